"""Erosion by rain that walks downhill at random [Leheny1995]."""

from warpriver.erosion.eroded import ErodedTerrain
from warpriver.erosion.leheny import erode, erode_ensemble

__all__ = ["ErodedTerrain", "erode", "erode_ensemble"]
