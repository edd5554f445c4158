"""ESRI ASCII grids and NumPy files of heights."""

from __future__ import annotations

import re
import warnings
import zipfile
from pathlib import Path

import numpy as np

from warpriver.io.crs import crs_text
from warpriver.io.files import decoded, is_number, need
from warpriver.io.raster_source import Raster, north_up
from warpriver.terrain import Terrain, require_memory

__all__ = ["ASCII", "NUMPY", "PROJECTION", "read_ascii", "read_numpy", "write_ascii", "write_numpy"]

ASCII = (".asc", ".grd")
NUMPY = (".npz", ".npy")
PROJECTION = ".prj"

# One line of the header of an ESRI ASCII grid.
HEADER = re.compile(r"[ \t]*([A-Za-z_]+)[ \t]+(\S+)[ \t]*(?:\r\n|\n|\r)")
KEYS = "ncols nrows xllcorner yllcorner xllcenter yllcenter cellsize dx dy nodata_value nodata".split()
NO_DATA = -9999.0
# Names of heights in an npz that was not written here.
HEIGHTS = ("height", "elevation", "dem", "z", "topographic__elevation")


def read_ascii(path: Path, nodata: float | None) -> Raster:
    """Read an ESRI ASCII grid, and its CRS from the .prj file beside it if there is one."""
    text = decoded(path)
    header: dict[str, float] = {}
    start = 0
    while match := HEADER.match(text, start):
        key, value = match[1].lower(), match[2]
        if key in ("nan", "inf"):
            break
        try:
            header[key] = float(value)
        except ValueError as error:
            raise ValueError(f"{path}: the header line {match[0].strip()!r} holds no number") from error
        start = match.end()
    unknown = [key for key in header if key not in KEYS]
    if unknown or not {"ncols", "nrows"} <= set(header):
        raise ValueError(
            f"{path}: not an ESRI ASCII grid: its header has {', '.join(header) or 'no line'}; "
            "it needs ncols, nrows, xllcorner or xllcenter, yllcorner or yllcenter, cellsize"
        )
    rows, columns = int(header["nrows"]), int(header["ncols"])
    require_memory((rows, columns), 17, what=f"{path}: a raster")
    height = _numbers(path, text[start:], rows * columns).reshape(rows, columns)
    for value in (nodata, header.get("nodata_value", header.get("nodata"))):
        if value is not None:
            height[height == value] = np.nan
    beside = [path.with_suffix(s) for s in (PROJECTION, PROJECTION.upper()) if path.with_suffix(s).is_file()]
    crs = crs_text(decoded(beside[0]).strip(), str(beside[0])) if beside else None
    return Raster(path, height, _placed(path, header, rows), crs)


def _numbers(path: Path, body: str, count: int) -> np.ndarray:
    """Return the heights below a header."""
    with warnings.catch_warnings():
        # NumPy says of text that it cannot read that the feature is deprecated.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            height = np.fromstring(body, np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            bad = next((word for word in body.split() if not is_number(word)), "?")
            raise ValueError(f"{path}: {bad[:40]!r} among the heights is no number (decimals need a point)") from None
    if len(height) != count:
        cause = "is the file cut short?" if len(height) < count else "is the header right?"
        raise ValueError(f"{path}: {len(height)} heights where the header promises {count}; {cause}")
    return height


def _placed(path: Path, header: dict[str, float], rows: int) -> tuple[float, ...]:
    """Affine numbers from a header that gives the lower left corner or centre."""
    width, length = header.get("dx", header.get("cellsize")), header.get("dy", header.get("cellsize"))
    if width is None or length is None:
        raise ValueError(f"{path}: the header gives no cellsize")
    if not (width > 0.0 and length > 0.0):
        raise ValueError(f"{path}: the header gives cells of {width:g} x {length:g}")
    corner = []
    for axis, size in (("x", width), ("y", length)):
        if f"{axis}llcorner" in header:
            corner.append(header[f"{axis}llcorner"])
        elif f"{axis}llcenter" in header:
            corner.append(header[f"{axis}llcenter"] - 0.5 * size)
        else:
            raise ValueError(f"{path}: the header gives neither {axis}llcorner nor {axis}llcenter")
    return north_up(corner[0], corner[1] + rows * length, width, length)


def write_ascii(terrain: Terrain, path: Path) -> None:
    """Write an ESRI ASCII grid in digits that give back the same heights, and its CRS to a .prj file beside it."""
    height = terrain.to_numpy()
    no_data = NO_DATA
    while (height == no_data).any():
        no_data = 10.0 * no_data - 9.0
    height[np.isnan(height)] = no_data
    west, south, _, _ = terrain.bounds
    header = {
        "ncols": terrain.shape[1], "nrows": terrain.shape[0], "xllcorner": west, "yllcorner": south,
        "cellsize": terrain.cell_size, "NODATA_value": no_data,
    }  # fmt: skip
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.writelines(f"{key:<13} {value!r}\n" for key, value in header.items())
        file.writelines(" ".join(map(repr, row.tolist())) + "\n" for row in height)
    if terrain.crs is not None:
        (pyproj,) = need(f"writing the CRS beside {path.name}", "pyproj")
        path.with_suffix(PROJECTION).write_text(pyproj.CRS(terrain.crs).to_wkt("WKT1_ESRI") + "\n", encoding="utf-8")


def read_numpy(path: Path, nodata: float | None) -> Raster:
    """Read heights from .npy, or from .npz with what else it holds of a terrain."""
    try:
        loaded = np.load(path, mmap_mode="r" if path.suffix.lower() == ".npy" else None)
        if isinstance(loaded, np.ndarray):
            return Raster(path, _heights(path, loaded, nodata))
        with loaded as file:
            names = [name for name in HEIGHTS if name in file.files]
            if not names:
                raise ValueError(f"holds {', '.join(file.files) or 'nothing'}, but no array named height")
            height = _heights(path, file[names[0]], nodata)
            found = {n: file[n] for n in ("cell_size", "origin", "crs") if n in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path}: cannot be read as NumPy's {path.suffix} ({error}); is the file whole?") from error
    crs = str(found["crs"]) if "crs" in found else ""
    affine = None
    if "cell_size" in found:
        size = float(found["cell_size"])
        west, north = (float(v) for v in found.get("origin", (0.0, 0.0)))
        affine = north_up(west, north, size, size)
    return Raster(path, height, affine, crs or None)


def _heights(path: Path, array: np.ndarray, nodata: float | None) -> np.ndarray:
    """A copy of an array as heights."""
    if array.ndim != 2 or array.dtype.kind not in "iuf":
        raise ValueError(f"an array of shape {array.shape} and type {array.dtype} where (rows, columns) heights belong")
    require_memory(array.shape, 17, what=f"{path}: a raster")
    height = np.array(array, np.float64)
    if nodata is not None:
        height[height == nodata] = np.nan
    return height


def write_numpy(terrain: Terrain, path: Path) -> None:
    """Write .npz, which keeps everything to the bit, or .npy, which keeps the heights."""
    with open(path, "wb") as file:
        if path.suffix.lower() == ".npy":
            np.save(file, terrain.to_numpy())
        else:
            np.savez(
                file, height=terrain.to_numpy(), cell_size=np.float64(terrain.cell_size),
                origin=np.array(terrain.origin, np.float64), crs=np.str_(terrain.crs or ""),
            )  # fmt: skip
