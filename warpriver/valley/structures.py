"""Structures that follow a synthetic valley's channel, as meshes: levees and bridges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.public import public
from warpriver.validate import shown
from warpriver.valley.stamps import MeshStamp
from warpriver.valley.valley import Valley

__all__ = ["bridge", "levee"]


# Sections of a levee along a bankfull width, and corners of a bridge's piers.
ALONG_WIDTH, AROUND_PIER = 4.0, 12


@public
def levee(
    valley: Valley,
    side: str = "left",
    *,
    start: float = 0.0,
    end: float = 1.0,
    offset: float = 5.0,
    height: float = 2.0,
    crest: float = 3.0,
    side_slope: float = 0.4,
) -> MeshStamp:
    """Make a levee along the channel: a mesh that raises the ground where it is higher.

    Args:
        valley: The valley that it stands in.
        side: "left" or "right" bank, looking downstream.
        start: Upstream end, 0 to 1 over the reach.
        end: Downstream end.
        offset: Distance from the bank to the middle of the crest, m.
        height: Crest above top of bank at its station, m.
        crest: Width of the crest, m.
        side_slope: Slope of both sides, m/m.

    Returns:
        Stamp for ``ValleyParams.stamps``.

    Raises:
        ValueError: A number out of range, or a levee that reaches over the bank.
    """
    if side not in ("left", "right"):
        raise InputError(f'side is {shown(side)}; give "left" or "right"')
    if not 0.0 <= start < end <= 1.0:
        raise InputError(f"start is {start:g} and end {end:g}; give 0 <= start < end <= 1")
    for name, value in (("height", height), ("crest", crest), ("side_slope", side_slope)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value:g}; give a finite number above 0")
    if not (math.isfinite(offset) and offset >= 0.5 * crest):
        raise InputError(f"offset is {offset:g} m, so that the crest, {crest:g} m wide, reaches over the bank")
    stations, reach = valley.stations, valley.stations.reach
    span = stations.length * (end - start)
    count = max(2, math.ceil(ALONG_WIDTH * span / valley.params.width)) + 1
    at = np.linspace(start, end, count) * stations.length
    s = stations.line.s[reach]

    def column(values: FloatArray) -> FloatArray:
        return np.interp(at, s, values[reach])

    tangent = np.column_stack([column(stations.line.tangent[:, k]) for k in (0, 1)])
    tangent /= np.hypot(*tangent.T)[:, None]
    place = np.column_stack([column(stations.line.xy[:, k]) for k in (0, 1)])
    sign, bank = (1.0, 0) if side == "left" else (-1.0, 1)
    normal = sign * np.column_stack([-tangent[:, 1], tangent[:, 0]])
    top = valley.bank_height_at(place[:, 0]) + column(stations.lift) + height
    middle = column(stations.half[:, bank]) + offset
    # The sides go down as far below the crest as the lowest ground beside it may lie.
    drop = height + float(valley.bankfull_depth)
    across = np.array([-0.5 * crest - drop / side_slope, -0.5 * crest, 0.5 * crest, 0.5 * crest + drop / side_slope])
    fall = np.array([drop, 0.0, 0.0, drop])
    xy = place[:, None] + (middle[:, None] + across)[:, :, None] * normal[:, None]
    xyz = np.concatenate([xy, (top[:, None] - fall)[:, :, None]], axis=2)
    origin = xyz[count // 2, 1, :2].copy()
    xyz[:, :, :2] -= origin
    return MeshStamp(
        xyz.reshape(-1, 3), _strip(count, 4, turned=side == "left"), tuple(origin), f"levee_{side}", base="datum"
    )


@public
def bridge(
    valley: Valley,
    station: float = 0.5,
    *,
    width: float = 8.0,
    thickness: float = 1.0,
    clearance: float = 2.0,
    overhang: float = 4.0,
    piers: int = 2,
    pier_diameter: float = 1.2,
) -> tuple[MeshStamp, ...]:
    """Make a bridge over the main channel: a deck that is a mesh of its own, and piers that raise the bed.

    Args:
        valley: The valley that it stands in.
        station: Where it crosses, 0 to 1 over the reach.
        width: Width of the deck, m.
        thickness: Thickness of the deck, m.
        clearance: Lower edge of the deck above top of bank, m.
        overhang: Length of the deck beyond each bank, m.
        piers: Number of piers in the channel.
        pier_diameter: m.

    Returns:
        Stamps for ``ValleyParams.stamps``: the deck, then the piers.

    Raises:
        ValueError: A number out of range.
    """
    if not 0.0 <= station <= 1.0:
        raise InputError(f"station is {station:g}; give a position from 0 to 1 over the reach")
    numbers = {"width": width, "thickness": thickness, "pier_diameter": pier_diameter}
    for name, value in numbers.items():
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value:g} m; give a finite length above 0")
    for name, value in {"clearance": clearance, "overhang": overhang}.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise InputError(f"{name} is {value:g} m; give a finite length, 0 or more")
    if isinstance(piers, bool) or not isinstance(piers, int) or not 0 <= piers <= 100:
        raise InputError(f"piers is {shown(piers)}; give a whole number from 0 to 100")
    stations, reach = valley.stations, valley.stations.reach
    s, at = stations.line.s[reach], station * stations.length

    def column(values: FloatArray) -> float:
        return float(np.interp(at, s, values[reach]))

    x, y = (column(stations.line.xy[:, k]) for k in (0, 1))
    angle = math.degrees(math.atan2(column(stations.line.tangent[:, 1]), column(stations.line.tangent[:, 0])))
    left, right = (column(stations.half[:, k]) for k in (0, 1))
    top = float(valley.bank_height_at(np.array([x]))[0]) + column(stations.lift)
    low = top + clearance
    deck = _box(0.5 * width, -(right + overhang), left + overhang, low, low + thickness)
    made = [MeshStamp(*deck, (x, y), "bridge_deck", base="datum", angle=angle, mode="keep")]
    for n in -right + (left + right) * (np.arange(piers) + 1.0) / (piers + 1.0):
        pier = _drum(0.5 * pier_diameter, float(n), top - 2.0 * valley.bankfull_depth, low)
        made.append(MeshStamp(*pier, (x, y), "bridge_pier", base="datum", angle=angle))
    return tuple(made)


def _strip(rows: int, columns: int, turned: bool) -> NDArray[np.int32]:
    """Triangles between the points of a sheet, counter-clockwise seen from above."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + columns, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + columns, corner + columns + 1], axis=1)
    triangles = np.concatenate([lower, upper]).astype(np.int32)
    return triangles if turned else triangles[:, ::-1].copy()


def _box(half: float, right: float, left: float, low: float, high: float) -> tuple[FloatArray, NDArray[np.int32]]:
    """A box: half its length along the channel, its ends across (to the left > 0), and its heights."""
    xyz = np.array(
        [[x, y, z] for z in (low, high) for x, y in ((-half, right), (half, right), (half, left), (-half, left))]
    )
    quads = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return xyz, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)


def _drum(radius: float, across: float, low: float, high: float) -> tuple[FloatArray, NDArray[np.int32]]:
    """An upright drum whose middle lies ``across`` to the left of the channel's line."""
    angle = 2.0 * math.pi * np.arange(AROUND_PIER) / AROUND_PIER
    ring = np.column_stack([radius * np.cos(angle), across + radius * np.sin(angle)])
    xyz = np.concatenate(
        [np.column_stack([ring, np.full(AROUND_PIER, z)]) for z in (low, high)]
        + [[[0.0, across, low], [0.0, across, high]]]
    )
    k = np.arange(AROUND_PIER)
    after, bottom, top = (k + 1) % AROUND_PIER, 2 * AROUND_PIER, 2 * AROUND_PIER + 1
    up = AROUND_PIER
    faces = [
        (k, after, after + up),
        (k, after + up, k + up),
        (after, k, k * 0 + bottom),
        (k + up, after + up, k * 0 + top),
    ]
    return xyz, np.concatenate([np.stack(face, axis=1) for face in faces]).astype(np.int32)
