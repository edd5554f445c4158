"""Events of a run: one dataclass a kind, all of them in one log in order of time.

A new kind is a frozen dataclass that derives from :class:`Event`, in the module of the process that it tells of. That
is all: it is recorded, stored, read and resumed by its fields, which may be float, int, bool, str or NumPy arrays, and
any of them or None.
"""

from __future__ import annotations

import array
import bisect
import dataclasses
import heapq
import re
import types
import typing
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar, Protocol, TypeVar, cast, overload

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
    "EventView",
    "HeldLock",
    "Split",
    "StoredEvents",
    "event_class",
    "event_fields",
    "events_of",
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
F = TypeVar("F", bound=Event)


class StoredEvents(Protocol):
    """A part of a log that is on disk."""

    def of(self, kind: str) -> Sequence[Event]:
        """Read its events of one kind, in order."""


class EventLog(Sequence[Event]):
    """All events of a run in the order in which they happened.

    Of those that are on disk only kind and time are in memory; they are read when they are asked for.
    """

    def __init__(self, events: Iterable[Event] = ()):
        """Start a log with events."""
        # None: on disk.
        self._held: list[Event | None] = []
        self._times = array.array("d")
        self._kinds = array.array("h")
        self._names: list[str] = []
        # Places of the events of each kind.
        self._places: dict[str, array.array[int]] = {}
        # Where those on disk are: the place of the first event of each part, and the part.
        self._firsts: list[int] = []
        self._parts: list[StoredEvents] = []
        self._forms: dict[str, dict[str, tuple[Any, ...]]] = {}
        self._bytes = 0
        self.extend(events)

    def __len__(self) -> int:
        return len(self._held)

    @overload
    def __getitem__(self, index: int) -> Event: ...

    @overload
    def __getitem__(self, index: slice) -> EventView[Event]: ...

    def __getitem__(self, index: int | slice) -> Event | EventView[Event]:
        if isinstance(index, slice):
            return EventView(self, range(*index.indices(len(self))))
        return self._at(range(len(self))[index])

    def _at(self, place: int) -> Event:
        """Return the event at a place from 0 on."""
        event = self._held[place]
        if event is not None:
            return event
        part = bisect.bisect_right(self._firsts, place) - 1
        kind = self._names[self._kinds[place]]
        places = self._places[kind]
        row = bisect.bisect_left(places, place) - bisect.bisect_left(places, self._firsts[part])
        return self._parts[part].of(kind)[row]

    def __iter__(self) -> Iterator[Event]:
        place = 0
        while place < len(self):
            yield self._at(place)
            place += 1

    @property
    def times(self) -> np.ndarray:
        """Times of the events, (E,) yr float64; none is read for them."""
        return np.array(self._times, np.float64)

    @property
    def kinds(self) -> list[str]:
        """Names of the kinds of the events; none is read for them."""
        return [self._names[kind] for kind in self._kinds]

    @property
    def held_bytes(self) -> int:
        """Bytes of the arrays of events that are in memory."""
        return self._bytes

    def of(self, *classes: type[E]) -> EventView[E]:
        """Return the events of one kind or several, as a sequence that grows with the log."""
        return EventView(self, None, tuple(cls.kind for cls in classes))

    def counts(self) -> dict[str, int]:
        """Return how many events of each kind there are, of kinds that there are."""
        return {kind: len(places) for kind, places in self._places.items() if places}

    def append(self, event: Event) -> None:
        """Add an event.

        Raises:
            TypeError: It is no event, or holds what cannot be stored.
        """
        self._check(event)
        self._bytes += _bytes_of(event)
        self._note(event.kind, float(event.time), event)

    def extend(self, events: Iterable[Event]) -> None:
        """Add events."""
        for event in events:
            self.append(event)

    def _note(self, kind: str, time: float, event: Event | None) -> None:
        places = self._places.get(kind)
        if places is None:
            places = self._places[kind] = array.array("q")
            self._names.append(kind)
        places.append(len(self._held))
        self._kinds.append(self._names.index(kind))
        self._times.append(time)
        self._held.append(event)

    def truncate(self, count: int) -> None:
        """Keep the first ``count`` events only."""
        for place in range(len(self) - 1, count - 1, -1):
            self._places[self._names[self._kinds[place]]].pop()
            self._bytes -= _bytes_of(self._held[place])
        for values in (self._held, self._times, self._kinds):
            del values[count:]
        while self._firsts and self._firsts[-1] >= count:
            self._firsts.pop()
            self._parts.pop()

    # ---- on disk

    def settle(self, first: int, count: int, part: StoredEvents, keep: tuple[type[Event], ...] = ()) -> None:
        """Let events that have been stored go from memory.

        Args:
            first: Place of the first of them; those before it have been stored.
            count: Number of them.
            part: Where they can be read.
            keep: Kinds that stay in memory all the same.
        """
        for place in range(first, first + count):
            event = self._held[place]
            if event is not None and not isinstance(event, keep):
                self._bytes -= _bytes_of(event)
                self._held[place] = None
        self._firsts.append(first)
        self._parts.append(part)

    def take_stored(self, first: int, kinds: Sequence[str], times: Sequence[float], part: StoredEvents) -> None:
        """Note events that are on disk in place of those from a place on.

        Args:
            first: That place.
            kinds: Their kinds.
            times: Their times, yr.
            part: Where they can be read.
        """
        self.truncate(first)
        for kind, time in zip(kinds, times, strict=True):
            self._note(kind, time, None)
        if len(kinds):
            self._firsts.append(first)
            self._parts.append(part)

    def in_memory(self) -> tuple[EventLog, np.ndarray]:
        """Return a log of the events that are in memory, and their places, (n,) int64."""
        places = np.array([place for place, event in enumerate(self._held) if event is not None], np.int64)
        return EventLog(event for event in self._held if event is not None), places

    def __repr__(self) -> str:
        told = ", ".join(f"{count} {kind}" for kind, count in self.counts().items())
        return f"EventLog({told or 'empty'})"

    # ---- what can be stored

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
        # Those of a segment are stored end to end.
        forms = self._forms_of(event.kind)
        form, known = (array.dtype, array.shape[1:]), forms.get(name)
        if form == known and array.ndim:
            return
        what = f"{name} of the event {type(event).__name__} is {array.dtype} {array.shape}"
        if array.ndim == 0 or array.dtype.kind not in "biufU":
            raise InputTypeError(f"{what}; give an array of numbers, words or flags with one axis or more")
        if known is not None and (form[1] != known[1] or not form[0].kind == known[0].kind == "U"):
            raise InputTypeError(f"{what}, in events before {known[0]} {('n', *known[1])}; all must be of one form")
        forms[name] = form

    def _forms_of(self, kind: str) -> dict[str, tuple[Any, ...]]:
        """Return the forms of the arrays of a kind, those of the last event where all are on disk."""
        if kind not in self._forms:
            self._forms[kind] = {}
            if self._places.get(kind):
                for name, value in vars(self._at(self._places[kind][-1])).items():
                    if isinstance(value, np.ndarray):
                        self._forms[kind][name] = value.dtype, value.shape[1:]
        return self._forms[kind]


def _bytes_of(event: Event | None) -> int:
    """Return the bytes of the arrays of an event that is in memory."""
    if event is None:
        return 0
    return sum(value.nbytes for value in vars(event).values() if isinstance(value, np.ndarray))


class EventView(Sequence[E]):
    """Some events of a log, each read when it is asked for."""

    def __init__(self, log: EventLog, within: range | None = None, kinds: tuple[str, ...] | None = None):
        """Take those at some places, by default at all, and of some kinds, by default of all."""
        self._log, self._within, self._kinds = log, within, kinds

    def _places(self) -> Sequence[int]:
        within = range(len(self._log)) if self._within is None else self._within
        if self._kinds is None:
            return within
        parts = [self._log._places.get(kind, ()) for kind in self._kinds]
        places = parts[0] if len(parts) == 1 else list(heapq.merge(*parts))
        if self._within is None:
            return places
        if within.step == 1:
            return places[bisect.bisect_left(places, within.start) : bisect.bisect_left(places, within.stop)]
        kept = set(places)
        return [place for place in within if place in kept]

    @property
    def times(self) -> np.ndarray:
        """Their times, (n,) yr float64; none is read for them."""
        return self._log.times[np.asarray(self._places(), np.int64)]

    def of(self, *classes: type[F]) -> EventView[F]:
        """Return those of one kind or several."""
        kinds = tuple(cls.kind for cls in classes if self._kinds is None or cls.kind in self._kinds)
        return EventView(self._log, self._within, kinds)

    def __len__(self) -> int:
        return len(self._places())

    @overload
    def __getitem__(self, index: int) -> E: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[E]: ...

    def __getitem__(self, index: int | slice) -> E | Sequence[E]:
        if not isinstance(index, slice):
            return cast(E, self._log._at(self._places()[index]))
        if self._kinds is None:
            return EventView(self._log, cast(range, self._places())[index])
        return [cast(E, self._log._at(place)) for place in self._places()[index]]

    def __iter__(self) -> Iterator[E]:
        for place in self._places():
            yield cast(E, self._log._at(place))

    def __eq__(self, other: object) -> bool:
        """Tell whether another sequence holds equal events in the same order."""
        if not isinstance(other, Sequence) or len(other) != len(self):
            return False
        return all(one == two for one, two in zip(self, other, strict=True))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(list(self))


@overload
def events_of(events: Iterable[Event], cls: type[E], /) -> Iterable[E]: ...


@overload
def events_of(events: Iterable[Event], *classes: type[Event]) -> Iterable[Event]: ...


def events_of(events: Iterable[Event], *classes: type[Event]) -> Iterable[Event]:
    """Return the events of some kinds; of a log, or a part of one, no others are read."""
    if isinstance(events, (EventLog, EventView)):
        return events.of(*classes)
    return [event for event in events if isinstance(event, classes)]
