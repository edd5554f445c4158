"""Riverscapes: Rosgen types, courses, beds and water of rivers on a terrain that is too coarse to show them.

It makes what a map of heights leaves out plausible, at any scale, by the type of each river [Peytavie2019]. It is not a
hydraulic model: depths and speeds are those of uniform flow in a section of the type.
"""

from warpriver.riverscape.beds import Bed
from warpriver.riverscape.labels import ChannelLabels, label_channels, river_mask
from warpriver.riverscape.layout import BedParams
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.rosgen import (
    CRITERIA,
    RiverTypes,
    RosgenParams,
    classify_rivers,
    classify_values,
    entrenchment_ratio,
)
from warpriver.riverscape.scene import Riverscape
from warpriver.riverscape.stations import Basins, Courses, Falls, Rocks
from warpriver.riverscape.templates import FlowParams, UniformFlow, uniform_flow
from warpriver.riverscape.trajectories import TrajectoryParams

__all__ = [
    "CRITERIA",
    "Basins",
    "Bed",
    "BedParams",
    "ChannelLabels",
    "Courses",
    "Falls",
    "FlowParams",
    "ProfileParams",
    "RiverTypes",
    "Riverscape",
    "Rocks",
    "RosgenParams",
    "TrajectoryParams",
    "UniformFlow",
    "classify_rivers",
    "classify_values",
    "entrenchment_ratio",
    "label_channels",
    "river_mask",
    "uniform_flow",
]
