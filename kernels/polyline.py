"""Functions on packed polylines that the kernels of several processes share."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import channels
from warpriver.kernels.channels import EDGE_NONE, EDGE_NORTH_SOUTH, Marks, Work
from warpriver.kernels.status import HALT
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@wp.struct
class Links:
    """Shortcuts (i, j) in ascending order, and what each saves in m; at each point how many begin and the first."""

    point_links: wp.array[int]
    point_link: wp.array[int]
    link_from: wp.array[int]
    link_to: wp.array[int]
    link_saving: wp.array[wp.float64]


@once
def build(scalar):
    """Make the shared polyline functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.polyline_{scalar.__name__}"
    base = channels.build(scalar)
    Points, Run = base.Points, base.Run
    vec2, vec4 = base.vec2, wp.types.vector(4, scalar)

    @wp.struct
    class Ends:
        """Distance along the river from a channel to its first and its last point, and how far each end is felt, m."""

        above: scalar
        head_reach: scalar
        below: scalar
        foot_reach: scalar

    # The integers whose order is that of real numbers from 0 on, bit for bit.
    bits = wp.int64 if scalar is wp.float64 else wp.int32
    ZERO, ONE, TWO, THREE, FOUR, THIRD = (scalar(v) for v in (0.0, 1.0, 2.0, 3.0, 4.0, 1.0 / 3.0))
    # Beyond this many e-foldings a weight is lost in the rounding of the sum.
    REACH = scalar(40.0 if scalar is wp.float64 else 18.0)
    TINY = scalar(1.0e-30)  # m; a length that keeps 0 / 0 away
    # Arc lengths are sums of segments that are rounded to whole quanta: they are exact, and so the same however they
    # are dealt out, up to 2^53 quanta, or 2,097 km of a channel.
    ARC_QUANTUM, ROUNDER = wp.float64(2.0**-32), wp.float64(1.5 * 2.0**20)  # m

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
        if work.status[HALT] != 0:
            return wp.vec3i(0, 0, 0)
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
        if work.status[HALT] != 0:
            return wp.vec2i(0, 0)
        if work.chunk == 0:
            return wp.vec2i(work.slab_channel[k], work.slab_channel[k + 1])
        return wp.vec2i(k, k + 1)

    @wp.func(module=name)
    def share_of(work: Work, k: int, i: int) -> int:
        """Chunk that a point belongs to; in slabs the slab k, whose thread asks."""
        if work.chunk == 0:
            return k
        return i // work.chunk

    @wp.func(module=name)
    def piece_count(work: Work, marks: Marks, first: int, stop: int) -> int:
        """Number of pieces of the points first .. stop - 1 for ``piece_range``: the marked chunks, or all as one."""
        if work.chunk == 0:
            return 1
        return marks.place[(stop - 1) // work.chunk + 1] - marks.place[first // work.chunk]

    @wp.func(module=name)
    def piece_range(work: Work, marks: Marks, first: int, stop: int, k: int) -> wp.vec2i:
        """Points of the k-th piece: all of them, or their share of a marked chunk."""
        if work.chunk == 0:
            return wp.vec2i(first, stop)
        c = marks.chunk[marks.place[first // work.chunk] + k]
        return wp.vec2i(wp.max(first, c * work.chunk), wp.min(stop, (c + 1) * work.chunk))

    @wp.func(module=name)
    def old_section_at(point_section: wp.array[vec2], i: int, form: base.Form) -> vec2:
        """Width and depth at a point: its own where they vary along the channel, else the channel's."""
        if point_section:
            return point_section[i]
        return vec2(form.width, form.depth)

    @wp.func(module=name)
    def closed_at(channel_closed: wp.array[int], channel: int) -> int:
        """1 where a channel is a ring, else 0; without the array there are no rings."""
        if channel_closed:
            return channel_closed[channel]
        return 0

    @wp.func(module=name)
    def old_round_index(i: int, first: int, last: int) -> int:
        """Point of a ring that an index beyond either end comes round to."""
        count = last - first + 1
        away = (i - first) % count
        if away < 0:
            away += count
        return first + away

    @wp.func(module=name)
    def mirrored(p: vec2, foot: vec2, edge: int) -> vec2:
        """A point on the other side of the edge of the map that runs through the foot of a channel."""
        if edge == EDGE_NORTH_SOUTH:
            return vec2(TWO * foot[0] - p[0], p[1])
        return vec2(p[0], TWO * foot[1] - p[1])

    @wp.func(module=name)
    def extended_point(point_xy: wp.array[vec2], i: int, run: Run) -> vec2:
        """Point i of a channel; beyond an end that of the link that goes on there, by two segments at most.

        A ring goes round. Where a channel leaves the map its foot is a mirror, so that it leaves at a right angle. Any
        other line goes on straight, as its point reflection.
        """
        if run.closed != 0 and (i < run.first or i > run.last):
            return point_xy[base.round_index(i, run)]
        if i < run.first:
            if run.upper >= 0:
                return point_xy[run.head + i - run.first]
            return TWO * point_xy[run.first] - point_xy[2 * run.first - i]
        if i > run.last:
            if run.lower >= 0:
                return point_xy[run.foot + i - run.last]
            if run.edge != EDGE_NONE:
                return mirrored(point_xy[2 * run.last - i], point_xy[run.last], run.edge)
            return TWO * point_xy[run.last] - point_xy[2 * run.last - i]
        return point_xy[i]

    @wp.func(module=name)
    def old_extended_point(point_xy: wp.array[vec2], i: int, first: int, last: int, closed: int) -> vec2:
        """Point i of a channel; beyond an end a ring goes round, and a line on as its point reflection: straight."""
        if closed != 0 and (i < first or i > last):
            return point_xy[old_round_index(i, first, last)]
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
        whole = la + lb
        if la == ZERO or lb == ZERO:
            return (a + b) / wp.max(whole, TINY)
        # Divisions that need not wait for each other.
        part = ONE / whole
        return a * (lb / la * part) + b * (la / lb * part)

    @wp.func(module=name)
    def fourth_order_tangent(before: vec2, here: vec2, after: vec2, la: scalar, lb: scalar) -> vec2:
        """First derivative to fourth order: the central one less h^2/6 times its own second derivative."""
        whole = la + lb
        if whole == ZERO:
            return here
        part = THIRD / whole
        return here - (la * part * (after - here) - lb * part * (here - before))

    @wp.func(module=name)
    def whole_quanta(length: scalar) -> wp.float64:
        """Length of a segment, m, rounded to whole quanta of arc length: those of the numbers near ``ROUNDER``."""
        return (wp.float64(length) + ROUNDER) - ROUNDER

    @wp.func(module=name)
    def arc_between(
        point_arc: wp.array[wp.float64], chunk_offset: wp.array[wp.int64], chunk: int, i: int, j: int
    ) -> wp.float64:
        """Arc length from point i to point j of one channel, m.

        With chunks ``point_arc`` begins anew in each, and ``chunk_offset`` is the inclusive sum of their quanta.
        """
        arc = point_arc[j] - point_arc[i]
        if chunk > 0:
            quanta = wp.int64(0)
            if j >= chunk:
                quanta = chunk_offset[j // chunk - 1]
            if i >= chunk:
                quanta = quanta - chunk_offset[i // chunk - 1]
            arc += wp.float64(quanta) * ARC_QUANTUM
        return arc

    @wp.func(module=name)
    def arc_at(
        point_arc: wp.array[wp.float64], chunk_offset: wp.array[wp.int64], chunk: int, first: int, i: int
    ) -> wp.float64:
        """Arc length of a point from the first one of its channel, m."""
        if chunk == 0:
            return point_arc[i]
        return arc_between(point_arc, chunk_offset, chunk, first, i)

    @wp.func(module=name)
    def length_of(
        point: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.int64],
        chunk: int,
        first: int,
        last: int,
        closed: int,
    ) -> wp.float64:
        """Length of a channel in m, that of a ring with the segment that closes it."""
        length = arc_at(point_arc, chunk_offset, chunk, first, last)
        if closed != 0:
            length += wp.float64(wp.length(point[first] - point[last]))
        return length

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
    def end_weight(i: int, run: Run, ends: Ends) -> scalar:
        """Smoothstep of a point's distance along the river to its nearer end, 0 there and 1 from the reach on."""
        t = scalar(1.0)
        away = ends.above + scalar(i - run.first) * run.spacing
        if away < ends.head_reach:
            t = away / ends.head_reach
        away = ends.below + scalar(run.last - i) * run.spacing
        if away < ends.foot_reach:
            t = wp.min(t, away / ends.foot_reach)
        return t * t * (THREE - TWO * t)

    @wp.func(module=name)
    def copy_run(points: Points, run: Run, points_out: Points):
        """Copy the points of a run, with their widths and depths where these vary along the channel."""
        for j in range(run.begin, run.stop):
            points_out.xy[j] = points.xy[j]
            if points.section:
                points_out.section[j] = points.section[j]

    @wp.func(module=name)
    def old_end_weight(i: int, first: int, last: int, spacing: scalar, reach: scalar) -> scalar:
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

    @wp.func(module=name)
    def copy_points(
        point: wp.array[vec2],
        section: wp.array[vec2],
        begin: int,
        stop: int,
        point_out: wp.array[vec2],
        section_out: wp.array[vec2],
    ):
        """Copy the points begin .. stop - 1, with their widths and depths where they vary along the channel."""
        for j in range(begin, stop):
            point_out[j] = point[j]
            if section:
                section_out[j] = section[j]

    return SimpleNamespace(
        **{k: v for k, v in vars(base).items() if k not in ("channel_at",)},
        vec4=vec4,
        Ends=Ends,
        mirrored=mirrored,
        bits=bits,
        channel_at=channel_at,
        point_range=point_range,
        channel_range=channel_range,
        share_of=share_of,
        piece_count=piece_count,
        piece_range=piece_range,
        old_section_at=old_section_at,
        closed_at=closed_at,
        old_round_index=old_round_index,
        extended_point=extended_point,
        old_extended_point=old_extended_point,
        circle_curvature=circle_curvature,
        central_tangent=central_tangent,
        fourth_order_tangent=fourth_order_tangent,
        whole_quanta=whole_quanta,
        arc_between=arc_between,
        arc_at=arc_at,
        length_of=length_of,
        recurrence_root=recurrence_root,
        recurrence_reach=recurrence_reach,
        end_weight=end_weight,
        old_end_weight=old_end_weight,
        copy_run=copy_run,
        right_normal=right_normal,
        copy_points=copy_points,
        REACH=REACH,
        ARC_QUANTUM=ARC_QUANTUM,
    )
