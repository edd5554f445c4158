"""ChannelTable: what belongs to whole channels, one read-only column for each quantity.

It is the only place that lists the columns of a channel. Networks, edits of the graph, records and files pass it whole,
so that a column reaches all of them once it is here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from warpriver.errors import InputError, InputTypeError
from warpriver.validate import numbers, positive_numbers

__all__ = ["JOINT_LOCK", "JOINT_NONE", "JOINT_THROUGH", "ChannelTable"]

# What the node at the foot of a channel is to the river: any node; a through node, where one river is two channels; or
# a locked point of it, which nothing moves.
JOINT_NONE, JOINT_THROUGH, JOINT_LOCK = 0, 1, 2


def _whole(dtype: Any) -> Callable[[Any, str], np.ndarray]:
    def check(values: Any, name: str) -> np.ndarray:
        array = np.asarray(values)
        whole = array.dtype.kind in "iu" or (array.dtype.kind == "f" and np.array_equal(array, np.round(array)))
        if not whole:
            raise InputError(f"{name} is {array.dtype}; give one whole number a channel")
        return array.astype(dtype)

    return check


def _positive_or_unknown(values: Any, name: str) -> np.ndarray:
    array = numbers(values, name)
    wrong = array <= 0.0
    if wrong.any():
        c = int(wrong.argmax())
        raise InputError(
            f"{name} of channel {c} is {array.flat[c]:g}; it must be positive, or NaN where it is not known"
        )
    return array


def _flags(values: Any, name: str) -> np.ndarray:
    array = np.array(values)
    if array.dtype.kind not in "biu" and array.size:
        raise InputError(f"{name} is {array.dtype}; give True or False for each channel")
    return array.astype(bool)


def _unknown(count: int) -> np.ndarray:
    return np.full(count, np.nan)


def _no_node(count: int) -> np.ndarray:
    return np.full(count, -1, np.int32)


def _nowhere(count: int) -> np.ndarray:
    return np.zeros(count, bool)


def _joints(values: Any, name: str) -> np.ndarray:
    array = _whole(np.int32)(values, name)
    wrong = (array < JOINT_NONE) | (array > JOINT_LOCK)
    if wrong.any():
        c = int(wrong.argmax())
        raise InputError(f"{name} of channel {c} is {array.flat[c]}; it is 0, 1 (a through node) or 2 (a locked point)")
    return array


def _no_joint(count: int) -> np.ndarray:
    return np.full(count, JOINT_NONE, np.int32)


def _free(values: Any, name: str) -> np.ndarray:
    """Return a free column as bool, int64, float64 or text, or raise ``ValueError``."""
    array = np.array(values)
    if array.dtype.kind == "O" and all(isinstance(value, str) for value in array.flat):
        array = array.astype(str)
    kind = array.dtype.kind
    if kind == "u" and array.size and array.max() > np.iinfo(np.int64).max:
        raise InputError(f"{name} holds {array.max()}, which does not fit into a signed number of 64 bits")
    if kind not in "biufU":
        raise InputError(
            f"{name} is {array.dtype}; give numbers, words or True and False, one a channel (NaN or '' where nothing "
            "is known)"
        )
    return array.astype({"b": bool, "i": np.int64, "u": np.int64, "f": np.float64}.get(kind, array.dtype))


class _Column(NamedTuple):
    """What makes a column of what is given.

    Attributes:
        check: Returns the column of given values, or raises ``ValueError``; gets its name for messages.
        missing: Makes the column of so many channels where no values are given; None: it stays None.
        required: Whether values must be given.
    """

    check: Callable[[Any, str], np.ndarray]
    missing: Callable[[int], np.ndarray] | None = None
    required: bool = False


COLUMNS = {
    "width": _Column(positive_numbers, required=True),
    "depth": _Column(positive_numbers, required=True),
    "discharge": _Column(positive_numbers, required=True),
    "drainage_area": _Column(_positive_or_unknown),
    "slope": _Column(numbers, _unknown),
    "id": _Column(_whole(np.int64), np.arange),
    "from_node": _Column(_whole(np.int32), _no_node),
    "to_node": _Column(_whole(np.int32), _no_node),
    "closed": _Column(_flags, _nowhere),
    "joint": _Column(_joints, _no_joint),
}


@dataclasses.dataclass(frozen=True, init=False, eq=False, repr=False)
class ChannelTable:
    """The columns of C channels; ``len`` gives C, iteration the names of the columns, ``table[name]`` one of them.

    Neither the table nor its arrays can be written into: :meth:`replace` and :meth:`take` make new ones, which share
    what stays the same. Beside the columns below a table takes free ones of any name, numbers, words or flags, which go
    through edits, records and files with the others. Arrays given to a constructor are copied.

    Attributes:
        width: (C,) float64, bankfull width in m (the mean, where it varies along the channel).
        depth: (C,) float64, bankfull depth in m.
        discharge: (C,) float64, bankfull discharge in m3/s at the downstream end.
        drainage_area: (C,) float64, drainage area in m2 at the downstream end, NaN where it is not known; or None where
            that of no channel is.
        slope: (C,) float64, drop of the channel over its length, m/m; NaN where it is not known.
        id: (C,) int64, identity that a channel keeps when others come and go; by default the indices.
        from_node: (C,) int32, node at the upstream end; -1 in a table that belongs to no network yet.
        to_node: (C,) int32, node at the downstream end; likewise.
        closed: (C,) bool, True for rings.
        joint: (C,) int32, what the node at the downstream end is to the river: 0 for any node; 1 for a through node,
            where a river was split in two channels; 2 for a locked point, whose river is one all the same. It counts
            where one channel ends and one begins.
        extra: The free columns by name, each (C,) bool, int64, float64 or text.
    """

    width: np.ndarray
    depth: np.ndarray
    discharge: np.ndarray
    drainage_area: np.ndarray | None
    slope: np.ndarray
    id: np.ndarray
    from_node: np.ndarray
    to_node: np.ndarray
    closed: np.ndarray
    joint: np.ndarray
    extra: Mapping[str, np.ndarray]

    def __init__(self, *, extra: Mapping[str, Any] | None = None, **columns: Any):
        """Check and copy columns; ``width``, ``depth`` and ``discharge`` are needed.

        Args:
            extra: The free columns by name.
            columns: The others; None for what is not known.

        Raises:
            TypeError: A column that is needed is missing, or there is none of that name.
            ValueError: A column has another length than ``width``, or values that it cannot have.
        """
        for name in columns:
            if name not in COLUMNS:
                raise InputTypeError(
                    f"a table of channels has no column {name!r}; a free one goes into extra={{{name!r}: ...}}"
                )
        count = 0 if columns.get("width") is None else np.size(columns["width"])
        self._fill(
            {name: _checked(name, columns.get(name), count) for name in COLUMNS},
            {name: _checked_extra(name, values, count) for name, values in (extra or {}).items()},
        )

    def _fill(self, columns: Mapping[str, np.ndarray | None], extra: Mapping[str, np.ndarray]) -> ChannelTable:
        """Take columns that were checked; they become read-only."""
        for name, array in columns.items():
            object.__setattr__(self, name, array)
        object.__setattr__(self, "extra", MappingProxyType(dict(extra)))
        for name in self:
            self[name].flags.writeable = False
        return self

    # ---- reading

    def __len__(self) -> int:
        return len(self.width)

    def __iter__(self) -> Iterator[str]:
        yield from (name for name in COLUMNS if getattr(self, name) is not None)
        yield from self.extra

    def __contains__(self, name: object) -> bool:
        return name in tuple(self)

    def __getitem__(self, name: str) -> np.ndarray:
        if name in self.extra:
            return self.extra[name]
        if name not in COLUMNS or getattr(self, name) is None:
            raise KeyError(f"no column {name!r}; there are {', '.join(self)}")
        column: np.ndarray = getattr(self, name)
        return column

    def __eq__(self, other: object) -> bool:
        """Tell whether the same columns hold the same values; what is not known in both is the same."""
        if not isinstance(other, ChannelTable):
            return NotImplemented
        if set(self) != set(other):
            return False
        return all(np.array_equal(self[n], other[n], equal_nan=self[n].dtype.kind == "f") for n in self)

    __hash__ = None  # type: ignore[assignment]

    @property
    def nbytes(self) -> int:
        """Memory of the columns in bytes."""
        return sum(self[name].nbytes for name in self)

    def __repr__(self) -> str:
        return f"ChannelTable({len(self)} channels: {', '.join(self)})"

    # ---- new tables

    def take(self, index: Any) -> ChannelTable:
        """Return the channels of that index, by number (as often as it stands there), by a (C,) mask or by a slice."""
        columns = {name: getattr(self, name) for name in COLUMNS}
        return object.__new__(ChannelTable)._fill(
            {name: None if array is None else array[index] for name, array in columns.items()},
            {name: array[index] for name, array in self.extra.items()},
        )

    def replace(self, *, extra: Mapping[str, Any] | None = None, **columns: Any) -> ChannelTable:
        """Return a table with other values in some columns.

        Args:
            extra: Free columns to add or to replace; None as the values takes one out.
            columns: New values of columns that there are, of length C. ``drainage_area=None`` makes it unknown.

        Raises:
            ValueError: There is no column of that name (a new one goes into ``extra``), or values that it cannot have.
        """
        known = {name: getattr(self, name) for name in COLUMNS}
        free = dict(self.extra)
        for name, values in columns.items():
            if name in known:
                known[name] = _checked(name, values, len(self))
            elif name in free:
                free[name] = _checked_extra(name, values, len(self))
            else:
                raise InputError(
                    f"no column {name!r}; there are {', '.join(self)}. A new one is added by extra={{{name!r}: ...}}"
                )
        for name, values in (extra or {}).items():
            if values is None:
                free.pop(name, None)
            else:
                free[name] = _checked_extra(name, values, len(self))
        return object.__new__(ChannelTable)._fill(known, free)

    # ---- copies

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, ({name: getattr(self, name) for name in COLUMNS}, dict(self.extra))

    def __deepcopy__(self, memo: Any) -> ChannelTable:
        return self  # nothing in it can change


def _rebuilt(columns: dict[str, Any], extra: dict[str, np.ndarray]) -> ChannelTable:
    return ChannelTable(**columns, extra=extra)


def _checked(name: str, values: Any, count: int) -> np.ndarray | None:
    """Return a column of given values, or what stands for them where there are none (None)."""
    column, label = COLUMNS[name], _label(name)
    if values is None:
        if column.required:
            raise InputTypeError(f"{label} is missing; give one number a channel")
        return None if column.missing is None else column.missing(count)
    return _of_length(label, column.check(values, label), count)


def _checked_extra(name: Any, values: Any, count: int) -> np.ndarray:
    """Return a free column of given values."""
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise InputError(f"an extra column has the name {name!r}; give it one of letters that can be printed")
    if name in COLUMNS or name == "extra":
        raise InputError(f"an extra column has the name {name!r}, which every table has; give it another")
    label = f"extra column {name!r}"
    return _of_length(label, _free(values, label), count)


def _label(name: str) -> str:
    """Name of a column in messages: that of the attribute of a network which gives it."""
    return f"channel_{name.removesuffix('_node')}"


def _of_length(label: str, array: np.ndarray, count: int) -> np.ndarray:
    if array.shape != (count,):
        unit = "whole number" if array.dtype.kind == "i" else "value"
        raise InputError(f"{label} has shape {array.shape} for {count} channels; give one {unit} a channel")
    return array
