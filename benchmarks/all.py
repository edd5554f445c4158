"""Runs all benchmarks one after the other, draws their results and prints the tables."""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
# What each file is told at small sizes, and at all sizes.
SUITE = {
    "step": ("--quick", "--full"),
    "network": ("--quick", ""),
    "paths": ("--quick", ""),
    "startup": ("--rounds 2", ""),
    "erosion": ("--quick", ""),
    "hydrology": ("--quick", ""),
    "riverscape": ("--quick", ""),
    "carving": ("--quick", ""),
    "editing": ("--quick", ""),
}
# Routing runs on one core of the host, and the file of its figures is named without a device.
HOST_ONLY = ("hydrology",)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("--full", action="store_true", help="all sizes, up to 10 million points, instead of small ones")
    parser.add_argument("--only", choices=SUITE, nargs="+", default=list(SUITE), help="some of them")
    parser.add_argument(
        "-o", "--out", type=Path, help="folder for the results (default out/bench; with --full benchmarks/results)"
    )
    options = parser.parse_args()
    out = options.out or (HERE / "results" if options.full else HERE.parent / "out" / "bench")
    failed = []
    for name in options.only:
        is_cpu = options.device == "cpu"
        if name in HOST_ONLY and not is_cpu:
            continue
        device = [] if name in HOST_ONLY else ["--device", options.device]
        target = out / (f"{name}.json" if name in HOST_ONLY else f"{name}-{options.device.split(':')[0]}.json")
        print(f"\n==== {name}", flush=True)
        begin = time.perf_counter()
        flags = SUITE[name][options.full].split()
        done = subprocess.run(
            [sys.executable, str(HERE / f"{name}.py"), *flags, *device, "-o", str(target)], check=False
        )
        print(f"{time.perf_counter() - begin:.0f} s", flush=True)
        failed += [name] * (done.returncode != 0)
    print("\n==== results", flush=True)
    subprocess.run([sys.executable, str(HERE / "plot.py"), str(out)], check=False)
    for flags in ([], ["--goals"]):
        table = [sys.executable, str(HERE / "table.py"), str(out), "--device", options.device.split(":")[0], *flags]
        subprocess.run(table, check=False)
        print(flush=True)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
