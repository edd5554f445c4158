"""Courses: stems as smooth lines, cut at their junctions into the channels of a network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.channel_table import ChannelTable
from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge, channel_width
from warpriver.hydrology.stems import Stems, settle_areas
from warpriver.terrain import Terrain

__all__ = ["Courses", "NetworkParts", "make_courses", "sample_channels"]


@dataclass(frozen=True)
class Courses:
    """Stems as lines; their points lie end to end.

    A stem has a point for each of its cells and one more at its end: on its parent where it joins one, and at an
    outlet a second one on its last cell.

    Attributes:
        xy: (P, 2) x, y in m.
        height: (P,) height of the surface that water runs on in m; a tributary ends at that of the cell it joins.
        area_below: (P,) drainage area in m2 just downstream of each point.
        area_above: (P,) the same just upstream of it; they differ at junctions.
        head: (S,) first point of each stem.
        tail: (S,) last point of each stem, without the second one at an outlet.
        onto: (S,) point of the parent that a stem ends on; -1 at outlets.
    """

    xy: FloatArray
    height: FloatArray
    area_below: FloatArray
    area_above: FloatArray
    head: IndexArray
    tail: IndexArray
    onto: IndexArray


class NetworkParts(NamedTuple):
    """What a network is made of.

    Attributes:
        point_xy: (P, 2) x, y in m.
        channel_start: (C + 1,) offsets of the channels' points.
        channels: Their table.
        node_xy: (N, 2) x, y in m.
        point_section: (P, 2) width and depth of each point in m, or None.
    """

    point_xy: FloatArray
    channel_start: IndexArray
    channels: ChannelTable
    node_xy: FloatArray
    point_section: FloatArray | None


def make_courses(stems: Stems, junction: IndexArray, terrain: Terrain, passes: int) -> Courses:
    """Make smooth lines of stems.

    Args:
        stems: The stems that are left; their areas are settled.
        junction: (S,) place where each stem meets its parent, -1 at outlets.
        terrain: Where the cells lie.
        passes: Passes of the filter 1/4, 1/2, 1/4.
    """
    total = settle_areas(stems, junction)
    stem = stems.stem
    number = np.arange(len(junction))
    joined = junction >= 0
    # Points of the cells, and those at the stems' ends.
    point, end = np.arange(len(stem)) + stem, stems.start[1:] + number
    onto = np.where(joined, point[junction], -1)
    below, height = np.empty(len(stem) + len(number)), np.empty(len(stem) + len(number))
    below[point], below[end] = stems.area, total
    below *= terrain.cell_size**2
    above = below.copy()
    above[onto[joined]] -= below[end[joined]]
    height[point], height[end] = stems.height, stems.height[np.where(joined, junction, stems.end)]
    xy = np.empty((len(below), 2))
    xy[point] = _centers(stems.place, terrain)
    xy[end] = np.where(joined[:, None], xy[onto], xy[end - 1])
    head, tail = stems.start[:-1] + number, end - ~joined
    _smooth(xy, np.concatenate([head, tail, end]), end[joined], onto[joined], passes)
    return Courses(xy, height, below, above, head, tail, onto)


def _centers(place: IndexArray, terrain: Terrain) -> FloatArray:
    """Centres of cells in m."""
    west, north = terrain.origin
    x = west + (place[:, 1] + 0.5) * terrain.cell_size
    y = north - (place[:, 0] + 0.5) * terrain.cell_size
    return np.column_stack([x, y])


def _smooth(xy: FloatArray, fixed: IndexArray, end: IndexArray, onto: IndexArray, passes: int) -> None:
    """Smooth all stems at once, in place, except for fixed points; those at an end go with the points they lie on."""
    free = np.ones(len(xy), bool)
    free[fixed] = False
    inner = np.flatnonzero(free)
    for _ in range(passes):
        xy[inner] = 0.25 * xy[inner - 1] + 0.5 * xy[inner] + 0.25 * xy[inner + 1]
        xy[end] = xy[onto]


def sample_channels(courses: Courses, spacing: float, coefficient: float, varying: bool) -> NetworkParts:
    """Cut courses at their junctions into channels, and sample these evenly.

    Args:
        courses: The courses.
        spacing: Distance between points in m.
        coefficient: Width over the square root of the drainage area, m per m.
        varying: Whether width and depth vary along a channel.
    """
    first, last, node_point, number = _cut(courses)
    (before, fraction), start = _even_points(courses, first, last, spacing)
    xy = _cubic(courses, before, fraction)
    xy[start[:-1]], xy[start[1:] - 1] = courses.xy[first], courses.xy[last]
    area = (1.0 - fraction) * courses.area_below[before] + fraction * courses.area_above[before + 1]
    width = channel_width(area, coefficient)
    count = np.diff(start)
    mean = np.add.reduceat(width, start[:-1]) / count
    section = np.column_stack([width, bankfull_depth(width)]) if varying else None
    depth = bankfull_depth(mean) if section is None else np.add.reduceat(section[:, 1], start[:-1]) / count
    # Junctions that were moved upstream to make space lie a little above the cell that the tributary ends at.
    drop = np.maximum(courses.height[first] - courses.height[last], 0.0)
    step = np.append(np.hypot(*np.diff(xy, axis=0).T), 0.0)
    step[start[1:] - 1] = 0.0
    drained = courses.area_above[last]
    channels = ChannelTable(
        width=mean,
        depth=depth,
        discharge=bankfull_discharge(channel_width(drained, coefficient)),
        drainage_area=drained,
        slope=drop / np.add.reduceat(step, start[:-1]),
        from_node=number[first],
        to_node=number[last],
    )
    return NetworkParts(xy, start, channels, courses.xy[node_point], section)


def _cut(courses: Courses) -> tuple[IndexArray, IndexArray, IndexArray, IndexArray]:
    """First and last point of each channel, the point of each node, and the node of each point; -1 for none."""
    head, tail, onto = courses.head, courses.tail, courses.onto
    joined = onto >= 0
    # From each head or junction to the next junction or tail.
    first = np.sort(np.concatenate([head, onto[joined]]))
    stem = np.searchsorted(head, first, side="right") - 1
    last = np.append(first[1:], -1)
    lowest = np.append(stem[1:] != stem[:-1], True)
    last[lowest] = tail[stem[lowest]]
    node_point = np.concatenate([first, tail[~joined]])
    number = np.full(len(courses.xy), -1)
    number[node_point] = np.arange(len(node_point))
    number[tail[joined]] = number[onto[joined]]
    return first, last, node_point, number


def _even_points(
    courses: Courses, first: IndexArray, last: IndexArray, spacing: float
) -> tuple[tuple[IndexArray, FloatArray], IndexArray]:
    """Even steps along channels: point before each sample, fraction of the way to the next one; channels' starts."""
    head, tail = courses.head, courses.tail
    step = np.hypot(*np.diff(courses.xy, axis=0).T)
    step[head[1:] - 1] = 0.0
    repeated = tail[:-1] + 1 < head[1:]
    step[tail[:-1][repeated]] = 0.0
    along = np.concatenate([[0.0], np.cumsum(step)])
    length = along[last] - along[first]
    intervals = np.maximum(2, np.rint(length / spacing).astype(np.int64))
    start = np.concatenate([[0], np.cumsum(intervals + 1)])
    channel = np.repeat(np.arange(len(first)), intervals + 1)
    way = (np.arange(start[-1]) - start[channel]) / intervals[channel]
    target = along[first[channel]] + way * length[channel]
    k = np.clip(np.searchsorted(along, target, side="right") - 1, first[channel], last[channel] - 1)
    fraction = np.clip((target - along[k]) / (along[k + 1] - along[k]), 0.0, 1.0)
    fraction[start[:-1]], fraction[start[1:] - 1] = 0.0, 1.0
    return (k, fraction), start


def _cubic(courses: Courses, k: IndexArray, fraction: FloatArray) -> FloatArray:
    """Points on the cubics between the points k and k + 1; tangents are those of parabolas through three points."""
    line, head, tail = courses.xy, courses.head, courses.tail
    step = np.hypot(*np.diff(line, axis=0).T)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        chord = np.diff(line, axis=0) / step
        tangent = np.empty_like(line)
        tangent[1:-1] = (step[1:] * chord[:-1] + step[:-1] * chord[1:]) / (step[:-1] + step[1:])
    tangent[head], tangent[tail] = chord[head], chord[tail - 1]
    t, h = fraction[:, None], step[k]
    a, b, u, v = line[k], line[k + 1], h * tangent[k], h * tangent[k + 1]
    s = 1.0 - t
    value: FloatArray = s * s * (1.0 + 2.0 * t) * a + t * t * (3.0 - 2.0 * t) * b + t * s * (s * u - t * v)
    return value
