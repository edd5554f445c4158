"""A process that the package does not know: one phase and one kernel, and nothing else has to know of it."""

import dataclasses

import models
import numpy as np
import pytest
import warp as wp
from plain import plain_params

from warpriver import Simulation
from warpriver.engine import state as engine_state
from warpriver.engine.checks import PhaseError
from warpriver.engine.phase import Phase
from warpriver.engine.stages import Stage, launch
from warpriver.history import Event, History
from warpriver.kernels import channels
from warpriver.kernels.channels import Work

# m/yr
WIND = (0.3, -0.7)


line = channels.build(wp.float64)


@wp.kernel(enable_backward=False)
def carry_points(channels: line.Channels, work: Work, wind: wp.vec2d, point_io: wp.array[wp.vec2d]):
    """Move all points by the wind's way over the time step of their channel."""
    run = line.begin_runs(channels, work, work.first + wp.tid())
    while run.stop < run.end:
        run = line.next_run(channels, run)
        for i in range(run.begin, run.stop):
            point_io[i] = point_io[i] + wind * run.step


@dataclasses.dataclass(frozen=True)
class Gust(Event):
    """The wind has blown for a while."""

    channels: int
    way: np.ndarray


class Drift(Phase):
    """Carries all points with the wind, and tells of it after every batch."""

    name = "drift with the wind"
    moves_nodes = True

    def __init__(self, wind):
        self.wind, self.allocations, self.installations, self.checks = wind, 0, 0, 0

    def allocate(self, state):
        self.allocations += 1
        self.blown = state.zeros(state.channel_capacity, state.scalar)

    def install(self, state):
        self.installations += 1

    def stages(self, state):
        channels, wind = state.channels(), wp.vec2d(*self.wind)

        def blow(share):
            inputs = [channels, share.work, wind]
            launch(carry_points, share.point_threads, inputs, [state.point_moved], state.device)

        return [Stage(self.name, blow)]

    def after(self, state, batch):
        return [Gust(time, state.network.channel_count, np.array([self.wind])) for time in batch.times]

    def check(self, state):
        self.checks += 1
        if not np.isfinite(state.point_moved.numpy()).all():
            raise PhaseError("blown away")


def still(**options):
    """Channels that nothing but the wind moves."""
    network = models.many_channels()
    params = plain_params(spacing=25.0, migration_rate=1e-9, collision_distance=0.0)
    return Simulation(network, params, **options)


def test_all_points_drift_by_the_vector(device):
    sim, calm = still(phases=[Drift(WIND)], device=device), still(device=device)
    sim.run(steps=20)
    calm.run(steps=20)
    for xy, start in zip(sim.network.polylines(), calm.network.polylines(), strict=True):
        np.testing.assert_allclose(xy - start, np.broadcast_to(np.multiply(WIND, sim.time), xy.shape), atol=1e-6)
    ends = np.concatenate([xy[[0, -1]] for xy in sim.network.polylines()])
    assert np.abs(sim.network.node_xy[:, None] - ends).sum(axis=2).min(axis=1).max() < 1e-9, "nodes go with the ends"


def test_its_events_are_recorded_saved_loaded_and_resumed(tmp_path, device):
    whole = models.tree(device=device, phases=[Drift(WIND)]).run(steps=60, record_every=10)
    half = models.tree(device=device, phases=[Drift(WIND)])
    half.run(steps=30, record_every=10, store=tmp_path / "run")
    rest = Simulation.resume(tmp_path / "run", phases=[Drift(WIND)], device=device)
    rest.run(steps=30, record_every=10)
    loaded = History.load(tmp_path / "run")
    gusts = loaded.events.of(Gust)
    assert len(gusts) == 60 and gusts[-1].time == pytest.approx(rest.time) and gusts[0].way.tolist() == [list(WIND)]
    assert list(loaded.events) == list(whole.events)
    assert loaded.events.counts().keys() >= {"gust", "cutoff", "collision"}
    np.testing.assert_array_equal(loaded.networks[-1].points(), whole.networks[-1].points())


def test_it_is_recorded_with_the_step_grows_and_is_checked(monkeypatch, device):
    """Its arrays are made anew where the network gets more points or channels, and its check is called."""
    drift = Drift(WIND)
    sim = models.tree(device=device, phases=[drift], check=True)
    sim.run(steps=3)
    assert drift.checks == 3 * sim.substeps
    made = drift.allocations
    sim.stepper.state.make_room(2 * sim.stepper.state.point_capacity)
    assert drift.allocations == made + 1
    installed = drift.installations
    sim.run(steps=40)
    assert len(sim.history.collisions) > 0 and drift.installations > installed


def test_the_order_of_shares_does_not_matter_to_it(monkeypatch):
    """In a GPU's layout and in slabs its result is the same to the bit."""
    runs = []
    for chunk in (0, 32):
        monkeypatch.setattr(engine_state, "CPU_CHUNK", chunk)
        sim = models.plain(phases=[Drift(WIND)], threads=1)
        sim.run(steps=10)
        runs.append(sim.network.points())
    np.testing.assert_array_equal(*runs)


def test_neither_engine_nor_history_nor_network_knows_any_process():
    """They import none, and name none of their kernels."""
    from pathlib import Path

    import warpriver

    root = Path(warpriver.__file__).parent
    files = [*(root / "engine").glob("*.py"), *(root / "history").glob("*.py"), root / "network.py"]
    for path in files:
        text = path.read_text()
        for room in ("warpriver.meander", "warpriver.shortest_path", "warpriver.models"):
            assert f"import {room}" not in text and f"from {room}" not in text, f"{path.name} knows {room}"
