"""A riverscape's water for other programs: rasters frame by frame, and flow maps for game engines."""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import pathlib
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FloatArray
from warpriver.errors import InputError, MissingExtraError, OutputExistsError, PathError
from warpriver.extras import need
from warpriver.files import beside
from warpriver.io.raster.terrains import write_raster, write_terrain
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.riverscape.scene import Frame, Riverscape
from warpriver.terrain import Terrain
from warpriver.validate import one_of

__all__ = ["FlowMap", "read_flow_map", "write_frames"]


# Which way the green channel points in the pictures that a program reads: its texture's v runs down or up.
PRESETS = {"unreal": "south", "unity": "north"}
# Formats that are not rasters of one field each.
EXR, ZARR, HEIGHT_MAPS = ".exr", ".zarr", (".png", ".r16", ".raw")
# What the fields are called in EXR files.
CHANNELS = {
    "elevation": "elevation",
    "depth": "depth",
    "east": "velocity.x",
    "north": "velocity.y",
    "effervescence": "foam",
}
# What a frame is written as: name, unit.
FIELDS = (("elevation", "m"), ("depth", "m"), ("east", "m/s"), ("north", "m/s"), ("effervescence", ""))


@dataclasses.dataclass(frozen=True, eq=False)
class FlowMap:
    """Velocity, foam and depth of the water as the four channels of a picture.

    Red and green are velocity: value = (channel - zero) / steps * greatest speed, so that still water is 0 exactly, and
    speed is kept. Blue is foam, alpha the depth over the greatest, both 0 to 1 over all values of the channel.

    Attributes:
        pixel: (rows, columns, 4) of 8 or 16 bits.
        told: What the side file says: ranges, zero, axes, place, and how to decode.
    """

    pixel: NDArray[np.uint8] | NDArray[np.uint16]
    told: dict[str, Any]

    @staticmethod
    @public
    def of(
        scene: Riverscape,
        bounds: Sequence[float] | FloatArray | None = None,
        cell_size: float = 0.25,
        *,
        time: float = 0.0,
        preset: str = "unreal",
        bits: int = 8,
    ) -> FlowMap:
        """Make the flow map of a scene.

        Args:
            scene: The riverscape.
            bounds: (west, south, east, north) in m; by default those of the terrain.
            cell_size: m a pixel.
            time: Of foam and depth, s; the velocity does not change.
            preset: "unreal", where green points down the picture, or "unity", where it points up.
            bits: 8 or 16 a channel.

        Raises:
            ValueError: No such grid, or another preset or number of bits.
        """
        one_of(preset, "preset", tuple(PRESETS))
        one_of(bits, "bits", (8, 16))
        (frame,) = scene.frames(bounds, cell_size, [time])
        velocity = frame.water.velocity.numpy().astype(np.float64)
        depth = frame.depth
        velocity[depth <= 0.0] = 0.0
        foam = np.where(depth > 0.0, frame.water.effervescence.numpy(), 0.0)
        zero, most = 2 ** (bits - 1), 2**bits - 1
        steps = zero - 1
        speed, deepest = float(np.abs(velocity).max()), float(depth.max())
        sign = -1.0 if PRESETS[preset] == "south" else 1.0
        scaled = velocity * (1.0, sign) / (speed or 1.0)
        kind = np.uint8 if bits == 8 else np.uint16
        pixel = np.empty((*depth.shape, 4), kind)
        pixel[..., :2] = zero + np.round(steps * scaled)
        pixel[..., 2] = np.round(most * np.clip(foam, 0.0, 1.0))
        pixel[..., 3] = np.round(most * depth / (deepest or 1.0))
        west, north = frame.water.origin
        told = {
            "preset": preset,
            "bits": bits,
            "red": {"is": "velocity to the east", "unit": "m/s", "zero": zero, "steps": steps, "range": speed},
            "green": {
                "is": f"velocity to the {PRESETS[preset]}",
                "unit": "m/s",
                "zero": zero,
                "steps": steps,
                "range": speed,
            },
            "blue": {"is": "foam", "unit": "1", "range": 1.0},
            "alpha": {"is": "depth of the water", "unit": "m", "range": deepest},
            "decode": "red, green: (channel - zero) / steps * range; blue, alpha: channel / (2^bits - 1) * range",
            "color_space": "linear: read it without sRGB and without compression that mixes channels",
            "meters_per_pixel": frame.water.cell_size,
            "west": west,
            "north": north,
            "rows": "from north to south",
            "crs": scene.terrain.raster.crs,
        }
        return FlowMap(pixel, told)

    @property
    def velocity(self) -> FloatArray:
        """(rows, columns, 2) decoded velocity to the east and north, m/s."""
        red = self.told["red"]
        value = (self.pixel[..., :2].astype(np.float64) - red["zero"]) / red["steps"] * red["range"]
        return np.asarray(value * (1.0, -1.0 if self.told["green"]["is"].endswith("south") else 1.0))

    @property
    def foam(self) -> FloatArray:
        """(rows, columns) decoded foam, 0 to 1."""
        return np.asarray(self.pixel[..., 2] / (2.0 ** self.told["bits"] - 1.0))

    @property
    def depth(self) -> FloatArray:
        """(rows, columns) decoded depth, m."""
        share = self.pixel[..., 3] / (2.0 ** self.told["bits"] - 1.0)
        return np.asarray(share * self.told["alpha"]["range"])

    @public
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the picture, and what it means as JSON beside it.

        Args:
            path: File to write, ``.png``; ``.png.json`` is added for the other.

        Raises:
            ValueError: Another suffix.
            OSError: The files cannot be written.
        """
        target = pathlib.Path(path)
        if target.suffix.lower() != ".png":
            raise InputError(f"{target} ends in {target.suffix or 'nothing'}; a flow map is a .png")
        side = f"{target.suffix}.json"
        with beside(target, (side,)) as temporary:
            temporary.write_bytes(_png(self.pixel))
            temporary.with_suffix(side).write_text(json.dumps(self.told, indent=1) + "\n")

    def __repr__(self) -> str:
        rows, columns = self.pixel.shape[:2]
        return (
            f"FlowMap({rows} x {columns} pixels of {self.told['meters_per_pixel']:g} m, {self.told['preset']}, "
            f"to {self.told['red']['range']:.3g} m/s, {self.told['alpha']['range']:.3g} m deep)"
        )


@public
def read_flow_map(path: str | os.PathLike[str]) -> FlowMap:
    """Read a flow map that :meth:`FlowMap.save` wrote.

    Args:
        path: The ``.png``, with its ``.png.json`` beside it.

    Raises:
        OSError: A file is missing.
        ValueError: It is no such picture.
    """
    source = pathlib.Path(path)
    try:
        data = source.read_bytes()
        told = json.loads(source.with_suffix(f"{source.suffix}.json").read_text())
    except OSError as error:
        raise PathError.of(error, f"cannot read the flow map {source}") from error
    except ValueError as error:
        raise InputError(f"{source}: the .json beside it cannot be read ({error})") from error
    try:
        return FlowMap(_pixels(data), told)
    except (struct.error, zlib.error, ValueError, KeyError) as error:
        raise InputError(f"{source} is no flow map ({error}); FlowMap.save writes one") from error


@public
def write_frames(
    scene: Riverscape,
    folder: str | os.PathLike[str],
    *,
    times: Sequence[float] | FloatArray,
    cell_size: float,
    bounds: Sequence[float] | FloatArray | None = None,
    loop: float | None = None,
    suffix: str = ".tif",
) -> list[pathlib.Path]:
    """Write the water frame by frame, and the bed once.

    =============== ===============================================================================================
    .tif, .npz ...  rasters, any that :func:`warpriver.io.write_raster` knows: ``bed`` and, of each frame,
                    ``0007_elevation`` (NaN where there is no water), ``0007_depth``, ``0007_east`` and ``0007_north``
                    of the velocity, ``0007_effervescence``
    .png, .r16      the same as height maps of 16 bits, with their range in the .json beside each; the elevation is that
                    of the bed where there is no water
    .exr            ``bed.exr``, and of each frame one ``0007.exr`` with the channels elevation, depth, velocity.x,
                    velocity.y and foam, 32 bits (``warpriver[exr]``)
    .zarr           ``frames.zarr``, all frames in one store of dimensions (time, y, x) that opens in xarray
                    (``warpriver[zarr]``)
    =============== ===============================================================================================

    Args:
        scene: The riverscape.
        folder: Where files go; it is made if need be.
        times: s.
        cell_size: m.
        bounds: (west, south, east, north) in m; by default those of the terrain.
        loop: Period in s after which the water repeats itself without a seam; by default it never does.
        suffix: Of the files.

    Returns:
        The files.

    Raises:
        ImportError: The format needs a module that is not installed.
        ValueError: No such grid, or an unknown suffix.
        OSError: A file cannot be written.
    """
    target = pathlib.Path(folder)
    kind = str(suffix).lower()
    exr = _openexr() if kind == EXR else None
    frames = scene.frames(bounds, cell_size, times, loop=loop)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PathError.of(error, f"cannot make the folder {target}") from error
    if kind == ZARR:
        return [_write_store(scene, frames, target / f"frames{ZARR}")]
    written: list[pathlib.Path] = []
    for number, frame in enumerate(frames):
        rasters = frame_rasters(frame, scene.terrain)
        named = {f"{number:04d}_{name}": raster for name, raster in rasters.items()}
        if number == 0:
            named = {"bed": _bed_raster(frame, scene.terrain)} | named
        if exr is not None:
            written += _write_exr(exr, target, number, named)
            continue
        for name, raster in named.items():
            path = target / f"{name}{suffix}"
            if kind in HEIGHT_MAPS:
                values = raster.numpy()
                if name.endswith("_elevation"):
                    values = np.where(np.isnan(values), frame.bed.numpy(), values)
                write_terrain(Terrain(values, raster.cell_size, raster.origin, raster.crs), path)
            else:
                write_raster(raster, path)
            written.append(path)
    return written


def _bed_raster(frame: Frame, terrain: Terrain) -> Raster:
    return Raster(frame.bed.numpy(), frame.water.cell_size, frame.water.origin, terrain.raster.crs, "m", "bed")


def _openexr() -> Any:
    try:
        return importlib.import_module("OpenEXR")
    except ImportError as error:
        raise MissingExtraError("EXR files need OpenEXR: pip install 'warpriver[exr]'") from error


def _write_exr(exr: Any, folder: pathlib.Path, number: int, named: dict[str, Raster]) -> list[pathlib.Path]:
    """Write the bed, if it is among them, and a frame with a channel for each field."""
    written = []
    frame = {CHANNELS[name.partition("_")[2]]: raster for name, raster in named.items() if name != "bed"}
    for name, fields in (("bed", {"Y": named["bed"]} if "bed" in named else {}), (f"{number:04d}", frame)):
        if not fields:
            continue
        first = next(iter(fields.values()))
        header = {
            "compression": exr.ZIP_COMPRESSION,
            "type": exr.scanlineimage,
            "comments": json.dumps(
                {
                    "west": first.origin[0],
                    "north": first.origin[1],
                    "meters_per_pixel": first.cell_size,
                    "crs": first.crs,
                    "unit": "m, m/s",
                }
            ),
        }
        channels = {channel: raster.numpy().astype(np.float32) for channel, raster in fields.items()}
        path = folder / f"{name}{EXR}"
        with beside(path) as temporary:
            exr.File(header, channels).write(str(temporary))
        written.append(path)
    return written


def _write_store(scene: Riverscape, frames: Iterator[Frame], path: pathlib.Path) -> pathlib.Path:
    """Write frames into a Zarr store, one after the other."""
    xarray, _ = need("write_frames", "xarray", "zarr")
    if path.exists():
        raise OutputExistsError(f"{path} exists; name another folder")
    try:
        for number, frame in enumerate(frames):
            fields = {name: raster.to_xarray() for name, raster in frame_rasters(frame, scene.terrain).items()}
            made = xarray.Dataset(fields).expand_dims(time=[frame.time])
            made["time"].attrs["long_name"] = "time in s"
            if number:
                # What has no time is there already.
                plain = [name for name in made.variables if "time" not in made[name].dims]
                made.drop_vars(plain).to_zarr(os.fspath(path), append_dim="time", consolidated=False)
            else:
                made = made.assign(bed=_bed_raster(frame, scene.terrain).to_xarray())
                made.to_zarr(os.fspath(path), mode="w-", consolidated=False)
    except OSError as error:
        raise PathError.of(error, f"cannot write {path}") from error
    return path


def frame_rasters(frame: Frame, terrain: Terrain) -> dict[str, Raster]:
    """Return the fields of a frame as rasters; water that lies below the bed is no water."""
    depth = frame.depth
    dry = depth <= 0.0
    velocity = frame.water.velocity.numpy().astype(np.float64)
    values = {
        "elevation": np.where(dry, np.nan, frame.water.elevation.numpy()),
        "depth": depth,
        "east": np.where(dry, 0.0, velocity[..., 0]),
        "north": np.where(dry, 0.0, velocity[..., 1]),
        "effervescence": np.where(dry, 0.0, frame.water.effervescence.numpy()),
    }
    place = (frame.water.cell_size, frame.water.origin, terrain.raster.crs)
    return {name: Raster(values[name], *place, unit, name) for name, unit in FIELDS}


def _png(pixel: NDArray[Any]) -> bytes:
    """A picture of four channels of 8 or 16 bits; other writers have no 16."""
    rows, columns, _ = pixel.shape
    depth = 8 * pixel.dtype.itemsize
    lines = np.ascontiguousarray(pixel.astype(pixel.dtype.newbyteorder(">"))).view(np.uint8).reshape(rows, -1)
    # Each line begins with its filter: none.
    body = np.concatenate([np.zeros((rows, 1), np.uint8), lines], axis=1).tobytes()

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", columns, rows, depth, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(body, 6)) + chunk(b"IEND", b"")


def _pixels(data: bytes) -> NDArray[Any]:
    """The pixels of a picture that ``_png`` wrote."""
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise InputError("no PNG")
    columns, rows, depth, color, *_ = struct.unpack(">IIBBBBB", data[16:29])
    at, body = 8, b""
    while at < len(data):
        (size,) = struct.unpack(">I", data[at : at + 4])
        if data[at + 4 : at + 8] == b"IDAT":
            body += data[at + 8 : at + 8 + size]
        at += 12 + size
    if color != 6 or depth not in (8, 16):
        raise InputError("not four channels of 8 or 16 bits")
    lines = np.frombuffer(zlib.decompress(body), np.uint8).reshape(rows, -1)
    if lines[:, 0].any():
        raise InputError("lines are filtered")
    kind = np.dtype(np.uint8 if depth == 8 else ">u2")
    plain = np.ascontiguousarray(lines[:, 1:]).view(kind).reshape(rows, columns, 4)
    return plain.astype(kind.newbyteorder("="))
