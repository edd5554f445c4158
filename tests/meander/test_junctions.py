import numpy as np
import pytest
from trees import assert_forest, random_tree

from warpriver import RiverNetwork
from warpriver.meander.junctions import JunctionParams, junction_angles, shape_junctions


def fork(flows, width=20.0, angle=0.6):
    """Two tributaries that meet at (0, 0), and the channel below, which flows south."""
    s = np.linspace(1.0, 0.0, 101)[:, None]
    up = 1000.0 * np.array([[-np.sin(angle), np.cos(angle)], [np.sin(angle), np.cos(angle)]])
    lines = [s * up[0], s * up[1], 1000.0 * (1 - s) * [0.0, -1.0]]
    return RiverNetwork.from_polylines(lines, width=width, drainage_area=[*flows, sum(flows)])


def arrival(line):
    """Angle between the last points of a tributary and the channel below, which flows south; rad."""
    last = line[-1] - line[-2]
    return np.arctan2(abs(last[0]), -last[1])


def test_equal_flows_meet_at_the_narrow_angle():
    angles = junction_angles(fork([5.0, 5.0]))
    np.testing.assert_allclose(angles[:2], np.radians(25.0))
    assert np.isnan(angles[2])


def test_a_small_tributary_comes_in_nearly_square_and_the_large_one_straight():
    small, large = junction_angles(fork([0.001, 10.0]))[:2]
    assert np.degrees(small) == pytest.approx(80.0, abs=1.0)
    assert np.degrees(large) == pytest.approx(0.0, abs=1.0)
    ratios = [junction_angles(fork([r, 1.0]))[0] for r in (0.01, 0.1, 0.3, 1.0)]
    assert (np.diff(ratios) < 0).all()


@pytest.mark.parametrize("flows", [(5.0, 5.0), (0.05, 10.0), (10.0, 0.05)])
def test_shaped_lines_arrive_at_the_angle_from_their_side(flows):
    network = fork(flows)
    shaped = shape_junctions(network)
    assert_forest(shaped)
    for c in (0, 1):
        before, after = network.polylines()[c], shaped.polylines()[c]
        # The last chord of 100 points differs from the tangent by its part of the reach.
        assert arrival(after) == pytest.approx(junction_angles(network)[c], abs=0.12)
        np.testing.assert_array_equal(after[-1], before[-1])
        np.testing.assert_array_equal(after[:80], before[:80])
        assert (after[80:-1, 0] * (1 if c else -1) > -1e-9).all(), "it stays on its side"
        assert np.hypot(*np.diff(after, axis=0).T).max() < 2.0 * 10.0, "no gap opens"
    np.testing.assert_array_equal(shaped.polylines()[2], network.polylines()[2])


def test_mirrored_network_gives_the_mirrored_shape():
    lines = fork((0.4, 3.0)).polylines()
    mirrored = RiverNetwork.from_polylines([xy * [-1, 1] for xy in lines], width=20.0, drainage_area=[0.4, 3.0, 3.4])
    shaped = shape_junctions(RiverNetwork.from_polylines(lines, width=20.0, drainage_area=[0.4, 3.0, 3.4]))
    for one, two in zip(shape_junctions(mirrored).polylines(), shaped.polylines(), strict=True):
        np.testing.assert_allclose(one, two * [-1, 1], atol=1e-9)


def test_any_tree_stays_a_forest_and_finite():
    for seed in range(20):
        assert_forest(shape_junctions(random_tree(seed, sources=3 + seed % 7)))


def test_a_single_channel_is_left_alone():
    line = np.stack([np.linspace(0, 900, 50), np.zeros(50)], axis=1)
    network = RiverNetwork.from_polylines([line], width=20.0)
    np.testing.assert_array_equal(shape_junctions(network).polylines()[0], network.polylines()[0])


def test_params_are_checked():
    with pytest.raises(ValueError, match="wide_angle"):
        JunctionParams(narrow_angle=60.0, wide_angle=30.0)
