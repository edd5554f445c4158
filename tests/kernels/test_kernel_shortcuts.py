"""Shortcut kernels against the twins in reference_paths.py: all pairs, scipy's graph search, ties by hand."""

import numpy as np
import pytest
import reference_paths as twin
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import DEALS, UNWRITTEN, by_fours, chunk_count, share_count, slab_bounds, to_device, unwritten
from path_lines import SPACING, PackedLines, varying_sections, wandering_line

from warpriver.kernels import cutoffs, resampling, routes, shortcuts

FAULT_SHORTCUTS_FULL = 3


class Case(PackedLines):
    """Some channels, and the kernels that find the shortest paths down them."""

    def __init__(self, lines, **options):
        super().__init__(lines, **options)
        self.kernel = shortcuts.build(self.scalar)
        self.shape = [self.channel_start, self.form, self.spacing]

    def ints(self, count=None):
        return unwritten(self.capacity if count is None else count, wp.int32, self.device)

    def zeros(self, count):
        return wp.zeros(count, dtype=wp.int32, device=self.device)

    def counters(self, count, deal):
        """What chunks count up from 0, and slabs write."""
        return self.zeros(count) if isinstance(deal, int) else self.ints(count)

    def share_of(self, deal):
        """Share of the work that each point belongs to, (count,)."""
        if isinstance(deal, int):
            return np.arange(self.count) // deal
        owner = np.repeat(np.arange(len(self.lines)), np.diff(self.start))
        return np.searchsorted(slab_bounds(deal, len(self.lines))[1:], owner, side="right")

    def shares(self, deal):
        return share_count(deal, len(self.lines), self.capacity)

    def chunks(self, deal):
        return chunk_count(self.capacity, deal) if isinstance(deal, int) else 1

    def law(self, radius, min_arc, cone):
        law = self.kernel.ShortcutLaw()
        law.radius, law.min_arc = radius, min_arc
        law.cone = np.cos(np.radians(cone)) ** 2 if cone < 90.0 else 0.0
        if self.closed is not None:
            law.channel_closed = self.closed
        return law

    def linked(self, radius, deal):
        """Grid of the points: (next, head)."""
        after, head = self.ints(), self.counters(4 * self.capacity, deal)
        inputs = [self.channel_start, self.form, self.step, radius, ..., self.points]
        self.launch(cutoffs.build(self.scalar).insert_points, deal, inputs, [after, by_fours(head), head])
        return after, head

    def counted(self, radius, min_arc, cone, deal=64, ordered=0):
        """Grid, shortcuts of each point and channel, and their sum over the shares; checks what is cleared."""
        near, channels = [self.points, self.section, *self.linked(radius, deal)], len(self.lines)
        law, points = self.law(radius, min_arc, cone), [self.ints() for _ in range(3)]
        by_share, by_channel = self.ints(self.shares(deal)), self.counters(channels, deal)
        inputs = [*self.shape, self.step, law, ..., ordered, *near]
        self.launch(self.kernel.count_shortcuts, deal, inputs, [*points, by_share, by_channel])
        owner = np.repeat(np.arange(channels), np.diff(self.start))
        awake = ~np.isin(owner, self.resting)
        links, neck, before = (a.numpy() for a in points)
        for array in (links, neck, before):
            assert (array[self.count :] == UNWRITTEN).all() and (array[: self.count][~awake] == UNWRITTEN).all()
        assert (neck[: self.count][awake] == -1).all() and (before[: self.count][awake] == 0).all()
        counts = np.where(awake, links[: self.count], 0)
        assert by_channel.numpy().tolist() == np.bincount(owner, counts, channels).tolist()
        assert by_share.numpy().tolist() == np.bincount(self.share_of(deal), counts, self.shares(deal)).tolist()
        return law, near, points[0], by_channel, to_device(np.cumsum(by_share.numpy()), wp.int32, self.device)

    def shortcuts(self, radius, min_arc, cone, deal=64, ordered=0, room=None):
        """Pairs by channel, numbered within the channel, in the order of the list."""
        law, near, links, by_channel, total = self.counted(radius, min_arc, cone, deal, ordered)
        found = int(total.numpy()[-1])
        room = found + 3 if room is None else room
        first, begin, end, fault = self.ints(), self.ints(room), self.ints(room), self.zeros(1)
        inputs = [*self.shape, law, ..., *near, links, by_channel, total]
        self.launch(self.kernel.list_shortcuts, deal, inputs, [first, begin, end, fault])
        if fault.numpy()[0] != 0:
            assert fault.numpy()[0] == FAULT_SHORTCUTS_FULL and (end.numpy() == UNWRITTEN).all()
            return None
        assert (end.numpy()[found:] == UNWRITTEN).all()
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

    def packed_links(self, pairs, deal):
        """Shortcuts numbered within their channels, as the kernels have them, by name."""
        packed = np.concatenate([p + a for p, a in zip(pairs, self.start[:-1], strict=True)])
        links = np.bincount(packed[:, 0], minlength=self.capacity)
        by_share = np.bincount(self.share_of(deal), links[: self.count], self.shares(deal))
        first = np.full(self.capacity, UNWRITTEN)
        i, at = np.unique(packed[:, 0], return_index=True)
        first[i] = at
        arrays = {
            "links": links,
            "first": first,
            "by_share": by_share,
            "total": np.cumsum(by_share),
            "by_channel": [len(p) for p in pairs],
            "begin": packed[:, 0],
            "end": packed[:, 1],
        }
        return {name: to_device(np.array(a), wp.int32, self.device) for name, a in arrays.items()}

    def linked_chunks(self, given, deal):
        """1 for the chunks in which shortcuts begin or end."""
        flags = np.zeros(self.chunks(deal), int)
        if isinstance(deal, int):
            flags[given["begin"].numpy() // deal] = flags[given["end"].numpy() // deal] = 1
        return flags

    def weighed(self, pairs, deal):
        """What each shortcut saves, in the order of the list; checks the chunks where any begins or ends."""
        chunks = self.chunks(deal)
        arc, length = (unwritten(n, wp.float64, self.device) for n in (self.capacity, chunks))
        kernel = resampling.build(self.scalar).measure_arcs
        self.launch(kernel, deal, [self.channel_start, self.step, ..., self.points], [arc, length])
        offset = to_device(np.cumsum(length.numpy()), wp.float64, self.device)
        given, ends = self.packed_links(pairs, deal), self.zeros(chunks)
        saving = unwritten(given["begin"].shape[0], wp.float64, self.device)
        inputs = [..., self.points, arc, offset, given["total"], given["begin"], given["end"]]
        self.launch(self.kernel.weigh_shortcuts, deal, inputs, [saving, ends])
        expected = self.linked_chunks(given, deal)
        np.testing.assert_array_equal(ends.numpy(), expected)
        return saving.numpy()

    def path(self, pairs, saving, deal=64, room=None, head=None, ends_at=None):
        """Shortcuts on the shortest path by channel, each where it begins; checks the counts.

        ``room``: so many are listed at most; ``head`` and ``ends_at``: heads of rings and marks at their ends.
        """
        chunks, channels, given = self.chunks(deal), len(self.lines), self.packed_links(pairs, deal)
        ends = self.linked_chunks(given, deal)
        before = self.zeros(self.capacity) if ends_at is None else ends_at
        neck, necks = self.ints(), self.zeros(chunks)
        neck.fill_(-1)
        saved = unwritten(self.capacity, wp.float64, self.device)
        cuts, points = self.ints(channels), self.ints(channels)
        inputs = [self.channel_start, ..., head, given["links"], given["first"], given["total"]]
        inputs += [given["by_channel"], to_device(ends, wp.int32, self.device), given["end"][:room]]
        inputs += [to_device(saving, wp.float64, self.device)]
        outputs = [before, saved, neck, necks, cuts, points]
        self.launch(routes.build(self.scalar).find_path, deal, inputs, outputs, by_channel=True)
        kept = []
        for first, own in zip(self.start[:-1], self.by_channel(neck.numpy()), strict=True):
            kept.append([(int(i), int(own[i] - first)) for i in np.flatnonzero(own >= 0)])
        assert cuts.numpy().tolist() == [len(k) for k in kept]
        sizes = [[j - i + 1 + (len(xy) if j < i else 0) for i, j in k] for xy, k in zip(self.lines, kept, strict=True)]
        assert points.numpy().tolist() == [sum(size) for size in sizes]
        counted = np.zeros(chunks, int)
        if isinstance(deal, int):
            np.add.at(counted, np.flatnonzero(neck.numpy() >= 0) // deal, 1)
        assert (necks.numpy() == counted).all()
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
        for ordered in (0, 1) if device == "cpu" else (0,):
            for channel, pairs in enumerate(case.shortcuts(1.5, 3.0, cone, deal, ordered)):
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
    for channel, pairs in enumerate(case.shortcuts(radius, min_arc, cone, deal, 1)):
        assert pairs.tolist() == expected[channel].tolist(), f"channel {channel}"


@pytest.mark.parametrize("deal", [64, "one slab", "a slab each, apart"])
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


@pytest.mark.parametrize("deal", DEALS)
def test_ties_by_hand(device, deal):
    case = Case([np.zeros((12, 2))], device=device)
    for links, saving, expected in (
        ([(2, 10), (4, 10)], [5.0, 5.0], [(2, 10)]),  # equally good: the one that begins upstream
        ([(1, 5)], [0.0], []),  # saves nothing: the channel stays
        ([(0, 5), (0, 9), (5, 9)], [2.0, 4.0, 2.0], [(0, 9)]),  # a chain of two is no better than one
        ([(0, 5), (0, 9), (5, 9)], [2.0, 4.0, 2.5], [(0, 5), (5, 9)]),  # end to end: they share a point
        ([(0, 6), (1, 4), (5, 9)], [3.0, 2.0, 2.0], [(1, 4), (5, 9)]),  # two short ones beat one long one
    ):
        assert case.path([np.array(links)], np.array(saving), deal)[0] == expected
