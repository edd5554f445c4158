"""Which channels of a file are joined: by its nodes, by the channels downstream that it names, or where ends meet.

What a file says counts for each line that it says it of. A line with a damaged identity, a second line of the same
identity, or one without nodes is numbered anew, and joined where it meets the others.
"""

from __future__ import annotations

import logging
from collections import Counter
from typing import NamedTuple

import numpy as np

from warpriver.errors import InputError, warn
from warpriver.extras import IMPORTING
from warpriver.io.vector.source import Line, Source
from warpriver.network_checks import NODE_TOLERANCE

__all__ = ["TOPOLOGIES", "Connections", "connect"]

log = logging.getLogger("warpriver")

TOPOLOGIES = ("file", "ends")
# An end lies at most this many widths of its channel, and this fraction of its line, from the node that the file joins
# it to. Nearer ones are brought there, as those of hand-made lines need it; what is further away is another place,
# whatever the file says.
GAP_WIDTHS, GAP_FRACTION = 1.0, 0.5


class Connections(NamedTuple):
    """How channels hang together.

    Attributes:
        channel_id: (C,) identities, or None: number them anew.
        nodes: (from, to, node_xy), or None: ends that meet are one node.
    """

    channel_id: np.ndarray | None
    nodes: tuple[np.ndarray, np.ndarray, np.ndarray] | None


class _Ends(NamedTuple):
    """Where the lines begin and end.

    Attributes:
        head: (C, 2) first points.
        tail: (C, 2) last points.
        room: (C,) how far an end may lie from its node, m.
    """

    head: np.ndarray
    tail: np.ndarray
    room: np.ndarray

    def off(self, xy: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Return the distance of points to the nearer end of other channels."""
        off: np.ndarray = np.minimum(np.hypot(*(xy - self.head[other]).T), np.hypot(*(xy - self.tail[other]).T))
        return off


def connect(lines: list[Line], sources: list[Source], topology: str, label: str) -> Connections:
    """Join channels as their file says; lines that it shows to run upstream are turned, ends brought to their nodes.

    Args:
        lines: All channels, with widths.
        sources: The files they come from.
        topology: "file": by nodes, else by channels downstream, else where ends meet; or "ends".
        label: What to call the files in messages.

    Raises:
        ValueError: Channels that name one another downstream in a circle.
    """
    if len(sources) > 1:
        return Connections(None, None)  # their numbers do not belong together
    identity, irregular = _identities(lines, label)
    if topology == "ends":
        return Connections(identity, None)
    count, known = len(lines), sources[0].node_xy
    noded = np.array([line.from_node is not None and line.to_node is not None for line in lines])
    if 2 * noded.sum() > count:
        names = _node_names(lines, noded, label)
        above, below = _neighbours(names)
        # Lines of one identity have the nodes of the whole, which tell nothing of where each of them lies.
        shared = irregular & noded
        _turn(lines, np.where(shared, -1, above), np.where(shared, -1, below), known, label)
        _follow_siblings(lines, names)
        irregular = ~noded | (irregular & [line.channel_id is not None for line in lines])
        return Connections(identity, _nodes(lines, names, known, irregular, label))
    if identity is not None and any(line.next_down is not None for line in lines):
        down = _next_channels(lines)
        _refuse_circles(lines, down)
        feeder = np.full(count, -1, np.int64)
        feeder[down[down >= 0]] = np.flatnonzero(down >= 0)
        _turn(lines, np.where(down >= 0, -1, feeder), down, {}, label)
        index = np.arange(count)
        names = np.concatenate([index, np.where(down >= 0, down, count + index)])
        return Connections(identity, _nodes(lines, names, {}, irregular, label))
    return Connections(identity, None)


def _identities(lines: list[Line], label: str) -> tuple[np.ndarray | None, np.ndarray]:
    """Return the identities that a file gives its channels, and which lines have none or share theirs with another.

    Those get numbers of their own, but for the first line of an identity, and that is told. Where the file gives no
    identities, or the same to all, there are none.
    """
    found = [line.channel_id for line in lines]
    counts = Counter(found)
    irregular = np.array([number is None or counts[number] > 1 for number in found])
    taken = set(counts) - {None}
    if not taken or (len(taken) == 1 < len(lines)):
        return None, irregular
    following = max(number for number in taken if number is not None) + 1
    missing: list[int] = []
    repeated: list[int] = []
    seen = set()
    for c, number in enumerate(found):
        if number is not None and number not in seen:
            seen.add(number)
            continue
        (missing if number is None else repeated).append(c)
        found[c] = following
        following += 1
    if 2 * len(repeated) > len(lines):
        warn(
            f"{label}: its identities tell no channels apart, as {len(repeated)} of {len(lines)} lines have that of "
            "another; channels are numbered anew and joined where they meet"
        )
        return None, irregular
    for lost, what in ((missing, "no whole number as its identity"), (repeated, "the identity of another")):
        if lost:
            warn(
                f"{label}: {len(lost)} of {len(lines)} lines have {what}: the first is "
                f"{lines[lost[0]].where.rpartition(', ')[2]}, whose channel_id is now {found[lost[0]]}. Such lines are "
                "joined where they meet others; all others keep what the file says"
            )
    return np.array(found, np.int64), irregular


def _next_channels(lines: list[Line]) -> np.ndarray:
    """Return the channel downstream of each, -1 where the file names none that it holds: (C,).

    Of several, as where a river parts, it is the one that drains most, of equal ones the first. Of several lines of one
    identity it is the one that begins nearest; they follow one another where they meet. A channel downstream that the
    file does not hold may be one whose identity is damaged: then it is such a one that begins there.
    """
    place, ends = _groups(lines), _ends(lines)
    down = np.full(len(lines), -1, np.int64)
    lost = []
    for c, line in enumerate(lines):
        # Some files mark an outlet by its own identity.
        following = [number for number in line.next_down or () if number != line.channel_id]
        there = [place[number] for number in following if number in place]
        if there:
            group = max(there, key=lambda group: lines[group[0]].drainage_area or 0.0)
            down[c] = group[0] if len(group) == 1 else _nearest(ends, c, np.array(group))[0]
        elif following:
            lost.append(c)
    _find_nameless(lines, ends, np.array(lost, np.int64), down)
    for group in place.values():
        for c in group if len(group) > 1 else ():
            begins, gap = _nearest(ends, c, np.array([d for d in group if d != c]))
            down[c] = begins if gap <= ends.room[c] else down[c]
    return down


def _find_nameless(lines: list[Line], ends: _Ends, lost: np.ndarray, down: np.ndarray) -> None:
    """Set for channels that name one downstream which the file does not hold a line without identity there."""
    with IMPORTING:
        from scipy.spatial import cKDTree

    nameless = np.array([c for c, line in enumerate(lines) if line.channel_id is None], np.int64)
    if not len(nameless) or not len(lost):
        return
    gap, nearest = cKDTree(ends.head[nameless]).query(ends.tail[lost])
    found = (gap <= ends.room[lost]) & (nameless[nearest] != lost)
    down[lost[found]] = nameless[nearest[found]]


def _nearest(ends: _Ends, channel: int, others: np.ndarray) -> tuple[int, float]:
    """Return which of other channels begins nearest to the end of one, and how far from it."""
    gap = np.hypot(*(ends.head[others] - ends.tail[channel]).T)
    return int(others[gap.argmin()]), float(gap.min())


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


def _node_names(lines: list[Line], noded: np.ndarray, label: str) -> np.ndarray:
    """Return names of the nodes at all upper ends, then at all lower ones, (2C,); lines without nodes get new ones."""
    count = len(lines)
    ends = np.empty(2 * count, np.int64)
    known = np.flatnonzero(noded)
    ends[known] = np.array([lines[c].from_node for c in known], np.int64)
    ends[count + known] = np.array([lines[c].to_node for c in known], np.int64)
    others = np.flatnonzero(~noded)
    if len(others):
        free = max(int(ends[known].max()), int(ends[count + known].max())) + 1
        ends[np.concatenate([others, count + others])] = free + np.arange(2 * len(others))
        warn(
            f"{label}: {len(others)} of {count} lines have no nodes (the first: "
            f"{lines[others[0]].where.rpartition(', ')[2]}); they were joined where they meet the others"
        )
    return ends


def _follow_siblings(lines: list[Line], names: np.ndarray) -> None:
    """Give lines of one identity that follow one another a node of their own between them."""
    count, ends = len(lines), _ends(lines)
    free = int(names.max()) + 1
    for group in _groups(lines).values():
        for c in group if len(group) > 1 else ():
            begins, gap = _nearest(ends, c, np.array([d for d in group if d != c]))
            if gap <= ends.room[c]:
                names[count + c] = names[begins] = free
                free += 1


def _groups(lines: list[Line]) -> dict[int, list[int]]:
    """Return the lines of each identity."""
    groups: dict[int, list[int]] = {}
    for c, line in enumerate(lines):
        if line.channel_id is not None:
            groups.setdefault(line.channel_id, []).append(c)
    return groups


def _neighbours(ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return another channel at the upper node of each, and one at its lower node; -1 where there is none: (C,) each.

    Args:
        ends: (2C,) names of the nodes at all upper ends, then at all lower ones.
    """
    count = len(ends) // 2
    order = np.argsort(ends, kind="stable")
    names, channel = ends[order], order % count
    found = np.full(2 * count, -1, np.int64)
    # The one before or after it in the list of all that touch the node.
    after = np.append(names[1:] == names[:-1], False)
    before = np.insert(names[1:] == names[:-1], 0, False)
    found[order[after]] = np.roll(channel, -1)[after]
    found[order[before & ~after]] = np.roll(channel, 1)[before & ~after]
    found[found == np.tile(np.arange(count), 2)] = -1
    return found[:count], found[count:]


def _turn(
    lines: list[Line], above: np.ndarray, below: np.ndarray, known: dict[int, tuple[float, float]], label: str
) -> None:
    """Turn lines round whose upper end touches what lies downstream, or whose lower end what lies upstream.

    Args:
        lines: The channels.
        above: (C,) a channel that each meets at its upper node, -1 for none.
        below: (C,) one that it meets at its lower node.
        known: Positions of nodes by the names that the lines have for theirs.
        label: What to call the file in messages.
    """
    ends = _ends(lines)
    head_up, tail_up = np.zeros((2, len(lines)), bool)
    head_down, tail_down = np.zeros((2, len(lines)), bool)
    for other, at_head, at_tail in ((above, head_up, tail_up), (below, head_down, tail_down)):
        has = np.flatnonzero(other >= 0)
        at_head[has] = ends.off(ends.head[has], other[has]) <= ends.room[has]
        at_tail[has] = ends.off(ends.tail[has], other[has]) <= ends.room[has]
    for c in np.flatnonzero(~(head_up | tail_up | head_down | tail_down)) if known else ():
        upper, lower = (
            known.get(node) if node is not None else None for node in (lines[c].from_node, lines[c].to_node)
        )
        if upper is not None and lower is not None:
            near = [np.hypot(*(ends[k][c] - node)) <= ends.room[c] for node in (upper, lower) for k in (0, 1)]
            head_up[c], tail_up[c], head_down[c], tail_down[c] = near
    wrong = (tail_up & ~head_up | head_down & ~tail_down) & ~(head_up & ~tail_up | tail_down & ~head_down)
    for c in np.flatnonzero(wrong):
        lines[c].reverse()
    if wrong.any():
        log.info("%s: %d lines that ran upstream were turned", label, int(wrong.sum()))


def _ends(lines: list[Line]) -> _Ends:
    """First and last point of each line, and how far from its node an end may lie."""
    head = np.array([line.xy[0] for line in lines])
    tail = np.array([line.xy[-1] for line in lines])
    width = np.array([float(np.mean(line.width)) for line in lines])
    length = np.array([float(np.hypot(*np.diff(line.xy, axis=0).T).sum()) for line in lines])
    # A width that is not positive is told when the network is built.
    return _Ends(head, tail, np.maximum(np.minimum(GAP_WIDTHS * width, GAP_FRACTION * length), 0.0))


def _nodes(
    lines: list[Line], names: np.ndarray, known: dict[int, tuple[float, float]], irregular: np.ndarray, label: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes above and below each channel and their positions.

    Args:
        lines: The channels.
        names: (2C,) names of the nodes at all upper ends, then at all lower ones.
        known: Positions of nodes by name, where the file states them.
        irregular: (C,) lines whose ends join what they meet, where the file joins them to nothing near.
        label: What to call the file in messages.
    """
    count = len(lines)
    ends = _ends(lines)
    xy, room = np.concatenate([ends.head, ends.tail]), np.tile(ends.room, 2)
    at, node_xy, alone = _placed_nodes(names, xy, room, known)
    gap = np.hypot(*(xy - node_xy[at]).T)
    apart = np.flatnonzero(gap > room)
    tolerance = NODE_TOLERANCE * float(min(np.min(line.width) for line in lines))
    loose = np.intersect1d(np.union1d(apart, alone), np.flatnonzero(np.tile(irregular, 2)))
    at, node_xy, free = _met(at, node_xy, xy, loose, apart, tolerance)
    if len(free):
        worst = int(free[gap[free].argmax()])
        warn(
            f"{label}: {len(free)} ends lie more than a width (or half their line) from the node or channel "
            f"that the file joins them to, and are left free (the furthest, {gap[worst]:.4g} m: "
            f"{lines[worst % count].where.rpartition(', ')[2]})"
        )
    gap[apart] = 0.0
    moved = np.flatnonzero(gap > NODE_TOLERANCE * room)
    for k in moved.tolist():
        line = lines[k % count]
        line.xy[0 if k < count else -1] = node_xy[at[k]]
    if len(moved):
        log.info("%s: %d ends were brought to their nodes", label, len(moved))
    used, at = np.unique(at, return_inverse=True)
    return at[:count], at[count:], node_xy[used]


def _placed_nodes(
    names: np.ndarray, xy: np.ndarray, room: np.ndarray, known: dict[int, tuple[float, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the node of each end, the places of the nodes, and the ends that are alone at theirs.

    A node lies where the file states it, or else at its first end, upper ends first; but where ends of one name lie
    apart, where most of them do: a line that was cut has the names of both its nodes at either half.
    """
    labels, first, at, size = np.unique(names, return_index=True, return_inverse=True, return_counts=True)
    node_xy = xy[first]
    for k, name in enumerate(labels.tolist()):
        if name in known:
            node_xy[k] = known[name]
    order = np.argsort(at, kind="stable")
    begin = np.concatenate([[0], np.cumsum(size)])
    for k in np.unique(at[np.hypot(*(xy - node_xy[at]).T) > room]).tolist():
        own = order[begin[k] : begin[k + 1]]
        apart = np.hypot(*(xy[own][:, None] - xy[own]).transpose(2, 0, 1)) > room[own]
        if apart.any() or labels[k] in known:
            stays = (np.hypot(*(xy[own] - node_xy[k]).T) <= room[own]).sum()
            votes = (~apart).sum(axis=1)
            if votes.max() > stays:
                node_xy[k] = xy[own[int(votes.argmax())]]
    return at, node_xy, np.flatnonzero(size[at] == 1)


def _met(
    at: np.ndarray, node_xy: np.ndarray, xy: np.ndarray, loose: np.ndarray, apart: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Let ends that are apart from their node have one of their own, and join loose ends where they meet others.

    Args:
        at: (2C,) node of each end.
        node_xy: (N, 2) places of the nodes.
        xy: (2C, 2) the ends.
        loose: Ends that may join what they meet.
        apart: Ends that are apart from their node.
        tolerance: How near ends meet, m.

    Returns:
        The nodes of the ends, their places, and which ends meet nothing although the file joins them.
    """
    with IMPORTING:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import cKDTree

    at = at.copy()
    at[apart] = len(node_xy) + np.arange(len(apart))
    node_xy = np.concatenate([node_xy, xy[apart]])
    if not len(loose):
        return at, node_xy, apart
    # Nodes that no end is left at do not count.
    used = np.unique(at)
    pairs = used[cKDTree(node_xy[used]).query_pairs(tolerance, output_type="ndarray")]
    may = np.zeros(len(node_xy), bool)
    may[at[loose]] = True
    pairs = pairs[may[pairs].any(axis=1)]
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(node_xy), len(node_xy)))
    _, group = connected_components(graph, directed=False)
    # The oldest node of a group stands for it: one that the file names, if there is one.
    _, oldest = np.unique(group, return_index=True)
    at = oldest[group][at]
    size = np.bincount(at, minlength=len(node_xy))
    return at, node_xy, apart[size[at[apart]] == 1]
