"""Routing: where water goes, how much area it drains, how long its courses are, and how high land lies above them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import warp as wp

from warpriver.hydrology.cells import Edges, NoData, flat, pad_terrain
from warpriver.kernels import routing as kernels
from warpriver.terrain import Terrain

__all__ = ["Flow", "drainage_area", "flow_directions", "flow_length", "hand", "route", "stream_power"]

# Scratch and results in bytes a cell, besides the padded copy.
D8_BYTES, MFD_BYTES = 17, 21


@dataclass(frozen=True, eq=False)
class Flow:
    """Where the water of each cell of a terrain goes by steepest descent: routed once, asked many times.

    It is a noun of its own because it is neither a surface nor a set of lines: a graph over a terrain's cells.

    Attributes:
        terrain: The surface.
        receiver: (rows, columns) int32, index row * columns + column of the cell that a cell's water goes to next; its
            own where water leaves or stays (outlets, pits, flats), -1 where there is no data.
        edges: The edge rules it was routed with.
        nodata: The rule for cells without data.
    """

    terrain: Terrain
    receiver: np.ndarray
    edges: Edges = "open"
    nodata: NoData = "outlet"

    @classmethod
    def _of(cls, terrain: Terrain, receiver: np.ndarray, edges: Edges, nodata: NoData) -> Flow:
        """Wrap a receiver that is known to be sound, without the checks."""
        flow = cls.__new__(cls)
        for name, value in (("terrain", terrain), ("receiver", receiver), ("edges", edges), ("nodata", nodata)):
            object.__setattr__(flow, name, value)
        return flow

    def __post_init__(self) -> None:
        """Check a receiver from elsewhere: the kernels do not."""
        receiver = np.ascontiguousarray(self.receiver, np.int32)
        if receiver.shape != self.terrain.shape or not np.array_equal(receiver, self.receiver):
            raise ValueError(f"receiver must be whole numbers of shape {self.terrain.shape}, one cell's index a cell")
        to = receiver[receiver >= 0]
        if receiver.min() < -1 or receiver.max() >= receiver.size or (receiver.reshape(-1)[to] < 0).any():
            raise ValueError("receiver leads out of the raster or to a cell without data")
        if len(to) and np.bincount(to).max() > 9:
            raise ValueError("receiver gives a cell more donors than it has neighbours")
        object.__setattr__(self, "receiver", receiver)

    @cached_property
    def order(self) -> np.ndarray:
        """All cells with data, (n,) int32, each before its receiver; backwards, each after it."""
        kernel = kernels.build(wp.float64).order_cells
        count: wp.array = wp.empty(1, dtype=int, device="cpu")
        cells = np.empty(self.receiver.size, np.int32)
        donors: wp.array = wp.zeros(cells.size, dtype=wp.uint8, device="cpu")
        wp.launch(kernel, 1, [flat(self.receiver)], [count, flat(cells), donors], device="cpu")
        found, wanted = int(count.numpy()[0]), int(np.count_nonzero(self.receiver >= 0))
        if found != wanted:
            raise ValueError(f"receiver leads water around in a cycle: {wanted - found} cells have no way out of one")
        return cells[:found]

    def __repr__(self) -> str:
        rows, columns = self.receiver.shape
        return f"Flow({rows} x {columns} cells, edges={self.edges!r}, nodata={self.nodata!r})"


def route(
    terrain: Terrain,
    *,
    edges: Edges = "open",
    nodata: NoData = "outlet",
    neighbors: Literal[8, 4] = 8,
    ties: Literal["first", "hash"] = "first",
    seed: int = 0,
) -> Flow:
    """Lead the water of each cell to the neighbour of steepest descent, (z - z_n) / distance [OCallaghan1984].

    The terrain is taken as it is: in a pit or on a flat
    water stays, so fill or carve it first. Water that reaches an outlet leaves the terrain there.

    Args:
        terrain: The surface.
        edges: What the four sides are, as in :func:`warpriver.hydrology.fill_depressions`.
        nodata: Cells without data are an "outlet" for their neighbours, or a "wall".
        neighbors: 8, or 4 for no diagonals. Filled terrain may have pits among four neighbours.
        ties: Which of equal slopes counts: the "first" clockwise from the north, or by "hash": one by chance, which
            depends on seed, cell and neighbour alone. On a plane the first ones all run in parallel.
        seed: Of the hash; 0 or more.

    Raises:
        ValueError: An unknown edge rule, a periodic side without its opposite, another number of neighbours, rule for
            ties or seed, or more than 2^31 cells.
        MemoryError: There is no room, told before anything is allocated.
    """
    if neighbors not in (8, 4):
        raise ValueError(f"neighbors is {neighbors!r}; use 8 or 4")
    if ties not in ("first", "hash"):
        raise ValueError(f"ties is {ties!r}; use 'first' or 'hash'")
    if seed != int(seed) or seed < 0:
        raise ValueError(f"seed is {seed}; give a whole number, 0 or more")
    cells = pad_terrain(terrain, edges, nodata, D8_BYTES)
    receiver = np.empty(terrain.shape, np.int32)
    mixed = int(np.random.SeedSequence(int(seed)).generate_state(1)[0] >> 1)
    rules = [int(neighbors == 4), int(ties == "hash"), mixed]
    wp.launch(
        kernels.build(wp.float64).find_receivers,
        dim=cells.rows,
        inputs=[cells.rows, cells.stride, *rules, flat(cells.height), flat(cells.state)],
        outputs=[_table(receiver)],
        device="cpu",
    )
    return Flow._of(terrain, receiver, edges, nodata)


def flow_directions(terrain: Terrain, *, edges: Edges = "open", nodata: NoData = "outlet") -> np.ndarray:
    """Return ``route(...).receiver``: the cell that each cell's water goes to next, (rows, columns) int32."""
    return route(terrain, edges=edges, nodata=nodata).receiver


def drainage_area(
    surface: Terrain | Flow,
    *,
    method: Literal["d8", "mfd"] = "d8",
    exponent: float = 1.1,
    edges: Edges | None = None,
    nodata: NoData | None = None,
) -> np.ndarray:
    """Return the area in m2 that drains through each cell, its own included.

    Args:
        surface: A terrain, filled or carved, or its flow.
        method: "d8": all water to the steepest neighbour; the areas are whole numbers of cells. "mfd": to all lower
            neighbours, in shares s^p / sum s^p of their slopes [Freeman1991].
        exponent: p of "mfd". 1.1 gives the roundest cones; large ones approach "d8".
        edges: What the four sides are, "open" by default; a flow has its own.
        nodata: "outlet" (the default) or "wall"; a flow has its own.

    Returns:
        (rows, columns) float64, m2; NaN where there is no data. Over outlets and pits it sums to the area of all cells.

    Raises:
        ValueError: An unknown method, an exponent that is not positive, edges beside a flow, and as :func:`route`.
        MemoryError: There is no room, told before anything is allocated.
    """
    if method not in ("d8", "mfd"):
        raise ValueError(f"method is {method!r}; use 'd8' or 'mfd'")
    if not (math.isfinite(exponent) and exponent > 0.0):
        raise ValueError(f"exponent is {exponent}; give a positive number, such as 1.1")
    if method == "d8":
        flow = _flow(surface, edges, nodata)
        cells = np.where(flow.receiver < 0, np.nan, 1.0)
        launch = kernels.build(wp.float64).sum_upstream
        wp.launch(launch, 1, [flat(flow.receiver), flat(flow.order)], [flat(cells)], device="cpu")
        cell_size = flow.terrain.cell_size
    else:
        terrain, edges, nodata = _surface(surface, edges, nodata)
        cells = _shared_cells(terrain, float(exponent), edges, nodata)
        cell_size = terrain.cell_size
    cells *= cell_size**2
    return cells


def stream_power(
    surface: Terrain | Flow,
    area: Any = None,
    *,
    m: float = 0.5,
    n: float = 1.0,
    edges: Edges | None = None,
    nodata: NoData | None = None,
) -> np.ndarray:
    """Return the stream power area^m slope^n of each cell, in m^(2 m); m = 1/2 and n = 1 as in [Peytavie2019].

    Args:
        surface: A terrain, filled or carved, or its flow.
        area: (rows, columns) drainage area in m2; by default that of :func:`drainage_area` by "d8".
        m: Exponent of the area.
        n: Exponent of the slope, which is that to the receiver; 0 at outlets, in pits and on flats.
        edges: As in :func:`drainage_area`.
        nodata: As in :func:`drainage_area`.

    Returns:
        (rows, columns) float64; NaN where there is no data.
    """
    flow = _flow(surface, edges, nodata)
    area = drainage_area(flow) if area is None else _checked_cells(area, flow, "area").astype(np.float64)
    slope = np.empty(flow.receiver.shape)
    wp.launch(
        kernels.build(wp.float64).measure_slopes,
        dim=len(slope),
        inputs=[_table(_host_height(flow.terrain)), _table(flow.receiver)],
        outputs=[_table(slope)],
        device="cpu",
    )
    return area**m * (slope / flow.terrain.cell_size) ** n


def flow_length(
    surface: Terrain | Flow, downstream: bool = True, *, edges: Edges | None = None, nodata: NoData | None = None
) -> np.ndarray:
    """Return lengths along the steepest courses in m.

    Args:
        surface: A terrain, filled or carved, or its flow.
        downstream: True: from each cell to where its water leaves or stays. False: of the longest course that comes
            down to each cell, 0 at sources.
        edges: As in :func:`drainage_area`.
        nodata: As in :func:`drainage_area`.

    Returns:
        (rows, columns) float64, m; NaN where there is no data.
    """
    flow = _flow(surface, edges, nodata)
    kernel = kernels.build(wp.float64)
    length = np.where(flow.receiver < 0, np.nan, 0.0)
    inputs = [length.shape[1], flat(flow.receiver), flat(flow.order)]
    launch = kernel.measure_downstream if downstream else kernel.measure_upstream
    wp.launch(launch, 1, inputs, [flat(length)], device="cpu")
    length *= flow.terrain.cell_size
    return length


def hand(
    surface: Terrain | Flow, channels: Any, *, edges: Edges | None = None, nodata: NoData | None = None
) -> np.ndarray:
    """Return the height above the nearest drainage: above the first channel cell down each course [Nobre2011].

    Args:
        surface: A terrain, filled or carved, or its flow.
        channels: (rows, columns) bool, the cells that are channel.
        edges: As in :func:`drainage_area`.
        nodata: As in :func:`drainage_area`.

    Returns:
        (rows, columns) float64, m; 0 in channels, NaN where no channel follows or there is no data.
    """
    flow = _flow(surface, edges, nodata)
    channel = _checked_cells(channels, flow, "channels").astype(bool) & (flow.receiver >= 0)
    height = _host_height(flow.terrain)
    base = np.where(channel, height, np.nan)
    inputs = [flat(flow.receiver), flat(flow.order), flat(channel.view(np.uint8))]
    wp.launch(kernels.build(wp.float64).carry_upstream, 1, inputs, [flat(base)], device="cpu")
    return height - base


def _shared_cells(terrain: Terrain, exponent: float, edges: Edges, nodata: NoData) -> np.ndarray:
    """Cells that drain through each cell by multiple flow, as fractions."""
    kernel = kernels.build(wp.float64)
    cells = pad_terrain(terrain, edges, nodata, MFD_BYTES)
    height, state = flat(cells.height), flat(cells.state)
    gathered = np.ones(cells.count)
    donors: wp.array = wp.full(cells.count, 255, dtype=wp.uint8, device="cpu")
    ground = [cells.rows, cells.stride]
    wp.launch(kernel.count_contributors, cells.rows, [cells.stride, height, state], [donors], device="cpu")
    stack: wp.array = wp.empty(cells.count, dtype=int, device="cpu")
    outputs = [flat(gathered), donors, stack]
    wp.launch(kernel.share_downhill, 1, [*ground, exponent, height, state], outputs, device="cpu")
    area = cells.interior(gathered)
    area[np.isnan(cells.height[1:-1, 1:-1])] = np.nan
    return area


def _flow(surface: Terrain | Flow, edges: Edges | None, nodata: NoData | None) -> Flow:
    """Route a terrain, or pass a flow on."""
    terrain, edges, nodata = _surface(surface, edges, nodata)
    return surface if isinstance(surface, Flow) else route(terrain, edges=edges, nodata=nodata)


def _surface(surface: Terrain | Flow, edges: Edges | None, nodata: NoData | None) -> tuple[Terrain, Edges, NoData]:
    """Terrain and rules of either."""
    if isinstance(surface, Flow):
        if edges is not None or nodata is not None:
            raise ValueError("a Flow has its edges and nodata already; leave them out, or give the terrain")
        return surface.terrain, surface.edges, surface.nodata
    return surface, "open" if edges is None else edges, "outlet" if nodata is None else nodata


def _checked_cells(values: Any, flow: Flow, name: str) -> np.ndarray:
    """Return an array with one value a cell, or raise ``ValueError``."""
    array = np.asarray(values)
    if array.shape != flow.receiver.shape:
        raise ValueError(f"{name} has shape {array.shape}; the terrain has {flow.receiver.shape}")
    return array


def _host_height(terrain: Terrain) -> np.ndarray:
    """Heights on the host, without a copy where they are there."""
    return np.ascontiguousarray(terrain.height.numpy())


def _table(array: np.ndarray) -> wp.array:
    """View a host array as a two-dimensional array of Warp's CPU device."""
    return flat(array).reshape(array.shape)
