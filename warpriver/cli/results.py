"""Results that other programs open, in the format of the input where that is one for a GIS."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warpriver.history import History
    from warpriver.network import RiverNetwork
    from warpriver.terrain import Terrain

__all__ = ["write_ground", "write_lines", "write_run"]

# The name of the files, and the modules without which GeoJSON of the lines is all that can be written.
NAME, MODULES = "rivers", ("pyogrio", "shapely")


def write_run(history: History, folder: Path, source: str | Path | None = None) -> list[str]:
    """Write rivers, earlier courses, oxbow lakes and abandoned courses of a run for a GIS; return what to say.

    Args:
        history: The run.
        folder: Where to write them.
        source: The file that the rivers come from, whose format the results get if it is one of a GIS; for a run that
            is continued its folder, and for none None: then that of earlier results there, or the default.
    """
    from warpriver.io.files import filtered_warnings
    from warpriver.io.vector.histories import HISTORY_SUFFIXES, records_between, write_history
    from warpriver.io.vector.networks import write_network

    suffixes = [Path(source).suffix.lower()] if source is not None else []
    suffixes += [file.suffix for file in sorted(folder.glob(f"{NAME}.*"))]
    whole = all(importlib.util.find_spec(module) for module in MODULES)
    default = ".gpkg" if whole else ".geojson"
    target = folder / f"{NAME}{next((s for s in suffixes if s in HISTORY_SUFFIXES), default)}"
    if not whole:
        write_network(history.networks[-1], target)
        return [f'  GIS      {target}; with courses and oxbow lakes: pip install "warpriver[gis]"']
    # That a shapefile has the mean widths was told when it was read.
    with filtered_warnings("ignore", Warning, ".*a shapefile holds one width"):
        files = write_history(history, target)
    step = records_between(history)
    some = f", courses of every {step} records" if step > 1 else ""
    return [f"  GIS      {', '.join(map(str, files))}{some}"]


def write_lines(network: RiverNetwork, folder: Path) -> list[str]:
    """Write rivers for a GIS, beside the CSV; return what to say."""
    from warpriver.io.vector.networks import write_network

    whole = all(importlib.util.find_spec(module) for module in MODULES)
    target = folder / f"{NAME}{'.gpkg' if whole else '.geojson'}"
    write_network(network, target)
    return [f"  GIS      {target}"]


def write_ground(terrain: Terrain, folder: Path, source: str | None = None) -> list[str]:
    """Write a terrain for a GIS or a terrain program, beside the .npz: in its source's format if that has one.

    Args:
        terrain: What to write.
        folder: Where to write it.
        source: The file that it comes from, or None.
    """
    from warpriver.io.raster.terrains import SUFFIXES, write_terrain

    suffix = "" if source is None else Path(source).suffix.lower()
    if suffix in (".npz", ".npy") or suffix not in SUFFIXES:
        suffix = ".tif" if importlib.util.find_spec("rasterio") else ".asc"
    target = folder / f"terrain{suffix}"
    write_terrain(terrain, target)
    return [f"  raster   {target}"]
