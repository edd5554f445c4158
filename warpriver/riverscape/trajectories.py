"""Trajectories: the courses that the rivers of a network take by their types, finer than the network shows.

A coarse course is an axis. Meanders swing about it as sine-generated curves [Langbein1966], the threads of a braided
river wander in its belt, and steep rivers follow it. All meet at the nodes.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.extras import IMPORTING
from warpriver.hydrology.orders import main_stem
from warpriver.network import RiverNetwork
from warpriver.parameter import Params, parameter
from warpriver.riverscape.stations import TYPES
from warpriver.riverscape.templates import TEMPLATES

__all__ = ["Axes", "Lines", "TrajectoryParams", "lay_axes", "lay_lines", "meander_angle", "thread_count"]


# Samples of half a wavelength of a meander, and of the tables of what its angle does.
HALF_WAVE, ANGLES = 48, 200
# Angle up to which a sine-generated curve does not turn back on its axis.
STEEPEST_ANGLE = 0.49 * np.pi
STRAIGHT, MEANDERING, BRAIDED = ("A+", "A"), ("B", "C", "E", "F", "G"), ("D", "DA")
# Least share of a thread of a braided river in the mean share.
LEAST_SHARE = 0.35


@dataclasses.dataclass(frozen=True)
class TrajectoryParams(Params):
    """Constants of trajectories."""

    wavelength: float = parameter(
        11.0, "widths", low=1.0, source="Leopold1960", doc="wavelength of meanders along the axis, in widths"
    )
    variation: float = parameter(
        0.25, "-", low=0.0, high=0.9, source="warpriver", doc="how far wavelengths and angles of bends vary, as a part"
    )
    shown_cells: float = parameter(
        8.0,
        "cells",
        low=0.0,
        source="warpriver",
        doc="cells of a wavelength from which a terrain shows its bends itself",
    )
    braid_belt: float = parameter(
        2.2, "-", low=1.0, source="Rosgen1994", doc="width of a braided belt over the sum of its threads' widths"
    )
    anastomosing_belt: float = parameter(
        4.0, "-", low=1.0, source="warpriver", doc="the same of type DA, whose threads lie farther apart"
    )
    most_threads: int = parameter(7, "-", low=3, source="warpriver", doc="greatest number of threads")
    least_threads: int = parameter(3, "-", low=2, source="warpriver", doc="least number of threads of a braided river")


class Axes(NamedTuple):
    """Coarse courses of channels, finely sampled: points lie end to end, evenly spaced in each channel.

    Attributes:
        start: (C + 1,) offsets.
        xy: (Q, 2) m.
        tangent: (Q, 2) unit vector downstream.
        along: (Q,) distance from the channel's head, m.
        length: (C,) m.
        stem: (C,) main stem of each channel, named by its lowest channel.
    """

    start: IndexArray
    xy: FloatArray
    tangent: FloatArray
    along: FloatArray
    length: FloatArray
    stem: IndexArray


class Lines(NamedTuple):
    """Lines of courses, densely sampled: points lie end to end.

    Attributes:
        start: (K + 1,) offsets.
        xy: (P, 2) m.
        axis: (P,) place along the channel's axis, m; it grows downstream.
        share: (P,) part of the channel's flow.
        channel: (K,) channel of each line.
        thread: (K,) its number in the channel; -1 for the plain of a braided river.
        belt: (P,) width of the plain, m; NaN for lines of water.
    """

    start: IndexArray
    xy: FloatArray
    axis: FloatArray
    share: FloatArray
    channel: IndexArray
    thread: IndexArray
    belt: FloatArray

    def ends(self, axes: Axes) -> tuple[FlagArray, FlagArray]:
        """Whether each line begins at its channel's upper node, and whether it ends at the lower one, (K,) each."""
        last = self.axis[self.start[1:] - 1]
        return self.axis[self.start[:-1]] <= 0.0, last >= axes.length[self.channel] * (1.0 - 1e-12)


def _angle_tables() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles, sinuosity 1 / J0 and amplitude over the chord of half a wavelength."""
    angle = np.linspace(0.0, STEEPEST_ANGLE, ANGLES)
    phase = np.cos(np.pi * (np.arange(512) + 0.5) / 512)
    direction = angle[:, None] * phase
    advance = np.cos(direction).mean(axis=1)
    return angle, 1.0 / advance, np.cumsum(np.sin(direction), axis=1).max(axis=1) / 512 / advance


ANGLE, SINUOSITY, AMPLITUDE = _angle_tables()


def meander_angle(sinuosity: float) -> float:
    """Return the angle of the sine-generated curve of a sinuosity, 1 / J0(angle), up to 2.1."""
    return float(np.interp(sinuosity, SINUOSITY, ANGLE))


def thread_count(kind: int, flow: FloatArray, params: TrajectoryParams) -> IndexArray:
    """Number of threads of types D and DA by flow in m3/s: round(1 + phi^(1/3)), one more of DA; 1 of other types."""
    if TYPES[kind] not in BRAIDED:
        return np.ones(np.shape(flow), np.int64)
    count = np.rint(1.0 + np.cbrt(flow)).astype(np.int64)
    return np.clip(count, params.least_threads, params.most_threads) + (TYPES[kind] == "DA")


def lay_axes(network: RiverNetwork, spacing: FloatArray, held: FloatArray | None = None) -> Axes:
    """Sample the channels' lines evenly on a cubic spline through each main stem, so that stems bend smoothly at nodes.

    Args:
        network: A forest.
        spacing: (C,) greatest distance between points, m.
        held: (C, 2, 2) directions in which channels are to leave and to reach their nodes; NaN: any. Those of which one
            is given are splines of their own.
    """
    with IMPORTING:
        from scipy.interpolate import CubicSpline

    start, xy = network.starts().astype(np.int64), network.points()
    stem = main_stem(network.channel_from, network.channel_to, network.channel_flow())
    below = {int(node): c for c, node in enumerate(network.channel_from)}
    count = network.channel_count
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = [(np.empty(0),) * 3] * count

    def sample(c: int, spline: Any, a: float, b: float) -> None:
        at = np.linspace(a, b, max(4, int(np.ceil((b - a) / spacing[c]))) + 1)
        ahead = spline(at, 1)
        parts[c] = (spline(at), ahead / np.hypot(*ahead.T)[:, None], at)

    own: FlagArray = np.zeros(count, bool) if held is None else np.asarray(np.isfinite(held).any(axis=(1, 2)))
    for chain in _chains(stem, network.channel_from, network.channel_to, below):
        if own[chain].all():
            continue
        joined = [xy[start[c] : start[c + 1]] for c in chain]
        line = np.concatenate([joined[0], *(part[1:] for part in joined[1:])])
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        spline = CubicSpline(arc, line)
        ends = np.concatenate([[0], np.cumsum([len(part) - 1 for part in joined])])
        for k, c in enumerate(chain):
            sample(c, spline, arc[ends[k]], arc[ends[k + 1]])
    for c in np.flatnonzero(own).tolist():
        assert held is not None
        line = xy[start[c] : start[c + 1]]
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        bounds = tuple((1, toward) if np.isfinite(toward).all() else "not-a-knot" for toward in held[c])
        sample(c, CubicSpline(arc, line, bc_type=bounds), 0.0, arc[-1])
    counts = np.array([len(p[0]) for p in parts])
    offsets = np.concatenate([[0], np.cumsum(counts)])
    points = np.concatenate([p[0] for p in parts])
    step = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T)])
    step[offsets[:-1]] = 0.0
    total = np.cumsum(step)
    along = total - np.repeat(total[offsets[:-1]], counts)
    return Axes(offsets, points, np.concatenate([p[1] for p in parts]), along, along[offsets[1:] - 1], stem)


def _chains(
    stem: IndexArray, above: NDArray[np.int32], below_node: NDArray[np.int32], below: dict[int, int]
) -> list[list[int]]:
    """Channels of each main stem, from the top down."""
    head: dict[int, int] = {}
    arriving = {(int(stem[c]), int(node)) for c, node in enumerate(below_node)}
    for c in range(len(stem)):
        if (int(stem[c]), int(above[c])) not in arriving:
            head[int(stem[c])] = c
    chains = []
    for name, c in head.items():
        chain = [c]
        while (following := below.get(int(below_node[chain[-1]]))) is not None and stem[following] == name:
            chain.append(following)
        chains.append(chain)
    return chains


def lay_lines(
    axes: Axes,
    kind: IndexArray,
    flow: FloatArray,
    width: FloatArray,
    room: FloatArray,
    swings: NDArray[np.bool_],
    seed: int,
    params: TrajectoryParams,
) -> Lines:
    """Lay the lines of all channels about their axes.

    Args:
        axes: The axes.
        kind: (C,) type of each channel.
        flow: (Q,) discharge along the axes, m3/s.
        width: (C,) width of a thread of the mean flow in m; of a braided river that of one that carries all.
        room: (Q, 2) width of level ground to the left and right of the axes, m; infinite where nothing confines.
        swings: (C,) whether a channel is to meander or to braid; the others follow their axes.
        seed: Seed; each channel has random numbers of its own.
        params: Constants.
    """
    made: list[_Line] = []
    for c in range(len(kind)):
        random = np.random.default_rng([seed, c])
        part = slice(axes.start[c], axes.start[c + 1])
        axis = _Axis(axes.along[part], axes.xy[part], axes.tangent[part], room[part])
        name, template = TYPES[kind[c]], TEMPLATES[kind[c]]
        if swings[c] and name in BRAIDED:
            made += _braid(axis, c, thread_count(int(kind[c]), flow[part], params), width[c], name, random, params)
        elif swings[c] and name in MEANDERING:
            made.append(_meander(axis, c, width[c], template.sinuosity, random, params))
        else:
            made.append(_followed(axis, c))
    counts = np.array([len(line.xy) for line in made])
    return Lines(
        np.concatenate([[0], np.cumsum(counts)]),
        np.concatenate([line.xy for line in made]),
        np.concatenate([line.axis for line in made]),
        np.concatenate([line.share for line in made]),
        np.array([line.channel for line in made]),
        np.array([line.thread for line in made]),
        np.concatenate([line.belt for line in made]),
    )


class _Axis(NamedTuple):
    along: FloatArray
    xy: FloatArray
    tangent: FloatArray
    room: FloatArray

    @property
    def length(self) -> float:
        return float(self.along[-1])

    def beside(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Places at a distance along the axis, y to its left."""
        middle = np.column_stack([np.interp(x, self.along, self.xy[:, k]) for k in (0, 1)])
        ahead = np.column_stack([np.interp(x, self.along, self.tangent[:, k]) for k in (0, 1)])
        ahead /= np.hypot(*ahead.T)[:, None]
        return middle + y[:, None] * np.column_stack([-ahead[:, 1], ahead[:, 0]])


class _Line(NamedTuple):
    xy: FloatArray
    axis: FloatArray
    share: FloatArray
    belt: FloatArray
    channel: int
    thread: int = 0


def _followed(axis: _Axis, channel: int) -> _Line:
    count = len(axis.along)
    return _Line(axis.xy, axis.along, np.ones(count), np.full(count, np.nan), channel)


def _meander(
    axis: _Axis, channel: int, width: float, sinuosity: float, random: np.random.Generator, params: TrajectoryParams
) -> _Line:
    """Half wavelengths of sine-generated curves, each from one inflection to the next, alternately left and right.

    theta = w cos(pi s / m) over the arc m of half a wavelength begins and ends on the axis, whatever its w and m, so
    that bends of different sizes follow each other without drifting away.
    """
    wave = params.wavelength * width
    bends = round(2.0 * axis.length / wave)
    if bends < 2:
        return _followed(axis, channel)
    chord = 1.0 + params.variation * random.uniform(-1.0, 1.0, bends)
    chord *= axis.length / chord.sum()
    angle = meander_angle(sinuosity) * (1.0 + 0.4 * params.variation * random.uniform(-1.0, 1.0, bends))
    side = np.where((np.arange(bends) + random.integers(2)) % 2 == 0, 1.0, -1.0)
    middle = np.cumsum(chord) - 0.5 * chord
    room = np.where(side > 0.0, *(np.interp(middle, axis.along, axis.room[:, k]) for k in (0, 1)))
    # The belt's edge is the outer bank.
    reach = np.maximum(room - 0.5 * width, 0.0) / chord
    angle = np.minimum(angle, np.interp(np.minimum(reach, AMPLITUDE[-1]), AMPLITUDE, ANGLE))
    x, y = _half_waves(chord, angle)
    x += (np.cumsum(chord) - chord)[:, None]
    y *= side[:, None]
    x, y = np.append(x[:, :-1].ravel(), axis.length), np.append(y[:, :-1].ravel(), 0.0)
    if params.variation > 0.0:
        x, y = _eased(x, y, width)
    # Where a node holds the end the bends grow over most of a wavelength.
    y = y * _grow(np.minimum(x, axis.length - x) / min(0.8 * wave, 0.5 * axis.length))
    return _Line(axis.beside(x, y), x, np.ones(len(x)), np.full(len(x), np.nan), channel)


def _half_waves(chord: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (n, HALF_WAVE + 1) along and beside the axis, from inflection to inflection."""
    fine = 8
    phase = np.cos(np.pi * (np.arange(HALF_WAVE * fine) + 0.5) / (HALF_WAVE * fine))
    direction = angle[:, None] * phase
    east, north = np.cumsum(np.cos(direction), axis=1), np.cumsum(np.sin(direction), axis=1)
    scale = (chord / east[:, -1])[:, None]
    zero = np.zeros((len(chord), 1))
    x, y = (np.concatenate([zero, v[:, fine - 1 :: fine] * scale], axis=1) for v in (east, north))
    return x, y


def _eased(x: FloatArray, y: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """Take out the corners at inflections, where bends of different angles meet, over half a width; the ends stay."""
    with IMPORTING:
        from scipy.ndimage import gaussian_filter1d

    even = np.linspace(x[0], x[-1], len(x))
    spread = 0.5 * width / (np.hypot(np.diff(x), np.diff(y)).sum() / (len(x) - 1))
    off, aside = (gaussian_filter1d(v, spread, mode="nearest") for v in (x - even, y))
    off[[0, -1]] = 0.0
    return np.maximum.accumulate(even + off), aside


def _grow(t: FloatArray) -> FloatArray:
    t = np.clip(t, 0.0, 1.0)
    return t * t * t * (t * (6.0 * t - 15.0) + 10.0)


def _braid(
    axis: _Axis,
    channel: int,
    number: IndexArray,
    width: float,
    name: str,
    random: np.random.Generator,
    params: TrajectoryParams,
) -> list[_Line]:
    """Threads that wander across a belt, part and meet, and the plain between them.

    Args:
        axis: The axis.
        channel: Its number.
        number: (n,) of threads along the axis; where it changes, threads leave or join the nearest one.
        width: Of one thread that carries all water, m.
        name: Type.
        random: Of what is drawn.
        params: Constants.
    """
    count = int(number.max())
    share = np.maximum(random.gamma(3.0, size=count) / 3.0, LEAST_SHARE)
    share /= share.sum()
    # The width of a section grows like the root of its area, and that nearly like its flow.
    threads = width * np.sqrt(share)
    belt = threads.sum() * (params.anastomosing_belt if name == "DA" else params.braid_belt)
    step = max(0.2 * threads.min(), axis.length / 20000.0)
    x = np.linspace(0.0, axis.length, max(8, int(np.ceil(axis.length / step))) + 1)
    room = [np.interp(x, axis.along, axis.room[:, k]) for k in (0, 1)]
    # They come together over a belt's width above each node; a short channel has room for little.
    gather = min(1.2 * belt, 0.35 * axis.length)
    apart = _grow(np.minimum(x, axis.length - x) / gather)
    wander = _wander(x, count, belt, random)
    beside = np.minimum(0.5 * belt, np.where(wander > 0.0, *room))
    half = np.maximum(beside - 0.5 * threads[:, None], 0.0)
    y = apart * half * wander
    runs = _runs(_steady(number[np.searchsorted(axis.along, x).clip(max=len(number) - 1)], x, gather), count)
    y, shares = _joined_threads(y, np.broadcast_to(share[:, None], y.shape), runs, x, gather)
    # Where the threads are one, each has all of the water: they are one section there.
    one = 1.0 - _grow(np.minimum(x, axis.length - x) / (0.6 * gather))
    made: list[_Line] = []
    for k, first, stop in runs:
        part = slice(first, stop)
        carried = shares[k] + (1.0 - shares[k]) * one
        nothing = np.full(stop - first, np.nan)
        made.append(_Line(axis.beside(x[part], y[k][part]), x[part], carried[part], nothing, channel, len(made)))
    left, right = (apart * np.minimum(0.5 * belt, side) for side in room)
    made.append(_Line(axis.beside(x, 0.5 * (left - right)), x, np.ones(len(x)), left + right, channel, -1))
    return made


def _steady(number: IndexArray, x: FloatArray, gather: float) -> IndexArray:
    """Numbers of threads that change only where there is room for it: two gathers from the ends and each other."""
    change = np.flatnonzero(np.diff(number)) + 1
    kept: list[int] = []
    for k in change.tolist():
        since = x[kept[-1]] if kept else 0.0
        if x[k] - since >= 2.0 * gather and x[-1] - x[k] >= 2.0 * gather:
            kept.append(k)
    part = np.searchsorted(kept, np.arange(len(x)), side="right")
    # The number in the middle of each stretch.
    edges = np.array([0, *kept, len(x)])
    middle = (edges[:-1] + edges[1:]) // 2
    return np.asarray(number[np.minimum(middle, len(x) - 1)][part])


def _runs(number: IndexArray, count: int) -> list[tuple[int, int, int]]:
    """Where each thread flows: its number, first place and the one behind the last; thread k where there are more."""
    runs = []
    for k in range(count):
        on = np.concatenate([[0], (number > k).astype(np.int64), [0]])
        begin, end = np.flatnonzero(np.diff(on) > 0), np.flatnonzero(np.diff(on) < 0)
        runs += [(k, int(a), int(b)) for a, b in zip(begin, end, strict=True)]
    return runs


def _joined_threads(
    y: FloatArray, share: FloatArray, runs: list[tuple[int, int, int]], x: FloatArray, gather: float
) -> tuple[FloatArray, FloatArray]:
    """Let threads that begin or end on the way leave or join the nearest one, with its water.

    Where they part both are one section, with the water of both, as at nodes.
    """
    y, total = y.copy(), share.copy()
    joints: list[tuple[int, int, FloatArray]] = []
    for k, first, stop in sorted(runs, reverse=True):
        for place, ahead, open_ended in (
            (first, x - x[first], first == 0),
            (stop - 1, x[stop - 1] - x, stop == len(x)),
        ):
            if open_ended:
                continue
            others = [j for j, a, b in runs if j < k and a <= place < b]
            nearest = min(others, key=lambda j: abs(y[j][place] - y[k][place]))
            grown = np.where(ahead < 0.0, 0.0, _grow(ahead / gather))
            total[nearest] = total[nearest] + total[k][place] * (1.0 - grown)
            joints.append((k, nearest, grown))
    line = total.copy()
    # From those that are there all along to those that leave them.
    for k, nearest, grown in reversed(joints):
        y[k] = y[nearest] + grown * (y[k] - y[nearest])
        line[k] = line[k] + (line[nearest] - line[k]) * (1.0 - grown)
    return y, line


def _wander(x: FloatArray, count: int, belt: float, random: np.random.Generator) -> FloatArray:
    """Places of threads across the belt, (count, n) from -1 to 1.

    They change sides in turn, like the strands of a braid, in waves that grow longer and shorter on the way.
    """
    wave, drift = belt * random.uniform(2.6, 3.4), belt * random.uniform(5.0, 9.0)
    turn = 2.0 * np.pi * x / wave + 0.8 * np.sin(2.0 * np.pi * x / drift + random.uniform(0.0, 2.0 * np.pi))
    turn += random.uniform(0.0, 2.0 * np.pi)
    total = np.empty((count, len(x)))
    for k in range(count):
        strand = np.sin(turn + 2.0 * np.pi * (k + random.uniform(-0.2, 0.2)) / count)
        waves, phase = belt * random.uniform(1.1, 2.6, 2), random.uniform(0.0, 2.0 * np.pi, 2)
        own = np.sin(2.0 * np.pi * x / waves[:, None] + phase[:, None])
        total[k] = 1.1 * strand + 0.35 * own[0] + 0.25 * own[1]
    return np.tanh(total)
