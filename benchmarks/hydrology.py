"""What routing costs: fill, carve, D8 and multiple flow on one core, beside RichDEM and fastscapelib in one run."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
from machine import baseline, forget_peak, in_child, machine, memory_status, write_result

from warpriver import hydrology
from warpriver.terrain import Terrain

CELL = 10.0
# Spectral exponents of the height: the higher, the smoother, and the fewer pits.
TERRAINS = {"rough": 3.0, "smooth": 4.0}
PEERS = ("richdem", "fastscapelib")


def fractal(size: int, exponent: float) -> np.ndarray:
    """Heights with a power-law spectrum, 1,000 to 1,200 m."""
    wave = np.hypot(np.fft.rfftfreq(size)[None], np.fft.fftfreq(size)[:, None])
    wave[0, 0] = 1.0
    noise = np.fft.rfft2(np.random.default_rng(0).standard_normal((size, size)))
    height = np.fft.irfft2(noise * wave ** (-exponent / 2.0), (size, size))
    return 1000.0 + 200.0 * (height - height.min()) / np.ptp(height)


def seconds(call: Callable[[], object], rounds: int) -> float:
    """Least time of one call."""
    best = math.inf
    for _ in range(rounds):
        begin = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begin)
    return best


def ours(height: np.ndarray, rounds: int) -> dict[str, float]:
    """Seconds of each of our calls."""
    terrain = Terrain(height, CELL)
    filled = hydrology.fill_depressions(terrain)
    return {
        "fill": seconds(lambda: hydrology.fill_depressions(terrain), rounds),
        "carve": seconds(lambda: hydrology.carve_depressions(terrain), rounds),
        "d8": seconds(lambda: hydrology.drainage_area(filled), rounds),
        "mfd": seconds(lambda: hydrology.drainage_area(filled, method="mfd"), rounds),
    }


@contextlib.contextmanager
def without_stderr() -> Iterator[None]:
    """Swallow progress bars that a library writes past Python."""
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)


def richdem(height: np.ndarray, rounds: int) -> dict[str, float] | None:
    """Seconds of RichDEM's calls; None where it is not installed."""
    try:
        import richdem as rd
    except ImportError:
        return None

    def raster() -> object:
        array = rd.rdarray(height.copy(), no_data=-9999.0)
        array.geotransform = (0.0, CELL, 0.0, 0.0, 0.0, -CELL)
        return array

    times = {"fill": math.inf, "d8": math.inf, "mfd": math.inf}
    with without_stderr():
        for _ in range(rounds):
            filled = raster()
            times["fill"] = min(times["fill"], seconds(lambda f=filled: rd.FillDepressions(f, True, True), 1))
            times["d8"] = min(times["d8"], seconds(lambda f=filled: rd.FlowAccumulation(f, method="D8"), 1))
            freeman = lambda f=filled: rd.FlowAccumulation(f, method="Freeman", exponent=1.1)  # noqa: E731
            times["mfd"] = min(times["mfd"], seconds(freeman, 1))
    return times


def fastscapelib(height: np.ndarray, rounds: int) -> dict[str, float] | None:
    """Seconds of fastscapelib's; it fills and routes in one call, so "d8" and "mfd" hold the fill. None if missing."""
    try:
        import fastscapelib as fs
    except ImportError:
        return None
    grid = fs.RasterGrid(list(height.shape), [CELL, CELL], fs.NodeStatus.FIXED_VALUE)

    def run(router: object) -> None:
        graph = fs.FlowGraph(grid, [fs.PFloodSinkResolver(), router])
        graph.update_routes(height.copy())
        graph.accumulate(1.0)

    return {
        "fill": 0.0,
        "d8": seconds(lambda: run(fs.SingleFlowRouter()), rounds),
        "mfd": seconds(lambda: run(fs.MultiFlowRouter(1.1)), rounds),
    }


def measure_memory(size: int) -> None:
    """Print the peak of bytes a cell of each call, the terrain included; for a process of its own."""
    hydrology.drainage_area(hydrology.carve_depressions(Terrain(np.eye(8), CELL)), method="mfd")
    terrain = Terrain(np.random.default_rng(0).random((size, size)), CELL)
    filled = hydrology.fill_depressions(Terrain(terrain.to_numpy(), CELL))
    calls = {
        "fill": lambda: hydrology.fill_depressions(terrain),
        "carve": lambda: hydrology.carve_depressions(terrain),
        "d8": lambda: hydrology.drainage_area(filled),
        "mfd": lambda: hydrology.drainage_area(filled, method="mfd"),
    }
    peaks = {}
    for name, call in calls.items():
        forget_peak()
        before = memory_status("VmRSS")
        call()
        peaks[name] = 8.0 + (memory_status("VmHWM") - before) / size**2
    print(json.dumps(peaks))


def memory(size: int) -> dict[str, float] | None:
    """Peak bytes a cell of each call; None where the system does not tell."""
    return in_child(__file__, "--measure-memory", size) if forget_peak() else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="up to 1024 x 1024 cells")
    parser.add_argument("-o", "--out", help="JSON to write (default results/hydrology.json)")
    parser.add_argument("--measure-memory", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure_memory:
        measure_memory(options.measure_memory)
        return
    sizes = [512, 1024] if options.quick else [1024, 2048, 4096]
    rows = []
    print(
        f"{'terrain':>8} {'cells':>6} {'by':>13} " + " ".join(f"{h:>9}" for h in ("fill+D8 s", "fill+MFD s", "carve s"))
    )
    for name, exponent in TERRAINS.items():
        for size in sizes:
            height, rounds = fractal(size, exponent), max(1, 4096 // size)
            found = {"warpriver": ours(height, rounds)}
            found |= {peer: globals()[peer](height, rounds) for peer in PEERS}
            for by, times in found.items():
                if times:
                    rows.append({"terrain": name, "size": size, "by": by, "seconds": times})
                    print_row(rows[-1])
    used = memory(sizes[-1])
    if used:
        print("peak bytes a cell, terrain included: " + ", ".join(f"{k} {v:.0f}" for k, v in used.items()))
    own = [r for r in rows if r["by"] == "warpriver"]
    total = [r["seconds"]["fill"] + r["seconds"]["mfd"] for r in own]
    slope = np.polyfit(np.log([r["size"] ** 2 for r in own]), np.log(total), 1)[0]
    print(f"fill + MFD grows as cells^{slope:.3f}")
    result = {
        "benchmark": "hydrology",
        "machine": machine("cpu", PEERS),
        "baseline": baseline("cpu"),
        "rows": rows,
        "exponent": slope,
        "peak_bytes_per_cell": used,
    }
    write_result(result, options.out, "hydrology")


def print_row(row: dict) -> None:
    times = row["seconds"]
    carve = f"{times['carve']:>9.3f}" if "carve" in times else ""
    print(
        f"{row['terrain']:>8} {row['size']:>6} {row['by']:>13} "
        f"{times['fill'] + times['d8']:>9.3f} {times['fill'] + times['mfd']:>10.3f} {carve}"
    )


if __name__ == "__main__":
    sys.exit(main())
