"""Junctions: the angle at which a tributary arrives, by how its flow compares with the other one's; and their drift.

Rivers of like size meet at a narrow angle; a small one meets a large one nearly at a right angle [Hooshyar2017,
Paris2023, Sec. 6.1]. A simulation eases the last reach of each tributary towards the angle of its template, and lets
junctions wander to where the tributary lies on the outer bank, unless it is told to leave them as they come.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from warpriver.device import PRECISIONS
from warpriver.engine.phase import Phase
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.graph.forest import leaving_channels
from warpriver.kernels import junctions as kernels
from warpriver.network import RiverNetwork
from warpriver.params import JunctionParams
from warpriver.public import public
from warpriver.validate import positive

__all__ = ["JunctionParams", "MoveJunctions", "arrival_angles", "junction_angles", "shape_junctions"]

# Widths of the channel below over which the last reach of a tributary is straight.
STRAIGHT = 1.5
# Junctions wander with all their speed from the curvature over the width on that bends towards the tributary.
BEND = 0.1
# Where a tributary arrives at less than the first over its last reach the junction wanders back; from the second one on
# it wanders freely, and from the third on along either bank, degrees.
LEAST_ANGLE, FREE_ANGLE, MOST_ANGLE = 45.0, 75.0, 120.0


@public
def junction_angles(network: RiverNetwork, params: JunctionParams | None = None) -> np.ndarray:
    """Angle at which each channel arrives at a junction, against the direction of the channel below it.

    Args:
        network: The network; flow is its drainage area, or its discharge where that is not known.
        params: Template constants.

    Returns:
        (C,) rad: the narrow angle for equal flows, widening to the wide one for the lesser of unequal ones and to 0 for
        the greater; NaN for channels that reach no junction of two.
    """
    params = params or JunctionParams()
    meets, likeness, lesser = _meetings(network)
    angle = np.where(lesser, _lesser_angle(likeness, params), _greater_angle(likeness, params))
    return np.where(meets, angle, np.nan)


def _meetings(network: RiverNetwork) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether each channel meets just one other at its foot and goes on, how like their flows are, if its is less."""
    flow = network.channel_flow()
    count = np.bincount(network.channel_to, minlength=network.node_count)
    leaving = np.bincount(network.channel_from, minlength=network.node_count)
    meets = ((count == 2) & (leaving == 1))[network.channel_to]
    total = np.bincount(network.channel_to, weights=flow, minlength=network.node_count)
    other = np.where(meets, total[network.channel_to] - flow, flow)
    likeness = np.minimum(flow, other) / np.maximum(np.maximum(flow, other), 1e-300)
    return meets, np.clip(likeness, 0.0, 1.0), flow <= other


def _lesser_angle(likeness: np.ndarray, params: JunctionParams) -> np.ndarray:
    """Angle of the lesser tributary, rad, by the ratio of the flows."""
    narrow, wide = np.radians(params.narrow_angle), np.radians(params.wide_angle)
    return np.asarray(wide + (narrow - wide) * likeness**params.exponent)


def _greater_angle(likeness: np.ndarray, params: JunctionParams) -> np.ndarray:
    """Angle of the greater one, rad: it turns aside only where the flows are alike."""
    return np.asarray(np.radians(params.narrow_angle) * likeness ** (3.0 * params.exponent))


@public
def arrival_angles(network: RiverNetwork, reach: float = 1.0) -> np.ndarray:
    """Angle at which each channel does arrive at a junction, against the direction of the channel below it.

    Both directions are those of the chords over the same length next to the junction, at most half of each channel.

    Args:
        network: The network.
        reach: Length of the chords, in widths of the channel below.

    Returns:
        (C,) rad from 0 to pi; NaN for channels that reach no junction of two.
    """
    reach = positive(reach, "reach", "widths")
    lines = _Lines(network)
    near = reach * lines.width_below
    own, below = -lines.upstream(near), lines.downstream(near)[lines.below]
    return np.where(lines.meets, np.abs(_turn(own, below)), np.nan)


@public
def shape_junctions(network: RiverNetwork, params: JunctionParams | None = None) -> RiverNetwork:
    """Return a network whose tributaries arrive at the template's angles; nodes and everything upstream stay.

    Elevations of its points, ``point_z``, are those of the lines as they were and are dropped.

    The last reach of a tributary becomes a cubic that leaves its old course with its direction, and a straight end that
    arrives at the node at the angle of :func:`junction_angles`, from the side on which the tributary lies.

    Args:
        network: The network.
        params: Template constants.
    """
    params = params or JunctionParams()
    angle = junction_angles(network, params)
    shaped = np.isfinite(angle)
    if not shaped.any():
        return network.to()
    lines = _Lines(network)
    xy, start, s, owner, length = lines.xy, lines.start, lines.arc, lines.owner, lines.length
    reach = np.minimum(0.5 * params.reach * (network.channel_width + lines.width_below), 0.5 * length)
    near = STRAIGHT * lines.width_below
    below, own = lines.downstream(near)[lines.below], lines.upstream(near)
    # Going round the node from the channel below to the other tributary, it comes first on the left.
    to_own, to_other = (np.mod(_turn(below, way), 2.0 * np.pi) for way in (own, own[lines.beside]))
    arriving = _rotated(below, np.where(to_own < to_other, -1.0, 1.0) * np.where(shaped, angle, 0.0))
    # Where the shaped reach begins, and the direction there.
    begin = np.clip(lines.first_beyond(length - reach), start[:-1] + 1, start[1:] - 2)
    first, leaving = xy[begin], _unit(xy[begin + 1] - xy[begin - 1])
    span, node = length - s[begin], xy[start[1:] - 1]
    # The last of it runs straight, in the direction in which it arrives.
    end = np.minimum(near, 0.5 * span)
    mouth = node - end[:, None] * arriving
    chord = np.maximum(np.hypot(*(mouth - first).T), 1e-30)
    inside = shaped[owner] & (np.arange(len(xy)) >= begin[owner])
    c = owner[inside]
    along = (s[inside] - s[begin[c]]) / span[c] * (chord + end)[c]
    t = np.minimum(along / chord[c], 1.0)[:, None]
    u = 1.0 - t
    cubic = first[c] + t * t * (3.0 - 2.0 * t) * (mouth[c] - first[c])
    cubic += chord[c][:, None] * t * u * (u * leaving[c] - t * arriving[c])
    cubic += np.maximum(along - chord[c], 0.0)[:, None] * arriving[c]
    moved = xy.copy()
    moved[inside] = cubic
    moved[start[1:] - 1] = node
    result = network.to()
    result.point_z = None
    result.point_xy.assign(moved.astype(PRECISIONS[result.dtype][2]))
    return result


class _Lines:
    """The lines of a network near their ends.

    Attributes:
        xy: (P, 2) points in m, relative to the network's origin; ``start``, ``owner``: which are whose.
        arc: (P,) arc length from the head of the channel, m; ``length``: (C,) that of the whole.
        meets: (C,) whether each channel meets just one other at its foot, from which one goes on.
        below: (C,) the channel that goes on from the foot of each, itself where none does.
        beside: (C,) the other one that meets it there, itself where there is none.
        width_below: (C,) width of the channel that goes on, m.
    """

    def __init__(self, network: RiverNetwork):
        self.start = start = network.starts()
        self.xy = network.points() - network.origin
        count = network.channel_count
        self.owner = np.repeat(np.arange(count), np.diff(start))
        self.arc = _arc(self.xy, start)
        self.length = self.arc[start[1:] - 1]
        self.meets, _, _ = _meetings(network)
        # All channels laid end to end, so that one search serves them all.
        self._offset = np.concatenate([[0.0], np.cumsum(self.length + 1.0)[:-1]])
        own, below = np.arange(count), leaving_channels(network)[network.channel_to]
        self.below = np.where(below >= 0, below, own)
        self.beside = np.where(self.meets, _other_at_foot(network), own)
        self.width_below = network.channel_width[self.below]

    def first_beyond(self, arc: np.ndarray) -> np.ndarray:
        """Return the first point of each channel, of all, that lies so far from its head or farther, (C,)."""
        point: np.ndarray = np.searchsorted(self.arc + self._offset[self.owner], self._offset + arc)
        return point

    def _place(self, arc: np.ndarray) -> np.ndarray:
        """Return the point of each channel at an arc length from its head, (C, 2) m."""
        after = np.clip(self.first_beyond(arc), self.start[:-1] + 1, self.start[1:] - 1)
        step = np.maximum(self.arc[after] - self.arc[after - 1], 1e-30)
        part = np.clip((arc - self.arc[after - 1]) / step, 0.0, 1.0)[:, None]
        return np.asarray((1.0 - part) * self.xy[after - 1] + part * self.xy[after])

    def upstream(self, away: np.ndarray) -> np.ndarray:
        """Return the unit vector from the foot of each channel to the point so far upstream, half of it at most."""
        return _unit(self._place(self.length - np.minimum(away, 0.5 * self.length)) - self.xy[self.start[1:] - 1])

    def downstream(self, away: np.ndarray) -> np.ndarray:
        """Return that from the head of each channel, at ``away`` of which (C,) the greatest that ends there counts."""
        most = np.zeros(len(self.length))
        np.maximum.at(most, self.below, away)
        return _unit(self._place(np.minimum(most, 0.5 * self.length)) - self.xy[self.start[:-1]])


def _other_at_foot(network: RiverNetwork) -> np.ndarray:
    """Return the other channel at the foot of each where two end there, -1 elsewhere, (C,)."""
    own = np.arange(network.channel_count)
    count = np.bincount(network.channel_to, minlength=network.node_count)
    # Of two the sum of the numbers tells the other one.
    total = np.bincount(network.channel_to, weights=own, minlength=network.node_count).astype(np.int64)
    return np.where((count == 2)[network.channel_to], total[network.channel_to] - own, -1)


def _arc(xy: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Arc length of each point from its channel's head, (P,)."""
    step = np.concatenate([[0.0], np.hypot(*np.diff(xy, axis=0).T)])
    step[start[:-1]] = 0.0
    total = np.cumsum(step)
    arc: np.ndarray = total - np.repeat(total[start[:-1]], np.diff(start))
    return arc


def _turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle by which each direction turns to become another one, rad, to the left above 0."""
    angle: np.ndarray = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    return angle


def _rotated(a: np.ndarray, angle: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * a[:, 0] - s * a[:, 1], s * a[:, 0] + c * a[:, 1]], axis=1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    size = np.hypot(*vectors.T)[:, None]
    unit: np.ndarray = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)
    return unit


class MoveJunctions(Phase):
    """Moves nodes with the river that goes on through them; shapes the mouths of tributaries, and lets them wander.

    It works on ``state.point_moved``. Where junctions are held it moves through nodes alone.

    Attributes:
        downstream: (C,) int32, the channel that each flows into, -1 if none; ``tributaries``: how many flow into it.
        drift: (C,) speed of the junction at its head, m/yr; ``active``, ``shift``: scratch.
        beside: (C,) int32, the other channel that flows into the one downstream; ``lesser``: the tributary at the head
            that is led; ``angle``: that of the template, rad; ``ease``: how fast a mouth takes it, 1/yr.
        loosen: (C,) how fast a corner at a locked point is rounded, 1/yr.
        aim: (C,) direction in which each arrives; ``lead``: part of the speed with which its mouth wanders.
    """

    name = "junctions"

    def __init__(
        self, rate: Callable[[np.ndarray, Any], np.ndarray], *, follows: str, drifts: bool, shape: JunctionParams | None
    ):
        """Say what moves nodes.

        Args:
            rate: (width, params) -> the rate k, m/yr, at a fraction of which junctions drift.
            follows: "stems", "through nodes" or "nothing": where rivers go on through nodes.
            drifts: Whether junctions drift.
            shape: Templates of the mouths, or None.
        """
        self._rate, self._drifts, self._shape = rate, drifts, shape
        self.follows_stems, self.follows_through = follows == "stems", follows == "through nodes"
        self.moves_nodes = self.follows_stems or drifts
        self._capacity = 0
        self._met = False

    def allocate(self, state: State) -> None:
        """Make the device arrays; where there are more points but no more channels, they stay."""
        count = state.channel_capacity
        if self._capacity == count:
            return
        self._capacity = count
        self.downstream, self.tributaries, self.active = state.zeros(count), state.zeros(count), state.zeros(count)
        self.drift, self.shift = state.zeros(count, state.scalar), state.zeros(count, state.vec2)
        self.beside, self.lesser = state.zeros(count), state.zeros(count)
        self.angle, self.ease = state.zeros(count, state.scalar), state.zeros(count, state.scalar)
        self.loosen = state.zeros(count, state.scalar)
        self.aim, self.lead = state.zeros(count, state.vec2), state.zeros(count, state.scalar)

    def install(self, state: State) -> None:
        """Take what flows into what, the speeds, and the angles."""
        network, count = state.network, state.network.channel_count
        if state.stems is not None and state.stems.joined:
            self.moves_nodes = True
        downstream = np.where(network.channel_closed, -1, leaving_channels(network)[network.channel_to])
        tributaries = np.bincount(downstream[downstream >= 0], minlength=count)
        self._assign(state, self.downstream, downstream)
        state.assign(self.tributaries, tributaries)
        if not self._met and (tributaries > 1).any():
            # Once there were junctions their stages stay, so that edits that come and go outdate nothing.
            self._met = True
            state.changed()
        # Where nothing joins there is no junction, and where channels part nothing wanders.
        wanders = tributaries > 1
        wanders &= (np.bincount(network.channel_from, minlength=network.node_count) == 1)[network.channel_from]
        rate = self._rate(network.channel_width, state.params)
        state.assign(self.loosen, rate / network.channel_width)
        state.assign(self.drift, np.where(wanders, state.params.junction_drift * rate, 0.0))
        if self._shape is not None:
            self._install_templates(state, downstream, rate)

    def _install_templates(self, state: State, downstream: np.ndarray, rate: np.ndarray) -> None:
        assert self._shape is not None
        network, count = state.network, state.network.channel_count
        meets, likeness, lesser = _meetings(network)
        if state.stems is not None and self.follows_stems:
            # Where the greater one goes straight on all of the angle is the other one's.
            goes_on = state.stems.links.lower >= 0
            through = np.zeros(network.node_count, bool)
            through[network.channel_to[goes_on]] = True
            lesser = np.where(through[network.channel_to], ~goes_on, lesser)
            meets = meets & ~goes_on
        angle = np.where(lesser, _lesser_angle(likeness, self._shape), _greater_angle(likeness, self._shape))
        meets &= ~network.channel_closed
        inner = meets & lesser & (downstream >= 0)
        led = np.full(count, -1)
        led[downstream[inner]] = np.flatnonzero(inner)
        below = np.maximum(downstream, 0)
        self._assign(state, self.beside, _other_at_foot(network))
        self._assign(state, self.lesser, led)
        self._assign(state, self.angle, np.where(meets, angle, -1.0))
        state.assign(self.ease, self._shape.ease * rate[below] / network.channel_width[below])

    def _assign(self, state: State, array: Any, values: np.ndarray) -> None:
        """Copy values of the channels; beyond the channels there is nothing: -1."""
        state.assign(array, np.concatenate([values, np.full(state.channel_capacity - len(values), -1, values.dtype)]))

    def stages(self, state: State) -> list[Stage]:
        """Return the stage: heads of channels at junctions move, the mouths of tributaries follow and are shaped."""
        joined = state.stems is not None and state.stems.joined
        shaped, drifts = self._met and self._shape is not None, self._met and self._drifts
        locked = joined and state.stems is not None and state.stems.locked
        if not joined and not drifts and not shaped:
            return []
        kernel, capacity, channels = kernels.build(state.scalar), state.channel_capacity, state.channels()
        junctions, template = kernel.Junctions(), kernel.Template()
        junctions.downstream, junctions.tributaries, junctions.drift = self.downstream, self.tributaries, self.drift
        junctions.beside, junctions.angle, junctions.ease = self.beside, self.angle, self.ease
        if self._shape is not None:
            junctions.lesser = self.lesser
            template.reach, template.straight, template.bend = self._shape.reach, STRAIGHT, BEND
            template.least, template.free = math.radians(LEAST_ANGLE), math.radians(FREE_ANGLE)
            template.most = math.radians(MOST_ANGLE)

        def start(name: str, inputs: list[Any], outputs: list[Any]) -> None:
            launch(getattr(kernel, name), capacity, [channels, *inputs], outputs, state.device)

        def run(whole: Share) -> None:
            start("settle_heads", [state.network.point_xy, whole.work], [self.shift, state.point_moved])
            if shaped:
                start("aim_mouths", [junctions, template, whole.work, state.point_moved], [self.aim, self.lead])
            if drifts:
                clear(self.active)
                start("count_active", [junctions], [self.active])
                inputs = [junctions, state.params.time_step, state.substep, self.active, self.lead]
                start("shift_heads", inputs, [self.shift, state.point_moved])
            start("follow_heads", [junctions, state.params.junction_reach, self.shift], [state.point_moved])
            if shaped:
                start("shape_mouths", [junctions, template, self.aim], [state.point_moved])
            if locked:
                start("ease_locks", [state.params.end_damping, whole.work, self.loosen], [state.point_moved])

        return [Stage(self.name, run, shared=False)]

    def check(self, state: State) -> None:
        """Points are finite."""
        state.check_moved(self.name, anchored=False)
