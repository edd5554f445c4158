"""Rivers laid in a terrain: the stations of their courses by type, and the bed that follows from them."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from warpriver.arrays import FloatArray, IndexArray
from warpriver.device import require_memory
from warpriver.network import RiverNetwork
from warpriver.riverscape.beds import Beds, ground_of
from warpriver.riverscape.courses import Course, Rock
from warpriver.riverscape.labels import label_channels
from warpriver.riverscape.layout import BedParams, Layout, lay_courses
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.rosgen import RiverTypes, classify_rivers, types_of
from warpriver.riverscape.stations import TYPES, Stations
from warpriver.riverscape.templates import FlowParams, section_table, uniform_flow
from warpriver.riverscape.trajectories import TrajectoryParams
from warpriver.terrain import Terrain
from warpriver.validate import one_of

__all__ = ["Rivers"]

# Bytes a station while courses are laid: looks at the ground across it.
STATION_BYTES = 2000


class Rivers:
    """The rivers of a network with their types, the stations of their courses, and their beds.

    Attributes:
        terrain: The ground, unchanged.
        network: The rivers; None where they were read from a file.
        types: Their types, where they were classified; None where words were given.
        kind: (C,) index of each channel's type into ``TYPES``.
        stations: The courses, station by station.
    """

    def __init__(
        self,
        terrain: Terrain,
        network: RiverNetwork,
        types: RiverTypes | Sequence[str] | str | None,
        *,
        detail: float,
        seed: int,
        flow: ArrayLike | None,
        width: Literal["type", "network"],
        planform: Literal["type", "given"],
        flow_params: FlowParams | None,
        trajectory_params: TrajectoryParams | None,
        profile_params: ProfileParams | None,
        bed_params: BedParams | None,
    ):
        """Lay the courses; the arguments are those of :class:`warpriver.riverscape.Riverscape`."""
        self.terrain = terrain
        self.network: RiverNetwork | None = network
        one_of(width, "width", ("type", "network"))
        one_of(planform, "planform", ("type", "given"))
        if types is None:
            types = classify_rivers(network, terrain, flow=flow)
        self.kind: IndexArray = types_of(types, network.channel_count)
        self.types = types if isinstance(types, RiverTypes) else None
        # Labels that were made before serve if they are of the same flow.
        labels = None if self.types is None or flow is not None else self.types.labels
        labels = label_channels(network, terrain, flow=flow) if labels is None else labels
        layout = Layout(
            detail,
            seed,
            width,
            planform,
            flow_params or FlowParams(),
            trajectory_params or TrajectoryParams(),
            profile_params or ProfileParams(),
            bed_params or BedParams(),
        )
        narrow = uniform_flow(labels.flow, 0.02, 8.0).width / 5.0
        count = int((network.channel_lengths() / np.maximum(detail, narrow)).sum() * 2.0)
        what = "a riverscape of stations; its detail is too fine:"
        require_memory((count, 1), STATION_BYTES, terrain.device, what)
        self.stations: Stations = lay_courses(ground_of(terrain), terrain.cell_size, network, self.kind, labels, layout)

    @classmethod
    def of_stations(cls, terrain: Terrain, stations: Stations) -> Rivers:
        """Return rivers that were laid before."""
        rivers = cls.__new__(cls)
        rivers.terrain, rivers.stations, rivers.network, rivers.types = terrain, stations, None, None
        _, first = np.unique(stations.channel, return_index=True)
        rivers.kind = stations.type[first]
        return rivers

    @functools.cached_property
    def beds(self) -> Beds:
        """What evaluates the bed."""
        return Beds(self.terrain, self.stations)

    def courses(self) -> list[Course]:
        """Return the courses that carry water, as water needs them: a fall is one segment."""
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
            table = section_table(stations.form[part], stations.blend[part], stations.lane[part], stations.bend[part])
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

    def rocks(self) -> list[Rock]:
        """Return the rocks, as water needs them."""
        rocks = self.stations.rocks
        top: FloatArray = self.beds.heights(rocks.xy)[0]
        return [
            Rock((float(x), float(y)), float(2.0 * r), float(z))
            for (x, y), r, z in zip(rocks.xy, rocks.radius, top, strict=True)
            if np.isfinite(z)
        ]

    def __repr__(self) -> str:
        length = self.stations.length()[self.stations.wet].sum() / 1e3
        names, wet = ", ".join(TYPES[k] for k in np.unique(self.kind)), int(self.stations.wet.sum())
        return (
            f"{len(self.kind)} channels of types {names}, {wet} courses, {length:.4g} km, "
            f"{len(self.stations.along)} stations"
        )
