"""Resampling kernels against a spline by SciPy through the same points, exact curves, and by hand."""

import itertools

import numpy as np
import pytest
import reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import (
    DEALS,
    REALS,
    SLABS,
    channels_of,
    starts_of,
    to_device,
)
from resampling_case import (
    POINT_TOLERANCE,
    POINT_TOLERANCE_32,
    SPACING_BEFORE,
    Case,
    assert_sampled,
    smooth_line,
    with_copies,
)

# ---- samples


@pytest.mark.parametrize("deal", DEALS)
def test_samples_match_the_spline(device, deal):
    rng = np.random.default_rng(6)
    lines = [smooth_line(rng, n) for n in (3, 4, 5, 120, 3, 3, 260, 64, 6)]
    spacing = np.array([50.0, 20.0, 50.0, 35.0, 400.0, 10.0, 61.0, 50.0, 50.0])
    assert_sampled(Case(lines, spacing=spacing, device=device), deal)


@pytest.mark.parametrize("deal", DEALS)
def test_samples_with_sections(device, deal):
    """Width and depth are linear between the moved points, and the ends keep theirs."""
    rng = np.random.default_rng(6)
    lines = [smooth_line(rng, n) for n in (3, 40, 150)]
    sections = [rng.uniform(1.0, 90.0, (len(xy), 2)) for xy in lines]
    assert_sampled(Case(lines, sections=sections, spacing=33.0, device=device), deal)


LOOPS = {
    "inside": [(20, 41)],
    "head": [(0, 30)],
    "tail": [(100, 129)],
    "all but the ends": [(0, 129)],
    "end to end": [(10, 30), (30, 64), (64, 90)],
    "head and tail": [(0, 64), (64, 129)],
    "on chunk boundaries": [(7, 14), (63, 65), (70, 128)],
    "next to the ends": [(1, 40), (90, 128)],
    "two segments apart": [(1, 3), (4, 6), (7, 9), (126, 129)],
}


@pytest.mark.parametrize("cuts", LOOPS.values(), ids=LOOPS)
def test_copies_left_by_cutoffs_are_passed_over(device, cuts):
    """At heads, tails and chunk boundaries, with channels before and after; the sections of copies do not count."""
    rng = np.random.default_rng(9)
    lines = [smooth_line(rng, n) for n in (5, 130, 3, 130)]
    lines[1], lines[3] = with_copies(lines[1], cuts), with_copies(lines[3], cuts)
    sections = [rng.uniform(1.0, 90.0, (len(xy), 2)) for xy in lines]
    for deal in DEALS:
        assert_sampled(Case(lines, sections=sections, device=device), deal)


@pytest.mark.parametrize("cuts", [[], [(30, 39)], [(47, 60)], [(35, 40), (42, 44), (46, 70)]], ids=str)
def test_links_are_sampled_on_the_cubic_through_the_whole_river(device, cuts):
    """Each at a spacing of its own; copies that cutoffs have left beside a junction are passed over there as well."""
    rng = np.random.default_rng(12)
    river = with_copies(smooth_line(rng, 120), cuts)
    ends = [0, 3, 41, 45, 119]
    lines = [river[a : b + 1] for a, b in itertools.pairwise(ends)]
    kept = reference.distinct_points(river)
    curve, t = reference.cubic_through(river[kept])
    arc = reference.arc_quanta(river[kept]) * reference.QUANTUM
    spacing = np.array([50.0, 40.0, 55.0, 50.0])
    # Packed in another order.
    order = [2, 0, 3, 1]
    case = Case(
        [lines[k] for k in order], spacing=spacing[order], stems=[[order.index(k) for k in range(4)]], device=device
    )
    place = np.interp(np.arange(120), kept, arc)
    for deal in (1, 7, 64, "one slab", "a slab each, apart"):
        sampled = case.sampled(deal)
        for c, k in enumerate(order):
            first, last = place[ends[k]], place[ends[k + 1]]
            count = reference.sample_count(last - first, spacing[k])
            expected = curve(np.interp(np.linspace(first, last, count), arc, t))
            np.testing.assert_allclose(sampled.points[c], expected, rtol=0.0, atol=POINT_TOLERANCE)
            np.testing.assert_array_equal(sampled.points[c][[0, -1]], lines[k][[0, -1]])


def test_a_line_that_leaves_the_map_is_sampled_as_if_it_went_on_in_a_mirror(device):
    """Its cubic then crosses the edge at a right angle; the other end goes on straight."""
    rng = np.random.default_rng(4)
    for edge, axis in ((1, 0), (2, 1)):
        line = smooth_line(rng, 40)
        mirror = line[-2::-1].copy()
        mirror[:, axis] = 2.0 * line[-1, axis] - mirror[:, axis]
        both = np.concatenate([line, mirror])
        curve, t = reference.cubic_through(both)
        arc = reference.arc_quanta(line) * reference.QUANTUM
        case = Case([line], device=device)
        case.members["edge"] = to_device(np.array([edge], np.int32), wp.int32, device)
        case.channels = channels_of(case.scalar, **case.members)
        count = reference.sample_count(arc[-1], 50.0)
        expected = curve(np.interp(np.linspace(0.0, arc[-1], count), arc, t[: len(line)]))
        np.testing.assert_allclose(case.sampled(7).points[0], expected, rtol=0.0, atol=POINT_TOLERANCE)


def test_the_last_sample_keeps_the_section_of_the_last_point(device):
    """Twelve to ninety metres wide at the outlet, and so it stays, step after step."""
    rng = np.random.default_rng(10)
    lines = [smooth_line(rng, n) for n in (3, 40)]
    sections = [np.stack([np.linspace(12.0, 90.0, len(xy)), np.linspace(1.0, 3.0, len(xy))], axis=1) for xy in lines]
    result = Case(lines, sections=sections, device=device).sampled()
    for section, sampled in zip(sections, result.sections, strict=True):
        assert sampled[0] == pytest.approx(section[0], rel=1e-15)
        assert sampled[-1] == pytest.approx(section[-1], rel=1e-15)


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(
    counts=st.lists(st.integers(3, 100), min_size=1, max_size=6),
    deal=st.one_of(st.integers(1, 130), st.sampled_from(SLABS)),
    seed=st.integers(0, 2**32 - 1),
    spacing=st.floats(5.0, 300.0),
    cut=st.booleans(),
)
def test_any_lines_match_the_spline(counts, deal, seed, spacing, cut):
    rng = np.random.default_rng(seed)
    lines = [smooth_line(rng, n) for n in counts]
    if cut:
        for c, n in enumerate(counts):
            ends = np.unique(rng.integers(0, n, 4))
            pairs = [(i, j) for i, j in itertools.pairwise(ends) if j - i > 1]
            lines[c] = with_copies(lines[c], pairs)
    assert_sampled(Case(lines, spacing=spacing), deal)


def test_samples_lie_at_an_even_spacing(device):
    """A gently winding line of uneven points becomes even: within what chords of arcs differ, and no drift along it."""
    lines = [smooth_line(np.random.default_rng(2), 300)]
    result = Case(lines, device=device).sampled()
    chord = np.linalg.norm(np.diff(result.points[0], axis=0), axis=1)
    # Bends of 100 m radius: a chord of 50 m is 1% shorter than its arc, the old chords likewise.
    assert chord == pytest.approx(result.spacing[0], rel=0.02)
    again = Case(result.points, device=device).sampled()
    assert np.diff(again.start)[0] == len(result.points[0])
    chord = np.linalg.norm(np.diff(again.points[0], axis=0), axis=1)
    assert chord == pytest.approx(again.spacing[0], rel=0.002)


def test_even_points_on_a_line_stay_where_they_are(device):
    """Sampling at the spacing that the points have already gives them back."""
    angle = 0.1 * np.arange(60)
    circle = 500.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    straight = np.stack([50.0 * np.arange(40), 20.0 * np.arange(40)], axis=1)
    chord = 1000.0 * np.sin(0.05)
    result = Case([circle, straight], spacing=[chord, np.hypot(50.0, 20.0)], device=device).sampled(7)
    for points, xy in zip(result.points, (circle, straight), strict=True):
        assert np.abs(points - xy).max() <= POINT_TOLERANCE


@pytest.mark.parametrize("shape", ["circle", "sine"])
def test_samples_of_a_smooth_curve_are_of_fourth_order(shape):
    """Halving the spacing divides the distance from the curve by 2^3.5 or more, away from the ends."""
    errors = []
    for count in (61, 121, 241):
        t = np.linspace(0.0, 1.0, count)
        t = t + 0.03 * np.sin(2.0 * np.pi * t)  # unevenly, but smoothly
        if shape == "circle":
            xy = 300.0 * np.stack([np.cos(5.0 * t), np.sin(5.0 * t)], axis=1)
        else:
            xy = np.stack([2000.0 * t, 200.0 * np.sin(14.0 * t)], axis=1)
        spacing = 0.83 * np.linalg.norm(np.diff(xy, axis=0), axis=1).mean()
        points = Case([xy], spacing=spacing).sampled().points[0]
        points = points[len(points) // 5 : -len(points) // 5]
        if shape == "circle":
            off = np.hypot(*points.T) - 300.0
        else:
            slope = 200.0 * 14.0 / 2000.0 * np.cos(14.0 * points[:, 0] / 2000.0)
            off = (points[:, 1] - 200.0 * np.sin(14.0 * points[:, 0] / 2000.0)) / np.hypot(1.0, slope)
        errors.append(np.abs(off).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders >= 3.5).all(), (orders, errors)


def test_samples_turn_and_shift_with_the_line(device):
    rng = np.random.default_rng(6)
    lines = [smooth_line(rng, n) for n in (3, 80, 130)]
    c, s = np.cos(0.7), np.sin(0.7)
    plain = Case(lines, device=device).sampled()
    for image in (np.array([[c, s], [-s, c]]), np.diag([1.0, -1.0])):
        result = Case([xy @ image + [300.0, -200.0] for xy in lines], device=device).sampled()
        for a, b in zip(result.points, plain.points, strict=True):
            assert np.abs(a - (b @ image + [300.0, -200.0])).max() <= POINT_TOLERANCE


def test_a_channel_cut_to_a_point_is_not_taken_over(device):
    """A ring cut where its ends meet has no length: a spacing of 0 would be divided by in the next step."""
    ring = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 50.0], [0.0, 50.0], [0.0, 0.0]])
    lines = [smooth_line(np.random.default_rng(4), 20), with_copies(ring, [(0, 4)])]
    result = Case(lines, device=device).sampled()
    assert result.fault != 0
    assert result.start.tolist() == [0, 20, 25] and (result.spacing == SPACING_BEFORE).all()


def test_a_loop_cut_at_a_crossing_that_is_a_point_stays_finite(device):
    """Both neck points at one place, inside and at both ends: one more copy than other cuts leave behind."""
    xy = smooth_line(np.random.default_rng(4), 60)
    for i, j in ((20, 40), (0, 30), (45, 59)):
        crossed = xy.copy()
        crossed[j] = crossed[i]
        line = with_copies(crossed, [(i, j)])
        for deal in DEALS:
            result = Case([line], device=device).sampled(deal)
            assert np.isfinite(result.points[0]).all()
            assert (result.points[0][[0, -1]] == line[[0, -1]]).all()
            chord = np.linalg.norm(np.diff(result.points[0], axis=0), axis=1)
            assert chord.max() <= 2.0 * result.spacing[0]


def test_single_precision_samples(device):
    rng = np.random.default_rng(16)
    lines = [np.float32(smooth_line(rng, n)).astype(np.float64) for n in (3, 130, 70, 3)]
    lines[1] = with_copies(lines[1], [(5, 40), (63, 70)])
    for deal in DEALS:
        assert_sampled(Case(lines, dtype="float32", device=device), deal, POINT_TOLERANCE_32)


# ---- slabs, and inactive channels


def test_the_division_changes_no_bit(device, dtype):
    """Neither slabs nor chunks: where a thread begins to march along the cubic cannot be seen."""
    rng = np.random.default_rng(19)
    lines = [smooth_line(rng, n) for n in (3, 130, 70, 3, 4, 90)]
    lines[1] = with_copies(lines[1], [(5, 40), (63, 70)])
    sections = [rng.uniform(1.0, 90.0, (len(xy), 2)) for xy in lines]
    case = Case(lines, sections=sections, resting=(2,), spacing=33.0, dtype=dtype, device=device)
    results = [case.sampled(deal) for deal in DEALS]
    for result in results[1:]:
        np.testing.assert_array_equal(result.raw, results[0].raw)
        np.testing.assert_array_equal(np.concatenate(result.sections), np.concatenate(results[0].sections))
        np.testing.assert_array_equal(result.spacing, results[0].spacing)


@pytest.mark.parametrize("deal", DEALS)
def test_channels_at_rest_keep_their_points(device, dtype, deal):
    """To the bit, with their spacing and their number, wherever the others push them; those become what they would."""
    rng = np.random.default_rng(20)
    lines = [smooth_line(rng, n) for n in (3, 40, 4, 150, 3, 64, 5, 90)]
    lines[3] = with_copies(lines[3], [(5, 40), (63, 70)])
    sections = [rng.uniform(1.0, 90.0, (len(xy), 2)) for xy in lines]
    given = {"sections": sections, "spacing": 21.0, "dtype": dtype, "device": device}
    awake = Case(lines, **given).sampled(deal)
    for resting in ((0, 4, 7), (1, 2, 3, 6), tuple(range(8))):
        result = Case(lines, resting=resting, **given).sampled(deal)
        assert result.fault == 0 and result.done == 3
        for c, (xy, section) in enumerate(zip(lines, sections, strict=True)):
            if c in resting:
                np.testing.assert_array_equal(result.points[c], xy.astype(REALS[dtype]))
                np.testing.assert_array_equal(result.sections[c], section.astype(REALS[dtype]))
                assert result.spacing[c] == SPACING_BEFORE
            else:
                np.testing.assert_array_equal(result.points[c], awake.points[c])
                np.testing.assert_array_equal(result.sections[c], awake.sections[c])
                assert result.spacing[c] == awake.spacing[c]
        assert result.start.tolist() == starts_of(result.points).tolist()
        assert np.isnan(result.raw[result.needed :]).all()


def test_a_channel_at_rest_sets_no_fault(device):
    """It is not measured at all; the step of those that move is taken over."""
    ring = with_copies(np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 50.0], [0.0, 0.0]]), [(0, 3)])
    lines = [smooth_line(np.random.default_rng(4), 20), ring]
    for deal in DEALS:
        result = Case(lines, resting=(1,), device=device).sampled(deal)
        assert result.fault == 0 and (result.points[1] == ring).all()


def test_sub_steps_are_counted_where_the_step_is_taken_over(device):
    """From 0 up and round; a fault, or points without room, leave the count as it was."""
    case = Case([smooth_line(np.random.default_rng(1), n) for n in (40, 3)], device=device)
    assert [case.sampled(substep=(k, 3)).done for k in range(3)] == [1, 2, 0]
    assert case.sampled(substep=(0, 1)).done == 0
    assert case.sampled(substep=(1, 3), fault=2).done == 1
    assert case.sampled(substep=(1, 3), capacity=10).done == 1
    assert case.sampled(substep=(1, 3), halt=1).done == 1


def test_lines_sampled_outside_of_a_step_are_taken_over_and_not_counted(device):
    """No step is asked for: neither sub-steps nor cutoffs are counted."""
    case = Case([smooth_line(np.random.default_rng(1), n) for n in (40, 3)], device=device)
    result = case.sampled(substep=(0, 1), goal=0)
    assert result.done == 0 and result.start.tolist() == starts_of(result.points).tolist()
    assert (result.spacing != SPACING_BEFORE).all()


def test_a_plan_may_hold_for_the_next_step(device):
    case = Case([smooth_line(np.random.default_rng(1), n) for n in (40, 3)], device=device)
    for keep_plan in (0, 1):
        for substep in ((0, 1), (1, 3), (2, 3)):
            case.sampled(substep=substep, keep_plan=keep_plan)
