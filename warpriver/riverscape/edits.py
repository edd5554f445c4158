"""What an author does to a riverscape, as values: its water, what lies in it, its rivers; see ``Riverscape.apply``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from warpriver.edits.values import Edit
from warpriver.errors import InputError
from warpriver.riverscape.primitives import (
    KINDS,
    SHAPES,
    Merge,
    Node,
    Primitives,
    Replace,
    check_primitives,
)
from warpriver.riverscape.templates import type_index
from warpriver.validate import checked_line, finite, finite_numbers, one_of, positive, shown, whole

__all__ = [
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
    "node_of",
    "node_values",
    "shape_column",
]


# Columns of primitives that can be set or scaled; those with two numbers.
COLUMNS = ("radius", "level", "gradient", "velocity", "amplitude", "wavelength", "effervescence")
PAIRS = ("gradient", "velocity")
Pair = tuple[float, float]


def node_values(node: Node) -> tuple[Any, ...]:
    """Return a tree as tuples of words and numbers, which JSON can hold; :func:`node_of` takes them back."""
    if isinstance(node, Primitives):
        rows = ((f.name, _plain(getattr(node, f.name))) for f in dataclasses.fields(Primitives))
        return ("primitives", tuple(rows))
    if isinstance(node, Merge):
        return ("merge", *(node_values(child) for child in node.children))
    return ("replace", node_values(node.under), node_values(node.over))


def node_of(values: Any) -> Node:
    """Return the tree that :func:`node_values` described.

    Raises:
        ValueError: It is none.
    """
    try:
        kind, *rest = values
        if kind == "merge":
            return Merge(tuple(node_of(child) for child in rest))
        if kind == "replace":
            under, over = rest
            return Replace(node_of(under), node_of(over))
        if kind != "primitives":
            raise InputError(f"{shown(kind)} is no kind of node")
        columns = dict(rest[0])
        whole_numbers = ("kind", "offset")
        arrays: dict[str, Any] = {
            name: np.array(v, np.int64 if name in whole_numbers else np.float64) for name, v in columns.items()
        }
        rows = Primitives(**arrays)
        wide = {name: np.shape(getattr(rows, name))[1:] for name in ("center", *PAIRS, "shape")}
        if not len(rows) or wide != {"center": (2,), "gradient": (2,), "velocity": (2,), "shape": (3,)}:
            raise InputError("arrays of primitives do not fit together")
        if any(len(getattr(rows, f.name)) != len(rows) for f in dataclasses.fields(Primitives)):
            raise InputError("arrays of primitives do not fit together")
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"tree is no tree of water ({error}); give Primitives, Merge or Replace") from error
    check_primitives(rows)
    return rows


def _plain(array: np.ndarray) -> tuple[Any, ...]:
    return tuple(tuple(row) if isinstance(row, list) else row for row in array.tolist())


def shape_column(kind: int, name: str) -> int | None:
    """Return which number of a primitive's shape has a name, for a kind; None if none has."""
    names = SHAPES.get(kind, ())
    return names.index(name) if name in names else None


def _tree(value: Any) -> tuple[Any, ...]:
    """A tree as it is stored, of a node or of such tuples."""
    if isinstance(value, (Primitives, Merge, Replace)):
        return node_values(value)
    return node_values(node_of(value))


def _name(value: Any, name: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"{name} is {shown(value)}; give a word")
    return value


class _OfRiverscape(Edit):
    """An edit of a riverscape."""

    of: ClassVar[str] = "riverscape"


@dataclasses.dataclass(frozen=True)
class _Selecting(_OfRiverscape):
    """Which primitives an edit is about: those that all of what is given holds for.

    Attributes:
        layer: Name of a layer of the water, such as "body", "waves", "wakes", "eddies", or one that was added.
        center: (x, y) of a circle that their centres lie in, m.
        radius: Of that circle, m.
        kind: A kind of primitive.
    """

    layer: str | None = None
    center: Pair | None = None
    radius: float | None = None
    kind: str | None = None

    def selection(self) -> dict[str, Any]:
        """Return the fields above, checked."""
        if self.layer is None and self.center is None and self.kind is None:
            raise InputError("nothing says which primitives are meant; give layer, kind, or center and radius")
        if (self.center is None) != (self.radius is None):
            raise InputError("center and radius go together; give both, or neither")
        return {
            "layer": None if self.layer is None else _name(self.layer, "layer"),
            "center": None if self.center is None else tuple(finite_numbers(self.center, 2, "center")),
            "radius": None if self.radius is None else positive(self.radius, "radius", "m"),
            "kind": None if self.kind is None else one_of(self.kind, "kind", tuple(KINDS)),
        }


@dataclasses.dataclass(frozen=True)
class AddWater(_OfRiverscape):
    """Put primitives, or a tree of them, upon the water, as a layer of a name.

    Attributes:
        tree: Primitives, merged and replaced; stored as tuples.
        layer: Its name, which no layer has yet.
        operator: "replace" what lies below, or "merge" with it.
        relative: Whether levels, gradients and velocities are added to those of the water where each centre lies.
    """

    tree: Any
    layer: str
    operator: str = "replace"
    relative: bool = True

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        one_of(self.operator, "operator", ("replace", "merge"))
        one_of(self.relative, "relative", (True, False))
        return {"tree": _tree(self.tree), "layer": _name(self.layer, "layer")}


@dataclasses.dataclass(frozen=True)
class MoveWater(_Selecting):
    """Move primitives as they are.

    Attributes:
        by: (x, y) m.
        layer, center, radius, kind: Which ones: those for which all that is given holds.
    """

    by: Pair = (0.0, 0.0)

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        return self.selection() | {"by": tuple(finite_numbers(self.by, 2, "by"))}


@dataclasses.dataclass(frozen=True)
class ChangeWater(_Selecting):
    """Set numbers of primitives, or multiply them.

    Attributes:
        set: New values by name: radius, level, gradient, velocity, amplitude, wavelength, effervescence, or a number
            of the shape of the kind, such as spin.
        times: Factors by name.
        layer, center, radius, kind: Which ones: those for which all that is given holds.
    """

    set: Any = ()
    times: Any = ()

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        found = self.selection()
        for field in ("set", "times"):
            given = getattr(self, field)
            try:
                pairs = list(given.items()) if isinstance(given, Mapping) else [tuple(pair) for pair in given]
            except TypeError:
                raise InputError(f"{field} is {shown(given)}; give names and numbers") from None
            stored: list[tuple[str, Any]] = []
            for pair in pairs:
                if len(pair) != 2:
                    raise InputError(f"{field} holds {shown(pair)}; give names and numbers")
                name, value = pair
                known = {*COLUMNS, *(each for names in SHAPES.values() for each in names)}
                one_of(name, f"a name in {field}", tuple(sorted(known)))
                if field == "set" and name in PAIRS:
                    stored.append((name, tuple(finite_numbers(value, 2, name))))
                else:
                    stored.append((name, finite(value, name)))
            found[field] = tuple(sorted(stored))
        if not found["set"] and not found["times"]:
            raise InputError("nothing is to be changed; give set or times")
        return found


@dataclasses.dataclass(frozen=True)
class RemoveWater(_Selecting):
    """Take primitives, or a whole layer, away.

    Attributes:
        layer, center, radius, kind: Which ones: those for which all that is given holds.
    """

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        return self.selection()


@dataclasses.dataclass(frozen=True)
class ReplaceWater(_Selecting):
    """Put a tree in the place of primitives, or of a whole layer.

    Attributes:
        tree: Primitives, merged and replaced; stored as tuples. It is merged with what is left of the layer.
        relative: Whether levels, gradients and velocities are added to those of the water where each centre lies.
        layer, center, radius, kind: What goes: primitives for which all that is given holds; a layer is needed.
    """

    tree: Any = None
    relative: bool = True

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        if self.layer is None:
            raise InputError("layer is missing; say in which layer the tree is to stand")
        one_of(self.relative, "relative", (True, False))
        return self.selection() | {"tree": _tree(self.tree)}


@dataclasses.dataclass(frozen=True)
class AddRock(_OfRiverscape):
    """Lay a boulder; in the water it has a wake and a pair of eddies.

    Attributes:
        center: (x, y) m.
        diameter: m.
        height: Of its top over the water, or over the ground where there is none, m; below 0 it is covered.
    """

    center: Pair
    diameter: float
    height: float = 0.1

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        return {
            "center": tuple(finite_numbers(self.center, 2, "center")),
            "diameter": positive(self.diameter, "diameter", "m"),
            "height": finite(self.height, "height", "m"),
        }


@dataclasses.dataclass(frozen=True)
class AddLog(_OfRiverscape):
    """Lay a trunk; in the water it has rough water along its lee, and an eddy behind either end.

    Attributes:
        start: (x, y) of one end, m.
        end: (x, y) of the other.
        diameter: m.
        height: Of its upper side over the water at its middle, m; below 0 it is covered.
    """

    start: Pair
    end: Pair
    diameter: float
    height: float = 0.1

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        start, end = (tuple(finite_numbers(getattr(self, name), 2, name)) for name in ("start", "end"))
        diameter = positive(self.diameter, "diameter", "m")
        if np.hypot(end[0] - start[0], end[1] - start[1]) < diameter:
            raise InputError("the log is shorter than it is thick; give two ends farther apart, or AddRock")
        return {"start": start, "end": end, "diameter": diameter, "height": finite(self.height, "height", "m")}


@dataclasses.dataclass(frozen=True)
class MoveObstacle(_OfRiverscape):
    """Move the nearest rock or log, with its wake; it stands as high over the water as before.

    Attributes:
        at: (x, y) on it, m.
        to: (x, y) to which its middle goes, m.
    """

    at: Pair
    to: Pair

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        return {name: tuple(finite_numbers(getattr(self, name), 2, name)) for name in ("at", "to")}


@dataclasses.dataclass(frozen=True)
class RemoveObstacle(_OfRiverscape):
    """Take the nearest rock or log away, with its wake.

    Attributes:
        at: (x, y) on it, m.
    """

    at: Pair

    def check(self) -> dict[str, Any]:
        """Check the place."""
        return {"at": tuple(finite_numbers(self.at, 2, "at"))}


@dataclasses.dataclass(frozen=True)
class RetypeChannel(_OfRiverscape):
    """Give a channel another type, and lay it anew; other channels, and the levels of its nodes, stay.

    Attributes:
        channel: Number of the channel.
        type: Rosgen's type, such as "C".
    """

    channel: int
    type: str

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        if not isinstance(self.type, str):
            raise InputError(f"type is {shown(self.type)}; give a word, such as 'C'")
        type_index(self.type)
        return {"channel": whole(self.channel, "channel"), "type": self.type.strip()}


@dataclasses.dataclass(frozen=True)
class RedrawCourse(_OfRiverscape):
    """Give a channel another course between two of its points, and lay it anew; other channels and all nodes stay.

    Attributes:
        channel: Number of the channel.
        xy: (n, 2) m, downstream; it begins and ends at the points of the channel nearest to its ends.
    """

    channel: int
    xy: tuple[Pair, ...]

    def check(self) -> dict[str, Any]:
        """Check the fields."""
        line = checked_line(self.xy, "xy")
        return {"channel": whole(self.channel, "channel"), "xy": tuple(tuple(p) for p in line.tolist())}
