"""What the commands that run a simulation share: their flags, the run, and what it writes."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.shared import INTERRUPTED, OK, STOPPED_EARLY, can_draw
from warpriver.errors import InputError
from warpriver.params import DAYS_PER_YEAR, SOLVER_PARAMS, MeanderParams, PathMeander
from warpriver.validate import not_negative

if TYPE_CHECKING:
    from warpriver.history import History
    from warpriver.network import RiverNetwork
    from warpriver.simulation import Simulation
    from warpriver.terrain import Terrain

__all__ = ["add_run_options", "draw_results", "make_simulation", "run_simulation", "write_results"]


def add_run_options(
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


def make_simulation(network: RiverNetwork, options: argparse.Namespace, terrain: Terrain | None = None) -> Simulation:
    """Make the simulation that the flags ask for."""
    from warpriver.simulation import Simulation

    kind = SOLVER_PARAMS[options.solver]
    own = {field.name for field in dataclasses.fields(kind)}
    every = {field.name for params in SOLVER_PARAMS.values() for field in dataclasses.fields(params)}
    given = {name: getattr(options, name) for name in every if getattr(options, name, None) is not None}
    strange = sorted(set(given) - own)
    if strange:
        raise InputError(f"{_flag(strange[0])} means nothing to --solver {options.solver}; leave it out")
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


def check_run_options(options: argparse.Namespace) -> None:
    """Refuse what no run can be made with, before anything is read or written."""
    from warpriver.history import Every

    not_negative(options.years, "--years", "years")
    Every(steps=options.record_every)


def run_simulation(simulation: Simulation, options: argparse.Namespace, folder: Path) -> int:
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
    advice = reason.advice if reason is not StopReason.STORE_FAILED else _stored_advice(history, store)
    print(f"warpriver {options.name}: {reason.value}: {advice}", file=sys.stderr)
    return INTERRUPTED if reason is StopReason.INTERRUPTED else STOPPED_EARLY


def _stored_advice(history: History, store: Path) -> str:
    """Say what to do when a run could not be written on, which ends with this process."""
    if history.stored_count == 0:
        return "nothing is left of it; choose a folder with more room, and run it again"
    at = history.times[history.stored_count - 1]
    return f"it is stored up to {at:.6g} yr; make room, then go on from there with warpriver simulate {store}"


def write_results(simulation: Simulation, folder: Path) -> None:
    """Write the final lines, and say what a river expert would ask first."""
    from warpriver import metrics
    from warpriver.io.vector.networks import write_network

    network = simulation.network
    write_network(network, folder / "channels.csv")
    print(f"  lines    {folder / 'channels.csv'}")
    # Of many the one with most water surface: the longest may be a brook.
    largest = int((network.channel_lengths() * network.channel_width).argmax())
    xy, width = network.polylines()[largest], float(network.channel_width[largest])
    ring = bool(network.channel_closed[largest])
    wave = metrics.wavelength(xy, width, closed=ring)
    count = len(simulation.history.splits)
    splits = f" and {count} split{'s' if count > 1 else ''} of rings" if count else ""
    print(
        f"  largest channel: sinuosity {metrics.sinuosity(xy, ring):.3g}, meander wavelength {wave:.4g} m "
        f"({wave / width:.3g} widths); {len(simulation.history.cutoffs)} cutoffs{splits} in all"
    )


def draw_results(history: History, folder: Path, terrain: Terrain | None = None) -> None:
    """Draw what can be drawn on this machine; what cannot is named, and is no failure."""
    if not can_draw():
        return
    from warpriver import viz

    viz.draw_belt(history, folder / "belt.png", terrain=terrain)
    print(f"  map      {folder / 'belt.png'}")
