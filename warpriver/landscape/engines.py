"""Height maps of 16 bits, masks of materials and splines as game engines and 3-D programs take them.

A height map of an engine has a vertex at the centre of each outer cell of the terrain, and as many between them as the
engine wants; pixels need not be square. What to type into the importer stands in the JSON beside it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import ByteArray, FloatArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING, need
from warpriver.files import beside, in_memory
from warpriver.landscape.carving import Carved
from warpriver.landscape.scene_files import write_surfaces
from warpriver.landscape.splines import Placing, channel_splines, splines_as_json
from warpriver.landscape.surfaces import landscape_surfaces
from warpriver.raster import Raster

__all__ = ["ENGINES", "Engine", "engine_size", "write_engine"]


TOP, WHOLE = 65535, 255
# Unreal Engine: sides of a landscape, and quads of a component, of which the other side has a whole number.
UNREAL = {505: 126, 1009: 126, 2017: 126, 4033: 126, 8129: 127}
POWERS = (33, 65, 129, 257, 513, 1025, 2049, 4097)
# A landscape of Unreal Engine at a scale of 100 has a step of 1/128 m; step 32,768 is its own height.
UNREAL_STEPS, UNREAL_ZERO, CENTIMETERS = 128.0, 32768, 100.0
# Points of the ground in a mesh, and pixels that are worked at at a time.
MAX_POINTS, BLOCK = 500_000, 1_000_000


@dataclasses.dataclass(frozen=True)
class Engine:
    """What a program takes.

    Attributes:
        name: What it is called.
        sizes: Vertices along the longer side that it knows; none: any number.
        height: Suffixes of the height maps: .png and .r16.
        mesh: File of the water (of programs of any size: of all surfaces).
        packed: Whether masks are packed in the channels of one picture.
        first_row: Side that the first row of a .r16 lies on.
        axes: Axes of its coordinates, which splines are written in.
        unit: Units of length in a metre.
    """

    name: str
    sizes: tuple[int, ...]
    height: tuple[str, ...]
    mesh: str
    packed: bool = False
    first_row: str = "north"
    axes: str = "x east, y north, z up"
    unit: float = 1.0


ENGINES = {
    "unreal": Engine(
        "Unreal Engine", tuple(UNREAL), (".png",), "water.glb", axes="x east, y south, z up", unit=CENTIMETERS
    ),
    "unity": Engine(
        "Unity", POWERS, (".r16",), "water.obj", packed=True, first_row="south", axes="x east, y up, z north"
    ),
    "godot": Engine("Godot", POWERS, (".r16",), "water.glb", axes="x east, y up, z south"),
    "blender": Engine("Blender", (), (".png",), "landscape.glb"),
    "houdini": Engine("Houdini", (), (".png", ".r16"), "landscape.usda", axes="x east, y up, z south"),
}


def engine_size(engine: Engine, shape: tuple[int, int], size: int | None) -> tuple[int, int]:
    """Return rows and columns of the height map of a raster.

    Args:
        engine: Whose.
        shape: Rows and columns of the raster.
        size: Vertices along the longer side; None: as many as the raster has cells, or the next larger number.
    """
    longer = max(shape)
    if not engine.sizes:
        if size is None:
            return shape
        rows, columns = (max(2, round(n * size / longer)) for n in shape)
        return rows, columns
    if size is None:
        size = next((n for n in engine.sizes if n >= longer), engine.sizes[-1])
    if size not in engine.sizes:
        raise InputError(f"size is {size}; {engine.name} takes {', '.join(map(str, engine.sizes))}")
    if size not in UNREAL or engine.name != "Unreal Engine":
        return size, size
    quads = UNREAL[size]
    whole = (size - 1) // quads
    rows, columns = (quads * min(whole, max(1, -(-whole * n // longer))) + 1 for n in shape)
    return rows, columns


def write_engine(carved: Carved, folder: Path, name: str, size: int | None, maps: Mapping[str, Raster]) -> list[Path]:
    """Write all that an engine takes into a folder; return the files."""
    engine, terrain = ENGINES[name], carved.terrain
    shape = engine_size(engine, terrain.shape, size)
    height = without_gaps(terrain.to_numpy())
    low, high = float(height.min()), float(height.max())
    high = high if high > low else low + 1.0
    level = np.empty(shape, np.uint16)
    for rows in _blocks(shape):
        level[rows] = np.rint((resampled(height, shape, rows) - low) * (TOP / (high - low)))
    grid = _Grid(carved, shape, low, high)
    folder.mkdir(parents=True, exist_ok=True)
    files = [_write_height(folder / f"heightmap{suffix}", level, engine) for suffix in engine.height]
    masks, told = _write_masks(carved, folder, engine, shape, maps)
    splines = folder / "splines.json"
    mesh = folder / engine.mesh
    surfaces = landscape_surfaces(carved, max_points=MAX_POINTS)
    if engine.sizes:
        surfaces = [surface for surface in surfaces if surface.name != "terrain"]
    write_surfaces(surfaces, mesh, origin=grid.mesh_origin(engine), y_up=engine.axes.split(", ")[1] == "y up")
    about = grid.about(engine) | {"heightmap": [file.name for file in files], "masks": told, "mesh": mesh.name}
    _write_json(splines, grid.splines(engine))
    side = folder / "landscape.json"
    _write_json(side, about)
    return [*files, *masks, splines, mesh, side]


@dataclasses.dataclass(frozen=True)
class _Grid:
    """Where the vertices of a height map lie, and what its steps are."""

    carved: Carved
    shape: tuple[int, int]
    low: float
    high: float

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """(west, south, east, north) of the outer vertices, m."""
        terrain = self.carved.terrain
        west, south, east, north = terrain.bounds
        half = 0.5 * terrain.cell_size
        return west + half, south + half, east - half, north - half

    @property
    def pixel(self) -> tuple[float, float]:
        """Distance of vertices in x and y, m."""
        west, south, east, north = self.corners
        return (east - west) / (self.shape[1] - 1), (north - south) / (self.shape[0] - 1)

    def mesh_origin(self, engine: Engine) -> tuple[float, float]:
        """Return the place that is the zero of x and y."""
        west, south, _, north = self.corners
        return (west, north) if "south" in engine.axes else (west, south)

    def about(self, engine: Engine) -> dict[str, Any]:
        """Return what an importer asks for."""
        (dx, dy), rise = self.pixel, (self.high - self.low) / TOP
        west, south, east, north = self.corners
        told: dict[str, Any] = {
            "program": engine.name,
            "rows": self.shape[0],
            "columns": self.shape[1],
            "metres_per_pixel": [dx, dy],
            "height_low": self.low,
            "height_high": self.high,
            "first_row": {".png": "north", ".r16": engine.first_row},
            "r16": "unsigned, little-endian",
            "origin": list(self.mesh_origin(engine)),
            "axes": engine.axes,
            "units_per_metre": engine.unit,
            "crs": self.carved.terrain.crs,
            "corners": {"west": west, "south": south, "east": east, "north": north},
        }
        if engine.name == "Unreal Engine":
            told["import"] = {
                "scale": [CENTIMETERS * dx, CENTIMETERS * dy, CENTIMETERS * UNREAL_STEPS * rise],
                "location": [0.0, 0.0, CENTIMETERS * (self.low + UNREAL_ZERO * rise)],
            }
        elif engine.name == "Unity":
            told["import"] = {
                "depth": "16 bit",
                "byte_order": "Windows",
                "flip_vertically": False,
                "terrain_size": [east - west, self.high - self.low, north - south],
                "position": [0.0, self.low, 0.0],
            }
        elif engine.name == "Godot":
            told["import"] = {"scale": [dx, 1.0, dy], "min_height": self.low, "max_height": self.high}
        elif engine.name == "Blender":
            told["import"] = {"displace_strength": self.high - self.low, "mid_level": 0.0, "color_space": "Non-Color"}
        else:
            told["import"] = {"height_range": [self.low, self.high], "size": [east - west, north - south]}
        return told

    def splines(self, engine: Engine) -> dict[str, Any]:
        """Return the channels in the coordinates of an engine."""
        x, y = self.mesh_origin(engine)
        order: Placing = {
            "x east, y south, z up": lambda v: np.column_stack([v[:, 0], -v[:, 1], v[:, 2]]),
            "x east, y up, z north": lambda v: np.column_stack([v[:, 0], v[:, 2], v[:, 1]]),
            "x east, y up, z south": lambda v: np.column_stack([v[:, 0], v[:, 2], -v[:, 1]]),
            "x east, y north, z up": lambda v: v,
        }[engine.axes]

        def turn(vectors: FloatArray) -> FloatArray:
            return np.multiply(engine.unit, order(vectors))

        def place(points: FloatArray) -> FloatArray:
            return turn(points - [x, y, 0.0])

        channels = splines_as_json(channel_splines(self.carved.network), place, turn, engine.unit)
        return {
            "axes": engine.axes,
            "units_per_metre": engine.unit,
            "origin": [x, y],
            "crs": self.carved.terrain.crs,
            "tangents": "derivative of the curve from point to point, as Hermite splines take it",
            "channels": channels,
        }


# ---- pictures


def _write_height(path: Path, level: NDArray[np.uint16], engine: Engine) -> Path:
    with beside(path) as temporary:
        if path.suffix == ".png":
            _write_png(temporary, level)
        else:
            rows = level[::-1] if engine.first_row == "south" else level
            temporary.write_bytes(np.ascontiguousarray(rows, "<u2").tobytes())
    return path


def _write_png(path: Path, pixels: np.ndarray) -> None:
    (image,) = need("writing .png", "PIL.Image")
    with in_memory(path) as buffer:
        image.fromarray(pixels).save(buffer, "PNG")


def _write_masks(
    carved: Carved, folder: Path, engine: Engine, shape: tuple[int, int], maps: Mapping[str, Raster]
) -> tuple[list[Path], dict[str, Any]]:
    """Write the weights of materials, which add up to 255 in a pixel, and other maps; return files and contents."""
    names = list(carved.materials)
    known = np.isfinite(carved.terrain.to_numpy())
    found = [carved.materials[name].numpy() for name in names]
    # Where there is no ground it is called ground all the same: engines blend all pixels.
    found[names.index("ground")][~known] = WHOLE
    weight = np.empty((*shape, len(names)), np.uint8)
    for rows in _blocks(shape):
        weight[rows] = whole_weights(np.stack([resampled(values, shape, rows) for values in found], axis=-1))
    files: list[Path] = []
    told: dict[str, Any] = {}

    def write(file: str, pixels: np.ndarray) -> None:
        with beside(folder / file) as temporary:
            _write_png(temporary, pixels)
        files.append(folder / file)

    if engine.packed:
        packs = [names[k : k + 4] for k in range(0, len(names), 4)]
        for k, group in enumerate(packs):
            pixels = np.zeros((*shape, 4), np.uint8)
            for channel, name in enumerate(group):
                pixels[..., channel] = weight[..., names.index(name)]
                told[name] = {"file": f"control_{k}.png", "channel": "rgba"[channel]}
            write(f"control_{k}.png", pixels)
    else:
        for k, name in enumerate(names):
            write(f"mask_{name}.png", weight[..., k])
            told[name] = {"file": f"mask_{name}.png"}
    for name, raster in maps.items():
        if raster.is_integer:
            # Kinds, of which there is nothing in between.
            at = [np.rint(np.linspace(0, n - 1, m)).astype(int) for n, m in zip(raster.shape, shape, strict=True)]
            write(f"map_{name}.png", raster.numpy()[np.ix_(*at)].astype(np.uint8))
            told[name] = {"file": f"map_{name}.png", "values": "as they are"}
            continue
        values = without_gaps(raster.numpy().astype(np.float64))
        low, high = float(values.min()), float(values.max())
        part = (values - low) / (high - low if high > low else 1.0)
        pixels = np.empty(shape, np.uint8)
        for rows in _blocks(shape):
            pixels[rows] = np.rint(WHOLE * resampled(part, shape, rows))
        write(f"map_{name}.png", pixels)
        told[name] = {"file": f"map_{name}.png", "low": low, "high": high, "unit": raster.unit}
    return files, told


def whole_weights(stack: FloatArray) -> ByteArray:
    """Return weights, (..., K), as whole numbers that add up to 255; what is left by rounding goes to the greatest."""
    total = stack.sum(axis=-1, keepdims=True)
    scaled = stack * (WHOLE / np.maximum(total, 1e-300))
    whole = np.floor(scaled)
    rest = WHOLE - whole.sum(axis=-1)
    np.put_along_axis(
        whole,
        scaled.argmax(axis=-1)[..., None],
        np.take_along_axis(whole, scaled.argmax(axis=-1)[..., None], axis=-1) + rest[..., None],
        axis=-1,
    )
    weights: ByteArray = whole.astype(np.uint8)
    return weights


def resampled(values: NDArray[Any], shape: tuple[int, int], rows: slice = slice(None)) -> FloatArray:
    """Return values at vertices spread evenly from the first row and column to the last ones, bilinear.

    Args:
        values: (r, c) numbers.
        shape: Rows and columns of the vertices.
        rows: The rows of them that are wanted.
    """
    out = values
    for axis, wanted in ((0, rows), (1, slice(None))):
        count = out.shape[axis]
        at = np.linspace(0.0, count - 1.0, shape[axis])[wanted]
        low = np.minimum(at.astype(np.int64), count - 2)
        part = np.expand_dims(at - low, 1 - axis)
        before, behind = (np.take(out, k, axis=axis).astype(np.float64) for k in (low, low + 1))
        out = before + part * (behind - before)
    return out


def _blocks(shape: tuple[int, int]) -> Iterator[slice]:
    """Yield rows, some at a time: rasters of engines are large, and what is computed on the way is larger."""
    step = max(1, BLOCK // shape[1])
    for first in range(0, shape[0], step):
        yield slice(first, min(first + step, shape[0]))


def without_gaps(values: FloatArray) -> FloatArray:
    """Return values in which cells without data have that of the nearest cell with some."""
    gap = np.isnan(values)
    if not gap.any() or gap.all():
        return np.nan_to_num(values, nan=0.0)
    with IMPORTING:
        from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(gap, return_distances=False, return_indices=True)
    found: FloatArray = values[tuple(nearest)]
    return found


def _write_json(path: Path, content: Any) -> None:
    with beside(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
