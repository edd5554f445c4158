"""Events of a run: one dataclass a kind, all of them in one log in order of time.

A new kind is a frozen dataclass that derives from :class:`Event`, in the module of the process that it tells of. That
is all: it is recorded, stored, read and resumed by its fields, which may be float, int, bool, str or NumPy arrays, and
any of them or None.
"""

from __future__ import annotations

import dataclasses
import re
import types
import typing
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar, TypeVar, cast, overload

import numpy as np

from warpriver.errors import InputTypeError
from warpriver.validate import shown

__all__ = [
    "Avulsion",
    "Collision",
    "Crevasse",
    "Cutoff",
    "Event",
    "EventField",
    "EventLog",
    "HeldLock",
    "Split",
    "event_class",
    "event_fields",
]

# Classes by the name of their kind.
_CLASSES: dict[str, type[Event]] = {}
# Fields by class, once they have been asked for.
_FIELDS: dict[type[Event], tuple[EventField, ...]] = {}


@dataclasses.dataclass(frozen=True)
class Event:
    """Something that happened at one time.

    Attributes:
        time: yr.
        kind: Name of the kind, the same for all events of a class: that of the class in small letters.
    """

    time: float
    kind: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        """Make a class known under the name of its kind.

        Raises:
            TypeError: Another class has that name.
        """
        super().__init_subclass__(**options)
        cls.kind = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        known = _CLASSES.get(cls.kind)
        if known is not None and _place(known) != _place(cls):
            raise InputTypeError(
                f"{_place(cls)} and {_place(known)} are both events of the kind {cls.kind!r}; rename one"
            )
        _CLASSES[cls.kind] = cls
        # A dataclass keeps the comparison that it finds; its own takes no arrays.
        cls.__eq__ = Event.__eq__  # type: ignore[method-assign]

    def __eq__(self, other: object) -> bool:
        """Tell whether another event is of the same kind and equal in all fields; NaN equals NaN."""
        if type(self) is not type(other):
            return NotImplemented
        return all(_same(getattr(self, f.name), getattr(other, f.name)) for f in dataclasses.fields(self))


@dataclasses.dataclass(frozen=True)
class Cutoff(Event):
    """One neck cutoff: the loop that a channel left behind as an oxbow lake, or the part that a ring split off.

    Attributes:
        time: Time of the cutoff, yr.
        channel: Identity of the channel.
        width: Bankfull width there, m.
        xy: (n, 2) float64 abandoned line in m, absolute, downstream order, both neck points included. Shortest paths
            leave closed loops: the first point is repeated at the end.
        depth: Bankfull depth there, m; None in runs of versions that did not note it, as the following.
        discharge: Bankfull discharge of the channel, m3/s.
        section: (n, 2) float64 width and depth at each point of ``xy`` in m, or None where they are constant along it.
        chute: Whether a chute across the bar cut the bend off, not the river at a neck.
    """

    channel: int
    width: float
    xy: np.ndarray
    depth: float | None = None
    discharge: float | None = None
    section: np.ndarray | None = None
    chute: bool = False


@dataclasses.dataclass(frozen=True)
class Collision(Event):
    """Two channels that touched and were joined there [Paris2023, Sec. 6.2].

    Attributes:
        time: yr.
        case: "upstream": two tributaries of a junction meet upstream of it, and the junction moves up.
            "downstream": a tributary meets the river that it flows into downstream of its mouth, which moves down.
            "neck": a river meets itself across nodes; the upper channel is the largest that arrives at each of them.
            "disconnected": neither flows into the other, and the smaller one is captured.
        channel: Identity of the channel that gave way; it ends at ``other`` now. In a neck it is the upper one.
        other: Identity of the channel that kept its course. What lies downstream of where they meet keeps it, except in
            an upstream collision, where that is a piece of the channel that both flow into.
        width: Bankfull width of the channel that gave way, m.
        xy: (n, 2) float64 course that was abandoned, m, absolute, downstream order; pieces of several channels lie one
            after the other, cut by ``start``.
        start: (k + 1,) int64 offsets of the pieces in ``xy``.
        depth: Bankfull depth of the channel that gave way, m; None where it was not noted, as the following.
        discharge: Its bankfull discharge, m3/s.
        section: (n, 2) float64 width and depth at each point of ``xy`` in m, or None where they are constant.
    """

    case: str
    channel: int
    other: int
    width: float
    xy: np.ndarray
    start: np.ndarray
    depth: float | None = None
    discharge: float | None = None
    section: np.ndarray | None = None

    def pieces(self) -> list[np.ndarray]:
        """Return the abandoned pieces, each an (n, 2) line."""
        return np.split(self.xy, self.start[1:-1])


@dataclasses.dataclass(frozen=True)
class HeldLock(Event):
    """A cutoff or a collision that did not happen, because a locked point would have gone with it.

    It is told once of two channels; for as long as they touch, they lie over each other.

    Attributes:
        time: yr, when it was first refused.
        case: "cutoff", or as in :class:`Collision`.
        channel: Identity of the channel that would have given way.
        other: Identity of the other one.
        x: Place of the locked point, m.
        y: Place of the locked point, m.
    """

    case: str
    channel: int
    other: int
    x: float
    y: float


@dataclasses.dataclass(frozen=True)
class Split(Event):
    """A ring that a neck divided in two rings which both go on, ``ring_policy="both"``.

    Attributes:
        time: yr.
        channel: Identity of the ring, which goes on with the part that holds its first point.
        other: Identity of the new ring, the other part.
        width: Bankfull width at the neck, m.
        xy: (n, 2) float64 line of the new ring as it came off, in m, absolute, downstream order, from the one bank of
            the neck to the other.
    """

    channel: int
    other: int
    width: float
    xy: np.ndarray


@dataclasses.dataclass(frozen=True)
class Crevasse(Event):
    """A bank that broke at the apex of a bend [Paris2023], Sec. 5.2.

    Attributes:
        time: yr.
        channel: Identity of the channel.
        width: Bankfull width there, m.
        curvature: Width times curvature, above 0 where the channel turns left.
        x: Where, m.
        y: Where, m.
        outcome: "" where that was all, "avulsion" where the channel left there; else what kept it from leaving.
    """

    channel: int
    width: float
    curvature: float
    x: float
    y: float
    outcome: str


@dataclasses.dataclass(frozen=True)
class Avulsion(Event):
    """A channel that left its course for a new one [Paris2023], Sec. 5.2.

    By chance it leads to a point of its own farther downstream, by hand to another channel, too.

    Attributes:
        time: yr.
        channel: Identity of the channel.
        width: Bankfull width where it left, m.
        xy: (n, 2) float64 course that was abandoned, m, absolute, downstream order, both ends included.
        course: (m, 2) float64 new course, likewise.
        bed: (m,) float64 bed that was carved along it, m; empty on a plain.
        depth: Bankfull depth where it left, m; None where it was not noted, as the following.
        discharge: Its bankfull discharge, m3/s.
        section: (n, 2) float64 width and depth at each point of ``xy`` in m, or None where they are constant.
    """

    channel: int
    width: float
    xy: np.ndarray
    course: np.ndarray
    bed: np.ndarray
    depth: float | None = None
    discharge: float | None = None
    section: np.ndarray | None = None


# ---- what a kind holds


class EventField(typing.NamedTuple):
    """One field of a kind of events.

    Attributes:
        name: Its name.
        type: float, int, bool, str or ``numpy.ndarray``.
        optional: Whether it may be None.
    """

    name: str
    type: type
    optional: bool


def event_class(kind: str) -> type[Event] | None:
    """Return the class of a kind, None where no class of that name was made in this program."""
    return _CLASSES.get(kind)


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == b.dtype.kind == "f")
    return a is b or bool(np.array_equal(a, b)) or (a != a and b != b)


def _place(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"


def event_fields(cls: type[Event]) -> tuple[EventField, ...]:
    """Return the fields of a kind, or raise ``TypeError`` for one that cannot be stored."""
    if cls not in _FIELDS:
        _FIELDS[cls] = _fields_of(cls)
    return _FIELDS[cls]


def _fields_of(cls: type[Event]) -> tuple[EventField, ...]:
    if not dataclasses.is_dataclass(cls) or "__dataclass_fields__" not in vars(cls):
        raise InputTypeError(f"{_place(cls)} is no dataclass; decorate it with @dataclasses.dataclass(frozen=True)")
    try:
        hints = typing.get_type_hints(cls)
    except NameError as error:
        raise InputTypeError(
            f"the types of the fields of {_place(cls)} are not known where it stands: {error}"
        ) from error
    fields = []
    for field in dataclasses.fields(cls):
        parts = [hints[field.name]]
        if typing.get_origin(parts[0]) in (typing.Union, types.UnionType):
            parts = list(typing.get_args(parts[0]))
        bare = [typing.get_origin(part) or part for part in parts if part is not type(None)]
        if len(bare) != 1 or bare[0] not in (float, int, bool, str, np.ndarray):
            raise InputTypeError(
                f"field {field.name} of {_place(cls)} is {hints[field.name]}; an event holds float, int, bool, str and "
                "NumPy arrays, and any of them or None"
            )
        fields.append(EventField(field.name, bare[0], len(bare) < len(parts)))
    return tuple(fields)


# ---- the log

_ALLOWED: dict[type, Any] = {
    float: (float, int, np.floating, np.integer),
    int: (int, np.integer),
    bool: (bool, np.bool_),
    str: str,
    np.ndarray: np.ndarray,
}
E = TypeVar("E", bound=Event)


class EventLog(Sequence[Event]):
    """All events of a run in the order in which they happened."""

    def __init__(self, events: Iterable[Event] = ()):
        """Start a log with events."""
        self._events: list[Event] = []
        self._by_kind: dict[str, list[Event]] = {}
        self._forms: dict[tuple[str, str], tuple[Any, ...]] = {}
        self.extend(events)

    def __len__(self) -> int:
        return len(self._events)

    @overload
    def __getitem__(self, index: int) -> Event: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Event]: ...

    def __getitem__(self, index: int | slice) -> Event | Sequence[Event]:
        return self._events[index]

    def __iter__(self) -> Iterator[Event]:
        return iter(self._events)

    def of(self, cls: type[E]) -> Sequence[E]:
        """Return the events of one kind, as a sequence that grows with the log."""
        return _EventsOfKind(self, cls)

    def counts(self) -> dict[str, int]:
        """Return how many events of each kind there are, of kinds that there are."""
        return {kind: len(events) for kind, events in self._by_kind.items() if events}

    def append(self, event: Event) -> None:
        """Add an event.

        Raises:
            TypeError: It is no event, or holds what cannot be stored.
        """
        self._check(event)
        self._events.append(event)
        self._by_kind.setdefault(event.kind, []).append(event)

    def extend(self, events: Iterable[Event]) -> None:
        """Add events."""
        for event in events:
            self.append(event)

    def truncate(self, count: int) -> None:
        """Keep the first ``count`` events only."""
        for event in reversed(self._events[count:]):
            self._by_kind[event.kind].pop()
        del self._events[count:]

    def __repr__(self) -> str:
        told = ", ".join(f"{count} {kind}" for kind, count in self.counts().items())
        return f"EventLog({told or 'empty'})"

    def _check(self, event: Event) -> None:
        if _CLASSES.get(getattr(event, "kind", "")) is not type(event):
            raise InputTypeError(f"{event!r} is no event; make a frozen dataclass that derives from Event")
        for name, kind, optional in event_fields(type(event)):
            value = getattr(event, name)
            if kind is np.ndarray and isinstance(value, np.ndarray):
                self._check_array(event, name, value)
            elif not isinstance(value, _ALLOWED[kind]) and not (value is None and optional):
                raise InputTypeError(
                    f"{name} of the event {type(event).__name__} is {shown(value)}, not {kind.__name__}"
                )

    def _check_array(self, event: Event, name: str, array: np.ndarray) -> None:
        # Those of all events are stored end to end.
        form, known = (array.dtype, array.shape[1:]), self._forms.get((event.kind, name))
        if form == known and array.ndim:
            return
        what = f"{name} of the event {type(event).__name__} is {array.dtype} {array.shape}"
        if array.ndim == 0 or array.dtype.kind not in "biufU":
            raise InputTypeError(f"{what}; give an array of numbers, words or flags with one axis or more")
        if known is not None and (form[1] != known[1] or not form[0].kind == known[0].kind == "U"):
            raise InputTypeError(f"{what}, in events before {known[0]} {('n', *known[1])}; all must be of one form")
        self._forms[event.kind, name] = form


class _EventsOfKind(Sequence[E]):
    """The events of one kind in a log."""

    def __init__(self, log: EventLog, cls: type[E]):
        self._log, self._kind = log, cls.kind

    @property
    def _events(self) -> list[E]:
        return cast(list[E], self._log._by_kind.get(self._kind, []))

    def __len__(self) -> int:
        return len(self._events)

    @overload
    def __getitem__(self, index: int) -> E: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[E]: ...

    def __getitem__(self, index: int | slice) -> E | Sequence[E]:
        return self._events[index]

    def __iter__(self) -> Iterator[E]:
        return iter(self._events)

    def __eq__(self, other: object) -> bool:
        """Tell whether another sequence holds equal events in the same order."""
        return isinstance(other, Sequence) and self._events == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(self._events)
