"""Makes the twins in ``tests/reference.py`` importable, and gives every kernel test the devices of the machine."""

import sys
from pathlib import Path

import pytest
import warp as wp

sys.path.insert(0, str(Path(__file__).parents[1]))


@pytest.fixture(params=[device.alias for device in wp.get_devices()])
def device(request):
    return request.param


@pytest.fixture(params=["float64", "float32"])
def dtype(request):
    return request.param
