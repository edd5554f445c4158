"""Neck cutoffs: pairs of points of one channel that come close are found on a grid, and the loops between them cut."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, polyline
from warpriver.kernels.channels import RING_POINTS, Marks, Work
from warpriver.kernels.status import (
    CUT_POINTS,
    CUT_POINTS_NEEDED,
    CUTS,
    CUTS_NEEDED,
    DONE,
    FAULT,
    FAULT_OXBOWS_FULL,
    HALT,
)
from warpriver.kernels.variants import named, once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the cutoff kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.cutoffs_{scalar.__name__}"
    line, table = polyline.build(scalar), buckets.build(scalar)
    vec2, Form, bucket_mask = line.vec2, line.Form, table.bucket_mask
    ZERO, HALF = scalar(0.0), scalar(0.5)

    @wp.kernel(module=name, enable_backward=False)
    def insert_points(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[Form],
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
        A bucket is the last point linked into it + 1; with chunks, which link in any order, its highest point + 1, too.
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
                per_cell = HALF / (cutoff_distance * channel_form[channel].widest)
                fields = 1 + wp.min(work.chunk, 1)
                for j in range(i, stop):
                    p = point_moved[j] * per_cell
                    cell = 4 * first + table.bucket_of(table.floor_int(p[0]), table.floor_int(p[1]), mask)
                    # Point + 1, so that a zeroed table is an empty one.
                    point_next_out[j] = wp.atomic_exch(bucket_head_io, fields * cell, j + 1)
                    if fields == 2:
                        wp.atomic_max(bucket_head_io, 2 * cell + 1, j + 1)
            i = stop
            channel += 1

    def neck_search(kernel_name, fields):
        """Make the search for necks where a bucket has so many fields.

        One: the first entry of a list that descends, as slabs make it. Two: that of a list in any order, and the
        highest.
        """
        FIELDS, TOP = fields, fields - 1

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
            last: int,
            ring_points: int,
            per_cell: scalar,
            radius: scalar,
            cutoff_distance: scalar,
            min_arc: scalar,
        ) -> int:
            """First point from ``nearest`` on, up to ``last``, that is closer to point i than the radius.

            A list that descends is left at its first entry below ``nearest``.
            ``ring_points``: those of a ring, 0 on a line.
            """
            here = point[i]
            x0 = table.floor_int(here[0] * per_cell - HALF)
            y0 = table.floor_int(here[1] * per_cell - HALF)
            found = int(last + 1)
            bucket = FIELDS * wp.vec4i(
                4 * first + table.bucket_of(x0, y0, mask),
                4 * first + table.bucket_of(x0 + 1, y0, mask),
                4 * first + table.bucket_of(x0, y0 + 1, mask),
                4 * first + table.bucket_of(x0 + 1, y0 + 1, mask),
            )
            highest = wp.vec4i(
                bucket_head[bucket[0] + TOP],
                bucket_head[bucket[1] + TOP],
                bucket_head[bucket[2] + TOP],
                bucket_head[bucket[3] + TOP],
            )
            # Mostly nothing is near: one branch for all four cells tells.
            if wp.max(highest) <= nearest:
                return found
            lowest = nearest * (1 - TOP)
            for corner in range(4):
                j = highest[corner] - 1
                if TOP > 0:
                    j = wp.where(j >= nearest, bucket_head[bucket[corner]], 0) - 1
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
        @named(kernel_name)
        def find_necks(
            # network
            channel_start: wp.array[int],
            channel_form: wp.array[Form],
            channel_spacing: wp.array[scalar],
            channel_step: wp.array[scalar],
            channel_closed: wp.array[int],
            # params
            cutoff_distance: scalar,
            cutoff_min_arc: scalar,
            work: Work,
            # in
            point_moved: wp.array[vec2],
            section_moved: wp.array[vec2],
            point_next: wp.array[int],
            bucket_head: wp.array[int],
            # out
            point_neck_out: wp.array[int],
            chunk_mark_out: wp.array[wp.vec2i],
            share_cut_out: wp.array[wp.vec2i],
            channel_necks_out: wp.array[int],
        ):
            """First later point of the same channel closer than the cutoff distance, -1 if none: |p_i - p_j| < w.

            Points no more than ``cutoff_min_arc`` widths apart along the channel, either way round on a ring, are
            neighbours [Howard1984]. A slab, which linked its points in order, has lists that descend: most end before
            their first entry. It counts the necks of its channels; a chunk is marked where it has any, (1, last point
            that a neck of it reaches). The cuts of the share are cleared.
            """
            k = work.first + wp.tid()
            if work.status[HALT] != 0:
                return
            share = line.point_range(work, channel_start, channel_form.shape[0], k)
            i = int(share[0])
            end = share[1]
            channel = int(share[2])
            reach = int(0)
            while i < end:
                first = channel_start[channel]
                last = channel_start[channel + 1] - 1
                stop = wp.min(end, last + 1)
                necks = int(0)
                if channel_step[channel] > ZERO:
                    mask = bucket_mask(last + 1 - first)
                    form = channel_form[channel]
                    radius = cutoff_distance * form.widest
                    min_arc = cutoff_min_arc / channel_spacing[channel]
                    apart = int(min_arc * form.widest) + 1
                    ring_points = line.closed_at(channel_closed, channel) * (last + 1 - first)
                    limit = int(last)
                    for j in range(i, stop):
                        if section_moved:
                            # The other point may be narrower: its width is looked at where it is found.
                            apart = int(HALF * min_arc * section_moved[j][0]) + 1
                        if ring_points > 0:
                            limit = wp.min(last, j + ring_points - apart)
                        found = nearest_after(
                            point_moved, section_moved, point_next, bucket_head, first, mask, j, j + apart, limit,
                            ring_points, HALF / radius, radius, cutoff_distance, min_arc,
                        )  # fmt: skip
                        if found > limit:
                            found = -1
                        else:
                            necks += 1
                        reach = wp.max(reach, found)
                        point_neck_out[j] = found
                elif work.chunk > 0:
                    for j in range(i, stop):
                        point_neck_out[j] = -1
                if work.chunk == 0:
                    channel_necks_out[channel] = necks
                i = stop
                channel += 1
            share_cut_out[k] = wp.vec2i(0, 0)
            if work.chunk > 0:
                # No neck ends at the first of all points.
                chunk_mark_out[k] = wp.vec2i(wp.min(reach, 1), reach)

        return find_necks

    @wp.kernel(module=name, enable_backward=False)
    def list_marks(
        # in
        chunk_mark_sum: wp.array[wp.vec2i],
        # out
        mark_place_out: wp.array[int],
        mark_chunk_out: wp.array[int],
    ):
        """List the chunks that are marked, in ascending order, and how many lie before each; see ``Marks``.

        ``chunk_mark_sum`` is the running sum of the marks.
        """
        k = wp.tid()
        before = int(0)
        if k > 0:
            before = chunk_mark_sum[k - 1][0]
        mark_place_out[k] = before
        after = chunk_mark_sum[k][0]
        if after > before:
            mark_chunk_out[before] = k
        if k == chunk_mark_sum.shape[0] - 1:
            mark_place_out[k + 1] = after

    @wp.func(module=name)
    def note_cut(
        work: Work, k: int, i: int, j: int, points: int, point_cut_out: wp.array[int], share_cut_io: wp.array[wp.vec2i]
    ):
        """Note that the loop between points i and j is cut off, with how many points, where it begins."""
        point_cut_out[i] = j
        wp.atomic_add(share_cut_io, line.share_of(work, k, i), wp.vec2i(1, points))

    @wp.func(module=name)
    def select_on_line(
        work: Work,
        marks: Marks,
        share: int,
        begin: int,
        stop: int,
        point_neck: wp.array[int],
        point_cut_out: wp.array[int],
        share_cut_io: wp.array[wp.vec2i],
    ):
        """Keep every neck of a line from ``begin`` on that begins at or after the end of the one kept before.

        A chunk ends where no neck reaches beyond any more: there the next cluster of necks begins, of which it does not
        depend on those before what is kept.
        """
        cursor = int(begin)
        reach = int(begin)
        k = int(0)
        pieces = line.piece_count(work, marks, begin, stop)
        while k < pieces:
            piece = line.piece_range(work, marks, begin, stop, k)
            k += 1
            for i in range(piece[0], piece[1]):
                j = point_neck[i]
                if j >= 0:
                    if work.chunk > 0 and i >= reach and i > begin:
                        return
                    reach = wp.max(reach, j)
                    if i >= cursor:
                        note_cut(work, share, i, j, j - i + 1, point_cut_out, share_cut_io)
                        cursor = j
                    else:
                        point_cut_out[i] = -1

    @wp.func(module=name)
    def forget_cuts(
        work: Work,
        marks: Marks,
        share: int,
        first: int,
        stop: int,
        point_neck: wp.array[int],
        point_cut_io: wp.array[int],
        share_cut_io: wp.array[wp.vec2i],
    ):
        """Take back the cuts of a ring that begin before ``stop``."""
        for k in range(line.piece_count(work, marks, first, stop)):
            piece = line.piece_range(work, marks, first, stop, k)
            for i in range(piece[0], piece[1]):
                if point_neck[i] >= 0 and point_cut_io[i] >= 0:
                    points = point_cut_io[i] - i + 1
                    wp.atomic_add(share_cut_io, line.share_of(work, share, i), wp.vec2i(-1, -points))
                    point_cut_io[i] = -1

    @wp.func(module=name)
    def select_on_ring(
        work: Work,
        marks: Marks,
        share: int,
        keep_longer: int,
        first: int,
        stop: int,
        point_neck: wp.array[int],
        point_cut_io: wp.array[int],
        share_cut_io: wp.array[wp.vec2i],
    ):
        """As ``select_on_line``, but a neck i, j may cut off what lies outside of i .. j: -2 - j stands for that.

        It does where ``keep_longer`` is set and the inside is the longer part of what is left of the ring; loops found
        before it lie outside and go with it. One such cut a step: what more there are is found again in the next.
        """
        left = stop - first
        cursor = int(first)
        limit = int(stop)
        for k in range(line.piece_count(work, marks, first, stop)):
            piece = line.piece_range(work, marks, first, stop, k)
            for i in range(piece[0], piece[1]):
                j = point_neck[i]
                if j >= 0:
                    inside = j - i
                    outside = left - inside
                    point_cut_io[i] = -1
                    if i >= cursor and j <= limit and (keep_longer == 0 or inside <= outside):
                        if outside >= RING_POINTS:
                            note_cut(work, share, i, j, inside + 1, point_cut_io, share_cut_io)
                            left = outside
                            cursor = j
                    elif i >= cursor and limit == stop and inside >= RING_POINTS:
                        forget_cuts(work, marks, share, first, i, point_neck, point_cut_io, share_cut_io)
                        note_cut(work, share, i, -2 - j, stop - first - inside + 1, point_cut_io, share_cut_io)
                        left = inside
                        cursor = i
                        limit = j

    @wp.kernel(module=name, enable_backward=False)
    def select_cuts(
        # network
        channel_start: wp.array[int],
        channel_closed: wp.array[int],
        # params
        keep_longer: int,
        work: Work,
        # in
        channel_necks: wp.array[int],
        chunk_mark_sum: wp.array[wp.vec2i],
        marks: Marks,
        point_neck: wp.array[int],
        # out
        point_cut_io: wp.array[int],
        share_cut_io: wp.array[wp.vec2i],
    ):
        """Keep, from the head of each channel down, every neck that begins at or after the end of the one before.

        Written for the points that have a neck: where it ends if it is cut, else -1. A slab takes its channels one by
        one; a chunk takes the rings that begin in it and the clusters of necks that do: a neck that no earlier one
        reaches beyond is kept, whatever those before are.
        """
        k = work.first + wp.tid()
        share = line.point_range(work, channel_start, channel_start.shape[0] - 1, k)
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        reach = int(0)
        if work.chunk > 0 and k > 0:
            reach = chunk_mark_sum[k - 1][1]
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            necked = work.chunk > 0
            if work.chunk == 0:
                necked = channel_necks[channel] > 0
            if necked and line.closed_at(channel_closed, channel) != 0:
                if i == first:
                    select_on_ring(work, marks, k, keep_longer, first, last + 1, point_neck, point_cut_io, share_cut_io)
            elif necked and work.chunk == 0:
                select_on_line(work, marks, k, first, last + 1, point_neck, point_cut_io, share_cut_io)
            elif necked and chunk_mark_sum[k][0] > marks.place[k]:
                for j in range(i, stop):
                    to = point_neck[j]
                    if to >= 0:
                        if j >= reach:
                            select_on_line(work, marks, k, j, last + 1, point_neck, point_cut_io, share_cut_io)
                        reach = wp.max(reach, to)
            i = stop
            channel += 1

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
            k = line.old_round_index(j + m, first, last)
            oxbow_xy_out[offset + m] = point_moved_io[k]
            if section_moved:
                oxbow_section_out[offset + m] = section_moved[k]
            if m < count - 1:
                point_moved_io[k] = here

    @wp.kernel(module=name, enable_backward=False)
    def record_cuts(
        # network
        channel_start: wp.array[int],
        # params
        work: Work,
        # in
        channel_necks: wp.array[int],
        share_cut: wp.array[wp.vec2i],
        share_cut_sum: wp.array[wp.vec2i],
        point_neck: wp.array[int],
        point_cut: wp.array[int],
        section_moved: wp.array[vec2],
        # out
        cut_out: wp.array[wp.vec4i],
        cut_span_out: wp.array[wp.vec2i],
        oxbow_xy_out: wp.array[vec2],
        oxbow_section_out: wp.array[vec2],
        point_moved_io: wp.array[vec2],
        status_io: wp.array[int],
    ):
        """Record each cut as (channel, first loop point in the buffer, number of points, sub-steps done before).

        They stand in the order of the packed points, after those of the sub-steps before. ``cut_span`` has the first
        and the last point of the loop. On a ring, what is cut off may be the part that holds its first point: what lies
        outside of i .. j for -2 - j, or what begins at i and goes round to an earlier j. That is saved at once, and its
        span is the point where it is noted.
        """
        if work.status[HALT] != 0:
            return
        k = work.first + wp.tid()
        total = share_cut_sum[share_cut_sum.shape[0] - 1]
        if k == 0:
            status_io[CUTS_NEEDED] = total[0]
            status_io[CUT_POINTS_NEEDED] = total[1]
        if (
            status_io[CUTS] + total[0] > cut_out.shape[0]
            or status_io[CUT_POINTS] + total[1] > oxbow_xy_out.shape[0]
        ):  # fmt: skip
            wp.atomic_max(status_io, FAULT, FAULT_OXBOWS_FULL)
            return
        if share_cut[k][0] == 0:
            return
        before = share_cut_sum[k] - share_cut[k]
        slot = status_io[CUTS] + before[0]
        offset = status_io[CUT_POINTS] + before[1]
        share = line.point_range(work, channel_start, channel_start.shape[0] - 1, k)
        i = int(share[0])
        channel = int(share[2])
        while i < share[1]:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(share[1], last + 1)
            if work.chunk == 0 and channel_necks[channel] == 0:
                i = stop
            while i < stop:
                j = int(-1)
                if point_neck[i] != -1:
                    j = point_cut[i]
                if j != -1:
                    # On a ring the loop may begin at ``head`` and go round to ``foot``, which lies before it.
                    head = wp.where(j < -1, -2 - j, i)
                    foot = wp.where(j < -1, i, j)
                    count = foot - head + 1
                    cut_span_out[slot] = wp.vec2i(i, foot)
                    if foot < head:
                        count += last + 1 - first
                        cut_span_out[slot] = wp.vec2i(i, i)
                        save_outside(
                            section_moved, first, last, foot, head, offset, oxbow_xy_out, oxbow_section_out,
                            point_moved_io,
                        )  # fmt: skip
                    cut_out[slot] = wp.vec4i(channel, offset, count, status_io[DONE])
                    slot += 1
                    offset += count
                i += 1
            channel += 1

    @wp.func(module=name)
    def first_cut(cut_span: wp.array[wp.vec2i], low: int, stop: int, point: int) -> int:
        """First of the cuts low .. stop - 1 that does not end before a point (binary search)."""
        at = int(low)
        high = int(stop)
        while at < high:
            middle = (at + high) // 2
            if cut_span[middle][1] < point:
                at = middle + 1
            else:
                high = middle
        return at

    @wp.kernel(module=name, enable_backward=False)
    def save_loops(
        # network
        channel_start: wp.array[int],
        # params
        work: Work,
        # in
        share_cut: wp.array[wp.vec2i],
        share_cut_sum: wp.array[wp.vec2i],
        cut: wp.array[wp.vec4i],
        cut_span: wp.array[wp.vec2i],
        section_moved: wp.array[vec2],
        status: wp.array[int],
        # out
        oxbow_xy_out: wp.array[vec2],
        oxbow_section_out: wp.array[vec2],
        point_moved_io: wp.array[vec2],
    ):
        """Save the points of each loop, ends included, and pull all but the last onto the point where it begins.

        A share does this for its own points, whichever share the loop begins in. The copies left behind have no
        length; resampling passes over them.
        """
        if work.status[HALT] != 0 or status[FAULT] == FAULT_OXBOWS_FULL:
            return
        k = work.first + wp.tid()
        begin = status[CUTS]
        stop = begin + share_cut_sum[share_cut_sum.shape[0] - 1][0]
        if begin == stop:
            return
        share = line.point_range(work, channel_start, channel_start.shape[0] - 1, k)
        m = int(0)
        if work.chunk == 0:
            stop = begin + share_cut_sum[k][0]
            m = stop - share_cut[k][0]
        else:
            m = first_cut(cut_span, begin, stop, share[0])
        while m < stop and cut_span[m][0] < share[1]:
            span = cut_span[m]
            if cut[m][2] == span[1] - span[0] + 1:
                offset = cut[m][1] - span[0]
                here = point_moved_io[span[0]]
                for i in range(wp.max(span[0], share[0]), wp.min(span[1] + 1, share[1])):
                    oxbow_xy_out[offset + i] = point_moved_io[i]
                    if section_moved:
                        oxbow_section_out[offset + i] = section_moved[i]
                    if i > span[0] and i < span[1]:
                        point_moved_io[i] = here
            m += 1

    return SimpleNamespace(
        vec2=vec2,
        Form=Form,
        insert_points=insert_points,
        find_necks=neck_search("find_necks", 1),
        find_necks_in_chunks=neck_search("find_necks_in_chunks", 2),
        list_marks=list_marks,
        select_cuts=select_cuts,
        record_cuts=record_cuts,
        save_loops=save_loops,
    )
