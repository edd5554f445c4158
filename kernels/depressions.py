"""Depressions: filled by a flood from the outlets, or opened by the smallest cuts; each kernel runs on one thread."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import cells
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the depression kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.depressions_{scalar.__name__}"
    raster = cells.build(scalar)
    neighbor, original, own_cell, distance = raster.neighbor, raster.original, raster.own_cell, raster.distance
    ZERO, ONE = scalar(0.0), scalar(1.0)
    # Half a step between numbers near 1. The sum h + ABOVE |h| rounds to the number after h, as ABOVE is a bit more.
    HALF_STEP = 2.0**-53 if scalar is wp.float64 else 2.0**-24
    ABOVE = scalar(HALF_STEP * (1.0 + 2.0 * HALF_STEP))
    MIN_STEP = scalar(2.0 * HALF_STEP)
    # Fall of a carved course, a fraction of its height a cell: a few steps, so that it never rounds to none.
    FALL = scalar(8.0 * HALF_STEP)
    # What a cell's length of course costs, in m of cutting: it decides between courses that cut the same.
    LENGTH_COST = scalar(2.0**-20)
    # What the counts of rims are: those in the heap, those in closed buckets, and the bucket opened last.
    IN_HEAP, IN_BUCKETS, OPEN_BUCKET = 0, 1, 2
    # What is known of a cell without a lower neighbour: if water leaves its flat, or if a course was searched from it.
    NO_PIT, UNKNOWN, DRAINED, SHUT_IN, SEARCHED = 0, 1, 2, 3, 4
    MAX_BUCKETS = scalar(2.0**30)
    IS_OPEN, IS_DONE = wp.uint8(cells.OPEN), wp.uint8(cells.DONE)
    IS_GHOST, IS_OUTLET = wp.uint8(cells.GHOST), wp.uint8(cells.OUTLET)

    @wp.struct
    class Flood:
        """Size of the padded raster, whether raised cells get a slope, and the buckets that rims wait in by height."""

        rows: int
        stride: int
        epsilon: int
        lowest: scalar
        buckets_per_meter: scalar

    @wp.struct
    class Rims:
        """Rims that wait for their height: lists in buckets, linked by cell, and a heap of those of the open bucket.

        ``bucket`` is the first cell of each list, -1 for none, and ``next`` the one after a cell. ``count`` has three
        numbers (see ``IN_HEAP``).
        """

        next: wp.array[int]
        bucket: wp.array[int]
        count: wp.array[int]
        heap_key: wp.array[scalar]
        heap_cell: wp.array[int]

    @wp.struct
    class Carving:
        """Size of the padded raster and the limits of a course, and what a search notes by cell, with its heap."""

        rows: int
        stride: int
        max_depth: scalar
        max_length: scalar
        cell_from: wp.array[int]
        cell_length: wp.array[scalar]
        cell_mark: wp.array[int]
        heap_key: wp.array[scalar]
        heap_cell: wp.array[int]

    @wp.func(module=name)
    def step_above(height: scalar, epsilon: int) -> scalar:
        """Lowest height that drains to one: the next number, and at least 2^-52 m above; the same without epsilon."""
        if epsilon == 0:
            return height
        return wp.max(height + ABOVE * wp.abs(height), height + MIN_STEP)

    @wp.func(module=name)
    def push_rim(size: int, key: scalar, cell: int, heap_key_io: wp.array[scalar], heap_cell_io: wp.array[int]):
        """Put an entry into a heap of four branches, whose first entry has the smallest key."""
        i = int(size)
        while i > 0:
            parent = (i - 1) >> 2
            parent_key = heap_key_io[parent]
            if parent_key <= key:
                break
            heap_key_io[i] = parent_key
            heap_cell_io[i] = heap_cell_io[parent]
            i = parent
        heap_key_io[i] = key
        heap_cell_io[i] = cell

    @wp.func(module=name)
    def pop_rim(size: int, heap_key_io: wp.array[scalar], heap_cell_io: wp.array[int]):
        """Drop the first entry of a heap of four branches."""
        last = size - 1
        key = heap_key_io[last]
        i = int(0)
        child = int(1)
        while child < last:
            least = int(child)
            least_key = heap_key_io[child]
            for j in range(1, 4):
                if child + j < last:
                    other_key = heap_key_io[child + j]
                    if other_key < least_key:
                        least = child + j
                        least_key = other_key
            if key <= least_key:
                break
            heap_key_io[i] = least_key
            heap_cell_io[i] = heap_cell_io[least]
            i = least
            child = 4 * i + 1
        heap_key_io[i] = key
        heap_cell_io[i] = heap_cell_io[last]

    @wp.func(module=name)
    def borders_open(cell: int, rows: int, stride: int, cell_state: wp.array[wp.uint8]) -> bool:
        """Tell whether water has still to reach a neighbour."""
        for k in range(8):
            n = neighbor(cell, stride, k)
            state = cell_state[n]
            if state == IS_GHOST:
                state = cell_state[original(n, rows, stride)]
            if state == IS_OPEN:
                return True
        return False

    @wp.func(module=name)
    def clear_rims(rims_out: Rims):
        """Make the heap and all buckets empty, and open none."""
        for i in range(rims_out.bucket.shape[0]):
            rims_out.bucket[i] = -1
        rims_out.count[IN_HEAP] = 0
        rims_out.count[IN_BUCKETS] = 0
        rims_out.count[OPEN_BUCKET] = -1

    @wp.func(module=name)
    def queue_rim(flood: Flood, cell: int, level: scalar, rims_io: Rims):
        """Keep a rim until its height comes: in the list of its bucket, or in the heap if that is open already."""
        bucket = int(wp.min((level - flood.lowest) * flood.buckets_per_meter, MAX_BUCKETS))
        bucket = wp.min(bucket, rims_io.bucket.shape[0] - 1)
        if bucket <= rims_io.count[OPEN_BUCKET]:
            push_rim(rims_io.count[IN_HEAP], level, cell, rims_io.heap_key, rims_io.heap_cell)
            rims_io.count[IN_HEAP] = rims_io.count[IN_HEAP] + 1
        else:
            rims_io.next[cell] = rims_io.bucket[bucket]
            rims_io.bucket[bucket] = cell
            rims_io.count[IN_BUCKETS] = rims_io.count[IN_BUCKETS] + 1

    @wp.func(module=name)
    def open_bucket(cell_level: wp.array[scalar], rims_io: Rims):
        """Move the rims of the next bucket that has some into the heap, which is empty."""
        index = rims_io.count[OPEN_BUCKET] + 1
        while rims_io.bucket[index] < 0:
            index += 1
        cell = rims_io.bucket[index]
        size = int(0)
        while cell >= 0:
            push_rim(size, cell_level[cell], cell, rims_io.heap_key, rims_io.heap_cell)
            size += 1
            cell = rims_io.next[cell]
        rims_io.count[OPEN_BUCKET] = index
        rims_io.count[IN_HEAP] = size
        rims_io.count[IN_BUCKETS] = rims_io.count[IN_BUCKETS] - size

    @wp.func(module=name)
    def stack_outlets(end: int, cell_state_io: wp.array[wp.uint8], queue_out: wp.array[int]) -> int:
        """Let water reach all outlets, and put them on the stack; returns their number."""
        size = int(0)
        for cell in range(end):
            if cell_state_io[cell] == IS_OUTLET:
                cell_state_io[cell] = IS_DONE
                queue_out[size] = cell
                size += 1
        return size

    @wp.func(module=name)
    def climb_from(
        flood: Flood,
        stacked: int,
        cell_level: wp.array[scalar],
        cell_state_io: wp.array[wp.uint8],
        queue_io: wp.array[int],
        rims_io: Rims,
    ):
        """Reach all that lies uphill of the stacked cells, and queue the rims among it.

        What drains to a cell that keeps its height keeps its own: no order is needed, and no heap. A cell that has an
        open neighbour below it is a rim that may spill into it; most are not any more when the climb has ended.
        """
        stack = int(stacked)
        found = rims_io.count[IN_HEAP]
        while stack > 0:
            stack -= 1
            cell = queue_io[stack]
            rim = step_above(cell_level[cell], flood.epsilon)
            spills = int(0)
            for k in range(8):
                n = neighbor(cell, flood.stride, k)
                state = cell_state_io[n]
                if state == IS_GHOST:
                    n = original(n, flood.rows, flood.stride)
                    state = cell_state_io[n]
                if state == IS_OPEN:
                    if cell_level[n] >= rim:
                        cell_state_io[n] = IS_DONE
                        queue_io[stack] = n
                        stack += 1
                    else:
                        spills = 1
            if spills == 1:
                # Behind the heap, until they are looked at again; it has the capacity, since no cell comes here twice.
                rims_io.heap_cell[found] = cell
                found += 1
        i = rims_io.count[IN_HEAP]
        while i < found:
            cell = rims_io.heap_cell[i]
            if borders_open(cell, flood.rows, flood.stride, cell_state_io):
                level = cell_level[cell]
                queue_rim(flood, cell, level, rims_io)
            i += 1

    @wp.kernel(module=name, enable_backward=False)
    def flood_cells(
        # params
        flood: Flood,
        # out
        raised_out: wp.array[int],
        cell_level_io: wp.array[scalar],
        cell_state_io: wp.array[wp.uint8],
        queue_io: wp.array[int],
        rims_io: Rims,
    ):
        """Raise every cell to W = max(z, step above the lowest W around it), outlets excepted [Barnes2014].

        That has one lowest solution, whatever the order among equals. Of the cells that water has reached the lowest
        with an open neighbour comes next. Raised cells come in order by themselves, so a plain queue holds them. The
        rims wait in buckets by height, of which one is open as a heap. The stack of climbs grows from the queue's near
        end and the raised cells from its far end; as no cell is of both kinds, they never meet.
        """
        end = (flood.rows + 2) * flood.stride
        clear_rims(rims_io)
        stack = stack_outlets(end, cell_state_io, queue_io)
        first = end - 1
        last = end - 1
        while stack > 0 or first > last or rims_io.count[IN_HEAP] + rims_io.count[IN_BUCKETS] > 0:
            if stack > 0:
                climb_from(flood, stack, cell_level_io, cell_state_io, queue_io, rims_io)
            if rims_io.count[IN_HEAP] == 0 and rims_io.count[IN_BUCKETS] > 0:
                open_bucket(cell_level_io, rims_io)
            stack = 0
            cell = int(-1)
            level = scalar(0.0)
            if first > last:
                cell = queue_io[first]
                level = cell_level_io[cell]
            if rims_io.count[IN_HEAP] > 0 and (first == last or rims_io.heap_key[0] < level):
                cell = rims_io.heap_cell[0]
                level = rims_io.heap_key[0]
                pop_rim(rims_io.count[IN_HEAP], rims_io.heap_key, rims_io.heap_cell)
                rims_io.count[IN_HEAP] = rims_io.count[IN_HEAP] - 1
            elif first > last:
                first -= 1
            if cell >= 0:
                rim = step_above(level, flood.epsilon)
                for k in range(8):
                    n = neighbor(cell, flood.stride, k)
                    state = cell_state_io[n]
                    if state == IS_GHOST:
                        n = original(n, flood.rows, flood.stride)
                        state = cell_state_io[n]
                    if state == IS_OPEN:
                        cell_state_io[n] = IS_DONE
                        if cell_level_io[n] >= rim:
                            queue_io[stack] = n
                            stack += 1
                        else:
                            cell_level_io[n] = rim
                            queue_io[last] = n
                            last -= 1
        raised_out[0] = end - 1 - last

    @wp.kernel(module=name, enable_backward=False)
    def find_pits(
        # terrain
        stride: int,
        # in
        cell_height: wp.array[scalar],
        cell_state: wp.array[wp.uint8],
        # out
        cell_pit_out: wp.array[wp.uint8],
    ):
        """Mark the cells of one row that are no outlets and have no lower neighbour; flats are marked whole."""
        cell = (wp.tid() + 1) * stride + 1
        end = cell + stride - 2
        while cell < end:
            pit = int(NO_PIT)
            if cell_state[cell] == IS_OPEN:
                height = cell_height[cell]
                pit = int(UNKNOWN)
                for k in range(8):
                    if cell_height[neighbor(cell, stride, k)] < height:
                        pit = NO_PIT
            cell_pit_out[cell] = wp.uint8(pit)
            cell += 1

    @wp.func(module=name)
    def push_course(size: int, cost: scalar, cell: int, heap_key_io: wp.array[scalar], heap_cell_io: wp.array[int]):
        """Put an entry into a binary heap, whose first entry has the smallest cost, and the first cell of equals."""
        i = int(size)
        while i > 0:
            parent = (i - 1) >> 1
            if heap_key_io[parent] < cost or (heap_key_io[parent] == cost and heap_cell_io[parent] < cell):
                break
            heap_key_io[i] = heap_key_io[parent]
            heap_cell_io[i] = heap_cell_io[parent]
            i = parent
        heap_key_io[i] = cost
        heap_cell_io[i] = cell

    @wp.func(module=name)
    def pop_course(size: int, heap_key_io: wp.array[scalar], heap_cell_io: wp.array[int]):
        """Drop the first entry of a binary heap."""
        last = size - 1
        cost = heap_key_io[last]
        cell = heap_cell_io[last]
        i = int(0)
        child = int(1)
        while child < last:
            other = child + 1
            if other < last:
                if heap_key_io[other] < heap_key_io[child] or (
                    heap_key_io[other] == heap_key_io[child] and heap_cell_io[other] < heap_cell_io[child]
                ):
                    child = other
            if cost < heap_key_io[child] or (cost == heap_key_io[child] and cell < heap_cell_io[child]):
                break
            heap_key_io[i] = heap_key_io[child]
            heap_cell_io[i] = heap_cell_io[child]
            i = child
            child = 2 * i + 1
        heap_key_io[i] = cost
        heap_cell_io[i] = cell

    @wp.func(module=name)
    def flood_flat(
        pit: int,
        mark: int,
        shut_in: int,
        cell_height: wp.array[scalar],
        cell_state: wp.array[wp.uint8],
        cell_pit_out: wp.array[wp.uint8],
        carving_io: Carving,
    ) -> int:
        """List the cells that are joined to a pit at its height; returns their number, or 0 if water leaves them.

        They get the state DRAINED then, else the one given.
        """
        height = cell_height[pit]
        found = wp.uint8(shut_in)
        size = int(1)
        first = int(0)
        carving_io.heap_cell[0] = pit
        carving_io.cell_mark[pit] = mark
        while first < size:
            cell = carving_io.heap_cell[first]
            first += 1
            if cell_state[cell] == IS_OUTLET:
                found = wp.uint8(DRAINED)
            for k in range(8):
                n = own_cell(neighbor(cell, carving_io.stride, k), carving_io.rows, carving_io.stride, cell_state)
                if cell_state[n] != IS_DONE:
                    if cell_height[n] < height:
                        found = wp.uint8(DRAINED)
                    if cell_height[n] == height and carving_io.cell_mark[n] != mark:
                        carving_io.cell_mark[n] = mark
                        carving_io.heap_cell[size] = n
                        size += 1
        for i in range(size):
            cell_pit_out[carving_io.heap_cell[i]] = found
            carving_io.cell_length[carving_io.heap_cell[i]] = ZERO
        if found == wp.uint8(DRAINED):
            return 0
        return size

    @wp.func(module=name)
    def find_course(
        sources: int,
        bottom: scalar,
        fall: scalar,
        mark: int,
        cell_height: wp.array[scalar],
        cell_state: wp.array[wp.uint8],
        cell_pit: wp.array[wp.uint8],
        carving_io: Carving,
    ) -> int:
        """End of the course of the smallest cut from a pit's cells to drained ground or an outlet; -1 if there is none.

        The cutting in a cell does not depend on where the course came from, so its first discovery is the cheapest.
        """
        size = int(0)
        while size < sources:
            push_course(size, ZERO, carving_io.heap_cell[size], carving_io.heap_key, carving_io.heap_cell)
            size += 1
        while size > 0:
            cell = carving_io.heap_cell[0]
            cost = carving_io.heap_key[0]
            pop_course(size, carving_io.heap_key, carving_io.heap_cell)
            size -= 1
            if cell_state[cell] == IS_OUTLET:
                return cell
            for k in range(8):
                n = own_cell(neighbor(cell, carving_io.stride, k), carving_io.rows, carving_io.stride, cell_state)
                if cell_state[n] != IS_DONE and carving_io.cell_mark[n] != mark:
                    length = carving_io.cell_length[cell] + distance(k)
                    depth = cell_height[n] - bottom
                    if length <= carving_io.max_length and depth <= carving_io.max_depth:
                        carving_io.cell_mark[n] = mark
                        carving_io.cell_from[n] = cell
                        carving_io.cell_length[n] = length
                        if depth < -fall * length:
                            return n
                        if depth == ZERO and (cell_pit[n] == wp.uint8(NO_PIT) or cell_pit[n] == wp.uint8(DRAINED)):
                            return n
                        cutting = wp.max(depth, ZERO) + LENGTH_COST * distance(k)
                        push_course(size, cost + cutting, n, carving_io.heap_key, carving_io.heap_cell)
                        size += 1
        return -1

    @wp.func(module=name)
    def cut_course(end: int, bottom: scalar, fall: scalar, carving: Carving, cell_height_io: wp.array[scalar]):
        """Lower the cells of a course to a line that falls from its pit, or is level if its end is."""
        slope = fall
        if cell_height_io[end] == bottom:
            slope = ZERO
        cell = int(end)
        while carving.cell_length[cell] > ZERO:
            cell_height_io[cell] = wp.min(cell_height_io[cell], bottom - slope * carving.cell_length[cell])
            cell = carving.cell_from[cell]

    @wp.kernel(module=name, enable_backward=False)
    def carve_pits(
        # in
        pit_cell: wp.array[int],
        cell_state: wp.array[wp.uint8],
        # out
        carved_out: wp.array[int],
        cell_height_io: wp.array[scalar],
        cell_pit_io: wp.array[wp.uint8],
        carving_io: Carving,
    ):
        """Open the pits in the order given, lowest first, by the course that takes away the least height [Lindsay2016].

        A course falls from the pit by a few steps between numbers a cell, and cells on it that are higher are lowered
        to it; one to drained ground at the pit's own height is level. So every cell of it drains, no new pit is made,
        and higher pits find the courses of lower ones.
        """
        for cell in range(cell_state.shape[0]):
            carving_io.cell_mark[cell] = 0
        # First tell the flats that water leaves from those that are shut in.
        count = pit_cell.shape[0]
        for i in range(count):
            if cell_pit_io[pit_cell[i]] == wp.uint8(UNKNOWN):
                flood_flat(pit_cell[i], i + 1, SHUT_IN, cell_height_io, cell_state, cell_pit_io, carving_io)
        carved = int(0)
        for i in range(count):
            pit = pit_cell[i]
            if cell_pit_io[pit] == wp.uint8(SHUT_IN):
                bottom = cell_height_io[pit]
                fall = FALL * wp.max(wp.abs(bottom), ONE)
                sources = flood_flat(pit, -1 - i, SEARCHED, cell_height_io, cell_state, cell_pit_io, carving_io)
                end = int(-1)
                if sources > 0:
                    end = find_course(
                        sources, bottom, fall, -1 - i, cell_height_io, cell_state, cell_pit_io, carving_io
                    )
                if end >= 0:
                    carved += 1
                    cut_course(end, bottom, fall, carving_io, cell_height_io)
        carved_out[0] = carved

    return SimpleNamespace(
        Flood=Flood, Rims=Rims, Carving=Carving, flood_cells=flood_cells, find_pits=find_pits, carve_pits=carve_pits
    )
