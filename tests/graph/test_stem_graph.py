"""Which channels go on from each other as one river."""

import numpy as np
from trees import random_tree

from warpriver import RiverNetwork
from warpriver.graph.stems import find_stems


def network_of(ends, discharge, closed=None):
    """Straight channels between numbered places, which lie on a circle."""
    place = [np.array([np.cos(k), np.sin(2.0 * k)]) * 1000.0 for k in range(20)]
    t = np.linspace(0.0, 1.0, 5)[:, None]
    lines = [(1.0 - t) * place[a] + t * place[b] for a, b in ends]
    return RiverNetwork.from_polylines(lines, width=10.0, discharge=discharge)


def test_the_tributary_with_more_discharge_goes_on():
    stems = find_stems(network_of([(0, 2), (1, 2), (2, 4), (3, 4), (4, 5)], [1.0, 2.0, 3.0, 9.0, 12.0]))
    assert stems.upper.tolist() == [-1, -1, 1, -1, 3]
    assert stems.lower.tolist() == [-1, 2, -1, 4, -1]
    assert stems.top.tolist() == [0, 1, 1, 3, 3]
    assert stems.bottom.tolist() == [0, 2, 2, 4, 4]


def test_of_equal_tributaries_the_first_goes_on():
    stems = find_stems(network_of([(1, 2), (0, 2), (2, 3)], [5.0, 5.0, 10.0]))
    assert stems.upper.tolist() == [-1, -1, 0]


def test_pieces_of_one_river_are_one_stem():
    stems = find_stems(network_of([(0, 1), (1, 2), (2, 3), (3, 4)], 3.0))
    assert stems.top.tolist() == [0] * 4 and stems.bottom.tolist() == [3] * 4
    broken = find_stems(network_of([(0, 1), (1, 2), (2, 3), (3, 4)], 3.0), alone=np.array([0, 1, 0, 0], bool))
    assert broken.upper.tolist() == [-1, -1, -1, 2] and broken.bottom.tolist() == [0, 1, 3, 3]


def test_stems_end_where_water_parts_and_in_circles():
    parting = find_stems(network_of([(0, 1), (1, 2), (1, 3), (3, 4)], 3.0))
    assert parting.upper.tolist() == [-1, -1, -1, 2]
    circle = find_stems(network_of([(0, 1), (1, 2), (2, 0), (3, 4), (4, 5)], 3.0))
    assert circle.upper.tolist() == [-1, -1, -1, -1, 3]
    assert circle.top.tolist() == [0, 1, 2, 3, 3]


def test_rings_are_stems_of_their_own():
    angle = 2.0 * np.pi * np.arange(40) / 40
    ring = 400.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    stems = find_stems(RiverNetwork.from_polylines([ring, ring + [2000.0, 0.0]], 20.0, closed=True))
    assert stems.upper.tolist() == stems.lower.tolist() == [-1, -1] and stems.top.tolist() == [0, 1]


def test_stems_of_a_tree_part_it_into_as_many_rivers_as_sources():
    for seed in range(10):
        network = random_tree(seed, sources=3 + seed)
        stems = find_stems(network)
        joined = np.flatnonzero(stems.upper >= 0)
        np.testing.assert_array_equal(stems.lower[stems.upper[joined]], joined)
        np.testing.assert_array_equal(network.channel_to[stems.upper[joined]], network.channel_from[joined])
        assert len(np.unique(stems.top)) == 3 + seed == len(np.unique(stems.bottom))
        # The largest arrival of every junction goes on.
        for c in joined:
            arriving = np.flatnonzero(network.channel_to == network.channel_from[c])
            assert network.channel_discharge[stems.upper[c]] == network.channel_discharge[arriving].max()
