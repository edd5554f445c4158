"""Planform metrics of rivers: arc length, curvature, bends, wavelength, migration, oxbow lakes.

Pure functions on float64 NumPy arrays. A centreline is an (n, 2) array of points in metres that runs
downstream; left and right are as seen looking downstream, and curvature > 0 turns left.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Bends",
    "InflectionPoints",
    "LognormalFit",
    "arc_length",
    "bend_radius",
    "bend_sinuosity",
    "bends",
    "curvature",
    "inflection_points",
    "lag",
    "lognormal_fit",
    "migration",
    "oxbow_lengths",
    "sinuosity",
    "sinuosity_window",
    "wavelength",
    "wavelength_range",
]

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

# Scale of the smoothing of curvature along the arc, in widths.
_SMOOTHING = 1.0
# A bend whose peak |curvature| * width stays below this (radius above 20 widths) does not count as a bend.
_STRAIGHT = 0.05
# Samples of the smoothed curvature per width of arc.
_SAMPLES_PER_WIDTH = 8.0
# Cosine of the largest angle between a channel and its counterpart at another date: 60 degrees.
_SAME_WAY = 0.5
# Candidate pieces that are projected on exactly for each nearest-point query.
_CANDIDATES = 6


class InflectionPoints(NamedTuple):
    """Where the curvature of a line changes sign.

    Attributes:
        arc_length: (k,) distance along the line from its first point, m.
        xy: (k, 2) positions on the line, m.
    """

    arc_length: FloatArray
    xy: FloatArray


class Bends(NamedTuple):
    """The bends of a line, each between two successive inflection points, in downstream order.

    Attributes:
        start: (k,) arc length of the upstream inflection point, m.
        end: (k,) arc length of the downstream inflection point, m.
        arc: (k,) length along the line between the two, m.
        chord: (k,) straight distance between the two, m.
        sinuosity: (k,) arc / chord, dimensionless (inf where the chord is 0).
        apex: (k,) arc length of the largest absolute curvature, m.
        curvature: (k,) signed curvature at the apex, 1/m; > 0 turns left.
        radius: (k,) radius of curvature at the apex, m.
    """

    start: FloatArray
    end: FloatArray
    arc: FloatArray
    chord: FloatArray
    sinuosity: FloatArray
    apex: FloatArray
    curvature: FloatArray
    radius: FloatArray


class LognormalFit(NamedTuple):
    """A lognormal distribution.

    Attributes:
        geometric_mean: exp of the mean logarithm, in the unit of the sample.
        log_sd: standard deviation of the natural logarithm, dimensionless.
    """

    geometric_mean: float
    log_sd: float


def arc_length(xy: ArrayLike) -> FloatArray:
    """Cumulative chord length along a line.

    Args:
        xy: (n, 2) points in downstream order, m.

    Returns:
        (n,) distance from the first point along the line, m; the first value is 0.

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points.
    """
    return _arc_length(_polyline(xy))


def curvature(xy: ArrayLike, closed: bool = False) -> FloatArray:
    """Signed curvature at every point, > 0 where the line turns left.

    Compact central difference: the curvature of the circle through a point and its two neighbours. With unit
    chord vectors u, v of the two segments of lengths h1, h2 that meet at the point,

        C = 2 (u x v) / |h1 u + h2 v|,

    exact on a circle, second order where the spacing varies smoothly, and at most 2 / h however sharp the line
    turns. The kernels use the same formula. The two end values continue the nearest
    two inner values linearly in arc length (by at most twice their distance, so that a tiny gap cannot throw
    them far off); a constant curvature thus stays constant up to the ends. Where the line doubles straight
    back on itself curvature is undefined, and 0 stands for it.

    Args:
        xy: (n, 2) points in downstream order, m.
        closed: the line is a ring, whose last point is joined to the first; all its values are inner ones.

    Returns:
        (n,) curvature, 1/m.

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points.
    """
    if closed:
        ring = _ring(xy)
        return _curvature(np.concatenate([ring[-1:], ring, ring[:1]]))[1:-1]
    return _curvature(_polyline(xy))


def sinuosity(xy: ArrayLike, closed: bool = False) -> float:
    """Length of a line over the straight distance between its ends [Paris2023, Eq. 3].

    A ring has no chord: its sinuosity is its length over the circumference of the circle of the same area, which
    limnology knows as the development of a shoreline [Hutchinson1957]. That of a circle is 1.

    Args:
        xy: (n, 2) points in downstream order, m.
        closed: the line is a ring, whose last point is joined to the first.

    Returns:
        Length / chord, dimensionless, at least 1; inf for a line that ends where it begins, or a ring without area.

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points.
    """
    if closed:
        ring = _ring(xy)
        around = _arc_length(np.concatenate([ring, ring[:1]]))[-1:]
        area = 0.5 * abs(float(_cross(ring - ring[0], np.roll(ring, -1, axis=0) - ring[0]).sum()))
        return float(_ratio(around, np.array([2.0 * math.sqrt(math.pi * area)]))[0])
    points = _polyline(xy)
    length = _arc_length(points)[-1:]
    return float(_ratio(length, _norm(points[-1:] - points[:1]))[0])


def sinuosity_window(xy: ArrayLike, window: float) -> FloatArray:
    """Sinuosity inside a moving window of arc length, centred at each point.

    The window ends are interpolated on the line. Near the two ends of the line the window is cut off there,
    so that it keeps at least half its length.

    Args:
        xy: (n, 2) points in downstream order, m.
        window: length of the window along the line, m.

    Returns:
        (n,) length / chord inside the window, dimensionless (inf where the chord is 0).

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points, or `window` is not positive.
    """
    points = _polyline(xy)
    half = 0.5 * _positive(window, "window")
    s = _arc_length(points)
    low = np.maximum(s - half, 0.0)
    high = np.minimum(s + half, s[-1])
    return _ratio(high - low, _norm(_at(points, s, high) - _at(points, s, low)))


def bend_sinuosity(xy: ArrayLike, width: float | None = None) -> FloatArray:
    """Sinuosity of each bend between successive inflection points.

    Args:
        xy: (n, 2) points in downstream order, m.
        width: channel width, m; smooths as in `inflection_points`.

    Returns:
        (k,) arc / chord of each bend, dimensionless, in downstream order.

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points, or `width` is not positive.
    """
    return bends(xy, width).sinuosity


def inflection_points(xy: ArrayLike, width: float | None = None) -> InflectionPoints:
    """Points where the line stops turning one way and starts turning the other way.

    The sign changes of the curvature are interpolated linearly between samples. Without `width` the curvature
    is that of `curvature`, and values within its rounding error count as straight. With `width`, noise must
    not make bends:

    1. the line is resampled evenly by a cubic spline (eight samples to a width, but never coarser than the
       given points nor finer than an eighth of their mean spacing), and its curvature is averaged along the
       arc with the weight (3/2 - x^2/2) exp(-x^2/2), x the distance in widths. Of a wave of 20, 10, 5, 2
       widths of arc this keeps 99.9, 98, 81 and 4 %;
    2. a bend whose peak |curvature| * width stays below 0.05 (radius above 20 widths) is merged with its
       neighbours. Where merging leaves several sign changes between two opposite bends, the middle one
       stands.

    Args:
        xy: (n, 2) points in downstream order, m.
        width: channel width, m, or None for the raw curvature.

    Returns:
        Arc lengths (k,) and positions (k, 2) of the inflection points, m; both empty where the line has none.

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points, or `width` is not positive.
    """
    points = _polyline(xy)
    position, _ = _sign_changes(*_bend_curvature(points, width))
    return InflectionPoints(position, _at(points, _arc_length(points), position))


def bends(xy: ArrayLike, width: float | None = None, closed: bool = False) -> Bends:
    """Measure every bend between two successive inflection points.

    The parts of the line before the first and after the last inflection point are not whole bends and are
    left out; all bends of a ring are whole, and one may reach beyond its end into the next lap. The apex is the
    largest absolute curvature, refined by a parabola through three samples. With `width` the curvature is the
    smoothed one of `inflection_points`, which flattens bends of less than five widths of arc.

    Args:
        xy: (n, 2) points in downstream order, m.
        width: channel width, m, or None for the raw curvature.
        closed: the line is a ring, whose last point is joined to the first.

    Returns:
        Arrays of length k, one value per bend; k is 0 where there are fewer than two inflection points.

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points, or `width` is not positive.
    """
    if closed:
        return _ring_bends(_ring(xy), width)
    points = _polyline(xy)
    s, value, floor = _bend_curvature(points, width)
    edge, first = _sign_changes(s, value, floor)
    start, end = edge[:-1], edge[1:]
    apex, peak = _apexes(s, value, first)
    chord = _norm(np.diff(_at(points, _arc_length(points), edge), axis=0))
    return Bends(start, end, end - start, chord, _ratio(end - start, chord), apex, peak, 1.0 / np.abs(peak))


def wavelength(xy: ArrayLike, width: float, half: bool = False, closed: bool = False) -> float:
    """Mean meander wavelength.

    A full meander is two bends, so the default is twice the mean straight distance between successive
    inflection points, the wavelength that the power laws of the field are about [Leopold1960, Williams1986].
    [Paris2023, Sec. 8.3] defines wavelength as the spacing of two successive inflection points, half of that,
    yet compares it with the laws for full meanders; `half=True` returns that spacing.

    Args:
        xy: (n, 2) points in downstream order, m.
        width: channel width, m; smooths as in `inflection_points`.
        half: return the mean spacing of successive inflection points instead of twice that.
        closed: the line is a ring, whose last point is joined to the first.

    Returns:
        Wavelength, m; nan where the line has fewer than two inflection points (a hardly bent line has none).

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points, or `width` is not positive.
    """
    chord = bends(xy, width, closed).chord
    if chord.size == 0:
        return math.nan
    return float(chord.mean()) * (1.0 if half else 2.0)


def bend_radius(xy: ArrayLike, width: float | None = None) -> FloatArray:
    """Radius of curvature at the apex of each bend.

    Args:
        xy: (n, 2) points in downstream order, m.
        width: channel width, m; smooths as in `inflection_points`.

    Returns:
        (k,) radius, m, in downstream order.

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points, or `width` is not positive.
    """
    return bends(xy, width).radius


def wavelength_range(width: float) -> tuple[float, float]:
    """Meander wavelengths to expect of real rivers of a width [Paris2023, Sec. 8.3].

        low = 6.28 w,    high = 1.65 * 7.5 w^1.12

    The paper quotes wavelength = a w^b with 6.28 <= a <= 12.34 and 1 <= b <= 1.13, an error of -40 %
    to +65 %, and prints [314, 990] m, [628, 2150] m and [1256, 4674] m for widths of 50, 100 and 200 m. Those
    numbers come from the lowest law without its error [Yalin1972] and from the law 7.5 w^1.12 of
    [Williams1986] with +65 %: here 989.4, 2150.5 and 4674.2 m, so only the printed 990 is off, by 0.6 m. The
    laws are for full meanders of two bends.

    Args:
        width: channel width, m.

    Returns:
        Lower and upper wavelength, m.

    Raises:
        ValueError: `width` is not positive.
    """
    w = _positive(width, "width")
    return 6.28 * w, 1.65 * 7.5 * w**1.12


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
    old, new = _polyline(before, "before"), _polyline(after, "after")
    scale = 1.0 if years is None else _positive(years, "years")
    limit = math.inf if max_distance is None else _positive(max_distance, "max_distance")
    s = _arc_length(old)
    heading = _unit(np.gradient(old, s, axis=0))
    foot, segment = _nearest(old, heading, new)
    direction = _unit(np.diff(new, axis=0))[segment]
    back, back_segment = _nearest(foot, direction, old)
    slip = np.abs(s[back_segment] + _norm(back - old[back_segment]) - s)

    step = foot - old
    distance = _norm(step)
    along, across = _dot(step, direction + heading), _cross(direction + heading, step)
    gap = s[-1] / (len(s) - 1)
    found = (distance <= limit) & (_dot(heading, direction) > _SAME_WAY) & (slip <= distance + gap)
    # The last term: a displacement that is all rounding errors has no direction.
    found &= np.abs(along) <= np.abs(across) + 1e-3 * gap
    return np.where(found, np.copysign(distance, across) / scale, np.nan)


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
    bend, rate = np.asarray(curvature_values, dtype=np.float64), np.asarray(rate_values, dtype=np.float64)
    if bend.ndim != 1 or bend.shape != rate.shape or bend.size < 4:
        raise ValueError(
            f"curvature_values and rate_values have shapes {bend.shape} and {rate.shape}; "
            "give two series of one length with at least 4 samples."
        )
    step = _positive(spacing, "spacing")
    reach = bend.size // 8 if max_lag is None else int(_positive(max_lag, "max_lag") / step)
    reach = max(reach, 1)
    if reach > bend.size // 2:
        raise ValueError(f"max_lag is {max_lag} m; give at most half the series, {bend.size // 2 * step} m.")
    score = _masked_correlation(bend, -rate, reach)
    if np.isnan(score).all():
        return math.nan
    shift = step * np.arange(-reach, reach + 1, dtype=np.float64)
    best, _ = _parabola_peak(shift, score, np.array([np.nanargmax(score)]))
    return float(best[0])


def oxbow_lengths(cutoffs: Iterable[Any]) -> FloatArray:
    """Lengths of abandoned loops.

    Args:
        cutoffs: (n, 2) arrays of points, or objects with such an array as `.xy`, m.

    Returns:
        (k,) length along each loop, m, in the order given; empty where there are none.

    Raises:
        ValueError: a loop is not a line of at least three finite, distinct points.
    """
    loops = (_polyline(getattr(cutoff, "xy", cutoff), f"cutoff {k}") for k, cutoff in enumerate(cutoffs))
    return np.array([_arc_length(loop)[-1] for loop in loops], dtype=np.float64)


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
    sample = np.asarray(lengths, dtype=np.float64).ravel()
    if sample.size == 0 or not (np.isfinite(sample) & (sample > 0.0)).all():
        raise ValueError(f"lengths holds {sample.size} values; give at least one, all positive and finite.")
    log = np.log(sample)
    spread = float(log.std(ddof=1)) if log.size > 1 else math.nan
    return LognormalFit(float(np.exp(log.mean())), spread)


def _polyline(xy: ArrayLike, name: str = "xy") -> FloatArray:
    """The points as a float64 (n, 2) array; raises ValueError where they are no usable line."""
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"{name} has shape {points.shape}; give an (n, 2) array of x, y in metres.")
    if len(points) < 3:
        raise ValueError(f"{name} has {len(points)} points; give at least 3.")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise ValueError(f"{name} is not finite at point {bad[0]}; remove or fill such points.")
    repeated = np.flatnonzero((points[1:] == points[:-1]).all(axis=1))
    if repeated.size:
        raise ValueError(f"{name} repeats point {repeated[0]} as the next point; remove one of them.")
    return points


def _ring(xy: ArrayLike) -> FloatArray:
    """The points of a ring, the first not repeated, as `_polyline` has those of a line."""
    points = _polyline(xy)
    if (points[0] == points[-1]).all():
        raise ValueError("xy repeats its first point at its end; leave it out of a closed line.")
    return points


def _ring_bends(ring: FloatArray, width: float | None) -> Bends:
    """`bends` of a checked ring, those that begin in one lap of it."""
    laps = bends(np.concatenate([ring, ring, ring, ring[:1]]), width)
    around = _arc_length(np.concatenate([ring, ring[:1]]))[-1]
    # Rounding must not count the bend at the seam twice, or not at all.
    seam = around * (1.0 - 1e-9)
    kept = (laps.start >= seam) & (laps.start < seam + around)
    lap = Bends(*(values[kept] for values in laps))
    return lap._replace(start=lap.start - around, end=lap.end - around, apex=lap.apex - around)


def _positive(value: float, name: str) -> float:
    """The value as a float; raises ValueError unless it is positive and finite."""
    number = float(value)
    if not (math.isfinite(number) and number > 0.0):
        raise ValueError(f"{name} is {value}; give a positive number.")
    return number


def _norm(vectors: FloatArray) -> FloatArray:
    """Length of each (n, 2) vector."""
    return np.hypot(vectors[:, 0], vectors[:, 1])


def _unit(vectors: FloatArray) -> FloatArray:
    """Each (n, 2) vector divided by its length; a zero vector stays zero."""
    length = _norm(vectors)[:, None]
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Dot product of each pair of (n, 2) vectors."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Signed cross product of each pair of (n, 2) vectors, > 0 where b lies to the left of a."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _ratio(length: FloatArray, chord: FloatArray) -> FloatArray:
    """The lengths over the chords, inf where the chord is 0, never below 1 by rounding."""
    ratio = np.divide(length, chord, out=np.full_like(length, np.inf), where=chord > 0.0)
    return np.maximum(ratio, 1.0)


def _at(points: FloatArray, s: FloatArray, position: FloatArray) -> FloatArray:
    """(k, 2) points on the line at the arc lengths `position`."""
    return np.column_stack([np.interp(position, s, points[:, 0]), np.interp(position, s, points[:, 1])])


def _arc_length(points: FloatArray) -> FloatArray:
    """`arc_length` of a checked line."""
    return np.concatenate([[0.0], np.cumsum(_norm(np.diff(points, axis=0)))])


def _curvature(points: FloatArray) -> FloatArray:
    """`curvature` of a checked line."""
    chord = np.diff(points, axis=0)
    h = _norm(chord)
    unit = chord / h[:, None]
    turn = 2.0 * _cross(unit[:-1], unit[1:])
    across = _norm(points[2:] - points[:-2])
    inner = np.divide(turn, across, out=np.zeros_like(turn), where=across > 0.0)
    if len(inner) == 1:
        return np.repeat(inner, 3)
    first = inner[0] + (inner[0] - inner[1]) * min(h[0] / h[1], 2.0)
    last = inner[-1] + (inner[-1] - inner[-2]) * min(h[-1] / h[-2], 2.0)
    return np.concatenate([[first], inner, [last]])


def _bend_curvature(points: FloatArray, width: float | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arc length, curvature and the absolute curvature that counts as straight, (m,) each."""
    s = _arc_length(points)
    if width is None:
        h = np.diff(s)
        area = np.concatenate([h[:1] ** 2, h[:-1] * h[1:], h[-1:] ** 2])
        return s, _curvature(points), 8.0 * np.finfo(np.float64).eps * np.abs(points).max() / area
    from scipy.interpolate import CubicSpline  # here, because importing it takes longer than most calls

    w = _positive(width, "width")
    mean = s[-1] / (len(s) - 1)
    spacing = min(max(w / _SAMPLES_PER_WIDTH, mean / _SAMPLES_PER_WIDTH), mean)
    even = np.linspace(0.0, s[-1], max(round(s[-1] / spacing), 2) + 1)
    value = _curvature(CubicSpline(s, points)(even))
    value[[0, -1]] = value[[1, -2]]  # extrapolated noise is the worst there is
    floor = np.full(even.shape, _STRAIGHT / w)
    # Within half a width of an end the smoothing has noise on one side only: no bend is told from it.
    floor[(even < 0.5 * w) | (even > even[-1] - 0.5 * w)] = np.inf
    return even, _smooth(value, _SMOOTHING * w / even[1]), floor


def _smooth(values: FloatArray, scale: float) -> FloatArray:
    """Weighted mean that keeps cubics, cut at 5 scales and at the ends; `scale` in samples."""
    reach = min(math.ceil(5.0 * scale), len(values) - 1)
    x = np.arange(-reach, reach + 1) / scale
    weight = (1.5 - 0.5 * x**2) * np.exp(-0.5 * x**2)
    size = 1 << (len(values) + 2 * reach).bit_length()
    spectrum = np.fft.rfft(weight, size)

    def convolve(series: FloatArray) -> FloatArray:
        return np.fft.irfft(np.fft.rfft(series, size) * spectrum, size)[reach : reach + len(series)]

    return convolve(values) / convolve(np.ones_like(values))


def _sign_changes(s: FloatArray, value: FloatArray, floor: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Where a curve passes from beyond +floor to beyond -floor or back, and the first sample after."""
    strong = np.flatnonzero(np.abs(value) > floor)
    turn = np.flatnonzero(np.diff(np.sign(value[strong])) != 0.0)
    last, first = strong[turn], strong[turn + 1]

    nonzero = np.flatnonzero(value)
    change = np.flatnonzero(np.diff(np.sign(value[nonzero])) != 0.0)
    left, right = nonzero[change], nonzero[change + 1]
    # Between opposite strong samples lies an odd number of sign changes: the middle one is well defined.
    middle = (np.searchsorted(left, last) + np.searchsorted(left, first) - 1) // 2
    a, b = left[middle], right[middle]
    return s[a] + (s[b] - s[a]) * value[a] / (value[a] - value[b]), b


def _apexes(s: FloatArray, value: FloatArray, cut: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Arc length and signed value of the absolute peak in each run of samples cut[k] .. cut[k + 1] - 1."""
    if cut.size < 2:
        return np.empty(0), np.empty(0)
    size = np.abs(value[: cut[-1]])
    top = np.maximum.reduceat(size, cut[:-1])
    at_top = size[cut[0] :] == np.repeat(top, np.diff(cut))
    index = np.where(at_top, np.arange(cut[0], cut[-1]), cut[-1])
    peak = np.minimum.reduceat(index, cut[:-1] - cut[0])
    return _parabola_peak(s, value, peak)


def _parabola_peak(x: FloatArray, y: FloatArray, index: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Extreme of the parabola around each extreme sample; end samples stay as they are."""
    i = np.clip(index, 1, len(x) - 2)
    x0, x1, x2 = x[i - 1], x[i], x[i + 1]
    d1, d2 = (y[i] - y[i - 1]) / (x1 - x0), (y[i + 1] - y[i]) / (x2 - x1)
    bow = (d2 - d1) / (x2 - x0)
    refine = (i == index) & (d1 * d2 < 0.0)
    place = 0.5 * (x0 + x1) - 0.5 * np.divide(d1, bow, out=np.zeros_like(d1), where=refine)
    peak = y[i - 1] + d1 * (place - x0) + bow * (place - x0) * (place - x1)
    return np.where(refine, place, x[index]), np.where(refine, peak, y[index])


def _nearest(points: FloatArray, heading: FloatArray, line: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Nearest point for each point on the segments that run its way, (n, 2), and that segment, (n,).

    A segment runs the way of a point if it lies within a right angle of the point's heading, rounded to one
    of eight; where none does, all are taken. Segments are split into pieces no longer than the mean one, so
    that the pieces with the nearest middles, O(n log m) to look up, hold the nearest point.
    """
    segment = np.diff(line, axis=0)
    length = _norm(segment)
    count = np.ceil(length / length.mean()).astype(np.intp)
    owner = np.repeat(np.arange(len(segment)), count)
    part = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    middle = line[owner] + ((part + 0.5) / count[owner])[:, None] * segment[owner]

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

    def spectrum(series: NDArray[Any]) -> NDArray[np.complex128]:
        return np.fft.rfft(series.astype(np.float64), size)

    def pair(left: NDArray[np.complex128], right: NDArray[np.complex128]) -> FloatArray:
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
