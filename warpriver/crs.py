"""Coordinate reference systems: the one question that everything metric asks of them."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["is_geographic", "pyproj_or_none", "short_name"]

# What is known of geographic systems where pyproj is not installed.
GEOGRAPHIC = "CRS84 CRS83 CRS27 4326 4258 4267 4269 4283 4490 4617 4674 4979 7844".split()


def pyproj_or_none() -> Any:
    """Return pyproj, or None where it is not installed."""
    try:
        return importlib.import_module("pyproj")
    except ImportError:
        return None


def is_geographic(crs: str) -> bool:
    """Tell whether a CRS ("EPSG:4326", WKT ...) is known to be in degrees; without pyproj only the common ones are."""
    if crs.split(":")[-1].upper() in GEOGRAPHIC or crs.startswith(("GEOG", "GEODCRS")):
        return True
    pyproj = pyproj_or_none()
    if pyproj is None:
        return False
    try:
        return bool(pyproj.CRS(crs).is_geographic)
    except pyproj.exceptions.CRSError:
        return False


def short_name(crs: str | None) -> str:
    """Return a CRS for a message."""
    return "no CRS" if crs is None else crs if len(crs) < 40 else f"{crs[:40]}..."
