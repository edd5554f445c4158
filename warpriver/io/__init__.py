"""Files in and out; the modules that a format needs are imported when it is used."""

import importlib
from typing import Any

from warpriver.io.meshes import read_mesh, write_mesh
from warpriver.io.raster.terrains import read_raster, read_terrain, write_raster, write_terrain
from warpriver.io.raster.xarrays import from_xarray, raster_from_xarray, to_xarray
from warpriver.io.valleys import read_valley, write_breaklines, write_points, write_valley
from warpriver.io.vector.histories import write_history
from warpriver.io.vector.networks import line_formats, read_network, write_network

__all__ = [
    "from_xarray",
    "line_formats",
    "raster_from_xarray",
    "read_mesh",
    "read_network",
    "read_raster",
    "read_terrain",
    "read_valley",
    "to_xarray",
    "write_breaklines",
    "write_history",
    "write_mesh",
    "write_network",
    "write_points",
    "write_raster",
    "write_terrain",
    "write_valley",
]


def __getattr__(name: str) -> Any:
    # Scenes stand above simulations, and so above this room; those who look for readers find theirs here all the same.
    if name == "read_scene":
        return importlib.import_module("warpriver.scenes").read_scene
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
