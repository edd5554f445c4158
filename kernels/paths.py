"""Meanders by shortest paths, the move: a push by the curvature, blurred along the channel, and a smoothing."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline, raster
from warpriver.kernels.polyline import Work
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of the push for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.paths_{scalar.__name__}"
    line, cells = polyline.build(scalar), raster.build(scalar)
    vec2, vec4, bits = line.vec2, line.vec4, line.bits
    ZERO, ONE, TWO, FOUR = (scalar(v) for v in (0.0, 1.0, 2.0, 4.0))
    PI = scalar(math.pi)

    @wp.struct
    class PathLaw:
        """Scalars of a simulation, from ``PathMeander``; lengths in widths, times in yr."""

        displacement_rate: scalar
        downstream_share: scalar
        blur_length: scalar
        smoothing: scalar
        end_damping: scalar
        slope_threshold: scalar

    @wp.func(module=name)
    def blur_root(width: scalar, spacing: scalar, law: PathLaw) -> scalar:
        """Root of the recurrences that blur the push over the blur length."""
        points = law.blur_length * width / spacing
        return line.recurrence_root(points * points)

    @wp.func(module=name)
    def diffusion_number(width: scalar, spacing: scalar, step: scalar, law: PathLaw) -> scalar:
        """D dt / h^2 of the smoothing, D = S k w."""
        return law.smoothing * law.displacement_rate * width * step / (spacing * spacing)

    @wp.func(module=name)
    def push_at(before: vec2, here: vec2, after: vec2, width: scalar, step: scalar, law: PathLaw) -> vec2:
        """Push of a point in a step: k w (C n + phi |C| t) dt, n to the right of the flow, t down it."""
        a = here - before
        b = after - here
        curvature = line.circle_curvature(a, b, wp.length(a), wp.length(b))
        normal = line.right_normal(before, after)
        tangent = vec2(-normal[1], normal[0])
        size = law.displacement_rate * step * width
        return (size * curvature) * normal + (size * law.downstream_share * wp.abs(curvature)) * tangent

    @wp.func(module=name)
    def warmup_points(form: vec4, spacing: scalar, step: scalar, law: PathLaw) -> int:
        """Number of points after which both recurrences have faded below rounding."""
        r_pull = line.recurrence_root(diffusion_number(form[2], spacing, step, law))
        return wp.max(line.recurrence_reach(blur_root(form[2], spacing, law)), line.recurrence_reach(r_pull))

    @wp.func(module=name)
    def ring_shares(
        point_section: wp.array[vec2], form: vec4, spacing: scalar, step: scalar, law: PathLaw, first: int, last: int
    ) -> vec2:
        """What each recurrence, of the blur and of the smoothing, gains by going once round a ring: 1 - r^n.

        Once round, I = A I + B, so that I = B / (1 - A).
        """
        blur = ONE
        pull = ONE
        width = form[0]
        for i in range(first, last + 1):
            if point_section:
                width = point_section[i][0]
            blur = blur * blur_root(width, spacing, law)
            pull = pull * line.recurrence_root(diffusion_number(width, spacing, step, law))
        return vec2(ONE - blur, ONE - pull)

    @wp.func(module=name)
    def sweep_push(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        form: vec4,
        spacing: scalar,
        step: scalar,
        law: PathLaw,
        first: int,
        last: int,
        closed: int,
        begin: int,
        stop: int,
        point_push_out: wp.array[vec4],
    ):
        """Pushes of the points begin .. stop - 1 of one channel, by one run down it from where the past has faded.

        That may lie more than once round a ring: then one lap is closed over the ring.
        """
        width = form[0]
        r_blur = blur_root(form[2], spacing, law)
        c_pull = diffusion_number(form[2], spacing, step, law)
        r_pull = line.recurrence_root(c_pull)
        warm = begin - warmup_points(form, spacing, step, law)
        count = last - first + 1
        if closed == 0:
            warm = wp.max(first, warm)
        else:
            warm = wp.max(begin - count, warm)
        before = line.extended_point(point_xy, warm - 1, first, last, closed)
        here = line.extended_point(point_xy, warm, first, last, closed)
        push = vec2(ZERO, ZERO)
        pull = vec2(ZERO, ZERO)
        for j in range(warm, stop):
            if j == begin and warm == begin - count:
                shares = ring_shares(point_section, form, spacing, step, law, first, last)
                push = push / shares[0]
                pull = pull / shares[1]
            after = line.extended_point(point_xy, j + 1, first, last, closed)
            if point_section:
                width = point_section[wp.where(j < first, line.round_index(j, first, last), j)][0]
                r_blur = blur_root(width, spacing, law)
                c_pull = diffusion_number(width, spacing, step, law)
                r_pull = line.recurrence_root(c_pull)
            push = (ONE - r_blur) * push_at(before, here, after, width, step, law) + r_blur * push
            pull = ((ONE - r_pull) * c_pull) * ((after - here) - (here - before)) + r_pull * pull
            if j == first and closed == 0:
                push = vec2(ZERO, ZERO)
                pull = vec2(ZERO, ZERO)
            if j >= begin:
                point_push_out[j] = vec4(push[0], push[1], pull[0], pull[1])
            before = here
            here = after

    @wp.kernel(module=name, enable_backward=False)
    def compute_push(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        # params
        law: PathLaw,
        work: Work,
        # out
        point_push_out: wp.array[vec4],
    ):
        """Push by the curvature and pull towards the neighbours' mean, both blurred downstream: (push, pull) in m.

        push = k w (C n + phi |C| t) dt; pull = c d2 p, c = S k w dt / h^2. Half of (1 - (b w)^2 d2/ds2)^-1 push and of
        (1 - c d2)^-1 pull is done here, the way down the channel; ``shift_points`` does the other half. Above the first
        point of a ring lies the ring itself, round and round. Channels whose step is 0 rest and are passed over.
        """
        share = line.point_range(work, channel_start, channel_form.shape[0], work.first + wp.tid())
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            step = channel_step[channel]
            if step > ZERO:
                sweep_push(
                    point_xy, point_section, channel_form[channel], channel_spacing[channel], step, law, first, last,
                    line.closed_at(channel_closed, channel), i, stop, point_push_out,
                )  # fmt: skip
            i = stop
            channel += 1

    @wp.func(module=name)
    def swell_of(count: int, width: scalar, spacing: scalar, step: scalar, law: PathLaw) -> scalar:
        """How far the smoothing pulls in the points of the regular ring of as many points, m.

        It takes 2 pi D dt off the area of any ring; the same way out along the whole ring gives it back [Gage1986].
        """
        c = diffusion_number(width, spacing, step, law)
        sine = wp.sin(PI / scalar(count))
        return TWO * spacing * sine * c / (ONE + FOUR * c * sine * sine)

    @wp.func(module=name)
    def sweep_shift(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        point_push: wp.array[vec4],
        cell_height: wp.array2d[wp.float64],
        grid: cells.RasterGrid,
        form: vec4,
        spacing: scalar,
        step: scalar,
        law: PathLaw,
        swell: scalar,
        first: int,
        last: int,
        closed: int,
        begin: int,
        stop: int,
        point_moved_out: wp.array[vec2],
        section_moved_out: wp.array[vec2],
    ) -> scalar:
        """Move the points begin .. stop - 1 of one channel, running up it; return how far the farthest goes, m.

        ``swell``: how far the points of a ring go to the right besides.
        """
        farthest = scalar(0.0)
        r_blur = blur_root(form[2], spacing, law)
        r_pull = line.recurrence_root(diffusion_number(form[2], spacing, step, law))
        top = stop - 1 + warmup_points(form, spacing, step, law)
        count = last - first + 1
        if closed == 0:
            top = wp.min(last, top)
        else:
            top = wp.min(stop - 1 + count, top)
        push = vec2(ZERO, ZERO)
        pull = vec2(ZERO, ZERO)
        for k in range(0, top - begin + 1):
            if top - k == stop - 1 and top == stop - 1 + count:
                shares = ring_shares(point_section, form, spacing, step, law, first, last)
                push = push / shares[0]
                pull = pull / shares[1]
            j = wp.where(top - k > last, line.round_index(top - k, first, last), top - k)
            if point_section:
                width = point_section[j][0]
                r_blur = blur_root(width, spacing, law)
                r_pull = line.recurrence_root(diffusion_number(width, spacing, step, law))
            both = point_push[j]
            push = (ONE - r_blur) * vec2(both[0], both[1]) + r_blur * push
            pull = (ONE - r_pull) * vec2(both[2], both[3]) + r_pull * pull
            if j == last and closed == 0:
                push = vec2(ZERO, ZERO)
                pull = vec2(ZERO, ZERO)
            if top - k < stop:
                moved = point_xy[j]
                if closed != 0 or (j > first and j < last):
                    weight = ONE
                    if closed == 0:
                        weight = line.end_weight(j, first, last, spacing, law.end_damping * form[0])
                    shift = weight * push + pull
                    if closed != 0:
                        before = line.extended_point(point_xy, j - 1, first, last, closed)
                        after = line.extended_point(point_xy, j + 1, first, last, closed)
                        shift = shift + swell * line.right_normal(before, after)
                    if cell_height:
                        shift = cells.slope_weight(cell_height, grid, moved, law.slope_threshold) * shift
                    farthest = wp.max(farthest, wp.length(shift))
                    moved = moved + shift
                point_moved_out[j] = moved
                if point_section:
                    section_moved_out[j] = point_section[j]
        return farthest

    @wp.kernel(module=name, enable_backward=False)
    def shift_points(
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
        law: PathLaw,
        work: Work,
        # in
        point_push: wp.array[vec4],
        # out
        point_moved_out: wp.array[vec2],
        section_moved_out: wp.array[vec2],
        channel_pace_io: wp.array[bits],
    ):
        """Finish the blur upstream and move: p += g (e push + pull); the two ends of a channel stay.

        e fades to 0 at both ends of a channel, g with the slope of the terrain, if there is one. On a ring e is 1, and
        all its points go outward by what the smoothing pulls them in on average, so that it keeps the area. The points
        of a channel whose step is 0 stay.
        """
        share = line.point_range(work, channel_start, channel_form.shape[0], work.first + wp.tid())
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            step = channel_step[channel]
            if step > ZERO:
                spacing = channel_spacing[channel]
                closed = line.closed_at(channel_closed, channel)
                swell = scalar(0.0)
                if closed != 0:
                    swell = swell_of(last - first + 1, channel_form[channel][0], spacing, step, law)
                    if channel_area[channel] < wp.int64(0):
                        swell = -swell
                farthest = sweep_shift(
                    point_xy, point_section, point_push, cell_height, grid, channel_form[channel], spacing, step, law,
                    swell, first, last, closed, i, stop, point_moved_out, section_moved_out,
                )  # fmt: skip
                wp.atomic_max(channel_pace_io, channel, wp.cast(farthest / step, bits))
            else:
                line.copy_points(point_xy, point_section, i, stop, point_moved_out, section_moved_out)
            i = stop
            channel += 1

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        PathLaw=PathLaw,
        RasterGrid=cells.RasterGrid,
        compute_push=compute_push,
        shift_points=shift_points,
    )
