"""What a synthetic valley costs: S1 to S6 at the paper's resolution, and a raster of S6 against its cells.

The peer is what the paper does by hand, in the same run: its points, triangulated and interpolated onto the same raster
(SciPy's LinearNDInterpolator).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
from machine import forget_peak, in_child, machine, memory_status, write_result

import warpriver as wr
from warpriver.bench import min_seconds

NAMES = ("S1", "S2", "S3", "S4", "S5", "S6")
# Spacing of the paper's points across the channel, m.
SPACING = 0.1
# The square of S6 that rasters cover, m.
SQUARE = (0.0, -1000.0, 2000.0, 1000.0)
ROUNDS = 5


def make(name: str, device: str) -> None:
    """All that a valley has: layout, network, covariance, and its points at the paper's resolution."""
    valley = wr.synthetic_valley(name, device=device)
    valley.grid(SPACING), valley.network, valley.covariance


def measure_examples(device: str) -> list[dict]:
    """Points and seconds of each example, and of its default raster."""
    rows = []
    for name in NAMES:
        valley = wr.synthetic_valley(name, device=device)
        points, cells = len(valley.grid(SPACING).points()), math.prod(valley.terrain.shape)
        rows.append(
            {
                "example": name,
                "points": points,
                "seconds": min_seconds(lambda name=name: make(name, device), rounds=ROUNDS, device=device),
                "raster_cells": cells,
                "raster_seconds": min_seconds(lambda v=valley: v.raster(v.cell_size), rounds=ROUNDS, device=device),
            }
        )
        r = rows[-1]
        print(
            f"{name}: {points:>7} points {r['seconds']:.4f} s; raster {cells:>7} cells {r['raster_seconds']:.4f} s",
            flush=True,
        )
    return rows


def measure_rasters(sizes: list[int], device: str) -> list[dict]:
    """Nanoseconds a cell of square rasters of S6."""
    valley, rows = wr.synthetic_valley("S6", device=device), []
    for size in sizes:
        cell = (SQUARE[2] - SQUARE[0]) / size
        rounds = ROUNDS if size <= 2000 else 3
        spent = min_seconds(lambda cell=cell: valley.raster(cell, SQUARE), rounds=rounds, device=device)
        rows.append({"size": size, "seconds": spent, "ns_per_cell": 1e9 * spent / size**2})
        print(f"S6, {size} x {size} cells: {spent:.3f} s, {rows[-1]['ns_per_cell']:.1f} ns a cell", flush=True)
    return rows


def measure_peer() -> dict:
    """S3 by triangulation of its points, against our raster of the same cells; and how far both lie apart."""
    from scipy.interpolate import LinearNDInterpolator

    valley = wr.synthetic_valley("S3")
    points = valley.grid(0.5).points()
    west, north = valley.terrain.origin
    rows, columns = valley.terrain.shape
    size = valley.terrain.cell_size
    x, y = np.meshgrid(west + (np.arange(columns) + 0.5) * size, north - (np.arange(rows) + 0.5) * size)
    begin = time.perf_counter()
    height = LinearNDInterpolator(points[:, :2], points[:, 2])(x, y)
    peer = time.perf_counter() - begin
    own = min_seconds(lambda: valley.raster(size), rounds=ROUNDS)
    difference = np.abs(height - valley.raster(size).to_numpy())
    result = {
        "points": len(points),
        "cells": rows * columns,
        "seconds": peer,
        "ratio": peer / own,
        "median_difference_m": float(np.nanmedian(difference)),
    }
    print(f"triangulation of {len(points)} points onto {rows * columns} cells: {peer:.2f} s, x {result['ratio']:.0f}")
    return result


def measure_memory(size: int) -> None:
    """Print the peak of bytes a cell of a raster of S6; for a process of its own."""
    valley = wr.synthetic_valley("S6")
    valley.raster(40.0)
    forget_peak()
    before = memory_status("VmRSS")
    valley.raster((SQUARE[2] - SQUARE[0]) / size, SQUARE)
    print(json.dumps((memory_status("VmHWM") - before) / size**2))


def memory(sizes: list[int]) -> dict[int, float] | None:
    """Peak bytes a cell by size; None where the system does not tell."""
    if not forget_peak():
        return None
    found = {size: in_child(__file__, "--measure-memory", size) for size in sizes}
    print("peak bytes a cell: " + ", ".join(f"{size}: {used:.1f}" for size, used in found.items()))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--quick", action="store_true", help="rasters up to 1000 x 1000")
    parser.add_argument("-o", "--out", help="JSON to write (default results/valley-DEVICE.json)")
    parser.add_argument("--measure-memory", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure_memory:
        measure_memory(options.measure_memory)
        return
    sizes = [500, 1000] if options.quick else [500, 1000, 2000, 4000]
    result = {
        "benchmark": "valley",
        "machine": machine(options.device, ("scipy",)),
        "spacing_m": SPACING,
        "examples": measure_examples(options.device),
        "rasters": measure_rasters(sizes, options.device),
        "triangulation": measure_peer(),
        "peak_bytes_per_cell": memory(sizes[1:]),
    }
    write_result(result, options.out, f"valley-{options.device.split(':')[0]}")


if __name__ == "__main__":
    main()
