"""Landscapes: what rivers do to the ground, as maps of their history, carved beds, water, and files of these."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from warpriver.landscape.constants import CarveParams
from warpriver.landscape.params import LandscapeParams

if TYPE_CHECKING:
    from warpriver.landscape.carving import Carved, CarveReport, carve
    from warpriver.landscape.coupling import erodibility, simulate_with_plants
    from warpriver.landscape.export import export_landscape
    from warpriver.landscape.falloff import levee_falloff, moisture_falloff, sediment_falloff
    from warpriver.landscape.grounds import ground_of_run, plain_under
    from warpriver.landscape.maps import GROUND, PLANTS, Landscape, LandscapeMaps, landscape_maps
    from warpriver.landscape.scene_files import write_surfaces
    from warpriver.landscape.sections import SectionTable
    from warpriver.landscape.splines import Splines, channel_splines
    from warpriver.landscape.surfaces import Surface, channel_ribbons, landscape_surfaces

__all__ = [
    "GROUND",
    "PLANTS",
    "CarveParams",
    "CarveReport",
    "Carved",
    "Landscape",
    "LandscapeMaps",
    "LandscapeParams",
    "SectionTable",
    "Splines",
    "Surface",
    "carve",
    "channel_ribbons",
    "channel_splines",
    "erodibility",
    "export_landscape",
    "ground_of_run",
    "landscape_maps",
    "landscape_surfaces",
    "levee_falloff",
    "moisture_falloff",
    "plain_under",
    "sediment_falloff",
    "simulate_with_plants",
    "write_surfaces",
]

# Each is imported when it is first used, so that the command line can list the constants without waiting for Warp.
_HOMES = {
    "carving": ("CarveReport", "Carved", "carve"),
    "coupling": ("erodibility", "simulate_with_plants"),
    "export": ("export_landscape",),
    "falloff": ("levee_falloff", "moisture_falloff", "sediment_falloff"),
    "grounds": ("ground_of_run", "plain_under"),
    "maps": ("GROUND", "PLANTS", "Landscape", "LandscapeMaps", "landscape_maps"),
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
