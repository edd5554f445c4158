"""Runs that go on: over their own ground, with what was changed told, and never otherwise in silence."""

import json
import pickle

import numpy as np
import pytest
import warp as wp
from models import many_channels, tree
from plain import plain_params

import warpriver as wr
from warpriver import History, PathMeander, RiverNetwork, Simulation, Terrain, generate
from warpriver.engine.phase import Phase
from warpriver.engine.stages import Stage, launch
from warpriver.errors import InputError
from warpriver.history import Ground, GroundChange, ParameterChange


def river(width=60.0, **options):
    return RiverNetwork.from_polylines([generate.noisy_line(6_000.0, 50.0, 60.0, 3)], width=width, **options)


def bank(steepness=0.3):
    """Ground that is level in the south and steep in the north, under the river."""
    rows, columns = 60, 160
    north = 1500.0 - (np.arange(rows) + 0.5) * 50.0
    height = 100.0 + np.broadcast_to(np.maximum(north, 0.0)[:, None] * steepness, (rows, columns))
    return Terrain(height - 0.01 * np.arange(columns), 50.0, (-1000.0, 1500.0))


@pytest.fixture
def ground_file(tmp_path):
    wr.write_terrain(bank(), tmp_path / "ground.npz")
    return tmp_path / "ground.npz"


def points(run):
    return np.concatenate([network.points() for network in run.networks])


# ---- the ground


def test_a_run_finds_its_ground_again(ground_file, tmp_path, device):
    """From its file, to the bits of a run without a stop; on a plain it is another river."""
    whole = Simulation(river(), plain_params(), terrain=wr.read_terrain(ground_file), device=device).run(years=60)
    Simulation(river(), plain_params(), terrain=wr.read_terrain(ground_file), device=device).run(
        years=30, store=tmp_path / "run"
    )
    again = Simulation.resume(tmp_path / "run", device=device)
    assert again.terrain is not None and again.history.ground.path == str(ground_file)
    again.run(steps=whole.steps[-1] - again.step_count)
    np.testing.assert_array_equal(whole.networks[-1].points(), again.network.points())
    plain = Simulation(river(), plain_params(), device=device).run(years=60)
    assert plain.networks[-1].point_count != whole.networks[-1].point_count


def test_a_terrain_is_read_as_it_was_read_before(tmp_path, device):
    """With the arguments that were given; they are kept in the run."""
    rng = np.random.default_rng(4)
    steps = (np.cumsum(rng.uniform(0.0, 3.0, (60, 160)), axis=0)[::-1] / 0.3048).round()
    steps[5, 5] = -5.0
    np.save(tmp_path / "feet.npy", steps)
    told = {"cell_size": 50.0, "origin": np.array([-1000.0, 1500.0]), "z_factor": 0.3048, "nodata": -5.0}
    terrain = wr.read_terrain(tmp_path / "feet.npy", **told)
    Simulation(river(), plain_params(), terrain=terrain, device=device).run(steps=5, store=tmp_path / "run")
    header = json.loads((tmp_path / "run" / "run.json").read_text())["ground"]
    assert header["options"] == {**told, "origin": [-1000.0, 1500.0]}
    again = Simulation.resume(tmp_path / "run", device=device)
    np.testing.assert_array_equal(again.terrain.to_numpy(), terrain.to_numpy())
    assert again.terrain.origin == (-1000.0, 1500.0)


def test_the_terrain_of_a_run_may_be_given(ground_file, tmp_path, device):
    """It is known by its heights and place, not by its name."""
    Simulation(river(), plain_params(), terrain=bank(), device=device).run(years=10, store=tmp_path / "run")
    again = Simulation.resume(tmp_path / "run", terrain=wr.read_terrain(ground_file), device=device)
    again.run(years=10)
    assert len(again.history.events.of(GroundChange)) == 0


def moved(by):
    return Terrain(bank().to_numpy(), 50.0, (-1000.0 + by, 1500.0))


@pytest.mark.parametrize(
    ("terrain", "words"),
    [
        (None, "comes from no file"),
        (lambda: bank(0.2), "is not the one that the run has had \\(160 x 60 cells of 50 m\\)"),
        (lambda: moved(50.0), "is not the one"),
        (lambda: bank().resampled(25.0), "is not the one"),
    ],
)
def test_other_ground_is_refused(terrain, words, tmp_path, device):
    Simulation(river(), plain_params(), terrain=bank(), device=device).run(steps=3, store=tmp_path / "run")
    before = (tmp_path / "run" / "segments.jsonl").read_bytes()
    with pytest.raises(InputError, match=words):
        Simulation.resume(tmp_path / "run", terrain=terrain and terrain(), device=device)
    assert (tmp_path / "run" / "segments.jsonl").read_bytes() == before


@pytest.mark.parametrize("fate", ["removed", "changed", "no terrain any more"])
def test_a_file_that_is_not_what_it_was_is_told(fate, ground_file, tmp_path, device):
    Simulation(river(), plain_params(), terrain=wr.read_terrain(ground_file), device=device).run(
        steps=3, store=tmp_path / "run"
    )
    if fate == "changed":
        wr.write_terrain(bank(0.31), ground_file)
    else:
        ground_file.unlink()
        if fate != "removed":
            ground_file.write_text("words")
    with pytest.raises(InputError, match=r"ground\.npz, which (cannot be read|has changed since).*terrain=") as told:
        Simulation.resume(tmp_path / "run", device=device)
    assert "\n" not in str(told.value)
    again = Simulation.resume(tmp_path / "run", terrain=bank(), device=device)
    assert again.terrain is not None


def test_a_run_on_a_plain_takes_no_terrain_unless_that_is_wanted(tmp_path, device):
    Simulation(river(), plain_params(), device=device).run(years=5, store=tmp_path / "run")
    with pytest.raises(InputError, match="it lies on a plain"):
        Simulation.resume(tmp_path / "run", terrain=bank(), device=device)
    changed = Simulation.resume(tmp_path / "run", terrain=bank(), change_terrain=True, device=device)
    changed.run(years=5)
    (event,) = wr.read_history(tmp_path / "run").events.of(GroundChange)
    assert event.time == pytest.approx(5.0, abs=0.3) and event.ground == Ground.of(bank())
    again = Simulation.resume(tmp_path / "run", terrain=bank(), device=device)
    np.testing.assert_array_equal(again.network.points(), changed.network.points())
    plain = Simulation.resume(tmp_path / "run", change_terrain=True, device=device)
    assert plain.terrain is None and plain.history.last_ground is None


def test_an_edit_of_the_ground_is_an_event(tmp_path, device):
    """Between two runs, or by a callback: from then on the run needs the edited ground."""
    sim = Simulation(river(), plain_params(), terrain=bank(), device=device)
    sim.run(steps=10, store=tmp_path / "run")
    sim.terrain.brush("raise", (2000.0, 100.0), 400.0, 30.0)
    sim.run(steps=10)
    # Called after the record of a step: what it does after the last one is noted by the next run.
    sim.run(steps=10, callbacks=[lambda s: s.terrain.brush("raise", (2000.0, -100.0), 400.0, 1.0)])
    sim.run(steps=10)
    changes = wr.read_history(tmp_path / "run").events.of(GroundChange)
    p = sim.params.time_step
    assert [event.time for event in changes] == pytest.approx([10 * p, 30 * p, 30 * p])
    for stale in (None, bank()):
        with pytest.raises(InputError, match=r"was edited during the run|is not the one"):
            Simulation.resume(tmp_path / "run", terrain=stale, device=device)
    again = Simulation.resume(tmp_path / "run", terrain=sim.terrain.copy(), device=device)
    sim.step(20)
    again.step(20)
    np.testing.assert_array_equal(sim.network.points(), again.network.points())


def test_an_edited_terrain_from_a_file_is_not_read_again(ground_file, tmp_path, device):
    sim = Simulation(river(), plain_params(), terrain=wr.read_terrain(ground_file), device=device)
    sim.terrain.brush("raise", (2000.0, 100.0), 400.0, 30.0)
    sim.run(steps=10, store=tmp_path / "run")
    with pytest.raises(InputError, match="was edited during the run"):
        Simulation.resume(tmp_path / "run", device=device)


def test_a_pickled_simulation_knows_its_ground(device):
    """Also one that was brushed before it was pickled and before the history knew."""
    sim = Simulation(river(), plain_params(), terrain=bank(), device=device)
    sim.run(steps=5)
    sim.terrain.brush("raise", (2000.0, 100.0), 400.0, 30.0)
    copy = pickle.loads(pickle.dumps(sim))
    assert copy.history.ground == sim.history.ground == Ground.of(bank())
    for each in (sim, copy):
        each.run(steps=5)
    assert list(copy.history.events) == list(sim.history.events)
    assert len(copy.history.events.of(GroundChange)) == 1
    np.testing.assert_array_equal(sim.network.points(), copy.network.points())


def test_the_digest_is_of_heights_and_place():
    land = bank()
    assert land.digest() == bank().digest() == land.copy().digest() == pickle.loads(pickle.dumps(land)).digest()
    zeros, minus = np.zeros((3, 3)), np.zeros((3, 3))
    minus[1, 1] = -0.0
    assert Terrain(zeros, 1.0).digest() == Terrain(minus, 1.0).digest()
    odd = np.full((3, 3), 2.0)
    odd[0, 0] = np.float64(np.frombuffer(np.uint64(0x7FF8000000000123).tobytes())[0])  # NaN of other bits
    usual = np.full((3, 3), 2.0)
    usual[0, 0] = np.nan
    assert Terrain(odd, 1.0).digest() == Terrain(usual, 1.0).digest()
    others = [Terrain(zeros, 2.0), Terrain(zeros, 1.0, (1.0, 0.0)), Terrain(zeros + 1e-300, 1.0), Terrain(odd, 1.0)]
    others.append(Terrain(np.zeros((1 + 1, 9 - 4)), 1.0))
    assert len({other.digest() for other in [Terrain(zeros, 1.0), *others]}) == 6


def test_files_of_terrains_are_noted_and_kept_by_copies(ground_file):
    terrain = wr.read_terrain(str(ground_file), nodata=-7.0)
    assert terrain.file.path == str(ground_file) and dict(terrain.file.options) == {"nodata": -7.0}
    assert terrain.copy().file == terrain.to("cpu").file == pickle.loads(pickle.dumps(terrain)).file == terrain.file
    assert bank().file is None and terrain.resampled(100.0).file is None


def test_a_simulation_on_another_device_has_a_terrain_of_its_own(device):
    """On the same device it is shared, as the docstring says."""
    land = bank()
    sim = Simulation(river(), plain_params(), terrain=land, device=device)
    assert (sim.terrain is land) == (wp.get_device(device) == land.device)
    assert sim.terrain.device == wp.get_device(device)


# ---- constants


@pytest.mark.parametrize(
    "changed",
    [
        {"migration_rate": 15.0},
        {"friction": 0.02, "upstream_weight": 2.0},
        {"spacing": 20.0},
        {"spacing_in_widths": 0.4},
        {"taubin_passes": 3},
        {"cutoff_distance": 0.0},
        {"sinuosity_scaling": "whole"},
    ],
    ids=lambda changed: ",".join(changed),
)
def test_changed_constants_are_taken_and_told(changed, tmp_path, device):
    first = Simulation(river(), plain_params(), device=device)
    first.run(steps=20, store=tmp_path / "run")
    params = first.params.replace(**changed)
    again = Simulation.resume(tmp_path / "run", params=params, device=device)
    assert again.params == params and again.history.params == plain_params()
    again.run(steps=20)
    loaded = wr.read_history(tmp_path / "run")
    assert loaded.params == plain_params() and loaded.last_params == params
    events = loaded.events.of(ParameterChange)
    assert {event.name: json.loads(event.after) for event in events} == changed
    assert {event.time for event in events} == {20 * params.time_step}
    third = Simulation.resume(tmp_path / "run", device=device)
    assert third.params == params
    np.testing.assert_array_equal(third.network.points(), again.network.points())
    for sim in (third, again):
        sim.step(10)
    np.testing.assert_array_equal(third.network.points(), again.network.points())
    if "spacing" in "".join(changed):
        gap = np.hypot(*np.diff(again.network.polylines()[0], axis=0).T)
        assert gap.max() < 1.1 * min(params.spacing, 24.0)


def test_unchanged_constants_are_no_event(tmp_path, device):
    whole = Simulation(river(), plain_params(), device=device).run(steps=40)
    Simulation(river(), plain_params(), device=device).run(steps=20, store=tmp_path / "run")
    again = Simulation.resume(tmp_path / "run", params=plain_params(), device=device)
    again.run(steps=20)
    assert len(again.history.events.of(ParameterChange)) == 0
    np.testing.assert_array_equal(whole.networks[-1].points(), again.network.points())


def test_a_change_before_a_record_that_never_came_has_not_happened(tmp_path, device):
    """A run that is killed right after it was resumed goes on from its last record with the constants of that."""
    Simulation(river(), plain_params(), device=device).run(steps=20, store=tmp_path / "run")
    lost = Simulation.resume(tmp_path / "run", params=plain_params(migration_rate=5.0), device=device)
    lost.step(3)
    lost.history.flush()
    again = Simulation.resume(tmp_path / "run", device=device)
    assert again.params == plain_params() and again.step_count == 20


@pytest.mark.parametrize(
    ("params", "words"),
    [
        (PathMeander(), "goes by MeanderParams and cannot go on by PathMeander"),
        (plain_params(time_step=1.0), "time_step is 1 yr"),
        (plain_params(collision_distance=0.0, cutoff_distance=0.0), "add or remove collide"),
        (plain_params(spacing=500.0, spacing_in_widths=0.0), "coarser than channel 0 is wide"),
    ],
    ids=["solver", "time step", "collisions", "spacing"],
)
def test_changes_that_a_run_cannot_make_are_refused(params, words, tmp_path, device):
    Simulation(river(), plain_params(), device=device).run(steps=2, store=tmp_path / "run")
    with pytest.raises(InputError, match=words):
        Simulation.resume(tmp_path / "run", params=params, device=device)


def test_a_history_in_memory_is_left_as_it_was_when_resuming_is_refused(device):
    sim = tree()
    sim.run(steps=60)
    sim.step(40)
    count = len(sim.history.events)
    with pytest.raises(InputError):
        Simulation.resume(sim.history, params=PathMeander(), device=device)
    assert len(sim.history.events) == count


def test_constants_and_columns_of_a_simulation_are_read_only(device):
    sim = Simulation(many_channels(3), plain_params(spacing=25.0), device=device)
    with pytest.raises(AttributeError, match=r"read-only; go on with others by Simulation.resume"):
        sim.params = plain_params(migration_rate=1.0)
    for name in ("history", "seed", "network", "terrain", "time", "step_count", "threads", "check", "stepper"):
        with pytest.raises(AttributeError):
            setattr(sim, name, None)
    for name in ("channel_width", "channel_depth", "channel_id", "channel_from", "node_xy"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(sim.network, name)[0] = 1


# ---- the seed


@wp.kernel(enable_backward=False)
def shake_points(seed: int, start: wp.array[int], step: wp.array[wp.float64], point_io: wp.array[wp.vec2d]):
    """Move the second point of each channel by chance."""
    channel = wp.tid()
    state = wp.rand_init(seed, channel)
    if step[channel] > wp.float64(0.0):
        way = wp.vec2d(wp.float64(wp.randf(state)), wp.float64(wp.randf(state)))
        point_io[start[channel] + 1] = point_io[start[channel] + 1] + way


class Shake(Phase):
    """A process that draws random numbers."""

    name = "shake"

    def stages(self, state):
        inputs = [state.seed, state.start, state.step]
        count = state.network.channel_count
        run = lambda _: launch(shake_points, count, inputs, [state.point_moved], state.device)  # noqa: E731
        return [Stage(self.name, run, shared=False)]


def test_the_seed_is_that_of_phases_that_draw(tmp_path, device):
    """The same numbers for the same seed, also in a run that goes on; those of the models draw none."""
    runs = [
        Simulation(river(), plain_params(), seed=seed, phases=[Shake()], device=device).run(steps=6)
        for seed in (1, 1, 2)
    ]
    same, again, other = (run.networks[-1].points() for run in runs)
    np.testing.assert_array_equal(same, again)
    assert np.abs(same - other).max() > 1e-3
    half = Simulation(river(), plain_params(), seed=np.int64(2), phases=[Shake()], device=device)
    half.run(steps=3, store=tmp_path / "run")
    rest = Simulation.resume(tmp_path / "run", phases=[Shake()], device=device)
    assert rest.seed == 2
    rest.step(3)
    np.testing.assert_array_equal(rest.network.points(), other)
    with pytest.raises(InputError, match="seed is -1"):
        Simulation(river(), plain_params(), seed=-1, device=device)


# ---- where a history is


def test_the_path_of_a_run_is_no_history(tmp_path, device):
    Simulation(river(), plain_params(), device=device).run(steps=2, store=tmp_path / "run")
    for path in (tmp_path / "run", str(tmp_path / "run")):
        with pytest.raises(TypeError, match=r"would be empty; read a stored run with read_history"):
            History(path)
    assert len(wr.read_history(tmp_path / "run")) == 2
