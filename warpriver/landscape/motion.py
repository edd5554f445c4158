"""Motion: what channels do between two records: they move, farther than they are wide, and leave courses at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from warpriver.extras import IMPORTING
from warpriver.kernels.covers import FELT
from warpriver.landscape.splatting import Segments, Splat
from warpriver.landscape.traces import old_courses_of

__all__ = ["Motion", "lead_between"]

# Where a channel moves by more than so many widths, the way is cut into stages of that, up to so many.
STAGE_WIDTHS, MOST_STAGES = 0.75, 12
# Around a channel that moves fast the stages are followed so far, in widths; farther off its distance changes evenly.
FAST_REACH = 2.0
# Feet of two neighbouring points lie no farther apart along the old course than so many lengths of their segment and so
# many times what they have moved; else the channel has jumped.
SEGMENT_LENGTHS, MOVED_LENGTHS = 3.0, 4.0
# A segment that spans a neck that was cut is no longer than so many widths, beyond what its ends have moved.
NECK_WIDTHS = 2.0


@dataclasses.dataclass(frozen=True)
class Motion:
    """How the segments of a network came to where they are.

    Attributes:
        segments: At the later record, with how far they have moved.
        begin: (S, 4) begin and end of each at the record before, m.
        born: (S,) when those that have not moved there appeared, yr; -inf for those that have moved.
    """

    segments: Segments
    begin: np.ndarray
    born: np.ndarray

    def take(self, which: np.ndarray) -> Motion:
        """Return the motion of some of the segments."""
        return Motion(self.segments.take(which), self.begin[which], self.born[which])

    def at(self, part: float, latest: float) -> Segments:
        """Return the segments when a part of the time between the records has passed, of those born up to a time."""
        line = self.begin + part * (self.segments.line - self.begin)
        return dataclasses.replace(self.segments, line=line).take(self.born <= latest)


def traced(splat: Splat, before: Segments, after: Segments, old: Segments, times: tuple[float, float]) -> Motion:
    """Find where segments come from on the course that the cells were led to last.

    Args:
        splat: The cells.
        before: Segments of that course.
        after: Segments of the following one.
        old: Courses that were given up in between.
        times: Of both records, yr.
    """
    count = len(after.line)
    begin, moved, source = _sources(splat, before, after)
    length = np.hypot(*(before.line[:, 2:] - before.line[:, :2]).T)
    # Along each old channel; segments of different ones follow each other without a gap.
    arc = np.cumsum(length) - 0.5 * length
    apart = np.abs(arc[source[:, 1]] - arc[source[:, 0]])
    size = np.hypot(*(after.line[:, 2:] - after.line[:, :2]).T)
    own = (source >= 0).all(axis=1)
    own &= apart <= SEGMENT_LENGTHS * size + MOVED_LENGTHS * moved.sum(axis=1)
    born = np.full(count, -np.inf)
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
    return Motion(dataclasses.replace(after, moved=moved), begin, born)


def _sources(splat: Splat, before: Segments, after: Segments) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the feet of both ends of segments, (S, 4) m, how far these are, (S, 2) m, and on which segment, (S, 2)."""
    count, line = len(after.line), after.line
    # Most segments end where the next one begins: each point is looked for once.
    ends = np.arange(1, count + 1)
    lone = np.append((line[:-1, 2:] != line[1:, :2]).any(axis=1), True)
    ends[lone] = count + np.arange(lone.sum())
    xy = np.concatenate([line[:, :2], line[lone, 2:]])
    foot, moved, source = splat.trace(xy)
    _trace_beyond(splat, before, xy, np.concatenate([after.section[:, 0], after.section[lone, 2]]), foot, moved, source)
    both = np.stack([np.arange(count), ends], axis=1)
    return foot[both].reshape(-1, 4), moved[both], source[both]


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
    line = before.line[nearest]
    way, off = line[:, 2:] - line[:, :2], xy[beyond] - line[:, :2]
    part = np.clip((off * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-30), 0.0, 1.0)
    foot[beyond] = line[:, :2] + part[:, None] * way
    moved[beyond] = np.hypot(*(xy[beyond] - foot[beyond]).T)
    source[beyond] = nearest


def lead_between(
    splat: Splat, before: Segments, after: Segments, events: Sequence[Any], times: tuple[float, float], counted: bool
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
    old = old_courses_of(events)
    motion = traced(splat, before, after, old, times)
    if len(old.line):
        old = dataclasses.replace(old, moved=splat.trace(old.line.reshape(-1, 2))[1].reshape(-1, 2))
    segments, years = motion.segments, times[1] - times[0]
    # No finer than the cells are.
    ratio = (segments.moved / np.maximum(segments.section[:, ::2], splat.cell_size)).max(axis=1)
    fast = ratio > STAGE_WIDTHS
    stages = int(np.clip(np.ceil(ratio[fast].max() / STAGE_WIDTHS), 2, MOST_STAGES)) if fast.any() else 1
    part_of_stage = np.arange(1, stages) / stages
    fast_blocks = np.empty(0, np.int64)
    if fast.any():
        reach = FAST_REACH * segments.section[fast, ::2].max(axis=1)
        lines = (motion.begin[fast], segments.line[fast])
        fast_blocks = np.union1d(*(splat.blocks_near(line, reach) for line in lines))
    # What no cell of those blocks can feel is left out.
    some = fast_blocks
    if len(old.line):
        some = np.union1d(some, splat.blocks_near(old.line, FELT * old.section[:, ::2].max(axis=1)))
    motion = motion.take(
        splat.reaches(segments.line, FELT * segments.section[:, ::2].max(axis=1) + segments.moved.max(axis=1), some)
    )
    parts = np.union1d(part_of_stage, (np.unique(old.time) - times[0]) / years if len(old.line) else [])
    for part in parts.tolist():
        time = times[0] + part * years
        slack = 1e-9 * max(1.0, abs(time))
        ends = np.abs(old.time - time) <= slack
        blocks = fast_blocks if np.isclose(part_of_stage, part, rtol=0.0, atol=1e-9).any() else np.empty(0, np.int64)
        if ends.any():
            reach = FELT * old.section[ends, ::2].max(axis=1)
            blocks = np.union1d(blocks, splat.blocks_near(old.line[ends], reach))
        running, later = motion.at(part, time + slack), old.time > time + slack
        if ends.any():
            until = motion.at(part, time - slack).join(old.take(ends | later))
            splat.advance(splat.frame(until), time, blocks=blocks, counted=counted)
            # The channel jumps; it passes over nothing.
            running = dataclasses.replace(running, moved=np.zeros_like(running.moved))
        splat.advance(splat.frame(running.join(old.take(later))), time, blocks=blocks, counted=counted)
    return segments
