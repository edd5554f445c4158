"""Lakes and other flats: which way water takes over ground that is level, and which of it is open water."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import ByteArray, CellArray, FloatArray
from warpriver.device import launch_kernel
from warpriver.hydrology.cells import PaddedCells, flat, table
from warpriver.hydrology.depressions import mark_pits
from warpriver.kernels import flats as kernels

__all__ = ["LAKE", "LAND", "SEA", "lead_over_flats"]


# What a cell is. On the sea and in a lake without an outlet no river goes on.
LAND, LAKE, SEA = 0, 1, 2
# A flat is a lake from this distance on between one of its cells and the shore, in cells: from a width of five cells.
LAKE_RADIUS = 3.0
# Height in m up to which level ground at an open side is the sea.
SEA_LEVEL = 0.0
# The cost of a cell's way is (shore distance x depth fraction^2)^-1. This is added to the fraction of the flat's
# maximum depth, so that shoals can be crossed.
DEPTH_EXPONENT, SHALLOWEST = 2.0, 0.05
# Length in cells that the last step to an exit counts more: of the exits of a mouth one is taken far from its banks.
TOLL = 8.0


def lead_over_flats(cells: PaddedCells, bed: FloatArray, receiver: CellArray) -> ByteArray:
    """Lead the water of all flats of a surface without depressions to their exits, and tell what is open water.

    Water follows the path of minimum cost over the flat: away from the shores, and through the deepest ground of a
    depression that was filled. It is found by a fast march from the exits, which favours no direction.

    Args:
        cells: The surface: every cell drains, over flats that are level.
        bed: (rows, columns) height of the ground in m; lower than the surface where a depression was filled.
        receiver: (rows, columns) receiver of each cell, its own on flats; it is completed.

    Returns:
        (rows, columns) LAND, LAKE or SEA.
    """
    water = np.zeros(receiver.shape, np.uint8)
    pit = mark_pits(cells)
    count = int(np.count_nonzero(pit))
    if count == 0:
        return water
    flats = _Flats(cells, pit, count)
    shore, *_ = flats.march(kernels.SHORES, np.ones(count))
    # On a table mountain there is no shore.
    shore[np.isinf(shore)] = 1.0
    place = flats.interior()
    cost = _costs(shore, flats.heights() - bed.reshape(-1)[place], flats.start)
    _, side, crossing, order = flats.march(kernels.EXITS, cost)
    flats.lead(side, crossing, order, receiver)
    water.reshape(-1)[place] = np.repeat(flats.kinds(shore), np.diff(flats.start))
    return water


def _costs(shore: FloatArray, depth: FloatArray, start: CellArray) -> FloatArray:
    """Cost of a length of way in each member, from its distance to the shore in cells and its depth in m."""
    deepest = np.repeat(np.maximum.reduceat(depth, start[:-1]), np.diff(start))
    fraction = np.divide(depth, deepest, out=np.ones_like(depth), where=deepest > 0.0)
    costs: FloatArray = 1.0 / (shore * ((fraction + SHALLOWEST) / (1.0 + SHALLOWEST)) ** DEPTH_EXPONENT)
    return costs


class _Flats:
    """The flats of a surface; their members are listed flat after flat.

    Attributes:
        cells: The surface.
        start: (F + 1,) offsets of the flats' members.
        inner: (F,) 1 for flats with exits that are no outlets.
        cell: (n,) padded cell of each member.
        member: Member that each padded cell is; -1 for none.
    """

    def __init__(self, cells: PaddedCells, pit: ByteArray, count: int):
        self.cells = cells
        self.kernel = kernels.build(wp.float64)
        counts = np.empty(2, np.int32)
        self.start: CellArray = np.empty(count + 1, np.int32)
        self.inner: CellArray = np.empty(count, np.int32)
        self.cell = np.empty(count, np.int32)
        self.member = np.full(cells.count, -1, np.int32)
        outputs = [self._struct(kernels.SHORES), flat(counts)]
        launch_kernel(self.kernel.list_flats, dim=1, inputs=[flat(pit)], outputs=outputs, device="cpu")
        self.start, self.inner = self.start[: counts[1] + 1].copy(), self.inner[: counts[1]].copy()

    def heights(self) -> FloatArray:
        """Height of each member in m."""
        return self.cells.height.reshape(-1)[self.cell]

    def interior(self) -> CellArray:
        """Index of each member in the raster without padding."""
        row, column = np.divmod(self.cell, self.cells.stride)
        return (row - 1) * self.cells.columns + column - 1

    def march(self, begin: int, cost: FloatArray) -> tuple[FloatArray, ByteArray, FloatArray, CellArray]:
        """Length of each member's way to the shores or exits; side that it crosses, and where; order of arrival."""
        length, crossing, side = np.empty_like(cost), np.empty_like(cost), np.empty(len(cost), np.uint8)
        order, place, heap = (np.empty(len(cost), np.int32) for _ in range(3))
        outputs = [flat(a) for a in (length, side, crossing, order, place, heap)]
        launch_kernel(
            self.kernel.march_flats, len(self.inner), [self._struct(begin), flat(cost)], outputs, device="cpu"
        )
        return length, side, crossing, order

    def lead(self, side: ByteArray, crossing: FloatArray, order: CellArray, receiver: CellArray) -> None:
        """Write the members' receivers."""
        gathered, largest, drift = np.empty_like(order), np.empty_like(order), np.empty_like(crossing)
        inputs = [self._struct(kernels.EXITS), flat(side), flat(crossing), flat(order)]
        outputs = [flat(gathered), flat(largest), flat(drift), table(receiver)]
        launch_kernel(self.kernel.lead_flats, len(self.inner), inputs, outputs, device="cpu")

    def kinds(self, shore: FloatArray) -> ByteArray:
        """LAND, LAKE or SEA for each flat, from its members' distances to the shore."""
        kind = np.where(np.maximum.reduceat(shore, self.start[:-1]) >= LAKE_RADIUS, LAKE, LAND).astype(np.uint8)
        ends = self.heights()[self.start[:-1]] <= SEA_LEVEL
        ends[self._terminal()] = True
        kind[(kind == LAKE) & (self.inner == 0) & ends] = SEA
        return kind

    def _terminal(self) -> CellArray:
        """Flats beside an outlet that was made for ground without any."""
        member = self.member[self.cells.around(self.cells.landlocked)]
        terminal: CellArray = np.searchsorted(self.start, member[member >= 0], side="right") - 1
        return terminal

    def _struct(self, begin: int) -> Any:
        """What the kernels need to know of the flats."""
        cells = self.cells
        flats = self.kernel.Flats()
        flats.rows, flats.stride, flats.begin = cells.rows, cells.stride, begin
        flats.toll = TOLL if begin == kernels.EXITS else 0.0
        flats.height, flats.state = flat(cells.height), flat(cells.state)
        flats.cell_member, flats.member_cell = flat(self.member), flat(self.cell)
        flats.start, flats.inner = flat(self.start), flat(self.inner)
        return flats
