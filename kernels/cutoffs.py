"""Neck cutoffs: pairs of points of one channel that come close are found on a grid, and the loops between them cut."""

import functools
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, polyline

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the cutoff kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.cutoffs_{scalar.__name__}"
    line, grid = polyline.build(scalar), buckets.build(scalar)
    vec2, vec4 = line.vec2, line.vec4
    floor_int, bucket_mask, bucket_of = grid.floor_int, grid.bucket_mask, grid.bucket_of
    HALF = scalar(0.5)
    FAULT_OXBOWS_FULL = 2

    @wp.kernel(module=name, enable_backward=False)
    def insert_points(
        # network
        channel_start: wp.array[int],
        channel_form: wp.array[vec4],
        # params
        cutoff_distance: scalar,
        chunk: int,
        # in
        point_moved: wp.array[vec2],
        # out
        point_next_out: wp.array[int],
        bucket_head_io: wp.array[int],
    ):
        """Link every point into its channel's grid cell that holds it; a cell is two cutoff distances wide.

        Each channel has its own buckets, from four times its first point on, so that they lie close in memory.
        """
        channel_count = channel_form.shape[0]
        i = wp.tid() * chunk
        end = wp.min(i + chunk, channel_start[channel_count])
        if i >= end:
            return
        channel = line.channel_at(channel_start, channel_count, i)
        while i < end:
            first = channel_start[channel]
            stop = wp.min(end, channel_start[channel + 1])
            mask = bucket_mask(channel_start[channel + 1] - first)
            per_cell = HALF / (cutoff_distance * channel_form[channel][2])
            for j in range(i, stop):
                p = point_moved[j] * per_cell
                bucket = 4 * first + bucket_of(floor_int(p[0]), floor_int(p[1]), mask)
                # The head holds point + 1, so that a zeroed table is an empty one.
                point_next_out[j] = wp.atomic_exch(bucket_head_io, bucket, j + 1)
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
        per_cell: scalar,
        radius: scalar,
        cutoff_distance: scalar,
        min_arc: scalar,
    ) -> int:
        """First point from ``nearest`` on, up to the channel's end, that is closer to point i than the radius.

        A list is left at its first entry below ``lowest``.
        """
        here = point[i]
        x0 = floor_int(here[0] * per_cell - HALF)
        y0 = floor_int(here[1] * per_cell - HALF)
        found = int(last + 1)
        for corner in range(4):
            j = bucket_head[4 * first + bucket_of(x0 + (corner & 1), y0 + (corner >> 1), mask)] - 1
            while j >= lowest:
                if j >= nearest and j < found:
                    reach = radius
                    if section:
                        width = HALF * (section[i][0] + section[j][0])
                        reach = cutoff_distance * width
                        if scalar(j - i) <= min_arc * width:
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
        # params
        cutoff_distance: scalar,
        cutoff_min_arc: scalar,
        chunk: int,
        ordered: int,
        # in
        point_moved: wp.array[vec2],
        section_moved: wp.array[vec2],
        point_next: wp.array[int],
        bucket_head: wp.array[int],
        # out
        point_neck_out: wp.array[int],
        chunk_necks_out: wp.array[int],
        neck_count_io: wp.array[int],
    ):
        """First later point of the same channel closer than the cutoff distance, -1 if none: |p_i - p_j| < w.

        Points no more than ``cutoff_min_arc`` widths apart along the channel are neighbours [Howard1984]. Where points
        were inserted in order (``ordered``: on the CPU), the lists descend, and most end before their first entry.
        """
        channel_count = channel_form.shape[0]
        k = wp.tid()
        i = k * chunk
        end = wp.min(i + chunk, channel_start[channel_count])
        necks = int(0)
        channel = int(0)
        if i < end:
            channel = line.channel_at(channel_start, channel_count, i)
        while i < end:
            first = channel_start[channel]
            last = channel_start[channel + 1] - 1
            stop = wp.min(end, last + 1)
            mask = bucket_mask(last + 1 - first)
            form = channel_form[channel]
            radius = cutoff_distance * form[2]
            min_arc = cutoff_min_arc / channel_spacing[channel]
            apart = int(min_arc * form[2]) + 1
            for j in range(i, stop):
                if section_moved:
                    # The other point may be narrower: its width is looked at where it is found.
                    apart = int(HALF * min_arc * section_moved[j][0]) + 1
                found = nearest_after(
                    point_moved, section_moved, point_next, bucket_head, first, mask, j, j + apart,
                    ordered * (j + apart), last, HALF / radius, radius, cutoff_distance, min_arc,
                )  # fmt: skip
                if found > last:
                    found = -1
                else:
                    necks += 1
                point_neck_out[j] = found
            i = stop
            channel += 1
        chunk_necks_out[k] = necks
        if necks > 0:
            wp.atomic_add(neck_count_io, 0, necks)

    @wp.kernel(module=name, enable_backward=False)
    def select_cuts(
        # network
        channel_start: wp.array[int],
        # params
        chunk: int,
        # in
        chunk_necks: wp.array[int],
        neck_count: wp.array[int],
        # out
        channel_cuts_out: wp.array[int],
        channel_cut_points_out: wp.array[int],
        point_neck_io: wp.array[int],
    ):
        """Keep, from the head of each channel down, every neck that begins at or after the end of the one before."""
        channel = wp.tid()
        channel_cuts_out[channel] = 0
        channel_cut_points_out[channel] = 0
        if neck_count[0] == 0:
            return
        cuts = int(0)
        points = int(0)
        first = channel_start[channel]
        stop = channel_start[channel + 1]
        cursor = int(first)
        for k in range(first // chunk, (stop - 1) // chunk + 1):
            if chunk_necks[k] > 0:
                for i in range(wp.max(first, k * chunk), wp.min(stop, (k + 1) * chunk)):
                    j = point_neck_io[i]
                    if j >= 0:
                        if i >= cursor:
                            cuts += 1
                            points += j - i + 1
                            cursor = j
                        else:
                            point_neck_io[i] = -1
        channel_cuts_out[channel] = cuts
        channel_cut_points_out[channel] = points

    @wp.kernel(module=name, enable_backward=False)
    def cut_necks(
        # network
        channel_start: wp.array[int],
        # params
        chunk: int,
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
        fault_io: wp.array[int],
    ):
        """Save each cut loop, ends included, and pull its inner points onto the point where it begins.

        A cut is recorded as (channel, first loop point in the buffer, number of points, -), in the order of the
        packed points. The copies left behind have no length; resampling passes over them.
        """
        channel = wp.tid()
        count = channel_start.shape[0] - 1
        if channel_cuts_sum[count - 1] > cut_out.shape[0] or channel_cut_points_sum[count - 1] > oxbow_xy_out.shape[0]:
            wp.atomic_max(fault_io, 0, FAULT_OXBOWS_FULL)
            return
        slot = int(0)
        offset = int(0)
        if channel > 0:
            slot = channel_cuts_sum[channel - 1]
            offset = channel_cut_points_sum[channel - 1]
        if channel_cuts_sum[channel] == slot:
            return
        first = channel_start[channel]
        stop = channel_start[channel + 1]
        for k in range(first // chunk, (stop - 1) // chunk + 1):
            if chunk_necks[k] > 0:
                for i in range(wp.max(first, k * chunk), wp.min(stop, (k + 1) * chunk)):
                    j = point_neck[i]
                    if j >= 0:
                        cut_out[slot] = wp.vec4i(channel, offset, j - i + 1, 0)
                        here = point_moved_io[i]
                        for m in range(i, j + 1):
                            oxbow_xy_out[offset + m - i] = point_moved_io[m]
                            if section_moved:
                                oxbow_section_out[offset + m - i] = section_moved[m]
                            if m < j:
                                point_moved_io[m] = here
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
