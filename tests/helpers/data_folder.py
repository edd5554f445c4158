"""Where measured rivers and golden cases lie; tests that need them skip, with a reason, where they are missing."""

import os
from pathlib import Path

import pytest

DEFAULT = Path(__file__).resolve().parents[3] / "shared" / "data"


def data_folder(part=""):
    """Folder of the test data, or a part of it, or a skip that says where it was looked for."""
    root = Path(os.environ.get("WARPRIVER_DATA", DEFAULT))
    folder = root / part
    if not folder.is_dir():
        pytest.skip(f"no test data in {folder}; set WARPRIVER_DATA to the folder that holds {part or 'them'}")
    return folder
