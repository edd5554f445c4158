"""Profiles: the water surface along the courses, which never rises downstream, with the steps of steep rivers.

It starts from the lowest ground between the banks. Over the tree of channels that ground has a lower envelope, the
least height upstream, and an upper one, the greatest downstream; any mixture of both falls everywhere [Peytavie2019].

``landscape.profiles`` carves the lines of a network as they are: rings and channels that part as well, with a limit of
cuts, without steps. Both take what they share from ``hydrology.drape``.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.hydrology.drape import running_minimum, without_gaps
from warpriver.parameter import Params, parameter
from warpriver.riverscape.stations import TYPES

__all__ = ["Graph", "ProfileParams", "Steps", "falling_profile", "lay_steps", "step_levels"]


# Types with steps, and the slope of the water between them as a part of the mean slope.
POOLS = {"A+": 0.0, "A": 0.0, "B": 0.4}


@dataclasses.dataclass(frozen=True)
class ProfileParams(Params):
    """Constants of profiles."""

    mix: float = parameter(
        1.0,
        "-",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="share of the lower envelope in the water surface: 1 only cuts, less of it fills hollows",
    )
    freeboard: float = parameter(
        0.25, "mean depths", low=0.0, source="warpriver", doc="height of the lowest ground at the banks over the water"
    )
    smoothing: float = parameter(
        10.0, "widths", low=0.0, source="warpriver", doc="length over which steps of the terrain's raster are graded"
    )
    grade: float = parameter(
        3.0, "-", low=1.0, source="warpriver", doc="greatest slope of a reach over the mean slope of its channel"
    )
    steepening: float = parameter(
        0.3, "m/m", low=0.0, source="warpriver", doc="slope that is added to that greatest slope"
    )
    step_coefficient: float = parameter(
        8.25, "widths", low=0.0, low_open=True, source="Rosgen2001", doc="spacing of steps at a slope of 1 %, in widths"
    )
    step_exponent: float = parameter(
        0.98, "-", low=0.0, source="Rosgen2001", doc="exponent with which it falls as the slope grows"
    )
    closest: float = parameter(1.0, "widths", low=0.1, source="warpriver", doc="least spacing of steps")
    widest: float = parameter(7.0, "widths", low=0.1, source="warpriver", doc="greatest spacing of steps")
    jitter: float = parameter(
        0.3, "-", low=0.0, high=0.9, source="warpriver", doc="how far spacings of steps vary, as a part"
    )
    face: float = parameter(0.6, "m/m", low=0.01, source="warpriver", doc="mean slope of the water over a step")
    cascade_slope: float = parameter(
        0.15, "m/m", low=0.0, low_open=True, source="warpriver", doc="slope of the water from which it is a cascade"
    )
    waterfall: float = parameter(
        1.5, "m", low=0.0, source="warpriver", doc="drop from which the water leaves the bed and falls freely"
    )


class Graph(NamedTuple):
    """Channels between nodes, with values at places along each that lie end to end.

    Attributes:
        start: (C + 1,) offsets of the channels' places.
        above: (C,) node upstream.
        below: (C,) node downstream.
        nodes: Number of nodes.
    """

    start: IndexArray
    above: IndexArray
    below: IndexArray
    nodes: int

    @property
    def channel(self) -> IndexArray:
        """(Q,) channel of each place."""
        return np.repeat(np.arange(len(self.above)), np.diff(self.start))

    def rounds(self) -> list[IndexArray]:
        """Channels in the order in which what lies above them is known, a round at a time."""
        pending = np.bincount(self.below, minlength=self.nodes)
        left, rounds = np.ones(len(self.above), bool), []
        while left.any():
            ready = np.flatnonzero(left & (pending[self.above] == 0))
            if not len(ready):
                raise InputError(f"{int(left.sum())} channels flow in a circle: none of them is the lowest")
            rounds.append(ready)
            np.subtract.at(pending, self.below[ready], 1)
            left[ready] = False
        return rounds


def falling_profile(
    ground: FloatArray, along: FloatArray, graph: Graph, window: FloatArray, steepest: FloatArray, mix: float
) -> FloatArray:
    """Return a water surface that never rises downstream, through all nodes.

    It is the mixture of the envelopes, then cut back to a greatest slope, then graded over a window: of a falling line
    and its mean the lower one. With mix 1 it is nowhere above the ground.

    Args:
        ground: (Q,) height of the lowest ground, infinite where it is not known.
        along: (Q,) distance along each channel, m.
        graph: The channels.
        window: (C,) length of the mean, m.
        steepest: (C,) greatest slope.
        mix: Share of the lower envelope.
    """
    ground = without_gaps(ground, graph.start)
    low = _lower_envelope(ground, graph)
    if mix < 1.0:
        # What meets at a mouth has levels of its own in the upper one.
        low = _lower_envelope(mix * low + (1.0 - mix) * _upper_envelope(ground, graph), graph)
    low = _cut_back(low, along, graph, steepest)
    return np.minimum(low, _graded(low, along, graph, window))


def _lower_envelope(values: FloatArray, graph: Graph) -> FloatArray:
    """The least value upstream, through nodes."""
    z = running_minimum(values, graph.channel)
    last = graph.start[1:] - 1
    level = np.full(graph.nodes, np.inf)
    # A node lies no higher than the head of what leaves it.
    fed = np.isin(graph.above, graph.below)
    np.minimum.at(level, graph.above[fed], z[graph.start[:-1][fed]])
    for ready in graph.rounds():
        z_end = np.minimum(z[last[ready]], level[graph.above[ready]])
        np.minimum.at(level, graph.below[ready], z_end)
    z = np.minimum(z, level[graph.above][graph.channel])
    z[last] = np.minimum(z[last], level[graph.below])
    # A node is as high as what arrives there, and what leaves it begins so.
    first, begins = graph.start[:-1], np.isfinite(level[graph.above])
    z[first[begins]] = level[graph.above[begins]]
    found: FloatArray = z
    return found


def _upper_envelope(values: FloatArray, graph: Graph) -> FloatArray:
    """The greatest value downstream, through nodes: the lower envelope of the negated values, upstream."""
    turned = Graph(len(values) - graph.start[::-1], graph.below[::-1], graph.above[::-1], graph.nodes)
    return -_lower_envelope(-values[::-1], turned)[::-1]


def _cut_back(z: FloatArray, along: FloatArray, graph: Graph, steepest: FloatArray) -> FloatArray:
    """The highest line below a falling one that is nowhere steeper than that, from the mouths up through the nodes."""
    slope, channel, last = steepest[graph.channel], graph.channel, graph.start[1:] - 1
    lift = slope * along
    # From the lower end up: min over s' >= s of z(s') + m s', less m s.
    backwards = np.arange(len(z))[::-1]
    out = running_minimum((z + lift)[backwards], (len(graph.above) - 1 - channel)[backwards])[backwards] - lift
    out = np.minimum(out, z)
    level = np.full(graph.nodes, np.inf)
    first = graph.start[:-1]
    for ready in graph.rounds()[::-1]:
        # Places of these channels, with the level of the node below.
        for c in ready if len(ready) < 4 else ():
            part = slice(first[c], last[c] + 1)
            out[part] = np.minimum(out[part], level[graph.below[c]] + slope[part] * (along[last[c]] - along[part]))
        if len(ready) >= 4:
            counts = np.diff(graph.start)[ready]
            at = (
                np.repeat(first[ready], counts)
                + np.arange(counts.sum())
                - np.repeat(np.cumsum(counts) - counts, counts)
            )
            end = np.repeat(level[graph.below[ready]], counts), np.repeat(along[last[ready]], counts)
            out[at] = np.minimum(out[at], end[0] + slope[at] * (end[1] - along[at]))
        np.minimum.at(level, graph.above[ready], out[first[ready]])
    # Channels that leave one node begin alike, and what arrives there ends so.
    ends = np.isfinite(level[graph.below])
    out[last] = np.where(ends, level[graph.below], z[last])
    begins = np.isfinite(level[graph.above])
    out[first[begins]] = level[graph.above[begins]]
    return out


def _graded(z: FloatArray, along: FloatArray, graph: Graph, window: FloatArray) -> FloatArray:
    """Mean of a falling line over a window that shrinks evenly towards the ends: it falls as well."""
    channel = graph.channel
    length = along[graph.start[1:] - 1][channel]
    half = np.minimum(np.minimum(0.5 * window[channel], along), length - along)
    step = np.append(np.diff(along), 0.0)
    step[graph.start[1:] - 1] = 0.0
    area = np.concatenate([[0.0], np.cumsum(0.5 * step * (z + np.append(z[1:], 0.0)))])[:-1]
    # One coordinate for all channels, in which they do not touch.
    base = np.concatenate([[0.0], np.cumsum(along[graph.start[1:] - 1] + 1.0)])[:-1][channel]
    place = base + along

    def integral(at: FloatArray) -> FloatArray:
        k = np.clip(
            np.searchsorted(place, at, side="right") - 1, graph.start[:-1][channel], graph.start[1:][channel] - 2
        )
        ahead = at - place[k]
        span = place[k + 1] - place[k]
        end = z[k] + (z[k + 1] - z[k]) * ahead / span
        return area[k] + 0.5 * ahead * (z[k] + end)

    wide = half > 1e-9
    mean = (integral(place + half) - integral(place - half)) / np.where(wide, 2.0 * half, 1.0)
    return np.where(wide, mean, z)


class Steps(NamedTuple):
    """Steps of the water surface of steep channels, in order along each.

    A step begins at ``axis`` and is ``length`` long; below it the water falls evenly from ``upper - drop`` to the level
    of the next step.

    Attributes:
        channel: (n,) channel of each.
        axis: (n,) place of its lip along the axis, m.
        end: (n,) place of the next one, or of the end of the channel.
        upper: (n,) level above.
        lower: (n,) level at its foot.
        tail: (n,) level at ``end``.
        length: (n,) m along the axis.
        free: (n,) whether the water falls freely.
        speed: (n,) speed at the lip, m/s.
    """

    channel: IndexArray
    axis: FloatArray
    end: FloatArray
    upper: FloatArray
    lower: FloatArray
    tail: FloatArray
    length: FloatArray
    free: NDArray[np.bool_]
    speed: FloatArray

    def take(self, index: NDArray[np.generic]) -> Steps:
        """Return some of them."""
        return Steps(*(v[index] for v in self))


def lay_steps(
    z: FloatArray,
    along: FloatArray,
    graph: Graph,
    kind: IndexArray,
    slope: FloatArray,
    width: FloatArray,
    speed: FloatArray,
    seed: int,
    params: ProfileParams,
) -> Steps:
    """Lay the steps of channels of types A+, A and B: 8.25 (100 S)^-0.98 widths apart, within 1 to 7, and jittered.

    Args:
        z: (Q,) water surface along the axes, falling.
        along: (Q,) m.
        graph: The channels.
        kind: (C,) types.
        slope: (C,) mean slopes.
        width: (C,) widths, m.
        speed: (C,) mean speed, m/s.
        seed: Seed; each channel has random numbers of its own.
        params: Constants.
    """
    columns: list[list[FloatArray]] = []
    for c in np.flatnonzero([TYPES[k] in POOLS for k in kind]).tolist():
        part = slice(graph.start[c], graph.start[c + 1])
        s, level = along[part], z[part]
        s_mean = max(float(slope[c]), (level[0] - level[-1]) / s[-1], 1e-4)
        apart = params.step_coefficient * (100.0 * s_mean) ** -params.step_exponent
        apart = float(np.clip(apart, params.closest, params.widest)) * width[c]
        random = np.random.default_rng([seed, c, 1])
        count = max(1, round(s[-1] / apart))
        gaps = 1.0 + params.jitter * random.uniform(-1.0, 1.0, count)
        lip = np.concatenate([[0.0], np.cumsum(gaps) / gaps.sum() * s[-1]])
        at = np.interp(lip, s, level)
        fall = at[:-1] - at[1:]
        rest = POOLS[TYPES[kind[c]]] * fall
        drop = fall - rest
        free = drop > params.waterfall
        throw = speed[c] * np.sqrt(2.0 * np.maximum(drop, 0.0) / 9.81)
        length = np.where(free, throw, drop / params.face)
        length = np.clip(length, 1e-3, 0.8 * np.diff(lip))
        one = np.ones(count)
        columns.append([c * one, lip[:-1], lip[1:], at[:-1], at[1:] + rest, at[1:], length, free, speed[c] * one])
    if not columns:
        empty = np.empty(0)
        columns = [[empty] * 9]
    found = [np.concatenate(parts) for parts in zip(*columns, strict=True)]
    channel, lip, end, upper, lower, tail, length, falls_free, fast = found
    return Steps(channel.astype(np.int64), lip, end, upper, lower, tail, length, falls_free.astype(bool), fast)


def step_levels(z: FloatArray, channel: IndexArray, axis: FloatArray, steps: Steps) -> FloatArray:
    """Return the water surface at places, with the steps that their channels have; nowhere higher than without them.

    Over a cascade it falls as a quintic step, over a waterfall as a thrown body, z = -g x^2 / (2 u^2).

    Args:
        z: (P,) level without steps.
        channel: (P,) channel of each place.
        axis: (P,) place along its axis, m.
        steps: The steps.
    """
    if not len(steps.channel):
        return z
    # One coordinate for all channels, so that one search finds the step above each place.
    span = float(max(axis.max(), steps.end.max())) + 1.0
    k = np.searchsorted(steps.channel * span + steps.axis, channel * span + axis, side="right") - 1
    found = (k >= 0) & (steps.channel[k] == channel)
    k = np.maximum(k, 0)
    ahead = np.maximum(axis - steps.axis[k], 0.0)
    t = np.clip(ahead / steps.length[k], 0.0, 1.0)
    part = np.where(steps.free[k], t * t, t * t * t * (t * (6.0 * t - 15.0) + 10.0))
    pool = steps.end[k] - steps.axis[k] - steps.length[k]
    beyond = np.clip((ahead - steps.length[k]) / np.maximum(pool, 1e-12), 0.0, 1.0)
    level = steps.upper[k] + part * (steps.lower[k] - steps.upper[k]) + beyond * (steps.tail[k] - steps.lower[k])
    return np.where(found, np.minimum(z, level), z)
