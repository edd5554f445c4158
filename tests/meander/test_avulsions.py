"""Crevasses and avulsions: how often banks break, which new courses there are, and what a run knows of them."""

import copy
import dataclasses
import math

import models
import numpy as np
import pytest
from insides import phase_of
from models import assert_same
from plain import plain_params

from warpriver import (
    MeanderParams,
    PathMeander,
    RiverNetwork,
    Simulation,
    Terrain,
    edits,
    generate,
    metrics,
    write_terrain,
)
from warpriver.history import Avulsion, History
from warpriver.kernels.status import CREVASSES
from warpriver.meander.avulsions import Avulse, NewCourse, plan_course
from warpriver.meander.courses import Refusal
from warpriver.meander.diversions import Diversion
from warpriver.params import AvulsionParams

WIDTH = 50.0


def grown(seed=1, length=30_000.0, width=WIDTH):
    """A river that has meandered for 87 yr."""
    sim = Simulation(
        RiverNetwork.from_polylines([generate.noisy_line(length, width, width, seed)], width), plain_params()
    )
    sim.step(300)
    return sim.network


@pytest.fixture(scope="module")
def meandering():
    return grown()


def count_crevasses(network, spacing, steps, rate):
    """Crevasses of a river that stands still, over so many steps; and how many its bends are expected to have."""
    params = AvulsionParams(crevasse_rate=rate, avulsion_probability=0.0)
    sim = Simulation(network, plain_params(spacing=spacing, migration_rate=0.0, avulsions=params))
    state, phase = sim.stepper.state, phase_of(sim, Avulse)
    total = 0
    for step in range(steps):
        state.begin_batch(begun=step)
        state.run(phase.stages(state))
        total += state.read_status()[CREVASSES]
    bend = phase.point_bend.numpy()[: sim.network.point_count]
    edges = np.flatnonzero(np.diff(np.sign(bend)) != 0.0) + 1
    length = np.array([len(r) for r in np.split(bend, edges) if np.abs(r).max() > params.crevasse_curvature])
    chance = 1.0 - np.exp(-1e-3 * rate * length * state.spacing.numpy()[0] * sim.params.time_step)
    return total, steps * chance.sum(), math.sqrt(steps * (chance * (1.0 - chance)).sum())


def test_banks_break_at_their_hazard_whatever_the_spacing(meandering):
    found = []
    for spacing in (50.0, 25.0, 12.5):
        total, expected, spread = count_crevasses(meandering, spacing, 3000, 0.8)
        assert abs(total - expected) < 3.0 * spread
        found.append(total)
    # Some 13,000 each, with a deviation of 1 %.
    assert min(found) > 10_000 and max(found) < 1.05 * min(found)


def test_by_default_there_is_one_avulsion_for_a_hundred_kilometres_and_years(meandering):
    _, expected, _ = count_crevasses(meandering, 50.0, 1, AvulsionParams().crevasse_rate)
    length, years = meandering.channel_lengths().sum(), plain_params().time_step
    per_100_km_and_yr = AvulsionParams().avulsion_probability * expected * (1e5 / length) * (100.0 / years)
    # Of the bends of a grown river nearly all are tight enough.
    assert 0.85 < per_100_km_and_yr <= 1.0


def test_as_printed_the_number_grows_with_the_points():
    """[Paris2023] as printed: tens of crevasses a step on 300 widths; twice the points break twice as often."""
    network, counts = grown(length=300.0 * WIDTH), []
    for spacing in (50.0, 25.0):
        params = MeanderParams.paper(events=True).replace(
            spacing=spacing, migration_rate=0.0, avulsions=AvulsionParams(crevasse_rule="point", avulsion_probability=0)
        )
        sim = Simulation(network, params)
        sim.step(100)
        counts.append(len(sim.history.crevasses) / 100)
    assert 5.0 < counts[0] < 74.0 and counts[1] == pytest.approx(2.0 * counts[0], rel=0.15)


# ---- runs


@pytest.mark.parametrize("kind", [plain_params, PathMeander])
def test_channels_leave_their_courses(kind):
    """Every avulsion begins and ends on what it leaves; the run shows the new course, and keeps the old one."""
    network = models.many_channels(8)
    options = {"crevasse_rate": 3.0, "avulsion_probability": 0.5}
    sim = Simulation(network, kind(spacing=25.0, avulsions=AvulsionParams(**options)), check=True)
    sim.run(steps=60, record_every=1)
    history = sim.history
    crevasses, gone = list(history.crevasses), list(history.avulsions)
    assert sum(e.outcome == "avulsion" for e in crevasses) == len(gone) > 5
    assert sum(e.outcome == "" for e in crevasses) > 20
    assert all(abs(e.curvature) > 0.1 for e in crevasses)
    for event in gone:
        assert event.bed.shape == (0,)
        np.testing.assert_allclose(event.xy[[0, -1]], event.course[[0, -1]], atol=1e-6)
        record = int(np.searchsorted(history.times, event.time - 1e-9))
        after = history.networks[record]
        line = after.polylines()[int(np.flatnonzero(after.channel_id == event.channel)[0])]
        middle = event.course[len(event.course) // 2]
        assert np.hypot(*(line - middle).T).min() < 30.0
    table = history.to_geopandas("abandoned") if _has("geopandas") else None
    if table is not None:
        assert (table["case"] == "avulsion").sum() == len(gone)


def _has(module):
    import importlib.util

    return importlib.util.find_spec(module) is not None


def leaving(**options):
    """Rivers over ground that falls to the east, of which many leave their courses."""
    network = models.many_channels(6)
    west, south, east, north = network.bounds()
    x = np.arange(west - 1000.0, east + 1000.0, 20.0)
    height = (
        50.0
        - 5e-4 * (x - west)
        + np.random.default_rng(3).normal(0.0, 0.15, (int((north - south + 2000.0) / 20.0), len(x)))
    )
    terrain = options.pop("terrain", None) or Terrain(height, 20.0, (west - 1000.0, north + 1000.0))
    params = AvulsionParams(crevasse_rate=2.0, avulsion_probability=0.5, **options.pop("constants", {}))
    return Simulation(network, plain_params(spacing=25.0, avulsions=params), terrain=terrain, **options)


def test_new_beds_fall_at_every_step():
    sim = leaving()
    before = sim.terrain.to_numpy()
    sim.step(50)
    gone = sim.history.avulsions
    assert len(gone) > 5
    cut = 0
    for event in gone:
        step = np.hypot(*np.diff(event.course, axis=0).T)
        assert (np.diff(event.bed) <= -1e-4 * step * (1.0 - 1e-9)).all()
        cut += len(event.bed)
    after = sim.terrain.to_numpy()
    assert (after <= before).all() and (after < before).sum() > cut


def test_refused_ones_leave_all_as_it_was():
    """Walls across the plain: what breaks is the same as where nothing ever leaves, and so is all else, to the bit."""
    network = models.many_channels(6)
    west, south, east, north = network.bounds()
    x = np.arange(west - 1000.0, east + 1000.0, 10.0)
    # Steps of 10 m every 200 m, so low in between that no slope holds the channels up.
    height = np.broadcast_to(30.0 * (np.floor(x / 60.0) % 2), (int((north - south + 2000.0) / 10.0), len(x)))
    terrain = Terrain(height, 10.0, (west - 1000.0, north + 1000.0))
    sims = []
    for probability in (0.0, 0.5):
        avulsions = AvulsionParams(crevasse_rate=3.0, avulsion_probability=probability, steepest_rise=0.01)
        params = plain_params(spacing=25.0, slope_threshold=50.0, avulsions=avulsions)
        sims.append(Simulation(network, params, terrain=terrain))
        sims[-1].step(40)
    assert not sims[1].history.avulsions
    reasons = {e.outcome for e in sims[1].history.crevasses} - {""}
    assert "the ground rises by more than 0.01 m/m" in reasons
    assert sum(e.outcome != "" for e in sims[1].history.crevasses) > 20
    np.testing.assert_array_equal(terrain.to_numpy(), height)
    for event in [e for sim in sims for e in sim.history.crevasses]:
        object.__setattr__(event, "outcome", "")
    assert_same(*sims)
    assert sims[0].history.crevasses == sims[1].history.crevasses


def test_a_run_with_avulsions_goes_on_to_the_same_bits(tmp_path):
    """Over the ground as it was carved, and over that of before, which is carved again."""
    sim = leaving()
    write_terrain(sim.terrain, tmp_path / "dem.npz")
    fresh = sim.terrain.copy()
    sim.run(steps=30, record_every=10)
    assert len(sim.history.avulsions) > 4
    sim.history.save(tmp_path / "run.npz")
    loaded = History.load(tmp_path / "run.npz")
    assert list(loaded.events) == list(sim.history.events)
    copies = [
        Simulation.resume(loaded, terrain=sim.terrain.copy()),
        Simulation.resume(History.load(tmp_path / "run.npz"), terrain=fresh),
        copy.deepcopy(sim),
    ]
    for each in (sim, *copies):
        each.step(12)
    for each in copies:
        assert_same(sim, each)
        np.testing.assert_array_equal(sim.terrain.to_numpy(), each.terrain.to_numpy())
    with pytest.raises(ValueError, match="is not the one that the run has had"):
        Simulation.resume(History.load(tmp_path / "run.npz"), terrain=Terrain(np.zeros((9, 9)), 1000.0))


def test_a_run_over_a_file_finds_it_and_carves_it_again(tmp_path):
    from warpriver import read_terrain

    write_terrain(leaving().terrain, tmp_path / "dem.npz")
    sim = leaving(terrain=read_terrain(tmp_path / "dem.npz"))
    sim.run(steps=20, record_every=10)
    again = Simulation.resume(sim.history)
    np.testing.assert_array_equal(again.terrain.to_numpy(), sim.terrain.to_numpy())


def test_what_happens_depends_on_the_seed_alone():
    sims = [leaving(threads=1), leaving(threads=2), leaving(capture=False), leaving(seed=1)]
    for sim, every in zip(sims, (1, 7, 30, 30), strict=True):
        sim.run(steps=30, record_every=every)
    for sim in sims[1:3]:
        assert_same(sims[0], sim)
        assert sim.history.avulsions == sims[0].history.avulsions
    assert sims[3].history.crevasses != sims[0].history.crevasses


# ---- courses that meet others


def plan(lines, at, target, angle=0.0, terrain=None, widths=WIDTH, **constants):
    """A course of the first line, from one point of it to another, by place."""
    network = RiverNetwork.from_polylines(lines, widths)
    sim = Simulation(network, plain_params(avulsions=AvulsionParams(jitter=0.0, **constants)), terrain=terrain)
    xy = sim.network.polylines()[0]
    points = [int(np.hypot(*(xy - place).T).argmin()) for place in (at, target)]
    params = sim.params.avulsions
    found = plan_course(
        sim.stepper.state, 0, points[0], params, np.random.default_rng(0), target=points[1], angle=math.radians(angle)
    )
    return found, xy


def bow(height, first, last, apex):
    """A straight line from west to east with a triangular bow between two places."""
    corners = np.array([[0.0, 0.0], [first, 0.0], [apex, height], [last, 0.0], [10_000.0, 0.0]])
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    at = np.arange(0.0, s[-1], 50.0)
    return np.column_stack([np.interp(at, s, corners[:, k]) for k in range(2)])


def test_a_course_that_meets_nothing_ends_at_its_target():
    found, xy = plan([bow(1500.0, 3000.0, 5000.0, 4000.0)], (2500.0, 0.0), (6000.0, 0.0), angle=-30.0)
    assert isinstance(found, NewCourse)
    np.testing.assert_allclose(found.course.xy[[0, -1]], xy[[found.first, found.last]], atol=1e-9)
    np.testing.assert_array_equal(found.old_xy[[0, -1]], xy[[found.first, found.last]])
    turn = math.degrees(math.atan2(*(found.course.xy[1] - found.course.xy[0])[::-1]))
    assert turn == pytest.approx(-30.0, abs=1e-6)
    assert metrics.sinuosity(found.course.xy) < metrics.sinuosity(found.old_xy)


def test_a_course_ends_where_it_meets_the_reach_below():
    """A loop below the target lies in its way."""
    line = np.concatenate([bow(900.0, 6000.0, 8000.0, 3500.0)])
    found, xy = plan([line], (1000.0, 0.0), (5900.0, 0.0), angle=32.0)
    assert isinstance(found, NewCourse)
    target = int(np.hypot(*(xy - (5900.0, 0.0)).T).argmin())
    assert found.last > target + 20
    np.testing.assert_allclose(found.course.xy[-1], xy[found.last], atol=1e-9)
    assert np.hypot(*(found.course.xy[-1] - found.course.xy[-2])) <= WIDTH


def test_a_course_across_the_reach_above_or_another_channel_is_refused():
    # The bow above hangs over the way.
    above = bow(900.0, 1000.0, 3000.0, 6500.0)
    found, _ = plan([above], (3100.0, 0.0), (9000.0, 0.0), angle=25.0)
    assert isinstance(found, Refusal) and found.reason == "it meets its own course upstream"
    other = np.column_stack([np.linspace(4000.0, 4000.0, 60), np.linspace(300.0, 3000.0, 60)])
    found, _ = plan([bow(10.0, 3000.0, 5000.0, 4000.0), other], (1000.0, 0.0), (9000.0, 0.0), angle=30.0)
    assert isinstance(found, Refusal) and found.reason == "it meets channel 1"
    assert found.xy[0] == pytest.approx(4000.0, abs=80.0)
    found, _ = plan([bow(10.0, 3000.0, 5000.0, 4000.0), other], (1000.0, 0.0), (9000.0, 0.0), angle=-30.0)
    assert isinstance(found, NewCourse)


def test_by_option_a_course_that_meets_another_channel_ends_there():
    """And the river joins it: the rest of the old course falls dry. Its own tributaries are met by none."""
    other = np.column_stack([np.linspace(4000.0, 4000.0, 60), np.linspace(300.0, 3000.0, 60)])
    lines = [bow(10.0, 3000.0, 5000.0, 4000.0), other]
    found, _ = plan(lines, (1000.0, 0.0), (9000.0, 0.0), angle=30.0, meeting="join")
    assert isinstance(found, Diversion) and found.end >= 0
    assert found.course.xy[-1][0] == pytest.approx(4000.0, abs=1.0)
    sim = Simulation(RiverNetwork.from_polylines(lines, WIDTH), plain_params(avulsions=AvulsionParams(meeting="join")))
    sim.apply(edits.AvulseChannel(0, 1000.0, to=9000.0, angle=30.0))
    assert sim.network.channel_count == 3 and sim.history.avulsions[0].xy[-1][0] > 9_900.0
    assert np.bincount(sim.network.channel_to).max() == 2
    joined = sim.network.points()
    sim.undo()
    assert sim.network.channel_count == 2
    sim.redo()
    np.testing.assert_array_equal(sim.network.points(), joined)
    brook = np.column_stack([np.linspace(4000.0, 500.0, 60), np.linspace(2500.0, 0.0, 60)])
    whole = bow(10.0, 3000.0, 5000.0, 4000.0)
    found, _ = plan([whole[10:], whole[:11], brook], (1500.0, 0.0), (9000.0, 0.0), angle=45.0, meeting="join")
    assert isinstance(found, (NewCourse, Refusal))


def test_a_cut_that_is_too_deep_is_refused_and_so_is_the_rim_of_the_map():
    x = np.arange(-1000.0, 11_000.0, 50.0)
    gentle = np.broadcast_to(np.maximum(0.0, 30.0 - 0.02 * np.abs(x - 4000.0)), (120, len(x)))
    terrain = Terrain(gentle, 50.0, (-1000.0, 3000.0))
    line = bow(10.0, 3000.0, 5000.0, 4000.0)
    found, _ = plan([line], (1000.0, 0.0), (7000.0, 0.0), terrain=terrain)
    assert isinstance(found, Refusal) and found.reason == "the cut would be deeper than 2 depths"
    found, _ = plan([line], (1000.0, 0.0), (7000.0, 0.0), terrain=terrain, deepest_cut=100.0)
    assert isinstance(found, NewCourse) and found.course.deepest_cut > 29.0
    small = terrain.crop((-1000.0, -600.0, 11_000.0, 600.0))
    found, _ = plan([line], (1000.0, 0.0), (9000.0, 0.0), angle=45.0, terrain=small, deepest_cut=100.0)
    assert isinstance(found, Refusal) and found.reason == "there is no ground"


def test_constants_out_of_range_are_refused():
    for wrong, message in (
        ({"farthest": 5.0}, "below nearest"),
        ({"crevasse_rule": "here"}, "use one of 'bend', 'point'"),
        ({"crevasse_rate": -1.0}, "crevasse_rate is -1"),
    ):
        with pytest.raises(ValueError, match=message):
            AvulsionParams(**wrong)
    with pytest.raises(ValueError, match=r"MeanderParams.avulsions is 3; give AvulsionParams\(...\) or None"):
        plain_params(avulsions=3)
    assert plain_params(avulsions={"jitter": 1.0}).avulsions == AvulsionParams(jitter=1.0)
    assert Avulsion.kind == "avulsion"


# ---- by hand


def by_hand():
    """A river over ground, the place where it shall leave, and where it shall come back."""
    line = bow(1500.0, 3000.0, 5000.0, 4000.0)
    x = np.arange(-1000.0, 11_000.0, 40.0)
    height = np.broadcast_to(30.0 - 1e-3 * x + 0.2 * np.sin(x / 90.0), (130, len(x)))
    sim = Simulation(
        RiverNetwork.from_polylines([line], WIDTH), plain_params(), terrain=Terrain(height, 40.0, (-1000.0, 3000.0))
    )
    sim.step(5)
    return sim, edits.AvulseChannel(0, (2500.0, 0.0), to=(6000.0, 0.0), angle=20.0)


def test_a_channel_leaves_by_hand_and_that_is_taken_back():
    """To the bit, the ground as well; done again it is the same."""
    sim, edit = by_hand()
    before, ground = sim.network.points().copy(), sim.terrain.to_numpy()
    sim.apply(edit)
    (event,) = sim.history.avulsions
    after, carved = sim.network.points().copy(), sim.terrain.to_numpy()
    assert metrics.sinuosity(after) < metrics.sinuosity(before) - 0.1 and (carved < ground).sum() > 50
    assert np.hypot(*(after - event.course[len(event.course) // 2]).T).min() < 26.0
    assert sim.undo() == edit and not sim.history.avulsions
    np.testing.assert_array_equal(sim.network.points(), before)
    np.testing.assert_array_equal(sim.terrain.to_numpy(), ground)
    sim.redo()
    np.testing.assert_array_equal(sim.network.points(), after)
    np.testing.assert_array_equal(sim.terrain.to_numpy(), carved)
    sim.step(10)


def test_a_session_with_avulsions_by_hand_is_done_again(tmp_path):
    sim, edit = by_hand()
    start = by_hand()[0]
    ground = start.terrain.copy()
    sim.apply(edit)
    sim.run(steps=10, record_every=5)
    sim.apply(edits.AvulseChannel(0, 1500.0))
    sim.run(steps=5, record_every=5)
    again = Simulation.replay(start, sim.history)
    assert_same(sim, again)
    assert sim.history.avulsions == again.history.avulsions and len(again.history.avulsions) == 2
    sim.history.save(tmp_path / "run.npz")
    for terrain in (ground, sim.terrain):
        resumed = Simulation.resume(History.load(tmp_path / "run.npz"), terrain=terrain.copy())
        np.testing.assert_array_equal(resumed.terrain.to_numpy(), sim.terrain.to_numpy())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"to": (1000.0, 0.0)}, "to does not lie downstream of at"),
        ({"at": 20.0}, "to leave its course keep 2 spacings away"),
        ({"channel": 4}, "there is no channel 4"),
        ({"angle": 120.0}, "angle is 120 degrees"),
        ({"to": (9900.0, 0.0), "angle": 90.0}, "channel 0 finds no course: there is no ground"),
    ],
)
def test_what_cannot_be_done_by_hand_is_refused(change, message):
    sim, edit = by_hand()
    before, ground, events = sim.network.points().copy(), sim.terrain.to_numpy(), len(sim.history.events)
    with pytest.raises(ValueError, match=message):
        sim.apply(dataclasses.replace(edit, **change))
    np.testing.assert_array_equal(sim.network.points(), before)
    np.testing.assert_array_equal(sim.terrain.to_numpy(), ground)
    assert len(sim.history.events) == events
