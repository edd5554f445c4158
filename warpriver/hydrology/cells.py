"""The padded copy of a terrain that water is led over: which cells are walls, ghosts and outlets."""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.device import launch_kernel, require_memory
from warpriver.errors import InputError
from warpriver.kernels import cells as kernels
from warpriver.terrain import Terrain
from warpriver.validate import one_of, shown

__all__ = ["Edges", "NoData", "PaddedCells", "flat", "pad_terrain", "side_rules", "table"]

Rule = Literal["open", "closed", "periodic"]
Edges = Rule | Mapping[str, Rule] | tuple[Rule, Rule, Rule, Rule]
NoData = Literal["outlet", "wall"]

SIDES = ("north", "south", "east", "west")
RULES = ("open", "closed", "periodic")
# Height and state in the padded arrays, and the scratch for outlets.
PADDED_BYTES = 12

log = logging.getLogger("warpriver")


@dataclass(frozen=True)
class PaddedCells:
    """Heights and states of a terrain's cells on the host's device, padded by a cell on every side.

    Attributes:
        rows: Rows of the terrain.
        columns: Columns of the terrain.
        height: (rows + 2, columns + 2) float64, m; NaN in walls and where there is no data.
        state: (rows + 2, columns + 2) uint8: OPEN, DONE (a wall), GHOST or OUTLET of ``kernels/cells.py``.
        landlocked: (n,) flat indices of the outlets made for pieces of ground that have no other.
    """

    rows: int
    columns: int
    height: np.ndarray
    state: np.ndarray
    landlocked: np.ndarray

    @property
    def stride(self) -> int:
        """Cells in a padded row."""
        return self.columns + 2

    @property
    def count(self) -> int:
        """Cells with the padding."""
        return self.height.size

    def interior(self, padded: np.ndarray) -> np.ndarray:
        """Copy the terrain's own cells out of a padded array."""
        inside: np.ndarray = padded.reshape(self.height.shape)[1:-1, 1:-1].copy()
        return inside

    def around(self, index: np.ndarray) -> np.ndarray:
        """Flat indices of the padded cells around some, (8 n,); across periodic sides those at the far side."""
        step = np.array([-1, 0, 1])
        near = (step[:, None] * self.stride + step).reshape(-1)
        found = (np.asarray(index)[:, None] + near[near != 0]).reshape(-1)
        row, column = np.divmod(found, self.stride)
        real = ((row - 1) % self.rows + 1) * self.stride + (column - 1) % self.columns + 1
        around: np.ndarray = np.where(self.state.reshape(-1)[found] == kernels.GHOST, real, found)
        return around

    def outlets(self) -> np.ndarray:
        """Which of the terrain's own cells water leaves at, (rows, columns) bool."""
        outlets: np.ndarray = self.interior(self.state) == kernels.OUTLET
        return outlets


def pad_terrain(terrain: Terrain, edges: Edges, nodata: NoData, scratch_bytes: int) -> PaddedCells:
    """Copy a terrain to the host with its padding, and find its outlets.

    Args:
        terrain: The surface.
        edges: "open": water leaves at the side's cells; "closed": a wall; "periodic": opposite sides are joined. One
            word for all sides, four in the order north, south, east, west, or a mapping by those names.
        nodata: "outlet": water leaves at cells beside one without data; "wall": it does not.
        scratch_bytes: Bytes a cell that the caller will need besides.

    Raises:
        ValueError: An unknown rule, a periodic side without its opposite, or more than 2^31 cells.
        MemoryError: Too little memory for the copy and the scratch.
    """
    rules = side_rules(edges)
    one_of(nodata, "nodata", ("outlet", "wall"))
    rows, columns = terrain.shape
    shape = (rows + 2, columns + 2)
    require_memory(shape, PADDED_BYTES + scratch_bytes, "cpu", "routing a terrain")
    if shape[0] * shape[1] >= 2**31:
        raise InputError(
            f"the terrain has {rows} x {columns} cells; 2^31 is the limit, route it tile by tile or at coarser cells"
        )
    if terrain.device.is_cuda:
        _say_where()
    wraps = rules["north"] == "periodic", rules["east"] == "periodic"
    height = _padded(terrain.height.numpy(), np.nan, wraps)
    gap = np.isnan(height[1:-1, 1:-1])
    state = np.full(shape, kernels.DONE, np.uint8)
    if wraps[0]:
        state[[0, -1], 1:-1] = kernels.GHOST
    if wraps[1]:
        state[1:-1, [0, -1]] = kernels.GHOST
    if all(wraps):
        state[[0, 0, -1, -1], [0, -1, 0, -1]] = kernels.GHOST
    outlet = _beside(_padded(gap, False, wraps)) if nodata == "outlet" and gap.any() else np.zeros_like(gap)
    for side, line in zip(SIDES, (outlet[0], outlet[-1], outlet[:, -1], outlet[:, 0]), strict=True):
        line |= rules[side] == "open"
    outlet &= ~gap
    inside = state[1:-1, 1:-1]
    inside[~gap] = kernels.OPEN
    inside[outlet] = kernels.OUTLET
    cells = PaddedCells(rows, columns, height, state, np.zeros(0, np.int64))
    # Ground may be cut off from every outlet only if there is none, or behind walls within the terrain.
    if not outlet.any() or (nodata == "wall" and gap.any()):
        return _drain_landlocked(cells)
    return cells


def side_rules(edges: Edges) -> dict[str, str]:
    """Return the rule of each side, or raise ``ValueError``."""
    hint = f"use {', '.join(map(repr, RULES))}, or one for each of {', '.join(SIDES)}"
    if isinstance(edges, str):
        rules: dict[str, str] = dict.fromkeys(SIDES, edges)
    elif isinstance(edges, Mapping):
        rules = dict(edges)
    elif isinstance(edges, (tuple, list)) and len(edges) == len(SIDES):
        rules = dict(zip(SIDES, edges, strict=True))
    else:
        raise InputError(f"edges is {shown(edges)}; {hint}")
    if set(rules) != set(SIDES) or not all(rule in RULES for rule in rules.values()):
        raise InputError(f"edges is {shown(edges)}; {hint}")
    for a, b in (("north", "south"), ("east", "west")):
        if (rules[a] == "periodic") != (rules[b] == "periodic"):
            raise InputError(f"edges: {a} is {rules[a]!r} and {b} is {rules[b]!r}; periodic sides come in pairs")
    return rules


def _padded(values: np.ndarray, fill: float, wraps: tuple[bool, bool]) -> np.ndarray:
    """Copy with a row and column more on every side, from the far side where the raster wraps across rows, columns."""
    padded = np.full((values.shape[0] + 2, values.shape[1] + 2), fill, values.dtype)
    padded[1:-1, 1:-1] = values
    if wraps[0]:
        padded[0], padded[-1] = padded[-2].copy(), padded[1].copy()
    if wraps[1]:
        padded[:, 0], padded[:, -1] = padded[:, -2].copy(), padded[:, 1].copy()
    return padded


def _beside(padded: np.ndarray) -> np.ndarray:
    """Cells that are marked or have a marked one among their eight neighbours."""
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    marks: np.ndarray = rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]
    return marks


def _drain_landlocked(cells: PaddedCells) -> PaddedCells:
    """Let every piece of ground without an outlet drain to its lowest cell."""
    count: DeviceArray = wp.zeros(1, dtype=int, device="cpu")
    given = cells.state.copy()
    launch_kernel(
        kernels.build(wp.float64).drain_landlocked,
        dim=1,
        inputs=[cells.rows, cells.stride, flat(cells.height)],
        outputs=[count, flat(cells.state), flat(given.copy()), wp.empty(cells.count, dtype=int, device="cpu")],
        device="cpu",
    )
    if found := int(count.numpy()[0]):
        log.info("%d piece(s) of ground have no outlet; each drains to its lowest cell", found)
    return replace(cells, landlocked=np.flatnonzero(cells.state != given))


def flat(array: np.ndarray) -> DeviceArray:
    """View a contiguous host array as a flat array of Warp's CPU device."""
    kinds = {np.dtype(np.float64): wp.float64, np.dtype(np.uint8): wp.uint8, np.dtype(np.int32): wp.int32}
    return wp.array(array.reshape(-1), dtype=kinds[array.dtype], device="cpu", copy=False)


def table(array: np.ndarray) -> DeviceArray:
    """View a host array as a two-dimensional array of Warp's CPU device."""
    grid: DeviceArray = flat(array).reshape(array.shape)
    return grid


@functools.cache
def _say_where() -> None:
    """Say once that routing has left the GPU."""
    log.info("hydrology runs on the CPU device for now: the terrain is copied there and its results back")
