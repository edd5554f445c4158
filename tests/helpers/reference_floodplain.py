"""Float64 NumPy twins of what a floodplain remembers."""

import numpy as np

from warpriver.kernels.floodplain import FORGOTTEN, NEVER, TICKS


def left(date, now, time):
    """What is left of something after its age in ticks, 0 of what never was."""
    age = np.maximum(now - date.astype(np.float64), 0.0) / TICKS / time
    return np.where((date == NEVER) | (age > FORGOTTEN), 0.0, np.exp(-age))


def cell_factors(river, plug, unrest, now, law):
    """Factor of each cell; ``law`` has (change, time) of "bar", "plug" and "unrest"."""
    banks = np.where(
        plug >= river,
        1.0 + law["plug"][0] * left(plug, now, law["plug"][1]),
        1.0 + law["bar"][0] * left(river, now, law["bar"][1]),
    )
    return banks * (1.0 + law["unrest"][0] * left(unrest, now, law["unrest"][1]))


def factors_at(cells, grid, xy):
    """Bilinear factors at places, 1 beyond the map; ``grid`` is (west, north, cell size)."""
    west, north, size = grid
    around = np.pad(cells, 1, constant_values=1.0)
    position = np.stack([(xy[:, 0] - west) / size - 0.5, (north - xy[:, 1]) / size - 0.5], axis=1)
    low = np.floor(position)
    u, v = (position - low).T
    j, i = (np.clip(low[:, k].astype(int) + 1, 0, cells.shape[1 - k]) for k in (0, 1))
    inside = (low >= -1).all(axis=1) & (low[:, 0] < cells.shape[1]) & (low[:, 1] < cells.shape[0])
    total = (1 - v) * ((1 - u) * around[i, j] + u * around[i, j + 1])
    total += v * ((1 - u) * around[i + 1, j] + u * around[i + 1, j + 1])
    return np.where(inside, total, 1.0)


def discs(shape, grid, xy, radius):
    """Cells whose centres lie in a disc, or which hold its middle, of any of some places."""
    west, north, size = grid
    row, column = np.indices(shape)
    position = np.stack([(xy[:, 0] - west) / size - 0.5, (north - xy[:, 1]) / size - 0.5], axis=1)
    found = np.zeros(shape, bool)
    for (x, y), reach in zip(position, np.broadcast_to(radius, len(xy)) / size, strict=True):
        found |= np.hypot(column - x, row - y) <= reach
        if 0 <= round(x) < shape[1] and 0 <= round(y) < shape[0]:
            found[round(y), round(x)] = True
    return found
