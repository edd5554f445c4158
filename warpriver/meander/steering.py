"""Steering: the controls of a simulation between its steps, and what its history has to know of their changes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from warpriver.edits.values import PaintControl, SetControls
from warpriver.engine.state import State
from warpriver.errors import InputError
from warpriver.history import Event
from warpriver.meander.control_map import ControlMap, Layout, changes, merged
from warpriver.meander.control_record import change_to, controls_after, controls_of, layout_after, stroke_of
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
            told = list(events)
            controls, layout = controls_after(told, self._device), layout_after(told)
        self.controls = checked_controls(controls, self._crs)
        self.map: ControlMap | None = None
        if self.controls:
            self.map = ControlMap(self.controls, area=self._area, layout=layout, crs=self._crs, device=self._device)
        self._seen = self._strokes()

    def begin(self) -> list[Event]:
        """Return the event of the controls that a run begins with; none without any."""
        return [change_to(0.0, -1, (), self.controls, self._layout)] if self.controls else []

    def replace(self, controls: object, state: State) -> list[Event]:
        """Let other controls hold from the next step on, and return the event of that; none where they are the same.

        Raises:
            ValueError: Something that is no control, or one in another CRS; then nothing has changed.
        """
        after = checked_controls(controls, self._crs)
        boxes = changes(self.controls, after)
        if not boxes and len(after) == len(self.controls):
            if all(a is b for a, b in zip(self.controls, after, strict=True)):
                return []
        told = self._serving(after)
        layout = None if told is None else told.layout
        event = change_to(_time(state), state.step_count, self.controls, after, layout)
        read = self.map is not None and (self.map.pulls, self.map.scales)
        if told is not None and told is self.map:
            told.update(after)
        self.controls = after
        if told is not self.map or (told is not None and read != (told.pulls, told.scales)):
            self.map = told
            state.steer(told)
        self._seen = self._strokes()
        self._hasten(state, boxes)
        return [event]

    def do(self, edit: SetControls | PaintControl, state: State) -> list[Event]:
        """Do an edit of controls, and return its events.

        Raises:
            ValueError: It cannot be done, and nothing has changed.
        """
        if isinstance(edit, SetControls):
            told = [(json.loads(words), np.array(numbers)) for words, numbers in edit.controls]
            return self.replace(controls_of(told, self.controls, self._device), state)
        field = self.controls[edit.control] if edit.control < len(self.controls) else None
        row, column, rows, columns = edit.window
        if not isinstance(field, ControlField):
            raise InputError(f"control {edit.control} is no field that could be painted")
        if row + rows > field.raster.shape[0] or column + columns > field.raster.shape[1]:
            raise InputError(f"window {edit.window} lies beyond the field, which has {field.raster.shape} cells")
        field.raster.put_cells(edit.window, np.reshape(edit.values, (rows, columns)))
        field.mark_painted(field.raster.centers(edit.window))
        return self.take_strokes(state)

    def keep(self, state: State) -> Callable[[], None]:
        """Return what brings the controls back to what they are now, and the plan of the next step with them."""
        controls, held, pace = self.controls, self.map, state.pace.numpy().copy()
        cells = {k: (c, c.raster.numpy()) for k, c in enumerate(controls) if isinstance(c, ControlField)}

        def put_back() -> None:
            boxes: list[Bounds] = []
            for field, values in cells.values():
                if not np.array_equal(field.raster.numpy(), values, equal_nan=True):
                    field.raster.values.assign(values)
                    boxes.append(field.bounds())
            if held is not self.map:
                self.map = held
                state.steer(held)
            if held is not None:
                held.update(controls, boxes)
            self.controls, self._seen = controls, {}
            self._seen = self._strokes()
            state.pace.assign(pace)

        return put_back

    def take_strokes(self, state: State) -> list[Event]:
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
                    found.append(stroke_of(_time(state), state.step_count, place, field, window))
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


def _time(state: State) -> float:
    return state.step_count * float(state.params.time_step)


def _widened(bounds: Bounds, reach: float) -> Bounds:
    west, south, east, north = bounds
    return west - reach, south - reach, east + reach, north + reach
