"""``warpriver landscape``: beds carved into a terrain, and files of it for engines, artists and GIS."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpriver.cli.output import say
from warpriver.cli.parser import area, number, whole_number
from warpriver.cli.shared import (
    HEIGHT_FLAGS,
    LINE_FLAGS,
    OK,
    add_lines,
    add_terrain,
    can_draw,
    command,
    ending_of,
    fresh_folder,
    given_flags,
    ground_under,
    quiet_warp,
    read_ground,
    read_lines,
    read_run,
    results_in,
    stored_run,
)
from warpriver.errors import InputError
from warpriver.landscape.constants import CarveParams

if TYPE_CHECKING:
    from warpriver.history import History
    from warpriver.landscape import CarveReport
    from warpriver.network import RiverNetwork
    from warpriver.raster import Raster
    from warpriver.terrain import Terrain

__all__ = ["add"]

TARGETS = ("gis", "mesh", "paraview", "unreal", "unity", "godot", "blender", "houdini")
PICTURE = "landscape.png"
# Drainage area from which cells of a terrain are rivers, where there is no file of them.
MIN_AREA = "500cells"


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "landscape",
        _landscape,
        help="carve rivers into a terrain, and write it for engines, artists and GIS",
        description="Inscribe the beds, banks, water and oxbow lakes of a run, or of river lines, in the ground, and\n"
        "write what other programs open. The water never rises downstream. Each --export has a folder of its own in\n"
        "DIR: gis (GeoTIFF, GeoPackage, CSV), mesh (glTF, OBJ, USD), paraview, and height maps with masks, splines\n"
        "and meshes for unreal, unity, godot, blender and houdini.",
        epilog="examples:\n"
        "  warpriver landscape out/river/run -o out/land\n"
        "  warpriver landscape out/river/run -o out/land --export gis unreal --size 2017 --resolution 8\n"
        "  warpriver landscape dem.tif --min-area 2km2 -o out/land --export blender\n"
        "  warpriver landscape rivers.gpkg --terrain dem.tif -o out/land --section trapezoid",
    )
    parser.add_argument("input", metavar="INPUT", help="run folder or .npz, river lines, or a terrain")
    out = parser.add_argument_group("output")
    out.add_argument(
        "-o", "--out", default="out/landscape", metavar="DIR", help="folder for the results (default out/landscape)"
    )
    out.add_argument(
        "--export", nargs="+", choices=TARGETS, default=["gis"], metavar="TARGET",
        help=f"what to write for: {', '.join(TARGETS)} (default gis)",
    )  # fmt: skip
    out.add_argument(
        "--size",
        type=whole_number(2),
        metavar="N",
        help="vertices along the longer side of height maps: of Unreal Engine 505, 1009, 2017, 4033 or 8129, of Unity "
        "and Godot 33 to 4097 (default: the next number above that of the cells)",
    )
    out.add_argument(
        "--maps",
        action="store_true",
        help="of a run: also maps of moisture, deposits, vegetation, old courses and their age; deposits, bars and "
        "lobes are laid on the ground before it is carved",
    )
    out.add_argument(
        "--every", type=whole_number(1), metavar="N", help="for ParaView: records from frame to frame (default 1)"
    )
    ground = add_terrain(
        parser, "heights under the rivers (default: those of the run, or a plain that falls along the rivers)"
    )
    ground.add_argument(
        "--resolution",
        type=number(above=0.0, unit="m"),
        metavar="M",
        help="cell size of the landscape in m, to which the ground is resampled (default: its own; of a plain a sixth "
        "of the narrowest channel)",
    )
    ground.add_argument(
        "--min-area",
        type=area,
        metavar="AREA",
        help=f"of a terrain: drainage area where rivers begin: 2 or 2km2, 5e5m2, 50cells (default {MIN_AREA})",
    )
    carving = parser.add_argument_group("carving")
    for field in dataclasses.fields(CarveParams):
        meta = field.metadata
        if not meta:
            continue
        unit = "" if meta["unit"] == "-" else f"{meta['unit']}; "
        carving.add_argument(
            "--" + field.name.replace("_", "-"),
            type=str if meta["choices"] else float,
            choices=meta["choices"] or None,
            default=field.default,
            metavar=None if meta["choices"] else "X",
            help=f"{meta['doc']} ({unit}default {field.default})",
        )
    carving.add_argument(
        "--keep-junctions",
        action="store_true",
        help="leave tributaries as they meet (default: they arrive at the angles that their flows suggest)",
    )
    add_lines(parser)


def _landscape(options: argparse.Namespace) -> int:
    source = Path(options.input)
    values = {f.name: getattr(options, f.name) for f in dataclasses.fields(CarveParams) if f.metadata}
    params = CarveParams(**values, junctions=not options.keep_junctions)
    folder = fresh_folder(options.out, *options.export, PICTURE, make=False)
    quiet_warp()
    from warpriver.landscape import carve, export_landscape

    history, network, ground = _given(source, options)
    if options.resolution is not None and options.resolution != ground.cell_size:
        ground = ground.resampled(options.resolution)
    maps, deposits = _maps(history, ground) if options.maps and history is not None else ({}, None)
    carved = carve(ground, network, params, deposits=deposits, history=history)
    told = _report(carved.report)
    with results_in(folder):
        files = export_landscape(
            carved, folder, targets=options.export, history=history, maps=maps, size=options.size, every=options.every
        )
        for target in dict.fromkeys(options.export):
            count = sum(file.is_relative_to(folder / target) for file in files)
            told.append(f"  {target:<8} {folder / target}, {count} files")
        if can_draw():
            from warpriver import viz

            if maps and history is not None:
                # A plain that was made has no relief, and its water no valleys.
                made = history.last_ground is None and options.terrain is None
                viz.draw_landscape(history, folder / PICTURE, terrain=None if made else ground)
            else:
                viz.draw_network(carved.network, folder / PICTURE, terrain=carved.terrain)
            told.append(f"  map      {folder / PICTURE}")
    for line in told:
        say(line)
    return OK


def _given(source: Path, options: argparse.Namespace) -> tuple[History | None, RiverNetwork, Terrain]:
    """Read the run, the rivers and the ground that were named."""
    from warpriver.io.raster.terrains import SUFFIXES
    from warpriver.io.vector.networks import line_formats
    from warpriver.landscape import ground_of_run, plain_under

    run = stored_run(source)
    if options.maps and run is None:
        raise InputError(f"--maps are made from a run, and {source} is none; leave it out")
    is_ground = run is None and ending_of(source, SUFFIXES) in SUFFIXES and source.suffix.lower() not in line_formats()
    if options.min_area is not None and not is_ground:
        raise InputError(f"--min-area is for rivers that are found on a terrain, and {source} is none; leave it out")
    if is_ground:
        return None, *_found(source, options)
    history = None
    if run is not None:
        if useless := given_flags(options, LINE_FLAGS):
            raise InputError(f"{useless[0]} says how river lines are read, and {run} is a run; leave it out")
        history = read_run(run)
        network = history.networks[-1]
    else:
        network = read_lines(source, options)
    ground = ground_under(options, network.crs)
    if history is not None:
        ground = ground_of_run(history, ground)
    if ground is None:
        ground = plain_under(network, options.resolution, history=history)
    return history, network, ground


def _maps(history: History, ground: Terrain) -> tuple[dict[str, Raster], Raster]:
    """Return maps of a run, and what it has laid on the ground; hollows of old courses are lakes, which are carved."""
    from warpriver.landscape import landscape_maps

    maps = landscape_maps(history, ground, ground.cell_size).rasters
    change = maps["elevation_change"]
    return maps, change.like(np.maximum(change.numpy(), 0.0), unit="m", name="deposits")


def _found(source: Path, options: argparse.Namespace) -> tuple[RiverNetwork, Terrain]:
    """Read a terrain, and find its rivers."""
    from warpriver.hydrology import extract_network

    if options.terrain is not None:
        raise InputError(f"--terrain goes with rivers, and {source} is a terrain itself; leave it out")
    lines = [name for name in LINE_FLAGS if name not in (*HEIGHT_FLAGS, "crs")]
    if useless := given_flags(options, lines):
        raise InputError(f"{useless[0]} says how river lines are read, and {source} is a terrain; leave it out")
    if options.crs is not None and options.terrain_crs is None:
        options.terrain_crs = options.crs
    ground = read_ground(source, options, to_crs=options.to_crs)
    least = options.min_area or area(MIN_AREA)
    return extract_network(ground, min_drainage_area=least.square_meters(ground.cell_size)), ground


def _report(report: CarveReport) -> list[str]:
    """Return what carving did."""
    told = [
        f"carved {report.cells:,} cells: {report.cut_volume:.4g} m3 cut, {report.deepest_cut:.3g} m at most; "
        f"{report.fill_volume:.4g} m3 filled, {report.highest_fill:.3g} m at most; {report.lakes} lakes"
    ]
    if report.held_points:
        told.append(
            f"  --max-cut held the water up at {report.held_points} points; a cut would have gone {report.excess:.3g} "
            "m deeper"
        )
    return told
