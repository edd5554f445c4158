"""Kernels of sensitivities against their NumPy twins; derivatives against imaginary steps through the twins.

``trace_velocity``, ``trace_tangents``, ``advance_points``, ``measure_segments``, ``place_points``, ``sample_courses``,
``sample_directions``.
"""

import numpy as np
import pytest
import reference_sensitivities as twin
import warp as wp
from kernel_arrays import REALS, SCALARS, starts_of, to_device, unwritten

from warpriver.kernels import sensitivities

# Points that a thread takes; lines have 61 and 23.
PIECES = (1, 7, 100)
# Relative to the greatest value: sums of 84 terms in either precision.
CLOSE = {"float64": 1e-12, "float32": 3e-4}
LAWS = {
    "plain": twin.RateLaw(),
    "whole sinuosity": twin.RateLaw(scale_local=1, scale_upstream=1),
    "upstream sinuosity": twin.RateLaw(local_weight=-0.7, scale_upstream=1, end_damping=0.0),
}
DIRECTIONS = 3


def make_lines():
    """Two wiggly, unevenly spaced lines, with widths and constants of the rate that vary along them."""
    rng = np.random.default_rng(5)
    lines, sections, laws = [], [], []
    for n, turn in ((61, 1.1), (23, 0.6)):
        angle = turn * np.sin(np.linspace(0.0, 11.0, n - 1)) + 0.1 * rng.standard_normal(n - 1)
        step = 30.0 * rng.uniform(0.8, 1.2, n - 1)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        lines.append(np.concatenate([[[0.0, 0.0]], np.cumsum(step, axis=0)]) + 1000.0 * len(lines))
        width = rng.uniform(60.0, 120.0, n)
        sections.append(np.stack([width, width * rng.uniform(0.8, 1.2, n), rng.uniform(50.0, 90.0, n)], axis=1))
        saturation = rng.uniform(0.15, 0.5, n) if len(lines) == 1 else np.zeros(n)
        laws.append(np.stack([rng.uniform(5.0, 9.0, n), rng.uniform(1.5, 3.0, n), saturation], axis=1))
    return lines, sections, laws


class Case:
    """The lines on a device, with directions, in one precision."""

    def __init__(self, device, dtype="float64", piece=7):
        self.device, self.dtype = device, dtype
        self.kernel = sensitivities.build(SCALARS[dtype])
        self.lines, self.sections, self.laws = make_lines()
        self.start, rng = starts_of(self.lines), np.random.default_rng(7)
        count = self.start[-1]
        self.widths = [float(s[:, 0].mean()) for s in self.sections]
        quanta = [np.rint(np.hypot(*np.diff(xy, axis=0).T) * 2.0**32).astype(np.int64) for xy in self.lines]
        self.quanta = np.concatenate([np.concatenate([[0], q]) for q in quanta])
        self.arcs = [q.sum() / 2.0**32 for q in quanta]
        self.change = rng.standard_normal((DIRECTIONS, count, 2))
        self.seed = rng.standard_normal((DIRECTIONS, count, 3))
        courses = self.courses = self.kernel.Courses()
        courses.start = to_device(self.start, wp.int32, device)
        courses.width = self.give(self.widths, SCALARS[dtype])
        courses.xy, courses.section, courses.law = (
            self.give(np.concatenate(part), self.kernel.vec2 if part is self.lines else self.kernel.vec3)
            for part in (self.lines, self.sections, self.laws)
        )  # fmt: skip
        courses.arc = to_device(np.cumsum(self.quanta), wp.int64, device)
        directions = self.directions = self.kernel.Directions()
        directions.xy = self.give(self.change.reshape(-1, 2), self.kernel.vec2)
        directions.seed = self.give(self.seed.reshape(-1, 3), self.kernel.vec3)
        owner = [k for k, xy in enumerate(self.lines) for _ in range(-(-len(xy) // piece))]
        first = [f for k, xy in enumerate(self.lines) for f in range(self.start[k], self.start[k + 1], piece)]
        pieces = self.pieces = self.kernel.Pieces()
        pieces.first = to_device(np.array([*first, count], np.int32), wp.int32, device)
        pieces.line = to_device(np.array(owner, np.int32), wp.int32, device)
        self.count, self.piece_count = int(count), len(owner)

    def give(self, values, kind):
        return to_device(np.asarray(values, REALS[self.dtype]), kind, self.device)

    def constants(self, law):
        constants = self.kernel.RateLaw()
        for name in ("local_weight", "upstream_weight", "scale_local", "scale_upstream", "end_damping"):
            setattr(constants, name, getattr(law, name))
        return constants

    def run(self, name, dim, inputs, *kinds):
        """Launch with fresh outputs of so many elements each, and return them."""
        outputs = [unwritten(count, kind, self.device) for count, kind in kinds]
        wp.launch(getattr(self.kernel, name), dim, inputs, outputs, device=self.device)
        return [out.numpy() for out in outputs]

    def parts(self, packed):
        return np.split(packed, self.start[1:-1])


def assert_close(found, expected, dtype):
    assert np.abs(found - expected).max() <= CLOSE[dtype] * np.abs(expected).max()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("dtype", SCALARS)
@pytest.mark.parametrize("piece", PIECES)
def test_velocity_is_that_of_the_double_sum(device, piece, dtype, law):
    case = Case(device, dtype, piece)
    inputs = [case.courses, case.constants(LAWS[law]), case.pieces]
    (found,) = case.run("trace_velocity", case.piece_count, inputs, (case.count, case.kernel.vec2))
    for k, part in enumerate(case.parts(found)):
        expected = twin.velocity(case.lines[k], case.sections[k], case.laws[k], LAWS[law], case.widths[k], case.arcs[k])
        assert_close(part, expected, dtype)
        assert (part[[0, -1]] == 0.0).all()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("dtype", SCALARS)
@pytest.mark.parametrize("piece", PIECES)
def test_tangents_are_the_derivative_by_imaginary_steps(device, piece, dtype, law):
    case = Case(device, dtype, piece)
    inputs = [case.courses, case.constants(LAWS[law]), case.pieces, case.directions]
    threads, size = DIRECTIONS * case.piece_count, DIRECTIONS * case.count
    (found,) = case.run("trace_tangents", threads, inputs, (size, case.kernel.vec2))
    for a, block in enumerate(found.reshape(DIRECTIONS, -1, 2)):
        for k, part in enumerate(case.parts(block)):
            own = slice(case.start[k], case.start[k + 1])
            expected = twin.velocity_change(
                case.lines[k],
                case.change[a, own],
                case.sections[k],
                case.laws[k],
                case.seed[a, own],
                LAWS[law],
                case.widths[k],
                case.arcs[k],
            )
            assert_close(part, expected, dtype)


def test_a_line_that_doubles_back_has_finite_velocities_and_tangents(device):
    case = Case(device)
    xy = case.courses.xy.numpy()
    xy[11], xy[31] = xy[9], xy[30]  # back onto itself, and a point that stands twice
    case.courses.xy = case.give(xy, case.kernel.vec2)
    inputs = [case.courses, case.constants(LAWS["plain"]), case.pieces]
    (found,) = case.run("trace_velocity", case.piece_count, inputs, (case.count, case.kernel.vec2))
    assert np.isfinite(found).all()
    threads, size = DIRECTIONS * case.piece_count, DIRECTIONS * case.count
    (found,) = case.run("trace_tangents", threads, [*inputs, case.directions], (size, case.kernel.vec2))
    assert np.isfinite(found).all()


def test_points_advance_by_velocity_times_step(device):
    case = Case(device)
    xy, velocity = case.courses.xy.numpy(), case.change[0]
    moving = case.give(xy, case.kernel.vec2)
    inputs = [wp.float64(0.3), case.give(velocity, case.kernel.vec2)]
    wp.launch(case.kernel.advance_points, case.count, inputs, [moving], device=device)
    np.testing.assert_allclose(moving.numpy(), xy + 0.3 * velocity, rtol=1e-15)


def test_segments_are_whole_quanta_and_lines_begin_at_none(device):
    case = Case(device)
    (found,) = case.run("measure_segments", case.count, [case.courses], (case.count, wp.int64))
    # A length that lies between two quanta within rounding goes to either.
    assert np.abs(found - case.quanta).max() <= 1
    assert (found[case.start[:-1]] == 0).all()


def test_even_places_and_what_is_sampled_there(device):
    case = Case(device)
    places = case.run(
        "place_points", case.count, [case.courses], (case.count, wp.int32), (case.count, case.kernel.vec4)
    )
    expected = [twin.even_places(part) for part in case.parts(np.cumsum(case.quanta))]
    first = np.concatenate([e[0] + case.start[k] for k, e in enumerate(expected)])
    weight = np.concatenate([e[1] for e in expected])
    np.testing.assert_array_equal(places[0], first)
    np.testing.assert_allclose(places[1], weight, atol=1e-9)
    given = [to_device(places[0], wp.int32, device), case.give(places[1], case.kernel.vec4)]
    kinds = ((case.count, case.kernel.vec2), (case.count, case.kernel.vec3), (case.count, case.kernel.vec3))
    xy, section, law = case.run("sample_courses", case.count, [case.courses, *given], *kinds)
    mixed = (weight[:, :, None] * np.concatenate(case.lines)[first[:, None] + np.arange(4)]).sum(axis=1)
    np.testing.assert_allclose(xy, mixed, atol=1e-7)
    for k, (found, line) in enumerate(zip(case.parts(xy), case.lines, strict=True)):
        np.testing.assert_array_equal(found[[0, -1]], line[[0, -1]])
        step = np.hypot(*np.diff(found, axis=0).T)
        # Chords of even arcs, which differ where the line bends between its points.
        assert step.std() < 0.1 * step.mean(), k
    for sampled, packed in ((section, case.sections), (law, case.laws)):
        for found, values in zip(case.parts(sampled), packed, strict=True):
            assert (found >= values.min(axis=0) - 1e-12).all() and (found <= values.max(axis=0) + 1e-12).all()
    size = DIRECTIONS * case.count
    kinds = ((size, case.kernel.vec2), (size, case.kernel.vec3))
    change, seed = case.run("sample_directions", size, [case.directions, *given], *kinds)
    for a in range(DIRECTIONS):
        own = slice(a * case.count, (a + 1) * case.count)
        mixed = (weight[:, :, None] * case.change[a][first[:, None] + np.arange(4)]).sum(axis=1)
        np.testing.assert_allclose(change[own], mixed, atol=1e-8)
        assert np.abs(seed[own]).max() <= np.abs(case.seed[a]).max()


def test_a_cubic_line_is_sampled_exactly(device):
    """Weights reproduce cubics in arc length: points on a straight line, unevenly spaced, with a cubic beside them."""
    case = Case(device)
    xy, arc = case.courses.xy.numpy(), np.sort(np.random.default_rng(1).uniform(0.0, 900.0, 61))
    xy[:61] = np.stack([arc, np.zeros(61)], axis=1)
    case.courses.xy = case.give(xy, case.kernel.vec2)
    quanta = np.rint(np.diff(arc, prepend=arc[0]) * 2.0**32).astype(np.int64)
    case.courses.arc = to_device(np.cumsum(np.concatenate([quanta, case.quanta[61:]])), wp.int64, device)
    places = case.run(
        "place_points", case.count, [case.courses], (case.count, wp.int32), (case.count, case.kernel.vec4)
    )
    xy[:61, 1] = 1e-7 * (arc - 100.0) * (arc - 400.0) * (arc - 800.0)
    case.courses.xy = case.give(xy, case.kernel.vec2)
    given = [to_device(places[0], wp.int32, device), case.give(places[1], case.kernel.vec4)]
    kinds = ((case.count, case.kernel.vec2), (case.count, case.kernel.vec3), (case.count, case.kernel.vec3))
    found = case.run("sample_courses", case.count, [case.courses, *given], *kinds)[0][:61]
    even = np.linspace(arc[0], arc[-1], 61)
    np.testing.assert_allclose(found[:, 0], even, atol=1e-6)
    np.testing.assert_allclose(found[:, 1], 1e-7 * (even - 100.0) * (even - 400.0) * (even - 800.0), atol=1e-6)
