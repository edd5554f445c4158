"""Rings in the kernels of a step and ``measure_rings``, among lines, against dense periodic twins and closed forms."""

import functools

import cutoff_case
import migration_case as moving
import numpy as np
import pytest
import reference_rings as twin
import resampling_case as sampling
import warp as wp
from cutoff_case import assert_cuts, wandering_line
from kernel_arrays import (
    CHUNKS,
    DEALS,
    REALS,
    SCALARS,
    SLABS,
    Backwards,
    channels_of,
    forms,
    ring_flags,
    share_out,
    split,
    starts_of,
    stems_of,
    to_device,
    unwritten,
)
from reference import Law
from test_kernel_collisions import Search

from warpriver.kernels import smoothing

# Rounding of sums over some hundred points, relative to the largest rate of the channel.
SUM_TOLERANCE = 1e-12
POINT_TOLERANCE = 1e-9
SHORT_STEP = 1e-4


def circle(count, radius, turn=1.0):
    """Even points on a circle, to the left for ``turn`` = 1."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), turn * np.sin(angle)], axis=1)


def wavy_ring(count, seed=0, spacing=50.0, wave=0.15):
    """A ring whose radius has some waves, with points about ``spacing`` apart, either way round."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(count) / count
    radius = np.ones(count)
    for k in range(2, max(3, min(12, count // 8))):
        radius += wave / k * rng.normal() * np.cos(k * angle + rng.uniform(0.0, 6.0))
    xy = radius[:, None] * circle(count, 1.0, rng.choice([-1.0, 1.0]))
    return xy * spacing / twin.segments(xy).mean()


def mixed(seed=0):
    """Lines and rings, very short ones among them, and which are rings."""
    lines = moving.stacked_lines(seed, (3, 40, 5, 130))
    rings = [wavy_ring(n, seed + n) for n in (8, 9, 150, 67, 8, 400)]
    order = [lines[0], rings[0], rings[1], lines[1], rings[2], lines[2], rings[3], rings[4], lines[3], rings[5]]
    return order, (1, 2, 4, 6, 7, 9)


# ---- rates and moves


@pytest.mark.parametrize("depth", [2.0, 2e4, 2e10], ids=["long ring", "some laps", "ten million laps"])
@pytest.mark.parametrize("scales", [(0, 0), (0, 1), (1, 1)], ids=["none", "upstream", "whole"])
def test_rates_match_the_dense_periodic_sum(device, scales, depth):
    """Rings of 8 to 400 points, from a hundred memories round to a ten-millionth of one, to 1e-12."""
    lines, rings = mixed()
    law = Law(time_step=SHORT_STEP, scale_local=scales[0], scale_upstream=scales[1])
    case = moving.Case(lines, depth=depth, rings=rings, device=device)
    sections = [(np.full(len(xy), 50.0), np.full(len(xy), depth)) for xy in lines]
    expected = {c: twin.migration_rate(lines[c], 50.0, *sections[c], law) for c in rings}
    for deal in DEALS:
        rates = case.rates(law, deal)
        for c in rings:
            assert np.abs(rates[c] - expected[c]).max() <= SUM_TOLERANCE * np.abs(expected[c]).max(), (deal, c)


def test_lines_among_rings_have_the_bits_that_they_have_alone(device, dtype):
    lines, rings = mixed(3)
    law = Law(time_step=0.6)
    case = moving.Case(lines, rings=rings, dtype=dtype, device=device)
    rest = [c for c in range(len(lines)) if c not in rings]
    alone = moving.Case([lines[c] for c in rest], dtype=dtype, device=device)
    for deal in (64, SLABS[0]):
        found, own = case.velocities(law, deal), alone.velocities(law, deal)
        moved, own_moved = case.moved(law, found, deal), alone.moved(law, own, deal)
        for k, c in enumerate(rest):
            np.testing.assert_array_equal(moved[c], own_moved[k])
            if deal != 64:  # chunks warm up from where they begin
                np.testing.assert_array_equal(found[c], own[k])


@functools.cache
def raw_rates(scale_local):
    """Rates of the rings of the test below by the dense twin, before they are smoothed: the same for any time step."""
    lines, rings = mixed(7)
    sections = moving.varying_sections(lines)
    return {c: twin.migration_rate(lines[c], 50.0, *sections[c].T, Law(scale_local=scale_local)) for c in rings}


@pytest.mark.parametrize("time_step", [SHORT_STEP, 0.6, 60.0])
@pytest.mark.parametrize("scale_local", [0, 1])
def test_smoothed_rates_and_moves_with_sections_match_the_dense_twins(device, scale_local, time_step):
    """Both recurrences of the smoothing closed over rings shorter and longer than they reach."""
    lines, rings = mixed(7)
    sections = moving.varying_sections(lines)
    law = Law(time_step=time_step, scale_local=scale_local)
    case = moving.Case(lines, sections=sections, rings=rings, device=device)
    roots = {c: twin.roots(lines[c], 50.0, sections[c][:, 0], law) for c in rings}
    expected = {
        c: twin.fading_sum(twin.velocities(lines[c], raw), roots[c]) for c, raw in raw_rates(scale_local).items()
    }
    after_all = {c: twin.move_points(lines[c], expected[c], roots[c], law) for c in rings}
    for deal in (1, 7, 64, 4096, *SLABS[1:3]):
        found = case.velocities(law, deal)
        moved = case.moved(law, found, deal)
        for c in rings:
            assert np.abs(found[c] - expected[c]).max() <= SUM_TOLERANCE * np.abs(expected[c]).max(), (deal, c)
            after = after_all[c]
            reach = np.abs(after).max() + np.abs(after - lines[c]).max()
            assert np.abs(moved[c] - after).max() <= 1e-14 * reach + SUM_TOLERANCE * np.abs(after - lines[c]).max()
    assert time_step < 1.0 or min(roots[1]) ** 8 > 0.1


def test_the_area_does_not_depend_on_the_division(device):
    """But for rounding; in slabs to the bit. It is counted in 2^-62 of the length squared."""
    lines, rings = mixed(5)
    case = moving.Case(lines, rings=rings, device=device)
    law = Law()
    found = {deal: case.channels(law, deal).area.numpy() for deal in DEALS}
    for c in rings:
        exact = twin.area(lines[c]) / (50.0 * len(lines[c])) ** 2 * 2.0**62
        for deal in DEALS:
            assert found[deal][c] == pytest.approx(exact, rel=1e-13)
    assert all((found[deal] == found[SLABS[0]]).all() for deal in SLABS)


def test_a_circle_of_few_points_turns_neither_in_nor_out(device, dtype):
    """All points of a circle move alike, by k w / R (omega + gamma): the rate of the closed form, for 8 points too."""
    for count in (8, 9, 50, 1000):
        for turn in (-1.0, 1.0):
            xy = circle(count, 400.0, turn)
            chord = twin.segments(xy)[0]
            case = moving.Case([xy], spacing=chord, rings=(0,), dtype=dtype, device=device)
            law = Law(time_step=SHORT_STEP, scale_upstream=0)
            rate = case.rates(law)[0]
            tolerance = {"float64": 1e-11, "float32": 2e-3 * count / 50.0 + 1e-4}[dtype]
            assert rate == pytest.approx(turn * 60.0 * 50.0 / 400.0 * 1.5, rel=tolerance)


@pytest.mark.parametrize("deal", DEALS)
def test_a_ring_may_begin_at_any_of_its_points(deal):
    """Rolled by some points it has the same rates, rolled, to rounding."""
    xy, law = wavy_ring(230, 4), Law(time_step=0.6)
    rate = moving.Case([xy], rings=(0,)).rates(law, deal)[0]
    for shift in (1, 37, 229):
        other = moving.Case([np.roll(xy, shift, axis=0)], rings=(0,)).rates(law, deal)[0]
        assert np.abs(other - np.roll(rate, shift)).max() <= SUM_TOLERANCE * np.abs(rate).max()


def test_rings_at_rest_are_passed_over(device, dtype):
    lines, rings = mixed(2)
    law = Law(time_step=0.6)
    awake = moving.Case(lines, rings=rings, dtype=dtype, device=device)
    case = moving.Case(lines, rings=rings, resting=(1, 4, 5), dtype=dtype, device=device)
    for deal in (7, 64, *SLABS):
        velocities, found = awake.velocities(law, deal), case.velocities(law, deal)
        moved, points = awake.moved(law, velocities, deal), case.moved(law, found, deal)
        for c, xy in enumerate(lines):
            expected = xy.astype(REALS[dtype]) if c in (1, 4, 5) else moved[c]
            np.testing.assert_array_equal(points[c], expected)


# ---- resampling


def moved_ring(rng, count):
    """Points a bit unevenly spaced on a ring, as a move leaves them, anywhere."""
    return wavy_ring(count, int(rng.integers(1 << 30))) + rng.uniform(-6.0, 6.0, (count, 2)) + rng.uniform(-500, 500, 2)


@pytest.mark.parametrize("spacing", [50.0, 33.0, 90.0])
def test_samples_of_rings_match_the_periodic_cubic(device, spacing):
    rng = np.random.default_rng(1)
    lines = [moved_ring(rng, n) for n in (8, 60, 9, 300)]
    lines[2:2] = [sampling.smooth_line(rng, n) for n in (3, 80)]
    rings = (0, 1, 4, 5)
    sections = [np.stack([rng.uniform(20.0, 40.0, len(xy)), rng.uniform(1.0, 3.0, len(xy))], axis=1) for xy in lines]
    case = sampling.Case(lines, spacing=spacing, sections=sections, rings=rings, device=device)
    for deal in (*CHUNKS, *SLABS):
        found = case.sampled(deal)
        for c in rings:
            points, section, even = twin.resample(lines[c], spacing, sections[c])
            assert found.points[c].shape == points.shape and len(points) >= 8
            assert np.abs(found.points[c] - points).max() <= POINT_TOLERANCE
            assert np.abs(found.sections[c] - section).max() <= POINT_TOLERANCE
            assert found.spacing[c] == pytest.approx(even, rel=1e-12)
            np.testing.assert_array_equal(found.points[c][0], lines[c][0])


def test_rings_with_copies_left_by_cuts(device):
    """Copies inside, at the head, at the end and on both sides of the seam have no length."""
    rng = np.random.default_rng(2)
    xy = moved_ring(rng, 90)
    cuts = ([(20, 41, False)], [(0, 15, False)], [(60, 89, False)], [(12, 80, True)], [(12, 80, True), (30, 50, False)])
    lines = [twin.cut_necks(xy, kept)[0] for kept in cuts]
    case = sampling.Case(lines, rings=tuple(range(len(lines))), device=device)
    for deal in (1, 7, 64, 4096, *SLABS):
        found = case.sampled(deal)
        for c, line in enumerate(lines):
            points, _, even = twin.resample(line, 50.0)
            assert np.abs(found.points[c] - points).max() <= POINT_TOLERANCE, (deal, c)
            assert found.spacing[c] == pytest.approx(even, rel=1e-12)


def test_a_circle_stays_round_when_it_is_resampled():
    """The cubic is off by less than 1e-4 h^4 / R^3, wherever the samples fall."""
    radius, count = 400.0, 60
    chord = twin.segments(circle(count, radius))[0]
    for spacing in (0.4 * chord, chord, 1.7 * chord):
        points = sampling.Case([circle(count, radius)], spacing=spacing, rings=(0,)).sampled().points[0]
        assert np.abs(np.hypot(*points.T) - radius).max() <= 3e-3 * chord**4 / radius**3


# ---- cutoffs


def wandering_ring(rng, count):
    """A closed line that comes close to itself often: a wandering one whose gap is spread over all its points."""
    xy = wandering_line(rng, count + 1)
    return xy[:-1] - np.arange(count)[:, None] / count * (xy[-1] - xy[0])


def ring_case(seed, longer=0, device="cpu", varied=False):
    rng = np.random.default_rng(seed)
    lines = [wandering_ring(rng, int(n)) for n in rng.integers(8, 160, 5)]
    lines[1:1] = [wandering_line(rng, 70)]
    sections = None
    if varied:
        sections = [np.stack([rng.uniform(6.0, 18.0, len(xy)), np.ones(len(xy))], axis=1) for xy in lines]
    return cutoff_case.Case(lines, sections=sections, rings=(0, 2, 3, 4, 5), longer=longer, device=device)


@pytest.mark.parametrize("varied", [False, True])
def test_necks_of_rings_are_those_of_all_pairs(device, varied):
    """Neighbours across the seam are no neck."""
    seam, total = 0, 0
    for seed in range(12):
        case = ring_case(seed, device=device, varied=varied)
        expected = case.twin_necks()
        for deal in (7, 64, Backwards(7), *SLABS[:3]):
            for c, (found, neck) in enumerate(zip(case.necks(deal), expected, strict=True)):
                np.testing.assert_array_equal(found, neck, err_msg=f"channel {c}")
        total += sum(int((neck >= 0).sum()) for neck in expected)
        case.rings = ()
        seam += sum((a != b).any() for a, b in zip(case.twin_necks(), expected, strict=True))
    assert total > 100 and seam > 5


@pytest.mark.parametrize("longer", [0, 1])
def test_cuts_of_rings_are_those_of_the_twin(device, longer):
    """Selected and cut: records, loops and the points left, for loops inside and across the seam."""
    outer = inner = several = 0
    for seed in range(20):
        case = ring_case(seed, longer, device)
        necks = case.twin_necks()
        expected = {c: twin.select_cuts(necks[c], longer) for c in case.rings}
        for deal in (7, 64, Backwards(7), *SLABS[:3]):
            kept = case.selected(necks, deal)
            for c in case.rings:
                assert [(i, j, bool(out)) for i, j, *out in kept[c]] == expected[c], (seed, deal, c)
            assert_cuts(case, kept, deal, necks)
        flat = [k for kept in expected.values() for k in kept]
        outer += sum(k[2] for k in flat)
        inner += sum(not k[2] for k in flat)
        several += sum(len(kept) > 1 for kept in expected.values())
    assert inner > 10 and several > 3 and (outer > 3) == bool(longer)


# ---- collisions, smoothing


@pytest.mark.parametrize("deal", [1, 64, *SLABS])
def test_rings_touch_nobody(deal, device):
    """Two crossing lines are found as without the ring that crosses both."""
    line = np.stack([10.0 * np.arange(60), np.zeros(60)], axis=1)
    lines = [line, circle(100, 150.0) + [300.0, 0.0], line[:, ::-1] + [305.0, -304.0]]
    nodes = [(0, 1), (2, 2), (3, 4)]
    found = Search(lines, [12.0] * 3, nodes, deal, 1.5, "float64", device, rings=(1,))
    start = starts_of(lines)
    owners = {tuple(np.searchsorted(start, pair, side="right") - 1) for pair in found.contacts}
    assert owners == {(0, 2)}
    met = Search(lines, [12.0] * 3, nodes, deal, 1.5, "float64", device).contacts
    assert len({tuple(np.searchsorted(start, pair, side="right") - 1) for pair in met}) == 3


def smoothed(lines, rings, numbers, *, deal=64, resting=(), stems=(), dtype="float64", device="cpu"):
    """One pass of the smoothing kernel; numbers = (strength, pass band, swell)."""
    scalar, start = SCALARS[dtype], starts_of(lines)
    kernel = smoothing.build(scalar)
    step = np.ones(len(lines))
    step[list(resting)] = 0.0
    before = to_device(np.concatenate(lines), kernel.vec2, device)
    after = unwritten(int(start[-1]), kernel.vec2, device)
    steps = to_device(step, scalar, device)
    channels = channels_of(
        scalar, start=to_device(start, wp.int32, device), form=forms(*np.ones((4, len(lines))), scalar, device),
        spacing=steps, step=steps, closed=ring_flags(rings, len(lines), device),
    )  # fmt: skip
    if stems:
        channels.stems = stems_of(stems, len(lines), device)
    for part in share_out(deal, len(lines), int(start[-1]), device):
        inputs = [channels, *numbers, part.work, before]
        wp.launch(kernel.smooth_points, dim=part.threads, inputs=inputs, outputs=[after], device=device)
    return split(after.numpy().astype(np.float64), start)


def test_smooth_points_matches_its_twin(device, dtype):
    lines, rings = mixed(6)
    tolerance = {"float64": 1e-11, "float32": 2e-2}[dtype]
    for strength, band in ((0.5, -1.0), (0.63, 0.1), (0.3, 0.0)):
        for deal in DEALS:
            for swell in (0, 1):
                found = smoothed(
                    lines, rings, (strength, band, swell), deal=deal, resting=(3, 4), dtype=dtype, device=device
                )
                for c, xy in enumerate(lines):
                    if c in (3, 4):
                        np.testing.assert_array_equal(found[c], xy.astype(REALS[dtype]))
                        continue
                    n = len(xy)
                    longest = 1.0 - np.cos(2.0 * np.pi / n if c in rings else np.pi / (n - 1))
                    weight = 1.0 / ((longest if band < 0.0 else band) - 1.0 / strength) if swell else strength
                    assert np.abs(found[c] - twin.smooth(xy, weight, c in rings)).max() <= tolerance


@pytest.mark.parametrize("resting", [(), (2,)])
def test_links_are_smoothed_as_one_line(resting, device, dtype):
    """To the bit, in the pass band of a line without end; an inactive link is held, and with it both its nodes."""
    river = wavy_ring(200, 4)[:160]
    ends = [0, 2, 60, 130, 159]
    order = [2, 0, 3, 1]
    lines = [river[ends[k] : ends[k + 1] + 1] for k in order]
    stem = [order.index(k) for k in range(4)]
    for swell in (0, 1):
        whole = smoothed([river], (), (0.5, 0.0, swell), dtype=dtype, device=device)[0]
        for deal in DEALS:
            options = {"deal": deal, "resting": [stem[k] for k in resting], "dtype": dtype, "device": device}
            found = smoothed(lines, (), (0.5, -1.0, swell), stems=[stem], **options)
            for k in range(4):
                expected = whole[ends[k] : ends[k + 1] + 1].copy()
                held = [0, -1] if k in resting else [-1] if k + 1 in resting else [0] if k - 1 in resting else []
                expected[held] = lines[stem[k]].astype(REALS[dtype])[held]
                if k in resting:
                    expected = lines[stem[k]].astype(REALS[dtype])
                np.testing.assert_array_equal(found[stem[k]], expected)


def test_a_pass_of_plain_laplacian_smoothing_shrinks_a_circle_by_the_known_factor():
    for count in (8, 50, 400):
        xy = circle(count, 1000.0)
        for _ in range(10):
            xy = smoothed([xy], (0,), (0.5, -1.0, 0))[0]
        factor = (1.0 - 0.5 * (1.0 - np.cos(2.0 * np.pi / count))) ** 10
        assert np.hypot(*xy.T) == pytest.approx(1000.0 * factor, rel=1e-13)
