"""What a command prints: results are on disk before it speaks, and no failure to print ends it."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import Any

__all__ = ["complain", "flush", "say", "use_any_console"]


def use_any_console() -> None:
    """Let characters that the console cannot show, of a file's name for example, be written as escapes."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            with contextlib.suppress(OSError, ValueError):
                reconfigure(errors="backslashreplace")


def say(*words: Any, sep: str = " ") -> None:
    """Print a line to standard output; where that fails, to a closed pipe or a full disk, nothing more is printed."""
    _print(sys.stdout, sep.join(map(str, words)))


def complain(*words: Any) -> None:
    """Print a line to standard error, as :func:`say` does."""
    _print(sys.stderr, " ".join(map(str, words)))


def flush() -> None:
    """Write what is still in the buffers, so that the interpreter finds nothing to fail on when it ends."""
    for stream in (sys.stdout, sys.stderr):
        _print(stream, None)


def _print(stream: Any, line: str | None) -> None:
    if stream is None:
        return
    try:
        if line is not None:
            stream.write(line + "\n")
        stream.flush()
    except UnicodeEncodeError:  # a stream that could not be told how to write what it cannot show
        assert line is not None
        _print(stream, line.encode("ascii", "backslashreplace").decode("ascii"))
    except (OSError, ValueError):
        _silence(stream)


def _silence(stream: Any) -> None:
    """Let what a stream still holds, and all that is to come, go nowhere."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
        stream.flush()
