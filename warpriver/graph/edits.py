"""Edits of a network's graph: a channel that meets another joins it there; what is left without water disappears.

One edit serves all cases of [Paris2023, Sec. 6.2]: the *minor* channel ends at a new junction on the *main* one, its
remaining course is abandoned, and the junction that it used to reach dissolves if fewer than two channels still meet
there.

**Identities** stay with the downstream end of a channel. Where a junction splits the main channel, the downstream piece
keeps its identity; where a junction dissolves, the two channels become one with the identity of the downstream one. A
junction that moves is both at once, and no identity is lost: its tributaries end elsewhere, and the channel that they
flow into begins elsewhere. An upstream piece gets a new identity only if that of the channel it was cut from is still
in use.

**Flow** is added up again along the whole way downstream of an edit. Width, depth, discharge and area follow from its
change. A channel of several pieces takes them from the channel whose flow was nearest to what it carries now.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from warpriver.channel_table import JOINT_LOCK, JOINT_NONE, JOINT_THROUGH, ChannelTable
from warpriver.graph.forest import leaving_channels
from warpriver.hydraulic_geometry import DEPTH_BY_WIDTH, DISCHARGE_BY_AREA, WIDTH_BY_FLOW
from warpriver.network import RiverNetwork

__all__ = ["EditedChannels", "NetworkEdit", "Refusal", "Rejoin", "valid_joints"]

# A new junction keeps this many points from both ends of the main channel, so that its pieces are channels themselves.
JUNCTION_CLEARANCE = 2


@dataclasses.dataclass(frozen=True)
class Rejoin:
    """What one edit did.

    Attributes:
        kind: "upstream", "downstream", "neck" or "disconnected"; see :class:`~warpriver.history.events.Collision`.
            "cutoff": a neck across nodes that are nothing but through nodes of one river.
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
class Refusal:
    """An edit that was not done, because a locked point would have gone with it.

    Attributes:
        kind: As in :class:`Rejoin`.
        minor: Identity of the channel that would have given way.
        main: Identity of the other one.
        node: Node of the locked point.
    """

    kind: str
    minor: int
    main: int
    node: int


@dataclasses.dataclass(frozen=True)
class EditedChannels:
    """The channels of a network after edits.

    Attributes:
        channel_old: (C,) index of the channel, before, whose identity each has, or from which it was cut.
        channel_start: (C + 1,) offsets of their points.
        channels: Their table; of what no edit computes, each channel has what ``channel_old`` had.
        node_xy: (N, 2) positions of their nodes in m, absolute.
        channel_changed: (C,) True where the points are not those of the channel before.
        run_begin: (R,) first point, before, of each run of consecutive points that the new order is made of.
        run_start: (R + 1,) offsets of the runs in the new order.
        run_scale: (R, 2) factors of width and depth, or None where they are constant along each channel.
        loops: (first point, number of points) of loops among the step's oxbows that follow the runs as new channels.
        drawn_xy: (M, 2) points that were not there before, m, absolute, or None; in the runs they are numbered from the
            number of points before on.
        drawn_section: (M, 2) their widths and depths, or None where these are constant along each channel.
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
    drawn_xy: np.ndarray | None = None
    drawn_section: np.ndarray | None = None


@dataclasses.dataclass
class _Piece:
    """A run of old points that is a channel or a piece of one.

    Attributes:
        first, stop: Its points, in the old order.
        tip: Point that follows the last one, in the old order; -1 if none.
        source: Channel, before, that the points are of.
        head, end: Node at the upstream and at the downstream end.
        supply: Flow that does not come from upstream.
        alive: Whether water still flows through it.
    """

    first: int
    stop: int
    tip: int
    source: int
    head: int
    end: int
    supply: float
    alive: bool = True

    @property
    def count(self) -> int:
        return self.stop - self.first


class NetworkEdit:
    """A network being edited; :meth:`rejoin` any number of times, then :meth:`build` the new one.

    Every channel takes part in one edit at most: what comes later in the same round is looked for again. An edit costs
    what it touches and the way downstream from there, not the size of the network.
    """

    def __init__(self, network: RiverNetwork, next_identity: int = 0):
        """Take the graph and the flow of a network; only what an edit touches is taken apart.

        Args:
            network: The network.
            next_identity: Least identity that a new channel may get; by default the first beyond those in use.
        """
        self.network = network
        self._next_identity = max(next_identity, int(network.channel_id.max()) + 1)
        self._start = network.starts()
        self._flow = network.channel_flow()
        self._arrivals = np.bincount(network.channel_to, minlength=network.node_count)
        arriving = np.bincount(network.channel_to, weights=self._flow, minlength=network.node_count)
        self._supply = self._flow - arriving[network.channel_from]
        self._by_end = np.argsort(network.channel_to, kind="stable")
        self._end_start = np.concatenate([[0], np.cumsum(self._arrivals)])
        self._by_head = leaving_channels(network)
        # What differs from the network: channels looked at, under their index, or cut off, under further numbers;
        # arrivals at nodes; the channel that leaves one.
        self._pieces: dict[int, _Piece] = {}
        self._into: dict[int, list[int]] = {}
        self._out: dict[int, int] = {}
        # New nodes by the point where they are, and those of them at which nothing joins.
        self._node_point: dict[int, int] = {}
        self._plain_nodes: set[int] = set()
        self._piece_count = network.channel_count
        self._touched: set[int] = set()
        self._abandoned: list[tuple[int, int, int]] = []
        # Edits that would have dropped a locked point.
        self.refused: list[Refusal] = []

    # ---- the graph as it is now

    def _piece(self, c: int) -> _Piece:
        if c not in self._pieces:
            net, first, stop = self.network, int(self._start[c]), int(self._start[c + 1])
            head, end = int(net.channel_from[c]), int(net.channel_to[c])
            self._pieces[c] = _Piece(first, stop, -1, c, head, end, float(self._supply[c]))
        return self._pieces[c]

    def _end(self, c: int) -> int:
        """Node at the downstream end of a piece."""
        return self._pieces[c].end if c in self._pieces else int(self.network.channel_to[c])

    def _head(self, c: int) -> int:
        """Node at the upstream end of a piece."""
        return self._pieces[c].head if c in self._pieces else int(self.network.channel_from[c])

    def _source(self, c: int) -> int:
        """Channel, before, that a piece is of."""
        return self._pieces[c].source if c in self._pieces else c

    def _arriving(self, node: int) -> list[int]:
        """Pieces that end at a node."""
        if node in self._into:
            return self._into[node]
        if node >= self.network.node_count:
            return []
        arriving: list[int] = self._by_end[self._end_start[node] : self._end_start[node + 1]].tolist()
        return arriving

    def _leaving(self, node: int) -> int:
        """Piece that begins at a node, -1 if none."""
        if node in self._out:
            return self._out[node]
        return int(self._by_head[node]) if node < self.network.node_count else -1

    def _way(self, upper: int, lower: int) -> list[int]:
        """Pieces from one down to the last before another; none where its water does not get there."""
        way = [upper]
        while (following := self._leaving(self._end(way[-1]))) != lower:
            if following < 0:
                return []
            way.append(following)
        return way

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
        kind, main, minor, way = self._roles(a, b)
        whole, other = self._piece(main), self._piece(minor)
        if whole.count < 2 * JUNCTION_CLEARANCE + 1:
            return None
        neighbours = {c for n in (other.end, whole.end, whole.head, other.head) for c in self._arriving(n)}
        neighbours |= {self._leaving(n) for n in (other.end, whole.end)} - {-1}
        if neighbours & self._touched:
            return None
        if (held := self._dropped_lock(minor, main)) >= 0:
            identity = self.network.channel_id
            self.refused.append(Refusal(kind, int(identity[minor]), int(identity[main]), held))
            return None
        self._touched |= neighbours | {main, minor}
        self._abandoned = []
        at_main, at_minor = (point_a, point_b) if main == a else (point_b, point_a)
        old_node, is_source = other.end, not self._arriving(other.head)
        # The only water of the main channel does not vanish into it.
        alone = bool(way) and all(len(self._arriving(self._end(c))) == 1 for c in way)
        if at_minor - other.first < 2 and is_source and not alone:
            self._drop(minor, main)
            junction = -1
        else:
            junction = min(max(at_main, whole.first + JUNCTION_CLEARANCE), whole.stop - 1 - JUNCTION_CLEARANCE)
            node = self._join(minor, max(at_minor, other.first + 1), main, junction)
            if alone:
                self._plain_nodes.add(node)
        self._settle(old_node, main)
        identity = self.network.channel_id
        return Rejoin(kind, int(identity[minor]), int(identity[main]), junction, tuple(self._abandoned))

    def _roles(self, a: int, b: int) -> tuple[str, int, int, list[int]]:
        """Kind of a collision, the main and the minor channel, and the way from the minor down to the main one."""
        # A channel that flows into the other one cannot receive it: the lower one keeps its course.
        for minor, main in ((a, b), (b, a)):
            if way := self._way(minor, main):
                stem = all(self._largest_arriving(self._end(c)) == c for c in way)
                through = all(self.network.channel_joint[self._source(c)] == JOINT_THROUGH for c in way)
                return "cutoff" if through else "neck" if stem else "downstream", main, minor, way
        kind = "upstream" if self._end(a) == self._end(b) else "disconnected"
        minor, main = sorted((a, b), key=self._rank)
        return kind, main, minor, []

    def _dropped_lock(self, minor: int, main: int) -> int:
        """Node of the locked point that would go if a channel ended on the main one; -1 if none would."""
        joint, dry = self.network.channel_joint, minor
        while dry >= 0 and dry != main:
            node = self._end(dry)
            if joint[self._source(dry)] == JOINT_LOCK:
                return node
            if any(c != dry for c in self._arriving(node)):
                return -1
            dry = self._leaving(node)
        return -1

    def _rank(self, c: int) -> tuple[float, int]:
        """Order of channels that meet: by flow, and the first of equal ones."""
        return float(self._flow[self._source(c)]), -c

    def _largest_arriving(self, node: int) -> int:
        return max(self._arriving(node), key=self._rank)

    def _join(self, minor: int, at_minor: int, main: int, at_main: int) -> int:
        """Split the main channel at a new node, end the minor one there, abandon its rest; return the node."""
        lower, other = self._piece(main), self._piece(minor)
        node = self.network.node_count + len(self._node_point)
        self._node_point[node] = at_main
        fraction, kept = self._fraction_above(lower, at_main), self._fraction_above(other, at_minor)
        upper, self._piece_count = self._piece_count, self._piece_count + 1
        self._touched.add(upper)
        self._pieces[upper] = _Piece(
            lower.first, at_main + 1, -1, lower.source, lower.head, node, fraction * lower.supply
        )  # fmt: skip
        self._out[lower.head] = upper
        self._into[other.end] = [c for c in self._arriving(other.end) if c != minor]
        self._abandoned.append((at_minor, other.stop, int(self.network.channel_id[other.source])))
        lower.first, lower.head = at_main, node
        lower.supply = (1.0 - fraction) * lower.supply + (1.0 - kept) * other.supply
        other.stop, other.tip, other.end, other.supply = at_minor + 1, at_main, node, kept * other.supply
        self._into[node] = [upper, minor]
        self._out[node] = main
        return node

    def _fraction_above(self, piece: _Piece, point: int) -> float:
        """Fraction of a channel's own ground that drains to it above a point: by length, but all of it for a source.

        The catchment of a source lies about and above its head; divided by length, it would dwindle with every junction
        that climbs it.
        """
        if not self._arriving(piece.head):
            return 1.0
        return (point - piece.first) / max(piece.count - 1, 1)

    def _drop(self, channel: int, heir: int) -> None:
        """Take a piece out; the ground that it drained goes to another."""
        piece = self._piece(channel)
        piece.alive = False
        self._piece(heir).supply += piece.supply
        self._into[piece.end] = [c for c in self._arriving(piece.end) if c != channel]
        self._out[piece.head] = -1
        self._abandoned.append((piece.first, piece.stop, int(self.network.channel_id[piece.source])))

    def _settle(self, node: int, heir: int) -> None:
        """Let what lies downstream of a node without water fall dry, down to where water arrives."""
        while (dry := self._leaving(node)) >= 0 and not self._arriving(node):
            self._drop(dry, heir)
            node = self._piece(dry).end

    # ---- the new network

    def build(self) -> EditedChannels:
        """Return the channels after the edits, and where their points come from."""
        old, flow, groups = self.network, self._flows(), self._groups()
        place, first, last = self._places(groups)
        edited = np.searchsorted(place, list(groups))
        source = np.where(place < old.channel_count, place, self._sources(first))
        # The channels that width, depth, discharge and area are taken from.
        model = source.copy()
        model[edited] = [self._model(group, flow[group[-1]]) for group in groups.values()]
        gain = flow[last] / self._flow[model]
        area = old.channel_drainage_area
        # What adds up at junctions is the area where it is known of all channels, else the discharge.
        by_area = area is not None and bool(np.isfinite(area).all())
        identity = np.concatenate([old.channel_id, self._next_identity + np.arange(self._piece_count)])
        head, end, node_xy = self._nodes(first, last)
        runs, run_piece, run_rank = self._runs(place, groups)
        length = runs[:, 1] - runs[:, 0]
        changed = np.zeros(len(place), bool)
        changed[edited] = [self._is_changed(c, group) for c, group in groups.items()]
        counts = np.bincount(run_rank, weights=length, minlength=len(place)).astype(np.int64)
        run_gain = flow[run_piece] / self._flow[self._sources(run_piece)]
        return EditedChannels(
            channel_old=source,
            channel_start=np.concatenate([[0], np.cumsum(counts)]),
            channels=old.channels.take(source).replace(
                id=identity[place],
                width=old.channel_width[model] * gain**WIDTH_BY_FLOW,
                depth=old.channel_depth[model] * gain ** (WIDTH_BY_FLOW * DEPTH_BY_WIDTH),
                discharge=old.channel_discharge[model] * (gain**DISCHARGE_BY_AREA if by_area else gain),
                drainage_area=None
                if area is None
                else area[model] * gain ** (1.0 if by_area else 1.0 / DISCHARGE_BY_AREA),
                slope=self._slopes(source, edited, groups),
                joint=valid_joints(old.channel_joint[self._sources(last)], head, end),
                from_node=head,
                to_node=end,
            ),
            node_xy=node_xy,
            channel_changed=changed,
            run_begin=runs[:, 0],
            run_start=np.concatenate([[0], np.cumsum(length)]),
            run_scale=None if old.point_section is None else _section_gain(run_gain),
        )

    def _groups(self) -> dict[int, list[int]]:
        """Channels that were looked at, by their place: the pieces of each in downstream order.

        A channel has the place of the channel before whose identity it has; new ones come last.
        """
        chains, count = self._chains(), self.network.channel_count
        chained = {c for chain in chains for c in chain}
        chains += [[c] for c, piece in sorted(self._pieces.items()) if piece.alive and c not in chained]
        named = [max((k for k, c in enumerate(chain) if c < count), default=-1) for chain in chains]
        groups = {chain[k]: chain for chain, k in zip(chains, named, strict=True) if k >= 0}
        added = count
        for chain in (chain for chain, k in zip(chains, named, strict=True) if k < 0):
            place = self._source(chain[0])
            if place in groups:
                place, added = added, added + 1
            groups[place] = chain
        return groups

    def _places(self, groups: dict[int, list[int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places of all channels in order, and the first and the last piece of each."""
        kept = np.ones(self.network.channel_count, bool)
        kept[[c for c in (*self._pieces, *(c for group in groups.values() for c in group)) if c < len(kept)]] = False
        place = np.sort(np.concatenate([np.flatnonzero(kept), np.array(list(groups), np.int64)]))
        first, last = place.copy(), place.copy()
        edited = np.searchsorted(place, list(groups))
        first[edited] = [group[0] for group in groups.values()]
        last[edited] = [group[-1] for group in groups.values()]
        return place, first, last

    def _sources(self, pieces: np.ndarray) -> np.ndarray:
        """Channel, before, that each piece is of."""
        source = pieces.copy()
        cut = np.flatnonzero(pieces >= self.network.channel_count)
        source[cut] = [self._source(c) for c in pieces[cut].tolist()]
        return source

    def _model(self, group: list[int], flow: float) -> int:
        """Source of a channel's pieces whose flow was nearest to what the channel carries now; the last of equals."""
        return min((self._source(c) for c in reversed(group)), key=lambda c: abs(math.log(flow / self._flow[c])))

    def _is_changed(self, place: int, group: list[int]) -> bool:
        """Tell whether a channel's points are not those of the channel before at its place."""
        piece = self._piece(group[0])
        if len(group) > 1 or piece.tip >= 0 or place >= self.network.channel_count:
            return True
        return (piece.first, piece.stop) != (self._start[place], self._start[place + 1])

    def _runs(self, place: np.ndarray, groups: dict[int, list[int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Runs (first, stop) of old points that the new order is made of, their pieces, the ranks of their channels."""
        plain = np.flatnonzero(~np.isin(place, list(groups)))
        runs = [np.stack([self._start[place[plain]], self._start[place[plain] + 1]], axis=1)]
        pieces, ranks = [place[plain]], [plain]
        for rank, group in zip(np.searchsorted(place, list(groups)).tolist(), groups.values(), strict=True):
            for k, c in enumerate(group):
                piece = self._piece(c)
                # The first point of a further piece is the last of the one before.
                found = [(piece.first + (k > 0), piece.stop)] + [(piece.tip, piece.tip + 1)] * (piece.tip >= 0)
                runs.append(np.array(found))
                pieces.append(np.full(len(found), c))
                ranks.append(np.full(len(found), rank))
        rank = np.concatenate(ranks)
        order = np.argsort(rank, kind="stable")
        return np.concatenate(runs)[order], np.concatenate(pieces)[order], rank[order]

    def _slopes(self, source: np.ndarray, edited: np.ndarray, groups: dict[int, list[int]]) -> np.ndarray:
        """Slope of each channel: that of the old one; where several become one, the drop of all over their length."""
        old = self.network.channel_slope
        slope: np.ndarray = old[source]
        for rank, group in zip(edited.tolist(), groups.values(), strict=True):
            if len(group) > 1:
                pieces = [self._piece(c) for c in group]
                lines = [self.network.point_xy[p.first : p.stop].numpy().astype(np.float64) for p in pieces]
                length = [np.hypot(*np.diff(line, axis=0).T).sum() for line in lines]
                slope[rank] = np.average(old[[p.source for p in pieces]], weights=length)
        return slope

    def _nodes(self, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes at the head and the end of each channel, numbered anew, and their positions."""
        old = self.network
        ends = np.zeros((self._piece_count, 2), np.int64)
        ends[: old.channel_count] = np.stack([old.channel_from, old.channel_to], axis=1)
        for c, piece in self._pieces.items():
            ends[c] = piece.head, piece.end
        nodes, label = np.unique(np.concatenate([ends[first, 0], ends[last, 1]]), return_inverse=True)
        known = nodes < old.node_count
        xy = np.empty((len(nodes), 2))
        xy[known] = old.node_xy[nodes[known]]
        made = [self._node_point[n] for n in nodes[~known].tolist()]
        # Few points: on a GPU they are read one by one rather than with all others.
        points = [old.point_xy[i : i + 1].numpy()[0].astype(np.float64) for i in made]
        xy[~known] = np.reshape(points, (-1, 2)) + old.origin
        return label[: len(first)], label[len(first) :], xy

    def _flows(self) -> np.ndarray:
        """Flow at the downstream end of every piece: its own supply and all that arrives at its head.

        Only what was edited and what lies downstream of it is added up again.
        """
        flow = np.zeros(self._piece_count)
        flow[: self.network.channel_count] = self._flow
        affected: set[int] = set()
        changed = [c for c, piece in self._pieces.items() if piece.alive]
        for c in changed + [self._leaving(node) for node in self._into]:
            while c >= 0 and c not in affected:
                affected.add(c)
                c = self._leaving(self._end(c))
        count = {c: sum(a in affected for a in self._arriving(self._head(c))) for c in affected}
        ready = sorted(c for c in affected if count[c] == 0)
        while ready:
            c = ready.pop()
            piece = self._pieces.get(c)
            supply = piece.supply if piece else float(self._supply[c])
            total = supply + sum(float(flow[a]) for a in self._arriving(self._head(c)))
            # A network given with less flow downstream of a junction than above it must still not run dry.
            flow[c] = max(total, 1e-6 * float(self._flow[self._source(c)]))
            following = self._leaving(self._end(c))
            if following >= 0:
                count[following] -= 1
                if count[following] == 0:
                    ready.append(following)
        return flow

    def _chains(self) -> list[list[int]]:
        """Pieces that follow each other where a junction was: a node that an edit left one arrival joins two."""
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
        """Tell whether more than one channel reached a node before the edits, or an edit let two meet there."""
        return bool(self._arrivals[node] > 1) if node < self.network.node_count else node not in self._plain_nodes


def valid_joints(joint: np.ndarray, head: np.ndarray, foot: np.ndarray) -> np.ndarray:
    """Return joints at the feet of channels where one channel ends and one begins, 0 elsewhere.

    Args:
        joint: (C,) what they would be.
        head: (C,) nodes at the heads of the channels.
        foot: (C,) those at their feet.
    """
    count = int(max(head.max(), foot.max())) + 1
    one = (np.bincount(foot, minlength=count) == 1) & (np.bincount(head, minlength=count) == 1)
    return np.where(one[foot], joint, JOINT_NONE)


def _section_gain(flow_gain: np.ndarray) -> np.ndarray:
    """Factors of width and depth, (n, 2), where the flow changes by those factors."""
    width_gain = flow_gain**WIDTH_BY_FLOW
    return np.stack([width_gain, width_gain**DEPTH_BY_WIDTH], axis=1)
