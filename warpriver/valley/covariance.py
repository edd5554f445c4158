"""Geomorphic covariance structures: measured on a valley's series, and given as a target.

The structure of two series is the product of their standardised residuals, c(i) = r1(i) r2(i); its mean over the reach
is their correlation [Brown2014], section 4.5.1. Means are integrals over the stationing (trapezoids). By frequency, the
correlation is that of the two series' components at the frequency, the cosine of the angle between their phases.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from warpriver.arrays import ComplexArray, FloatArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.public import public
from warpriver.valley.controls import Harmonic

__all__ = [
    "Covariance",
    "correlation_by_frequency",
    "covariance_series",
    "harmonics_for_covariance",
    "harmonics_for_covariances",
]


# A target is met when the mean comes this close.
TOLERANCE = 0.02
# A frequency keeps at least this fraction of the strongest one's amplitude, so that its phase means something.
MIN_SHARE = 0.05
# A component of the partner this much weaker than the whole has no phase to hold on to.
NO_COMPONENT = 1e-6


@dataclasses.dataclass(frozen=True)
class Covariance:
    """Covariance structure of a valley along its reach.

    Attributes:
        station: (n,) distance along the channel, m.
        thalweg_width: (n,) c(z_T, W), of thalweg elevation and bankfull width.
        thalweg_curvature: (n,) c(z_T, |C|), of thalweg elevation and the absolute curvature that sections lean by.
        mean_thalweg_width: Its mean, -1 to 1; NaN where one of both does not vary.
        mean_thalweg_curvature: Its mean, likewise.
        by_frequency: Correlation with the partner of the (first) covariance target at each of its frequencies; else
            empty.
    """

    station: FloatArray
    thalweg_width: FloatArray
    thalweg_curvature: FloatArray
    mean_thalweg_width: float
    mean_thalweg_curvature: float
    by_frequency: dict[float, float]


def covariance_series(first: FloatArray, second: FloatArray, position: FloatArray) -> tuple[FloatArray, float]:
    """Return the structure c(i) of two series, (n,), and its mean; NaN where one of them does not vary.

    Args:
        first: (n,) series.
        second: (n,) series.
        position: (n,) stationing, rising; evenness is not needed.
    """
    weight = _weights(position)
    a, b = _standardised(first, weight), _standardised(second, weight)
    return a * b, float(weight @ (a * b))


def correlation_by_frequency(
    first: FloatArray, second: FloatArray, position: FloatArray, frequencies: Sequence[float]
) -> FloatArray:
    """Return the correlation of two series at each frequency, (k,); NaN where one has no component there.

    Args:
        first: (n,) series.
        second: (n,) series.
        position: (n,) stationing, 0 to 1.
        frequencies: Cycles over the reach.
    """
    weight = _weights(position)
    a, b = (_components(series, position, weight, frequencies) for series in (first, second))
    size = np.abs(a) * np.abs(b)
    known = (np.abs(a) > NO_COMPONENT * np.ptp(first)) & (np.abs(b) > NO_COMPONENT * np.ptp(second))
    return np.where(known, np.real(a * np.conj(b)) / np.where(known, size, 1.0), np.nan)


@public
def harmonics_for_covariance(
    partner: FloatArray,
    position: FloatArray,
    frequencies: Sequence[float],
    mean: float | None = None,
    by_frequency: Sequence[float] | None = None,
    amplitude: float = 1.0,
) -> tuple[Harmonic, ...]:
    """Harmonics with a target covariance with a series: the inverse of :func:`covariance_series`.

    At each frequency the sum follows the partner's component, shifted in phase: by arccos of the target correlation,
    or by one common angle that gives the mean. Amplitudes are in proportion to the partner's; where both the mean and
    the frequencies' correlations are given, they are chosen to give the mean.

    Args:
        partner: (n,) series.
        position: (n,) stationing, 0 to 1.
        frequencies: Cycles over the reach, above 0, no two alike.
        mean: Mean of the structure, -1 to 1.
        by_frequency: Correlation at each frequency, -1 to 1.
        amplitude: sqrt 2 times the root mean square of the sum.

    Returns:
        One harmonic a frequency.

    Raises:
        ValueError: No target, one out of range, a partner without a component at a frequency, or a mean that no phases
            and amplitudes reach; the range within reach is named.
    """
    frequency = _checked_frequencies(frequencies)
    weight = _weights(position)
    series = _standardised(partner, weight)
    if np.isnan(series).any():
        raise InputError("the other series does not vary, so that nothing can covary with it")
    component = _components(series, position, weight, frequency)
    missing = np.abs(component) < NO_COMPONENT
    if missing.any():
        raise InputError(
            f"the other series has no component at frequency {frequency[missing][0]:g}; leave it out, or give "
            "one that it has"
        )
    phase, size = np.angle(component), np.abs(component)
    made = _Made(position, weight, series, frequency, phase)
    if by_frequency is not None:
        shift = np.arccos(_checked_targets(by_frequency, len(frequency)))
        if mean is not None:
            size = _shares_for_mean(made, size, shift, _checked_mean(mean))
    elif mean is not None:
        shift = np.full(len(frequency), _common_shift(made, size, _checked_mean(mean)))
    else:
        raise InputError("give the mean of the covariance, or that of each frequency")
    size = size * amplitude / (math.sqrt(2.0) * made.spread(size, shift))
    return tuple(
        Harmonic(float(a), float(f), float(p), "cos") for a, f, p in zip(size, frequency, phase + shift, strict=True)
    )


@public
def harmonics_for_covariances(
    partners: FloatArray,
    position: FloatArray,
    frequencies: Sequence[float],
    means: Sequence[float],
    amplitude: float = 1.0,
) -> tuple[Harmonic, ...]:
    """Harmonics that have target mean covariances with several series at once.

    The coefficients of cosines and sines form a vector whose length, in the metric of the waves' own covariances, is
    the standard deviation of the sum; each target fixes its component along one direction. The shortest vector that
    meets the targets is lengthened at right angles to all of them, towards the first series a quarter turn behind.

    Args:
        partners: (m, n) series.
        position: (n,) stationing, 0 to 1.
        frequencies: Cycles over the reach, above 0, no two alike.
        means: (m,) targets for the mean of the structure with each series, -1 to 1.
        amplitude: sqrt 2 times the root mean square of the sum.

    Returns:
        One harmonic a frequency.

    Raises:
        ValueError: A target out of range, a series that does not vary, or targets that no sum of these harmonics meets
            at once; the largest common fraction of them that one meets is named.
    """
    frequency, weight = _checked_frequencies(frequencies), _weights(position)
    target = np.array([_checked_mean(mean) for mean in means])
    series = np.stack([_standardised(partner, weight) for partner in partners])
    if np.isnan(series).any():
        raise InputError("one of the other series does not vary, so that nothing can covary with it")
    angle = 2.0 * math.pi * frequency[:, None] * position
    waves = np.concatenate([np.cos(angle), np.sin(angle)])
    waves -= (waves @ weight)[:, None]
    with_partners, metric = waves @ (weight * series).T, (waves * weight) @ waves.T
    directions = np.linalg.lstsq(metric, with_partners, rcond=1e-10)[0]
    gram = with_partners.T @ directions
    shortest = directions @ np.linalg.lstsq(gram, target, rcond=1e-10)[0]
    if np.abs(with_partners.T @ shortest - target).max() > TOLERANCE:
        raise InputError(
            f"the mean covariances {_listed(target)} are impossible together: at these frequencies the other series "
            "vary alike, or not at all; add frequencies that they have"
        )
    length = math.sqrt(max(float(shortest @ metric @ shortest), 0.0))
    if length > 1.0 + TOLERANCE:
        raise InputError(
            f"the mean covariances {_listed(target)} are impossible together with these frequencies, which reach "
            f"{_listed(target / length)}; give smaller ones, or add frequencies that the other series have"
        )
    across = _across(directions, gram, metric, len(frequency))
    if across is None and length < 1.0 - TOLERANCE:
        raise InputError(
            f"the mean covariances {_listed(target)} are impossible together with so few frequencies, which give "
            f"{_listed(target / max(length, TOLERANCE))}; add frequencies"
        )
    found = shortest / (length if across is None else max(length, 1.0))
    if across is not None and length < 1.0:
        found = found + math.sqrt(1.0 - length**2) * across
    found *= amplitude / math.sqrt(2.0)
    cosine, sine = np.split(found, 2)
    size, phase = np.hypot(cosine, sine), np.arctan2(-sine, cosine)
    return tuple(Harmonic(float(a), float(f), float(p), "cos") for a, f, p in zip(size, frequency, phase, strict=True))


def _across(directions: FloatArray, gram: FloatArray, metric: FloatArray, count: int) -> FloatArray | None:
    """Unit vector at right angles to all directions, or None: the first one a quarter turn behind, if it is across."""
    turned = np.concatenate([-directions[count:, 0], directions[:count, 0]])
    # Where nothing of it lies across, one of the waves does.
    best, longest = None, 1e-6
    for trial in (turned / math.sqrt(float(turned @ metric @ turned)), *np.eye(2 * count)):
        across = trial - directions @ np.linalg.lstsq(gram, directions.T @ (metric @ trial), rcond=1e-10)[0]
        length = math.sqrt(max(float(across @ metric @ across), 0.0))
        if length > longest:
            best, longest = across / length, length
        if longest > 0.1:
            break
    return best


def _listed(values: FloatArray) -> str:
    return " and ".join(f"{value:.3g}" for value in values)


class _Made:
    """What a sum of harmonics of given amplitudes and shifts has in common with the partner."""

    def __init__(
        self, position: FloatArray, weight: FloatArray, series: FloatArray, frequency: FloatArray, phase: FloatArray
    ):
        angle = 2.0 * math.pi * frequency[:, None] * position + phase[:, None]
        waves = np.concatenate([np.cos(angle), -np.sin(angle)])
        waves -= (waves @ weight)[:, None]
        self.with_partner = waves @ (weight * series)
        self.with_waves = (waves * weight) @ waves.T

    def spread(self, size: FloatArray, shift: FloatArray) -> float:
        """Standard deviation of the sum."""
        share = np.concatenate([size * np.cos(shift), size * np.sin(shift)])
        return math.sqrt(max(float(share @ self.with_waves @ share), 1e-300))

    def mean(self, size: FloatArray, shift: FloatArray) -> float:
        """Mean of the structure of the sum and the partner."""
        share = np.concatenate([size * np.cos(shift), size * np.sin(shift)])
        return float(share @ self.with_partner) / self.spread(size, shift)


def _common_shift(made: _Made, size: FloatArray, mean: float) -> float:
    """Shift of all phases, 0 to pi, that gives the mean."""
    with IMPORTING:
        from scipy.optimize import brentq

    one = np.ones(len(size))
    shifts = np.linspace(0.0, math.pi, 721)
    means = np.array([made.mean(size, t * one) for t in shifts])
    high, low = int(np.argmax(means)), int(np.argmin(means))
    if means[low] <= mean <= means[high]:
        span = sorted((shifts[high], shifts[low]))
        return float(brentq(lambda t: made.mean(size, t * one) - mean, *span, xtol=1e-12))
    return float(shifts[high if mean > 0.0 else low]) if _reached(mean, means[low], means[high]) else 0.0


def _shares_for_mean(made: _Made, size: FloatArray, shift: FloatArray, mean: float) -> FloatArray:
    """Amplitudes that give the mean with the shifts held: between those of the minimum and of the maximum mean."""
    with IMPORTING:
        from scipy.optimize import brentq

    worth = size * np.cos(shift)
    ends = []
    for sign in (-1.0, 1.0):
        gain = np.maximum(sign * worth, 0.0)
        if not (gain > 1e-12).any():
            gain = (sign * np.cos(shift) == (sign * np.cos(shift)).max()) * size
        ends.append(np.maximum(gain / gain.max(), MIN_SHARE))
    low, high = (made.mean(share, shift) for share in ends)

    def between(t: float) -> FloatArray:
        share: FloatArray = (1.0 - t) * ends[0] + t * ends[1]
        return share

    if low <= mean <= high:
        t = brentq(lambda t: made.mean(between(t), shift) - mean, 0.0, 1.0, xtol=1e-14)
        return between(t)
    _reached(mean, low, high)
    bound: FloatArray = ends[1 if mean > high else 0]
    return bound


def _reached(mean: float, low: float, high: float) -> bool:
    """True where the mean is within the tolerance of what can be had; raises ValueError otherwise."""
    if low - TOLERANCE <= mean <= high + TOLERANCE:
        return True
    raise InputError(
        f"a mean covariance of {mean:g} is impossible with these frequencies: they give {low:.3f} to {high:.3f}; give "
        "one in between, or add frequencies that the other series has"
    )


def _checked_frequencies(frequencies: Sequence[float]) -> FloatArray:
    frequency = np.atleast_1d(np.asarray(frequencies, np.float64))
    if frequency.ndim != 1 or not len(frequency) or not np.isfinite(frequency).all() or not (frequency > 0.0).all():
        raise InputError(f"frequencies are {list(np.ravel(frequency))}; give numbers above 0, in cycles over the reach")
    if len(np.unique(frequency)) < len(frequency):
        raise InputError("frequencies holds one twice; each stands once")
    return frequency


def _checked_targets(targets: Sequence[float], count: int) -> FloatArray:
    value = np.atleast_1d(np.asarray(targets, np.float64))
    if value.shape != (count,):
        raise InputError(f"by_frequency has {value.size} values for {count} frequencies; give one each")
    if not (np.abs(value) <= 1.0).all():
        raise InputError(f"by_frequency holds {value[~(np.abs(value) <= 1.0)][0]:g}; a correlation lies in -1 to 1")
    return value


def _checked_mean(mean: float) -> float:
    if not abs(mean) <= 1.0:
        raise InputError(f"the target of the mean covariance is {mean:g}; it lies in -1 to 1")
    return float(mean)


def _weights(position: FloatArray) -> FloatArray:
    """Weights of a mean by trapezoids; they sum to 1."""
    step = np.diff(position)
    weight = np.zeros(len(position))
    weight[:-1] += step
    weight[1:] += step
    shares: FloatArray = weight / weight.sum()
    return shares


def _standardised(series: FloatArray, weight: FloatArray) -> FloatArray:
    """Residuals about the mean in standard deviations; NaN where the series does not vary."""
    residual = series - weight @ series
    deviation = math.sqrt(float(weight @ residual**2))
    if deviation <= 1e-12 * max(float(np.abs(series).max()), 1e-300):
        return np.full(len(series), np.nan)
    return residual / deviation


def _components(series: FloatArray, position: FloatArray, weight: FloatArray, frequencies: Any) -> ComplexArray:
    """Complex amplitudes of a series at each frequency, of a cosine; least squares, with a constant."""
    angle = 2.0 * math.pi * np.outer(position, frequencies)
    basis = np.column_stack([np.ones(len(position)), np.cos(angle), np.sin(angle)])
    root = np.sqrt(weight)[:, None]
    fit = np.linalg.lstsq(root * basis, root[:, 0] * series, rcond=None)[0][1:]
    count = len(fit) // 2
    components: ComplexArray = fit[:count] - 1j * fit[count:]
    return components
