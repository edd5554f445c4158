"""Files beside a picture that say where it lies: world files, and the .aux.xml of GDAL."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from warpriver.crs import pyproj_or_none

__all__ = ["WORLD_FILES", "write_placing", "write_world_file"]

# Suffixes of world files by those of pictures.
WORLD_FILES = {".png": ".pgw", ".jpg": ".jgw"}


def write_world_file(path: Path, place: Sequence[float]) -> None:
    """Write the six numbers of a world file: sides of a pixel, and the centre of the first one.

    Args:
        path: File to write.
        place: (west, north, width, height): outer corner of the first pixel, and sides of a pixel, m.
    """
    west, north, width, height = map(float, place)
    numbers = (width, 0.0, 0.0, -height, west + 0.5 * width, north - 0.5 * height)
    path.write_text("".join(f"{number!r}\n" for number in numbers), encoding="ascii")


def write_placing(path: Path, place: Sequence[float], crs: str | None, band: Mapping[str, str] | None = None) -> None:
    """Write the .aux.xml in which GDAL, QGIS and their like find where a picture lies.

    Args:
        path: File to write.
        place: As of :func:`write_world_file`.
        crs: Coordinate reference system, or None.
        band: What is told of the first band, by GDAL's names.
    """
    top = ElementTree.Element("PAMDataset")
    if crs is not None:
        pyproj = pyproj_or_none()
        text = pyproj.CRS(crs).to_wkt() if pyproj else crs
        ElementTree.SubElement(top, "SRS", dataAxisToSRSAxisMapping="1,2").text = text
    west, north, width, height = map(float, place)
    numbers = (west, width, 0.0, north, 0.0, -height)
    ElementTree.SubElement(top, "GeoTransform").text = ", ".join(map(repr, numbers))
    if band:
        element = ElementTree.SubElement(top, "PAMRasterBand", band="1")
        for tag, text in band.items():
            ElementTree.SubElement(element, tag).text = text
    ElementTree.ElementTree(top).write(path, encoding="utf-8")
