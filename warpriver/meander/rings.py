"""Rings that necks split in two, where both parts go on."""

from __future__ import annotations

import numpy as np

from warpriver.meander.topology import EditedChannels
from warpriver.network import RiverNetwork

__all__ = ["split_rings"]


def split_rings(network: RiverNetwork, cut: np.ndarray, loop_xy: np.ndarray) -> EditedChannels:
    """Make channels of loops that were cut off rings: what is left of a ring keeps its place, its loops come last.

    A loop becomes a ring of its parent's width, depth and discharge, with an identity of its own, the next
    that is free in the order of ``cut``, and a node of its own.

    Args:
        network: The network, the loops cut off.
        cut: (K, 3) int, for each loop its ring, and its first point and number of points among the loops' points.
        loop_xy: (M, 2) points of the step's loops, m, absolute.
    """
    parent, begin, count = (np.asarray(column, np.int64) for column in cut.T)
    channels, points = network.channel_count, network.point_count
    old = np.concatenate([np.arange(channels), parent])
    node = network.node_count + np.arange(len(parent))
    area = network.channel_drainage_area
    return EditedChannels(
        channel_old=old,
        channel_start=np.concatenate([network.starts(), points + np.cumsum(count)]),
        channel_id=np.concatenate([network.channel_id, network.channel_id.max() + 1 + np.arange(len(parent))]),
        channel_width=network.channel_width[old],
        channel_depth=network.channel_depth[old],
        channel_discharge=network.channel_discharge[old],
        channel_drainage_area=None if area is None else area[old],
        channel_nodes=(
            np.concatenate([network.channel_from, node]),
            np.concatenate([network.channel_to, node]),
            np.concatenate([network.node_xy, loop_xy[begin]]),
        ),
        channel_slope=network.channel_slope[old],
        channel_changed=np.arange(len(old)) >= channels,
        run_begin=np.array([0]),
        run_start=np.array([0, points]),
        run_scale=None if network.point_section is None else np.ones((1, 2)),
        loops=tuple(zip(begin.tolist(), count.tolist(), strict=True)),
    )
