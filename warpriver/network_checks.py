"""Checks of lines and graphs that are to be a network, and the nodes where lines meet."""

from __future__ import annotations

from typing import Any

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.channel_table import ChannelTable
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.kernels.channels import RING_POINTS
from warpriver.validate import floats, shown

__all__ = [
    "NODE_TOLERANCE",
    "check_graph",
    "check_packed",
    "check_rings_apart",
    "checked_points",
    "find_nodes",
    "per_channel",
    "per_point",
    "ring_flags",
    "ring_marks",
    "ring_points",
]

# Two channel ends closer than this fraction of the narrower width are one node.
NODE_TOLERANCE = 1e-3
# The ends of a line that is to be a ring may be so many times its longest segment, or its width, apart.
RING_GAP = 3.0
# What values of points must be.
RANGES = {"point_section": "width and depth must be positive and finite", "point_z": "it must be finite"}


def find_nodes(
    xy: np.ndarray, start: np.ndarray, closed: np.ndarray, tolerance: float, origin: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes above and below each channel, and their positions: channel ends within ``tolerance`` m are one node.

    Both ends of a ring are its first point.
    """
    with IMPORTING:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import cKDTree

    count = len(start) - 1
    ends = np.concatenate([xy[start[:-1]], xy[np.where(closed, start[:-1], start[1:] - 1)]])
    # Ends in one place are one from the start: pairs of a thousand of them would be a million.
    _, first, place = np.unique(np.ascontiguousarray(ends).view(np.complex128), return_index=True, return_inverse=True)
    pairs = cKDTree(ends[first]).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(first), len(first)))
    node_count, group = connected_components(graph, directed=False)
    oldest = np.full(node_count, 2 * count, np.int64)
    np.minimum.at(oldest, group, first)
    # Nodes are numbered by the first end that lies at them.
    rank = np.empty(node_count, np.int64)
    rank[np.argsort(oldest)] = np.arange(node_count)
    label = rank[group[place.ravel()]]
    return label[:count], label[count:], ends[np.sort(oldest)] + origin


def ring_flags(closed: Any, count: int) -> np.ndarray:
    """Spread ``closed`` over the channels, (C,) bool."""
    flags = np.asarray(closed)
    if flags.dtype != bool or flags.shape not in ((), (count,)):
        raise InputError(
            f"closed is {shown(closed)}; give True or False, or one of them for each of the {count} channels"
        )
    each: np.ndarray = np.broadcast_to(flags, (count,)).copy()
    return each


def ring_marks(marks: Any, rings: np.ndarray, counts: list[int]) -> list[tuple[int, int]]:
    """Return the marked point of each ring that has one, (channel, index)."""
    if marks is None:
        return []
    if np.ndim(marks) == 0:
        if not rings.any():
            raise InputError("marks: there is no ring among the channels; leave marks out, or pass closed=True")
        marks = [marks if ring else None for ring in rings]
    if len(marks) != len(rings):
        raise InputError(f"marks: {len(marks)} values for {len(rings)} channels; give one index, or one a channel")
    found = []
    for c, mark in enumerate(marks):
        if mark is None:
            continue
        if not rings[c]:
            raise InputError(f"marks: channel {c} is no ring and has no marked point; give None for it, or close it")
        if isinstance(mark, bool) or not isinstance(mark, (int, np.integer)):
            raise InputError(f"mark of channel {c} is {shown(mark)}; give the index of a point, or None")
        if not 0 <= mark < counts[c]:
            raise InputError(f"mark of channel {c} is {mark}; its points are numbered from 0 to {counts[c] - 1}")
        found.append((c, int(mark)))
    return found


def ring_points(xy: np.ndarray, width: float, channel: int) -> int:
    """Return how many points of a line make its ring, or raise ``ValueError`` where it is none."""
    step = np.hypot(*np.diff(xy, axis=0).T)
    gap = float(np.hypot(*(xy[-1] - xy[0])))
    count = len(xy) - 1 if gap <= NODE_TOLERANCE * width else len(xy)
    limit = RING_GAP * max(float(step.max()), width)
    if gap > limit:
        raise InputError(
            f"channel {channel}: closed, but its ends are {gap:g} m apart, more than {limit:g} m (three of its longest "
            "segments or widths); close the line, or pass closed=False for it"
        )
    if count < RING_POINTS:
        raise InputError(
            f"channel {channel}: a ring of {count} points; a ring needs at least {RING_POINTS}, add points"
        )
    return count


def check_rings_apart(lines: list[np.ndarray], rings: np.ndarray, widths: list[np.ndarray]) -> None:
    """Raise ``ValueError`` where a ring shares a point with another ring or with the end of a channel."""
    if not rings.any() or len(lines) < 2:
        return
    with IMPORTING:
        from scipy.spatial import cKDTree

    index = np.flatnonzero(rings)
    owner = np.repeat(index, [len(lines[c]) for c in index])
    points = np.concatenate([lines[c] for c in index])
    tolerance = NODE_TOLERANCE * min(float(w.min()) for w in widths)
    tree = cKDTree(points)
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    met = [(int(a), int(b), points[p]) for (a, b), p in zip(owner[pairs], pairs[:, 0], strict=True) if a != b]
    for c in np.flatnonzero(~rings):
        ends = lines[c][[0, -1]]
        away, nearest = tree.query(ends)
        met += [(int(owner[nearest[k]]), int(c), ends[k]) for k in (0, 1) if away[k] <= tolerance]
    if met:
        ring, other, (x, y) = met[0]
        raise InputError(
            f"channel {ring} is a ring and meets channel {other} at ({x:.6g}, {y:.6g}); rings join no other channel: "
            "open it there with closed=False, or move them apart"
        )


def offsets(start: Any) -> np.ndarray:
    """Return offsets into the points as int32, or raise ``ValueError``."""
    array = floats(start, "channel_start", "(C + 1,) offsets into the points")
    if array.ndim != 1 or not (np.isfinite(array) & (array == np.round(array)) & (np.abs(array) < 2**31)).all():
        raise InputError(f"channel_start is {shown(start)}; give (C + 1,) offsets into the points, whole numbers")
    return array.astype(np.int32)


def check_packed(xy: np.ndarray, start: np.ndarray, count: int) -> None:
    """Raise ``ValueError`` unless points and offsets are those of so many channels, none of them without length."""
    if xy.ndim != 2 or xy.shape[1] != 2:
        raise InputError(f"point_xy has shape {xy.shape}; give (P, 2) x, y in metres")
    if len(start) != count + 1 or count == 0 or start[0] != 0 or start[-1] > len(xy):
        raise InputError(
            f"channel_start is {len(start)} offsets, from {start[0] if len(start) else '-'} to "
            f"{start[-1] if len(start) else '-'}, for {count} channels and {len(xy)} points; it runs from 0 to the "
            "number of points, one more than channels, of which a network has at least one"
        )
    short = np.diff(start) < 2
    if short.any():
        c = int(short.argmax())
        raise InputError(f"channel {c} has {start[c + 1] - start[c]} point(s); a channel needs at least 2, drop it")
    # A channel has length if any of its points differs from its first one.
    used = xy[: start[-1]]
    apart = (used != np.repeat(used[start[:-1]], np.diff(start), axis=0)).any(axis=1)
    empty = ~np.logical_or.reduceat(apart, start[:-1])
    if empty.any():
        raise InputError(f"channel {int(empty.argmax())} has no length: all its points are in one place; drop it")


def check_graph(channels: ChannelTable, node_xy: np.ndarray) -> None:
    """Raise ``ValueError`` unless identities differ, and nodes and channels belong to one another."""
    identity, above, below = channels.id, channels.from_node, channels.to_node
    order = np.argsort(identity, kind="stable")
    twice = np.flatnonzero(identity[order][1:] == identity[order][:-1])
    if len(twice):
        first, second = order[twice[0] : twice[0] + 2]
        raise InputError(
            f"channel_id {identity[first]} stands twice, at channels {first} and {second} ({len(twice)} such pairs in "
            "all); identities must differ"
        )
    if node_xy.ndim != 2 or node_xy.shape[1] != 2:
        raise InputError(f"node_xy has shape {node_xy.shape}; give (N, 2) x, y in metres")
    ends = np.concatenate([above, below])
    if ends.min() < 0 or ends.max() >= len(node_xy):
        c = int(np.flatnonzero((ends < 0) | (ends >= len(node_xy)))[0]) % len(channels)
        raise InputError(f"channel {c} runs from node {above[c]} to {below[c]}, but there are {len(node_xy)} nodes")
    free = np.bincount(ends, minlength=len(node_xy)) == 0
    if free.any():
        raise InputError(f"node {int(free.argmax())} belongs to no channel ({int(free.sum())} such in all); remove it")


def checked_points(name: str, values: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return finite values of the points, float64, or raise ``ValueError``; a width and depth must be positive."""
    array = floats(values, name)
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}; give {shape}, a row for each point")
    wrong = ~np.isfinite(array)
    if name == "point_section":
        wrong |= ~(array > 0.0)
    if wrong.any():
        point = int(np.argwhere(wrong)[0][0])
        raise InputError(f"{name} of point {point} is {array[point].tolist()}; {RANGES[name]}")
    return array


def per_channel(name: str, values: Any, count: int) -> FloatArray:
    """Return one number a channel, NaN where it is not known, or raise ``ValueError``."""
    array = floats(values, name).copy()
    if array.ndim > 1 or (array.ndim == 1 and len(array) != count):
        raise InputError(f"{name}: shape {array.shape} for {count} channels; give one number or one a channel")
    array = np.broadcast_to(array, (count,)).copy()
    if np.isinf(array).any():
        c = int(np.isinf(array).argmax())
        raise InputError(f"{name} of channel {c} is infinite; use NaN where it is not known")
    return array


def per_point(value: Any, counts: list[int], name: str, unit: str, *, positive: bool = True) -> list[np.ndarray]:
    """Spread a number, a number a channel, or an array a channel over the points; all finite, and all ``positive``."""
    if not isinstance(value, (list, tuple)) and np.ndim(value) == 0:
        values: list[Any] = [value] * len(counts)
    else:
        values = list(value)
    if len(values) != len(counts):
        raise InputError(f"{name}: {len(values)} values for {len(counts)} channels; give one number or one a channel")
    spread = []
    for c, (v, n) in enumerate(zip(values, counts, strict=True)):
        array = floats(v, f"{name} of channel {c}").copy()
        if array.ndim > 1 or (array.ndim == 1 and len(array) != n):
            raise InputError(f"{name} of channel {c}: shape {array.shape} for {n} points; give one number or ({n},)")
        array = np.broadcast_to(array, (n,)).copy()
        fits = np.isfinite(array) & (array > 0.0) if positive else np.isfinite(array)
        if not fits.all():
            must = "positive and finite" if positive else "finite"
            raise InputError(f"{name} of channel {c} is {array[~fits][0]:g} {unit}; it must be {must}")
        spread.append(array)
    return spread
