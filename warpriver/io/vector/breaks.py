"""Where channels begin in rows of points: by a column that names them, by blank lines, or by jumps that are told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError, warn

__all__ = ["CHANNEL_NAMES", "breaks_by_blank", "breaks_by_name", "channel_columns", "tell_jumps"]

# Columns that tell channels apart, the first that is there. The second ones may number points instead, or hold
# something else: they count only where their rows stand together.
SURE = (
    "channel", "channel_id", "seg_id", "segment_id", "reach_id", "river_id", "stream_id", "line_id", "comid",
    "nhdplusid", "hyriv_id", "linkno",
)  # fmt: skip
UNSURE = (
    "id", "fid", "ogc_fid", "objectid", "gid", "feature_id", "featureid", "path_id", "reach", "segment", "river",
    "river_name", "gnis_name", "stream", "line", "part", "part_id", "vertex_part", "path", "track", "name",
)  # fmt: skip
CHANNEL_NAMES = (*SURE, *UNSURE)
# A step that is so many times the usual one of its line, of at least so many points, is told.
JUMP, POINTS = 15.0, 8


def channel_columns(names: Sequence[str]) -> list[str]:
    """Return the columns that may tell channels apart, the best first; ``names`` are in lower case."""
    return [name for name in CHANNEL_NAMES if name in names]


def breaks_by_name(path: Path, ids: np.ndarray, name: str) -> tuple[list[int], list[Any]] | None:
    """Return the rows at which a column changes, but for the first, and the label of each channel.

    Args:
        path: The file, for messages.
        ids: The column, a number or a word a row.
        name: Its name.

    Returns:
        None where the column numbers points or holds something else.

    Raises:
        ValueError: The rows of a channel do not stand together.
    """
    breaks = np.flatnonzero(ids[1:] != ids[:-1]) + 1
    if name in UNSURE and len(breaks) == len(ids) - 1:
        return None
    labels = ids[np.concatenate([[0], breaks])].tolist()
    labels = [int(v) if isinstance(v, float) and v.is_integer() else v for v in labels]
    label, times = Counter(labels).most_common(1)[0]
    if times == 1:
        return breaks.tolist(), labels
    if name in UNSURE and name != "id":
        warn(
            f"{path}: the column {name} does not part the rows into channels, as those of {label} do not stand "
            "together; it is passed over. Sort the rows if it names channels"
        )
        return None
    raise InputError(f"{path}: the rows of channel {label} do not stand together; sort them by channel")


def breaks_by_blank(rows: list[str]) -> list[int]:
    """Return the rows of numbers before which there are more blank lines than before each of them."""
    # Most files have none, and a million rows are searched in no time before they are counted.
    if "" not in map(str.strip, rows):
        return []
    gaps, gap = [], 0
    for row in rows:
        bare = row.strip()
        if not bare:
            gap += 1
        elif not bare.startswith("#"):
            gaps.append(gap)
            gap = 0
    # Blank lines after every row come from line ends that were doubled, and part nothing.
    usual = min(gaps[1:], default=0)
    return [k for k, blank in enumerate(gaps) if k and blank > usual]


def tell_jumps(where: str, xy: np.ndarray, first: int, line_number: Callable[[int], int]) -> None:
    """Warn of a line that jumps, as where several rivers were read as one.

    Args:
        where: File and channel.
        xy: (n, 2) points.
        first: Its first row of numbers.
        line_number: Returns the number in the file of the line that holds a row of numbers.
    """
    if len(xy) < POINTS:
        return
    step = np.hypot(*np.diff(xy, axis=0).T)
    usual = float(np.median(step))
    far = np.flatnonzero(step > JUMP * usual) if usual > 0.0 else np.empty(0, int)
    if len(far):
        k = int(far[step[far].argmax()])
        more = f" ({len(far)} jumps in all)" if len(far) > 1 else ""
        begin, end = line_number(first + k), line_number(first + k + 1)
        warn(
            f"{where}: from line {begin} to {end} it jumps {step[k] / usual:.3g} times its usual spacing{more}; if "
            "several rivers follow one another there, part them by blank lines or a column channel"
        )
