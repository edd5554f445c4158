"""Terrains and rasters as xarray arrays: cell centres as coordinates, the CRS as CF and rioxarray write it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpriver.crs import CRSLike, length_unit
from warpriver.errors import InputError
from warpriver.io.raster.settle import settled_raster, settled_terrain
from warpriver.io.raster.source import RasterSource, cells_without_data, with_gaps
from warpriver.io.units import is_degrees, metres_in, names_a_unit
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.sentinels import equal_cells
from warpriver.terrain import Terrain

if TYPE_CHECKING:
    import xarray

__all__ = ["from_xarray", "raster_from_xarray", "to_xarray"]

X_NAMES = ("x", "easting", "lon", "longitude")
Y_NAMES = ("y", "northing", "lat", "latitude")
DEGREES = ("lon", "longitude", "lat", "latitude")
# Coordinates may be off an even spacing by this fraction of a cell, as float32 ones are.
UNEVEN = 0.02


@public
def to_xarray(terrain: Terrain | Raster) -> xarray.DataArray:
    """Return a terrain or a raster as ``xarray.DataArray``, see :meth:`warpriver.raster.Raster.to_xarray`."""
    return (terrain.raster if isinstance(terrain, Terrain) else terrain).to_xarray()


@public
def from_xarray(
    array: xarray.DataArray,
    *,
    cell_size: float | None = None,
    crs: CRSLike | None = None,
    to_crs: CRSLike | None = None,
    z_factor: float | None = None,
    nodata: float | None = None,
    device: wp.DeviceLike = "cpu",
) -> Terrain:
    """Return a terrain from an ``xarray.DataArray`` of dimensions (y, x), (northing, easting) or (lat, lon).

    Rows may run from the north or from the south; coordinates are cell centres, evenly spaced, in metres or in the unit
    that their attribute "units" names. The CRS is looked for where rioxarray and CF put it. Of an array that was read
    with ``mask_and_scale=False``, "_FillValue" and "missing_value" are no data, as is what lies outside of "valid_min",
    "valid_max" or "valid_range", and "scale_factor" and "add_offset" are applied. The rest, such as the unit of the
    heights, is as in ``read_terrain``.

    Args:
        array: Heights; further dimensions of length 1 are dropped.
        cell_size: Length of a cell's side in m to resample to.
        crs: CRS of an array that states none.
        to_crs: CRS to bring it into, "EPSG:...", WKT or "utm".
        z_factor: Metres in the array's unit of height.
        nodata: Value that stands for no data, besides what the array says; NaN: no other.
        device: Warp device name.

    Raises:
        ValueError: Other dimensions, coordinates that are missing or uneven, or whatever ``read_terrain`` refuses.
    """
    source = _source(array, "a terrain", nodata)
    return settled_terrain(source, cell_size=cell_size, crs=crs, to_crs=to_crs, z_factor=z_factor, device=device)


@public
def raster_from_xarray(
    array: xarray.DataArray,
    *,
    cell_size: float | None = None,
    crs: CRSLike | None = None,
    to_crs: CRSLike | None = None,
    nodata: float | None = None,
    device: wp.DeviceLike = "cpu",
) -> Raster:
    """Return a raster from an ``xarray.DataArray``, as :func:`from_xarray` reads it.

    Whole numbers keep their type, unless some are no data. The unit is the attribute "units", the name that of the
    array, or else its "long_name".

    Args:
        array: Values; further dimensions of length 1 are dropped.
        cell_size: Length of a cell's side in m to resample to, which whole numbers are not.
        crs: CRS of an array that states none.
        to_crs: CRS to bring it into, "EPSG:...", WKT or "utm".
        nodata: Value that stands for no data, besides what the array says; NaN: no other.
        device: Warp device name.

    Raises:
        ValueError: Other dimensions, coordinates that are missing or uneven, or whatever ``read_raster`` refuses.
    """
    source = _source(array, "a raster", nodata)
    return settled_raster(source, cell_size=cell_size, crs=crs, to_crs=to_crs, device=device)


def _source(array: Any, what: str, nodata: float | None) -> RasterSource:
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
    crs, degrees = _stated_crs(array), _in_degrees(array, x, y)
    (west, width), (north, length) = (_spacing(array, d, label, crs, degrees) for d in (x, y))
    values = _values(array, label, nodata, heights=what == "a terrain")
    affine = (width, 0.0, west - 0.5 * width, 0.0, length, north - 0.5 * length)
    name = array.name if array.name is not None else array.attrs.get("long_name")
    units = array.attrs.get("units")
    return RasterSource(label, values, affine, crs, degrees, units, None if name is None else str(name))


def _values(array: Any, label: Path, nodata: float | None, *, heights: bool) -> np.ndarray:
    """Return the values of an array, NaN where it says that there are none, scaled as it says."""
    told = array.attrs
    raw = np.array(array.values, None if array.dtype.kind in "iu" else np.float64)
    gap, declared = np.zeros(raw.shape, bool), False
    # What xarray has masked and scaled already stands in the encoding, not in the attributes.
    for key in ("_FillValue", "missing_value"):
        for value in np.atleast_1d(told.get(key, [])):
            gap, declared = gap | equal_cells(raw, float(value)), True
    low, high = told.get("valid_range", (told.get("valid_min"), told.get("valid_max")))
    with np.errstate(invalid="ignore"):
        gap |= (raw < low) if low is not None else False
        gap |= (raw > high) if high is not None else False
    gap = cells_without_data(label, raw, gap, nodata, declared=declared, heights=heights)
    scale, offset = told.get("scale_factor"), told.get("add_offset")
    if scale is not None or offset is not None:
        raw = raw * float(1.0 if scale is None else scale) + float(0.0 if offset is None else offset)
    return with_gaps(raw, gap)


def _in_degrees(array: Any, x: Hashable, y: Hashable) -> bool:
    """Tell whether the coordinates are longitude and latitude by their name or unit."""
    named = any(str(name).lower() in DEGREES for name in (x, y))
    return named or any(is_degrees(str(array[name].attrs.get("units", ""))) for name in (x, y) if name in array.coords)


def _spacing(array: Any, name: Hashable, label: Path, crs: str | None, degrees: bool) -> tuple[float, float]:
    """First coordinate of a dimension, and the step between cells, in the unit of the CRS."""
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
    factor = 1.0 if degrees else _unit_factor(array[name].attrs.get("units"), name, label, crs)
    return factor * float(values[0]), factor * float(step)


def _unit_factor(units: Any, name: Hashable, label: Path, crs: str | None) -> float:
    """Return what brings coordinates into the unit of the CRS, or into metres without one."""
    if not names_a_unit(None if units is None else str(units)):
        return 1.0
    metres = metres_in(str(units))
    if metres is None:
        raise InputError(
            f"{label}: the coordinates {name!r} are in {units!r}, which is not known as a unit of length; give them "
            "in metres"
        )
    return metres / (1.0 if crs is None else length_unit(crs)[1])


def _stated_crs(array: Any) -> str | None:
    """CRS of an array as rioxarray, CF or older GIS readers write it."""
    mapping = array.attrs.get("grid_mapping", array.encoding.get("grid_mapping", "spatial_ref"))
    places: Sequence[Any] = [array.coords[mapping].attrs] if mapping in array.coords else []
    for attributes in (*places, array.attrs):
        for key in ("crs_wkt", "spatial_ref", "crs"):
            if attributes.get(key):
                return str(attributes[key])
    return None
