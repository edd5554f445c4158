"""Stations of courses that a user gives, with the rocks and logs that lie in them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.riverscape.beds import ground_of
from warpriver.riverscape.courses import Course, Log, Rock
from warpriver.riverscape.layout import BANK_EASE, BedParams, bank_reach, no_falls
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.stations import TYPES, Basins, Falls, Rocks, Stations
from warpriver.riverscape.templates import ACROSS
from warpriver.terrain import Terrain

__all__ = ["given_stations", "mounds_of"]


# Distance between the mounds that a log is made of, in its radii: it is level within a thousandth.
LOG_STEP = 0.25
GRAVITY = 9.81
# Beyond this, in m, two ends of courses are no node.
APART = 1e-6


def given_stations(
    terrain: Terrain, courses: Sequence[Course], bed: BedParams | None = None, profile: ProfileParams | None = None
) -> Stations:
    """Return the stations of courses of one's own; of several the deepest counts, as of threads.

    Args:
        terrain: The ground, up to which their banks rise.
        courses: The courses.
        bed: Constants of banks.
        profile: Constants, of which the freeboard rounds their rim.
    """
    bed, profile = bed or BedParams(), profile or ProfileParams()
    start = np.concatenate([[0], np.cumsum([len(np.asarray(c.xy)) for c in courses])])
    count = len(courses)

    def joined(name: str) -> FloatArray:
        return np.concatenate([np.asarray(getattr(course, name)) for course in courses])

    xy, level, width, depth = (joined(name) for name in ("xy", "level", "width", "depth"))
    tangent, form = joined("direction"), joined("form")
    fill = (form[:, 1:] + form[:, :-1]).mean(axis=1) / 2.0
    along = joined("along")
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.append(-np.diff(level) / np.diff(along), 0.0)
    last = start[1:] - 1
    slope[last] = slope[last - 1]
    ends = np.concatenate([xy[start[:-1]], xy[last]])
    node = np.unique(np.round(ends / APART), axis=0, return_inverse=True)[1].ravel()
    # Each point has a form of its own: of two that follow each other one is in the first row, and one in the second.
    point = np.arange(len(xy))
    ahead = np.minimum(point + 1, np.repeat(last, np.diff(start)))
    odd = (point % 2).astype(bool)
    own = np.column_stack([np.where(odd, ahead, point), np.where(odd, point, ahead)])
    # Half way between the places of a course's table.
    table = np.empty((len(xy), ACROSS))
    table[:, ::2], table[:, 1::2] = form, 0.5 * (form[:, 1:] + form[:, :-1])
    kind = np.array([TYPES.index(course.channel_type) for course in courses])
    bank = joined("bank_level")
    return Stations(
        start=start,
        channel=np.arange(count),
        type=kind,
        thread=np.zeros(count, np.int64),
        wet=np.ones(count, bool),
        group=np.zeros(count, np.int64),
        from_node=node[:count],
        to_node=node[count:],
        xy=xy,
        tangent=tangent,
        along=along,
        water=level,
        slope=np.maximum(slope, 0.0),
        width=width,
        depth=depth,
        flow=joined("discharge"),
        speed=joined("speed"),
        curvature=joined("curvature"),
        lane=np.full(len(xy), 0.5),
        bend=np.zeros(len(xy)),
        form=own,
        blend=odd.astype(np.float64),
        reach=bank_reach(ground_of(terrain), xy, tangent, np.minimum(level, bank), width, width, bed),
        ease=BANK_EASE * width,
        rim=profile.freeboard * fill * depth,
        form_table=table,
        falls=_falls(courses, start),
        basins=Basins(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.int64)),
        rocks=Rocks(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.int64)),
    )


def _falls(courses: Sequence[Course], start: IndexArray) -> Falls:
    """The steps of courses: each is one of their segments."""
    counts = [len(np.asarray(course.falls)) for course in courses]
    course = np.repeat(np.arange(len(courses)), counts)
    if not len(course):
        return no_falls()
    own = np.concatenate([np.asarray(c.falls, np.int64) for c in courses])
    station = start[course] + own
    xy, level, speed, along = (
        np.concatenate([np.asarray(getattr(c, name)) for c in courses]) for name in ("xy", "level", "speed", "along")
    )
    ahead = xy[station + 1] - xy[station]
    length = np.hypot(*ahead.T)
    drop = level[station] - level[station + 1]
    throw = speed[station] * np.sqrt(2.0 * drop / GRAVITY)
    free = (drop > ProfileParams().waterfall) & (length < 1.5 * throw)
    return Falls(
        xy[station],
        ahead / length[:, None],
        level[station],
        drop,
        length,
        speed[station],
        free,
        course,
        along[station],
        station,
        station + 1,
    )


def mounds_of(obstacles: Sequence[Rock | Log]) -> FloatArray:
    """Return rocks and logs as mounds, (n, 4): x, y, radius, elevation of the top; a log is a row of them."""
    rows: list[tuple[float, float, float, float]] = []
    for each in obstacles:
        radius = 0.5 * each.diameter
        if isinstance(each, Rock):
            rows.append((*each.center, radius, each.top))
            continue
        part = np.linspace(0.0, 1.0, 2 + math.ceil(math.dist(each.start, each.end) / (LOG_STEP * radius)))
        middle = np.outer(1.0 - part, each.start) + np.outer(part, each.end)
        rows += [(x, y, radius, each.top) for x, y in middle.tolist()]
    return np.array(rows, np.float64).reshape(-1, 4)
