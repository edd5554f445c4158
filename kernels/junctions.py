"""Junctions: nodes that move with the stem that goes on through them, and wander along the channel downstream."""

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

    @wp.struct
    class Junctions:
        """What meets where, by channel: the one downstream, -1 if none, how many flow in, speed of the head in m/yr."""

        downstream: wp.array[int]
        tributaries: wp.array[int]
        drift: wp.array[scalar]

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
        # out
        channel_shift_io: wp.array[vec2],
        point_moved_io: wp.array[vec2],
    ):
        """Move the head of each channel downstream of a junction by v dt along its first segment, half of it at most.

        Junctions wander in the first of the sub-steps, in which every channel moves that can; they stay where one of
        theirs cannot, and where the channel downstream has become so short that the next junction is near.
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
            along = point_moved_io[first + 1] - head
            size = wp.length(along)
            if size > ZERO:
                shift = along * (wp.min(junctions.drift[channel] * time_step, HALF * size) / size)
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
        settle_heads=settle_heads,
        count_active=count_active,
        shift_heads=shift_heads,
        follow_heads=follow_heads,
    )
