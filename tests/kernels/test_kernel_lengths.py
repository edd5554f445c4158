"""Kernels of lengths and counts of points against NumPy and by hand, and the faults that they tell."""

import numpy as np
import pytest
import reference
import warp as wp
from kernel_arrays import (
    CHUNKS,
    DEALS,
    REALS,
    SCALARS,
    SLABS,
    UNWRITTEN,
    arcs_of,
    share_count,
    split,
    starts_of,
    status_of,
    to_device,
    unwritten,
)
from resampling_case import (
    ARC_TOLERANCE,
    FAULT_NOT_FINITE,
    FAULT_POINTS_FULL,
    QUANTA_TOLERANCE,
    SPACING_BEFORE,
    Case,
    as_quanta,
    smooth_line,
    with_copies,
)

from warpriver.kernels import polyline
from warpriver.kernels.status import FAULT


@pytest.mark.parametrize("chunk", CHUNKS)
def test_arc_lengths_by_chunk(device, chunk):
    """Each point's arc in its chunk; nothing is added between one channel and the next."""
    rng = np.random.default_rng(3)
    case = Case([smooth_line(rng, n) for n in (3, 70, 4, 3, 3, 129, 64)], device=device)
    total = np.concatenate([np.diff(reference.arc_quanta(xy), prepend=0) for xy in case.lines]).cumsum()
    arc, length = (a.numpy() for a in case.measured(chunk))
    threads = share_count(chunk, len(case.lines), case.capacity)
    # A chunk also owns the segment that leads to its first point, so that the chunks' lengths add up.
    ends = total[np.minimum(np.arange(1, threads + 1) * chunk, case.count) - 1]
    assert np.abs(length - np.diff(ends, prepend=0)).max() <= QUANTA_TOLERANCE
    before = np.concatenate([[0], ends[:-1]])[np.arange(case.count) // chunk]
    assert np.abs(as_quanta(arc[: case.count]) - (total - before)).max() <= QUANTA_TOLERANCE
    assert np.isnan(arc[case.count :]).all()


@pytest.mark.parametrize("deal", SLABS)
def test_arc_lengths_by_slab(device, deal):
    """Each point's arc from its channel's head; what an inactive channel had is left."""
    rng = np.random.default_rng(3)
    case = Case([smooth_line(rng, n) for n in (3, 70, 4, 3, 3, 129, 64)], resting=(0, 4), device=device)
    arc, length = (a.numpy() for a in case.measured(deal))
    for c, (xy, found) in enumerate(zip(case.lines, split(arc, case.start), strict=True)):
        if c in case.resting:
            assert np.isnan(found).all()
        else:
            assert np.abs(as_quanta(found) - reference.arc_quanta(xy)).max() <= QUANTA_TOLERANCE
    assert np.isnan(arc[case.count :]).all() and (length == UNWRITTEN).all()


def test_arc_lengths_are_those_of_the_segments_to_half_a_quantum_each():
    """2^-33 m a segment: a channel of a million points of 50 m is off by a tenth of a millimetre at the very most."""
    xy = smooth_line(np.random.default_rng(3), 5000)
    arc = Case([xy]).arcs("one slab")[0] * reference.QUANTUM
    exact = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    assert np.abs(arc - exact).max() <= 0.5 * reference.QUANTUM * len(xy) + 1e-9
    assert np.abs(arc - exact).max() <= 3.0 * reference.QUANTUM * np.sqrt(len(xy) / 12.0), "it adds up as chance has it"


def test_arc_lengths_do_not_depend_on_the_division(device, dtype):
    """To the bit, in chunks of any size and in slabs: they are sums of whole quanta."""
    rng = np.random.default_rng(4)
    lines = [smooth_line(rng, n) for n in (3, 700, 4, 3, 3, 129, 64)]
    lines[1] = with_copies(lines[1], [(63, 129), (500, 699)])
    case = Case(lines, dtype=dtype, device=device)
    expected = case.arcs(SLABS[0])
    assert all(arc[-1] > 0 for arc in expected)
    for deal in DEALS:
        for arc, own in zip(case.arcs(deal), expected, strict=True):
            np.testing.assert_array_equal(arc, own)


def test_arcs_between_points_of_a_channel_are_those_of_its_segments(device, dtype):
    """From the head and from any point to any later one, as the kernels ask for them, in quanta."""
    line = polyline.build(SCALARS[dtype])
    arc_place, arc_from = line.arc_place, line.arc_from

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(arcs: polyline.Arcs, first: int, between_out: wp.array2d[wp.float64]):
        i, j = wp.tid()
        if i <= j:
            between_out[i, j] = arc_from(arcs, arc_place(arcs, first + i), first + j)

    rng = np.random.default_rng(5)
    case = Case([smooth_line(rng, n) for n in (3, 70, 4, 129)], dtype=dtype, device=device)
    expected = case.arcs(SLABS[0])
    for deal in DEALS:
        arc, length = case.measured(deal)
        offset = to_device(np.cumsum(length.numpy()), wp.int64, device)
        for first, own in zip(case.start[:-1].tolist(), expected, strict=True):
            n = len(own)
            between = wp.zeros((n, n), wp.float64, device=device)
            inputs = [arcs_of(deal, arc, offset), first]
            wp.launch(evaluate, dim=(n, n), inputs=inputs, outputs=[between], device=device)
            np.testing.assert_array_equal(as_quanta(between.numpy()), np.triu(own - own[:, None]))


def test_lengths_are_rounded_to_the_nearest_quantum(device, dtype):
    """Halves to even; from nothing to 524 km, beyond which a quantum is lost in the sum that rounds."""
    scalar, real = SCALARS[dtype], REALS[dtype]
    whole_quanta = polyline.build(scalar).whole_quanta

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(length: wp.array[scalar], quanta_out: wp.array[wp.float64]):
        i = wp.tid()
        quanta_out[i] = whole_quanta(length[i])

    rng = np.random.default_rng(6)
    halves = (np.arange(9) + 0.5) * reference.QUANTUM
    length = np.concatenate([[0.0, 524_287.0], halves, 10.0 ** rng.uniform(-12.0, 5.7, 1000)]).astype(real)
    out = unwritten(len(length), wp.float64, device)
    wp.launch(evaluate, len(length), inputs=[to_device(length, scalar, device)], outputs=[out], device=device)
    quanta = as_quanta(out.numpy())
    np.testing.assert_array_equal(quanta, reference.segment_quanta(length.astype(np.float64)))
    assert quanta[2:11].tolist() == [0, 2, 2, 4, 4, 6, 6, 8, 8]


@pytest.mark.parametrize("where", [1, 6, 12])
@pytest.mark.parametrize(("value", "fault"), [(np.nan, 1), (np.inf, 1), (-np.inf, 1), (1.1e9, 1), (1e30, 1), (5e8, 0)])
def test_a_length_that_is_not_finite_or_beyond_any_river_is_a_fault(device, dtype, value, fault, where):
    """A point that has run away, so that its channel is longer than 2^30 m, wherever chunks and channels begin.

    Chunks find it where they measure, so that their lengths can be added up; slabs where the samples are counted.
    """
    rng = np.random.default_rng(3)
    lines = [smooth_line(rng, n) for n in (7, 14, 9)]
    for place in (where, 0, -1):
        far = [xy.copy() for xy in lines]
        far[1][place, 0] = value
        case = Case(far, dtype=dtype, device=device)
        for deal in DEALS:
            for before in (0, 2):
                status = status_of({FAULT: before}, device)
                arc, length = case.measured(deal, status)
                if isinstance(deal, int):
                    assert status.numpy()[FAULT] == max(before, fault)
                    assert (length.numpy() >= 0).all(), "what has no length adds none"
                else:
                    assert status.numpy()[FAULT] == before
                offset = to_device(np.cumsum(length.numpy()), wp.int64, device)
                case.counted(deal, arcs_of(deal, arc, offset), status)
                assert status.numpy()[FAULT] == max(before, fault), "the graver fault is kept"


@pytest.mark.parametrize(("gaps", "fault"), [(1, 0), (2, 0), (3, 1)])
def test_a_channel_may_be_too_long_of_which_no_chunk_is(device, gaps, fault):
    """Each gap of 500,000 km is within what a chunk may hold; a channel holds two of them and no more."""
    x = 5e8 * np.arange(gaps + 1)
    lines = [smooth_line(np.random.default_rng(3), 7), np.stack([np.repeat(x, 5), np.zeros(5 * len(x))], axis=1)]
    case = Case(lines, device=device)
    for deal in (1, 2, *SLABS):
        status = status_of({}, device)
        arc, length = case.measured(deal, status)
        assert status.numpy()[FAULT] == 0
        offset = to_device(np.cumsum(length.numpy()), wp.int64, device)
        case.counted(deal, arcs_of(deal, arc, offset), status)
        assert status.numpy()[FAULT] == fault, deal


@pytest.mark.parametrize(("spacing", "fault"), [(0.1, 0), (0.01, 0), (0.009, 1), (1e-3, 1), (1e-9, 1)])
def test_more_segments_than_integers_count_are_a_fault(device, spacing, fault):
    """Of 10,000 km: 2^30 segments are the limit."""
    case = Case([np.array([[0.0, 0.0], [4e6, 0.0], [1e7, 0.0]])], spacing=spacing, device=device)
    for deal in (7, SLABS[0]):
        status = status_of({}, device)
        arc, length = case.measured(deal, status)
        offset = to_device(np.cumsum(length.numpy()), wp.int64, device)
        samples, _ = case.counted(deal, arcs_of(deal, arc, offset), status)
        assert status.numpy()[FAULT] == fault
        assert samples.numpy()[0] == (0 if fault else round(1e7 / spacing) + 1)


@pytest.mark.parametrize("deal", [7, *SLABS[:2]])
def test_a_halted_step_measures_nothing(device, deal):
    case = Case([smooth_line(np.random.default_rng(1), n) for n in (40, 3)], device=device)
    arc, length = case.measured(deal, halt=1)
    assert np.isnan(arc.numpy()).all() and (length.numpy() == UNWRITTEN).all()


def test_counts_by_hand(device):
    """Straight lines of 2,000 m, 2,024 m, 2,025 m, 60 m and 1 m at 50 m: halves go up, and there are at least two."""
    lengths = np.array([2000.0, 2024.0, 2025.0, 60.0, 1.0])
    lines = [np.stack([length * np.array([0.0, 0.25, 1.0]), np.zeros(3)], axis=1) for length in lengths]
    result = Case(lines, device=device).sampled()
    assert np.diff(result.start).tolist() == [41, 41, 42, 3, 3]
    assert result.spacing == pytest.approx(lengths / [40, 40, 41, 2, 2], rel=1e-15)
    for length, points in zip(lengths, result.points, strict=True):
        assert points[:, 0] == pytest.approx(np.linspace(0.0, length, len(points)), abs=ARC_TOLERANCE)
        assert (points[:, 1] == 0.0).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [0, 6, 13])
def test_a_point_that_is_not_finite_sets_the_fault_and_nothing_else_changes(device, value, where):
    rng = np.random.default_rng(3)
    lines = [smooth_line(rng, n) for n in (20, 14, 30)]
    lines[1][where, 1] = value
    for deal in DEALS:
        result = Case(lines, device=device).sampled(deal, capacity=500)
        assert result.fault == FAULT_NOT_FINITE
        assert np.isnan(result.raw).all()
        assert result.start.tolist() == starts_of(lines).tolist()
        assert (result.spacing == SPACING_BEFORE).all()


@pytest.mark.parametrize("fault", [1, 2])
def test_an_earlier_fault_is_kept_and_stops_the_step(device, fault):
    lines = [smooth_line(np.random.default_rng(1), 40)]
    result = Case(lines, device=device).sampled(fault=fault)
    assert result.fault == fault
    assert np.isnan(result.raw).all() and (result.spacing == SPACING_BEFORE).all()
    assert result.start.tolist() == [0, 40]


def test_points_that_do_not_fit_change_nothing_and_tell_their_number(device):
    rng = np.random.default_rng(1)
    lines = [smooth_line(rng, n) for n in (40, 3, 60)]
    case = Case(lines, spacing=20.0, device=device)
    needed = case.sampled().needed
    for deal in DEALS:
        short = case.sampled(deal, capacity=needed - 1)
        assert short.needed == needed and short.fault == FAULT_POINTS_FULL
        assert np.isnan(short.raw).all() and (short.spacing == SPACING_BEFORE).all()
        assert short.start.tolist() == starts_of(lines).tolist()
        exact = case.sampled(deal, capacity=needed)
        assert np.isfinite(exact.raw).all() and exact.start[-1] == needed
