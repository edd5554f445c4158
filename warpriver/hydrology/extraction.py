"""Network extraction: the cells that drain enough ground, as smooth channels of a river network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpriver.channel_table import ChannelTable
from warpriver.errors import InputError
from warpriver.hydraulic_geometry import WIDTH_COEFFICIENT, bankfull_depth, bankfull_discharge, channel_width
from warpriver.hydrology.cells import Edges, NoData
from warpriver.hydrology.depressions import carve_depressions, fill_depressions
from warpriver.hydrology.routing import Flow, checked_areas, host_areas, route
from warpriver.network import RiverNetwork
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of
from warpriver.validate import positive, whole

__all__ = ["extract_network"]

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Least length of a channel: cells, and widths. A line needs three points, and may not be shorter than it is wide.
LEAST_CELLS, LEAST_WIDTHS = 3.0, 2.0
# Drainage areas this close to a whole number of cells are that number.
WHOLE = 1e-6


@dataclass
class _Stems:
    """The channel cells as stems: each runs from a source down along the largest donors, to an outlet or another stem.

    The cells of all stems lie end to end, each stem from its source down.

    Attributes:
        place: (n, 2) row and column of the cell; beyond the raster for what lies across a periodic side from its mouth.
        area: (n,) drainage area in cells.
        supply: (n,) the part of it that comes from no channel cell, in cells.
        start: (S + 1,) offsets of the stems.
        parent: (S,) stem that it flows into; -1 at an outlet.
        joint: (S,) place, among all stems' cells, where it flows into its parent; -1 at an outlet.
        room: (n,) how many channels of the least length fit between the stem's source and the cell.
        alive: (S,) False for stems that are left out.
    """

    place: IndexArray
    area: FloatArray
    supply: FloatArray
    start: IndexArray
    parent: IndexArray
    joint: IndexArray
    room: FloatArray
    alive: NDArray[np.bool_]

    @property
    def end(self) -> IndexArray:
        """(S,) place of each stem's last cell."""
        return self.start[1:] - 1

    def tributaries(self) -> IndexArray:
        """Stems that flow into another, by the place where they do.

        Of those at one place the first comes from furthest upstream: by its angle to the stem above the place.
        """
        found = np.flatnonzero(self.alive & (self.parent >= 0))
        joint = self.joint[found]
        above = np.maximum(joint - 1, self.start[self.parent[found]])
        upstream, course = self._between(joint, above), self._between(joint, self.end[found])
        length = np.hypot(*upstream.T) * np.hypot(*course.T)
        cosine = (upstream * course).sum(axis=1) / np.maximum(length, 1e-9)
        return found[np.lexsort((self.area[self.end[found]], np.round(-cosine, 9), joint))]

    def _between(self, a: IndexArray, b: IndexArray) -> FloatArray:
        """Rows and columns from the cells at some places to those at others."""
        return (self.place[b] - self.place[a]).astype(np.float64)


def extract_network(
    terrain: Terrain | Raster,
    *,
    min_drainage_area: float,
    width_coefficient: float = WIDTH_COEFFICIENT,
    spacing: float | None = None,
    smoothing: int = 4,
    varying: bool = True,
    edges: Edges = "open",
    nodata: NoData = "outlet",
    carve: bool = True,
    unroll: bool = False,
    area: Any = None,
    flow: Flow | None = None,
    dtype: str = "float64",
    device: Any = "cpu",
) -> RiverNetwork:
    """Find the rivers of a terrain: a forest of binary trees, one for every basin that is large enough.

    A cell is channel if it drains ``min_drainage_area`` or more by steepest descent. Nodes lie at sources, junctions
    and outlets (the edge of the map, no data, a place that water does not leave). Courses run through the cells'
    centres, are smoothed by passes of the filter 1/4, 1/2, 1/4 in which sources and outlets stay where they are, and
    are sampled evenly along a cubic that passes through the smoothed points and goes on smoothly through junctions
    down the larger stream.

    Every channel is at least three cells and two widths long. Where tributaries would meet a stream closer together,
    or more than one in a place, their junctions move along the stream, as a rule downstream; one that would join a
    stream right above its own end joins the larger stream below. A channel between a source and a junction that is
    shorter than that is left out; so is the smallest tributary where a stream is too short for all of them. Drainage
    areas stay true: what is left out still drains through the channel below.

    Lakes are crossed. On a flat one, and on a depression that is filled, water runs straight on towards the outlet, in
    smooth lines with slope 0 that join on the way; a depression that is carved is crossed through its lowest cells and
    the cut. Drainage area and discharge go on through it. Shores drain onto it as hillslopes drain into a valley: what
    gathers ``min_drainage_area`` on the lake only is a channel from there on. A lake without data is no ground:
    channels end on its shore and begin anew below it, without the water from above, or, with ``nodata="wall"``, run
    round it to where the land lets them out. A river that touches an open side of the map leaves there, also where it
    would run along it; along a closed side it runs on.

    Where a side is periodic, channels end there and begin anew on the opposite side; with ``unroll`` they run on beyond
    the map, so that each river is in one piece from its mouth, which lies on the map.

    Args:
        terrain: The ground, or a raster of heights in m; it is not changed.
        min_drainage_area: Least drainage area of a channel, m2.
        width_coefficient: c of the width c area^0.5 in m per m; see :func:`warpriver.hydrology.channel_width`.
        spacing: Distance between points along a channel in m, adapted so that it divides the length; at least two
            intervals a channel. By default the cell size.
        smoothing: Passes of the filter; n of them smooth like a Gaussian of sqrt(n / 2) cells.
        varying: Whether width and depth vary along a channel with its drainage area, or have its mean width.
        edges: What the four sides are, as in :func:`warpriver.hydrology.fill_depressions`.
        nodata: Cells without data are an "outlet" for their neighbours, or a "wall".
        carve: Whether depressions are opened by carving, or filled.
        unroll: Whether rivers run on across periodic sides.
        area: Drainage area by "d8" in m2, a Raster or (rows, columns), if it is known.
        flow: The terrain's flow, if it is known: routed after filling or carving. It has its own edges, and
            ``carve`` is not used.
        dtype: Precision of the network on the device, "float64" or "float32".
        device: Warp device of the network.

    Returns:
        The network, in the terrain's CRS. ``channel_drainage_area`` is that just above the node at the downstream end,
        and ``channel_discharge`` is the bankfull discharge of a channel as wide as it is there,
        :func:`warpriver.hydrology.bankfull_discharge`. ``channel_slope`` is the drop
        from the cell at the channel's upper end to the one at its lower end, over the length of its line. Heights are
        those of the surface that water was routed on, carved or filled: the raw terrain rises along a course wherever
        it crosses a pit or noise. So it is never below 0, 0 (or nearly) across a filled lake, and near an outlet of a
        carved pit that of the cut.

    Raises:
        ValueError: A level terrain, a threshold or another number out of range, a threshold that leaves no channel, an
            area that shrinks downstream or does not fit the terrain, and as
            :func:`warpriver.hydrology.fill_depressions`.
        MemoryError: There is no room, told before anything is allocated.
    """
    threshold = positive(min_drainage_area, "min_drainage_area", "m2")
    coefficient = positive(width_coefficient, "width_coefficient", "m per m")
    ground = surface_of(terrain)
    step = positive(ground.cell_size if spacing is None else spacing, "spacing", "m")
    smoothing = whole(smoothing, "smoothing", unit="passes")
    if flow is None:
        _refuse_level_ground(ground)
        surface = (carve_depressions if carve else fill_depressions)(ground, edges=edges, nodata=nodata)
        flow = route(surface, edges=edges, nodata=nodata)
    elif flow.terrain.shape != ground.shape or flow.terrain.cell_size != ground.cell_size:
        raise InputError(f"flow is that of another terrain: {flow!r} beside {ground.shape[0]} x {ground.shape[1]}")
    cell_area = ground.cell_size**2
    cells = _cells_drained(flow, area, cell_area)
    stems = _find_stems(flow.host_receiver, cells, threshold / cell_area, coefficient, unroll)
    largest = float(np.nanmax(cells)) * cell_area
    if len(stems.start) > 1:
        _make_room(stems)
    if not stems.alive.any():
        short = " longer than three cells and two widths" if largest >= threshold else ""
        raise InputError(
            f"no channel{short} drains {threshold:g} m2 (min_drainage_area); the largest drainage area on this terrain "
            f"is {largest:g} m2"
        )
    _drop_dead(stems)
    junction = _place_junctions(stems)
    total = _settle_areas(stems, junction)
    xy = _smooth(_centers(stems.place, ground), stems, junction, int(smoothing))
    return _build(
        stems,
        junction,
        total * cell_area,
        xy,
        # Places across a periodic side lie beyond the raster.
        flow.terrain.height.numpy()[tuple((stems.place % ground.shape).T)].astype(np.float64),
        cell_area,
        coefficient,
        step,
        varying,
        ground.crs,
        dtype,
        device,
    )


def _refuse_level_ground(terrain: Terrain) -> None:
    """Raise ``ValueError`` where all cells have one height: the ways of water would be those of the raster."""
    height = terrain.height.numpy()
    lowest = np.fmin.reduce(height, axis=None)
    if lowest == np.fmax.reduce(height, axis=None):
        raise InputError(f"the terrain is level, {lowest:g} m in every cell with data: water has no way to take")


def _cells_drained(flow: Flow, area: Any, cell_area: float) -> FloatArray:
    """Drainage area of all cells in cells, NaN without data; whole numbers where it is whole within rounding."""
    found = host_areas(flow) if area is None else checked_areas(area, flow)
    cells = found / cell_area
    near = np.rint(cells)
    np.copyto(cells, near, where=np.abs(cells - near) <= WHOLE * np.abs(near))
    if area is not None:
        receiver = flow.host_receiver.reshape(-1)
        inside = np.flatnonzero(receiver >= 0)
        flat = cells.reshape(-1)
        if not (flat[inside] > 0.0).all():
            raise InputError("area is not positive in every cell with data")
        if (flat[receiver[inside]] < flat[inside]).any():
            raise InputError("area shrinks downstream along the steepest courses; give drainage_area(flow), by 'd8'")
    cells[flow.host_receiver < 0] = np.nan
    return cells


def _find_stems(
    receiver: NDArray[np.int32], cells: FloatArray, threshold: float, coefficient: float, unroll: bool
) -> _Stems:
    """Split the channel cells into stems."""
    columns = receiver.shape[1]
    flat = cells.reshape(-1)
    # A part in 1e9 of slack, so that a threshold of a whole number of cells keeps cells that drain just that.
    cell = np.flatnonzero(flat >= threshold * (1.0 - 1e-9))
    n = len(cell)
    if n == 0:
        none = np.zeros(0, np.int64)
        nothing = np.zeros(0)
        start = np.zeros(1, np.int64)
        return _Stems(np.zeros((0, 2), np.int64), nothing, nothing, start, none, none, nothing, np.zeros(0, bool))
    area = flat[cell]
    to = receiver.reshape(-1)[cell].astype(np.int64)
    place = np.column_stack(np.divmod(cell, columns))
    step = np.column_stack(np.divmod(to, columns)) - place
    # Across a periodic side the receiver is no neighbour on the map.
    far = np.abs(step) > 1
    down = np.searchsorted(cell, to)
    down[to == cell] = -1
    if unroll:
        place += _sums_down(down, np.where(far, np.sign(step) * np.array(receiver.shape), 0))
    else:
        down[far.any(axis=1)] = -1
    inner = np.flatnonzero(down >= 0)
    supply = area - np.bincount(down[inner], weights=area[inner], minlength=n)
    # The largest donor of each cell continues its stem; of equal ones the last in the raster.
    main = np.full(n, -1)
    by_area = inner[np.argsort(area[inner], kind="stable")]
    main[down[by_area]] = by_area
    head, rise = _climb(main)
    order = np.lexsort((rise, head))
    start = np.concatenate([np.flatnonzero(rise[order] == 0), [n]])
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(n)
    stem = np.repeat(np.arange(len(start) - 1), np.diff(start))
    below = down[order[start[1:] - 1]]
    joint = np.where(below >= 0, rank[below], -1)
    area = area[order]
    # Width in cells, times the least length in widths, and one for rounding to whole cells.
    needed = np.maximum(LEAST_CELLS, LEAST_WIDTHS * coefficient * np.sqrt(area) + 1.0)
    fits = np.concatenate([[0.0], np.cumsum(1.0 / needed[1:])])
    return _Stems(
        place=place[order],
        area=area,
        supply=supply[order],
        start=start,
        parent=np.where(below >= 0, stem[joint], -1),
        joint=joint,
        room=fits - np.repeat(fits[start[:-1]], np.diff(start)),
        alive=np.ones(len(start) - 1, bool),
    )


def _climb(above: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Follow pointers upwards to their ends (-1): the last element and the number of steps to it, by doubling."""
    n = len(above)
    last = np.where(above >= 0, above, np.arange(n))
    steps = (above >= 0).astype(np.int64)
    while True:
        further = steps[last]
        if not further.any():
            return last, steps
        steps = steps + further
        last = last[last]


def _sums_down(down: IndexArray, own: IndexArray) -> IndexArray:
    """Sum of each element's own values and those of all below it, along pointers to their ends (-1), by doubling."""
    total, to = own.copy(), down.copy()
    while (inner := np.flatnonzero(to >= 0)).size:
        total[inner] += total[to[inner]]
        to[inner] = to[to[inner]]
    return total


def _make_room(stems: _Stems) -> None:
    """Leave out stems, and lead others past the end of the one they join, until all junctions have room."""
    length = stems.room[stems.end]
    while True:
        joining = stems.tributaries()
        parent, joint = stems.parent[joining], stems.joint[joining]
        load = np.bincount(parent, minlength=len(length))
        spur = stems.alive & (load == 0) & (length < 1.0)
        if spur.any():
            _leave_out(stems, np.flatnonzero(spur))
            continue
        # A tributary that joins a stem right above its end joins the stem below, as does the last one of a full stem.
        full = stems.alive & (load > 0) & (load + 1 > length)
        lowest = np.zeros(len(joining), bool)
        lowest[:-1] = parent[1:] != parent[:-1]
        lowest[-1:] = True
        can = stems.parent[parent] >= 0
        passing = can & ((stems.room[joint] > length[parent] - 1.0) | (lowest & full[parent]))
        if passing.any():
            moved, past = joining[passing], parent[passing]
            stems.joint[moved], stems.parent[moved] = stems.joint[past], stems.parent[past]
            continue
        # A full stem that ends at an outlet loses its smallest tributary.
        crowd = np.flatnonzero(full[parent])
        if not len(crowd):
            return
        crowd = crowd[np.lexsort((stems.area[stems.end[joining[crowd]]], parent[crowd]))]
        smallest = np.concatenate([[True], parent[crowd][1:] != parent[crowd][:-1]])
        _leave_out(stems, joining[crowd[smallest]])


def _leave_out(stems: _Stems, which: IndexArray) -> None:
    """Take stems out with all that flows into them; their ground drains to where they did."""
    dead = np.zeros(len(stems.alive), bool)
    dead[which] = True
    while True:
        more = dead | (stems.alive & (stems.parent >= 0) & dead[stems.parent])
        if (more == dead).all():
            break
        dead = more
    water = _stem_totals(stems)
    joined = which[stems.parent[which] >= 0]
    np.add.at(stems.supply, stems.joint[joined], water[joined])
    stems.alive[dead] = False


def _stem_totals(stems: _Stems) -> FloatArray:
    """Drainage area of each living stem at its lower end in cells, with all that flows into it: (S,)."""
    total = np.add.reduceat(stems.supply, stems.start[:-1])
    depth = _climb(stems.parent)[1]
    joining = np.flatnonzero(stems.alive & (stems.parent >= 0))
    joining = joining[np.argsort(-depth[joining], kind="stable")]
    for level in np.split(joining, np.flatnonzero(np.diff(depth[joining])) + 1):
        np.add.at(total, stems.parent[level], total[level])
    return total


def _drop_dead(stems: _Stems) -> None:
    """Forget the stems that are left out."""
    keep = np.flatnonzero(stems.alive)
    count = np.diff(stems.start)[keep]
    start = np.concatenate([[0], np.cumsum(count)])
    shift = stems.start[keep] - start[:-1]
    source = np.arange(start[-1]) + np.repeat(shift, count)
    number = np.cumsum(stems.alive) - 1
    parent = stems.parent[keep]
    inner = parent >= 0
    joint = stems.joint[keep]
    joint[inner] += (start[number[parent[inner]]]) - stems.start[parent[inner]]
    parent[inner] = number[parent[inner]]
    stems.place, stems.area, stems.supply = stems.place[source], stems.area[source], stems.supply[source]
    stems.room, stems.start, stems.parent, stems.joint = stems.room[source], start, parent, joint
    stems.alive = np.ones(len(keep), bool)


def _place_junctions(stems: _Stems) -> IndexArray:
    """Place where each stem meets its parent: (S,) among all stems' cells, one to a place, -1 at outlets.

    Junctions first move down until each is one channel below the one before, then up until they end in time.
    """
    junction = np.full(len(stems.parent), -1)
    joining = stems.tributaries()
    if not len(joining):
        return junction
    parent = stems.parent[joining]
    first = np.searchsorted(parent, np.unique(parent))
    count = np.diff(np.append(first, len(parent)))
    nth = np.arange(len(joining)) - np.repeat(first, count)
    left = np.repeat(count, count) - nth
    # One number line for all stems, each on a stretch of its own.
    length = stems.room[stems.end]
    stretch = np.concatenate([[0.0], np.cumsum(np.ceil(length) + 2.0)])[:-1]
    wanted = np.maximum(stems.room[stems.joint[joining]], 1.0) + stretch[parent]
    wanted = np.maximum.accumulate(wanted - nth) + nth
    wanted = np.minimum(wanted, length[parent] + stretch[parent] - left)
    line = stems.room + np.repeat(stretch, np.diff(stems.start))
    junction[joining] = np.searchsorted(line, wanted - 1e-9)
    return junction


def _settle_areas(stems: _Stems, junction: IndexArray) -> FloatArray:
    """Replace each cell's area by what its stem drains there; return the stems' own at their lower ends, in cells."""
    total = _stem_totals(stems)
    gain = stems.supply.copy()
    joining = junction >= 0
    gain[junction[joining]] += total[joining]
    summed = np.concatenate([[0.0], np.cumsum(gain)])
    stems.area = summed[1:] - np.repeat(summed[stems.start[:-1]], np.diff(stems.start))
    return total


def _centers(place: IndexArray, terrain: Terrain) -> FloatArray:
    """Centres of cells in m."""
    west, north = terrain.origin
    x = west + (place[:, 1] + 0.5) * terrain.cell_size
    y = north - (place[:, 0] + 0.5) * terrain.cell_size
    return np.column_stack([x, y])


def _smooth(xy: FloatArray, stems: _Stems, junction: IndexArray, passes: int) -> FloatArray:
    """Smooth all stems at once; each ends where its parent then runs, at one point more than it has cells.

    Returns:
        (n + S,) x, y of the stems' points. The point more of a stem that ends at an outlet lies on its last cell.
    """
    count = np.diff(stems.start)
    start = stems.start + np.arange(len(stems.start))
    place = np.arange(len(xy)) + np.repeat(np.arange(len(count)), count)
    line = np.empty((start[-1], 2))
    line[place] = xy
    tail = start[1:] - 1
    joined = junction >= 0
    onto = place[junction[joined]]
    line[tail[~joined]] = xy[stems.end[~joined]]
    line[tail[joined]] = line[onto]
    fixed = np.zeros(len(line), bool)
    fixed[start[:-1]] = fixed[tail] = True
    fixed[tail[~joined] - 1] = True
    inner = np.flatnonzero(~fixed)
    for _ in range(passes):
        line[inner] = 0.25 * line[inner - 1] + 0.5 * line[inner] + 0.25 * line[inner + 1]
        line[tail[joined]] = line[onto]
    return line


def _build(
    stems: _Stems,
    junction: IndexArray,
    total: FloatArray,
    line: FloatArray,
    height: FloatArray,
    cell_area: float,
    coefficient: float,
    spacing: float,
    varying: bool,
    crs: str | None,
    dtype: str,
    device: Any,
) -> RiverNetwork:
    """Cut the stems at their junctions and sample the channels."""
    count = np.diff(stems.start)
    stem_of_cell = np.repeat(np.arange(len(count)), count)
    head = stems.start[:-1] + np.arange(len(count))
    joined = junction >= 0
    # Last point of each stem: on its parent, or, at an outlet, its last cell.
    tail = stems.start[1:] + np.arange(len(count)) - ~joined
    onto = np.where(joined, junction + stem_of_cell[junction], -1)
    # Area in m2 at each point, below it and above it: they differ at junctions.
    below = np.empty(len(line))
    below[np.arange(len(stems.area)) + stem_of_cell] = stems.area * cell_area
    below[stems.start[1:] + np.arange(len(count))] = total
    above = below.copy()
    above[onto[joined]] -= total[joined]
    # Height in m at each point; a tributary ends at that of the cell it joins.
    level = np.empty(len(line))
    level[np.arange(len(stems.area)) + stem_of_cell] = height
    level[stems.start[1:] + np.arange(len(count))] = height[np.where(joined, junction, stems.end)]
    # Channels: from each head or junction to the next junction or tail.
    node_point = np.sort(np.concatenate([head, onto[joined]]))
    first = node_point
    stem = np.searchsorted(head, first, side="right") - 1
    last = np.append(first[1:], -1)
    lowest = np.append(stem[1:] != stem[:-1], True)
    last[lowest] = tail[stem[lowest]]
    # Nodes: one at each head, junction and outlet.
    node_at = np.concatenate([node_point, tail[~joined]])
    number = np.full(len(line), -1)
    number[node_at] = np.arange(len(node_at))
    number[tail[joined]] = number[onto[joined]]
    sample, start = _even_points(line, head, tail, first, last, spacing)
    k, part = sample
    xy = _cubic(line, head, tail, k, part)
    xy[start[:-1]], xy[start[1:] - 1] = line[first], line[last]
    area = (1.0 - part) * below[k] + part * above[k + 1]
    width = channel_width(area, coefficient)
    points = np.diff(start)
    mean = np.add.reduceat(width, start[:-1]) / points
    section = np.column_stack([width, bankfull_depth(width)]) if varying else None
    depth = np.add.reduceat(section[:, 1], start[:-1]) / points if section is not None else bankfull_depth(mean)
    # Junctions that were led up their stream to leave room lie a little above the cell that the tributary ends at.
    drop = np.maximum(level[first] - level[last], 0.0)
    pace = np.append(np.hypot(*np.diff(xy, axis=0).T), 0.0)
    pace[start[1:] - 1] = 0.0
    # A round origin keeps offsets exact in binary.
    origin = np.round(0.5 * (xy.min(axis=0) + xy.max(axis=0)))
    return RiverNetwork(
        xy - origin,
        start,
        ChannelTable(
            width=mean,
            depth=depth,
            discharge=bankfull_discharge(channel_width(above[last], coefficient)),
            drainage_area=above[last],
            slope=drop / np.add.reduceat(pace, start[:-1]),
            from_node=number[first],
            to_node=number[last],
        ),
        node_xy=line[node_at],
        point_section=section,
        origin=origin,
        crs=crs,
        dtype=dtype,
        device=device,
    )


def _even_points(
    line: FloatArray, head: IndexArray, tail: IndexArray, first: IndexArray, last: IndexArray, spacing: float
) -> tuple[tuple[IndexArray, FloatArray], IndexArray]:
    """Even steps along channels: point before each sample and the part of the way to the next one; channels' starts."""
    step = np.hypot(*np.diff(line, axis=0).T)
    step[head[1:] - 1] = 0.0
    repeated = tail[:-1] + 1 < head[1:]
    step[tail[:-1][repeated]] = 0.0
    along = np.concatenate([[0.0], np.cumsum(step)])
    length = along[last] - along[first]
    intervals = np.maximum(2, np.rint(length / spacing).astype(np.int64))
    start = np.concatenate([[0], np.cumsum(intervals + 1)])
    channel = np.repeat(np.arange(len(first)), intervals + 1)
    share = (np.arange(start[-1]) - start[channel]) / intervals[channel]
    wanted = along[first[channel]] + share * length[channel]
    k = np.clip(np.searchsorted(along, wanted, side="right") - 1, first[channel], last[channel] - 1)
    part = np.clip((wanted - along[k]) / (along[k + 1] - along[k]), 0.0, 1.0)
    part[start[:-1]], part[start[1:] - 1] = 0.0, 1.0
    return (k, part), start


def _cubic(line: FloatArray, head: IndexArray, tail: IndexArray, k: IndexArray, part: FloatArray) -> FloatArray:
    """Points on the cubics between the points k and k + 1; tangents are those of parabolas through three points."""
    step = np.hypot(*np.diff(line, axis=0).T)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        chord = np.diff(line, axis=0) / step
        tangent = np.empty_like(line)
        tangent[1:-1] = (step[1:] * chord[:-1] + step[:-1] * chord[1:]) / (step[:-1] + step[1:])
    tangent[head], tangent[tail] = chord[head], chord[tail - 1]
    t, h = part[:, None], step[k]
    a, b, u, v = line[k], line[k + 1], h * tangent[k], h * tangent[k + 1]
    s = 1.0 - t
    return s * s * (1.0 + 2.0 * t) * a + t * t * (3.0 - 2.0 * t) * b + t * s * (s * u - t * v)
