"""One studio that is served by a process of its own, and one browser, for all tests of this folder."""

import http.client

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


@pytest.fixture(scope="session")
def studio(tmp_path_factory):
    """A studio as it begins without a file."""
    from talk import serving

    folder = tmp_path_factory.mktemp("studio") / "session"
    with serving("--folder", str(folder), folder=folder) as made:
        yield made


@pytest.fixture(scope="session")
def chromium():
    """A browser."""
    from browser import Browser

    made = Browser()
    yield made
    made.close()


def send(studio, method, path, body):
    """Do a request as the page does, and return status and text of the answer."""
    connection = http.client.HTTPConnection("127.0.0.1", studio.port, timeout=120)
    ours = {"Cookie": f"warpriver_studio={studio.token}", "Origin": f"http://127.0.0.1:{studio.port}"}
    connection.request(method, path, body, {"Host": f"127.0.0.1:{studio.port}"} | ours)
    answer = connection.getresponse()
    return answer.status, answer.read()


@pytest.fixture(scope="module")
def served(studio, lines_file):
    """The studio with those rivers."""
    status, told = send(studio, "PUT", "/open/rivers.geojson", lines_file.read_bytes())
    assert status == 200, told
    return studio


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
