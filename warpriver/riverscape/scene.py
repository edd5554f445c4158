"""A river with its bed and its moving water, to be asked at any place and time [Peytavie2019]."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import os
import pathlib
from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.device import resolve_device
from warpriver.errors import InputError, PathError
from warpriver.files import beside
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.riverscape.beds import Bed, Beds
from warpriver.riverscape.courses import Course, CourseMap, Rock
from warpriver.riverscape.drift import LeafFrame, checked_times, drift_leaves
from warpriver.riverscape.layout import BedParams
from warpriver.riverscape.primitives import Merge, Node, Primitives, Replace
from warpriver.riverscape.profiles import ProfileParams
from warpriver.riverscape.rivers import Rivers
from warpriver.riverscape.rosgen import RiverTypes
from warpriver.riverscape.seeding import SeedingParams, seed_water
from warpriver.riverscape.stations import Stations
from warpriver.riverscape.templates import FlowParams
from warpriver.riverscape.trajectories import TrajectoryParams
from warpriver.riverscape.water import Water, WaterGrid, WaterSample
from warpriver.terrain import Terrain
from warpriver.validate import checked_points, finite_numbers, positive, seeded, whole

__all__ = ["Frame", "Riverscape", "read_riverscape"]


# Cells of a frame at most.
MOST_CELLS = 2**28
# Of the file that a scene is kept in.
FORMAT = 1
COURSE_ARRAYS = ("xy", "level", "width", "depth", "speed", "form", "falls")


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
        terrain: The ground, unchanged.
        rivers: What was laid from a network; None where courses were given.
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
        self.terrain = terrain if device is None else terrain.to(resolve_device(device))
        self.detail, self.seed = positive(detail, "detail", "m"), whole(seed, "seed", maximum=2**31 - 1)
        seeded(seed)
        self.params = SeedingParams() if params is None else params
        self.rivers: Rivers | None = None
        self._given = (list(rivers), list(rocks)) if not isinstance(rivers, RiverNetwork) else ([], [])
        self._tree: Node | None = tree
        self._bed: tuple[tuple[object, ...], DeviceArray] | None = None
        if isinstance(rivers, RiverNetwork):
            if len(rocks):
                raise InputError("rocks lie in courses of your own; those of a network get theirs by type")
            self.rivers = Rivers(
                self.terrain,
                rivers,
                types,
                detail=self.detail,
                seed=self.seed,
                flow=flow,
                width=width,
                planform=planform,
                flow_params=flow_params,
                trajectory_params=trajectory_params,
                profile_params=profile_params,
                bed_params=bed_params,
            )
        else:
            if types is not None or flow is not None:
                raise InputError("types and flow are those of a network; a Course has its own")
            self.courses  # noqa: B018  # what is wrong with them is told here

    @property
    def device(self) -> wp.Device:
        """Where it is evaluated."""
        return self.terrain.device

    @property
    def network(self) -> RiverNetwork | None:
        """The rivers that it was made from; None where courses were given."""
        return None if self.rivers is None else self.rivers.network

    @property
    def types(self) -> RiverTypes | None:
        """Their types, where they were classified."""
        return None if self.rivers is None else self.rivers.types

    @property
    def stations(self) -> Stations:
        """The courses of a network, station by station."""
        if self.rivers is None:
            raise InputError("this riverscape was made from courses of your own: see .courses")
        return self.rivers.stations

    @functools.cached_property
    def courses(self) -> CourseMap:
        """The courses, to be asked at any place."""
        courses, rocks = self._given if self.rivers is None else (self.rivers.courses(), self.rivers.rocks())
        return CourseMap(courses, rocks=rocks, device=self.device)

    @functools.cached_property
    def water_surface(self) -> Water:
        """The blend-flow tree of the water."""
        made = seed_water(self.courses, self.detail, self.seed, self.params) if self._tree is None else self._tree
        return Water(made, device=self.device)

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
        if self.rivers is None:
            return self.courses.bed(xy, self.terrain, rocks=rocks)
        return self.rivers.beds.heights(checked_points(xy, "xy"), rocks=rocks)[0]

    @public
    def bed_at(self, xy: ArrayLike) -> Bed:
        """Ask for all about the bed of rivers of a network: height, what is cut, water, depth and material.

        Args:
            xy: (n, 2) m.

        Raises:
            ValueError: Places that are not finite, or a riverscape that was made from courses of your own.
        """
        return self._beds().at(checked_points(xy, "xy"))

    def _beds(self) -> Beds:
        if self.rivers is None:
            raise InputError("the bed's material and water follow from types; make the riverscape from a network")
        return self.rivers.beds

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
        if self.rivers is None:
            low_x, low_y, high_x, high_y = self.courses.bounds
            near = low_x < east and high_x > west and low_y < north and high_y > south
        else:
            stations = self.rivers.stations
            x, y = stations.xy.T
            reach = 0.5 * stations.width + stations.reach
            near = bool(((x > west - reach) & (x < east + reach) & (y > south - reach) & (y < north + reach)).any())
            low_x, low_y, high_x, high_y = (float(v) for v in (x.min(), y.min(), x.max(), y.max()))
        if not near:
            raise InputError(
                f"bounds ({west:g}, {south:g}, {east:g}, {north:g}) hold no river; the courses lie within "
                f"({low_x:.1f}, {low_y:.1f}, {high_x:.1f}, {high_y:.1f})"
            )

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
    def save(self, path: str | os.PathLike[str]) -> None:
        """Keep the scene in a file: what it is made of as JSON, its arrays beside that as npz.

        Args:
            path: File to write, ``.json``; arrays go into a file of the same name that ends in ``.npz``.

        Raises:
            ValueError: Another suffix.
            OSError: The files cannot be written.
        """
        target = pathlib.Path(path)
        arrays: dict[str, NDArray[Any]] = {}
        raster = self.terrain.raster
        arrays["terrain"] = raster.values.numpy()
        courses = []
        for k, course in enumerate(self.courses.courses):
            for name in COURSE_ARRAYS:
                arrays[f"course{k}_{name}"] = np.asarray(getattr(course, name))
            courses.append({"type": course.channel_type})
        told = {
            "format": FORMAT,
            "kind": "riverscape",
            "detail": self.detail,
            "seed": self.seed,
            "params": dataclasses.asdict(self.params),
            "terrain": {"cell_size": raster.cell_size, "origin": list(raster.origin), "crs": raster.crs},
            "courses": courses,
            "rocks": [
                {"center": [float(v) for v in r.center], "diameter": float(r.diameter), "top": float(r.top)}
                for r in self.courses.rocks
            ],
            "tree": _listed(self.water_surface.tree, arrays),
            "laid": self.rivers is not None,
        }
        if self.rivers is not None:
            arrays |= {f"laid.{name}": values for name, values in self.rivers.stations.to_arrays().items()}
        if target.suffix.lower() != ".json":
            raise InputError(
                f"{target} ends in {target.suffix or 'nothing'}; a scene is a .json, with a .npz beside it"
            )
        with beside(target, (".npz",)) as temporary:
            temporary.write_text(json.dumps(told, indent=1) + "\n")
            np.savez_compressed(temporary.with_suffix(".npz"), **arrays)  # type: ignore[arg-type]

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
            if self.rivers is not None:
                bed: DeviceArray = self.rivers.beds.raster(cell_size, *origin, shape)
            else:
                x = origin[0] + cell_size * (np.arange(shape[1]) + 0.5)
                y = origin[1] - cell_size * (np.arange(shape[0]) + 0.5)
                at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
                bed = wp.array(self.bed(at).reshape(shape), dtype=wp.float64, device=self.device)
            self._bed = (key, bed)
        return self._bed[1]

    def __repr__(self) -> str:
        if self.rivers is not None:
            return f"Riverscape({self.rivers!r}, detail {self.detail:g} m on {self.device.alias})"
        kinds = ", ".join(sorted({course.channel_type for course in self.courses.courses}))
        length = sum(course.length for course in self.courses.courses)
        return (
            f"Riverscape({len(self.courses.courses)} courses of type {kinds}, {length:.4g} m, "
            f"{len(self.courses.rocks)} rocks, {self.water_surface.primitives!r}, on {self.courses.device.alias})"
        )


def _listed(node: Node, arrays: dict[str, NDArray[Any]]) -> dict[str, object]:
    """A tree as what JSON holds; its arrays go into the other file."""
    if isinstance(node, Primitives):
        name = f"primitives{sum(key.endswith('_radius') for key in arrays)}"
        for field in dataclasses.fields(Primitives):
            arrays[f"{name}_{field.name}"] = getattr(node, field.name)
        return {"primitives": name}
    if isinstance(node, Merge):
        return {"merge": [_listed(child, arrays) for child in node.children]}
    return {"replace": [_listed(node.under, arrays), _listed(node.over, arrays)]}


def _tree_of(told: dict[str, object], arrays: dict[str, NDArray[Any]]) -> Node:
    if "primitives" in told:
        return Primitives(*(arrays[f"{told['primitives']}_{field.name}"] for field in dataclasses.fields(Primitives)))
    if "merge" in told:
        return Merge(tuple(_tree_of(child, arrays) for child in told["merge"]))  # type: ignore[attr-defined]
    under, over = (_tree_of(child, arrays) for child in told["replace"])  # type: ignore[attr-defined]
    return Replace(under, over)


@public
def read_riverscape(path: str | os.PathLike[str], *, device: wp.DeviceLike = "cpu") -> Riverscape:
    """Read a scene that :meth:`Riverscape.save` wrote; the water is that of the file, to the bit.

    Args:
        path: The ``.json`` file.
        device: Warp device.

    Raises:
        OSError: A file is missing.
        ValueError: It is no scene.
    """
    source = pathlib.Path(path)
    try:
        told = json.loads(source.read_text())
        with np.load(source.with_suffix(".npz")) as file:
            arrays = dict(file)
    except OSError as error:
        raise PathError.of(error, "give the .json of a scene, with its .npz beside it") from error
    except ValueError as error:
        raise InputError(f"{source} is no scene ({error}); Riverscape.save writes one") from error
    try:
        if told["kind"] != "riverscape" or told["format"] != FORMAT:
            raise KeyError("format")
        place = told["terrain"]
        terrain = Terrain(arrays["terrain"], place["cell_size"], place["origin"], place["crs"], device=device)
        courses = [
            Course(
                channel_type=course["type"],
                **{name: arrays[f"course{k}_{name}"] for name in COURSE_ARRAYS},
            )
            for k, course in enumerate(told["courses"])
        ]
        rocks = [Rock(tuple(r["center"]), r["diameter"], r["top"]) for r in told["rocks"]]
        tree = _tree_of(told["tree"], arrays)
        params = SeedingParams(**told["params"])
        laid = None
        if told.get("laid"):
            names = [name for name in arrays if name.startswith("laid.")]
            laid = Stations.from_arrays({name.removeprefix("laid."): arrays[name] for name in names})
    except (KeyError, TypeError) as error:
        raise InputError(f"{source} is no scene of this version ({error}); Riverscape.save writes one") from error
    scene = Riverscape(
        terrain, courses, rocks=rocks, detail=told["detail"], seed=told["seed"], params=params, tree=tree, device=device
    )
    if laid is not None:
        scene.rivers = Rivers.of_stations(scene.terrain, laid)
    return scene
