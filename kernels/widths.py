"""Widths that vary through bends: the outer bank is eroded, and the inner bank follows with a lag."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.channels import Work
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Power of the depth that the width of a channel at rest goes with along it [Konsoer2013].
DEPTH_POWER = 1.41


@once
def build(scalar):
    """Make the kernel for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.widths_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2, Channels, Points = line.vec2, line.Channels, line.Points
    ZERO, HALF, ONE, POWER = (scalar(v) for v in (0.0, 0.5, 1.0, DEPTH_POWER))

    @wp.struct
    class Widening:
        """Part of the outer bank's loss by which the inner one lags, time in which it makes up for it (yr), cap."""

        lag: scalar
        time: scalar
        widest: scalar

    @wp.kernel(module=name, enable_backward=False)
    def widen_points(
        # network
        channels: Channels,
        points: Points,
        # params
        widening: Widening,
        work: Work,
        # out
        moved_io: Points,
    ):
        """Width of each point after a sub-step, W <- V + (W - V) e^(-dt / T), V = W0 + lag T E, and its place.

        E is the way of the outer bank a year, the one that the law has for the channel; the inner bank follows with
        (1 - lag) E + (W - W0) / T [Parker2011]. The middle of both goes E dt less half of what the width gains. W0 is
        the width of the channel, by the depth where that varies along it; V is ``widest`` W0 at most.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                kept = wp.exp(-run.step / widening.time)
                for j in range(run.begin, run.stop):
                    section = points.section[j]
                    rest = run.form.width * wp.pow(section[1] / run.form.depth, POWER)
                    way = moved_io.xy[j] - points.xy[j]
                    size = wp.length(way)
                    goal = rest + widening.lag * widening.time * size / run.step
                    goal = wp.min(goal, wp.min(widening.widest * rest, wp.max(run.form.widest, rest)))
                    width = goal + kept * (section[0] - goal)
                    if size > ZERO:
                        moved_io.xy[j] = points.xy[j] + (ONE - HALF * (width - section[0]) / size) * way
                    moved_io.section[j] = vec2(width, section[1])

    return SimpleNamespace(vec2=vec2, Channels=Channels, Points=Points, Widening=Widening, widen_points=widen_points)
