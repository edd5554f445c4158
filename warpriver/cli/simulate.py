"""``warpriver simulate``: rivers that migrate, and runs that go on."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from warpriver.cli.results import write_run
from warpriver.cli.runs import add_run_options, draw_results, make_simulation, run_simulation, write_results
from warpriver.cli.shared import (
    add_ground,
    add_line_options,
    command,
    fresh_folder,
    ground_under,
    quiet_warp,
    read_lines,
    stored_run,
)

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "simulate",
        _simulate,
        help="let the rivers of a file migrate, or go on with a stored run",
        description="Read river lines (CSV, GeoJSON, GeoPackage, GeoParquet, shapefile ...; downstream order), let\n"
        "them migrate and cut off their bends, and write into a folder the run, the final lines, a map, and for a GIS\n"
        "the rivers, courses with times, oxbow lakes and abandoned courses, in the format of INPUT or as .gpkg.\n"
        "INPUT may also be the run folder of an earlier command: it is then continued and grows.",
        epilog="examples:\n"
        "  warpriver simulate river.csv --width 80 --years 200 -o out/river\n"
        "  warpriver simulate rivers.gpkg --layer main --to-crs utm --years 500 --record-every 20 -o out/rivers\n"
        "  warpriver simulate rivers.gpkg --terrain dem.tif --years 300\n"
        "  warpriver simulate river.csv --solver path --search-radius 2 --years 300\n"
        "  warpriver simulate out/river/run --years 100",
    )
    parser.add_argument("input", metavar="INPUT", help="river lines, or the run folder of an earlier command")
    parser.add_argument("--width", type=float, metavar="M", help="bankfull width in m (default: the file's)")
    parser.add_argument("--depth", type=float, metavar="M", help="bankfull depth in m (default: from the width)")
    parser.add_argument("--layer", help="layer to read, of a file with several")
    add_line_options(parser)
    parser.add_argument("--crs", help="coordinate reference system of a file that does not say, e.g. EPSG:32619")
    parser.add_argument("--to-crs", help='reproject rivers and terrain, e.g. EPSG:32619, or "utm" for their zone')
    parser.add_argument(
        "--terrain",
        metavar="FILE",
        help="heights under the river (GeoTIFF, ESRI ASCII, npz ...): migration fades with their slope",
    )
    add_ground(parser)
    add_run_options(parser, out=None, years=200.0)


def _simulate(options: argparse.Namespace) -> int:
    from warpriver.history import History
    from warpriver.simulation import Simulation

    quiet_warp()
    source = Path(options.input)
    run = stored_run(source)
    if run is not None:
        terrain = ground_under(options, History.load(run).crs if options.to_crs else None)
        simulation = Simulation.resume(run, terrain=terrain, device=options.device, threads=options.threads)
        folder = Path(options.out) if options.out else run.parent
        if options.out or run.is_file():
            folder = fresh_folder(options.out or f"out/{run.stem}")
    else:
        network = read_lines(source, options, depth=options.depth, dtype=options.dtype, device=options.device)
        terrain = ground_under(options, network.crs)
        simulation = make_simulation(network, options, terrain)
        folder = fresh_folder(options.out or f"out/{source.name.split('.')[0]}")
    code = run_simulation(simulation, options, folder)
    write_results(simulation, folder)
    write_run(simulation.history, folder, source)
    draw_results(simulation.history, folder, terrain)
    return code
