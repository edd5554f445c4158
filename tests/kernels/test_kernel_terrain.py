"""Terrain kernels, and the raster functions in them, against their twins; outputs are NaN before, rasters have gaps."""

import numpy as np
import pytest
import reference_terrain as twin
import warp as wp
from kernel_arrays import to_device, unwritten
from raster_bench import GRID, TOLERANCE, Bench, rough, scattered


@pytest.fixture
def bench(dtype, device):
    return Bench(dtype, device)


@pytest.mark.parametrize("gaps", [0.0, 0.15, 0.6])
def test_gradients_are_those_of_the_twin(bench, dtype, gaps):
    height, xy = rough(gaps=gaps), scattered()
    kernel, inputs = bench.kernel, [bench.raster(height), bench.grid, bench.points(xy)]
    gradient = unwritten(len(xy), kernel.vec2, bench.device)
    (gradient,) = bench.launch(kernel.sample_gradients, len(xy), inputs, [gradient])
    steepest = np.array([twin.gradient_at(height, GRID, p) for p in xy])
    assert 0.1 < np.isnan(steepest[:, 0]).mean() < 0.9
    np.testing.assert_allclose(gradient, steepest, atol=TOLERANCE[dtype], rtol=0.0)


@pytest.mark.parametrize("shape", [(2, 2), (2, 5), (3, 3), (4, 4), (5, 2)])
def test_small_rasters_have_no_inside_to_lean_on(bench, dtype, shape):
    height = np.random.default_rng(3).uniform(0.0, 100.0, shape)
    west, north, size = GRID
    xy = np.random.default_rng(4).uniform((west, north - shape[0] * size), (west + shape[1] * size, north), (100, 2))
    inputs = [bench.raster(height), bench.grid, bench.points(xy)]
    outputs = unwritten(100, bench.kernel.vec2, bench.device)
    (gradient,) = bench.launch(bench.kernel.sample_gradients, 100, inputs, [outputs])
    expected = np.array([twin.gradient_at(height, GRID, p) for p in xy])
    np.testing.assert_allclose(gradient, expected, atol=TOLERANCE[dtype], rtol=0.0)


def test_points_that_are_nowhere_get_nan(bench):
    xy = np.array([[np.nan, 800.0], [200.0, np.nan], [np.inf, 800.0], [200.0, -np.inf], [1e30, 1e30]])
    inputs = [bench.raster(rough(gaps=0.0)), bench.grid, bench.points(xy)]
    gradient = wp.zeros(5, dtype=bench.kernel.vec2, device=bench.device)
    (gradient,) = bench.launch(bench.kernel.sample_gradients, 5, inputs, [gradient])
    assert np.isnan(gradient).all()


def test_slope_of_cells(bench):
    height = rough()
    out = unwritten(height.shape, wp.float64, bench.device)
    inputs = [bench.raster(height), wp.float64(1.0 / GRID[2])]
    (slope,) = bench.launch(bench.kernel.compute_slope, height.shape, inputs, [out])
    np.testing.assert_allclose(slope, twin.slope(height, GRID[2]), rtol=1e-12)


# First row, first column, rows, columns: everything, and a part.
WINDOWS = [(0, 0, 24, 31), (5, 7, 9, 11)]
CENTER, RADIUS = (223.0, 811.0), 47.0


def within(window, edited, before):
    """What an edit of all cells is where only a window is edited."""
    row, column, rows, columns = window
    out = before.copy()
    out[row : row + rows, column : column + columns] = edited[row : row + rows, column : column + columns]
    return out


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("amount", [12.5, -40.0])
def test_a_brush_raises_cells(bench, dtype, window, amount):
    height = rough()
    io = bench.raster(height)
    inputs = [bench.grid, bench.brush(CENTER, RADIUS, amount), wp.vec4i(*window)]
    (edited,) = bench.launch(bench.kernel.raise_cells, window[2:], inputs, [io])
    weight = twin.brush_weight(height.shape, GRID, CENTER, RADIUS)
    expected = within(window, height + amount * weight, height)
    np.testing.assert_allclose(edited, expected, atol=TOLERANCE[dtype], rtol=0.0)
    untouched = weight == 0.0
    np.testing.assert_array_equal(edited[untouched], height[untouched])


@pytest.mark.parametrize("window", WINDOWS)
def test_a_brush_flattens_cells(bench, dtype, window):
    height = rough()
    io = bench.raster(height)
    inputs = [bench.grid, bench.brush(CENTER, RADIUS, 0.8, level=321.0), wp.vec4i(*window)]
    (edited,) = bench.launch(bench.kernel.flatten_cells, window[2:], inputs, [io])
    weight = 0.8 * twin.brush_weight(height.shape, GRID, CENTER, RADIUS)
    expected = within(window, height + weight * (321.0 - height), height)
    np.testing.assert_allclose(edited, expected, atol=TOLERANCE[dtype], rtol=0.0)


@pytest.mark.parametrize("reach", [0, 1, 4, 40])
def test_rows_are_blurred_in_whole_pairs(bench, reach):
    height, window = rough(), (3, 5, 12, 20)
    weight = np.random.default_rng(5).uniform(0.0, 0.1, reach + 1)
    out = unwritten(window[2:], wp.float64, bench.device)
    inputs = [bench.raster(height), wp.vec4i(*window), bench.raster(weight)]
    (blurred,) = bench.launch(bench.kernel.blur_rows, window[2:], inputs, [out])
    expected = twin.blurred(height, weight, axis=1)[3:15, 5:25]
    np.testing.assert_allclose(blurred, expected, atol=1e-9, rtol=0.0)


def test_columns_are_blurred_and_blended(bench, dtype):
    height, window, first_row = rough(), (6, 5, 9, 20), 3
    weight = np.array([0.4, 0.2, 0.1])
    strip = height[first_row:19, 5:25]
    io = bench.raster(height)
    inputs = [bench.grid, bench.brush(CENTER, RADIUS, 0.7), wp.vec4i(*window), first_row, bench.raster(weight)]
    (edited,) = bench.launch(bench.kernel.blend_columns, window[2:], [*inputs, bench.raster(strip)], [io])
    smooth = height.copy()
    smooth[first_row:19, 5:25] = twin.blurred(strip, weight, axis=0)
    share = 0.7 * twin.brush_weight(height.shape, GRID, CENTER, RADIUS)
    expected = within(window, height + share * (smooth - height), height)
    np.testing.assert_allclose(edited, expected, atol=TOLERANCE[dtype], rtol=0.0)


@pytest.mark.parametrize("window", WINDOWS)
def test_a_ridge_is_added(bench, dtype, window):
    height, half = rough(), 30.0
    line = np.array([[100.0, 720.0], [180.0, 850.0], [230.0, 800.0], [420.0, 890.0]])
    crest = np.array([10.0, 60.0, -20.0, 40.0])
    io = bench.raster(height)
    inputs = [bench.grid, bench.scalar(half), wp.vec4i(*window), bench.points(line)]
    inputs.append(to_device(crest.astype(bench.real), bench.scalar, bench.device))
    (edited,) = bench.launch(bench.kernel.raise_ridge, window[2:], inputs, [io])
    expected = within(window, height + twin.ridge(height.shape, GRID, line, crest, half), height)
    np.testing.assert_allclose(edited, expected, atol=TOLERANCE[dtype], rtol=0.0)


def resampled(bench, height, step, way, shape):
    out = unwritten(shape, wp.float64, bench.device)
    inputs = [wp.vec2d(*step), wp.vec2i(*way), bench.raster(height)]
    (found,) = bench.launch(bench.kernel.resample_cells, shape, inputs, [out])
    return found


@pytest.mark.parametrize("step", [2, 3, 5, 12])
@pytest.mark.parametrize("gaps", [0.0, 0.5])
def test_multiples_are_means_of_blocks(bench, step, gaps):
    height = rough(gaps=gaps)
    expected = twin.block_means(height, step)
    found = resampled(bench, height, (step, step), (1, 1), expected.shape)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("step", [1.0001, 1.5, 2.0, 3.7, 11.0])
def test_coarser_cells_are_means_of_the_surface(bench, step):
    height = np.random.default_rng(6).uniform(0.0, 1000.0, (24, 31))
    expected = twin.surface_means(height, step)
    found = resampled(bench, height, (step, step), (2, 2), expected.shape)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_coarser_cells_need_data_on_half_of_their_area(bench):
    height = np.full((24, 31), 7.0)
    height[:, 10:] = np.nan
    found = resampled(bench, height, (2.5, 2.5), (2, 2), (10, 12))
    np.testing.assert_allclose(found[:, :4], 7.0, rtol=1e-14)
    assert np.isnan(found[:, 4:]).all()


@pytest.mark.parametrize("step", [1.0, 0.5, 0.37])
def test_finer_cells_are_samples(bench, step):
    height = rough()
    shape = tuple(max(2, int(n / step + 0.5)) for n in height.shape)
    fine = resampled(bench, height, (step, step), (0, 0), shape)
    grid = (0.0, 0.0, 1.0)
    x, y = twin.centers(shape, (0.0, 0.0, step))
    expected = [twin.value_at(height, grid, p) for p in zip(x.ravel(), y.ravel(), strict=True)]
    np.testing.assert_allclose(fine.ravel(), expected, atol=1e-9, rtol=0.0)


def test_oblong_cells_are_resampled_along_each_side_by_itself(bench):
    """Columns twice as fine, rows three times as coarse: the mean of three rows, linear along them."""
    height = np.random.default_rng(6).uniform(0.0, 1000.0, (24, 31))
    changed = resampled(bench, height, (0.5, 3.0), (0, 1), (8, 62))
    mean = height.reshape(8, 3, 31).mean(axis=1)
    x = np.clip((np.arange(62) + 0.5) * 0.5 - 0.5, 0.0, 30.0)
    expected = [np.interp(x, np.arange(31), row) for row in mean]
    np.testing.assert_allclose(changed, expected, rtol=1e-12)
