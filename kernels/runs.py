"""Runs of points that an edit of the network puts into a new order."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernel for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.runs_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2 = line.vec2

    @wp.kernel(module=name, enable_backward=False)
    def gather_runs(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        # params
        chunk: int,
        # in
        run_begin: wp.array[int],
        run_start: wp.array[int],
        run_scale: wp.array[vec2],
        # out
        sample_xy_out: wp.array[vec2],
        sample_section_out: wp.array[vec2],
    ):
        """Take runs of points over into a new order; width and depth change by the factors of their run."""
        run_count = run_begin.shape[0]
        i = wp.tid() * chunk
        end = wp.min(i + chunk, run_start[run_count])
        if i >= end:
            return
        run = line.channel_at(run_start, run_count, i)
        while i < end:
            shift = run_begin[run] - run_start[run]
            stop = wp.min(end, run_start[run + 1])
            for j in range(i, stop):
                sample_xy_out[j] = point_xy[j + shift]
                if point_section:
                    sample_section_out[j] = wp.cw_mul(point_section[j + shift], run_scale[run])
            i = stop
            run += 1

    return SimpleNamespace(vec2=vec2, gather_runs=gather_runs)
