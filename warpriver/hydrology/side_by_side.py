"""Streams that run side by side: each joins its neighbour where it first comes close."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from warpriver.arrays import FlagArray, IndexArray
from warpriver.extras import IMPORTING
from warpriver.hydrology.channel_cells import ChannelCells
from warpriver.hydrology.stems import Stems, split_into_stems

with IMPORTING:
    from scipy.spatial import cKDTree

__all__ = ["join_side_by_side"]


# Streams are close within this distance between cell centres, and, from bank to bank, within one cell.
CLOSE = 3.2
# They run side by side if they are close for this many cells, and for so many times the distance, above their junction.
SIDE_BY_SIDE, ASPECT = 8, 4.0
# They are led together over a stretch of this many times the distance.
SLANT = 2.0


class _Pairs(NamedTuple):
    """Stems, each with another one that it may run alongside of.

    Attributes:
        stem: (P,) the smaller one.
        beside: (P,) the other one: its parent, the next tributary of that, or a stem that ends near it; the larger one.
        limit: (P,) place on the other one down to which it may be joined.
    """

    stem: IndexArray
    beside: IndexArray
    limit: IndexArray

    def take(self, which: IndexArray | FlagArray) -> _Pairs:
        """Some of them."""
        return _Pairs(*(values[which] for values in self))


def join_side_by_side(cells: ChannelCells, coefficient: float) -> ChannelCells:
    """Join streams that run alongside of the one they flow into, or of a larger one that ends where they do.

    Where a stream is close to the other one all the way down to its end, over a length that is no mere junction, it
    joins it where that begins, as far as water can get there without rising. So it may leave the map with the other.

    Args:
        cells: The channel cells.
        coefficient: Width over the square root of the drainage area, both in cells.
    """
    while True:
        if not len(cells.down):
            return cells
        stems = split_into_stems(cells, coefficient)
        course = _Courses(stems, coefficient)
        pairs = _neighbors(stems, course.reach)
        # Most diverge at once: only the others are followed all the way up.
        pairs = pairs.take(course.close_at_end(pairs))
        top, pairs = course.tops(pairs)
        # What is joined this time must stay as it is.
        moving = np.zeros(len(stems.parent), bool)
        moving[pairs.stem] = True
        still = ~moving[pairs.beside]
        pairs, top = pairs.take(still), top[still]
        if not len(top):
            return cells
        # A stream that runs alongside of several joins the one beside which it runs for longest.
        order = np.lexsort((pairs.beside, top, pairs.stem))
        once = order[np.append(True, np.diff(pairs.stem[order]) != 0)]
        cells = _joined(cells, stems, course, pairs.take(once), top[once])


def _neighbors(stems: Stems, reach: float) -> _Pairs:
    """Each tributary beside its parent, and each stem beside larger ones that end near it: next ones up or down."""
    joining = stems.tributaries()
    parent = stems.parent[joining]
    next_one = parent[1:] == parent[:-1]
    root = np.flatnonzero(stems.parent < 0)
    near = cKDTree(stems.place[stems.end[root]]).query_pairs(reach, output_type="ndarray")
    a = np.concatenate([joining[:-1][next_one], root[near[:, 0]]])
    b = np.concatenate([joining[1:][next_one], root[near[:, 1]]])
    area = stems.area[stems.end]
    larger = np.where((area[a] > area[b]) | ((area[a] == area[b]) & (a > b)), a, b)
    stem, beside = np.concatenate([joining, a + b - larger]), np.concatenate([parent, larger])
    return _Pairs(stem, beside, np.concatenate([stems.joint[joining], stems.end[larger]]))


class _Courses:
    """The stems' cells, to be asked for the nearest one on a stem."""

    def __init__(self, stems: Stems, coefficient: float):
        self.stems = stems
        self.half_width = 0.5 * coefficient * np.sqrt(stems.area)
        self.reach = max(CLOSE, 2.0 * float(self.half_width.max()) + 1.0)
        # Stems lie in planes of their own, farther apart than any reach.
        self.apart = 4.0 * self.reach
        self.tree = cKDTree(np.column_stack([stems.place, self.apart * stems.stem]))

    def nearest(self, place: IndexArray, beside: IndexArray, limit: IndexArray) -> IndexArray:
        """Nearest place on a stem, for cells at some places; -1 where none is close.

        What lies a little downstream of the limit counts as the limit.
        """
        point = np.column_stack([self.stems.place[place], self.apart * beside])
        distance, found = self.tree.query(point, distance_upper_bound=self.reach)
        found = np.where(np.isfinite(distance), found, 0)
        close = distance <= np.maximum(CLOSE, self.half_width[place] + self.half_width[found] + 1.0)
        close &= found <= limit + np.int64(self.reach)
        return np.where(close, np.minimum(found, limit), -1)

    def span(self, pairs: _Pairs) -> IndexArray:
        """Number of cells that a tributary has to be close for."""
        width = 2.0 * self.half_width[self.stems.end[pairs.beside]]
        return np.maximum(SIDE_BY_SIDE, np.ceil(ASPECT * width)).astype(np.int64)

    def close_at_end(self, pairs: _Pairs) -> FlagArray:
        """Whether a tributary's last cells are all close to the other stem."""
        length = np.diff(self.stems.start)[pairs.stem]
        count = np.minimum(self.span(pairs), length)
        number = np.repeat(np.arange(len(count)), count)
        up = np.arange(len(number)) - np.repeat(np.cumsum(count) - count, count)
        place = self.stems.end[pairs.stem][number] - up
        near = self.nearest(place, pairs.beside[number], pairs.limit[number])
        close: FlagArray = np.bincount(number, weights=near < 0, minlength=len(count)) == 0.0
        return close

    def tops(self, pairs: _Pairs) -> tuple[IndexArray, _Pairs]:
        """Places from which on the tributaries are close down to their ends and can join; those that can."""
        start, end = self.stems.start[pairs.stem], self.stems.end[pairs.stem]
        count = end - start + 1
        number = np.repeat(np.arange(len(count)), count)
        place = np.arange(len(number)) + np.repeat(start - (np.cumsum(count) - count), count)
        near = self.nearest(place, pairs.beside[number], pairs.limit[number])
        lowest_far = np.full(len(count), -1)
        np.maximum.at(lowest_far, number[near < 0], place[near < 0])
        height = self.stems.height
        can = (near >= 0) & (place > lowest_far[number]) & (height[near] <= height[place])
        top = end.copy()
        np.minimum.at(top, number[can], place[can])
        worth = (top < end) & (end - top + 1 >= np.minimum(self.span(pairs), count))
        return top[worth], pairs.take(worth)


def _joined(cells: ChannelCells, stems: Stems, course: _Courses, pairs: _Pairs, top: IndexArray) -> ChannelCells:
    """Lead tributaries from their top places to the other stems, and leave out their cells from there on."""
    count = stems.end[pairs.stem] - top
    number = np.repeat(np.arange(len(count)), count + 1)
    place = np.arange(len(number)) + np.repeat(top - (np.cumsum(count + 1) - (count + 1)), count + 1)
    near = course.nearest(place, pairs.beside[number], pairs.limit[number])
    instead = np.arange(len(cells.down))
    instead[stems.cell[place]] = stems.cell[near]
    gone = np.zeros(len(cells.down), bool)
    gone[stems.cell[place]] = True
    gone[stems.cell[top]] = False
    # Not straight across: streams meet at a narrow angle.
    onto = near[np.cumsum(count + 1) - (count + 1)]
    across = np.hypot(*(stems.place[top] - stems.place[onto]).T)
    onto = np.minimum(onto + np.ceil(SLANT * across).astype(np.int64), pairs.limit)
    down = cells.down.copy()
    down[stems.cell[top]] = stems.cell[onto]
    return cells.without(gone, instead, down)
