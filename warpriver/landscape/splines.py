"""Channels as splines: points with width, depth and tangents, whose elevations never rise downstream."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.extras import need
from warpriver.graph.forest import leaving_channels
from warpriver.io.vector.layers import Layer
from warpriver.landscape.profiles import lines_of
from warpriver.network import RiverNetwork
from warpriver.public import public

__all__ = ["Placing", "Splines", "channel_splines", "spline_layer", "splines_as_json"]

# Turns places, and turns directions, into those of a program.
Placing = Callable[[FloatArray], FloatArray]


@dataclasses.dataclass(frozen=True)
class Splines:
    """Points of all channels, end to end; cubics with these tangents pass through them.

    Attributes:
        start: (C + 1,) offsets of the channels.
        xyz: (P, 3) points in m; z is the water's level, which never rises along a channel.
        tangent: (P, 3) derivative along the curve per point, m: what Hermite splines need. Its z is 0 or less.
        width: (P,) m.
        depth: (P,) m.
        distance: (P,) from the channel's head, m.
        network: The channels.
    """

    start: IndexArray
    xyz: FloatArray
    tangent: FloatArray
    width: FloatArray
    depth: FloatArray
    distance: FloatArray
    network: RiverNetwork


@public
def channel_splines(network: RiverNetwork) -> Splines:
    """Return the channels of a network as splines; those of rings have their first point again at their end.

    Args:
        network: Channels with elevations, as :func:`carve` returns them; without them they lie at 0.
    """
    lines = lines_of(network)
    level = np.zeros(network.point_count) if network.point_z is None else network.point_z
    xyz = np.column_stack([lines.xy, level[lines.source]])
    last = np.zeros(len(xyz), bool)
    last[lines.start[1:] - 1] = True
    chord = np.append(np.diff(xyz, axis=0), [[0.0, 0.0, 0.0]], axis=0)
    chord[last] = 0.0
    before = np.roll(chord, 1, axis=0)
    head = np.zeros(len(xyz), bool)
    head[lines.start[:-1]] = True
    tangent = 0.5 * (before + chord)
    tangent[head], tangent[last] = chord[head], before[last]
    # Heights between points that fall stay between them where no slope is above three times that of a chord.
    steepest = 3.0 * np.minimum(np.where(last, np.inf, -chord[:, 2]), np.where(head, np.inf, -before[:, 2]))
    tangent[:, 2] = -np.clip(-tangent[:, 2], 0.0, np.maximum(steepest, 0.0))
    step = np.where(head, 0.0, np.hypot(*before[:, :2].T))
    total = np.cumsum(step)
    distance = total - total[lines.start[:-1]][lines.owner]
    return Splines(lines.start, xyz, tangent, 2.0 * lines.half, lines.depth, distance, network)


def splines_as_json(splines: Splines, place: Placing, turn: Placing, scale: float) -> list[dict[str, Any]]:
    """Return an object a channel, in the coordinates of a program.

    Args:
        splines: The channels.
        place: Turns (n, 3) absolute places into the program's.
        turn: Turns (n, 3) vectors into the program's.
        scale: The program's units in a metre.
    """
    network = splines.network
    xyz, tangent = place(splines.xyz), turn(splines.tangent)
    below = np.where(network.channel_closed, -1, leaving_channels(network)[network.channel_to])
    found = []
    for c, (a, b) in enumerate(zip(splines.start[:-1].tolist(), splines.start[1:].tolist(), strict=True)):
        found.append(
            {
                "channel_id": int(network.channel_id[c]),
                "next_down": int(network.channel_id[below[c]]) if below[c] >= 0 else None,
                "closed": bool(network.channel_closed[c]),
                "discharge_m3s": float(network.channel_discharge[c]),
                "points": np.round(xyz[a:b], 4).tolist(),
                "tangents": np.round(tangent[a:b], 4).tolist(),
                "width": np.round(scale * splines.width[a:b], 4).tolist(),
                "depth": np.round(scale * splines.depth[a:b], 4).tolist(),
            }
        )
    return found


def spline_layer(splines: Splines, name: str) -> Layer:
    """Return the points of splines as a layer of a GeoPackage."""
    (shapely,) = need("writing .gpkg", "shapely")
    counts = np.diff(splines.start)
    columns = {
        "channel_id": np.repeat(splines.network.channel_id, counts),
        "point": np.concatenate([np.arange(n) for n in counts]),
        "distance_m": splines.distance,
        "width_m": splines.width,
        "depth_m": splines.depth,
        "tangent_x": splines.tangent[:, 0],
        "tangent_y": splines.tangent[:, 1],
        "tangent_z": splines.tangent[:, 2],
    }
    return Layer(name, "Point Z", shapely.points(splines.xyz), columns, "points")
