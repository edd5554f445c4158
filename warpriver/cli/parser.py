"""The parser of the command line: its errors are one line, and numbers are checked where they are typed."""

from __future__ import annotations

import argparse
import dataclasses
import math
import re
from collections.abc import Callable
from typing import Any, NoReturn

from warpriver.cli.output import complain

__all__ = ["BAD_INPUT", "Area", "BadValue", "Interval", "Parser", "area", "interval", "number", "whole_number"]

BAD_INPUT = 2
NEGATIVE = re.compile(r"-((\d+\.?\d*|\.\d+)(e[-+]?\d+)?|inf(inity)?)$", re.IGNORECASE)


class BadValue(SystemExit):
    """A flag was given a value that is none; it has been told."""


class Parser(argparse.ArgumentParser):
    """An ``ArgumentParser`` with help as it is written, errors in one line, and negative numbers such as -3.4e38."""

    def __init__(self, **options: Any):
        """Take what ``ArgumentParser`` takes."""
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False, **options)
        # argparse takes -1e3 for a flag before Python 3.14.
        self._negative_number_matcher = NEGATIVE

    def flags(self) -> dict[str, str]:
        """Return the flags by the names of what they set."""
        return {a.dest: max(a.option_strings, key=len) for a in self._actions if a.option_strings}

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, and exit with 2."""
        of_value = message.startswith("argument ")
        complain(f"{self.prog}: {message.removeprefix('argument ')}; {self.prog} --help explains the flags")
        raise (BadValue if of_value else SystemExit)(BAD_INPUT)


def number(
    low: float = -math.inf, high: float = math.inf, *, above: float | None = None, unit: str = ""
) -> Callable[[str], float]:
    """Return a type of flag: a finite number from ``low`` to ``high``, or one above ``above``."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        good = math.isfinite(value) and low <= value <= high and (above is None or value > above)
        if not good:
            raise argparse.ArgumentTypeError(f"{text!r} is not {_wanted(low, high, above, unit)}")
        return value

    return parse


def _wanted(low: float, high: float, above: float | None, unit: str) -> str:
    kind = f"a number of {unit}" if unit else "a number"
    if above is not None:
        low = above
        kind += f" above {above:g}"
    elif math.isfinite(low):
        kind += f", {low:g} or more"
    if math.isfinite(high):
        kind = f"a number from {low:g} to {high:g}" if math.isfinite(low) else f"a number up to {high:g}"
    return kind


# Counts beyond this are mistakes: they fit no index of the kernels.
MAX_WHOLE = 2**31 - 1


def whole_number(low: int = 0) -> Callable[[str], int]:
    """Return a type of flag: a whole number, ``low`` or more."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= MAX_WHOLE:
            limit = f" and {MAX_WHOLE} or less" if value > MAX_WHOLE else ""
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, {low} or more{limit}")
        return value

    return parse


@dataclasses.dataclass(frozen=True)
class Area:
    """A drainage area in m2 or in cells."""

    value: float
    unit: str

    def square_meters(self, cell_size: float) -> float:
        """Return it in m2, for cells of a size in m."""
        return self.value * {"km2": 1e6, "m2": 1.0, "cells": cell_size**2}[self.unit]


def area(text: str) -> Area:
    """Parse an area: 2 or 2km2, 5e5m2, 50cells."""
    found = re.fullmatch(r"(.*?)\s*(km2|m2|cells?)?", text.strip())
    assert found is not None
    unit = {None: "km2", "cell": "cells"}.get(found[2], found[2])
    try:
        value = float(found[1])
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text!r} is not an area above 0, such as 2 or 2km2, 5e5m2, 50cells")
    return Area(value, unit)


@dataclasses.dataclass(frozen=True)
class Interval:
    """Time between records, in steps or in years."""

    steps: int | None = None
    years: float | None = None


def interval(text: str) -> Interval:
    """Parse the time between records: 20 or 20steps, 10yr."""
    found = re.fullmatch(r"(.*?)\s*(steps?|yr|years?)?", text.strip())
    assert found is not None
    in_years = found[2] in ("yr", "year", "years")
    try:
        value = float(found[1])
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0) or not (in_years or value == int(value)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a time between records, such as 20 or 20steps, 10yr")
    return Interval(years=value) if in_years else Interval(steps=int(value))
