"""Where measured rivers and golden cases lie; tests that need them skip, with a reason, where they are missing."""

import os
from pathlib import Path

import pytest

DEFAULT = Path(__file__).resolve().parents[3] / "shared" / "data"
# Surveys with a width at every point, by river and dates.
SURVEYS = {
    "jurua": ("19871012", "20170710"),
    "jutai": ("19890805", "20170802"),
    "mamore": ("19861105", "19890708"),
    "purus": ("19870701", "20170804"),
    "tarauaca": ("20070729", "20170724"),
    "tarauaca_jurua": ("20070729", "20170724"),
}


def data_folder(part=""):
    """Folder of the test data, or a part of it, or a skip that says where it was looked for."""
    root = Path(os.environ.get("WARPRIVER_DATA", DEFAULT))
    folder = root / part
    if not folder.is_dir():
        pytest.skip(f"no test data in {folder}; set WARPRIVER_DATA to the folder that holds {part or 'them'}")
    return folder
