"""Depressions: filled until they spill, or opened by carving a course out of them."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
import warp as wp

from warpriver.arrays import ByteArray, DeviceArray
from warpriver.device import launch_kernel
from warpriver.errors import InputError
from warpriver.hydrology.cells import Edges, NoData, PaddedCells, flat, pad_terrain, table
from warpriver.kernels import depressions as kernels
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import NAME, UNIT, Terrain, surface_of

__all__ = [
    "carve_cells",
    "carve_depressions",
    "fill_cells",
    "fill_depressions",
    "limit_in_m",
    "mark_pits",
    "with_heights",
]

Surface = TypeVar("Surface", Terrain, Raster)

# Scratch and result in bytes a cell, besides the padded copy.
FILL_BYTES, CARVE_BYTES = 29, 49
# What a search for courses notes by cell, and its heap.
CARVE_NOTES = {"cell_from": int, "cell_length": wp.float64, "cell_mark": int, "heap_key": wp.float64, "heap_cell": int}
# Rims of depressions wait in as many buckets by height; about every second cell of rough ground is one for a time.
CELLS_PER_BUCKET = 4
# In m: terrain with less relief has a single bucket.
MIN_RELIEF = 1e-200


@public
def fill_depressions(
    terrain: Surface, *, epsilon: bool = True, edges: Edges = "open", nodata: NoData = "outlet"
) -> Surface:
    """Raise every cell from which water cannot leave until it can [Barnes2014].

    The result is the lowest surface W >= z with W = max(z, s(lowest W among the eight neighbours)) in every cell but
    the outlets, which keep their height. With ``epsilon`` s(h) is the next float64 number above h, at least
    h + 2^-52 m: every cell then has a lower neighbour, flats included, and water drains over it, straight towards the
    outlet (:func:`warpriver.hydrology.route` fills and leads it through the deepest ground instead). Without it
    s(h) = h: depressions become flats. That surface is unique, so the order in which cells of equal height are dealt
    with does not matter; nothing is lowered, and filling a filled terrain changes nothing.

    Args:
        terrain: The surface, a terrain or a raster of heights in m; it is not changed.
        epsilon: Whether filled ground keeps a minimum slope towards its outlet. Heights stored as float32 lose it.
        edges: What the four sides are, "open" (water leaves at their cells), "closed" (a wall) or "periodic" (joined to
            the opposite side): one word, four in the order north, south, east, west, or a mapping by those names.
        nodata: Cells without data are an "outlet" for their neighbours, or a "wall".

    Returns:
        The filled surface, a terrain or a raster as was given, on the same device. Ground that has no outlet drains to
        its lowest cell, which keeps its height.

    Raises:
        ValueError: No surface, an unknown edge rule, a periodic side without its opposite, or more than 2^31 cells.
        MemoryError: Too little memory, told before anything is allocated.
    """
    cells = pad_terrain(surface_of(terrain), edges, nodata, FILL_BYTES)
    fill_cells(cells, epsilon)
    return with_heights(terrain, cells)


@public
def carve_depressions(
    terrain: Surface,
    *,
    edges: Edges = "open",
    nodata: NoData = "outlet",
    max_depth: float | None = None,
    max_length: float | None = None,
) -> Surface:
    """Cut a course out of every depression where that takes away the least height, and fill what cannot be cut.

    Pits are opened one after another, the lowest first, at equal height the first in the raster. From the pit's cells
    the cheapest course to lower ground, to drained ground of the same height, or to an outlet is searched, where a cell
    costs the height by which it exceeds the pit, summed over the course (plus 2^-20 m a cell of length, which decides
    between courses that cut the same). Cells on it are lowered to a line that falls from the pit by 2^-50 of its height
    a cell, or is level. At last the terrain is filled with epsilon, so that no pit and no flat is left. The result lies
    nowhere above :func:`fill_depressions`.

    Args:
        terrain: The surface, a terrain or a raster of heights in m; it is not changed.
        edges: As in :func:`fill_depressions`.
        nodata: As in :func:`fill_depressions`.
        max_depth: Maximum cut in a cell in m; None for any.
        max_length: Maximum length of a course in m; None for any. A limit also bounds the time of the search.

    Returns:
        The carved surface, a terrain or a raster as was given, on the same device.

    Raises:
        ValueError: A limit below 0, and as :func:`fill_depressions`.
        MemoryError: Too little memory, told before anything is allocated.
    """
    depth, length = limit_in_m(max_depth, "max_depth"), limit_in_m(max_length, "max_length")
    cells = pad_terrain(surface_of(terrain), edges, nodata, CARVE_BYTES)
    carve_cells(cells, depth, length / terrain.cell_size)
    fill_cells(cells, True)
    return with_heights(terrain, cells)


def fill_cells(cells: PaddedCells, epsilon: bool) -> None:
    """Fill the heights in place; the states and the ghosts among the heights get stale."""
    kernel, count = kernels.build(wp.float64), cells.count
    lowest, highest = float(np.fmin.reduce(cells.height, axis=None)), float(np.fmax.reduce(cells.height, axis=None))
    buckets = count // CELLS_PER_BUCKET + 1
    flood = kernel.Flood()
    flood.rows, flood.stride, flood.epsilon, flood.lowest = cells.rows, cells.stride, int(epsilon), lowest
    flood.buckets_per_meter = buckets / max(highest - lowest, MIN_RELIEF)

    def whole_numbers(size: int) -> DeviceArray:
        return wp.empty(size, dtype=int, device="cpu")

    rims = kernel.Rims()
    rims.next, rims.bucket, rims.count = whole_numbers(count), whole_numbers(buckets), whole_numbers(3)
    rims.heap_key, rims.heap_cell = wp.empty(count, dtype=wp.float64, device="cpu"), whole_numbers(count)
    launch_kernel(
        kernel.flood_cells,
        dim=1,
        inputs=[flood],
        outputs=[whole_numbers(1), flat(cells.height), flat(cells.state), whole_numbers(count), rims],
        device="cpu",
    )


def mark_pits(cells: PaddedCells) -> ByteArray:
    """Mark the padded cells that are no outlets and have no lower neighbour, not 0."""
    pit = np.zeros(cells.count, np.uint8)
    inputs = [cells.stride, flat(cells.height), flat(cells.state)]
    launch_kernel(kernels.build(wp.float64).find_pits, cells.rows, inputs, [flat(pit)], device="cpu")
    return pit


def carve_cells(cells: PaddedCells, max_depth: float, max_length: float) -> None:
    """Carve courses into the heights in place; lengths are in cells."""
    kernel = kernels.build(wp.float64)
    height, state, count = flat(cells.height), flat(cells.state), cells.count
    pit = mark_pits(cells)
    pit_cell = np.flatnonzero(pit).astype(np.int32)
    if not len(pit_cell):
        return
    pit_cell = pit_cell[np.argsort(cells.height.reshape(-1)[pit_cell], kind="stable")]
    carving = kernel.Carving()
    carving.rows, carving.stride, carving.max_depth, carving.max_length = (
        cells.rows,
        cells.stride,
        max_depth,
        max_length,
    )
    for field, kind in CARVE_NOTES.items():
        setattr(carving, field, wp.empty(count, dtype=kind, device="cpu"))
    launch_kernel(
        kernel.carve_pits,
        dim=1,
        inputs=[flat(pit_cell), state],
        outputs=[wp.empty(1, dtype=int, device="cpu"), height, flat(pit), carving],
        device="cpu",
    )


def limit_in_m(value: float | None, name: str) -> float:
    """Return a limit as a number, or raise ``ValueError``."""
    if value is None:
        return math.inf
    if not float(value) >= 0.0:
        raise InputError(f"{name} is {value}; give m, 0 or more, or None for no limit")
    return float(value)


def with_heights(surface: Surface, cells: PaddedCells) -> Surface:
    """Return the heights as what the surface is, on its device."""
    height = table(cells.interior(cells.height))
    if isinstance(surface, Raster):
        return surface.like(height, unit=surface.unit, name=surface.name)
    return Terrain.wrap_raster(surface.raster.like(height, unit=UNIT, name=NAME))
