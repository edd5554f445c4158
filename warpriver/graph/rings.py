"""Rings that necks split in two, where both continue."""

from __future__ import annotations

import numpy as np

from warpriver.graph.edits import EditedChannels
from warpriver.network import RiverNetwork

__all__ = ["split_rings"]


def split_rings(network: RiverNetwork, cut: np.ndarray, loop_xy: np.ndarray, next_identity: int = 0) -> EditedChannels:
    """Make channels of loops that were cut off rings: what is left of a ring keeps its place, its loops come last.

    A loop becomes a ring with all that its parent has but an identity of its own, the next that is free in the order of
    ``cut``, and a node of its own.

    Args:
        network: The network, the loops cut off.
        cut: (K, 3) int, for each loop its ring, and its first point and number of points among the loops' points.
        loop_xy: (M, 2) points of the step's loops, m, absolute.
        next_identity: Least identity that a new ring may get; by default the first beyond those in use.
    """
    next_identity = max(next_identity, int(network.channel_id.max()) + 1)
    parent, begin, count = (np.asarray(column, np.int64) for column in cut.T)
    channels, points = network.channel_count, network.point_count
    old = np.concatenate([np.arange(channels), parent])
    node = network.node_count + np.arange(len(parent))
    table = network.channels.take(old)
    return EditedChannels(
        channel_old=old,
        channel_start=np.concatenate([network.starts(), points + np.cumsum(count)]),
        channels=table.replace(
            id=np.concatenate([network.channel_id, next_identity + np.arange(len(parent))]),
            from_node=np.concatenate([network.channel_from, node]),
            to_node=np.concatenate([network.channel_to, node]),
        ),
        node_xy=np.concatenate([network.node_xy, loop_xy[begin]]),
        channel_changed=np.arange(len(old)) >= channels,
        run_begin=np.array([0]),
        run_start=np.array([0, points]),
        run_scale=None if network.point_section is None else np.ones((1, 2)),
        loops=tuple(zip(begin.tolist(), count.tolist(), strict=True)),
    )
