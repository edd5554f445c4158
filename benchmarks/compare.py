"""Two result files side by side: every row that both have, the ratio of its figures, and what became worse.

Times are divided by what the memory of each machine does: a step counts by the bytes that a plain copy moves in its
time, so that files from different machines can be compared, roughly. Exit code 1 with --fail-above where a figure is
worse by more than that ratio; a row of the old file that the new one lacks counts as well.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

# What tells a row from others. Sizes are those asked for: how many points there are in the end may change a little.
KEYS = (
    "case", "variant", "phase", "module", "asked_points", "asked_channels", "mean_points", "cells", "years", "threads",
    "mode", "rows", "columns", "events", "grids", "batch", "terrain", "size", "by", "file", "name", "dtype", "arch",
)  # fmt: skip
# Figures by the ends of their names: times are normalised, and of a few higher is better.
TIMES = ("_ms", "ms_per_step", "ns_per_point", "_seconds", "seconds")
SIZES = ("bytes_per_point", "registers", "local", "spills")
BETTER_HIGHER = ("events_per_second", "ratio", "speedup")
# Figures of the machine or of a peer, by name: they say nothing of this program.
NOT_OURS = ("triad_ns_per_point", "meanderpy_ms", "paper_ms", "roofline_bytes_per_point", "copy_bytes_per_second")
# What a smaller change is taken for chance.
TOLERANCE = 1.1


@dataclass(frozen=True)
class Change:
    """One figure of one row in both files.

    Attributes:
        row: What tells the row.
        figure: Name of the figure.
        old: Its value in the old file; None where the row is new.
        new: Its value in the new file; None where the row is gone.
        worse: How many times as bad it became, normalised; infinite where it is gone or was 0; None where it is new.
    """

    row: str
    figure: str
    old: float | None
    new: float | None
    worse: float | None


def tables(value: object, path: str = "") -> Iterator[tuple[str, dict]]:
    """All rows of a result as (name of the list that holds it, row)."""
    if isinstance(value, dict):
        for name, held in value.items():
            yield from tables(held, name)
    elif isinstance(value, list):
        for held in value:
            if isinstance(held, dict):
                yield path, held


def row_key(path: str, row: dict) -> str:
    """What tells a row of a table."""
    told = [f"{row[key]:g}" if isinstance(row[key], float) else str(row[key]) for key in KEYS if key in row]
    return " / ".join([path, *told])


def figures(row: dict, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Figures of a row that are compared, those in dictionaries below it included."""
    for name, value in row.items():
        full = f"{prefix}{name}"
        if isinstance(value, dict):
            yield from figures(value, f"{full}.")
        elif isinstance(value, (int, float)) and not isinstance(value, bool) and name not in (*KEYS, *NOT_OURS):
            if is_time(full) or full.endswith(SIZES) or full in BETTER_HIGHER:
                yield full, float(value)


def is_time(name: str) -> bool:
    """Tell whether a figure is a time, by its name or by that of the dictionary that holds it."""
    return any(part.endswith(TIMES) for part in name.split("."))


def bandwidth(result: dict) -> float | None:
    """Bytes a second that a plain copy moves on the machine of a result; None where it was not measured."""
    return result.get("baseline", result).get("copy_bytes_per_second")


def indexed(result: dict) -> dict[str, dict]:
    """Rows of a result by what tells them.

    Raises:
        ValueError: Two rows cannot be told from each other.
    """
    found: dict[str, dict] = {}
    for path, row in tables(result):
        key = row_key(path, row)
        if key in found:
            raise ValueError(f"two rows are called {key!r}")
        found[key] = row
    return found


def compare(old: dict, new: dict, *, normalise: bool = True) -> list[Change]:
    """Compare all figures of two results.

    Args:
        old: The result to compare with.
        new: The result in question.
        normalise: Whether times count by the bytes that could have been copied meanwhile; without effect where
            a file does not say how fast that was.

    Raises:
        ValueError: They are results of different benchmarks.
    """
    if old.get("benchmark") != new.get("benchmark"):
        raise ValueError(f"results of different benchmarks: {old.get('benchmark')} and {new.get('benchmark')}")
    speeds = bandwidth(old), bandwidth(new)
    faster = speeds[1] / speeds[0] if normalise and speeds[0] and speeds[1] else 1.0
    before, after = indexed(old), indexed(new)
    changes = []
    for key in [*before, *(k for k in after if k not in before)]:
        was, now = dict(figures(before.get(key, {}))), dict(figures(after.get(key, {})))
        for figure in [*was, *(f for f in now if f not in was)]:
            a, b = was.get(figure), now.get(figure)
            changes.append(Change(key, figure, a, b, worse(figure, a, b, faster)))
    return changes


def worse(figure: str, old: float | None, new: float | None, faster: float) -> float | None:
    """How many times as bad a figure became; ``faster``: by how much the new machine's memory is."""
    if old is None:
        return None
    if new is None or not math.isfinite(new):
        return math.inf
    if figure in BETTER_HIGHER:
        old, new = new, old
    if not (is_time(figure) or figure == "events_per_second"):
        faster = 1.0
    if old == 0.0:
        return 1.0 if new == 0.0 else math.inf
    return new * faster / old


def told(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def print_changes(changes: list[Change], tolerance: float, everything: bool) -> None:
    """Print those beyond the tolerance, or all."""
    shown = [c for c in changes if everything or c.worse is None or not 1.0 / tolerance <= c.worse <= tolerance]
    wide = max((len(f"{c.row}: {c.figure}") for c in shown), default=10)
    print(f"{'':{wide}} {'old':>10} {'new':>10} {'ratio':>7}")
    for c in shown:
        mark = ""
        if c.worse is not None and not 1.0 / tolerance <= c.worse <= tolerance:
            mark = "worse" if c.worse > 1.0 else "better"
        print(f"{f'{c.row}: {c.figure}':{wide}} {told(c.old):>10} {told(c.new):>10} {told(c.worse):>7} {mark}".rstrip())
    print(f"{len(changes)} figures, {len(changes) - len(shown)} of them within {tolerance:g} and not shown")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", metavar="OLD.json")
    parser.add_argument("new", metavar="NEW.json")
    parser.add_argument(
        "--tolerance", type=float, default=TOLERANCE, help=f"ratio up to which a change is chance (default {TOLERANCE})"
    )
    parser.add_argument("--fail-above", type=float, metavar="RATIO", help="exit code 1 where a figure is so much worse")
    parser.add_argument("--raw", action="store_true", help="compare times as they are, for files of one machine")
    parser.add_argument("--all", action="store_true", help="show figures within the tolerance as well")
    options = parser.parse_args(arguments)
    if options.tolerance < 1.0 or (options.fail_above is not None and options.fail_above < 1.0):
        parser.error("--tolerance and --fail-above are ratios of 1 or more")
    try:
        old, new = (json.loads(Path(path).read_text()) for path in (options.old, options.new))
        changes = compare(old, new, normalise=not options.raw)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    for name, result in (("old", old), ("new", new)):
        about, speed = result.get("machine", {}), bandwidth(result)
        copy = "no copy measured, times as they are" if speed is None else f"copy {1e-9 * speed:.3g} GB/s"
        print(f"{name}: {about.get('processor')}, {about.get('device')}, {about.get('commit')}, {copy}")
    print_changes(changes, options.tolerance, options.all)
    bad = [c for c in changes if options.fail_above and c.worse is not None and c.worse > options.fail_above]
    if bad:
        print(f"{len(bad)} figures are worse by more than {options.fail_above:g}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
