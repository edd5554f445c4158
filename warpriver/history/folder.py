"""RunFolder: a run on disk, ``run.json`` with its constants, numbered segments of records and events, and their index.

Records since the last segment are in a journal. A segment is brought to the disk under another name, renamed, and only
then noted by a line of its own at the end of the index: what the index lists is there and whole, whenever a run is
killed or runs out of disk space.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from warpriver.errors import InputError, OutputExistsError, PathError
from warpriver.files import STAGING, beside, sync_folder
from warpriver.history.events import Event, EventLog
from warpriver.history.journal import JOURNAL, Journal
from warpriver.history.lock import LOCK, FolderLock
from warpriver.history.record import Record
from warpriver.history.segments import (
    INDEX,
    DamageError,
    Segment,
    SegmentIndex,
    checked_segment,
    decode_event_index,
    decode_events,
    decode_events_of,
    decode_records,
    encode,
    opened,
    segment_name,
    write_archive,
)

__all__ = ["HEADER", "RunFolder", "SegmentEvents"]

HEADER = "run.json"


class RunFolder:
    """A run on disk; one process writes to it at a time.

    Attributes:
        path: The folder.
        segments: Its segments, in order.
        journal: What was recorded since the last of them.
    """

    def __init__(self, path: Path, index: SegmentIndex):
        """Take a folder with its index; see :meth:`create` and :meth:`open`."""
        self.path = path
        self._index = index
        self.journal = Journal(path)
        self._lock = FolderLock(path)
        self._cache: tuple[int, list[Record]] | None = None
        self._events: tuple[int, dict[str, list[Event]]] | None = None

    @property
    def segments(self) -> Sequence[Segment]:
        """The segments that count, in order."""
        return self._index.segments

    # ---- making and opening

    @classmethod
    @contextlib.contextmanager
    def create(cls, path: Path, header: str, *, keep: bool = True) -> Iterator[RunFolder]:
        """Make a folder with a header and no segment, and hold its lock; if the block fails, nothing is left of it.

        Args:
            path: The folder.
            header: Text of the header.
            keep: If the block fails after it has stored a segment, leave what is stored.

        Yields:
            The folder, locked.

        Raises:
            FileExistsError: The folder holds something already.
            OSError: It cannot be written.
        """
        made = [folder for folder in (path, *path.parents) if not folder.exists()]
        self = None
        try:
            try:
                path.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise PathError.of(error, f"cannot make the folder {path}") from error
            with FolderLock(path) as lock:
                if any(entry.name != LOCK for entry in path.iterdir()):
                    made = []
                    raise OutputExistsError(
                        f"{path} exists and is not empty; name another folder, or resume the run in it"
                    )
                self = cls(path, SegmentIndex(path / INDEX))
                self._lock = lock
                self.write_header(header)
                sync_folder(path.parent)
                yield self
        except BaseException:
            if self is None or not (keep and self.segments):
                names = [] if self is None else [HEADER, INDEX, JOURNAL, *(segment.name for segment in self.segments)]
                with contextlib.suppress(OSError):  # not if somebody else has written there
                    for name in names:
                        (path / name).unlink(missing_ok=True)
                    for folder in made:
                        folder.rmdir()
            raise

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """Open a folder: its segments are there, in order and of the size that the index lists; none is read.

        Raises:
            ValueError: Something is missing or damaged.
        """
        self = cls(path, SegmentIndex.load(path / INDEX))
        for segment in self.segments:
            checked_segment(path, segment, bytes_too=False)
        # The one that was being written when a run was killed may be there already; further ones were listed once.
        lost = path / segment_name(len(self.segments) + 1)
        if lost.exists():
            raise InputError(
                f"{path / INDEX} lists {len(self.segments)} segments, but {lost.name} is there as well; put it back "
                "from a copy of the run, or open what can be read with History.load(..., salvage=True)"
            )
        return self

    # ---- writing

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the lock of the folder.

        Raises:
            RunLockedError: Another process or simulation holds it.
            ValueError: The run has grown since it was opened here.
            OSError: The lock cannot be made.
        """
        outermost = not self._lock.held
        with self._lock:
            if outermost:
                if SegmentIndex.load(self.path / INDEX).segments != self.segments:
                    raise InputError(
                        f"{self.path} was continued elsewhere since it was opened here; resume it again from there"
                    )
                for left in self.path.glob(f"{STAGING}*"):  # by a killed process
                    shutil.rmtree(left, ignore_errors=True)
            yield

    def write_header(self, text: str) -> None:
        """Replace the header."""
        with beside(self.path / HEADER) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def append(self, records: Sequence[Record], events: Sequence[Event], first_event: int) -> int:
        """Store records and events as one segment and return its number.

        Raises:
            OSError: There is no room, or the folder is gone; what was there before stays as it was.
        """
        number = len(self.segments)
        name = segment_name(number)
        size, crc32 = write_archive(self.path / name, encode(records, events, first_event))
        steps, times = [r.step for r in records], [r.time for r in records]
        self._index.append(Segment(name, size, crc32, steps, times, first_event, len(events)))
        return number

    # ---- reading

    def record(self, number: int, row: int) -> Record:
        """Return one record of a segment, which is kept for the next call.

        Raises:
            ValueError: The segment is missing or damaged.
        """
        if self._cache is None or self._cache[0] != number:
            segment = self.segments[number]
            path = checked_segment(self.path, segment, bytes_too=True)
            with opened(path) as archive:
                records = decode_records(archive)
                if [r.step for r in records] != segment.steps or [r.time for r in records] != segment.times:
                    raise InputError(f"its records are not those that {INDEX} lists")
            self._cache = (number, records)
        return self._cache[1][row]

    def events(self) -> EventLog:
        """Return the events of all segments, which are read when asked for.

        Those that a resumed run had not met yet do not count.

        Raises:
            ValueError: A segment is missing or damaged, or holds events of a kind that no class here has.
        """
        log = EventLog()
        for number, segment in enumerate(self.segments):
            kinds: list[str] = []
            times: list[float] = []
            if segment.events:
                with opened(checked_segment(self.path, segment, bytes_too=False)) as archive:
                    kinds, times = decode_event_index(archive)
                    if len(kinds) != segment.events:
                        raise InputError(f"it holds {len(kinds)} events, and {INDEX} lists {segment.events}")
            log.take_stored(segment.first_event, kinds, times, SegmentEvents(self, number))
        return log

    def events_of(self, number: int, kind: str) -> list[Event]:
        """Return the events of one kind in a segment, which are kept for the next call.

        Raises:
            ValueError: The segment is missing or damaged.
        """
        known = self._events[1] if self._events is not None and self._events[0] == number else None
        if known is None or kind not in known:
            path = checked_segment(self.path, self.segments[number], bytes_too=known is None)
            with opened(path) as archive:
                found = decode_events_of(archive, kind)
            if known is None:
                self._events = (number, known := {})
            known[kind] = found
        return known[kind]

    @staticmethod
    def salvage(path: Path) -> Iterator[tuple[list[Record], int, list[Event]]]:
        """Yield what can be read of a folder: the records, first event and events of each segment.

        Raises:
            DamageError: At the first segment that is missing or damaged.
        """
        step = -1
        listed, there = _segments_of(path)
        for number in range(max(listed, there)):
            with opened(path / segment_name(number)) as archive:
                records, (first, events) = decode_records(archive), decode_events(archive)
            if np.any(np.diff([step, *(r.step for r in records)]) < 0):
                raise DamageError(f"{path / segment_name(number)} goes back in time")
            step = records[-1].step if records else step
            yield records, first, events
        if listed == there:
            yield from Journal(path).entries(listed)
        if listed < there:
            raise DamageError(f"{INDEX} lists {listed} of these segments, so that none can be told to be the last")


class SegmentEvents:
    """The events of a segment, as a part of a log."""

    def __init__(self, folder: RunFolder, number: int):
        """Take those of a segment of a folder, by its number."""
        self._folder, self._number = folder, number

    def of(self, kind: str) -> list[Event]:
        """Read its events of one kind, in order."""
        return self._folder.events_of(self._number, kind)


def _segments_of(path: Path) -> tuple[int, int]:
    """Number of segments that the index of a folder lists, and one more than the greatest number of those there."""
    index = path / INDEX
    listed = index.read_bytes().count(b"\n") if index.is_file() else 0
    numbers = [name[len("segment_") : -len(".npz")] for name in (file.name for file in path.glob("segment_*.npz"))]
    return listed, max([0, *(int(number) + 1 for number in numbers if number.isdigit())])
