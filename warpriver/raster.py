"""Raster: values of square cells with their place on the map, on the device; sampling, cropping, and its checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.crs import CRSLike, metric_crs, pyproj_or_none, short_name
from warpriver.device import PRECISIONS, launch_kernel, present_device, require_memory, resolve_device
from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.kernels import raster as kernels
from warpriver.public import public
from warpriver.thumbnail import card, png_of, raster_picture
from warpriver.validate import checked_points, finite_numbers, positive, shown

if TYPE_CHECKING:
    import xarray

__all__ = [
    "Raster",
    "checked_grid",
    "checked_values",
    "refuse_infinite",
]

# What the cells may hold on the device.
CELL_TYPES = (wp.float64, wp.int8, wp.int16, wp.int32, wp.int64, wp.uint8, wp.uint16, wp.uint32, wp.uint64)


class Raster:
    """A map: values of square cells, north up, with their place, unit and name, on the device.

    Row 0 is the north edge. The value of a cell belongs to its centre, at (west + (column + 1/2) cell_size,
    north - (row + 1/2) cell_size). Values are float64, with NaN for no data, or whole numbers of any integer type,
    which have a value in every cell: receivers, labels, masks. Drainage areas and whatever else is computed from a
    terrain come as rasters; heights of the ground are a :class:`warpriver.Terrain`, which holds one.

    ``numpy.asarray(raster)``, and so NumPy's functions, take its values as :meth:`numpy` gives them. Rasters pickle
    with equal bits and come back on the device that they lay on; where the machine has no such device they come back
    on the CPU, with a ``UserWarning``.

    Attributes:
        values: device array (rows, columns) of float64 or integers; kernels may edit it in place.
        cell_size: Length of a cell's side in m.
        origin: (west, north), the outer corner of the first cell in m.
        unit: Unit of the values, such as "m2"; "" for none.
        name: What they are, such as "drainage_area"; "" for no name.
    """

    values: DeviceArray
    cell_size: float
    origin: tuple[float, float]
    unit: str
    name: str

    @public
    def __init__(
        self,
        values: npt.ArrayLike | DeviceArray,
        cell_size: float,
        origin: Sequence[float] | np.ndarray = (0.0, 0.0),
        crs: str | None = None,
        unit: str = "",
        name: str = "",
        *,
        device: wp.DeviceLike = "cpu",
    ):
        """Copy values to the device.

        Args:
            values: (rows, columns) numbers, row 0 in the north. Whole ones keep their type; bool becomes uint8; others
                become float64, also whole ones of which some are masked. NaN, or masked, is no data.
            cell_size: Length of a cell's side in m.
            origin: (west, north), the outer corner of the first cell in m.
            crs: Coordinate reference system, as text or ``pyproj.CRS``; x and y in it must be metres.
            unit: Unit of the values.
            name: What they are.
            device: Warp device name, "cpu" or "cuda:0".

        Raises:
            ValueError: Fewer than 2 x 2 cells, not two dimensions, an infinite value, a cell size or an origin that is
                no length, a CRS that is unknown or not in metres, a unit or name that is no text, or an unknown device.
            MemoryError: The device has not enough memory for it.
        """
        target = resolve_device(device)
        self.cell_size, self.origin = checked_grid(cell_size, origin)
        self._crs = metric_crs(crs)
        self.unit, self.name = _text(unit, "unit"), _text(name, "name")
        array = checked_values(values, target, integers=True)
        self.values = wp.array(array, dtype=wp.dtype_from_numpy(array.dtype), device=target)

    @classmethod
    def wrap(
        cls,
        values: DeviceArray,
        cell_size: float,
        origin: tuple[float, float],
        crs: str | None,
        unit: str = "",
        name: str = "",
    ) -> Raster:
        """Wrap a device array and a place that were checked, without a copy."""
        raster = cls.__new__(cls)
        raster.values, raster.cell_size, raster.origin, raster._crs = values, cell_size, origin, crs
        raster.unit, raster.name = unit, name
        return raster

    @property
    def crs(self) -> str | None:
        """Coordinate reference system as text ("EPSG:32619", WKT ...), or None; never one in degrees."""
        return self._crs

    @crs.setter
    def crs(self, crs: CRSLike | None) -> None:
        self._crs = metric_crs(crs)

    @property
    def device(self) -> wp.Device:
        """Warp device that the values lie on."""
        return cast(wp.Device, self.values.device)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.values.shape[0]), int(self.values.shape[1])

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Outer edges (west, south, east, north) in m."""
        (rows, columns), (west, north) = self.shape, self.origin
        return west, north - rows * self.cell_size, west + columns * self.cell_size, north

    @property
    def dtype(self) -> np.dtype:
        """NumPy's type of the values: float64, or that of whole numbers."""
        dtype: np.dtype = np.dtype(wp.dtype_to_numpy(self.values.dtype))
        return dtype

    @property
    def is_integer(self) -> bool:
        """Whether the cells hold whole numbers."""
        return self.dtype.kind in "iu"

    def numpy(self) -> np.ndarray:
        """Return a copy of the values on the host, (rows, columns)."""
        values: np.ndarray = self.values.numpy().copy() if self.device.is_cpu else self.values.numpy()
        return values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if copy is False:
            raise InputError("the values of a raster are copied to become a NumPy array; see Raster.numpy")
        return np.asarray(self.numpy(), dtype)

    @public
    def like(self, values: npt.ArrayLike | DeviceArray, *, unit: str = "", name: str = "") -> Raster:
        """Return a raster of other values on the same cells, on the same device.

        A device array of float64 or integers on that device is used as it is, without a copy and without a check of its
        values: so the results of kernels become maps.

        Args:
            values: (rows, columns) numbers of this shape, on the host or on a device.
            unit: Unit of the values.
            name: What they are.

        Raises:
            ValueError: Another shape, or what the constructor refuses.
        """
        place = (self.cell_size, self.origin, self.crs)
        if isinstance(values, wp.array) and values.dtype in CELL_TYPES and values.is_contiguous:
            here = values if values.device == self.device else wp.clone(values, device=self.device)
            made = Raster.wrap(here, *place, _text(unit, "unit"), _text(name, "name"))
        else:
            made = Raster(values, *place, unit, name, device=self.device)
        if made.values.shape != self.values.shape:
            raise InputError(f"values have shape {tuple(made.values.shape)}; the raster has {self.shape}")
        return made

    def matches(self, other: Any) -> bool:
        """Tell whether a raster or terrain has the same cells: shape, cell size, origin and CRS."""
        place = (self.shape, self.cell_size, self.origin, self.crs)
        return bool(place == (other.shape, other.cell_size, other.origin, other.crs))

    def copy(self) -> Raster:
        """Return a copy on the same device."""
        return self.to(self.device)

    @public
    def to(self, device: wp.DeviceLike) -> Raster:
        """Return a copy on another device."""
        values = wp.clone(self.values, device=resolve_device(device))
        return Raster.wrap(values, self.cell_size, self.origin, self.crs, self.unit, self.name)

    def grid(self, dtype: str = "float64", origin: Sequence[float] | np.ndarray = (0.0, 0.0)) -> Any:
        """Return the ``RasterGrid`` that ``kernels/raster.py`` reads beside the values.

        Args:
            dtype: Precision of the points to look up, "float64" or "float32".
            origin: Absolute position of those points' zero in m, as ``RiverNetwork.origin``.
        """
        grid = kernels.build(PRECISIONS[dtype][0]).RasterGrid()
        grid.west, grid.north = self.origin[0] - float(origin[0]), self.origin[1] - float(origin[1])
        grid.cell_size, grid.cells_per_meter = self.cell_size, 1.0 / self.cell_size
        return grid

    @public
    def sample(self, xy: npt.ArrayLike) -> np.ndarray:
        """Return the value at points: bilinear between the cells' centres; of whole numbers that of the point's cell.

        At the outer edge and beside cells without data, of the four centres around a point the missing ones drop out,
        so that a value goes on unchanged through the outer half cell.

        Args:
            xy: (n, 2) points in m.

        Returns:
            (n,) float64; NaN off the raster and in cells without data. Whole numbers are exact up to 2^53.
        """
        points: DeviceArray = wp.array(checked_points(xy, "xy", finite=False), dtype=wp.vec2d, device=self.device)
        if self.is_integer:
            return self._sample_cells(points)
        out = wp.empty(len(points), dtype=wp.float64, device=self.device)
        inputs = [self.values, self.grid(), points]
        launch_kernel(kernels.build(wp.float64).sample_values, len(points), inputs, [out], device=self.device)
        sampled: np.ndarray = out.numpy().copy()
        return sampled

    def _sample_cells(self, points: DeviceArray) -> np.ndarray:
        """Return whole numbers of the cells that points lie in, as float64; NaN off the raster."""
        rows, columns = self.shape
        if rows * columns >= 2**31:
            raise InputError(f"whole numbers of {rows} x {columns} cells; 2^31 is the limit, sample a crop of them")
        cell = wp.empty(len(points), dtype=wp.int32, device=self.device)
        inside = wp.empty(len(points), dtype=wp.uint8, device=self.device)
        inputs = [rows, columns, self.grid(), points]
        launch_kernel(kernels.build(wp.float64).find_cells, len(points), inputs, [cell, inside], device=self.device)
        if not len(points):
            return np.empty(0)
        # Gathered on the device, so that the points' values alone come to the host.
        value = wp.indexedarray(self.values.flatten(), [cell]).numpy()
        return np.where(inside.numpy(), value.astype(np.float64), np.nan)

    @public
    def crop(self, bounds: Sequence[float] | np.ndarray, *, what: str = "raster") -> Raster:
        """Return the cells whose centres lie within (west, south, east, north) in m; errors call it ``what``."""
        west, south, east, north = finite_numbers(bounds, 4, "bounds")
        window = self.window(west, south, east, north)
        if not (west < east and south < north) or window is None or min(window[2:]) < 2:
            raise InputError(
                f"bounds ({west:g}, {south:g}, {east:g}, {north:g}) hold fewer than 2 x 2 cells of the {what}, which "
                f"lies within {tuple(round(b, 3) for b in self.bounds)}; give (west, south, east, north) in m"
            )
        row, column, rows, columns = window
        cells = wp.clone(self.values[row : row + rows, column : column + columns].contiguous())
        origin = (self.origin[0] + column * self.cell_size, self.origin[1] - row * self.cell_size)
        return Raster.wrap(cells, self.cell_size, origin, self.crs, self.unit, self.name)

    def window(self, west: float, south: float, east: float, north: float) -> tuple[int, int, int, int] | None:
        """Return (first row, first column, rows, columns) of the cells with centres in a box; None if none has."""
        size, (rows, columns) = self.cell_size, self.shape
        first_column = max(math.ceil((west - self.origin[0]) / size - 0.5), 0)
        last_column = min(math.floor((east - self.origin[0]) / size - 0.5), columns - 1)
        first_row = max(math.ceil((self.origin[1] - north) / size - 0.5), 0)
        last_row = min(math.floor((self.origin[1] - south) / size - 0.5), rows - 1)
        if first_column > last_column or first_row > last_row:
            return None
        return first_row, first_column, last_row - first_row + 1, last_column - first_column + 1

    def centers(self, window: tuple[int, int, int, int]) -> tuple[float, float, float, float]:
        """Return (west, south, east, north) in m of the outer centres in (first row, first column, rows, columns)."""
        (row, column, rows, columns), (west, north), size = window, self.origin, self.cell_size
        left, top = west + (column + 0.5) * size, north - (row + 0.5) * size
        return left, top - (rows - 1) * size, left + (columns - 1) * size, top

    def cells(self, window: tuple[int, int, int, int]) -> np.ndarray:
        """Return a copy of the values in (first row, first column, rows, columns), on the host."""
        cells: np.ndarray = self._cut(window).numpy().copy()
        return cells

    def put_cells(self, window: tuple[int, int, int, int], values: np.ndarray) -> None:
        """Put values of its type into (first row, first column, rows, columns), in place."""
        self._cut(window).assign(values)

    def _cut(self, window: tuple[int, int, int, int]) -> DeviceArray:
        row, column, rows, columns = window
        cut: DeviceArray = self.values[row : row + rows, column : column + columns]
        return cut

    def to_xarray(self) -> xarray.DataArray:
        """Return an ``xarray.DataArray`` of dimensions (y, x), row 0 in the north (``warpriver[gis]``).

        The coordinates are the cells' centres in m; ``spatial_ref`` holds the CRS in the CF convention.
        """
        (module,) = need("to_xarray", "xarray")
        (rows, columns), (west, north), size = self.shape, self.origin, self.cell_size
        reference: dict[str, Any] = {}
        pyproj = pyproj_or_none()
        if self.crs is not None:
            reference = pyproj.CRS(self.crs).to_cf() if pyproj else {}
            reference |= {"spatial_ref": reference.get("crs_wkt", self.crs)}
        reference["GeoTransform"] = " ".join(repr(float(v)) for v in (west, size, 0.0, north, 0.0, -size))
        # No "axis": with it ParaView takes metres for degrees and wraps the map round a sphere.
        y_named, x_named = ({"units": "m", "standard_name": f"projection_{axis}_coordinate"} for axis in "yx")
        y = ("y", north - (np.arange(rows) + 0.5) * size, y_named)
        x = ("x", west + (np.arange(columns) + 0.5) * size, x_named)
        told = {"units": self.unit} if self.unit else {}
        told |= {"long_name": self.name} if self.name else {}
        labelled: xarray.DataArray = module.DataArray(
            self.numpy(),
            dims=("y", "x"),
            coords={"y": y, "x": x, "spatial_ref": ((), 0, reference)},
            name=self.name or None,
            attrs=told | {"grid_mapping": "spatial_ref"},
        )
        return labelled

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"values": self.values.numpy(), "on": self.device.alias}

    def __setstate__(self, state: dict[str, Any]) -> None:
        array, device = state["values"], present_device(state["on"], "a raster")
        self.__dict__.update({key: value for key, value in state.items() if key != "on"})
        self.values = wp.array(array, dtype=wp.dtype_from_numpy(array.dtype), device=device)

    def __deepcopy__(self, memo: dict[int, Any]) -> Raster:
        return self.copy()

    def __repr__(self) -> str:
        label = self.name or "unnamed"
        return f"Raster({label}{f' in {self.unit}' if self.unit else ''}, {self.summary('values', self.unit)})"

    def _repr_html_(self) -> str:
        facts = {"name": self.name or "unnamed", **self.facts("values", self.unit)}
        return card("Raster", facts, self._repr_png_())

    def _repr_png_(self) -> bytes:
        return png_of(raster_picture(self.values.numpy(), self.cell_size, heights=False))

    def facts(self, word: str, unit: str) -> dict[str, str]:
        """Return what a notebook tells of a raster, whose values are called ``word``."""
        array = self.values.numpy()
        (rows, columns), gap = self.shape, np.isnan(array)
        form = "d" if self.is_integer else ".6g"
        span = "none" if gap.all() else f"{np.nanmin(array):{form}} to {np.nanmax(array):{form}} {unit}".rstrip()
        return {
            "cells": f"{rows} x {columns} of {self.cell_size:.6g} m",
            word: span,
            "no data": f"{100.0 * gap.mean():.3g} %",
            "west, south, east, north": ", ".join(f"{v:.10g}" for v in self.bounds),
            "CRS": short_name(self.crs),
        }

    def summary(self, word: str, unit: str) -> str:
        """Size, place and span of the values, for a ``repr``."""
        array = self.values.numpy()
        (rows, columns), gap = self.shape, np.isnan(array)
        size = f"{columns * self.cell_size / 1e3:.4g} x {rows * self.cell_size / 1e3:.4g} km"
        form = "d" if self.is_integer else ".6g"
        span = "no data" if gap.all() else f"{word} {np.nanmin(array):{form}} to {np.nanmax(array):{form}} {unit}"
        kind = f" {self.dtype}" if self.is_integer else ""
        missing = f", {100.0 * gap.mean():.3g} % no data" if gap.any() and not gap.all() else ""
        crs = None if self.crs is None else short_name(self.crs)
        return (
            f"{rows} x {columns}{kind} cells of {self.cell_size:.6g} m, {size}, {span.rstrip()}{missing}, crs={crs}, "
            f"on {self.device.alias}"
        )


def checked_grid(cell_size: Any, origin: Any) -> tuple[float, tuple[float, float]]:
    """Return cell size and origin as numbers, or raise ``ValueError``."""
    west, north = finite_numbers(origin, 2, "origin")
    return positive(cell_size, "cell_size", "m"), (west, north)


def checked_values(
    values: npt.ArrayLike | DeviceArray,
    device: wp.DeviceLike,
    *,
    integers: bool,
    word: str = "values",
    unit: str = "",
    what: str = "a raster",
) -> np.ndarray:
    """Return values of cells on the host, NaN for no data.

    Args:
        values: Numbers as (rows, columns): anything that NumPy takes, masked arrays or a device array.
        device: Where they are to lie.
        integers: Whether whole numbers keep their type; else all become float64.
        word: What they are called, for messages.
        unit: Unit that they must have.
        what: What they make, for messages.

    Raises:
        ValueError: Not two dimensions, fewer than 2 x 2 cells, no real numbers, or an infinite one.
        MemoryError: The device has not enough memory for them.
    """
    if hasattr(values, "dims") and hasattr(values, "coords"):
        read = "wr.io.raster_from_xarray" if integers else "wr.from_xarray"
        raise InputError(f"{word} is an xarray array, whose rows may run from the south; {read} reads it as it lies")
    try:
        source: Any = values.numpy() if isinstance(values, wp.array) else values
        source = source if hasattr(source, "shape") else np.asarray(source)
        if len(source.shape) != 2 or min(source.shape) < 2:
            raise InputError(f"its shape is {source.shape}")
        kind = _cell_type(source, integers)
        # The device's copy and a mask; and the array's own, unless it has the right type already.
        own = 0 if getattr(source, "dtype", None) == kind else kind.itemsize
        require_memory(source.shape, kind.itemsize + 1 + own, device, what)
        if isinstance(source, np.ma.MaskedArray) and kind.kind == "f":
            source = np.ma.filled(source.astype(np.float64), np.nan)
        array = np.asarray(source, kind)
    except (TypeError, ValueError) as error:
        needed = f"numbers as (rows, columns), {f'in {unit}, ' if unit else ''}at least 2 of each"
        raise InputError(f"{word} cannot be used ({error}); give {needed}") from error
    refuse_infinite(array, word)
    return array


def refuse_infinite(values: np.ndarray, word: str) -> None:
    """Raise ``ValueError`` that names the first infinite cell."""
    infinite = np.isinf(values)
    if infinite.any():
        row, column = np.unravel_index(int(infinite.argmax()), values.shape)
        raise InputError(
            f"{word}: infinite in {int(infinite.sum())} cells, the first at row {row}, column {column}; "
            "write NaN for no data"
        )


def _cell_type(source: Any, integers: bool) -> np.dtype:
    """Return the type that values get in the cells: float64, or the whole type that they have."""
    kind = np.dtype(getattr(source, "dtype", np.float64)).newbyteorder("=")
    if kind.kind == "c":
        raise InputError("its numbers are complex")
    if not integers or kind.kind not in "iub" or np.ma.is_masked(source):
        return np.dtype(np.float64)
    return np.dtype(np.uint8) if kind.kind == "b" else kind


def _text(value: Any, name: str) -> str:
    """Return a word, or raise ``ValueError``."""
    if not isinstance(value, str):
        raise InputError(
            f'{name} is {shown(value)}; give text, such as "{"m2" if name == "unit" else "drainage_area"}"'
        )
    return value
