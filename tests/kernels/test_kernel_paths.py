"""Shortest-path kernels against the twins in reference_paths.py: all pairs, dense sums, scipy's graph search."""

import dataclasses

import numpy as np
import pytest
import reference
import reference_paths as twin
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import CHUNKS, SCALARS, UNWRITTEN, chunk_count, forms, split, starts_of, to_device, unwritten
from reference_paths import PathLaw

from warpriver.kernels import cutoffs, paths, resampling

SPACING = 10.0
FAULT_SHORTCUTS_FULL = 3
# A push is a sum over some hundred points; relative to the largest of the channel.
SUM_TOLERANCE, SUM_TOLERANCE_32 = 1e-12, 3e-5
# A coordinate of a moved point: a few units in the last place of some kilometres.
MOVE_TOLERANCE, MOVE_TOLERANCE_32 = 4e-12, 1e-3


def wandering_line(rng, count, curl=0.9, start=(0.0, 0.0)):
    """A line whose heading wanders: it comes close to itself often, and crosses itself."""
    heading = np.cumsum(rng.normal(0.0, curl, count - 1))
    steps = SPACING * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([[start], np.asarray(start) + np.cumsum(steps, axis=0)])


def varying_sections(rng, counts):
    return [np.stack([rng.uniform(5.0, 30.0, n), np.ones(n)], axis=1) for n in counts]


class Case:
    """Some channels on a device, and the kernels of a step by shortest paths, one method each."""

    def __init__(self, lines, *, width=12.0, sections=None, dtype="float64", device="cpu", spare=5):
        self.scalar = SCALARS[dtype]
        self.kernel, self.device, self.lines = paths.build(self.scalar), device, lines
        self.start = starts_of(lines)
        self.count, self.capacity = int(self.start[-1]), int(self.start[-1]) + spare
        packed = np.full((self.capacity, 2), np.nan)
        packed[: self.count] = np.concatenate(lines)
        self.points = to_device(packed, self.kernel.vec2, device)
        self.mean = self.widest = np.broadcast_to(np.float64(width), len(lines))
        self.sections, self.section = sections, None
        if sections is not None:
            self.mean = np.array([s[:, 0].mean() for s in sections])
            self.widest = np.array([s[:, 0].max() for s in sections])
            filled = np.concatenate([*sections, np.full((spare, 2), np.nan)])
            self.section = to_device(filled, self.kernel.vec2, device)
        self.channel_start = to_device(self.start, wp.int32, device)
        self.form = forms(self.mean, np.nan, self.widest, np.nan, self.scalar, device)
        self.spacing = to_device(np.full(len(lines), SPACING), self.scalar, device)

    def ints(self, count=None):
        return unwritten(self.capacity if count is None else count, wp.int32, self.device)

    def widths(self):
        """Width at each point by channel."""
        if self.sections is not None:
            return [s[:, 0] for s in self.sections]
        return [np.full(len(xy), w) for xy, w in zip(self.lines, self.mean, strict=True)]

    def launch(self, kernel, threads, inputs, outputs):
        wp.launch(kernel, dim=threads, inputs=inputs, outputs=outputs, device=self.device)

    def device_law(self, law):
        struct = self.kernel.PathLaw()
        for name, value in dataclasses.asdict(law).items():
            setattr(struct, name, value)
        return struct

    def pushes(self, law, chunk=64):
        """Pushes and pulls by channel, blurred downstream."""
        out = unwritten(self.capacity, self.kernel.vec4, self.device)
        inputs = [self.points, self.section, self.channel_start, self.form, self.spacing, self.device_law(law), chunk]
        self.launch(self.kernel.compute_push, chunk_count(self.capacity, chunk), inputs, [out])
        return self.by_channel(out)

    def shifted(self, law, halves, chunk=64):
        """Points by channel after a step with those pushes and pulls."""
        packed = np.concatenate([*halves, np.full((self.capacity - self.count, 4), np.nan)])
        out = unwritten(self.capacity, self.kernel.vec2, self.device)
        inputs = [self.points, self.section, self.channel_start, self.form, self.spacing, None]
        inputs += [self.kernel.RasterGrid(), self.device_law(law), chunk]
        inputs += [to_device(packed, self.kernel.vec4, self.device)]
        self.launch(self.kernel.shift_points, chunk_count(self.capacity, chunk), inputs, [out])
        return self.by_channel(out)

    def by_channel(self, out):
        packed = out.numpy().astype(np.float64)
        assert np.isfinite(packed[: self.count]).all() and np.isnan(packed[self.count :]).all()
        return split(packed, self.start)

    def shortcut_law(self, radius, min_arc, cone):
        law = self.kernel.ShortcutLaw()
        law.radius, law.min_arc = radius, min_arc
        law.cone = np.cos(np.radians(cone)) ** 2 if cone < 90.0 else 0.0
        return law

    def linked(self, radius, chunk):
        """Grid of the points: (next, head)."""
        after, head = self.ints(), wp.zeros(4 * self.capacity, dtype=wp.int32, device=self.device)
        inputs = [self.channel_start, self.form, radius, chunk, self.points]
        kernel = cutoffs.build(self.scalar).insert_points
        self.launch(kernel, chunk_count(self.capacity, chunk), inputs, [after, head])
        return after, head

    def counted(self, radius, min_arc, cone, chunk=64, ordered=0):
        """Grid, shortcuts that begin at each point, and their running sum over the chunks; checks what is cleared."""
        threads = chunk_count(self.capacity, chunk)
        near = [self.points, self.section, *self.linked(radius, chunk)]
        law = self.shortcut_law(radius, min_arc, cone)
        points, chunks = [self.ints() for _ in range(3)], [self.ints(threads) for _ in range(3)]
        inputs = [self.channel_start, self.form, self.spacing, law, chunk, ordered, *near]
        self.launch(self.kernel.count_shortcuts, threads, inputs, [*points, *chunks])
        links, neck, before = (a.numpy() for a in points)
        assert (links[self.count :] == UNWRITTEN).all()
        assert (neck[: self.count] == -1).all() and (before[: self.count] == 0).all()
        by_chunk, ends, necks = (a.numpy() for a in chunks)
        flat = np.zeros(threads * chunk, int)
        flat[: self.count] = links[: self.count]
        assert (by_chunk == flat.reshape(threads, chunk).sum(axis=1)).all()
        assert (ends == 0).all() and (necks == 0).all()
        return law, near, points[0], to_device(np.cumsum(by_chunk), wp.int32, self.device)

    def shortcuts(self, radius, min_arc, cone, chunk=64, ordered=0, room=None):
        """Pairs by channel, numbered within the channel, in the order of the list."""
        law, near, links, total = self.counted(radius, min_arc, cone, chunk, ordered)
        found = int(total.numpy()[-1])
        room = found + 3 if room is None else room
        begin, end, fault = self.ints(room), self.ints(room), wp.zeros(1, dtype=wp.int32, device=self.device)
        inputs = [self.channel_start, self.form, self.spacing, law, chunk, *near, links, total]
        self.launch(self.kernel.list_shortcuts, chunk_count(self.capacity, chunk), inputs, [begin, end, fault])
        if fault.numpy()[0] != 0:
            assert fault.numpy()[0] == FAULT_SHORTCUTS_FULL and (end.numpy() == UNWRITTEN).all()
            return None
        assert (end.numpy()[found:] == UNWRITTEN).all()
        pairs = np.stack([begin.numpy()[:found], end.numpy()[:found]], axis=1)
        owner = np.searchsorted(self.start, pairs[:, 0], side="right") - 1
        return [pairs[owner == c] - a for c, a in enumerate(self.start[:-1])]

    def twin_shortcuts(self, radius, min_arc, cone):
        found = []
        for xy, width in zip(self.lines, self.widths(), strict=True):
            mean = 0.5 * (width[:, None] + width)
            found.append(twin.find_shortcuts(xy, SPACING, radius * mean, min_arc * mean, cone))
        return found

    def packed_links(self, pairs, chunk):
        """Device arrays of shortcuts numbered within their channels: (links a point, a chunk, their sum, from, to)."""
        packed = np.concatenate([p + a for p, a in zip(pairs, self.start[:-1], strict=True)])
        threads = chunk_count(self.capacity, chunk)
        links = np.full(threads * chunk, 0)
        np.add.at(links, packed[:, 0], 1)
        by_chunk = links.reshape(threads, chunk).sum(axis=1)
        arrays = [links[: self.capacity], by_chunk, np.cumsum(by_chunk), packed[:, 0], packed[:, 1]]
        return [to_device(a, wp.int32, self.device) for a in arrays]

    def weighed(self, pairs, chunk):
        """What each shortcut saves, in the order of the list, and the chunks where one ends."""
        threads = chunk_count(self.capacity, chunk)
        arc, length = (unwritten(n, wp.float64, self.device) for n in (self.capacity, threads))
        kernel = resampling.build(self.scalar).measure_chunks
        self.launch(kernel, threads, [self.channel_start, len(self.lines), chunk, self.points], [arc, length])
        offset = to_device(np.cumsum(length.numpy()), wp.float64, self.device)
        _, _, total, begin, end = self.packed_links(pairs, chunk)
        saving = unwritten(begin.shape[0], wp.float64, self.device)
        ends = wp.zeros(threads, dtype=wp.int32, device=self.device)
        inputs = [chunk, self.points, arc, offset, total, begin, end]
        self.launch(self.kernel.weigh_shortcuts, threads, inputs, [saving, ends])
        assert (np.flatnonzero(ends.numpy()) == np.unique(end.numpy() // chunk)).all()
        return saving.numpy()

    def path(self, pairs, saving, chunk=64):
        """Shortcuts on the shortest path by channel; checks the counts."""
        threads, channels = chunk_count(self.capacity, chunk), len(self.lines)
        links, by_chunk, total, _, end = self.packed_links(pairs, chunk)
        ends = np.zeros(threads, int)
        ends[end.numpy() // chunk] = 1
        zeros = [np.zeros(self.capacity), np.full(self.capacity, -1), np.zeros(threads)]
        before, neck, necks = (to_device(v, wp.int32, self.device) for v in zeros)
        saved = unwritten(self.capacity, wp.float64, self.device)
        cuts, points = self.ints(channels), self.ints(channels)
        inputs = [self.channel_start, chunk, links, by_chunk, total, to_device(ends, wp.int32, self.device), end]
        inputs += [to_device(saving, wp.float64, self.device)]
        self.launch(self.kernel.find_path, channels, inputs, [before, saved, neck, necks, cuts, points])
        kept = []
        for first, own in zip(self.start[:-1], split(neck.numpy(), self.start), strict=True):
            kept.append([(int(i), int(own[i] - first)) for i in np.flatnonzero(own >= 0)])
        assert cuts.numpy().tolist() == [len(k) for k in kept]
        assert points.numpy().tolist() == [sum(j - i + 1 for i, j in k) for k in kept]
        flags = np.zeros(threads * chunk, int)
        flags[: self.count] = neck.numpy()[: self.count] >= 0
        assert (necks.numpy() == flags.reshape(threads, chunk).sum(axis=1)).all()
        return kept


# ---- push


@pytest.mark.parametrize("chunk", CHUNKS)
@pytest.mark.parametrize("varies", [False, True])
def test_push_and_shift_match_the_twins(device, dtype, chunk, varies):
    rng = np.random.default_rng(3)
    counts = (3, 4, 130, 3, 67, 300, 5)
    lines = [wandering_line(rng, n, curl=0.3) for n in counts]
    sections = varying_sections(rng, counts) if varies else None
    case, law = Case(lines, sections=sections, dtype=dtype, device=device), PathLaw(time_step=0.05)
    sums, moves = (SUM_TOLERANCE, MOVE_TOLERANCE) if dtype == "float64" else (SUM_TOLERANCE_32, MOVE_TOLERANCE_32)
    halves = [twin.compute_push(xy, SPACING, w, law) for xy, w in zip(lines, case.widths(), strict=True)]
    for actual, expected in zip(case.pushes(law, chunk), halves, strict=True):
        assert np.abs(actual - expected).max() <= sums * np.abs(expected).max()
    rows = zip(case.shifted(law, halves, chunk), lines, halves, case.mean, case.widths(), strict=True)
    for actual, xy, half, mean, width in rows:
        expected = twin.shift_points(xy, half, SPACING, mean, width, law)
        np.testing.assert_allclose(actual, expected, rtol=0.0, atol=moves)
        assert (actual[[0, -1]] == np.asarray(xy[[0, -1]], self_type(dtype))).all(), "an end moved"


def self_type(dtype):
    return np.float64 if dtype == "float64" else np.float32


def test_the_two_recurrences_solve_the_implicit_smoothing(device):
    """Away from the ends, one way down and one up are (1 - c d2)^-1, here as a dense system, for push and pull."""
    rng = np.random.default_rng(5)
    xy = wandering_line(rng, 400, curl=0.2)
    law = PathLaw(end_damping=0.0)
    case = Case([xy], device=device)
    width = case.widths()[0]
    moved = case.shifted(law, case.pushes(law))[0] - xy
    blur, share = (law.blur_length * 12.0 / SPACING) ** 2, twin.roots(xy, SPACING, width, law)[2][0]
    push, pull = twin.pushes(xy, width, law), share * np.diff(reference.reflect_ends(xy, 1), n=2, axis=0)
    dense = [reference.implicit_smoothing(v.T[k], c) for k in range(2) for v, c in ((push, blur), (pull, share))]
    expected = np.stack([dense[0] + dense[1], dense[2] + dense[3]], axis=1)
    # What an end does differently fades as r^n: r = 0.57 and 0.62 here, below 1e-14 after 70 points.
    np.testing.assert_allclose(moved[70:-70], expected[70:-70], rtol=0.0, atol=1e-11)


def test_a_line_that_doubles_back_is_pushed_by_nothing_undefined(device, dtype):
    there = np.stack([SPACING * np.arange(20), np.zeros(20)], axis=1)
    xy = np.concatenate([there, there[-2::-1]])
    halves = Case([xy], dtype=dtype, device=device).pushes(PathLaw())
    assert np.isfinite(halves[0]).all()


# ---- shortcuts


@pytest.mark.parametrize("chunk", CHUNKS)
@pytest.mark.parametrize("cone", [10.0, 45.0, 90.0])
def test_shortcuts_match_all_pairs(device, chunk, cone):
    """Channels on top of each other, some so short that two cells share a bucket: each pair once, in order."""
    rng = np.random.default_rng(7)
    lines = [wandering_line(rng, n, curl) for n, curl in ((3, 1), (9, 1.5), (120, 0.9), (12, 2), (300, 0.5), (33, 1))]
    case = Case(lines, width=np.array([12.0, 30.0, 12.0, 25.0, 15.0, 40.0]), device=device)
    expected = case.twin_shortcuts(1.5, 3.0, cone)
    assert sum(len(p) for p in expected) > 50
    for ordered in (0, 1) if device == "cpu" else (0,):
        for channel, pairs in enumerate(case.shortcuts(1.5, 3.0, cone, chunk, ordered)):
            assert pairs.tolist() == expected[channel].tolist(), f"channel {channel}"


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.integers(3, 120), min_size=1, max_size=5),
    chunk=st.integers(1, 150),
    seed=st.integers(0, 2**32 - 1),
    curl=st.floats(0.05, 2.0),
    radius=st.floats(0.05, 2.5),
    slack=st.floats(0.001, 4.0),
    cone=st.floats(1.0, 90.0),
    varies=st.booleans(),
)
def test_any_shortcuts_match_all_pairs(counts, chunk, seed, curl, radius, slack, cone, varies):
    rng = np.random.default_rng(seed)
    lines = [wandering_line(rng, n, curl) for n in counts]
    case = Case(lines, sections=varying_sections(rng, counts) if varies else None)
    min_arc = max(1.0, radius) + slack
    expected = case.twin_shortcuts(radius, min_arc, cone)
    for channel, pairs in enumerate(case.shortcuts(radius, min_arc, cone, chunk, 1)):
        assert pairs.tolist() == expected[channel].tolist(), f"channel {channel}"


def test_too_little_room_is_flagged_and_nothing_written(device):
    case = Case([wandering_line(np.random.default_rng(1), 300)], device=device)
    found = len(case.shortcuts(1.5, 3.0, 90.0)[0])
    assert case.shortcuts(1.5, 3.0, 90.0, room=found - 1) is None
    assert len(case.shortcuts(1.5, 3.0, 90.0, room=found)[0]) == found


@pytest.mark.parametrize("chunk", CHUNKS)
def test_savings_are_arc_less_chord(device, chunk):
    rng = np.random.default_rng(11)
    case = Case([wandering_line(rng, n) for n in (150, 3, 200, 64)], device=device)
    pairs = case.twin_shortcuts(1.5, 3.0, 90.0)
    expected = np.concatenate([twin.savings(xy, p) for xy, p in zip(case.lines, pairs, strict=True)])
    # Arc lengths are sums of some hundred segments of 10 m.
    np.testing.assert_allclose(case.weighed(pairs, chunk), expected, rtol=0.0, atol=4e-12)


# ---- the shortest path


@pytest.mark.parametrize("chunk", CHUNKS)
def test_path_is_as_short_as_scipys(device, chunk):
    rng = np.random.default_rng(13)
    case = Case([wandering_line(rng, n, c) for n in (150, 3, 200, 64, 9) for c in (0.4, 1.0)], device=device)
    pairs = case.twin_shortcuts(2.0, 3.0, 90.0)
    kept = case.path(pairs, case.weighed(pairs, chunk), chunk)
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
    chunk=st.integers(1, 50),
    seed=st.integers(0, 2**32 - 1),
    density=st.floats(0.0, 0.3),
)
def test_any_links_with_ties_give_the_twins_route(counts, chunk, seed, density):
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
    kept = case.path(pairs, np.concatenate(saving), chunk)
    for n, links, gain, cut in zip(counts, pairs, saving, kept, strict=True):
        assert cut == twin.best_chain(n, links, gain)[0]


@pytest.mark.parametrize("chunk", CHUNKS)
def test_ties_by_hand(device, chunk):
    case = Case([np.zeros((12, 2))], device=device)
    for links, saving, expected in (
        ([(2, 10), (4, 10)], [5.0, 5.0], [(2, 10)]),  # equally good: the one that begins upstream
        ([(1, 5)], [0.0], []),  # saves nothing: the channel stays
        ([(0, 5), (0, 9), (5, 9)], [2.0, 4.0, 2.0], [(0, 9)]),  # a chain of two is no better than one
        ([(0, 5), (0, 9), (5, 9)], [2.0, 4.0, 2.5], [(0, 5), (5, 9)]),  # end to end: they share a point
        ([(0, 6), (1, 4), (5, 9)], [3.0, 2.0, 2.0], [(1, 4), (5, 9)]),  # two short ones beat one long one
    ):
        assert case.path([np.array(links)], np.array(saving), chunk)[0] == expected
