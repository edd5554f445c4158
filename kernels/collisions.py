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
    """Blocks by the grid cell of their middle: the next one in the cell's list, whose it is, and the cells' buckets.

    ``channel_river`` labels the rivers that channels are parts of, where only parts of one river touch; else it is
    missing.
    """

    point_next: wp.array[int]
    point_owner: wp.array[int]
    bucket: wp.array[int]
    channel_river: wp.array[int]


@wp.struct
class Contacts:
    """Places where channels touch, as pairs of points; ``pair`` is missing while they are only counted.

    ``share_count`` is the number of those of each slab or chunk, ``share_sum`` its running sum.
    """

    pair: wp.array[wp.vec2i]
    share_count: wp.array[int]
    share_sum: wp.array[int]


@once
def build(scalar):
    """Make the collision kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.collisions_{scalar.__name__}"
    wp.set_module_options({"max_unroll": 1}, module=name)
    line, table = polyline.build(scalar), buckets.build(scalar)
    vec2, Channels, Form, Points = line.vec2, line.Channels, line.Form, line.Points
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
    class CollisionConstants:
        """Constants of the search; ``reach`` in m, other lengths in widths.

        Channels fall into levels by their reach, which doubles from one to the next, as do the cells: a narrow channel
        looks for its own kind and for all wider ones, and the cells of the narrow stay small. ``level_mask`` has a bit
        for every level that holds a channel.
        """

        distance: scalar
        node_reach: scalar
        neck_arc: scalar
        block: scalar
        reach: scalar
        level_count: int
        level_mask: int

    @wp.struct
    class Block:
        """Points begin .. stop - 1 of a channel, for one entry in the grid; a full block has ``size`` points."""

        channel: int
        begin: int
        stop: int
        size: int
        middle: vec2

    @wp.func(module=name)
    def block_points(channels: Channels, constants: CollisionConstants, channel: int) -> int:
        """Number of consecutive points of a channel that one entry in the grid stands for."""
        return wp.max(1, int(constants.block * channels.form[channel].widest / channels.spacing[channel]))

    @wp.func(module=name)
    def block_at(
        point_xy: wp.array[vec2], channels: Channels, constants: CollisionConstants, channel: int, begin: int
    ) -> Block:
        """The block of a channel that begins at a point."""
        block = Block()
        block.channel = channel
        block.begin = begin
        block.size = block_points(channels, constants, channel)
        block.stop = wp.min(begin + block.size, channels.start[channel + 1])
        block.middle = point_xy[wp.min(begin + block.size // 2, block.stop - 1)]
        return block

    @wp.func(module=name)
    def reach_of(constants: CollisionConstants, form: Form) -> scalar:
        """What two blocks may be apart, middle to middle, and still touch is the sum of this of both.

        Half the distance that counts as a touch, half a block, and what chords across a cut neck are longer.
        """
        spacing = COARSEST * form.target_spacing
        width = form.widest
        return HALF * (constants.distance * width + wp.max(constants.block * width, spacing)) + SLACK * spacing

    @wp.func(module=name)
    def level_of(constants: CollisionConstants, form: Form) -> int:
        """Level of a channel: the lowest whose reach is at least its own."""
        reach = reach_of(constants, form)
        level = int(0)
        size = constants.reach
        while size < reach and level < constants.level_count - 1:
            size = TWO * size
            level += 1
        return level

    @wp.func(module=name)
    def cell_size(constants: CollisionConstants, level: int) -> scalar:
        """Width of the cells of a level: two side by side hold all that touches what lies between their middles."""
        return FOUR * constants.reach * scalar(1 << level)

    @wp.func(module=name)
    def bucket_at(x: int, y: int, level: int, mask: int) -> int:
        """First field of a cell's bucket; the levels lie far from each other."""
        return FIELDS * table.bucket_of(x + level * LEVEL_X, y + level * LEVEL_Y, mask)

    @wp.kernel(module=name, enable_backward=False)
    def insert_blocks(
        # network
        channels: Channels,
        point_xy: wp.array[vec2],
        # params
        constants: CollisionConstants,
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
        run = line.begin_runs(channels, work, work.first + wp.tid())
        while run.stop < run.end:
            run = line.next_run(channels, run)
            size = block_points(channels, constants, run.channel)
            level = level_of(constants, run.form)
            per_cell = ONE / cell_size(constants, level)
            moves = int(run.step > ZERO)
            j = run.first + (run.begin - run.first + size - 1) // size * size
            if run.closed != 0:
                j = run.stop
            while j < run.stop:
                p = point_xy[wp.min(j + size // 2, run.last)] * per_cell
                bucket = bucket_at(table.floor_int(p[0]), table.floor_int(p[1]), level, mask)
                point_owner_out[j] = (run.channel << LEVEL_BITS) | level
                wp.atomic_max(bucket_io, bucket + HIGH, run.channel + 1)
                wp.atomic_max(bucket_io, bucket + LOW, NOTHING - run.channel)
                wp.atomic_max(bucket_io, bucket + MOVES, moves)
                point_next_out[j] = wp.atomic_exch(bucket_io, bucket + HEAD, j + 1)
                j += size

    @wp.func(module=name)
    def near_shared_node(
        channels: Channels, channel_nodes: wp.array[wp.vec2i], c: int, d: int, i: int, j: int, reach: scalar
    ) -> bool:
        """Tell whether two points lie, together, within ``reach`` of a node that their channels share."""
        up_c = scalar(i - channels.start[c]) * channels.spacing[c]
        down_c = scalar(channels.start[c + 1] - 1 - i) * channels.spacing[c]
        up_d = scalar(j - channels.start[d]) * channels.spacing[d]
        down_d = scalar(channels.start[d + 1] - 1 - j) * channels.spacing[d]
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
    def width_at(points: Points, channels: Channels, channel: int, i: int) -> scalar:
        """Width at a point: its own where it varies along the channel, else the channel's."""
        if points.section:
            return points.section[i][0]
        return channels.form[channel].width

    @wp.func(module=name)
    def reach_along(channels: Channels, constants: CollisionConstants, c: int, d: int) -> scalar:
        """Reach of a node that two channels share, in widths; links of a stem have necks there, as one channel has."""
        if channels.stems.lower:
            if channels.stems.lower[c] == d or channels.stems.lower[d] == c:
                return constants.neck_arc
        return constants.node_reach

    @wp.func(module=name)
    def first_contact(
        points: Points,
        channels: Channels,
        channel_nodes: wp.array[wp.vec2i],
        constants: CollisionConstants,
        own: Block,
        other: Block,
        best: wp.vec2i,
    ) -> wp.vec2i:
        """First contact (i, j) of two blocks, in the order of i and then j, if it comes before ``best``."""
        c, d = own.channel, other.channel
        result = best
        near = HALF * constants.distance * (channels.form[c].widest + channels.form[d].widest)
        near += (HALF * scalar(other.size) + ONE) * channels.spacing[d]
        for i in range(own.begin, own.stop):
            if wp.length_sq(points.xy[i] - other.middle) > near * near:
                continue
            for j in range(other.begin, other.stop):
                if i < result[0] or (i == result[0] and j < result[1]):
                    width_c = width_at(points, channels, c, i)
                    width_d = width_at(points, channels, d, j)
                    touch = HALF * constants.distance * (width_c + width_d)
                    if wp.length_sq(points.xy[j] - points.xy[i]) < touch * touch:
                        reach = reach_along(channels, constants, c, d) * wp.max(width_c, width_d)
                        if not near_shared_node(channels, channel_nodes, c, d, i, j, reach):
                            result = wp.vec2i(i, j)
        return result

    @wp.func(module=name)
    def cell_contact(
        points: Points,
        channels: Channels,
        channel_nodes: wp.array[wp.vec2i],
        constants: CollisionConstants,
        index: BlockIndex,
        head: int,
        level: int,
        block: Block,
        best: wp.vec2i,
    ) -> wp.vec2i:
        """First contact of a block with those of a level in a list, if it comes before ``best``.

        On its own level a channel looks for those of a higher number.
        """
        form = channels.form[block.channel]
        moves = channels.step[block.channel] > ZERO
        own_reach = reach_of(constants, form)
        lowest = int(-1)
        if level_of(constants, form) == level:
            lowest = block.channel
        result = best
        other = int(head)
        while other >= 0:
            d = index.point_owner[other] >> LEVEL_BITS
            # Cells of other levels may share the bucket.
            sought = d > lowest and (index.point_owner[other] & LEVEL_MASK) == level
            if sought and index.channel_river:
                sought = index.channel_river[d] == index.channel_river[block.channel]
            if sought and (moves or channels.step[d] > ZERO):
                far = block_at(points.xy, channels, constants, d, other)
                reach = own_reach + reach_of(constants, channels.form[d])
                if wp.length_sq(far.middle - block.middle) < reach * reach:
                    result = first_contact(points, channels, channel_nodes, constants, block, far, result)
            other = index.point_next[other] - 1
        return result

    @wp.func(module=name)
    def block_contact(
        points: Points,
        channels: Channels,
        channel_nodes: wp.array[wp.vec2i],
        constants: CollisionConstants,
        index: BlockIndex,
        own_level: int,
        block: Block,
    ) -> wp.vec2i:
        """First contact of a block with a channel of a higher number or level, (NOTHING, -1) if there is none."""
        mask = index.bucket.shape[0] // FIELDS - 1
        channel = block.channel
        moves = channels.step[channel] > ZERO
        best = wp.vec2i(NOTHING, -1)
        for level in range(own_level, constants.level_count):
            if (constants.level_mask >> level) & 1 != 0:
                per_cell = ONE / cell_size(constants, level)
                x0 = table.floor_int(block.middle[0] * per_cell - HALF)
                y0 = table.floor_int(block.middle[1] * per_cell - HALF)
                for corner in range(4):
                    cell = bucket_at(x0 + (corner & 1), y0 + (corner >> 1), level, mask)
                    # Most cells hold one channel only, or none that moves: nothing to walk through.
                    alone = index.bucket[cell + HIGH] - 1 == channel and NOTHING - index.bucket[cell + LOW] == channel
                    if not alone and (moves or index.bucket[cell + MOVES] != 0):
                        head = index.bucket[cell + HEAD] - 1
                        best = cell_contact(points, channels, channel_nodes, constants, index, head, level, block, best)
        return best

    @wp.kernel(module=name, enable_backward=False)
    def find_contacts(
        # network
        channels: Channels,
        points: Points,
        channel_nodes: wp.array[wp.vec2i],
        # params
        constants: CollisionConstants,
        work: Work,
        # in
        index: BlockIndex,
        # out
        contacts_io: Contacts,
        status_io: wp.array[int],
    ):
        """Count the blocks of each slab or chunk that touch another channel; where there are pairs, list the contacts.

        Channels touch where |p_i - p_j| < (w_i + w_j) / 2, away from nodes that they share [Paris2023, Sec. 6.2]. Two
        inactive channels are left as they are. Chunks add their count to the status.
        """
        if work.status[HALT] != 0:
            return
        k = work.first + wp.tid()
        count = int(0)
        run = line.begin_runs(channels, work, k)
        while run.stop < run.end:
            run = line.next_run(channels, run)
            size = block_points(channels, constants, run.channel)
            level = level_of(constants, run.form)
            j = run.first + (run.begin - run.first + size - 1) // size * size
            if run.closed != 0:
                j = run.stop
            while j < run.stop:
                block = block_at(points.xy, channels, constants, run.channel, j)
                contact = block_contact(points, channels, channel_nodes, constants, index, level, block)
                if contact[1] >= 0:
                    if contacts_io.pair:
                        contacts_io.pair[contacts_io.share_sum[k] - contacts_io.share_count[k] + count] = contact
                    count += 1
                j += size
        if not contacts_io.pair:
            contacts_io.share_count[k] = count
            if work.chunk > 0 and count > 0:
                wp.atomic_add(status_io, CONTACTS, count)

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
        CollisionConstants=CollisionConstants,
        insert_blocks=insert_blocks,
        find_contacts=find_contacts,
        count_contacts=count_contacts,
    )
