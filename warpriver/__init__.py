"""warpriver: a GPU compute engine for rivers.

A network of channels is read or made, a simulation lets it migrate and cut off its bends, and a history keeps what
happened. Start at :class:`RiverNetwork` and :class:`Simulation`; what belongs to one subject is in its room, such as
``warpriver.metrics`` or ``warpriver.io``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warpriver import (
        calibration,
        edits,
        erosion,
        generate,
        history,
        hydrology,
        io,
        landscape,
        meander,
        metrics,
        riverscape,
        scenes,
        studio,
        valley,
        viz,
    )
    from warpriver.erosion.leheny import erode
    from warpriver.errors import WarpriverError
    from warpriver.history import Every, History, read_history
    from warpriver.hydrology.extraction import extract_network
    from warpriver.io.meshes import write_mesh
    from warpriver.io.raster.terrains import read_terrain, write_terrain
    from warpriver.io.raster.xarrays import from_xarray, to_xarray
    from warpriver.io.vector.networks import read_network, write_network
    from warpriver.network import RiverNetwork
    from warpriver.params import LehenyParams, MeanderParams, PathMeander
    from warpriver.simulation import Simulation
    from warpriver.terrain import Terrain
    from warpriver.valley.valley import synthetic_valley

# Twenty names at most, beside the rooms: what first scripts need.
__all__ = [
    "Every",
    "History",
    "LehenyParams",
    "MeanderParams",
    "PathMeander",
    "RiverNetwork",
    "Simulation",
    "Terrain",
    "WarpriverError",
    "calibration",
    "edits",
    "erode",
    "erosion",
    "extract_network",
    "from_xarray",
    "generate",
    "history",
    "hydrology",
    "io",
    "landscape",
    "meander",
    "metrics",
    "read_history",
    "read_network",
    "read_terrain",
    "riverscape",
    "scenes",
    "studio",
    "synthetic_valley",
    "to_xarray",
    "valley",
    "viz",
    "write_mesh",
    "write_network",
    "write_terrain",
]

__version__ = "0.1.0"

# Each name is imported when it is first used, so that `warpriver --help` does not wait for Warp.
_HOMES = {
    "Attractor": "warpriver.meander.controls",  # controls and their like are listed by their room
    "AvulsionParams": "warpriver.params",
    "ChuteParams": "warpriver.params",
    "ControlField": "warpriver.meander.controls",
    "DampingRegion": "warpriver.meander.controls",
    "ErodibilityField": "warpriver.meander.controls",
    "FloodplainParams": "warpriver.params",
    "Every": "warpriver.history",
    "Guide": "warpriver.meander.controls",
    "History": "warpriver.history",
    "LehenyParams": "warpriver.params",
    "MeanderParams": "warpriver.params",
    "PathMeander": "warpriver.params",
    "Repeller": "warpriver.meander.controls",
    "Riverscape": "warpriver.riverscape.scene",  # listed by its room
    "RiverNetwork": "warpriver.network",
    "Simulation": "warpriver.simulation",
    "Terrain": "warpriver.terrain",
    "WarpriverError": "warpriver.errors",
    "WidthParams": "warpriver.params",
    "calibrate": "warpriver.calibration",  # listed by its room
    "carve": "warpriver.landscape.carving",  # listed by its room
    "classify_rivers": "warpriver.riverscape",
    "erode": "warpriver.erosion.leheny",
    "extract_network": "warpriver.hydrology.extraction",
    "from_xarray": "warpriver.io.raster.xarrays",
    "hindcast": "warpriver.calibration",  # listed by its room
    "landscape_maps": "warpriver.landscape.maps",  # listed by its room
    "read_history": "warpriver.history",
    "read_network": "warpriver.io.vector.networks",
    "read_scene": "warpriver.scenes",  # listed by its room
    "read_terrain": "warpriver.io.raster.terrains",
    "synthetic_valley": "warpriver.valley.valley",
    "taubin_smooth": "warpriver.meander.smoothing",  # listed by its room
    "to_xarray": "warpriver.io.raster.xarrays",
    "write_mesh": "warpriver.io.meshes",
    "write_network": "warpriver.io.vector.networks",
    "write_terrain": "warpriver.io.raster.terrains",
}
_ROOMS = (
    "calibration",
    "edits",
    "erosion",
    "generate",
    "history",
    "hydrology",
    "io",
    "landscape",
    "meander",
    "metrics",
    "riverscape",
    "scenes",
    "studio",
    "valley",
    "viz",
)


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"warpriver.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'warpriver' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
