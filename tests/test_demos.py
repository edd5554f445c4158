import runpy
import sys
from pathlib import Path

import pytest

DEMOS = sorted((Path(__file__).resolve().parents[1] / "demos").glob("*.py"))


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.usefixtures("coarse_pictures")
@pytest.mark.parametrize("demo", DEMOS, ids=lambda p: p.stem)
def test_demo_runs_and_its_own_check_holds(demo, tmp_path, monkeypatch):
    """As ``python demos/NAME.py FOLDER`` runs it."""
    monkeypatch.setattr(sys, "argv", [str(demo), str(tmp_path)])
    runpy.run_path(str(demo), run_name="__main__")
    assert list(tmp_path.glob("*.png")), "a demo draws something"
    assert len(demo.read_text().splitlines()) < 150
