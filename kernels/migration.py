"""Meander migration: the rate from local and upstream curvature, and the move [Howard1984, Paris2023]."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import ground as grounds
from warpriver.kernels import memory, polyline
from warpriver.kernels.channels import EDGE_NONE, Work
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the migration kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.migration_{scalar.__name__}"
    line, land, past = polyline.build(scalar), grounds.build(scalar), memory.build(scalar)
    vec2, vec3, bits = line.vec2, line.vec3, line.bits
    Channels, Points, Run, Ground, BankScale = line.Channels, line.Points, line.Run, land.Ground, land.BankScale
    MigrationConstants, Terms, Memory, Ends = past.MigrationConstants, past.Terms, past.Memory, line.Ends
    decay_weights, segment_depth, smoothing_root = past.decay_weights, past.segment_depth, past.smoothing_root
    strength_of, felt_curvature, decay_of = past.strength_of, past.felt_curvature, past.decay_of
    ZERO, QUARTER, HALF, ONE, TWO = (scalar(v) for v in (0.0, 0.25, 0.5, 1.0, 2.0))
    SIXTH, TWELFTH, THIRD, PART = (scalar(v) for v in (1.0 / 6.0, 1.0 / 12.0, 1.0 / 3.0, 1.0 / 36.0))
    # Widths below an inlet over which banks come to differ in strength.
    INLET_REACH = scalar(20.0)
    REACH, AREA_PARTS, HALF_64 = line.REACH, past.AREA_PARTS, wp.float64(0.5)

    @wp.struct
    class Sweep:
        """A sweep down a channel over the points warm .. stop - 1, whose velocities count from ``begin`` on.

        At ``head`` the mean of what lies upstream and the smoothed velocity are ``upstream`` and ``smoothed``.
        ``whole``: the sum of the weights of once round a ring.
        """

        warm: int
        head: int
        begin: int
        stop: int
        upstream: scalar
        smoothed: vec2
        whole: scalar

    @wp.struct
    class Velocities:
        """Velocities that have still to be smoothed upstream: ``point`` by point, ``tail`` as in ``Memory``."""

        point: wp.array[vec2]
        tail: wp.array[vec2]

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
    def warmup_start(points: Points, run: Run, constants: MigrationConstants) -> int:
        """First point upstream of a run whose weight in it is lost in rounding, or the channel's head."""
        if not points.section:
            # Compared as a real number: it may be far beyond the integers.
            reach = REACH / (decay_of(vec2(run.form.width, run.form.depth), constants) * run.spacing)
            if reach < scalar(run.begin - run.first):
                return run.begin - int(reach) - 1
            return run.first
        i = int(run.begin)
        depth = scalar(0.0)
        while i > run.first and depth < REACH:
            depth += segment_depth(points, run, constants, i - 1, i)
            i -= 1
        return i

    @wp.func(module=name)
    def ring_warmup(points: Points, run: Run, constants: MigrationConstants, begin: int):
        """Index upstream of ``begin``, once round at most, whose weight there is lost in rounding, and its depth."""
        i = int(begin)
        depth = scalar(0.0)
        while i > begin - (run.last - run.first + 1) and depth < REACH:
            after = line.round_index(i, run)
            i -= 1
            before = line.round_index(i, run)
            depth += segment_depth(points, run, constants, before, after)
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
    def ring_lap(run: Run, terms: Terms) -> int:
        """Points of a ring over which its smoothing is closed."""
        return wp.max(1, wp.min(run.last - run.first + 1, terms.reach))

    @wp.func(module=name)
    def bend_at(channels: Channels, run: Run, j: int, k: vec3) -> vec3:
        """Curvature at a point, to second order, with the second and the first difference, as if evenly spaced.

        Near a junction the stencil reaches into the next link, which has a spacing of its own. A circle through
        segments a, b has the curvature (b - a) / 3 beyond its middle, plus (a^2 + a b + b^2) / 36 times the second
        derivative there; both are read off the parabola through the three.
        """
        near_head = run.upper >= 0 and j < run.first + 2
        near_foot = run.lower >= 0 and j > run.last - 2
        if not near_head and not near_foot:
            return vec3(k[1], k[0] - TWO * k[1] + k[2], HALF * (k[2] - k[0]))
        h = line.segment_length(channels, run, j - 2)
        a = line.segment_length(channels, run, j - 1)
        b = line.segment_length(channels, run, j)
        x0 = (a - h) * THIRD - a
        x1 = (b - a) * THIRD
        x2 = (line.segment_length(channels, run, j + 1) - b) * THIRD + b
        slope = (k[1] - k[0]) / (x1 - x0)
        second = ((k[2] - k[1]) / (x2 - x1) - slope) / (x2 - x0)
        curvature = k[1] - x1 * (slope - second * x0)
        curvature = curvature - (a * a + a * b + b * b) * PART * (TWO * second)
        change = TWO * second * run.spacing * run.spacing
        return vec3(curvature + TWELFTH * change, change, (slope - second * (x0 + x1)) * run.spacing)

    @wp.func(module=name)
    def straightened(felt: scalar, curvature: scalar, width: scalar, constants: MigrationConstants) -> scalar:
        """Curvature that the local term straightens: what is felt, and all that a radius of one width leaves over.

        If the local term saturated altogether, a bend that is pushed inward would fold where it becomes a point.
        """
        if constants.curvature_saturation > ZERO and wp.abs(curvature) * width > ONE:
            return felt + curvature - wp.sign(curvature) / width
        return felt

    @wp.func(module=name)
    def junction_strength(
        channels: Channels,
        points: Points,
        run: Run,
        j: int,
        strength: scalar,
        bend: vec2,
        constants: MigrationConstants,
    ) -> scalar:
        """Strength of a bend at a point; where the width jumps, at the junction downstream, the mean of both.

        ``bend`` is the curvature and what is straightened of it here; what more or less a link of another width
        straightens counts as strength.
        """
        if j < run.last or run.lower < 0:
            return strength
        width = channels.form[run.lower].width
        if points.section:
            width = points.section[run.foot][0]
        share = scalar(1.0)
        if bend[1] != ZERO:
            felt = felt_curvature(bend[0], width, constants)[0]
            share = straightened(felt, bend[0], width, constants) / bend[1]
        return HALF * (strength + share * strength_of(width, constants))

    @wp.func(module=name)
    def remembered(bend: vec3, felt: vec3, constants: MigrationConstants) -> scalar:
        """Curvature that goes into the memory, for ``bend`` of ``bend_at`` and what is felt of it, by its derivatives.

        The linear quadrature and the 3-point curvature each lose a twelfth of a second difference, the one of what is
        felt, the other of the curvature.
        """
        if constants.curvature_saturation > ZERO:
            return felt[0] - TWELFTH * (felt[1] * bend[1] + felt[2] * bend[2] * bend[2])
        return bend[0] - SIXTH * bend[1]

    @wp.func(module=name)
    def swept_normal(channels: Channels, point_xy: wp.array[vec2], j: int, run: Run, bend: vec3) -> vec2:
        """Normal at a point of a sweep, which came with its curvature where its neighbours are equally far."""
        if j < run.last or run.lower < 0:
            return vec2(bend[1], bend[2])
        return line.normal_at(channels, point_xy, j, run)

    @wp.func(module=name)
    def sweep_velocity(
        channels: Channels,
        points: Points,
        run: Run,
        terms: Terms,
        constants: MigrationConstants,
        ends: Ends,
        sweep: Sweep,
        point_velocity_out: wp.array[vec2],
    ) -> vec3:
        """Velocities of a channel's points by one sweep down it; returns (upstream, smoothed) at its end.

        The points are evenly spaced, so that a segment's optical depth needs no chord.
        """
        r = terms.root
        before = line.extended_point(points.xy, sweep.warm - 1, run)
        here = line.extended_point(points.xy, sweep.warm, run)
        after = line.extended_point(points.xy, sweep.warm + 1, run)
        a = before - line.extended_point(points.xy, sweep.warm - 2, run)
        b, c = here - before, after - here
        lb = wp.length(b)
        lc = wp.length(c)
        k0 = line.circle_curvature(a, b, wp.length(a), lb)
        k1 = line.circle_bend(b, c, lb, lc)
        section = vec2(run.form.width, run.form.depth)
        if points.section:
            section = points.section[line.round_index(sweep.warm, run)]
        memory_before = decay_of(section, constants)
        # Where width and depth do not vary along the channel, these are the same at every point.
        memory = memory_before
        strength = strength_of(section[0], constants)
        q = decay_weights(memory * run.spacing)
        value_before = scalar(0.0)
        upstream = scalar(0.0)
        smoothed = vec2(ZERO, ZERO)
        for j in range(sweep.warm, sweep.stop):
            ahead = line.extended_point(points.xy, j + 2, run)
            d = ahead - after
            ld = wp.length(d)
            k2 = line.circle_bend(c, d, lc, ld)
            if points.section:
                k = int(j)
                if j < run.first:
                    k = line.round_index(j, run)
                section = points.section[k]
                r = smoothing_root(section[0], run, terms.sinuosity, constants)
                memory = decay_of(section, constants)
                strength = strength_of(section[0], constants)
                q = decay_weights(HALF * (memory_before + memory) * run.spacing)
            bend = bend_at(channels, run, j, vec3(k0, k1[0], k2[0]))
            curvature = bend[0] - TWELFTH * bend[1]
            felt = felt_curvature(curvature, section[0], constants)
            value = strength * remembered(bend, felt, constants)
            upstream = q[0] * upstream + q[1] * value_before + q[2] * value
            bent = vec2(curvature, straightened(felt[0], curvature, section[0], constants))
            local = terms.local * junction_strength(channels, points, run, j, strength, bent, constants)
            if ends.head_locked + ends.foot_locked != 0:
                local = local * line.local_weight(j, run, ends, wp.abs(curvature) * section[0])
            push = terms.upstream * line.end_weight(j, run, ends)
            rate = local * bent[1] + push * upstream
            smoothed = ((ONE - r) * rate) * swept_normal(channels, points.xy, j, run, k1) + r * smoothed
            if j == sweep.head:
                upstream = sweep.upstream
                smoothed = sweep.smoothed
            if j >= sweep.begin:
                point_velocity_out[j] = smoothed
            value_before = value
            memory_before = memory
            after = ahead
            c = d
            lc = ld
            k0 = k1[0]
            k1 = k2
        return vec3(upstream, smoothed[0], smoothed[1])

    @wp.func(module=name)
    def ring_start(points: Points, run: Run, terms: Terms, constants: MigrationConstants) -> Sweep:
        """The first of three sweeps over a ring, for the mean of what lies upstream; the last one writes.

        Upstream mean and smoothed velocity are recurrences: once round, I = A I + B, so that I = B / (1 - A). A =
        e^(-depth of the ring) may come close to 1: 1 - A is the sum of the weights of a segment of that depth.
        """
        origin = run.begin - ring_lap(run, terms)
        warm, depth = ring_warmup(points, run, constants, origin)
        weights = decay_weights(depth)
        return Sweep(warm, warm, origin + 1, origin + 1, ZERO, vec2(ZERO, ZERO), weights[1] + weights[2])

    @wp.func(module=name)
    def ring_sweep(
        points: Points, run: Run, terms: Terms, constants: MigrationConstants, before: Sweep, end: vec3, last: bool
    ) -> Sweep:
        """The sweep that closes the smoothed velocity, then the one that writes; ``end``: of the one before."""
        lap = ring_lap(run, terms)
        if not last:
            origin = run.begin - lap
            return Sweep(
                origin, origin, run.begin + 1, run.begin + 1, end[0] / before.whole, vec2(ZERO, ZERO), before.whole
            )
        smoothed = vec2(end[1], end[2]) / (ONE - ring_fade(points, run, terms, constants, lap))
        return Sweep(run.begin, run.begin, run.begin, run.stop, end[0], smoothed, before.whole)

    @wp.func(module=name)
    def line_sweep(channels: Channels, points: Points, run: Run, terms: Terms, constants: MigrationConstants) -> Sweep:
        """Sweep over a run of a line, from where what lies farther upstream is lost in rounding."""
        warm = warmup_start(points, run, constants)
        warm = wp.max(run.first, warm - terms.reach)
        upstream = scalar(0.0)
        if run.upper < 0 and line.is_fed(channels, run.channel):
            upstream = strength_of(line.section_at(points, run.first, run)[0], constants) * channels.inlet[run.channel]
        return Sweep(warm, run.first, run.begin, run.stop, upstream, vec2(ZERO, ZERO), ONE)

    @wp.kernel(module=name, enable_backward=False)
    def compute_velocity(
        # network
        channels: Channels,
        points: Points,
        # params
        constants: MigrationConstants,
        work: Work,
        # out
        point_velocity_out: wp.array[vec2],
        memory_out: Memory,
    ):
        """Velocity n mu in m/yr, n to the right of the flow, smoothed downstream where the step asks for it.

        mu = omega mu0 + e sigma^(-2/3) gamma int mu0(u - z) e^(-alpha z) dz / int e^(-alpha z) dz, mu0 = k w C or
        k c0 tanh(w C / c0), alpha = 2 f / d or 1 / (L w). e fades to 0 at both ends of a river, so that bends only
        straighten there, and is 1 on a ring. The reach above a channel's head counts as straight [Paris2023, Eq. 2-5],
        unless it is fed, that above the first point of a ring is the ring itself, round and round. Inactive channels
        are skipped.

        A link begins here as if nothing came from the link upstream, and notes what it hands on to the one downstream.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if past.is_felt(channels, run):
                terms = past.terms_of(channels, points.xy, run, constants)
                ends = past.ends_of(channels, run, constants)
                sweep = Sweep()
                left = int(0)
                if run.closed != 0:
                    sweep = ring_start(points, run, terms, constants)
                    left = int(2)
                else:
                    sweep = line_sweep(channels, points, run, terms, constants)
                state = vec3()
                while left >= 0:
                    state = sweep_velocity(channels, points, run, terms, constants, ends, sweep, point_velocity_out)
                    if left > 0:
                        sweep = ring_sweep(points, run, terms, constants, sweep, state, left == 1)
                    left -= 1
                if run.upper >= 0 and run.stop == run.last + 1:
                    memory_out.terms[run.channel] = terms
                    memory_out.ends[run.channel] = ends
                if run.lower >= 0 and run.stop == run.last + 1:
                    if line.foot_held(channels, run.channel):
                        # No displacement goes on through a locked point.
                        state = vec3(state[0], ZERO, ZERO)
                    memory_out.end[run.channel] = state
                    memory_out.fade[run.channel] = past.fade_of(channels, points, run, terms, constants, ends)

    @wp.kernel(module=name, enable_backward=False)
    def resolve_rate(
        # network
        channels: Channels,
        point_xy: wp.array[vec2],
        # params
        work: Work,
        # in
        point_velocity: wp.array[vec2],
        # out
        point_rate_out: wp.array[scalar],
    ):
        """Migration rate mu in m/yr, positive to the right of the flow, from velocities n mu that are not smoothed."""
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if past.is_felt(channels, run):
                for j in range(run.begin, run.stop):
                    normal = line.normal_at(channels, point_xy, j, run)
                    point_rate_out[j] = wp.dot(normal, point_velocity[j])

    @wp.func(module=name)
    def ring_tail(
        points: Points, point_velocity: wp.array[vec2], run: Run, terms: Terms, constants: MigrationConstants
    ) -> vec2:
        """Velocity of the point below a run of a ring, smoothed from downstream and closed over the ring."""
        r = terms.root
        lap = wp.min(run.last - run.first + 1, terms.reach)
        smoothed = vec2(ZERO, ZERO)
        for k in range(lap):
            j = line.round_index(run.stop - 1 + lap - k, run)
            if points.section:
                r = smoothing_root(points.section[j][0], run, terms.sinuosity, constants)
            smoothed = (ONE - r) * point_velocity[j] + r * smoothed
        return smoothed / (ONE - ring_fade(points, run, terms, constants, lap))

    @wp.func(module=name)
    def pull_at(
        points: Points, ground: Ground, run: Run, constants: MigrationConstants, j: int, normal: vec2, rate: scalar
    ) -> vec2:
        """What controls add to the velocity of a point that they reach, m/yr."""
        width = line.section_at(points, j, run)[0]
        floor = ground.steering.floor * strength_of(width, constants) / width
        pull = land.control_pull(ground.steering, points.xy[j], normal, rate, floor)
        if j == run.last and run.edge != EDGE_NONE:
            # Along the edge of the map, as the rate.
            pull = wp.dot(pull, normal) * normal
        return pull

    @wp.func(module=name)
    def easing_lag(run: Run, constants: MigrationConstants) -> int:
        """Points that the local term diffuses past in a step: a second difference over so many is stable."""
        diffused = -constants.local_weight * strength_of(run.form.widest, constants) * run.step
        lag = 1 + int(TWO * wp.sqrt(diffused) / run.spacing)
        if run.closed != 0:
            lag = wp.min(lag, (run.last + 1 - run.first) / 4)
        return lag

    @wp.func(module=name)
    def eased(points: Points, run: Run, constants: MigrationConstants, lag: int, j: int) -> vec2:
        """Velocity with which a bend tighter than its width straightens, m/yr: D d2p/ds2.

        The second difference is over as many points as are diffused past in the step, so that it is stable.
        """
        velocity = vec2(ZERO, ZERO)
        if run.closed == 0:
            lag = wp.min(lag, wp.min(j - run.first, run.last - j))
        before = line.extended_point(points.xy, j - lag, run)
        after = line.extended_point(points.xy, j + lag, run)
        bent = (after - points.xy[j]) - (points.xy[j] - before)
        width = run.form.width
        if points.section:
            width = points.section[j][0]
        arc = scalar(lag) * run.spacing
        if wp.length_sq(bent) * width * width > arc * arc * arc * arc:
            diffused = -constants.local_weight * strength_of(width, constants) * run.step
            velocity = (wp.min(diffused / (arc * arc), QUARTER) / run.step) * bent
        return velocity

    @wp.func(module=name)
    def steered(
        channels: Channels,
        points: Points,
        ground: Ground,
        run: Run,
        constants: MigrationConstants,
        scale: BankScale,
        lag: int,
        j: int,
        velocity: vec2,
    ) -> vec2:
        """Velocity of a point with the pull of controls, which fades at the ends of a river, and what holds it back."""
        block = land.block_at(ground.steering, points.xy[j])
        drawn = velocity
        if block != ONE:
            normal = line.normal_at(channels, points.xy, j, run)
            pull = pull_at(points, ground, run, constants, j, normal, wp.dot(normal, velocity))
            drawn = velocity + line.end_weight(j, run, past.ends_of(channels, run, constants)) * pull
        free = land.freedom_at(ground, points.xy[j], constants.slope_threshold, block)
        if ground.banks.cell_noise:
            factor = land.bank_factor(ground.banks, scale, points.xy[j])
            if run.upper < 0 and line.is_fed(channels, run.channel):
                # Else a head in strong banks would keep out what enters there.
                t = wp.min(scalar(j - run.first) * run.spacing / (INLET_REACH * run.form.width), ONE)
                factor = ONE + t * (factor - ONE)
            free = factor * free
        drawn = free * drawn
        kept = free
        if kept < ONE and block == ONE and j > run.first and j < run.last:
            # Else bends that are pushed against a slope, or strong banks, would be folded there.
            drawn = drawn + (ONE - kept) * eased(points, run, constants, lag, j)
        return drawn

    @wp.func(module=name)
    def sweep_move(
        channels: Channels,
        points: Points,
        velocities: Velocities,
        ground: Ground,
        run: Run,
        terms: Terms,
        constants: MigrationConstants,
        moved_out: Points,
    ) -> scalar:
        """Move the points of a run, sweeping up the channel; return the greatest speed, m/yr."""
        r = terms.root
        # The last point moves where the river goes on, unless it is locked; the first one is the last of the link
        # upstream.
        last = int(run.last)
        if (run.lower < 0 and run.edge == EDGE_NONE) or line.foot_held(channels, run.channel):
            last = run.last - 1
        free = land.is_plain(ground)
        scale = BankScale()
        lag = int(1)
        if not free:
            scale = land.bank_scale(ground.banks, run.form.width)
            lag = easing_lag(run, constants)
        fastest = scalar(0.0)
        smoothed = vec2(ZERO, ZERO)
        top = int(run.stop - 1)
        if run.closed != 0:
            smoothed = ring_tail(points, velocities.point, run, terms, constants)
        else:
            top = wp.min(run.last, run.stop - 1 + terms.reach)
            if top == run.last and run.lower >= 0:
                smoothed = velocities.tail[run.channel]
        for k in range(0, top - run.begin + 1):
            j = top - k
            if points.section:
                r = smoothing_root(points.section[j][0], run, terms.sinuosity, constants)
            smoothed = (ONE - r) * velocities.point[j] + r * smoothed
            if j == run.last and run.closed == 0:
                smoothed = past.foot_velocity(channels, run, velocities.point, smoothed)
            if j < run.stop:
                moved = points.xy[j]
                if run.closed != 0 or (j > run.first and j <= last):
                    velocity = smoothed
                    if not free:
                        velocity = steered(channels, points, ground, run, constants, scale, lag, j, smoothed)
                    fastest = wp.max(fastest, wp.length(velocity))
                    moved = moved + run.step * velocity
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
        velocities: Velocities,
        # out
        moved_out: Points,
        channel_max_speed_io: wp.array[bits],
    ):
        """Finish the smoothing upstream and move: p += ((1 - c d2)^-1 (n mu) + e pull) g dt [Paris2023, Eq. 1, 6, 7].

        What is smoothed is the displacement itself, not its size: neighbours whose normals cross go on together. The
        pull is that of controls, e fades to 0 at both ends of a river and is 1 on a ring, g fades with the slope of the
        terrain, if there is one, and with damping. What slopes hold back straightens by its local term all the same
        where it is bent more tightly than its width. The points of inactive channels stay.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                terms = past.smoothing_of(channels, points.xy, run, constants)
                fastest = sweep_move(channels, points, velocities, ground, run, terms, constants, moved_out)
                wp.atomic_max(channel_max_speed_io, run.channel, wp.cast(fastest, bits))
            else:
                line.copy_run(points, run, moved_out)

    return SimpleNamespace(
        vec2=vec2,
        Channels=Channels,
        Form=line.Form,
        Points=Points,
        MigrationConstants=MigrationConstants,
        Memory=Memory,
        Velocities=Velocities,
        measure_rings=measure_rings,
        compute_velocity=compute_velocity,
        resolve_rate=resolve_rate,
        move_points=move_points,
    )
