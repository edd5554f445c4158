"""Kernels of the push against the twins in reference_paths.py, and against the implicit equation that they solve."""

import dataclasses

import numpy as np
import pytest
import reference
import reference_paths as twin
import reference_rings as rings
import warp as wp
from kernel_arrays import DEALS, REALS, bits_of, ground_of, points_of, struct_of, to_device, unwritten
from path_lines import SPACING, PackedLines, varying_sections, wandering_line
from reference_paths import PathLaw

from warpriver.kernels import paths

# A push is a sum over some hundred points; relative to the largest of the channel.
SUM_TOLERANCE, SUM_TOLERANCE_32 = 1e-12, 3e-5
# A coordinate of a moved point: a few units in the last place of some kilometres.
MOVE_TOLERANCE, MOVE_TOLERANCE_32 = 4e-12, 1e-3
# A slope that a raster of 100 m cells has everywhere.
CELL = 100.0


def device_constants(kernel, law):
    members = dataclasses.asdict(law)
    del members["time_step"]  # each channel has its own
    return struct_of(kernel.PathConstants, **members)


class Case(PackedLines):
    """Some channels, and the kernels that push them."""

    def __init__(self, lines, **options):
        super().__init__(lines, **options)
        self.kernel = paths.build(self.scalar)
        if self.rings:
            self.channels.area = to_device(np.sign([rings.area(xy) for xy in lines]), wp.int64, self.device)

    def pushes(self, law, deal=64):
        """Pushes and pulls by channel, blurred downstream; those of inactive channels are not written."""
        out = unwritten(self.capacity, self.kernel.vec4, self.device)
        constants = device_constants(self.kernel, law)
        self.launch(self.kernel.compute_push, deal, [self.channels, self.points, constants, ...], [out])
        packed = out.numpy().astype(np.float64)
        assert np.isnan(packed[self.count :]).all()
        found = self.by_channel(packed)
        for c, half in enumerate(found):
            assert np.isnan(half).all() if c in self.resting else np.isfinite(half).all()
        return found

    def ground(self, slope):
        """A plain that falls south; level where the slope is None."""
        height = None if slope is None else -slope * CELL * np.arange(160.0)[:, None] * np.ones(160)
        return ground_of(self.scalar, height, (-8000.0, 8000.0, CELL), self.device)

    def shifted(self, law, halves, deal=64, slope=None):
        """Points and max speed by channel after a step with those pushes and pulls; checks the sections."""
        packed = np.concatenate([*halves, np.full((self.capacity - self.count, 4), np.nan)])
        out, section = (unwritten(self.capacity, self.kernel.vec2, self.device) for _ in range(2))
        max_speed = to_device(np.zeros(len(self.lines)), self.scalar, self.device)
        inputs = [self.channels, self.points, self.ground(slope), device_constants(self.kernel, law), ...]
        inputs += [to_device(packed, self.kernel.vec4, self.device)]
        written = points_of(self.scalar, out, None if self.section is None else section)
        self.launch(self.kernel.shift_points, deal, inputs, [written, bits_of(max_speed)])
        moved = out.numpy().astype(np.float64)
        assert np.isfinite(moved[: self.count]).all() and np.isnan(moved[self.count :]).all()
        if self.section is not None:
            np.testing.assert_array_equal(section.numpy(), self.section.numpy())
        return self.by_channel(moved), max_speed.numpy().astype(np.float64)


@pytest.mark.parametrize("deal", DEALS)
@pytest.mark.parametrize("varies", [False, True])
def test_push_and_shift_match_the_twins(device, dtype, deal, varies):
    """Inactive channels among them keep their points, and have no speed."""
    rng = np.random.default_rng(3)
    counts = (3, 4, 130, 3, 67, 300, 5)
    lines = [wandering_line(rng, n, curl=0.3) for n in counts]
    sections, law = varying_sections(rng, counts) if varies else None, PathLaw(time_step=0.05)
    options = {"sections": sections, "time_step": law.time_step, "dtype": dtype, "device": device}
    case = Case(lines, resting=(1, 4), **options)
    sums, moves = (SUM_TOLERANCE, MOVE_TOLERANCE) if dtype == "float64" else (SUM_TOLERANCE_32, MOVE_TOLERANCE_32)
    halves = [twin.compute_push(xy, SPACING, w, law) for xy, w in zip(lines, case.widths(), strict=True)]
    for c, (actual, expected) in enumerate(zip(case.pushes(law, deal), halves, strict=True)):
        if c not in case.resting:
            assert np.abs(actual - expected).max() <= sums * np.abs(expected).max()
    moved, max_speed = case.shifted(law, halves, deal)
    rows = zip(moved, lines, halves, case.mean, case.widths(), strict=True)
    for c, (actual, xy, half, mean, width) in enumerate(rows):
        given = np.asarray(xy, REALS[dtype])
        if c in case.resting:
            assert (actual == given).all() and max_speed[c] == 0.0
            continue
        expected = twin.shift_points(xy, half, SPACING, mean, width, law)
        np.testing.assert_allclose(actual, expected, rtol=0.0, atol=moves)
        assert (actual[[0, -1]] == given[[0, -1]]).all(), "an end moved"
        fastest = np.hypot(*(expected - xy).T).max() / law.time_step
        # Rounded coordinates make the distance, not the max speed, inexact.
        assert max_speed[c] == pytest.approx(fastest, rel=1e-4 if dtype == "float32" else 1e-9)


def test_ground_slows_the_push(device):
    """On an even slope everything is scaled by one number; at the threshold, and off the ground, nothing moves."""
    rng, law = np.random.default_rng(4), PathLaw(time_step=0.05)
    lines = [wandering_line(rng, n, curl=0.3) for n in (40, 3, 150)]
    case = Case([*lines, lines[0] + 20_000.0], time_step=law.time_step, device=device)
    halves = [twin.compute_push(xy, SPACING, w, law) for xy, w in zip(case.lines, case.widths(), strict=True)]
    free, max_speed = case.shifted(law, halves)
    for part, weight in ((0.0, 1.0), (0.25, 1.0 - 0.25**2 * 2.5), (0.5, 0.5), (1.0 + 1e-9, 0.0), (2.0, 0.0)):
        held, slowed = case.shifted(law, halves, slope=part * law.slope_threshold)
        for c, xy in enumerate(case.lines):
            share = weight if c < len(lines) else 0.0
            np.testing.assert_allclose(held[c] - xy, share * (free[c] - xy), rtol=0.0, atol=1e-10)
            assert slowed[c] == pytest.approx(share * max_speed[c], abs=1e-9)


def test_the_two_recurrences_solve_the_implicit_smoothing(device):
    """Away from the ends, one way down and one up are (1 - c d2)^-1, here as a dense system, for push and pull."""
    rng = np.random.default_rng(5)
    xy = wandering_line(rng, 400, curl=0.2)
    law = PathLaw(end_damping=0.0)
    case = Case([xy], time_step=law.time_step, device=device)
    width = case.widths()[0]
    moved = case.shifted(law, case.pushes(law))[0][0] - xy
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
