"""Stations of courses that a user gives, with the rocks and logs that lie in them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.kernels import courses as kernels
from warpriver.riverscape.beds import Beds, ground_of
from warpriver.riverscape.courses import Course, Log, Rock
from warpriver.riverscape.layout import BANK_EASE, BedParams, bank_reach, no_falls
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.stations import TYPES, Basins, Falls, Rocks, Stations
from warpriver.riverscape.templates import ACROSS
from warpriver.terrain import Terrain

__all__ = ["given_stations", "with_obstacles"]


# Distance between the mounds that a log is made of, in its radii: it is level within a hundredth.
LOG_STEP = 0.5
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
    table = np.stack([np.interp(np.linspace(0.0, 1.0, ACROSS), np.linspace(0.0, 1.0, kernels.ACROSS), f) for f in form])
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


def with_obstacles(terrain: Terrain, stations: Stations, rocks: Sequence[Rock], logs: Sequence[Log]) -> Stations:
    """Return stations with rocks and logs on their bed; a log is a row of mounds.

    Args:
        terrain: The ground.
        stations: The stations.
        rocks: Boulders.
        logs: Trunks.
    """
    rows = [(*rock.center, 0.5 * rock.diameter, rock.top) for rock in rocks]
    for log in logs:
        radius = 0.5 * log.diameter
        long = math.dist(log.start, log.end)
        part = np.linspace(0.0, 1.0, 2 + math.ceil(long / (LOG_STEP * radius)))
        middle = np.outer(1.0 - part, log.start) + np.outer(part, log.end)
        rows += [(x, y, radius, log.top) for x, y in middle.tolist()]
    if not rows:
        return stations
    place = np.array(rows, np.float64)
    bed = Beds(terrain, stations).heights(place[:, :2], rocks=False)[0]
    height = place[:, 3] - bed
    kept = np.flatnonzero(height > 0.0)
    old = stations.rocks
    nearest: IndexArray = stations.station_course[_nearest(stations.xy, place[kept, :2])]
    added = Rocks(
        np.concatenate([old.xy, place[kept, :2]]),
        np.concatenate([old.radius, place[kept, 2]]),
        np.concatenate([old.height, height[kept]]),
        np.concatenate([old.course, nearest]),
    )
    return dataclasses.replace(stations, rocks=added)


def _nearest(xy: FloatArray, place: FloatArray) -> IndexArray:
    from warpriver.extras import IMPORTING

    with IMPORTING:
        from scipy.spatial import cKDTree
    return np.asarray(cKDTree(xy).query(place)[1], np.int64).reshape(-1)
