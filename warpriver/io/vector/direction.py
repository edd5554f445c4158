"""Whether lines run downstream: what the shape of a network and its elevations say of it."""

from __future__ import annotations

import numpy as np

from warpriver.errors import warn
from warpriver.network import RiverNetwork

__all__ = ["tell_direction"]

# Rivers part now and then; where they part so many times as often as they meet, their lines run the other way.
FORKS = 3
# Lines of this fraction of the length that climb are drawn upstream; fewer may be noise of elevations.
CLIMBING = 0.8


def tell_direction(network: RiverNetwork, label: str) -> None:
    """Warn of lines that seem to run upstream.

    Args:
        network: The channels as they were read.
        label: What to call the files.
    """
    lines = np.flatnonzero(~network.channel_closed)
    leaving = np.bincount(network.channel_from[lines], minlength=network.node_count)
    arriving = np.bincount(network.channel_to[lines], minlength=network.node_count)
    forks, joints = int((leaving > 1).sum()), int((arriving > 1).sum())
    sinks = np.flatnonzero((arriving > 2) & (leaving == 0))
    climbing = _climbing(network)
    if forks and forks >= FORKS * joints:
        told = f"lines part at {forks} node{'s' * (forks > 1)} and meet at {joints}, as lines that run upstream do"
        advice = "lines run downstream here: pass reverse=True, or turn those that do not"
    elif climbing > CLIMBING:
        told = f"the elevations of {100.0 * climbing:.0f} % of the length rise from the first point to the last"
        advice = "lines run downstream here: pass reverse=True, or turn those that do not"
    elif len(sinks):
        x, y = network.node_xy[sinks[0]]
        told = f"{arriving[sinks[0]]} lines end at ({x:.6g}, {y:.6g}) and none begins there"
        advice = "if one of them runs upstream, turn it"
    else:
        return
    warn(f"{label}: {told}; {advice}")


def _climbing(network: RiverNetwork) -> float:
    """Return the fraction of the length whose lines end higher than they begin."""
    elevations = network.point_elevations()
    if elevations is None:
        return 0.0
    rises = np.array([z[-1] > z[0] for z in elevations]) & ~network.channel_closed
    length = network.channel_lengths()
    return float(length[rises].sum() / length.sum())
