"""Routing: where water goes from each cell, in which order, and what it gathers on the way; D8 and multiple flow."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import cells
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the routing kernels for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.routing_{scalar.__name__}"
    raster = cells.build(scalar)
    neighbor, own_cell = raster.neighbor, raster.own_cell
    row_step, column_step, nearness, distance = raster.row_step, raster.column_step, raster.nearness, raster.distance
    vec8 = wp.types.vector(8, scalar)
    vec8i = wp.types.vector(8, wp.int32)
    ZERO, ONE = scalar(0.0), scalar(1.0)
    IS_OPEN, IS_DONE = wp.uint8(cells.OPEN), wp.uint8(cells.DONE)
    # Count of contributors of a cell that has been dealt with.
    NO_COUNT = wp.uint8(255)

    @wp.kernel(module=name, enable_backward=False)
    def find_receivers(
        # terrain
        rows: int,
        stride: int,
        # params
        four: int,
        ties: int,
        seed: int,
        # in
        cell_height: wp.array[scalar],
        cell_state: wp.array[wp.uint8],
        # out
        cell_receiver_out: wp.array2d[int],
    ):
        """Neighbour of steepest descent of the cells of one row.

        Of equals it is the first clockwise from the north, or, if ``ties`` is 1, the one with the largest hash of seed,
        cell and neighbour. If ``four`` is 1, there are no diagonals. An outlet, a pit and a flat get their own index, a
        cell without data -1. Indices are those of the raster without padding: row * columns + column [OCallaghan1984].
        """
        row = wp.tid()
        columns = stride - 2
        for column in range(columns):
            cell = (row + 1) * stride + column + 1
            state = cell_state[cell]
            receiver = int(-1)
            if state != IS_DONE:
                receiver = row * columns + column
            if state == IS_OPEN:
                height = cell_height[cell]
                steepest = scalar(0.0)
                to = int(-1)
                most = wp.uint32(0)
                for k in range(8):
                    # Beyond a wall there is NaN, which is never steeper.
                    slope = (height - cell_height[neighbor(cell, stride, k)]) * nearness(k)
                    if slope > ZERO and slope >= steepest and (four == 0 or (k & 1) == 0):
                        lot = wp.uint32(0)
                        if ties == 1:
                            lot = wp.rand_init(int(wp.rand_init(seed, row * columns + column)), k)
                        if slope > steepest or lot > most:
                            steepest = slope
                            most = lot
                            to = k
                if to >= 0:
                    receiver_row = (row + row_step(to) + rows) % rows
                    receiver = receiver_row * columns + (column + column_step(to) + columns) % columns
            cell_receiver_out[row, column] = receiver

    @wp.kernel(module=name, enable_backward=False)
    def order_cells(
        # in
        cell_receiver: wp.array[int],
        # out
        count_out: wp.array[int],
        order_out: wp.array[int],
        cell_donors_io: wp.array[wp.uint8],
    ):
        """List the cells so that each stands before its receiver, and count them; on one thread.

        Every course is followed from its source down to the first cell that still waits for another donor [Zhou2019].
        Cells of a cycle are left out. ``cell_donors_io`` starts at 0.
        """
        end = cell_receiver.shape[0]
        for cell in range(end):
            receiver = cell_receiver[cell]
            if receiver < 0:
                cell_donors_io[cell] = NO_COUNT
            elif receiver != cell:
                cell_donors_io[receiver] = cell_donors_io[receiver] + wp.uint8(1)
        count = int(0)
        for source in range(end):
            cell = int(source)
            while cell_donors_io[cell] == wp.uint8(0):
                order_out[count] = cell
                count += 1
                cell_donors_io[cell] = NO_COUNT
                receiver = cell_receiver[cell]
                if receiver != cell:
                    cell_donors_io[receiver] = cell_donors_io[receiver] - wp.uint8(1)
                    cell = receiver
        count_out[0] = count

    @wp.kernel(module=name, enable_backward=False)
    def sum_upstream(
        # in
        cell_receiver: wp.array[int],
        order: wp.array[int],
        # out
        cell_sum_io: wp.array[scalar],
    ):
        """Add to each cell what its donors have gathered, A_i = a_i + sum A_donors; on one thread, down the order."""
        for i in range(order.shape[0]):
            cell = order[i]
            receiver = cell_receiver[cell]
            if receiver != cell:
                cell_sum_io[receiver] = cell_sum_io[receiver] + cell_sum_io[cell]

    @wp.func(module=name)
    def course_step(cell: int, receiver: int, columns: int) -> scalar:
        """Distance from a cell to its receiver in cells; 0 to itself."""
        same_row = cell // columns == receiver // columns
        same_column = cell % columns == receiver % columns
        if same_row and same_column:
            return ZERO
        if same_row or same_column:
            return ONE
        return distance(1)

    @wp.kernel(module=name, enable_backward=False)
    def measure_downstream(
        # terrain
        columns: int,
        # in
        cell_receiver: wp.array[int],
        order: wp.array[int],
        # out
        cell_length_io: wp.array[scalar],
    ):
        """Length of the course from each cell to where it ends, in cells; on one thread, up the order."""
        for i in range(order.shape[0]):
            cell = order[order.shape[0] - 1 - i]
            receiver = cell_receiver[cell]
            length = scalar(0.0)
            if receiver != cell:
                length = cell_length_io[receiver] + course_step(cell, receiver, columns)
            cell_length_io[cell] = length

    @wp.kernel(module=name, enable_backward=False)
    def measure_upstream(
        # terrain
        columns: int,
        # in
        cell_receiver: wp.array[int],
        order: wp.array[int],
        # out
        cell_length_io: wp.array[scalar],
    ):
        """Length of the longest course down to each cell, in cells; on one thread, down the order; starts at 0."""
        for i in range(order.shape[0]):
            cell = order[i]
            receiver = cell_receiver[cell]
            if receiver != cell:
                length = cell_length_io[cell] + course_step(cell, receiver, columns)
                cell_length_io[receiver] = wp.max(cell_length_io[receiver], length)

    @wp.kernel(module=name, enable_backward=False)
    def carry_upstream(
        # in
        cell_receiver: wp.array[int],
        order: wp.array[int],
        cell_fixed: wp.array[wp.uint8],
        # out
        cell_value_io: wp.array[scalar],
    ):
        """Give each cell the value of the first fixed cell down its course; on one thread, up the order.

        ``cell_value_io`` starts with the values of the fixed cells, and NaN elsewhere.
        """
        for i in range(order.shape[0]):
            cell = order[order.shape[0] - 1 - i]
            if cell_fixed[cell] == wp.uint8(0):
                cell_value_io[cell] = cell_value_io[cell_receiver[cell]]

    @wp.kernel(module=name, enable_backward=False)
    def measure_slopes(
        # in
        cell_height: wp.array2d[scalar],
        cell_receiver: wp.array2d[int],
        # out
        cell_slope_out: wp.array2d[scalar],
    ):
        """Fall to the receiver over the distance to it, in height per cell, for one row; 0 where there is none."""
        row = wp.tid()
        columns = cell_height.shape[1]
        for column in range(columns):
            cell = row * columns + column
            receiver = cell_receiver[row, column]
            slope = cell_height[row, column]
            if receiver >= 0:
                slope = scalar(0.0)
                step = course_step(cell, receiver, columns)
                if step > ZERO:
                    fall = cell_height[row, column] - cell_height[receiver // columns, receiver % columns]
                    slope = fall / step
            cell_slope_out[row, column] = slope

    @wp.kernel(module=name, enable_backward=False)
    def count_contributors(
        # terrain
        stride: int,
        # in
        cell_height: wp.array[scalar],
        cell_state: wp.array[wp.uint8],
        # out
        cell_donors_out: wp.array[wp.uint8],
    ):
        """Count the higher neighbours of the cells of one row: those that will have been dealt with before."""
        cell = (wp.tid() + 1) * stride + 1
        end = cell + stride - 2
        while cell < end:
            donors = int(255)
            if cell_state[cell] != IS_DONE:
                donors = int(0)
                height = cell_height[cell]
                for k in range(8):
                    donors += wp.where(cell_height[neighbor(cell, stride, k)] > height, 1, 0)
            cell_donors_out[cell] = wp.uint8(donors)
            cell += 1

    @wp.kernel(module=name, enable_backward=False)
    def share_downhill(
        # terrain
        rows: int,
        stride: int,
        # params
        exponent: scalar,
        # in
        cell_height: wp.array[scalar],
        cell_state: wp.array[wp.uint8],
        # out
        cell_sum_io: wp.array[scalar],
        cell_donors_io: wp.array[wp.uint8],
        stack_io: wp.array[int],
    ):
        """Pass what each cell has gathered on to its lower neighbours, in fractions s_k^p / sum s^p [Freeman1991].

        A cell passes on when its last contributor has; on one thread, with a stack of the cells that can. Slopes are
        taken relative to the steepest one, so that tiny ones do not vanish in the power.
        """
        share = vec8()
        lower = vec8i()
        last = (rows + 1) * stride - 1
        for source in range(stride + 1, last):
            size = int(0)
            if cell_donors_io[source] == wp.uint8(0):
                stack_io[0] = source
                size = 1
            while size > 0:
                size -= 1
                cell = stack_io[size]
                cell_donors_io[cell] = NO_COUNT
                height = cell_height[cell]
                steepest = scalar(0.0)
                first = int(0)
                count = int(0)
                for k in range(8):
                    n = neighbor(cell, stride, k)
                    slope = (height - cell_height[n]) * nearness(k)
                    lower[count] = n
                    share[count] = slope
                    if slope > steepest:
                        steepest = slope
                        first = count
                    count += wp.where(slope > ZERO, 1, 0)
                n = lower[first]
                lower[first] = lower[0]
                share[first] = share[0]
                lower[0] = n
                share[0] = ONE
                total = scalar(1.0)
                for i in range(1, count):
                    relative = wp.pow(share[i] / steepest, exponent)
                    share[i] = relative
                    total += relative
                gathered = cell_sum_io[cell] / total
                if cell_state[cell] != IS_OPEN:
                    gathered = ZERO
                for i in range(count):
                    n = own_cell(lower[i], rows, stride, cell_state)
                    cell_sum_io[n] = cell_sum_io[n] + share[i] * gathered
                    donors = cell_donors_io[n] - wp.uint8(1)
                    cell_donors_io[n] = donors
                    stack_io[size] = n
                    size += wp.where(donors == wp.uint8(0), 1, 0)

    return SimpleNamespace(
        find_receivers=find_receivers,
        order_cells=order_cells,
        sum_upstream=sum_upstream,
        measure_downstream=measure_downstream,
        measure_upstream=measure_upstream,
        carry_upstream=carry_upstream,
        measure_slopes=measure_slopes,
        count_contributors=count_contributors,
        share_downhill=share_downhill,
    )
