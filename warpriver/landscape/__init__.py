"""Landscapes: what the history of a river does to the ground around it, as maps."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from warpriver.landscape.params import LandscapeParams

if TYPE_CHECKING:
    from warpriver.landscape.coupling import erodibility, simulate_with_plants
    from warpriver.landscape.falloff import moisture_falloff, sediment_falloff
    from warpriver.landscape.maps import GROUND, PLANTS, Landscape, LandscapeMaps, landscape_maps

__all__ = [
    "GROUND",
    "PLANTS",
    "Landscape",
    "LandscapeMaps",
    "LandscapeParams",
    "erodibility",
    "landscape_maps",
    "moisture_falloff",
    "sediment_falloff",
    "simulate_with_plants",
]

# Each is imported when it is first used, so that the command line can list the constants without waiting for Warp.
_HOMES = {
    "coupling": ("erodibility", "simulate_with_plants"),
    "falloff": ("moisture_falloff", "sediment_falloff"),
    "maps": ("GROUND", "PLANTS", "Landscape", "LandscapeMaps", "landscape_maps"),
}


def __getattr__(name: str) -> Any:
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"warpriver.landscape.{home}"), name)
    globals()[name] = value
    return value
