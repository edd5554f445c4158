"""Control functions of synthetic valleys, each against its definition."""

import math

import numpy as np
import pytest

from warpriver import generate
from warpriver import valley as g
from warpriver.valley.controls import evaluate
from warpriver.valley.terms import TERMS

U = np.linspace(0.0, 1.0, 2001)


def test_harmonics_add_up():
    f = evaluate((g.sine(0.5, 1.25, math.pi), g.cosine(2.0, 2.0, math.pi)), U)
    x = 2.0 * np.pi * U
    np.testing.assert_allclose(f, 0.5 * np.sin(1.25 * x + np.pi) + 2.0 * np.cos(2.0 * x + np.pi), atol=1e-14)
    np.testing.assert_array_equal(evaluate((), U), 0.0)


@pytest.mark.parametrize("angle", [0.4, 1.2, 2.0])
def test_sine_generated_offset_is_that_of_the_curve(angle):
    """The same sideways offset as of the curve walked in plan, scaled to 1."""
    line = generate.sine_generated(100.0, angle, 2, 0.01)
    offset = line[:, 1] - 0.5 * (line[:, 1].max() + line[:, 1].min())
    value = g.SineGenerated(1.0, 2.0, 0.0, angle)(np.linspace(0.0, 1.0, len(line)))
    np.testing.assert_allclose(value, offset / np.abs(offset).max(), atol=2e-5)


def test_kinoshita_offset_is_that_of_the_curve_and_leans():
    line = generate.kinoshita(100.0, 1.6, 1, 0.01)
    offset = line[:, 1] - 0.5 * (line[:, 1].max() + line[:, 1].min())
    value = g.Kinoshita(3.0, 1.0, 0.0, 1.6)(np.linspace(0.0, 1.0, len(line)))
    # The curve's end differs sideways from its start by what its third harmonic leaves: none here.
    np.testing.assert_allclose(value, 3.0 * offset / np.abs(offset).max(), atol=1e-4)
    assert np.abs(value).max() == pytest.approx(3.0, rel=1e-3)


def test_a_cnoidal_wave_is_a_cosine_at_modulus_0_and_solitary_near_1():
    np.testing.assert_allclose(g.Cnoidal(0.7, 3.0, 0.0, 0.0)(U), 0.7 * np.cos(6.0 * np.pi * U), atol=1e-12)
    even = np.arange(4000) / 4000
    for modulus in (0.3, 0.9, 0.9999):
        value = g.Cnoidal(0.7, 2.0, 0.4, modulus)(even)
        assert value.mean() == pytest.approx(0.0, abs=1e-9)
        assert np.ptp(value) == pytest.approx(1.4, rel=1e-4)
    value = g.Cnoidal(1.0, 1.0, 0.0, 0.9999)(even)
    # Near a solitary crest cn is sech: of K u / pi * 2 pi.
    from scipy.special import ellipk

    k = float(ellipk(0.9999))
    crest = even[:200]
    np.testing.assert_allclose(value[:200] - value[0], 2.0 / np.cosh(2.0 * k * crest) ** 2 - 2.0, atol=1e-3)


def test_an_autoregressive_series_has_its_own_statistics():
    """Over 200 pseudo-periods: the standard deviation, and the autocorrelation that the coefficients give."""
    term = g.Autoregressive(0.4, 200.0, 0.25, samples=20_000, seed=3)
    value = term(np.linspace(0.0, 1.0, 20_001))
    assert value.std() == pytest.approx(0.4, rel=0.15)
    k, h = 2.0 * math.pi * 200.0 / 20_000, 0.25
    first = 2.0 * math.exp(-k * h) * math.cos(k * math.sqrt(1.0 - h * h))
    second = -math.exp(-2.0 * k * h)
    rho = [1.0, first / (1.0 - second)]
    for _ in range(98):
        rho.append(first * rho[-1] + second * rho[-2])
    v = value - value.mean()
    found = [float((v[: len(v) - lag] * v[lag:]).mean() / (v * v).mean()) for lag in range(0, 100, 10)]
    # The error of an autocorrelation over 200 periods that are correlated over one or two: about 0.1.
    np.testing.assert_allclose(found, rho[:100:10], atol=0.15)
    np.testing.assert_array_equal(term(U), term(U))
    assert not np.array_equal(term(U), g.Autoregressive(0.4, 200.0, 0.25, samples=20_000, seed=4)(U))


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_a_spectral_series_has_its_power_law_and_deviation(exponent):
    even = np.arange(4096) / 4096
    value = g.Spectral(0.3, exponent, 1, 64, seed=5)(even)
    assert value.std() == pytest.approx(0.3, rel=1e-10)
    power = np.abs(np.fft.rfft(value)[1:65]) ** 2
    slope = np.polyfit(np.log(np.arange(1, 65)), np.log(power), 1)[0]
    assert slope == pytest.approx(-exponent, abs=1e-8)
    assert np.abs(np.fft.rfft(value)[65:]).max() < 1e-9


def test_gradient_noise_vanishes_at_its_lattice_and_stays_within_its_amplitude():
    lattice = np.arange(0, 33) / 32
    np.testing.assert_allclose(g.GradientNoise(1.0, 32.0, seed=1)(lattice), 0.0, atol=1e-12)
    value = g.GradientNoise(0.5, 300.0, seed=1)(np.linspace(0.0, 1.0, 30_001))
    assert 0.3 < np.abs(value).max() <= 0.5
    assert abs(value.mean()) < 0.02
    one, two = (g.GradientNoise(1.0, 8.0, n, 0.5, seed=2)(U) for n in (1, 2))
    second = g.GradientNoise(1.0, 8.0, 2, 1.0, seed=2)(U) - one
    np.testing.assert_allclose(two - one, 0.5 * second, atol=1e-12)
    assert np.abs(np.diff(two)).max() < 0.05, "smooth"


def test_steps_and_splines_pass_through_what_they_are_given():
    steps = g.Steps((0.25, 0.5), (0.0, -1.0, -0.5), riser=0.02)
    np.testing.assert_allclose(
        steps(np.array([0.0, 0.239, 0.25, 0.261, 0.4, 0.6, 1.0])), [0, 0, -0.5, -1, -1, -0.5, -0.5]
    )
    points = (0.0, 0.2, 0.7, 1.0), (1.0, -0.5, 0.3, 0.3)
    for kind in ("cubic", "monotone", "linear"):
        np.testing.assert_allclose(g.Spline(*points, kind)(np.array(points[0])), points[1], atol=1e-14)
    monotone = g.Spline(*points, "monotone")(U)
    assert monotone.max() <= 1.0 + 1e-12 and monotone.min() >= -0.5 - 1e-12
    assert g.Spline((0.2, 0.4, 0.8), (1.0, 2.0, 3.0))(np.array([0.0]))[0] == 1.0, "held beyond its ends"


def test_a_surveyed_series_and_its_strongest_harmonics():
    rng = np.random.default_rng(0)
    n = 240
    t = np.arange(n) / n
    survey = 40.0 + 6.0 * np.cos(2 * np.pi * 3 * t + 0.3) + 3.0 * np.sin(2 * np.pi * 8 * t) + rng.normal(0.0, 0.1, n)
    found = g.strongest_harmonics(survey, 2)
    np.testing.assert_allclose([h.amplitude for h in found], [6.0, 3.0], atol=0.05)
    # n samples from end to end of the reach are n / (n - 1) of a period.
    np.testing.assert_allclose([h.frequency * n / (n - 1) for h in found], [3.0, 8.0])
    np.testing.assert_allclose(found[0].phase, 0.3, atol=0.01)
    at = np.linspace(0.0, 1.0, n)
    for count in (n, n - 1):
        all_of_them = g.strongest_harmonics(survey[:count], count)
        even = np.linspace(0.0, 1.0, count)
        np.testing.assert_allclose(evaluate(all_of_them, even), survey[:count] - survey[:count].mean(), atol=1e-10)
    np.testing.assert_allclose(g.Series(survey)(at), survey, atol=1e-12)
    relative = g.Series(survey, relative=True)(at)
    np.testing.assert_allclose(relative, survey / survey.mean() - 1.0, atol=1e-12)
    kept = g.Series(survey, relative=True, harmonics=2)(at)
    assert np.abs(kept - relative).max() < 0.02
    uneven = np.sort(rng.uniform(0.0, 1.0, 50))
    np.testing.assert_allclose(g.Series(np.sin(uneven), positions=uneven)(uneven), np.sin(uneven), atol=1e-12)


def test_every_term_evaluates_beyond_the_reach_and_keeps_its_shape():
    wide = np.linspace(-0.3, 1.3, 33).reshape(3, 11)
    for kind in TERMS.values():
        value = evaluate((kind(),), wide)
        assert value.shape == wide.shape and np.isfinite(value).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: g.sine(math.nan, 1.0), "Harmonic.amplitude is nan"),
        (lambda: g.sine(1.0, -1.0), "Harmonic.frequency is -1"),
        (lambda: g.Harmonic(wave="tan"), "Harmonic.wave is 'tan'; use one of 'sin', 'cos'"),
        (lambda: g.SineGenerated(angle=2.5), "SineGenerated.angle is 2.5 rad"),
        (lambda: g.Cnoidal(modulus=1.0), "Cnoidal.modulus is 1"),
        (lambda: g.Autoregressive(damping=0.0), "Autoregressive.damping is 0"),
        (lambda: g.Autoregressive(samples=100.5), "Autoregressive.samples is 100.5; give a whole number"),
        (lambda: g.Spectral(lowest=9, highest=3)(U), "Spectral.highest is 3, below lowest, 9"),
        (lambda: g.GradientNoise(octaves=0), "GradientNoise.octaves is 0"),
        (lambda: g.Steps((0.5,), (1.0,)), "Steps.levels has 1 values for 1 positions; give one more"),
        (lambda: g.Steps((0.5, 0.4), (1.0, 2.0, 3.0)), "Steps.positions must rise"),
        (lambda: g.Spline((0.0, 0.5), (1.0, 2.0, 3.0)), "2 positions and 3 values"),
        (lambda: g.Spline((0.0, 0.5), (1.0, "x")), "Spline.values must be a list of numbers"),
        (lambda: g.Series([1.0, math.nan, 2.0]), r"Series.values\[1\] is nan"),
        (lambda: g.Series([1.0]), "Series.values has 1 value"),
        (lambda: g.Series([1.0, 2.0], positions=[0.0]), "1 positions for 2 values"),
        (lambda: g.Series([-1.0, 1.0], relative=True), "mean is positive"),
        (lambda: g.strongest_harmonics([1.0, math.inf, 2.0], 1), "3 or more finite numbers"),
        (lambda: g.strongest_harmonics([1.0, 3.0, 2.0], 0), "give a whole number of harmonics, 1 or more"),
        (lambda: evaluate((lambda u: u * math.nan,), U), "not finite"),
        (lambda: evaluate((lambda u: u[:3],), U), "one for each position"),
    ],
)
def test_bad_terms_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
