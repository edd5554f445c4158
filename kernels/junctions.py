"""Junctions: nodes that move with the stem that goes on through them, and wander along the channel downstream."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.channels import Work
from warpriver.kernels.status import HALT, NUMBER
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the junction kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.junctions_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2, Channels = line.vec2, line.Channels
    ZERO, HALF, ONE, TWO, THREE = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0))
    # A junction keeps this many widths of the channel downstream from the next one.
    MINIMUM_WIDTHS = scalar(10.0)
    TINY, TURN = scalar(1.0e-30), scalar(2.0 * math.pi)
    # Points of a reach that is shaped at least.
    LEAST_POINTS = 3

    @wp.struct
    class Junctions:
        """What meets where, by channel: the one downstream, -1 if none, how many flow in, speed of the head in m/yr.

        ``beside`` is the other channel that flows into the one downstream, ``lesser`` the tributary at its own head
        that is led to a bank, -1 if none. ``angle`` is that of the template at its foot, rad, below 0 where there is
        none, and ``ease`` how fast it gets there, 1/yr.
        """

        downstream: wp.array[int]
        tributaries: wp.array[int]
        drift: wp.array[scalar]
        beside: wp.array[int]
        lesser: wp.array[int]
        angle: wp.array[scalar]
        ease: wp.array[scalar]

    @wp.struct
    class Template:
        """How mouths are shaped, ``reach`` in mean widths of both channels, ``straight`` in those below, and led.

        Junctions wander on towards the outer bank, with all their speed from the curvature ``bend`` over the width on.
        They wander back where the last reach arrives at less than ``least``, freely from ``free`` on, and on to either
        bank where it arrives at more than ``most``, rad.
        """

        reach: scalar
        straight: scalar
        bend: scalar
        least: scalar
        free: scalar
        most: scalar

    @wp.kernel(module=name, enable_backward=False)
    def settle_heads(
        # network
        channels: Channels,
        point_xy: wp.array[vec2],
        # params
        work: Work,
        # out
        channel_shift_out: wp.array[vec2],
        point_moved_io: wp.array[vec2],
    ):
        """Move the head of each link to where the link upstream of it now ends, and note by how much."""
        channel = wp.tid()
        shift = vec2(ZERO, ZERO)
        if work.status[HALT] == 0 and channels.stems.upper:
            upper = channels.stems.upper[channel]
            if upper >= 0:
                head = channels.start[channel]
                foot = point_moved_io[channels.start[upper + 1] - 1]
                shift = foot - point_xy[head]
                point_moved_io[head] = foot
        channel_shift_out[channel] = shift

    @wp.func(module=name)
    def direction_from(channels: Channels, point_xy: wp.array[vec2], channel: int, upstream: int, away: scalar) -> vec2:
        """Unit vector from an end of a channel to its point at an arc length from there, at most half the channel.

        ``upstream`` is 1 for the foot, from which it looks upstream, 0 for the head.
        """
        first = channels.start[channel]
        last = channels.start[channel + 1] - 1
        place = wp.min(away / channels.spacing[channel], HALF * scalar(last - first))
        k = wp.min(int(place), last - first - 1)
        part = place - scalar(k)
        end = first
        near = first + k
        far = first + k + 1
        if upstream != 0:
            end = last
            near = last - k
            far = last - k - 1
        way = (ONE - part) * point_xy[near] + part * point_xy[far] - point_xy[end]
        return way / wp.max(wp.length(way), TINY)

    @wp.func(module=name)
    def turn_between(a: vec2, b: vec2) -> scalar:
        """Angle by which a direction turns to become another one, rad, to the left above 0."""
        return wp.atan2(a[0] * b[1] - a[1] * b[0], wp.dot(a, b))

    @wp.func(module=name)
    def rotated(a: vec2, angle: scalar) -> vec2:
        """A vector turned to the left."""
        c = wp.cos(angle)
        s = wp.sin(angle)
        return vec2(c * a[0] - s * a[1], s * a[0] + c * a[1])

    @wp.func(module=name)
    def cubic_at(a: vec2, b: vec2, leaving: vec2, arriving: vec2, t: scalar) -> vec2:
        """Point at t, 0 to 1, of the cubic between two points whose tangents there are unit vectors times the chord."""
        u = ONE - t
        way = b - a
        return a + t * t * (THREE - TWO * t) * way + wp.length(way) * t * u * (u * leaving - t * arriving)

    @wp.func(module=name)
    def shaped_length(channels: Channels, junctions: Junctions, mouths: Template, channel: int) -> scalar:
        """Length of the last reach of a channel, m, that is shaped."""
        widths = channels.form[channel].width + channels.form[junctions.downstream[channel]].width
        return HALF * mouths.reach * widths

    @wp.kernel(module=name, enable_backward=False)
    def aim_mouths(
        # network
        channels: Channels,
        junctions: Junctions,
        # params
        mouths: Template,
        work: Work,
        # in
        point_moved: wp.array[vec2],
        # out
        channel_aim_out: wp.array[vec2],
        channel_lead_out: wp.array[scalar],
    ):
        """Direction in which each tributary is to arrive, unit vector, and part of its speed with which it wanders.

        It arrives at the angle of its template to the channel downstream, or to the course of the river that goes on
        through the node, from the side on which it lies: going round the node from the one downstream to the other
        tributary, it comes first on the left. Its mouth wanders on while the river bends towards it, so that it lies on
        the inner bank, the less the more it lies on the outer one; and back, below 0, where it runs along the river.
        """
        channel = wp.tid()
        aim = vec2(ZERO, ZERO)
        lead = scalar(0.0)
        downstream = junctions.downstream[channel]
        if downstream >= 0 and work.status[HALT] == 0:
            beside = junctions.beside[channel]
            if beside >= 0 and junctions.angle[channel] >= ZERO and channels.step[channel] > ZERO:
                near = mouths.straight * channels.form[downstream].width
                down = direction_from(channels, point_moved, downstream, 0, near)
                up = direction_from(channels, point_moved, beside, 1, near)
                own = direction_from(channels, point_moved, channel, 1, near)
                to_own = turn_between(down, own)
                to_other = turn_between(down, up)
                if to_own < ZERO:
                    to_own = to_own + TURN
                if to_other < ZERO:
                    to_other = to_other + TURN
                side = ONE
                if to_own > to_other:
                    side = -ONE
                course = down
                if channels.stems.lower:
                    if channels.stems.lower[beside] == downstream:
                        # The river goes on through the node, in a bend: its tangent there.
                        course = (down - up) / wp.max(wp.length(down - up), TINY)
                aim = rotated(course, -side * junctions.angle[channel])
                # Above 0 where the tributary lies on the inner bank.
                bend = side * turn_between(-up, down) / mouths.straight
                lead = wp.clamp(HALF + HALF * bend / mouths.bend, ZERO, ONE)
                reach = direction_from(
                    channels, point_moved, channel, 1, shaped_length(channels, junctions, mouths, channel)
                )
                arrives = side * turn_between(-reach, down)
                back = wp.clamp((arrives - mouths.least) / (mouths.free - mouths.least), -ONE, ONE)
                if back < ONE:
                    lead = wp.min(lead, back)
                on = wp.min((arrives - mouths.most) / (mouths.free - mouths.least), ONE)
                if on > ZERO:
                    lead = wp.max(lead, on)
        channel_aim_out[channel] = aim
        channel_lead_out[channel] = lead

    @wp.kernel(module=name, enable_backward=False)
    def shape_mouths(
        # network
        channels: Channels,
        junctions: Junctions,
        # params
        mouths: Template,
        # in
        channel_aim: wp.array[vec2],
        # out
        point_moved_io: wp.array[vec2],
    ):
        """Draw the last reach of each tributary towards its template, by the part ease dt of the way.

        The template is a cubic that goes on in the direction of the course upstream, and a straight end that arrives in
        the direction aimed at. The reach is half of the channel at most.
        """
        channel = wp.tid()
        aim = channel_aim[channel]
        if wp.length_sq(aim) > ZERO:
            last = channels.start[channel + 1] - 1
            spacing = channels.spacing[channel]
            count = int(shaped_length(channels, junctions, mouths, channel) / spacing)
            count = wp.min(count, (last - channels.start[channel]) // 2)
            if count >= LEAST_POINTS:
                part = wp.min(junctions.ease[channel] * channels.step[channel], ONE)
                width = channels.form[junctions.downstream[channel]].width
                end = wp.min(mouths.straight * width, HALF * scalar(count) * spacing)
                base = point_moved_io[last - count]
                leaving = point_moved_io[last - count + 1] - point_moved_io[last - count - 1]
                leaving = leaving / wp.max(wp.length(leaving), TINY)
                mouth = point_moved_io[last] - end * aim
                way = mouth - base
                chord = wp.max(wp.length(way), TINY)
                for k in range(1, count):
                    s = scalar(k) / scalar(count) * (chord + end)
                    place = mouth + (s - chord) * aim
                    if s < chord:
                        place = cubic_at(base, mouth, leaving, aim, s / chord)
                    j = last - count + k
                    point_moved_io[j] = point_moved_io[j] + part * (place - point_moved_io[j])

    @wp.kernel(module=name, enable_backward=False)
    def ease_locks(
        # network
        channels: Channels,
        # params
        reach: scalar,
        work: Work,
        # in
        channel_ease: wp.array[scalar],
        # out
        point_moved_io: wp.array[vec2],
    ):
        """Draw the river on both sides of a locked point towards two cubics that meet there in one direction.

        Else it would straighten towards the lock from both sides, and have a corner there. By the part ease dt, all of
        it from a curvature of 1 over the width on at the lock, nothing up to half of that. ``reach`` is in widths, less
        than half of the channel at most. Points between two locks are those of one of them.
        """
        upper = wp.tid()
        if work.status[HALT] != 0 or channels.step[upper] == ZERO or not line.foot_held(channels, upper):
            return
        lower = channels.stems.lower[upper]
        if lower < 0:
            return
        foot = channels.start[upper + 1] - 1
        head = channels.start[lower]
        width = channels.form[upper].width
        above = wp.min(int(reach * width / channels.spacing[upper]), (foot - channels.start[upper] - 3) // 2)
        below = wp.min(int(reach * width / channels.spacing[lower]), (channels.start[lower + 1] - 1 - head - 3) // 2)
        if above < 2 or below < 2:
            return
        lock = point_moved_io[foot]
        arrives = lock - point_moved_io[foot - 1]
        leaves = point_moved_io[head + 1] - lock
        bend = TWO * wp.abs(turn_between(arrives, leaves)) / wp.max(wp.length(arrives) + wp.length(leaves), TINY)
        part = wp.clamp(TWO * bend * width - ONE, ZERO, ONE) * wp.min(channel_ease[upper] * channels.step[upper], ONE)
        if part > ZERO:
            base = point_moved_io[foot - above]
            end = point_moved_io[head + below]
            into = wp.normalize(point_moved_io[foot - above + 1] - point_moved_io[foot - above - 1])
            out = wp.normalize(point_moved_io[head + below + 1] - point_moved_io[head + below - 1])
            through = wp.normalize(
                line.central_tangent(lock - base, end - lock, wp.length(lock - base), wp.length(end - lock))
            )
            for k in range(1, above):
                j = foot - above + k
                place = cubic_at(base, lock, into, through, scalar(k) / scalar(above))
                point_moved_io[j] = point_moved_io[j] + part * (place - point_moved_io[j])
            for k in range(1, below):
                place = cubic_at(lock, end, through, out, scalar(k) / scalar(below))
                point_moved_io[head + k] = point_moved_io[head + k] + part * (place - point_moved_io[head + k])

    @wp.kernel(module=name, enable_backward=False)
    def count_active(
        # network
        channels: Channels,
        junctions: Junctions,
        # out
        channel_active_io: wp.array[int],
    ):
        """Number of the tributaries of each channel that are active in this sub-step."""
        channel = wp.tid()
        downstream = junctions.downstream[channel]
        if downstream >= 0 and channels.step[channel] > ZERO:
            wp.atomic_add(channel_active_io, downstream, 1)

    @wp.kernel(module=name, enable_backward=False)
    def shift_heads(
        # network
        channels: Channels,
        junctions: Junctions,
        # params
        time_step: scalar,
        # in
        substep: wp.array[int],
        channel_active: wp.array[int],
        channel_lead: wp.array[scalar],
        # out
        channel_shift_io: wp.array[vec2],
        point_moved_io: wp.array[vec2],
    ):
        """Move the head of each channel downstream of a junction by v dt along its first segment, half of it at most.

        Where a tributary is led by that part of it; below 0 back along the last segment of the other one.
        Junctions wander in the first of the sub-steps, in which every channel moves that can; they stay where one of
        theirs cannot, and where the channel that becomes shorter is so short that the next junction is near.
        """
        channel = wp.tid()
        first = channels.start[channel]
        last = channels.start[channel + 1] - 1
        tributaries = junctions.tributaries[channel]
        moves = substep[NUMBER] == 0 and tributaries > 0 and channel_active[channel] == tributaries
        if moves and channels.step[channel] > ZERO:
            length = scalar(last - first) * channels.spacing[channel]
            moves = length > MINIMUM_WIDTHS * channels.form[channel].widest
        else:
            moves = False
        shift = vec2(ZERO, ZERO)
        if moves:
            head = point_moved_io[first]
            speed = junctions.drift[channel]
            along = point_moved_io[first + 1] - head
            lesser = int(-1)
            if junctions.lesser:
                lesser = junctions.lesser[channel]
            if lesser >= 0:
                speed = speed * channel_lead[lesser]
                if speed < ZERO:
                    upper = junctions.beside[lesser]
                    foot = channels.start[upper + 1] - 1
                    length = scalar(foot - channels.start[upper]) * channels.spacing[upper]
                    if length > MINIMUM_WIDTHS * channels.form[upper].widest:
                        speed = -speed
                        along = point_moved_io[foot - 1] - head
                    else:
                        speed = ZERO
            size = wp.length(along)
            if size > ZERO:
                shift = along * (wp.min(speed * time_step, HALF * size) / size)
                point_moved_io[first] = head + shift
        channel_shift_io[channel] = channel_shift_io[channel] + shift

    @wp.kernel(module=name, enable_backward=False)
    def follow_heads(
        # network
        channels: Channels,
        junctions: Junctions,
        # params
        reach: scalar,
        # in
        channel_shift: wp.array[vec2],
        # out
        point_moved_io: wp.array[vec2],
    ):
        """Take the lower reach of each tributary along with its junction, the less the farther away, by a smoothstep.

        So the tributaries keep apart and go on to meet at an angle. ``reach`` is in widths, half the channel at most.
        A reach that is pushed or pulled about straightens on the way, so that it does not end in a hook: by a part
        |shift| / W of its distance from the chord, W the width of the river. The link that the stem comes from has
        moved by itself: only its last point follows.
        """
        channel = wp.tid()
        downstream = junctions.downstream[channel]
        if downstream >= 0:
            shift = channel_shift[downstream]
            if wp.length_sq(shift) > ZERO:
                last = channels.start[channel + 1] - 1
                count = int(reach * channels.form[channel].widest / channels.spacing[channel])
                count = wp.min(count, (last - channels.start[channel]) // 2)
                if channels.stems.lower:
                    if channels.stems.lower[channel] >= 0:
                        count = 1
                mouth = point_moved_io[channels.start[downstream]]
                base = point_moved_io[last - count]
                straighter = wp.min(wp.length(shift) / channels.form[downstream].widest, ONE)
                for k in range(1, count):
                    t = ONE - scalar(k) / scalar(count)
                    weight = t * t * (THREE - TWO * t)
                    moved = point_moved_io[last - k] + weight * shift
                    chord = base + t * (mouth - base)
                    point_moved_io[last - k] = moved + (weight * straighter) * (chord - moved)
                point_moved_io[last] = mouth

    return SimpleNamespace(
        vec2=vec2,
        Junctions=Junctions,
        Template=Template,
        aim_mouths=aim_mouths,
        shape_mouths=shape_mouths,
        ease_locks=ease_locks,
        settle_heads=settle_heads,
        count_active=count_active,
        shift_heads=shift_heads,
        follow_heads=follow_heads,
    )
