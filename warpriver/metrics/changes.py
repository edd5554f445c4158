"""What changes: migration between two dates, its lag behind curvature, and the lengths of what was cut off."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpriver.arrays import ComplexArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.metrics.lines import (
    FloatArray,
    IndexArray,
    arc_length_of,
    cross,
    dot,
    norm,
    parabola_peak,
    unit,
)
from warpriver.public import public
from warpriver.validate import checked_line, floats, positive

__all__ = ["LognormalFit", "Match", "lag", "lognormal_fit", "match_lines", "migration", "oxbow_lengths"]

# Cosine of the largest angle between a channel and its counterpart at another date: 60 degrees.
_SAME_WAY = 0.5
# Candidate pieces that are projected on exactly for each nearest-point query.
_CANDIDATES = 6


class LognormalFit(NamedTuple):
    """A lognormal distribution.

    Attributes:
        geometric_mean: exp of the mean logarithm, in the unit of the sample.
        log_sd: standard deviation of the natural logarithm, dimensionless.
    """

    geometric_mean: float
    log_sd: float


@public
def migration(
    before: ArrayLike, after: ArrayLike, years: float | None = None, max_distance: float | None = None
) -> FloatArray:
    """Displacement of a channel between two dates at each point of the first line, > 0 to the left.

    Each point of `before` is paired with the nearest point on those segments of `after` that do not run the
    opposite way (so never with the other limb of a bend), and the distance gets the sign of the side. A point
    has no counterpart, and gets nan, where

    - the two channels differ in direction by more than 60 degrees;
    - the nearest point on `before` of its counterpart is farther from it along the channel than the
      displacement (the channel between was abandoned, or a cutoff joined what was far apart);
    - the displacement would run along the channel more than across it (beyond an end of `after`);
    - the distance exceeds `max_distance`.

    Args:
        before: (n, 2) points at the first date in downstream order, m.
        after: (m, 2) points at the second date in downstream order, m, in the same coordinates.
        years: time between the two dates, yr; None for the plain displacement.
        max_distance: largest displacement to accept, m; None for any. One or two widths keep cutoffs out.

    Returns:
        (n,) displacement, m, or rate, m/yr, if `years` is given; nan where there is no counterpart.

    Raises:
        ValueError: a line is not one of at least three finite, distinct points, or a number is not positive.
    """
    old, new = checked_line(before, "before"), checked_line(after, "after")
    scale = 1.0 if years is None else positive(years, "years")
    limit = math.inf if max_distance is None else positive(max_distance, "max_distance")
    return match_lines(old, new, limit).distance / scale


@public
def lag(curvature_values: ArrayLike, rate_values: ArrayLike, spacing: float, max_lag: float | None = None) -> float:
    """Downstream distance by which migration follows curvature.

    Both series are sampled evenly along the channel. A bend to the left moves to the right, so curvature is
    correlated with minus the rate: the result is the shift, within `max_lag` either way, at which the Pearson
    correlation is largest, refined by a parabola [Sylvester2019]. Pairs with a nan in either series are left
    out. On a regular train of bends the correlation repeats every two bends: keep `max_lag` below one bend's
    arc there.

    Args:
        curvature_values: (n,) curvature, > 0 to the left, any unit.
        rate_values: (n,) migration at the same points, > 0 to the left as `migration` returns it, any unit.
        spacing: distance between samples along the channel, m.
        max_lag: largest shift to look at, m, at most half the series; None for an eighth of it.

    Returns:
        Lag, m, > 0 where migration lies downstream of curvature; nan where no correlation is defined.

    Raises:
        ValueError: the series are not one-dimensional and of one length of at least four, `spacing` is not
            positive, or `max_lag` is out of range.
    """
    bend, rate = floats(curvature_values, "curvature_values"), floats(rate_values, "rate_values")
    if bend.ndim != 1 or bend.shape != rate.shape or bend.size < 4:
        raise InputError(
            f"curvature_values and rate_values have shapes {bend.shape} and {rate.shape}; "
            "give two series of one length with at least 4 samples."
        )
    step = positive(spacing, "spacing")
    reach = bend.size // 8 if max_lag is None else int(positive(max_lag, "max_lag") / step)
    reach = max(reach, 1)
    if reach > bend.size // 2:
        raise InputError(f"max_lag is {max_lag} m; give at most half the series, {bend.size // 2 * step} m.")
    score = _masked_correlation(bend, -rate, reach)
    if np.isnan(score).all():
        return math.nan
    shift = step * np.arange(-reach, reach + 1, dtype=np.float64)
    best, _ = parabola_peak(shift, score, np.array([np.nanargmax(score)]))
    return float(best[0])


@public
def oxbow_lengths(cutoffs: Iterable[Any]) -> FloatArray:
    """Lengths of abandoned loops.

    Args:
        cutoffs: (n, 2) arrays of points, or objects with such an array as `.xy`, m.

    Returns:
        (k,) length along each loop, m, in the order given; empty where there are none.

    Raises:
        ValueError: a loop is not a line of at least three finite, distinct points.
    """
    loops = (checked_line(getattr(cutoff, "xy", cutoff), f"cutoff {k}") for k, cutoff in enumerate(cutoffs))
    return np.array([arc_length_of(loop)[-1] for loop in loops], dtype=np.float64)


@public
def lognormal_fit(lengths: ArrayLike) -> LognormalFit:
    """Lognormal distribution of a sample, for example of oxbow lengths.

    Args:
        lengths: (k,) positive values.

    Returns:
        Geometric mean in the unit of `lengths`, and the sample standard deviation (k - 1) of the natural
        logarithm, nan for a single value.

    Raises:
        ValueError: `lengths` is empty or holds a value that is not positive and finite.
    """
    sample = floats(lengths, "lengths").ravel()
    if sample.size == 0 or not (np.isfinite(sample) & (sample > 0.0)).all():
        raise InputError(f"lengths holds {sample.size} values; give at least one, all positive and finite.")
    log = np.log(sample)
    spread = float(log.std(ddof=1)) if log.size > 1 else math.nan
    return LognormalFit(float(np.exp(log.mean())), spread)


class Match(NamedTuple):
    """Where the points of a line have gone to on a later one; see :func:`migration`.

    Attributes:
        distance: (n,) displacement, m, > 0 to the left; nan where a point has no counterpart.
        foot: (n, 2) nearest point on the later line, m, also where it is no counterpart.
        segment: (n,) segment of the later line that it lies on.
        share: (n,) how far along that segment, from 0 to 1.
    """

    distance: FloatArray
    foot: FloatArray
    segment: IndexArray
    share: FloatArray


def match_lines(old: FloatArray, new: FloatArray, limit: float = math.inf) -> Match:
    """Return the counterparts on a later line of the points of a line, as :func:`migration` pairs them.

    Args:
        old: (n, 2) checked points at the first date, m.
        new: (m, 2) checked points at the second date, m.
        limit: Largest displacement to accept, m.
    """
    s = arc_length_of(old)
    heading = unit(np.gradient(old, s, axis=0))
    foot, segment = _nearest(old, heading, new)
    direction = unit(np.diff(new, axis=0))[segment]
    back, back_segment = _nearest(foot, direction, old)
    slip = np.abs(s[back_segment] + norm(back - old[back_segment]) - s)

    step = foot - old
    distance = norm(step)
    along, across = dot(step, direction + heading), cross(direction + heading, step)
    gap = s[-1] / (len(s) - 1)
    found = (distance <= limit) & (dot(heading, direction) > _SAME_WAY) & (slip <= distance + gap)
    # The last term: a displacement that is all rounding errors has no direction.
    found &= np.abs(along) <= np.abs(across) + 1e-3 * gap
    share = norm(foot - new[segment]) / norm(new[segment + 1] - new[segment])
    return Match(np.where(found, np.copysign(distance, across), np.nan), foot, segment, share)


def _nearest(points: FloatArray, heading: FloatArray, line: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Nearest point for each point on the segments that run its way, (n, 2), and that segment, (n,).

    A segment runs the way of a point if it lies within a right angle of the point's heading, rounded to one
    of eight; where none does, all are taken. Segments are split into pieces no longer than the mean one, so
    that the pieces with the nearest middles, O(n log m) to look up, hold the nearest point.
    """
    segment = np.diff(line, axis=0)
    length = norm(segment)
    count = np.ceil(length / length.mean()).astype(np.intp)
    owner = np.repeat(np.arange(len(segment)), count)
    piece = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    middle = line[owner] + ((piece + 0.5) / count[owner])[:, None] * segment[owner]

    foot, home = np.empty_like(points), np.empty(len(points), dtype=np.intp)
    compass = np.rint(np.arctan2(heading[:, 1], heading[:, 0]) / (0.25 * np.pi)).astype(np.intp) % 8
    for k in np.unique(compass):
        mine = np.flatnonzero(compass == k)
        same_way = segment @ [math.cos(0.25 * np.pi * k), math.sin(0.25 * np.pi * k)] > 0.0
        pieces = same_way[owner] if same_way.any() else np.full(owner.shape, True)
        foot[mine], home[mine] = _project(points[mine], middle[pieces], owner[pieces], line)
    return foot, home


def _project(
    points: FloatArray, middle: FloatArray, owner: IndexArray, line: FloatArray
) -> tuple[FloatArray, IndexArray]:
    """Nearest point for each point on the segments that own the nearest middles, and that segment."""
    with IMPORTING:
        from scipy.spatial import cKDTree  # here, because importing it takes longer than most calls

    found = cKDTree(middle).query(points, k=min(_CANDIDATES, len(owner)))[1].reshape(len(points), -1)
    start, end = line[owner[found]], line[owner[found] + 1]
    run = ((points[:, None] - start) * (end - start)).sum(axis=2) / ((end - start) ** 2).sum(axis=2)
    foot = np.where(run[:, :, None] >= 1.0, end, start + np.clip(run, 0.0, 1.0)[:, :, None] * (end - start))
    away = foot - points[:, None]
    best = np.hypot(away[:, :, 0], away[:, :, 1]).argmin(axis=1)
    row = np.arange(len(points))
    return foot[row, best], owner[found[row, best]]


def _masked_correlation(a: FloatArray, b: FloatArray, reach: int) -> FloatArray:
    """(2 reach + 1,) Pearson correlation of a[i] and b[i + k], |k| <= reach, over pairs without nan."""
    ma, mb = np.isfinite(a), np.isfinite(b)
    fa = np.where(ma, a - (a[ma].mean() if ma.any() else 0.0), 0.0)
    fb = np.where(mb, b - (b[mb].mean() if mb.any() else 0.0), 0.0)
    size = 1 << (2 * len(a)).bit_length()

    def spectrum(series: NDArray[Any]) -> ComplexArray:
        return np.fft.rfft(series.astype(np.float64), size)

    def pair(left: ComplexArray, right: ComplexArray) -> FloatArray:
        full = np.fft.irfft(left.conj() * right, size)
        return np.concatenate([full[size - reach :], full[: reach + 1]])

    one_a, one_b, sa, sb = spectrum(ma), spectrum(mb), spectrum(fa), spectrum(fb)
    count = np.rint(pair(one_a, one_b))
    sum_a, sum_b = pair(sa, one_b), pair(one_a, sb)
    spread_a = count * pair(spectrum(fa**2), one_b) - sum_a**2
    spread_b = count * pair(one_a, spectrum(fb**2)) - sum_b**2
    enough = (count >= 3) & (spread_a > 1e-12 * spread_a.max()) & (spread_b > 1e-12 * spread_b.max())
    scale = np.sqrt(np.where(enough, spread_a * spread_b, 1.0))
    return np.where(enough, (count * pair(sa, sb) - sum_a * sum_b) / scale, np.nan)
