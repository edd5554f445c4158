"""The ground of a 3-D preview where a terrain is given: its surface, level across the channels that lie on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain
from warpriver.viz.bands import Window, refine_lines, select_inside
from warpriver.viz.relief import height_grid, relief_picture
from warpriver.viz.sheet import GROUND, color_ramp

__all__ = ["LIT_STRENGTH", "TerrainGround", "clip_window"]

# Maximum of cells that are drawn, and to which a coarser terrain is refined, for so many across the narrowest channel.
MAX_CELLS, REFINED_CELLS, CELLS_ACROSS = 1_000_000, 300_000, 4.0
# Strength of the shades in the picture on a surface that lamps shade as well; fraction of the light from everywhere.
LIT_STRENGTH, AMBIENT = 0.45, 0.3
# Ribbons lie above the surface by this fraction of a cell.
LIFT = 0.25
# Relief over the block's length that the heights are exaggerated to, and the limits of that.
RELIEF_PART, EXAGGERATION = 0.08, (1.0, 8.0)


def clip_window(window: Window, bounds: Window) -> Window:
    """Return the piece of a window that lies within bounds, (west, south, east, north) in m; they overlap."""
    west, south = (max(window[k], bounds[k]) for k in (0, 1))
    east, north = (min(window[k], bounds[k]) for k in (2, 3))
    if not (west < east and south < north):
        raise InputError(f"window {tuple(window)} m and terrain {tuple(bounds)} m only touch")
    return west, south, east, north


class TerrainGround:
    """A terrain's surface in a window, resampled to at most a million cells.

    Attributes:
        window: (west, south, east, north) in m.
        origin: (2,) middle of the window in m.
        exaggeration: Factor on heights.
        depth: Greatest depth of a channel in m.
        drop: How far the drawn surface reaches below the lowest ground, 0.
        ambient: Fraction of the light that comes from everywhere.
        top: Height of the highest ground above the lowest in m, exaggerated.
    """

    def __init__(self, window: Window, network: RiverNetwork, terrain: Terrain, exaggeration: float | None):
        """Resample a terrain and level it across the channels.

        Args:
            window: (west, south, east, north) in m, within the terrain.
            network: The channels.
            terrain: The ground.
            exaggeration: Factor on heights, or None for one that suits the relief.
        """
        west, south, east, north = window
        self.window, self._terrain, self.ambient = window, terrain, AMBIENT
        self.origin = np.array([0.5 * (west + east), 0.5 * (south + north)])
        self.drop, self.depth = 0.0, float(np.max(network.channel_depth))
        width, length = east - west, north - south
        fine = max(float(np.min(network.channel_width)) / CELLS_ACROSS, np.sqrt(width * length / REFINED_CELLS))
        cell = max(min(float(terrain.cell_size), fine), np.sqrt(width * length / MAX_CELLS))
        shape = max(2, int(length / cell)), max(2, int(width / cell))
        # Vertices stand on the window's edge: they are centres of cells of a grid half a cell larger.
        self._cell = np.array([width / (shape[1] - 1), length / (shape[0] - 1)])
        half = 0.5 * self._cell
        rim = (west - half[0], south - half[1], east + half[0], north + half[1])
        height, known = height_grid(terrain, rim, shape)
        self._height = height[::-1].copy()
        lines, widths = select_inside(network.polylines(close=True), network.point_widths(close=True), window)
        if lines:
            self._level(lines, widths)
        low, high = (self._height[known[::-1]].min(), self._height[known[::-1]].max()) if known.any() else (0.0, 0.0)
        if exaggeration is None:
            exaggeration = float(np.clip(RELIEF_PART * max(width, length) / max(high - low, 1e-9), *EXAGGERATION))
        self.exaggeration = float(exaggeration)
        self._height = self.exaggeration * (np.maximum(self._height, low) - low)
        self.top = float(self._height.max())

    def _level(self, lines: Sequence[np.ndarray], widths: Sequence[np.ndarray]) -> None:
        """Give cells within a channel's width the height of its middle, and blend the next half width into it."""
        with IMPORTING:
            from scipy.spatial import cKDTree

        cell = float(self._cell.max())
        seen = [(xy, w) for xy, w in zip(lines, widths, strict=True) if w.max() > 1.5 * cell]
        if not seen:
            return
        refined, width = refine_lines([xy for xy, _ in seen], [w for _, w in seen], step=0.5 * cell)
        middle, half = np.concatenate(refined), 0.5 * np.concatenate(width)
        x, y, _ = self.grid()
        xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        reach = 2.0 * float(half.max()) + cell
        distance, nearest = cKDTree(middle).query(xy, distance_upper_bound=reach)
        near = np.flatnonzero(np.isfinite(distance))
        level, half = self.height(middle)[nearest[near]], half[nearest[near]]
        fraction = np.clip((distance[near] - half - cell) / half, 0.0, 1.0)
        fraction = fraction * fraction * (3.0 - 2.0 * fraction)
        flat = self._height.ravel()
        flat[near] = level + fraction * (flat[near] - level)

    def grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x (nx,), y (ny,) in absolute m and the height (ny, nx) in m, row 0 in the south."""
        west, south, east, north = self.window
        rows, columns = self._height.shape
        return np.linspace(west, east, columns), np.linspace(south, north, rows), self._height

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Return the height in m of the drawn surface at (n, 2) absolute positions; that of the edge beyond it."""
        with IMPORTING:
            from scipy.ndimage import map_coordinates

        at = (np.asarray(xy) - np.array(self.window[:2])) / self._cell
        height: np.ndarray = map_coordinates(self._height, [at[:, 1], at[:, 0]], order=1, mode="nearest")
        return height

    def water_level(self, xy: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Return the height of the water at the (2 P, 2) banks of channels with that many points each."""
        return self.height(xy) + LIFT * float(self._cell.min())

    def drape(
        self, lines: Sequence[np.ndarray], widths: Sequence[np.ndarray], smallest: float
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Refine lines so that ribbons along them follow the surface, and widen those below ``smallest`` m."""
        wide = [np.maximum(width, smallest) for width in widths]
        return refine_lines(lines, wide, step=0.5 * float(self._cell.min()))

    def picture(self, shape: tuple[int, int]) -> np.ndarray:
        """Return the relief for the surface's colour, (rows, columns, 3) uint8, plain where there is no data."""
        relief = relief_picture(self._terrain, self.window, shape, strength=LIT_STRENGTH)
        relief.color[~relief.known] = 255.0 * color_ramp(((0.0, GROUND),), 0.0)
        color: np.ndarray = np.clip(relief.color, 0.0, 255.0).astype(np.uint8)
        return color
