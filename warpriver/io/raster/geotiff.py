"""GeoTIFF, and the rasters of other programs, by rasterio."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.crs import crs_text
from warpriver.device import require_memory
from warpriver.errors import InputError, PathError
from warpriver.extras import need
from warpriver.io.files import filtered_warnings, plain_path
from warpriver.io.raster.source import RasterSource, cells_without_data, with_gaps
from warpriver.raster import Raster

__all__ = ["READABLE", "TIFF", "check_raster", "read_gdal", "write_gdal", "write_geotiff"]

TIFF = (".tif", ".tiff")
# Formats that are read beside GeoTIFF, by the driver of GDAL. No other driver ever opens a file: some, such as VRT,
# read whatever files or addresses their text names.
READABLE = {
    ".dem": "USGSDEM", ".img": "HFA", ".bil": "EHdr", ".flt": "EHdr", ".sdat": "SAGA", ".hgt": "SRTMHGT",
}  # fmt: skip
DRIVERS = dict.fromkeys(TIFF, "GTiff") | READABLE
NAMES = {
    "GTiff": "a GeoTIFF", "USGSDEM": "a USGS DEM", "HFA": "an Erdas Imagine file", "EHdr": "an ESRI .bil or .flt",
    "SAGA": "a SAGA grid", "SRTMHGT": "an SRTM .hgt",
}  # fmt: skip
# Cells a side of the tiles of a GeoTIFF that is written, and rows that are read back at a time.
BLOCK = CHECK_ROWS = 512


def read_gdal(path: Path, band: int, nodata: float | None, *, heights: bool) -> RasterSource:
    """Read one band; masked cells, and those of the value ``nodata``, become NaN; whole numbers may stay whole."""
    rasterio, errors = need(f"reading {path.suffix}", "rasterio", "rasterio.errors")
    with _opened(path, rasterio, errors) as dataset:
        if not 1 <= band <= dataset.count:
            raise InputError(f"{path}: there is no band {band}; it has 1 to {dataset.count}")
        kind = np.dtype(dataset.dtypes[band - 1])
        if kind.kind not in "iuf":
            raise InputError(f"{path}: band {band} is {kind}, not real numbers")
        require_memory(dataset.shape, 18 + kind.itemsize, what=f"{path}: a raster")
        try:
            raw = dataset.read(band, masked=True)
        except errors.RasterioError as error:
            raise InputError(f"{path}: its cells cannot be read ({error}); is the file whole?") from error
        declared = dataset.nodatavals[band - 1] is not None
        gap = cells_without_data(path, raw.data, np.ma.getmaskarray(raw), nodata, declared=declared, heights=heights)
        scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
        plain = scale == 1.0 and offset == 0.0
        values = with_gaps(raw.data if plain else raw.data.astype(np.float64) * scale + offset, gap)
        affine = None if dataset.transform.is_identity else tuple(dataset.transform)[:6]
        units = dataset.units[band - 1] or dataset.tags(band).get("units") or dataset.tags().get("units")
        crs = crs_text(dataset.crs if dataset.crs is not None and dataset.crs.to_wkt() else None, str(path))
        return RasterSource(
            path,
            values,
            affine,
            crs,
            units=units,
            name=dataset.descriptions[band - 1],
            crs_beside=_crs_beside(path),
        )


@contextmanager
def _opened(path: Path, rasterio: Any, errors: Any) -> Iterator[Any]:
    """Open a file by the one driver of its suffix, or raise ``ValueError``."""
    driver = DRIVERS[path.suffix.lower()]
    with plain_path(path) as plain, filtered_warnings("ignore", errors.NotGeoreferencedWarning):
        try:
            dataset = rasterio.open(plain, driver=driver)
        except errors.RasterioError as error:
            why = str(error).replace(str(plain), path.name)
            raise InputError(f"{path}: not {NAMES[driver]} that rasterio can open ({why})") from error
        with dataset:
            yield dataset


def _crs_beside(path: Path) -> bool:
    """Tell whether the CRS that GDAL states comes from a file beside the raster."""
    side = path.with_name(f"{path.name}.aux.xml")
    if side.is_file() and re.search(rb"<SRS\b", side.read_bytes()[:1_000_000]):
        return True
    if path.suffix.lower() in TIFF:
        return False
    return any(os.path.isfile(path.with_suffix(suffix)) for suffix in (".prj", ".PRJ"))


def write_geotiff(raster: Raster, path: Path) -> None:
    """Write whole numbers as they are, others as float32 where that keeps them all to the bit, else as float64.

    The file is a cloud-optimized GeoTIFF: deflated tiles, and overviews (means, of whole numbers nearest cells), with
    the CRS; NaN is the value of no data of what is not whole.
    """
    values = raster.numpy()
    if not raster.is_integer:
        with np.errstate(over="ignore"):
            single = values.astype(np.float32)
        if np.array_equal(single.astype(np.float64), values, equal_nan=True):
            values = single
    options = {
        "compress": "deflate", "blocksize": BLOCK, "bigtiff": "if_safer",
        "overview_resampling": "nearest" if raster.is_integer else "average",
    }  # fmt: skip
    write_gdal(raster, values, path, "COG", None if raster.is_integer else math.nan, **options)


def write_gdal(
    raster: Raster, values: np.ndarray, path: Path, driver: str, nodata: float | None, **options: Any
) -> None:
    """Write a band through GDAL, with the place, CRS, unit and name of a raster.

    Args:
        raster: Whose place it has.
        values: (rows, columns) numbers of a type that the format holds.
        path: File to write.
        driver: GDAL's name of the format.
        nodata: Value that stands for no data.
        options: Of the driver.

    Raises:
        ImportError: rasterio is missing.
        OSError: The file cannot be written.
    """
    rasterio, transform = need(f"writing {path.suffix}", "rasterio", "rasterio.transform")
    size, (west, north) = raster.cell_size, raster.origin
    profile = {
        "driver": driver, "width": raster.shape[1], "height": raster.shape[0], "count": 1,
        "dtype": values.dtype.name, "nodata": nodata, "transform": transform.from_origin(west, north, size, size),
    }  # fmt: skip
    if raster.crs is not None:
        (crs,) = need("writing a CRS", "rasterio.crs")
        profile["crs"] = crs.CRS.from_user_input(raster.crs)
    try:
        with rasterio.open(path.absolute(), "w", **profile, **options) as dataset:
            dataset.write(values, 1)
            if raster.unit:
                dataset.units = (raster.unit,)
                dataset.update_tags(units=raster.unit)
            if raster.name:
                dataset.set_band_description(1, raster.name)
            dataset.update_tags(AREA_OR_POINT="Area")
    except Exception as error:  # at close GDAL's own, of a private class
        raise PathError(f"GDAL cannot write it ({error})") from error


def check_raster(path: Path, raster: Raster) -> None:
    """Raise ``ValueError`` unless a file holds that raster: GDAL does not tell when its last bytes find no room.

    Formats of 32 bits hold it rounded.
    """
    rasterio, windows = need(f"reading {path.suffix}", "rasterio", "rasterio.windows")
    values = raster.numpy()
    with rasterio.open(path.absolute()) as dataset:
        if dataset.shape != values.shape or (dataset.crs is None) != (raster.crs is None):
            raise InputError(f"it has {dataset.shape} cells in place of {values.shape}, or no CRS")
        for row in range(0, values.shape[0], CHECK_ROWS):
            rows = values[row : row + CHECK_ROWS]
            window = windows.Window(0, row, rows.shape[1], len(rows))
            found = dataset.read(1, window=window, masked=not raster.is_integer)
            if not raster.is_integer:
                exact = rows if found.dtype == np.float64 else rows.astype(found.dtype)
                found, rows = found.astype(np.float64).filled(np.nan), exact.astype(np.float64)
            if not np.array_equal(found, rows, equal_nan=not raster.is_integer):
                raise InputError(f"rows {row} to {row + len(rows) - 1} differ")
