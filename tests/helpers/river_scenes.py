"""Small riverscapes of single types, and of a junction, for the tests of beds."""

import numpy as np

import warpriver as wr
from warpriver.riverscape import Riverscape


def valley_floor(slope, rows=24, columns=50, cell=10.0, curve=1e-4):
    """Ground that falls to the east along y = 120 m, and rises to both sides."""
    x, y = (np.arange(columns) + 0.5) * cell, (rows - np.arange(rows) - 0.5) * cell
    x, y = np.meshgrid(x, y)
    return wr.Terrain(100.0 - slope * x + curve * (y - 0.5 * rows * cell) ** 2, cell, (0.0, rows * cell))


def one_river(kind, slope, flow, length=200.0, *, detail=0.5, seed=1, curve=1e-4, device="cpu", **options):
    """One channel of a type down such ground."""
    x = np.linspace(60.0, 60.0 + length, 12)
    network = wr.RiverNetwork.from_polylines([np.column_stack([x, 120.0 + 0.0 * x])], width=4.0, slope=[slope])
    ground = valley_floor(slope, curve=curve)
    return Riverscape(ground, network, kind, flow=flow, detail=detail, seed=seed, device=device, **options)


def junction(kinds=("B", "B", "C"), *, detail=0.5, seed=1, device="cpu"):
    """Two channels that meet and go on as one."""
    s = np.linspace(0.0, 1.0, 12)[:, None]
    node = np.array([240.0, 120.0])
    lines = [
        np.array([60.0, 160.0]) * (1 - s) + node * s,
        np.array([60.0, 70.0]) * (1 - s) + node * s,
        node * (1 - s) + np.array([440.0, 120.0]) * s,
    ]
    network = wr.RiverNetwork.from_polylines(lines, width=4.0, slope=[0.02] * 3, drainage_area=[4e6, 2e6, 6e6])
    return Riverscape(valley_floor(0.02), network, kinds, detail=detail, seed=seed, device=device)
