"""Steering: the controls of a simulation between its steps, and what its history has to know of their changes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from warpriver.edits.values import PaintControl
from warpriver.engine.state import State
from warpriver.errors import InputError
from warpriver.history import ControlChange, ControlStroke, Event
from warpriver.history.events import events_of
from warpriver.meander.control_map import ControlMap, Layout, changes, merged
from warpriver.meander.control_record import change_to, controls_after, layout_after, stroke_of
from warpriver.meander.controls import Bounds, Control, ControlField, checked_controls
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain

__all__ = ["Steering"]


class Steering:
    """The controls of a simulation, and the map that they are stamped into.

    A map serves as long as the controls fit its cells; then only the cells that a change reaches are stamped anew, and
    the recorded step reads them as they are.

    Attributes:
        controls: The controls as they are now.
        map: Where they are stamped, None where there are none.
    """

    def __init__(
        self,
        network: RiverNetwork,
        terrain: Terrain | None = None,
        controls: object = (),
        *,
        events: Iterable[Event] | None = None,
    ):
        """Stamp controls for a network.

        Args:
            network: The network, on its device.
            terrain: The ground, or None.
            controls: One control or several.
            events: Events of a run that is resumed, whose controls are made again in place of ``controls``.

        Raises:
            ValueError: Something that is no control, or one in another CRS.
        """
        self._crs, self._device = network.crs, network.device
        boxes = np.array([network.bounds(), *([] if terrain is None else [terrain.bounds])])
        (west, south), (east, north) = boxes[:, :2].min(axis=0).tolist(), boxes[:, 2:].max(axis=0).tolist()
        self._area: Bounds = (west, south, east, north)
        layout = None
        if events is not None:
            told = list(events_of(events, ControlChange, ControlStroke))
            controls, layout = controls_after(told, self._device), layout_after(told)
        self.controls = checked_controls(controls, self._crs)
        self.map: ControlMap | None = None
        if self.controls:
            self.map = ControlMap(self.controls, area=self._area, layout=layout, crs=self._crs, device=self._device)
        self._seen = self._strokes()

    def begin(self, time: float) -> list[Event]:
        """Return the event of the controls that a run begins with; none without any."""
        return [change_to(time, (), self.controls, self._layout)] if self.controls else []

    def replace(self, controls: object, state: State, time: float) -> list[Event]:
        """Let other controls hold from the next step on, and return the events of that.

        Raises:
            ValueError: Something that is no control, or one in another CRS; then nothing has changed.
        """
        after = checked_controls(controls, self._crs)
        painted = self.take_strokes(state, time)
        boxes = changes(self.controls, after)
        if not boxes and len(after) == len(self.controls):
            if all(a is b for a, b in zip(self.controls, after, strict=True)):
                return painted
        told = self._serving(after)
        event = change_to(time, self.controls, after, None if told is None else told.layout)
        read = self.map is not None and (self.map.pulls, self.map.scales)
        if told is not None and told is self.map:
            told.update(after)
        self.controls = after
        if told is not self.map or (told is not None and read != (told.pulls, told.scales)):
            self.map = told
            state.steer(told)
        self._seen = self._strokes()
        self._hasten(state, boxes)
        return [*painted, event]

    def put_back(self, controls: tuple[Control, ...], before: ControlMap | None, state: State) -> None:
        """Go back to controls that held between the same two steps, stamped into the map that they had."""
        read = None if self.map is None else (self.map.pulls, self.map.scales)
        if before is not None:
            # Another map has not got what was painted since.
            painted = [control.bounds() for control in controls if isinstance(control, ControlField)]
            before.update(controls, painted if before is not self.map else ())
        self.controls = controls
        if before is not self.map or (before is not None and read != (before.pulls, before.scales)):
            self.map = before
            state.steer(before)
        self._seen = self._strokes()

    def paint(self, edit: PaintControl, state: State) -> tuple[list[Event], Callable[[], None]]:
        """Set cells of a field; return the events of that, and what takes it back.

        Raises:
            ValueError: There is no such field, or no such cells; nothing has changed.
        """
        field = self.controls[edit.control] if edit.control < len(self.controls) else None
        row, column, rows, columns = edit.window
        if not isinstance(field, ControlField):
            raise InputError(f"control {edit.control} is no field that could be painted")
        if row + rows > field.raster.shape[0] or column + columns > field.raster.shape[1]:
            raise InputError(f"window {edit.window} lies beyond the field, which has {field.raster.shape} cells")
        before, bounds = field.raster.cells(edit.window), field.raster.centers(edit.window)
        field.raster.put_cells(edit.window, np.reshape(edit.values, (rows, columns)))
        field.mark_painted(bounds)

        def back() -> None:
            field.raster.put_cells(edit.window, before)
            if self.map is not None:
                self.map.update(self.controls, [_widened(bounds, field.raster.cell_size)])

        return self.take_strokes(state, state.step_count * float(state.params.time_step)), back

    def take_strokes(self, state: State, time: float) -> list[Event]:
        """Stamp what was painted since the last look, and return the events of that."""
        if self.map is None or not self._seen:
            return []
        found: list[Event] = []
        boxes: list[Bounds] = []
        for place, count in self._seen.items():
            field = self.controls[place]
            assert isinstance(field, ControlField)
            new = merged(field.strokes[count:])
            for bounds in new:
                window = field.raster.window(*bounds)
                if window is not None:
                    found.append(stroke_of(time, state.step_count, place, field, window))
                    # Between centres the field is linear: a cell reaches as far as the next centre.
                    boxes.append(_widened(bounds, field.raster.cell_size))
        if found:
            self._seen = self._strokes()
            self._hasten(state, self.map.update(self.controls, boxes))
        return found

    # ---- inside

    @property
    def _layout(self) -> Layout | None:
        return None if self.map is None else self.map.layout

    def _strokes(self) -> dict[int, int]:
        """Number of strokes of each control that is painted, by its place."""
        return {k: len(c.strokes) for k, c in enumerate(self.controls) if isinstance(c, ControlField)}

    def _serving(self, controls: Sequence[Control]) -> ControlMap | None:
        """The map as it is, where it serves for these controls as well; or a new one."""
        if not controls:
            return None
        if self.map is not None and self.map.covers(controls):
            return self.map
        return ControlMap(controls, area=self._area, crs=self._crs, device=self._device)

    def _hasten(self, state: State, boxes: Sequence[Bounds]) -> None:
        """Let the next step be planned for the pull of what has changed, of which the last one tells nothing."""
        if self.map is None or not boxes:
            return
        network = state.network
        xy, start = network.points(), network.starts()
        near = np.zeros(len(xy), bool)
        for west, south, east, north in boxes:
            near |= (xy[:, 0] >= west) & (xy[:, 0] <= east) & (xy[:, 1] >= south) & (xy[:, 1] <= north)
        if near.any():
            pull = np.zeros(len(xy))
            pull[near] = np.hypot(*self.map.gradient(xy[near]).T)
            state.hasten_by(1.0 + np.maximum.reduceat(pull, start[:-1]))


def _widened(bounds: Bounds, reach: float) -> Bounds:
    west, south, east, north = bounds
    return west - reach, south - reach, east + reach, north + reach
