"""Planforms after 2,000 years beside those of measured rivers: three widths, three spacings, and how sure each is.

Each width and spacing is a run of some valleys of 300 widths, too far apart to meet. Bends are those of its last
records, a hundred years apart, and standard errors are jackknifed over the valleys: those of one valley
are no free sample.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from pathlib import Path

import numpy as np
from machine import machine, write_result
from scipy import stats

import warpriver as wr
from warpriver.metrics.meanders import Bends

YEARS, BETWEEN, RECORDS = 2000.0, 100.0, 5
LENGTH, APART = 300.0, 200.0  # widths
WIDTHS, PARTS = (50.0, 100.0, 200.0), (1.0, 0.5, 0.25)
# What measured rivers have: bends of six reaches in the Amazon basin, oxbow lakes of surveys.
REAL = {
    "wavelength": (13.0, 20.0),
    "bend length": (9.0, 14.0),
    "radius": (2.5, 3.6),
    "share of R < 2 w": (0.15, 0.35),
    "lean upstream, < 1.2": (0.31, 0.55),
    "lean upstream, 1.2 to 2": (0.49, 0.73),
    "lean upstream, > 2": (0.61, 0.85),
    "oxbow length": (20.0, 36.0),
    "straight below the head": (0.0, 30.0),
}
CLASSES = (0.0, 1.2, 2.0, np.inf)
# A lake is a bend that was left; shorter ones are trimmed off a neck that has just been cut.
SHORTEST_LAKE = 10.0  # widths


def measure(width: float, spacing: float, valleys: int, seed: int, device: str) -> dict:
    """The statistics of a run, each with its standard error."""
    lines = [wr.generate.noisy_line(LENGTH * width, 0.5 * width, 0.5 * width, 100 * seed + k) for k in range(valleys)]
    lines = [line + [0.0, k * APART * width] for k, line in enumerate(lines)]
    network = wr.RiverNetwork.from_polylines(lines, width=width, device=device)
    sim = wr.Simulation(network, wr.MeanderParams(spacing=spacing), seed=seed)
    begin = time.process_time()
    history = sim.run(years=YEARS, record_every=wr.Every(years=BETWEEN))
    spent = time.process_time() - begin

    records = history.networks[-RECORDS:]
    bends = [[wr.metrics.bends(line, width) for line in record.polylines()] for record in records]
    of_valley = [[record[k] for record in bends] for k in range(valleys)]
    found = jackknifed(of_valley, width)
    lakes = wr.metrics.oxbow_lengths(history.cutoffs) / width
    told = wr.metrics.statistics(history)
    owner = np.array([cutoff.channel for cutoff in history.cutoffs])
    parts = [np.log(lakes[owner == k]) for k in np.unique(owner)]
    without = [np.exp(np.concatenate(parts[:k] + parts[k + 1 :]).mean()) for k in range(len(parts))]
    found["oxbow length"] = float(np.exp(np.log(lakes).mean())), spread(without)
    found["straight below the head"] = told.straight_below_head, np.nan
    return {
        "width": width,
        "spacing": spacing,
        "valleys": valleys,
        "bends": sum(len(b.arc) for row in bends for b in row),
        "cpu_seconds": spent,
        "means": {name: value for name, (value, _) in found.items()},
        "errors": {name: error for name, (_, error) in found.items()},
        "lakes": tell_lakes(lakes, owner),
    }


def jackknifed(of_valley: list[list[Bends]], width: float) -> dict[str, tuple[float, float]]:
    """Statistics of the bends of all valleys, and standard errors from leaving one of them out at a time."""
    tables = [np.concatenate([table_of(b, width) for b in valley]) for valley in of_valley]
    whole = tell_bends(np.concatenate(tables))
    left_out = [tell_bends(np.concatenate(tables[:k] + tables[k + 1 :])) for k in range(len(tables))]
    return {name: (value, spread([each[name] for each in left_out])) for name, value in whole.items()}


def table_of(bends: Bends, width: float) -> np.ndarray:
    """(k, 5) arc, chord and radius in widths, sinuosity, and whether the apex lies upstream of the middle."""
    ahead = bends.apex < 0.5 * (bends.start + bends.end)
    return np.column_stack([bends.arc / width, bends.chord / width, bends.radius / width, bends.sinuosity, ahead])


def tell_bends(table: np.ndarray) -> dict[str, float]:
    arc, chord, radius, winding, ahead = table.T
    leans = [float(ahead[(winding >= a) & (winding < b)].mean()) for a, b in itertools.pairwise(CLASSES)]
    sizes = (2.0 * chord.mean(), np.median(arc), np.median(radius), (radius < 2.0).mean())
    return dict(zip(REAL, (*map(float, sizes), *leans), strict=False))


def spread(left_out: list[float]) -> float:
    """Standard error of a statistic from its values without one valley each."""
    n = len(left_out)
    return float(np.sqrt((n - 1) * np.var(left_out))) if n > 1 else np.nan


def tell_lakes(lakes: np.ndarray, owner: np.ndarray) -> dict[str, float]:
    """How near the lengths of the lakes are to a lognormal distribution.

    D of Kolmogorov and Smirnov is that of the logarithms to the normal distribution of their own mean and deviation;
    p, by simulation as these are from the same lakes [Lilliefors 1967], is that of the lakes of each valley.
    """
    long = lakes >= SHORTEST_LAKE
    found: dict[str, float] = {"lakes": len(lakes), "short": float((~long).mean())}
    for name, some in (("all", lakes), ("long", lakes[long])):
        log = np.log(some)
        d = stats.kstest((log - log.mean()) / log.std(), "norm").statistic
        found |= {f"{name}_mean": float(np.exp(log.mean())), f"{name}_spread": float(log.std()),
                  f"{name}_skew": float(stats.skew(log)), f"{name}_D": float(d)}  # fmt: skip
    draw = np.random.default_rng(0)
    p = [
        stats.goodness_of_fit(
            stats.norm, np.log(lakes[long & (owner == k)]), statistic="ks", n_mc_samples=499, rng=draw
        ).pvalue
        for k in np.unique(owner)
    ]
    return found | {"long_p": float(np.median(p)), "lognormal_valleys": float((np.array(p) > 0.05).mean())}


def told(row: dict) -> str:
    lines = [
        f"width {row['width']:g} m, spacing {row['spacing']:g} m: {row['bends']} bends, {row['cpu_seconds']:.0f} s"
    ]
    for name, value in row["means"].items():
        low, high = REAL[name]
        off = "" if low <= value <= high else f"   outside of {low:g} to {high:g}"
        lines.append(f"  {name:26} {value:6.2f} +- {row['errors'][name]:.2f}{off}")
    lakes = row["lakes"]
    lines.append(
        f"  {lakes['lakes']} lakes, {lakes['short']:.1%} shorter than {SHORTEST_LAKE:g} widths; the others: mean "
        f"{lakes['long_mean']:.1f}, D {lakes['long_D']:.3f}, p of a valley {lakes['long_p']:.2f}, lognormal at 5 % in "
        f"{lakes['lognormal_valleys']:.0%} of them; all: D {lakes['all_D']:.3f}"
    )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("--widths", type=float, nargs="+", default=WIDTHS, metavar="M", help="widths, m")
    parser.add_argument("--parts", type=float, nargs="+", default=PARTS, metavar="X", help="parts of the usual spacing")
    parser.add_argument("--valleys", type=int, default=8, help="valleys of each run (default 8)")
    parser.add_argument("--seed", type=int, default=1, help="seed of lines, banks and inlets (default 1)")
    parser.add_argument("-o", "--out", type=Path, help="JSON file for the results (default benchmarks/results)")
    options = parser.parse_args()
    usual, rows = wr.MeanderParams(), []
    for width in options.widths:
        for part in options.parts:
            spacing = part * min(usual.spacing, usual.spacing_in_widths * width)
            rows.append(measure(width, spacing, options.valleys, options.seed, options.device))
            print(told(rows[-1]), flush=True)
    result = {"machine": machine(options.device), "real": REAL, "rivers": rows}
    write_result(result, options.out, f"realism-{options.device.split(':')[0]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
