"""Descent in any direction: each cell's water goes to one of the two neighbours beside its steepest descent."""

import functools
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import cells

wp.set_module_options({"enable_backward": False})

# Side of a cell whose water does not go on, and of the padding.
NO_SIDE = 255


@functools.cache
def build(scalar):
    """Make the kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.descent_{scalar.__name__}"
    raster = cells.build(scalar)
    neighbor, own_cell, end_of_side = raster.neighbor, raster.own_cell, raster.end_of_side
    vec2 = wp.types.vector(2, scalar)
    ZERO, HALF, ONE = (scalar(v) for v in (0.0, 0.5, 1.0))
    IS_OPEN = wp.uint8(cells.OPEN)
    # Count of donors of a cell that has been dealt with.
    NO_COUNT = wp.uint8(255)

    @wp.func(module=name)
    def facet_descent(height: scalar, straight: scalar, diagonal: scalar) -> vec2:
        """Steepest descent on the triangle to a straight and a diagonal neighbour [Tarboton1997].

        Returns the square of the slope, 0 or below where there is no descent, and where it crosses the side between
        them: 0 is the straight neighbour, 1 the diagonal one. A neighbour without data is NaN; the slope is NaN where
        both are.
        """
        along = height - straight
        across = straight - diagonal
        if wp.isnan(straight) or across >= along:
            fall = height - diagonal
            return vec2(HALF * fall * wp.abs(fall), ONE)
        if across > ZERO:
            return vec2(along * along + across * across, across / along)
        return vec2(along * wp.abs(along), ZERO)

    @wp.kernel(module=name, enable_backward=False)
    def measure_descents(
        # terrain
        stride: int,
        # in
        cell_height: wp.array[scalar],
        cell_state: wp.array[wp.uint8],
        # out
        cell_side_out: wp.array[wp.uint8],
        cell_crossing_out: wp.array[scalar],
    ):
        """Side that the steepest descent from each cell of a row crosses, of the eight around it, and where.

        A side is told by its straight neighbour times two, plus one if its diagonal neighbour follows clockwise; it is
        NO_SIDE for outlets, pits, flats and cells without data. The padding is not written.
        """
        cell = (wp.tid() + 1) * stride + 1
        end = cell + stride - 2
        while cell < end:
            best = vec2(ZERO, ZERO)
            found = int(NO_SIDE)
            if cell_state[cell] == IS_OPEN:
                height = cell_height[cell]
                for k in range(4):
                    straight = cell_height[neighbor(cell, stride, 2 * k)]
                    way = facet_descent(height, straight, cell_height[neighbor(cell, stride, (2 * k + 7) % 8)])
                    if way[0] > best[0]:
                        best = way
                        found = 4 * k
                    way = facet_descent(height, straight, cell_height[neighbor(cell, stride, 2 * k + 1)])
                    if way[0] > best[0]:
                        best = way
                        found = 4 * k + 1
            cell_side_out[cell] = wp.uint8(found)
            cell_crossing_out[cell] = best[1]
            cell += 1

    @wp.func(module=name)
    def end_cell(cell: int, k: int, rows: int, stride: int, cell_state: wp.array[wp.uint8]) -> int:
        """Neighbour k of a cell, across periodic sides too."""
        return own_cell(neighbor(cell, stride, k), rows, stride, cell_state)

    @wp.func(module=name)
    def diagonal_of(side: int) -> int:
        """Diagonal neighbour at the end of a side."""
        return (side // 2 + 7 + 2 * (side & 1)) % 8

    @wp.func(module=name)
    def count_donors(
        rows: int,
        stride: int,
        cell_state: wp.array[wp.uint8],
        cell_side: wp.array[wp.uint8],
        cell_crossing: wp.array[scalar],
        cell_donors_io: wp.array[wp.uint8],
    ):
        """Count the cells whose water may go to each cell: those for which it is an end of the side."""
        for cell in range(stride + 1, (rows + 1) * stride - 1):
            side = int(cell_side[cell])
            if side != NO_SIDE:
                if cell_crossing[cell] < ONE:
                    n = end_cell(cell, side // 2, rows, stride, cell_state)
                    cell_donors_io[n] = cell_donors_io[n] + wp.uint8(1)
                if cell_crossing[cell] > ZERO:
                    n = end_cell(cell, diagonal_of(side), rows, stride, cell_state)
                    cell_donors_io[n] = cell_donors_io[n] + wp.uint8(1)

    @wp.kernel(module=name, enable_backward=False)
    def lead_downhill(
        # terrain
        rows: int,
        stride: int,
        # in
        cell_state: wp.array[wp.uint8],
        cell_side: wp.array[wp.uint8],
        cell_crossing: wp.array[scalar],
        # out
        cell_donors_io: wp.array[wp.uint8],
        stack_io: wp.array[int],
        cell_gathered_io: wp.array[int],
        cell_largest_io: wp.array[int],
        cell_drift_io: wp.array[scalar],
        cell_receiver_out: wp.array2d[int],
    ):
        """Lead each cell's water along the steepest descent, to one end of the side that it crosses; on one thread.

        It is the end that keeps the course nearest to the descent: transverse deviations are summed down the course,
        along the largest donor [Orlandini2003]. A cell's turn comes when all those have had theirs whose water may go
        to it. ``cell_receiver_out`` starts with each cell's own index, the number of cells gathered at 1; donors, the
        largest donor and the drift start at 0.
        """
        count_donors(rows, stride, cell_state, cell_side, cell_crossing, cell_donors_io)
        columns = stride - 2
        for source in range(stride + 1, (rows + 1) * stride - 1):
            size = int(0)
            if cell_donors_io[source] == wp.uint8(0) and int(cell_side[source]) != NO_SIDE:
                stack_io[0] = source
                size = 1
            while size > 0:
                size -= 1
                cell = stack_io[size]
                cell_donors_io[cell] = NO_COUNT
                side = int(cell_side[cell])
                if side != NO_SIDE:
                    crossing = cell_crossing[cell]
                    end = end_of_side(cell_drift_io[cell], crossing, side)
                    to = end_cell(cell, int(end[0]), rows, stride, cell_state)
                    row = cell // stride - 1
                    cell_receiver_out[row, cell % stride - 1] = (to // stride - 1) * columns + to % stride - 1
                    gathered = cell_gathered_io[cell]
                    cell_gathered_io[to] = cell_gathered_io[to] + gathered
                    if gathered > cell_largest_io[to]:
                        cell_largest_io[to] = gathered
                        cell_drift_io[to] = end[1]
                    if crossing < ONE:
                        n = end_cell(cell, side // 2, rows, stride, cell_state)
                        cell_donors_io[n] = cell_donors_io[n] - wp.uint8(1)
                        if cell_donors_io[n] == wp.uint8(0):
                            stack_io[size] = n
                            size += 1
                    if crossing > ZERO:
                        n = end_cell(cell, diagonal_of(side), rows, stride, cell_state)
                        cell_donors_io[n] = cell_donors_io[n] - wp.uint8(1)
                        if cell_donors_io[n] == wp.uint8(0):
                            stack_io[size] = n
                            size += 1

    return SimpleNamespace(measure_descents=measure_descents, lead_downhill=lead_downhill)
