"""Flats: connected cells of one height without lower neighbours; how far their shores are, and the ways out.

The cells of a flat are its members, listed one flat after another. A flat ends at its shores, the higher cells and
walls around it, and at its exits, cells of its height that water leaves by: such with lower neighbours, and, if it has
none of these, outlets. Nothing passes from flat to flat, so that each is one thread's work.
"""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import cells
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# What a march through a flat begins at.
SHORES, EXITS = 0, 1


@once
def build(scalar):
    """Make the kernels on flats for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.flats_{scalar.__name__}"
    raster = cells.build(scalar)
    neighbor, own_cell = raster.neighbor, raster.own_cell
    vec2 = wp.types.vector(2, scalar)
    ZERO, ONE, DIAGONAL, HALF_DIAGONAL = (scalar(v) for v in (0.0, 1.0, math.sqrt(2.0), math.sqrt(0.5)))
    FAR = scalar(math.inf)
    IS_OPEN, IS_DONE, IS_OUTLET = wp.uint8(cells.OPEN), wp.uint8(cells.DONE), wp.uint8(cells.OUTLET)
    # Place in the heap of a member that does not wait there, and of one that the march has reached.
    NOWHERE, REACHED = -1, -2

    @wp.struct
    class Flats:
        """The padded raster, its flats, and what a march begins at.

        ``toll`` is the length in cells that a way begins with. ``cell_member`` is the member that a cell is, -1 for
        none; ``start`` are the offsets of the flats' members, and ``inner`` is 1 for flats with exits that are no
        outlets.
        """

        rows: int
        stride: int
        begin: int
        toll: scalar
        height: wp.array[scalar]
        state: wp.array[wp.uint8]
        cell_member: wp.array[int]
        member_cell: wp.array[int]
        start: wp.array[int]
        inner: wp.array[int]

    @wp.kernel(module=name, enable_backward=False)
    def list_flats(
        # in
        cell_pit: wp.array[wp.uint8],
        # out
        flats_io: Flats,
        count_out: wp.array[int],
    ):
        """List the members of all flats, and count the members and the flats; on one thread.

        ``cell_pit`` is not 0 in the cells that are no outlets and have no lower neighbour; ``cell_member`` starts at
        -1.
        """
        size = int(0)
        flats = int(0)
        flats_io.start[0] = 0
        for start in range(cell_pit.shape[0]):
            if cell_pit[start] != wp.uint8(0) and flats_io.cell_member[start] < 0:
                first = int(size)
                inner = int(0)
                level = flats_io.height[start]
                flats_io.cell_member[start] = size
                flats_io.member_cell[size] = start
                size += 1
                while first < size:
                    cell = flats_io.member_cell[first]
                    first += 1
                    for k in range(8):
                        n = own_cell(neighbor(cell, flats_io.stride, k), flats_io.rows, flats_io.stride, flats_io.state)
                        if flats_io.state[n] == IS_OPEN and flats_io.height[n] == level:
                            if cell_pit[n] == wp.uint8(0):
                                inner = 1
                            elif flats_io.cell_member[n] < 0:
                                flats_io.cell_member[n] = size
                                flats_io.member_cell[size] = n
                                size += 1
                flats_io.inner[flats] = inner
                flats += 1
                flats_io.start[flats] = size
        count_out[0] = size
        count_out[1] = flats

    @wp.func(module=name)
    def interior_index(cell: int, stride: int) -> int:
        """Index of a cell in the raster without padding."""
        return (cell // stride - 1) * (stride - 2) + cell % stride - 1

    @wp.func(module=name)
    def is_seed(flats: Flats, flat: int, cell: int, level: scalar) -> bool:
        """Tell whether a march through a flat begins at a cell, a neighbour of a member.

        The open side of the map is a shore where water leaves inside of it: courses do not run along it.
        """
        state = flats.state[cell]
        if flats.begin == SHORES:
            return state == IS_DONE or flats.height[cell] > level or (state == IS_OUTLET and flats.inner[flat] == 1)
        if state == IS_DONE or flats.height[cell] != level:
            return False
        if state == IS_OUTLET:
            return flats.inner[flat] == 0
        return flats.cell_member[cell] < 0

    @wp.func(module=name)
    def known_length(
        flats: Flats,
        flat: int,
        member: int,
        direction: int,
        member_cost: wp.array[scalar],
        member_place: wp.array[int],
        member_length: wp.array[scalar],
    ) -> scalar:
        """Length of the way from a neighbour of a member to where the march began, if it is known; else infinite.

        Where it begins the length is the toll, some cells of the member's cost. So exits are chosen that lie far from
        the shore, and of a narrow mouth the middle.
        """
        cell = flats.member_cell[member]
        n = own_cell(neighbor(cell, flats.stride, direction), flats.rows, flats.stride, flats.state)
        other = flats.cell_member[n]
        if other >= 0:
            if member_place[other] == REACHED:
                return member_length[other]
            return FAR
        if is_seed(flats, flat, n, flats.height[cell]):
            return flats.toll * member_cost[member]
        return FAR

    @wp.func(module=name)
    def way_between(straight: scalar, diagonal: scalar, cost: scalar) -> vec2:
        """Length of the shortest way that crosses the side between a straight and a diagonal neighbour, and where.

        Along the side the remaining length is taken as linear; 0 is the straight neighbour, 1 the diagonal one
        [Ferguson2006].
        """
        if diagonal == FAR:
            return vec2(straight + cost, ZERO)
        fall = straight - diagonal
        if fall >= cost * HALF_DIAGONAL:
            return vec2(diagonal + cost * DIAGONAL, ONE)
        if fall <= ZERO:
            return vec2(straight + cost, ZERO)
        sine = fall / cost
        cosine = wp.sqrt(ONE - sine * sine)
        return vec2(straight + cost * cosine, sine / cosine)

    @wp.func(module=name)
    def rise_in_heap(
        start: int,
        first: int,
        member: int,
        member_length: wp.array[scalar],
        member_place_out: wp.array[int],
        heap_io: wp.array[int],
    ):
        """Put a member into a binary heap that begins at ``first``, from a place on upwards."""
        i = int(start)
        length = member_length[member]
        while i > 0:
            parent = (i - 1) >> 1
            other = heap_io[first + parent]
            if member_length[other] < length or (member_length[other] == length and other < member):
                break
            heap_io[first + i] = other
            member_place_out[other] = i
            i = parent
        heap_io[first + i] = member
        member_place_out[member] = i

    @wp.func(module=name)
    def take_nearest(
        size: int, first: int, member_length: wp.array[scalar], member_place_out: wp.array[int], heap_io: wp.array[int]
    ) -> int:
        """Take the member with the shortest way, and of equals the first, out of a heap of the given size."""
        nearest = heap_io[first]
        last = size - 1
        member = heap_io[first + last]
        length = member_length[member]
        i = int(0)
        child = int(1)
        while child < last:
            one = heap_io[first + child]
            if child + 1 < last:
                other = heap_io[first + child + 1]
                if member_length[other] < member_length[one] or (
                    member_length[other] == member_length[one] and other < one
                ):
                    child += 1
                    one = other
            if length < member_length[one] or (length == member_length[one] and member < one):
                break
            heap_io[first + i] = one
            member_place_out[one] = i
            i = child
            child = 2 * i + 1
        heap_io[first + i] = member
        member_place_out[member] = i
        member_place_out[nearest] = REACHED
        return nearest

    @wp.func(module=name)
    def offer_way(
        flats: Flats,
        flat: int,
        member: int,
        toward: int,
        size: int,
        member_cost: wp.array[scalar],
        member_length_io: wp.array[scalar],
        member_side_out: wp.array[wp.uint8],
        member_crossing_out: wp.array[scalar],
        member_place_io: wp.array[int],
        heap_io: wp.array[int],
    ) -> int:
        """Shorten a member's way by the ways past a neighbour that is reached; returns the size of the heap then.

        A side is told by its straight neighbour times two, plus one if its diagonal neighbour follows clockwise.
        """
        length = member_length_io[member]
        found = int(0)
        turn = int(0)
        while turn < 2:
            straight = toward
            clockwise = turn
            if (toward & 1) == 1:
                straight = (toward + 1 + 6 * turn) % 8
            diagonal = (straight + 1 + 6 * (1 - clockwise)) % 8
            a = known_length(flats, flat, member, straight, member_cost, member_place_io, member_length_io)
            b = known_length(flats, flat, member, diagonal, member_cost, member_place_io, member_length_io)
            way = vec2(FAR, ZERO)
            if a < FAR or b < FAR:
                way = way_between(a, b, member_cost[member])
            if way[0] < length:
                length = way[0]
                member_side_out[member] = wp.uint8(2 * straight + clockwise)
                member_crossing_out[member] = way[1]
                found = 1
            turn += 1
        if found == 0:
            return size
        member_length_io[member] = length
        start = member_place_io[member]
        more = int(size)
        if start == NOWHERE:
            start = size
            more += 1
        rise_in_heap(start, flats.start[flat], member, member_length_io, member_place_io, heap_io)
        return more

    @wp.kernel(module=name, enable_backward=False)
    def march_flats(
        # terrain
        flats: Flats,
        # in
        member_cost: wp.array[scalar],
        # out
        member_length_io: wp.array[scalar],
        member_side_out: wp.array[wp.uint8],
        member_crossing_out: wp.array[scalar],
        member_order_out: wp.array[int],
        member_place_io: wp.array[int],
        heap_io: wp.array[int],
    ):
        """Length of the shortest way from each member of a flat to where the march begins, and the side it crosses.

        It is the solution of the eikonal equation, |grad T| = cost, by a fast march [Sethian1996] over the eight
        triangles around each cell. Members are listed in the order in which they are reached.
        """
        flat = wp.tid()
        first = flats.start[flat]
        size = int(0)
        for member in range(first, flats.start[flat + 1]):
            member_length_io[member] = FAR
            member_place_io[member] = NOWHERE
            member_side_out[member] = wp.uint8(0)
            member_crossing_out[member] = ZERO
        for member in range(first, flats.start[flat + 1]):
            # Not unrolled, which would make eight copies of it all.
            k = int(0)
            while k < 8:
                if known_length(flats, flat, member, k, member_cost, member_place_io, member_length_io) < FAR:
                    size = offer_way(
                        flats, flat, member, k, size, member_cost, member_length_io,
                        member_side_out, member_crossing_out, member_place_io, heap_io,
                    )  # fmt: skip
                k += 1
        reached = int(first)
        while size > 0:
            nearest = take_nearest(size, first, member_length_io, member_place_io, heap_io)
            size -= 1
            member_order_out[reached] = nearest
            reached += 1
            cell = flats.member_cell[nearest]
            k = int(0)
            while k < 8:
                n = own_cell(neighbor(cell, flats.stride, k), flats.rows, flats.stride, flats.state)
                other = flats.cell_member[n]
                if other >= 0:
                    if member_place_io[other] != REACHED:
                        size = offer_way(
                            flats, flat, other, (k + 4) % 8, size, member_cost, member_length_io,
                            member_side_out, member_crossing_out, member_place_io, heap_io,
                        )  # fmt: skip
                k += 1

    @wp.kernel(module=name, enable_backward=False)
    def lead_flats(
        # terrain
        flats: Flats,
        # in
        member_side: wp.array[wp.uint8],
        member_crossing: wp.array[scalar],
        member_order: wp.array[int],
        # out
        member_gathered_io: wp.array[int],
        member_largest_io: wp.array[int],
        member_drift_io: wp.array[scalar],
        cell_receiver_out: wp.array2d[int],
    ):
        """Lead the water of a flat to its exits: of the two ends of the side that a way crosses, to one.

        It is the end that keeps the course nearest to the way: transverse deviations are summed down the course, along
        the largest donor [Orlandini2003]. Members that were reached last come first.
        """
        flat = wp.tid()
        first = flats.start[flat]
        end = flats.start[flat + 1]
        for member in range(first, end):
            member_gathered_io[member] = 1
            member_largest_io[member] = 0
            member_drift_io[member] = ZERO
        for i in range(end - first):
            member = member_order[end - 1 - i]
            cell = flats.member_cell[member]
            crossing = member_crossing[member]
            code = int(member_side[member])
            clockwise = 2 * (code & 1) - 1
            k = code // 2
            n = own_cell(neighbor(cell, flats.stride, k), flats.rows, flats.stride, flats.state)
            rise = scalar(clockwise) / wp.sqrt(ONE + crossing * crossing)
            drift = member_drift_io[member] - rise * crossing
            if crossing > ZERO:
                k = (k + clockwise + 8) % 8
                other = own_cell(neighbor(cell, flats.stride, k), flats.rows, flats.stride, flats.state)
                other_drift = member_drift_io[member] + rise * (ONE - crossing)
                if crossing == ONE or wp.abs(other_drift) < wp.abs(drift):
                    n = other
                    drift = other_drift
            cell_receiver_out[cell // flats.stride - 1, cell % flats.stride - 1] = interior_index(n, flats.stride)
            to = flats.cell_member[n]
            if to >= 0:
                gathered = member_gathered_io[member]
                member_gathered_io[to] = member_gathered_io[to] + gathered
                if gathered > member_largest_io[to]:
                    member_largest_io[to] = gathered
                    member_drift_io[to] = drift

    return SimpleNamespace(Flats=Flats, list_flats=list_flats, march_flats=march_flats, lead_flats=lead_flats)
