"""Files in and out; the modules that a format needs are imported when it is used."""

from warpriver.io.raster.terrains import read_raster, read_terrain, write_raster, write_terrain
from warpriver.io.raster.xarrays import from_xarray, raster_from_xarray, to_xarray
from warpriver.io.valleys import read_mesh, read_valley, write_breaklines, write_mesh, write_points, write_valley
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
    "write_mesh",
    "write_network",
    "write_points",
    "write_raster",
    "write_terrain",
    "write_valley",
]
