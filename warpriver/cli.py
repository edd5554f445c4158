"""The command line: calls the public API and nothing else."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import importlib.util
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver import __version__
from warpriver.params import DAYS_PER_YEAR, SOLVER_PARAMS, LehenyParams, MeanderParams, PathMeander

if TYPE_CHECKING:
    from warpriver.generate.eroded import ErodedTerrain
    from warpriver.generate.valley import Valley
    from warpriver.history import History
    from warpriver.hydrology.routing import Flow
    from warpriver.network import RiverNetwork
    from warpriver.simulation import Simulation
    from warpriver.terrain import Terrain

__all__ = ["main"]

OK, STOPPED_EARLY, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

EXTRAS = {
    "viz": ("matplotlib", "pyvista"),
    "movie": ("imageio_ffmpeg",),
    "gis": ("pyogrio", "geopandas", "shapely", "pyproj", "rasterio", "xarray"),
    "bench": ("meanderpy", "h5py", "numba"),
}

# Frames of the demo's movie; more make the file larger, not the film better.
DEMO_FRAMES = 40


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 stopped early, 2 bad input, 130 interrupted."""
    options = _parser().parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: print(
                f"warpriver {options.name}: warning: {message}", file=sys.stderr
            )
            return options.command(options)
    except (ValueError, OSError, ImportError, RuntimeError, MemoryError) as error:
        text = " ".join(str(error).split())
        if isinstance(error, OSError) and error.filename and str(error.filename) not in text:
            text += f": {error.filename}"
        print(f"warpriver {options.name}: {text}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"warpriver {options.name}: interrupted", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="warpriver",
        description="Rivers that meander, on the GPU or the CPU: migrate channel networks, real or not, and draw them.",
        epilog="warpriver COMMAND --help explains the flags of a command with their units and defaults.",
    )
    parser.add_argument("--version", action="version", version=f"warpriver {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_demo(commands)
    _add_network(commands)
    _add_simulate(commands)
    _add_erode(commands)
    _add_valley(commands)
    _add_render(commands)
    _add_bench(commands)
    _add_info(commands)
    return parser


def _command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], **texts: str
) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, formatter_class=argparse.RawDescriptionHelpFormatter, **texts)
    parser.set_defaults(command=run, name=name)
    return parser


# ---- demo


def _add_demo(commands: Any) -> None:
    parser = _command(
        commands,
        "demo",
        _demo,
        help="the main job on built-in input: a terrain, its rivers, and what they do in centuries",
        description="Make up a basin of 40 x 26 km among mountains, find its rivers, let them migrate, cut off\n"
        "their bends and run into each other, and draw them before and after. Needs no file from outside.\n"
        "Into FOLDER go terrain.npz, network.csv and network.png (the rivers as found), run (the simulation),\n"
        "channels.csv and rivers.png (the rivers after it), before_after.png, and the movie rivers.gif.",
        epilog="examples:\n"
        "  warpriver demo\n"
        "  warpriver demo --seed 3 --relief 600 --years 500 -o out/gentle\n"
        "  warpriver demo --min-area 2 --cell-size 50 --no-movie -o out/fine",
    )
    ground = parser.add_argument_group("terrain and network")
    ground.add_argument("--cell-size", type=float, default=100.0, metavar="M", help="terrain cell in m (default 100)")
    ground.add_argument(
        "--relief", type=float, default=1200.0, metavar="M", help="height of the mountains in m (default 1200)"
    )
    ground.add_argument(
        "--min-area", type=float, default=8.0, metavar="KM2", help="least drainage area of a channel in km2 (default 8)"
    )
    parser.add_argument("--no-movie", action="store_true", help="skip the movie, the slowest picture")
    _add_run_options(parser, out="out/demo", years=500.0, record_every=20, seed=1, reference="the widest channel's")


def _demo(options: argparse.Namespace) -> int:
    from warpriver import generate, hydrology
    from warpriver.io.lines import write_network
    from warpriver.io.rasters import write_terrain

    _quiet_warp()
    terrain = generate.intermontane_basin(options.cell_size, options.seed, relief=options.relief, device=options.device)
    network = hydrology.extract_network(
        terrain, min_drainage_area=1e6 * options.min_area, dtype=options.dtype, device=options.device
    )
    if options.reference_width is None:
        options.reference_width = max(float(width.max()) for width in network.point_widths())
    simulation = _simulation(network, options, terrain)
    folder = _fresh_folder(options.out)
    write_terrain(terrain, folder / "terrain.npz")
    write_network(network, folder / "network.csv")
    print(f"{terrain}\n{network}\n  terrain  {folder / 'terrain.npz'}\n  lines    {folder / 'network.csv'}")
    code = _run(simulation, options, folder)
    _write_results(simulation, folder)
    _draw_demo(simulation.history, terrain, folder, movie=not options.no_movie)
    return code


def _draw_demo(history: History, terrain: Terrain, folder: Path, *, movie: bool) -> None:
    """Draw the rivers before, after, and on the way."""
    if importlib.util.find_spec("matplotlib") is None:
        print('  no pictures: matplotlib is missing; pip install "warpriver[viz]"')
        return
    from warpriver import hydrology, viz

    found = history.networks[0]
    order = hydrology.strahler_order(found.channel_from, found.channel_to)
    viz.draw_network(
        found, folder / "network.png", terrain=terrain, color="order", order=order, title="Rivers of the terrain"
    )
    title = "Rivers of a basin"
    viz.draw_belt(history, folder / "rivers.png", terrain=terrain, color="discharge", title=title)
    viz.draw_before_after(history, folder / "before_after.png", terrain=terrain)
    for name in ("network.png", "rivers.png", "before_after.png"):
        print(f"  picture  {folder / name}")
    if movie:
        every = -(-len(history) // DEMO_FRAMES)
        viz.movie(history, folder / "rivers.gif", terrain=terrain, every=every, size=(880, 680), fps=8.0, title=title)
        print(f"  movie    {folder / 'rivers.gif'}")


# ---- network


def _add_network(commands: Any) -> None:
    parser = _command(
        commands,
        "network",
        _network,
        help="find the rivers of a terrain and write them as lines",
        description="Route water over a terrain, take what drains enough ground for a channel, and write the channels\n"
        "with their width, depth and discharge. Depressions are opened by carving first.",
        epilog="examples:\n"
        "  warpriver network dem.tif --min-area 2 -o rivers.gpkg --picture rivers.png\n"
        "  warpriver network dem.asc --crs EPSG:4326 --to-crs utm -o rivers.csv",
    )
    parser.add_argument("terrain", metavar="TERRAIN", help="heights: GeoTIFF, ESRI ASCII, npz ...")
    parser.add_argument("-o", "--out", required=True, metavar="FILE", help="lines to write; the ending says the format")
    parser.add_argument(
        "--min-area", type=float, default=1.0, metavar="KM2", help="least drainage area of a channel in km2 (default 1)"
    )
    parser.add_argument("--spacing", type=float, metavar="M", help="distance between points in m (default: the cell)")
    parser.add_argument("--smoothing", type=int, default=4, metavar="N", help="passes that smooth courses (default 4)")
    parser.add_argument("--picture", metavar="FILE", help="also draw the network over the shaded terrain, by order")
    parser.add_argument(
        "--fill",
        action="store_true",
        help="fill depressions instead of carving them open: finds more of the rivers of flat, leveed ground",
    )
    parser.add_argument("--crs", help="coordinate reference system of a file that does not say")
    parser.add_argument("--to-crs", help='reproject, e.g. EPSG:32619, or "utm" for the zone of the data')
    _add_heights(parser)


def _network(options: argparse.Namespace) -> int:
    from warpriver import hydrology
    from warpriver.io.lines import write_network

    _quiet_warp()
    terrain = _read_ground(options.terrain, options.crs, options)
    print(terrain)
    network = hydrology.extract_network(
        terrain,
        min_drainage_area=1e6 * options.min_area,
        spacing=options.spacing,
        smoothing=options.smoothing,
        carve=not options.fill,
    )
    print(network)
    area = network.channel_drainage_area
    if area is not None:
        print(f"largest drainage area {area.max() / 1e6:.4g} km2, discharge {network.channel_discharge.max():.4g} m3/s")
    write_network(network, options.out)
    print(options.out)
    if options.picture is not None:
        from warpriver import viz

        order = hydrology.strahler_order(network.channel_from, network.channel_to)
        viz.draw_network(network, options.picture, terrain=terrain, color="order", order=order)
        print(options.picture)
    return OK


# ---- simulate


def _add_simulate(commands: Any) -> None:
    parser = _command(
        commands,
        "simulate",
        _simulate,
        help="let the rivers of a file migrate, or go on with a stored run",
        description="Read river lines (CSV, GeoJSON, GeoPackage, GeoParquet, shapefile ...; downstream order), let\n"
        "them migrate and cut off their bends, and write the run, the final lines and a map into a folder.\n"
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
    _add_line_options(parser)
    parser.add_argument("--crs", help="coordinate reference system of a file that does not say, e.g. EPSG:32619")
    parser.add_argument("--to-crs", help='reproject rivers and terrain, e.g. EPSG:32619, or "utm" for their zone')
    parser.add_argument(
        "--terrain",
        metavar="FILE",
        help="heights under the river (GeoTIFF, ESRI ASCII, npz ...): migration fades with their slope",
    )
    _add_ground(parser)
    _add_run_options(parser, out=None, years=200.0)


def _simulate(options: argparse.Namespace) -> int:
    from warpriver.io.lines import read_network
    from warpriver.simulation import Simulation

    _quiet_warp()
    source = Path(options.input)
    terrain = None
    if options.terrain is not None:
        terrain = _read_ground(options.terrain, options.terrain_crs, options)
    if _is_run(source):
        run = source if (source / "run.json").is_file() or source.is_file() else source / "run"
        simulation = Simulation.resume(run, terrain=terrain, device=options.device, threads=options.threads)
        folder = Path(options.out) if options.out else run.parent
        if options.out or run.is_file():
            folder = _fresh_folder(options.out or f"out/{run.stem}")
    else:
        network = read_network(
            source,
            width=options.width,
            depth=options.depth,
            layer=options.layer,
            short=options.short,
            closed=options.closed or None,
            crs=options.crs,
            to_crs=options.to_crs,
            dtype=options.dtype,
            device=options.device,
        )
        simulation = _simulation(network, options, terrain)
        folder = _fresh_folder(options.out or f"out/{source.name.split('.')[0]}")
    code = _run(simulation, options, folder)
    _write_results(simulation, folder)
    _draw_results(simulation.history, folder, terrain)
    return code


def _add_run_options(
    parser: argparse.ArgumentParser,
    out: str | None,
    years: float,
    record_every: int = 10,
    seed: int = 0,
    reference: str | None = None,
) -> None:
    """Flags of every command that runs a simulation; ``reference`` says what the reference width is by default."""
    run = parser.add_argument_group("run")
    run.add_argument("--years", type=float, default=years, help=f"how long to run, in years (default {years:g})")
    run.add_argument(
        "--record-every",
        type=int,
        default=record_every,
        metavar="STEPS",
        help=f"steps between records (default {record_every})",
    )
    run.add_argument("--seed", type=int, default=seed, help=f"seed of what is random (default {seed})")
    run.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')
    run.add_argument(
        "--threads", type=int, metavar="N", help="threads on the CPU; results do not depend on it (default: all cores)"
    )
    run.add_argument("--dtype", default="float64", choices=("float64", "float32"), help="precision (default float64)")
    run.add_argument("--check", action="store_true", help="check every phase of every step (slow)")
    run.add_argument("--no-progress", action="store_true", help="no progress bar")
    where = out or "out/NAME"
    run.add_argument("-o", "--out", default=out, metavar="FOLDER", help=f"where results go (default {where})")
    model = parser.add_argument_group("model (Paris et al. 2023, Table 1)")
    model.add_argument(
        "--solver",
        choices=tuple(SOLVER_PARAMS),
        default="migration",
        help="what moves the channels: migration by upstream curvature, or shortest paths (default migration)",
    )
    model.add_argument("--step-days", type=float, metavar="DAYS", help="time step in days (default 106)")
    model.add_argument(
        "--spacing",
        type=float,
        metavar="M",
        help="distance between points in m (default 50, at most a channel's width)",
    )
    told = {"spacing_in_widths": "1, or 0 with --spacing"} | ({"reference_width": reference} if reference else {})
    shared = {field.name for field in dataclasses.fields(MeanderParams)}
    for field in dataclasses.fields(MeanderParams):
        if field.name not in ("time_step", "spacing"):
            _add_model_flag(model, field, told.get(field.name, field.default))
    path = parser.add_argument_group("model of --solver path, which shares the flags above that it has a use for")
    for field in dataclasses.fields(PathMeander):
        if field.name not in shared:
            _add_model_flag(path, field, field.default)


def _add_model_flag(group: Any, field: dataclasses.Field, default: Any) -> None:
    """Add the flag of one constant, whose help tells that default."""
    meta = field.metadata
    unit = "" if meta["unit"] == "-" else f" in {meta['unit']}"
    group.add_argument(
        _flag(field.name),
        type=str if meta["choices"] else float,
        choices=meta["choices"] or None,
        metavar=None if meta["choices"] else "X",
        help=f"{meta['doc']}{unit} (default {default})",
    )


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _simulation(network: RiverNetwork, options: argparse.Namespace, terrain: Terrain | None = None) -> Simulation:
    from warpriver.simulation import Simulation

    kind = SOLVER_PARAMS[options.solver]
    own = {field.name for field in dataclasses.fields(kind)}
    every = {field.name for params in SOLVER_PARAMS.values() for field in dataclasses.fields(params)}
    given = {name: getattr(options, name) for name in every if getattr(options, name, None) is not None}
    strange = sorted(set(given) - own)
    if strange:
        raise ValueError(f"{_flag(strange[0])} means nothing to --solver {options.solver}; leave it out")
    if options.spacing is None and options.spacing_in_widths is None:
        given["spacing_in_widths"] = 1.0
    if options.step_days is not None:
        given["time_step"] = options.step_days / DAYS_PER_YEAR
    return Simulation(
        network,
        kind(**given),
        terrain=terrain,
        seed=options.seed,
        check=options.check,
        threads=options.threads,
    )


def _run(simulation: Simulation, options: argparse.Namespace, folder: Path) -> int:
    """Run with a progress bar and say what came of it."""
    from warpriver.history import StopReason

    store = simulation.history.path or folder / "run"
    begin_step, begin = simulation.step_count, time.perf_counter()
    history = simulation.run(
        years=options.years,
        record_every=options.record_every,
        store=store,
        progress=not options.no_progress,
    )
    seconds = time.perf_counter() - begin
    steps = simulation.step_count - begin_step
    print(f"{simulation!r}")
    if steps:
        print(f"  {steps} steps in {seconds:.2f} s, {1e3 * seconds / steps:.3g} ms a step")
    reason = history.stop_reason or StopReason.COMPLETED
    print(f"  run      {store}")
    if reason is StopReason.COMPLETED:
        return OK
    print(f"warpriver {options.name}: {reason.value}: {reason.advice}", file=sys.stderr)
    return INTERRUPTED if reason is StopReason.INTERRUPTED else STOPPED_EARLY


def _write_results(simulation: Simulation, folder: Path) -> None:
    """Write the final lines, and say what a river expert would ask first."""
    from warpriver import metrics
    from warpriver.io.lines import write_network

    network = simulation.network
    write_network(network, folder / "channels.csv")
    print(f"  lines    {folder / 'channels.csv'}")
    # Of many the one with most water surface: the longest may be a brook.
    largest = int((network.channel_lengths() * network.channel_width).argmax())
    xy, width = network.polylines()[largest], float(network.channel_width[largest])
    ring = bool(network.channel_closed[largest])
    wave = metrics.wavelength(xy, width, closed=ring)
    print(
        f"  largest channel: sinuosity {metrics.sinuosity(xy, ring):.3g}, meander wavelength {wave:.4g} m "
        f"({wave / width:.3g} widths); {len(simulation.history.cutoffs)} cutoffs in all"
    )


def _draw_results(history: History, folder: Path, terrain: Terrain | None = None) -> None:
    """Draw what can be drawn on this machine; what cannot is named, and is no failure."""
    if importlib.util.find_spec("matplotlib") is None:
        print('  no pictures: matplotlib is missing; pip install "warpriver[viz]"')
        return
    from warpriver import viz

    viz.draw_belt(history, folder / "belt.png", terrain=terrain)
    print(f"  map      {folder / 'belt.png'}")


# ---- erode


def _add_erode(commands: Any) -> None:
    parser = _command(
        commands,
        "erode",
        _erode,
        help="let rain carve a river network into a plane, a peak or a terrain",
        description="Leheny's erosion: units of rain fall on random cells, walk downhill by chance, take a constant\n"
        "depth off every cell of their way, and what gets too steep slides. Writes the terrain, its rivers as lines,\n"
        "and pictures: the terrain by elevation, the drainage, the ordered network.",
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
    start.add_argument("--cell-size", type=float, metavar="M", help="cell of a plane or peak in m (default 1)")
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
    _add_heights(start)
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
    model.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')
    out = parser.add_argument_group("output")
    out.add_argument("-o", "--out", default="out/erode", metavar="FOLDER", help="where results go (default out/erode)")
    out.add_argument(
        "--rivers", type=float, default=50.0, metavar="R", help="least cells that a river drains (default 50)"
    )
    out.add_argument("--movie", metavar="FILE", help="also a movie of the network growing, .gif or .mp4, in FOLDER")
    out.add_argument("--frames", type=int, default=50, help="frames of the movie, about (default 50)")
    out.add_argument("--no-progress", action="store_true", help="no progress bar")


def _erode(options: argparse.Namespace) -> int:
    from warpriver import generate, hydrology
    from warpriver.io.lines import write_network
    from warpriver.io.rasters import write_terrain

    _quiet_warp()
    if options.movie is not None and Path(options.movie).suffix.lower() not in (".gif", ".mp4"):
        raise ValueError(f"--movie {options.movie}: the ending says the format; use .gif or .mp4")
    if options.frames < 2:
        raise ValueError(f"--frames {options.frames}: give 2 or more")
    start = _erosion_start(options)
    edges = options.edges.split(",") if options.edges and "," in options.edges else options.edges
    begin = time.perf_counter()
    eroded = generate.erode(
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
    _draw_erosion(eroded, flow, network, threshold, folder, options.movie)
    return OK


def _erosion_start(options: argparse.Namespace) -> Terrain:
    """Make or read the terrain that rain is to fall on."""
    from warpriver import generate

    made = {"plane": generate.erosion_plane, "peak": generate.erosion_peak}
    if options.start not in made:
        for flag in ("size", "cell_size", "slope"):
            if getattr(options, flag) is not None:
                raise ValueError(f"--{flag.replace('_', '-')} is for a plane or peak; {options.start} has its own")
        return _read_ground(options.start, options.crs, options, options.device)
    try:
        columns, rows = (int(n) for n in (options.size or "300x200").lower().split("x"))
    except ValueError:
        raise ValueError(f"--size {options.size}: give columns and rows, such as 300x200") from None
    size = 1.0 if options.cell_size is None else options.cell_size
    slope = 1.0 if options.slope is None else options.slope
    return made[options.start]((rows, columns), size, slope, device=options.device)


def _draw_erosion(
    eroded: ErodedTerrain, flow: Flow, network: RiverNetwork, threshold: float, folder: Path, movie: str | None
) -> None:
    """Draw the terrain, its drainage and its rivers, and the movie if there is to be one."""
    if importlib.util.find_spec("matplotlib") is None:
        print('  no pictures: matplotlib is missing; pip install "warpriver[viz]"')
        return
    from warpriver import viz

    viz.draw_elevation(eroded, folder / "elevation.png", title=f"{eroded.events:,} events")
    viz.draw_drainage(flow, folder / "drainage.png", min_drainage_area=threshold)
    viz.draw_ordered_network(eroded, network, folder / "network.png")
    print(f"  pictures {folder / 'elevation.png'}, drainage.png, network.png")
    if movie is not None:
        viz.erosion_movie(eroded, folder / movie, min_drainage_area=threshold)
        print(f"  movie    {folder / movie}")


# ---- valley


def _add_valley(commands: Any) -> None:
    parser = _command(
        commands,
        "valley",
        _valley,
        help="make a river valley of prescribed form, from an example or a TOML file",
        description="Make a synthetic river valley (Brown et al. 2014): S1 to S6, the paper's examples, or a TOML\n"
        "file of your own. Into a folder go its terrain, channel lines, points, mesh, breaklines, parameters and\n"
        "pictures; into a file what its ending says: terrain (.tif .asc .npz .r16 ...), points (.xyz .csv), mesh\n"
        "(.obj .ply .stl .vtp), breaklines (.geojson), channel (.gpkg), parameters (.toml) or picture (.png .pdf).",
        epilog="examples:\n"
        "  warpriver valley S3 -o out/S3\n"
        "  warpriver valley S5 --cell-size 0.5 -o s5.tif\n"
        "  warpriver valley S1 -o mine.toml                      # parameters to start from\n"
        "  warpriver valley mine.toml --set slope=0.004 --set sharp_bends=blend -o out/mine\n"
        "  warpriver valley --schema                             # every key of a valley file",
    )
    parser.add_argument("valley", nargs="?", metavar="S1..S6|FILE.toml", help="an example, or a valley file")
    parser.add_argument("-o", "--out", metavar="PATH", help="folder or file to write (default folder out/NAME)")
    parser.add_argument(
        "--cell-size", type=float, metavar="M", help="cells of the terrain in m (default: bankfull width / 20)"
    )
    parser.add_argument(
        "--spacing",
        type=float,
        metavar="M",
        help="distance of points and mesh across the channel in m (default: bankfull width / 20; the paper's is 0.1)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a constant of the valley, as width=40; may be given again",
    )
    parser.add_argument("--crs", help="coordinate reference system of the outputs, e.g. EPSG:32619 (default: none)")
    parser.add_argument(
        "--origin",
        type=float,
        nargs=2,
        default=(0.0, 0.0),
        metavar=("X", "Y"),
        help="place of the upstream end of the valley axis in m (default 0 0); moves a valley with a line of its own",
    )
    parser.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')
    parser.add_argument("--schema", action="store_true", help="print the keys of a valley file and stop")


def _valley(options: argparse.Namespace) -> int:
    from warpriver.generate.valley import synthetic_valley
    from warpriver.io.valleys import read_valley, valley_schema

    if options.schema:
        print(valley_schema())
        return OK
    if options.valley is None:
        raise ValueError("name an example, S1 to S6, or a TOML file")
    _quiet_warp()
    is_file = Path(options.valley).suffix.lower() == ".toml"
    params = read_valley(options.valley) if is_file else options.valley
    valley = synthetic_valley(
        params,
        cell_size=options.cell_size,
        origin=options.origin,
        crs=options.crs,
        device=options.device,
        **_settings(options.set),
    )
    print(valley)
    width, depth = valley.network.point_widths()[0], valley.network.point_depths()[0]
    print(f"width {width.min():.2f} to {width.max():.2f} m, bankfull depth {depth.min():.3f} to {depth.max():.3f} m")
    print(f"width to depth {valley.params.width_to_depth:.2f}, confinement {valley.params.confinement:.2f}")
    found = valley.covariance
    print(f"mean c(z_T, W) {found.mean_thalweg_width:.3f}, mean c(z_T, |C|) {found.mean_thalweg_curvature:.3f}")
    out = Path(options.out or f"out/{valley.params.name}")
    if out.suffix:
        _write_valley(valley, out, options.spacing)
        print(out)
        return OK
    out.mkdir(parents=True, exist_ok=True)
    terrain = "terrain.tif" if importlib.util.find_spec("rasterio") is not None else "terrain.npz"
    for name in (terrain, "channel.csv", "points.csv", "mesh.obj", "breaklines.geojson", "valley.toml"):
        _write_valley(valley, out / name, options.spacing)
        print(out / name)
    if importlib.util.find_spec("matplotlib") is None:
        print('no pictures: matplotlib is missing; pip install "warpriver[viz]"')
        return OK
    from warpriver import viz

    viz.draw_valley(valley, out / "valley.png")
    viz.draw_valley_sections(valley, out / "sections.png")
    print(out / "valley.png", out / "sections.png", sep="\n")
    return OK


def _write_valley(valley: Valley, path: Path, spacing: float | None) -> None:
    """Write what the name of a file says: breaklines, channel, parameters, picture, mesh, points, else terrain."""
    from warpriver.io import valleys
    from warpriver.io.lines import line_formats, write_network
    from warpriver.io.rasters import terrain_formats, write_terrain

    suffix = path.suffix.lower()
    if suffix == ".toml":
        valleys.write_valley(valley.params, path)
    elif suffix in (".geojson", ".json"):
        valleys.write_breaklines(valley.breaklines(), path, crs=valley.crs)
    elif path.name == "channel.csv":
        write_network(valley.network, path)
    elif suffix in valleys.POINTS and suffix != ".npz":
        valleys.write_points(valley.grid(spacing), path)
    elif suffix in valleys.MESHES:
        valleys.write_mesh(valley.grid(spacing), path)
    elif suffix in (".pdf", ".svg", ".png", ".jpg"):
        from warpriver import viz

        viz.draw_valley(valley, path)
    elif suffix in terrain_formats():
        write_terrain(valley.terrain, path)
    elif suffix in line_formats():
        write_network(valley.network, path)
    else:
        raise ValueError(f"cannot write {path}: no format of terrains, points, meshes, lines or pictures ends so")


def _settings(texts: Sequence[str]) -> dict[str, Any]:
    """Constants from KEY=VALUE, numbers where they are numbers."""
    found: dict[str, Any] = {}
    for text in texts:
        key, sign, word = text.partition("=")
        if not sign or not key.strip() or not word.strip():
            raise ValueError(f"--set {text}: give KEY=VALUE, as --set width=40")
        value: Any = word.strip()
        for kind in (float, int):
            with contextlib.suppress(ValueError):
                value = kind(word)
        found[key.strip()] = value
    return found


# ---- render


def _add_render(commands: Any) -> None:
    parser = _command(
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
    _add_ground(parser)
    parser.add_argument("--every", type=int, default=1, help="records a frame of a movie (default 1)")
    parser.add_argument("--fps", type=float, default=12.0, help="frames a second of a movie (default 12)")
    parser.add_argument("--title", help="title of a map or movie")
    parser.add_argument("--width", type=float, metavar="M", help="bankfull width in m of lines that have none")
    parser.add_argument("--layer", help="layer to read, of a file with several")
    _add_line_options(parser)
    parser.add_argument("--crs", help="coordinate reference system of a file that does not say")
    parser.add_argument("--to-crs", help='reproject lines, e.g. "utm"')


def _render(options: argparse.Namespace) -> int:
    from warpriver import viz
    from warpriver.history import History

    _quiet_warp()
    source, out = Path(options.input), Path(options.out)
    is_movie = out.suffix.lower() in (".gif", ".mp4")
    if not is_movie and out.suffix.lower() != ".png":
        raise ValueError(f"{out}: the ending says what to draw; use .png, .gif or .mp4")
    window, terrain = options.window, None
    if options.terrain is not None:
        terrain = _read_ground(options.terrain, options.terrain_crs, options)
    if not _is_run(source):
        if is_movie:
            raise ValueError(f"{source} holds lines, not a run: there is nothing to make a movie of; use .png")
        network = _read_lines(source, options)
        if options.scene:
            viz.render_scene(network, out, window=window, terrain=terrain)
        else:
            viz.draw_network(network, out, window=window, terrain=terrain, title=options.title)
        print(out)
        return OK
    history = History.load(source if source.is_file() or (source / "run.json").is_file() else source / "run")
    until = None
    if options.until is not None:
        until = int((history.times <= options.until).sum()) - 1
        if until < 0:
            raise ValueError(f"--until {options.until:g}: the run begins at {history.times[0]:g} yr")
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


# ---- bench


def _add_bench(commands: Any) -> None:
    parser = _command(
        commands,
        "bench",
        _bench,
        help="what a step costs on this machine",
        description="Let made-up rivers in full bend, 50 m wide with a point every 50 m, go on, and measure\n"
        "their steps: time a step and a point, by phase, and beside a plain copy of memory in the same run.\n"
        "Memory: about 150 bytes a point, and 1 GB for the copy. The whole suite, with peers, is benchmarks/.",
        epilog="examples:\n"
        "  warpriver bench\n"
        "  warpriver bench --points 1000000 --channels 1000 --threads 1\n"
        "  warpriver bench --device cuda --points 10000000 --channels 10000 --json gpu.json",
    )
    scene = parser.add_argument_group("scene")
    scene.add_argument("--points", type=int, default=100_000, metavar="N", help="points, about (default 100000)")
    scene.add_argument(
        "--channels", type=int, default=100, metavar="N", help="channels that share the points evenly (default 100)"
    )
    scene.add_argument("--terrain", action="store_true", help="put ground under them, whose slope is felt")
    scene.add_argument("--no-cutoffs", action="store_true", help="cut no necks off")
    scene.add_argument("--no-collisions", action="store_true", help="do not look for channels that touch")
    where = parser.add_argument_group("machine")
    where.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')
    where.add_argument("--dtype", default="float64", choices=("float64", "float32"), help="precision (default float64)")
    where.add_argument("--threads", type=int, metavar="N", help="threads on the CPU (default: one for each core)")
    parser.add_argument("--json", metavar="FILE", help="also write the figures into a file")


def _bench(options: argparse.Namespace) -> int:
    import json

    _quiet_warp()
    from warpriver import throughput

    target = None if options.json is None else Path(options.json)
    if target is not None and not target.parent.is_dir():
        raise ValueError(f"--json {target}: there is no folder {target.parent}")
    found = throughput.measure(
        options.points,
        options.channels,
        device=options.device,
        dtype=options.dtype,
        threads=options.threads,
        terrain=options.terrain,
        cutoffs=not options.no_cutoffs,
        collisions=not options.no_collisions,
    )
    hands = f"{found['threads']} thread{'s' * (found['threads'] != 1)}"
    parts = ["migration"] + [name for name in ("cutoffs", "collisions", "terrain") if found[name]]
    print(f"{found['device']}, {hands}, {found['dtype']}: {', '.join(parts)}")
    print(f"  scene    {found['points']} points in {found['channels']} channels")
    print(
        f"  step     {found['ms_per_step']:.4g} ms, {found['ns_per_point']:.4g} ns a point; "
        f"{found['cutoffs_per_step']:.3g} cutoffs, {found['bytes_per_point']:.0f} bytes a point on the device"
    )
    total = sum(found["phases_ms"].values())
    shares = [f"{name} {cost / total:.0%}" for name, cost in found["phases_ms"].items()]
    print(f"  phases   {', '.join(shares)}")
    print(
        f"  memory   a copy moves {1e-9 * found['copy_bytes_per_second']:.3g} GB/s (read + written): "
        f"a step takes as long as {found['copies_of_points']:.3g} copies of its points"
    )
    if target is not None:
        target.write_text(json.dumps({"benchmark": "bench", "warpriver": __version__, **found}, indent=2) + "\n")
        print(f"  figures  {target}")
    return OK


# ---- info


def _add_info(commands: Any) -> None:
    parser = _command(
        commands,
        "info",
        _info,
        help="what this installation can do, or what a file holds",
        description="Without FILE: versions, devices, optional parts, and whether 3-D previews can be drawn.\n"
        "With FILE: what the run or the lines hold.",
    )
    parser.add_argument("file", nargs="?", metavar="FILE", help="a run or river lines")
    parser.add_argument("--width", type=float, metavar="M", help="bankfull width in m of lines that have none")
    parser.add_argument("--layer", help="layer to read, of a file with several")
    _add_line_options(parser)
    parser.add_argument("--crs", help="coordinate reference system of a file that does not say")
    parser.add_argument("--to-crs", help='reproject lines, e.g. "utm"')


def _info(options: argparse.Namespace) -> int:
    _quiet_warp()
    if options.file is not None:
        return _info_file(options)
    import numpy
    import scipy
    import warp as wp

    wp.init()
    print(f"warpriver {__version__}, Warp {wp.__version__}, NumPy {numpy.__version__}, SciPy {scipy.__version__}")
    for device in wp.get_devices():
        memory = f", {device.total_memory / 2**30:.0f} GiB" if device.is_cuda else ""
        print(f"device {device.alias}: {device.name}{memory}")
    for extra, modules in EXTRAS.items():
        missing = [m for m in modules if importlib.util.find_spec(m) is None]
        state = "installed" if not missing else f'not installed (pip install "warpriver[{extra}]")'
        print(f"extra {extra}: {state}")
    if importlib.util.find_spec("pyvista") is not None:
        from warpriver import viz

        probe = viz.gl.probe()
        print(f"3-D previews: {'yes' if probe.ok else probe.message}")
    return OK


def _info_file(options: argparse.Namespace) -> int:
    from warpriver import metrics
    from warpriver.history import History

    source = Path(options.file)
    if _is_run(source):
        history = History.load(source if source.is_file() or (source / "run.json").is_file() else source / "run")
        print(history)
        network = history.networks[-1]
    else:
        network = _read_lines(source, options)
    print(network)
    west, south, east, north = network.bounds()
    print(f"west {west:.1f}, south {south:.1f}, east {east:.1f}, north {north:.1f} m")
    print(_attribute_summary(network))
    lines, lengths = network.polylines(), network.channel_lengths()
    for c in lengths.argsort()[::-1][:10]:
        sinuosity = metrics.sinuosity(lines[c], bool(network.channel_closed[c]))
        print(
            f"channel {c}: {lengths[c] / 1e3:.4g} km, {len(lines[c])} points, width {network.channel_width[c]:.4g} m, "
            f"depth {network.channel_depth[c]:.3g} m, sinuosity {sinuosity:.3g}"
        )
    if network.channel_count > 10:
        print(f"... and {network.channel_count - 10} shorter ones")
    return OK


def _attribute_summary(network: RiverNetwork) -> str:
    """Say from where to where the attributes of the channels go, of those that are known."""
    import numpy as np

    from warpriver import hydrology

    def span(values: np.ndarray, unit: str) -> str:
        low, high = f"{values.min():.3g}", f"{values.max():.3g}"
        return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"

    outlets = int((~np.isin(network.channel_to, network.channel_from)).sum())
    parts = [f"{outlets} outlet{'s' * (outlets != 1)}"]
    try:
        order = hydrology.strahler_order(network.channel_from, network.channel_to)
        parts.append(f"Strahler order 1 to {order.max()}")
    except ValueError as error:
        parts.append(f"no stream orders ({error})")
    parts.append(f"discharge {span(network.channel_discharge, 'm3/s')}")
    if network.channel_drainage_area is not None:
        parts.append(f"drainage area {span(network.channel_drainage_area / 1e6, 'km2')}")
    known = network.channel_slope[np.isfinite(network.channel_slope)]
    if len(known):
        some = "" if len(known) == network.channel_count else f" in {len(known)} channels"
        parts.append(f"slope {span(known, 'm/m')}{some}")
    return ", ".join(parts)


# ---- shared


def _read_lines(source: Path, options: argparse.Namespace) -> RiverNetwork:
    from warpriver.io.lines import read_network

    return read_network(
        source,
        width=options.width,
        layer=options.layer,
        short=options.short,
        closed=options.closed or None,
        crs=options.crs,
        to_crs=options.to_crs,
    )


def _add_heights(parser: Any) -> None:
    """Flags of every command that reads heights from a file."""
    parser.add_argument(
        "--z-factor", type=float, metavar="M", help="metres in the file's unit of height, 0.3048 for feet (default 1)"
    )
    parser.add_argument(
        "--nodata", type=float, metavar="H", help="height that stands for no data, besides what the file says"
    )


def _add_ground(parser: argparse.ArgumentParser) -> None:
    """Flags of a command that takes a terrain beside rivers."""
    parser.add_argument("--terrain-crs", metavar="CRS", help="coordinate reference system of a --terrain without one")
    _add_heights(parser)


def _read_ground(path: str, crs: str | None, options: argparse.Namespace, device: str = "cpu") -> Terrain:
    """Read a terrain as the flags say."""
    from warpriver.io.rasters import read_terrain

    return read_terrain(
        path, crs=crs, to_crs=options.to_crs, z_factor=options.z_factor, nodata=options.nodata, device=device
    )


def _add_line_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--short",
        default="error",
        choices=("error", "drop", "narrow", "keep"),
        help="lines shorter than they are wide, as linework has at junctions: refuse the file, drop them, narrow them "
        "to their length, or keep them (default error)",
    )
    parser.add_argument(
        "--closed",
        action="store_true",
        help="lines that end at their first point are rings: the water goes round (default: those that the file marks)",
    )


def _is_run(source: Path) -> bool:
    return source.suffix == ".npz" or any((p / "run.json").is_file() for p in (source, source / "run"))


def _fresh_folder(path: str) -> Path:
    """Make the folder for results; one that holds an earlier run is not written over."""
    folder = Path(path)
    if (folder / "run").exists():
        raise ValueError(f"{folder} holds an earlier run; remove it, choose another -o, or continue {folder / 'run'}")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _quiet_warp() -> None:
    """Start Warp without its greeting, and without its native warning where a machine has no CUDA driver."""
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        said.seek(0)
        for line in said.read().decode(errors="replace").splitlines():
            if "CUDA driver" not in line:
                print(line, file=sys.stderr)
