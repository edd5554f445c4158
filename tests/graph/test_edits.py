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
    """A channel or a piece of one, with all its points in the old order; a piece cut off upstream has no name yet."""

    points: list
    above: int
    below: int
    supply: float
    name: int | None
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

    def larger(self, c):
        return self.flow_before[self.reaches[c].old], -c

    def kind_and_main(self, a, b):
        for upper, lower in ((a, b), (b, a)):
            if lower in (course := self.course(upper)):
                passed = [self.into(self.reaches[c].above) for c in course[1 : course.index(lower) + 1]]
                stem = all(max(ends, key=self.larger) in course for ends in passed)
                return "neck" if stem else "downstream", lower, all(len(ends) == 1 for ends in passed)
        kind = "upstream" if self.reaches[a].below == self.reaches[b].below else "disconnected"
        return kind, max((a, b), key=self.larger), False

    def rejoin(self, a, point_a, b, point_b):
        """Kind, names of minor and main, junction and the points left behind by name; None where it is impossible."""
        if a in self.touched or b in self.touched:
            return None
        at = {a: point_a, b: point_b}
        kind, main, alone = self.kind_and_main(a, b)
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
        if other.is_source and at[minor] - first < 2 and not alone:
            junction = -1
            self.remove(minor, main)
        else:
            self.connect(minor, max(at[minor], first + 1), main, junction, plain=alone)
        # Every reach that is no source and gets no water; the main river inherits.
        while dry := [c for c, reach in self.reaches.items() if not reach.is_source and not self.into(reach.above)]:
            self.remove(dry[0], main)
        return kind, *names, junction, sorted(self.left)

    def connect(self, minor, at_minor, main, junction, *, plain):
        """The main reach becomes two, and the minor one ends between them."""
        whole, other = self.reaches[main], self.reaches[minor]
        node = self.network.node_count + self.created
        self.places[node] = self.network.points()[junction]
        if not plain:
            self.junctions.add(node)
        share = {}
        for reach, point in ((whole, junction), (other, at_minor)):
            fraction = reach.points.index(point) / (len(reach.points) - 1)
            share[reach.name] = 1.0 if reach.is_source else fraction
        self.left.append((other.name, [p for p in other.points if p >= at_minor]))
        self.reaches[self.network.channel_count + self.created] = Reach(
            points=[p for p in whole.points if p <= junction],
            above=whole.above,
            below=node,
            supply=share[whole.name] * whole.supply,
            name=None,
            old=whole.old,
            is_source=whole.is_source,
        )
        self.created += 1
        whole.points, other.points = (
            [p for p in whole.points if p >= junction],
            [p for p in other.points if p <= at_minor] + [junction],
        )
        whole.above = other.below = node
        whole.supply = (1.0 - share[whole.name]) * whole.supply + (1.0 - share[other.name]) * other.supply
        other.supply *= share[other.name]
        whole.is_source = False

    def remove(self, c, heir):
        gone = self.reaches.pop(c)
        self.reaches[heir].supply += gone.supply
        self.left.append((int(self.network.channel_id[gone.old]), gone.points))

    def build(self):
        """Channels in order, those joined at nodes that are no junction any more: (place, members, points); flows."""
        flow = {}
        while len(flow) < len(self.reaches):
            for c, reach in self.reaches.items():
                if c not in flow and all(a in flow for a in self.into(reach.above)):
                    flow[c] = reach.supply + sum(flow[a] for a in self.into(reach.above))
        after = {}
        for node in self.junctions:
            if len(self.into(node)) == 1 and self.out_of(node) is not None:
                after[self.into(node)[0]] = self.out_of(node)
        channels, cut_off, xy = [], [], self.network.points()
        for c in sorted(self.reaches.keys() - after.values()):
            members, points = [c], list(self.reaches[c].points)
            while members[-1] in after:
                members.append(after[members[-1]])
                following = self.reaches[members[-1]].points
                assert (xy[following[0]] == xy[points[-1]]).all(), "pieces meet"
                points += following[1:]
            named = [m for m in members if self.reaches[m].name is not None]
            (channels if named else cut_off).append((named[-1] if named else None, members, points))
        taken, new = {place for place, *_ in channels}, self.network.channel_count
        for _, members, points in cut_off:
            place = self.reaches[members[0]].old
            if place in taken:
                place, new = new, new + 1
            channels.append((place, members, points))
        return sorted(channels), flow


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
    start, before, count = network.starts(), plain.flow_before, network.channel_count
    assert split_by(expanded(edited), edited.channel_start) == [points for *_, points in channels]
    names = [*network.channel_id, *(network.channel_id.max() + 1 + np.arange(plain.created))]
    assert edited.channels.id.tolist() == [names[place] for place, *_ in channels]
    source = [place if place < count else plain.reaches[members[0]].old for place, members, _ in channels]
    assert edited.channel_old.tolist() == source
    changed = [points != list(range(start[c], start[c + 1])) for c, (*_, points) in zip(source, channels, strict=True)]
    assert edited.channel_changed.tolist() == changed
    after = np.array([flow[members[-1]] for _, members, _ in channels])
    model = []
    for (_, members, _), now in zip(channels, after, strict=True):
        apart = [abs(np.log(now / before[plain.reaches[c].old])) for c in members]
        nearest = len(members) - 1 - int(np.argmin(apart[::-1]))
        model.append(plain.reaches[members[nearest]].old)
    gain = after / before[model]
    area = network.channel_drainage_area
    if area is None:
        assert edited.channels.drainage_area is None
        np.testing.assert_allclose(edited.channels.discharge, after, rtol=FLOW_TOLERANCE)
    else:
        np.testing.assert_allclose(edited.channels.drainage_area, after, rtol=FLOW_TOLERANCE)
        expected = network.channel_discharge[model] * gain
        np.testing.assert_allclose(edited.channels.discharge, expected, rtol=FLOW_TOLERANCE)
    np.testing.assert_allclose(edited.channels.width, network.channel_width[model] * gain**0.5, rtol=FLOW_TOLERANCE)
    depth = network.channel_depth[model] * gain ** (0.5 / 1.41)
    np.testing.assert_allclose(edited.channels.depth, depth, rtol=FLOW_TOLERANCE)
    above, below, xy = edited.channels.from_node, edited.channels.to_node, edited.node_xy
    ends = [(plain.reaches[members[0]].above, plain.reaches[members[-1]].below) for _, members, _ in channels]
    nodes = sorted({n for pair in ends for n in pair})
    assert [(nodes[a], nodes[b]) for a, b in zip(above, below, strict=True)] == ends
    np.testing.assert_allclose(xy, [plain.places[n] for n in nodes], rtol=0.0, atol=1e-9)
    if network.point_section is None:
        assert edited.run_scale is None
        return
    factor = []
    for _, members, _ in channels:
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
    kinds = ("upstream", "downstream", "neck", "disconnected", "vanished")
    assert {kind: seen.count(kind) > 3 for kind in kinds} == dict.fromkeys(kinds, True)
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


# ---- one case of each kind, worked out by hand

# Rivers by identity: area at the downstream end in km2, width in m, identities upstream. 13 has 2 km2 of its own.
BASIN = {
    11: (6.0, 60.0, []),
    12: (4.0, 80.0, []),
    13: (12.0, 200.0, [11, 12]),
    14: (8.0, 100.0, []),
    15: (20.0, 240.0, [13, 14]),
    16: (10.0, 90.0, []),
}
DISCHARGE, DEPTH = dict(zip(BASIN, [5.0, 4.0, 11.0, 7.0, 15.0, 9.0], strict=True)), 2.0


def basin():
    """The rivers of ``BASIN``, 21 points each; 16 is a river of its own."""
    corners = {11: (-1000, 3000), 12: (1000, 3000), 13: (0, 2000), 14: (3000, 2000), 15: (0, 1000), 16: (5000, 3000)}
    down = {11: (0, 2000), 12: (0, 2000), 13: (0, 1000), 14: (0, 1000), 15: (0, 0), 16: (5000, 0)}
    lines = [np.linspace(corners[c], down[c], 21) for c in BASIN]
    return RiverNetwork.from_polylines(
        lines,
        width=[width for _, width, _ in BASIN.values()],
        depth=DEPTH,
        discharge=list(DISCHARGE.values()),
        drainage_area=[area * 1e6 for area, *_ in BASIN.values()],
        channel_id=list(BASIN),
    )


def met(upper, point_upper, lower, point_lower, network=None):
    """Let two channels of the basin meet, each at one of its points, and return what was done and the channels."""
    network = network or basin()
    a, b = (network.channel_id.tolist().index(c) for c in (upper, lower))
    start = network.starts().tolist()
    edit = NetworkEdit(network)
    done = edit.rejoin(a, start[a] + point_upper, b, start[b] + point_lower)
    assert edit.rejoin(a, start[a] + point_upper, b, start[b] + point_lower) is None, "once in a round"
    return done, edit.build()


def assert_rivers(edited, expected):
    """Identity, number of points, area, upstream channels and the channel that the width is taken from."""
    table, points = edited.channels, np.diff(edited.channel_start)
    assert table.id.tolist() == list(expected)
    for c, (identity, (count, area, upstream, model)) in enumerate(expected.items()):
        assert points[c] == count, identity
        assert table.drainage_area[c] / 1e6 == pytest.approx(area, rel=1e-12), identity
        assert sorted(table.id[table.to_node == table.from_node[c]].tolist()) == upstream, identity
        before, width, _ = BASIN[model]
        gain = area / before
        assert table.width[c] == pytest.approx(width * gain**0.5, rel=1e-12), identity
        assert table.depth[c] == pytest.approx(DEPTH * gain ** (0.5 / 1.41), rel=1e-12), identity
        assert table.discharge[c] == pytest.approx(DISCHARGE[model] * gain, rel=1e-12), identity


def test_upstream_the_junction_climbs_and_nobody_loses_its_identity():
    """12 meets 11 at a quarter of its way: what is left of that belongs to 13. Sources keep all of their ground."""
    done, edited = met(12, 10, 11, 5)
    assert (done.kind, done.minor, done.main, done.junction) == ("upstream", 12, 11, 5)
    assert done.abandoned == ((31, 42, 12),)
    rivers = {
        11: (6, 6.0, [], 11), 12: (12, 4.0, [], 12), 13: (36, 12.0, [11, 12], 13),
        14: (21, 8.0, [], 14), 15: (21, 20.0, [13, 14], 15), 16: (21, 10.0, [], 16),
    }  # fmt: skip
    assert_rivers(edited, rivers)
    assert edited.node_xy[edited.channels.from_node[2]].tolist() == [-750.0, 2750.0]


def test_downstream_the_sibling_gets_the_reach_between_and_keeps_its_width():
    """12, the smaller, meets 13 halfway: 11 goes on to there, and half of the ground of 13 drains to it."""
    done, edited = met(12, 10, 13, 10)
    assert (done.kind, done.minor, done.main) == ("downstream", 12, 13)
    rivers = {
        11: (31, 7.0, [], 11), 12: (12, 4.0, [], 12), 13: (11, 12.0, [11, 12], 13),
        14: (21, 8.0, [], 14), 15: (21, 20.0, [13, 14], 15), 16: (21, 10.0, [], 16),
    }  # fmt: skip
    assert_rivers(edited, rivers)


def test_neck_the_main_stem_meets_itself_and_its_tributary_gets_the_reach_between():
    """11, the larger of both, meets 13 halfway, and 15 is met by 13 across two junctions further on."""
    done, edited = met(11, 10, 13, 10)
    assert (done.kind, done.minor, done.main) == ("neck", 11, 13)
    rivers = {
        11: (12, 6.0, [], 11), 12: (31, 5.0, [], 12), 13: (11, 12.0, [11, 12], 13),
        14: (21, 8.0, [], 14), 15: (21, 20.0, [13, 14], 15), 16: (21, 10.0, [], 16),
    }  # fmt: skip
    assert_rivers(edited, rivers)
    # Over two junctions: 12 goes on with 13 down to the mouth of 14 and with 14 to where 11 is now.
    done, edited = met(11, 10, 15, 10)
    assert (done.kind, done.minor, done.main) == ("neck", 11, 15)
    rivers = {
        11: (12, 6.0, [], 11), 13: (41, 6.0, [], 12), 14: (21, 8.0, [], 14), 15: (11, 20.0, [11, 17], 15),
        16: (21, 10.0, [], 16), 17: (11, 14.0, [13, 14], 15),
    }  # fmt: skip
    assert_rivers(edited, rivers)
    # A tributary of the main stem that does the same is none of its course.
    assert met(12, 10, 15, 10)[0].kind == met(14, 10, 15, 10)[0].kind == "downstream"


def test_disconnected_the_captor_grows_and_the_victim_shrinks_down_to_its_outlet():
    """16 captures 12: it is one channel more, and 11 and 13, which are left alone, are one channel less."""
    done, edited = met(12, 10, 16, 10)
    assert (done.kind, done.minor, done.main) == ("disconnected", 12, 16)
    rivers = {
        12: (12, 4.0, [], 12), 13: (41, 8.0, [], 11), 14: (21, 8.0, [], 14), 15: (21, 16.0, [13, 14], 15),
        16: (11, 14.0, [12, 17], 16), 17: (11, 10.0, [], 16),
    }  # fmt: skip
    assert_rivers(edited, rivers)
    # 11 captured: what flows on is nearer to what 13 carried than to 12.
    area = np.array([2.0, 4.0, 12.0, 8.0, 20.0, 10.0])
    small = basin()
    small = small.with_channels(small.channels.replace(drainage_area=area * 1e6))
    edited = met(11, 10, 16, 10, small)[1]
    merged = edited.channels.id.tolist().index(13)
    assert edited.channels.width[merged] == pytest.approx(200.0 * (10.0 / 12.0) ** 0.5)


def test_three_that_meet_at_one_node_keep_it():
    """5 and 6 meet above the end that they share with 7: their junction is new, and so is the piece of 5 above it."""
    lines = [np.linspace(head, (0, 0), 21) for head in ((-900, 900), (0, 900), (900, 900))]
    lines.append(np.linspace((0, 0), (0, -900), 21))
    network = RiverNetwork.from_polylines(lines, 20.0, drainage_area=[3e6, 2e6, 1e6, 6e6], channel_id=[5, 6, 7, 8])
    edit = NetworkEdit(network)
    assert edit.rejoin(0, 10, 1, 21 + 10).kind == "upstream"
    table = edit.build().channels
    assert table.id.tolist() == [5, 6, 7, 8, 9]
    into = {
        c: sorted(table.id[table.to_node == node].tolist()) for c, node in zip(table.id, table.from_node, strict=True)
    }
    assert into == {5: [6, 9], 6: [], 7: [], 8: [5, 7], 9: []}
    np.testing.assert_allclose(table.drainage_area / 1e6, [5.0, 2.0, 1.0, 6.0, 3.0], rtol=1e-12)


@pytest.mark.parametrize("at", [10, 1])
def test_a_course_of_several_channels_cuts_its_loop_off(at):
    """Nothing joins where they meet, so they stay two channels; the source does not vanish, even with its head."""
    lines = [
        np.linspace((0, 900), (0, 0), 21),
        np.linspace((0, 0), (900, 0), 21),
        np.linspace((900, 0), (900, 900), 21),
    ]
    network = RiverNetwork.from_polylines(
        lines, [20.0, 30.0, 40.0], drainage_area=[3e6, 5e6, 6e6], channel_id=[5, 6, 7]
    )
    edit = NetworkEdit(network)
    done = edit.rejoin(0, at, 2, 2 * 21 + 10)
    assert (done.kind, done.minor, done.main, done.junction) == ("neck", 5, 7, 52)
    assert done.abandoned == ((at, 21, 5), (21, 42, 6), (42, 53, 7))
    edited = edit.build()
    table = edited.channels
    assert table.id.tolist() == [5, 7] and expanded(edited) == [*range(at + 1), 52, *range(52, 63)]
    assert table.to_node[0] == table.from_node[1]
    # The ground of what fell dry drains to what is left downstream.
    np.testing.assert_allclose(table.drainage_area, [3e6, 6e6], rtol=1e-12)
    np.testing.assert_array_equal(table.width, [20.0, 40.0])


def test_a_source_that_touches_with_its_head_vanishes_and_leaves_its_ground():
    done, edited = met(12, 1, 16, 10)
    assert (done.kind, done.junction, done.abandoned) == ("disconnected", -1, ((21, 42, 12),))
    rivers = {
        13: (41, 8.0, [], 11), 14: (21, 8.0, [], 14), 15: (21, 16.0, [13, 14], 15), 16: (21, 14.0, [], 16)
    }  # fmt: skip
    assert_rivers(edited, rivers)


def test_a_new_channel_gets_no_identity_that_was_ever_used():
    network = basin()
    start = network.starts().tolist()
    edit = NetworkEdit(network, next_identity=40)
    assert edit.rejoin(1, start[1] + 10, 5, start[5] + 10) is not None
    assert edit.build().channels.id.tolist() == [12, 13, 14, 15, 16, 40]
