"""Resampling: evenly spaced points on the C1 cubic through the moved ones [Paris2023, Sec. 4.3]."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline
from warpriver.kernels.channels import EDGE_NONE, RING_POINTS, Work
from warpriver.kernels.polyline import ArcPlace, Arcs
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
    vec2, Channels, Points, Run = line.vec2, line.Channels, line.Points, line.Run
    ZERO, ONE, TWO, THREE = scalar(0.0), scalar(1.0), scalar(2.0), scalar(3.0)
    ZERO_64, HALF_64 = wp.float64(0.0), wp.float64(0.5)
    QUANTA = wp.float64(1.0) / line.ARC_QUANTUM
    # m; where a chunk or a channel is longer, points have run away.
    FARTHEST = wp.float64(2.0**30)
    # More segments of a channel than this are beyond the integers, or soon will be.
    MAXIMUM = wp.float64(2.0**30)

    @wp.kernel(module=name, enable_backward=False)
    def measure_arcs(
        # network
        channels: Channels,
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

        Each chunk notes the length that it adds, in quanta. A slab skips inactive channels.
        """
        if work.status[HALT] != 0:
            return
        k = work.first + wp.tid()
        arc = wp.float64(0.0)
        run = line.begin_runs(channels, work, k)
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if work.chunk == 0:
                arc = wp.float64(0.0)
            if work.chunk > 0 or run.step > ZERO:
                here = point_moved[run.begin]
                if run.begin > run.first:
                    arc += line.whole_quanta(wp.length(here - point_moved[run.begin - 1]))
                point_arc_out[run.begin] = arc
                for j in range(run.begin + 1, run.stop):
                    after = point_moved[j]
                    arc += line.whole_quanta(wp.length(after - here))
                    point_arc_out[j] = arc
                    here = after
        if work.chunk > 0:
            if arc < FARTHEST:
                chunk_length_out[k] = wp.int64(arc * QUANTA)
            else:
                # Nothing of this step is committed, so that the state before the fault can still be looked at.
                chunk_length_out[k] = wp.int64(0)
                wp.atomic_max(status_io, FAULT, FAULT_NOT_FINITE)

    @wp.kernel(module=name, enable_backward=False)
    def count_samples(
        # network
        channels: Channels,
        # params
        work: Work,
        # in
        point_moved: wp.array[vec2],
        arcs: Arcs,
        # out
        channel_samples_out: wp.array[int],
        channel_spacing_out: wp.array[scalar],
        status_io: wp.array[int],
    ):
        """Number of new points of each channel, from its length and the target spacing, and the even spacing.

        A ring has as many points as segments. An inactive channel keeps its points. One without length, or longer than
        any river, is a fault.
        """
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            if channels.step[channel] == ZERO:
                channel_samples_out[channel] = channels.start[channel + 1] - channels.start[channel]
                channel_spacing_out[channel] = channels.spacing[channel]
            else:
                run = line.whole_run(channels, channel)
                length = line.length_of(point_moved, arcs, run)
                pieces = int(-1)
                needed = length / wp.float64(run.form.target_spacing)
                if length > ZERO_64 and length < FARTHEST and needed < MAXIMUM:
                    minimum = int(2)
                    if run.closed != 0:
                        minimum = RING_POINTS
                    pieces = wp.max(minimum, int(needed + HALF_64))
                    channel_spacing_out[channel] = scalar(length / wp.float64(pieces))
                else:
                    wp.atomic_max(status_io, FAULT, FAULT_NOT_FINITE)
                channel_samples_out[channel] = pieces + 1 - run.closed

    @wp.func(module=name)
    def kept_after(point: wp.array[vec2], i: int, run: Run) -> int:
        """Next point that is not a copy of point i (a cutoff leaves copies behind); i + 1 beyond the channel's end.

        Indices of a ring go on beyond its ends, round and round.
        """
        j = i + 1
        if run.closed != 0:
            here = point[line.round_index(i, run)]
            while j <= i + run.last - run.first and point[line.round_index(j, run)] == here:
                j += 1
            return j
        while j < run.last and point[j] == point[i]:
            j += 1
        return j

    @wp.func(module=name)
    def kept_before(point: wp.array[vec2], i: int, run: Run) -> int:
        """Last point before i that is not a copy of it; beyond the channel's head i - 1, or first - 1."""
        j = i - 1
        if run.closed != 0:
            here = point[line.round_index(i, run)]
            while j >= i - run.last + run.first and point[line.round_index(j, run)] == here:
                j -= 1
            return j
        while j >= run.first and point[j] == point[wp.max(i, run.first)]:
            j -= 1
        return j

    @wp.func(module=name)
    def kept_beyond(point: wp.array[vec2], junction: int, farthest: int, count: int) -> vec2:
        """The kept point that comes so many after the first one of the next link, seen from its end at a junction."""
        step = wp.where(farthest > junction, 1, -1)
        j = int(junction)
        for _k in range(count):
            here = point[j]
            while j != farthest and point[j] == here:
                j += step
        return point[j]

    @wp.func(module=name)
    def kept_point(point: wp.array[vec2], i: int, run: Run) -> vec2:
        """Point i; beyond an end the kept point of the next link, or of the ring.

        Where nothing goes on, the kept points inside are reflected: by the point at the end, or by the edge of the map.
        """
        if i >= run.first and i <= run.last:
            return point[i]
        if run.closed != 0:
            return point[line.round_index(i, run)]
        if i < run.first and run.upper >= 0:
            return kept_beyond(point, run.head, run.head_first, run.first - i)
        if i > run.last and run.lower >= 0:
            return kept_beyond(point, run.foot, run.foot_last, i - run.last)
        j = int(run.last)
        beyond = i - run.last
        step = int(-1)
        if i < run.first:
            j = int(run.first)
            beyond = run.first - i
            step = 1
        end = point[j]
        for _k in range(beyond):
            if step < 0:
                j = wp.max(kept_before(point, j, run), run.first)
            else:
                j = wp.min(kept_after(point, j, run), run.last)
        if step < 0 and run.edge != EDGE_NONE:
            return line.mirrored(point[j], end, run.edge)
        return TWO * end - point[j]

    @wp.func(module=name)
    def next_point(point: wp.array[vec2], i: int, here: vec2, run: Run):
        """Kept point after point i, which lies ``here``, and where it lies itself."""
        j = i + 1
        if j < run.last:
            ahead = point[j]
            if not (ahead == here):
                return j, ahead
        # At the end of a line, round a ring, or where a cutoff left copies.
        j = kept_after(point, i, run)
        return j, kept_point(point, j, run)

    @wp.func(module=name)
    def segment_of(point: wp.array[vec2], arcs: Arcs, head: ArcPlace, run: Run, target: wp.float64) -> int:
        """First point of the segment of a channel that holds an arc length from its head (binary search)."""
        low = int(run.first)
        high = run.last + run.closed
        while high - low > 1:
            middle = (low + high) // 2
            if line.arc_from(arcs, head, middle) <= target:
                low = middle
            else:
                high = middle
        while low > run.first and point[low] == point[low - 1]:
            low -= 1
        return low

    @wp.func(module=name)
    def arc_beyond(arcs: Arcs, head: ArcPlace, run: Run, length: wp.float64, i: int) -> wp.float64:
        """Arc length of a point; the index of a ring may go on beyond its end, into the next lap."""
        if i > run.last:
            return length + line.arc_from(arcs, head, i - run.last - 1 + run.first)
        return line.arc_from(arcs, head, i)

    @wp.func(module=name)
    def hermite(b: vec2, c: vec2, tangent_b: vec2, tangent_c: vec2, size: scalar, u: scalar) -> vec2:
        """Point at the fraction u of the cubic from b to c with those unit-speed tangents."""
        v = ONE - u
        blend = u * u * (THREE - TWO * u)
        return b + blend * (c - b) + (size * u * v) * (v * tangent_b - u * tangent_c)

    @wp.func(module=name)
    def sweep_samples(moved: Points, arcs: Arcs, old: Run, new: Run, sampled_out: Points):
        """Write a run of new points of a channel, marching down its old segments with a rolling window."""
        spacing = wp.float64(new.spacing)
        head = line.arc_place(arcs, old.first)
        target = spacing * wp.float64(new.begin - new.first)
        ib = segment_of(moved.xy, arcs, head, old, target)
        ia = kept_before(moved.xy, ib, old)
        ic = kept_after(moved.xy, ib, old)
        id = kept_after(moved.xy, ic, old)
        ie = kept_after(moved.xy, id, old)
        z = kept_point(moved.xy, kept_before(moved.xy, ia, old), old)
        a = kept_point(moved.xy, ia, old)
        b = kept_point(moved.xy, ib, old)
        c = kept_point(moved.xy, ic, old)
        d = kept_point(moved.xy, id, old)
        e = kept_point(moved.xy, ie, old)
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
        length = line.length_of(moved.xy, arcs, old)
        arc_b = line.arc_from(arcs, head, ib)
        arc_c = arc_beyond(arcs, head, old, length, ic)
        for k in range(new.begin, new.stop):
            target = spacing * wp.float64(k - new.first)
            while arc_c < target and ic < old.last + old.closed:
                ib = ic
                ic = id
                id = ie
                b = c
                c = d
                d = e
                ie, e = next_point(moved.xy, ie, d, old)
                bc = cd
                cd = de
                de = wp.length(e - d)
                tb = tc
                tc = td
                td = line.central_tangent(d - c, e - d, cd, de)
                tangent_b = tangent_c
                tangent_c = line.fourth_order_tangent(tb, tc, td, bc, cd)
                arc_b = arc_c
                arc_c = arc_beyond(arcs, head, old, length, ic)
            u = scalar(0.0)
            if k > new.first and arc_c > arc_b:
                u = wp.clamp(scalar((target - arc_b) / (arc_c - arc_b)), ZERO, ONE)
            if k == new.last and old.closed == 0:
                ib = old.last
                b = moved.xy[ib]
                u = ZERO
            sampled_out.xy[k] = hermite(b, c, tangent_b, tangent_c, bc, u)
            if moved.section:
                before = kept_point(moved.section, ib, old)
                sampled_out.section[k] = (ONE - u) * before + u * kept_point(moved.section, ic, old)

    @wp.kernel(module=name, enable_backward=False)
    def resample_points(
        # network
        channels: Channels,
        # params
        work: Work,
        # in
        samples: Channels,
        moved: Points,
        arcs: Arcs,
        # out
        sampled_out: Points,
    ):
        """Sample the cubic through the moved points at the even spacing; both ends of a channel stay where they are.

        ``samples`` are the same channels with their new points. A ring begins where its first point is. The points of
        an inactive channel stay as they are.
        """
        count = samples.start.shape[0] - 1
        if work.status[FAULT] != 0 or samples.start[count] > sampled_out.xy.shape[0]:
            return
        run = line.begin_runs(samples, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(samples, run)
            if run.step > ZERO:
                sweep_samples(moved, arcs, line.whole_run(channels, run.channel), run, sampled_out)
            else:
                shift = channels.start[run.channel] - run.first
                for j in range(run.begin, run.stop):
                    sampled_out.xy[j] = moved.xy[j + shift]
                    if moved.section:
                        sampled_out.section[j] = moved.section[j + shift]

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
        """Commit the new starts and spacings and count the sub-step, unless it failed or its points do not fit.

        ``keep_plan``: 1 where the plan of one step holds for the next. Where the goal is no step, lines are sampled
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
        measure_arcs=measure_arcs,
        count_samples=count_samples,
        resample_points=resample_points,
        commit_step=commit_step,
    )
