"""ESRI ASCII grids and NumPy files of heights and other rasters."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from warpriver.device import require_memory
from warpriver.errors import InputError, warn
from warpriver.extras import need
from warpriver.io.files import decoded, filtered_warnings, is_number
from warpriver.io.raster.npz import load_cells
from warpriver.io.raster.source import RasterSource, cells_without_data, north_up, with_gaps
from warpriver.raster import Raster
from warpriver.sentinels import equal_cells
from warpriver.validate import whole

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
LANDLAB = "topographic__elevation"
HEIGHTS = ("height", "elevation", "dem", "z", LANDLAB)
VALUES = "values"
# A body of an ASCII grid without any of these holds whole numbers; they stay so up to this size, which float64 has.
FRACTION = re.compile(r"[.eEnN]")
LARGEST_WHOLE = 2.0**53


def read_ascii(path: Path, nodata: float | None, *, heights: bool) -> RasterSource:
    """Read an ESRI ASCII grid, its CRS from the .prj file beside it, unit and name from the .aux.xml if there are."""
    text = decoded(path)
    header, start = _header(path, text)
    rows, columns = int(header["nrows"]), int(header["ncols"])
    require_memory((rows, columns), 17, what=f"{path}: a raster")
    values = _numbers(path, text[start:], rows * columns).reshape(rows, columns)
    # Where the header names no value, heights have ESRI's default.
    stated = header.get("nodata_value", header.get("nodata", NO_DATA if heights else None))
    gap = np.zeros(values.shape, bool) if stated is None else equal_cells(values, stated)
    declared = bool({"nodata_value", "nodata"} & set(header))
    gap = cells_without_data(path, values, gap, nodata, declared=declared, heights=heights)
    if not FRACTION.search(text, start) and np.abs(values).max(initial=0.0) < LARGEST_WHOLE:
        small = np.abs(values).max(initial=0.0) <= np.iinfo(np.int32).max
        values = values.astype(np.int32 if small else np.int64)
    projections = [path.with_suffix(s) for s in (PROJECTION, PROJECTION.upper())]
    crs = next((decoded(side).strip() for side in projections if side.is_file()), None)
    unit, name = _read_labels(path)
    return RasterSource(
        path, with_gaps(values, gap), _placed(path, header, rows), crs, units=unit, name=name, crs_beside=True
    )


def _header(path: Path, text: str) -> tuple[dict[str, float], int]:
    """Return the header of a grid by lower-case name, and where the numbers begin."""
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
    for key in ("nrows", "ncols"):
        whole(header[key], f"{path}: {key}", 1)
    return header, start


def _numbers(path: Path, body: str, count: int) -> np.ndarray:
    """Return the numbers after a header."""
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
        text = decoded(side)
        if "<!DOCTYPE" in text:
            raise InputError(f"{side}: holds a document type, which such files have no use for; remove it")
        band = ElementTree.fromstring(text).find("PAMRasterBand")
    except ElementTree.ParseError as error:
        raise InputError(f"{side}: not XML ({error}); repair or remove it") from error
    return (None, None) if band is None else (band.findtext("UnitType"), band.findtext("Description"))


def read_numpy(path: Path, nodata: float | None, names: Sequence[str], *, heights: bool) -> RasterSource:
    """Read values from .npy, or from .npz the first array of those names, with what else it holds of a raster."""
    key, cells, facts = load_cells(path, names, ("cell_size", "origin", "crs", "unit", "name"))
    gap = cells_without_data(path, cells, np.zeros(cells.shape, bool), nodata, declared=False, heights=heights)
    values = with_gaps(np.array(cells), gap)
    if key == LANDLAB:
        values = values[::-1]
        warn(
            f"{path}: {LANDLAB} is taken as landlab has it, row 0 in the south, and turned; if its row 0 is in the "
            f"north, name the array {HEIGHTS[0]}"
        )
    affine = None
    try:
        if "cell_size" in facts:
            size = float(facts["cell_size"])
            west, north = (float(v) for v in facts.get("origin", (0.0, 0.0)))
            affine = north_up(west, north, size, size)
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: its cell_size or origin is not what write_terrain writes ({error})") from error
    crs, unit, name = (str(facts[key]) if key in facts else "" for key in ("crs", "unit", "name"))
    return RasterSource(path, values, affine, crs or None, units=unit or None, name=name or None)


def write_numpy(raster: Raster, path: Path, key: str) -> None:
    """Write .npz, which keeps everything to the bit, or .npy, which keeps the values.

    Args:
        raster: What to write.
        path: File name.
        key: Name of the array of values: ``VALUES``, and unit and name beside it, or the first of ``HEIGHTS``.
    """
    arrays: dict[str, Any] = {
        key: raster.numpy(), "cell_size": np.float64(raster.cell_size),
        "origin": np.array(raster.origin, np.float64), "crs": np.str_(raster.crs or ""),
    }  # fmt: skip
    if key == VALUES:
        arrays |= {"unit": np.str_(raster.unit), "name": np.str_(raster.name)}
    with open(path, "wb") as file:
        if path.suffix.lower() == ".npy":
            # Not by np.save, which does not tell when the last bytes find no room.
            values = np.ascontiguousarray(arrays[key])
            np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(values))
            file.write(values.data)
        else:
            np.savez(file, **arrays)
