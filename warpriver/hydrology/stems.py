"""Stems: the channel cells as courses from source to mouth, and how their channels get long enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.hydrology.channel_cells import ChannelCells, climb

__all__ = ["Stems", "drop_dead", "place_junctions", "settle_areas", "space_junctions", "split_into_stems"]


# Minimum length of a channel: cells, and widths. A line needs three points, and may not be shorter than it is wide.
MIN_CELLS, MIN_WIDTHS = 3.0, 2.0
# Minimum length of a channel from a source, as a fraction of the square root of the minimum drainage area. Channels
# from sources have a mean length of about that root; a tenth of them are shorter than this.
STUB = 0.3


@dataclass
class Stems:
    """The channel cells as stems: each runs from a source down along the largest donors, to an outlet or another stem.

    The cells of all stems lie end to end, each stem from its source down.

    Attributes:
        cell: (n,) which of the channel cells it is.
        place: (n,) row and column of the cell.
        height: (n,) height of the surface that water runs on in m.
        area: (n,) drainage area in cells.
        supply: (n,) what of it comes from no channel cell, in cells.
        start: (S + 1,) offsets of the stems.
        parent: (S,) stem that it flows into; -1 at an outlet.
        joint: (S,) place, among all stems' cells, where it flows into its parent; -1 at an outlet.
        capacity: (n,) how many channels of the minimum length fit between the stem's source and the cell.
        alive: (S,) False for stems that are left out.
    """

    cell: IndexArray
    place: IndexArray
    height: FloatArray
    area: FloatArray
    supply: FloatArray
    start: IndexArray
    parent: IndexArray
    joint: IndexArray
    capacity: FloatArray
    alive: FlagArray

    @property
    def end(self) -> IndexArray:
        """(S,) place of each stem's last cell."""
        return self.start[1:] - 1

    @property
    def stem(self) -> IndexArray:
        """(n,) stem of each cell."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    def tributaries(self) -> IndexArray:
        """Stems that flow into another, by the place where they do.

        Of those at one place the first comes from furthest upstream: by its angle to the stem above the place.
        """
        found = np.flatnonzero(self.alive & (self.parent >= 0))
        joint = self.joint[found]
        above = np.maximum(joint - 1, self.start[self.parent[found]])
        upstream, course = self._between(joint, above), self._between(joint, self.end[found])
        length = np.hypot(*upstream.T) * np.hypot(*course.T)
        cosine = (upstream * course).sum(axis=1) / np.maximum(length, 1e-9)
        return found[np.lexsort((self.area[self.end[found]], np.round(-cosine, 9), joint))]

    def _between(self, a: IndexArray, b: IndexArray) -> FloatArray:
        """Rows and columns from the cells at some places to those at others."""
        return (self.place[b] - self.place[a]).astype(np.float64)


def split_into_stems(cells: ChannelCells, coefficient: float) -> Stems:
    """Split the channel cells into stems; the width is the coefficient times the square root of the area, in cells."""
    n = len(cells.down)
    inner = np.flatnonzero(cells.down >= 0)
    # The largest donor of each cell continues its stem; of equal ones the last in the raster.
    main = np.full(n, -1)
    by_area = inner[np.argsort(cells.area[inner], kind="stable")]
    main[cells.down[by_area]] = by_area
    head, rise = climb(main)
    order = np.lexsort((rise, head))
    start = np.concatenate([np.flatnonzero(rise[order] == 0), [n]])
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(n)
    stem = np.repeat(np.arange(len(start) - 1), np.diff(start))
    below = cells.down[order[start[1:] - 1]]
    joint = np.where(below >= 0, rank[below], -1)
    area = cells.area[order]
    # Width in cells, times the minimum length in widths, and one for rounding to whole cells.
    needed = np.maximum(MIN_CELLS, MIN_WIDTHS * coefficient * np.sqrt(area) + 1.0)
    fits = np.concatenate([[0.0], np.cumsum(1.0 / needed[1:])])
    return Stems(
        cell=order,
        place=cells.place[order],
        height=cells.height[order],
        area=area,
        supply=cells.supply[order],
        start=start,
        parent=np.where(below >= 0, stem[joint], -1),
        joint=joint,
        capacity=fits - np.repeat(fits[start[:-1]], np.diff(start)),
        alive=np.ones(len(start) - 1, bool),
    )


def space_junctions(stems: Stems, threshold: float) -> None:
    """Leave out stems, and lead others past the end of the one they join, until all junctions have enough space.

    Args:
        stems: All stems; they are changed.
        threshold: Minimum drainage area of a channel in cells, which decides what is a stub.
    """
    length = stems.capacity[stems.end]
    stub = np.diff(stems.start) - 1 < STUB * np.sqrt(threshold)
    while True:
        joining = stems.tributaries()
        parent, joint = stems.parent[joining], stems.joint[joining]
        load = np.bincount(parent, minlength=len(length))
        spur = stems.alive & (load == 0) & ((length < 1.0) | stub)
        if spur.any():
            _leave_out(stems, np.flatnonzero(spur))
            continue
        # A tributary that joins a stem right above its end joins the next one downstream; a full stem's last one too.
        full = stems.alive & (load > 0) & (load + 1 > length)
        lowest = np.zeros(len(joining), bool)
        lowest[:-1] = parent[1:] != parent[:-1]
        lowest[-1:] = True
        can = stems.parent[parent] >= 0
        passing = can & ((stems.capacity[joint] > length[parent] - 1.0) | (lowest & full[parent]))
        if passing.any():
            moved, past = joining[passing], parent[passing]
            stems.joint[moved], stems.parent[moved] = stems.joint[past], stems.parent[past]
            continue
        # A full stem that ends at an outlet loses its smallest tributary.
        crowd = np.flatnonzero(full[parent])
        if not len(crowd):
            return
        crowd = crowd[np.lexsort((stems.area[stems.end[joining[crowd]]], parent[crowd]))]
        smallest = np.concatenate([[True], parent[crowd][1:] != parent[crowd][:-1]])
        _leave_out(stems, joining[crowd[smallest]])


def _leave_out(stems: Stems, which: IndexArray) -> None:
    """Take stems out with all that flows into them; their ground drains to where they did."""
    dead = np.zeros(len(stems.alive), bool)
    dead[which] = True
    while True:
        more = dead | (stems.alive & (stems.parent >= 0) & dead[stems.parent])
        if (more == dead).all():
            break
        dead = more
    water = _stem_totals(stems)
    joined = which[stems.parent[which] >= 0]
    np.add.at(stems.supply, stems.joint[joined], water[joined])
    stems.alive[dead] = False


def _stem_totals(stems: Stems) -> FloatArray:
    """Drainage area of each living stem at its lower end in cells, with all that flows into it: (S,)."""
    total = np.add.reduceat(stems.supply, stems.start[:-1])
    depth = climb(stems.parent)[1]
    joining = np.flatnonzero(stems.alive & (stems.parent >= 0))
    joining = joining[np.argsort(-depth[joining], kind="stable")]
    for level in np.split(joining, np.flatnonzero(np.diff(depth[joining])) + 1):
        np.add.at(total, stems.parent[level], total[level])
    return total


def drop_dead(stems: Stems) -> None:
    """Forget the stems that are left out."""
    keep = np.flatnonzero(stems.alive)
    count = np.diff(stems.start)[keep]
    start = np.concatenate([[0], np.cumsum(count)])
    shift = stems.start[keep] - start[:-1]
    source = np.arange(start[-1]) + np.repeat(shift, count)
    number = np.cumsum(stems.alive) - 1
    parent = stems.parent[keep]
    inner = parent >= 0
    joint = stems.joint[keep]
    joint[inner] += (start[number[parent[inner]]]) - stems.start[parent[inner]]
    parent[inner] = number[parent[inner]]
    for name in ("cell", "place", "height", "area", "supply", "capacity"):
        setattr(stems, name, getattr(stems, name)[source])
    stems.start, stems.parent, stems.joint = start, parent, joint
    stems.alive = np.ones(len(keep), bool)


def place_junctions(stems: Stems) -> IndexArray:
    """Place where each stem meets its parent: (S,) among all stems' cells, one to a place, -1 at outlets.

    Junctions first move down until each is one channel downstream of the one before, then up until they end in time.
    """
    junction = np.full(len(stems.parent), -1)
    joining = stems.tributaries()
    if not len(joining):
        return junction
    parent = stems.parent[joining]
    first = np.searchsorted(parent, np.unique(parent))
    count = np.diff(np.append(first, len(parent)))
    nth = np.arange(len(joining)) - np.repeat(first, count)
    left = np.repeat(count, count) - nth
    # One number line for all stems, each on a stretch of its own.
    length = stems.capacity[stems.end]
    stretch = np.concatenate([[0.0], np.cumsum(np.ceil(length) + 2.0)])[:-1]
    target = np.maximum(stems.capacity[stems.joint[joining]], 1.0) + stretch[parent]
    target = np.maximum.accumulate(target - nth) + nth
    target = np.minimum(target, length[parent] + stretch[parent] - left)
    line = stems.capacity + np.repeat(stretch, np.diff(stems.start))
    junction[joining] = np.searchsorted(line, target - 1e-9)
    return junction


def settle_areas(stems: Stems, junction: IndexArray) -> FloatArray:
    """Replace each cell's area by what its stem drains there; return the stems' own at their lower ends, in cells."""
    total = _stem_totals(stems)
    gain = stems.supply.copy()
    joining = junction >= 0
    gain[junction[joining]] += total[joining]
    summed = np.concatenate([[0.0], np.cumsum(gain)])
    stems.area = summed[1:] - np.repeat(summed[stems.start[:-1]], np.diff(stems.start))
    return total
