"""``warpriver erode``: rain that carves a network."""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.output import say
from warpriver.cli.parser import area, number, whole_number
from warpriver.cli.results import write_ground, write_lines
from warpriver.cli.shared import (
    MOVIES,
    OK,
    add_heights,
    add_systems,
    can_draw,
    check_picture,
    command,
    fresh_folder,
    given_flags,
    quiet_warp,
    read_ground,
    results_in,
)
from warpriver.errors import InputError
from warpriver.params import LehenyParams

if TYPE_CHECKING:
    from warpriver.erosion.eroded import ErodedTerrain
    from warpriver.hydrology.routing import Flow
    from warpriver.network import RiverNetwork
    from warpriver.terrain import Terrain

__all__ = ["add"]

RESULTS = ("terrain.npz", "rivers.csv", "rivers.gpkg", "elevation.png", "drainage.png", "network.png")
# The model's depth D, which is no depth of a channel.
FLAGS = {"depth": "--cut-depth"}
# Flags for what is read from a file, and for what is made.
FILE_FLAGS = ("crs", "to_crs", "z_factor", "nodata", "band", "range", "shape", "origin")
MADE_FLAGS = ("size", "slope")
# Starts that are made.
MADE = ("plane", "peak")


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "erode",
        _erode,
        help="let rain carve a river network into a plane, a peak or a terrain",
        description="Leheny's erosion: units of rain fall on random cells, walk downhill by chance, take a constant\n"
        "depth off every cell of their way, and what gets too steep slides. Writes the terrain (.npz, and\n"
        ".tif or the format of its start), its rivers (.csv and .gpkg), and pictures: the terrain by elevation, the\n"
        "drainage, the ordered network. The model has no metres of its own: depth, threshold and bias count in one\n"
        "unit of height. Without a base level outlets sink like all cells, without limit: canyons are then deeper\n"
        "than the map is wide.",
        epilog="examples:\n"
        "  warpriver erode --size 300x200 --events 10000 --start plane -o out/erode\n"
        "  warpriver erode --size 401x401 --start peak --events 40000 --movie growth.gif\n"
        "  warpriver erode --start dem.tif --fill --cut-depth 0.5 --slide-threshold 40 --flow-bias 1 --base-level 0",
    )
    start = parser.add_argument_group("start")
    start.add_argument(
        "--start",
        default="plane",
        metavar="plane|peak|FILE",
        help="plane: falls south, its east and west sides are joined; peak: falls to all sides; or heights from a "
        "file: GeoTIFF, ESRI ASCII, npz ... (default plane)",
    )
    start.add_argument("--size", metavar="COLUMNSxROWS", help="cells of a plane or peak (default 300x200)")
    start.add_argument(
        "--cell-size",
        type=number(above=0.0, unit="m"),
        metavar="M",
        help="size of a cell in m: of a plane or peak (default 1), of a file that does not state it; else the heights "
        "of a file are resampled to it",
    )
    start.add_argument("--slope", type=float, metavar="S", help="slope of a plane or peak in m/m (default 1)")
    start.add_argument(
        "--edges",
        metavar="RULES",
        help="open, closed or periodic for all sides, or four in the order north,south,east,west (default: the "
        "start's; of a file, open)",
    )
    start.add_argument("--fill", action="store_true", help="raise ground that water cannot leave until it can")
    add_systems(start, "a file")
    add_heights(start, cell_size=False)
    model = parser.add_argument_group("model (Leheny 1995)")
    model.add_argument(
        "--events", type=whole_number(), default=10_000, metavar="N", help="units of rain (default 10000)"
    )
    model.add_argument(
        "--base-level",
        type=_level,
        metavar="H|none",
        help="height in m that no cell sinks below, such as that of the sea; rivers are graded to it (default: the "
        "foot of a plane or peak; of a file, none)",
    )
    for field in dataclasses.fields(LehenyParams):
        meta = field.metadata
        unit = "" if meta["unit"] == "-" else f"{meta['unit']}; "
        model.add_argument(
            FLAGS.get(field.name, "--" + field.name.replace("_", "-")),
            dest=field.name,
            type=int if meta["choices"] else float,
            choices=meta["choices"] or None,
            default=field.default,
            metavar=None if meta["choices"] else "X",
            help=f"{meta['doc']} ({unit}default {field.default:g})",
        )
    model.add_argument("--seed", type=whole_number(), default=0, help="seed of what is random (default 0)")
    model.add_argument(
        "--batch",
        type=whole_number(1),
        default=1,
        metavar="B",
        help="units of rain that walk at a time (default 1, one by one)",
    )
    model.add_argument("--dtype", default="float64", choices=("float64", "float32"), help="precision (default float64)")
    model.add_argument(
        "--device",
        default="cpu",
        help='of batches: "cpu", "cuda", "cuda:1" ...; one by one it is the CPU (default cpu)',
    )
    out = parser.add_argument_group("output")
    out.add_argument(
        "-o", "--out", default="out/erode", metavar="FOLDER", help="folder for the results (default out/erode)"
    )
    out.add_argument(
        "--min-area",
        type=area,
        default=area("50cells"),
        metavar="AREA",
        help="minimum drainage area of a river: 2 or 2km2, 5e5m2, 50cells (default 50cells)",
    )
    out.add_argument("--movie", metavar="NAME", help="also a movie of the network growing, .gif or .mp4, in FOLDER")
    out.add_argument(
        "--frames", type=whole_number(2), default=50, metavar="N", help="frames of the movie, about (default 50)"
    )
    out.add_argument("--no-progress", action="store_true", help="no progress bar")


def _erode(options: argparse.Namespace) -> int:
    from warpriver import hydrology
    from warpriver.erosion import erode
    from warpriver.io.raster.terrains import write_terrain
    from warpriver.io.vector.networks import write_network

    params = LehenyParams(**{f.name: getattr(options, f.name) for f in dataclasses.fields(LehenyParams)})
    if options.movie is not None:
        check_picture(Path(options.movie).name, "--movie", MOVIES)
    folder = fresh_folder(options.out, *RESULTS, *([options.movie] if options.movie else []), make=False)
    quiet_warp()
    start = _erosion_start(options)
    edges = options.edges.split(",") if options.edges and "," in options.edges else options.edges
    begin = time.perf_counter()
    eroded = erode(
        start,
        params,
        events=options.events,
        seed=options.seed,
        edges=edges,
        batch=options.batch,
        fill=options.fill,
        base_level=_base_level(start, options),
        record_every=max(1, options.events // (options.frames - 1)) if options.movie else None,
        dtype=options.dtype,
        progress=not options.no_progress,
    )
    told = [f"{eroded!r}\n  {time.perf_counter() - begin:.2f} s"]
    flow, threshold = eroded.flow(), options.min_area.square_meters(eroded.cell_size)
    network = hydrology.extract_network(eroded, flow=flow, min_drainage_area=threshold)
    laws = hydrology.network_laws(flow, threshold)
    told.append(repr(network))
    told.append(
        f"  {len(laws.streams)} orders, {', '.join(map(str, laws.streams))} streams; bifurcation ratio "
        f"{laws.bifurcation_ratio:.3g}, area {laws.area_ratio:.3g}, length {laws.length_ratio:.3g}; Hack's exponent "
        f"{laws.hack_exponent:.3g}; P(A > a) ~ a^-{laws.area_exponent:.3g}"
    )
    try:
        with results_in(folder):
            write_terrain(eroded, folder / "terrain.npz")
            write_network(network, folder / "rivers.csv")
            told.append(f"  terrain  {folder / 'terrain.npz'}\n  lines    {folder / 'rivers.csv'}")
            told += write_ground(eroded, folder, None if options.start in MADE else options.start)
            told += write_lines(network, folder)
            told += _draw_erosion(eroded, flow, network, threshold, folder, options.movie)
    finally:
        for line in told:
            say(line)
    return OK


def _level(text: str) -> float:
    """Parse a height, or "none", which is minus infinity."""
    return -math.inf if text == "none" else number(unit="m")(text)


def _base_level(start: Terrain, options: argparse.Namespace) -> float | None:
    """Return the base level that was typed, or that of the start."""
    level = options.base_level
    if level is None and options.start in MADE:
        level = float(start.to_numpy().min())
    return level if level is not None and math.isfinite(level) else None


def _erosion_start(options: argparse.Namespace) -> Terrain:
    """Make or read the terrain that rain is to fall on."""
    from warpriver import generate

    if options.start not in MADE:
        if useless := given_flags(options, MADE_FLAGS):
            raise InputError(f"{useless[0]} is for a plane or peak, and {options.start} has its own; leave it out")
        return read_ground(options.start, options, device=options.device)
    if useless := given_flags(options, FILE_FLAGS):
        raise InputError(f"{useless[0]} says how a file is read, and --start {options.start} is none; leave it out")
    try:
        columns, rows = (int(n) for n in (options.size or "300x200").lower().split("x"))
    except ValueError:
        raise InputError(f"--size {options.size}: give columns and rows, such as 300x200") from None
    size = 1.0 if options.cell_size is None else options.cell_size
    slope = 1.0 if options.slope is None else options.slope
    make = generate.erosion_plane if options.start == "plane" else generate.erosion_peak
    return make((rows, columns), size, slope, device=options.device)


def _draw_erosion(
    eroded: ErodedTerrain, flow: Flow, network: RiverNetwork, threshold: float, folder: Path, movie: str | None
) -> list[str]:
    """Draw the terrain, its drainage and its rivers, and the movie if there is to be one; return what to say."""
    if not can_draw():
        return []
    from warpriver import viz

    viz.draw_elevation(eroded, folder / "elevation.png", title=f"{eroded.events:,} events")
    viz.draw_drainage(flow, folder / "drainage.png", min_drainage_area=threshold)
    viz.draw_ordered_network(eroded, network, folder / "network.png")
    told = [f"  pictures {folder / 'elevation.png'}, drainage.png, network.png"]
    if movie is not None:
        viz.erosion_movie(eroded, folder / movie, min_drainage_area=threshold)
        told.append(f"  movie    {folder / movie}")
    return told
