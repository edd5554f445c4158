"""History: what a run recorded, read while it goes on or after it was reopened.

On disk a run is a folder: ``run.json`` with its constants, numbered segments of records and events, and their index
with a checksum for each. Or it is one archive with all of that. A run that is interrupted, killed, or out of disk space
leaves everything recorded before readable.
"""

from __future__ import annotations

import dataclasses
import enum
import itertools
import json
import os
import shutil
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import warpriver.history as settings  # SEGMENT_BYTES and SEGMENT_SECONDS: a program may set them there at any time
from warpriver.errors import InputError, InputTypeError, MissingFileError, OutputExistsError, PathError
from warpriver.history.changes import Ground, ground_after, params_after
from warpriver.history.events import Collision, Cutoff, Event, EventLog, Split
from warpriver.history.record import Record
from warpriver.history.segments import (
    INDEX,
    DamageError,
    Segment,
    SegmentIndex,
    checked_segment,
    decode_events,
    decode_records,
    encode,
    opened,
    sealed,
    segment_name,
    unsealed,
    write_archive,
)
from warpriver.network import RiverNetwork
from warpriver.params import SOLVER_PARAMS, MeanderParams, PathMeander

__all__ = ["History", "StopReason", "read_history"]

FORMAT = "warpriver-run-3"
HEADER = "run.json"


class StopReason(enum.Enum):
    """Why a run ended; ``advice`` says what to do next."""

    COMPLETED = "completed"
    INTERRUPTED = "interrupted"
    CALLBACK = "stopped by a callback"
    NOT_FINITE = "a point is no longer finite"
    CHECK_FAILED = "a phase check failed"
    STORE_FAILED = "the run could not be written"

    @property
    def advice(self) -> str:
        """What to do about it, in one sentence."""
        return {
            StopReason.COMPLETED: "nothing to do; call run again to go on",
            StopReason.INTERRUPTED: "the run stands at a step boundary; call run again, or resume from what was stored",
            StopReason.CALLBACK: "call run again to go on",
            StopReason.NOT_FINITE: "the state before the failing step is kept; look for extreme widths or rates there, "
            "and report it if there are none",
            StopReason.CHECK_FAILED: "the state after the failing phase is kept; report it with the input",
            StopReason.STORE_FAILED: "make room or choose another folder, then save the history, of which the part "
            "that was not stored yet is still in memory, and run again",
        }[self]


class _Networks(Sequence):
    """The recorded networks, each built when it is asked for."""

    def __init__(self, history: History):
        self._history = history

    def __len__(self) -> int:
        return len(self._history.times)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        return self._history.network(index)


class History:
    """What a run recorded, in order of time; read it while the run goes on or after reopening it.

    Attributes:
        params: The constants that the run began with; ``last_params`` are those at its end.
        ground: The terrain that it began on, None for a plain; ``last_ground`` is that at its end.
        seed: Seed of random numbers.
        origin: (2,) absolute position of the recorded points' zero, m.
        crs: Coordinate reference system or None.
        dtype: Precision of the run.
        stop_reason: Why the last run ended, or None while it has not.
        path: Folder that the run is streamed to, or None.
    """

    def __init__(
        self,
        params: MeanderParams | PathMeander,
        *,
        seed: int = 0,
        origin: Sequence[float] | np.ndarray = (0.0, 0.0),
        crs: str | None = None,
        dtype: str = "float64",
        ground: Ground | None = None,
    ):
        """Start an empty history; :meth:`load` reads a stored one.

        Args:
            params: Constants of the run.
            seed: Seed of random numbers.
            origin: Absolute position of the recorded points' zero, m.
            crs: Coordinate reference system.
            dtype: Precision of the run.
            ground: The terrain that it begins on.

        Raises:
            TypeError: ``params`` are no constants of a run, but perhaps the path of one.
        """
        if isinstance(params, (str, os.PathLike)):
            raise InputTypeError(f"History({str(params)!r}) would be empty; read a stored run with read_history(...)")
        if not isinstance(params, tuple(SOLVER_PARAMS.values())):
            raise InputTypeError(f"params is {params!r}; give MeanderParams or PathMeander")
        self.params = params
        self.seed = seed
        self.origin = np.array(origin, np.float64)
        self.crs = crs
        self.dtype = dtype
        self.ground = ground
        self.stop_reason: StopReason | None = None
        self.path: Path | None = None
        self._times: list[float] = []
        self._steps: list[int] = []
        # A record in memory, or where to find it: (number of its segment, index in it).
        self._records: list[Record | tuple[int, int]] = []
        self._form: tuple[Any, ...] | None = None
        # None: still in the segments.
        self._events: EventLog | None = EventLog()
        self._events_stored = 0
        self._index: SegmentIndex | None = None
        self._pending: list[int] = []
        self._pending_bytes = 0
        self._flushed = time.monotonic()
        self._cache: tuple[int, list[Record]] | None = None

    # ---- reading

    @property
    def times(self) -> np.ndarray:
        """Times of the records in yr, (K,) float64."""
        return np.array(self._times)

    @property
    def steps(self) -> np.ndarray:
        """Steps done at the records, (K,) int64."""
        return np.array(self._steps, np.int64)

    @property
    def networks(self) -> Sequence[RiverNetwork]:
        """The recorded networks, a sequence of K; each is built when asked for."""
        return _Networks(self)

    @property
    def events(self) -> EventLog:
        """Everything that happened, in order: :class:`Cutoff`, :class:`Collision`, :class:`Split` and further kinds."""
        if self._events is None:
            self._events = EventLog(self._stored_events())
        return self._events

    @property
    def last_params(self) -> MeanderParams | PathMeander:
        """The constants after all changes so far."""
        return params_after(self.params, self.events)

    @property
    def last_ground(self) -> Ground | None:
        """The ground after all changes so far, None for a plain."""
        return ground_after(self.ground, self.events)

    @property
    def cutoffs(self) -> Sequence[Cutoff]:
        """The events that are cutoffs."""
        return self.events.of(Cutoff)

    @property
    def collisions(self) -> Sequence[Collision]:
        """The events that are collisions."""
        return self.events.of(Collision)

    @property
    def splits(self) -> Sequence[Split]:
        """The events that are splits of rings."""
        return self.events.of(Split)

    def __len__(self) -> int:
        return len(self._records)

    def record(self, index: int) -> Record:
        """Return one record, from memory or from disk.

        Raises:
            ValueError: The segment that holds it is missing or damaged.
        """
        held = self._records[index]
        if isinstance(held, Record):
            return held
        number, row = held
        if self._cache is None or self._cache[0] != number:
            assert self.path is not None and self._index is not None
            with opened(checked_segment(self.path, self._index.segments[number], bytes_too=True)) as archive:
                self._cache = (number, decode_records(archive))
        return self._cache[1][row]

    def network(self, index: int) -> RiverNetwork:
        """Return the network of one record, on the CPU device."""
        return self.network_of(self.record(index))

    def network_of(self, record: Record) -> RiverNetwork:
        """Return the network of a record of this run, on the CPU device."""
        return RiverNetwork(
            record.point_xy,
            record.channel_start,
            record.channels,
            node_xy=record.node_xy,
            point_section=record.point_section,
            origin=self.origin,
            crs=self.crs,
            dtype=self.dtype,
        )

    def __repr__(self) -> str:
        if not self._times:
            return "History(empty)"
        reason = self.stop_reason.value if self.stop_reason else "still running"
        where = f", stored in {self.path}" if self.path else ""
        counts = self.events.counts()
        always = {Cutoff.kind: 0, Collision.kind: 0}
        told = "".join(f"{count} {kind.replace('_', ' ')}s, " for kind, count in {**always, **counts}.items())
        return f"History({len(self)} records, {self._times[0]:.4g} to {self._times[-1]:.4g} yr, {told}{reason}{where})"

    # ---- writing

    def append(self, record: Record) -> None:
        """Add a record; it goes to disk with its segment when the history is stored.

        Raises:
            ValueError: It has other columns, or other arrays, than the records before.
        """
        form = record.form
        if self._records and self._form is None:
            self._form = self.record(-1).form
        if self._form is not None and form != self._form:
            raise InputError(f"a record holds {form}, those before {self._form}; all records of a run have one form")
        self._form = form
        self._note(record, record.step, record.time)
        if self.path is None:
            return
        self._pending.append(len(self._records) - 1)
        self._pending_bytes += record.nbytes
        late = time.monotonic() - self._flushed >= settings.SEGMENT_SECONDS
        if late or self._pending_bytes >= settings.SEGMENT_BYTES:
            self.flush()

    def _note(self, held: Record | tuple[int, int], step: int, at: float) -> None:
        self._records.append(held)
        self._steps.append(step)
        self._times.append(at)

    def rewind(self) -> None:
        """Forget the events after the last record: a run that goes on from there meets them again."""
        count = self.record(-1).events_before if self._records else 0
        self.events.truncate(count)
        self._events_stored = min(self._events_stored, count)

    def store_in(self, path: str | os.PathLike) -> None:
        """Stream what is and will be recorded into a folder.

        Args:
            path: A folder to make, or the one that this history was loaded from, which then grows.

        Raises:
            FileExistsError: The folder holds something else.
            OSError: It cannot be written.
        """
        folder = Path(path)
        if self.path is not None and folder.resolve() == self.path.resolve():
            return
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise OutputExistsError(f"{folder} exists and is not empty; name another folder, or resume the run in it")
        folder.mkdir(parents=True, exist_ok=True)
        if self.path is not None:  # stored elsewhere so far: bring the records along
            self._records, self._events = [self.record(k) for k in range(len(self._records))], self.events
        self._pending = list(range(len(self._records)))
        self._events_stored = 0
        self.path = folder
        self._index = SegmentIndex(folder / INDEX)
        self._write_header()
        self.flush()

    def flush(self) -> None:
        """Write the pending records and events as one segment; nothing to do for a history in memory.

        Raises:
            OSError: They cannot be written; they stay in memory, and what was written before stays readable.
        """
        if self.path is None or self._index is None:
            return
        self._flushed = time.monotonic()
        first = self._events_stored
        # Without events in memory none has happened since they were stored.
        events = [] if self._events is None else self._events[first:]
        if not (self._pending or events):
            return
        number = len(self._index.segments)
        records = [self.record(k) for k in self._pending]
        size, crc32 = write_archive(self.path / segment_name(number), encode(records, events, first))
        steps, times = [r.step for r in records], [r.time for r in records]
        self._index.append(Segment(segment_name(number), size, crc32, steps, times, first, len(events)))
        for row, k in enumerate(self._pending):
            self._records[k] = (number, row)
        self._pending, self._pending_bytes = [], 0
        self._events_stored += len(events)

    def close(self, reason: StopReason) -> None:
        """Note why the run ended and write what is pending."""
        self.stop_reason = reason
        self.flush()
        if self.path is not None:
            self._write_header()

    def save(self, path: str | os.PathLike) -> None:
        """Write everything to one ``.npz`` file, or to a new folder for any other name.

        Raises:
            FileExistsError: The folder holds something already (a file is replaced).
            OSError: It cannot be written; nothing half-written is left.
        """
        target = Path(path)
        if target.suffix == ".npz":
            records = [self.record(k) for k in range(len(self))]
            write_archive(target, {**encode(records, self.events, 0), "header": np.array(self._header())})
            return
        told = {"seed": self.seed, "origin": self.origin, "crs": self.crs, "dtype": self.dtype, "ground": self.ground}
        copy = History(self.params, **told)
        copy.events.extend(self.events)
        copy.stop_reason = self.stop_reason
        made = not target.exists()
        try:
            copy.store_in(target)
            for k in range(len(self)):
                copy.append(self.record(k))
            copy.flush()
        except OSError as error:
            if made and not isinstance(error, FileExistsError):
                shutil.rmtree(target, ignore_errors=True)
            raise

    # ---- reopening

    @classmethod
    def load(cls, path: str | os.PathLike, *, salvage: bool = False) -> History:
        """Reopen a run that was saved or streamed; records and events of a folder are read when asked for.

        Args:
            path: The file or the folder.
            salvage: Of a folder, read the segments one after the other, up to the first that is missing or damaged,
                into memory: what can be saved of a damaged run. The history is then stored nowhere; ``save`` it.

        Raises:
            FileNotFoundError: Nothing is there.
            ValueError: It is not a run, or one of another version; or a part of it is missing or damaged.
        """
        source = Path(path)
        if not source.exists():
            raise MissingFileError(f"no run at {source}")
        if source.is_file():
            with opened(source) as archive:
                header = str(archive["header"]) if "header" in archive else None
                if header is None:
                    raise InputError("it has no header")
                history = cls._from_header(header, source)
                history._take(decode_records(archive), *decode_events(archive))
            return history
        header_file = source / HEADER
        if not header_file.is_file():
            raise InputError(f"{source} is not a run: it has no {HEADER}")
        history = cls._from_header(header_file.read_bytes(), header_file)
        if salvage:
            history._salvage(source)
        else:
            history._open(source)
        return history

    def _take(self, records: list[Record], first: int, events: list[Event]) -> None:
        """Take the records and events of a segment into memory."""
        self.events.truncate(first)
        self.events.extend(events)
        for record in records:
            self.append(record)

    def _salvage(self, folder: Path) -> None:
        """Take what can be read of a folder into memory."""
        for number in itertools.count():
            path = folder / segment_name(number)
            try:
                with opened(path) as archive:
                    parts = decode_records(archive), *decode_events(archive)
            except DamageError as error:
                warnings.warn(f"{folder}: {number} segments were read; then: {error}", UserWarning, stacklevel=3)
                return
            self._take(*parts)

    def _open(self, folder: Path) -> None:
        """Go on with what the index of a folder lists."""
        self.path, self._index, self._events = folder, SegmentIndex.load(folder / INDEX), None
        for number, segment in enumerate(self._index.segments):
            checked_segment(folder, segment, bytes_too=False)
            for row, (step, at) in enumerate(zip(segment.steps, segment.times, strict=True)):
                self._note((number, row), step, at)
            self._events_stored = segment.first_event + segment.events
        # The one that was being written when a run was killed may be there already; further ones were listed once.
        lost = folder / segment_name(len(self._index.segments) + 1)
        if lost.exists():
            raise InputError(
                f"{folder / INDEX} lists {len(self._index.segments)} segments, but {lost.name} is there as well; put "
                "it back from a copy of the run, or open what can be read with History.load(..., salvage=True)"
            )

    def _stored_events(self) -> list[Event]:
        """Read the events of all segments."""
        assert self.path is not None and self._index is not None
        found: list[Event] = []
        for segment in self._index.segments:
            if segment.events == 0:
                del found[segment.first_event :]
                continue
            with opened(checked_segment(self.path, segment, bytes_too=True)) as archive:
                first, events = decode_events(archive)
            found[first:] = events
        return found

    def _header(self) -> str:
        values = {
            "format": FORMAT,
            "solver": next(name for name, kind in SOLVER_PARAMS.items() if isinstance(self.params, kind)),
            "params": dataclasses.asdict(self.params),
            "seed": int(self.seed),
            "origin": self.origin.tolist(),
            "crs": self.crs,
            "dtype": self.dtype,
            "ground": self.ground.as_json() if self.ground else None,
            "stop_reason": self.stop_reason.name if self.stop_reason else None,
        }
        return sealed(values, indent=2)

    def _write_header(self) -> None:
        assert self.path is not None
        temporary = self.path / (HEADER + ".tmp")
        try:
            temporary.write_text(self._header())
            os.replace(temporary, self.path / HEADER)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise PathError(error.errno, f"cannot write {self.path / HEADER}: {error.strerror or error}") from error

    @classmethod
    def _from_header(cls, text: str | bytes, source: Path) -> History:
        kind = _format_of(text)
        if kind is not None and kind != FORMAT:
            raise InputError(
                f"{source} is a run of the format {kind!r}; this version reads {FORMAT!r} only. Open it with the "
                "version that wrote it, or run it again"
            )
        try:
            values = unsealed(text)
            history = cls(
                SOLVER_PARAMS[values["solver"]](**values["params"]),
                seed=values["seed"],
                origin=values["origin"],
                crs=values["crs"],
                dtype=values["dtype"],
                ground=Ground(**values["ground"]) if values["ground"] else None,
            )
            if values["stop_reason"] is not None:
                history.stop_reason = StopReason[values["stop_reason"]]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{source} is not a warpriver run or is damaged: {error}") from error
        return history

    # ---- copies

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and copy with all records and events in memory; the copy is stored nowhere."""
        state = {name: value for name, value in vars(self).items() if name not in _STORAGE}
        state["_records"] = [self.record(k) for k in range(len(self))]
        state["_events"] = list(self.events)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(vars(History(state["params"])))
        vars(self).update(state)
        self._events = EventLog(state["_events"])


def read_history(path: str | os.PathLike, *, salvage: bool = False) -> History:
    """Read a run that was stored; its records and events are loaded when they are used.

    Args:
        path: Folder of the run, or the file that ``History.save`` wrote.
        salvage: Read what can be read of a damaged folder, into memory.

    Raises:
        FileNotFoundError: Nothing is there.
        ValueError: It is not a run, or one of another version; or a part of it is missing or damaged.
    """
    return History.load(path, salvage=salvage)


# What belongs to the folder of a history.
_STORAGE = ("path", "_index", "_events_stored", "_pending", "_pending_bytes", "_flushed", "_cache")


def _format_of(text: str | bytes) -> str | None:
    """Return the format that a header states, None where it cannot be read."""
    try:
        return str(json.loads(text)["format"])
    except (UnicodeDecodeError, json.JSONDecodeError, KeyError, TypeError):
        return None
