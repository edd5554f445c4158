"""What a step costs: against points, by phase, by threads, in memory, and beside meanderpy on the same line."""

from __future__ import annotations

import argparse
import itertools
import os
import sys

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
import roofline
import warp as wp
from machine import (
    baseline,
    cores,
    forget_peak,
    in_child,
    machine,
    memory_status,
    say_baseline,
    triad,
    write_result,
)

import warpriver as wr
from warpriver import bench
from warpriver.hydraulic_geometry import bankfull_depth

CHANNEL_POINTS = 1000
SHORT, LONG = 300, 1_000_000
# What is switched on, and which phases of the roofline table that takes.
VARIANTS = {
    "migration": ({"cutoffs": False, "collisions": False}, ("migrate", "resample")),
    "cutoffs": ({"cutoffs": True, "collisions": False}, ("migrate", "cut off", "resample")),
    "full": ({"cutoffs": True, "collisions": True}, ("migrate", "cut off", "resample", "collide")),
}
HEADS = ("ms/step", "ns/point", "x triad", "x roofline", "cuts/step", "B/point")


def row(case: str, asked: int, channels: int, variant: str, options: argparse.Namespace, threads: int = 1) -> dict:
    """Cost of a step of a network of about so many points, as one row of the result."""
    switches, _ = VARIANTS[variant]
    sim = bench.synthetic_network(
        asked, channels, device=options.device, dtype=options.dtype, threads=threads, **switches
    )
    cost = bench.step_cost(sim)
    found = {"case": case, "asked_points": asked, "variant": variant, "threads": sim.threads} | cost
    found |= compared(found, options, triad(max(1000, cost["points"])))
    print_row(found)
    return found


def compared(found: dict, options: argparse.Namespace, triad_ns: float) -> dict:
    """A row's cost as multiples of what the memory of this machine does."""
    speed = baseline(options.device)
    bandwidth = speed["copy_bytes_per_second" if found["threads"] == 1 else "copy_all_bytes_per_second"]
    shape = {"channel_points": found["points"] / found["channels"]}
    if not wp.get_device(options.device).is_cpu:
        bandwidth = speed["copy_bytes_per_second"]
        shape["chunk_points"] = roofline.CHUNK_POINTS
    phases = roofline.phase_bytes(options.dtype, **shape)
    moved = sum(phases[name] for name in VARIANTS[found["variant"]][1])
    return {
        "triad_ns_per_point": triad_ns,
        "ratio_to_triad": found["ns_per_point"] / triad_ns,
        "roofline_bytes_per_point": moved,
        "ratio_to_roofline": 1e-9 * found["ns_per_point"] * bandwidth / moved,
        "copies_of_points": bench.copies_of_points(
            1e-3 * found["ms_per_step"], found["points"], options.dtype, bandwidth
        ),
    }


def print_row(r: dict) -> None:
    print(
        f"{r['case']:>18} {r['variant']:>9} {r['threads']:>3} {r['points']:>9} {r['channels']:>8} "
        f"{r['ms_per_step']:>10.4f} {r['ns_per_point']:>10.1f} {r['ratio_to_triad']:>10.1f} "
        f"{r['ratio_to_roofline']:>10.1f} {r['cutoffs_per_step']:>10.3f} {r['bytes_per_point']:>10.0f}",
        flush=True,
    )


def measure_threads(asked: int, options: argparse.Namespace) -> list[dict]:
    """The same steps by one thread, two and one for each core.

    Raises:
        RuntimeError: The results are not the same bits.
    """
    rows, reached = [], []
    for threads in sorted({1, min(2, cores()), cores()}):
        sim = bench.synthetic_network(asked, max(1, asked // CHANNEL_POINTS), dtype=options.dtype, threads=threads)
        for _ in range(5):
            sim.step()
        reached.append(sim.network.points())
        if not np.array_equal(reached[0], reached[-1]):
            raise RuntimeError(f"{threads} threads give other bits than one")
        cost = bench.step_cost(sim)
        rows.append({"case": "threads", "asked_points": asked, "variant": "full", "threads": threads} | cost)
        rows[-1] |= compared(rows[-1], options, triad(cost["points"]))
        rows[-1]["speedup"] = rows[0]["ms_per_step"] / rows[-1]["ms_per_step"]
        print_row(rows[-1])
    return rows


def phase_rows(asked: int, options: argparse.Namespace) -> list[dict]:
    """Cost of each phase of a full step by one thread, and what its kernels have to move."""
    channels = max(1, asked // CHANNEL_POINTS)
    sim = bench.synthetic_network(asked, channels, device=options.device, dtype=options.dtype, threads=1)
    steps = max(5, min(200, 2_000_000 // asked))
    seconds = bench.phase_seconds(sim, steps=steps)
    chunk_points = np.inf if wp.get_device(options.device).is_cpu else roofline.CHUNK_POINTS
    channel_points = sim.network.point_count / channels
    moved = roofline.phase_bytes(options.dtype, channel_points=channel_points, chunk_points=chunk_points)
    bandwidth = baseline(options.device)["copy_bytes_per_second"]
    rows = []
    for name, cost in seconds.items():
        ns = 1e9 * cost / sim.network.point_count
        rows.append({"case": "phase", "asked_points": asked, "phase": name, "ns_per_point": ns})
        if name in moved:
            rows[-1]["roofline_bytes_per_point"] = moved[name]
            rows[-1]["ratio_to_roofline"] = 1e-9 * ns * bandwidth / moved[name]
    print(f"ns a point by phase, {asked} points: " + ", ".join(f"{r['phase']} {r['ns_per_point']:.1f}" for r in rows))
    return rows


# ---- memory


def measure_memory(asked: int, options: argparse.Namespace) -> dict:
    """What a simulation of so many points adds to this process, bytes a point; to be run in a process of its own."""
    for _ in range(2):  # kernels and the river that others are cut from
        bench.synthetic_network(3000, 3, device=options.device, dtype=options.dtype).step()
    fresh, before = forget_peak(), memory_status("VmRSS")
    sim = bench.synthetic_network(asked, max(1, asked // CHANNEL_POINTS), device=options.device, dtype=options.dtype)
    made = memory_status("VmHWM")
    forget_peak()
    for _ in range(3):
        sim.step()
    stepped, points = memory_status("VmHWM"), sim.network.point_count
    found = {"case": "memory", "asked_points": asked, "points": points}
    found["bytes_per_point"] = bench.device_bytes(sim) / points
    if fresh and before and made and stepped:
        found["making_peak_bytes_per_point"] = (made - before) / points
        found["stepping_peak_bytes_per_point"] = (stepped - before) / points
    return found


def memory_row(asked: int, options: argparse.Namespace) -> dict:
    """Memory at one size, measured in a child process, so that the peak is that of this size alone."""
    arguments = ("--measure-memory", asked, "--device", options.device, "--dtype", options.dtype)
    found = in_child(__file__, *arguments)
    peaks = [found.get(f"{name}_peak_bytes_per_point", float("nan")) for name in ("making", "stepping")]
    print(
        f"memory, {found['points']} points: {found['bytes_per_point']:.0f} bytes a point in device arrays; "
        f"process at most {peaks[0]:.0f} while made, {peaks[1]:.0f} while stepped",
        flush=True,
    )
    return found


# ---- peer


def meanderpy_row(points: int, dtype: str) -> dict | None:
    """Cost of a step of meanderpy and of ours on the same centreline; None where meanderpy is not installed."""
    try:
        from meanderpy import meanderpy
    except ImportError:
        return None
    width, spacing = bench.WIDTH, bench.SPACING
    line = bench.cut_lines([points])[0]
    depth = float(bankfull_depth(width))
    rate, step, padding = 60.0 / (365.25 * 86400.0), 106.0 * 86400.0, (20, 5)
    *_, arc = meanderpy.compute_derivatives(line[:, 0], line[:, 1], np.zeros(len(line)))

    def peer() -> None:
        """What the body of its main loop does; it edits its arguments, so each call starts from a copy."""
        x, y, z = line[:, 0].copy(), line[:, 1].copy(), np.zeros(len(line))
        x, y = meanderpy.migrate_one_step(
            x, y, z, width, rate, step, 1.0, 0.011, depth, *padding, deltas=spacing, cfl_factor=0.5
        )
        x, y, z, *_ = meanderpy.cut_off_cutoffs(x, y, z, arc, width, spacing)
        meanderpy.resample_centerline(x, y, z, spacing)

    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=width, dtype=dtype), threads=1)
    peer()  # compiles its numba functions, if any
    ours = 1e-3 * bench.step_cost(sim)["ms_per_step"]
    theirs = bench.min_seconds(peer, max(1, 3000 // points), 5)
    print(f"{points} points: meanderpy {1e3 * theirs:.3g} ms, ours {1e3 * ours:.3g} ms, x{theirs / ours:.0f}")
    return {
        "case": "meanderpy", "asked_points": points, "meanderpy_ms": 1e3 * theirs, "ours_ms": 1e3 * ours,
        "ratio": theirs / ours,
    }  # fmt: skip


def fit_exponent(rows: list[dict], variant: str) -> float | None:
    """Exponent p of cost ~ points^p over the sizes that hold several channels; None for fewer than two."""
    chosen = [
        r for r in rows if r["case"] == "1000 a channel" and r["variant"] == variant and r["asked_points"] > 5_000
    ]
    if len(chosen) < 2:
        return None
    return float(np.polyfit(*(np.log([r[k] for r in chosen]) for k in ("points", "ms_per_step")), 1)[0])


def measure_all(sizes: list[int], options: argparse.Namespace) -> dict:
    """All figures."""
    is_cpu = wp.get_device(options.device).is_cpu
    print(say_baseline(baseline(options.device)))
    print(f"{'case':>18} {'on':>9} {'thr':>3} {'points':>9} {'channels':>8} " + " ".join(f"{h:>10}" for h in HEADS))
    rows = []
    for size, variant in itertools.product(sizes, VARIANTS):
        rows.append(row("1000 a channel", size, max(1, size // CHANNEL_POINTS), variant, options))
    # In one channel: few points, where a step is launches, and many, where it is one recurrence.
    for size in [SHORT] + [n for n in (min(LONG, max(sizes)),) if n > CHANNEL_POINTS]:
        rows.append(row("one channel", size, 1, "cutoffs", options))
    middle = min(LONG, max(sizes))
    if is_cpu:
        rows += measure_threads(middle, options)
    for size in sorted({min(10_000, middle), middle}):
        rows += phase_rows(size, options)
    rows += [memory_row(size, options) for size in sizes]
    if is_cpu:
        peers = (SHORT, 1_000, 3_000) if options.quick else (SHORT, 1_000, 3_000, 10_000)
        rows += [r for r in (meanderpy_row(n, options.dtype) for n in peers) if r is not None]
    exponents = {variant: fit_exponent(rows, variant) for variant in VARIANTS}
    known = [f"{p:.3f} ({variant})" for variant, p in exponents.items() if p is not None]
    if known:
        print(f"cost grows as points^p, p = {', '.join(known)}")
    return {"rows": rows, "exponents": exponents}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("--dtype", default="float64", choices=("float64", "float32"), help="default float64")
    parser.add_argument("--quick", action="store_true", help="sizes up to 100,000 points")
    parser.add_argument("--full", action="store_true", help="sizes up to 10 million points; takes some 12 GB")
    parser.add_argument("--points", metavar="N,N...", help="sizes, instead of 1,000 to 1,000,000")
    parser.add_argument("-o", "--out", help="JSON to write (default results/step-DEVICE.json; -float32)")
    parser.add_argument("--measure-memory", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure_memory:
        import json

        print(json.dumps(measure_memory(options.measure_memory, options)))
        return
    top = 5 if options.quick else 7 if options.full else 6
    sizes = [int(n) for n in options.points.split(",")] if options.points else [10**k for k in range(3, top + 1)]
    result = {
        "benchmark": "step",
        "dtype": options.dtype,
        "machine": machine(options.device, ("meanderpy",)),
        "baseline": baseline(options.device),
        **measure_all(sizes, options),
    }
    suffix = "" if options.dtype == "float64" else f"-{options.dtype}"
    write_result(result, options.out, f"step-{options.device.split(':')[0]}{suffix}")


if __name__ == "__main__":
    sys.exit(main())
