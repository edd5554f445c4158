"""Smooth steps from 0 to 1 that the kernels of several processes share."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.steps_{scalar.__name__}"
    ZERO, ONE, TWO, THREE, SIX, TEN, FIFTEEN = (scalar(v) for v in (0.0, 1.0, 2.0, 3.0, 6.0, 10.0, 15.0))

    @wp.func(module=name)
    def cubic_step(fraction: scalar) -> scalar:
        """0 below 0, 1 above 1, between them 3 t^2 - 2 t^3: once continuously differentiable."""
        t = wp.clamp(fraction, ZERO, ONE)
        return t * t * (THREE - TWO * t)

    @wp.func(module=name)
    def quintic_step(fraction: scalar) -> scalar:
        """0 below 0, 1 above 1, between them 6 t^5 - 15 t^4 + 10 t^3: twice continuously differentiable."""
        t = wp.clamp(fraction, ZERO, ONE)
        return t * t * t * (t * (t * SIX - FIFTEEN) + TEN)

    return SimpleNamespace(cubic_step=cubic_step, quintic_step=quintic_step)
