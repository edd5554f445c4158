"""Float64 NumPy twins of the terrain kernels, written to be read: a point or a cell at a time, rules as stated."""

import math

import numpy as np


def corners(height, grid, xy):
    """The four centres around a point that have data, as (row, column, weight); None where its own cell has none."""
    west, north, size = grid
    rows, columns = height.shape
    x, y = (xy[0] - west) / size - 0.5, (north - xy[1]) / size - 0.5
    if not (-0.5 <= x <= columns - 0.5 and -0.5 <= y <= rows - 0.5):
        return None
    if np.isnan(height[min(math.floor(y + 0.5), rows - 1), min(math.floor(x + 0.5), columns - 1)]):
        return None
    found = []
    for row in (math.floor(y), math.floor(y) + 1):
        for column in (math.floor(x), math.floor(x) + 1):
            weight = (1.0 - abs(x - column)) * (1.0 - abs(y - row))
            if 0 <= row < rows and 0 <= column < columns and not np.isnan(height[row, column]):
                found.append((row, column, weight))
    return found


def value_at(height, grid, xy):
    """Height at a point: the weighted mean of the centres around it that have data."""
    found = corners(height, grid, xy)
    if found is None:
        return math.nan
    return sum(w * height[i, j] for i, j, w in found) / sum(w for _, _, w in found)


def difference(before, here, after):
    """Change per cell: central, one-sided where a neighbour is missing, 0 where both are."""
    if np.isnan(before) and np.isnan(after):
        return 0.0
    if np.isnan(before):
        return after - here
    if np.isnan(after):
        return here - before
    return 0.5 * (after - before)


def cell_gradient(height, size, row, column):
    """Gradient (east, north) at a cell's centre."""
    framed = np.pad(height, 1, constant_values=np.nan)
    here, i, j = height[row, column], row + 1, column + 1
    if np.isnan(here):
        return np.array([math.nan, math.nan])
    east = difference(framed[i, j - 1], here, framed[i, j + 1])
    north = difference(framed[i + 1, j], here, framed[i - 1, j])
    return np.array([east, north]) / size


def gradient_at(height, grid, xy):
    """Gradient at a point: the weighted mean of those at the centres around it that have data."""
    found = corners(height, grid, xy)
    if found is None:
        return np.array([math.nan, math.nan])
    return sum(w * cell_gradient(height, grid[2], i, j) for i, j, w in found) / sum(w for _, _, w in found)


def slope(height, size):
    """Slope of every cell."""
    out = [[np.hypot(*cell_gradient(height, size, i, j)) for j in range(height.shape[1])] for i in range(len(height))]
    return np.array(out)


def falloff(part):
    """1 - 3 p^2 + 2 p^3 within 0 .. 1."""
    p = np.clip(part, 0.0, 1.0)
    return 1.0 - 3.0 * p**2 + 2.0 * p**3


def centers(shape, grid):
    """Coordinates x and y of every cell's centre, each (rows, columns)."""
    west, north, size = grid
    row, column = np.indices(shape)
    return west + (column + 0.5) * size, north - (row + 0.5) * size


def brush_weight(shape, grid, center, radius):
    """Weight of a round brush at every cell."""
    x, y = centers(shape, grid)
    return falloff(np.hypot(x - center[0], y - center[1]) / radius)


def blurred(height, weight, axis):
    """h + sum of w_k (h_-k + h_k - 2 h) along an axis, over the pairs that are whole."""
    out = height.copy()
    for index in np.ndindex(height.shape):
        for k in range(1, len(weight)):
            before, after = list(index), list(index)
            before[axis], after[axis] = index[axis] - k, index[axis] + k
            if before[axis] >= 0 and after[axis] < height.shape[axis]:
                excess = height[tuple(before)] + height[tuple(after)] - 2.0 * height[index]
                out[index] += 0.0 if np.isnan(excess) else weight[k] * excess
    return out


def ridge(shape, grid, line, crest, half_width):
    """Height that a ridge adds to every cell."""
    x, y = centers(shape, grid)
    nearest, height = np.full(shape, np.inf), np.zeros(shape)
    for (ax, ay), (bx, by), first, last in zip(line[:-1], line[1:], crest[:-1], crest[1:], strict=True):
        along = (x - ax) * (bx - ax) + (y - ay) * (by - ay)
        part = np.clip(along / ((bx - ax) ** 2 + (by - ay) ** 2), 0.0, 1.0)
        distance = np.hypot(x - ax - part * (bx - ax), y - ay - part * (by - ay))
        closer = distance < nearest
        nearest[closer] = distance[closer]
        height[closer] = (first + part * (last - first))[closer]
    return height * falloff(nearest / half_width)


def block_means(height, step):
    """Means over blocks of step x step cells, the last ones cut off by the edge; NaN where less than half has data."""
    shape = tuple(math.floor(n / step + 0.5) for n in height.shape)
    out = np.full(shape, np.nan)
    for i, j in np.ndindex(shape):
        block = height[i * step : (i + 1) * step, j * step : (j + 1) * step]
        if np.isfinite(block).mean() >= 0.5:
            out[i, j] = np.nanmean(block)
    return out


def line_means(values, step):
    """Means of the line through values at 0, 1, 2 .., level beyond both ends, over pieces of a length from -1/2 on."""
    count, out = len(values), []
    for i in range(math.floor(count / step + 0.5)):
        low, high = i * step - 0.5, min((i + 1) * step, count) - 0.5
        # The trapezoidal rule is exact between the kinks.
        kinks = [low, *(k for k in range(count) if low < k < high), high]
        at = np.interp(kinks, np.arange(count), values)
        out.append(np.sum(0.5 * np.diff(kinks) * (at[1:] + at[:-1])) / (high - low))
    return np.array(out)


def surface_means(height, step):
    """Means of the bilinear surface over new cells of step x step old ones."""
    columns = np.apply_along_axis(line_means, 1, height, step)
    return np.apply_along_axis(line_means, 0, columns, step)


def pcg(state):
    """One round of the PCG hash on 32 bits, as Warp has it."""
    b = (state * 747796405 + 2891336453) & 0xFFFFFFFF
    c = (((b >> ((b >> 28) + 4)) ^ b) * 277803737) & 0xFFFFFFFF
    return ((c >> 22) ^ c) & 0xFFFFFFFF


def lattice_gradient(seed, i, j):
    """Unit vector of a lattice point."""

    def rand_init(first, second):
        return pcg((first + pcg(second & 0xFFFFFFFF)) & 0xFFFFFFFF)

    angle = 2.0 * math.pi * rand_init(seed, rand_init(i, j)) / 2.0**32
    return np.array([math.cos(angle), math.sin(angle)])


def gradient_noise(seed, x, y):
    """Gradient noise: ramps of the four lattice points around, blended by 6 t^5 - 15 t^4 + 10 t^3, times sqrt(2)."""
    i, j = math.floor(x), math.floor(y)
    total = 0.0
    for di in (0, 1):
        for dj in (0, 1):
            u, v = abs(x - i - di), abs(y - j - dj)
            blend = math.prod(1.0 - (6.0 * t**5 - 15.0 * t**4 + 10.0 * t**3) for t in (u, v))
            total += blend * lattice_gradient(seed, i + di, j + dj) @ np.array([x - i - di, y - j - dj])
    return math.sqrt(2.0) * total


def octave_sum(seed, shape, size, longest, roughness, count):
    """Sum of octaves at the centres, places from the south-west corner, each octave turned by the golden angle."""
    golden = math.pi * (3.0 - math.sqrt(5.0))
    turn = np.array([[math.cos(golden), -math.sin(golden)], [math.sin(golden), math.cos(golden)]])
    out = np.zeros(shape)
    for row, column in np.ndindex(shape):
        place = np.array([column + 0.5, shape[0] - row - 0.5]) * size / longest
        for k in range(count):
            place = turn @ place
            out[row, column] += roughness**k * gradient_noise(seed + k, *place)
            place = 2.0 * place
    return out


def receivers(height, is_base):
    """Steepest of eight descents of every cell, as flat indices; base cells and pits drain to themselves."""
    rows, columns = height.shape
    out = np.arange(height.size)
    for row, column in np.ndindex(height.shape):
        best = 0.0
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in range(max(column - 1, 0), min(column + 2, columns)):
                fall = (height[row, column] - height[i, j]) / max(math.hypot(i - row, j - column), 1e-9)
                if not is_base[row, column] and (i, j) != (row, column) and fall > best:
                    best, out[row * columns + column] = fall, i * columns + j
    return out


def drained(height, receiver, resistance, floor, size, steepness, concavity, hillslope):
    """Drainage area, and height in the steady state, of every cell."""
    columns = height.shape[1]
    order = np.argsort(height, axis=None, kind="stable")
    area, out = np.full(height.size, size**2), height.ravel().copy()
    for cell in order[::-1]:
        if receiver[cell] != cell:
            area[receiver[cell]] += area[cell]
    for cell in order:
        to = receiver[cell]
        if to != cell:
            length = size * math.hypot(cell // columns - to // columns, cell % columns - to % columns)
            slope_there = resistance[cell] * steepness / max(area[cell], hillslope) ** concavity
            out[cell] = out[to] + max(length * slope_there, floor[cell] - floor[to])
    return area, out
