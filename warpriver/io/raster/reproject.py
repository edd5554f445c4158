"""Rasters in another CRS, or turned: values looked up where the new cells' centres lie in the old raster."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from warpriver.crs import short_name
from warpriver.device import require_memory
from warpriver.errors import InputError, warn
from warpriver.extras import need
from warpriver.io.crs import full_turn
from warpriver.io.raster.source import RasterSource, north_up
from warpriver.raster import Raster

__all__ = ["warp"]

# Points along each side of a raster whose places in another CRS tell its extent there; points looked up at a time.
OUTLINE, STRIP = 33, 1_000_000
# So many cells are looked for in the new raster; where more than this fraction of them is not there, that is told.
PROBES, LOST = 4096, 0.25


def warp(raster: RasterSource, target: str) -> RasterSource:
    """Return a raster on north-up square cells in another CRS, its values as by ``Raster.sample``.

    Exact on planes, as the filters of GDAL's warper are not where cells shrink or turn: there slopes of 0.2 came out
    0.008 off. A cell in the middle keeps its area. Longitudes are those nearest to the middle of the raster, so that
    one across the 180th meridian, or from 0 to 360 degrees, stays whole.
    """
    (pyproj,) = need("to_crs", "pyproj")
    there = pyproj.Transformer.from_crs(raster.crs, target, always_xy=True)
    back = pyproj.Transformer.from_crs(target, raster.crs, always_xy=True)
    rows, columns = raster.values.shape

    def moved(columns_at: np.ndarray, rows_at: np.ndarray) -> np.ndarray:
        return np.stack(there.transform(*raster.points(columns_at, rows_at).T), axis=1)

    corners = moved(0.5 * columns + np.array([-0.5, 0.5, -0.5]), 0.5 * rows + np.array([-0.5, -0.5, 0.5]))
    side, ends = np.linspace(0.0, 1.0, OUTLINE), np.repeat([0.0, 1.0], OUTLINE)
    outline = moved(columns * np.concatenate([side, side, ends]), rows * np.concatenate([ends, side, side]))
    if not np.isfinite(corners).all() or not np.isfinite(outline).all():
        raise InputError(f"{raster.path}: a part of it cannot be brought into the CRS {target[:40]}; crop it first")
    (ax, ay), (bx, by) = corners[1:] - corners[0]
    size = math.sqrt(abs(ax * by - ay * bx))
    (west, south), (east, north) = outline.min(axis=0), outline.max(axis=0)
    # A hair less, so that rounding adds no row without data.
    shape = (max(2, math.ceil((north - south) / size - 1e-6)), max(2, math.ceil((east - west) / size - 1e-6)))
    require_memory(shape, 18, what=f"{raster.path}: the reprojected raster")
    # The old raster with its cells as units: x counts columns, -y rows.
    old, to_cells = Raster(raster.values, 1.0), raster.to_cells()
    turn = full_turn(raster.crs)
    middle = float(raster.points(np.array([0.5 * columns]), np.array([0.5 * rows]))[0, 0])
    values = np.empty(shape)
    x = west + (np.arange(shape[1]) + 0.5) * size
    for first in range(0, shape[0], max(1, STRIP // shape[1])):
        strip = values[first : first + max(1, STRIP // shape[1])]
        y = north - (first + np.arange(len(strip)) + 0.5) * size
        there_x, there_y = back.transform(*(a.ravel() for a in np.meshgrid(x, y)))
        if turn is not None:
            there_x = middle + np.remainder(there_x - middle + 0.5 * turn, turn) - 0.5 * turn
        at = to_cells(there_x, there_y)
        strip[:] = old.sample(at * (1.0, -1.0)).reshape(strip.shape)
    if old.is_integer and not np.isnan(values).any():
        values = values.astype(old.dtype)
    affine = north_up(float(west), float(north), size, size)
    made = dataclasses.replace(raster, values=values, affine=affine, crs=target, lonlat=False)
    _tell_losses(raster, made, moved)
    return made


def _tell_losses(old: RasterSource, new: RasterSource, moved: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
    """Warn where cells with data are not found in the new raster; ``moved`` brings columns and rows to points there."""
    known = np.flatnonzero(np.isfinite(old.values))
    probes = known[np.linspace(0, len(known) - 1, min(PROBES, len(known))).astype(np.int64)]
    row, column = np.divmod(probes, old.values.shape[1])
    at = np.floor(new.to_cells()(*moved(column + 0.5, row + 0.5).T)).astype(np.int64)
    inside = ((at >= 0) & (at < new.values.shape[::-1])).all(axis=1)
    found = np.zeros(len(at), bool)
    found[inside] = np.isfinite(new.values[at[inside, 1], at[inside, 0]])
    lost = 1.0 - found.mean() if len(found) else 0.0
    if lost > LOST:
        warn(
            f"{old.path}: {100.0 * lost:.0f} % of its cells with data come out empty in {short_name(new.crs)}; is "
            "that CRS meant for where they lie?"
        )
