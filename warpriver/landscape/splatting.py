"""Splatting: courses of moving channels onto the cells of a raster, summed over time."""

from __future__ import annotations

import dataclasses
import itertools
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from warpriver.device import PRECISIONS, launch_kernel, require_memory, resolve_device
from warpriver.kernels import covers
from warpriver.kernels import splat as kernels
from warpriver.network import RiverNetwork

__all__ = ["Frame", "Segments", "Splat", "curvature_of", "sections_of", "segments_of"]

BLOCK, TILE = kernels.BLOCK, kernels.TILE
# Memory of the state of a cell, and of the arrays of its maps while they are made.
CELL_BYTES = 260
# What ``Cells.left`` is where no channel has been, yr.
LEFT_NEVER = -1.0e30


@dataclasses.dataclass(frozen=True)
class Segments:
    """Segments of courses.

    Attributes:
        line: (S, 4) x and y of begin and end, m.
        section: (S, 4) width and depth of begin and end, m.
        bend: (S, 2) width times curvature at begin and end; of a course that was given up the distance from its nearer
            end in widths.
        time: (S,) when the course was given up, yr; empty for present ones.
    """

    line: np.ndarray
    section: np.ndarray
    bend: np.ndarray
    time: np.ndarray


def segments_of(network: RiverNetwork) -> Segments:
    """Return the segments of a network."""
    start = network.starts().astype(np.int64)
    head = np.delete(np.arange(start[-1]), start[1:] - 1)
    tail = head + 1
    closed = np.flatnonzero(network.channel_closed)
    head, tail = np.concatenate([head, start[closed + 1] - 1]), np.concatenate([tail, start[closed]])
    xy, section = network.points(), sections_of(network)
    bend = section[:, 0] * curvature_of(xy, start, network.channel_closed)
    line, form = np.hstack([xy[head], xy[tail]]), np.hstack([section[head], section[tail]])
    return Segments(line, form, np.stack([bend[head], bend[tail]], axis=1), np.empty(0))


def sections_of(network: RiverNetwork) -> np.ndarray:
    """Return width and depth at each point, (P, 2) m."""
    if network.point_section is not None:
        return network.point_section[: network.point_count].numpy().astype(np.float64)
    constant = np.stack([network.channel_width, network.channel_depth], axis=1)
    return np.repeat(constant, np.diff(network.starts()), axis=0).astype(np.float64)


def curvature_of(xy: np.ndarray, start: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """Return the curvature of lines at their points, that of the circle through three of them; left > 0, 1/m.

    The ends of a line that is no ring have that of the points beside them.
    """
    before, after = np.roll(np.arange(len(xy)), 1), np.roll(np.arange(len(xy)), -1)
    first, last = start[:-1], start[1:] - 1
    before[first], after[last] = last, first
    a, b = xy - xy[before], xy[after] - xy
    size = np.hypot(*a.T) * np.hypot(*b.T) * np.hypot(*(a + b).T)
    turn = 2.0 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / np.maximum(size, 1e-30)
    lines = ~closed
    turn[first[lines]], turn[last[lines]] = turn[after[first[lines]]], turn[before[last[lines]]]
    return turn


class Frame:
    """A course on the device, with its segments by blocks of cells.

    Attributes:
        course: ``kernels.Course``.
        bins: ``kernels.Bins``; the tiles are those that were worked at.
        count: Number of segments.
        blocks: (B,) blocks that hold any, ascending.
        widest: Greatest width, m.
    """

    course: Any
    bins: Any
    count: int
    blocks: np.ndarray
    widest: float


class Splat:
    """Cells of a raster over which courses are led, one after the other.

    Attributes:
        shape: Rows and columns.
        cells: ``kernels.Cells``, the state of the cells.
        touched: Cells worked at so far, those of each interval counted anew.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        cell_size: float,
        origin: tuple[float, float],
        tables: tuple[np.ndarray, np.ndarray],
        *,
        device: Any = "cpu",
        dtype: str = "float64",
        threads: int | None = None,
    ):
        """Make empty cells.

        Args:
            shape: Rows and columns.
            cell_size: Side of a cell, m.
            origin: (west, north), m.
            tables: The falloffs of moisture and of sediment, from ``falloff_table``.
            device: Warp device.
            dtype: Precision of positions and distances.
            threads: Threads on the CPU, by default one for each core.
        """
        self.shape, self.device = shape, resolve_device(device)
        require_memory(shape, CELL_BYTES, self.device, "landscape maps")
        self._scalar, self._real = PRECISIONS[dtype][0], np.dtype(dtype)
        self._kernel = kernels.build(self._scalar)
        self._zero = np.array([origin[0] + 0.5 * cell_size, origin[1] - 0.5 * cell_size])
        grid = self._kernel.Grid()
        grid.rows, grid.columns, grid.cell_size = shape[0], shape[1], cell_size
        grid.block_rows, grid.block_columns = (-(-n // BLOCK) for n in shape)
        self._grid = grid
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._threads = max(1, threads if threads is not None else cores) if self.device.is_cpu else 1
        self.cells = self._kernel.Cells()
        self.cells.offset = wp.full(shape, covers.FELT + 1.0, dtype=self._scalar, device=self.device)
        for name in ("moisture", "sediment", "deep", "occupied"):
            setattr(self.cells, name, wp.zeros(shape, dtype=wp.int64, device=self.device))
        self.cells.left = wp.full(shape, LEFT_NEVER, dtype=wp.float64, device=self.device)
        self.cells.section = wp.zeros(shape, dtype=wp.vec2f, device=self.device)
        self.cells.kind = wp.zeros(shape, dtype=wp.uint8, device=self.device)
        for name in ("inner", "lobe", "across"):
            setattr(self.cells, name, wp.zeros(shape, dtype=wp.float32, device=self.device))
        self._interval = self._kernel.Interval()
        for name, table in zip(("moisture", "sediment"), tables, strict=True):
            profile = self._kernel.Profile()
            profile.node = wp.array(table.astype(self._real), dtype=self._kernel.vec2, device=self.device)
            profile.per_width = (len(table) - 1) / covers.FELT
            setattr(self._interval, name, profile)
        self.touched = 0
        self._widest = 0.0
        self._last: Frame | None = None
        self._time = 0.0

    # ---- frames

    def frame(self, segments: Segments) -> Frame:
        """Bring segments to the device and list them by blocks."""
        made, kernel, device = Frame(), self._kernel, self.device
        line, section = segments.line, segments.section
        made.count = count = len(line)
        made.widest = float(section[:, ::2].max()) if count else 0.0
        vec2, vec4 = kernel.vec2, kernel.vec4
        course = made.course = kernel.Course()
        way = line[:, 2:] - line[:, :2]
        size = (way**2).sum(axis=1)
        change = section[:, 2] - section[:, 0]
        form = [1.0 / np.maximum(size, 1e-30), section[:, 0], change, np.minimum(section[:, 0], section[:, 2])]
        placed = np.hstack([line[:, :2] - self._zero, way])
        course.line = wp.array(placed.astype(self._real), dtype=vec4, device=device)
        course.form = wp.array(np.stack(form, axis=1).astype(self._real), dtype=vec4, device=device)
        course.depth = wp.array(section[:, 1::2].astype(self._real), dtype=vec2, device=device)
        course.bend = wp.array(segments.bend.astype(self._real), dtype=vec2, device=device)
        course.moved = wp.zeros(count, dtype=vec2, device=device)
        blocks = self._grid.block_rows * self._grid.block_columns
        ends = wp.zeros(count, dtype=wp.int32, device=device)
        launch_kernel(kernel.count_blocks, count, [course, self._grid], [ends], device=device)
        wp.utils.array_scan(ends, ends, inclusive=True)
        pairs = int(ends[-1:].numpy()[0]) if count else 0
        keys = wp.empty(2 * max(pairs, 1), dtype=wp.int32, device=device)
        values = wp.empty(2 * max(pairs, 1), dtype=wp.int32, device=device)
        if pairs:
            launch_kernel(kernel.list_blocks, count, [course, self._grid, ends], [keys, values], device=device)
            wp.utils.radix_sort_pairs(keys, values, pairs)
        made.bins = kernel.Bins()
        made.bins.block_start = wp.empty(blocks + 1, dtype=wp.int32, device=device)
        made.bins.block_segment = values
        launch_kernel(kernel.find_starts, blocks + 1, [keys, pairs], [made.bins.block_start], device=device)
        made.blocks = np.flatnonzero(np.diff(made.bins.block_start.numpy()))
        return made

    def _take_tiles(self, frame: Frame, blocks: np.ndarray) -> None:
        """Let a frame work at the tiles of some blocks."""
        side, across = kernels.TILES_IN_BLOCK, self._grid.block_columns
        row, column = side * (blocks // across), side * (blocks % across)
        inner = np.arange(side)
        rows = row[:, None, None] + inner[None, :, None]
        columns = column[:, None, None] + inner[None, None, :]
        within = (rows * TILE < self.shape[0]) & (columns * TILE < self.shape[1])
        tile = (rows * (across * side) + columns)[within].astype(np.int32)
        slot = np.full(self._grid.block_rows * across * side**2, -1, np.int32)
        slot[tile] = np.arange(len(tile), dtype=np.int32)
        frame.bins.tile = wp.array(tile, dtype=wp.int32, device=self.device)
        frame.bins.tile_slot = wp.array(slot, dtype=wp.int32, device=self.device)
        frame.bins.near = wp.empty((max(len(tile), 1), kernels.NEAR_LIMIT + 1), dtype=wp.int32, device=self.device)

    # ---- intervals

    def advance(self, frame: Frame, time: float, counted: float | None = None) -> None:
        """Lead the cells from the course before to this one.

        Args:
            frame: The course.
            time: When it is there, yr.
            counted: Years that moisture and sediment are added up for, by default those since the course before.
        """
        last, kernel, interval = self._last, self._kernel, self._interval
        interval.begin, interval.years = time, 0.0
        blocks = frame.blocks
        if last is not None:
            interval.begin, interval.years = self._time, time - self._time
            inputs = [self._grid, last.course, last.bins, frame.course.line]
            self._launch(kernel.trace_points, frame.count, inputs, [frame.course.moved])
            blocks = np.union1d(blocks, last.blocks)
        interval.counted = interval.years if counted is None else counted
        self._widest = max(self._widest, frame.widest)
        self._take_tiles(frame, blocks)
        count = len(frame.bins.tile)
        self.touched += count * TILE**2
        bounds = np.linspace(0, count, self._threads + 1).astype(int).tolist()
        parts = [(a, b) for a, b in itertools.pairwise(bounds) if b > a]

        def work(part: tuple[int, int]) -> None:
            inputs = [self._grid, part[0], interval, frame.course]
            self._launch(kernel.advance_cells, part[1] - part[0], inputs, [frame.bins, self.cells])

        if len(parts) > 1:
            with ThreadPoolExecutor(len(parts)) as pool:
                list(pool.map(work, parts))
        elif parts:
            work(parts[0])
        self._last, self._time = frame, time

    def lay(self, segments: Segments, kind: int) -> None:
        """Cover cells with courses that were given up, or with lobes.

        Args:
            segments: Their segments.
            kind: ``covers.OXBOW`` or ``covers.ABANDONED``; ``covers.BAR`` for lobes.
        """
        if not len(segments.line):
            return
        frame = self.frame(segments)
        self._take_tiles(frame, frame.blocks)
        times: wp.array = wp.array(segments.time, dtype=wp.float64, device=self.device)
        inputs = [self._grid, kind, frame.course, times]
        self._launch(self._kernel.lay_courses, len(frame.bins.tile), inputs, [frame.bins, self.cells])

    def touched_sigma(self) -> float:
        """Return half of the greatest width of a channel so far, in cells."""
        return 0.5 * self._widest / self._grid.cell_size

    def _launch(self, kernel: Any, dim: int, inputs: list[Any], outputs: list[Any]) -> None:
        if dim:
            launch_kernel(kernel, dim, inputs, outputs, device=self.device)
