"""Routing: where water goes, how much area it drains, how long its courses are, and how high land lies above them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import CellArray, DeviceArray, FloatArray
from warpriver.device import launch_kernel
from warpriver.errors import InputError
from warpriver.hydrology.cells import Edges, NoData, PaddedCells, flat, pad_terrain, table
from warpriver.hydrology.depressions import carve_cells, fill_cells, limit_in_m, with_heights
from warpriver.hydrology.lakes import SEA, lead_over_flats
from warpriver.kernels import routing as kernels
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain, surface_of
from warpriver.validate import MAX_SEED, finite, one_of, positive, whole

__all__ = [
    "Flow",
    "checked_areas",
    "drainage_area",
    "flow_directions",
    "flow_length",
    "hand",
    "host_areas",
    "host_lengths",
    "order_cells",
    "route",
    "stream_power",
    "sum_upstream",
]


Surface = Terrain | Raster
Depressions = Literal["keep", "fill", "carve"]

# Scratch and results in bytes a cell, besides the padded copy.
D8_BYTES, MFD_BYTES, OPEN_BYTES = 17, 21, 110
# Longest cut that opens a depression by default: the longer one of some cells and a length in m. A bank of noise or a
# bridge is as wide as a few cells, a road's embankment wider than some cells of fine rasters.
CUT_CELLS, CUT_LENGTH = 4.0, 30.0


@dataclass(frozen=True, eq=False)
class Flow:
    """Where the water of each cell of a terrain goes by steepest descent: routed once, used many times.

    It is a noun of its own because it is neither a surface nor a set of lines: a graph over a terrain's cells. Flows
    pickle, as rasters do.

    Attributes:
        terrain: The surface.
        receiver: Raster of int32 on the surface's device, index row * columns + column of the cell that a cell's water
            goes to next; its own where water leaves or stays (outlets, pits, flats), -1 where there is no data. Given
            as an array, it is checked and becomes a Raster.
        edges: The edge rules it was routed with.
        nodata: The rule for cells without data.
        water: Raster of uint8, or None where it is not known: 0 on land; 1 on lakes, level ground and filled
            depressions that are five cells wide or wider; 2 on the sea and on lakes that no water leaves.
    """

    terrain: Terrain
    receiver: Raster
    edges: Edges = "open"
    nodata: NoData = "outlet"
    water: Raster | None = None

    @classmethod
    def _of(
        cls, terrain: Terrain, receiver: np.ndarray, edges: Edges, nodata: NoData, water: np.ndarray | None = None
    ) -> Flow:
        """Wrap results on the host that are known to be sound, without the checks."""
        flow = cls.__new__(cls)
        flow._keep(terrain, receiver, water)
        for name, value in (("edges", edges), ("nodata", nodata)):
            object.__setattr__(flow, name, value)
        return flow

    def __post_init__(self) -> None:
        """Check a receiver from elsewhere: the kernels do not."""
        terrain = surface_of(self.terrain)
        given = self.receiver
        receiver = np.array(given, np.int32, order="C")
        if receiver.shape != terrain.shape or not np.array_equal(receiver, given):
            raise InputError(f"receiver must be whole numbers of shape {terrain.shape}, one cell's index a cell")
        if isinstance(given, Raster) and not given.matches(terrain):
            raise InputError(f"receiver lies on other cells than the terrain: {given!r} beside {terrain!r}")
        to = receiver[receiver >= 0]
        if receiver.min() < -1 or receiver.max() >= receiver.size or (receiver.reshape(-1)[to] < 0).any():
            raise InputError("receiver leads out of the raster or to a cell without data")
        if len(to) and np.bincount(to).max() > 9:
            raise InputError("receiver gives a cell more donors than it has neighbours")
        water = None
        if self.water is not None:
            water = np.ascontiguousarray(checked_cells(self.water, terrain, "water"), np.uint8)
            if not np.array_equal(water, self.water) or water.max() > SEA:
                raise InputError("water must be 0 on land, 1 on lakes and 2 on the sea")
        self._keep(terrain, receiver, water)

    def _keep(self, terrain: Terrain, receiver: np.ndarray, water: np.ndarray | None) -> None:
        """Keep a terrain, and a receiver and the water from the host."""
        rasters = {"receiver": terrain.raster.like(table(receiver), name="receiver"), "water": None}
        if water is not None:
            rasters["water"] = terrain.raster.like(table(water), name="water")
        for name, value in {"terrain": terrain, **rasters}.items():
            object.__setattr__(self, name, value)

    @cached_property
    def host_receiver(self) -> np.ndarray:
        """The receiver on the host, where water is led for now: a view of it on the CPU, fetched once from a GPU."""
        receiver: np.ndarray = self.receiver.values.numpy()
        return receiver

    @cached_property
    def order(self) -> np.ndarray:
        """All cells with data, (n,) int32, each before its receiver; backwards, each after it."""
        cells = order_cells(self.host_receiver)
        left = int(np.count_nonzero(self.host_receiver >= 0)) - len(cells)
        if left:
            raise InputError(f"receiver leads water around in a cycle: {left} cells have no way out of one")
        return cells

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "host_receiver"}

    def __repr__(self) -> str:
        rows, columns = self.terrain.shape
        return f"Flow({rows} x {columns} cells, edges={self.edges!r}, nodata={self.nodata!r})"


@public
def route(
    terrain: Surface,
    *,
    depressions: Depressions = "keep",
    max_cut: float | None = None,
    edges: Edges = "open",
    nodata: NoData = "outlet",
    neighbors: Literal[8, 4] = 8,
    ties: Literal["first", "hash"] = "first",
    seed: int = 0,
) -> Flow:
    """Lead the water of each cell to the neighbour of steepest descent, (z - z_n) / distance [OCallaghan1984].

    Water that reaches an outlet leaves the terrain there. With ``depressions="keep"`` it stays in pits and on flats.
    Otherwise all of it gets out:

    - Depressions are filled to where they spill; by "carve" they are first cut open along the course that takes away
      the least height, where a cut of ``max_cut`` is long enough.
    - Over flats and filled depressions water runs to the exits along paths of minimum cost: away from the shores,
      through the deepest ground, and in any direction rather than along those of the raster.
    - Flats five cells wide or wider are lakes (``Flow.water``). One at an open side at a height of 0 or below is the
      sea.

    Args:
        terrain: The surface, a terrain or a raster of heights in m; it is not changed.
        depressions: "keep", "fill" or "carve".
        max_cut: Longest cut by "carve" in m, ``math.inf`` for any; by default 4 cells or 30 m, whichever is longer.
        edges: What the four sides are, as in :func:`warpriver.hydrology.fill_depressions`.
        nodata: Cells without data are an "outlet" for their neighbours, or a "wall".
        neighbors: 8, or 4 for no diagonals. Filled terrain may have pits among four neighbours.
        ties: Which of equal slopes counts: the "first" clockwise from the north, or by "hash": a random one, which
            depends on seed, cell and neighbour alone. On a plane the first ones all run in parallel.
        seed: Of the hash; 0 or more.

    Returns:
        The flow. Its terrain is the surface that water runs on: the one given, or opened, with level lakes.

    Raises:
        ValueError: No surface, an unknown edge rule, a periodic side without its opposite, another number of
            neighbours, rule for ties, for depressions or seed, 4 neighbours or a cut where they have no meaning, or
            more than 2^31 cells.
        MemoryError: Too little memory, told before anything is allocated.
    """
    one_of(depressions, "depressions", ("keep", "fill", "carve"))
    one_of(neighbors, "neighbors", (8, 4))
    one_of(ties, "ties", ("first", "hash"))
    seed = whole(seed, "seed", maximum=MAX_SEED)
    ground = surface_of(terrain)
    if max_cut is not None:
        if depressions != "carve":
            raise InputError(f'max_cut is for depressions="carve"; they are {depressions!r}')
        limit_in_m(max_cut, "max_cut")
    if depressions == "keep":
        cells = pad_terrain(ground, edges, nodata, D8_BYTES)
        return Flow._of(ground, _receivers(cells, neighbors, ties, seed), edges, nodata)
    if neighbors == 4:
        raise InputError(f"neighbors is 4 and depressions {depressions!r}; opened ground drains among 8 neighbours")
    cut = 0.0
    if depressions == "carve":
        cut = max(CUT_CELLS * ground.cell_size, CUT_LENGTH) if max_cut is None else float(max_cut)
    surface, bed = _open(ground, cut, edges, nodata)
    cells = pad_terrain(surface, edges, nodata, 0)
    receiver = _receivers(cells, neighbors, ties, seed)
    water = lead_over_flats(cells, bed, receiver)
    return Flow._of(surface, receiver, edges, nodata, water)


def _open(ground: Terrain, cut: float, edges: Edges, nodata: NoData) -> tuple[Terrain, np.ndarray]:
    """Carve and fill a terrain, level: the surface, and the height of its ground."""
    cells = pad_terrain(ground, edges, nodata, OPEN_BYTES)
    if cut > 0.0:
        carve_cells(cells, math.inf, cut / ground.cell_size)
    bed = cells.interior(cells.height)
    fill_cells(cells, False)
    return with_heights(ground, cells), bed


def _receivers(cells: PaddedCells, neighbors: int, ties: str, seed: int) -> np.ndarray:
    """Receiver of each cell by steepest descent; its own in pits and on flats."""
    receiver = np.empty((cells.rows, cells.columns), np.int32)
    mixed = int(np.random.SeedSequence(int(seed)).generate_state(1)[0] >> 1)
    rules = [int(neighbors == 4), int(ties == "hash"), mixed]
    launch_kernel(
        kernels.build(wp.float64).find_receivers,
        dim=cells.rows,
        inputs=[cells.rows, cells.stride, *rules, flat(cells.height), flat(cells.state)],
        outputs=[table(receiver)],
        device="cpu",
    )
    return receiver


@public
def flow_directions(terrain: Surface, *, edges: Edges = "open", nodata: NoData = "outlet") -> Raster:
    """Return ``route(...).receiver``: the cell that each cell's water goes to next, as in :class:`Flow`."""
    return route(terrain, edges=edges, nodata=nodata).receiver


@public
def drainage_area(
    surface: Surface | Flow,
    *,
    method: Literal["d8", "mfd"] = "d8",
    exponent: float = 1.1,
    edges: Edges | None = None,
    nodata: NoData | None = None,
) -> Raster:
    """Return the area in m2 that drains through each cell, its own included.

    Args:
        surface: A terrain, filled or carved, a raster of such heights, or its flow.
        method: "d8": all water to the steepest neighbour; the areas are whole numbers of cells. "mfd": to all lower
            neighbours, in fractions s^p / sum s^p of their slopes [Freeman1991].
        exponent: p of "mfd". 1.1 gives the roundest cones; large ones approach "d8".
        edges: What the four sides are, "open" by default; a flow has its own.
        nodata: "outlet" (the default) or "wall"; a flow has its own.

    Returns:
        Raster in m2, on the surface's device; NaN where there is no data. Over outlets and pits it sums to the area of
        all cells.

    Raises:
        ValueError: An unknown method, an exponent that is not positive, "mfd" on a flow with lakes, edges beside a
            flow, and as :func:`route`.
        MemoryError: Too little memory, told before anything is allocated.
    """
    one_of(method, "method", ("d8", "mfd"))
    positive(exponent, "exponent", hint=", such as 1.1")
    if method == "d8":
        flow = _flow(surface, edges, nodata)
        terrain, area = flow.terrain, host_areas(flow)
    else:
        if isinstance(surface, Flow) and surface.water is not None:
            raise InputError("multiple flow stays on level lakes, as this flow has; give fill_depressions(terrain)")
        terrain, edges, nodata = _surface(surface, edges, nodata)
        area = _shared_cells(terrain, float(exponent), edges, nodata)
        area *= terrain.cell_size**2
    return terrain.raster.like(table(area), unit="m2", name="drainage_area")


def host_areas(flow: Flow) -> np.ndarray:
    """Return the drainage area by steepest descent on the host, (rows, columns) float64 in m2."""
    area = sum_upstream(flow.host_receiver, flow.order, np.where(flow.host_receiver < 0, np.nan, 1.0))
    area *= flow.terrain.cell_size**2
    return area


def sum_upstream(receiver: CellArray, order: CellArray, values: FloatArray) -> FloatArray:
    """Add to each value, in place, what all cells upstream of its cell have.

    Args:
        receiver: Receiver of each cell, its own where water stays, -1 without data; of any shape.
        order: Each cell before its receiver, from :func:`order_cells`.
        values: One a cell; returned.
    """
    launch = kernels.build(wp.float64).sum_upstream
    launch_kernel(launch, 1, [flat(receiver), flat(order)], [flat(values)], device="cpu")
    return values


def order_cells(receiver: CellArray) -> CellArray:
    """List all cells with data, each before its receiver; cells of a cycle are left out."""
    count: DeviceArray = wp.empty(1, dtype=int, device="cpu")
    cells = np.empty(receiver.size, np.int32)
    donors: DeviceArray = wp.zeros(cells.size, dtype=wp.uint8, device="cpu")
    outputs = [count, flat(cells), donors]
    launch_kernel(kernels.build(wp.float64).order_cells, 1, [flat(receiver)], outputs, device="cpu")
    return cells[: int(count.numpy()[0])]


@public
def stream_power(
    surface: Surface | Flow,
    area: Raster | ArrayLike | None = None,
    *,
    m: float = 0.5,
    n: float = 1.0,
    edges: Edges | None = None,
    nodata: NoData | None = None,
) -> Raster:
    """Return the stream power area^m slope^n of each cell, in m^(2 m); m = 1/2 and n = 1 as in [Peytavie2019].

    Args:
        surface: A terrain, filled or carved, a raster of such heights, or its flow.
        area: (rows, columns) drainage area in m2; by default that of :func:`drainage_area` by "d8".
        m: Exponent of the area.
        n: Exponent of the slope, which is that to the receiver; 0 at outlets, in pits and on flats.
        edges: As in :func:`drainage_area`.
        nodata: As in :func:`drainage_area`.

    Returns:
        Raster on the surface's device; NaN where there is no data.
    """
    flow = _flow(surface, edges, nodata)
    drained = host_areas(flow) if area is None else checked_areas(area, flow)
    slope = np.empty(flow.terrain.shape)
    launch_kernel(
        kernels.build(wp.float64).measure_slopes,
        dim=len(slope),
        inputs=[table(_host_height(flow.terrain)), table(flow.host_receiver)],
        outputs=[table(slope)],
        device="cpu",
    )
    m, n = finite(m, "m"), finite(n, "n")
    power = drained**m * (slope / flow.terrain.cell_size) ** n
    return flow.terrain.raster.like(table(power), unit=_power_of_metres(2.0 * m), name="stream_power")


@public
def flow_length(
    surface: Surface | Flow,
    downstream: bool = True,
    *,
    edges: Edges | None = None,
    nodata: NoData | None = None,
) -> Raster:
    """Return lengths along the steepest courses in m.

    Args:
        surface: A terrain, filled or carved, a raster of such heights, or its flow.
        downstream: True: from each cell to where its water leaves or stays. False: of the longest course that comes
            down to each cell, 0 at sources.
        edges: As in :func:`drainage_area`.
        nodata: As in :func:`drainage_area`.

    Returns:
        Raster in m, on the surface's device; NaN where there is no data.
    """
    flow = _flow(surface, edges, nodata)
    name = "flow_length" if downstream else "upstream_flow_length"
    return flow.terrain.raster.like(table(host_lengths(flow, downstream)), unit="m", name=name)


def host_lengths(flow: Flow, downstream: bool = True) -> np.ndarray:
    """Return the lengths of :func:`flow_length` on the host, (rows, columns) float64 in m."""
    kernel, receiver = kernels.build(wp.float64), flow.host_receiver
    length = np.where(receiver < 0, np.nan, 0.0)
    inputs = [length.shape[1], flat(receiver), flat(flow.order)]
    launch = kernel.measure_downstream if downstream else kernel.measure_upstream
    launch_kernel(launch, 1, inputs, [flat(length)], device="cpu")
    length *= flow.terrain.cell_size
    return length


@public
def hand(
    surface: Surface | Flow, channels: Raster | ArrayLike, *, edges: Edges | None = None, nodata: NoData | None = None
) -> Raster:
    """Return the height above the nearest drainage: above the first channel cell down each course [Nobre2011].

    Args:
        surface: A terrain, filled or carved, a raster of such heights, or its flow.
        channels: (rows, columns) True, or not 0, in the cells that are channel.
        edges: As in :func:`drainage_area`.
        nodata: As in :func:`drainage_area`.

    Returns:
        Raster in m, on the surface's device; 0 in channels, NaN where no channel follows or there is no data.
    """
    flow = _flow(surface, edges, nodata)
    receiver = flow.host_receiver
    channel = checked_cells(channels, flow.terrain, "channels").astype(bool) & (receiver >= 0)
    height = _host_height(flow.terrain)
    base = np.where(channel, height, np.nan)
    inputs = [flat(receiver), flat(flow.order), flat(channel.view(np.uint8))]
    launch_kernel(kernels.build(wp.float64).carry_upstream, 1, inputs, [flat(base)], device="cpu")
    return flow.terrain.raster.like(table(height - base), unit="m", name="height_above_drainage")


def _shared_cells(terrain: Terrain, exponent: float, edges: Edges, nodata: NoData) -> np.ndarray:
    """Cells that drain through each cell by multiple flow, as fractions."""
    kernel = kernels.build(wp.float64)
    cells = pad_terrain(terrain, edges, nodata, MFD_BYTES)
    height, state = flat(cells.height), flat(cells.state)
    gathered = np.ones(cells.count)
    donors: DeviceArray = wp.full(cells.count, 255, dtype=wp.uint8, device="cpu")
    ground = [cells.rows, cells.stride]
    launch_kernel(kernel.count_contributors, cells.rows, [cells.stride, height, state], [donors], device="cpu")
    stack: DeviceArray = wp.empty(cells.count, dtype=int, device="cpu")
    outputs = [flat(gathered), donors, stack]
    launch_kernel(kernel.share_downhill, 1, [*ground, exponent, height, state], outputs, device="cpu")
    area = cells.interior(gathered)
    area[np.isnan(cells.height[1:-1, 1:-1])] = np.nan
    return area


def _flow(surface: Surface | Flow, edges: Edges | None, nodata: NoData | None) -> Flow:
    """Route a terrain, or pass a flow on."""
    terrain, edges, nodata = _surface(surface, edges, nodata)
    return surface if isinstance(surface, Flow) else route(terrain, edges=edges, nodata=nodata)


def _surface(surface: Surface | Flow, edges: Edges | None, nodata: NoData | None) -> tuple[Terrain, Edges, NoData]:
    """Terrain and rules of either."""
    if isinstance(surface, Flow):
        if edges is not None or nodata is not None:
            raise InputError("a Flow has its edges and nodata already; leave them out, or give the terrain")
        return surface.terrain, surface.edges, surface.nodata
    return surface_of(surface), "open" if edges is None else edges, "outlet" if nodata is None else nodata


def checked_areas(area: Raster | ArrayLike, flow: Flow) -> np.ndarray:
    """Return drainage areas as float64 on the host, or raise ``ValueError`` where they are not one a cell."""
    return checked_cells(area, flow.terrain, "area").astype(np.float64, copy=False)


def checked_cells(values: Raster | ArrayLike, terrain: Terrain, name: str) -> np.ndarray:
    """Return one value a cell on the host, from an array or a raster on the terrain's cells; else ``ValueError``."""
    if isinstance(values, Raster):
        if not values.matches(terrain):
            raise InputError(f"{name} lies on other cells than the terrain: {values!r} beside {terrain!r}")
        cells: np.ndarray = values.values.numpy()
        return cells
    array = np.asarray(values)
    if array.shape != terrain.shape:
        raise InputError(f"{name} has shape {array.shape}; the terrain has {terrain.shape}")
    return array


def _host_height(terrain: Terrain) -> np.ndarray:
    """Heights on the host, without a copy where they are there."""
    return np.ascontiguousarray(terrain.height.numpy())


def _power_of_metres(exponent: float) -> str:
    """Unit m^exponent as text."""
    if exponent in (0.0, 1.0):
        return "m" if exponent else ""
    return f"m{exponent:.0f}" if exponent == int(exponent) and exponent > 0.0 else f"m^{exponent:g}"
