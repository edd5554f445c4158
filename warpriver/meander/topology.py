"""Edits of a network's graph: a channel that meets another joins it there; what is left without water disappears.

One edit serves the three cases of [Paris2023, Sec. 6.2]: the *minor* channel ends at a new junction on the *main* one,
its remaining part is abandoned, and the junction that it used to reach is dissolved.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict

import numpy as np

from warpriver.network import RiverNetwork

__all__ = ["EditedChannels", "NetworkEdit", "Rejoin", "check_forest"]

# A new junction keeps this many points from both ends of the main channel, so that its parts are channels themselves.
JUNCTION_CLEARANCE = 2

# w ~ a^0.5, phi ~ a^0.69 [Paris2023, Peytavie2019]; w = 18.8 d^1.41 [Konsoer2013]
WIDTH_EXPONENT, DISCHARGE_EXPONENT, DEPTH_EXPONENT = 0.5, 0.69, 1.0 / 1.41


def check_forest(network: RiverNetwork) -> None:
    """Raise ``ValueError`` for a graph that is no forest: channels that part, or that flow in a circle."""
    outgoing = np.bincount(network.channel_from, minlength=network.node_count)
    if (outgoing > 1).any():
        node = int(outgoing.argmax())
        c = np.flatnonzero(network.channel_from == node)[:2].tolist()
        x, y = network.node_xy[node]
        raise ValueError(
            f"channels {c[0]} and {c[1]} both begin at ({x:.6g}, {y:.6g}), where water would part; remove one, or set "
            "MeanderParams(collision_distance=0) to let every channel migrate for itself"
        )
    below = np.full(network.node_count, -1)
    below[network.channel_from] = network.channel_to
    # Doubling: after k rounds each node looks 2^k nodes down; what still sees water after all nodes goes in a circle.
    for _ in range(network.node_count.bit_length() + 1):
        below = np.where(below >= 0, below[below], -1)
    if (below >= 0).any():
        c = int(np.flatnonzero(below[network.channel_from] >= 0)[0])
        raise ValueError(f"channel {c} belongs to a circle or flows into one; reverse or remove a channel of it")


@dataclasses.dataclass(frozen=True)
class Rejoin:
    """What one edit did.

    Attributes:
        kind: "upstream", "downstream" or "disconnected".
        minor: Identity of the channel that gave way.
        main: Identity of the channel that kept its course.
        junction: Index of the point, in the old order, where they now meet; -1 if the minor one vanished whole.
        abandoned: (first, stop) ranges of points, in the old order, that no channel uses any more, with the identity of
            the channel that each belonged to.
    """

    kind: str
    minor: int
    main: int
    junction: int
    abandoned: tuple[tuple[int, int, int], ...]


@dataclasses.dataclass(frozen=True)
class EditedChannels:
    """The channels of a network after edits.

    Attributes:
        channel_old: (C,) index of the channel, before, that each goes by.
        channel_start: (C + 1,) offsets of their points.
        channel_id, channel_width, channel_depth, channel_discharge, channel_drainage_area, channel_slope,
            channel_nodes: As in :class:`~warpriver.network.RiverNetwork`.
        point_source: (P,) index of each point before.
        point_scale: (P, 2) factors of width and depth, or None where they are constant along each channel.
    """

    channel_old: np.ndarray
    channel_start: np.ndarray
    channel_id: np.ndarray
    channel_width: np.ndarray
    channel_depth: np.ndarray
    channel_discharge: np.ndarray
    channel_drainage_area: np.ndarray | None
    channel_nodes: tuple[np.ndarray, np.ndarray, np.ndarray]
    point_source: np.ndarray
    point_scale: np.ndarray | None
    channel_slope: np.ndarray


@dataclasses.dataclass
class _Part:
    """A run of old points that is, or is part of, a channel."""

    first: int
    stop: int
    old: int
    tip: int  # point that follows the last one, in the old order; -1 if none
    above: int
    below: int
    supply: float
    identity: int
    alive: bool = True

    @property
    def count(self) -> int:
        return self.stop - self.first


class NetworkEdit:
    """A network being edited; :meth:`rejoin` any number of times, then :meth:`build` the new one.

    Every channel takes part in one edit at most: what comes later in the same round is looked for again.
    """

    def __init__(self, network: RiverNetwork):
        """Take the graph and the flow of a network apart."""
        self.network = network
        start = network.starts().tolist()
        self._flow = network.channel_flow()
        self._arrivals = np.bincount(network.channel_to, minlength=network.node_count)
        above, below = network.channel_from.tolist(), network.channel_to.tolist()
        arriving = np.bincount(network.channel_to, weights=self._flow, minlength=network.node_count)
        supply = (self._flow - arriving[network.channel_from]).tolist()
        identity = network.channel_id.tolist()
        self.parts = [
            _Part(start[c], start[c + 1], c, -1, above[c], below[c], supply[c], identity[c])
            for c in range(network.channel_count)
        ]
        self.into: dict[int, list[int]] = defaultdict(list)
        self.out: dict[int, int] = {}
        for c, part in enumerate(self.parts):
            self.into[part.below].append(c)
            self.out[part.above] = c
        self.node_point: dict[int, int] = {}
        self.next_node = network.node_count
        self.next_identity = int(network.channel_id.max()) + 1 if network.channel_count else 0
        self.touched: set[int] = set()
        self._abandoned: list[tuple[int, int, int]] = []

    # ---- one edit

    def rejoin(self, a: int, point_a: int, b: int, point_b: int) -> Rejoin | None:
        """Let two channels that touch join there; None where that is impossible or one was edited in this round.

        Args:
            a: Channel.
            point_a: Its point that touches, in the old order.
            b: The other channel.
            point_b: Its point.
        """
        if a in self.touched or b in self.touched:
            return None
        kind, main, minor, at_main, at_minor = self._roles(a, point_a, b, point_b)
        whole, other = self.parts[main], self.parts[minor]
        if whole.count < 2 * JUNCTION_CLEARANCE + 1:
            return None
        neighbours = {
            *self.into[other.below],
            *self.into[whole.below],
            *self.into[whole.above],
            *self.into[other.above],
        }
        neighbours |= {self.out[n] for n in (other.below, whole.below) if n in self.out}
        if neighbours & self.touched:
            return None
        self.touched |= neighbours | {main, minor}
        self._abandoned = []
        at_main = min(max(at_main, whole.first + JUNCTION_CLEARANCE), whole.stop - 1 - JUNCTION_CLEARANCE)
        old_node, is_source = other.below, not self.into[other.above]
        if at_minor - other.first < 2 and is_source:
            self._drop(minor, main)
            junction = -1
        else:
            at_minor = max(at_minor, other.first + 1)
            self._join(minor, at_minor, main, at_main)
            junction = at_main
        self._settle(old_node, main)
        return Rejoin(kind, other.identity, whole.identity, junction, tuple(self._abandoned))

    def _roles(self, a: int, point_a: int, b: int, point_b: int) -> tuple[str, int, int, int, int]:
        """Kind of the collision, main and minor channel and their points."""
        part_a, part_b = self.parts[a], self.parts[b]
        if part_a.below == part_b.above:
            return "downstream", b, a, point_b, point_a
        if part_b.below == part_a.above:
            return "downstream", a, b, point_a, point_b
        flow = self._flow
        a_is_main = flow[a] > flow[b] or (flow[a] == flow[b] and a < b)
        # A channel that flows into the other one cannot receive it: the lower one keeps its course.
        if a_is_main and self._reaches(a, b):
            a_is_main = False
        elif not a_is_main and self._reaches(b, a):
            a_is_main = True
        kind = "upstream" if part_a.below == part_b.below else "disconnected"
        if a_is_main:
            return kind, a, b, point_a, point_b
        return kind, b, a, point_b, point_a

    def _reaches(self, upper: int, lower: int) -> bool:
        """Tell whether the water of one channel flows through the other."""
        here = upper
        while self.parts[here].below in self.out:
            here = self.out[self.parts[here].below]
            if here == lower:
                return True
        return False

    def _join(self, minor: int, at_minor: int, main: int, at_main: int) -> None:
        """Split the main channel, end the minor one at the new node, abandon its rest."""
        whole, other = self.parts[main], self.parts[minor]
        node, self.next_node = self.next_node, self.next_node + 1
        self.node_point[node] = at_main
        share, kept = self._share_above(whole, at_main), self._share_above(other, at_minor)
        lower = _Part(
            at_main, whole.stop, whole.old, whole.tip, node, whole.below,
            (1.0 - share) * whole.supply + (1.0 - kept) * other.supply, self.next_identity,
        )  # fmt: skip
        self.next_identity += 1
        self.parts.append(lower)
        index = len(self.parts) - 1
        self.into[whole.below] = [index if c == main else c for c in self.into[whole.below]]
        self.into[other.below] = [c for c in self.into[other.below] if c != minor]
        self._abandoned.append((at_minor, other.stop, other.identity))
        whole.stop, whole.tip, whole.below, whole.supply = at_main + 1, -1, node, share * whole.supply
        other.stop, other.tip, other.below, other.supply = at_minor + 1, at_main, node, kept * other.supply
        self.into[node] = [main, minor]
        self.out[node] = index

    def _share_above(self, part: _Part, point: int) -> float:
        """Share of a channel's own ground that drains to it above a point: by length, but all of it for a source.

        The catchment of a source lies about and above its head; shared out by length, it would dwindle with every
        junction that climbs it.
        """
        if not self.into[part.above]:
            return 1.0
        return (point - part.first) / max(part.count - 1, 1)

    def _drop(self, channel: int, heir: int) -> None:
        """Take a channel out; the ground that it drained goes to another."""
        part = self.parts[channel]
        part.alive = False
        self.parts[heir].supply += part.supply
        self.into[part.below] = [c for c in self.into[part.below] if c != channel]
        self.out.pop(part.above, None)
        self._abandoned.append((part.first, part.stop, part.identity))

    def _settle(self, node: int, heir: int) -> None:
        """Let what lies below a node without water fall dry, down to where water arrives."""
        while node in self.out and not self.into[node]:
            dry = self.out[node]
            if dry == heir:  # the upper part of the main channel: its supply goes on with the part below
                heir = self.out[self.parts[dry].below]
            self._drop(dry, heir)
            node = self.parts[dry].below

    # ---- the new network

    def build(self) -> EditedChannels:
        """Return the channels after the edits, and where their points come from."""
        old, flow, before = self.network, self._flows(), self._flow.tolist()
        chains = self._chains()
        ranges, scale, counts = [], [], []
        for chain in chains:
            points = 0
            for k, c in enumerate(chain):
                part = self.parts[c]
                # The first point of a further part is the last of the one before.
                ranges.append((part.first + (k > 0), part.stop))
                scale.append(flow[c] / before[part.old])
                if part.tip >= 0:
                    ranges.append((part.tip, part.tip + 1))
                    scale.append(scale[-1])
                points += part.count + (part.tip >= 0) - (k > 0)
            counts.append(points)
        length = np.array([stop - first for first, stop in ranges])
        begin = np.array([first for first, _ in ranges])
        source = np.arange(length.sum()) + np.repeat(begin - np.cumsum(length) + length, length)
        point_scale = None
        if old.point_section is not None:
            width_gain = np.repeat(scale, length) ** WIDTH_EXPONENT
            point_scale = np.stack([width_gain, width_gain**DEPTH_EXPONENT], axis=1)
        base = np.array([self.parts[chain[-1]].old for chain in chains])
        gain = np.array([flow[chain[-1]] for chain in chains]) / self._flow[base]
        area = old.channel_drainage_area
        return EditedChannels(
            channel_old=base,
            channel_start=np.concatenate([[0], np.cumsum(counts)]),
            channel_id=np.array([self.parts[chain[0]].identity for chain in chains]),
            channel_width=old.channel_width[base] * gain**WIDTH_EXPONENT,
            channel_depth=old.channel_depth[base] * gain ** (WIDTH_EXPONENT * DEPTH_EXPONENT),
            channel_discharge=old.channel_discharge[base] * (gain if area is None else gain**DISCHARGE_EXPONENT),
            channel_drainage_area=None if area is None else area[base] * gain,
            channel_nodes=self._nodes(chains),
            point_source=source,
            point_scale=point_scale,
            channel_slope=self._slopes(chains),
        )

    def _slopes(self, chains: list[list[int]]) -> np.ndarray:
        """Slope of each channel: that of the old one; where parts become one, the drop of all over their length."""
        old = self.network.channel_slope
        slope = old[[self.parts[chain[0]].old for chain in chains]]
        for k, chain in enumerate(chains):
            if len(chain) > 1:
                parts = [self.parts[c] for c in chain]
                own = old[[part.old for part in parts]]
                xy = self.network.point_xy.numpy()
                length = [np.hypot(*np.diff(xy[p.first : p.stop].astype(np.float64), axis=0).T).sum() for p in parts]
                slope[k] = np.average(own, weights=length)
        return slope

    def _nodes(self, chains: list[list[int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes above and below each channel, numbered anew, and their positions."""
        old = self.network
        above = [self.parts[chain[0]].above for chain in chains]
        below = [self.parts[chain[-1]].below for chain in chains]
        nodes, label = np.unique(above + below, return_inverse=True)
        known = nodes < old.node_count
        xy = np.empty((len(nodes), 2))
        xy[known] = old.node_xy[nodes[known]]
        made = [self.node_point[n] for n in nodes[~known].tolist()]
        xy[~known] = old.point_xy.numpy()[made].astype(np.float64) + old.origin
        return label[: len(chains)], label[len(chains) :], xy

    def _flows(self) -> list[float]:
        """Flow at the lower end of every part: its own supply and all that arrives above it."""
        flow = [0.0] * len(self.parts)
        waiting = [len(self.into[part.above]) for part in self.parts]
        ready = [c for c, part in enumerate(self.parts) if part.alive and waiting[c] == 0]
        while ready:
            c = ready.pop()
            part = self.parts[c]
            flow[c] += part.supply
            # A network given with less flow below a junction than above it must still not run dry.
            flow[c] = max(flow[c], 1e-6 * float(self._flow[part.old]))
            below = self.out.get(part.below)
            if below is not None:
                flow[below] += flow[c]
                waiting[below] -= 1
                if waiting[below] == 0:
                    ready.append(below)
        return flow

    def _chains(self) -> list[list[int]]:
        """Channels as lists of parts: a node that only one channel of an edit still reaches joins two parts."""
        passing = {n for n in self.out if len(self.into[n]) == 1 and self._was_junction(n)}
        chains = []
        for c, part in enumerate(self.parts):
            if not part.alive or part.above in passing:
                continue
            chain = [c]
            while self.parts[chain[-1]].below in passing:
                chain.append(self.out[self.parts[chain[-1]].below])
            chains.append(chain)
        return chains

    def _was_junction(self, node: int) -> bool:
        """Tell whether more than one channel reached a node before the edits, or an edit made it."""
        return node >= self.network.node_count or bool(self._arrivals[node] > 1)
