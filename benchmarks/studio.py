"""What the studio takes from an edit to the changed buffer on the page, while the run plays, and what a frame weighs.

A headless Chromium draws by software; so what counts is when the page has the edit's state in its buffer, not when it
is on the screen. The network lies on a ground of 2048 x 2048 cells, has at least so many points, and keeps them. Edits
are measured in windows; that of the best one tells what the machine can do where other programs disturb the others.

``--soak MINUTES`` plays for so long instead, with a map on the ground half of the time and edits now and then, and
tells how the memory of each process and of the page grows. Needs ``warpriver[studio]`` and Chromium.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "studio"))
from browser import CHROMIUM, Browser
from machine import RESULTS, machine

import warpriver as wr
from warpriver.studio.folder import begin_folder

# Cells a side of the ground, their size in m; what is aimed at in ms by points.
CELLS, CELL, GOALS = 2048, 20.0, {10_000: 33.0, 100_000: 100.0}
# Migration rate in m/yr of the network that keeps its size: all points move, and few bends are cut off.
RATE = 5.0
# Windows into which the edits are divided, and seconds after which no further one is done.
WINDOWS, SECONDS = 5, 60.0
# Seconds between two looks at the memory, and minutes with a map and without one.
LOOK, TURN = 10.0, 2.0
# Moves a point of a channel by a tenth of its width, and waits for the state that holds it. The listener is behind that
# of the page, which has the state in its buffer by then.
EDIT = """(() => new Promise((done) => {
  const s = studio.live, c = Math.floor(Math.random() * s.channels), i = Math.floor((s.start[c] + s.start[c + 1]) / 2);
  const at = [s.xy[2 * i] + studio.origin[0], s.xy[2 * i + 1] + studio.origin[1]], width = s.size[4 * c];
  const began = performance.now(), heard = [];
  let command = Infinity;
  const finish = (value) => { studio.link.removeEventListener("state", hear); done(value); };
  const check = () => {
    const found = heard.find(([edits]) => edits >= command);
    if (found) finish([found[1] - began, found[2]]);
  };
  const hear = ({ detail }) => { heard.push([detail.edits, performance.now(), detail.xy.buffer.byteLength]); check(); };
  studio.link.addEventListener("state", hear);
  setTimeout(() => finish([NaN, -1]), 30000);
  const edit = { edit: "MovePoint", channel: s.id[c], at, to: [at[0], at[1] + 0.1 * width], radius: 8 * width };
  studio.link.ask("edit", { edit }).then((answer) => { command = answer.command; check(); }, () => finish([NaN, 0]));
}))()"""


def rivers(points: int) -> wr.Simulation:
    """Rivers side by side over a plain of 41 x 41 km, with at least so many points."""
    ground = wr.generate.tilted_plain((CELLS, CELLS), CELL, 2e-4)
    side = 0.94 * CELLS * CELL
    spacing = 50.0 if points <= 20_000 else 25.0
    count = math.ceil(points * spacing / side)
    lines = [
        wr.generate.noisy_line(side, spacing, 1.5 * spacing, seed)
        + [0.03 * CELLS * CELL, (seed + 0.5) * CELLS * CELL / count]
        for seed in range(count)
    ]
    network = wr.RiverNetwork.from_polylines(lines, width=spacing)
    return wr.Simulation(network, wr.MeanderParams(migration_rate=RATE), terrain=ground)


def serve(folder: Path) -> tuple[subprocess.Popen[str], str]:
    """Serve a session, and return the process and the link."""
    command = [sys.executable, "-m", "warpriver", "studio", "--folder", str(folder), "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    found = re.search(r"http://\S+", process.stdout.readline())
    if not found:
        raise RuntimeError("the studio did not start")
    return process, found[0]


def measure(points: int, edits: int) -> dict:
    """Latencies of edits with so many points."""
    with tempfile.TemporaryDirectory() as box:
        simulation = rivers(points)
        begin_folder(Path(box) / "session", simulation)
        process, link = serve(Path(box) / "session")
        browser = Browser()
        try:
            browser.open(link)
            browser.wait("window.studio?.state && studio.scene.frames > 1", 180)
            browser.run("studio.ask('play', { rate: 30 })")
            browser.wait("studio.live.step > 20", 120)
            step, seen, began = browser.run("studio.live.step"), browser.run("studio.seen"), time.monotonic()
            taken, weights = [], []
            used = spent_by(process.pid, browser)
            while len(taken) < edits and time.monotonic() - began < SECONDS:
                ms, weight = browser.run(EDIT)
                taken.append(ms)
                weights.append(weight)
                time.sleep(0.05)
            spent = time.monotonic() - began
            shares = {name: (t - used[name]) / spent for name, t in spent_by(process.pid, browser).items()}
            steps = (browser.run("studio.live.step") - step) / spent
            frames = (browser.run("studio.seen") - seen) / spent
            step_ms, live = browser.run("[studio.live.stepMs, studio.live.points]")
        finally:
            browser.close()
            process.terminate()
            process.wait(20)
    times = np.array(taken, dtype=float)
    done, lost = np.isfinite(times), weights.count(-1)
    best = min(np.percentile(part, 95) for part in np.array_split(times[done], WINDOWS))
    return {
        "points_asked": points, "points": live, "cells": CELLS * CELLS, "edits": int(done.sum()), "lost": lost,
        "refused": int((~done).sum()) - lost,
        "p50_ms": float(np.percentile(times[done], 50)), "p95_ms": float(np.percentile(times[done], 95)),
        "best_window_p95_ms": float(best), "slowest_ms": float(times[done].max()), "goal_ms": GOALS.get(points),
        "bytes_a_frame": int(np.median(np.array(weights)[done])), "steps_a_second": steps, "processor_share": shares,
        "frames_a_second": frames, "step_ms": step_ms, "load": os.getloadavg()[0],
    }  # fmt: skip


# ---- what the processes take


def processes(root: int) -> dict[int, int]:
    """Parents of all processes that descend from one."""
    parents = {}
    for name in os.listdir("/proc"):
        if name.isdigit():
            with contextlib.suppress(OSError):
                parents[int(name)] = int(Path(f"/proc/{name}/stat").read_text().rpartition(")")[2].split()[1])
    found = {root}
    for _ in range(6):
        found |= {pid for pid, parent in parents.items() if parent in found}
    return {pid: parents.get(pid, 0) for pid in found}


def spent_by(server: int, browser: Browser) -> dict[str, float]:
    """Seconds of the processor that the server's processes, and those of the browser, have used."""
    found = {}
    for name, root in (("studio", server), ("browser", browser.process.pid)):
        found[name] = 0.0
        for pid in processes(root):
            with contextlib.suppress(OSError):
                fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
                found[name] += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return found


def resident(pid: int) -> float:
    """Resident memory of a process in MB, 0 for one that has ended."""
    with contextlib.suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return 0.0


def look(server: int, browser: Browser) -> dict[str, float]:
    """Memory of everything in MB: each process, and what the page's scripts hold after a collection."""
    browser.call("HeapProfiler.collectGarbage")
    heap = browser.call("Runtime.getHeapUsage")
    held = heap["usedSize"] + heap.get("backingStorageSize", 0.0)
    seen = {"server": resident(server)}
    for pid in processes(server):
        with contextlib.suppress(OSError):
            name = Path(f"/proc/{pid}/comm").read_text().strip()
            if name in ("wr-simulation", "wr-maps"):
                seen[name[3:]] = resident(pid)
    for kind in ("renderer", "gpu-process"):
        theirs = [pid for pid in processes(browser.process.pid) if f"--type={kind}" in _words(pid)]
        seen[f"chromium {kind}"] = max(map(resident, theirs), default=0.0)
    return seen | {"page": held / 1e6}


def _words(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_text()
    return ""


def soak(minutes: float) -> dict:
    """Play for so many minutes; memory of all processes over the time, and its slope over the second half."""
    with tempfile.TemporaryDirectory() as box:
        # The built-in basin: a new folder.
        process, link = serve(Path(box) / "session")
        browser = Browser()
        samples: list[dict[str, float]] = []
        try:
            browser.open(link)
            browser.wait("window.studio?.state && studio.scene.frames > 1", 180)
            browser.run("studio.ask('play', { rate: 60 })")
            began, mapped = time.monotonic(), False
            while (now := time.monotonic() - began) < 60.0 * minutes:
                if mapped != (now / 60.0 % (2.0 * TURN) > TURN):
                    mapped = not mapped
                    browser.run(f"studio.ask('map', {{ name: {json.dumps('age' if mapped else None)} }})")
                edited = browser.run(EDIT)[0]
                if len(samples) % 6 == 5:
                    browser.run("studio.ask('undo')")
                step = browser.run("studio.live.step")
                samples.append({"minute": now / 60.0, "step": step, "edit_ms": edited, **look(process.pid, browser)})
                print(" ".join(f"{key} {value or 0:.1f}" for key, value in samples[-1].items()), flush=True)
                time.sleep(max(0.0, LOOK - (time.monotonic() - began - now)))
            errors = list(browser.console)
        finally:
            browser.close()
            process.terminate()
            process.wait(20)
    half = [sample for sample in samples if sample["minute"] >= 0.5 * minutes]
    names = [name for name in samples[-1] if name not in ("minute", "step", "edit_ms")]
    slopes, spans = {}, {}
    for name in names:
        line = np.array([[sample["minute"], sample[name]] for sample in half if name in sample])
        slopes[name] = float(np.polyfit(*line.T, 1)[0]) if len(line) > 2 else 0.0
        spans[name] = [float(line[:, 1].min()), float(line[:, 1].max())]
    return {
        "minutes": minutes, "steps": samples[-1]["step"], "mb_a_minute": slopes, "mb_second_half": spans,
        "errors": errors, "samples": samples, "load": os.getloadavg()[0],
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="10,000 points only, and fewer edits")
    parser.add_argument("--edits", type=int, help="edits of each size (default 200; with --quick 40)")
    parser.add_argument("--soak", type=float, metavar="MINUTES", help="play for so long, and tell what memory does")
    parser.add_argument("-o", "--out", type=Path, help="result file (default results/studio-cpu.json)")
    options = parser.parse_args()
    if CHROMIUM is None:
        print("Chromium is not installed: apt-get install chromium", file=sys.stderr)
        return 1
    if options.soak is not None:
        found = soak(options.soak)
        for name, slope in found["mb_a_minute"].items():
            low, high = found["mb_second_half"][name]
            print(f"{name:>20}: {slope:+8.3f} MB a minute over the second half, {low:.1f} to {high:.1f} MB")
        print(f"{found['steps']:,} steps in {options.soak:g} minutes; errors of the page: {found['errors'] or 'none'}")
        write(options.out or RESULTS / "studio-soak-cpu.json", {"soak": found})
        return 0
    rows = []
    for points in (10_000,) if options.quick else (10_000, 100_000):
        row = measure(points, options.edits or (40 if options.quick else 200))
        print(
            f"{row['points']:>8,} points: {row['edits']} edits, {row['lost']} lost; "
            f"edit to buffer {row['p50_ms']:.1f} ms (p50), {row['p95_ms']:.1f} ms (p95; "
            f"of the best of {WINDOWS} windows {row['best_window_p95_ms']:.1f}, goal {row['goal_ms']:g}); "
            f"{row['bytes_a_frame']:,} bytes a frame; {row['steps_a_second']:.1f} steps "
            f"a second of {row['step_ms']:.1f} ms, {row['frames_a_second']:.1f} frames a second; "
            f"processor: studio {100 * row['processor_share']['studio']:.0f} %, browser "
            f"{100 * row['processor_share']['browser']:.0f} %; load {row['load']:.1f}"
        )
        rows.append(row)
    write(options.out or RESULTS / "studio-cpu.json", {"rows": rows})
    return 0


def write(path: Path, found: dict) -> None:
    """Write what was measured."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"benchmark": "studio", "machine": machine("cpu")} | found, indent=2) + "\n")


if __name__ == "__main__":
    sys.exit(main())
