"""Functions on packed polylines that the kernels of several processes share."""

import functools
from types import SimpleNamespace

import warp as wp

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the shared polyline functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.polyline_{scalar.__name__}"
    vec2, vec4 = wp.types.vector(2, scalar), wp.types.vector(4, scalar)
    ZERO, ONE, TWO, THREE, FOUR = (scalar(v) for v in (0.0, 1.0, 2.0, 3.0, 4.0))
    # Beyond this many e-foldings a weight is lost in the rounding of the sum.
    REACH = scalar(40.0 if scalar is wp.float64 else 18.0)
    TINY = scalar(1.0e-30)  # m; a length that keeps 0 / 0 away

    @wp.func(module=name)
    def channel_at(channel_start: wp.array[int], channel_count: int, point: int) -> int:
        """Channel that owns a point: the last one that starts at or before it."""
        low = int(0)
        high = channel_count
        while high - low > 1:
            middle = (low + high) // 2
            if channel_start[middle] <= point:
                low = middle
            else:
                high = middle
        return low

    @wp.func(module=name)
    def section_at(point_section: wp.array[vec2], i: int, form: vec4) -> vec2:
        """Width and depth at a point: its own where they vary along the channel, else the channel's."""
        if point_section:
            return point_section[i]
        return vec2(form[0], form[1])

    @wp.func(module=name)
    def extended_point(point_xy: wp.array[vec2], i: int, first: int, last: int) -> vec2:
        """Point i of a channel; beyond an end the line goes on as its point reflection, so ends are straight."""
        if i < first:
            return TWO * point_xy[first] - point_xy[2 * first - i]
        if i > last:
            return TWO * point_xy[last] - point_xy[2 * last - i]
        return point_xy[i]

    @wp.func(module=name)
    def circle_curvature(a: vec2, b: vec2, la: scalar, lb: scalar) -> scalar:
        """Curvature of the circle through three points that are joined by a and b, of lengths la and lb; left > 0."""
        scale = la * lb * wp.length(a + b)
        if scale > ZERO:
            return TWO * (a[0] * b[1] - a[1] * b[0]) / scale
        return ZERO

    @wp.func(module=name)
    def central_tangent(a: vec2, b: vec2, la: scalar, lb: scalar) -> vec2:
        """First derivative by arc length where segments a and b meet (three points, uneven spacing)."""
        if la == ZERO or lb == ZERO:
            return (a + b) / wp.max(la + lb, TINY)
        return (a * (lb / la) + b * (la / lb)) / (la + lb)

    @wp.func(module=name)
    def fourth_order_tangent(before: vec2, here: vec2, after: vec2, la: scalar, lb: scalar) -> vec2:
        """First derivative to fourth order: the central one less h^2/6 times its own second derivative."""
        if la + lb == ZERO:
            return here
        return here - (la * (after - here) - lb * (here - before)) / (THREE * (la + lb))

    @wp.func(module=name)
    def arc_at(point_arc: wp.array[wp.float64], chunk_offset: wp.array[wp.float64], chunk: int, i: int) -> wp.float64:
        """Arc length of a point since the start of the packed array; ``chunk_offset`` is an inclusive sum."""
        k = i // chunk
        if k == 0:
            return point_arc[i]
        return chunk_offset[k - 1] + point_arc[i]

    @wp.func(module=name)
    def recurrence_root(c: scalar) -> scalar:
        """Root r with which (1 - c d2)^-1, d2 the second difference, is one recurrence down and one up the line.

        Each is u_i = (1 - r) v_i + r u_(i-1), i counted in its own direction; c = r / (1 - r)^2.
        """
        return TWO * c / (ONE + TWO * c + wp.sqrt(ONE + FOUR * c))

    @wp.func(module=name)
    def recurrence_reach(r: scalar) -> int:
        """Number of points after which r^n is lost in rounding."""
        if r == ZERO:
            return 0
        return int(REACH / -wp.log(r)) + 1

    @wp.func(module=name)
    def end_weight(i: int, first: int, last: int, spacing: scalar, reach: scalar) -> scalar:
        """Smoothstep of the distance along the channel to its nearer end, 0 there and 1 from ``reach`` on."""
        away = scalar(wp.min(i - first, last - i)) * spacing
        if away >= reach:
            return ONE
        t = away / reach
        return t * t * (THREE - TWO * t)

    @wp.func(module=name)
    def right_normal(before: vec2, after: vec2) -> vec2:
        """Unit normal to the right of the flow; none where the line turns back on itself."""
        t = after - before
        size = wp.length(t)
        if size == ZERO:
            return vec2(ZERO, ZERO)
        return vec2(t[1], -t[0]) / size

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        channel_at=channel_at,
        section_at=section_at,
        extended_point=extended_point,
        circle_curvature=circle_curvature,
        central_tangent=central_tangent,
        fourth_order_tangent=fourth_order_tangent,
        arc_at=arc_at,
        recurrence_root=recurrence_root,
        recurrence_reach=recurrence_reach,
        end_weight=end_weight,
        right_normal=right_normal,
        REACH=REACH,
    )
