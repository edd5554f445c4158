"""The rasters that controls are stamped into: the control field and the factor of the rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.device import PRECISIONS, launch_kernel, require_memory
from warpriver.errors import InputError
from warpriver.kernels import controls as kernels
from warpriver.kernels import ground as grounds
from warpriver.meander.controls import CELLS_ACROSS, Bounds, Control, RateControl, checked_controls
from warpriver.raster import Raster
from warpriver.terrain import Terrain

__all__ = ["MODES", "ControlMap", "Layout", "changes", "merged"]


# The minimum of cells across the radius of a control that a map of the maximum size may come down to.
MIN_CELLS_ACROSS = 4.0
# Cells of a map at most, bytes that each takes, and cells around what is stamped, where the gradient falls to 0.
MAX_CELLS, CELL_BYTES, RIM = 2**24, 16, 3
# Cells up to which a map is made larger than its controls, so that they may be moved about without another one.
ROOMY_CELLS = 2**20
# How the gradient steers, by the word that ``control_steering`` has for it.
MODES = {"normal": grounds.NORMAL, "vector": grounds.VECTOR, "printed": grounds.PRINTED}


class Layout(NamedTuple):
    """Where the cells of a map lie.

    Attributes:
        cell_size: m.
        west, north: Outer corner of the first cell, m.
        rows, columns: Their numbers.
    """

    cell_size: float
    west: float
    north: float
    rows: int
    columns: int


class ControlMap:
    """The control field and the factor of the rate on one raster, stamped from controls.

    Attributes:
        controls: What is stamped.
        raster: The control field c, a Raster in m.
        factor: Factor of the rate on the same cells.
        layout: Where the cells lie.
        pulls: Whether the control field is read; it is once a control has had one.
        scales: Whether the factor is read, likewise.
    """

    pulls = scales = False

    def __init__(
        self,
        controls: Sequence[Control],
        *,
        area: Bounds | None = None,
        layout: Layout | None = None,
        crs: str | None = None,
        device: Any = "cpu",
    ):
        """Lay a raster over all controls and stamp them.

        Args:
            controls: The controls, one or more.
            area: Bounds in m that the raster holds as well, if few cells are needed for that.
            layout: Where the cells lie; by default where the controls ask for it.
            crs: Coordinate reference system of the network that they steer.
            device: Warp device.

        Raises:
            ValueError: No control, something that is none, or a control whose raster has another CRS.
            MemoryError: The rasters do not fit.
        """
        self.controls = checked_controls(controls, crs)
        if not self.controls:
            raise InputError("controls is empty; give one or more")
        self.layout = _laid_out(self.controls, area) if layout is None else layout
        size, west, north, *shape = self.layout
        require_memory(shape, CELL_BYTES, device, "the raster of the controls")
        values = wp.zeros(shape, dtype=wp.float64, device=device)
        self.raster = Raster.wrap(values, size, (west, north), crs, "m", "control")
        self.factor = self.raster.like(wp.full(shape, 1.0, dtype=wp.float64, device=device), name="rate factor")
        self._grid = self.raster.grid()
        blocks = tuple(math.ceil(count / grounds.BLOCK) for count in shape)
        self._blocks = wp.full(blocks, 1.0, dtype=wp.float32, device=device)
        self._highest = wp.full(1, 1.0, dtype=wp.float32, device=device)
        self._note_kinds()
        for control in self.controls:
            self._stamp(control, control.bounds())
        self._bound_blocks(self._window(self.raster.bounds))

    def covers(self, controls: Sequence[Control]) -> bool:
        """Tell whether other controls fit these cells: they lie within them, and ask for no finer ones."""
        if not controls:
            return True
        size, (west, south, east, north) = _needs(controls)
        rim = RIM * self.raster.cell_size * (1.0 - 1e-9)
        left, bottom, right, top = self.raster.bounds
        inside = west >= left + rim and south >= bottom + rim and east <= right - rim and north <= top - rim
        return inside and size >= self.raster.cell_size * (1.0 - 1e-9)

    def update(self, controls: Sequence[Control], changed: Sequence[Bounds] = ()) -> list[Bounds]:
        """Stamp other controls into the same cells: those alone that what has changed reaches.

        Args:
            controls: The controls from now on; ``covers`` them.
            changed: Bounds in m within which fields were painted.

        Returns:
            Bounds in m of what has changed.
        """
        after = checked_controls(controls, self.raster.crs)
        boxes = merged([*changes(self.controls, after), *changed])
        self.controls = after
        self._note_kinds()
        for bounds in boxes:
            window = self._window(bounds)
            if window is None:
                continue
            for cells, value in ((self.raster, 0.0), (self.factor, 1.0)):
                self._launch(kernels.build(wp.float64).fill_window, window, [window, wp.float64(value)], cells)
            for control in after:
                self._stamp(control, bounds)
            self._bound_blocks(window)
        return boxes

    def gradient(self, xy: ArrayLike) -> FloatArray:
        """Return the gradient of the control field at points, (n, 2), as the kernels read it; 0 off its raster.

        Args:
            xy: (n, 2) points in m.
        """
        gradient: FloatArray = np.nan_to_num(Terrain.wrap_raster(self.raster).gradient(xy))
        return gradient

    def steering(self, params: Any, dtype: str, origin: Sequence[float] | np.ndarray) -> Any:
        """Return the struct ``Steering`` of ``kernels/ground.py``.

        Args:
            params: ``control_steering`` and ``control_floor``.
            dtype: Precision of the points.
            origin: Absolute position of the points' zero in m.
        """
        steering = grounds.build(PRECISIONS[dtype][0]).Steering()
        if self.pulls:
            steering.cell_control = self.raster.values
        if self.scales:
            steering.cell_factor = self.factor.values
        steering.block_mobility, steering.highest = self._blocks, self._highest
        steering.grid = self.raster.grid(dtype, origin)
        steering.floor, steering.mode = params.control_floor, MODES[params.control_steering]
        return steering

    def _note_kinds(self) -> None:
        scaling = [isinstance(control, RateControl) for control in self.controls]
        self.pulls, self.scales = self.pulls or not all(scaling), self.scales or any(scaling)

    # ---- what controls stamp with

    def add_bump(self, line: FloatArray, radius: float, strength: float, window: wp.vec4i) -> None:
        """Add a radial field around a line or a point to the control field."""
        kernel = kernels.build(wp.float64)
        bump = kernel.Bump()
        bump.radius, bump.strength = radius, strength
        points: DeviceArray = wp.array(line, dtype=wp.vec2d, device=self.raster.device)
        self._launch(kernel.add_bump, window, [self._grid, bump, window, points], self.raster)

    def apply_field(self, name: Literal["add_field", "scale_by_field"], field: Raster, window: wp.vec4i) -> None:
        """Add a raster to the control field, or multiply the factor by it."""
        here = field if field.device == self.raster.device else field.to(self.raster.device)
        target = self.raster if name == "add_field" else self.factor
        inputs = [self._grid, window, here.values, here.grid()]
        self._launch(getattr(kernels.build(wp.float64), name), window, inputs, target)

    def scale_inside(self, polygon: FloatArray, factor: float, blend: float, window: wp.vec4i) -> None:
        """Multiply the factor in a polygon."""
        corners: DeviceArray = wp.array(polygon, dtype=wp.vec2d, device=self.raster.device)
        inputs = [self._grid, wp.float64(factor), wp.float64(blend), window, corners]
        self._launch(kernels.build(wp.float64).scale_inside, window, inputs, self.factor)

    def _launch(self, kernel: Any, window: Any, inputs: list[Any], target: Raster) -> None:
        launch_kernel(kernel, (window[2], window[3]), inputs, [target.values], device=target.device)

    def _bound_blocks(self, window: Any) -> None:
        """Find what controls let points do in the blocks that hold a window, or lie beside it."""
        first = [max(begin - 1, 0) // grounds.BLOCK for begin in window[:2]]
        last = [(begin + count) // grounds.BLOCK for begin, count in zip(window[:2], window[2:], strict=True)]
        rows, columns = (min(b, n - 1) - a + 1 for a, b, n in zip(first, last, self._blocks.shape, strict=True))
        inputs = [self._grid, wp.vec4i(first[0], first[1], rows, columns), self.raster.values, self.factor.values]
        kernel = kernels.build(wp.float64).bound_blocks
        launch_kernel(kernel, (rows, columns), inputs, [self._blocks], device=self.raster.device)
        row, column = first
        reached = self._blocks[row : row + rows, column : column + columns].contiguous().numpy()
        self._highest.assign(np.maximum(self._highest.numpy(), np.abs(reached).max()))

    def _window(self, bounds: Bounds) -> wp.vec4i | None:
        """Cells with centres within bounds, or that a value there reaches."""
        rim = self.raster.cell_size
        west, south, east, north = bounds
        window = self.raster.window(west - rim, south - rim, east + rim, north + rim)
        return None if window is None else wp.vec4i(*window)

    def _stamp(self, control: Control, within: Bounds) -> None:
        """Stamp a control into the cells within bounds that it reaches."""
        reach = control.bounds()
        rim = self.raster.cell_size
        low = [max(a, b) for a, b in zip(reach[:2], within[:2], strict=True)]
        high = [min(a, b) for a, b in zip(reach[2:], within[2:], strict=True)]
        if low[0] <= high[0] + rim and low[1] <= high[1] + rim:
            window = self._window((low[0], low[1], high[0], high[1]))
            if window is not None:
                control.stamp(self, window)


def _laid_out(controls: Sequence[Control], area: Bounds | None) -> Layout:
    """Cells that hold all controls, and an area as well where that takes few; about the middle of what they hold."""
    size, (west, south, east, north) = _needs(controls)
    if area is not None:
        wide = min(west, area[0]), min(south, area[1]), max(east, area[2]), max(north, area[3])
        if (wide[2] - wide[0]) * (wide[3] - wide[1]) <= ROOMY_CELLS * size * size:
            west, south, east, north = wide
    rows, columns = (math.ceil(span / size - 1e-9) + 2 * RIM for span in (north - south, east - west))
    return Layout(
        size, 0.5 * (west + east) - 0.5 * columns * size, 0.5 * (south + north) + 0.5 * rows * size, rows, columns
    )


def _needs(controls: Sequence[Control]) -> tuple[float, Bounds]:
    """Cell size and bounds that hold all controls; raises ``ValueError`` where too many cells would be needed."""
    boxes = np.array([control.bounds() for control in controls])
    west, south = boxes[:, :2].min(axis=0)
    east, north = boxes[:, 2:].max(axis=0)
    finest = min(control.cell_size() for control in controls)
    fits = math.sqrt(max(east - west, finest) * max(north - south, finest) / MAX_CELLS)
    if fits > finest * CELLS_ACROSS / MIN_CELLS_ACROSS:
        raise InputError(
            f"the controls lie within {east - west:.4g} x {north - south:.4g} m, which {MAX_CELLS} cells divide into "
            f"{fits:.3g} m; the smallest control needs cells of {finest * CELLS_ACROSS / MIN_CELLS_ACROSS:.3g} m or "
            "less; leave out what lies far off, or make small controls larger"
        )
    return max(finest, fits), (float(west), float(south), float(east), float(north))


def changes(before: Sequence[Control], after: Sequence[Control]) -> list[Bounds]:
    """Bounds of the controls that have gone, and of those that have come; of all where those that stay change places.

    Sums depend on their order in the last digit, and a map must not depend on what was stamped before.
    """
    places = _places(before, after)
    stayed = [place for place in places if place >= 0]
    if stayed != sorted(stayed):
        return [control.bounds() for control in (*before, *after)]
    gone = set(range(len(before))).difference(stayed)
    come = [control for control, place in zip(after, places, strict=True) if place < 0]
    return [control.bounds() for control in (*(before[k] for k in sorted(gone)), *come)]


def _places(before: Sequence[Control], after: Sequence[Control]) -> list[int]:
    """Place among the controls before of each control that was there, the same or an equal one; else -1."""
    same = {id(control): k for k, control in enumerate(before)}
    left: dict[Bounds, list[int]] = {}
    for k, control in enumerate(before):
        left.setdefault(control.bounds(), []).append(k)
    places: list[int] = []
    for control in after:
        rest = left.get(control.bounds(), [])
        wanted = same.get(id(control), -1)
        if wanted not in rest:
            wanted = next((k for k in rest if before[k] == control), -1)
        if wanted >= 0:
            rest.remove(wanted)
        places.append(wanted)
    return places


def merged(boxes: Sequence[Bounds]) -> list[Bounds]:
    """Boxes of which no two overlap: those that did are joined."""
    found: list[Bounds] = []
    for box in boxes:
        joined = box
        while True:
            touching = [b for b in found if _overlap(b, joined)]
            if not touching:
                break
            found = [b for b in found if not _overlap(b, joined)]
            rows = np.array([joined, *touching])
            low, high = rows[:, :2].min(axis=0), rows[:, 2:].max(axis=0)
            joined = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        found.append(joined)
    return found


def _overlap(a: Bounds, b: Bounds) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]
