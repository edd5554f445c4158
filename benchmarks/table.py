"""Prints the figures of results/ as Markdown: the table of docs/speed.md, or with --goals the goals beside them."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from plot import RESULTS, read, rows_of

SIZES = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
KINDS = {
    "migration": "migration and resampling alone",
    "cutoffs": "with cutoffs",
    "full": "with cutoffs and collisions",
}


def one(result: dict | None, case: str, **wanted: object) -> dict | None:
    """The row of one case, or None where the result has none."""
    found = rows_of(result, case, **wanted) if result else []
    return found[0] if found else None


def points_table(step: dict) -> str:
    """Nanoseconds per point and step against points."""
    sizes = [n for n in SIZES if one(step, "1000 a channel", asked_points=n)]
    lines = [f"| points | {' | '.join(f'{n:,}' for n in sizes)} |", "| --- " * (len(sizes) + 1) + "|"]
    for variant, name in KINDS.items():
        rows = [one(step, "1000 a channel", asked_points=n, variant=variant) for n in sizes]
        cells = [f"{r['ns_per_point']:.0f}" if r else "" for r in rows]
        lines.append(f"| {name}, ns per point and step | {' | '.join(cells)} |")
    return "\n".join(lines)


def sentences(step: dict, network: dict | None, startup: dict | None) -> list[str]:
    """What else docs/speed.md says, as far as it was measured."""
    said = []
    peers = rows_of(step, "meanderpy")
    if peers:
        ratios = ", ".join(f"1/{r['ratio']:,.0f}" for r in peers)
        points = ", ".join(f"{r['asked_points']:,}" for r in peers)
        said.append(f"On the same centreline a step takes {ratios} of meanderpy's time at {points} points.")
    speed = 1e-9 * step["baseline"]["copy_bytes_per_second"]
    said.append(f"A plain copy moves {speed:.1f} GB/s on this machine (one core, read and written).")
    rivers, run = one(network, "extracted"), one(network, "long run")
    if rivers:
        said.append(
            f"The rivers of a terrain, {rivers['channels']:,} channels and {rivers['points']:,} points, on it with all "
            f"phases: {rivers['ms_per_step']:.0f} ms a step (one thread)."
        )
    if run:
        said.append(
            f"{run['channels_before']:,} channels for {run['years']:g} years, {run['steps']:,} steps: "
            f"{run['seconds']:.0f} s on {run['threads']} cores."
        )
    cold, warm = one(startup, "cold"), one(startup, "cached")
    if cold and warm:
        said.append(
            f"From the start of Python to the end of the first step: {warm['until_first_step_seconds']:.1f} s, "
            f"{cold['until_first_step_seconds']:.0f} s the first time, when kernels are compiled."
        )
    return said


def goals(step: dict | None, network: dict | None) -> list[tuple[str, str, str]]:
    """(figure, goal, measured) for all that was aimed at; measured is "not measured" where it was not."""
    rows: list[tuple[str, str, float | None]] = []

    def add(figure: str, row: dict | None, name: str, sign: str, goal: float) -> None:
        rows.append((figure, f"{sign} {goal:,g}", None if row is None else row.get(name)))

    for n, goal in zip(SIZES[1:], (70, 70, 80, 90), strict=True):
        row = one(step, "1000 a channel", asked_points=n, variant="cutoffs")
        add(f"ns a point, {n:,} points, cutoffs on", row, "ns_per_point", "<=", goal)
    add("exponent of cost against points", step["exponents"] if step else None, "cutoffs", "<=", 1.03)
    add("ms a step, one channel of 300 points", one(step, "one channel", asked_points=300), "ms_per_step", "<=", 0.03)
    many = one(step, "1000 a channel", asked_points=1_000_000, variant="cutoffs")
    single = one(step, "one channel", asked_points=1_000_000)
    ratio = {"x": single["ns_per_point"] / many["ns_per_point"]} if many and single else None
    add("one channel of 1M points over 1,000 channels, a point", ratio, "x", "<=", 1.5)
    drawn = one(network, "drawn lengths", asked_channels=20_000, mean_points=100)
    add("20,000 channels, 2M points: full step over migration", drawn, "ratio_to_migration", "<=", 2.5)
    tiles = one(network, "extracted x 4")
    name = f"{tiles['channels']:,} channels, {tiles['points']:,} points" if tiles else "four times those"
    add(f"rivers of terrains, {name}: the same", tiles, "ratio_to_migration", "<=", 2.5)
    worst = max((r["times_migrate"] for r in rows_of(network, "extracted, phase")), default=None) if network else None
    add("rivers of a terrain: the dearest phase over migrate", {"x": worst}, "x", "<=", 3)
    twice = one(step, "threads", asked_points=1_000_000, threads=2)
    add("two threads against one at 1M points, same bits", twice, "speedup", ">=", 1.5)
    for n, goal in ((300, 100), (1_000, 200), (3_000, 800), (10_000, 4_000)):
        add(f"meanderpy over ours, {n:,} points", one(step, "meanderpy", asked_points=n), "ratio", ">=", goal)
    add("ms a step, the paper's largest scene", one(network, "the paper's largest"), "ms_per_step", "<=", 1)
    large = one(step, "memory", asked_points=10_000_000)
    for part in ("making", "stepping"):
        add(f"bytes a point at 10M points while {part}", large, f"{part}_peak_bytes_per_point", "<=", 600)
    return [(figure, goal, "not measured" if value is None else f"{value:,.3g}") for figure, goal, value in rows]


def met(goal: str, measured: str) -> str:
    """Tell whether a goal is met."""
    if measured == "not measured":
        return ""
    sign, limit = goal.split()
    value, bound = (float(text.replace(",", "")) for text in (measured, limit))
    return "yes" if (value <= bound if sign == "<=" else value >= bound) else "NO"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=RESULTS, help="of the JSON files (default results)")
    parser.add_argument("--device", default="cpu", help="whose results (default cpu)")
    parser.add_argument("--goals", action="store_true", help="print what was aimed at instead")
    options = parser.parse_args(arguments)
    step, network, startup = (read(options.folder, f"{n}-{options.device}") for n in ("step", "network", "startup"))
    if options.goals:
        print("| figure | goal | measured | met |\n| --- | --- | --- | --- |")
        for figure, goal, measured in goals(step, network):
            print(f"| {figure} | {goal} | {measured} | {met(goal, measured)} |")
        return 0
    if step is None:
        print(f"{options.folder} holds no results of step.py: run make bench first", file=sys.stderr)
        return 1
    print(points_table(step) + "\n\n" + "\n".join(sentences(step, network, startup)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
