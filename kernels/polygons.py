"""Functions on single lines and polygons that the kernels of several processes share: distances and what is inside."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.polygons_{scalar.__name__}"
    vec2 = wp.types.vector(2, scalar)
    ZERO, ONE = scalar(0.0), scalar(1.0)
    FAR, TINY = scalar(2.0**100), scalar(1.0e-30)

    @wp.func(module=name)
    def distance_to_segment(a: vec2, b: vec2, xy: vec2) -> scalar:
        """Distance from a place to a segment, m."""
        along, off = b - a, xy - a
        t = wp.clamp(wp.dot(off, along) / wp.max(wp.dot(along, along), TINY), ZERO, ONE)
        return wp.length(off - t * along)

    @wp.func(module=name)
    def distance_to_line(line_xy: wp.array[vec2], xy: vec2) -> scalar:
        """Distance from a place to a polyline, or to its single point, m."""
        nearest = wp.length(xy - line_xy[0])
        for k in range(1, line_xy.shape[0]):
            nearest = wp.min(nearest, distance_to_segment(line_xy[k - 1], line_xy[k], xy))
        return nearest

    @wp.func(module=name)
    def distance_inside(corner_xy: wp.array[vec2], xy: vec2) -> scalar:
        """Distance from a place in a polygon to its edge, m; 0 outside. The polygon closes by itself."""
        inside = bool(False)
        nearest = scalar(FAR)
        count = corner_xy.shape[0]
        before = corner_xy[count - 1]
        for k in range(count):
            here = corner_xy[k]
            if (before[1] > xy[1]) != (here[1] > xy[1]):
                along = here - before
                if xy[0] < before[0] + (xy[1] - before[1]) / along[1] * along[0]:
                    inside = not inside
            nearest = wp.min(nearest, distance_to_segment(before, here, xy))
            before = here
        if inside:
            return nearest
        return ZERO

    return SimpleNamespace(
        vec2=vec2,
        distance_to_line=distance_to_line,
        distance_inside=distance_inside,
    )
