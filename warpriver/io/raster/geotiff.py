"""GeoTIFF by rasterio."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.device import require_memory
from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.io.crs import crs_text
from warpriver.io.files import filtered_warnings
from warpriver.io.raster.source import RasterSource, with_gaps
from warpriver.raster import Raster

__all__ = ["TIFF", "read_geotiff", "write_geotiff"]

TIFF = (".tif", ".tiff")


def read_geotiff(path: Path, band: int, nodata: float | None) -> RasterSource:
    """Read one band; masked cells, and those of the value ``nodata``, become NaN; whole numbers may stay whole."""
    rasterio, errors = need(f"reading {path.suffix}", "rasterio", "rasterio.errors")
    try:
        with filtered_warnings("ignore", errors.NotGeoreferencedWarning):
            dataset = rasterio.open(path)
    except errors.RasterioError as error:
        raise InputError(f"{path}: not a GeoTIFF that rasterio can open ({error})") from error
    with dataset:
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
        gap = np.ma.getmaskarray(raw)
        if nodata is not None:
            gap = gap | (raw.data == nodata)
        scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
        plain = scale == 1.0 and offset == 0.0
        values = with_gaps(raw.data if plain else raw.data.astype(np.float64) * scale + offset, gap)
        affine = None if dataset.transform.is_identity else tuple(dataset.transform)[:6]
        units = dataset.units[band - 1] or dataset.tags(band).get("units") or dataset.tags().get("units")
        name = dataset.descriptions[band - 1]
        return RasterSource(path, values, affine, _stated_crs(dataset.crs, path), units=units, name=name)


def _stated_crs(crs: Any, path: Path) -> str | None:
    """CRS of a dataset as text; a local one, which tells the unit alone, counts as none."""
    if crs is None or not crs.to_wkt() or crs.to_wkt().startswith(("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")):
        return None
    return crs_text(crs, str(path))


def write_geotiff(raster: Raster, path: Path) -> None:
    """Write whole numbers as they are, others as float32 where that keeps them all to the bit, else as float64.

    Deflated, with the CRS; NaN is the value of no data of the latter.
    """
    rasterio, transform = need(f"writing {path.suffix}", "rasterio", "rasterio.transform")
    values = raster.numpy()
    if not raster.is_integer:
        with np.errstate(over="ignore"):
            single = values.astype(np.float32)
        if np.array_equal(single.astype(np.float64), values, equal_nan=True):
            values = single
    size, (west, north) = raster.cell_size, raster.origin
    profile = {
        "driver": "GTiff", "width": raster.shape[1], "height": raster.shape[0], "count": 1,
        "dtype": values.dtype.name, "nodata": None if raster.is_integer else math.nan, "compress": "deflate",
        "tiled": True, "transform": transform.from_origin(west, north, size, size), "bigtiff": "if_safer",
    }  # fmt: skip
    if raster.crs is not None:
        (crs,) = need("writing a CRS", "rasterio.crs")
        profile["crs"] = crs.CRS.from_user_input(raster.crs)
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(values, 1)
        if raster.unit:
            dataset.units = (raster.unit,)
            dataset.update_tags(units=raster.unit)
        if raster.name:
            dataset.set_band_description(1, raster.name)
        dataset.update_tags(AREA_OR_POINT="Area")
