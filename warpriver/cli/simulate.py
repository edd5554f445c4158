"""``warpriver simulate``: rivers that migrate, and runs that go on."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.output import say
from warpriver.cli.parser import interval, number, whole_number
from warpriver.cli.results import write_run
from warpriver.cli.runs import add_run_options, draw_map, foretell, make_params, run_simulation, told_end, write_results
from warpriver.cli.shared import (
    LINE_FLAGS,
    OK,
    add_line_options,
    add_systems,
    add_terrain,
    command,
    fresh_folder,
    given_flags,
    ground_under,
    quiet_warp,
    read_lines,
    read_run,
    results_in,
    stored_run,
)
from warpriver.errors import InputError

if TYPE_CHECKING:
    from warpriver.simulation import Simulation

__all__ = ["add"]

# Defaults of runs that are no scenes.
YEARS, RECORDS = 200.0, "10steps"
# Flags that a scene takes.
SCENE_FLAGS = {"allow", "device", "threads", "no_progress", "out", "input", "schema", "help"}
# What is written into the folder of results.
RESULTS = ("run", "channels.csv", "belt.png", "rivers.gpkg", "rivers.geojson")


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "simulate",
        _simulate,
        help="let the rivers of a file migrate, go on with a stored run, or play a scene",
        description="Read river lines (CSV, GeoJSON, GeoPackage, GeoParquet, shapefile ...; points run downstream),\n"
        "let them migrate and cut off their bends, and write into a folder the run, the final lines, a map, and for a\n"
        "GIS the rivers, courses with times, oxbow lakes and abandoned courses, in the format of INPUT or as .gpkg.\n"
        "\n"
        "INPUT may also be the run of an earlier command: it goes on from its last record, over the terrain\n"
        "that it was run on, and grows. With -o it is copied first, and the copy goes on. Flags of the model\n"
        "change constants from there on; the change is recorded in the run. Flags that only say how lines\n"
        "are read are refused.\n"
        "\n"
        "A scene, a TOML file, says all of that itself: terrain, rivers, constants, controls, edits, outputs. With it\n"
        "go only --allow, --device, --threads, --no-progress and -o.",
        epilog="examples:\n"
        "  warpriver simulate river.csv --width 80 --years 200 -o out/river\n"
        "  warpriver simulate rivers.gpkg --layer main --to-crs utm --years 500 --record-every 10yr -o out/rivers\n"
        "  warpriver simulate rivers.gpkg --terrain dem.tif --years 300\n"
        "  warpriver simulate river.csv --solver path --search-radius 2 --years 300\n"
        "  warpriver simulate out/river/run --years 100\n"
        "  warpriver simulate out/river/run --migration-rate 20 --years 100 -o out/slower\n"
        "  warpriver simulate scene.toml -o out/scene\n"
        "  warpriver simulate --schema                           # every key of a scene",
    )
    parser.add_argument(
        "input",
        nargs="?",
        metavar="INPUT",
        help="river lines, the run folder of an earlier command, or a scene (.toml)",
    )
    parser.add_argument("--schema", action="store_true", help="print the keys of a scene and stop")
    parser.add_argument(
        "--allow",
        action="append",
        metavar="FOLDER",
        help="of a scene: it may also name files of this folder, beside those of its own; may be given again",
    )
    lines = parser.add_argument_group("river lines")
    lines.add_argument(
        "--width", type=number(above=0.0, unit="m"), metavar="M", help="bankfull width in m (default: the file's)"
    )
    lines.add_argument(
        "--depth", type=number(above=0.0, unit="m"), metavar="M", help="bankfull depth in m (default: from the width)"
    )
    add_line_options(lines)
    add_systems(lines, "a file")
    ground = add_terrain(
        parser,
        "heights under the rivers (GeoTIFF, ESRI ASCII, npz ...): migration fades with their slope; a run that goes on "
        "finds its own",
    )
    ground.add_argument(
        "--change-terrain",
        action="store_true",
        help="let a run go on over the --terrain that is given, or over a plain without one, also if it is not its own",
    )
    add_run_options(parser, out=None, years=YEARS, record_every=RECORDS)
    parser.add_argument(
        "--seed",
        type=whole_number(),
        metavar="N",
        help="seed of the strength of banks, the bends that come in at inlets, and avulsions (default 0); a run that "
        "goes on has its own",
    )
    # So that what was typed can be told from what was not: scenes have their own.
    parser.set_defaults(years=None, record_every=None)


def _simulate(options: argparse.Namespace) -> int:
    from warpriver.history import StopReason
    from warpriver.scenes import scene_schema

    if options.schema:
        say(scene_schema())
        return OK
    if options.input is None:
        raise InputError("name river lines, the folder of a run, or a scene (.toml)")
    quiet_warp()
    source = Path(options.input)
    if source.suffix.lower() == ".toml":
        return _play(source, options)
    if options.allow:
        raise InputError(f"--allow is for a scene, and {source} is none; leave it out")
    options.years = YEARS if options.years is None else options.years
    options.record_every = options.record_every or interval(RECORDS)
    run = stored_run(source)
    simulation, folder, store = _begun(source, options) if run is None else _resumed(run, options)
    with results_in(folder):
        code, told = run_simulation(simulation, options, store)
        try:
            if simulation.history.stop_reason is not StopReason.STORE_FAILED:
                told += write_results(simulation, folder)
                told += write_run(simulation.history, folder, source)
                told += draw_map(simulation.history, folder, simulation.terrain)
        finally:
            for line in told:
                say(line)
    return code


def _play(source: Path, options: argparse.Namespace) -> int:
    """Run a scene and write what it says."""
    from warpriver.history import StopReason
    from warpriver.scenes import read_scene

    useless = given_flags(options, [name for name in options.parser.flags() if name not in SCENE_FLAGS])
    if useless:
        raise InputError(f"{useless[0]}: the scene {source} says that itself; change it there, or leave it out")
    scene = read_scene(source, folders=options.allow or ())
    folder = scene.check_folder(options.out or f"out/{scene.name}")
    simulation = scene.simulation(device=options.device, threads=options.threads, folder=folder)
    store = scene.store(folder)
    with results_in(folder):
        scene.write_start(simulation, folder)
        watch = foretell(simulation, scene.years, scene.run_plan.record_every, store or folder, options.name)
        begin = time.perf_counter()
        scene.play(simulation, store=store, callbacks=watch, progress=not options.no_progress)
        code, told = told_end(simulation, 0, time.perf_counter() - begin, store, options.name)
        try:
            if simulation.history.stop_reason is not StopReason.STORE_FAILED:
                told += [f"  written  {path}" for path in scene.write(simulation, folder)]
        finally:
            for line in told:
                say(line)
    return code


def _begun(source: Path, options: argparse.Namespace) -> tuple[Simulation, Path, Path]:
    """Begin a run on the lines of a file."""
    from warpriver.simulation import Simulation

    if options.change_terrain:
        raise InputError(f"--change-terrain is for a run that goes on, and {source} is none; leave it out")
    params = make_params(options)
    out = options.out or f"out/{source.name.split('.')[0]}"
    folder = fresh_folder(out, *RESULTS, make=False)
    network = read_lines(source, options, depth=options.depth, dtype=options.dtype or "float64", device=options.device)
    terrain = ground_under(options, network.crs)
    simulation = Simulation(
        network, params, terrain=terrain, seed=options.seed or 0, check=options.check, threads=options.threads
    )
    return simulation, folder, folder / "run"


def _resumed(run: Path, options: argparse.Namespace) -> tuple[Simulation, Path, Path]:
    """Go on with a stored run, or with a copy of it."""
    from warpriver.simulation import Simulation

    if useless := given_flags(options, LINE_FLAGS):
        raise InputError(f"{useless[0]} says how river lines are read, and {run} is a run; leave it out")
    if options.terrain is None and options.to_crs is not None:
        raise InputError(
            f"--to-crs is for lines and a --terrain, and {run} is a run in a system of its own; leave it out"
        )
    history = read_run(run)
    if options.dtype not in (None, history.dtype):
        raise InputError(f"--dtype {options.dtype}: the run has {history.dtype}, and goes on in that; leave it out")
    if options.seed not in (None, history.seed):
        raise InputError(
            f"--seed {options.seed}: the run has the seed {history.seed}, and goes on with it; leave it out"
        )
    copied = options.out is not None or run.is_file()
    out = options.out or f"out/{run.stem}"
    folder = fresh_folder(out, *RESULTS, make=False) if copied else run.parent
    terrain = ground_under(options, history.crs)
    simulation = Simulation.resume(
        history,
        params=make_params(options, history.last_params),
        terrain=terrain,
        change_terrain=options.change_terrain,
        device=options.device,
        check=options.check,
        threads=options.threads,
    )
    return simulation, folder, folder / "run" if copied else run
