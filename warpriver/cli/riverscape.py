"""``warpriver riverscape``: the types of rivers, their beds, and their moving water."""

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
from warpriver.cli.words import naming
from warpriver.errors import InputError

if TYPE_CHECKING:
    from warpriver.network import RiverNetwork
    from warpriver.riverscape import Riverscape, RiverTypes
    from warpriver.terrain import Terrain

__all__ = ["add"]


# What can be written, and the files that tell that a folder has it already.
FILES = {
    "types": ("types.csv",),
    "bed": ("bed.tif", "bed.npz"),
    "movie": ("movie.mp4", "movie.gif"),
    "flowmap": ("flow.png",),
    "mesh": ("riverscape.glb",),
    "frames": ("frames",),
    "scene": ("scene.json",),
}
MOVIE_SIZE = (640, 360)


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "riverscape",
        _riverscape,
        help="give rivers their Rosgen types, and the beds and moving water that a terrain is too coarse to show",
        description="Find the rivers of a terrain, or read them, give each its Rosgen type, and say why\n"
        "(Peytavie et al. 2019). With --window also lay courses and beds there: steps and pools, meanders, braids;\n"
        "and write what --movie, --flowmap, --mesh, --frames and --scene ask for.",
        epilog="examples:\n"
        "  warpriver riverscape dem.tif --to-crs utm --min-area 1 -o out/types\n"
        "  warpriver riverscape dem.tif --window 391000,3794000,391400,3794300 --detail 0.25 -o out/bed\n"
        "  warpriver riverscape dem.tif --rivers mine.gpkg --type C --flow 4 -o out/mine\n"
        "  warpriver riverscape dem.tif --window W,S,E,N --types --movie --flowmap unreal --mesh -o out/water",
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
    bed.add_argument(
        "--edits", metavar="FILE", help="session of edits to do again, as warpriver.edits.write_edits wrote it"
    )
    wanted = parser.add_argument_group("files (default: types, and with --window the bed)")
    wanted.add_argument("--types", action="store_true", help="types.csv and types.png")
    wanted.add_argument("--bed", action="store_true", help="bed.tif and bed.png")
    wanted.add_argument("--movie", action="store_true", help="the water as movie.mp4, or .gif without imageio-ffmpeg")
    wanted.add_argument("--flowmap", choices=("unreal", "unity"), help="flow map for a game engine: flow.png and .json")
    wanted.add_argument("--mesh", action="store_true", help="ground, water and falls as riverscape.glb")
    wanted.add_argument("--frames", metavar="SUFFIX", help="the water frame by frame: .tif .png .r16 .exr .zarr ...")
    wanted.add_argument("--scene", action="store_true", help="the scene as scene.json and .npz, to go on with")
    wanted.add_argument(
        "--seconds",
        type=number(above=0.0, unit="s"),
        default=4.0,
        metavar="S",
        help="length of the movie and the frames, s (default 4)",
    )
    wanted.add_argument(
        "--loop",
        type=number(above=0.0, unit="s"),
        metavar="S",
        help="period after which the water repeats itself without a seam, s (default: never)",
    )
    wanted.add_argument(
        "--fps", type=number(above=0.0, unit="1/s"), default=12.0, metavar="N", help="frames a second (default 12)"
    )
    ground = parser.add_argument_group("terrain")
    add_systems(ground, "a file")
    add_heights(ground)


def _riverscape(options: argparse.Namespace) -> int:
    from warpriver import hydrology
    from warpriver.io.vector.networks import read_network
    from warpriver.riverscape import Riverscape, classify_rivers

    wanted = _wanted(options)
    out = fresh_folder(options.out, *(file for name in wanted for file in FILES[name]), make=False)
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
        if options.edits is not None:
            # They may lie anywhere.
            scene = scene.replay(options.edits)
        with naming(bounds="--window"):
            carved = scene.carved(options.detail, window)
        if options.edits is None:
            # The water of a whole network would take minutes.
            scene = scene.within(_seen(window) if "movie" in wanted else window)
    told = [repr(network)]
    told += [f"type {name}: {km:.4g} km" for name, km in types.lengths(network).items()]
    try:
        with results_in(out) as folder:
            if "types" in wanted:
                told += _write_types(types, network, terrain, folder)
            if scene is not None and carved is not None and window is not None:
                told.append(repr(scene))
                if "bed" in wanted:
                    told += _write_bed(scene, carved, folder)
                told += _write_water(scene, wanted, window, options, folder)
    finally:
        for line in told:
            say(line)
    return OK


def _wanted(options: argparse.Namespace) -> tuple[str, ...]:
    """Names of what is to be written."""
    found = tuple(name for name in FILES if getattr(options, name))
    rest = [name for name in found if name != "types"]
    if options.window is None and (rest or options.edits is not None):
        raise InputError(f"--{rest[0] if rest else 'edits'} needs --window: say where courses and beds are laid")
    return found or (("types",) if options.window is None else ("types", "bed"))


def _write_water(
    scene: Riverscape,
    wanted: tuple[str, ...],
    window: tuple[float, float, float, float],
    options: argparse.Namespace,
    folder: Path,
) -> list[str]:
    """Write what is asked for of the water in a window."""
    from warpriver.riverscape import FlowMap, write_frames

    told = []
    if "flowmap" in wanted:
        made = FlowMap.of(scene, window, options.detail, preset=options.flowmap)
        made.save(folder / "flow.png")
        told.append(f"{folder / 'flow.png'}: {made!r}")
    if "mesh" in wanted:
        scene.to_glb(folder / "riverscape.glb", bounds=window, cell_size=options.detail)
        told.append(f"{folder / 'riverscape.glb'}")
    count = max(1, round(options.seconds * options.fps))
    if "frames" in wanted:
        times = [k / options.fps for k in range(count)]
        files = write_frames(
            scene, folder / "frames", times=times, cell_size=options.detail, bounds=window, loop=options.loop,
            suffix=options.frames,
        )  # fmt: skip
        told.append(f"{folder / 'frames'}: {count} frames in {len(files)} files")
    if "movie" in wanted:
        from warpriver import viz

        west, south, east, north = window
        across = max(east - west, 1.8 * (north - south))
        camera = viz.Camera((0.5 * (west + east), 0.5 * (south + north)), 70.0, 42.0, 1.05 * across, 50.0)
        name = "movie.mp4" if importlib.util.find_spec("imageio_ffmpeg") is not None else "movie.gif"
        viz.riverscape_movie(
            scene, folder / name, seconds=options.seconds, fps=options.fps, loop=options.loop, camera=camera,
            size=MOVIE_SIZE,
        )  # fmt: skip
        told.append(f"{folder / name}: {count} frames")
    if "scene" in wanted:
        scene.save(folder / "scene.json")
        told.append(f"{folder / 'scene.json'}")
    return told


def _window(text: str) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--window {text}: give west,south,east,north in m") from None
    if not (west < east and south < north):
        raise InputError(f"--window {text}: west must be below east, and south below north")
    return west, south, east, north


def _seen(window: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """What the camera of a movie sees: beyond the window what lies behind it."""
    west, south, east, north = window
    far = 2.5 * max(east - west, 1.8 * (north - south))
    return west - far, south - far, east + far, north + far


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
    told = [f"{folder / name}: {carved.shape[0]} x {carved.shape[1]} cells"]
    if can_draw():
        from warpriver import viz

        viz.draw_bed(scene, folder / "bed.png", bounds=carved.bounds)
        told.append(f"{folder / 'bed.png'}")
    return told
