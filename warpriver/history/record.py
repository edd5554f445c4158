"""Record: the state of a network at one time, complete enough to go on from."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from warpriver.channel_table import ChannelTable
from warpriver.errors import InputError
from warpriver.network_checks import check_graph, check_packed

__all__ = ["Record", "check_record"]


@dataclasses.dataclass(frozen=True)
class Record:
    """The state of a network at one time, in the precision of the device, so that a run can go on from it.

    Attributes:
        step: Number of steps done.
        time: yr.
        events_before: Number of events up to this time.
        point_xy: (P, 2) m, relative to ``origin``.
        point_section: (P, 2) width and depth in m, or None where they are constant along each channel.
        channel_start: (C + 1,) int32.
        channels: The table of the channels.
        node_xy: (N, 2) m, absolute.
        resume: Arrays that whoever does the steps needs to go on, by names of its own.
    """

    step: int
    time: float
    events_before: int
    point_xy: np.ndarray
    point_section: np.ndarray | None
    channel_start: np.ndarray
    channels: ChannelTable
    node_xy: np.ndarray
    resume: Mapping[str, np.ndarray]

    @property
    def nbytes(self) -> int:
        """Memory of the arrays in bytes."""
        section = 0 if self.point_section is None else self.point_section.nbytes
        own = self.point_xy.nbytes + self.channel_start.nbytes + self.channels.nbytes + self.node_xy.nbytes
        return section + own + sum(array.nbytes for array in self.resume.values())

    @property
    def form(self) -> tuple[Any, ...]:
        """What all records of a history have in common, as their arrays are stored end to end."""
        return (
            self.point_xy.dtype,
            self.point_section is None,
            *((name, self.channels[name].dtype.kind) for name in self.channels),
            *((name, array.dtype, array.shape[1:]) for name, array in self.resume.items()),
        )


def check_record(record: Record) -> None:
    """Raise ``ValueError`` unless a record is that of a network: arrays that fit together, numbers that make sense."""
    where = f"record of step {record.step}"
    xy, start, section = record.point_xy, record.channel_start, record.point_section
    if not isinstance(record.step, int) or not isinstance(record.events_before, int):
        raise InputError(f"{where}: {record.events_before} events before it; these are no whole numbers")
    if record.step < 0 or record.events_before < 0 or not 0.0 <= record.time < np.inf:
        raise InputError(f"{where}: time {record.time}, {record.events_before} events before it")
    if xy.ndim != 2 or xy.shape[1] != 2 or xy.dtype.kind != "f" or start.ndim != 1 or start.dtype.kind != "i":
        raise InputError(f"{where}: points {xy.dtype} {xy.shape}, offsets {start.dtype} {start.shape}")
    check_packed(xy, start, len(record.channels))
    if start[-1] != len(xy):
        raise InputError(f"{where}: {len(xy)} points for channels that end at {start[-1]}")
    if not np.isfinite(xy).all() or not np.isfinite(record.node_xy).all():
        raise InputError(f"{where}: a position is not finite")
    if section is not None and (section.shape != xy.shape or not (np.isfinite(section) & (section > 0.0)).all()):
        raise InputError(f"{where}: widths and depths {section.shape} of {xy.shape} points, or one not positive")
    check_graph(record.channels, record.node_xy)
