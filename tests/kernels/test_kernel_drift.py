"""``carry_foam`` against a float64 twin, and along a uniform current."""

import numpy as np
import reference_riverscape as reference
import warp as wp
from kernel_arrays import REALS, SCALARS, to_device, vec2_of

from warpriver.kernels import drift

NEAR = {"float64": 1e-12, "float32": 2e-6}


def carry(foam, velocity, source, size, step, kept, dtype, device):
    scalar, real = SCALARS[dtype], REALS[dtype]
    out = wp.empty(foam.shape, dtype=scalar, device=device)
    arrays = [
        to_device(velocity.astype(real), vec2_of(scalar), device),
        to_device(source.astype(real), scalar, device),
        to_device(foam.astype(real), scalar, device),
    ]
    inputs = [scalar(1.0 / size), scalar(step), scalar(kept), *arrays]
    wp.launch(drift.build(scalar).carry_foam, foam.shape, inputs, [out], device=device)
    return out.numpy()


def test_foam_is_carried_as_by_the_twin(dtype, device):
    rng = np.random.default_rng(1)
    foam, source = rng.random((9, 11)), 0.3 * rng.random((9, 11))
    velocity = rng.uniform(-1.0, 1.0, (9, 11, 2)).astype(np.float32).astype(float)
    found = carry(foam, velocity, source, 0.5, 0.7, 0.8, dtype, device)
    expected = reference.carried_foam(foam, velocity, source, 0.5, 0.7, 0.8)
    np.testing.assert_allclose(found, expected, atol=NEAR[dtype])


def test_a_patch_moves_with_the_current_and_fades(dtype, device):
    """Two cells a step to the east, one to the north; rows run from the north."""
    foam = np.zeros((12, 12))
    foam[6, 3] = 0.8
    velocity = np.broadcast_to([1.0, 0.5], (12, 12, 2))
    found = carry(foam, velocity, np.zeros((12, 12)), 0.5, 1.0, 0.5, dtype, device)
    expected = np.zeros((12, 12))
    expected[5, 5] = 0.4
    np.testing.assert_allclose(found, expected, atol=1e-6)
