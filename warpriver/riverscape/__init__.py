"""Rivers with beds and moving water, to be asked at any place and time [Peytavie2019]."""

from warpriver.riverscape.courses import Course, CourseMap, Rock, SurveyedPlaces
from warpriver.riverscape.drift import Foam, LeafFrame
from warpriver.riverscape.examples import Example, example
from warpriver.riverscape.outputs import FlowMap, read_flow_map, write_frames
from warpriver.riverscape.primitives import KINDS, Merge, Primitives, Replace, blend, primitives
from warpriver.riverscape.scene import Frame, Riverscape, read_riverscape
from warpriver.riverscape.seeding import SeedingParams, seed_water
from warpriver.riverscape.water import Water, WaterGrid, WaterSample

__all__ = [
    "KINDS",
    "Course",
    "CourseMap",
    "Example",
    "FlowMap",
    "Foam",
    "Frame",
    "LeafFrame",
    "Merge",
    "Primitives",
    "Replace",
    "Riverscape",
    "Rock",
    "SeedingParams",
    "SurveyedPlaces",
    "Water",
    "WaterGrid",
    "WaterSample",
    "blend",
    "example",
    "primitives",
    "read_flow_map",
    "read_riverscape",
    "seed_water",
    "write_frames",
]
