"""Draining: all water of a terrain led out of it, out of depressions and over flats and lakes."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver.errors import InputError
from warpriver.hydrology.cells import Edges, NoData, PaddedCells, flat, pad_terrain, table
from warpriver.hydrology.depressions import carve_cells, fill_cells, limit_in_m, with_heights
from warpriver.hydrology.lakes import lead_over_flats
from warpriver.hydrology.routing import Flow
from warpriver.kernels import descent as kernels
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of
from warpriver.validate import one_of

__all__ = ["Depressions", "drain"]

Depressions = Literal["carve", "fill"]

# Scratch and results in bytes a cell, besides the padded copy.
DRAIN_BYTES = 110
# Longest cut that opens a depression by default: the longer one of some cells and a length in m. A bank of noise or a
# bridge is as wide as a few cells, a road's embankment wider than some cells of fine rasters.
CUT_CELLS, CUT_LENGTH = 4.0, 30.0


def drain(
    terrain: Terrain | Raster,
    *,
    depressions: Depressions = "carve",
    max_cut: float | None = None,
    edges: Edges = "open",
    nodata: NoData = "outlet",
) -> Flow:
    """Lead all water out of a terrain, as rivers run.

    - Depressions are filled to where they spill. With "carve" they are first cut open along the course that takes away
      the least height, where a cut of ``max_cut`` is long enough.
    - On slopes water goes to one of the two neighbours beside the steepest descent [Tarboton1997], so that the
      deviations add up to less than a cell along a course [Orlandini2003].
    - Over flats and filled depressions it follows paths of minimum cost to the exits: away from the shores, and through
      the deepest ground.

    So courses have no favourite direction, as those of :func:`route` have: along the eight of the raster.

    Args:
        terrain: The surface, a terrain or a raster of heights in m; it is not changed.
        depressions: "carve" or "fill".
        max_cut: Longest cut in m, ``math.inf`` for any; by default 4 cells or 30 m, whichever is longer.
        edges: What the four sides are, as in :func:`warpriver.hydrology.fill_depressions`.
        nodata: Cells without data are an "outlet" for their neighbours, or a "wall".

    Returns:
        The flow over the opened surface, on which lakes are level. Its ``water`` tells where they are: flats five cells
        wide or wider. One at an open side at a height of 0 or below is the sea.

    Raises:
        ValueError: Depressions opened in another way, a cut below 0 or where nothing is carved, and as :func:`route`.
        MemoryError: Too little memory, told before anything is allocated.
    """
    one_of(depressions, "depressions", ("carve", "fill"))
    if max_cut is not None and depressions == "fill":
        raise InputError("max_cut is for depressions='carve'")
    ground = surface_of(terrain)
    cut = 0.0
    if depressions == "carve":
        cut = max(CUT_CELLS * ground.cell_size, CUT_LENGTH) if max_cut is None else limit_in_m(max_cut, "max_cut")
    surface, bed = _open(ground, cut, edges, nodata)
    cells = pad_terrain(surface, edges, nodata, 0)
    receiver = _lead_downhill(cells)
    water = lead_over_flats(cells, bed, receiver)
    return Flow.of(surface, receiver, edges, nodata, water)


def _open(ground: Terrain, cut: float, edges: Edges, nodata: NoData) -> tuple[Terrain, NDArray[np.float64]]:
    """Carve by cuts of a length in m and fill, level: the surface, and the height of its ground."""
    cells = pad_terrain(ground, edges, nodata, DRAIN_BYTES)
    if cut > 0.0:
        carve_cells(cells, math.inf, cut / ground.cell_size)
    bed = cells.interior(cells.height)
    fill_cells(cells, False)
    return with_heights(ground, cells), bed


def _lead_downhill(cells: PaddedCells) -> NDArray[np.int32]:
    """Receiver of each cell beside its steepest descent, (rows, columns); its own at outlets and on flats."""
    kernel, state, count = kernels.build(wp.float64), flat(cells.state), cells.count
    side, crossing = np.full(count, kernels.NO_SIDE, np.uint8), np.empty(count)
    inputs = [cells.stride, flat(cells.height), state]
    wp.launch(kernel.measure_descents, cells.rows, inputs, [flat(side), flat(crossing)], device="cpu")
    receiver = np.arange(cells.rows * cells.columns, dtype=np.int32).reshape(cells.rows, cells.columns)
    receiver[np.isnan(cells.height[1:-1, 1:-1])] = -1
    gathered, largest = np.ones(count, np.int32), np.zeros(count, np.int32)
    donors, stack, drift = np.zeros(count, np.uint8), np.empty(count, np.int32), np.zeros(count)
    wp.launch(
        kernel.lead_downhill,
        dim=1,
        inputs=[cells.rows, cells.stride, state, flat(side), flat(crossing)],
        outputs=[*(flat(a) for a in (donors, stack, gathered, largest, drift)), table(receiver)],
        device="cpu",
    )
    return receiver
