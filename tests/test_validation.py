"""The meander model against closed forms, symmetries and the literature; run with -s to see the figures measured."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import phases
import pytest
from crossings import crossings
from plain import plain_params

import warpriver as wr
from warpriver import models
from warpriver.hydraulic_geometry import bankfull_depth
from warpriver.meander.migration import explicit_dt, stable_dt

WIDTHS = (50.0, 100.0, 200.0)
DEFAULT = plain_params()
RATE, FRICTION, GAMMA = DEFAULT.migration_rate, DEFAULT.friction, DEFAULT.upstream_weight

# Wavelengths times alpha: the wave that grows fastest, the one that neither grows nor decays, one between, one longer.
FASTEST, NEUTRAL, SHORTER, LONGER = 8.242, 5.130, 5.5, 12.0


def memory(width):
    """The alpha of the upstream integral, 2 f / d, 1/m."""
    return 2.0 * FRICTION / float(bankfull_depth(width))


def theory(width, q):
    """Complex rate of a small wave A e^(i q x), growth - i q celerity, 1/yr (spec: Numerics that matter)."""
    a, stretch = memory(width), RATE * width * q**2
    growth = stretch * (-1.0 + GAMMA * a**2 / (a**2 + q**2))
    celerity = GAMMA * stretch * a / (a**2 + q**2)
    return growth - 1j * q * celerity


# With "upstream" scaling growth ends where gamma sigma^(-2/3) = 1, at a sinuosity of 2.5^1.5 = 3.95, cutoffs or not.
SATURATION = GAMMA**1.5
# Cutoffs keep every run below that by far: measured up to 3.5 ("upstream") and 3.8 ("whole", which does not saturate).
SINUOSITY_LIMIT = 4.5

# ---- linear theory


# Two per cent were asked for at 16 points a wavelength; 0.11 % at most was measured, of the size that fourth-order
# curvature and quadrature leave, so three times that.
LINEAR_ERROR = 0.003
# Measured 3.95 to 4.00; second order was asked for. Below 3.8 one of the two fourth-order corrections is lost.
LINEAR_ORDER = 3.8
# The spec gives the decay of the 375 m wave to three digits; at 7.5 points a wave an error of 1.5 % was measured, at 15
# points 0.11 %.
SHORT_WAVE, SHORT_WAVE_DECAY = 375.0, -0.209
SHORT_WAVE_ERROR = {50.0: 0.03, 25.0: 0.003}
# Order of the time step: measured 0.98 to 1.00 below the longest explicit step. Above it the implicit share smooths by
# (8/9 D dt - h^2/4) q^2: its second part lets the error fall faster than the step while both are alike; measured 1.01,
# 1.09, 1.22 on the way down.
STEP_ORDER = {"explicit": (0.95, 1.05), "implicit": (0.95, 1.3)}

AMPLITUDE = 1e-3  # m: the square of its slope, 1e-10, is below every error looked for
WAVES = 24
# Part of the line that is fitted. What the fixed head does to the wave fades as e^(-alpha x), so over a wavelength of
# 8 / alpha by e^-8: none of it is left half way down.
ZONE = (0.5, 0.75)


def step_factor(width, wavelength, points, time_step, steps=4, *, device):
    """What one step of ``time_step`` yr multiplies a small wave by (complex), from a least-squares fit.

    The mean of so few steps that the wave cannot have gone half its length: the root would take another branch.
    """
    h, q = wavelength / points, 2.0 * np.pi / wavelength
    assert h <= width
    x = h * np.arange(round(WAVES * points) + 1)
    start = np.column_stack([x, AMPLITUDE * np.sin(q * x)])
    params = plain_params(spacing=h, end_damping=0.0, cutoff_distance=0.0)

    def amplitude(xy):
        x, y = xy[(xy[:, 0] > ZONE[0] * start[-1, 0]) & (xy[:, 0] < ZONE[1] * start[-1, 0])].T
        a, b = np.linalg.lstsq(np.column_stack([np.cos(q * x), np.sin(q * x)]), y, rcond=None)[0]
        return a - 1j * b

    end = phases.march(start, width, params, time_step, steps, device=device)
    return (amplitude(end) / amplitude(start)) ** (1.0 / steps)


def longest_explicit(width, spacing):
    """Longest step in which nothing of the local term is implicit, yr (a hair less)."""
    return 0.99 * float(explicit_dt(width, plain_params(spacing=spacing)))


def space_error(width, wavelength, points, *, device):
    """Complex error of the rate without that of the time step: explicit Euler multiplies by 1 + s dt exactly."""
    dt = longest_explicit(width, wavelength / points)
    return (step_factor(width, wavelength, points, dt, device=device) - 1.0) / dt - theory(
        width, 2.0 * np.pi / wavelength
    )


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("alpha_wavelength", [FASTEST, NEUTRAL, SHORTER, LONGER])
def test_small_waves_grow_and_travel_as_in_theory(width, alpha_wavelength, device):
    wavelength = alpha_wavelength / memory(width)
    q = 2.0 * np.pi / wavelength
    exact, scale = theory(width, q), RATE * width * q**2
    points = max(16, int(np.ceil(wavelength / width)))  # the spacing may not exceed the width
    errors = np.array([space_error(width, wavelength, points * m, device=device) for m in (1, 2, 4)])
    # The growth of the neutral wave is 0: errors of growth are told by the size of its two parts, k w q^2.
    growth, travel = abs(errors.real) / scale, abs(errors.imag / exact.imag)
    orders = np.log2(np.stack([growth[:-1] / growth[1:], travel[:-1] / travel[1:]]))
    print(
        f"w {width:g} m, wave {wavelength:.0f} m, {points} points: growth {exact.real:+.5f}/yr, error/(k w q2) "
        f"{growth[0]:.2e}; celerity {-exact.imag / q:.2f} m/yr, error {travel[0]:.2e}; orders "
        f"{orders[0].round(2)}, {orders[1].round(2)}"
    )
    assert growth[0] < LINEAR_ERROR and travel[0] < LINEAR_ERROR
    assert (orders > LINEAR_ORDER).all()


# Widths from the end of a line, and the part of what bends upstream push it that a bend feels there: 3 t^2 - 2 t^3 over
# five widths.
FADING = {1.25: 0.15625, 2.5: 0.5, 3.75: 0.84375, 5.0: 1.0, 7.5: 1.0}


@pytest.mark.parametrize("term", ["upstream", "local"])
def test_bends_fade_over_five_widths_next_to_a_held_end(term, device):
    """Against the bends a wavelength upstream: no kink grows at the end, and any straightens as fast as elsewhere."""
    weights = {"local_weight": 0.0} if term == "upstream" else {"upstream_weight": 0.0}
    width, h = 50.0, 12.5
    wavelength = 12.0 * width
    # The head, from where on the rate settles down to that of the wave, is far from the bends that are compared.
    x = h * np.arange(round(12 * wavelength / h) + 1)
    for distance, part in FADING.items():
        # A crest at the place that is looked at: the rate does not vanish there.
        start = np.column_stack([x, 0.1 * np.cos(2.0 * np.pi * (x - x[-1] + distance * width) / wavelength)])
        network = wr.RiverNetwork.from_polylines([start], width=width)
        sim = wr.Simulation(network, plain_params(spacing=h, time_step=0.002, **weights), device=device)
        before = sim.network.polylines()[0]
        sim.step()
        after = sim.network.polylines()[0]
        at = x[-1] - width * distance - np.array([0.0, wavelength])
        moved = np.interp(at, *after.T) - np.interp(at, *before.T)
        print(f"{term}, {distance:g} widths from the end: {moved[0] / moved[1]:.4f} of the speed")
        assert moved[0] / moved[1] == pytest.approx(part if term == "upstream" else 1.0, abs=0.003)


def test_fastest_and_neutral_wave_lie_where_theory_has_them():
    for width in WIDTHS:
        a = memory(width)
        rates = {r: theory(width, 2.0 * np.pi * a / r).real for r in (FASTEST, 0.98 * FASTEST, 1.02 * FASTEST, NEUTRAL)}
        assert max(rates, key=rates.get) == FASTEST
        # The spec gives both wavelengths and the growth to four digits.
        assert rates[FASTEST] == pytest.approx(0.3377 * RATE * width * a**2, rel=2e-4)
        assert abs(rates[NEUTRAL]) < 1e-3 * rates[FASTEST]


@pytest.mark.parametrize("spacing", SHORT_WAVE_ERROR)
def test_short_wave_decays_where_public_codes_let_it_grow(spacing, device):
    width, q = 50.0, 2.0 * np.pi / SHORT_WAVE
    exact, dt = theory(width, q), longest_explicit(width, spacing)
    rate = (step_factor(width, SHORT_WAVE, SHORT_WAVE / spacing, dt, device=device) - 1.0) / dt
    decay = np.exp(-memory(width) * spacing)
    peer = RATE * width * (np.sin(q * spacing) / spacing) ** 2
    peer *= -1.0 + GAMMA * (1.0 - decay) / (1.0 - decay * np.exp(-1j * q * spacing))
    print(f"spacing {spacing:g} m: {rate.real:+.4f}/yr, theory {exact.real:+.4f}, public codes {peer.real:+.4f}")
    assert exact.real == pytest.approx(SHORT_WAVE_DECAY, abs=5e-4)
    assert rate.real == pytest.approx(exact.real, rel=SHORT_WAVE_ERROR[spacing])


@pytest.mark.parametrize("kind", STEP_ORDER)
def test_time_step_is_first_order(kind, device):
    width, points = 50.0, 64  # so fine that the error of space is 4e-6 of the rate
    wavelength = FASTEST / memory(width)
    exact = theory(width, 2.0 * np.pi / wavelength)
    first = longest_explicit(width, wavelength / points)
    if kind == "implicit":
        first = 0.5 * float(stable_dt(width, bankfull_depth(width), DEFAULT))
    errors = []
    for halving in range(4):
        dt = first / 2**halving
        implicit = dt > longest_explicit(width, wavelength / points)
        assert implicit == (kind == "implicit")
        errors.append(abs(np.log(step_factor(width, wavelength, points, dt, device=device)) / dt - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"{kind} from {first:.4f} yr: relative errors {np.array(errors) / abs(exact)}, orders {orders.round(3)}")
    low, high = STEP_ORDER[kind]
    assert (orders > low).all() and (orders < high).all()


# Convergence of real bends with the spacing: rms distance in 4 yr from a run at 6.25 m, and how much it falls as the
# spacing halves. Second order gives 4.2 and 5.0 (the reference has a quarter of the finest spacing's error); measured
# 5.0 and 4.8 ("upstream"), 6.4 and 5.7 ("whole").
BEND_GAIN = (3.8, 4.3)
# The same for halving the step from 1/2 yr down, against 1/256 yr: first order gives 2.0 to 2.3; measured 1.9 to 2.2.
STEP_GAIN = (1.8, 2.5)


def bend_train(spacing):
    """Five bends of 1,226 m and sinuosity 1.5 (a fastest wave of a channel 100 m wide)."""
    return wr.generate.kinoshita(1226.0, 1.2, 5, spacing)


def distance_rms(xy, reference):
    """Rms distance in m of a line from another, without 1.5 km at both ends; the other is taken as a smooth curve."""
    from scipy.interpolate import CubicSpline

    count = len(reference)
    smooth = CubicSpline(np.arange(count), reference)(np.linspace(0, count - 1, 32 * (count - 1) + 1))
    s = wr.metrics.arc_length(xy)
    away = wr.metrics.migration(xy, smooth)[(s > 1500.0) & (s < s[-1] - 1500.0)]
    assert np.isfinite(away).all()
    return float(np.sqrt((away**2).mean()))


@pytest.mark.parametrize("scaling", ["upstream", "whole"])
def test_bends_converge_with_the_spacing(scaling, device):
    # So short that the finest spacing, too, has no implicit share, and the same for all.
    steps, years = 1214, 2.0
    assert years / steps < longest_explicit(100.0, 6.25)
    lines = []
    for spacing in (50.0, 25.0, 12.5, 6.25):
        params = plain_params(spacing=spacing, sinuosity_scaling=scaling, cutoff_distance=0.0)
        lines.append(phases.march(bend_train(spacing), 100.0, params, years / steps, steps, device=device))
    rms = np.array([distance_rms(line, lines[-1]) for line in lines[:-1]])
    print(f"{scaling}: rms distance {rms.round(4)} m at 50, 25, 12.5 m; falls by {(rms[:-1] / rms[1:]).round(2)}")
    assert (rms[:-1] / rms[1:] > BEND_GAIN).all()


@pytest.mark.parametrize("scaling", ["upstream", "whole"])
def test_bends_converge_with_the_time_step(scaling, device):
    # So fine that the implicit share of the local term, (8/9 D dt - h^2/4) q^2, is that of the step alone.
    params = plain_params(spacing=12.5, sinuosity_scaling=scaling, cutoff_distance=0.0)
    lines = [phases.march(bend_train(12.5), 100.0, params, 8.0 / n, n, device=device) for n in (16, 32, 64, 128, 2048)]
    rms = np.array([distance_rms(line, lines[-1]) for line in lines[:-1]])
    gain = rms[:-1] / rms[1:]
    print(f"{scaling}: rms distance {rms.round(3)} m at 1/2, 1/4, 1/8, 1/16 yr; falls by {gain.round(2)}")
    assert (gain > STEP_GAIN[0]).all() and (gain < STEP_GAIN[1]).all()


# ---- the longest step

# How much faster than in theory anything may grow in steps of ``stable_dt``: measured 1.00 to 1.10 (coarse grids).
OUTGROWTH = 1.15
# Waves below half the neutral one decay. In steps of so many ``stable_dt`` one of them grows: measured 12 to 37 by the
# grid, on some not within 100. So for small waves stable_dt is honest by a factor of ten.
SMALL_WAVE_MARGIN = 10.0
# No state of 300 yr, taken every 5 yr, crossed itself in unbroken steps of up to 16 stable_dt (w 50 and 200 m, spacing
# a quarter of the width); so tight bends leave room for a factor of four.
TIGHT_BEND_MARGIN = 4.0
# A channel's ends are held: not looked at, in widths.
END = 20.0


def never_part(patch):
    """Let a simulation do steps of any length in one."""

    def unlimited(width, *_):
        return np.full(len(width), np.inf), np.full(len(width), np.inf)

    make = models.MODELS[wr.MeanderParams]
    patch.setitem(models.MODELS, wr.MeanderParams, lambda params: dataclasses.replace(make(params), limits=unlimited))


def impulse_response(width, spacing, time_step, monkeypatch, *, device):
    """Wave numbers and the complex factors by which one unbroken step multiplies each wave of the grid."""
    never_part(monkeypatch)
    count = 1024
    xy = np.column_stack([spacing * np.arange(count + 1), np.zeros(count + 1)])
    xy[count // 4, 1] = 1e-4
    params = plain_params(spacing=spacing, time_step=time_step, end_damping=0.0, cutoff_distance=0.0)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([xy], width=width), params, capture=False, device=device)
    before = np.fft.rfft(sim.network.polylines()[0][:, 1])
    sim.step()
    assert sim.substeps == 1
    after = np.fft.rfft(sim.network.polylines()[0][:, 1])
    return 2.0 * np.pi * np.fft.rfftfreq(count + 1, spacing)[1:], (after / before)[1:]


@pytest.mark.parametrize("width", [20.0, *WIDTHS, 500.0])
@pytest.mark.parametrize("part", [1.0, 0.25])
def test_small_waves_behave_in_steps_of_stable_dt(width, part, monkeypatch, device):
    spacing, honest = part * width, float(stable_dt(width, bankfull_depth(width), DEFAULT))

    def short_waves_decay(time_step):
        q, factor = impulse_response(width, spacing, time_step, monkeypatch, device=device)
        short = q > 4.0 * np.pi * memory(width) / NEUTRAL
        return not short.any() or abs(factor[short]).max() < 1.0

    q, factor = impulse_response(width, spacing, honest, monkeypatch, device=device)
    worst = (np.log(abs(factor)) / honest).max() / theory(width, q).real.max()
    low, high = 1.0, 128.0
    while high / low > 1.05:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if short_waves_decay(middle * honest) else (low, middle)
    print(
        f"w {width:g} m, spacing {spacing:g} m: stable_dt {honest:.3f} yr; in it the fastest growth is {worst:.3f} of "
        f"theory's; damped waves grow from {low:.1f} stable_dt on"
    )
    assert short_waves_decay(honest)
    assert worst < OUTGROWTH
    assert low > SMALL_WAVE_MARGIN


def crossing_share(width, multiple, monkeypatch, *, device):
    """Share of states of 300 yr that cross themselves in unbroken steps of so many ``stable_dt``, and the sinuosity."""
    spacing = 0.25 * width
    honest = float(stable_dt(width, bankfull_depth(width), DEFAULT))
    with monkeypatch.context() as patch:
        never_part(patch)
        sim = noisy_run(width, plain_params(spacing=spacing, time_step=multiple * honest), 6, 150.0, device=device)
    crossing, bent = [], []

    def look(sim):
        for xy in sim.network.polylines():
            crossing.append(len(crossings(xy)) > 0)
            bent.append(wr.metrics.sinuosity(xy))

    history = sim.run(years=300, record_every=10**6, callbacks=[(wr.history.Every(years=5), look)])
    assert history.stop_reason is wr.history.StopReason.COMPLETED
    return float(np.mean(crossing)), max(bent)


def noisy_run(width, params, channels, length, *, device):
    """Simulation of channels that are straight but for a noise of a twentieth of the width; length in widths."""
    lines = []
    for seed in range(channels):
        line = wr.generate.noisy_line(length * width, params.spacing, width / 20.0, seed)
        line[:, 1] += 400.0 * width * seed
        lines.append(line)
    return wr.Simulation(wr.RiverNetwork.from_polylines(lines, width=width), params, device=device)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("multiple", [1.0, TIGHT_BEND_MARGIN])
def test_tight_bends_behave_in_steps_of_stable_dt_and_far_above(width, multiple, monkeypatch, device):
    share, bent = crossing_share(width, multiple, monkeypatch, device=device)
    print(
        f"w {width:g} m: states that cross themselves {share:.1%} in steps of {multiple:g} stable_dt (sinuosity up to "
        f"{bent:.2f})"
    )
    assert share == 0.0
    assert bent < SINUOSITY_LIMIT


@pytest.mark.parametrize("time_step", [0.1, 1.0, 10.0])
def test_long_steps_are_done_in_honest_sub_steps(time_step, device):
    sim = noisy_run(100.0, plain_params(spacing=50.0, time_step=time_step), 3, 200.0, device=device)
    farthest = []

    def travel(sim):
        """Greatest distance that a point went in a part of the step, in widths."""
        farthest.append(sim.stepper.state.max_speed.numpy().max() * time_step / sim.substeps / 100.0)

    history = sim.run(years=300, record_every=10**6, callbacks=[travel])
    assert max(farthest) < 1.0
    bent = [wr.metrics.sinuosity(xy) for xy in sim.network.polylines()]
    cutoffs = len(history.cutoffs)
    print(f"step {time_step:g} yr in {sim.substeps}: sinuosity {np.round(bent, 2)} after 300 yr, {cutoffs} cutoffs")
    assert history.stop_reason is wr.history.StopReason.COMPLETED
    assert 1.5 < min(bent) and max(bent) < SINUOSITY_LIMIT


# ---- what does not move, and symmetries

# A straight line at an angle has rounding errors of 1e-12 m at 15 km; theory lets them grow by e^(0.12/yr * 30 yr), 40.
STRAIGHT_DRIFT = 1e-9
# On a circle the curvature of three points is exact but for rounding: 1e-12 m in 25 m chords, squared: 1e-15 of 1e-3.
CIRCLE_ERROR = 1e-11
# Fourth order was found for the curvature of smooth bends (measured 3.99); second order was asked for.
CURVATURE_ORDER = 3.8
# Lines on a grid of 2^-10 m, so that moving them by whole metres is exact. What is left is the rounding of absolute
# coordinates when they are read back: half a unit in the last place of 4.6e6 m, 5e-10 m.
WHOLE_METRES = 1e-9
# Turning by an angle rounds every coordinate, 2e-12 m; tight bends and cutoffs amplify it (the spec has 1e-9 m grow to
# 9e-8 m in 100 steps). Measured 2e-11 m for any angle, 0 for a mirror image and a quarter turn.
TURNED, MIRRORED = 1e-8, 1e-10
# float32 resolves 2.4e-4 m at 3 km, and bends amplify it; measured 7e-4 m after 20 steps, with room for another order
# of the same operations.
FLOAT32 = 0.02
# UTM coordinates of real rivers, m.
UTM = (500_000.0, 4_600_000.0)


def necked_line():
    """Bends that are about to be cut off, on a grid of 2^-10 m."""
    xy = wr.generate.kinoshita(1300.0, 2.12, 5, 50.0)
    return np.round(xy * 1024.0) / 1024.0


def after_steps(xy, dtype="float64", steps=20, *, device, **changes):
    """Line and cutoffs after some steps of the default length."""
    params = plain_params(**({"spacing": 50.0} | changes))
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([xy], width=100.0, dtype=dtype), params, device=device)
    history = sim.run(steps=steps)
    return sim.network.polylines()[0], history.cutoffs


@pytest.mark.parametrize("degrees", [0.0, 33.0, 90.0])
def test_straight_reach_stays_where_it_is(degrees, device):
    angle = np.deg2rad(degrees)
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    xy, cutoffs = after_steps(np.outer(np.linspace(0.0, 15_000.0, 301), along), steps=100, device=device)
    drift = abs(xy @ across).max()
    print(f"straight at {degrees:g} degrees: {drift:.1e} m off after 100 steps")
    assert drift < STRAIGHT_DRIFT and not cutoffs
    assert np.diff(xy @ along) == pytest.approx(50.0, abs=STRAIGHT_DRIFT)


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_circle_moves_outwards_by_k_w_over_r(turn, device):
    radius, width = 1000.0, 50.0
    angle = np.linspace(0.0, 0.75 * np.pi, 95)
    arc = radius * np.column_stack([np.sin(angle), turn * (1.0 - np.cos(angle))])
    params = plain_params(upstream_weight=0.0, sinuosity_scaling="none")
    # The local weight is -1: the local term alone moves a left turn to the left, towards its centre.
    expected = -RATE * width / radius * turn
    rate = phases.rate_of(arc, width, params, device=device)[3:-3]
    worst = abs(rate / expected - 1.0).max()
    print(f"circle: rate {rate.mean():+.6f} m/yr, expected {expected:+.6f}; worst error {worst:.1e}")
    assert rate == pytest.approx(expected, rel=CIRCLE_ERROR)
    assert wr.metrics.curvature(arc) == pytest.approx(turn / radius, rel=CIRCLE_ERROR)
    # With both terms, far down the arc, the rate is (gamma - 1) k w / R to the right: the bend widens.
    both = phases.rate_of(arc, width, plain_params(sinuosity_scaling="none"), device=device)[-10]
    assert both == pytest.approx((GAMMA - 1.0) * RATE * width / radius * turn, rel=1e-6)


def test_curvature_of_bends_is_fourth_order(device):
    wavelength, bend = 1226.0, 1.2
    from scipy.special import j0

    arc = wavelength / j0(bend)  # theta = bend sin(2 pi s / arc)
    error = []
    for count in (24, 48, 96):
        xy = wr.generate.sine_generated(wavelength, bend, 6, arc / count)
        s = arc / count * np.arange(len(xy))
        exact = bend * 2.0 * np.pi / arc * np.cos(2.0 * np.pi * s / arc)
        error.append(abs(phases.curvature_of(xy, device=device) - exact)[10:-10].max() / abs(exact).max())
    orders = np.log2(np.array(error[:-1]) / error[1:])
    print(f"curvature of a sine-generated bend at 24, 48, 96 points: errors {error}, orders {orders.round(2)}")
    assert (orders > CURVATURE_ORDER).all()


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("offset", [(1.0, -7.0), UTM])
def test_moving_the_map_by_whole_metres_moves_the_result(dtype, offset, device):
    here, cutoffs = after_steps(necked_line(), dtype, device=device)
    there, cutoffs_there = after_steps(necked_line() + offset, dtype, device=device)
    assert len(cutoffs) == len(cutoffs_there) > 0 and here.shape == there.shape
    error = abs(there - offset - here).max()
    error = max(error, *(abs(b.xy - offset - a.xy).max() for a, b in zip(cutoffs, cutoffs_there, strict=True)))
    print(f"{dtype}, moved by {offset}: {error:.1e} m apart after 20 steps and {len(cutoffs)} cutoffs")
    assert error <= WHOLE_METRES


@pytest.mark.parametrize("degrees", [30.0, 90.0, 217.0])
def test_turning_the_map_turns_the_result(degrees, device):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = np.array([[c, s], [-s, c]])
    here, cutoffs = after_steps(necked_line(), device=device)
    there, cutoffs_there = after_steps(necked_line() @ turn, device=device)
    assert len(cutoffs) == len(cutoffs_there) > 0 and here.shape == there.shape
    error = abs(there - here @ turn).max()
    print(f"turned by {degrees:g} degrees: {error:.1e} m apart after 20 steps and {len(cutoffs)} cutoffs")
    assert error < TURNED


def test_mirror_image_evolves_as_a_mirror_image(device):
    flip = np.array([1.0, -1.0])
    here, cutoffs = after_steps(necked_line(), device=device)
    there, cutoffs_there = after_steps(necked_line() * flip, device=device)
    assert len(cutoffs) == len(cutoffs_there) > 0 and here.shape == there.shape
    error = abs(there * flip - here).max()
    print(f"mirrored: {error:.1e} m apart after 20 steps and {len(cutoffs)} cutoffs")
    assert error < MIRRORED


def test_float32_follows_float64(device):
    double, cutoffs = after_steps(necked_line(), device=device)
    single, cutoffs32 = after_steps(necked_line(), "float32", device=device)
    assert len(cutoffs) == len(cutoffs32) and double.shape == single.shape
    apart = abs(double - single).max()
    print(f"float32 and float64: {apart:.1e} m apart after 20 steps and {len(cutoffs)} cutoffs")
    assert apart < FLOAT32


# ---- statistics and the literature


# Runs from noise, four channels of 300 widths. The paper's Table 3 and Section 8.3: sinuosity of its scenes, and the
# wavelengths of real rivers by width.
PAPER_SINUOSITY = (1.9, 3.8)
PAPER_WAVELENGTH = {50.0: (314.0, 990.0), 100.0: (628.0, 2150.0), 200.0: (1256.0, 4674.0)}
CHANNELS, LENGTH = 4, 300.0
YOUNG, OLD = 400, 2000  # yr
# Standard deviation of the sinuosity over the last 1,000 yr, of the mean of four channels: measured 0.09 to 0.30.
SINUOSITY_SPREAD = 0.5
# How much more bent than with cutoffs a channel becomes without: measured 1.4 ("upstream", which saturates) and 5.3.
UNCUT = {"upstream": 1.25, "whole": 2.5}
# Oxbow lengths in widths (geometric mean) and the standard deviation of their logarithm. meanderpy, which scales the
# whole rate, has 19 to 23 w and 0.60 to 0.63; measured here, so at w = 200 m, 24.5 w and 0.43 over 2,000 yr.
OXBOW_WHOLE, OXBOW_SD = (19.0, 29.0), (0.3, 0.65)
# Kolmogorov distance of 3,200 lengths from the lognormal and from the normal fitted to them: measured 0.072 and 0.148.
LOGNORMAL_DISTANCE = 0.1
# Celerity of noise while its bends are small, against the theory of the fastest wave: the waves that have grown from
# noise are spread about it, from the neutral one at 1.6 times that celerity to long ones at half of it.
CELERITY = (0.5, 1.6)
# Lag of migration behind curvature, in widths, after 400 yr, mean of the channels: measured 3.2 to 5.2 ("upstream"),
# 1.7 to 2.5 ("whole"); real rivers 2.4 to 4.4.
LAG = (1.0, 6.0)


@pytest.fixture(scope="module")
def grown(made_once):
    """State every 100 yr of channels that have grown from noise for 2,000 yr, and the cutoffs."""

    def ask(width, scaling, *, device):
        return made_once(
            f"{scaling} {width:g} {device}".replace(":", " "), lambda: grow(width, scaling, OLD, device=device)
        )

    return ask


def grow(width, scaling, years, *, device):
    params = plain_params(sinuosity_scaling=scaling)
    sim = noisy_run(width, params, CHANNELS, LENGTH, device=device)
    times, lines = [], []

    def look(sim):
        times.append(sim.time)
        lines.append(sim.network.polylines())

    history = sim.run(years=years, record_every=10**6, callbacks=[(wr.history.Every(years=100), look)])
    assert history.stop_reason is wr.history.StopReason.COMPLETED
    sinuosity = np.array([[wr.metrics.sinuosity(xy) for xy in state] for state in lines])
    return SimpleNamespace(times=np.array(times), lines=lines, sinuosity=sinuosity, cutoffs=list(history.cutoffs))


def state_at(run, years):
    return run.lines[int(np.argmin(abs(run.times - years)))]


@pytest.mark.parametrize("scaling", ["upstream", "whole"])
@pytest.mark.parametrize("width", WIDTHS)
def test_wavelength_and_sinuosity_after_400_years(grown, width, scaling, device):
    """Section 8.3 of the paper defines a wavelength as the spacing of two inflection points, half a meander.

    With the scaling that it prints (the default), wavelengths by that definition lie within its numbers. The laws
    behind the numbers, though, are for whole meanders of two bends. Scaling the whole rate, as its authors' code does,
    gives wavelengths that lie within them by that meaning; both are printed.
    """
    run = grown(width, scaling, device=device)
    lines = state_at(run, YOUNG)
    half = float(np.mean([wr.metrics.wavelength(xy, width, half=True) for xy in lines]))
    bent = float(np.mean([wr.metrics.sinuosity(xy) for xy in lines]))
    low, high = PAPER_WAVELENGTH[width]
    at_100 = float(np.mean([wr.metrics.wavelength(xy, width, half=True) for xy in state_at(run, 100)]))
    print(
        f"{scaling}, w {width:g} m: after 400 yr half {half:.0f} m, whole {2 * half:.0f} m, paper [{low:g}, {high:g}]; "
        f"after 100 yr {at_100:.0f} and {2 * at_100:.0f} m; sinuosity {bent:.2f}"
    )
    assert low <= (half if scaling == "upstream" else 2.0 * half) <= high
    assert PAPER_SINUOSITY[0] <= bent <= PAPER_SINUOSITY[1]


@pytest.mark.parametrize("scaling", ["upstream", "whole"])
@pytest.mark.parametrize("width", WIDTHS)
def test_cutoffs_keep_sinuosity_bounded_for_2000_years(grown, width, scaling, device):
    run = grown(width, scaling, device=device)
    late = run.sinuosity[run.times > 999.0]
    print(
        f"{scaling}, w {width:g} m: sinuosity over the last 1,000 yr {late.mean():.2f}, spread of the mean of "
        f"{CHANNELS} channels {late.mean(axis=1).std():.2f}, of one {late.std():.2f}, highest {late.max():.2f}; "
        f"{len(run.cutoffs)} cutoffs"
    )
    assert run.sinuosity.max() < SINUOSITY_LIMIT
    assert late.mean(axis=1).std() < SINUOSITY_SPREAD
    if scaling == "upstream":
        assert PAPER_SINUOSITY[0] < late.mean() < PAPER_SINUOSITY[1]
    # With "whole", narrow channels straighten again: nothing disturbs the head, and bends are carried out at the lower
    # end faster than they spread up (30 m/yr against 15 km at w = 50 m; mean 1.4 to 1.6 there).


@pytest.mark.parametrize("scaling", UNCUT)
def test_without_cutoffs_channels_become_much_more_bent(grown, scaling, device):
    params = plain_params(sinuosity_scaling=scaling, cutoff_distance=0.0)
    sim = noisy_run(100.0, params, 1, LENGTH, device=device)
    history = sim.run(years=500, record_every=10**6)
    bent = wr.metrics.sinuosity(sim.network.polylines()[0])
    run = grown(100.0, scaling, device=device)
    cut = run.sinuosity[run.times > 999.0].mean()
    print(
        f"{scaling}: sinuosity {bent:.2f} after 500 yr without cutoffs, {cut:.2f} with; saturates at {SATURATION:.2f}"
    )
    assert history.stop_reason is wr.history.StopReason.COMPLETED and not history.cutoffs
    assert bent > UNCUT[scaling] * cut
    if scaling == "upstream":
        assert bent < SATURATION


def test_bends_travel_downstream(device):
    width, early, late = 100.0, 30.0, 32.0
    sim = noisy_run(width, plain_params(time_step=0.1), 1, LENGTH, device=device)
    offset = {}
    for years in (early, late):
        sim.run(years=years - sim.time, record_every=10**6)
        x, y = sim.network.polylines()[0].T
        grid = np.arange(0.1 * x[-1], 0.9 * x[-1], 5.0)
        offset[years] = np.interp(grid, x, y)
    # ``lag`` takes a rate, positive to the left, that answers curvature to the right: so minus the later line.
    shift = wr.metrics.lag(offset[early], -offset[late], 5.0, max_lag=300.0)
    q = 2.0 * np.pi * memory(width) / FASTEST
    expected = -theory(width, q).imag / q
    slope = abs(np.gradient(offset[late], 5.0)).max()
    print(f"bends of slope {slope:.3f} travel {shift / 2:.1f} m/yr; theory of the fastest wave {expected:.1f} m/yr")
    assert CELERITY[0] * expected < shift / (late - early) < CELERITY[1] * expected


@pytest.mark.parametrize("scaling", ["upstream", "whole"])
@pytest.mark.parametrize("width", WIDTHS)
def test_migration_lags_curvature(grown, width, scaling, device):
    params = plain_params(sinuosity_scaling=scaling)
    lags = []
    for xy in state_at(grown(width, scaling, device=device), YOUNG):
        away = slice(round(END * width / 50.0), -round(END * width / 50.0))
        rate, spacing = phases.rate_of(xy, width, params, device=device), wr.metrics.arc_length(xy)[-1] / (len(xy) - 1)
        lags.append(wr.metrics.lag(wr.metrics.curvature(xy)[away], -rate[away], spacing, max_lag=8.0 * width) / width)
    print(f"{scaling}, w {width:g} m: migration lags curvature by {np.round(lags, 2)} widths")
    assert LAG[0] < np.mean(lags) < LAG[1]


def test_oxbow_lengths_are_lognormal(grown, device):
    """Whole-rate scaling gives meanderpy's lengths; scaling the upstream term alone gives longer loops.

    There a sinuosity of 2.6 lowers gamma to 1.3 but not the local term, so bends below 11 / alpha instead of 5 / alpha
    smooth out, and only long loops last until they close.
    """
    from scipy.stats import kstest

    means = {}
    for scaling in ("whole", "upstream"):
        for width in WIDTHS:
            lengths = wr.metrics.oxbow_lengths(grown(width, scaling, device=device).cutoffs) / width
            fit = wr.metrics.lognormal_fit(lengths)
            z = (np.log(lengths) - np.log(fit.geometric_mean)) / fit.log_sd
            distance = kstest(z, "norm").statistic
            plain = kstest((lengths - lengths.mean()) / lengths.std(ddof=1), "norm").statistic
            means[scaling, width] = fit.geometric_mean
            print(
                f"{scaling}, w {width:g} m: {len(lengths)} oxbows, geometric mean {fit.geometric_mean:.1f} w, sd of ln "
                f"{fit.log_sd:.2f}; distance from lognormal {distance:.3f}, from normal {plain:.3f}"
            )
            assert distance < LOGNORMAL_DISTANCE and distance < plain
            assert OXBOW_SD[0] < fit.log_sd < OXBOW_SD[1]
    assert OXBOW_WHOLE[0] < means["whole", 200.0] < OXBOW_WHOLE[1]
    assert all(means["upstream", width] > 1.3 * means["whole", width] for width in WIDTHS)


# ---- channels whose width varies

# A narrow reach with a wide one far below: the wide one cannot act on it (flow carries everything downstream), so what
# is left is the smoothing's reach of some points and rounding.
NARROW_ERROR = 0.01
NARROW, WIDE = 50.0, 1000.0


def test_narrow_reach_migrates_as_if_the_river_were_narrow_throughout(device):
    """The implicit share of the local term must be that of the width at the point, not of the widest one."""
    wavelength = FASTEST / memory(NARROW)
    h, q, dt = wavelength / 16, 2.0 * np.pi / wavelength, DEFAULT.time_step
    x = h * np.arange(60 * 16 + 1)
    line = np.column_stack([x, AMPLITUDE * np.sin(q * x)])
    rates = []
    for wide in (NARROW, WIDE):
        width = np.where(x < 40 * wavelength, NARROW, wide)
        params = plain_params(spacing=h, end_damping=0.0, cutoff_distance=0.0)
        sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=[width]), params, device=device)
        amplitude = []
        for _ in range(2):
            x1, y1 = sim.network.polylines()[0][15 * 16 : 35 * 16].T
            amplitude.append(np.linalg.lstsq(np.column_stack([np.cos(q * x1), np.sin(q * x1)]), y1, rcond=None)[0])
            sim.step()
        rates.append(np.log(np.hypot(*amplitude[1]) / np.hypot(*amplitude[0])) / dt)
    print(f"growth in the narrow reach {rates[0]:+.4f}/yr alone, {rates[1]:+.4f}/yr above a reach {WIDE:g} m wide")
    assert rates[1] == pytest.approx(rates[0], rel=NARROW_ERROR)


def test_narrow_reach_is_cut_off_as_if_the_river_were_narrow_throughout(device):
    """Neighbours along the channel are told by the width at the point: no loop of 2 km is a neighbour at 50 m width."""
    loops, crossing = {}, {}
    for wide in (NARROW, WIDE):
        line = wr.generate.noisy_line(30_000.0, 50.0, 2.5, 1)
        width = np.interp(line[:, 0], [20_000.0, 22_000.0], [NARROW, wide])
        sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=[width]), DEFAULT, device=device)
        states = []

        def look(sim, states=states):
            narrow = sim.network.point_widths()[0] < 1.01 * NARROW
            pairs = crossings(sim.network.polylines()[0])
            states.append(bool(narrow[pairs].all(axis=1).any()))

        history = sim.run(years=400, record_every=10**6, callbacks=[(wr.history.Every(years=10), look)])
        cut = [c for c in history.cutoffs if c.width < 1.01 * NARROW]
        loops[wide] = float(np.median(wr.metrics.oxbow_lengths(cut))) if cut else np.nan
        crossing[wide] = np.mean(states)
        print(
            f"lower reach {wide:g} m wide: {len(cut)} loops of the narrow reach cut off, median {loops[wide]:.0f} m; "
            f"it crosses itself in {crossing[wide]:.0%} of the states"
        )
    assert crossing[NARROW] == crossing[WIDE] == 0.0
    assert loops[WIDE] == pytest.approx(loops[NARROW], rel=0.5)
