"""Neck cutoffs: pairs of points of one channel that come close are found on a grid, and the loops between them cut."""

import functools
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, polyline
from warpriver.kernels.polyline import CUT_POINTS, CUTS, DONE, FAULT, FAULT_OXBOWS_FULL, HALT, RING_POINTS, Work

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the cutoff kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.cutoffs_{scalar.__name__}"
    line, table = polyline.build(scalar), buckets.build(scalar)
    vec2, vec4, bucket_mask = line.vec2, line.vec4, table.bucket_mask
    ZERO, HALF = scalar(0.0), scalar(0.5)

    @wp.kernel(module=name, enable_backward=False)
    def insert_points(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_step: wp.array[scalar],
        # params
        cutoff_distance: scalar,
        work: Work,
        # in
        point_moved: wp.array[vec2],
        # out
        point_next_out: wp.array[int],
        bucket_row_out: wp.array[wp.vec4i],
        bucket_head_io: wp.array[int],
    ):
        """Link every point into its channel's grid cell that holds it; a cell is two cutoff distances wide.

        Each channel has its own buckets, from four times its first point on, so that they lie close in memory. Channels
        whose step is 0 rest. ``bucket_row_out`` is the table once more, by fours: so it is emptied in fewer stores.
        """
        share = line.point_range(work, channel_start, channel_form.shape[0], work.first + wp.tid())
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            stop = wp.min(end, channel_start[channel + 1])
            if channel_step[channel] > ZERO:
                mask = bucket_mask(channel_start[channel + 1] - first)
                if work.chunk == 0:
                    # The thread has the channel for itself, and just now in its cache.
                    for row in range(first, first + (mask + 1) // 4):
                        bucket_row_out[row] = wp.vec4i(0, 0, 0, 0)
                per_cell = HALF / (cutoff_distance * channel_form[channel][2])
                for j in range(i, stop):
                    p = point_moved[j] * per_cell
                    cell = 4 * first + table.bucket_of(table.floor_int(p[0]), table.floor_int(p[1]), mask)
                    # The head holds point + 1, so that a zeroed table is an empty one.
                    point_next_out[j] = wp.atomic_exch(bucket_head_io, cell, j + 1)
            i = stop
            channel += 1

    @wp.func(module=name)
    def nearest_after(
        point: wp.array[vec2],
        section: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        first: int,
        mask: int,
        i: int,
        nearest: int,
        lowest: int,
        last: int,
        ring_points: int,
        per_cell: scalar,
        radius: scalar,
        cutoff_distance: scalar,
        min_arc: scalar,
    ) -> int:
        """First point from ``nearest`` on, up to ``last``, that is closer to point i than the radius.

        A list is left at its first entry below ``lowest``. ``ring_points``: those of a ring, 0 on a line.
        """
        here = point[i]
        x0 = table.floor_int(here[0] * per_cell - HALF)
        y0 = table.floor_int(here[1] * per_cell - HALF)
        found = int(last + 1)
        head = wp.vec4i(
            bucket_head[4 * first + table.bucket_of(x0, y0, mask)],
            bucket_head[4 * first + table.bucket_of(x0 + 1, y0, mask)],
            bucket_head[4 * first + table.bucket_of(x0, y0 + 1, mask)],
            bucket_head[4 * first + table.bucket_of(x0 + 1, y0 + 1, mask)],
        )
        # Mostly nothing is near: one branch for all four cells tells.
        if wp.max(head) <= lowest:
            return found
        for corner in range(4):
            j = head[corner] - 1
            while j >= lowest:
                if j >= nearest and j < found:
                    reach = radius
                    if section:
                        width = HALF * (section[i][0] + section[j][0])
                        reach = cutoff_distance * width
                        apart = int(j - i)
                        if ring_points > 0:
                            apart = wp.min(apart, ring_points - apart)
                        if scalar(apart) <= min_arc * width:
                            reach = scalar(0.0)
                    if wp.length_sq(point[j] - here) < reach * reach:
                        found = j
                j = point_next[j] - 1
        return found

    @wp.kernel(module=name, enable_backward=False)
    def find_necks(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        # params
        cutoff_distance: scalar,
        cutoff_min_arc: scalar,
        work: Work,
        ordered: int,
        # in
        point_moved: wp.array[vec2],
        section_moved: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        # out
        point_neck_out: wp.array[int],
        chunk_necks_io: wp.array[int],
        channel_necks_io: wp.array[int],
    ):
        """First later point of the same channel closer than the cutoff distance, -1 if none: |p_i - p_j| < w.

        Points no more than ``cutoff_min_arc`` widths apart along the channel, either way round on a ring, are
        neighbours [Howard1984]. Where points were inserted in order (``ordered``: on the CPU), the lists descend, and
        most end before their first entry.
        """
        k = work.first + wp.tid()
        share = line.point_range(work, channel_start, channel_form.shape[0], k)
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            necks = int(0)
            if channel_step[channel] > ZERO:
                mask = bucket_mask(last + 1 - first)
                form = channel_form[channel]
                radius = cutoff_distance * form[2]
                min_arc = cutoff_min_arc / channel_spacing[channel]
                apart = int(min_arc * form[2]) + 1
                ring_points = line.closed_at(channel_closed, channel) * (last + 1 - first)
                limit = int(last)
                for j in range(i, stop):
                    if section_moved:
                        # The other point may be narrower: its width is looked at where it is found.
                        apart = int(HALF * min_arc * section_moved[j][0]) + 1
                    if ring_points > 0:
                        limit = wp.min(last, j + ring_points - apart)
                    found = nearest_after(
                        point_moved, section_moved, point_next, bucket_head, first, mask, j, j + apart,
                        ordered * (j + apart), limit, ring_points, HALF / radius, radius, cutoff_distance, min_arc,
                    )  # fmt: skip
                    if found > limit:
                        found = -1
                    else:
                        necks += 1
                    point_neck_out[j] = found
            if work.chunk == 0:
                channel_necks_io[channel] = necks
            elif necks > 0:
                chunk_necks_io[k] += necks
                wp.atomic_add(channel_necks_io, channel, necks)
            i = stop
            channel += 1

    @wp.func(module=name)
    def neck_range(work: Work, chunk_necks: wp.array[int], first: int, stop: int, k: int) -> wp.vec2i:
        """Points of the k-th piece of a channel in which necks may begin; none where its chunk has none."""
        if work.chunk > 0 and chunk_necks[first // work.chunk + k] == 0:
            return wp.vec2i(stop, stop)
        return line.piece_range(work, first, stop, k)

    @wp.func(module=name)
    def select_on_line(
        work: Work, chunk_necks: wp.array[int], first: int, stop: int, point_neck_io: wp.array[int]
    ) -> wp.vec2i:
        """Keep every neck of a line that begins at or after the end of the one before; return cuts and their points."""
        cuts = int(0)
        points = int(0)
        cursor = int(first)
        for k in range(line.piece_count(work, first, stop)):
            piece = neck_range(work, chunk_necks, first, stop, k)
            for i in range(piece[0], piece[1]):
                j = point_neck_io[i]
                if j >= 0:
                    if i >= cursor:
                        cuts += 1
                        points += j - i + 1
                        cursor = j
                    else:
                        point_neck_io[i] = -1
        return wp.vec2i(cuts, points)

    @wp.func(module=name)
    def select_on_ring(
        work: Work, keep_longer: int, chunk_necks: wp.array[int], first: int, stop: int, point_neck_io: wp.array[int]
    ) -> wp.vec2i:
        """As ``select_on_line``, but a neck i, j may cut off what lies outside of i .. j: -2 - j stands for that.

        It does where ``keep_longer`` is set and the inside is the longer part of what is left of the ring; loops found
        before it lie outside and go with it. One such cut a step: what more there are is found again in the next.
        """
        cuts = int(0)
        points = int(0)
        left = stop - first
        cursor = int(first)
        limit = int(stop)
        for k in range(line.piece_count(work, first, stop)):
            piece = neck_range(work, chunk_necks, first, stop, k)
            for i in range(piece[0], piece[1]):
                j = point_neck_io[i]
                if j >= 0:
                    inside = j - i
                    outside = left - inside
                    point_neck_io[i] = -1
                    if i >= cursor and j <= limit and (keep_longer == 0 or inside <= outside):
                        if outside >= RING_POINTS:
                            point_neck_io[i] = j
                            cuts += 1
                            points += inside + 1
                            left = outside
                            cursor = j
                    elif i >= cursor and limit == stop and inside >= RING_POINTS:
                        for m in range(first, i):
                            point_neck_io[m] = -1
                        point_neck_io[i] = -2 - j
                        cuts = 1
                        points = stop - first - inside + 1
                        left = inside
                        cursor = i
                        limit = j
        return wp.vec2i(cuts, points)

    @wp.kernel(module=name, enable_backward=False)
    def select_cuts(
        # network
        channel_start: wp.array[int],
        channel_closed: wp.array[int],
        # params
        keep_longer: int,
        work: Work,
        # in
        chunk_necks: wp.array[int],
        channel_necks: wp.array[int],
        # out
        channel_cuts_out: wp.array[int],
        channel_cut_points_out: wp.array[int],
        point_neck_io: wp.array[int],
    ):
        """Keep, from the head of each channel down, every neck that begins at or after the end of the one before."""
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            kept = wp.vec2i(0, 0)
            if channel_necks[channel] > 0:
                first = channel_start[channel]
                stop = channel_start[channel + 1]
                if line.closed_at(channel_closed, channel) != 0:
                    kept = select_on_ring(work, keep_longer, chunk_necks, first, stop, point_neck_io)
                else:
                    kept = select_on_line(work, chunk_necks, first, stop, point_neck_io)
            channel_cuts_out[channel] = kept[0]
            channel_cut_points_out[channel] = kept[1]

    @wp.func(module=name)
    def save_loop(
        section_moved: wp.array[vec2],
        i: int,
        j: int,
        offset: int,
        oxbow_xy_out: wp.array[vec2],
        oxbow_section_out: wp.array[vec2],
        point_moved_io: wp.array[vec2],
    ):
        """Save the points i .. j of a loop and pull all but the last onto the first."""
        here = point_moved_io[i]
        for m in range(i, j + 1):
            oxbow_xy_out[offset + m - i] = point_moved_io[m]
            if section_moved:
                oxbow_section_out[offset + m - i] = section_moved[m]
            if m < j:
                point_moved_io[m] = here

    @wp.func(module=name)
    def save_outside(
        section_moved: wp.array[vec2],
        first: int,
        last: int,
        i: int,
        j: int,
        offset: int,
        oxbow_xy_out: wp.array[vec2],
        oxbow_section_out: wp.array[vec2],
        point_moved_io: wp.array[vec2],
    ):
        """Save the points j .. last, first .. i of a ring and pull all but the last of them onto point j."""
        here = point_moved_io[j]
        count = last - j + 1 + i - first + 1
        for m in range(count):
            k = line.round_index(j + m, first, last)
            oxbow_xy_out[offset + m] = point_moved_io[k]
            if section_moved:
                oxbow_section_out[offset + m] = section_moved[k]
            if m < count - 1:
                point_moved_io[k] = here

    @wp.kernel(module=name, enable_backward=False)
    def cut_necks(
        # network
        channel_start: wp.array[int],
        # params
        work: Work,
        # in
        chunk_necks: wp.array[int],
        channel_cuts_sum: wp.array[int],
        channel_cut_points_sum: wp.array[int],
        point_neck: wp.array[int],
        section_moved: wp.array[vec2],
        # out
        cut_out: wp.array[wp.vec4i],
        oxbow_xy_out: wp.array[vec2],
        oxbow_section_out: wp.array[vec2],
        point_moved_io: wp.array[vec2],
        status_io: wp.array[int],
    ):
        """Save each cut loop, ends included, and pull its inner points onto the point where it begins.

        A cut is recorded as (channel, first loop point in the buffer, number of points, sub-steps done before), in the
        order of the packed points, after those of the sub-steps before; on a ring, what is cut off may be the part that
        holds its first point: what lies outside of i .. j for -2 - j, or what begins at i and goes round to an earlier
        j. The copies left behind have no length; resampling passes over them.
        """
        if status_io[HALT] != 0:
            return
        count = channel_start.shape[0] - 1
        cuts_before = status_io[CUTS]
        points_before = status_io[CUT_POINTS]
        if (
            cuts_before + channel_cuts_sum[count - 1] > cut_out.shape[0]
            or points_before + channel_cut_points_sum[count - 1] > oxbow_xy_out.shape[0]
        ):
            wp.atomic_max(status_io, FAULT, FAULT_OXBOWS_FULL)
            return
        share = line.channel_range(work, work.first + wp.tid())
        for channel in range(share[0], share[1]):
            slot = int(cuts_before)
            offset = int(points_before)
            if channel > 0:
                slot += channel_cuts_sum[channel - 1]
                offset += channel_cut_points_sum[channel - 1]
            if cuts_before + channel_cuts_sum[channel] > slot:
                first = channel_start[channel]
                stop = channel_start[channel + 1]
                for k in range(line.piece_count(work, first, stop)):
                    piece = neck_range(work, chunk_necks, first, stop, k)
                    for i in range(piece[0], piece[1]):
                        j = point_neck[i]
                        if j < -1:
                            count = stop - first - (-2 - j - i) + 1
                            cut_out[slot] = wp.vec4i(channel, offset, count, status_io[DONE])
                            save_outside(
                                section_moved, first, stop - 1, i, -2 - j, offset, oxbow_xy_out, oxbow_section_out,
                                point_moved_io,
                            )  # fmt: skip
                            slot += 1
                            offset += count
                        if j >= 0 and j < i:
                            count = stop - first - (i - j) + 1
                            cut_out[slot] = wp.vec4i(channel, offset, count, status_io[DONE])
                            save_outside(
                                section_moved, first, stop - 1, j, i, offset, oxbow_xy_out, oxbow_section_out,
                                point_moved_io,
                            )  # fmt: skip
                            slot += 1
                            offset += count
                        if j > i:
                            cut_out[slot] = wp.vec4i(channel, offset, j - i + 1, status_io[DONE])
                            save_loop(section_moved, i, j, offset, oxbow_xy_out, oxbow_section_out, point_moved_io)
                            slot += 1
                            offset += j - i + 1

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        insert_points=insert_points,
        find_necks=find_necks,
        select_cuts=select_cuts,
        cut_necks=cut_necks,
    )
