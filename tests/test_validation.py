"""The meander model against closed forms, symmetries and the literature; run with -s to see the figures measured."""

import functools
from types import SimpleNamespace

import numpy as np
import phases
import pytest

import warpriver as wr
from warpriver.meander.migration import explicit_dt, stable_dt
from warpriver.network import bankfull_depth

WIDTHS = (50.0, 100.0, 200.0)
DEFAULT = wr.MeanderParams()
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


# ---- linear theory


# Two per cent were asked for at 16 points a wavelength; 0.10 % at most was measured (the error of fourth-order curvature
# and quadrature, (q h)^4 / 24), so three times that.
LINEAR_ERROR = 0.003
# Measured 3.97 to 3.99; second order was asked for. Below 3.8 one of the two fourth-order corrections is lost.
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


def step_factor(width, wavelength, points, time_step, steps=4):
    """What one step of ``time_step`` yr multiplies a small wave by (complex), from a least-squares fit.

    The mean of so few steps that the wave cannot have gone half its length: the root would take another branch.
    """
    h, q = wavelength / points, 2.0 * np.pi / wavelength
    assert h <= width
    x = h * np.arange(round(WAVES * points) + 1)
    start = np.column_stack([x, AMPLITUDE * np.sin(q * x)])
    params = wr.MeanderParams(spacing=h, end_damping=0.0, cutoff_distance=0.0)

    def amplitude(xy):
        x, y = xy[(xy[:, 0] > ZONE[0] * start[-1, 0]) & (xy[:, 0] < ZONE[1] * start[-1, 0])].T
        a, b = np.linalg.lstsq(np.column_stack([np.cos(q * x), np.sin(q * x)]), y, rcond=None)[0]
        return a - 1j * b

    end = phases.march(start, width, params, time_step, steps)
    return (amplitude(end) / amplitude(start)) ** (1.0 / steps)


def longest_explicit(width, spacing):
    """Longest step in which nothing of the local term is implicit, yr (a hair less)."""
    return 0.99 * float(explicit_dt(width, wr.MeanderParams(spacing=spacing)))


def space_error(width, wavelength, points):
    """Complex error of the rate without that of the time step: explicit Euler multiplies by 1 + s dt exactly."""
    dt = longest_explicit(width, wavelength / points)
    return (step_factor(width, wavelength, points, dt) - 1.0) / dt - theory(width, 2.0 * np.pi / wavelength)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("alpha_wavelength", [FASTEST, NEUTRAL, SHORTER, LONGER])
def test_small_waves_grow_and_travel_as_in_theory(width, alpha_wavelength):
    wavelength = alpha_wavelength / memory(width)
    q = 2.0 * np.pi / wavelength
    exact, scale = theory(width, q), RATE * width * q**2
    points = max(16, int(np.ceil(wavelength / width)))  # the spacing may not exceed the width
    errors = np.array([space_error(width, wavelength, points * m) for m in (1, 2, 4)])
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


def test_fastest_and_neutral_wave_lie_where_theory_has_them():
    for width in WIDTHS:
        a = memory(width)
        rates = {r: theory(width, 2.0 * np.pi * a / r).real for r in (FASTEST, 0.98 * FASTEST, 1.02 * FASTEST, NEUTRAL)}
        assert max(rates, key=rates.get) == FASTEST
        # The spec gives both wavelengths and the growth to four digits.
        assert rates[FASTEST] == pytest.approx(0.3377 * RATE * width * a**2, rel=2e-4)
        assert abs(rates[NEUTRAL]) < 1e-3 * rates[FASTEST]


@pytest.mark.parametrize("spacing", SHORT_WAVE_ERROR)
def test_short_wave_decays_where_public_codes_let_it_grow(spacing):
    width, q = 50.0, 2.0 * np.pi / SHORT_WAVE
    exact, dt = theory(width, q), longest_explicit(width, spacing)
    rate = (step_factor(width, SHORT_WAVE, SHORT_WAVE / spacing, dt) - 1.0) / dt
    decay = np.exp(-memory(width) * spacing)
    peer = RATE * width * (np.sin(q * spacing) / spacing) ** 2
    peer *= -1.0 + GAMMA * (1.0 - decay) / (1.0 - decay * np.exp(-1j * q * spacing))
    print(f"spacing {spacing:g} m: {rate.real:+.4f}/yr, theory {exact.real:+.4f}, public codes {peer.real:+.4f}")
    assert exact.real == pytest.approx(SHORT_WAVE_DECAY, abs=5e-4)
    assert rate.real == pytest.approx(exact.real, rel=SHORT_WAVE_ERROR[spacing])


@pytest.mark.parametrize("kind", STEP_ORDER)
def test_time_step_is_first_order(kind):
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
        errors.append(abs(np.log(step_factor(width, wavelength, points, dt)) / dt - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"{kind} from {first:.4f} yr: relative errors {np.array(errors) / abs(exact)}, orders {orders.round(3)}")
    low, high = STEP_ORDER[kind]
    assert (orders > low).all() and (orders < high).all()
