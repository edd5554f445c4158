"""The sections of gpu.py that prove: machine, kernel tests, whole models, the same bits again, compute-sanitizer."""

from __future__ import annotations

import functools
import glob
import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from gpu_report import Report, SkippedError, one_line
from machine import cores, machine

import warpriver as wr
from warpriver import bench
from warpriver.cli.info import describe_device, describe_gpus
from warpriver.engine import state as buffers

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"
# Points that a thread takes on a GPU, and on the CPU where it stands in for one.
CHUNK = 32
# Coordinates on two devices may part so far in three steps, m: rounding, grown by bends that are tight.
APART = {"float64": 1e-4, "float32": 1.0}
# Seconds that a section needs to put down what it has found.
CLOSING = 3.0


# ---- machine


@wp.kernel(enable_backward=False)
def count_sevenths(value_out: wp.array[int]):
    """Write the index modulo 7."""
    i = wp.tid()
    value_out[i] = i % 7


def machine_section(report: Report) -> None:
    """What this machine is, whether a recording can be replayed, and what a copy, a launch and a look cost."""
    device = wp.get_device(report.device)
    devices, driver, toolkit = wp.get_devices(), wp.get_cuda_driver_version(), wp.get_cuda_toolkit_version()
    report.tell(
        machine=machine(report.device),
        device=describe_device(device),
        driver=driver,
        toolkit=toolkit,
        advice=describe_gpus(devices, driver, toolkit),
        memory_pool=bool(device.is_cuda and device.is_mempool_enabled),
        nvidia_smi=nvidia_smi(),
    )
    report.attempt("a recording", lambda: replay_scan(report, 10_000 if report.small else 1_000_000))
    nbytes = 2**24 if report.small else None
    speed = bench.copy_bandwidth(1, report.device, nbytes)
    report.tell(copy_bytes_per_second=speed)
    report.tell(**small_costs(report.device))


def nvidia_smi() -> list[str]:
    """What nvidia-smi says of each GPU; nothing where it is missing."""
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return []
    subprocess.run([tool], check=False, timeout=10)  # all of it, into the log
    wanted = (
        "name,driver_version,memory.total,memory.used,clocks.sm,clocks.max.sm,clocks.mem,power.limit,temperature.gpu"
    )
    query = [tool, f"--query-gpu={wanted}", "--format=csv"]
    return subprocess.run(query, capture_output=True, text=True, check=False, timeout=10).stdout.splitlines()


def replay_scan(report: Report, count: int) -> None:
    """Record a kernel and a scan, replay them, and look at the sums."""
    values, sums = (wp.zeros(count, dtype=int, device=report.device) for _ in range(2))
    wp.launch(count_sevenths, count, outputs=[values], device=report.device)  # compiles it
    with wp.ScopedCapture(device=report.device) as recording:
        wp.launch(count_sevenths, count, outputs=[values], device=report.device)
        wp.utils.array_scan(values, sums)
    for array in (values, sums):
        array.zero_()
    wp.capture_launch(recording.graph)
    if not np.array_equal(sums.numpy(), np.cumsum(np.arange(count) % 7)):
        report.fail("a recorded kernel and scan give other sums when they are replayed")
    seconds = bench.min_seconds(lambda: wp.capture_launch(recording.graph), 20, device=report.device)
    report.tell(scan_replay_us=1e6 * seconds)


def small_costs(device: str) -> dict[str, float]:
    """Microseconds of a launch, of a replay of one, and of reading 64 bytes."""
    values: wp.array = wp.zeros(16, dtype=int, device=device)

    def launch() -> None:
        wp.launch(count_sevenths, 16, outputs=[values], device=device)

    launch()
    with wp.ScopedCapture(device=device) as recording:
        launch()
    calls = {"launch_us": launch, "replay_us": lambda: wp.capture_launch(recording.graph), "look_us": values.numpy}
    return {name: 1e6 * bench.min_seconds(call, 100, device=device) for name, call in calls.items()}


# ---- kernel tests


def kernels_section(report: Report) -> None:
    """The tests of the kernels on this device, a process for each file, as many at once as there are cores."""
    files = sorted((TESTS / "kernels").glob("test_*.py"), key=lambda path: -path.stat().st_size)
    files = [path for path in files if path.stem != "test_aot"]  # it compiles for GPUs that are not here
    if report.small:
        files = files[-1:]
    alias = wp.get_device(report.device).alias
    hands = 1 if report.small else min(8, cores())
    begin = time.monotonic()
    with ThreadPoolExecutor(hands) as pool:
        for future in as_completed([pool.submit(run_tests, path, alias, report) for path in files]):
            row, failures = future.result()
            report.add("files", row)
            for failure in failures:
                report.fail(failure)
    rows = report.facts["files"]
    counts = {name: sum(row[name] for row in rows) for name in ("passed", "failed", "skipped")}
    report.tell(**counts, processes=hands, wall_seconds=time.monotonic() - begin)
    if counts["passed"] == 0:
        report.fail(f"no test of a kernel passed on {alias}")


def run_tests(path: Path, alias: str, report: Report) -> tuple[dict[str, Any], list[str]]:
    """Run the tests of a file on one device, and return their counts and what failed."""
    row = {"file": path.stem, "passed": 0, "failed": 0, "skipped": 0, "seconds": 0.0}
    seconds, begin, code = report.left() - CLOSING, time.monotonic(), None
    if seconds <= 0.0:
        return row, [f"{path.stem}: not begun, no time was left"]
    said, results = (report.folder / f"{path.stem}.{ending}" for ending in ("log", "xml"))
    results.unlink(missing_ok=True)
    with open(said, "w") as log:
        # Away from the checkout: its warpriver lacks the kernels where it is not installed.
        options: dict[str, Any] = {"stdout": log, "stderr": subprocess.STDOUT, "cwd": report.folder, "env": one_core()}
        try:
            code = subprocess.run(pytest_command(path, alias, results, seconds), timeout=seconds, **options).returncode
        except subprocess.TimeoutExpired:
            pass
    row["seconds"] = time.monotonic() - begin
    if code in (0, 1, 2, 5) and results.exists():  # 2: it cannot be imported; 5: it has no test for this device
        failures = count_tests(results.read_text(), row)
        results.unlink()
    else:
        failures = ["not done" if code is None else f"pytest ended with exit code {code}"]
        failures[0] += f" after {row['seconds']:.0f} s; the last line of its log: {count_said(said.read_text(), row)}"
    return row, [f"{path.stem}: {failure}" for failure in failures]


def pytest_command(path: Path, alias: str, results: Path, seconds: float) -> list[str]:
    """The process that runs the tests of a file on one device; where one hangs, its log tells in which line."""
    command = [sys.executable, "-m", "pytest", "-v", "--tb=short", "-p", "no:xdist", "-p", "no:cacheprovider"]
    command += ["-c", str(ROOT / "pyproject.toml"), "--rootdir", str(ROOT), "--junitxml", str(results), "-k", alias]
    return [*command, "-o", f"faulthandler_timeout={max(1.0, seconds / 3.0):.0f}", str(path)]


def count_tests(text: str, row: dict[str, Any]) -> list[str]:
    """Count the tests of a JUnit file into a row, and return each that failed with the beginning of its message."""
    failures = []
    for case in ElementTree.fromstring(text).iter("testcase"):
        wrong = [e for e in case if e.tag in ("failure", "error")]
        kind = "failed" if wrong else "skipped" if case.find("skipped") is not None else "passed"
        row[kind] += 1
        failures += [f"{case.get('name')}: {one_line(wrong[0].get('message'))}"] if wrong else []
    return failures


def count_said(text: str, row: dict[str, Any]) -> str:
    """Count the tests in the log of a process that was not done into a row, and return the log's last line."""
    for kind in ("passed", "failed", "skipped"):
        row[kind] = len(re.findall(rf"::\S+ {kind.upper()}\b", text))
    lines = text.split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "(empty)")


def one_core() -> dict[str, str]:
    """The environment of a process in which NumPy has one thread, and that says at once what it says."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return os.environ | threads | {"PYTHONUNBUFFERED": "1"}


# ---- whole models


def models_section(report: Report) -> None:
    """The models of tests/helpers/models.py, whose steps are the same bits in whatever way they are done."""
    stages = model_table()
    as_a_gpu_deals_out(report)
    names = ("plain", "tree in parts", "paths") if report.small else tuple(stages.MODELS)
    for name in names:
        report.attempt(name, lambda name=name: check_model(report, stages, name))
    report.attempt("check=True", lambda: check_phases(report, stages, "tree in parts"))


def model_table() -> Any:
    """``tests/helpers/models.py``: MODELS are pairs of a function, which takes options of a Simulation, and steps."""
    sys.path.append(str(TESTS / "helpers"))
    import insides
    import models

    return SimpleNamespace(MODELS=models.MODELS, assert_same=models.assert_same, tighten=insides.tighten)


def as_a_gpu_deals_out(report: Report) -> None:
    """Let the CPU, where it stands in for a GPU, deal points out in chunks as a GPU does."""
    if wp.get_device(report.device).is_cpu:
        buffers.CPU_CHUNK = CHUNK


def in_steps_of(sim: wr.Simulation, steps: int, count: int) -> wr.Simulation:
    """Do so many steps, at most ``count`` by one call."""
    while sim.step_count < steps:
        sim.step(min(count, steps - sim.step_count))
    return sim


def check_model(report: Report, stages: Any, name: str) -> None:
    """Do a model's steps one by one, recorded, in rows, and in buffers that are too small; compare with the CPU."""
    model, steps = stages.MODELS[name]
    steps, begin = min(steps, 6) if report.small else steps, time.monotonic()
    plain = in_steps_of(model(device=report.device, capture=False), steps, 1)
    row = {"model": name, "steps": steps, "points": plain.network.point_count}
    row |= {"cutoffs": len(plain.history.cutoffs), "joins": len(plain.history.collisions)}

    def tight() -> wr.Simulation:
        sim = model(device=report.device)
        stages.tighten(sim)
        return in_steps_of(sim, steps, steps)

    ways = {
        "recorded": lambda: in_steps_of(model(device=report.device), steps, 1),
        "rows": lambda: in_steps_of(model(device=report.device), steps, 16),
        "tight": tight,
    }
    for way, run in ways.items():
        try:
            stages.assert_same(run(), plain)
            row[way] = "same"
        except Exception as error:
            row[way] = "other"
            report.fail(f"{name}, {way} against plain: {type(error).__name__}: {one_line(error)}")
    row["apart_m"] = apart_from_cpu(report, model, name)
    report.add("models", row | {"seconds": time.monotonic() - begin})


def apart_from_cpu(report: Report, model: Any, name: str, steps: int = 3) -> float | None:
    """Greatest distance in m between coordinates of this device and the CPU; None where the points are not the same."""
    before, buffers.CPU_CHUNK = buffers.CPU_CHUNK, CHUNK
    try:
        here, cpu = model(device=report.device), model(device="cpu", threads=1)
        for sim in (here, cpu):
            in_steps_of(sim, steps, steps)
    finally:
        buffers.CPU_CHUNK = before
    if not np.array_equal(here.network.starts(), cpu.network.starts()):
        counts = [sim.network.point_count for sim in (here, cpu)]
        report.fail(f"{name}: after {steps} steps {counts[0]} points in other places than the CPU's {counts[1]}")
        return None
    apart = float(np.abs(here.network.points() - cpu.network.points()).max())
    if not apart <= APART[here.network.dtype]:
        report.fail(
            f"{name}: {apart:.3g} m from the CPU after {steps} steps, {APART[here.network.dtype]:g} are allowed"
        )
    return apart


def check_phases(report: Report, stages: Any, name: str) -> None:
    """Check every phase of every step of a model, which changes no bit."""
    model, steps = stages.MODELS[name]
    steps = min(steps, 4 if report.small else 30)
    runs = [in_steps_of(model(device=report.device, check=check), steps, steps) for check in (False, True)]
    stages.assert_same(*runs)
    report.tell(checked=f"{name}, {steps} steps")


# ---- the same bits again


def repeat_section(report: Report) -> None:
    """Two runs from the same start give the same bits, with so many points that the order of sums would be seen."""
    stages = model_table()
    as_a_gpu_deals_out(report)
    points, steps = (20_000, 5) if report.small else (1_000_000, 30)
    for channels, dtype in ((points // 1000, "float64"), (1, "float64"), (points // 1000, "float32")):
        what = f"{points} points in {channels} channel{'s' * (channels != 1)}, {dtype}"
        report.attempt(what, lambda c=channels, d=dtype: run_twice(report, stages, points, c, steps, d))


def run_twice(report: Report, stages: Any, points: int, channels: int, steps: int, dtype: str) -> None:
    """Compare two runs."""
    network, begin = rivers(points, channels, report.small), time.monotonic()
    sims = [wr.Simulation(network, device=report.device, dtype=dtype) for _ in range(2)]
    for sim in sims:
        in_steps_of(sim, steps, steps)
    row = {"points": sims[0].network.point_count, "channels": channels, "dtype": dtype, "steps": steps}
    row |= {"cutoffs": len(sims[0].history.cutoffs), "same": True, "sha256": [fingerprint(sim) for sim in sims]}
    try:
        stages.assert_same(*sims)
    except AssertionError as error:
        row["same"] = False
        report.fail(f"{points} points, {channels} channels, {dtype}: two runs differ: {one_line(error)}")
    report.add("runs", row | {"seconds": time.monotonic() - begin})


@functools.lru_cache(maxsize=4)
def rivers(points: int, channels: int, small: bool) -> wr.RiverNetwork:
    """Rivers in full bend on the CPU, as ``bench.synthetic_network`` lays them out; small ones are young."""
    young: dict[str, Any] = {"river_points": 500, "years": 5.0} if small else {}
    lines = bench.lay_out(bench.cut_lines([points // channels] * channels, **young))
    return wr.RiverNetwork.from_polylines(lines, width=bench.WIDTH)


def fingerprint(sim: wr.Simulation) -> str:
    """A short hash of all points: what to hold against the same run elsewhere."""
    count = sim.network.point_count
    return hashlib.sha256(sim.network.point_xy.numpy()[:count].tobytes()).hexdigest()[:16]


# ---- compute-sanitizer

WORKLOAD = ("tree in parts", "paths")


def sanitizer_section(report: Report) -> None:
    """Small plain runs under compute-sanitizer: no access out of bounds, and no race in shared memory."""
    on_gpu = wp.get_device(report.device).is_cuda
    command = [sys.executable, __file__, report.device, *WORKLOAD[: 1 if report.small else None]]
    tool = find_sanitizer() if on_gpu else None
    if tool is None:
        # What would run under it still has to run.
        subprocess.run(command, check=True, timeout=max(1.0, report.left() - CLOSING), env=one_core())
        raise SkippedError("no compute-sanitizer")
    for name, share in (("memcheck", 0.6), ("racecheck", 1.0)):
        sanitize(report, tool, name, command, share * (report.left() - CLOSING))


def find_sanitizer() -> str | None:
    """Path of compute-sanitizer, which a toolkit has and a driver has not."""
    homes = [os.environ.get(name) for name in ("CUDA_HOME", "CUDA_PATH")] + sorted(glob.glob("/usr/local/cuda*"))
    places = [f"{home}/{folder}" for home in homes if home for folder in ("bin", "compute-sanitizer")]
    return shutil.which("compute-sanitizer") or shutil.which("compute-sanitizer", path=os.pathsep.join(places))


def sanitize(report: Report, tool: str, name: str, command: list[str], seconds: float) -> None:
    """Run a command under one of the tools."""
    flags = ["--tool", name, "--error-exitcode", "99", "--print-limit", "20"]
    if name == "memcheck":
        flags += ["--report-api-errors", "no"]  # a query that fails is none of ours
    begin, row = time.monotonic(), {"tool": name, "summary": None}
    try:
        done = subprocess.run(
            [tool, *flags, *command],
            capture_output=True,
            text=True,
            check=False,
            timeout=max(1.0, seconds),
            env=one_core(),
        )
    except subprocess.TimeoutExpired:
        report.fail(f"{name}: not done after {seconds:.0f} s")
    else:
        print(done.stdout, done.stderr, sep="\n", flush=True)
        row["summary"] = sanitizer_summary(done.stdout + done.stderr)
        if done.returncode != 0 or row["summary"] is None:
            report.fail(f"{name}: exit code {done.returncode}, {row['summary'] or 'no summary'}")
    report.add("tools", row | {"seconds": time.monotonic() - begin})


def sanitizer_summary(text: str) -> str | None:
    """The line in which compute-sanitizer counts what it found."""
    found = re.findall(r"SUMMARY: (.*)", text)
    return found[-1].strip() if found else None


def workload(device: str, names: list[str]) -> None:
    """What compute-sanitizer looks at: a few steps of models of some 2,000 points, launch by launch."""
    stages = model_table()
    for name in names:
        model, _ = stages.MODELS[name]
        sim = in_steps_of(model(device=device, capture=False), 2, 1)
        print(f"{name}: {sim}", flush=True)


if __name__ == "__main__":
    workload(sys.argv[1], sys.argv[2:])
