"""What files say of rasters brought to what the library needs: metres, square cells, north up."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

import numpy as np
import warp as wp

from warpriver.crs import CRSLike, crs_text, height_unit
from warpriver.errors import InputError, warn
from warpriver.io.crs import one_crs, reproject, settled_crs, within_degrees
from warpriver.io.raster.reproject import warp
from warpriver.io.raster.source import RasterSource, north_up
from warpriver.io.units import metres_in, names_a_unit
from warpriver.io.vector.source import Line, Source
from warpriver.raster import Raster
from warpriver.terrain import NAME, UNIT, Terrain, square_cells
from warpriver.validate import finite_numbers, positive

__all__ = ["settled_raster", "settled_terrain"]

log = logging.getLogger("warpriver")

# Cells count as square while their sides, added up over the raster, differ by less than this fraction of a cell; from
# the smaller fraction on that is told.
SQUARE, NEARLY = 0.5, 0.01
# No ground on Earth lies lower or higher, m.
DEEPEST, HIGHEST = -12000.0, 9000.0
# A cell longer than this cannot be told from metres when nothing says that it is in degrees.
LONGEST_DEGREES = 0.1


def settled_terrain(
    source: RasterSource,
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: CRSLike | None = None,
    to_crs: CRSLike | None = None,
    z_factor: float | None = None,
    device: wp.DeviceLike = "cpu",
) -> Terrain:
    """Make a terrain of what a file says and what the caller says: metres, square cells, north up."""
    _place(source, cell_size, origin)
    _scale_heights(source, crs, z_factor)
    source, size = _settled(source, cell_size, crs, to_crs)
    try:
        heights = Raster(source.values, size, source.corner, source.crs, UNIT, NAME, device=device)
        return Terrain.from_raster(heights)
    except ValueError as error:
        raise InputError(f"{source.path}: {error}") from error


def settled_raster(
    source: RasterSource,
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: CRSLike | None = None,
    to_crs: CRSLike | None = None,
    device: wp.DeviceLike = "cpu",
) -> Raster:
    """Make a raster of what a file says and what the caller says: metres, square cells, north up."""
    _place(source, cell_size, origin)
    source, size = _settled(source, cell_size, crs, to_crs)
    told = (source.units or "", source.name or "")
    try:
        return Raster(source.values, size, source.corner, source.crs, *told, device=device)
    except ValueError as error:
        raise InputError(f"{source.path}: {error}") from error


def _settled(
    source: RasterSource, cell_size: float | None, crs: CRSLike | None, to_crs: CRSLike | None
) -> tuple[RasterSource, float]:
    """Return the cells of a file in a metric CRS, north up and square, and their size."""
    source.crs, factor = settled_crs(_outline(source, source.crs), crs)
    source.scale_place(factor)
    if source.crs is None and to_crs is None:
        _check_degrees(source)
    if to_crs is not None:
        outline = _outline(source, source.crs)
        target = reproject([outline], to_crs)
        same = np.array_equal(outline.lines[0].xy, _outline(source, None).lines[0].xy)
        if not same or source.is_turned():
            source = warp(source, target)
        source.crs = target
    else:
        one_crs([_outline(source, source.crs)])
    if source.is_turned():
        raise InputError(
            f'{source.path}: its rows do not run east; pass to_crs= (its own CRS or "utm") to have it turned'
        )
    source.put_north_up()
    return source, _square(source, cell_size)


def _place(source: RasterSource, cell_size: float | None, origin: Sequence[float] | None) -> None:
    """Give cells their place from the arguments where the file does not tell it."""
    if cell_size is not None:
        positive(cell_size, "cell_size", "m")
    west, north = (0.0, 0.0) if origin is None else finite_numbers(origin, 2, "origin")
    if source.affine is None:
        if cell_size is None:
            raise InputError(f"{source.path}: the file does not tell the size of its cells; pass cell_size= in m")
        source.affine = north_up(west, north, cell_size, cell_size)
    elif origin is not None:
        if not source.place_beside:
            raise InputError(f"{source.path}: the file tells its origin; leave origin= out")
        source.affine = north_up(west, north, *source.cell)
    if not np.isfinite(source.corner).all() or not min(source.cell) > 0.0:
        raise InputError(f"{source.path}: its cell size or origin is not a number: {source.affine}")


def _scale_heights(source: RasterSource, crs: CRSLike | None, z_factor: float | None) -> None:
    """Scale the heights to metres; warn of values that no ground has."""
    source.values = np.asarray(source.values, np.float64)
    unit, factor = _height_unit(source, crs)
    if z_factor is not None:
        source.values = source.values * positive(z_factor, "z_factor", hint=", 0.3048 for feet")
    elif factor is None:
        raise InputError(
            f"{source.path}: its heights are in {unit!r}, which is not known as a unit of length; pass z_factor= "
            "(metres in it)"
        )
    elif abs(factor - 1.0) > 1e-9:
        source.values = source.values * factor
        warn(
            f"{source.path}: its heights are in {unit!r}; they were multiplied by {factor:.10g} to be metres. Pass "
            "z_factor= if that is wrong"
        )
    _tell_extremes(source, told=z_factor is not None or names_a_unit(source.units))


def _height_unit(source: RasterSource, crs: CRSLike | None) -> tuple[str, float | None]:
    """Return the unit of the heights and metres in it, None if it is not known; metres if nothing is said."""
    if names_a_unit(source.units):
        return str(source.units), metres_in(str(source.units))
    overruled = crs is not None and (source.crs is None or source.crs_beside)
    known = crs_text(crs, "crs=") if overruled else crs_text(source.crs, str(source.path))
    return (height_unit(known) if known is not None else None) or ("metre", 1.0)


def _tell_extremes(source: RasterSource, *, told: bool) -> None:
    """Warn of heights that no ground on Earth has; ``told``: somebody says what their unit is."""
    with np.errstate(invalid="ignore"):
        low, high = source.values < DEEPEST, source.values > HIGHEST
    text = ""
    if low.any():
        text = (
            f"{int(low.sum())} heights are as low as {source.values[low].min():g} m; if that stands for no data, pass "
        )
        text += "nodata="
    elif high.any() and not told:
        text = f"heights are up to {source.values[high].max():g} m; if they are in feet, pass z_factor=0.3048"
    if text:
        warn(f"{source.path}: {text}")


def _outline(source: RasterSource, crs: str | None) -> Source:
    """The corners of the cells, as the checks of coordinates want them."""
    rows, columns = source.values.shape
    corners = source.points(columns * np.array([0.0, 1.0, 1.0, 0.0]), rows * np.array([0.0, 0.0, 1.0, 1.0]))
    return Source(source.path, [Line(corners, str(source.path))], crs, source.lonlat, crs_beside=source.crs_beside)


def _check_degrees(source: RasterSource) -> None:
    """Raise ``ValueError`` where coordinates without a CRS can only be degrees."""
    if max(source.cell) < LONGEST_DEGREES and within_degrees(_outline(source, None).lines, 360.0):
        raise InputError(
            f"{source.path}: cells of {source.cell[0]:.4g} within 360 and 90 look like longitude and latitude and no "
            'CRS is stated; pass crs="EPSG:4326" and to_crs="utm"'
        )


def _square(source: RasterSource, cell_size: float | None) -> float:
    """Resample a raster to square cells of the requested size, where it is not that already; return the size."""
    width, length = source.cell
    rows, columns = source.values.shape
    drift = abs(width - length) * max(rows, columns) / min(width, length)
    size = math.sqrt(width * length) if width != length else width
    if drift < SQUARE and (cell_size is None or abs(cell_size - size) * max(rows, columns) < NEARLY * size):
        if drift > NEARLY:
            warn(
                f"{source.path}: cells of {width:.6g} x {length:.6g} m are taken as {size:.6g} m square, off by "
                f"{drift:.2g} of a cell over the raster"
            )
        return size
    if cell_size is None:
        raise InputError(
            f"{source.path}: its cells are {width:.6g} x {length:.6g} m, not square; pass "
            f"cell_size={min(width, length):.6g}, or another size in m, to have it resampled"
        )
    if source.values.dtype.kind != "f":
        raise InputError(f"{source.path}: its whole numbers are not resampled; leave cell_size= out")
    log.info("%s: resampled from %g x %g m to %g m", source.path, width, length, cell_size)
    source.values = square_cells(source.values, width, length, cell_size)
    return float(cell_size)
