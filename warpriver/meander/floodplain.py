"""What a river leaves behind and meets again: clay plugs in oxbow lakes, young bars, and unrest near fresh cutoffs."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.device import PRECISIONS, launch_kernel, require_memory
from warpriver.engine.phase import Batch, Phase
from warpriver.engine.saved import SavedError
from warpriver.engine.stages import Share, Stage, launch, put
from warpriver.engine.state import State
from warpriver.history.events import Event
from warpriver.kernels import floodplain as kernels
from warpriver.kernels.status import CUT_POINTS, CUTS
from warpriver.meander.loops import Loops

__all__ = ["Floodplain"]

# Cells across the narrowest channel, at least as far as the map has no more than so many.
CELLS_ACROSS, MAX_CELLS = 3.0, 2**24
# Greatest widths around the channels of the start that the map holds, where there is no terrain.
MARGIN = 60.0
# Widths of river from the neck on that a plug leaves open, since the river flows there.
OPEN_ENDS = 3.0
# Times the reach of unrest up to which it is felt.
SPREAD = 5.0
# What is remembered, in the order in which it is kept.
KINDS = ("river", "plug", "unrest")


class _Layout(NamedTuple):
    """Where the cells lie, m, and how many there are."""

    cell_size: float
    west: float
    north: float
    rows: int
    columns: int

    @classmethod
    def around(cls, state: State) -> _Layout:
        """Return cells on the terrain, or around the channels on a plain."""
        network = state.network
        width = network.channel_width
        if network.point_section is not None:
            width = np.concatenate(network.point_widths())
        if state.map_edges is not None:
            west, south, east, north, _ = state.map_edges
        else:
            west, south, east, north = (float(v) for v in network.bounds())
            margin = MARGIN * float(width.max())
            west, south, east, north = west - margin, south - margin, east + margin, north + margin
        size = float(width.min()) / CELLS_ACROSS
        size = max(size, math.sqrt((east - west) * (north - south) / MAX_CELLS))
        return cls(size, west, north, math.ceil((north - south) / size), math.ceil((east - west) / size))


class Floodplain(Phase):
    """Remembers where the river was and what it cut off, and scales the way of each point by that.

    Its map is fixed at the start; beyond it nothing is remembered. Dates are those of the sub-steps at whose beginning
    the river lay somewhere, or in which a loop was cut off.

    Attributes:
        now: (1,) int32, date of the sub-step at hand, ticks.
        river, plug, unrest: (cells,) int32, dates; None for what has no effect.
    """

    name = "remember the floodplain"
    every_substep = True
    now: DeviceArray

    def __init__(self, loops: Loops) -> None:
        """Take the loops that are cut off, which become plugs."""
        self._loops = loops
        self._layout: _Layout | None = None
        self._pending: dict[str, np.ndarray] = {}
        self.river: DeviceArray | None = None
        self.plug: DeviceArray | None = None
        self.unrest: DeviceArray | None = None

    def allocate(self, state: State) -> None:
        """Make the map, once."""
        if self._layout is None:
            self._layout = _Layout.around(state)
        if hasattr(self, "now"):
            return
        self.now = state.zeros(1)
        params, count = state.params.floodplain, self._layout.rows * self._layout.columns
        require_memory((self._layout.rows, self._layout.columns), 12, state.device, "the map of the floodplain")
        # A plug that the river erodes is none any more, which its dates tell.
        river = params.bar_factor != 1.0 or params.plug_factor != 1.0
        for kind, wanted in zip(KINDS, (river, params.plug_factor != 1.0, params.unrest > 0.0), strict=True):
            if wanted:
                never = wp.full(count, kernels.NEVER, dtype=wp.int32, device=state.device)
                setattr(self, kind, never)

    def install(self, state: State) -> None:
        """Take what a record had."""
        for kind in KINDS:
            cells = getattr(self, kind)
            if cells is not None and f"floodplain_{kind}_cell" in self._pending:
                dates = np.full(len(cells), kernels.NEVER, np.int32)
                dates[self._pending[f"floodplain_{kind}_cell"]] = self._pending[f"floodplain_{kind}_date"]
                put(cells, dates)
        self._pending = {}

    def _struct(self, state: State) -> Any:
        """Return the map as kernels take it, for positions about the network's origin."""
        kernel, params, layout = kernels.build(state.scalar), state.params.floodplain, self._layout
        assert layout is not None
        plain = kernel.Floodplain()
        for kind in KINDS:
            if getattr(self, kind) is not None:
                setattr(plain, kind, getattr(self, kind))
        origin = state.network.origin
        plain.grid.west, plain.grid.north = layout.west - float(origin[0]), layout.north - float(origin[1])
        plain.grid.cell_size, plain.grid.cells_per_meter = layout.cell_size, 1.0 / layout.cell_size
        plain.rows, plain.columns = layout.rows, layout.columns
        plain.bar_change, plain.bar_time = params.bar_factor - 1.0, params.bar_time
        plain.plug_change, plain.plug_time = params.plug_factor - 1.0, params.plug_time
        plain.unrest_change, plain.unrest_time = params.unrest, params.unrest_time
        return plain

    def stages(self, state: State) -> list[Stage]:
        """Return the stages: the date, the ways of the points, and where the river is."""
        kernel, plain, channels = kernels.build(state.scalar), self._struct(state), state.channels()
        points, device = state.points(), state.device

        def tell(_: Share) -> None:
            inputs = [state.params.time_step, state.substep, state.status.array]
            launch(kernel.tell_date, 1, inputs, [self.now], device)

        def scale(share: Share) -> None:
            inputs = [channels, points, plain, share.work, self.now]
            outputs = [state.point_moved, state.max_speed_bits]
            launch(kernel.scale_moves, share.point_threads, inputs, outputs, device)

        def mark(share: Share) -> None:
            inputs = [channels, points, plain, share.work, self.now]
            launch(kernel.mark_courses, share.point_threads, inputs, [self.river], device)

        # Before any way is scaled, and not after it: a sub-step that is done again finds the same.
        marks = [Stage(self.name, mark, shared=False)] if self.river is not None else []
        return [Stage(self.name, tell, shared=False), *marks, Stage(self.name, scale)]

    def after(self, state: State, batch: Batch) -> list[Event]:
        """Lay plugs into the loops that were cut off, and spread unrest around their necks."""
        count, points = batch.status[CUTS], batch.status[CUT_POINTS]
        if count == 0 or (self.plug is None and self.unrest is None):
            return []
        cut = self._loops.cut[:count].numpy()
        xy = self._loops.oxbow_xy[:points].numpy().astype(np.float64)
        width = np.repeat(state.network.channel_width[cut["channel"]], cut["count"])
        if self._loops.oxbow_section is not None:
            width = self._loops.oxbow_section[:points].numpy()[:, 0].astype(np.float64)
        owner = np.repeat(np.arange(count), cut["count"])
        head, foot = xy[cut["begin"]], xy[cut["begin"] + cut["count"] - 1]
        plain, date = self._struct(state), int(self.now.numpy()[0])
        if self.plug is not None:
            place, radius = _discs(xy, owner, width, head, foot)
            self._stamp(state, "lay_plugs", len(place), [plain], [place, radius], date, self.plug)
        if self.unrest is not None:
            reach = state.params.floodplain.unrest_reach * width[cut["begin"]]
            rows = 2 * math.ceil(SPREAD * float(reach.max()) / plain.grid.cell_size) + 2
            self._stamp(
                state, "spread_unrest", (count, rows), [plain, SPREAD], [0.5 * (head + foot), reach], date, self.unrest
            )
        return []

    def _stamp(
        self, state: State, name: str, dim: Any, params: list[Any], places: list[FloatArray], date: int, cells: Any
    ) -> None:
        """Launch a kernel over places, positions and sizes, that raises the dates of cells."""
        if len(places[0]) == 0:
            return
        scalar, vec2, real = PRECISIONS[state.network.dtype]
        arrays: list[DeviceArray] = [
            wp.array(values.astype(real), dtype=kind, device=state.device)
            for values, kind in zip(places, (vec2, scalar), strict=True)
        ]
        kernel = getattr(kernels.build(state.scalar), name)
        launch_kernel(kernel, dim, [*params, *arrays, date], [cells], device=state.device)

    def saved(self, state: State) -> dict[str, np.ndarray]:
        """Return where the cells lie, and the dates of those that are not forgotten."""
        assert self._layout is not None
        params = state.params.floodplain
        now = round(state.step_count * state.params.time_step * kernels.TICKS)
        found = {"floodplain_layout": np.array(self._layout, np.float64)}
        river = None if self.river is None else self.river.numpy()
        times = (params.bar_time, params.plug_time, params.unrest_time)
        for kind, time in zip(KINDS, times, strict=True):
            cells = getattr(self, kind)
            if cells is None:
                continue
            date = cells.numpy()
            oldest = max(now - (kernels.FORGOTTEN + 1.0) * time * kernels.TICKS, kernels.NEVER + 1.0)
            kept = date >= oldest
            if kind == "plug" and river is not None:
                # Where the river came back there is none, also once that is forgotten.
                kept &= date >= river
            index = np.flatnonzero(kept)
            found[f"floodplain_{kind}_cell"] = index.astype(np.int32)
            found[f"floodplain_{kind}_date"] = date[index].astype(np.int32)
        return found

    def restore(self, state: State, saved: dict[str, np.ndarray]) -> None:
        """Take up where the cells lie, and their dates."""
        if "floodplain_layout" not in saved:
            return
        layout = np.asarray(saved["floodplain_layout"])
        good = layout.shape == (5,) and layout.dtype.kind == "f" and bool(np.isfinite(layout).all())
        if not good or layout[0] <= 0.0 or min(layout[3:]) < 1.0 or layout[3] * layout[4] > 2 * MAX_CELLS:
            raise SavedError("floodplain_layout")
        size, west, north, rows, columns = (float(v) for v in layout)
        self._layout = _Layout(size, west, north, int(rows), int(columns))
        for kind in KINDS:
            cell, date = (np.asarray(saved.get(f"floodplain_{kind}_{part}", np.empty(0))) for part in ("cell", "date"))
            whole = cell.size == 0 or (cell.dtype.kind == date.dtype.kind == "i" and cell.ndim == 1)
            if (
                not whole
                or cell.shape != date.shape
                or (cell.size and not 0 <= cell.min() <= cell.max() < rows * columns)
            ):
                raise SavedError(f"floodplain_{kind}_cell")
            self._pending[f"floodplain_{kind}_cell"] = cell.astype(np.int64)
            self._pending[f"floodplain_{kind}_date"] = date.astype(np.int32)


def _discs(
    xy: FloatArray, owner: np.ndarray, width: FloatArray, head: FloatArray, foot: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places and radii in m of discs that cover loops, but for what lies near their necks.

    Args:
        xy: (n, 2) points of the loops, end to end, m.
        owner: (n,) loop of each.
        width: (n,) its width there, m.
        head: (k, 2) first point of each loop.
        foot: (k, 2) last one.
    """
    nearest = np.minimum(*(np.hypot(*(xy - end[owner]).T) for end in (head, foot)))
    # Between points that are farther apart than a radius a disc in the middle.
    inside = owner[1:] == owner[:-1]
    place = np.concatenate([xy, 0.5 * (xy[1:] + xy[:-1])[inside]])
    size = np.concatenate([width, (0.5 * (width[1:] + width[:-1]))[inside]])
    away = np.concatenate([nearest, np.minimum(nearest[1:], nearest[:-1])[inside]])
    kept = away > OPEN_ENDS * size
    return place[kept], 0.5 * size[kept]
