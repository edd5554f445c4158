"""A river with its bed and its moving water, to be asked at any place and time [Peytavie2019]."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import pathlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.errors import InputError, PathError
from warpriver.files import beside
from warpriver.public import public
from warpriver.riverscape.courses import Course, CourseMap, Rock
from warpriver.riverscape.drift import LeafFrame, checked_times, drift_leaves
from warpriver.riverscape.primitives import Merge, Node, Primitives, Replace
from warpriver.riverscape.seeding import SeedingParams, seed_water
from warpriver.riverscape.water import Water, WaterGrid, WaterSample
from warpriver.terrain import Terrain
from warpriver.validate import finite_numbers, positive, seeded, whole

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
    """A terrain with the beds of channels in it and water that moves.

    Args:
        terrain: The ground.
        courses: Channels: lines, levels, sections, speeds.
        rocks: Boulders in and beside the water.
        detail: Spacing of the water's primitives where it runs at 1 m/s, m.
        seed: Of all that is drawn.
        params: How primitives are chosen.
        tree: The water as a tree of its own, in place of one that follows from the courses.
        device: Warp device.

    Attributes:
        terrain: As given.
        courses: The channels, to be asked at any place.
        water_surface: The blend-flow tree.
        detail: As given.
        seed: As given.

    Raises:
        ValueError: No course, or a value out of its range.

    Source:
        [Peytavie2019].
    """

    @public
    def __init__(
        self,
        terrain: Terrain,
        courses: Sequence[Course],
        *,
        rocks: Sequence[Rock] = (),
        detail: float = 0.5,
        seed: int = 0,
        params: SeedingParams | None = None,
        tree: Primitives | Merge | Replace | None = None,
        device: wp.DeviceLike = "cpu",
    ) -> None:
        self.terrain = terrain
        self.detail, self.seed = positive(detail, "detail", "m"), whole(seed, "seed", most=2**31 - 1)
        seeded(seed)
        self.params = SeedingParams() if params is None else params
        self.courses = CourseMap(courses, rocks=rocks, device=device)
        made: Node = seed_water(self.courses, self.detail, self.seed, self.params) if tree is None else tree
        self.water_surface = Water(made, device=device)
        self._bed: tuple[tuple[object, ...], DeviceArray] | None = None

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
    def bed(self, xy: ArrayLike) -> FloatArray:
        """Ask for the height of the bed, or of the ground beside it, at places.

        Args:
            xy: (n, 2) m.

        Raises:
            ValueError: Places that are not finite.
        """
        return self.courses.bed(xy, self.terrain)

    @public
    def carved(self, cell_size: float, bounds: Sequence[float] | FloatArray | None = None) -> Terrain:
        """Return the ground with the beds in it, as a terrain of any cell size.

        Args:
            cell_size: m.
            bounds: (west, south, east, north) in m; by default those of the terrain.

        Raises:
            ValueError: No such grid, or too many cells.
        """
        origin, shape = self._grid(bounds, cell_size)
        height = self._bed_grid(origin, cell_size, shape).numpy()
        return Terrain(height, cell_size, origin, self.terrain.raster.crs, device=self.courses.device)

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
        }
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
            x = origin[0] + cell_size * (np.arange(shape[1]) + 0.5)
            y = origin[1] - cell_size * (np.arange(shape[0]) + 0.5)
            at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            bed: DeviceArray = wp.array(self.bed(at).reshape(shape), dtype=wp.float64, device=self.courses.device)
            self._bed = (key, bed)
        return self._bed[1]

    def __repr__(self) -> str:
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
    except (KeyError, TypeError) as error:
        raise InputError(f"{source} is no scene of this version ({error}); Riverscape.save writes one") from error
    return Riverscape(
        terrain, courses, rocks=rocks, detail=told["detail"], seed=told["seed"], params=params, tree=tree, device=device
    )
