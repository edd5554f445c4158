import dataclasses
import runpy
import sys
from pathlib import Path

import pytest

import warpriver as wr

FOLDER = Path(__file__).resolve().parents[1] / "demos"
RUNNER = FOLDER / "scenes.py"
DEMOS = sorted(path for path in FOLDER.glob("*.py") if path != RUNNER)
# Of a demo with many rows a few, since each takes a second.
ROWS = {
    "path_knobs": ["search_radius", "smoothing"],
    "realism": ["inlet_curvature", "bank_spread", "memory_length", "chutes", "widths"],
}
SCENES = sorted(path.stem for path in (FOLDER / "scenes").glob("*.toml"))


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.usefixtures("coarse_pictures")
@pytest.mark.parametrize("demo", DEMOS, ids=lambda p: p.stem)
def test_demo_runs_and_its_own_check_holds(demo, tmp_path, monkeypatch):
    """As ``python demos/NAME.py FOLDER`` runs it."""
    monkeypatch.setattr(sys, "argv", [str(demo), str(tmp_path), *ROWS.get(demo.stem, ())])
    runpy.run_path(str(demo), run_name="__main__")
    assert {path.suffix for path in tmp_path.iterdir()} & {".png", ".jpg"}, "a demo draws something"
    assert len(demo.read_text().splitlines()) < 150


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("name", SCENES)
def test_scene_shows_what_its_figure_claims(name, tmp_path):
    """As ``python demos/scenes.py FOLDER NAME`` checks it, but for the pictures, which take most of its time."""
    runner = runpy.run_path(str(RUNNER), run_name="scenes")
    scene = wr.read_scene(FOLDER / "scenes" / f"{name}.toml")
    assert scene.outputs.pictures[0].file == f"{name}.png"
    # Records change no bits. The edits of a session are all done in its first fifty years.
    steps = scene.step_at(55.0) if name == "session" else scene.run_plan.steps
    scene = dataclasses.replace(
        scene,
        run_plan=dataclasses.replace(scene.run_plan, steps=steps, record_every=wr.Every(steps=10**6)),
        outputs=dataclasses.replace(scene.outputs, pictures=()),
    )
    sim = scene.simulation()
    scene.play(sim)
    scene.write(sim, tmp_path)
    assert runner[name](scene, sim, tmp_path)


@pytest.mark.usefixtures("coarse_pictures")
def test_the_runner_of_scenes_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(RUNNER), str(tmp_path), "junctions"])
    runpy.run_path(str(RUNNER), run_name="__main__")
    assert (tmp_path / "junctions.png").exists() and "degrees" in capsys.readouterr().out


def test_the_runner_of_scenes_is_short_and_every_scene_is_described():
    assert len(RUNNER.read_text().splitlines()) < 150
    readme = (FOLDER / "README.md").read_text()
    assert [name for name in SCENES if f"`{name}`" not in readme] == []
