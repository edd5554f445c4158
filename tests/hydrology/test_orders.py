"""Stream orders on trees drawn by hand, and the laws of networks on lattices whose exponents are known."""

import numpy as np
import pytest

from warpriver import Terrain
from warpriver.hydrology import Flow, drainage_area, flow_length
from warpriver.hydrology.orders import (
    exceedance,
    hack_exponent,
    horton_order,
    horton_ratios,
    main_stem,
    main_stem_length,
    shreve_magnitude,
    strahler_order,
    tokunaga,
)

#   0   1   2   3  4        nodes 0 to 4 are sources; channels 0 to 8 by the node above
#    \ /     \ /  /
#     5       6  /
#      \     /  /
#       \   / 7 <- 4 joins 6-7
#        \   /
#         8 -> 9
FROM = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8])
TO = np.array([5, 5, 6, 6, 7, 8, 7, 8, 9])
AREA = np.array([2.0, 3.0, 1.0, 4.0, 1.5, 6.0, 5.5, 8.0, 15.0])
LENGTH = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 5.0, 6.0, 7.0, 8.0])


def perfect_tree(order):
    """A binary tree without side tributaries: every node of the level k has two of the level k - 1 above it."""
    above, below = [], []
    for node in range(1, 2**order):
        above.append(node)
        below.append(node // 2)
    level = np.floor(np.log2(above))
    return np.array(above), np.array(below), order - level


def scheidegger(rows, columns, seed):
    """Flow in which each cell drains to the cell below on its left or right, by chance, periodic across columns."""
    rng = np.random.default_rng(seed)
    here = np.arange(rows * columns).reshape(rows, columns)
    column = (here % columns + rng.integers(0, 2, here.shape)) % columns
    receiver = (np.arange(rows)[:, None] + 1) * columns + column
    receiver[-1] = here[-1]
    return Flow(Terrain(np.zeros((rows, columns)), 1.0), receiver.astype(np.int32), edges="periodic")


def test_orders_of_a_tree_drawn_by_hand():
    assert strahler_order(FROM, TO).tolist() == [1, 1, 1, 1, 1, 2, 2, 2, 3]
    assert shreve_magnitude(FROM, TO).tolist() == [1, 1, 1, 1, 1, 2, 2, 3, 5]
    assert main_stem(FROM, TO, AREA).tolist() == [0, 5, 2, 8, 4, 5, 8, 8, 8]
    assert horton_order(FROM, TO, AREA).tolist() == [1, 2, 1, 3, 1, 2, 3, 3, 3]
    # 3 -> 6 -> 7 -> 8 -> 9
    assert main_stem_length(FROM, TO, LENGTH, AREA)[8] == 40 + 6 + 7 + 8
    assert main_stem_length(FROM, TO, LENGTH, AREA, longest=True)[8] == 50 + 7 + 8


def test_orders_do_not_depend_on_how_channels_are_numbered():
    shuffle = np.random.default_rng(1).permutation(len(FROM))
    names = np.random.default_rng(2).permutation(100)
    above, below = names[FROM[shuffle]], names[TO[shuffle]]
    assert (strahler_order(above, below) == strahler_order(FROM, TO)[shuffle]).all()
    assert (shreve_magnitude(above, below) == shreve_magnitude(FROM, TO)[shuffle]).all()
    assert (horton_order(above, below, AREA[shuffle]) == horton_order(FROM, TO, AREA)[shuffle]).all()


def test_more_than_two_channels_may_meet_and_one_may_go_on():
    # Two of order 2 and one of order 1 meet; then a node without a junction.
    above = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8])
    below = np.array([5, 5, 6, 6, 7, 7, 7, 8, 9])
    assert strahler_order(above, below).tolist() == [1, 1, 1, 1, 1, 2, 2, 3, 3]
    # A single order 2 with two of order 1 stays 2.
    assert strahler_order([0, 1, 2, 3, 4, 5], [4, 4, 5, 5, 5, 6])[-1] == 2


def test_several_trees_at_once():
    above, below = np.concatenate([FROM, FROM + 100]), np.concatenate([TO, TO + 100])
    assert strahler_order(above, below).tolist() == 2 * strahler_order(FROM, TO).tolist()


def test_a_long_chain_and_a_circle():
    n = 3000
    assert (strahler_order(np.arange(n), np.arange(1, n + 1)) == 1).all()
    with pytest.raises(ValueError, match="circle"):
        strahler_order([0, 1, 2], [1, 2, 0])
    with pytest.raises(ValueError, match="circle"):
        shreve_magnitude([0], [0])
    with pytest.raises(ValueError, match="leave node 1"):
        strahler_order([0, 1, 1], [1, 2, 3])
    with pytest.raises(ValueError, match="channel_from"):
        strahler_order([], [])
    with pytest.raises(ValueError, match="area"):
        horton_ratios(FROM, TO, LENGTH, AREA[:3])


def test_horton_ratios_of_a_perfect_tree():
    above, below, order = perfect_tree(7)
    assert (strahler_order(above, below) == order).all()
    area = 4.0**order
    ratios = horton_ratios(above, below, 1.5**order, area)
    assert ratios.streams.tolist() == [64, 32, 16, 8, 4, 2, 1]
    np.testing.assert_allclose(ratios[3:], [2.0, 1.5, 4.0])
    assert tokunaga(above, below).matrix.sum() == 0.0


def test_horton_ratios_count_streams_not_channels():
    ratios = horton_ratios(FROM, TO, LENGTH, AREA)
    assert ratios.streams.tolist() == [5, 2, 1]
    np.testing.assert_allclose(ratios.length, [30.0, (5 + 6 + 7) / 2, 8.0])
    np.testing.assert_allclose(ratios.area, [11.5 / 5, 7.0, 15.0])


def test_tokunaga_of_a_tree_drawn_by_hand():
    found = tokunaga(FROM, TO)
    # Channel 4 joins the stream 6-7 from the side: one of two streams of order 2.
    expected = np.zeros((3, 3))
    expected[0, 1] = 0.5
    assert (found.matrix == expected).all()
    np.testing.assert_allclose(found.mean, [1 / 3, 0.0])
    assert np.isnan(found.ratio)


def tokunaga_tree(order, node):
    """Tree with T_k = 2^(k - 1): a list of (node above, node below); returns it and the next free number."""
    number = [node + 1]

    def stream(k, end):
        """A stream of order k that ends at a node; side tributaries come in one after another."""
        edges = []
        for j in range(1, k):
            for _ in range(2 ** (k - j - 1)):
                top = number[0]
                number[0] += 1
                edges.append((top, end))
                edges += stream(j, top)
                end = top
        top = number[0]
        number[0] += 1
        edges.append((top, end))
        if k > 1:
            edges += stream(k - 1, top) + stream(k - 1, top)
        return edges

    return stream(order, node)


def test_tokunaga_law_of_a_tree_made_by_it():
    above, below = np.array(tokunaga_tree(5, 0)).T
    found = tokunaga(above, below)
    assert strahler_order(above, below).max() == 5
    np.testing.assert_allclose(found.mean, [1.0, 2.0, 4.0, 8.0])
    np.testing.assert_allclose([found.first, found.ratio], [1.0, 2.0])


def test_power_law_and_exceedance_of_exact_samples():
    area = np.geomspace(1.0, 1e6, 50)
    law = hack_exponent(1.4 * area**0.57, area)
    np.testing.assert_allclose(law, [0.57, 1.4, 1.0])
    # Quantiles of P(A > a) = a^-0.43.
    areas = ((np.arange(200_000) + 0.5) / 200_000) ** (-1 / 0.43)
    found = exceedance(areas, low=10.0, high=1e4)
    assert abs(found.exponent - 0.43) < 0.005
    assert found.probability[-1] == 0.0 and (np.diff(found.probability) < 0.0).all()
    with pytest.raises(ValueError, match="two"):
        exceedance([5.0, 5.0])
    with pytest.raises(ValueError, match="positive"):
        hack_exponent([1.0, -1.0], [1.0, 2.0])


def test_scheidegger_lattice():
    rows = columns = 600
    flow = scheidegger(rows, columns, 4)
    area = drainage_area(flow).numpy()
    sources = (area[1:] == 1.0).mean()
    away = area[200:]
    distribution = exceedance(away, low=10.0, high=1000.0)
    length = flow_length(flow, downstream=False).numpy() + 1.0
    big = (area > 100.0) & (area < 5000.0)
    hack = hack_exponent(length[big], area[big])
    magnitude = shreve_magnitude(*_as_channels(flow))
    print(f"sources {sources:.4f} (1/4), P(A > a) {distribution.exponent:.3f} (1/3), Hack {hack.exponent:.3f} (2/3)")
    assert abs(sources - 0.25) < 0.005
    assert abs(distribution.exponent - 1 / 3) < 0.03
    assert abs(hack.exponent - 2 / 3) < 0.04
    assert abs(tokunaga(*_as_channels(flow)).ratio - 2.7) < 0.5
    receiver = flow.receiver.numpy().reshape(-1)
    last = receiver == np.arange(receiver.size)
    assert magnitude.sum() > 0 and last.sum() == columns


def _as_channels(flow):
    """Every cell that drains to another one as a channel."""
    to = flow.receiver.numpy().reshape(-1)
    here = np.arange(to.size)
    return here[to != here], to[to != here]
