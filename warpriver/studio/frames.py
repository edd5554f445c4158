"""What the studio sends to its pages, as bytes: a header of little-endian numbers, then arrays.

A frame begins with its kind (uint32). STATE holds all channels, PATCH a window of a raster, LOOPS lines that are left
behind, MAP a map of the ground in steps of 1/254. Arrays of doubles come first, so that each array lies where a browser
can take it without a copy. Positions are float32, relative to the origin of the map that the page is told.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from warpriver.errors import InputError
from warpriver.raster import Raster

__all__ = [
    "LOOPS",
    "MAP",
    "PATCH",
    "RASTERS",
    "STATE",
    "State",
    "as_earlier",
    "decode_state",
    "encode_loops",
    "encode_map",
    "encode_patch",
    "encode_state",
]

STATE, PATCH, LOOPS, MAP = 1, 2, 3, 4
# Rasters of which a page holds a copy.
RASTERS = ("height", "control")
# kind, sequence, edits done, flags, channels, points, step, the greatest width in m; time in yr and ms a step. Flags
# are at byte FLAGS.
FLAGS = 12
_STATE = struct.Struct("<7Ifdd")
_PATCH = struct.Struct("<IIIIIIII")
_LOOPS = struct.Struct("<4I")
# kind, rows, columns; west and north relative to the origin, cell size, least and greatest value; the name follows.
_MAP = struct.Struct("<3I4x5d16s")
PLAYING, EARLIER, VARYING = 1, 2, 4
# Steps of the widths of points, and of the values of a map, whose last one stands for no data.
WIDTH_STEPS, MAP_STEPS = 65535, 254


@dataclasses.dataclass(frozen=True)
class State:
    """All channels at one time, as a page draws them.

    Attributes:
        sequence: Number of the frame.
        edits: Number of the last command that is in it.
        step: Steps done.
        time: yr.
        step_ms: What a step took, ms.
        playing: Whether the run goes on by itself.
        channel_id: (C,) float64, identities.
        channel_size: (C, 4) float32: width and depth in m, discharge in m3/s, Strahler order.
        channel_start: (C + 1,) uint32, offsets of the channels' points.
        point_xy: (P, 2) float32, m, relative to the origin of the map.
        point_width: (P,) widths in m, or None where they are constant along each channel; sent in steps of 1/65535 of
            the greatest one.
    """

    sequence: int
    edits: int
    step: int
    time: float
    step_ms: float
    playing: bool
    channel_id: np.ndarray
    channel_size: np.ndarray
    channel_start: np.ndarray
    point_xy: np.ndarray
    point_width: np.ndarray | None = None


def encode_state(state: State) -> bytes:
    """Return a state as bytes."""
    channels, points = len(state.channel_id), len(state.point_xy)
    widths, widest = b"", 0.0
    if state.point_width is not None and points:
        widest = float(state.point_width.max())
        widths = np.round(state.point_width * (WIDTH_STEPS / widest)).astype("<u2").tobytes()
    flags = PLAYING * state.playing + VARYING * bool(widths)
    head = _STATE.pack(
        STATE, state.sequence, state.edits, flags, channels, points, state.step, widest, state.time, state.step_ms
    )
    return b"".join(
        [
            head,
            np.ascontiguousarray(state.channel_id, "<f8").tobytes(),
            np.ascontiguousarray(state.channel_size, "<f4").tobytes(),
            np.ascontiguousarray(state.channel_start, "<u4").tobytes(),
            np.ascontiguousarray(state.point_xy, "<f4").tobytes(),
            widths,
        ]
    )


def as_earlier(frame: bytes) -> bytes:
    """Return the frame of a state marked as one that was asked for, and is not the present one."""
    marked = bytearray(frame)
    marked[FLAGS] |= EARLIER
    return bytes(marked)


def decode_state(frame: bytes) -> State:
    """Return the state that bytes hold; pages do the same in JavaScript.

    Raises:
        ValueError: They hold none, or are cut short.
    """
    if len(frame) < _STATE.size:
        raise InputError(f"a state of {len(frame)} bytes is shorter than its header")
    kind, sequence, edits, flags, channels, points, step, widest, time, step_ms = _STATE.unpack_from(frame)
    each = 10 if flags & VARYING else 8
    if kind != STATE or len(frame) != _STATE.size + channels * 24 + (channels + 1) * 4 + points * each:
        raise InputError(f"a frame of kind {kind} and {len(frame)} bytes is no state")
    at = _STATE.size

    def taken(kind: str, *shape: int) -> np.ndarray:
        nonlocal at
        count = int(np.prod(shape))
        array = np.frombuffer(frame, kind, count, at).reshape(shape)
        at += array.nbytes
        return array

    told = (taken("<f8", channels), taken("<f4", channels, 4), taken("<u4", channels + 1), taken("<f4", points, 2))
    widths = taken("<u2", points) * (widest / WIDTH_STEPS) if flags & VARYING else None
    return State(sequence, edits, step, time, step_ms, bool(flags & PLAYING), *told, widths)


def encode_patch(raster: str, window: Sequence[int], values: npt.NDArray[np.floating]) -> bytes:
    """Return a window of a raster as bytes.

    Args:
        raster: One of RASTERS.
        window: First row, first column, rows, columns.
        values: (rows, columns).
    """
    row, column, rows, columns = (int(v) for v in window)
    head = _PATCH.pack(PATCH, RASTERS.index(raster), row, column, rows, columns, 0, 0)
    return head + np.ascontiguousarray(values, "<f4").tobytes()


def encode_map(name: str, raster: Raster, low: float, high: float, origin: npt.NDArray[np.float64]) -> bytes:
    """Return a map of the ground as bytes: 0 to 254 from the least to the greatest value, 255 for no data.

    Args:
        name: Of the map, 16 letters at most.
        raster: The map.
        low: Value that 0 stands for.
        high: Value that 254 stands for.
        origin: Origin of the map, m.
    """
    (rows, columns), (west, north) = raster.shape, raster.origin
    values = np.asarray(raster.numpy(), np.float64)
    scaled = np.clip((values - low) / max(high - low, 1e-300), 0.0, 1.0) * MAP_STEPS
    steps = np.where(np.isfinite(values), np.round(scaled), MAP_STEPS + 1).astype(np.uint8)
    place = (west - origin[0], north - origin[1], raster.cell_size, low, high)
    return _MAP.pack(MAP, rows, columns, *place, name.encode()) + steps.tobytes()


def encode_loops(
    lines: Sequence[npt.NDArray[np.float64]],
    widths: Sequence[float],
    times: Sequence[float],
    kind: int,
    origin: npt.NDArray[np.float64],
) -> bytes:
    """Return lines that channels left behind as bytes.

    Args:
        lines: (n, 2) points each, m.
        widths: Of each line, m.
        times: When each was left, yr.
        kind: 0 for oxbow lakes, 1 for abandoned courses; 2 and 3 for these in place of all before.
        origin: Origin of the map, m.
    """
    points = np.concatenate([np.asarray(line) - origin for line in lines]) if lines else np.empty((0, 2))
    starts = np.cumsum([0, *map(len, lines)])
    head = _LOOPS.pack(LOOPS, kind, len(lines), len(points))
    return b"".join(
        [
            head,
            np.asarray(widths, "<f4").tobytes(),
            np.asarray(times, "<f4").tobytes(),
            starts.astype("<u4").tobytes(),
            np.ascontiguousarray(points, "<f4").tobytes(),
        ]
    )
