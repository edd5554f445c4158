"""The command line: calls the public API and nothing else; a file for each command."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence

from warpriver import __version__
from warpriver.cli import bench, convert, demo, erode, info, network, render, simulate, valley
from warpriver.cli.output import complain, flush, use_any_console
from warpriver.cli.parser import BAD_INPUT, BadValue, Parser
from warpriver.cli.shared import INTERRUPTED
from warpriver.cli.words import flag_names, in_flags, naming, typed
from warpriver.errors import WarpriverError

__all__ = ["main"]

# In the order in which --help lists them.
COMMANDS = (demo, network, simulate, erode, valley, render, convert, bench, info)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 stopped early, 2 bad input, 130 interrupted."""
    use_any_console()
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        try:
            options = _parser().parse_args(words)
        except BadValue:
            return BAD_INPUT
        with naming(**flag_names(options.parser)), typed(words):
            return _run(options)
    finally:
        flush()


def _run(options: argparse.Namespace) -> int:
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: complain(
                f"warpriver {options.name}: warning: {in_flags(' '.join(str(message).split()))}"
            )
            return options.command(options)
    except (WarpriverError, ValueError, OSError, ImportError, RuntimeError, MemoryError) as error:
        text = in_flags(" ".join(str(error).split()))
        if isinstance(error, OSError) and error.filename and str(error.filename) not in text:
            text += f": {error.filename}"
        complain(f"warpriver {options.name}: {text}")
        return BAD_INPUT
    except KeyboardInterrupt:
        complain(f"warpriver {options.name}: interrupted")
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
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
