"""What a command prints: results are on disk before it speaks, and no failure to print ends it."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any

__all__ = ["complain", "forgiving_console", "say"]


def say(*words: Any, sep: str = " ") -> None:
    """Print a line to standard output."""
    print(*words, sep=sep, flush=True)


def complain(*words: Any) -> None:
    """Print a line to standard error."""
    print(*words, file=sys.stderr, flush=True)


class _Forgiving:
    """A text stream that shows what its encoding lacks as escapes, and drops what nobody reads any more."""

    def __init__(self, stream: Any):
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, as far as there is somewhere to write it to."""
        try:
            try:
                self._stream.write(text)
            except UnicodeEncodeError:
                code = self._stream.encoding or "ascii"
                self._stream.write(text.encode(code, "backslashreplace").decode(code))
        except (OSError, ValueError):
            self._give_up()
        return len(text)

    def flush(self) -> None:
        """Write what waits."""
        try:
            self._stream.flush()
        except (OSError, ValueError):
            self._give_up()

    def _give_up(self) -> None:
        """Let the rest go nowhere, also what Python writes at its end: the reader has gone, or the disk is full."""
        with contextlib.suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)


@contextlib.contextmanager
def forgiving_console() -> Iterator[None]:
    """Let what is printed in the block not end it, whatever becomes of standard output and standard error."""
    before = sys.stdout, sys.stderr
    # A stream that was closed before the program began is None, and print takes that.
    sys.stdout, sys.stderr = (None if stream is None else _Forgiving(stream) for stream in before)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, _Forgiving):
                stream.flush()
        sys.stdout, sys.stderr = before
