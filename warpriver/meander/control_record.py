"""Controls as a history keeps them: numbers and a few words, from which they are made again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.history import ControlChange, ControlStroke, Event
from warpriver.history.events import events_of
from warpriver.meander.control_map import Layout
from warpriver.meander.controls import (
    Attractor,
    Control,
    ControlField,
    DampingRegion,
    ErodibilityField,
    Guide,
    Repeller,
)
from warpriver.raster import Raster
from warpriver.validate import shown

__all__ = ["change_to", "control_of", "controls_after", "described", "layout_after", "stroke_of"]


KINDS: dict[str, type[Control]] = {
    kind.__name__: kind for kind in (Attractor, Repeller, Guide, ControlField, DampingRegion, ErodibilityField)
}
# Numbers of a raster before its values: cell size, west, north, rows, columns.
PLACE = 5


def change_to(time: float, before: Sequence[Control], after: Sequence[Control], layout: Layout | None) -> ControlChange:
    """Return the event of a change of controls.

    Args:
        time: yr.
        before: Controls until then; those that stay are not told again.
        after: Controls from then on.
        layout: Raster that they are stamped into, None without any.

    Raises:
        ValueError: A control of a kind that no history can keep.
    """
    places = {id(control): place for place, control in enumerate(before)}
    told: list[dict[str, Any]] = []
    numbers: list[FloatArray] = []
    for control in after:
        if id(control) in places:
            told.append({"kept": places[id(control)]})
        else:
            words, own = control.packed()
            told.append({**words, "count": len(own)})
            numbers.append(own)
    place = Layout(0.0, 0.0, 0.0, 0, 0) if layout is None else layout
    return ControlChange(time, json.dumps(told), np.concatenate([np.zeros(0), *numbers]), *place)


def described(control: Control) -> dict[str, Any]:
    """Return a control as JSON can hold it; :func:`control_of` makes it again.

    Raises:
        ValueError: A control of a kind that no history can keep.
    """
    words, numbers = control.packed()
    return {**words, "numbers": numbers.tolist()}


def control_of(values: Mapping[str, Any], device: wp.DeviceLike = "cpu") -> Control:
    """Return the control that :func:`described` told of.

    Raises:
        ValueError: It is none, or one that cannot be.
    """
    if values.get("kind") not in KINDS or "numbers" not in values:
        raise InputError(f"{shown(dict(values))} is no control; it needs a kind, of {', '.join(KINDS)}, and numbers")
    try:
        return _unpacked(dict(values), np.asarray(values["numbers"], np.float64), device)
    except (TypeError, IndexError, ValueError) as error:
        raise InputError(f"a control of the kind {values['kind']} is damaged: {error}") from error


def stroke_of(
    time: float, step: int, place: int, field: ControlField, window: tuple[int, int, int, int]
) -> ControlStroke:
    """Return the event of a stroke: the values of a field in a window = (first row, first column, rows, columns)."""
    return ControlStroke(time, step, place, *window, field.raster.cells(window).flatten())


def controls_after(events: Iterable[Event], device: wp.DeviceLike = "cpu") -> tuple[Control, ...]:
    """Return the controls that hold after the events of a run, made anew.

    Args:
        events: Events of a run from its start on, as ``History.events``.
        device: Warp device of their rasters.
    """
    controls: tuple[Control, ...] = ()
    for event in events_of(events, ControlChange, ControlStroke):
        if isinstance(event, ControlChange):
            controls = _changed(controls, event, device)
        elif isinstance(event, ControlStroke):
            _paint(controls[event.control], event)
    return controls


def layout_after(events: Iterable[Event]) -> Layout | None:
    """Return the raster that the controls are stamped into after the events of a run; None without controls."""
    layout = None
    for event in events_of(events, ControlChange):
        layout = Layout(event.cell_size, event.west, event.north, event.rows, event.columns)
    return layout if layout is not None and layout.rows else None


def _changed(before: Sequence[Control], event: ControlChange, device: wp.DeviceLike) -> tuple[Control, ...]:
    found: list[Control] = []
    first = 0
    for words in json.loads(event.controls):
        if "kept" in words:
            found.append(before[words["kept"]])
            continue
        count = words["count"]
        found.append(_unpacked(words, event.numbers[first : first + count], device))
        first += count
    return tuple(found)


def _paint(field: Control, stroke: ControlStroke) -> None:
    assert isinstance(field, ControlField)
    window = stroke.row, stroke.column, stroke.rows, stroke.columns
    field.raster.put_cells(window, stroke.values.reshape(stroke.rows, stroke.columns))


def _unpacked(words: dict[str, Any], numbers: FloatArray, device: wp.DeviceLike) -> Control:
    # Each kind is made in its own way.
    kind: Callable[..., Control] = KINDS[words["kind"]]
    values = numbers.tolist()
    if kind in (Attractor, Repeller):
        return kind((values[0], values[1]), values[2], values[3])
    if kind is Guide:
        return Guide(numbers[2:].reshape(-1, 2), values[0], values[1])
    if words.get("raster"):
        size, west, north = values[:3]
        cells = numbers[PLACE:].reshape(int(values[3]), int(values[4]))
        unit = "m" if kind is ControlField else ""
        return kind(Raster(cells, size, (west, north), words["crs"], unit, device=device))
    return kind(numbers[2:].reshape(-1, 2), values[0], blend=values[1])
