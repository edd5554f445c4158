"""Kernels of synthetic terrains, and the noise in them, against their twins."""

import math

import numpy as np
import pytest
import reference_terrain as twin
import warp as wp
from kernel_arrays import SCALARS, to_device, unwritten

from warpriver.kernels import terrains

# Float32: a place some thousand wavelengths from the corner is off by 1e-4 of a wavelength, and noise is as steep as 4.
TOLERANCE = {"float64": 1e-12, "float32": 1e-3}


@pytest.mark.parametrize("seed", [0, 7, 2**31 - 9])
def test_octaves_are_those_of_the_twin(dtype, device, seed):
    kernel = terrains.build(SCALARS[dtype])
    law = kernel.Octaves()
    law.seed, law.count, law.longest, law.cell_size, law.roughness = seed, 4, 90.0, 7.0, 0.6
    out = unwritten((12, 17), wp.float64, device)
    wp.launch(kernel.sum_octaves, dim=(12, 17), inputs=[law], outputs=[out], device=device)
    expected = twin.octave_sum(seed, (12, 17), 7.0, 90.0, 0.6, 4)
    np.testing.assert_allclose(out.numpy(), expected, atol=TOLERANCE[dtype], rtol=0.0)


def random_land(rows=15, columns=19, seed=0):
    """Heights, and base cells along an edge and inside."""
    rng = np.random.default_rng(seed)
    base = rng.random((rows, columns)) < 0.05
    base[-1] = True
    return rng.uniform(0.0, 100.0, (rows, columns)), base


def test_receivers_are_those_of_the_twin(device):
    kernel = terrains.build(wp.float64)
    height, base = random_land()
    out = unwritten(height.size, wp.int32, device)
    inputs = [to_device(height, wp.float64, device), to_device(base.astype(np.int32), wp.int32, device)]
    wp.launch(kernel.find_receivers, dim=height.shape, inputs=inputs, outputs=[out], device=device)
    found = out.numpy()
    np.testing.assert_array_equal(found, twin.receivers(height, base))
    assert (found == np.arange(height.size)).sum() > base.sum(), "the case has no pit"


def test_land_is_drained_as_by_the_twin(device):
    kernel = terrains.build(wp.float64)
    height, base = random_land(seed=1)
    receiver = twin.receivers(height, base)
    rng = np.random.default_rng(2)
    resistance, floor = rng.uniform(0.5, 2.0, height.size), rng.uniform(0.0, 30.0, height.size)
    law = kernel.Drainage()
    law.cell_size, law.steepness, law.concavity, law.hillslope = 30.0, 9.0, 0.45, 2500.0
    order = np.argsort(height, axis=None, kind="stable").astype(np.int32)
    area = to_device(np.full(height.size, 900.0), wp.float64, device)
    out = to_device(height.ravel(), wp.float64, device)
    inputs = [
        law, to_device(order, wp.int32, device), to_device(receiver.astype(np.int32), wp.int32, device),
        to_device(resistance, wp.float64, device), to_device(floor, wp.float64, device), height.shape[1],
    ]  # fmt: skip
    wp.launch(kernel.drain_cells, dim=1, inputs=inputs, outputs=[area, out], device=device)
    expected = twin.drained(height, receiver, resistance, floor, 30.0, 9.0, 0.45, 2500.0)
    np.testing.assert_array_equal(area.numpy(), expected[0])
    np.testing.assert_allclose(out.numpy(), expected[1], rtol=1e-13)
    ends = receiver == np.arange(height.size)
    assert area.numpy()[ends].sum() == pytest.approx(height.size * 900.0)


def test_noise_has_the_size_and_wavelength_that_it_is_said_to_have(device):
    """One octave: 0 at the lattice points, within [-1, 1], and no trend over many cells."""
    kernel = terrains.build(wp.float64)
    law = kernel.Octaves()
    law.seed, law.count, law.longest, law.cell_size, law.roughness = 3, 1, 10.0, 1.0, 1.0
    out = wp.zeros((600, 600), dtype=wp.float64, device=device)
    wp.launch(kernel.sum_octaves, dim=out.shape, inputs=[law], outputs=[out], device=device)
    noise = out.numpy()
    assert 0.85 < np.abs(noise).max() <= 1.0
    assert abs(noise.mean()) < 0.01
    # The mean square of gradient noise with unit gradients: 2 * 0.5 * 2 * (integral of its squared profile) in theory.
    t = (np.arange(4000) + 0.5) / 4000
    fade = 1.0 - (6.0 * t**5 - 15.0 * t**4 + 10.0 * t**3)
    square = 2.0 * 0.5 * 4.0 * 2.0 * ((fade * t) ** 2).mean() * (fade**2).mean()
    assert noise.std() == pytest.approx(math.sqrt(square), rel=0.05)
