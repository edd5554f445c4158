"""What was laid before, where only some channels of a riverscape are laid anew."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.network import RiverNetwork
from warpriver.riverscape.profiles import Graph
from warpriver.riverscape.stations import Stations

__all__ = ["Before", "Profile"]


class Profile(NamedTuple):
    """The water along the axes, without steps.

    Attributes:
        start: (C + 1,) offsets of the channels.
        level: (Q,) m.
    """

    start: IndexArray
    level: FloatArray

    def with_channels_of(self, other: Profile, changed: FlagArray) -> Profile:
        """Return this profile, with some channels those of another."""
        parts = [
            (other if changed[c] else self).of(c)  # by channel
            for c in range(len(changed))
        ]
        return Profile(np.concatenate([[0], np.cumsum([len(part) for part in parts])]), np.concatenate(parts))

    def of(self, channel: int) -> FloatArray:
        """Return the levels of a channel."""
        return self.level[self.start[channel] : self.start[channel + 1]]


class Before(NamedTuple):
    """What was laid before, where only some channels are laid anew.

    Attributes:
        stations: As they were.
        profile: As it was.
        changed: (C,) channels that are laid anew.
        redrawn: (C,) those of them whose lines are other ones.
        leveled: (C,) those of them whose water may lie elsewhere than before.
        free: (N,) nodes whose level may change; the others keep theirs.
    """

    stations: Stations
    profile: Profile
    changed: FlagArray
    redrawn: FlagArray
    leveled: FlagArray
    free: FlagArray

    def directions(self, network: RiverNetwork) -> FloatArray:
        """Directions in which redrawn channels leave and reach nodes where others meet them, (C, 2, 2); NaN: any."""
        found = np.full((len(self.changed), 2, 2), np.nan)
        meeting = np.bincount(np.concatenate([network.channel_from, network.channel_to]), minlength=network.node_count)
        before = self.stations
        first, last = before.start[:-1], before.start[1:] - 1
        for end, station, node in ((0, first, network.channel_from), (1, last, network.channel_to)):
            shared = self.redrawn & (meeting[node] > 1)
            main = np.unique(before.channel, return_index=True)[1]
            found[shared, end] = before.tangent[station[main][shared]]
        return found

    def levels(self, z: FloatArray, graph: Graph) -> FloatArray:
        """Water along the axes that keeps to the levels of nodes that may not change; it falls as before."""
        before, first, last = self.stations, graph.start[:-1], graph.start[1:] - 1
        main = np.unique(before.channel, return_index=True)[1]
        known = np.full(graph.nodes, np.nan)
        known[graph.above] = before.water[before.start[:-1][main]]
        known[graph.below] = before.water[before.start[1:][main] - 1]
        level = np.full(graph.nodes, np.nan)
        level[graph.above], level[graph.below] = z[first], z[last]
        low = np.where(self.free, -np.inf, known)
        high = np.where(self.free, np.inf, known)
        rounds = graph.rounds()
        for ready in rounds:
            np.minimum.at(high, graph.below[ready], high[graph.above[ready]])
        for ready in rounds[::-1]:
            np.maximum.at(low, graph.above[ready], low[graph.below[ready]])
        level = np.where(self.free, np.clip(level, low, high), known)
        out = np.clip(z, level[graph.below][graph.channel], level[graph.above][graph.channel])
        out[first], out[last] = level[graph.above], level[graph.below]
        for c in np.flatnonzero(self.changed & ~self.leveled).tolist():
            out[graph.start[c] : graph.start[c + 1]] = self.profile.of(c)
        return out
