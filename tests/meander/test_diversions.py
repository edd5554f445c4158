"""Diversions: channels that leave for another one along the cheapest way, and what the network is afterwards."""

import numpy as np
import pytest
from plain import plain_params
from trees import assert_forest

from warpriver import AvulsionParams, RiverNetwork, Simulation, Terrain, edits, generate
from warpriver.meander.diversions import upstream_of

SPACING, WIDTH = 50.0, 50.0


def ground(wall=0.0):
    """A plain that falls to the south and to the east; a wall with a gap lies across it, if it is wanted."""
    x, y = np.meshgrid(np.arange(25.0, 12_000.0, 50.0), np.arange(7_975.0, 0.0, -50.0))
    height = 40.0 - 5e-4 * x + 1.5e-3 * y
    height = height + np.where((np.abs(y - 4_000.0) < 150.0) & (np.abs(x - 9_000.0) > 400.0), wall, 0.0)
    return Terrain(height, 50.0, (0.0, 8_000.0))


def rivers(wall=0.0):
    """Two tributaries of a river in the north, and one in the south."""
    x = np.arange(500.0, 11_500.0, SPACING)
    north = np.column_stack([x, np.full_like(x, 6_500.0)])
    half = len(x) // 3
    side = np.linspace([north[half, 0] - 1_200.0, 7_800.0], north[half], 40)
    lines = [north[: half + 1], side, north[half:], np.column_stack([x, np.full_like(x, 2_600.0)])]
    network = RiverNetwork.from_polylines(lines, [40.0, 30.0, WIDTH, WIDTH], discharge=[300.0, 100.0, 400.0, 500.0])
    sim = Simulation(network, plain_params(spacing=SPACING), terrain=ground(wall))
    sim.step(3)
    return sim


def bits(sim):
    return [sim.network.points(), sim.network.starts(), sim.network.channel_discharge, sim.terrain.to_numpy()]


def test_a_river_is_diverted_to_another_with_all_its_water():
    sim = rivers()
    before = bits(sim)
    sim.apply(edits.DivertChannel(2, (6_000.0, 6_500.0), to=3))
    network = sim.network
    # The river in the south is divided where 400 m3/s come to it; nothing is left in the north downstream of the place.
    assert network.channel_count == 5
    order = np.argsort(network.channel_id)
    discharge = dict(zip(network.channel_id[order].tolist(), network.channel_discharge[order].tolist(), strict=True))
    assert discharge[2] == pytest.approx(400.0) and discharge[3] == pytest.approx(900.0)
    assert sum(q == pytest.approx(500.0) for q in discharge.values()) == 1
    below = int(np.flatnonzero(network.channel_id == 3)[0])
    assert network.channel_width[below] > WIDTH
    assert not ((network.points()[:, 1] > 6_000.0) & (network.points()[:, 0] > 6_500.0)).any()
    (event,) = sim.history.avulsions
    np.testing.assert_allclose(event.xy[0], event.course[0], atol=1e-6)
    assert (np.diff(event.bed) < 0.0).all() and len(event.xy) > 100
    assert network.channel_to[int(np.flatnonzero(network.channel_id == 2)[0])] == network.channel_from[below]
    after = bits(sim)
    sim.undo()
    for a, b in zip(bits(sim), before, strict=True):
        np.testing.assert_array_equal(a, b)
    sim.redo()
    for a, b in zip(bits(sim), after, strict=True):
        np.testing.assert_array_equal(a, b)
    sim.run(steps=40, record_every=20)
    again = Simulation.replay(rivers(), sim.history)
    np.testing.assert_array_equal(again.network.points(), sim.network.points())


def test_the_way_goes_where_the_ground_lets_it():
    """Through the gap of a wall, 3 km off the shortest way."""
    sim = rivers(wall=30.0)
    sim.apply(edits.DivertChannel(2, (6_000.0, 6_500.0)))
    (event,) = sim.history.avulsions
    across = event.course[np.abs(event.course[:, 1] - 4_000.0).argmin()]
    assert abs(across[0] - 9_000.0) < 400.0


def test_what_cannot_be_diverted_is_refused():
    sim = rivers()
    before = bits(sim)
    for edit, message in (
        (edits.DivertChannel(2, (6_000.0, 6_500.0), to=0), "the water of channel 0 comes through channel 2"),
        (edits.DivertChannel(2, (6_000.0, 6_500.0), to=9), "there is no channel 9"),
        (edits.DivertChannel(3, 2_000.0, to=1), "finds no course"),
    ):
        with pytest.raises(ValueError, match=message):
            sim.apply(edit)
        for a, b in zip(bits(sim), before, strict=True):
            np.testing.assert_array_equal(a, b)
    assert upstream_of(sim.network, 2).tolist() == [True, True, True, False]


def test_a_river_is_diverted_to_the_edge_of_the_ground():
    sim = rivers()
    before = bits(sim)
    sim.apply(edits.DivertChannel(3, (6_000.0, 2_600.0), to="outlet"))
    network = sim.network
    line = network.polylines()[int(np.flatnonzero(network.channel_id == 3)[0])]
    assert network.channel_count == 4 and line[-1, 1] < 100.0, "it leaves in the south, the nearest edge"
    assert network.channel_discharge[network.channel_id == 3] == pytest.approx(500.0)
    sim.run(steps=20)
    again = Simulation.replay(rivers(), sim.history)
    np.testing.assert_array_equal(again.network.points(), sim.network.points())
    sim = rivers()
    sim.apply(edits.DivertChannel(3, (6_000.0, 2_600.0), to="outlet"))
    sim.undo()
    for a, b in zip(bits(sim), before, strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(ValueError, match="to"):
        edits.DivertChannel(3, 100.0, to="elsewhere")


def bending(**constants):
    """Two winding rivers side by side on ground that falls to the east, with avulsions at every break of a bank."""
    lines = [
        generate.noisy_line(11_000.0, SPACING, 60.0, seed) + [500.0, y] for seed, y in ((1, 5_000.0), (2, 3_600.0))
    ]
    network = RiverNetwork.from_polylines(lines, WIDTH, discharge=[300.0, 500.0])
    avulsions = AvulsionParams(crevasse_rate=0.02, avulsion_probability=1.0, **constants)
    terrain = Terrain(ground().to_numpy() * 0.0 + 40.0 - 5e-4 * np.arange(25.0, 12_000.0, 50.0), 50.0, (0.0, 8_000.0))
    return Simulation(network, plain_params(spacing=SPACING, avulsions=avulsions), terrain=terrain, seed=4)


def outflow(network):
    """Water that leaves the network, m3/s."""
    ends = ~np.isin(network.channel_to, network.channel_from)
    return float(network.channel_discharge[ends].sum())


def test_by_chance_rivers_leave_for_another_one(tmp_path):
    """Of the avulsions half are regional; all water still leaves the map, and a run goes on to the same bits."""
    sim = bending(regional=0.5)
    sim.run(years=60.0, record_every=10_000)
    assert_forest(sim.network, binary=False)
    assert outflow(sim.network) == pytest.approx(800.0, rel=1e-9)
    events = sim.history.avulsions
    started = bending()
    started.run(years=60.0, record_every=10_000)
    assert len(events) >= 3 and sim.network.channel_count != 2 and started.network.channel_count == 2
    for event in events:
        assert (np.diff(event.bed) < 0.0).all()
    sim.history.save(tmp_path / "run.npz")
    resumed = Simulation.resume(tmp_path / "run.npz", terrain=bending().terrain)
    for run in (sim, resumed):
        run.run(years=10.0, record_every=10_000)
    for a, b in zip(bits(resumed), bits(sim), strict=True):
        np.testing.assert_array_equal(a, b)
