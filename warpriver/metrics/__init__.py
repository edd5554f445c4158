"""Planform metrics of rivers: arc length, curvature, bends, wavelength, migration, oxbow lakes.

Pure functions on float64 NumPy arrays. A centreline is an (n, 2) array of points in metres that runs
downstream; left and right are as seen looking downstream, and curvature > 0 turns left.
"""

from warpriver.metrics.changes import LognormalFit, lag, lognormal_fit, migration, oxbow_lengths
from warpriver.metrics.lines import arc_length, curvature, sinuosity, sinuosity_window
from warpriver.metrics.meanders import (
    Bends,
    InflectionPoints,
    bend_radius,
    bend_sinuosity,
    bends,
    inflection_points,
    wavelength,
    wavelength_range,
)
from warpriver.metrics.rivers import Comparison, RiverStatistics, compare, statistics

__all__ = [
    "Bends",
    "Comparison",
    "InflectionPoints",
    "LognormalFit",
    "RiverStatistics",
    "arc_length",
    "bend_radius",
    "bend_sinuosity",
    "bends",
    "compare",
    "curvature",
    "inflection_points",
    "lag",
    "lognormal_fit",
    "migration",
    "oxbow_lengths",
    "sinuosity",
    "sinuosity_window",
    "statistics",
    "wavelength",
    "wavelength_range",
]
