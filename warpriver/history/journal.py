"""The journal of a run: its records since the last segment, each written as soon as it is there.

An entry is a line of its own, with a number, a size and a checksum, and an archive. Entries are appended to one file,
and not forced onto the disk: they outlive the process that wrote them, if not a loss of power. What was being written
when a run was killed does not count, nor do entries of records that a segment holds by now.
"""

from __future__ import annotations

import contextlib
import io
import os
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.history.events import Event
from warpriver.history.record import Record
from warpriver.history.segments import decode_events, decode_records, encode, sealed, unsealed

__all__ = ["JOURNAL", "Journal"]

JOURNAL = "journal.bin"


class Journal:
    """Records and events that no segment holds yet."""

    def __init__(self, folder: Path):
        """Take the journal of a folder; there is none before the first entry."""
        self.path = folder / JOURNAL

    def append(self, number: int, records: Sequence[Record], events: Sequence[Event], first_event: int) -> None:
        """Add an entry.

        Args:
            number: Number of the segment that will hold it.
            records: The records.
            events: The events since those of the entry before.
            first_event: Place of the first of them among all events of the run.

        Raises:
            OSError: There is no room, or the folder is gone; the journal is as it was.
        """
        buffer = io.BytesIO()
        arrays: dict[str, Any] = encode(records, events, first_event)
        np.savez(buffer, **arrays)
        data = buffer.getbuffer()
        head = sealed({"segment": number, "bytes": len(data), "crc32": zlib.crc32(data)}).encode()
        with self.path.open("ab") as file:
            length = file.tell()
            try:
                file.write(head + b"\n")
                file.write(data)
                file.flush()
            except OSError:
                with contextlib.suppress(OSError):
                    os.truncate(self.path, length)
                raise

    def clear(self) -> None:
        """Remove the journal: its records are stored."""
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)

    def entries(self, number: int) -> Iterator[tuple[list[Record], int, list[Event]]]:
        """Yield records, first event and events of the entries that count, up to the first that is not whole.

        Args:
            number: How many segments there are; entries for an earlier one are stored.
        """
        if not self.path.is_file():
            return
        with self.path.open("rb") as file:
            while line := file.readline():
                try:
                    head = unsealed(line)
                    data = file.read(head["bytes"])
                    if len(data) != head["bytes"] or zlib.crc32(data) != head["crc32"]:
                        return
                except (InputError, KeyError, TypeError, ValueError, OverflowError):
                    return
                if head["segment"] == number:
                    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                        yield decode_records(archive), *decode_events(archive)
