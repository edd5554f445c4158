"""Synthetic centrelines: meanders of known shape, straight lines, seeded noise.

Pure functions that return (n, 2) float64 arrays of points in metres, running from (0, 0) along +x.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.public import public
from warpriver.validate import finite, not_negative, positive, seeded

__all__ = ["kinoshita", "noisy_line", "sine_generated", "straight_line", "valley_line"]


# Points of the Gauss-Legendre rule for one step along a curve: exact to rounding for a quarter wavelength.
_QUADRATURE = 16
# Samples of one wavelength for the mean of a smooth periodic function (the sum converges exponentially).
_PERIOD = 512
# First zero of the Bessel function J0: the angle at which a sine-generated curve stops advancing, rad.
_LARGEST_ANGLE = 2.404825557695773
# Sines in a valley line, and how far their wavelengths spread about the requested one.
_VALLEY_SINES, _VALLEY_SPREAD = 5, 2.0


@public
def sine_generated(wavelength: float, angle: float, wavelengths: float, spacing: float) -> FloatArray:
    """Sine-generated curve: the meander whose direction is a sine of arc length [Langbein1966].

        theta(s) = angle sin(2 pi s / M),    wavelength = M J0(angle)

    M is the arc wavelength and J0 the Bessel function; sinuosity over whole wavelengths is 1 / J0(angle). The
    curve starts at the apex of a bend to the left. Above about 2.2 rad neighbouring bends cross each other;
    such curves are allowed. At 2.405 rad a wavelength no longer advances.

    Args:
        wavelength: straight-line distance between two like points, m.
        angle: largest angle with the +x axis, rad, 0 (straight) to below 2.405.
        wavelengths: number of wavelengths, not necessarily whole.
        spacing: distance between points along the curve, m, below `wavelength`; the nearest value that
            divides the length evenly is used.

    Returns:
        (n, 2) points evenly spaced in arc length, m.

    Raises:
        ValueError: a number is out of range.
    """
    return kinoshita(wavelength, angle, wavelengths, spacing, skewness=0.0, flatness=0.0)


@public
def kinoshita(
    wavelength: float,
    angle: float,
    wavelengths: float,
    spacing: float,
    skewness: float = 1.0 / 32.0,
    flatness: float = 1.0 / 192.0,
) -> FloatArray:
    """Kinoshita curve: a sine-generated curve with skewed and flattened bends [Kinoshita1961].

        theta(s) = angle sin(k s) + angle^3 (skewness cos(3 k s) - flatness sin(3 k s)),    k = 2 pi / M

    M is found from the straight-line wavelength. A positive skewness makes bends that lean upstream, with
    their largest curvature in the upstream half; a negative one makes the mirror image, bends that lean
    downstream. A positive flatness lowers the curvature at the apex, a negative one raises it.

    Args:
        wavelength: straight-line distance between two like points, m.
        angle: amplitude of the direction angle, rad, 0 to below 2.405.
        wavelengths: number of wavelengths, not necessarily whole.
        spacing: distance between points along the curve, m, below `wavelength`; the nearest value that
            divides the length evenly is used.
        skewness: coefficient of the skewing term, dimensionless, > 0 upstream.
        flatness: coefficient of the flattening term, dimensionless.

    Returns:
        (n, 2) points evenly spaced in arc length, m, along +x on average.

    Raises:
        ValueError: a number is out of range, or the angle is so large that the curve does not advance.
    """
    positive(wavelength, "wavelength")
    positive(wavelengths, "wavelengths")
    _spacing(spacing, wavelength, "wavelength")
    not_negative(angle, "angle", "rad")
    finite(skewness, "skewness")
    finite(flatness, "flatness")

    def direction(phase: FloatArray) -> FloatArray:
        third = skewness * np.cos(3.0 * phase) - flatness * np.sin(3.0 * phase)
        return angle * np.sin(phase) + angle**3 * third

    advance = float(np.cos(direction(2.0 * np.pi * np.arange(_PERIOD) / _PERIOD)).mean())
    if angle >= _LARGEST_ANGLE or advance < 1e-3:
        raise InputError(f"angle is {angle} rad, where the curve does not advance; give a smaller one.")
    arc = wavelength / advance
    return _walk(lambda s: direction(2.0 * np.pi * s / arc), wavelengths * arc, spacing)


@public
def straight_line(length: float, spacing: float) -> FloatArray:
    """Evenly spaced points on a straight line along +x.

    Args:
        length: length, m.
        spacing: distance between points, m, below `length`; the nearest value that divides the length evenly
            is used.

    Returns:
        (n, 2) points from (0, 0) to (length, 0), m, n at least 3.

    Raises:
        ValueError: a number is not positive, or `spacing` is not below `length`.
    """
    positive(length, "length")
    _spacing(spacing, length, "length")
    x = np.linspace(0.0, length, _steps(length, spacing) + 1)
    return np.column_stack([x, np.zeros_like(x)])


@public
def noisy_line(
    length: float,
    spacing: float,
    amplitude: float,
    seed: int,
    correlation: float | None = None,
    taper: float = 0.1,
) -> FloatArray:
    """Straight line along +x with smooth, seeded sideways noise: a channel for meanders to grow from.

    White noise is smoothed by a Gaussian, made to fade smoothly to 0 at both ends, and scaled so that the
    largest sideways offset is `amplitude`. Points are even in x, so they stay even along the line while the
    noise is gentle.

    Args:
        length: straight length, m.
        spacing: distance between points along x, m, below `length`; the nearest value that divides the length
            evenly is used.
        amplitude: largest sideways offset, m.
        seed: seed of `numpy.random.default_rng`; the same seed gives the same line.
        correlation: standard deviation of the smoothing Gaussian, m; None for four spacings.
        taper: Fraction of the length at each end over which the noise fades, 0 to 0.5; at 0 only the end points
            are held.

    Returns:
        (n, 2) points from (0, 0) to (length, 0), m.

    Raises:
        ValueError: a number is out of range.
    """
    line = straight_line(length, spacing)
    positive(amplitude, "amplitude")
    scale = 4.0 * spacing if correlation is None else positive(correlation, "correlation")
    fade = _fade(line[:, 0] / length, taper)
    # Twice as long as the line, because the filter wraps around.
    white = seeded(seed).standard_normal(2 * len(line))
    frequency = 2.0 * np.pi * np.fft.rfftfreq(len(white), line[1, 0])
    kept = np.fft.rfft(white) * np.exp(-0.5 * (frequency * scale) ** 2)
    offset = np.fft.irfft(kept, len(white))[: len(line)] * fade
    line[:, 1] = offset * (amplitude / np.abs(offset).max())
    return line


@public
def valley_line(length: float, spacing: float, amplitude: float, wavelength: float, seed: int) -> FloatArray:
    """Gently wandering line along +x, for example the axis of a valley.

    The sum of five sines with seeded phases and with wavelengths from half to twice the requested one, the
    longer the larger; it fades to 0 over a tenth of the length at both ends.

    Args:
        length: straight length, m.
        spacing: distance between points along the line, m, below `wavelength` and `length`; the nearest value
            that divides the length of the line evenly is used.
        amplitude: largest sideways offset, m, to within the spacing of the points.
        wavelength: typical distance between two like points, m.
        seed: seed of `numpy.random.default_rng`; the same seed gives the same line.

    Returns:
        (n, 2) points from (0, 0) to (length, 0), m, evenly spaced along the line to about 1 %.

    Raises:
        ValueError: a number is not positive, or `spacing` is too large.
    """
    positive(length, "length")
    positive(amplitude, "amplitude")
    positive(wavelength, "wavelength")
    _spacing(spacing, min(wavelength, length), "the smaller of wavelength and length")
    fine = straight_line(length, spacing / 8.0)
    rng = seeded(seed)
    period = wavelength * np.geomspace(1.0 / _VALLEY_SPREAD, _VALLEY_SPREAD, _VALLEY_SINES)
    phase = rng.uniform(0.0, 2.0 * np.pi, _VALLEY_SINES)
    offset = (period * np.sin(2.0 * np.pi * fine[:, :1] / period + phase)).sum(axis=1)
    offset *= _fade(fine[:, 0] / length, 0.1)
    fine[:, 1] = offset * (amplitude / np.abs(offset).max())

    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    even = np.linspace(0.0, s[-1], _steps(s[-1], spacing) + 1)
    return np.column_stack([np.interp(even, s, fine[:, 0]), np.interp(even, s, fine[:, 1])])


def _walk(direction: Callable[[FloatArray], FloatArray], length: float, spacing: float) -> FloatArray:
    """(n, 2) points every `spacing` or so along the curve of direction angle `direction(s)`, from (0, 0)."""
    count = _steps(length, spacing)
    step = length / count
    node, weight = np.polynomial.legendre.leggauss(_QUADRATURE)
    theta = direction(step * (np.arange(count)[:, None] + 0.5 * (node + 1.0)))
    moves = 0.5 * step * np.column_stack([np.cos(theta) @ weight, np.sin(theta) @ weight])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])


def _fade(position: FloatArray, taper: float) -> FloatArray:
    """Weight of each relative position 0 .. 1: 0 at both ends, 1 beyond `taper` from them, smooth between."""
    if not 0.0 <= taper <= 0.5:
        raise InputError(f"taper is {taper}; give a fraction of the length from 0 to 0.5.")
    to_end = np.minimum(position, 1.0 - position)
    fraction = np.clip(to_end / max(taper, 1e-12), 0.0, 1.0)
    return fraction**2 * (3.0 - 2.0 * fraction)


def _steps(length: float, spacing: float) -> int:
    """Number of equal steps nearest to `spacing` along `length`, at least 2."""
    return max(2, round(length / spacing))


def _spacing(spacing: float, limit: float, name: str) -> None:
    """Raises ValueError unless the spacing is positive and below the limit."""
    if positive(spacing, "spacing") >= limit:
        raise InputError(f"spacing is {spacing} m, {name} {limit} m; give a spacing below it.")
