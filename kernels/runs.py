"""Runs of points that an edit of the network puts into a new order."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import channels
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernel for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.runs_{scalar.__name__}"
    line = channels.build(scalar)
    vec2, Points = line.vec2, line.Points

    @wp.kernel(module=name, enable_backward=False)
    def gather_runs(
        # network
        points: Points,
        # params
        chunk: int,
        # in
        run_begin: wp.array[int],
        run_start: wp.array[int],
        run_scale: wp.array[vec2],
        # out
        moved_out: Points,
    ):
        """Bring runs of points into a new order; width and depth change by the factors of their run."""
        run_count = run_begin.shape[0]
        i = wp.tid() * chunk
        end = wp.min(i + chunk, run_start[run_count])
        if i >= end:
            return
        run = line.channel_at(run_start, i)
        while i < end:
            shift = run_begin[run] - run_start[run]
            stop = wp.min(end, run_start[run + 1])
            for j in range(i, stop):
                moved_out.xy[j] = points.xy[j + shift]
                if points.section:
                    moved_out.section[j] = wp.cw_mul(points.section[j + shift], run_scale[run])
            i = stop
            run += 1

    return SimpleNamespace(vec2=vec2, gather_runs=gather_runs)
