"""What a file says of its channels, before any of it is checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.io.vector.attributes import GENERIC, NO_VALUE, Family

__all__ = ["Line", "Source", "checked_points"]


@dataclasses.dataclass
class Line:
    """One channel as the file has it; None for what the file does not say.

    Attributes:
        xy: (n, 2) points, in the unit of the file.
        where: File and channel, for messages.
        feature: Number of the feature it is, or is a part of.
        width: Bankfull width in m, one number or (n,).
        depth: Bankfull depth in m, one number or (n,).
        discharge: Bankfull discharge in m3/s, or the long-term mean.
        mean_flow: Whether the discharge is a long-term mean.
        mean_width, mean_depth: That of the channel as a whole, where it is stated beside those of the points.
        drainage_area: Drainage area at the downstream end, m2.
        slope: Drop over length, m/m.
        channel_id: Identity.
        next_down: Identities of the channels downstream; those that are none are left in.
        from_node, to_node: Nodes above and below, as the file names them.
        closed: Not 0 for a ring.
        joint: 1 or 2 where its lower end is a through node or a locked point.
        z: (n,) elevation of the points, m.
        extra: What it has of free columns, by name.
        lists: Which of width and depth come from a list that is stated downstream, however the points run.
    """

    xy: np.ndarray
    where: str
    feature: int = 0
    width: Any = None
    depth: Any = None
    discharge: Any = None
    mean_flow: bool = False
    mean_width: float | None = None
    mean_depth: float | None = None
    drainage_area: float | None = None
    slope: float | None = None
    channel_id: int | None = None
    next_down: tuple[int, ...] | None = None
    from_node: int | None = None
    to_node: int | None = None
    closed: float | None = None
    joint: float | None = None
    z: np.ndarray | None = None
    extra: dict[str, Any] = dataclasses.field(default_factory=dict)
    lists: tuple[str, ...] = ()

    def reverse(self) -> None:
        """Let the points run the other way, and what goes with them."""
        kept = {name: getattr(self, name) for name in self.lists}
        self.map_points(lambda a: a[::-1].copy())
        # That of the lower end is not known any more.
        self.joint = None
        for name, value in kept.items():
            setattr(self, name, value)

    def map_points(self, change: Callable[[np.ndarray], np.ndarray]) -> None:
        """Apply ``change`` to every array that has one entry a point."""
        self.xy = change(self.xy)
        for name in ("width", "depth", "z"):
            if np.ndim(getattr(self, name)):
                setattr(self, name, change(getattr(self, name)))


@dataclasses.dataclass
class Source:
    """The channels of one file, and what it says of their coordinates.

    Attributes:
        path: The file.
        lines: Its channels.
        crs: Its CRS in the words of the file, or None.
        lonlat: Whether the coordinates are longitude and latitude by format or name.
        family: Whose attributes it has.
        origin: (x, y) zero of the device coordinates, where the file states it.
        node_xy: Positions of nodes by the names that the file gives them, where it states them.
        extra: Names of the free columns that are read from it, each with its kind where the file states it.
        ours: Whether it comes from ``write_network``, also where a GIS has saved it since.
        crs_beside: Whether the CRS comes from a file beside it, such as a .prj, which ``crs=`` overrules.
    """

    path: Path
    lines: list[Line]
    crs: str | None
    lonlat: bool = False
    family: Family = GENERIC
    origin: tuple[float, float] | None = None
    node_xy: dict[int, tuple[float, float]] = dataclasses.field(default_factory=dict)
    extra: Mapping[str, str | None] = dataclasses.field(default_factory=dict)
    ours: bool = False
    crs_beside: bool = False

    def scale_place(self, factor: float) -> None:
        """Multiply all coordinates by a number, as to turn feet into metres."""
        if factor != 1.0:
            self.origin, self.node_xy = None, {}
            for line in self.lines:
                line.xy = factor * line.xy


def checked_points(xy: np.ndarray, where: str) -> np.ndarray:
    """Return (n, 2) points, or raise ``ValueError`` for one that is not finite or stands for no value."""
    wrong = ~np.isfinite(xy).all(axis=1)
    if wrong.any():
        raise InputError(f"{where}: point {int(wrong.argmax())} is not finite; remove or repair it")
    none = (xy[:, 0] == xy[:, 1]) & np.isin(xy[:, 0], NO_VALUE)
    if none.any():
        k = int(none.argmax())
        raise InputError(f"{where}: point {k} is at ({xy[k, 0]:g}, {xy[k, 1]:g}), which stands for no value; remove it")
    return xy
