"""What animated water costs: the document's three reaches, queries of its surface, and a network of 193 km.

Times are those of the processor, on one core: they hold beside other work. Figures of Peytavie et al. (2019) stand
beside them: Table 1 (CPU, 4 GHz) and Table 2.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
import warp as wp
from machine import machine

from warpriver.riverscape import Course, CourseMap, Riverscape, Water, example, primitives, seed_water

# Of the document: primitives of the water, ms to generate bed and water, side of the grid, ms for both on it.
TABLE = {"A": (520, 12.0, 512, 617.0), "C": (754, 13.0, 512, 583.0), "D": (1270, 38.0, 1024, 3480.0)}
DETAIL = 0.5
# Of the rounds of one figure, s.
LONGEST = 3.0


def seconds(call: Callable[[], object], rounds: int) -> float:
    """Least time of one call, of the processor; after a few seconds further rounds are left out."""
    best, stop = math.inf, time.perf_counter() + LONGEST
    for k in range(rounds):
        begin = time.process_time()
        call()
        wp.synchronize()
        best = min(best, time.process_time() - begin)
        if k and time.perf_counter() > stop:
            break
    return best


def measure_scene(name: str, device: str, rounds: int) -> dict:
    """Counts and times of one of the three reaches."""
    count, told_made, side, told_queries = TABLE[name]
    made = example(name)

    def generate() -> tuple[Riverscape, Water]:
        scene = Riverscape(made.terrain, made.courses, rocks=made.rocks, detail=DETAIL, device=device)
        # Bed and water.
        _ = scene.rivers.beds
        return scene, scene.water_surface

    scene, water = generate()
    beds = scene.rivers.beds
    west, south, east, north = made.terrain.raster.bounds
    cell = max(east - west, north - south) / side
    grid = water.on_grid((west, north), cell, (side, side), 1.0)
    # The water alone: that many places, all of them in it, row by row.
    low, high = water.bounds[:2], water.bounds[2:]
    fine = np.random.default_rng(0).uniform(low, high, (10 * side * side, 2))
    wet = fine[water.at(fine, 1.0).weight > 0.0][: side * side]
    wet = wet[np.lexsort((wet[:, 0], np.floor(wet[:, 1] / 0.1)))]
    row = {
        "scene": name,
        "primitives": len(water.primitives),
        "primitives_table_1": count,
        "bytes_per_primitive": water.bytes_per_primitive,
        "generate_ms": 1e3 * seconds(generate, rounds),
        "generate_ms_table_1": told_made,
        "queries": 2 * side * side,
        "bed_ms": 1e3 * seconds(lambda: beds.raster(cell, west, north, (side, side)), rounds),
        "water_ms": 1e3 * seconds(lambda: water.on_grid((west, north), cell, (side, side), 1.0), rounds),
        "wet_share": float((grid.weight.numpy() > 0.0).mean()),
        "both_ms_table_1": told_queries,
        "wet_queries_per_us": len(wet) / 1e6 / seconds(lambda: water.at(wet, 1.0), rounds),
    }
    print(
        f"{name}: {row['primitives']} primitives ({count}), made in {row['generate_ms']:.1f} ms ({told_made}), bed "
        f"{row['bed_ms']:.0f} + water {row['water_ms']:.0f} ms for 2 x {side}^2 ({told_queries:.0f}); all wet "
        f"{row['wet_queries_per_us']:.1f} M queries/s",
        flush=True,
    )
    return row


def measure_leaves(device: str, rounds: int) -> list[dict]:
    """Queries a second on water everywhere, by kind and noise: about three primitives at a place."""
    x, y = np.meshgrid(np.arange(0.0, 40.0, 0.5), np.arange(0.0, 40.0, 0.5))
    center = np.column_stack([x.ravel(), y.ravel()])
    rows = []
    for noise in ("baked", "exact"):
        for kind in ("calm", "turbulent", "cascade", "vortex"):
            leaves = primitives(
                kind, center, 0.5, 5.0, velocity=(0.8, 0.1), amplitude=0.02, wavelength=0.4, height=0.1, shear=1.0
            )
            water = Water(leaves, cell_size=0.5, noise=noise, device=device)
            call = lambda water=water: water.on_grid((0.0, 40.0), 40.0 / 512, (512, 512), 1.0)  # noqa: E731
            call()
            rows.append({"kind": kind, "noise": noise, "queries_per_us": 512**2 / 1e6 / seconds(call, rounds)})
            print(f"{kind:>10} {noise}: {rows[-1]['queries_per_us']:.1f} M queries/s", flush=True)
    return rows


def measure_network(kilometres: int, device: str) -> dict:
    """Seconds to make the water of a network of meandering reaches of 1 km each, 7 m wide."""
    side = math.ceil(math.sqrt(kilometres))
    courses = []
    for k in range(kilometres):
        s = np.linspace(0.0, 1000.0, 501)
        angle = 1.1 * np.sin(2.0 * np.pi * s / 110.0 + k)
        step = 2.0 * np.column_stack([np.cos(angle), np.sin(angle)])
        xy = np.cumsum(step, axis=0) + (1700.0 * (k % side), 1700.0 * (k // side))
        courses.append(Course(xy, 500.0 - 0.006 * s, 7.0, 0.5, 0.55, "C"))
    begin = time.process_time()
    mapped = CourseMap(courses, device=device)
    tree = seed_water(mapped, 0.75, 0)
    seeded = time.process_time()
    water = Water(tree, device=device)
    end = time.process_time()
    row = {
        "kilometres": kilometres,
        "primitives": len(water.primitives),
        "seed_seconds": seeded - begin,
        "compile_seconds": end - seeded,
        "seconds_table_2": 227.0,
        "kilometres_table_2": 193.1,
        "primitives_table_2": 1_505_000,
    }
    print(
        f"{kilometres} km: {row['primitives']} primitives, seeded in {row['seed_seconds']:.1f} s, compiled in "
        f"{row['compile_seconds']:.1f} s (the document, with terrain: 227 s for 193 km)",
        flush=True,
    )
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("--quick", action="store_true", help="fewer rounds, and a network of 10 km in place of 193")
    parser.add_argument("-o", "--out", type=Path, help="JSON to write (default results/riverscape-DEVICE.json)")
    options = parser.parse_args()
    out = options.out or Path(__file__).parent / "results" / f"riverscape-{options.device.replace(':', '')}.json"
    rounds = 3 if options.quick else 15
    out.parent.mkdir(parents=True, exist_ok=True)
    parts: dict[str, Callable[[], object]] = {
        "scenes": lambda: [measure_scene(name, options.device, rounds) for name in TABLE],
        "network": lambda: measure_network(10 if options.quick else 193, options.device),
        "leaves": lambda: measure_leaves(options.device, rounds),
    }
    result: dict[str, object] = {"benchmark": "riverscape", "machine": machine(options.device)}
    # What is known so far is kept, so that nothing is lost if the rest takes too long.
    for name, measure in parts.items():
        result[name] = measure()
        out.write_text(json.dumps(result, indent=2) + "\n")
    print(f"written to {out}")


if __name__ == "__main__":
    main()
