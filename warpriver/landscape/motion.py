"""Motion: what channels do between two records: they move, farther than they are wide, and leave courses at once."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.extras import IMPORTING
from warpriver.history.events import Cutoff
from warpriver.kernels.covers import FELT
from warpriver.landscape.splatting import Segments, Splat, Visit
from warpriver.landscape.traces import old_courses_of

__all__ = ["Motion", "lead_between"]

# Stages that the way of a channel is cut into where it moves by more than so many widths.
STAGES = ((2, 0.75), (4, 1.5), (8, 3.0), (12, 6.0))
# Around a channel that moves fast the stages are followed so far, in widths; farther off its distance changes evenly.
FAST_REACH = 2.0
# Feet of two neighbouring points lie no farther apart along the old course than so many lengths of their segment and so
# many times what they have moved; else the channel has jumped.
SEGMENT_LENGTHS, MOVED_LENGTHS = 3.0, 4.0
# Nodes that have moved farther than so many widths are matched with places up to so many widths along the old course,
# tried at so many; a difference in direction weighs as much as one in curvature, and this many widths.
MATCHED_WIDTHS, MATCH_WIDTHS, MATCH_TRIES, MATCH_STIFFNESS = 0.1, 3.0, 13, 0.05
# And farther than so many times the root of width times cell.
MATCHED_CELLS = 0.6
# They move no farther along it than so many times what the bend has moved across; of shifts of neighbouring nodes.
MATCH_MOVES = 1.25
MATCH_WEIGHTS = np.array([1.0, 2.0, 3.0, 2.0, 1.0])
# What spans a neck when it was cut lies within so many widths of what joined both sides.
BRIDGE_WIDTHS = 4.0
# A segment that spans a neck that was cut is no longer than so many widths, beyond what its ends have moved.
NECK_WIDTHS = 2.0


@dataclasses.dataclass(frozen=True)
class Motion:
    """How the segments of a network came to where they are.

    Attributes:
        segments: At the later record, with how far they have moved.
        begin: (S, 4) begin and end of each at the record before, m.
        born: (S,) when those that have not moved there appeared, yr; -inf for those that have moved.
        since: (S,) when they were where they begin, as a part of the time between the records.
    """

    segments: Segments
    begin: np.ndarray
    born: np.ndarray
    since: np.ndarray

    def take(self, which: np.ndarray) -> Motion:
        """Return the motion of some of the segments."""
        return Motion(self.segments.take(which), self.begin[which], self.born[which], self.since[which])

    def at(self, part: float, latest: float) -> Segments:
        """Return the segments when a part of the time between the records has passed, of those born up to a time."""
        there = self.born <= latest
        gone = np.clip((part - self.since[there]) / np.maximum(1.0 - self.since[there], 1e-12), 0.0, 1.0)
        begin, segments = self.begin[there], self.segments.take(there)
        return dataclasses.replace(segments, line=begin + gone[:, None] * (segments.line - begin))


def traced(
    splat: Splat,
    before: Segments,
    after: Segments,
    old: Segments,
    bridges: Segments,
    times: tuple[float, float],
) -> Motion:
    """Find where segments come from on the course that the cells were led to last.

    Args:
        splat: The cells.
        before: Segments of that course.
        after: Segments of the following one.
        old: Courses that were given up in between.
        bridges: What joined both sides of the necks that were cut in between.
        times: Of both records, yr.
    """
    count = len(after.line)
    nodes = _Nodes.of(after)
    ends = np.stack([nodes.begin, nodes.begin + 1], axis=1)
    begin, moved, source, sag = (values[ends] for values in _sources(splat, before, nodes))
    begin = begin.reshape(-1, 4)
    length = np.hypot(*(before.line[:, 2:] - before.line[:, :2]).T)
    # Along each old channel; segments of different ones follow each other without a gap.
    arc = np.cumsum(length) - 0.5 * length
    apart = np.abs(arc[source[:, 1]] - arc[source[:, 0]])
    size = np.hypot(*(after.line[:, 2:] - after.line[:, :2]).T)
    own = (source >= 0).all(axis=1)
    own &= apart <= SEGMENT_LENGTHS * size + MOVED_LENGTHS * moved.sum(axis=1)
    born, since = np.full(count, -np.inf), np.zeros(count)
    jumped = np.flatnonzero(~own)
    if len(jumped):
        born[jumped] = 0.5 * (times[0] + times[1])
        if len(old.line):
            with IMPORTING:
                from scipy.spatial import cKDTree

            middle = 0.5 * (after.line[jumped, :2] + after.line[jumped, 2:])
            born[jumped] = old.time[cKDTree(old.line[:, :2]).query(middle)[1]]
        # Where a neck was cut they span it, and move with the points beside them.
        span = np.hypot(*(begin[jumped, 2:] - begin[jumped, :2]).T)
        width = after.section[jumped, 0]
        far = jumped[~((source[jumped] >= 0).all(axis=1) & (span <= NECK_WIDTHS * width + moved[jumped].sum(axis=1)))]
        begin[far] = after.line[far]
        moved[far] = 0.0
        sag[jumped] = 0.0
        if len(far) and len(bridges.line):
            near, feet = _feet_on(bridges, begin[far], after.section[far, 0])
            far, feet, bridge = far[near >= 0], feet[near >= 0], near[near >= 0]
            begin[far] = feet
            moved[far] = np.hypot(*np.moveaxis((after.line[far] - feet).reshape(-1, 2, 2), 2, 0))
            # At that time the bridges are there in their place.
            slack = 4e-9 * max(1.0, abs(times[1]))
            born[far] = bridges.time[bridge] + slack
            since[far] = (bridges.time[bridge] - times[0]) / (times[1] - times[0])
    return Motion(dataclasses.replace(after, moved=moved, sag=sag), begin, born, since)


def _feet_on(bridges: Segments, line: FloatArray, width: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Return the bridge that is nearest to each segment, -1 where none is near, and the feet of its ends, (n, 4)."""
    with IMPORTING:
        from scipy.spatial import cKDTree

    middle = 0.5 * (bridges.line[:, :2] + bridges.line[:, 2:])
    away, nearest = cKDTree(middle).query(0.5 * (line[:, :2] + line[:, 2:]))
    feet = [_foot_on(bridges.line[nearest], line[:, k : k + 2]) for k in (0, 2)]
    return np.where(away <= BRIDGE_WIDTHS * width, nearest, -1), np.hstack(feet)


def _foot_on(line: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the place on each segment, (n, 4), that is nearest to a point, (n, 2)."""
    way, off = line[:, 2:] - line[:, :2], xy - line[:, :2]
    part = np.clip((off * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-30), 0.0, 1.0)
    foot: FloatArray = line[:, :2] + part[:, None] * way
    return foot


def bridges_of(events: Sequence[Any]) -> Segments:
    """Return what joined both sides of the necks that were cut, a segment each."""
    # The loops of shortest paths are closed.
    cut = [e for e in events if isinstance(e, Cutoff) and len(e.xy) > 1 and (e.xy[0] != e.xy[-1]).any()]
    ends = [0, -1]
    return old_courses_of(
        [dataclasses.replace(e, xy=e.xy[ends], section=None if e.section is None else e.section[ends]) for e in cut]
    )


@dataclasses.dataclass(frozen=True)
class _Nodes:
    """Ends of segments, in order along chains of them.

    Attributes:
        xy: (N, 2) m.
        width: (N,) m.
        begin: (S,) node at which each segment begins; it ends at the next one.
        head: (C,) first node of each chain.
    """

    xy: FloatArray
    width: FloatArray
    begin: IndexArray
    head: IndexArray

    @classmethod
    def of(cls, segments: Segments) -> _Nodes:
        """Find the nodes of segments, most of which end where the next one begins."""
        line, count = segments.line, len(segments.line)
        first = np.append(True, (line[1:, 0] != line[:-1, 2]) | (line[1:, 1] != line[:-1, 3]))[:count]
        begin = np.arange(count) + np.cumsum(first) - 1
        last = np.append(first[1:], True)[:count]
        total = count + int(first.sum())
        xy, width = np.empty((total, 2)), np.empty(total)
        xy[begin], width[begin] = line[:, :2], segments.section[:, 0]
        end = begin[last] + 1
        xy[end], width[end] = line[last, 2:], segments.section[last, 2]
        return cls(xy, width, begin, begin[first])


@dataclasses.dataclass(frozen=True)
class _Chains:
    """Nodes as courses with directions and bends.

    Attributes:
        arc: (N,) distance along its chain in m; chains lie far apart.
        low: (N,) where its chain begins, m.
        high: (N,) where it ends, m.
        along: (N, 2) direction of the chain.
        heading: (N,) its angle.
        curvature: (N,) 1/m, above 0 to the left.
    """

    arc: FloatArray
    low: FloatArray
    high: FloatArray
    along: FloatArray
    heading: FloatArray
    curvature: FloatArray

    @classmethod
    def of(cls, nodes: _Nodes) -> _Chains:
        """Follow the chains of some nodes."""
        total, begin, head = len(nodes.xy), nodes.begin, nodes.head
        way = nodes.xy[begin + 1] - nodes.xy[begin]
        length = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-12)
        unit = way / length[:, None]
        along, sizes, step = np.zeros((total, 2)), np.zeros(total), np.zeros(total)
        along[begin], sizes[begin] = unit, 0.5 * length
        along[begin + 1] += unit
        sizes[begin + 1] += 0.5 * length
        along /= np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-12)[:, None]
        # Chains apart by more than any match is looked for.
        step[begin + 1], step[head] = length, 1e3 * float(nodes.width.max(initial=1.0))
        arc = np.cumsum(step)
        turn, before, behind = np.zeros(total), unit[:-1], unit[1:]
        chained = begin[1:] == begin[:-1] + 1
        cross = before[:, 0] * behind[:, 1] - before[:, 1] * behind[:, 0]
        turns = np.arctan2(cross, (before * behind).sum(axis=1))
        turn[begin[1:][chained]] = turns[chained]
        heading = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
        counts = np.diff(np.append(head, total))
        low, high = (np.repeat(arc[place], counts) for place in (head, np.append(head[1:], total) - 1))
        return cls(arc, low, high, along, heading, turn / np.maximum(sizes, 1e-12))


def _sources(splat: Splat, before: Segments, nodes: _Nodes) -> tuple[FloatArray, FloatArray, IndexArray, FloatArray]:
    """Return where nodes come from, (N, 2) m; how far and on which segment the nearest place is, (N,); sags, (N,) m."""
    foot, moved, source = splat.trace(nodes.xy)
    _trace_beyond(splat, before, nodes.xy, nodes.width, foot, moved, source)
    sag = np.zeros(len(moved))
    # With their neighbours: an apex may move along the course alone. Ways that bulge by less than a small part of a
    # cell are straight.
    with IMPORTING:
        from scipy.ndimage import maximum_filter1d

    around = maximum_filter1d(moved, 2 * MATCH_TRIES, mode="nearest")
    least = np.maximum(MATCHED_WIDTHS * nodes.width, MATCHED_CELLS * np.sqrt(splat.cell_size * nodes.width))
    some = np.flatnonzero((source >= 0) & (around > least))
    if len(some):
        _match(_Nodes.of(before), nodes, some, MATCH_MOVES * around[some], foot, source, sag)
    return foot, moved, source, sag


def _match(
    old: _Nodes,
    new: _Nodes,
    some: IndexArray,
    most: FloatArray,
    foot: FloatArray,
    source: IndexArray,
    sag: FloatArray,
) -> None:
    """Move the feet of some nodes along the old course to where it has their direction and their bend, in place.

    Bends run downstream: what is nearest to an apex is a flank. A node that comes from a place of its own direction
    moves with its bend; the ground beside it sees the bend pass by, its distance to the channel bulging by curvature
    times the square of the way along it, over 8.
    """
    width, start = new.width[some], old.begin[source[some]]
    was, now = _Chains.of(old), _Chains.of(new)
    at = was.arc[start] + np.hypot(*(foot[some] - old.xy[start]).T)
    low, high = was.low[start], was.high[start]
    tries = np.linspace(-MATCH_WIDTHS, MATCH_WIDTHS, MATCH_TRIES)
    cost = np.empty((MATCH_TRIES, len(some)))
    for k, shift in enumerate(tries.tolist()):
        place = np.clip(at + shift * width, low, high)
        turn = np.interp(place, was.arc, was.heading) - now.heading[some]
        turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
        bend = width * (np.interp(place, was.arc, was.curvature) - now.curvature[some])
        cost[k] = turn**2 + bend**2 + (MATCH_STIFFNESS * (place - at) / width) ** 2
    best = np.clip(cost.argmin(axis=0), 1, MATCH_TRIES - 2)
    left, here, right = (cost[best + k, np.arange(len(some))] for k in (-1, 0, 1))
    # The lowest point of a parabola through three of them.
    curved = np.maximum(left - 2.0 * here + right, 1e-12)
    shift = tries[best] + np.clip(0.5 * (left - right) / curved, -1.0, 1.0) * (tries[1] - tries[0])
    # Alike along the channel, where neighbours are matched as well.
    whole = np.zeros(len(new.xy))
    whole[some] = shift
    chosen = np.zeros(len(new.xy))
    chosen[some] = 1.0
    total, weight = (np.convolve(values, MATCH_WEIGHTS, "same") for values in (whole, chosen))
    shift = (total / np.maximum(weight, 1e-12))[some]
    place = np.clip(at + np.clip(shift * width, -most, most), low, high)
    for k in range(2):
        foot[some, k] = np.interp(place, was.arc, old.xy[:, k])
    along = ((new.xy[some] - foot[some]) * now.along[some]).sum(axis=1)
    bend = 0.5 * (now.curvature[some] + np.interp(place, was.arc, was.curvature))
    sag[some] = -bend * along**2 / 8.0


def _trace_beyond(
    splat: Splat,
    before: Segments,
    xy: np.ndarray,
    width: np.ndarray,
    foot: np.ndarray,
    moved: np.ndarray,
    source: np.ndarray,
) -> None:
    """Find the feet of points beyond the edge of the raster, in place, from where they are felt within."""
    beyond = np.flatnonzero((source < 0) & splat.is_beyond(xy, 2.0 * FELT * width))
    if not len(beyond) or not len(before.line):
        return
    with IMPORTING:
        from scipy.spatial import cKDTree

    middle = 0.5 * (before.line[:, :2] + before.line[:, 2:])
    reach = FELT * float(width[beyond].max())
    away, nearest = cKDTree(middle).query(xy[beyond], distance_upper_bound=reach)
    found = np.isfinite(away)
    beyond, nearest = beyond[found], nearest[found]
    foot[beyond] = _foot_on(before.line[nearest], xy[beyond])
    moved[beyond] = np.hypot(*(xy[beyond] - foot[beyond]).T)
    source[beyond] = nearest


def lead_between(
    splat: Splat,
    before: Segments,
    after: Segments,
    events: Sequence[Any],
    times: tuple[float, float],
    counted: bool,
) -> Segments:
    """Lead the cells through what happens between two records, and return the segments at the later one.

    Where channels move by more than their width the cells see stages of that; where courses are given up, they see the
    channel with them up to that time, and without them from then on.

    Args:
        splat: The cells, at the earlier record.
        before: Segments at the earlier record.
        after: Segments at the later one.
        events: Those between, that left courses behind.
        times: Of both records, yr.
        counted: Add the time up.
    """
    old = splat.widened(old_courses_of(events))
    bridges = splat.widened(bridges_of(events))
    motion = traced(splat, before, after, old, bridges, times)
    if len(old.line):
        old = dataclasses.replace(old, moved=splat.trace(old.line.reshape(-1, 2))[1].reshape(-1, 2))
    first, last = times
    segments, years = motion.segments, last - first
    # No finer than the cells are.
    ways = np.maximum(np.hypot(*np.moveaxis((segments.line - motion.begin).reshape(-1, 2, 2), 2, 0)), segments.moved)
    ratio = (ways / np.maximum(segments.section[:, ::2], splat.cell_size)).max(axis=1)
    stops = _stops(splat, motion, ratio)
    felt = FELT * old.section[:, ::2].max(axis=1)
    met = np.flatnonzero(splat.reaches(old.line, felt))
    old, felt = old.take(met), felt[met]
    left = [(time, np.flatnonzero(old.time == time)) for time in np.unique(old.time).tolist()]
    ends = [(time, some, splat.tiles_near(old.line[some], felt[some])) for time, some in left]
    # What no cell of those tiles can feel is left out.
    reach = FELT * segments.section[:, ::2].max(axis=1) + ways.max(axis=1)
    seen = np.unique(np.concatenate([np.empty(0, np.int64), *(some[-1] for some in (*stops, *ends))]))
    near = np.flatnonzero(splat.reaches(segments.line, reach, seen))
    motion, reach = motion.take(near), reach[near]
    slack = 1e-9 * max(1.0, abs(first), abs(last))
    visits: list[Visit] = []
    shared: dict[int, Motion] = {}
    stages = [(first + part * years, None, tiles) for part, tiles in stops]
    for time, some, tiles in sorted([*stages, *ends], key=lambda stop: stop[0]):
        part = (time - first) / years
        # The stages of the same tiles share what they feel.
        if id(tiles) not in shared:
            shared[id(tiles)] = motion.take(np.flatnonzero(splat.reaches(motion.segments.line, reach, tiles)))
        there = shared[id(tiles)]
        if some is not None:
            ending = functools.partial(_until, there, old, (part, time, slack))
            visits.append(Visit(time, tiles, ending))
        visits.append(Visit(time, tiles, functools.partial(_from, there, old, bridges, (part, time, slack), some)))
    splat.visit(visits, counted=counted, span=years)
    return segments


def _stops(splat: Splat, motion: Motion, ratio: FloatArray) -> list[tuple[float, IndexArray]]:
    """Return the stages that places see where channels move by more than their width.

    Args:
        splat: The cells.
        motion: How segments move.
        ratio: By how many widths.

    Returns:
        Parts of the time between the records, and the tiles that see the channels then.
    """
    segments, stops, done = motion.segments, [], np.empty(0, np.int64)
    for stages, least in reversed(STAGES):
        fast = ratio > least
        if fast.any():
            reach = FAST_REACH * segments.section[fast, ::2].max(axis=1)
            lines = (motion.begin[fast], segments.line[fast])
            tiles = np.union1d(*(splat.tiles_near(line, reach) for line in lines))
            # Those that see more stages see these among them.
            fresh = np.setdiff1d(tiles, done, assume_unique=True)
            if len(fresh):
                stops += [(k / stages, fresh) for k in range(1, stages)]
            done = tiles
    return stops


def _until(motion: Motion, old: Segments, at: tuple[float, float, float]) -> Segments:
    """Return what runs up to a time at which courses are given up: part of the time between records, time, slack."""
    part, time, slack = at
    return motion.at(part, time - slack).join(old.take(old.time > time - slack))


def _from(
    motion: Motion, old: Segments, bridges: Segments, at: tuple[float, float, float], ended: IndexArray | None
) -> Segments:
    """Return what runs from a time on, at which some courses may have been given up."""
    part, time, slack = at
    running = motion.at(part, time + slack)
    if ended is not None:
        # The channel jumps; it passes over nothing.
        running = dataclasses.replace(running, moved=np.zeros_like(running.moved))
    return running.join(bridges.take(np.abs(bridges.time - time) <= slack), old.take(old.time > time + slack))
