"""What the plots of a page show: figures of the rivers over the run, of which every page is told those so far."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.metrics import wavelength
from warpriver.network import RiverNetwork

__all__ = ["FIGURES", "Series", "figures_of"]

# File of a session's folder that holds them.
FIGURES = "figures.json"
# What a row holds after step and time, and rows that are kept at most: of more, every other one is given up.
NAMES, ROWS = ("sinuosity", "cutoffs", "wavelength"), 600
Row = tuple[int, float, float | None, float | None, float | None]


def figures_of(network: RiverNetwork) -> tuple[float | None, float | None]:
    """Return the mean sinuosity of the channels, and the wavelength of the longest one in m; None for what is none."""
    if not network.channel_count:
        return None, None
    start, xy, lengths = network.starts(), network.points(), network.channel_lengths()
    longest = int(np.argmax(lengths))
    line = xy[start[longest] : start[longest + 1]]
    wave = wavelength(line, float(network.channel_width[longest])) if len(line) > 8 else math.nan
    chord = np.hypot(*(xy[start[1:] - 1] - xy[start[:-1]]).T)
    winding = (lengths / np.maximum(chord, 1e-300))[~network.channel_closed & (chord > 0.0)]
    return (float(winding.mean()) if len(winding) else None), (wave if math.isfinite(wave) else None)


class Series:
    """Figures by step: sinuosity, cutoffs and wavelength."""

    def __init__(self) -> None:
        self.rows: list[Row] = []

    def note(self, step: int, time: float, *values: float | None) -> None:
        """Add a row, in place of one of the same step."""
        self.rewind(step - 1)
        sinuosity, cutoffs, wave = values
        self.rows.append((step, time, sinuosity, cutoffs, wave))
        if len(self.rows) > ROWS:
            # The first one stays, and the last one.
            del self.rows[1:-1:2]

    def rewind(self, step: int) -> None:
        """Forget what came after a step."""
        while self.rows and self.rows[-1][0] > step:
            self.rows.pop()

    def told(self) -> dict[str, list[list[float]]]:
        """Return [time, value] of each figure, where it is known."""
        columns = dict(zip(NAMES, (2, 3, 4), strict=True))
        return {
            name: [[row[1], value] for row in self.rows if (value := row[k]) is not None] for name, k in columns.items()
        }

    def write(self, path: Path) -> None:
        """Write them to a file."""
        path.write_text(json.dumps(self.rows))

    def read(self, path: Path, step: int) -> None:
        """Take those up to a step from a file; one that is missing or no such file is passed over."""
        try:
            rows = [_row(row) for row in json.loads(path.read_text(encoding="utf-8"))]
        except (OSError, ValueError, TypeError, RecursionError):
            return
        if len(rows) <= ROWS and all(a[0] < b[0] for a, b in itertools.pairwise(rows)):
            self.rows = rows
            self.rewind(step)


def _row(told: Sequence[Any]) -> Row:
    step, time, *values = told
    if len(values) != len(NAMES) or not isinstance(step, int) or isinstance(step, bool):
        raise InputError("no row of figures")
    numbers = [None if value is None else float(value) for value in values]
    if not all(math.isfinite(value) for value in [float(time), *(v for v in numbers if v is not None)]):
        raise InputError("no number")
    return (step, float(time), numbers[0], numbers[1], numbers[2])
