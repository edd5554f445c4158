"""Snapshot: a network between two steps, to be put back when an edit of it is taken back."""

from __future__ import annotations

import dataclasses

import numpy as np

from warpriver.channel_table import ChannelTable

__all__ = ["Snapshot"]


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """A network between two steps, and what the state holds beside it, on the host.

    Attributes:
        point_xy: (P, 2) m, relative to the origin, in the precision of the device.
        point_section: (P, 2) width and depth in m, or None.
        channel_start: (C + 1,) int32.
        channels: The table of the channels.
        node_xy: (N, 2) m, absolute.
        channel_length: (C,) length of the channels at the last edit, m.
        saved: What ``State.saved`` gave.
    """

    point_xy: np.ndarray
    point_section: np.ndarray | None
    channel_start: np.ndarray
    channels: ChannelTable
    node_xy: np.ndarray
    channel_length: np.ndarray
    saved: dict[str, np.ndarray]
