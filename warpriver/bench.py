"""What a step costs on this machine, and how fast its memory is: the measuring behind ``warpriver bench``.

A figure in milliseconds is true of one machine alone. So a step's cost is also given as the number of times that the
points could have been copied meanwhile, by one core or by as many as the step used, measured in the same run.
"""

from __future__ import annotations

import functools
import itertools
import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from warpriver.device import PRECISIONS, resolve_device
from warpriver.errors import InputError
from warpriver.generate.lines import noisy_line
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams
from warpriver.simulation import Simulation
from warpriver.terrain import Terrain

__all__ = [
    "HOST_PHASES",
    "advance",
    "copies_of_points",
    "copy_bandwidth",
    "cut_lines",
    "device_bytes",
    "ground_under",
    "lay_out",
    "measure",
    "min_seconds",
    "phase_seconds",
    "step_cost",
    "synthetic_network",
    "warm_up",
]

WIDTH, SPACING = 50.0, 50.0  # m
# Points of the river that others are cut from, and how long it has meandered, yr: its sinuosity is then above 2 and its
# necks close all the time. A straight river is cheaper.
RIVER_POINTS, RIVER_YEARS = 20_000, 300.0
# Widths between channels that are laid out side by side: those on the edge do not meet within a benchmark.
GAP_WIDTHS = 40.0
ROUNDS = 5
# Steps a round on a GPU: they are requested at once, so that the host looks at a few of them only.
GPU_STEPS = 64
# Bytes of each array that is copied: more than processors have of cache.
COPY_BYTES = 512 * 2**20
# All else is held against the copy: its best time should not depend on what else the machine does.
COPY_ROUNDS = 15
# Phases of a step that run on the host: joins after collisions, and all that lies between the launches.
HOST_PHASES = ("join", "rest of host")
# What the river of the scenes has meandered with: migration alone, so that they are the same whatever the defaults are.
RIVER = MeanderParams(
    friction=0.011, curvature_saturation=0.0, inlet="none", sinuosity_scaling="upstream", cutoff_distance=1.0,
    bank_spread=0.0,
)  # fmt: skip


def min_seconds(call: Callable[[], object], repeats: int = 1, rounds: int = ROUNDS, device: Any = "cpu") -> float:
    """Shortest time of a call over several rounds of ``repeats`` calls, the one least disturbed by other work.

    Args:
        call: What is timed.
        repeats: Calls a round.
        rounds: Rounds.
        device: Warp device that is waited for at the ends of a round.

    Returns:
        Seconds a call.
    """
    device, best = resolve_device(device), math.inf
    for _ in range(rounds):
        wp.synchronize_device(device)
        begin = time.perf_counter()
        for _ in range(repeats):
            call()
        wp.synchronize_device(device)
        best = min(best, (time.perf_counter() - begin) / repeats)
    return best


def copy_bandwidth(threads: int = 1, device: Any = "cpu", nbytes: int | None = None) -> float:
    """Bytes a second that a plain copy reads and writes together, as STREAM counts them.

    Args:
        threads: Cores, each of which copies a share; ignored on a GPU.
        device: Warp device whose memory is meant.
        nbytes: Bytes of each of the two arrays, by default more than caches hold.
    """
    count = (nbytes or COPY_BYTES) // 8
    if not resolve_device(device).is_cpu:
        source, target = (wp.zeros(count, dtype=wp.float64, device=device) for _ in range(2))
        return 2 * 8 * count / min_seconds(lambda: wp.copy(target, source), 10, COPY_ROUNDS, device)
    a, b = np.ones(count), np.zeros(count)
    edges = np.linspace(0, count, threads + 1).astype(int).tolist()
    shares = [(b[i:j], a[i:j]) for i, j in itertools.pairwise(edges)]
    with ThreadPoolExecutor(threads) as pool:
        copy = functools.partial(np.copyto, *shares[0]) if threads == 1 else lambda: list(pool.map(_copy_share, shares))
        return 2 * 8 * count / min_seconds(copy, rounds=COPY_ROUNDS)


def _copy_share(share: tuple[np.ndarray, np.ndarray]) -> None:
    np.copyto(*share)


def copies_of_points(seconds: float, points: int, dtype: str, bandwidth: float) -> float:
    """Times that all points, x and y, could have been copied in so many seconds."""
    return seconds * bandwidth / (2 * 2 * np.dtype(PRECISIONS[dtype][2]).itemsize * points)


# ---- scenes


@functools.lru_cache(maxsize=4)
def _developed_river(points: int, years: float, seed: int) -> np.ndarray:
    length = points * SPACING / 2.7  # by then it is about so much longer than its valley
    line = noisy_line(length, SPACING, WIDTH, seed)
    sim = Simulation(RiverNetwork.from_polylines([line], width=WIDTH), RIVER)
    sim.run(years=years, record_every=10**9)
    return sim.network.polylines()[0]


def cut_lines(
    counts: Sequence[int], seed: int = 0, river_points: int = RIVER_POINTS, years: float = RIVER_YEARS
) -> list[np.ndarray]:
    """Cut reaches at random from a river that has meandered for centuries, 50 m wide and with a point every 50 m.

    Args:
        counts: Points of each line, 3 or more; beyond those of the river it is repeated head to tail.
        seed: Which reaches.
        river_points: Points of the river, about.
        years: Its age.

    Returns:
        One (n, 2) array a line, m.
    """
    river = _developed_river(river_points, years, 0)
    rng = np.random.default_rng(seed)
    lines = []
    for count in counts:
        if count <= len(river):
            first = int(rng.integers(len(river) - count + 1))
            lines.append(river[first : first + count])
            continue
        k = np.arange(count)
        lines.append(river[k % (len(river) - 1)] + (k // (len(river) - 1))[:, None] * (river[-1] - river[0]))
    return lines


def lay_out(lines: Sequence[np.ndarray], gap: float = GAP_WIDTHS * WIDTH) -> list[np.ndarray]:
    """Move lines beside each other, in rows, so that their bounding boxes lie ``gap`` m apart."""
    low = np.array([line.min(axis=0) for line in lines])
    size = np.array([line.max(axis=0) for line in lines]) - low + gap
    row_width = max(float(size[:, 0].max()), math.sqrt(float(size.prod(axis=1).sum())))
    moved, corner, height = [], np.zeros(2), 0.0
    for line, first, box in zip(lines, low, size, strict=True):
        if corner[0] > 0.0 and corner[0] + box[0] > row_width:
            corner, height = np.array([0.0, corner[1] + height]), 0.0
        moved.append(line - first + corner)
        corner = corner + [box[0], 0.0]
        height = max(height, float(box[1]))
    return moved


def ground_under(network: RiverNetwork, cell_size: float = 100.0, relief_slope: float = 0.1) -> Terrain:
    """Hills under a network, waves of slopes up to ``relief_slope``: migration fades here and there.

    Args:
        network: What lies on it.
        cell_size: m; coarser where the map would have more than 64 million cells.
        relief_slope: Greatest slope, m/m.
    """
    west, south, east, north = network.bounds()
    west, south, east, north = west - 1000.0, south - 1000.0, east + 1000.0, north + 1000.0
    cell_size = max(cell_size, math.sqrt((east - west) * (north - south) / 64e6))
    x = np.arange(west, east + cell_size, cell_size)
    y = np.arange(north, south - cell_size, -cell_size)[:, None]
    wave = 5000.0 / (2.0 * math.pi)
    height = relief_slope / math.sqrt(2.0) * wave * (np.sin(x / wave) + np.cos(y / wave))
    return Terrain(height, cell_size, origin=(west, north), crs=network.crs, device=network.device)


# ---- measuring


def advance(sim: Simulation, steps: int) -> None:
    """Do steps as they are timed: one call each on the CPU, one call for all on a GPU, which does them in rows."""
    if not sim.device.is_cpu:
        sim.step(steps)
        return
    for _ in range(steps):
        sim.step()


def warm_up(sim: Simulation, steps: int) -> None:
    """Do steps in which kernels are compiled and recorded: so many on the CPU, and rows of every length on a GPU."""
    if sim.device.is_cpu:
        advance(sim, steps)
        return
    for power in range(GPU_STEPS.bit_length()):
        sim.step(1 << power)


def step_cost(sim: Simulation, rounds: int = 2 * ROUNDS, repeats: int | None = None, warmup: int = 3) -> dict[str, Any]:
    """Measure whole steps of a simulation, which moves on.

    Args:
        sim: What is stepped.
        rounds: Rounds; the best one counts.
        repeats: Steps a round, see :func:`advance`. By default ``GPU_STEPS`` on a GPU; on the CPU 3 to 50, of some
            100,000 points in all: few, so that the rivers stay alike.
        warmup: Steps before on the CPU, see :func:`warm_up`.

    Returns:
        ``points`` and ``channels`` at the end of the best round, its ``ms_per_step`` and ``ns_per_point``; over all
        rounds ``ms_mean``, ``cutoffs_per_step``, ``collisions_per_step``; ``substeps`` of the last step, and
        ``bytes_per_point`` of all device arrays.
    """
    warm_up(sim, warmup)
    history, first = sim.history, sim.step_count
    cutoffs, collisions = len(history.cutoffs), len(history.collisions)
    few = min(50, max(3, 100_000 // sim.network.point_count)) if sim.device.is_cpu else GPU_STEPS
    repeats, found = repeats or few, []
    for _ in range(rounds):
        cost = min_seconds(functools.partial(advance, sim, repeats), 1, 1, sim.device) / repeats
        found.append((cost / sim.network.point_count, cost, sim.network.point_count, sim.network.channel_count))
    steps = sim.step_count - first
    per_point, cost, points, channels = min(found)
    return {
        "points": points,
        "channels": channels,
        "ms_per_step": 1e3 * cost,
        "ms_mean": 1e3 * float(np.mean([f[1] for f in found])),
        "ns_per_point": 1e9 * per_point,
        "cutoffs_per_step": (len(history.cutoffs) - cutoffs) / steps,
        "collisions_per_step": (len(history.collisions) - collisions) / steps,
        "substeps": sim.substeps,
        "bytes_per_point": device_bytes(sim) / sim.network.point_count,
    }


def device_bytes(sim: Simulation) -> int:
    """Device memory of a simulation without its terrain: the network's points and the scratch of a step."""
    network = sim.network
    points = [a for a in (network.point_xy, network.point_section) if a is not None]
    held = sum(len(a) * wp.types.type_size_in_bytes(a.dtype) for a in points)
    return held + sim.stepper.state.nbytes


def phase_seconds(sim: Simulation, steps: int = 10, warmup: int = 2) -> dict[str, float]:
    """Split the time of a step by its phases, sub-steps and edits included; the simulation moves on.

    The phases are replayed one by one, so that one no longer finds in the cache what the one before left there: their
    sum is somewhat more than a step costs in one piece.

    Args:
        sim: What is stepped; not one made with ``check=True`` or ``capture=False``.
        steps: Steps over which the mean is taken, see :func:`advance`.
        warmup: Steps before them on the CPU, see :func:`warm_up`.

    Returns:
        Seconds a step of each phase, in the order of the step, with those of the host last: "join" (channels that
        touch are joined, and searched again) and "rest of host" (all that is not a phase).
    """
    seconds: dict[str, float] = {}
    sim.stepper.time_phases(seconds)
    try:
        warm_up(sim, warmup)
        for name in seconds:
            seconds[name] = 0.0
        begin = time.perf_counter()
        advance(sim, steps)
        total = time.perf_counter() - begin
    finally:
        sim.stepper.time_phases(None)
    on_host = {name: seconds.pop(name) for name in list(seconds) if name.endswith(" on host")}
    joins = on_host.get("collide on host", 0.0)
    rest = max(total - joins - sum(seconds.values()), 0.0)
    host = dict(zip(HOST_PHASES, (joins, rest), strict=True))
    return {name: cost / steps for name, cost in (seconds | host).items()}


def synthetic_network(
    points: int,
    channels: int,
    *,
    device: Any = "cpu",
    dtype: str = "float64",
    threads: int | None = None,
    terrain: bool = False,
    cutoffs: bool = True,
    collisions: bool = True,
) -> Simulation:
    """Make a simulation of rivers in full bend, 50 m wide with a point every 50 m, side by side.

    Args:
        points: Points of the network, about.
        channels: Channels that share them evenly.
        device: Warp device.
        dtype: "float64" or "float32".
        threads: Threads on the CPU, by default one for each core.
        terrain: Whether there is ground under it whose slope is felt.
        cutoffs: Whether necks are cut off.
        collisions: Whether channels that touch are joined.

    Raises:
        ValueError: Fewer than 3 points a channel, or no channel.
    """
    if channels < 1 or points < 3 * channels:
        raise InputError(f"{points} points in {channels} channels: give at least 1 channel and 3 points for each")
    device = resolve_device(device)
    lines = lay_out(cut_lines([points // channels] * channels, river_points=RIVER_POINTS if points > 2_000 else 2_000))
    network = RiverNetwork.from_polylines(lines, width=WIDTH, device=device, dtype=dtype)
    del lines
    off: dict[str, Any] = {"cutoff_distance": 0.0} if not cutoffs else {}
    off |= {"collision_distance": 0.0} if not collisions else {}
    ground = ground_under(network) if terrain else None
    return Simulation(network, MeanderParams(**off), terrain=ground, threads=threads)


def measure(points: int, channels: int, *, copy_bytes: int | None = None, **options: Any) -> dict[str, Any]:
    """Measure a step of a made-up network on this machine, as ``warpriver bench`` does.

    Args:
        points: Points of the network, about.
        channels: Channels that share them evenly.
        copy_bytes: Bytes of each array of the copy that the step is compared with; see :func:`copy_bandwidth`.
        options: Those of :func:`synthetic_network`.

    Returns:
        What :func:`step_cost` returns, ``phases_ms``, ``threads``, ``copy_bytes_per_second`` of as many threads, and
        ``copies_of_points``: how many times the points could have been copied in a step's time.

    Raises:
        ValueError: As :func:`synthetic_network`.
    """
    sim = synthetic_network(points, channels, **options)
    bandwidth = copy_bandwidth(sim.threads, sim.device, copy_bytes)
    result = step_cost(sim)
    phases = phase_seconds(sim, steps=max(3, min(100, 1_000_000 // result["points"])))
    ratio = copies_of_points(1e-3 * result["ms_per_step"], result["points"], sim.network.dtype, bandwidth)
    return result | {
        "phases_ms": {name: 1e3 * cost for name, cost in phases.items()},
        "device": sim.device.name,
        "dtype": sim.network.dtype,
        "threads": sim.threads,
        "terrain": sim.terrain is not None,
        "cutoffs": "cut off" in phases,
        "collisions": sim.params.collision_distance > 0.0,
        "copy_bytes_per_second": bandwidth,
        "copies_of_points": ratio,
    }
