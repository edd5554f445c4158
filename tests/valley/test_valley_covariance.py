"""Covariance structures: measured, and asked for."""

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid

import warpriver as wr
from warpriver import valley as g
from warpriver.valley.covariance import correlation_by_frequency, covariance_series

TARGETS = np.arange(-1.0, 1.01, 0.25)
# What the issue of the inverse is held to.
WITHIN = 0.02
WIDTH = (g.sine(0.2, 2, 0.4), g.cosine(0.12, 5, 1.0), g.sine(0.08, 9, 2.0))
FREQUENCIES = (2.0, 5.0, 9.0)


def valley(target, **changes):
    controls = {"width": WIDTH, "centerline": (g.sine(30.0, 2),), **changes.pop("controls", {})}
    return wr.synthetic_valley("S3", controls=controls, covariance=target, **changes)


def test_structure_is_the_product_of_standardised_residuals():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 500))
    even = np.linspace(0.0, 1.0, 500)
    series, mean = covariance_series(a, b, even)
    weight = np.full(500, 1.0)
    weight[[0, -1]] = 0.5
    weight /= weight.sum()
    ra = (a - weight @ a) / math.sqrt(weight @ (a - weight @ a) ** 2)
    rb = (b - weight @ b) / math.sqrt(weight @ (b - weight @ b) ** 2)
    np.testing.assert_allclose(series, ra * rb)
    assert mean == pytest.approx(weight @ (ra * rb))
    assert covariance_series(a, a, even)[1] == pytest.approx(1.0)
    assert math.isnan(covariance_series(a, np.ones(500), even)[1])


def test_correlation_by_frequency_is_the_cosine_between_phases():
    u = np.linspace(0.0, 1.0, 3001)
    a = np.sin(2 * np.pi * 2 * u) + 0.3 * np.sin(2 * np.pi * 7.5 * u + 0.2)
    b = 5.0 * np.sin(2 * np.pi * 2 * u + 1.1) + 2.0 * np.sin(2 * np.pi * 7.5 * u + 0.2 + 2.0)
    np.testing.assert_allclose(
        correlation_by_frequency(a, b, u, (2.0, 7.5)), [math.cos(1.1), math.cos(2.0)], atol=1e-10
    )
    assert np.isnan(correlation_by_frequency(a, np.sin(2 * np.pi * 2 * u), u, (2.0, 7.5))[1])


@pytest.mark.parametrize("stationing", ["channel", "valley"])
@pytest.mark.parametrize("mean", TARGETS)
def test_mean_covariance_with_the_width_is_the_one_asked_for(mean, stationing):
    made = valley(g.CovarianceTarget("width", mean, FREQUENCIES, amplitude=0.4), stationing=stationing)
    assert made.covariance.mean_thalweg_width == pytest.approx(mean, abs=WITHIN)
    # All frequencies are shifted alike.
    np.testing.assert_allclose(list(made.covariance.by_frequency.values()), mean, atol=WITHIN)
    residual, u = (getattr(made.stations, k)[made.stations.reach] for k in ("residual", "position"))
    variance = trapezoid((residual - trapezoid(residual, u)) ** 2, u)
    assert math.sqrt(2.0 * variance) == pytest.approx(0.4, rel=1e-6)


@pytest.mark.parametrize("frequency", FREQUENCIES)
@pytest.mark.parametrize("mean", TARGETS)
def test_covariance_at_each_of_three_frequencies(mean, frequency):
    """One frequency is asked for the target and the others for its half and its opposite."""
    wanted = {f: m for f, m in zip(FREQUENCIES, (0.5 * mean, -mean, 0.5 * mean), strict=True)}
    wanted[frequency] = mean
    made = valley(g.CovarianceTarget("width", None, FREQUENCIES, tuple(wanted.values())))
    for f, c in made.covariance.by_frequency.items():
        assert c == pytest.approx(wanted[f], abs=WITHIN)


@pytest.mark.parametrize("source", ["control", "planform"])
@pytest.mark.parametrize("mean", TARGETS)
def test_mean_covariance_with_the_curvature_is_the_one_asked_for(mean, source):
    """|C| of one sinusoid has a rectified sine's harmonics: three of them, 4, 8 and 12, give all of -1 to 1."""
    controls = {"curvature": (g.sine(0.1, 2),)} if source == "control" else {}
    made = valley(g.CovarianceTarget("curvature", mean, (4.0, 8.0, 12.0)), controls=controls)
    assert made.covariance.mean_thalweg_curvature == pytest.approx(mean, abs=WITHIN)


@pytest.mark.parametrize("frequencies", [(1.3, 2.7, 4.1), (0.5, 1.25, 2.0)])
@pytest.mark.parametrize("mean", [-0.75, 0.0, 0.5])
def test_frequencies_that_are_no_whole_numbers(frequencies, mean):
    width = tuple(g.sine(a, f, p) for a, f, p in zip((0.2, 0.1, 0.1), frequencies, (0.1, 1.0, 2.0), strict=True))
    made = valley(g.CovarianceTarget("width", mean, frequencies), controls={"width": width})
    assert made.covariance.mean_thalweg_width == pytest.approx(mean, abs=WITHIN)


@pytest.mark.parametrize("mean", [-0.3, 0.0, 0.25, 0.5, 0.6])
def test_mean_and_frequencies_together(mean):
    """Phases are held by the frequencies' targets; amplitudes give the mean."""
    wanted = (0.8, -0.8, 0.2)
    made = valley(g.CovarianceTarget("width", mean, FREQUENCIES, wanted))
    assert made.covariance.mean_thalweg_width == pytest.approx(mean, abs=WITHIN)
    np.testing.assert_allclose(list(made.covariance.by_frequency.values()), wanted, atol=WITHIN)


def test_a_surveyed_width_can_be_covaried_with():
    rng = np.random.default_rng(4)
    widths = 30.0 + np.cumsum(rng.normal(size=200)) * 0.3
    controls = {"width": (g.Series(widths, relative=True),)}
    made = valley(g.CovarianceTarget("width", 0.6, tuple(range(1, 9))), controls=controls)
    assert made.covariance.mean_thalweg_width == pytest.approx(0.6, abs=WITHIN)


def test_impossible_targets_are_said_to_be():
    with pytest.raises(
        ValueError, match=r"S3: covariance with the width: .* of 1 is impossible .* -0\.4\d\d to 0\.4\d\d"
    ):
        valley(g.CovarianceTarget("width", 1.0, (5.0,)))
    with pytest.raises(ValueError, match=r"a mean covariance of 0\.9 is impossible"):
        valley(g.CovarianceTarget("width", 0.9, FREQUENCIES, (0.1, 0.2, 0.3)))
    with pytest.raises(ValueError, match="no component at frequency 3"):
        valley(g.CovarianceTarget("width", 0.5, (2.0, 3.0)))
    with pytest.raises(ValueError, match="does not vary"):
        valley(g.CovarianceTarget("width", 0.5, (2.0,)), controls={"width": ()})
    with pytest.raises(ValueError, match=r"mean covariance is 1\.5; it lies in -1 to 1"):
        valley(g.CovarianceTarget("width", 1.5, (2.0,)))
    with pytest.raises(ValueError, match="by_frequency has 1 values for 2 frequencies"):
        valley(g.CovarianceTarget("width", None, (2.0, 5.0), (0.5,)))
    with pytest.raises(ValueError, match="by_frequency holds -2"):
        valley(g.CovarianceTarget("width", None, (2.0, 5.0), (0.5, -2.0)))
    with pytest.raises(ValueError, match="give the mean of the covariance, or that of each frequency"):
        valley(g.CovarianceTarget("width", None, (2.0,)))
    with pytest.raises(ValueError, match="holds one twice"):
        valley(g.CovarianceTarget("width", 0.5, (2.0, 2.0)))
    with pytest.raises(ValueError, match="numbers above 0"):
        valley(g.CovarianceTarget("width", 0.5, (0.0,)))
    with pytest.raises(ValueError, match=r"CovarianceTarget\.mean is 'high'; give a number"):
        g.CovarianceTarget("width", "high")
    with pytest.raises(ValueError, match=r"CovarianceTarget\.frequencies must be a list of numbers"):
        g.CovarianceTarget("width", 0.5, "all")
    with pytest.raises(ValueError, match="'velocity'; use one of 'width', 'curvature'"):
        g.CovarianceTarget("velocity", 0.5)
    with pytest.raises(ValueError, match="give one of them"):
        valley(g.CovarianceTarget("width", 0.5, (2.0,)), controls={"thalweg": (g.sine(1, 1),)})


@pytest.mark.parametrize(("with_width", "with_curvature"), [(0.6, -0.3), (-0.5, 0.5), (0.0, 0.0), (0.8, 0.1)])
def test_two_targets_are_met_at_once(with_width, with_curvature):
    frequencies = (2.0, 4.0, 5.0, 9.0)
    targets = (
        g.CovarianceTarget("width", with_width, frequencies, amplitude=0.4),
        g.CovarianceTarget("curvature", with_curvature, (4.0, 8.0), amplitude=0.4),
    )
    made = valley(targets)
    assert made.covariance.mean_thalweg_width == pytest.approx(with_width, abs=WITHIN)
    assert made.covariance.mean_thalweg_curvature == pytest.approx(with_curvature, abs=WITHIN)
    residual, u = (getattr(made.stations, k)[made.stations.reach] for k in ("residual", "position"))
    variance = trapezoid((residual - trapezoid(residual, u)) ** 2, u)
    assert math.sqrt(2.0 * variance) == pytest.approx(0.4, rel=1e-6)
    assert {term.frequency for term in made.thalweg} == {2.0, 4.0, 5.0, 8.0, 9.0}


def test_two_targets_that_cannot_be_met_are_said_to_be():
    def two(width, curvature, frequencies=(2.0, 4.0, 5.0), **options):
        return (
            g.CovarianceTarget("width", width, frequencies, **options),
            g.CovarianceTarget("curvature", curvature, frequencies),
        )

    with pytest.raises(ValueError, match=r"S3: covariance with the width and the curvature: .* impossible together"):
        valley(two(0.95, 0.95))
    with pytest.raises(ValueError, match=r"impossible together"):
        valley(two(0.2, 0.1, (2.0,)))
    with pytest.raises(ValueError, match='has two targets with "width"'):
        valley((g.CovarianceTarget("width", 0.1), g.CovarianceTarget("width", 0.2)))
    with pytest.raises(ValueError, match=r"has the amplitudes 0\.3 and 0\.25"):
        valley(two(0.1, 0.1, amplitude=0.3))
    with pytest.raises(ValueError, match="each must be a mean"):
        valley(two(0.1, None))
    with pytest.raises(ValueError, match="must be a CovarianceTarget, two of them, or None"):
        valley((0.3, 0.4))
