"""Rivers laid in a terrain: the stations of their courses by type, and the bed that follows from them."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.device import require_memory
from warpriver.network import RiverNetwork
from warpriver.riverscape.beds import Beds, ground_of
from warpriver.riverscape.before import Before, Profile
from warpriver.riverscape.courses import Course, Log, Rock
from warpriver.riverscape.given import given_stations, mounds_of
from warpriver.riverscape.labels import label_channels
from warpriver.riverscape.layout import Layout, lay_courses
from warpriver.riverscape.rosgen import RiverTypes, classify_rivers, types_of
from warpriver.riverscape.stations import TYPES, Rocks, Stations
from warpriver.riverscape.templates import section_table, uniform_flow
from warpriver.terrain import Terrain
from warpriver.validate import one_of

__all__ = ["Rivers"]

# Bytes a station while courses are laid: looks at the ground across it.
STATION_BYTES = 2000


class Rivers:
    """The rivers of a network with their types, the stations of their courses, and their beds.

    Attributes:
        terrain: The ground, unchanged.
        network: The rivers; None of courses of one's own, or where they were read from a file without it.
        types: Their types, where they were classified; None where words were given.
        kind: (C,) index of each channel's type into ``TYPES``.
        stations: The courses, station by station.
        obstacles: Rocks and logs that a user laid in them.
    """

    def __init__(
        self,
        terrain: Terrain,
        network: RiverNetwork,
        types: RiverTypes | Sequence[str] | str | None,
        layout: Layout,
        *,
        flow: ArrayLike | None = None,
    ):
        """Lay the courses.

        Args:
            terrain: The ground.
            network: The rivers.
            types: Their types.
            layout: Constants of all parts.
            flow: (C,) discharges in place of those by drainage area.
        """
        self.terrain = terrain
        self.network: RiverNetwork | None = network
        one_of(layout.width, "width", ("type", "network"))
        one_of(layout.planform, "planform", ("type", "given"))
        if types is None:
            types = classify_rivers(network, terrain, flow=flow)
        self.kind: IndexArray = types_of(types, network.channel_count)
        self.types = types if isinstance(types, RiverTypes) else None
        # Labels that were made before serve if they are of the same flow.
        labels = None if self.types is None or flow is not None else self.types.labels
        labels = label_channels(network, terrain, flow=flow) if labels is None else labels
        narrow = uniform_flow(labels.flow, 0.02, 8.0).width / 5.0
        count = int((network.channel_lengths() / np.maximum(layout.detail, narrow)).sum() * 2.0)
        what = "a riverscape of stations; its detail is too fine:"
        require_memory((count, 1), STATION_BYTES, terrain.device, what)
        self.layout, self.flow = layout, flow
        self.stations: Stations
        self.profile: Profile | None
        ground = ground_of(terrain)
        self.stations, self.profile = lay_courses(ground, terrain.cell_size, network, self.kind, labels, layout)
        self.obstacles: tuple[Rock | Log, ...] = ()
        self._given: list[Course] | None = None

    @classmethod
    def of_stations(
        cls,
        terrain: Terrain,
        stations: Stations,
        courses: Sequence[Course] | None = None,
        obstacles: Sequence[Rock | Log] = (),
    ) -> Rivers:
        """Return rivers that were laid before, or those of courses of one's own."""
        rivers = cls.__new__(cls)
        rivers.terrain, rivers.stations, rivers.network, rivers.types = terrain, stations, None, None
        rivers.profile = None
        _, first = np.unique(stations.channel, return_index=True)
        rivers.kind = stations.type[first]
        rivers.obstacles = tuple(obstacles)
        rivers._given = None if courses is None else list(courses)
        return rivers

    @classmethod
    def of_courses(cls, terrain: Terrain, courses: Sequence[Course], obstacles: Sequence[Rock | Log] = ()) -> Rivers:
        """Return the rivers of courses of one's own."""
        return cls.of_stations(terrain, given_stations(terrain, courses), courses, obstacles)

    def type_words(self) -> list[str]:
        """Return the type of each channel as a word."""
        if self.types is not None:
            return [str(word) for word in self.types.channel_type]
        return [TYPES[k] for k in self.kind]

    def take_network(
        self, network: RiverNetwork, types: Sequence[str], layout: Layout, profile: Profile, flow: ArrayLike | None
    ) -> None:
        """Take what stations were laid from, so that parts of it can be laid anew."""
        self.network, self.layout, self.profile, self.flow = network, layout, profile, flow
        self.kind = types_of(types, network.channel_count)

    def with_obstacles(self, obstacles: Sequence[Rock | Log], kept: IndexArray | None = None) -> Rivers:
        """Return these rivers with other rocks and logs of a user's, and with some of the rocks of their own.

        Args:
            obstacles: All rocks and logs of a user's.
            kept: Numbers of the rocks of their own that stay; by default all.
        """
        other = copy.copy(self)
        other.__dict__.pop("beds", None)
        other.obstacles = tuple(obstacles)
        if kept is not None:
            rocks = self.stations.rocks
            fewer = Rocks(rocks.xy[kept], rocks.radius[kept], rocks.height[kept], rocks.course[kept])
            other.stations = dataclasses.replace(self.stations, rocks=fewer)
        return other

    def on(self, terrain: Terrain) -> Rivers:
        """Return the same courses on other ground."""
        other = copy.copy(self)
        other.__dict__.pop("beds", None)
        other.terrain = terrain
        return other

    def laid_anew(
        self,
        terrain: Terrain,
        network: RiverNetwork,
        types: RiverTypes | Sequence[str],
        changed: FlagArray,
        free: FlagArray,
        *,
        redrawn: FlagArray,
        leveled: FlagArray,
    ) -> Rivers:
        """Return the rivers with some channels laid anew between the nodes, whose levels stay unless they are free.

        Args:
            terrain: The ground as it is now.
            network: The rivers as they are now: the same channels between the same nodes.
            types: Their types.
            changed: (C,) channels to lay anew.
            free: (N,) nodes whose level may change.
            redrawn: (C,) channels whose lines are other ones.
            leveled: (C,) channels whose water may lie elsewhere than before.
        """
        assert self.profile is not None
        other = copy.copy(self)
        other.__dict__.pop("beds", None)
        other.terrain, other.network = terrain, network
        other.kind = types_of(types, network.channel_count)
        other.types = types if isinstance(types, RiverTypes) else None
        labels = label_channels(network, terrain, flow=self.flow)
        ground = ground_of(terrain)
        before = Before(self.stations, self.profile, changed, redrawn, leveled, free)
        other.stations, other.profile = lay_courses(
            ground, terrain.cell_size, network, other.kind, labels, self.layout, before
        )
        return other

    @functools.cached_property
    def beds(self) -> Beds:
        """What evaluates the bed."""
        return Beds(self.terrain, self.stations, obstacles=mounds_of(self.obstacles))

    def courses(self) -> list[Course]:
        """Return the courses that carry water, as water needs them: a fall is one segment."""
        if self._given is not None:
            return self._given
        stations = self.stations
        made = []
        keep = np.ones(len(stations.along), bool)
        end = stations.falls.end
        for first, last in zip(stations.falls.station.tolist(), end.tolist(), strict=True):
            keep[first + 1 : last] = False
        lip = np.zeros(len(stations.along), bool)
        lip[stations.falls.station] = True
        for k in np.flatnonzero(stations.wet).tolist():
            part = np.arange(stations.start[k], stations.start[k + 1])
            part = part[keep[part]]
            section = (stations.form[part], stations.blend[part], stations.lane[part], stations.bend[part])
            table = section_table(*section, stations.form_table)
            made.append(
                Course(
                    stations.xy[part],
                    stations.water[part],
                    stations.width[part],
                    stations.depth[part],
                    stations.speed[part],
                    TYPES[stations.type[k]],
                    np.clip(table, 0.0, 1.0),
                    np.flatnonzero(lip[part]),
                )
            )
        return made

    def rocks(self, window: tuple[float, float, float, float] | None = None) -> list[Rock]:
        """Return the rocks, as water needs them: those of a user's behind those that follow from types.

        Args:
            window: (west, south, east, north) in m, beyond which the latter are left out.
        """
        rocks = self.stations.rocks
        xy, radius = rocks.xy, rocks.radius
        if window is not None:
            inside = ((xy >= window[:2]) & (xy <= window[2:])).all(axis=1)
            xy, radius = xy[inside], radius[inside]
        top: FloatArray = self.beds.heights(xy)[0]
        own = [
            Rock((float(x), float(y)), float(2.0 * r), float(z))
            for (x, y), r, z in zip(xy, radius, top, strict=True)
            if np.isfinite(z)
        ]
        return own + [each for each in self.obstacles if isinstance(each, Rock)]

    def logs(self) -> list[Log]:
        """Return the logs of a user's."""
        return [each for each in self.obstacles if isinstance(each, Log)]

    def __repr__(self) -> str:
        length = self.stations.length()[self.stations.wet].sum() / 1e3
        names, wet = ", ".join(TYPES[k] for k in np.unique(self.kind)), int(self.stations.wet.sum())
        return (
            f"{len(self.kind)} channels of types {names}, {wet} courses, {length:.4g} km, "
            f"{len(self.stations.along)} stations"
        )
