"""Geometry of channels: tangents, curvature, arc lengths, recurrences along the line."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import channels
from warpriver.kernels.channels import EDGE_NONE, EDGE_NORTH_SOUTH
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@wp.struct
class Arcs:
    """Arc length of each point from its channel's head, m; with chunks from its chunk's first point on.

    ``chunk_offset`` is the inclusive running sum of the chunks' lengths in quanta, ``chunk`` the number of points of a
    chunk, 0 without chunks.
    """

    point: wp.array[wp.float64]
    chunk_offset: wp.array[wp.int64]
    chunk: int


@wp.struct
class ArcPlace:
    """A place along all points: the arc length within its chunk, m, and the quanta of the chunks before."""

    within: wp.float64
    before: wp.int64


@once
def build(scalar):
    """Make the functions on polylines for one precision; their namespace has those of ``channels`` as well.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.polyline_{scalar.__name__}"
    base = channels.build(scalar)
    vec2, vec3 = base.vec2, wp.types.vector(3, scalar)
    Channels, Points, Run = base.Channels, base.Points, base.Run

    @wp.struct
    class Ends:
        """Distance along the river from a channel to its first and its last point, and how far each end is felt, m.

        An end may be a locked point, 1 for ``head_locked`` and ``foot_locked``.
        """

        above: scalar
        head_reach: scalar
        below: scalar
        foot_reach: scalar
        head_locked: int
        foot_locked: int

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
    def circle_curvature(a: vec2, b: vec2, la: scalar, lb: scalar) -> scalar:
        """Curvature of the circle through three points that are joined by a and b, of lengths la and lb; left > 0."""
        scale = la * lb * wp.length(a + b)
        if scale > ZERO:
            return TWO * (a[0] * b[1] - a[1] * b[0]) / scale
        return ZERO

    @wp.func(module=name)
    def circle_bend(a: vec2, b: vec2, la: scalar, lb: scalar) -> vec3:
        """Curvature as ``circle_curvature``, and the unit normal to the right of the flow: (curvature, normal).

        There is no normal where the line turns back on itself.
        """
        chord = a + b
        size = wp.length(chord)
        if size == ZERO:
            return vec3(ZERO, ZERO, ZERO)
        curvature = ZERO
        scale = la * lb * size
        if scale > ZERO:
            curvature = TWO * (a[0] * b[1] - a[1] * b[0]) / scale
        part = ONE / size
        return vec3(curvature, chord[1] * part, -chord[0] * part)

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
    def arc_place(arcs: Arcs, i: int) -> ArcPlace:
        """Place of a point."""
        place = ArcPlace()
        place.within = arcs.point[i]
        place.before = wp.int64(0)
        if arcs.chunk > 0 and i >= arcs.chunk:
            place.before = arcs.chunk_offset[i // arcs.chunk - 1]
        return place

    @wp.func(module=name)
    def arc_from(arcs: Arcs, origin: ArcPlace, i: int) -> wp.float64:
        """Arc length from a place to point i of the same channel, m."""
        place = arc_place(arcs, i)
        arc = place.within - origin.within
        if arcs.chunk > 0:
            arc += wp.float64(place.before - origin.before) * ARC_QUANTUM
        return arc

    @wp.func(module=name)
    def length_of(point: wp.array[vec2], arcs: Arcs, run: Run) -> wp.float64:
        """Length of a channel in m, that of a ring with the segment that closes it."""
        length = arc_from(arcs, arc_place(arcs, run.first), run.last)
        if run.closed != 0:
            length += wp.float64(wp.length(point[run.first] - point[run.last]))
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
        """Smoothstep of a point's distance along the river to its nearer end, 0 there and 1 from the reach on.

        A ring has no ends.
        """
        t = scalar(1.0)
        if run.closed != 0:
            return t
        away = ends.above + scalar(i - run.first) * run.spacing
        if away < ends.head_reach:
            t = away / ends.head_reach
        away = ends.below + scalar(run.last - i) * run.spacing
        if away < ends.foot_reach:
            t = wp.min(t, away / ends.foot_reach)
        return t * t * (THREE - TWO * t)

    @wp.func(module=name)
    def local_weight(i: int, run: Run, ends: Ends, tightness: scalar) -> scalar:
        """Share of its own curvature that a point near a locked one feels, 1 from the reach of that on.

        It falls as by ``end_weight``, so that the river keeps its form there and no corner arises at the lock; but a
        bend tighter than its width, of a ``tightness`` |C| w from 1/2 on, straightens all the same.
        """
        t = scalar(1.0)
        if ends.head_locked != 0:
            t = wp.min(t, (ends.above + scalar(i - run.first) * run.spacing) / ends.head_reach)
        if ends.foot_locked != 0:
            t = wp.min(t, (ends.below + scalar(run.last - i) * run.spacing) / ends.foot_reach)
        if t >= ONE:
            return ONE
        return wp.max(t * t * (THREE - TWO * t), wp.clamp(TWO * tightness - ONE, ZERO, ONE))

    @wp.func(module=name)
    def copy_run(points: Points, run: Run, points_out: Points):
        """Copy the points of a run, with their widths and depths where these vary along the channel."""
        for j in range(run.begin, run.stop):
            points_out.xy[j] = points.xy[j]
            if points.section:
                points_out.section[j] = points.section[j]

    @wp.func(module=name)
    def right_normal(before: vec2, after: vec2) -> vec2:
        """Unit normal to the right of the flow; none where the line turns back on itself."""
        t = after - before
        size = wp.length(t)
        if size == ZERO:
            return vec2(ZERO, ZERO)
        part = ONE / size
        return vec2(t[1] * part, -t[0] * part)

    @wp.func(module=name)
    def segment_length(channels: Channels, run: Run, i: int) -> scalar:
        """Length of the segment from point i on to the next one, also of the links that go on from a channel."""
        if i < run.first and run.upper >= 0:
            return channels.spacing[run.upper]
        if i >= run.last and run.lower >= 0:
            return channels.spacing[run.lower]
        return run.spacing

    @wp.func(module=name)
    def normal_at(channels: Channels, point_xy: wp.array[vec2], j: int, run: Run) -> vec2:
        """Unit normal to the right of the flow at a point, at a junction with regard to how far its neighbours are."""
        before = extended_point(point_xy, j - 1, run)
        after = extended_point(point_xy, j + 1, run)
        if (j < run.last or run.lower < 0) and (j > run.first or run.upper < 0):
            return right_normal(before, after)
        here = point_xy[j]
        la = segment_length(channels, run, j - 1)
        tangent = central_tangent(here - before, after - here, la, segment_length(channels, run, j))
        return right_normal(vec2(ZERO, ZERO), tangent)

    return SimpleNamespace(
        **vars(base),
        vec3=vec3,
        Ends=Ends,
        mirrored=mirrored,
        bits=bits,
        extended_point=extended_point,
        circle_curvature=circle_curvature,
        circle_bend=circle_bend,
        central_tangent=central_tangent,
        fourth_order_tangent=fourth_order_tangent,
        whole_quanta=whole_quanta,
        arc_place=arc_place,
        arc_from=arc_from,
        length_of=length_of,
        recurrence_root=recurrence_root,
        recurrence_reach=recurrence_reach,
        end_weight=end_weight,
        local_weight=local_weight,
        right_normal=right_normal,
        segment_length=segment_length,
        normal_at=normal_at,
        copy_run=copy_run,
        REACH=REACH,
        ARC_QUANTUM=ARC_QUANTUM,
    )
