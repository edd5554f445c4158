"""Calibration: constants of meander migration from dated surveys, and what forecasts with them are worth."""

from __future__ import annotations

from warpriver.calibration.fits import Fit, calibrate

__all__ = ["Fit", "calibrate"]
