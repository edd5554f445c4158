"""``warpriver calibrate``: what it writes can be simulated, and what is wrong is told in one line."""

import numpy as np
import pytest
import surveyed
from surveyed import measured

import warpriver as wr
from warpriver.cli import main

pytestmark = pytest.mark.usefixtures("coarse_pictures")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder, line = tmp_path_factory.mktemp("surveys"), surveyed.grown()
    for k in range(3):
        wr.write_network(measured(line, 3.0, k), folder / f"{k}.csv")
        line = surveyed.moved(line, 10.0)[0]
    return folder


def run(capsys, *arguments):
    code = main(["calibrate", *(str(a) for a in arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_two_surveys_give_a_scene_that_simulates(files, tmp_path, capsys):
    out = tmp_path / "out"
    code, said, err = run(capsys, files / "0.csv", files / "1.csv", "--years", 10, "-o", out)
    assert code == 0, err
    assert "migration_rate" in said and "half by the constants of the other" in said and str(out / "map.png") in said
    for name in ("scene.toml", "rivers.csv", "points.csv", "forecasts.csv", "fit.png", "map.png"):
        assert (out / name).stat().st_size > 0, name
    scene = wr.read_scene(out / "scene.toml")
    assert scene.params.migration_rate == pytest.approx(20.0, rel=0.1)
    assert scene.years == pytest.approx(10.0, abs=0.3)
    assert main(["simulate", str(out / "scene.toml"), "-o", str(tmp_path / "run"), "--no-progress"]) == 0
    code, _, err = run(capsys, files / "0.csv", files / "1.csv", "--years", 10, "-o", out)
    assert code == 2 and "scene.toml" in err


def test_three_surveys_give_forecasts(files, tmp_path, capsys):
    surveys = [files / f"{k}.csv" for k in range(3)]
    dates = ["--dates", 1990, 2000, 2010, "--leads", 10, "--window", 10]
    code, said, err = run(capsys, *surveys, *dates, "--fit", "migration_rate", "-o", tmp_path / "out")
    assert code == 0, err
    assert "no change" in said and (tmp_path / "out" / "forecasts.png").stat().st_size > 0
    table = np.genfromtxt(tmp_path / "out" / "forecasts.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert table["begin"] == 2000 and table["end"] == 2010 and table["distance"] < 0.7 * table["no_change"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["0.csv", "--years", "10"], "one survey"),
        (["0.csv", "1.csv"], "--years between two surveys"),
        (["0.csv", "1.csv", "2.csv", "--years", "10"], "give --dates"),
        (["0.csv", "1.csv", "--dates", "1990"], "--dates has 1"),
        (["0.csv", "1.csv", "--dates", "2000", "1990"], "oldest first"),
        (["0.csv", "1.csv", "--years", "-3"], "--years"),
        (["0.csv", "1.csv", "--years", "10", "--vary", "friction"], "not fitted"),
        (["1.csv", "0.csv", "--years", "10"], "outer banks"),
        (["0.csv", "none.csv", "--years", "10"], "none.csv"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(files, tmp_path, capsys, monkeypatch, arguments, said):
    monkeypatch.chdir(files)
    code, _, err = run(capsys, *arguments, "-o", tmp_path / "out")
    assert code == 2 and said in err and len(err.strip().splitlines()) == 1, err
    assert not (tmp_path / "out").exists()
