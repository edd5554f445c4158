"""What landscape maps cost: nanoseconds a cell that a channel reaches, beside a distance transform a frame and a sum.

The runs are rivers side by side that have meandered, 100,000 points in all, on 2048 x 2048 cells of 10 m. The peer does
with SciPy what the two sums need and no more: the course as cells, ``distance_transform_edt``, both falloffs of the
distance over one width, and their sums. It knows no widths that differ, no ages, no sides and no events. All by one
thread, timed by the processor's time of this process; both in turns.
"""

from __future__ import annotations

import argparse
import os
import pickle
import tempfile
import time
from pathlib import Path

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
from machine import machine, write_result
from scipy.ndimage import distance_transform_edt

import warpriver as wr
from warpriver.landscape import Landscape, moisture_falloff, sediment_falloff

CELLS, CELL = 2048, 10.0
SIDE = CELLS * CELL
# Widths of the rivers, m, and records of each; as many rivers as have 100,000 points at a spacing of one width.
WIDTHS = {5.0: 30, 10.0: 100, 20.0: 30}
POINTS, EVERY = 100_000, 10
PEER_FRAMES = 4
# Steps over which a run with and without records is timed.
TIMED_STEPS = 150


def rivers(width: float, points: int) -> wr.RiverNetwork:
    """Rivers from west to east, evenly spaced, crooked from the start."""
    each = int(1.3 * SIDE / width)
    count = max(1, points // each)
    lines = []
    for k in range(count):
        heading = 0.9 * np.sin(2.0 * np.pi * (np.arange(4 * each) / 14.0 + k / 3.0)) * np.linspace(0.8, 1.1, 4 * each)
        line = width * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
        line = line[line[:, 0] < SIDE - 4.0 * width]
        lines.append(line + [2.0 * width, (k + 0.5) * SIDE / count])
    return wr.RiverNetwork.from_polylines(lines, width=width)


def recorded(width: float, points: int, records: int) -> tuple[wr.History, dict]:
    """A run of some records, and what recording costs its first steps, to a folder: processor time with and without."""
    params, spent = wr.MeanderParams(reference_width=100.0), {}
    for name, every in (("without", 10**9), ("with", EVERY)):
        sim = wr.Simulation(rivers(width, points), params, threads=1)
        sim.step(2)
        with tempfile.TemporaryDirectory() as folder:
            begin = time.process_time()
            sim.run(steps=TIMED_STEPS, record_every=every, store=Path(folder) / "run")
            spent[name] = time.process_time() - begin
            if name == "with" and records * EVERY > TIMED_STEPS:
                sim.run(steps=records * EVERY - TIMED_STEPS, record_every=every)
            # In memory, with all records.
            history = pickle.loads(pickle.dumps(sim.history))
    return history, {"seconds": spent, "recording_share": spent["with"] / spent["without"] - 1.0}


def peer_frame(network: wr.RiverNetwork, width: float, total: list[np.ndarray]) -> None:
    """One frame by SciPy: cells of the course, distances, falloffs, sums."""
    off = np.ones((CELLS, CELLS), bool)
    xy = np.concatenate([np.concatenate([line, 0.5 * (line[1:] + line[:-1])]) for line in network.polylines()])
    row, column = ((SIDE - xy[:, 1]) / CELL).astype(int), (xy[:, 0] / CELL).astype(int)
    inside = (row >= 0) & (row < CELLS) & (column >= 0) & (column < CELLS)
    off[row[inside], column[inside]] = False
    widths = distance_transform_edt(off) * (CELL / width)
    total[0] += moisture_falloff(widths)
    total[1] += sediment_falloff(widths)


def measure(width: float, points: int, records: int) -> dict:
    history, recording = recorded(width, points, records)
    landscape = Landscape(history, None, CELL, bounds=(0.0, 0.0, SIDE, SIDE), threads=1)
    landscape.lead_to(0)
    own, touched = [], landscape.touched
    peer: list[float] = []
    total = [np.zeros((CELLS, CELLS)) for _ in range(2)]
    last = len(history) - 1
    for k in range(1, last + 1):
        begin = time.process_time()
        landscape.lead_to(k)
        own.append(time.process_time() - begin)
        if k % max(1, last // PEER_FRAMES) == 0:
            network = history.networks[k]
            begin = time.process_time()
            peer_frame(network, width, total)
            peer.append(time.process_time() - begin)
    cells = (landscape.touched - touched) / len(own)
    begin = time.process_time()
    landscape.maps()
    finish = time.process_time() - begin
    row = {
        "width_m": width,
        "points": history.networks[last].point_count,
        "records": len(history),
        "touched_share": cells / CELLS**2,
        "seconds_a_record": float(np.mean(own)),
        "ns_a_touched_cell": 1e9 * float(np.mean(own)) / cells,
        "seconds_of_maps": finish,
        "peer_seconds_a_record": float(np.mean(peer)),
        "ratio": float(np.mean(peer)) / float(np.mean(own)),
        "recording": recording,
    }
    print(
        f"w = {width:g} m: {row['points']} points, {row['records']} records, {100 * row['touched_share']:.0f} % of the "
        f"cells touched: {1e3 * row['seconds_a_record']:.0f} ms a record, {row['ns_a_touched_cell']:.0f} ns a touched "
        f"cell; distance transform, sums {1e3 * row['peer_seconds_a_record']:.0f} ms, x {row['ratio']:.1f}; "
        f"recording adds {100 * recording['recording_share']:.1f} % to the run",
        flush=True,
    )
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="10 records")
    parser.add_argument("--records", type=int, help="records of each run (default 30, of the middle one 100)")
    parser.add_argument("-o", "--out", help="JSON to write (default results/landscape.json)")
    options = parser.parse_args()
    rows = [
        measure(width, POINTS, 10 if options.quick else options.records or records) for width, records in WIDTHS.items()
    ]
    result = {"benchmark": "landscape", "machine": machine("cpu", ("scipy",)), "rows": rows}
    write_result(result, options.out, "landscape")


if __name__ == "__main__":
    main()
