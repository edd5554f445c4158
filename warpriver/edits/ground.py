"""Edits of the ground: what they do, and which cells they may change."""

from __future__ import annotations

import numpy as np

from warpriver.edits.values import EditTerrain
from warpriver.terrain import Terrain

__all__ = ["edit_terrain", "edited_box", "terrain_window"]


def edit_terrain(terrain: Terrain, edit: EditTerrain) -> None:
    """Do an edit of the ground."""
    if edit.operation == "ridge":
        terrain.add_ridge(edit.line, edit.height, edit.width)  # type: ignore[arg-type]
    else:
        terrain.brush(edit.operation, edit.center, edit.radius, edit.amount, level=edit.level)  # type: ignore[arg-type]


def edited_box(edit: EditTerrain) -> tuple[np.ndarray, np.ndarray]:
    """Return the south-west and the north-east corner of what an edit of the ground may change, m."""
    if edit.operation == "ridge":
        line, half = np.asarray(edit.line), 0.5 * (edit.width or 0.0)
    else:
        line, half = np.asarray([edit.center]), edit.radius or 0.0
    return line.min(axis=0) - half, line.max(axis=0) + half


def terrain_window(terrain: Terrain, edit: EditTerrain) -> tuple[int, int, int, int] | None:
    """Return the cells that an edit of the ground may change, as ``Raster.window``; None if there are none."""
    (west, south), (east, north) = edited_box(edit)
    return terrain.raster.window(west, south, east, north)
