"""Terrain that rain erodes: the starts of Leheny's model, and what it leaves, with the account of what has happened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.device import require_memory
from warpriver.hydrology.cells import NoData, side_rules
from warpriver.hydrology.routing import Flow, route
from warpriver.params import LehenyParams
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import grid_shape, positive

__all__ = ["ErodedTerrain", "erosion_peak", "erosion_plane"]

# Edges of the page's plane: water leaves in the south, the north is a wall, east and west are joined.
PLANE_EDGES = {"north": "closed", "south": "open", "east": "periodic", "west": "periodic"}
# Bytes a cell while a start is made.
START_BYTES = 34


class ErodedTerrain(Terrain):
    """A terrain with the account of the rain that has eroded it: it may be eroded on, and routed as water went.

    It is a kind of terrain, rather than a noun beside it, so that all that takes a terrain takes it.

    Attributes:
        edges: Rules of the sides, by their names, as in :func:`warpriver.hydrology.fill_depressions`.
        nodata: Rule for cells without data.
        params: Constants that it was eroded with.
        base_level: Height in m that no cell was lowered below; None without one.
        events: Units of rain so far.
        visits: Cells that they visited, each counted as often as it was; D times this is what water took.
        slides: Slides of one cell.
        volume_removed: m3 that are gone: by water, and by slides.
        snapshots: Requested earlier states, on the same device; each an ErodedTerrain without snapshots.
    """

    edges: dict[str, Any]
    nodata: NoData
    params: LehenyParams
    base_level: float | None
    events: int
    visits: int
    slides: int
    volume_removed: float
    snapshots: tuple[ErodedTerrain, ...]

    @classmethod
    def with_account(
        cls,
        terrain: Terrain,
        height: DeviceArray,
        edges: Mapping[str, Any],
        nodata: NoData,
        params: LehenyParams,
        account: tuple[int, int, int, float] = (0, 0, 0, 0.0),
        *,
        base_level: float | None = None,
    ) -> ErodedTerrain:
        """Wrap device heights that lie where a terrain does, without a copy or a check."""
        eroded = cls.__new__(cls)
        eroded.raster = Terrain.wrap(height, terrain.cell_size, terrain.origin, terrain.crs).raster
        eroded.edges, eroded.nodata, eroded.params = dict(edges), nodata, params
        eroded.base_level = base_level
        eroded.events, eroded.visits, eroded.slides, eroded.volume_removed = account
        eroded.snapshots = ()
        return eroded

    @property
    def account(self) -> tuple[int, int, int, float]:
        """What has happened so far: events, visits, slides, and the volume removed in m3."""
        return self.events, self.visits, self.slides, self.volume_removed

    def copy(self) -> ErodedTerrain:
        """Return a copy on the same device, with its account and without snapshots."""
        return self.to(self.device)

    def to(self, device: wp.DeviceLike) -> ErodedTerrain:
        """Return a copy on another device, with its account and without snapshots."""
        moved = super().to(device)
        return ErodedTerrain.with_account(
            moved, moved.height, self.edges, self.nodata, self.params, self.account, base_level=self.base_level
        )

    def flow(self, seed: int = 0) -> Flow:
        """Route water by steepest descent over it, as rivers are identified: among its neighbours, ties by chance.

        Give it to ``warpriver.extract_network(eroded, flow=eroded.flow(), min_drainage_area=R * cell_size**2)``.

        Args:
            seed: Of the choice between equal slopes.
        """
        return route(
            self,
            edges=self.edges,
            nodata=self.nodata,
            neighbors=8 if self.params.neighbors == 8 else 4,
            ties="hash",
            seed=seed,
        )

    def __repr__(self) -> str:
        rows, columns = self.shape
        return (
            f"ErodedTerrain({rows} x {columns} cells of {self.cell_size:g} m, {self.events} events, "
            f"{self.slides} slides, {self.volume_removed:.4g} m3 removed)"
        )


@public
def erosion_plane(
    shape: Sequence[int] = (200, 300), cell_size: float = 1.0, slope: float = 1.0, *, device: wp.DeviceLike = "cpu"
) -> ErodedTerrain:
    """Plane that falls south with a constant slope, its east and west sides joined: the page's start [Leheny1995].

    Only the south side is open. With the defaults a cell's height is its row number from the south.

    Args:
        shape: Rows and columns.
        cell_size: m.
        slope: m/m, above 0.
        device: Warp device name.
    """
    rows, columns = _checked_start(shape, slope)
    height = np.repeat((slope * cell_size * np.arange(rows)[::-1])[:, None], columns, axis=1)
    terrain = Terrain(height, cell_size, (0.0, rows * cell_size), device=device)
    return ErodedTerrain.with_account(terrain, terrain.height, PLANE_EDGES, "outlet", LehenyParams())


@public
def erosion_peak(
    shape: Sequence[int] = (201, 201), cell_size: float = 1.0, slope: float = 1.0, *, device: wp.DeviceLike = "cpu"
) -> ErodedTerrain:
    """Cone that falls from the middle of the raster to all sides, which are open.

    The model knows the grid: along its eight directions water gathers less than between them, and rivers form a star.

    Args:
        shape: Rows and columns.
        cell_size: m.
        slope: m/m, above 0.
        device: Warp device name.
    """
    rows, columns = _checked_start(shape, slope)
    y, x = np.arange(rows)[:, None] - 0.5 * (rows - 1), np.arange(columns)[None, :] - 0.5 * (columns - 1)
    far = np.hypot(x, y)
    terrain = Terrain(slope * cell_size * (far.max() - far), cell_size, (0.0, rows * cell_size), device=device)
    return ErodedTerrain.with_account(terrain, terrain.height, side_rules("open"), "outlet", LehenyParams())


def _checked_start(shape: Sequence[int], slope: float) -> tuple[int, int]:
    """Rows and columns; raises ``ValueError`` unless there are two of each and the ground slopes."""
    rows, columns = grid_shape(shape)
    positive(slope, "slope", hint=": on level ground water goes nowhere")
    require_memory((rows, columns), START_BYTES)
    return rows, columns
