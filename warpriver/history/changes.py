"""What may change while a run goes on: constants, the ground, the network. Each change is an event of the run."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from warpriver.edits.values import Edit, PaintControl, edit_of
from warpriver.history.events import Event, events_of
from warpriver.params import MeanderParams, PathMeander
from warpriver.terrain import Terrain

__all__ = [
    "AppliedEdit",
    "ControlChange",
    "ControlStroke",
    "Ground",
    "GroundChange",
    "ParameterChange",
    "ground_after",
    "params_after",
]


@dataclasses.dataclass(frozen=True)
class Ground:
    """The terrain of a run: enough to find it again, and to know it when it is found.

    Attributes:
        digest: ``Terrain.digest`` of its heights.
        about: What it is, in a few words.
        path: Absolute path of the file that it came from; None where there is none.
        options: Arguments of ``read_terrain`` that the file was read with.
    """

    digest: str
    about: str
    path: str | None = None
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, terrain: Terrain) -> Ground:
        """Describe a terrain."""
        rows, columns = terrain.shape
        about = f"{columns} x {rows} cells of {terrain.cell_size:g} m"
        if terrain.file is None:
            return cls(terrain.digest(), about)
        return cls(terrain.digest(), about, terrain.file.path, _plain(terrain.file.options))

    def as_json(self) -> dict[str, Any]:
        """Return the fields as JSON can hold them; ``Ground(**...)`` takes them back."""
        return {**dataclasses.asdict(self), "options": dict(self.options)}


def _plain(options: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments as JSON gives them back."""

    def plain(value: Any) -> Any:
        return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)

    options_read: dict[str, Any] = json.loads(json.dumps(dict(options), default=plain))
    return options_read


@dataclasses.dataclass(frozen=True, repr=False)
class AppliedEdit(Event):
    """An edit that was done between two steps, after so many of them.

    Attributes:
        time: yr.
        step: Steps done before it.
        name: Name of its kind, such as "MovePoint".
        told: uint8, its kind and fields as JSON in UTF-8.
    """

    step: int
    name: str
    told: np.ndarray

    @classmethod
    def of(cls, time: float, step: int, edit: Edit) -> AppliedEdit:
        """Make the event of an edit."""
        return cls(time, step, edit.name, np.frombuffer(json.dumps(edit.as_json()).encode(), np.uint8))

    @property
    def edit(self) -> Edit:
        """The edit, to be done again."""
        return edit_of(json.loads(self.told.tobytes()))

    def __repr__(self) -> str:
        return f"AppliedEdit(time={self.time!r}, step={self.step!r}, {self.edit!r})"


@dataclasses.dataclass(frozen=True)
class ParameterChange(Event):
    """A constant of the model that was changed when the run was resumed.

    Attributes:
        time: yr; the run goes on with the new value from there.
        name: Name of the constant.
        before: Value until then, as JSON.
        after: Value from then on, as JSON.
    """

    name: str
    before: str
    after: str


@dataclasses.dataclass(frozen=True)
class GroundChange(Event):
    """The ground became another one: it was edited between two steps, or another terrain was given to a resumed run.

    Attributes:
        time: yr; the ground was as before up to the record before, and as told here from then on.
        about: What the ground is from then on; "" for a plain.
        digest: ``Terrain.digest`` of its heights; "" for a plain.
        path: File that it comes from; "" where there is none.
        options: Arguments of ``read_terrain``, as JSON.
    """

    about: str
    digest: str
    path: str
    options: str

    @classmethod
    def to(cls, time: float, ground: Ground | None) -> GroundChange:
        """Make the event of a change to a ground, or to a plain."""
        if ground is None:
            return cls(time, "", "", "", "{}")
        return cls(time, ground.about, ground.digest, ground.path or "", json.dumps(dict(ground.options)))

    @property
    def ground(self) -> Ground | None:
        """The ground from then on, None for a plain."""
        if not self.digest:
            return None
        return Ground(self.digest, self.about, self.path or None, json.loads(self.options))


@dataclasses.dataclass(frozen=True)
class ControlChange(Event):
    """Other controls steer the channels; :func:`warpriver.meander.control_record.controls_after` makes them again.

    Attributes:
        time: yr; the controls hold from there on.
        controls: What they are, as JSON: an object for each, with its kind and how many of the numbers are its own, or
            the place that it had among the controls before.
        numbers: Their numbers, those of rasters among them, end to end.
        cell_size: Cell size of the raster that they are stamped into, m.
        west: Its west edge, m.
        north: Its north edge, m.
        rows: Its rows; 0 where there are no controls.
        columns: Its columns.
    """

    controls: str
    numbers: np.ndarray
    cell_size: float
    west: float
    north: float
    rows: int
    columns: int


@dataclasses.dataclass(frozen=True)
class ControlStroke(Event):
    """A control field was painted.

    Attributes:
        time: yr; the field holds the values from there on.
        step: Steps done before it.
        control: Place of the field among the controls.
        row: First row of the cells that were painted.
        column: First column.
        rows: Rows of them.
        columns: Columns of them.
        values: (rows * columns,) their values afterwards, m, row by row.
    """

    step: int
    control: int
    row: int
    column: int
    rows: int
    columns: int
    values: np.ndarray

    @property
    def edit(self) -> PaintControl:
        """The edit, to be done again."""
        window = self.row, self.column, self.rows, self.columns
        return PaintControl(self.control, window, tuple(self.values.tolist()))


def params_after(params: MeanderParams | PathMeander, events: Iterable[Event]) -> MeanderParams | PathMeander:
    """Return constants with the changes that events tell of."""
    changed = {event.name: json.loads(event.after) for event in events_of(events, ParameterChange)}
    return params.replace(**changed) if changed else params


def ground_after(ground: Ground | None, events: Iterable[Event]) -> Ground | None:
    """Return the ground after the changes that events tell of."""
    for event in events_of(events, GroundChange):
        ground = event.ground
    return ground
