"""The sections of gpu.py that measure: steps in rows, their kernels, ways to deal points out, and other computing."""

from __future__ import annotations

import itertools
import re
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import roofline
import warp as wp
from gpu_proof import CHUNK, as_a_gpu_deals_out, rivers
from gpu_report import Report
from valley import SQUARE

import warpriver as wr
from warpriver import bench
from warpriver.engine import stages
from warpriver.engine import state as buffers

# What is measured: name, channels of a million points, collisions.
SCENES = (("1,000 a channel", 1000, False), ("with collisions", 1000, True), ("one channel", 1, False))
DTYPES = ("float64", "float32")
CHUNKS = (32, 16, 64)
BLOCK_DIMS = (64, 128, 256)
PHASES = {False: ("migrate", "cut off", "resample"), True: ("migrate", "cut off", "resample", "collide")}
# Rounds, of GPU_STEPS steps each on a GPU; and single steps in which kernels are timed.
ROUNDS, SWEEP_ROUNDS, KERNEL_STEPS = 4, 2, 20


# ---- steps


def speed_section(report: Report) -> None:
    """Steps in rows, each kernel, and points dealt out otherwise, beside a plain copy in the same run."""
    as_a_gpu_deals_out(report)
    points = 3_000 if report.small else 1_000_000
    bandwidth = bench.copy_bandwidth(1, report.device, 2**24 if report.small else None)
    report.tell(copy_bytes_per_second=bandwidth)
    for (name, channels, collisions), dtype in itertools.product(SCENES, DTYPES):
        scene = (name, points, max(1, channels * points // 1_000_000), collisions, dtype)
        report.attempt(f"{name}, {dtype}", lambda s=scene: step_row(report, bandwidth, *s))
    for dtype in DTYPES:
        report.attempt(f"kernels, {dtype}", lambda d=dtype: kernel_rows(report, bandwidth, points, d))
    needed = 4.0 * longest(report, "steps")
    for dtype in DTYPES:
        scene = ("ten times as many", 10 * points, 10 * points // 1000, False, dtype)
        if enough_left(report, f"{scene[0]}, {dtype}", needed):
            report.attempt(f"{scene[0]}, {dtype}", lambda s=scene: step_row(report, bandwidth, *s))
    for dtype, block_dim, chunk in itertools.product(DTYPES, BLOCK_DIMS, CHUNKS):
        layout = f"chunk {chunk}, blocks of {block_dim}, {dtype}"
        if enough_left(report, layout, 1.5 * longest(report, "layouts")):
            call = (report, bandwidth, points, dtype, chunk, block_dim)
            report.attempt(layout, lambda c=call: layout_row(*c))


def longest(report: Report, table: str) -> float:
    """Seconds that the longest row of a table took so far."""
    return max((row["seconds"] for row in report.facts.get(table, [])), default=1.0)


def enough_left(report: Report, what: str, seconds: float) -> bool:
    """Tell whether there is time for a row that takes so long, and some to spare; else note that it is left out."""
    if report.left() > seconds + 1.0:
        return True
    report.add("left_out", {"what": what, "seconds_left": report.left()})
    return False


def simulation(
    report: Report, points: int, channels: int, collisions: bool, dtype: str, **options: Any
) -> wr.Simulation:
    """Rivers in full bend on the device."""
    off: dict[str, Any] = {} if collisions else {"collision_distance": 0.0}
    network = rivers(points, channels, report.small)
    return wr.Simulation(network, wr.MeanderParams(**off), device=report.device, dtype=dtype, threads=1, **options)


def step_row(
    report: Report, bandwidth: float, name: str, points: int, channels: int, collisions: bool, dtype: str
) -> None:
    """Measure steps of a scene, in rows on a GPU."""
    begin = time.monotonic()
    sim = simulation(report, points, channels, collisions, dtype)
    cost = bench.step_cost(sim, rounds=ROUNDS)
    row = {"scene": name, "dtype": dtype} | cost | ratios(cost, bandwidth, dtype, collisions)
    report.add("steps", row | {"seconds": time.monotonic() - begin})


def ratios(cost: dict[str, Any], bandwidth: float, dtype: str, collisions: bool) -> dict[str, float]:
    """A step's time as multiples of what a copy takes: for the points alone, and for all that kernels must move."""
    moved = roofline.phase_bytes(dtype, channel_points=cost["points"] / cost["channels"], chunk_points=float(CHUNK))
    floor = sum(moved[phase] for phase in PHASES[collisions]) * cost["points"] / bandwidth
    seconds = 1e-3 * cost["ms_per_step"]
    copies = bench.copies_of_points(seconds, cost["points"], dtype, bandwidth)
    return {"copies_of_points": copies, "ratio_to_roofline": seconds / floor}


# ---- kernels


def kernel_rows(report: Report, bandwidth: float, points: int, dtype: str) -> None:
    """Time every kernel of a step, launched one by one."""
    channels = max(1, points // 1000)
    sim = simulation(report, points, channels, True, dtype, capture=False)
    sim.step(3)
    found = kernel_times(sim, KERNEL_STEPS)
    shape = {"channel_points": points / channels, "chunk_points": float(CHUNK)}
    floor = {x.kernel: sum(roofline.bytes_per_point(x, dtype, **shape)) / bandwidth for x in roofline.STEP}
    rows = []
    for name, times in found.items():
        launches = len(times) / KERNEL_STEPS
        rows.append({"kernel": name, "dtype": dtype, "launches": launches, "us": launches * statistics.median(times)})
        if name in floor:
            rows[-1]["floor_us"] = 1e6 * floor[name] * sim.network.point_count
    for row in sorted(rows, key=lambda row: -row["us"]):
        report.add("kernels", row)


def kernel_times(sim: wr.Simulation, steps: int) -> dict[str, list[float]]:
    """Microseconds of each launch in so many steps, by kernel.

    On a GPU they are those between two CUDA events, and memory that is set or copied is among them.
    """
    done: list[tuple[str, float]] = []
    if sim.device.is_cuda:
        wp.timing_begin(wp.TIMING_KERNEL | wp.TIMING_KERNEL_BUILTIN | wp.TIMING_MEMSET | wp.TIMING_MEMCPY)
        try:
            bench.advance(sim, steps)
        finally:
            results = wp.timing_end()
        done = [(plain_name(result.name), 1e3 * result.elapsed) for result in results]
    else:
        with launches(lambda kernel, seconds: done.append((plain_name(kernel.key), 1e6 * seconds))):
            bench.advance(sim, steps)
    found: dict[str, list[float]] = {}
    for name, elapsed in done:
        found.setdefault(name, []).append(elapsed)
    return found


def plain_name(name: str) -> str:
    """``forward kernel build__locals__move_points_0123abcd`` is ``move_points``; other names stay."""
    found = re.fullmatch(r"(?:forward kernel )?(?:\w*__locals__)?(\w+?)(?:_[0-9a-f]{8})?", name)
    return found[1] if found else name


@contextmanager
def launches(tell: Callable[[Any, float], None]) -> Iterator[None]:
    """Tell of each launch on the CPU, which returns when it is done, how long it took."""
    launch = wp.launch

    def timed(kernel: Any, *arguments: Any, **options: Any) -> Any:
        begin = time.perf_counter()
        result = launch(kernel, *arguments, **options)
        tell(kernel, time.perf_counter() - begin)
        return result

    wp.launch = timed
    try:
        yield
    finally:
        wp.launch = launch


# ---- how points are dealt out


def layout_row(report: Report, bandwidth: float, points: int, dtype: str, chunk: int, block_dim: int) -> None:
    """Measure steps whose threads take so many points each, in blocks of so many threads."""
    begin = time.monotonic()
    with dealt_out(wp.get_device(report.device).is_cpu, chunk, block_dim):
        sim = simulation(report, points, max(1, points // 1000), False, dtype)
        cost = bench.step_cost(sim, rounds=SWEEP_ROUNDS)
    row = {"chunk": chunk, "block_dim": block_dim, "dtype": dtype}
    row |= {"ns_per_point": cost["ns_per_point"]} | ratios(cost, bandwidth, dtype, False)
    report.add("layouts", row | {"seconds": time.monotonic() - begin})


@contextmanager
def dealt_out(is_cpu: bool, chunk: int, block_dim: int) -> Iterator[None]:
    """Let simulations made within give each thread ``chunk`` points, and launch in blocks of ``block_dim`` threads."""
    name = "CPU_CHUNK" if is_cpu else "CUDA_CHUNK"
    before = getattr(buffers, name), stages.BLOCK_DIM
    setattr(buffers, name, chunk)
    stages.BLOCK_DIM = block_dim
    try:
        yield
    finally:
        setattr(buffers, name, before[0])
        stages.BLOCK_DIM = before[1]


# ---- what else runs on a GPU


def others_section(report: Report) -> None:
    """A terrain's samples, a valley's raster and erosion in batches: values and time beside the CPU's."""
    report.attempt("terrain", lambda: terrain_samples(report))
    report.attempt("valley", lambda: valley_raster(report))
    report.attempt("erosion", lambda: erosion(report))


def erosion(report: Report) -> None:
    """Rain in batches: the same bits again, and as much taken away as on the CPU."""
    side, events, batch = (64, 512, 128) if report.small else (512, 16_384, 4096)
    found, seconds = {}, {}
    for name, device in (("here", report.device), ("again", report.device), ("cpu", "cpu")):
        plane = wr.generate.erosion_plane((side, side), device=device)
        wr.erode(plane, events=batch, batch=batch)  # compiles
        begin = time.perf_counter()
        found[name] = wr.erode(plane, events=events, seed=1, batch=batch)
        height = found[name].to_numpy()
        seconds[name] = time.perf_counter() - begin
        found[f"{name} height"] = height
    if not np.array_equal(found["here height"], found["again height"]):
        report.fail("erosion in batches: two runs differ")
    row = compared("erosion", found["here height"], found["cpu height"], 0.0)
    ratio = found["here"].volume_removed / found["cpu"].volume_removed
    if not abs(ratio - 1.0) < 0.05:
        report.fail(f"erosion in batches takes away {ratio:.3f} times what it does on the CPU")
    report.add(
        "others",
        row | {"volume_ratio": ratio, "events": events, "seconds": seconds["again"], "cpu_seconds": seconds["cpu"]},
    )


def valley_raster(report: Report) -> None:
    """A raster of the sixth valley of the paper."""
    size = 150 if report.small else 2000
    cell = (SQUARE[2] - SQUARE[0]) / size
    here, cpu = (wr.synthetic_valley("S6", device=device) for device in (report.device, "cpu"))
    against(report, "valley raster", lambda v: v.raster(cell, SQUARE).to_numpy(), here, cpu, 1e-6)


def terrain_samples(report: Report) -> None:
    """Heights and gradients at points on a terrain, and some off it."""
    side, count = (64, 1_000) if report.small else (1024, 1_000_000)
    cpu = wr.generate.fractal_terrain((side, side), 10.0, 80.0, 3)
    here = cpu.to(report.device)
    xy = np.random.default_rng(0).uniform(-50.0, 10.0 * side + 50.0, (count, 2)) + [cpu.bounds[0], cpu.bounds[1]]
    against(report, "terrain heights", lambda t: t.sample(xy), here, cpu, 1e-9)
    against(report, "terrain gradients", lambda t: t.gradient(xy), here, cpu, 1e-9)


def against(report: Report, name: str, call: Callable[[Any], np.ndarray], here: Any, cpu: Any, allowed: float) -> None:
    """Hold what a call gives on this device against the CPU, with the time of both, results on the host."""
    values = [call(each) for each in (here, cpu)]
    row = compared(name, *values, allowed)
    if row["share_beyond"] > 1e-4:
        report.fail(f"{name}: {row['share_beyond']:.3%} of the values are more than {allowed:g} from the CPU's")
    for key, each in (("seconds", here), ("cpu_seconds", cpu)):
        row[key] = bench.min_seconds(lambda each=each: call(each), rounds=3, device=report.device)
    report.add("others", row)


def compared(name: str, here: np.ndarray, cpu: np.ndarray, allowed: float) -> dict[str, Any]:
    """How far values lie apart, and the share of them that lie farther than allowed, or are missing on one side."""
    known = np.isfinite(here) & np.isfinite(cpu)
    apart = np.abs(here[known] - cpu[known])
    beyond = int((apart > allowed).sum()) + int((np.isfinite(here) != np.isfinite(cpu)).sum())
    return {
        "what": name,
        "values": here.size,
        "apart": float(apart.max(initial=0.0)),
        "share_beyond": beyond / here.size,
    }
