"""History: what a run recorded, read while it goes on or after it was reopened.

On disk a run is a folder, see :mod:`warpriver.history.folder`, or one archive with all of that. A run that is
interrupted, killed, or out of disk space leaves everything recorded before readable.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import errno
import json
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, overload

import numpy as np

import warpriver.history as settings  # SEGMENT_BYTES and SEGMENT_SECONDS: a program may set them there at any time
from warpriver.crs import short_name
from warpriver.errors import InputError, InputTypeError, MissingFileError, MissingRecordError, warn
from warpriver.extras import need
from warpriver.history.changes import (
    AppliedEdit,
    ControlChange,
    ControlStroke,
    Ground,
    GroundChange,
    ParameterChange,
    ground_after,
    params_after,
)
from warpriver.history.datasets import dataset_of, write_zarr
from warpriver.history.events import Avulsion, Collision, Crevasse, Cutoff, Event, EventLog, Split
from warpriver.history.folder import HEADER, RunFolder, SegmentEvents
from warpriver.history.record import Record
from warpriver.history.segments import (
    DamageError,
    decode_events,
    decode_records,
    encode,
    opened,
    sealed,
    unsealed,
    write_archive,
)
from warpriver.history.tables import event_columns, features_of, geometry_of, summary_columns
from warpriver.network import RiverNetwork
from warpriver.params import SOLVER_PARAMS, MeanderParams, PathMeander
from warpriver.public import public
from warpriver.thumbnail import LAKE, SAND, WATER, card, lines_picture, png_of
from warpriver.validate import position, shown, whole

if TYPE_CHECKING:
    import geopandas
    import pandas
    import xarray

__all__ = ["History", "StopReason", "read_history"]

FORMAT = "warpriver-run-3"
# What the system says where a file finds no room: then a shorter one may.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# Events that stay in memory: edits, and what a run that goes on must know. There are as many as were made by hand.
EDITS = (AppliedEdit, ControlStroke)
LASTING = (*EDITS, ControlChange, GroundChange, ParameterChange)
# Earlier courses that a notebook shows at most.
THUMBNAIL_COURSES = 12


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
            StopReason.STORE_FAILED: "the records that could not be stored are still in memory: make room and run "
            "again, or save the history elsewhere",
        }[self]


class _Networks(Sequence[RiverNetwork]):
    """The recorded networks, each built when it is asked for."""

    def __init__(self, history: History):
        self._history = history

    def __len__(self) -> int:
        return len(self._history.times)

    @overload
    def __getitem__(self, index: int) -> RiverNetwork: ...

    @overload
    def __getitem__(self, index: slice) -> list[RiverNetwork]: ...

    def __getitem__(self, index: int | slice) -> RiverNetwork | list[RiverNetwork]:
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
        stored_count: Number of the records that are on disk there.
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
            raise InputTypeError(f"params is {shown(params)}; give MeanderParams or PathMeander")
        self.params = params
        self.seed = seed
        self.origin = position(origin)
        self.crs = crs
        self.dtype = dtype
        self.ground = ground
        self.stop_reason: StopReason | None = None
        self._times: list[float] = []
        self._steps: list[int] = []
        # A record in memory, or where to find it: (number of its segment, index in it).
        self._records: list[Record | tuple[int, int]] = []
        self._form: tuple[Any, ...] | None = None
        # None: still in the segments.
        self._events: EventLog | None = EventLog()
        self._events_stored = 0
        self._folder: RunFolder | None = None
        self._pending: list[int] = []
        self._pending_bytes = 0
        self._flushed = time.monotonic()
        # Events that segments or the journal hold.
        self._events_noted = 0
        self._journaling = True

    # ---- reading

    @property
    def path(self) -> Path | None:
        """Folder that the run is streamed to, or None."""
        return None if self._folder is None else self._folder.path

    @property
    def stored_count(self) -> int:
        """Number of the records that are on disk, the first ones."""
        return len(self._records) - len(self._pending) if self._folder is not None else 0

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
            assert self._folder is not None
            self._events = self._folder.events()
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
    def crevasses(self) -> Sequence[Crevasse]:
        """The events that are banks that broke."""
        return self.events.of(Crevasse)

    @property
    def avulsions(self) -> Sequence[Avulsion]:
        """The events that are channels that left their courses."""
        return self.events.of(Avulsion)

    @property
    def splits(self) -> Sequence[Split]:
        """The events that are splits of rings."""
        return self.events.of(Split)

    @property
    def edits(self) -> Sequence[AppliedEdit | ControlStroke]:
        """The events that are edits; each has the ``step`` after which it was done, and the ``edit``."""
        return cast("Sequence[AppliedEdit | ControlStroke]", self.events.of(*EDITS))

    def __len__(self) -> int:
        return len(self._records)

    def record(self, index: int) -> Record:
        """Return one record, from memory or from disk; a negative index counts from the end.

        Raises:
            IndexError: There is no such record, also a ``ValueError``.
            ValueError: The segment that holds it is missing or damaged.
        """
        if not self._records:
            where = "" if self.path is None else f" in {self.path}"
            raise MissingRecordError(
                f"the history{where} holds no record: its run was stopped before the first one; run it again"
            )
        index, count = whole(index, "index of a record", minimum=-(2**63)), len(self._records)
        if not -count <= index < count:
            raise MissingRecordError(f"there is no record {index}; the history has {count}, from 0 to {count - 1}")
        held = self._records[index]
        if isinstance(held, Record):
            return held
        assert self._folder is not None
        return self._folder.record(*held)

    @public
    def network(self, index: int) -> RiverNetwork:
        """Return the network of one record, on the CPU device."""
        return self.network_of(self.record(index))

    def network_of(self, record: Record) -> RiverNetwork:
        """Return the network of a record of this run, on the CPU device."""
        if record.point_xy.dtype != self.dtype:
            raise InputError(f"the record of step {record.step} is {record.point_xy.dtype}, its run {self.dtype}")
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

    # ---- as tables

    @public
    def to_geopandas(self, layer: str = "courses", *, every: int = 1) -> geopandas.GeoDataFrame:
        """Return a layer of the run as ``geopandas.GeoDataFrame`` (``warpriver[gis]``).

        ``time_yr`` is the time of the record or event in yr; ``begin`` and ``end`` are dates, for programs that show
        time by dates: year 0 of the run is 2000. Beyond the year 9999 they are empty.

        Args:
            layer: "courses": the line of each channel at each record. "oxbows": the loops that were cut off, as areas
                as wide as the channel. "abandoned": the courses that were given up where channels met, or left theirs.
            every: Take every so many records; the last one always.

        Raises:
            ImportError: geopandas is missing.
            ValueError: Another layer, an interval below 1, or a history without a record.
        """
        (module,) = need("History.to_geopandas", "geopandas")
        features = features_of(self, layer, every)
        return module.GeoDataFrame(dict(features.columns), geometry=geometry_of(features), crs=self.crs)

    @public
    def to_xarray(self, *, every: int = 1) -> xarray.Dataset:
        """Return the run as ``xarray.Dataset`` (``warpriver[gis]``), with the names and attributes of CF and UGRID.

        All records lie end to end along ``node``, ``edge`` and ``channel``; ``record_nodes`` and ``record_channels``
        say how many each has, ``node_record`` and ``edge_record`` to which one belongs. So do the courses that events
        left, along ``event_point``. Columns of channels that hold words are left out.

        Args:
            every: Take every so many records; the last one always.

        Raises:
            ImportError: xarray is missing.
            ValueError: An interval below 1, or a history without a record.
        """
        return dataset_of(self, every)

    @public
    def to_zarr(self, path: str | os.PathLike[str], *, every: int = 1) -> None:
        """Write the run as a Zarr store (``warpriver[zarr]``), which opens in xarray without warpriver.

        Args:
            path: Folder to make.
            every: Take every so many records; the last one always.

        Raises:
            ImportError: xarray or zarr is missing.
            FileExistsError: The folder holds something already.
            OSError: It cannot be written.
            ValueError: As :meth:`to_xarray`.
        """
        write_zarr(self, path, every)

    def event_table(self) -> pandas.DataFrame:
        """Return all events as ``pandas.DataFrame`` (``warpriver[gis]``), a row each, in order of time.

        Columns: ``time_yr``, ``kind``, ``length_m`` and ``x``, ``y`` (the mean point) of the line that an event left
        behind, then what its kind tells: ``channel_id``, ``width_m`` and so on; NaN or "" where a kind has no such.
        """
        (module,) = need("History.event_table", "pandas")
        return module.DataFrame(event_columns(self))

    def summary(self) -> pandas.DataFrame:
        """Return a row a record as ``pandas.DataFrame`` (``warpriver[gis]``).

        Columns: ``time_yr``, ``step``, the numbers of ``channels`` and ``points``, total ``length_m``, ``sinuosity``
        (length over the distance of the ends, of channels that are no rings), mean ``width_m``, and how many events of
        each kind there had been: ``cutoffs``, ``collisions`` ...
        """
        (module,) = need("History.summary", "pandas")
        return module.DataFrame(summary_columns(self))

    def __repr__(self) -> str:
        if not self._times:
            return "History(empty)"
        reason = self.stop_reason.value if self.stop_reason else "still running"
        where = f", stored in {self.path}" if self.path else ""
        counts = self.events.counts()
        always = {Cutoff.kind: 0, Collision.kind: 0}
        told = "".join(f"{count} {kind.replace('_', ' ')}s, " for kind, count in {**always, **counts}.items())
        return f"History({len(self)} records, {self._times[0]:.4g} to {self._times[-1]:.4g} yr, {told}{reason}{where})"

    def _repr_html_(self) -> str:
        if not self._times:
            return "<b>History</b>, empty"
        counts = {Cutoff.kind: 0, Collision.kind: 0} | self.events.counts()
        facts = {
            "records": f"{len(self)}, {self._times[0]:.4g} to {self._times[-1]:.4g} yr",
            **{f"{kind.replace('_', ' ')}s": f"{count:,}" for kind, count in counts.items()},
            "ended": self.stop_reason.value if self.stop_reason else "still running",
            "stored in": "memory" if self.path is None else str(self.path),
            "CRS": short_name(self.crs),
        }
        return card("History", facts, self._repr_png_() or b"")

    def _repr_png_(self) -> bytes | None:
        """Draw some of the earlier courses, the loops that were cut off, and the channels of the last record."""
        if not self._times:
            return None
        shown = np.unique(np.linspace(0, len(self) - 1, THUMBNAIL_COURSES).round().astype(int)).tolist()
        networks = [self.network(k) for k in shown]
        layers = [(n.polylines(close=True), n.channel_width.tolist(), SAND) for n in networks[:-1]]
        loops = [cutoff for cutoff in self.cutoffs if len(cutoff.xy) > 1]
        layers.append(([loop.xy for loop in loops], [loop.width for loop in loops], LAKE))
        layers.append((networks[-1].polylines(close=True), networks[-1].channel_width.tolist(), WATER))
        return png_of(lines_picture(layers))

    # ---- writing

    def append(self, record: Record) -> None:
        """Add a record; when the history is stored it goes to the journal at once, and later to a segment.

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
        if self._folder is None:
            return
        self._pending.append(len(self._records) - 1)
        self._pending_bytes += record.nbytes
        late = time.monotonic() - self._flushed >= settings.SEGMENT_SECONDS
        if late or self._pending_bytes + self._event_bytes() >= settings.SEGMENT_BYTES:
            self.flush()
        else:
            self._note_down([record])

    def _note_down(self, records: list[Record]) -> None:
        """Write pending records to the journal, and the events since.

        Where that fails they wait for their segment, which tells of it; no entry follows, so that none is missing.
        """
        assert self._folder is not None
        if not self._journaling:
            return
        first = max(self._events_noted, self._events_stored)
        events: Sequence[Event] = [] if self._events is None else self._events[first:]
        try:
            with self._folder.writing():
                self._folder.journal.append(len(self._folder.segments), records, events, first)
        except OSError:
            self._journaling = False
            return
        self._events_noted = first + len(events)

    def relieve(self) -> None:
        """Store what is pending if it takes up much memory; events may do so that no record follows for long.

        Raises:
            OSError: As :meth:`flush`.
        """
        if self._folder is not None and self._pending_bytes + self._event_bytes() >= settings.SEGMENT_BYTES:
            self.flush()

    def _event_bytes(self) -> int:
        return 0 if self._events is None else self._events.held_bytes

    def _note(self, held: Record | tuple[int, int], step: int, at: float) -> None:
        self._records.append(held)
        self._steps.append(step)
        self._times.append(at)

    def rewind(self) -> None:
        """Forget the events after the last record: a run that goes on from there meets them again."""
        self.forget_events(self.record(-1).events_before if self._records else 0)

    def share_events(self, history: History) -> None:
        """Take the events of another history for its own."""
        self._events = history.events

    def forget_events(self, count: int) -> None:
        """Keep the first ``count`` events only."""
        self.events.truncate(count)
        self._events_stored = min(self._events_stored, count)
        self._events_noted = min(self._events_noted, count)

    def store_in(self, path: str | os.PathLike[str]) -> None:
        """Stream what is and will be recorded into a folder.

        Args:
            path: A folder to make, or the one that this history was loaded from, which then grows.

        Raises:
            FileExistsError: The folder holds something else.
            OSError: It cannot be written; the history stays stored where it was.
        """
        path = Path(path)
        if self.path is not None and path.resolve() == self.path.resolve():
            return
        if self._folder is not None:
            copy = self._copied_to(path)
            for name in (*_STORAGE, "_records", "_events"):
                setattr(self, name, getattr(copy, name))
            return
        before = self._pending, self._events_stored
        try:
            with RunFolder.create(path, self._header()) as self._folder:
                self._pending, self._events_stored = list(range(len(self._records))), 0
                self.flush()
        except BaseException:
            if self._folder is None or not self._folder.segments:
                self._folder, (self._pending, self._events_stored) = None, before
            raise

    def _copied_to(self, path: Path) -> History:
        """Return a copy that is stored in a new folder; record by record, so that memory does not grow with the run."""
        told: dict[str, Any] = {
            "seed": self.seed,
            "origin": self.origin,
            "crs": self.crs,
            "dtype": self.dtype,
            "ground": self.ground,
        }
        copy = History(self.params, **told)
        copy.stop_reason = self.stop_reason
        with RunFolder.create(path, self._header(), keep=False) as copy._folder:
            for k in range(len(self)):
                record = self.record(k)
                copy.events.extend(self.events[len(copy.events) : record.events_before])
                copy.append(record)
            copy.events.extend(self.events[len(copy.events) :])
            copy.flush()
        return copy

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Keep other processes from writing to the folder of this history; nothing to do for one in memory.

        Raises:
            BlockingIOError: Another process or simulation writes there.
            ValueError: The run has grown since it was opened here.
            OSError: The folder cannot be written.
        """
        with contextlib.nullcontext() if self._folder is None else self._folder.writing():
            yield

    def flush(self) -> None:
        """Store the pending records and events; nothing to do for a history in memory.

        On a disk without room for all of them the first ones are stored, as many as there is room for.

        Raises:
            OSError: Some cannot be stored; they stay in memory, and what was stored before stays readable. Where the
                folder is gone, so are the records that were in it, and the history is one in memory from then on.
            ValueError: The run has grown since it was opened here.
        """
        if self._folder is None:
            return
        self._flushed = time.monotonic()
        count = len(self._pending)
        # Without events in memory none has happened since they were stored.
        while self._pending or (self._events is not None and len(self._events) > self._events_stored):
            try:
                with self._folder.writing():
                    self._store(count)
                count = len(self._pending)
            except OSError as error:
                if not self._folder.path.is_dir():
                    self._lose_folder()
                    raise
                if error.errno not in NO_ROOM:
                    raise
                if self._folder.journal.path.exists():
                    # It takes up room itself.
                    self._folder.journal.clear()
                    continue
                if count <= 1:
                    raise
                count //= 2

    def _store(self, count: int) -> None:
        """Store the first of the pending records, and the events up to the last of them, or all with all of them."""
        assert self._folder is not None
        first, part = self._events_stored, self._pending[:count]
        records = [self.record(k) for k in part]
        end = records[-1].events_before if count < len(self._pending) else None
        events: Sequence[Event] = [] if self._events is None else self._events[first:end]
        number = self._folder.append(records, events, first)
        for row, k in enumerate(part):
            self._records[k] = (number, row)
        del self._pending[:count]
        self._pending_bytes = 0 if not self._pending else self._pending_bytes - sum(r.nbytes for r in records)
        if self._events is not None and len(events):
            self._events.settle(first, len(events), SegmentEvents(self._folder, number), LASTING)
        self._events_stored += len(events)
        self._folder.journal.clear()
        self._events_noted = self._events_stored
        self._journaling = not self._pending

    def _lose_folder(self) -> None:
        """Go on in memory, with what was not in the folder alone."""
        kept = [k for k, held in enumerate(self._records) if isinstance(held, Record)]
        warn(
            f"the folder {self.path} is gone, and with it {len(self._records) - len(kept)} of {len(self._records)} "
            "records; the others are in memory"
        )
        for name in ("_records", "_steps", "_times"):
            setattr(self, name, [getattr(self, name)[k] for k in kept])
        self._folder, self._pending, self._pending_bytes = None, [], 0
        self._events_stored = self._events_noted = 0
        self._events, places = EventLog().in_memory() if self._events is None else self._events.in_memory()
        # Events are counted anew.
        for k, held in enumerate(self._records):
            assert isinstance(held, Record)
            before = int(np.searchsorted(places, held.events_before))
            self._records[k] = dataclasses.replace(held, events_before=before)

    def close(self, reason: StopReason) -> None:
        """Note why the run ended and store what is pending.

        Raises:
            OSError: As :meth:`flush`.
        """
        self.stop_reason = reason
        self.flush()
        if self._folder is not None:
            with self._folder.writing():
                self._folder.write_header(self._header())

    @public
    def save(self, path: str | os.PathLike[str]) -> None:
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
        self._copied_to(target)

    # ---- reopening

    @classmethod
    @public
    def load(cls, path: str | os.PathLike[str], *, salvage: bool = False) -> History:
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

    def _salvage(self, path: Path) -> None:
        """Take what can be read of a folder into memory."""
        count = 0
        try:
            for segment in RunFolder.salvage(path):
                self._take(*segment)
                count += 1
        except DamageError as error:
            warn(f"{path}: {count} segments were read; then: {error}")

    def _open(self, path: Path) -> None:
        """Go on with what the index of a folder lists."""
        self._folder, self._events = RunFolder.open(path), None
        for number, segment in enumerate(self._folder.segments):
            for row, (step, at) in enumerate(zip(segment.steps, segment.times, strict=True)):
                self._note((number, row), step, at)
            self._events_stored = segment.first_event + segment.events
        self._events_noted = self._events_stored
        # What a run that was killed had recorded since.
        for records, first, events in self._folder.journal.entries(len(self._folder.segments)):
            if len(events) or first < self._events_stored:
                self.forget_events(first)
                self.events.extend(events)
            self._events_noted = first + len(events)
            for record in records:
                self._note(record, record.step, record.time)
                self._pending.append(len(self._records) - 1)
                self._pending_bytes += record.nbytes

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
        except (LookupError, TypeError, ValueError, ArithmeticError) as error:
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


@public
def read_history(path: str | os.PathLike[str], *, salvage: bool = False) -> History:
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
_STORAGE = ("_folder", "_events_stored", "_events_noted", "_journaling", "_pending", "_pending_bytes", "_flushed")


def _format_of(text: str | bytes) -> str | None:
    """Return the format that a header states, None where it cannot be read."""
    try:
        return str(json.loads(text)["format"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
