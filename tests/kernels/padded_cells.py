"""Padded rasters on a device for the hydrology kernels, made by the module that the library makes them with."""

import numpy as np
import warp as wp
from kernel_arrays import REALS, SCALARS, to_device

from warpriver.hydrology.cells import pad_terrain
from warpriver.terrain import Terrain


class Case:
    """Heights of one precision on a device, padded, with their states; arrays come back without the padding."""

    def __init__(self, height, *, edges="open", nodata="outlet", dtype="float64", device="cpu"):
        self.scalar, self.real, self.device = SCALARS[dtype], REALS[dtype], device
        self.cells = pad_terrain(Terrain(np.asarray(height, np.float64), 1.0), edges, nodata, 0)
        self.rows, self.stride, self.count = self.cells.rows, self.cells.stride, self.cells.count
        self.shape = (self.cells.rows, self.cells.columns)
        self.height = to_device(self.cells.height.ravel(), self.scalar, device)
        self.state = to_device(self.cells.state.ravel(), wp.uint8, device)

    def scratch(self, kind, value=None):
        """Array with an element a padded cell, of a value or unwritten."""
        array = wp.empty(self.count, dtype=kind, device=self.device)
        array.fill_(77 if value is None else value)
        return array

    def launch(self, kernel, inputs, outputs, dim=1):
        """Launch on the case's device; the kernels that need an order run on one thread."""
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)

    def inside(self, array):
        """The terrain's own cells of a padded array, on the host."""
        return array.numpy().reshape(self.cells.height.shape)[1:-1, 1:-1]
