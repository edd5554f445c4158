"""What figures were measured on, as every result file says it: versions, memory bandwidth, peak memory of a process."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import warpriver as wr
from warpriver.bench import copy_bandwidth, min_seconds

# Loading of kernels is no news here.
wp.config.log_level = wp.LOG_WARNING

RESULTS = Path(__file__).parent / "results"
# Where what takes long to make and never changes is kept between runs.
KEPT = Path(__file__).resolve().parents[1] / "build" / "bench"
# Longest that a child process may take, s.
PATIENCE = 7200


def machine(device: str, peers: Iterable[str] = ()) -> dict:
    """Processor, versions and commit.

    Args:
        device: Warp device name.
        peers: Distributions whose versions matter; None stands for one that is not installed.
    """
    processor = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [row.split(":", 1)[1].strip() for row in info.read_text().splitlines() if row.startswith("model name")]
        processor = names[0] if names else processor
    describe = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    done = subprocess.run(describe, capture_output=True, text=True, check=False)
    versions = {}
    for peer in peers:
        try:
            versions[peer] = importlib.metadata.version(peer)
        except importlib.metadata.PackageNotFoundError:
            versions[peer] = None
    return {
        "processor": processor,
        "cores": cores(),
        "device": wp.get_device(device).name,
        "python": platform.python_version(),
        "warpriver": wr.__version__,
        "warp": wp.__version__,
        "numpy": np.__version__,
        "commit": done.stdout.strip() or None,
        "peers": versions,
    }


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def baseline(device: str) -> dict[str, float]:
    """Speed of the memory, measured now: what makes runs on different machines comparable.

    Args:
        device: Warp device name; of a GPU the copy is its own, the rest is the host's.

    Returns:
        ``copy_bytes_per_second`` of one core (or the GPU), ``copy_all_bytes_per_second`` of all cores, and
        ``triad_ns_per_point``: one pass of ``c = a + b`` over arrays of four million float64.
    """
    found = {"copy_bytes_per_second": copy_bandwidth(1, device)}
    found["copy_all_bytes_per_second"] = copy_bandwidth(cores(), "cpu")
    return found | {"triad_ns_per_point": triad(4_000_000)}


def triad(points: int) -> float:
    """Nanoseconds a point of ``c = a + b`` in NumPy, over arrays of that many float64."""
    a, b, c = np.ones(points), np.ones(points), np.empty(points)
    return 1e9 * min_seconds(lambda: np.add(a, b, out=c), max(3, 5_000_000 // points)) / points


def say_baseline(found: dict[str, float]) -> str:
    """One line that tells the baseline."""
    one, every = (1e-9 * found[f"{name}_bytes_per_second"] for name in ("copy", "copy_all"))
    return f"copy: {one:.1f} GB/s on one core or the GPU, {every:.1f} GB/s on {cores()} cores (read + written)"


# ---- memory of a process


def memory_status(name: str) -> int | None:
    """A line of /proc/self/status in bytes, such as VmRSS or VmHWM; None where the system has none."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    rows = [row for row in status.read_text().splitlines() if row.startswith(name + ":")]
    return 1024 * int(rows[0].split()[1]) if rows else None


def forget_peak() -> bool:
    """Give back what is free, and let VmHWM begin anew at what is held; False where the system does not allow it."""
    gc.collect()
    # What the allocator keeps of arrays that are gone would hide what comes next.
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def run_child(script: str, *arguments: Any, environment: dict[str, str] | None = None) -> str:
    """Run a script in a process of its own, and return what it printed.

    Args:
        script: Path of the script.
        arguments: Its arguments.
        environment: Variables beyond those of this process.

    Raises:
        RuntimeError: The process failed; the message is the end of what it said.
    """
    command = [sys.executable, script, *map(str, arguments)]
    # Arrays go back to the system when they are freed, so that what is held is what is counted.
    variables = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"} | (environment or {})
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=variables, timeout=PATIENCE)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr[-2000:]}")
    return done.stdout


def in_child(script: str, *arguments: Any) -> dict:
    """Run a script in a process of its own, and return the JSON of its last line."""
    return json.loads(run_child(script, *arguments).splitlines()[-1])


def write_result(result: dict, path: str | None, name: str) -> None:
    """Write a result as JSON to ``path``, by default to ``results/name.json``."""
    target = Path(path) if path else RESULTS / f"{name}.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(result, indent=2) + "\n")
    print(f"written to {target}")
