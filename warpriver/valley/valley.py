"""Synthetic river valleys of prescribed form: a surface from reach averages and control functions [Brown2014].

A valley is laid out on the host, a station at a time at most, and its surface is evaluated on the device: for every
cell of a raster, at any points, or on the curvilinear grid of its sections.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import DeviceArray, FloatArray, IndexArray
from warpriver.device import launch_kernel, present_device, require_memory, resolve_device
from warpriver.errors import InputError
from warpriver.kernels import stamps as stamp_kernels
from warpriver.kernels import valley as kernels
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import position, positive, shown
from warpriver.valley.controls import Term
from warpriver.valley.covariance import (
    Covariance,
    correlation_by_frequency,
    covariance_series,
    harmonics_for_covariance,
    harmonics_for_covariances,
)
from warpriver.valley.examples import EXAMPLES
from warpriver.valley.params import SECTION_FORMS, ObjectField, ValleyParams
from warpriver.valley.stamps import Ground, Structure, set_into
from warpriver.valley.stations import Line, Stations, lay_stations, lay_threads, valley_lines

__all__ = ["Valley", "ValleyGrid", "synthetic_valley"]


# Cells across the bankfull width of a raster whose cell size is not given.
CELLS_ACROSS = 20.0
# Ground shown behind the valley tops, in valley widths, and its minimum in bankfull widths.
MARGIN, MIN_MARGIN = 0.03, 0.5
# Nodes of the lattice of nearest stations across the bankfull width, and their maximum along a side.
NODES_ACROSS, MAX_NODES = 4.0, 2048
# Bytes a cell that a raster needs: its heights, and a copy of them on the host.
CELL_BYTES = 16
# Columns of the curvilinear grid on each side between bank and floor's edge, and of the valley side.
FLOOR_COLUMNS, SIDE_COLUMNS = 12, 4


@dataclasses.dataclass(frozen=True)
class ValleyGrid:
    """Structured curvilinear grid of a valley: a row a station, columns from the left valley top to the right.

    Attributes:
        xyz: (stations, columns, 3) absolute places and heights in m.
        banks: Columns of the left and the right bank.
        edges: Columns of the left and the right edge of the valley floor.
        station: (stations,) distance along the channel in m.
        lateral: (stations, columns) distance from the centreline across the channel in m, positive to the left.
        crs: Coordinate reference system, or None.
    """

    xyz: FloatArray
    banks: tuple[int, int]
    edges: tuple[int, int]
    station: FloatArray
    lateral: FloatArray
    crs: str | None = None

    def points(self) -> FloatArray:
        """Return the points as (n, 3), a station after the other."""
        return self.xyz.reshape(-1, 3)

    def triangles(self) -> IndexArray:
        """Return the triangles between the points, (m, 3), counter-clockwise seen from above."""
        rows, columns = self.xyz.shape[:2]
        corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
        # Columns run from left to right, so that the next row lies to the left of the way along a row.
        lower = np.stack([corner, corner + 1, corner + columns], axis=1)
        upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
        return np.concatenate([lower, upper])


class Valley:
    """A synthetic river valley: what it was made from, its stations, and its surface on a device.

    Make one with :func:`synthetic_valley`. Heights, lines and series are computed on first use. A valley
    pickles with equal bits if its control functions do; the terrain travels with it, what else the device holds is made
    anew. Where a machine has no such device it comes back on the CPU, with a ``UserWarning``.

    Attributes:
        params: What it was made from.
        stations: The main channel at its stations, in the frame of the valley.
        threads: Further channels.
        lines: Edges of the valley's floor and top.
        thalweg: Control function of the thalweg: the one given, or that of the covariance target.
        sinuosity: Length of the channel over length of the valley axis.
        bankfull_depth: Reach-average bankfull depth in m, given or by the Shields stress (eq. 4).
        device: Warp device.
    """

    def __init__(
        self,
        params: ValleyParams,
        *,
        cell_size: float | None = None,
        origin: Sequence[float] = (0.0, 0.0),
        crs: str | None = None,
        device: wp.DeviceLike = "cpu",
    ):
        """Lay out the valley; see :func:`synthetic_valley` for the arguments."""
        self.params = params
        self.device = resolve_device(device)
        self.cell_size = params.width / CELLS_ACROSS if cell_size is None else positive(cell_size, "cell_size", "m")
        self.crs = crs
        self.thalweg = _thalweg(params)
        self.stations = _placed(lay_stations(params, self.thalweg), origin)
        self.threads = lay_threads(params, self.stations)
        self.lines = valley_lines(params, self.stations, self.threads)
        self.sinuosity = self.stations.length / self.stations.axis_length
        self.bankfull_depth = params.bankfull_depth

    @functools.cached_property
    def terrain(self) -> Terrain:
        """The valley as a raster of ``cell_size``, over the whole reach and a margin behind the valley tops."""
        return self.raster(self.cell_size)

    @functools.cached_property
    def network(self) -> RiverNetwork:
        """The channel, with its threads, with width and depth at every station."""
        return _network(self)

    @functools.cached_property
    def covariance(self) -> Covariance:
        """Covariance structures c(z_T, W) and c(z_T, |C|) that the valley has."""
        return _covariance(self)

    @public
    def raster(self, cell_size: float, bounds: Sequence[float] | None = None) -> Terrain:
        """Evaluate the surface at the cells' centres of a raster.

        Args:
            cell_size: m.
            bounds: (west, south, east, north) in m; by default everything from end to end of the reach. Cells upstream
                and downstream of the reach have no data.

        Returns:
            Terrain.

        Raises:
            ValueError: A cell size that is not positive, or bounds that hold fewer than 2 x 2 cells.
            MemoryError: The raster does not fit.
        """
        size = positive(cell_size, "cell_size", "m")
        west, south, east, north = self.bounds if bounds is None else (float(v) for v in bounds)
        rows, columns = (math.floor((b - a) / size + 1e-6) for a, b in ((south, north), (west, east)))
        if rows < 2 or columns < 2:
            raise InputError(
                f"cell_size is {size:g} m, with which {west:g}, {south:g}, {east:g}, {north:g} m hold {max(rows, 0)} x "
                f"{max(columns, 0)} cells; give a smaller one"
            )
        require_memory((rows, columns), CELL_BYTES, self.device, "a valley")
        frame = self.stations.frame
        grid = kernels.build(wp.float64).Grid()
        first = frame.to_valley(np.array([west + 0.5 * size, north - 0.5 * size]))
        grid.corner = wp.vec2d(*first)
        grid.cell_size, grid.cosine, grid.sine = size, math.cos(frame.angle), -math.sin(frame.angle)
        height = wp.empty((rows, columns), dtype=wp.float64, device=self.device)
        launch_kernel(
            kernels.build(wp.float64).evaluate_cells,
            dim=(rows, columns),
            inputs=[self._surface, self._lattice, grid],
            outputs=[height],
            device=self.device,
        )
        if self._is_stamped:
            window = stamp_kernels.build(wp.float64).Window()
            window.corner, window.cell_size, window.cosine, window.sine = grid.corner, size, grid.cosine, grid.sine
            self._stamp(Ground(height, window=window))
        return Terrain.wrap(height, size, (west, north), self.crs)

    @public
    def height(self, xy: ArrayLike) -> FloatArray:
        """Evaluate the surface at any places.

        Args:
            xy: (n, 2) absolute places in m.

        Returns:
            (n,) heights in m, NaN upstream and downstream of the reach.
        """
        given = np.asarray(xy, np.float64)
        if given.ndim != 2 or given.shape[1] != 2 or not np.isfinite(given).all():
            raise InputError(f"xy has shape {given.shape}; give (n, 2) finite places in m")
        if not len(given):
            return np.empty(0)
        place: DeviceArray = wp.array(self.stations.frame.to_valley(given), dtype=wp.vec2d, device=self.device)
        height = self._bare_height(place)
        self._stamp(Ground(height, place))
        values: FloatArray = height.numpy()
        return values

    def _bare_height(self, place: DeviceArray) -> DeviceArray:
        """Heights at places of the valley's frame, without patches and meshes."""
        out = wp.empty(len(place), dtype=wp.float64, device=self.device)
        launch_kernel(
            kernels.build(wp.float64).evaluate_points,
            dim=len(place),
            inputs=[self._surface, self._lattice, place],
            outputs=[out],
            device=self.device,
        )
        return out

    @property
    def _is_stamped(self) -> bool:
        """Whether anything is set into the ground."""
        return bool(self.params.patches) or any(stamp.mode != "keep" for stamp in self.params.stamps)

    def _stamp(self, ground: Ground) -> None:
        """Set the patches and meshes into heights on the device."""
        if self._is_stamped:
            set_into(ground, self.params.patches, self.params.stamps, self._bases)

    @functools.cached_property
    def _bases(self) -> list[float]:
        """Height of each mesh's z = 0: that of the bare ground at its place, or 0."""
        stamps = self.params.stamps
        if not stamps:
            return []
        place: DeviceArray = wp.array([stamp.place for stamp in stamps], dtype=wp.vec2d, device=self.device)
        ground = self._bare_height(place).numpy()
        for stamp, height in zip(stamps, ground, strict=True):
            if stamp.base == "ground" and not np.isfinite(height):
                raise InputError(
                    f"MeshStamp.place of {stamp.name!r} is {stamp.place}, where the valley has no ground; move it, or "
                    'set base = "datum"'
                )
        return [float(h) if s.base == "ground" else 0.0 for s, h in zip(stamps, ground, strict=True)]

    def structures(self) -> list[Structure]:
        """Return the meshes that stand on the ground without being part of it (mode "keep"), on the map."""
        made = []
        for stamp, base in zip(self.params.stamps, self._bases, strict=True):
            if stamp.mode == "keep":
                xyz = stamp.placed(base)
                xyz[:, :2] = self.stations.frame.to_map(xyz[:, :2])
                made.append(Structure(stamp.name, xyz, np.asarray(stamp.triangles, np.int32), self.crs))
        return made

    @public
    def bank_height_at(self, x: FloatArray) -> FloatArray:
        """Return the height of the plane of top of bank, bent by the long profile.

        Args:
            x: (n,) places along the valley axis in m, 0 at the upstream end of the reach.

        Returns:
            (n,) heights in m; a station's top of bank lies ``stations.lift`` above it.
        """
        return self._plane(np.asarray(x, np.float64))

    @public
    def grid(self, spacing: float | None = None) -> ValleyGrid:
        """Lay the structured curvilinear grid: sections at every station of the main channel, and the valley beside it.

        Args:
            spacing: Maximum distance between points across the channel, m; by default 1/20 of its mean width.
                The document's is 0.1 m.
        """
        step = self.params.width / CELLS_ACROSS if spacing is None else positive(spacing, "spacing", "m")
        reach = self.stations.reach
        across = math.ceil(float(self.stations.width[reach].max()) / step - 1e-9) + 1
        count = self.params.increments + 1
        beside = FLOOR_COLUMNS + SIDE_COLUMNS
        kernel, first = kernels.build(wp.float64), self.stations.lead
        frame = kernel.Frame()
        at = self.stations.frame
        frame.x, frame.y, frame.cosine, frame.sine = at.x, at.y, math.cos(at.angle), math.sin(at.angle)
        xyz = wp.empty((count, across + 2 * beside), dtype=wp.vec3d, device=self.device)
        inputs = [self._surface, frame, first, beside, across]
        launch_kernel(kernel.lay_sections, dim=(count, across), inputs=inputs, outputs=[xyz], device=self.device)
        inputs = [self._surface, self._lattice, frame, first, FLOOR_COLUMNS, SIDE_COLUMNS]
        launch_kernel(kernel.lay_sides, dim=(count, 2 * beside), inputs=inputs, outputs=[xyz], device=self.device)
        last, places = across + 2 * beside - 1, xyz.numpy()
        if self._is_stamped:
            local = at.to_valley(places[..., :2]).reshape(-1, 2)
            place: DeviceArray = wp.array(local, dtype=wp.vec2d, device=self.device)
            height: DeviceArray = wp.array(places[..., 2].ravel(), dtype=wp.float64, device=self.device)
            self._stamp(Ground(height, place))
            places[..., 2] = height.numpy().reshape(places.shape[:2])
        line = self.stations.line
        middle, tangent = line.xy[reach], line.tangent[reach]
        left = at.to_map(middle + np.column_stack([-tangent[:, 1], tangent[:, 0]])) - at.to_map(middle)
        lateral = np.einsum("sck,sk->sc", places[..., :2] - at.to_map(middle)[:, None], left)
        edges = (SIDE_COLUMNS, last - SIDE_COLUMNS)
        return ValleyGrid(places, (beside, last - beside), edges, line.s[reach].copy(), lateral, self.crs)

    def breaklines(self) -> dict[str, FloatArray]:
        """Return the lines along which the surface bends, by name, (n, 3) absolute places and heights in m.

        Thalweg (the deepest place of each section), both banks, both edges of the floor and both of the valley top.
        """
        stations, reach = self.stations, self.stations.reach
        xy, tangent = stations.line.xy[reach], stations.line.tangent[reach]
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
        half, apex = stations.half[reach], stations.apex[reach]
        n = {
            "thalweg": half[:, 0] - apex * half.sum(axis=1),
            "left_bank": half[:, 0],
            "right_bank": -half[:, 1],
        }
        rise = {
            "thalweg": stations.thalweg[reach],
            "left_bank": stations.lift[reach],
            "right_bank": stations.lift[reach],
        }
        made = {}
        for name, off in n.items():
            place = xy + off[:, None] * normal
            made[name] = np.column_stack([stations.frame.to_map(place), self._plane(place[:, 0]) + rise[name]])
        x = self.lines.start + self.lines.step * np.arange(len(self.lines.table), dtype=np.float64)
        table = self.lines.table
        for column, name in enumerate(("left_floor", "left_top", "right_floor", "right_top")):
            z = self._plane(x) + table[:, 4] + (table[:, 5] if name.endswith("top") else 0.0)
            made[name] = np.column_stack([stations.frame.to_map(np.column_stack([x, table[:, column]])), z])
        return made

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(west, south, east, north) in m of the valley and a margin behind its tops."""
        table = self.lines.table
        high, low = float(table[:, [0, 1]].max()), float(table[:, [2, 3]].min())
        margin = max(MARGIN * (high - low), MIN_MARGIN * self.params.width)
        x = (self.lines.start, self.lines.start + self._axis_span)
        corners = np.array([[a, b] for a in x for b in (low - margin, high + margin)])
        placed = self.stations.frame.to_map(corners)
        (west, south), (east, north) = placed.min(axis=0), placed.max(axis=0)
        return float(west), float(south), float(east), float(north)

    @property
    def _axis_span(self) -> float:
        """Length of the ground along the axis, m."""
        return self.lines.step * (len(self.lines.table) - 1)

    def _plane(self, x: FloatArray) -> FloatArray:
        """Height of the plane of top of bank, bent by the long profile, m."""
        table = self.lines.table
        bend = np.interp(x, self.lines.start + self.lines.step * np.arange(len(table)), table[:, 6])
        return self.stations.bank_height + self.params.slope * (self.stations.axis_length - x) + bend

    @functools.cached_property
    def _surface(self) -> Any:
        """The valley on the device."""
        channels = [_channel_arrays(self.stations), *((t[0], t[1], t[2]) for t in self.threads)]
        surface = kernels.build(wp.float64).Surface()

        def on_device(values: Any, kind: Any) -> DeviceArray:
            return wp.array(np.ascontiguousarray(values), dtype=kind, device=self.device)

        counts = [len(line.s) for line, _, _ in channels]
        surface.channel_start = on_device(np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), wp.int32)
        surface.station_xy = on_device(np.concatenate([c[0].xy for c in channels]), wp.vec2d)
        surface.station_tangent = on_device(np.concatenate([c[0].tangent for c in channels]), wp.vec2d)
        surface.station_half = on_device(np.concatenate([c[1] for c in channels]), wp.vec2d)
        surface.station_form = on_device(np.concatenate([c[2] for c in channels]), wp.vec3d)
        surface.valley_line = on_device(self.lines.table, wp.types.vector(7, wp.float64))
        section = self.params.section
        surface.section_thread = on_device(section.threads, wp.vec4d)
        surface.section_form, surface.terraces = SECTION_FORMS[section.form], int(self.params.terraces)
        surface.flat, surface.exponent = section.flat_fraction, section.exponent
        rows = [_object_row(kind) for kind in self.params.objects]
        surface.object_table = on_device(np.reshape(rows, (len(rows), 10)), wp.float64)
        surface.object_seed = on_device(np.array([kind.seed for kind in self.params.objects], np.int32), wp.int32)
        surface.line_start, surface.lines_per_meter = self.lines.start, 1.0 / self.lines.step
        surface.bank_height = self.stations.bank_height + self.params.slope * self.stations.axis_length
        surface.slope, surface.lift_reach = self.params.slope, self.params.width
        # Rounding must not take the ground from the ends.
        slack = 1e-9 * self._axis_span
        surface.begin, surface.end = self.lines.start - slack, self.lines.start + self._axis_span + slack
        return surface

    @functools.cached_property
    def _lattice(self) -> Any:
        """Lattice over the valley's floor, and for every channel the station nearest to each of its nodes.

        It is as fine as the channel asks for, however fine a raster is: places go on from what its nodes know.
        """
        kernel, surface = kernels.build(wp.float64), self._surface
        station, table = surface.station_xy.numpy(), self.lines.table
        low = np.minimum(station.min(axis=0), [self.lines.start, table[:, 2].min()])
        high = np.maximum(station.max(axis=0), [self.lines.start + self._axis_span, table[:, 0].max()])
        step = max(self.params.width / NODES_ACROSS, float((high - low).max()) / MAX_NODES)
        lattice = kernel.Lattice()
        lattice.columns, lattice.rows = (math.ceil(v / step) + 1 for v in high - low)
        lattice.corner, lattice.step = wp.vec2d(low[0], high[1]), step
        dim = (1 + len(self.threads), lattice.rows, lattice.columns)
        known = wp.full(math.prod(dim), kernels.NOWHERE, dtype=wp.int32, device=self.device)
        inputs = [surface, lattice]
        launch_kernel(kernel.mark_stations, dim=len(station), inputs=inputs, outputs=[known], device=self.device)
        other = wp.empty_like(known)
        stride = 1 << max(0, math.ceil(math.log2(max(dim[1:]))) - 1)
        # The last rounds twice over mend most of what jump flooding misses.
        for jump in [stride >> k for k in range(stride.bit_length())] + [2, 1]:
            inputs = [surface, lattice, known, jump]
            launch_kernel(kernel.spread_stations, dim=dim, inputs=inputs, outputs=[other], device=self.device)
            known, other = other, known
        launch_kernel(
            kernel.settle_cells, dim=dim, inputs=[surface, lattice, known], outputs=[other], device=self.device
        )
        lattice.node_station, lattice.cell_station = known, other
        return lattice

    def __getstate__(self) -> dict[str, Any]:
        made_anew = ("_surface", "_lattice", "network")
        kept = {name: value for name, value in self.__dict__.items() if name not in made_anew}
        return kept | {"device": self.device.alias}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, device=present_device(state["device"], "a valley"))

    def __repr__(self) -> str:
        p, s = self.params, self.stations
        return (
            f"Valley {p.name}: {s.axis_length:g} m long, sinuosity {self.sinuosity:.4f}, bankfull width {p.width:g} m, "
            f"depth {self.bankfull_depth:.4g} m, {1 + len(self.threads)} channel{'s' if self.threads else ''}"
        )


@public
def synthetic_valley(
    valley: str | ValleyParams = "S3",
    *,
    cell_size: float | None = None,
    origin: Sequence[float] = (0.0, 0.0),
    crs: str | None = None,
    device: wp.DeviceLike = "cpu",
    **changes: Any,
) -> Valley:
    """Make a river valley of prescribed form, after Brown, Pasternack and Wallender [Brown2014].

    Args:
        valley: "S1" to "S6", the examples of the paper, or parameters of your own; ``warpriver.io.read_valley`` reads
            them from a file.
        cell_size: Cells of ``.terrain`` in m; by default a twentieth of the bankfull width.
        origin: (x, y) in m of the upstream end of the valley axis; with a given centreline it moves the whole valley.
        crs: Coordinate reference system of the outputs.
        device: Warp device name.
        changes: Fields of :class:`ValleyParams` to change, as ``stationing="valley"``.

    Returns:
        Valley, with ``.terrain``, ``.network``, ``.sinuosity``, ``.bankfull_depth`` and ``.covariance``.

    Raises:
        ValueError: An unknown example or field, a number out of range, a width or depth that is not positive at a
            station, sections that cross in a sharp bend, or a covariance that is out of reach.
    """
    if isinstance(valley, str):
        if valley not in EXAMPLES:
            raise InputError(
                f"valley is {shown(valley)}; use one of {', '.join(EXAMPLES)}, or ValleyParams; read_valley reads files"
            )
        valley = EXAMPLES[valley]
    unknown = set(changes) - {field.name for field in dataclasses.fields(ValleyParams)}
    if unknown:
        raise InputError(f"{sorted(unknown)[0]!r} is no field of ValleyParams")
    if changes:
        valley = valley.replace(**changes)
    return Valley(valley, cell_size=cell_size, origin=origin, crs=crs, device=device)


def _placed(stations: Stations, origin: Sequence[float]) -> Stations:
    """Stations in a frame that is moved by the origin."""
    at = position(origin)
    frame = stations.frame
    return dataclasses.replace(
        stations, frame=dataclasses.replace(frame, x=frame.x + float(at[0]), y=frame.y + float(at[1]))
    )


def _thalweg(params: ValleyParams) -> Sequence[Term]:
    """Control function of the thalweg; solved for where there is a covariance target."""
    targets = params.targets
    if not targets:
        return params.controls.get("thalweg", ())
    level = lay_stations(params, ())
    reach, position = level.reach, level.position[level.reach]
    partners = {"width": level.width[reach], "curvature": np.abs(level.section_curvature[reach])}
    names = " and the ".join(target.partner for target in targets)
    try:
        if len(targets) == 2:
            series = np.stack([partners[target.partner] for target in targets])
            frequencies = sorted({f for target in targets for f in target.frequencies})
            means = [target.mean for target in targets if target.mean is not None]
            return harmonics_for_covariances(series, position, frequencies, means, targets[0].amplitude)
        target = targets[0]
        return harmonics_for_covariance(
            partners[target.partner], position, target.frequencies, target.mean, target.by_frequency, target.amplitude
        )
    except ValueError as error:
        raise InputError(f"{params.name}: covariance with the {names}: {error}") from None


def _covariance(valley: Valley) -> Covariance:
    """What the valley's thalweg has in common with its width and curvature."""
    stations, reach = valley.stations, valley.stations.reach
    position, residual = stations.position[reach], stations.residual[reach]
    partners = {"width": stations.width[reach], "curvature": np.abs(stations.section_curvature[reach])}
    series = {name: covariance_series(residual, partner, position) for name, partner in partners.items()}
    targets, by_frequency = valley.params.targets, {}
    if targets:
        target = targets[0]
        found = correlation_by_frequency(residual, partners[target.partner], position, target.frequencies)
        by_frequency = {float(f): float(c) for f, c in zip(target.frequencies, found, strict=True)}
    return Covariance(
        station=stations.line.s[reach],
        thalweg_width=series["width"][0],
        thalweg_curvature=series["curvature"][0],
        mean_thalweg_width=series["width"][1],
        mean_thalweg_curvature=series["curvature"][1],
        by_frequency=by_frequency,
    )


def _network(valley: Valley) -> RiverNetwork:
    """The main channel, cut where threads leave it and come back, and the threads."""
    stations, reach = valley.stations, valley.stations.reach
    xy = stations.frame.to_map(stations.line.xy[reach])
    width, depth = stations.width[reach], stations.depth[reach]
    # No piece is shorter than it is wide: threads that leave closer to each other share a node.
    last = len(xy) - 1
    shortest = max(2, math.ceil(1.5 * float(width.max()) / stations.length * last))
    cuts = [0]
    for at in sorted(round(v * last) for t in valley.params.threads for v in (t.start, t.end)):
        if at - cuts[-1] >= shortest and last - at >= shortest:
            cuts.append(at)
    cuts.append(last)
    pieces = [(a, b + 1) for a, b in itertools.pairwise(cuts)]
    lines = [xy[a:b] for a, b in pieces]
    widths, depths = [width[a:b] for a, b in pieces], [depth[a:b] for a, b in pieces]
    for (line, half, form), thread in zip(valley.threads, valley.params.threads, strict=True):
        own = stations.frame.to_map(line.xy)
        for end, place in ((0, thread.start), (-1, thread.end)):
            own[end] = xy[min(cuts, key=lambda cut: abs(cut - place * last))]
        lines.append(own)
        widths.append(half.sum(axis=1))
        depths.append(form[:, 0])
    return RiverNetwork.from_polylines(lines, width=widths, depth=depths, crs=valley.crs, device=valley.device.alias)


def _channel_arrays(stations: Stations) -> tuple[Line, FloatArray, FloatArray]:
    """Line, half-widths and (depth, apex, lift) of the main channel, lead-in included."""
    return stations.line, stations.half, np.column_stack([stations.depth, stations.apex, stations.lift])


def _object_row(kind: ObjectField) -> list[float]:
    """Row of the kernels' table: lattice cell (m), draws a cell and their chance, minimum radius, spread of its log."""
    is_log = kind.kind == "log"
    reach = 0.5 * kind.largest + (0.5 * kind.length if is_log else 0.0)
    cell = max(1.0 / math.sqrt(kind.density), reach)
    draws = math.ceil(kind.density * cell * cell - 1e-9)
    place = {"channel": 0.0, "floor": 1.0, "both": 2.0}[kind.where]
    spread = math.log(kind.largest / kind.smallest)
    chance = kind.density * cell * cell / draws
    length = max(kind.length - kind.largest, 0.0) if is_log else 0.0
    return [
        float(is_log),
        place,
        cell,
        draws,
        chance,
        0.5 * kind.smallest,
        spread,
        kind.height,
        length,
        0.5 * kind.largest,
    ]
