"""Controls of migration: fields that attract and repel channels, and regions where they migrate faster or slower.

All controls are stamped into two rasters, so that thousands of them cost a step what one costs: the control field c,
whose gradient steers the channels, and the factor of the rate. Off these rasters nothing is controlled [Paris2023],
section 5.2.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import FloatArray
from warpriver.device import require_memory
from warpriver.errors import InputError, InputTypeError, MissingExtraError, MissingFileError
from warpriver.parameter import Params, parameter
from warpriver.raster import Raster
from warpriver.terrain import Terrain
from warpriver.validate import checked_points, finite_numbers, floats, not_negative, positive

if TYPE_CHECKING:
    from warpriver.meander.control_map import ControlMap

__all__ = [
    "Attractor",
    "Control",
    "ControlField",
    "DampingRegion",
    "ErodibilityField",
    "Guide",
    "RateControl",
    "Repeller",
    "checked_controls",
]

Bounds = tuple[float, float, float, float]

# Cells across the radius of a control.
CELLS_ACROSS = 16.0
# Cells along a side of a field, at most.
MAX_CELLS = 1e6
# Cells across a polygon whose edge is blended over less than four of them; corners of a polygon, or points of a guide,
# at most.
ACROSS_POLYGON, MAX_POINTS = 128.0, 10_000


# The kinds that there are.
GIVEN = "Attractor, Repeller, Guide, ControlField, DampingRegion or ErodibilityField"


class Control:
    """What a control is: a value that stamps itself into the rasters of a :class:`ControlMap`."""

    def bounds(self) -> Bounds:
        """Return what it reaches, (west, south, east, north) in m."""
        raise NotImplementedError

    def cell_size(self) -> float:
        """Return the cell size in m that shows it well."""
        raise NotImplementedError

    def stamp(self, target: ControlMap, window: wp.vec4i) -> None:
        """Add itself to the cells of a window of the map."""
        raise NotImplementedError

    def packed(self) -> tuple[dict[str, Any], FloatArray]:
        """Return what it is as a few words and as numbers, of which a history and files can make it again.

        Raises:
            ValueError: It is of a kind of which they cannot.
        """
        raise InputError(f"a control is a {type(self).__name__}, which no history can keep; give {GIVEN}")

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other) or not dataclasses.is_dataclass(self):
            return self is other
        names = [field.name for field in dataclasses.fields(self)]
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)

    def __hash__(self) -> int:
        return hash((type(self).__name__, self.bounds()))


@dataclasses.dataclass(frozen=True, eq=False)
class Guide(Params, Control):
    """A polyline that draws channels towards it, within ``radius`` on both sides.

    With d the distance to the line and p = d / radius, c = (strength radius / 1.717) (1 - p^2)^3, so that the greatest
    gradient of c is ``strength``.

    Attributes:
        xy: (n, 2) points in m.
        radius: How far it reaches, m.
        strength: Greatest gradient of c; below 0 it repels.
    """

    xy: ArrayLike
    radius: float = parameter(1000.0, "m", low=0.0, low_open=True, source="Paris2023", doc="how far it reaches")
    strength: float = parameter(1.0, "-", source="Paris2023", doc="greatest gradient of c; below 0 it repels")

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "xy", _frozen_points(self.xy, "Guide.xy", 2))

    def bounds(self) -> Bounds:
        """Return what it reaches, (west, south, east, north) in m."""
        return _around(np.asarray(self.xy), self.radius)

    def cell_size(self) -> float:
        """Return the cell size in m that shows it well."""
        return self.radius / CELLS_ACROSS

    def stamp(self, target: ControlMap, window: wp.vec4i) -> None:
        """Add itself to the cells of a window of the map."""
        target.add_bump(np.asarray(self.xy), self.radius, self.strength, window)

    def packed(self) -> tuple[dict[str, Any], FloatArray]:
        """Return its kind, and radius, strength and points."""
        return {"kind": "Guide"}, np.concatenate([[self.radius, self.strength], np.asarray(self.xy).ravel()])


@dataclasses.dataclass(frozen=True, eq=False)
class Attractor(Params, Control):
    """A point that draws channels towards it, within ``radius``.

    With p the distance over the radius, c = (strength radius / 1.717) (1 - p^2)^3, so that the greatest gradient of c
    is ``strength``.

    Attributes:
        center: (x, y) in m.
        radius: How far it reaches, m.
        strength: Greatest gradient of c; below 0 it repels.
    """

    center: tuple[float, float]
    radius: float = parameter(1000.0, "m", low=0.0, low_open=True, source="Paris2023", doc="how far it reaches")
    strength: float = parameter(1.0, "-", source="Paris2023", doc="greatest gradient of the control field")

    def __post_init__(self) -> None:
        super().__post_init__()
        x, y = finite_numbers(self.center, 2, f"{type(self).__name__}.center")
        object.__setattr__(self, "center", (x, y))

    def bounds(self) -> Bounds:
        """Return what it reaches, (west, south, east, north) in m."""
        (x, y), reach = self.center, self.radius
        return x - reach, y - reach, x + reach, y + reach

    def cell_size(self) -> float:
        """Return the cell size in m that shows it well."""
        return self.radius / CELLS_ACROSS

    def stamp(self, target: ControlMap, window: wp.vec4i) -> None:
        """Add itself to the cells of a window of the map."""
        target.add_bump(np.array([self.center]), self.radius, self.strength, window)

    def packed(self) -> tuple[dict[str, Any], FloatArray]:
        """Return its kind, and centre, radius and strength."""
        return {"kind": type(self).__name__}, np.array([*self.center, self.radius, self.strength])


@dataclasses.dataclass(frozen=True, eq=False)
class Repeller(Attractor):
    """A point that drives channels away from it: an :class:`Attractor` with -c."""

    def stamp(self, target: ControlMap, window: wp.vec4i) -> None:
        """Add itself to the cells of a window of the map."""
        target.add_bump(np.array([self.center]), self.radius, -self.strength, window)


class ControlField(Control):
    """A painted control field: a raster of c in m, above 0 where channels are drawn to, below 0 where driven from.

    Its gradient has no unit: a slope of 1 moves a bend by its own rate. Cells without data, and all beyond the raster,
    count as 0.

    Attributes:
        raster: The values in m.
    """

    raster: Raster
    #: Bounds of all that was painted so far, in order, m.
    strokes: list[Bounds]

    def __init__(
        self,
        values: ArrayLike | Raster,
        cell_size: float | None = None,
        origin: Sequence[float] = (0.0, 0.0),
        *,
        crs: str | None = None,
        device: str | wp.Device = "cpu",
    ):
        """Take a raster, or copy values to the device.

        Args:
            values: Raster of values in m, as ``wr.io.read_raster`` reads one; or (rows, columns) numbers, row 0 in the
                north, with their cell size and origin.
            cell_size: Length of a cell's side in m; for numbers only.
            origin: (west, north), the outer corner of the first cell in m; for numbers only.
            crs: Coordinate reference system; for numbers only.
            device: Warp device; for numbers only.

        Raises:
            ValueError: A raster of whole numbers, numbers without a cell size, or what :class:`Raster` refuses.
        """
        self.strokes = []
        if isinstance(values, Raster):
            if cell_size is not None:
                raise InputError("cell_size is given beside a Raster, which has its own; give one of them")
            self.raster = values if not values.is_integer else values.like(values.numpy().astype(np.float64))
            return
        if cell_size is None:
            raise InputError("cell_size is missing; give the length of a cell's side in m")
        numbers = floats(values, "values") if not np.ma.isMaskedArray(values) else values
        self.raster = Raster(numbers, cell_size, origin, crs, "m", "control", device=device)

    @classmethod
    def blank(
        cls, bounds: Sequence[float], cell_size: float, *, crs: str | None = None, device: str = "cpu"
    ) -> ControlField:
        """Return a field of zeros to paint on.

        Args:
            bounds: (west, south, east, north) in m; the east and south edges move out to whole cells.
            cell_size: Length of a cell's side in m.
            crs: Coordinate reference system.
            device: Warp device.
        """
        west, south, east, north = finite_numbers(bounds, 4, "bounds")
        if not (east > west and north > south):
            raise InputError(f"bounds are {tuple(bounds)}; give (west, south, east, north) in m")
        cell_size = positive(cell_size, "cell_size", "m")
        if max(north - south, east - west) > MAX_CELLS * cell_size:
            raise InputError(f"bounds span more than {MAX_CELLS:g} cells of {cell_size:g} m; give a coarser cell_size")
        shape = tuple(max(2, math.ceil(span / cell_size - 1e-9)) for span in (north - south, east - west))
        require_memory(shape, 8, device, "a control field")
        return cls(np.zeros(shape), cell_size, (west, north), crs=crs, device=device)

    @classmethod
    def from_gray(
        cls, values: ArrayLike, bounds: Sequence[float], height: float, *, crs: str | None = None
    ) -> ControlField:
        """Return the field that a gray image paints: its darkest value is -height, its middle 0, its brightest height.

        Args:
            values: (rows, columns) gray values, row 0 in the north: whole numbers from 0 to 255 or 65,535, by their
                type, or real ones from 0 to 1.
            bounds: (west, south, east, north) in m that the image covers; its pixels must be square.
            height: Greatest value of c in m.
            crs: Coordinate reference system.

        Raises:
            ValueError: An image that is not gray or whose pixels are not square.
        """
        gray = np.asarray(values)
        if gray.ndim != 2 or min(gray.shape) < 2:
            raise InputError(f"the image has shape {gray.shape}; give gray values, (rows, columns)")
        if gray.dtype.kind == "u":
            gray = gray / float(np.iinfo(gray.dtype).max)
        gray = np.asarray(gray, np.float64)
        if not np.isfinite(gray).all() or gray.min() < 0.0 or gray.max() > 1.0:
            raise InputError("the gray values must lie from 0 to 1, or be whole numbers of 8 or 16 bits without a sign")
        west, south, east, north = finite_numbers(bounds, 4, "bounds")
        (height,) = finite_numbers([height], 1, "height")
        size = (east - west) / gray.shape[1], (north - south) / gray.shape[0]
        if not size[0] > 0.0 or abs(size[0] - size[1]) > 1e-3 * size[0]:
            raise InputError(
                f"bounds give pixels of {size[0]:g} x {size[1]:g} m; give (west, south, east, north) with square ones"
            )
        return cls((2.0 * gray - 1.0) * height, size[0], (west, north), crs=crs)

    @classmethod
    def from_image(
        cls, path: str | os.PathLike[str], bounds: Sequence[float], height: float, *, crs: str | None = None
    ) -> ControlField:
        """Return the field that a gray image file paints, as :meth:`from_gray` (``warpriver[viz]``).

        A GeoTIFF of values in m has its place: ``ControlField(wr.io.read_raster(path))``.

        Args:
            path: PNG, JPEG, TIFF ...; of colours their mean counts.
            bounds: (west, south, east, north) in m that the image covers.
            height: Greatest value of c in m.
            crs: Coordinate reference system.

        Raises:
            ImportError: imageio is missing.
            ValueError: The file cannot be read as an image, or its pixels are not square.
        """
        try:
            imageio = importlib.import_module("imageio.v3")
        except ImportError as error:
            raise MissingExtraError('ControlField.from_image needs imageio: pip install "warpriver[viz]"') from error
        if not isinstance(path, (str, os.PathLike)):
            raise InputTypeError(f"path is a {type(path).__name__}; give the path of an image")
        if not os.path.isfile(path):
            raise MissingFileError(f"no image at {path}")
        try:
            pixels = np.asarray(imageio.imread(path, plugin="pillow"))
        except (OSError, ValueError, SyntaxError) as error:
            raise InputError(f"{path} cannot be read as an image: {error}") from error
        if pixels.ndim == 3:
            whole = pixels.dtype.kind == "u"
            colors = pixels[..., :3] if pixels.shape[2] > 2 else pixels[..., :1]
            pixels = colors.mean(axis=2) / (np.iinfo(pixels.dtype).max if whole else 1.0)
        return cls.from_gray(pixels, bounds, height, crs=crs)

    def paint(self, center: Sequence[float], radius: float, amount: float) -> None:
        """Add to the field under a round brush, whose weight falls smoothly from 1 at its centre to 0.

        Args:
            center: (x, y) in m.
            radius: m.
            amount: m at the centre; below 0 it repels.
        """
        (amount,) = finite_numbers([amount], 1, "amount")
        kind: Literal["raise", "lower"] = "raise" if amount >= 0.0 else "lower"
        Terrain.wrap_raster(self.raster).brush(kind, center, radius, abs(amount))
        self._note_stroke(center, radius)

    def erase(self, center: Sequence[float], radius: float, share: float = 1.0) -> None:
        """Draw the field towards 0 under a round brush.

        Args:
            center: (x, y) in m.
            radius: m.
            share: How much of it is taken away at the centre, 0 to 1.
        """
        Terrain.wrap_raster(self.raster).brush("flatten", center, radius, share, level=0.0)
        self._note_stroke(center, radius)

    def smooth(self, center: Sequence[float], radius: float, share: float = 1.0) -> None:
        """Blend the field with its local mean under a round brush; see :meth:`warpriver.Terrain.brush`."""
        Terrain.wrap_raster(self.raster).brush("smooth", center, radius, share)
        self._note_stroke(center, radius)

    def mark_painted(self, bounds: Sequence[float] | None = None) -> None:
        """Tell that the values of ``raster`` were edited otherwise, within (west, south, east, north) in m or all."""
        west, south, east, north = finite_numbers(self.raster.bounds if bounds is None else bounds, 4, "bounds")
        self.strokes.append((west, south, east, north))

    def _note_stroke(self, center: Sequence[float], radius: float) -> None:
        (x, y), reach = center, float(radius)
        self.strokes.append((float(x) - reach, float(y) - reach, float(x) + reach, float(y) + reach))

    def bounds(self) -> Bounds:
        """Return what it reaches, (west, south, east, north) in m."""
        return self.raster.bounds

    def cell_size(self) -> float:
        """Return the cell size in m that shows it well."""
        return self.raster.cell_size

    def stamp(self, target: ControlMap, window: wp.vec4i) -> None:
        """Add itself to the cells of a window of the map."""
        target.apply_field("add_field", self.raster, window)

    def packed(self) -> tuple[dict[str, Any], FloatArray]:
        """Return its kind and CRS, and the place and the values of its raster."""
        return _packed_raster(self, self.raster)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ControlField) and _same_raster(self.raster, other.raster)

    __hash__ = Control.__hash__


class RateControl(Control):
    """A factor of the migration rate, in a polygon or by a raster; several multiply."""

    #: Greatest factor that makes sense for this kind.
    highest = math.inf

    def __init__(self, area: ArrayLike | Raster, factor: float | None = None, *, blend: float = 0.0):
        """Take a polygon and its factor, or a raster of factors.

        Args:
            area: (n, 2) corners of a polygon in m, which closes by itself; or a Raster of factors, 1 where it has no
                data and beyond it.
            factor: Factor in the polygon; of a raster none is given.
            blend: Distance inside the polygon's edge over which the factor fades from 1, m.

        Raises:
            ValueError: A factor below 0 or out of range, a polygon of fewer than 3 corners, or a factor or blend beside
                a raster.
        """
        kind = type(self).__name__
        self.blend = not_negative(blend, f"{kind}.blend")
        self.raster: Raster | None = None
        self.polygon: FloatArray | None = None
        if isinstance(area, Raster):
            if factor is not None or blend:
                raise InputError(f"{kind} takes no factor and no blend beside a Raster of factors")
            values = area.numpy()
            wrong = ~((values >= 0.0) & (values <= self.highest)) & ~np.isnan(values)
            if wrong.any():
                row, column = np.unravel_index(int(wrong.argmax()), values.shape)
                raise InputError(
                    f"{kind} has the factor {values[row, column]:g} at row {row}, column {column}; the range is 0 to "
                    f"{self.highest:g}"
                )
            self.raster = area if not area.is_integer else area.like(values.astype(np.float64))
            self.factor = None
            return
        factor = self._default_factor() if factor is None else factor
        self.factor = not_negative(factor, f"{kind}.factor")
        if self.factor > self.highest:
            raise InputError(f"{kind}.factor is {self.factor:g}; the range is 0 to {self.highest:g}")
        self.polygon = _frozen_points(area, f"{kind}.area", 3)
        self._bounds = _around(self.polygon, 0.0)

    def _default_factor(self) -> float:
        raise InputError(f"{type(self).__name__}.factor is missing; give the factor of the rate in the polygon")

    def bounds(self) -> Bounds:
        """Return what it reaches, (west, south, east, north) in m."""
        if self.raster is not None:
            return self.raster.bounds
        return self._bounds

    def cell_size(self) -> float:
        """Return the cell size in m that shows it well."""
        if self.raster is not None:
            return self.raster.cell_size
        west, south, east, north = self.bounds()
        return max(max(east - west, north - south) / ACROSS_POLYGON, 0.25 * self.blend)

    def stamp(self, target: ControlMap, window: wp.vec4i) -> None:
        """Multiply the cells of a window of the map."""
        if self.raster is not None:
            target.apply_field("scale_by_field", self.raster, window)
        else:
            assert self.polygon is not None and self.factor is not None
            target.scale_inside(self.polygon, self.factor, self.blend, window)

    def packed(self) -> tuple[dict[str, Any], FloatArray]:
        """Return its kind, and factor, blend and corners; or as a :class:`ControlField` its raster."""
        if self.raster is not None:
            return _packed_raster(self, self.raster)
        assert self.polygon is not None and self.factor is not None
        return {"kind": type(self).__name__}, np.concatenate([[self.factor, self.blend], self.polygon.ravel()])

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other) or not isinstance(other, RateControl):
            return False
        if self.raster is not None or other.raster is not None:
            return self.raster is not None and other.raster is not None and _same_raster(self.raster, other.raster)
        assert self.polygon is not None and other.polygon is not None
        return (self.factor, self.blend) == (other.factor, other.blend) and np.array_equal(self.polygon, other.polygon)

    __hash__ = Control.__hash__

    def __repr__(self) -> str:
        what = repr(self.raster) if self.polygon is None else f"{len(self.polygon)} corners, factor={self.factor:g}"
        return f"{type(self).__name__}({what})"


class DampingRegion(RateControl):
    """Where channels migrate more slowly, or not at all: a factor from 0 to 1, by default 0 [Paris2023]."""

    highest = 1.0

    def _default_factor(self) -> float:
        return 0.0


class ErodibilityField(RateControl):
    """How easily banks are eroded: a factor of the rate, 0 or more; 1 is the bank that the rate belongs to."""


def checked_controls(controls: object, crs: str | None) -> tuple[Control, ...]:
    """Return controls as a tuple, or raise ``ValueError``."""
    given = (controls,) if isinstance(controls, Control) else controls
    try:
        found: tuple[Any, ...] = tuple(given)  # type: ignore[arg-type]
    except TypeError:
        found = (controls,)
    for control in found:
        if not isinstance(control, Control):
            raise InputError(f"controls holds a {type(control).__name__}; give {GIVEN}")
        raster = getattr(control, "raster", None)
        if raster is not None and crs is not None and raster.crs is not None and raster.crs != crs:
            raise InputError(f"a {type(control).__name__} has the CRS {raster.crs}, the network {crs}; reproject it")
    return found


def _frozen_points(xy: ArrayLike, label: str, count: int) -> FloatArray:
    """Read-only (n, 2) points, at least so many."""
    points = np.array(checked_points(xy, label))
    if not count <= len(points) <= MAX_POINTS:
        raise InputError(f"{label} has {len(points)} points; give {count} to {MAX_POINTS}")
    points.flags.writeable = False
    return points


def _around(points: FloatArray, reach: float) -> Bounds:
    (west, south), (east, north) = points.min(axis=0) - reach, points.max(axis=0) + reach
    return float(west), float(south), float(east), float(north)


def _packed_raster(control: Control, raster: Raster) -> tuple[dict[str, Any], FloatArray]:
    place = [raster.cell_size, *raster.origin, *raster.shape]
    words = {"kind": type(control).__name__, "raster": True, "crs": raster.crs}
    return words, np.concatenate([place, raster.numpy().ravel()])


def _same_raster(a: Raster, b: Raster) -> bool:
    return a is b or (a.matches(b) and np.array_equal(a.numpy(), b.numpy(), equal_nan=True))
