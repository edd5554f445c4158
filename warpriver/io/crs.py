"""Coordinate reference systems: what a file states, whether it is metric, and bringing files into one system."""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.crs import CRSLike, crs_text, is_geographic, length_unit, pyproj_or_none, same_crs, short_name
from warpriver.errors import InputError, warn
from warpriver.extras import need
from warpriver.io.vector.source import Line, Source

__all__ = ["full_turn", "one_crs", "reproject", "settled_crs", "within_degrees"]

log = logging.getLogger("warpriver")

MERCATOR_RADIUS = 6378137.0  # m, the sphere of EPSG:3857

# Lengths in a projection may differ from those on the ground by this fraction: first a warning, then a refusal.
SCALE_WARN = 0.01
SCALE_REFUSE = 0.05
# How WKT begins for systems of a building site or a laboratory, which state a unit and no place on Earth.
LOCAL = ("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")


def within_degrees(lines: list[Line], east: float = 180.0) -> bool:
    """Tell whether all points could be longitude and latitude; ``east`` is 360 where longitudes may run to that."""
    return all(((line.xy >= (-180.0, -90.0)) & (line.xy <= (east, 90.0))).all() for line in lines)


def full_turn(crs: str | None) -> float | None:
    """Return what a full turn of longitude is in the unit of a geographic CRS, 360 in degrees; None for others."""
    if crs is None or not is_geographic(crs):
        return None
    unit = length_unit(crs)[1]  # radians
    return 360.0 if unit == 1.0 else math.tau / unit


def settled_crs(source: Source, stated: CRSLike | None) -> tuple[str | None, float]:
    """Return the CRS of a file from what it says and what the caller says, and metres in its unit of length.

    The second is 1 but for local systems, which state a unit and no place on Earth and count as no CRS.
    """
    said = crs_text(stated, "crs=")
    overruled = said is not None and source.crs_beside
    known = None if overruled else crs_text(source.crs, str(source.path))
    if overruled and source.crs is not None:
        log.info("%s: crs= overrules the file beside it", source.path)
    if known is not None and known.startswith(LOCAL):
        if said is not None:
            return said, 1.0
        unit, factor = length_unit(known)
        if abs(factor - 1.0) > 1e-9:
            warn(
                f"{source.path}: its coordinates are in {unit!r} of a local system; they were multiplied by "
                f"{factor:.10g} to be metres"
            )
        return None, factor
    if known is not None and said is not None and not same_crs(known, said):
        raise InputError(
            f"{source.path}: the file is in {short_name(known)} but crs= says {short_name(said)}; "
            "leave crs= out, or use to_crs= to reproject"
        )
    found = known or said
    if not source.lonlat:
        return found, 1.0
    if found is not None and not is_geographic(found):
        raise InputError(
            f"{source.path}: its coordinates are longitude and latitude by format or name, but its CRS is "
            f"said to be {short_name(found)}; correct one of them"
        )
    return found or "EPSG:4326", 1.0


def one_crs(sources: list[Source]) -> str | None:
    """Return the CRS that all files share, or raise ``ValueError`` if they differ or it is not metric."""
    first = sources[0]
    for source in sources[1:]:
        if not same_crs(first.crs, source.crs):
            raise InputError(
                f"{first.path} is in {short_name(first.crs)} and {source.path} in "
                f"{short_name(source.crs)}; pass to_crs= to bring them together, or read them one by one"
            )
    for source in sources:
        _check_metric(source.path, source.crs, source.lines)
    return first.crs


def reproject(sources: list[Source], to_crs: CRSLike) -> str:
    """Bring the lines of all files into one CRS and return it."""
    (pyproj,) = need("to_crs", "pyproj")
    for source in sources:
        if source.crs is None:
            raise InputError(f"{source.path}: the file states no CRS to reproject from; pass it as crs=")
    zone = isinstance(to_crs, str) and to_crs.strip().lower() == "utm"
    target = _utm_zone(pyproj, sources) if zone else crs_text(to_crs, "to_crs=")
    if target is None:
        raise InputError(f'to_crs= is {short_name(str(to_crs))!r}, an undefined CRS; write it like "EPSG:32619"')
    for source in sources:
        if not same_crs(source.crs, target):
            xy = _transformed(pyproj, source, target)
            parts = np.split(xy, np.cumsum([len(line.xy) for line in source.lines])[:-1])
            for line, part in zip(source.lines, parts, strict=True):
                line.xy = part
            source.origin, source.node_xy = None, {}
            log.info("%s: reprojected from %s to %s", source.path, source.crs, target)
        _check_metric(source.path, target, source.lines)
    return target


def _transformed(pyproj: Any, source: Source, target: str) -> np.ndarray:
    """Return all points of a file in another CRS, or raise ``ValueError`` where that is impossible."""
    change = pyproj.Transformer.from_crs(source.crs, target, always_xy=True)
    xy = np.stack(change.transform(*_packed(source.lines).T), axis=1)
    if not np.isfinite(xy).all():
        raise InputError(
            f"{source.path}: {int((~np.isfinite(xy)).any(axis=1).sum())} points cannot be brought from "
            f"{short_name(source.crs)} to {short_name(target)}; is the CRS of the file right?"
        )
    return xy


def _utm_zone(pyproj: Any, sources: list[Source]) -> str:
    """Return the WGS 84 / UTM zone of the mean point of all files."""
    lon, lat = np.radians(np.concatenate([_transformed(pyproj, s, "EPSG:4326") for s in sources])).T
    # A mean of directions, so that lines on both sides of the 180th meridian have their mean there.
    middle = math.degrees(math.atan2(np.sin(lon).mean(), np.cos(lon).mean()))
    height = math.degrees(lat.mean())
    if not -80.0 <= height <= 84.0:
        raise InputError(f"UTM has no zone at {height:.4g} degrees of latitude; name a polar CRS as to_crs=")
    zone = int((middle + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{32600 + zone if height >= 0.0 else 32700 + zone}"


def _check_metric(path: Path, crs: str | None, lines: list[Line]) -> None:
    """Raise ``ValueError`` unless x and y in this CRS are metres on the ground."""
    if crs is None:
        return
    advice = 'pass to_crs="utm" or to_crs="EPSG:..."'
    if is_geographic(crs):
        raise InputError(f"{path}: {short_name(crs)} is longitude and latitude, not metres; {advice}")
    unit, factor = length_unit(crs)
    if abs(factor - 1.0) > 1e-9:
        raise InputError(f"{path}: {short_name(crs)} is in {unit}, not metres; {advice}")
    mean = _packed(lines).mean(axis=0)
    pyproj, scale = pyproj_or_none(), 1.0
    if pyproj is not None:
        system = pyproj.CRS(crs)
        if system.is_projected:
            scale = _ground_scale(pyproj, system, mean)
    elif crs == "EPSG:3857":
        scale = math.cosh(mean[1] / MERCATOR_RADIUS)
    off = abs(scale - 1.0)
    if not off > SCALE_WARN:
        return
    text = f"{path}: lengths in {short_name(crs)} are {scale:.3g} times those on the ground there"
    if off > SCALE_REFUSE:
        raise InputError(f"{text}; {advice}")
    warn(f"{text}; to_crs= would correct them")


def _ground_scale(pyproj: Any, system: Any, xy: np.ndarray) -> float:
    """Return length in a projection over length on the ground, the worse of two directions; NaN outside."""
    to_degrees = pyproj.Transformer.from_crs(system, system.geodetic_crs, always_xy=True)
    step = 100.0
    scales = []
    for dx, dy in ((step, 0.0), (0.0, step)):
        lon, lat = to_degrees.transform(xy[0] + np.array([-dx, dx]), xy[1] + np.array([-dy, dy]))
        if not np.isfinite([lon, lat]).all():
            return math.nan
        ground = system.get_geod().inv(lon[0], lat[0], lon[1], lat[1])[2]
        scales.append(2.0 * step / ground if ground > 0.0 else math.nan)
    return scales[int(np.abs(np.array(scales) - 1.0).argmax())]


def _packed(lines: list[Line]) -> np.ndarray:
    """Return the points of all lines end to end."""
    return np.concatenate([line.xy for line in lines])
