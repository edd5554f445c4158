"""What is written of the run of a scene."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from warpriver import viz
from warpriver.edits.session import write_edits
from warpriver.io.raster.terrains import write_terrain
from warpriver.io.vector.histories import write_history
from warpriver.io.vector.networks import write_network
from warpriver.scenes.parts import Outputs, Picture
from warpriver.simulation import Simulation

__all__ = ["MOVIES", "PICTURES", "picture_options", "write_outputs"]

# What a picture may be of: what draws it, and the endings of its file.
PAGES, PREVIEWS = (".png", ".jpg", ".pdf", ".svg"), (".png", ".jpg")
MOVIES = (".gif", ".mp4")
PICTURES: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "belt": (viz.draw_belt, PAGES),
    "before_after": (viz.draw_before_after, PAGES),
    "network": (viz.draw_network, PAGES),
    "movie": (viz.movie, MOVIES),
    "preview": (viz.render_scene, PREVIEWS),
}
# Arguments of those functions that a file can hold.
OPTIONS = ("age_span", "color", "dpi", "every", "exaggeration", "flow_arrow", "fps", "frame", "hold", "legend", "size",
           "title", "window")  # fmt: skip


def picture_options(of: str) -> list[str]:
    """Return the keys that a picture of a kind has, beside file, of, relief and until."""
    names = inspect.signature(PICTURES[of][0]).parameters
    return [name for name in OPTIONS if name in names]


def write_outputs(outputs: Outputs, simulation: Simulation, folder: Path) -> list[Path]:
    """Write what is to be written of a simulation that was run, and return the files."""
    written: list[Path] = []
    if outputs.lines is not None:
        written.append(folder / outputs.lines)
        write_network(simulation.network, written[-1])
    if outputs.gis is not None:
        written += write_history(simulation.history, folder / outputs.gis, layers=outputs.layers)
    if outputs.terrain is not None and simulation.terrain is not None:
        written.append(folder / outputs.terrain)
        write_terrain(simulation.terrain, written[-1])
    if outputs.session is not None:
        written.append(folder / outputs.session)
        write_edits(written[-1], simulation)
    for picture in outputs.pictures:
        written.append(folder / picture.file)
        _draw(picture, simulation, written[-1])
    return written


def _draw(picture: Picture, simulation: Simulation, path: Path) -> None:
    history = simulation.history
    options: dict[str, Any] = dict(picture.options)
    if picture.relief and simulation.terrain is not None:
        options["terrain"] = simulation.terrain
    shown = len(history.times) - 1
    if picture.until is not None:
        shown = max(0, int((history.times <= picture.until * (1.0 + 1e-12)).sum()) - 1)
    draw = PICTURES[picture.of][0]
    if picture.of == "network":
        draw(history.networks[shown], path, **options)
        return
    if picture.of != "movie":
        options["until"] = shown
    draw(history, path, **options)
