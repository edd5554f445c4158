"""Controls: scalar fields and factors of the rate, stamped into rasters; ``ground.py`` reads them."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import polygons, raster
from warpriver.kernels.ground import BLOCK
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the kernels of controls for one precision of the positions; the rasters hold float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.controls_{scalar.__name__}"
    cells, shapes = raster.build(scalar), polygons.build(scalar)
    vec2, RasterGrid = cells.vec2, cells.RasterGrid
    ZERO = scalar(0.0)
    ZERO_64, ONE_64, TWO_64, THREE_64 = (wp.float64(v) for v in (0.0, 1.0, 2.0, 3.0))
    # Of (1 - p^2)^3 the steepest place, at p = 1 / sqrt 5, has this slope.
    STEEPEST = wp.float64(96.0 / (25.0 * math.sqrt(5.0)))
    # Of a block without controls, and more than the rounding of one with them.
    NONE, ROUNDED_UP = wp.float32(1.0), wp.float64(1.0 + 2.0**-22)
    # Stands for 0, which has no sign to tell of.
    SMALLEST = wp.float32(2.0**-120)

    @wp.struct
    class Bump:
        """A radial field around a point or a line: c = (strength radius / 1.717) (1 - (distance / radius)^2)^3, m."""

        radius: scalar
        strength: wp.float64

    @wp.func(module=name)
    def bump_height(bump: Bump, distance: scalar) -> wp.float64:
        """Value of a bump at a distance from its middle, m."""
        p = wp.float64(distance) / wp.float64(bump.radius)
        if p >= ONE_64:
            return ZERO_64
        rest = ONE_64 - p * p
        return bump.strength * wp.float64(bump.radius) / STEEPEST * rest * rest * rest

    @wp.kernel(module=name, enable_backward=False)
    def add_bump(
        # terrain
        grid: RasterGrid,
        # params
        bump: Bump,
        window: wp.vec4i,
        # in
        line_xy: wp.array[vec2],
        # out
        cell_control_io: wp.array2d[wp.float64],
    ):
        """Add a bump around a line, or its single point, to a window = (first row, first column, rows, columns)."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        distance = shapes.distance_to_line(line_xy, cells.center_of_cell(grid, row, column))
        cell_control_io[row, column] = cell_control_io[row, column] + bump_height(bump, distance)

    @wp.kernel(module=name, enable_backward=False)
    def add_field(
        # terrain
        grid: RasterGrid,
        # params
        window: wp.vec4i,
        # in
        cell_value: wp.array2d[wp.float64],
        value_grid: RasterGrid,
        # out
        cell_control_io: wp.array2d[wp.float64],
    ):
        """Add a painted field, bilinear between its centres; off it and where it has no data it counts as 0."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        value = cells.value_at(cell_value, value_grid, cells.center_of_cell(grid, row, column))
        if not wp.isnan(value):
            cell_control_io[row, column] = cell_control_io[row, column] + value

    @wp.kernel(module=name, enable_backward=False)
    def scale_by_field(
        # terrain
        grid: RasterGrid,
        # params
        window: wp.vec4i,
        # in
        cell_value: wp.array2d[wp.float64],
        value_grid: RasterGrid,
        # out
        cell_factor_io: wp.array2d[wp.float64],
    ):
        """Multiply the factor by a field; off it and where it has no data it counts as 1."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        value = cells.value_at(cell_value, value_grid, cells.center_of_cell(grid, row, column))
        if not wp.isnan(value):
            cell_factor_io[row, column] = cell_factor_io[row, column] * value

    @wp.kernel(module=name, enable_backward=False)
    def scale_inside(
        # terrain
        grid: RasterGrid,
        # params
        factor: wp.float64,
        blend: scalar,
        window: wp.vec4i,
        # in
        corner_xy: wp.array[vec2],
        # out
        cell_factor_io: wp.array2d[wp.float64],
    ):
        """Multiply the factor in a polygon, fading to 1 over the distance ``blend`` inside its edge."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        inside = shapes.distance_inside(corner_xy, cells.center_of_cell(grid, row, column))
        if inside > ZERO:
            weight = wp.float64(1.0)
            if inside < blend:
                weight = wp.float64(inside / blend)
                weight = weight * weight * (THREE_64 - TWO_64 * weight)
            cell_factor_io[row, column] = cell_factor_io[row, column] * (ONE_64 + weight * (factor - ONE_64))

    @wp.kernel(module=name, enable_backward=False)
    def fill_window(
        # params
        window: wp.vec4i,
        value: wp.float64,
        # out
        cell_value_out: wp.array2d[wp.float64],
    ):
        """Set the cells of a window."""
        i, j = wp.tid()
        cell_value_out[window[0] + i, window[1] + j] = value

    @wp.kernel(module=name, enable_backward=False)
    def bound_blocks(
        # terrain
        grid: RasterGrid,
        # params
        window: wp.vec4i,
        # in
        cell_control: wp.array2d[wp.float64],
        cell_factor: wp.array2d[wp.float64],
        # out
        block_mobility_out: wp.array2d[wp.float32],
    ):
        """Greatest factor by which controls let a point move in each block of a window of blocks: f (1 + |grad c|).

        A block reaches from its first centres to those of the next one. In between centres both f and the gradient are
        means of those of the cells around, so that none is greater than at some centre. 1 stands for no control at all,
        a minus sign for factors that are not 1.
        """
        i, j = wp.tid()
        greatest = wp.float64(0.0)
        touched, scaled = bool(False), bool(False)
        first_row, first_column = (window[0] + i) * BLOCK, (window[1] + j) * BLOCK
        for row in range(first_row, wp.min(first_row + BLOCK + 1, cell_factor.shape[0])):
            for column in range(first_column, wp.min(first_column + BLOCK + 1, cell_factor.shape[1])):
                slope = wp.length(cells.cell_difference(cell_control, row, column)) * wp.float64(grid.cells_per_meter)
                factor = cell_factor[row, column]
                touched = touched or slope > ZERO_64
                scaled = scaled or factor != ONE_64
                greatest = wp.max(greatest, factor * (ONE_64 + slope))
        bound = NONE
        if scaled:
            bound = -wp.max(wp.float32(greatest * ROUNDED_UP), SMALLEST)
        elif touched:
            bound = wp.float32(greatest * ROUNDED_UP)
        block_mobility_out[window[0] + i, window[1] + j] = bound

    return SimpleNamespace(
        vec2=vec2,
        Bump=Bump,
        RasterGrid=RasterGrid,
        add_bump=add_bump,
        add_field=add_field,
        scale_by_field=scale_by_field,
        scale_inside=scale_inside,
        fill_window=fill_window,
        bound_blocks=bound_blocks,
    )
