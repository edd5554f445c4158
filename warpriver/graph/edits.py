"""Edits of a network's graph: a channel that meets another joins it there; what is left without water disappears.

One edit serves the three cases of [Paris2023, Sec. 6.2]: the *minor* channel ends at a new junction on the *main* one,
its remaining part is abandoned, and the junction that it used to reach is dissolved.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from warpriver.channel_table import ChannelTable
from warpriver.errors import InputError
from warpriver.hydraulic_geometry import DEPTH_BY_WIDTH, DISCHARGE_BY_AREA, WIDTH_BY_FLOW
from warpriver.network import RiverNetwork

__all__ = ["EditedChannels", "NetworkEdit", "Rejoin", "check_forest"]

# A new junction keeps this many points from both ends of the main channel, so that its parts are channels themselves.
JUNCTION_CLEARANCE = 2


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
            "MeanderParams(collision_distance=0) to let every channel migrate for itself"
        )
    below = np.full(network.node_count, -1)
    below[head] = foot
    # Doubling: after k rounds each node looks 2^k nodes down; what still sees water after all nodes goes in a circle.
    for _ in range(network.node_count.bit_length() + 1):
        below = np.where(below >= 0, below[below], -1)
    if (below >= 0).any():
        c = int(lines[below[head] >= 0][0])
        raise InputError(f"channel {c} belongs to a circle or flows into one; reverse or remove a channel of it")


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
        channels: Their table; of what no edit computes, each channel has what the one had that it goes by.
        node_xy: (N, 2) positions of their nodes in m, absolute.
        channel_changed: (C,) True where the points are not those of the channel before.
        run_begin: (R,) first point, before, of each run of consecutive points that the new order is made of.
        run_start: (R + 1,) offsets of the runs in the new order.
        run_scale: (R, 2) factors of width and depth, or None where they are constant along each channel.
        loops: (first point, number of points) of loops among the step's oxbows that follow the runs as new channels.
    """

    channel_old: np.ndarray
    channel_start: np.ndarray
    channels: ChannelTable
    node_xy: np.ndarray
    channel_changed: np.ndarray
    run_begin: np.ndarray
    run_start: np.ndarray
    run_scale: np.ndarray | None
    loops: tuple[tuple[int, int], ...] = ()


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

    Every channel takes part in one edit at most: what comes later in the same round is looked for again. An edit costs
    what it touches and the way down from there, not the size of the network.
    """

    def __init__(self, network: RiverNetwork):
        """Take the graph and the flow of a network; only what an edit touches is taken apart."""
        self.network = network
        self._start = network.starts()
        self._flow = network.channel_flow()
        self._arrivals = np.bincount(network.channel_to, minlength=network.node_count)
        arriving = np.bincount(network.channel_to, weights=self._flow, minlength=network.node_count)
        self._supply = self._flow - arriving[network.channel_from]
        self._by_foot = np.argsort(network.channel_to, kind="stable")
        self._foot_start = np.concatenate([[0], np.cumsum(self._arrivals)])
        self._by_head = np.full(network.node_count, -1)
        self._by_head[network.channel_from] = np.arange(network.channel_count)
        # What differs from the network: channels looked at, or made; arrivals at nodes; the channel that leaves one.
        self._parts: dict[int, _Part] = {}
        self._into: dict[int, list[int]] = {}
        self._out: dict[int, int] = {}
        self._node_point: dict[int, int] = {}
        self._part_count = network.channel_count
        self._next_identity = int(network.channel_id.max()) + 1 if network.channel_count else 0
        self._touched: set[int] = set()
        self._abandoned: list[tuple[int, int, int]] = []

    # ---- the graph as it is now

    def _part(self, c: int) -> _Part:
        if c not in self._parts:
            net = self.network
            self._parts[c] = _Part(
                int(self._start[c]), int(self._start[c + 1]), c, -1, int(net.channel_from[c]), int(net.channel_to[c]),
                float(self._supply[c]), int(net.channel_id[c]),
            )  # fmt: skip
        return self._parts[c]

    def _below(self, c: int) -> int:
        """Node at the lower end of a part."""
        return self._parts[c].below if c in self._parts else int(self.network.channel_to[c])

    def _above(self, c: int) -> int:
        """Node at the upper end of a part; edits do not change it."""
        return self._parts[c].above if c in self._parts else int(self.network.channel_from[c])

    def _arriving(self, node: int) -> list[int]:
        """Parts that end at a node."""
        if node in self._into:
            return self._into[node]
        if node >= self.network.node_count:
            return []
        return self._by_foot[self._foot_start[node] : self._foot_start[node + 1]].tolist()

    def _leaving(self, node: int) -> int:
        """Part that begins at a node, -1 if none."""
        if node in self._out:
            return self._out[node]
        return int(self._by_head[node]) if node < self.network.node_count else -1

    # ---- one edit

    def rejoin(self, a: int, point_a: int, b: int, point_b: int) -> Rejoin | None:
        """Let two channels that touch join there; None where that is impossible or one was edited in this round.

        Args:
            a: Channel.
            point_a: Its point that touches, in the old order.
            b: The other channel.
            point_b: Its point.
        """
        if a in self._touched or b in self._touched:
            return None
        kind, main, minor, at_main, at_minor = self._roles(a, point_a, b, point_b)
        whole, other = self._part(main), self._part(minor)
        if whole.count < 2 * JUNCTION_CLEARANCE + 1:
            return None
        neighbours = {c for n in (other.below, whole.below, whole.above, other.above) for c in self._arriving(n)}
        neighbours |= {self._leaving(n) for n in (other.below, whole.below)} - {-1}
        if neighbours & self._touched:
            return None
        self._touched |= neighbours | {main, minor}
        self._abandoned = []
        at_main = min(max(at_main, whole.first + JUNCTION_CLEARANCE), whole.stop - 1 - JUNCTION_CLEARANCE)
        old_node, is_source = other.below, not self._arriving(other.above)
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
        if self._below(a) == self._above(b):
            return "downstream", b, a, point_b, point_a
        if self._below(b) == self._above(a):
            return "downstream", a, b, point_a, point_b
        flow = self._flow
        a_is_main = flow[a] > flow[b] or (flow[a] == flow[b] and a < b)
        # A channel that flows into the other one cannot receive it: the lower one keeps its course.
        if a_is_main and self._reaches(a, b):
            a_is_main = False
        elif not a_is_main and self._reaches(b, a):
            a_is_main = True
        kind = "upstream" if self._below(a) == self._below(b) else "disconnected"
        if a_is_main:
            return kind, a, b, point_a, point_b
        return kind, b, a, point_b, point_a

    def _reaches(self, upper: int, lower: int) -> bool:
        """Tell whether the water of one channel flows through the other."""
        here = self._leaving(self._below(upper))
        while here >= 0 and here != lower:
            here = self._leaving(self._below(here))
        return here == lower

    def _join(self, minor: int, at_minor: int, main: int, at_main: int) -> None:
        """Split the main channel, end the minor one at the new node, abandon its rest."""
        whole, other = self._part(main), self._part(minor)
        node = self.network.node_count + len(self._node_point)
        self._node_point[node] = at_main
        share, kept = self._share_above(whole, at_main), self._share_above(other, at_minor)
        index, self._part_count = self._part_count, self._part_count + 1
        self._parts[index] = _Part(
            at_main, whole.stop, whole.old, whole.tip, node, whole.below,
            (1.0 - share) * whole.supply + (1.0 - kept) * other.supply, self._next_identity,
        )  # fmt: skip
        self._next_identity += 1
        self._into[whole.below] = [index if c == main else c for c in self._arriving(whole.below)]
        self._into[other.below] = [c for c in self._arriving(other.below) if c != minor]
        self._abandoned.append((at_minor, other.stop, other.identity))
        whole.stop, whole.tip, whole.below, whole.supply = at_main + 1, -1, node, share * whole.supply
        other.stop, other.tip, other.below, other.supply = at_minor + 1, at_main, node, kept * other.supply
        self._into[node] = [main, minor]
        self._out[node] = index

    def _share_above(self, part: _Part, point: int) -> float:
        """Share of a channel's own ground that drains to it above a point: by length, but all of it for a source.

        The catchment of a source lies about and above its head; shared out by length, it would dwindle with every
        junction that climbs it.
        """
        if not self._arriving(part.above):
            return 1.0
        return (point - part.first) / max(part.count - 1, 1)

    def _drop(self, channel: int, heir: int) -> None:
        """Take a channel out; the ground that it drained goes to another."""
        part = self._part(channel)
        part.alive = False
        self._part(heir).supply += part.supply
        self._into[part.below] = [c for c in self._arriving(part.below) if c != channel]
        self._out[part.above] = -1
        self._abandoned.append((part.first, part.stop, part.identity))

    def _settle(self, node: int, heir: int) -> None:
        """Let what lies below a node without water fall dry, down to where water arrives."""
        while self._leaving(node) >= 0 and not self._arriving(node):
            dry = self._leaving(node)
            if dry == heir:  # the upper part of the main channel: its supply goes on with the part below
                heir = self._leaving(self._part(dry).below)
            self._drop(dry, heir)
            node = self._part(dry).below

    # ---- the new network

    def build(self) -> EditedChannels:
        """Return the channels after the edits, and where their points come from."""
        old, flow = self.network, self._flows()
        chains = self._chains()
        dead = [c for c, part in self._parts.items() if not part.alive]
        inner = [c for chain in chains for c in chain[1:]]
        head = np.ones(self._part_count, bool)
        head[dead + inner] = False
        heads = np.flatnonzero(head)
        chain_of = {chain[0]: chain for chain in chains}
        special = [c for c in sorted({*self._parts, *chain_of}) if head[c]]
        runs, run_part, run_rank = self._runs(heads, special, chain_of)
        length = runs[:, 1] - runs[:, 0]
        run_gain = flow[run_part] / self._flow[self._old_of(run_part)]
        last = heads.copy()
        last[np.searchsorted(heads, list(chain_of))] = [chain[-1] for chain in chain_of.values()]
        base = self._old_of(last)
        gain = flow[last] / self._flow[base]
        table = old.channels.take(base)
        area = table.drainage_area
        # What adds up at junctions is the area where it is known of all channels, else the discharge.
        by_area = old.channels.drainage_area is not None and bool(np.isfinite(old.channels.drainage_area).all())
        above, below, node_xy = self._nodes(heads, last)
        changed = np.zeros(len(heads), bool)
        changed[np.searchsorted(heads, special)] = [self._is_changed(c, chain_of) for c in special]
        identity = np.zeros(self._part_count, np.int64)
        identity[: old.channel_count] = old.channel_id
        for c, part in self._parts.items():
            identity[c] = part.identity
        counts = np.bincount(run_rank, weights=length, minlength=len(heads)).astype(np.int64)
        return EditedChannels(
            channel_old=base,
            channel_start=np.concatenate([[0], np.cumsum(counts)]),
            channels=table.replace(
                id=identity[heads],
                width=table.width * gain**WIDTH_BY_FLOW,
                depth=table.depth * gain ** (WIDTH_BY_FLOW * DEPTH_BY_WIDTH),
                discharge=table.discharge * (gain**DISCHARGE_BY_AREA if by_area else gain),
                drainage_area=None if area is None else area * (gain if by_area else gain ** (1.0 / DISCHARGE_BY_AREA)),
                slope=self._slopes(heads, chains),
                from_node=above,
                to_node=below,
            ),
            node_xy=node_xy,
            channel_changed=changed,
            run_begin=runs[:, 0],
            run_start=np.concatenate([[0], np.cumsum(length)]),
            run_scale=None if old.point_section is None else _section_gain(run_gain),
        )

    def _old_of(self, parts: np.ndarray) -> np.ndarray:
        """Channel, before, that each part is or was part of."""
        old = parts.copy()
        made = np.flatnonzero(parts >= self.network.channel_count)
        old[made] = [self._parts[c].old for c in parts[made].tolist()]
        return old

    def _is_changed(self, c: int, chain_of: dict[int, list[int]]) -> bool:
        """Tell whether a channel's points are not those that it had."""
        part = self._part(c)
        same = part.tip < 0 and part.first == self._start[part.old] and part.stop == self._start[part.old + 1]
        return c in chain_of or not same

    def _runs(
        self, heads: np.ndarray, special: list[int], chain_of: dict[int, list[int]]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Runs (first, stop) of old points that the new order is made of, their parts, the ranks of their channels."""
        plain = np.flatnonzero(~np.isin(heads, special))
        runs = [np.stack([self._start[heads[plain]], self._start[heads[plain] + 1]], axis=1)]
        parts, ranks = [heads[plain]], [plain]
        for rank, c in zip(np.searchsorted(heads, special).tolist(), special, strict=True):
            for k, member in enumerate(chain_of.get(c, [c])):
                part = self._part(member)
                # The first point of a further part is the last of the one before.
                pieces = [(part.first + (k > 0), part.stop)] + [(part.tip, part.tip + 1)] * (part.tip >= 0)
                runs.append(np.array(pieces))
                parts.append(np.full(len(pieces), member))
                ranks.append(np.full(len(pieces), rank))
        rank = np.concatenate(ranks)
        order = np.argsort(rank, kind="stable")
        return np.concatenate(runs)[order], np.concatenate(parts)[order], rank[order]

    def _slopes(self, heads: np.ndarray, chains: list[list[int]]) -> np.ndarray:
        """Slope of each channel: that of the old one; where parts become one, the drop of all over their length."""
        old = self.network.channel_slope
        slope = old[self._old_of(heads)]
        for chain in chains:
            parts = [self._part(c) for c in chain]
            lines = [self.network.point_xy[p.first : p.stop].numpy().astype(np.float64) for p in parts]
            length = [np.hypot(*np.diff(line, axis=0).T).sum() for line in lines]
            slope[np.searchsorted(heads, chain[0])] = np.average(old[[p.old for p in parts]], weights=length)
        return slope

    def _nodes(self, heads: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes above and below each channel, numbered anew, and their positions."""
        old = self.network
        ends = np.zeros((self._part_count, 2), np.int64)
        ends[: old.channel_count] = np.stack([old.channel_from, old.channel_to], axis=1)
        for c, part in self._parts.items():
            ends[c] = part.above, part.below
        nodes, label = np.unique(np.concatenate([ends[heads, 0], ends[last, 1]]), return_inverse=True)
        known = nodes < old.node_count
        xy = np.empty((len(nodes), 2))
        xy[known] = old.node_xy[nodes[known]]
        made = [self._node_point[n] for n in nodes[~known].tolist()]
        # Few points: on a GPU they are read one by one rather than with all others.
        points = [old.point_xy[i : i + 1].numpy()[0].astype(np.float64) for i in made]
        xy[~known] = np.reshape(points, (-1, 2)) + old.origin
        return label[: len(heads)], label[len(heads) :], xy

    def _flows(self) -> np.ndarray:
        """Flow at the lower end of every part: its own supply and all that arrives above it.

        Only what was edited and what lies below it is added up again.
        """
        flow = np.zeros(self._part_count)
        flow[: self.network.channel_count] = self._flow
        affected: set[int] = set()
        changed = [c for c, part in self._parts.items() if part.alive]
        for c in changed + [self._leaving(node) for node in self._into]:
            while c >= 0 and c not in affected:
                affected.add(c)
                c = self._leaving(self._below(c))
        count = {c: sum(a in affected for a in self._arriving(self._above(c))) for c in affected}
        ready = sorted(c for c in affected if count[c] == 0)
        while ready:
            c = ready.pop()
            part = self._parts.get(c)
            supply, old = (part.supply, part.old) if part else (float(self._supply[c]), c)
            total = supply + sum(float(flow[a]) for a in self._arriving(self._above(c)))
            # A network given with less flow below a junction than above it must still not run dry.
            flow[c] = max(total, 1e-6 * float(self._flow[old]))
            below = self._leaving(self._below(c))
            if below >= 0:
                count[below] -= 1
                if count[below] == 0:
                    ready.append(below)
        return flow

    def _chains(self) -> list[list[int]]:
        """Parts that follow each other without a junction: a node that an edit left one arrival joins two parts."""
        following = {}
        for node, arriving in self._into.items():
            if len(arriving) == 1 and self._leaving(node) >= 0 and self._was_junction(node):
                following[arriving[0]] = self._leaving(node)
        chains = []
        for c in sorted(following.keys() - following.values()):
            chain = [c]
            while chain[-1] in following:
                chain.append(following[chain[-1]])
            chains.append(chain)
        return chains

    def _was_junction(self, node: int) -> bool:
        """Tell whether more than one channel reached a node before the edits, or an edit made it."""
        return node >= self.network.node_count or bool(self._arrivals[node] > 1)


def _section_gain(flow_gain: np.ndarray) -> np.ndarray:
    """Factors of width and depth, (n, 2), where the flow changes by those factors."""
    width_gain = flow_gain**WIDTH_BY_FLOW
    return np.stack([width_gain, width_gain**DEPTH_BY_WIDTH], axis=1)
