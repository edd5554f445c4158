"""Rings: channels that are closed, moved, split and smoothed as a whole, held against closed forms and conservation."""

import numpy as np
import pytest
import reference_rings as twin
from plain import plain_params
from ring_shapes import assert_as_alone, circle, noisy_ring, ring_network

import warpriver as wr
from warpriver import PathMeander, RiverNetwork, Simulation, metrics
from warpriver.meander import taubin_smooth


def smoothed(xy, passes, *, device, **options):
    """A ring after so many pairs of passes on a device."""
    return taubin_smooth(ring_network(xy, device=device), passes, **options).polylines()[0]


def dumbbell(neck=30.0, spacing=20.0, left=200.0, right=300.0):
    """Two circles joined by a neck of two parallel banks, ``neck`` apart: closed, about evenly spaced."""
    half = 0.5 * neck
    parts = []
    for radius, middle, begin in ((right, 0.0, np.pi), (left, -(left + right + 60.0), 0.0)):
        gap = np.arcsin(half / radius)
        n = round((2.0 * np.pi - 2.0 * gap) * radius / spacing)
        angle = begin + np.linspace(gap, 2.0 * np.pi - gap, n)
        parts.append(np.stack([middle + radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    return np.concatenate(parts)


# ---- the circle


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize(
    ("turn", "gamma", "scaling"),
    [(1.0, 2.5, "upstream"), (-1.0, 2.5, "whole"), (1.0, 1.0, "none"), (-1.0, 0.4, "none")],
)
def test_a_circle_follows_the_closed_form_of_its_radius(turn, gamma, scaling, dtype, device):
    """C = 1/R everywhere, so that its upstream mean is 1/R too: dR/dt = k w (omega + gamma) / R,
    R^2 = R0^2 + 2 k w (omega + gamma) t. It grows for gamma > 1, stays for 1, shrinks below, and stays round.

    A step goes by the rate at its beginning: R is off by (R - R0) dt |dR/dt| / R at most, 2e-5 of R here.
    """
    radius, width, k = 1000.0, 50.0, 60.0
    params = plain_params(time_step=0.05, spacing=25.0, migration_rate=k, upstream_weight=gamma,
                           sinuosity_scaling=scaling)  # fmt: skip
    sim = Simulation(ring_network(circle(251, radius, turn), width, dtype=dtype), params, check=True, device=device)
    sim.run(steps=400, record_every=400)
    xy = sim.network.polylines()[0]
    found = np.hypot(*(xy - xy.mean(axis=0)).T)
    expected = np.sqrt(radius**2 + 2.0 * k * width * (gamma - 1.0) * sim.time)
    assert np.ptp(found) <= {"float64": 1e-4, "float32": 0.2}[dtype], "it stays a circle"
    assert found.mean() == pytest.approx(expected, rel={"float64": 2e-5, "float32": 1e-4}[dtype])
    assert np.hypot(*xy.mean(axis=0)) <= 0.05, "and where it is"
    # Step by step, R' = R + dt k w (omega + gamma) / R, without the error of the step. What is left is the sinuosity of
    # the polygon, whose area is short of the circle's: 1 + (pi / n)^2 / 6, where sinuosity slows the rate.
    stepped = radius
    for _ in range(400):
        stepped += params.time_step * k * width * (gamma - 1.0) / stepped
    if dtype == "float64":
        assert found.mean() == pytest.approx(stepped, rel=1e-7 if scaling == "none" else 3e-6)


@pytest.mark.parametrize("gamma", [0.0, 2.5])
def test_the_error_of_the_circle_is_that_of_the_step(gamma, device):
    """It halves with the time step, first order, whether the circle grows or shrinks."""
    errors = []
    for parts in (1, 2, 4):
        # So fine that the step alone counts: the implicit share of the local term takes (8/9 D dt - h^2 / 4) / R^2.
        params = plain_params(time_step=0.4 / parts, spacing=2.5, upstream_weight=gamma)
        sim = Simulation(ring_network(circle(2513, 1000.0), 50.0), params, device=device)
        sim.run(steps=50 * parts, record_every=1000)
        found = np.hypot(*sim.network.polylines()[0].T).mean()
        errors.append(found - np.sqrt(1000.0**2 + 2.0 * 60.0 * 50.0 * (gamma - 1.0) * 20.0))
    assert np.diff(np.log2(np.abs(errors))) == pytest.approx(-1.0, abs=0.05)


# ---- a long run


@pytest.mark.parametrize("policy", ["longer", "marked"])
def test_a_noisy_ring_meanders_for_two_thousand_steps(policy, device):
    """580 years: it grows bends and splits; where the longer part goes on, its mean radius stays within 0.6 and 1.35 of
    the start's (0.75 and 1.02 are found); what it loses goes with the loops. The marked part may be a small one.
    """
    sim = Simulation(
        ring_network(noisy_ring()), plain_params(spacing=40.0, ring_policy=policy), check=False, device=device
    )
    means, sizes = [], []

    def note(now):
        xy = now.network.polylines()[0]
        means.append(np.hypot(*(xy - xy.mean(axis=0)).T).mean())
        sizes.append((metrics.sinuosity(xy, closed=True), now.network.channel_lengths()[0]))

    sim.run(steps=2000, record_every=2000, callbacks=[(wr.history.Every(steps=100), note)])
    assert len(sim.history.cutoffs) > 10 and np.isfinite(sim.network.points()).all()
    assert max(s for s, _ in sizes) > 2.0, "it meanders"
    if policy == "longer":
        assert 0.6 * 3000.0 < min(means) and max(means) < 1.35 * 3000.0
    step = np.hypot(*np.diff(sim.network.polylines(close=True)[0], axis=0).T)
    assert step.max() < 2.0 * 40.0
    lake = sim.history.cutoffs[0].xy
    assert np.hypot(*(lake[-1] - lake[0])) < 60.0 < metrics.oxbow_lengths([lake])[0]


# ---- splits


@pytest.mark.parametrize("shift", [0, 17, 40, 71])
@pytest.mark.parametrize("policy", ["longer", "marked", "both"])
@pytest.mark.parametrize("kind", [plain_params, PathMeander])
def test_a_split_conserves_points_and_length(kind, policy, shift, device):
    """The parts together are as long as the ring was and twice the neck, to a spacing each, wherever it begins."""
    xy = np.roll(dumbbell(), shift, axis=0)
    params = kind(spacing=20.0, time_step=1e-6, ring_policy=policy, cutoff_min_arc=3.0)
    if kind is PathMeander:
        params = params.replace(search_radius=1.0)
    sim = Simulation(ring_network(xy, width=40.0), params, check=True, device=device)
    before, points = sim.network.channel_lengths()[0], sim.network.point_count
    mark = sim.network.polylines()[0][0]
    sim.step()
    after = sim.network.channel_lengths()
    if policy == "both":
        assert sim.network.channel_count == 2 and not sim.history.cutoffs
        (split,) = sim.history.splits
        assert (split.channel, split.other, split.width, split.time) == (0, 1, 40.0, sim.time)
        assert np.hypot(*(split.xy[-1] - split.xy[0])) < 40.0, "from one bank of the neck to the other"
        assert np.hypot(*(split.xy - sim.network.polylines()[1][0]).T).min() < 1.0, "the line of the new ring"
        assert sim.network.channel_closed.all() and sim.network.channel_id.tolist() == [0, 1]
        parts, counts = after, np.diff(sim.network.starts())
        assert (sim.network.channel_from == sim.network.channel_to).all() and sim.network.node_count == 2
    else:
        (cutoff,) = sim.history.cutoffs
        assert sim.network.channel_count == 1 and cutoff.channel == 0
        lake = cutoff.xy[:-1] if kind is PathMeander else cutoff.xy
        parts = np.array([after[0], twin.segments(lake).sum()])
        counts = [sim.network.point_count, len(lake)]
        if policy == "longer":
            assert parts[0] > parts[1]
        else:
            kept = sim.network.polylines()[0]
            assert np.hypot(*(kept[0] - mark)) < 1.0, "the marked point goes on, and stays the first"
    # The neck is counted twice, the smoothing of its corners in.
    assert parts.sum() == pytest.approx(before + 2.0 * 30.0, abs=4.0 * 20.0)
    assert abs(sum(counts) - points) <= 5
    # The two circles; one of them keeps the banks between, 60 m each.
    assert sorted(parts) == pytest.approx([2 * np.pi * 200.0, 2 * np.pi * 300.0], abs=150.0)


def test_several_necks_in_a_step_are_cut_in_one_order(device):
    """Three lobes on a ring close at once: all are cut in the first step, in the order of the points, or the next."""
    lobes = []
    for k in range(3):
        turn = 2.0 * np.pi * k / 3.0
        lobe = dumbbell()[:94] + [500.0, 0.0]  # the great circle, open to the west
        spin = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        lobes.append(lobe @ spin)
    ring = np.concatenate(lobes)
    runs = []
    for threads in (1, 2):
        params = plain_params(spacing=20.0, time_step=1e-6, cutoff_min_arc=3.0)
        sim = Simulation(ring_network(ring, width=40.0), params, threads=threads, device=device)
        sim.run(steps=3)
        runs.append([c.xy.tobytes() for c in sim.history.cutoffs])
    assert runs[0] == runs[1] and len(runs[0]) >= 2


def test_both_parts_go_on_and_split_again(device):
    params = plain_params(spacing=40.0, ring_policy="both")
    sim = Simulation(ring_network(noisy_ring()), params, device=device)
    sim.run(steps=500)
    network = sim.network
    assert network.channel_count > 20 and not sim.history.cutoffs
    assert [s.other for s in sim.history.splits] == network.channel_id[1:].tolist()
    assert all(s.channel < s.other and s.time <= sim.time for s in sim.history.splits)
    assert len(set(network.channel_id.tolist())) == network.channel_count == network.node_count
    assert np.isfinite(network.points()).all() and (np.diff(network.starts()) >= 8).all()
    assert sim.history.network(-1).channel_closed.all()


@pytest.mark.parametrize("kind", [plain_params, PathMeander])
def test_rings_multiply_up_to_a_limit_with_a_word(kind, device, tmp_path):
    params = kind(spacing=40.0, ring_policy="both", max_rings=4)
    free, whole, half = (
        Simulation(ring_network(noisy_ring()), params.replace(max_rings=limit), device=device) for limit in (1000, 4, 4)
    )
    free.run(steps=500)
    assert free.network.channel_count > 6
    with pytest.warns(UserWarning, match=r"there are 4 rings: no more are made \(max_rings=4\)") as told:
        whole.run(steps=500)
    assert len([w for w in told if "rings" in str(w.message)]) == 1, "once"
    assert whole.network.channel_count == 4 and len(whole.history.splits) == 3 and len(whole.history.cutoffs) > 2
    both = (*whole.history.splits, *whole.history.cutoffs)
    assert sorted(both, key=lambda event: event.time)[:3] == list(whole.history.splits), "first splits, then lakes"
    assert list(whole.history.splits) == list(free.history.splits[:3])
    with pytest.warns(UserWarning, match="max_rings=4"):
        half.run(steps=300, store=tmp_path / "run")
        rest = Simulation.resume(tmp_path / "run", device=device)
        rest.run(steps=200)
    np.testing.assert_array_equal(rest.network.points(), whole.network.points())


# ---- with lines


def test_open_and_closed_channels_in_one_run(device):
    """The lines do as they do alone, and rings join none of them."""
    lines = [wr.generate.noisy_line(6000.0, 40.0, 60.0, k) + [-3000.0, 5000.0 + 2500.0 * k] for k in range(2)]
    ring = noisy_ring(radius=1500.0)
    origin = np.zeros(2)
    params = plain_params(spacing=40.0)
    both = Simulation(RiverNetwork.from_polylines([lines[0], ring, lines[1]], 60.0, closed=[False, True, False],
                                                  origin=origin), params, device=device)  # fmt: skip
    alone = Simulation(RiverNetwork.from_polylines(lines, 60.0, origin=origin), params, device=device)
    single = Simulation(ring_network(ring, origin=origin), params, device=device)
    assert_as_alone(both, alone, single, 600, device)


def test_a_ring_across_a_line_joins_nothing(device):
    line = np.stack([np.linspace(-3000.0, 3000.0, 120), np.full(120, 10.0)], axis=1)
    network = RiverNetwork.from_polylines([line, circle(200, 1200.0), line + [0.0, 4000.0]], 60.0,
                                          closed=[False, True, False])  # fmt: skip
    sim = Simulation(network, plain_params(), device=device)
    sim.run(steps=30)
    assert sim.network.channel_count == 3 and not sim.history.collisions


# ---- histories


@pytest.mark.parametrize("policy", ["longer", "both"])
def test_a_run_resumed_is_equal_to_the_bit(tmp_path, policy, device):
    params = plain_params(spacing=40.0, ring_policy=policy)
    whole = Simulation(ring_network(noisy_ring()), params, device=device)
    whole.run(steps=330)
    half = Simulation(ring_network(noisy_ring()), params, device=device)
    half.run(steps=170, store=tmp_path / "run")
    rest = Simulation.resume(tmp_path / "run", device=device)
    assert rest.network.channel_closed.all()
    rest.run(steps=160)
    np.testing.assert_array_equal(rest.network.points(), whole.network.points())
    assert [c.xy.tobytes() for c in rest.history.cutoffs] == [c.xy.tobytes() for c in whole.history.cutoffs]
    assert rest.network.channel_id.tolist() == whole.network.channel_id.tolist()
    again = wr.history.History.load(tmp_path / "run")
    rest.history.save(tmp_path / "run.npz")
    for found in (rest.history, again, wr.history.History.load(tmp_path / "run.npz")):
        for a, b in zip(found.splits, whole.history.splits, strict=True):
            assert (a.time, a.channel, a.other, a.width) == (b.time, b.channel, b.other, b.width)
            np.testing.assert_array_equal(a.xy, b.xy)
        last = found.record(-1)
        assert last.events_before == len(whole.history.events) and last.channels.closed.all()
    assert (f"{len(whole.history.splits)} splits" in repr(again)) == (policy == "both")
    # What came after the last record is done again.
    whole.history.events.extend(whole.history.events[:1])
    assert len(Simulation.resume(whole.history, device=device).history.events) == len(again.events) > 0
    assert len(whole.history.cutoffs) > 0 or whole.network.channel_count > 1


def test_a_run_without_rings_has_no_splits(tmp_path, device):
    sim = Simulation(
        RiverNetwork.from_polylines([wr.generate.noisy_line(3000.0, 50.0, 60.0, 0)], 60.0),
        plain_params(),
        device=device,
    )
    assert not sim.history.record(-1).channels.closed.any() and sim.stepper.state.closed is None
    sim.history.save(tmp_path / "run.npz")
    again = wr.history.History.load(tmp_path / "run.npz")
    assert again.splits == [] and again.record(-1).events_before == 0 and "split" not in repr(again)
    assert not sim.history.network(-1).channel_closed.any()


# ---- smoothing


def test_taubin_keeps_the_area_of_a_ring_over_a_thousand_passes(device):
    """Within 1 %, and its length but for the noise that goes; plain smoothing by the same strength loses half of it."""
    rng = np.random.default_rng(0)
    smooth = circle(300, 1000.0)
    rough = smooth + rng.normal(0.0, 2.0, smooth.shape)
    after = smoothed(rough, 1000, device=device)
    assert twin.area(after) == pytest.approx(twin.area(rough), rel=1e-2)
    assert twin.segments(after).sum() == pytest.approx(twin.segments(smooth).sum(), rel=1e-2)
    assert np.abs(np.hypot(*after.T) - np.hypot(*after.T).mean()).max() < 2.0
    plain = rough
    for _ in range(1000):
        plain = twin.smooth(twin.smooth(plain, 0.5), 0.5)
    factor = (1.0 - 0.5 * (1.0 - np.cos(2.0 * np.pi / 300))) ** 2000
    assert twin.area(plain) / twin.area(rough) == pytest.approx(factor**2, rel=5e-3) and factor**2 < 0.65


@pytest.mark.parametrize("count", [8, 9, 40, 1000])
def test_taubin_leaves_a_circle_as_it_is(count, device):
    """Its one wave is the edge of the pass band, whatever the number of points."""
    xy = circle(count, 500.0)
    np.testing.assert_allclose(smoothed(xy, 1000, device=device), xy, rtol=0.0, atol=1e-8)


def test_taubin_takes_out_the_shortest_wave_and_holds_ends(device):
    xy = np.stack([50.0 * np.arange(101), 5.0 * (-1.0) ** np.arange(101)], axis=1)
    after = taubin_smooth(xy, 30)
    assert (after[[0, -1]] == xy[[0, -1]]).all()
    assert np.abs(after[20:-20, 1]).max() < 0.1
    lines = [xy, circle(40, 300.0) + [0.0, 2000.0]]
    both = taubin_smooth(RiverNetwork.from_polylines(lines, 20.0, closed=[False, True], device=device), 30)
    assert both.point_xy.device.alias == device and both.channel_closed.tolist() == [False, True]
    for line, ring, found in zip(lines, (False, True), both.polylines(), strict=True):
        np.testing.assert_allclose(found, taubin_smooth(line, 30, closed=ring), rtol=0.0, atol=1e-10)
    band = smoothed(circle(40, 300.0), 10, pass_band=0.1, device=device)
    k = 1.0 - np.cos(2.0 * np.pi / 40)
    growth = (1.0 - 0.5 * k) * (1.0 - k / (0.1 - 2.0))
    assert np.hypot(*band.T) == pytest.approx(300.0 * growth**10, rel=1e-12)


def test_a_step_may_smooth(device):
    """A pass a step keeps a circle on its closed form and changes a noisy ring; threads do not matter."""
    params = plain_params(time_step=0.05, spacing=25.0, taubin_passes=1)
    sim = Simulation(ring_network(circle(251, 1000.0), 50.0), params, check=True, device=device)
    sim.run(steps=100)
    found = np.hypot(*sim.network.polylines()[0].T)
    assert found == pytest.approx(np.sqrt(1e6 + 2.0 * 60.0 * 50.0 * 1.5 * 5.0), rel=2e-5)
    runs = {}
    for passes, threads in ((0, 1), (2, 1), (2, 2)):
        lines = [noisy_ring(middle=(0.0, 9000.0 * k), seed=k) for k in range(3)]
        network = RiverNetwork.from_polylines(lines, 60.0, closed=True)
        other = Simulation(network, plain_params(spacing=40.0, taubin_passes=passes), threads=threads, device=device)
        other.run(steps=50)
        runs[passes, threads] = other.network.points()
    np.testing.assert_array_equal(runs[2, 1], runs[2, 2])
    assert runs[0, 1].shape != runs[2, 1].shape or np.abs(runs[0, 1] - runs[2, 1]).max() > 0.1


# ---- metrics, files, bad input


def test_metrics_of_rings():
    xy = circle(400, 800.0)
    assert metrics.sinuosity(xy, closed=True) == pytest.approx(1.0, abs=1e-4)
    assert metrics.curvature(xy, closed=True) == pytest.approx(1.0 / 800.0, rel=1e-9)
    ellipse = xy * [2.0, 1.0]
    around = twin.segments(ellipse).sum()
    assert metrics.sinuosity(ellipse, closed=True) == pytest.approx(
        around / (2 * np.pi * 800.0 * np.sqrt(2.0)), rel=1e-4
    )
    angle = 2.0 * np.pi * np.arange(1200) / 1200
    gear = circle(1200, 1.0) * (2000.0 + 150.0 * np.cos(12 * angle))[:, None]
    for shift in (0, 33, 50, 77):
        rolled = np.roll(gear, shift, axis=0)
        bends = metrics.bends(rolled, 60.0, closed=True)
        assert len(bends.arc) == 24 and bends.arc.sum() == pytest.approx(twin.segments(gear).sum(), rel=1e-5)
        assert metrics.wavelength(rolled, 60.0, closed=True) == pytest.approx(2.0 * np.pi * 2000.0 / 12, rel=0.03)
    with pytest.raises(ValueError, match="repeats its first point"):
        metrics.curvature(np.concatenate([xy, xy[:1]]), closed=True)


@pytest.mark.parametrize("suffix", [".csv", ".geojson", ".gpkg", ".parquet", ".shp"])
def test_files_keep_rings(tmp_path, suffix):
    if suffix in (".gpkg", ".parquet", ".shp"):
        pytest.importorskip("geopandas")
        pytest.importorskip("pyogrio")
    ring = noisy_ring(radius=500.0)
    line = np.stack([np.linspace(-900.0, 900.0, 40), np.full(40, 900.0)], axis=1)
    network = RiverNetwork.from_polylines([ring, line], 30.0, closed=[True, False])
    path = tmp_path / f"rings{suffix}"
    wr.io.write_network(network, path)
    back = wr.read_network(path)
    assert back.channel_closed.tolist() == [True, False]
    for a, b in zip(back.polylines(), network.polylines(), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-9)
    assert not wr.read_network(path, closed=False).channel_closed.any()


def test_an_unmarked_ring_in_a_file_is_one_only_when_asked_for(tmp_path):
    ring = circle(30, 400.0)
    path = tmp_path / "ring.csv"
    np.savetxt(path, np.concatenate([ring, ring[:1]]), delimiter=",")
    assert not wr.read_network(path, width=20.0).channel_closed.any()
    network = wr.read_network(path, width=20.0, closed=True)
    assert network.channel_closed.all() and network.point_count == 30


def test_a_repeated_first_point_is_dropped():
    ring, closed = circle(50, 300.0), np.concatenate([circle(50, 300.0), circle(50, 300.0)[:1]])
    width = np.linspace(20.0, 30.0, 51)
    network = ring_network(closed, [width])
    np.testing.assert_array_equal(network.polylines()[0], ring)
    np.testing.assert_array_equal(network.point_widths()[0], width[:50])
    np.testing.assert_array_equal(network.polylines(close=True)[0], closed)
    assert network.channel_lengths() == pytest.approx(twin.segments(ring).sum(), rel=1e-14)
    assert network.node_count == 1 and "1 rings" in repr(network)


LINE = np.stack([np.linspace(0.0, 3000.0, 60), np.zeros(60)], axis=1)
RING = circle(60, 500.0)


# ---- the marked point


def test_a_ring_begins_at_its_mark_and_keeps_it(tmp_path, device):
    """In the network, in files and through a run whose first neck cuts the other part off."""
    xy = dumbbell()
    width = np.linspace(38.0, 42.0, len(xy))
    mark = len(xy) - 10  # in the lesser circle
    network = RiverNetwork.from_polylines([xy], [width], closed=True, marks=[mark])
    np.testing.assert_allclose(network.polylines()[0], np.roll(xy, -mark, axis=0), rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(network.point_widths()[0], np.roll(width, -mark))
    np.testing.assert_allclose(network.node_xy[0], xy[mark], rtol=0.0, atol=1e-9)
    wr.io.write_network(network, tmp_path / "ring.geojson")
    np.testing.assert_allclose(wr.read_network(tmp_path / "ring.geojson").polylines()[0][0], xy[mark], atol=1e-9)
    params = plain_params(spacing=20.0, time_step=1e-6, ring_policy="marked", cutoff_min_arc=3.0)
    sim = Simulation(network, params, device=device)
    history = sim.run(steps=2, record_every=1, store=tmp_path / "run")
    assert len(history.cutoffs) == 1 and sim.network.channel_lengths()[0] < 1600.0, "the lesser one goes on"
    for kept in wr.history.History.load(tmp_path / "run").networks:
        assert np.hypot(*(kept.polylines()[0][0] - xy[mark])) < 1.0


def test_marks_of_several_rings():
    lines = [RING, LINE + [0.0, 3000.0], RING + [4000.0, 0.0]]
    closed = [True, False, True]
    for marks, first in ((None, (0, 0)), (7, (7, 7)), ([5, None, None], (5, 0)), ([None, None, 59], (0, 59))):
        network = RiverNetwork.from_polylines(lines, 30.0, closed=closed, marks=marks)
        for xy, line, k in zip(network.polylines(), lines, (first[0], 0, first[1]), strict=True):
            np.testing.assert_allclose(xy, np.roll(line, -k, axis=0), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("closed", "marks", "words"),
    [
        ([True, False], [60, None], "mark of channel 0 is 60; its points are numbered from 0 to 59"),
        ([True, False], -1, "mark of channel 0 is -1; its points"),
        ([True, False], [1.5, None], "mark of channel 0 is 1.5; give the index of a point"),
        ([True, False], [True, None], "mark of channel 0 is True; give the index of a point"),
        ([True, False], [0, 3], "channel 1 is no ring and has no marked point"),
        ([True, False], [0], "marks: 1 values for 2 channels"),
        (False, 3, "there is no ring among the channels"),
    ],
)
def test_bad_marks_are_refused(closed, marks, words):
    with pytest.raises(ValueError, match=words) as caught:
        RiverNetwork.from_polylines([RING, LINE + [0.0, 3000.0]], 30.0, closed=closed, marks=marks)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "closed", "words"),
    [
        ([circle(7, 500.0)], True, "a ring of 7 points; a ring needs at least 8"),
        ([LINE], True, "closed, but its ends are 3000 m apart"),
        ([LINE, RING], [True, True], "channel 0: closed, but its ends"),
        ([RING], [True, False], "closed is .*; give True or False"),
        ([RING], "yes", "closed is 'yes'"),
        ([RING, RING[5] + LINE], [True, False], "channel 0 is a ring and meets channel 1"),
        ([RING[5] - LINE[::-1], RING], [False, True], "channel 1 is a ring and meets channel 0"),
        ([RING, RING + [1000.0, 0.0]], True, "channel 0 is a ring and meets channel 1"),
    ],
)
def test_bad_rings_are_refused(lines, closed, words):
    with pytest.raises(ValueError, match=words) as caught:
        RiverNetwork.from_polylines(lines, 30.0, closed=closed)
    assert "\n" not in str(caught.value)


def test_a_simulation_refuses_what_it_cannot_do_with_rings():
    closed = np.concatenate([RING, RING[:1]])
    with pytest.raises(ValueError, match="make it a ring"):
        Simulation(RiverNetwork.from_polylines([closed], 50.0), plain_params())
    with pytest.raises(ValueError, match="ring_policy is 'none'; use one of"):
        plain_params(ring_policy="none")
    with pytest.raises(ValueError, match="give a whole number"):
        plain_params(taubin_passes=1.5)
    for numbers, words in (
        ({"passes": -1}, "passes is -1"),
        ({"strength": 0.0}, "strength"),
        ({"pass_band": 1.0}, "pass_band"),
    ):
        with pytest.raises(ValueError, match=words):
            taubin_smooth(RING, closed=True, **numbers)


def test_the_command_line_runs_rings(tmp_path, capsys):
    from warpriver.cli import main

    ring = noisy_ring(radius=800.0)
    path = tmp_path / "ring.csv"
    np.savetxt(path, np.concatenate([ring, ring[:1]]), delimiter=",")
    options = ["--width", "60", "--closed", "--ring-policy", "marked", "--taubin-passes", "1", "--years", "3"]
    assert main(["simulate", str(path), *options, "-o", str(tmp_path / "out"), "--no-progress"]) == 0
    assert wr.read_network(tmp_path / "out" / "channels.csv").channel_closed.all()
    assert main(["info", str(tmp_path / "out" / "channels.csv")]) == 0
    assert "sinuosity 1." in capsys.readouterr().out
    assert main(["simulate", str(path), "--width", "60", "-o", str(tmp_path / "no"), "--no-progress"]) == 2
    assert "make it a ring" in capsys.readouterr().err


@pytest.mark.parametrize("solver", ["migration", "path"])
def test_the_command_line_tells_splits(tmp_path, capsys, solver):
    from warpriver.cli import main

    path, out = tmp_path / "ring.csv", tmp_path / "out"
    np.savetxt(path, np.concatenate([dumbbell(), dumbbell()[:1]]), delimiter=",")
    options = ["--width", "40", "--closed", "--ring-policy", "both", "--years", "0.3", "--spacing", "20"]
    options += ["--cutoff-distance", "1"] if solver == "migration" else []
    assert main(["simulate", str(path), *options, "--solver", solver, "-o", str(out), "--no-progress"]) == 0
    assert "0 cutoffs and 1 split of rings in all" in capsys.readouterr().out
    assert len(wr.history.History.load(out / "run").splits) == 1
    assert wr.read_network(out / "channels.csv").channel_closed.tolist() == [True, True]


def test_a_belt_tells_splits(tmp_path, device):
    pytest.importorskip("matplotlib")
    params = plain_params(spacing=20.0, time_step=0.01, ring_policy="both", cutoff_min_arc=3.0)
    history = Simulation(ring_network(dumbbell(), width=40.0), params, device=device).run(steps=2, record_every=1)
    figure = wr.viz.draw_belt(history, tmp_path / "belt.png")
    words = [text.get_text() for axes in figure.axes for text in axes.texts] + [t.get_text() for t in figure.texts]
    told = f"{len(history.splits)} split"
    assert any(told in word and "cutoff" not in word for word in words), words
