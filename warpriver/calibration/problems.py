"""The least-squares problem of a calibration: constants of the rate law in, misfits of displacements out."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver.arrays import FloatArray
from warpriver.calibration.courses import Lines, trace
from warpriver.calibration.observed import Observed, left_normals, match_all
from warpriver.metrics.changes import Match
from warpriver.params import MeanderParams

__all__ = ["BOUNDS", "COLUMNS", "Field", "Problem", "robust_scale"]

# Constants that can be fitted, and the column of ``Courses.law`` that each is. The memory is told by one of two.
COLUMNS = {"migration_rate": 0, "memory_length": 1, "friction": 1, "curvature_saturation": 2}
# Where they are looked for: wide enough for any river, narrow enough for the steps to stay sane.
BOUNDS = {
    "migration_rate": (1e-4, 3e3),
    "memory_length": (0.3, 15.0),
    "friction": (2e-4, 0.2),
    "curvature_saturation": (0.02, 3.0),
}
# Logarithm of how far the rate is looked for from its first guess, either way: a factor of thirty.
RATE_RANGE = 3.4
# Misfits beyond so many standard deviations count less and less.
OUTLIER = 1.5
# Standard deviation of the logarithm of a constant that varies along a river, about its value for the whole.
FIELD_SD = 0.5
# Misfits are alike over so many widths at most: longer waves in them are too few to be told from one.
MOST_ALIKE = 30.0
# Knots that are so many apart along a line share a direction, as what one of them moves does not reach the next
# [Curtis1974].
COLORS = 6


@dataclasses.dataclass(frozen=True)
class Field:
    """How one constant varies along the rivers: by a factor exp(sum of coefficients times hats).

    Attributes:
        name: The constant.
        knot: (N, 2) the two knots that each point lies between.
        weight: (N,) the part of the second one.
        color: (K,) direction that each knot shares.
        nearest: (C, N) knot of each colour that is nearest to a point, -1 where the line has none.
    """

    name: str
    knot: NDArray[np.intp]
    weight: FloatArray
    color: NDArray[np.intp]
    nearest: NDArray[np.intp]

    @property
    def count(self) -> int:
        """Number of knots."""
        return len(self.color)

    def values(self, coefficients: FloatArray) -> FloatArray:
        """Logarithm of the factor at each point, (N,)."""
        first, second = self.knot.T
        return np.asarray((1.0 - self.weight) * coefficients[first] + self.weight * coefficients[second])

    def seeds(self) -> FloatArray:
        """What each colour adds to the logarithm at each point for a unit of all of its knots, (C, N)."""
        return np.stack([self.values((self.color == c).astype(np.float64)) for c in range(self.color.max() + 1)])

    @classmethod
    def smooth(cls, name: str, lines: Lines, length: float) -> Field:
        """Hats of so many widths from knot to knot along each line."""
        knots, weights, colors, first = [], [], [], 0
        for n, h, w in zip(np.diff(lines.start), lines.spacing(), lines.mean_width(), strict=True):
            count = max(2, 1 + round((n - 1) * h / (length * w)))
            at = np.linspace(0.0, count - 1.0, n)
            below = np.minimum(at.astype(np.intp), count - 2)
            knots.append(first + np.stack([below, below + 1], axis=1))
            weights.append(at - below)
            colors.append(np.arange(count) % COLORS)
            first += count
        return cls._of(name, lines, np.concatenate(knots), np.concatenate(weights), np.concatenate(colors))

    @classmethod
    def by_channel(cls, name: str, lines: Lines, channel: NDArray[np.intp]) -> Field:
        """One value a channel."""
        numbers, index = np.unique(channel, return_inverse=True)
        order = np.zeros(len(numbers), np.intp)
        # Along each line one after the other.
        for k in range(lines.count):
            part = index[lines.start[k] : lines.start[k + 1]]
            links = part[np.concatenate([[0], np.flatnonzero(np.diff(part)) + 1])]
            order[links] = np.arange(len(links)) % COLORS
        return cls._of(name, lines, np.stack([index, index], axis=1), np.zeros(len(index)), order)

    @classmethod
    def _of(cls, name: str, lines: Lines, knot: NDArray[np.intp], weight: FloatArray, color: NDArray[np.intp]) -> Field:
        nearest = np.full((int(color.max()) + 1, len(knot)), -1)
        main = np.where(weight < 0.5, knot[:, 0], knot[:, 1])
        for k in range(lines.count):
            part = slice(lines.start[k], lines.start[k + 1])
            own = main[part]
            # Middle of the points that belong most to each knot of the line.
            knots, at = np.unique(own, return_inverse=True)
            middle = np.bincount(at, weights=np.arange(len(own))) / np.bincount(at)
            for c in range(len(nearest)):
                mine = np.flatnonzero(color[knots] == c)
                if len(mine):
                    mine = mine[np.argsort(middle[mine])]
                    edges = 0.5 * (middle[mine][1:] + middle[mine][:-1])
                    nearest[c, part] = knots[mine[np.searchsorted(edges, np.arange(len(own)))]]
        return cls(name, knot, weight, color, nearest)


def robust_scale(misfit: FloatArray) -> float:
    """Standard deviation of a normal sample with the same median distance from 0."""
    return float(np.median(np.abs(misfit))) / 0.6745


class Problem:
    """Misfits of the displacements that the law makes, and their derivatives, for ``scipy.optimize.least_squares``.

    The unknowns are the logarithms of the constants, the coefficients of the fields, and the offset between the two
    surveys in m, in this order.

    Attributes:
        observed: What is to be met.
        params: Constants that are not fitted.
        names: The constants that are fitted.
        fields: Which of them vary along the river.
        scale: Standard deviation of a misfit, m.
        correlation_length: Distance in m over which misfits are alike: points within it count as one.
    """

    def __init__(
        self,
        observed: Observed,
        params: MeanderParams,
        names: Sequence[str],
        fields: Sequence[Field],
        priors: dict[str, tuple[float, float]],
        offset: bool,
        device: wp.DeviceLike,
    ):
        self.observed, self.params, self.names, self.fields = observed, params, tuple(names), tuple(fields)
        self.priors, self.offset, self.device = priors, offset, device
        self.scale, self.correlation_length = 1.0, float(observed.before.lines.mean_width().mean())
        lines = observed.before.lines
        self._spacing = lines.spacing()[lines.owner()]
        self._seeds = self._directions()
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    # ---- unknowns

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return len(self.names) + sum(field.count for field in self.fields) + 2

    def start(self) -> FloatArray:
        """The unknowns of ``params``, without fields and offset."""
        theta = np.zeros(self.count)
        theta[: len(self.names)] = [math.log(getattr(self.params, name)) for name in self.names]
        return theta

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest values of the unknowns."""
        low, high = np.full(self.count, -4.0 * FIELD_SD), np.full(self.count, 4.0 * FIELD_SD)
        for k, name in enumerate(self.names):
            low[k], high[k] = np.log(BOUNDS[name])
            if name == "migration_rate":
                # The first guess of a rate is not far off; far off, steps are many.
                guess = math.log(self.params.migration_rate)
                low[k], high[k] = max(low[k], guess - RATE_RANGE), min(high[k], guess + RATE_RANGE)
        # Surveys that lie farther apart are to be put right first.
        reach = float(self.observed.before.lines.mean_width().max()) if self.offset else 1e-3
        low[-2:], high[-2:] = -reach, reach
        return low, high

    def constants(self, theta: FloatArray) -> dict[str, float]:
        """The constants that belong to unknowns."""
        return {name: float(np.exp(theta[k])) for k, name in enumerate(self.names)}

    def law(self, theta: FloatArray) -> FloatArray:
        """Rate, memory and saturation at every point, (N, 3); see ``trace``."""
        found = self.params.replace(**self.constants(theta))
        memory = found.memory_length if found.memory_length > 0.0 else 0.5 / found.friction
        row = [found.migration_rate, memory, found.curvature_saturation]
        law = np.tile(np.array(row), (len(self._spacing), 1))
        for field, coefficients in zip(self.fields, self._split(theta), strict=True):
            sign = -1.0 if field.name == "friction" else 1.0
            law[:, COLUMNS[field.name]] *= np.exp(sign * field.values(coefficients))
        return law

    def _split(self, theta: FloatArray) -> list[FloatArray]:
        """Coefficients of each field."""
        ends = len(self.names) + np.cumsum([0] + [field.count for field in self.fields])
        return [theta[a:b] for a, b in itertools.pairwise(ends)]

    def _directions(self) -> FloatArray:
        """Seeds of all directions, (A, N, 3): the constants, then the colours of each field."""
        size, rows = len(self._spacing), []
        for name in self.names:
            row = np.zeros((size, 3))
            row[:, COLUMNS[name]] = -1.0 if name == "friction" else 1.0
            rows.append(row)
        for field in self.fields:
            for seed in field.seeds():
                row = np.zeros((size, 3))
                row[:, COLUMNS[field.name]] = -seed if field.name == "friction" else seed
                rows.append(row)
        return np.stack(rows) if rows else np.zeros((0, size, 3))

    # ---- misfits

    def displaced(self, theta: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Displacement of each point by the law, (N,), nan where it has no counterpart, and the lines."""
        lines = self.observed.before.lines
        run = trace(lines, self.law(theta), self._seeds[:0], self.params, self.observed.years, device=self.device)
        moved = np.split(run.xy, lines.start[1:-1])
        return np.concatenate([match.distance for match in match_all(lines, moved)]), moved

    def misfit(self, theta: FloatArray) -> FloatArray:
        """What is observed less what the law and the offset give, (N,), m; nan where nothing can be compared."""
        return self._evaluate(theta)[0]

    def residuals(self, theta: FloatArray) -> FloatArray:
        """Misfits of the scored points in standard deviations, each as much as it counts, then those of the priors."""
        misfit = np.nan_to_num(self._evaluate(theta)[0][self.observed.scored])
        return np.concatenate([misfit * self._root()[self.observed.scored], self._prior_misfit(theta)])

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivative of ``residuals`` by the unknowns."""
        change = np.nan_to_num(self._evaluate(theta)[1][self.observed.scored])
        return np.concatenate([change * self._root()[self.observed.scored, None], self._prior_change()])

    def loss(self, z: FloatArray) -> FloatArray:
        """Robust loss 2 (sqrt(1 + z) - 1) of misfits beyond ``OUTLIER``, and squares for the priors."""
        z = np.asarray(z)
        count = int(self.observed.scored.sum())
        limit = (OUTLIER * self.scale * self._root()[self.observed.scored]) ** 2
        part = z[:count] / limit
        root = np.sqrt(1.0 + part)
        rho = np.stack([z, np.ones_like(z), np.zeros_like(z)])
        rho[0, :count] = 2.0 * limit * (root - 1.0)
        rho[1, :count] = 1.0 / root
        rho[2, :count] = -0.5 / (root**3 * limit)
        return rho

    def costs(self, unknowns: FloatArray) -> FloatArray:
        """Minus the logarithm of the posterior density, but for a constant, of members (M, unknowns): (M,).

        All members are simulated together.
        """
        lines, observed = self.observed.before.lines, self.observed
        law = np.concatenate([self.law(theta) for theta in unknowns])
        tiled, none = lines.tiled(len(unknowns)), np.zeros((0, len(law), 3))
        run = trace(tiled, law, none, self.params, observed.years, device=self.device)
        costs = []
        for theta, xy in zip(unknowns, np.split(run.xy, len(unknowns)), strict=True):
            moved = np.split(xy, lines.start[1:-1])
            displacement = np.concatenate([match.distance for match in match_all(lines, moved)])
            misfit = np.nan_to_num(observed.displacement - displacement - observed.normal @ theta[-2:])
            scored = (misfit * self._root())[observed.scored]
            residual = np.concatenate([scored, self._prior_misfit(theta)])
            costs.append(0.5 * float(self.loss(residual**2)[0].sum()))
        return np.array(costs)

    def _root(self) -> FloatArray:
        """What a misfit at each point is multiplied by."""
        return np.sqrt(np.minimum(self._spacing / self.correlation_length, 1.0)) / self.scale

    def _prior_misfit(self, theta: FloatArray) -> FloatArray:
        rows = [theta[len(self.names) : -2] / FIELD_SD]
        for k, name in enumerate(self.names):
            if name in self.priors:
                middle, sd = self.priors[name]
                rows.append(np.array([(theta[k] - math.log(middle)) / sd]))
        return np.concatenate(rows)

    def _prior_change(self) -> FloatArray:
        knots = self.count - len(self.names) - 2
        told = [k for k, name in enumerate(self.names) if name in self.priors]
        change = np.zeros((knots + len(told), self.count))
        change[np.arange(knots), len(self.names) + np.arange(knots)] = 1.0 / FIELD_SD
        for row, k in enumerate(told):
            change[knots + row, k] = 1.0 / self.priors[self.names[k]][1]
        return change

    def _evaluate(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Misfits (N,) and their derivatives (N, unknowns)."""
        if self._last is not None and np.array_equal(self._last[0], theta):
            return self._last[1], self._last[2]
        lines, observed = self.observed.before.lines, self.observed
        run = trace(lines, self.law(theta), self._seeds, self.params, observed.years, device=self.device)
        moved = np.split(run.xy, lines.start[1:-1])
        found = match_all(lines, moved)
        displacement = np.concatenate([match.distance for match in found])
        misfit = observed.displacement - displacement - observed.normal @ theta[-2:]
        change = np.empty((len(misfit), self.count))
        by_direction = np.concatenate(
            [
                _foot_change(match, xy, run.change[:, a:b])
                for match, xy, a, b in zip(found, moved, lines.start[:-1], lines.start[1:], strict=True)
            ],
            axis=1,
        )
        change[:, : len(self.names)] = -by_direction[: len(self.names)].T
        column, direction = len(self.names), len(self.names)
        for field in self.fields:
            change[:, column : column + field.count] = 0.0
            for c, nearest in enumerate(field.nearest):
                has = nearest >= 0
                change[has, column + nearest[has]] = -by_direction[direction + c, has]
            column, direction = column + field.count, direction + len(field.nearest)
        change[:, -2:] = -observed.normal if self.offset else 0.0
        self._last = theta.copy(), misfit, change
        return misfit, change

    # ---- what the misfits tell

    def settle(self, theta: FloatArray) -> None:
        """Take the scale of the misfits, and the distance over which they are alike, from those that there are."""
        misfit = np.where(self.observed.scored, self.misfit(theta), np.nan)
        self.scale = max(robust_scale(misfit[np.isfinite(misfit)]), 1e-6)
        most = MOST_ALIKE * float(self.observed.before.lines.mean_width().max())
        self.correlation_length = min(self.alike(np.clip(np.nan_to_num(misfit / self.scale), -3.0, 3.0)), most)

    def alike(self, series: FloatArray) -> float:
        """Distance along the river over which a series, one value a point, is alike, m: its integral scale."""
        lines = self.observed.before.lines
        parts = zip(np.split(series, lines.start[1:-1]), lines.spacing(), strict=True)
        return float(np.average([_integral_scale(part) * h for part, h in parts], weights=np.diff(lines.start)))

    def covariance(self, theta: FloatArray) -> FloatArray:
        """Covariance of the unknowns, by the spread of what pieces of river say of them [Liang1986].

        Misfits are alike along a bend: those of one piece, ten times as long as they are alike, count as one
        observation, whatever their dependence.
        """
        residual, change = self.residuals(theta), self.jacobian(theta)
        bent = self.loss(residual**2)[1]
        curvature = change.T @ (bent[:, None] * change)
        count = int(self.observed.scored.sum())
        lines = self.observed.before.lines
        along = np.concatenate([np.arange(n) * h for n, h in zip(np.diff(lines.start), lines.spacing(), strict=True)])
        place = np.stack([lines.owner(), along // (10.0 * self.correlation_length)], axis=1)[self.observed.scored]
        block = np.unique(place, axis=0, return_inverse=True)[1].ravel()
        push = (bent * residual)[:count, None] * change[:count]
        blocks = block.max() + 1
        sums = np.stack([np.bincount(block, weights=column, minlength=blocks) for column in push.T], axis=1)
        spread = sums.T @ sums * blocks / max(blocks - 1, 1)
        # What priors say counts as if it were observed.
        told = change[count:]
        inverse = np.linalg.pinv(curvature)
        return np.asarray(inverse @ (spread + told.T @ told) @ inverse)


def _foot_change(match: Match, xy: FloatArray, change: FloatArray) -> FloatArray:
    """Derivative of the distances to a line by the directions, (A, n): how its nearest places move across it.

    Only what points move across the line counts: they slide along it where the even places do.
    """
    across = (change * left_normals(xy)).sum(axis=2)
    return np.asarray((1.0 - match.share) * across[:, match.segment] + match.share * across[:, match.segment + 1])


def _integral_scale(series: FloatArray) -> float:
    """Sum of a series' autocorrelation, both ways, up to where it first falls below 0; at least 1 sample."""
    size = 1 << (2 * len(series)).bit_length()
    power = np.abs(np.fft.rfft(series, size)) ** 2
    correlation = np.fft.irfft(power, size)[: len(series) // 2]
    if correlation[0] <= 0.0:
        return 1.0
    below = np.flatnonzero(correlation <= 0.0)
    end = int(below[0]) if len(below) else len(correlation)
    return max(1.0, 2.0 * float(correlation[:end].sum() / correlation[0]) - 1.0)
