"""Junctions: nodes that wander down the channel below them."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
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
    vec2, vec4 = line.vec2, line.vec4
    ZERO, HALF, ONE, TWO, THREE = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0))
    # A junction keeps this many widths of the channel below from the next one.
    LEAST_WIDTHS = scalar(10.0)

    @wp.kernel(module=name, enable_backward=False)
    def count_awake(
        # network
        channel_below: wp.array[int],
        channel_step: wp.array[scalar],
        # out
        channel_awake_io: wp.array[int],
    ):
        """Number of the tributaries of each channel that move in this sub-step."""
        channel = wp.tid()
        below = channel_below[channel]
        if below >= 0 and channel_step[channel] > ZERO:
            wp.atomic_add(channel_awake_io, below, 1)

    @wp.kernel(module=name, enable_backward=False)
    def shift_heads(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_tributaries: wp.array[int],
        channel_drift: wp.array[scalar],
        # params
        time_step: scalar,
        # in
        substep: wp.array[int],
        channel_awake: wp.array[int],
        # out
        channel_shift_out: wp.array[vec2],
        point_moved_io: wp.array[vec2],
    ):
        """Move the head of each channel below a junction by v dt down its first segment, half of it at most.

        Junctions wander in the first of the sub-steps, in which every channel moves that can; they stay where one of
        theirs cannot, and where the channel below has become so short that the next junction is near.
        """
        channel = wp.tid()
        first = channel_start[channel]
        last = channel_start[channel + 1] - 1
        tributaries = channel_tributaries[channel]
        moves = substep[0] == 0 and tributaries > 0 and channel_awake[channel] == tributaries
        if moves and channel_step[channel] > ZERO:
            moves = scalar(last - first) * channel_spacing[channel] > LEAST_WIDTHS * channel_form[channel][2]
        else:
            moves = False
        shift = vec2(ZERO, ZERO)
        if moves:
            head = point_moved_io[first]
            along = point_moved_io[first + 1] - head
            size = wp.length(along)
            if size > ZERO:
                shift = along * (wp.min(channel_drift[channel] * time_step, HALF * size) / size)
                point_moved_io[first] = head + shift
        channel_shift_out[channel] = shift

    @wp.kernel(module=name, enable_backward=False)
    def follow_heads(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        channel_below: wp.array[int],
        # params
        reach: scalar,
        # in
        channel_shift: wp.array[vec2],
        # out
        point_moved_io: wp.array[vec2],
    ):
        """Take the lower reach of each tributary along with its junction, the less the farther away, by a smoothstep.

        So the tributaries keep apart and go on to meet at an angle. ``reach`` is in widths, half the channel at most.
        """
        channel = wp.tid()
        below = channel_below[channel]
        if below >= 0:
            shift = channel_shift[below]
            if wp.length_sq(shift) > ZERO:
                last = channel_start[channel + 1] - 1
                count = int(reach * channel_form[channel][2] / channel_spacing[channel])
                count = wp.min(count, (last - channel_start[channel]) // 2)
                for k in range(1, count):
                    t = ONE - scalar(k) / scalar(count)
                    point_moved_io[last - k] = point_moved_io[last - k] + shift * (t * t * (THREE - TWO * t))
                point_moved_io[last] = point_moved_io[channel_start[below]]

    return SimpleNamespace(
        vec2=vec2, vec4=vec4, count_awake=count_awake, shift_heads=shift_heads, follow_heads=follow_heads
    )
