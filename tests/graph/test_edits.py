"""Edits of a network's graph, held against taking the whole graph apart and building it anew."""

import dataclasses
import itertools

import numpy as np
import pytest
from trees import random_tree

from warpriver import RiverNetwork
from warpriver.graph.edits import NetworkEdit

# Sums of some ten flows in another order.
FLOW_TOLERANCE = 1e-12
# Points that a new junction keeps from both ends of the main channel.
CLEARANCE = 2


@dataclasses.dataclass
class Reach:
    """A channel or a part of one, with all its points in the old order."""

    points: list
    above: int
    below: int
    supply: float
    name: int
    old: int
    is_source: bool


class PlainEdit:
    """The same edits on a dictionary of reaches; every question is answered by looking at all of them."""

    def __init__(self, network):
        self.network = network
        start, self.flow_before = network.starts(), network.channel_flow()
        above, below = network.channel_from, network.channel_to
        self.reaches = {}
        for c in range(network.channel_count):
            above_it = np.flatnonzero(below == above[c])
            self.reaches[c] = Reach(
                points=list(range(start[c], start[c + 1])),
                above=int(above[c]),
                below=int(below[c]),
                supply=self.flow_before[c] - self.flow_before[above_it].sum(),
                name=int(network.channel_id[c]),
                old=c,
                is_source=len(above_it) == 0,
            )
        self.junctions = {n for n in range(network.node_count) if (below == n).sum() > 1}
        self.places = dict(enumerate(network.node_xy))
        self.touched, self.created = set(), 0

    def into(self, node):
        return [c for c, reach in self.reaches.items() if reach.below == node]

    def out_of(self, node):
        return next((c for c, reach in self.reaches.items() if reach.above == node), None)

    def course(self, c):
        """Reaches that the water of a reach flows through, itself first."""
        found = [c]
        while (c := self.out_of(self.reaches[c].below)) is not None:
            found.append(c)
        return found

    def rejoin(self, a, point_a, b, point_b):
        """Kind, names of minor and main, junction and the points left behind by name; None where it is impossible."""
        if a in self.touched or b in self.touched:
            return None
        at = {a: point_a, b: point_b}
        if b in self.course(a)[1:2] or a in self.course(b)[1:2]:
            kind, main = "downstream", b if b in self.course(a)[1:2] else a
        else:
            kind = "upstream" if self.reaches[a].below == self.reaches[b].below else "disconnected"
            main = min((a, b), key=lambda c: (-self.flow_before[c], c))
            if b in self.course(a):
                main = b
            elif a in self.course(b):
                main = a
        minor = b if main == a else a
        whole, other = self.reaches[main], self.reaches[minor]
        if len(whole.points) < 2 * CLEARANCE + 1:
            return None
        nodes = {whole.above, whole.below, other.above, other.below}
        near = {c for n in nodes for c in self.into(n)} | {self.out_of(whole.below), self.out_of(other.below)} - {None}
        if near & self.touched:
            return None
        self.touched |= near | {a, b}
        self.left = []
        names = (other.name, whole.name)
        first = other.points[0]
        junction = min(max(at[main], whole.points[CLEARANCE]), whole.points[-1 - CLEARANCE])
        if other.is_source and at[minor] - first < 2:
            junction = -1
            self.remove(minor, main)
        else:
            self.connect(minor, max(at[minor], first + 1), main, junction)
        self.dry_out(main)
        return kind, *names, junction, sorted(self.left)

    def connect(self, minor, at_minor, main, junction):
        """The main reach becomes two, and the minor one ends between them."""
        whole, other = self.reaches[main], self.reaches[minor]
        node = self.network.node_count + self.created
        self.places[node] = self.network.points()[junction]
        self.junctions.add(node)
        share = {}
        for reach, point in ((whole, junction), (other, at_minor)):
            part = reach.points.index(point) / (len(reach.points) - 1)
            share[reach.name] = 1.0 if reach.is_source else part
        self.left.append((other.name, [p for p in other.points if p >= at_minor]))
        new = max(self.reaches.keys() | self.touched | {self.network.channel_count + self.created - 1}) + 1
        self.reaches[new] = Reach(
            points=[p for p in whole.points if p >= junction],
            above=node,
            below=whole.below,
            supply=(1.0 - share[whole.name]) * whole.supply + (1.0 - share[other.name]) * other.supply,
            name=int(self.network.channel_id.max()) + 1 + self.created,
            old=whole.old,
            is_source=False,
        )
        self.created += 1
        whole.points, other.points = (
            [p for p in whole.points if p <= junction],
            [p for p in other.points if p <= at_minor] + [junction],
        )
        whole.below = other.below = node
        whole.supply *= share[whole.name]
        other.supply *= share[other.name]

    def remove(self, c, heir):
        gone = self.reaches.pop(c)
        self.reaches[heir].supply += gone.supply
        self.left.append((gone.name, gone.points))

    def dry_out(self, main):
        """Take away, one after the other, every reach that is no source and gets no water; the main river inherits."""
        while dry := [c for c, reach in self.reaches.items() if not reach.is_source and not self.into(reach.above)]:
            heir = main if main in self.reaches and main not in dry else self.course(dry[0])[-1]
            if main in dry:
                heir = self.course(main)[1]
            self.remove(dry[0], heir)
            main = heir

    def build(self):
        """Reaches in order, those joined at nodes that are no junction any more: a list of (members, points)."""
        flow = {}
        while len(flow) < len(self.reaches):
            for c, reach in self.reaches.items():
                if c not in flow and all(a in flow for a in self.into(reach.above)):
                    flow[c] = reach.supply + sum(flow[a] for a in self.into(reach.above))
        after = {}
        for node in self.junctions:
            if len(self.into(node)) == 1 and self.out_of(node) is not None:
                after[self.into(node)[0]] = self.out_of(node)
        channels, xy = [], self.network.points()
        for c in sorted(self.reaches.keys() - after.values()):
            members, points = [c], list(self.reaches[c].points)
            while members[-1] in after:
                members.append(after[members[-1]])
                following = self.reaches[members[-1]].points
                assert (xy[following[0]] == xy[points[-1]]).all(), "pieces meet"
                points += following[1:]
            channels.append((members, points))
        return channels, flow


def forest(seed, kind):
    """A random forest in random order, some channels cut in two where nothing joins; some have sections by point."""
    rng = np.random.default_rng(seed)
    lines, widths, areas = [], [], []
    for k in range(int(rng.integers(1, 4))):
        tree = random_tree(1000 * seed + k, sources=int(rng.integers(2, 8)), size=3000.0)
        given = zip(tree.polylines(), tree.channel_width, tree.channel_drainage_area, strict=True)
        for xy, width, area in given:
            pieces = [xy + [20_000.0 * k, 0.0]]
            if rng.random() < 0.25 and len(xy) > 12:
                middle = int(rng.integers(4, len(xy) - 4))
                pieces = [pieces[0][: middle + 1], pieces[0][middle:]]
            lines += pieces
            widths += [width] * len(pieces)
            areas += [area] * len(pieces)
    order = rng.permutation(len(lines))
    lines, widths = [lines[c] for c in order], [float(widths[c]) for c in order]
    areas = np.array(areas)[order]
    if kind == "sections":
        widths = [w * rng.uniform(0.8, 1.2, len(xy)) for w, xy in zip(widths, lines, strict=True)]
    if kind == "discharge":
        return RiverNetwork.from_polylines(lines, width=widths, discharge=areas / 1e6)
    return RiverNetwork.from_polylines(lines, width=widths, drainage_area=areas)


def random_place(rng, network, c):
    """A point of a channel, often one near its ends."""
    first, stop = network.starts()[c : c + 2].tolist()
    edge = int(rng.integers(0, 3))
    return int(rng.choice([min(first + edge, stop - 1), max(stop - 1 - edge, first), rng.integers(first, stop)]))


def expanded(edited):
    """Index, before, of every point in the new order."""
    length = np.diff(edited.run_start)
    return [int(b) + k for b, n in zip(edited.run_begin, length, strict=True) for k in range(n)]


def assert_same_network(network, edited, plain):
    """Channels, nodes, flows and points are those of the plain edit."""
    channels, flow = plain.build()
    start, before = network.starts(), plain.flow_before
    assert split_by(expanded(edited), edited.channel_start) == [points for _, points in channels]
    assert edited.channels.id.tolist() == [plain.reaches[members[0]].name for members, _ in channels]
    last = [plain.reaches[members[-1]] for members, _ in channels]
    base = [reach.old for reach in last]
    assert edited.channel_old.tolist() == base
    changed = [points != list(range(start[c], start[c + 1])) for c, (_, points) in zip(base, channels, strict=True)]
    assert edited.channel_changed.tolist() == changed
    after = np.array([flow[members[-1]] for members, _ in channels])
    gain = after / before[base]
    area = network.channel_drainage_area
    if area is None:
        assert edited.channels.drainage_area is None
        np.testing.assert_allclose(edited.channels.discharge, after, rtol=FLOW_TOLERANCE)
    else:
        np.testing.assert_allclose(edited.channels.drainage_area, after, rtol=FLOW_TOLERANCE)
        expected = network.channel_discharge[base] * gain**0.69
        np.testing.assert_allclose(edited.channels.discharge, expected, rtol=FLOW_TOLERANCE)
    np.testing.assert_allclose(edited.channels.width, network.channel_width[base] * gain**0.5, rtol=FLOW_TOLERANCE)
    depth = network.channel_depth[base] * gain ** (0.5 / 1.41)
    np.testing.assert_allclose(edited.channels.depth, depth, rtol=FLOW_TOLERANCE)
    above, below, xy = edited.channels.from_node, edited.channels.to_node, edited.node_xy
    ends = [(plain.reaches[members[0]].above, reach.below) for (members, _), reach in zip(channels, last, strict=True)]
    nodes = sorted({n for pair in ends for n in pair})
    assert [(nodes[a], nodes[b]) for a, b in zip(above, below, strict=True)] == ends
    np.testing.assert_allclose(xy, [plain.places[n] for n in nodes], rtol=0.0, atol=1e-9)
    if network.point_section is None:
        assert edited.run_scale is None
        return
    factor = []
    for members, _ in channels:
        for k, c in enumerate(members):
            ratio = flow[c] / before[plain.reaches[c].old]
            factor += [(ratio**0.5, ratio ** (0.5 / 1.41))] * (len(plain.reaches[c].points) - (k > 0))
    np.testing.assert_allclose(np.repeat(edited.run_scale, np.diff(edited.run_start), axis=0), factor, rtol=1e-11)


def split_by(values, start):
    return [values[a:b] for a, b in itertools.pairwise(start.tolist())]


@pytest.mark.parametrize("kind", ["area", "discharge", "sections"])
def test_edits_are_those_of_building_the_graph_anew(kind):
    """Random forests, random sequences of edits, the network compared after every one of them."""
    seen, joined = [], 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        network = forest(seed, kind)
        edit, plain = NetworkEdit(network), PlainEdit(network)
        for _ in range(int(rng.integers(1, 12))):
            if network.channel_count < 2:
                break
            a, b = rng.choice(network.channel_count, 2, replace=False).tolist()
            places = random_place(rng, network, a), random_place(rng, network, b)
            done = edit.rejoin(a, places[0], b, places[1])
            expected = plain.rejoin(a, places[0], b, places[1])
            assert (done is None) == (expected is None)
            if done is None:
                continue
            left = sorted((name, list(range(first, stop))) for first, stop, name in done.abandoned)
            assert (done.kind, done.minor, done.main, done.junction, left) == expected
            seen.append(done.kind if done.junction >= 0 else "vanished")
            assert_same_network(network, edit.build(), plain)
        joined += len(plain.build()[0]) < network.channel_count + plain.created
    assert {kind: seen.count(kind) > 3 for kind in ("upstream", "downstream", "disconnected", "vanished")} == {
        kind: True for kind in ("upstream", "downstream", "disconnected", "vanished")
    }
    assert joined > 10, "channels dissolve and are joined to others"


def test_without_edits_the_network_is_as_it_was():
    for kind in ("area", "discharge", "sections"):
        network = forest(3, kind)
        edited = NetworkEdit(network).build()
        assert not edited.channel_changed.any()
        assert expanded(edited) == list(range(network.point_count))
        assert edited.channel_old.tolist() == list(range(network.channel_count))
        np.testing.assert_array_equal(edited.channels.width, network.channel_width)
        np.testing.assert_array_equal(edited.channel_start, network.starts())
        assert edited.channels == network.channels
        np.testing.assert_array_equal(edited.node_xy, network.node_xy)


def test_what_an_edit_does_not_reach_keeps_its_bits():
    """Flow, width and depth of channels upstream of an edit, and of other trees, are not even rounded anew."""
    for seed in range(20):
        network = forest(seed, "area")
        rng = np.random.default_rng(seed)
        edit, plain = NetworkEdit(network), PlainEdit(network)
        a, b = rng.choice(network.channel_count, 2, replace=False).tolist()
        places = random_place(rng, network, a), random_place(rng, network, b)
        below = {*plain.course(a), *plain.course(b)}
        if edit.rejoin(a, places[0], b, places[1]) is None:
            continue
        edited = edit.build()
        far = ~np.isin(edited.channel_old, list(below)) & ~edited.channel_changed
        same = edited.channel_old[far]
        assert far.any() or len(below) == network.channel_count
        np.testing.assert_array_equal(edited.channels.drainage_area[far], network.channel_drainage_area[same])
        np.testing.assert_array_equal(edited.channels.width[far], network.channel_width[same])
        np.testing.assert_array_equal(edited.channels.depth[far], network.channel_depth[same])
