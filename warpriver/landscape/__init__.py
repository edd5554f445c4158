"""Landscapes: beds, water and lakes carved into a terrain, and files of them for engines, artists and GIS."""

from warpriver.landscape.carving import Carved, CarveParams, CarveReport, carve
from warpriver.landscape.sections import SectionTable

__all__ = ["CarveParams", "CarveReport", "Carved", "SectionTable", "carve"]
