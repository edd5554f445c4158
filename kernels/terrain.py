"""Terrain: gradients at points, slope of cells, brushes, ridges, and another cell size."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels import raster
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the terrain kernels for one precision of the positions; heights are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.terrain_{scalar.__name__}"
    cells = raster.build(scalar)
    vec2, RasterGrid = cells.vec2, cells.RasterGrid
    ZERO, ONE, TWO, THREE = scalar(0.0), scalar(1.0), scalar(2.0), scalar(3.0)
    ZERO_64, HALF_64, ONE_64, TWO_64, NAN_64 = (wp.float64(v) for v in (0.0, 0.5, 1.0, 2.0, math.nan))

    @wp.struct
    class Brush:
        """A round brush; lengths in m. ``amount`` is a height in m, or a share from 0 to 1."""

        center: vec2
        radius: scalar
        amount: scalar
        level: wp.float64

    @wp.func(module=name)
    def falloff(part: scalar) -> scalar:
        """Weight 1 at the part 0 of a radius, 0 from 1 on, flat at both: 1 - 3 p^2 + 2 p^3."""
        p = wp.clamp(part, ZERO, ONE)
        return ONE - p * p * (THREE - TWO * p)

    @wp.func(module=name)
    def brush_weight(grid: RasterGrid, brush: Brush, row: int, column: int) -> scalar:
        """Amount of a brush at the centre of a cell."""
        offset = cells.center_of_cell(grid, row, column) - brush.center
        return brush.amount * falloff(wp.length(offset) / brush.radius)

    @wp.kernel(module=name, enable_backward=False)
    def sample_gradients(
        # terrain
        cell_height: wp.array2d[wp.float64],
        grid: RasterGrid,
        # in
        point_xy: wp.array[vec2],
        # out
        point_gradient_out: wp.array[vec2],
    ):
        """Gradient at points, (d/dx east, d/dy north)."""
        i = wp.tid()
        point_gradient_out[i] = cells.gradient_at(cell_height, grid, point_xy[i])

    @wp.kernel(module=name, enable_backward=False)
    def compute_slope(
        # terrain
        cell_height: wp.array2d[wp.float64],
        cells_per_meter: wp.float64,
        # out
        cell_slope_out: wp.array2d[wp.float64],
    ):
        """Slope of each cell, the length of its gradient; NaN without data."""
        row, column = wp.tid()
        cell_slope_out[row, column] = wp.length(cells.cell_difference(cell_height, row, column)) * cells_per_meter

    @wp.kernel(module=name, enable_backward=False)
    def raise_cells(
        # terrain
        grid: RasterGrid,
        # params
        brush: Brush,
        window: wp.vec4i,
        # out
        cell_height_io: wp.array2d[wp.float64],
    ):
        """Add the brush's amount to the cells of a window = (first row, first column, rows, columns)."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        weight = brush_weight(grid, brush, row, column)
        if weight != ZERO:
            cell_height_io[row, column] = cell_height_io[row, column] + wp.float64(weight)

    @wp.kernel(module=name, enable_backward=False)
    def flatten_cells(
        # terrain
        grid: RasterGrid,
        # params
        brush: Brush,
        window: wp.vec4i,
        # out
        cell_height_io: wp.array2d[wp.float64],
    ):
        """Draw the cells of a window towards the brush's level."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        weight = wp.float64(brush_weight(grid, brush, row, column))
        if weight > ZERO_64:
            cell_height_io[row, column] += weight * (brush.level - cell_height_io[row, column])

    @wp.func(module=name)
    def pair_excess(before: wp.float64, here: wp.float64, after: wp.float64) -> wp.float64:
        """Sum of two opposite neighbours less twice the middle; 0 if one is missing, so that planes stay planes."""
        excess = before + after - TWO_64 * here
        if wp.isnan(excess):
            return ZERO_64
        return excess

    @wp.kernel(module=name, enable_backward=False)
    def blur_rows(
        # terrain
        cell_height: wp.array2d[wp.float64],
        # params
        window: wp.vec4i,
        weight: wp.array[wp.float64],
        # out
        blurred_out: wp.array2d[wp.float64],
    ):
        """Blur along the rows of a window: h + sum over k of w_k (h_(-k) + h_k - 2 h)."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        here = cell_height[row, column]
        total = here
        reach = wp.min(weight.shape[0] - 1, wp.min(column, cell_height.shape[1] - 1 - column))
        for k in range(1, reach + 1):
            total += weight[k] * pair_excess(cell_height[row, column - k], here, cell_height[row, column + k])
        blurred_out[i, j] = total

    @wp.kernel(module=name, enable_backward=False)
    def blend_columns(
        # terrain
        grid: RasterGrid,
        # params
        brush: Brush,
        window: wp.vec4i,
        first_row: int,
        weight: wp.array[wp.float64],
        # in
        blurred: wp.array2d[wp.float64],
        # out
        cell_height_io: wp.array2d[wp.float64],
    ):
        """Blur along the columns of what ``blur_rows`` made from ``first_row`` on, and blend it in by the brush."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        share = wp.float64(brush_weight(grid, brush, row, column))
        if share > ZERO_64:
            middle = row - first_row
            here = blurred[middle, j]
            total = here
            reach = wp.min(weight.shape[0] - 1, wp.min(middle, blurred.shape[0] - 1 - middle))
            for k in range(1, reach + 1):
                total += weight[k] * pair_excess(blurred[middle - k, j], here, blurred[middle + k, j])
            cell_height_io[row, column] += share * (total - cell_height_io[row, column])

    @wp.kernel(module=name, enable_backward=False)
    def raise_ridge(
        # terrain
        grid: RasterGrid,
        # params
        half_width: scalar,
        window: wp.vec4i,
        # in
        crest_xy: wp.array[vec2],
        crest_height: wp.array[scalar],
        # out
        cell_height_io: wp.array2d[wp.float64],
    ):
        """Add a ridge: its height at the nearest point of a polyline, falling off with the distance to it."""
        i, j = wp.tid()
        row, column = window[0] + i, window[1] + j
        here = cells.center_of_cell(grid, row, column)
        nearest = half_width
        height = scalar(0.0)
        for k in range(crest_xy.shape[0] - 1):
            along = crest_xy[k + 1] - crest_xy[k]
            offset = here - crest_xy[k]
            part = wp.clamp(wp.dot(offset, along) / wp.dot(along, along), ZERO, ONE)
            distance = wp.length(offset - part * along)
            if distance < nearest:
                nearest = distance
                height = crest_height[k] + part * (crest_height[k + 1] - crest_height[k])
        if nearest < half_width:
            cell_height_io[row, column] = cell_height_io[row, column] + wp.float64(
                height * falloff(nearest / half_width)
            )

    @wp.func(module=name)
    def hat_sum(t: wp.float64) -> wp.float64:
        """Integral up to t of the hat function 1 - |t| on (-1, 1)."""
        c = wp.clamp(t, -ONE_64, ONE_64)
        if c < ZERO_64:
            return HALF_64 * (ONE_64 + c) * (ONE_64 + c)
        return ONE_64 - HALF_64 * (ONE_64 - c) * (ONE_64 - c)

    @wp.func(module=name)
    def axis_weight(way: int, cell: int, low: wp.float64, high: wp.float64) -> wp.float64:
        """Weight of an old cell for a new one that reaches from ``low`` to ``high``, counted in old centres.

        way 0, finer: linear at the middle; 1, whole multiples: the overlap; 2, coarser: the mean of the linear surface.
        """
        k = wp.float64(cell)
        if way == 0:
            return wp.max(ZERO_64, ONE_64 - wp.abs(HALF_64 * (low + high) - k))
        if way == 1:
            return wp.max(ZERO_64, wp.min(high, k + HALF_64) - wp.max(low, k - HALF_64))
        return hat_sum(high - k) - hat_sum(low - k)

    @wp.kernel(module=name, enable_backward=False)
    def resample_cells(
        # params
        step: wp.vec2d,
        way: wp.vec2i,
        # in
        cell_height: wp.array2d[wp.float64],
        # out
        cell_height_out: wp.array2d[wp.float64],
    ):
        """Heights on cells of ``step`` = (columns, rows) of the old; ``way`` as in ``axis_weight``, for each axis.

        A finer cell needs data in the old cell that its centre lies in, a coarser one on half of its part of the
        raster. Beyond the outer centres the edge's heights go on.
        """
        i, j = wp.tid()
        rows, columns = cell_height.shape[0], cell_height.shape[1]
        south = wp.min(wp.float64(i + 1) * step[1], wp.float64(rows)) - HALF_64
        east = wp.min(wp.float64(j + 1) * step[0], wp.float64(columns)) - HALF_64
        north, west = wp.float64(i) * step[1] - HALF_64, wp.float64(j) * step[0] - HALF_64
        total = wp.float64(0.0)
        weights = wp.float64(0.0)
        missing = wp.float64(0.0)
        for k in range(int(wp.floor(north)), int(wp.ceil(south)) + 1):
            row = wp.clamp(k, 0, rows - 1)
            wy = axis_weight(way[1], k, north, south)
            for m in range(int(wp.floor(west)), int(wp.ceil(east)) + 1):
                height = cell_height[row, wp.clamp(m, 0, columns - 1)]
                weight = wy * axis_weight(way[0], m, west, east)
                if wp.isnan(height):
                    missing += weight
                else:
                    total += weight * height
                    weights += weight
        known = weights > ZERO_64 and weights >= missing
        if way[0] == 0 and way[1] == 0:
            row = wp.min(int(HALF_64 * (north + south) + HALF_64), rows - 1)
            column = wp.min(int(HALF_64 * (west + east) + HALF_64), columns - 1)
            known = not wp.isnan(cell_height[row, column])
        cell_height_out[i, j] = NAN_64
        if known:
            cell_height_out[i, j] = total / weights

    return SimpleNamespace(
        vec2=vec2,
        RasterGrid=RasterGrid,
        Brush=Brush,
        sample_gradients=sample_gradients,
        compute_slope=compute_slope,
        raise_cells=raise_cells,
        flatten_cells=flatten_cells,
        blur_rows=blur_rows,
        blend_columns=blend_columns,
        raise_ridge=raise_ridge,
        resample_cells=resample_cells,
    )
