"""warpriver: a GPU compute engine for rivers.

A network of channels is read or made, a simulation lets it migrate and cut off its bends, and a history keeps what
happened. Start at :class:`RiverNetwork`, :class:`Simulation` and :class:`History`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warpriver import generate, hydrology, metrics, viz
    from warpriver.channel_table import ChannelTable
    from warpriver.generate.eroded import ErodedTerrain
    from warpriver.generate.leheny import erode, erode_ensemble
    from warpriver.generate.valley import Valley, synthetic_valley
    from warpriver.generate.valley_params import ValleyParams
    from warpriver.history import Collision, Cutoff, Event, History, Split, StopReason
    from warpriver.hydrology.extraction import extract_network
    from warpriver.io.lines import read_network, write_network
    from warpriver.io.rasters import read_raster, read_terrain, write_raster, write_terrain
    from warpriver.io.valleys import read_valley, write_breaklines, write_mesh, write_points, write_valley
    from warpriver.io.xarrays import from_xarray, raster_from_xarray, to_xarray
    from warpriver.meander.smoothing import taubin_smooth
    from warpriver.network import RiverNetwork
    from warpriver.params import LehenyParams, MeanderParams, PathMeander
    from warpriver.raster import Raster
    from warpriver.simulation import Every, Simulation
    from warpriver.terrain import Terrain

__all__ = [
    "ChannelTable",
    "Collision",
    "Cutoff",
    "ErodedTerrain",
    "Event",
    "Every",
    "History",
    "LehenyParams",
    "MeanderParams",
    "PathMeander",
    "Raster",
    "RiverNetwork",
    "Simulation",
    "Split",
    "StopReason",
    "Terrain",
    "Valley",
    "ValleyParams",
    "erode",
    "erode_ensemble",
    "extract_network",
    "from_xarray",
    "generate",
    "hydrology",
    "metrics",
    "raster_from_xarray",
    "read_network",
    "read_raster",
    "read_terrain",
    "read_valley",
    "synthetic_valley",
    "taubin_smooth",
    "to_xarray",
    "viz",
    "write_breaklines",
    "write_mesh",
    "write_network",
    "write_points",
    "write_raster",
    "write_terrain",
    "write_valley",
]

__version__ = "0.1.0"

# Each name is imported when it is first used, so that `warpriver --help` does not wait for Warp.
_HOMES = {
    "ChannelTable": "warpriver.channel_table",
    "Collision": "warpriver.history",
    "Cutoff": "warpriver.history",
    "ErodedTerrain": "warpriver.generate.eroded",
    "Event": "warpriver.history",
    "Every": "warpriver.simulation",
    "History": "warpriver.history",
    "LehenyParams": "warpriver.params",
    "MeanderParams": "warpriver.params",
    "PathMeander": "warpriver.params",
    "Raster": "warpriver.raster",
    "RiverNetwork": "warpriver.network",
    "Simulation": "warpriver.simulation",
    "Split": "warpriver.history",
    "StopReason": "warpriver.history",
    "Terrain": "warpriver.terrain",
    "erode": "warpriver.generate.leheny",
    "erode_ensemble": "warpriver.generate.leheny",
    "Valley": "warpriver.generate.valley",
    "ValleyParams": "warpriver.generate.valley_params",
    "extract_network": "warpriver.hydrology.extraction",
    "from_xarray": "warpriver.io.xarrays",
    "read_network": "warpriver.io.lines",
    "raster_from_xarray": "warpriver.io.xarrays",
    "read_raster": "warpriver.io.rasters",
    "read_terrain": "warpriver.io.rasters",
    "read_valley": "warpriver.io.valleys",
    "synthetic_valley": "warpriver.generate.valley",
    "taubin_smooth": "warpriver.meander.smoothing",
    "to_xarray": "warpriver.io.xarrays",
    "write_breaklines": "warpriver.io.valleys",
    "write_mesh": "warpriver.io.valleys",
    "write_network": "warpriver.io.lines",
    "write_points": "warpriver.io.valleys",
    "write_raster": "warpriver.io.rasters",
    "write_terrain": "warpriver.io.rasters",
    "write_valley": "warpriver.io.valleys",
}
_ROOMS = ("generate", "hydrology", "metrics", "viz")


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
