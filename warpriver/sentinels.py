"""Numbers that stand for "no data" in files and arrays although nothing declares them."""

from __future__ import annotations

import numpy as np

__all__ = ["equal_cells", "find_sentinels", "listed"]

# What programs write where nothing was measured. Each is also a number that may be meant, so that it counts only where
# it stands alone: where more cells have exactly this value than others have one within NEAR of it.
KNOWN = (
    -999.0, -9999.0, -99999.0, -999999.0, -32767.0, -32768.0, -2147483647.0, -2147483648.0,
    9999.0, 32767.0, 65535.0, 99999.0, 999999.0, 2147483647.0, 2147483648.0,
)  # fmt: skip
NEAR = 100.0
# Beyond this no number is a measured one: 1e20, 9.97e36, 1.70141e38, 3.40282e38, 1.8e308 ...
FAR = 1e9
# Beyond it a value is matched by the digits that single precision keeps; from 1e30 on by two, as in -3.4e38.
SINGLE, HUGE, ROUGHLY = 1e-6, 1e30, 0.01
# Different values that one array may hold for no data.
MAX_VALUES = 6


def find_sentinels(values: np.ndarray, known: np.ndarray | None = None) -> list[tuple[float, int]]:
    """Return the values that look like no data, each with the number of its cells, by size from the outside.

    Args:
        values: Numbers of any shape; NaN is passed over.
        known: Cells to look at, of the same shape; by default those that are not NaN.
    """
    if values.dtype.kind not in "iuf" or values.size == 0:
        return []
    if known is None:
        known = np.isfinite(values) if values.dtype.kind == "f" else np.ones(values.shape, bool)
    elif values.dtype.kind == "f":
        known = known & np.isfinite(values)
    found: list[tuple[float, int]] = []
    while len(found) < MAX_VALUES and known.any():
        some = values.flat[known.argmax()]
        ends = (values.min(where=known, initial=some), values.max(where=known, initial=some))
        sentinel = next((end for end in ends if _stands_out(end, values, known)), None)
        if sentinel is None:
            break
        cells = known & (values == sentinel)
        found.append((float(sentinel), int(cells.sum())))
        known = known & ~cells
    return found


def _stands_out(value: np.generic, values: np.ndarray, known: np.ndarray) -> bool:
    """Tell whether the lowest or highest value of an array is no measured one."""
    number = float(value)
    if values.dtype.kind == "f" and abs(number) >= FAR:
        return True
    if number not in KNOWN:
        return False
    # The lowest or the highest of all: what is near lies on one side.
    near = values <= number + NEAR if number < 0.0 else values >= number - NEAR
    same = int((known & (values == value)).sum())
    return same > int((known & near).sum()) - same and same < int(known.sum())


def equal_cells(values: np.ndarray, value: float) -> np.ndarray:
    """Return where values are ``value``, NaN included; of one beyond 1e9 its first digits count."""
    if np.isnan(value):
        return np.isnan(values) if values.dtype.kind == "f" else np.zeros(values.shape, bool)
    if values.dtype.kind != "f":
        return np.asarray(values == value)
    with np.errstate(over="ignore", invalid="ignore"):
        if FAR < abs(value) < np.inf:
            return np.abs(values.astype(np.float64) / value - 1.0) < (ROUGHLY if abs(value) > HUGE else SINGLE)
        return np.asarray(values == value)


def listed(found: list[tuple[float, int]]) -> str:
    """Return sentinels and the number of their cells for a message."""
    return ", ".join(f"{count} {'is' if count == 1 else 'are'} {value:.9g}" for value, count in found)
