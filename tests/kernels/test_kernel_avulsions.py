"""Where banks break, how new courses walk and what they carve, against float64 twins."""

import math

import numpy as np
import pytest
import warp as wp
from kernel_arrays import REALS, SCALARS, channels_of, forms, points_of, struct_of, to_device, vec2_of

from warpriver.kernels import avulsions
from warpriver.kernels.channels import Work
from warpriver.kernels.status import BEGUN, CREVASSES, FAULT, STATUS_SIZE, STEPS

STEP_YEARS, RATE = 0.5, 4e-4
# Places of some 5 km: of a curvature of 1 in 60 m, over 11 m, single precision leaves three digits.
TIGHT = {"float64": 1e-10, "float32": 1e-3}


def bends(count, h, width, seed):
    """A line of bends of many sizes, evenly spaced to within rounding of the step."""
    rng = np.random.default_rng(seed)
    s = h * np.arange(count)
    turn = sum(rng.uniform(0.1, 0.5) * np.sin(2.0 * math.pi * s / (width * k) + rng.uniform(0, 6)) for k in (9, 13, 31))
    step = h * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.concatenate([[[0.0, 1000.0 * seed]], np.cumsum(step[:-1], axis=0) + [0.0, 1000.0 * seed]])


LINES = [(bends(300, 20.0, 60.0, 1), 20.0, 60.0), (bends(90, 50.0, 50.0, 2), 50.0, 50.0),
         (bends(400, 11.0, 80.0, 3), 11.0, 80.0)]  # fmt: skip
IDENTITY = np.array([7, 3, 12], np.int32)


def twin_bend(xy, h, width, by_point):
    """Width times the mean curvature over a width, by weights of parts of a point at both ends."""
    a, b = np.diff(xy, axis=0)[:-1], np.diff(xy, axis=0)[1:]
    cross, lengths = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.hypot(*a.T) * np.hypot(*b.T) * np.hypot(*(a + b).T)
    k = np.concatenate([[0.0], 2.0 * cross / lengths, [0.0]])
    inner = np.zeros(len(xy))
    inner[1:-1] = 1.0
    reach = 0.0 if by_point else max(0.5 * width / h - 0.5, 0.0)
    side = math.ceil(reach)
    weight = np.minimum(reach + 1.0 - np.abs(np.arange(-side, side + 1)), 1.0)
    total, weights = (np.convolve(v, weight, "full")[side : side + len(xy)] for v in (k * inner, inner))
    return width * np.divide(total, weights, out=np.zeros(len(xy)), where=weights > 0)


def twin_lengths(bend):
    """Points of the bend of each apex, 0 elsewhere: runs of one sign, with their first greatest."""
    found = np.zeros(len(bend), int)
    edges = np.flatnonzero(np.diff(np.sign(bend)) != 0.0) + 1
    for run in np.split(np.arange(len(bend)), edges):
        if bend[run[0]] != 0.0:
            found[run[np.abs(bend[run]).argmax()]] = len(run)
    return found


class Case:
    """The lines on a device, dealt out in slabs of channels or chunks of points."""

    def __init__(self, dtype, device, deal="slabs", by_point=0, rings=False):
        self.scalar, self.device, self.by_point = SCALARS[dtype], device, by_point
        self.kernel = avulsions.build(self.scalar)
        counts = [len(xy) for xy, _, _ in LINES]
        self.start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        xy = np.concatenate([xy for xy, _, _ in LINES]).astype(REALS[dtype])
        width = np.array([w for _, _, w in LINES])
        spacing = np.array([h for _, h, _ in LINES])
        members = {
            "start": to_device(self.start, wp.int32, device),
            "form": forms(width, width / 20.0, width, spacing, self.scalar, device),
            "spacing": to_device(spacing.astype(REALS[dtype]), self.scalar, device),
            "step": to_device(np.zeros(3, REALS[dtype]), self.scalar, device),
        }
        if rings:
            members["closed"] = to_device(np.array([0, 1, 0], np.int32), wp.int32, device)
        self.channels = channels_of(self.scalar, **members)
        self.points = points_of(self.scalar, to_device(xy, vec2_of(self.scalar), device))
        self.work = Work()
        self.status = wp.zeros(STATUS_SIZE, dtype=wp.int32, device=device)
        self.work.status = self.status
        slabs = np.array([0, 2, 3], np.int32) if deal == "slabs" else np.zeros(1, np.int32)
        self.work.slab_channel = to_device(slabs, wp.int32, device)
        self.work.chunk = 0 if deal == "slabs" else int(deal)
        self.threads = 2 if deal == "slabs" else math.ceil(self.start[-1] / int(deal))
        self.breaking = struct_of(
            self.kernel.Breaking, curvature=0.08, rate=RATE, chance=0.3, avulsion=0.4, time_step=STEP_YEARS,
            by_point=by_point, seed=5,
        )  # fmt: skip
        self.bend = wp.full(int(self.start[-1]), -7.0, dtype=self.scalar, device=device)
        self.bank = wp.full(int(self.start[-1]), -7, dtype=wp.int32, device=device)

    def run(self, begun=0, done=1, number=0, fault=0):
        """Bends, banks and the count of those that break at the end of a step."""
        status = np.zeros(STATUS_SIZE, np.int32)
        status[[BEGUN, STEPS, FAULT]] = begun, done, fault
        self.status.assign(status)
        substep = to_device(np.array([number, 4, 0], np.int32), wp.int32, self.device)
        head, args = [self.channels, self.points, self.breaking, self.work, substep], {"device": self.device}
        wp.launch(self.kernel.measure_bends, self.threads, head, [self.bend], **args)
        identity = to_device(IDENTITY, wp.int32, self.device)
        inputs = [self.channels, self.breaking, self.work, identity, self.bend, substep]
        wp.launch(self.kernel.break_banks, self.threads, inputs, [self.bank, self.status], **args)
        return self.bend.numpy(), self.bank.numpy().copy(), int(self.status.numpy()[CREVASSES])


@pytest.mark.parametrize("by_point", [0, 1])
def test_bends_are_those_of_the_twin(by_point, dtype, device):
    found, _, _ = Case(dtype, device, by_point=by_point).run()
    expected = np.concatenate([twin_bend(xy, h, w, by_point) for xy, h, w in LINES])
    np.testing.assert_allclose(found, expected, atol=TIGHT[dtype])


@pytest.mark.parametrize("by_point", [0, 1])
def test_banks_break_as_often_as_their_chances_say(by_point, dtype, device):
    """Each of the bends, and of the points, over 1,500 steps, to 4.5 deviations of the binomial."""
    case, count = Case(dtype, device, by_point=by_point), 1500
    broken, left, total = np.zeros(case.start[-1]), np.zeros(case.start[-1]), 0
    for step in range(count):
        bend, bank, crevasses = case.run(begun=step)
        broken += bank > 0
        left += bank == avulsions.LEAVES
        assert crevasses == (bank > 0).sum()
        total += crevasses
    if by_point:
        chance = np.where(np.abs(bend) > 0.08, 0.3, 0.0)
    else:
        parts = [twin_lengths(part) for part in np.split(bend.astype(float), case.start[1:-1])]
        length = np.concatenate([n * h for n, (_, h, _) in zip(parts, LINES, strict=True)])
        chance = np.where((np.abs(bend) > 0.08) & (length > 0.0), 1.0 - np.exp(-RATE * length * STEP_YEARS), 0.0)
        assert 30 < (length > 0.0).sum() < 120
    spread = np.sqrt(count * chance * (1.0 - chance))
    np.testing.assert_array_less(np.abs(broken - count * chance), 4.5 * spread + 1e-9)
    assert total == pytest.approx(count * chance.sum(), abs=3.0 * math.sqrt((spread**2).sum()))
    assert left.sum() == pytest.approx(0.4 * total, abs=3.0 * math.sqrt(0.24 * total))


def test_the_same_banks_break_however_points_are_dealt_out(dtype, device):
    for by_point in (0, 1):
        kinds = [Case(dtype, device, deal, by_point) for deal in ("slabs", "32", "7")]
        for step in (0, 3, 4):
            found = [case.run(begun=step) for case in kinds]
            for bend, bank, count in found[1:]:
                np.testing.assert_array_equal(bend, found[0][0])
                np.testing.assert_array_equal(bank, found[0][1])
                assert count == found[0][2]
    # Steps are told apart by how many are done, whichever of them went before the row.
    case = Case(dtype, device)
    np.testing.assert_array_equal(case.run(begun=5, done=2)[1], case.run(begun=0, done=7)[1])
    assert (case.run(begun=5)[1] != case.run(begun=6)[1]).any()


def test_banks_hold_within_a_step_after_a_fault_and_on_rings(dtype, device):
    for told in ({"number": 2}, {"fault": 3}):
        case = Case(dtype, device, by_point=1)
        bend, bank, count = case.run(**told)
        assert count == 0 and (bank == -7).all() and (bend == -7.0).all()
    case = Case(dtype, device, by_point=1, rings=True)
    _, bank, count = case.run()
    ring = slice(case.start[1], case.start[2])
    assert count == (bank > 0).sum() > 50 and not bank[ring].any()


# ---- courses


def test_a_walk_is_that_of_the_twin(dtype, device):
    """d = t u + (1 - t) d0 with t the way walked over |a - b|, 1 at most; without chance."""
    kernel, rng, spacing = avulsions.build(SCALARS[dtype]), np.random.default_rng(1), 50.0
    ends = rng.uniform(0.0, 4000.0, (40, 2, 2))
    first = rng.uniform(-math.pi, math.pi, 40)
    heading = np.column_stack([np.cos(first), np.sin(first)])
    real, vec2 = REALS[dtype], vec2_of(SCALARS[dtype])
    room = 4 * 6000 // 50
    out = wp.empty((40, room), dtype=vec2, device=device), wp.empty((40, room), dtype=wp.float64, device=device)
    state = wp.empty((40, 2), dtype=wp.int32, device=device)
    walk = struct_of(kernel.Walk, spacing=spacing, jitter=0.0, steepest=0.05)
    seeds = to_device(np.arange(40, dtype=np.uint32), wp.uint32, device)
    ways = [to_device(values.astype(real), vec2, device) for values in (ends, heading)]
    courses = struct_of(kernel.Courses, ends=ways[0], direction=ways[1], seed=seeds)
    inputs = [None, kernel.RasterGrid(), walk, courses]
    wp.launch(kernel.walk_courses, 40, inputs, [*out, state], device=device)
    found, ended = out[0].numpy(), state.numpy()
    assert (ended[:, 0] == avulsions.ARRIVED).all()
    for k, (a, b) in enumerate(ends):
        line = [a]
        while np.hypot(*(b - line[-1])) > spacing:
            off = b - line[-1]
            t = min((len(line) - 1) * spacing / np.hypot(*(b - a)), 1.0)
            d = t * off / np.hypot(*off) + (1.0 - t) * heading[k]
            line.append(line[-1] + spacing * d / np.hypot(*d))
        if dtype == "float64":  # in single precision the last step may be one more
            assert ended[k, 1] == len(line) + 1
        count = min(ended[k, 1], len(line) + 1)
        # Rounding of places of 4 km adds up along the way.
        atol = 1e-8 if dtype == "float64" else 0.5
        np.testing.assert_allclose(found[k, : count - 1], np.array(line)[: count - 1], atol=atol)


def test_a_bed_is_carved_over_the_width(dtype, device):
    kernel = avulsions.build(SCALARS[dtype])
    line, bed = np.array([[45.0, 60.0], [200.0, 110.0], [330.0, 40.0]]), np.array([9.0, 7.0, 6.5])
    height = np.random.default_rng(2).uniform(8.0, 10.0, (20, 40))
    grid = struct_of(kernel.RasterGrid, west=0.0, north=200.0, cell_size=10.0, cells_per_meter=0.1)
    out = to_device(height.copy(), wp.float64, device)
    inputs = [grid, SCALARS[dtype](60.0), wp.vec4i(2, 3, 15, 30)]
    inputs += [
        to_device(line.astype(REALS[dtype]), vec2_of(SCALARS[dtype]), device),
        to_device(bed, wp.float64, device),
    ]
    wp.launch(kernel.carve_line, (15, 30), inputs, [out], device=device)
    rows, columns = np.indices(height.shape)
    xy = np.stack([10.0 * columns + 5.0, 195.0 - 10.0 * rows], axis=-1)
    nearest, level = np.full(height.shape, np.inf), np.zeros(height.shape)
    for k in range(2):
        along = line[k + 1] - line[k]
        t = np.clip(((xy - line[k]) @ along) / (along @ along), 0.0, 1.0)
        away = np.hypot(*(xy - line[k] - t[..., None] * along).transpose(2, 0, 1))
        level = np.where(away < nearest, bed[k] + t * (bed[k + 1] - bed[k]), level)
        nearest = np.minimum(nearest, away)
    p = np.clip(nearest / 30.0 - 1.0, 0.0, 1.0)
    weight = 1.0 - p * p * (3.0 - 2.0 * p)
    expected = height.copy()
    window = np.s_[2:17, 3:33]
    lowered = height + weight * np.minimum(level - height, 0.0)
    expected[window] = lowered[window]
    np.testing.assert_allclose(out.numpy(), expected, atol=1e-10 if dtype == "float64" else 1e-4)
