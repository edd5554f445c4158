"""warpriver: a GPU compute engine for rivers.

A network of channels is read or made, a simulation lets it migrate and cut off its bends, and a history keeps what
happened. Start at :class:`RiverNetwork`, :class:`Simulation` and :class:`History`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warpriver import erosion, generate, hydrology, meander, metrics, valley, viz
    from warpriver.channel_table import ChannelTable
    from warpriver.erosion.eroded import ErodedTerrain
    from warpriver.erosion.leheny import erode, erode_ensemble
    from warpriver.history import Collision, Cutoff, Event, History, Split, StopReason
    from warpriver.hydrology.extraction import extract_network
    from warpriver.io.raster.terrains import read_raster, read_terrain, write_raster, write_terrain
    from warpriver.io.raster.xarrays import from_xarray, raster_from_xarray, to_xarray
    from warpriver.io.valleys import read_valley, write_breaklines, write_mesh, write_points, write_valley
    from warpriver.io.vector.networks import read_network, write_network
    from warpriver.meander.smoothing import taubin_smooth
    from warpriver.network import RiverNetwork
    from warpriver.params import LehenyParams, MeanderParams, PathMeander
    from warpriver.raster import Raster
    from warpriver.simulation import Every, Simulation
    from warpriver.terrain import Terrain
    from warpriver.valley.params import ValleyParams
    from warpriver.valley.valley import Valley, synthetic_valley

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
    "erosion",
    "extract_network",
    "from_xarray",
    "generate",
    "hydrology",
    "meander",
    "metrics",
    "raster_from_xarray",
    "read_network",
    "read_raster",
    "read_terrain",
    "read_valley",
    "synthetic_valley",
    "taubin_smooth",
    "to_xarray",
    "valley",
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
    "ErodedTerrain": "warpriver.erosion.eroded",
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
    "erode": "warpriver.erosion.leheny",
    "erode_ensemble": "warpriver.erosion.leheny",
    "Valley": "warpriver.valley.valley",
    "ValleyParams": "warpriver.valley.params",
    "extract_network": "warpriver.hydrology.extraction",
    "from_xarray": "warpriver.io.raster.xarrays",
    "read_network": "warpriver.io.vector.networks",
    "raster_from_xarray": "warpriver.io.raster.xarrays",
    "read_raster": "warpriver.io.raster.terrains",
    "read_terrain": "warpriver.io.raster.terrains",
    "read_valley": "warpriver.io.valleys",
    "synthetic_valley": "warpriver.valley.valley",
    "taubin_smooth": "warpriver.meander.smoothing",
    "to_xarray": "warpriver.io.raster.xarrays",
    "write_breaklines": "warpriver.io.valleys",
    "write_mesh": "warpriver.io.valleys",
    "write_network": "warpriver.io.vector.networks",
    "write_points": "warpriver.io.valleys",
    "write_raster": "warpriver.io.raster.terrains",
    "write_terrain": "warpriver.io.raster.terrains",
    "write_valley": "warpriver.io.valleys",
}
_ROOMS = ("erosion", "generate", "hydrology", "meander", "metrics", "valley", "viz")


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
