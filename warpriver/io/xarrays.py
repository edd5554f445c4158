"""Terrains as xarray arrays, with cell centres as coordinates and the CRS as CF and rioxarray write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.crs import pyproj_or_none
from warpriver.io.crs import crs_text
from warpriver.io.files import need
from warpriver.io.raster_source import Raster
from warpriver.io.rasters import settled_terrain
from warpriver.terrain import Terrain

__all__ = ["from_xarray", "to_xarray"]

X_NAMES = ("x", "easting", "lon", "longitude")
Y_NAMES = ("y", "northing", "lat", "latitude")
DEGREES = ("lon", "longitude", "lat", "latitude")
# Coordinates may be off an even spacing by this part of a cell, as float32 ones are.
UNEVEN = 0.02


def to_xarray(terrain: Terrain) -> Any:
    """Return a terrain as ``xarray.DataArray`` of dimensions (y, x), row 0 in the north.

    The coordinates are the cells' centres in m; ``spatial_ref`` holds the CRS in the CF convention.
    """
    (xarray,) = need("to_xarray", "xarray")
    (rows, columns), (west, north), size = terrain.shape, terrain.origin, terrain.cell_size
    reference: dict[str, Any] = {}
    pyproj = pyproj_or_none()
    if terrain.crs is not None:
        reference = pyproj.CRS(terrain.crs).to_cf() if pyproj else {}
        reference |= {"spatial_ref": reference.get("crs_wkt", terrain.crs)}
    reference["GeoTransform"] = " ".join(repr(float(v)) for v in (west, size, 0.0, north, 0.0, -size))
    spacing = {"units": "m", "standard_name": "projection_x_coordinate", "axis": "X"}
    y = (
        "y",
        north - (np.arange(rows) + 0.5) * size,
        spacing | {"standard_name": "projection_y_coordinate", "axis": "Y"},
    )
    x = ("x", west + (np.arange(columns) + 0.5) * size, spacing)
    return xarray.DataArray(
        terrain.to_numpy(),
        dims=("y", "x"),
        coords={"y": y, "x": x, "spatial_ref": ((), 0, reference)},
        name="height",
        attrs={"units": "m", "long_name": "height", "grid_mapping": "spatial_ref"},
    )


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
    label = Path(f"array {array.name!r}" if getattr(array, "name", None) else "array")
    if not hasattr(array, "dims") or not hasattr(array, "coords") or not hasattr(array, "dtype"):
        raise ValueError(f"{type(array).__name__} is no xarray.DataArray; pick one variable of a data set")
    array = array.squeeze(drop=True)
    names = {str(d).lower(): d for d in array.dims}
    y, x = (next((names[n] for n in known if n in names), None) for known in (Y_NAMES, X_NAMES))
    if array.ndim != 2 or x is None or y is None:
        raise ValueError(f"{label}: its dimensions are {tuple(array.dims)}; a terrain needs (y, x)")
    array = array.transpose(y, x)
    (west, width), (north, length) = _spacing(array, x, label), _spacing(array, y, label)
    height = np.array(array.values, np.float64)
    fill = array.attrs.get("_FillValue", array.encoding.get("_FillValue"))
    if fill is not None:
        height[height == float(fill)] = np.nan
    degrees = str(x).lower() in DEGREES or str(array[x].attrs.get("units", "")).startswith("degree")
    affine = (width, 0.0, west - 0.5 * width, 0.0, length, north - 0.5 * length)
    raster = Raster(label, height, affine, _stated_crs(array, label), degrees, array.attrs.get("units"))
    return settled_terrain(raster, cell_size=cell_size, crs=crs, to_crs=to_crs, z_factor=z_factor, device=device)


def _spacing(array: Any, name: Any, label: Path) -> tuple[float, float]:
    """First coordinate of a dimension, and the step between cells."""
    if name not in array.coords or array.sizes[name] < 2:
        raise ValueError(f"{label}: the dimension {name!r} needs coordinates, of two cells or more")
    values = np.asarray(array[name].values, np.float64)
    step = (values[-1] - values[0]) / (len(values) - 1)
    if not np.isfinite(values).all() or step == 0.0:
        raise ValueError(f"{label}: the coordinates {name!r} are not finite numbers that differ")
    if np.abs(values - np.linspace(values[0], values[-1], len(values))).max() > UNEVEN * abs(step):
        raise ValueError(
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
