"""Banks that differ in strength: a random field, by which the rate of a point is multiplied."""

from types import SimpleNamespace

import warp as wp

from warpriver.kernels.variants import once

wp.set_module_options({"enable_backward": False})

# The field reaches so many standard deviations, and no farther.
REACH = 2.5
# Cells of the field to a correlation length, and of its table a side, a power of two, after which it comes again.
CELLS, SIZE = 4, 512


@once
def build(scalar):
    """Make the structs and functions for one precision of the positions; places are float64 in both.

    Args:
        scalar: ``wp.float32`` or ``wp.float64``.
    """
    name = f"warpriver.kernels.banks_{scalar.__name__}"
    vec2 = wp.types.vector(2, scalar)
    HALF, ONE, TWO, FARTHEST = (wp.float64(v) for v in (0.5, 1.0, 2.0, REACH))
    # Levels have parts of the table of their own.
    APART = 173

    @wp.struct
    class Banks:
        """A normal random field on a table that comes again and again; without a table all banks are alike.

        ``correlation`` is the length in widths over which it falls to 1/e, ``spread`` the standard deviation of the
        logarithm of the factor, whose mean is 1. ``origin`` is the zero of the positions, m.
        """

        cell_noise: wp.array2d[wp.float32]
        origin: wp.vec2d
        correlation: wp.float64
        spread: wp.float64

    @wp.struct
    class BankScale:
        """How a channel reads the field, by its width: two levels, their cells in m, and the weight of each."""

        level: int
        cell: wp.float64
        lower: wp.float64
        upper: wp.float64

    @wp.func(module=name)
    def bank_scale(banks: Banks, width: scalar) -> BankScale:
        """Scale of a width, which lies between two powers of two: the field of each, and their mix of variance 1."""
        octave = wp.log2(wp.float64(width))
        level = wp.floor(octave)
        part = octave - level
        size = wp.sqrt(part * part + (ONE - part) * (ONE - part))
        cell = banks.correlation * wp.pow(TWO, level) / wp.float64(CELLS)
        return BankScale(int(level), cell, (ONE - part) / size, part / size)

    @wp.func(module=name)
    def table_value(banks: Banks, place: wp.vec2d, level: int) -> wp.float64:
        """Bilinear value of the table at a place in cells."""
        column, row = wp.floor(place[0]), wp.floor(place[1])
        u, v = place[0] - column, place[1] - row
        i = int(wp.int64(column) + wp.int64(level * APART)) & (SIZE - 1)
        j = int(wp.int64(row)) & (SIZE - 1)
        right, below = (i + 1) & (SIZE - 1), (j + 1) & (SIZE - 1)
        a, b = wp.float64(banks.cell_noise[j, i]), wp.float64(banks.cell_noise[j, right])
        c, d = wp.float64(banks.cell_noise[below, i]), wp.float64(banks.cell_noise[below, right])
        return a + u * (b - a) + v * (c + u * (d - c) - a - u * (b - a))

    @wp.func(module=name)
    def bank_factor(banks: Banks, scale: BankScale, xy: vec2) -> scalar:
        """Factor of the rate at a point, e^(s N - s^2 / 2), N a normal random field of the place [Guneralp2011]."""
        place = (wp.vec2d(wp.float64(xy[0]), wp.float64(xy[1])) + banks.origin) / scale.cell
        noise = scale.lower * table_value(banks, place, scale.level)
        noise += scale.upper * table_value(banks, HALF * place, scale.level + 1)
        noise = wp.clamp(noise, -FARTHEST, FARTHEST)
        return scalar(wp.exp(banks.spread * (noise - HALF * banks.spread)))

    return SimpleNamespace(Banks=Banks, BankScale=BankScale, bank_scale=bank_scale, bank_factor=bank_factor)
