"""Splatting: courses of moving channels onto the cells of a raster, summed over time."""

from __future__ import annotations

import dataclasses
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from warpriver.device import PRECISIONS, launch_kernel, require_memory, resolve_device
from warpriver.kernels import covers
from warpriver.kernels import splat as kernels
from warpriver.network import RiverNetwork

__all__ = ["Frame", "Segments", "Splat", "Visit", "bend_of", "sections_of", "segments_of"]

BLOCK, TILE = kernels.BLOCK, kernels.TILE
# Memory of the state of a cell, and of the arrays of its maps while they are made.
CELL_BYTES = 260
# Tiles that are worth a thread.
TILES_A_THREAD = 256
# Reach upstream whose curvature makes a point move: how far its middle lies, and half of its length, widths.
BEND_LAG, BEND_HALF = 3.0, 1.0
# What ``Cells.left`` is where no channel has been, yr.
LEFT_NEVER = -1.0e30


@dataclasses.dataclass(frozen=True)
class Segments:
    """Segments of courses.

    Attributes:
        line: (S, 4) x and y of begin and end, m.
        section: (S, 4) width and depth of begin and end, m.
        bend: (S, 2) width times curvature of the bend at begin and end; of a course that was given up the distance
            from its nearer end in widths.
        moved: (S, 2) how far begin and end have come since the record before, m; 0 where that is not known.
        time: (S,) when the course was given up, yr; 0 for present ones.
        sag: (S, 2) how far to the left of the straight way begin and end were halfway, m.
    """

    line: np.ndarray
    section: np.ndarray
    bend: np.ndarray
    moved: np.ndarray
    time: np.ndarray
    sag: np.ndarray

    def take(self, which: np.ndarray) -> Segments:
        """Return some of the segments."""
        return Segments(*(values[which] if len(values) else values for values in vars(self).values()))

    def join(self, *others: Segments) -> Segments:
        """Return these and others."""
        together = zip(*(vars(some).values() for some in (self, *others)), strict=True)
        return Segments(*(np.concatenate(values) for values in together))


@dataclasses.dataclass(frozen=True)
class Visit:
    """A stage that some tiles are led to.

    Attributes:
        time: When it is, yr.
        tiles: (T,) tiles, in any order.
        course: Makes the segments that their cells feel then.
    """

    time: float
    tiles: np.ndarray
    course: Callable[[], Segments]


def segments_of(network: RiverNetwork) -> Segments:
    """Return the segments of a network."""
    start = network.starts().astype(np.int64)
    head = np.delete(np.arange(start[-1]), start[1:] - 1)
    tail = head + 1
    closed = np.flatnonzero(network.channel_closed)
    head, tail = np.concatenate([head, start[closed + 1] - 1]), np.concatenate([tail, start[closed]])
    xy, section = network.points(), sections_of(network)
    bend = bend_of(xy, start, section[:, 0])
    line, form = np.hstack([xy[head], xy[tail]]), np.hstack([section[head], section[tail]])
    bends = np.stack([bend[head], bend[tail]], axis=1)
    return Segments(line, form, bends, np.zeros_like(bends), np.zeros(len(head)), np.zeros_like(bends))


def sections_of(network: RiverNetwork) -> np.ndarray:
    """Return width and depth at each point, (P, 2) m."""
    if network.point_section is not None:
        return np.asarray(network.point_section[: network.point_count].numpy(), np.float64)
    constant = np.stack([network.channel_width, network.channel_depth], axis=1).astype(np.float64)
    return np.asarray(np.repeat(constant, np.diff(network.starts()), axis=0))


def bend_of(xy: np.ndarray, start: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Return width times curvature of the bend that makes each point move, left > 0, (P,).

    Migration lags the curvature, on rivers by 3.5 to 4.4 widths: it is the mean over the reach that lies ``BEND_LAG``
    widths upstream, as far as there is any.
    """
    step = np.diff(xy, axis=0)
    step[start[1:-1] - 1] = 0.0
    length = np.hypot(*step.T)
    arc = np.concatenate([[0.0], np.cumsum(length)])
    heading = np.arctan2(step[:, 1], step[:, 0])
    turn = np.diff(heading)
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
    # None from one channel to the next.
    turn[np.maximum(start[1:-1] - 2, 0)] = 0.0
    turn[start[1:-1] - 1] = 0.0
    # The direction at a point is the sum of the turns before, and half of its own.
    whole = np.concatenate([[0.0], np.cumsum(turn), [0.0]])
    whole[-1] = whole[-2]
    direction = np.concatenate([[0.0], 0.5 * (whole[:-2] + whole[1:-1]), [whole[-1]]])
    count = np.diff(start)
    head, foot = (np.repeat(arc[k], count) for k in (start[:-1], start[1:] - 1))
    high = np.clip(arc - (BEND_LAG - BEND_HALF) * width, head, foot)
    low = np.clip(arc - (BEND_LAG + BEND_HALF) * width, head, foot)
    # At a head there is nothing upstream: the first reach of that length.
    high = np.minimum(np.maximum(high, low + BEND_HALF * width), foot)
    swing = np.interp(high, arc, direction) - np.interp(low, arc, direction)
    return np.asarray(width * swing / np.maximum(high - low, 1e-9))


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
        cell_size: Side of a cell, m.
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
        narrowest: float = 0.0,
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
            narrowest: Width in m that narrower channels are taken to have.
        """
        self._narrowest = narrowest
        self.shape, self.cell_size, self.device = shape, cell_size, resolve_device(device)
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
        tiles = grid.block_rows * grid.block_columns * kernels.TILES_IN_BLOCK**2
        self._felt = wp.zeros(tiles, dtype=wp.int32, device=self.device)
        self._tile_time = np.zeros(tiles)
        self._no_group: wp.array[Any] = wp.empty(0, dtype=wp.int32, device=self.device)

    # ---- frames

    def widened(self, segments: Segments) -> Segments:
        """Return segments that are as wide as the narrowest ones should be."""
        if not self._narrowest or not len(segments.line):
            return segments
        section = segments.section.copy()
        section[:, ::2] = np.maximum(section[:, ::2], self._narrowest)
        return dataclasses.replace(segments, section=section)

    def frame(self, segments: Segments, group: np.ndarray | None = None, blocks: np.ndarray | None = None) -> Frame:
        """Bring segments to the device and list them by blocks.

        Args:
            segments: The segments.
            group: (S,) number of the group of each, where blocks list those of their own group only.
            blocks: (B,) group of each block, -1 for none.
        """
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
        course.moved = wp.array(np.hstack([segments.moved, segments.sag]).astype(self._real), dtype=vec4, device=device)
        groups = course.group = self._no_group
        if group is not None and blocks is not None:
            course.group = wp.array(group.astype(np.int32), dtype=wp.int32, device=device)
            groups = wp.array(blocks.astype(np.int32), dtype=wp.int32, device=device)
        total = self._grid.block_rows * self._grid.block_columns
        ends = wp.zeros(count, dtype=wp.int32, device=device)
        launch_kernel(kernel.count_blocks, count, [course, self._grid, groups], [ends], device=device)
        wp.utils.array_scan(ends, ends, inclusive=True)
        pairs = int(ends[-1:].numpy()[0]) if count else 0
        keys = wp.empty(2 * max(pairs, 1), dtype=wp.int32, device=device)
        values = wp.empty(2 * max(pairs, 1), dtype=wp.int32, device=device)
        if pairs:
            launch_kernel(kernel.list_blocks, count, [course, self._grid, groups, ends], [keys, values], device=device)
            wp.utils.radix_sort_pairs(keys, values, pairs)
        made.bins = kernel.Bins()
        made.bins.block_start = wp.empty(total + 1, dtype=wp.int32, device=device)
        made.bins.block_segment = values
        launch_kernel(kernel.find_starts, total + 1, [keys, pairs], [made.bins.block_start], device=device)
        made.blocks = np.flatnonzero(np.diff(made.bins.block_start.numpy()))
        return made

    def tiles_of(self, blocks: np.ndarray) -> np.ndarray:
        """Return the tiles of some blocks."""
        side, across = kernels.TILES_IN_BLOCK, self._grid.block_columns
        row, column = side * (blocks // across), side * (blocks % across)
        inner = np.arange(side)
        rows = row[:, None, None] + inner[None, :, None]
        columns = column[:, None, None] + inner[None, None, :]
        within = (rows * TILE < self.shape[0]) & (columns * TILE < self.shape[1])
        return np.asarray((rows * (across * side) + columns)[within])

    def blocks_of(self, tiles: np.ndarray) -> np.ndarray:
        """Return the block that each of some tiles lies in."""
        side, across = kernels.TILES_IN_BLOCK, self._grid.block_columns
        return np.asarray(tiles // (across * side) // side * across + tiles % (across * side) // side)

    def _take_tiles(self, frame: Frame, tiles: np.ndarray) -> None:
        """Let a frame work at some tiles."""
        tile = tiles.astype(np.int32)
        slot = np.full(len(self._tile_time), -1, np.int32)
        slot[tile] = np.arange(len(tile), dtype=np.int32)
        frame.bins.tile = wp.array(tile, dtype=wp.int32, device=self.device)
        frame.bins.tile_slot = wp.array(slot, dtype=wp.int32, device=self.device)
        frame.bins.worked = wp.zeros(max(len(tile), 1), dtype=wp.int32, device=self.device)
        frame.bins.felt = self._felt
        for name in ("near", "part"):
            lists = wp.empty((max(len(tile), 1), kernels.NEAR_LIMIT + 1), dtype=wp.int32, device=self.device)
            setattr(frame.bins, name, lists)

    # ---- intervals

    def trace(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return where points come from, on the whole course that the cells were led to last.

        Args:
            xy: (n, 2) m.

        Returns:
            (n, 2) feet in m; (n,) distance from there, m, and (n,) the segment, -1 where none is within reach.
        """
        assert self._last is not None
        kernel, device, count = self._kernel, self.device, len(xy)
        point: wp.array[Any] = wp.array((xy - self._zero).astype(self._real), dtype=kernel.vec2, device=device)
        foot = wp.empty(count, dtype=kernel.vec2, device=device)
        moved = wp.empty(count, dtype=self._scalar, device=device)
        segment = wp.empty(count, dtype=wp.int32, device=device)
        inputs = [self._grid, self._last.course, self._last.bins, point]
        self._launch(kernel.trace_points, count, inputs, [foot, moved, segment])
        feet = foot.numpy().astype(np.float64) + self._zero
        return feet, moved.numpy().astype(np.float64), segment.numpy().copy()

    def is_beyond(self, xy: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Tell which points lie off the raster, and no farther from it than a distance in m, (n,)."""
        x, y = (xy - self._zero).T
        half, (rows, columns) = 0.5 * self.cell_size, self.shape
        across = np.maximum(-half - x, x - (columns * self.cell_size - half))
        down = np.maximum(y - half, -(rows * self.cell_size - half) - y)
        away = np.maximum(across, down)
        return np.asarray((away >= 0.0) & (away <= reach))

    def _boxes(self, line: np.ndarray, reach: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return first and last + 1 row and column, (n, 2) each, of the tiles around segments, and which have any."""
        size = TILE * self._grid.cell_size
        near, far = np.minimum(line[:, :2], line[:, 2:]), np.maximum(line[:, :2], line[:, 2:])
        (west, south), (east, north) = (near - self._zero).T, (far - self._zero).T
        # Rows go down from the first cell's centre, half a cell from the edge.
        edge = 0.5 * self._grid.cell_size
        low = np.stack([edge - (north + reach), edge + west - reach], axis=1) / size
        high = np.stack([edge - (south - reach), edge + east + reach], axis=1) / size
        most = -(-np.array(self.shape) // TILE)
        first = np.clip(np.floor(low), 0, most).astype(np.int64)
        last = np.clip(np.ceil(high), 0, most).astype(np.int64)
        return first, last, (first < last).all(axis=1)

    def tiles_near(self, line: np.ndarray, reach: np.ndarray | float) -> np.ndarray:
        """Return the tiles within a distance in m of the boxes around segments, ascending."""
        first, last, seen = self._boxes(line, reach)
        first, last = first[seen], last[seen]
        if not len(first):
            return np.empty(0, np.int64)
        # Within the box around all of them: corners of each box of tiles, whose running sums are 1 within it.
        corner = first.min(axis=0)
        mask = np.zeros(last.max(axis=0) - corner + 1, np.int32)
        first, last = first - corner, last - corner
        for sign, rows, columns in ((1, first, first), (-1, first, last), (-1, last, first), (1, last, last)):
            np.add.at(mask, (rows[:, 0], columns[:, 1]), sign)
        row, column = np.nonzero(mask.cumsum(axis=0).cumsum(axis=1)[:-1, :-1])
        return np.asarray((row + corner[0]) * (kernels.TILES_IN_BLOCK * self._grid.block_columns) + column + corner[1])

    def reaches(self, line: np.ndarray, reach: np.ndarray | float, tiles: np.ndarray | None = None) -> np.ndarray:
        """Tell which segments come within a distance in m, by the boxes around them, of some tiles, by default all."""
        first, last, seen = self._boxes(line, reach)
        if tiles is None:
            return seen
        side = kernels.TILES_IN_BLOCK
        shape = side * self._grid.block_rows, side * self._grid.block_columns
        total = np.zeros((shape[0] + 1, shape[1] + 1), np.int32)
        inner = np.zeros(shape, np.int32)
        inner.ravel()[tiles] = 1
        total[1:, 1:] = inner.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
        (top, left), (bottom, right) = first.T, last.T
        count = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
        return np.asarray(seen & (count > 0))

    def advance(
        self, frame: Frame, time: float, *, counted: bool = True, extra: float = 0.0, span: float = 0.0
    ) -> None:
        """Lead the cells from the course before to this one: all that it reaches, or the one before did.

        Args:
            frame: The course.
            time: When it is there, yr.
            counted: Add the time up for moisture and sediment.
            extra: Years that these are added up for besides.
            span: Years from the course of which ``sag`` of the segments tells, to this one; 0: all ways are straight.
        """
        blocks = frame.blocks if self._last is None else np.union1d(frame.blocks, self._last.blocks)
        if self._last is None:
            self._tile_time[:] = time
        self._advance(frame, self.tiles_of(blocks), np.full(len(self._tile_time), time), counted, extra, span)
        self._last = frame

    def visit(self, visits: Sequence[Visit], *, counted: bool = True, span: float = 0.0) -> None:
        """Lead cells from the course before through stages at some places, each at its own time.

        What happens in different blocks is independent: the first stages of all blocks are led to together, then the
        second ones, and so on.

        Args:
            visits: The stages, in the order of time.
            counted: Add the time up for moisture and sediment.
            span: As of :meth:`advance`.
        """
        blocks = [np.unique(self.blocks_of(visit.tiles)) for visit in visits]
        # Of each visit and block, how many visits the block has had before.
        pair_visit = np.repeat(np.arange(len(visits)), [len(some) for some in blocks])
        pair_block = np.concatenate([*blocks, np.empty(0, np.int64)]).astype(np.int64)
        order = np.argsort(pair_block, kind="stable")
        ordered = pair_block[order]
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order)) - np.searchsorted(ordered, ordered)
        made: dict[int, Segments] = {}
        for turn in range(int(rank.max(initial=-1)) + 1):
            now = np.flatnonzero(rank == turn)
            ends = self._tile_time.copy()
            groups = np.full(self._grid.block_rows * self._grid.block_columns, -1)
            groups[pair_block[now]] = pair_visit[now]
            tiles, courses, owners = [], [], []
            for k in np.unique(pair_visit[now]).tolist():
                some = visits[k].tiles[groups[self.blocks_of(visits[k].tiles)] == k]
                ends[some] = visits[k].time
                tiles.append(some)
                course = made.pop(k) if k in made else visits[k].course()
                # Other blocks may come to it later.
                if (rank[pair_visit == k] > turn).any():
                    made[k] = course
                courses.append(course)
                owners.append(np.full(len(course.line), k))
            course = courses[0].join(*courses[1:])
            frame = self.frame(course, np.concatenate(owners), groups)
            self._advance(frame, np.concatenate(tiles), ends, counted, 0.0, span)

    def _advance(
        self, frame: Frame, tiles: np.ndarray, ends: np.ndarray, counted: bool, extra: float, span: float
    ) -> None:
        """Lead some tiles to a course; ``ends`` is the time that each tile of the raster is at then."""
        interval = self._interval
        interval.counted, interval.extra, interval.span = float(counted), extra, span
        for name, times in (("tile_time", self._tile_time), ("tile_end", ends)):
            setattr(interval, name, wp.array(times, dtype=wp.float64, device=self.device))
        self._widest = max(self._widest, frame.widest)
        self._take_tiles(frame, tiles)
        count = len(tiles)
        # Threads take longer to start than a few tiles need.
        threads = min(self._threads, max(1, count // TILES_A_THREAD))
        bounds = np.linspace(0, count, threads + 1).astype(int).tolist()
        parts = [(a, b) for a, b in itertools.pairwise(bounds) if b > a]

        def work(part: tuple[int, int]) -> None:
            inputs = [self._grid, part[0], interval, frame.course]
            self._launch(self._kernel.advance_cells, part[1] - part[0], inputs, [frame.bins, self.cells])

        if len(parts) > 1:
            with ThreadPoolExecutor(len(parts)) as pool:
                list(pool.map(work, parts))
        elif parts:
            work(parts[0])
        self.touched += int(frame.bins.worked.numpy().sum()) * TILE**2
        self._tile_time = ends

    def lay(self, segments: Segments, kind: int) -> None:
        """Cover cells with courses that were given up, or with lobes.

        Args:
            segments: Their segments.
            kind: ``covers.OXBOW`` or ``covers.ABANDONED``; ``covers.BAR`` for lobes.
        """
        if not len(segments.line):
            return
        frame = self.frame(self.widened(segments))
        self._take_tiles(frame, self.tiles_of(frame.blocks))
        times: wp.array[Any] = wp.array(segments.time, dtype=wp.float64, device=self.device)
        inputs = [self._grid, kind, frame.course, times]
        self._launch(self._kernel.lay_courses, len(frame.bins.tile), inputs, [frame.bins, self.cells])

    def touched_sigma(self) -> float:
        """Return half of the greatest width of a channel so far, in cells."""
        return float(0.5 * self._widest / self._grid.cell_size)

    def _launch(self, kernel: Any, dim: int, inputs: list[Any], outputs: list[Any]) -> None:
        if dim:
            launch_kernel(kernel, dim, inputs, outputs, device=self.device)
