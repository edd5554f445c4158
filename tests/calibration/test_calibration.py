"""Calibration finds the constants of rivers that are known, and nothing where there is nothing to find."""

import dataclasses

import numpy as np
import pytest
import surveyed
from data_folder import data_folder
from plain import plain_params
from surveyed import LAW, TRUE, WIDTH, grown, measured, moved

import warpriver as wr
from warpriver.calibration.courses import Lines, trace
from warpriver.calibration.observed import left_normals, observe, survey
from warpriver.calibration.problems import Field, Problem

YEARS = 20.0
# Of exact lines: the fit has its own steps and spacing. Of lines that are 5 m off at each point.
EXACT, NOISY = 0.03, 0.10
NOISE = 5.0


def errors(fit, true=TRUE):
    """Relative errors of the constants."""
    return {name: abs(fit.constants[name] / value - 1.0) for name, value in true.items()}


@pytest.fixture(scope="module")
def pair(device):
    line = grown(device=device)
    return line, moved(line, YEARS, device=device)[0]


@pytest.fixture(scope="module")
def fit(pair, device):
    before, after = (measured(line, device=device) for line in pair)
    return wr.calibrate(before, after, YEARS)


def test_constants_of_a_river_that_is_known_are_found(fit):
    print(fit, errors(fit))
    assert max(errors(fit).values()) < EXACT
    assert fit.correlation > 0.999 and fit.skill > 0.95
    assert np.hypot(*fit.offset) < 0.01 * WIDTH
    assert fit.params == LAW.replace(**fit.constants)
    assert list(fit.constants) == list(TRUE)


def test_lines_that_are_five_metres_off_give_them_within_a_tenth(pair, device):
    before, after = (measured(line, NOISE, k, device) for k, line in enumerate(pair))
    fit = wr.calibrate(before, after, YEARS)
    print(fit, errors(fit))
    assert max(errors(fit).values()) < NOISY
    for name, value in TRUE.items():
        low, estimate, high = fit.interval(name, deviations=4.0)
        assert low < value < high and low < estimate < high


def test_an_offset_between_surveys_is_told_from_migration(pair, fit, device):
    before, after = measured(pair[0], device=device), measured(pair[1] + [25.0, -15.0], device=device)
    found = wr.calibrate(before, after, YEARS)
    assert found.offset == pytest.approx(fit.offset + [25.0, -15.0], abs=0.5)
    assert max(errors(found, fit.constants).values()) < 0.01
    blind = wr.calibrate(before, after, YEARS, offset=False)
    assert (blind.offset == 0.0).all() or np.hypot(*blind.offset) < 0.01
    assert blind.correlation < found.correlation and max(errors(blind).values()) > 0.1


def test_cutoffs_are_left_out_of_the_score_alone(pair, device):
    """An oxbow in the second survey: as it had been cut off by hand, where two limbs are nearest to each other."""
    before, after = pair
    step = np.hypot(*np.diff(after, axis=0).T).mean()
    away = np.hypot(*(after[:, None] - after[None]).transpose(2, 0, 1))
    far = np.abs(np.subtract.outer(np.arange(len(after)), np.arange(len(after)))) * step > 8.0 * WIDTH
    i, j = sorted(np.unravel_index(np.where(far, away, np.inf).argmin(), away.shape))
    cut = np.concatenate([after[: i + 1], after[j:]])
    found = wr.calibrate(measured(before, device=device), measured(cut, device=device), YEARS)
    print(found, errors(found))
    assert max(errors(found).values()) < EXACT
    # More than half of the loop, and all of the ends.
    lost = int((~found.scored).sum()) - 2 * 30
    assert lost * WIDTH / 3.0 > 0.5 * (j - i) * step > 5.0 * WIDTH


def test_friction_is_found_as_well(device):
    true = {"migration_rate": 25.0, "friction": 0.009}
    law = plain_params(**true, sinuosity_scaling="none")
    line = grown(device=device)
    after = moved(line, 10.0, law, device=device)[0]
    fit = wr.calibrate(
        measured(line, device=device),
        measured(after, device=device),
        10.0,
        params=law,
        fit=["migration_rate", "friction"],
    )
    print(fit, errors(fit, true))
    assert max(errors(fit, true).values()) < EXACT
    assert fit.params.memory_length == 0.0 and fit.params.curvature_saturation == 0.0


@pytest.mark.parametrize("scaling", ["whole", "upstream"])
def test_the_sinuosity_of_the_law_is_heeded(scaling, device):
    law = LAW.replace(sinuosity_scaling=scaling)
    line = grown(device=device)
    after = moved(line, YEARS, law, device=device)[0]
    fit = wr.calibrate(measured(line, device=device), measured(after, device=device), YEARS, params=law)
    print(fit, errors(fit))
    assert max(errors(fit).values()) < EXACT and fit.params.sinuosity_scaling == scaling


def test_links_of_a_stem_are_fitted_as_one_river(pair, fit, device):
    before, after = pair
    middle = len(before) // 2
    parts = [before[: middle + 1], before[middle:]]
    network = wr.RiverNetwork.from_polylines(parts, width=WIDTH, crs="EPSG:32619", device=device)
    found = wr.calibrate(network, measured(after, device=device), YEARS)
    np.testing.assert_allclose(list(found.constants.values()), list(fit.constants.values()), rtol=1e-3)
    assert len(found.start) == 2


def test_the_rate_of_each_channel_is_found(device):
    """Two rivers of one network, one twice as fast; the prior of a factor draws it to 1, by less than its error."""
    line = grown(device=device)
    other = line + [0.0, 40_000.0]
    slow, fast = (
        moved(xy, 10.0, LAW.replace(migration_rate=k), device=device)[0] for xy, k in ((line, 12.0), (other, 24.0))
    )
    before = wr.RiverNetwork.from_polylines([line, other], width=WIDTH, device=device)
    after = wr.RiverNetwork.from_polylines([slow, fast], width=WIDTH, device=device)
    fit = wr.calibrate(before, after, 10.0, vary=["migration_rate"], length=None)
    rates = [fit.law[fit.part(k), 0] for k in range(2)]
    assert all(np.ptp(rate) < 1e-9 for rate in rates)
    assert [rate[0] for rate in rates] == pytest.approx([12.0, 24.0], rel=EXACT)
    assert np.ptp(fit.law[:, 1]) == 0.0


def test_a_rate_that_varies_along_the_river_is_found_and_drawn_as_a_map(device):
    """Erodible banks from the middle of the map on: a map from the fit takes a simulation where the river went."""
    line = grown(device=device)
    west, south, east, north = line[:, 0].min(), line[:, 1].min(), line[:, 0].max(), line[:, 1].max()
    size = 50.0
    x = np.arange(west - 1000.0, east + 1000.0, size)
    rows = int((north - south + 2000.0) / size)
    middle = 0.5 * (west + east)
    # A slope of 4 km, about one spacing of knots.
    ramp = np.clip(0.5 + (x - middle) / 4000.0, 0.0, 1.0)
    raster = wr.raster.Raster(np.tile(0.6 + 0.8 * ramp, (rows, 1)), size, origin=(x[0] - 0.5 * size, north + 1000.0))
    after = moved(line, YEARS, controls=[wr.ErodibilityField(raster)], device=device)[0]
    before, later = measured(line, device=device), measured(after, device=device)
    fit = wr.calibrate(before, later, YEARS, vary="migration_rate".split(), length=25.0)
    true = 20.0 * np.interp(fit.xy[:, 0], x, 0.6 + 0.8 * ramp)
    off = np.abs(fit.law[fit.scored, 0] / true[fit.scored] - 1.0)
    print(fit, np.median(off), off.max())
    assert np.median(off) < 0.05
    again = moved(line, YEARS, fit.params, controls=[fit.erodibility()], device=device)[0]
    reached = wr.metrics.migration(again, after)
    assert np.nanmedian(np.abs(reached)) < 0.05 * np.nanmedian(np.abs(fit.observed))


def test_derivatives_are_those_of_the_lines(device):
    """How far points go across the line for a change of a constant, against differences of whole runs: to a hundredth.

    Along the line they slide besides, as the even places do, which changes no shape.
    """
    even = survey(measured(grown(device=device), device=device), "", 0.5).lines
    law = np.tile(np.array(list(TRUE.values())), (len(even.xy), 1))
    seeds = np.zeros((3, len(even.xy), 3))
    seeds[[0, 1, 2], :, [0, 1, 2]] = 1.0
    run = trace(even, law, seeds, LAW, YEARS, device=device)
    across = left_normals(run.xy)
    for k in range(3):
        step = 1e-3 * seeds[k]
        there, back = (
            trace(even, law * np.exp(sign * step), seeds[:0], LAW, YEARS, steps=run.steps, device=device).xy
            for sign in (1.0, -1.0)
        )
        expected = ((there - back) * across).sum(axis=1) / 2e-3
        off = (run.change[k] * across).sum(axis=1) - expected
        assert np.linalg.norm(off) < 0.01 * np.linalg.norm(expected), k


def test_derivatives_are_those_of_the_residuals(pair, device):
    """Of all unknowns, with fields of the rate and the memory, whose knots share directions.

    The residuals know of chords of a third of a width, which lie up to half a metre inside of bends: a tenth.
    """
    before, after = (survey(measured(line, device=device), "", 0.5) for line in pair)
    lines = before.lines
    fields = [Field.smooth(name, lines, 25.0) for name in ("migration_rate", "memory_length")]
    problem = Problem(observe(before, after, YEARS), LAW, list(TRUE), fields, {}, True, device)
    theta, scored = problem.start(), problem.observed.scored.sum()
    problem.settle(theta)
    change = problem.jacobian(theta)[:scored]
    # All constants, the offset, and every eighth knot.
    for k in (0, 1, 2, *range(5, problem.count - 2, 8), problem.count - 2, problem.count - 1):
        step = np.zeros(problem.count)
        step[k] = 1e-3 if k < problem.count - 2 else 0.1
        there, back = (problem.residuals(theta + sign * step)[:scored] for sign in (1.0, -1.0))
        by_difference = (there - back) / (2.0 * step[k])
        # Where a knot moves the river; downstream of it chords shift along the line.
        felt = np.abs(change[:, k]) > 0.1 * np.abs(change[:, k]).max()
        off = (change[:, k] - by_difference)[felt]
        # A knot at the ends, where nothing is scored, moves nothing.
        moves = np.linalg.norm(change[:, k]) > 0.02 * np.linalg.norm(change[:, 0])
        assert np.linalg.norm(off) < 0.1 * np.linalg.norm(by_difference[felt]) or not moves, k


def test_lines_go_where_a_simulation_takes_them(pair, device):
    """The steps of a fit and those of the engine: within 1.5 m where bends moved by 80 m and more."""
    line = pair[0]
    even = survey(measured(line, device=device), "", 0.0).lines
    law = np.tile(np.array(list(TRUE.values())), (len(even.xy), 1))
    run = trace(even, law, np.zeros((0, len(even.xy), 3)), LAW, YEARS, device=device)
    apart = wr.metrics.migration(run.xy, pair[1])[30:-30]
    assert np.nanmax(np.abs(wr.metrics.migration(line, pair[1]))) > 80.0
    assert np.nanpercentile(np.abs(apart), 99.0) < 1.5


def test_the_division_of_points_does_not_show(device):
    """Several lines in one launch give what each gives alone, to the bit."""
    line = grown(device=device)
    even = survey(measured(line, device=device), "", 0.5).lines
    seeds = np.zeros((2, len(even.xy), 3))
    seeds[0, :, 0] = seeds[1, :, 1] = 1.0
    law = np.tile(np.array(list(TRUE.values())), (len(even.xy), 1))
    alone = trace(even, law, seeds, LAW, 5.0, device=device)
    twice: Lines = even.tiled(2)
    both = trace(twice, np.tile(law, (2, 1)), np.tile(seeds, (1, 2, 1)), LAW, 5.0, device=device)
    np.testing.assert_array_equal(both.xy, np.tile(alone.xy, (2, 1)))
    np.testing.assert_array_equal(both.change, np.tile(alone.change, (1, 2, 1)))


def test_draws_spread_as_the_errors_do(fit):
    drawn = fit.draws(400, seed=1)
    for name, error in fit.log_error.items():
        logs = np.log([getattr(params, name) for params in drawn])
        # Standard errors of a mean and of a standard deviation of 400 draws, four times.
        assert abs(logs.mean() - np.log(fit.constants[name])) < 0.2 * error
        assert logs.std() == pytest.approx(error, rel=0.15)
    assert fit.draws(3, seed=1) == fit.draws(3, seed=1) != fit.draws(3, seed=2)


def test_nothing_is_found_where_there_is_nothing(pair, device):
    line, after = pair
    before = measured(line, device=device)
    cases = {
        "do not overlap": measured(after + [1e5, 0.0], device=device),
        "reverse one": measured(after[::-1], device=device),
        "CRS": wr.RiverNetwork.from_polylines([after], width=WIDTH, crs="EPSG:32620", device=device),
    }
    for said, network in cases.items():
        with pytest.raises(wr.errors.InputError, match=said):
            wr.calibrate(before, network, YEARS)
    with pytest.raises(wr.errors.InputError, match="widths long"):
        wr.calibrate(measured(line[:20], device=device), before, YEARS)
    with pytest.raises(wr.errors.InputError, match="outer banks"):
        wr.calibrate(measured(after, device=device), before, YEARS)
    shaken = line + np.column_stack([np.zeros(len(line)), 30.0 * np.sin(np.arange(len(line)) / 31.0)])
    with pytest.raises(wr.errors.InputError, match=r"how this river moved|outer banks"):
        wr.calibrate(before, measured(shaken, device=device), YEARS)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"fit": ["depth"]}, "fit names"),
        ({"fit": []}, "fit names nothing"),
        ({"fit": ["friction", "memory_length"]}, "leave one out"),
        ({"vary": ["friction"]}, "not fitted"),
        ({"length": 3.0}, "10 or more"),
        ({"years": 0.0}, "years"),
        ({"smoothing": -1.0}, "smoothing"),
    ],
)
def test_arguments_are_checked(pair, arguments, said, device):
    with pytest.raises(wr.errors.InputError, match=said):
        wr.calibrate(*(measured(line, device=device) for line in pair), **{"years": YEARS, **arguments})


def test_rings_are_refused(device):
    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    ring = wr.RiverNetwork.from_polylines(
        [3000.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)], width=WIDTH, closed=True, device=device
    )
    with pytest.raises(wr.errors.InputError, match="ring"):
        wr.calibrate(ring, ring, YEARS)


def test_what_no_survey_tells_is_kept_by_its_prior(device):
    """Hardly curved anywhere: the saturation stays where other rivers have it, and its error says so."""
    line = surveyed.grown(years=60.0, device=device)
    after = moved(line, YEARS, device=device)[0]
    fit = wr.calibrate(measured(line, 2.0, 1, device), measured(after, 2.0, 2, device), YEARS)
    assert 0.08 < fit.constants["curvature_saturation"] < 0.8
    assert fit.log_error["curvature_saturation"] > 3.0 * fit.log_error["memory_length"]


def test_a_fit_writes_a_scene_that_goes_on(fit, pair, tmp_path):
    written = wr.calibration.write_fit(fit, tmp_path / "out", measured(pair[1]), years=3.0)
    assert [path.name for path in written] == list(wr.calibration.FIT_FILES)
    scene = wr.read_scene(written[0])
    for name, value in fit.constants.items():
        assert getattr(scene.params, name) == pytest.approx(value, rel=1e-5)
    assert scene.params.sinuosity_scaling == "none"
    history = scene.run()
    assert history.times[-1] == pytest.approx(3.0, abs=LAW.time_step)
    table = np.genfromtxt(written[2], delimiter=",", names=True)
    assert table["scored"].sum() == fit.scored.sum()
    np.testing.assert_allclose(table["predicted_m"][fit.scored], fit.predicted[fit.scored], atol=0.006)


def test_a_surveyed_river_is_explained(device):
    """The Jurua in Brazil, 1987 to 2017: r over all the interval, by three constants. Measured .869."""
    folder = data_folder("centerlines")
    before, after = (wr.read_network(folder / f"jurua_{day}.csv.gz", device=device) for day in ("19871012", "20170710"))
    fit = wr.calibrate(before, after, 29.74)
    print(fit)
    assert fit.correlation > 0.85 and fit.skill > 0.5
    assert fit.scored.mean() > 0.8
    assert 15.0 < fit.constants["migration_rate"] < 35.0 and 2.0 < fit.constants["memory_length"] < 4.0


def test_fits_are_values(fit):
    assert dataclasses.is_dataclass(fit) and "memory_length" in str(fit)
    with pytest.raises(wr.errors.InputError, match="not fitted"):
        fit.interval("friction")
    with pytest.raises(wr.errors.InputError, match="one value"):
        fit.erodibility()
    with pytest.raises(wr.errors.InputError, match="line"):
        fit.part(1)
