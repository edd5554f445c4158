"""``warpriver demo``: from a synthetic terrain to its rivers after centuries."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.output import say
from warpriver.cli.parser import area, number, whole_number
from warpriver.cli.results import write_ground, write_run
from warpriver.cli.runs import add_run_options, make_params, run_simulation, write_results
from warpriver.cli.shared import can_draw, command, fresh_folder, quiet_warp, results_in

if TYPE_CHECKING:
    import numpy as np

    from warpriver.history import History
    from warpriver.network import RiverNetwork
    from warpriver.terrain import Terrain

__all__ = ["add"]

# Frames of the demo's movie; more make the file larger, not the film better.
DEMO_FRAMES = 40
# Width and height of its frames in pixels.
MOVIE_SIZE = (880, 680)
# Width and height of the close-up in pixels, and half of its width as a part of the terrain's.
LANDSCAPE_SIZE, CLOSEUP = (1400, 960), 0.2
RESULTS = ("run", "terrain.npz", "network.csv", "channels.csv", "rivers.gpkg", "rivers.geojson")


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "demo",
        _demo,
        help="the main job on built-in input: a terrain, its rivers, and what they do in centuries",
        description="Make a basin of 40 x 26 km among mountains, find its rivers, let them migrate, cut off their\n"
        "bends and run into each other, and draw them before and after. Needs no file from outside.\n"
        "Into FOLDER go terrain.npz and terrain.tif, network.csv and network.png (the rivers as found), run (the\n"
        "simulation), channels.csv and rivers.png (the rivers after it), rivers.gpkg (for a GIS: rivers, courses with\n"
        "times, oxbow lakes, abandoned courses), before_after.png, landscape.png (the largest river in its belt), and\n"
        "the movie rivers.gif.",
        epilog="examples:\n"
        "  warpriver demo\n"
        "  warpriver demo --seed 3 --relief 600 --years 500 -o out/gentle\n"
        "  warpriver demo --min-area 2 --cell-size 50 --no-movie -o out/fine",
    )
    ground = parser.add_argument_group("terrain and network")
    ground.add_argument(
        "--cell-size",
        type=number(above=0.0, unit="m"),
        default=100.0,
        metavar="M",
        help="size of a cell of the terrain in m (default 100)",
    )
    ground.add_argument(
        "--relief",
        type=number(0.0, unit="m"),
        default=1200.0,
        metavar="M",
        help="height of the mountains in m (default 1200)",
    )
    ground.add_argument("--seed", type=whole_number(), default=1, help="seed of the terrain and of the run (default 1)")
    ground.add_argument(
        "--min-area",
        type=area,
        default=area("8"),
        metavar="AREA",
        help="minimum drainage area of a channel: 8 or 8km2, 5e6m2, 50cells (default 8km2)",
    )
    parser.add_argument("--no-movie", action="store_true", help="skip the movie, the slowest picture")
    add_run_options(parser, out="out/demo", years=300.0, record_every="20steps")


def _demo(options: argparse.Namespace) -> int:
    from warpriver import generate, hydrology
    from warpriver.history import StopReason
    from warpriver.io.raster.terrains import write_terrain
    from warpriver.io.vector.networks import write_network
    from warpriver.simulation import Simulation
    from warpriver.terrain import TerrainFile

    quiet_warp()
    params = make_params(options)
    out = options.out or "out/demo"
    fresh_folder(out, *RESULTS, make=False)
    terrain = generate.intermontane_basin(options.cell_size, options.seed, relief=options.relief, device=options.device)
    network = hydrology.extract_network(
        terrain,
        min_drainage_area=options.min_area.square_meters(options.cell_size),
        dtype=options.dtype or "float64",
        device=options.device,
    )
    folder = Path(out)
    # The run finds its ground there when it goes on.
    terrain.file = TerrainFile(str((folder / "terrain.npz").resolve()))
    simulation = Simulation(
        network, params, terrain=terrain, seed=options.seed, check=options.check, threads=options.threads
    )
    with results_in(folder):
        write_terrain(terrain, folder / "terrain.npz")
        write_network(network, folder / "network.csv")
        say(f"{terrain}\n{network}\n  terrain  {folder / 'terrain.npz'}\n  lines    {folder / 'network.csv'}")
        say(*write_ground(terrain, folder))
        code, told = run_simulation(simulation, options, folder / "run")
        try:
            if simulation.history.stop_reason is not StopReason.STORE_FAILED:
                told += write_results(simulation, folder)
                told += write_run(simulation.history, folder)
                told += _draw_demo(simulation.history, terrain, folder, movie=not options.no_movie)
        finally:
            for line in told:
                say(line)
    return code


def _draw_demo(history: History, terrain: Terrain, folder: Path, *, movie: bool) -> list[str]:
    """Draw the rivers before, after, and on the way; return what to say of it."""
    if not can_draw():
        return []
    from warpriver import hydrology, viz
    from warpriver.viz.belt import BeltSheet, belt_ramps, history_bounds, share_painter
    from warpriver.viz.movie import write_frames

    found = history.networks[0]
    order = hydrology.strahler_order(found.channel_from, found.channel_to)
    viz.draw_network(
        found, folder / "network.png", terrain=terrain, color="order", order=order, title="Rivers of the terrain"
    )
    title = "Rivers of a basin"
    last = len(history) - 1
    # The pages share the cells that are led from record to record, which takes longest.
    layout: dict[str, Any] = {"terrain": terrain, "bounds": history_bounds(history, last)}
    map_page = BeltSheet(history, color="discharge", title=title, **layout)
    both = BeltSheet(history, title="Before and after", two=True, **layout)
    pages = [map_page, both]
    if movie:
        pages.append(BeltSheet(history, title=title, size=MOVIE_SIZE, dpi=100.0, **layout))
    share_painter(pages, history, terrain)
    told = [f"  picture  {folder / name}" for name in ("network.png", "rivers.png", "before_after.png")]

    def frames() -> Iterator[np.ndarray]:
        """Turn all pages; those of the movie are its frames."""
        both.turn_to(0, panel=0)
        for record in [*range(0, last, -(-len(history) // DEMO_FRAMES)), last]:
            if movie:
                pages[-1].turn_to(record)
                yield pages[-1].pixels()
        map_page.turn_to(last)
        both.turn_to(last, panel=1)

    if movie:
        write_frames(folder / "rivers.gif", frames(), fps=8.0, hold=2.0, ramps=belt_ramps(history))
        told.append(f"  movie    {folder / 'rivers.gif'}")
    else:
        list(frames())
    map_page.sheet.save(folder / "rivers.png")
    both.sheet.save(folder / "before_after.png")
    viz.draw_landscape(
        history, folder / "landscape.png", terrain=terrain, window=_closeup(history.networks[-1], terrain),
        size=LANDSCAPE_SIZE, dpi=110.0, title=title,
    )  # fmt: skip
    told.append(f"  picture  {folder / 'landscape.png'}")
    return told


def _closeup(network: RiverNetwork, terrain: Terrain) -> tuple[float, float, float, float]:
    """Return a window of two fifths of the terrain in the middle of the widest river, in its lower half."""
    west, south, east, north = terrain.bounds
    channel = int(network.channel_width.argmax())
    line = network.polylines()[channel]
    x, y = line[len(line) // 2 :].mean(axis=0)
    # The map is lower than its page; within the terrain as far as that goes.
    half = CLOSEUP * (east - west), 0.58 * CLOSEUP * (east - west)
    x = float(min(max(x, west + half[0]), east - half[0]))
    y = float(min(max(y, south + half[1]), max(south + half[1], north - half[1])))
    return x - half[0], y - half[1], x + half[0], y + half[1]
