"""Locked points and through nodes while a river moves: what is held, what is refused, and what a node changes."""

import functools

import numpy as np
import pytest
from edited import SOLVERS, bends, bits, river
from plain import plain_params

from warpriver import RiverNetwork, Simulation, edits, generate
from warpriver.engine import state as engine_state
from warpriver.engine.substeps import begin_substep
from warpriver.history import HeldLock, History

# Rounding of a displacement of metres at coordinates of kilometres, m.
ROUNDING = 1e-9
# Gaps between even samples, in parts of the mean; but where a neck has just been cut, which is 1 in 50 at most.
EVEN, CUT = 0.06, 0.02


def locked_points(sim):
    """Places of the locked points, in the order of their channels."""
    network = sim.network
    return network.node_xy[network.channel_to[network.channel_joint == 2]]


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_lock_holds_over_a_thousand_steps_with_cutoffs_beside_it(solver, device):
    sim = river(length=20_000.0, params=SOLVERS[solver], device=device)
    sim.run(steps=20)
    line = sim.network.polylines()[0]
    sim.lock(0, 6_000.0)
    sim.lock(0, tuple(line[250]))
    places = locked_points(sim).copy()
    assert len(places) == 2 and any((line[250] == place).all() for place in places)
    for _ in range(20):
        sim.step(50)
        assert np.abs(locked_points(sim) - places).max() <= 1e-9
        for xy in sim.network.polylines():
            gaps = np.hypot(*np.diff(xy, axis=0).T)
            uneven = np.abs(gaps / gaps.mean() - 1.0) > EVEN
            assert uneven.mean() < CUT, "samples are even between locked points"
    # The river itself goes through them, not the nodes alone.
    for place in places:
        ends = [xy[k] for xy in sim.network.polylines() for k in (0, -1)]
        assert sum((end == place).all() for end in ends) == 2
    around = [min(np.hypot(*(cut.xy - place).T).min() for place in places) for cut in sim.history.cutoffs]
    assert len(around) > 10 and min(around) < 1_000.0
    # It is one river for its author.
    assert sim.network.channel_count == 3
    sim.unlock(0, tuple(places[0]))
    sim.unlock(0, tuple(places[1]))
    assert sim.network.channel_id.tolist() == [0] and sim.network.channel_joint.tolist() == [0]
    sim.step(5)
    assert np.hypot(*(sim.network.points() - places[0]).T).min() > 1e-6, "what was unlocked moves"


def test_the_push_from_upstream_fades_to_nothing_towards_a_lock():
    """What it moves a point by is what it would at a through node, times the smoothstep that the ends have, too."""
    moved = {}
    for kind in (edits.SplitChannel, edits.LockPoint):
        sim = bends(1, weight=0.0)
        sim.run(steps=5)
        sim.apply(kind(0, 6_000.0))
        state = sim.stepper.state
        state.begin_batch()
        state.run([*begin_substep(state), *sim.stepper.phases[0].stages(state)])
        count = sim.network.point_count
        moved[kind] = state.point_moved.numpy()[:count] - sim.network.point_xy.numpy()[:count]
    free, held = (np.split(each, sim.network.starts()[1:-1]) for each in moved.values())
    reach = sim.params.end_damping * 60.0
    spacing = sim.stepper.state.spacing.numpy()[:2]
    for c, (plain, slowed) in enumerate(zip(free, held, strict=True)):
        # The lower part keeps the place of the channel, and begins at the lock; the upper one ends there.
        along = np.arange(len(plain)) * spacing[c]
        away = along if c == 0 else along[-1] - along
        t = np.minimum(away / reach, 1.0)
        # Where the channel's own end is nearer, both fade alike.
        own = (along[-1] - along if c == 0 else along) >= reach
        weight = (t * t * (3.0 - 2.0 * t))[:, None]
        np.testing.assert_allclose(slowed[own], (plain * weight)[own], atol=ROUNDING)
        at_lock = 0 if c == 0 else -1
        assert np.abs(plain[5 if c == 0 else -6]).max() > 0.1 and (slowed[at_lock] == 0.0).all()


def neck(params=plain_params, gap=40.0, radius=450.0, device="cpu"):
    """A river with a round loop, whose ends at (0, 0) are as close as a neck."""
    half = np.pi - np.arcsin(0.5 * gap / radius)
    turn = np.linspace(half, -half, int(radius / 4.0)) + 0.5 * np.pi
    loop = radius * np.stack([-np.cos(turn), np.sin(turn)], axis=1) + [0.0, radius]
    first, last = loop[0], loop[-1]
    left = np.stack([np.linspace(-4_000.0, first[0], 80), np.linspace(-100.0, first[1], 80) - 10.0], axis=1)[:-2]
    right = np.stack([np.linspace(last[0], 4_000.0, 80), np.linspace(last[1], -100.0, 80) - 10.0], axis=1)[2:]
    network = RiverNetwork.from_polylines([np.concatenate([left, loop, right])], width=60.0)
    return Simulation(network, params(spacing=25.0), device=device)


@pytest.mark.parametrize(("solver", "radius"), [("migration", 450.0), ("migration", 85.0), ("paths", 450.0)])
def test_a_neck_across_a_through_node_is_a_cutoff(solver, radius):
    """Also one so near to the node that channels which meet at a junction would not touch there."""
    sim, whole = neck(SOLVERS[solver], radius=radius), neck(SOLVERS[solver], radius=radius)
    sim.apply(edits.SplitChannel(0, (0.0, 2.0 * radius), width_above=60.0))
    for each in (sim, whole):
        each.step(3)
    assert not sim.history.collisions and len(sim.history.cutoffs) == len(whole.history.cutoffs) == 1
    loops = [np.hypot(*np.diff(each.history.cutoffs[0].xy, axis=0).T).sum() for each in (sim, whole)]
    assert loops[0] == pytest.approx(loops[1], rel=0.1) and loops[0] > 5.0 * radius
    # Two channels still, with a node at the neck.
    assert sim.network.channel_count == 2 and sorted(sim.network.channel_joint.tolist()) == [0, 1]
    assert sim.network.channel_lengths().sum() == pytest.approx(whole.network.channel_lengths()[0], rel=0.01)
    node = sim.network.node_xy[sim.network.channel_to[sim.network.channel_joint == 1][0]]
    assert np.abs(node).max() < 200.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_also_where_channels_do_not_join(solver):
    """A brook that crosses the river is left alone."""
    sim = neck(functools.partial(SOLVERS[solver], collision_distance=0.0))
    sim.apply(edits.SplitChannel(0, (0.0, 900.0)))
    sim.apply(edits.AddChannel([(-2_000.0, -900.0), (-2_100.0, 900.0)], width=20.0))
    sim.step(3)
    assert not sim.history.collisions and len(sim.history.cutoffs) == 1
    assert sim.network.channel_count == 3 and sorted(sim.network.channel_joint.tolist()) == [0, 0, 1]


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_cutoff_that_would_drop_a_lock_is_refused_and_told_once(solver, tmp_path, device):
    sim = neck(SOLVERS[solver], device=device)
    sim.lock(0, (0.0, 900.0))
    place = locked_points(sim)[0].copy()
    sim.run(steps=10, store=tmp_path / "run")
    assert not sim.history.collisions and not sim.history.cutoffs
    (held,) = sim.history.events.of(HeldLock)
    assert held.case == "cutoff" and {held.channel, held.other} == {0, 1} and (held.x, held.y) == tuple(place)
    np.testing.assert_array_equal(locked_points(sim)[0], place)
    again = Simulation.resume(History.load(tmp_path / "run"), device=device)
    for each in (sim, again):
        each.step(10)
    assert bits(again) == bits(sim) and len(again.history.events.of(HeldLock)) == 1
    # Unlocked, it is a neck like any other.
    sim.unlock(0, tuple(place))
    sim.step(2)
    assert len(sim.history.cutoffs) == 1 and sim.network.channel_count == 1


def test_a_tributary_that_touches_does_not_take_a_lock_away(device):
    """A larger river would capture what lies above the lock, and what is below it would fall dry."""
    x = np.linspace(0.0, 6_000.0, 121)
    large = np.stack([x, np.zeros(121)], axis=1)
    small = np.stack([x, 600.0 - 560.0 * np.exp(-(((x - 2_000.0) / 500.0) ** 2))], axis=1)
    network = RiverNetwork.from_polylines([large, small], width=[80.0, 50.0])
    free, held = (Simulation(network, plain_params(spacing=40.0), device=device) for _ in range(2))
    held.lock(1, 4_000.0)
    place = locked_points(held)[0].copy()
    for sim in (free, held):
        sim.step(3)
    assert len(free.history.collisions) == 1 and free.history.collisions[0].channel == 1
    assert not held.history.collisions
    (told,) = held.history.events.of(HeldLock)
    assert told.case == "disconnected" and told.other == 0
    np.testing.assert_array_equal(locked_points(held)[0], place)


def locked_river(threads=1):
    sim = river(length=20_000.0, threads=threads)
    sim.lock(0, 6_000.0)
    sim.apply(edits.SplitChannel(0, 9_000.0, width_above=66.0))
    sim.lock(0, 4_000.0)
    sim.step(300)
    return sim


def test_locks_are_the_same_to_the_bit_on_any_number_of_threads_and_in_a_gpu_s_layout(monkeypatch):
    expected = bits(locked_river())
    for threads in (2, 4):
        assert bits(locked_river(threads)) == expected
    monkeypatch.setattr(engine_state, "CPU_CHUNK", 32)
    assert bits(locked_river()) == expected


def test_a_locked_point_is_moved_with_both_sides():
    sim = river()
    sim.lock(0, 6_000.0)
    place = locked_points(sim)[0]
    to = place + [40.0, -70.0]
    sim.apply(edits.MovePoint(0, tuple(place), tuple(to), 600.0))
    np.testing.assert_allclose(locked_points(sim)[0], to, atol=1e-9)
    place = locked_points(sim)[0].copy()
    sim.step(50)
    np.testing.assert_array_equal(locked_points(sim)[0], place)


def test_junctions_wander_but_locks_do_not(device):
    x = np.linspace(0.0, 6_000.0, 121)
    main = np.stack([x, 40.0 * np.sin(x / 300.0)], axis=1)
    side = np.stack([np.linspace(2_000.0, x[50], 60), np.linspace(3_000.0, main[50, 1], 60)], axis=1)
    network = RiverNetwork.from_polylines([main[:51], main[50:], side], width=[50.0, 60.0, 30.0])
    for memory in ("stem", "channel"):
        params = plain_params(spacing=30.0, junction_drift=0.5, upstream_memory=memory)
        sim = Simulation(network, params, device=device)
        sim.lock(1, 1_500.0)
        place, junction = locked_points(sim)[0].copy(), sim.network.node_xy[network.channel_to[0]].copy()
        sim.step(40)
        np.testing.assert_array_equal(locked_points(sim)[0], place)
        ends = sim.network.polylines()[2][-1]
        assert np.hypot(*(ends - junction)) > 1.0


def test_a_river_has_no_corner_at_a_lock():
    """After 60 years in which its bends went on it turns there no more than twice as sharply as its sharpest bends."""
    line = generate.noisy_line(12_000.0, 30.0, 60.0, 0)
    params = plain_params(spacing=30.0, sinuosity_scaling="whole")
    sim = Simulation(RiverNetwork.from_polylines([line], width=60.0), params, device="cpu")
    sim.run(years=80.0, record_every=10_000)
    length = sim.network.channel_lengths()[0]
    for part in (0.35, 0.5, 0.65):
        sim.lock(0, part * length)
    sim.run(years=60.0, record_every=10_000)
    network, lines = sim.network, sim.network.polylines()
    corners = []
    for c in np.flatnonzero(network.channel_joint):
        below = int(np.flatnonzero(network.channel_from == network.channel_to[c])[0])
        corners.append(turns(np.concatenate([lines[c][-2:], lines[below][1:2]]))[0])
    sharpest = max(np.quantile(turns(xy), 0.99) for xy in lines)
    # Measured 0.4 and 0.3 rad; it was 1.9 where the river straightened towards the lock.
    assert len(corners) == 3 and max(corners) < 2.0 * sharpest, (corners, sharpest)


def turns(xy):
    """Angles by which a line turns at its inner points, rad."""
    step = np.diff(xy, axis=0)
    a, b = step[:-1], step[1:]
    return np.abs(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1)))
