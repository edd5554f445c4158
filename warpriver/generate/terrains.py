"""Synthetic terrains: exact forms, fractal noise, land that rivers drain, a basin among mountains and a mountain front.

Their south-west corner lies at (0, 0). Those that draw random numbers take a seed: the same seed gives the same land.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray, FlagArray, FloatArray
from warpriver.device import launch_kernel, require_memory, start_warp
from warpriver.errors import InputError, MissingExtraError
from warpriver.extras import IMPORTING
from warpriver.kernels import terrains as kernels
from warpriver.public import public
from warpriver.terrain import Terrain, square_cells
from warpriver.validate import MAX_SEED, finite, grid_shape, not_negative, positive, seeded, whole

__all__ = [
    "cone",
    "fluvial_terrain",
    "fractal_terrain",
    "intermontane_basin",
    "mountain_front",
    "mountain_front_line",
    "mountain_front_zones",
    "read_sample_dem",
    "tilted_plain",
]


# Octaves down to this many cells a wavelength; the longest wavelength is this fraction of the longer side.
FINEST, LONGEST = 2.5, 0.5
# Drained land: exponent of area, area of a slope without a channel in m2, and its slope.
CONCAVITY, HILLSLOPE, STEEPEST = 0.45, 3.0e4, 0.65
# Rounds in which divides move, and the fraction of the way to the steady state that each covers. How much the first
# paths avoid cells at random, by single cells and by stretches; how much resistance to erosion varies; wavelength of
# both, m.
ROUNDS, STRIDE, SCATTER, STRETCHES, RESISTANCE, PATCH = 40, 0.5, 0.8, 2.0, 0.35, 4000.0
# Bytes a cell while land is drained: the graph of paths over eight neighbours.
DRAINED_BYTES = 450

# The mountain front, m: extent; where the plain ends, and where the valley begins; widths of the valley's floor.
FRONT_SIZE = (35_000.0, 20_000.0)
FRONT_FOOT, FRONT_TOP = 19_000.0, 21_000.0
PLAIN_SLOPE, FRONT_SLOPE, VALLEY_SLOPE = 1.0e-3, 0.2, 4.0e-3
# Cells that still show the canyon, m.
COARSEST = 250.0
# Length over which the slope along the river changes at the foot and the top; half-widths of canyon and valley floor.
FRONT_BEND, CANYON, VALLEY = 400.0, 150.0, 700.0

# The basin among mountains, m: extent; half of the plain's width in the west, the x from which it narrows and where
# only the valley of its river is left; half of that valley's width, and the x of its head.
BASIN_SIZE = (40_000.0, 26_000.0)
BASIN_HALF, BASIN_FROM, BASIN_TO = 8_500.0, 4_000.0, 32_000.0
BASIN_VALLEY, BASIN_HEAD = 350.0, 30_000.0
# How far the mountains' foot comes forward and steps back, m. Slopes of the plain: down it, and towards its river.
# Height of the fans at that foot and the length over which they fade; unevenness of the plain, m.
BASIN_BAYS, BASIN_SLOPE, BASIN_CROSS = 2_500.0, 6.0e-4, 8.0e-4
FAN_HEIGHT, FAN_LENGTH, BASIN_UNEVEN = 14.0, 1_800.0, 4.0
# Hillslopes are rounded over so many cells: land in strict balance has knife edges.
ROUNDING = 0.6
BASIN_COARSEST = 400.0

# Meridian arc and parallel of the WGS 84 ellipsoid.
EQUATOR, FLATNESS = 6378137.0, 0.0066943799901413165


@public
def tilted_plain(
    shape: Sequence[int], cell_size: float, slope: float, direction: float = 0.0, *, device: wp.DeviceLike = "cpu"
) -> Terrain:
    """Plane that falls in one direction; its lowest cell is at 0 m.

    Args:
        shape: Rows and columns.
        cell_size: m.
        slope: m/m, 0 or more.
        direction: Direction of the fall, rad from +x (east) to the left: pi/2 falls north.
        device: Warp device name.
    """
    x, y = _centers(shape, cell_size)
    angle = finite(direction, "direction", "rad")
    height = -not_negative(slope, "slope") * (math.cos(angle) * x + math.sin(angle) * y)
    return _terrain(height - height.min(), cell_size, device)


@public
def cone(shape: Sequence[int], cell_size: float, slope: float, *, device: wp.DeviceLike = "cpu") -> Terrain:
    """Cone with its apex in the middle of the raster; the corners of the raster are at 0 m.

    Args:
        shape: Rows and columns.
        cell_size: m.
        slope: m/m, 0 or more.
        device: Warp device name.
    """
    x, y = _centers(shape, cell_size)
    middle = 0.5 * cell_size * shape[1], 0.5 * cell_size * shape[0]
    height = math.hypot(*middle) - np.hypot(x - middle[0], y - middle[1])
    return _terrain(not_negative(slope, "slope") * height, cell_size, device)


@public
def fractal_terrain(
    shape: Sequence[int],
    cell_size: float,
    relief: float,
    seed: int,
    roughness: float = 0.45,
    octaves: int | None = None,
    *,
    device: wp.DeviceLike = "cpu",
) -> Terrain:
    """Fractal noise: octaves of gradient noise, each of half the wavelength and ``roughness`` times the height.

    Land that nothing has drained yet: it is as rough in valleys as on ridges and full of pits. Where rivers should have
    been at work take :func:`fluvial_terrain`. Finer cells under the same extent and seed show the same land.

    Args:
        shape: Rows and columns.
        cell_size: m.
        relief: Highest less lowest height, m; the lowest is 0.
        seed: 0 or more.
        roughness: Height of an octave over that of the one before, above 0, up to 1; 0.35 is smooth, 0.5 craggy.
        octaves: Number of octaves; by default down to 2.5 cells a wavelength.
        device: Warp device name.
    """
    not_negative(relief, "relief")
    size = _checked(shape, cell_size)
    longest = LONGEST * max(size) * cell_size
    count = max(1, 1 + math.floor(math.log2(longest / (FINEST * cell_size)))) if octaves is None else octaves
    height = _noise(size, cell_size, longest, seed, roughness, count)
    height = (height - height.min()) * (relief / np.ptp(height))
    return _terrain(height, cell_size, device)


@public
def fluvial_terrain(
    shape: Sequence[int],
    cell_size: float,
    relief: float,
    seed: int,
    concavity: float = CONCAVITY,
    *,
    device: wp.DeviceLike = "cpu",
) -> Terrain:
    """Mountains in which every cell drains to the raster's edge: uplift and erosion by rivers in balance.

    The steady state of the stream power law: slope along the steepest descent = k / area^concavity, down to hillslopes
    of 3 ha whose slope is constant [Whipple1999]. Paths start as cheapest ones over random ground, and the divides
    then move until the slopes on both sides are alike. There are no pits. The edge lies at 0 m.

    Args:
        shape: Rows and columns; 2048 x 2048 takes a minute and 2 GB.
        cell_size: m.
        relief: Highest height, m.
        seed: 0 or more.
        concavity: Exponent of area, 0.3 to 0.6 in nature.
        device: Warp device name.
    """
    not_negative(relief, "relief")
    positive(concavity, "concavity")
    size = _checked(shape, cell_size, DRAINED_BYTES)
    if min(size) < 3:
        raise InputError(f"shape is {tuple(shape)}; give rows and columns, at least 3 of each: the edge is all sea.")
    base = np.ones(size, bool)
    base[1:-1, 1:-1] = False
    height = _drained(np.zeros(size), base, cell_size, seed, concavity)
    return _terrain(height * (relief / height.max()), cell_size, device)


@public
def intermontane_basin(
    cell_size: float = 100.0, seed: int = 0, *, relief: float = 1200.0, device: wp.DeviceLike = "cpu"
) -> Terrain:
    """Scene of 40 x 26 km: mountains on three sides of a plain that opens to the west, for a whole river network.

    The mountains are drained as in :func:`fluvial_terrain`, down to the plain. It falls west by 0.0006 and towards a
    winding axis by 0.0008, steepens on fans at the foot of the mountains, and is uneven by a few metres, so that rivers
    found on it wander, gather and leave as one. In the east it narrows to the valley in which the largest one comes.

    Args:
        cell_size: m, 400 or less.
        seed: 0 or more.
        relief: Height of the highest summit above the ground it would stand on, m.
        device: Warp device name.
    """
    with IMPORTING:
        from scipy.ndimage import distance_transform_edt, gaussian_filter

    if positive(cell_size, "cell_size") > BASIN_COARSEST:
        raise InputError(f"cell_size is {cell_size} m; give {BASIN_COARSEST:g} m or less, or the valleys are lost.")
    not_negative(relief, "relief")
    whole(seed, "seed", maximum=MAX_SEED)
    size = (round(BASIN_SIZE[1] / cell_size), round(BASIN_SIZE[0] / cell_size))
    size = _checked(size, cell_size, DRAINED_BYTES)
    x, y = _centers(size, cell_size)
    bay = BASIN_BAYS * _noise(size, cell_size, 9000.0, seed + 1, 0.5, 5)
    uneven = BASIN_UNEVEN * _noise(size, cell_size, 5000.0, seed + 2, 0.55, 6)
    off = np.abs(y - _basin_axis(x, seed))
    half = BASIN_HALF * (1.0 - _smoothstep((x - BASIN_FROM) / (BASIN_TO - BASIN_FROM)))
    plain = off < half + bay * np.minimum(1.0, half / 2000.0)
    plain |= (off < max(BASIN_VALLEY, cell_size)) & (x < BASIN_HEAD)
    rise = gaussian_filter(_drained(np.zeros(size), plain, cell_size, seed, CONCAVITY), ROUNDING)
    fan = FAN_HEIGHT * np.exp(-cell_size * distance_transform_edt(plain) / FAN_LENGTH)
    floor = BASIN_SLOPE * x + BASIN_CROSS * off + fan + uneven
    return _terrain(rise * (relief / rise.max()) + floor, cell_size, device)


@public
def mountain_front(cell_size: float = 50.0, seed: int = 0, *, device: wp.DeviceLike = "cpu") -> Terrain:
    """Scene of 35 x 20 km for a river in three stages, after [Paris2023, Fig. 27]; it flows west.

    ========== ============ ====================================================================================
    zone       x, km        ground under the river
    ========== ============ ====================================================================================
    valley     21 .. 35     a flat floor about 1.4 km wide with slope 0.004, and mountains 1 km higher
    front      19 .. 21     a canyon with slope 0.2: too steep for bends; so is the front beside it
    plain      0 .. 19      slope 0.001, with unevenness of a few decimetres
    ========== ============ ====================================================================================

    The mountains are drained as in :func:`fluvial_terrain`, into the valley and to the plain.
    :func:`mountain_front_line` gives a river that follows the zones, :func:`mountain_front_zones` their limits.

    Args:
        cell_size: m, 250 or less.
        seed: 0 or more.
        device: Warp device name.
    """
    if positive(cell_size, "cell_size") > COARSEST:
        raise InputError(f"cell_size is {cell_size} m; give {COARSEST} m or less, or the canyon is lost between cells.")
    whole(seed, "seed", maximum=MAX_SEED)
    size = (round(FRONT_SIZE[1] / cell_size), round(FRONT_SIZE[0] / cell_size))
    size = _checked(size, cell_size, DRAINED_BYTES)
    x, y = _centers(size, cell_size)
    base, floor = _front_base(x, y, cell_size, seed)
    height = _drained(floor, base, cell_size, seed, CONCAVITY)
    return _terrain(height, cell_size, device)


@public
def mountain_front_line(spacing: float = 50.0, seed: int = 0) -> FloatArray:
    """River for :func:`mountain_front` of the same seed: (n, 2) points from the valley's head to the plain's west edge.

    It follows the middle of the valley and of the canyon and runs on nearly straight over the plain.

    Args:
        spacing: Distance between points in m.
        seed: That of the terrain.
    """
    x = np.linspace(FRONT_SIZE[0] - 500.0, 500.0, 4001)
    line = np.column_stack([x, _river_y(x, seed)])
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    even = np.linspace(0.0, s[-1], max(2, round(s[-1] / positive(spacing, "spacing"))) + 1)
    return np.column_stack([np.interp(even, s, line[:, 0]), np.interp(even, s, line[:, 1])])


def mountain_front_zones() -> dict[str, tuple[float, float]]:
    """Limits in x (west, east) of the zones of :func:`mountain_front` in m.

    Within "front" the slope along the river exceeds 0.15; the bends of its profile lie between the zones.
    """
    bend = FRONT_BEND
    return {
        "plain": (0.0, FRONT_FOOT - bend),
        "front": (FRONT_FOOT + 0.5 * bend, FRONT_TOP - 0.5 * bend),
        "valley": (FRONT_TOP + bend, FRONT_SIZE[0]),
    }


@public
def read_sample_dem(cell_size: float = 75.0, *, device: wp.DeviceLike = "cpu") -> Terrain:
    """Real mountains that need no download: the Jacksboro fault, Tennessee, 30 x 32 km, from the SRTM at 3 arc seconds.

    The file comes with matplotlib. Longitude and latitude are laid out flat around the middle, true to 0.3 % in length;
    x and y are metres from the south-west corner, and there is no CRS.

    Args:
        cell_size: m; a cell of the file is 75 x 92 m.
        device: Warp device name.

    Raises:
        ImportError: matplotlib is not installed.
    """
    try:
        from matplotlib import cbook
    except ImportError as error:
        raise MissingExtraError('the sample DEM comes with matplotlib: pip install "warpriver[viz]"') from error
    with np.load(cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as file:
        height = file["elevation"].astype(np.float64)
        # The file has its ymin and ymax the wrong way round.
        south, north = sorted((float(file["ymin"]), float(file["ymax"])))
        west, east = float(file["xmin"]), float(file["xmax"])
    middle = math.radians(0.5 * (south + north))
    flat = 1.0 - FLATNESS * math.sin(middle) ** 2
    width = math.radians(east - west) * EQUATOR / math.sqrt(flat) * math.cos(middle) / height.shape[1]
    length = math.radians(north - south) * EQUATOR * (1.0 - FLATNESS) / flat**1.5 / height.shape[0]
    return _terrain(square_cells(height, width, length, positive(cell_size, "cell_size")), cell_size, device)


def _basin_axis(x: FloatArray, seed: int) -> FloatArray:
    """Line to which the plain of the basin falls from both sides: y at x."""
    phase = seeded(seed).uniform(0.0, 2.0 * np.pi, 2)
    axis: FloatArray = (
        0.5 * BASIN_SIZE[1] + 1500.0 * np.sin(x / 4500.0 + phase[0]) + 800.0 * np.sin(x / 1900.0 + phase[1])
    )
    return axis


def _front_base(x: FloatArray, y: FloatArray, cell_size: float, seed: int) -> tuple[FlagArray, FloatArray]:
    """Cells of the mountain front that rivers have made flat, and the height under which nothing is cut anywhere."""
    size = (len(y), x.shape[1])
    off = np.abs(y - _river_y(x, seed))
    bay = 1500.0 * _noise(size, cell_size, 5000.0, seed + 1, 0.5, 3) * _smoothstep(off / 2500.0)
    uneven = _noise(size, cell_size, 3000.0, seed + 2, 0.4, 4)
    widening = _smoothstep((x - FRONT_TOP) / 3000.0)
    half = CANYON + (VALLEY - CANYON) * widening + 250.0 * widening * uneven
    # Where the front steps back or forward, so does the profile along the river: level across, but for unevenness.
    base = (x - bay < FRONT_FOOT) | (off < half)
    floor = _river_height(x - bay)
    return base, floor + 0.3 * uneven * _smoothstep((FRONT_FOOT - 500.0 - x) / 500.0)


def _river_y(x: FloatArray, seed: int) -> FloatArray:
    """Where the river of the mountain front lies: winding in the valley, straight in the canyon, wandering after."""
    phase = seeded(seed).uniform(0.0, 2.0 * np.pi, 4)
    valley = _smoothstep((x - FRONT_TOP) / 4000.0)
    plain = _smoothstep((FRONT_FOOT - 1000.0 - x) / 3000.0)
    winding = 900.0 * np.sin(x / 1300.0 + phase[0]) + 1200.0 * np.sin(x / 2700.0 + phase[1])
    wandering = 60.0 * np.sin(x / 270.0 + phase[2]) + 150.0 * np.sin(x / 1100.0 + phase[3])
    across: FloatArray = 0.5 * FRONT_SIZE[1] + valley * winding + plain * wandering
    return across


def _river_height(x: FloatArray) -> FloatArray:
    """Height of the river of the mountain front: the integral of a slope that changes smoothly between the zones."""
    fine = np.linspace(0.0, FRONT_SIZE[0], 7001)
    foot = _smoothstep(0.5 + (fine - FRONT_FOOT) / (2.0 * FRONT_BEND))
    top = _smoothstep(0.5 + (fine - FRONT_TOP) / (2.0 * FRONT_BEND))
    slope = PLAIN_SLOPE + (FRONT_SLOPE - PLAIN_SLOPE) * foot + (VALLEY_SLOPE - FRONT_SLOPE) * top
    rise = 0.5 * (slope[1:] + slope[:-1]) * np.diff(fine)
    height: FloatArray = np.interp(x, fine, np.concatenate([[0.0], np.cumsum(rise)]))
    return height


def _drained(
    floor: FloatArray,
    base: FlagArray,
    cell_size: float,
    seed: int,
    concavity: float,
) -> FloatArray:
    """Heights of land that drains into its base cells, which keep those of ``floor``; below it nothing is cut."""
    kernel = kernels.build(wp.float64)
    shape, count = base.shape, base.size
    patches = _noise(shape, cell_size, PATCH, seed + 3, 0.5, 4)
    height = _cheapest_heights(floor, base, cell_size, seed, patches)
    drainage = kernel.Drainage()
    drainage.cell_size, drainage.concavity, drainage.hillslope = cell_size, concavity, max(HILLSLOPE, cell_size**2)
    drainage.steepness = STEEPEST * drainage.hillslope**concavity
    is_base: DeviceArray = wp.array(base.astype(np.int32), dtype=int, device="cpu")
    resistance: DeviceArray = wp.array(np.exp(RESISTANCE * patches).ravel(), dtype=wp.float64, device="cpu")
    lowest: DeviceArray = wp.array(floor.ravel(), dtype=wp.float64, device="cpu")
    receiver = wp.empty(count, dtype=int, device="cpu")
    for _ in range(ROUNDS):
        before: DeviceArray = wp.array(height, dtype=wp.float64, device="cpu")
        launch_kernel(kernel.find_receivers, dim=shape, inputs=[before, is_base], outputs=[receiver], device="cpu")
        order: DeviceArray = wp.array(np.argsort(height, axis=None, kind="stable"), dtype=int, device="cpu")
        area = wp.full(count, cell_size**2, dtype=wp.float64, device="cpu")
        steady = wp.clone(before.flatten())
        inputs = [drainage, order, receiver, resistance, lowest, shape[1]]
        launch_kernel(kernel.drain_cells, dim=1, inputs=inputs, outputs=[area, steady], device="cpu")
        # A mean of two surfaces that both fall to the same receivers falls to them too: no pits come up.
        height += STRIDE * (steady.numpy().reshape(shape) - height)
    return height


def _cheapest_heights(
    floor: FloatArray, base: FlagArray, cell_size: float, seed: int, patches: FloatArray
) -> FloatArray:
    """First heights of land that drains into its base cells: those rise along the cheapest path over random ground."""
    with IMPORTING:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

    rng = seeded(seed)
    cost = 0.15 * cell_size * np.exp(SCATTER * rng.standard_normal(base.shape) + STRETCHES * patches).ravel()
    index = np.arange(base.size, dtype=np.int32).reshape(base.shape)
    flat, is_base = floor.ravel(), base.ravel()
    # One more node, the sea, from which each base cell is as far as it is high.
    sea, coast = base.size, index[base]
    depth = float(flat[is_base].min()) - cell_size
    tails, heads, weights = [np.full(len(coast), sea, np.int32)], [coast], [flat[is_base] - depth]
    straight = [(index[:, :-1], index[:, 1:], 1.0), (index[:-1], index[1:], 1.0)]
    diagonal = [(index[:-1, :-1], index[1:, 1:], math.sqrt(2.0)), (index[:-1, 1:], index[1:, :-1], math.sqrt(2.0))]
    for a, b, length in straight + diagonal:
        for tail, head in ((a.ravel(), b.ravel()), (b.ravel(), a.ravel())):
            tail, head = tail[~is_base[head]], head[~is_base[head]]
            rise = np.maximum(flat[head] - flat[tail], 0.0)
            tails.append(tail)
            heads.append(head)
            weights.append(0.5 * length * (cost[tail] + cost[head]) + rise)
    entries = np.concatenate(weights), (np.concatenate(tails), np.concatenate(heads))
    graph = coo_array(entries, shape=(sea + 1, sea + 1)).tocsr()
    far = dijkstra(graph, indices=sea)[:-1].reshape(base.shape)
    return np.where(base, floor, far + depth)


def _noise(
    shape: tuple[int, ...], cell_size: float, longest: float, seed: int, roughness: float, octaves: int
) -> FloatArray:
    """Fractal noise at the cells' centres, its octave 0 in [-1, 1]."""
    if not (0.0 < roughness <= 1.0) or octaves < 1:
        raise InputError(f"roughness is {roughness}, octaves {octaves}; give 0 < roughness <= 1 and at least 1 octave.")
    whole(seed, "seed", maximum=MAX_SEED)
    start_warp()
    kernel = kernels.build(wp.float64)
    noise = kernel.Octaves()
    noise.seed = int(np.random.SeedSequence(seed).generate_state(1)[0] >> 1)
    noise.count, noise.longest, noise.cell_size, noise.roughness = octaves, longest, cell_size, roughness
    out = wp.empty(shape, dtype=wp.float64, device="cpu")
    launch_kernel(kernel.sum_octaves, dim=shape, inputs=[noise], outputs=[out], device="cpu")
    values: FloatArray = out.numpy().copy()
    return values


def _terrain(height: FloatArray, cell_size: float, device: Any) -> Terrain:
    """Terrain with its south-west corner at (0, 0)."""
    return Terrain(height, cell_size, (0.0, height.shape[0] * cell_size), device=device)


def _centers(shape: Sequence[int], cell_size: float) -> tuple[FloatArray, FloatArray]:
    """Coordinates x, (1, columns), and y, (rows, 1), of the cells' centres."""
    rows, columns = _checked(shape, cell_size)
    x = (np.arange(columns, dtype=np.float64) + 0.5) * cell_size
    y = (np.arange(rows, 0, -1, dtype=np.float64) - 0.5) * cell_size
    return x[None, :], y[:, None]


def _checked(shape: Sequence[int], cell_size: float, bytes_per_cell: int = 34) -> tuple[int, int]:
    """Rows and columns; raises ValueError or MemoryError before anything is made of them."""
    rows, columns = grid_shape(shape)
    positive(cell_size, "cell_size")
    require_memory((rows, columns), bytes_per_cell)
    return rows, columns


def _smoothstep(fraction: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, smooth between."""
    p = np.clip(fraction, 0.0, 1.0)
    return p * p * (3.0 - 2.0 * p)
