"""Edits of a network by its author: channels that are divided, joined, added, removed, redrawn, widened.

All of them say which channels become which *courses*, lines made of runs of old points and of points that were drawn,
and end in the same :class:`~warpriver.graph.edits.EditedChannels` as a collision. What is not named stays as it is, to
the bit: flow is not added up anew but changed along the way downstream by what is more or less of it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from warpriver.channel_table import JOINT_LOCK, JOINT_NONE
from warpriver.errors import InputError
from warpriver.graph.edits import JUNCTION_CLEARANCE, EditedChannels, valid_joints
from warpriver.hydraulic_geometry import DEPTH_BY_WIDTH, DISCHARGE_BY_AREA, WIDTH_BY_FLOW
from warpriver.network import RiverNetwork

__all__ = ["Reworking", "nearest_point", "river_of", "smooth_line"]

# A network given with less flow downstream of a junction than above it must still not run dry.
MIN_FLOW = 1e-6


def river_of(network: RiverNetwork, channel: int) -> list[int]:
    """Return the parts of a channel between its locked points, downstream; mostly it is its only part.

    Args:
        network: The network.
        channel: Index of any part.
    """
    parts = [channel]
    while (below := _after_lock(network, parts[-1])) >= 0 and below != channel:
        parts.append(below)
    while (above := _before_lock(network, parts[0])) >= 0 and above not in parts:
        parts.insert(0, above)
    return parts


def _after_lock(network: RiverNetwork, channel: int) -> int:
    if network.channel_joint[channel] != JOINT_LOCK:
        return -1
    leaving = np.flatnonzero(network.channel_from == network.channel_to[channel])
    return int(leaving[0]) if len(leaving) == 1 else -1


def _before_lock(network: RiverNetwork, channel: int) -> int:
    arriving = np.flatnonzero(network.channel_to == network.channel_from[channel])
    locked = len(arriving) == 1 and network.channel_joint[arriving[0]] == JOINT_LOCK
    return int(arriving[0]) if locked and arriving[0] != channel else -1


def smooth_line(xy: np.ndarray, spacing: float) -> np.ndarray:
    """Return points along a smooth line through some, no farther apart than the spacing, those given among them.

    Between two of them the line is a cubic whose tangents are the central differences by arc length at both; a straight
    line stays one.

    Args:
        xy: (n, 2) points in m, n at least 2, none of them twice in a row.
        spacing: m.
    """
    step = np.diff(xy, axis=0)
    size = np.hypot(*step.T)
    slope = step / size[:, None]
    tangent = np.concatenate([slope[:1], slope, slope[-1:]])
    # Weighted by the other segment: exact on a parabola.
    before, after = np.concatenate([size[:1], size]), np.concatenate([size, size[-1:]])
    tangent = (tangent[:-1] * after[:, None] + tangent[1:] * before[:, None]) / (before + after)[:, None]
    count = np.maximum(np.ceil(size / spacing).astype(int), 1)
    segment = np.repeat(np.arange(len(size)), count)
    first = np.concatenate([[0], np.cumsum(count)])
    u = ((np.arange(first[-1]) - first[segment]) / count[segment])[:, None]
    v = 1.0 - u
    line = xy[segment] + u * u * (3.0 - 2.0 * u) * step[segment]
    line += size[segment][:, None] * u * v * (v * tangent[segment] - u * tangent[segment + 1])
    return np.concatenate([line, xy[-1:]])


@dataclasses.dataclass
class _Run:
    """Points first .. stop - 1, from the network's count on those that were drawn; factors of width and depth."""

    first: int
    stop: int
    gain: tuple[float, float] = (1.0, 1.0)


@dataclasses.dataclass
class _Course:
    """What a channel is after the edit.

    Attributes:
        source: Channel, before, that what is not said here is of.
        runs: What its points are, downstream.
        head, foot: Nodes; from the network's count on new ones.
        columns: Values in the table that differ from those of ``source``.
        changed: Whether the points are not those of the source.
    """

    source: int
    runs: list[_Run]
    head: int
    foot: int
    columns: dict[str, Any] = dataclasses.field(default_factory=dict)
    changed: bool = False

    @property
    def count(self) -> int:
        return sum(run.stop - run.first for run in self.runs)

    def widen(self, width: float, depth: float) -> None:
        """Multiply width and depth of its points."""
        for run in self.runs:
            run.gain = run.gain[0] * width, run.gain[1] * depth


class _Flows(dict[int, float]):
    """Flow at the foot of channels: what was set, or else that of the network before."""

    def __init__(self, flow: np.ndarray):
        super().__init__()
        self._before = flow

    def __missing__(self, c: int) -> float:
        return float(self._before[c])


class Reworking:
    """A network on its way through one edit: name what changes, then :meth:`build` the channels afterwards.

    Channels are named by their index before; those that are new have numbers from the network's count on.

    Attributes:
        network: The network before.
    """

    def __init__(self, network: RiverNetwork, spacing: np.ndarray, next_identity: int):
        """Take a network as it is.

        Args:
            network: The network.
            spacing: (C,) spacing of the points of its channels, m.
            next_identity: Least identity that a new channel may get.
        """
        self.network = network
        self._start = network.starts()
        self._spacing = spacing
        self._next_identity = max(next_identity, int(network.channel_id.max()) + 1)
        self._courses: dict[int, _Course] = {}
        self._removed: set[int] = set()
        self._count = network.channel_count
        self._node_xy: dict[int, np.ndarray] = {}
        self._node_count = network.node_count
        self._drawn: list[np.ndarray] = []
        self._drawn_section: list[np.ndarray] = []
        self._drawn_count = 0
        self._flow = _Flows(network.channel_flow())
        area = network.channel_drainage_area
        # What adds up at junctions is the area where it is known of all channels, else the discharge.
        self._by_area = area is not None and bool(np.isfinite(area).all())

    # ---- the graph as it is now

    def _course(self, c: int) -> _Course:
        if c not in self._courses:
            ends = int(self.network.channel_from[c]), int(self.network.channel_to[c])
            self._courses[c] = _Course(c, [_Run(int(self._start[c]), int(self._start[c + 1]))], *ends)
        return self._courses[c]

    def _head(self, c: int) -> int:
        return self._courses[c].head if c in self._courses else int(self.network.channel_from[c])

    def _foot(self, c: int) -> int:
        return self._courses[c].foot if c in self._courses else int(self.network.channel_to[c])

    def _meeting(self, node: int, ends: np.ndarray, end_of: Any) -> list[int]:
        plain = [c for c in np.flatnonzero(ends == node).tolist() if c not in self._courses and c not in self._removed]
        edited = [c for c in self._courses if c not in self._removed and end_of(c) == node]
        return sorted(plain + edited)

    def arriving(self, node: int) -> list[int]:
        """Channels that end at a node; a ring does not."""
        found = self._meeting(node, self.network.channel_to, self._foot)
        return [c for c in found if c >= self.network.channel_count or not self.network.channel_closed[c]]

    def leaving(self, node: int) -> list[int]:
        """Channels that begin at a node."""
        found = self._meeting(node, self.network.channel_from, self._head)
        return [c for c in found if c >= self.network.channel_count or not self.network.channel_closed[c]]

    def joint(self, c: int) -> int:
        """What the node at the foot of a channel is to the river."""
        return int(self._value(c, "joint"))

    def _value(self, c: int, column: str) -> Any:
        """Value of a channel in the table as it is now."""
        course = self._courses.get(c)
        if course is not None and column in course.columns:
            return course.columns[column]
        return self.network.channels[column][c if course is None else course.source]

    # ---- lines

    def _draw(self, xy: np.ndarray, section: np.ndarray | None = None) -> _Run:
        """Take points, m, absolute, with width and depth where these vary, and return them as a run."""
        first = self.network.point_count + self._drawn_count
        self._drawn.append(xy)
        self._drawn_count += len(xy)
        if self.network.point_section is not None:
            assert section is not None
            self._drawn_section.append(section)
        return _Run(first, first + len(xy))

    def line(self, c: int) -> np.ndarray:
        """Points of a channel as they were, m, absolute, (n, 2) float64."""
        first, stop = int(self._start[c]), int(self._start[c + 1])
        line: np.ndarray = self.network.point_xy[first:stop].numpy().astype(np.float64) + self.network.origin
        return line

    def section(self, c: int) -> np.ndarray | None:
        """Width and depth at the points of a channel as they were, m; None where they do not vary."""
        if self.network.point_section is None:
            return None
        first, stop = int(self._start[c]), int(self._start[c + 1])
        section: np.ndarray | None = self.network.point_section[first:stop].numpy().astype(np.float64)
        return section

    def redraw(self, c: int, begin: int, stop: int, xy: np.ndarray) -> None:
        """Put points in place of some of a channel, which has not been edited otherwise.

        As many as before keep their widths and depths, where these vary; others get them in even steps from the point
        before to the point after.

        Args:
            c: Channel.
            begin: Index of the first point that is replaced, among those of the channel.
            stop: Index of the first one after it that is not.
            xy: (n, 2) m.
        """
        course = self._course(c)
        (whole,) = course.runs
        section = self.section(c)
        if section is not None:
            if len(xy) == stop - begin:
                section = section[begin:stop]
            else:
                part = (np.arange(1, len(xy) + 1) / (len(xy) + 1))[:, None]
                section = (1.0 - part) * section[begin - 1] + part * section[min(stop, len(section) - 1)]
        before, after = _Run(whole.first, whole.first + begin), _Run(whole.first + stop, whole.stop)
        runs = [before, self._draw(xy, section), after]
        course.runs, course.changed = [run for run in runs if run.first < run.stop], True

    def divert(self, c: int, point: int, xy: np.ndarray, node: int) -> None:
        """Let a channel leave its course at a point for a node, and take its water along; the rest of it falls dry.

        The part upstream of the point is a new one, and goes on along the line.

        Args:
            c: Channel, which has not been edited.
            point: Index in all points.
            xy: (n, 2) m, from the point to the node, both included.
            node: Where it ends.
        """
        upper = self.split(c, point, JOINT_NONE)
        course, section = self._courses[upper], self.section(c)
        if section is not None:
            section = np.repeat(section[point - int(self._start[c])][None], len(xy) - 1, axis=0)
        course.runs.append(self._draw(xy[1:], section))
        course.foot, course.changed = node, True
        # It is the same channel, on another course.
        course.columns["id"] = self._value(c, "id")
        self.add_flow(node, self._flow[upper])
        self.remove([c])

    def place_node(self, node: int, xy: np.ndarray) -> None:
        """Move a node; the ends of channels there are the caller's affair."""
        self._node_xy[node] = np.asarray(xy, np.float64)

    def resize(self, c: int, width: float | None, depth: float | None) -> None:
        """Set width and depth of a channel, m; where they vary along it all change by the same factor."""
        course = self._course(c)
        scale = [1.0, 1.0]
        for k, (name, value) in enumerate((("width", width), ("depth", depth))):
            if value is not None:
                before = float(self._value(c, name))
                # What is set to what it was stays, to the bit.
                scale[k] = 1.0 if value == before else value / before
                course.columns[name] = value
        course.widen(*scale)

    # ---- graph

    def split(self, c: int, point: int, joint: int, flow: float | None = None) -> int:
        """Divide a channel at one of its points, and return the new part upstream; the node between is new.

        Args:
            c: Channel, as it was.
            point: Index in all points.
            joint: What the node is to the river.
            flow: Flow at the foot of the part upstream; by default that of the channel.
        """
        lower = self._course(c)
        (whole,) = lower.runs
        node, upper = self._new_node(point), self._count
        self._count += 1
        columns = {**lower.columns, "id": self._new_identity(), "joint": joint}
        self._courses[upper] = _Course(
            lower.source, [_Run(whole.first, point + 1, whole.gain)], lower.head, node, columns
        )
        lower.runs, lower.head = [_Run(point, whole.stop, whole.gain)], node
        self._flow[upper] = self._flow[c]
        if flow is not None:
            self._regain(upper, flow)
        return upper

    def _new_node(self, point: int) -> int:
        node, self._node_count = self._node_count, self._node_count + 1
        at = self.network.point_xy[point : point + 1].numpy()[0].astype(np.float64)
        self._node_xy[node] = at + self.network.origin
        return node

    def _new_identity(self) -> int:
        identity, self._next_identity = self._next_identity, self._next_identity + 1
        return identity

    def join(self, upper: int, lower: int) -> None:
        """Make one channel of two that follow each other: it is the lower one, and begins where the upper one did."""
        above, below = self._course(upper), self._course(lower)
        # Points that are spaced alike stay where they are, to the bit.
        alike = self._spacing_of(upper) == self._spacing_of(lower)
        below.changed = below.changed or above.changed or not alike
        slopes = [float(self._value(c, "slope")) for c in (upper, lower)]
        lengths = [(self._course(c).count - 1) * self._spacing_of(c) for c in (upper, lower)]
        if slopes[0] != slopes[1]:
            below.columns["slope"] = np.average(slopes, weights=lengths)
        if self.network.point_section is not None:
            # Each point keeps its own; the channel's are the means.
            for name in ("width", "depth"):
                sizes = [float(self._value(c, name)) for c in (upper, lower)]
                if sizes[0] != sizes[1]:
                    below.columns[name] = np.average(sizes, weights=lengths)
        # The first point of the lower one is the last of the upper one.
        below.runs[0].first += 1
        below.runs = [*above.runs, *below.runs]
        below.head = above.head
        self._removed.add(upper)

    def _spacing_of(self, c: int) -> float:
        course = self._courses.get(c)
        return float(self._spacing[c if course is None else course.source])

    def remove(self, parts: list[int]) -> None:
        """Take a channel out, with what falls dry downstream of it; the flow downstream is less by what it carried.

        Args:
            parts: The channel, or all its parts between locked points, downstream.

        Raises:
            ValueError: A locked point would fall dry.
        """
        self._removed.update(parts)
        lost, node = self._flow[parts[-1]], self._foot(parts[-1])
        while not self.arriving(node) and (below := self.leaving(node)):
            dry = below[0]
            if self.joint(dry) == JOINT_LOCK:
                raise InputError(
                    f"channel {self._value(dry, 'id')} would fall dry, and has a locked point; unlock that first"
                )
            self._removed.add(dry)
            lost, node = self._flow[dry], self._foot(dry)
        self.add_flow(node, -lost)
        arriving, below = self.arriving(node), self.leaving(node)
        if len(arriving) == 1 and len(below) == 1:
            self._dissolve(arriving[0], below[0])

    def _dissolve(self, upper: int, lower: int) -> None:
        """Join two where a junction was; width and depth follow from the one whose flow was nearest to that now."""
        source = self._course(lower).source
        now, above, before = self._flow[lower], self._flow[upper], float(self.network.channel_flow()[source])
        identity = self._value(upper, "id")
        self.join(upper, lower)
        if lower >= self.network.channel_count:
            # A part that was cut off in the same edit has an identity that nobody knows yet.
            self._course(lower).columns["id"] = identity
        if abs(math.log(now / above)) < abs(math.log(now / before)):
            widen = (now / above) ** WIDTH_BY_FLOW
            width, depth = float(self._value(upper, "width")), float(self._value(upper, "depth"))
            self._course(lower).columns |= {"width": width * widen, "depth": depth * widen**DEPTH_BY_WIDTH}

    def add_flow(self, node: int, more: float) -> None:
        """Let more or less water, as drainage area or discharge, go down from a node; width and depth follow.

        A channel that carries less than arrives at its head, as files and edits may have it, keeps that fraction of
        what is left.
        """
        seen: set[int] = set()
        while (below := self.leaving(node)) and below[0] not in seen:
            c = below[0]
            seen.add(c)
            before, now = self._flow[c], self._flow[c] + more
            left = sum(self._flow[upper] for upper in self.arriving(node))
            if more < 0.0 and before < (left - more) * (1.0 - 1e-9):
                now = before * left / (left - more)
            self._regain(c, max(now, MIN_FLOW * before))
            more, node = self._flow[c] - before, self._foot(c)

    def _regain(self, c: int, flow: float) -> None:
        """Let a channel carry so much; width, depth, discharge and area follow."""
        gain = flow / self._flow[c]
        if gain == 1.0:
            return
        self._flow[c] = flow
        course, widen = self._course(c), gain**WIDTH_BY_FLOW
        deepen = widen**DEPTH_BY_WIDTH
        values = {
            "width": widen,
            "depth": deepen,
            "discharge": gain**DISCHARGE_BY_AREA if self._by_area else gain,
        }
        if self.network.channel_drainage_area is not None:
            values["drainage_area"] = gain if self._by_area else gain ** (1.0 / DISCHARGE_BY_AREA)
        course.columns |= {name: float(self._value(c, name)) * factor for name, factor in values.items()}
        course.widen(widen, deepen)

    def set_discharge(self, c: int, discharge: float, *, alone: bool = False) -> None:
        """Set the discharge of a channel in m3/s; unless ``alone``, what is more or less of it goes on downstream."""
        before, gain = self._flow[c], discharge / float(self._value(c, "discharge"))
        self._regain(c, before * (gain ** (1.0 / DISCHARGE_BY_AREA) if self._by_area else gain))
        self._course(c).columns["discharge"] = discharge
        if not alone:
            self.add_flow(self._foot(c), self._flow[c] - before)

    def junction_at(self, c: int, point: int) -> int:
        """Return the node at a point of a channel, which is divided there, or the one at its end that is near.

        Its own ground drains to the two parts by length, that of a source to the part upstream.
        """
        first, stop = int(self._start[c]), int(self._start[c + 1])
        if stop - first < 2 * JUNCTION_CLEARANCE + 1 or point < first + JUNCTION_CLEARANCE:
            at_head = point - first <= stop - 1 - point
            return self._head(c) if at_head else self._foot(c)
        if point > stop - 1 - JUNCTION_CLEARANCE:
            return self._foot(c)
        above = self.arriving(self._head(c))
        supply = self._flow[c] - sum(self._flow[a] for a in above)
        kept = (point - first) / (stop - 1 - first) if above else 1.0
        upper = self.split(c, point, JOINT_NONE, max(self._flow[c] - (1.0 - kept) * supply, MIN_FLOW * self._flow[c]))
        return self._courses[upper].foot

    def add(self, xy: np.ndarray, node: int | None, columns: dict[str, Any], model: int) -> int:
        """Add a channel along points, m, to a node or to an outlet of its own, and return its number.

        Args:
            xy: (n, 2) m, downstream; the last point lies at the node.
            node: Where it ends; None: at a new one.
            columns: Its values in the table, ``width``, ``depth`` and ``discharge`` at least.
            model: Channel from which it has the free columns.
        """
        section = np.tile([columns["width"], columns["depth"]], (len(xy), 1))
        c, self._count = self._count, self._count + 1
        head, self._node_count = self._node_count, self._node_count + 1
        self._node_xy[head] = xy[0]
        if node is None:
            node, self._node_count = self._node_count, self._node_count + 1
            self._node_xy[node] = xy[-1]
        if self.network.channel_drainage_area is not None:
            # As much ground as the channels there drain for as much water.
            q, area = float(self.network.channel_discharge[model]), float(self.network.channel_drainage_area[model])
            columns = {"drainage_area": area * (columns["discharge"] / q) ** (1.0 / DISCHARGE_BY_AREA), **columns}
        kept = {"id": self._new_identity(), "joint": JOINT_NONE, "slope": np.nan, "closed": False}
        self._flow[c] = columns["drainage_area" if self._by_area else "discharge"]
        self._courses[c] = _Course(model, [self._draw(xy, section)], head, node, {**kept, **columns}, changed=True)
        self.add_flow(node, self._flow[c])
        return c

    def outlet(self, xy: np.ndarray) -> int:
        """Return a new node at a place, m, from which nothing flows on."""
        node, self._node_count = self._node_count, self._node_count + 1
        self._node_xy[node] = np.asarray(xy, np.float64)
        return node

    def node_place(self, node: int) -> np.ndarray:
        """Position of a node, m."""
        return self._node_xy[node] if node in self._node_xy else self.network.node_xy[node]

    # ---- the channels afterwards

    def build(self) -> EditedChannels:
        """Return the channels after the edit, and where their points come from.

        Raises:
            ValueError: No channel is left.
        """
        old, count = self.network, self.network.channel_count
        kept = np.ones(count, bool)
        kept[[c for c in self._removed if c < count]] = False
        added = [c for c in range(count, self._count) if c not in self._removed]
        order = np.concatenate([np.flatnonzero(kept), np.array(added, np.int64)])
        if not len(order):
            raise InputError("no channel would be left; a network has at least one")
        edited = {c: int(np.searchsorted(order, c)) for c in sorted(self._courses) if c not in self._removed}
        # Added channels are rows of their courses; until then any will do.
        plain = np.minimum(order, count - 1)
        source, changed = plain.copy(), np.zeros(len(order), bool)
        ends = np.stack([old.channel_from[plain], old.channel_to[plain]], axis=1).astype(np.int64)
        for c, row in edited.items():
            course = self._courses[c]
            source[row], changed[row], ends[row] = course.source, course.changed, (course.head, course.foot)
        nodes, label = np.unique(ends, return_inverse=True)
        label = label.reshape(ends.shape)
        runs, scale, counts = self._runs(order, edited)
        table = self._table(edited, source).replace(from_node=label[:, 0], to_node=label[:, 1])
        table = table.replace(joint=valid_joints(table.joint, table.from_node, table.to_node))
        length = runs[:, 1] - runs[:, 0]
        return EditedChannels(
            channel_old=source,
            channel_start=np.concatenate([[0], np.cumsum(counts)]),
            channels=table,
            node_xy=self._places(nodes),
            channel_changed=changed,
            run_begin=runs[:, 0],
            run_start=np.concatenate([[0], np.cumsum(length)]),
            run_scale=None if old.point_section is None else scale,
            drawn_xy=np.concatenate(self._drawn) if self._drawn else None,
            drawn_section=np.concatenate(self._drawn_section) if self._drawn_section else None,
        )

    def _places(self, nodes: np.ndarray) -> np.ndarray:
        """Positions of nodes, (N, 2) m."""
        old = self.network
        xy: np.ndarray = old.node_xy[np.minimum(nodes, old.node_count - 1)].copy()
        rows = np.searchsorted(nodes, list(self._node_xy))
        for row, (node, place) in zip(rows.tolist(), self._node_xy.items(), strict=True):
            if row < len(nodes) and nodes[row] == node:
                xy[row] = place
        return xy

    def _runs(self, order: np.ndarray, edited: dict[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Runs of points of all channels in order, the factors of their width and depth, points of each channel.

        Args:
            order: Channels.
            edited: Place in it of those that have a course of their own.
        """
        counts = np.diff(self._start)[np.minimum(order, self.network.channel_count - 1)].astype(np.int64)
        plain = np.ones(len(order), bool)
        plain[list(edited.values())] = False
        rows = np.flatnonzero(plain)
        # Channels that stay and follow each other are one run.
        breaks = np.flatnonzero((np.diff(order[rows]) != 1) | (np.diff(rows) != 1)) + 1
        blocks = np.split(rows, breaks) if len(rows) else []
        found = [
            (int(block[0]), [_Run(int(self._start[order[block[0]]]), int(self._start[order[block[-1]] + 1]))])
            for block in blocks
        ]
        for c, row in edited.items():
            found.append((row, self._courses[c].runs))
            counts[row] = self._courses[c].count
        runs = [run for _, own in sorted(found, key=lambda each: each[0]) for run in own if run.first < run.stop]
        return np.array([(run.first, run.stop) for run in runs]), np.array([run.gain for run in runs]), counts

    def _table(self, edited: dict[int, int], source: np.ndarray) -> Any:
        table = self.network.channels.take(source)
        columns: dict[str, Any] = {}
        for c, row in edited.items():
            for name, value in self._courses[c].columns.items():
                if name not in columns:
                    columns[name] = table[name].copy()
                columns[name][row] = value
        return table.replace(**columns) if columns else table


def nearest_point(xy: np.ndarray, place: Iterable[float]) -> tuple[int, float]:
    """Return the index of the point nearest to a place, the first of equals, and how far it is, m."""
    away = np.hypot(*(xy - np.asarray(place, np.float64)).T)
    k = int(away.argmin())
    return k, float(away[k])
