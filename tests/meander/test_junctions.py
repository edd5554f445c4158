import numpy as np
import pytest
from plain import plain_params
from trees import assert_forest, random_tree

import warpriver as wr
from warpriver import RiverNetwork
from warpriver.meander.junctions import JunctionParams, arrival_angles, junction_angles, shape_junctions


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
    np.testing.assert_allclose(angles[:2], np.radians(28.0))
    assert np.isnan(angles[2])


def test_a_small_tributary_comes_in_nearly_square_and_the_large_one_straight():
    small, large = junction_angles(fork([0.001, 10.0]))[:2]
    assert np.degrees(small) == pytest.approx(95.0, abs=1.0)
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


def test_arrival_angles_are_those_of_the_lines():
    angle = 0.6
    found = arrival_angles(fork((5.0, 1.0), angle=angle))
    np.testing.assert_allclose(found[:2], angle, rtol=1e-12)
    assert np.isnan(found[2])
    shaped = shape_junctions(fork((0.05, 10.0)))
    np.testing.assert_allclose(arrival_angles(shaped)[:2], junction_angles(shaped)[:2], atol=0.03)


@pytest.mark.parametrize("params", [plain_params, wr.PathMeander])
def test_in_a_simulation_mouths_take_the_angles_of_their_templates(params, device):
    """After 60 years, as long as the widest migrates by 100 widths: within 8 degrees in the mean, and none along.

    A template is an angle to the course of a river that bends at the node, arrivals are measured against the channel
    below it.
    """
    off, least, before = [], [], []
    for seed in range(4):
        network = random_tree(seed, sources=8, size=9000.0, width=25.0)
        sim = wr.Simulation(network, params(spacing=25.0, time_step=0.5), device=device)
        before += differences(sim.network)
        sim.run(steps=120, record_every=1000)
        assert_forest(sim.network)
        off += differences(sim.network)
        least.append(np.nanmin(lesser_arrivals(sim.network)))
    assert np.mean(before) > 25.0 and np.mean(off) < 8.0 and min(least) > 25.0, (np.mean(before), np.mean(off), least)


def lesser_arrivals(network):
    """Angles at which the lesser tributaries arrive, degrees; NaN for all other channels."""
    flow = network.channel_flow()
    greatest = np.zeros(network.node_count)
    np.maximum.at(greatest, network.channel_to, flow)
    return np.degrees(np.where(flow < greatest[network.channel_to], arrival_angles(network), np.nan))


def differences(network):
    off = np.abs(lesser_arrivals(network) - np.degrees(junction_angles(network)))
    return off[np.isfinite(off)].tolist()


def test_without_templates_nothing_is_shaped(device):
    """Two straight tributaries stay so, and keep the angle at which they meet."""
    network = fork((5.0, 1.0), angle=0.4)
    sim = wr.Simulation(network, wr.MeanderParams.paper().replace(spacing=20.0), device=device)
    sim.run(steps=50)
    np.testing.assert_allclose(arrival_angles(sim.network)[:2], 0.4, rtol=1e-6)


def test_a_mouth_is_led_to_the_outer_bank_and_not_along_the_river(device):
    """A brook on the inner bank of a bend goes on downstream to where the river bends away; one that runs along the
    river goes back upstream, and so comes in more steeply."""
    s = np.linspace(0.0, 4000.0, 201)
    river = np.stack([s, 250.0 * np.sin(2.0 * np.pi * s / 2000.0)], axis=1)
    # At the crest at 500 m the river bends to the right: the brook from the south comes to the inner bank.
    inner = [river[:26], river[25:], np.linspace([500.0, -900.0], river[25], 60)]
    straight = np.stack([s, 0.0 * s], axis=1)
    along = [straight[:101], straight[100:], np.linspace([500.0, 400.0], straight[100], 80)]
    shifts = []
    for lines in (inner, along):
        network = wr.RiverNetwork.from_polylines(lines, width=[40.0, 40.0, 15.0], discharge=[100.0, 101.0, 1.0])
        still = {"local_weight": 0.0, "upstream_weight": 0.0, "end_damping": 0.0, "collision_distance": 0.0}
        sim = wr.Simulation(network, plain_params(spacing=20.0, **still), device=device)
        node = int(sim.network.channel_to[2])
        before = sim.network.node_xy[node].copy()
        sim.run(years=10)
        shifts.append(float((sim.network.node_xy[node] - before)[0]))
    # The speed is a fifth of 60 m/yr at most.
    assert 60.0 < shifts[0] <= 120.0 + 1e-6 and -120.0 - 1e-6 <= shifts[1] < -20.0
