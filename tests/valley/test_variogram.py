"""Control functions by a variogram: their covariance, and kriging through known values."""

import numpy as np
import pytest
from scipy.linalg import solve

from warpriver.valley import Spline, Variogram

U = np.linspace(0.0, 1.0, 785)


@pytest.mark.parametrize("model", ["exponential", "spherical", "gaussian"])
def test_a_drawn_series_has_its_variogram(model):
    """Mean over 400 series; each lag's mean of products has a standard error of about 2 / sqrt(400 x 10)."""
    term = Variogram(2.0, 0.1, model)
    series = np.stack([term.replace(seed=k)(U) for k in range(400)])
    for lag in (0, 10, 40, 90):
        found = (series[:, lag:] * series[:, : len(U) - lag]).mean()
        assert found == pytest.approx(float(term.covariance(U[lag])), abs=4.0 * 2.0 * 2.0 / np.sqrt(400 * 10))


def test_the_nugget_is_independent_from_sample_to_sample():
    term = Variogram(1.0, 0.2, nugget=0.4)
    series = np.stack([term.replace(seed=k)(U) for k in range(300)])
    assert (series**2).mean() == pytest.approx(1.0, abs=0.05)
    assert (series[:, 1:] * series[:, :-1]).mean() == pytest.approx(0.6 * np.exp(-3.0 / 784 / 0.2), abs=0.05)


@pytest.mark.parametrize("model", ["exponential", "spherical", "gaussian"])
@pytest.mark.parametrize("random", [False, True])
def test_a_conditioned_series_passes_through_what_is_known(model, random):
    at, value = (0.0731, 0.2, 0.55, 0.9), (0.4, -1.0, 2.0, 0.3)
    term = Variogram(1.0, 0.15, model, positions=at, values=value, random=random)
    np.testing.assert_allclose(term(np.array(at)), value, atol=1e-9)


def test_the_kriged_estimate_is_that_of_simple_kriging():
    """Against the textbook system, solved place by place; between its samples the estimate is linear."""
    at, value = np.array([0.1, 0.4, 0.45, 0.8]), np.array([1.0, -0.5, 0.2, 0.7])
    term = Variogram(1.3, 0.3, "spherical", nugget=0.1, positions=at, values=value, random=False)
    matrix = term.covariance(at[:, None] - at) + 0.1 * 1.3**2 * np.eye(4)
    expected = [value @ solve(matrix, term.covariance(at - u)) for u in U]
    np.testing.assert_allclose(term(U), expected, atol=1e-12)
    assert abs(term(at) - value).max() > 1e-3, "with a nugget the known values are smoothed"


def test_the_mean_of_conditioned_series_is_the_estimate():
    known = {"positions": (0.2, 0.6), "values": (1.0, -1.0)}
    drawn = np.mean([Variogram(1.0, 0.3, seed=k, **known)(U) for k in range(600)], axis=0)
    # A standard deviation of at most 1 over sqrt(600), at some eight independent places.
    assert np.abs(drawn - Variogram(1.0, 0.3, random=False, **known)(U)).max() < 3.5 / np.sqrt(600)


def test_bad_variograms_are_refused():
    for options, message in (
        ({"positions": (0.1, 0.2), "values": (1.0,)}, "2 positions and 1 values"),
        ({"positions": (0.2, 0.1), "values": (1.0, 2.0)}, "positions must rise"),
        ({"random": False}, "without positions and values"),
        ({"correlation": 0.0}, "Variogram.correlation is 0"),
        ({"model": "hole"}, "Variogram.model is 'hole'"),
    ):
        with pytest.raises(ValueError, match=message):
            Variogram(**options)


def test_a_bezier_curve_begins_and_ends_at_its_points():
    """De Casteljau's cubic, by its parameter."""
    at, value = np.array([0.0, 0.2, 0.7, 1.0]), np.array([0.0, 2.0, -1.0, 1.0])
    t = np.linspace(0.0, 1.0, 50)
    bernstein = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    found = Spline(at, value, "bezier")(at @ bernstein)
    np.testing.assert_allclose(found, value @ bernstein, atol=1e-7)
    with pytest.raises(ValueError, match="takes at most 64"):
        Spline(np.linspace(0, 1, 65), np.zeros(65), "bezier")
