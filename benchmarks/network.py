"""What networks cost: many channels of drawn lengths, rivers of a terrain with all phases on, long runs with edits."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time

# One core, as long as a simulation is not given more: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
from machine import (
    KEPT,
    baseline,
    forget_peak,
    in_child,
    machine,
    memory_status,
    say_baseline,
    write_result,
)
from scipy.optimize import nnls

import warpriver as wr
from warpriver import bench

# Rivers are four times as wide as the default law has them, so that a cell of 60 m is about a width.
WIDTH_COEFFICIENT = 4 * 0.002285373260087453
CELL, RELIEF, SEED = 60.0, 150.0, 3
LINK_AREA = 1.7e6  # m2; gives 5,164 channels on 2048 x 2048 cells
PARAMS = wr.MeanderParams(spacing_in_widths=1.0)
QUIET = {"cutoff_distance": 0.0, "collision_distance": 0.0}
# No phase may cost more than so many times what migration does.
PHASE_LIMIT = 3.0
# The largest scene of Paris et al. (2023), Table 2: points, and ms a step on an i7 at 4 GHz.
PAPER_POINTS, PAPER_MS = 9807, 36.2
# Steps of a round: few, since the rivers of a terrain lengthen and join fast and are others after a century.
RIVER_REPEATS = 2
# Bins of the histogram of step costs.
BINS = 12


@dataclasses.dataclass(frozen=True)
class Plan:
    """Sizes of a run of this file.

    Attributes:
        channels: Numbers of channels of drawn lengths.
        mean_points: Mean points of a channel.
        most_points: Networks of more are left out.
        cells: Side of the terrain of the scale case.
        run_cells, run_area, run_years: Terrain, least drainage area (m2) and length of the long run.
    """

    channels: tuple[int, ...]
    mean_points: tuple[int, ...]
    most_points: int
    cells: int
    run_cells: int
    run_area: float
    run_years: float


USUAL = Plan((1, 10, 100, 1000, 5000, 20_000), (30, 100, 300), 2_500_000, 2048, 2048, 4.4e6, 300.0)
QUICK = Plan((1, 10, 100, 1000), (30, 100, 300), 100_000, 512, 512, 2.7e6, 30.0)
TINY = Plan((1, 10, 100), (30, 100), 10_000, 256, 256, 1.7e6, 5.0)
PLANS = {"usual": USUAL, "quick": QUICK, "tiny": TINY}


# ---- scenes


def link_lengths() -> np.ndarray:
    """Lengths in m of the links of a real network: 30 x 32 km of the Appalachians (SRTM), channels from 1 km2."""
    return wr.extract_network(wr.generate.read_sample_dem(), min_drainage_area=1e6).channel_lengths()


def drawn_network(channels: int, mean_points: float, device: str, seed: int = 0) -> wr.RiverNetwork:
    """Channels side by side, their lengths drawn from those of real links and scaled to a mean, a point every 50 m."""
    links = link_lengths()
    drawn = np.random.default_rng(seed).choice(links, channels) * (mean_points / links.mean())
    counts = np.maximum(drawn.round().astype(int), 4)
    lines = bench.lay_out(bench.cut_lines(counts.tolist(), seed))
    return wr.RiverNetwork.from_polylines(lines, width=bench.WIDTH, device=device)


def terrain_of(cells: int, device: str) -> wr.Terrain:
    """Built-in mountains of so many cells a side; they take long to make and are kept."""
    path = KEPT / f"fluvial-{cells}.npy"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        made = wr.generate.fluvial_terrain((cells, cells), cell_size=CELL, relief=RELIEF, seed=SEED)
        part = path.with_suffix(".part.npy")
        np.save(part, made.to_numpy())
        part.replace(path)
    return wr.Terrain(np.load(path), CELL, origin=(0.0, cells * CELL), device=device)


def rivers_of(terrain: wr.Terrain, area: float) -> wr.RiverNetwork:
    """The rivers of such a terrain."""
    return wr.extract_network(
        terrain, min_drainage_area=area, width_coefficient=WIDTH_COEFFICIENT, device=terrain.device
    )


def tiled(network: wr.RiverNetwork, times: int, gap: float = 2000.0) -> wr.RiverNetwork:
    """The same network times x times, side by side, ``gap`` m apart."""
    west, south, east, north = network.bounds()
    shifts = [
        np.array([i * (east - west + gap), j * (north - south + gap)]) for i in range(times) for j in range(times)
    ]
    count, nodes, start = len(shifts), network.node_count, network.starts()
    section = None if network.point_section is None else network.point_section.numpy()[: network.point_count]
    relative = network.points() - network.origin
    steps = np.arange(count)
    return wr.RiverNetwork(
        np.concatenate([relative + shift for shift in shifts]),
        np.append((start[:-1] + start[-1] * steps[:, None]).ravel(), start[-1] * count),
        channel_width=np.tile(network.channel_width, count),
        channel_depth=np.tile(network.channel_depth, count),
        channel_discharge=np.tile(network.channel_discharge, count),
        channel_nodes=(
            (network.channel_from + nodes * steps[:, None]).ravel(),
            (network.channel_to + nodes * steps[:, None]).ravel(),
            np.concatenate([network.node_xy + shift for shift in shifts]),
        ),
        point_section=None if section is None else np.tile(section, (count, 1)),
        origin=network.origin,
        device=network.device,
    )


# ---- questions


def costs(network: wr.RiverNetwork, params: wr.MeanderParams, *, repeats: int, **options: object) -> tuple[dict, dict]:
    """Cost of the full step of a network, and of migration and resampling alone, over rounds of ``repeats`` steps."""
    alone = dataclasses.replace(params, **QUIET)
    full, alone = (bench.step_cost(wr.Simulation(network, p, **options), repeats=repeats) for p in (params, alone))
    return full, alone


def channels_rows(plan: Plan, options: argparse.Namespace) -> list[dict]:
    """(a) Cost against the number of channels, by one thread."""
    rows = []
    for mean in plan.mean_points:
        for channels in plan.channels:
            if channels * mean > plan.most_points:
                continue
            network = drawn_network(channels, mean, options.device)
            repeats = min(50, max(3, 100_000 // network.point_count))
            full, alone = costs(network, wr.MeanderParams(), repeats=repeats, threads=1)
            rows.append({"case": "drawn lengths", "asked_channels": channels, "mean_points": mean} | full)
            rows[-1] |= {"migration_ms": alone["ms_per_step"], "ratio_to_migration": over(full, alone)}
            print_row(rows[-1])
    return rows


def over(full: dict, alone: dict) -> float:
    """Cost of a point in the full step over that in the other one; the two networks differ in points after a while."""
    return full["ns_per_point"] / alone["ns_per_point"]


def print_row(r: dict) -> None:
    print(
        f"{r['case']:>18} {r['channels']:>8} {r['points']:>9} {r['ms_per_step']:>10.4f} {r['ns_per_point']:>10.1f} "
        f"{r['ratio_to_migration']:>10.2f} {r['cutoffs_per_step']:>10.2f} {r['collisions_per_step']:>10.2f} "
        f"{r['substeps']:>9}",
        flush=True,
    )


def linear_fit(rows: list[dict]) -> dict:
    """Cost = a + b points + c channels, none below 0, with the least relative errors."""
    ms, points, channels = (np.array([r[k] for r in rows], float) for k in ("ms_per_step", "points", "channels"))
    terms = np.stack([np.ones_like(ms), points, channels], axis=1)
    found, _ = nnls(terms / ms[:, None], np.ones_like(ms))
    return {
        "us_per_step": 1e3 * found[0],
        "ns_per_point": 1e6 * found[1],
        "ns_per_channel": 1e6 * found[2],
        "largest_relative_error": float(np.abs(terms @ found / ms - 1.0).max()),
    }


def scale_case(plan: Plan, options: argparse.Namespace) -> list[dict]:
    """(b) Rivers of a terrain, all phases on; (c) four times as many, without the ground, against migration."""
    terrain = terrain_of(plan.cells, options.device)
    network = rivers_of(terrain, LINK_AREA)
    full, alone = costs(network, PARAMS, repeats=RIVER_REPEATS, terrain=terrain, threads=1)
    rows = [{"case": "extracted", "cells": plan.cells} | full]
    rows[0] |= {"migration_ms": alone["ms_per_step"], "ratio_to_migration": over(full, alone)}
    print_row(rows[0])
    sim = wr.Simulation(network, PARAMS, terrain=terrain, threads=1)
    phases = {name: 1e3 * cost for name, cost in bench.phase_seconds(sim, steps=20).items()}
    for name, ms in phases.items():
        rows.append({"case": "extracted, phase", "cells": plan.cells, "phase": name, "ms_per_step": ms})
        rows[-1]["times_migrate"] = ms / phases["migrate"]
    print("ms a step by phase: " + ", ".join(f"{name} {ms:.3f}" for name, ms in phases.items()))
    worst = max((name for name in phases if name != "migrate"), key=lambda name: phases[name])
    times = phases[worst] / phases["migrate"]
    verdict = "yes" if times <= PHASE_LIMIT else "NO"
    print(f"no phase above {PHASE_LIMIT:g} times migrate: {verdict} ({worst} {times:.2f} times)")
    full, alone = costs(tiled(network, 2), PARAMS, repeats=RIVER_REPEATS, threads=1)
    rows.append({"case": "extracted x 4", "cells": plan.cells} | full)
    rows[-1] |= {"migration_ms": alone["ms_per_step"], "ratio_to_migration": over(full, alone)}
    print_row(rows[-1])
    return rows


def long_run(plan: Plan, options: argparse.Namespace) -> dict:
    """(d) A long run with collisions, step by step; to be run in a process of its own."""
    terrain = terrain_of(plan.run_cells, "cpu")
    network = rivers_of(terrain, plan.run_area).to(options.device)
    del terrain
    wr.Simulation(drawn_network(4, 30, options.device), wr.MeanderParams()).step()
    fresh, before = forget_peak(), memory_status("VmRSS")
    begin = time.perf_counter()
    sim = wr.Simulation(network, PARAMS)
    points, channels = sim.network.point_count, sim.network.channel_count
    steps = round(plan.run_years / PARAMS.time_step)
    cost, joins = np.zeros(steps), np.zeros(steps, int)
    for k in range(steps):
        known, now = len(sim.history.collisions), time.perf_counter()
        sim.step()
        cost[k], joins[k] = time.perf_counter() - now, len(sim.history.collisions) - known
    total, peak = time.perf_counter() - begin, memory_status("VmHWM")
    edited = joins > 0
    edges = np.geomspace(1e3 * cost.min(), 1e3 * cost.max() * (1 + 1e-9), BINS + 1)
    kinds = {"with": edited, "without": ~edited}
    counts = {name: np.histogram(1e3 * cost[which], edges)[0].tolist() for name, which in kinds.items()}
    most = max(points, sim.network.point_count)
    return {
        "case": "long run", "cells": plan.run_cells, "years": plan.run_years, "steps": steps, "seconds": total,
        "threads": sim.threads, "channels_before": channels, "channels": sim.network.channel_count,
        "points_before": points, "points": sim.network.point_count, "ms_per_step": 1e3 * float(cost.mean()),
        "ms_median_with_edits": 1e3 * float(np.median(cost[edited])) if edited.any() else None,
        "ms_median_without_edits": 1e3 * float(np.median(cost[~edited])) if not edited.all() else None,
        "steps_with_edits": int(edited.sum()), "cutoffs_per_step": len(sim.history.cutoffs) / steps,
        "collisions_per_step": float(joins.mean()), "substeps": sim.substeps,
        "peak_bytes_per_point": (peak - before) / most if fresh and peak and before else None,
        "histogram_ms": edges.tolist(), "histogram": counts,
    }  # fmt: skip


def say_long_run(r: dict) -> None:
    print(
        f"{r['channels_before']} channels x {r['years']:g} years finished: {r['steps']} steps in {r['seconds']:.1f} s, "
        f"{r['ms_per_step']:.2f} ms a step ({r['threads']} threads), {r['channels']} channels left; a step: "
        f"{r['cutoffs_per_step']:.2f} cutoffs, {r['collisions_per_step']:.2f} joins"
    )
    if r["peak_bytes_per_point"] is not None:
        print(f"  the process grew by at most {r['peak_bytes_per_point']:.0f} bytes a point, its history included")
    print(f"  {'ms a step':>16} {'with edits':>10} {'without':>10}")
    edges, found = r["histogram_ms"], r["histogram"]
    for low, high, a, b in zip(edges[:-1], edges[1:], found["with"], found["without"], strict=True):
        print(f"  {low:>7.2f} {high:>8.2f} {a:>10} {b:>10}")


def paper_case(options: argparse.Namespace) -> dict:
    """(e) A network as large as the largest scene of the paper, on ground whose slope is felt, with collisions."""
    terrain, area, network = terrain_of(512, options.device), 8 * LINK_AREA, None
    for _ in range(6):  # finer channels are narrower, and their points closer: points go about as 1 / area
        network = rivers_of(terrain, area)
        sim = wr.Simulation(network, PARAMS, terrain=terrain, threads=1)
        if abs(sim.network.point_count / PAPER_POINTS - 1.0) < 0.02:
            break
        area *= sim.network.point_count / PAPER_POINTS
    full, alone = costs(network, PARAMS, repeats=RIVER_REPEATS, terrain=terrain, threads=1)
    found = {"case": "the paper's largest", "paper_points": PAPER_POINTS, "paper_ms": PAPER_MS} | full
    found |= {"migration_ms": alone["ms_per_step"], "ratio_to_migration": over(full, alone)}
    found["copies_of_points"] = bench.copies_of_points(
        1e-3 * full["ms_per_step"], full["points"], "float64", baseline(options.device)["copy_bytes_per_second"]
    )
    print_row(found)
    print(
        f"the paper: {PAPER_POINTS} points, {PAPER_MS} ms on a 4 GHz i7; here {full['points']} points, "
        f"{full['ms_per_step']:.3f} ms = {found['copies_of_points']:.0f} copies of the points by one core"
    )
    return found


def measure_all(plan: Plan, options: argparse.Namespace) -> dict:
    """All figures."""
    print(say_baseline(baseline(options.device)))
    heads = ("ms/step", "ns/point", "x migrate", "cuts/step", "joins/step")
    print(f"{'case':>18} {'channels':>8} {'points':>9} " + " ".join(f"{h:>10}" for h in heads) + f" {'sub-steps':>9}")
    rows = channels_rows(plan, options)
    fit = linear_fit(rows)
    print(
        f"cost = {fit['us_per_step']:.1f} us + {fit['ns_per_point']:.1f} ns a point + {fit['ns_per_channel']:.0f} ns a "
        f"channel, to {100 * fit['largest_relative_error']:.0f} % at worst"
    )
    rows += scale_case(plan, options)
    rows.append(paper_case(options))
    rows.append(in_child(__file__, "--measure-run", "--plan", options.plan, "--device", options.device))
    say_long_run(rows[-1])
    return {"rows": rows, "fit": fit}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("--quick", action="store_true", help="the same as --plan quick")
    parser.add_argument("--plan", default="usual", choices=PLANS, help="sizes (default usual: some minutes)")
    parser.add_argument("-o", "--out", help="JSON to write (default results/network-DEVICE.json)")
    parser.add_argument("--measure-run", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.plan = "quick" if options.quick else options.plan
    plan = PLANS[options.plan]
    if options.measure_run:
        print(json.dumps(long_run(plan, options)))
        return
    result = {
        "benchmark": "network",
        "plan": options.plan,
        "machine": machine(options.device),
        "baseline": baseline(options.device),
        **measure_all(plan, options),
    }
    write_result(result, options.out, f"network-{options.device.split(':')[0]}")


if __name__ == "__main__":
    sys.exit(main())
