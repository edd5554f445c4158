"""Terrains and rasters as xarray arrays: cell centres as coordinates, the CRS as CF and rioxarray write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.io.crs import crs_text
from warpriver.io.raster.source import RasterSource, with_gaps
from warpriver.io.raster.terrains import settled_raster, settled_terrain
from warpriver.raster import Raster
from warpriver.terrain import Terrain

__all__ = ["from_xarray", "raster_from_xarray", "to_xarray"]

X_NAMES = ("x", "easting", "lon", "longitude")
Y_NAMES = ("y", "northing", "lat", "latitude")
DEGREES = ("lon", "longitude", "lat", "latitude")
# Coordinates may be off an even spacing by this part of a cell, as float32 ones are.
UNEVEN = 0.02


def to_xarray(terrain: Terrain | Raster) -> Any:
    """Return a terrain or a raster as ``xarray.DataArray``, see :meth:`warpriver.raster.Raster.to_xarray`."""
    return (terrain.raster if isinstance(terrain, Terrain) else terrain).to_xarray()


def from_xarray(
    array: Any,
    *,
    cell_size: float | None = None,
    crs: str | None = None,
    to_crs: str | None = None,
    z_factor: float | None = None,
    device: Any = "cpu",
) -> Terrain:
    """Return a terrain from an ``xarray.DataArray`` of dimensions (y, x), (northing, easting) or (lat, lon).

    Rows may run from the north or from the south; coordinates are cell centres, evenly spaced. The CRS is looked for
    where rioxarray and CF put it, "_FillValue" is no data; the rest is as in ``read_terrain``.

    Args:
        array: Heights; further dimensions of length 1 are dropped.
        cell_size: Length of a cell's side in m to resample to.
        crs: CRS of an array that states none.
        to_crs: CRS to bring it into, "EPSG:...", WKT or "utm".
        z_factor: Metres in the array's unit of height.
        device: Warp device name.

    Raises:
        ValueError: Other dimensions, coordinates that are missing or uneven, or whatever ``read_terrain`` refuses.
    """
    source = _source(array, "a terrain")
    return settled_terrain(source, cell_size=cell_size, crs=crs, to_crs=to_crs, z_factor=z_factor, device=device)


def raster_from_xarray(
    array: Any,
    *,
    cell_size: float | None = None,
    crs: str | None = None,
    to_crs: str | None = None,
    device: Any = "cpu",
) -> Raster:
    """Return a raster from an ``xarray.DataArray``, as :func:`from_xarray` reads it.

    Whole numbers keep their type, unless some are no data. The unit is the attribute "units", the name that of the
    array, or else its "long_name".

    Args:
        array: Values; further dimensions of length 1 are dropped.
        cell_size: Length of a cell's side in m to resample to, which whole numbers are not.
        crs: CRS of an array that states none.
        to_crs: CRS to bring it into, "EPSG:...", WKT or "utm".
        device: Warp device name.

    Raises:
        ValueError: Other dimensions, coordinates that are missing or uneven, or whatever ``read_raster`` refuses.
    """
    source = _source(array, "a raster")
    return settled_raster(source, cell_size=cell_size, crs=crs, to_crs=to_crs, device=device)


def _source(array: Any, what: str) -> RasterSource:
    """Return what an array says; ``what`` is to become of it, for messages."""
    label = Path(f"array {array.name!r}" if getattr(array, "name", None) else "array")
    if not hasattr(array, "dims") or not hasattr(array, "coords") or not hasattr(array, "dtype"):
        raise InputError(f"{type(array).__name__} is no xarray.DataArray; pick one variable of a data set")
    array = array.squeeze(drop=True)
    names = {str(d).lower(): d for d in array.dims}
    y, x = (next((names[n] for n in known if n in names), None) for known in (Y_NAMES, X_NAMES))
    if array.ndim != 2 or x is None or y is None:
        raise InputError(f"{label}: its dimensions are {tuple(array.dims)}; {what} needs (y, x)")
    array = array.transpose(y, x)
    (west, width), (north, length) = _spacing(array, x, label), _spacing(array, y, label)
    values = np.array(array.values, None if array.dtype.kind in "iu" else np.float64)
    fill = array.attrs.get("_FillValue", array.encoding.get("_FillValue"))
    gap = np.zeros(values.shape, bool) if fill is None else values == float(fill)
    degrees = str(x).lower() in DEGREES or str(array[x].attrs.get("units", "")).startswith("degree")
    affine = (width, 0.0, west - 0.5 * width, 0.0, length, north - 0.5 * length)
    crs, units = _stated_crs(array, label), array.attrs.get("units")
    name = array.name if array.name is not None else array.attrs.get("long_name")
    return RasterSource(label, with_gaps(values, gap), affine, crs, degrees, units, None if name is None else str(name))


def _spacing(array: Any, name: Any, label: Path) -> tuple[float, float]:
    """First coordinate of a dimension, and the step between cells."""
    if name not in array.coords or array.sizes[name] < 2:
        raise InputError(f"{label}: the dimension {name!r} needs coordinates, of two cells or more")
    values = np.asarray(array[name].values, np.float64)
    step = (values[-1] - values[0]) / (len(values) - 1)
    if not np.isfinite(values).all() or step == 0.0:
        raise InputError(f"{label}: the coordinates {name!r} are not finite numbers that differ")
    if np.abs(values - np.linspace(values[0], values[-1], len(values))).max() > UNEVEN * abs(step):
        raise InputError(
            f"{label}: the coordinates {name!r} are unevenly spaced; interpolate the array to an even grid"
        )
    return float(values[0]), float(step)


def _stated_crs(array: Any, label: Path) -> str | None:
    """CRS of an array as rioxarray, CF or older GIS readers write it."""
    mapping = array.attrs.get("grid_mapping", array.encoding.get("grid_mapping", "spatial_ref"))
    places: Sequence[Any] = [array.coords[mapping].attrs] if mapping in array.coords else []
    for attributes in (*places, array.attrs):
        for key in ("crs_wkt", "spatial_ref", "crs"):
            if attributes.get(key):
                return crs_text(attributes[key], str(label))
    return None
