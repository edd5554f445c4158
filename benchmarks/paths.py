"""What a step by shortest paths costs: beside migration on the same rivers and rings, its search beside scipy's."""

from __future__ import annotations

import argparse
import os
import sys
import time

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
import warp as wp
from machine import machine, write_result
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import warpriver as wr
from warpriver import bench
from warpriver.shortest_path.route import TakeShortcuts

CHANNEL_POINTS = 1000
RING_WIDTH, RING_SPACING = 60.0, 40.0  # m
RING_STEPS = 120  # until rings are in full bend and their necks close
SETTLE = 10  # steps before the measurement, so that each solver has cut what it cuts at once
ROUNDS = 5


def both(points: int, channel_points: int, device: str, dtype: str) -> tuple[wr.Simulation, wr.Simulation]:
    """Migration and shortest paths on the same developed rivers, collisions off."""
    channels = max(1, points // channel_points)
    migration = bench.synthetic_network(points, channels, device=device, dtype=dtype, threads=1, collisions=False)
    path = wr.Simulation(migration.network, wr.PathMeander(collision_distance=0.0), threads=1)
    for _ in range(SETTLE):
        migration.step()
        path.step()
    return migration, path


def noisy_rings(points: int, device: str, dtype: str) -> tuple[wr.Simulation, wr.Simulation]:
    """Migration and shortest paths from the same rings, of about 1,000 points each, after a century's bends."""
    rng = np.random.default_rng(0)
    angle = 2.0 * np.pi * np.arange(CHANNEL_POINTS) / CHANNEL_POINTS
    circle, radius = np.stack([np.cos(angle), np.sin(angle)], axis=1), CHANNEL_POINTS * RING_SPACING / (2.0 * np.pi)
    count = max(1, points // CHANNEL_POINTS)
    lines = []
    for k in range(count):
        bumps = sum(rng.normal(0.0, 40.0) * np.cos(m * angle + rng.uniform(0.0, 6.0)) for m in range(3, 60))
        lines.append((radius + bumps)[:, None] * circle + 4.0 * radius * np.array([k % 32, k // 32]))
    network = wr.RiverNetwork.from_polylines(lines, RING_WIDTH, closed=True, device=device, dtype=dtype)
    kinds = (wr.MeanderParams(spacing=RING_SPACING), wr.PathMeander(spacing=RING_SPACING))
    sims = [wr.Simulation(network, params, threads=1) for params in kinds]
    for sim in sims:
        for _ in range(RING_STEPS):
            sim.step()
    return sims[0], sims[1]


def compared(migration: wr.Simulation, path: wr.Simulation) -> dict:
    """Cost of a step of both, as a row of the result."""
    counts = [sim.network.point_count for sim in (migration, path)]
    cost = least((migration, path), max(3, 300_000 // counts[0]))
    per_point = [1e9 * c / n for c, n in zip(cost, counts, strict=True)]
    return {
        "points": counts[1],
        "migration_points": counts[0],
        "channels": path.network.channel_count,
        "migration_ns_per_point": per_point[0],
        "paths_ns_per_point": per_point[1],
        "ratio": per_point[1] / per_point[0],
        "bytes_per_point": path.stepper.state.nbytes / counts[1],
    }


def least(sims: tuple[wr.Simulation, ...], steps: int) -> list[float]:
    """Least seconds a step of each simulation, measured in turns."""
    best = [np.inf] * len(sims)
    for _ in range(ROUNDS):
        for k, sim in enumerate(sims):
            wp.synchronize_device(sim.device)
            begin = time.perf_counter()
            bench.advance(sim, steps)
            wp.synchronize_device(sim.device)
            best[k] = min(best[k], (time.perf_counter() - begin) / steps)
    return best


def search_cost(network: wr.RiverNetwork) -> dict:
    """Our sweep and scipy's search on the same graph, which a wide radius and no cone fill with shortcuts.

    Beside the sweep stands what a step does around it: grid, list of edges, sweep, loops cut off.
    """
    sim = wr.Simulation(network, wr.PathMeander(collision_distance=0.0, search_radius=4.0, cone_angle=90.0))
    state, network, device = sim.stepper.state, sim.network, sim.device
    (cutter,) = (phase for phase in sim.stepper.phases if isinstance(phase, TakeShortcuts))
    found, loops = cutter.shortcuts, cutter.loops
    count, start = network.point_count, network.starts()
    whole = sweep = np.inf
    state.assign(state.step, np.ones(network.channel_count))  # none is inactive
    for _ in range(ROUNDS + 1):
        state.begin_batch()
        wp.copy(state.point_moved, network.point_xy)
        wp.synchronize_device(device)
        begin = time.perf_counter()
        state.run(found.stages(state, cutter.route, cutter.cuts))
        wp.synchronize_device(device)
        middle = time.perf_counter()
        state.run(cutter.path_stages(state))
        wp.synchronize_device(device)
        after = time.perf_counter()
        state.run(loops.stages(state, cutter.cuts))
        wp.synchronize_device(device)
        if cutter.grow(state, state.read_status()):
            continue
        whole, sweep = min(whole, time.perf_counter() - begin), min(sweep, after - middle)
    links = found.count(state)
    pairs = np.stack([found.link_from.numpy()[:links], found.link_to.numpy()[:links]], axis=1)
    neighbours = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    neighbours = np.delete(neighbours, start[1:-1] - 1, axis=0)
    edges, xy = np.concatenate([neighbours, pairs]), network.points()
    begin = time.perf_counter()
    length = np.linalg.norm(xy[edges[:, 1]] - xy[edges[:, 0]], axis=1)
    graph = coo_array((length, edges.T), shape=(count, count)).tocsr()
    built, scipys = time.perf_counter() - begin, np.inf
    for _ in range(3):
        begin = time.perf_counter()
        # All channels in one search: from each point the way to its own head.
        distance = dijkstra(graph, indices=start[:-1], min_only=True)
        scipys = min(scipys, time.perf_counter() - begin)
    neck = cutter.point_neck.numpy()[:count]
    i = np.flatnonzero(neck >= 0)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    saved = (arc[neck[i]] - arc[i] - np.hypot(*(xy[neck[i]] - xy[i]).T)).sum()
    total = (arc[start[1:] - 1] - arc[start[:-1]]).sum()
    return {
        "points": count,
        "channels": network.channel_count,
        "shortcuts": links,
        "sweep_ms": 1e3 * sweep,
        "edges_sweep_and_cuts_ms": 1e3 * whole,
        "scipy_search_ms": 1e3 * scipys,
        "scipy_build_ms": 1e3 * built,
        "ratio": scipys / sweep,
        "length_difference": abs(total - saved - distance[start[1:] - 1].sum()) / total,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--dtype", default="float64", choices=("float64", "float32"))
    parser.add_argument("--quick", action="store_true", help="sizes up to 100,000 points")
    parser.add_argument("-o", "--out", help="JSON to write (default results/paths-DEVICE.json)")
    options = parser.parse_args()
    sizes = [10_000, 100_000] + [1_000_000] * (not options.quick)
    cases = [(n, CHANNEL_POINTS) for n in sizes] + [(1_000_000, 1_000_000)] * (not options.quick)
    heads = ("migration ns", "paths ns", "ratio", "shortcuts", "scipy/sweep")
    print(f"{'points':>9} {'channels':>8} " + " ".join(f"{head:>12}" for head in heads))
    rows = []
    for points, channel_points in cases:
        migration, path = both(points, channel_points, options.device, options.dtype)
        row = compared(migration, path)
        row["search"] = search_cost(path.network)
        seconds = bench.phase_seconds(path, steps=2 * ROUNDS)
        row["phases_ns_per_point"] = {name: 1e9 * cost / path.network.point_count for name, cost in seconds.items()}
        rows.append(row)
        print(
            f"{row['points']:>9} {row['channels']:>8} {row['migration_ns_per_point']:>12.1f} "
            f"{row['paths_ns_per_point']:>12.1f} "
            f"{row['ratio']:>12.2f} {row['search']['shortcuts']:>12} {row['search']['ratio']:>12.1f}"
        )
        print("   ns a point by phase: " + ", ".join(f"{k} {v:.1f}" for k, v in row["phases_ns_per_point"].items()))
    rings = [compared(*noisy_rings(points, options.device, options.dtype)) for points in sizes]
    for row in rings:
        print(
            f"{row['points']:>9} {row['channels']:>8} {row['migration_ns_per_point']:>12.1f} "
            f"{row['paths_ns_per_point']:>12.1f} {row['ratio']:>12.2f}  rings"
        )
    many = [r for r in rows if r["channels"] > 1]
    counts, costs = [r["points"] for r in many], [r["points"] * r["paths_ns_per_point"] for r in many]
    slope = float(np.polyfit(np.log(counts), np.log(costs), 1)[0])
    print(f"cost grows as points^{slope:.3f}")
    result = {
        "benchmark": "paths",
        "dtype": options.dtype,
        "machine": machine(options.device, ("scipy",)),
        "sizes": rows,
        "rings": rings,
        "exponent": slope,
    }
    write_result(result, options.out, f"paths-{options.device.split(':')[0]}")


if __name__ == "__main__":
    sys.exit(main())
