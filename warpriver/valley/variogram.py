"""Control functions with the statistics of a variogram: drawn at random, or kriged through known values."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.parameter import Params, parameter
from warpriver.validate import freeze_numbers, seeded
from warpriver.valley.controls import interpolated

__all__ = ["Variogram"]


# Known values at most: their covariances are a dense matrix.
MAX_KNOWN = 2000
# The circle on which a series is drawn is doubled so often until its spectrum has no negative power, within rounding.
DOUBLINGS, NEGATIVE_POWER = 6, 1e-9


@dataclasses.dataclass(frozen=True)
class Variogram(Params):
    """A normal series of mean 0 with a given variogram, drawn at random or kriged [Robert1988] [Legleiter2006].

    The covariance at a distance h, a fraction of the reach, is amplitude^2 (1 - nugget) r(h) with

    =========== =====================================================================
    model       r(h), where a is ``correlation``
    =========== =====================================================================
    exponential exp(-3 h / a): rough, a first-order autoregressive series
    spherical   1 - 3/2 h / a + 1/2 (h / a)^3 for h < a, else 0
    gaussian    exp(-3 (h / a)^2): smooth
    =========== =====================================================================

    and the rest, amplitude^2 nugget, is independent from sample to sample. With ``positions`` and ``values`` the series
    is conditioned on them by simple kriging: it passes through them if the nugget is 0, and else treats it as the
    variance of their error. Without ``random`` it is the kriged estimate alone, the mean of all such series.
    """

    amplitude: float = parameter(1.0, "-", low=0.0, low_open=True, source="Robert1988", doc="standard deviation")
    correlation: float = parameter(
        0.1, "reach", low=0.0, low_open=True, high=10.0, source="Robert1988", doc="range a, a fraction of the reach"
    )
    model: str = parameter(
        "exponential",
        "-",
        choices=("exponential", "spherical", "gaussian"),
        source="Legleiter2006",
        doc="shape of the variogram",
    )
    nugget: float = parameter(
        0.0, "-", low=0.0, high=1.0, source="Legleiter2006", doc="fraction of the variance without correlation"
    )
    positions: tuple[float, ...] = ()
    values: tuple[float, ...] = ()
    random: bool = True
    samples: int = parameter(784, "-", low=8, high=1_000_000, source="warpriver", doc="steps of the series")
    seed: int = parameter(0, "-", low=0, source="warpriver", doc="seed of the series, a whole number")

    def __post_init__(self) -> None:
        for name in ("positions", "values"):
            if len(getattr(self, name)):
                freeze_numbers(self, name)
            else:
                object.__setattr__(self, name, ())
        super().__post_init__()
        if len(self.positions) != len(self.values):
            raise InputError(
                f"Variogram has {len(self.positions)} positions and {len(self.values)} values; give as many"
            )
        if len(self.positions) > MAX_KNOWN:
            raise InputError(f"Variogram.positions has {len(self.positions)} numbers; give at most {MAX_KNOWN}")
        if any(b <= a for a, b in zip(self.positions, self.positions[1:], strict=False)):
            raise InputError("Variogram.positions must rise")
        if not self.random and not self.positions:
            raise InputError("Variogram.random is false without positions and values, so that it is 0 all along")

    def __call__(self, u: FloatArray) -> FloatArray:
        """Values at positions u."""
        known, value = np.array(self.positions), np.array(self.values)
        at = np.union1d(np.linspace(0.0, 1.0, int(self.samples) + 1), known)
        series = np.zeros(len(at))
        if self.random:
            even = np.linspace(0.0, 1.0, int(self.samples) + 1)
            series = np.asarray(interpolated(at, even, self._drawn(), self._between))
        if len(known):
            weights = self._kriged(known, value - series[np.searchsorted(at, known)])
            series = series + self.covariance(at[:, None] - known) @ weights
        return interpolated(u, at, series, self._between)

    def covariance(self, distance: FloatArray) -> FloatArray:
        """Return the covariance at distances that are fractions of the reach, without the nugget."""
        h = np.abs(distance) / self.correlation
        if self.model == "exponential":
            shape = np.exp(-3.0 * h)
        elif self.model == "gaussian":
            shape = np.exp(-3.0 * h**2)
        else:
            shape = np.where(h < 1.0, 1.0 - 1.5 * h + 0.5 * h**3, 0.0)
        return self.amplitude**2 * (1.0 - self.nugget) * shape

    @property
    def _between(self) -> str:
        """Interpolation between samples; that of rough series must not overshoot."""
        return "cubic" if self.model == "gaussian" and self.nugget == 0.0 else "linear"

    def _kriged(self, known: FloatArray, residual: FloatArray) -> FloatArray:
        """Weights of the covariances with the known places."""
        with IMPORTING:
            from scipy.linalg import lstsq

        matrix = self.covariance(known[:, None] - known)
        matrix[np.diag_indices(len(known))] += self.amplitude**2 * self.nugget
        # Places that lie close together on a smooth series make a matrix that is singular to rounding.
        return np.asarray(lstsq(matrix, residual, cond=1e-13, lapack_driver="gelsd")[0])

    def _drawn(self) -> FloatArray:
        """A series of the samples, by circulant embedding: exact where the spectrum has no negative power."""
        count = int(self.samples) + 1
        half = 1 << math.ceil(math.log2(count))
        for _ in range(DOUBLINGS):
            distance = np.arange(half + 1) / int(self.samples)
            circle = self.covariance(np.concatenate([distance, distance[-2:0:-1]]))
            power = np.fft.rfft(circle).real
            if power.min() >= -NEGATIVE_POWER * power.max():
                break
            half *= 2
        rng = seeded(self.seed)
        noise = rng.standard_normal(len(circle))
        scale = np.sqrt(np.maximum(power, 0.0))
        series = np.fft.irfft(np.fft.rfft(noise) * scale, len(circle))[:count]
        return series + self.amplitude * math.sqrt(self.nugget) * rng.standard_normal(count)
