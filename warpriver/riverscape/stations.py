"""Stations: the threads of water of a riverscape, station by station, with what lies in them.

This is what trajectories, profiles and sections make together, and what the bed and the water are made from.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.riverscape.courses import TYPES

__all__ = ["TYPES", "Basins", "Falls", "Rocks", "Stations"]


# What of a station the section of the next channel changes.
SECTIONS = ("width", "depth", "speed", "lane", "bend", "form", "blend", "reach", "ease", "rim")


@dataclasses.dataclass(frozen=True)
class Falls:
    """Steps of the water surface, from upstream to downstream in each course.

    Attributes:
        xy: (n, 2) place of the lip in m.
        direction: (n, 2) unit vector downstream.
        level: (n,) water above the lip, m.
        drop: (n,) height of the step, m.
        length: (n,) horizontal length over which the water falls, m.
        speed: (n,) mean speed of the water at the lip, m/s.
        free: (n,) bool: a waterfall, whose nappe leaves the bed; else a cascade over it.
        course: (n,) course that it belongs to.
        along: (n,) distance along that course, m.
        station: (n,) station at the lip.
        end: (n,) station at the foot.
    """

    xy: FloatArray
    direction: FloatArray
    level: FloatArray
    drop: FloatArray
    length: FloatArray
    speed: FloatArray
    free: NDArray[np.bool_]
    course: IndexArray
    along: FloatArray
    station: IndexArray
    end: IndexArray

    def __len__(self) -> int:
        return len(self.xy)


@dataclasses.dataclass(frozen=True)
class Basins:
    """Hollows of the bed: discs that are ``depth`` deeper than the section at the centre, and fade with (1 - r2)^3.

    Attributes:
        xy: (n, 2) centre in m.
        radius: (n,) m.
        depth: (n,) m.
        course: (n,) course that it belongs to.
    """

    xy: FloatArray
    radius: FloatArray
    depth: FloatArray
    course: IndexArray

    def __len__(self) -> int:
        return len(self.xy)


@dataclasses.dataclass(frozen=True)
class Rocks:
    """Rocks on the bed: mounds of round plan.

    Attributes:
        xy: (n, 2) centre in m.
        radius: (n,) m.
        height: (n,) m over the bed around it; it never stands above the ground that was there before.
        course: (n,) course that it belongs to.
    """

    xy: FloatArray
    radius: FloatArray
    height: FloatArray
    course: IndexArray

    def __len__(self) -> int:
        return len(self.xy)


@dataclasses.dataclass(frozen=True)
class Stations:
    """All courses of a riverscape; their stations lie end to end, and run downstream.

    Between two stations everything is linear. With f_i = (p - xy[i]) . tangent[i], a place p lies between the stations
    i and i + 1 of a course where f_i >= 0 > f_(i + 1); the part of the way is f_i / (f_i - f_(i + 1)).

    Attributes:
        start: (K + 1,) offsets of the courses' stations.
        channel: (K,) channel of the network that a course belongs to.
        type: (K,) index into ``TYPES``.
        thread: (K,) number of the course among those of its channel.
        wet: (K,) bool: False for the plain between braided threads, which is shaped as a course but carries no water.
        group: (K,) courses of one group follow each other as one river (a main stem): the deepest counts where they
            overlap. Others are blended.
        from_node: (K,) node of the network at the upstream end.
        to_node: (K,) node at the downstream end.
        xy: (P, 2) stations in m, absolute.
        tangent: (P, 2) unit vector downstream.
        along: (P,) distance along the course, m.
        water: (P,) mean water surface, m; it never rises downstream.
        slope: (P,) slope of the water surface there, m/m, 0 or more.
        width: (P,) width of the water surface, m.
        depth: (P,) greatest depth below the water surface, m.
        flow: (P,) discharge, m3/s.
        speed: (P,) mean speed over the section, m/s: flow over its area.
        curvature: (P,) 1/m, positive where it turns left.
        lane: (P,) part of the width, from the left bank, at which the section is deepest.
        bend: (P,) 0 to 1: how much the section is that of a bend.
        form: (P, 2) two forms of section, rows of ``form_table``; ``blend`` (P,) is the weight of the second.
        blend: See ``form``.
        reach: (P,) distance from the water's edge at which the banks have come up to the ground, m.
        ease: (P,) distance from the water's edge over which the banks become steep, m.
        rim: (P,) height over which the upper edge of the banks is rounded, m.
        form_table: (F, 65) depth over its scale across the forms of sections, from the left bank to the right one.
        falls: Steps of the water surface.
        basins: Hollows.
        rocks: Rocks.
    """

    start: IndexArray
    channel: IndexArray
    type: IndexArray
    thread: IndexArray
    wet: NDArray[np.bool_]
    group: IndexArray
    from_node: IndexArray
    to_node: IndexArray
    xy: FloatArray
    tangent: FloatArray
    along: FloatArray
    water: FloatArray
    slope: FloatArray
    width: FloatArray
    depth: FloatArray
    flow: FloatArray
    speed: FloatArray
    curvature: FloatArray
    lane: FloatArray
    bend: FloatArray
    form: IndexArray
    blend: FloatArray
    reach: FloatArray
    ease: FloatArray
    rim: FloatArray
    form_table: FloatArray
    falls: Falls
    basins: Basins
    rocks: Rocks

    @property
    def count(self) -> int:
        """Number of courses."""
        return len(self.channel)

    @property
    def station_course(self) -> IndexArray:
        """(P,) course of each station."""
        return np.repeat(np.arange(self.count), np.diff(self.start))

    def to_arrays(self) -> dict[str, Any]:
        """Return all arrays by name, those of falls, basins and rocks as "falls.xy" and so on."""
        found: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if dataclasses.is_dataclass(value):
                found |= {f"{field.name}.{f.name}": getattr(value, f.name) for f in dataclasses.fields(value)}
            else:
                found[field.name] = value
        return found

    @staticmethod
    def from_arrays(arrays: Mapping[str, Any]) -> Stations:
        """Return what :meth:`to_arrays` was called of."""
        parts: dict[str, Any] = {
            name: kind(**{f.name: arrays[f"{name}.{f.name}"] for f in dataclasses.fields(kind)})
            for name, kind in (("falls", Falls), ("basins", Basins), ("rocks", Rocks))
        }
        plain = {f.name: arrays[f.name] for f in dataclasses.fields(Stations) if f.name not in parts}
        return Stations(**plain, **parts)

    def length(self) -> FloatArray:
        """Return the length of each course, (K,) m."""
        return self.along[self.start[1:] - 1]

    def with_channels_of(self, other: Stations, changed: FlagArray) -> Stations:
        """Return these stations, with the courses of some channels those of others, in the order of the channels.

        Args:
            other: Stations of the same channels.
            changed: (C,) channels whose courses are those of ``other``.
        """
        picked = [np.flatnonzero(~changed[self.channel]), np.flatnonzero(changed[other.channel])]
        which = np.repeat([0, 1], [len(p) for p in picked])
        course = np.concatenate(picked)
        channel = np.concatenate([s.channel[p] for s, p in zip((self, other), picked, strict=True)])
        order = np.lexsort((course, channel))
        which, course = which[order], course[order]
        # Courses of both, one after the other, and where they begin among the stations of both.
        number = course + which * self.count
        begin = np.concatenate([self.start[:-1], other.start[:-1] + self.start[-1]])[number]
        size = np.concatenate([np.diff(self.start), np.diff(other.start)])[number]
        start = np.concatenate([[0], np.cumsum(size)])
        row = np.repeat(begin - start[:-1], size) + np.arange(start[-1])
        renamed = np.full(self.count + other.count, -1)
        renamed[number] = np.arange(len(number))
        moved = np.zeros(self.count + other.count, np.int64)
        moved[number] = start[:-1] - begin

        def joined(name: str) -> Any:
            return np.concatenate([getattr(self, name), getattr(other, name)])

        def marks(kind: Any, name: str) -> Any:
            pair = getattr(self, name), getattr(other, name)
            own = np.concatenate([pair[0].course, pair[1].course + self.count])
            kept = np.flatnonzero(renamed[own] >= 0)
            kept = kept[np.argsort(renamed[own[kept]], kind="stable")]
            values = {
                f.name: np.concatenate([getattr(p, f.name) for p in pair])[kept] for f in dataclasses.fields(kind)
            }
            values["course"] = renamed[own[kept]]
            if kind is Falls:
                first = np.repeat([0, self.start[-1]], [len(p) for p in pair])[kept]
                for end in ("station", "end"):
                    values[end] = values[end] + first + moved[own[kept]]
            return kind(**values)

        of_course = ("channel", "type", "thread", "wet", "group", "from_node", "to_node")
        whole: dict[str, Any] = {"start": start, "form_table": self.form_table}
        whole |= {name: marks(kind, name) for name, kind in (("falls", Falls), ("basins", Basins), ("rocks", Rocks))}
        whole |= {name: joined(name)[number] for name in of_course}
        rest = [f.name for f in dataclasses.fields(Stations) if f.name not in whole]
        return Stations(**whole, **{name: joined(name)[row] for name in rest})

    def with_tail_of(self, other: Stations, channel: int, widths: float) -> Stations:
        """Return these stations with the sections of others near the lower end of a channel, whose line is the same.

        Args:
            other: Stations of the same channels.
            channel: The channel.
            widths: How far up they count, in widths.
        """
        pairs = list(
            zip(np.flatnonzero(self.channel == channel), np.flatnonzero(other.channel == channel), strict=True)
        )
        size, new_size = np.diff(self.start), np.diff(other.start)
        if any(size[k] != new_size[m] for k, m in pairs):
            one = np.arange(int(self.channel.max()) + 1) == channel
            return self.with_channels_of(other, one)
        columns = {name: getattr(self, name).copy() for name in SECTIONS}
        for k, m in pairs:
            last, end = int(self.start[k + 1]), int(other.start[m + 1])
            left = self.along[last - 1] - self.along[self.start[k] : last]
            wide = np.maximum(self.width[self.start[k] : last], other.width[other.start[m] : end])
            count = int((left < widths * wide).sum())
            for name, values in columns.items():
                values[last - count : last] = getattr(other, name)[end - count : end]
        return dataclasses.replace(self, **columns)
