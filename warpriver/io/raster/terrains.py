"""Terrains and other rasters from and to files: what is read becomes metres on square cells, north up.

The suffix names the format.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
from collections.abc import Sequence
from pathlib import Path

import warp as wp

from warpriver.crs import CRSLike
from warpriver.errors import InputError
from warpriver.files import beside
from warpriver.io.files import check_readable
from warpriver.io.raster.foreign import FOREIGN, write_foreign
from warpriver.io.raster.geotiff import READABLE, TIFF, check_raster, read_gdal, write_geotiff
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
from warpriver.io.raster.heightmaps import PNG, RAW, parts_of, read_heightmap, write_heightmap
from warpriver.io.raster.noted import noted_file
from warpriver.io.raster.settle import settled_raster, settled_terrain
from warpriver.io.raster.source import RasterSource
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain

__all__ = [
    "read_raster",
    "read_terrain",
    "terrain_formats",
    "write_raster",
    "write_terrain",
]

CELLS = (*TIFF, *FOREIGN, *ASCII, *NUMPY)
HEIGHT_MAPS = (PNG, *RAW)
SUFFIXES = (*CELLS, *HEIGHT_MAPS)
READ_ONLY = tuple(suffix for suffix in READABLE if suffix not in FOREIGN)
NEEDS = dict.fromkeys((*TIFF, *READABLE), ("rasterio",)) | {PNG: ("PIL",)}


def terrain_formats() -> dict[str, bool]:
    """Return the suffixes of terrain files, each with whether the modules that it needs are installed here."""
    return {s: all(importlib.util.find_spec(m) for m in NEEDS.get(s, ())) for s in (*SUFFIXES, *READ_ONLY)}


@noted_file
@public
def read_terrain(
    path: str | os.PathLike[str],
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: CRSLike | None = None,
    to_crs: CRSLike | None = None,
    range: tuple[float, float] | None = None,
    z_factor: float | None = None,
    nodata: float | None = None,
    shape: tuple[int, int] | None = None,
    band: int = 1,
    device: wp.DeviceLike = "cpu",
) -> Terrain:
    """Read a terrain from a file whose suffix names the format.

    ================== =====================================================================================
    .tif, .tiff        GeoTIFF, one band, scale and offset applied, masks kept (``warpriver[gis]``)
    .dem, .hgt         USGS DEM, SRTM tile (``warpriver[gis]``)
    .img, .bil, .flt   Erdas Imagine, ESRI binary grids (``warpriver[gis]``)
    .sdat              SAGA grid (``warpriver[gis]``)
    .asc, .grd         ESRI ASCII grid; the CRS from a .prj file beside it
    .npz               as ``write_terrain`` writes it: everything to the bit; or landlab's ``topographic__elevation``,
                       whose row 0 is in the south: it is turned, with a warning
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
    length on the ground need ``to_crs``. Numbers of unknown CRS are metres, unless all are within 360 and 90 and the
    cells are shorter than 0.1: those can only be degrees. Longitudes may run to 180 or to 360. Coordinates of a local
    system in another unit are scaled to metres, with a warning.

    *Heights* become metres: where the band or the vertical CRS says feet, centimetres or another unit of length, they
    are scaled, with a warning; a unit that is not known is refused until ``z_factor`` is given. Where nothing says what
    no data is, values such as -9999, 32767 or 3.4e38 that stand alone are read as no data, with a warning; if the file
    names another value, or ``nodata`` does, they are kept, and the warning tells their number.

    Args:
        path: File name.
        cell_size: Length of a cell's side in m: of a file that does not tell it; else the heights are resampled to it
            (bilinear where finer, area mean where coarser).
        origin: (west, north), the outer corner of the first cell in m, of a file that does not tell it.
        crs: CRS of a file that states none, or only in a file beside it, such as a .prj: that one is overruled.
        to_crs: CRS to bring it into, bilinear on square cells of the same area: "EPSG:...", WKT, or "utm" for the
            WGS 84 / UTM zone of its middle (``warpriver[gis]``). Corners that the old raster does not fill are NaN.
        range: (low, high) in m, what the lowest and the highest step of a height map stand for.
        z_factor: Metres in the file's unit of height, 0.3048 for feet; overrules what the file says.
        nodata: Value that stands for no data, besides what the file says itself, as it is stored there; NaN: no other.
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
    suffix = _suffix(path, (*SUFFIXES, *READ_ONLY))
    check_readable(path)
    if range is not None and suffix not in HEIGHT_MAPS:
        raise InputError(f"{path}: {suffix} holds heights themselves; leave range= out")
    if suffix not in HEIGHT_MAPS:
        source = _read_cells(path, suffix, band, nodata, HEIGHTS, heights=True)
    else:
        source = read_heightmap(path, range, shape)
    return settled_terrain(
        source, cell_size=cell_size, origin=origin, crs=crs, to_crs=to_crs, z_factor=z_factor, device=device
    )


@public
def read_raster(
    path: str | os.PathLike[str],
    *,
    cell_size: float | None = None,
    origin: Sequence[float] | None = None,
    crs: CRSLike | None = None,
    to_crs: CRSLike | None = None,
    nodata: float | None = None,
    band: int = 1,
    device: wp.DeviceLike = "cpu",
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
        crs: CRS of a file that states none, or only in a file beside it.
        to_crs: CRS to bring it into, as in ``read_terrain``; of whole numbers a new cell has the one that its centre
            lies in.
        nodata: Value that stands for no data, besides what the file says itself; others that look like it, such as
            -9999, are told with a warning and kept. NaN: no other.
        band: Band of a GeoTIFF, from 1.
        device: Warp device name, "cpu" or "cuda:0".

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: The format, or ``to_crs``, needs a module that is not installed.
        MemoryError: There is no room for it; told from the file's header, before anything is allocated.
        ValueError: As in ``read_terrain``.
    """
    path = Path(path)
    suffix = _cell_suffix(path, (*CELLS, *READ_ONLY))
    check_readable(path)
    source = _read_cells(path, suffix, band, nodata, (VALUES, *HEIGHTS), heights=False)
    return settled_raster(source, cell_size=cell_size, origin=origin, crs=crs, to_crs=to_crs, device=device)


def _read_cells(
    path: Path, suffix: str, band: int, nodata: float | None, names: Sequence[str], *, heights: bool
) -> RasterSource:
    """Read a file of a format that holds values themselves."""
    if suffix in NUMPY:
        return read_numpy(path, nodata, names, heights=heights)
    return (
        read_ascii(path, nodata, heights=heights) if suffix in ASCII else read_gdal(path, band, nodata, heights=heights)
    )


@public
def write_terrain(terrain: Terrain, path: str | os.PathLike[str], *, range: tuple[float, float] | None = None) -> None:
    """Write a terrain to a file whose suffix names the format; ``read_terrain`` reads it back.

    ================== =====================================================================================
    .tif, .tiff        cloud-optimized GeoTIFF: deflated tiles and overviews; no data is NaN (``warpriver[gis]``)
    .sdat, .bil, .img  SAGA grid, ESRI band file, Erdas Imagine (``warpriver[gis]``); no data is -9999
    .asc, .grd         ESRI ASCII grid in digits that give back the same numbers; no data is -9999
    .npz, .npy         all of a terrain; its heights
    .png, .r16, .raw   height map of 16 bits: 65,536 steps, little-endian in raw files (PNG: ``warpriver[gis]``)
    ================== =====================================================================================

    Heights are float32 where that loses nothing, else float64; .bil has no float64 and rounds, with a warning. The CRS
    is in the file or in a .prj beside it.

    Beside a height map stand NAME.png.json (metres per pixel, heights of the first and the last step, origin, CRS,
    scales for Unreal Engine) and NAME.png.aux.xml with a world file (.pgw) or, of raw files, a header (.hdr): GDAL and
    QGIS read place, CRS and heights in metres from them. Where cells have no data, step 0 stands for them and heights
    start at step 1.

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
    with _replaced(path, suffix, terrain.raster) as temporary:
        if suffix in CELLS:
            _write_cells(terrain.raster, temporary, suffix, HEIGHTS[0], path)
        else:
            write_heightmap(terrain, temporary, range, path)


@public
def write_raster(raster: Raster, path: str | os.PathLike[str]) -> None:
    """Write a raster to a file whose suffix names the format; ``read_raster`` reads it back.

    Formats are those of ``write_terrain`` except height maps. Whole numbers are written as such, without a value of no
    data, since every cell has one. CRS, unit and name go with them: a GeoTIFF has them as those of its band, other
    grids in .prj and .aux.xml files beside them, which GDAL reads; .npz holds all to the bit, .npy the values alone.

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
    with _replaced(path, suffix, raster) as temporary:
        _write_cells(raster, temporary, suffix, VALUES, path)
        if suffix in ASCII:
            write_labels(raster, temporary)


def _replaced(path: Path, suffix: str, raster: Raster) -> contextlib.AbstractContextManager[Path]:
    """Give the path to write a file at that takes the place of an old one, and of what lies beside that."""
    if suffix in TIFF:
        return beside(path, check=lambda written: check_raster(written, raster))
    if suffix in FOREIGN:
        return beside(path, FOREIGN[suffix].parts, lambda written: check_raster(written, raster))
    if suffix in ASCII:
        return beside(path, (PROJECTION, label_suffix(path)))
    return beside(path, parts_of(path) if suffix in HEIGHT_MAPS else ())


def _write_cells(raster: Raster, path: Path, suffix: str, key: str, told: Path) -> None:
    """Write a file of a format that holds values themselves; ``key`` names them in .npz, ``told`` it in messages."""
    if suffix in TIFF:
        write_geotiff(raster, path)
    elif suffix in FOREIGN:
        write_foreign(raster, path, told)
    elif suffix in ASCII:
        write_ascii(raster, path)
    else:
        write_numpy(raster, path, key)


def _suffix(path: Path, known: Sequence[str] = SUFFIXES) -> str:
    """Return the lower-case suffix that names the format, or raise ``ValueError``."""
    suffix = path.suffix.lower()
    if suffix not in known:
        raise InputError(f"{path}: {suffix or 'no suffix'} names no format of terrains; known are {', '.join(known)}")
    return suffix


def _cell_suffix(path: Path, known: Sequence[str] = CELLS) -> str:
    """Return the lower-case suffix of a format that holds values themselves, or raise ``ValueError``."""
    suffix = path.suffix.lower()
    if suffix not in known:
        heights = "holds heights of terrains alone" if suffix in HEIGHT_MAPS else "names no format of rasters"
        raise InputError(f"{path}: {suffix or 'no suffix'} {heights}; known are {', '.join(known)}")
    return suffix
