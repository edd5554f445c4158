"""Descent in any direction: each cell's water goes to one of the two neighbours beside its steepest descent."""

import functools
import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import cells

wp.set_module_options({"enable_backward": False})


@functools.cache
def build(scalar):
    """Make the kernel for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.descent_{scalar.__name__}"
    raster = cells.build(scalar)
    neighbor, own_cell, end_of_side = raster.neighbor, raster.own_cell, raster.end_of_side
    vec2, vec3 = wp.types.vector(2, scalar), wp.types.vector(3, scalar)
    ZERO, ONE, INVERSE_DIAGONAL = scalar(0.0), scalar(1.0), scalar(math.sqrt(0.5))
    IS_OPEN = wp.uint8(cells.OPEN)
    # Count of higher neighbours of a cell that has been dealt with.
    NO_COUNT = wp.uint8(255)

    @wp.func(module=name)
    def facet_descent(height: scalar, straight: scalar, diagonal: scalar) -> vec2:
        """Steepest descent on the triangle to a straight and a diagonal neighbour [Tarboton1997].

        Returns the slope, and where the descent crosses the side between them: 0 is the straight neighbour, 1 the
        diagonal one. A neighbour without data is NaN; the slope is NaN where both are.
        """
        along = height - straight
        across = straight - diagonal
        if wp.isnan(straight) or across >= along:
            return vec2((height - diagonal) * INVERSE_DIAGONAL, ONE)
        if across > ZERO:
            return vec2(wp.sqrt(along * along + across * across), across / along)
        return vec2(along, ZERO)

    @wp.func(module=name)
    def steepest_facet(cell: int, stride: int, cell_height: wp.array[scalar]) -> vec3:
        """Slope, crossing and side of the steepest of the eight triangles around a cell; the slope is 0 in pits.

        A side is told by its straight neighbour times two, plus one if its diagonal neighbour follows clockwise.
        """
        best = vec3(ZERO, ZERO, ZERO)
        height = cell_height[cell]
        side = int(0)
        while side < 16:
            k = side // 2
            straight = cell_height[neighbor(cell, stride, k)]
            diagonal = cell_height[neighbor(cell, stride, (k + 7 + 2 * (side & 1)) % 8)]
            way = facet_descent(height, straight, diagonal)
            if way[0] > best[0]:
                best = vec3(way[0], way[1], scalar(side))
            side += wp.where((side & 1) == 1, 3, 1)
        return best

    @wp.kernel(module=name, enable_backward=False)
    def lead_downhill(
        # terrain
        rows: int,
        stride: int,
        # in
        cell_height: wp.array[scalar],
        cell_state: wp.array[wp.uint8],
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
        along the largest donor [Orlandini2003]. A cell's turn comes when all higher neighbours have had theirs;
        ``cell_donors_io`` starts with their number. Outlets, pits and flats get their own index, cells without data
        -1. ``cell_gathered_io`` starts at 1, the largest donor and the drift at 0.
        """
        columns = stride - 2
        for row in range(rows):
            for column in range(columns):
                cell_receiver_out[row, column] = -1
        for source in range(stride + 1, (rows + 1) * stride - 1):
            size = int(0)
            if cell_donors_io[source] == wp.uint8(0):
                stack_io[0] = source
                size = 1
            while size > 0:
                size -= 1
                cell = stack_io[size]
                cell_donors_io[cell] = NO_COUNT
                to = int(cell)
                facet = steepest_facet(cell, stride, cell_height)
                if cell_state[cell] == IS_OPEN and facet[0] > ZERO:
                    side = int(facet[2])
                    end = end_of_side(cell_drift_io[cell], facet[1], side)
                    to = own_cell(neighbor(cell, stride, int(end[0])), rows, stride, cell_state)
                    gathered = cell_gathered_io[cell]
                    cell_gathered_io[to] = cell_gathered_io[to] + gathered
                    if gathered > cell_largest_io[to]:
                        cell_largest_io[to] = gathered
                        cell_drift_io[to] = end[1]
                receiver = (to // stride - 1) * columns + to % stride - 1
                cell_receiver_out[cell // stride - 1, cell % stride - 1] = receiver
                k = int(0)
                while k < 8:
                    n = neighbor(cell, stride, k)
                    if cell_height[n] < cell_height[cell]:
                        n = own_cell(n, rows, stride, cell_state)
                        cell_donors_io[n] = cell_donors_io[n] - wp.uint8(1)
                        if cell_donors_io[n] == wp.uint8(0):
                            stack_io[size] = n
                            size += 1
                    k += 1

    return SimpleNamespace(lead_downhill=lead_downhill)
