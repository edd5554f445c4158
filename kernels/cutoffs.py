"""Neck cutoffs: pairs of points of one channel that come close are found on a grid, and the loops between them cut."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, cuts, polyline
from warpriver.kernels.channels import RING_POINTS, Work
from warpriver.kernels.cuts import Cuts, Marks
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


@wp.struct
class Cut:
    """A loop that was cut off: its channel, its points in the buffer, and the sub-steps of the batch before it."""

    channel: int
    begin: int
    count: int
    substep: int


@once
def build(scalar):
    """Make the cutoff kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.cutoffs_{scalar.__name__}"
    line, table, chosen = polyline.build(scalar), buckets.build(scalar), cuts.build(scalar)
    vec2, Channels, Points, Run = line.vec2, line.Channels, line.Points, line.Run
    PointTable, Reach = table.PointTable, table.Reach
    ZERO, HALF = scalar(0.0), scalar(0.5)

    @wp.struct
    class Loops:
        """The loops that a batch of sub-steps cuts off, and their points end to end.

        ``span`` is the first and the last point of each in its channel; where it is one point, the loop has been saved.
        """

        cut: wp.array[Cut]
        span: wp.array[wp.vec2i]
        xy: wp.array[vec2]
        section: wp.array[vec2]

    @wp.kernel(module=name, enable_backward=False)
    def insert_points(
        # network
        channels: Channels,
        # params
        distance: scalar,
        work: Work,
        # in
        point_moved: wp.array[vec2],
        # out
        point_next_out: wp.array[int],
        bucket_row_out: wp.array[wp.vec4i],
        bucket_head_io: wp.array[int],
    ):
        """Link every point into its channel's grid cell that holds it; see ``PointTable``.

        Each channel has its own buckets, from four times its first point on, so that they lie close in memory. Inactive
        channels are skipped. ``bucket_row_out`` is the table once more, by fours: so it is emptied in fewer stores.
        A bucket is the last point linked into it + 1; with chunks, which link in any order, its highest point + 1, too.
        """
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            if run.step > ZERO:
                mask = table.bucket_mask(run.last + 1 - run.first)
                if work.chunk == 0:
                    # The thread has the channel for itself, and just now in its cache.
                    for row in range(run.first, run.first + (mask + 1) // 4):
                        bucket_row_out[row] = wp.vec4i(0, 0, 0, 0)
                per_cell = HALF / (distance * run.form.widest)
                fields = 1 + wp.min(work.chunk, 1)
                for j in range(run.begin, run.stop):
                    p = point_moved[j] * per_cell
                    cell = 4 * run.first + table.bucket_of(table.floor_int(p[0]), table.floor_int(p[1]), mask)
                    # Point + 1, so that a zeroed table is an empty one.
                    point_next_out[j] = wp.atomic_exch(bucket_head_io, fields * cell, j + 1)
                    if fields == 2:
                        wp.atomic_max(bucket_head_io, 2 * cell + 1, j + 1)

    def neck_search(kernel_name, fields):
        """Make the search for necks where a bucket has so many fields.

        One: the first entry of a list that descends, as slabs make it. Two: that of a list in any order, and the
        highest.
        """
        FIELDS, TOP = fields, fields - 1

        @wp.func(module=name)
        def nearest_after(
            moved: Points, near: PointTable, reach: Reach, ring_points: int, i: int, nearest: int, farthest: int
        ) -> int:
            """First point from ``nearest`` on, up to ``farthest``, that is closer to point i than the radius.

            A list that descends is left at its first entry before ``nearest``.
            ``ring_points``: those of a ring, 0 on a line.
            """
            here = moved.xy[i]
            x0 = table.floor_int(here[0] * reach.per_cell - HALF)
            y0 = table.floor_int(here[1] * reach.per_cell - HALF)
            found = int(farthest + 1)
            bucket = FIELDS * wp.vec4i(
                reach.first + table.bucket_of(x0, y0, reach.mask),
                reach.first + table.bucket_of(x0 + 1, y0, reach.mask),
                reach.first + table.bucket_of(x0, y0 + 1, reach.mask),
                reach.first + table.bucket_of(x0 + 1, y0 + 1, reach.mask),
            )
            highest = wp.vec4i(
                near.bucket_head[bucket[0] + TOP],
                near.bucket_head[bucket[1] + TOP],
                near.bucket_head[bucket[2] + TOP],
                near.bucket_head[bucket[3] + TOP],
            )
            # Mostly nothing is near: one branch for all four cells tells.
            if wp.max(highest) <= nearest:
                return found
            lowest = nearest * (1 - TOP)
            for corner in range(4):
                j = highest[corner] - 1
                if TOP > 0:
                    j = wp.where(j >= nearest, near.bucket_head[bucket[corner]], 0) - 1
                while j >= lowest:
                    if j >= nearest and j < found:
                        radius = reach.radius
                        if moved.section:
                            width = HALF * (moved.section[i][0] + moved.section[j][0])
                            radius = near.distance * width
                            apart = int(j - i)
                            if ring_points > 0:
                                apart = wp.min(apart, ring_points - apart)
                            if scalar(apart) <= reach.min_arc * width:
                                radius = scalar(0.0)
                        if wp.length_sq(moved.xy[j] - here) < radius * radius:
                            found = j
                    j = near.point_next[j] - 1
            return found

        @wp.kernel(module=name, enable_backward=False)
        @named(kernel_name)
        def find_necks(
            # network
            channels: Channels,
            # params
            work: Work,
            # in
            moved: Points,
            near: PointTable,
            # out
            cuts_out: Cuts,
            chunk_mark_out: wp.array[wp.vec2i],
        ):
            """First later point of the same channel closer than the cutoff distance, -1 if none: |p_i - p_j| < w.

            Points no more than ``near.min_arc`` widths apart along the channel, either way round on a ring, are
            neighbours [Howard1984]. A slab, which linked its points in order, has lists that descend: most end before
            their first entry. It counts the necks of its channels; a chunk is marked where it has any, (1, last point
            that a neck of it reaches). The cuts of the share are cleared.
            """
            k = work.first + wp.tid()
            if work.status[HALT] != 0:
                return
            farthest_neck = int(0)
            run = line.begin_runs(channels, work, k)
            while run.stop < run.end:
                run = line.next_run(channels, run)
                necks = int(0)
                if run.step > ZERO:
                    reach = table.reach_in(near, run)
                    apart = int(reach.min_arc * run.form.widest) + 1
                    ring_points = run.closed * (run.last + 1 - run.first)
                    limit = int(run.last)
                    for j in range(run.begin, run.stop):
                        if moved.section:
                            # The other point may be narrower: its width is looked at where it is found.
                            apart = int(HALF * reach.min_arc * moved.section[j][0]) + 1
                        if ring_points > 0:
                            limit = wp.min(run.last, j + ring_points - apart)
                        found = nearest_after(moved, near, reach, ring_points, j, j + apart, limit)
                        if found > limit:
                            found = -1
                        else:
                            necks += 1
                        farthest_neck = wp.max(farthest_neck, found)
                        cuts_out.point_neck[j] = found
                elif work.chunk > 0:
                    for j in range(run.begin, run.stop):
                        cuts_out.point_neck[j] = -1
                if work.chunk == 0:
                    cuts_out.channel_necks[run.channel] = necks
            cuts_out.share_cut[k] = wp.vec2i(0, 0)
            if work.chunk > 0:
                # No neck ends at the first of all points.
                chunk_mark_out[k] = wp.vec2i(wp.min(farthest_neck, 1), farthest_neck)

        return find_necks

    @wp.kernel(module=name, enable_backward=False)
    def list_marks(
        # in
        chunk_mark_sum: wp.array[wp.vec2i],
        # out
        mark_place_out: wp.array[int],
        mark_chunk_out: wp.array[int],
    ):
        """List the chunks that are marked, in ascending order, and how many lie before each; see ``Marks``."""
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
    def select_on_line(work: Work, marks: Marks, k: int, begin: int, stop: int, cuts_io: Cuts):
        """Keep every neck of a line from ``begin`` on that begins at or after the end of the one kept before.

        A chunk ends where no neck reaches beyond any more: there the next cluster of necks begins, of which it does not
        depend on those before what is kept.
        """
        cursor = int(begin)
        reach = int(begin)
        n = int(0)
        pieces = chosen.piece_count(work, marks, begin, stop)
        while n < pieces:
            piece = chosen.piece_range(work, marks, begin, stop, n)
            n += 1
            for i in range(piece[0], piece[1]):
                j = cuts_io.point_neck[i]
                if j >= 0:
                    if work.chunk > 0 and i >= reach and i > begin:
                        return
                    reach = wp.max(reach, j)
                    if i >= cursor:
                        chosen.note_cut(work, k, i, j, j - i + 1, cuts_io)
                        cursor = j
                    else:
                        cuts_io.point_cut[i] = -1

    @wp.func(module=name)
    def forget_cuts(work: Work, marks: Marks, k: int, first: int, stop: int, cuts_io: Cuts):
        """Take back the cuts of a ring that begin before ``stop``."""
        for n in range(chosen.piece_count(work, marks, first, stop)):
            piece = chosen.piece_range(work, marks, first, stop, n)
            for i in range(piece[0], piece[1]):
                if cuts_io.point_neck[i] >= 0 and cuts_io.point_cut[i] >= 0:
                    points = cuts_io.point_cut[i] - i + 1
                    wp.atomic_add(cuts_io.share_cut, chosen.share_of(work, k, i), wp.vec2i(-1, -points))
                    cuts_io.point_cut[i] = -1

    @wp.func(module=name)
    def select_on_ring(work: Work, marks: Marks, k: int, keep_longer: int, run: Run, cuts_io: Cuts):
        """As ``select_on_line``, but a neck i, j may cut off what lies outside of i .. j: -2 - j stands for that.

        It does where ``keep_longer`` is set and the inside is the longer one of what is left of the ring; loops found
        before it lie outside and go with it. One such cut a step: what more there are is found again in the next.
        """
        stop = run.last + 1
        left = stop - run.first
        cursor = int(run.first)
        limit = int(stop)
        for n in range(chosen.piece_count(work, marks, run.first, stop)):
            piece = chosen.piece_range(work, marks, run.first, stop, n)
            for i in range(piece[0], piece[1]):
                j = cuts_io.point_neck[i]
                if j >= 0:
                    inside = j - i
                    outside = left - inside
                    cuts_io.point_cut[i] = -1
                    if i >= cursor and j <= limit and (keep_longer == 0 or inside <= outside):
                        if outside >= RING_POINTS:
                            chosen.note_cut(work, k, i, j, inside + 1, cuts_io)
                            left = outside
                            cursor = j
                    elif i >= cursor and limit == stop and inside >= RING_POINTS:
                        forget_cuts(work, marks, k, run.first, i, cuts_io)
                        chosen.note_cut(work, k, i, -2 - j, stop - run.first - inside + 1, cuts_io)
                        left = inside
                        cursor = i
                        limit = j

    @wp.kernel(module=name, enable_backward=False)
    def select_cuts(
        # network
        channels: Channels,
        # params
        keep_longer: int,
        work: Work,
        # in
        marks: Marks,
        # out
        cuts_io: Cuts,
    ):
        """Keep, from the head of each channel down, every neck that begins at or after the end of the one before.

        Written for the points that have a neck: where it ends if it is cut, else -1. A slab takes its channels one by
        one; a chunk takes the rings that begin in it and the clusters of necks that do: a neck that no earlier one
        reaches beyond is kept, whatever those before are.
        """
        k = work.first + wp.tid()
        reach = int(0)
        if work.chunk > 0 and k > 0:
            reach = marks.sum[k - 1][1]
        run = line.begin_runs(channels, work, k)
        while run.stop < run.end:
            run = line.next_run(channels, run)
            necked = work.chunk > 0
            if work.chunk == 0:
                necked = cuts_io.channel_necks[run.channel] > 0
            if necked and run.closed != 0:
                if run.begin == run.first:
                    select_on_ring(work, marks, k, keep_longer, run, cuts_io)
            elif necked and work.chunk == 0:
                select_on_line(work, marks, k, run.first, run.last + 1, cuts_io)
            elif necked and marks.sum[k][0] > marks.place[k]:
                for j in range(run.begin, run.stop):
                    to = cuts_io.point_neck[j]
                    if to >= 0:
                        if j >= reach:
                            select_on_line(work, marks, k, j, run.last + 1, cuts_io)
                        reach = wp.max(reach, to)

    @wp.func(module=name)
    def save_outside(run: Run, i: int, j: int, offset: int, loops_out: Loops, moved_io: Points):
        """Save the points j .. last, first .. i of a ring and pull all but the last of them onto point j."""
        here = moved_io.xy[j]
        count = run.last - j + 1 + i - run.first + 1
        for m in range(count):
            k = line.round_index(j + m, run)
            loops_out.xy[offset + m] = moved_io.xy[k]
            if moved_io.section:
                loops_out.section[offset + m] = moved_io.section[k]
            if m < count - 1:
                moved_io.xy[k] = here

    @wp.kernel(module=name, enable_backward=False)
    def record_cuts(
        # network
        channels: Channels,
        # params
        work: Work,
        # in
        cuts: Cuts,
        # out
        loops_out: Loops,
        moved_io: Points,
        status_io: wp.array[int],
    ):
        """Record each cut, in the order of the packed points, after those of the sub-steps before.

        On a ring, what is cut off may hold its first point: what lies outside of i .. j for -2 - j, or what begins at i
        and goes round to an earlier j. That is saved at once, and its span is the point where it is noted.
        """
        if work.status[HALT] != 0:
            return
        k = work.first + wp.tid()
        total = cuts.share_cut_sum[cuts.share_cut_sum.shape[0] - 1]
        if k == 0:
            status_io[CUTS_NEEDED] = total[0]
            status_io[CUT_POINTS_NEEDED] = total[1]
        if (
            status_io[CUTS] + total[0] > loops_out.cut.shape[0]
            or status_io[CUT_POINTS] + total[1] > loops_out.xy.shape[0]
        ):  # fmt: skip
            wp.atomic_max(status_io, FAULT, FAULT_OXBOWS_FULL)
            return
        if cuts.share_cut[k][0] == 0:
            return
        before = cuts.share_cut_sum[k] - cuts.share_cut[k]
        slot = status_io[CUTS] + before[0]
        offset = status_io[CUT_POINTS] + before[1]
        run = line.begin_runs(channels, work, k)
        while run.stop < run.end:
            run = line.next_run(channels, run)
            i = int(run.begin)
            if work.chunk == 0 and cuts.channel_necks[run.channel] == 0:
                i = run.stop
            while i < run.stop:
                j = int(-1)
                if cuts.point_neck[i] != -1:
                    j = cuts.point_cut[i]
                if j != -1:
                    # On a ring the loop may begin at ``head`` and go round to ``foot``, which lies before it.
                    head = wp.where(j < -1, -2 - j, i)
                    foot = wp.where(j < -1, i, j)
                    count = foot - head + 1
                    loops_out.span[slot] = wp.vec2i(i, foot)
                    if foot < head:
                        count += run.last + 1 - run.first
                        loops_out.span[slot] = wp.vec2i(i, i)
                        save_outside(run, foot, head, offset, loops_out, moved_io)
                    loops_out.cut[slot] = Cut(run.channel, offset, count, status_io[DONE])
                    slot += 1
                    offset += count
                i += 1

    @wp.func(module=name)
    def first_cut(span: wp.array[wp.vec2i], low: int, stop: int, point: int) -> int:
        """First of the cuts low .. stop - 1 that does not end before a point (binary search)."""
        at = int(low)
        high = int(stop)
        while at < high:
            middle = (at + high) // 2
            if span[middle][1] < point:
                at = middle + 1
            else:
                high = middle
        return at

    @wp.kernel(module=name, enable_backward=False)
    def save_loops(
        # network
        channels: Channels,
        # params
        work: Work,
        # in
        cuts: Cuts,
        # out
        loops_io: Loops,
        moved_io: Points,
    ):
        """Save the points of each loop, ends included, and pull all but the last onto the point where it begins.

        A share does this for its own points, whichever share the loop begins in. The copies left behind have no
        length; resampling passes over them.
        """
        if work.status[HALT] != 0 or work.status[FAULT] == FAULT_OXBOWS_FULL:
            return
        k = work.first + wp.tid()
        begin = work.status[CUTS]
        stop = begin + cuts.share_cut_sum[cuts.share_cut_sum.shape[0] - 1][0]
        if begin == stop:
            return
        share = line.begin_runs(channels, work, k)
        m = int(0)
        if work.chunk == 0:
            stop = begin + cuts.share_cut_sum[k][0]
            m = stop - cuts.share_cut[k][0]
        else:
            m = first_cut(loops_io.span, begin, stop, share.stop)
        while m < stop and loops_io.span[m][0] < share.end:
            span = loops_io.span[m]
            cut = loops_io.cut[m]
            if cut.count == span[1] - span[0] + 1:
                offset = cut.begin - span[0]
                here = moved_io.xy[span[0]]
                for i in range(wp.max(span[0], share.stop), wp.min(span[1] + 1, share.end)):
                    loops_io.xy[offset + i] = moved_io.xy[i]
                    if moved_io.section:
                        loops_io.section[offset + i] = moved_io.section[i]
                    if i > span[0] and i < span[1]:
                        moved_io.xy[i] = here
            m += 1

    return SimpleNamespace(
        vec2=vec2,
        PointTable=PointTable,
        Loops=Loops,
        insert_points=insert_points,
        find_necks=neck_search("find_necks", 1),
        find_necks_in_chunks=neck_search("find_necks_in_chunks", 2),
        list_marks=list_marks,
        select_cuts=select_cuts,
        record_cuts=record_cuts,
        save_loops=save_loops,
    )
