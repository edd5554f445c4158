"""Gives every kernel test both precisions."""

import pytest


@pytest.fixture(params=["float64", "float32"])
def dtype(request):
    return request.param
