"""Checks of what users give: each returns the value in the type that is needed, or raises one clear ``ValueError``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from warpriver.errors import InputError

__all__ = [
    "checked_line",
    "checked_points",
    "finite_numbers",
    "freeze_numbers",
    "not_negative",
    "numbers",
    "one_of",
    "positive",
    "positive_numbers",
    "whole",
]

T = TypeVar("T")


def whole(value: Any, name: str, least: int = 0, unit: str = "") -> int:
    """Return a whole number, such as 3 or 3.0, of ``least`` or more."""
    try:
        number = int(value)
        good = not isinstance(value, (bool, np.bool_)) and number == value and number >= least
    except (TypeError, ValueError, OverflowError):
        good = False
    if not good:
        raise InputError(f"{name} is {_shown(value)}; give a whole number{_of(unit)}, {least} or more")
    return number


def positive(value: Any, name: str, unit: str = "", hint: str = "") -> float:
    """Return a finite number above 0; ``hint`` ends the message."""
    number = _number(value)
    if not (math.isfinite(number) and number > 0.0):
        raise InputError(f"{name} is {_shown(value)}; give a positive number{_of(unit)}{hint}")
    return number


def not_negative(value: Any, name: str, unit: str = "", hint: str = "") -> float:
    """Return a finite number of 0 or more; ``hint`` ends the message."""
    number = _number(value)
    if not (math.isfinite(number) and number >= 0.0):
        raise InputError(f"{name} is {_shown(value)}; give a finite number{_of(unit)}, 0 or more{hint}")
    return number


def one_of(value: T, name: str, choices: Sequence[T]) -> T:
    """Return a value that is one of a few."""
    if value not in choices:
        *first, last = (repr(choice) for choice in choices)
        raise InputError(f"{name} is {value!r}; use {', '.join(first)} or {last}")
    return value


def finite_numbers(values: Any, count: int, name: str) -> list[float]:
    """Return that many finite numbers."""
    try:
        found = [float(v) for v in values]
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is {values!r}; give {count} numbers") from error
    if len(found) != count or not all(math.isfinite(v) for v in found):
        raise InputError(f"{name} is {found}; give {count} finite numbers")
    return found


def numbers(values: Any, name: str) -> np.ndarray:
    """Return one number a channel as float64, none of them infinite; NaN stands for what is not known."""
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not numbers ({error}); give one number a channel") from error
    if np.isinf(array).any():
        c = int(np.isinf(array).argmax())
        raise InputError(f"{name} of channel {c} is infinite; use NaN where it is not known")
    return array


def positive_numbers(values: Any, name: str) -> np.ndarray:
    """Return one number a channel as float64, all of them positive and finite."""
    array = numbers(values, name)
    wrong = ~(array > 0.0)
    if wrong.any():
        c = int(wrong.argmax())
        raise InputError(f"{name} of channel {c} is {array.flat[c]:g}; it must be positive and finite")
    return array


def checked_line(xy: Any, label: str) -> np.ndarray:
    """Return a line as (n, 2) float64: three points or more, finite, no two of them alike in a row."""
    try:
        line = np.array(xy, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{label}: not an array of numbers ({error}); give (n, 2) x, y in metres") from error
    if line.ndim != 2 or line.shape[1] != 2:
        raise InputError(f"{label}: shape {line.shape}; give (n, 2) x, y in metres")
    if len(line) < 3:
        raise InputError(f"{label}: {len(line)} point(s); give at least 3, or drop it")
    bad = ~np.isfinite(line).all(axis=1)
    if bad.any():
        raise InputError(f"{label}: point {int(bad.argmax())} is not finite; remove or repair it")
    repeated = (np.diff(line, axis=0) == 0.0).all(axis=1)
    if repeated.any():
        k = int(repeated.argmax())
        raise InputError(
            f"{label}: points {k} and {k + 1} are both at ({line[k, 0]:g}, {line[k, 1]:g}); remove one "
            f"({int(repeated.sum())} such pairs in all)"
        )
    return line


def checked_points(xy: Any, name: str, finite: bool = True) -> np.ndarray:
    """Return points as (n, 2) float64."""
    try:
        points = np.ascontiguousarray(xy, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not an array of numbers ({error}); give (n, 2) in m") from error
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"{name} has shape {points.shape}; give (n, 2) points in m")
    if finite and not np.isfinite(points).all():
        raise InputError(f"{name} holds a point that is not finite; remove or repair it")
    return points


def freeze_numbers(params: Any, *names: str) -> None:
    """Turn fields of a frozen dataclass into tuples of finite floats."""
    for name in names:
        try:
            value = np.array(getattr(params, name), np.float64)
        except (TypeError, ValueError):
            value = np.array(np.nan)
        if value.ndim != 1 or len(value) == 0:
            raise InputError(f"{type(params).__name__}.{name} must be a list of numbers")
        if not np.isfinite(value).all():
            at = int(np.flatnonzero(~np.isfinite(value))[0])
            raise InputError(f"{type(params).__name__}.{name}[{at}] is {value[at]}; give finite numbers")
        object.__setattr__(params, name, tuple(float(v) for v in value))


def _number(value: Any) -> float:
    """A number, NaN for what is none: words and flags are not taken for numbers."""
    if isinstance(value, (bool, np.bool_, str, bytes)):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _shown(value: Any) -> str:
    """A value for a message: numbers without the decoration of their type."""
    number = isinstance(value, (float, int, np.integer, np.floating)) and not isinstance(value, bool)
    return f"{value:g}" if number else repr(value)


def _of(unit: str) -> str:
    return f" of {unit}" if unit else ""
