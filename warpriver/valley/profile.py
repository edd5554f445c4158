"""Long profile of a valley: how its slope changes from the upstream to the downstream end of the reach."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.parameter import Params, parameter

__all__ = ["LongProfile"]


# Slopes at both ends that are as equal as this make a straight profile.
STRAIGHT = 1e-9


@dataclasses.dataclass(frozen=True)
class LongProfile(Params):
    """Profile of basin scale in place of an even slope; its mean slope is that of the reach [Brown2014], Table 2.

    With R the slope at the upstream end over that at the downstream end, and u from 0 to 1 along the axis, the slope is
    in proportion to

    =========== ========================================== ==========================================
    form        slope                                      profile
    =========== ========================================== ==========================================
    linear      1
    exponential R^-u                                       exponential [Snow1987]
    logarithmic 1 / (1 + (R - 1) u)                        logarithmic [Snow1987]
    power       (1 + c u)^-exponent, c = R^(1/exponent) - 1  power of the distance from a head upstream
    =========== ========================================== ==========================================

    R above 1 is a concave profile, as of rivers; below 1 a convex one.
    """

    form: str = parameter(
        "linear",
        "-",
        choices=("linear", "exponential", "logarithmic", "power"),
        source="Brown2014",
        doc="form of the profile",
    )
    slope_ratio: float = parameter(
        10.0,
        "-",
        low=0.0,
        low_open=True,
        high=1e6,
        source="Snow1987",
        doc="slope at the upstream end over that at the downstream end; without effect on a linear profile",
    )
    exponent: float = parameter(
        0.5, "-", low=0.0, low_open=True, high=10.0, source="Snow1987", doc="exponent of the power form"
    )

    def height(self, u: FloatArray) -> FloatArray:
        """Return the height above the downstream end over the whole fall: 1 at u = 0, 0 at u = 1.

        Args:
            u: Positions along the valley axis, 0 to 1.
        """
        u = np.asarray(u, np.float64)
        ratio = float(self.slope_ratio)
        if self.form == "linear" or abs(ratio - 1.0) < STRAIGHT:
            return 1.0 - u
        if self.form == "exponential":
            rate = math.log(ratio)
            return np.asarray(np.expm1(rate * (1.0 - u)) / math.expm1(rate))
        if self.form == "logarithmic":
            return np.asarray(1.0 - np.log1p((ratio - 1.0) * u) / math.log(ratio))
        c = math.expm1(math.log(ratio) / self.exponent)
        power = 1.0 - self.exponent
        if abs(power) < STRAIGHT:
            return np.asarray(1.0 - np.log1p(c * u) / math.log1p(c))
        left, whole = power * np.log1p(c * u), power * math.log1p(c)
        return np.asarray(1.0 - np.expm1(left) / math.expm1(whole))

    def bend(self, u: FloatArray) -> FloatArray:
        """Return how far the profile lies above the straight line between its ends, over the whole fall."""
        u = np.clip(u, 0.0, 1.0)
        return self.height(u) - (1.0 - u)
