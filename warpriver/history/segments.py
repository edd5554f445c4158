"""Segments: records and events as NumPy archives, each listed with its checksum in an index beside them."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import os
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.channel_table import COLUMNS, ChannelTable
from warpriver.errors import InputError, PathError, WarpriverError
from warpriver.files import beside, sync_folder
from warpriver.history.events import Event, event_class, event_fields
from warpriver.history.record import Record, check_record

__all__ = [
    "INDEX",
    "DamageError",
    "Segment",
    "SegmentIndex",
    "checked_segment",
    "decode_event_index",
    "decode_events",
    "decode_events_of",
    "decode_records",
    "encode",
    "opened",
    "sealed",
    "segment_name",
    "unsealed",
    "write_archive",
]

INDEX = "segments.jsonl"
# How the names of the arrays of an archive begin.
NAMES = ("record/", "node/", "point/", "channel/", "column", "resume/", "event", "header")


class DamageError(InputError):
    """A file of a run is missing, cut or changed."""


class UnknownKindError(WarpriverError):
    """A segment holds events of a kind that this program has no class for."""


@dataclasses.dataclass(frozen=True)
class Segment:
    """What the index says of a segment.

    Attributes:
        name: Name of its file.
        bytes: Size of the file.
        crc32: Checksum of its bytes.
        steps: Steps done at its records.
        times: Times of its records, yr.
        first_event: Place of its first event among all events of the run; those from there on that earlier segments
            hold do not count: they lay after the record from which a run went on.
        events: Number of its events.
    """

    name: str
    bytes: int
    crc32: int
    steps: list[int]
    times: list[float]
    first_event: int
    events: int


def segment_name(number: int) -> str:
    """Return the name of a segment's file."""
    return f"segment_{number:06d}.npz"


# ---- text with a checksum


def sealed(values: Mapping[str, Any], indent: int | None = None) -> str:
    """Return values as JSON with a checksum in them."""
    return json.dumps({**values, "checksum": _checksum_of(values)}, indent=indent)


def unsealed(text: str | bytes) -> dict[str, Any]:
    """Return what :func:`sealed` was given, or raise ``ValueError`` where it is damaged."""
    try:
        values: dict[str, Any] = json.loads(text)
        crc = values.pop("checksum")
    except (ValueError, AttributeError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"it is cut or changed ({type(error).__name__}: {error})") from error
    if crc != _checksum_of(values):
        raise InputError("its checksum is not that of what it holds")
    return values


def _is_sealed(text: bytes) -> bool:
    try:
        unsealed(text)
    except InputError:
        return False
    return True


def _checksum_of(values: Mapping[str, Any]) -> int:
    return zlib.crc32(json.dumps(values, sort_keys=True).encode())


# ---- the index


class SegmentIndex:
    """The list of a run's segments, a line each in a file that only grows."""

    def __init__(self, path: Path):
        """Start a new index: an empty file."""
        self.path = path
        self.segments: list[Segment] = []
        self._length = 0
        self._open_line = False
        try:
            path.write_bytes(b"")
            sync_folder(path.parent)
        except OSError as error:
            raise PathError.of(error, f"cannot write {path}") from error

    @classmethod
    def load(cls, path: Path) -> SegmentIndex:
        """Read an index; a last line that was being written when the run was killed does not count.

        Raises:
            ValueError: A line is damaged.
        """
        self = cls.__new__(cls)
        self.path, self.segments = path, []
        try:
            data = path.read_bytes() if path.exists() else b""
        except OSError as error:
            raise PathError.of(error, f"cannot read {path}") from error
        *lines, last = data.split(b"\n")
        self._length = len(data) - len(last)
        # A whole line counts although its end is missing or another character: then it is the end that was damaged.
        whole = next((text for text in (last, last[:-1]) if _is_sealed(text)), b"")
        self._open_line = whole != b""
        if self._open_line:
            lines.append(whole)
            self._length += len(whole)
        for number, line in enumerate(lines):
            try:
                segment = Segment(**unsealed(line))
                self._check_next(segment)
            except (TypeError, ValueError) as error:
                raise InputError(f"{path}, line {number + 1}, is damaged: {error}") from error
            self.segments.append(segment)
        return self

    def _check_next(self, segment: Segment) -> None:
        """Raise ``ValueError`` unless a segment can follow those before it."""
        name, before = segment_name(len(self.segments)), self.segments[-1:]
        if segment.name != name:
            raise InputError(f"it names {segment.name} where {name} should stand")
        for order in (segment.steps, segment.times):
            if sorted(order) != order or len(segment.steps) != len(segment.times):
                raise InputError(f"its records are not in order: {order}")
        last = next((s.steps[-1] for s in reversed(self.segments) if s.steps), 0)
        if segment.steps and segment.steps[0] < last:
            raise InputError(f"its records begin at step {segment.steps[0]}, those before end at step {last}")
        if segment.first_event > sum(s.first_event + s.events for s in before):
            raise InputError(f"its first event is number {segment.first_event}; events before that are missing")

    def append(self, segment: Segment) -> None:
        """List a segment that is in its place, on the disk; after a failure the file is as it was."""
        line = f"{chr(10) * self._open_line}{sealed(dataclasses.asdict(segment))}\n".encode()
        try:
            with self.path.open("r+b") as file:
                file.truncate(self._length)
                file.seek(self._length)
                file.write(line)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            with contextlib.suppress(OSError):
                os.truncate(self.path, self._length)
            raise PathError.of(error, f"cannot write {self.path}") from error
        self._length += len(line)
        self._open_line = False
        self.segments.append(segment)


# ---- archives


def write_archive(target: Path, arrays: Mapping[str, Any]) -> tuple[int, int]:
    """Write arrays as one archive that appears whole or not at all; return its size and its checksum."""
    with beside(target) as temporary:
        with temporary.open("wb") as file:
            np.savez(file, **arrays)
        found = temporary.stat().st_size, _checksum(temporary)
    return found


def _checksum(path: Path) -> int:
    crc = 0
    with path.open("rb") as file:
        while block := file.read(2**16):
            crc = zlib.crc32(block, crc)
    return crc


def checked_segment(folder: Path, segment: Segment, *, bytes_too: bool) -> Path:
    """Return the file of a segment, or raise :class:`DamageError` where it is missing or is not what was written.

    Args:
        folder: Folder of the run.
        segment: The segment.
        bytes_too: Compare its bytes with the checksum, not only their number.
    """
    path = folder / segment.name
    advice = "put it back from a copy of the run, or open what comes before it with History.load(..., salvage=True)"
    if not path.is_file():
        raise DamageError(f"{path} is missing; {advice}")
    size = path.stat().st_size
    if size != segment.bytes:
        raise DamageError(f"{path} is damaged: it has {size} bytes in place of {segment.bytes}; {advice}")
    if bytes_too and _checksum(path) != segment.crc32:
        raise DamageError(f"{path} is damaged: its checksum is not the one in {INDEX}; {advice}")
    return path


@contextlib.contextmanager
def opened(path: Path) -> Any:
    """Open an archive, whose arrays are read when they are asked for; damage is an error that names the file."""
    try:
        archive = np.load(path, allow_pickle=False)
        if isinstance(archive, np.ndarray):
            raise InputError("it is a single array")
        with archive:
            yield archive
    except UnknownKindError as error:
        raise InputError(f"{path} {error}") from error
    except MemoryError:
        raise
    except Exception as error:  # whatever a reader of archives makes of damaged bytes
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DamageError(f"{path} is not a warpriver run or is damaged ({reason})") from error


# ---- records as arrays


def encode(records: Sequence[Record], events: Sequence[Event], first_event: int) -> dict[str, np.ndarray]:
    """Return records and events as named arrays; those of records and of a kind of events lie end to end."""
    arrays = {
        "record/step": np.array([r.step for r in records], np.int64),
        "record/time": np.array([r.time for r in records], np.float64),
        "record/events": np.array([r.events_before for r in records], np.int64),
        "record/points": np.array([len(r.point_xy) for r in records], np.int64),
        "record/channels": np.array([len(r.channels) for r in records], np.int64),
        "record/nodes": np.array([len(r.node_xy) for r in records], np.int64),
    }
    if records:
        arrays["point/xy"] = np.concatenate([r.point_xy for r in records])
        sections = [r.point_section for r in records if r.point_section is not None]
        if sections:
            arrays["point/section"] = np.concatenate(sections)
        arrays["channel/start"] = np.concatenate([r.channel_start for r in records])
        arrays["node/xy"] = np.concatenate([r.node_xy for r in records])
        names = list(records[0].channels)
        arrays["columns"] = np.array(names)
        arrays |= {f"column/{k}": np.concatenate([r.channels[n] for r in records]) for k, n in enumerate(names)}
        for name in records[0].resume:
            parts = [r.resume[name] for r in records]
            arrays[f"resume/{name}"] = np.concatenate(parts)
            arrays[f"resume/{name}/start"] = _offsets(map(len, parts))
    return arrays | _encode_events(events, first_event)


def decode_records(arrays: Any) -> list[Record]:
    """Return the records of an archive."""
    steps, times, events = (arrays[f"record/{name}"].tolist() for name in ("step", "time", "events"))
    if not steps:
        return []
    points, channels, nodes = (_offsets(arrays[f"record/{name}"]) for name in ("points", "channels", "nodes"))
    xy, node_xy = _split(arrays["point/xy"], points), _split(arrays["node/xy"], nodes)
    sections = _split(arrays["point/section"], points) if "point/section" in arrays else [None] * len(steps)
    starts = _split(arrays["channel/start"], _offsets(np.diff(channels) + 1))
    tables = _split_tables(arrays, channels)
    stray = [name for name in arrays if not name.startswith(NAMES)]
    if stray:
        raise InputError(f"it has an array {stray[0]!r}")
    # An array or its offsets alone is one of which a name was changed.
    keys = dict.fromkeys(name.removesuffix("/start") for name in arrays if name.startswith("resume/"))
    resume = {key.removeprefix("resume/"): _split(arrays[key], arrays[f"{key}/start"]) for key in keys}
    records = [
        Record(
            step=steps[k],
            time=times[k],
            events_before=events[k],
            point_xy=xy[k],
            point_section=sections[k],
            channel_start=starts[k],
            channels=tables[k],
            node_xy=node_xy[k],
            resume={name: values[k] for name, values in resume.items()},
        )
        for k in range(len(steps))
    ]
    for record in records:
        check_record(record)
    return records


def _split_tables(arrays: Any, start: np.ndarray) -> list[ChannelTable]:
    columns = {str(name): _split(arrays[f"column/{k}"], start) for k, name in enumerate(arrays["columns"])}
    tables = []
    for k in range(len(start) - 1):
        table = {name: values[k] for name, values in columns.items()}
        extra = {name: table.pop(name) for name in list(table) if name not in COLUMNS}
        tables.append(ChannelTable(**table, extra=extra))
    return tables


def _offsets(counts: Iterable[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(np.fromiter(counts, np.int64))])


def _split(values: np.ndarray, start: np.ndarray) -> list[np.ndarray]:
    if start[-1] != len(values):
        raise InputError(f"{len(values)} values for parts that end at {start[-1]}")
    if start[0] != 0 or (np.diff(start) < 0).any():
        raise InputError("parts of negative length")
    return [values[a:b] for a, b in itertools.pairwise(start.tolist())]


# ---- events as arrays


def _encode_events(events: Sequence[Event], first: int) -> dict[str, np.ndarray]:
    by_kind: dict[str, list[Event]] = {}
    for event in events:
        by_kind.setdefault(event.kind, []).append(event)
    number = {kind: k for k, kind in enumerate(by_kind)}
    classes = [type(of_kind[0]) for of_kind in by_kind.values()]
    arrays = {
        "event/first": np.array(first),
        "event/order": np.array([number[event.kind] for event in events], np.int32),
        "event/kinds": np.array(list(by_kind), str),
        "event/modules": np.array([cls.__module__ for cls in classes], str),
    }
    for kind, of_kind in by_kind.items():
        for name, of_type, optional in event_fields(type(of_kind[0])):
            key, values = f"event/{kind}/{name}", [getattr(event, name) for event in of_kind]
            if optional:
                arrays[f"{key}/known"] = np.array([value is not None for value in values], bool)
                values = [value for value in values if value is not None]
            if of_type is not np.ndarray:
                arrays[key] = np.array([of_type(value) for value in values], _DTYPES[of_type])
            elif values:
                arrays[key] = np.concatenate(values)
                arrays[f"{key}/start"] = _offsets(map(len, values))
    return arrays


_DTYPES: dict[type, type] = {float: np.float64, int: np.int64, bool: np.bool_, str: np.str_}


def decode_events(arrays: Any) -> tuple[int, list[Event]]:
    """Return the events of an archive, and the place of the first among all events of the run."""
    order, kinds = arrays["event/order"], arrays["event/kinds"].tolist()
    found = [
        iter(_decode_kind(arrays, kind, module, int((order == k).sum())))
        for k, (kind, module) in enumerate(zip(kinds, arrays["event/modules"].tolist(), strict=True))
    ]
    return int(arrays["event/first"]), [next(found[k]) for k in order.tolist()]


def decode_event_index(arrays: Any) -> tuple[list[str], list[float]]:
    """Return kinds and times of the events of an archive in order; nothing else of them is read."""
    order, kinds = arrays["event/order"], arrays["event/kinds"].tolist()
    times = np.empty(len(order))
    for k, (kind, module) in enumerate(zip(kinds, arrays["event/modules"].tolist(), strict=True)):
        _class_of(kind, module)
        times[order == k] = arrays[f"event/{kind}/time"]
    return [kinds[k] for k in order.tolist()], times.tolist()


def decode_events_of(arrays: Any, kind: str) -> list[Event]:
    """Return the events of one kind of an archive."""
    place = arrays["event/kinds"].tolist().index(kind)
    count = int((arrays["event/order"] == place).sum())
    return _decode_kind(arrays, kind, str(arrays["event/modules"][place]), count)


def _class_of(kind: str, module: str) -> type[Event]:
    cls = event_class(kind)
    if cls is None:
        raise UnknownKindError(f"holds events of the kind {kind!r}, which no class here has; import {module} first")
    return cls


def _decode_kind(arrays: Any, kind: str, module: str, count: int) -> list[Event]:
    cls = _class_of(kind, module)
    columns: dict[str, list[Any]] = {}
    defaults = {f.name: f.default for f in dataclasses.fields(cls) if f.default is not dataclasses.MISSING}
    for name, of_type, optional in event_fields(cls):
        key = f"event/{kind}/{name}"
        if optional and f"{key}/known" not in arrays:
            # Of a version whose events did not have the field yet.
            columns[name] = [None] * count
            continue
        if of_type is not np.ndarray and key not in arrays and name in defaults:
            columns[name] = [defaults[name]] * count
            continue
        values = iter(_decode_column(arrays, key, of_type))
        known = arrays[f"{key}/known"].tolist() if optional else [True] * count
        columns[name] = [next(values) if there else None for there in known]
    return [cls(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]


def _decode_column(arrays: Any, key: str, of_type: type) -> list[Any]:
    if of_type is not np.ndarray:
        values: list[Any] = arrays[key].tolist()
        return values
    # Copies: one that is kept does not hold those of all others.
    return [part.copy() for part in _split(arrays[key], arrays[f"{key}/start"])] if key in arrays else []
