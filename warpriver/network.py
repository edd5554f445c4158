"""RiverNetwork: channels and nodes on the host, their points packed end to end on the device."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.channel_table import COLUMNS, ChannelTable
from warpriver.crs import metric_crs, short_name
from warpriver.device import PRECISIONS, resolve_device
from warpriver.errors import InputError, InputTypeError
from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge
from warpriver.network_checks import (
    NODE_TOLERANCE,
    check_graph,
    check_packed,
    check_rings_apart,
    checked_points,
    find_nodes,
    offsets,
    per_channel,
    per_point,
    ring_flags,
    ring_marks,
    ring_points,
)
from warpriver.public import public
from warpriver.thumbnail import WATER, card, lines_picture, png_of
from warpriver.validate import checked_line, floats, one_of, position

__all__ = ["RiverNetwork"]

# Columns that the constructor takes by keyword, ``channel_width`` and so on; the nodes come as one tuple.
KEYWORDS = tuple(f"channel_{name}" for name in COLUMNS if not name.endswith("_node"))


class RiverNetwork:
    """Channels between nodes, each a line of points from upstream to downstream.

    Build one with :meth:`from_polylines` or ``warpriver.read_network``. The points of all channels lie end to end in
    one device array, ``point_xy``, cut by ``channel_start``. What belongs to a whole channel is a column of a table on
    the host, ``channels``; its columns are also attributes of the network, ``channel_width`` and so on. They cannot be
    written into: ``network.with_channels(network.channels.replace(width=...))`` is a network with other ones.

    Attributes:
        node_xy: (N, 2) float64, read-only: node positions in m, absolute.
        origin: (2,) float64, absolute position of the device coordinates' zero.
        crs: Coordinate reference system as text ("EPSG:32619", WKT ...), or None.
        dtype: "float64" or "float32", the precision on the device.
        point_xy: device array of 2-vectors, m, relative to ``origin``; only the first ``point_count`` are in use.
        point_section: device array of (width, depth) in m at each point, or None where they are constant along a
            channel.
        point_z: (P,) float64 on the host, read-only: elevation of each point of the line as it was given, in m, of bed
            or water surface, or None. Nothing that moves points can tell theirs: a simulation, a change of the graph,
            smoothing and junction templates drop it.
        channel_start: device int32 array (C + 1,): channel c owns the points channel_start[c] to
            channel_start[c + 1] - 1.
    """

    @public
    def __init__(
        self,
        point_xy: npt.ArrayLike,
        channel_start: npt.ArrayLike,
        channels: ChannelTable | None = None,
        *,
        node_xy: npt.ArrayLike | None = None,
        channel_nodes: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
        point_section: npt.ArrayLike | None = None,
        point_z: npt.ArrayLike | None = None,
        origin: Sequence[float] | np.ndarray = (0.0, 0.0),
        crs: str | None = None,
        dtype: str = "float64",
        device: wp.DeviceLike = "cpu",
        **columns: npt.ArrayLike | None,
    ):
        """Wrap packed arrays; users call :meth:`from_polylines`, which checks the lines as well as the graph.

        A channel that meets no other is a basin of its own. Rings, channels that part and channels that flow in a
        circle can be held, read and written; a simulation and stream orders refuse them.

        Args:
            point_xy: (P, 2) points relative to ``origin``.
            channel_start: (C + 1,) int32 offsets into the points.
            channels: The table of the channels; or give its columns by keyword.
            node_xy: (N, 2) positions of the nodes that the table names, m, absolute; by default ends that coincide are
                one node.
            channel_nodes: (from, to, node_xy), beside columns by keyword; by default ends that coincide are one node.
            point_section: (P, 2) width and depth at each point in m, or None.
            point_z: (P,) elevation of each point in m, or None.
            origin: Absolute position of the points' zero, m.
            crs: Coordinate reference system.
            dtype: "float64" or "float32".
            device: Warp device name.
            columns: ``channel_width``, ``channel_depth``, ``channel_discharge`` and, where it is known,
                ``channel_drainage_area``, ``channel_slope``, ``channel_id``, ``channel_closed``,
                ``channel_joint``: see
                :class:`~warpriver.channel_table.ChannelTable`.

        Raises:
            TypeError: A table and columns are given, or columns that there are not, or that are needed are missing.
            ValueError: Arrays that do not fit together, a channel of fewer than 2 points or of no length, an identity
                that stands twice, a node that is not there, or one that no channel touches.
        """
        one_of(dtype, "dtype", tuple(PRECISIONS))
        _, vec2, real = PRECISIONS[dtype]
        self.dtype = dtype
        self.device = resolve_device(device)
        self.origin = position(origin)
        self.crs = metric_crs(crs)
        if channels is None:
            channels, node_xy = _table_of_keywords(columns, channel_nodes)
        elif columns or channel_nodes is not None:
            raise InputTypeError(f"RiverNetwork takes a table of channels, or {', '.join(KEYWORDS)}, but not both")
        start = offsets(channel_start)
        xy = floats(point_xy, "point_xy", "(P, 2) x, y in metres")
        check_packed(xy, start, len(channels))
        if node_xy is None:
            tolerance = NODE_TOLERANCE * float(np.min(channels.width))
            points = np.asarray(xy, np.float64)
            above, below, node_xy = find_nodes(points, start, channels.closed, tolerance, self.origin)
            channels = channels.replace(from_node=above, to_node=below)
        check_graph(channels, np.asarray(node_xy))
        self.channel_start: DeviceArray
        self.node_xy: np.ndarray
        self.point_z: np.ndarray | None
        self.replace_channels(start, channels, np.asarray(node_xy))
        self.point_xy: DeviceArray = wp.array(np.asarray(xy, real), dtype=vec2, device=self.device)
        self.point_section: DeviceArray | None = None
        if point_section is not None:
            section = checked_points("point_section", point_section, (len(xy), 2))
            self.point_section = wp.array(section.astype(real), dtype=vec2, device=self.device)
        if point_z is not None:
            elevations = checked_points("point_z", point_z, (len(xy),))[: self.point_count].copy()
            elevations.flags.writeable = False
            self.point_z = elevations

    @classmethod
    @public
    def from_polylines(
        cls,
        polylines: Iterable[npt.ArrayLike],
        width: npt.ArrayLike | Sequence[npt.ArrayLike],
        depth: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
        discharge: npt.ArrayLike | None = None,
        *,
        drainage_area: npt.ArrayLike | None = None,
        slope: npt.ArrayLike | None = None,
        z: Sequence[npt.ArrayLike] | None = None,
        channel_id: npt.ArrayLike | None = None,
        extra: Mapping[str, Any] | None = None,
        nodes: Sequence[npt.ArrayLike] | None = None,
        origin: npt.ArrayLike | None = None,
        allow_short: bool = False,
        closed: bool | Sequence[bool] | np.ndarray = False,
        marks: int | Sequence[int | None] | np.ndarray | None = None,
        crs: str | None = None,
        dtype: str = "float64",
        device: wp.DeviceLike = "cpu",
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
            drainage_area: Drainage area in m2 at the downstream end, one number a channel, NaN where it is not known.
            slope: Drop over length of each channel in m/m, one number or one a channel, NaN where it is not known.
            z: Elevation of the points in m, one (n,) array a channel, where it is known.
            channel_id: Identities of the channels, whole numbers; by default 0, 1, 2 ...
            extra: Free columns of the channels by name: one number, word or flag a channel.
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
        crs = metric_crs(crs)
        lines = [checked_line(xy, f"channel {c}") for c, xy in enumerate(polylines)]
        if not lines:
            raise InputError("a network needs at least one line; got none")
        rings = ring_flags(closed, len(lines))
        counts = [len(xy) for xy in lines]
        point_width = per_point(width, counts, "width", "m")
        point_depth = [bankfull_depth(w) for w in point_width]
        if depth is not None:
            point_depth = per_point(depth, counts, "depth", "m")
        point_z = per_point(z, counts, "z", "m", positive=False) if z is not None else []
        of_points = [lines, point_width, point_depth] + [point_z] * (z is not None)
        for c in np.flatnonzero(rings).tolist():
            counts[c] = ring_points(lines[c], float(point_width[c].min()), c)
            for arrays in of_points:
                arrays[c] = arrays[c][: counts[c]]
        for c, mark in ring_marks(marks, rings, counts):
            for arrays in of_points:
                arrays[c] = np.roll(arrays[c], -mark, axis=0)
        check_rings_apart(lines, rings, point_width)
        for c, (xy, w) in enumerate(zip(lines, point_width, strict=True)):
            length = float(np.hypot(*np.diff(xy, axis=0).T).sum())
            if w.max() > length and not allow_short:
                raise InputError(
                    f"channel {c}: its width, {w.max():g} m, exceeds its length, {length:g} m; "
                    "check the units of both, or drop the channel"
                )
        packed = np.concatenate(lines)
        # A round origin keeps offsets exact in binary, so that moving a line by whole metres moves the result by them.
        if origin is None:
            origin = np.round(0.5 * (packed.min(axis=0) + packed.max(axis=0)))
        zero = position(origin)
        channel_width = np.array([_mean(w) for w in point_width])
        varies = any(np.ptp(w) > 0.0 for w in point_width) or any(np.ptp(d) > 0.0 for d in point_depth)
        section = np.stack([np.concatenate(point_width), np.concatenate(point_depth)], axis=1) if varies else None
        flow = bankfull_discharge(channel_width)
        if discharge is not None:
            flow = np.array([q[0] for q in per_point(discharge, [1] * len(lines), "discharge", "m3/s")])
        if drainage_area is not None:
            drainage_area = per_channel("drainage_area", drainage_area, len(lines))
        table = ChannelTable(
            width=channel_width,
            depth=np.array([_mean(d) for d in point_depth]),
            discharge=flow,
            drainage_area=drainage_area,
            slope=None if slope is None else per_channel("slope", slope, len(lines)),
            id=channel_id,
            from_node=None if nodes is None else nodes[0],
            to_node=None if nodes is None else nodes[1],
            closed=rings,
            extra=extra or {},
        )
        return cls(
            packed - zero,
            np.concatenate([[0], np.cumsum(counts)]),
            table,
            node_xy=None if nodes is None else nodes[2],
            point_section=section,
            point_z=np.concatenate(point_z) if point_z else None,
            origin=zero,
            crs=crs,
            dtype=dtype,
            device=device,
        )

    # ---- channels

    @property
    def channels(self) -> ChannelTable:
        """All columns of the channels, as one table."""
        return self._channels

    @property
    def channel_width(self) -> np.ndarray:
        """(C,) float64, bankfull width in m (the mean, where it varies along the channel)."""
        return self._channels.width

    @property
    def channel_depth(self) -> np.ndarray:
        """(C,) float64, bankfull depth in m."""
        return self._channels.depth

    @property
    def channel_discharge(self) -> np.ndarray:
        """(C,) float64, bankfull discharge in m3/s at the downstream end."""
        return self._channels.discharge

    @property
    def channel_drainage_area(self) -> np.ndarray | None:
        """(C,) float64, drainage area in m2 at the downstream end, NaN where it is not known; or None."""
        return self._channels.drainage_area

    @property
    def channel_slope(self) -> np.ndarray:
        """(C,) float64, drop from the upstream to the downstream end over the length, m/m; NaN where it is not known.

        It is that of the channel as it was found: migration and cutoffs leave it, a collision hands it on (each part
        keeps the slope of the channel it was cut from, and parts that become one channel get the drop of all over their
        length).
        """
        return self._channels.slope

    @property
    def channel_id(self) -> np.ndarray:
        """(C,) int64, identity that a channel keeps when others come and go.

        It stays with the downstream end: a channel that captures another keeps it downstream of the new junction, a
        river keeps it when its last tributary but one is captured. None is given twice in a run.
        """
        return self._channels.id

    @property
    def channel_from(self) -> np.ndarray:
        """(C,) int32, node at the upstream end."""
        return self._channels.from_node

    @property
    def channel_to(self) -> np.ndarray:
        """(C,) int32, node at the downstream end."""
        return self._channels.to_node

    @property
    def channel_closed(self) -> np.ndarray:
        """(C,) bool, True for a ring: its last point is joined to its first, and its one node is its own."""
        return self._channels.closed

    @property
    def channel_joint(self) -> np.ndarray:
        """(C,) int32, what the node at the downstream end is to the river: 0, 1 (through node) or 2 (locked point)."""
        return self._channels.joint

    @property
    def channel_count(self) -> int:
        """Number of channels."""
        return len(self._channels)

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.node_xy)

    def replace_channels(self, channel_start: np.ndarray, channels: ChannelTable, node_xy: np.ndarray) -> None:
        """Replace what belongs to whole channels; the caller brings the points into the same order.

        Args:
            channel_start: (C + 1,) offsets into the points.
            channels: The table of the channels.
            node_xy: (N, 2) positions of its nodes in m, absolute.
        """
        start = np.array(channel_start, np.int32)
        self.point_count = int(start[-1])
        self.channel_start = wp.array(start, dtype=wp.int32, device=self.device)
        self._channels = channels
        self.place_nodes(node_xy)
        self.point_z = None

    def place_nodes(self, node_xy: np.ndarray) -> None:
        """Set the positions of the nodes, (N, 2) in m, absolute; the ends of the channels are the caller's affair."""
        self.node_xy = np.array(node_xy, np.float64)
        self.node_xy.flags.writeable = False

    @public
    def with_channels(self, channels: ChannelTable) -> RiverNetwork:
        """Return a copy with another table of the same channels, such as ``network.channels.replace(width=...)``.

        Where width and depth vary along the channels, those of the points stay as they are.
        """
        return self._copied(channels)

    @public
    def with_elevations(self, point_z: npt.ArrayLike) -> RiverNetwork:
        """Return a copy whose points have these elevations, (P,) in m, or None for none: ``point_z``."""
        return RiverNetwork(**(self._host_values() | {"point_z": point_z}))

    def channel_flow(self) -> np.ndarray:
        """Return what adds up at junctions, (C,): drainage area in m2 if it is known of all, else discharge in m3/s."""
        area = self.channel_drainage_area
        return area if area is not None and np.isfinite(area).all() else self.channel_discharge

    def starts(self) -> np.ndarray:
        """Return ``channel_start`` as a host array, (C + 1,) int32."""
        starts: np.ndarray = self.channel_start.numpy().copy()
        return starts

    def points(self) -> np.ndarray:
        """Return all points in absolute coordinates, (P, 2) float64 in m."""
        points: np.ndarray = self.point_xy[: self.point_count].numpy().astype(np.float64) + self.origin
        return points

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

    def point_elevations(self, *, close: bool = False) -> list[np.ndarray] | None:
        """Return ``point_z`` channel by channel, a list of (n,) arrays, or None; ``close`` as in `polylines`."""
        if self.point_z is None:
            return None
        return self._closed_up(np.split(self.point_z, self.starts()[1:-1]), close)

    def _closed_up(self, arrays: list[np.ndarray], close: bool) -> list[np.ndarray]:
        if not close or not self.channel_closed.any():
            return arrays
        return [np.concatenate([a, a[:1]]) if ring else a for a, ring in zip(arrays, self.channel_closed, strict=True)]

    def _split_section(self, column: int, constant: np.ndarray) -> list[np.ndarray]:
        starts = self.starts()
        if self.point_section is None:
            values = np.repeat(constant, np.diff(starts))
        else:
            values = self.point_section[: self.point_count].numpy()[:, column].astype(np.float64)
        return np.split(values, starts[1:-1])

    def channel_lengths(self) -> np.ndarray:
        """Return the length of each channel's line in m, (C,) float64; that of a ring is all the way round."""
        xy, starts = self.points(), self.starts()
        step = np.hypot(*np.diff(xy, axis=0).T)
        step[starts[1:-1] - 1] = 0.0
        total = np.concatenate([[0.0], np.cumsum(step)])
        length: np.ndarray = total[starts[1:] - 1] - total[starts[:-1]]
        if self.channel_closed.any():
            length += np.where(self.channel_closed, np.hypot(*(xy[starts[:-1]] - xy[starts[1:] - 1]).T), 0.0)
        return length

    def bounds(self) -> tuple[float, float, float, float]:
        """Return (west, south, east, north) of all points in m."""
        xy = self.points()
        (west, south), (east, north) = xy.min(axis=0), xy.max(axis=0)
        return float(west), float(south), float(east), float(north)

    @public
    def to(self, device: wp.DeviceLike = None, dtype: str | None = None) -> RiverNetwork:
        """Return a copy on another device or in another precision."""
        return self._copied(self._channels, device, dtype)

    def _copied(self, channels: ChannelTable, device: wp.DeviceLike = None, dtype: str | None = None) -> RiverNetwork:
        values = self._host_values()
        values |= {"channels": channels, "dtype": dtype or self.dtype, "device": device or self.device}
        return RiverNetwork(**values)

    def _host_values(self) -> dict[str, Any]:
        """Everything that the constructor takes, on the host, to the bit."""
        count = self.point_count
        return {
            "point_xy": self.point_xy[:count].numpy(),
            "channel_start": self.starts(),
            "channels": self._channels,
            "node_xy": self.node_xy,
            "point_section": None if self.point_section is None else self.point_section[:count].numpy(),
            "point_z": self.point_z,
            "origin": self.origin,
            "crs": self.crs,
            "dtype": self.dtype,
            "device": self.device.alias,
        }

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy with the points on the host; they come back on the device of that name."""
        return _rebuilt, (self._host_values(),)

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

    def _repr_html_(self) -> str:
        def span(values: np.ndarray, unit: str) -> str:
            low, high = f"{values.min():.4g}", f"{values.max():.4g}"
            return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"

        facts = {
            "channels": f"{self.channel_count:,}",
            "nodes": f"{self.node_count:,}",
            "points": f"{self.point_count:,}",
            "length": f"{self.channel_lengths().sum() / 1e3:.4g} km",
            "width": span(self.channel_width, "m"),
            "discharge": span(self.channel_discharge, "m3/s"),
            "west, south, east, north": ", ".join(f"{v:.10g}" for v in self.bounds()),
            "CRS": short_name(self.crs),
        }
        return card("RiverNetwork", facts, self._repr_png_())

    def _repr_png_(self) -> bytes:
        return png_of(lines_picture([(self.polylines(close=True), self.channel_width.tolist(), WATER)]))


def _rebuilt(values: dict[str, Any]) -> RiverNetwork:
    return RiverNetwork(**values)


def _table_of_keywords(columns: dict[str, Any], nodes: tuple[Any, Any, Any] | None) -> tuple[ChannelTable, Any]:
    """Return the table of columns by keyword, and the positions of its nodes (None: they are still to be found)."""
    for name in columns:
        if name not in KEYWORDS:
            raise InputTypeError(f"RiverNetwork takes no {name}; it takes {', '.join(KEYWORDS)}")
    values = {name.removeprefix("channel_"): array for name, array in columns.items()}
    if nodes is None:
        return ChannelTable(**values), None
    return ChannelTable(**values, from_node=nodes[0], to_node=nodes[1]), nodes[2]


def _mean(values: np.ndarray) -> float:
    """Mean that gives a constant back to the bit."""
    return float(values[0] if np.ptp(values) == 0.0 else values.mean())
