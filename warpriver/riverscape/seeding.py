"""Which primitives a river's water is made of: where, how large, of which kind and how lively [Peytavie2019], 5.3."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.kernels import flow_tree as kernels
from warpriver.parameter import Params, parameter
from warpriver.public import public
from warpriver.riverscape.courses import Course, CourseMap, SurveyedPlaces
from warpriver.riverscape.primitives import Node, Primitives, blend
from warpriver.riverscape.programs import CELLS_ACROSS, TileFrame
from warpriver.riverscape.sorting import boxes, distinct
from warpriver.validate import positive, whole

__all__ = ["SeedingParams", "seed_layers", "seed_water"]


GRAVITY = 9.81
# Spacings of the lattice: half the detail, and its double, four and eight times that.
LEVELS = 4
# Types whose water goes down steps, whose bends part deep from shallow water, and which lie in several threads.
STEPPED, BENDING, THREADED = ("A+", "A", "B"), ("C", "E", "F", "G"), ("D", "DA")
# Radius of the largest primitives, in details.
FARTHEST = 4.0
# (west, south, east, north) in m.
Window: TypeAlias = tuple[float, float, float, float]
# Where a bend begins: curvature times width.
BEND = 0.15


@dataclasses.dataclass(frozen=True)
class SeedingParams(Params):
    """How primitives are chosen for the water of courses."""

    calm_froude: float = parameter(
        0.2, "-", low=0.0, high=1.0, source="warpriver", doc="Froude number below which water is calm"
    )
    ripple_froude: float = parameter(
        0.45, "-", low=0.0, high=1.0, source="warpriver", doc="Froude number below which it ripples; above, turbulent"
    )
    liveliness: float = parameter(
        1.0, "-", low=0.0, high=20.0, source="warpriver", doc="factor on the amplitude of all waves"
    )
    wind: float = parameter(
        0.003, "m", low=0.0, high=1.0, source="warpriver", doc="amplitude of the ripples that wind alone makes"
    )
    foam_reach: float = parameter(
        8.0, "falls", low=0.1, high=100.0, source="Peytavie2019", doc="heights of a fall over which foam fades by 1/e"
    )
    rough_reach: float = parameter(
        6.0, "falls", low=0.1, high=100.0, source="Peytavie2019", doc="heights of a fall over which waves fade by 1/e"
    )


@dataclasses.dataclass(frozen=True)
class _Sites:
    """Places of primitives: their spacing, the courses there, and numbers that only depend on the place."""

    xy: FloatArray
    spacing: FloatArray
    bits: IndexArray
    survey: SurveyedPlaces

    def __getitem__(self, rows: IndexArray | FlagArray) -> _Sites:
        return _Sites(self.xy[rows], self.spacing[rows], self.bits[rows], self.survey[rows])


@public
def seed_water(courses: CourseMap, detail: float, seed: int, params: SeedingParams | None = None) -> Node:
    """Return the blend-flow tree of the water of courses.

    Centres lie on a lattice whose spacing halves where the water is fast, with radii as large as the spacing; what is
    replaced upon that: standing waves, wakes of rocks. All that is drawn depends on the seed and the place alone.

    Args:
        courses: Channels and rocks.
        detail: Spacing of primitives where water runs at 1 m/s, m.
        seed: Of what is drawn.
        params: How they are chosen.

    Raises:
        ValueError: A detail or a seed that is out of range.

    Source:
        [Peytavie2019], Sec. 5.3.
    """
    positive(detail, "detail", "m")
    whole(seed, "seed", maximum=2**31 - 1)
    params = SeedingParams() if params is None else params
    return blend(*seed_layers(courses, detail, seed, params).values())


def seed_layers(
    courses: CourseMap, detail: float, seed: int, params: SeedingParams, window: Window | None = None
) -> dict[str, Primitives]:
    """Return what :func:`seed_water` makes a tree of, from the bottom up, by name; layers without leaves are left out.

    With a window, (west, south, east, north) in m, the body of the water is left out that does not reach into it.

    "body": all of the water; "waves": standing waves; "wakes": rough water behind rocks and logs; "eddies": the pairs
    of vortices upon that.
    """
    known = _PointTable(courses)
    made = {
        "body": _body(courses, known, detail, seed, params, window),
        "waves": _standing_waves(courses, known, detail, seed, params),
    }
    parts = [_wakes(courses, known, seed, params)]
    if courses.logs:
        parts.append(_log_wakes(courses, known, seed, params))
    for name, each in zip(("wakes", "eddies"), zip(*parts, strict=True), strict=True):
        made[name] = Primitives.concatenate(each)
    return {name: rows for name, rows in made.items() if name == "body" or len(rows)}


class _PointTable:
    """What is the same all across a course, by its points."""

    def __init__(self, courses: CourseMap) -> None:
        self.width, self.depth = courses.joined("width"), courses.joined("depth")
        self.speed, self.curvature = courses.joined("speed"), courses.joined("curvature")
        form = courses.joined("form")
        self.mean_depth = self.depth * (form[:, 1:] + form[:, :-1]).mean(axis=1) / 2.0
        kinds = np.array([course.channel_type for course in courses.courses])[courses.course_of_point]
        self.stepped, self.bending = np.isin(kinds, STEPPED), np.isin(kinds, BENDING)
        self.threaded = np.isin(kinds, THREADED)
        self.course = courses.course_of_point
        # Where the falls are, as a distance along the course that its number keeps apart from others'; differences are
        # taken along the course alone, so that they do not depend on its number.
        length = max(course.length for course in courses.courses) + 1.0
        points = [start + np.asarray(c.falls) for c, start in zip(courses.courses, courses.start, strict=False)]
        self.fall = np.sort(np.concatenate(points).astype(np.int64))
        level, along = courses.joined("level"), courses.joined("along")
        self.fall_height = level[self.fall] - level[self.fall + 1]
        self.fall_level = 0.5 * (level[self.fall] + level[self.fall + 1])
        self.fall_run = along[self.fall + 1] - along[self.fall]
        self.apart = 2.0 * length
        self.fall_along = 0.5 * (along[self.fall] + along[self.fall + 1])
        self.fall_course = self.course[self.fall]
        self.fall_place = self.fall_course * self.apart + self.fall_along

    def behind_fall(self, survey: SurveyedPlaces) -> tuple[FloatArray, FloatArray]:
        """Distance below the last fall upstream, m, infinite where there is none; and its height, m."""
        if not len(self.fall):
            return np.full(len(survey.along), np.inf), np.ones(len(survey.along))
        place = self.course[survey.point] * self.apart + survey.along
        last = np.searchsorted(self.fall_place, place) - 1
        known = (last >= 0) & (self.fall_course[last] == self.course[survey.point])
        last = np.maximum(last, 0)
        far = np.maximum(survey.along - self.fall_along[last], 0.0)
        return np.where(known, far, np.inf), np.where(known, self.fall_height[last], 1.0)

    def near_fall(self, survey: SurveyedPlaces) -> tuple[IndexArray, FloatArray]:
        """The nearest fall of the course, and how far down the stream it is, m; infinite where there is none."""
        if not len(self.fall):
            return np.zeros(len(survey.along), np.int64), np.full(len(survey.along), np.inf)
        place = self.course[survey.point] * self.apart + survey.along
        after = np.searchsorted(self.fall_place, place)
        sides = np.clip([after - 1, after], 0, len(self.fall) - 1)
        far = self.fall_along[sides] - survey.along
        far = np.where(self.fall_course[sides] == self.course[survey.point], far, np.inf)
        nearest = np.abs(far).argmin(axis=0)
        rows = np.arange(len(place))
        return sides[nearest, rows], far[nearest, rows]


def hashed(i: IndexArray, j: IndexArray, salt: int) -> IndexArray:
    """Random bits of lattice places, below 2^32 [Perlin2002]: of the place and a salt alone."""
    mask = np.uint64(0xFFFFFFFFFFFFFFFF)
    with np.errstate(over="ignore"):
        x = np.asarray(i).astype(np.int64).view(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        x ^= np.asarray(j).astype(np.int64).view(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
        x += np.uint64(salt & 0xFFFFFFFF) * np.uint64(0x165667B19E3779F9)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9) & mask
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB) & mask
    return ((x ^ (x >> np.uint64(31))) & np.uint64(0xFFFFFFFF)).astype(np.int64)


def _place_bits(xy: FloatArray, salt: int) -> IndexArray:
    """Random bits of places: of where they are, to a centimetre, and of a salt alone."""
    x, y = np.round(np.asarray(xy) * 100.0).astype(np.int64).T
    return hashed(x, y, salt)


def _share(bits: IndexArray, salt: int) -> FloatArray:
    """Numbers in [0, 1) from random bits."""
    return hashed(bits, np.zeros_like(bits), salt) / 2.0**32


def _lattice(courses: CourseMap, known: _PointTable, detail: float, seed: int, window: Window | None) -> _Sites:
    """Corners of the squares that the water is divided into, a square by four where its water wants it finer."""
    finest = 0.5 * detail
    side = finest * 2.0 ** (LEVELS - 1)
    xy, half = courses.joined("xy"), 0.5 * known.width
    squares = _near_squares(xy, half, side)
    if window is not None:
        # The corners of a square reach into its neighbours.
        low, high = np.floor(np.array(window[:2]) / side) - 2, np.floor(np.array(window[2:]) / side) + 2
        squares = squares[((squares >= low) & (squares <= high)).all(axis=1)]
    corners: list[tuple[IndexArray, float]] = []
    for level in range(LEVELS - 1, -1, -1):
        side = finest * 2.0**level
        found = courses.survey((squares + 0.5) * side)
        near = found.point >= 0
        squares, point = squares[near], found.point[near]
        beyond = (np.abs(found.across[near]) - 1.0) * half[point]
        # A corner of a square in the water is another one's, too.
        wet = beyond < 0.5 * side
        squares, point = squares[wet], point[wet]
        fits = _level(known.speed[point], known.width[point], detail) >= level
        kept = squares[fits]
        block = np.concatenate([kept + step for step in ((0, 0), (1, 0), (0, 1), (1, 1))])
        corners.append((_unique(block), side))
        fine = squares[~fits]
        squares = np.concatenate([2 * fine + step for step in ((0, 0), (1, 0), (0, 1), (1, 1))])
    places = np.concatenate([corner * side for corner, side in corners])
    spacing = np.concatenate([np.full(len(corner), side) for corner, side in corners])
    bits = np.concatenate([hashed(c[:, 0], c[:, 1], seed * LEVELS + k) for k, (c, _) in enumerate(corners)])
    found = courses.survey(places)
    beyond = (np.abs(found.across) - 1.0) * half[np.maximum(found.point, 0)]
    # What only reaches the bank is left out.
    wet_places = (found.point >= 0) & (beyond < 0.5 * spacing)
    return _Sites(places, spacing, bits, found)[wet_places]


def _level(speed: FloatArray, width: FloatArray, detail: float) -> IndexArray:
    """Level of the lattice that suits water: its spacing is half the detail, times 2 to the power of the level."""
    wanted = np.minimum(detail * np.sqrt(1.0 / speed), 0.25 * width)
    return np.clip(np.floor(np.log2(wanted / (0.5 * detail)) + 0.5), 0, LEVELS - 1).astype(np.int64)


def frame_of_water(courses: Sequence[Course], detail: float) -> TileFrame:
    """Return what the numbers of the water of courses are relative to, so that parts of it have the bits of the whole.

    The cells are as large as the smallest tenth of the primitives.
    """
    speed, width, along, xy = (
        np.concatenate([np.asarray(getattr(c, name)) for c in courses]) for name in ("speed", "width", "along", "xy")
    )
    spacing = 0.5 * detail * 2.0 ** _level(speed, width, detail)
    count = width * np.maximum(np.diff(along, append=along[-1]), 0.0) / spacing**2
    order = np.argsort(spacing, kind="stable")
    total = np.cumsum(count[order])
    size = float(spacing[order][np.searchsorted(total, 0.1 * total[-1])])
    west, south = (int(v) for v in np.floor(xy.min(axis=0) / (CELLS_ACROSS * size)))
    return TileFrame(size, (west, south), np.empty((0, 2), np.int64), np.empty(0))


def margin_of(frame: TileFrame, detail: float) -> float:
    """Return how far beyond a window water has to be made, m, so that in it every bit is that of the whole.

    The datum of a tile follows from all that reaches into it, and what reaches into the window may begin in the tile
    beside it.
    """
    return 2.0 * (CELLS_ACROSS * frame.cell_size + FARTHEST * detail)


def _unique(pairs: IndexArray) -> IndexArray:
    """Different pairs of whole numbers, sorted."""
    if not len(pairs):
        return pairs
    low = pairs.min(axis=0)
    wide = int(pairs[:, 0].max() - low[0]) + 1
    key = distinct((pairs[:, 1] - low[1]) * wide + pairs[:, 0] - low[0])
    return np.asarray(np.column_stack([key % wide, key // wide]) + low)


def _near_squares(xy: FloatArray, half: FloatArray, side: float) -> IndexArray:
    """Squares of a side that the boxes around points of courses touch."""
    low = np.floor((xy - half[:, None]) / side).astype(np.int64) - 1
    high = np.floor((xy + half[:, None]) / side).astype(np.int64) + 1
    _, column, row = boxes(low, high)
    return _unique(np.column_stack([column, row]))


def _body(
    courses: CourseMap, known: _PointTable, detail: float, seed: int, params: SeedingParams, window: Window | None
) -> Primitives:
    """Calm, rippling and turbulent water, and echoes of calm water at banks."""
    at = _lattice(courses, known, detail, seed, window)
    here, point = at.survey, at.survey.point
    depth = np.maximum(here.depth, 0.1 * known.depth[point])
    speed = np.hypot(*here.velocity.T)
    # Beyond the water's edge it is as at its edge: a tenth of the depth.
    least = 0.2 * known.speed[point]
    slow = speed < least
    direction = courses.joined("direction")[point]
    velocity = np.where(slow[:, None], least[:, None] * direction, here.velocity)
    speed = np.maximum(speed, least)
    froude = _liveliness(known, here, speed / np.sqrt(GRAVITY * depth))
    behind, height = known.behind_fall(here)
    rough = np.exp(-behind / (params.rough_reach * height))
    kind = np.where(froude < params.calm_froude, kernels.CALM, kernels.RIPPLE)
    kind = np.where((froude >= params.ripple_froude) | (rough > 0.3), kernels.TURBULENT, kind)
    head = speed**2 / (2.0 * GRAVITY)
    part = np.choose(kind, [0.1, 0.25, 0.5])
    amplitude = part * head + params.wind * np.choose(kind, [0.5, 1.0, 1.0]) + 0.18 * height * rough
    amplitude = params.liveliness * np.minimum(amplitude, 0.35 * depth)
    # Stationary waves are as long as 2 pi u^2 / g; below a fall they are shorter.
    length = 2.0 * np.pi * speed**2 / GRAVITY
    shortest = np.choose(kind, [1.2, 0.6, 0.5]) * at.spacing
    length = np.clip(length, shortest, np.choose(kind, [3.0, 2.0, 1.6]) * at.spacing)
    length = np.where(kind == kernels.TURBULENT, length * (1.0 - 0.4 * rough), length)
    foam = np.where(kind == kernels.TURBULENT, np.clip(0.6 * (froude - 0.6), 0.0, 0.5), 0.0)
    foam = np.clip(foam + np.clip(4.0 * height, 0.2, 0.8) * np.exp(-behind / (params.foam_reach * height)), 0.0, 1.0)
    shape = np.zeros((len(kind), 3))
    # At the banks of calm water ripples are thrown back.
    half = 0.5 * known.width[point]
    to_bank = (1.0 - np.abs(here.across)) * half
    echo = (kind == kernels.CALM) & (to_bank > 0.0) & (to_bank < 0.8 * at.spacing)
    side = np.where(here.across > 0.0, 1.0, -1.0)
    shape[echo, 0] = np.arctan2(side * direction[:, 0], -side * direction[:, 1])[echo]
    shape[echo, 1] = to_bank[echo]
    kind = np.where(echo, kernels.ECHO, kind)
    level, gradient = here.level.copy(), here.gradient.copy()
    # What reaches over a fall is a part of it: of all of them the levels agree, above and below.
    fall, far = known.near_fall(here)
    over = np.abs(far) < at.spacing
    kind = np.where(over, kernels.CASCADE, kind)
    fall, far = fall[over], far[over]
    drop, top = known.fall_height[fall], known.fall[fall]
    level[over] = known.fall_level[fall]
    gradient[over] = 0.0
    toward = courses.joined("direction")[top]
    velocity[over] = np.maximum(speed[over], 1.2 * known.speed[top])[:, None] * toward
    amplitude[over] = params.liveliness * np.minimum(0.2 * drop + params.wind, 0.35 * known.depth[top])
    length[over] = 0.7 * at.spacing[over]
    foam[over] = np.clip(4.0 * drop, 0.25, 0.75) + 0.25 * _share(at.bits[over], 3)
    # The lip is not quite straight; nowhere does the water fall before the bed does.
    lip = far + 0.3 * known.fall_run[fall] + 0.05 * at.spacing[over] * _share(at.bits[over], 1)
    blending = np.maximum(0.5 * known.fall_run[fall], 0.35 * drop) * (0.9 + 0.3 * _share(at.bits[over], 2))
    shape[over] = np.column_stack([drop, blending, lip])
    return Primitives(kind, at.xy, at.spacing, level, gradient, velocity, amplitude, length, foam, shape, at.bits)


def _liveliness(known: _PointTable, here: SurveyedPlaces, froude: FloatArray) -> FloatArray:
    """Froude numbers as the types have them: rough in deep bends and on straights, calm in shallows [Peytavie2019]."""
    point = here.point
    deep = np.clip(here.depth / known.depth[point], 0.0, 1.0)
    bent = np.clip(np.abs(known.curvature[point]) * known.width[point] / BEND - 0.5, 0.0, 1.0)
    in_bends = 0.5 + 0.9 * deep
    on_straights = 0.9 + 0.7 * deep
    bending = bent * in_bends + (1.0 - bent) * on_straights
    threaded = 0.5 + 0.8 * deep
    return froude * np.where(known.bending[point], bending, np.where(known.threaded[point], threaded, 1.0))


def _standing_waves(
    courses: CourseMap, known: _PointTable, detail: float, seed: int, params: SeedingParams
) -> Primitives:
    """Trains of stationary waves, 2 pi u^2 / g long, in the deepest water of rapids."""
    xy, along = courses.joined("xy"), courses.joined("along")
    froude = known.speed / np.sqrt(GRAVITY * known.mean_depth)
    bent = np.abs(known.curvature) * known.width
    length = 2.0 * np.pi * courses.joined("peak_speed") ** 2 / GRAVITY
    rapid = (froude > params.ripple_froude) & (bent < BEND) & ~known.stepped & (length > 0.25 * detail)
    # One place in about four widths, the same whatever lies elsewhere.
    part = np.floor(along / (2.0 * known.width)).astype(np.int64)
    first = rapid & ((np.diff(part, prepend=-1) != 0) | (np.diff(known.course, prepend=-1) != 0))
    bits = _place_bits(xy, seed * LEVELS + 6)
    point = np.flatnonzero(first & (_share(bits, 1) < 0.5))
    deepest = 1.0 - 2.0 * courses.joined("form")[point].argmax(axis=1) / (courses.joined("form").shape[1] - 1.0)
    left = np.column_stack([-courses.joined("direction")[point, 1], courses.joined("direction")[point, 0]])
    place = xy[point] + (0.5 * known.width[point] * 0.7 * deepest)[:, None] * left
    here = courses.survey(place)
    size = np.maximum(1.5 * length[point], 0.7 * detail)
    speed = np.hypot(*here.velocity.T)
    wet = (here.depth > 0.0) & (speed > 0.0)
    head = speed**2 / (2.0 * GRAVITY)
    shape = np.column_stack([params.liveliness * np.minimum(0.6 * head, 0.4 * here.depth), size * 0.5, length[point]])
    found = Primitives(
        np.full(len(point), kernels.WAVE), place, size, here.level, here.gradient, here.velocity,
        params.liveliness * np.minimum(0.3 * head + params.wind, 0.3 * np.maximum(here.depth, 0.0)),
        np.full(len(point), 0.7) * size, np.full(len(point), 0.2), shape, bits[point],
    )  # fmt: skip
    return found[wet]


def _wakes(courses: CourseMap, known: _PointTable, seed: int, params: SeedingParams) -> tuple[Primitives, Primitives]:
    """Behind each rock in the water rough water, and a pair of vortices of 1.2 diameters, beta = +-u/R, upon it."""
    center = np.array([rock.center for rock in courses.rocks]).reshape(-1, 2)
    size = np.array([rock.diameter for rock in courses.rocks])
    here = courses.survey(center)
    speed = np.hypot(*here.velocity.T)
    # Rocks at the banks stand aside of the current.
    wet = (here.point >= 0) & (here.depth > 0.0) & (speed > 0.02) & (np.abs(here.across) < 0.75)
    wake = _Wake(courses, known, center[wet], size[wet], here[wet], seed, params)
    wake.look((0.7, 0.0), (1.6, 0.0), (2.8, 0.0), (1.1, 0.6), (1.3, -0.6))
    rough = [wake.rough(*each) for each in ((0.7, 0.0, 1.0, 1.0), (1.6, 0.0, 1.2, 0.7), (2.8, 0.0, 1.5, 0.4))]
    pairs = [wake.vortex(side, along, 0.6) for side, along in ((1.0, 1.1), (-1.0, 1.3))]
    return Primitives.concatenate(rough), Primitives.concatenate(pairs)


def _log_wakes(
    courses: CourseMap, known: _PointTable, seed: int, params: SeedingParams
) -> tuple[Primitives, Primitives]:
    """Rough water along the lee of each log, and a vortex behind either end, turning against each other."""
    start = np.array([log.start for log in courses.logs]).reshape(-1, 2)
    end = np.array([log.end for log in courses.logs]).reshape(-1, 2)
    thick = np.array([log.diameter for log in courses.logs])
    middle = courses.survey(0.5 * (start + end))
    speed = np.hypot(*middle.velocity.T)
    wet = (middle.point >= 0) & (middle.depth > 0.0) & (speed > 0.02)
    start, end, thick, middle = start[wet], end[wet], thick[wet], middle[wet]
    toward = middle.velocity / speed[wet][:, None]
    left = np.column_stack([-toward[:, 1], toward[:, 0]])
    # The end on the left comes first.
    swapped = ((end - start) * left).sum(axis=1) > 0.0
    start, end = np.where(swapped[:, None], end, start), np.where(swapped[:, None], start, end)
    broad = np.abs(((end - start) * left).sum(axis=1))
    # Of a log along the current little stands in its way.
    size = np.clip(0.35 * broad, thick, 2.5 * thick)
    rough, pairs = [], []
    count = np.maximum(1, np.ceil(np.hypot(*(end - start).T) / (1.2 * size))).astype(np.int64)
    for k in range(int(count.max(initial=0))):
        some = count > k
        part = ((k + 0.5) / count[some])[:, None]
        place = (1.0 - part) * start[some] + part * end[some]
        here = courses.survey(place)
        flowing = (here.point >= 0) & (here.depth > 0.0) & (np.hypot(*here.velocity.T) > 0.02)
        own = np.flatnonzero(some)[flowing]
        wake = _Wake(courses, known, place[flowing], size[own], here[flowing], seed, params)
        rough += [wake.rough(*each) for each in ((0.9, 0.0, 1.1, 1.0), (2.0, 0.0, 1.3, 0.5))]
    for side, tip, other in ((1.0, start, end), (-1.0, end, start)):
        place = tip + (0.6 * size / np.maximum(np.hypot(*(other - tip).T), 1e-9))[:, None] * (other - tip)
        here = courses.survey(place)
        flowing = (here.point >= 0) & (here.depth > 0.0) & (np.hypot(*here.velocity.T) > 0.02)
        wake = _Wake(courses, known, place[flowing], size[flowing], here[flowing], seed, params)
        pairs.append(wake.vortex(side, 1.0, 0.0))
    none = _Wake(courses, known, start[:0], size[:0], middle[np.zeros(len(start), bool)], seed, params)
    rough, pairs = [none.rough(0.0, 0.0, 1.0, 1.0), *rough], [none.vortex(1.0, 1.0, 0.0), *pairs]
    return Primitives.concatenate(rough), Primitives.concatenate(pairs)


class _Wake:
    """Primitives behind things that stand in the water: where they are, how wide and how high."""

    def __init__(
        self,
        courses: CourseMap,
        known: _PointTable,
        center: FloatArray,
        size: FloatArray,
        here: SurveyedPlaces,
        seed: int,
        params: SeedingParams,
    ) -> None:
        self.courses, self.known, self.center, self.size, self.here = courses, known, center, size, here
        self.speed = np.maximum(np.hypot(*here.velocity.T), 1e-9)
        self.toward = here.velocity / self.speed[:, None]
        self.left = np.column_stack([-self.toward[:, 1], self.toward[:, 0]])
        self.bits = _place_bits(center, seed * LEVELS + 7)
        head = self.speed**2 / (2.0 * GRAVITY)
        self.height = params.liveliness * np.minimum(1.2 * head + params.wind, 0.3 * here.depth)
        self._found: dict[tuple[float, float], SurveyedPlaces] = {}

    def look(self, *offsets: tuple[float, float]) -> None:
        """Ask what the water is like at distances down the stream and to the left, in widths, all in one go."""
        found = self.courses.survey(np.concatenate([self._place(*offset) for offset in offsets]))
        count = len(self.size)
        for k, offset in enumerate(offsets):
            self._found[offset] = found[np.arange(k * count, (k + 1) * count)]

    def _place(self, along: float, aside: float) -> FloatArray:
        ahead, left = (along * self.size)[:, None] * self.toward, (aside * self.size)[:, None] * self.left
        return np.asarray(self.center + ahead + left)

    def rough(self, along: float, aside: float, wide: float, share: float) -> Primitives:
        """Rough water at a distance down the stream and to the left, in widths."""
        return self._rows(
            kernels.TURBULENT, along, aside, wide * self.size, amplitude=share * self.height,
            wavelength=0.9 * self.size, effervescence=np.full(len(self.size), 0.5 * share),
            shape=np.zeros((len(self.size), 3)),
        )  # fmt: skip

    def vortex(self, side: float, along: float, aside: float) -> Primitives:
        """Vortices on the left (1) or the right (-1), which turn the water back behind what stands there."""
        radius = 1.2 * self.size
        spin = -side * self.speed / radius
        shape = np.column_stack([-1.5 * side * np.ones(len(self.size)), spin, 0.8 * self.height])
        return self._rows(
            kernels.VORTEX, along, aside * side, radius, amplitude=self.height, wavelength=1.1 * self.size,
            effervescence=np.full(len(self.size), 0.25), shape=shape,
        )  # fmt: skip

    def _rows(self, kind: int, along: float, aside: float, radius: FloatArray, **rest: FloatArray) -> Primitives:
        size, here = self.size, self.here
        place = self._place(along, aside)
        if (along, aside) not in self._found:
            self.look((along, aside))
        found = self._found[along, aside]
        dry = ~(found.depth > 0.0)
        level = np.where(dry, here.level, found.level)
        velocity = np.where(dry[:, None], here.velocity, found.velocity)
        gradient = np.where(dry[:, None], 0.0, found.gradient)
        made = Primitives(
            kind=np.full(len(size), kind), center=place, radius=radius, level=level, gradient=gradient,
            velocity=0.6 * velocity, offset=hashed(self.bits, self.bits, int(97 * along + 31 * aside)), **rest,
        )  # fmt: skip
        # A wake ends where the water falls.
        return made[(found.point >= 0) & ~(np.abs(self.known.near_fall(found)[1]) < radius)]
