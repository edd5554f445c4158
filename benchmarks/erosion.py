"""What an event of Leheny's erosion costs: one by one beside a numba loop, in batches, and on many grids at once.

One by one is work for the CPU, whatever the device.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
import warp as wp
from machine import baseline, machine, write_result

import warpriver as wr

PAGE = (200, 300)
BIAS, DEPTH, THRESHOLD = 0.05, 10.0, 2000.0


def numba_loop() -> Callable[[np.ndarray, int, int], int] | None:
    """The model as one would write it with numba, on a plane periodic across columns; None where it is missing."""
    try:
        from numba import njit
    except ImportError:
        return None
    row_step, column_step = np.array([-1, -1, 0, 1, 1, 1, 0, -1]), np.array([0, 1, 1, 1, 0, -1, -1, -1])

    @njit
    def erode(height: np.ndarray, events: int, seed: int) -> int:
        """Erode in place; returns the number of slides."""
        np.random.seed(seed)  # noqa: NPY002  (numba has no other)
        rows, columns = height.shape
        way, waiting = np.empty(height.size, np.int64), np.zeros(height.size, np.uint8)
        weight, beside = np.empty(8), np.empty(8, np.int64)
        slides = 0
        for _ in range(events):
            cell, size = np.random.randint(height.size), 0  # noqa: NPY002
            while True:
                way[size] = cell
                size += 1
                row, column = cell // columns, cell % columns
                if row == rows - 1:
                    break
                count, steepest = 0, 0.0
                for k in range(8):
                    i, j = row + row_step[k], (column + column_step[k]) % columns
                    if i >= 0:
                        fall = height[row, column] - height[i, j]
                        if fall > 0.0:
                            weight[count], beside[count] = fall, i * columns + j
                            count += 1
                            steepest = max(steepest, fall)
                total = 0.0
                for k in range(count):
                    weight[k] = math.exp(BIAS * (weight[k] - steepest))
                    total += weight[k]
                rest, chosen = np.random.random() * total - weight[0], 0  # noqa: NPY002
                while rest >= 0.0 and chosen < count - 1:
                    chosen += 1
                    rest -= weight[chosen]
                cell = beside[chosen]
            for k in range(size):
                height[way[k] // columns, way[k] % columns] -= DEPTH
                waiting[way[k]] = 1
            while size > 0:
                size -= 1
                cell = way[size]
                waiting[cell] = 0
                row, column = cell // columns, cell % columns
                for k in range(8):
                    i, j = row + row_step[k], (column + column_step[k]) % columns
                    if 0 <= i < rows and height[i, j] - height[row, column] > THRESHOLD:
                        while height[i, j] - height[row, column] > THRESHOLD:
                            height[i, j] -= (height[i, j] - height[row, column]) / 4.0
                            slides += 1
                        if waiting[i * columns + j] == 0:
                            waiting[i * columns + j] = 1
                            way[size] = i * columns + j
                            size += 1
        return slides

    erode(wr.generate.erosion_plane((8, 8)).to_numpy(), 10, 0)
    return erode


def seconds(call: Callable[[], object], rounds: int, device: str) -> float:
    """Least time of one call."""
    best = math.inf
    for _ in range(rounds):
        wp.synchronize_device(device)
        begin = time.perf_counter()
        call()
        wp.synchronize_device(device)
        best = min(best, time.perf_counter() - begin)
    return best


def row(mode: str, shape: tuple[int, int], events: int, cost: float, grids: int = 1, batch: int = 1) -> dict:
    """One line of the table."""
    print(
        f"{mode:>10} {shape[1]:>5} x {shape[0]:<5} {events:>8} {grids:>5} {batch:>6} {cost:>9.3f} "
        f"{1e-3 * grids * events / cost:>10.1f}"
    )
    return {
        "mode": mode, "rows": shape[0], "columns": shape[1], "events": events, "grids": grids, "batch": batch,
        "seconds": cost, "events_per_second": grids * events / cost,
    }  # fmt: skip


def measure(options: argparse.Namespace) -> dict:
    """All figures."""
    peer, device = numba_loop(), options.device
    if peer is None:
        print('numba is missing (pip install "warpriver[bench]"): no peer', file=sys.stderr)
    plane = wr.generate.erosion_plane(PAGE, device=device)
    wr.erode(plane, events=2)
    wr.erode(plane, events=4, batch=2)
    print(f"{'mode':>10} {'cells':>13} {'events':>8} {'grids':>5} {'batch':>6} {'s':>9} {'1000 ev/s':>10}")
    rows = []
    for events in (5_000, 10_000, 20_000, 40_000):
        rows.append(row("serial", PAGE, events, seconds(lambda n=events: wr.erode(plane, events=n, seed=1), 5, device)))
        if peer is not None:
            cost = seconds(lambda n=events: peer(plane.to_numpy(), n, 1), 5, "cpu")
            rows.append(row("numba", PAGE, events, cost))
    serial = [r for r in rows if r["mode"] == "serial"]
    exponent = np.polyfit(np.log([r["events"] for r in serial]), np.log([r["seconds"] for r in serial]), 1)[0]
    flat = wr.LehenyParams(slide_threshold=1e9)
    walks = [seconds(lambda n=n: wr.erode(plane, flat, events=n, seed=1), 5, device) for n in (10_000, 40_000)]
    grids = 16 if options.quick else 64
    cost = seconds(lambda: wr.erosion.erode_ensemble(plane, events=10_000, seeds=range(grids)), 1, device)
    rows.append(row("ensemble", PAGE, 10_000, cost, grids=grids))
    side, events = (512, 50_000) if options.quick else (1024, 200_000)
    large = wr.generate.erosion_plane((side, side), device=device)
    rows.append(row("serial", large.shape, events, seconds(lambda: wr.erode(large, events=events, seed=1), 1, device)))
    for batch in (256, 1024, 4096):
        cost = seconds(lambda b=batch: wr.erode(large, events=events, seed=1, batch=b), 1, device)
        rows.append(row("batched", large.shape, events, cost, batch=batch))
    if peer is not None:
        rows.append(row("numba", large.shape, events, seconds(lambda: peer(large.to_numpy(), events, 1), 1, "cpu")))
    page = {r["mode"]: r["seconds"] for r in rows if r["rows"] == PAGE[0] and r["events"] == 10_000}
    ratio = page["serial"] / page["numba"] if "numba" in page else None
    if ratio is not None:
        print(f"serial over numba, {PAGE[1]} x {PAGE[0]}, 10,000 events: {ratio:.2f}")
    walk_exponent = math.log(walks[1] / walks[0]) / math.log(4.0)
    print(f"cost grows as events^{exponent:.3f}; without slides as events^{walk_exponent:.3f}")
    return {"rows": rows, "serial_over_numba": ratio, "exponent": exponent, "exponent_without_slides": walk_exponent}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--quick", action="store_true", help="16 grids, and 512 x 512 cells with 50,000 events")
    parser.add_argument("-o", "--out", help="JSON to write (default results/erosion-DEVICE.json)")
    options = parser.parse_args()
    result = {
        "benchmark": "erosion",
        "machine": machine(options.device, ("numba",)),
        "baseline": baseline(options.device),
        **measure(options),
    }
    write_result(result, options.out, f"erosion-{options.device.split(':')[0]}")


if __name__ == "__main__":
    sys.exit(main())
