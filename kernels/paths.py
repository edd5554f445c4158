"""Meanders by shortest paths, the move: a push by the curvature, blurred along the channel, and a smoothing."""

import functools
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline, raster
from warpriver.kernels.polyline import Work

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the kernels of the push for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.paths_{scalar.__name__}"
    line, cells = polyline.build(scalar), raster.build(scalar)
    vec2, vec4 = line.vec2, line.vec4
    ZERO, ONE = scalar(0.0), scalar(1.0)

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
    def sweep_push(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        form: vec4,
        spacing: scalar,
        step: scalar,
        law: PathLaw,
        first: int,
        last: int,
        begin: int,
        stop: int,
        point_push_out: wp.array[vec4],
    ):
        """Pushes of the points begin .. stop - 1 of one channel, by one run down it from where the past has faded."""
        width = form[0]
        widest = form[2]
        r_blur = blur_root(widest, spacing, law)
        c_pull = diffusion_number(widest, spacing, step, law)
        r_pull = line.recurrence_root(c_pull)
        warm = wp.max(first, begin - wp.max(line.recurrence_reach(r_blur), line.recurrence_reach(r_pull)))
        before = line.extended_point(point_xy, warm - 1, first, last, 0)
        here = point_xy[warm]
        push = vec2(ZERO, ZERO)
        pull = vec2(ZERO, ZERO)
        for j in range(warm, stop):
            after = line.extended_point(point_xy, j + 1, first, last, 0)
            if point_section:
                width = point_section[j][0]
                r_blur = blur_root(width, spacing, law)
                c_pull = diffusion_number(width, spacing, step, law)
                r_pull = line.recurrence_root(c_pull)
            push = (ONE - r_blur) * push_at(before, here, after, width, step, law) + r_blur * push
            pull = ((ONE - r_pull) * c_pull) * ((after - here) - (here - before)) + r_pull * pull
            if j == first:
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
        # params
        law: PathLaw,
        work: Work,
        # out
        point_push_out: wp.array[vec4],
    ):
        """Push by the curvature and pull towards the neighbours' mean, both blurred downstream: (push, pull) in m.

        push = k w (C n + phi |C| t) dt; pull = c d2 p, c = S k w dt / h^2. Half of (1 - (b w)^2 d2/ds2)^-1 push and of
        (1 - c d2)^-1 pull is done here, the way down the channel; ``shift_points`` does the other half. Channels whose
        step is 0 rest and are passed over.
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
                    i, stop, point_push_out,
                )  # fmt: skip
            i = stop
            channel += 1

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
        first: int,
        last: int,
        begin: int,
        stop: int,
        point_moved_out: wp.array[vec2],
        section_moved_out: wp.array[vec2],
    ) -> scalar:
        """Move the points begin .. stop - 1 of one channel, running up it; return how far the farthest goes, m."""
        farthest = scalar(0.0)
        r_blur = blur_root(form[2], spacing, law)
        r_pull = line.recurrence_root(diffusion_number(form[2], spacing, step, law))
        top = wp.min(last, stop - 1 + wp.max(line.recurrence_reach(r_blur), line.recurrence_reach(r_pull)))
        push = vec2(ZERO, ZERO)
        pull = vec2(ZERO, ZERO)
        for k in range(0, top - begin + 1):
            j = top - k
            if point_section:
                width = point_section[j][0]
                r_blur = blur_root(width, spacing, law)
                r_pull = line.recurrence_root(diffusion_number(width, spacing, step, law))
            both = point_push[j]
            push = (ONE - r_blur) * vec2(both[0], both[1]) + r_blur * push
            pull = (ONE - r_pull) * vec2(both[2], both[3]) + r_pull * pull
            if j == last:
                push = vec2(ZERO, ZERO)
                pull = vec2(ZERO, ZERO)
            if j < stop:
                moved = point_xy[j]
                if j > first and j < last:
                    shift = line.end_weight(j, first, last, spacing, law.end_damping * form[0]) * push + pull
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
        channel_pace_io: wp.array[scalar],
    ):
        """Finish the blur upstream and move: p += g (e push + pull); the two ends of a channel stay.

        e fades to 0 at both ends of a channel, g with the slope of the terrain, if there is one. The points of a
        channel whose step is 0 stay.
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
                farthest = sweep_shift(
                    point_xy, point_section, point_push, cell_height, grid, channel_form[channel],
                    channel_spacing[channel], step, law, first, last, i, stop, point_moved_out, section_moved_out,
                )  # fmt: skip
                wp.atomic_max(channel_pace_io, channel, farthest / step)
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
