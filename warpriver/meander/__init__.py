"""What a meandering channel does in one step: migrate, cut off, be resampled; and the parts that can be used alone.

:func:`migration_rate` tells how fast each point of a network migrates, :func:`step_limits` and :func:`stable_dt` how
long a step may be. :func:`shape_junctions` gives tributaries the angle that fits their flows, and
:func:`taubin_smooth` takes short waves out of lines. :class:`Attractor`, :class:`Repeller`, :class:`Guide`,
:class:`ControlField`, :class:`DampingRegion` and :class:`ErodibilityField` are the controls that a simulation takes,
:func:`mapped_banks` makes the last one from two dated surveys, :class:`AvulsionParams` lets channels leave their
courses.
"""

from warpriver.meander.control_edit import SetControls
from warpriver.meander.controls import (
    Attractor,
    Control,
    ControlField,
    DampingRegion,
    ErodibilityField,
    Guide,
    Repeller,
)
from warpriver.meander.dated import mapped_banks
from warpriver.meander.junctions import JunctionParams, arrival_angles, junction_angles, shape_junctions
from warpriver.meander.migration import stable_dt, step_limits
from warpriver.meander.rates import migration_rate
from warpriver.meander.smoothing import taubin_smooth
from warpriver.params import AvulsionParams, ChuteParams, FloodplainParams, WidthParams

__all__ = [
    "Attractor",
    "AvulsionParams",
    "ChuteParams",
    "Control",
    "ControlField",
    "DampingRegion",
    "ErodibilityField",
    "FloodplainParams",
    "Guide",
    "JunctionParams",
    "Repeller",
    "SetControls",
    "WidthParams",
    "arrival_angles",
    "junction_angles",
    "mapped_banks",
    "migration_rate",
    "shape_junctions",
    "stable_dt",
    "step_limits",
    "taubin_smooth",
]
