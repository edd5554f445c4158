"""Beds: the ground with courses, basins and rocks in it, at any places and at any scale [Peytavie2019, Sec. 5.2].

A course is its section, with banks that rise to the ground by 35 degrees at most. The bed is the lowest of all of them
and the ground; nothing is raised. Rivers that meet are rounded by a norm of what they cut: a polynomial minimum would
dig where two rims coincide.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver.arrays import DeviceArray, FloatArray, IndexArray
from warpriver.device import PRECISIONS, launch_kernel, put_on_device, require_memory
from warpriver.kernels import beds as kernels
from warpriver.riverscape.sorting import boxes, stable_order
from warpriver.riverscape.stations import TYPES, Stations
from warpriver.riverscape.templates import BEND_TABLE, LANES, section_depth, spread_factor
from warpriver.terrain import Terrain

__all__ = ["MATERIALS", "Bed", "Beds", "Located", "ground_of"]


# What a bed is made of, in the order of ``Bed.material``.
MATERIALS = ("rock", "gravel", "sand", "silt")
# Weights of the materials by type, in the deepest part of the section and at its edge.
DEEP = {
    "A+": (0.8, 0.2, 0.0, 0.0), "A": (0.6, 0.4, 0.0, 0.0), "B": (0.3, 0.6, 0.1, 0.0), "C": (0.0, 0.75, 0.25, 0.0),
    "D": (0.0, 0.8, 0.2, 0.0), "DA": (0.0, 0.0, 0.5, 0.5), "E": (0.0, 0.2, 0.6, 0.2), "F": (0.1, 0.5, 0.4, 0.0),
    "G": (0.2, 0.6, 0.2, 0.0),
}  # fmt: skip
EDGE = {
    "A+": (0.9, 0.1, 0.0, 0.0), "A": (0.7, 0.3, 0.0, 0.0), "B": (0.3, 0.5, 0.2, 0.0), "C": (0.0, 0.2, 0.6, 0.2),
    "D": (0.0, 0.5, 0.5, 0.0), "DA": (0.0, 0.0, 0.1, 0.9), "E": (0.0, 0.0, 0.3, 0.7), "F": (0.1, 0.3, 0.4, 0.2),
    "G": (0.1, 0.4, 0.4, 0.1),
}  # fmt: skip
# Slopes of banks, and the part of the reach at which what is cut fades, as the kernels have them.
STEEPEST_BANK, GENTLEST_BANK, FADES = kernels.STEEPEST_BANK, kernels.GENTLEST_BANK, kernels.FADES
# Ends of a line reach as far as its banks.
UNLIMITED = 1e6
# Length ahead of a segment within which what it cuts fades, in its own lengths and in half widths.
AHEAD_LENGTHS, AHEAD_HALVES = 1.0, 0.1
# Least softness of the rim, m.
LEAST_RIM = 0.005
# Bytes a cell of a raster, and a pair of the index, need.
CELL_BYTES, INDEX_BYTES = 16, 80
# Size of the index's cells, in median distances from a line to the end of its banks.
CELLS_ACROSS = 0.4


class Bed(NamedTuple):
    """The bed at places.

    Attributes:
        elevation: (n,) m; NaN off the terrain.
        cut: (n,) depth below the ground that was there, m, 0 or more.
        water: (n,) mean water surface of the course that a place lies in or beside, m; NaN away from all of them.
        depth: (n,) depth of the water, m, 0 on land.
        material: (n, 4) weights of ``MATERIALS``; they sum to 1 in the water and fade to 0 up the banks.
    """

    elevation: FloatArray
    cut: FloatArray
    water: FloatArray
    depth: FloatArray
    material: FloatArray


class Located(NamedTuple):
    """Places along courses.

    Attributes:
        station: (n,) station at the upper end of the segment; -1 away from all courses.
        part: (n,) part of the way to the next station.
        left: (n,) distance to the left of the course, m.
        edge: (n,) distance beyond the water's edge, m; below 0 in the water.
    """

    station: IndexArray
    part: FloatArray
    left: FloatArray
    edge: FloatArray

    def of(self, values: FloatArray) -> FloatArray:
        """Return values of stations, (P,) or (P, k), at the places; NaN away from all courses."""
        found = self.station >= 0
        k = np.maximum(self.station, 0)
        part = self.part if values.ndim == 1 else self.part[:, None]
        mixed = (1.0 - part) * values[k] + part * values[np.minimum(k + 1, len(values) - 1)]
        return np.where(found if values.ndim == 1 else found[:, None], mixed, np.nan)


def ground_of(terrain: Terrain) -> Any:
    """Return the function that gives the height of the ground that beds are cut into, at (n, 2) places in m."""

    def ground(xy: FloatArray) -> FloatArray:
        origin = _origin(terrain)
        place = put_on_device(xy - origin, wp.vec2d, terrain.device)
        out = wp.empty(len(place), dtype=wp.float64, device=terrain.device)
        grid = terrain.grid("float64", origin)
        kernel = kernels.build(wp.float64).sample_ground
        launch_kernel(kernel, len(place), [terrain.height, grid, place], [out], device=terrain.device)
        found: FloatArray = out.numpy().copy()
        return found

    return ground


def _origin(terrain: Terrain) -> FloatArray:
    """Zero of the places on the device: the south-west corner in whole metres, so that offsets are exact."""
    west, south, _, _ = terrain.bounds
    return np.array([math.floor(west), math.floor(south)], np.float64)


class Beds:
    """The bed of courses in a terrain, on its device."""

    def __init__(
        self, terrain: Terrain, courses: Stations, dtype: str = "float64", obstacles: FloatArray | None = None
    ):
        """Bring the courses to the device, with an index of which of them a place may meet.

        Args:
            terrain: The ground.
            courses: The courses.
            obstacles: (n, 4) mounds of a user's: x, y, radius and elevation of the top, m.
            dtype: Precision of places, "float64" or "float32"; heights are float64.
        """
        self.terrain, self.courses = terrain, courses
        self._obstacles = np.empty((0, 4)) if obstacles is None else obstacles
        self._zero = _origin(terrain)
        self._scalar, self._vec2, _ = PRECISIONS[dtype]
        self._kernels = built = kernels.build(self._scalar)
        self._stations, self.limits = self._of_stations(built)
        self._marks = self._of_marks(rocks=True)
        self._index = self._of_index(built, self.limits)
        wet = courses.wet[courses.station_course].astype(np.uint8)
        self._wet = put_on_device(wet, wp.uint8, terrain.device)
        self._grid = terrain.grid(dtype, self._zero)

    def _array(self, values: Any, dtype: Any) -> DeviceArray:
        return put_on_device(values, dtype, self.terrain.device)

    def _of_stations(self, built: Any) -> tuple[Any, FloatArray]:
        courses = self.courses
        stations = built.Stations()
        stations.line = self._array(np.column_stack([courses.xy - self._zero, courses.tangent]), built.vec4)
        stations.water = self._array(courses.water, wp.float64)
        section = np.column_stack([0.5 * courses.width, courses.depth, courses.reach, courses.ease])
        stations.section = self._array(section, built.vec4)
        lane = (courses.lane - LANES[0]) / (LANES[1] - LANES[0])
        soft = np.maximum(courses.rim, LEAST_RIM)
        stations.shape = self._array(np.column_stack([courses.blend, courses.bend, lane, soft]), built.vec4)
        stations.form = self._array(courses.form, wp.vec2i)
        limits = self._limits()
        stations.segment = self._array(np.column_stack([limits, self._far(limits) ** 2]), built.vec3)
        stations.group = self._array(courses.group[courses.station_course], wp.int32)
        stations.form_depth = self._array(courses.form_table, self._scalar)
        stations.bend_depth = self._array(BEND_TABLE, self._scalar)
        return stations, limits

    def _limits(self) -> FloatArray:
        """What each segment reaches beyond its two ends, (P, 2) m: little, but for ends of rivers."""
        courses = self.courses
        length = np.append(np.diff(courses.along), 0.0)
        inner = np.maximum(AHEAD_LENGTHS * length + AHEAD_HALVES * 0.5 * courses.width, 1e-6)
        limits = np.column_stack([inner, inner])
        count = int(max(courses.from_node.max(), courses.to_node.max())) + 1
        arrives, leaves = (np.bincount(n, minlength=count) > 0 for n in (courses.to_node, courses.from_node))
        first, last = courses.start[:-1], courses.start[1:] - 2
        limits[first[~arrives[courses.from_node]], 0] = UNLIMITED
        limits[last[~leaves[courses.to_node]], 1] = UNLIMITED
        return limits

    def _far(self, limits: FloatArray) -> FloatArray:
        """How far from its first station each segment may reach, (P,) m."""
        courses = self.courses
        across = 0.5 * courses.width + courses.reach
        across = np.maximum(across, np.append(across[1:], 0.0))
        length = np.append(np.abs(np.diff(courses.along)), 0.0)
        # At the far end of a cap, of the fan, or of the segment.
        found: FloatArray = across + np.minimum(limits.max(axis=1), across) + 1.001 * length
        return found

    def _of_marks(self, rocks: bool) -> Any:
        """Basins, rocks and obstacles; without rocks these are still listed, but as high as nothing."""
        basins, stones, own = self.courses.basins, self.courses.rocks, self._obstacles
        xy = np.concatenate([basins.xy, stones.xy, own[:, :2]]) - self._zero
        height, top = (stones.height, own[:, 3]) if rocks else (0.0 * stones.height, 0.0 * own[:, 3])
        size = np.concatenate([basins.depth, height, top])
        radius = np.concatenate([basins.radius, stones.radius, own[:, 2]])
        kinds = [kernels.BASIN, kernels.ROCK, kernels.OBSTACLE if rocks else kernels.ROCK]
        kind = np.repeat(kinds, [len(basins), len(stones), len(own)])
        self._mark_place = np.column_stack([xy, radius, size]).reshape(-1, 4)
        marks = self._kernels.Marks()
        marks.place = self._array(self._mark_place, self._kernels.vec4)
        marks.kind = self._array(kind, wp.int32)
        return marks

    def _of_index(self, built: Any, limits: FloatArray) -> Any:
        courses = self.courses
        course = courses.station_course
        segment = np.flatnonzero(course[1:] == course[:-1])
        # By groups, so that a cell's list needs no further sorting.
        segment = segment[np.argsort(courses.group[course[segment]], kind="stable")]
        across = np.maximum(*(0.5 * courses.width[k] + courses.reach[k] for k in (segment, segment + 1)))
        ahead = np.minimum(limits[segment], across[:, None])
        size = float(np.clip(CELLS_ACROSS * np.median(across), 0.25, 200.0))
        owner, cell = self._cells(built, segment, across, ahead, size)
        mark = self._mark_place
        mark_pair, mark_cell = _cells_of_discs(mark[:, :2], mark[:, 2], size)
        # Obstacles also lie away from all courses; other marks change nothing there.
        own = mark_cell[mark_pair >= len(mark) - len(self._obstacles)]
        every = np.concatenate([cell, own])
        low, high = every.min(axis=0), every.max(axis=0)
        block = kernels.BLOCK
        shape = (high - low) // block + 1  # columns, rows of blocks
        table = np.full((int(shape[1]), int(shape[0])), -1, np.int64)
        shift = block.bit_length() - 1
        table.ravel()[((every[:, 1] - low[1]) >> shift) * shape[0] + ((every[:, 0] - low[0]) >> shift)] = 0
        used = np.flatnonzero(table.ravel() == 0)
        table.ravel()[used] = np.arange(len(used))
        cells = len(used) * block * block
        starts, items = _packed(self._cell_number(cell - low, table), owner, cells)
        inside = ((mark_cell >= low) & (mark_cell <= high)).all(axis=1)
        mark_pair, mark_cell = mark_pair[inside], mark_cell[inside]
        number = self._cell_number(mark_cell - low, table)
        inside = number >= 0
        mark_starts, mark_items = _packed(number[inside], mark_pair[inside], cells)
        index = built.Index()
        index.west, index.south, index.per_cell = float(low[0] * size), float(low[1] * size), 1.0 / size
        index.block = self._array(table, wp.int32)
        index.cell_start, index.cell_segment = self._array(starts, wp.int32), self._array(items, wp.int32)
        index.mark_start, index.cell_mark = self._array(mark_starts, wp.int32), self._array(mark_items, wp.int32)
        return index

    def _cells(
        self, built: Any, segment: IndexArray, across: FloatArray, ahead: FloatArray, size: float
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Cells that segments may reach, segment by segment: (n,) segment and (n, 2) column and row."""
        device = self.terrain.device
        inputs = [
            self._stations,
            self._scalar(1.0 / size),
            self._array(segment, wp.int32),
            self._array(across, self._scalar),
        ]
        inputs.append(self._array(ahead, built.vec2))
        count = wp.empty(len(segment), dtype=wp.int32, device=device)
        nowhere, nothing = self._array(np.full(len(segment), -1), wp.int32), wp.empty(1, dtype=wp.vec2i, device=device)
        launch_kernel(built.list_cells, len(segment), [*inputs, nowhere], [count, nothing], device=device)
        counts = count.numpy().astype(np.int64)
        total = int(counts.sum())
        require_memory((total, 1), INDEX_BYTES, device, "an index of a bed")
        first = self._array(np.cumsum(counts) - counts, wp.int32)
        cell = wp.empty(total, dtype=wp.vec2i, device=device)
        launch_kernel(built.list_cells, len(segment), [*inputs, first], [count, cell], device=device)
        return np.repeat(segment.astype(np.int32), counts), cell.numpy().reshape(-1, 2)

    @staticmethod
    def _cell_number(cell: NDArray[np.integer], table: IndexArray) -> NDArray[np.int32]:
        shift, inner = kernels.BLOCK.bit_length() - 1, kernels.BLOCK - 1
        column, row = (np.ascontiguousarray(cell[:, k], np.int32) for k in (0, 1))
        own = table.astype(np.int32).ravel()[(row >> shift) * np.int32(table.shape[1]) + (column >> shift)]
        number = (((own << shift) + (row & inner)) << shift) + (column & inner)
        return np.where(own < 0, np.int32(-1), number)

    def heights(self, xy: FloatArray, rocks: bool = True) -> tuple[FloatArray, FloatArray]:
        """Return the heights of the bed, with or without its rocks, and of the ground without it at (n, 2) places."""
        device = self.terrain.device
        place = self._array(xy - self._zero, self._vec2)
        height, base = (wp.empty(len(place), dtype=wp.float64, device=device) for _ in range(2))
        marks = self._marks if rocks else self._of_marks(rocks=False)
        inputs = [self.terrain.height, self._grid, self._stations, marks, self._index, place]
        launch_kernel(self._kernels.evaluate_points, len(place), inputs, [height, base], device=device)
        return height.numpy().copy(), base.numpy().copy()

    def raster(self, cell_size: float, west: float, north: float, shape: tuple[int, int]) -> DeviceArray:
        """Return the heights of the bed at the centres of a raster's cells, on the device."""
        device = self.terrain.device
        require_memory(shape, CELL_BYTES, device, "a bed")
        window = self._kernels.Window()
        window.west, window.north = west + 0.5 * cell_size - self._zero[0], north - 0.5 * cell_size - self._zero[1]
        window.cell_size = cell_size
        out = wp.empty(shape, dtype=wp.float64, device=device)
        inputs = [self.terrain.height, self._grid, self._stations, self._marks, self._index, window]
        launch_kernel(self._kernels.evaluate_cells, shape, inputs, [out], device=device)
        return out

    def locate(self, xy: FloatArray) -> Located:
        """Return where places lie along the courses that carry water: in or nearest to the water."""
        device = self.terrain.device
        place = self._array(xy - self._zero, self._vec2)
        segment = wp.empty(len(place), dtype=wp.int32, device=device)
        found = wp.empty(len(place), dtype=self._kernels.vec3, device=device)
        inputs = [self._stations, self._index, place, self._wet]
        launch_kernel(self._kernels.locate_points, len(place), inputs, [segment, found], device=device)
        values = found.numpy().astype(np.float64)
        return Located(segment.numpy().astype(np.int64), values[:, 0], values[:, 1], values[:, 2])

    def at(self, xy: FloatArray) -> Bed:
        """Return the bed at (n, 2) places: heights, water and material."""
        height, base = self.heights(xy)
        located = self.locate(xy)
        water = located.of(self.courses.water)
        depth = np.where(located.station >= 0, np.maximum(np.nan_to_num(water) - height, 0.0), 0.0)
        cut = np.where(np.isfinite(height), base - height, 0.0)
        # Beyond what is cut there is no water, also where the ground falls away below a spring or a mouth.
        depth = np.where(cut > 0.0, depth, 0.0)
        return Bed(height, cut, water, np.nan_to_num(depth), self._material(located, depth, cut))

    def _material(self, located: Located, depth: FloatArray, cut: FloatArray) -> FloatArray:
        """Weights of the materials: of the type, by depth; rock on rocks; fading up the banks."""
        courses = self.courses
        kind = courses.type[courses.station_course[np.maximum(located.station, 0)]]
        deep, edge = (np.array([table[name] for name in TYPES])[kind] for table in (DEEP, EDGE))
        greatest = np.maximum(np.nan_to_num(located.of(courses.depth), nan=1.0), 1e-6)
        part = np.clip(np.nan_to_num(depth) / greatest, 0.0, 1.0)[:, None]
        weights = part * deep + (1.0 - part) * edge
        reach = np.maximum(np.nan_to_num(located.of(courses.reach), nan=1.0), 1e-6)
        fade = np.clip(1.0 - 2.0 * np.maximum(located.edge, 0.0) / reach, 0.0, 1.0)
        fade = np.where((located.station >= 0) & (cut > 0.0), fade * fade * (3.0 - 2.0 * fade), 0.0)
        found: FloatArray = weights * fade[:, None]
        return found

    def velocity(self, xy: FloatArray) -> FloatArray:
        """Return the mean velocity of the water at places, (n, 2) m/s; 0 on land.

        Across a section speed grows with d^(2/3), so that the integral of u d is the discharge.
        """
        located, courses = self.locate(xy), self.courses
        k = np.maximum(located.station, 0)
        half = np.maximum(0.5 * np.nan_to_num(located.of(courses.width)), 1e-9)
        share = 0.5 - 0.5 * located.left / half
        nearer = np.where(located.part < 0.5, k, np.minimum(k + 1, len(courses.along) - 1))
        blend, lane, bend = (np.nan_to_num(located.of(v)) for v in (courses.blend, courses.lane, courses.bend))
        section = (courses.form[k], blend, lane, bend, courses.form_table)
        depth = section_depth(share, *section)
        most = np.nan_to_num(located.of(courses.speed)) * spread_factor(*section)
        speed = most * depth ** (2.0 / 3.0)
        speed = np.where((located.station >= 0) & (located.edge < 0.0), speed, 0.0)
        ahead = np.nan_to_num(located.of(courses.tangent))
        ahead = np.where(located.station[:, None] >= 0, ahead, courses.tangent[nearer])
        found: FloatArray = speed[:, None] * ahead / np.maximum(np.hypot(*ahead.T), 1e-12)[:, None]
        return found


def _cells_of_discs(xy: FloatArray, radius: FloatArray, size: float) -> tuple[IndexArray, IndexArray]:
    low = np.floor((xy - radius[:, None]) / size).astype(np.int64)
    high = np.floor((xy + radius[:, None]) / size).astype(np.int64)
    disc, column, row = boxes(low, high)
    return disc, np.column_stack([column, row])


def _packed(cell: NDArray[np.int32], item: NDArray[np.integer], count: int) -> tuple[IndexArray, NDArray[np.integer]]:
    """Offsets of cells, and their items in the order in which they come."""
    order = stable_order(cell)
    starts = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=count))])
    return starts, item[order]
