"""Terrain: a raster of heights on the device; sampling, gradient, slope, brushes, another cell size, a part of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import warp as wp

from warpriver.crs import is_geographic, short_name
from warpriver.kernels import terrain as kernels
from warpriver.network import PRECISIONS, resolve_device

__all__ = ["Terrain", "available_memory", "require_memory", "square_cells"]

BRUSHES = ("raise", "lower", "smooth", "flatten")
# A cell is a whole multiple of another to this part.
WHOLE = 1e-9
# Standard deviation of the Gaussian of the smoothing brush, in radii; its least value in cells; how far it reaches.
SMOOTH_PART, SMOOTH_LEAST, SMOOTH_REACH = 0.125, 0.75, 3.0


def available_memory(device: Any = "cpu") -> int | None:
    """Return the memory in bytes that can be had on a device now, or None where the system does not tell."""
    device = resolve_device(device)
    if device.is_cuda:
        # What has been freed stays in the pool, and counts as taken, until the device has been waited for.
        wp.synchronize_device(device)
        return int(device.free_memory)
    known = []
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        known += [1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
        group = Path("/sys/fs/cgroup")
        limit, used = (group / "memory.max").read_text(), (group / "memory.current").read_text()
        known += [int(limit) - int(used)] if limit.strip() != "max" else []
    except (OSError, ValueError):
        pass
    return min(known, default=None)


def require_memory(shape: Sequence[int], bytes_per_cell: int, device: Any = "cpu", what: str = "a terrain") -> None:
    """Raise ``MemoryError`` if a raster of that shape cannot fit; call it before anything is allocated.

    Args:
        shape: Rows and columns.
        bytes_per_cell: All that will be alive at a time, divided by the cells.
        device: Where it is to lie.
        what: The thing, for the message.
    """
    need, free = math.prod(int(n) for n in shape) * bytes_per_cell, available_memory(device)
    if free is not None and need > free:
        raise MemoryError(
            f"{what} of {shape[0]} x {shape[1]} cells needs {need / 1e9:.3g} GB and {free / 1e9:.3g} GB are free on "
            f"{resolve_device(device).alias}; use a coarser cell size or a part of it"
        )


class Terrain:
    """A raster of heights on square cells, north up, on the device.

    Row 0 is the north edge. The height of a cell belongs to its centre, at (west + (column + 1/2) cell_size,
    north - (row + 1/2) cell_size). NaN is no data. Between centres heights are bilinear. At the outer edge and beside
    cells without data one rule holds: of the four centres around a point the missing ones drop out, so that a height
    goes on unchanged through the outer half cell, and a point whose own cell is missing has height NaN.

    Attributes:
        height: device array (rows, columns) of float64, m; kernels may edit it in place.
        cell_size: Length of a cell's side in m.
        origin: (west, north), the outer corner of the first cell in m.
        crs: Coordinate reference system as text ("EPSG:32619", WKT ...), or None.
        device: Warp device that ``height`` lies on.
    """

    def __init__(
        self,
        height: Any,
        cell_size: float,
        origin: Sequence[float] | np.ndarray = (0.0, 0.0),
        crs: str | None = None,
        *,
        device: Any = "cpu",
    ):
        """Copy heights to the device.

        Args:
            height: (rows, columns) heights in m, row 0 in the north; NaN, or masked, where there is no data.
            cell_size: Length of a cell's side in m.
            origin: (west, north), the outer corner of the first cell in m.
            crs: Coordinate reference system; geographic ones are refused, since x and y are metres here.
            device: Warp device name, "cpu" or "cuda:0".

        Raises:
            ValueError: Fewer than 2 x 2 cells, not two dimensions, no data at all, an infinite height, a cell size or
                an origin that is no length, a CRS in degrees, or an unknown device.
            MemoryError: There is no room for it on the device.
        """
        self.device = resolve_device(device)
        self.cell_size, self.origin = _checked_grid(cell_size, origin)
        self.crs = crs
        if crs is not None and is_geographic(crs):
            raise ValueError(
                f"{short_name(crs)} is longitude and latitude, not metres; read the file with "
                'warpriver.read_terrain(..., to_crs="utm"), or reproject the heights'
            )
        if isinstance(height, wp.array):
            height = height.numpy()
        self.height: wp.array = wp.array(_checked_height(height, self.device), dtype=wp.float64, device=self.device)

    @classmethod
    def _of(cls, height: wp.array, cell_size: float, origin: Sequence[float], crs: str | None) -> Terrain:
        """Wrap a device array that is known to be sound, without a copy."""
        terrain = cls.__new__(cls)
        terrain.height, terrain.device, terrain.crs = height, height.device, crs
        terrain.cell_size, terrain.origin = _checked_grid(cell_size, origin)
        return terrain

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.height.shape[0]), int(self.height.shape[1])

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Outer edges (west, south, east, north) in m."""
        (rows, columns), (west, north) = self.shape, self.origin
        return west, north - rows * self.cell_size, west + columns * self.cell_size, north

    def to_numpy(self) -> np.ndarray:
        """Return a copy of the heights on the host, (rows, columns) float64 in m."""
        return self.height.numpy().copy()

    def copy(self) -> Terrain:
        """Return a copy on the same device."""
        return Terrain._of(wp.clone(self.height), self.cell_size, self.origin, self.crs)

    def to(self, device: Any) -> Terrain:
        """Return a copy on another device."""
        target = resolve_device(device)
        return Terrain._of(wp.clone(self.height, device=target), self.cell_size, self.origin, self.crs)

    def grid(self, dtype: str = "float64", origin: Sequence[float] | np.ndarray = (0.0, 0.0)) -> Any:
        """Return the ``RasterGrid`` that ``kernels/raster.py`` reads beside ``height``.

        Args:
            dtype: Precision of the points to look up, "float64" or "float32".
            origin: Absolute position of those points' zero in m, as ``RiverNetwork.origin``.
        """
        grid = kernels.build(PRECISIONS[dtype][0]).RasterGrid()
        grid.west, grid.north = self.origin[0] - float(origin[0]), self.origin[1] - float(origin[1])
        grid.cell_size, grid.cells_per_meter = self.cell_size, 1.0 / self.cell_size
        return grid

    def sample(self, xy: Any) -> np.ndarray:
        """Return the height in m at points, bilinear between the cells' centres.

        Args:
            xy: (n, 2) points in m.

        Returns:
            (n,) float64; NaN off the terrain and in cells without data.
        """
        points = self._points(xy)
        out = wp.empty(len(points), dtype=wp.float64, device=self.device)
        self._launch("sample_values", len(points), [self.height, self.grid(), points], [out])
        return out.numpy().copy()

    def gradient(self, xy: Any) -> np.ndarray:
        """Return the gradient (dh/dx towards east, dh/dy towards north) at points.

        Central differences at the cells' centres, one-sided at the edge and beside cells without data, bilinear in
        between: a continuous field, smoother than the derivative of the bilinear heights, and exact on a plane.

        Args:
            xy: (n, 2) points in m.

        Returns:
            (n, 2) float64; NaN off the terrain and in cells without data.
        """
        points = self._points(xy)
        out = wp.empty(len(points), dtype=wp.vec2d, device=self.device)
        self._launch("sample_gradients", len(points), [self.height, self.grid(), points], [out])
        return out.numpy().copy()

    def slope(self) -> np.ndarray:
        """Return the slope of each cell, |grad h|: (rows, columns) float64, NaN without data."""
        out = wp.empty(self.shape, dtype=wp.float64, device=self.device)
        self._launch("compute_slope", self.shape, [self.height, wp.float64(1.0 / self.cell_size)], [out])
        return out.numpy().copy()

    def brush(
        self,
        kind: Literal["raise", "lower", "smooth", "flatten"],
        center: Sequence[float] | np.ndarray,
        radius: float,
        amount: float,
        *,
        level: float | None = None,
    ) -> None:
        """Edit the heights in place under a round brush, whose weight falls smoothly from 1 at its centre to 0.

        The weight at a distance p radii from the centre is 1 - 3 p^2 + 2 p^3. Cells without data stay so, and a brush
        that lies off the terrain does nothing.

        Args:
            kind: "raise" or "lower" by an amount in m; "smooth": blend with a Gaussian mean of an eighth of the radius,
                which leaves a plane as it is; "flatten": draw towards a level.
            center: (x, y) in m.
            radius: m; a brush below the cell size may miss all centres.
            amount: m for "raise" and "lower"; a share from 0 to 1 for "smooth" and "flatten".
            level: Height in m that "flatten" goes to; by default that at the centre.

        Raises:
            ValueError: Another kind, a number out of range, or no height at the centre to flatten to.
        """
        if kind not in BRUSHES:
            raise ValueError(f"brush kind is {kind!r}; use one of {', '.join(BRUSHES)}")
        x, y = _numbers(center, 2, "center")
        radius = _positive(radius, "radius", "m")
        share = kind in ("smooth", "flatten")
        if not math.isfinite(amount) or amount < 0.0 or (share and amount > 1.0):
            raise ValueError(f"amount is {amount}; to {kind} give " + ("a share, 0 to 1" if share else "m, 0 or more"))
        if kind == "flatten" and level is None:
            level = float(self.sample([(x, y)])[0])
        if kind == "flatten" and not math.isfinite(level or 0.0):
            raise ValueError(f"there is no height at the centre ({x:g}, {y:g}) to flatten to; give level= in m")
        brush = kernels.build(wp.float64).Brush()
        brush.center, brush.radius, brush.level = wp.vec2d(x, y), radius, 0.0 if level is None else float(level)
        brush.amount = -float(amount) if kind == "lower" else float(amount)
        window = self._window(x - radius, y - radius, x + radius, y + radius)
        if window is None:
            return
        name = "flatten_cells" if kind == "flatten" else "raise_cells"
        if kind == "smooth":
            self._smooth(brush, window, radius)
        else:
            self._launch(name, window[2:], [self.grid(), brush, wp.vec4i(*window)], [self.height])

    def _smooth(self, brush: Any, window: tuple[int, int, int, int], radius: float) -> None:
        """Blend the window with its Gaussian mean, rows first, columns second."""
        spread = max(SMOOTH_PART * radius / self.cell_size, SMOOTH_LEAST)
        reach = math.ceil(SMOOTH_REACH * spread)
        bell = np.exp(-0.5 * (np.arange(reach + 1) / spread) ** 2)
        weight: wp.array = wp.array(bell / (2.0 * bell.sum() - 1.0), dtype=wp.float64, device=self.device)
        row, column, rows, columns = window
        first, last = max(row - reach, 0), min(row + rows + reach, self.shape[0])
        blurred = wp.empty((last - first, columns), dtype=wp.float64, device=self.device)
        strip = wp.vec4i(first, column, last - first, columns)
        self._launch("blur_rows", blurred.shape, [self.height, strip, weight], [blurred])
        inputs = [self.grid(), brush, wp.vec4i(*window), first, weight, blurred]
        self._launch("blend_columns", (rows, columns), inputs, [self.height])

    def add_ridge(self, line: Any, height: Any, width: float) -> None:
        """Add a ridge along a line in place, or cut a valley if its height is below 0.

        A cell at a distance p half-widths from the line rises by 1 - 3 p^2 + 2 p^3 times the height at the nearest
        point of the line, between whose points heights are linear.

        Args:
            line: (n, 2) points in m, n at least 2.
            height: Height of the crest over the ground in m, one number or one a point.
            width: Width of the foot in m.
        """
        crest = _checked_points(line, "line")
        if len(crest) < 2 or (np.diff(crest, axis=0) == 0.0).all(axis=1).any():
            raise ValueError(f"line has {len(crest)} points; give at least 2, none of them twice in a row")
        rise = np.broadcast_to(np.asarray(height, np.float64), len(crest)) if np.ndim(height) == 0 else height
        rise = np.array(_numbers(rise, len(crest), "height"))
        half = 0.5 * _positive(width, "width", "m")
        (west, south), (east, north) = crest.min(axis=0) - half, crest.max(axis=0) + half
        window = self._window(west, south, east, north)
        if window is None:
            return
        crest_xy: wp.array = wp.array(crest, dtype=wp.vec2d, device=self.device)
        crest_height: wp.array = wp.array(rise, dtype=wp.float64, device=self.device)
        inputs = [self.grid(), wp.float64(half), wp.vec4i(*window), crest_xy, crest_height]
        self._launch("raise_ridge", window[2:], inputs, [self.height])

    def resampled(self, cell_size: float) -> Terrain:
        """Return the terrain on another cell size, from the same north-west corner: bilinear up, area mean down.

        The mean is that of the old cells where a whole number of them makes a new one, else that of the bilinear
        surface: both keep the volume, and the second keeps planes, which fractions of cells would turn into steps.
        The number of rows and columns is rounded, so that the far edges move by half a new cell at most. Where finer,
        a cell has data if the old cell that its centre lies in has; where coarser, if half of its area has.
        """
        size = _positive(cell_size, "cell_size", "m")
        step = size / self.cell_size
        height = _resample(self.height, (step, step))
        return Terrain._of(height, size, self.origin, self.crs)

    def crop(self, bounds: Sequence[float] | np.ndarray) -> Terrain:
        """Return the cells whose centres lie within (west, south, east, north) in m."""
        west, south, east, north = _numbers(bounds, 4, "bounds")
        window = self._window(west, south, east, north)
        if not (west < east and south < north) or window is None or min(window[2:]) < 2:
            raise ValueError(
                f"bounds ({west:g}, {south:g}, {east:g}, {north:g}) hold fewer than 2 x 2 cells of the terrain, which "
                f"lies within {tuple(round(b, 3) for b in self.bounds)}; give (west, south, east, north) in m"
            )
        row, column, rows, columns = window
        part = wp.clone(self.height[row : row + rows, column : column + columns].contiguous())
        origin = (self.origin[0] + column * self.cell_size, self.origin[1] - row * self.cell_size)
        return Terrain._of(part, self.cell_size, origin, self.crs)

    def __repr__(self) -> str:
        height = self.height.numpy()
        (rows, columns), gap = self.shape, np.isnan(height)
        size = f"{columns * self.cell_size / 1e3:.4g} x {rows * self.cell_size / 1e3:.4g} km"
        span = "no data" if gap.all() else f"heights {np.nanmin(height):.6g} to {np.nanmax(height):.6g} m"
        crs = None if self.crs is None else short_name(self.crs)
        share = f", {100.0 * gap.mean():.3g} % no data" if gap.any() and not gap.all() else ""
        return (
            f"Terrain({rows} x {columns} cells of {self.cell_size:.6g} m, {size}, {span}{share}, crs={crs}, "
            f"on {self.device.alias})"
        )

    def _points(self, xy: Any) -> wp.array:
        """Copy points to the device."""
        return wp.array(_checked_points(xy, "xy", finite=False), dtype=wp.vec2d, device=self.device)

    def _launch(self, name: str, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        """Launch one of the float64 kernels."""
        wp.launch(getattr(kernels.build(wp.float64), name), dim, inputs, outputs, device=self.device)

    def _window(self, west: float, south: float, east: float, north: float) -> tuple[int, int, int, int] | None:
        """Return (first row, first column, rows, columns) of the cells with centres in a box; None if none has."""
        size, (rows, columns) = self.cell_size, self.shape
        first_column = max(math.ceil((west - self.origin[0]) / size - 0.5), 0)
        last_column = min(math.floor((east - self.origin[0]) / size - 0.5), columns - 1)
        first_row = max(math.ceil((self.origin[1] - north) / size - 0.5), 0)
        last_row = min(math.floor((self.origin[1] - south) / size - 0.5), rows - 1)
        if first_column > last_column or first_row > last_row:
            return None
        return first_row, first_column, last_row - first_row + 1, last_column - first_column + 1


def square_cells(height: np.ndarray, width: float, length: float, cell_size: float, device: Any = "cpu") -> np.ndarray:
    """Return heights of cells ``width`` (east) x ``length`` (north) m on square ones, from the north-west corner.

    As in :meth:`Terrain.resampled`: bilinear where the new cells are finer, area mean where they are coarser.
    """
    source: wp.array = wp.array(np.asarray(height, np.float64), dtype=wp.float64, device=resolve_device(device))
    return _resample(source, (cell_size / width, cell_size / length)).numpy()


def _resample(height: wp.array, step: tuple[float, float]) -> wp.array:
    """Heights on cells of ``step`` = (columns, rows) of the old ones, on the device."""
    shape = tuple(math.floor(n / s + 0.5) for n, s in zip(height.shape, step[::-1], strict=True))
    if min(shape) < 2:
        raise ValueError(f"the cell size leaves {shape[0]} x {shape[1]} cells; a terrain needs at least 2 x 2")
    require_memory(shape, 8, height.device)
    out = wp.empty(shape, dtype=wp.float64, device=height.device)
    ways = [0 if s <= 1.0 else 1 if abs(s - round(s)) < WHOLE * s else 2 for s in step]
    kernel = kernels.build(wp.float64).resample_cells
    inputs = [wp.vec2d(*step), wp.vec2i(*ways), height]
    wp.launch(kernel, dim=shape, inputs=inputs, outputs=[out], device=height.device)
    return out


def _checked_grid(cell_size: Any, origin: Any) -> tuple[float, tuple[float, float]]:
    """Return cell size and origin as numbers, or raise ``ValueError``."""
    west, north = _numbers(origin, 2, "origin")
    return _positive(cell_size, "cell_size", "m"), (west, north)


def _checked_height(height: Any, device: Any) -> np.ndarray:
    """Return heights as float64 with NaN for no data, or raise ``ValueError``; ``MemoryError`` if there is no room."""
    try:
        source = height if hasattr(height, "shape") else np.asarray(height)
        if len(source.shape) != 2 or min(source.shape) < 2:
            raise ValueError(f"its shape is {source.shape}")
        # The device's copy and a mask; and the array's own, unless it has the right type already.
        require_memory(source.shape, 9 if getattr(source, "dtype", None) == np.float64 else 17, device)
        if isinstance(source, np.ma.MaskedArray):
            source = np.ma.filled(source.astype(np.float64), np.nan)
        array = np.asarray(source, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"height cannot be used ({error}); give numbers as (rows, columns), in m, at least 2 of each"
        ) from error
    infinite = np.isinf(array)
    if infinite.any():
        row, column = np.unravel_index(int(infinite.argmax()), array.shape)
        raise ValueError(
            f"height is infinite in {int(infinite.sum())} cells, the first at row {row}, column {column}; "
            "write NaN for no data"
        )
    if np.isnan(array).all():
        raise ValueError("height is NaN in every cell; a terrain needs data")
    return array


def _checked_points(xy: Any, name: str, finite: bool = True) -> np.ndarray:
    """Return points as (n, 2) float64, or raise ``ValueError``."""
    try:
        points = np.ascontiguousarray(xy, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is not an array of numbers ({error}); give (n, 2) in m") from error
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"{name} has shape {points.shape}; give (n, 2) points in m")
    if finite and not np.isfinite(points).all():
        raise ValueError(f"{name} holds a point that is not finite; remove or repair it")
    return points


def _numbers(values: Any, count: int, name: str) -> list[float]:
    """Return that many finite numbers, or raise ``ValueError``."""
    try:
        numbers = [float(v) for v in values]
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is {values!r}; give {count} numbers") from error
    if len(numbers) != count or not all(math.isfinite(v) for v in numbers):
        raise ValueError(f"{name} is {numbers}; give {count} finite numbers")
    return numbers


def _positive(value: Any, name: str, unit: str) -> float:
    """Return a positive finite number, or raise ``ValueError``."""
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is {value!r}; give a positive number of {unit}") from error
    if not (math.isfinite(number) and number > 0.0):
        raise ValueError(f"{name} is {number:g}; give a positive number of {unit}")
    return number
