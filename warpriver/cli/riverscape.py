"""``warpriver riverscape``: the types of rivers, and the beds that they have."""

from __future__ import annotations

import argparse
import csv
import importlib.util
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.output import say
from warpriver.cli.parser import area, number, whole_number
from warpriver.cli.shared import (
    OK,
    add_heights,
    add_systems,
    can_draw,
    command,
    fresh_folder,
    quiet_warp,
    read_ground,
    results_in,
)
from warpriver.errors import InputError

if TYPE_CHECKING:
    from warpriver.network import RiverNetwork
    from warpriver.riverscape import Riverscape, RiverTypes
    from warpriver.terrain import Terrain

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "riverscape",
        _riverscape,
        help="give rivers their Rosgen types, and carve beds that a terrain is too coarse to show",
        description="Find the rivers of a terrain, or read them, give each its Rosgen type, and say why\n"
        "(Peytavie et al. 2019). With --window also lay courses and beds there: steps and pools, meanders, braids.",
        epilog="examples:\n"
        "  warpriver riverscape dem.tif --to-crs utm --min-area 1 -o out/types\n"
        "  warpriver riverscape dem.tif --window 391000,3794000,391400,3794300 --detail 0.25 -o out/bed\n"
        "  warpriver riverscape dem.tif --rivers mine.gpkg --type C --flow 4 -o out/mine",
    )
    parser.add_argument("terrain", metavar="TERRAIN", help="heights: GeoTIFF, ESRI ASCII, npz ...")
    parser.add_argument("-o", "--out", required=True, metavar="FOLDER", help="folder to write")
    rivers = parser.add_argument_group("rivers")
    rivers.add_argument("--rivers", metavar="FILE", help="lines of the rivers (default: found on the terrain)")
    rivers.add_argument(
        "--min-area",
        type=area,
        default=area("1"),
        metavar="AREA",
        help="minimum drainage area of a channel: 1 or 1km2, 5e5m2, 50cells (default 1km2)",
    )
    rivers.add_argument(
        "--type", metavar="TYPE", help="type of all rivers, A+ A B C D DA E F or G (default: by the terrain)"
    )
    rivers.add_argument(
        "--flow", type=number(above=0.0, unit="m3/s"), metavar="M3/S", help="discharge of all rivers (default: by area)"
    )
    rivers.add_argument(
        "--grain-size",
        type=number(above=0.0, unit="mm"),
        metavar="MM",
        help="median grain of the beds in mm, which adds a digit to the types (default: not known)",
    )
    bed = parser.add_argument_group("beds")
    bed.add_argument("--window", metavar="W,S,E,N", help="where beds are carved, m")
    bed.add_argument(
        "--detail",
        type=number(above=0.0, unit="m"),
        default=0.5,
        metavar="M",
        help="size of the carved terrain's cells, and least distance between stations of courses, in m (default 0.5)",
    )
    bed.add_argument(
        "--seed", type=whole_number(), default=0, metavar="N", help="seed of what is drawn at random (default 0)"
    )
    bed.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')
    ground = parser.add_argument_group("terrain")
    add_systems(ground, "a file")
    add_heights(ground)


def _riverscape(options: argparse.Namespace) -> int:
    from warpriver import hydrology
    from warpriver.io.vector.networks import read_network
    from warpriver.riverscape import Riverscape, classify_rivers

    out = fresh_folder(options.out, "types.csv", "bed.tif", "bed.npz", make=False)
    window = None if options.window is None else _window(options.window)
    quiet_warp()
    terrain = read_ground(options.terrain, options, device=options.device)
    if options.rivers is None:
        least = options.min_area.square_meters(terrain.cell_size)
        network = hydrology.extract_network(terrain, min_drainage_area=least)
    else:
        network = read_network(Path(options.rivers), crs=options.crs, to_crs=options.to_crs)
    types = classify_rivers(network, terrain, flow=options.flow, grain_size=options.grain_size)
    if options.type is not None:
        for channel in range(len(types)):
            types = types.retyped(channel, options.type)
    scene, carved = None, None
    if window is not None:
        scene = Riverscape(terrain, network, types, detail=options.detail, seed=options.seed, flow=options.flow)
        carved = scene.carved(options.detail, window)
    told = [repr(network)]
    told += [f"type {name}: {km:.4g} km" for name, km in types.lengths(network).items()]
    try:
        with results_in(out) as folder:
            told += _write_types(types, network, terrain, folder)
            if scene is not None and carved is not None:
                told += _write_bed(scene, carved, folder)
    finally:
        for line in told:
            say(line)
    return OK


def _window(text: str) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--window {text}: give west,south,east,north in m") from None
    if not (west < east and south < north):
        raise InputError(f"--window {text}: west must be below east, and south below north")
    return west, south, east, north


def _write_types(types: RiverTypes, network: RiverNetwork, terrain: Terrain, folder: Path) -> list[str]:
    """Write the types with their reasons as a table, and draw them."""
    from warpriver.files import beside
    from warpriver.riverscape import CRITERIA

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["channel", "type", *(f"{n}{s}" for n in CRITERIA for s in ("", "_source", "_status")), "reason"])
    for k, channel in enumerate(network.channel_id):
        cells = [v for row in types.table(k) for v in (row["value"], row["source"], row["status"])]
        writer.writerow([int(channel), types.channel_type[k], *cells, types.note[k]])
    with beside(folder / "types.csv") as path:
        path.write_text(text.getvalue())
    told = [f"{folder / 'types.csv'}"]
    if can_draw():
        from warpriver import viz

        viz.draw_river_types(types, network, folder / "types.png", terrain=terrain)
        told.append(f"{folder / 'types.png'}")
    return told


def _write_bed(scene: Riverscape, carved: Terrain, folder: Path) -> list[str]:
    """Write the carved terrain of a window, and draw it."""
    from warpriver.io.raster.terrains import write_terrain

    name = "bed.tif" if importlib.util.find_spec("rasterio") is not None else "bed.npz"
    write_terrain(carved, folder / name)
    told = [repr(scene), f"{folder / name}: {carved.shape[0]} x {carved.shape[1]} cells"]
    if can_draw():
        from warpriver import viz

        viz.draw_bed(scene, folder / "bed.png", bounds=carved.bounds)
        told.append(f"{folder / 'bed.png'}")
    return told
