"""Controls stamped into rasters, and what blocks of cells say of them, against float64 twins."""

import itertools
import math

import numpy as np
import pytest
import warp as wp
from kernel_arrays import REALS, SCALARS, struct_of, to_device, vec2_of

from warpriver.kernels import controls
from warpriver.kernels.ground import BLOCK

# A raster of cells of 20 m whose north-west corner lies at (-100, 700); a window of it, and a line of three points.
SHAPE, SIZE, WEST, NORTH = (37, 41), 20.0, -100.0, 700.0
WINDOW = (4, 6, 28, 30)
LINE = np.array([[60.0, 60.0], [330.0, 420.0], [520.0, 300.0]])
# Heights of some 100 m, distances of some 500 m.
CLOSE = {"float64": 1e-10, "float32": 2e-3}


def place(kernel, west=WEST, north=NORTH, size=SIZE):
    return struct_of(kernel.RasterGrid, west=west, north=north, cell_size=size, cells_per_meter=1.0 / size)


def centres(shape=SHAPE, west=WEST, north=NORTH, size=SIZE):
    rows, columns = np.indices(shape)
    return np.stack([west + (columns + 0.5) * size, north - (rows + 0.5) * size], axis=-1)


def distance_to(line, xy):
    """Distance of places to a polyline."""
    nearest = np.hypot(*(xy - line[0]).transpose(2, 0, 1))
    for a, b in itertools.pairwise(line):
        t = np.clip(((xy - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
        nearest = np.minimum(nearest, np.hypot(*(xy - a - t[..., None] * (b - a)).transpose(2, 0, 1)))
    return nearest


def bilinear(values, xy, west, north, size):
    """Bilinear value between centres, that of the nearest within the outer half cell; NaN beyond the raster."""
    column, row = (xy[..., 0] - west) / size - 0.5, (north - xy[..., 1]) / size - 0.5
    rows, columns = values.shape
    off = (column < -0.5) | (row < -0.5) | (column > columns - 0.5) | (row > rows - 0.5)
    column, row = np.clip(column, 0.0, columns - 1.0), np.clip(row, 0.0, rows - 1.0)
    j, i = np.minimum(column.astype(int), columns - 2), np.minimum(row.astype(int), rows - 2)
    u, v = column - j, row - i
    upper = values[i, j] * (1.0 - u) + values[i, j + 1] * u
    lower = values[i + 1, j] * (1.0 - u) + values[i + 1, j + 1] * u
    return np.where(off, np.nan, upper * (1.0 - v) + lower * v)


def within(changed, before):
    """What the window shows of changed values; all other cells are as before."""
    expected = before.copy()
    row, column, rows, columns = WINDOW
    expected[row : row + rows, column : column + columns] = changed[row : row + rows, column : column + columns]
    return expected


def stamped(name, inputs, before, dtype, device):
    """Values after a launch over the window."""
    kernel = controls.build(SCALARS[dtype])
    out = to_device(before.copy(), wp.float64, device)
    wp.launch(getattr(kernel, name), WINDOW[2:], inputs(kernel), [out], device=device)
    return out.numpy()


def start(seed=1):
    return np.random.default_rng(seed).normal(2.0, 1.0, SHAPE)


@pytest.mark.parametrize("line", [LINE[:1], LINE], ids=["point", "line"])
def test_a_bump_is_that_of_the_twin(line, dtype, device):
    def inputs(kernel):
        xy = to_device(line.astype(REALS[dtype]), vec2_of(SCALARS[dtype]), device)
        return [place(kernel), struct_of(kernel.Bump, radius=180.0, strength=-0.7), wp.vec4i(*WINDOW), xy]

    before = start()
    p = distance_to(line, centres()) / 180.0
    bump = -0.7 * 180.0 / (96.0 / (25.0 * math.sqrt(5.0))) * np.maximum(1.0 - p * p, 0.0) ** 3
    found = stamped("add_bump", inputs, before, dtype, device)
    np.testing.assert_allclose(found, within(before + bump, before), atol=CLOSE[dtype])


@pytest.mark.parametrize("name", ["add_field", "scale_by_field"])
def test_a_field_is_that_of_the_twin(name, dtype, device):
    values = np.random.default_rng(2).uniform(0.5, 2.0, (9, 11))
    where = (55.0, 520.0, 47.0)

    def inputs(kernel):
        cells = to_device(values, wp.float64, device)
        return [place(kernel), wp.vec4i(*WINDOW), cells, place(kernel, *where)]

    before = start()
    here = bilinear(values, centres(), *where)
    changed = before + np.nan_to_num(here) if name == "add_field" else before * np.where(np.isnan(here), 1.0, here)
    found = stamped(name, inputs, before, dtype, device)
    assert np.isnan(here).any()
    np.testing.assert_allclose(found, within(changed, before), atol=10.0 * CLOSE[dtype])


def test_a_polygon_scales_what_it_holds(dtype, device):
    shapely = pytest.importorskip("shapely")

    def inputs(kernel):
        corners = to_device(LINE.astype(REALS[dtype]), vec2_of(SCALARS[dtype]), device)
        return [place(kernel), wp.float64(0.25), SCALARS[dtype](60.0), wp.vec4i(*WINDOW), corners]

    before, polygon, xy = start(), shapely.Polygon(LINE), shapely.points(centres())
    inside = np.where(shapely.contains(polygon, xy), shapely.distance(polygon.exterior, xy), 0.0)
    t = np.clip(inside / 60.0, 0.0, 1.0)
    changed = before * np.where(inside > 0.0, 1.0 - 0.75 * t * t * (3.0 - 2.0 * t), 1.0)
    found = stamped("scale_inside", inputs, before, dtype, device)
    np.testing.assert_allclose(found, within(changed, before), atol=CLOSE[dtype])


def test_a_window_is_filled(dtype, device):
    before = start()
    found = stamped("fill_window", lambda _: [wp.vec4i(*WINDOW), wp.float64(5.0)], before, dtype, device)
    np.testing.assert_array_equal(found, within(np.full(SHAPE, 5.0), before))


def test_blocks_know_how_free_their_points_may_be(dtype, device):
    """No place in a block may move more freely; without controls it is 1, where rates are scaled below 0."""
    kernel = controls.build(SCALARS[dtype])
    shape = (3 * BLOCK - 5, 4 * BLOCK + 1)
    control, factor = np.zeros(shape), np.ones(shape)
    control[: BLOCK + 3, :BLOCK] = np.random.default_rng(3).normal(0.0, 9.0, (BLOCK + 3, BLOCK))
    factor[2 * BLOCK + 4 :, 3 * BLOCK + 2 :] = 0.0
    factor[5, 2 * BLOCK + 3] = 2.5
    out = wp.full((3, 5), -7.0, dtype=wp.float32, device=device)
    cells = [to_device(values, wp.float64, device) for values in (control, factor)]
    inputs = [place(kernel), wp.vec4i(0, 0, 3, 5), *cells]
    wp.launch(kernel.bound_blocks, (3, 5), inputs, [out], device=device)
    east, north = np.gradient(control, SIZE, axis=1), -np.gradient(control, SIZE, axis=0)
    free = factor * (1.0 + np.hypot(east, north))
    expected = np.ones((3, 5))
    for i, j in np.ndindex(3, 5):
        block = np.s_[i * BLOCK : (i + 1) * BLOCK + 1, j * BLOCK : (j + 1) * BLOCK + 1]
        sign = -1.0 if (factor[block] != 1.0).any() else 1.0
        expected[i, j] = sign * free[block].max()
    # Rounded up in float32, by two parts in 10 million.
    np.testing.assert_allclose(out.numpy(), expected, rtol=1e-6, atol=1e-30)
    assert (np.abs(out.numpy()) >= np.abs(expected)).all() and (out.numpy() == 1.0).sum() == (expected == 1.0).sum() > 4
    assert np.signbit(out.numpy()[2, 4]) and out.numpy()[2, 4] != 0.0
