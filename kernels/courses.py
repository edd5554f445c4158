"""Channels as water needs them: level, bed and current of the nearest course at any place [Peytavie2019]."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import steps
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Depths across a section, over its greatest one, at even places from the left bank to the right.
ACROSS = 33
# How steeply banks rise from the water at most, and over how many depths they begin to.
BANK_SLOPE, BANK_EASE = 0.6, 0.5


@once
def build(scalar):
    """Make the kernels of courses for one precision; places are relative to an origin, heights float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.courses_{scalar.__name__}"
    smooth_steps = steps.build(scalar)
    vec2, vec4 = wp.types.vector(2, scalar), wp.types.vector(4, scalar)
    ZERO, HALF, ONE, TWO = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0))
    FAR, SHORT = scalar(1.0e30), scalar(1.0e-12)
    BANK_SLOPE_, BANK_EASE_ = scalar(BANK_SLOPE), scalar(BANK_EASE)
    TWO_THIRDS = scalar(2.0 / 3.0)
    LAST, LAST_ = ACROSS - 1, scalar(ACROSS - 1)
    NOWHERE, HIGHEST = wp.float64(math.nan), wp.float64(math.inf)
    ONE64, HALF64 = wp.float64(1.0), wp.float64(0.5)

    @wp.struct
    class Courses:
        """Points of all courses, downstream; a segment runs from its point to the next one.

        ``place``: x, y and half width in m, distance along the course in m. ``flow``: direction, speed at the greatest
        depth in m/s, that depth in m. ``bank``: level that banks rise from, without steps. ``form``: rows of
        ``ACROSS``. ``fall``: whether the segment is a fall, where the water is that above or below. Buckets of a grid
        list the segments that reach into them, in order; ``west`` and ``south`` are the first ones from the origin.
        """

        place: wp.array[vec4]
        flow: wp.array[vec4]
        level: wp.array[wp.float64]
        bank: wp.array[wp.float64]
        form: wp.array2d[scalar]
        course: wp.array[int]
        fall: wp.array[int]
        bucket_start: wp.array[int]
        bucket_segment: wp.array[int]
        bucket_size: scalar
        west: int
        south: int
        columns: int
        rows: int

    @wp.struct
    class Survey:
        """What courses are like at places.

        ``level`` of the water in m (NaN where no course is near), ``gradient`` of it; ``depth`` of the bed below that,
        m, below 0 on a bank; ``velocity`` in m/s; ``across``: distance from the course over its half width, above 0 on
        the left; ``along`` in m from the course's first point; ``point``: first of the nearest segment, -1 where none
        is.
        """

        level: wp.array[wp.float64]
        gradient: wp.array[vec2]
        depth: wp.array[scalar]
        velocity: wp.array[vec2]
        across: wp.array[scalar]
        along: wp.array[scalar]
        point: wp.array[int]

    @wp.struct
    class Nearest:
        """The nearest place on the segments of one course: first point, share towards the next, distance squared."""

        point: int
        share: scalar
        square: scalar

    @wp.func(module=name)
    def side_of(courses: Courses, near: Nearest, at: vec2) -> scalar:
        """Distance from the course over its half width there, above 0 on the left."""
        a, b = courses.place[near.point], courses.place[near.point + 1]
        half = a[2] + near.share * (b[2] - a[2])
        left = (b[0] - a[0]) * (at[1] - a[1]) - (b[1] - a[1]) * (at[0] - a[0])
        return wp.where(left < ZERO, -ONE, ONE) * wp.sqrt(near.square) / half

    @wp.func(module=name)
    def depth_of(courses: Courses, near: Nearest, across: scalar) -> scalar:
        """Depth of a section below the water, m; on a bank below 0, by an eased slope."""
        i = near.point
        depth = courses.flow[i][3] + near.share * (courses.flow[i + 1][3] - courses.flow[i][3])
        if wp.abs(across) >= ONE:
            half = courses.place[i][2] + near.share * (courses.place[i + 1][2] - courses.place[i][2])
            beyond, ease = (wp.abs(across) - ONE) * half, BANK_EASE_ * depth
            return BANK_SLOPE_ * (ease - wp.sqrt(beyond * beyond + ease * ease))
        x = HALF * (ONE - across) * LAST_
        k = wp.min(int(x), LAST - 1)
        x = x - scalar(k)
        first = courses.form[i, k] + x * (courses.form[i, k + 1] - courses.form[i, k])
        second = courses.form[i + 1, k] + x * (courses.form[i + 1, k + 1] - courses.form[i + 1, k])
        return depth * (first + near.share * (second - first))

    @wp.func(module=name)
    def level_of(courses: Courses, near: Nearest) -> wp.float64:
        """Level of the water; on a fall that above its middle, and below it that of the foot."""
        i = near.point
        share = wp.float64(near.share)
        if courses.fall[i] != 0:
            share = wp.where(share < HALF64, wp.float64(0.0), ONE64)
        return courses.level[i] + share * (courses.level[i + 1] - courses.level[i])

    @wp.func(module=name)
    def bed_of(courses: Courses, near: Nearest, across: scalar) -> wp.float64:
        """Height of the section or bank; away from the water banks follow its level without steps."""
        i, share = near.point, wp.float64(near.share)
        level = courses.level[i] + share * (courses.level[i + 1] - courses.level[i])
        x = wp.clamp(TWO * (wp.abs(across) - ONE), ZERO, ONE)
        if x > ZERO:
            bank = courses.bank[i] + share * (courses.bank[i + 1] - courses.bank[i])
            level = level + wp.float64(smooth_steps.cubic_step(x)) * (bank - level)
        return level - wp.float64(depth_of(courses, near, across))

    @wp.func(module=name)
    def gradient_of(courses: Courses, near: Nearest) -> vec2:
        """Gradient of the water along the course; beside a fall that of the segment above or below it."""
        i = near.point
        if courses.fall[i] != 0:
            i = wp.where(near.share < HALF, i - 1, i + 1)
            last = courses.course.shape[0] - 1
            i = wp.clamp(i, 0, last - 1)
            if courses.course[i] != courses.course[near.point] or courses.course[i + 1] != courses.course[i]:
                return vec2(ZERO, ZERO)
            if courses.fall[i] != 0:
                return vec2(ZERO, ZERO)
        a, b = courses.place[i], courses.place[i + 1]
        rise = scalar(courses.level[i + 1] - courses.level[i])
        toward = vec2(b[0] - a[0], b[1] - a[1])
        return (rise / wp.max(wp.dot(toward, toward), SHORT)) * toward

    @wp.func(module=name)
    def lowest_course(courses: Courses, at: vec2) -> Nearest:
        """Nearest place on the course whose bed is the lowest at a place; point -1 where no course is near."""
        best, near = Nearest(), Nearest()
        best.point = -1
        lowest = HIGHEST
        column = int(wp.floor(at[0] / courses.bucket_size)) - courses.west
        row = int(wp.floor(at[1] / courses.bucket_size)) - courses.south
        if column < 0 or row < 0 or column >= courses.columns or row >= courses.rows:
            return best
        bucket = row * courses.columns + column
        stop = courses.bucket_start[bucket + 1]
        course = int(-1)
        for k in range(courses.bucket_start[bucket], stop + 1):
            i = int(-1)
            here = int(-2)
            if k < stop:
                i = courses.bucket_segment[k]
                here = courses.course[i]
            if here != course:
                # All segments of a course have been seen.
                if course >= 0:
                    bed = bed_of(courses, near, side_of(courses, near, at))
                    if bed < lowest:
                        lowest = bed
                        best = near
                course = here
                near = Nearest()
                near.square = FAR
            if k < stop:
                a, b = courses.place[i], courses.place[i + 1]
                toward, off = vec2(b[0] - a[0], b[1] - a[1]), vec2(at[0] - a[0], at[1] - a[1])
                share = wp.clamp(wp.dot(off, toward) / wp.max(wp.dot(toward, toward), SHORT), ZERO, ONE)
                off = off - share * toward
                square = wp.dot(off, off)
                if square < near.square:
                    near.point = i
                    near.share = share
                    near.square = square
        return best

    @wp.kernel(module=name, enable_backward=False)
    def survey_places(
        # params
        courses: Courses,
        # in
        point_xy: wp.array[vec2],
        # out
        survey_out: Survey,
    ):
        """Say what the course with the lowest bed is like at places; u ~ d^(2/3) across it [Jarrett1984]."""
        i = wp.tid()
        near = lowest_course(courses, point_xy[i])
        survey_out.point[i] = near.point
        survey_out.level[i] = NOWHERE
        survey_out.gradient[i] = vec2(ZERO, ZERO)
        survey_out.velocity[i] = vec2(ZERO, ZERO)
        survey_out.depth[i] = ZERO
        survey_out.across[i] = ZERO
        survey_out.along[i] = ZERO
        if near.point < 0:
            return
        k = near.point
        across = side_of(courses, near, point_xy[i])
        depth = depth_of(courses, near, across)
        first, second = courses.flow[k], courses.flow[k + 1]
        flow = first + near.share * (second - first)
        direction = wp.normalize(vec2(flow[0], flow[1]))
        share = wp.clamp(depth / flow[3], ZERO, ONE)
        survey_out.level[i] = level_of(courses, near)
        survey_out.gradient[i] = gradient_of(courses, near)
        survey_out.depth[i] = depth
        survey_out.velocity[i] = flow[2] * wp.pow(share, TWO_THIRDS) * direction
        survey_out.across[i] = across
        survey_out.along[i] = courses.place[k][3] + near.share * (courses.place[k + 1][3] - courses.place[k][3])

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        Courses=Courses,
        Survey=Survey,
        survey_places=survey_places,
    )
