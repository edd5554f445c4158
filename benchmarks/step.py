"""What a step costs: against the number of points, and against meanderpy on the same line."""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
import warp as wp
from machine import machine

import warpriver as wr

WIDTH, SPACING, CHANNEL_POINTS = 50.0, 50.0, 1000
# Different rivers, so that their cutoffs fall on different steps.
RIVERS = 96
RESULTS = Path(__file__).parent / "results"
ROUNDS = 5


def seconds(call: Callable[[], object], repeats: int, device: wp.Device) -> float:
    """Least time of one call over several rounds of ``repeats`` calls."""
    best = math.inf
    for _ in range(ROUNDS):
        wp.synchronize_device(device)
        begin = time.perf_counter()
        for _ in range(repeats):
            call()
        wp.synchronize_device(device)
        best = min(best, (time.perf_counter() - begin) / repeats)
    return best


def baseline(points: int) -> float:
    """Nanoseconds a point of one memory-bound NumPy pass over three arrays of that many float64."""
    a, b, c = np.ones(points), np.ones(points), np.empty(points)
    device = wp.get_device("cpu")
    return 1e9 * seconds(lambda: np.add(a, b, out=c), max(3, 5_000_000 // points), device) / points


def developed_lines(points: int) -> list[np.ndarray]:
    """Different rivers of about so many points, of sinuosity above 2, whose necks close now and then."""
    length = points * SPACING / 2.7
    rivers = RIVERS if points <= CHANNEL_POINTS else 1
    lines = [wr.generate.noisy_line(length, SPACING, WIDTH, seed) for seed in range(rivers)]
    apart = wr.MeanderParams(collision_distance=0.0)  # they all begin at the origin
    sim = wr.Simulation(wr.RiverNetwork.from_polylines(lines, width=WIDTH), apart)
    sim.run(years=300, record_every=10**6)
    return sim.network.polylines()


def simulation(points: int, channel_points: int, device: str, dtype: str, collisions: bool = False) -> wr.Simulation:
    """A simulation of about so many points in channels of so many, side by side."""
    tiles = developed_lines(min(channel_points, 20_000))
    if channel_points > 20_000:  # one long river: the pieces head to tail
        tile = tiles[0]
        count = max(1, round(channel_points / len(tile)))
        shift = tile[-1] - tile[0]
        lines = [np.concatenate([(tile if k == 0 else tile[1:]) + k * shift for k in range(count)])]
    else:
        mean = np.mean([len(t) for t in tiles])
        count = max(1, round(points / mean))
        apart = np.array([0.0, 2.0 * SPACING * channel_points])
        lines = [tiles[k % len(tiles)] + k * apart for k in range(count)]
    network = wr.RiverNetwork.from_polylines(lines, width=WIDTH, device=device, dtype=dtype)
    return wr.Simulation(network, wr.MeanderParams(collision_distance=1.0 if collisions else 0.0))


def step_cost(points: int, channel_points: int, device: str, dtype: str) -> dict:
    """Cost of a step at one size."""
    sim = simulation(points, channel_points, device, dtype)
    for _ in range(3):
        sim.step()
    cuts, count = len(sim.history.cutoffs), sim.network.point_count
    steps = max(3, 1_000_000 // count)
    cost = seconds(sim.step, steps, sim.device)
    now = sim.network.point_count
    base = baseline(max(1000, now))
    with_collisions = None
    if sim.network.channel_count > 1:
        full = simulation(points, channel_points, device, dtype, collisions=True)
        for _ in range(3):
            full.step()
        with_collisions = 1e9 * seconds(full.step, steps, full.device) / full.network.point_count
    state = sim.buffers.nbytes + now * 2 * (8 if dtype == "float64" else 4)
    return {
        "points": now,
        "channels": sim.network.channel_count,
        "ms_per_step": 1e3 * cost,
        "ns_per_point": 1e9 * cost / now,
        "baseline_ns_per_point": base,
        "ns_per_point_with_collisions": with_collisions,
        "ratio_to_baseline": 1e9 * cost / now / base,
        "cutoffs_per_step": (len(sim.history.cutoffs) - cuts) / (ROUNDS * steps),
        "bytes_per_point": state / now,
    }


def phase_costs(points: int, device: str, dtype: str) -> dict[str, float]:
    """Nanoseconds a point of each phase, launched one by one; the median over several steps."""
    sim = simulation(points, CHANNEL_POINTS, device, dtype, collisions=True)
    sim.step()
    graphs = {}
    for name, stages in itertools.groupby(sim._stages(), lambda stage: stage.phase):
        with wp.ScopedCapture(device=sim.device) as recording:
            sim._run(list(stages))
        graphs[name] = recording.graph
    costs: dict[str, list[float]] = {name: [] for name in graphs}
    for _ in range(3 * ROUNDS):
        sim.buffers.fault.zero_()
        for name, graph in graphs.items():
            wp.synchronize_device(sim.device)
            begin = time.perf_counter()
            wp.capture_launch(graph)
            wp.synchronize_device(sim.device)
            costs[name].append(time.perf_counter() - begin)
    return {name: 1e9 * float(np.median(cost)) / sim.network.point_count for name, cost in costs.items()}


def meanderpy_cost(points: int) -> dict | None:
    """Cost of a step of meanderpy and of ours on the same centreline; None where meanderpy is not installed."""
    try:
        from meanderpy import meanderpy
    except ImportError:
        return None
    line = developed_lines(points)[0][:points]
    depth = float(wr.network.bankfull_depth(WIDTH))
    rate, step, padding = 60.0 / (365.25 * 86400.0), 106.0 * 86400.0, (20, 5)
    *_, arc = meanderpy.compute_derivatives(line[:, 0], line[:, 1], np.zeros(len(line)))

    def peer() -> None:
        """What the body of its main loop does; it edits its arguments, so each call starts from a copy."""
        x, y, z = line[:, 0].copy(), line[:, 1].copy(), np.zeros(len(line))
        x, y = meanderpy.migrate_one_step(
            x, y, z, WIDTH, rate, step, 1.0, 0.011, depth, *padding, deltas=SPACING, cfl_factor=0.5
        )
        x, y, z, *_ = meanderpy.cut_off_cutoffs(x, y, z, arc, WIDTH, SPACING)
        meanderpy.resample_centerline(x, y, z, SPACING)

    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=WIDTH))
    sim.step()
    peer()  # compiles its numba functions, if any
    device = sim.device
    ours = seconds(sim.step, max(5, 200_000 // points), device)
    theirs = seconds(peer, max(1, 3000 // points), device)
    return {"points": points, "meanderpy_ms": 1e3 * theirs, "ours_ms": 1e3 * ours, "ratio": theirs / ours}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--dtype", default="float64", choices=("float64", "float32"))
    parser.add_argument("--quick", action="store_true", help="sizes up to 100,000 points")
    parser.add_argument("-o", "--out", help="JSON to write (default results/step-DEVICE.json)")
    options = parser.parse_args()
    sizes = [1_000, 10_000, 100_000] + ([] if options.quick else [1_000_000])

    heads = ("ms/step", "ns/point", "+ collide", "x baseline", "cuts/step", "B/point")
    print(f"{'points':>9} {'channels':>8} " + " ".join(f"{head:>10}" for head in heads))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rows = []
    for size in sizes:
        rows.append(step_cost(size, CHANNEL_POINTS, options.device, options.dtype))
        print_row(rows[-1])
    if not options.quick:
        rows.append(step_cost(1_000_000, 1_000_000, options.device, options.dtype))
        print_row(rows[-1])
    # What the largest case added to the process, its making and the NumPy copies of it included.
    peak = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / max(r["points"] for r in rows)
    print(f"peak memory of the process: {peak:.0f} bytes a point")
    many = [r for r in rows if r["channels"] > 1 and r["points"] > 5_000]
    slope = np.polyfit(np.log([r["points"] for r in many]), np.log([r["ms_per_step"] for r in many]), 1)[0]
    print(f"cost grows as points^{slope:.3f}")
    phases = phase_costs(sizes[-1], options.device, options.dtype)
    print("ns a point by phase: " + ", ".join(f"{name} {cost:.1f}" for name, cost in phases.items()))
    peers = [r for r in (meanderpy_cost(n) for n in (300, 1_000, 3_000)) if r] if options.device == "cpu" else []
    for r in peers:
        print(
            f"{r['points']} points: meanderpy {r['meanderpy_ms']:.3g} ms, ours {r['ours_ms']:.3g} ms, x{r['ratio']:.0f}"
        )
    result = {
        "benchmark": "step",
        "dtype": options.dtype,
        "machine": machine(options.device, ("meanderpy",)),
        "sizes": rows,
        "exponent": slope,
        "phases_ns_per_point": phases,
        "meanderpy": peers,
        "peak_bytes_per_point": peak,
    }
    target = Path(options.out) if options.out else RESULTS / f"step-{options.device.split(':')[0]}.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(result, indent=2) + "\n")
    print(f"written to {target}")


def print_row(row: dict) -> None:
    cost = row["ns_per_point_with_collisions"]
    cells = [
        f"{row['points']:>9} {row['channels']:>8}",
        f"{row['ms_per_step']:>10.4f} {row['ns_per_point']:>10.1f}",
        f"{'' if cost is None else f'{cost:.1f}':>10} {row['ratio_to_baseline']:>10.1f}",
        f"{row['cutoffs_per_step']:>10.3f} {row['bytes_per_point']:>10.0f}",
    ]
    print(" ".join(cells))


if __name__ == "__main__":
    sys.exit(main())
