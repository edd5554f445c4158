"""``warpriver render``: maps, movies and 3-D previews."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from warpriver.cli.shared import (
    OK,
    add_ground,
    add_lines,
    command,
    ground_under,
    quiet_warp,
    read_lines,
    read_run,
    stored_run,
)
from warpriver.errors import InputError

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "render",
        _render,
        help="draw a stored run or river lines: map, movie or 3-D preview",
        description="Draw a stored run (its channel belt: old courses by age, oxbow lakes, the channel) or lines.\n"
        "The ending of OUT says what: .png a map, or with --scene a 3-D preview; .gif or .mp4 a movie.",
        epilog="examples:\n"
        "  warpriver render out/river/run -o belt.png\n"
        "  warpriver render out/river/run -o belt.gif --every 2\n"
        "  warpriver render out/river/run --scene -o preview.png\n"
        "  warpriver render river.csv --width 80 -o map.png",
    )
    parser.add_argument("input", metavar="INPUT", help="run folder or .npz, or river lines")
    parser.add_argument("-o", "--out", required=True, metavar="OUT", help="picture or movie to write")
    parser.add_argument("--scene", action="store_true", help="3-D preview instead of a map")
    parser.add_argument("--until", type=float, metavar="YEARS", help="draw the state at this time (default: the last)")
    parser.add_argument(
        "--window", type=float, nargs=4, metavar=("W", "S", "E", "N"), help="part to draw, in m (default: everything)"
    )
    parser.add_argument("--terrain", metavar="FILE", help="heights to draw under the rivers")
    add_ground(parser)
    parser.add_argument("--every", type=int, default=1, help="records a frame of a movie (default 1)")
    parser.add_argument("--fps", type=float, default=12.0, help="frames a second of a movie (default 12)")
    parser.add_argument("--title", help="title of a map or movie")
    add_lines(parser)


def _render(options: argparse.Namespace) -> int:
    from warpriver import viz

    quiet_warp()
    source, out = Path(options.input), Path(options.out)
    is_movie = out.suffix.lower() in (".gif", ".mp4")
    if not is_movie and out.suffix.lower() != ".png":
        raise InputError(f"{out}: the ending says what to draw; use .png, .gif or .mp4")
    window, run = options.window, stored_run(source)
    if run is None:
        if is_movie:
            raise InputError(f"{source} holds lines, not a run: there is nothing to make a movie of; use .png")
        network = read_lines(source, options)
        terrain = ground_under(options, network.crs)
        if options.scene:
            viz.render_scene(network, out, window=window, terrain=terrain)
        else:
            viz.draw_network(network, out, window=window, terrain=terrain, title=options.title)
        print(out)
        return OK
    history = read_run(run)
    terrain = ground_under(options, history.crs)
    until = None
    if options.until is not None:
        until = int((history.times <= options.until).sum()) - 1
        if until < 0:
            raise InputError(f"--until {options.until:g}: the run begins at {history.times[0]:g} yr")
    if is_movie:
        viz.movie(
            history, out, fps=options.fps, window=window, terrain=terrain, every=options.every, title=options.title
        )
    elif options.scene:
        viz.render_scene(history, out, window=window, terrain=terrain, until=until)
    else:
        viz.draw_belt(history, out, window=window, terrain=terrain, until=until, title=options.title)
    print(out)
    return OK
