"""Landscape: what the history of a river does to the ground around it, as maps."""

from warpriver.landscape.falloff import moisture_falloff, sediment_falloff
from warpriver.landscape.maps import GROUND, PLANTS, LandscapeMaps, landscape_maps
from warpriver.landscape.params import LandscapeParams

__all__ = [
    "GROUND",
    "PLANTS",
    "LandscapeMaps",
    "LandscapeParams",
    "landscape_maps",
    "moisture_falloff",
    "sediment_falloff",
]
