"""Inlets: which heads are fed, what that does to a straight reach, and that runs keep their bits."""

import numpy as np
import pytest
import reference_banks

import warpriver as wr
from warpriver.engine import state as engine_state
from warpriver.engine.stems import find_map_edges
from warpriver.meander.inlets import find_inlets, inlet_periods

WIDTH = 40.0
FED = wr.MeanderParams(
    spacing=20.0, inlet="all", sinuosity_scaling="whole", memory_length=2.5, curvature_saturation=0.25
)  # fmt: skip


def noisy(length=200.0, seed=0):
    return wr.RiverNetwork.from_polylines([wr.generate.noisy_line(length * WIDTH, 20.0, 10.0, seed)], width=WIDTH)


@pytest.mark.parametrize("inlet", ["all", "periodic", "none"])
def test_a_river_is_not_left_straight_below_an_inlet(inlet, device):
    """Meanders grow as they are carried down: below a head that nothing disturbs they go away."""
    sim = wr.Simulation(noisy(), FED.replace(inlet=inlet), seed=1, device=device)
    sim.run(years=600, record_every=10**6)
    straight = wr.metrics.statistics(sim.network).straight_below_head
    assert straight > 40.0 if inlet == "none" else straight < 15.0


def test_a_straight_reach_answers_by_the_exponential_of_its_memory(device):
    """One short step: the push is gamma k w C(t) e^(-z / (L w)), C at the beginning of the step."""
    line = np.stack([np.arange(0.0, 4001.0, 20.0), np.zeros(201)], axis=1)
    params = FED.replace(time_step=0.01, curvature_saturation=0.0, bank_spread=0.0)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], WIDTH), params, seed=5, device=device)
    sim.step()
    moved = sim.network.polylines()[0]
    curvature = params.inlet_curvature / WIDTH * reference_banks.slow_noise(5, int(sim.network.channel_id[0]), 0.0)
    z = np.arange(1, 60) * 20.0
    push = 0.01 * 2.5 * params.migration_rate * WIDTH * curvature * np.exp(-z / (2.5 * WIDTH))
    # To the right of the flow, which is down here; the first points feel the step's own smoothing of the local term.
    np.testing.assert_allclose(moved[1:60, 1], -push, atol=1e-3 * abs(push).max())
    assert abs(push[0]) > 1e-5 and (moved[0] == line[0]).all()


def test_the_period_is_that_of_a_wave_that_passes():
    """lambda / c, c = k w gamma alpha q^2 / (alpha^2 + q^2): with alpha = q half of k w gamma q."""
    params = FED.replace(inlet_wavelength=2.0 * np.pi * 2.5)
    (period,) = inlet_periods(np.array([WIDTH]), np.array([1.0]), params)
    assert period == pytest.approx(2.0 * np.pi * 2.5 * WIDTH / (0.5 * 60.0 * 2.5 / 2.5))
    friction = params.replace(memory_length=0.0, friction=0.5 / (2.5 * WIDTH))
    assert inlet_periods(np.array([WIDTH]), np.array([1.0]), friction)[0] == pytest.approx(period)
    assert inlet_periods(np.array([WIDTH]), np.array([1.0]), params.replace(upstream_weight=0.0))[0] == 0.0


def test_heads_at_the_edge_of_the_map_are_inlets_and_springs_are_not():
    lines = [
        ((0.0, 500.0), (600.0, 500.0)),
        ((600.0, 980.0), (600.0, 500.0)),
        ((300.0, 200.0), (600.0, 500.0)),
        ((600.0, 500.0), (1000.0, 400.0)),
    ]
    network = wr.RiverNetwork.from_polylines([np.linspace(*line, 9) for line in lines], [20.0, 30.0, 20.0, 40.0])
    edges = find_map_edges(wr.Terrain(np.zeros((50, 50)), 20.0, origin=(0.0, 1000.0)))
    assert find_inlets(network, edges, "edge").tolist() == [True, True, False, False]
    assert find_inlets(network, None, "edge").tolist() == [True, True, True, False]
    assert find_inlets(network, edges, "all").tolist() == [True, True, True, False]
    assert not find_inlets(network, edges, "none").any()
    angle = 2.0 * np.pi * np.arange(40) / 40
    ring = wr.RiverNetwork.from_polylines([500.0 * np.stack([np.cos(angle), np.sin(angle)], 1)], 20.0, closed=True)
    assert not find_inlets(ring, None, "all").any()


def test_bits_do_not_depend_on_threads_chunks_or_a_stop(tmp_path, monkeypatch):
    lines = wr.generate.noisy_line(60.0 * WIDTH, 20.0, 10.0, 3)
    half = len(lines) // 2
    pieces = [lines[: half + 1], lines[half:], lines[half] + np.array([[-600.0, 900.0], [-200.0, 400.0], [0.0, 0.0]])]

    def simulation(**options):
        network = wr.RiverNetwork.from_polylines(pieces, [WIDTH, WIDTH, 15.0])
        return wr.Simulation(network, FED, seed=2**40 + 3, **options)

    whole = simulation(threads=1)
    whole.run(steps=40)
    points = whole.network.points()
    several = simulation(threads=3, capture=False)
    several.run(steps=40)
    np.testing.assert_array_equal(several.network.points(), points)
    stopped = simulation(threads=1)
    stopped.run(steps=17, store=tmp_path / "run")
    again = wr.Simulation.resume(tmp_path / "run", threads=1, device="cpu")
    again.run(steps=23)
    np.testing.assert_array_equal(again.network.points(), points)
    other = simulation(threads=1)
    other.stepper.state.seed = 4
    other.stepper.state.changed()
    other.run(steps=40)
    assert not np.array_equal(other.network.points(), points)
    monkeypatch.setattr(engine_state, "CPU_CHUNK", 32)
    chunked = simulation(threads=1)
    chunked.run(steps=40)
    np.testing.assert_allclose(chunked.network.points(), points, atol=1e-6)


def test_a_periodic_river_feeds_itself_to_the_same_bits_whatever_the_seed_and_stops(tmp_path):
    def simulation(seed, **options):
        params = FED.replace(inlet="periodic", bank_spread=0.0)
        return wr.Simulation(noisy(120.0), params, seed=seed, threads=1, **options)

    whole = simulation(1)
    whole.run(steps=300)
    other = simulation(2)
    other.run(steps=300)
    np.testing.assert_array_equal(other.network.points(), whole.network.points())
    stopped = simulation(1)
    stopped.run(steps=170, store=tmp_path / "run", record_every=10**6)
    again = wr.Simulation.resume(tmp_path / "run", threads=1, device="cpu")
    again.run(steps=130)
    np.testing.assert_array_equal(again.network.points(), whole.network.points())
    alone = wr.Simulation(noisy(120.0), FED.replace(inlet="none", bank_spread=0.0), threads=1, device="cpu")
    alone.run(steps=300)
    assert not np.array_equal(alone.network.points(), whole.network.points())
