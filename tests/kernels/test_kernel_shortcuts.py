"""Shortcut kernels against the twins in reference_paths.py: all pairs, scipy's graph search, ties by hand."""

import numpy as np
import pytest
import reference_paths as twin
import warp as wp
from cutoff_case import tangled_neck
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import (
    DEALS,
    SLABS,
    UNWRITTEN,
    Backwards,
    by_fours,
    list_of_marks,
    running_marks,
    share_count,
    share_of_points,
    status_of,
    to_device,
    unwritten,
)
from path_lines import SPACING, PackedLines, varying_sections, wandering_line

from warpriver.kernels import cutoffs, resampling, routes, shortcuts
from warpriver.kernels.polyline import Links
from warpriver.kernels.status import FAULT, LINKS_NEEDED

FAULT_SHORTCUTS_FULL = 3


class Case(PackedLines):
    """Some channels, and the kernels that find the shortest paths down them."""

    def __init__(self, lines, **options):
        super().__init__(lines, **options)
        self.kernel = shortcuts.build(self.scalar)
        self.shape = [self.channel_start, self.form, self.spacing]

    def ints(self, count=None):
        return unwritten(self.capacity if count is None else count, wp.int32, self.device)

    def zeros(self, count, kind=wp.int32):
        return wp.zeros(count, dtype=kind, device=self.device)

    def shares(self, deal):
        return share_count(deal, len(self.lines), self.capacity)

    def chunks(self, deal):
        """Number of chunks; slabs have none, and arrays of one element for them."""
        return self.shares(deal) if isinstance(deal, int) else 1

    def law(self, radius, min_arc, cone):
        law = self.kernel.ShortcutLaw()
        law.radius, law.min_arc = radius, min_arc
        law.cone = np.cos(np.radians(cone)) ** 2 if cone < 90.0 else 0.0
        if self.closed is not None:
            law.channel_closed = self.closed
        return law

    # ---- shortcuts

    def linked(self, radius, deal):
        """Grid of the points: (next, head); with chunks a bucket has two fields, slabs empty their own."""
        chunked = isinstance(deal, int)
        after, head = self.ints(), self.zeros(8 * self.capacity) if chunked else self.ints(4 * self.capacity)
        inputs = [self.channel_start, self.form, self.step, radius, ..., self.xy]
        self.launch(cutoffs.build(self.scalar).insert_points, deal, inputs, [after, by_fours(head), head])
        return after, head

    def by_share(self, links, farthest, deal):
        """Number of shortcuts that begin in each share, and the last point that one of them reaches, (shares, 2)."""
        share, marks = share_of_points(deal, self.start), np.zeros((self.shares(deal), 2), int)
        np.add.at(marks[:, 0], share, links[: self.count])
        np.maximum.at(marks[:, 1], share, farthest[: self.count])
        return marks

    def search(self, law, near, deal):
        """What counting writes, on the device: shortcuts, path and way back by point, by share, cuts, by channel."""
        out = [self.ints() for _ in range(3)]
        out += [unwritten(self.shares(deal), wp.vec2i, self.device) for _ in range(2)]
        out += [self.ints(len(self.lines))]
        in_chunks = isinstance(deal, int)
        search = self.kernel.count_shortcuts_in_chunks if in_chunks else self.kernel.count_shortcuts
        self.launch(search, deal, [*self.shape, self.step, law, ..., *near], out)
        return out

    def counted(self, radius, min_arc, cone, deal=64):
        """Grid, shortcuts of each point and channel, and running sums over the shares; checks what is cleared."""
        near = [self.xy, self.section, *self.linked(radius, deal)]
        law, chunked = self.law(radius, min_arc, cone), isinstance(deal, int)
        found = self.search(law, near, deal)
        links, neck, before, by_share, cuts, by_channel = (a.numpy() for a in found)
        owner = np.repeat(np.arange(len(self.lines)), np.diff(self.start))
        resting = np.isin(owner, self.resting)
        for array, cleared in ((links, 0), (neck, -1), (before, 0)):
            assert (array[self.count :] == UNWRITTEN).all()
            assert (array[: self.count][resting] == (cleared if chunked else UNWRITTEN)).all()
        assert (neck[: self.count][~resting] == -1).all() and (before[: self.count][~resting] == 0).all()
        assert (cuts == 0).all()
        counts = np.where(resting, 0, links[: self.count])
        farthest = np.zeros(self.count, int)
        for c, pairs in enumerate(self.twin_shortcuts(radius, min_arc, cone)):
            np.maximum.at(farthest, pairs[:, 0] + self.start[c], pairs[:, 1] + self.start[c])
        assert by_share.tolist() == self.by_share(counts, farthest, deal).tolist()
        if chunked:
            assert (by_channel == UNWRITTEN).all()
        else:
            assert by_channel.tolist() == np.bincount(owner, counts, len(self.lines)).tolist()
        return law, near, found[0], found[-1], running_marks(by_share, self.device)

    def shortcuts(self, radius, min_arc, cone, deal=64, room=None):
        """Pairs by channel, numbered within the channel, in the order of the list; None where there is no room."""
        law, near, links, by_channel, total = self.counted(radius, min_arc, cone, deal)
        found = int(total.numpy()[-1, 0])
        room = found + 3 if room is None else room
        first, begin, end, status = self.ints(), self.ints(room), self.ints(room), status_of({}, self.device)
        inputs = [*self.shape, law, ..., *near, links, by_channel, total]
        self.launch(self.kernel.list_shortcuts, deal, inputs, [first, begin, end, status])
        assert status.numpy()[LINKS_NEEDED] == found, "told, whether there is room or not"
        if room < found:
            assert status.numpy()[FAULT] == FAULT_SHORTCUTS_FULL
            assert all((array.numpy() == UNWRITTEN).all() for array in (first, begin, end))
            return None
        assert status.numpy()[FAULT] == 0 and (end.numpy()[found:] == UNWRITTEN).all()
        pairs = np.stack([begin.numpy()[:found], end.numpy()[:found]], axis=1)
        i, at = np.unique(pairs[:, 0], return_index=True)
        assert (first.numpy()[i] == at).all() and (np.delete(first.numpy(), i) == UNWRITTEN).all()
        owner = np.searchsorted(self.start, pairs[:, 0], side="right") - 1
        return [pairs[owner == c] - a for c, a in enumerate(self.start[:-1])]

    def twin_shortcuts(self, radius, min_arc, cone):
        found = []
        for c, (xy, width) in enumerate(zip(self.lines, self.widths(), strict=True)):
            mean = 0.5 * (width[:, None] + width)
            pairs = twin.find_shortcuts(xy, SPACING, radius * mean, min_arc * mean, cone)
            found.append(pairs[:0] if c in self.resting else pairs)
        return found

    # ---- what they save

    def packed_links(self, pairs, deal, room=None):
        """Shortcuts numbered within their channels, as the kernels have them, by name; ``room`` for so many."""
        packed = np.concatenate([p + a for p, a in zip(pairs, self.start[:-1], strict=True)])
        links = np.bincount(packed[:, 0], minlength=self.capacity)
        farthest = np.zeros(self.capacity, int)
        np.maximum.at(farthest, packed[:, 0], packed[:, 1])
        by_share, by_channel = self.by_share(links, farthest, deal), [len(p) for p in pairs]
        if isinstance(deal, int):
            by_channel = np.full(len(pairs), UNWRITTEN)
        else:
            # Where a channel has none, or rests, slabs look no further; there is what an earlier step left.
            owner = np.repeat(np.arange(len(pairs)), np.diff(self.start))
            links[: self.count][np.array(by_channel)[owner] == 0] = 2
        first = np.full(self.capacity, UNWRITTEN)
        i, at = np.unique(packed[:, 0], return_index=True)
        first[i] = at
        arrays = {"links": links, "first": first, "by_channel": by_channel}
        arrays |= {"begin": packed[:room, 0], "end": packed[:room, 1]}
        given = {name: to_device(np.array(a), wp.int32, self.device) for name, a in arrays.items()}
        flags = None
        if isinstance(deal, int):
            flags = np.zeros(self.chunks(deal), int)
            flags[packed // deal] = 1
        return given | {
            "total": running_marks(by_share, self.device),
            "flags": flags,
            "marks": list_of_marks(flags, self.device),
        }

    def arcs(self, deal):
        """Arc lengths on the device: (by point, offsets of the chunks)."""
        arc = unwritten(self.capacity, wp.float64, self.device)
        length = unwritten(self.chunks(deal), wp.int64, self.device)
        kernel, status = resampling.build(self.scalar).measure_arcs, status_of({}, self.device)
        self.launch(kernel, deal, [self.channel_start, self.step, ..., self.xy], [arc, length, status])
        assert status.numpy()[FAULT] == 0
        return arc, to_device(np.cumsum(length.numpy()), wp.int64, self.device)

    def weighed(self, pairs, deal):
        """What each shortcut saves, in the order of the list; checks the chunks where any begins or ends."""
        given, marks = self.packed_links(pairs, deal), self.zeros(self.chunks(deal), wp.vec2i)
        saving = unwritten(given["begin"].shape[0], wp.float64, self.device)
        inputs = [..., self.xy, *self.arcs(deal), given["total"], given["begin"], given["end"]]
        self.launch(self.kernel.weigh_shortcuts, deal, inputs, [saving, marks])
        flags = [0] if given["flags"] is None else given["flags"]
        assert marks.numpy().tolist() == [[int(flag), 0] for flag in flags]
        return saving.numpy()

    # ---- the path

    def path(self, pairs, saving, deal=64, room=None, head=None, ends_at=None):
        """Shortcuts on the shortest path by channel, each where it begins; checks the counts by share.

        ``room``: so many are listed at most; ``head`` and ``ends_at``: heads of rings and marks at their ends. In
        ``swept`` is kept where the best shortcut to each point begins, and what is saved there.
        """
        given, kernel = self.packed_links(pairs, deal, room), routes.build(self.scalar)
        links = Links()
        links.point_links, links.point_link = given["links"], given["first"]
        links.link_from, links.link_to = given["begin"], given["end"]
        links.link_saving = to_device(saving[:room], wp.float64, self.device)
        before = self.zeros(self.capacity) if ends_at is None else ends_at
        neck, saved = self.ints(), unwritten(self.capacity, wp.float64, self.device)
        neck.fill_(-1)
        cuts = self.zeros(self.shares(deal), wp.vec2i)
        inputs = [self.channel_start, ..., self.closed, head]
        inputs += [given["by_channel"], given["total"], given["marks"], links]
        self.launch(kernel.find_path, deal, inputs, [before, saved, neck, cuts])
        self.swept = before.numpy(), saved.numpy()
        kept, counts, share = [], np.zeros((self.shares(deal), 2), int), share_of_points(deal, self.start)
        for first, own in zip(self.start[:-1], self.by_channel(neck.numpy()), strict=True):
            kept.append([(int(i), int(own[i] - first)) for i in np.flatnonzero(own >= 0)])
            for i, j in kept[-1]:
                counts[share[first + i]] += [1, (j - i) % len(own) + 1]
        assert cuts.numpy().tolist() == counts.tolist()
        return kept


# ---- shortcuts


@pytest.mark.parametrize("deal", DEALS)
@pytest.mark.parametrize("cone", [10.0, 45.0, 90.0])
def test_shortcuts_match_all_pairs(device, deal, cone):
    """Channels on top of each other, some so short that two cells share a bucket: each pair once, in order."""
    rng = np.random.default_rng(7)
    lines = [wandering_line(rng, n, curl) for n, curl in ((3, 1), (9, 1.5), (120, 0.9), (12, 2), (300, 0.5), (33, 1))]
    width = np.array([12.0, 30.0, 12.0, 25.0, 15.0, 40.0])
    for resting in ((), (0, 2, 5)):
        case = Case(lines, width=width, resting=resting, device=device)
        expected = case.twin_shortcuts(1.5, 3.0, cone)
        assert sum(len(p) for p in expected) > (20 if resting else 50)
        for channel, pairs in enumerate(case.shortcuts(1.5, 3.0, cone, deal)):
            assert pairs.tolist() == expected[channel].tolist(), f"channel {channel}"


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.integers(3, 120), min_size=1, max_size=5),
    deal=st.one_of(st.integers(1, 150), st.sampled_from(DEALS)),
    seed=st.integers(0, 2**32 - 1),
    curl=st.floats(0.05, 2.0),
    radius=st.floats(0.05, 2.5),
    slack=st.floats(0.001, 4.0),
    cone=st.floats(1.0, 90.0),
    varies=st.booleans(),
)
def test_any_shortcuts_match_all_pairs(counts, deal, seed, curl, radius, slack, cone, varies):
    rng = np.random.default_rng(seed)
    lines = [wandering_line(rng, n, curl) for n in counts]
    case = Case(lines, sections=varying_sections(rng, counts) if varies else None)
    min_arc = max(1.0, radius) + slack
    expected = case.twin_shortcuts(radius, min_arc, cone)
    for channel, pairs in enumerate(case.shortcuts(radius, min_arc, cone, deal)):
        assert pairs.tolist() == expected[channel].tolist(), f"channel {channel}"


@pytest.mark.parametrize("deal", [1, 64, Backwards(7), "one slab", "a slab each, apart"])
def test_too_little_room_is_flagged_and_nothing_written(device, deal):
    rng = np.random.default_rng(1)
    case = Case([wandering_line(rng, 300), wandering_line(rng, 100)], device=device)
    found = sum(len(p) for p in case.shortcuts(1.5, 3.0, 90.0, deal))
    assert case.shortcuts(1.5, 3.0, 90.0, deal, room=found - 1) is None
    pairs = case.shortcuts(1.5, 3.0, 90.0, deal, room=found)
    assert sum(len(p) for p in pairs) == found
    saving = case.weighed(pairs, deal)
    assert case.path(pairs, saving, deal, room=found)[0] != []
    assert case.path(pairs, saving, deal, room=found - 1) == [[], []], "nothing is cut before there is room"


@pytest.mark.parametrize("deal", DEALS)
def test_savings_are_arc_less_chord(device, deal):
    rng = np.random.default_rng(11)
    case = Case([wandering_line(rng, n) for n in (150, 3, 200, 64)], device=device)
    pairs = case.twin_shortcuts(1.5, 3.0, 90.0)
    expected = np.concatenate([twin.savings(xy, p) for xy, p in zip(case.lines, pairs, strict=True)])
    # Arc lengths are sums of some hundred segments of 10 m.
    np.testing.assert_allclose(case.weighed(pairs, deal), expected, rtol=0.0, atol=4e-12)


# ---- the shortest path


@pytest.mark.parametrize("deal", DEALS)
def test_path_is_as_short_as_scipys(device, deal):
    rng = np.random.default_rng(13)
    case = Case([wandering_line(rng, n, c) for n in (150, 3, 200, 64, 9) for c in (0.4, 1.0)], device=device)
    pairs = case.twin_shortcuts(2.0, 3.0, 90.0)
    kept = case.path(pairs, case.weighed(pairs, deal), deal)
    assert sum(len(k) for k in kept) > 20
    for xy, links, cut in zip(case.lines, pairs, kept, strict=True):
        length, _ = twin.shortest_path(xy, links)
        route = [i for i in range(len(xy)) if not any(a < i < b for a, b in cut)]
        ours = np.linalg.norm(np.diff(xy[route], axis=0), axis=1).sum()
        assert abs(ours - length) <= 1e-12 * length
        assert set(cut) <= {(int(i), int(j)) for i, j in links}


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.integers(3, 40), min_size=1, max_size=4),
    deal=st.one_of(st.integers(1, 50), st.sampled_from(DEALS)),
    seed=st.integers(0, 2**32 - 1),
    density=st.floats(0.0, 0.3),
)
def test_any_links_with_ties_give_the_twins_route(counts, deal, seed, density):
    """Whole-number savings, so that ties abound: the channel goes before a shortcut, then the one from upstream."""
    rng = np.random.default_rng(seed)
    pairs, saving = [], []
    for n in counts:
        links = np.argwhere(np.triu(rng.random((n, n)) < density, 2))
        pairs.append(links.reshape(-1, 2))
        saving.append(rng.integers(0, 4, len(links)).astype(float))
    if sum(len(p) for p in pairs) == 0:
        return
    case = Case([np.zeros((n, 2)) for n in counts])
    kept = case.path(pairs, np.concatenate(saving), deal)
    for n, links, gain, cut in zip(counts, pairs, saving, kept, strict=True):
        assert cut == twin.best_chain(n, links, gain)[0]


def tangled_links(rng, n):
    """Shortcuts of n points in ascending order, (k, 2): in clusters of all kinds, several to and from a point."""
    neck = tangled_neck(rng, n)
    i = np.flatnonzero(neck >= 0)
    pairs = [np.stack([i, neck[i]], axis=1)]
    for _ in range(2):
        i = i[(neck[i] - i > 3) & (rng.random(len(i)) < 0.3)]
        pairs.append(np.stack([i, rng.integers(i + 2, neck[i])], axis=1))
    return np.unique(np.concatenate(pairs), axis=0)


@settings(max_examples=120, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.one_of(st.integers(3, 40), st.integers(3, 250)), min_size=1, max_size=8),
    deal=st.sampled_from((1, 2, 7, 64, Backwards(7), *SLABS)),
    seed=st.integers(0, 2**32 - 1),
    whole=st.booleans(),
)
def test_any_tangle_of_links_gives_the_twins_route(counts, deal, seed, whole):
    """Chunks sweep the clusters apart from each other, in any order; slabs a channel at once: the same route, ties too.

    Clusters may share the point where one ends and the next begins, and one shortcut may pass over many of them.
    """
    rng = np.random.default_rng(seed)
    resting = np.flatnonzero(rng.random(len(counts)) < 0.2)
    pairs = [tangled_links(rng, n) for n in counts]
    for c in resting:
        pairs[c] = pairs[c][:0]
    saving = [rng.uniform(-1.0, 9.0, len(p)) for p in pairs]
    if whole:
        saving = [rng.integers(-1, 4, len(p)).astype(float) for p in pairs]
    case = Case([np.zeros((n, 2)) for n in counts], resting=tuple(resting))
    if sum(map(len, pairs)) > 0:
        kept = case.path(pairs, np.concatenate(saving), deal)
        assert kept == [twin.best_chain(n, *given)[0] for n, *given in zip(counts, pairs, saving, strict=True)]


def test_clusters_are_swept_apart_from_each_other():
    """What is saved within one does not tell what those above have saved, nor in which order chunks came to them."""
    rng = np.random.default_rng(3)
    counts = rng.integers(3, 250, 40).tolist()
    pairs = [tangled_links(rng, n) for n in counts]
    saving = np.concatenate([rng.uniform(-1.0, 9.0, len(p)) for p in pairs])
    case, results = Case([np.zeros((n, 2)) for n in counts]), []
    for deal in (7, 1, 64, Backwards(7)):
        case.path(pairs, saving, deal)
        results.append(case.swept)
    for source, saved in results[1:]:
        np.testing.assert_array_equal(source, results[0][0])
        np.testing.assert_array_equal(saved, results[0][1])
    assert (results[0][0] > 0).sum() > 500


def test_the_tangles_hold_what_they_are_to():
    """Clusters of one and of many over several chunks of 64, and routes that go on where a cluster ends."""
    rng, clusters, reach, shared, several = np.random.default_rng(1), [], 0, 0, 0
    for n in rng.integers(3, 250, 200).tolist():
        links, far = tangled_links(rng, n), -1
        for i, j in links.tolist():
            if i >= far:
                clusters.append(0)
                shared += i == far
            clusters[-1] += 1
            far = max(far, j)
            reach = max(reach, j - i)
        several += len(twin.best_chain(n, links, rng.uniform(-1.0, 9.0, len(links)))[0]) > 3
    assert reach > 192 and shared > 100 and several > 50
    assert clusters.count(1) > 50 and max(clusters) > 50


@pytest.mark.parametrize("deal", [1, 7, *SLABS[:2]])
def test_a_halted_step_finds_no_shortcuts_and_no_route(device, deal):
    """What the sub-step before has found, and told, stays."""
    rng = np.random.default_rng(1)
    lines = [wandering_line(rng, 300), wandering_line(rng, 100)]
    case = Case(lines, device=device)
    law, near, links, by_channel, total = case.counted(1.5, 3.0, 90.0, deal)
    pairs = case.twin_shortcuts(1.5, 3.0, 90.0)
    found = sum(map(len, pairs))
    case.halt = 1
    assert all((array.numpy() == UNWRITTEN).all() for array in case.search(law, near, deal))
    first, begin, end, status = case.ints(), case.ints(found), case.ints(found - 1), status_of({}, device)
    inputs = [*case.shape, law, ..., *near, links, by_channel, total]
    case.launch(case.kernel.list_shortcuts, deal, inputs, [first, begin, end, status])
    assert all((array.numpy() == UNWRITTEN).all() for array in (first, begin, end)) and not status.numpy().any()
    saving, marks = unwritten(found, wp.float64, device), case.zeros(case.chunks(deal), wp.vec2i)
    given = case.packed_links(pairs, deal)
    inputs = [..., case.xy, *case.arcs(deal), total, given["begin"], given["end"]]
    case.launch(case.kernel.weigh_shortcuts, deal, inputs, [saving, marks])
    assert np.isnan(saving.numpy()).all() and not marks.numpy().any()
    assert case.path(pairs, np.ones(found), deal) == [[], []]


@pytest.mark.parametrize("deal", DEALS)
def test_ties_by_hand(device, deal):
    case = Case([np.zeros((12, 2))], device=device)
    for links, saving, expected in (
        ([(2, 10), (4, 10)], [5.0, 5.0], [(2, 10)]),  # equally good: the one that begins upstream
        ([(1, 5)], [0.0], []),  # saves nothing: the channel stays
        ([(0, 5), (0, 9), (5, 9)], [2.0, 4.0, 2.0], [(0, 9)]),  # a chain of two is no better than one
        ([(0, 5), (0, 9), (5, 9)], [2.0, 4.0, 2.5], [(0, 5), (5, 9)]),  # end to end: they share a point
        ([(0, 6), (1, 4), (5, 9)], [3.0, 2.0, 2.0], [(1, 4), (5, 9)]),  # two short ones beat one long one
        ([(0, 3), (3, 6), (6, 11)], [1.0, 1.0, 1.0], [(0, 3), (3, 6), (6, 11)]),  # three clusters of one, end to end
        ([(0, 3), (0, 11), (3, 6), (6, 11)], [1.0, 3.5, 1.0, 1.0], [(0, 11)]),  # one over them all
    ):
        assert case.path([np.array(links)], np.array(saving), deal)[0] == expected
