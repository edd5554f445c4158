"""The command line: calls the public API and nothing else; a file for each command."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence

from warpriver import __version__
from warpriver.cli import bench, demo, erode, info, network, render, simulate, valley
from warpriver.cli.shared import BAD_INPUT, INTERRUPTED
from warpriver.cli.words import Parser, flags_of, in_flags
from warpriver.errors import WarpriverError

__all__ = ["main"]

# In the order in which --help lists them.
COMMANDS = (demo, network, simulate, erode, valley, render, bench, info)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 stopped early, 2 bad input, 130 interrupted."""
    options = _parser().parse_args(arguments)
    flags = flags_of(options.parser)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: print(
                f"warpriver {options.name}: warning: {in_flags(str(message), flags)}", file=sys.stderr
            )
            return options.command(options)
    except (WarpriverError, ValueError, OSError, ImportError, RuntimeError, MemoryError) as error:
        text = in_flags(" ".join(str(error).split()), flags)
        if isinstance(error, OSError) and error.filename and str(error.filename) not in text:
            text += f": {error.filename}"
        print(f"warpriver {options.name}: {text}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"warpriver {options.name}: interrupted", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="warpriver",
        description="Rivers that meander, on the GPU or the CPU: migrate channel networks, real or not, and draw them.",
        epilog="warpriver COMMAND --help explains the flags of a command with their units and defaults.",
    )
    parser.add_argument("--version", action="version", version=f"warpriver {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return parser
