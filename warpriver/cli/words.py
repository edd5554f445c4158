"""Messages of the library in the words of the command line, and flags that take negative numbers."""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from warpriver.errors import WarpriverError

__all__ = ["Parser", "flags_of", "in_flags", "renamed"]

# An argument as a message writes it: to_crs="utm", cell_size=, range=(low, high), MeanderParams(collision_distance=0).
ARGUMENT = re.compile(
    r"""(?P<call>\b[A-Z]\w*Params\()?(?P<name>\b[a-z]\w*)=(?P<value>"[^"]*"|'[^']*'|\([^()]*\)|[-+\w.]*)(?(call)\))"""
)
# Parameters of a model, as messages about their values name them: MeanderParams.time_step is ...
FIELD = re.compile(r"\b[A-Z]\w*Params\.([a-z]\w*)")
# Negative numbers that argparse takes for flags: those with an exponent, with a point at the end, and infinity.
NEGATIVE = re.compile(r"-(\d+\.?\d*|\.\d+)e[-+]?\d+$|-\d+\.$|-(inf|infinity)$", re.IGNORECASE)


class Parser(argparse.ArgumentParser):
    """A parser that takes -3.4e38 and -inf for numbers, not for flags."""

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse arguments; such numbers are marked with a blank, which ``float`` passes over."""
        words = sys.argv[1:] if args is None else args
        return super().parse_known_args([f" {word}" if NEGATIVE.match(word) else word for word in words], namespace)


def flags_of(parser: argparse.ArgumentParser) -> dict[str, str]:
    """Return the flags of a command by the names of the arguments that they stand for."""
    return {word[2:].replace("-", "_"): word for word in re.findall(r"--[a-z][-a-z0-9]*", parser.format_usage())}


def in_flags(text: str, flags: dict[str, str]) -> str:
    """Return a message whose arguments are written as flags, where the command has them.

    Args:
        text: What the library says.
        flags: Flags by argument.
    """

    def flag(found: re.Match[str]) -> str:
        known = flags.get(found["name"])
        if known is None:
            return found[0]
        value = found["value"].strip("\"'")
        if value.startswith("("):
            value = " ".join(word.strip().upper() for word in value.strip("()").split(","))
        return known if value in ("", "True") else f"{known} {value}"

    text = ARGUMENT.sub(flag, text)
    return FIELD.sub(lambda found: flags.get(found[1], found[0]), text)


@contextmanager
def renamed(**names: str) -> Iterator[None]:
    """Let messages that come out of the block name arguments otherwise: ``renamed(crs="terrain_crs")``."""

    def other(text: str) -> str:
        for name, instead in names.items():
            text = re.sub(rf"\b{name}(?==)", instead, text)
        return text

    refusal = None
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            yield
        except WarpriverError as error:
            refusal = error
    for warning in told:
        warnings.warn(other(str(warning.message)), warning.category, stacklevel=3)
    if refusal is not None:
        raise type(refusal)(other(str(refusal))) from refusal
