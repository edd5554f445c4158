"""Diversions: a channel that leaves for another one, along the cheapest way over the ground."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.channel_table import JOINT_LOCK
from warpriver.engine.state import State
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.graph.authoring import Reworking, smooth_line
from warpriver.meander.courses import Course, Refusal, falling_bed
from warpriver.network import RiverNetwork
from warpriver.params import AvulsionParams
from warpriver.terrain import Terrain

with IMPORTING:
    from scipy.ndimage import grey_dilation
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

__all__ = ["Diversion", "divert", "find_way", "upstream_of"]


# Cells of the ground that are looked at, a side; larger windows are looked at more coarsely.
MAX_CELLS = 300
# A rise costs as much as a way so many times as long as one that climbs it as steeply as is carved.
DEAR = 10.0
# Every so many cells of the cheapest way a point of the course, which is smooth in between.
THINNED = 3
# Where no rise is carved at all, one costs as if it were this slope that is.
MIN_SLOPE = 1e-6


@dataclasses.dataclass(frozen=True)
class Diversion:
    """A channel that can leave for another one, or for an outlet of its own.

    Attributes:
        channel: Index of the channel.
        first: Point, of all, where it leaves.
        end: Point of the other channel, of all, where it comes to; -1 where it ends in an outlet.
        course: The course, from the one point to the other.
        width: Width of the channel, m.
        old_xy: (n, 2) course that it leaves, down to its end, m.
    """

    channel: int
    first: int
    end: int
    course: Course
    width: float
    old_xy: FloatArray

    @staticmethod
    def along(network: RiverNetwork, channel: int, first: int, end: int, course: Course) -> Diversion:
        """Return the diversion of a channel along a course."""
        last = int(network.starts()[channel + 1])
        old = network.point_xy[first:last].numpy().astype(np.float64) + network.origin
        return Diversion(channel, first, end, course, float(network.channel_width[channel]), old)


def divert(state: State, new: Diversion) -> tuple[Reworking, FloatArray]:
    """Return the channels once one has left for another, to be built, and its new course, (n, 2) m.

    Raises:
        ValueError: A locked point would fall dry, or it comes to one.
    """
    network = state.network
    spacing = state.spacing.numpy()[: network.channel_count].astype(np.float64)
    work = Reworking(network, spacing, state.next_identity)
    if new.end < 0:
        node = work.outlet(new.course.xy[-1])
    else:
        node = work.junction_at(int(np.searchsorted(network.starts(), new.end, side="right")) - 1, new.end)
        if any(work.joint(c) == JOINT_LOCK for c in work.arriving(node)):
            raise InputError("the new course comes to a locked point; unlock it first")
    line = np.concatenate([new.course.xy[:-1], work.node_place(node)[None]])
    work.divert(new.channel, new.first, line, node)
    return work, line


def upstream_of(network: RiverNetwork, channel: int) -> FlagArray:
    """Return which channels' water comes through a channel, itself among them, (C,)."""
    found = np.zeros(network.channel_count, bool)
    rest = [channel]
    while rest:
        c = rest.pop()
        if not found[c]:
            found[c] = True
            rest += np.flatnonzero(network.channel_to == network.channel_from[c]).tolist()
    return found


def find_way(
    state: State,
    channel: int,
    point: int,
    params: AvulsionParams,
    target: int | None = None,
    *,
    goals: str = "channels",
) -> Diversion | Refusal:
    """Find the cheapest way over the ground from a point of a channel to another one, or to the edge of the ground.

    It costs its length, and more where it climbs; its own channel, and those whose water comes through it, are in the
    way. The rules of new courses hold: no steeper rise and no deeper cut than they allow, and the bed falls.

    Args:
        state: The network and its ground.
        channel: Index of the channel.
        point: Point, of all, where it leaves.
        params: How steeply the ground may rise, how deep a cut may be, and how far the other channel may lie.
        target: Index of the other channel; by default the one that is reached at the lowest cost.
        goals: "channels", "outlet", the edge of the ground or where it has no data, or "any" of them.

    Returns:
        The diversion, or why there is none.
    """
    network, terrain = state.network, state.terrain
    xy, start = network.points(), network.starts()
    here = xy[point]
    width, depth = float(network.channel_width[channel]), float(network.channel_depth[channel])
    if terrain is None:
        return Refusal("there is no ground", (float(here[0]), float(here[1])))
    owner = np.repeat(np.arange(network.channel_count), np.diff(start))
    open_to = ~upstream_of(network, channel) & ~network.channel_closed
    if target is not None:
        open_to &= np.arange(network.channel_count) == target
    if goals == "outlet":
        open_to &= False
    cells = _Cells(terrain, here, params.farthest * width)
    goal = cells.of(xy[open_to[owner]])
    if goals != "channels":
        goal = np.union1d(goal, cells.rim(terrain))
    wall = np.setdiff1d(cells.of(xy[~open_to[owner]]), cells.of(here[None]))
    way = cells.cheapest(int(cells.of(here[None])[0]), goal[goal >= 0], wall[wall >= 0], params.steepest_rise)
    if len(way) < 2:
        what = "another channel" if goals == "channels" else "the edge of the ground"
        return Refusal(f"no way leads to {what}", (float(here[0]), float(here[1])))
    candidates, end, last = np.flatnonzero(open_to[owner]), -1, way[-1:]
    if len(candidates):
        away = np.hypot(*(xy[candidates] - way[-1]).T)
        if away.min() <= cells.size:
            end = int(candidates[away.argmin()])
            last = xy[end : end + 1]
    corners = np.concatenate([here[None], way[THINNED:-1:THINNED], last])
    line = smooth_line(corners, float(state.spacing.numpy()[channel]))
    ground = terrain.sample(line)
    if not np.isfinite(ground).all():
        return Refusal("there is no ground", (float(here[0]), float(here[1])))
    rise = np.diff(ground) / np.hypot(*np.diff(line, axis=0).T)
    if rise.max() > params.steepest_rise:
        x, y = line[int(rise.argmax())].tolist()
        return Refusal(f"the ground rises by more than {params.steepest_rise:g} m/m", (x, y))
    course = Course(line, ground, falling_bed(line, ground, params.fall))
    if course.deepest_cut > params.deepest_cut * depth:
        x, y = line[int((ground - course.bed).argmax())].tolist()
        return Refusal(f"the cut would be deeper than {params.deepest_cut:g} depths", (x, y))
    return Diversion.along(network, channel, point, end, course)


class _Cells:
    """The ground around a place, on cells of a number that can be searched."""

    def __init__(self, terrain: Terrain, center: FloatArray, reach: float):
        """Take the cells within a distance of the place, or means of them."""
        x, y = center.tolist()
        near = terrain.raster.window(x - reach, y - reach, x + reach, y + reach)
        row, column, rows, columns = near if near is not None else (0, 0, 2, 2)
        self._step = max(1, math.ceil(max(rows, columns) / MAX_CELLS))
        self.size = terrain.cell_size * self._step
        west, north = terrain.origin
        self._west, self._north = west + column * terrain.cell_size, north - row * terrain.cell_size
        self.shape = math.ceil(rows / self._step), math.ceil(columns / self._step)
        self.height = terrain.sample(self.centers(np.arange(math.prod(self.shape)))).reshape(self.shape)

    def centers(self, cell: IndexArray) -> FloatArray:
        """Return the centres of cells, m."""
        i, j = np.divmod(cell, self.shape[1])
        return np.column_stack([self._west + (j + 0.5) * self.size, self._north - (i + 0.5) * self.size])

    def of(self, xy: FloatArray) -> IndexArray:
        """Return the cells that points lie in, each once; -1 for those beyond."""
        j, i = np.floor((xy[:, 0] - self._west) / self.size), np.floor((self._north - xy[:, 1]) / self.size)
        inside = (i >= 0) & (j >= 0) & (i < self.shape[0]) & (j < self.shape[1])
        return np.unique(np.where(inside, i * self.shape[1] + j, -1).astype(np.int64))

    def rim(self, terrain: Terrain) -> IndexArray:
        """Return the cells at the edge of the ground, and those next to cells without data."""
        west, south, east, north = terrain.bounds
        known = np.isfinite(self.height)
        xy = self.centers(np.arange(known.size))
        away = np.minimum.reduce([xy[:, 0] - west, east - xy[:, 0], xy[:, 1] - south, north - xy[:, 1]])
        edge = (away < self.size).reshape(self.shape) | (grey_dilation((~known).astype(np.uint8), (3, 3)) > 0)
        return np.flatnonzero((edge & known).ravel())

    def cheapest(self, source: int, goal: Any, wall: Any, steepest: float) -> FloatArray:
        """Return the centres of the cells of the cheapest way to any of the goals, m; none where there is no way.

        Cells within two of where the ground is steeper than ``steepest`` are as dear as a climb of that slope: a smooth
        line through the way keeps clear of what its cells do.
        """
        free = np.isfinite(self.height)
        free.ravel()[wall] = False
        steep = np.hypot(*np.gradient(self.height, self.size)) > steepest
        price = np.where(grey_dilation(steep.astype(np.uint8), (3, 3)) > 0, DEAR, 1.0).ravel()
        dear = DEAR / max(steepest, MIN_SLOPE)
        number = np.arange(free.size).reshape(self.shape)
        rows, columns, costs = [], [], []
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = number[: self.shape[0] - down, max(-right, 0) : self.shape[1] - max(right, 0)]
            b = number[down:, max(right, 0) : self.shape[1] - max(-right, 0)]
            both = free.ravel()[a] & free.ravel()[b]
            a, b = a[both], b[both]
            climb = self.height.ravel()[b] - self.height.ravel()[a]
            length = self.size * math.hypot(down, right)
            for first, second, rise in ((a, b, climb), (b, a, -climb)):
                rows.append(first)
                columns.append(second)
                costs.append(length * price[second] + dear * np.maximum(rise, 0.0))
        entries = np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))
        cost, before = dijkstra(
            coo_array(entries, shape=(free.size, free.size)).tocsr(), indices=source, return_predecessors=True
        )
        if not len(goal) or not np.isfinite(cost[goal]).any():
            return np.empty((0, 2))
        way = [int(goal[cost[goal].argmin()])]
        while before[way[-1]] >= 0:
            way.append(int(before[way[-1]]))
        return self.centers(np.array(way[::-1]))
