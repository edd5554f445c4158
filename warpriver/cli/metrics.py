"""``warpriver metrics``: the statistics of rivers, measured or simulated, side by side."""

from __future__ import annotations

import argparse
import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpriver.cli.files import kind_of
from warpriver.cli.output import say
from warpriver.cli.shared import OK, add_lines, check_out, command, quiet_warp, read_lines, read_run, stored_run
from warpriver.errors import InputError

if TYPE_CHECKING:
    from warpriver.history import History
    from warpriver.network import RiverNetwork

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands,
        "metrics",
        _metrics,
        help="statistics of rivers and runs, side by side",
        description="Measure the planform of each FILE: meander wavelength, length, radius and lean of bends,\n"
        "straight reaches, angles of tributaries, oxbow lakes, in widths of the channels. Of a run its last record\n"
        "and all its cutoffs.",
        epilog="examples:\n"
        "  warpriver metrics rivers.gpkg\n"
        "  warpriver metrics measured.csv out/river/run\n"
        "  warpriver metrics river_1987.csv --later river_2017.csv -o river.csv",
    )
    parser.add_argument("files", nargs="+", metavar="FILE", help="river lines or runs")
    parser.add_argument(
        "--later",
        metavar="FILE",
        help="lines of the same channels at a later date, for the lag of migration behind curvature",
    )
    parser.add_argument("-o", "--out", metavar="FILE", help="also write the table, as .csv")
    add_lines(parser)


def _metrics(options: argparse.Namespace) -> int:
    from warpriver import metrics

    out = None if options.out is None else check_out(options.out, "-o", (".csv",))
    if options.later is not None and len(options.files) > 1:
        raise InputError(f"--later belongs to one FILE, and {len(options.files)} are given; measure one at a time")
    quiet_warp()
    later = None if options.later is None else read_lines(Path(options.later), options)
    rivers = [_river(Path(name), options) for name in options.files]
    found = [metrics.statistics(river, later) for river in rivers]
    heads = [Path(name).stem for name in options.files]
    if len(found) == 1:
        say(str(found[0]))
    elif len(found) == 2:
        say(f"a: {options.files[0]}\nb: {options.files[1]}")
        say(str(metrics.Comparison(*found)))
    else:
        for name, each in zip(options.files, found, strict=True):
            say(f"{name}:\n{each}\n")
    if out is not None:
        rows = zip(*(each.rows() for each in found), strict=True)
        with out.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["statistic", "unit", *heads])
            for row in rows:
                values = ["" if math.isnan(value) else f"{value:.6g}" for _, value, _, _ in row]
                table.writerow([row[0][0], row[0][2], *values])
        say(f"{out}")
    return OK


def _river(source: Path, options: argparse.Namespace) -> RiverNetwork | History:
    """Read lines or a run."""
    kind = kind_of(source)
    if kind == "run":
        return read_run(stored_run(source) or source)
    if kind != "lines":
        raise InputError(f"{source} holds a {kind}; give river lines or a run")
    return read_lines(source, options)
