"""Seeded noise that the kernels of several processes share; every value depends on the seed and the place alone."""

import math
from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})


@once
def build(scalar):
    """Make the noise functions for one precision.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.noise_{scalar.__name__}"
    vec2, vec3 = wp.types.vector(2, scalar), wp.types.vector(3, scalar)
    ONE, TWO, SIX, TEN, FIFTEEN, THIRTY = (scalar(v) for v in (1.0, 2.0, 6.0, 10.0, 15.0, 30.0))
    TURN = scalar(2.0 * math.pi / 2.0**32)
    # Of unit gradients the noise reaches 1/sqrt(2) at most: this makes it 1.
    REACH = scalar(math.sqrt(2.0))

    @wp.func(module=name)
    def lattice_hash(seed: int, i: int, j: int) -> wp.uint32:
        """Random bits of a lattice point, by the counter-based PCG generator of Warp."""
        return wp.rand_init(seed, int(wp.rand_init(i, j)))

    @wp.func(module=name)
    def lattice_gradient(seed: int, i: int, j: int) -> vec2:
        """Unit vector in a random direction, one for each lattice point."""
        angle = TURN * scalar(lattice_hash(seed, i, j))
        return vec2(wp.cos(angle), wp.sin(angle))

    @wp.func(module=name)
    def gradient_noise(seed: int, xy: vec2) -> vec3:
        """Smooth noise of wavelength about 1 in [-1, 1], 0 at the lattice points, with its derivatives [Perlin2002].

        Returns (value, d/dx, d/dy); twice continuously differentiable.
        """
        i, j = int(wp.floor(xy[0])), int(wp.floor(xy[1]))
        x, y = xy[0] - scalar(i), xy[1] - scalar(j)
        ga, gb = lattice_gradient(seed, i, j), lattice_gradient(seed, i + 1, j)
        gc, gd = lattice_gradient(seed, i, j + 1), lattice_gradient(seed, i + 1, j + 1)
        a, b = ga[0] * x + ga[1] * y, gb[0] * (x - ONE) + gb[1] * y
        c, d = gc[0] * x + gc[1] * (y - ONE), gd[0] * (x - ONE) + gd[1] * (y - ONE)
        u, v = x * x * x * (x * (x * SIX - FIFTEEN) + TEN), y * y * y * (y * (y * SIX - FIFTEEN) + TEN)
        du, dv = THIRTY * x * x * (x * (x - TWO) + ONE), THIRTY * y * y * (y * (y - TWO) + ONE)
        mixed = a - b - c + d
        value = a + u * (b - a) + v * (c - a) + u * v * mixed
        slope = ga + u * (gb - ga) + v * (gc - ga) + (u * v) * (ga - gb - gc + gd)
        slope += vec2(du * (b - a + v * mixed), dv * (c - a + u * mixed))
        return REACH * vec3(value, slope[0], slope[1])

    @wp.func(module=name)
    def periodic_noise(seed: int, xy: vec2, period: int) -> scalar:
        """Value of ``gradient_noise`` that repeats itself after ``period``, a power of 2 [Perlin2002]."""
        i, j = int(wp.floor(xy[0])), int(wp.floor(xy[1]))
        x, y = xy[0] - scalar(i), xy[1] - scalar(j)
        mask = period - 1
        west, east, south, north = i & mask, (i + 1) & mask, j & mask, (j + 1) & mask
        ga, gb = lattice_gradient(seed, west, south), lattice_gradient(seed, east, south)
        gc, gd = lattice_gradient(seed, west, north), lattice_gradient(seed, east, north)
        a, b = ga[0] * x + ga[1] * y, gb[0] * (x - ONE) + gb[1] * y
        c, d = gc[0] * x + gc[1] * (y - ONE), gd[0] * (x - ONE) + gd[1] * (y - ONE)
        u, v = x * x * x * (x * (x * SIX - FIFTEEN) + TEN), y * y * y * (y * (y * SIX - FIFTEEN) + TEN)
        return REACH * (a + u * (b - a) + v * (c - a) + u * v * (a - b - c + d))

    return SimpleNamespace(
        vec2=vec2, vec3=vec3, lattice_hash=lattice_hash, gradient_noise=gradient_noise, periodic_noise=periodic_noise
    )
