"""What tests may ask of a device: its kind, and how closely results that the CPU gives to the bit are to be met."""

import numpy as np
import pytest
import warp as wp


def is_cpu(device):
    """Whether a name is that of a CPU device."""
    return wp.get_device(device).is_cpu


def need_cpu(device, why):
    """Skip a test that has nothing to say of a GPU."""
    if not is_cpu(device):
        pytest.skip(f"{device}: {why}")


def assert_bits(found, expected, device, allowed):
    """Assert that arrays are equal: to the bit on the CPU, within ``allowed`` on a GPU.

    Bits differ between devices, and between a GPU and NumPy, where multiplications and additions are fused: not from
    run to run. NaN equals NaN.
    """
    if is_cpu(device):
        np.testing.assert_array_equal(found, expected)
    else:
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=allowed)
