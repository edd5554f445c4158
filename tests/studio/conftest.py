"""A studio that is served by a process of its own."""

import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

for module in ("starlette", "uvicorn", "websockets"):
    pytest.importorskip(module, reason="the studio needs warpriver[studio]")


@pytest.fixture(scope="session")
def lines_file(tmp_path_factory):
    """Two rivers that meet, as a file: 200 points."""
    import warpriver as wr

    a = wr.generate.noisy_line(length=5000, spacing=50, amplitude=80, seed=1)
    b = np.stack([np.linspace(a[-1, 0] - 2500, a[-1, 0], 60), np.linspace(2200, a[-1, 1], 60)], 1)
    c = a[-1] + np.stack([np.linspace(0, 4000, 90), 60 * np.sin(np.linspace(0, 9, 90))], 1)
    path = tmp_path_factory.mktemp("studio") / "rivers.geojson"
    wr.write_network(wr.RiverNetwork.from_polylines([a, b, c], width=[60.0, 40.0, 80.0]), path)
    return path


@pytest.fixture(scope="module")
def served(lines_file, tmp_path_factory):
    """A studio with those rivers: ``link``, ``port``, ``token``, ``folder``."""
    folder = tmp_path_factory.mktemp("served") / "session"
    command = [sys.executable, "-m", "warpriver", "studio", str(lines_file), "--no-browser", "--folder", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    found = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=(\S+)", line)
    if not found:
        process.kill()
        raise RuntimeError(f"no link: {line} {process.stderr.read()}")
    yield SimpleNamespace(link=found[0], port=int(found[1]), token=found[2], folder=folder, process=process)
    process.terminate()
    assert process.wait(20) is not None


@pytest.fixture
def page(served):
    """Makes pages without a browser, which are closed in the end."""
    from talk import Talk

    made = []

    def make(**headers):
        made.append(Talk(served, **headers))
        return made[-1]

    yield make
    for talk in made:
        talk.close()
