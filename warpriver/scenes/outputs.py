"""What is written of the run of a scene."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver import viz
from warpriver.edits.session import write_edits
from warpriver.files import beside
from warpriver.io.raster.terrains import write_terrain
from warpriver.io.tables import raising
from warpriver.io.vector.histories import write_history
from warpriver.io.vector.networks import write_network
from warpriver.meander.controls import Attractor, Control, Guide, RateControl, Repeller
from warpriver.scenes.parts import Outputs, Picture, TimedControl
from warpriver.simulation import Simulation
from warpriver.viz.sheet import save_figure

__all__ = ["MAPS", "MOVIES", "PICTURES", "picture_options", "write_outputs"]

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
# Pictures that can show controls, and the colour of their outlines.
MAPS, OUTLINE = ("belt", "before_after", "network"), "#8c2d2d"
# Arguments of those functions that a file can hold.
OPTIONS = ("age_span", "color", "dpi", "every", "exaggeration", "flow_arrow", "fps", "frame", "hold", "legend", "size",
           "title", "window")  # fmt: skip


def picture_options(of: str) -> list[str]:
    """Return the keys that a picture of a kind has, beside file, of, relief and until."""
    names = inspect.signature(PICTURES[of][0]).parameters
    return [name for name in OPTIONS if name in names]


def write_outputs(
    outputs: Outputs, simulation: Simulation, controls: Sequence[TimedControl], folder: Path, label: str
) -> list[Path]:
    """Write what is to be written of a simulation that was run, and return the files.

    Args:
        outputs: What is to be written.
        simulation: The run.
        controls: Controls that a picture may show.
        folder: Where the files go.
        label: The scene, for messages.

    Raises:
        ValueError: A picture cannot be drawn as it is asked for.
        OSError: A file cannot be written.
    """
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
    for number, picture in enumerate(outputs.pictures):
        written.append(folder / picture.file)
        draw = functools.partial(_draw, picture, simulation, controls, written[-1])
        raising(f"{label}: output.picture[{number}]", draw, {})
    return written


def _draw(picture: Picture, simulation: Simulation, controls: Sequence[TimedControl], path: Path) -> None:
    history = simulation.history
    options: dict[str, Any] = dict(picture.options)
    if picture.relief and simulation.terrain is not None:
        options["terrain"] = simulation.terrain
    shown = len(history.times) - 1
    if picture.until is not None:
        shown = max(0, int((history.times <= picture.until * (1.0 + 1e-12)).sum()) - 1)
    draw = PICTURES[picture.of][0]
    shown_network = picture.of == "network"
    if picture.of not in ("movie", "network"):
        options["until"] = shown
    what = history.networks[shown] if shown_network else history
    if not picture.controls:
        draw(what, path, **options)
        return
    figure = draw(what, **options)
    time = float(history.times[shown])
    at_work = [each.control for each in controls if each.begin <= time and (each.end is None or time <= each.end)]
    # Of two maps, that of the later time.
    _outline(at_work, figure.axes[1 if picture.of == "before_after" else 0])
    with beside(path) as temporary:
        save_figure(figure, str(temporary), float(options.get("dpi", figure.dpi)))


def _outline(controls: Sequence[Control], axes: Any) -> None:
    """Draw what controls reach: drawn through where they draw rivers to them, dashed where they drive them off."""
    from matplotlib.patches import Circle, Polygon, Rectangle

    for control in controls:
        style: dict[str, Any] = {"fill": False, "edgecolor": OUTLINE, "linewidth": 1.6, "zorder": 50}
        if isinstance(control, Attractor):
            repels = isinstance(control, Repeller) != (control.strength < 0.0)
            axes.add_patch(Circle(control.center, control.radius, linestyle="--" if repels else "-", **style))
            axes.plot(*control.center, marker="x" if repels else "+", color=OUTLINE, markersize=9, zorder=50)
        elif isinstance(control, Guide):
            axes.plot(*np.asarray(control.xy).T, color=OUTLINE, linewidth=1.6, zorder=50)
        elif isinstance(control, RateControl) and control.polygon is not None:
            axes.add_patch(Polygon(control.polygon, linestyle=":", **style))
        else:
            west, south, east, north = control.bounds()
            axes.add_patch(Rectangle((west, south), east - west, north - south, linestyle=":", **style))
