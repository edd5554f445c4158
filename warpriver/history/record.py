"""Record: the state of a network at one time, complete enough to go on from."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from warpriver.channel_table import ChannelTable

__all__ = ["Record"]


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
