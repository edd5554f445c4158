"""Forms of a channel's cross section: depth below top of bank in bankfull depths, from the left bank to the right."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# Forms of cross sections; a rectangle and a triangle are trapezoids.
ASYMMETRIC, TRAPEZOID, SEMICIRCLE, POLYNOMIAL, WEIBULL = range(5)


@once
def build(scalar):
    """Make the functions of cross sections for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.sections_{scalar.__name__}"
    vec4 = wp.types.vector(4, scalar)
    ZERO, HALF, ONE, TWO, FOUR = (scalar(v) for v in (0.0, 0.5, 1.0, 2.0, 4.0))
    LOG_HALF, TINY = scalar(math.log(0.5)), scalar(1.0e-12)
    # Sides of the threads' section are brought down to the banks by 1 - (2 Y - 1)^EDGE.
    EDGE = scalar(32.0)

    @wp.func(module=name)
    def asymmetric_depth(y: scalar, apex: scalar) -> scalar:
        """4 Y^k (1 - Y^k) with a^k = 1/2, seen from the nearer bank [Deutsch1996; Brown2014, eqs 22 and 23]."""
        side = y
        a = apex
        if apex > HALF:
            side = ONE - y
            a = ONE - apex
        power = wp.pow(wp.max(side, ZERO), LOG_HALF / wp.log(wp.max(a, TINY)))
        return FOUR * power * (ONE - power)

    @wp.func(module=name)
    def thread_depth(y: scalar, section_thread: wp.array[vec4]) -> scalar:
        """The deepest of Weibull densities, each scaled to its own depth [Jacobson2006]."""
        deepest = scalar(0.0)
        for k in range(section_thread.shape[0]):
            thread = section_thread[k]
            t = (y - thread[0]) / thread[1]
            shape = thread[2]
            if t > ZERO or (t == ZERO and shape == ONE):
                mode = (shape - ONE) / shape
                peak = wp.exp(-mode)
                value = wp.exp(-wp.pow(t, shape))
                if shape > ONE:
                    peak = peak * wp.pow(mode, mode)
                    value = value * wp.pow(t, shape - ONE)
                deepest = wp.max(deepest, thread[3] * value / peak)
        return deepest * (ONE - wp.pow(wp.abs(TWO * y - ONE), EDGE))

    @wp.func(module=name)
    def depth_at(
        form: int, y: scalar, apex: scalar, flat: scalar, exponent: scalar, section_thread: wp.array[vec4]
    ) -> scalar:
        """Depth below top of bank in bankfull depths, at Y = 0 at the left bank to 1 at the right one."""
        if form == ASYMMETRIC:
            return asymmetric_depth(y, apex)
        if form == TRAPEZOID:
            side = apex * (ONE - flat)
            far = (ONE - apex) * (ONE - flat)
            return wp.min(ONE, wp.min(y / wp.max(side, TINY), (ONE - y) / wp.max(far, TINY)))
        if form == SEMICIRCLE:
            off = TWO * y - ONE
            return wp.sqrt(wp.max(ONE - off * off, ZERO))
        if form == POLYNOMIAL:
            side = apex
            if y > apex:
                side = ONE - apex
            return ONE - wp.pow(wp.abs(y - apex) / side, exponent)
        return thread_depth(y, section_thread)

    return SimpleNamespace(depth_at=depth_at)
