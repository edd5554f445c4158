"""The animated surface of water: a blend-flow tree, evaluated at places and times [Peytavie2019], Sec. 6."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.device import PRECISIONS, launch_kernel, put_on_device, resolve_device
from warpriver.errors import InputError
from warpriver.kernels import flow_tree
from warpriver.kernels import water as kernels
from warpriver.public import public
from warpriver.riverscape.primitives import Merge, Node, Primitives, Replace
from warpriver.riverscape.programs import CELLS_ACROSS, TileFrame, write_programs
from warpriver.validate import finite_numbers, positive, real

__all__ = ["Water", "WaterGrid", "WaterSample"]


# Longest time that is accepted, s: 30,000 years. Shortest loop, s.
LONGEST, SHORTEST_LOOP = 1e12, 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class WaterSample:
    """The water surface at places.

    Attributes:
        elevation: (n,) m; NaN where no primitive reaches.
        still: (n,) elevation without waves, m.
        velocity: (n, 2) m/s.
        effervescence: (n,) white water, 0 to 1.
        weight: (n,) sum of the weights of the primitives; 0 where there are none.
    """

    elevation: FloatArray
    still: FloatArray
    velocity: FloatArray
    effervescence: FloatArray
    weight: FloatArray


@dataclasses.dataclass(frozen=True, eq=False)
class WaterGrid:
    """The water surface on a grid, row 0 in the north, on the device that it was evaluated on.

    Attributes:
        elevation: (rows, columns) float64, m; NaN where no primitive reaches.
        still: The same without waves.
        velocity: (rows, columns) pairs, m/s.
        effervescence: (rows, columns), 0 to 1.
        weight: (rows, columns), 0 where there is no water.
        origin: West and north edge, m.
        cell_size: m.
    """

    elevation: DeviceArray
    still: DeviceArray
    velocity: DeviceArray
    effervescence: DeviceArray
    weight: DeviceArray
    origin: tuple[float, float]
    cell_size: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.elevation.shape[0], self.elevation.shape[1]


class Water:
    """A blend-flow tree on a device.

    Args:
        tree: Primitives, merged and replaced.
        cell_size: Of the cells that know what reaches them, m; by default such that most primitives reach few.
        contrast: Whether waves are mixed over the root of the sum of squared weights, so that they are as high between
            centres as at them; else by the weighted mean, as in the document, by which they fade there.
        noise: "baked": octaves of noise in periodic tables, once continuously differentiable; "exact": noise itself.
        dtype: "float32", or "float64" for tests; elevations are float64 in both.
        leaf: Own leaves: a ``wp.func`` of (kind: int, offset from the centre: vec2 in m, weight, shape: vec3, phase:
            vec4) that returns vec4 (height above the primitive's plane in m, velocity to add in m/s, effervescence to
            add), all in the given precision; called for kinds from 7 on.
        frame: That of another water, to give the same bits where both are alike; by default one of its own.
        device: Warp device.

    Attributes:
        primitives: All leaves, in the order of the tree.
        frame: What places and levels are relative to.
        bytes_per_primitive: Of the arrays that hold them.

    Raises:
        ValueError: A tree that cannot be compiled, or a choice that is none of these.
    """

    @public
    def __init__(
        self,
        tree: Primitives | Merge | Replace,
        *,
        cell_size: float | None = None,
        contrast: bool = True,
        noise: str = "baked",
        dtype: str = "float32",
        leaf: Callable[..., Any] | None = None,
        frame: TileFrame | None = None,
        device: wp.DeviceLike = "cpu",
    ) -> None:
        if noise not in ("baked", "exact"):
            raise InputError(f"noise is {noise!r}; use 'baked' or 'exact'")
        if dtype not in PRECISIONS:
            raise InputError(f"dtype is {dtype!r}; use 'float32' or 'float64'")
        self.tree: Node = tree
        self.contrast, self.noise, self.dtype = bool(contrast), noise, dtype
        self.device = resolve_device(device)
        scalar, _, self._real = PRECISIONS[dtype]
        self._kernels = kernels.build(scalar)
        self._evaluate = self._kernels.evaluate_water if leaf is None else _own_kernel(leaf, scalar)
        size = None if cell_size is None else positive(cell_size, "cell_size", "m")
        programs = write_programs(tree, size, frame)
        self.frame = programs.frame
        self.primitives, self.origin, self.cell_size = programs.rows, programs.origin, programs.cell_size
        if leaf is None and (self.primitives.kind >= flow_tree.OWN).any():
            raise InputError("the tree has own leaves (kinds from 7 on); give their function as leaf=")
        self._rows = self._rows_on_device(programs)
        self._cells = self._cells_on_device(programs)
        self._noise = self._kernels.Noise()
        self._noise.exact = int(noise == "exact")
        self._noise.coefficient = _noise_table(scalar, self.device.alias)
        arrays = [
            getattr(self._rows, name) for name in ("place", "flow", "look", "shape", "phase", "kind", "tile", "offset")
        ]
        self.bytes_per_primitive = sum(array.capacity for array in arrays) // len(self.primitives)
        self._time: float | None = None

    @public
    def at(self, xy: ArrayLike, time: float = 0.0) -> WaterSample:
        """Evaluate the surface at places.

        Args:
            xy: (n, 2) m.
            time: s.

        Raises:
            ValueError: Places or a time that are not finite.

        Source:
            [Peytavie2019], Sec. 6.
        """
        try:
            points = np.asarray(xy, np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(f"xy cannot be used ({error}); give (n, 2) places in m") from error
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise InputError(f"xy has shape {points.shape}, or a value that is not finite; give (n, 2) places in m")
        self._set_time(time)
        surface = self._surface(len(points))
        if len(points):
            local = put_on_device(points - self.origin, wp.vec2d, self.device)
            inputs = [self._rows, self._noise, self._cells, self._kernels.Grid(), local]
            launch_kernel(self._evaluate, len(points), inputs, [surface], device=self.device)
        return WaterSample(
            surface.elevation.numpy(),
            surface.still.numpy(),
            surface.velocity.numpy().astype(np.float64),
            surface.foam.numpy().astype(np.float64),
            surface.weight.numpy().astype(np.float64),
        )

    @public
    def on_grid(
        self, origin: tuple[float, float] | FloatArray, cell_size: float, shape: tuple[int, int], time: float = 0.0
    ) -> WaterGrid:
        """Evaluate the surface at the centres of the cells of a grid.

        Args:
            origin: West and north edge, m.
            cell_size: m.
            shape: Rows and columns.
            time: s.

        Raises:
            ValueError: No such grid.

        Source:
            [Peytavie2019], Sec. 6.
        """
        west, north = finite_numbers(origin, 2, "origin")
        size = positive(cell_size, "cell_size", "m")
        rows, columns = (int(v) for v in finite_numbers(shape, 2, "shape"))
        if min(rows, columns) < 1 or rows * columns >= 2**31:
            raise InputError(f"shape is {rows} x {columns}; give at least one cell, and fewer than 2^31")
        self._set_time(time)
        surface = self._surface(rows * columns)
        grid = self._kernels.Grid()
        grid.west, grid.north = west + 0.5 * size - self.origin[0], north - 0.5 * size - self.origin[1]
        grid.cell_size, grid.columns = size, columns
        nowhere = wp.empty(0, dtype=wp.vec2d, device=self.device)
        inputs = [self._rows, self._noise, self._cells, grid, nowhere]
        launch_kernel(self._evaluate, rows * columns, inputs, [surface], device=self.device)
        names = ("elevation", "still", "velocity", "foam", "weight")
        elevation, still, velocity, foam, weight = (getattr(surface, name).reshape((rows, columns)) for name in names)
        return WaterGrid(elevation, still, velocity, foam, weight, (west, north), size)

    @public
    def loop_grid(
        self,
        origin: tuple[float, float] | FloatArray,
        cell_size: float,
        shape: tuple[int, int],
        time: float,
        period: float,
    ) -> WaterGrid:
        """Evaluate a surface that repeats itself without a seam: one time fades into another, a period earlier.

        Each primitive's waves are scaled by the correlation of its noise over the period, so that they neither grow nor
        fade on the way.

        Args:
            origin: West and north edge, m.
            cell_size: m.
            shape: Rows and columns.
            time: s.
            period: s, at least 1.

        Raises:
            ValueError: No such grid, or a period in which water would shiver rather than flow.
        """
        whole = positive(period, "period", "s")
        if whole < SHORTEST_LOOP:
            raise InputError(f"period is {whole:g} s; give {SHORTEST_LOOP:g} s or more: shorter loops look like jelly")
        now = real(time) % whole
        x = now / whole
        share = 1.0 - x * x * (3.0 - 2.0 * x)
        alike = self._alike_after(whole)
        size = np.sqrt(share**2 + (1.0 - share) ** 2 + 2.0 * alike * share * (1.0 - share))
        late = self._scaled_grid(share / size, origin, cell_size, shape, now)
        early = self._scaled_grid((1.0 - share) / size, origin, cell_size, shape, now - whole)
        surfaces = [self._flat(grid) for grid in (early, late)]
        scalar = PRECISIONS[self.dtype][0]
        inputs = [scalar(share), surfaces[0]]
        count = late.shape[0] * late.shape[1]
        launch_kernel(self._kernels.fade_surfaces, count, inputs, [surfaces[1]], device=self.device)
        return late

    def _alike_after(self, period: float) -> FloatArray:
        """Correlation of each primitive's noise with itself a period later."""
        p = self.primitives
        speed = np.hypot(*p.velocity.T)
        vortex = p.kind == flow_tree.VORTEX
        # A vortex turns: what lies half way to its rim moves by so much.
        speed[vortex] = 2.0 * np.abs(np.sin(0.5 * p.shape[vortex, 1] * period)) * 0.5 * p.radius[vortex] / period
        lag, value = _noise_correlation()
        return np.asarray(np.interp(speed * period / p.wavelength, lag, value))

    def _scaled_grid(self, gain: FloatArray, *where: Any) -> WaterGrid:
        """Evaluate a grid with the waves of each primitive scaled."""
        kept = self._rows.look
        p = self.primitives
        look = np.column_stack([gain * p.amplitude, 1.0 / p.wavelength, p.effervescence]).astype(self._real)
        self._rows.look = wp.array(look, dtype=self._kernels.vec3, device=self.device)
        try:
            return self.on_grid(*where)
        finally:
            self._rows.look = kept

    def _flat(self, grid: WaterGrid) -> Any:
        surface = self._kernels.Surface()
        for name, array in (
            ("elevation", grid.elevation),
            ("still", grid.still),
            ("velocity", grid.velocity),
            ("foam", grid.effervescence),
            ("weight", grid.weight),
        ):
            setattr(surface, name, array.flatten())
        return surface

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north of all primitives, m."""
        low = (self.primitives.center - self.primitives.radius[:, None]).min(axis=0)
        high = (self.primitives.center + self.primitives.radius[:, None]).max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def _set_time(self, time: float) -> None:
        """Carry the noise of all primitives to a time."""
        t = real(time)
        if not abs(t) <= LONGEST:
            raise InputError(f"time is {time!r}; give seconds, at most {LONGEST:g}")
        if t != self._time:
            outputs = [self._rows.phase]
            inputs = [self._rows, wp.float64(t)]
            launch_kernel(self._kernels.set_phases, len(self.primitives), inputs, outputs, device=self.device)
            self._time = t

    def _surface(self, count: int) -> Any:
        surface = self._kernels.Surface()
        for name, kind in (
            ("elevation", wp.float64),
            ("still", wp.float64),
            ("velocity", self._kernels.vec2),
            ("foam", PRECISIONS[self.dtype][0]),
            ("weight", PRECISIONS[self.dtype][0]),
        ):
            setattr(surface, name, wp.empty(count, dtype=kind, device=self.device))
        return surface

    def _rows_on_device(self, programs: Any) -> Any:
        """Pack the leaves: places relative to tiles, levels to the tiles' datums."""
        p, made = programs.rows, self._kernels
        side = CELLS_ACROSS * programs.cell_size
        columns = programs.tile_shape[1]
        tile = np.column_stack([programs.row_tile % columns, programs.row_tile // columns])
        corner = side * (tile + programs.tile_corner)
        place = np.empty((len(p), 4))
        place[:, :2] = p.center - programs.origin - corner
        place[:, 2] = p.radius
        place[:, 3] = p.level - programs.tile_datum[programs.row_tile]
        form = p.shape.copy()
        # Shear is given from the centre to the rim; kernels take it a metre.
        vortex = p.kind == flow_tree.VORTEX
        form[vortex, 0] /= p.radius[vortex]
        rows = made.Primitives()

        def put(values: ArrayLike, kind: Any, real_type: Any) -> DeviceArray:
            return put_on_device(np.asarray(values, real_type), kind, self.device)

        rows.place = put(place, made.vec4, self._real)
        rows.flow = put(np.column_stack([p.gradient, p.velocity]), made.vec4, self._real)
        rows.look = put(np.column_stack([p.amplitude, 1.0 / p.wavelength, p.effervescence]), made.vec3, self._real)
        rows.shape = put(form, made.vec3, self._real)
        rows.phase = wp.zeros(len(p), dtype=made.vec4, device=self.device)
        rows.kind = put(p.kind, wp.int32, np.int32)
        rows.tile = put(programs.row_tile, wp.int32, np.int32)
        rows.offset = put(p.offset.astype(np.uint32).view(np.int32), wp.int32, np.int32)
        return rows

    def _cells_on_device(self, programs: Any) -> Any:
        cells = self._kernels.Cells()
        cells.tile_size = CELLS_ACROSS * programs.cell_size
        cells.tile_rows, cells.tile_columns = programs.tile_shape
        cells.tile_west, cells.tile_south = programs.tile_corner
        cells.cell_size, cells.cells_across = programs.cell_size, CELLS_ACROSS
        for name, values in (
            ("tile_first", programs.tile_first),
            ("cell_start", programs.cell_start),
            ("code", programs.code),
        ):
            setattr(cells, name, put_on_device(values.astype(np.int32, copy=False), wp.int32, self.device))
        cells.tile_datum = put_on_device(programs.tile_datum.astype(self._real), PRECISIONS[self.dtype][0], self.device)
        cells.contrast = int(self.contrast)
        return cells

    def __repr__(self) -> str:
        west, south, east, north = self.bounds
        return f"Water({self.primitives!r}, {east - west:.4g} x {north - south:.4g} m, on {self.device.alias})"


@functools.cache
def _noise_table(scalar: Any, alias: str) -> DeviceArray:
    """Coefficients of the periodic quadratic B-splines through the noise at the texels, for a device."""
    size, made = flow_tree.TEXELS, kernels.build(scalar)
    value = wp.empty((flow_tree.TABLES, size, size), dtype=wp.float64, device=alias)
    launch_kernel(made.bake_noise, value.shape, [], [value], device=alias)
    # A quadratic B-spline has 1/8, 3/4, 1/8 at its texels.
    response = 0.75 + 0.25 * np.cos(2.0 * np.pi * np.fft.fftfreq(size))
    spectrum = np.fft.fft2(value.numpy(), axes=(1, 2)) / (response[:, None] * response)
    coefficient = np.fft.ifft2(spectrum, axes=(1, 2)).real
    # The kernels add 0, 1 and 2 to the texel before a place.
    padded = np.pad(coefficient, ((0, 0), (1, 1), (1, 1)), mode="wrap")
    return wp.array(padded.reshape(-1).astype(PRECISIONS[scalar.__name__][2]), device=alias)


@functools.cache
def _noise_correlation() -> tuple[FloatArray, FloatArray]:
    """Lags in wavelengths, and the mean correlation of the tables of noise with themselves that far away."""
    size = flow_tree.TEXELS
    table = _noise_table(wp.float64, "cpu").numpy().reshape(flow_tree.TABLES, size + 2, size + 2)[:, 1:-1, 1:-1]
    power = np.abs(np.fft.fft2(table - table.mean(axis=(1, 2), keepdims=True), axes=(1, 2))) ** 2
    likeness = np.fft.ifft2(power, axes=(1, 2)).real
    likeness = (likeness / likeness[:, :1, :1]).mean(axis=0)
    lag = np.arange(size // flow_tree.PERIOD * 2)
    # Along both axes; beyond two wavelengths nothing is left.
    value = 0.5 * (likeness[0, lag] + likeness[lag, 0])
    return np.append(lag * flow_tree.PERIOD / size, 2.5), np.append(np.clip(value, -0.5, 1.0), 0.0)


@functools.cache
def _own_kernel(leaf: Any, scalar: Any) -> Any:
    """The kernel whose own leaves are those of a user's function."""
    if not isinstance(leaf, wp.Function):
        raise InputError(f"leaf is a {type(leaf).__name__}; decorate it with @wp.func")
    return kernels.build(scalar).evaluator(leaf, f"warpriver.own_water_{_own_kernel.cache_info().misses}")
