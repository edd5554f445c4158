"""Synthetic centrelines against their closed forms."""

import numpy as np
import pytest
from scipy.special import j0

from warpriver import metrics
from warpriver.generate import kinoshita, noisy_line, sine_generated, straight_line, valley_line

# Quadrature and summation errors of coordinates of some kilometres, m.
ROUNDING = 1e-8


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, 1.9, 2.3])
def test_sine_generated_has_the_wavelength_and_sinuosity_asked_for(angle):
    xy = sine_generated(800.0, angle, 3, 1.0)
    assert xy.dtype == np.float64
    np.testing.assert_array_equal(xy[0], [0.0, 0.0])
    np.testing.assert_allclose(xy[-1], [2400.0, 0.0], atol=ROUNDING)
    # Chords of 1 m on radii above 40 m are short by less than h^2 C^2 / 24 = 3e-5 of their length.
    assert metrics.sinuosity(xy) == pytest.approx(1.0 / j0(angle), rel=3e-5)


def test_sine_generated_points_are_even_in_arc_length():
    angle, spacing = 1.8, 7.0
    xy = sine_generated(700.0, angle, 2.5, spacing)
    arc = 700.0 / j0(angle)
    step = 2.5 * arc / (len(xy) - 1)
    assert step == pytest.approx(spacing, rel=0.5 / (len(xy) - 2))
    h = np.diff(metrics.arc_length(xy))
    # A chord of an arc of `step` at the largest curvature C = angle 2 pi / M is short by (step C)^2 / 24.
    assert h.max() <= step + ROUNDING
    assert h.min() >= step * (1.0 - (step * angle * 2.0 * np.pi / arc) ** 2 / 23.0)


def test_sine_generated_starts_in_a_left_bend_of_known_curvature():
    wavelength, angle, spacing = 1000.0, 1.2, 2.0
    xy = sine_generated(wavelength, angle, 2, spacing)
    k = 2.0 * np.pi * j0(angle) / wavelength
    s = np.linspace(0.0, 2.0 * wavelength / j0(angle), len(xy))
    exact = angle * k * np.cos(k * s)
    # Second order: (k h)^2 is 7e-5 here; the linear continuation to the two ends costs as much again.
    np.testing.assert_allclose(metrics.curvature(xy), exact, atol=3e-4 * angle * k)


def test_sine_generated_points_lie_on_one_curve_at_every_spacing():
    arc = 2 * 900.0 / j0(1.5)
    coarse, fine = (sine_generated(900.0, 1.5, 2, arc / count) for count in (16, 256))
    np.testing.assert_allclose(fine[::16], coarse, atol=ROUNDING)


def test_kinoshita_without_its_third_harmonic_is_sine_generated():
    np.testing.assert_array_equal(
        kinoshita(600.0, 1.4, 2, 5.0, skewness=0.0, flatness=0.0), sine_generated(600.0, 1.4, 2, 5.0)
    )


@pytest.mark.parametrize("skewness", [-1 / 32, 0.0, 1 / 32])
def test_kinoshita_runs_along_x_with_the_wavelength_asked_for(skewness):
    xy = kinoshita(600.0, 1.7, 4, 3.0, skewness=skewness)
    np.testing.assert_allclose(xy[-1], [2400.0, 0.0], atol=ROUNDING)
    raw = metrics.bends(xy)
    np.testing.assert_allclose(raw.chord[1:] + raw.chord[:-1], 2 * raw.chord.mean(), rtol=1e-3)


def loop_lean(xy):
    """Distance along x from the axis of the highest loop at its half height to its tip, m."""
    tip = int(np.argmax(xy[: len(xy) // 2, 1]))
    bend = int(len(xy) / 8)  # half a bend of two wavelengths
    height = 0.5 * (xy[:, 1].min() + xy[:, 1].max())
    up, down = xy[tip - bend : tip + 1], xy[tip : tip + bend + 1][::-1]
    axis = 0.5 * (np.interp(height, up[:, 1], up[:, 0]) + np.interp(height, down[:, 1], down[:, 0]))
    return xy[tip, 0] - axis


def test_positive_skewness_leans_upstream_and_negative_is_its_mirror_image():
    up = kinoshita(1000.0, 1.5, 2, 1.0, skewness=1 / 32)
    down = kinoshita(1000.0, 1.5, 2, 1.0, skewness=-1 / 32)
    assert loop_lean(up) < -20.0
    assert loop_lean(down) > 20.0
    apex = metrics.bends(up)
    assert np.all((apex.apex - apex.start) / apex.arc < 0.4)
    apex = metrics.bends(down)
    assert np.all((apex.apex - apex.start) / apex.arc > 0.6)
    np.testing.assert_allclose(down[::-1] * [-1, 1] + [2000.0, 0.0], up, atol=1e-6)


def test_flatness_lowers_the_curvature_at_the_apex():
    peak = [
        np.abs(metrics.bends(kinoshita(1000.0, 1.3, 2, 2.0, skewness=0.0, flatness=f)).curvature).max()
        for f in (-1 / 48, 0.0, 1 / 48)
    ]
    assert peak[0] > peak[1] > peak[2]


def test_straight_line():
    xy = straight_line(1000.0, 30.0)
    assert xy.shape == (34, 2)
    np.testing.assert_allclose(np.diff(xy[:, 0]), 1000.0 / 33, rtol=1e-12)
    np.testing.assert_array_equal(xy[:, 1], 0.0)
    np.testing.assert_array_equal(xy[[0, -1]], [[0.0, 0.0], [1000.0, 0.0]])
    assert straight_line(10.0, 9.0).shape == (3, 2)


def test_noisy_line_is_seeded_bounded_and_held_at_its_ends():
    xy = noisy_line(15000.0, 50.0, 2.5, seed=7)
    assert xy.shape == (301, 2)
    np.testing.assert_array_equal(xy, noisy_line(15000.0, 50.0, 2.5, seed=7))
    assert not np.allclose(xy, noisy_line(15000.0, 50.0, 2.5, seed=8))
    assert np.abs(xy[:, 1]).max() == pytest.approx(2.5, rel=1e-12)
    np.testing.assert_array_equal(xy[[0, -1]], [[0.0, 0.0], [15000.0, 0.0]])
    np.testing.assert_allclose(np.diff(xy[:, 0]), 50.0, rtol=1e-12)


def test_noisy_line_fades_towards_its_ends():
    xy = noisy_line(10000.0, 10.0, 5.0, seed=1, correlation=50.0, taper=0.3)
    free = noisy_line(10000.0, 10.0, 5.0, seed=1, correlation=50.0, taper=0.0)
    # 300 m from the end is a tenth of the way up a smoothstep, 3 (1/10)^2 - 2 (1/10)^3 = 0.028 of the noise.
    near = slice(1, 30)
    assert np.abs(xy[near, 1]).max() < 0.1 * np.abs(free[near, 1]).max()
    np.testing.assert_array_equal(free[[0, -1], 1], 0.0)


@pytest.mark.parametrize("correlation", [40.0, 160.0])
def test_noisy_line_is_as_smooth_as_its_correlation_length(correlation):
    y = noisy_line(400e3, 10.0, 5.0, seed=3, correlation=correlation)[:, 1]
    # White noise through a Gaussian of sd c has mean slope^2 / mean height^2 = 1 / (2 c^2).
    measured = np.sqrt(0.5 * np.mean(y**2) / np.mean(np.gradient(y, 10.0) ** 2))
    # A sample of 400 km / 160 m = 2500 independent values: 5 % is more than three standard errors.
    assert measured == pytest.approx(correlation, rel=0.05)


def test_valley_line_wanders_evenly_within_its_amplitude():
    xy = valley_line(20e3, 40.0, 600.0, 5e3, seed=11)
    np.testing.assert_array_equal(xy, valley_line(20e3, 40.0, 600.0, 5e3, seed=11))
    np.testing.assert_allclose(xy[[0, -1]], [[0.0, 0.0], [20e3, 0.0]], atol=1e-9)
    assert 595.0 < np.abs(xy[:, 1]).max() <= 600.0
    h = np.diff(metrics.arc_length(xy))
    np.testing.assert_allclose(h, h.mean(), rtol=0.01)
    assert h.mean() == pytest.approx(40.0, rel=0.01)
    assert metrics.sinuosity(xy) < 1.5


@pytest.mark.parametrize(
    "call",
    [
        lambda: sine_generated(0.0, 1.0, 2, 5.0),
        lambda: sine_generated(100.0, -0.1, 2, 5.0),
        lambda: sine_generated(100.0, 2.405, 2, 5.0),
        lambda: sine_generated(100.0, 7.0, 2, 5.0),
        lambda: sine_generated(100.0, np.nan, 2, 5.0),
        lambda: sine_generated(100.0, 1.0, 0, 5.0),
        lambda: sine_generated(100.0, 1.0, 2, 100.0),
        lambda: sine_generated(100.0, 1.0, 2, -1.0),
        lambda: kinoshita(100.0, 1.0, 2, 5.0, skewness=np.inf),
        lambda: kinoshita(100.0, 2.3, 2, 5.0, skewness=0.2, flatness=0.0),
        lambda: straight_line(100.0, 100.0),
        lambda: straight_line(np.inf, 1.0),
        lambda: noisy_line(100.0, 1.0, 0.0, seed=0),
        lambda: noisy_line(100.0, 1.0, 1.0, seed=0, correlation=-5.0),
        lambda: noisy_line(100.0, 1.0, 1.0, seed=0, taper=0.6),
        lambda: valley_line(1000.0, 300.0, 10.0, 200.0, seed=0),
        lambda: valley_line(100.0, 150.0, 10.0, 200.0, seed=0),
        lambda: valley_line(1000.0, 10.0, -10.0, 200.0, seed=0),
    ],
)
def test_numbers_out_of_range_are_refused_by_name(call):
    with pytest.raises(ValueError, match=r" is .*; give "):
        call()
