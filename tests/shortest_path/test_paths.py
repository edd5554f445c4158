"""Meanders by shortest paths: routes against scipy, the cone, closed forms, long runs, each knob, bad input."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
import reference_paths as twin
import warp as wp
from crossings import crossings
from insides import shortcuts_of
from phases import any_step

import warpriver as wr
from warpriver.cli import main
from warpriver.engine import state as engine
from warpriver.kernels.status import CUT_POINTS_NEEDED, CUTS_NEEDED, FAULT
from warpriver.meander.resampling import Resample
from warpriver.shortest_path.push import Push, push_limits
from warpriver.shortest_path.route import TakeShortcuts

CURVES, SPACING, WIDTH = 200, 10.0, 12.0
# Sums of some hundred lengths, in another order.
SAME_LENGTH = 1e-12


def wandering_line(rng, count, curl=0.6):
    """A line whose heading wanders, so that it comes close to itself."""
    heading = np.cumsum(rng.normal(0.0, curl, count - 1))
    steps = SPACING * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)])


def prepare(lines, params, *, device, width=WIDTH, dtype="float64", spacing=SPACING, closed=False):
    """A network whose points stay as they are, and have moved, in the state of a step, and the phases of the solver."""
    network = wr.RiverNetwork.from_polylines(lines, width=width, dtype=dtype, closed=closed, device=device)
    even = np.full(len(lines), spacing)
    sampler = Resample()
    push, cutter = Push(), TakeShortcuts(params, sampler.arcs)
    state = engine.State(network, params.replace(spacing=spacing), None, (push, cutter, sampler), any_step)
    state.begin()
    state.allocate_points(network.point_count)
    wp.copy(state.point_moved, network.point_xy, count=network.point_count)
    state.assign(state.spacing, even)
    state.channel_substeps.fill_(1)
    state.assign(state.step, np.ones(len(lines)))
    state.begin_batch()
    return SimpleNamespace(network=network, inner=state, push=push, cutter=cutter, found=cutter.shortcuts)


def take(state):
    """Take the shortcuts of the points as they are."""
    state.inner.run(state.cutter.stages(state.inner))


def pushed_points(state, time_step):
    """Points after one push of so many years, (n, 2)."""
    inner = state.inner
    inner.params = inner.params.replace(time_step=time_step)
    inner.schedule(inner.substep)
    inner.run(state.push.stages(inner))
    return inner.point_moved.numpy() + state.network.origin


def cut(lines, params, **options):
    """Take the shortcuts of lines as they are: by channel, all pairs joined and the pairs on the shortest path."""
    state = prepare(lines, params, **options)
    found, inner = state.found, state.inner
    take(state)
    while (status := inner.read_status())[FAULT] != 0:
        # Where there is too little room, for shortcuts or for loops, nothing is cut.
        assert state.cutter.grow(inner, status)
        inner.begin_batch()
        take(state)
    count = found.count(inner)
    links = np.stack([found.link_from.numpy()[:count], found.link_to.numpy()[:count]], axis=1)
    start, neck = state.network.starts(), state.cutter.point_neck.numpy()
    by_channel, kept = [], []
    for first, stop in itertools.pairwise(start):
        own = (links[:, 0] >= first) & (links[:, 0] < stop)
        by_channel.append(links[own] - first)
        i = first + np.flatnonzero(neck[first:stop] >= 0)
        kept.append(np.stack([i, neck[i]], axis=1) - first)
    return by_channel, kept


def run(params, *, width=100.0, length=20_000.0, seed=0, steps=1000, line=None, **options):
    """A simulation from a noisy line, after so many steps."""
    if line is None:
        line = wr.generate.noisy_line(length, 50.0, 0.5 * width, seed)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=width), params, **options)
    sim.run(steps=steps, record_every=10)
    return sim


# ---- the path


@pytest.fixture(scope="module")
def curves():
    rng = np.random.default_rng(2026)
    return [wandering_line(rng, int(rng.integers(20, 400)), rng.uniform(0.2, 1.0)) for _ in range(CURVES)]


@pytest.mark.parametrize("cone", [45.0, 90.0])
def test_200_random_curves_against_scipy(curves, cone, device):
    """All channels of one network at once: same edges as comparing all pairs, and a route as short as Dijkstra's."""
    params = wr.PathMeander(search_radius=2.0, cutoff_min_arc=5.0, cone_angle=cone)
    links, kept = cut(curves, params, device=device)
    with_shortcuts, same, most = 0, 0, 0.0
    for xy, edges, shortcuts in zip(curves, links, kept, strict=True):
        all_pairs = twin.find_shortcuts(xy, SPACING, 2.0 * WIDTH, 5.0 * WIDTH, cone)
        assert edges.tolist() == all_pairs.tolist()
        length, route = twin.shortest_path(xy, edges)
        ours = [i for i in range(len(xy)) if not ((shortcuts[:, 0] < i) & (i < shortcuts[:, 1])).any()]
        measured = np.linalg.norm(np.diff(xy[ours], axis=0), axis=1).sum()
        most = max(most, abs(measured - length) / length)
        with_shortcuts += len(edges) > 0
        same += np.array_equal(ours, route)
    print(f"\ncone {cone:g}: {with_shortcuts} of {CURVES} curves have shortcuts; lengths differ by {most:.1e} at most;")
    print(f"{same} routes are the same, the others as short")
    assert with_shortcuts > 150 and most <= SAME_LENGTH


def taken(state):
    """What a search has left: the shortcuts taken, the points, the records of the cuts and the loops."""
    status, loops = state.inner.read_status(), state.cutter.loops
    assert status[FAULT] == 0
    cuts, points = status[CUTS_NEEDED], status[CUT_POINTS_NEEDED]
    necks, moved = state.cutter.point_neck.numpy(), state.inner.point_moved.numpy()
    return necks, moved, loops.cut.numpy()[:cuts], loops.oxbow_xy.numpy()[:points]


def reserve(state):
    """Make room for all shortcuts and loops that there can be."""
    state.found.reserve(state.inner, 100_000)
    state.cutter.loops.reserve(state.inner, state.network.point_count, 4 * state.network.point_count)


def assert_same(results):
    """All results are the first one, to the bit."""
    for result in results[1:]:
        for array, expected in zip(result, results[0], strict=True):
            np.testing.assert_array_equal(array, expected)


def test_the_same_route_every_time(curves, monkeypatch):
    """How points are dealt out, in slabs of any size or in chunks as on a GPU, changes nothing."""
    params = wr.PathMeander(search_radius=2.0)
    results = []
    for slab, chunk in ((10**6, 0), (5000, 0), (100, 0), (10**6, 4096), (10**6, 32), (10**6, 7), (10**6, 1)):
        monkeypatch.setattr(engine, "SLAB_POINTS", slab)
        monkeypatch.setattr(engine, "CPU_CHUNK", chunk)
        state = prepare(curves, params, device="cpu")
        inner = state.inner
        assert inner.whole.work.chunk == chunk
        assert len(inner.slabs) == (1 if slab == 10**6 else math.ceil(inner.point_capacity / slab))
        reserve(state)
        take(state)
        results.append(taken(state))
    assert (results[0][0] >= 0).sum() > 200
    assert_same(results)


def test_only_the_cone_keeps_strands_that_meet_at_an_angle_apart(device):
    """A line comes back to its own first reach at 80 degrees and stops short of it: near, but it does not run along."""
    out = np.stack([np.arange(0.0, 400.0, 10.0), np.zeros(40)], axis=1)
    turn = np.linspace(0.0, 1.5 * np.pi, 40)[1:]
    back = np.stack([390.0 + 120.0 * np.sin(turn), 120.0 - 120.0 * np.cos(turn)], axis=1)
    tip = back[-1] + np.outer(np.arange(1, 12), 10.0 * np.array([math.sin(0.17), -math.cos(0.17)]))
    xy = np.concatenate([out, back, tip])
    assert 5.0 < tip[-1, 1] < 1.5 * WIDTH, "the tip ends near the first reach"
    for cone, joined in ((45.0, False), (75.0, False), (85.0, True), (90.0, True)):
        links, kept = cut([xy], wr.PathMeander(cone_angle=cone), device=device)
        assert (len(links[0]) > 0) == joined and (len(kept[0]) > 0) == joined, cone


def test_strands_that_cross_are_joined_at_any_angle(device):
    """The same line, its tip drawn through the first reach: no channel can lie so."""
    out = np.stack([np.arange(0.0, 400.0, 10.0), np.zeros(40)], axis=1)
    turn = np.linspace(0.0, 1.5 * np.pi, 40)[1:]
    back = np.stack([390.0 + 120.0 * np.sin(turn), 120.0 - 120.0 * np.cos(turn)], axis=1)
    tip = back[-1] + np.outer(np.arange(1, 25), [0.3, -9.7])
    xy = np.concatenate([out, back, tip])
    assert len(crossings(xy)) == 1
    _, kept = cut([xy], wr.PathMeander(cone_angle=10.0), device=device)
    left = np.ones(len(xy), bool)
    for i, j in kept[0]:
        left[i + 1 : j] = False
    assert len(kept[0]) == 1 and len(crossings(xy[left])) == 0


# ---- small waves


def growth(params, wave, width, spacing, time_step, *, device):
    """Measured growth rate of a small sine, 1/yr, and its shift downstream, m/yr, over one step."""
    x = spacing * np.arange(round(20 * wave / spacing) + 1)
    q = 2.0 * np.pi / wave
    xy = np.stack([x, 1e-3 * np.sin(q * x)], axis=1)
    y = pushed_points(prepare([xy], params, width=width, spacing=spacing, device=device), time_step)[:, 1]
    inner = slice(len(x) // 2 - round(wave / spacing), len(x) // 2 + round(wave / spacing))
    basis = np.stack([np.sin(q * x), np.cos(q * x)], axis=1)[inner]
    a, b = np.linalg.lstsq(basis, y[inner], rcond=None)[0]
    return (math.hypot(a, b) / 1e-3 - 1.0) / time_step, -math.atan2(b, a) / q / time_step


def closed_growth(params, wave, width):
    q2 = (2.0 * np.pi / wave) ** 2
    blurred = 1.0 / (1.0 + (params.blur_length * width) ** 2 * q2)
    return params.displacement_rate * width * q2 * (blurred - params.smoothing)


@pytest.mark.parametrize("wave", [400.0, 700.0, 1100.0, 3000.0])
def test_growth_of_small_waves_meets_the_closed_form_with_second_order(wave, device):
    """k w q^2 (1 / (1 + (b w)^2 q^2) - S); a quarter of the error a halving. Small waves stay where they are."""
    params, width = wr.PathMeander(), 100.0
    exact, scale = closed_growth(params, wave, width), closed_growth(params, 1100.0, width)
    errors = []
    for spacing in (50.0, 25.0, 12.5):
        rate, celerity = growth(params, wave, width, spacing, 1e-4, device=device)
        errors.append(abs(rate - exact))
        assert abs(celerity) < 1e-3
    print(f"\nwave {wave:g} m: exact {exact:+.5f} /yr, errors {', '.join(f'{e:.1e}' for e in errors)}")
    assert errors[-1] < 0.04 * scale
    assert math.log2(errors[1] / errors[2]) > 1.6


def fastest_wave(params, width):
    return 2.0 * np.pi * params.blur_length * width / math.sqrt(1.0 / math.sqrt(params.smoothing) - 1.0)


def test_fastest_and_neutral_wave():
    params, width = wr.PathMeander(), 100.0
    b, s = params.blur_length * width, params.smoothing
    waves = np.linspace(300.0, 3000.0, 20_001)
    rates = closed_growth(params, waves, width)
    assert waves[rates.argmax()] == pytest.approx(fastest_wave(params, width), rel=1e-3)
    assert waves[np.flatnonzero(rates > 0)[0]] == pytest.approx(2 * np.pi * b / math.sqrt(1 / s - 1), rel=1e-3)


def test_long_steps_are_done_in_parts(device):
    params = wr.PathMeander(time_step=4.0)
    assert push_limits(100.0, 3.0, params) == pytest.approx((100.0 / 60.0, 1.125 * 100.0 / 60.0))
    assert push_limits(100.0, 3.0, params.replace(blur_length=1.0)) == pytest.approx((100.0 / 60.0, 50.0 / 60.0))
    assert np.isinf(push_limits(100.0, 3.0, params.replace(displacement_rate=0.0))).all()
    sim = run(params, steps=1, device=device)
    assert sim.substeps == 3 and sim.stable_dt == pytest.approx(100.0 / 60.0)


# ---- long runs


def test_5000_steps(device):
    """No NaN, no crossing, ends that do not move at all, statistics that settle, oxbows that are closed and simple."""
    shapely = pytest.importorskip("shapely")
    width, line = 50.0, wr.generate.noisy_line(10_000.0, 50.0, 25.0, 1)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=width), wr.PathMeander(), device=device)
    ends = sim.network.polylines()[0][[0, -1]]
    sinuosity, wavelength, crossed = [], [], 0
    for step in range(1, 5001):
        sim.step()
        if step % 5 == 0:
            xy = sim.network.polylines()[0]
            assert np.isfinite(xy).all() and (xy[[0, -1]] == ends).all()
            crossed += len(crossings(xy)) > 0
            sinuosity.append(wr.metrics.sinuosity(xy))
        if step % 50 == 0:
            wavelength.append(wr.metrics.wavelength(xy, width) / width)
    means = [np.mean(part) for part in np.split(np.array(sinuosity), 5)]
    waves = [np.mean(part) for part in np.split(np.array(wavelength), 5)]
    cutoffs = sim.history.cutoffs
    print(f"\n5,000 steps: sinuosity {', '.join(f'{m:.2f}' for m in means)} by thousands of steps, wavelength")
    print(f"{', '.join(f'{w:.2f}' for w in waves)} widths, {len(cutoffs)} cutoffs, {crossed} of 1,000 states cross")
    assert crossed == 0
    # Five hundred widths of channel wander by a tenth or so about their mean (measured 2.7 to 3.2).
    assert all(2.2 < m < 3.6 for m in means[1:]) and abs(means[4] / np.mean(means[1:4]) - 1.0) < 0.2
    # The waves that grow fastest measure 11.3 widths along the channel while they are small.
    assert all(8.5 < w < 12.0 for w in waves[1:]) and abs(waves[4] / np.mean(waves[1:4]) - 1.0) < 0.1
    assert len(cutoffs) > 500
    for c in cutoffs:
        assert (c.xy[0] == c.xy[-1]).all()
        ring = shapely.LinearRing(c.xy)
        assert ring.is_simple and ring.length >= 5.0 * width


def test_checked_phases_and_float32(device):
    """Every phase keeps its promise; in float32 the statistics stay those of float64 (chaos takes the points)."""
    line = wr.generate.noisy_line(20_000.0, 50.0, 50.0, 3)
    sims = []
    for dtype in ("float64", "float32"):
        sims.append(
            wr.Simulation(
                wr.RiverNetwork.from_polylines([line], width=100.0), wr.PathMeander(), dtype=dtype, device=device,
                check=dtype == "float32",
            )
        )  # fmt: skip
        sims[-1].run(steps=900, record_every=75)
    sinuous = [np.mean([wr.metrics.sinuosity(n.polylines()[0]) for n in s.history.networks[6:]]) for s in sims]
    assert sinuous[1] == pytest.approx(sinuous[0], rel=0.2) and len(sims[1].history.cutoffs) > 20


def test_room_for_shortcuts_grows(device):
    """Strands side by side from the start: more shortcuts than there is room for, taken at once."""
    legs = [
        np.stack([np.linspace(0.0, 2000.0, 101)[:: 1 if k % 2 == 0 else -1], np.full(101, 30.0 * k)], 1) for k in (0, 1)
    ]
    params = wr.PathMeander(spacing=20.0, search_radius=2.0, displacement_rate=0.0)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([np.concatenate(legs)], width=40.0), params, device=device)
    room = shortcuts_of(sim).capacity
    sim.step()
    assert shortcuts_of(sim).capacity > room
    # From the head across: the whole hairpin goes.
    assert len(sim.history.cutoffs) == 1 and sim.network.channel_lengths()[0] < 100.0


# ---- knobs


def test_rate_only_sets_the_clock(device):
    """Twice the rate and half the step is the same run, to the bit."""
    slow = run(wr.PathMeander(time_step=0.25), steps=600, device=device)
    fast = run(wr.PathMeander(time_step=0.125, displacement_rate=120.0), steps=600, device=device)
    assert (slow.network.points() == fast.network.points()).all() and len(slow.history.cutoffs) > 5


def test_everything_scales_with_the_width(device):
    """Twice as wide, long and coarse, at twice the rate, is the same river twice as large."""
    line = wr.generate.noisy_line(10_000.0, 32.0, 32.0, 2)
    small = run(wr.PathMeander(time_step=0.25, spacing=32.0), width=64.0, line=line, steps=600, device=device)
    large = run(
        wr.PathMeander(time_step=0.25, spacing=64.0, displacement_rate=120.0),
        width=128.0,
        line=2 * line,
        steps=600,
        device=device,
    )
    np.testing.assert_allclose(large.network.points(), 2.0 * small.network.points(), rtol=0.0, atol=1e-6)


def bend_length(sim, width=100.0):
    return np.mean([wr.metrics.wavelength(n.polylines()[0], width) for n in sim.history.networks[-30:]])


def test_each_knob_does_what_it_says(device):
    """Small sweeps of a grown river, 100 m wide."""
    table = {}
    for knob, values in (
        ("blur_length", (1.0, 1.5, 2.2)),
        ("smoothing", (0.15, 0.35, 0.5)),
        ("search_radius", (1.0, 1.5, 2.5)),
        ("downstream_share", (0.5, 0.9, 1.5)),
    ):
        for value in values:
            sim = run(wr.PathMeander(**{knob: value}), steps=2000, seed=4, device=device)
            necks = [np.hypot(*(c.xy[-1] - c.xy[-2])) for c in sim.history.cutoffs]
            table[knob, value] = bend_length(sim), np.mean(necks), len(necks)
    for (knob, value), (wave, neck, count) in table.items():
        print(f"{knob} {value}: wavelength {wave:.0f} m, necks cut at {neck:.0f} m, {count} cutoffs")
    waves = {key: row[0] for key, row in table.items()}
    assert waves["blur_length", 1.0] < waves["blur_length", 1.5] < waves["blur_length", 2.2]
    # Grown bends keep the wave that grew fastest while they were small (measured 0.80 to 1.03 of it).
    for knob in ("blur_length", "smoothing"):
        for value in (v for k, v in table if k == knob):
            assert waves[knob, value] == pytest.approx(fastest_wave(wr.PathMeander(**{knob: value}), 100.0), rel=0.25)
    assert waves["smoothing", 0.15] < waves["smoothing", 0.35] < waves["smoothing", 0.5]
    for radius in (1.0, 1.5, 2.5):
        # A neck is cut as soon as it is in reach; on points 50 m apart, up to two spacings before that.
        assert 100.0 * radius - 60.0 < table["search_radius", radius][1] <= 100.0 * radius
    # A share does not make the bends longer.
    assert waves["downstream_share", 0.5] == pytest.approx(waves["downstream_share", 1.5], rel=0.2)


def test_a_wider_cone_joins_more(curves, device):
    counts = [
        sum(len(p) for p in cut(curves, wr.PathMeander(cone_angle=c), device=device)[0]) for c in (10, 30, 60, 90)
    ]
    assert counts[0] < counts[1] < counts[2] < counts[3]


def pushed(xy, params, *, device):
    """Points after one push, (n, 2)."""
    return pushed_points(prepare([xy], params, width=100.0, spacing=25.0, device=device), 0.2)


def test_without_the_downstream_share_nothing_tells_the_flow(device):
    """Away from the ends a line pushed upside down moves as the line itself; with a share it does not."""
    line = wr.generate.kinoshita(1200.0, 1.2, 10, 25.0)
    for share, least, most in ((0.0, 0.0, 1e-9), (0.9, 1.0, math.inf)):
        params = wr.PathMeander(downstream_share=share)
        apart = np.abs(pushed(line, params, device=device) - pushed(line[::-1].copy(), params, device=device)[::-1])[
            250:-250
        ].max()
        assert least <= apart <= most


def test_the_downstream_share_carries_grown_bends_downstream(device):
    line = wr.generate.sine_generated(1200.0, 1.0, 10, 25.0)
    shifts = {}
    for share in (0.0, 0.9):
        params = wr.PathMeander(spacing=25.0, downstream_share=share, time_step=0.1)
        there = run(params, line=line, steps=100, device=device)
        apex = [
            np.median(wr.metrics.inflection_points(n.polylines()[0], 100.0).xy[:, 0]) for n in there.history.networks
        ]
        shifts[share] = (apex[-1] - apex[0]) / 10.0
    print(f"\nbends move by {shifts[0.9]:.1f} m a year, {shifts[0.0]:.2f} without the downstream share")
    assert abs(shifts[0.0]) < 0.5 and shifts[0.9] > 2.0


def test_steep_ground_holds_the_channel(device):
    ground = wr.generate.tilted_plain((200, 400), 30.0, 0.5, device=device)
    line = wr.generate.noisy_line(6_000.0, 50.0, 50.0, 0) + [1000.0, 3000.0]
    network = wr.RiverNetwork.from_polylines([line], width=100.0)
    sim = wr.Simulation(network, wr.PathMeander(), terrain=ground, device=device)
    before = sim.network.points()
    sim.run(steps=50)
    # A channel that cannot move at all rests: its points are not even sampled anew.
    np.testing.assert_array_equal(sim.network.points(), before)


# ---- in the company of the rest


def test_junctions_stay_and_channels_that_touch_are_joined(device):
    """Two tributaries and a trunk: nodes do not move at all; collisions are those of migration."""
    rng = np.random.default_rng(0)
    node = np.array([10_000.0, 0.0])
    lines = []
    for a, b in (([0.0, 3000.0], node), ([0.0, -3000.0], node), (node, [20_000.0, 0.0])):
        line = np.linspace(a, b, 200)
        line[1:-1] += rng.normal(0.0, 5.0, (198, 2))
        lines.append(line)
    network = wr.RiverNetwork.from_polylines(lines, width=[60.0, 60.0, 100.0])
    sim = wr.Simulation(network, wr.PathMeander(), device=device)
    history = sim.run(steps=150, record_every=50)
    assert len(history.collisions) == 0
    for net in history.networks:
        for xy, a, b in zip(net.polylines(), net.channel_from, net.channel_to, strict=True):
            assert (xy[0] == net.node_xy[a]).all() and (xy[-1] == net.node_xy[b]).all()
    history = sim.run(steps=2500, record_every=500)
    assert len(history.collisions) > 0 and len(history.cutoffs) > 100


def test_a_run_goes_on_to_the_bit_from_disk(tmp_path, device):
    whole = run(wr.PathMeander(search_radius=1.4), steps=700, device=device)
    line = wr.generate.noisy_line(20_000.0, 50.0, 50.0, 0)
    part = wr.Simulation(
        wr.RiverNetwork.from_polylines([line], width=100.0), wr.PathMeander(search_radius=1.4), device=device
    )
    part.run(steps=500, record_every=100, store=tmp_path / "run")
    again = wr.Simulation.resume(tmp_path / "run", device=device)
    assert again.params == wr.PathMeander(search_radius=1.4)
    again.run(steps=200)
    assert (again.network.points() == whole.network.points()).all()
    assert len(again.history.cutoffs) == len(whole.history.cutoffs) > 10
    assert all((a.xy == b.xy).all() for a, b in zip(again.history.cutoffs, whole.history.cutoffs, strict=True))


def test_command_line(tmp_path, capsys):
    line = wr.generate.noisy_line(9_000.0, 30.0, 60.0, 4)
    wr.io.write_network(wr.RiverNetwork.from_polylines([line], width=60.0), tmp_path / "river.csv")
    begin = ["simulate", str(tmp_path / "river.csv"), "--solver", "path", "--years", "60", "--no-progress"]
    knobs = "--displacement-rate 80 --downstream-share 0.5 --blur-length 1.4 --smoothing 0.3 --search-radius 1.3"
    knobs += " --cone-angle 30 --spacing 40"
    assert main([*begin, *knobs.split(), "-o", str(tmp_path / "out")]) == 0
    params = wr.history.History.load(tmp_path / "out" / "run").params
    assert params == wr.PathMeander(
        displacement_rate=80, downstream_share=0.5, blur_length=1.4, smoothing=0.3, search_radius=1.3, cone_angle=30,
        spacing=40, time_step=params.time_step,
    )  # fmt: skip
    assert (tmp_path / "out" / "belt.png").stat().st_size > 0
    capsys.readouterr()
    for more, words in (
        (["--friction", "0.01"], "--friction means nothing to --solver path"),
        (["--cone-angle", "95"], "--cone-angle is 95"),
        (["--search-radius", "200", "--cutoff-min-arc", "300"], "exceeds the length of channel 0"),
    ):
        assert main([*begin, *more, "-o", str(tmp_path / "bad")]) == 2
        said = capsys.readouterr().err
        assert words in said and said.count("\n") == 1, said


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"search_radius": 0.0}, "search_radius"),
        ({"search_radius": -1.0}, "search_radius"),
        ({"search_radius": 5.0}, "a straight line would be cut"),
        ({"cone_angle": 0.0}, "cone_angle"),
        ({"cone_angle": 90.5}, "cone_angle"),
        ({"cone_angle": math.nan}, "cone_angle"),
        ({"smoothing": 0.0}, "smoothing"),
        ({"blur_length": 0.1}, "blur_length"),
        ({"downstream_share": 2.5}, "downstream_share"),
        ({"displacement_rate": -1.0}, "displacement_rate"),
    ],
)
def test_a_value_out_of_range_is_named(change, word):
    with pytest.raises(ValueError, match=word):
        wr.PathMeander(**change)


def test_a_radius_beyond_the_length_and_strange_params_are_refused():
    network = wr.RiverNetwork.from_polylines([[[0.0, 0.0], [150.0, 0.0], [300.0, 0.0]]], width=100.0)
    with pytest.raises(ValueError, match="exceeds the length of channel 0"):
        wr.Simulation(network, wr.PathMeander(search_radius=4.0))
    with pytest.raises(ValueError, match="MeanderParams, a PathMeander or None"):
        wr.Simulation(network, {"search_radius": 1.0})
    with pytest.raises(TypeError, match="upstream_memory"):
        wr.PathMeander(upstream_memory="stem")
