"""Resampling: evenly spaced points on the C1 cubic through the moved ones [Paris2023, Sec. 4.3]."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.channels import RING_POINTS, Work
from warpriver.kernels.status import (
    CUT_POINTS,
    CUT_POINTS_NEEDED,
    CUTS,
    CUTS_NEEDED,
    DONE,
    FAULT,
    FAULT_NOT_FINITE,
    FAULT_POINTS_FULL,
    GOAL,
    HALT,
    NUMBER,
    PLANNED,
    POINTS,
    POINTS_NEEDED,
    STATUS_SIZE,
    STEPS,
    TOTAL,
)
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the resampling kernels for one precision; arc lengths are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.resampling_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2, Form = line.vec2, line.Form
    ZERO, ONE, TWO, THREE = scalar(0.0), scalar(1.0), scalar(2.0), scalar(3.0)
    ZERO_64, HALF_64 = wp.float64(0.0), wp.float64(0.5)
    QUANTA = wp.float64(1.0) / line.ARC_QUANTUM
    # m; where a chunk or a channel is longer, points have run away.
    FARTHEST = wp.float64(2.0**30)
    # More segments of a channel than this are beyond the integers, or soon will be.
    MOST = wp.float64(2.0**30)

    @wp.kernel(module=name, enable_backward=False)
    def measure_arcs(
        # network
        channel_start: wp.array[int],
        channel_step: wp.array[scalar],
        # params
        work: Work,
        # in
        point_moved: wp.array[vec2],
        # out
        point_arc_out: wp.array[wp.float64],
        chunk_length_out: wp.array[wp.int64],
        status_io: wp.array[int],
    ):
        """Arc length of each point from its channel's head, m; with chunks, from its chunk's first point on.

        Each chunk notes the length that it adds, in quanta. A slab passes over channels whose step is 0.
        """
        if work.status[HALT] != 0:
            return
        k = work.first + wp.tid()
        share = line.point_range(work, channel_start, channel_step.shape[0], k)
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        arc = wp.float64(0.0)
        while i < end:
            first = channel_start[channel]
            stop = wp.min(end, channel_start[channel + 1])
            if work.chunk == 0:
                arc = wp.float64(0.0)
            if work.chunk > 0 or channel_step[channel] > ZERO:
                here = point_moved[i]
                if i > first:
                    arc += line.whole_quanta(wp.length(here - point_moved[i - 1]))
                point_arc_out[i] = arc
                for j in range(i + 1, stop):
                    after = point_moved[j]
                    arc += line.whole_quanta(wp.length(after - here))
                    point_arc_out[j] = arc
                    here = after
            i = stop
            channel += 1
        if work.chunk > 0:
            if arc < FARTHEST:
                chunk_length_out[k] = wp.int64(arc * QUANTA)
            else:
                # Nothing of this step is taken over, so that the state before the fault can still be looked at.
                chunk_length_out[k] = wp.int64(0)
                wp.atomic_max(status_io, FAULT, FAULT_NOT_FINITE)

    @wp.kernel(module=name, enable_backward=False)
    def count_samples(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[Form],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        # params
        work: Work,
        # in
        point_moved: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.int64],
        # out
        channel_samples_out: wp.array[int],
        channel_spacing_out: wp.array[scalar],
        status_io: wp.array[int],
    ):
        """Number of new points of each channel, from its length and the spacing asked for, and the even spacing.

        A ring has as many points as segments. A channel whose step is 0 keeps its points. One without length, or longer
        than any river, is a fault.
        """
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            if channel_step[channel] == ZERO:
                channel_samples_out[channel] = channel_start[channel + 1] - channel_start[channel]
                channel_spacing_out[channel] = channel_spacing[channel]
            else:
                first = channel_start[channel]
                last = channel_start[channel + 1] - 1
                closed = line.closed_at(channel_closed, channel)
                length = line.length_of(point_moved, point_arc, chunk_offset, work.chunk, first, last, closed)
                pieces = int(-1)
                needed = length / wp.float64(channel_form[channel].target_spacing)
                if length > ZERO_64 and length < FARTHEST and needed < MOST:
                    least = int(2)
                    if closed != 0:
                        least = RING_POINTS
                    pieces = wp.max(least, int(needed + HALF_64))
                    channel_spacing_out[channel] = scalar(length / wp.float64(pieces))
                else:
                    wp.atomic_max(status_io, FAULT, FAULT_NOT_FINITE)
                channel_samples_out[channel] = pieces + 1 - closed

    @wp.func(module=name)
    def kept_after(point: wp.array[vec2], i: int, first: int, last: int, closed: int) -> int:
        """Next point that is not a copy of point i (a cutoff leaves copies behind); i + 1 beyond the channel's end.

        Indices of a ring go on beyond its ends, round and round.
        """
        j = i + 1
        if closed != 0:
            here = point[line.old_round_index(i, first, last)]
            while j <= i + last - first and point[line.old_round_index(j, first, last)] == here:
                j += 1
            return j
        while j < last and point[j] == point[i]:
            j += 1
        return j

    @wp.func(module=name)
    def kept_before(point: wp.array[vec2], i: int, first: int, last: int, closed: int) -> int:
        """Last point before i that is not a copy of it; beyond the channel's head i - 1, or first - 1."""
        j = i - 1
        if closed != 0:
            here = point[line.old_round_index(i, first, last)]
            while j >= i - last + first and point[line.old_round_index(j, first, last)] == here:
                j -= 1
            return j
        while j >= first and point[j] == point[wp.max(i, first)]:
            j -= 1
        return j

    @wp.func(module=name)
    def kept_point(point: wp.array[vec2], i: int, first: int, last: int, closed: int) -> vec2:
        """Point i; beyond an end the point reflection of the kept points inside, or on round a ring."""
        if i >= first and i <= last:
            return point[i]
        if closed != 0:
            return point[line.old_round_index(i, first, last)]
        j = int(last)
        beyond = i - last
        step = int(-1)
        if i < first:
            j = int(first)
            beyond = first - i
            step = 1
        end = point[j]
        for _k in range(beyond):
            if step < 0:
                j = wp.max(kept_before(point, j, first, last, 0), first)
            else:
                j = wp.min(kept_after(point, j, first, last, 0), last)
        return TWO * end - point[j]

    @wp.func(module=name)
    def next_point(point: wp.array[vec2], i: int, here: vec2, first: int, last: int, closed: int):
        """Kept point after point i, which lies ``here``, and where it lies itself."""
        j = i + 1
        if j < last:
            ahead = point[j]
            if not (ahead == here):
                return j, ahead
        # At the end of a line, round a ring, or where a cutoff left copies.
        j = kept_after(point, i, first, last, closed)
        return j, kept_point(point, j, first, last, closed)

    @wp.func(module=name)
    def segment_of(
        point: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.int64],
        chunk: int,
        first: int,
        last: int,
        closed: int,
        target: wp.float64,
    ) -> int:
        """First point of the segment of a channel that holds an arc length from its head (binary search)."""
        low = first
        high = last + closed
        while high - low > 1:
            middle = (low + high) // 2
            if line.arc_at(point_arc, chunk_offset, chunk, first, middle) <= target:
                low = middle
            else:
                high = middle
        while low > first and point[low] == point[low - 1]:
            low -= 1
        return low

    @wp.func(module=name)
    def arc_beyond(
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.int64],
        chunk: int,
        first: int,
        last: int,
        length: wp.float64,
        i: int,
    ) -> wp.float64:
        """Arc length of a point; the index of a ring may go on beyond its end, into the next lap."""
        if i > last:
            return length + line.arc_at(point_arc, chunk_offset, chunk, first, i - last - 1 + first)
        return line.arc_at(point_arc, chunk_offset, chunk, first, i)

    @wp.func(module=name)
    def hermite(b: vec2, c: vec2, tangent_b: vec2, tangent_c: vec2, size: scalar, u: scalar) -> vec2:
        """Point at the part u of the cubic from b to c with those unit-speed tangents."""
        v = ONE - u
        blend = u * u * (THREE - TWO * u)
        return b + blend * (c - b) + (size * u * v) * (v * tangent_b - u * tangent_c)

    @wp.func(module=name)
    def sweep_samples(
        channel_range: wp.vec4i,
        sample_range: wp.vec4i,
        chunk: int,
        closed: int,
        spacing: wp.float64,
        point: wp.array[vec2],
        section: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.int64],
        sample_out: wp.array[vec2],
        sample_section_out: wp.array[vec2],
    ):
        """Write the new points begin .. stop - 1 of a channel, marching down its old segments with a rolling window.

        channel_range = (first, last, -, -) of the old points; sample_range = (first, last, begin, stop) of the new.
        """
        first = channel_range[0]
        last = channel_range[1]
        target = spacing * wp.float64(sample_range[2] - sample_range[0])
        ib = segment_of(point, point_arc, chunk_offset, chunk, first, last, closed, target)
        ia = kept_before(point, ib, first, last, closed)
        ic = kept_after(point, ib, first, last, closed)
        id = kept_after(point, ic, first, last, closed)
        ie = kept_after(point, id, first, last, closed)
        z = kept_point(point, kept_before(point, ia, first, last, closed), first, last, closed)
        a = kept_point(point, ia, first, last, closed)
        b = kept_point(point, ib, first, last, closed)
        c = kept_point(point, ic, first, last, closed)
        d = kept_point(point, id, first, last, closed)
        e = kept_point(point, ie, first, last, closed)
        ab = wp.length(b - a)
        bc = wp.length(c - b)
        cd = wp.length(d - c)
        de = wp.length(e - d)
        ta = line.central_tangent(a - z, b - a, wp.length(a - z), ab)
        tb = line.central_tangent(b - a, c - b, ab, bc)
        tc = line.central_tangent(c - b, d - c, bc, cd)
        td = line.central_tangent(d - c, e - d, cd, de)
        tangent_b = line.fourth_order_tangent(ta, tb, tc, ab, bc)
        tangent_c = line.fourth_order_tangent(tb, tc, td, bc, cd)
        length = line.length_of(point, point_arc, chunk_offset, chunk, first, last, closed)
        arc_b = line.arc_at(point_arc, chunk_offset, chunk, first, ib)
        arc_c = arc_beyond(point_arc, chunk_offset, chunk, first, last, length, ic)
        for k in range(sample_range[2], sample_range[3]):
            target = spacing * wp.float64(k - sample_range[0])
            while arc_c < target and ic < last + closed:
                ib = ic
                ic = id
                id = ie
                b = c
                c = d
                d = e
                ie, e = next_point(point, ie, d, first, last, closed)
                bc = cd
                cd = de
                de = wp.length(e - d)
                tb = tc
                tc = td
                td = line.central_tangent(d - c, e - d, cd, de)
                tangent_b = tangent_c
                tangent_c = line.fourth_order_tangent(tb, tc, td, bc, cd)
                arc_b = arc_c
                arc_c = arc_beyond(point_arc, chunk_offset, chunk, first, last, length, ic)
            u = scalar(0.0)
            if k > sample_range[0] and arc_c > arc_b:
                u = wp.clamp(scalar((target - arc_b) / (arc_c - arc_b)), ZERO, ONE)
            if k == sample_range[1] and closed == 0:
                ib = last
                b = kept_point(point, last, first, last, 0)
                u = ZERO
            sample_out[k] = hermite(b, c, tangent_b, tangent_c, bc, u)
            if section:
                before = kept_point(section, ib, first, last, closed)
                sample_section_out[k] = (ONE - u) * before + u * kept_point(section, ic, first, last, closed)

    @wp.kernel(module=name, enable_backward=False)
    def resample_points(
        # network
        channel_start: wp.array[int],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        # params
        work: Work,
        # in
        channel_start_next: wp.array[int],
        point_moved: wp.array[vec2],
        section_moved: wp.array[vec2],
        point_arc: wp.array[wp.float64],
        chunk_offset: wp.array[wp.int64],
        status: wp.array[int],
        # out
        point_xy_out: wp.array[vec2],
        point_section_out: wp.array[vec2],
    ):
        """Sample the cubic through the moved points at the even spacing; both ends of a channel stay where they are.

        A ring begins where its first point is.
        ``channel_spacing`` is the new one. The points of a channel whose step is 0 are taken over as they are.
        """
        channel_count = channel_spacing.shape[0]
        if status[FAULT] != 0 or channel_start_next[channel_count] > point_xy_out.shape[0]:
            return
        share = line.point_range(work, channel_start_next, channel_count, work.first + wp.tid())
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            stop = wp.min(end, channel_start_next[channel + 1])
            if channel_step[channel] > ZERO:
                old = wp.vec4i(channel_start[channel], channel_start[channel + 1] - 1, 0, 0)
                new = wp.vec4i(channel_start_next[channel], channel_start_next[channel + 1] - 1, i, stop)
                sweep_samples(
                    old, new, work.chunk, line.closed_at(channel_closed, channel),
                    wp.float64(channel_spacing[channel]), point_moved, section_moved, point_arc, chunk_offset,
                    point_xy_out, point_section_out,
                )  # fmt: skip
            else:
                shift = channel_start[channel] - channel_start_next[channel]
                for j in range(i, stop):
                    point_xy_out[j] = point_moved[j + shift]
                    if section_moved:
                        point_section_out[j] = section_moved[j + shift]
            i = stop
            channel += 1

    @wp.kernel(module=name, enable_backward=False)
    def commit_step(
        # params
        point_capacity: int,
        keep_plan: int,
        # in
        channel_start_next: wp.array[int],
        channel_spacing_next: wp.array[scalar],
        # out
        channel_start_out: wp.array[int],
        channel_spacing_out: wp.array[scalar],
        substep_io: wp.array[int],
        status_io: wp.array[int],
    ):
        """Take over the new starts and spacings and count the sub-step, unless it failed or its points do not fit.

        ``keep_plan``: 1 where the plan of one step holds for the next. Where no steps are asked for, lines are sampled
        anew outside of any step, and nothing is counted. The number of each sub-step done and that of all in its step
        follow the status.
        """
        channel = wp.tid()
        last = channel_start_next.shape[0] - 1
        if status_io[HALT] != 0 or status_io[FAULT] != 0:
            return
        points = channel_start_next[last]
        if points > point_capacity:
            # The first thread to come here hides this from the others, which have nothing else to say.
            status_io[POINTS_NEEDED] = points
            wp.atomic_max(status_io, FAULT, FAULT_POINTS_FULL)
            return
        channel_start_out[channel] = channel_start_next[channel]
        if channel < last:
            channel_spacing_out[channel] = channel_spacing_next[channel]
        else:
            status_io[POINTS] = points
            status_io[POINTS_NEEDED] = points
            if status_io[GOAL] > 0:
                done = status_io[DONE]
                status_io[STATUS_SIZE + 2 * done] = substep_io[NUMBER]
                status_io[STATUS_SIZE + 2 * done + 1] = substep_io[TOTAL]
                status_io[DONE] = done + 1
                substep_io[NUMBER] = substep_io[NUMBER] + 1
                if substep_io[NUMBER] == substep_io[TOTAL]:
                    substep_io[NUMBER] = 0
                    substep_io[PLANNED] = keep_plan
                    status_io[STEPS] = status_io[STEPS] + 1
                status_io[CUTS] = status_io[CUTS] + status_io[CUTS_NEEDED]
                status_io[CUT_POINTS] = status_io[CUT_POINTS] + status_io[CUT_POINTS_NEEDED]

    return SimpleNamespace(
        vec2=vec2,
        Form=Form,
        measure_arcs=measure_arcs,
        count_samples=count_samples,
        resample_points=resample_points,
        commit_step=commit_step,
    )
