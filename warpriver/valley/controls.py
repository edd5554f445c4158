"""Control functions of synthetic valleys: terms that are summed, each a function of the position along the reach.

A term is a frozen dataclass that is called with positions ``u``, 0 at the upstream end of the reach and 1 at its
downstream end, and returns values of the same shape. A control function is a tuple of terms, evaluated by
:func:`evaluate`; large and small scales are terms of one sum. Frequencies count cycles over the reach. Beyond the ends
the analytic terms go on as they are; those that are given or drawn at points keep their end values.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.parameter import Params, parameter
from warpriver.public import public
from warpriver.validate import MAX_SEED, floats, freeze_numbers, seeded, whole

__all__ = [
    "Autoregressive",
    "Cnoidal",
    "GradientNoise",
    "Harmonic",
    "Kinoshita",
    "Series",
    "SineGenerated",
    "Spectral",
    "Spline",
    "Steps",
    "Term",
    "cosine",
    "evaluate",
    "interpolated",
    "sine",
    "strongest_harmonics",
]

# A term: any callable of the position along the reach.
Term = Callable[[FloatArray], FloatArray]

TURN = 2.0 * math.pi
# Samples of one wavelength of a curve that is integrated from its direction, and those that its extremes are among.
_PERIOD, _DENSE = 256, 8192
# Largest angle of a sine-generated curve that still advances: the first zero of the Bessel function J0.
_LARGEST_ANGLE = 2.404825557695773
# Steps before the first of an autoregressive series, over which its arbitrary start is forgotten, in wavelengths.
_SPIN_UP = 20.0
# Samples of a Bezier curve by its parameter, and its control points at most: its degree is one less.
_BEZIER, _MAX_BEZIER = 4097, 64


def _amplitude() -> Any:
    return parameter(1.0, "-", source="Brown2014", doc="size of the variation; in m for elements given in m")


def _frequency() -> Any:
    return parameter(1.0, "cycles a reach", low=0.0, source="Brown2014", doc="angular frequency, cycles over the reach")


def _phase() -> Any:
    return parameter(0.0, "rad", source="Brown2014", doc="phase shift")


def _seed() -> Any:
    return parameter(0, "-", low=0.0, source="warpriver", doc="seed of what is random, a whole number")


@dataclasses.dataclass(frozen=True)
class Harmonic(Params):
    """One sinusoid, f = amplitude sin(2 pi frequency u + phase), or its cosine [Brown2014], eq. 5."""

    amplitude: float = _amplitude()
    frequency: float = _frequency()
    phase: float = _phase()
    wave: str = parameter("sin", "-", choices=("sin", "cos"), source="Brown2014", doc="sine or cosine")

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        angle = TURN * self.frequency * u + self.phase
        return self.amplitude * (np.sin(angle) if self.wave == "sin" else np.cos(angle))


@public
def sine(amplitude: float, frequency: float, phase: float = 0.0) -> Harmonic:
    """Return the term amplitude sin(2 pi frequency u + phase)."""
    return Harmonic(amplitude, frequency, phase, "sin")


@public
def cosine(amplitude: float, frequency: float, phase: float = 0.0) -> Harmonic:
    """Return the term amplitude cos(2 pi frequency u + phase)."""
    return Harmonic(amplitude, frequency, phase, "cos")


@dataclasses.dataclass(frozen=True)
class Kinoshita(Params):
    """Sideways offset of a Kinoshita curve along its length, scaled to reach ``amplitude`` [Kinoshita1961].

    The direction is theta = angle sin p + angle^3 (skewness cos 3p - flatness sin 3p) with p = 2 pi frequency u +
    phase, and the offset the integral of sin theta: the angle makes crests round or pointed. As a centreline in
    plan, whose x is no longer even, take ``warpriver.generate.kinoshita``.
    """

    amplitude: float = _amplitude()
    frequency: float = _frequency()
    phase: float = _phase()
    angle: float = parameter(
        1.9, "rad", low=0.0, high=_LARGEST_ANGLE, low_open=True, source="Kinoshita1961", doc="largest direction angle"
    )
    skewness: float = parameter(1.0 / 32.0, "-", source="Kinoshita1961", doc="skewing of bends, > 0 upstream")
    flatness: float = parameter(1.0 / 192.0, "-", source="Kinoshita1961", doc="flattening of bends")

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        p = TURN * np.arange(_PERIOD) / _PERIOD
        third = self.skewness * np.cos(3.0 * p) - self.flatness * np.sin(3.0 * p)
        slope = np.fft.rfft(np.sin(self.angle * np.sin(p) + self.angle**3 * third)) / _PERIOD
        order = np.arange(1, _PERIOD // 4)
        # Integrated term by term; the spectrum of a smooth periodic function ends well below that many orders.
        wave = 2.0 * slope[order] / (1j * order)
        one = np.fft.irfft(np.concatenate([[0.0], wave]), _DENSE) * (0.5 * _DENSE)
        middle, half = 0.5 * (one.max() + one.min()), 0.5 * np.ptp(one)
        angle = np.ravel(TURN * self.frequency * u + self.phase)
        value = np.zeros(angle.size)
        for k in np.flatnonzero(np.abs(wave) > 1e-15 * half):
            value += wave[k].real * np.cos(order[k] * angle) - wave[k].imag * np.sin(order[k] * angle)
        shift: FloatArray = (self.amplitude * (value - middle) / half).reshape(np.shape(u))
        return shift


@dataclasses.dataclass(frozen=True)
class SineGenerated(Params):
    """Sideways offset of a sine-generated curve along its length, scaled to reach ``amplitude`` [Langbein1966].

    The direction is theta = angle sin(2 pi frequency u + phase) and the offset the integral of sin theta. As a
    centreline in plan take ``warpriver.generate.sine_generated``.
    """

    amplitude: float = _amplitude()
    frequency: float = _frequency()
    phase: float = _phase()
    angle: float = parameter(
        1.9, "rad", low=0.0, high=_LARGEST_ANGLE, low_open=True, source="Langbein1966", doc="largest direction angle"
    )

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        return Kinoshita(self.amplitude, self.frequency, self.phase, self.angle, 0.0, 0.0)(u)


@dataclasses.dataclass(frozen=True)
class Cnoidal(Params):
    """Cnoidal wave: crests narrower than troughs, f = amplitude (2 cn^2(K p / pi | modulus) - mean) [Korteweg1895].

    p = 2 pi frequency u + phase and K the complete elliptic integral; crest to trough is twice the amplitude and the
    mean over a wave is 0. Modulus 0 is a cosine, close to 1 a train of solitary crests.
    """

    amplitude: float = _amplitude()
    frequency: float = _frequency()
    phase: float = _phase()
    modulus: float = parameter(0.9, "-", low=0.0, high=0.999999, source="Korteweg1895", doc="parameter m of cn")

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        with IMPORTING:
            from scipy.special import ellipe, ellipj, ellipk

        m, quarter = self.modulus, float(ellipk(self.modulus))
        _, cn, _, _ = ellipj(quarter * (TURN * self.frequency * u + self.phase) / math.pi, m)
        mean = 0.5 if m < 1e-8 else (float(ellipe(m)) / quarter - 1.0 + m) / m
        shift: FloatArray = 2.0 * self.amplitude * (cn * cn - mean)
        return shift


@dataclasses.dataclass(frozen=True)
class Autoregressive(Params):
    """Second-order autoregressive series with a pseudo-period, normal noise and the damping h [Ferguson1976].

    x_i = 2 exp(-k h) cos(k sqrt(1 - h^2)) x_(i-1) - exp(-2 k h) x_(i-2) + e_i, where k is 2 pi frequency over the
    number of samples. ``amplitude`` is the standard deviation of the process; a short reach may have another.
    """

    amplitude: float = parameter(1.0, "-", low=0.0, source="Ferguson1976", doc="standard deviation of the process")
    frequency: float = _frequency()
    damping: float = parameter(
        0.3, "-", low=0.0, low_open=True, high=0.999, source="Ferguson1976", doc="0 regular, 1 without a period"
    )
    samples: int = parameter(784, "-", low=8.0, source="warpriver", doc="steps of the series over the reach")
    seed: int = _seed()

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        with IMPORTING:
            from scipy.signal import lfilter

        count = int(self.samples)
        k = TURN * max(self.frequency, 1e-3) / count
        first = 2.0 * math.exp(-k * self.damping) * math.cos(k * math.sqrt(1.0 - self.damping**2))
        second = -math.exp(-2.0 * k * self.damping)
        variance = (1.0 - second) / ((1.0 + second) * ((1.0 - second) ** 2 - first**2))
        before = min(math.ceil(_SPIN_UP / (k * self.damping)), 1_000_000)
        # Drawn from the upstream end, the spin-up apart, so that the series does not depend on its length.
        noise = seeded(self.seed).standard_normal(before + count + 1)
        value = lfilter([1.0], [1.0, -first, -second], noise)[before:] / math.sqrt(variance)
        return self.amplitude * interpolated(u, np.linspace(0.0, 1.0, count + 1), value)


@dataclasses.dataclass(frozen=True)
class Spectral(Params):
    """Sum of sines with power 1 / frequency^exponent and random phases [Newland1984].

    Whole numbers of cycles from ``lowest`` to ``highest``; ``amplitude`` is the standard deviation over the reach.
    """

    amplitude: float = parameter(1.0, "-", low=0.0, source="Newland1984", doc="standard deviation over the reach")
    exponent: float = parameter(1.0, "-", source="Newland1984", doc="power falls as frequency^-exponent; 1 is 1/f")
    lowest: int = parameter(1, "cycles a reach", low=1.0, source="warpriver", doc="lowest frequency, a whole number")
    highest: int = parameter(64, "cycles a reach", low=1.0, source="warpriver", doc="highest frequency")
    seed: int = _seed()

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        if self.highest < self.lowest:
            raise InputError(f"Spectral.highest is {self.highest}, below lowest, {self.lowest}; give a band")
        order = np.arange(int(self.lowest), int(self.highest) + 1, dtype=np.float64)
        size = order ** (-0.5 * self.exponent)
        size *= self.amplitude * math.sqrt(2.0 / float(size @ size))
        phase = seeded(self.seed).uniform(0.0, TURN, len(order))
        value = np.zeros(np.shape(u))
        for k, a, p in zip(order, size, phase, strict=True):
            value += a * np.sin(TURN * k * u + p)
        return value


@dataclasses.dataclass(frozen=True)
class GradientNoise(Params):
    """Perlin's gradient noise along the reach, summed over octaves [Perlin2002].

    Octave k has ``frequency`` 2^k lattice steps over the reach and ``roughness``^k of the height; the first one lies
    within [-amplitude, amplitude].
    """

    amplitude: float = _amplitude()
    frequency: float = parameter(
        4.0, "steps a reach", low=0.0, low_open=True, source="Perlin2002", doc="lattice steps over the reach"
    )
    octaves: int = parameter(1, "-", low=1.0, high=16.0, source="Musgrave1989", doc="number of octaves")
    roughness: float = parameter(0.5, "-", low=0.0, high=1.0, source="Musgrave1989", doc="height of octave to octave")
    seed: int = _seed()

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        value = np.zeros(np.shape(u))
        for k in range(int(self.octaves)):
            # Gradients of an octave come from its own stream, by lattice point from the upstream end.
            rng = np.random.default_rng([whole(self.seed, "seed", maximum=MAX_SEED), k])
            last = math.ceil(self.frequency * 2.0**k) + 1
            gradient = np.concatenate([[0.0], rng.uniform(-1.0, 1.0, last + 1), [0.0]])
            at = self.frequency * 2.0**k * np.clip(u, 0.0, 1.0)
            i = np.floor(at).astype(int)
            t = at - i
            fade = t**3 * (t * (6.0 * t - 15.0) + 10.0)
            low, high = gradient[i + 1] * t, gradient[i + 2] * (t - 1.0)
            # A step between gradients 1 and -1 reaches 1/2: doubled, the noise reaches the amplitude.
            value = value + self.amplitude * self.roughness**k * 2.0 * (low + fade * (high - low))
        return value


@dataclasses.dataclass(frozen=True)
class Steps(Params):
    """Level treads between risers, as of a step-pool reach or of terraces down the valley.

    ``levels[0]`` holds upstream of ``positions[0]``, ``levels[k]`` from ``positions[k - 1]`` on.
    """

    positions: tuple[float, ...] = (0.5,)
    levels: tuple[float, ...] = (0.0, -1.0)
    riser: float = parameter(
        0.01, "reach", low=0.0, source="warpriver", doc="length of a riser, a fraction of the reach"
    )

    def __post_init__(self) -> None:
        freeze_numbers(self, "positions", "levels")
        super().__post_init__()
        if len(self.levels) != len(self.positions) + 1:
            raise InputError(
                f"Steps.levels has {len(self.levels)} values for {len(self.positions)} positions; give one more"
            )
        if any(b <= a for a, b in zip(self.positions, self.positions[1:], strict=False)):
            raise InputError("Steps.positions must rise")

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        value = np.full(np.shape(u), self.levels[0])
        for k, at in enumerate(self.positions):
            passed = np.clip((u - at) / max(self.riser, 1e-12) + 0.5, 0.0, 1.0)
            value += (self.levels[k + 1] - self.levels[k]) * passed * passed * (3.0 - 2.0 * passed)
        return value


@dataclasses.dataclass(frozen=True)
class Spline(Params):
    """Smooth curve through control points: a natural cubic, or one that does not overshoot (``monotone``).

    A Bezier curve (``bezier``) begins and ends at the first and the last point and is drawn towards the others.
    """

    positions: tuple[float, ...] = (0.0, 1.0)
    values: tuple[float, ...] = (0.0, 0.0)
    interpolation: str = parameter(
        "cubic",
        "-",
        choices=("cubic", "monotone", "linear", "bezier"),
        source="Mortenson1997",
        doc="curve between the points",
    )

    def __post_init__(self) -> None:
        freeze_numbers(self, "positions", "values")
        super().__post_init__()
        if len(self.positions) != len(self.values) or len(self.values) < 2:
            raise InputError(
                f"Spline has {len(self.positions)} positions and {len(self.values)} values; give as many, 2 or more"
            )
        if any(b <= a for a, b in zip(self.positions, self.positions[1:], strict=False)):
            raise InputError("Spline.positions must rise")
        if self.interpolation == "bezier" and len(self.positions) > _MAX_BEZIER:
            raise InputError(
                f"Spline.positions has {len(self.positions)} numbers; a Bezier curve takes at most {_MAX_BEZIER}"
            )

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        return interpolated(u, np.array(self.positions), np.array(self.values), self.interpolation)


@dataclasses.dataclass(frozen=True)
class Series(Params):
    """A surveyed series, even along the reach unless ``positions`` are given.

    With ``relative`` the values stand for their variation about their mean, v / mean - 1: what a scaled element takes.
    With ``harmonics`` above 0 only that many of its strongest harmonics are kept.
    """

    values: tuple[float, ...] = (0.0, 0.0)
    positions: tuple[float, ...] | None = None
    amplitude: float = _amplitude()
    relative: bool = False
    harmonics: int = parameter(0, "-", low=0.0, source="Clarke1988", doc="strongest harmonics to keep, 0 for all")

    def __post_init__(self) -> None:
        freeze_numbers(self, "values")
        if self.positions is not None:
            freeze_numbers(self, "positions")
            if len(self.positions) != len(self.values):
                raise InputError(
                    f"Series has {len(self.positions)} positions for {len(self.values)} values; give as many"
                )
            if any(b <= a for a, b in zip(self.positions, self.positions[1:], strict=False)):
                raise InputError("Series.positions must rise")
        super().__post_init__()
        if len(self.values) < 2:
            raise InputError(f"Series.values has {len(self.values)} value; give 2 or more")
        if self.relative and not sum(self.values) / len(self.values) > 0.0:
            raise InputError("Series.relative asks for values whose mean is positive")

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        value = np.array(self.values)
        at = np.linspace(0.0, 1.0, len(value)) if self.positions is None else np.array(self.positions)
        if self.relative:
            value = value / value.mean() - 1.0
        if not self.harmonics:
            return self.amplitude * interpolated(u, at, value, "monotone")
        if self.positions is not None:
            even = np.linspace(0.0, 1.0, len(value))
            value = interpolated(even, at, value, "monotone")
        return self.amplitude * evaluate(strongest_harmonics(value, int(self.harmonics)), u)


def evaluate(terms: Sequence[Term], u: ArrayLike) -> FloatArray:
    """Sum of terms at positions along the reach.

    Args:
        terms: Control function; an empty one is 0.
        u: Positions, 0 upstream to 1 downstream.

    Returns:
        Array of the shape of ``u``.

    Raises:
        ValueError: A value is not finite.
    """
    u = np.asarray(u, np.float64)
    value = np.zeros(u.shape)
    for term in terms:
        added = np.asarray(term(u), np.float64)
        if added.shape != u.shape or not np.isfinite(added).all():
            raise InputError(f"{type(term).__name__} gives values that are not finite, or not one for each position")
        value += added
    return value


@public
def strongest_harmonics(values: ArrayLike, count: int) -> tuple[Harmonic, ...]:
    """Harmonics of a series by FFT, the strongest first, ready to be used as a control function [Clarke1988].

    The series is taken as one whole reach: its last value belongs to the downstream end. What differs between both
    ends appears as a jump, so a trend is better taken off first. The mean is left out.

    Args:
        values: (n,) series, even along the reach.
        count: How many to keep; those of no amplitude are left out.

    Returns:
        Cosine terms; all of them together restore the series, the mean aside.

    Raises:
        ValueError: Fewer than 3 values, a value that is not finite, or a count below 1.
    """
    value = floats(values, "values")
    if value.ndim != 1 or len(value) < 3 or not np.isfinite(value).all():
        raise InputError("values must be a series of 3 or more finite numbers")
    count = whole(count, "count", 1, "harmonics")
    samples = len(value)
    spectrum = np.fft.rfft(value) / samples
    size = 2.0 * np.abs(spectrum)
    if samples % 2 == 0:
        size[-1] *= 0.5
    size[0] = 0.0
    # The n samples of a period lie (n - 1) / n of it apart from first to last: cycles over the reach shrink with it.
    stretch = (samples - 1) / samples
    order = [k for k in np.argsort(-size, kind="stable")[:count] if size[k] > 0.0]
    return tuple(cosine(float(size[k]), float(k * stretch), float(np.angle(spectrum[k]))) for k in order)


def interpolated(u: FloatArray, at: FloatArray, value: FloatArray, kind: str = "cubic") -> FloatArray:
    """Values at u of a curve through points, or towards them; beyond the ends those of the ends.

    Args:
        u: Positions.
        at: (n,) positions of the points, rising.
        value: (n,) their values.
        kind: "cubic" (natural), "monotone", "linear" or "bezier".
    """
    with IMPORTING:
        from scipy.interpolate import BPoly, CubicSpline, PchipInterpolator

    u = np.clip(u, at[0], at[-1])
    if kind == "linear" or len(at) < 3:
        return np.interp(u, at, value)
    if kind == "bezier":
        t = np.linspace(0.0, 1.0, _BEZIER)
        place, curve = (BPoly(points[:, None], [0.0, 1.0]) for points in (at, value))
        return np.asarray(curve(PchipInterpolator(place(t), t)(u)))
    curve = PchipInterpolator(at, value) if kind == "monotone" else CubicSpline(at, value, bc_type="natural")
    return np.asarray(curve(u))
