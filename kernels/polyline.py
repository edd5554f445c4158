"""Functions on packed polylines that the kernels of several processes share."""

import functools
from types import SimpleNamespace

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Work:
    """How the points of a network are dealt out to the threads of a launch.

    A thread takes a *slab*, the whole channels slab_channel[k] .. slab_channel[k + 1] - 1, or, where ``chunk`` is not
    0, that many consecutive points. ``first`` is the slab or chunk of the launch's first thread.
    """

    slab_channel: wp.array[int]
    chunk: int
    first: int


@functools.cache
def build(scalar):
    """Make the shared polyline functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.polyline_{scalar.__name__}"
    vec2, vec4 = wp.types.vector(2, scalar), wp.types.vector(4, scalar)
    ZERO, TWO, THREE = scalar(0.0), scalar(2.0), scalar(3.0)
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
    def point_range(work: Work, channel_start: wp.array[int], channel_count: int, k: int) -> wp.vec3i:
        """Points of a slab or chunk as (first, stop, channel of the first); empty beyond the last one."""
        if work.chunk == 0:
            channel = work.slab_channel[k]
            return wp.vec3i(channel_start[channel], channel_start[work.slab_channel[k + 1]], channel)
        i = k * work.chunk
        stop = wp.min(i + work.chunk, channel_start[channel_count])
        if i >= stop:
            return wp.vec3i(stop, stop, 0)
        return wp.vec3i(i, stop, channel_at(channel_start, channel_count, i))

    @wp.func(module=name)
    def channel_range(work: Work, k: int) -> wp.vec2i:
        """Channels (first, stop) of a thread that works on whole channels: those of its slab, or one."""
        if work.chunk == 0:
            return wp.vec2i(work.slab_channel[k], work.slab_channel[k + 1])
        return wp.vec2i(k, k + 1)

    @wp.func(module=name)
    def section_at(point_section: wp.array[vec2], i: int, form: vec4) -> vec2:
        """Width and depth at a point: its own where they vary along the channel, else the channel's."""
        if point_section:
            return point_section[i]
        return vec2(form[0], form[1])

    @wp.func(module=name)
    def closed_at(channel_closed: wp.array[int], channel: int) -> int:
        """1 where a channel is a ring, else 0; without the array there are no rings."""
        if channel_closed:
            return channel_closed[channel]
        return 0

    @wp.func(module=name)
    def round_index(i: int, first: int, last: int) -> int:
        """Point of a ring that an index beyond either end comes round to."""
        count = last - first + 1
        away = (i - first) % count
        if away < 0:
            away += count
        return first + away

    @wp.func(module=name)
    def extended_point(point_xy: wp.array[vec2], i: int, first: int, last: int, closed: int) -> vec2:
        """Point i of a channel; beyond an end a ring goes round, and a line on as its point reflection: straight."""
        if closed != 0 and (i < first or i > last):
            return point_xy[round_index(i, first, last)]
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

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        channel_at=channel_at,
        point_range=point_range,
        channel_range=channel_range,
        section_at=section_at,
        closed_at=closed_at,
        round_index=round_index,
        extended_point=extended_point,
        circle_curvature=circle_curvature,
        central_tangent=central_tangent,
        fourth_order_tangent=fourth_order_tangent,
    )
