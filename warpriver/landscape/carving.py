"""Carving: the beds, the water and the lakes of rivers inscribed in a terrain."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import CellArray, DeviceArray, FlagArray, FloatArray, IndexArray
from warpriver.crs import same_crs, short_name
from warpriver.device import launch_kernel
from warpriver.errors import InputError, warn
from warpriver.extras import IMPORTING
from warpriver.history.events import Cutoff
from warpriver.history.history import History
from warpriver.hydraulic_geometry import bankfull_depth
from warpriver.hydrology.drape import falling_levels
from warpriver.kernels import carving as kernels
from warpriver.landscape.constants import CarveParams
from warpriver.landscape.profiles import Lines, WaterProfile, fine_lines, lines_of, water_profile
from warpriver.landscape.sections import SectionTable, parabola, trapezoid
from warpriver.meander.junctions import shape_junctions
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of

__all__ = ["CarveParams", "CarveReport", "Carved", "carve"]


# Sides of segments over the mean of width and cell (so that a bend of two widths is followed to a sixteenth of a cell),
# and their limits in widths; no side is shorter than a cell.
STEP, STEP_WIDTHS = 1.0, (0.25, 0.75)
# Part of a cell between two places of a line at which the water is looked at, and by which a bank is wider than a bed.
VISIT_CELLS, BANK_CELLS = 0.45, 1.5
# Half-widths in cells below which a channel is narrow.
NARROW_CELLS = 4.0
# Half of a cell's diagonal, in cells, and the cosine of a turn at which a line is no longer straight.
DIAGONAL, STRAIGHT = math.sqrt(0.5), 0.8
# The maximum slope of 1 - 3 p^2 + 2 p^3.
STEEPEST = 1.5
# Depth of a deposit that covers the ground, and of a lake that is still one; m and fractions of the channel's depth.
COVER, SHALLOW = 0.5, 0.05
# Maximum of courses of a run that lakes are held against, and widths beside a course that the river has worked over.
MAX_COURSES, SWEPT = 24, 0.5
WHOLE = 255


@dataclasses.dataclass(frozen=True)
class CarveReport:
    """What carving did.

    Attributes:
        cells: Number of cells in the support: no other was changed.
        cut_volume: Ground that was taken, m3.
        fill_volume: Ground that was added, m3, without deposits.
        deepest_cut: Greatest lowering of a cell, m.
        highest_fill: Greatest raising of a cell, m.
        held_points: Number of points of the network at which ``max_cut`` held the water up.
        excess: Maximum of how much deeper than ``max_cut`` a cut would have had to be there, m.
        cells_beyond: Number of cells under water above whose level more than ``max_cut`` of ground was taken: beds
            stay open where their sides lie that high. Banks and walls stop at the limit.
        cell_excess: Maximum of how much more, m.
        lakes: Number of oxbow lakes.
    """

    cells: int
    cut_volume: float
    fill_volume: float
    deepest_cut: float
    highest_fill: float
    held_points: int
    excess: float
    cells_beyond: int
    cell_excess: float
    lakes: int


@dataclasses.dataclass(frozen=True, eq=False)
class Carved:
    """A terrain with its rivers.

    Attributes:
        terrain: The ground, beds and lake floors included.
        water: Level of the water, m; NaN where it is dry.
        depth: Depth of the water, m; NaN where it is dry.
        support: 1 in the cells that channels and their banks reach, 0 elsewhere, uint8.
        materials: Weights by name, uint8 that add up to 255 in each cell with data: "bed" (under water), "bank", "wall"
            (steep ground of cuts), "deposit", "ground" (the rest).
        network: The channels as they were carved, with the levels of the water as ``point_z``.
        cut_excess: (P,) by how much a cut would have gone below ``max_cut`` at each point of the network, m.
        report: What carving did.
    """

    terrain: Terrain
    water: Raster
    depth: Raster
    support: Raster
    materials: Mapping[str, Raster]
    network: RiverNetwork
    cut_excess: FloatArray
    report: CarveReport


@public
def carve(
    terrain: Terrain | Raster,
    network: RiverNetwork,
    params: CarveParams | None = None,
    *,
    sections: SectionTable | None = None,
    deposits: Raster | None = None,
    history: History | None = None,
) -> Carved:
    """Inscribe the beds of rivers in a terrain, with banks, water, and the oxbow lakes of a run.

    The level of the water follows the ground and never rises downstream, on any channel or across junctions. Below it
    the bed has the cross section of its channel, of the width and depth of its points; where channels meet, or limbs of
    a bend, the deeper one counts. Around it the ground is drawn to the level of the water, within a distance beyond
    which no cell changes. Channels narrower than a cell are as wide as the cells that they run through.

    Args:
        terrain: The ground; it is not changed.
        network: The channels, whose points lie close enough to follow their bends.
        params: Constants.
        sections: Forms of the cross sections, in place of that of the constants.
        deposits: Thickness of sediment in m on the terrain's cells, which is added before beds are carved.
        history: A run whose cutoffs become lakes, of the age that they have at its end.

    Returns:
        The terrain, the water and more.

    Raises:
        ValueError: A channel that lies off the terrain, channels that flow in a circle, a table of sections for another
            number of points, deposits on other cells, or another CRS.
    """
    params = params or CarveParams()
    ground = surface_of(terrain)
    if ground.crs is not None and network.crs is not None and not same_crs(ground.crs, network.crs):
        raise InputError(
            f"the terrain is in {short_name(ground.crs)}, the channels in {short_name(network.crs)}; read one of them "
            "with to_crs="
        )
    table = sections or SectionTable.of([_form(params)])
    if table.row is not None and len(table.row) != network.point_count:
        raise InputError(f"sections.row has {len(table.row)} rows for {network.point_count} points; give one a point")
    if params.junctions:
        network = shape_junctions(network)
    base = _with_deposits(ground, deposits)
    carved = _Carving(base, table)
    lakes = _lakes(history, params)
    body, graph = _lake_bodies(lakes, base, params)
    if len(body.level):
        carved.inscribe(body, graph, params)
    lake_water = carved.water.numpy().copy() if lakes else None
    profile = water_profile(
        carved.terrain(),
        network,
        fill_fraction=params.fill_fraction,
        max_cut=params.max_cut,
        smoothing=params.smoothing,
    )
    lines = lines_of(network)
    river = _Body(lines, profile.level[lines.source], profile.cut[lines.source], table.row)
    carved.inscribe(river, _Graph.of(network), params)
    if lake_water is not None:
        carved.settle_lakes(lake_water)
    made = _result(carved, ground, base, network, profile, params.max_cut, len(graph.rings))
    _tell_cuts(profile, made.report, params)
    return made


def _form(params: CarveParams) -> Any:
    return parabola if params.section == "parabola" else lambda y: trapezoid(y, params.side_fraction)


def _with_deposits(ground: Terrain, deposits: Raster | None) -> Terrain:
    """Return the ground with deposits on it."""
    if deposits is None:
        return ground
    if not ground.raster.matches(deposits) or deposits.is_integer:
        raise InputError("deposits must be a Raster of thickness in m on the cells of the terrain")
    added = np.nan_to_num(deposits.numpy(), nan=0.0)
    return Terrain.from_raster(ground.raster.like(ground.to_numpy() + added))


def _tell_cuts(profile: WaterProfile, report: CarveReport, params: CarveParams) -> None:
    """Warn of places where the limit of cuts held the water up, or was not kept."""
    held = int((profile.excess > 0.0).sum())
    if held:
        warn(
            f"max_cut={params.max_cut:g} m held the water up at {held} of {len(profile.excess)} points, where a cut "
            f"would have gone {profile.excess.max():.3g} m deeper; hollows upstream of them were filled instead"
        )
    if report.cells_beyond:
        warn(
            f"the sides of beds were cut by up to {report.cell_excess:.3g} m more than max_cut={params.max_cut:g} m in "
            f"{report.cells_beyond} cells, as they lie that high above the lowest ground across the channel"
        )


# ---- what is inscribed


@dataclasses.dataclass(frozen=True)
class _Body:
    """Lines of water with what belongs to their points: level, (Q,); cut, (Q,); rows of the table, one a source."""

    lines: Lines
    level: FloatArray
    cut: FloatArray
    row: CellArray | None


@dataclasses.dataclass(frozen=True)
class _Graph:
    """How lines follow each other: nodes above and below each, their number, and which are level."""

    upper: CellArray
    lower: CellArray
    nodes: int
    rings: FlagArray

    @staticmethod
    def of(network: RiverNetwork) -> _Graph:
        return _Graph(network.channel_from, network.channel_to, network.node_count, network.channel_closed)

    @staticmethod
    def apart(count: int) -> _Graph:
        """Lines that touch no others."""
        upper = np.arange(count, dtype=np.int32)
        return _Graph(2 * upper, 2 * upper + 1, 2 * count, np.zeros(count, bool))


class _Carving:
    """A terrain that is being carved, on its device.

    Attributes:
        height: (rows, columns) device array of the ground, m.
        water, depth: Level and depth of the water, NaN where dry.
        support: uint8, 1 in cells that were reached.
        materials: Device arrays of bed, bank and wall, uint8.
    """

    def __init__(self, base: Terrain, table: SectionTable):
        self._base, device = base, base.device
        self.height = wp.clone(base.height)
        self.water = wp.full(base.shape, math.nan, dtype=wp.float64, device=device)
        self.depth = wp.full(base.shape, math.nan, dtype=wp.float64, device=device)
        self.support = wp.zeros(base.shape, dtype=wp.uint8, device=device)
        self.materials = {n: wp.zeros(base.shape, dtype=wp.uint8, device=device) for n in ("bed", "bank", "wall")}
        self._section: DeviceArray = wp.array(table.depth, dtype=wp.float64, device=device)

    def terrain(self) -> Terrain:
        """Return the ground as it is now, in the same memory."""
        return Terrain.wrap_raster(self._base.raster.like(self.height, unit="m", name="height"))

    def inscribe(self, body: _Body, graph: _Graph, params: CarveParams) -> None:
        """Carve lines into the ground."""
        made, device, size = kernels.build(wp.float64), self._base.device, self._base.cell_size
        arrays = _segments(body, params, size)
        tiles = _tiles(arrays, self._base)
        count = len(tiles["number"])
        if not count:
            return
        segments, held = made.Segments(), made.Tiles()
        for name, (values, kind) in arrays.items():
            setattr(segments, name, wp.array(values, dtype=kind, device=device))
        for name in ("number", "start", "segment"):
            setattr(held, name, wp.array(tiles[name].astype(np.int32), dtype=wp.int32, device=device))
        held.columns, held.raster = tiles["columns"], wp.vec2i(*self._base.shape)
        dim = (count, kernels.TILE**2)
        level, cut = (wp.empty(dim, dtype=wp.float64, device=device) for _ in range(2))
        shape = wp.empty(dim, dtype=wp.vec3d, device=device)
        inputs = [segments, held, self._base.grid(), self._section]
        launch_kernel(made.find_water, dim, inputs, [level, cut, shape], device=device)
        _let_fall(level, shape, body, graph, tiles, self._base)
        before = wp.clone(self.height)
        outputs = [self.height, self.water, self.depth, self.support]
        launch_kernel(made.carve_cells, dim, [held, params.max_cut, level, cut, shape], outputs, device=device)
        per_repose = 1.0 / (size * math.tan(math.radians(params.repose_angle)))
        inputs = [held, per_repose, shape, self.height, before]
        launch_kernel(made.weigh_materials, dim, inputs, list(self.materials.values()), device=device)

    def settle_lakes(self, lake_water: FloatArray) -> None:
        """Let lakes be dry where the banks of a river have taken their place, and deep as the ground is below them."""
        water, depth, height = (a.numpy() for a in (self.water, self.depth, self.height))
        lake = np.isfinite(lake_water) & (water == lake_water)
        below = lake & (lake_water > height)
        water[lake & ~below] = depth[lake & ~below] = np.nan
        depth[below] = (water - height)[below]
        self.water.assign(water)
        self.depth.assign(depth)
        for name, array in self.materials.items():
            values = array.numpy()
            values[below] = WHOLE if name == "bed" else 0
            array.assign(values)


def _segments(body: _Body, params: CarveParams, cell: float) -> dict[str, tuple[np.ndarray, Any]]:
    """Return the pieces of lines, as the kernels hold them: arrays by name, with their types."""
    lines = body.lines
    width = 2.0 * lines.half
    step = np.clip(STEP * np.sqrt(width * cell), STEP_WIDTHS[0] * width, STEP_WIDTHS[1] * width)
    step = np.maximum(step, cell)
    xy, base, part = fine_lines(lines, step)
    after = np.minimum(base + 1, len(lines.xy) - 1)

    def along(values: FloatArray) -> FloatArray:
        return values[base] + part * (values[after] - values[base])

    owner = lines.owner[base]
    first = np.flatnonzero((owner[1:] == owner[:-1]) & (np.hypot(*np.diff(xy, axis=0).T) > 0.0))
    last = first + 1
    same = owner[first]
    head, foot = np.append(True, same[1:] != same[:-1]), np.append(same[1:] != same[:-1], True)
    unit = xy[last] - xy[first]
    unit /= np.hypot(*unit.T)[:, None]
    before, behind = np.roll(unit, 1, axis=0), np.roll(unit, -1, axis=0)
    for ends, other in ((head, before), (foot, behind)):
        other[ends] = unit[ends]
    _close_rings(lines, xy, first, head, foot, unit, before, behind)
    source = body.lines.source
    row = np.zeros(len(source), np.int32) if body.row is None else body.row[source]

    def pair(values: FloatArray) -> FloatArray:
        return np.stack([values[first], values[last]], axis=1)

    # No bed is narrower than the cells that its line runs through: across a line they are that wide, at its ends and
    # where it turns as wide as their diagonal.
    through = np.repeat(0.5 * np.abs(unit).sum(axis=1)[:, None], 2, axis=1)
    for k, (ends, other) in enumerate(((head, before), (foot, behind))):
        through[ends | ((unit * other).sum(axis=1) < STRAIGHT), k] = DIAGONAL
    half = np.maximum(pair(along(lines.half)), cell * through)
    bank = half + np.maximum(params.bank_reach * 2.0 * pair(along(lines.half)), BANK_CELLS * cell)
    cut = pair(along(body.cut))
    reach = np.maximum(bank, half + STEEPEST * cut / math.tan(math.radians(params.repose_angle)))
    whole = np.where(part[last] > 0.0, part[last], 1.0)
    return {
        "first": (xy[first], wp.vec2d),
        "last": (xy[last], wp.vec2d),
        "first_tangent": (_unit(unit + before), wp.vec2d),
        "last_tangent": (_unit(unit + behind), wp.vec2d),
        "level": (pair(along(body.level)), wp.vec2d),
        "cut": (cut, wp.vec2d),
        "half": (half, wp.vec2d),
        "depth": (pair(along(lines.depth)), wp.vec2d),
        "bank": (bank, wp.vec2d),
        "reach": (reach, wp.vec2d),
        "row": (np.stack([row[base[first]], row[after[first]]], axis=1), wp.vec2i),
        "part": (np.stack([part[first], whole], axis=1), wp.vec2d),
        "ends": ((kernels.HEAD * head + kernels.FOOT * foot).astype(np.uint8), wp.uint8),
    }


def _close_rings(
    lines: Lines,
    xy: FloatArray,
    first: IndexArray,
    head: FlagArray,
    foot: FlagArray,
    unit: FloatArray,
    before: FloatArray,
    behind: FloatArray,
) -> None:
    """Let lines that end where they begin go on there."""
    heads, feet = np.flatnonzero(head), np.flatnonzero(foot)
    closed = (xy[first[heads]] == xy[first[feet] + 1]).all(axis=1)
    a, b = heads[closed], feet[closed]
    before[a], behind[b] = unit[b], unit[a]
    head[a] = foot[b] = False


def _unit(vectors: FloatArray) -> FloatArray:
    unit: FloatArray = vectors / np.maximum(np.hypot(*vectors.T), 1e-300)[:, None]
    return unit


def _tiles(arrays: Mapping[str, tuple[np.ndarray, Any]], base: Terrain) -> dict[str, Any]:
    """Return the tiles of a raster that segments reach, and the segments of each in their order."""
    (rows, columns), size, (west, north), side = base.shape, base.cell_size, base.origin, kernels.TILE
    first, last, reach = (arrays[name][0] for name in ("first", "last", "reach"))
    far = reach.max(axis=1)[:, None]
    low, high = np.minimum(first, last) - far, np.maximum(first, last) + far
    span = side * size
    across = -(-columns // side), -(-rows // side)
    limits = []
    for k, (begin, end) in enumerate(((low[:, 0] - west, high[:, 0] - west), (north - high[:, 1], north - low[:, 1]))):
        lower = np.clip(np.floor(begin / span), 0, across[k]).astype(np.int64)
        upper = np.clip(np.floor(end / span), -1, across[k] - 1).astype(np.int64)
        limits.append((lower, np.maximum(upper - lower + 1, 0)))
    (column, width), (row, depth) = limits
    count = width * depth
    segment = np.repeat(np.arange(len(first)), count)
    at = np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)
    wide = np.maximum(width[segment], 1)
    number = (row[segment] + at // wide) * across[0] + column[segment] + at % wide
    # A tile off the capsule of its segment has nothing of it.
    middle = np.stack([west + (number % across[0] + 0.5) * span, north - (number // across[0] + 0.5) * span], axis=1)
    along, offset = (last - first)[segment], middle - first[segment]
    t = np.clip((along * offset).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    near = np.hypot(*(offset - t[:, None] * along).T) <= far[segment, 0] + 0.75 * span
    number, segment = number[near], segment[near]
    order = np.argsort(number, kind="stable")
    tiles, starts = np.unique(number[order], return_index=True)
    return {
        "number": tiles,
        "start": np.append(starts, len(order)),
        "segment": segment[order],
        "columns": across[0],
    }


def _let_fall(
    level: DeviceArray, shape: DeviceArray, body: _Body, graph: _Graph, tiles: Mapping[str, Any], base: Terrain
) -> None:
    """Lower the water in the cells that lines run through until it rises from none to the next, downstream.

    The beds of channels narrower than a few cells are made as deep there as their deepest point in a cell.
    """
    places = _visits(body.lines, base, tiles)
    if not len(places.order):
        return
    values, shapes = level.numpy(), shape.numpy()
    flat, depth = values.reshape(-1), shapes.reshape(-1, 3)[:, 0]
    narrow = np.where(places.half < NARROW_CELLS * base.cell_size, places.depth, 0.0)
    deepest = np.maximum.reduceat(narrow[places.order], places.first)
    depth[places.cell] = np.maximum(depth[places.cell], deepest)
    # Their weights are those of the bed, in corners that lines cut as well.
    shapes.reshape(-1, 3)[places.cell[deepest > 0.0], 1:] = 1.0
    found = flat[places.cell]
    ends = (graph.upper, graph.lower)
    while True:
        heights = np.where(places.seen, found[places.member], np.inf)
        visited = falling_levels(heights, places.start, ends, graph.nodes, graph.rings)
        lowest = np.minimum.reduceat(visited[places.order], places.first)
        if np.array_equal(lowest, found):
            break
        found = lowest
    flat[places.cell] = found
    level.assign(values)
    shape.assign(shapes)


@dataclasses.dataclass(frozen=True)
class _Visits:
    """Places along lines, (V,), and the cells of tiles that they lie in, (G,).

    Attributes:
        start: (C + 1,) offsets of the lines.
        seen: (V,) which of them lie in a cell that lines reach.
        half, depth: (V,) of the channel there, m.
        cell: (G,) cells as places in the arrays of the tiles.
        member: (V,) number of the cell of each place.
        order, first: Places by cell, and where each cell begins in them.
    """

    start: IndexArray
    seen: FlagArray
    half: FloatArray
    depth: FloatArray
    cell: IndexArray
    member: IndexArray
    order: IndexArray
    first: IndexArray


def _visits(lines: Lines, base: Terrain, tiles: Mapping[str, Any]) -> _Visits:
    """Visit the cells that lines run through, at places no farther apart than a fraction of a cell."""
    xy, point, part = fine_lines(lines, np.full(len(lines.xy), VISIT_CELLS * base.cell_size))
    after = np.minimum(point + 1, len(lines.xy) - 1)
    half, depth = (v[point] + part * (v[after] - v[point]) for v in (lines.half, lines.depth))
    (west, north), size, (rows, columns), side = base.origin, base.cell_size, base.shape, kernels.TILE
    column = np.floor((xy[:, 0] - west) / size).astype(np.int64)
    row = np.floor((north - xy[:, 1]) / size).astype(np.int64)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    tile = np.where(inside, (row // side) * tiles["columns"] + column // side, -1)
    slot = np.minimum(np.searchsorted(tiles["number"], tile), len(tiles["number"]) - 1)
    seen = inside & (tiles["number"][slot] == tile)
    cell = np.where(seen, slot * side * side + (row % side) * side + column % side, -1)
    order = np.argsort(cell, kind="stable")[int((~seen).sum()) :]
    groups, first = np.unique(cell[order], return_index=True)
    member = np.zeros(len(xy), np.int64)
    member[order] = np.repeat(np.arange(len(groups)), np.diff(np.append(first, len(order))))
    return _Visits(np.searchsorted(point, lines.start), seen, half, depth, groups, member, order, first)


# ---- lakes


@dataclasses.dataclass(frozen=True)
class _Lake:
    """A piece of an oxbow lake: its line, (n, 2), width and depth in m."""

    xy: FloatArray
    width: float
    depth: float


def _lakes(history: History | None, params: CarveParams) -> list[_Lake]:
    """Return what is left of the loops that were cut off, at the end of a run."""
    if history is None or not len(history.times):
        return []
    end = float(history.times[-1])
    # Only these are read.
    times = history.events.of(Cutoff).times
    left = np.exp(-np.maximum(end - times, 0.0) / params.lake_time) > SHALLOW
    young = [history.cutoffs[k] for k in np.flatnonzero(left).tolist()]
    swept = _later_courses(history, min((c.time for c in young), default=end))
    found = []
    for cutoff in young:
        bankfull = cutoff.depth if cutoff.depth is not None else float(bankfull_depth(cutoff.width))
        depth = bankfull * math.exp(-max(end - cutoff.time, 0.0) / params.lake_time)
        length = float(np.hypot(*np.diff(cutoff.xy, axis=0).T).sum()) if len(cutoff.xy) > 2 else 0.0
        if length <= (2.0 * params.plug_length + 1.0) * cutoff.width:
            continue
        xy = _between_plugs(cutoff.xy, params.plug_length * cutoff.width)
        gone = np.zeros(len(xy), bool)
        for time, tree, widest in swept:
            if time > cutoff.time:
                gone |= tree.query(xy, distance_upper_bound=0.5 * (cutoff.width + widest) + SWEPT * widest)[0] < np.inf
        runs = np.split(np.arange(len(xy)), np.flatnonzero(gone[1:] != gone[:-1]) + 1)
        found += [_Lake(xy[run], cutoff.width, depth) for run in runs if len(run) > 2 and not gone[run[0]]]
    return found


def _later_courses(history: History, since: float) -> list[tuple[float, Any, float]]:
    """Return time, tree of the points and maximum width of some recorded courses, the last one among them."""
    with IMPORTING:
        from scipy.spatial import cKDTree

    later = np.flatnonzero(history.times > since)
    some = later[np.unique(np.linspace(0, len(later) - 1, min(len(later), MAX_COURSES)).astype(int))]
    found = []
    for k in some.tolist():
        network = history.network(k)
        widest = float(max(w.max() for w in network.point_widths()))
        found.append((float(history.times[k]), cKDTree(network.points()), widest))
    return found


def _lake_bodies(lakes: Sequence[_Lake], base: Terrain, params: CarveParams) -> tuple[_Body, _Graph]:
    """Return lakes as lines of level water; those off the terrain are left out."""
    kept, level = [], []
    for lake in lakes:
        along = np.gradient(lake.xy, axis=0)
        left = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(np.hypot(*along.T), 1e-300)[:, None]
        ground = base.sample(np.concatenate([lake.xy + a * 0.5 * lake.width * left for a in (-1.0, 0.0, 1.0)]))
        if np.isfinite(ground).any():
            kept.append(lake)
            level.append(float(np.nanmin(ground)))
    sizes = [len(lake.xy) for lake in kept]
    xy = np.concatenate([np.empty((0, 2)), *(lake.xy for lake in kept)])
    half, depth, flat = (
        np.repeat(np.array(values, np.float64), sizes)
        for values in ([0.5 * lake.width for lake in kept], [lake.depth for lake in kept], level)
    )
    lines = Lines(xy, np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), np.arange(len(xy)), half, depth)
    above = np.nan_to_num(base.sample(xy) - flat, nan=0.0)
    return _Body(lines, flat, np.clip(above, 0.0, params.max_cut), None), _Graph.apart(len(kept))


def _between_plugs(xy: FloatArray, plug: float) -> FloatArray:
    """Return a loop without its ends."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    inside = (s > plug) & (s < s[-1] - plug)
    cut = [[np.interp(at, s, xy[:, 0]), np.interp(at, s, xy[:, 1])] for at in (plug, s[-1] - plug)]
    return np.concatenate([[cut[0]], xy[inside], [cut[1]]])


# ---- results


def _result(
    carved: _Carving,
    ground: Terrain,
    base: Terrain,
    network: RiverNetwork,
    profile: WaterProfile,
    max_cut: float,
    lakes: int,
) -> Carved:
    raster = ground.raster
    reached = np.flatnonzero(carved.support.numpy())
    change = carved.height.numpy().reshape(-1)[reached] - base.height.numpy().reshape(-1)[reached]
    area = ground.cell_size**2
    # Ground above the bed, in cells under water.
    taken = -change - np.nan_to_num(carved.depth.numpy().reshape(-1)[reached], nan=math.inf)
    beyond = taken - max_cut * (1.0 + 1e-12) - 1e-9
    report = CarveReport(
        cells=len(reached),
        cut_volume=float(-np.minimum(change, 0.0).sum() * area),
        fill_volume=float(np.maximum(change, 0.0).sum() * area),
        deepest_cut=float(-min(change.min(initial=0.0), 0.0)),
        highest_fill=float(max(change.max(initial=0.0), 0.0)),
        held_points=int((profile.excess > 0.0).sum()),
        excess=float(profile.excess.max(initial=0.0)),
        cells_beyond=int((beyond > 0.0).sum()),
        cell_excess=float(np.maximum(beyond, 0.0).max(initial=0.0)),
        lakes=lakes,
    )
    return Carved(
        terrain=carved.terrain(),
        water=raster.like(carved.water, unit="m", name="water_level"),
        depth=raster.like(carved.depth, unit="m", name="water_depth"),
        support=raster.like(carved.support, name="support"),
        materials=_materials(carved, ground, base),
        network=network.with_elevations(profile.level),
        cut_excess=profile.excess,
        report=report,
    )


def _materials(carved: _Carving, ground: Terrain, base: Terrain) -> dict[str, Raster]:
    """Return the weights of all materials, which add up to 255 where there is ground."""
    like = ground.raster.like
    found = {name: like(array, name=name) for name, array in carved.materials.items()}
    known = np.isfinite(base.height.numpy())
    rest = np.where(known, WHOLE, 0).astype(np.uint8)
    for array in carved.materials.values():
        rest -= array.numpy()
    deposit = np.zeros(ground.shape, np.uint8)
    if base is not ground:
        thickness = np.nan_to_num(base.height.numpy() - ground.height.numpy(), nan=0.0)
        deposit = np.rint(rest * np.clip(thickness / COVER, 0.0, 1.0)).astype(np.uint8)
    found["deposit"], found["ground"] = like(deposit, name="deposit"), like(rest - deposit, name="ground")
    return found
