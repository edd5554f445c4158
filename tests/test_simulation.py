import copy
import os
import pickle
import signal
import threading
import warnings

import numpy as np
import pytest
import warp as wp
from insides import loops_of, tighten
from plain import plain_params
from trees import random_tree

from warpriver import PathMeander, RiverNetwork, Simulation, generate
from warpriver.engine.checks import PhaseError
from warpriver.history import Every, History, StopReason
from warpriver.meander.resampling import Resample


def wandering(seed=0, length=12_000.0, width=50.0, channels=1, **options):
    """A network of noisy straight channels, far enough apart not to meet."""
    lines = [generate.noisy_line(length, 50.0, width, seed + k) + [0.0, 8000.0 * k] for k in range(channels)]
    return RiverNetwork.from_polylines(lines, width=width, **options)


def states_equal(a, b):
    """True when two simulations hold the same bits."""
    n = a.network.point_count
    return n == b.network.point_count and np.array_equal(a.network.point_xy.numpy()[:n], b.network.point_xy.numpy()[:n])


@pytest.fixture(scope="module")
def long_run(device):
    """300 years of one channel, with cutoffs, every phase checked."""
    sim = Simulation(wandering(), plain_params(), check=True, device=device)
    return sim, sim.run(years=300, record_every=50)


def test_a_channel_meanders_and_cuts_off(long_run):
    sim, history = long_run
    assert history.stop_reason is StopReason.COMPLETED
    assert sim.network.channel_lengths()[0] > 1.9 * 12_000
    assert len(history.cutoffs) > 0
    for cutoff in history.cutoffs:
        assert 0 < cutoff.time <= sim.time and cutoff.channel == 0 and cutoff.width == 50.0
        neck = np.hypot(*(cutoff.xy[-1] - cutoff.xy[0]))
        assert neck < 50.0, "the two ends of a loop are a neck"
        assert np.hypot(*np.diff(cutoff.xy, axis=0).T).sum() >= 5 * 50.0


def test_ends_stay_where_they_were(long_run):
    _, history = long_run
    first = history.networks[0].polylines()[0]
    for network in history.networks:
        line = network.polylines()[0]
        np.testing.assert_array_equal(line[[0, -1]], first[[0, -1]])


def test_points_are_evenly_spaced(long_run):
    sim, history = long_run
    for network in history.networks[1:]:
        step = np.hypot(*np.diff(network.polylines()[0], axis=0).T)
        # The spacing asked for is met by the mean; a chord is shorter than its arc, at a fresh neck much.
        assert np.mean(step) == pytest.approx(sim.params.spacing, rel=0.01)
        assert np.median(step) == pytest.approx(sim.params.spacing, rel=0.005)
        assert step.max() < 1.3 * sim.params.spacing


def test_same_seed_same_bits(device):
    one, two = (Simulation(wandering(seed=3), plain_params(), device=device) for _ in range(2))
    one.run(steps=700)
    two.run(steps=700)
    assert states_equal(one, two)
    assert [c.xy.tobytes() for c in one.history.cutoffs] == [c.xy.tobytes() for c in two.history.cutoffs]
    assert len(one.history.cutoffs) > 0


@pytest.mark.parametrize("options", [{"capture": False}, {"check": True}])
def test_replayed_plain_and_checked_steps_are_equal_to_the_bit(options, device):
    replayed, other = (
        Simulation(wandering(channels=3), plain_params(), device=device),
        Simulation(wandering(channels=3), plain_params(), **options, device=device),
    )
    replayed.run(steps=600, record_every=1000)
    other.run(steps=600, record_every=1000)
    assert len(replayed.history.cutoffs) > 0
    assert states_equal(replayed, other)


def test_growing_buffers_changes_nothing(device):
    roomy, tight = (
        Simulation(wandering(channels=2), plain_params(), device=device),
        Simulation(wandering(channels=2), plain_params(), device=device),
    )
    tighten(tight, points=8)
    for sim in (roomy, tight):
        sim.run(steps=700, record_every=1000)
    assert len(roomy.history.cutoffs) > 1
    capacity = tight.stepper.state.point_capacity
    assert loops_of(tight).oxbow_capacity > 8 and capacity > tight.history.networks[0].point_count
    assert states_equal(roomy, tight)


@pytest.mark.parametrize("where", ["folder", "file", "memory"])
def test_save_reload_continue_is_the_uninterrupted_run(tmp_path, where, device):
    whole = Simulation(wandering(seed=5), plain_params(), device=device)
    whole.run(steps=600, record_every=7)
    half = Simulation(wandering(seed=5), plain_params(), device=device)
    history = half.run(steps=300, record_every=7, store=tmp_path / "run" if where == "folder" else None)
    if where == "file":
        history.save(tmp_path / "run.npz")
    source = {"folder": tmp_path / "run", "file": tmp_path / "run.npz", "memory": history}[where]
    again = Simulation.resume(source, device=device)
    assert again.step_count == 300
    again.run(steps=300, record_every=7)
    assert states_equal(whole, again)
    assert len(again.history.cutoffs) == len(whole.history.cutoffs) > 0
    for a, b in zip(again.history.cutoffs, whole.history.cutoffs, strict=True):
        assert a.time == b.time
        np.testing.assert_array_equal(a.xy, b.xy)
    assert set(whole.history.steps) <= set(again.history.steps) | {300}


def test_width_that_varies_is_carried_along(device):
    line = generate.noisy_line(12_000.0, 50.0, 50.0, 1)
    width = np.linspace(60.0, 120.0, len(line))
    sim = Simulation(RiverNetwork.from_polylines([line], width=[width]), plain_params(), check=True, device=device)
    sim.run(steps=500)
    now = sim.network.point_widths()[0]
    assert len(now) == sim.network.point_count
    assert now[0] == pytest.approx(60.0) and now[-1] == pytest.approx(120.0)
    assert (np.diff(now) > -1e-9).all(), "widths still grow downstream, cutoffs or not"
    if sim.history.cutoffs:
        assert all(60.0 < c.width < 120.0 for c in sim.history.cutoffs)


def test_a_constant_width_given_per_point_is_the_same_channel(device):
    line = generate.noisy_line(12_000.0, 50.0, 50.0, 2)
    width = np.full(len(line), 50.0)
    width[-1] += 1e-9  # enough to be carried per point
    plain = Simulation(RiverNetwork.from_polylines([line], width=50.0), plain_params(), device=device)
    varied = Simulation(RiverNetwork.from_polylines([line], width=[width]), plain_params(), device=device)
    for sim in (plain, varied):
        sim.run(steps=50)
    # A relative change of 2e-11 at one end grows with the bends, e-fold in some 8 years here.
    np.testing.assert_allclose(varied.network.polylines()[0], plain.network.polylines()[0], atol=1e-6)


def test_float32_follows_float64(device):
    double, single = (
        Simulation(wandering(seed=1), plain_params(), device=device),
        Simulation(wandering(seed=1), plain_params(), dtype="float32", device=device),
    )
    for sim in (double, single):
        sim.run(steps=20)
    # float32 curvature errs by 4e-5 of 1/w near the origin; 20 steps of 17 m at most carry it on.
    np.testing.assert_allclose(single.network.polylines()[0], double.network.polylines()[0], atol=0.3)
    single.run(steps=600)
    assert single.network.channel_lengths()[0] > 1.5 * 12_000


def test_steps_asked_for_at_once_are_those_of_as_many_calls(device):
    """With sub-steps and cutoffs among them; nothing is recorded but events."""
    params = plain_params(time_step=1.0)
    one_by_one, at_once = (Simulation(wandering(width=60.0), params, device=device) for _ in range(2))
    for _ in range(150):
        one_by_one.step()
    at_once.step(1)
    at_once.step(149)
    assert at_once.step_count == one_by_one.step_count == 150 and at_once.substeps > 1
    np.testing.assert_array_equal(at_once.network.points(), one_by_one.network.points())
    cutoffs = [[(c.time, c.xy.tobytes()) for c in sim.history.cutoffs] for sim in (one_by_one, at_once)]
    assert len(cutoffs[0]) > 1 and cutoffs[0] == cutoffs[1]
    assert len(at_once.history) == 1


@pytest.mark.parametrize("count", [0, -3, 1.5, np.nan, np.inf])
def test_a_number_of_steps_that_is_none_is_refused(count, device):
    sim = Simulation(wandering(), plain_params(), device=device)
    with pytest.raises(ValueError, match=r"count is .*; give a whole number"):
        sim.step(count)
    assert sim.step_count == 0


def test_the_network_given_is_left_alone(device):
    network = wandering()
    before = network.polylines()[0]
    Simulation(network, plain_params(), device=device).run(steps=50)
    np.testing.assert_array_equal(network.polylines()[0], before)


def test_a_figure_of_eight_is_allowed_and_cut_at_its_crossing(device):
    t = np.linspace(0.0, 1.0, 200)
    loop = np.stack([3000.0 * t, np.zeros(200)], axis=1)
    angle = np.linspace(0.0, 2.0 * np.pi, 120)[1:]
    circle = np.stack([3000.0 + 600.0 * np.sin(angle), 600.0 - 600.0 * np.cos(angle)], axis=1)
    tail = np.stack([3000.0 + 3000.0 * t[5:], np.zeros(195)], axis=1)
    sim = Simulation(
        RiverNetwork.from_polylines([np.concatenate([loop, circle, tail])], width=60.0), plain_params(), device=device
    )
    sim.step()
    assert len(sim.history.cutoffs) == 1
    assert len(sim.history.cutoffs[0].xy) == pytest.approx(2 * np.pi * 600.0 / 50.0, rel=0.1)


def test_long_steps_are_done_in_parts(device):
    sim = Simulation(wandering(width=60.0), plain_params(time_step=2.0), device=device)
    sim.step()
    assert 1 < sim.substeps <= int(np.ceil(2.0 / sim.stable_dt))
    assert sim.time == 2.0
    narrow = generate.noisy_line(600.0, 2.0, 1.0, 0)
    sim = Simulation(
        RiverNetwork.from_polylines([narrow], width=2.0), plain_params(spacing=2.0), check=True, device=device
    )
    assert sim.run(years=20).stop_reason is StopReason.COMPLETED


def test_a_time_step_out_of_proportion_is_refused():
    with pytest.raises(ValueError, match="is it in years"):
        Simulation(wandering(), plain_params(time_step=106.0 * 86400.0))


def test_spacing_wider_than_a_channel_is_refused():
    with pytest.raises(ValueError, match=r"spacing 50 m is coarser than channel 0 is wide \(20 m\)"):
        Simulation(wandering(width=20.0), plain_params(spacing_in_widths=0.0))


def test_a_ring_is_refused():
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    ring = 800.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    with pytest.raises(ValueError, match="channel 0: its ends coincide"):
        Simulation(RiverNetwork.from_polylines([ring], width=50.0), plain_params())


def test_schedules(device):
    sim = Simulation(wandering(), plain_params(), device=device)
    seen = []
    history = sim.run(
        steps=40, record_every=Every(years=2.0), callbacks=[(Every(steps=10), lambda s: seen.append(s.step_count))]
    )
    assert seen == [10, 20, 30, 40]
    assert history.steps[0] == 0 and history.steps[-1] == 40
    inner = history.times[1:-1]
    np.testing.assert_array_equal(np.floor(inner / 2.0), np.arange(1, len(inner) + 1))
    assert [k for k in range(1, 31) if Every(years=1.0).due(k, 0.1)] == [10, 20, 30]
    for bad in ({}, {"steps": 0}, {"years": -1.0}, {"steps": 1, "years": 1.0}, {"steps": 1.5}):
        with pytest.raises(ValueError, match="Every"):
            Every(**bad)


def test_a_callback_may_stop_the_run(device):
    sim = Simulation(wandering(), plain_params(), device=device)
    history = sim.run(steps=100, callbacks=[lambda s: s.step_count == 13])
    assert history.stop_reason is StopReason.CALLBACK and history.steps[-1] == 13
    assert sim.run(steps=2).stop_reason is StopReason.COMPLETED and sim.step_count == 15


@pytest.mark.parametrize("bad", [{}, {"years": 1, "steps": 1}, {"steps": -1}, {"steps": 1.5}, {"years": np.nan}])
def test_run_says_what_it_needs(bad):
    with pytest.raises(ValueError, match=r"steps|years"):
        Simulation(wandering(), plain_params()).run(**bad)


def test_zero_years_record_the_start(device):
    history = Simulation(wandering(), plain_params(), device=device).run(years=0)
    assert len(history) == 1 and history.stop_reason is StopReason.COMPLETED


def test_a_point_that_is_not_finite_stops_the_run_and_keeps_the_state_before(device):
    sim = Simulation(wandering(), plain_params(), device=device)
    sim.run(steps=5)
    before = sim.network.polylines()[0]
    state = sim.stepper.state
    state.point_moved.zero_()
    poison = state.form.numpy().copy()
    poison["depth"][0] = np.nan  # a depth of NaN makes every rate NaN
    state.form.assign(poison)
    history = sim.run(steps=5)
    assert history.stop_reason is StopReason.NOT_FINITE and "report" in history.stop_reason.advice
    assert sim.step_count == 5
    np.testing.assert_array_equal(sim.network.polylines()[0], before)
    with pytest.raises(FloatingPointError, match="step 6"):
        sim.step()


def test_a_broken_phase_is_found(monkeypatch, device):
    sim = Simulation(wandering(), plain_params(), check=True, device=device)
    real = Resample.check

    def shifted(self, state):
        xy = state.network.point_xy.numpy().copy()
        xy[10] += 500.0
        state.network.point_xy.assign(xy)
        real(self, state)

    monkeypatch.setattr(Resample, "check", shifted)
    with pytest.raises(PhaseError, match="too far from the next"):
        sim.run(steps=3)
    assert sim.history.stop_reason is StopReason.CHECK_FAILED


def test_ctrl_c_stops_at_a_step_boundary_and_leaves_a_readable_run(tmp_path, device):
    assert threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT)
    sim = Simulation(wandering(), plain_params(), device=device)

    def interrupt(s):
        if s.step_count == 37:
            os.kill(os.getpid(), signal.SIGINT)

    history = sim.run(steps=1000, record_every=10, store=tmp_path / "run", callbacks=[interrupt])
    assert history.stop_reason is StopReason.INTERRUPTED
    assert sim.step_count == 37
    assert signal.getsignal(signal.SIGINT) is before
    reopened = History.load(tmp_path / "run")
    assert reopened.stop_reason is StopReason.INTERRUPTED
    assert reopened.steps.tolist() == [0, 10, 20, 30, 37]
    rest = Simulation.resume(tmp_path / "run", device=device)
    rest.run(steps=63)
    whole = Simulation(wandering(), plain_params(), device=device)
    whole.run(steps=100)
    assert states_equal(rest, whole)


def test_a_run_emits_no_warning(device):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Simulation(wandering(), plain_params(), device=device).run(steps=50)


def test_repr_says_where_the_run_stands(long_run, device):
    text = repr(long_run[0])
    for word in ("300", "step", device, "float64", "stable up to", "spacing 50 m", "cutoffs", "completed"):
        assert word in text


def test_memory_grows_with_the_points(device):
    sims = [Simulation(wandering(length=length), plain_params(), device=device) for length in (20_000.0, 200_000.0)]
    per_point = [
        (s.stepper.state.nbytes + len(s.network.point_xy) * wp.types.type_size_in_bytes(s.network.point_xy.dtype))
        / s.network.point_count
        for s in sims
    ]
    # A few buffers are sized by chunk and channel; what grows is under 2 kB a point by far.
    assert max(per_point) < 400.0 and per_point[1] <= per_point[0]


def test_an_error_of_a_callback_is_its_callers_affair(tmp_path, device):
    """Only a history that cannot be stored ends a run quietly."""

    def write(sim):
        (tmp_path / "no" / "such" / "folder").write_text("x")

    sim = Simulation(wandering(width=60.0), plain_params(), device=device)
    with pytest.raises(FileNotFoundError):
        sim.run(steps=5, callbacks=[write])
    assert sim.history.stop_reason is None and sim.step_count == 1


# ---- copies


def drifting(device):
    network = random_tree(7, sources=8, size=8000.0, width=25.0)
    return Simulation(network, plain_params(spacing=20.0, junction_drift=0.5), device=device, threads=2)


def paths(device):
    line = generate.noisy_line(6000.0, 40.0, 40.0, 3)
    network = RiverNetwork.from_polylines([line], width=50.0)
    return Simulation(network, PathMeander(spacing=40.0), device=device, dtype="float32")


def checked(device):
    line = generate.noisy_line(6000.0, 40.0, 40.0, 3)
    return Simulation(RiverNetwork.from_polylines([line], width=50.0), plain_params(), device=device, check=True)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda sim: pickle.loads(pickle.dumps(sim))], ids=["copy", "pickle"])
@pytest.mark.parametrize(("model", "steps"), [(drifting, 60), (paths, 300), (checked, 12)])
def test_a_copy_goes_on_to_the_same_bits(model, steps, copied, device):
    """From between two records, with all that has happened; the one that was copied is none the wiser."""
    sim, untouched = model(device), model(device)
    sim.run(steps=steps // 2 - 3, record_every=10)
    for _ in range(3):
        sim.step()
    other = copied(sim)
    assert (other.step_count, other.substeps, other.check, other.threads) == (
        sim.step_count, sim.substeps, sim.check, sim.threads,
    )  # fmt: skip
    assert list(other.history.events) == list(sim.history.events) and other.history is not sim.history
    for run in (sim, other):
        run.run(steps=steps - run.step_count, record_every=10)
    untouched.run(steps=steps, record_every=10)
    if model is not checked:
        assert len(sim.history.events) > 3
    for run in (other, untouched):
        np.testing.assert_array_equal(run.network.points(), sim.network.points())
        assert run.network.channels == sim.network.channels
        np.testing.assert_array_equal(run.network.node_xy, sim.network.node_xy)
        assert list(run.history.events) == list(sim.history.events)
    np.testing.assert_array_equal(other.history.steps, sim.history.steps)


def test_a_copy_of_a_stored_run_is_stored_nowhere(tmp_path, device):
    sim = checked(device)
    sim.run(steps=5, record_every=1, store=tmp_path / "run")
    other = pickle.loads(pickle.dumps(sim))
    assert other.history.path is None and len(other.history) == 6
    other.run(steps=5, record_every=1)
    assert len(History.load(tmp_path / "run")) == 6
    sim.run(steps=5, record_every=1)
    assert len(History.load(tmp_path / "run")) == 11
