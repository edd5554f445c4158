"""Network extraction: the cells that drain enough ground, as smooth channels of a river network."""

from __future__ import annotations

from typing import Literal

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.hydraulic_geometry import WIDTH_COEFFICIENT
from warpriver.hydrology.cells import Edges, NoData
from warpriver.hydrology.channel_cells import find_channel_cells
from warpriver.hydrology.courses import make_courses, sample_channels
from warpriver.hydrology.routing import Depressions, Flow, checked_areas, host_areas, route
from warpriver.hydrology.side_by_side import join_side_by_side
from warpriver.hydrology.stems import drop_dead, place_junctions, space_junctions, split_into_stems
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of
from warpriver.validate import positive, whole

__all__ = ["extract_network"]


# Drainage areas this close to a whole number of cells are that number.
WHOLE = 1e-6


@public
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
    max_cut: float | None = None,
    unroll: bool = False,
    area: Raster | ArrayLike | None = None,
    flow: Flow | None = None,
    dtype: Literal["float64", "float32"] = "float64",
    device: wp.DeviceLike = "cpu",
) -> RiverNetwork:
    """Find the rivers of a terrain: a forest of binary trees, one for every basin that is large enough.

    A cell is channel if it drains ``min_drainage_area`` or more by steepest descent. Nodes lie at sources, junctions
    and outlets (the edge of the map, no data, the sea, a place that water does not leave). Courses run through the
    cells' centres, are smoothed by passes of the filter 1/4, 1/2, 1/4 in which sources and outlets stay where they
    are, and are sampled evenly along a cubic that passes through the smoothed points and goes on smoothly through
    junctions down the larger stream.

    Depressions and flats:
        Short obstacles, such as noise, bridges and banks, are cut through; every other depression is filled to where
        it spills (:func:`warpriver.hydrology.route`). Over level and filled ground rivers follow its deepest part and
        keep away from the shores. Their slope is 0 there.

    Lakes:
        Level and filled ground that is five cells wide or wider is a lake. No river begins on it: rivers cross it from
        where they flow in to the outlet, which carries the water of all shores. They end on the shore of the sea (such
        ground at an open side of the map at a height of 0 or below), and of a lake that no water leaves. A lake
        without data is no ground: rivers end on its shore and begin anew below it, without the water from above, or,
        with ``nodata="wall"``, run round it to where the land lets them out.

    Streams side by side:
        A stream that runs alongside of a larger one, within three cells or a cell from bank to bank, down to where
        both meet or end, joins it where that begins.

    Short channels:
        Every channel is at least three cells and two widths long. Where tributaries would meet a stream closer
        together, or more than one in a place, their junctions move along the stream, as a rule downstream; one that
        would join a stream right above its own end joins the larger stream below. A stream shorter than that is left
        out, and so is one without tributaries that is shorter than 0.3 times the square root of
        ``min_drainage_area``, a stub; where a stream is too short for all tributaries, the smallest is. Drainage areas
        stay true: what is left out still drains through the channel below.

    Edges:
        A river that touches an open side of the map leaves there, also where it would run along it; along a closed
        side it runs on. Where a side is periodic, channels end there and begin anew on the opposite side; with
        ``unroll`` they run on beyond the map, so that each river is in one piece from its mouth, which lies on the map.

    Args:
        terrain: The ground, or a raster of heights in m; it is not changed.
        min_drainage_area: Minimum drainage area of a channel, m2.
        width_coefficient: c of the width c area^0.5 in m per m; see :func:`warpriver.hydrology.channel_width`.
        spacing: Distance between points along a channel in m, adapted so that it divides the length; at least two
            intervals a channel. By default the cell size.
        smoothing: Passes of the filter; n of them smooth like a Gaussian of sqrt(n / 2) cells.
        varying: Whether width and depth vary along a channel with its drainage area, or have its mean width.
        edges: What the four sides are, as in :func:`warpriver.hydrology.fill_depressions`.
        nodata: Cells without data are an "outlet" for their neighbours, or a "wall".
        carve: Whether depressions are cut open where a cut of ``max_cut`` is long enough, or are all filled.
        max_cut: Length of the longest cut in m, ``math.inf`` for any; by default 4 cells or 30 m, whichever is longer.
            Longer cuts lead rivers through banks and hills.
        unroll: Whether rivers run on across periodic sides.
        area: (rows, columns) drainage area by "d8" in m2, if it is known.
        flow: The terrain's flow, if it is known. It has its own edges and depressions; ``edges``, ``nodata``
            and ``carve`` are not used. Lakes are known to it where it was routed with ``depressions``.
        dtype: Precision of the network on the device.
        device: Warp device of the network.

    Returns:
        The network, in the terrain's CRS. ``channel_drainage_area`` is that just above the node at the downstream end,
        and ``channel_discharge`` is the bankfull discharge of a channel as wide as it is there,
        :func:`warpriver.hydrology.bankfull_discharge`. ``channel_slope`` is the drop
        from the cell at the channel's upper end to the one at its lower end, over the length of its line. Heights are
        those of the surface that water was routed on, carved and filled: the raw terrain rises along a course wherever
        it crosses a pit or noise. So it is never below 0, 0 across a lake, and near an outlet of a carved pit that of
        the cut.

    Raises:
        ValueError: A level terrain, a threshold or another number out of range, a cut where nothing is carved, a
            threshold that leaves no channel, an area that shrinks downstream or does not fit the terrain, and as
            :func:`warpriver.hydrology.fill_depressions`.
        MemoryError: Too little memory, told before anything is allocated.
    """
    threshold = positive(min_drainage_area, "min_drainage_area", "m2")
    coefficient = positive(width_coefficient, "width_coefficient", "m per m")
    ground = surface_of(terrain)
    step = positive(ground.cell_size if spacing is None else spacing, "spacing", "m")
    passes = whole(smoothing, "smoothing", unit="passes")
    if max_cut is not None and not (carve and flow is None):
        raise InputError("max_cut is for carve=True, and not for a flow that is given")
    if flow is None:
        _refuse_level_ground(ground)
        opened: Depressions = "carve" if carve else "fill"
        flow = route(ground, depressions=opened, max_cut=max_cut, edges=edges, nodata=nodata)
    elif flow.terrain.shape != ground.shape or flow.terrain.cell_size != ground.cell_size:
        raise InputError(f"flow is that of another terrain: {flow!r} beside {ground.shape[0]} x {ground.shape[1]}")
    cell_area = ground.cell_size**2
    drained = _cells_drained(flow, area, cell_area)
    cells = find_channel_cells(flow, drained, threshold / cell_area, unroll)
    stems = split_into_stems(join_side_by_side(cells, coefficient), coefficient)
    space_junctions(stems, threshold / cell_area)
    if not stems.alive.any():
        raise InputError(_no_channel(threshold, float(np.nanmax(drained)) * cell_area))
    drop_dead(stems)
    courses = make_courses(stems, place_junctions(stems), ground, passes)
    parts = sample_channels(courses, step, coefficient, varying)
    # A round origin keeps offsets exact in binary.
    origin = np.round(0.5 * (parts.point_xy.min(axis=0) + parts.point_xy.max(axis=0)))
    return RiverNetwork(
        parts.point_xy - origin,
        parts.channel_start,
        parts.channels,
        node_xy=parts.node_xy,
        point_section=parts.point_section,
        origin=origin,
        crs=ground.crs,
        dtype=dtype,
        device=device,
    )


def _no_channel(threshold: float, largest: float) -> str:
    """Say that a threshold leaves no channel, and what would."""
    short = " longer than three cells, two widths and a stub" if largest >= threshold else ""
    return (
        f"no channel{short} drains {threshold:g} m2 (min_drainage_area); the largest drainage area on this terrain "
        f"is {largest:g} m2"
    )


def _refuse_level_ground(terrain: Terrain) -> None:
    """Raise ``ValueError`` where all cells have one height: the courses of water would be those of the raster."""
    height = terrain.height.numpy()
    lowest = np.fmin.reduce(height, axis=None)
    if lowest == np.fmax.reduce(height, axis=None):
        raise InputError(f"the terrain is level, {lowest:g} m in every cell with data: water has no course to take")


def _cells_drained(flow: Flow, area: Raster | ArrayLike | None, cell_area: float) -> FloatArray:
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
