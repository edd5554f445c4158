"""``select_cuts``, ``record_cuts`` and ``save_loops`` against a sweep down each channel and cuts done one by one."""

import numpy as np
import pytest
import reference
import reference_rings
from cutoff_case import FAULT_OXBOWS_FULL, Case, assert_cuts, tangled_neck, wandering_line
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import DEALS, SLABS, UNWRITTEN, Backwards

# Chunks that the necks below reach over, one of them in another order, and slabs.
SMALL = (1, 2, 7, 64, Backwards(7), *SLABS)


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


def tangled_case(rng, counts, *, closed=False, longer=0):
    """Channels with necks of all kinds, some inactive in between, all rings or none; and the cuts that are kept."""
    necks = [tangled_neck(rng, n) for n in counts]
    resting = tuple(np.flatnonzero(rng.random(len(counts)) < 0.2))
    rings = tuple(range(len(counts))) if closed is True else tuple(np.flatnonzero(rng.random(len(counts)) < closed))
    lines = [wandering_line(rng, n) for n in counts]
    sections = [rng.uniform(1.0, 9.0, (n, 2)) for n in counts] if rng.random() < 0.5 else None
    case = Case(lines, sections=sections, resting=resting, rings=rings, longer=longer)
    kept = []
    for c, neck in enumerate(necks):
        if c in resting:
            kept.append([])
        elif c in rings:
            chosen = reference_rings.select_cuts(neck, longer)
            kept.append([(i, j, True) if outer else (i, j) for i, j, outer in chosen])
        else:
            kept.append(reference.select_cuts(neck))
    return case, necks, kept


# ---- selecting


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


@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.one_of(st.integers(3, 40), st.integers(3, 300)), min_size=1, max_size=12),
    deal=st.sampled_from(SMALL),
    seed=st.integers(0, 2**32 - 1),
    closed=st.sampled_from([0.0, 0.0, 0.5, 1.0]),
    longer=st.integers(0, 1),
)
def test_any_tangle_of_necks_is_cut_as_one_by_one(counts, deal, seed, closed, longer):
    """Lines and rings, in chunks far smaller and far larger than the clusters, and inactive channels in between."""
    case, necks, kept = tangled_case(np.random.default_rng(seed), counts, closed=closed, longer=longer)
    assert case.selected(necks, deal) == kept
    assert_cuts(case, kept, deal, necks)


def test_the_tangles_hold_what_they_are_to():
    """Clusters of one neck and of many, over several chunks of 64, cuts that share a point, of rings all kinds."""
    rng = np.random.default_rng(1)
    reach, shared, clusters, outer, many = 0, 0, [], 0, 0
    for k in range(200):
        case, necks, kept = tangled_case(rng, [int(n) for n in rng.integers(3, 300, 4)], closed=k % 2, longer=1)
        for c, neck in enumerate(necks):
            if c in case.rings:
                outer += sum(len(cut) == 3 for cut in kept[c])
                many += len(kept[c]) > 2
                continue
            shared += sum(a[1] == b[0] for a, b in zip(kept[c][:-1], kept[c][1:], strict=True))
            far = -1
            for i in np.flatnonzero(neck >= 0):
                if i >= far:
                    clusters.append(0)
                clusters[-1] += 1
                far = max(far, int(neck[i]))
                reach = max(reach, int(neck[i] - i))
    assert reach > 192 and shared > 100 and outer > 20 and many > 20
    assert clusters.count(1) > 100 and max(clusters) > 50


@pytest.mark.parametrize("deal", DEALS)
def test_selection_by_hand(device, deal):
    """The first neck wins, one inside it falls, one that begins where it ends stays, and so does one at the tail."""
    neck = np.array([-1, 4, 6, -1, 7, -1, -1, 9, -1, -1])
    case = Case([np.zeros((10, 2))], device=device)
    assert case.selected([neck], deal) == [[(1, 4), (4, 7), (7, 9)]]


@pytest.mark.parametrize("deal", DEALS)
def test_a_neck_that_begins_where_the_farthest_one_before_ends_is_kept(device, deal):
    """What is kept in a cluster ends before the cluster does: 2 .. 5 falls to 0 .. 3, but it reaches on to 5, so that
    4 .. 9 is of the same cluster and is kept; 9 .. 12 begins another one.
    """
    neck = np.full(14, -1)
    neck[[0, 2, 4, 9]] = [3, 5, 9, 12]
    case = Case([np.zeros((6, 2)), np.zeros((14, 2))], device=device)
    assert case.selected([np.full(6, -1), neck], deal) == [[], [(0, 3), (4, 9), (9, 12)]]


@pytest.mark.parametrize("deal", SMALL)
def test_one_neck_over_a_thousand_hides_them_all(device, deal):
    """It begins in the first chunk and ends in the last; without it every second one of the row is kept."""
    n = 400
    neck = np.full(n, -1)
    neck[5:-4] = np.arange(5, n - 4) + 2
    case = Case([np.zeros((9, 2)), np.zeros((n, 2))], device=device)
    alone = [(i, i + 2) for i in range(5, n - 4, 2)]
    assert case.selected([np.full(9, -1), neck], deal)[1] == alone
    neck[1] = n - 1
    assert case.selected([np.full(9, -1), neck], deal)[1] == [(1, n - 1)]


def test_without_necks_nothing_is_selected():
    case = Case([np.zeros((5, 2)), np.zeros((3, 2))])
    for deal in DEALS:
        assert case.selected([np.full(5, -1), np.full(3, -1)], deal) == [[], []]


# ---- recording and saving


@pytest.mark.parametrize("deal", DEALS)
def test_cuts_at_heads_tails_and_chunk_boundaries(device, deal):
    """Loops that begin at a channel's first point, end at its last, span several chunks, or end on a boundary."""
    rng = np.random.default_rng(2)
    lines = [wandering_line(rng, n) for n in (20, 3, 65, 130, 3)]
    kept = [[(0, 7), (7, 14), (14, 19)], [(0, 2)], [(0, 64)], [(2, 63), (63, 64), (65, 129)], []]
    case = Case(lines, sections=[rng.uniform(1.0, 9.0, (len(xy), 2)) for xy in lines], device=device)
    assert_cuts(case, kept, deal)


@pytest.mark.parametrize("deal", DEALS)
def test_loops_of_rings_that_go_round_share_points_with_those_beside_them(device, deal):
    """Loops over several chunks that end where the one that goes round begins, and begin where it ends."""
    rng = np.random.default_rng(3)
    lines = [wandering_line(rng, n) for n in (150, 30, 90, 40)]
    kept = [
        [(12, 70, True), (13, 40), (60, 70)],  # what lies outside of 12 .. 70 is noted at 12
        [(3, 9), (9, 20)],
        [(5, 33), (33, 60), (80, 5)],  # from 80 round to 5: noted where it begins
        [(39, 0)],
    ]
    case = Case(lines, sections=[rng.uniform(1.0, 9.0, (len(xy), 2)) for xy in lines], rings=(0, 2, 3), device=device)
    assert_cuts(case, kept, deal)


@pytest.mark.parametrize("deal", [1, 7, 64, *SLABS])
def test_too_many_cuts_or_loop_points_change_nothing_and_set_the_fault(device, deal):
    """How many there are is told either way; see ``Case.cut``."""
    rng = np.random.default_rng(2)
    lines = [wandering_line(rng, n) for n in (20, 30)]
    kept = [[(0, 7), (9, 14)], [(3, 8)]]
    case = Case(lines, device=device)
    total = 8 + 6 + 6
    for cut_capacity, oxbow_capacity, fails in ((3, total, False), (2, total, True), (3, total - 1, True)):
        result = case.cut(kept, deal, cut_capacity, oxbow_capacity)
        assert result.fault == (FAULT_OXBOWS_FULL if fails else 0)
        if fails:
            assert all((a == xy).all() for a, xy in zip(result.points, lines, strict=True))
            assert (result.records == UNWRITTEN).all() and np.isnan(result.loops).all()


@pytest.mark.parametrize("deal", [1, 7, 64, *SLABS])
def test_cuts_of_a_row_of_sub_steps_come_behind_each_other(device, deal):
    """Each is told when it was; what does not fit behind those before is a fault, too."""
    rng = np.random.default_rng(2)
    lines = [wandering_line(rng, n) for n in (20, 30)]
    kept = [[(0, 7), (9, 14)], [(3, 8)]]
    case = Case(lines, device=device)
    first, again = case.cut(kept, deal), case.cut(kept, deal, done=5, before=(2, 17))
    assert again.fault == 0 and (again.records[:2] == UNWRITTEN).all() and np.isnan(again.loops[:17]).all()
    assert (again.records[2:5] == first.records[:3] + np.array([0, 17, 0, 5])).all()
    np.testing.assert_array_equal(again.loops[17:], first.loops)
    assert case.cut(kept, deal, cut_capacity=4, done=5, before=(2, 17)).fault == FAULT_OXBOWS_FULL
    assert case.cut(kept, deal, oxbow_capacity=36, done=5, before=(2, 17)).fault == FAULT_OXBOWS_FULL


@pytest.mark.parametrize("deal", [7, *SLABS[:2]])
def test_a_halted_step_cuts_nothing(device, deal):
    """Nor does it overwrite what the step before it has told that it needs."""
    rng = np.random.default_rng(2)
    lines = [wandering_line(rng, n) for n in (20, 30)]
    case = Case(lines, halt=1, device=device)
    result = case.cut([[(0, 7), (9, 14)], [(3, 8)]], deal, 1, 1)
    assert all((a == xy).all() for a, xy in zip(result.points, lines, strict=True))
    assert result.fault == 0 and (result.records == UNWRITTEN).all() and np.isnan(result.loops).all()


# ---- all together


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_found_necks_are_cut_from_end_to_end(device, dtype):
    """All kernels in a row, on lines that wander across themselves; quarters of a metre have exact squares."""
    rng = np.random.default_rng(12)
    lines = [np.round(4.0 * wandering_line(rng, n, curl=1.2)) / 4.0 for n in (150, 3, 250, 40, 100)]
    results = []
    for deal in DEALS:
        case = Case(lines, width=15.0, dtype=dtype, device=device)
        necks = case.necks(deal)
        kept = case.selected(necks, deal)
        assert kept == [reference.select_cuts(neck) for neck in case.twin_necks()]
        assert_cuts(case, kept, deal, necks)
        results.append(kept)
    assert all(kept == results[0] for kept in results) and sum(map(len, results[0])) > 8
