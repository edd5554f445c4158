"""The edit log of a session: a line for each thing done, written behind the lines before it and never anew.

A line is an object in JSON: an edit with its step, or how many of the last edits were taken back, or how far the run
has come. What is read is what the lines come to. A process that is killed while it writes leaves a last line that is
cut short; it is left out, with a word.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import IO, Any

from warpriver.edits import Edit, Session
from warpriver.edits.values import edit_of
from warpriver.errors import InputError, PathError

__all__ = ["Entry", "Journal", "digest", "read_journal"]

FORMAT = "warpriver-studio-log-1"


@dataclasses.dataclass(frozen=True)
class Entry:
    """An edit that was done.

    Attributes:
        step: Steps that were done before it.
        edit: The edit.
        group: Name of the group with which it is undone, or None.
    """

    step: int
    edit: Edit
    group: str | None = None


class Journal:
    """The log of a session that goes on."""

    def __init__(self, path: Path, seed: int, entries: list[Entry], steps: int):
        """Open a log, or begin one.

        Args:
            path: Its file.
            seed: Seed of the run.
            entries: What it holds, as :func:`read_journal` says.
            steps: Steps that it tells of.
        """
        self._path, self._seed = path, seed
        self._entries = list(entries)
        self._steps = steps
        fresh = not path.exists()
        if not fresh:
            _cut_torn(path)
        self._file: IO[bytes] = path.open("ab")
        if fresh or not path.stat().st_size:
            self._write({"format": FORMAT, "seed": seed})
            self._file.flush()

    def note(self, entries: list[Entry], steps: int) -> None:
        """Bring the log to these edits and steps: only what differs from it is written."""
        same = 0
        # Nearly always all but the last ones are the very objects that were noted before.
        while same < min(len(entries), len(self._entries)) and entries[same] is self._entries[same]:
            same += 1
        if same < len(self._entries):
            self._write({"undo": len(self._entries) - same})
        for entry in entries[same:]:
            told: dict[str, Any] = {"step": entry.step} | entry.edit.as_json()
            self._write(told if entry.group is None else told | {"group": entry.group})
        self._entries[same:] = entries[same:]
        if steps != self._steps:
            self._steps = steps
            self._write({"steps": steps})
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, values: dict[str, Any]) -> None:
        self._file.write(json.dumps(values, separators=(",", ":")).encode() + b"\n")


def read_journal(path: Path) -> tuple[list[Entry], int | None, int, str | None]:
    """Return the edits of a log, the seed, the steps that were done, and a word on what was left out.

    A log without a whole line has no edits, no steps, and None for a seed.

    Raises:
        ValueError: It is no log, or one of its lines is none.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PathError.of(error, f"cannot read {path}") from error
    lines = data.split(b"\n")
    torn = lines.pop()
    entries: list[Entry] = []
    seed: int | None = None
    steps = 0
    for number, line in enumerate(lines, 1):
        try:
            told = json.loads(line)
            if not isinstance(told, dict) or (number == 1 and told.get("format") != FORMAT):
                raise InputError(f"the first line needs the format {FORMAT!r}")
            if number == 1:
                seed = int(told["seed"])
            elif "undo" in told:
                del entries[len(entries) - min(int(told["undo"]), len(entries)) :]
            elif "steps" in told:
                steps = int(told["steps"])
            else:
                step, group = int(told.pop("step")), told.pop("group", None)
                entries.append(Entry(step, edit_of(told), group))
        except (LookupError, TypeError, ValueError, RecursionError) as error:
            raise InputError(f"{path}, line {number}: {error}") from error
    word = f"the last line of {path.name} was cut short and is left out" if torn else None
    return entries, seed, max([steps, *(entry.step for entry in entries)]), word


def session_of(entries: list[Entry], seed: int, steps: int) -> Session:
    """Return edits as a session, which :meth:`warpriver.Simulation.replay` does again."""
    return Session(tuple((entry.step, entry.edit) for entry in entries), seed, steps)


def digest(entries: list[Entry]) -> str:
    """Return a sum of edits and their steps: the same for the same ones alone."""
    total = hashlib.sha256()
    for entry in entries:
        total.update(json.dumps([entry.step, entry.edit.as_json()]).encode())
    return total.hexdigest()


def _cut_torn(path: Path) -> None:
    """Remove a last line that was cut short, so that the next one stands by itself."""
    with path.open("rb+") as file:
        data = file.read()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            file.truncate(whole)
