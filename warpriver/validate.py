"""Checks of what users give: each returns the value in the type that is needed, or raises one clear ``ValueError``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.errors import InputError

__all__ = [
    "checked_line",
    "checked_points",
    "finite",
    "finite_numbers",
    "floats",
    "freeze_numbers",
    "grid_shape",
    "not_negative",
    "numbers",
    "one_of",
    "position",
    "positive",
    "positive_numbers",
    "real",
    "seeded",
    "shown",
    "whole",
]

T = TypeVar("T")

# Numbers beyond these stand for no quantity of a river, and their squares overflow or vanish.
SMALLEST, LARGEST = 1e-30, 1e30
# Counts beyond this are mistakes: they fit no index of the kernels.
MAX_WHOLE = 2**31 - 1
MAX_SEED = 2**63 - 1
# Characters of a value in a message.
LONGEST = 80


def real(value: Any) -> float:
    """Return a number as a float; NaN for words, flags, infinities, and numbers beyond all reckoning."""
    if isinstance(value, (bool, np.bool_, str, bytes)):
        return math.nan
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return number if number == 0.0 or SMALLEST <= abs(number) <= LARGEST else math.nan


def whole(value: Any, name: str, minimum: int = 0, unit: str = "", maximum: int = MAX_WHOLE) -> int:
    """Return a whole number, such as 3 or 3.0, from ``minimum`` to ``maximum``."""
    try:
        number = int(value)
        good = not isinstance(value, (bool, np.bool_, str, bytes)) and bool(
            number == value and minimum <= number <= maximum
        )
    except (TypeError, ValueError, OverflowError):
        good = False
    if not good:
        limit = f" and {maximum} or less" if isinstance(value, (int, float)) and value > maximum else ""
        raise InputError(f"{name} is {shown(value)}; give a whole number{_of(unit)}, {minimum} or more{limit}")
    return number


def seeded(seed: Any, name: str = "seed") -> np.random.Generator:
    """Return random numbers that follow from a seed, a whole number of 0 or more."""
    return np.random.default_rng(whole(seed, name, maximum=MAX_SEED))


def positive(value: Any, name: str, unit: str = "", hint: str = "") -> float:
    """Return a finite number above 0; ``hint`` ends the message."""
    number = real(value)
    if not number > 0.0:
        raise InputError(f"{name} is {shown(value)}; give a positive number{_of(unit)}{hint}")
    return number


def not_negative(value: Any, name: str, unit: str = "", hint: str = "") -> float:
    """Return a finite number of 0 or more; ``hint`` ends the message."""
    number = real(value)
    if not number >= 0.0:
        raise InputError(f"{name} is {shown(value)}; give a finite number{_of(unit)}, 0 or more{hint}")
    return number


def finite(value: Any, name: str, unit: str = "") -> float:
    """Return a finite number of either sign."""
    number = real(value)
    if math.isnan(number):
        raise InputError(f"{name} is {shown(value)}; give a finite number{_of(unit)}")
    return number


def position(xy: Any, name: str = "origin") -> FloatArray:
    """Return a place, x and y in m, both finite, as (2,) float64."""
    array = floats(xy, name, "x and y in m").copy()
    if array.shape != (2,) or not np.isfinite(array).all():
        raise InputError(f"{name} is {shown(xy)}; give x and y in m, both finite")
    return array


def one_of(value: T, name: str, choices: Sequence[T]) -> T:
    """Return a value that is one of a few."""
    # An array is equal to each of its elements.
    if isinstance(value, np.ndarray) or value not in choices:
        *first, last = (repr(choice) for choice in choices)
        raise InputError(f"{name} is {shown(value)}; use {', '.join(first)} or {last}")
    return value


def floats(values: Any, name: str, give: str = "numbers") -> FloatArray:
    """Return an array as float64, of any shape, with NaN where it holds them; ``give`` says what was expected."""
    try:
        return np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} is {shown(values)}; give {give}") from error


def grid_shape(shape: Any, name: str = "shape", minimum: int = 2) -> tuple[int, int]:
    """Return rows and columns, ``minimum`` or more of each."""
    try:
        rows, columns = (whole(count, name, minimum) for count in shape)
    except ValueError as error:
        given = shown(tuple(shape))
        raise InputError(
            f"{name} is {given}; give rows and columns, whole numbers, at least {minimum} of each"
        ) from error
    return rows, columns


def finite_numbers(values: Any, count: int, name: str) -> list[float]:
    """Return that many finite numbers."""
    found = floats(values, name, f"{count} numbers")
    if found.shape != (count,) or not np.isfinite(found).all():
        raise InputError(f"{name} is {shown(values)}; give {count} finite numbers")
    return [float(v) for v in found]


def numbers(values: Any, name: str) -> FloatArray:
    """Return one number a channel as float64, none of them infinite; NaN stands for what is not known."""
    array = floats(values, name, "one number a channel").copy()
    if np.isinf(array).any():
        c = int(np.isinf(array).argmax())
        raise InputError(f"{name} of channel {c} is infinite; use NaN where it is not known")
    return array


def positive_numbers(values: Any, name: str) -> FloatArray:
    """Return one number a channel as float64, all of them positive and finite."""
    array = numbers(values, name)
    wrong = ~(array > 0.0)
    if wrong.any():
        c = int(wrong.argmax())
        raise InputError(f"{name} of channel {c} is {array.flat[c]:g}; it must be positive and finite")
    return array


def checked_line(xy: Any, label: str) -> FloatArray:
    """Return a line as (n, 2) float64: three points or more, finite, no two of them alike in a row."""
    line = floats(xy, label, "(n, 2) x, y in metres").copy()
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
    points = np.ascontiguousarray(floats(xy, name, "(n, 2) x, y in metres"))
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
        except (TypeError, ValueError, OverflowError):
            value = np.array(np.nan)
        if value.ndim != 1 or len(value) == 0:
            raise InputError(f"{type(params).__name__}.{name} must be a list of numbers")
        if not np.isfinite(value).all():
            at = int(np.flatnonzero(~np.isfinite(value))[0])
            raise InputError(f"{type(params).__name__}.{name}[{at}] is {value[at]}; give finite numbers")
        object.__setattr__(params, name, tuple(float(v) for v in value))


def shown(value: Any) -> str:
    """Return a value for a message: numbers without the decoration of their type, nothing longer than a line."""
    if isinstance(value, (float, int, np.integer, np.floating)) and not isinstance(value, bool):
        try:
            return f"{float(value):g}"
        except OverflowError:
            return f"about {'-' if value < 0 else ''}1e{math.log10(abs(int(value))):.0f}"
    text = " ".join(repr(value).split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def _of(unit: str) -> str:
    return f" of {unit}" if unit else ""
