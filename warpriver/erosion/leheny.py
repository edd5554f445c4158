"""Leheny's erosion: rain carves river networks into any height field, by events, in batches, or many grids at once.

Each event is a unit of rain on a random cell. It walks downhill by chance, takes a constant depth off every cell of its
way, and where neighbours then differ by too much, the taller one slides down. Material is not conserved: what is gone
is counted. The model makes networks, not landscapes of a real age: it has no time and no metres of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver import progress as progress_bar
from warpriver.arrays import CellArray, DeviceArray, FlagArray, FloatArray
from warpriver.device import PRECISIONS, launch_kernel, require_memory, resolve_device
from warpriver.erosion.eroded import ErodedTerrain
from warpriver.errors import InputError, InternalError
from warpriver.extras import IMPORTING
from warpriver.hydrology.cells import Edges, NoData, PaddedCells, pad_terrain, side_rules
from warpriver.kernels import leheny as kernels
from warpriver.params import LehenyParams
from warpriver.public import public
from warpriver.terrain import Terrain
from warpriver.validate import MAX_SEED, finite_numbers, one_of, whole

__all__ = ["erode", "erode_ensemble"]


# Heights are whole numbers of quanta, of which the depth D has 2^24 to 2^25 (float32: 2^6 to 2^7); so many fit exactly.
QUANTUM_BITS = {"float64": 24, "float32": 6}
EXACT_BITS = {"float64": 52, "float32": 23}
# Events between two looks at the host: they set how often progress is told and an interrupt is heard.
SEGMENT = 2000
# Cells of a row whose marks make a word.
WORD = 64
# Bytes a cell of a grid: height, stack and mark, and their copies; filling adds the graph of neighbours.
GRID_BYTES, FILL_BYTES = 45, 300
# Filled ground falls by this fraction of D per cell, which is enough to survive any number of events.
MIN_FALL = 2.0**-6
# Neighbours south and east of a cell, of which every pair has one.
PAIR_NEIGHBORS = (2, 3, 4, 5)
STEPS = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))


@public
def erode(
    terrain: Terrain,
    params: LehenyParams | None = None,
    *,
    events: int = 10_000,
    seed: int = 0,
    edges: Edges | None = None,
    nodata: NoData | None = None,
    batch: int = 1,
    fill: bool = False,
    base_level: float | None = None,
    record_every: int | None = None,
    dtype: str = "float64",
    progress: bool = False,
) -> ErodedTerrain:
    """Erode a terrain by rain that walks downhill at random [Leheny1995].

    An event: a unit of rain falls on a random cell and goes on to a lower neighbour i with the probability
    p_i = exp(E (h - h_i)) / N, where N sums over the lower neighbours, until it has reached an outlet. Every cell of
    its way, the outlet included, is lowered by D. Then, while two neighbours differ by more than M, the taller one
    loses a quarter of the difference. No pit comes up by this, and water never goes uphill.

    The model has no base level of its own: outlets sink without limit, and the ground behind them follows. With
    ``base_level`` no cell sinks below that height, and on its way to an outlet water lowers no cell to the height of
    the next one: rivers are graded to the base level, by a quantum a cell where it has been reached.

    **Serial** (``batch=1``): one event after another, to the letter. Slides are dealt with from the last cell of the
    way upwards; around a cell, clockwise from the north. That is work for one thread, so it runs on the CPU wherever
    the terrain lies, and gives the same bits for each.

    **Batched** (``batch`` of B): B units of rain walk over the same heights at a time; then all that they take is taken
    away, and then slides come to rest. Two rules keep the result independent of the order of threads, and pits away:

    - In one batch all water that leaves a cell goes to the same neighbour, drawn with the p_i above. So each unit alone
      walks as in the serial mode, but units that meet stay together, and the cell that they move to is lowered at least
      as much as the one that they come from. (If they separated, a cell could sink below all its neighbours.)
    - Slides come down sweep by sweep: all pairs of neighbours that differ by more than M are noted, and go to rest in
      eight groups (east, south-east, south, south-west; even and odd), in none of which a cell is twice.

    Heights are kept as whole multiples of a quantum, 2^-25 to 2^-24 of D (float32: 2^-7 to 2^-6), to which the start
    and D are rounded and a slide is rounded down. All sums are then exact, and the same in any order.
    A start with slopes above the sliding threshold first slides by the rule of the batches.

    Same input, seed, batch and dtype give the same bits, on any schedule of records. Eroding the result on with the
    same seed gives what one run over all events gives, if ``batch`` divides the events of the first.

    Args:
        terrain: The start; it is not changed.
        params: E, D, M and the number of neighbours; by default those of an ErodedTerrain, or ``LehenyParams()``.
        events: Units of rain, 0 or more.
        seed: Of all that is random; 0 or more.
        edges: What the four sides are: "open" (water leaves at their cells), "closed" (a wall) or "periodic" (joined to
            the opposite side): one word, four in the order north, south, east, west, or a mapping by those names. By
            default those of an ErodedTerrain, else "open".
        nodata: Cells without data are an "outlet" for their neighbours, or a "wall"; by default those of an
            ErodedTerrain, else "outlet".
        batch: Units of rain that walk at a time; with 1 the CPU does the work, else the terrain's device.
        fill: Raise ground from which water cannot leave until it can, with a minimum slope towards its outlet.
        base_level: Height in m that no cell is lowered below, such as that of the sea; by default that of an
            ErodedTerrain, else there is none.
        record_every: Events between snapshots, which the start and the end belong to; None for none. In batches they
            are taken at the end of the batch.
        dtype: Precision in which heights are eroded, "float64" or "float32".
        progress: Show a progress bar.

    Returns:
        The eroded terrain, on the device of the start.

    Raises:
        ValueError: A number out of range, an unknown edge rule, no way out (no open side and no outlet within), cells
            that water cannot leave (pits and level ground, without ``fill``), or more events than the precision holds.
        MemoryError: There is no room, told before anything is allocated.
    """
    batch = whole(batch, "batch", 1)
    # A GPU has nothing to offer to a single thread.
    where = "cpu" if batch == 1 else None
    run = _Run(terrain, params, events, [seed], edges, nodata, fill, dtype, base_level=base_level, device=where)
    stops = _stops(run.first, run.first + run.events, record_every, batch)
    snapshots = [run.result(0)] if record_every is not None else []
    advance = run.rain_serially if batch == 1 else lambda stop: run.rain_in_batches(stop, batch)
    with progress_bar.bar("events", run.events, show=progress) as tell:
        for stop, is_record in stops:
            tell(advance(stop))
            if is_record:
                snapshots.append(run.result(0))
    eroded = run.result(0)
    eroded.snapshots = tuple(snapshots)
    return eroded


@public
def erode_ensemble(
    terrain: Terrain | Sequence[Terrain],
    params: LehenyParams | None = None,
    *,
    events: int = 10_000,
    seeds: Sequence[int] = range(64),
    edges: Edges | None = None,
    nodata: NoData | None = None,
    fill: bool = False,
    base_level: float | None = None,
    dtype: str = "float64",
    progress: bool = False,
) -> list[ErodedTerrain]:
    """Erode many grids at once on their device, each by a thread of its own and one event after another.

    Each result is that of ``erode(terrain, ..., seed=seed)``: on the CPU to the bit; a GPU rounds exponentials in its
    own way, which may send a walk elsewhere where a random number falls between the two.

    Args:
        terrain: The start of all, or one for each seed: all of one shape, cell size and device, with the same cells
            without data.
        params: As in :func:`erode`.
        events: Units of rain on each grid.
        seeds: One for each grid.
        edges: As in :func:`erode`.
        nodata: As in :func:`erode`.
        fill: As in :func:`erode`.
        base_level: As in :func:`erode`.
        dtype: As in :func:`erode`.
        progress: Show a progress bar.

    Returns:
        The eroded terrains, in the order of the seeds.

    Raises:
        ValueError: As :func:`erode`; no seed, or starts that do not fit together.
        MemoryError: There is no room, told before anything is allocated.
    """
    run = _Run(terrain, params, events, list(seeds), edges, nodata, fill, dtype, base_level=base_level)
    with progress_bar.bar("events", run.events, show=progress) as tell:
        for stop, _ in _stops(run.first, run.first + run.events, None, 1):
            tell(run.rain_serially(stop))
    return [run.result(k) for k in range(len(run.seeds))]


class _Run:
    """Grids under the rain: what is checked and made once, and the arrays that the kernels work on.

    Attributes:
        terrains: The starts, one for each grid, or one for all.
        first: Events that they have seen already.
        events: Events to come.
        seeds: One for each grid.
        done: Events that the grids have seen now.
        device: Where the grids lie while it rains; results go to the device of the starts.
        constants: Argument struct of the kernels.
        height: (grids * cells,) heights on the device.
    """

    def __init__(
        self,
        terrain: Terrain | Sequence[Terrain],
        params: LehenyParams | None,
        events: int,
        seeds: list[int],
        edges: Edges | None,
        nodata: NoData | None,
        fill: bool,
        dtype: str,
        *,
        base_level: float | None = None,
        device: Any = None,
    ):
        self.terrains: list[Terrain] = list(terrain) if isinstance(terrain, (list, tuple)) else [terrain]  # type: ignore
        self.seeds = [whole(seed, "seed", maximum=MAX_SEED) for seed in seeds]
        self.events = whole(events, "events", 0)
        self.cell_state = np.zeros(0, np.uint8)
        self.first_height = np.zeros(0)
        one_of(dtype, "dtype", tuple(PRECISIONS))
        start = _common_start(self.terrains, len(self.seeds))
        known = start if isinstance(start, ErodedTerrain) else None
        self.params = params if params is not None else known.params if known else LehenyParams()
        self.rules = side_rules(edges if edges is not None else known.edges if known else "open")
        self.nodata: NoData = nodata if nodata is not None else known.nodata if known else "outlet"
        self.base_level = base_level if base_level is not None else known.base_level if known else None
        if self.base_level is not None:
            (self.base_level,) = finite_numbers([self.base_level], 1, "base_level")
        self.first = self.done = known.events if known else 0
        self.device, self.dtype = resolve_device(start.device if device is None else device), dtype
        if self.first + self.events >= 2**31:
            raise InputError(f"events would come to {self.first + self.events}; 2^31 is the limit")
        require_memory((start.shape[0] * len(self.seeds), start.shape[1]), GRID_BYTES, self.device, "erosion")
        if fill:
            require_memory(start.shape, FILL_BYTES, "cpu", "filling")
        self._make_constants(start)
        self._make_grids(fill)

    def _make_constants(self, start: Terrain) -> None:
        """Choose the quantum and set the constants."""
        params, (scalar, _, real) = self.params, PRECISIONS[self.dtype]
        quantum = 2.0 ** (math.frexp(params.depth)[1] - 1 - QUANTUM_BITS[self.dtype])
        if params.slide_threshold < 4.0 * quantum:
            raise InputError(
                f"LehenyParams.slide_threshold is {params.slide_threshold:g} m, nothing beside the depth of an event, "
                f"{params.depth:g} m; give more than that depth"
            )
        self.kernel = kernels.build(scalar)
        constants = self.kernel.Constants()
        constants.rows, constants.columns = start.shape
        constants.wraps_rows, constants.wraps_columns = (
            int(self.rules[side] == "periodic") for side in ("north", "east")
        )
        constants.four = int(params.neighbors == 4)
        constants.quantum, constants.bias, constants.threshold = quantum, params.flow_bias, params.slide_threshold
        constants.depth = round(params.depth / quantum) * quantum
        constants.base = -math.inf if self.base_level is None else round(self.base_level / quantum) * quantum
        self.constants, self.quantum, self.depth, self.real, self.scalar = (
            constants,
            quantum,
            float(constants.depth),
            real,
            scalar,
        )

    def _make_grids(self, fill: bool) -> None:
        """Check the starts, bring them to rest and lay them out."""
        heights = [self._checked_height(terrain, fill) for terrain in self.terrains]
        ground = np.flatnonzero(np.isfinite(heights[0])).astype(np.int32)
        self.ground: DeviceArray = wp.array(ground, dtype=int, device=self.device)
        self.state: DeviceArray = wp.array(self.cell_state.reshape(-1), dtype=wp.uint8, device=self.device)
        self.cells, grids = heights[0].size, len(self.seeds)
        if self.cells * grids >= 2**31:
            raise InputError(f"{grids} grids have {self.cells * grids} cells; 2^31 is the limit, do fewer at a time")
        self.tally: DeviceArray = wp.zeros(3 * grids, dtype=wp.int64, device=self.device)
        self.height: DeviceArray = wp.empty(grids * self.cells, dtype=self.scalar, device=self.device)
        self.marks = [_HostedArray(self.words, wp.uint64, self.device) for _ in range(2)]
        self.beside = _HostedArray(self.words, wp.uint64, self.device)
        self.listed = _HostedArray(self.words, wp.int32, self.device)
        self.steep = wp.zeros((len(PAIR_NEIGHBORS), self.words), dtype=wp.uint64, device=self.device)
        slides = np.zeros(len(heights), np.int64)
        for g, height in enumerate(heights):
            grid = self.height[g * self.cells : (g + 1) * self.cells]
            grid.assign(height.astype(self.real).reshape(-1))
            before = int(self.tally.numpy()[1])
            self.marks[0].array.fill_(2**WORD - 1)
            self._rest(grid)
            slides[g] = int(self.tally.numpy()[1]) - before
        for g in range(len(heights), grids):
            wp.copy(self.height, self.height, g * self.cells, 0, self.cells)
        self.tally.zero_()
        self.start_slides = np.broadcast_to(slides, grids)
        self.start_height = heights
        pairs = np.array([np.random.SeedSequence(seed).generate_state(2) >> 1 for seed in self.seeds], np.int32)
        self.grid_seed: DeviceArray = wp.array(pairs[:, 0].copy(), dtype=int, device=self.device)
        self.rain_seed, self.turn_seed = (int(v) for v in pairs[0])
        self.scratch: dict[str, DeviceArray] = {}

    def _checked_height(self, terrain: Terrain, fill: bool) -> FloatArray:
        """Heights in whole quanta that water can leave everywhere, (rows, columns); sets the states of the cells."""
        gaps = bool(np.isnan(terrain.height.numpy()).any())
        if "open" not in self.rules.values() and not (gaps and self.nodata == "outlet"):
            raise InputError("edges: no side is open, so that water has nowhere to go; open a side")
        padded = pad_terrain(terrain, self.rules, self.nodata, 0)  # type: ignore[arg-type]
        np.copyto(padded.height, np.rint(padded.height / self.quantum) * self.quantum)
        state, outlet = padded.interior(padded.state), padded.outlets()
        height = padded.interior(padded.height)
        min_fall = max(self.quantum, round(MIN_FALL * self.depth / self.quantum) * self.quantum)
        lowest = max(float(np.nanmin(height)) - self.depth * self.events, float(self.constants.base))
        if fill:
            height = self._filled(height, outlet, min_fall)
        else:
            self._refuse_pits(padded, height, outlet)
        largest = max(abs(lowest), abs(float(np.nanmax(height))))
        if largest > self.quantum * 2.0 ** EXACT_BITS[self.dtype]:
            hint = "; use float64" if self.dtype == "float32" else ""
            raise InputError(
                f"{self.events} events may dig down to {lowest:g} m, which {self.dtype} does not hold to "
                f"{self.quantum:g} m, the smallest step beside a depth of {self.depth:g} m; give fewer events or a "
                f"larger depth{hint}"
            )
        if self.cell_state.size and not (
            np.array_equal(self.cell_state, state) and np.array_equal(np.isnan(height), np.isnan(self.first_height))
        ):
            raise InputError("the starts differ in which cells have no data; give starts with the same ones")
        self.cell_state, self.first_height = state, height
        return height

    def _refuse_pits(self, padded: PaddedCells, height: FloatArray, outlet: FlagArray) -> None:
        """Raise ``ValueError`` if rain could not leave some cell."""
        lowest = np.full(height.shape, np.inf)
        for row, column in STEPS[:: 2 if self.constants.four else 1]:
            beside = padded.height[1 + row : padded.rows + 1 + row, 1 + column : padded.columns + 1 + column]
            lowest = np.fmin(lowest, beside)
        stuck = np.isfinite(height) & ~outlet & ~(lowest < height)
        if stuck.any():
            row, column = (int(v[0]) for v in np.nonzero(stuck))
            level = " the ground is level, it needs a slope;" if np.nanmax(height) == np.nanmin(height) else ""
            raise InputError(
                f"{np.count_nonzero(stuck)} of {stuck.size} cells have no lower neighbour, the first in row {row}, "
                f"column {column}:{level} rain would never leave; raise them with fill=True or open a side (edges)"
            )

    def _filled(self, height: FloatArray, outlet: FlagArray, min_fall: float) -> FloatArray:
        """Raise heights so that each cell lies ``min_fall`` above the next one on its way out with the lowest pass."""
        below, order = _ways_out(height, outlet, self.rules, bool(self.constants.four))
        if len(order) < np.count_nonzero(np.isfinite(height)):
            raise InputError("some ground is joined to the rest across corners only; use 8 neighbours")
        array: DeviceArray = wp.array(height.reshape(-1), dtype=wp.float64, device="cpu")
        kernel = kernels.build(wp.float64)
        inputs: list[DeviceArray] = [wp.array(a, dtype=int, device="cpu") for a in (below, order)]
        launch_kernel(kernel.raise_courses, 1, [kernel.Constants(), min_fall, *inputs], [array], device="cpu")
        filled: FloatArray = array.numpy().reshape(height.shape).copy()
        return filled

    @property
    def words(self) -> int:
        """Words of marks of a grid."""
        return int(self.constants.rows) * -(-int(self.constants.columns) // WORD)

    def rain_serially(self, stop: int) -> int:
        """Do all events before ``stop`` on every grid; returns how many."""
        count, grids = stop - self.done, len(self.seeds)
        if count:
            stack, waiting = self._array("stack", int, grids), self._array("waiting", wp.uint8, grids)
            events = self.kernel.Events()
            events.first, events.count, events.seed = self.done, count, self.grid_seed
            inputs = [self.constants, events, self.ground, self.state]
            outputs = [self.height, stack, waiting, self.tally]
            launch_kernel(self.kernel.erode_serially, grids, inputs, outputs, device=self.device)
        self.done = stop
        return count

    def rain_in_batches(self, stop: int, batch: int) -> int:
        """Do all events before ``stop``, in batches that begin at multiples of their size; returns how many."""
        begin = self.done
        below, visits = self._array("below", int, 1, -1), self._array("visits", int, 1)
        rows, columns = self.constants.rows, self.constants.columns
        lowered = self.marks[0].array
        chunk = WORD if self.device.is_cpu else 1
        tables = [a.reshape((rows, columns)) for a in (self.height, visits, below)]
        while self.done < stop:
            number = self.done // batch
            count = min((number + 1) * batch, stop) - self.done
            turn = int(np.random.SeedSequence((self.turn_seed, number)).generate_state(1)[0] >> 1)
            walks = self.kernel.Walks()
            walks.first, walks.seed, walks.turn_seed = self.done, self.rain_seed, turn
            inputs = [self.constants, walks, self.ground, self.state, self.height]
            launch_kernel(self.kernel.walk_together, count, inputs, [below, visits, self.tally], device=self.device)
            graded = self._graded(visits, below) if self.base_level is not None else None
            lowered.zero_()
            dim, inputs = (rows, -(-columns // chunk)), [self.constants, chunk]
            launch_kernel(self.kernel.lower_visited, dim, inputs, [*tables, lowered], device=self.device)
            if graded is not None:
                launch_kernel(self.kernel.raise_graded, self.cells, [graded], [self.height], device=self.device)
            self._rest(self.height)
            self.done += count
        return self.done - begin

    def _graded(self, visits: DeviceArray, below: DeviceArray) -> DeviceArray:
        """Heights after a batch whose ways are graded to the base level."""
        one, two = ([self._array(f"graded {k}", self.scalar, 1), self._array(f"ahead {k}", int, 1)] for k in (1, 2))
        inputs = [self.constants, self.state, self.height, visits, below]
        launch_kernel(self.kernel.begin_grading, self.cells, inputs, one, device=self.device)
        # Far enough for a way through all cells.
        for k in range(self.cells.bit_length()):
            rise = self.scalar(self.quantum * 2.0**k)
            launch_kernel(self.kernel.double_grading, self.cells, [rise, *one], two, device=self.device)
            one, two = two, one
        return one[0]

    def _rest(self, height: DeviceArray) -> None:
        """Let pairs slide, sweep by sweep, until there is rest; only the cells in ``marks[0]`` have been lowered."""
        rows, columns = self.constants.rows, self.constants.columns
        odd = (rows % 2 and self.constants.wraps_rows) or (columns % 2 and self.constants.wraps_columns)
        chunk = WORD if self.device.is_cpu else 1
        listed, beside, steep = self.listed.array, self.beside.array, self.steep
        lowered, slid = self.marks
        every = []
        for k in PAIR_NEIGHBORS[:: 2 if self.constants.four else 1]:
            for color in range(3 if odd else 2):
                pairs = self.kernel.Pairs()
                pairs.k, pairs.color, pairs.chunk = k, color, chunk
                every.append(pairs)
        while words := self._list_beside(lowered):
            dim, inputs = (words, WORD // chunk), [self.constants, chunk, listed, beside, height]
            steep.zero_()
            launch_kernel(self.kernel.mark_steep, dim, inputs, [steep], device=self.device)
            slid.array.zero_()
            for pairs in every:
                inputs, outputs = [self.constants, pairs, listed, steep], [height, slid.array, self.tally]
                launch_kernel(self.kernel.slide_pairs, dim, inputs, outputs, device=self.device)
            lowered, slid = slid, lowered

    def _list_beside(self, marks: _HostedArray) -> int:
        """Mark the cells from which pairs may reach into marked ones, and list the words that have some; their count.

        The host does that: sweeps soon have few words left, and it has to look at each one whether there is rest.
        """
        wraps = bool(self.constants.wraps_rows), bool(self.constants.wraps_columns)
        found = marks_beside(marks.fetched(), (int(self.constants.rows), int(self.constants.columns)), wraps)
        words = np.flatnonzero(found)
        if len(words):
            self.beside.send(found)
            self.listed.send(words)
        return len(words)

    def _array(self, name: str, kind: Any, grids: int, value: int = 0) -> DeviceArray:
        """Scratch of one value a cell and grid, made on first use."""
        if name not in self.scratch:
            self.scratch[name] = wp.full(grids * self.cells, value, dtype=kind, device=self.device)
        return self.scratch[name]

    def result(self, grid: int) -> ErodedTerrain:
        """The terrain of a grid now, with its account; raises RuntimeError where water went nowhere."""
        start = self.terrains[grid if len(self.terrains) > 1 else 0]
        before = self.start_height[grid if len(self.terrains) > 1 else 0]
        values = self.height[grid * self.cells : (grid + 1) * self.cells].numpy().astype(np.float64)
        height = values.reshape(before.shape)
        visits, slides, stuck = (int(v) for v in self.tally.numpy()[3 * grid : 3 * grid + 3])
        if stuck:
            raise InternalError(f"{stuck} walks ended in a pit, which cannot be: please report this with the input")
        removed = float(np.nansum(before - height)) * start.cell_size**2
        slides += int(self.start_slides[grid])
        earlier = start.account if isinstance(start, ErodedTerrain) else (0, 0, 0, 0.0)
        account = self.done, visits + earlier[1], slides + earlier[2], removed + earlier[3]
        array: DeviceArray = wp.array(height, dtype=wp.float64, device=start.device)
        return ErodedTerrain.with_account(
            start, array, self.rules, self.nodata, self.params, account, base_level=self.base_level
        )


class _HostedArray:
    """An array on a device that the host reads and writes in turns, without any new allocation.

    On the CPU the host looks at the array itself; for a GPU it has a copy in pinned memory.
    """

    def __init__(self, count: int, kind: Any, device: Any):
        self.array: DeviceArray = wp.zeros(count, dtype=kind, device=device)
        self._copy = self.array
        if not device.is_cpu:
            self._copy = wp.zeros(count, dtype=kind, device="cpu", pinned=True)
        self._values: np.ndarray = self._copy.numpy()

    def fetched(self) -> np.ndarray:
        """Values now, once all that was launched before has been done; they hold until the next call."""
        if self._copy is not self.array:
            wp.copy(self._copy, self.array)
            wp.synchronize_stream(self.array.device)
        return self._values

    def send(self, values: np.ndarray) -> None:
        """Set the first values; what was sent before must have arrived, as it has when anything was fetched since."""
        self._values[: len(values)] = values
        if self._copy is not self.array:
            wp.copy(self.array, self._copy, count=len(values))


def marks_beside(marks: NDArray[np.uint64], shape: tuple[int, int], wraps: tuple[bool, bool]) -> NDArray[np.uint64]:
    """Marks of marked cells, and of those to whose east, south-east, south or south-west one lies.

    Args:
        marks: (rows * words,) a bit for each cell of a row, the lowest for the first; bits beyond its end are ignored.
        shape: Rows and columns.
        wraps: Whether the north and south sides, and the east and west ones, are joined.

    Returns:
        (rows * words,) uint64.
    """
    rows, columns = shape
    table = marks.reshape(rows, -1)
    one, carry, last = np.uint64(1), np.uint64(WORD - 1), np.uint64((columns - 1) % WORD)
    end = np.uint64(2 ** (int(last) + 1) - 1)
    # Sweeps soon have few rows left.
    row = np.flatnonzero(table.any(axis=1))
    word = table[row]
    word[:, -1] &= end
    # A bit where there is a mark to the east of a cell, and where there is one to the west.
    east, west = word >> one, word << one
    east[:, :-1] |= word[:, 1:] << carry
    west[:, 1:] |= word[:, :-1] >> carry
    if wraps[1]:
        east[:, -1] |= (word[:, 0] & one) << last
        west[:, 0] |= word[:, -1] >> last
    beside = np.zeros_like(table)
    beside[row] = word | east
    above = slice(None) if wraps[0] or not len(row) or row[0] > 0 else slice(1, None)
    beside[row[above] - 1] |= (word | east | west)[above]
    beside[:, -1] &= end
    return beside.reshape(-1)


def _stops(first: int, last: int, every: int | None, batch: int) -> list[tuple[int, bool]]:
    """Numbers of events at which to stop, and whether to record there; on ends of batches, or the last."""
    records = set()
    if every is not None:
        every = whole(every, "record_every", 1)
        records = {min(last, -(-stop // batch) * batch) for stop in range(first + every, last + 1, every)}
        if last > first:
            records.add(last)
    segment = max(SEGMENT, batch) // batch * batch
    looks = set(range((first // segment + 1) * segment, last, segment)) | {last}
    return [(stop, stop in records) for stop in sorted(records | looks)]


def _ways_out(
    height: FloatArray, outlet: FlagArray, rules: Mapping[str, str], four: bool
) -> tuple[CellArray, CellArray]:
    """Next cell on each cell's way out over the lowest pass (-1 at outlets), and an order from the outlets up.

    The ways are those of a minimum spanning tree of the cells and a sea behind the outlets, whose edges weigh as much
    as their higher end is high: in such a tree every way goes over the lowest pass there is.
    """
    with IMPORTING:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    cells = height.size
    index = np.arange(cells, dtype=np.int32).reshape(height.shape)
    wraps = rules["north"] == "periodic", rules["east"] == "periodic"
    tails, heads = [], []
    for k in PAIR_NEIGHBORS[:: 2 if four else 1]:
        row, column = STEPS[k]
        beside = np.roll(index, (-row, -column), (0, 1))
        valid = np.isfinite(height) & np.isfinite(np.roll(height, (-row, -column), (0, 1)))
        if row and not wraps[0]:
            valid[-1] = False
        if column and not wraps[1]:
            valid[:, -1 if column > 0 else 0] = False
        tails.append(index[valid])
        heads.append(beside[valid])
    coast = index[outlet]
    tails.append(np.full(len(coast), cells, np.int32))
    heads.append(coast)
    tail, head = np.concatenate(tails), np.concatenate(heads)
    flat = np.append(height.reshape(-1), -np.inf)
    # Ranks instead of heights: they are above 0, as weights must be.
    weight = 1.0 + np.unique(np.maximum(flat[tail], flat[head]), return_inverse=True)[1]
    # A cell may be its neighbour's neighbour twice where a side of two cells wraps: equal weights do no harm.
    pair, first = np.unique(
        np.minimum(tail, head).astype(np.int64) * (cells + 1) + np.maximum(tail, head), return_index=True
    )
    graph = coo_array((weight[first], np.divmod(pair, cells + 1)), shape=(cells + 1, cells + 1)).tocsr()
    order, below = breadth_first_order(minimum_spanning_tree(graph), cells, directed=False)
    below = np.where(below == cells, -1, below).astype(np.int32)[:-1]
    return below, order[1:].astype(np.int32)


def _common_start(terrains: Sequence[Terrain], grids: int) -> Terrain:
    """First of the starts, or ``ValueError`` if they do not fit together."""
    if grids == 0:
        raise InputError("seeds is empty; give one for each grid")
    for terrain in terrains:
        if not isinstance(terrain, Terrain):
            raise InputError(
                f"terrain is a {type(terrain).__name__}; give a Terrain, such as warpriver.Terrain(height, 1)"
            )
    if len(terrains) not in (1, grids):
        raise InputError(f"there are {len(terrains)} starts for {grids} seeds; give one, or one for each")
    first = terrains[0]
    for terrain in terrains:
        same = terrain.shape == first.shape and terrain.cell_size == first.cell_size
        if not same or terrain.device != first.device or getattr(terrain, "events", 0) != getattr(first, "events", 0):
            raise InputError("the starts differ in shape, cell size, device or events; give starts that are alike")
    return first
