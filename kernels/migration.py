"""Meander migration: the rate from local and upstream curvature, and the move [Howard1984, Paris2023]."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline, raster
from warpriver.kernels.channels import Work
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the migration kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.migration_{scalar.__name__}"
    line, cells = polyline.build(scalar), raster.build(scalar)
    vec2, vec3, bits = line.vec2, wp.types.vector(3, scalar), line.bits
    Channels, Points, Run, Ground = line.Channels, line.Points, line.Run, cells.Ground
    ZERO, HALF, ONE, TWO = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0))
    SIXTH, TWELFTH, EIGHT_NINTHS, QUARTER = (scalar(v) for v in (1.0 / 6.0, 1.0 / 12.0, 8.0 / 9.0, 0.25))
    TWO_THIRDS = scalar(2.0 / 3.0)
    REACH = line.REACH
    SERIES_LIMIT = scalar(0.5)
    # Areas of rings are added up in 2^-62 of the squared length, as integers, so that the order does not matter. The
    # greatest, that of a circle, is 1 / (4 pi) of it.
    AREA_PARTS, AREA_PART = wp.float64(2.0**62), wp.float64(2.0**-62)
    HALF_64, TWO_64, PI_64 = (wp.float64(v) for v in (0.5, 2.0, math.pi))
    # 1/2 - x/6 + x^2/24 - ...: below the limit the first term left out is under 1e-16.
    factorial, SERIES = 2.0, []
    for term in range(14):
        SERIES.append((-1.0) ** term / factorial)
        factorial *= term + 3
    C0, C1, C2, C3, C4, C5, C6, C7, C8, C9, C10, C11, C12, C13 = (scalar(c) for c in SERIES)

    @wp.struct
    class MigrationConstants:
        """Constants of a simulation, from ``MeanderParams``; lengths in m, times in yr."""

        migration_rate: scalar
        reference_width: scalar
        friction: scalar
        local_weight: scalar
        upstream_weight: scalar
        scale_local: int
        scale_upstream: int
        end_damping: scalar
        slope_threshold: scalar

    @wp.struct
    class Terms:
        """What the terms of the rate weigh in a channel in this sub-step.

        ``sinuosity`` is the factor sigma^(-2/3), ``root`` the root r of the smoothing at the widest point.
        """

        local: scalar
        upstream: scalar
        sinuosity: scalar
        root: scalar

    @wp.struct
    class Sweep:
        """A sweep down a channel over the points warm .. stop - 1, whose rates count from ``begin`` on.

        At ``head`` the mean of what lies upstream and the smoothed rate are ``upstream`` and ``smoothed``.
        """

        warm: int
        head: int
        begin: int
        stop: int
        upstream: scalar
        smoothed: scalar

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
    def smoothing_root(width: scalar, run: Run, sinuosity: scalar, constants: MigrationConstants) -> scalar:
        """Root r of the implicit fraction of the local term, 0 where the explicit step is stable by itself.

        The local term diffuses with D = k w |omega|. With b = D dt / h^2 the step's factor on the shortest wave of the
        grid is 1 - (16/3) b / (1 + 4 c); c = 8/9 b - 1/4 is the smallest implicit fraction with which it keeps above
        -1/2, so that a kink rings for a few steps at most.
        """
        diffusivity = -constants.local_weight * strength_of(width, constants)
        if constants.scale_local != 0:
            diffusivity = diffusivity * sinuosity
        c = EIGHT_NINTHS * diffusivity * run.step / (run.spacing * run.spacing) - QUARTER
        if not (c > ZERO):
            return ZERO
        return line.recurrence_root(c)

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

    @wp.kernel(module=name, enable_backward=False)
    def measure_rings(
        # network
        channels: Channels,
        point_xy: wp.array[vec2],
        # params
        work: Work,
        # out
        channel_area_io: wp.array[wp.int64],
    ):
        """Area that each ring encloses, positive to the left of the flow, in 2^-62 of its length squared.

        A = sum (p_i - p_0) x (p_(i+1) - p_0) / 2. Each thread adds what its points give; inactive rings are skipped.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.closed != 0 and run.step > ZERO:
                total = wp.float64(0.0)
                here = point_xy[run.begin] - point_xy[run.first]
                for j in range(run.begin, run.stop):
                    after = line.extended_point(point_xy, j + 1, run) - point_xy[run.first]
                    total += wp.float64(here[0]) * wp.float64(after[1]) - wp.float64(here[1]) * wp.float64(after[0])
                    here = after
                length = wp.float64(run.spacing) * wp.float64(run.last - run.first + 1)
                fraction = HALF_64 * total / (length * length)
                wp.atomic_add(channel_area_io, run.channel, wp.int64(wp.round(fraction * AREA_PARTS)))

    @wp.func(module=name)
    def segment_depth(points: Points, run: Run, friction: scalar, i: int, j: int) -> scalar:
        """Optical depth of the segment between two points: alpha = 2 f / d, in the mean of both, times its length."""
        return (
            friction
            * run.spacing
            * (ONE / line.section_at(points, i, run)[1] + ONE / line.section_at(points, j, run)[1])
        )

    @wp.func(module=name)
    def warmup_start(points: Points, run: Run, friction: scalar) -> int:
        """First point upstream of a run whose weight in it is lost in rounding, or the channel's head."""
        if not points.section:
            # Compared as a real number: it may be far beyond the integers.
            reach = REACH * run.form.depth / (TWO * friction * run.spacing)
            if reach < scalar(run.begin - run.first):
                return run.begin - int(reach) - 1
            return run.first
        i = int(run.begin)
        depth = scalar(0.0)
        while i > run.first and depth < REACH:
            depth += segment_depth(points, run, friction, i - 1, i)
            i -= 1
        return i

    @wp.func(module=name)
    def ring_warmup(points: Points, run: Run, friction: scalar, begin: int):
        """Index upstream of ``begin``, once round at most, whose weight there is lost in rounding, and its depth."""
        i = int(begin)
        depth = scalar(0.0)
        while i > begin - (run.last - run.first + 1) and depth < REACH:
            after = line.round_index(i, run)
            i -= 1
            before = line.round_index(i, run)
            depth += segment_depth(points, run, friction, before, after)
        return i, depth

    @wp.func(module=name)
    def ring_fade(points: Points, run: Run, terms: Terms, constants: MigrationConstants, lap: int) -> scalar:
        """Fraction of the smoothing's sum that is left of it once round the ring; 0 where less than a lap counts."""
        if lap < run.last - run.first + 1:
            return ZERO
        fade = scalar(1.0)
        for i in range(run.first, run.last + 1):
            if points.section:
                fade = fade * smoothing_root(points.section[i][0], run, terms.sinuosity, constants)
            else:
                fade = fade * terms.root
        return fade

    @wp.func(module=name)
    def sweep_rate(
        points: Points,
        run: Run,
        terms: Terms,
        constants: MigrationConstants,
        sweep: Sweep,
        point_rate_out: wp.array[scalar],
    ) -> vec2:
        """Rates of a channel's points by one sweep down it; returns (upstream, smoothed) at its end.

        The points are evenly spaced, so that a segment's optical depth needs no chord.
        """
        r = terms.root
        before = line.extended_point(points.xy, sweep.warm - 1, run)
        here = line.extended_point(points.xy, sweep.warm, run)
        after = line.extended_point(points.xy, sweep.warm + 1, run)
        a = before - line.extended_point(points.xy, sweep.warm - 2, run)
        b = here - before
        c = after - here
        lb = wp.length(b)
        lc = wp.length(c)
        k0 = line.circle_curvature(a, b, wp.length(a), lb)
        k1 = line.circle_curvature(b, c, lb, lc)
        section = vec2(run.form.width, run.form.depth)
        if points.section:
            section = points.section[line.round_index(sweep.warm, run)]
        memory_before = TWO * constants.friction / section[1]
        # Where width and depth do not vary along the channel, these are the same at every point.
        memory = memory_before
        strength = strength_of(section[0], constants)
        q = decay_weights(memory * run.spacing)
        value_before = scalar(0.0)
        upstream = scalar(0.0)
        smoothed = scalar(0.0)
        for j in range(sweep.warm, sweep.stop):
            ahead = line.extended_point(points.xy, j + 2, run)
            d = ahead - after
            ld = wp.length(d)
            k2 = line.circle_curvature(c, d, lc, ld)
            change = k0 - TWO * k1 + k2
            if points.section:
                k = int(j)
                if j < run.first:
                    k = line.round_index(j, run)
                section = points.section[k]
                r = smoothing_root(section[0], run, terms.sinuosity, constants)
                memory = TWO * constants.friction / section[1]
                strength = strength_of(section[0], constants)
                q = decay_weights(HALF * (memory_before + memory) * run.spacing)
            # The linear quadrature and the 3-point curvature each lose a twelfth of the second difference.
            value = strength * (k1 - SIXTH * change)
            upstream = q[0] * upstream + q[1] * value_before + q[2] * value
            rate = terms.local * strength * (k1 - TWELFTH * change) + terms.upstream * upstream
            smoothed = (ONE - r) * rate + r * smoothed
            if j == sweep.head:
                upstream = sweep.upstream
                smoothed = sweep.smoothed
            if j >= sweep.begin:
                point_rate_out[j] = smoothed
            value_before = value
            memory_before = memory
            after = ahead
            c = d
            lc = ld
            k0 = k1
            k1 = k2
        return vec2(upstream, smoothed)

    @wp.func(module=name)
    def ring_sweep(
        points: Points, run: Run, terms: Terms, constants: MigrationConstants, point_rate_out: wp.array[scalar]
    ) -> Sweep:
        """Sweep over a run of a ring: upstream mean and smoothed rate are closed over the ring at its first point.

        Both are recurrences: once round, I = A I + B, so that I = B / (1 - A). A = e^(-depth of the ring) may come
        close to 1: 1 - A is the sum of the weights of a segment of that depth.
        """
        lap = wp.max(1, wp.min(run.last - run.first + 1, line.recurrence_reach(terms.root)))
        origin = run.begin - lap
        warm, depth = ring_warmup(points, run, constants.friction, origin)
        whole = decay_weights(depth)
        # Nothing is written before the sweep itself.
        first_lap = Sweep(warm, warm, origin + 1, origin + 1, ZERO, ZERO)
        upstream = sweep_rate(points, run, terms, constants, first_lap, point_rate_out)[0] / (whole[1] + whole[2])
        second_lap = Sweep(origin, origin, run.begin + 1, run.begin + 1, upstream, ZERO)
        start = sweep_rate(points, run, terms, constants, second_lap, point_rate_out)
        smoothed = start[1] / (ONE - ring_fade(points, run, terms, constants, lap))
        return Sweep(run.begin, run.begin, run.begin, run.stop, start[0], smoothed)

    @wp.func(module=name)
    def line_sweep(points: Points, run: Run, terms: Terms, constants: MigrationConstants) -> Sweep:
        """Sweep over a run of a line, from where what lies farther upstream is lost in rounding."""
        warm = warmup_start(points, run, constants.friction)
        warm = wp.max(run.first, warm - line.recurrence_reach(terms.root))
        return Sweep(warm, run.first, run.begin, run.stop, ZERO, ZERO)

    @wp.func(module=name)
    def terms_of(channels: Channels, point_xy: wp.array[vec2], run: Run, constants: MigrationConstants) -> Terms:
        """What the terms of the rate weigh in the channel of a run."""
        sinuosity = scalar(1.0)
        if run.closed != 0:
            sinuosity = ring_sinuosity(channels.area[run.channel])
        else:
            sinuosity = line_sinuosity(point_xy, run)
        local = constants.local_weight
        upstream = constants.upstream_weight
        if constants.scale_local != 0:
            local = local * sinuosity
        if constants.scale_upstream != 0:
            upstream = upstream * sinuosity
        return Terms(local, upstream, sinuosity, smoothing_root(run.form.widest, run, sinuosity, constants))

    @wp.kernel(module=name, enable_backward=False)
    def compute_rate(
        # network
        channels: Channels,
        points: Points,
        # params
        constants: MigrationConstants,
        work: Work,
        # out
        point_rate_out: wp.array[scalar],
    ):
        """Migration rate in m/yr, positive to the right of the flow, smoothed downstream where the step asks for it.

        mu = omega mu0 + sigma^(-2/3) gamma int mu0(u - z) e^(-alpha z) dz / int e^(-alpha z) dz, mu0 = k w C,
        alpha = 2 f / d; the reach above a channel's head counts as straight [Paris2023, Eq. 2-5], that above the first
        point of a ring is the ring itself, round and round. Inactive channels are skipped.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                terms = terms_of(channels, points.xy, run, constants)
                sweep = Sweep()
                if run.closed != 0:
                    sweep = ring_sweep(points, run, terms, constants, point_rate_out)
                else:
                    sweep = line_sweep(points, run, terms, constants)
                sweep_rate(points, run, terms, constants, sweep, point_rate_out)

    @wp.func(module=name)
    def ring_tail(
        points: Points, point_rate: wp.array[scalar], run: Run, terms: Terms, constants: MigrationConstants
    ) -> scalar:
        """Rate of the point below a run of a ring, smoothed from downstream and closed over the ring."""
        r = terms.root
        lap = wp.min(run.last - run.first + 1, line.recurrence_reach(r))
        smoothed = scalar(0.0)
        for k in range(lap):
            j = line.round_index(run.stop - 1 + lap - k, run)
            if points.section:
                r = smoothing_root(points.section[j][0], run, terms.sinuosity, constants)
            smoothed = (ONE - r) * point_rate[j] + r * smoothed
        return smoothed / (ONE - ring_fade(points, run, terms, constants, lap))

    @wp.func(module=name)
    def sweep_move(
        points: Points,
        point_rate: wp.array[scalar],
        ground: Ground,
        run: Run,
        terms: Terms,
        constants: MigrationConstants,
        moved_out: Points,
    ) -> scalar:
        """Move the points of a run, sweeping up the channel; return the greatest speed, m/yr."""
        r = terms.root
        fastest = scalar(0.0)
        smoothed = scalar(0.0)
        top = int(run.stop - 1)
        if run.closed != 0:
            smoothed = ring_tail(points, point_rate, run, terms, constants)
        else:
            top = wp.min(run.last, run.stop - 1 + line.recurrence_reach(r))
        for k in range(0, top - run.begin + 1):
            j = top - k
            if points.section:
                r = smoothing_root(points.section[j][0], run, terms.sinuosity, constants)
            smoothed = (ONE - r) * point_rate[j] + r * smoothed
            if j == run.last and run.closed == 0:
                smoothed = ZERO
            if j < run.stop:
                moved = points.xy[j]
                if run.closed != 0 or (j > run.first and j < run.last):
                    before = line.extended_point(points.xy, j - 1, run)
                    normal = line.right_normal(before, line.extended_point(points.xy, j + 1, run))
                    weight = ONE
                    if run.closed == 0:
                        weight = line.end_weight(j, run, constants.end_damping * run.form.width)
                    if ground.height:
                        weight = weight * cells.slope_weight(ground, moved, constants.slope_threshold)
                    fastest = wp.max(fastest, wp.abs(smoothed * weight))
                    moved = moved + normal * (smoothed * weight * run.step)
                moved_out.xy[j] = moved
                if points.section:
                    moved_out.section[j] = points.section[j]
        return fastest

    @wp.kernel(module=name, enable_backward=False)
    def move_points(
        # network
        channels: Channels,
        points: Points,
        # terrain
        ground: Ground,
        # params
        constants: MigrationConstants,
        work: Work,
        # in
        point_rate: wp.array[scalar],
        # out
        moved_out: Points,
        channel_pace_io: wp.array[bits],
    ):
        """Finish the smoothing upstream and move: p += n mu g e dt [Paris2023, Eq. 1 and 6].

        e fades to 0 at both ends of a channel and is 1 on a ring, g fades with the slope of the terrain, if there is
        one. The points of inactive channels stay.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                terms = Terms()
                terms.sinuosity = ONE
                if constants.scale_local != 0 and run.closed != 0:
                    terms.sinuosity = ring_sinuosity(channels.area[run.channel])
                elif constants.scale_local != 0:
                    terms.sinuosity = line_sinuosity(points.xy, run)
                terms.root = smoothing_root(run.form.widest, run, terms.sinuosity, constants)
                fastest = sweep_move(points, point_rate, ground, run, terms, constants, moved_out)
                wp.atomic_max(channel_pace_io, run.channel, wp.cast(fastest, bits))
            else:
                line.copy_run(points, run, moved_out)

    return SimpleNamespace(
        vec2=vec2,
        Channels=Channels,
        Form=line.Form,
        Points=Points,
        MigrationConstants=MigrationConstants,
        measure_rings=measure_rings,
        compute_rate=compute_rate,
        move_points=move_points,
    )
