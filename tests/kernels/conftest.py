"""Gives every kernel test the devices of the machine, and both precisions."""

import pytest
import warp as wp


@pytest.fixture(params=[device.alias for device in wp.get_devices()])
def device(request):
    return request.param


@pytest.fixture(params=["float64", "float32"])
def dtype(request):
    return request.param
