"""Forecasts know nothing of what is to come, and are scored beside no change and linear extrapolation."""

import numpy as np
import pytest
import surveyed
from data_folder import data_folder
from surveyed import LAW, TRUE, WIDTH, measured

import warpriver as wr

DATES = [1990.0, 1995.0, 2000.0, 2005.0, 2010.0]
# m; surveys are off by so much at each point, as 30 m pixels make them.
NOISE = 8.0


@pytest.fixture(scope="module")
def surveys(device):
    line, found = surveyed.grown(device=device), []
    for k in range(len(DATES)):
        found.append(measured(line, NOISE, k, device))
        line = surveyed.moved(line, 5.0, device=device)[0]
    return found


@pytest.fixture(scope="module")
def past(surveys):
    return wr.hindcast(surveys, DATES, leads=(5.0, 10.0))


def test_a_river_that_obeys_the_law_is_forecast_better_than_without_it(past):
    print(past)
    for lead, count in ((5.0, 3), (10.0, 2)):
        score = past.score(lead)
        assert score.count == count
        assert score.distance < 0.7 * score.linear and score.distance < 0.5 * score.no_change
        assert 0.85 <= score.coverage <= 0.97
        assert score.skill_over_no_change > 0.5 and score.skill_over_linear > 0.3
    for forecast in past.forecasts:
        assert forecast.params.memory_length == pytest.approx(TRUE["memory_length"], rel=0.3)
        assert forecast.band > forecast.distance


def test_later_surveys_change_no_forecast(past, surveys):
    """The last survey lies a width off: nothing but the forecasts that end there knows."""
    off = wr.RiverNetwork.from_polylines(
        [surveys[-1].polylines()[0] + [WIDTH, 0.0]], width=WIDTH, crs="EPSG:32619", device=surveys[-1].device
    )
    other = wr.hindcast([*surveys[:-1], off], DATES, leads=(5.0, 10.0))
    for a, b in zip(past.forecasts, other.forecasts, strict=True):
        assert (a == b) == (a.end < DATES[-1])
        assert a.params == b.params and (a.begin, a.end) == (b.begin, b.end)
        # Bands are made before the outcome, of the points that are scored then.
        assert b.band == pytest.approx(a.band, rel=0.1)


def test_either_half_is_told_by_the_other(surveys):
    past = wr.hindcast([surveys[0], surveys[-1]], [DATES[0], DATES[-1]], split="reach")
    print(past)
    assert [f.part for f in past.forecasts] == ["lower", "upper"] and past.split == "reach"
    for forecast in past.forecasts:
        assert forecast.correlation > 0.97 and forecast.distance < 0.5 * forecast.no_change
        assert np.isnan(forecast.linear) and 0.75 < forecast.coverage < 0.99
    assert past.score(DATES[-1] - DATES[0]).count == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"dates": [1.0, 2.0]}, "as many of both"),
        ({"dates": [3.0, 2.0, 1.0]}, "rise"),
        ({"split": "space"}, "split"),
        ({"leads": ()}, "leads"),
        ({"leads": (40.0,)}, "40 yr"),
        ({"window": 100.0}, "100 yr"),
        ({"level": 1.5}, "level"),
        ({"networks": ["a", "b", "c"]}, "RiverNetwork"),
    ],
)
def test_arguments_are_checked(surveys, arguments, said):
    with pytest.raises(wr.errors.InputError, match=said):
        wr.hindcast(**{"networks": surveys[:3], "dates": DATES[:3], **arguments})


def test_forecasts_are_written_as_a_table(past, tmp_path):
    wr.calibration.write_hindcast(past, tmp_path / "forecasts.csv")
    table = np.genfromtxt(tmp_path / "forecasts.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert len(table) == len(past.forecasts)
    np.testing.assert_allclose(table["distance"], [f.distance for f in past.forecasts], rtol=1e-5)


def test_the_posterior_agrees_with_the_normal_law_of_a_fit(surveys):
    pytest.importorskip("emcee")
    fit = wr.calibrate(surveys[0], surveys[2], 10.0, params=LAW, fit=list(TRUE)[:2], offset=False)
    with pytest.warns(UserWarning, match="too short"):
        chains = wr.calibration.posterior(fit, walkers=4, steps=30, seed=1)
    assert chains.samples.shape == (84, 2) and 0.1 < chains.acceptance < 0.9
    for name in fit.constants:
        low, middle, high = (chains.quantile(name, q) for q in (0.05, 0.5, 0.95))
        assert low < middle < high and low < 1.2 * TRUE[name] and high > 0.8 * TRUE[name]
        assert abs(np.log(middle / fit.constants[name])) < 4.0 * max(fit.log_error[name], 0.01)
    with pytest.warns(UserWarning, match="too short"):
        again = wr.calibration.posterior(fit, walkers=4, steps=30, seed=1)
    np.testing.assert_array_equal(again.samples, chains.samples)
    with pytest.raises(wr.errors.InputError, match="walkers"):
        wr.calibration.posterior(fit, walkers=2)


def test_a_surveyed_river_is_forecast_beyond_no_change(device):
    """The Mamore in Bolivia, yearly lines, five years ahead. Measured 96 m, and 123 m for no change."""
    folder, years = data_folder("mamore_series"), (1986, 1991, 1996, 2001, 2006)
    networks = [wr.read_network(folder / f"mamore_{year}.csv.gz", width=390.0, device=device) for year in years]
    past = wr.hindcast(networks, years, leads=(5.0,))
    print(past)
    score = past.score(5.0)
    assert score.count == 3
    assert score.distance < 0.9 * score.no_change and score.distance < score.linear
    assert 0.8 < score.coverage < 0.98
