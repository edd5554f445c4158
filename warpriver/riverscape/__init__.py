"""Riverscapes: Rosgen types, courses, beds and moving water of rivers on a terrain that is too coarse to show them.

It makes what a map of heights leaves out plausible, at any scale, by the type of each river [Peytavie2019]. It is not a
hydraulic model: depths and speeds are those of uniform flow in a section of the type.
"""

from warpriver.riverscape.beds import Bed
from warpriver.riverscape.courses import Course, CourseMap, Log, Rock, SurveyedPlaces
from warpriver.riverscape.drift import Foam, LeafFrame
from warpriver.riverscape.edits import (
    AddLog,
    AddRock,
    AddWater,
    ChangeWater,
    MoveObstacle,
    MoveWater,
    RedrawCourse,
    RemoveObstacle,
    RemoveWater,
    ReplaceWater,
    RetypeChannel,
)
from warpriver.riverscape.examples import Example, example
from warpriver.riverscape.files import read_riverscape
from warpriver.riverscape.labels import ChannelLabels, label_channels, river_mask
from warpriver.riverscape.layout import BedParams
from warpriver.riverscape.outputs import FlowMap, read_flow_map, write_frames
from warpriver.riverscape.primitives import KINDS, Merge, Primitives, Replace, blend, primitives
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.rivers import Rivers
from warpriver.riverscape.rosgen import (
    CRITERIA,
    RiverTypes,
    RosgenParams,
    classify_rivers,
    classify_values,
    entrenchment_ratio,
)
from warpriver.riverscape.scene import Frame, Riverscape
from warpriver.riverscape.seeding import SeedingParams, seed_water
from warpriver.riverscape.stations import TYPES, Basins, Falls, Rocks, Stations
from warpriver.riverscape.templates import FlowParams, UniformFlow, UnitSections, uniform_flow, unit_sections
from warpriver.riverscape.trajectories import TrajectoryParams
from warpriver.riverscape.water import Water, WaterGrid, WaterSample

__all__ = [
    "CRITERIA",
    "KINDS",
    "TYPES",
    "AddLog",
    "AddRock",
    "AddWater",
    "Basins",
    "Bed",
    "BedParams",
    "ChangeWater",
    "ChannelLabels",
    "Course",
    "CourseMap",
    "Example",
    "Falls",
    "FlowMap",
    "FlowParams",
    "Foam",
    "Frame",
    "LeafFrame",
    "Log",
    "Merge",
    "MoveObstacle",
    "MoveWater",
    "Primitives",
    "ProfileParams",
    "RedrawCourse",
    "RemoveObstacle",
    "RemoveWater",
    "Replace",
    "ReplaceWater",
    "RetypeChannel",
    "RiverTypes",
    "Rivers",
    "Riverscape",
    "Rock",
    "Rocks",
    "RosgenParams",
    "SeedingParams",
    "Stations",
    "SurveyedPlaces",
    "TrajectoryParams",
    "UniformFlow",
    "UnitSections",
    "Water",
    "WaterGrid",
    "WaterSample",
    "blend",
    "classify_rivers",
    "classify_values",
    "entrenchment_ratio",
    "example",
    "label_channels",
    "primitives",
    "read_flow_map",
    "read_riverscape",
    "river_mask",
    "seed_water",
    "uniform_flow",
    "unit_sections",
    "write_frames",
]
