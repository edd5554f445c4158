"""A river with its bed and its moving water, to be asked at any place and time [Peytavie2019]."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.device import resolve_device
from warpriver.edits.session import Session, session_of
from warpriver.edits.values import Edit
from warpriver.errors import InputError
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.riverscape.beds import Bed
from warpriver.riverscape.courses import Course, CourseMap, Rock, checked_courses
from warpriver.riverscape.drift import LeafFrame, checked_times, drift_leaves
from warpriver.riverscape.layout import BedParams, Layout
from warpriver.riverscape.made import Layer, Made
from warpriver.riverscape.patches import CELLS, Patch, counted, lay_patches
from warpriver.riverscape.primitives import Merge, Primitives, Replace
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.rivers import Rivers
from warpriver.riverscape.rosgen import RiverTypes
from warpriver.riverscape.seeding import SeedingParams
from warpriver.riverscape.stations import Stations
from warpriver.riverscape.templates import FlowParams
from warpriver.riverscape.trajectories import TrajectoryParams
from warpriver.riverscape.water import Water, WaterGrid, WaterSample
from warpriver.terrain import Terrain
from warpriver.validate import checked_points, finite, finite_numbers, positive, real, seeded, whole

__all__ = ["Frame", "Riverscape"]


# Cells of a frame at most.
MOST_CELLS = 2**28


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """A scene on a grid at a time, row 0 in the north, on the device.

    Attributes:
        time: s.
        water: The surface; where it lies below the bed the place is dry.
        bed: (rows, columns) float64, m; the same array in all frames.
    """

    time: float
    water: WaterGrid
    bed: DeviceArray

    @property
    def depth(self) -> FloatArray:
        """(rows, columns) m; 0 where it is dry."""
        found = self.water.elevation.numpy() - self.bed.numpy()
        return np.maximum(np.where(np.isnan(found), 0.0, found), 0.0)


class Riverscape:
    """The rivers on a terrain in detail that it does not show: their courses, their bed and their moving water.

    Args:
        terrain: The ground.
        rivers: The rivers, a forest of channels, whose courses follow from their types; or courses of your own.
        types: From :func:`classify_rivers`, or a word such as "C" for all channels or for each; by default they are
            classified.
        rocks: Boulders in and beside courses of your own.
        detail: Least distance between stations along courses, and spacing of the water's primitives where it runs at
            1 m/s, m.
        seed: Of all that is drawn.
        flow: (C,) discharges in m3/s in place of those by drainage area.
        width: Widths by the "type" and flow, or those of the "network".
        planform: Courses by "type", or the lines as they are "given", as those of a simulation; rivers of types D and
            DA part in threads all the same.
        flow_params: Constants of speed and width.
        trajectory_params: Constants of courses.
        profile_params: Constants of the water surface along them.
        bed_params: Constants of banks, bars and basins.
        params: How primitives of the water are chosen.
        tree: The water as a tree of its own, in place of one that follows from the courses.
        device: Warp device, by default the terrain's.

    Attributes:
        detail: As given.
        seed: As given.

    Raises:
        ValueError: Rivers that part or flow in a circle, lie off the ground or run uphill; an unknown type, or a
            braided one on a slope on which rivers do not braid; no course, or a value out of its range.
        MemoryError: A detail so fine that the courses do not fit.

    Source:
        [Peytavie2019].
    """

    @public
    def __init__(
        self,
        terrain: Terrain,
        rivers: RiverNetwork | Sequence[Course],
        types: RiverTypes | Sequence[str] | str | None = None,
        *,
        rocks: Sequence[Rock] = (),
        detail: float = 0.5,
        seed: int = 0,
        flow: ArrayLike | None = None,
        width: Literal["type", "network"] = "type",
        planform: Literal["type", "given"] = "type",
        flow_params: FlowParams | None = None,
        trajectory_params: TrajectoryParams | None = None,
        profile_params: ProfileParams | None = None,
        bed_params: BedParams | None = None,
        params: SeedingParams | None = None,
        tree: Primitives | Merge | Replace | None = None,
        device: wp.DeviceLike = None,
    ) -> None:
        ground = terrain if device is None else terrain.to(resolve_device(device))
        self.detail, self.seed = positive(detail, "detail", "m"), whole(seed, "seed", maximum=2**31 - 1)
        seeded(seed)
        self.params = SeedingParams() if params is None else params
        self._bed: tuple[tuple[object, ...], DeviceArray] | None = None
        self._done: list[tuple[Edit, Made]] = []
        self._undone: list[Edit] = []
        if isinstance(rivers, RiverNetwork):
            if len(rocks):
                raise InputError("rocks lie in courses of your own; those of a network get theirs by type")
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
            laid = Rivers(ground, rivers, types, layout, flow=flow)
        else:
            if types is not None or flow is not None:
                raise InputError("types and flow are those of a network; a Course has its own")
            given = checked_courses(rivers)
            laid = Rivers.of_courses(ground, given, list(rocks))
        self._made = Made(ground, laid, self.detail, self.seed, self.params, tree)

    @classmethod
    def of_made(cls, made: Made, edits: Sequence[Edit] = ()) -> Riverscape:
        """Return the scene of what was made before; ``edits`` are those that led there, which cannot be undone."""
        scene = cls.__new__(cls)
        scene.detail, scene.seed, scene.params = made.detail, made.seed, made.params
        scene._bed, scene._done, scene._undone, scene._made = None, [], [], made
        scene._before = tuple(edits)
        return scene

    # Edits that were done before the scene was read from a file.
    _before: tuple[Edit, ...] = ()

    @public
    def within(self, bounds: Sequence[float] | FloatArray) -> Riverscape:
        """Return this scene with water in a window alone: there the same, to the bit, at its share of the cost.

        Beyond the window there may be no water, and rocks and leaves have none to lie in. Undone edits are forgotten.

        Args:
            bounds: (west, south, east, north) in m.

        Raises:
            ValueError: Bounds without a river in them.
        """
        west, south, east, north = finite_numbers(bounds, 4, "bounds")
        self._require_river(west, south, east, north)
        made = dataclasses.replace(self._made, window=(west, south, east, north))
        return Riverscape.of_made(made, self.edits)

    @property
    def made(self) -> Made:
        """What it is made of now."""
        return self._made

    @property
    def terrain(self) -> Terrain:
        """The ground that beds are cut into, with the edits of it."""
        return self._made.terrain

    @property
    def rivers(self) -> Rivers:
        """Stations and beds of the courses, with rocks and logs."""
        return self._made.rivers

    @property
    def device(self) -> wp.Device:
        """Where it is evaluated."""
        return self.terrain.device

    @property
    def network(self) -> RiverNetwork | None:
        """The rivers that it was made from; None where courses were given."""
        return self.rivers.network

    @property
    def types(self) -> RiverTypes | None:
        """Their types, where they were classified."""
        return self.rivers.types

    @property
    def stations(self) -> Stations:
        """The courses, station by station."""
        return self.rivers.stations

    @property
    def courses(self) -> CourseMap:
        """The courses, to be asked at any place."""
        return self._made.courses

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The parts of the water that have names, from the bottom up."""
        return self._made.layers

    @property
    def water_surface(self) -> Water:
        """The blend-flow tree of the water."""
        return self._made.surface

    # ---- edits

    @property
    def edits(self) -> tuple[Edit, ...]:
        """All edits that were done, in order; :func:`warpriver.edits.write_edits` keeps them in a file."""
        return (*self._before, *(edit for edit, _ in self._done))

    @public
    def apply(self, edit: Edit) -> None:
        """Do an edit: of the water, of rocks and logs, of a river, or of the ground (``edits.EditTerrain``).

        What it does not name stays as it is, to the bit. A river whose course, type or ground changes is laid anew
        between its nodes, which keep their levels, unless the ground was changed at them.

        Args:
            edit: One of :mod:`warpriver.riverscape` or ``EditTerrain``.

        Raises:
            ValueError: It cannot be done, and nothing has changed.
        """
        made = self._made.with_edit(edit)
        self._done.append((edit, self._made))
        self._undone.clear()
        self._put(made)

    @public
    def undo(self) -> Edit:
        """Take the last edit back, to the bit, and return it.

        Raises:
            ValueError: None was done.
        """
        if not self._done:
            raise InputError("no edit was done to this scene; there is nothing to take back")
        edit, before = self._done.pop()
        self._undone.append(edit)
        self._put(before)
        return edit

    @public
    def redo(self) -> Edit:
        """Do the edit again that was taken back last, and return it.

        Raises:
            ValueError: None was taken back since the last edit.
        """
        if not self._undone:
            raise InputError("no edit was taken back since the last edit; there is nothing to do again")
        edit = self._undone.pop()
        made = self._made.with_edit(edit)
        self._done.append((edit, self._made))
        self._put(made)
        return edit

    def _put(self, made: Made) -> None:
        self._made, self._bed = made, None

    @public
    def replay(self, edits: Session | str | os.PathLike[str] | Sequence[Edit]) -> Riverscape:
        """Return this scene with the edits of a session upon it; the same ones make the same scene, to the bit.

        Args:
            edits: A file that :func:`warpriver.edits.write_edits` wrote, a session, or edits.

        Raises:
            OSError: The file is missing.
            ValueError: It is no session, or an edit of it cannot be done here.
        """
        scene = Riverscape.of_made(self._made, self._before)
        scene._done = list(self._done)
        for number, (_, edit) in enumerate(session_of(edits).edits):
            try:
                scene.apply(edit)
            except InputError as error:
                raise InputError(f"edit {number} ({edit.name}): {error}") from error
        return scene

    @public
    def water(self, xy: ArrayLike, t: float = 0.0) -> WaterSample:
        """Ask for the water at places: elevation, velocity, effervescence, weight; NaN and 0 where there is none.

        Args:
            xy: (n, 2) m.
            t: s.

        Raises:
            ValueError: Places or a time that are not finite.
        """
        return self.water_surface.at(xy, t)

    @public
    def bed(self, xy: ArrayLike, *, rocks: bool = True) -> FloatArray:
        """Ask for the height of the bed, or of the ground beside it, at places.

        Args:
            xy: (n, 2) m.
            rocks: Whether rocks lie on it.

        Raises:
            ValueError: Places that are not finite.
        """
        return self.rivers.beds.heights(checked_points(xy, "xy"), rocks=rocks)[0]

    @public
    def bed_at(self, xy: ArrayLike) -> Bed:
        """Ask for all about the bed: height, what is cut, water, depth and material.

        Args:
            xy: (n, 2) m.

        Raises:
            ValueError: Places that are not finite.
        """
        return self.rivers.beds.at(checked_points(xy, "xy"))

    @public
    def carved(self, cell_size: float, bounds: Sequence[float] | FloatArray | None = None) -> Terrain:
        """Return the ground with the beds in it, as a terrain of any cell size.

        Args:
            cell_size: m.
            bounds: (west, south, east, north) in m; by default those of the terrain.

        Raises:
            ValueError: No such grid, too many cells, or bounds without a river in them.
            MemoryError: Too many cells.
        """
        origin, shape = self._grid(bounds, cell_size)
        if bounds is not None:
            self._require_river(*finite_numbers(bounds, 4, "bounds"))
        return Terrain.wrap(self._bed_grid(origin, cell_size, shape), float(cell_size), origin, self.terrain.crs)

    def _require_river(self, west: float, south: float, east: float, north: float) -> None:
        """Raise ``ValueError`` where no course reaches into a window."""
        stations = self.rivers.stations
        x, y = stations.xy.T
        reach = 0.5 * stations.width + stations.reach
        near = bool(((x > west - reach) & (x < east + reach) & (y > south - reach) & (y < north + reach)).any())
        low_x, low_y, high_x, high_y = (float(v) for v in (x.min(), y.min(), x.max(), y.max()))
        if not near:
            raise InputError(
                f"bounds is ({west:.10g}, {south:.10g}, {east:.10g}, {north:.10g}), which holds no river; the courses "
                f"lie within ({low_x:.1f}, {low_y:.1f}, {high_x:.1f}, {high_y:.1f})"
            )

    @public
    def save(self, path: str | os.PathLike[str]) -> None:
        """Keep the scene in a file: what it is made of as JSON, its arrays beside that as npz.

        Args:
            path: File to write, ``.json``; arrays go into a file of the same name that ends in ``.npz``.

        Raises:
            ValueError: Another suffix.
            OSError: The files cannot be written.
        """
        from warpriver.riverscape.files import write_scene

        write_scene(self, path)

    @public
    def frames(
        self,
        bounds: Sequence[float] | FloatArray | None,
        cell_size: float,
        times: Sequence[float] | FloatArray,
        *,
        loop: float | None = None,
    ) -> Iterator[Frame]:
        """Go through the scene on a grid, time by time.

        Args:
            bounds: (west, south, east, north) in m; None: those of the terrain.
            cell_size: m.
            times: s.
            loop: Period in s after which the water repeats itself without a seam; by default it never does.

        Raises:
            ValueError: No such grid, too many cells, or times that are not finite.
        """
        origin, shape = self._grid(bounds, cell_size)
        moments = checked_times(times)
        period = None if loop is None else positive(loop, "loop", "s")
        return self._frames(origin, cell_size, shape, moments, period)

    def _frames(
        self,
        origin: tuple[float, float],
        cell_size: float,
        shape: tuple[int, int],
        moments: list[float],
        period: float | None,
    ) -> Iterator[Frame]:
        bed = self._bed_grid(origin, cell_size, shape)
        for moment in moments:
            if period is None:
                grid = self.water_surface.on_grid(origin, cell_size, shape, moment)
            else:
                grid = self.water_surface.loop_grid(origin, cell_size, shape, moment, period)
            yield Frame(moment, grid, bed)

    @public
    def drift(self, times: Sequence[float] | FloatArray, *, leaves: int = 200) -> Iterator[LeafFrame]:
        """Let leaves drift on the water; where they begin follows from the seed.

        Args:
            times: s, not falling.
            leaves: How many.

        Raises:
            ValueError: Times that fall or are not finite, or no water that could carry a leaf.
        """
        count = whole(leaves, "leaves", 1)
        return drift_leaves(self.water_surface, self.bed, times, count, self.seed)

    @public
    def to_glb(
        self,
        path: str | os.PathLike[str],
        *,
        bounds: Sequence[float] | FloatArray | None = None,
        cell_size: float | None = None,
        time: float = 0.0,
    ) -> None:
        """Write ground, water and falls as a mesh, binary glTF 2.0.

        The water has the distance along its course and to the left of it, in m, as texture coordinates, and the
        attributes ``_FLOW`` (velocity in m/s in the axes of glTF: x east, y up, z south) and ``_FOAM``.

        Args:
            path: File to write, ``.glb``.
            bounds: (west, south, east, north) in m; by default those of the terrain.
            cell_size: Of ground and water, m; by default half the detail.
            time: s.

        Raises:
            ValueError: Another suffix, no such grid, too many cells, or bounds off the ground.
            OSError: The file cannot be written.
        """
        from warpriver.riverscape.meshes import write_glb

        size = 0.5 * self.detail if cell_size is None else cell_size
        write_glb(self, path, bounds=bounds, cell_size=size, time=real(time))

    @public
    def patches(
        self,
        eye: Sequence[float] | FloatArray,
        *,
        bounds: Sequence[float] | FloatArray | None = None,
        cell_size: float = 0.25,
        angle: float = 0.003,
        time: float = 0.0,
        heading: float | None = None,
        field: float = 60.0,
    ) -> list[Patch]:
        """Lay ground and water in patches of 10 x 10 cells for a view, fine where they are near, without cracks.

        The mesh of a patch has steps of 1, 2, 5 or 10 cells. Along their edge two patches lie on the same lines.

        Args:
            eye: (x, y, z) of the eye, m.
            bounds: (west, south, east, north) in m, grown to whole patches; by default those of the terrain.
            cell_size: m.
            angle: Under which a step may be seen at most, rad; cells are never divided.
            time: s.
            heading: Direction of view, degrees from east to north; patches out of view are left out. By default all
                are laid.
            field: Angle of view, degrees.

        Raises:
            ValueError: No such grid, too many cells, or a value out of its range.

        Source:
            [Peytavie2019], Sec. 7.1.
        """
        x, y, z = finite_numbers(eye, 3, "eye")
        (west, north), (rows, _) = self._grid(bounds, cell_size)
        south = north - rows * cell_size if bounds is None else float(bounds[1])
        east = self.terrain.raster.bounds[2] if bounds is None else float(bounds[2])
        shape = counted((west, south, east, north), cell_size)
        if shape[0] * shape[1] * CELLS**2 > MOST_CELLS:
            raise InputError(f"{shape[0]} x {shape[1]} patches are too many; use a coarser cell size or a part of it")
        return lay_patches(
            self,
            (x, y, z),
            origin=(west, south),
            shape=shape,
            cell_size=positive(cell_size, "cell_size", "m"),
            angle=positive(angle, "angle", "rad"),
            time=real(time),
            heading=None if heading is None else math.radians(finite(heading, "heading", "degrees")),
            field=math.radians(positive(field, "field", "degrees")),
        )

    def _grid(
        self, bounds: Sequence[float] | FloatArray | None, cell_size: float
    ) -> tuple[tuple[float, float], tuple[int, int]]:
        """West and north edge, rows and columns of a grid."""
        size = positive(cell_size, "cell_size", "m")
        west, south, east, north = finite_numbers(self.terrain.raster.bounds if bounds is None else bounds, 4, "bounds")
        rows, columns = math.ceil((north - south) / size - 1e-9), math.ceil((east - west) / size - 1e-9)
        if not (west < east and south < north) or min(rows, columns) < 2:
            raise InputError(
                f"bounds ({west:g}, {south:g}, {east:g}, {north:g}) hold fewer than 2 x 2 cells of {size:g} m; give "
                "(west, south, east, north) in m"
            )
        if rows * columns > MOST_CELLS:
            raise InputError(
                f"{rows} x {columns} cells are too many, {MOST_CELLS} at most; use a coarser cell size or a part of it"
            )
        return (west, north), (rows, columns)

    def _bed_grid(self, origin: tuple[float, float], cell_size: float, shape: tuple[int, int]) -> DeviceArray:
        """The bed at the centres of a grid, kept for the next call."""
        key = (*origin, cell_size, shape)
        if self._bed is None or self._bed[0] != key:
            bed: DeviceArray = self.rivers.beds.raster(cell_size, *origin, shape)
            self._bed = (key, bed)
        return self._bed[1]

    def __repr__(self) -> str:
        if self.network is not None:
            return f"Riverscape({self.rivers!r}, detail {self.detail:g} m on {self.device.alias})"
        kinds = ", ".join(sorted({course.channel_type for course in self.courses.courses}))
        length = sum(course.length for course in self.courses.courses)
        return (
            f"Riverscape({len(self.courses.courses)} courses of type {kinds}, {length:.4g} m, "
            f"{len(self.courses.rocks)} rocks, {self.water_surface.primitives!r}, on {self.courses.device.alias})"
        )
