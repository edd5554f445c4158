"""``warpriver render``: maps, movies and 3-D previews."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from warpriver.cli.output import say
from warpriver.cli.parser import number, whole_number
from warpriver.cli.shared import (
    MOVIES,
    OK,
    PICTURES,
    add_lines,
    add_terrain,
    check_picture,
    command,
    ground_under,
    quiet_warp,
    read_lines,
    read_run,
    stored_run,
)
from warpriver.errors import InputError

__all__ = ["add"]

PREVIEWS = (".png", ".jpg")


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "render",
        _render,
        help="draw a stored run or river lines: map, movie or 3-D preview",
        description="Draw a stored run (its channel belt: old courses by age, oxbow lakes, the channel) or lines.\n"
        "The ending of OUT says what: .png, .jpg, .pdf or .svg a map, or with --scene a 3-D preview (.png, .jpg);\n"
        ".gif or .mp4 a movie.",
        epilog="examples:\n"
        "  warpriver render out/river/run -o belt.png\n"
        "  warpriver render out/river/run -o belt.gif --every 2\n"
        "  warpriver render out/river/run --scene -o preview.png\n"
        "  warpriver render river.csv --width 80 -o map.png",
    )
    parser.add_argument("input", metavar="INPUT", help="run folder or .npz, or river lines")
    parser.add_argument("-o", "--out", required=True, metavar="OUT", help="picture or movie to write")
    parser.add_argument("--scene", action="store_true", help="3-D preview instead of a map")
    parser.add_argument(
        "--until",
        type=number(unit="years"),
        metavar="YEARS",
        help="of a run: draw its state at this time, not of a movie (default: the last)",
    )
    parser.add_argument(
        "--window", type=float, nargs=4, metavar=("W", "S", "E", "N"), help="area to draw, in m (default: everything)"
    )
    parser.add_argument(
        "--every", type=whole_number(1), metavar="N", help="of a movie: records from frame to frame (default 1)"
    )
    parser.add_argument(
        "--fps", type=number(0.0, 60.0, above=0.0), metavar="N", help="of a movie: frames a second (default 12)"
    )
    parser.add_argument("--title", help="title of a map or movie")
    add_terrain(parser, "heights to draw under the rivers")
    add_lines(parser)


def _render(options: argparse.Namespace) -> int:
    source, out = Path(options.input), Path(options.out)
    is_movie = out.suffix.lower() in MOVIES
    run = stored_run(source)
    check_picture(out, "-o", PREVIEWS if options.scene and not is_movie else (*PICTURES, *MOVIES))
    _check_flags(source, out, is_movie, run, options)
    quiet_warp()
    from warpriver import viz

    if run is None:
        network = read_lines(source, options)
        terrain = ground_under(options, network.crs)
        if options.scene:
            viz.render_scene(network, out, window=options.window, terrain=terrain)
        else:
            viz.draw_network(network, out, window=options.window, terrain=terrain, title=options.title)
        say(out)
        return OK
    history = read_run(run)
    terrain = ground_under(options, history.crs)
    shown: dict[str, Any] = {"window": options.window, "terrain": terrain}
    if options.until is not None:
        shown["until"] = int((history.times <= options.until).sum()) - 1
        if shown["until"] < 0:
            raise InputError(f"--until {options.until:g}: the run begins at {history.times[0]:g} yr")
    if is_movie:
        viz.movie(history, out, fps=options.fps or 12.0, every=options.every or 1, title=options.title, **shown)
    elif options.scene:
        viz.render_scene(history, out, **shown)
    else:
        viz.draw_belt(history, out, title=options.title, **shown)
    say(out)
    return OK


def _check_flags(source: Path, out: Path, is_movie: bool, run: Path | None, options: argparse.Namespace) -> None:
    """Refuse what cannot be drawn, and flags that would do nothing."""
    if run is None and is_movie:
        raise InputError(f"{source} holds lines, not a run: there is nothing to make a movie of; use .png")
    for flag, given, useless, why in (
        ("--scene", options.scene, is_movie, f"{out} is a movie of maps"),
        ("--until", options.until is not None, is_movie, f"{out} is a movie of all times"),
        ("--until", options.until is not None, run is None, f"{source} holds lines, not a run"),
        ("--every", options.every is not None, not is_movie, f"{out} is no movie"),
        ("--fps", options.fps is not None, not is_movie, f"{out} is no movie"),
        ("--title", options.title is not None, options.scene, "a preview has none"),
    ):
        if given and useless:
            raise InputError(f"{flag}: {why}; leave it out")
