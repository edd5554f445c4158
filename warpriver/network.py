"""RiverNetwork: channels and nodes on the host, their points packed end to end on the device."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import warp as wp

from warpriver.crs import is_geographic, short_name
from warpriver.kernels.polyline import RING_POINTS

__all__ = ["RiverNetwork", "bankfull_depth", "bankfull_discharge", "bankfull_width"]

PRECISIONS = {"float64": (wp.float64, wp.vec2d, np.float64), "float32": (wp.float32, wp.vec2f, np.float32)}

# Two channel ends closer than this part of the narrower width are one node.
NODE_TOLERANCE = 1e-3
# The ends of a line that is to be a ring may be so many times its longest segment, or its width, apart.
RING_GAP = 3.0


def bankfull_depth(width: Any) -> Any:
    """Bankfull depth in m of a channel ``width`` m wide, from w = 18.8 d^1.41 [Konsoer2013]."""
    return (np.asarray(width, np.float64) / 18.8) ** (1.0 / 1.41)


def bankfull_width(depth: Any) -> Any:
    """Bankfull width in m of a channel ``depth`` m deep, w = 18.8 d^1.41 [Konsoer2013]."""
    return 18.8 * np.asarray(depth, np.float64) ** 1.41


def bankfull_discharge(width: Any) -> Any:
    """Bankfull discharge in m3/s of a channel ``width`` m wide, from w = 7.2 Q^0.5 [Andreadis2013]."""
    return (np.asarray(width, np.float64) / 7.2) ** 2


def resolve_device(device: Any) -> Any:
    """Return the Warp device of that name, or raise ``ValueError`` that lists the devices of this machine."""
    try:
        return wp.get_device(device)
    except Exception as error:
        known = ", ".join(d.alias for d in wp.get_devices())
        raise ValueError(f"device {device!r} is not on this machine; it has: {known}") from error


class RiverNetwork:
    """Channels between nodes, each a line of points from upstream to downstream.

    Build one with :meth:`from_polylines` or ``warpriver.read_network``. The points of all channels lie end to end in
    one device array, ``point_xy``, cut by ``channel_start``; what belongs to a whole channel is NumPy on the host.

    Attributes:
        channel_width: (C,) float64, bankfull width in m (the mean, where it varies along the channel).
        channel_depth: (C,) float64, bankfull depth in m.
        channel_discharge: (C,) float64, bankfull discharge in m3/s at the downstream end.
        channel_drainage_area: (C,) float64, drainage area in m2 at the downstream end, or None where it is not known.
        channel_slope: (C,) float64, drop of the channel from its upstream to its downstream end over its length, m/m;
            NaN where it is not known. It is that of the channel as it was found: migration and cutoffs leave it, a
            collision hands it on (each part keeps the slope of the channel it was cut from, and parts that become one
            channel get the drop of all over their length).
        channel_id: (C,) int64, identity that a channel keeps when others come and go.
        channel_from: (C,) int32, node at the upstream end.
        channel_to: (C,) int32, node at the downstream end.
        channel_closed: (C,) bool, True for a ring: its last point is joined to its first, which is not repeated, and
            its one node is its own.
        node_xy: (N, 2) float64, node positions in m, absolute.
        origin: (2,) float64, absolute position of the device coordinates' zero.
        crs: Coordinate reference system as text ("EPSG:32619", WKT ...), or None.
        dtype: "float64" or "float32", the precision on the device.
        point_xy: device array of 2-vectors, m, relative to ``origin``; only the first ``point_count`` are in use.
        point_section: device array of (width, depth) in m at each point, or None where they are constant along a
            channel.
        channel_start: device int32 array (C + 1,): channel c owns the points channel_start[c] to
            channel_start[c + 1] - 1.
    """

    def __init__(
        self,
        point_xy: np.ndarray,
        channel_start: np.ndarray,
        *,
        channel_width: np.ndarray,
        channel_depth: np.ndarray,
        channel_discharge: np.ndarray,
        channel_drainage_area: np.ndarray | None = None,
        channel_slope: np.ndarray | None = None,
        channel_id: np.ndarray | None = None,
        channel_nodes: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
        channel_closed: np.ndarray | None = None,
        point_section: np.ndarray | None = None,
        origin: Sequence[float] | np.ndarray = (0.0, 0.0),
        crs: str | None = None,
        dtype: str = "float64",
        device: Any = "cpu",
    ):
        """Wrap packed arrays; users call :meth:`from_polylines`, which checks the lines as well as the graph.

        A channel that meets no other is a basin of its own. Rings, channels that part and channels that flow in a
        circle can be held, read and written; a simulation and stream orders refuse them.

        Args:
            point_xy: (P, 2) points relative to ``origin``.
            channel_start: (C + 1,) int32 offsets into the points.
            channel_width: (C,) m.
            channel_depth: (C,) m.
            channel_discharge: (C,) m3/s.
            channel_drainage_area: (C,) m2, or None where it is not known.
            channel_slope: (C,) m/m, NaN where it is not known; None: nowhere.
            channel_id: (C,) identities; by default the indices.
            channel_nodes: (from, to, node_xy); by default ends that coincide are one node.
            channel_closed: (C,) True for rings; by default there are none.
            point_section: (P, 2) width and depth at each point in m, or None.
            origin: Absolute position of the points' zero, m.
            crs: Coordinate reference system.
            dtype: "float64" or "float32".
            device: Warp device name.

        Raises:
            ValueError: Arrays that do not fit together, a channel of fewer than 2 points or of no length, an identity
                that stands twice, a node that is not there, or one that no channel touches.
        """
        if dtype not in PRECISIONS:
            raise ValueError(f"dtype is {dtype!r}; use 'float64' or 'float32'")
        _, vec2, real = PRECISIONS[dtype]
        self.dtype = dtype
        self.device = resolve_device(device)
        self.origin = np.array(origin, np.float64)
        self.crs = crs
        self.channel_start: wp.array
        self.channel_drainage_area: np.ndarray | None = None
        start = np.array(channel_start, np.int32)
        count = len(channel_width)
        _check_packed(np.asarray(point_xy), start, count)
        closed = np.zeros(count, bool) if channel_closed is None else np.asarray(channel_closed, bool)
        if channel_nodes is None:
            tolerance = NODE_TOLERANCE * float(np.min(channel_width))
            channel_nodes = _find_nodes(np.asarray(point_xy, np.float64), start, closed, tolerance, self.origin)
        identity = np.arange(count) if channel_id is None else np.asarray(channel_id)
        above, below, node_xy = map(np.asarray, channel_nodes)
        _check_graph(count, identity, above, below, node_xy)
        self.replace_channels(
            start,
            channel_width=channel_width,
            channel_depth=channel_depth,
            channel_discharge=channel_discharge,
            channel_drainage_area=channel_drainage_area,
            channel_slope=channel_slope,
            channel_id=identity,
            channel_nodes=channel_nodes,
            channel_closed=closed,
        )
        self.point_xy: wp.array = wp.array(np.asarray(point_xy, real), dtype=vec2, device=self.device)
        self.point_section: wp.array | None = None
        if point_section is not None:
            self.point_section = wp.array(np.asarray(point_section, real), dtype=vec2, device=self.device)

    @classmethod
    def from_polylines(
        cls,
        polylines: Iterable[Any],
        width: Any,
        depth: Any = None,
        discharge: Any = None,
        *,
        drainage_area: Any = None,
        slope: Any = None,
        channel_id: Any = None,
        nodes: tuple[Any, Any, Any] | None = None,
        origin: Any = None,
        allow_short: bool = False,
        closed: Any = False,
        marks: Any = None,
        crs: str | None = None,
        dtype: str = "float64",
        device: Any = "cpu",
    ) -> RiverNetwork:
        """Build a network from lines that run downstream; ends that meet become one node.

        A line marked ``closed`` is a ring, as a moat or a closed flume is: the water goes round, nothing flows in or
        out, and it never joins other channels. Its first point may be repeated at its end, or be up to three widths or
        three of its longest segments away from it. A line that meets no other is a basin of its own. Other lines that
        end where they begin, and circles of channels, are taken, and refused by a simulation.

        Args:
            polylines: One (n, 2) array of x, y in m per channel, upstream to downstream, n >= 3.
            width: Bankfull width in m: one number, one number a channel, or one (n,) array a channel where it varies.
            depth: Bankfull depth in m, in the same forms; by default from the width by w = 18.8 d^1.41.
            discharge: Bankfull discharge in m3/s, one number or one a channel; by default from the width.
            drainage_area: Drainage area in m2 at the downstream end, one number a channel, where it is known.
            slope: Drop over length of each channel in m/m, one number or one a channel, NaN where it is not known.
            channel_id: Identities of the channels, whole numbers; by default 0, 1, 2 ...
            nodes: (from, to, node_xy): node above and below each channel, as indices into node_xy, (N, 2) in m; by
                default ends that meet are one node.
            origin: Absolute position of the device coordinates' zero, m; by default the middle, in whole metres.
            allow_short: Take channels shorter than they are wide, as collisions may leave them.
            closed: True where lines are rings: one word, or one a channel.
            marks: Marked point of each ring, the one that goes on with ``ring_policy="marked"``: one index for all
                rings, or an index a channel, None where it is the first point. A ring is turned to begin there: its
                first point is the marked one, in the network, in histories and in files.
            crs: Coordinate reference system, projected; x and y are metres.
            dtype: Precision on the device, "float64" or "float32".
            device: Warp device name, "cpu" or "cuda:0".

        Raises:
            ValueError: No line, a line of fewer than 3 points, a point that is not finite or stands twice in a row, a
                width that is not positive or exceeds the line's length, a geographic CRS, shapes that do not fit, an
                identity that stands twice, a node that is not there or that no line touches; a ring of fewer than 8
                points, whose ends do not meet, or that meets another channel; a mark that is no point of its ring, or
                on a channel that is none.
                A line may cross itself: its first step cuts the loop off like any neck.
        """
        if crs is not None and is_geographic(crs):
            raise ValueError(
                f"crs {short_name(crs)} is longitude and latitude, not metres; reproject the lines first, or read them "
                'with read_network(..., to_crs="utm")'
            )
        lines = [_checked_line(xy, c) for c, xy in enumerate(polylines)]
        if not lines:
            raise ValueError("a network needs at least one line; got none")
        rings = _ring_flags(closed, len(lines))
        counts = [len(xy) for xy in lines]
        point_width = _per_point(width, counts, "width", "m")
        point_depth = [bankfull_depth(w) for w in point_width]
        if depth is not None:
            point_depth = _per_point(depth, counts, "depth", "m")
        for c in np.flatnonzero(rings).tolist():
            keep = _ring_points(lines[c], float(point_width[c].min()), c)
            lines[c], point_width[c], point_depth[c] = lines[c][:keep], point_width[c][:keep], point_depth[c][:keep]
            counts[c] = keep
        for c, mark in _ring_marks(marks, rings, counts):
            lines[c], point_width[c], point_depth[c] = (
                np.roll(a, -mark, axis=0) for a in (lines[c], point_width[c], point_depth[c])
            )
        _check_rings_apart(lines, rings, point_width)
        for c, (xy, w) in enumerate(zip(lines, point_width, strict=True)):
            length = float(np.hypot(*np.diff(xy, axis=0).T).sum())
            if w.max() > length and not allow_short:
                raise ValueError(
                    f"channel {c}: its width, {w.max():g} m, exceeds its length, {length:g} m; "
                    "check the units of both, or drop the channel"
                )
        packed = np.concatenate(lines)
        # A round origin keeps offsets exact in binary, so that moving a line by whole metres moves the result by them.
        if origin is None:
            origin = np.round(0.5 * (packed.min(axis=0) + packed.max(axis=0)))
        channel_width = np.array([_mean(w) for w in point_width])
        varies = any(np.ptp(w) > 0.0 for w in point_width) or any(np.ptp(d) > 0.0 for d in point_depth)
        section = np.stack([np.concatenate(point_width), np.concatenate(point_depth)], axis=1) if varies else None
        flow = bankfull_discharge(channel_width)
        if discharge is not None:
            flow = np.array([q[0] for q in _per_point(discharge, [1] * len(lines), "discharge", "m3/s")])
        if drainage_area is not None:
            area = _per_point(drainage_area, [1] * len(lines), "drainage_area", "m2")
            drainage_area = np.array([a[0] for a in area])
        return cls(
            packed - np.asarray(origin, np.float64),
            np.concatenate([[0], np.cumsum(counts)]),
            channel_width=channel_width,
            channel_depth=np.array([_mean(d) for d in point_depth]),
            channel_discharge=flow,
            channel_drainage_area=drainage_area,
            channel_slope=None if slope is None else _checked_slope(slope, len(lines)),
            channel_id=channel_id,
            channel_nodes=nodes,
            channel_closed=rings,
            point_section=section,
            origin=origin,
            crs=crs,
            dtype=dtype,
            device=device,
        )

    @property
    def channel_count(self) -> int:
        """Number of channels."""
        return len(self.channel_width)

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.node_xy)

    def replace_channels(
        self,
        channel_start: np.ndarray,
        *,
        channel_width: np.ndarray,
        channel_depth: np.ndarray,
        channel_discharge: np.ndarray,
        channel_drainage_area: np.ndarray | None,
        channel_id: np.ndarray,
        channel_nodes: tuple[np.ndarray, np.ndarray, np.ndarray],
        channel_closed: np.ndarray,
        channel_slope: np.ndarray | None = None,
    ) -> None:
        """Replace what belongs to whole channels; the caller brings the points into the same order.

        Args:
            channel_start: (C + 1,) offsets into the points.
            channel_width: (C,) m.
            channel_depth: (C,) m.
            channel_discharge: (C,) m3/s.
            channel_drainage_area: (C,) m2 or None.
            channel_id: (C,) identities.
            channel_nodes: (from, to, node_xy), node_xy in m, absolute.
            channel_closed: (C,) True for rings.
            channel_slope: (C,) m/m, or None: known nowhere.
        """
        start = np.array(channel_start, np.int32)
        self.point_count = int(start[-1])
        self.channel_start = wp.array(start, dtype=wp.int32, device=self.device)
        self.channel_width = np.array(channel_width, np.float64)
        self.channel_depth = np.array(channel_depth, np.float64)
        self.channel_discharge = np.array(channel_discharge, np.float64)
        area = channel_drainage_area
        self.channel_drainage_area = None if area is None else np.array(area, np.float64)
        unknown = np.full(len(self.channel_width), np.nan)
        self.channel_slope = unknown if channel_slope is None else np.array(channel_slope, np.float64)
        self.channel_id = np.array(channel_id, np.int64)
        self.channel_from, self.channel_to = (np.array(n, np.int32) for n in channel_nodes[:2])
        self.node_xy = np.array(channel_nodes[2], np.float64)
        self.channel_closed = np.array(channel_closed, bool)

    def channel_flow(self) -> np.ndarray:
        """Return what adds up at junctions, (C,): drainage area in m2 where it is known, else discharge in m3/s."""
        return self.channel_discharge if self.channel_drainage_area is None else self.channel_drainage_area

    def starts(self) -> np.ndarray:
        """Return ``channel_start`` as a host array, (C + 1,) int32."""
        return self.channel_start.numpy().copy()

    def points(self) -> np.ndarray:
        """Return all points in absolute coordinates, (P, 2) float64 in m."""
        return self.point_xy.numpy()[: self.point_count].astype(np.float64) + self.origin

    def polylines(self, *, close: bool = False) -> list[np.ndarray]:
        """Return the channels' lines in absolute coordinates, a list of (n, 2) float64 arrays in m.

        Args:
            close: Repeat the first point of every ring at its end.
        """
        return self._closed_up(np.split(self.points(), self.starts()[1:-1]), close)

    def point_widths(self, *, close: bool = False) -> list[np.ndarray]:
        """Return the bankfull width in m at each point, a list of (n,) float64 arrays; ``close`` as in `polylines`."""
        return self._closed_up(self._split_section(0, self.channel_width), close)

    def point_depths(self, *, close: bool = False) -> list[np.ndarray]:
        """Return the bankfull depth in m at each point, a list of (n,) float64 arrays; ``close`` as in `polylines`."""
        return self._closed_up(self._split_section(1, self.channel_depth), close)

    def _closed_up(self, arrays: list[np.ndarray], close: bool) -> list[np.ndarray]:
        if not close or not self.channel_closed.any():
            return arrays
        return [np.concatenate([a, a[:1]]) if ring else a for a, ring in zip(arrays, self.channel_closed, strict=True)]

    def _split_section(self, column: int, constant: np.ndarray) -> list[np.ndarray]:
        starts = self.starts()
        if self.point_section is None:
            values = np.repeat(constant, np.diff(starts))
        else:
            values = self.point_section.numpy()[: self.point_count, column].astype(np.float64)
        return np.split(values, starts[1:-1])

    def channel_lengths(self) -> np.ndarray:
        """Return the length of each channel's line in m, (C,) float64; that of a ring is all the way round."""
        xy, starts = self.points(), self.starts()
        step = np.hypot(*np.diff(xy, axis=0).T)
        step[starts[1:-1] - 1] = 0.0
        total = np.concatenate([[0.0], np.cumsum(step)])
        length = total[starts[1:] - 1] - total[starts[:-1]]
        if self.channel_closed.any():
            length += np.where(self.channel_closed, np.hypot(*(xy[starts[:-1]] - xy[starts[1:] - 1]).T), 0.0)
        return length

    def bounds(self) -> tuple[float, float, float, float]:
        """Return (west, south, east, north) of all points in m."""
        xy = self.points()
        (west, south), (east, north) = xy.min(axis=0), xy.max(axis=0)
        return float(west), float(south), float(east), float(north)

    def to(self, device: Any = None, dtype: str | None = None) -> RiverNetwork:
        """Return a copy on another device or in another precision."""
        section = None if self.point_section is None else self.point_section.numpy()[: self.point_count]
        return RiverNetwork(
            self.point_xy.numpy()[: self.point_count],
            self.starts(),
            channel_width=self.channel_width,
            channel_depth=self.channel_depth,
            channel_discharge=self.channel_discharge,
            channel_drainage_area=self.channel_drainage_area,
            channel_slope=self.channel_slope,
            channel_id=self.channel_id,
            channel_nodes=(self.channel_from, self.channel_to, self.node_xy),
            channel_closed=self.channel_closed,
            point_section=section,
            origin=self.origin,
            crs=self.crs,
            dtype=dtype or self.dtype,
            device=device or self.device,
        )

    def __repr__(self) -> str:
        length = self.channel_lengths().sum() / 1e3
        widths = self.channel_width
        span = f"{widths.min():.4g}" if np.ptp(widths) == 0 else f"{widths.min():.4g}-{widths.max():.4g}"
        varying = " varying along the channels," if self.point_section is not None else ""
        rings = f" ({int(self.channel_closed.sum())} rings)" if self.channel_closed.any() else ""
        return (
            f"RiverNetwork({self.channel_count} channels{rings}, {self.node_count} nodes, {self.point_count} points, "
            f"{length:.4g} km, width {span} m,{varying} crs={self.crs}, {self.dtype} on {self.device.alias})"
        )


def _find_nodes(
    xy: np.ndarray, start: np.ndarray, closed: np.ndarray, tolerance: float, origin: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes above and below each channel, and their positions: channel ends within ``tolerance`` m are one node.

    Both ends of a ring are its first point.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    count = len(start) - 1
    ends = np.concatenate([xy[start[:-1]], xy[np.where(closed, start[:-1], start[1:] - 1)]])
    pairs = cKDTree(ends).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(2 * count, 2 * count))
    node_count, label = connected_components(graph, directed=False)
    first = np.full(node_count, 2 * count, np.int64)
    np.minimum.at(first, label, np.arange(2 * count))
    return label[:count], label[count:], ends[first] + origin


def _ring_flags(closed: Any, count: int) -> np.ndarray:
    """Spread ``closed`` over the channels, (C,) bool."""
    flags = np.asarray(closed)
    if flags.dtype != bool or flags.shape not in ((), (count,)):
        raise ValueError(f"closed is {closed!r}; give True or False, or one of them for each of the {count} channels")
    return np.broadcast_to(flags, (count,)).copy()


def _ring_marks(marks: Any, rings: np.ndarray, counts: list[int]) -> list[tuple[int, int]]:
    """Return the marked point of each ring that has one, (channel, index)."""
    if marks is None:
        return []
    if np.ndim(marks) == 0:
        if not rings.any():
            raise ValueError("marks: there is no ring among the channels; leave marks out, or pass closed=True")
        marks = [marks if ring else None for ring in rings]
    if len(marks) != len(rings):
        raise ValueError(f"marks: {len(marks)} values for {len(rings)} channels; give one index, or one a channel")
    found = []
    for c, mark in enumerate(marks):
        if mark is None:
            continue
        if not rings[c]:
            raise ValueError(f"marks: channel {c} is no ring and has no marked point; give None for it, or close it")
        if isinstance(mark, bool) or not isinstance(mark, (int, np.integer)):
            raise ValueError(f"mark of channel {c} is {mark!r}; give the index of a point, or None")
        if not 0 <= mark < counts[c]:
            raise ValueError(f"mark of channel {c} is {mark}; its points are numbered from 0 to {counts[c] - 1}")
        found.append((c, int(mark)))
    return found


def _ring_points(xy: np.ndarray, width: float, channel: int) -> int:
    """Return how many points of a line make its ring, or raise ``ValueError`` where it is none."""
    step = np.hypot(*np.diff(xy, axis=0).T)
    gap = float(np.hypot(*(xy[-1] - xy[0])))
    count = len(xy) - 1 if gap <= NODE_TOLERANCE * width else len(xy)
    limit = RING_GAP * max(float(step.max()), width)
    if gap > limit:
        raise ValueError(
            f"channel {channel}: closed, but its ends are {gap:g} m apart, more than {limit:g} m (three of its longest "
            "segments or widths); close the line, or pass closed=False for it"
        )
    if count < RING_POINTS:
        raise ValueError(
            f"channel {channel}: a ring of {count} points; a ring needs at least {RING_POINTS}, add points"
        )
    return count


def _check_rings_apart(lines: list[np.ndarray], rings: np.ndarray, widths: list[np.ndarray]) -> None:
    """Raise ``ValueError`` where a ring shares a point with another ring or with the end of a channel."""
    if not rings.any() or len(lines) < 2:
        return
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
        raise ValueError(
            f"channel {ring} is a ring and meets channel {other} at ({x:.6g}, {y:.6g}); rings join no other channel: "
            "open it there with closed=False, or move them apart"
        )


def _check_packed(xy: np.ndarray, start: np.ndarray, count: int) -> None:
    """Raise ``ValueError`` unless points and offsets are those of so many channels, none of them without length."""
    if len(start) != count + 1 or count == 0 or start[0] != 0 or start[-1] > len(xy):
        raise ValueError(
            f"channel_start is {len(start)} offsets, from {start[0] if len(start) else '-'} to "
            f"{start[-1] if len(start) else '-'}, for {count} channels and {len(xy)} points; it runs from 0 to the "
            "number of points, one more than channels, of which a network has at least one"
        )
    short = np.diff(start) < 2
    if short.any():
        c = int(short.argmax())
        raise ValueError(f"channel {c} has {start[c + 1] - start[c]} point(s); a channel needs at least 2, drop it")
    # A channel has length if any of its points differs from its first one.
    used = xy[: start[-1]]
    apart = (used != np.repeat(used[start[:-1]], np.diff(start), axis=0)).any(axis=1)
    empty = ~np.logical_or.reduceat(apart, start[:-1])
    if empty.any():
        raise ValueError(f"channel {int(empty.argmax())} has no length: all its points are in one place; drop it")


def _check_graph(count: int, identity: np.ndarray, above: np.ndarray, below: np.ndarray, node_xy: np.ndarray) -> None:
    """Raise ``ValueError`` unless identities differ, and nodes and channels belong to one another."""
    for name, array in (("channel_id", identity), ("channel_nodes' from", above), ("channel_nodes' to", below)):
        if array.shape != (count,):
            raise ValueError(f"{name} has shape {array.shape} for {count} channels; give one whole number a channel")
        if array.dtype.kind not in "iu" and not np.array_equal(array, np.round(array)):
            raise ValueError(f"{name} is {array.dtype}; give one whole number a channel")
    order = np.argsort(identity, kind="stable")
    twice = np.flatnonzero(identity[order][1:] == identity[order][:-1])
    if len(twice):
        first, second = order[twice[0] : twice[0] + 2]
        raise ValueError(
            f"channel_id {identity[first]} stands twice, at channels {first} and {second} ({len(twice)} such pairs in "
            "all); identities must differ"
        )
    if node_xy.ndim != 2 or node_xy.shape[1] != 2:
        raise ValueError(f"node_xy has shape {node_xy.shape}; give (N, 2) x, y in metres")
    ends = np.concatenate([above, below])
    if ends.min() < 0 or ends.max() >= len(node_xy):
        c = int(np.flatnonzero((ends < 0) | (ends >= len(node_xy)))[0]) % count
        raise ValueError(f"channel {c} runs from node {above[c]} to {below[c]}, but there are {len(node_xy)} nodes")
    free = np.bincount(ends, minlength=len(node_xy)) == 0
    if free.any():
        raise ValueError(f"node {int(free.argmax())} belongs to no channel ({int(free.sum())} such in all); remove it")


def _checked_slope(slope: Any, count: int) -> np.ndarray:
    """Return one slope a channel, NaN where it is not known, or raise ``ValueError``."""
    array = np.array(slope, np.float64)
    if array.ndim > 1 or (array.ndim == 1 and len(array) != count):
        raise ValueError(f"slope: shape {array.shape} for {count} channels; give one number or one a channel")
    array = np.broadcast_to(array, (count,)).copy()
    if np.isinf(array).any():
        raise ValueError(f"slope of channel {int(np.isinf(array).argmax())} is infinite; use NaN where it is not known")
    return array


def _mean(values: np.ndarray) -> float:
    """Mean that gives a constant back to the bit."""
    return float(values[0] if np.ptp(values) == 0.0 else values.mean())


def _checked_line(xy: Any, channel: int) -> np.ndarray:
    """Return one line as (n, 2) float64, or raise ``ValueError`` that says what is wrong with it and where."""
    try:
        line = np.array(xy, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"channel {channel}: not an array of numbers ({error}); give (n, 2) x, y in metres") from error
    if line.ndim != 2 or line.shape[1] != 2:
        raise ValueError(f"channel {channel}: shape {line.shape}; give (n, 2) x, y in metres")
    if len(line) < 3:
        raise ValueError(f"channel {channel}: {len(line)} point(s); a channel needs at least 3, drop it or add points")
    bad = ~np.isfinite(line).all(axis=1)
    if bad.any():
        raise ValueError(f"channel {channel}: point {int(bad.argmax())} is not finite; remove or repair it")
    repeated = (np.diff(line, axis=0) == 0.0).all(axis=1)
    if repeated.any():
        k = int(repeated.argmax())
        raise ValueError(
            f"channel {channel}: points {k} and {k + 1} are both at ({line[k, 0]:g}, {line[k, 1]:g}); remove one "
            f"({int(repeated.sum())} such pairs in all)"
        )
    return line


def _per_point(value: Any, counts: list[int], name: str, unit: str) -> list[np.ndarray]:
    """Spread a number, a number a channel, or an array a channel over the points; every value must be positive."""
    if not isinstance(value, (list, tuple)) and np.ndim(value) == 0:
        values: list[Any] = [value] * len(counts)
    else:
        values = list(value)
    if len(values) != len(counts):
        raise ValueError(f"{name}: {len(values)} values for {len(counts)} channels; give one number or one a channel")
    spread = []
    for c, (v, n) in enumerate(zip(values, counts, strict=True)):
        array = np.array(v, np.float64)
        if array.ndim > 1 or (array.ndim == 1 and len(array) != n):
            raise ValueError(f"{name} of channel {c}: shape {array.shape} for {n} points; give one number or ({n},)")
        array = np.broadcast_to(array, (n,)).copy()
        if not (np.isfinite(array).all() and (array > 0.0).all()):
            worst = array[~(np.isfinite(array) & (array > 0.0))][0]
            raise ValueError(f"{name} of channel {c} is {worst:g} {unit}; it must be positive and finite")
        spread.append(array)
    return spread
