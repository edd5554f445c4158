"""Coordinate reference systems: their text, their units, and whether x and y in them are metres."""

from __future__ import annotations

import functools
import importlib
import re
from typing import Any, Protocol, TypeAlias, runtime_checkable

from warpriver.errors import InputError
from warpriver.validate import shown

__all__ = [
    "CRSLike",
    "SupportsWkt",
    "crs_text",
    "height_unit",
    "is_geographic",
    "length_unit",
    "metric_crs",
    "pyproj_or_none",
    "same_crs",
    "short_name",
]

# What is known of geographic systems where pyproj is not installed.
GEOGRAPHIC = "CRS84 CRS83 CRS27 4326 4258 4267 4269 4283 4490 4617 4674 4979 7844".split()
AUTHORITIES = "EPSG|OGC|ESRI|IGNF|IAU_2015"


@runtime_checkable
class SupportsWkt(Protocol):
    """A CRS of another library, such as ``pyproj.CRS`` or ``rasterio.crs.CRS``."""

    def to_wkt(self) -> str:
        """Return the CRS as WKT."""


CRSLike: TypeAlias = "str | SupportsWkt"


def pyproj_or_none() -> Any:
    """Return pyproj, or None where it is not installed."""
    try:
        return importlib.import_module("pyproj")
    except ImportError:
        return None


def crs_text(crs: CRSLike | None, where: str) -> str | None:
    """Return a CRS as "AUTHORITY:CODE", or as WKT if it has no code.

    Args:
        crs: "EPSG:32619" in any case, a URN, WKT, PROJ text, or a CRS object of pyproj or rasterio.
        where: The file or argument that it comes from, for messages.

    Returns:
        Its text; None for None, and for the "undefined" systems of GIS files.

    Raises:
        ValueError: Not a CRS.
    """
    if crs is None:
        return None
    if not isinstance(crs, (str, SupportsWkt)):
        raise InputError(f"{where} is {shown(crs)}; give it as text, such as 'EPSG:32619' or WKT, or as a pyproj.CRS")
    text = " ".join((crs if isinstance(crs, str) else crs.to_wkt()).split())
    if re.match(r'\w+\["Undefined', text, re.IGNORECASE):
        return None
    pyproj = pyproj_or_none()
    try:
        return _normal(text, pyproj)
    except ValueError:
        who = "not a CRS:" if pyproj is None else "pyproj does not know the CRS"
        raise InputError(f'{where}: {who} {short_name(text)!r}; write it like "EPSG:32619", or as WKT') from None


@functools.lru_cache(maxsize=256)
def _normal(text: str, pyproj: Any) -> str:
    """Return the normal form of a CRS, or raise ``ValueError``; without pyproj its form alone is checked."""
    code = re.fullmatch(rf"(?:urn:ogc:def:crs:)?({AUTHORITIES}):(?:[^:]*:)?(\w+)", text, re.IGNORECASE)
    if code:
        text = f"{code[1]}:{code[2]}".upper()
    if pyproj is None:
        if code is None and not re.match(r"\w+:\w+|\w+\[.*\]$|\+\w+", text):
            raise InputError(text)
        return text
    try:
        known = pyproj.CRS.from_user_input(text)
    except pyproj.exceptions.CRSError as error:
        raise InputError(text) from error
    authority = known.to_authority(min_confidence=100)
    return ":".join(authority) if authority else str(known.to_wkt())


def is_geographic(crs: str) -> bool:
    """Tell whether a CRS ("EPSG:4326", WKT ...) is known to be in degrees; without pyproj only the common ones are."""
    if crs.split(":")[-1].upper() in GEOGRAPHIC or crs.startswith(("GEOG", "GEODCRS")):
        return True
    system = _system(crs)
    return system is not None and bool(system.is_geographic)


def length_unit(crs: str) -> tuple[str, float]:
    """Return the name of the unit of x and y in a CRS, and metres in it; metres where nothing is known."""
    system = _system(crs)
    axis = system.axis_info[0] if system is not None and system.axis_info else None
    if axis is not None and axis.unit_conversion_factor > 0.0:
        return axis.unit_name, float(axis.unit_conversion_factor)
    # Local systems of older WKT state their unit without axes.
    stated = re.findall(r'\bUNIT\["([^"]*)",\s*([0-9.eE+-]+)', crs) if crs.startswith("LOCAL_CS") else []
    return (stated[0][0], float(stated[0][1])) if stated else ("metre", 1.0)


def height_unit(crs: str) -> tuple[str, float] | None:
    """Return the name of the unit of heights in a compound CRS, and metres in it; None where it states none."""
    system = _system(crs)
    if system is None or len(system.axis_info) < 3:
        return None
    axis = system.axis_info[2]
    return axis.unit_name, float(axis.unit_conversion_factor)


def metric_crs(crs: CRSLike | None, name: str = "crs") -> str | None:
    """Return the text of a CRS, or raise ``ValueError`` unless x and y in it are metres.

    Args:
        crs: A CRS, or None.
        name: The argument that it comes from, for messages.
    """
    text = crs if isinstance(crs, str) and is_geographic(crs) else crs_text(crs, name)
    if text is None:
        return None
    if is_geographic(text):
        raise InputError(
            f"{name}: {short_name(text)} is longitude and latitude, not metres; read the file with "
            'to_crs="utm", or reproject the coordinates first'
        )
    unit, factor = length_unit(text)
    if abs(factor - 1.0) > 1e-9:
        raise InputError(
            f"{name}: {short_name(text)} is in {unit}, not metres; read the file with "
            'to_crs="utm", or reproject the coordinates first'
        )
    return text


def same_crs(a: str | None, b: str | None) -> bool:
    """Tell whether two CRS, as :func:`crs_text` gives them, are the same."""
    if a == b or a is None or b is None:
        return a == b
    one, other = _system(a), _system(b)
    return one is not None and other is not None and bool(one.equals(other, ignore_axis_order=True))


def short_name(crs: str | None) -> str:
    """Return a CRS for a message."""
    return "no CRS" if crs is None else crs if len(crs) < 40 else f"{crs[:40]}..."


def _system(crs: str) -> Any:
    """Return the ``pyproj.CRS`` of a text, None where pyproj is missing or does not know it."""
    return _made(crs, pyproj_or_none())


@functools.lru_cache(maxsize=64)
def _made(crs: str, pyproj: Any) -> Any:
    if pyproj is None:
        return None
    try:
        return pyproj.CRS(crs)
    except pyproj.exceptions.CRSError:
        return None
