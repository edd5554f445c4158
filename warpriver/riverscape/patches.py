"""Patches of ground and water for a view: fine where it is near, coarse far away, without cracks between them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from warpriver.arrays import FloatArray, IndexArray

if TYPE_CHECKING:
    from warpriver.riverscape.scene import Riverscape

__all__ = ["CELLS", "Patch", "counted", "lay_patches"]


# Cells along the side of a patch [Peytavie2019, Sec. 7.1], and how many of them a step of a patch's mesh may be long.
CELLS = 10
STEPS = (1, 2, 5, 10)


@dataclasses.dataclass(frozen=True, eq=False)
class Patch:
    """A square of 10 x 10 cells of ground and water, as a mesh of steps of 1, 2, 5 or 10 cells.

    Attributes:
        row, column: Of the patch, from the south-west corner of all.
        step: Cells that a step of the mesh is long.
        points: (n, 3) corners of the steps, m, row by row from the south-west: x, y and the bed.
        water: (n,) elevation of the water, m; NaN where there is none.
        velocity: (n, 2) of the water, m/s.
        effervescence: (n,) white water, 0 to 1.
        triangles: (m, 3) points of each, counter-clockwise seen from above.
    """

    row: int
    column: int
    step: int
    points: FloatArray
    water: FloatArray
    velocity: FloatArray
    effervescence: FloatArray
    triangles: IndexArray


def lay_patches(
    scene: Riverscape,
    eye: tuple[float, float, float],
    *,
    origin: tuple[float, float],
    shape: tuple[int, int],
    cell_size: float,
    angle: float,
    time: float,
    heading: float | None,
    field: float,
) -> list[Patch]:
    """Lay patches for a view; see :meth:`Riverscape.patches`.

    Args:
        scene: The riverscape.
        eye: (x, y, z) m.
        origin: South-west corner, m.
        shape: Rows and columns of patches.
        cell_size: m.
        angle: That a step may be seen under, rad.
        time: s.
        heading: Direction of view, rad, or None: all around.
        field: Angle of view, rad.
    """
    rows, columns = shape
    side = CELLS * cell_size
    row, column = np.divmod(np.arange(rows * columns), columns)
    middle = np.column_stack([origin[0] + (column + 0.5) * side, origin[1] + (row + 0.5) * side])
    ground = scene.bed(middle, rocks=False)
    up = np.where(np.isfinite(ground), ground, np.nanmean(ground) if np.isfinite(ground).any() else 0.0) - eye[2]
    far = np.maximum(np.hypot(*(middle - eye[:2]).T) - side * math.sqrt(0.5), 0.0)
    far = np.hypot(far, up)
    wanted = far * angle / cell_size
    level = np.searchsorted(STEPS, wanted, side="right") - 1
    step = np.asarray(STEPS)[np.maximum(level, 0)]
    seen = np.ones(len(row), bool)
    if heading is not None:
        seen = _in_view(middle, side, eye, heading, field)
    table = step.reshape(rows, columns)
    return _meshes(scene, np.flatnonzero(seen), table, origin, cell_size, time)


def _in_view(
    middle: FloatArray, side: float, eye: tuple[float, float, float], heading: float, field: float
) -> np.ndarray:
    """Patches that reach into the angle of view; those under the eye always."""
    off = middle - eye[:2]
    far = np.hypot(*off.T)
    radius = side * math.sqrt(0.5)
    turn = np.abs(np.angle(np.exp(1j * (np.arctan2(off[:, 1], off[:, 0]) - heading))))
    slack = np.arcsin(np.clip(radius / np.maximum(far, radius), 0.0, 1.0))
    return np.asarray((far <= radius) | (turn <= 0.5 * field + slack))


def _meshes(
    scene: Riverscape,
    chosen: IndexArray,
    table: IndexArray,
    origin: tuple[float, float],
    cell_size: float,
    time: float,
) -> list[Patch]:
    columns = table.shape[1]
    lattice, owners = [], []
    for number in chosen.tolist():
        i, j = divmod(number, columns)
        at = np.arange(0, CELLS + 1, table[i, j])
        v, u = np.meshgrid(at, at, indexing="ij")
        lattice.append(np.column_stack([CELLS * i + v.ravel(), CELLS * j + u.ravel()]))
        owners.append((i, j, len(at)))
    if not lattice:
        return []
    every = np.concatenate(lattice)
    # A corner that several patches share is evaluated once.
    wide = CELLS * columns + 1
    unique, number = np.unique(every[:, 0] * wide + every[:, 1], return_inverse=True)
    at = np.column_stack([origin[0] + cell_size * (unique % wide), origin[1] + cell_size * (unique // wide)])
    bed, water = scene.bed(at), scene.water(at, time)
    elevation = np.where(water.elevation > bed, water.elevation, np.nan)
    values = np.column_stack([bed, elevation, water.velocity, water.effervescence])[number]
    made, first = [], 0
    for (i, j, count), corner in zip(owners, lattice, strict=True):
        part = values[first : first + count * count].reshape(count, count, 5).copy()
        first += count * count
        _close(part, i, j, table)
        flat = part.reshape(-1, 5)
        xy = np.column_stack([origin[0] + cell_size * corner[:, 1], origin[1] + cell_size * corner[:, 0]])
        a = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
        triangles = np.concatenate(
            [np.stack([a, a + 1, a + count + 1], axis=1), np.stack([a, a + count + 1, a + count], axis=1)]
        )
        points = np.column_stack([xy, flat[:, 0]])
        made.append(Patch(i, j, int(table[i, j]), points, flat[:, 1], flat[:, 2:4], flat[:, 4], triangles))
    return made


def _close(part: FloatArray, i: int, j: int, table: IndexArray) -> None:
    """Put the edges of a patch onto the straight lines between the corners that it shares with its neighbour.

    These are the least common multiple of both steps apart: the same ones on both sides, whatever the steps.
    """
    rows, columns = table.shape
    own = int(table[i, j])
    edges = {
        (i - 1, j): part[0], (i + 1, j): part[-1], (i, j - 1): part[:, 0], (i, j + 1): part[:, -1],
    }  # fmt: skip
    at = np.arange(0, CELLS + 1, own)
    for (row, column), edge in edges.items():
        if not (0 <= row < rows and 0 <= column < columns):
            continue
        apart = math.lcm(own, int(table[row, column]))
        if apart > own:
            shared = np.arange(0, CELLS + 1, apart)
            kept = edge[shared // own].copy()
            k = np.minimum(at // apart, len(shared) - 2)
            t = ((at - k * apart) / apart)[:, None]
            mixed = (1.0 - t) * kept[k] + t * kept[k + 1]
            edge[:] = np.where((at % apart == 0)[:, None], edge, mixed)


def counted(bounds: Sequence[float], cell_size: float) -> tuple[int, int]:
    """Return rows and columns of patches that cover bounds, whole ones from the south-west corner on."""
    west, south, east, north = bounds
    side = CELLS * cell_size
    return math.ceil((north - south) / side - 1e-9), math.ceil((east - west) / side - 1e-9)
