"""Resampling kernels against a spline by SciPy through the same points, exact curves, and by hand."""

import dataclasses
import itertools

import numpy as np
import pytest
import reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import (
    CHUNKS,
    DEALS,
    REALS,
    SCALARS,
    SLABS,
    UNWRITTEN,
    arcs_of,
    channels_of,
    forms,
    points_of,
    ring_flags,
    share_count,
    share_out,
    split,
    starts_of,
    status_of,
    stems_of,
    to_device,
    unwritten,
)

from warpriver.kernels import polyline, resampling
from warpriver.kernels.status import (
    CUT_POINTS,
    CUT_POINTS_NEEDED,
    CUTS,
    CUTS_NEEDED,
    DONE,
    FAULT,
    GOAL,
    HALT,
    POINTS,
    POINTS_NEEDED,
    STATUS_SIZE,
    STEPS,
)

# A length within rounding of half a quantum may be rounded to either side.
QUANTA_TOLERANCE = 1
ARC_TOLERANCE = 1e-9
POINT_TOLERANCE = 1e-9
# A float32 coordinate of a few km is off by 2.4e-4 m at most; the cubic combines a few of them.
POINT_TOLERANCE_32 = 2e-3
FAULT_NOT_FINITE, FAULT_POINTS_FULL = 1, 4
# What a spacing is before a step.
SPACING_BEFORE = 123.0


def smooth_line(rng, count, spacing=50.0):
    """Points a bit unevenly spaced on a winding line, as a move leaves them."""
    s = np.cumsum(spacing * rng.uniform(0.85, 1.15, count))
    heading = rng.uniform(0.0, 6.0) + 1.2 * np.sin(s / rng.uniform(120.0, 250.0) + rng.uniform(0.0, 6.0))
    steps = np.diff(s)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)[1:]
    return np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)]) + rng.uniform(-500.0, 500.0, 2)


def as_quanta(arc):
    """Arc lengths in m as the whole numbers of quanta that they are."""
    quanta = arc / reference.QUANTUM
    assert (quanta == np.rint(quanta)).all()
    return quanta.astype(np.int64)


def with_copies(xy, pairs):
    """The line as cutoffs leave it: the points i .. j - 1 of each pair stand at point i."""
    return reference.cut_necks(xy, pairs)[0]


@dataclasses.dataclass
class Sampled:
    """What all kernels together made of the lines of a case; ``points`` and ``sections`` by channel."""

    points: list
    sections: list | None
    spacing: np.ndarray
    start: np.ndarray
    fault: int
    needed: int
    raw: np.ndarray
    done: int


class Case:
    """Some moved channels on a device; each kernel has its method, and ``sampled`` runs them all."""

    def __init__(
        self,
        lines,
        *,
        spacing=50.0,
        sections=None,
        resting=(),
        rings=(),
        stems=(),
        dtype="float64",
        device="cpu",
        spare=5,
    ):
        self.resting, self.rings = resting, rings
        self.scalar = SCALARS[dtype]
        self.kernel, self.device, self.lines = resampling.build(self.scalar), device, lines
        self.start = starts_of(lines)
        self.count, self.capacity = int(self.start[-1]), int(self.start[-1]) + spare
        self.asked = np.broadcast_to(np.float64(spacing), len(lines))
        self.sections = sections
        beyond = np.full((spare, 2), np.nan)
        self.point_moved = to_device(np.concatenate([*lines, beyond]), self.kernel.vec2, device)
        section = None
        if sections is not None:
            section = to_device(np.concatenate([*sections, beyond]), self.kernel.vec2, device)
        self.moved = points_of(self.scalar, self.point_moved, section)
        step = np.full(len(lines), 0.3)
        step[list(resting)] = 0.0
        # Of the form only the target spacing is for these kernels.
        self.members = {
            "start": to_device(self.start, wp.int32, device),
            "form": forms(np.nan, np.nan, np.nan, self.asked, self.scalar, device),
            "spacing": to_device(np.full(len(lines), SPACING_BEFORE), self.scalar, device),
            "step": to_device(step, self.scalar, device),
            "closed": ring_flags(rings, len(lines), device),
        }
        if stems:
            self.members["stems"] = stems_of(stems, len(lines), device)
        self.channels = channels_of(self.scalar, **self.members)

    def launch(self, kernel, dim, inputs, outputs):
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)

    def launch_points(self, kernel, deal, capacity, inputs, outputs, halt=0, status=None):
        """Launch a kernel over that many points; ``...`` stands for the work among the inputs."""
        for part in share_out(deal, len(self.lines), capacity, self.device, halt, status):
            self.launch(kernel, part.threads, [part.work if value is ... else value for value in inputs], outputs)

    def measured(self, deal, status=None, halt=0):
        """Arc lengths in the chunks or along the channels, and the length of each chunk, both on the device."""
        arc = unwritten(self.capacity, wp.float64, self.device)
        length = unwritten(share_count(deal, len(self.lines), self.capacity), wp.int64, self.device)
        status = status_of({}, self.device) if status is None else status
        inputs = [self.channels, ..., self.point_moved]
        self.launch_points(self.kernel.measure_arcs, deal, self.capacity, inputs, [arc, length, status], halt)
        return arc, length

    def arcs(self, deal, status=None):
        """Arc lengths of the points from their channels' heads, in quanta, by channel."""
        arc, length = (a.numpy() for a in self.measured(deal, status))
        arc = as_quanta(arc[: self.count])
        if isinstance(deal, int):
            arc += (np.cumsum(length) - length)[np.arange(self.count) // deal]
        return [own - own[0] for own in split(arc, self.start)]

    def counted(self, deal, arcs, status):
        """Points and even spacing of each channel, both on the device."""
        samples = unwritten(len(self.lines), wp.int32, self.device)
        spacing = unwritten(len(self.lines), self.scalar, self.device)
        for part in share_out(deal, len(self.lines), self.capacity, self.device):
            inputs = [self.channels, part.work, self.point_moved, arcs]
            self.launch(self.kernel.count_samples, part.channel_threads, inputs, [samples, spacing, status])
        return samples, spacing

    def sampled(self, deal=64, capacity=None, fault=0, substep=(2, 5), halt=0, goal=1, keep_plan=0):
        """All kernels in a row, into new arrays of that capacity (by default just what is needed and 4 more)."""
        channels = len(self.lines)
        state = {FAULT: fault, HALT: halt, GOAL: goal, POINTS: -1, POINTS_NEEDED: -1}
        state |= {STATUS_SIZE: -1, STATUS_SIZE + 1: -1}
        # What the sub-steps before have cut off, and what this one has.
        state |= {CUTS: 2, CUT_POINTS: 30, CUTS_NEEDED: channels, CUT_POINTS_NEEDED: 10 * channels}
        status = status_of(state, self.device, row=1)
        arc, length = self.measured(deal, status)
        offset = unwritten(len(length), wp.int64, self.device)
        if isinstance(deal, int):
            offset = to_device(np.cumsum(length.numpy()), wp.int64, self.device)
        arcs = arcs_of(deal, arc, offset)
        samples, spacing = self.counted(deal, arcs, status)
        start_next = to_device(np.concatenate([[0], np.cumsum(samples.numpy())]), wp.int32, self.device)
        needed = int(start_next.numpy()[-1])
        capacity = needed + 4 if capacity is None else capacity
        points = unwritten(capacity, self.kernel.vec2, self.device)
        sections = None if self.sections is None else unwritten(capacity, self.kernel.vec2, self.device)
        new = channels_of(self.scalar, **self.members | {"start": start_next, "spacing": spacing})
        inputs, sampled = [self.channels, ..., new, self.moved, arcs], points_of(self.scalar, points, sections)
        self.launch_points(self.kernel.resample_points, deal, capacity, inputs, [sampled], status=status)
        start_out = to_device(self.start, wp.int32, self.device)
        spacing_out = to_device(np.full(channels, SPACING_BEFORE), self.scalar, self.device)
        count = to_device([*substep, 1], wp.int32, self.device)
        outputs = [start_out, spacing_out, count, status]
        self.launch(self.kernel.commit_step, channels + 1, [capacity, keep_plan, start_next, spacing], outputs)
        raw, start = points.numpy().astype(np.float64), start_out.numpy()
        by_channel = split(raw, start_next.numpy())
        if sections is not None:
            sections = split(sections.numpy().astype(np.float64), start_next.numpy())
        done, total, planned = count.numpy().tolist()
        assert total == substep[1]
        found = status.numpy()
        fault, counted, steps = found[[FAULT, DONE, STEPS]].tolist()
        assert found[STATUS_SIZE:].tolist() == (list(substep) if counted else [-1, -1])
        taken = fault == 0 and not halt
        assert steps == (counted and done == 0) and planned == (keep_plan if steps else 1)
        assert counted == (taken and goal > 0) and done == (substep[0] + counted) % total
        assert found[[CUTS, CUT_POINTS]].tolist() == [2 + counted * channels, 30 + counted * 10 * channels]
        assert found[[CUTS_NEEDED, CUT_POINTS_NEEDED]].tolist() == [channels, 10 * channels]
        assert found[POINTS] == (needed if taken else -1)
        if not taken:
            assert start.tolist() == self.start.tolist() and (spacing_out.numpy() == SPACING_BEFORE).all()
        told = not halt and fault in (0, FAULT_POINTS_FULL)
        assert found[POINTS_NEEDED] == (needed if told else -1), "told, whether there is room or not"
        return Sampled(by_channel, sections, spacing_out.numpy(), start, fault, needed, raw, done)

    def twins(self):
        sections = [None] * len(self.lines) if self.sections is None else self.sections
        return [
            reference.resample(xy, s, section) for xy, s, section in zip(self.lines, self.asked, sections, strict=True)
        ]


def assert_sampled(case, deal, tolerance=POINT_TOLERANCE):
    """Points, sections, counts and spacings are the twin's; the ends are the moved ends to the bit."""
    actual = case.sampled(deal)
    assert actual.fault == 0
    assert np.isnan(actual.raw[actual.needed :]).all()
    start = [0]
    for c, (xy, (points, section, spacing)) in enumerate(zip(case.lines, case.twins(), strict=True)):
        assert len(actual.points[c]) == len(points), f"channel {c}"
        error = np.abs(actual.points[c] - points).max()
        assert error <= tolerance, f"channel {c}: {error}"
        assert (actual.points[c][[0, -1]] == xy[[0, -1]]).all(), f"channel {c}"
        assert actual.spacing[c] == pytest.approx(spacing, abs=tolerance)
        if section is not None:
            error = np.abs(actual.sections[c] - section).max(axis=1)
            assert error.max() <= tolerance, f"channel {c}: section {error.argmax()} off by {error.max()}"
        start.append(start[-1] + len(points))
    assert actual.start.tolist() == start
    return actual


# ---- lengths and counts


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


# ---- shared functions


def test_channel_of_a_point(device):
    start = np.array([0, 3, 6, 106, 109], np.int32)
    channel_at = polyline.build(wp.float64).channel_at

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(channel_start: wp.array[int], channel_out: wp.array[int]):
        i = wp.tid()
        channel_out[i] = channel_at(channel_start, i)

    out = unwritten(109, wp.int32, device)
    wp.launch(evaluate, dim=109, inputs=[to_device(start, wp.int32, device)], outputs=[out], device=device)
    assert out.numpy().tolist() == [0] * 3 + [1] * 3 + [2] * 100 + [3] * 3


def test_tangents_match_the_parabola_and_its_correction(device, dtype):
    """Three-point tangents on uneven points, and the fourth-order ones from three of them, as in the twin's spline."""
    rng = np.random.default_rng(3)
    scalar = SCALARS[dtype]
    line = polyline.build(scalar)
    central_tangent, fourth_order_tangent = line.central_tangent, line.fourth_order_tangent
    vec2 = line.vec2
    xy = smooth_line(rng, 40).astype(np.float32).astype(np.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(point: wp.array[vec2], tangent_out: wp.array[vec2], corrected_out: wp.array[vec2]):
        i = wp.tid() + 2
        za = point[i - 1] - point[i - 2]
        ab = point[i] - point[i - 1]
        bc = point[i + 1] - point[i]
        cd = point[i + 2] - point[i + 1]
        before = central_tangent(za, ab, wp.length(za), wp.length(ab))
        here = central_tangent(ab, bc, wp.length(ab), wp.length(bc))
        after = central_tangent(bc, cd, wp.length(bc), wp.length(cd))
        tangent_out[i] = here
        corrected_out[i] = fourth_order_tangent(before, here, after, wp.length(ab), wp.length(bc))

    out = [unwritten(len(xy), vec2, device) for _ in range(2)]
    wp.launch(evaluate, dim=len(xy) - 4, inputs=[to_device(xy, vec2, device)], outputs=out, device=device)
    t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    curve, knots = reference.cubic_through(xy)
    # A tangent is a few quotients of differences of coordinates.
    tolerance = 1e-13 if dtype == "float64" else 2e-6
    assert out[0].numpy()[2:-2] == pytest.approx(reference.three_point_tangents(t, xy)[1:-1], abs=tolerance)
    assert out[1].numpy()[2:-2] == pytest.approx(curve(knots, 1)[2:-2], abs=tolerance)


def test_curvature_of_degenerate_points_is_zero():
    """Two points at one place, or a line that turns back on itself, have none; nothing is divided by zero."""
    line = polyline.build(wp.float64)
    circle_curvature, vec2 = line.circle_curvature, line.vec2

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(a: wp.array[vec2], b: wp.array[vec2], curvature_out: wp.array[wp.float64]):
        i = wp.tid()
        curvature_out[i] = circle_curvature(a[i], b[i], wp.length(a[i]), wp.length(b[i]))

    a = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0], [1.0, 0.0], [0.0, 1.0]])
    b = np.array([[1.0, 0.0], [0.0, 0.0], [-3.0, -4.0], [0.0, 1.0], [1.0, 0.0]])
    out = unwritten(5, wp.float64, "cpu")
    wp.launch(evaluate, dim=5, inputs=[to_device(v, vec2, "cpu") for v in (a, b)], outputs=[out], device="cpu")
    # The circle through three corners of a unit square has the radius 1 / sqrt 2; to the left and to the right.
    assert out.numpy() == pytest.approx([0.0, 0.0, 0.0, np.sqrt(2.0), -np.sqrt(2.0)], rel=1e-15)


def test_extended_points_are_those_of_the_next_links_or_reflections(device):
    line = polyline.build(wp.float64)
    extended_point, vec2, Run = line.extended_point, line.vec2, line.Run

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(point: wp.array[vec2], closed: int, edge: int, head: int, foot: int, point_out: wp.array[vec2]):
        i = wp.tid()
        run = Run()
        run.first = 3
        run.last = 5
        run.closed = closed
        run.edge = edge
        run.head = head
        run.upper = wp.where(head >= 0, 0, -1)
        run.foot = foot
        run.lower = wp.where(foot >= 0, 0, -1)
        point_out[i] = extended_point(point, 1 + i, run)

    # Three points of a channel between two others, which end and begin where it does.
    own = [[0.0, 0.0], [2.0, 1.0], [5.0, -1.0]]
    packed = [[-9.0, 7.0], [-4.0, 2.0], own[0], *own, own[2], [8.0, -4.0], [9.0, 9.0]]

    def found(closed=0, edge=0, head=-1, foot=-1):
        out = unwritten(7, vec2, device)
        inputs = [to_device(np.array(packed), vec2, device), closed, edge, head, foot]
        wp.launch(evaluate, dim=7, inputs=inputs, outputs=[out], device=device)
        return out.numpy().tolist()

    straight = [[-5.0, 1.0], [-2.0, -1.0], *own, [8.0, -3.0], [10.0, -2.0]]
    assert found() == reference.reflect_ends(np.array(own)).tolist() == straight
    assert found(closed=1) == [own[1], own[2], *own, own[0], own[1]], "a ring"
    assert found(edge=1) == [*straight[:5], [8.0, 1.0], [10.0, 0.0]], "a mirror that runs north"
    assert found(edge=2) == [*straight[:5], [2.0, -3.0], [0.0, -2.0]], "a mirror that runs west"
    assert found(head=2, foot=6) == [packed[0], packed[1], *own, packed[7], packed[8]], "links"
    assert found(foot=6) == [*straight[:5], packed[7], packed[8]]
