"""What a section of gpu.py finds, in a file that is always whole: replaced with each addition, never edited."""

from __future__ import annotations

import json
import os
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

# How a section may end. Only the first two are good.
DONE, SKIPPED, FAILED, OVERRAN = "done", "skipped", "failed", "overran"
# Characters of an error that a result keeps; the log has all of it.
ERROR_LENGTH = 300


class SkippedError(Exception):
    """A section cannot be done on this machine; the message says why."""


def write_beside(path: Path, text: str) -> None:
    """Write a file under another name and move it to its own, so that who reads it never finds a part of it."""
    fresh = path.with_name(path.name + ".new")
    fresh.write_text(text)
    os.replace(fresh, path)


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON, beside its place and then into it."""
    write_beside(path, json.dumps(value, indent=2) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Return what a file holds, or nothing where it is missing."""
    return json.loads(path.read_text()) if path.exists() else {}


def one_line(error: object) -> str:
    """The beginning of a message, on one line."""
    text = " ".join(str(error).split())
    return text if len(text) <= ERROR_LENGTH else text[:ERROR_LENGTH] + " ..."


class Report:
    """The findings of one section, and how much time it has left.

    Attributes:
        device: Name of the Warp device that is looked at.
        small: Whether sizes are small, to see that everything works rather than how fast.
        folder: Where the section may leave further files.
        facts: What was found: numbers, texts, and tables as lists of rows.
        failures: What was found to be wrong, a line each.
    """

    def __init__(self, target: Path, *, device: str = "cpu", small: bool = False, seconds: float = 60.0):
        """Begin a report.

        Args:
            target: JSON file to write; its folder is there.
            device: Name of the Warp device.
            small: Whether sizes are small.
            seconds: How long the section may take from now on.
        """
        self.device, self.small = device, small
        self.folder = target.parent
        self.facts: dict[str, Any] = {}
        self.failures: list[str] = []
        self._target, self._seconds, self._begin = target, seconds, time.monotonic()
        self._write("begun")

    def left(self) -> float:
        """Seconds that are left to the section."""
        return self._seconds - (time.monotonic() - self._begin)

    def tell(self, **facts: Any) -> None:
        """Note single facts."""
        self.facts.update(facts)
        for name, value in facts.items():
            print(f"{name}: {value}", flush=True)
        self._write("begun")

    def add(self, table: str, row: dict[str, Any]) -> None:
        """Add a row to a table."""
        self.facts.setdefault(table, []).append(row)
        print(f"{table}: " + ", ".join(f"{name} {value}" for name, value in row.items()), flush=True)
        self._write("begun")

    def fail(self, what: str) -> None:
        """Note that something is wrong; the section goes on."""
        self.failures.append(one_line(what))
        print(f"WRONG: {what}", flush=True)
        self._write("begun")

    def attempt(self, what: str, call: Callable[[], None]) -> None:
        """Do a part of the section; an error in it is noted, and the section goes on."""
        try:
            call()
        except Exception as error:
            traceback.print_exc()
            self.fail(f"{what}: {type(error).__name__}: {error}")

    def run(self, section: Callable[[Report], None]) -> str:
        """Do the whole section and return how it ended."""
        state, error = DONE, None
        try:
            section(self)
        except SkippedError as reason:
            state, error = SKIPPED, one_line(reason)
        except Exception as problem:
            traceback.print_exc()
            state, error = FAILED, f"{type(problem).__name__}: {one_line(problem)}"
        if self.failures:
            state = FAILED
        self._write(state, error)
        return state

    def _write(self, state: str, error: str | None = None) -> None:
        taken = time.monotonic() - self._begin
        record = {"state": state, "error": error, "seconds": taken, "failures": self.failures, "facts": self.facts}
        write_json(self._target, record)
