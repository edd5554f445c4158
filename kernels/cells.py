"""Cells of a padded raster: a row and a column more on every side, so that every cell has eight neighbours.

The padding is a wall or a ghost, a copy of the cell at the far side of a periodic raster. Cell (row, column) lies at
(row + 1) stride + column + 1 of the flat array, where stride is the number of columns with the padding. Neighbours are
numbered 0 .. 7, clockwise from the north; the odd ones are diagonal.
"""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# State of a cell while water is led over the raster: OPEN until water has reached it, then DONE, as walls always are.
OPEN, DONE, GHOST, OUTLET = 0, 1, 2, 3


@once
def build(scalar):
    """Make the functions and kernels on cells for one precision of the heights.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.cells_{scalar.__name__}"
    ONE, DIAGONAL, INVERSE_DIAGONAL = scalar(1.0), scalar(math.sqrt(2.0)), scalar(math.sqrt(0.5))
    IS_OPEN, IS_DONE, IS_GHOST, IS_OUTLET = (wp.uint8(v) for v in (OPEN, DONE, GHOST, OUTLET))

    @wp.func(module=name)
    def row_step(k: int) -> int:
        """Rows from a cell south to its neighbour k."""
        if k == 7 or k < 2:
            return -1
        if k > 2 and k < 6:
            return 1
        return 0

    @wp.func(module=name)
    def column_step(k: int) -> int:
        """Columns from a cell east to its neighbour k."""
        if k > 0 and k < 4:
            return 1
        if k > 4:
            return -1
        return 0

    @wp.func(module=name)
    def neighbor(cell: int, stride: int, k: int) -> int:
        """Neighbour k of a cell; it may be a wall or a ghost."""
        return cell + row_step(k) * stride + column_step(k)

    @wp.func(module=name)
    def original(cell: int, rows: int, stride: int) -> int:
        """Cell of which a ghost is the copy."""
        columns = stride - 2
        row = (cell // stride - 1 + rows) % rows
        column = (cell % stride - 1 + columns) % columns
        return (row + 1) * stride + column + 1

    @wp.func(module=name)
    def own_cell(cell: int, rows: int, stride: int, cell_state: wp.array[wp.uint8]) -> int:
        """The cell, or of a ghost the cell of which it is the copy."""
        if cell_state[cell] == IS_GHOST:
            return original(cell, rows, stride)
        return cell

    @wp.func(module=name)
    def distance(k: int) -> scalar:
        """Cells from a centre to that of neighbour k."""
        if (k & 1) == 1:
            return DIAGONAL
        return ONE

    @wp.func(module=name)
    def nearness(k: int) -> scalar:
        """One over the distance to neighbour k, per cell."""
        if (k & 1) == 1:
            return INVERSE_DIAGONAL
        return ONE

    @wp.func(module=name)
    def spread_from(
        start: int,
        rows: int,
        stride: int,
        cell_height: wp.array[scalar],
        cell_reached_io: wp.array[wp.uint8],
        stack_io: wp.array[int],
    ) -> int:
        """Reach all cells that are joined to one; returns the lowest of them, the first in the raster among equals."""
        lowest = int(start)
        stack_io[0] = start
        cell_reached_io[start] = IS_DONE
        size = int(1)
        while size > 0:
            size -= 1
            cell = stack_io[size]
            height = cell_height[cell]
            if height < cell_height[lowest] or (height == cell_height[lowest] and cell < lowest):
                lowest = cell
            for k in range(8):
                n = own_cell(neighbor(cell, stride, k), rows, stride, cell_reached_io)
                if cell_reached_io[n] != IS_DONE:
                    cell_reached_io[n] = IS_DONE
                    stack_io[size] = n
                    size += 1
        return lowest

    @wp.kernel(module=name, enable_backward=False)
    def drain_landlocked(
        # terrain
        rows: int,
        stride: int,
        # in
        cell_height: wp.array[scalar],
        # out
        count_out: wp.array[int],
        cell_state_io: wp.array[wp.uint8],
        cell_reached_io: wp.array[wp.uint8],
        stack_out: wp.array[int],
    ):
        """Make the lowest cell of every piece of ground without an outlet an outlet, and count them; on one thread.

        ``cell_reached_io`` starts as a copy of the states.
        """
        landlocked = int(0)
        last = (rows + 1) * stride - 1
        for cell in range(stride + 1, last):
            if cell_reached_io[cell] == IS_OUTLET:
                spread_from(cell, rows, stride, cell_height, cell_reached_io, stack_out)
        for cell in range(stride + 1, last):
            if cell_reached_io[cell] == IS_OPEN:
                lowest = spread_from(cell, rows, stride, cell_height, cell_reached_io, stack_out)
                if cell_state_io[lowest] == IS_OPEN:
                    cell_state_io[lowest] = IS_OUTLET
                    landlocked += 1
        count_out[0] = landlocked

    return SimpleNamespace(
        row_step=row_step,
        column_step=column_step,
        neighbor=neighbor,
        original=original,
        own_cell=own_cell,
        distance=distance,
        nearness=nearness,
        drain_landlocked=drain_landlocked,
    )
