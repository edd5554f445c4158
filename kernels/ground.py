"""What lies under a point and steers it: heights of the ground, and the controls stamped on it, read in one way."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import banks, raster
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# How the gradient of the control field turns a migration rate mu along the normal n into a velocity.
NORMAL, VECTOR, PRINTED = range(3)
# Side of a block of cells of controls, in cells.
BLOCK = 16


@once
def build(scalar):
    """Make the structs and functions for one precision of the positions; the rasters hold float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.ground_{scalar.__name__}"
    cells, bank = raster.build(scalar), banks.build(scalar)
    Banks = bank.Banks
    vec2, RasterGrid = cells.vec2, cells.RasterGrid
    ZERO, ONE, TWO, THREE = (scalar(v) for v in (0.0, 1.0, 2.0, 3.0))

    @wp.struct
    class Steering:
        """The control field c (m) and the factor of the rate on the cells of one raster, and how they are read.

        ``floor``: fraction of the rate k that a straight reach is steered with. ``mode``: NORMAL, VECTOR or PRINTED. An
        array is missing where nothing pulls, or scales the rate. ``block_mobility`` has, for blocks of cells, the
        greatest factor by which controls let a point move; it is 1 in those that no control reaches, and only there,
        and has a minus sign where the factor of the rate is not 1 everywhere.
        ``highest`` is 1, or the greatest of them so far.
        """

        cell_control: wp.array2d[wp.float64]
        cell_factor: wp.array2d[wp.float64]
        block_mobility: wp.array2d[wp.float32]
        highest: wp.array[wp.float32]
        grid: RasterGrid
        floor: scalar
        mode: int

    @wp.struct
    class Ground:
        """Heights of the ground, m, and where they lie; without heights the ground is a plain."""

        height: wp.array2d[wp.float64]
        grid: RasterGrid
        steering: Steering
        banks: Banks

    @wp.func(module=name)
    def is_plain(ground: Ground) -> bool:
        """Tell whether nothing on the ground holds a channel or draws it: no heights, controls, or uneven banks."""
        if ground.height or ground.steering.block_mobility:
            return False
        if ground.banks.cell_noise:
            return False
        return True

    @wp.func(module=name)
    def slope_weight(ground: Ground, xy: vec2, limit: scalar) -> scalar:
        """1 on flat ground, falling as a smoothstep to 0 at the slope ``limit``; 0 where there is no ground."""
        slope = wp.length(cells.gradient_at(ground.height, ground.grid, xy))
        if not (slope < limit):
            return ZERO
        t = slope / limit
        return ONE - t * t * (THREE - TWO * t)

    @wp.func(module=name)
    def rate_factor(steering: Steering, xy: vec2) -> scalar:
        """Factor of the rate at a point, bilinear between the centres, all of which have one; 1 off the raster."""
        factor = scalar(1.0)
        cell_factor = steering.cell_factor
        position = cells.cell_position(steering.grid, xy)
        column, row = int(position[0]), int(position[1])
        if position[0] >= ZERO and position[1] >= ZERO:
            if column + 1 < cell_factor.shape[1] and row + 1 < cell_factor.shape[0]:
                u, v = wp.float64(position[0] - scalar(column)), wp.float64(position[1] - scalar(row))
                upper, lower = cell_factor[row], cell_factor[row + 1]
                above = upper[column] + u * (upper[column + 1] - upper[column])
                below = lower[column] + u * (lower[column + 1] - lower[column])
                factor = scalar(above + v * (below - above))
        return factor

    @wp.func(module=name)
    def control_gradient(steering: Steering, xy: vec2) -> vec2:
        """Gradient of the control field at a point, as ``gradient_at``; 0 off its raster and along its empty rim."""
        slope = vec2(ZERO, ZERO)
        cell_control = steering.cell_control
        position = cells.cell_position(steering.grid, xy)
        column, row = int(position[0]), int(position[1])
        if column > 0 and row > 0 and column + 2 < cell_control.shape[1] and row + 2 < cell_control.shape[0]:
            u, v = wp.float64(position[0] - scalar(column)), wp.float64(position[1] - scalar(row))
            change = cells.difference_inside(cell_control, column, row, u, v)
            slope = vec2(scalar(change[0]), scalar(change[1])) * steering.grid.cells_per_meter
        return slope

    @wp.func(module=name)
    def block_at(steering: Steering, xy: vec2) -> scalar:
        """What ``block_mobility`` has for the block of cells around a point; 1 off the raster."""
        mobility = scalar(1.0)
        if steering.block_mobility:
            position = cells.cell_position(steering.grid, xy)
            rows, columns = BLOCK * steering.block_mobility.shape[0], BLOCK * steering.block_mobility.shape[1]
            if position[0] >= ZERO and position[1] >= ZERO:
                if position[0] < scalar(columns) and position[1] < scalar(rows):
                    mobility = scalar(steering.block_mobility[int(position[1]) // BLOCK, int(position[0]) // BLOCK])
        return mobility

    @wp.func(module=name)
    def raised_mobility(ground: Ground, xy: vec2, limit: scalar, highest: scalar) -> scalar:
        """The greater of a mobility and that of a point: how much of its rate ground and controls let it have."""
        mobility = wp.abs(block_at(ground.steering, xy))
        if mobility > highest and ground.height:
            mobility = mobility * slope_weight(ground, xy, limit)
        return wp.max(highest, mobility)

    @wp.func(module=name)
    def freedom_at(ground: Ground, xy: vec2, limit: scalar, block: scalar) -> scalar:
        """Fraction of its rate with which a point moves: g, by the slope of the ground, times the factor of controls.

        ``block`` is what ``block_at`` says of the point.
        """
        weight = scalar(1.0)
        if ground.height:
            weight = slope_weight(ground, xy, limit)
        if block < ZERO:
            weight = weight * rate_factor(ground.steering, xy)
        return weight

    @wp.func(module=name)
    def control_pull(steering: Steering, xy: vec2, normal: vec2, rate: scalar, floor: scalar) -> vec2:
        """Velocity that the control field adds to mu n, m/yr: (|mu| + floor) (n . grad c) n; 0 without a field.

        So bends to both sides and straight reaches are drawn the same way. As a whole vector it is (|mu| + floor)
        grad c; as printed mu grad c [Paris2023, Eq. 7], in which the sign of the rate turns attraction into repulsion
        on every other bend. ``floor`` is the rate that a straight reach has.
        """
        pull = vec2(ZERO, ZERO)
        if steering.cell_control:
            pull = control_gradient(steering, xy)
            if steering.mode == PRINTED:
                pull = rate * pull
            else:
                if steering.mode == NORMAL:
                    pull = wp.dot(normal, pull) * normal
                pull = (wp.abs(rate) + floor) * pull
        return pull

    return SimpleNamespace(
        vec2=vec2,
        RasterGrid=RasterGrid,
        Steering=Steering,
        Banks=Banks,
        BankScale=bank.BankScale,
        bank_scale=bank.bank_scale,
        bank_factor=bank.bank_factor,
        Ground=Ground,
        control_gradient=control_gradient,
        rate_factor=rate_factor,
        raised_mobility=raised_mobility,
        block_at=block_at,
        freedom_at=freedom_at,
        is_plain=is_plain,
        control_pull=control_pull,
    )
