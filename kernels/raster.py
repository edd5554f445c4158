"""Rasters: sampling at points, and functions that several processes share: which cell, value, gradient, the edges.

Row 0 is the north edge. A value belongs to its cell's centre. One rule holds at the outer edges and beside cells that
have no data (NaN): of the four centres around a point those that are missing drop out, and the weights of the others
are scaled up to 1. So a value goes on unchanged through the outer half cell, and a point whose own cell is missing gets
NaN.
"""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make functions and kernels on rasters for one precision of the positions; the rasters hold float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.raster_{scalar.__name__}"
    vec2 = wp.types.vector(2, scalar)
    HALF, ONE = scalar(0.5), scalar(1.0)
    ZERO_64, HALF_64, ONE_64, NAN_64 = (wp.float64(v) for v in (0.0, 0.5, 1.0, math.nan))
    # Fraction of a cell by which a point on the outer edge may miss it through rounding.
    SLACK = scalar(1.0e-6 if scalar is wp.float64 else 1.0e-3)

    @wp.struct
    class RasterGrid:
        """Where a raster lies, relative to the same zero as the points that are looked up in it; m and 1/m."""

        west: scalar
        north: scalar
        cell_size: scalar
        cells_per_meter: scalar

    @wp.func(module=name)
    def cell_position(grid: RasterGrid, xy: vec2) -> vec2:
        """Column and row of a point as fractions; whole numbers at the cells' centres."""
        column = (xy[0] - grid.west) * grid.cells_per_meter - HALF
        row = (grid.north - xy[1]) * grid.cells_per_meter - HALF
        return vec2(column, row)

    @wp.func(module=name)
    def is_within(rows: int, columns: int, position: vec2) -> bool:
        """Tell whether a position, as ``cell_position`` gives it, lies on a raster, its outer edge included."""
        low = -HALF - SLACK
        return (
            position[0] >= low
            and position[1] >= low
            and position[0] <= scalar(columns) + low + SLACK + SLACK
            and position[1] <= scalar(rows) + low + SLACK + SLACK
        )

    @wp.func(module=name)
    def is_inside(cell_value: wp.array2d[wp.float64], position: vec2) -> bool:
        """Tell whether a position lies on the raster."""
        return is_within(cell_value.shape[0], cell_value.shape[1], position)

    @wp.func(module=name)
    def own_cell(rows: int, columns: int, position: vec2) -> wp.vec2i:
        """Row and column of the cell that a position on a raster lies in."""
        column = wp.clamp(int(position[0] + HALF), 0, columns - 1)
        return wp.vec2i(wp.clamp(int(position[1] + HALF), 0, rows - 1), column)

    @wp.func(module=name)
    def own_value(cell_value: wp.array2d[wp.float64], position: vec2) -> wp.float64:
        """Value of the cell that a position on the raster lies in."""
        cell = own_cell(cell_value.shape[0], cell_value.shape[1], position)
        return cell_value[cell[0], cell[1]]

    @wp.func(module=name)
    def corner_weight(corner: int, u: wp.float64, v: wp.float64) -> wp.float64:
        """Bilinear weight of corner 0 .. 3 (+1 column, +2 rows) at the parts u of a column and v of a row."""
        wu, wv = ONE_64 - u, ONE_64 - v
        if corner % 2 == 1:
            wu = u
        if corner >= 2:
            wv = v
        return wu * wv

    @wp.func(module=name)
    def value_near_gap(
        cell_value: wp.array2d[wp.float64], position: vec2, column: int, row: int, u: wp.float64, v: wp.float64
    ) -> wp.float64:
        """Weighted mean of those of the four centres that have data; NaN where the point's own cell has none."""
        if wp.isnan(own_value(cell_value, position)):
            return NAN_64
        total = wp.float64(0.0)
        weights = wp.float64(0.0)
        for corner in range(4):
            j = wp.clamp(column + corner % 2, 0, cell_value.shape[1] - 1)
            i = wp.clamp(row + corner // 2, 0, cell_value.shape[0] - 1)
            weight = corner_weight(corner, u, v)
            if not wp.isnan(cell_value[i, j]):
                total += weight * cell_value[i, j]
                weights += weight
        return total / weights

    @wp.func(module=name)
    def value_at(cell_value: wp.array2d[wp.float64], grid: RasterGrid, xy: vec2) -> wp.float64:
        """Value at a point: bilinear between the centres; NaN off the raster and in cells without data."""
        position = cell_position(grid, xy)
        if not is_inside(cell_value, position):
            return NAN_64
        column, row = int(position[0] + ONE) - 1, int(position[1] + ONE) - 1
        u, v = wp.float64(position[0] - scalar(column)), wp.float64(position[1] - scalar(row))
        west, east = wp.max(column, 0), wp.min(column + 1, cell_value.shape[1] - 1)
        north, south = wp.max(row, 0), wp.min(row + 1, cell_value.shape[0] - 1)
        upper = cell_value[north, west] + u * (cell_value[north, east] - cell_value[north, west])
        lower = cell_value[south, west] + u * (cell_value[south, east] - cell_value[south, west])
        value = upper + v * (lower - upper)
        if wp.isnan(value):
            return value_near_gap(cell_value, position, column, row, u, v)
        return value

    @wp.func(module=name)
    def difference(before: wp.float64, here: wp.float64, after: wp.float64) -> wp.float64:
        """Change per cell: central, one-sided where a neighbour is missing, 0 where both are."""
        if wp.isnan(before):
            if wp.isnan(after):
                return ZERO_64
            return after - here
        if wp.isnan(after):
            return here - before
        return HALF_64 * (after - before)

    @wp.func(module=name)
    def value_or_gap(cell_value: wp.array2d[wp.float64], row: int, column: int) -> wp.float64:
        """Value of a cell; NaN beyond the edge."""
        if row < 0 or column < 0 or row >= cell_value.shape[0] or column >= cell_value.shape[1]:
            return NAN_64
        return cell_value[row, column]

    @wp.func(module=name)
    def cell_difference(cell_value: wp.array2d[wp.float64], row: int, column: int) -> wp.vec2d:
        """Change of the value per cell towards east and north at a cell; NaN where it has no data."""
        here = cell_value[row, column]
        if wp.isnan(here):
            return wp.vec2d(NAN_64, NAN_64)
        west, east = value_or_gap(cell_value, row, column - 1), value_or_gap(cell_value, row, column + 1)
        south, north = value_or_gap(cell_value, row + 1, column), value_or_gap(cell_value, row - 1, column)
        return wp.vec2d(difference(west, here, east), difference(south, here, north))

    @wp.func(module=name)
    def difference_near_gap(
        cell_value: wp.array2d[wp.float64], position: vec2, column: int, row: int, u: wp.float64, v: wp.float64
    ) -> wp.vec2d:
        """Weighted mean of the changes at those of the four centres that have data."""
        if wp.isnan(own_value(cell_value, position)):
            return wp.vec2d(NAN_64, NAN_64)
        total = wp.vec2d()
        weights = wp.float64(0.0)
        for corner in range(4):
            j = wp.clamp(column + corner % 2, 0, cell_value.shape[1] - 1)
            i = wp.clamp(row + corner // 2, 0, cell_value.shape[0] - 1)
            weight = corner_weight(corner, u, v)
            if not wp.isnan(cell_value[i, j]):
                total += weight * cell_difference(cell_value, i, j)
                weights += weight
        return total / weights

    @wp.func(module=name)
    def difference_inside(
        cell_value: wp.array2d[wp.float64], column: int, row: int, u: wp.float64, v: wp.float64
    ) -> wp.vec2d:
        """Bilinear mean of the central differences at four centres that lie two cells or more from the edge.

        The twelve values around are read once. Along x the mean of the four differences is that of two second sums.
        """
        s, t = ONE_64 - u, ONE_64 - v
        above, upper, lower, below = cell_value[row - 1], cell_value[row], cell_value[row + 1], cell_value[row + 2]
        n0, n1 = above[column], above[column + 1]
        a0, a1, a2, a3 = upper[column - 1], upper[column], upper[column + 1], upper[column + 2]
        b0, b1, b2, b3 = lower[column - 1], lower[column], lower[column + 1], lower[column + 2]
        s0, s1 = below[column], below[column + 1]
        east = t * (s * (a2 - a0) + u * (a3 - a1)) + v * (s * (b2 - b0) + u * (b3 - b1))
        north = t * (s * (n0 - b1) + u * (n1 - b2)) + v * (s * (a1 - s0) + u * (a2 - s1))
        return wp.vec2d(HALF_64 * east, HALF_64 * north)

    @wp.func(module=name)
    def gradient_at(cell_value: wp.array2d[wp.float64], grid: RasterGrid, xy: vec2) -> vec2:
        """Gradient (d/dx east, d/dy north) at a point; NaN off the raster and in cells without data.

        Central differences at the centres, one-sided beside gaps and edges, bilinear in between: continuous, and exact
        on a plane out to the edge.
        """
        change = wp.vec2d(NAN_64, NAN_64)
        position = cell_position(grid, xy)
        if is_inside(cell_value, position):
            column, row = int(position[0] + ONE) - 1, int(position[1] + ONE) - 1
            u, v = wp.float64(position[0] - scalar(column)), wp.float64(position[1] - scalar(row))
            if column > 0 and row > 0 and column + 2 < cell_value.shape[1] and row + 2 < cell_value.shape[0]:
                change = difference_inside(cell_value, column, row, u, v)
            if wp.isnan(change[0] + change[1]):
                change = difference_near_gap(cell_value, position, column, row, u, v)
        return vec2(scalar(change[0]), scalar(change[1])) * grid.cells_per_meter

    @wp.func(module=name)
    def center_of_cell(grid: RasterGrid, row: int, column: int) -> vec2:
        """Point at the centre of a cell."""
        x = grid.west + (scalar(column) + HALF) * grid.cell_size
        y = grid.north - (scalar(row) + HALF) * grid.cell_size
        return vec2(x, y)

    @wp.kernel(module=name, enable_backward=False)
    def sample_values(
        # terrain
        cell_value: wp.array2d[wp.float64],
        grid: RasterGrid,
        # in
        point_xy: wp.array[vec2],
        # out
        point_value_out: wp.array[wp.float64],
    ):
        """Value at points, bilinear."""
        i = wp.tid()
        point_value_out[i] = value_at(cell_value, grid, point_xy[i])

    @wp.kernel(module=name, enable_backward=False)
    def find_cells(
        # terrain
        rows: int,
        columns: int,
        grid: RasterGrid,
        # in
        point_xy: wp.array[vec2],
        # out
        point_cell_out: wp.array[int],
        point_inside_out: wp.array[wp.uint8],
    ):
        """Index row * columns + column of the cell that each point lies in, and 1; two zeros off the raster."""
        i = wp.tid()
        position = cell_position(grid, point_xy[i])
        point_cell_out[i] = 0
        point_inside_out[i] = wp.uint8(0)
        if is_within(rows, columns, position):
            cell = own_cell(rows, columns, position)
            point_cell_out[i] = cell[0] * columns + cell[1]
            point_inside_out[i] = wp.uint8(1)

    return SimpleNamespace(
        sample_values=sample_values,
        find_cells=find_cells,
        vec2=vec2,
        RasterGrid=RasterGrid,
        cell_position=cell_position,
        is_within=is_within,
        is_inside=is_inside,
        own_cell=own_cell,
        value_at=value_at,
        cell_difference=cell_difference,
        difference_inside=difference_inside,
        gradient_at=gradient_at,
        center_of_cell=center_of_cell,
    )
