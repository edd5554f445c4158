"""Memory of curvature upstream: what is left of it along a channel, and what a link of a stem hands on to the next."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.channels import EDGE_NONE, EDGE_NORTH_SOUTH, EDGE_WEST_EAST, Work
from warpriver.kernels.status import HALT
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels for one precision, and the functions that they share with those of migration.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.memory_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2, vec3, vec4 = line.vec2, line.vec3, wp.types.vector(4, scalar)
    Channels, Points, Run, Ends = line.Channels, line.Points, line.Run, line.Ends
    ZERO, HALF, ONE, TWO = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0))
    EIGHT_NINTHS, QUARTER, TWO_THIRDS = (scalar(v) for v in (8.0 / 9.0, 0.25, 2.0 / 3.0))
    SERIES_LIMIT = scalar(0.5)
    # What has faded to this fraction is lost in the rounding of the sum.
    LOST = scalar(math.exp(-float(line.REACH)))
    # What enters a link is followed until this fraction of it is left.
    FAINT = scalar(1e-13 if scalar is wp.float64 else 1e-6)
    # Areas of rings are added up in 2^-62 of the squared length, as integers, so that the order does not matter. The
    # greatest, that of a circle, is 1 / (4 pi) of it. Lengths of stems are added up in quanta.
    AREA_PARTS, AREA_PART = wp.float64(2.0**62), wp.float64(2.0**-62)
    QUANTUM, QUANTA = line.ARC_QUANTUM, wp.float64(1.0) / line.ARC_QUANTUM
    TWO_64, PI_64 = wp.float64(2.0), wp.float64(math.pi)
    # 1/2 - x/6 + x^2/24 - ...: below the limit the first term left out is under 1e-16.
    factorial, SERIES = 2.0, []
    for term in range(14):
        SERIES.append((-1.0) ** term / factorial)
        factorial *= term + 3
    C0, C1, C2, C3, C4, C5, C6, C7, C8, C9, C10, C11, C12, C13 = (scalar(c) for c in SERIES)

    @wp.struct
    class MigrationConstants:
        """Constants of a simulation, from ``MeanderParams``; lengths in m, times in yr.

        ``freest`` is the greatest factor of the rate that banks have. ``memory_length`` is 0 where friction and depth
        tell how far bends are felt, ``curvature_saturation`` where nothing saturates.
        """

        migration_rate: scalar
        reference_width: scalar
        friction: scalar
        memory_length: scalar
        curvature_saturation: scalar
        local_weight: scalar
        upstream_weight: scalar
        scale_local: int
        scale_upstream: int
        end_damping: scalar
        slope_threshold: scalar
        freest: scalar

    @wp.struct
    class Terms:
        """What the terms of the rate weigh in a channel in this sub-step.

        ``sinuosity`` is the factor sigma^(-2/3), ``root`` the root r of the smoothing at the widest point, ``reach``
        the number of points after which r^n is lost. In a link, ``fade`` is what a segment leaves of the memory, where
        width and depth do not vary.
        """

        local: scalar
        upstream: scalar
        sinuosity: scalar
        root: scalar
        fade: scalar
        reach: int

    @wp.struct
    class Memory:
        """What the links of stems hand on, by channel; the arrays are missing where no channel goes on in another one.

        A link turns the upstream mean I and the smoothed velocity u that enter it into A I + B and R u + T I + S, where
        u, T, S are vectors: ``end`` is (B, S) and ``fade`` (A, R, T), of links that have one downstream. ``start`` is
        the (I, u) that enters. ``terms`` is what the terms weigh in a link, ``ends`` how far the ends of its stem are.

        Smoothed upstream, a velocity v that comes from below a link leaves it at its second point as V + G v: ``back``
        is (V, G), and ``tail`` the v that enters a link.
        """

        end: wp.array[vec3]
        fade: wp.array[vec4]
        start: wp.array[vec3]
        back: wp.array[vec3]
        tail: wp.array[vec2]
        terms: wp.array[Terms]
        ends: wp.array[Ends]

    @wp.func(module=name)
    def decay_weights(x: scalar) -> vec3:
        """Weights (q, w0, w1) of I_i = q I_(i-1) + w0 v_(i-1) + w1 v_i over a segment of optical depth x.

        They integrate e^(-x) times a v that is linear on the segment exactly: w1 = 1 - (1 - q)/x, w0 = (1 - q)/x - q.
        """
        if x < SERIES_LIMIT:
            psi = C13
            psi = psi * x + C12
            psi = psi * x + C11
            psi = psi * x + C10
            psi = psi * x + C9
            psi = psi * x + C8
            psi = psi * x + C7
            psi = psi * x + C6
            psi = psi * x + C5
            psi = psi * x + C4
            psi = psi * x + C3
            psi = psi * x + C2
            psi = psi * x + C1
            psi = psi * x + C0
            mean = ONE - x * psi
            return vec3(ONE - x * mean, x * (mean - psi), x * psi)
        q = wp.exp(-x)
        share = (ONE - q) / x
        return vec3(q, share - q, ONE - share)

    @wp.func(module=name)
    def strength_of(width: scalar, constants: MigrationConstants) -> scalar:
        """Rate times radius of a bend, k w; where a reference width W is given k belongs to it: k w^2 / W."""
        if constants.reference_width > ZERO:
            return constants.migration_rate * width * (width / constants.reference_width)
        return constants.migration_rate * width

    @wp.func(module=name)
    def felt_curvature(curvature: scalar, width: scalar, constants: MigrationConstants) -> vec3:
        """Curvature C as the rate feels it, c0 tanh(w C / c0) / w, and its first and second derivative by C.

        It grows no further in bends tighter than w / c0, where the flow no longer follows the bank [Blanckaert2011];
        without a limit c0 it is C itself.
        """
        if constants.curvature_saturation > ZERO:
            scale = width / constants.curvature_saturation
            felt = wp.tanh(scale * curvature)
            slope = ONE - felt * felt
            return vec3(felt / scale, slope, -TWO * scale * felt * slope)
        return vec3(curvature, ONE, ZERO)

    @wp.func(module=name)
    def decay_of(section: vec2, constants: MigrationConstants) -> scalar:
        """Decay alpha of the memory at a width and depth, 1/m: 2 f / d, or by a length in widths, 1 / (L w)."""
        if constants.memory_length > ZERO:
            return ONE / (constants.memory_length * section[0])
        return TWO * constants.friction / section[1]

    @wp.func(module=name)
    def smoothing_root(width: scalar, run: Run, sinuosity: scalar, constants: MigrationConstants) -> scalar:
        """Root r of the implicit fraction of the local term, 0 where the explicit step is stable by itself.

        The local term diffuses with D = k w |omega|. With b = D dt / h^2 the step's factor on the shortest wave of the
        grid is 1 - (16/3) b / (1 + 4 c); c = 8/9 b - 1/4 is the smallest implicit fraction with which it keeps above
        -1/2, so that a kink rings for a few steps at most.
        """
        diffusivity = -constants.local_weight * strength_of(width, constants) * constants.freest
        if constants.scale_local != 0:
            diffusivity = diffusivity * sinuosity
        c = EIGHT_NINTHS * diffusivity * run.step / (run.spacing * run.spacing) - QUARTER
        if not (c > ZERO):
            return ZERO
        return line.recurrence_root(c)

    @wp.func(module=name)
    def segment_depth(points: Points, run: Run, constants: MigrationConstants, i: int, j: int) -> scalar:
        """Optical depth of the segment between two points: the decay, in the mean of both, times its length."""
        before, after = line.section_at(points, i, run), line.section_at(points, j, run)
        if constants.memory_length > ZERO:
            return HALF * run.spacing * (decay_of(before, constants) + decay_of(after, constants))
        return constants.friction * run.spacing * (ONE / before[1] + ONE / after[1])

    @wp.func(module=name)
    def line_sinuosity(point_xy: wp.array[vec2], run: Run) -> scalar:
        """sigma^(-2/3), written (chord / length)^(2/3) so that a channel that returns to its head gives 0."""
        chord = wp.length(point_xy[run.last] - point_xy[run.first])
        return wp.pow(wp.min(chord / (run.spacing * scalar(run.last - run.first)), ONE), TWO_THIRDS)

    @wp.func(module=name)
    def ring_sinuosity(area: wp.int64) -> scalar:
        """sigma^(-2/3) of a ring: sigma is its length over that of the circle of the same area [Hutchinson1957]."""
        fraction = wp.abs(wp.float64(area)) * AREA_PART
        return wp.pow(wp.min(scalar(TWO_64 * wp.sqrt(PI_64 * fraction)), ONE), TWO_THIRDS)

    @wp.func(module=name)
    def length_of_link(channels: Channels, channel: int) -> scalar:
        """Length of a channel, m."""
        return scalar(channels.start[channel + 1] - 1 - channels.start[channel]) * channels.spacing[channel]

    @wp.func(module=name)
    def sinuosity_of(channels: Channels, point_xy: wp.array[vec2], run: Run) -> scalar:
        """sigma^(-2/3) of the river that a channel is part of: the ring, or the stem from its source to its mouth."""
        if run.closed != 0:
            return ring_sinuosity(channels.area[run.channel])
        if run.upper < 0 and run.lower < 0:
            return line_sinuosity(point_xy, run)
        top, bottom = channels.stems.top[run.channel], channels.stems.bottom[run.channel]
        chord = wp.length(point_xy[channels.start[bottom + 1] - 1] - point_xy[channels.start[top]])
        length = scalar(wp.float64(channels.stems.length[top]) * QUANTUM)
        return wp.pow(wp.min(chord / length, ONE), TWO_THIRDS)

    @wp.func(module=name)
    def smoothing_of(channels: Channels, point_xy: wp.array[vec2], run: Run, constants: MigrationConstants) -> Terms:
        """Of the terms of a channel those that the smoothing needs."""
        sinuosity = scalar(1.0)
        if constants.scale_local != 0:
            sinuosity = sinuosity_of(channels, point_xy, run)
        root = smoothing_root(run.form.widest, run, sinuosity, constants)
        return Terms(ZERO, ZERO, sinuosity, root, ONE, line.recurrence_reach(root))

    @wp.func(module=name)
    def terms_of(channels: Channels, point_xy: wp.array[vec2], run: Run, constants: MigrationConstants) -> Terms:
        """What the terms of the rate weigh in the channel of a run."""
        sinuosity = sinuosity_of(channels, point_xy, run)
        local = constants.local_weight
        upstream = constants.upstream_weight
        if constants.scale_local != 0:
            local = local * sinuosity
        if constants.scale_upstream != 0:
            upstream = upstream * sinuosity
        root = smoothing_root(run.form.widest, run, sinuosity, constants)
        fade = scalar(1.0)
        if run.upper >= 0 or run.lower >= 0:
            fade = wp.exp(-run.spacing * decay_of(vec2(run.form.width, run.form.depth), constants))
        return Terms(local, upstream, sinuosity, root, fade, line.recurrence_reach(root))

    @wp.func(module=name)
    def is_felt(channels: Channels, run: Run) -> bool:
        """Tell whether the rates of a channel count in this sub-step: it is active, or the link downstream is."""
        if run.step > ZERO:
            return True
        return run.lower >= 0 and channels.step[wp.max(run.lower, 0)] > ZERO

    @wp.func(module=name)
    def free_ends(channels: Channels, run: Run, constants: MigrationConstants) -> Ends:
        """Ends of a channel that no other goes on from. Where it leaves the map, or enters it, an end is not held."""
        ends = Ends(ZERO, ZERO, ZERO, ZERO, 0, 0)
        if not line.is_fed(channels, run.channel):
            ends.head_reach = constants.end_damping * run.form.width
        if run.edge == EDGE_NONE:
            ends.foot_reach = constants.end_damping * run.form.width
        return ends

    @wp.func(module=name)
    def ends_of(channels: Channels, run: Run, constants: MigrationConstants) -> Ends:
        """How far the ends of its river, or the locked points in it, are from a channel, as far as they are felt."""
        if run.upper < 0 and run.lower < 0:
            return free_ends(channels, run, constants)
        top, bottom = channels.stems.top[run.channel], channels.stems.bottom[run.channel]
        ends = free_ends(channels, line.whole_run(channels, bottom), constants)
        ends.head_reach = constants.end_damping * channels.form[top].width
        link = int(run.channel)
        while link != top and ends.above < ends.head_reach and not line.foot_held(channels, channels.stems.upper[link]):
            link = channels.stems.upper[link]
            ends.above = ends.above + length_of_link(channels, link)
        if line.foot_held(channels, channels.stems.upper[link]):
            ends.head_reach = constants.end_damping * channels.form[link].width
            ends.head_locked = int(ends.head_reach > ZERO)
        elif link == top and line.is_fed(channels, top):
            ends.head_reach = ZERO
        link = int(run.channel)
        while link != bottom and ends.below < ends.foot_reach and not line.foot_held(channels, link):
            link = channels.stems.lower[link]
            ends.below = ends.below + length_of_link(channels, link)
        if line.foot_held(channels, link):
            ends.foot_reach = constants.end_damping * channels.form[link].width
            ends.foot_locked = int(ends.foot_reach > ZERO)
        # A link that was not looked at lies farther away than the end is felt.
        return ends

    @wp.func(module=name)
    def fade_of(
        channels: Channels, points: Points, run: Run, terms: Terms, constants: MigrationConstants, ends: Ends
    ) -> vec4:
        """(A, R, T) of a link, see ``Memory``. Points from which R would not reach its end have no share in T."""
        r, q = scalar(terms.root), scalar(terms.fade)
        begin = run.last - terms.reach
        left = scalar(1.0)
        root = scalar(1.0)
        mixed = vec2(ZERO, ZERO)
        j = int(run.first + 1)
        if begin > j:
            # Beyond that reach R is lost.
            root = ZERO
            if not points.section:
                left = wp.pow(q, scalar(begin - j))
                j = begin
        ends_felt = ends.above < ends.head_reach or ends.below < ends.foot_reach
        while j <= run.last:
            if points.section:
                q = wp.exp(-segment_depth(points, run, constants, j - 1, j))
                r = smoothing_root(points.section[j][0], run, terms.sinuosity, constants)
            left = left * q
            if j >= begin:
                felt = terms.upstream * left
                if ends_felt:
                    felt = felt * line.end_weight(j, run, ends)
                normal = vec2(ZERO, ZERO)
                if j < run.last:
                    normal = line.right_normal(points.xy[j - 1], points.xy[j + 1])
                else:
                    normal = line.normal_at(channels, points.xy, j, run)
                mixed = ((ONE - r) * felt) * normal + r * mixed
                root = root * r
            j += 1
        if line.foot_held(channels, run.channel):
            return vec4(left, ZERO, ZERO, ZERO)
        return vec4(left, root, mixed[0], mixed[1])

    @wp.func(module=name)
    def chained_start(channels: Channels, memory: Memory, run: Run) -> vec3:
        """Upstream mean and smoothed velocity that enter a link: what the links upstream hand on, until all is lost."""
        mean = scalar(1.0)
        root = scalar(1.0)
        mixed = vec2(ZERO, ZERO)
        start = vec3(ZERO, ZERO, ZERO)
        below = int(run.channel)
        link = int(run.upper)
        while link >= 0 and (mean > LOST or root > LOST or wp.length(mixed) > LOST):
            if channels.step[link] == ZERO and channels.step[below] == ZERO:
                # Its velocities were not computed: from here on upstream the river counts as straight.
                return start
            end, fade = memory.end[link], memory.fade[link]
            smoothed = root * vec2(end[1], end[2]) + end[0] * mixed
            start = start + vec3(mean * end[0], smoothed[0], smoothed[1])
            mixed = root * vec2(fade[2], fade[3]) + fade[0] * mixed
            mean = mean * fade[0]
            root = root * fade[1]
            below = link
            link = channels.stems.upper[link]
        return start

    @wp.kernel(module=name, enable_backward=False)
    def measure_stems(
        # network
        channels: Channels,
        # out
        stem_length_io: wp.array[wp.int64],
    ):
        """Length of each stem in quanta, at its top: each channel adds its own."""
        channel = wp.tid()
        if channels.start[channel] < channels.start[channel + 1]:
            quanta = wp.round(wp.float64(length_of_link(channels, channel)) * QUANTA)
            wp.atomic_add(stem_length_io, channels.stems.top[channel], wp.int64(quanta))

    @wp.kernel(module=name, enable_backward=False)
    def chain_links(
        # network
        channels: Channels,
        # params
        constants: MigrationConstants,
        work: Work,
        # out
        memory_io: Memory,
    ):
        """What enters each link from upstream.

        A link hands on (I, u) -> (A I + B, R u + T I + S), so that links are chained without a look at their points.
        """
        channel = wp.tid()
        if work.status[HALT] == 0 and channels.step[channel] > ZERO:
            run = line.whole_run(channels, channel)
            memory_io.start[channel] = chained_start(channels, memory_io, run)

    @wp.func(module=name)
    def foot_velocity(channels: Channels, run: Run, point_velocity: wp.array[vec2], smoothed: vec2) -> vec2:
        """Smoothed velocity at the last point of a channel: where a stem ends it is held, or slides along the edge."""
        if run.lower >= 0 and not line.foot_held(channels, run.channel):
            return smoothed
        velocity = vec2(ZERO, ZERO)
        if run.edge == EDGE_NORTH_SOUTH:
            velocity = vec2(ZERO, point_velocity[run.last][1])
        elif run.edge == EDGE_WEST_EAST:
            velocity = vec2(point_velocity[run.last][0], ZERO)
        return velocity

    @wp.func(module=name)
    def back_of(
        channels: Channels,
        points: Points,
        run: Run,
        terms: Terms,
        constants: MigrationConstants,
        point_velocity: wp.array[vec2],
    ) -> vec3:
        """(V, G) of a link, see ``Memory``, from velocities that are complete, from as far downstream as it counts."""
        r = terms.root
        lowest = wp.min(run.last, run.first + 1 + terms.reach)
        smoothed = vec2(ZERO, ZERO)
        left = wp.where(lowest < run.last, ZERO, ONE)
        for k in range(0, lowest - run.first):
            j = lowest - k
            if points.section:
                r = smoothing_root(points.section[j][0], run, terms.sinuosity, constants)
            smoothed = (ONE - r) * point_velocity[j] + r * smoothed
            left = left * r
            if j == run.last and (run.lower < 0 or line.foot_held(channels, run.channel)):
                smoothed = foot_velocity(channels, run, point_velocity, smoothed)
                left = ZERO
        return vec3(smoothed[0], smoothed[1], left)

    @wp.kernel(module=name, enable_backward=False)
    def add_upstream(
        # network
        channels: Channels,
        points: Points,
        # params
        constants: MigrationConstants,
        work: Work,
        # out
        memory_io: Memory,
        point_velocity_io: wp.array[vec2],
    ):
        """Add to the velocities of each link what enters it, n e gamma I exp(-depth), smoothed downstream alike.

        They are complete then, and what the link hands on upstream is noted.
        """
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            if channels.stems.upper[channel] >= 0 and channels.step[channel] > ZERO:
                run = line.whole_run(channels, channel)
                terms, ends, start = memory_io.terms[channel], memory_io.ends[channel], memory_io.start[channel]
                push = terms.upstream * start[0]
                smoothed = vec2(start[1], start[2])
                faint = FAINT * (wp.abs(push) + wp.abs(start[1]) + wp.abs(start[2]))
                r, q = scalar(terms.root), scalar(terms.fade)
                ends_felt = ends.above < ends.head_reach or ends.below < ends.foot_reach
                point_velocity_io[run.first] = smoothed
                before = points.xy[run.first]
                here = points.xy[run.first + 1]
                j = int(run.first + 1)
                while j <= run.last and wp.abs(push) + wp.abs(smoothed[0]) + wp.abs(smoothed[1]) > faint:
                    if points.section:
                        q = wp.exp(-segment_depth(points, run, constants, j - 1, j))
                        r = smoothing_root(points.section[j][0], run, terms.sinuosity, constants)
                    push = push * q
                    normal = vec2(ZERO, ZERO)
                    after = here
                    if j < run.last:
                        after = points.xy[j + 1]
                        normal = line.right_normal(before, after)
                    else:
                        normal = line.normal_at(channels, points.xy, j, run)
                    felt = push
                    if ends_felt:
                        felt = felt * line.end_weight(j, run, ends)
                    smoothed = ((ONE - r) * felt) * normal + r * smoothed
                    point_velocity_io[j] = point_velocity_io[j] + smoothed
                    before = here
                    here = after
                    j += 1
                memory_io.back[channel] = back_of(channels, points, run, terms, constants, point_velocity_io)

    @wp.kernel(module=name, enable_backward=False)
    def find_tails(
        # network
        channels: Channels,
        # params
        work: Work,
        # out
        memory_io: Memory,
    ):
        """Velocity of the point just downstream of each link, smoothed upstream to there, from as far as it counts.

        A junction is the last point of the link upstream and counts once. Inactive links hold it, and hand nothing on.
        """
        channel = wp.tid()
        if work.status[HALT] != 0 or channels.step[channel] == ZERO:
            return
        tail = vec2(ZERO, ZERO)
        left = scalar(1.0)
        link = int(channels.stems.lower[channel])
        while link >= 0 and left > LOST:
            if channels.step[link] == ZERO:
                left = ZERO
            else:
                back = memory_io.back[link]
                tail = tail + left * vec2(back[0], back[1])
                left = left * back[2]
                link = channels.stems.lower[link]
        memory_io.tail[channel] = tail

    return SimpleNamespace(
        vec2=vec2,
        vec3=vec3,
        vec4=vec4,
        Channels=Channels,
        Points=Points,
        MigrationConstants=MigrationConstants,
        Terms=Terms,
        Memory=Memory,
        Ends=Ends,
        AREA_PARTS=AREA_PARTS,
        decay_weights=decay_weights,
        strength_of=strength_of,
        felt_curvature=felt_curvature,
        decay_of=decay_of,
        segment_depth=segment_depth,
        smoothing_root=smoothing_root,
        smoothing_of=smoothing_of,
        terms_of=terms_of,
        is_felt=is_felt,
        fade_of=fade_of,
        ends_of=ends_of,
        foot_velocity=foot_velocity,
        measure_stems=measure_stems,
        chain_links=chain_links,
        add_upstream=add_upstream,
        find_tails=find_tails,
    )
