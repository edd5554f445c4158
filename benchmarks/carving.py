"""What carving costs for each cell that it touches: with finer cells, and with more rivers; and a distance transform.

The peer is the first half of carving as it is done with a raster library, in the same run: the channels as cells, and
the distance of every cell to the nearest one with its place (`scipy.ndimage.distance_transform_edt`), over the whole
raster.
"""

from __future__ import annotations

import argparse
import os

# One core: set before NumPy is loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np
from machine import machine, write_result
from scipy.ndimage import distance_transform_edt

import warpriver as wr
from warpriver.bench import min_seconds
from warpriver.landscape import carve, plain_under

# Rivers side by side: length and distance of their axes, m; widths, m.
LENGTH, APART, WIDTHS = 16_000.0, 2_500.0, (40.0, 60.0, 90.0, 130.0)
ROUNDS = 3


def rivers(count: int) -> wr.RiverNetwork:
    """Sine-generated rivers of four widths and a sinuosity of 2.2, points a width apart."""
    lines, widths = [], []
    for k in range(count):
        width = WIDTHS[k % len(WIDTHS)]
        wavelength = 10.0 * width
        line = wr.generate.sine_generated(wavelength, 1.6, LENGTH / wavelength, width)
        lines.append(line + [0.0, k * APART])
        widths.append(width)
    return wr.RiverNetwork.from_polylines(lines, widths)


def edt_seconds(carved: wr.landscape.Carved) -> float:
    """Time of the distance transform from the cells of the channels' points."""
    (west, north), size, shape = carved.water.origin, carved.water.cell_size, carved.water.shape
    xy = carved.network.points()
    row = np.clip(((north - xy[:, 1]) // size).astype(int), 0, shape[0] - 1)
    column = np.clip(((xy[:, 0] - west) // size).astype(int), 0, shape[1] - 1)
    dry = np.ones(shape, bool)
    dry[row, column] = False
    return min_seconds(lambda: distance_transform_edt(dry, return_indices=True), rounds=1)


def measure(count: int, cell: float, device: str) -> dict[str, float]:
    """One network on one plain."""
    network = rivers(count).to(device)
    ground = plain_under(network, cell)
    carved = carve(ground, network)
    took, peer = min_seconds(lambda: carve(ground, network), rounds=ROUNDS), edt_seconds(carved)
    cells = int(np.prod(ground.shape))
    row = {
        "channels": count, "points": network.point_count, "cell": cell, "cells": cells,
        "touched": carved.report.cells, "seconds": took, "edt_seconds": peer,
        "ns_per_touched": 1e9 * took / carved.report.cells,
    }  # fmt: skip
    print(
        f"{count:>8} {network.point_count:>8} {cell:>6.1f} {cells:>11,} {carved.report.cells:>10,} {took:>9.3f} "
        f"{row['ns_per_touched']:>8.0f} {peer:>9.3f}"
    )
    return row


def exponent(rows: list[dict[str, float]], of: str) -> float:
    """Exponent with which seconds grow."""
    return float(np.polyfit(np.log([r[of] for r in rows]), np.log([r["seconds"] for r in rows]), 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="up to a million cells")
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    parser.add_argument("-o", "--out", help="JSON to write (default results/carving-DEVICE.json)")
    options = parser.parse_args()
    heads = ("channels", "points", "cell m", "cells", "touched", "seconds", "ns/cell", "edt s")
    print("{:>8} {:>8} {:>6} {:>11} {:>10} {:>9} {:>8} {:>9}".format(*heads))
    fine = [40.0, 20.0] if options.quick else [40.0, 20.0, 10.0, 5.0]
    many = [1, 2, 4] if options.quick else [2, 4, 8, 16, 32]
    by_cell = [measure(4, cell, options.device) for cell in fine]
    by_count = [measure(count, 20.0, options.device) for count in many]
    found = {"cells": exponent(by_cell, "touched"), "channels": exponent(by_count, "touched")}
    print(
        f"seconds grow as touched cells^{found['cells']:.2f} with finer cells, ^{found['channels']:.2f} with channels"
    )
    result = {
        "benchmark": "carving",
        "machine": machine(options.device, ("scipy",)),
        "rows": by_cell + by_count,
        "exponents": found,
    }
    write_result(result, options.out, f"carving-{options.device.split(':')[0]}")


if __name__ == "__main__":
    main()
