"""Junctions that wander down the channel below them."""

import numpy as np
import pytest
from plain import plain_params
from trees import assert_forest, random_tree

import warpriver as wr

WIDTH, SPACING = 40.0, 20.0
# A straight channel stays straight to rounding, and its first segment is halved at most.
ROUNDING = 1e-8


def fork(lower=6000.0):
    """Two straight tributaries that meet above a straight channel."""
    part = np.linspace(0.0, 1.0, 120)[:, None]
    lines = [(1.0 - part) * [-2000.0, 2500.0], (1.0 - part) * [1800.0, 2600.0], part * [0.0, -lower]]
    return wr.RiverNetwork.from_polylines(lines, width=[WIDTH, WIDTH, 1.4 * WIDTH], drainage_area=[1e8, 1e8, 2e8])


@pytest.mark.parametrize("capture", [True, False])
@pytest.mark.parametrize(
    ("params", "rate"),
    [
        # Straight channels do not migrate; the bends that the drift gives the tributaries are held back here, and no
        # corner of a river that goes on through the junction is rounded.
        (
            plain_params(
                spacing=SPACING,
                junction_drift=0.1,
                local_weight=0.0,
                upstream_weight=0.0,
                upstream_memory="channel",
                junctions=None,
            ),
            60.0,
        ),
        (wr.PathMeander(spacing=SPACING, junction_drift=0.1, displacement_rate=40.0, junctions=None), 40.0),
    ],
    ids=["migration", "paths"],
)
def test_a_junction_wanders_at_its_speed(params, rate, capture, device):
    sim = wr.Simulation(fork(), params, check=not capture, capture=capture, device=device)
    node = sim.network.channel_to[0]
    before = sim.network.node_xy.copy()
    sim.run(steps=200)
    gone = 0.1 * rate * 200 * params.time_step
    expected = before.copy()
    expected[node] += [0.0, -gone]
    np.testing.assert_allclose(sim.network.node_xy, expected, atol=ROUNDING, rtol=0.0)
    # The tributaries follow, their sources stay, and nothing is torn.
    assert_forest(sim.network)
    ends = [xy[-1] for xy in sim.network.polylines()[:2]] + [sim.network.polylines()[2][0]]
    np.testing.assert_allclose(ends, [expected[node]] * 3, atol=ROUNDING, rtol=0.0)


def test_without_drift_and_stems_junctions_stay(device):
    params = plain_params(spacing=SPACING, upstream_memory="channel", junction_drift=0.0)
    sim = wr.Simulation(fork(), params, device=device)
    before = sim.network.node_xy.copy()
    sim.run(steps=50)
    np.testing.assert_array_equal(sim.network.node_xy, before)


def test_a_junction_stops_before_the_next_one(device):
    params = plain_params(
        spacing=SPACING,
        junction_drift=1.0,
        local_weight=0.0,
        upstream_weight=0.0,
        collision_distance=0.0,
        junctions=None,
    )
    sim = wr.Simulation(fork(lower=1500.0), params, device=device)
    sim.run(steps=300)
    length = sim.network.channel_lengths()[2]
    assert 10.0 * 1.4 * WIDTH - 2.0 * SPACING < length <= 10.0 * 1.4 * WIDTH


def test_on_steep_ground_junctions_stay(device):
    sim = wr.Simulation(
        fork(),
        plain_params(spacing=SPACING, junction_drift=0.5),
        terrain=wr.Terrain(np.add.outer(np.arange(120) * 20.0, np.zeros(90)), 100.0, origin=(-4500.0, 4000.0)),
        device=device,
    )
    before = sim.network.node_xy.copy()
    sim.run(steps=20)
    np.testing.assert_array_equal(sim.network.node_xy, before)


@pytest.mark.parametrize("kind", [plain_params, wr.PathMeander])
def test_trees_keep_together_while_junctions_wander_and_channels_join(kind, tmp_path, device):
    """The graph stays a forest, and a run that goes on from a record is the same to the bit."""
    collisions = 0
    for seed in range(6):
        network = random_tree(seed, sources=8, size=8000.0, width=25.0)
        params = kind(spacing=20.0, junction_drift=0.2, time_step=0.5)
        sim = wr.Simulation(network, params, device=device)
        first = sim.network.node_xy.copy()
        sim.run(steps=40, record_every=40)
        again = wr.Simulation.resume(
            sim.history.save(tmp_path / f"{seed}.npz") or tmp_path / f"{seed}.npz", device=device
        )
        for run in (sim, again):
            run.run(steps=40, record_every=40)
        assert_forest(sim.network)
        collisions += len(sim.history.collisions)
        assert sim.network.node_xy.shape != first.shape or (sim.network.node_xy != first).any()
        np.testing.assert_array_equal(again.network.points(), sim.network.points())
        np.testing.assert_array_equal(again.network.node_xy, sim.network.node_xy)
    assert collisions > 5


def test_where_a_channel_parts_nothing_wanders(device):
    part = np.linspace(0.0, 1.0, 60)[:, None]
    lines = [part * [-2000.0, -2500.0], part * [1800.0, -2600.0]]
    network = wr.RiverNetwork.from_polylines(lines, width=WIDTH)
    sim = wr.Simulation(
        network, plain_params(spacing=SPACING, collision_distance=0.0, junction_drift=0.5), device="cpu"
    )
    before = sim.network.node_xy.copy()
    sim.run(steps=20)
    np.testing.assert_array_equal(sim.network.node_xy, before)
