"""What water needs to know of a channel: its course, levels, sections and current, and a query of them at any place."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import DeviceArray, FloatArray, IndexArray
from warpriver.device import launch_kernel, resolve_device
from warpriver.errors import InputError
from warpriver.kernels import courses as kernels
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import checked_line, checked_points, floats

__all__ = ["TYPES", "Course", "CourseMap", "Rock", "SurveyedPlaces"]


# Rosgen's types, by slope and section [Rosgen1994].
TYPES = ("A+", "A", "B", "C", "D", "DA", "E", "F", "G")
# How far beyond its water a course is looked for, in its own greatest depths and half widths.
REACH_IN_DEPTHS, REACH_IN_HALF_WIDTHS = 6.0, 0.5
# Buckets of the search at most.
MOST_BUCKETS = 2**26


@dataclasses.dataclass(frozen=True, eq=False)
class Rock:
    """A boulder in or beside the water: the upper half of a spheroid.

    Attributes:
        center: (2,) m.
        diameter: m.
        top: Elevation of its highest point, m.
    """

    center: tuple[float, float]
    diameter: float
    top: float


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """A channel as water needs it, one value a point; points run downstream.

    Attributes:
        xy: (n, 2) centre line, m.
        level: (n,) of the water, m; it never rises.
        width: (n,) of the water, m.
        depth: (n,) greatest of the section, m.
        speed: (n,) mean of the section, m/s.
        channel_type: Rosgen's type [Rosgen1994], one of :data:`TYPES`.
        form: (m,) or (n, m) depth over the greatest, at even places from the left bank to the right; by default that
            of a parabola.
        falls: Numbers of the first points of segments on which the water falls: its level is that of the point above,
            then that of the point below.

    Raises:
        ValueError: A line of fewer than 3 points, arrays that differ in length, a level that rises, or a value out of
            its range.
    """

    xy: ArrayLike
    level: ArrayLike
    width: ArrayLike
    depth: ArrayLike
    speed: ArrayLike
    channel_type: str = "C"
    form: ArrayLike | None = None
    falls: ArrayLike = ()

    def __post_init__(self) -> None:
        xy = checked_line(self.xy, "Course.xy")
        count = len(xy)
        object.__setattr__(self, "xy", xy)
        if self.channel_type not in TYPES:
            raise InputError(f"Course.channel_type is {self.channel_type!r}; use one of {', '.join(TYPES)}")
        for name in ("level", "width", "depth", "speed"):
            value = np.array(np.broadcast_to(floats(getattr(self, name), f"Course.{name}"), count))
            low = -np.inf if name == "level" else 0.0
            wrong = ~(np.isfinite(value) & (value > low))
            if wrong.any():
                k = int(wrong.argmax())
                raise InputError(f"Course.{name} of point {k} is {value[k]:g}; give a finite number above {low:g}")
            object.__setattr__(self, name, value)
        rising = np.diff(np.asarray(self.level)) > 0.0
        if rising.any():
            k = int(rising.argmax())
            raise InputError(f"Course.level rises after point {k}, {int(rising.sum())} times in all; water does not")
        place = np.linspace(1.0, -1.0, kernels.ACROSS)
        form = np.atleast_2d(1.0 - place**2 if self.form is None else floats(self.form, "Course.form"))
        if form.ndim != 2 or form.shape[1] < 2 or len(form) not in (1, count) or not np.isfinite(form).all():
            raise InputError(f"Course.form has shape {form.shape}; give (m,) or ({count}, m) finite numbers")
        if form.shape[1] != kernels.ACROSS:
            given = np.linspace(1.0, -1.0, form.shape[1])
            form = np.stack([np.interp(-place, -given, row) for row in form])
        if form.min() < 0.0 or form.max() > 1.0 + 1e-9 or not (form.mean(axis=1) > 0.0).all():
            raise InputError("Course.form must lie in [0, 1], and be above 0 somewhere: depth over the greatest depth")
        object.__setattr__(self, "form", np.array(np.broadcast_to(form, (count, kernels.ACROSS))))
        falls = np.asarray(self.falls, np.int64).reshape(-1)
        if len(falls) and not (0 <= falls.min() and falls.max() < count - 1):
            raise InputError(f"Course.falls must be numbers of points from 0 to {count - 2}, but not the last point's")
        object.__setattr__(self, "falls", falls)

    @property
    def along(self) -> FloatArray:
        """(n,) distance from the first point, m."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(np.asarray(self.xy), axis=0).T))])

    @property
    def length(self) -> float:
        """Length, m."""
        return float(self.along[-1])

    @property
    def discharge(self) -> FloatArray:
        """(n,) mean speed times the section's area, m3/s."""
        area = np.asarray(self.width) * np.asarray(self.depth) * _mean(np.asarray(self.form))
        return np.asarray(np.asarray(self.speed) * area)

    @property
    def direction(self) -> FloatArray:
        """(n, 2) unit vectors downstream: at each point half way between those of its segments."""
        toward = np.diff(np.asarray(self.xy), axis=0)
        toward /= np.hypot(*toward.T)[:, None]
        joined = np.concatenate([toward[:1], toward[:-1] + toward[1:], toward[-1:]])
        size = np.hypot(*joined.T)[:, None]
        # Where a course turns back on itself, the segment before tells.
        return np.where(size > 1e-9, joined / np.maximum(size, 1e-9), np.concatenate([toward[:1], toward]))

    @property
    def curvature(self) -> FloatArray:
        """(n,) 1/m, above 0 where it turns left."""
        direction, along = self.direction, self.along
        angle = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
        return np.gradient(angle, along)

    @property
    def bank_level(self) -> FloatArray:
        """(n,) level that banks rise from, m: the mean of the water's over a length of three widths, without steps."""
        along, level = self.along, np.asarray(self.level)
        reach = 1.5 * np.asarray(self.width)
        # Of the linear level between points, by its integral.
        total = np.concatenate([[0.0], np.cumsum(0.5 * (level[1:] + level[:-1]) * np.diff(along))])
        low, high = np.maximum(along - reach, 0.0), np.minimum(along + reach, along[-1])
        return np.asarray((np.interp(high, along, total) - np.interp(low, along, total)) / (high - low))

    @property
    def peak_speed(self) -> FloatArray:
        """(n,) speed at the greatest depth, m/s: u ~ d^(2/3) across, such that the integral of u d is the discharge."""
        form = np.asarray(self.form)
        return np.asarray(self.speed) * _mean(form) / _mean(form ** (5.0 / 3.0))


@dataclasses.dataclass(frozen=True, eq=False)
class SurveyedPlaces:
    """What courses are like at n places.

    Attributes:
        level: (n,) of the water, m; NaN where no course is near.
        gradient: (n, 2) of it, m/m.
        depth: (n,) of the bed below it, m; below 0 on a bank.
        velocity: (n, 2) m/s.
        across: (n,) distance from the centre line over the half width, above 0 on the left.
        along: (n,) from the first point of the course, m.
        point: (n,) first point of the nearest segment among those of all courses, -1 where no course is near.
    """

    level: FloatArray
    gradient: FloatArray
    depth: FloatArray
    velocity: FloatArray
    across: FloatArray
    along: FloatArray
    point: IndexArray


class CourseMap:
    """Courses and rocks on a device, to be asked at any place.

    Args:
        courses: One or more.
        rocks: Boulders.
        device: Warp device.

    Attributes:
        courses: As given.
        rocks: As given.
        start: First point of each course among all points, and their count.

    Raises:
        ValueError: No course, or more buckets than can be held.
    """

    @public
    def __init__(self, courses: Sequence[Course], *, rocks: Sequence[Rock] = (), device: wp.DeviceLike = "cpu") -> None:
        self.courses, self.rocks = list(courses), list(rocks)
        if not self.courses or not all(isinstance(course, Course) for course in self.courses):
            raise InputError("courses must be one Course or more; wr.riverscape.Course(...) makes one")
        self.device = resolve_device(device)
        self._kernels = kernels.build(wp.float64)
        self.start = np.concatenate([[0], np.cumsum([len(np.asarray(c.xy)) for c in self.courses])])
        self._joined: dict[str, FloatArray] = {}
        joined = {
            name: self.joined(name) for name in ("xy", "level", "width", "depth", "along", "direction", "peak_speed")
        }
        self._bucket(joined)
        self._on_device(joined)

    def joined(self, name: str) -> FloatArray:
        """Values of all courses' points, one course after the other."""
        if name not in self._joined:
            self._joined[name] = np.concatenate([np.asarray(getattr(course, name)) for course in self.courses])
        return self._joined[name]

    @property
    def course_of_point(self) -> IndexArray:
        """(n,) number of the course of each point."""
        return np.repeat(np.arange(len(self.courses)), np.diff(self.start))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north of all water, m."""
        half = 0.5 * self._joined["width"][:, None]
        low, high = (self._joined["xy"] - half).min(axis=0), (self._joined["xy"] + half).max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @public
    def survey(self, xy: ArrayLike) -> SurveyedPlaces:
        """Ask what the courses are like at places; where several are near, the one whose bed is lowest.

        Args:
            xy: (n, 2) m.

        Raises:
            ValueError: Places that are not finite.
        """
        points = checked_points(xy, "xy")
        found = self._kernels.Survey()
        for name, kind in (
            ("level", wp.float64),
            ("gradient", wp.vec2d),
            ("depth", wp.float64),
            ("velocity", wp.vec2d),
            ("across", wp.float64),
            ("along", wp.float64),
            ("point", wp.int32),
        ):
            setattr(found, name, wp.empty(len(points), dtype=kind, device=self.device))
        if len(points):
            at: DeviceArray = wp.array(points - self.origin, dtype=wp.vec2d, device=self.device)
            launch_kernel(self._kernels.survey_places, len(points), [self._courses, at], [found], device=self.device)
        names = [f.name for f in dataclasses.fields(SurveyedPlaces)]
        return SurveyedPlaces(*(getattr(found, name).numpy() for name in names))

    @public
    def bed(self, xy: ArrayLike, terrain: Terrain, *, rocks: bool = True) -> FloatArray:
        """Height of the bed at places: the least of the ground and all sections and banks, and the rocks on it.

        Args:
            xy: (n, 2) m.
            terrain: The ground; between its cells' centres by cubics.
            rocks: Whether rocks lie on it.

        Raises:
            ValueError: Places that are not finite, or a terrain on another device.
        """
        points = checked_points(xy, "xy")
        bed = wp.empty(len(points), dtype=wp.float64, device=self.device)
        if len(points):
            at: DeviceArray = wp.array(points - self.origin, dtype=wp.vec2d, device=self.device)
            inputs = [self._ground(terrain), self._courses, self._rocks if rocks else self._no_rocks, at]
            launch_kernel(self._kernels.carve_places, len(points), inputs, [bed], device=self.device)
        return np.asarray(bed.numpy())

    def _ground(self, terrain: Terrain) -> Any:
        raster = terrain.raster
        ground = self._kernels.Ground()
        ground.height = raster.values if raster.device == self.device else raster.values.to(self.device)
        ground.cell_size = raster.cell_size
        ground.west = raster.origin[0] + 0.5 * raster.cell_size - self.origin[0]
        ground.north = raster.origin[1] - 0.5 * raster.cell_size - self.origin[1]
        return ground

    def _bucket(self, joined: dict[str, FloatArray]) -> None:
        """Lay a grid over all water and list what reaches into each of its squares."""
        xy, half = joined["xy"], 0.5 * joined["width"]
        reach = half * (1.0 + REACH_IN_HALF_WIDTHS) + REACH_IN_DEPTHS * joined["depth"]
        inner = np.ones(len(xy), bool)
        inner[self.start[1:] - 1] = False
        self._segment = np.flatnonzero(inner)
        wide = np.maximum(reach[self._segment], reach[self._segment + 1])[:, None]
        low = np.minimum(xy[self._segment], xy[self._segment + 1]) - wide
        high = np.maximum(xy[self._segment], xy[self._segment + 1]) + wide
        rock_xy = np.array([rock.center for rock in self.rocks], np.float64).reshape(-1, 2)
        radius = np.array([0.5 * rock.diameter for rock in self.rocks])[:, None]
        corner = np.minimum(low.min(axis=0), (rock_xy - radius).min(axis=0, initial=np.inf))
        far = np.maximum(high.max(axis=0), (rock_xy + radius).max(axis=0, initial=-np.inf))
        size = max(float(np.median(reach)) / 3.0, 1e-3)
        # Where the water is sparse, larger squares.
        size = max(size, float(np.sqrt(np.prod(far - corner) / MOST_BUCKETS)))
        self.origin = (float(corner[0]), float(corner[1]))
        self._size = size
        self._shape = tuple(int(v) + 1 for v in np.floor((far - corner) / size))
        self._bucket_start, self._bucket_segment = self._listed(low, high)
        self._bucket_segment = self._segment[self._bucket_segment]
        self._rock_start, self._rock_listed = self._listed(rock_xy - radius, rock_xy + radius)

    def _listed(self, low: FloatArray, high: FloatArray) -> tuple[IndexArray, IndexArray]:
        """First entry of each bucket, and the boxes in each of them, in their order."""
        first = np.floor((low - self.origin) / self._size).astype(np.int64)
        across, up = (np.floor((high - self.origin) / self._size).astype(np.int64) - first + 1).T
        count = across * up
        box = np.repeat(np.arange(len(low)), count)
        k = np.arange(len(box)) - np.repeat(np.cumsum(count) - count, count)
        bucket = (first[box, 1] + k // across[box]) * self._shape[0] + first[box, 0] + k % across[box]
        order = np.argsort(bucket, kind="stable")
        start = np.concatenate([[0], np.cumsum(np.bincount(bucket, minlength=self._shape[0] * self._shape[1]))])
        return start, box[order]

    def _on_device(self, joined: dict[str, FloatArray]) -> None:
        made = self._kernels

        def put(values: ArrayLike, kind: Any, numpy_type: Any) -> DeviceArray:
            return wp.array(np.ascontiguousarray(values, numpy_type), dtype=kind, device=self.device)

        local = joined["xy"] - self.origin
        falls = np.zeros(len(local), np.int32)
        for course, start in zip(self.courses, self.start[:-1], strict=True):
            falls[start + np.asarray(course.falls)] = 1
        courses = made.Courses()
        place = np.column_stack([local, 0.5 * joined["width"], joined["along"]])
        flow = np.column_stack([joined["direction"], joined["peak_speed"], joined["depth"]])
        courses.place, courses.flow = put(place, made.vec4, np.float64), put(flow, made.vec4, np.float64)
        courses.level = put(joined["level"], wp.float64, np.float64)
        courses.bank = put(self.joined("bank_level"), wp.float64, np.float64)
        courses.form = put(self.joined("form"), wp.float64, np.float64)
        courses.course = put(self.course_of_point, wp.int32, np.int32)
        courses.fall = put(falls, wp.int32, np.int32)
        courses.bucket_start = put(self._bucket_start, wp.int32, np.int32)
        courses.bucket_segment = put(self._bucket_segment, wp.int32, np.int32)
        courses.bucket_size = self._size
        courses.columns, courses.rows = self._shape
        self._courses = courses
        rows = [[*np.subtract(r.center, self.origin), 0.5 * r.diameter, 0.35 * r.diameter] for r in self.rocks]
        self._rocks, self._no_rocks = made.Rocks(), made.Rocks()
        self._rocks.place = put(np.array(rows).reshape(-1, 4), made.vec4, np.float64)
        self._rocks.top = put(np.array([rock.top for rock in self.rocks]), wp.float64, np.float64)
        self._rocks.bucket_start = put(self._rock_start, wp.int32, np.int32)
        self._rocks.bucket_rock = put(self._rock_listed, wp.int32, np.int32)
        self._no_rocks.bucket_start = wp.zeros_like(self._rocks.bucket_start)
        for name in ("place", "top", "bucket_rock"):
            setattr(self._no_rocks, name, getattr(self._rocks, name))


def _mean(form: FloatArray) -> FloatArray:
    """Mean over the width, by the trapezoidal rule."""
    return np.asarray((form[:, :-1] + form[:, 1:]).mean(axis=1) / 2.0)
