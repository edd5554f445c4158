"""What a file says of its cells, before any of it is checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from warpriver.errors import warn
from warpriver.sentinels import equal_cells, find_sentinels, listed

__all__ = ["RasterSource", "cells_without_data", "north_up", "with_gaps"]


@dataclasses.dataclass
class RasterSource:
    """The cells of one file as it has them; None for what the file does not say.

    Attributes:
        path: The file, or the name of what was read, for messages.
        values: (rows, columns) float64, NaN without data; or whole numbers, where the file has them in every cell.
        affine: (a, b, c, d, e, f): the point j columns and i rows from the first cell's outer corner lies at
            x = a j + b i + c, y = d j + e i + f.
        crs: CRS as the file states it.
        lonlat: Whether the coordinates are longitude and latitude by name.
        units: Unit of the values as the file names it.
        name: What the values are, as the file names them.
        crs_beside: Whether the CRS comes from a file beside it, such as a .prj, which ``crs=`` overrules.
        place_beside: Whether the origin does, which ``origin=`` overrules.
    """

    path: Path
    values: np.ndarray
    affine: tuple[float, ...] | None = None
    crs: str | None = None
    lonlat: bool = False
    units: str | None = None
    name: str | None = None
    crs_beside: bool = False
    place_beside: bool = False

    @property
    def cell(self) -> tuple[float, float]:
        """Lengths of a cell's sides along the columns' and the rows' index."""
        a, b, _, d, e, _ = self.affine or (math.nan,) * 6
        return math.hypot(a, d), math.hypot(b, e)

    @property
    def corner(self) -> tuple[float, float]:
        """Outer corner of the first cell."""
        _, _, c, _, _, f = self.affine or (math.nan,) * 6
        return c, f

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
        rows, columns = self.values.shape
        return bool(max(abs(b) * rows, abs(d) * columns) > 1e-3 * min(self.cell))

    def scale_place(self, factor: float) -> None:
        """Multiply all coordinates by a number, as to turn feet into metres."""
        if self.affine is not None and factor != 1.0:
            self.affine = tuple(factor * v for v in self.affine)

    def put_north_up(self) -> None:
        """Turn a raster whose rows run east or west into one with row 0 in the north and column 0 in the west."""
        a, b, c, d, e, f = self.affine or (math.nan,) * 6
        rows, columns = self.values.shape
        if a < 0.0:
            self.values, a, c = self.values[:, ::-1], -a, c + a * columns
        if e > 0.0:
            self.values, e, f = self.values[::-1], -e, f + e * rows
        self.affine = (a, b, c, d, e, f)


def north_up(west: float, north: float, width: float, length: float) -> tuple[float, ...]:
    """Return the affine numbers of north-up cells ``width`` x ``length`` from their north-west corner."""
    return width, 0.0, west, 0.0, -length, north


def cells_without_data(
    path: Path, values: np.ndarray, gap: np.ndarray, nodata: float | None, *, declared: bool, heights: bool
) -> np.ndarray:
    """Return which cells have no data: those known, those of the caller's value, and what can be nothing else.

    Where neither the file nor the caller says what no data is, heights such as -9999 that stand alone are taken for
    it, with a warning. Where one does, or where values need not be heights, the warning says that they are there.

    Args:
        path: The file, for messages.
        values: Its numbers as they are stored, before scale, offset and unit.
        gap: Cells known to have no data.
        nodata: Value that the caller names; NaN: no further one.
        declared: Whether the file says what no data is.
        heights: Whether the values are heights.
    """
    if nodata is not None:
        found_gap: np.ndarray = gap | equal_cells(values, nodata)
        return found_gap
    found = find_sentinels(values, ~gap)
    if not found:
        return gap
    declared = declared or bool(gap.any()) or (values.dtype.kind == "f" and bool(np.isnan(values).any()))
    text = f"{path}: of its cells {listed(found)}"
    if declared or not heights:
        warn(f"{text}, which may stand for no data; if so, pass nodata={found[0][0]:.9g}")
        return gap
    for value, _ in found:
        gap = gap | equal_cells(values, value)
    warn(
        f"{text}, which nothing in the file explains; they are read as no data. Pass nodata=nan to keep them, or "
        "nodata= with the value that has none"
    )
    return gap


def with_gaps(values: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Return values with NaN in gaps, as float64, edited in place if they are; whole ones stay so without a gap."""
    if values.dtype.kind in "iu" and not gap.any():
        return values
    made = values.astype(np.float64, copy=False)
    made[gap] = np.nan
    return made
