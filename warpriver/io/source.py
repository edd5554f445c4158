"""What a file says of its channels, before any of it is checked, and the names under which files say it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["NAMES", "Line", "Source"]

# Columns and attributes by role, lower case; the first one that holds a value counts.
NAMES = {
    "x": ("x", "x_m", "easting", "east", "x_coord", "point_x"),
    "y": ("y", "y_m", "northing", "north", "y_coord", "point_y"),
    "lon": ("lon", "longitude", "long", "lng"),
    "lat": ("lat", "latitude"),
    "width": ("width", "width_m", "width1", "mean_width_m", "median_width_m"),
    "depth": ("depth", "depth_m"),
    "discharge": ("discharge", "discharge_m3s"),
    "channel": ("channel", "channel_id", "seg_id", "id"),
}


@dataclasses.dataclass
class Line:
    """One channel as the file has it; None for what the file does not say.

    Attributes:
        xy: (n, 2) points, in the unit of the file.
        where: File and channel, for messages.
        width: Bankfull width in m, one number or (n,).
        depth: Bankfull depth in m, one number or (n,).
        discharge: Bankfull discharge in m3/s.
    """

    xy: np.ndarray
    where: str
    width: Any = None
    depth: Any = None
    discharge: Any = None

    def map_points(self, change: Callable[[np.ndarray], np.ndarray]) -> None:
        """Apply ``change`` to every array that has one entry a point."""
        self.xy = change(self.xy)
        for name in ("width", "depth"):
            if np.ndim(getattr(self, name)):
                setattr(self, name, change(getattr(self, name)))


@dataclasses.dataclass
class Source:
    """The channels of one file, and what it says of their coordinates.

    Attributes:
        path: The file.
        lines: Its channels.
        crs: Its CRS, as ``crs_text`` gives it, or None.
        lonlat: Whether the coordinates are longitude and latitude by format or name.
    """

    path: Path
    lines: list[Line]
    crs: str | None
    lonlat: bool = False
