"""The grid of the points and the search for necks, ``find_necks``, against comparing all pairs of points."""

import numpy as np
import pytest
import reference
import warp as wp
from cutoff_case import SPACING, Case, assert_cuts, assert_same_necks, wandering_line
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import (
    DEALS,
    REALS,
    SCALARS,
    SLABS,
    UNWRITTEN,
    list_of_marks,
    running_marks,
    to_device,
    unwritten,
)

from warpriver.kernels import buckets, cutoffs

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
    bucket_mask = buckets.build(wp.float64).bucket_mask

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
    """Lists hold every point once, those of a channel lie in its own part of the table, and equal cells share one.

    In slabs they descend; with chunks each has its highest point beside it.
    """
    rng = np.random.default_rng(1)
    lines = [wandering_line(rng, n) for n in (3, 40, 3, 3, 157, 64, 5)]
    case = Case(lines, device=device)
    after, head = (a.numpy() for a in case.linked(deal))
    fields = 2 if isinstance(deal, int) else 1
    head, highest = head.reshape(-1, fields)[:, 0], head.reshape(-1, fields)[:, -1]
    assert (after[case.count :] == UNWRITTEN).all()
    assert (after[: case.count] >= 0).all(), "a list ends in what was there before"
    for a, b in zip(case.start[:-1], case.start[1:], strict=True):
        mask = (1 << int(2 * (b - a)).bit_length()) - 1
        beyond = 0 if isinstance(deal, int) else UNWRITTEN
        assert (head[4 * a : 4 * a + mask + 1] >= 0).all() and (head[4 * a + mask + 1 : 4 * b] == beyond).all()
    assert ((highest > 0) == (head > 0)).all()
    bucket_of = np.full(case.count, -1)
    for bucket in np.flatnonzero(head > 0):
        point, members = head[bucket] - 1, []
        while point >= 0:
            assert bucket_of[point] == -1
            bucket_of[point] = bucket
            members.append(point)
            point = after[point] - 1
        assert highest[bucket] == max(members) + 1
        assert isinstance(deal, int) or members == sorted(members, reverse=True), "a list is not in order"
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
    assert_same_necks(case.necks(deal), expected)


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
    assert_same_necks(case.necks(deal), expected)


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
        head = head.reshape(case.capacity, -1)
        expected = case.twin_necks()
        for c in resting:
            first, stop = case.start[c : c + 2]
            left = 0 if isinstance(deal, int) else UNWRITTEN
            assert (after[first:stop] == UNWRITTEN).all() and (head[first:stop] == left).all()
            expected[c][:] = -1
        assert_same_necks(case.necks(deal), expected)
        # What an earlier step left in the necks of an inactive channel is not looked at.
        kept = case.selected(expected, deal)
        assert kept == [reference.select_cuts(neck) for neck in expected]
        assert sum(map(len, kept)) > 3 or len(resting) == 9
        assert_cuts(case, kept, deal, expected)


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
    assert (case.necks(deal)[0] == -1).all()


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


@pytest.mark.parametrize("deal", [1, 64, *SLABS[:2]])
def test_a_halted_step_searches_nothing(device, deal):
    """What the sub-step before it has found stays, the cuts of the shares as well: the host has not seen it yet."""
    rng = np.random.default_rng(5)
    case = Case([wandering_line(rng, n) for n in (90, 40)], halt=1, device=device)
    assert all((array == UNWRITTEN).all() for array in case.find(deal))


# ---- the chunks that hold necks


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(count=st.integers(1, 300), part=st.sampled_from([0.0, 0.02, 0.5, 1.0]), seed=st.integers(0, 2**32 - 1))
def test_list_marks_lists_the_marked_chunks_in_order(count, part, seed):
    """How many lie before each, of all at the end too; what is beyond the list stays as it was."""
    flags = (np.random.default_rng(seed).random(count) < part).astype(int)
    chunk_mark = np.stack([flags, 9 * flags], axis=1)
    marks = running_marks(chunk_mark, "cpu")
    place, chunk = unwritten(count + 1, wp.int32, "cpu"), unwritten(count, wp.int32, "cpu")
    kernel = cutoffs.build(wp.float64).list_marks
    wp.launch(kernel, dim=count, inputs=[marks], outputs=[place, chunk], device="cpu")
    expected = list_of_marks(chunk_mark, "cpu")
    assert place.numpy().tolist() == expected.place.numpy().tolist() == [0, *np.cumsum(flags)]
    assert chunk.numpy().tolist() == expected.chunk.numpy().tolist()
    assert chunk.numpy()[: flags.sum()].tolist() == np.flatnonzero(flags).tolist()
