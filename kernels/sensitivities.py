"""Sensitivities of migrating lines: how each point would move with other constants, carried along in the same steps."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import memory, polyline
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.sensitivities_{scalar.__name__}"
    line, past = polyline.build(scalar), memory.build(scalar)
    vec2, vec3, vec4 = line.vec2, line.vec3, past.vec4
    ZERO, HALF, ONE, TWO, THREE = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0))
    TWO_THIRDS = scalar(2.0 / 3.0)
    REACH, QUANTUM, QUANTA = line.REACH, line.ARC_QUANTUM, wp.float64(1.0) / line.ARC_QUANTUM

    @wp.struct
    class RateLaw:
        """Constants of the rate that are the same everywhere, from ``MeanderParams``; ``end_damping`` in widths."""

        local_weight: scalar
        upstream_weight: scalar
        scale_local: int
        scale_upstream: int
        end_damping: scalar

    @wp.struct
    class Courses:
        """Lines whose points lie end to end, each with the constants of the rate there.

        ``start`` has the offsets of the lines, ``width`` their mean widths in m. ``section`` is the width of a point,
        the strength of its bends over the rate, and the length that its memory is a multiple of, all in m. ``law`` is
        the rate in m/yr, that multiple, and the width times curvature at which the rate saturates (0: never). ``arc``
        is the running sum of the segments' lengths in quanta, 0 for the one above a line's first point.
        """

        start: wp.array[int]
        width: wp.array[scalar]
        xy: wp.array[vec2]
        section: wp.array[vec3]
        law: wp.array[vec3]
        arc: wp.array[wp.int64]

    @wp.struct
    class Directions:
        """Directions in which constants change, one block of all points after the other.

        ``xy`` is how far a point has moved for each unit, m, ``seed`` how the logarithms of the three constants in
        ``Courses.law`` change there.
        """

        xy: wp.array[vec2]
        seed: wp.array[vec3]

    @wp.struct
    class Pieces:
        """Consecutive points that a thread takes: ``first[p] .. first[p + 1] - 1`` of the line ``line[p]``."""

        first: wp.array[int]
        line: wp.array[int]

    @wp.struct
    class Stretch:
        """Points begin .. stop - 1 of a line of points first .. last, and what the terms of the rate weigh there."""

        first: int
        last: int
        begin: int
        stop: int
        local: scalar
        upstream: scalar
        spacing: scalar
        reach: scalar

    @wp.struct
    class Bend:
        """A point between the segments ``a`` and ``b``.

        ``value`` is the strength of its bend, ``slope`` and ``turn`` its derivatives by the curvature and by the
        logarithm of the saturation; ``decay`` is one over the memory in m, ``rate`` that of the law.
        """

        a: vec2
        b: vec2
        la: scalar
        lb: scalar
        curvature: scalar
        value: scalar
        slope: scalar
        turn: scalar
        decay: scalar
        rate: scalar

    @wp.func(module=name)
    def stretch_of(courses: Courses, constants: RateLaw, pieces: Pieces, p: int) -> Stretch:
        """The points of a piece, with the weights of the terms in its line."""
        s = Stretch()
        owner = pieces.line[p]
        s.first = courses.start[owner]
        s.last = courses.start[owner + 1] - 1
        s.begin = pieces.first[p]
        s.stop = pieces.first[p + 1]
        length = scalar(wp.float64(courses.arc[s.last] - courses.arc[s.first]) * QUANTUM)
        chord = wp.length(courses.xy[s.last] - courses.xy[s.first])
        sinuosity = wp.pow(wp.min(chord / length, ONE), TWO_THIRDS)
        s.local = constants.local_weight
        s.upstream = constants.upstream_weight
        if constants.scale_local != 0:
            s.local = s.local * sinuosity
        if constants.scale_upstream != 0:
            s.upstream = s.upstream * sinuosity
        s.spacing = length / scalar(s.last - s.first)
        s.reach = constants.end_damping * courses.width[owner]
        return s

    @wp.func(module=name)
    def felt_at(s: Stretch, j: int) -> scalar:
        """Fraction of what is upstream that is felt at a point: it fades to 0 at both ends of the line."""
        away = scalar(wp.min(j - s.first, s.last - j)) * s.spacing
        if away >= s.reach:
            return ONE
        t = away / s.reach
        return t * t * (THREE - TWO * t)

    @wp.func(module=name)
    def saturated(width: scalar, saturation: scalar, curvature: scalar) -> vec3:
        """Curvature as it counts, c0 tanh(w C / c0) / w, and its derivatives by C and by the logarithm of c0."""
        if saturation == ZERO:
            return vec3(curvature, ONE, ZERO)
        u = width * curvature / saturation
        t = wp.tanh(u)
        slope = ONE - t * t
        return vec3(saturation * t / width, slope, saturation * (t - u * slope) / width)

    @wp.func(module=name)
    def bend_at(courses: Courses, s: Stretch, j: int) -> Bend:
        """The bend at a point of a line, none at its ends."""
        bend = Bend()
        section = courses.section[j]
        law = courses.law[j]
        here = courses.xy[j]
        bend.a = here - courses.xy[wp.max(j - 1, s.first)]
        bend.b = courses.xy[wp.min(j + 1, s.last)] - here
        bend.la = wp.length(bend.a)
        bend.lb = wp.length(bend.b)
        bend.curvature = line.circle_curvature(bend.a, bend.b, bend.la, bend.lb)
        counted = saturated(section[0], law[2], bend.curvature)
        bend.value = section[1] * counted[0]
        bend.slope = section[1] * counted[1]
        bend.turn = section[1] * counted[2]
        bend.decay = ONE / (law[1] * section[2])
        bend.rate = law[0]
        return bend

    @wp.func(module=name)
    def warm_start(courses: Courses, s: Stretch) -> int:
        """First point upstream of a stretch whose weight in it is not lost in rounding."""
        i = int(s.begin)
        depth = scalar(0.0)
        decay = ONE / (courses.law[i][1] * courses.section[i][2])
        while i > s.first and depth < REACH:
            before = ONE / (courses.law[i - 1][1] * courses.section[i - 1][2])
            depth += HALF * (before + decay) * wp.length(courses.xy[i] - courses.xy[i - 1])
            decay = before
            i -= 1
        return i

    @wp.kernel(module=name, enable_backward=False)
    def trace_velocity(
        # network
        courses: Courses,
        # params
        constants: RateLaw,
        pieces: Pieces,
        # out
        velocity_out: wp.array[vec2],
    ):
        """Velocity in m/yr of every point of lines whose ends are held, n k (omega v + e gamma mean of v upstream).

        v = w c0 tanh(w C / c0) / w, and the mean is the recurrence of [Paris2023], Eq. 2-5, over an uneven line.
        """
        s = stretch_of(courses, constants, pieces, wp.tid())
        warm = warm_start(courses, s)
        before = bend_at(courses, s, warm)
        mean = scalar(0.0)
        for j in range(warm, s.stop):
            here = bend_at(courses, s, j)
            if j > warm:
                q = past.decay_weights(HALF * here.la * (before.decay + here.decay))
                mean = q[0] * mean + q[1] * before.value + q[2] * here.value
            if j >= s.begin:
                velocity = vec2(ZERO, ZERO)
                if j > s.first and j < s.last:
                    rate = here.rate * (s.local * here.value + s.upstream * felt_at(s, j) * mean)
                    velocity = rate * line.right_normal(vec2(ZERO, ZERO), here.a + here.b)
                velocity_out[j] = velocity
            before = here

    @wp.func(module=name)
    def curvature_change(bend: Bend, da: vec2, db: vec2) -> scalar:
        """Change of the curvature 2 a x b / (|a| |b| |a + b|) where its segments change by da and db."""
        chord = bend.a + bend.b
        sizes = bend.la * bend.lb * wp.length(chord)
        if sizes == ZERO:
            return ZERO
        area = (da[0] * bend.b[1] - da[1] * bend.b[0]) + (bend.a[0] * db[1] - bend.a[1] * db[0])
        stretch = wp.dot(bend.a, da) / (bend.la * bend.la) + wp.dot(bend.b, db) / (bend.lb * bend.lb)
        stretch += wp.dot(chord, da + db) / wp.dot(chord, chord)
        return TWO * area / sizes - bend.curvature * stretch

    @wp.func(module=name)
    def velocity_change(bend: Bend, change: vec2, rate: scalar, rate_change: scalar) -> vec2:
        """Change of the velocity, rate times normal, where the rate and the chord a + b change."""
        chord = bend.a + bend.b
        size = wp.length(chord)
        if size == ZERO:
            return vec2(ZERO, ZERO)
        along = chord / size
        normal = vec2(along[1], -along[0])
        # The normal turns with the chord: against the direction of flow where the chord turns to the right.
        return rate_change * normal - (rate * wp.dot(change, normal) / size) * along

    @wp.kernel(module=name, enable_backward=False)
    def trace_tangents(
        # network
        courses: Courses,
        # params
        constants: RateLaw,
        pieces: Pieces,
        # in
        directions: Directions,
        # out
        change_out: wp.array[vec2],
    ):
        """Change of the velocities of ``trace_velocity`` in each direction: its derivative, term by term.

        A thread a piece and direction. The derivative of the recurrence I_i = q I_(i-1) + w0 v_(i-1) + w1 v_i is
        carried beside it; of its weights over a segment of depth x, dq = -q dx, dw1 = (w0 / x) dx, dw0 = -dq - dw1.
        """
        piece_count = pieces.line.shape[0]
        offset = wp.tid() // piece_count * courses.xy.shape[0]
        s = stretch_of(courses, constants, pieces, wp.tid() % piece_count)
        warm = warm_start(courses, s)
        before = bend_at(courses, s, warm)
        before_change = scalar(0.0)
        before_seed = directions.seed[offset + warm]
        mean = scalar(0.0)
        mean_change = scalar(0.0)
        for j in range(warm, s.stop):
            here = bend_at(courses, s, j)
            seed = directions.seed[offset + j]
            moved = directions.xy[offset + j]
            da = moved - directions.xy[offset + wp.max(j - 1, s.first)]
            db = directions.xy[offset + wp.min(j + 1, s.last)] - moved
            here_change = here.slope * curvature_change(here, da, db) + here.turn * seed[2]
            if j > warm and here.la > ZERO:
                x = HALF * here.la * (before.decay + here.decay)
                dx = HALF * wp.dot(here.a, da) / here.la * (before.decay + here.decay)
                dx -= HALF * here.la * (before.decay * before_seed[1] + here.decay * seed[1])
                q = past.decay_weights(x)
                dw1 = q[1] / x * dx
                dw0 = q[0] * dx - dw1
                mean_change = q[0] * (mean_change - dx * mean) + q[1] * before_change + q[2] * here_change
                mean_change += dw0 * before.value + dw1 * here.value
                mean = q[0] * mean + q[1] * before.value + q[2] * here.value
            if j >= s.begin:
                change = vec2(ZERO, ZERO)
                if j > s.first and j < s.last:
                    felt = s.upstream * felt_at(s, j)
                    rate = here.rate * (s.local * here.value + felt * mean)
                    rate_change = rate * seed[0] + here.rate * (s.local * here_change + felt * mean_change)
                    change = velocity_change(here, da + db, rate, rate_change)
                change_out[offset + j] = change
            before = here
            before_change = here_change
            before_seed = seed

    @wp.kernel(module=name, enable_backward=False)
    def advance_points(
        # params
        step: scalar,
        # in
        velocity: wp.array[vec2],
        # out
        xy_io: wp.array[vec2],
    ):
        """Move points, or how far they have moved, by one step: p + v dt."""
        i = wp.tid()
        xy_io[i] = xy_io[i] + step * velocity[i]

    @wp.kernel(module=name, enable_backward=False)
    def measure_segments(
        # network
        courses: Courses,
        # out
        quanta_out: wp.array[wp.int64],
    ):
        """Length of the segment above each point in whole quanta, 0 above the first one of a line."""
        i = wp.tid()
        quanta = wp.int64(0)
        if i > courses.start[line.channel_at(courses.start, i)]:
            quanta = wp.int64(line.whole_quanta(wp.length(courses.xy[i] - courses.xy[i - 1])) * QUANTA)
        quanta_out[i] = quanta

    @wp.kernel(module=name, enable_backward=False)
    def place_points(
        # network
        courses: Courses,
        # out
        place_out: wp.array[int],
        weight_out: wp.array[vec4],
    ):
        """Where as many even points of each line lie: first of four points in a row, and the weights of these.

        They are those of the cubic through the four by arc length (Lagrange's), whose middle segment the place is on
        except near the ends. The ends stay to the bit.
        """
        i = wp.tid()
        owner = line.channel_at(courses.start, i)
        first = courses.start[owner]
        last = courses.start[owner + 1] - 1
        origin = courses.arc[first]
        part = wp.float64(i - first) / wp.float64(last - first)
        target = wp.int64(wp.round(part * wp.float64(courses.arc[last] - origin)))
        low = int(first)
        high = int(last)
        while high - low > 1:
            middle = (low + high) // 2
            if courses.arc[middle] - origin <= target:
                low = middle
            else:
                high = middle
        k = wp.clamp(low - 1, first, last - 3)
        scale = wp.float64(1.0) / wp.float64(wp.max(courses.arc[k + 3] - courses.arc[k], wp.int64(1)))
        t0 = scalar(wp.float64(courses.arc[k] - origin - target) * scale)
        t1 = scalar(wp.float64(courses.arc[k + 1] - origin - target) * scale)
        t2 = scalar(wp.float64(courses.arc[k + 2] - origin - target) * scale)
        t3 = scalar(wp.float64(courses.arc[k + 3] - origin - target) * scale)
        place_out[i] = k
        if i == first:
            weight_out[i] = vec4(ONE, ZERO, ZERO, ZERO)
        elif i == last:
            weight_out[i] = vec4(ZERO, ZERO, ZERO, ONE)
        else:
            weight_out[i] = vec4(
                t1 * t2 * t3 / ((t1 - t0) * (t2 - t0) * (t3 - t0)),
                t0 * t2 * t3 / ((t0 - t1) * (t2 - t1) * (t3 - t1)),
                t0 * t1 * t3 / ((t0 - t2) * (t1 - t2) * (t3 - t2)),
                t0 * t1 * t2 / ((t0 - t3) * (t1 - t3) * (t2 - t3)),
            )

    @wp.func(module=name)
    def nearer_part(w: vec4) -> vec2:
        """Point, of four in a row, above a place, and the fraction of the way to the next one, for linear values."""
        # The cubic's weights reproduce straight lines: the mean index is the place, as the points are nearly even.
        at = w[1] + TWO * w[2] + THREE * w[3]
        below = wp.clamp(wp.floor(at), ZERO, TWO)
        return vec2(below, wp.clamp(at - below, ZERO, ONE))

    @wp.kernel(module=name, enable_backward=False)
    def sample_courses(
        # network
        courses: Courses,
        # in
        place: wp.array[int],
        weight: wp.array[vec4],
        # out
        xy_out: wp.array[vec2],
        section_out: wp.array[vec3],
        law_out: wp.array[vec3],
    ):
        """Points at their new places, with what belongs to them; what is positive is mixed linearly."""
        i = wp.tid()
        k = place[i]
        w = weight[i]
        xy_out[i] = (
            w[0] * courses.xy[k] + w[1] * courses.xy[k + 1] + w[2] * courses.xy[k + 2] + w[3] * courses.xy[k + 3]
        )
        near = nearer_part(w)
        k += int(near[0])
        section_out[i] = (ONE - near[1]) * courses.section[k] + near[1] * courses.section[k + 1]
        law_out[i] = (ONE - near[1]) * courses.law[k] + near[1] * courses.law[k + 1]

    @wp.kernel(module=name, enable_backward=False)
    def sample_directions(
        # in
        directions: Directions,
        place: wp.array[int],
        weight: wp.array[vec4],
        # out
        xy_out: wp.array[vec2],
        seed_out: wp.array[vec3],
    ):
        """How far the points at new places have moved in each direction, with the weights of the points themselves."""
        count = place.shape[0]
        i = wp.tid() % count
        offset = wp.tid() - i
        k = offset + place[i]
        w = weight[i]
        xy = directions.xy
        xy_out[offset + i] = w[0] * xy[k] + w[1] * xy[k + 1] + w[2] * xy[k + 2] + w[3] * xy[k + 3]
        near = nearer_part(w)
        k += int(near[0])
        seed_out[offset + i] = (ONE - near[1]) * directions.seed[k] + near[1] * directions.seed[k + 1]

    return SimpleNamespace(
        vec2=vec2,
        vec3=vec3,
        vec4=vec4,
        RateLaw=RateLaw,
        Courses=Courses,
        Directions=Directions,
        Pieces=Pieces,
        trace_velocity=trace_velocity,
        trace_tangents=trace_tangents,
        advance_points=advance_points,
        measure_segments=measure_segments,
        place_points=place_points,
        sample_courses=sample_courses,
        sample_directions=sample_directions,
    )
