"""The water of channels along their lines: levels on the ground that never rise downstream, and smooth finer lines.

The lines of any network, rings and channels that part among them, with a limit of cuts. ``riverscape.profiles`` has the
levels of made-up courses in a tree of channels: with steps, a greatest slope, and nodes whose levels edits keep. Both
take what they share from ``hydrology.drape``.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.graph.forest import leaving_channels
from warpriver.hydrology.drape import falling_levels, without_gaps
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain

__all__ = ["Lines", "WaterProfile", "fine_lines", "lines_of", "water_profile"]


# Places across a section at which the ground is looked at, in half-widths from the middle.
ACROSS = (-1.0, -0.5, 0.0, 0.5, 1.0)


@dataclasses.dataclass(frozen=True)
class Lines:
    """Channels as they are carved: points end to end, of a ring with the first one again at its end.

    Attributes:
        xy: (Q, 2) points in m.
        start: (C + 1,) offsets of the channels.
        source: (Q,) point of the network that a point is.
        half: (Q,) half of the width in m.
        depth: (Q,) m.
    """

    xy: FloatArray
    start: IndexArray
    source: IndexArray
    half: FloatArray
    depth: FloatArray

    @property
    def owner(self) -> IndexArray:
        """(Q,) channel of each point."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))


@dataclasses.dataclass(frozen=True)
class WaterProfile:
    """Water along channels.

    Attributes:
        level: (P,) of the water at the points of the network, m; it never rises downstream.
        cut: (P,) height of the ground over the water or below it, in the section, at most; m.
        excess: (P,) by how much the level lies over the one that cutting alone would have led to, because of the limit
            of cuts; m.
    """

    level: FloatArray
    cut: FloatArray
    excess: FloatArray


def lines_of(network: RiverNetwork) -> Lines:
    """Return the channels of a network with rings closed."""
    start, rings = network.starts().astype(np.int64), network.channel_closed
    index = np.arange(start[-1])
    # A ring has its first point again behind its last one.
    source = np.insert(index, start[1:][rings], start[:-1][rings])
    sizes = np.diff(start) + rings
    width, depth = (np.concatenate(v) for v in (network.point_widths(), network.point_depths()))
    xy = network.points()[source]
    return Lines(xy, np.concatenate([[0], np.cumsum(sizes)]), source, 0.5 * width[source], depth[source])


def water_profile(
    ground: Terrain, network: RiverNetwork, *, fill_fraction: float, max_cut: float, smoothing: float
) -> WaterProfile:
    """Find levels of the water that the ground can hold.

    The lowest ground across the section at each point counts. Of levels that never rise, the highest ones that are
    nowhere above it take cutting alone, the lowest ones that are nowhere below it filling alone; what lies between them
    at any fixed fraction never rises either, nor does the higher of that and the second less the limit of cuts.

    Args:
        ground: The terrain.
        network: The channels.
        fill_fraction: Fraction of the way from cutting to filling, 0 to 1.
        max_cut: Limit of cuts below that ground, m.
        smoothing: Length along the channel over which the levels are averaged, in its widths.
    """
    start = network.starts().astype(np.int64)
    xy, half = network.points(), 0.5 * np.concatenate(network.point_widths())
    left = _normals(xy, start)
    found = ground.sample(np.concatenate([xy + a * half[:, None] * left for a in ACROSS])).reshape(len(ACROSS), -1)
    low = without_gaps(np.fmin.reduce(found), start)
    high = np.where(np.isfinite(found).any(axis=0), np.fmax.reduce(found), low)
    ends, nodes, rings = (network.channel_from, network.channel_to), network.node_count, network.channel_closed
    cutting = falling_levels(low, start, ends, nodes, rings)
    filling = -falling_levels(-low[::-1], start[-1] - start[::-1], (ends[1][::-1], ends[0][::-1]), nodes, rings[::-1])[
        ::-1
    ]
    filling = np.where(np.repeat(rings, np.diff(start)), cutting, filling)
    wanted = _smoothed(cutting + fill_fraction * (filling - cutting), xy, start, smoothing * 2.0 * half)
    wanted = _drowned(wanted, network, xy, start, half)
    level = np.maximum(wanted, filling - max_cut)
    # To the bit: sums round.
    level = falling_levels(level, start, ends, nodes, rings)
    cut = np.minimum(np.maximum(np.abs(high - level), np.abs(low - level)), max_cut)
    return WaterProfile(level, cut, np.maximum(level - wanted, 0.0))


def fine_lines(lines: Lines, step: FloatArray) -> tuple[FloatArray, IndexArray, FloatArray]:
    """Refine lines along cubics through their points.

    Args:
        lines: The lines.
        step: (Q,) maximum distance of the points of the finer line, m.

    Returns:
        (F, 2) points; (F,) point of the lines at or before each, and the fraction of the way to the next one, 0 at the
        points themselves.
    """
    xy, owner = lines.xy, lines.owner
    last = np.zeros(len(xy), bool)
    last[lines.start[1:] - 1] = True
    chord = np.append(np.diff(xy, axis=0), [[0.0, 0.0]], axis=0)
    length = np.hypot(*chord.T)
    pieces = np.where(last, 1, np.maximum(1, np.ceil(length / step))).astype(np.int64)
    base = np.repeat(np.arange(len(xy)), pieces)
    first = np.concatenate([[0], np.cumsum(pieces)[:-1]])
    t = (np.arange(len(base)) - first[base]) / pieces[base]
    tangent = _tangents(chord, length, last, owner)
    u, size = 1.0 - t, length[base, None]
    after = np.minimum(base + 1, len(xy) - 1)
    blend = (t * t * (3.0 - 2.0 * t))[:, None]
    cubic = xy[base] + blend * chord[base]
    cubic += (t * u * u)[:, None] * size * tangent[base] - (t * t * u)[:, None] * size * tangent[after]
    return np.where(t[:, None] > 0.0, cubic, xy[base]), base, t


def _tangents(chord: FloatArray, length: FloatArray, last: FlagArray, owner: IndexArray) -> FloatArray:
    """Return the slope of a cubic at each point per metre of its line, by three points where there are three."""
    unit = chord / np.maximum(length, 1e-300)[:, None]
    before, behind = np.roll(unit, 1, axis=0), unit
    size_before, size_behind = np.roll(length, 1)[:, None], length[:, None]
    tangent = (size_behind * before + size_before * behind) / np.maximum(size_before + size_behind, 1e-300)
    head = np.append(True, np.diff(owner) != 0)
    tangent[head] = unit[head]
    tangent[last] = before[last]
    # Rings go on.
    starts, ends = np.flatnonzero(head), np.flatnonzero(last)
    return _joined(tangent, unit, starts, ends, chord, length)


def _joined(
    tangent: FloatArray, unit: FloatArray, first: IndexArray, last: IndexArray, chord: FloatArray, length: FloatArray
) -> FloatArray:
    """Give lines that end where they begin one tangent there."""
    total = np.add.reduceat(np.where(np.isin(np.arange(len(chord)), last)[:, None], 0.0, chord), first)
    closed = (np.hypot(*total.T) < 1e-9 * length[first]) & (last - first > 2)
    mean = unit[first[closed]] + unit[last[closed] - 1]
    tangent[first[closed]] = tangent[last[closed]] = mean / np.maximum(np.hypot(*mean.T), 1e-300)[:, None]
    return tangent


def _normals(xy: FloatArray, start: IndexArray) -> FloatArray:
    """Return the unit vectors to the left of the flow at each point."""
    ahead, behind = np.arange(len(xy)) + 1, np.arange(len(xy)) - 1
    ahead[start[1:] - 1] -= 1
    behind[start[:-1]] += 1
    along = xy[ahead] - xy[behind]
    left: FloatArray = np.stack([-along[:, 1], along[:, 0]], axis=1)
    left /= np.maximum(np.hypot(*along.T), 1e-300)[:, None]
    return left


def _smoothed(values: FloatArray, xy: FloatArray, start: IndexArray, length: FloatArray) -> FloatArray:
    """Return running means along channels, three times over; what never rises still does not, and ends stay.

    Beyond its ends a channel goes on as its own point reflection.
    """
    counts, channel = np.diff(start), np.repeat(np.arange(len(start) - 1), np.diff(start))
    step = np.append(np.hypot(*np.diff(xy, axis=0).T), 0.0)
    step[start[1:] - 1] = 0.0
    spacing = np.add.reduceat(step, start[:-1]) / np.maximum(counts - 1, 1)
    wanted = np.maximum.reduceat(length, start[:-1]) / np.maximum(spacing, 1e-300)
    # Half of the window of one of three means, in points.
    reach = np.minimum(np.round(wanted / 6.0), (counts - 1) // 2).astype(np.int64)
    index = np.arange(len(values)) - start[:-1][channel]
    for _ in range(3):
        total = np.concatenate([[0.0], np.cumsum(values - values[start[:-1]][channel])])
        base = start[:-1][channel]

        def sum_to(k: IndexArray, total: FloatArray = total, base: IndexArray = base) -> FloatArray:
            found: FloatArray = total[base + k] - total[base]
            return found

        low, high, n = index - reach[channel], index + reach[channel] + 1, counts[channel]
        inside = sum_to(np.minimum(high, n)) - sum_to(np.maximum(low, 0))
        first, final = values[base], values[base + n - 1]
        # Reflected: before the first point -v[k] + 2 v[0], behind the last one 2 v[n - 1] - v.
        before = np.maximum(-low, 0)
        behind = np.maximum(high - n, 0)
        inside += -(sum_to(np.minimum(before + 1, n)) - sum_to(np.minimum(np.ones_like(n), n)))
        edge = final - first
        inside += 2.0 * behind * edge - (sum_to(n - 1) - sum_to(np.maximum(n - 1 - behind, 0)))
        values = np.where(reach[channel] > 0, first + inside / (2 * reach[channel] + 1), values)
    return values


def _drowned(
    level: FloatArray, network: RiverNetwork, xy: FloatArray, start: IndexArray, half: FloatArray
) -> FloatArray:
    """Return levels in which the last reach of a tributary, within the channel that it joins, has the level there."""
    below = np.where(network.channel_closed, -1, leaving_channels(network)[network.channel_to])
    owner = np.repeat(np.arange(network.channel_count), np.diff(start))
    head = start[:-1][np.maximum(below, 0)]
    away = np.hypot(*(xy - xy[start[1:] - 1][owner]).T)
    inside = (below >= 0)[owner] & (away < half[head][owner])
    return np.where(inside, np.minimum(level, level[head][owner]), level)
