"""Elevations of channel lines: those of the ground, brought down so that they never rise downstream."""

from __future__ import annotations

import numpy as np

from warpriver.arrays import CellArray, FlagArray, FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of

__all__ = ["drape", "falling_levels", "running_minimum", "without_gaps"]


@public
def drape(network: RiverNetwork, terrain: Terrain | Raster) -> RiverNetwork:
    """Give the points of a network their elevations on a terrain, as ``point_z``, such that no channel rises.

    Ground rises along a course wherever it crosses noise, a pit, or the bank of a bend. There the channel goes on at
    the lowest level that it has reached, as if it had cut in: a point has the lowest height of the ground at it and at
    all points upstream of it, through junctions too. A ring has its lowest height everywhere. Points without data get
    the height of the nearest one upstream, or else downstream, in their channel.

    Args:
        network: The channels.
        terrain: The ground, or a raster of heights in m, such as the carved one that a network was extracted from.

    Returns:
        A copy of the network with elevations.

    Raises:
        ValueError: A channel that lies off the terrain or where it has no data, or channels that flow in a circle.
    """
    start = network.starts().astype(np.int64)
    height = without_gaps(surface_of(terrain).sample(network.points()), start)
    ends = (network.channel_from, network.channel_to)
    return network.with_elevations(falling_levels(height, start, ends, network.node_count, network.channel_closed))


def falling_levels(
    height: FloatArray,
    start: IndexArray,
    ends: tuple[CellArray, CellArray],
    nodes: int,
    rings: FlagArray,
) -> FloatArray:
    """Return the greatest levels that are nowhere above the heights and rise along no channel, nor across nodes.

    Args:
        height: (P,) heights of places along channels that lie end to end, from upstream to downstream.
        start: (C + 1,) offsets of the channels.
        ends: Nodes above and below each channel, (C,) each.
        nodes: Number of nodes.
        rings: (C,) which channels are rings: they are level.
    """
    upper, lower = ends
    channel = np.repeat(np.arange(len(start) - 1), np.diff(start))
    z = running_minimum(height, channel)
    last = start[1:] - 1
    level = _node_levels(z[last], upper, lower, nodes, rings)
    z = np.minimum(z, np.where(rings, np.inf, level[upper])[channel])
    z[last] = np.minimum(z[last], np.where(rings, np.inf, level[lower]))
    return np.where(rings[channel], z[last][channel], z)


def without_gaps(height: FloatArray, start: IndexArray) -> FloatArray:
    """Return heights in which gaps have the height before them in their channel, or else the first one there."""
    known = np.isfinite(height)
    place = np.maximum.accumulate(np.where(known, np.arange(len(height)), -1))
    channel = np.repeat(np.arange(len(start) - 1), np.diff(start))
    missing = np.add.reduceat(known, start[:-1]) == 0
    if missing.any():
        raise InputError(
            f"{int(missing.sum())} channels (the first: {int(missing.argmax())}) lie off the terrain or where it has "
            "no data; leave them out, or give a terrain that reaches as far"
        )
    first = np.flatnonzero(known)[np.searchsorted(np.flatnonzero(known), start[:-1])]
    return height[np.maximum(place, first[channel])]


def running_minimum(values: FloatArray, group: IndexArray) -> FloatArray:
    """Return the minimum of each group's values up to each, to the bit; groups lie one after the other."""
    order = np.argsort(values, kind="stable")
    rank = np.empty(len(values), np.int64)
    rank[order] = np.arange(len(values))
    # Whole numbers, so that the ranks of later groups are below all earlier ones and nothing is rounded.
    shift = group * len(values)
    return values[order][np.minimum.accumulate(rank - shift) + shift]


def _node_levels(end: FloatArray, upper: CellArray, lower: CellArray, count: int, rings: FlagArray) -> FloatArray:
    """Return the level of each node, (N,): the lowest that a channel reaches it with, infinite at sources."""
    level = np.full(count, np.inf)
    pending = np.bincount(lower[~rings], minlength=count)
    left = ~rings
    while left.any():
        ready = np.flatnonzero(left & (pending[upper] == 0))
        if not len(ready):
            raise InputError(f"{int(left.sum())} channels flow in a circle: none of them is the lowest")
        np.minimum.at(level, lower[ready], np.minimum(end[ready], level[upper[ready]]))
        np.subtract.at(pending, lower[ready], 1)
        left[ready] = False
    return level
