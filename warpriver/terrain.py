"""Terrain: a raster of heights on the device; sampling, gradient, slope, brushes, resampling and cropping."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.crs import CRSLike, metric_crs
from warpriver.device import launch_kernel, require_memory, resolve_device
from warpriver.errors import InputError, warn
from warpriver.kernels import terrain as kernels
from warpriver.public import public
from warpriver.raster import (
    Raster,
    checked_grid,
    checked_values,
    refuse_infinite,
)
from warpriver.sentinels import find_sentinels, listed
from warpriver.thumbnail import card, png_of, raster_picture
from warpriver.validate import checked_points, finite_numbers, floats, positive, shown

__all__ = ["NAME", "UNIT", "Terrain", "TerrainFile", "square_cells", "surface_of"]

BRUSHES = ("raise", "lower", "smooth", "flatten")
# A cell is a whole multiple of another up to this relative error.
WHOLE = 1e-9
# Standard deviation of the Gaussian of the smoothing brush, in radii; its minimum in cells; how far it reaches.
SMOOTH_FRACTION, SMOOTH_MINIMUM, SMOOTH_REACH = 0.125, 0.75, 3.0
# What a terrain's raster holds.
UNIT, NAME = "m", "height"


@dataclasses.dataclass(frozen=True)
class TerrainFile:
    """The file that a terrain was read from or written to.

    Attributes:
        path: Absolute path.
        options: Arguments that ``read_terrain`` needs beside it to come to the same heights.
    """

    path: str
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)


class Terrain:
    """A raster of heights on square cells, north up, on the device.

    Row 0 is the north edge. The height of a cell belongs to its centre, at (west + (column + 1/2) cell_size,
    north - (row + 1/2) cell_size). NaN is no data. Between centres heights are bilinear. At the outer edge and beside
    cells without data one rule holds: of the four centres around a point the missing ones drop out, so that a height
    goes on unchanged through the outer half cell, and a point whose own cell is missing has height NaN.

    Heights that were computed as a :class:`warpriver.raster.Raster` become a terrain by :meth:`from_raster`. Terrains
    pickle as rasters do.

    Attributes:
        raster: The heights as a Raster, in the same memory; maps on the same cells are made by ``raster.like``.
        file: The file that it comes from, which a run notes to find its ground again; None where there is none. Heights
            that were edited since are told by their :meth:`digest`.
    """

    raster: Raster
    file: TerrainFile | None = None

    @public
    def __init__(
        self,
        height: npt.ArrayLike | DeviceArray,
        cell_size: float,
        origin: Sequence[float] | np.ndarray = (0.0, 0.0),
        crs: str | None = None,
        *,
        device: wp.DeviceLike = "cpu",
    ):
        """Copy heights to the device.

        Args:
            height: (rows, columns) heights in m, row 0 in the north; NaN, or masked, where there is no data. Values
                such as -9999 or 3.4e38 that stand alone are kept, with a warning.
            cell_size: Length of a cell's side in m.
            origin: (west, north), the outer corner of the first cell in m.
            crs: Coordinate reference system, as text or ``pyproj.CRS``; x and y in it must be metres.
            device: Warp device name, "cpu" or "cuda:0".

        Raises:
            ValueError: Fewer than 2 x 2 cells, not two dimensions, no data at all, an infinite height, a cell size or
                an origin that is no length, a CRS that is unknown or not in metres, or an unknown device.
            MemoryError: The device has not enough memory for it.
        """
        target = resolve_device(device)
        place = (*checked_grid(cell_size, origin), metric_crs(crs))
        array = checked_values(height, target, integers=False, word="height", unit=UNIT, what="a terrain")
        _require_data(array)
        found = find_sentinels(array)
        if found:
            warn(f"height: of its cells {listed(found)}; if that stands for no data, write NaN there")
        values: DeviceArray = wp.array(array, dtype=wp.float64, device=target)
        self.raster = Raster.wrap(values, *place, UNIT, NAME)

    @staticmethod
    def wrap_raster(raster: Raster) -> Terrain:
        """Wrap a raster of heights that was checked, without a copy."""
        terrain = Terrain.__new__(Terrain)
        terrain.raster = raster
        return terrain

    @staticmethod
    def wrap(height: DeviceArray, cell_size: float, origin: tuple[float, float], crs: str | None) -> Terrain:
        """Wrap a device array that was checked, without a copy."""
        return Terrain.wrap_raster(Raster.wrap(height, cell_size, origin, crs, UNIT, NAME))

    @classmethod
    @public
    def from_raster(cls, raster: Raster) -> Terrain:
        """Return a terrain of the heights that a raster holds, in the same memory: edits show in both.

        Args:
            raster: float64 values in m; NaN where there is no data.

        Raises:
            ValueError: It holds whole numbers, another unit, no data at all or an infinite height.
        """
        if not isinstance(raster, Raster):
            raise InputError(f"raster is a {type(raster).__name__}; give a Raster, or Terrain(height, cell_size)")
        if raster.is_integer or raster.unit not in ("", UNIT):
            held = raster.dtype if raster.is_integer else f"in {raster.unit!r}"
            raise InputError(f"raster {raster.name!r} is {held}; a terrain needs float64 heights in m")
        height = raster.values.numpy()
        refuse_infinite(height, "height")
        _require_data(height)
        return Terrain.wrap_raster(raster.like(raster.values, unit=UNIT, name=NAME))

    @property
    def height(self) -> DeviceArray:
        """Device array (rows, columns) of float64, m; kernels may edit it in place."""
        return self.raster.values

    @property
    def cell_size(self) -> float:
        """Length of a cell's side in m."""
        return self.raster.cell_size

    @property
    def origin(self) -> tuple[float, float]:
        """(west, north), the outer corner of the first cell in m."""
        return self.raster.origin

    @property
    def crs(self) -> str | None:
        """Coordinate reference system as text ("EPSG:32619", WKT ...), or None."""
        return self.raster.crs

    @crs.setter
    def crs(self, crs: CRSLike | None) -> None:
        self.raster.crs = crs

    @property
    def device(self) -> wp.Device:
        """Warp device that ``height`` lies on."""
        return self.raster.device

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.raster.shape

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Outer edges (west, south, east, north) in m."""
        return self.raster.bounds

    def to_numpy(self) -> np.ndarray:
        """Return a copy of the heights on the host, (rows, columns) float64 in m."""
        return self.raster.numpy()

    def copy(self) -> Terrain:
        """Return a copy on the same device."""
        return self._same_file(Terrain.wrap_raster(self.raster.copy()))

    @public
    def to(self, device: wp.DeviceLike) -> Terrain:
        """Return a copy on another device."""
        return self._same_file(Terrain.wrap_raster(self.raster.to(device)))

    def _same_file(self, copy: Terrain) -> Terrain:
        copy.file = self.file
        return copy

    def digest(self) -> str:
        """Return a hash of the heights and their place, 32 hexadecimal digits; the CRS does not count.

        Terrains whose heights are the same to the bit have the same digest, on any device.
        """
        height = self.to_numpy()
        height[np.isnan(height)] = np.nan
        height += 0.0  # -0.0 is 0.0
        place = np.array([*self.shape, self.cell_size, *self.origin], np.float64)
        return hashlib.blake2b(place.tobytes() + height.tobytes(), digest_size=16).hexdigest()

    def grid(self, dtype: str = "float64", origin: Sequence[float] | np.ndarray = (0.0, 0.0)) -> Any:
        """Return the ``RasterGrid`` that ``kernels/raster.py`` reads beside ``height``, as :meth:`Raster.grid`."""
        return self.raster.grid(dtype, origin)

    @public
    def sample(self, xy: npt.ArrayLike) -> np.ndarray:
        """Return the height in m at points, bilinear between the cells' centres.

        Args:
            xy: (n, 2) points in m.

        Returns:
            (n,) float64; NaN off the terrain and in cells without data.
        """
        return self.raster.sample(xy)

    @public
    def gradient(self, xy: npt.ArrayLike) -> np.ndarray:
        """Return the gradient (dh/dx towards east, dh/dy towards north) at points.

        Central differences at the cells' centres, one-sided at the edge and beside cells without data, bilinear in
        between: a continuous field, smoother than the derivative of the bilinear heights, and exact on a plane.

        Args:
            xy: (n, 2) points in m.

        Returns:
            (n, 2) float64; NaN off the terrain and in cells without data.
        """
        points: DeviceArray = wp.array(checked_points(xy, "xy", finite=False), dtype=wp.vec2d, device=self.device)
        out = wp.empty(len(points), dtype=wp.vec2d, device=self.device)
        self._launch("sample_gradients", len(points), [self.height, self.grid(), points], [out])
        gradient: np.ndarray = out.numpy().copy()
        return gradient

    def slope(self) -> np.ndarray:
        """Return the slope of each cell, |grad h|: (rows, columns) float64, NaN without data."""
        out = wp.empty(self.shape, dtype=wp.float64, device=self.device)
        self._launch("compute_slope", self.shape, [self.height, wp.float64(1.0 / self.cell_size)], [out])
        slope: np.ndarray = out.numpy().copy()
        return slope

    @public
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
            amount: m for "raise" and "lower"; a fraction from 0 to 1 for "smooth" and "flatten".
            level: Height in m that "flatten" goes to; by default that at the centre.

        Raises:
            ValueError: Another kind, a number out of range, or no height at the centre to flatten to.
        """
        if kind not in BRUSHES:
            raise InputError(f"brush kind is {shown(kind)}; use one of {', '.join(BRUSHES)}")
        x, y = finite_numbers(center, 2, "center")
        radius = positive(radius, "radius", "m")
        blends = kind in ("smooth", "flatten")
        if not math.isfinite(amount) or amount < 0.0 or (blends and amount > 1.0):
            needed = "a fraction, 0 to 1" if blends else "m, 0 or more"
            raise InputError(f"amount is {amount}; to {kind} give {needed}")
        if kind == "flatten" and level is None:
            level = float(self.sample([(x, y)])[0])
        if kind == "flatten" and not math.isfinite(level or 0.0):
            raise InputError(f"there is no height at the centre ({x:g}, {y:g}) to flatten to; give level= in m")
        brush = kernels.build(wp.float64).Brush()
        brush.center, brush.radius, brush.level = wp.vec2d(x, y), radius, 0.0 if level is None else float(level)
        brush.amount = -float(amount) if kind == "lower" else float(amount)
        window = self.raster.window(x - radius, y - radius, x + radius, y + radius)
        if window is None:
            return
        name = "flatten_cells" if kind == "flatten" else "raise_cells"
        if kind == "smooth":
            self._smooth(brush, window, radius)
        else:
            self._launch(name, window[2:], [self.grid(), brush, wp.vec4i(*window)], [self.height])

    def _smooth(self, brush: Any, window: tuple[int, int, int, int], radius: float) -> None:
        """Blend the window with its Gaussian mean, rows first, columns second."""
        spread = max(SMOOTH_FRACTION * radius / self.cell_size, SMOOTH_MINIMUM)
        reach = math.ceil(SMOOTH_REACH * spread)
        bell = np.exp(-0.5 * (np.arange(reach + 1) / spread) ** 2)
        weight: DeviceArray = wp.array(bell / (2.0 * bell.sum() - 1.0), dtype=wp.float64, device=self.device)
        row, column, rows, columns = window
        first, last = max(row - reach, 0), min(row + rows + reach, self.shape[0])
        blurred = wp.empty((last - first, columns), dtype=wp.float64, device=self.device)
        strip = wp.vec4i(first, column, last - first, columns)
        self._launch("blur_rows", blurred.shape, [self.height, strip, weight], [blurred])
        inputs = [self.grid(), brush, wp.vec4i(*window), first, weight, blurred]
        self._launch("blend_columns", (rows, columns), inputs, [self.height])

    @public
    def add_ridge(self, line: npt.ArrayLike, height: float | Sequence[float] | np.ndarray, width: float) -> None:
        """Add a ridge along a line in place, or cut a valley if its height is below 0.

        A cell at a distance p half-widths from the line rises by 1 - 3 p^2 + 2 p^3 times the height at the nearest
        point of the line, between whose points heights are linear.

        Args:
            line: (n, 2) points in m, n at least 2.
            height: Height of the crest over the ground in m, one number or one a point.
            width: Width of the foot in m.
        """
        crest = checked_points(line, "line")
        if len(crest) < 2 or (np.diff(crest, axis=0) == 0.0).all(axis=1).any():
            raise InputError(f"line has {len(crest)} points; give at least 2, none of them twice in a row")
        heights = floats(height, "height")
        heights = np.full(len(crest), heights) if heights.ndim == 0 else heights
        rise = np.array(finite_numbers(heights, len(crest), "height"))
        half = 0.5 * positive(width, "width", "m")
        (west, south), (east, north) = crest.min(axis=0) - half, crest.max(axis=0) + half
        window = self.raster.window(west, south, east, north)
        if window is None:
            return
        crest_xy: DeviceArray = wp.array(crest, dtype=wp.vec2d, device=self.device)
        crest_height: DeviceArray = wp.array(rise, dtype=wp.float64, device=self.device)
        inputs = [self.grid(), wp.float64(half), wp.vec4i(*window), crest_xy, crest_height]
        self._launch("raise_ridge", window[2:], inputs, [self.height])

    @public
    def resampled(self, cell_size: float) -> Terrain:
        """Return the terrain on another cell size, from the same north-west corner: bilinear up, area mean down.

        The mean is that of the old cells where a whole number of them makes a new one, else that of the bilinear
        surface: both keep the volume, and the second keeps planes, which fractions of cells would turn into steps.
        The number of rows and columns is rounded, so that the far edges move by half a new cell at most. Where finer,
        a cell has data if the old cell that its centre lies in has; where coarser, if half of its area has.
        """
        size = positive(cell_size, "cell_size", "m")
        step = size / self.cell_size
        height = _resample(self.height, (step, step))
        return Terrain.wrap(height, size, self.origin, self.crs)

    @public
    def crop(self, bounds: Sequence[float] | np.ndarray) -> Terrain:
        """Return the cells whose centres lie within (west, south, east, north) in m."""
        return Terrain.wrap_raster(self.raster.crop(bounds, what="terrain"))

    def __repr__(self) -> str:
        return f"Terrain({self.raster.summary('heights', UNIT)})"

    def _repr_html_(self) -> str:
        return card(type(self).__name__, self.raster.facts("heights", UNIT), self._repr_png_())

    def _repr_png_(self) -> bytes:
        return png_of(raster_picture(self.height.numpy(), self.cell_size, heights=True))

    def _launch(self, name: str, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        """Launch one of the float64 kernels."""
        launch_kernel(getattr(kernels.build(wp.float64), name), dim, inputs, outputs, device=self.device)


def surface_of(surface: Terrain | Raster) -> Terrain:
    """Return a terrain, or the one whose heights a raster holds; raises ``ValueError`` for anything else."""
    if isinstance(surface, Raster):
        return Terrain.from_raster(surface)
    if not isinstance(surface, Terrain):
        raise InputError(f"the surface is a {type(surface).__name__}; give a Terrain, or a Raster of heights in m")
    return surface


def square_cells(
    height: np.ndarray, width: float, length: float, cell_size: float, device: wp.DeviceLike = "cpu"
) -> np.ndarray:
    """Return heights of cells ``width`` (east) x ``length`` (north) m on square ones, from the north-west corner.

    As in :meth:`Terrain.resampled`: bilinear where the new cells are finer, area mean where they are coarser.
    """
    source: DeviceArray = wp.array(np.asarray(height, np.float64), dtype=wp.float64, device=resolve_device(device))
    square: np.ndarray = _resample(source, (cell_size / width, cell_size / length)).numpy()
    return square


def _resample(height: DeviceArray, step: tuple[float, float]) -> DeviceArray:
    """Heights on cells of ``step`` = (columns, rows) of the old ones, on the device."""
    shape = tuple(math.floor(n / s + 0.5) for n, s in zip(height.shape, step[::-1], strict=True))
    if min(shape) < 2:
        raise InputError(f"the cell size leaves {shape[0]} x {shape[1]} cells; a terrain needs at least 2 x 2")
    require_memory(shape, 8, height.device)
    out = wp.empty(shape, dtype=wp.float64, device=height.device)
    ways = [0 if s <= 1.0 else 1 if abs(s - round(s)) < WHOLE * s else 2 for s in step]
    kernel = kernels.build(wp.float64).resample_cells
    inputs = [wp.vec2d(*step), wp.vec2i(*ways), height]
    launch_kernel(kernel, dim=shape, inputs=inputs, outputs=[out], device=height.device)
    return out


def _require_data(height: np.ndarray) -> None:
    """Raise ``ValueError`` where no cell has a height."""
    if np.isnan(height).all():
        raise InputError("height is NaN in every cell; a terrain needs data")
