"""Height maps of 16 bits, PNG and raw, with files beside them that say where they lie and what a step is.

A JSON file is for people and for :func:`read_heightmap`; what GDAL, QGIS and their like read is in an .aux.xml (place,
CRS, scale and offset of the heights), with a world file beside a PNG and an ESRI header beside a raw file.
"""

from __future__ import annotations

import json
import logging
import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.device import require_memory
from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.files import in_memory
from warpriver.io.files import decoded, filtered_warnings
from warpriver.io.raster.placing import WORLD_FILES, write_placing, write_world_file
from warpriver.io.raster.source import RasterSource, north_up
from warpriver.terrain import Terrain
from warpriver.validate import shown

__all__ = ["PNG", "RAW", "parts_of", "read_heightmap", "write_heightmap"]

log = logging.getLogger("warpriver")

PNG = ".png"
RAW = (".r16", ".raw")
TOP = 65535


def side_file(path: Path) -> Path:
    """Return the JSON file that goes with a height map: its whole name and .json."""
    return path.with_name(path.name + ".json")


def read_heightmap(path: Path, limits: tuple[float, float] | None, shape: tuple[int, int] | None) -> RasterSource:
    """Read steps of height, and scale them to metres by ``limits`` = (low, high) or by the JSON file."""
    side: dict[str, Any] = {}
    if side_file(path).is_file():
        try:
            side = json.loads(decoded(side_file(path)))
        except (json.JSONDecodeError, RecursionError) as error:
            raise InputError(f"{side_file(path)}: not JSON ({error})") from error
        if not isinstance(side, dict):
            raise InputError(f"{side_file(path)}: not a JSON object")
    try:
        stated = (float(side["height_low"]), float(side["height_high"])) if "height_low" in side else None
        pixel = float(side["metres_per_pixel"]) if "metres_per_pixel" in side else None
        west, north = (float(v) for v in side.get("origin", (0.0, 0.0)))
        rows_columns = (int(side["rows"]), int(side["columns"])) if "rows" in side else None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{side_file(path)}: not what write_terrain writes ({error!r})") from error
    found = limits or stated
    if found is None:
        raise InputError(f"{path}: a height map does not tell its heights; pass range=(low, high) in m")
    low, high = checked_limits(found)
    step, top = _read_png(path) if path.suffix.lower() == PNG else _read_raw(path, shape or rows_columns)
    if top < TOP:
        log.warning("%s: %d steps of height are few: slopes come in terraces", path, top + 1)
    first = 0 if side.get("no_data") is None else 1
    height = low + (step - np.float64(first)) * ((high - low) / (top - first))
    if first:
        height[step == 0] = np.nan
    affine = None if pixel is None else north_up(west, north, pixel, pixel)
    return RasterSource(path, height, affine, side.get("crs"), units="m", crs_beside=True, place_beside=True)


def _read_png(path: Path) -> tuple[np.ndarray, int]:
    """Return the steps of a grey PNG, and the highest step that it can hold."""
    (image,) = need(f"reading {path.suffix}", "PIL.Image")
    with path.open("rb") as file:
        head = file.read(26)
    if len(head) < 26 or head[:8] != b"\x89PNG\r\n\x1a\n" or head[12:16] != b"IHDR":
        raise InputError(f"{path}: not a PNG file, or cut short")
    columns, rows, bits, color = struct.unpack(">IIBB", head[16:26])
    if color != 0 or bits not in (8, 16):
        raise InputError(f"{path}: a PNG of color type {color} and {bits} bits; a height map is grey, of 16 or 8 bits")
    require_memory((rows, columns), 22, what=f"{path}: a raster")
    try:
        with (
            filtered_warnings("ignore", image.DecompressionBombWarning),
            image.open(path, formats=["PNG"]) as picture,
        ):
            return np.array(picture), 2**bits - 1
    except (OSError, SyntaxError, ValueError, image.DecompressionBombError) as error:
        raise InputError(f"{path}: its pixels cannot be read ({error}); is the file whole?") from error


def _read_raw(path: Path, shape: tuple[int, int] | None) -> tuple[np.ndarray, int]:
    """Return the steps of a raw file, and the highest step."""
    size = path.stat().st_size
    side = math.isqrt(size // 2)
    if shape is None and 2 * side * side != size:
        raise InputError(f"{path}: {size} bytes are no square of 16-bit steps; pass shape=(rows, columns)")
    rows, columns = shape or (side, side)
    if rows < 1 or columns < 1 or 2 * rows * columns != size:
        raise InputError(f"{path}: {size} bytes, but {rows} x {columns} steps of 16 bits are {2 * rows * columns}")
    require_memory((rows, columns), 20, what=f"{path}: a raster")
    return np.fromfile(path, "<u2").reshape(rows, columns), TOP


def write_heightmap(terrain: Terrain, path: Path, limits: tuple[float, float] | None, label: Path) -> None:
    """Write steps of height between ``limits``, by default the lowest and the highest; 0 is no data where there is any.

    Args:
        terrain: What to write.
        path: File to write; those that say where it lies are written beside it.
        limits: Heights of the first and the last step, m.
        label: What to call the file in messages.
    """
    height = terrain.to_numpy()
    gap = np.isnan(height)
    lowest, highest = float(np.nanmin(height)), float(np.nanmax(height))
    low, high = checked_limits(limits or (lowest, highest if highest > lowest else lowest + 1.0))
    if lowest < low or highest > high:
        raise InputError(
            f"{label}: heights from {lowest:g} to {highest:g} m do not fit into range=({low:g}, {high:g}); widen it"
        )
    first = int(gap.any())
    with np.errstate(invalid="ignore"):
        step = np.rint((height - low) * ((TOP - first) / (high - low))) + first
    step[gap] = 0.0
    place = (*terrain.origin, terrain.cell_size, terrain.cell_size)
    if path.suffix.lower() == PNG:
        (image,) = need(f"writing {path.suffix}", "PIL.Image")
        with in_memory(path) as buffer:
            image.fromarray(step.astype(np.uint16)).save(buffer, "PNG")
        write_world_file(path.with_suffix(WORLD_FILES[PNG]), place)
    else:
        # Not by tofile, which does not tell when its last bytes find no room.
        path.write_bytes(np.ascontiguousarray(step, "<u2").data)
        _write_header(terrain, path.with_suffix(".hdr"))
    rise = (high - low) / (TOP - first)
    # height = offset + scale * step
    told = {"Description": "height", "UnitType": "m", "Offset": repr(low - first * rise), "Scale": repr(rise)}
    told |= {"NoDataValue": "0"} if first else {}
    write_placing(path.with_name(f"{path.name}.aux.xml"), place, terrain.crs, told)
    side = {
        "metres_per_pixel": terrain.cell_size, "rows": terrain.shape[0], "columns": terrain.shape[1],
        "height_low": low, "height_high": high, "no_data": 0 if first else None,
        "origin": list(terrain.origin), "crs": terrain.crs,
        # A landscape of Unreal Engine at a scale of 100 has pixels of 1 m and 512 m between the first and last step.
        "unreal_scale_xy": 100.0 * terrain.cell_size, "unreal_scale_z": 100.0 * TOP * rise / 512.0,
    }  # fmt: skip
    side_file(path).write_text(json.dumps(side, indent=1) + "\n", encoding="utf-8")


def parts_of(path: Path) -> tuple[str, ...]:
    """Return the suffixes of the files that belong to a height map, in place of its own."""
    places = (WORLD_FILES[PNG],) if path.suffix.lower() == PNG else (".hdr",)
    return (*places, f"{path.suffix}.json", f"{path.suffix}.aux.xml")


def _write_header(terrain: Terrain, path: Path) -> None:
    """Write the header by which GDAL and ESRI's programs open a raw file."""
    (west, north), size, (rows, columns) = terrain.origin, float(terrain.cell_size), terrain.shape
    header = {
        "NROWS": rows, "NCOLS": columns, "NBANDS": 1, "NBITS": 16, "PIXELTYPE": "UNSIGNEDINT", "BYTEORDER": "I",
        "LAYOUT": "BIL", "ULXMAP": repr(west + 0.5 * size), "ULYMAP": repr(north - 0.5 * size),
        "XDIM": repr(size), "YDIM": repr(size),
    }  # fmt: skip
    path.write_text("".join(f"{key:<10} {value}\n" for key, value in header.items()), encoding="ascii")


def checked_limits(limits: Sequence[float]) -> tuple[float, float]:
    """Return (low, high) in m, or raise ``ValueError``."""
    try:
        low, high = (float(v) for v in limits)
    except (TypeError, ValueError) as error:
        raise InputError(f"range is {shown(limits)}; give range=(low, high) in m") from error
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"range is ({low:g}, {high:g}); give range=(low, high) in m with low below high")
    return low, high
