"""What enters at inlets, by ``feed_inlets``, against its twin and what it is said to be."""

import numpy as np
import pytest
import reference_banks as twin
import warp as wp
from kernel_arrays import SCALARS, channels_of, forms, struct_of, to_device

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
