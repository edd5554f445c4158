"""Meander migration: the rate from local and upstream curvature, and the move [Howard1984, Paris2023]."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline, raster
from warpriver.kernels.polyline import Work
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
    vec2, vec3, vec4, bits = line.vec2, wp.types.vector(3, scalar), line.vec4, line.bits
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
    class MigrationLaw:
        """Scalars of a simulation, from ``MeanderParams``; lengths in m, times in yr."""

        migration_rate: scalar
        reference_width: scalar
        friction: scalar
        local_weight: scalar
        upstream_weight: scalar
        scale_local: int
        scale_upstream: int
        end_damping: scalar
        slope_threshold: scalar

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
    def strength_of(width: scalar, law: MigrationLaw) -> scalar:
        """Rate times radius of a bend, k w; where a reference width W is given k belongs to it: k w^2 / W."""
        if law.reference_width > ZERO:
            return law.migration_rate * width * (width / law.reference_width)
        return law.migration_rate * width

    @wp.func(module=name)
    def smoothing_root(widest: scalar, spacing: scalar, factor: scalar, step: scalar, law: MigrationLaw) -> scalar:
        """Root r of the implicit share of the local term, 0 where the explicit step is stable by itself.

        The local term diffuses with D = k w |omega|. With b = D dt / h^2 the step's factor on the shortest wave of the
        grid is 1 - (16/3) b / (1 + 4 c); c = 8/9 b - 1/4 is the least implicit share with which it keeps above -1/2, so
        that a kink rings for a few steps at most.
        """
        diffusivity = -law.local_weight * strength_of(widest, law)
        if law.scale_local != 0:
            diffusivity = diffusivity * factor
        c = EIGHT_NINTHS * diffusivity * step / (spacing * spacing) - QUARTER
        if not (c > ZERO):
            return ZERO
        return line.recurrence_root(c)

    @wp.func(module=name)
    def sinuosity_factor(point_xy: wp.array[vec2], first: int, last: int, spacing: scalar) -> scalar:
        """sigma^(-2/3), written (chord / length)^(2/3) so that a channel that returns to its head gives 0."""
        chord = wp.length(point_xy[last] - point_xy[first])
        return wp.pow(wp.min(chord / (spacing * scalar(last - first)), ONE), TWO_THIRDS)

    @wp.func(module=name)
    def ring_factor(area: wp.int64) -> scalar:
        """sigma^(-2/3) of a ring: sigma is its length over that of the circle of the same area [Hutchinson1957]."""
        part = wp.abs(wp.float64(area)) * AREA_PART
        return wp.pow(wp.min(scalar(TWO_64 * wp.sqrt(PI_64 * part)), ONE), TWO_THIRDS)

    @wp.kernel(module=name, enable_backward=False)
    def measure_rings(
        # network
        point_xy: wp.array[vec2],
        channel_start: wp.array[int],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        # params
        work: Work,
        # out
        channel_area_io: wp.array[wp.int64],
    ):
        """Area that each ring encloses, positive to the left of the flow, in 2^-62 of its length squared.

        A = sum (p_i - p_0) x (p_(i+1) - p_0) / 2. Each thread adds what its points give; rings at rest are passed over.
        """
        share = line.point_range(work, channel_start, channel_spacing.shape[0], work.first + wp.tid())
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            if channel_closed[channel] != 0 and channel_step[channel] > ZERO:
                total = wp.float64(0.0)
                here = point_xy[i] - point_xy[first]
                for j in range(i, stop):
                    after = line.extended_point(point_xy, j + 1, first, last, 1) - point_xy[first]
                    total += wp.float64(here[0]) * wp.float64(after[1]) - wp.float64(here[1]) * wp.float64(after[0])
                    here = after
                length = wp.float64(channel_spacing[channel]) * wp.float64(last - first + 1)
                part = HALF_64 * total / (length * length)
                wp.atomic_add(channel_area_io, channel, wp.int64(wp.round(part * AREA_PARTS)))
            i = stop
            channel += 1

    @wp.func(module=name)
    def segment_depth(
        point_section: wp.array[vec2], form: vec4, friction: scalar, spacing: scalar, i: int, j: int
    ) -> scalar:
        """Optical depth of the segment between two points: alpha = 2 f / d, in the mean of both, times its length."""
        return (
            friction
            * spacing
            * (ONE / line.section_at(point_section, i, form)[1] + ONE / line.section_at(point_section, j, form)[1])
        )

    @wp.func(module=name)
    def warmup_start(
        point_section: wp.array[vec2], form: vec4, friction: scalar, spacing: scalar, first: int, begin: int
    ) -> int:
        """First point upstream of ``begin`` whose weight there is lost in rounding, or the channel's head."""
        if not point_section:
            # Compared as a real number: it may be far beyond the integers.
            reach = REACH * form[1] / (TWO * friction * spacing)
            if reach < scalar(begin - first):
                return begin - int(reach) - 1
            return first
        i = begin
        depth = scalar(0.0)
        while i > first and depth < REACH:
            depth += segment_depth(point_section, form, friction, spacing, i - 1, i)
            i -= 1
        return i

    @wp.func(module=name)
    def ring_warmup(
        point_section: wp.array[vec2], form: vec4, friction: scalar, spacing: scalar, first: int, last: int, begin: int
    ):  # fmt: skip
        """Index upstream of ``begin``, once round at most, whose weight there is lost in rounding, and its depth."""
        i = int(begin)
        depth = scalar(0.0)
        while i > begin - (last - first + 1) and depth < REACH:
            after = line.round_index(i, first, last)
            i -= 1
            before = line.round_index(i, first, last)
            depth += segment_depth(point_section, form, friction, spacing, before, after)
        return i, depth

    @wp.func(module=name)
    def ring_fade(
        point_section: wp.array[vec2], r: scalar, smoothing: vec3, law: MigrationLaw, first: int, last: int, lap: int
    ) -> scalar:
        """Part of the smoothing's sum that is left of it once round the ring; 0 where less than a lap counts."""
        if lap < last - first + 1:
            return ZERO
        fade = scalar(1.0)
        for i in range(first, last + 1):
            if point_section:
                fade = fade * smoothing_root(point_section[i][0], smoothing[0], smoothing[1], smoothing[2], law)
            else:
                fade = fade * r
        return fade

    @wp.func(module=name)
    def sweep_rate(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        form: vec4,
        law: MigrationLaw,
        weight: vec3,
        smoothing: vec3,
        first: int,
        last: int,
        closed: int,
        warm: int,
        head: int,
        start: vec2,
        begin: int,
        stop: int,
        point_rate_out: wp.array[scalar],
    ) -> vec2:
        """Rates of the points begin .. stop - 1 of one channel, by one run down it from ``warm``.

        weight = (factor of the local term, factor of the upstream term, root r of the smoothing at the widest point);
        smoothing = (spacing, sinuosity factor, time step), from which r follows where the width varies; the points are
        evenly spaced, so that a segment's optical depth needs no chord. At ``head`` the upstream mean and the smoothed
        rate are those of ``start``; returns both as they are at the end.
        """
        r = weight[2]
        before = line.extended_point(point_xy, warm - 1, first, last, closed)
        here = line.extended_point(point_xy, warm, first, last, closed)
        after = line.extended_point(point_xy, warm + 1, first, last, closed)
        a = before - line.extended_point(point_xy, warm - 2, first, last, closed)
        b = here - before
        c = after - here
        lb = wp.length(b)
        lc = wp.length(c)
        k0 = line.circle_curvature(a, b, wp.length(a), lb)
        k1 = line.circle_curvature(b, c, lb, lc)
        section = vec2(form[0], form[1])
        if point_section:
            section = point_section[line.round_index(warm, first, last)]
        memory_before = TWO * law.friction / section[1]
        # Where width and depth do not vary along the channel, these are the same at every point.
        memory = memory_before
        strength = strength_of(section[0], law)
        q = decay_weights(memory * smoothing[0])
        value_before = scalar(0.0)
        upstream = scalar(0.0)
        smoothed = scalar(0.0)
        for j in range(warm, stop):
            ahead = line.extended_point(point_xy, j + 2, first, last, closed)
            d = ahead - after
            ld = wp.length(d)
            k2 = line.circle_curvature(c, d, lc, ld)
            change = k0 - TWO * k1 + k2
            if point_section:
                k = int(j)
                if j < first:
                    k = line.round_index(j, first, last)
                section = point_section[k]
                r = smoothing_root(section[0], smoothing[0], smoothing[1], smoothing[2], law)
                memory = TWO * law.friction / section[1]
                strength = strength_of(section[0], law)
                q = decay_weights(HALF * (memory_before + memory) * smoothing[0])
            # The linear quadrature and the 3-point curvature each lose a twelfth of the second difference.
            value = strength * (k1 - SIXTH * change)
            upstream = q[0] * upstream + q[1] * value_before + q[2] * value
            rate = weight[0] * strength * (k1 - TWELFTH * change) + weight[1] * upstream
            smoothed = (ONE - r) * rate + r * smoothed
            if j == head:
                upstream = start[0]
                smoothed = start[1]
            if j >= begin:
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
    def ring_start(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        form: vec4,
        law: MigrationLaw,
        weight: vec3,
        smoothing: vec3,
        first: int,
        last: int,
        begin: int,
        point_rate_out: wp.array[scalar],
    ) -> vec2:
        """Upstream mean and smoothed rate at a point of a ring, each closed over the ring.

        Both are recurrences: once round, I = A I + B, so that I = B / (1 - A). A = e^(-depth of the ring) may come
        close to 1: 1 - A is the sum of the weights of a segment of that depth.
        """
        lap = wp.max(1, wp.min(last - first + 1, line.recurrence_reach(weight[2])))
        origin = begin - lap
        warm, depth = ring_warmup(point_section, form, law.friction, smoothing[0], first, last, origin)
        state = sweep_rate(
            point_xy, point_section, form, law, weight, smoothing, first, last, 1, warm, warm, vec2(ZERO, ZERO),
            origin + 1, origin + 1, point_rate_out,
        )  # fmt: skip
        whole = decay_weights(depth)
        upstream = state[0] / (whole[1] + whole[2])
        state = sweep_rate(
            point_xy, point_section, form, law, weight, smoothing, first, last, 1, origin, origin, vec2(upstream, ZERO),
            begin + 1, begin + 1, point_rate_out,
        )  # fmt: skip
        return vec2(state[0], state[1] / (ONE - ring_fade(point_section, weight[2], smoothing, law, first, last, lap)))

    @wp.kernel(module=name, enable_backward=False)
    def compute_rate(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        channel_area: wp.array[wp.int64],
        # params
        law: MigrationLaw,
        work: Work,
        # out
        point_rate_out: wp.array[scalar],
    ):
        """Migration rate in m/yr, positive to the right of the flow, smoothed downstream where the step asks for it.

        mu = omega mu0 + sigma^(-2/3) gamma int mu0(u - z) e^(-alpha z) dz / int e^(-alpha z) dz, mu0 = k w C,
        alpha = 2 f / d; the reach above a channel's head counts as straight [Paris2023, Eq. 2-5], that above the first
        point of a ring is the ring itself, round and round. Channels whose step is 0 rest and are passed over.
        """
        share = line.point_range(work, channel_start, channel_form.shape[0], work.first + wp.tid())
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            form = channel_form[channel]
            spacing = channel_spacing[channel]
            step = channel_step[channel]
            if step > ZERO:
                closed = line.closed_at(channel_closed, channel)
                factor = scalar(1.0)
                if closed != 0:
                    factor = ring_factor(channel_area[channel])
                else:
                    factor = sinuosity_factor(point_xy, first, last, spacing)
                local = law.local_weight
                upstream = law.upstream_weight
                if law.scale_local != 0:
                    local = local * factor
                if law.scale_upstream != 0:
                    upstream = upstream * factor
                weight = vec3(local, upstream, smoothing_root(form[2], spacing, factor, step, law))
                smoothing = vec3(spacing, factor, step)
                warm = int(i)
                head = int(first)
                start = vec2(ZERO, ZERO)
                if closed != 0:
                    head = i
                    start = ring_start(
                        point_xy, point_section, form, law, weight, smoothing, first, last, i, point_rate_out
                    )
                else:
                    warm = warmup_start(point_section, form, law.friction, spacing, first, i)
                    warm = wp.max(first, warm - line.recurrence_reach(weight[2]))
                sweep_rate(
                    point_xy, point_section, form, law, weight, smoothing, first, last, closed, warm, head, start, i,
                    stop, point_rate_out,
                )  # fmt: skip
            i = stop
            channel += 1

    @wp.func(module=name)
    def ring_tail(
        point_section: wp.array[vec2],
        point_rate: wp.array[scalar],
        law: MigrationLaw,
        reach: vec4,
        factor: scalar,
        first: int,
        last: int,
        stop: int,
    ) -> scalar:
        """Rate of the point ``stop`` of a ring, smoothed from downstream and closed over the ring; see sweep_move."""
        r = reach[0]
        lap = wp.min(last - first + 1, line.recurrence_reach(r))
        smoothed = scalar(0.0)
        for k in range(lap):
            j = line.round_index(stop - 1 + lap - k, first, last)
            if point_section:
                r = smoothing_root(point_section[j][0], reach[1], factor, reach[3], law)
            smoothed = (ONE - r) * point_rate[j] + r * smoothed
        smoothing = vec3(reach[1], factor, reach[3])
        return smoothed / (ONE - ring_fade(point_section, reach[0], smoothing, law, first, last, lap))

    @wp.func(module=name)
    def sweep_move(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        point_rate: wp.array[scalar],
        cell_height: wp.array2d[wp.float64],
        grid: cells.RasterGrid,
        law: MigrationLaw,
        reach: vec4,
        factor: scalar,
        first: int,
        last: int,
        closed: int,
        begin: int,
        stop: int,
        point_moved_out: wp.array[vec2],
        section_moved_out: wp.array[vec2],
    ) -> scalar:
        """Move the points begin .. stop - 1 of one channel, running up it; return the greatest speed, m/yr.

        reach = (root r of the smoothing at the widest point, spacing, damped length, time step); factor is that of
        sinuosity.
        """
        r = reach[0]
        fastest = scalar(0.0)
        smoothed = scalar(0.0)
        top = int(stop - 1)
        if closed != 0:
            smoothed = ring_tail(point_section, point_rate, law, reach, factor, first, last, stop)
        else:
            top = wp.min(last, stop - 1 + line.recurrence_reach(r))
        for k in range(0, top - begin + 1):
            j = top - k
            if point_section:
                r = smoothing_root(point_section[j][0], reach[1], factor, reach[3], law)
            smoothed = (ONE - r) * point_rate[j] + r * smoothed
            if j == last and closed == 0:
                smoothed = ZERO
            if j < stop:
                moved = point_xy[j]
                if closed != 0 or (j > first and j < last):
                    before = line.extended_point(point_xy, j - 1, first, last, closed)
                    normal = line.right_normal(before, line.extended_point(point_xy, j + 1, first, last, closed))
                    weight = ONE
                    if closed == 0:
                        weight = line.end_weight(j, first, last, reach[1], reach[2])
                    if cell_height:
                        weight = weight * cells.slope_weight(cell_height, grid, moved, law.slope_threshold)
                    fastest = wp.max(fastest, wp.abs(smoothed * weight))
                    moved = moved + normal * (smoothed * weight * reach[3])
                point_moved_out[j] = moved
                if point_section:
                    section_moved_out[j] = point_section[j]
        return fastest

    @wp.kernel(module=name, enable_backward=False)
    def move_points(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        channel_area: wp.array[wp.int64],
        # terrain
        cell_height: wp.array2d[wp.float64],
        grid: cells.RasterGrid,
        # params
        law: MigrationLaw,
        work: Work,
        # in
        point_rate: wp.array[scalar],
        # out
        point_moved_out: wp.array[vec2],
        section_moved_out: wp.array[vec2],
        channel_pace_io: wp.array[bits],
    ):
        """Finish the smoothing upstream and move: p += n mu g e dt [Paris2023, Eq. 1 and 6].

        e fades to 0 at both ends of a channel and is 1 on a ring, g fades with the slope of the terrain, if there is
        one. The points of a channel whose step is 0 stay.
        """
        share = line.point_range(work, channel_start, channel_form.shape[0], work.first + wp.tid())
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            form = channel_form[channel]
            spacing = channel_spacing[channel]
            step = channel_step[channel]
            if step > ZERO:
                closed = line.closed_at(channel_closed, channel)
                factor = ONE
                if law.scale_local != 0 and closed != 0:
                    factor = ring_factor(channel_area[channel])
                elif law.scale_local != 0:
                    factor = sinuosity_factor(point_xy, first, last, spacing)
                r = smoothing_root(form[2], spacing, factor, step, law)
                reach = vec4(r, spacing, law.end_damping * form[0], step)
                fastest = sweep_move(
                    point_xy, point_section, point_rate, cell_height, grid, law, reach, factor, first, last, closed,
                    i, stop, point_moved_out, section_moved_out,
                )  # fmt: skip
                wp.atomic_max(channel_pace_io, channel, wp.cast(fastest, bits))
            else:
                line.copy_points(point_xy, point_section, i, stop, point_moved_out, section_moved_out)
            i = stop
            channel += 1

    return SimpleNamespace(
        vec2=vec2,
        vec3=vec3,
        vec4=vec4,
        MigrationLaw=MigrationLaw,
        measure_rings=measure_rings,
        RasterGrid=cells.RasterGrid,
        compute_rate=compute_rate,
        move_points=move_points,
    )
