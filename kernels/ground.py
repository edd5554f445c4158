"""What lies under a point and steers it: heights of the ground, and the controls stamped on it, read in one way."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels import raster
from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# How the gradient of the control field turns a migration rate mu along the normal n into a velocity.
NORMAL, VECTOR, PRINTED = range(3)


@once
def build(scalar):
    """Make the structs and functions for one precision of the positions; the rasters hold float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.ground_{scalar.__name__}"
    cells = raster.build(scalar)
    vec2, RasterGrid = cells.vec2, cells.RasterGrid
    ZERO, ONE, TWO, THREE = (scalar(v) for v in (0.0, 1.0, 2.0, 3.0))

    @wp.struct
    class Steering:
        """The control field c (m) and the factor of the rate on the cells of one raster, and how they are read.

        ``floor``: part of the rate k that a straight reach is steered with. ``mode``: NORMAL, VECTOR or PRINTED. Both
        arrays are missing where nothing is controlled.
        """

        cell_control: wp.array2d[wp.float64]
        cell_factor: wp.array2d[wp.float64]
        grid: RasterGrid
        floor: scalar
        mode: int

    @wp.struct
    class Ground:
        """Heights of the ground, m, and where they lie; without heights the ground is a plain."""

        height: wp.array2d[wp.float64]
        grid: RasterGrid
        steering: Steering

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
        """Factor of the rate at a point; 1 off its raster."""
        value = cells.value_at(steering.cell_factor, steering.grid, xy)
        if wp.isnan(value):
            return ONE
        return scalar(value)

    @wp.func(module=name)
    def control_gradient(steering: Steering, xy: vec2) -> vec2:
        """Gradient of the control field at a point; 0 off its raster."""
        slope = cells.gradient_at(steering.cell_control, steering.grid, xy)
        if wp.isnan(slope[0] + slope[1]):
            return vec2(ZERO, ZERO)
        return slope

    @wp.func(module=name)
    def freedom_at(ground: Ground, xy: vec2, limit: scalar) -> scalar:
        """Part of its rate with which a point moves: g, by the slope of the ground, times the factor of controls."""
        weight = ONE
        if ground.height:
            weight = slope_weight(ground, xy, limit)
        if ground.steering.cell_factor:
            weight = weight * rate_factor(ground.steering, xy)
        return weight

    @wp.func(module=name)
    def mobility_at(ground: Ground, xy: vec2, limit: scalar) -> scalar:
        """Part of its rate with which a point may move at most, whichever way it is pulled."""
        weight = freedom_at(ground, xy, limit)
        if ground.steering.cell_control:
            if weight > ZERO:
                weight = weight * (ONE + wp.length(control_gradient(ground.steering, xy)))
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
        Ground=Ground,
        slope_weight=slope_weight,
        freedom_at=freedom_at,
        mobility_at=mobility_at,
        control_pull=control_pull,
    )
