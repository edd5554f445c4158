"""``warpriver erode``: rain that carves a network."""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.results import write_ground, write_lines
from warpriver.cli.shared import OK, add_heights, can_draw, command, quiet_warp, read_ground
from warpriver.errors import InputError
from warpriver.params import LehenyParams

if TYPE_CHECKING:
    from warpriver.erosion.eroded import ErodedTerrain
    from warpriver.hydrology.routing import Flow
    from warpriver.network import RiverNetwork
    from warpriver.terrain import Terrain

__all__ = ["add"]

STARTS = ("plane", "peak")


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
        "drainage, the ordered network.",
        epilog="examples:\n"
        "  warpriver erode --size 300x200 --events 10000 --start plane -o out/erode\n"
        "  warpriver erode --size 401x401 --start peak --events 40000 --movie growth.gif\n"
        "  warpriver erode --start dem.tif --fill --depth 0.5 --slide-threshold 40 --flow-bias 1 --rivers 500",
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
        type=float,
        metavar="M",
        help="cell of a plane or peak in m (default 1); of a file, what to resample it to",
    )
    start.add_argument("--slope", type=float, metavar="S", help="slope of a plane or peak in m/m (default 1)")
    start.add_argument(
        "--edges",
        metavar="RULES",
        help="open, closed or periodic for all sides, or four in the order north,south,east,west (default: the "
        "start's; of a file, open)",
    )
    start.add_argument("--fill", action="store_true", help="raise ground that water cannot leave until it can")
    start.add_argument("--crs", help="coordinate reference system of a file that does not say")
    start.add_argument("--to-crs", help='reproject a file, e.g. EPSG:32619, or "utm" for the zone of the data')
    add_heights(start, cell_size=False)
    model = parser.add_argument_group("model (Leheny 1995)")
    model.add_argument("--events", type=int, default=10_000, metavar="N", help="units of rain (default 10000)")
    for field in dataclasses.fields(LehenyParams):
        meta = field.metadata
        unit = "" if meta["unit"] == "-" else f"{meta['unit']}, "
        model.add_argument(
            "--" + field.name.replace("_", "-"),
            type=int if meta["choices"] else float,
            choices=meta["choices"] or None,
            default=field.default,
            metavar=None if meta["choices"] else "X",
            help=f"{meta['doc']} ({unit}default {field.default:g})",
        )
    model.add_argument("--seed", type=int, default=0, help="seed of what is random (default 0)")
    model.add_argument(
        "--batch", type=int, default=1, metavar="B", help="units of rain that walk at a time (default 1, one by one)"
    )
    model.add_argument("--dtype", default="float64", choices=("float64", "float32"), help="precision (default float64)")
    model.add_argument(
        "--device",
        default="cpu",
        help='of batches: "cpu", "cuda", "cuda:1" ...; one by one it is the CPU (default cpu)',
    )
    out = parser.add_argument_group("output")
    out.add_argument("-o", "--out", default="out/erode", metavar="FOLDER", help="where results go (default out/erode)")
    out.add_argument(
        "--rivers", type=float, default=50.0, metavar="R", help="least cells that a river drains (default 50)"
    )
    out.add_argument("--movie", metavar="FILE", help="also a movie of the network growing, .gif or .mp4, in FOLDER")
    out.add_argument("--frames", type=int, default=50, help="frames of the movie, about (default 50)")
    out.add_argument("--no-progress", action="store_true", help="no progress bar")


def _erode(options: argparse.Namespace) -> int:
    from warpriver import hydrology
    from warpriver.erosion import erode
    from warpriver.io.raster.terrains import write_terrain
    from warpriver.io.vector.networks import write_network

    quiet_warp()
    if options.movie is not None and Path(options.movie).suffix.lower() not in (".gif", ".mp4"):
        raise InputError(f"--movie {options.movie}: the ending says the format; use .gif or .mp4")
    if options.frames < 2:
        raise InputError(f"--frames {options.frames}: give 2 or more")
    start = _erosion_start(options)
    edges = options.edges.split(",") if options.edges and "," in options.edges else options.edges
    begin = time.perf_counter()
    eroded = erode(
        start,
        LehenyParams(**{f.name: getattr(options, f.name) for f in dataclasses.fields(LehenyParams)}),
        events=options.events,
        seed=options.seed,
        edges=edges,
        batch=options.batch,
        fill=options.fill,
        record_every=max(1, options.events // (options.frames - 1)) if options.movie else None,
        dtype=options.dtype,
        progress=not options.no_progress,
    )
    print(f"{eroded!r}\n  {time.perf_counter() - begin:.2f} s")
    flow, threshold = eroded.flow(), options.rivers * eroded.cell_size**2
    network = hydrology.extract_network(eroded, flow=flow, min_drainage_area=threshold)
    laws = hydrology.network_laws(flow, threshold)
    print(network)
    print(
        f"  {len(laws.streams)} orders, {', '.join(map(str, laws.streams))} streams; bifurcation ratio "
        f"{laws.bifurcation_ratio:.3g}, area {laws.area_ratio:.3g}, length {laws.length_ratio:.3g}; Hack's exponent "
        f"{laws.hack_exponent:.3g}; P(A > a) ~ a^-{laws.area_exponent:.3g}"
    )
    folder = Path(options.out)
    folder.mkdir(parents=True, exist_ok=True)
    write_terrain(eroded, folder / "terrain.npz")
    write_network(network, folder / "rivers.csv")
    print(f"  terrain  {folder / 'terrain.npz'}\n  lines    {folder / 'rivers.csv'}")
    write_ground(eroded, folder, None if options.start in STARTS else options.start)
    write_lines(network, folder)
    _draw_erosion(eroded, flow, network, threshold, folder, options.movie)
    return OK


def _erosion_start(options: argparse.Namespace) -> Terrain:
    """Make or read the terrain that rain is to fall on."""
    from warpriver import generate

    made = dict(zip(STARTS, (generate.erosion_plane, generate.erosion_peak), strict=True))
    if options.start not in made:
        for flag in ("size", "slope"):
            if getattr(options, flag) is not None:
                raise InputError(f"--{flag} is for a plane or peak; {options.start} has its own")
        return read_ground(options.start, options, device=options.device)
    try:
        columns, rows = (int(n) for n in (options.size or "300x200").lower().split("x"))
    except ValueError:
        raise InputError(f"--size {options.size}: give columns and rows, such as 300x200") from None
    size = 1.0 if options.cell_size is None else options.cell_size
    slope = 1.0 if options.slope is None else options.slope
    return made[options.start]((rows, columns), size, slope, device=options.device)


def _draw_erosion(
    eroded: ErodedTerrain, flow: Flow, network: RiverNetwork, threshold: float, folder: Path, movie: str | None
) -> None:
    """Draw the terrain, its drainage and its rivers, and the movie if there is to be one."""
    if not can_draw():
        return
    from warpriver import viz

    viz.draw_elevation(eroded, folder / "elevation.png", title=f"{eroded.events:,} events")
    viz.draw_drainage(flow, folder / "drainage.png", min_drainage_area=threshold)
    viz.draw_ordered_network(eroded, network, folder / "network.png")
    print(f"  pictures {folder / 'elevation.png'}, drainage.png, network.png")
    if movie is not None:
        viz.erosion_movie(eroded, folder / movie, min_drainage_area=threshold)
        print(f"  movie    {folder / movie}")
