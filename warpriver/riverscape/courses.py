"""What water needs to know of a channel: its course, levels, sections and current, and a query of them at any place."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import DeviceArray, FlagArray, FloatArray, IndexArray
from warpriver.device import launch_kernel, put_on_device, resolve_device
from warpriver.errors import InputError
from warpriver.kernels import courses as kernels
from warpriver.public import public
from warpriver.riverscape.sorting import boxes, stable_order
from warpriver.validate import checked_line, checked_points, floats

__all__ = ["TYPES", "Course", "CourseFrame", "CourseMap", "Log", "Rock", "SurveyedPlaces", "checked_courses"]


# Rosgen's types, by slope and section [Rosgen1994].
TYPES = ("A+", "A", "B", "C", "D", "DA", "E", "F", "G")
# How far beyond its water a course is looked for, in its own greatest depths and half widths.
REACH_IN_DEPTHS, REACH_IN_HALF_WIDTHS = 6.0, 0.5
# Buckets of the search at most.
MOST_BUCKETS = 2**26


@dataclasses.dataclass(frozen=True)
class Rock:
    """A boulder in or beside the water.

    Attributes:
        center: (2,) m.
        diameter: m.
        top: Elevation of its highest point, m.
    """

    center: tuple[float, float]
    diameter: float
    top: float


@dataclasses.dataclass(frozen=True)
class Log:
    """A trunk that lies in or beside the water.

    Attributes:
        start: (2,) middle of one end, m.
        end: (2,) of the other.
        diameter: m.
        top: Elevation of its upper side, m.
    """

    start: tuple[float, float]
    end: tuple[float, float]
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

    @functools.cached_property
    def along(self) -> FloatArray:
        """(n,) distance from the first point, m."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(np.asarray(self.xy), axis=0).T))])

    @property
    def length(self) -> float:
        """Length, m."""
        return float(self.along[-1])

    @functools.cached_property
    def discharge(self) -> FloatArray:
        """(n,) mean speed times the section's area, m3/s."""
        area = np.asarray(self.width) * np.asarray(self.depth) * _mean(np.asarray(self.form))
        return np.asarray(np.asarray(self.speed) * area)

    @functools.cached_property
    def direction(self) -> FloatArray:
        """(n, 2) unit vectors downstream: at each point half way between those of its segments."""
        toward = np.diff(np.asarray(self.xy), axis=0)
        toward /= np.hypot(*toward.T)[:, None]
        joined = np.concatenate([toward[:1], toward[:-1] + toward[1:], toward[-1:]])
        size = np.hypot(*joined.T)[:, None]
        # Where a course turns back on itself, the segment before tells.
        return np.where(size > 1e-9, joined / np.maximum(size, 1e-9), np.concatenate([toward[:1], toward]))

    @functools.cached_property
    def curvature(self) -> FloatArray:
        """(n,) 1/m, above 0 where it turns left."""
        direction, along = self.direction, self.along
        angle = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
        return np.gradient(angle, along)

    @functools.cached_property
    def bank_level(self) -> FloatArray:
        """(n,) level that banks rise from, m: the mean of the water's over a length of three widths, without steps."""
        along, level = self.along, np.asarray(self.level)
        reach = 1.5 * np.asarray(self.width)
        # Of the linear level between points, by its integral.
        total = np.concatenate([[0.0], np.cumsum(0.5 * (level[1:] + level[:-1]) * np.diff(along))])
        low, high = np.maximum(along - reach, 0.0), np.minimum(along + reach, along[-1])
        return np.asarray((np.interp(high, along, total) - np.interp(low, along, total)) / (high - low))

    @functools.cached_property
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

    def __getitem__(self, rows: IndexArray | FlagArray) -> SurveyedPlaces:
        return SurveyedPlaces(*(getattr(self, f.name)[rows] for f in dataclasses.fields(self)))


class CourseFrame(NamedTuple):
    """What places of a map of courses are relative to: maps of one frame give the same bits where they are alike.

    Attributes:
        origin: (x, y) in m.
        size: Side of the squares that are searched, m.
    """

    origin: tuple[float, float]
    size: float


class CourseMap:
    """Courses, rocks and logs on a device, to be asked at any place.

    Args:
        courses: One or more.
        rocks: Boulders.
        logs: Trunks.
        frame: That of another map, to give the same bits where both are alike; by default one of its own.
        device: Warp device.

    Attributes:
        courses: As given.
        rocks: As given.
        logs: As given.
        frame: What places are relative to.
        start: First point of each course among all points, and their count.

    Raises:
        ValueError: No course, or more buckets than can be held.
    """

    @public
    def __init__(
        self,
        courses: Sequence[Course],
        *,
        rocks: Sequence[Rock] = (),
        logs: Sequence[Log] = (),
        frame: CourseFrame | None = None,
        device: wp.DeviceLike = "cpu",
    ) -> None:
        self.courses, self.rocks, self.logs = checked_courses(courses), list(rocks), list(logs)
        self.device = resolve_device(device)
        self._kernels = kernels.build(wp.float64)
        self.start = np.concatenate([[0], np.cumsum([len(np.asarray(c.xy)) for c in self.courses])])
        self._joined: dict[str, FloatArray] = {}
        joined = {
            name: self.joined(name) for name in ("xy", "level", "width", "depth", "along", "direction", "peak_speed")
        }
        self._bucket(joined, frame)
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
            at = put_on_device(points - self.origin, wp.vec2d, self.device)
            launch_kernel(self._kernels.survey_places, len(points), [self._courses, at], [found], device=self.device)
        names = [f.name for f in dataclasses.fields(SurveyedPlaces)]
        return SurveyedPlaces(*(getattr(found, name).numpy() for name in names))

    def _bucket(self, joined: dict[str, FloatArray], frame: CourseFrame | None) -> None:
        """Lay a grid over all water and list what reaches into each of its squares."""
        xy = joined["xy"]
        reach = _reach(joined["width"], joined["depth"])
        inner = np.ones(len(xy), bool)
        inner[self.start[1:] - 1] = False
        segment = np.flatnonzero(inner)
        wide = np.maximum(reach[segment], reach[segment + 1])[:, None]
        low = np.minimum(xy[segment], xy[segment + 1]) - wide
        high = np.maximum(xy[segment], xy[segment + 1]) + wide
        if frame is None:
            frame = _frame(low.min(axis=0), high.max(axis=0), reach)
        self.frame, self.origin = frame, frame.origin
        first = np.floor((low - self.origin) / frame.size).astype(np.int64)
        last = np.floor((high - self.origin) / frame.size).astype(np.int64)
        self._corner = first.min(axis=0)
        self._shape = tuple(int(v) + 1 for v in last.max(axis=0) - self._corner)
        box, column, row = boxes(first - self._corner, last - self._corner)
        bucket = row * self._shape[0] + column
        order = stable_order(bucket)
        counts = np.bincount(bucket, minlength=self._shape[0] * self._shape[1])
        self._bucket_start = np.concatenate([[0], np.cumsum(counts)])
        self._bucket_segment = segment[box[order]]

    def _on_device(self, joined: dict[str, FloatArray]) -> None:
        made = self._kernels

        def put(values: ArrayLike, kind: Any, numpy_type: Any) -> DeviceArray:
            return put_on_device(np.asarray(values, numpy_type), kind, self.device)

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
        courses.bucket_size = self.frame.size
        courses.west, courses.south = (int(v) for v in self._corner)
        courses.columns, courses.rows = self._shape
        self._courses = courses


def frame_of(courses: Sequence[Course]) -> CourseFrame:
    """Return the frame that a map of courses would have, for maps of a part of them."""
    xy, reach = np.concatenate([np.asarray(c.xy) for c in courses]), np.concatenate([_reach_of(c) for c in courses])
    return _frame((xy - reach[:, None]).min(axis=0), (xy + reach[:, None]).max(axis=0), reach)


def courses_near(courses: Sequence[Course], window: tuple[float, float, float, float]) -> list[Course]:
    """Return the courses whose water or banks may reach into a window, whole.

    Args:
        courses: All courses.
        window: (west, south, east, north) in m.
    """
    low, high = np.array(window[:2]), np.array(window[2:])

    def near(course: Course) -> bool:
        xy, reach = np.asarray(course.xy), float(_reach_of(course).max())
        return bool((xy.min(axis=0) - reach < high).all() and (xy.max(axis=0) + reach > low).all())

    return [course for course in courses if near(course)]


def _reach_of(course: Course) -> FloatArray:
    return _reach(np.asarray(course.width), np.asarray(course.depth))


def _reach(width: FloatArray, depth: FloatArray) -> FloatArray:
    """How far from its points a course is known, m."""
    return np.asarray(0.5 * width * (1.0 + REACH_IN_HALF_WIDTHS) + REACH_IN_DEPTHS * depth)


def _frame(low: FloatArray, high: FloatArray, reach: FloatArray) -> CourseFrame:
    """Squares from the corner of all water; where it is sparse, larger ones."""
    size = max(float(np.median(reach)) / 3.0, 1e-3)
    size = max(size, float(np.sqrt(np.prod(high - low) / MOST_BUCKETS)))
    return CourseFrame((float(low[0]), float(low[1])), size)


def checked_courses(courses: Sequence[Course]) -> list[Course]:
    """Return courses as a list; raises ``ValueError`` for none, and for what is none."""
    found = list(courses)
    if not found or not all(isinstance(course, Course) for course in found):
        raise InputError("courses must be one Course or more; wr.riverscape.Course(...) makes one")
    return found


def _mean(form: FloatArray) -> FloatArray:
    """Mean over the width, by the trapezoidal rule."""
    return np.asarray((form[:, :-1] + form[:, 1:]).mean(axis=1) / 2.0)
