"""Terrains from and to files: the suffix names the format; what is read becomes metres on square cells, north up."""

from __future__ import annotations

import importlib.util
import logging
import math
import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.io.crs import crs_text, one_crs, reproject, settled_crs, within_degrees
from warpriver.io.files import beside, check_readable
from warpriver.io.geotiff import TIFF, read_geotiff, write_geotiff
from warpriver.io.grids import ASCII, NUMPY, PROJECTION, read_ascii, read_numpy, write_ascii, write_numpy
from warpriver.io.heightmaps import PNG, RAW, read_heightmap, write_heightmap
from warpriver.io.raster_source import Raster, north_up
from warpriver.io.source import Line, Source
from warpriver.io.warping import warp
from warpriver.terrain import Terrain, square_cells

__all__ = ["read_terrain", "settled_terrain", "terrain_formats", "write_terrain"]

log = logging.getLogger("warpriver")

SUFFIXES = (*TIFF, *ASCII, *NUMPY, PNG, *RAW)
NEEDS = dict.fromkeys(TIFF, ("rasterio",)) | {PNG: ("PIL",)}

# Cells count as square while their sides, taken over the whole raster, differ by less than this part of a cell; from
# the smaller part on that is told.
SQUARE, NEARLY = 0.5, 0.01
# A height below this is no place on Earth, m: the deepest sea is 11 km deep.
DEEPEST = -12000.0
# A cell longer than this cannot be told from metres when nothing says that it is in degrees.
LONGEST_DEGREES = 0.1
FEET = re.compile(r"(us |u\.s\. |international )?(survey )?(feet|foot|ft)\b|.*\b(feet|foot|ft)\b", re.IGNORECASE)


def terrain_formats() -> dict[str, bool]:
    """Return the suffixes of terrain files, each with whether the modules that it needs are installed here."""
    return {s: all(importlib.util.find_spec(m) for m in NEEDS.get(s, ())) for s in SUFFIXES}


def read_terrain(
    path: str | os.PathLike[str],
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: str | None = None,
    to_crs: str | None = None,
    range: tuple[float, float] | None = None,
    z_factor: float | None = None,
    nodata: float | None = None,
    shape: tuple[int, int] | None = None,
    band: int = 1,
    device: Any = "cpu",
) -> Terrain:
    """Read a terrain from a file whose suffix names the format.

    ================== =====================================================================================
    .tif, .tiff        GeoTIFF, one band, scale and offset applied, masks kept (``warpriver[gis]``)
    .asc, .grd         ESRI ASCII grid; the CRS from a .prj file beside it
    .npz               as ``write_terrain`` writes it: everything to the bit
    .npy               heights alone: pass ``cell_size``
    .png               grey height map of 16 bits (or 8), steps from black to white (``warpriver[gis]``)
    .r16, .raw         height map of 16-bit steps, little-endian, by rows from the north; square unless told
    ================== =====================================================================================

    A height map is scaled by the file NAME.png.json that ``write_terrain`` puts beside it, or by ``range`` and
    ``cell_size``.

    *Placing.* North up: rasters whose rows run from the south, or whose columns run from the east, are turned; rotated
    or sheared ones need ``to_crs``. Cells must be square: those that add up to less than half a cell of difference over
    the raster are taken as square (from a hundredth on it warns), others need ``cell_size``.

    *Coordinates* must be metres, as in ``read_network``: a geographic CRS, another unit, or a projection far off the
    length on the ground need ``to_crs``. Numbers of unknown CRS are metres, unless all are within 180 and 90 and the
    cells are shorter than 0.1: those can only be degrees. Heights are in metres whatever the coordinates' unit; where
    the file says feet, it warns until ``z_factor`` is given.

    Args:
        path: File name.
        cell_size: Length of a cell's side in m: of a file that does not tell it; else the heights are resampled to it
            (bilinear where finer, area mean where coarser).
        origin: (west, north), the outer corner of the first cell in m, of a file that does not tell it.
        crs: CRS of a file that states none.
        to_crs: CRS to bring it into, bilinear on square cells of the same area: "EPSG:...", WKT, or "utm" for the
            WGS 84 / UTM zone of its middle (``warpriver[gis]``). Corners that the old raster does not fill are NaN.
        range: (low, high) in m, what the lowest and the highest step of a height map stand for.
        z_factor: Metres in the file's unit of height, 0.3048 for feet.
        nodata: Value that stands for no data, besides what the file says itself.
        shape: (rows, columns) of a raw height map.
        band: Band of a GeoTIFF, from 1.
        device: Warp device name, "cpu" or "cuda:0".

    Returns:
        The terrain; its ``crs`` is "EPSG:..." where the authority has a code for it, else WKT, or None.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: The format, or ``to_crs``, needs a module that is not installed.
        MemoryError: There is no room for it; told from the file's header, before anything is allocated.
        ValueError: The file is not of its format, cut short or without data; it does not tell the cell size, or its
            CRS is unknown, not metric, or in conflict with ``crs``.
    """
    path = Path(path)
    suffix = _suffix(path)
    check_readable(path)
    if range is not None and suffix not in (PNG, *RAW):
        raise ValueError(f"{path}: {suffix} holds heights themselves; leave range= out")
    if suffix in TIFF:
        raster = read_geotiff(path, band, nodata)
    elif suffix in ASCII:
        raster = read_ascii(path, nodata)
    elif suffix in NUMPY:
        raster = read_numpy(path, nodata)
    else:
        raster = read_heightmap(path, range, shape)
    return settled_terrain(
        raster, cell_size=cell_size, origin=origin, crs=crs, to_crs=to_crs, z_factor=z_factor, device=device
    )


def write_terrain(terrain: Terrain, path: str | os.PathLike[str], *, range: tuple[float, float] | None = None) -> None:
    """Write a terrain to a file whose suffix names the format; ``read_terrain`` reads it back.

    A GeoTIFF holds float32 where that loses nothing, else float64, deflated, with its CRS, "m" and no data as NaN; an
    ESRI ASCII grid holds digits that give back the same numbers (no data as -9999) and a .prj file beside it; .npz
    holds all of a terrain, .npy its heights. Height maps (.png; .r16 and .raw, little-endian) hold 65,536 steps, which
    NAME.png.json beside them explains: metres per pixel, height of the first and the last step, origin, CRS; where
    cells have no data, step 0 stands for them and heights start at step 1.

    The file is written beside its place and then renamed, so that a failure leaves the old one as it was.

    Args:
        terrain: What to write.
        path: File name.
        range: (low, high) in m, the heights of the first and the last step of a height map; by default the lowest and
            the highest height. A common range makes neighbouring tiles fit.

    Raises:
        ImportError: The format needs a module that is not installed.
        OSError: The file cannot be written there.
        ValueError: Unknown suffix, or heights outside ``range``.
    """
    path = Path(path)
    suffix = _suffix(path)
    if range is not None and suffix not in (PNG, *RAW):
        raise ValueError(f"{path}: {suffix} holds heights themselves; leave range= out")
    with beside(path, (PROJECTION,) if suffix in ASCII else ()) as temporary:
        if suffix in TIFF:
            write_geotiff(terrain, temporary)
        elif suffix in ASCII:
            write_ascii(terrain, temporary)
        elif suffix in NUMPY:
            write_numpy(terrain, temporary)
        else:
            write_heightmap(terrain, temporary, range)


def _suffix(path: Path) -> str:
    """Return the lower-case suffix that names the format, or raise ``ValueError``."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(
            f"{path}: {suffix or 'no suffix'} names no format of terrains; known are {', '.join(SUFFIXES)}"
        )
    return suffix


def settled_terrain(
    raster: Raster,
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: str | None = None,
    to_crs: str | None = None,
    z_factor: float | None = None,
    device: Any = "cpu",
) -> Terrain:
    """Make a terrain of what a file says and what the caller says: metres, square cells, north up."""
    _place(raster, cell_size, origin)
    _check_numbers(raster, z_factor)
    raster.crs = settled_crs(_outline(raster, crs_text(raster.crs, str(raster.path))), crs)
    if raster.crs is None and to_crs is None:
        _check_degrees(raster)
    if to_crs is not None:
        source = _outline(raster, raster.crs)
        target = reproject([source], to_crs)
        same = np.array_equal(source.lines[0].xy, _outline(raster, None).lines[0].xy)
        if not same or raster.is_turned():
            raster = warp(raster, target)
        raster.crs = target
    else:
        one_crs([_outline(raster, raster.crs)])
    if raster.is_turned():
        raise ValueError(
            f'{raster.path}: its rows do not run east; pass to_crs= (its own CRS or "utm") to have it turned'
        )
    raster.put_north_up()
    size = _square(raster, cell_size)
    west, north = raster.points(np.zeros(1), np.zeros(1))[0]
    try:
        return Terrain(raster.height, size, (west, north), raster.crs, device=device)
    except ValueError as error:
        raise ValueError(f"{raster.path}: {error}") from error


def _place(raster: Raster, cell_size: float | None, origin: Sequence[float] | None) -> None:
    """Give a raster its place from the arguments where the file does not tell it."""
    for value in () if cell_size is None else (cell_size,):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"cell_size is {value:g}; give a positive number of m")
    if raster.affine is not None:
        if origin is not None:
            raise ValueError(f"{raster.path}: the file tells its origin; leave origin= out")
        return
    if cell_size is None:
        raise ValueError(f"{raster.path}: the file does not tell the size of its cells; pass cell_size= in m")
    west, north = (0.0, 0.0) if origin is None else (float(v) for v in origin)
    raster.affine = north_up(west, north, cell_size, cell_size)


def _check_numbers(raster: Raster, z_factor: float | None) -> None:
    """Scale the heights to metres; warn of values that look like another unit or like no data."""
    if not np.isfinite(raster.points(np.zeros(1), np.zeros(1))).all() or not min(raster.cell) > 0.0:
        raise ValueError(f"{raster.path}: its cell size or origin is not a number: {raster.affine}")
    if z_factor is not None:
        if not (math.isfinite(z_factor) and z_factor > 0.0):
            raise ValueError(f"z_factor is {z_factor}; give a positive number, 0.3048 for feet")
        raster.height = raster.height * z_factor
    elif raster.units and FEET.match(raster.units):
        warnings.warn(
            f"{raster.path}: its heights are in {raster.units!r} and are taken as metres; pass z_factor=0.3048",
            UserWarning,
            stacklevel=4,
        )
    with np.errstate(invalid="ignore"):
        deep = raster.height < DEEPEST
    if deep.any():
        warnings.warn(
            f"{raster.path}: {int(deep.sum())} heights are as low as {raster.height[deep].min():g} m; if that stands "
            "for no data, pass nodata=",
            UserWarning,
            stacklevel=4,
        )


def _outline(raster: Raster, crs: str | None) -> Source:
    """The corners of a raster, as the checks of coordinates want them."""
    rows, columns = raster.height.shape
    corners = raster.points(columns * np.array([0.0, 1.0, 1.0, 0.0]), rows * np.array([0.0, 0.0, 1.0, 1.0]))
    return Source(raster.path, [Line(corners, str(raster.path))], crs, raster.lonlat)


def _check_degrees(raster: Raster) -> None:
    """Raise ``ValueError`` where coordinates without a CRS can only be degrees."""
    if max(raster.cell) < LONGEST_DEGREES and within_degrees(_outline(raster, None).lines):
        raise ValueError(
            f"{raster.path}: cells of {raster.cell[0]:.4g} within 180 and 90 look like longitude and latitude and no "
            'CRS is stated; pass crs="EPSG:4326" and to_crs="utm"'
        )


def _square(raster: Raster, cell_size: float | None) -> float:
    """Resample a raster to square cells of the size asked for, where it is not that already; return the size."""
    width, length = raster.cell
    rows, columns = raster.height.shape
    drift = abs(width - length) * max(rows, columns) / min(width, length)
    size = math.sqrt(width * length) if width != length else width
    if drift < SQUARE and (cell_size is None or abs(cell_size - size) * max(rows, columns) < NEARLY * size):
        if drift > NEARLY:
            warnings.warn(
                f"{raster.path}: cells of {width:.6g} x {length:.6g} m are taken as {size:.6g} m square, off by "
                f"{drift:.2g} of a cell over the raster",
                UserWarning,
                stacklevel=4,
            )
        return size
    if cell_size is None:
        raise ValueError(
            f"{raster.path}: its cells are {width:.6g} x {length:.6g} m, not square; pass cell_size= to have it "
            "resampled"
        )
    log.info("%s: resampled from %g x %g m to %g m", raster.path, width, length, cell_size)
    raster.height = square_cells(raster.height, width, length, cell_size)
    return float(cell_size)
