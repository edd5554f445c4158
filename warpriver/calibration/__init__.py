"""Calibration: constants of meander migration from dated surveys, and what forecasts with them are worth."""

from __future__ import annotations

from warpriver.calibration.files import FIT_FILES, FORECASTS, write_fit, write_hindcast
from warpriver.calibration.fits import Fit, calibrate
from warpriver.calibration.hindcasts import Forecast, Hindcast, Score, hindcast
from warpriver.calibration.posterior import Posterior, posterior

__all__ = [
    "FIT_FILES",
    "FORECASTS",
    "Fit",
    "Forecast",
    "Hindcast",
    "Posterior",
    "Score",
    "calibrate",
    "hindcast",
    "posterior",
    "write_fit",
    "write_hindcast",
]
