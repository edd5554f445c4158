"""Meanders by shortest paths, the move: a push by the curvature, blurred along the channel, and a smoothing."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import ground as grounds
from warpriver.kernels import polyline
from warpriver.kernels.channels import Work
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of the push for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.paths_{scalar.__name__}"
    line, land = polyline.build(scalar), grounds.build(scalar)
    vec2, vec4, bits = line.vec2, wp.types.vector(4, scalar), line.bits
    Channels, Points, Run, Ground = line.Channels, line.Points, line.Run, land.Ground
    ZERO, ONE, TWO, FOUR = (scalar(v) for v in (0.0, 1.0, 2.0, 4.0))
    PI = scalar(math.pi)

    @wp.struct
    class PathConstants:
        """Constants of a simulation, from ``PathMeander``; lengths in widths, times in yr."""

        displacement_rate: scalar
        downstream_share: scalar
        blur_length: scalar
        smoothing: scalar
        end_damping: scalar
        slope_threshold: scalar

    @wp.func(module=name)
    def blur_root(width: scalar, run: Run, constants: PathConstants) -> scalar:
        """Root of the recurrences that blur the push over the blur length."""
        points = constants.blur_length * width / run.spacing
        return line.recurrence_root(points * points)

    @wp.func(module=name)
    def diffusion_number(width: scalar, run: Run, constants: PathConstants) -> scalar:
        """D dt / h^2 of the smoothing, D = S k w."""
        spacing = run.spacing
        return constants.smoothing * constants.displacement_rate * width * run.step / (spacing * spacing)

    @wp.func(module=name)
    def push_at(before: vec2, here: vec2, after: vec2, width: scalar, step: scalar, constants: PathConstants) -> vec2:
        """Push of a point in a step: k w (C n + phi |C| t) dt, n to the right of the flow, t down it."""
        a = here - before
        b = after - here
        curvature = line.circle_curvature(a, b, wp.length(a), wp.length(b))
        normal = line.right_normal(before, after)
        tangent = vec2(-normal[1], normal[0])
        size = constants.displacement_rate * step * width
        return (size * curvature) * normal + (size * constants.downstream_share * wp.abs(curvature)) * tangent

    @wp.func(module=name)
    def warmup_points(run: Run, constants: PathConstants) -> int:
        """Number of points after which both recurrences have faded below rounding."""
        widest = run.form.widest
        r_pull = line.recurrence_root(diffusion_number(widest, run, constants))
        return wp.max(line.recurrence_reach(blur_root(widest, run, constants)), line.recurrence_reach(r_pull))

    @wp.func(module=name)
    def ring_gains(points: Points, run: Run, constants: PathConstants) -> vec2:
        """What each recurrence, of the blur and of the smoothing, gains by going once round a ring: 1 - r^n.

        Once round, I = A I + B, so that I = B / (1 - A).
        """
        blur = ONE
        pull = ONE
        width = run.form.width
        for i in range(run.first, run.last + 1):
            if points.section:
                width = points.section[i][0]
            blur = blur * blur_root(width, run, constants)
            pull = pull * line.recurrence_root(diffusion_number(width, run, constants))
        return vec2(ONE - blur, ONE - pull)

    @wp.func(module=name)
    def sweep_push(points: Points, run: Run, constants: PathConstants, point_push_out: wp.array[vec4]):
        """Pushes of the points of a run, by one sweep down the channel from where the past has faded.

        That may lie more than once round a ring: then one lap is closed over the ring.
        """
        width = run.form.width
        r_blur = blur_root(run.form.widest, run, constants)
        c_pull = diffusion_number(run.form.widest, run, constants)
        r_pull = line.recurrence_root(c_pull)
        warm = run.begin - warmup_points(run, constants)
        count = run.last - run.first + 1
        if run.closed == 0:
            warm = wp.max(run.first, warm)
        else:
            warm = wp.max(run.begin - count, warm)
        before = line.extended_point(points.xy, warm - 1, run)
        here = line.extended_point(points.xy, warm, run)
        push = vec2(ZERO, ZERO)
        pull = vec2(ZERO, ZERO)
        for j in range(warm, run.stop):
            if j == run.begin and warm == run.begin - count:
                gains = ring_gains(points, run, constants)
                push = push / gains[0]
                pull = pull / gains[1]
            after = line.extended_point(points.xy, j + 1, run)
            if points.section:
                width = points.section[wp.where(j < run.first, line.round_index(j, run), j)][0]
                r_blur = blur_root(width, run, constants)
                c_pull = diffusion_number(width, run, constants)
                r_pull = line.recurrence_root(c_pull)
            push = (ONE - r_blur) * push_at(before, here, after, width, run.step, constants) + r_blur * push
            pull = ((ONE - r_pull) * c_pull) * ((after - here) - (here - before)) + r_pull * pull
            if j == run.first and run.closed == 0:
                push = vec2(ZERO, ZERO)
                pull = vec2(ZERO, ZERO)
            if j >= run.begin:
                point_push_out[j] = vec4(push[0], push[1], pull[0], pull[1])
            before = here
            here = after

    @wp.kernel(module=name, enable_backward=False)
    def compute_push(
        # network
        channels: Channels,
        points: Points,
        # params
        constants: PathConstants,
        work: Work,
        # out
        point_push_out: wp.array[vec4],
    ):
        """Push by the curvature and pull towards the neighbours' mean, both blurred downstream: (push, pull) in m.

        push = k w (C n + phi |C| t) dt; pull = c d2 p, c = S k w dt / h^2. Half of (1 - (b w)^2 d2/ds2)^-1 push and of
        (1 - c d2)^-1 pull is done here, the way down the channel; ``shift_points`` does the other half. Above the first
        point of a ring lies the ring itself, round and round. Inactive channels are skipped.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                sweep_push(points, run, constants, point_push_out)

    @wp.func(module=name)
    def swell_of(channels: Channels, run: Run, constants: PathConstants) -> scalar:
        """How far the points of a ring have to go to the right so that it keeps its area, m; 0 on a line.

        The smoothing takes 2 pi D dt off the area of any ring. What it pulls in the points of the regular ring of as
        many gives that back [Gage1986].
        """
        if run.closed == 0:
            return ZERO
        c = diffusion_number(run.form.width, run, constants)
        sine = wp.sin(PI / scalar(run.last - run.first + 1))
        swell = TWO * run.spacing * sine * c / (ONE + FOUR * c * sine * sine)
        if channels.area[run.channel] < wp.int64(0):
            swell = -swell
        return swell

    @wp.func(module=name)
    def sweep_shift(
        points: Points,
        point_push: wp.array[vec4],
        ground: Ground,
        run: Run,
        constants: PathConstants,
        swell: scalar,
        moved_out: Points,
    ) -> scalar:
        """Move the points of a run, sweeping up the channel; return how far the farthest goes, m.

        ``swell``: how far the points of a ring go to the right besides.
        """
        farthest = scalar(0.0)
        reach = constants.end_damping * run.form.width
        ends = line.Ends(ZERO, reach, ZERO, reach, 0, 0)
        r_blur = blur_root(run.form.widest, run, constants)
        r_pull = line.recurrence_root(diffusion_number(run.form.widest, run, constants))
        top = run.stop - 1 + warmup_points(run, constants)
        count = run.last - run.first + 1
        if run.closed == 0:
            top = wp.min(run.last, top)
        else:
            top = wp.min(run.stop - 1 + count, top)
        push = vec2(ZERO, ZERO)
        pull = vec2(ZERO, ZERO)
        for k in range(0, top - run.begin + 1):
            if top - k == run.stop - 1 and top == run.stop - 1 + count:
                gains = ring_gains(points, run, constants)
                push = push / gains[0]
                pull = pull / gains[1]
            j = wp.where(top - k > run.last, line.round_index(top - k, run), top - k)
            if points.section:
                width = points.section[j][0]
                r_blur = blur_root(width, run, constants)
                r_pull = line.recurrence_root(diffusion_number(width, run, constants))
            both = point_push[j]
            push = (ONE - r_blur) * vec2(both[0], both[1]) + r_blur * push
            pull = (ONE - r_pull) * vec2(both[2], both[3]) + r_pull * pull
            if j == run.last and run.closed == 0:
                push = vec2(ZERO, ZERO)
                pull = vec2(ZERO, ZERO)
            if top - k < run.stop:
                moved = points.xy[j]
                if run.closed != 0 or (j > run.first and j < run.last):
                    weight = line.end_weight(j, run, ends)
                    shift = weight * push + pull
                    block = land.block_at(ground.steering, moved)
                    if run.closed != 0 or block != ONE:
                        before = line.extended_point(points.xy, j - 1, run)
                        after = line.extended_point(points.xy, j + 1, run)
                        normal = line.right_normal(before, after)
                        shift = shift + swell * normal
                        if block != ONE:
                            floor = ground.steering.floor * constants.displacement_rate * run.step
                            drawn = land.control_pull(ground.steering, moved, normal, wp.dot(push, normal), floor)
                            shift = shift + weight * drawn
                    shift = land.freedom_at(ground, moved, constants.slope_threshold, block) * shift
                    farthest = wp.max(farthest, wp.length(shift))
                    moved = moved + shift
                moved_out.xy[j] = moved
                if points.section:
                    moved_out.section[j] = points.section[j]
        return farthest

    @wp.kernel(module=name, enable_backward=False)
    def shift_points(
        # network
        channels: Channels,
        points: Points,
        # terrain
        ground: Ground,
        # params
        constants: PathConstants,
        work: Work,
        # in
        point_push: wp.array[vec4],
        # out
        moved_out: Points,
        channel_max_speed_io: wp.array[bits],
    ):
        """Finish the blur upstream and move: p += g (e (push + drawn) + pull); the two ends of a channel stay.

        e fades to 0 at both ends of a channel, g with the slope of the terrain, if there is one, and with damping;
        ``drawn`` is what controls do, as in migration with the push along the normal as the rate. On a ring e is 1, and
        all its points go outward by what the smoothing pulls them in on average, so that it keeps the area. The points
        of inactive channels stay.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                swell = swell_of(channels, run, constants)
                farthest = sweep_shift(points, point_push, ground, run, constants, swell, moved_out)
                wp.atomic_max(channel_max_speed_io, run.channel, wp.cast(farthest / run.step, bits))
            else:
                line.copy_run(points, run, moved_out)

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        PathConstants=PathConstants,
        compute_push=compute_push,
        shift_points=shift_points,
    )
