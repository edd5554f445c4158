"""Length, curvature and sinuosity of one line, and what all metrics share: checked lines and plane vectors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from warpriver.arrays import FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.public import public
from warpriver.validate import checked_line, positive

__all__ = [
    "FloatArray",
    "IndexArray",
    "arc_length",
    "arc_length_of",
    "checked_ring",
    "cross",
    "curvature",
    "curvature_of",
    "dot",
    "norm",
    "parabola_peak",
    "points_at",
    "ratio",
    "sinuosity",
    "sinuosity_window",
    "unit",
]


@public
def arc_length(xy: ArrayLike) -> FloatArray:
    """Cumulative chord length along a line.

    Args:
        xy: (n, 2) points in downstream order, m.

    Returns:
        (n,) distance from the first point along the line, m; the first value is 0.

    Raises:
        ValueError: `xy` is not a line of at least three finite, distinct points.
    """
    return arc_length_of(checked_line(xy, "xy"))


@public
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
        ring = checked_ring(xy)
        return curvature_of(np.concatenate([ring[-1:], ring, ring[:1]]))[1:-1]
    return curvature_of(checked_line(xy, "xy"))


@public
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
        ring = checked_ring(xy)
        around = arc_length_of(np.concatenate([ring, ring[:1]]))[-1:]
        area = 0.5 * abs(float(cross(ring - ring[0], np.roll(ring, -1, axis=0) - ring[0]).sum()))
        return float(ratio(around, np.array([2.0 * math.sqrt(math.pi * area)]))[0])
    points = checked_line(xy, "xy")
    length = arc_length_of(points)[-1:]
    return float(ratio(length, norm(points[-1:] - points[:1]))[0])


@public
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
    points = checked_line(xy, "xy")
    half = 0.5 * positive(window, "window")
    s = arc_length_of(points)
    low = np.maximum(s - half, 0.0)
    high = np.minimum(s + half, s[-1])
    return ratio(high - low, norm(points_at(points, s, high) - points_at(points, s, low)))


def checked_ring(xy: ArrayLike) -> FloatArray:
    """The points of a ring, the first not repeated, as `checked_line` has those of a line."""
    points = checked_line(xy, "xy")
    if (points[0] == points[-1]).all():
        raise InputError("xy repeats its first point at its end; leave it out of a closed line.")
    return points


def norm(vectors: FloatArray) -> FloatArray:
    """Length of each (n, 2) vector."""
    return np.hypot(vectors[:, 0], vectors[:, 1])


def unit(vectors: FloatArray) -> FloatArray:
    """Each (n, 2) vector divided by its length; a zero vector stays zero."""
    length = norm(vectors)[:, None]
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Dot product of each pair of (n, 2) vectors."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Signed cross product of each pair of (n, 2) vectors, > 0 where b lies to the left of a."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def ratio(length: FloatArray, chord: FloatArray) -> FloatArray:
    """The lengths over the chords, inf where the chord is 0, never below 1 by rounding."""
    over = np.divide(length, chord, out=np.full_like(length, np.inf), where=chord > 0.0)
    return np.maximum(over, 1.0)


def points_at(points: FloatArray, s: FloatArray, position: FloatArray) -> FloatArray:
    """(k, 2) points on the line at the arc lengths `position`."""
    return np.column_stack([np.interp(position, s, points[:, 0]), np.interp(position, s, points[:, 1])])


def arc_length_of(points: FloatArray) -> FloatArray:
    """`arc_length` of a checked line."""
    return np.concatenate([[0.0], np.cumsum(norm(np.diff(points, axis=0)))])


def curvature_of(points: FloatArray) -> FloatArray:
    """`curvature` of a checked line."""
    chord = np.diff(points, axis=0)
    h = norm(chord)
    heading = chord / h[:, None]
    turn = 2.0 * cross(heading[:-1], heading[1:])
    across = norm(points[2:] - points[:-2])
    inner = np.divide(turn, across, out=np.zeros_like(turn), where=across > 0.0)
    if len(inner) == 1:
        return np.repeat(inner, 3)
    first = inner[0] + (inner[0] - inner[1]) * min(h[0] / h[1], 2.0)
    last = inner[-1] + (inner[-1] - inner[-2]) * min(h[-1] / h[-2], 2.0)
    return np.concatenate([[first], inner, [last]])


def parabola_peak(x: FloatArray, y: FloatArray, index: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Extreme of the parabola around each extreme sample; end samples stay as they are."""
    i = np.clip(index, 1, len(x) - 2)
    x0, x1, x2 = x[i - 1], x[i], x[i + 1]
    d1, d2 = (y[i] - y[i - 1]) / (x1 - x0), (y[i + 1] - y[i]) / (x2 - x1)
    bow = (d2 - d1) / (x2 - x0)
    refine = (i == index) & (d1 * d2 < 0.0)
    place = 0.5 * (x0 + x1) - 0.5 * np.divide(d1, bow, out=np.zeros_like(d1), where=refine)
    peak = y[i - 1] + d1 * (place - x0) + bow * (place - x0) * (place - x1)
    return np.where(refine, place, x[index]), np.where(refine, peak, y[index])
