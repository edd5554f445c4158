"""Which channels of a file are joined: by its nodes, by the channels downstream that it names, or where ends meet."""

from __future__ import annotations

import logging
import warnings
from typing import NamedTuple

import numpy as np

from warpriver.errors import InputError
from warpriver.io.vector.source import Line, Source
from warpriver.network_checks import NODE_TOLERANCE

__all__ = ["TOPOLOGIES", "Connections", "connect"]

log = logging.getLogger("warpriver")

TOPOLOGIES = ("file", "ends")
# An end lies at most this many widths of its channel, and this part of its line, from the node that the file joins it
# to. Nearer ones are brought there, as those of hand-made lines need it; what is further away is another place,
# whatever the file says.
GAP_WIDTHS, GAP_PART = 1.0, 0.5


class Connections(NamedTuple):
    """How channels hang together.

    Attributes:
        channel_id: (C,) identities, or None: number them anew.
        nodes: (from, to, node_xy), or None: ends that meet are one node.
    """

    channel_id: np.ndarray | None
    nodes: tuple[np.ndarray, np.ndarray, np.ndarray] | None


def connect(lines: list[Line], sources: list[Source], topology: str, label: str) -> Connections:
    """Join channels as their file says; lines that it shows to run upstream are turned, ends brought to their nodes.

    Args:
        lines: All channels, with widths.
        sources: The files they come from.
        topology: "file": by nodes, else by channels downstream, else where ends meet; or "ends".
        label: What to call the files in messages.

    Raises:
        ValueError: Identities that stand twice, or channels that name one another downstream in a circle.
    """
    if len(sources) > 1:
        return Connections(None, None)  # their numbers do not belong together
    if len({line.feature for line in lines}) < len(lines):
        log.info("%s: features of several lines; lines are numbered anew and join where they meet", label)
        return Connections(None, None)
    identity = _identities(lines, topology)
    if topology == "ends":
        return Connections(identity, None)
    if all(line.from_node is not None and line.to_node is not None for line in lines):
        ends = np.array([line.from_node for line in lines] + [line.to_node for line in lines], np.int64)
        return Connections(identity, _nodes(lines, ends, sources[0].node_xy, label))
    if identity is not None and any(line.next_down is not None for line in lines):
        down = _next_channels(lines, identity)
        _refuse_circles(lines, down)
        _turn(lines, down, label)
        count = np.arange(len(lines))
        ends = np.concatenate([count, np.where(down >= 0, down, len(lines) + count)])
        return Connections(identity, _nodes(lines, ends, {}, label))
    return Connections(identity, None)


def _identities(lines: list[Line], topology: str) -> np.ndarray | None:
    """Return the identities that a file gives its channels, None where some have none."""
    found = [line.channel_id for line in lines]
    if any(number is None for number in found):
        return None
    first: dict[int, Line] = {}
    for line in lines:
        assert line.channel_id is not None
        other = first.setdefault(line.channel_id, line)
        if other is line:
            continue
        if topology == "ends":
            return None
        raise InputError(
            f"{line.where}: its identity, {line.channel_id}, is also that of {other.where.rpartition(', ')[2]}; make "
            "them differ, or pass topology='ends' to number the channels anew and join them where they meet"
        )
    return np.array(found, np.int64)


def _next_channels(lines: list[Line], identity: np.ndarray) -> np.ndarray:
    """Return the channel downstream of each, -1 where the file names none that it holds: (C,).

    Of several, as where a river parts, it is the one that drains most, of equal ones the first.
    """
    place = {int(number): c for c, number in enumerate(identity.tolist())}
    down = np.full(len(lines), -1, np.int64)
    for c, line in enumerate(lines):
        there = [place[number] for number in line.next_down or () if number in place]
        if there:
            down[c] = max(there, key=lambda d: lines[d].drainage_area or 0.0)
    return down


def _refuse_circles(lines: list[Line], down: np.ndarray) -> None:
    """Raise ``ValueError`` where channels name one another downstream in a circle."""
    far = down.copy()
    # Doubling: after k rounds each looks 2^k channels down.
    for _ in range(len(lines).bit_length() + 1):
        far = np.where(far >= 0, far[far], -1)
    if not (far >= 0).any():
        return
    circle = [int(far[far >= 0][0])]  # so far down that it lies on the circle itself
    while (following := int(down[circle[-1]])) != circle[0]:
        circle.append(following)
    names = [str(lines[c].channel_id) for c in (*circle[:6], circle[0])]
    if len(circle) > 6:
        names.insert(-1, "...")
    raise InputError(
        f"{lines[circle[0]].where}: channels flow in a circle, {' -> '.join(names)}; correct what they name "
        "downstream, or pass topology='ends' to join them where they meet"
    )


def _turn(lines: list[Line], down: np.ndarray, label: str) -> None:
    """Turn lines round whose upper end touches the channel downstream, or whose lower end the channel upstream."""
    head, tail, room = _ends(lines)
    has = np.flatnonzero(down >= 0)
    mouth = np.flatnonzero((down < 0) & np.isin(np.arange(len(lines)), down))
    feeder = np.full(len(lines), -1, np.int64)
    feeder[down[has]] = has

    def off(xy: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Distance to the nearer end of another channel."""
        return np.minimum(np.hypot(*(xy - head[other]).T), np.hypot(*(xy - tail[other]).T))

    wrong = np.zeros(len(lines), bool)
    below, above = down[has], feeder[mouth]
    wrong[has] = (off(head[has], below) <= room[has]) & (off(tail[has], below) > room[has])
    wrong[mouth] = (off(tail[mouth], above) <= room[mouth]) & (off(head[mouth], above) > room[mouth])
    for c in np.flatnonzero(wrong):
        lines[c].map_points(lambda a: a[::-1].copy())
    if wrong.any():
        log.info("%s: %d lines that ran upstream were turned", label, int(wrong.sum()))


def _ends(lines: list[Line]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First and last point of each line, and how far from its node an end may lie."""
    head = np.array([line.xy[0] for line in lines])
    tail = np.array([line.xy[-1] for line in lines])
    width = np.array([float(np.mean(line.width)) for line in lines])
    length = np.array([float(np.hypot(*np.diff(line.xy, axis=0).T).sum()) for line in lines])
    # A width that is not positive is told when the network is built.
    return head, tail, np.maximum(np.minimum(GAP_WIDTHS * width, GAP_PART * length), 0.0)


def _nodes(
    lines: list[Line], ends: np.ndarray, known: dict[int, tuple[float, float]], label: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes above and below each channel and their positions.

    Args:
        lines: The channels.
        ends: (2C,) names of the nodes at all upper ends, then at all lower ones.
        known: Positions of nodes by name; others lie at the first end that has their name, upper ends first.
        label: What to call the file in messages.
    """
    count = len(lines)
    head, tail, room = _ends(lines)
    xy, room = np.concatenate([head, tail]), np.tile(room, 2)
    names, first, at = np.unique(ends, return_index=True, return_inverse=True)
    node_xy = xy[first]
    for k, name in enumerate(names.tolist()):
        if name in known:
            node_xy[k] = known[name]
    gap = np.hypot(*(xy - node_xy[at]).T)
    apart = np.flatnonzero(gap > room)
    if len(apart):
        worst = int(apart[gap[apart].argmax()])
        warnings.warn(
            f"{label}: {len(apart)} ends lie more than a width (or half their line) from the node or channel "
            f"that the file joins them to, and are left free (the furthest, {gap[worst]:.4g} m: "
            f"{lines[worst % count].where.rpartition(', ')[2]})",
            UserWarning,
            stacklevel=4,
        )
        at[apart] = len(names) + np.arange(len(apart))
        node_xy = np.concatenate([node_xy, xy[apart]])
        gap[apart] = 0.0
    moved = np.flatnonzero(gap > NODE_TOLERANCE * room)
    for k in moved.tolist():
        line = lines[k % count]
        line.xy[0 if k < count else -1] = node_xy[at[k]]
    if len(moved):
        log.info("%s: %d ends were brought to their nodes", label, len(moved))
    used, at = np.unique(at, return_inverse=True)
    return at[:count], at[count:], node_xy[used]
