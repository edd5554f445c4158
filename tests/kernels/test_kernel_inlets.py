"""What enters at inlets, by ``feed_inlets``, against its twin and what it is said to be."""

import numpy as np
import pytest
import reference_banks as twin
import warp as wp
from kernel_arrays import (
    SCALARS,
    channels_of,
    forms,
    points_of,
    starts_of,
    status_of,
    stems_of,
    struct_of,
    to_device,
    vec2_of,
)

from warpriver.kernels import inlets
from warpriver.kernels.status import BEGUN, HALT, NUMBER, STATUS_SIZE, STEPS, SUBSTEP_SIZE, TOTAL


def fed(width, period, identity, begun, part, *, dtype="float64", seed=5, halt=0, device="cpu"):
    """Curvature that each channel feels, at a number of steps of 0.3 yr and a part of one (number, total)."""
    scalar = SCALARS[dtype]
    kernel, count = inlets.build(scalar), len(width)
    form = forms(np.array(width), np.ones(count), np.array(width), np.ones(count), scalar, device)
    channels = channels_of(scalar, form=form)
    inflow = struct_of(kernel.Inflow, curvature=0.1, time_step=0.3, seed=seed)
    status, substep = np.zeros(STATUS_SIZE, np.int32), np.zeros(SUBSTEP_SIZE, np.int32)
    status[BEGUN], status[STEPS], status[HALT] = begun - 2, 2, halt
    substep[NUMBER], substep[TOTAL] = part
    out = wp.full(count, 7.0, dtype=scalar, device=device)
    inputs = [channels, inflow, to_device(identity, int, device), to_device(period, wp.float64, device)]
    inputs += [to_device(substep, int, device), to_device(status, int, device)]
    wp.launch(kernel.feed_inlets, dim=count, inputs=inputs, outputs=[out], device=device)
    return out.numpy().astype(np.float64)


def test_the_curvature_is_that_of_the_twin(device, dtype):
    width, identity = [20.0, 50.0, 50.0, 400.0], [3, 9, 9, 70_000]
    period = [12.0, 40.0, 40.0, 0.0]
    for begun, part in ((2, (0, 1)), (1000, (3, 5)), (300_000, (1, 2))):
        found = fed(width, period, identity, begun, part, dtype=dtype, device=device)
        time = 0.3 * (begun + part[0] / part[1])
        each = list(zip(width, period, identity, strict=True))[:3]
        expected = [0.1 * twin.slow_noise(5, i, time / p) / w for w, p, i in each]
        np.testing.assert_allclose(found[:3], expected, atol=0.1 / 20.0 * (1e-9 if dtype == "float64" else 1e-6))
        assert found[1] == found[2] and found[3] == 7.0, "a channel without inlet is left alone"


def test_nothing_is_fed_while_halted(device):
    assert fed([20.0], [12.0], [3], 100, (0, 1), halt=1, device=device).tolist() == [7.0]


def test_its_mean_square_and_its_periods_are_those_that_are_stated():
    turns = np.arange(0.0, 4000.0, 0.05)
    for seed in range(4):
        noise = twin.slow_noise(seed, 11, turns)
        assert np.mean(noise**2) == pytest.approx(1.0, abs=0.03) and abs(noise.mean()) < 0.02
        assert np.abs(noise).max() < 4.0
        crossings = np.count_nonzero(np.diff(np.sign(noise)) > 0.0)
        assert 0.7 < turns[-1] / crossings < 1.4, "a period from one upward crossing of zero to the next"
    assert abs(np.corrcoef(twin.slow_noise(0, 11, turns), twin.slow_noise(0, 12, turns))[0, 1]) < 0.1


def returned(lines, width, *, fed, stems=(), end_damping=3.0, saturation=0.3, dtype="float64", device="cpu", halt=0):
    """Curvature that the heads of lines 20 m apart feel of the foot of their river, of a memory of 2.5 widths."""
    scalar, count = SCALARS[dtype], len(lines)
    kernel, width = inlets.build(scalar), np.array(width)
    start = to_device(starts_of(lines), int, device)
    channels = channels_of(
        scalar,
        start=start,
        form=forms(width, np.ones(count), width, np.ones(count), scalar, device),
        spacing=to_device(np.full(count, 20.0), scalar, device),
        step=to_device(np.ones(count), scalar, device),
        fed=to_device(np.array(fed), int, device),
        stems=stems_of(stems, count, device),
    )
    points = points_of(scalar, to_device(np.concatenate(lines), vec2_of(scalar), device))
    constants = struct_of(
        kernel.MigrationConstants, memory_length=2.5, curvature_saturation=saturation, end_damping=end_damping
    )
    out = wp.full(count, 7.0, dtype=scalar, device=device)
    inputs = [channels, points, constants, status_of({HALT: halt}, device)]
    wp.launch(kernel.return_outflow, dim=count, inputs=inputs, outputs=[out], device=device)
    return out.numpy().astype(np.float64)


def outflow(line, width, saturation):
    """What a line feels three widths above its foot: the weighted mean, linear on each segment, by Gauss quadrature."""
    a, b = np.diff(line, axis=0)[:-1], np.diff(line, axis=0)[1:]
    bend = 2.0 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    bend = bend / (np.hypot(*a.T) * np.hypot(*b.T) * np.hypot(*(a + b).T))
    felt = saturation / width * np.tanh(width * bend / saturation)
    foot = len(line) - 1 - int(np.ceil(3.0 * width / 20.0))
    felt = felt[:foot]  # of the points 1 .. foot
    x, weight = np.polynomial.legendre.leggauss(20)
    part = 0.5 * (x + 1.0)
    z = 20.0 * (np.arange(len(felt) - 1)[:, None] + part)
    value = felt[:-1, None] + part * (felt[1:, None] - felt[:-1, None])
    alpha = 1.0 / (2.5 * width)
    return float((alpha * np.exp(-alpha * (20.0 * (len(felt) - 1) - z)) * value * 0.5 * weight * 20.0).sum())


def test_what_leaves_at_the_foot_of_a_river_comes_in_at_its_head(device, dtype):
    rng = np.random.default_rng(7)
    turned = np.cumsum(rng.normal(0.0, 0.25, (3, 150)), axis=1)
    lines = [20.0 * np.cumsum(np.stack([np.cos(t), np.sin(t)], axis=1), axis=0) for t in turned]
    tolerance = 1e-12 if dtype == "float64" else 3e-6
    found = returned(lines, [40.0, 60.0, 40.0], fed=[1, 1, 0], dtype=dtype, device=device)
    expected = [outflow(line, w, 0.3) for line, w in zip(lines[:2], (40.0, 60.0), strict=True)]
    np.testing.assert_allclose(found[:2], expected, atol=tolerance)
    assert found[2] == 7.0 and abs(found[0]) > 1e-4
    # The links 0 and 2 are one river: its head is that of the first, its foot that of the last.
    joined = returned(lines, [40.0, 60.0, 40.0], fed=[1, 0, 0], stems=[[0, 2]], dtype=dtype, device=device)
    np.testing.assert_allclose(joined[0], outflow(lines[2], 40.0, 0.3), atol=tolerance)
    assert (returned(lines, [40.0, 60.0, 40.0], fed=[1, 1, 1], halt=1, device=device) == 7.0).all()


def test_lines_too_short_for_bends_return_none_or_what_they_have(device):
    lines = [np.array([[0.0, 0.0], [20.0, 0.0]]), np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 1.0]])]
    assert np.isfinite(returned(lines, [40.0, 40.0], fed=[1, 1], device=device)).all()
