"""Calibration: the constants of the rate law with which a river moves as it did between two surveys."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver.arrays import FloatArray
from warpriver.calibration.courses import trace
from warpriver.calibration.observed import Observed, observe, survey
from warpriver.calibration.problems import BOUNDS, COLUMNS, OUTLIER, Field, Problem, robust_scale
from warpriver.errors import InputError, warn
from warpriver.extras import IMPORTING
from warpriver.meander.controls import ErodibilityField
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.validate import not_negative, positive, shown, whole

__all__ = ["NAMES", "Fit", "calibrate", "checked_names", "fit_observed", "measured_law"]

# What is fitted where nothing is asked for.
NAMES = ("migration_rate", "memory_length", "curvature_saturation")
# Where the search begins for a constant that is off.
STARTS = {"memory_length": 2.5, "curvature_saturation": 0.25}
# Median and standard deviation of the logarithm of what dated reaches of real rivers have (six of the Amazon basin:
# 1.6 to 3.0 widths, and .2 to .7). They only matter where a reach says little.
PRIORS = {"memory_length": (2.5, 0.4), "curvature_saturation": (0.25, 0.5)}
# The first guess is the best of these.
MEMORIES, SATURATIONS = (1.0, 2.0, 3.0, 5.0), (0.1, 0.2, 0.4)
# Rates are measured over so short a time that nothing moves, yr.
INSTANT = 1e-3
REWEIGHTINGS = 15
# Length of a first step of the search, in logarithms; the search is repeated with what the misfits then are.
FIRST_STEP, ROUNDS = 0.2, 2
STEP_TOLERANCE, COST_TOLERANCE = 1e-3, 1e-4
# A correlation of fewer standard deviations than this is none: nothing is learnt from it.
SIGNIFICANCE = 2.0
# Knots that are closer together would be moved by each other's bends.
SHORTEST_FIELD = 10.0  # widths
# A factor of the rate is drawn on cells of half a width, as far as so many widths from the river.
FIELD_REACH, MOST_CELLS = 6.0, 20_000_000


class Interval(NamedTuple):
    """Limits of a constant, with an estimate between them."""

    low: float
    estimate: float
    high: float


@dataclasses.dataclass(frozen=True)
class Fit:
    """What two surveys of a river say of the constants of its migration.

    Attributes:
        params: Constants to simulate with: those that were given, with the fitted ones in their places.
        constants: The fitted constants by name.
        log_error: Standard error of the natural logarithm of each: .05 is 5 %.
        correlation: Pearson's r of the displacements that the law makes, simulated over the whole interval, with those
            observed, over all scored points.
        skill: 1 - (mean distance that is left) / (mean displacement observed): 0 is as good as no change, 1 perfect.
        offset: (2,) how far the later survey lies off the earlier one, m, which the displacements do not count.
        scale: Standard deviation of a misfit, m, as of a normal sample with the same median.
        correlation_length: Distance along the river over which misfits are alike, m.
        years: Time between the surveys, yr.
        start: (L + 1,) offsets of the lines in the arrays by points: one line a river, from a source to a mouth.
        xy: (N, 2) even points of the first survey, m.
        width: (N,) width there, m.
        observed: (N,) displacement to the later survey, less the offset, m, > 0 to the left; nan where there is none.
        predicted: (N,) displacement that the law makes in the same time, m.
        scored: (N,) bool, where both are compared: not near cutoffs, nor near the ends of a line.
        law: (N, 3) rate (m/yr), memory and saturation at each point, where they vary.
        problem: What was minimised, for :func:`posterior`.
        unknowns: Where it is least.
        covariance: Of the unknowns.
    """

    params: MeanderParams
    constants: dict[str, float]
    log_error: dict[str, float]
    correlation: float
    skill: float
    offset: FloatArray
    scale: float
    correlation_length: float
    years: float
    start: NDArray[np.int32]
    xy: FloatArray
    width: FloatArray
    observed: FloatArray
    predicted: FloatArray
    scored: NDArray[np.bool_]
    law: FloatArray
    problem: Problem = dataclasses.field(repr=False)
    unknowns: FloatArray = dataclasses.field(repr=False)
    covariance: FloatArray = dataclasses.field(repr=False)

    def interval(self, name: str, deviations: float = 1.645) -> Interval:
        """Limits of a fitted constant, by default those of nine cases in ten, by the normal law of its logarithm."""
        if name not in self.constants:
            raise InputError(f"{shown(name)} was not fitted; this fit has {', '.join(self.constants)}")
        factor = math.exp(deviations * self.log_error[name])
        value = self.constants[name]
        return Interval(value / factor, value, value * factor)

    def draws(self, count: int, seed: int = 0) -> list[MeanderParams]:
        """Constants drawn from the normal law of their logarithms, for ensembles."""
        rng = np.random.default_rng(seed)
        size = len(self.problem.names)
        low, high = (bound[:size] for bound in self.problem.bounds())
        drawn = rng.multivariate_normal(
            self.unknowns[:size], self.covariance[:size, :size], count, check_valid="ignore"
        )
        drawn = np.clip(drawn, low, high)
        return [self.params.replace(**self.problem.constants(each)) for each in drawn]

    def lines(self) -> list[FloatArray]:
        """The lines of the first survey where the law takes them by the time of the second, (n, 2) each, m."""
        return self.problem.displaced(self.unknowns)[1]

    @property
    def crs(self) -> str | None:
        """Coordinate reference system of the surveys, or None."""
        return self.problem.observed.before.crs

    def part(self, line: int) -> slice:
        """The points of one of the lines."""
        number = whole(line, "line")
        if number >= len(self.start) - 1:
            raise InputError(f"line is {number}; there are {len(self.start) - 1}, counted from 0")
        return slice(int(self.start[number]), int(self.start[number + 1]))

    def later(self, line: int) -> FloatArray:
        """The line of the second survey that one of the lines is compared with, (n, 2), m."""
        self.part(line)
        return self.problem.observed.after[line] + self.offset

    def erodibility(self, cell_size: float | None = None) -> ErodibilityField:
        """A map of how the rate varies along the river, 1 where it is ``params.migration_rate``, as a control.

        Simulations with it migrate by the rate of the nearest point of the river as it was at the first survey.

        Args:
            cell_size: Size of a cell in m; by default half the least mean width.

        Raises:
            ValueError: The rate was not fitted as a field, or the map would be too large.
        """
        if not any(field.name == "migration_rate" for field in self.problem.fields):
            raise InputError("the rate was fitted as one value; calibrate(..., vary=['migration_rate']) makes a field")
        lines = self.problem.observed.before.lines
        size = 0.5 * float(lines.mean_width().min()) if cell_size is None else positive(cell_size, "cell_size", "m")
        factor = self.law[:, 0] / self.params.migration_rate
        reach = FIELD_REACH * float(self.width.max())
        return ErodibilityField(_nearest_values(self.xy, factor, size, reach, self.crs))

    def __str__(self) -> str:
        rows = [f"r {self.correlation:.3f}, skill {self.skill:.2f} over {self.years:g} yr, "
                f"{self.scored.mean():.0%} of {len(self.xy)} points scored"]  # fmt: skip
        units = {"migration_rate": "m/yr", "memory_length": "widths"}
        for name in self.constants:
            low, value, high = self.interval(name)
            rows.append(f"{name:22} {value:8.4g} ({low:.4g} to {high:.4g}) {units.get(name, '')}".rstrip())
        return "\n".join(rows)


@public
def calibrate(
    before: RiverNetwork,
    after: RiverNetwork,
    years: float,
    *,
    params: MeanderParams | None = None,
    fit: Sequence[str] = NAMES,
    vary: Sequence[str] = (),
    length: float | None = 50.0,
    smoothing: float = 0.5,
    offset: bool = True,
) -> Fit:
    """Fit the constants of meander migration to two surveys of a river.

    The first survey migrates by the rate law [Howard1984, Sylvester2019] until the time of the second, and the
    constants are those with which it comes closest, by bounded robust least squares. What is compared is the
    displacement across the channel, found in the same way for both (:func:`warpriver.metrics.migration`). Each step
    carries the derivatives of all points by the constants along, so that a fit takes about ten simulations.

    Cutoffs are left out of the score, with six widths of channel on both sides, and so are ten widths at the ends of
    rivers; the curvature there counts all the same for what lies downstream. An offset between the two surveys, as
    satellite images have, is fitted beside the constants. The rivers of a network are its stems, from source to mouth;
    those shorter than 30 widths are left out.

    Where a constant may vary, it is what it is for the whole times a factor, whose logarithm has a standard deviation
    of .5 as a prior: a value at knots ``length`` widths apart, linear in between, or one a channel.

    Example::

        fit = wr.calibrate(wr.read_network("1987.gpkg"), wr.read_network("2017.gpkg"), years=29.7)
        print(fit)                                             # constants with their uncertainty, and r
        wr.Simulation(network, fit.params).run(years=50)

    Args:
        before: The river at the first date, with its widths.
        after: The river at the second date, on the same coordinates.
        years: Time between both, yr.
        params: What is not fitted, and where the search begins. By default the law without sinuosity, of which a long
            reach has no single value, and without chance: ``MeanderParams(sinuosity_scaling="none", bank_spread=0.0,
            inlet="none", cutoff_distance=1.0)``.
        fit: Constants to fit: "migration_rate", "memory_length" or "friction", "curvature_saturation".
        vary: Those of them that vary along the river.
        length: Distance between knots in widths, 10 or more; None: one value a channel.
        smoothing: Standard deviation of the Gaussian that takes the steps of pixels out of both lines, in widths; 0:
            none. Waves of ten widths stay as they are.
        offset: Fit an offset between the surveys; False: they lie on each other.

    Returns:
        The fit; its ``params`` go into a simulation.

    Raises:
        TypeError: An argument is of another kind.
        ValueError: The surveys do not overlap, show different rivers or have different systems, too little is left
            beside cutoffs, a constant cannot be fitted, or the law does not explain how the river moved.
    """
    years = positive(years, "years", "yr")
    smoothing = not_negative(smoothing, "smoothing", "widths")
    fit, vary = checked_names(fit, vary)
    if length is not None and not positive(length, "length", "widths") >= SHORTEST_FIELD:
        raise InputError(f"length is {shown(length)} widths; give {SHORTEST_FIELD:g} or more")
    law = (params or measured_law()).for_widths(before.channel_width)
    observed = observe(survey(before, "before", smoothing), survey(after, "after", smoothing), years)
    return fit_observed(observed, law, fit, vary=vary, length=length, offset=offset, device=before.device)


def measured_law() -> MeanderParams:
    """The law of measured reaches: without a sinuosity, random banks and inlets, and with necks that hold longest."""
    return MeanderParams(sinuosity_scaling="none", bank_spread=0.0, inlet="none", cutoff_distance=1.0)


def fit_observed(
    observed: Observed,
    params: MeanderParams,
    names: Sequence[str],
    *,
    vary: Sequence[str] = (),
    length: float | None = None,
    offset: bool = True,
    device: wp.DeviceLike = "cpu",
) -> Fit:
    """Fit constants to what was observed; see :func:`calibrate`."""
    params = params.replace(**{name: STARTS[name] for name in names if name in STARTS and not getattr(params, name)})
    if "friction" in names:
        params = params.replace(memory_length=0.0)
    before = observed.before
    guess, shift = _first_guess(observed, params, names, offset, device)
    fields = [
        Field.smooth(name, before.lines, length) if length else Field.by_channel(name, before.lines, before.channel)
        for name in vary
    ]
    priors = {name: prior for name, prior in PRIORS.items() if name in names}
    problem = Problem(observed.shifted(shift), guess, names, fields, priors, offset, device)
    theta, total = problem.start(), shift
    for _ in range(ROUNDS):
        # The offset is small where the search begins: nearest places change with it.
        theta = _minimised(problem, theta)
        total = total + theta[-2:]
        problem = Problem(observed.shifted(total), guess, names, fields, priors, offset, device)
        theta[-2:] = 0.0
    problem.settle(theta)
    return _fit_of(problem, theta, total)


def checked_names(fit: Sequence[str], vary: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The constants to fit, and those that vary."""
    found = []
    for label, names in (("fit", fit), ("vary", vary)):
        listed = list(names)
        for name in listed:
            if not isinstance(name, str) or name not in COLUMNS:
                raise InputError(f"{label} names {shown(name)}; it can be {', '.join(COLUMNS)}")
        found.append(tuple(dict.fromkeys(listed)))
    if not found[0]:
        raise InputError(f"fit names nothing; give some of {', '.join(COLUMNS)}")
    if {"memory_length", "friction"} <= set(found[0]):
        raise InputError("fit names memory_length and friction, which are two ways to tell the same; leave one out")
    missing = [name for name in found[1] if name not in found[0]]
    if missing:
        raise InputError(f"vary names {missing[0]}, which is not fitted; add it to fit")
    return found[0], found[1]


def _first_guess(
    observed: Observed, params: MeanderParams, names: Sequence[str], offset: bool, device: wp.DeviceLike
) -> tuple[MeanderParams, FloatArray]:
    """Constants and offset by the rates of the first survey: linear in the rate, the best of a few of the others."""
    memories: Iterable[dict[str, float]] = [{}]
    if "memory_length" in names:
        memories = [{"memory_length": m} for m in MEMORIES]
    elif "friction" in names:
        depth = float(np.median(observed.before.lines.depth))
        width = float(np.median(observed.before.lines.width))
        memories = [{"friction": 0.5 * depth / (m * width)} for m in MEMORIES]
    saturations: Iterable[dict[str, float]] = [{}]
    if "curvature_saturation" in names:
        saturations = [{"curvature_saturation": c} for c in SATURATIONS]
    seen = observed.displacement[observed.scored]
    scale, best = robust_scale(seen), (math.inf, params, np.zeros(3))
    for memory, saturation in itertools.product(memories, saturations):
        law = params.replace(**memory, **saturation)
        per_rate = _rate_for_one(observed, law, device)
        terms = np.column_stack([per_rate, observed.normal])[observed.scored]
        if not offset:
            terms[:, 1:] = 0.0
        x, misfit = _robust_solution(terms, seen, scale)
        cost = float(np.sum(np.sqrt(1.0 + (misfit / (OUTLIER * scale)) ** 2) - 1.0))
        if cost < best[0]:
            best = cost, law, x
    _, law, x = best
    if "migration_rate" in names:
        if not x[0] > 0.0:
            raise InputError(
                "bends of this river do not move to their outer banks between before and after; check that after is "
                "the later one and that both run downstream"
            )
        law = law.replace(migration_rate=float(np.clip(x[0], *BOUNDS["migration_rate"])))
    return law, x[1:]


def _rate_for_one(observed: Observed, params: MeanderParams, device: wp.DeviceLike) -> FloatArray:
    """Displacement at the rates of the first survey for a migration rate of 1 m/yr, (N,), m."""
    lines = observed.before.lines
    memory = params.memory_length if params.memory_length > 0.0 else 0.5 / params.friction
    law = np.tile(np.array([1.0, memory, params.curvature_saturation]), (len(lines.xy), 1))
    run = trace(lines, law, np.zeros((0, len(lines.xy), 3)), params, INSTANT, even=False, device=device)
    across = ((run.xy - lines.xy) * observed.normal).sum(axis=1)
    return np.asarray(across * (observed.years / INSTANT))


def _robust_solution(terms: FloatArray, seen: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """Least squares in which outliers count less, by reweighting; the solution and the misfits."""
    weight = np.ones(len(seen))
    for _ in range(REWEIGHTINGS):
        x = np.linalg.lstsq(terms * weight[:, None], seen * weight, rcond=None)[0]
        misfit = seen - terms @ x
        weight = (1.0 + (misfit / (OUTLIER * scale)) ** 2) ** -0.25
    return np.asarray(x, np.float64), np.asarray(misfit)


def _minimised(problem: Problem, theta: FloatArray) -> FloatArray:
    """The unknowns at which the misfits are least."""
    with IMPORTING:
        from scipy.optimize import least_squares

    low, high = problem.bounds()
    theta = np.clip(theta, low + 1e-6, high - 1e-6)
    problem.settle(theta)
    unit = np.full(problem.count, FIRST_STEP)
    unit[-2:] *= problem.scale
    # The length of the first step is 1 in these units where the search begins at 0.
    found = least_squares(
        lambda u: problem.residuals(theta + unit * u),
        np.zeros(problem.count),
        lambda u: problem.jacobian(theta + unit * u) * unit,
        bounds=((low - theta) / unit, (high - theta) / unit),
        loss=problem.loss,
        xtol=STEP_TOLERANCE,
        ftol=COST_TOLERANCE,
    )
    return np.asarray(theta + unit * found.x)


def _fit_of(problem: Problem, theta: FloatArray, offset: FloatArray) -> Fit:
    """The fit that unknowns stand for."""
    observed, lines = problem.observed, problem.observed.before.lines
    misfit = problem.misfit(theta)
    seen = observed.displacement
    predicted = seen - misfit
    scored = observed.scored & np.isfinite(misfit)
    r = float(np.corrcoef(predicted[scored], seen[scored])[0, 1]) if scored.sum() > 2 else math.nan
    river = float((lines.spacing()[lines.owner()])[scored].sum())
    independent = river / problem.alike(np.where(scored, predicted, 0.0))
    if not r * math.sqrt(max(independent, 0.0)) > SIGNIFICANCE:
        raise InputError(
            f"the law does not explain how this river moved: r is {r:.2f} over {river / 1e3:.0f} km; check that before "
            "and after show one river, the years, and the widths, or give a longer reach"
        )
    covariance = problem.covariance(theta)
    low, high = problem.bounds()
    for k, name in enumerate(problem.names):
        if min(theta[k] - low[k], high[k] - theta[k]) < 0.01:
            warn(f"{name} is {math.exp(theta[k]):g}, at the end of where it is looked for: the surveys do not tell it")
    constants = problem.constants(theta)
    return Fit(
        params=problem.params.replace(**constants),
        constants=constants,
        log_error={name: float(np.sqrt(covariance[k, k])) for k, name in enumerate(problem.names)},
        correlation=r,
        skill=1.0 - float(np.abs(misfit[scored]).mean() / np.abs(seen[scored]).mean()),
        offset=offset,
        scale=problem.scale,
        correlation_length=problem.correlation_length,
        years=observed.years,
        start=lines.start,
        xy=lines.xy,
        width=lines.width,
        observed=seen,
        predicted=predicted,
        scored=scored,
        law=problem.law(theta),
        problem=problem,
        unknowns=theta,
        covariance=covariance,
    )


def _nearest_values(xy: FloatArray, value: FloatArray, size: float, reach: float, crs: str | None) -> Raster:
    """A raster with the value of the nearest point, as far as ``reach`` from all of them, m."""
    with IMPORTING:
        from scipy.spatial import cKDTree

    low, high = xy.min(axis=0) - reach, xy.max(axis=0) + reach
    columns, rows = (math.ceil(extent / size) for extent in high - low)
    if columns * rows > MOST_CELLS:
        raise InputError(
            f"a map of the rate has {columns} x {rows} cells of {size:g} m; give a cell_size of "
            f"{size * math.sqrt(columns * rows / MOST_CELLS):.0f} m or more"
        )
    x = low[0] + (np.arange(columns) + 0.5) * size
    y = high[1] - (np.arange(rows) + 0.5) * size
    tree, values = cKDTree(xy), np.empty((rows, columns))
    for k in range(rows):
        values[k] = value[tree.query(np.column_stack([x, np.full(columns, y[k])]))[1]]
    return Raster(values, size, origin=(float(low[0]), float(high[1])), crs=crs)
