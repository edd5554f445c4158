"""Statistics by which rivers are told apart, in widths: those of a network or a run, and of two side by side."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from warpriver.errors import InputError
from warpriver.graph.stems import find_stems
from warpriver.history import History
from warpriver.metrics.changes import lag, lognormal_fit, migration, oxbow_lengths
from warpriver.metrics.lines import FloatArray, IndexArray, arc_length_of, points_at, sinuosity
from warpriver.metrics.meanders import bend_curvature, bends
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.validate import positive

__all__ = ["Comparison", "RiverStatistics", "compare", "statistics"]

# Widths of its neighbours that a link is looked at with, so that bends across junctions are whole.
_BESIDE = 30.0
# A bend tighter than this many widths counts as tight.
_TIGHT = 2.0
# Sinuosity of a bend from which on it belongs to the next class, in which it is told how many lean upstream.
_CLASSES = (1.2, 2.0)
# Widths below a junction where curvature is compared with that elsewhere, and above it over which angles are taken.
_BELOW = 3.0
# Degrees below which a tributary counts as nearly parallel.
_NARROW = 25.0
# Between two surveys no displacement of more than so many widths is believed, and no lag of more.
_FARTHEST, _LONGEST_LAG = 1.0, 10.0


def _row(unit: str, doc: str) -> Any:
    return dataclasses.field(default=math.nan, metadata={"unit": unit, "doc": doc})


@dataclasses.dataclass(frozen=True)
class RiverStatistics:
    """What a geomorphologist asks first of a river's planform. Where there is nothing to tell from, a value is nan.

    Lengths are in widths of the channel that they are on, the median of its points. Bends are those of
    :func:`bends`, of rivers that go on through junctions; a bend leans upstream where its apex comes before the middle
    of its arc.
    """

    bends: float = _row("-", "number of bends")
    sinuosity: float = _row("-", "length of all rivers over their chords")
    wavelength: float = _row("widths", "meander wavelength, two bends, mean")
    bend_length: float = _row("widths", "length of a bend along the channel, median")
    radius: float = _row("widths", "radius of curvature at the apex of a bend, median")
    tight_share: float = _row("-", "share of bends tighter than two widths")
    lean_slight: float = _row("-", "share of bends that lean upstream, sinuosity below 1.2")
    lean_middle: float = _row("-", "share of bends that lean upstream, sinuosity 1.2 to 2")
    lean_strong: float = _row("-", "share of bends that lean upstream, sinuosity above 2")
    straight: float = _row("widths", "longest straight reach (radius above 20 widths)")
    straight_below_head: float = _row("widths", "straight reach below the head of a river, greatest")
    lag: float = _row("widths", "distance by which migration follows curvature")
    tributary_angle: float = _row("deg", "angle between a tributary and the main stem above it, median")
    narrow_share: float = _row("-", "share of tributaries that meet it at less than 25 deg")
    junction_curvature: float = _row("-", "curvature within 3 widths below junctions over that elsewhere")
    oxbows: float = _row("-", "number of oxbow lakes")
    oxbow_length: float = _row("widths", "length of an oxbow lake, geometric mean")
    oxbow_spread: float = _row("-", "standard deviation of the logarithm of that length")
    oxbow_skew: float = _row("-", "skewness of that logarithm, 0 of a lognormal distribution")

    def rows(self) -> list[tuple[str, float, str, str]]:
        """Return (name, value, unit, meaning) of every statistic."""
        told = dataclasses.fields(self)
        return [(f.name, float(getattr(self, f.name)), f.metadata["unit"], f.metadata["doc"]) for f in told]

    def __str__(self) -> str:
        return _table([(doc, unit, (value,)) for _, value, unit, doc in self.rows()], ())


@dataclasses.dataclass(frozen=True)
class Comparison:
    """The statistics of two rivers side by side; as text it is a table.

    Attributes:
        a: Those of the first river.
        b: Those of the second one.
    """

    a: RiverStatistics
    b: RiverStatistics

    def rows(self) -> list[tuple[str, float, float, float]]:
        """Return (name, a, b, b - a) of every statistic."""
        both = zip(self.a.rows(), self.b.rows(), strict=True)
        return [(one[0], one[1], other[1], other[1] - one[1]) for one, other in both]

    def __str__(self) -> str:
        told = [
            (doc, unit, (one, other, other - one))
            for (_, one, unit, doc), (_, other, _, _) in zip(self.a.rows(), self.b.rows(), strict=True)
        ]
        return _table(told, ("a", "b", "b - a"))


@public
def compare(a: RiverNetwork | History | RiverStatistics, b: RiverNetwork | History | RiverStatistics) -> Comparison:
    """Set the statistics of two rivers side by side: measured and simulated, before and after.

    Example::

        real, run = wr.read_network("jutai.csv.gz"), wr.read_history("out/jutai/run")
        print(wr.metrics.compare(real, run))

    Args:
        a: A network; a run, whose last record counts, with its cutoffs; or statistics by :func:`statistics`.
        b: The other one, alike.

    Returns:
        Both statistics, as a table where they are printed.

    Raises:
        ValueError: A run without records.
    """
    return Comparison(*(each if isinstance(each, RiverStatistics) else statistics(each) for each in (a, b)))


@public
def statistics(river: RiverNetwork | History, later: RiverNetwork | None = None) -> RiverStatistics:
    """Measure the planform of a river or a network: bends, straight reaches, junctions, oxbow lakes, and their changes.

    Args:
        river: A network, or a run: its last record, and all its cutoffs. The lag is that between its last two records.
        later: The same channels at a later date, or after a year or ten of a run, for the lag of migration behind
            curvature [Sylvester2019]; displacements of more than a width do not count.

    Returns:
        The statistics.

    Raises:
        ValueError: A run without records, or ``later`` with another number of channels.
    """
    if isinstance(river, History):
        if len(river) == 0:
            raise InputError("the history has no records; run the simulation first")
        at_end = river.networks[-1]
        oxbows = _oxbows(river)
        if later is None and len(river) > 1:
            before, after = river.networks[-2], at_end
            return dataclasses.replace(_planform(at_end), **oxbows, lag=_lag(before, after))
        return dataclasses.replace(_planform(at_end), **oxbows, lag=_lag(at_end, later))
    return dataclasses.replace(_planform(river), lag=_lag(river, later))


def _planform(network: RiverNetwork) -> RiverStatistics:
    """All but what changes."""
    reaches = list(_reaches(network))
    found = [_Bends.of(reach) for reach in reaches]
    arc, chord, radius, winding, ahead = np.concatenate(found, axis=1) if found else np.empty((5, 0))
    sizes = {}
    if len(arc):
        sizes = {
            "wavelength": 2.0 * float(chord.mean()),
            "bend_length": float(np.median(arc)),
            "radius": float(np.median(radius)),
            "tight_share": float((radius < _TIGHT).mean()),
        }
        kind = np.searchsorted(_CLASSES, winding, side="right")
        for k, name in enumerate(("lean_slight", "lean_middle", "lean_strong")):
            if (kind == k).any():
                sizes[name] = float(ahead[kind == k].mean())
    longest, below_head = _straight(reaches)
    return RiverStatistics(
        bends=float(len(arc)),
        sinuosity=_winding(network),
        straight=longest,
        straight_below_head=below_head,
        **_junctions(network, reaches),
        **sizes,
    )


class _Reach(NamedTuple):
    """A channel with some of what goes on from it upstream and downstream.

    Attributes:
        channel: Its index.
        stem: Index of the first link of its river.
        order: How many links of it lie upstream.
        closed: It is a ring.
        width: Median width, m.
        xy: (n, 2) its points and those beside it, m.
        first, last: Arc length of its own ends in them, m.
        s, curvature, floor: Arc length, smoothed curvature and what counts as straight, by ``bend_curvature``.
    """

    channel: int
    stem: int
    order: int
    closed: bool
    width: float
    xy: FloatArray
    first: float
    last: float
    s: FloatArray
    curvature: FloatArray
    floor: FloatArray

    def own(self) -> Any:
        """Which samples are the channel's own."""
        return (self.s >= self.first) & (self.s <= self.last)


class _Bends(NamedTuple):
    """Bends of a reach that begin in it, in its widths; ``ahead``: whether the apex comes before the middle."""

    arc: FloatArray
    chord: FloatArray
    radius: FloatArray
    winding: FloatArray
    ahead: FloatArray

    @classmethod
    def of(cls, reach: _Reach) -> _Bends:
        found = bends(reach.xy, reach.width, reach.closed)
        own = np.full(found.start.shape, True)
        if not reach.closed:
            own = (found.start >= reach.first) & (found.start < reach.last)
        ahead = (found.apex < 0.5 * (found.start + found.end)).astype(np.float64)
        sizes = (found.arc / reach.width, found.chord / reach.width, found.radius / reach.width)
        return cls(*(each[own] for each in (*sizes, found.sinuosity, ahead)))


def _reaches(network: RiverNetwork) -> Iterator[_Reach]:
    """Every channel of at least three points, with what goes on from it."""
    stems, lines = find_stems(network), network.polylines()
    widths = [float(np.median(width)) for width in network.point_widths()]
    position = _positions(stems.upper)
    for c, line in enumerate(lines):
        above = _collect(lines, stems.upper, c, _BESIDE * widths[c], upstream=True)
        below = _collect(lines, stems.lower, c, _BESIDE * widths[c], upstream=False)
        xy = _distinct(np.concatenate([above, line, below]))
        if len(xy) < 3 or len(_distinct(line)) < 2:
            continue
        closed = bool(network.channel_closed[c])
        first = float(arc_length_of(np.concatenate([above, line[:1]]))[-1]) if len(above) else 0.0
        last = first + float(arc_length_of(line)[-1])
        s, curvature, floor = bend_curvature(np.concatenate([xy, xy[:1]]) if closed else xy, widths[c])
        yield _Reach(c, int(stems.top[c]), int(position[c]), closed, widths[c], xy, first, last, s, curvature, floor)


def _positions(upper: IndexArray) -> IndexArray:
    """Number of links upstream of each channel in its stem, by doubling."""
    count = (upper >= 0).astype(np.intp)
    jump = upper.astype(np.intp)
    for _ in range(len(upper).bit_length()):
        on = jump >= 0
        count[on] += count[jump[on]]
        jump[on] = jump[jump[on]]
    return count


def _collect(lines: list[FloatArray], following: IndexArray, c: int, reach: float, *, upstream: bool) -> FloatArray:
    """Points next to a channel along its river, over a length, without those at its own ends."""
    parts: list[FloatArray] = []
    link, left = int(following[c]), reach
    while link >= 0 and left > 0.0:
        line = lines[link][::-1] if upstream else lines[link]
        s = arc_length_of(line)
        parts.append(line[1 : int(np.searchsorted(s, left)) + 1])
        left -= float(s[-1])
        link = int(following[link])
    if not parts:
        return np.empty((0, 2))
    found = np.concatenate(parts)
    return found[::-1] if upstream else found


def _distinct(xy: FloatArray) -> FloatArray:
    """A line without points that repeat the one before."""
    return xy[np.concatenate([[True], (np.diff(xy, axis=0) != 0.0).any(axis=1)])] if len(xy) else xy


def _winding(network: RiverNetwork) -> float:
    """Length of all channels over their chords; of rings alone as `sinuosity` has it."""
    lines = network.polylines()
    if network.channel_closed.all():
        return float(np.mean([sinuosity(line, closed=True) for line in lines]))
    lines = [line for line, ring in zip(lines, network.channel_closed, strict=True) if not ring]
    chord = sum(math.hypot(*(line[-1] - line[0])) for line in lines)
    length = sum(float(arc_length_of(line)[-1]) for line in lines)
    return length / chord if chord > 0.0 else math.inf


def _straight(reaches: list[_Reach]) -> tuple[float, float]:
    """Longest straight reach of all rivers, and the longest one that begins at a head, in widths."""
    longest, below_head = math.nan, math.nan
    rivers: dict[int, list[_Reach]] = {}
    for reach in reaches:
        rivers.setdefault(reach.stem, []).append(reach)
    for links in rivers.values():
        place, total = [np.zeros(1)], 0.0
        for reach in sorted(links, key=lambda each: each.order):
            own = reach.own() if not reach.closed else np.full(reach.s.shape, True)
            bent = own & (np.abs(reach.curvature) > reach.floor)
            place.append(total + (reach.s[bent] - reach.first) / reach.width)
            total += (reach.s[own][-1] - reach.s[own][0]) / reach.width if own.any() else 0.0
        bent_at = np.concatenate(place)[1:]
        if links[0].closed:
            gaps = np.diff(bent_at, append=total + bent_at[:1]) if len(bent_at) else np.array([total])
        else:
            gaps = np.diff(bent_at, prepend=0.0, append=total)
            below_head = float(np.fmax(below_head, gaps[0]))
        longest = float(np.fmax(longest, gaps.max()))
    return longest, below_head


def _junctions(network: RiverNetwork, reaches: list[_Reach]) -> dict[str, float]:
    """Angles of tributaries, and curvature below junctions over that elsewhere."""
    stems = find_stems(network)
    arriving = np.bincount(network.channel_to[~network.channel_closed], minlength=network.node_count)
    below = [r for r in reaches if r.order > 0 and arriving[network.channel_from[r.channel]] > 1]
    if not below:
        return {}
    of_channel = {reach.channel: reach for reach in reaches}
    angles = []
    for main in below:
        onward = _direction(main.xy, main.first - _BELOW * main.width, main.first)
        node = network.channel_from[main.channel]
        for c in np.flatnonzero((network.channel_to == node) & ~network.channel_closed).tolist():
            if c != stems.upper[main.channel] and c in of_channel:
                reach = of_channel[c]
                arrival = _direction(reach.xy, reach.last - _BELOW * reach.width, reach.last)
                cosine = float(np.clip(onward @ arrival, -1.0, 1.0))
                angles.append(math.degrees(math.acos(cosine)))
    bent: list[tuple[float, float]] = [(0.0, 0.0), (0.0, 0.0)]
    chosen, lines = {reach.channel for reach in below}, network.polylines()
    for reach in reaches:
        # The channel alone: a corner at the junction itself is no bend below it.
        line = _distinct(lines[reach.channel])
        if reach.closed or len(line) < 3:
            continue
        s, curvature, _ = bend_curvature(line, reach.width)
        size = np.abs(curvature) * reach.width
        near = (s <= _BELOW * reach.width) & (reach.channel in chosen)
        for k, part in enumerate((near, ~near)):
            # By the length of the channel: samples lie closer in narrow ones.
            weight = s[1] / reach.width
            bent[k] = bent[k][0] + weight * float(size[part].sum()), bent[k][1] + weight * float(part.sum())
    near_mean, mean = (total / weight if weight > 0.0 else math.nan for total, weight in bent)
    told = {"junction_curvature": near_mean / mean if mean > 0.0 else math.nan}
    if angles:
        told["tributary_angle"] = float(np.median(angles))
        told["narrow_share"] = float((np.array(angles) < _NARROW).mean())
    return told


def _direction(xy: FloatArray, start: float, end: float) -> FloatArray:
    """Unit vector from one arc length of a line to another one, which may lie beyond its ends."""
    s = arc_length_of(xy)
    a, b = points_at(xy, s, np.array([start, end]))
    size = math.hypot(*(b - a))
    return (b - a) / size if size > 0.0 else np.zeros(2)


def _lag(before: RiverNetwork, after: RiverNetwork | None) -> float:
    """Lag of migration behind curvature in widths, the mean by length over channels that moved; nan without a date."""
    if after is None:
        return math.nan
    if after.channel_count != before.channel_count:
        raise InputError(
            f"later has {after.channel_count} channels where the river has {before.channel_count}; give the same "
            "channels at both dates"
        )
    told, weight = [], []
    for old, new, width in zip(before.polylines(), after.polylines(), before.point_widths(), strict=True):
        w = float(np.median(width))
        s = arc_length_of(old)
        count = round(float(s[-1]) / (0.5 * w))
        if count < 4 * _LONGEST_LAG:
            continue
        even = points_at(old, s, np.linspace(0.0, float(s[-1]), count + 1))
        rate = migration(even, new, max_distance=_FARTHEST * w)
        gap = float(arc_length_of(even)[-1]) / count
        at, bend, _ = bend_curvature(even, w)
        found = lag(np.interp(arc_length_of(even), at, bend), rate, gap, max_lag=_LONGEST_LAG * w)
        if math.isfinite(found):
            told.append(found / w)
            weight.append(float(s[-1]))
    return float(np.average(told, weights=weight)) if told else math.nan


def _oxbows(history: History) -> dict[str, float]:
    """Lengths of the oxbow lakes of a run, each in widths of the channel that left it."""
    cutoffs = history.cutoffs
    if not cutoffs:
        return {"oxbows": 0.0}
    length = oxbow_lengths(cutoffs) / np.array([positive(c.width, "width") for c in cutoffs])
    fit = lognormal_fit(length)
    skew = math.nan
    if len(length) > 2 and fit.log_sd > 0.0:
        log = np.log(length)
        skew = float(((log - log.mean()) ** 3).mean() / log.std() ** 3)
    return {
        "oxbows": float(len(length)),
        "oxbow_length": fit.geometric_mean,
        "oxbow_spread": fit.log_sd,
        "oxbow_skew": skew,
    }


def _table(rows: Sequence[tuple[str, str, tuple[float, ...]]], heads: tuple[str, ...]) -> str:
    """Lines of a table, with a head over each column of numbers if there are any."""
    wide = max(len(doc) + len(unit) + 3 for doc, unit, _ in rows)
    lines = ["".ljust(wide) + "".join(f"{head:>10}" for head in heads)] if heads else []
    for doc, unit, values in rows:
        name = doc if unit == "-" else f"{doc} ({unit})"
        lines.append(name.ljust(wide) + "".join("      none" if math.isnan(v) else f"{v:10.3g}" for v in values))
    return "\n".join(lines)
