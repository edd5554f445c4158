"""The kinds of terms that a control function is a sum of, by the names that a valley file gives them."""

from __future__ import annotations

from warpriver.valley.controls import (
    Autoregressive,
    Cnoidal,
    GradientNoise,
    Harmonic,
    Kinoshita,
    Series,
    SineGenerated,
    Spectral,
    Spline,
    Steps,
)
from warpriver.valley.variogram import Variogram

__all__ = ["TERMS"]

TERMS: dict[str, type] = {
    "harmonic": Harmonic,
    "sine-generated": SineGenerated,
    "kinoshita": Kinoshita,
    "autoregressive": Autoregressive,
    "spectral": Spectral,
    "perlin": GradientNoise,
    "cnoidal": Cnoidal,
    "steps": Steps,
    "spline": Spline,
    "series": Series,
    "variogram": Variogram,
}
