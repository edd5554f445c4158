"""Collisions: where channels of a network come closer to each other than they are wide."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import buckets, polyline
from warpriver.kernels.channels import COARSEST_SPACING, Work
from warpriver.kernels.status import CONTACTS, HALT
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# A chord may be longer than the spacing where a neck was cut, by 1.34 spacings (see meander/resampling.py).
SLACK_SPACINGS = 1.5


@wp.struct
class BlockIndex:
    """Blocks by the grid cell of their middle: the next one in the cell's list, whose it is, and the cells' buckets."""

    point_next: wp.array[int]
    point_owner: wp.array[int]
    bucket: wp.array[int]


@once
def build(scalar):
    """Make the collision kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.collisions_{scalar.__name__}"
    line, table = polyline.build(scalar), buckets.build(scalar)
    vec2, Form = line.vec2, line.Form
    ZERO, HALF, ONE, TWO, FOUR = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 4.0))
    COARSEST, SLACK = scalar(COARSEST_SPACING), scalar(SLACK_SPACINGS)
    # A block's owner is written as channel * 32 + level.
    LEVEL_BITS, LEVEL_MASK = 5, 31
    NOTHING = 2147483647
    # A bucket is four integers: last block + 1, highest channel + 1, NOTHING - lowest channel, 1 if one of them moves.
    # All 0: empty.
    HEAD, HIGH, LOW, MOVES, FIELDS = 0, 1, 2, 3, 4
    # Cells that the next level lies away in the table, so that levels do not fall on each other.
    LEVEL_X, LEVEL_Y = 8 * 7919, 8 * 104729

    @wp.struct
    class CollisionLaw:
        """Scalars of the search; ``reach`` in m, other lengths in widths.

        Channels fall into levels by their reach, which doubles from one to the next, as do the cells: a narrow channel
        looks for its own kind and for all wider ones, and the cells of the narrow stay small. ``level_mask`` has a bit
        for every level that holds a channel.
        """

        distance: scalar
        node_reach: scalar
        block: scalar
        reach: scalar
        level_count: int
        level_mask: int

    @wp.func(module=name)
    def block_points(law: CollisionLaw, form: Form, spacing: scalar) -> int:
        """Number of consecutive points of a channel that one entry in the grid stands for."""
        return wp.max(1, int(law.block * form.widest / spacing))

    @wp.func(module=name)
    def reach_of(law: CollisionLaw, form: Form) -> scalar:
        """What two blocks may be apart, middle to middle, and still touch is the sum of this of both.

        Half the distance that counts as a touch, half a block, and what chords across a cut neck are longer.
        """
        spacing = COARSEST * form.target_spacing
        return HALF * (law.distance * form.widest + wp.max(law.block * form.widest, spacing)) + SLACK * spacing

    @wp.func(module=name)
    def level_of(law: CollisionLaw, form: Form) -> int:
        """Level of a channel: the lowest whose reach is at least its own."""
        reach = reach_of(law, form)
        level = int(0)
        size = law.reach
        while size < reach and level < law.level_count - 1:
            size = TWO * size
            level += 1
        return level

    @wp.func(module=name)
    def cell_size(law: CollisionLaw, level: int) -> scalar:
        """Width of the cells of a level: two side by side hold all that touches what lies between their middles."""
        return FOUR * law.reach * scalar(1 << level)

    @wp.func(module=name)
    def bucket_at(x: int, y: int, level: int, mask: int) -> int:
        """First field of a cell's bucket; the levels lie far from each other."""
        return FIELDS * table.bucket_of(x + level * LEVEL_X, y + level * LEVEL_Y, mask)

    @wp.kernel(module=name, enable_backward=False)
    def insert_blocks(
        # network
        point_xy: wp.array[vec2],
        channel_start: wp.array[int],
        channel_form: wp.array[Form],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        # params
        law: CollisionLaw,
        work: Work,
        # out
        point_next_out: wp.array[int],
        point_owner_out: wp.array[int],
        bucket_io: wp.array[int],
        status_out: wp.array[int],
    ):
        """Link the first point of every block into the cell of the block's middle, and note the cell's channels.

        Rings are left out: they never join others. The count of contacts begins anew.
        """
        if work.status[HALT] == 0 and work.first + wp.tid() == 0:
            status_out[CONTACTS] = 0
        mask = bucket_io.shape[0] // FIELDS - 1
        share = line.point_range(work, channel_start, channel_spacing.shape[0], work.first + wp.tid())
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        while i < end:
            first = channel_start[channel]
            stop = channel_start[channel + 1]
            form = channel_form[channel]
            step = block_points(law, form, channel_spacing[channel])
            level = level_of(law, form)
            per_cell = ONE / cell_size(law, level)
            moves = int(channel_step[channel] > ZERO)
            j = first + (i - first + step - 1) // step * step
            if line.closed_at(channel_closed, channel) != 0:
                j = stop
            while j < wp.min(end, stop):
                p = point_xy[wp.min(j + step // 2, stop - 1)] * per_cell
                bucket = bucket_at(table.floor_int(p[0]), table.floor_int(p[1]), level, mask)
                point_owner_out[j] = (channel << LEVEL_BITS) | level
                wp.atomic_max(bucket_io, bucket + HIGH, channel + 1)
                wp.atomic_max(bucket_io, bucket + LOW, NOTHING - channel)
                wp.atomic_max(bucket_io, bucket + MOVES, moves)
                point_next_out[j] = wp.atomic_exch(bucket_io, bucket + HEAD, j + 1)
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
        channel_form: wp.array[Form],
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
        stop_i = wp.min(blocks[1] + block_points(law, channel_form[c], channel_spacing[c]), channel_start[c + 1])
        stop_j = wp.min(blocks[3] + block_points(law, channel_form[d], channel_spacing[d]), channel_start[d + 1])
        size = block_points(law, channel_form[d], channel_spacing[d])
        middle = vec2(point_xy[wp.min(blocks[3] + size // 2, stop_j - 1)])
        near = HALF * law.distance * (channel_form[c].widest + channel_form[d].widest)
        near += (HALF * scalar(size) + ONE) * channel_spacing[d]
        for i in range(blocks[1], stop_i):
            if wp.length_sq(point_xy[i] - middle) > near * near:
                continue
            for j in range(blocks[3], stop_j):
                if i < result[0] or (i == result[0] and j < result[1]):
                    width_c = line.old_section_at(point_section, i, channel_form[c])[0]
                    width_d = line.old_section_at(point_section, j, channel_form[d])[0]
                    touch = HALF * law.distance * (width_c + width_d)
                    if wp.length_sq(point_xy[j] - point_xy[i]) < touch * touch:
                        reach = law.node_reach * wp.max(width_c, width_d)
                        if not near_shared_node(channel_nodes, channel_start, channel_spacing, c, d, i, j, reach):
                            result = wp.vec2i(i, j)
        return result

    @wp.func(module=name)
    def cell_contact(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_nodes: wp.array[wp.vec2i],
        channel_form: wp.array[Form],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        law: CollisionLaw,
        index: BlockIndex,
        head: int,
        seek: wp.vec4i,
        best: wp.vec2i,
    ) -> wp.vec2i:
        """First contact of a block with those in a list, if it comes before ``best``.

        seek = (channel, block, level that is looked for, points of the block). On its own level a channel looks for
        those of a higher number.
        """
        channel, block = seek[0], seek[1]
        middle = point_xy[wp.min(block + seek[3] // 2, channel_start[channel + 1] - 1)]
        moves = channel_step[channel] > ZERO
        own_reach = reach_of(law, channel_form[channel])
        lowest = int(-1)
        if level_of(law, channel_form[channel]) == seek[2]:
            lowest = channel
        result = best
        other = int(head)
        while other >= 0:
            d = index.point_owner[other] >> LEVEL_BITS
            # Cells of other levels may share the bucket.
            sought = d > lowest and (index.point_owner[other] & LEVEL_MASK) == seek[2]
            if sought and (moves or channel_step[d] > ZERO):
                size = block_points(law, channel_form[d], channel_spacing[d])
                far = point_xy[wp.min(other + size // 2, channel_start[d + 1] - 1)]
                reach = own_reach + reach_of(law, channel_form[d])
                if wp.length_sq(far - middle) < reach * reach:
                    result = first_contact(
                        point_xy, point_section, channel_start, channel_nodes, channel_form, channel_spacing,
                        law, wp.vec4i(channel, block, d, other), result,
                    )  # fmt: skip
            other = index.point_next[other] - 1
        return result

    @wp.func(module=name)
    def block_contact(
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_nodes: wp.array[wp.vec2i],
        channel_form: wp.array[Form],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        law: CollisionLaw,
        index: BlockIndex,
        channel: int,
        own_level: int,
        block: int,
    ) -> wp.vec2i:
        """First contact of a block with a channel of a higher number or level, (NOTHING, -1) if there is none."""
        mask = index.bucket.shape[0] // FIELDS - 1
        step = block_points(law, channel_form[channel], channel_spacing[channel])
        middle = point_xy[wp.min(block + step // 2, channel_start[channel + 1] - 1)]
        moves = channel_step[channel] > ZERO
        best = wp.vec2i(NOTHING, -1)
        for level in range(own_level, law.level_count):
            if (law.level_mask >> level) & 1 != 0:
                per_cell = ONE / cell_size(law, level)
                x0 = table.floor_int(middle[0] * per_cell - HALF)
                y0 = table.floor_int(middle[1] * per_cell - HALF)
                for corner in range(4):
                    cell = bucket_at(x0 + (corner & 1), y0 + (corner >> 1), level, mask)
                    # Most cells hold one channel only, or none that moves: nothing to walk through.
                    alone = index.bucket[cell + HIGH] - 1 == channel and NOTHING - index.bucket[cell + LOW] == channel
                    if not alone and (moves or index.bucket[cell + MOVES] != 0):
                        best = cell_contact(
                            point_xy, point_section, channel_start, channel_nodes, channel_form, channel_spacing,
                            channel_step, law, index, index.bucket[cell + HEAD] - 1,
                            wp.vec4i(channel, block, level, step), best,
                        )  # fmt: skip
        return best

    @wp.kernel(module=name, enable_backward=False)
    def find_contacts(
        # network
        point_xy: wp.array[vec2],
        point_section: wp.array[vec2],
        channel_start: wp.array[int],
        channel_nodes: wp.array[wp.vec2i],
        channel_form: wp.array[Form],
        channel_spacing: wp.array[scalar],
        channel_step: wp.array[scalar],
        channel_closed: wp.array[int],
        # params
        law: CollisionLaw,
        work: Work,
        # in
        index: BlockIndex,
        share_offset: wp.array[int],
        # out
        contact_out: wp.array[wp.vec2i],
        share_contacts_io: wp.array[int],
        status_io: wp.array[int],
    ):
        """Count the blocks of each slab or chunk that touch another channel; with ``contact_out``, list the contacts.

        Channels touch where |p_i - p_j| < (w_i + w_j) / 2, away from nodes that they share [Paris2023, Sec. 6.2]. Two
        channels whose steps are 0 are left as they are. Chunks add their count to the status.
        """
        if work.status[HALT] != 0:
            return
        k = work.first + wp.tid()
        share = line.point_range(work, channel_start, channel_spacing.shape[0], k)
        i = int(share[0])
        end = share[1]
        channel = int(share[2])
        contacts = int(0)
        while i < end:
            first = channel_start[channel]
            stop = wp.min(end, channel_start[channel + 1])
            step = block_points(law, channel_form[channel], channel_spacing[channel])
            level = level_of(law, channel_form[channel])
            j = first + (i - first + step - 1) // step * step
            if line.closed_at(channel_closed, channel) != 0:
                j = stop
            while j < stop:
                contact = block_contact(
                    point_xy, point_section, channel_start, channel_nodes, channel_form, channel_spacing,
                    channel_step, law, index, channel, level, j,
                )  # fmt: skip
                if contact[1] >= 0:
                    if contact_out:
                        contact_out[share_offset[k] - share_contacts_io[k] + contacts] = contact
                    contacts += 1
                j += step
            i = stop
            channel += 1
        if not contact_out:
            share_contacts_io[k] = contacts
            if work.chunk > 0 and contacts > 0:
                wp.atomic_add(status_io, CONTACTS, contacts)

    @wp.kernel(module=name, enable_backward=False)
    def count_contacts(
        # in
        share_contacts: wp.array[int],
        # out
        status_io: wp.array[int],
    ):
        """Add up the contacts of the slabs, whose threads do not share a counter; launched with one thread."""
        if status_io[HALT] == 0:
            contacts = int(0)
            for k in range(share_contacts.shape[0]):
                contacts += share_contacts[k]
            status_io[CONTACTS] = contacts

    return SimpleNamespace(
        vec2=vec2,
        Form=Form,
        CollisionLaw=CollisionLaw,
        insert_blocks=insert_blocks,
        find_contacts=find_contacts,
        count_contacts=count_contacts,
    )
