"""GeoTIFF by rasterio."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.io.crs import crs_text
from warpriver.io.files import need
from warpriver.io.raster_source import Raster
from warpriver.terrain import Terrain, require_memory

__all__ = ["TIFF", "read_geotiff", "write_geotiff"]

TIFF = (".tif", ".tiff")


def read_geotiff(path: Path, band: int, nodata: float | None) -> Raster:
    """Read one band; masked cells, and those of the value ``nodata``, become NaN."""
    rasterio, errors = need(f"reading {path.suffix}", "rasterio", "rasterio.errors")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", errors.NotGeoreferencedWarning)
            dataset = rasterio.open(path)
    except errors.RasterioError as error:
        raise ValueError(f"{path}: not a GeoTIFF that rasterio can open ({error})") from error
    with dataset:
        if not 1 <= band <= dataset.count:
            raise ValueError(f"{path}: there is no band {band}; it has 1 to {dataset.count}")
        kind = np.dtype(dataset.dtypes[band - 1])
        if kind.kind not in "iuf":
            raise ValueError(f"{path}: band {band} is {kind}, not heights")
        require_memory(dataset.shape, 18 + kind.itemsize, what=f"{path}: a raster")
        try:
            raw = dataset.read(band, masked=True)
        except errors.RasterioError as error:
            raise ValueError(f"{path}: its cells cannot be read ({error}); is the file whole?") from error
        height = raw.data.astype(np.float64) * dataset.scales[band - 1] + dataset.offsets[band - 1]
        height[np.ma.getmaskarray(raw)] = np.nan
        if nodata is not None:
            height[raw.data == nodata] = np.nan
        affine = None if dataset.transform.is_identity else tuple(dataset.transform)[:6]
        units = dataset.units[band - 1] or dataset.tags(band).get("units") or dataset.tags().get("units")
        return Raster(path, height, affine, _stated_crs(dataset.crs, path), units=units)


def _stated_crs(crs: Any, path: Path) -> str | None:
    """CRS of a dataset as text; a local one, which tells the unit alone, counts as none."""
    if crs is None or not crs.to_wkt() or crs.to_wkt().startswith(("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")):
        return None
    return crs_text(crs, str(path))


def write_geotiff(terrain: Terrain, path: Path) -> None:
    """Write float32 where that keeps every height to the bit, else float64; deflate, nodata NaN, the CRS."""
    rasterio, transform = need(f"writing {path.suffix}", "rasterio", "rasterio.transform")
    height = terrain.to_numpy()
    with np.errstate(over="ignore"):
        single = height.astype(np.float32)
    kept = np.array_equal(single.astype(np.float64), height, equal_nan=True)
    size, (west, north) = terrain.cell_size, terrain.origin
    profile = {
        "driver": "GTiff", "width": terrain.shape[1], "height": terrain.shape[0], "count": 1,
        "dtype": "float32" if kept else "float64", "nodata": math.nan, "compress": "deflate", "tiled": True,
        "transform": transform.from_origin(west, north, size, size), "bigtiff": "if_safer",
    }  # fmt: skip
    if terrain.crs is not None:
        (crs,) = need("writing a CRS", "rasterio.crs")
        profile["crs"] = crs.CRS.from_user_input(terrain.crs)
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(single if kept else height, 1)
        dataset.units = ("m",)
        dataset.update_tags(units="m", AREA_OR_POINT="Area")
