"""Terrains and other rasters from and to files: what is read becomes metres on square cells, north up.

The suffix names the format.
"""

from __future__ import annotations

import contextlib
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

from warpriver.errors import InputError
from warpriver.io.crs import crs_text, one_crs, reproject, settled_crs, within_degrees
from warpriver.io.files import beside, check_readable
from warpriver.io.raster.geotiff import TIFF, read_geotiff, write_geotiff
from warpriver.io.raster.grids import (
    ASCII,
    HEIGHTS,
    NUMPY,
    PROJECTION,
    VALUES,
    label_suffix,
    read_ascii,
    read_numpy,
    write_ascii,
    write_labels,
    write_numpy,
)
from warpriver.io.raster.heightmaps import PNG, RAW, read_heightmap, write_heightmap
from warpriver.io.raster.noted import noted_file
from warpriver.io.raster.reproject import warp
from warpriver.io.raster.source import RasterSource, north_up
from warpriver.io.vector.source import Line, Source
from warpriver.raster import Raster
from warpriver.terrain import Terrain, square_cells
from warpriver.validate import positive

__all__ = [
    "read_raster",
    "read_terrain",
    "settled_raster",
    "settled_terrain",
    "terrain_formats",
    "write_raster",
    "write_terrain",
]

log = logging.getLogger("warpriver")

CELLS = (*TIFF, *ASCII, *NUMPY)
HEIGHT_MAPS = (PNG, *RAW)
SUFFIXES = (*CELLS, *HEIGHT_MAPS)
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


@noted_file
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
    if range is not None and suffix not in HEIGHT_MAPS:
        raise InputError(f"{path}: {suffix} holds heights themselves; leave range= out")
    if suffix in CELLS:
        source = _read_cells(path, suffix, band, nodata, HEIGHTS)
    else:
        source = read_heightmap(path, range, shape)
    return settled_terrain(
        source, cell_size=cell_size, origin=origin, crs=crs, to_crs=to_crs, z_factor=z_factor, device=device
    )


def read_raster(
    path: str | os.PathLike[str],
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: str | None = None,
    to_crs: str | None = None,
    nodata: float | None = None,
    band: int = 1,
    device: Any = "cpu",
) -> Raster:
    """Read a raster from a file: GeoTIFF, ESRI ASCII grid, .npz or .npy, as ``write_raster`` writes them, or others'.

    Place and coordinates are as in ``read_terrain``. Whole numbers keep their type, unless cells have no data: then
    they become float64 with NaN. (In an ASCII grid, which tells no type, they are int32, or int64 if they need it.)
    Unit and name are those that the file states: unit and description of a GeoTIFF's band, those in the .aux.xml file
    beside an ASCII grid, the entries of an .npz.

    Args:
        path: File name.
        cell_size: Length of a cell's side in m, of a file that does not tell it; else values are resampled to it, which
            whole numbers are not.
        origin: (west, north), the outer corner of the first cell in m, of a file that does not tell it.
        crs: CRS of a file that states none.
        to_crs: CRS to bring it into, as in ``read_terrain``; of whole numbers a new cell has the one that its centre
            lies in.
        nodata: Value that stands for no data, besides what the file says itself.
        band: Band of a GeoTIFF, from 1.
        device: Warp device name, "cpu" or "cuda:0".

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: The format, or ``to_crs``, needs a module that is not installed.
        MemoryError: There is no room for it; told from the file's header, before anything is allocated.
        ValueError: As in ``read_terrain``.
    """
    path = Path(path)
    suffix = _cell_suffix(path)
    check_readable(path)
    source = _read_cells(path, suffix, band, nodata, (VALUES, *HEIGHTS))
    return settled_raster(source, cell_size=cell_size, origin=origin, crs=crs, to_crs=to_crs, device=device)


def _read_cells(path: Path, suffix: str, band: int, nodata: float | None, names: Sequence[str]) -> RasterSource:
    """Read a file of a format that holds values themselves."""
    if suffix in TIFF:
        return read_geotiff(path, band, nodata)
    return read_ascii(path, nodata) if suffix in ASCII else read_numpy(path, nodata, names)


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
    if range is not None and suffix not in HEIGHT_MAPS:
        raise InputError(f"{path}: {suffix} holds heights themselves; leave range= out")
    with _replaced(path, suffix) as temporary:
        if suffix in CELLS:
            _write_cells(terrain.raster, temporary, suffix, HEIGHTS[0])
        else:
            write_heightmap(terrain, temporary, range)


def write_raster(raster: Raster, path: str | os.PathLike[str]) -> None:
    """Write a raster to a file: GeoTIFF, ESRI ASCII grid, .npz or .npy; ``read_raster`` reads it back.

    Formats are those of ``write_terrain``. Whole numbers are written as such, without a value of no data, since every
    cell has one. CRS, unit and name go with them: a GeoTIFF has them as those of its band, an ASCII grid in a .prj and
    an .aux.xml file beside it, which GDAL reads; .npz holds all to the bit, .npy the values alone.

    Args:
        raster: What to write; of a terrain, ``terrain.raster``.
        path: File name.

    Raises:
        ImportError: The format needs a module that is not installed.
        OSError: The file cannot be written there.
        ValueError: Unknown suffix, or no raster.
    """
    path = Path(path)
    suffix = _cell_suffix(path)
    if not isinstance(raster, Raster):
        raise InputError(f"raster is a {type(raster).__name__}; give a Raster, or write_terrain a terrain")
    with _replaced(path, suffix) as temporary:
        _write_cells(raster, temporary, suffix, VALUES)
        if suffix in ASCII:
            write_labels(raster, temporary)


def _replaced(path: Path, suffix: str) -> contextlib.AbstractContextManager[Path]:
    """Give the path to write a file at that takes the place of an old one, and of what lies beside that."""
    return beside(path, (PROJECTION, label_suffix(path)) if suffix in ASCII else ())


def _write_cells(raster: Raster, path: Path, suffix: str, key: str) -> None:
    """Write a file of a format that holds values themselves; ``key`` names them in .npz."""
    if suffix in TIFF:
        write_geotiff(raster, path)
    elif suffix in ASCII:
        write_ascii(raster, path)
    else:
        write_numpy(raster, path, key)


def _suffix(path: Path) -> str:
    """Return the lower-case suffix that names the format, or raise ``ValueError``."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"{path}: {suffix or 'no suffix'} names no format of terrains; known are {', '.join(SUFFIXES)}"
        )
    return suffix


def _cell_suffix(path: Path) -> str:
    """Return the lower-case suffix of a format that holds values themselves, or raise ``ValueError``."""
    suffix = path.suffix.lower()
    if suffix not in CELLS:
        heights = "holds heights of terrains alone" if suffix in HEIGHT_MAPS else "names no format of rasters"
        raise InputError(f"{path}: {suffix or 'no suffix'} {heights}; known are {', '.join(CELLS)}")
    return suffix


def settled_terrain(
    source: RasterSource,
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: str | None = None,
    to_crs: str | None = None,
    z_factor: float | None = None,
    device: Any = "cpu",
) -> Terrain:
    """Make a terrain of what a file says and what the caller says: metres, square cells, north up."""
    _place(source, cell_size, origin)
    _scale_heights(source, z_factor)
    source, size = _settled(source, cell_size, crs, to_crs)
    try:
        return Terrain(source.values, size, source.corner, source.crs, device=device)
    except ValueError as error:
        raise InputError(f"{source.path}: {error}") from error


def settled_raster(
    source: RasterSource,
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: str | None = None,
    to_crs: str | None = None,
    device: Any = "cpu",
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
    source: RasterSource, cell_size: float | None, crs: str | None, to_crs: str | None
) -> tuple[RasterSource, float]:
    """Return the cells of a file in a metric CRS, north up and square, and their size."""
    source.crs = settled_crs(_outline(source, crs_text(source.crs, str(source.path))), crs)
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
    if source.affine is not None and origin is not None:
        raise InputError(f"{source.path}: the file tells its origin; leave origin= out")
    if source.affine is None:
        if cell_size is None:
            raise InputError(f"{source.path}: the file does not tell the size of its cells; pass cell_size= in m")
        west, north = (0.0, 0.0) if origin is None else (float(v) for v in origin)
        source.affine = north_up(west, north, cell_size, cell_size)
    if not np.isfinite(source.corner).all() or not min(source.cell) > 0.0:
        raise InputError(f"{source.path}: its cell size or origin is not a number: {source.affine}")


def _scale_heights(source: RasterSource, z_factor: float | None) -> None:
    """Scale the heights to metres; warn of values that look like another unit or like no data."""
    source.values = np.asarray(source.values, np.float64)
    if z_factor is not None:
        positive(z_factor, "z_factor", hint=", 0.3048 for feet")
        source.values = source.values * z_factor
    elif source.units and FEET.match(source.units):
        warnings.warn(
            f"{source.path}: its heights are in {source.units!r} and are taken as metres; pass z_factor=0.3048",
            UserWarning,
            stacklevel=4,
        )
    with np.errstate(invalid="ignore"):
        deep = source.values < DEEPEST
    if deep.any():
        warnings.warn(
            f"{source.path}: {int(deep.sum())} heights are as low as {source.values[deep].min():g} m; if that stands "
            "for no data, pass nodata=",
            UserWarning,
            stacklevel=4,
        )


def _outline(source: RasterSource, crs: str | None) -> Source:
    """The corners of the cells, as the checks of coordinates want them."""
    rows, columns = source.values.shape
    corners = source.points(columns * np.array([0.0, 1.0, 1.0, 0.0]), rows * np.array([0.0, 0.0, 1.0, 1.0]))
    return Source(source.path, [Line(corners, str(source.path))], crs, source.lonlat)


def _check_degrees(source: RasterSource) -> None:
    """Raise ``ValueError`` where coordinates without a CRS can only be degrees."""
    if max(source.cell) < LONGEST_DEGREES and within_degrees(_outline(source, None).lines):
        raise InputError(
            f"{source.path}: cells of {source.cell[0]:.4g} within 180 and 90 look like longitude and latitude and no "
            'CRS is stated; pass crs="EPSG:4326" and to_crs="utm"'
        )


def _square(source: RasterSource, cell_size: float | None) -> float:
    """Resample a raster to square cells of the size asked for, where it is not that already; return the size."""
    width, length = source.cell
    rows, columns = source.values.shape
    drift = abs(width - length) * max(rows, columns) / min(width, length)
    size = math.sqrt(width * length) if width != length else width
    if drift < SQUARE and (cell_size is None or abs(cell_size - size) * max(rows, columns) < NEARLY * size):
        if drift > NEARLY:
            warnings.warn(
                f"{source.path}: cells of {width:.6g} x {length:.6g} m are taken as {size:.6g} m square, off by "
                f"{drift:.2g} of a cell over the raster",
                UserWarning,
                stacklevel=5,
            )
        return size
    if cell_size is None:
        raise InputError(
            f"{source.path}: its cells are {width:.6g} x {length:.6g} m, not square; pass cell_size= to have it "
            "resampled"
        )
    if source.values.dtype.kind != "f":
        raise InputError(f"{source.path}: its whole numbers are not resampled; leave cell_size= out")
    log.info("%s: resampled from %g x %g m to %g m", source.path, width, length, cell_size)
    source.values = square_cells(source.values, width, length, cell_size)
    return float(cell_size)
