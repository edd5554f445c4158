"""Float64 NumPy twins of what enters at inlets and of the strength of banks."""

import numpy as np

from warpriver.kernels.banks import CELLS, REACH, SIZE
from warpriver.kernels.inlets import LONGEST, SHORTEST, WAVES


def pcg(state):
    """Next state of Warp's generator, which is its number as well: 32 bits."""
    word = (state * 747796405 + 2891336453) & 0xFFFFFFFF
    word = ((word >> ((word >> 28) + 4)) ^ word) * 277803737 & 0xFFFFFFFF
    return (word >> 22) ^ word


def stream(seed, offset):
    """State that a seed and an offset begin with."""
    return pcg((seed + pcg(offset)) & 0xFFFFFFFF)


def slow_noise(seed, identity, turns):
    """Sum of sine waves: the k-th has a frequency from the k-th of even shares of the range, in its logarithm."""
    total = np.zeros(np.shape(turns))
    for k in range(WAVES):
        share = pcg(stream(stream(seed, identity), k))
        phase = pcg(share)
        frequency = (LONGEST / SHORTEST) ** ((k + (share >> 8) / 2.0**24) / WAVES) / LONGEST
        total += np.sin(2.0 * np.pi * (frequency * np.asarray(turns) + (phase >> 8) / 2.0**24))
    return np.sqrt(2.0 / WAVES) * total


def table_value(table, place):
    """Bilinear value at places in cells of a table that comes again, (n,)."""
    low = np.floor(place).astype(np.int64)
    u, v = (place - low).T
    (i, j), (right, below) = low.T % SIZE, (low.T + 1) % SIZE
    return (
        (1.0 - u) * (1.0 - v) * table[j, i]
        + u * (1.0 - v) * table[j, right]
        + (1.0 - u) * v * table[below, i]
        + u * v * table[below, right]
    )


def bank_factor(table, xy, width, correlation, spread):
    """e^(s N - s^2 / 2) at absolute positions: N mixes the fields of both powers of two that a width lies between."""
    octave = np.log2(width)
    level = int(np.floor(octave))
    part = octave - level
    cell = correlation * 2.0**level / CELLS
    noise = 0.0
    for k, weight in ((level, 1.0 - part), (level + 1, part)):
        shift = np.array([173.0 * k, 0.0])
        noise = noise + weight * table_value(table.astype(np.float64), xy / (cell * 2.0 ** (k - level)) + shift)
    noise = np.clip(noise / np.hypot(part, 1.0 - part), -REACH, REACH)
    return np.exp(spread * noise - 0.5 * spread**2)
