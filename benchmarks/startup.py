"""What starting costs: the import, the first step with nothing compiled, the same with all kernels in Warp's cache."""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile

import numpy as np
from machine import baseline, machine, run_child, say_baseline, write_result

# Run in a process of its own; the clock starts with its first line, when the interpreter is up.
CHILD = """
import time
begin = time.perf_counter()
marks = {}
def mark(name):
    global begin
    now = time.perf_counter()
    marks[name], begin = now - begin, now
import warpriver as wr
mark("import_seconds")
import json, sys
import warp as wp
wp.init()
mark("warp_seconds")
device, dtype = sys.argv[1:3]
lines = [wr.generate.noisy_line(5000.0, 50.0, 50.0, k) + [0.0, 3000.0 * k] for k in range(2)]
network = wr.RiverNetwork.from_polylines(lines, width=50.0, device=device, dtype=dtype)
mark("network_seconds")
sim = wr.Simulation(network)
mark("simulation_seconds")
sim.step()
wp.synchronize_device(device)
mark("first_step_seconds")
sim.step()
wp.synchronize_device(device)
mark("second_step_seconds")
print(json.dumps(marks))
"""
LOADED = re.compile(r"Module (\S+) \S+ load on device '[^']+' took ([\d.]+) ms +\((\w+)\)")


def start(kind: str, cache: str, options: argparse.Namespace) -> tuple[dict, dict[str, tuple[float, str]]]:
    """Seconds of each part of a start, and how each module was come by: (seconds, "compiled" or "cached")."""
    with tempfile.NamedTemporaryFile("w", suffix=".py") as script:
        script.write(CHILD)
        script.flush()
        said = run_child(script.name, options.device, options.dtype, environment={"WARP_CACHE_PATH": cache})
    marks = json.loads(said.splitlines()[-1])
    modules = {name: (1e-3 * float(ms), how) for name, ms, how in LOADED.findall(said)}
    parts = [v for k, v in marks.items() if k != "second_step_seconds"]
    return {"case": kind, **marks, "until_first_step_seconds": sum(parts)}, modules


def measure_all(options: argparse.Namespace) -> dict:
    """All figures."""
    print(say_baseline(baseline(options.device)))
    rows, compiled = [], {}
    with tempfile.TemporaryDirectory(prefix="warpriver-cache-") as cache:
        cold, modules = start("cold", cache, options)
        rows.append(cold)
        compiled = {name: cost for name, (cost, how) in modules.items() if how == "compiled"}
        if not compiled:
            raise RuntimeError("the start with an empty cache compiled nothing: is WARP_CACHE_PATH no longer read?")
        warm = [start("cached", cache, options) for _ in range(options.rounds)]
        late = {name for _, modules in warm for name, (_, how) in modules.items() if how == "compiled"}
        if late:
            raise RuntimeError(f"compiled again in a start with a filled cache: {', '.join(sorted(late))}")
        chosen = min(range(len(warm)), key=lambda k: warm[k][0]["until_first_step_seconds"])
        rows.append(warm[chosen][0])
    parts = [k for k in rows[0] if k.endswith("_seconds")]
    print(f"{'s':>24} " + " ".join(f"{r['case']:>9}" for r in rows))
    for part in parts:
        print(f"{part.removesuffix('_seconds').replace('_', ' '):>24} " + " ".join(f"{r[part]:>9.4f}" for r in rows))
    for name, cost in compiled.items():
        print(f"{name:>50} compiled in {cost:.2f} s")
        rows.append({"case": "compile", "module": name, "seconds": cost})
    print(f"{len(compiled)} modules compiled in {np.sum(list(compiled.values())):.1f} s in all")
    return {"rows": rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("--dtype", default="float64", choices=("float64", "float32"), help="default float64")
    parser.add_argument("--rounds", type=int, default=5, help="cached starts; the fastest counts (default 5)")
    parser.add_argument("-o", "--out", help="JSON to write (default results/startup-DEVICE.json)")
    options = parser.parse_args()
    result = {
        "benchmark": "startup",
        "dtype": options.dtype,
        "machine": machine(options.device),
        "baseline": baseline(options.device),
        **measure_all(options),
    }
    write_result(result, options.out, f"startup-{options.device.split(':')[0]}")


if __name__ == "__main__":
    sys.exit(main())
