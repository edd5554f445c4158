"""Courses between two records: where a channel ran while it moved further than it is wide."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from warpriver.extras import IMPORTING
from warpriver.network import RiverNetwork

__all__ = ["STAGES", "courses_between"]

# Stages that the way from one record to the next is cut into at most; a channel moves by at most so many widths from
# one to the next, where they are enough.
STAGES, WIDTHS_A_STAGE = 16, 0.5
# A point is taken for one that moved if the old course is so many widths away, and further points of it follow each
# other within so many points: what jumped is no bend that moved, but a cutoff.
REACH, FOLLOWING = 12.0, 8


def courses_between(
    before: RiverNetwork, after: RiverNetwork
) -> Iterator[tuple[int, list[np.ndarray], list[np.ndarray]]]:
    """Yield the courses through which channels moved between two records, those parts that moved visibly.

    Points move in straight lines, each from the nearest point of its channel's old course.

    Args:
        before: The earlier network.
        after: The later one.

    Yields:
        The stage, 1 to ``STAGES`` - 1, and lines (n, 2) in m with the widths (n,) of their points, m.
    """
    with IMPORTING:
        from scipy.spatial import cKDTree

    old, new = before.points(), after.points()
    old_id = np.repeat(before.channel_id, np.diff(before.starts()))
    new_id = np.repeat(after.channel_id, np.diff(after.starts()))
    width = np.concatenate(after.point_widths())
    distance, nearest = cKDTree(old).query(new, distance_upper_bound=REACH * float(width.max()))
    found = np.isfinite(distance)
    nearest[~found] = 0
    # A channel that a collision made has no old course under its name: it comes from whichever is nearest.
    found &= ((old_id[nearest] == new_id) | ~np.isin(new_id, before.channel_id)) & (distance <= REACH * width)
    moved = found & (distance > WIDTHS_A_STAGE * width)
    if not moved.any():
        return
    step = np.diff(nearest)
    joined = found[1:] & found[:-1] & (new_id[1:] == new_id[:-1]) & (np.abs(step) <= FOLLOWING)
    # The points beside those that moved, so that bands join what is there already.
    kept = moved.copy()
    kept[1:] |= moved[:-1]
    kept[:-1] |= moved[1:]
    joined &= kept[1:] & kept[:-1]
    runs = [run for run in np.split(np.arange(len(new)), np.flatnonzero(~joined) + 1) if len(run) > 1]
    if not runs:
        return
    stages = int(np.clip(np.ceil((distance[moved] / width[moved]).max() / WIDTHS_A_STAGE), 2, STAGES))
    begin, way = old[nearest], new - old[nearest]
    widths = [width[run] for run in runs]
    for k in range(1, stages):
        stage = round(k * STAGES / stages)
        line = begin + stage / STAGES * way
        yield stage, [line[run] for run in runs], widths
