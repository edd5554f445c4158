"""Stream orders of a channel graph, and the laws that drainage networks follow.

Pure functions on NumPy arrays. A graph is given as the nodes upstream and downstream of each channel, like
``channel_from`` and ``channel_to`` of a ``RiverNetwork`` (or any other numbers of nodes): a forest in which water
leaves a node by at most one channel. More than two channels may join at a node.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.public import public
from warpriver.validate import floats, positive_numbers

__all__ = [
    "Exceedance",
    "HortonRatios",
    "PowerLaw",
    "Tokunaga",
    "exceedance",
    "hack_exponent",
    "horton_order",
    "horton_ratios",
    "main_stem",
    "main_stem_length",
    "shreve_magnitude",
    "strahler_order",
    "tokunaga",
]


# Limits of the fit of P(A > a): a multiple of the minimum area, a fraction of the maximum.
EXCEEDANCE_LOW, EXCEEDANCE_HIGH = 10.0, 0.01
EXCEEDANCE_SAMPLES = 64


class PowerLaw(NamedTuple):
    """A power law y = coefficient x^exponent.

    Attributes:
        exponent: Dimensionless.
        coefficient: y at x = 1.
        correlation: Pearson's r of the logarithms; NaN where one of them is constant.
    """

    exponent: float
    coefficient: float
    correlation: float


class HortonRatios(NamedTuple):
    """Horton's laws of a network: streams of each Strahler order, and their ratios.

    A stream is a run of channels of one order.

    Attributes:
        streams: (K,) number of streams of the orders 1 to K.
        length: (K,) their mean length, m.
        area: (K,) their mean drainage area at the lower end, m2.
        bifurcation_ratio: R_B, streams of an order over those of the next one, fitted over all orders.
        length_ratio: R_L, mean length over that of the order before.
        area_ratio: R_A, mean area over that of the order before.
    """

    streams: IndexArray
    length: FloatArray
    area: FloatArray
    bifurcation_ratio: float
    length_ratio: float
    area_ratio: float


class Exceedance(NamedTuple):
    """How drainage areas are distributed.

    Attributes:
        area: (n,) distinct areas, ascending, m2.
        probability: (n,) fraction of all that is larger, P(A > a).
        exponent: beta of P(A > a) ~ a^-beta.
    """

    area: FloatArray
    probability: FloatArray
    exponent: float


class Tokunaga(NamedTuple):
    """Side tributaries of the streams of each order.

    Attributes:
        matrix: (K, K), [i - 1, j - 1]: number of streams of order i that join a stream of order j from the side, a
            stream of order j; the two or more whose meeting forms it do not count. 0 for i >= j.
        mean: (K - 1,) T_k, the mean over all pairs of orders k apart, weighted by the streams of the higher one.
        first: a of T_k = a c^(k - 1); NaN where fewer than two T_k are above 0.
        ratio: c of the same.
    """

    matrix: FloatArray
    mean: FloatArray
    first: float
    ratio: float


@public
def strahler_order(channel_from: ArrayLike, channel_to: ArrayLike) -> IndexArray:
    """Strahler order: 1 at sources; where the highest order arrives twice or more, one higher, else the highest.

    Args:
        channel_from: (C,) node upstream of each channel.
        channel_to: (C,) node downstream of it.

    Returns:
        (C,) int64.

    Raises:
        ValueError: Channels split or flow in a circle.
    """
    return _strahler(_Graph(channel_from, channel_to))


@public
def shreve_magnitude(channel_from: ArrayLike, channel_to: ArrayLike) -> IndexArray:
    """Shreve magnitude: the number of sources above each channel, (C,) int64.

    Args:
        channel_from: (C,) node upstream of each channel.
        channel_to: (C,) node downstream of it.
    """
    graph = _Graph(channel_from, channel_to)
    magnitude: IndexArray = (graph.arriving == 0).astype(np.int64)
    for level in graph.levels:
        joining = level[graph.down[level] >= 0]
        np.add.at(magnitude, graph.down[joining], magnitude[joining])
    return magnitude


@public
def main_stem(channel_from: ArrayLike, channel_to: ArrayLike, area: ArrayLike) -> IndexArray:
    """Stem that each channel belongs to, named by its lowest channel: (C,) int64.

    Upstream of a junction Hack's main stem goes on along the channel of the largest area; at equal areas, the first.

    Args:
        channel_from: (C,) node upstream of each channel.
        channel_to: (C,) node downstream of it.
        area: (C,) drainage area, or what else decides.
    """
    graph = _Graph(channel_from, channel_to)
    return _stems(graph, _per_channel(area, graph, "area"))


@public
def main_stem_length(
    channel_from: ArrayLike, channel_to: ArrayLike, length: ArrayLike, area: ArrayLike, *, longest: bool = False
) -> FloatArray:
    """Length of the main stem above the lower end of each channel, from its source: (C,) m.

    Args:
        channel_from: (C,) node upstream of each channel.
        channel_to: (C,) node downstream of it.
        length: (C,) m.
        area: (C,) drainage area, which decides how the stem goes on upstream.
        longest: Take the longest course instead.
    """
    graph = _Graph(channel_from, channel_to)
    own = _per_channel(length, graph, "length")
    weight = _per_channel(area, graph, "area")
    total: FloatArray = own.copy()
    main = np.ones(len(own), bool) if longest else _continues(graph, weight)
    above = np.zeros(len(own))
    for level in graph.levels:
        total[level] = own[level] + above[level]
        joining = level[(graph.down[level] >= 0) & main[level]]
        np.maximum.at(above, graph.down[joining], total[joining])
    return total


@public
def horton_order(channel_from: ArrayLike, channel_to: ArrayLike, area: ArrayLike | None = None) -> IndexArray:
    """Horton order: every stem, up to its source, has the Strahler order of its lowest channel.

    Upstream of a junction the stem goes on along the highest Strahler order; of equal ones along the larger area, or,
    without areas, the larger Shreve magnitude.

    Args:
        channel_from: (C,) node upstream of each channel.
        channel_to: (C,) node downstream of it.
        area: (C,) drainage area, or None.

    Returns:
        (C,) int64.
    """
    graph = _Graph(channel_from, channel_to)
    order = _strahler(graph)
    weight = shreve_magnitude(channel_from, channel_to) if area is None else _per_channel(area, graph, "area")
    rank = np.empty(len(order))
    rank[np.lexsort((-np.arange(len(order)), weight, order))] = np.arange(len(order))
    return order[_stems(graph, rank)]


@public
def horton_ratios(channel_from: ArrayLike, channel_to: ArrayLike, length: ArrayLike, area: ArrayLike) -> HortonRatios:
    """Count, mean length and mean area of the streams of each Strahler order, and the ratios of their laws.

    The ratios are fitted as straight lines of the logarithm over the order, by least squares; NaN for one order. The
    streams of the highest order are often cut off by the map: read the arrays before the ratios.

    Args:
        channel_from: (C,) node upstream of each channel.
        channel_to: (C,) node downstream of it.
        length: (C,) m.
        area: (C,) drainage area at the lower end, m2.
    """
    graph = _Graph(channel_from, channel_to)
    order = _strahler(graph)
    own, drained = _per_channel(length, graph, "length"), _per_channel(area, graph, "area")
    lowest = _stream_ends(graph, order)
    stream = _labels(graph, ~lowest)
    stream_length = np.bincount(stream, weights=own, minlength=len(order))[lowest]
    stream_order = order[lowest] - 1
    count = np.bincount(stream_order)
    mean_length = np.bincount(stream_order, weights=stream_length) / count
    mean_area = np.bincount(stream_order, weights=drained[lowest]) / count
    number = np.arange(1.0, len(count) + 1)
    steps = [_slope(number, np.log(v)) for v in (count, mean_length, mean_area)]
    return HortonRatios(
        count.astype(np.int64), mean_length, mean_area, math.exp(-steps[0]), math.exp(steps[1]), math.exp(steps[2])
    )


@public
def hack_exponent(length: ArrayLike, area: ArrayLike) -> PowerLaw:
    """Hack's law, length of the main stem = coefficient area^exponent, fitted to the logarithms by least squares.

    Args:
        length: (n,) lengths of main stems, from :func:`main_stem_length` or ``flow_length(flow, downstream=False)``, m.
        area: (n,) drainage area at their lower ends, m2.

    Raises:
        ValueError: Fewer than two values, or one that is not positive.
    """
    y, x = _logarithms(length, "length"), _logarithms(area, "area")
    if len(x) != len(y):
        raise InputError(f"length has {len(y)} values and area {len(x)}")
    exponent = _slope(x, y)
    spread = np.ptp(x) > 0.0 and np.ptp(y) > 0.0
    correlation = float(np.corrcoef(x, y)[0, 1]) if spread else math.nan
    return PowerLaw(exponent, math.exp(y.mean() - exponent * x.mean()), correlation)


@public
def exceedance(area: ArrayLike, *, low: float | None = None, high: float | None = None) -> Exceedance:
    """Distribution P(A > a) of drainage areas, and the exponent beta of a^-beta that fits it.

    The fit is one of least squares on points evenly spaced in log a between ``low`` and ``high``: the distribution is
    no power law near a cell's size and near that of the map.

    Args:
        area: Areas of cells or channels in m2; NaN is left out.
        low: Minimum area of the fit; by default ten times the smallest area.
        high: Maximum area of the fit; by default 1 % of the largest area. Where that leaves less than a decade, all
            areas are fitted.

    Raises:
        ValueError: Fewer than two distinct areas, or one that is not positive.
    """
    values = floats(area, "area").reshape(-1)
    values = values[~np.isnan(values)]
    _logarithms(values, "area")
    distinct, count = np.unique(values, return_counts=True)
    if len(distinct) < 2:
        raise InputError(f"all {len(values)} areas are {distinct[0]:g} m2; a distribution needs two")
    probability = 1.0 - np.cumsum(count) / len(values)
    probability[-1] = 0.0
    a = EXCEEDANCE_LOW * distinct[0] if low is None else float(low)
    b = EXCEEDANCE_HIGH * distinct[-1] if high is None else float(high)
    if low is None and high is None and b < 10.0 * a:
        a, b = distinct[0], distinct[-2]
    if not 0.0 < a < b:
        if low is not None or high is not None:
            raise InputError(f"no areas between low, {a:g} m2, and high, {b:g} m2")
        return Exceedance(distinct, probability, math.nan)
    sample = np.geomspace(a, b, EXCEEDANCE_SAMPLES)
    place = np.searchsorted(distinct, sample * (1.0 + 1e-12), side="right") - 1
    fraction = np.where(place >= 0, probability[np.maximum(place, 0)], 1.0)
    seen = fraction > 0.0
    return Exceedance(distinct, probability, -_slope(np.log(sample[seen]), np.log(fraction[seen])))


@public
def tokunaga(channel_from: ArrayLike, channel_to: ArrayLike) -> Tokunaga:
    """Count the side tributaries of streams, order by order, and fit T_k = a c^(k - 1) to them.

    Args:
        channel_from: (C,) node upstream of each channel.
        channel_to: (C,) node downstream of it.
    """
    graph = _Graph(channel_from, channel_to)
    order = _strahler(graph)
    lowest = _stream_ends(graph, order)
    number = int(order.max())
    streams = np.bincount(order[lowest] - 1, minlength=number)
    # A stream of the channel's own order arrives above: what else does so comes from the side.
    goes_on = np.zeros(len(order), bool)
    goes_on[graph.down[~lowest]] = True
    side = np.flatnonzero(lowest & (graph.down >= 0))
    side = side[goes_on[graph.down[side]]]
    matrix = np.zeros((number, number))
    np.add.at(matrix, (order[side] - 1, order[graph.down[side]] - 1), 1.0)
    mean = np.array([np.trace(matrix, k) / streams[k:].sum() for k in range(1, number)])
    matrix /= streams
    k = np.flatnonzero(mean > 0.0)
    if len(k) < 2:
        return Tokunaga(matrix, mean, math.nan, math.nan)
    # Few streams have a large k, and the map cuts them off: each T_k counts by the streams that it is the mean of.
    weight = np.array([streams[i + 1 :].sum() for i in k], np.float64)
    growth, first = np.polyfit(k, np.log(mean[k]), 1, w=np.sqrt(weight))
    return Tokunaga(matrix, mean, math.exp(first), math.exp(growth))


class _Graph:
    """Which channel follows on which, and the channels by level: each after all that flow into it."""

    def __init__(self, channel_from: ArrayLike, channel_to: ArrayLike):
        above, below = np.asarray(channel_from).reshape(-1), np.asarray(channel_to).reshape(-1)
        if len(above) != len(below) or len(above) == 0:
            raise InputError(
                f"channel_from has {len(above)} nodes and channel_to {len(below)}; give one for each channel"
            )
        nodes, label = np.unique(np.concatenate([above, below]), return_inverse=True)
        begin, end = label.reshape(2, -1)
        leaving = np.bincount(begin, minlength=len(nodes))
        if (leaving > 1).any():
            node = int(leaving.argmax())
            raise InputError(f"{leaving[node]} channels leave node {nodes[node]}; orders need water that never splits")
        out = np.full(len(nodes), -1, np.int64)
        out[begin] = np.arange(len(begin))
        self.down: IndexArray = out[end]
        joining = self.down[self.down >= 0]
        self.arriving: IndexArray = np.bincount(joining, minlength=len(begin)).astype(np.int64)
        self.levels = self._levels()

    def _levels(self) -> list[IndexArray]:
        """Channels whose donors are all in earlier levels, level by level."""
        waiting = self.arriving.copy()
        levels = []
        level = np.flatnonzero(waiting == 0)
        done = 0
        while len(level):
            levels.append(level)
            done += len(level)
            below = self.down[level]
            below = below[below >= 0]
            np.subtract.at(waiting, below, 1)
            below = np.unique(below)
            level = below[waiting[below] == 0]
        if done < len(waiting):
            c = int(np.flatnonzero(waiting > 0)[0])
            raise InputError(f"channel {c} belongs to a circle or flows out of one; {len(waiting) - done} do")
        return levels


def _strahler(graph: _Graph) -> IndexArray:
    """Strahler order of each channel."""
    order = np.ones(len(graph.down), np.int64)
    best = np.zeros(len(graph.down), np.int64)
    times = np.zeros(len(graph.down), np.int64)
    for level in graph.levels:
        fed = level[graph.arriving[level] > 0]
        order[fed] = best[fed] + (times[fed] > 1)
        joining = level[graph.down[level] >= 0]
        below, mine = graph.down[joining], order[joining]
        before = best[below]
        np.maximum.at(best, below, mine)
        times[below[best[below] > before]] = 0
        np.add.at(times, below[mine == best[below]], 1)
    return order


def _continues(graph: _Graph, weight: FloatArray | IndexArray) -> FlagArray:
    """Channels of the largest weight among those that arrive at their node; the first of equals."""
    joining = np.flatnonzero(graph.down >= 0)
    by_weight = joining[np.lexsort((-joining, weight[joining]))]
    main = np.full(len(graph.down), -1, np.int64)
    main[graph.down[by_weight]] = by_weight
    chosen = np.zeros(len(graph.down), bool)
    chosen[main[main >= 0]] = True
    return chosen


def _labels(graph: _Graph, continues: FlagArray) -> IndexArray:
    """Lowest channel of the run that each channel belongs to."""
    last = np.arange(len(graph.down))
    last[continues] = graph.down[continues]
    while True:
        further = last[last]
        if (further == last).all():
            return last
        last = further


def _stems(graph: _Graph, weight: FloatArray | IndexArray) -> IndexArray:
    """Lowest channel of each channel's stem."""
    return _labels(graph, _continues(graph, weight))


def _stream_ends(graph: _Graph, order: IndexArray) -> FlagArray:
    """Channels after which the order changes, or water leaves."""
    ends: FlagArray = (graph.down < 0) | (order[graph.down] != order)
    return ends


def _per_channel(values: ArrayLike, graph: _Graph, name: str) -> FloatArray:
    """Return one number a channel, or raise ``ValueError``."""
    array = positive_numbers(values, name).reshape(-1)
    if len(array) != len(graph.down):
        raise InputError(f"{name} has {len(array)} values for {len(graph.down)} channels; give one a channel")
    return array


def _logarithms(values: ArrayLike, name: str) -> FloatArray:
    """Return the logarithms of at least two positive numbers, or raise ``ValueError``."""
    array = floats(values, name).reshape(-1)
    if len(array) < 2 or not (np.isfinite(array) & (array > 0.0)).all():
        raise InputError(f"{name}: give at least two values, all positive and finite; got {len(array)}")
    logarithms: FloatArray = np.log(array)
    return logarithms


def _slope(x: FloatArray, y: FloatArray) -> float:
    """Slope of the straight line of least squares; NaN where x is constant."""
    off = x - x.mean() if len(x) else x
    spread = float(off @ off) if len(x) else 0.0
    return float(off @ y) / spread if spread > 0.0 else math.nan
