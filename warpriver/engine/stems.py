"""Stems on the device: which channels go on from each other as one river, and which leave the map."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import warp as wp

from warpriver.channel_table import JOINT_LOCK
from warpriver.engine.stages import put
from warpriver.graph.stems import Stems, find_stems
from warpriver.kernels.channels import EDGE_NONE, EDGE_NORTH_SOUTH, EDGE_WEST_EAST
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain

__all__ = ["MapEdges", "StemArrays", "find_map_edges"]


class StemArrays:
    """The links next to each channel, and the edge of the map at its foot, for kernels.

    Attributes:
        links: The stems of the network.
        joined: Whether any channel has gone on in another one; ``locked``: whether any has ended at a locked point;
            ``slides``: whether any leaves the map.
        length: (C,) int64, length of each stem, see the kernel ``measure_stems``.
        substeps: (C,) int32, scratch: maximum number of sub-steps of the links of each stem.
    """

    links: Stems

    def __init__(self, count: int, device: Any, *, through_only: bool = False):
        """Allocate for so many channels; ``through_only``: junctions and the edge of the map hold all channels."""
        self._through_only = through_only
        self._arrays = {
            name: wp.zeros(count, dtype=wp.int32, device=device) for name in ("upper", "lower", "top", "bottom")
        }
        self._edge, self._held = (wp.zeros(count, dtype=wp.int32, device=device) for _ in range(2))
        self.length = wp.zeros(count, dtype=wp.int64, device=device)
        self.substeps = wp.zeros(count, dtype=wp.int32, device=device)
        self.joined = self.slides = self.locked = False

    def take(self, network: RiverNetwork, edges: MapEdges | None, alone: np.ndarray | None = None) -> bool:
        """Take the channels of a network, some of which may be stems of their own; tell whether stages are outdated."""
        before = self.joined, self.slides, self.locked
        capacity = len(self._edge)
        self.links = find_stems(network, alone, through_only=self._through_only)
        for name, array in self._arrays.items():
            # Beyond the channels nothing goes on.
            values = (
                np.arange(capacity, dtype=np.int32) if name in ("top", "bottom") else np.full(capacity, -1, np.int32)
            )
            values[: network.channel_count] = getattr(self.links, name)
            put(array, values)
        edge = np.full(capacity, EDGE_NONE, np.int32)
        if edges is not None and not self._through_only:
            edge[: network.channel_count] = find_edges(network, edges)
        put(self._edge, edge)
        held = np.zeros(capacity, np.int32)
        held[: network.channel_count] = network.channel_joint == JOINT_LOCK
        put(self._held, held)
        # What there was once is looked for ever after, to the same bits: edits that come and go outdate nothing.
        self.joined, self.locked = self.joined or bool((self.links.upper >= 0).any()), self.locked or bool(held.any())
        self.slides = bool((edge != EDGE_NONE).any())
        return before != (self.joined, self.slides, self.locked)

    def give(self, channels: Any) -> None:
        """Set the arrays in the channels as kernels take them; they stay missing where there is nothing to tell."""
        if self.joined:
            for name, array in self._arrays.items():
                setattr(channels.stems, name, array)
            channels.stems.length = self.length
            if self.locked:
                channels.stems.held = self._held
        if self.slides:
            channels.edge = self._edge

    def holds_feet(self) -> np.ndarray:
        """Return whether the last point of each channel stays in place, (C,) bool."""
        count = len(self.links.lower)
        ends = (self.links.lower < 0) & (self._edge.numpy()[:count] == EDGE_NONE)
        feet: np.ndarray = ends | (self._held.numpy()[:count] != 0)
        return feet

    def level(self, substeps: np.ndarray) -> np.ndarray:
        """Return the maximum over the links of each channel's stem, (C,); 0 where that of the channel itself is 0."""
        greatest = np.zeros(len(substeps), substeps.dtype)
        np.maximum.at(greatest, self.links.top, substeps)
        return np.where(substeps > 0, greatest[self.links.top], 0)


class MapEdges(NamedTuple):
    """Outer edges in m of what of a terrain has data, and the size of its cells."""

    west: float
    south: float
    east: float
    north: float
    cell_size: float

    def distance(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how far points, (N, 2), are inside of the nearer edge along each axis, m."""
        x, y = xy.T
        return np.minimum(x - self.west, self.east - x), np.minimum(y - self.south, self.north - y)


def find_map_edges(terrain: Terrain | None) -> MapEdges | None:
    """Return the edges of what has data; rows and columns on the rim may not. All of the terrain where nothing has.

    A plain, None, has none.
    """
    if terrain is None:
        return None
    west, south, east, north = terrain.bounds
    size = terrain.cell_size
    known = np.isfinite(terrain.to_numpy())
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if len(rows) == 0:
        return MapEdges(west, south, east, north, size)
    last_row, last_column = known.shape[0] - 1 - rows[-1], known.shape[1] - 1 - columns[-1]
    return MapEdges(
        west + columns[0] * size, south + last_row * size, east - last_column * size, north - rows[0] * size, size
    )


def find_edges(network: RiverNetwork, edges: MapEdges) -> np.ndarray:
    """Return the edge of the map at the foot of each channel, (C,) int32: ``EDGE_NORTH_SOUTH`` and so on.

    A channel leaves the map where it alone ends at a node within a cell of the edge, from which nothing flows on.
    """
    away_x, away_y = edges.distance(network.node_xy[network.channel_to])
    edge = np.where(away_x <= away_y, EDGE_NORTH_SOUTH, EDGE_WEST_EAST)
    meeting = np.bincount(network.channel_to, minlength=network.node_count)
    meeting += np.bincount(network.channel_from, minlength=network.node_count)
    leaves = (meeting[network.channel_to] == 1) & (np.minimum(away_x, away_y) < edges.cell_size)
    found: np.ndarray = np.where(leaves, edge, EDGE_NONE).astype(np.int32)
    return found
