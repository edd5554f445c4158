"""Forests: networks whose channels join downstream and never part."""

from __future__ import annotations

import numpy as np

from warpriver.errors import InputError
from warpriver.network import RiverNetwork

__all__ = ["check_forest", "leaving_channels"]


def leaving_channels(network: RiverNetwork) -> np.ndarray:
    """Return for each node of a forest the channel that begins there, -1 for none: (N,) int64."""
    leaving = np.full(network.node_count, -1)
    leaving[network.channel_from] = np.arange(network.channel_count)
    return leaving


def check_forest(network: RiverNetwork) -> None:
    """Raise ``ValueError`` for a graph that is no forest: channels that part, or that flow in a circle."""
    # The node of a ring is its own.
    lines = np.flatnonzero(~network.channel_closed)
    head, foot = network.channel_from[lines], network.channel_to[lines]
    outgoing = np.bincount(head, minlength=network.node_count)
    if (outgoing > 1).any():
        node = int(outgoing.argmax())
        c = np.flatnonzero(network.channel_from == node)[:2].tolist()
        x, y = network.node_xy[node]
        raise InputError(
            f"channels {c[0]} and {c[1]} both begin at ({x:.6g}, {y:.6g}), where water would part; remove one, or set "
            "MeanderParams(collision_distance=0) to let every channel migrate for itself; if the lines run upstream, "
            "read them with reverse=True"
        )
    downstream = np.full(network.node_count, -1)
    downstream[head] = foot
    # Doubling: after k rounds each node looks 2^k nodes down; what still sees water after all nodes goes in a circle.
    for _ in range(network.node_count.bit_length() + 1):
        downstream = np.where(downstream >= 0, downstream[downstream], -1)
    if (downstream >= 0).any():
        c = int(lines[downstream[head] >= 0][0])
        raise InputError(f"channel {c} belongs to a circle or flows into one; reverse or remove a channel of it")
