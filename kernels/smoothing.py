"""Smoothing of channels without shrinking them: passes of Taubin's pair of weights [Taubin1995]."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.channels import Work
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the smoothing kernel for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.smoothing_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2, Channels, Run = line.vec2, line.Channels, line.Run
    ZERO, HALF, ONE, TWO = scalar(0.0), scalar(0.5), scalar(1.0), scalar(2.0)
    PI = scalar(3.14159265358979323846)

    @wp.func(module=name)
    def longest_wave(count: int, closed: int) -> scalar:
        """Eigenvalue K = 1 - cos a of the longest wave: once round a ring, half a wave on a line with held ends."""
        half_angle = PI / scalar(count)
        if closed == 0:
            half_angle = HALF * PI / scalar(count - 1)
        sine = wp.sin(half_angle)
        return TWO * sine * sine

    @wp.func(module=name)
    def is_held(channels: Channels, run: Run, j: int) -> bool:
        """Tell whether a point stays: the end of a line, unless it is free and an active link goes on there."""
        if run.closed != 0 or (j > run.first and j < run.last):
            return False
        link = wp.where(j == run.first, run.upper, run.lower)
        if line.foot_held(channels, wp.where(j == run.first, run.upper, run.channel)):
            return True
        return link < 0 or channels.step[wp.max(link, 0)] == ZERO

    @wp.kernel(module=name, enable_backward=False)
    def smooth_points(
        # network
        channels: Channels,
        # params
        strength: scalar,
        pass_band: scalar,
        swell: int,
        work: Work,
        # in
        point_xy: wp.array[vec2],
        # out
        point_xy_out: wp.array[vec2],
    ):
        """One pass p += w ((p_before + p_after) / 2 - p), with w the strength; where ``swell`` is set, of the way back.

        A wave of eigenvalue K = 1 - cos a (a: its angle from point to point) is multiplied by 1 - w K. The way back has
        1 / w = pass_band - 1 / strength, so that both together give 1 - strength |w| K (K - pass_band): a wave of the
        pass band stays. A band below 0 stands for the channel's longest wave, or for none where it is the link of a
        stem: then none grows, and a circle of even points stays. A junction within a stem goes with both of its links.
        Ends of lines are held; inactive channels are copied.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            weight = strength
            if swell != 0:
                band = pass_band
                if band < ZERO:
                    band = ZERO
                    if run.upper < 0 and run.lower < 0:
                        band = longest_wave(run.last - run.first + 1, run.closed)
                weight = ONE / (band - ONE / strength)
            if run.step == ZERO:
                weight = ZERO
            for j in range(run.begin, run.stop):
                here = point_xy[j]
                if weight != ZERO and not is_held(channels, run, j):
                    before = line.extended_point(point_xy, j - 1, run)
                    after = line.extended_point(point_xy, j + 1, run)
                    here = here + weight * (HALF * (before + after) - here)
                point_xy_out[j] = here

    return SimpleNamespace(vec2=vec2, Channels=Channels, Form=line.Form, smooth_points=smooth_points)
