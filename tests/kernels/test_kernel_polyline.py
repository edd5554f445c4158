"""Functions of lines that kernels share, against exact curves and by hand."""

import numpy as np
import pytest
import reference
import warp as wp
from kernel_arrays import SCALARS, to_device, unwritten
from resampling_case import smooth_line

from warpriver.kernels import polyline


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
