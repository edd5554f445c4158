"""Bends of a line: inflection points, apexes, radii and wavelengths."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from warpriver.extras import IMPORTING
from warpriver.metrics.lines import (
    FloatArray,
    IndexArray,
    arc_length_of,
    checked_ring,
    curvature_of,
    norm,
    parabola_peak,
    points_at,
    ratio,
)
from warpriver.public import public
from warpriver.validate import checked_line, positive

__all__ = [
    "Bends",
    "InflectionPoints",
    "bend_curvature",
    "bend_radius",
    "bend_sinuosity",
    "bends",
    "inflection_points",
    "wavelength",
    "wavelength_range",
]

# Scale of the smoothing of curvature along the arc, in widths.
_SMOOTHING = 1.0
# A bend whose peak |curvature| * width stays below this (radius above 20 widths) does not count as a bend.
_STRAIGHT = 0.05
# Samples of the smoothed curvature per width of arc.
_SAMPLES_PER_WIDTH = 8.0


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


@public
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
    points = checked_line(xy, "xy")
    position, _ = _sign_changes(*bend_curvature(points, width))
    return InflectionPoints(position, points_at(points, arc_length_of(points), position))


@public
def bends(xy: ArrayLike, width: float | None = None, closed: bool = False) -> Bends:
    """Measure every bend between two successive inflection points.

    The stretches of the line before the first and after the last inflection point are not whole bends and are
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
        return _ring_bends(checked_ring(xy), width)
    points = checked_line(xy, "xy")
    s, value, floor = bend_curvature(points, width)
    edge, first = _sign_changes(s, value, floor)
    start, end = edge[:-1], edge[1:]
    apex, peak = _apexes(s, value, first)
    chord = norm(np.diff(points_at(points, arc_length_of(points), edge), axis=0))
    return Bends(start, end, end - start, chord, ratio(end - start, chord), apex, peak, 1.0 / np.abs(peak))


@public
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


@public
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


@public
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


@public
def wavelength_range(width: float) -> tuple[float, float]:
    """Meander wavelengths to expect of real rivers of a width [Paris2023, Sec. 8.3].

        low = 6.28 w,    high = 1.65 * 7.5 w^1.12

    The paper quotes wavelength = a w^b with 6.28 <= a <= 12.34 and 1 <= b <= 1.13, an error of -40 %
    to +65 %, and prints [314, 990] m, [628, 2150] m and [1256, 4674] m for widths of 50, 100 and 200 m. Those
    numbers come from the lowest relation without its error [Yalin1972] and from the relation 7.5 w^1.12 of
    [Williams1986] with +65 %: here 989.4, 2150.5 and 4674.2 m, so only the printed 990 is off, by 0.6 m. The
    laws are for full meanders of two bends.

    Args:
        width: channel width, m.

    Returns:
        Lower and upper wavelength, m.

    Raises:
        ValueError: `width` is not positive.
    """
    w = positive(width, "width")
    return 6.28 * w, 1.65 * 7.5 * w**1.12


def _ring_bends(ring: FloatArray, width: float | None) -> Bends:
    """`bends` of a checked ring, those that begin in one lap of it."""
    laps = bends(np.concatenate([ring, ring, ring, ring[:1]]), width)
    around = arc_length_of(np.concatenate([ring, ring[:1]]))[-1]
    # Rounding must not count the bend at the seam twice, or not at all.
    seam = around * (1.0 - 1e-9)
    kept = (laps.start >= seam) & (laps.start < seam + around)
    start, end, arc, chord, sinuosity, apex, *turn = (values[kept] for values in laps)
    return Bends(start - around, end - around, arc, chord, sinuosity, apex - around, *turn)


def bend_curvature(points: FloatArray, width: float | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arc length, curvature of `inflection_points` and the absolute curvature that counts as straight, (m,) each."""
    s = arc_length_of(points)
    if width is None:
        h = np.diff(s)
        area = np.concatenate([h[:1] ** 2, h[:-1] * h[1:], h[-1:] ** 2])
        return s, curvature_of(points), 8.0 * np.finfo(np.float64).eps * np.abs(points).max() / area
    with IMPORTING:
        from scipy.interpolate import CubicSpline  # here, because importing it takes longer than most calls

    w = positive(width, "width")
    mean = s[-1] / (len(s) - 1)
    spacing = min(max(w / _SAMPLES_PER_WIDTH, mean / _SAMPLES_PER_WIDTH), mean)
    even = np.linspace(0.0, s[-1], max(round(s[-1] / spacing), 2) + 1)
    value = curvature_of(CubicSpline(s, points)(even))
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
    return parabola_peak(s, value, peak)
