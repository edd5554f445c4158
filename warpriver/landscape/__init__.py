"""Landscapes: beds, water and lakes carved into a terrain, and files of them for engines, artists and GIS."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from warpriver.landscape.constants import CarveParams

if TYPE_CHECKING:
    from warpriver.landscape.carving import Carved, CarveReport, carve
    from warpriver.landscape.export import export_landscape
    from warpriver.landscape.grounds import ground_of_run, plain_under
    from warpriver.landscape.scene_files import write_surfaces
    from warpriver.landscape.sections import SectionTable
    from warpriver.landscape.splines import Splines, channel_splines
    from warpriver.landscape.surfaces import Surface, channel_ribbons, landscape_surfaces

__all__ = [
    "CarveParams",
    "CarveReport",
    "Carved",
    "SectionTable",
    "Splines",
    "Surface",
    "carve",
    "channel_ribbons",
    "channel_splines",
    "export_landscape",
    "ground_of_run",
    "landscape_surfaces",
    "plain_under",
    "write_surfaces",
]

# Each is imported when it is first used, so that the command line can list the constants without waiting for Warp.
_HOMES = {
    "carving": ("CarveReport", "Carved", "carve"),
    "export": ("export_landscape",),
    "grounds": ("ground_of_run", "plain_under"),
    "scene_files": ("write_surfaces",),
    "sections": ("SectionTable",),
    "splines": ("Splines", "channel_splines"),
    "surfaces": ("Surface", "channel_ribbons", "landscape_surfaces"),
}


def __getattr__(name: str) -> Any:
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"warpriver.landscape.{home}"), name)
    globals()[name] = value
    return value
