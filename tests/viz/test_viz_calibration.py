"""Pictures of calibrations show the numbers that they are made of."""

import numpy as np
import pytest
import surveyed
from surveyed import LAW, measured

import warpriver as wr

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.usefixtures("coarse_pictures")


@pytest.fixture(scope="module")
def surveys():
    line = surveyed.grown()
    return [measured(xy, 3.0, k) for k, xy in enumerate((line, surveyed.moved(line, 10.0)[0]))]


@pytest.fixture(scope="module")
def fit(surveys):
    return wr.calibrate(*surveys, 10.0, params=LAW)


def test_a_fit_is_drawn_along_the_river(fit, tmp_path):
    figure = wr.viz.draw_fit(fit, tmp_path / "fit.png")
    assert (tmp_path / "fit.png").stat().st_size > 0
    *rows, against = figure.axes
    drawn = {line.get_label(): line.get_ydata() for line in rows[0].lines if not line.get_label().startswith("_")}
    np.testing.assert_array_equal(drawn["observed"][fit.scored], fit.observed[fit.scored])
    np.testing.assert_array_equal(drawn["by the law"][fit.scored], fit.predicted[fit.scored])
    assert np.isnan(drawn["observed"][~fit.scored]).all()
    assert against.get_xlabel() == "by the law, m" and f"r {fit.correlation:.2f}" in figure.texts[0].get_text()


def test_a_fit_is_drawn_as_a_map(fit, tmp_path):
    figure = wr.viz.draw_fit_map(fit, tmp_path / "map.svg")
    assert (tmp_path / "map.svg").stat().st_size > 0
    whole, detail, bar = figure.axes
    colors = whole.collections[1].get_colors()
    inner = fit.scored[1:] & fit.scored[:-1]
    assert len(np.unique(colors[~inner], axis=0)) == 1 and len(np.unique(colors[inner], axis=0)) > 50
    first, second, law = detail.lines
    # The law lies nearer to the second survey than the first survey does, on the map as in the numbers.
    gaps = [np.nanmedian(np.abs(wr.metrics.migration(line.get_xydata() * 1e3, second.get_xydata() * 1e3)[60:-60]))
            for line in (first, law)]  # fmt: skip
    assert gaps[1] < 0.5 * gaps[0]
    west, east = detail.get_xlim()
    assert east - west < 0.9 * np.ptp(whole.get_xlim()) and bar.get_title()


def test_forecasts_are_drawn(surveys, tmp_path):
    line = surveys[-1].polylines()[0]
    later = [measured(surveyed.moved(line, years)[0], 3.0, years) for years in (5, 10)]
    past = wr.hindcast([*surveys, *later], [0.0, 10.0, 15.0, 20.0], leads=(5.0, 10.0), window=10.0, params=LAW)
    figure = wr.viz.draw_hindcast(past, tmp_path / "forecasts.png")
    assert (tmp_path / "forecasts.png").stat().st_size > 0
    left, right = figure.axes
    means = {line.get_label(): line.get_ydata() for line in left.lines}
    assert list(means["warpriver"]) == [past.score(lead).distance for lead in (5.0, 10.0)]
    assert list(means["no change"]) == [past.score(lead).no_change for lead in (5.0, 10.0)]
    covered = right.collections[0].get_offsets()[:, 1]
    np.testing.assert_allclose(covered, [f.coverage for f in past.forecasts])
