"""ESRI ASCII grids and NumPy files of heights and other rasters."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from warpriver.device import require_memory
from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.io.crs import crs_text
from warpriver.io.files import decoded, filtered_warnings, is_number
from warpriver.io.raster.source import RasterSource, north_up, with_gaps
from warpriver.raster import Raster

__all__ = [
    "ASCII",
    "HEIGHTS",
    "NUMPY",
    "PROJECTION",
    "VALUES",
    "label_suffix",
    "read_ascii",
    "read_numpy",
    "write_ascii",
    "write_labels",
    "write_numpy",
]

ASCII = (".asc", ".grd")
NUMPY = (".npz", ".npy")
PROJECTION = ".prj"

# One line of the header of an ESRI ASCII grid.
HEADER = re.compile(r"[ \t]*([A-Za-z_]+)[ \t]+(\S+)[ \t]*(?:\r\n|\n|\r)")
KEYS = "ncols nrows xllcorner yllcorner xllcenter yllcenter cellsize dx dy nodata_value nodata".split()
NO_DATA = -9999.0
# Names of heights in an npz, the first as it is written here; and of other values.
HEIGHTS = ("height", "elevation", "dem", "z", "topographic__elevation")
VALUES = "values"
# A body of an ASCII grid without any of these holds whole numbers; they stay so up to this size, which float64 has.
FRACTION = re.compile(r"[.eEnN]")
LARGEST_WHOLE = 2.0**53


def read_ascii(path: Path, nodata: float | None) -> RasterSource:
    """Read an ESRI ASCII grid, its CRS from the .prj file beside it, unit and name from the .aux.xml if there are."""
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
            raise InputError(f"{path}: the header line {match[0].strip()!r} holds no number") from error
        start = match.end()
    unknown = [key for key in header if key not in KEYS]
    if unknown or not {"ncols", "nrows"} <= set(header):
        raise InputError(
            f"{path}: not an ESRI ASCII grid: its header has {', '.join(header) or 'no line'}; "
            "it needs ncols, nrows, xllcorner or xllcenter, yllcorner or yllcenter, cellsize"
        )
    rows, columns = int(header["nrows"]), int(header["ncols"])
    require_memory((rows, columns), 17, what=f"{path}: a raster")
    values = _numbers(path, text[start:], rows * columns).reshape(rows, columns)
    gap = np.zeros(values.shape, bool)
    for value in (nodata, header.get("nodata_value", header.get("nodata"))):
        if value is not None:
            gap |= values == value
    if not FRACTION.search(text, start) and np.abs(values).max(initial=0.0) < LARGEST_WHOLE:
        small = np.abs(values).max(initial=0.0) <= np.iinfo(np.int32).max
        values = values.astype(np.int32 if small else np.int64)
    values = with_gaps(values, gap)
    beside = [path.with_suffix(s) for s in (PROJECTION, PROJECTION.upper()) if path.with_suffix(s).is_file()]
    crs = crs_text(decoded(beside[0]).strip(), str(beside[0])) if beside else None
    unit, name = _read_labels(path)
    return RasterSource(path, values, _placed(path, header, rows), crs, units=unit, name=name)


def _numbers(path: Path, body: str, count: int) -> np.ndarray:
    """Return the numbers below a header."""
    # NumPy says of text that it cannot read that the feature is deprecated.
    with filtered_warnings("error", DeprecationWarning):
        try:
            height = np.fromstring(body, np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            bad = next((word for word in body.split() if not is_number(word)), "?")
            raise InputError(f"{path}: {bad[:40]!r} among the heights is no number (decimals need a point)") from None
    if len(height) != count:
        cause = "is the file cut short?" if len(height) < count else "is the header right?"
        raise InputError(f"{path}: {len(height)} heights where the header promises {count}; {cause}")
    return height


def _placed(path: Path, header: dict[str, float], rows: int) -> tuple[float, ...]:
    """Affine numbers from a header that gives the lower left corner or centre."""
    width, length = header.get("dx", header.get("cellsize")), header.get("dy", header.get("cellsize"))
    if width is None or length is None:
        raise InputError(f"{path}: the header gives no cellsize")
    if not (width > 0.0 and length > 0.0):
        raise InputError(f"{path}: the header gives cells of {width:g} x {length:g}")
    corner = []
    for axis, size in (("x", width), ("y", length)):
        if f"{axis}llcorner" in header:
            corner.append(header[f"{axis}llcorner"])
        elif f"{axis}llcenter" in header:
            corner.append(header[f"{axis}llcenter"] - 0.5 * size)
        else:
            raise InputError(f"{path}: the header gives neither {axis}llcorner nor {axis}llcenter")
    return north_up(corner[0], corner[1] + rows * length, width, length)


def write_ascii(raster: Raster, path: Path) -> None:
    """Write an ESRI ASCII grid in digits that give back the same values, and its CRS to a .prj file beside it."""
    values = raster.numpy()
    if raster.is_integer and np.abs(values.astype(np.float64)).max() >= LARGEST_WHOLE:
        raise InputError(
            f"{path.name}: whole numbers of 2^53 or more are not kept in an ASCII grid; write .npz or .tif"
        )
    west, south, _, _ = raster.bounds
    header: dict[str, float] = {
        "ncols": raster.shape[1], "nrows": raster.shape[0], "xllcorner": west, "yllcorner": south,
        "cellsize": raster.cell_size,
    }  # fmt: skip
    if not raster.is_integer:
        no_data = NO_DATA
        while (values == no_data).any():
            no_data = 10.0 * no_data - 9.0
        values[np.isnan(values)] = no_data
        header["NODATA_value"] = no_data
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.writelines(f"{key:<13} {value!r}\n" for key, value in header.items())
        file.writelines(" ".join(map(repr, row.tolist())) + "\n" for row in values)
    if raster.crs is not None:
        (pyproj,) = need(f"writing the CRS beside {path.name}", "pyproj")
        path.with_suffix(PROJECTION).write_text(pyproj.CRS(raster.crs).to_wkt("WKT1_ESRI") + "\n", encoding="utf-8")


def label_suffix(path: Path) -> str:
    """Return the suffix of the file beside a grid that GDAL reads its unit and name from."""
    return f"{path.suffix}.aux.xml"


def write_labels(raster: Raster, path: Path) -> None:
    """Write the unit and the name of a raster, which an ASCII grid has no place for, to the .aux.xml file beside it."""
    if not (raster.unit or raster.name):
        return
    top = ElementTree.Element("PAMDataset")
    band = ElementTree.SubElement(top, "PAMRasterBand", band="1")
    for tag, text in (("Description", raster.name), ("UnitType", raster.unit)):
        if text:
            ElementTree.SubElement(band, tag).text = text
    ElementTree.ElementTree(top).write(path.with_suffix(label_suffix(path)), encoding="utf-8")


def _read_labels(path: Path) -> tuple[str | None, str | None]:
    """Return the unit and the name that the .aux.xml file beside a grid tells, each None where it does not."""
    side = path.with_suffix(label_suffix(path))
    if not side.is_file():
        return None, None
    try:
        band = ElementTree.parse(side).getroot().find("PAMRasterBand")
    except ElementTree.ParseError as error:
        raise InputError(f"{side}: not XML ({error}); repair or remove it") from error
    return (None, None) if band is None else (band.findtext("UnitType"), band.findtext("Description"))


def read_numpy(path: Path, nodata: float | None, names: Sequence[str] = HEIGHTS) -> RasterSource:
    """Read values from .npy, or from .npz the first array of those names, with what else it holds of a raster."""
    try:
        loaded = np.load(path, mmap_mode="r" if path.suffix.lower() == ".npy" else None)
        if isinstance(loaded, np.ndarray):
            return RasterSource(path, _cells(path, loaded, nodata))
        with loaded as file:
            held = [name for name in names if name in file.files]
            if not held:
                raise InputError(f"holds {', '.join(file.files) or 'nothing'}, but no array named {names[0]}")
            values = _cells(path, file[held[0]], nodata)
            found = {n: file[n] for n in ("cell_size", "origin", "crs", "unit", "name") if n in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read as NumPy's {path.suffix} ({error}); is the file whole?") from error
    affine = None
    if "cell_size" in found:
        size = float(found["cell_size"])
        west, north = (float(v) for v in found.get("origin", (0.0, 0.0)))
        affine = north_up(west, north, size, size)
    crs, unit, name = (str(found[key]) if key in found else "" for key in ("crs", "unit", "name"))
    return RasterSource(path, values, affine, crs or None, units=unit or None, name=name or None)


def _cells(path: Path, array: np.ndarray, nodata: float | None) -> np.ndarray:
    """A copy of an array as the values of cells."""
    if array.ndim != 2 or array.dtype.kind not in "iuf":
        raise InputError(f"an array of shape {array.shape} and type {array.dtype} where (rows, columns) numbers belong")
    require_memory(array.shape, 17, what=f"{path}: a raster")
    return with_gaps(np.array(array), np.zeros(array.shape, bool) if nodata is None else array == nodata)


def write_numpy(raster: Raster, path: Path, key: str) -> None:
    """Write .npz, which keeps everything to the bit, or .npy, which keeps the values.

    Args:
        raster: What to write.
        path: File name.
        key: Name of the array of values: ``VALUES``, and unit and name beside it, or the first of ``HEIGHTS``.
    """
    arrays = {
        key: raster.numpy(), "cell_size": np.float64(raster.cell_size),
        "origin": np.array(raster.origin, np.float64), "crs": np.str_(raster.crs or ""),
    }  # fmt: skip
    if key == VALUES:
        arrays |= {"unit": np.str_(raster.unit), "name": np.str_(raster.name)}
    with open(path, "wb") as file:
        if path.suffix.lower() == ".npy":
            np.save(file, arrays[key])
        else:
            np.savez(file, **arrays)
