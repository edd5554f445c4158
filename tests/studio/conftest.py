"""A studio that is served by a process of its own."""

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
    """A studio with those rivers."""
    from talk import serving

    folder = tmp_path_factory.mktemp("served") / "session"
    with serving(str(lines_file), "--folder", str(folder), folder=folder) as made:
        yield made


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
