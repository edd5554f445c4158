"""Channel cells: those that drain enough ground, where their water goes on, and courses that run side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.hydrology.lakes import LAND, SEA
from warpriver.hydrology.routing import Flow, order_cells, sum_upstream

__all__ = ["ChannelCells", "climb", "find_channel_cells"]


@dataclass
class ChannelCells:
    """The cells that are channel, as a graph.

    Attributes:
        place: (n, 2) row and column; beyond the raster for what lies across a periodic side from its mouth.
        height: (n,) height of the surface that water runs on in m.
        area: (n,) drainage area in cells.
        supply: (n,) what of it comes from no channel cell, in cells.
        down: (n,) the cell that the water goes to next, -1 at outlets.
    """

    place: IndexArray
    height: FloatArray
    area: FloatArray
    supply: FloatArray
    down: IndexArray

    def without(self, gone: FlagArray, instead: IndexArray, down: IndexArray) -> ChannelCells:
        """Take cells out: others do instead of them, to which their supply and their donors go.

        Args:
            gone: (n,) True for the cells to take out.
            instead: (n,) the cell instead of each that is gone; one that stays.
            down: (n,) where the water goes on; what leads to a cell that is gone leads to the one instead of it.
        """
        supply = self.supply.copy()
        np.add.at(supply, instead[gone], self.supply[gone])
        inner = down >= 0
        to = down.copy()
        to[inner] = np.where(gone[down[inner]], instead[down[inner]], down[inner])
        number = np.cumsum(~gone) - 1
        to = np.where(to >= 0, number[to], -1)[~gone]
        supply = supply[~gone]
        return ChannelCells(self.place[~gone], self.height[~gone], _totals(to, supply), supply, to)


def find_channel_cells(flow: Flow, cells: FloatArray, threshold: float, unroll: bool) -> ChannelCells:
    """Find the cells that are channel.

    On land a cell is if it drains the threshold. On a lake it is one if a channel flows in above it, so that none
    begins there; on the sea none is.

    Args:
        flow: The terrain's flow.
        cells: (rows, columns) drainage area in cells, NaN without data.
        threshold: Minimum drainage area in cells.
        unroll: Whether places run on across periodic sides.
    """
    receiver = flow.host_receiver
    # A fraction of 1e-9 of slack, so that a threshold of a whole number of cells keeps cells that drain just that.
    enough = cells >= threshold * (1.0 - 1e-9)
    if flow.water is not None:
        water = flow.water.values.numpy()
        fed = sum_upstream(receiver, flow.order, (enough & (water == LAND)).astype(np.float64)) > 0.0
        enough &= fed & (water != SEA)
    cell = np.flatnonzero(enough)
    area = cells.reshape(-1)[cell]
    to = receiver.reshape(-1)[cell].astype(np.int64)
    place = np.column_stack(np.divmod(cell, receiver.shape[1]))
    step = np.column_stack(np.divmod(to, receiver.shape[1])) - place
    # Across a periodic side the receiver is no neighbour on the map.
    far = np.abs(step) > 1
    down = np.minimum(np.searchsorted(cell, to), len(cell) - 1)
    down[(to == cell) | (cell[down] != to)] = -1
    if unroll:
        place += _sums_down(down, np.where(far, np.sign(step) * np.array(receiver.shape), 0))
    else:
        down[far.any(axis=1)] = -1
    inner = down >= 0
    supply = area - np.bincount(down[inner], weights=area[inner], minlength=len(cell))
    height = flow.terrain.height.numpy().reshape(-1)[cell].astype(np.float64)
    return ChannelCells(place, height, area, supply, down)


def climb(above: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Follow pointers upwards to their ends (-1): the last element and the number of steps to it, by doubling."""
    n = len(above)
    last = np.where(above >= 0, above, np.arange(n))
    steps = (above >= 0).astype(np.int64)
    while True:
        further = steps[last]
        if not further.any():
            return last, steps
        steps = steps + further
        last = last[last]


def _sums_down(down: IndexArray, own: IndexArray) -> IndexArray:
    """Sum of each element's own values and those of all downstream of it, along pointers that end at -1."""
    total: IndexArray = own.copy()
    to = down.copy()
    while (inner := np.flatnonzero(to >= 0)).size:
        total[inner] += total[to[inner]]
        to[inner] = to[to[inner]]
    return total


def _totals(down: IndexArray, supply: FloatArray) -> FloatArray:
    """Sum of each cell's own supply and that of all cells upstream of it."""
    receiver = np.where(down >= 0, down, np.arange(len(down))).astype(np.int32)
    return sum_upstream(receiver, order_cells(receiver), supply.copy())
