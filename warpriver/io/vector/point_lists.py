"""Attributes that hold a list, a number a point, also after a GIS has moved the points."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError, warn
from warpriver.io.vector.attributes import is_no_value, list_names

__all__ = ["PointLists", "filled_gaps"]

# A line that was edited fits its list by the length along it while that length is within this fraction of the one that
# its attributes state; a line that was cut does not.
SAME_LENGTH = 0.05
UNREADABLE = "cannot be read, and is passed over"
INTERPOLATED = "has another number of values than points, as after an edit in a GIS, and is interpolated along the line"
MISFIT = "belongs to a line of another length, as after a cut in a GIS, and is passed over"
# A shapefile cuts a text here.
LONGEST_TEXT = 254


class PointLists:
    """Reads the lists of the features of one file, and counts those that do not fit their points.

    Attributes:
        path: The file.
        told: How many lists had each fate, by name and fate.
    """

    def __init__(self, path: Path):
        """Read lists of this file."""
        self.path = path
        self.told: Counter[tuple[str, str]] = Counter()

    def read(self, attributes: Mapping[str, Any], role: str, xy: np.ndarray) -> np.ndarray | None:
        """Return one number a point, or None if there is none or if the list belongs to another line.

        Args:
            attributes: Values by lower-case name.
            role: "width" or "depth".
            xy: (n, 2) points.
        """
        for name in list_names(role):
            value = attributes.get(name)
            # A number stands for none in some tables, or for a line of one width.
            if value is None or isinstance(value, (int, float)) or (isinstance(value, str) and not value.strip()):
                continue
            numbers = _numbers(value)
            if numbers is None:
                self.told[name, UNREADABLE] += 1
                continue
            filled = filled_gaps(numbers, role)
            if filled is None or len(filled) == len(xy):
                return filled
            along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
            stated = _number(attributes.get("length_m"))
            if len(filled) < 2 or not abs(along[-1] - stated) <= SAME_LENGTH * stated:
                self.told[name, MISFIT] += 1
                return None
            self.told[name, INTERPOLATED] += 1
            read: np.ndarray | None = np.interp(along / along[-1], np.linspace(0.0, 1.0, len(filled)), filled)
            return read
        return None

    def tell(self) -> None:
        """Warn of the lists that do not fit."""
        for (name, fate), count in self.told.items():
            lines = "1 line" if count == 1 else f"{count} lines"
            warn(f"{self.path}: the list {name} of {lines} {fate}")


def filled_gaps(numbers: np.ndarray, role: str) -> np.ndarray | None:
    """Return numbers along a line with those of no value interpolated between the others; None where all are none."""
    none = is_no_value(numbers, role)
    if not none.any():
        return numbers
    if none.all():
        return None
    at = np.arange(len(numbers))
    full: np.ndarray | None = np.interp(at, at[~none], numbers[~none])
    return full


def _numbers(value: Any) -> np.ndarray | None:
    """Return a list as it is written by us, or as GDAL turns it into text: "(3:1,2,3)", "1,2,3"; None for others."""
    try:
        array = np.array(_parsed(value) if isinstance(value, str) else value, np.float64)
    except (TypeError, ValueError, RecursionError):
        return None
    return array if array.ndim == 1 and len(array) else None


def _parsed(text: str) -> Any:
    """Return a list from text, or raise ``ValueError`` if it is cut short or no list."""
    text = text.strip()
    if text.startswith("["):
        return json.loads(text)
    counted = re.fullmatch(r"\((\d+):(.*)\)", text)
    words = (counted[2] if counted else text.strip("{}")).replace(",", " ").split()
    if len(text) >= LONGEST_TEXT or (counted and int(counted[1]) != len(words)):
        raise InputError("cut short")
    return words


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return np.nan
