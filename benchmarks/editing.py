"""What editing costs while a river moves: controls in a step, an edit and the step after it, and a stroke of a brush.

The scene is of the size of the paper's Fig. 29: 10,000 points on 35 x 35 km, a terrain of 1,024 x 1,024 cells, and 60
controls. The peer is a plain step of the same run, taken in turns.
"""

from __future__ import annotations

import argparse
import copy
import os
import time
from collections.abc import Callable, Iterator

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
from machine import machine, write_result

import warpriver as wr
from warpriver import edits

SIDE, CELLS, CHANNELS, SPACING, WIDTH = 35_000.0, 1024, 16, 50.0, 60.0
CONTROLS, RADIUS = 60, 2_500.0
STROKES = (250.0, 500.0, 1_000.0, 2_000.0)


def scene(device: str, controls: bool) -> wr.Simulation:
    """Rivers side by side on a gentle slope, after forty steps."""
    rng = np.random.default_rng(0)
    lines = [wr.generate.noisy_line(30_000.0, SPACING, 50.0, k) + [2_000.0, 2_000.0 + 2_000.0 * k] for k in range(16)]
    network = wr.RiverNetwork.from_polylines(lines, width=WIDTH, device=device)
    cell = SIDE / CELLS
    height = np.broadcast_to(40.0 - 1e-3 * cell * np.arange(CELLS), (CELLS, CELLS))
    terrain = wr.Terrain(height, cell, (0.0, SIDE), device=device)
    places = rng.uniform(2_000.0, 33_000.0, (CONTROLS, 2))
    repellers = [wr.Repeller(center=(x, y), radius=RADIUS, strength=0.5) for x, y in places] if controls else []
    params = wr.MeanderParams(migration_rate=20.0)
    sim = wr.Simulation(network, params, terrain=terrain, controls=repellers, threads=1)
    sim.run(steps=40, record_every=10**6)
    return sim


def seconds(call: Callable[[], object]) -> float:
    """Time of one call."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def shown_edits(sim: wr.Simulation) -> Iterator[tuple[str, edits.Edit]]:
    """One edit of each local kind, on the rivers as they are."""
    lines = sim.network.polylines()

    def point(channel: int, part: float) -> np.ndarray:
        return lines[channel][int(part * len(lines[channel]))]

    ids = sim.network.channel_id
    here = point(3, 0.4)
    yield "move a point", edits.MovePoint(int(ids[3]), tuple(here), to=tuple(here + [0.0, 200.0]), radius=800.0)
    yield "lock a point", edits.LockPoint(int(ids[4]), tuple(point(4, 0.5)))
    yield "split a channel", edits.SplitChannel(int(ids[5]), tuple(point(5, 0.5)))
    foot = point(6, 0.6)
    yield "add a channel", edits.AddChannel(np.array([foot + [-900.0, 700.0], foot]), width=20.0)
    a, b = point(7, 0.3), point(7, 0.33)
    yield "redraw a section", edits.RedrawSection(int(ids[7]), np.array([a, 0.5 * (a + b) + [0.0, 150.0], b]))
    yield "set a width", edits.SetChannel(int(ids[8]), width=80.0)
    yield "raise the ground", edits.EditTerrain("raise", center=tuple(point(9, 0.5)), radius=500.0, amount=5.0)
    moved = [*sim.controls[:-1], wr.Repeller(center=tuple(point(2, 0.5)), radius=RADIUS, strength=0.5)]
    yield "move a control", wr.meander.SetControls(moved)


def edit_rows(sim: wr.Simulation, rounds: int) -> list[dict[str, float]]:
    """Medians over some rounds, each on a copy of the run: a plain step, the edit, and the step after it."""
    taken: dict[str, list[tuple[float, float, float]]] = {}
    for _ in range(rounds):
        copied = copy.deepcopy(sim)
        for name, edit in shown_edits(copied):
            copied.step(2)
            plain = seconds(lambda run=copied: run.step(1))
            apply = seconds(lambda run=copied, edit=edit: run.apply(edit))
            after = seconds(lambda run=copied: run.step(1))
            taken.setdefault(name, []).append((plain, apply, after))
    rows = []
    for name, times in taken.items():
        plain, apply, after = np.median(np.array(times), axis=0)
        rows.append({
            "case": "edit", "edit": name, "plain_ms": 1e3 * plain, "edit_ms": 1e3 * apply, "step_ms": 1e3 * after,
            "ratio": (apply + after) / plain,
        })  # fmt: skip
        print(f"{name:<20} {1e3 * apply:>9.2f} {1e3 * after:>9.2f} {1e3 * plain:>9.2f} {rows[-1]['ratio']:>7.1f}")
    return rows


def control_row(plain: wr.Simulation, steered: wr.Simulation, rounds: int) -> dict[str, float]:
    """Steps with and without controls in turns, by the shortest, a point each: rivers under controls grow longer."""
    best = {"plain": np.inf, "steered": np.inf}
    for _ in range(rounds):
        for name, sim in (("plain", plain), ("steered", steered)):
            best[name] = min(best[name], seconds(lambda sim=sim: sim.step(1)) / sim.network.point_count)
    row = {
        "case": "controls", "points": steered.network.point_count, "controls": CONTROLS,
        "plain_ns_per_point": 1e9 * best["plain"], "steered_ns_per_point": 1e9 * best["steered"],
        "ratio": best["steered"] / best["plain"],
    }  # fmt: skip
    print(f"a step with {CONTROLS} controls over one without, a point: {row['ratio']:.2f}")
    return row


def stroke_rows(sim: wr.Simulation, rounds: int) -> list[dict[str, float]]:
    """Strokes of growing radius on the ground, against the cells that they touch."""
    rows = []
    for radius in STROKES:
        edit = edits.EditTerrain("raise", center=(0.5 * SIDE, 0.5 * SIDE), radius=radius, amount=0.01)
        took = min(seconds(lambda edit=edit: sim.apply(edit)) for _ in range(rounds))
        cells = np.pi * (radius / (SIDE / CELLS)) ** 2
        rows.append({"case": "stroke", "radius": radius, "cells": cells, "ms": 1e3 * took})
        print(f"a stroke of {radius:>6.0f} m, {cells:>8,.0f} cells: {1e3 * took:.2f} ms")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer rounds")
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("-o", "--out", help="JSON to write (default results/editing-DEVICE.json)")
    options = parser.parse_args()
    rounds = 5 if options.quick else 25
    plain, steered = scene(options.device, False), scene(options.device, True)
    rows = [control_row(plain, steered, 4 * rounds)]
    print(f"{'edit':<20} {'edit ms':>9} {'step ms':>9} {'plain ms':>9} {'ratio':>7}")
    rows += edit_rows(steered, rounds)
    rows += stroke_rows(steered, rounds)
    result = {"benchmark": "editing", "machine": machine(options.device), "rows": rows}
    write_result(result, options.out, f"editing-{options.device.split(':')[0]}")


if __name__ == "__main__":
    main()
