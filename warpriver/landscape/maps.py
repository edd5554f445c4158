"""Landscape maps: moisture, deposits, vegetation, old courses and their age, from the history of a run."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpriver.crs import same_crs, short_name
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.history import Avulsion, Collision, Crevasse, Cutoff, History
from warpriver.hydrology import fill_depressions, stream_power
from warpriver.kernels import covers
from warpriver.landscape.falloff import falloff_table, moisture_falloff, sediment_falloff, smoothstep
from warpriver.landscape.motion import lead_between
from warpriver.landscape.params import LandscapeParams
from warpriver.landscape.splatting import LEFT_NEVER, Segments, Splat, segments_of
from warpriver.landscape.traces import lobes_of, old_courses_of
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.terrain import Terrain
from warpriver.validate import finite_numbers, positive, whole

__all__ = ["GROUND", "PLANTS", "Cover", "Landscape", "LandscapeMaps", "bounds_of", "landscape_maps"]

FloatArray = NDArray[np.float64]

# What covers a cell: the numbers of ``LandscapeMaps.ground``.
GROUND = ("floodplain", "point bar", "oxbow lake", "dry course", "channel", "plug", "lobe")
# Kinds of vegetation: the numbers of ``LandscapeMaps.plants``.
PLANTS = ("water", "bare sand", "pioneers", "willow", "swamp", "forest", "grassland")
# Percentile of the stream power that counts as 1.
POWER_PERCENTILE = 99.0
# Widths around the outermost channels that a raster holds where no bounds are given.
MARGIN = covers.FELT
# Channels are followed up to so many widths off the raster.
OFF_WIDTHS = 4.0 * covers.FELT
# How far below its rim the water of an old course stands, in what is left of its depth; least depth of a lake, alike.
RIM, LEAST_LAKE = 0.1, 0.08
# Hollows deeper than this are wet, m.
SWAMP_DEPTH = 0.15
# Most cells of a raster.
MOST_CELLS = 2**31


@dataclasses.dataclass(frozen=True)
class LandscapeMaps:
    """Maps of what a river has left behind, on the same cells; NaN is no data.

    Attributes:
        moisture: Soil moisture [Paris2023, Eq. 8]: stream power over ``power_scale``, plus the sum over time.
        sediment: Thickness of the deposits in m [Paris2023, Eq. 9], below the depth of the channel that laid them down.
        vegetation: Density of the vegetation, 0 to 1.
        age: Years since water last ran there, 0 under the channels; NaN where it never did.
        belt: 1 where a channel has ever been, else 0.
        occupied: Years that channels were there.
        elevation_change: Height that deposits, bars and lobes add, and old courses take, m. The beds of the present
            channels are not in it.
        lake: Depth of the water in oxbow lakes, m; 0 elsewhere.
        sand: Fraction of sand among the deposits, the rest is mud; NaN where there are none.
        ground: What covers a cell, a number in ``GROUND``.
        plants: Kind of vegetation, a number in ``PLANTS``.
        inner: Width times curvature of the channel that left a point bar, above 0 where that is on the inner side of
            the bend; NaN elsewhere.
        water: Distance to the middle of the nearest present channel in widths, above 0 on its left; NaN from 6 on.
        power_scale: Stream power that counts as a moisture of 1, m; NaN without a terrain.
        time: Of the maps, yr.
        params: The constants.
        touched: Cells that were worked at, counted anew for each record.
    """

    moisture: Raster
    sediment: Raster
    vegetation: Raster
    age: Raster
    belt: Raster
    occupied: Raster
    elevation_change: Raster
    lake: Raster
    sand: Raster
    ground: Raster
    plants: Raster
    inner: Raster
    water: Raster
    power_scale: float
    time: float
    params: LandscapeParams
    touched: int

    @property
    def rasters(self) -> dict[str, Raster]:
        """The maps by their names."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: value for name, value in fields.items() if isinstance(value, Raster)}

    def __repr__(self) -> str:
        rows, columns = self.age.shape
        return (
            f"LandscapeMaps({rows} x {columns} cells of {self.age.cell_size:g} m at {self.time:.4g} yr: "
            f"{', '.join(self.rasters)})"
        )


@public
def landscape_maps(
    history: History,
    terrain: Terrain | None = None,
    cell_size: float = 10.0,
    *,
    params: LandscapeParams | None = None,
    bounds: Sequence[float] | np.ndarray | None = None,
    until: int | None = None,
    window: int | None = None,
    moisture_falloff: Callable[[np.ndarray], np.ndarray] = moisture_falloff,
    sediment_falloff: Callable[[np.ndarray], np.ndarray] = sediment_falloff,
    device: str = "cpu",
    threads: int | None = None,
) -> LandscapeMaps:
    """Make maps of what a river has left behind: moisture, deposits, vegetation, bars, oxbow lakes and their age.

    Sums are over time, so that they do not depend on how often a run was recorded. From one record to the next the
    distance of each cell to the channel, in widths of that channel, changes evenly; where the channel passes over a
    cell, the cell lies on its other side afterwards. What cutoffs, collisions and avulsions leave counts from the time
    of the event. The nearest channel is the one with the least distance in its own widths.

    Args:
        history: The run.
        terrain: Ground of the run, for the stream power; the maps lie within its bounds.
        cell_size: Side of the cells, m.
        params: Constants.
        bounds: (west, south, east, north) of the maps in m; by default those of the terrain, or 6 widths around the
            channels.
        until: Index of the record to show as the present (negative: from the end); by default the last.
        window: Number of records, the latest ones, that moisture and sediment are summed over; by default all. With 1
            the present channels count for the time since the record before.
        moisture_falloff: Moisture by distance in widths, for arrays from 0 to 6.
        sediment_falloff: Deposits by distance in widths, likewise.
        device: Warp device.
        threads: Threads on the CPU, by default one for each core; the maps do not depend on it.

    Raises:
        ValueError: No record, a record that does not exist, bounds that hold no cell, a terrain elsewhere or in another
            CRS, or falloffs that have not faded at 6 widths.
        MemoryError: The cells do not fit.
    """
    record = _checked_record(history, until)
    options: dict[str, Any] = {"params": params, "window": window, "device": device, "threads": threads}
    options |= {"moisture_falloff": moisture_falloff, "sediment_falloff": sediment_falloff}
    bounds = bounds if bounds is not None or terrain is not None else bounds_of(history, record)
    landscape = Landscape(history, terrain, cell_size, bounds=bounds, last=record, **options)
    landscape.lead_to(record)
    return landscape.maps()


@dataclasses.dataclass(frozen=True)
class Cover:
    """What has covered each cell last, (rows, columns) each.

    Attributes:
        kind: A number of ``kernels.covers``.
        left: When water was there last, yr.
        from_end: Of an old course the distance from its nearer end in widths.
        across: Of an old course the distance from its middle in widths.
        is_channel: Whether the cell is under a present channel.
    """

    kind: np.ndarray
    left: np.ndarray
    from_end: np.ndarray
    across: np.ndarray
    is_channel: np.ndarray


class Landscape:
    """Cells that are led through a history, record by record, also while it grows; see :func:`landscape_maps`.

    Attributes:
        record: Index of the record that the cells are at, -1 before the first.
    """

    def __init__(
        self,
        history: History,
        terrain: Terrain | None,
        cell_size: float,
        *,
        bounds: Any,
        last: int | None = None,
        params: LandscapeParams | None = None,
        window: int | None = None,
        moisture_falloff: Callable[[np.ndarray], np.ndarray] = moisture_falloff,
        sediment_falloff: Callable[[np.ndarray], np.ndarray] = sediment_falloff,
        device: Any = "cpu",
        threads: int | None = None,
        narrowest: float = 0.0,
        counted: bool = True,
    ):
        """Make empty cells; arguments as of :func:`landscape_maps`.

        ``last`` is the record that ``window`` counts from, ``narrowest`` a width in m that narrower channels are taken
        to have; without ``counted`` nothing is added up for moisture and sediment.
        """
        size = self._cell_size = positive(cell_size, "cell_size", unit="m")
        self._history, self._params = history, params or LandscapeParams()
        window = None if window is None else whole(window, "window", 1, "records")
        threads = None if threads is None else whole(threads, "threads", 1)
        tables = (
            falloff_table(moisture_falloff, "moisture_falloff"),
            falloff_table(sediment_falloff, "sediment_falloff"),
        )
        shape, self._origin = _checked_place(history, terrain, size, bounds)
        self._splat = Splat(shape, size, self._origin, tables, device=device, threads=threads, narrowest=narrowest)
        self._power, self._scale = _stream_power(terrain, self._splat, size, self._origin)
        self._last, self._first = last, 0 if window is None or last is None else max(0, last + 1 - window)
        self._alone, self._counted = window == 1, counted
        self._network: RiverNetwork | None = None
        self._segments: Segments | None = None
        self.record = -1

    def lead_to(self, record: int) -> None:
        """Lead the cells up to a record, the present one or a later one."""
        history, splat = self._history, self._splat
        times, events = history.times, history.events.of(Cutoff, Collision, Avulsion, Crevasse)
        at = events.times
        for k in range(self.record + 1, record + 1):
            network, now = history.networks[k], float(times[k])
            segments, counted, span = splat.widened(segments_of(network)), self._counted and k > self._first, 0.0
            # What lies far off the raster is left out.
            segments = segments.take(np.flatnonzero(splat.reaches(segments.line, OFF_WIDTHS * segments.section[:, 0])))
            met: list[Any] = []
            if self._network is not None and self._segments is not None:
                met = [events[j] for j in np.flatnonzero((at > times[k - 1]) & (at <= now)).tolist()]
                left = [event for event in met if isinstance(event, (Cutoff, Collision, Avulsion))]
                span = now - float(times[k - 1])
                segments = lead_between(splat, self._segments, segments, left, (float(times[k - 1]), now), counted)
            frame = splat.frame(segments)
            splat.advance(frame, now, counted=counted, span=span)
            if self._network is not None:
                _lay_events(met, self._network, splat, self._params)
            if self._alone and k == self._last:
                span = now - float(times[k - 1]) if k else history.params.time_step
                splat.advance(frame, now, extra=span)
            self._network, self._segments, self.record = network, segments, k

    @property
    def touched(self) -> int:
        """Cells that were worked at so far, counted anew for each course."""
        return self._splat.touched

    def cover(self) -> Cover:
        """Return what has covered each cell last."""
        cells = self._splat.cells
        host = {name: getattr(cells, name).numpy() for name in ("kind", "left", "inner", "across", "offset")}
        under = np.abs(host["offset"]) <= covers.BANK
        return Cover(host["kind"], host["left"], host["inner"], host["across"], under)

    def maps(self) -> LandscapeMaps:
        """Return the maps at the present record."""
        now = float(self._history.times[self.record])
        place = self._cell_size, self._origin, self._history.crs
        return _finished(self._splat, place, self._params, self._power, self._scale, now)


def _lay_events(events: Sequence[Any], network: RiverNetwork, splat: Splat, params: LandscapeParams) -> None:
    """Lay down what the events between two records left."""
    splat.lay(old_courses_of([e for e in events if isinstance(e, (Collision, Avulsion))]), covers.ABANDONED)
    splat.lay(old_courses_of([e for e in events if isinstance(e, Cutoff)]), covers.OXBOW)
    broken = [e for e in events if isinstance(e, Crevasse)]
    splat.lay(lobes_of(broken, network, params.lobe_length, params.lobe_height), covers.BAR)


# ---- the raster


def _checked_record(history: History, until: int | None) -> int:
    count = len(history.times)
    if count == 0:
        raise InputError("the history holds no record; run the simulation first")
    record = count - 1 if until is None else whole(until, "until", minimum=-(2**63))
    if not -count <= record < count:
        raise InputError(f"until is {until}, but the history holds records 0 to {count - 1}")
    return record % count


def _checked_place(
    history: History, terrain: Terrain | None, cell_size: float, bounds: Any
) -> tuple[tuple[int, int], tuple[float, float]]:
    """Return rows and columns, and the west and north edge of the maps."""
    if terrain is not None and terrain.crs is not None and history.crs is not None:
        if not same_crs(terrain.crs, history.crs):
            raise InputError(
                f"the terrain is in {short_name(terrain.crs)}, the run in {short_name(history.crs)}; give its own one"
            )
    if bounds is not None:
        west, south, east, north = finite_numbers(bounds, 4, "bounds")
    elif terrain is not None:
        west, south, east, north = terrain.bounds
    else:
        west, south, east, north = bounds_of(history, len(history) - 1)
    # Whole cells, as many as reach beyond the bounds by no more than rounding does.
    columns, rows = ((high - low) / cell_size for low, high in ((west, east), (south, north)))
    if not (columns >= 2.0 and rows >= 2.0):
        raise InputError(
            f"({west:g}, {south:g}, {east:g}, {north:g}) m hold fewer than 2 x 2 cells of {cell_size:g} m; give (west, "
            "south, east, north), or smaller cells"
        )
    if columns * rows >= MOST_CELLS:
        raise InputError(f"{rows:.4g} x {columns:.4g} cells of {cell_size:g} m; 2^31 is the limit, give larger cells")
    return (math.ceil(rows - 1e-6), math.ceil(columns - 1e-6)), (west, north)


def bounds_of(history: History, last: int) -> tuple[float, float, float, float]:
    """Return the bounds of all channels up to a record, with a margin."""
    boxes = []
    for k in range(last + 1):
        network = history.networks[k]
        margin = MARGIN * max(float(width.max()) for width in network.point_widths())
        west, south, east, north = network.bounds()
        boxes.append((west - margin, south - margin, east + margin, north + margin))
    low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
    return float(low[0]), float(low[1]), float(high[2]), float(high[3])


def _stream_power(
    terrain: Terrain | None, splat: Splat, cell_size: float, origin: tuple[float, float]
) -> tuple[FloatArray | None, float]:
    """Return the stream power at the cells over its scale, from 0 to 1, and the scale; None without a terrain."""
    if terrain is None:
        return None, math.nan
    ground = terrain.to("cpu")
    power = stream_power(fill_depressions(ground))
    known = power.numpy()[np.isfinite(power.numpy())]
    scale = float(np.percentile(known, POWER_PERCENTILE)) if len(known) else 0.0
    if scale <= 0.0:
        return np.zeros(splat.shape), scale
    rows, columns = splat.shape
    x = origin[0] + (np.arange(columns) + 0.5) * cell_size
    y = origin[1] - (np.arange(rows) + 0.5) * cell_size
    if power.shape == splat.shape and power.origin == origin and power.cell_size == cell_size:
        values = power.numpy()
    else:
        values = np.stack([power.sample(np.stack([x, np.full(columns, row)], axis=1)) for row in y])
    return np.clip(values / scale, 0.0, 1.0), scale


# ---- the maps


def _finished(
    splat: Splat,
    place: tuple[float, tuple[float, float], str | None],
    params: LandscapeParams,
    power: FloatArray | None,
    scale: float,
    now: float,
) -> LandscapeMaps:
    """Return the maps of what the cells hold."""
    cells, quantum = splat.cells, 1.0 / covers.QUANTA
    host = {name: getattr(cells, name).numpy() for name in ("left", "kind", "inner", "across", "lobe", "offset")}
    section = cells.section.numpy()
    years = {name: getattr(cells, name).numpy() * quantum for name in ("moisture", "sediment", "deep", "occupied")}
    kind, left = host["kind"], host["left"]
    been = left > LEFT_NEVER
    age = np.where(been, now - left, np.nan)
    channel = np.abs(host["offset"]) <= covers.BANK
    age[channel] = 0.0
    moisture = params.moisture_rate * years["moisture"]
    if power is not None:
        moisture = moisture + np.nan_to_num(power)
    sediment = capped(params.sediment_rate * years["sediment"], years["deep"], years["sediment"], splat.touched_sigma())
    depth = section[..., 1].astype(np.float64)
    old = (kind == covers.OXBOW) | (kind == covers.ABANDONED)
    plug = old & (host["inner"] < params.plug_length)
    # An old course is a parabola that fills up from below, at its ends first.
    open_part = np.where(old, np.exp(-np.nan_to_num(age) / params.lake_time), 0.0)
    if params.plug_length > 0.0:
        open_part *= smoothstep(host["inner"] / params.plug_length)
    hollow = np.where(old, depth * np.clip(1.0 - (2.0 * host["across"]) ** 2, 0.0, 1.0) * open_part, 0.0)
    # Water stands below the rim; where little of it is left a swamp is.
    lake = np.where((kind == covers.OXBOW) & ~channel, hollow - RIM * depth * open_part, 0.0)
    lake[lake < np.maximum(LEAST_LAKE * depth, 1e-3)] = 0.0
    bar = (kind == covers.BAR) & ~channel
    # Bars emerge below the floodplain and grow up to it; scroll bars are what floods leave on them at intervals.
    phase = 2.0 * np.pi * left / params.scroll_period
    growing = np.exp(-np.nan_to_num(age) / params.bar_time)
    relief = np.where(
        bar, depth * (params.scroll_height * 0.5 * np.cos(np.where(been, phase, 0.0)) - params.bar_depth * growing), 0.0
    )
    change = np.where(channel, 0.0, sediment + relief + host["lobe"] - hollow)
    sand = _sand(kind, channel, plug, sediment, host["lobe"], open_part)
    ground = kind.copy()
    ground[channel] = GROUND.index("channel")
    ground[(kind == covers.CHANNEL) & ~channel] = GROUND.index("point bar")
    ground[plug & (kind == covers.OXBOW)] = GROUND.index("plug")
    ground[(ground == 0) & (host["lobe"] > 0.0)] = GROUND.index("lobe")
    water = channel | (lake > 0.0)
    wet = smoothstep(moisture)
    grown = 1.0 - np.exp(-np.where(been, np.nan_to_num(age), np.inf) / params.cover_time)
    vegetation = np.where(water, 0.0, (wet + (1.0 - wet) * params.dry_cover) * grown)
    plants = _plants(water, wet, age, sand, hollow, params)

    def raster(values: np.ndarray, name: str, unit: str = "") -> Raster:
        return Raster(values, *place, unit, name, device=splat.device.alias)

    offset = np.where(np.abs(host["offset"]) < covers.FELT, host["offset"], np.nan)
    return LandscapeMaps(
        moisture=raster(moisture, "moisture"),
        sediment=raster(sediment, "sediment", "m"),
        vegetation=raster(vegetation, "vegetation"),
        age=raster(age, "age", "yr"),
        belt=raster(been.astype(np.uint8), "belt"),
        occupied=raster(years["occupied"], "occupied", "yr"),
        elevation_change=raster(change, "elevation_change", "m"),
        lake=raster(lake, "lake", "m"),
        sand=raster(sand, "sand"),
        ground=raster(ground, "ground"),
        plants=raster(plants, "plants"),
        inner=raster(np.where(bar, host["inner"], np.nan), "inner"),
        water=raster(offset, "water", "widths"),
        power_scale=scale,
        time=now,
        params=params,
        touched=splat.touched,
    )


def capped(laid: FloatArray, deep: FloatArray, years: FloatArray, sigma: float) -> FloatArray:
    """Return deposits below the depth of the channels that laid them down, d (1 - exp(-s / d)).

    The depth is the mean over those deposits, smoothed, so that it does not jump where a brook meets a river.

    Args:
        laid: Deposits without a limit, m.
        deep: Sum over time of the profile times the depth, m yr.
        years: Sum over time of the profile, yr.
        sigma: Reach of the smoothing, in cells.
    """
    with IMPORTING:
        from scipy.ndimage import gaussian_filter

    above, below = (gaussian_filter(values, sigma, mode="nearest", truncate=3.0) for values in (deep, years))
    known = (years > 0.0) & (below > 0.0)
    depth = np.where(known, above / np.where(known, below, 1.0), 1.0)
    return np.where(known, depth * -np.expm1(-laid / np.maximum(depth, 1e-6)), 0.0)


def _sand(
    kind: np.ndarray,
    channel: np.ndarray,
    plug: np.ndarray,
    sediment: FloatArray,
    lobe: np.ndarray,
    open_part: FloatArray,
) -> FloatArray:
    """Return the fraction of sand: bars, channels and plugs are of sand, what fills old courses is mud."""
    sand = np.full(kind.shape, np.nan)
    sand[sediment > 0.0] = 0.35
    sand[lobe > 0.0] = 0.7
    sand[(kind == covers.BAR) | (kind == covers.CHANNEL)] = 0.9
    old = (kind == covers.OXBOW) | (kind == covers.ABANDONED)
    # The bed of an old course is of sand still; mud covers it as it fills.
    sand[old] = (0.1 + 0.6 * open_part)[old]
    sand[plug] = 0.7
    sand[channel] = 1.0
    return sand


def _plants(
    water: np.ndarray,
    wet: FloatArray,
    age: FloatArray,
    sand: FloatArray,
    hollow: FloatArray,
    params: LandscapeParams,
) -> np.ndarray:
    """Return the kind of vegetation: by age on sand, swamp in hollows, forest where it is moist, else grassland."""
    years = np.where(np.isnan(age), np.inf, age)
    kind = np.full(wet.shape, PLANTS.index("grassland"), np.uint8)
    kind[wet > 0.25] = PLANTS.index("forest")
    fresh = years < 2.0 * params.cover_time
    kind[fresh] = PLANTS.index("willow")
    kind[years < 0.75 * params.cover_time] = PLANTS.index("pioneers")
    kind[(years < 0.25 * params.cover_time) & (sand > 0.5)] = PLANTS.index("bare sand")
    kind[hollow > SWAMP_DEPTH] = PLANTS.index("swamp")
    kind[water] = PLANTS.index("water")
    return kind
