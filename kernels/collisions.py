"""Collisions: where channels of a network come closer to each other than they are wide."""

import functools
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polyline

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the collision kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.collisions_{scalar.__name__}"
    line = polyline.build(scalar)
    vec2, vec4 = line.vec2, line.vec4
    HALF, TWO = scalar(0.5), scalar(2.0)
    NOTHING = 2147483647
    HASH_X, HASH_Y, HASH_MIX = wp.uint32(0x9E3779B1), wp.uint32(0x85EBCA77), wp.uint32(0x27D4EB2F)

    @wp.struct
    class CollisionLaw:
        """Scalars of the search; lengths in m, factors in widths."""

        distance: scalar
        node_reach: scalar
        block: scalar
        cell: scalar

    @wp.func(module=name)
    def block_points(law: CollisionLaw, spacing: scalar) -> int:
        """Number of consecutive points that one entry in the grid stands for."""
        return wp.max(1, int(law.block / spacing))

    @wp.func(module=name)
    def bucket_of(x: int, y: int, mask: int) -> int:
        """Bucket of a grid cell."""
        mixed = ((wp.uint32(x) * HASH_X) ^ (wp.uint32(y) * HASH_Y)) * HASH_MIX
        return int((mixed ^ (mixed >> wp.uint32(15))) & wp.uint32(mask))

    @wp.kernel(module=name, enable_backward=False)
    def insert_blocks(
        # network
        point_xy: wp.array[vec2],
        channel_start: wp.array[int],
        channel_spacing: wp.array[scalar],
        # params
        law: CollisionLaw,
        chunk: int,
        # out
        point_next_out: wp.array[int],
        point_channel_out: wp.array[int],
        bucket_head_io: wp.array[int],
        bucket_high_io: wp.array[int],
    ):
        """Link the first point of every block into the cell of the block's middle, and note the cell's last channel."""
        channel_count = channel_spacing.shape[0]
        mask = bucket_head_io.shape[0] - 1
        i = wp.tid() * chunk
        end = wp.min(i + chunk, channel_start[channel_count])
        if i >= end:
            return
        channel = line.channel_at(channel_start, channel_count, i)
        while i < end:
            first = channel_start[channel]
            stop = channel_start[channel + 1]
            step = block_points(law, channel_spacing[channel])
            j = first + (i - first + step - 1) // step * step
            while j < wp.min(end, stop):
                p = point_xy[wp.min(j + step // 2, stop - 1)] / law.cell
                bucket = bucket_of(int(wp.floor(p[0])), int(wp.floor(p[1])), mask)
                point_channel_out[j] = channel
                # Both hold a number + 1, so that a zeroed grid is an empty one.
                wp.atomic_max(bucket_high_io, bucket, channel + 1)
                point_next_out[j] = wp.atomic_exch(bucket_head_io, bucket, j + 1)
                j += step
            i = wp.min(end, stop)
            channel += 1

    @wp.func(module=name)
    def near_shared_node(
        channel_nodes: wp.array[wp.vec2i],
        channel_start: wp.array[int],
        channel_spacing: wp.array[scalar],
        c: int,
        d: int,
        i: int,
        j: int,
        reach: scalar,
    ) -> bool:
        """Tell whether two points lie, together, within ``reach`` of a node that their channels share."""
        up_c = scalar(i - channel_start[c]) * channel_spacing[c]
        down_c = scalar(channel_start[c + 1] - 1 - i) * channel_spacing[c]
        up_d = scalar(j - channel_start[d]) * channel_spacing[d]
        down_d = scalar(channel_start[d + 1] - 1 - j) * channel_spacing[d]
        ends_c, ends_d = channel_nodes[c], channel_nodes[d]
        near = bool(False)
        if ends_c[1] == ends_d[1] and down_c + down_d < reach:
            near = True
        if ends_c[1] == ends_d[0] and down_c + up_d < reach:
            near = True
        if ends_c[0] == ends_d[1] and up_c + down_d < reach:
            near = True
        if ends_c[0] == ends_d[0] and up_c + up_d < reach:
            near = True
        return near

    @wp.func(module=name)
    def first_contact(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_nodes: wp.array[wp.vec2i],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        law: CollisionLaw,
        blocks: wp.vec4i,
        best: wp.vec2i,
    ) -> wp.vec2i:
        """First contact (i, j) of two blocks, in the order of i and then j, if it comes before ``best``.

        blocks = (channel, first point, channel, first point).
        """
        c, d = blocks[0], blocks[2]
        result = best
        stop_i = wp.min(blocks[1] + block_points(law, channel_spacing[c]), channel_start[c + 1])
        stop_j = wp.min(blocks[3] + block_points(law, channel_spacing[d]), channel_start[d + 1])
        half = block_points(law, channel_spacing[d]) // 2
        middle = vec2(point_xy[wp.min(blocks[3] + half, stop_j - 1)])
        near = law.distance * wp.max(channel_form[c][2], channel_form[d][2]) + HALF * law.block
        near += TWO * channel_spacing[d]
        for i in range(blocks[1], stop_i):
            if wp.length_sq(point_xy[i] - middle) > near * near:
                continue
            for j in range(blocks[3], stop_j):
                if i < result[0] or (i == result[0] and j < result[1]):
                    width_c = line.section_at(point_section, i, channel_form[c])[0]
                    width_d = line.section_at(point_section, j, channel_form[d])[0]
                    touch = HALF * law.distance * (width_c + width_d)
                    if wp.length_sq(point_xy[j] - point_xy[i]) < touch * touch:
                        reach = law.node_reach * wp.max(width_c, width_d)
                        if not near_shared_node(channel_nodes, channel_start, channel_spacing, c, d, i, j, reach):
                            result = wp.vec2i(i, j)
        return result

    @wp.func(module=name)
    def block_contact(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_nodes: wp.array[wp.vec2i],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        law: CollisionLaw,
        point_next: wp.array[int],
        point_channel: wp.array[int],
        bucket_head: wp.array[int],
        bucket_high: wp.array[int],
        channel: int,
        block: int,
    ) -> wp.vec2i:
        """First contact of a block with a channel of a higher number, (NOTHING, -1) if there is none."""
        mask = bucket_head.shape[0] - 1
        step = block_points(law, channel_spacing[channel])
        middle = point_xy[wp.min(block + step // 2, channel_start[channel + 1] - 1)]
        x0 = int(wp.floor(middle[0] / law.cell - HALF))
        y0 = int(wp.floor(middle[1] / law.cell - HALF))
        best = wp.vec2i(NOTHING, -1)
        for corner in range(4):
            bucket = bucket_of(x0 + (corner & 1), y0 + (corner >> 1), mask)
            # Most cells hold one channel only: nothing to walk through.
            if bucket_high[bucket] - 1 > channel:
                other = bucket_head[bucket] - 1
                while other >= 0:
                    d = point_channel[other]
                    if d > channel:
                        half = block_points(law, channel_spacing[d]) // 2
                        far = point_xy[wp.min(other + half, channel_start[d + 1] - 1)]
                        reach = law.distance * wp.max(channel_form[channel][2], channel_form[d][2])
                        reach += law.block + channel_spacing[channel] + channel_spacing[d]
                        if wp.length_sq(far - middle) < reach * reach:
                            best = first_contact(
                                point_xy, point_section, channel_start, channel_nodes, channel_form, channel_spacing,
                                law, wp.vec4i(channel, block, d, other), best,
                            )  # fmt: skip
                    other = point_next[other] - 1
        return best

    @wp.kernel(module=name, enable_backward=False)
    def find_contacts(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_nodes: wp.array[wp.vec2i],
        channel_form: wp.array[vec4],
        channel_spacing: wp.array[scalar],
        # params
        law: CollisionLaw,
        chunk: int,
        # in
        point_next: wp.array[int],
        point_channel: wp.array[int],
        bucket_head: wp.array[int],
        bucket_high: wp.array[int],
        chunk_offset: wp.array[int],
        # out
        contact_out: wp.array[wp.vec2i],
        chunk_contacts_io: wp.array[int],
        contact_count_io: wp.array[int],
    ):
        """Count the blocks of each chunk that touch another channel; with ``contact_out``, list their contacts (i, j).

        Channels touch where |p_i - p_j| < (w_i + w_j) / 2, away from nodes that they share [Paris2023, Sec. 6.2].
        """
        channel_count = channel_spacing.shape[0]
        k = wp.tid()
        i = k * chunk
        end = wp.min(i + chunk, channel_start[channel_count])
        contacts = int(0)
        channel = int(0)
        if i < end:
            channel = line.channel_at(channel_start, channel_count, i)
        while i < end:
            first = channel_start[channel]
            stop = wp.min(end, channel_start[channel + 1])
            step = block_points(law, channel_spacing[channel])
            j = first + (i - first + step - 1) // step * step
            while j < stop:
                contact = block_contact(
                    point_xy, point_section, channel_start, channel_nodes, channel_form, channel_spacing, law,
                    point_next, point_channel, bucket_head, bucket_high, channel, j,
                )  # fmt: skip
                if contact[1] >= 0:
                    if contact_out:
                        contact_out[chunk_offset[k] - chunk_contacts_io[k] + contacts] = contact
                    contacts += 1
                j += step
            i = stop
            channel += 1
        if not contact_out:
            chunk_contacts_io[k] = contacts
            if contacts > 0:
                wp.atomic_add(contact_count_io, 0, contacts)

    @wp.kernel(module=name, enable_backward=False)
    def gather_points(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        # in
        sample_source: wp.array[int],
        sample_scale: wp.array[vec2],
        # out
        sample_xy_out: wp.array[vec2],
        sample_section_out: wp.array[vec2],
    ):
        """Take points over into a new order; width and depth change by the factors of their channel."""
        i = wp.tid()
        sample_xy_out[i] = point_xy[sample_source[i]]
        if point_section:
            sample_section_out[i] = wp.cw_mul(point_section[sample_source[i]], sample_scale[i])

    return SimpleNamespace(
        vec2=vec2,
        vec4=vec4,
        CollisionLaw=CollisionLaw,
        insert_blocks=insert_blocks,
        find_contacts=find_contacts,
        gather_points=gather_points,
    )
