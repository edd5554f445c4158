"""Rasters with gaps, points over them, and the kernels that read them in one precision on one device."""

import numpy as np
import reference_terrain as twin
import warp as wp
from kernel_arrays import REALS, SCALARS, to_device

from warpriver.kernels import raster, terrain

# Float64: some products of numbers of the size of the heights, 1e3. Float32: a place in a raster of 40 cells is off by
# up to 3e-6 cells, and heights of neighbours differ by up to 1e3 m.
TOLERANCE = {"float64": 1e-9, "float32": 2e-2}
GRID = (120.0, 900.0, 8.0)


def rough(rows=24, columns=31, gaps=0.15, seed=0):
    """Random heights with gaps, some of them in the corners and along an edge."""
    rng = np.random.default_rng(seed)
    height = rng.uniform(0.0, 1000.0, (rows, columns))
    height[rng.random(height.shape) < gaps] = np.nan
    height[0, :4] = np.nan
    return height


def scattered(count=400, seed=1, beyond=20.0):
    """Points over GRID's raster and a little beyond; centres and places on the edge among them."""
    rng = np.random.default_rng(seed)
    west, north, size = GRID
    low, high = (west - beyond, north - 24 * size - beyond), (west + 31 * size + beyond, north + beyond)
    centers = np.stack(twin.centers((24, 31), GRID), axis=-1).reshape(-1, 2)
    return np.concatenate([rng.uniform(low, high, (count, 2)), centers[::7]])


class Bench:
    """The kernels in one precision on one device, and GRID as they read it."""

    def __init__(self, dtype, device):
        self.scalar, self.real, self.device = SCALARS[dtype], REALS[dtype], device
        self.kernel, self.raster_kernel = terrain.build(self.scalar), raster.build(self.scalar)
        self.grid = self.kernel.RasterGrid()
        self.grid.west, self.grid.north, self.grid.cell_size = GRID
        self.grid.cells_per_meter = 1.0 / GRID[2]

    def raster(self, values):
        return to_device(values, wp.float64, self.device)

    def points(self, xy):
        return to_device(np.asarray(xy, self.real), self.kernel.vec2, self.device)

    def brush(self, center, radius, amount, level=0.0):
        brush = self.kernel.Brush()
        brush.center, brush.radius, brush.amount, brush.level = self.kernel.vec2(*center), radius, amount, level
        return brush

    def launch(self, kernel, dim, inputs, outputs):
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)
        return [out.numpy() for out in outputs]
