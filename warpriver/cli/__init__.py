"""The command line: calls the public API and nothing else; a file for each command."""

from __future__ import annotations

import argparse
import functools
import sys
import warnings
from collections.abc import Sequence

from warpriver import __version__
from warpriver.cli import (
    bench,
    calibrate,
    convert,
    demo,
    erode,
    info,
    landscape,
    metrics,
    network,
    render,
    riverscape,
    simulate,
    studio,
    valley,
)
from warpriver.cli.output import complain, forgiving_console
from warpriver.cli.parser import BAD_INPUT, BadValue, Parser
from warpriver.cli.shared import INTERRUPTED
from warpriver.cli.words import flag_names, in_flags, naming, typed
from warpriver.errors import WarpriverError

__all__ = ["main"]

# In the order in which --help lists them.
COMMANDS = (
    demo, network, simulate, calibrate, erode, valley, landscape, riverscape, studio, render, convert, metrics, bench,
    info,
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 stopped early, 2 bad input, 130 interrupted.

    This is the one place where errors end: each becomes a line on standard error. In Python's development mode
    (``python -X dev -m warpriver``) those that are not ours come with their traceback.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    with forgiving_console():
        try:
            options = _parser().parse_args(words)
        except BadValue:
            return BAD_INPUT
        with naming(**flag_names(options.parser)), typed(words):
            return _run(options)


def _run(options: argparse.Namespace) -> int:
    def tell(text: str) -> None:
        complain(f"warpriver {options.name}: {in_flags(' '.join(text.split()))}")

    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: tell(f"warning: {message}")
            code: int = options.command(options)
            return code
    except KeyboardInterrupt:
        tell("interrupted")
        return INTERRUPTED
    except Exception as error:
        if sys.flags.dev_mode and not isinstance(error, WarpriverError):
            raise
        tell(_text_of(error))
        return BAD_INPUT


def _text_of(error: Exception) -> str:
    """Return what went wrong; an error that was not foreseen tells its kind, and how to find its place."""
    text = str(error)
    if isinstance(error, OSError) and error.filename and str(error.filename) not in text:
        text += f": {error.filename}"
    if isinstance(error, MemoryError) and not text:
        return "out of memory"
    if isinstance(error, (WarpriverError, ValueError, OSError, ImportError, MemoryError)):
        return text or type(error).__name__
    return f"{type(error).__name__}: {text} (unforeseen; python -X dev -m warpriver ... shows where)"


@functools.cache
def _parser() -> argparse.ArgumentParser:
    """Return the parser of all commands: 400 flags take longer to set up than to read."""
    parser = Parser(
        prog="warpriver",
        description="Find the rivers of a terrain, let rivers meander on the GPU or the CPU, and draw them.",
        epilog="warpriver COMMAND --help explains the flags of a command with their units and defaults.",
    )
    parser.add_argument("--version", action="version", version=f"warpriver {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return parser
