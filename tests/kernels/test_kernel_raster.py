"""Sampling of rasters against its twin, and the cells that points lie in."""

import numpy as np
import pytest
import reference_terrain as twin
import warp as wp
from kernel_arrays import unwritten
from raster_bench import GRID, TOLERANCE, Bench, rough, scattered

NOWHERE = np.array([[np.nan, 800.0], [200.0, np.nan], [np.inf, 800.0], [200.0, -np.inf], [1e30, 1e30]])


@pytest.fixture
def bench(dtype, device):
    return Bench(dtype, device)


def sampled(bench, height, xy):
    value = unwritten(len(xy), wp.float64, bench.device)
    inputs = [bench.raster(height), bench.grid, bench.points(xy)]
    return bench.launch(bench.raster_kernel.sample_values, len(xy), inputs, [value])[0]


def found(bench, shape, xy):
    cell = unwritten(len(xy), wp.int32, bench.device)
    inside = wp.full(len(xy), 7, dtype=wp.uint8, device=bench.device)
    inputs = [*shape, bench.grid, bench.points(xy)]
    return bench.launch(bench.raster_kernel.find_cells, len(xy), inputs, [cell, inside])


@pytest.mark.parametrize("gaps", [0.0, 0.15, 0.6])
def test_values_are_those_of_the_twin(bench, dtype, gaps):
    height, xy = rough(gaps=gaps), scattered()
    expected = np.array([twin.value_at(height, GRID, p) for p in xy])
    assert 0.1 < np.isnan(expected).mean() < 0.9
    np.testing.assert_allclose(sampled(bench, height, xy), expected, atol=TOLERANCE[dtype], rtol=0.0)


def test_cells_are_those_that_points_lie_in(bench):
    """Off the lines between cells, on which either is right."""
    xy = scattered()
    west, north, size = GRID
    place = np.stack([(north - xy[:, 1]) / size, (xy[:, 0] - west) / size], axis=1)
    clear = (np.abs(place - np.rint(place)) > 1e-3).all(axis=1)
    row, column = np.floor(place[clear]).astype(int).T
    on = (row >= 0) & (row < 24) & (column >= 0) & (column < 31)
    cell, inside = found(bench, (24, 31), xy[clear])
    assert 0.2 < on.mean() < 0.95 and np.array_equal(inside, on.astype(np.uint8))
    assert np.array_equal(cell, np.where(on, row * 31 + column, 0))


def test_corners_of_the_raster_belong_to_its_corner_cells(bench):
    west, north, size = GRID
    xy = [(west, north), (west + 31 * size, north), (west, north - 24 * size), (west + 31 * size, north - 24 * size)]
    cell, inside = found(bench, (24, 31), xy)
    assert cell.tolist() == [0, 30, 23 * 31, 24 * 31 - 1] and inside.all()


def test_points_that_are_nowhere_get_nothing(bench):
    assert np.isnan(sampled(bench, rough(gaps=0.0), NOWHERE)).all()
    cell, inside = found(bench, (24, 31), NOWHERE)
    assert not cell.any() and not inside.any()
