"""Pictures are coarse where a test does not ask for more."""

import pytest


@pytest.fixture(autouse=True)
def few_pixels(coarse_pictures):
    """Draw 60 dots an inch where nothing else is asked for."""
