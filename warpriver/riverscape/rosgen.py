"""Rosgen's types of rivers: which one a channel is, by how far it is outside of the limits of each, and why.

The limits are those of Rosgen's Level II [Rosgen1994]; where they leave a gap, or meet, the type is the one that a
channel misses least, in tolerances. What cannot be measured on a terrain is left out, and said to be.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.hydraulic_geometry import bankfull_depth
from warpriver.metrics.lines import sinuosity
from warpriver.network import RiverNetwork
from warpriver.parameter import Params, parameter
from warpriver.public import public
from warpriver.riverscape.labels import ChannelLabels, label_channels
from warpriver.riverscape.stations import TYPES
from warpriver.riverscape.templates import type_index
from warpriver.terrain import Terrain
from warpriver.validate import floats, one_of

__all__ = ["CRITERIA", "RiverTypes", "RosgenParams", "classify_rivers", "classify_values", "entrenchment_ratio"]


CRITERIA = ("entrenchment", "width_to_depth", "sinuosity", "slope")
WORDS = ("entrenchment ratio", "width to depth", "sinuosity", "slope")
INF = math.inf
# (low, high) by type and criterion, in the order of TYPES and CRITERIA; None where a type asks nothing. Sinuosities are
# the lower ones of the two tables that are in use (1994, 1996).
BOUNDS: tuple[tuple[tuple[float, float] | None, ...], ...] = (
    ((0.0, 1.4), (0.0, 12.0), (1.0, 1.1), (0.10, INF)),  # A+
    ((0.0, 1.4), (0.0, 12.0), (1.0, 1.2), (0.04, 0.10)),  # A
    ((1.4, 2.2), (12.0, INF), (1.2, INF), (0.02, 0.039)),  # B
    ((2.2, INF), (12.0, INF), (1.2, INF), (0.0, 0.02)),  # C
    (None, (40.0, INF), None, (0.0, 0.04)),  # D
    ((4.0, INF), (0.0, 40.0), None, (0.0, 0.005)),  # DA
    ((2.2, INF), (0.0, 12.0), (1.5, INF), (0.0, 0.02)),  # E
    ((0.0, 1.4), (12.0, INF), (1.2, INF), (0.0, 0.02)),  # F
    ((0.0, 1.4), (0.0, 12.0), (1.2, INF), (0.02, 0.039)),  # G
)
BRAIDED = (TYPES.index("D"), TYPES.index("DA"))
# The first of these that is among the best wins a tie; the others follow in the order of TYPES.
TIES = ("B", "C")
# Where a value came from.
MEASURED, GIVEN, LAW, UNRESOLVED = "measured", "given", "law", "unresolved"
# How it meets a limit.
MET, NEAR, MISSED, NOT_ASKED = "met", "within tolerance", "missed", "not asked"
# Least grain of each digit, mm: boulders, cobbles, gravel, sand, silt; bedrock has no grain.
GRAINS = ((256.0, 2), (64.0, 3), (2.0, 4), (0.062, 5), (0.0, 6))
MATERIALS = {1: "bedrock", 2: "boulders", 3: "cobbles", 4: "gravel", 5: "sand", 6: "silt or clay"}
# Sections across the valley: places along each channel at most, steps on each side, and how far they reach in widths.
SECTIONS, STEPS, REACH = 25, 48, 12.0


@dataclasses.dataclass(frozen=True)
class RosgenParams(Params):
    """Constants of the classification."""

    ratio_tolerance: float = parameter(
        0.2, "-", low=0.0, low_open=True, source="Rosgen1994", doc="tolerance of entrenchment ratio and sinuosity"
    )
    width_tolerance: float = parameter(
        2.0, "-", low=0.0, low_open=True, source="Rosgen1994", doc="tolerance of the ratio of width to depth"
    )
    slope_tolerance: float = parameter(
        0.1, "-", low=0.0, low_open=True, source="warpriver", doc="tolerance of the slope, as a part of the limit"
    )
    greatest_depth: float = parameter(
        1.5, "-", low=1.0, source="warpriver", doc="greatest bankfull depth of a section over its mean depth"
    )
    braiding_coefficient: float = parameter(
        0.0125, "-", low=0.0, source="Leopold1957", doc="c of the slope c phi^-0.44 above which rivers braid (metric)"
    )
    braiding_exponent: float = parameter(0.44, "-", source="Leopold1957", doc="exponent of the same")
    braiding_flow: float = parameter(2.0, "m3/s", low=0.0, source="warpriver", doc="least flow of a braided river")
    anastomosing_order: int = parameter(4, "-", low=1, source="warpriver", doc="least Strahler order of type DA")
    shortest: float = parameter(
        10.0, "widths", low=0.0, source="warpriver", doc="least length of a channel whose sinuosity means anything"
    )


@dataclasses.dataclass(frozen=True)
class RiverTypes:
    """Types of channels, and how they came about.

    ``channel_type`` are words such as "C", or "C4" where the bed's material is known; :meth:`reasons` says why. A type
    of a user's own is set by :meth:`retyped`.

    Attributes:
        channel_type: (C,) words.
        index: (C,) index of the type into ``TYPES``.
        value: (C, 4) value of each of ``CRITERIA``; NaN where there is none.
        source: (C, 4) where it came from: "measured", "given", "law" (of a width law, which counts as unresolved) or
            "unresolved".
        status: (C, 9, 4) for each of ``TYPES`` "met", "within tolerance", "missed", "not asked", or "unresolved".
        cost: (C, 9) distance outside of the limits, in tolerances; infinite where a type is ruled out.
        labels: Flow, slope and order of the channels; None where values were given alone.
        note: (C,) what decided, in words.
    """

    channel_type: NDArray[np.str_]
    index: NDArray[np.int64]
    value: FloatArray
    source: NDArray[np.str_]
    status: NDArray[np.str_]
    cost: FloatArray
    labels: ChannelLabels | None
    note: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.index)

    def reasons(self, channel: int) -> str:
        """Say why a channel has its type: each criterion with its value, source, limits and how it meets them."""
        if not 0 <= int(channel) < len(self):
            raise InputError(f"channel is {channel}; there are {len(self)}, from 0 to {len(self) - 1}")
        lines = [f"channel {channel}: {self.channel_type[channel]}, {self.note[channel]}"]
        lines += [
            f"  {word}: {row['value']}, {row['source']}; {row['bound']}: {row['status']}"
            for word, row in zip(WORDS, self.table(channel), strict=True)
        ]
        return "\n".join(lines)

    def table(self, channel: int, type: str | None = None) -> list[dict[str, str]]:
        """Return the criteria of a channel as rows: criterion, value, source, bound and status.

        Args:
            channel: Which one.
            type: The type whose limits are meant; by default the channel's own.
        """
        kind = int(self.index[channel]) if type is None else type_index(type)
        return [
            {
                "criterion": name,
                "value": _shown(self.value[channel, k]),
                "source": str(self.source[channel, k]),
                "bound": _bound_in_words(kind, k),
                "status": str(self.status[channel, kind, k]),
            }
            for k, name in enumerate(CRITERIA)
        ]

    @public
    def retyped(self, channel: int, type: str) -> RiverTypes:
        """Return the types with another one for a channel, which stays whatever was measured."""
        if not 0 <= channel < len(self):
            raise InputError(f"channel is {channel}; there are {len(self)}, from 0 to {len(self) - 1}")
        names, index, note = self.channel_type.astype(object), self.index.copy(), self.note.astype(object)
        index[channel], names[channel], note[channel] = type_index(type), str(type).strip(), "as it was given"
        return dataclasses.replace(self, channel_type=names.astype(str), index=index, note=note.astype(str))

    def lengths(self, network: RiverNetwork) -> dict[str, float]:
        """Return the length of the channels of each type in km, types without channels left out."""
        total = np.bincount(self.index, weights=network.channel_lengths(), minlength=len(TYPES)) / 1e3
        return {name: float(km) for name, km in zip(TYPES, total, strict=True) if km > 0.0}

    def __repr__(self) -> str:
        count = np.bincount(self.index, minlength=len(TYPES))
        return f"RiverTypes({', '.join(f'{n} x {name}' for name, n in zip(TYPES, count, strict=True) if n)})"


@public
def classify_rivers(
    network: RiverNetwork,
    terrain: Terrain | None = None,
    *,
    values: Mapping[str, ArrayLike] | None = None,
    flow: ArrayLike | None = None,
    grain_size: ArrayLike | None = None,
    shows: str = "water",
    params: RosgenParams | None = None,
) -> RiverTypes:
    """Give each channel of a network its Rosgen type.

    The entrenchment ratio is measured on sections of the terrain: the width of the ground below twice the greatest
    bankfull depth, over the bankfull width. It and the sinuosity are unresolved where cells are wider than half the
    river; sinuosity is measured all the same on lines whose points are that close. A ratio of width to depth that
    follows from the width law, as that of extracted networks does, is no measurement. What is unresolved does not
    count.

    Args:
        network: A forest of channels.
        terrain: The ground; without it only slopes and shapes of the lines are measured.
        values: Known values by criterion, "entrenchment", "width_to_depth", "sinuosity", "slope": one number or (C,),
            NaN where they are to be measured.
        flow: (C,) discharges in m3/s, see :func:`label_channels`.
        grain_size: Median grain D50 of the bed in mm, one or (C,), NaN where it is not known, infinite for bedrock:
            adds the digit.
        shows: What the terrain shows in the channels: the "water", or the "bed".
        params: Constants.

    Raises:
        ValueError: A criterion that there is not, values that do not fit, and as :func:`label_channels`.
    """
    one_of(shows, "shows", ("water", "bed"))
    given = params or RosgenParams()
    labels = label_channels(network, terrain, flow=flow)
    count = network.channel_count
    value, source = np.full((count, 4), np.nan), np.full((count, 4), UNRESOLVED, dtype="<U12")
    spacing = _spacing(network)
    resolved, floor = np.ones(count, bool), np.full(count, np.nan)
    if terrain is not None:
        resolved = terrain.cell_size <= 0.5 * network.channel_width
        wide = _floor_width(network, terrain, shows, given)
        found = resolved & np.isfinite(wide)
        value[found, 0], source[found, 0] = wide[found] / network.channel_width[found], MEASURED
        # A section on coarse cells ends within a cell of each side: it can show that a valley is wide, not how narrow.
        floor = (
            np.where(np.isfinite(wide), np.maximum(wide - 2.0 * terrain.cell_size, 0.0), 0.0) / network.channel_width
        )
    value[:, 1] = network.channel_width / network.channel_depth
    # A stored depth differs from the law's by rounding, one that varies along a channel by its mean.
    lawful = np.abs(network.channel_depth / bankfull_depth(network.channel_width) - 1.0) < 0.02
    source[:, 1] = np.where(lawful, LAW, GIVEN)
    length = network.channel_lengths()
    curved = (resolved | (spacing <= 0.5 * network.channel_width)) & (length >= given.shortest * network.channel_width)
    lines = network.polylines()
    bends = np.array([sinuosity(line) if ok else np.nan for line, ok in zip(lines, curved, strict=True)])
    curved &= np.isfinite(bends)
    value[curved, 2], source[curved, 2] = bends[curved], MEASURED
    known = np.isfinite(labels.slope)
    value[known, 3], source[known, 3] = labels.slope[known], MEASURED
    for name, numbers in (values or {}).items():
        if name not in CRITERIA:
            raise InputError(f"values has {name!r}; use {', '.join(CRITERIA)}")
        _take(value, source, CRITERIA.index(name), _one_each(numbers, name, count))
    return _classify(value, source, floor, labels, grain_size, given)


@public
def classify_values(
    entrenchment: ArrayLike,
    width_to_depth: ArrayLike,
    sinuosity: ArrayLike,
    slope: ArrayLike,
    *,
    flow: ArrayLike | None = None,
    order: ArrayLike | None = None,
    grain_size: ArrayLike | None = None,
    params: RosgenParams | None = None,
) -> RiverTypes:
    """Give rivers of known form their Rosgen types; NaN is what is not known.

    Args:
        entrenchment: Width at twice the greatest bankfull depth over bankfull width, (n,) or one number.
        width_to_depth: Bankfull width over mean bankfull depth.
        sinuosity: Length of the channel over that of the valley.
        slope: Of the water surface, m/m.
        flow: Bankfull discharge in m3/s; without it no river is taken to be braided.
        order: Strahler order; without it none is of type DA.
        grain_size: D50 of the bed in mm; infinite for bedrock.
        params: Constants.
    """
    arrays = [
        floats(v, name) for v, name in zip((entrenchment, width_to_depth, sinuosity, slope), CRITERIA, strict=True)
    ]
    try:
        value = np.stack([np.atleast_1d(a) for a in np.broadcast_arrays(*arrays)], axis=-1)
    except ValueError as error:
        raise InputError(f"the values have shapes {', '.join(str(a.shape) for a in arrays)}; give (n,) each") from error
    if value.ndim != 2:
        raise InputError(f"the values have {value.ndim - 1} dimensions; give (n,) each")
    if (value < 0.0).any() or np.isinf(value).any():
        raise InputError("a value is below 0 or infinite; use NaN where it is not known")
    count = len(value)
    source = np.where(np.isfinite(value), GIVEN, UNRESOLVED).astype("<U12")
    phi = np.zeros(count) if flow is None else _one_each(flow, "flow", count)
    level = np.zeros(count) if order is None else _one_each(order, "order", count)
    unknown = np.full(count, np.nan)
    return _classify(value, source, unknown, (phi, level), grain_size, params or RosgenParams())


def _classify(
    value: FloatArray,
    source: NDArray[np.str_],
    floor: FloatArray,
    labels: ChannelLabels | tuple[FloatArray, FloatArray],
    grain_size: ArrayLike | None,
    params: RosgenParams,
) -> RiverTypes:
    """Classify; ``floor`` is the least that the entrenchment ratio can be, where a terrain shows that much."""
    flow, order = labels if isinstance(labels, tuple) else (labels.flow, labels.order)
    counts = np.isfinite(value) & ((source == MEASURED) | (source == GIVEN))
    miss, status = _misses(value, counts, params)
    cost = miss.sum(axis=2)
    er, slope = np.where(counts[:, 0], value[:, 0], floor), np.where(counts[:, 3], value[:, 3], np.nan)
    with np.errstate(divide="ignore"):
        line = params.braiding_coefficient * flow**-params.braiding_exponent
    d, da = BRAIDED
    # Comparisons with what is not known are false.
    braids = (slope > line) & (flow >= params.braiding_flow) & ~(er < 2.2) & (cost[:, d] < 1.0)
    parts = (slope <= line) & (slope < 0.005) & (order >= params.anastomosing_order) & (er > 4.0) & (cost[:, da] < 1.0)
    cost[:, d] = np.where(braids, cost[:, d], INF)
    cost[:, da] = np.where(parts, cost[:, da], INF)
    index, note = _least(cost, braids, parts, line)
    names = np.array(TYPES, dtype=object)[index]
    if grain_size is not None:
        digit = _digits(_one_each(grain_size, "grain_size", len(value), infinite=True))
        names = np.array([f"{name}{n}" if n else name for name, n in zip(names, digit, strict=True)], dtype=object)
    known = None if isinstance(labels, tuple) else labels
    return RiverTypes(names.astype(str), index, value, source, status, cost, known, note)


def _misses(value: FloatArray, counts: NDArray[np.bool_], params: RosgenParams) -> tuple[FloatArray, NDArray[np.str_]]:
    """Distance outside of each type's limits, in tolerances, (C, 9, 4), and how each is met."""
    low = np.array([[b[0] if b else -INF for b in row] for row in BOUNDS])[None]
    high = np.array([[b[1] if b else INF for b in row] for row in BOUNDS])[None]
    asked = np.array([[b is not None for b in row] for row in BOUNDS])[None]
    v = np.where(counts, value, 1.0)[:, None, :]
    below, above = np.maximum(low - v, 0.0), np.maximum(v - high, 0.0)
    tolerance = np.array([params.ratio_tolerance, params.width_tolerance, params.ratio_tolerance, 1.0])
    scale = np.broadcast_to(tolerance, low.shape).copy()
    limit = np.where(below > 0.0, low, np.where(above > 0.0, high, 1.0))
    with np.errstate(invalid="ignore"):
        miss = (below + above) / np.where(np.arange(4) == 3, params.slope_tolerance * limit, scale)
    miss = np.where(asked & counts[:, None, :], miss, 0.0)
    status = np.where(miss == 0.0, MET, np.where(miss <= 1.0, NEAR, MISSED)).astype("<U16")
    status = np.where(counts[:, None, :], status, UNRESOLVED)
    return miss, np.where(np.broadcast_to(asked, status.shape), status, NOT_ASKED)


def _least(
    cost: FloatArray, braids: NDArray[np.bool_], parts: NDArray[np.bool_], line: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.str_]]:
    """Type of the least cost, and what decided. Braiding decides alone."""
    d, da = BRAIDED
    ranked = [TYPES.index(t) for t in TIES] + [k for k, t in enumerate(TYPES) if t not in TIES]
    best = cost.min(axis=1, keepdims=True)
    tied = cost <= best + 1e-12
    single = tied.copy()
    single[:, [d, da]] = False
    first = np.array(ranked)[single[:, ranked].argmax(axis=1)]
    index = np.where(braids, d, np.where(parts, da, first))
    note = []
    for c in range(len(cost)):
        words = [TYPES[k] for k in np.flatnonzero(single[c])]
        if braids[c]:
            note.append(f"braided: steeper than {line[c]:.2g}, the slope above which rivers of this flow braid")
        elif parts[c]:
            note.append(f"anastomosing: below the slope of braiding, {line[c]:.2g}, in a wide valley")
        elif len(words) > 1:
            gap = f"; which it misses least, by {best[c, 0]:.2g} tolerances" if best[c, 0] > 0.0 else ""
            note.append(f"by the order of ties, as {' and '.join(words)} fit alike{gap}")
        elif best[c, 0] > 0.0:
            note.append(f"which it misses least, by {best[c, 0]:.2g} tolerances")
        else:
            note.append("whose limits it meets")
    return index, np.array(note)


def _digits(grain: FloatArray) -> NDArray[np.int64]:
    """Digit of the bed's material, 0 where it is not known."""
    digit = np.full(len(grain), 6)
    for least, number in GRAINS[::-1]:
        digit = np.where(grain > least, number, digit)
    digit = np.where(np.isinf(grain), 1, digit)
    return np.where(np.isnan(grain), 0, digit)


@public
def entrenchment_ratio(
    network: RiverNetwork, terrain: Terrain, *, shows: str = "water", params: RosgenParams | None = None
) -> FloatArray:
    """Measure the entrenchment ratio of each channel: the median over sections across its valley, (C,).

    It is the width of the ground, connected to the channel, that lies below twice the greatest bankfull depth above the
    bed, over the bankfull width; at most 24. Where the terrain shows the water, that is one depth above it.

    Args:
        network: The channels.
        terrain: The ground; where its cells are wider than half a channel the ratio says nothing.
        shows: What the terrain shows in the channels: the "water", or the "bed".
        params: Constants.

    Returns:
        (C,) NaN where the channel lies where there is no data.
    """
    one_of(shows, "shows", ("water", "bed"))
    wide = _floor_width(network, terrain, shows, params or RosgenParams())
    found: FloatArray = np.minimum(wide / network.channel_width, 2.0 * REACH)
    return found


def _floor_width(network: RiverNetwork, terrain: Terrain, shows: str, params: RosgenParams) -> FloatArray:
    """Median width of the ground below flood level along each channel, (C,) m."""
    point, channel = _sections(network)
    width = np.concatenate(network.point_widths())[point]
    depth = np.concatenate(network.point_depths())[point] * params.greatest_depth
    step = np.maximum(REACH * width / STEPS, 0.25 * terrain.cell_size)
    offset = np.arange(-STEPS, STEPS + 1) * step[:, None]
    xy, ahead = network.points()[point], _directions(network)[point]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    place = xy[:, None] + left[:, None] * offset[..., None]
    height = terrain.sample(place.reshape(-1, 2)).reshape(len(point), -1)
    inside = np.where(np.abs(offset) <= 0.5 * np.maximum(width, 2.0 * step)[:, None], height, INF)
    inside = np.nan_to_num(inside, nan=INF)
    base, bottom = inside.min(axis=1), inside.argmin(axis=1)[:, None]
    dry = ~(height < (base + (depth if shows == "water" else 2.0 * depth))[:, None])
    # The first dry place on each side of the lowest one between the banks.
    column = np.arange(height.shape[1])[None]
    right_end = np.where(dry & (column > bottom), column, height.shape[1]).min(axis=1)
    left_end = np.where(dry & (column < bottom), column, -1).max(axis=1)
    wide = np.maximum((right_end - left_end - 1) * step, width)
    return _medians(np.where(np.isfinite(base), wide, np.nan), channel, network.channel_count)


def _sections(network: RiverNetwork) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Points of sections, evenly along each channel, and their channels."""
    start = network.starts().astype(np.int64)
    counts = np.diff(start)
    taken = np.minimum(counts, SECTIONS)
    channel = np.repeat(np.arange(len(counts)), taken)
    rank = np.arange(len(channel)) - np.repeat(np.cumsum(taken) - taken, taken)
    return start[channel] + ((2 * rank + 1) * counts[channel]) // (2 * taken[channel]), channel


def _directions(network: RiverNetwork) -> FloatArray:
    """Unit vector downstream at each point, (P, 2)."""
    start, xy = network.starts().astype(np.int64), network.points()
    index, channel = np.arange(len(xy)), np.repeat(np.arange(network.channel_count), np.diff(start))
    ahead = xy[np.minimum(index + 1, start[channel + 1] - 1)] - xy[np.maximum(index - 1, start[channel])]
    found: FloatArray = ahead / np.maximum(np.hypot(*ahead.T), 1e-12)[:, None]
    return found


def _medians(values: FloatArray, group: NDArray[np.int64], count: int) -> FloatArray:
    """Median of the known values of each group; NaN where there are none."""
    known = np.isfinite(values)
    values, group = values[known], group[known]
    order = np.lexsort([values, group])
    sizes = np.bincount(group, minlength=count)
    first = np.cumsum(sizes) - sizes
    out = np.full(count, np.nan)
    some = sizes > 0
    low, high = first[some] + (sizes[some] - 1) // 2, first[some] + sizes[some] // 2
    ranked = values[order]
    out[some] = 0.5 * (ranked[low] + ranked[high])
    return out


def _spacing(network: RiverNetwork) -> FloatArray:
    """Mean distance between the points of each channel, m."""
    found: FloatArray = network.channel_lengths() / (np.diff(network.starts()) - 1)
    return found


def _take(value: FloatArray, source: NDArray[np.str_], k: int, numbers: FloatArray) -> None:
    known = np.isfinite(numbers)
    if (numbers[known] < 0.0).any():
        raise InputError(f"{CRITERIA[k]} is {numbers[known].min():g}; give 0 or more, NaN where it is to be measured")
    value[known, k], source[known, k] = numbers[known], GIVEN


def _one_each(values: ArrayLike, name: str, count: int, *, infinite: bool = False) -> FloatArray:
    array = floats(values, name)
    if array.shape not in ((), (count,)):
        raise InputError(f"{name} has shape {array.shape}; give one number, or {count}")
    if (np.isinf(array).any() and not infinite) or (array < 0.0).any():
        raise InputError(f"{name} holds a value below 0 or infinite; use NaN where it is not known")
    return np.broadcast_to(array, (count,)).astype(np.float64)


def _shown(value: float) -> str:
    return "unknown" if math.isnan(value) else f"{value:.3g}"


def _bound_in_words(kind: int, k: int) -> str:
    bound = BOUNDS[kind][k]
    name = TYPES[kind]
    if bound is None:
        return f"{name} asks nothing"
    low, high = bound
    if math.isinf(high):
        return f"{name} has {low:g} or more"
    return f"{name} has less than {high:g}" if low == 0.0 else f"{name} has {low:g} to {high:g}"


def types_of(types: RiverTypes | Sequence[str] | str, count: int) -> NDArray[np.int64]:
    """Return the index of each channel's type, of what a user gave."""
    if isinstance(types, RiverTypes):
        found = types.index
    elif isinstance(types, str):
        found = np.full(count, type_index(types))
    else:
        found = np.array([type_index(name) for name in types], np.int64)
    if len(found) != count:
        raise InputError(f"types are {len(found)} for {count} channels; give one word for all, or one a channel")
    return found
