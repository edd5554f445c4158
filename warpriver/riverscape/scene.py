"""Riverscape: courses, bed and water of the rivers on a terrain, to be looked at from any distance."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import FloatArray
from warpriver.device import require_memory, resolve_device
from warpriver.errors import InputError
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.riverscape.beds import Bed, Beds, ground_of
from warpriver.riverscape.labels import label_channels
from warpriver.riverscape.layout import BedParams, Layout, lay_courses
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.rosgen import RiverTypes, classify_rivers, types_of
from warpriver.riverscape.stations import TYPES, Courses
from warpriver.riverscape.templates import FlowParams, uniform_flow
from warpriver.riverscape.trajectories import TrajectoryParams
from warpriver.terrain import Terrain
from warpriver.validate import checked_points, finite_numbers, one_of, positive, whole

__all__ = ["Riverscape"]


# Bytes a station while courses are laid: looks at the ground across it.
STATION_BYTES = 2000


class Riverscape:
    """The rivers on a terrain in detail that it does not show: their courses, their bed and their water.

    Attributes:
        terrain: The ground, unchanged.
        network: The rivers.
        types: Their Rosgen types.
        detail: Least distance between what is told apart along a river, m.
        seed: Seed of all that is drawn at random.
        courses: The courses, station by station.
    """

    @public
    def __init__(
        self,
        terrain: Terrain,
        network: RiverNetwork,
        types: RiverTypes | Sequence[str] | str | None = None,
        *,
        detail: float = 0.5,
        seed: int = 0,
        flow: ArrayLike | None = None,
        width: Literal["type", "network"] = "type",
        planform: Literal["type", "given"] = "type",
        flow_params: FlowParams | None = None,
        trajectory_params: TrajectoryParams | None = None,
        profile_params: ProfileParams | None = None,
        bed_params: BedParams | None = None,
        device: wp.DeviceLike = None,
    ):
        """Lay the courses of all rivers, and bring them to the device.

        Args:
            terrain: The ground.
            network: The rivers, a forest.
            types: From :func:`classify_rivers`, or a word such as "C" for all channels or for each; by default they are
                classified.
            detail: Least distance between stations along the courses, m.
            seed: Seed; the same one makes the same riverscape.
            flow: (C,) discharges in m3/s in place of those by drainage area.
            width: Widths by the "type" and flow, or those of the "network".
            planform: Courses by "type", or the lines as they are "given", as those of a simulation; rivers of types D
                and DA part in threads all the same.
            flow_params: Constants of speed and width.
            trajectory_params: Constants of courses.
            profile_params: Constants of the water surface.
            bed_params: Constants of banks, bars and basins.
            device: Where it is evaluated, by default the terrain's.

        Raises:
            ValueError: Rivers that part or flow in a circle, lie off the ground or run uphill; an unknown type, or a
                braided one on a slope on which rivers do not braid.
            MemoryError: A detail so fine that the courses do not fit.
        """
        self.terrain = terrain if device is None else terrain.to(resolve_device(device))
        self.network = network
        self.detail = positive(detail, "detail", "m")
        self.seed = whole(seed, "seed")
        one_of(width, "width", ("type", "network"))
        one_of(planform, "planform", ("type", "given"))
        if types is None:
            types = classify_rivers(network, terrain, flow=flow)
        index = types_of(types, network.channel_count)
        # A layout needs the flow alone of labels that were made before, and that only if it is the same.
        known = isinstance(types, RiverTypes) and types.labels is not None and flow is None
        labels = types.labels if known and isinstance(types, RiverTypes) else None
        labels = label_channels(network, terrain, flow=flow) if labels is None else labels
        self.kind = index
        self.types = types if isinstance(types, RiverTypes) else None
        layout = Layout(
            self.detail,
            self.seed,
            width,
            planform,
            flow_params or FlowParams(),
            trajectory_params or TrajectoryParams(),
            profile_params or ProfileParams(),
            bed_params or BedParams(),
        )
        self._require_memory(labels.flow)
        ground = ground_of(self.terrain)
        self.courses: Courses = lay_courses(ground, terrain.cell_size, network, index, labels, layout)

    def _require_memory(self, flow: FloatArray) -> None:
        narrow = uniform_flow(flow, 0.02, 8.0).width / 5.0
        count = int((self.network.channel_lengths() / np.maximum(self.detail, narrow)).sum() * 2.0)
        require_memory(
            (count, 1), STATION_BYTES, self.terrain.device, "a riverscape of stations; its detail is too fine:"
        )

    @property
    def device(self) -> wp.Device:
        """Where it is evaluated."""
        return self.terrain.device

    @functools.cached_property
    def beds(self) -> Beds:
        """What evaluates the bed."""
        return Beds(self.terrain, self.courses)

    @public
    def bed(self, xy: ArrayLike) -> Bed:
        """Return the bed at places: height, water, depth, material.

        Args:
            xy: (n, 2) places in m.
        """
        return self.beds.at(checked_points(xy, "xy"))

    @public
    def carved(self, cell_size: float, bounds: Sequence[float] | np.ndarray | None = None) -> Terrain:
        """Return the terrain with the beds carved into it, on cells of any size.

        Args:
            cell_size: m.
            bounds: (west, south, east, north) in m, by default those of the terrain. Cells lie on a grid through its
                north-west corner, so that windows side by side fit together.

        Raises:
            ValueError: Fewer than 2 x 2 cells, or a window without a river in it, where one is given.
            MemoryError: Too many cells.
        """
        size = positive(cell_size, "cell_size", "m")
        west, south, east, north = self.terrain.bounds if bounds is None else finite_numbers(bounds, 4, "bounds")
        rows, columns = (math.floor((b - a) / size + 1e-6) for a, b in ((south, north), (west, east)))
        if rows < 2 or columns < 2:
            raise InputError(
                f"bounds ({west:g}, {south:g}, {east:g}, {north:g}) hold {max(rows, 0)} x {max(columns, 0)} cells of "
                f"{size:g} m; give (west, south, east, north) that hold 2 x 2 or more"
            )
        if bounds is not None:
            self._require_river(west, south, east, north)
        height = self.beds.raster(size, west, north, (rows, columns))
        return Terrain.wrap(height, size, (west, north), self.terrain.crs)

    def _require_river(self, west: float, south: float, east: float, north: float) -> None:
        """Raise ``ValueError`` where no course reaches into a window."""
        x, y = self.courses.xy.T
        reach = 0.5 * self.courses.width + self.courses.reach
        near = (x > west - reach) & (x < east + reach) & (y > south - reach) & (y < north + reach)
        if not near.any():
            places = tuple(round(float(v), 1) for v in (x.min(), y.min(), x.max(), y.max()))
            raise InputError(
                f"bounds ({west:g}, {south:g}, {east:g}, {north:g}) hold no river; the courses lie within {places}"
            )

    def __repr__(self) -> str:
        length = self.courses.length()[self.courses.wet].sum() / 1e3
        names = ", ".join(TYPES[k] for k in np.unique(self.kind))
        wet = int(self.courses.wet.sum())
        return (
            f"Riverscape({self.network.channel_count} channels of types {names}, {wet} courses, "
            f"{length:.4g} km, {len(self.courses.along)} stations, detail {self.detail:g} m on {self.device.alias})"
        )
