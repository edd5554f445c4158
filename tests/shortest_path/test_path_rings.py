"""Rings that meander by shortest paths: closed forms, routes against scipy, long runs, company, files."""

import numpy as np
import pytest
import reference_paths as twin
import reference_rings as rings
from crossings import crossings
from ring_shapes import assert_as_alone, circle, noisy_ring, ring_network
from scipy.optimize import brentq
from test_paths import SPACING, assert_same, prepare, reserve, take, taken

import warpriver as wr
from warpriver import PathMeander, RiverNetwork, Simulation, metrics
from warpriver.engine import state as engine

WIDTH = 60.0


def mean_radius(xy):
    return np.hypot(*(xy - xy.mean(axis=0)).T).mean()


# ---- the circle, the area


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize(("turn", "blur"), [(1.0, 1.5), (-1.0, 20.0)], ids=["left", "right"])
def test_a_circle_follows_the_closed_form_of_its_radius(turn, blur, dtype, device):
    """The blurred push is k w / R / (1 + (b w / R)^2) everywhere, and the smoothing takes nothing: (R^2 - R0^2) / 2 +
    (b w)^2 ln(R / R0) = k w t. A step goes by the rate at its beginning: R is off by 1e-5 of it here.
    """
    radius, params = 1000.0, PathMeander(time_step=0.05, spacing=25.0, blur_length=blur)
    sim = Simulation(ring_network(circle(251, radius, turn), 50.0, dtype=dtype), params, check=True, device=device)
    sim.run(steps=400, record_every=400)
    xy = sim.network.polylines()[0]
    found, reach = np.hypot(*(xy - xy.mean(axis=0)).T), blur * 50.0

    def missed(r):
        return 0.5 * (r**2 - radius**2) + reach**2 * np.log(r / radius) - params.displacement_rate * 50.0 * sim.time

    expected = brentq(missed, radius, 2.0 * radius)
    assert expected > 1020.0
    assert np.ptp(found) <= {"float64": 1e-4, "float32": 0.2}[dtype], "it stays a circle"
    assert found.mean() == pytest.approx(expected, rel={"float64": 1.5e-5, "float32": 1e-4}[dtype])
    assert np.hypot(*xy.mean(axis=0)) <= 0.05, "and where it is"


def test_smoothing_keeps_the_area_over_a_thousand_steps(device):
    """Within 1 %, while the bumps of a noisy ring go; diffusion alone would take 2 pi S k w a year, a fifth of it."""
    radius, years, strength = 1000.0, 58.0, 0.5
    params = PathMeander(spacing=25.0, time_step=years / 1000, smoothing=strength, blur_length=1e6)
    sim = Simulation(ring_network(noisy_ring(radius, 25.0, noise=15.0), WIDTH), params, device=device)
    before = sim.network.polylines()[0]
    sim.run(steps=1000, record_every=1000)
    after = sim.network.polylines()[0]
    taken = 2.0 * np.pi * strength * params.displacement_rate * WIDTH * years / rings.area(before)
    print(f"\narea {rings.area(after) / rings.area(before):.5f} of the start's; diffusion would take {taken:.2f} of it")
    assert taken > 0.18 and rings.area(after) == pytest.approx(rings.area(before), rel=1e-2)
    deviation = [np.std(np.hypot(*(xy - xy.mean(axis=0)).T)) for xy in (before, after)]
    assert deviation[1] < 0.5 * deviation[0], "it smooths"


def test_small_rings_do_not_die(device):
    """A ring of one width across grows like any other."""
    params = PathMeander(spacing=20.0, time_step=0.1)
    sim = Simulation(ring_network(circle(8, 0.5 * WIDTH), WIDTH), params, device=device)
    sim.run(steps=300, record_every=300)
    assert 0.5 * WIDTH < mean_radius(sim.network.polylines()[0]) < 10.0 * WIDTH


# ---- the route


@pytest.mark.parametrize("policy", ["longer", "marked"])
def test_200_noisy_rings_against_scipy(policy, device):
    """All rings of one network at once: the route is as short as that of a search on two laps, to 1e-12."""
    rng = np.random.default_rng(7)
    lines = []
    for k in range(200):
        count = int(rng.integers(40, 160))
        angle = 2.0 * np.pi * np.arange(count) / count
        radius = 1.0 + sum(rng.normal(0.0, 0.35) / m**0.5 * np.cos(m * angle + rng.uniform(0, 6)) for m in range(2, 9))
        xy = radius[:, None] * circle(count, 1.0) + rng.normal(0.0, 0.02, (count, 2))
        lines.append(xy * SPACING / rings.segments(xy).mean() + [3000.0 * (k % 20), 3000.0 * (k // 20)])
    params = PathMeander(search_radius=2.0, cutoff_min_arc=4.0, ring_policy=policy)
    state = prepare(lines, params, closed=True, device=device)
    reserve(state)
    take(state)
    found, longer = state.found, policy == "longer"
    assert state.inner.read_status()[0] == 0
    start, neck = state.network.starts(), state.cutter.point_neck.numpy()
    links = np.stack([a.numpy()[: found.count(state.inner)] for a in (found.link_from, found.link_to)], axis=1)
    most, with_shortcuts, taken = 0.0, 0, 0
    for k, (xy, first) in enumerate(zip(lines, start[:-1], strict=True)):
        n = len(xy)
        pairs = links[(links[:, 0] >= first) & (links[:, 0] < start[k + 1])] - first
        assert pairs.tolist() == twin.ring_shortcuts(xy, SPACING, 24.0, 48.0, 45.0).tolist()
        own = neck[first : first + n]
        kept = [(int(i), int(own[i] - first)) for i in np.flatnonzero(own >= 0)]
        if len(pairs) == 0:
            assert kept == []
            continue
        head = twin.ring_head(n, pairs, longer)
        edges, _ = twin.ring_edges(n, pairs, head, longer)
        length = twin.shortest_ring(xy, edges, head)
        most = max(most, abs(twin.ring_length(xy, kept) - length) / length)
        with_shortcuts, taken = with_shortcuts + 1, taken + len(kept)
    print(f"\n{policy}: {with_shortcuts} of 200 rings have shortcuts, {taken} are taken; lengths differ by {most:.1e}")
    assert with_shortcuts > 100 and taken > with_shortcuts and most <= 1e-12


@pytest.mark.parametrize("policy", ["longer", "marked"])
def test_the_same_route_every_time(policy, monkeypatch):
    """How points are dealt out, in slabs of any size or in chunks as on a GPU, changes nothing."""
    lines = [noisy_ring(150.0, SPACING, noise=12.0, seed=k, middle=(900.0 * k, 0.0)) for k in range(30)]
    params = PathMeander(search_radius=2.0, ring_policy=policy)
    results = []
    for slab, chunk in ((10**6, 0), (200, 0), (10**6, 4096), (10**6, 32), (10**6, 7)):
        monkeypatch.setattr(engine, "SLAB_POINTS", slab)
        monkeypatch.setattr(engine, "CPU_CHUNK", chunk)
        state = prepare(lines, params, closed=True, device="cpu")
        assert state.inner.whole.work.chunk == chunk
        reserve(state)
        take(state)
        results.append(taken(state))
    assert (results[0][0] >= 0).sum() > 20
    assert_same(results)


# ---- long runs


@pytest.mark.parametrize("policy", ["longer", "marked"])
def test_a_noisy_ring_meanders_for_two_thousand_steps(policy, device):
    """580 years: no NaN, no crossing that stays; where the longer part goes on, its mean radius stays within 0.75 and
    1.4 of the start's (0.92 and 1.22 are found). Its lakes are closed, simple loops.
    """
    shapely = pytest.importorskip("shapely")
    sim = Simulation(ring_network(noisy_ring()), PathMeander(spacing=40.0, ring_policy=policy), device=device)
    radii, sinuosities, crossed = [], [], []
    for _ in range(400):
        sim.run(steps=5, record_every=2000)
        xy = sim.network.polylines()[0]
        assert np.isfinite(xy).all()
        crossed.append(len(crossings(np.concatenate([xy, xy[:1]]))) > 0)
        radii.append(mean_radius(xy))
        sinuosities.append(metrics.sinuosity(xy, closed=True))
    lakes = sim.history.cutoffs
    print(f"\n{policy}: mean radius {min(radii):.0f} to {max(radii):.0f} m, sinuosity up to {max(sinuosities):.2f},")
    print(f"{len(lakes)} lakes, {sum(crossed)} of 400 states cross")
    assert not any(crossed)
    assert len(lakes) > 20 and max(sinuosities) > 2.0
    if policy == "longer":
        assert 0.75 * 3000.0 < min(radii) and max(radii) < 1.4 * 3000.0
    for lake in lakes:
        assert (lake.xy[0] == lake.xy[-1]).all() and shapely.LinearRing(lake.xy).is_simple


@pytest.mark.parametrize("policy", ["longer", "marked", "both"])
@pytest.mark.parametrize("shape", ["an eight", "twice round", "a band"])
def test_rings_that_cross_or_touch_themselves_come_apart(shape, policy, device):
    """At once, and for good; no policy leaves a point of them undefined."""
    angle = 2.0 * np.pi * np.arange(240) / 240
    xy = {
        "an eight": np.stack([1000.0 * np.sin(angle), 500.0 * np.sin(2.0 * angle)], axis=1),
        "twice round": (1000.0 + 40.0 * np.cos(angle))[:, None] * circle(120, 1.0)[np.arange(240) % 120],
        "a band": np.stack([2000.0 * np.cos(angle), 30.0 * np.sin(angle)], axis=1),
    }[shape]
    sim = Simulation(ring_network(xy, WIDTH), PathMeander(spacing=30.0, ring_policy=policy), check=True, device=device)
    for steps in (1, 1, 1, 47):
        sim.run(steps=steps)
        for ring in sim.network.polylines(close=True):
            assert len(crossings(ring)) == 0, (steps, len(ring))
    assert len(sim.history.cutoffs) + len(sim.history.splits) > 0


def test_both_parts_go_on(device):
    sim = Simulation(
        ring_network(noisy_ring()), PathMeander(spacing=40.0, ring_policy="both"), check=True, device=device
    )
    sim.run(steps=150)
    network, splits = sim.network, sim.history.splits
    assert network.channel_closed.all() and not sim.history.cutoffs
    assert network.channel_count == network.node_count == len(splits) + 1 > 20
    assert [s.other for s in splits] == network.channel_id[1:].tolist()
    assert np.isfinite(network.points()).all() and (np.diff(network.starts()) >= 8).all()


def test_the_marked_point_goes_on_wherever_necks_close(device):
    """It moves no farther than its own push takes it in each step."""
    xy = noisy_ring(radius=800.0)
    for mark in (0, 31, 64, 97):
        network = RiverNetwork.from_polylines([xy], WIDTH, closed=True, marks=mark)
        sim = Simulation(network, PathMeander(spacing=40.0, ring_policy="marked"), device=device)
        before = sim.network.polylines()[0][0]
        for _ in range(600):
            sim.step()
            here = sim.network.polylines()[0][0]
            assert np.hypot(*(here - before)) < 0.6 * WIDTH
            before = here
        assert len(sim.history.cutoffs) > 0


# ---- with lines, threads, histories


def test_open_and_closed_channels_in_one_run(device):
    """The lines do as they do alone, and so does the ring, whatever the threads."""
    lines = [wr.generate.noisy_line(6000.0, 40.0, 60.0, k) + [-3000.0, 5000.0 + 2500.0 * k] for k in range(2)]
    ring, origin, params = noisy_ring(radius=1500.0), np.zeros(2), PathMeander(spacing=40.0)
    mixed = RiverNetwork.from_polylines([lines[0], ring, lines[1]], WIDTH, closed=[False, True, False], origin=origin)
    both, threaded = (Simulation(mixed, params, threads=k, device=device) for k in (1, 2))
    alone = Simulation(RiverNetwork.from_polylines(lines, WIDTH, origin=origin), params, device=device)
    single = Simulation(ring_network(ring, origin=origin), params, device=device)
    assert_as_alone(both, alone, single, 400, device)
    threaded.run(steps=400)
    np.testing.assert_array_equal(both.network.points(), threaded.network.points())
    parts = both.network.polylines()
    ends = [parts[0][[0, -1]], parts[2][[0, -1]]]
    np.testing.assert_array_equal(ends, [line[[0, -1]] for line in lines])


@pytest.mark.parametrize("policy", ["longer", "both"])
def test_a_run_resumed_is_equal_to_the_bit(tmp_path, policy, device):
    params = PathMeander(spacing=40.0, ring_policy=policy)
    whole = Simulation(ring_network(noisy_ring()), params, device=device)
    whole.run(steps=160)
    half = Simulation(ring_network(noisy_ring()), params, device=device)
    half.run(steps=90, store=tmp_path / "run")
    rest = Simulation.resume(tmp_path / "run", device=device)
    rest.run(steps=70)
    np.testing.assert_array_equal(rest.network.points(), whole.network.points())
    for name in ("cutoffs", "splits"):
        found, expected = getattr(rest.history, name), getattr(whole.history, name)
        assert [e.xy.tobytes() for e in found] == [e.xy.tobytes() for e in expected]
    assert len(whole.history.cutoffs) + len(whole.history.splits) > 20


def test_a_step_may_smooth_by_taubins_passes(device):
    sims = [
        Simulation(ring_network(noisy_ring()), PathMeander(spacing=40.0, taubin_passes=n), device=device)
        for n in (0, 2)
    ]
    for sim in sims:
        sim.run(steps=20)
    rough, smooth = (np.abs(np.diff(metrics.curvature(s.network.polylines()[0], closed=True))).mean() for s in sims)
    assert smooth < 0.95 * rough
    with pytest.raises(ValueError, match="give a whole number"):
        PathMeander(taubin_passes=0.5)


def test_a_radius_beyond_the_length_of_a_ring_is_refused():
    with pytest.raises(ValueError, match="exceeds the length of channel 0"):
        Simulation(ring_network(circle(8, 30.0), 60.0), PathMeander(search_radius=4.0, spacing=10.0))
