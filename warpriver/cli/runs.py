"""What the commands that run a simulation share: their flags, the run, and what it writes."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import functools
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.output import complain, say
from warpriver.cli.parser import Interval, interval, number, whole_number
from warpriver.cli.shared import INTERRUPTED, OK, STOPPED_EARLY, can_draw
from warpriver.cli.words import in_flags, naming
from warpriver.errors import InputError, WarpriverError
from warpriver.parameter import Params
from warpriver.params import DAYS_PER_YEAR, SOLVER_PARAMS, MeanderParams, PathMeander

if TYPE_CHECKING:
    from warpriver.history import Every, History
    from warpriver.simulation import Simulation
    from warpriver.terrain import Terrain

__all__ = [
    "add_run_options",
    "draw_map",
    "foretell",
    "given_params",
    "make_params",
    "run_simulation",
    "told_end",
    "write_results",
]

# A run of fewer steps times points takes a second or two: no estimate is made.
SHORT_RUN = 20_000_000
# A network with so many times the points that were estimated is worth a word.
OUTGROWN = 2.0
# Defaults that follow from something else.
TOLD = {"reference_width": "the widest channel's", "friction": "0.011", "memory_length": "2.2"}


def add_run_options(
    parser: argparse.ArgumentParser, out: str | None, years: float, record_every: str = "10steps"
) -> None:
    """Flags of every command that runs a simulation."""
    run = parser.add_argument_group("run")
    run.add_argument(
        "--years",
        type=number(0.0, unit="years"),
        default=years,
        metavar="YEARS",
        help=f"how long to run, in years (default {years:g})",
    )
    run.add_argument(
        "--record-every",
        type=interval,
        default=interval(record_every),
        metavar="TIME",
        help="time between records, in steps or years: 20steps or 10yr; a bare number is steps "
        f"(default {record_every})",
    )
    run.add_argument("--device", default="cpu", help='"cpu", "cuda", "cuda:1" ... (default cpu)')
    run.add_argument(
        "--threads",
        type=whole_number(1),
        metavar="N",
        help="threads on the CPU; results do not depend on it (default: all cores)",
    )
    run.add_argument("--dtype", choices=("float64", "float32"), help="precision (default float64)")
    run.add_argument("--check", action="store_true", help="check every phase of every step (slow)")
    run.add_argument("--no-progress", action="store_true", help="no progress bar")
    run.add_argument("-o", "--out", metavar="FOLDER", help=f"folder for the results (default {out or 'out/NAME'})")
    model = parser.add_argument_group(
        "model",
        "Meander migration after Howard and Knutson (1984), with constants after Paris et al. (2023), and what gives "
        "planforms the statistics of measured rivers. The rate of real rivers spans 2 to 128 m/yr.",
    )
    model.add_argument(
        "--solver",
        choices=tuple(SOLVER_PARAMS),
        help="what moves the channels: migration by upstream curvature, or shortest paths (default migration)",
    )
    model.add_argument(
        "--step-days", type=number(above=0.0, unit="days"), metavar="DAYS", help="time step in days (default 106)"
    )
    shared = {field.name for field in dataclasses.fields(MeanderParams)}
    for field in dataclasses.fields(MeanderParams):
        if field.name != "time_step":
            _add_model_flag(model, field)
    model.add_argument(
        "--set",
        action="append",
        metavar="PART.NAME=VALUE",
        help="a constant of a part of the model that has no flag of its own, which is thereby asked for, as "
        f"chutes.rate=0.001; may be given again. Parts and constants: {_told_parts()}",
    )
    path = parser.add_argument_group(
        "model of --solver path", "It shares the flags above, except those of rate, width, friction and weights."
    )
    for field in dataclasses.fields(PathMeander):
        if field.name not in shared:
            _add_model_flag(path, field)


def _add_model_flag(group: Any, field: dataclasses.Field[Any]) -> None:
    """Add the flag of one constant; its default is left to the constants."""
    meta = field.metadata
    unit = "" if meta["unit"] == "-" else f"{meta['unit']}; "
    with naming(**{name: _flag(name) for kind in SOLVER_PARAMS.values() for name in kind.__dataclass_fields__}):
        doc = in_flags(meta["doc"])
    if "kind" in meta:
        # What is there by default can be left out, what is not can be asked for.
        there = field.default is not None
        flag, value = ("--no-" + field.name, False) if there else (_flag(field.name), meta["kind"]())
        doc = f"without {doc.partition(';')[0]}" if there else doc
        group.add_argument(flag, dest=field.name, action="store_const", const=value, help=doc)
        return
    group.add_argument(
        _flag(field.name),
        type=str if meta["choices"] else float,
        choices=meta["choices"] or None,
        metavar=None if meta["choices"] else "X",
        help=f"{doc} ({unit}default {TOLD.get(field.name, field.default)})".replace("%", "%%"),
    )


def _parts(kind: type[MeanderParams] | type[PathMeander]) -> dict[str, type[Params]]:
    """Return the parts of a solver's constants that may be left out, by name."""
    return {f.name: f.metadata["kind"] for f in dataclasses.fields(kind) if "kind" in f.metadata}


def _told_parts() -> str:
    """What --set knows, for its help."""
    rows = ((name, [f.name for f in dataclasses.fields(part)]) for name, part in _parts(MeanderParams).items())
    return "; ".join(f"{name} ({', '.join(names)})" for name, names in rows)


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def given_params(options: argparse.Namespace) -> dict[str, Any]:
    """Return the constants that were typed, by their names."""
    every = {name for kind in SOLVER_PARAMS.values() for name in kind.__dataclass_fields__}
    given = {name: getattr(options, name) for name in every if getattr(options, name, None) is not None}
    if options.step_days is not None:
        given["time_step"] = options.step_days / DAYS_PER_YEAR
    return given


def make_params(
    options: argparse.Namespace, before: MeanderParams | PathMeander | None = None
) -> MeanderParams | PathMeander:
    """Return the constants that the flags ask for: those of a run with what was typed, or the defaults with that."""
    if before is None:
        kind = SOLVER_PARAMS[options.solver or "migration"]
    else:
        kind = type(before)
        if options.solver is not None and SOLVER_PARAMS[options.solver] is not kind:
            raise InputError(f"--solver {options.solver}: the run goes on by the one that it began with; leave it out")
    solver = next(name for name, params in SOLVER_PARAMS.items() if params is kind)
    given = given_params(options)
    if options.set:
        given |= _set_parts(options.set, kind, solver, given, before)
    strange = sorted(set(given) - set(kind.__dataclass_fields__))
    if strange:
        raise InputError(f"{_flag(strange[0])} means nothing to --solver {solver}; leave it out")
    return kind(**given) if before is None else before.replace(**given)


def _set_parts(
    texts: Sequence[str],
    kind: type[MeanderParams] | type[PathMeander],
    solver: str,
    given: Mapping[str, Any],
    before: MeanderParams | PathMeander | None,
) -> dict[str, Params]:
    """Return the parts of the constants that PART.NAME=VALUE change: of those that there are, or of the defaults."""
    from warpriver.io.tables import nearest, raising

    parts = _parts(kind)
    changes: dict[str, dict[str, Any]] = {}
    for text in texts:
        key, sign, word = (piece.strip() for piece in text.partition("="))
        name, dot, constant = key.partition(".")
        if not (sign and dot and word):
            own = f"; {name} has a flag, {_flag(name)}" if name in kind.__dataclass_fields__ else ""
            raise InputError(f"--set {text}: give PART.NAME=VALUE, as chutes.rate=0.001{own}")
        if name not in parts:
            raise InputError(f"--set {text}: --solver {solver} has no part {name}; {nearest(name, parts)}")
        known = {field.name: field for field in dataclasses.fields(parts[name])}
        if constant not in known:
            raise InputError(f"--set {text}: {name} has no {constant}; {nearest(constant, known)}")
        if given.get(name, True) is False:
            raise InputError(f"--set {text}: --no-{name} leaves that out; give one of the two")
        value: Any = word
        if not known[constant].metadata["choices"]:
            with contextlib.suppress(ValueError):
                value = float(word)
        changes.setdefault(name, {})[constant] = value
    found: dict[str, Params] = {}
    for name, values in changes.items():
        begin = getattr(before, name, None) or parts[name]()
        make = functools.partial(begin.replace, **values)
        # All at once: limits may hold of one another.
        found[name] = raising("--set", make, {f"{parts[name].__name__}.": f" {name}."})
    return found


def schedule_of(every: Interval) -> Every:
    """Return the schedule of records that was typed."""
    from warpriver.history import Every

    return Every(steps=every.steps, years=every.years)


def run_simulation(simulation: Simulation, options: argparse.Namespace, store: Path) -> tuple[int, list[str]]:
    """Tell what the run will take, do it with a progress bar, and return the exit code and what came of it."""
    every = schedule_of(options.record_every)
    begin_step, begin = simulation.step_count, time.perf_counter()
    simulation.run(
        years=options.years,
        record_every=every,
        store=store,
        callbacks=foretell(simulation, options.years, every, store, options.name),
        progress=not options.no_progress,
    )
    return told_end(simulation, begin_step, time.perf_counter() - begin, store, options.name)


def told_end(
    simulation: Simulation, begin_step: int, seconds: float, store: Path | None, name: str
) -> tuple[int, list[str]]:
    """Return the exit code of a run that ended, and what came of it.

    Args:
        simulation: The run.
        begin_step: Steps that were done before.
        seconds: What it took.
        store: Where it is stored, or None.
        name: Name of the command.
    """
    from warpriver.history import StopReason

    history, steps = simulation.history, simulation.step_count - begin_step
    told = [repr(simulation)]
    if steps:
        told.append(f"  {steps} steps in {seconds:.2f} s, {1e3 * seconds / steps:.3g} ms a step")
    told += [f"  run      {store}"] if store is not None else []
    reason = history.stop_reason or StopReason.COMPLETED
    if reason is StopReason.COMPLETED:
        return OK, told
    failed = reason is StopReason.STORE_FAILED and store is not None
    advice = _stored_advice(history, store) if failed and store is not None else in_flags(reason.advice)
    complain(f"warpriver {name}: {reason.value}: {advice}")
    return (INTERRUPTED if reason is StopReason.INTERRUPTED else STOPPED_EARLY), told


def _stored_advice(history: History, store: Path) -> str:
    """Say what to do when a run could not be written on, which ends with this process."""
    if history.stored_count == 0:
        return "nothing is left of it; choose a folder with more room, and run it again"
    at = history.times[history.stored_count - 1]
    return f"it is stored up to {at:.6g} yr; make room, then go on from there with warpriver simulate {store}"


def foretell(
    simulation: Simulation, years: float, every: Every, store: Path, name: str
) -> list[tuple[Every, Callable[[Simulation], None]]]:
    """Say what a long run will take, and return callbacks that watch that it is no more.

    Args:
        simulation: The run before it begins.
        years: How long it will be.
        every: When it is recorded.
        store: Where it is stored.
        name: Name of the command.
    """
    from warpriver.estimate import estimate_run

    steps = int(years / simulation.params.time_step) + 1
    if steps * simulation.network.point_count < SHORT_RUN:
        return []
    try:
        found = estimate_run(simulation, steps, every)
    except WarpriverError:  # a copy cannot be made of every state of a run
        return []
    (now, grown), (soon, late), (small, large) = found.points, found.seconds, found.bytes
    more = ""
    if grown > 1.1 * now:
        more = f"; {_time(late)} and {_size(large)} with {grown:,} points, when bends have grown"
    say(f"  estimate {steps:,} steps of {now:,} points take about {_time(soon)} and {_size(small)} of disk{more}")
    above = next(p for p in (store, *store.absolute().parents) if p.exists())
    free = shutil.disk_usage(above).free
    if free < large:
        complain(f"warpriver {name}: warning: {_size(free)} are free on the disk of {store}")
    limit = OUTGROWN * max(grown, now)
    told: list[bool] = []

    def watch(running: Simulation) -> None:
        if running.network.point_count > limit and not told:
            told.append(True)
            complain(
                f"warpriver {name}: warning: at {running.time:.4g} yr the network has "
                f"{running.network.point_count:,} points, more than twice the estimate: steps take longer and longer. "
                "Small channels may migrate too fast: look at --reference-width and --migration-rate. Ctrl-C ends the "
                "run at a step and keeps it"
            )

    return [(every, watch)]


def _time(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def _size(count: float) -> str:
    return f"{count / 1e6:.{0 if count > 1e7 else 1}f} MB" if count < 1e9 else f"{count / 1e9:.1f} GB"


def _metres(length: float) -> str:
    """A length in whole metres, of brooks to two digits."""
    return f"{length:.0f}" if length >= 10.0 else f"{length:.2g}"


def write_results(simulation: Simulation, folder: Path) -> list[str]:
    """Write the final lines, and return what a river expert would ask first."""
    from warpriver import metrics
    from warpriver.io.vector.networks import write_network

    network = simulation.network
    write_network(network, folder / "channels.csv")
    # Of many the one with most water surface: the longest may be a brook.
    largest = int((network.channel_lengths() * network.channel_width).argmax())
    xy, width = network.polylines()[largest], float(network.channel_width[largest])
    ring = bool(network.channel_closed[largest])
    wave, usual = metrics.wavelength(xy, width, closed=ring), metrics.wavelength_range(width)
    bends = "no meander wavelength, as it has too few bends"
    if wave > 0.0:
        bends = f"meander wavelength {wave:.4g} m, {wave / width:.3g} widths"
    cutoffs, count = len(simulation.history.cutoffs), len(simulation.history.splits)
    splits = f" and {count} split{'s' if count > 1 else ''} of rings" if count else ""
    return [
        f"  lines    {folder / 'channels.csv'}",
        f"  largest channel: width {width:.4g} m, sinuosity {metrics.sinuosity(xy, ring):.3g}, {bends} (usual for this "
        f"width: {_metres(usual[0])} to {_metres(usual[1])} m); {cutoffs} cutoffs{splits} in all",
    ]


def draw_map(history: History, folder: Path, terrain: Terrain | None) -> list[str]:
    """Draw the map of a run, if this machine can; return what to say of it."""
    if not can_draw():
        return []
    from warpriver import viz

    viz.draw_belt(history, folder / "belt.png", terrain=terrain)
    return [f"  map      {folder / 'belt.png'}"]
