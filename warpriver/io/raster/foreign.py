"""Rasters in the formats of other programs: SAGA grids, ESRI band files, Erdas Imagine, written by GDAL."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from warpriver.errors import InputError, warn
from warpriver.io.raster.geotiff import write_gdal
from warpriver.raster import Raster

__all__ = ["FOREIGN", "Format", "write_foreign"]

# What stands for no data: the first that no cell has.
NO_DATA = (-9999.0, -99999.0, -1e30)


class Format(NamedTuple):
    """A format of GDAL.

    Attributes:
        driver: GDAL's name of it.
        parts: Suffixes of the further files that belong to it, in place of its own.
        kinds: NumPy's names of the numbers that it holds.
    """

    driver: str
    parts: tuple[str, ...]
    kinds: tuple[str, ...]


_WHOLE = ("uint8", "int16", "uint16", "int32", "uint32")
FOREIGN = {
    ".sdat": Format("SAGA", (".sgrd", ".mgrd", ".prj", ".sdat.aux.xml"), (*_WHOLE, "float32", "float64")),
    ".bil": Format("EHdr", (".hdr", ".prj", ".stx", ".clr", ".bil.aux.xml"), (*_WHOLE, "float32")),
    ".img": Format("HFA", (".ige", ".rrd", ".img.aux.xml"), ("int8", *_WHOLE, "float32", "float64")),
}


def write_foreign(raster: Raster, path: Path, told: Path) -> None:
    """Write a raster in the format of a suffix of :data:`FOREIGN`.

    Whole numbers have the narrowest type of the format that holds them; where it has a value of no data for them all
    the same, it is one that no cell has.

    Args:
        raster: What to write.
        path: File to write.
        told: What to call it in messages.

    Raises:
        ImportError: rasterio is missing.
        OSError: The file cannot be written.
        ValueError: Whole numbers that no type of the format holds.
    """
    form = FOREIGN[path.suffix.lower()]
    if raster.is_integer:
        values = _whole_values(raster.numpy(), form, told)
        # A SAGA grid always has one, and GDAL would take 255 for bytes.
        nodata = _absent(values, _limits(values.dtype), told) if form.driver == "SAGA" else None
    else:
        values = _real_values(raster.numpy(), form, told)
        nodata = _absent(values, NO_DATA, told)
        values[np.isnan(values)] = nodata
    write_gdal(raster, values, path, form.driver, nodata)


def _whole_values(values: np.ndarray, form: Format, told: Path) -> np.ndarray:
    """Return whole numbers in their type, or the first of the format that holds them."""
    if values.dtype.name in form.kinds:
        return values
    low, high = int(values.min()), int(values.max())
    for kind in form.kinds:
        if np.dtype(kind).kind in "iu" and np.iinfo(kind).min <= low and high <= np.iinfo(kind).max:
            return values.astype(kind)
    raise InputError(f"{told}: whole numbers up to {high} do not fit into 32 bits; write .tif or .npz")


def _real_values(values: np.ndarray, form: Format, told: Path) -> np.ndarray:
    """Return numbers as float32 where the format holds no others or nothing is lost, else as float64."""
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    if np.array_equal(single.astype(np.float64), values, equal_nan=True):
        return single
    if "float64" in form.kinds:
        return values
    off = float(np.nanmax(np.abs(single - values)))
    if not np.isfinite(off):
        raise InputError(f"{told}: numbers up to {np.nanmax(np.abs(values)):.4g} do not fit into 32 bits; write .tif")
    warn(f"{told}: {told.suffix} holds numbers of 32 bits: they are rounded, by up to {off:.2g}; .tif keeps all digits")
    return single


def _limits(dtype: np.dtype) -> tuple[float, ...]:
    """Return values that may stand for no data among whole numbers."""
    return float(np.iinfo(dtype).min), float(np.iinfo(dtype).max)


def _absent(values: np.ndarray, candidates: tuple[float, ...], told: Path) -> float:
    """Return the first of some values that no cell has."""
    for value in candidates:
        if not (values == values.dtype.type(value)).any():
            return value
    raise InputError(f"{told}: cells have all values that could stand for no data; write .tif")
