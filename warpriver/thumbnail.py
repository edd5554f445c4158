"""What a notebook shows of networks, terrains, rasters and runs: a small picture beside a few facts.

NumPy alone draws, so that it is there without the extra "viz" and as fast as a ``repr`` should be; maps to keep are
those of :mod:`warpriver.viz`.
"""

from __future__ import annotations

import base64
import html
import struct
import zlib
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FlagArray

__all__ = ["LAKE", "SAND", "WATER", "card", "lines_picture", "png_of", "raster_picture"]

Pixels = NDArray[np.uint8]
Color = tuple[int, int, int]

# Longer side of a picture in pixels, shorter side at least, samples a pixel and direction, and empty pixels around.
LONG, SHORT, FINE, RIM = 420, 60, 2, 6
# Points of lines that are drawn at most; others are passed over evenly.
MAX_POINTS = 300_000
GROUND: Color = (244, 242, 234)
WATER: Color = (61, 126, 166)
LAKE: Color = (134, 174, 174)
SAND: Color = (214, 203, 160)
# From low to high.
HEIGHTS = ((82, 110, 96), (150, 165, 120), (205, 190, 145), (176, 146, 118), (240, 236, 230))
VALUES = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))


def card(kind: str, facts: Mapping[str, str], picture: bytes) -> str:
    """Return HTML with a picture (PNG) beside a table of facts."""
    left = 'style="text-align:left"'
    rows = "".join(
        f"<tr><th {left}>{html.escape(name)}</th><td {left}>{html.escape(text)}</td></tr>"
        for name, text in facts.items()
    )
    source = base64.b64encode(picture).decode()
    return (
        f'<div style="display:flex;gap:1em;align-items:flex-start"><img src="data:image/png;base64,{source}" '
        f'alt="{html.escape(kind)}"/><div><b>{html.escape(kind)}</b><table>{rows}</table></div></div>'
    )


def png_of(pixels: Pixels) -> bytes:
    """Return (rows, columns, 3) colours as a PNG file."""
    rows, columns = pixels.shape[:2]
    lines = np.zeros((rows, 1 + 3 * columns), np.uint8)  # each begins with the number of its filter, 0 for none
    lines[:, 1:] = pixels.reshape(rows, -1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(lines.tobytes(), 6)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def raster_picture(values: np.ndarray, cell_size: float, *, heights: bool) -> Pixels:
    """Return a picture of cells, row 0 in the north, (rows, columns, 3); white without data.

    Args:
        values: (rows, columns) numbers.
        cell_size: Side of a cell in m.
        heights: Shade them as ground.
    """
    step = max(1, -(-max(values.shape) // LONG))
    coarse = np.asarray(values[step // 2 :: step, step // 2 :: step], np.float64)
    known = np.isfinite(coarse)
    if not known.any():
        return np.full((*coarse.shape, 3), 255, np.uint8)
    low, high = np.percentile(coarse[known], (1.0, 99.0))
    fraction = np.clip((np.where(known, coarse, low) - low) / max(high - low, 1e-300), 0.0, 1.0)
    ramp = np.array(HEIGHTS if heights else VALUES, np.float64)
    at = np.linspace(0.0, 1.0, len(ramp))
    color = np.stack([np.interp(fraction, at, ramp[:, k]) for k in range(3)], axis=-1)
    if heights and min(coarse.shape) > 1:
        south, east = np.gradient(np.where(known, coarse, low), step * cell_size)
        steep = max(float(np.percentile(np.hypot(south, east), 90.0)), 1e-12)
        # Light from the north-west, 45 degrees high, on slopes of which the steeper ones are about 0.6.
        south, east = 0.6 * south / steep, 0.6 * east / steep
        light = (1.0 + (east + south) / np.sqrt(2.0)) / np.sqrt(1.0 + east**2 + south**2)
        color *= np.clip(1.0 + 0.6 * (light - 1.0), 0.4, 1.15)[..., None]
    color[~known] = 255.0
    shown: Pixels = np.clip(color, 0.0, 255.0).astype(np.uint8)
    return shown


def lines_picture(layers: Sequence[tuple[Sequence[np.ndarray], Sequence[float], Color]]) -> Pixels:
    """Return a picture of lines, north up, (rows, columns, 3).

    Args:
        layers: Lines (n, 2) in m, their widths in m, and a colour; later ones lie on top.
    """
    everything = [xy for lines, _, _ in layers for xy in lines]
    low = np.min([xy.min(axis=0) for xy in everything], axis=0)
    high = np.max([xy.max(axis=0) for xy in everything], axis=0)
    span = np.maximum(high - low, 1e-3 * float((high - low).max()) + 1e-9)
    size = float(span.max()) / (LONG - 2 * RIM)
    columns, rows = (max(SHORT, int(np.ceil(s / size)) + 2 * RIM) for s in span)
    middle = 0.5 * (low + high)
    corner = np.array([middle[0] - 0.5 * columns * size, middle[1] + 0.5 * rows * size])
    pixels = np.full((rows, columns, 3), GROUND, np.float64)
    for lines, widths, color in layers:
        ink = np.zeros((FINE * rows, FINE * columns), bool)
        reach = np.clip(np.round(0.5 * np.asarray(widths, np.float64) * FINE / size), 1, 5 * FINE).astype(int)
        for wide in np.unique(reach):
            chosen = [xy for xy, r in zip(lines, reach, strict=True) if r == wide]
            ink |= _thickened(_traced(chosen, corner, size / FINE, ink.shape), int(wide))
        cover = ink.reshape(rows, FINE, columns, FINE).mean(axis=(1, 3))[..., None]
        pixels += cover * (np.array(color) - pixels)
    return np.clip(np.round(pixels), 0.0, 255.0).astype(np.uint8)


def _traced(lines: Sequence[np.ndarray], corner: np.ndarray, size: float, shape: tuple[int, int]) -> FlagArray:
    """Return which samples lines pass through."""
    stride = max(1, sum(map(len, lines)) // MAX_POINTS)
    lines = [xy if stride == 1 else np.concatenate([xy[:-1:stride], xy[-1:]]) for xy in lines]
    begin = np.concatenate([xy[:-1] for xy in lines])
    way = np.concatenate([np.diff(xy, axis=0) for xy in lines])
    counts = np.maximum(1, np.ceil(np.abs(way).max(axis=1) / size)).astype(np.int64)
    segment = np.repeat(np.arange(len(way)), counts)
    along = (np.arange(len(segment)) - (np.cumsum(counts) - counts)[segment] + 0.5) / counts[segment]
    xy = begin[segment] + along[:, None] * way[segment]
    column, row = np.floor((xy[:, 0] - corner[0]) / size), np.floor((corner[1] - xy[:, 1]) / size)
    ink = np.zeros(shape, bool)
    ink[np.clip(row, 0, shape[0] - 1).astype(int), np.clip(column, 0, shape[1] - 1).astype(int)] = True
    return ink


def _thickened(ink: FlagArray, reach: int) -> FlagArray:
    """Return samples within a distance of those that are set, in a square."""
    for axis in (0, 1):
        wide = ink.copy()
        for shift in range(1, reach + 1):
            head, tail = [slice(None)] * 2, [slice(None)] * 2
            head[axis], tail[axis] = slice(shift, None), slice(None, -shift)
            wide[tuple(head)] |= ink[tuple(tail)]
            wide[tuple(tail)] |= ink[tuple(head)]
        ink = wide
    return ink
