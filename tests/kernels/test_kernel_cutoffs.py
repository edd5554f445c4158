"""Cutoff kernels against comparing all pairs of points, a sweep down each channel, and cuts done one by one."""

import numpy as np
import pytest
import reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import (
    DEALS,
    REALS,
    SCALARS,
    SLABS,
    UNWRITTEN,
    by_fours,
    forms,
    nested,
    ring_flags,
    share_count,
    share_out,
    split,
    starts_of,
    to_device,
    unwritten,
)

from warpriver.kernels import buckets, cutoffs
from warpriver.kernels.polyline import FAULT

SPACING = 10.0
FAULT_OXBOWS_FULL = 2


def wandering_line(rng, count, curl=0.9, start=(0.0, 0.0)):
    """A line whose heading wanders: it comes close to itself often, crosses itself, and lies on both sides of zero."""
    heading = np.cumsum(rng.normal(0.0, curl, count - 1))
    steps = SPACING * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([[start], np.asarray(start) + np.cumsum(steps, axis=0)])


def orders(device):
    """Points lie in the lists in order only where a launch is one serial loop."""
    return (0, 1) if device == "cpu" else (0,)


class Case:
    """Some channels on a device, and the four kernels of a cutoff, one method each; lists of channels in and out."""

    def __init__(
        self,
        lines,
        *,
        width=12.0,
        sections=None,
        cutoff=1.0,
        min_arc=3.0,
        resting=(),
        rings=(),
        longer=0,
        dtype="float64",
        device="cpu",
        spare=5,
    ):
        self.resting, self.rings, self.longer = resting, rings, longer
        self.closed = ring_flags(rings, len(lines), device)
        self.scalar = SCALARS[dtype]
        self.kernel, self.device, self.lines = cutoffs.build(self.scalar), device, lines
        self.cutoff, self.min_arc, self.start = cutoff, min_arc, starts_of(lines)
        self.count, self.capacity = int(self.start[-1]), int(self.start[-1]) + spare
        packed = np.full((self.capacity, 2), np.nan)
        packed[: self.count] = np.concatenate(lines)
        self.packed = packed
        self.width = np.broadcast_to(np.float64(width), len(lines))
        self.sections, self.section = sections, None
        if sections is not None:
            self.width = np.array([s[:, 0].max() for s in sections])
            filled = np.concatenate([*sections, np.full((spare, 2), np.nan)])
            self.section = to_device(filled, self.kernel.vec2, device)
        self.channel_start = to_device(self.start, wp.int32, device)
        # Only the greatest width is for the cutoffs; the mean of a varying one would be wrong here.
        self.form = forms(np.nan, np.nan, self.width, np.nan, self.scalar, device)
        self.channel_spacing = to_device(np.full(len(lines), SPACING), self.scalar, device)
        step = np.full(len(lines), 0.3)
        step[list(resting)] = 0.0
        self.channel_step = to_device(step, self.scalar, device)

    def parts(self, deal):
        return share_out(deal, len(self.lines), self.capacity, self.device)

    def launch_points(self, kernel, deal, inputs, outputs):
        """Launch a kernel over the points; ``...`` stands for the work among the inputs."""
        for part in self.parts(deal):
            given = [part.work if value is ... else value for value in inputs]
            wp.launch(kernel, dim=part.threads, inputs=given, outputs=outputs, device=self.device)

    def launch_channels(self, kernel, deal, inputs, outputs, before=()):
        """Launch a kernel over the channels; after the start, and what is to come before it, comes the work."""
        for part in self.parts(deal):
            given = [self.channel_start, *before, part.work, *inputs]
            wp.launch(kernel, dim=part.channel_threads, inputs=given, outputs=outputs, device=self.device)

    def linked(self, deal=64):
        """Grid of the points: (next, head) on the device."""
        points = to_device(self.packed, self.kernel.vec2, self.device)
        after = unwritten(self.capacity, wp.int32, self.device)
        head = wp.zeros(4 * self.capacity, dtype=wp.int32, device=self.device)
        if not isinstance(deal, int):
            # A slab empties the table of its own channels.
            head.fill_(UNWRITTEN)
        inputs = [self.channel_start, self.form, self.channel_step, self.cutoff, ..., points]
        self.launch_points(self.kernel.insert_points, deal, inputs, [after, by_fours(head), head])
        return after, head

    def necks(self, deal=64, ordered=0):
        """First later neighbour of each point by channel, numbered within the channel; checks the counts.

        Necks of a channel at rest are not written, and count as none here.
        """
        after, head = self.linked(deal)
        points = to_device(self.packed, self.kernel.vec2, self.device)
        neck = unwritten(self.capacity, wp.int32, self.device)
        # Chunks add to what was cleared before, slabs write.
        chunk_necks, channel_necks = (
            wp.zeros(n, dtype=wp.int32, device=self.device)
            for n in (share_count(deal, len(self.lines), self.capacity), len(self.lines))
        )
        if not isinstance(deal, int):
            chunk_necks.fill_(UNWRITTEN)
            channel_necks.fill_(UNWRITTEN)
        inputs = [self.channel_start, self.form, self.channel_spacing, self.channel_step, self.closed, self.cutoff]
        inputs += [self.min_arc, ..., ordered, points, self.section, after, head]
        self.launch_points(self.kernel.find_necks, deal, inputs, [neck, chunk_necks, channel_necks])
        found = neck.numpy()
        assert (found[self.count :] == UNWRITTEN).all()
        for c in self.resting:
            first, stop = self.start[c : c + 2]
            assert (found[first:stop] == UNWRITTEN).all(), "a channel at rest was searched"
            found[first:stop] = -1
        assert (found[: self.count] >= -1).all()
        by_channel = split(found, self.start)
        assert channel_necks.numpy().tolist() == [int((n >= 0).sum()) for n in by_channel]
        if isinstance(deal, int):
            assert (chunk_necks.numpy() == self.by_chunk(found, deal)).all()
        else:
            assert (chunk_necks.numpy() == UNWRITTEN).all()
        return [np.where(n >= 0, n - a, -1) for n, a in zip(by_channel, self.start[:-1], strict=True)]

    def by_chunk(self, point_neck, chunk):
        """Number of necks that begin in each chunk."""
        flags = np.zeros(share_count(chunk, len(self.lines), self.capacity) * chunk, int)
        flags[: self.count] = point_neck[: self.count] >= 0
        return flags.reshape(-1, chunk).sum(axis=1)

    def twin_necks(self):
        """The same by comparing all pairs."""
        necks = []
        for c, xy in enumerate(self.lines):
            width = np.full(len(xy), self.width[c]) if self.sections is None else self.sections[c][:, 0]
            mean = 0.5 * (width[:, None] + width)
            necks.append(reference.find_necks(xy, SPACING, self.cutoff * mean, self.min_arc * mean))
        return necks

    def packed_necks(self, necks, deal):
        """Device arrays of necks that are numbered within their channels: by point, by chunk and by channel."""
        point_neck = np.full(self.capacity, UNWRITTEN)
        for c, (first, neck) in enumerate(zip(self.start[:-1], necks, strict=True)):
            if c not in self.resting:
                point_neck[first : first + len(neck)] = np.where(neck >= 0, neck + first, -1)
        by_chunk = self.by_chunk(point_neck, deal) if isinstance(deal, int) else [UNWRITTEN]
        by_channel = [(neck >= 0).sum() for neck in necks]
        return [to_device(v, wp.int32, self.device) for v in (point_neck, by_chunk, by_channel)]

    def selected(self, necks, deal=64):
        """Necks kept, by channel as lists of pairs, from those given; checks the counts."""
        point_neck, chunk_necks, channel_necks = self.packed_necks(necks, deal)
        cuts = unwritten(len(self.lines), wp.int32, self.device)
        points = unwritten(len(self.lines), wp.int32, self.device)
        inputs, before = [chunk_necks, channel_necks], [self.closed, self.longer]
        self.launch_channels(self.kernel.select_cuts, deal, inputs, [cuts, points, point_neck], before)
        left = point_neck.numpy()
        assert (left[self.count :] == UNWRITTEN).all()
        kept = []
        for first, neck in zip(self.start[:-1], split(left, self.start), strict=True):
            kept.append([(int(i), int(neck[i] - first)) for i in np.flatnonzero(neck >= 0)])
        assert cuts.numpy().tolist() == [len(pairs) for pairs in kept]
        assert points.numpy().tolist() == [sum(j - i + 1 for i, j in pairs) for pairs in kept]
        return kept

    def cut(self, kept, deal=64, cut_capacity=None, oxbow_capacity=None, done=0, before=(0, 0)):
        """Cut those pairs: (points by channel, records, loop points, loop sections, fault).

        ``done`` sub-steps left ``before`` cuts and loop points in the buffers.
        """
        necks = [np.full(len(xy), -1) for xy in self.lines]
        for neck, pairs in zip(necks, kept, strict=True):
            for i, j in pairs:
                neck[i] = j
        point_neck, chunk_necks, _ = self.packed_necks(necks, deal)
        cuts = np.cumsum([len(pairs) for pairs in kept])
        # On a ring a loop may go round to an earlier point.
        sizes = [[(j - i) % len(xy) + 1 for i, j in pairs] for xy, pairs in zip(self.lines, kept, strict=True)]
        loop_points = np.cumsum([sum(size) for size in sizes])
        cut_capacity = before[0] + cuts[-1] + 3 if cut_capacity is None else cut_capacity
        oxbow_capacity = before[1] + loop_points[-1] + 3 if oxbow_capacity is None else oxbow_capacity
        records = unwritten(int(cut_capacity), wp.vec4i, self.device)
        loops = unwritten(int(oxbow_capacity), self.kernel.vec2, self.device)
        loop_sections = None
        if self.section is not None:
            loop_sections = unwritten(int(oxbow_capacity), self.kernel.vec2, self.device)
        points = to_device(self.packed, self.kernel.vec2, self.device)
        status = to_device([0, 0, done, *before, 0, 1, 0], wp.int32, self.device)
        sums = [to_device(v, wp.int32, self.device) for v in (cuts, loop_points)]
        inputs = [chunk_necks, *sums, point_neck, self.section]
        self.launch_channels(self.kernel.cut_necks, deal, inputs, [records, loops, loop_sections, points, status])
        after = points.numpy()
        assert np.isnan(after[self.count :]).all()
        loop_sections = None if loop_sections is None else loop_sections.numpy()
        return split(after, self.start), records.numpy(), loops.numpy(), loop_sections, int(status.numpy()[FAULT])


def assert_same_necks(actual, expected):
    for channel, (a, e) in enumerate(zip(actual, expected, strict=True)):
        assert a.tolist() == e.tolist(), f"channel {channel}"


# ---- the grid


def test_floor_of_positive_negative_and_whole_numbers(device, dtype):
    scalar = SCALARS[dtype]
    floor_int = buckets.build(scalar).floor_int

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(x: wp.array[scalar], floor_out: wp.array[int]):
        i = wp.tid()
        floor_out[i] = floor_int(x[i])

    tiny = float(np.finfo(REALS[dtype]).tiny)
    x = np.array([-1e6 - 0.5, -3.0, -2.5, -1.0, -tiny, 0.0, tiny, 0.5, 1.0, 2.5, 3.0, 1e6 + 0.5])
    out = unwritten(len(x), wp.int32, device)
    wp.launch(evaluate, dim=len(x), inputs=[to_device(x, scalar, device)], outputs=[out], device=device)
    assert out.numpy().tolist() == np.floor(x).astype(int).tolist()


def test_a_channel_has_more_than_two_buckets_a_point_and_at_most_four():
    bucket_mask = nested(cutoffs.build(wp.float64).insert_points, "bucket_mask")

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(mask_out: wp.array[int]):
        i = wp.tid()
        mask_out[i] = bucket_mask(i)

    out = unwritten(5000, wp.int32, "cpu")
    wp.launch(evaluate, dim=5000, outputs=[out], device="cpu")
    size, points = out.numpy()[3:] + 1, np.arange(3, 5000)
    assert (np.bitwise_count(size) == 1).all()
    assert ((2 * points < size) & (size <= 4 * points)).all()


@pytest.mark.parametrize("deal", DEALS)
def test_every_point_is_in_one_list_of_its_own_channel(device, deal):
    """Lists hold every point once, those of a channel lie in its own part of the table, and equal cells share one."""
    rng = np.random.default_rng(1)
    lines = [wandering_line(rng, n) for n in (3, 40, 3, 3, 157, 64, 5)]
    case = Case(lines, device=device)
    after, head = (a.numpy() for a in case.linked(deal))
    assert (after[case.count :] == UNWRITTEN).all()
    assert (after[: case.count] >= 0).all(), "a list ends in what was there before"
    for a, b in zip(case.start[:-1], case.start[1:], strict=True):
        mask = (1 << int(2 * (b - a)).bit_length()) - 1
        beyond = 0 if isinstance(deal, int) else UNWRITTEN
        assert (head[4 * a : 4 * a + mask + 1] >= 0).all() and (head[4 * a + mask + 1 : 4 * b] == beyond).all()
    bucket_of = np.full(case.count, -1)
    for bucket in np.flatnonzero(head > 0):
        point, previous = head[bucket] - 1, case.count
        while point >= 0:
            assert bucket_of[point] == -1
            bucket_of[point] = bucket
            if device == "cpu":
                assert point < previous, "a list is not in order"
            previous, point = point, after[point] - 1
    cells = np.floor(case.packed / (2.0 * 12.0))
    for a, b in zip(case.start[:-1], case.start[1:], strict=True):
        assert ((4 * a <= bucket_of[a:b]) & (bucket_of[a:b] < 4 * b)).all()
        _, cell = np.unique(cells[a:b], axis=0, return_inverse=True)
        for members in (np.flatnonzero(cell == k) for k in range(cell.max() + 1)):
            assert len(set(bucket_of[a:b][members])) == 1


# ---- finding necks


@pytest.mark.parametrize("deal", DEALS)
def test_necks_match_all_pairs(device, deal):
    """Nine channels on top of each other: none finds a point of another."""
    rng = np.random.default_rng(7)
    lines = [wandering_line(rng, n) for n in (3, 4, 120, 3, 300, 5, 64, 128, 33)]
    width = np.array([12.0, 30.0, 12.0, 25.0, 15.0, 40.0, 12.0, 9.0, 60.0])
    case = Case(lines, width=width, device=device)
    expected = case.twin_necks()
    assert sum((neck >= 0).sum() for neck in expected) > 100
    for ordered in orders(device):
        assert_same_necks(case.necks(deal, ordered), expected)


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.integers(3, 120), min_size=1, max_size=5),
    deal=st.one_of(st.integers(1, 150), st.sampled_from(SLABS)),
    seed=st.integers(0, 2**32 - 1),
    curl=st.floats(0.05, 2.0),
    cutoff=st.floats(0.05, 2.5),
    slack=st.floats(0.001, 4.0),
    shift=st.floats(-1e5, 1e5),
    varies=st.booleans(),
)
def test_any_necks_match_all_pairs(counts, deal, seed, curl, cutoff, slack, shift, varies):
    rng = np.random.default_rng(seed)
    lines = [wandering_line(rng, n, curl, (shift, -shift)) for n in counts]
    sections = [np.stack([rng.uniform(5.0, 30.0, n), np.ones(n)], axis=1) for n in counts] if varies else None
    case = Case(lines, sections=sections, cutoff=cutoff, min_arc=max(1.0, cutoff) + slack)
    expected = case.twin_necks()
    for ordered in (0, 1):
        assert_same_necks(case.necks(deal, ordered), expected)


def test_parallel_channels_within_reach_of_each_other_are_not_necks(device):
    """A hundred lines 1 m apart, 12 m wide: each is straight, so none has a neck."""
    lines = [np.stack([SPACING * np.arange(20), np.full(20, float(c))], axis=1) for c in range(100)]
    assert all((neck == -1).all() for neck in Case(lines, device=device).necks())


@pytest.mark.parametrize("deal", DEALS)
def test_channels_at_rest_are_not_searched(device, deal):
    """Neither inserted nor searched; the others find what they find among themselves, and are cut as without them."""
    rng = np.random.default_rng(8)
    lines = [wandering_line(rng, n, curl=1.2) for n in (3, 120, 4, 90, 3, 200, 64, 130, 3)]
    sections = [rng.uniform(8.0, 20.0, (len(xy), 2)) for xy in lines]
    for resting in ((0, 3, 8), (1, 2, 4, 5, 6), tuple(range(9))):
        case = Case(lines, sections=sections, resting=resting, device=device)
        after, head = (a.numpy() for a in case.linked(deal))
        expected = case.twin_necks()
        for c in resting:
            first, stop = case.start[c : c + 2]
            left = 0 if isinstance(deal, int) else UNWRITTEN
            assert (after[first:stop] == UNWRITTEN).all() and (head[4 * first : 4 * stop] == left).all()
            expected[c][:] = -1
        for ordered in orders(device):
            assert_same_necks(case.necks(deal, ordered), expected)
        kept = [reference.select_cuts(neck) for neck in expected]
        # What an earlier step left in the necks of a channel at rest is not looked at: its count is 0.
        necks, chunk_necks, channel_necks = case.packed_necks(expected, deal)
        necks = necks.numpy()
        for c in resting:
            necks[case.start[c] : case.start[c + 1]] = case.start[c + 1] - 1
        cuts, points = (unwritten(len(lines), wp.int32, device) for _ in range(2))
        inputs, io = [chunk_necks, channel_necks], to_device(necks, wp.int32, device)
        case.launch_channels(case.kernel.select_cuts, deal, inputs, [cuts, points, io], [None, 0])
        assert cuts.numpy().tolist() == [len(pairs) for pairs in kept]
        assert sum(map(len, kept)) > 3 or len(resting) == 9
        assert_cuts(case, kept, deal)


def test_a_hairpin_by_hand(device):
    """Out along y = 0 and back along y = 8: of 12 m wide points the first with a partner in reach and 36 m of arc."""
    out = np.stack([SPACING * np.arange(6), np.zeros(6)], axis=1)
    back = np.stack([SPACING * np.arange(5, -1, -1), np.full(6, 8.0)], axis=1)
    neck = Case([np.concatenate([out, back])], device=device).necks()[0]
    # Point i lies 8 m below point 11 - i, and hypot(8, 10) m is out of reach; 4 and 5 are too near along the channel.
    assert neck.tolist() == [11, 10, 9, 8, -1, -1, -1, -1, -1, -1, -1, -1]


def test_reach_is_the_mean_of_both_widths(device):
    """Points 15 m apart, 10 and 20 m wide, touch when either grows by a millimetre; the channel's greatest is 40 m."""
    out = np.stack([SPACING * np.arange(12), np.zeros(12)], axis=1)
    back = np.stack([SPACING * np.arange(11, -1, -1), np.full(12, 15.0)], axis=1)
    xy = np.concatenate([out, back])
    section = np.ones((24, 2))
    section[12, 0] = 40.0
    section[2, 0], section[21, 0] = 10.0, 20.0
    assert (Case([xy], sections=[section], device=device).necks()[0] == -1).all()
    for k in (2, 21):
        wider = section.copy()
        wider[k, 0] += 0.001
        assert np.flatnonzero(Case([xy], sections=[wider], device=device).necks()[0] >= 0).tolist() == [2]


def test_points_exactly_at_the_cutoff_distance_do_not_touch(device):
    """|p_i - p_j| < w, not <=: whole numbers, so that nothing is rounded."""
    out = np.stack([SPACING * np.arange(8), np.zeros(8)], axis=1)
    for gap, touches in ((16.0, False), (15.0, True)):
        back = np.stack([SPACING * np.arange(7, -1, -1), np.full(8, gap)], axis=1)
        neck = Case([np.concatenate([out, back])], width=16.0, device=device).necks()[0]
        assert (neck >= 0).any() == touches


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(
    spacings=st.floats(0.5, 40.0),
    cutoff=st.floats(0.01, 3.0),
    slack=st.floats(1e-9, 5.0),
    turn=st.floats(0.0, 6.3),
    deal=st.one_of(st.integers(1, 60), st.sampled_from(SLABS)),
)
def test_a_straight_line_is_never_cut(spacings, cutoff, slack, turn, deal):
    """Whatever the width in spacings and the direction, for any least arc from one width up that exceeds the cutoff."""
    x = SPACING * np.arange(150)[:, None] * np.array([np.cos(turn), np.sin(turn)])
    min_arc = max(1.0, cutoff * (1.0 + slack))
    if cutoff >= 1.0:
        min_arc = cutoff * (1.0 + slack)
    case = Case([x - x[75]], width=spacings * SPACING, cutoff=cutoff, min_arc=min_arc)
    assert (case.necks(deal, ordered=1)[0] == -1).all()


def test_a_straight_line_is_not_cut_where_the_arc_is_a_whole_number_of_spacings():
    """w = 3 h, cutoff just under one width, least arc one width: points 3 h apart are as near as allowed."""
    for h_over_w in (3, 5, 7, 10):
        x = np.stack([SPACING * np.arange(60), np.zeros(60)], axis=1)
        case = Case([x], width=h_over_w * SPACING, cutoff=1.0 - 1e-12, min_arc=1.0)
        assert (case.necks()[0] == -1).all()


def test_single_precision_finds_the_same_necks(device):
    """Coordinates in quarters of a metre have exact squares in float32: the answers agree to the point."""
    rng = np.random.default_rng(4)
    lines = [np.round(4.0 * wandering_line(rng, n)) / 4.0 for n in (200, 3, 90)]
    case = Case(lines, width=16.0, dtype="float32", device=device)
    expected = case.twin_necks()
    assert sum((neck >= 0).sum() for neck in expected) > 20
    for deal in (1, 7, 4096, *SLABS):
        assert_same_necks(case.necks(deal), expected)


def test_points_that_are_not_finite_are_no_necks(device):
    """They must not lead outside the table either; resampling then stops the step."""
    rng = np.random.default_rng(0)
    xy = wandering_line(rng, 60)
    xy[20], xy[40] = np.nan, np.inf
    neck = Case([xy], device=device).necks()[0]
    assert neck[20] == neck[40] == -1 and not np.isin(neck, (20, 40)).any()


# ---- selecting


def random_necks(rng, counts, part=0.3):
    """Necks that overlap, nest, meet end to start, and reach the channel's ends."""
    necks = []
    for n in counts:
        neck = np.full(n, -1)
        for i in range(n - 2):
            if rng.random() < part:
                neck[i] = rng.integers(i + 2, min(n, i + 2 + max(1, n // 5)))
        necks.append(neck)
    return necks


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.integers(3, 100), min_size=1, max_size=8),
    deal=st.one_of(st.integers(1, 130), st.sampled_from(SLABS)),
    seed=st.integers(0, 2**32 - 1),
    part=st.floats(0.0, 0.6),
)
def test_selection_is_a_greedy_sweep_and_cuts_match_the_twin(counts, deal, seed, part):
    rng = np.random.default_rng(seed)
    lines = [wandering_line(rng, n) for n in counts]
    case = Case(lines, sections=[rng.uniform(1.0, 9.0, (n, 2)) for n in counts])
    necks = random_necks(rng, counts, part)
    kept = [reference.select_cuts(neck) for neck in necks]
    assert case.selected(necks, deal) == kept
    assert_cuts(case, kept, deal)


def assert_cuts(case, kept, deal):
    """Records, loops, sections and the copies left behind are those of cutting one by one, in order."""
    after, records, loops, loop_sections, fault = case.cut(kept, deal)
    assert fault == 0
    slot = offset = 0
    for c, (xy, pairs) in enumerate(zip(case.lines, kept, strict=True)):
        expected, expected_loops = reference.cut_necks(xy, pairs)
        assert (after[c] == expected).all()
        for (i, j), loop in zip(pairs, expected_loops, strict=True):
            assert records[slot].tolist() == [c, offset, j - i + 1, 0]
            assert (loops[offset : offset + len(loop)] == loop).all()
            if case.sections is not None:
                assert (loop_sections[offset : offset + len(loop)] == case.sections[c][i : j + 1]).all()
            slot, offset = slot + 1, offset + len(loop)
    assert (records[slot:] == UNWRITTEN).all() and np.isnan(loops[offset:]).all()


def test_selection_by_hand():
    """The first neck wins, one inside it falls, one that begins where it ends stays, and so does one at the tail."""
    neck = np.array([-1, 4, 6, -1, 7, -1, -1, 9, -1, -1])
    case = Case([np.zeros((10, 2))])
    assert case.selected([neck]) == [[(1, 4), (4, 7), (7, 9)]]


def test_without_necks_nothing_is_selected():
    case = Case([np.zeros((5, 2)), np.zeros((3, 2))])
    assert case.selected([np.full(5, -1), np.full(3, -1)]) == [[], []]


@pytest.mark.parametrize("deal", DEALS)
def test_cuts_at_heads_tails_and_chunk_boundaries(device, deal):
    """Loops that begin at a channel's first point, end at its last, span several chunks, or end on a boundary."""
    rng = np.random.default_rng(2)
    lines = [wandering_line(rng, n) for n in (20, 3, 65, 130, 3)]
    kept = [[(0, 7), (7, 14), (14, 19)], [(0, 2)], [(0, 64)], [(2, 63), (63, 64), (65, 129)], []]
    case = Case(lines, sections=[rng.uniform(1.0, 9.0, (len(xy), 2)) for xy in lines], device=device)
    assert_cuts(case, kept, deal)


def test_too_many_cuts_or_loop_points_change_nothing_and_set_the_fault(device):
    rng = np.random.default_rng(2)
    lines = [wandering_line(rng, n) for n in (20, 30)]
    kept = [[(0, 7), (9, 14)], [(3, 8)]]
    case = Case(lines, device=device)
    total = 8 + 6 + 6
    for cut_capacity, oxbow_capacity, fails in ((3, total, False), (2, total, True), (3, total - 1, True)):
        after, records, loops, _, fault = case.cut(kept, 7, cut_capacity, oxbow_capacity)
        assert fault == (FAULT_OXBOWS_FULL if fails else 0)
        if fails:
            assert all((a == xy).all() for a, xy in zip(after, lines, strict=True))
            assert (records == UNWRITTEN).all() and np.isnan(loops).all()


def test_cuts_of_a_row_of_sub_steps_come_behind_each_other(device):
    """Each is told when it was; what does not fit behind those before is a fault, too."""
    rng = np.random.default_rng(2)
    lines = [wandering_line(rng, n) for n in (20, 30)]
    kept = [[(0, 7), (9, 14)], [(3, 8)]]
    case = Case(lines, device=device)
    first, again = case.cut(kept), case.cut(kept, done=5, before=(2, 17))
    assert again[4] == 0 and (again[1][:2] == UNWRITTEN).all() and np.isnan(again[2][:17]).all()
    assert (again[1][2:5] == first[1][:3] + np.array([0, 17, 0, 5])).all()
    np.testing.assert_array_equal(again[2][17:], first[2])
    assert case.cut(kept, cut_capacity=4, done=5, before=(2, 17))[4] == FAULT_OXBOWS_FULL
    assert case.cut(kept, oxbow_capacity=36, done=5, before=(2, 17))[4] == FAULT_OXBOWS_FULL


def test_found_necks_are_cut_from_end_to_end(device):
    """All kernels in a row, on lines that wander across themselves."""
    rng = np.random.default_rng(12)
    lines = [wandering_line(rng, n, curl=1.2) for n in (150, 3, 250, 40, 100)]
    results = []
    for deal in DEALS:
        case = Case(lines, width=15.0, device=device)
        kept = case.selected(case.necks(deal), deal)
        assert kept == [reference.select_cuts(neck) for neck in case.twin_necks()]
        assert_cuts(case, kept, deal)
        results.append(kept)
    assert all(kept == results[0] for kept in results) and sum(map(len, results[0])) > 8
