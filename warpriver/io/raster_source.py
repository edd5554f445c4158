"""What a file says of its heights, before any of it is checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

__all__ = ["Raster", "north_up"]


@dataclasses.dataclass
class Raster:
    """The heights of one file as it has them; None for what the file does not say.

    Attributes:
        path: The file, or the name of what was read, for messages.
        height: (rows, columns) float64, NaN without data.
        affine: (a, b, c, d, e, f): the point j columns and i rows from the first cell's outer corner lies at
            x = a j + b i + c, y = d j + e i + f.
        crs: CRS as ``crs_text`` gives it.
        lonlat: Whether the coordinates are longitude and latitude by name.
        units: Unit of the heights as the file names it.
    """

    path: Path
    height: np.ndarray
    affine: tuple[float, ...] | None = None
    crs: str | None = None
    lonlat: bool = False
    units: str | None = None

    @property
    def cell(self) -> tuple[float, float]:
        """Lengths of a cell's sides along the columns' and the rows' index."""
        a, b, _, d, e, _ = self.affine or (math.nan,) * 6
        return math.hypot(a, d), math.hypot(b, e)

    def points(self, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return the (n, 2) points at those numbers of columns and rows from the first cell's outer corner."""
        a, b, c, d, e, f = self.affine or (math.nan,) * 6
        return np.stack([a * columns + b * rows + c, d * columns + e * rows + f], axis=1)

    def to_cells(self) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """Return the function from x, y to (n, 2) numbers of columns and rows, the inverse of ``points``."""
        a, b, c, d, e, f = self.affine or (math.nan,) * 6
        inverse = np.linalg.inv([[a, b], [d, e]])
        return lambda x, y: np.stack([x - c, y - f], axis=1) @ inverse.T

    def is_turned(self) -> bool:
        """Tell whether rows do not run east or west by more than a thousandth of a cell over the whole raster."""
        _, b, _, d, _, _ = self.affine or (math.nan,) * 6
        rows, columns = self.height.shape
        return max(abs(b) * rows, abs(d) * columns) > 1e-3 * min(self.cell)

    def put_north_up(self) -> None:
        """Turn a raster whose rows run east or west into one with row 0 in the north and column 0 in the west."""
        a, b, c, d, e, f = self.affine or (math.nan,) * 6
        rows, columns = self.height.shape
        if a < 0.0:
            self.height, a, c = self.height[:, ::-1], -a, c + a * columns
        if e > 0.0:
            self.height, e, f = self.height[::-1], -e, f + e * rows
        self.affine = (a, b, c, d, e, f)


def north_up(west: float, north: float, width: float, length: float) -> tuple[float, ...]:
    """Return the affine numbers of north-up cells ``width`` x ``length`` from their north-west corner."""
    return width, 0.0, west, 0.0, -length, north
