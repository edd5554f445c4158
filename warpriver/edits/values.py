"""Edits as values: frozen dataclasses that say what is to be done, and check of it what can be told without a network.

A new kind of edit is a frozen dataclass that derives from :class:`Edit` here or in the room of its process, and a
function in ``warpriver/editing.py`` that does it. It is stored by its fields, which may be float, int, bool, str, None,
and tuples of these, however nested; ``check`` makes them of what a user gives.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from warpriver.errors import InputError, InputTypeError
from warpriver.validate import (
    checked_line,
    checked_points,
    finite_numbers,
    floats,
    not_negative,
    one_of,
    positive,
    shown,
    whole,
)

__all__ = [
    "AddChannel",
    "AvulseChannel",
    "CutLoop",
    "DeferJunction",
    "DivertChannel",
    "Edit",
    "EditTerrain",
    "JoinChannels",
    "LockPoint",
    "MovePoint",
    "PaintControl",
    "Place",
    "RedrawSection",
    "RemoveChannel",
    "SetChannel",
    "SplitChannel",
    "UnlockPoint",
    "edit_kinds",
    "edit_of",
]

# A place on a channel: arc length from its head in m, or (x, y), the nearest point to which is meant.
Place = float | tuple[float, float]
# Lines are tuples of points, so that edits are equal where they say the same.
Line = tuple[tuple[float, float], ...]
BRUSHES = ("raise", "lower", "smooth", "flatten")
# Classes by name, and the rooms of those that are not here, which know them once they are imported.
_CLASSES: dict[str, type[Edit]] = {}
_ROOMS = {"SetControls": "warpriver.meander"} | dict.fromkeys(
    (
        "AddLog",
        "AddRock",
        "AddWater",
        "ChangeWater",
        "MoveObstacle",
        "MoveWater",
        "RedrawCourse",
        "RemoveObstacle",
        "RemoveWater",
        "ReplaceWater",
        "RetypeChannel",
    ),
    "warpriver.riverscape",
)


@dataclasses.dataclass(frozen=True)
class Edit:
    """Something that an author does between two steps; see the classes that derive from it."""

    name: ClassVar[str] = "Edit"
    of: ClassVar[str] = "network"

    def __init_subclass__(cls, **options: Any) -> None:
        """Make a class known under its name.

        Raises:
            TypeError: Another class has that name.
        """
        super().__init_subclass__(**options)
        cls.name = cls.__name__
        if cls.name.startswith("_"):
            return
        known = _CLASSES.get(cls.name)
        if known is not None and known.__module__ != cls.__module__:
            raise InputTypeError(f"{cls.__module__} and {known.__module__} both have an edit {cls.name}; rename one")
        _CLASSES[cls.name] = cls

    def __post_init__(self) -> None:
        for field, value in self.check().items():
            object.__setattr__(self, field, value)

    def check(self) -> dict[str, Any]:
        """Return fields as they are stored, of those that were given; raises ``ValueError`` for one that cannot be."""
        return {}

    def as_json(self) -> dict[str, Any]:
        """Return the kind of the edit and its fields, as JSON can hold them; :func:`edit_of` takes them back."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {"edit": self.name} | fields


def edit_kinds(of: str = "network") -> dict[str, type[Edit]]:
    """Return the classes of edits that there are, by name, of a "network" or of a "riverscape"."""
    return {name: kind for name, kind in _CLASSES.items() if kind.of == of}


def edit_of(values: Any) -> Edit:
    """Return the edit that ``Edit.as_json`` described.

    Raises:
        ValueError: It is none, or one that cannot be.
    """
    if not isinstance(values, dict) or not isinstance(values.get("edit"), str):
        raise InputError(f"{shown(values)} is no edit; it needs the key 'edit' with the name of its kind")
    fields = dict(values)
    name = fields.pop("edit")
    if name in _ROOMS:
        importlib.import_module(_ROOMS[name])
    cls = _CLASSES.get(name)
    if cls is None:
        raise InputError(f"there is no edit {name!r}; there are {', '.join(sorted(_CLASSES))}")
    known = {field.name for field in dataclasses.fields(cls)}
    if unknown := sorted(fields.keys() - known):
        raise InputError(f"{name} has no {unknown[0]!r}; it has {', '.join(sorted(known))}")
    try:
        return cls(**{key: _tuples(value) for key, value in fields.items()})
    except TypeError as error:  # a field is missing
        raise InputError(f"{name} lacks a field: {error}") from error


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


@dataclasses.dataclass(frozen=True)
class LockPoint(Edit):
    """Hold a point of a channel in place, whatever its bends do; it is a point of every later course.

    The push of bends upstream fades to nothing towards it, as towards the ends of a channel. A cutoff or a collision
    that would drop it is refused, and noted as a ``HeldLock`` event. Locked points, and the ends of the channel, are 10
    spacings apart.

    Attributes:
        channel: Identity of the channel; it can be no ring.
        at: Place on the channel; the nearest of its points is locked where it lies.
    """

    channel: int
    at: Place

    def check(self) -> dict[str, Any]:
        """Check the channel and the place."""
        return {"channel": _channel(self.channel), "at": _place(self.at)}


@dataclasses.dataclass(frozen=True)
class UnlockPoint(Edit):
    """Let a locked point go.

    Attributes:
        channel: Identity of the channel.
        at: Place on the channel, the nearest of whose locked points is unlocked.
    """

    channel: int
    at: Place

    def check(self) -> dict[str, Any]:
        """Check the channel and the place."""
        return {"channel": _channel(self.channel), "at": _place(self.at)}


@dataclasses.dataclass(frozen=True)
class MovePoint(Edit):
    """Move a point of a channel, and what lies near it along the channel by less, falling smoothly to 0.

    What lies at the arc length s from it moves by (1 - t^2)^3 of the way, t = s over the radius, or over the distance
    to the end of the channel or the locked point that is nearer. At a node, or a locked point, all channels that meet
    there follow.

    Attributes:
        channel: Identity of the channel.
        at: Place on the channel; the nearest of its points is moved.
        to: (x, y) where it goes, m.
        radius: Arc length over which the channel follows, m, 2 spacings or more.
    """

    channel: int
    at: Place
    to: tuple[float, float]
    radius: float

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        return {
            "channel": _channel(self.channel),
            "at": _place(self.at),
            "to": tuple(finite_numbers(self.to, 2, "to")),
            "radius": positive(self.radius, "radius", "m"),
        }


@dataclasses.dataclass(frozen=True)
class SplitChannel(Edit):
    """Make two channels of one, with a width and depth of their own; the node between them changes nothing by itself.

    The part downstream keeps the identity, that upstream gets a new one. Necks across the node are cutoffs.

    Attributes:
        channel: Identity of the channel; it can be no ring.
        at: Place on the channel; it is divided at the nearest of its points.
        width_above, depth_above: Width and depth of the part upstream, m; by default those of the channel.
        width_below, depth_below: Those of the part downstream.
    """

    channel: int
    at: Place
    width_above: float | None = None
    depth_above: float | None = None
    width_below: float | None = None
    depth_below: float | None = None

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        names = ("width_above", "depth_above", "width_below", "depth_below")
        return {"channel": _channel(self.channel), "at": _place(self.at)} | {
            name: _positive_or_none(getattr(self, name), name, "m") for name in names
        }


@dataclasses.dataclass(frozen=True)
class JoinChannels(Edit):
    """Make one channel of two where the one goes on from the other, at a node where nothing else ends.

    It has the identity, the width, the depth and the discharge of the channel downstream; where widths vary along the
    channels, each point keeps its own.

    Attributes:
        upper: Identity of the channel upstream.
        lower: Identity of the channel downstream.
    """

    upper: int
    lower: int

    def check(self) -> dict[str, Any]:
        """Check the channels."""
        return {"upper": _channel(self.upper, "upper"), "lower": _channel(self.lower, "lower")}


@dataclasses.dataclass(frozen=True)
class AddChannel(Edit):
    """Add a channel along a line that runs downstream, from its source to a channel that it joins, or to an outlet.

    It joins the channel on which it ends, or from which its end is no farther than half the width of that: a junction
    is made there, and the water goes on downstream, where width and depth follow. At the end of a channel it joins the
    node that is there.

    Attributes:
        xy: (n, 2) points in m, downstream, n at least 2; a smooth line through them is taken.
        width: Bankfull width, m.
        depth: Bankfull depth, m; by default from the width.
        discharge: Bankfull discharge, m3/s; by default from the width.
        ends: "channel": it has to end on one; "outlet": it ends freely; "any": as it comes.
        max_rise: Greatest height in m by which the ground under the line may rise above a point upstream; by default
            that is not checked.
    """

    xy: Line
    width: float
    depth: float | None = None
    discharge: float | None = None
    ends: str = "any"
    max_rise: float | None = None

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        return {
            "xy": _line(self.xy, "xy"),
            "width": positive(self.width, "width", "m"),
            "depth": _positive_or_none(self.depth, "depth", "m"),
            "discharge": _positive_or_none(self.discharge, "discharge", "m3/s"),
            "ends": one_of(self.ends, "ends", ("any", "channel", "outlet")),
            "max_rise": None if self.max_rise is None else not_negative(self.max_rise, "max_rise", "m"),
        }


@dataclasses.dataclass(frozen=True)
class RemoveChannel(Edit):
    """Remove a channel, from its head to its end.

    Channels that flow into its head end there from then on. What lies downstream loses its water, and width and depth
    follow; what no water is left in falls dry as well, down to the next junction. A junction at which one tributary is
    left dissolves: what met there is one channel.

    Attributes:
        channel: Identity of the channel.
    """

    channel: int

    def check(self) -> dict[str, Any]:
        """Check the channel."""
        return {"channel": _channel(self.channel)}


@dataclasses.dataclass(frozen=True)
class RedrawSection(Edit):
    """Give a channel another course between two of its points.

    Attributes:
        channel: Identity of the channel; no locked point can lie between both ends of the line.
        xy: (n, 2) points in m, downstream, n at least 2. The first and the last stand for the nearest points of the
            channel, between which it takes a smooth line through the others; they lie within 2 widths of it.
    """

    channel: int
    xy: Line

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        return {"channel": _channel(self.channel), "xy": _line(self.xy, "xy")}


@dataclasses.dataclass(frozen=True)
class CutLoop(Edit):
    """Cut a bend off, as a breached neck or a chute does: what lies between is left behind as an oxbow lake.

    Attributes:
        channel: Identity of the channel; no locked point can lie on the loop.
        at: Place on the bend; or, where ``to`` is given, where the river leaves it.
        to: Place farther downstream where it comes back. By default both are chosen, within 60 widths around ``at``,
            such that the straight way is as short as can be beside the loop that it cuts off.
    """

    channel: int
    at: Place
    to: Place | None = None

    def check(self) -> dict[str, Any]:
        """Check the channel and both places."""
        to = None if self.to is None else _place(self.to, "to")
        return {"channel": _channel(self.channel), "at": _place(self.at), "to": to}


@dataclasses.dataclass(frozen=True)
class SetChannel(Edit):
    """Set width, depth or discharge of a channel, or of a reach of it.

    A reach becomes a channel of its own, between through nodes; so the channel has the same identity downstream of it,
    and new ones in the reach and upstream of it. More or less discharge goes on downstream, and width and depth follow,
    there and in the channel itself where they are not given.

    Attributes:
        channel: Identity of the channel.
        width: Bankfull width, m; where it varies along the channel, its mean.
        depth: Bankfull depth, m, likewise.
        discharge: Bankfull discharge at the downstream end, m3/s; of a whole channel only.
        reach: (from, to), two places on the channel; by default all of it.
    """

    channel: int
    width: float | None = None
    depth: float | None = None
    discharge: float | None = None
    reach: tuple[Place, Place] | None = None

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        if self.width is None and self.depth is None and self.discharge is None:
            raise InputError("SetChannel sets nothing; give width, depth or discharge")
        reach = self.reach
        if reach is not None:
            if not isinstance(reach, Sequence) or len(reach) != 2:
                raise InputError(f"reach is {shown(reach)}; give two places, (from, to)")
            reach = (_place(reach[0], "reach[0]"), _place(reach[1], "reach[1]"))
            if self.discharge is not None:
                raise InputError("discharge cannot be set in a reach: it is that of the channel; leave reach out")
        return {
            "channel": _channel(self.channel),
            "width": _positive_or_none(self.width, "width", "m"),
            "depth": _positive_or_none(self.depth, "depth", "m"),
            "discharge": _positive_or_none(self.discharge, "discharge", "m3/s"),
            "reach": reach,
        }


@dataclasses.dataclass(frozen=True)
class EditTerrain(Edit):
    """Change the heights under the network, as :meth:`warpriver.Terrain.brush` and ``add_ridge`` do.

    Attributes:
        operation: "raise", "lower", "smooth" or "flatten" under a round brush; "ridge" along a line.
        center: (x, y) of the brush, m.
        radius: Radius of the brush, m.
        amount: m for "raise" and "lower", a fraction from 0 to 1 for "smooth" and "flatten".
        level: Height in m that "flatten" goes to; by default that at the centre.
        line: (n, 2) points of the ridge, m.
        height: Height of its crest in m, one number or one a point; a valley below 0.
        width: Width of its foot, m.
    """

    operation: str
    center: tuple[float, float] | None = None
    radius: float | None = None
    amount: float | None = None
    level: float | None = None
    line: Line | None = None
    height: float | tuple[float, ...] | None = None
    width: float | None = None

    def check(self) -> dict[str, Any]:
        """Check the fields: those that the operation needs, and no others."""
        one_of(self.operation, "operation", (*BRUSHES, "ridge"))
        ridge, brush = ("line", "height", "width"), ("center", "radius", "amount")
        needed, others = (ridge, (*brush, "level")) if self.operation == "ridge" else (brush, ridge)
        for name in needed:
            if getattr(self, name) is None:
                raise InputError(f"{name} is missing; to {self.operation} give {', '.join(needed)}")
        if self.level is not None and self.operation not in ("flatten", "ridge"):
            raise InputError(f"level is {shown(self.level)}; only flatten goes to one")
        for name in others:
            if getattr(self, name) is not None:
                raise InputError(f"{name} is given, which {self.operation} does not take; leave it out")
        if self.operation != "ridge":
            amount = not_negative(self.amount, "amount")
            if self.operation in ("smooth", "flatten") and amount > 1.0:
                raise InputError(f"amount is {amount:g}; to {self.operation} give a fraction, 0 to 1")
            level = None if self.level is None else finite_numbers([self.level], 1, "level")[0]
            return {
                "center": tuple(finite_numbers(self.center, 2, "center")),
                "radius": positive(self.radius, "radius", "m"),
                "amount": amount,
                "level": level,
            }
        line = _line(self.line, "line")
        height: Any = self.height
        if np.ndim(height) == 0:
            height = finite_numbers([height], 1, "height")[0]
        else:
            height = tuple(finite_numbers(height, len(line), "height"))
        return {"line": line, "height": height, "width": positive(self.width, "width", "m")}


@dataclasses.dataclass(frozen=True)
class AvulseChannel(Edit):
    """Let a channel leave its course for a new one, as by an avulsion; the ground is carved along it.

    What is not given is left to chance, by the seed of the run, the step and the place: see
    :class:`warpriver.meander.AvulsionParams`, whose other constants hold.

    Attributes:
        channel: Identity of the channel.
        at: Place where it leaves.
        to: Place farther downstream where it comes back.
        angle: First angle between the old course and the new one, degrees, to the left.
    """

    channel: int
    at: Place
    to: Place | None = None
    angle: float | None = None

    def check(self) -> dict[str, Any]:
        """Check the channel, both places and the angle."""
        angle = None if self.angle is None else finite_numbers([self.angle], 1, "angle")[0]
        if angle is not None and abs(angle) > 90.0:
            raise InputError(f"angle is {angle:g} degrees; give -90 (right) to 90 (left)")
        to = None if self.to is None else _place(self.to, "to")
        return {"channel": _channel(self.channel), "at": _place(self.at), "to": to, "angle": angle}


@dataclasses.dataclass(frozen=True)
class DivertChannel(Edit):
    """Let a channel leave its course for another channel, along the cheapest way over the ground, which is carved.

    A way costs its length, and more where it climbs. A junction is made where it ends; what lies downstream on the old
    course falls dry, down to where other water arrives, and discharge, width and depth follow along both.

    Attributes:
        channel: Identity of the channel.
        at: Place where it leaves.
        to: Identity of the other channel, or "outlet": the edge of the ground; by default the channel that is reached
            at the lowest cost.
    """

    channel: int
    at: Place
    to: int | str | None = None

    def check(self) -> dict[str, Any]:
        """Check the channels and the place."""
        to = self.to if self.to is None or self.to == "outlet" else _channel(self.to, "to")
        return {"channel": _channel(self.channel), "at": _place(self.at), "to": to}


@dataclasses.dataclass(frozen=True)
class DeferJunction(Edit):
    """Let a tributary run along the belt of the river, down to a bend that reaches as far out, and join it there.

    As the Yazoo does beside the Mississippi. The course keeps two widths of the river outside of its bends, and is
    carved into the ground; it does not go past other tributaries of its side.

    Attributes:
        channel: Identity of the tributary.
    """

    channel: int

    def check(self) -> dict[str, Any]:
        """Check the channel."""
        return {"channel": _channel(self.channel)}


@dataclasses.dataclass(frozen=True)
class PaintControl(Edit):
    """Set cells of a painted control field; what is painted on a field itself is told by this.

    Attributes:
        control: Place of the field among the controls.
        window: First row, first column, rows and columns of the cells.
        values: Their values in m, row by row.
    """

    control: int
    window: tuple[int, int, int, int]
    values: tuple[float, ...]

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        if not isinstance(self.window, Sequence) or len(self.window) != 4:
            raise InputError(f"window is {self.window!r}; give first row, first column, rows and columns")
        row, column = (whole(value, "window") for value in self.window[:2])
        rows, columns = (whole(value, "window", 1) for value in self.window[2:])
        values = floats(self.values, "values")
        if values.shape != (rows * columns,):
            raise InputError(f"values have the shape {values.shape}; give one for each of {rows} x {columns} cells")
        return {
            "control": whole(self.control, "control"),
            "window": (row, column, rows, columns),
            "values": tuple(values.tolist()),
        }


def _channel(value: Any, name: str = "channel") -> int:
    return whole(value, name)


def _place(value: Any, name: str = "at") -> Place:
    if np.ndim(value) == 0:
        return not_negative(value, name, "m", hint=" from the head of the channel, or a point (x, y)")
    x, y = finite_numbers(value, 2, name)
    return (x, y)


def _positive_or_none(value: Any, name: str, unit: str) -> float | None:
    return None if value is None else positive(value, name, unit)


def _line(xy: Any, name: str) -> Line:
    """A line of two points or more, none of them twice in a row."""
    points = checked_points(xy, name)
    if len(points) >= 3:
        checked_line(points, name)
    elif len(points) < 2 or (points[0] == points[1]).all():
        raise InputError(f"{name} has {len(points)} points; give at least 2, not in one place")
    return tuple((x, y) for x, y in points.tolist())
