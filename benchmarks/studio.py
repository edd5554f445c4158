"""What the studio takes from an edit to the changed buffer on the page, while the run plays, and what a frame weighs.

A headless Chromium draws by software; so what counts is when the page has the edit's state in its buffer, not when it
is on the screen. Needs ``warpriver[studio]`` and Chromium.
"""

from __future__ import annotations

import argparse
import json
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
from warpriver.studio.worker import begin_folder

# Cells a side of the ground, their size in m; what is aimed at in ms by points.
CELLS, CELL, GOALS = 2048, 20.0, {10_000: 33.0, 100_000: 100.0}
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
  const edit = { edit: "MovePoint", channel: s.id[c], at, to: [at[0], at[1] + 0.1 * width], radius: 8 * width };
  studio.link.ask("edit", { edit }).then((answer) => { command = answer.command; check(); }, () => finish([NaN, 0]));
}))()"""


def rivers(points: int) -> wr.Simulation:
    """Rivers side by side over a plain of 41 x 41 km, with so many points."""
    ground = wr.generate.tilted_plain((CELLS, CELLS), CELL, 2e-4)
    side = 0.94 * CELLS * CELL
    spacing = 50.0 if points <= 20_000 else 25.0
    # They lengthen while they are measured.
    count = max(1, round(points * spacing / side / 1.3))
    lines = [
        wr.generate.noisy_line(side, spacing, 1.5 * spacing, seed)
        + [0.03 * CELLS * CELL, (seed + 0.5) * CELLS * CELL / count]
        for seed in range(count)
    ]
    return wr.Simulation(wr.RiverNetwork.from_polylines(lines, width=spacing), terrain=ground)


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
            for _ in range(edits):
                ms, weight = browser.run(EDIT)
                taken.append(ms)
                weights.append(weight)
                time.sleep(0.05)
            spent = time.monotonic() - began
            steps = (browser.run("studio.live.step") - step) / spent
            frames = (browser.run("studio.seen") - seen) / spent
            step_ms, live = browser.run("[studio.live.stepMs, studio.live.points]")
        finally:
            browser.close()
            process.terminate()
            process.wait(20)
    times = np.array(taken, dtype=float)
    done = np.isfinite(times)
    return {
        "points_asked": points, "points": live, "cells": CELLS * CELLS, "edits": int(done.sum()),
        "p50_ms": float(np.percentile(times[done], 50)), "p95_ms": float(np.percentile(times[done], 95)),
        "goal_ms": GOALS.get(points), "bytes_a_frame": int(np.median(weights)), "steps_a_second": steps,
        "frames_a_second": frames, "step_ms": step_ms, "load": os.getloadavg()[0],
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="10,000 points only, and fewer edits")
    parser.add_argument("--edits", type=int, help="edits of each size (default 200; with --quick 40)")
    parser.add_argument("-o", "--out", type=Path, default=RESULTS / "studio-cpu.json", help="result file")
    options = parser.parse_args()
    if CHROMIUM is None:
        print("Chromium is not installed: apt-get install chromium", file=sys.stderr)
        return 1
    rows = []
    for points in (10_000,) if options.quick else (10_000, 100_000):
        row = measure(points, options.edits or (40 if options.quick else 200))
        print(
            f"{row['points']:>8,} points: edit to buffer {row['p50_ms']:.1f} ms (p50), {row['p95_ms']:.1f} ms (p95, "
            f"goal {row['goal_ms']:g}); {row['bytes_a_frame']:,} bytes a frame; {row['steps_a_second']:.1f} steps "
            f"a second of {row['step_ms']:.1f} ms, {row['frames_a_second']:.1f} frames a second; load {row['load']:.1f}"
        )
        rows.append(row)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    content = {"benchmark": "studio", "machine": machine("cpu"), "rows": rows}
    options.out.write_text(json.dumps(content, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
