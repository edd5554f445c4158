"""Junctions: the angle at which a tributary arrives, by how its flow compares with the other one's; and their drift.

Rivers of like size meet at a narrow angle; a small one meets a large one nearly at a right angle [Hooshyar2017,
Paris2023, Sec. 6.1]. The templates shape the last reach of the tributaries for pictures and for carving. A simulation
holds junctions where they are [Paris2023], unless they are told to wander down the channel below.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from warpriver.channel_table import JOINT_NONE
from warpriver.device import PRECISIONS
from warpriver.engine.phase import Phase
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.errors import InputError
from warpriver.graph.forest import check_forest
from warpriver.kernels import junctions as kernels
from warpriver.network import RiverNetwork
from warpriver.params import Params, parameter
from warpriver.public import public

__all__ = ["JunctionParams", "MoveJunctions", "junction_angles", "shape_junctions"]


@dataclasses.dataclass(frozen=True)
class JunctionParams(Params):
    """Constants of the junction templates."""

    narrow_angle: float = parameter(
        25.0,
        "deg",
        low=0.0,
        high=90.0,
        source="warpriver",
        doc="angle between a tributary and the channel below when both tributaries carry the same",
    )
    wide_angle: float = parameter(
        80.0,
        "deg",
        low=0.0,
        high=90.0,
        source="warpriver",
        doc="that angle for a tributary that carries next to nothing beside the other one",
    )
    exponent: float = parameter(
        0.5,
        "-",
        low=0.0,
        low_open=True,
        source="warpriver",
        doc="how fast the angle narrows as the flows become alike: ratio^exponent",
    )
    reach: float = parameter(
        6.0,
        "widths",
        low=1.0,
        source="warpriver",
        doc="length of the last reach that is shaped, in widths of its own channel, at most half of the channel",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wide_angle < self.narrow_angle:
            raise InputError(
                f"JunctionParams.wide_angle ({self.wide_angle:g} deg) is below narrow_angle ({self.narrow_angle:g} deg)"
            )


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
    flow = network.channel_flow()
    count = np.bincount(network.channel_to, minlength=network.node_count)
    has_outlet = np.zeros(network.node_count, bool)
    has_outlet[network.channel_from] = True
    meets = (count == 2) & has_outlet
    total = np.bincount(network.channel_to, weights=flow, minlength=network.node_count)
    other = total[network.channel_to] - flow
    likeness = np.minimum(flow, other) / np.maximum(np.maximum(flow, other), 1e-300)
    narrow, wide = np.radians(params.narrow_angle), np.radians(params.wide_angle)
    part = np.clip(likeness, 0.0, 1.0) ** params.exponent
    lesser = flow <= other
    angle = np.where(lesser, wide + (narrow - wide) * part, narrow * part)
    return np.where(meets[network.channel_to], angle, np.nan)


@public
def shape_junctions(network: RiverNetwork, params: JunctionParams | None = None) -> RiverNetwork:
    """Return a network whose tributaries arrive at the template's angles; nodes and everything upstream stay.

    Elevations of its points, ``point_z``, are those of the lines as they were and are dropped.

    The last reach of a tributary is blended into a cubic that leaves its old course with its direction and arrives at
    the node at the angle of :func:`junction_angles`, from the side on which the tributary lies.

    Args:
        network: The network.
        params: Template constants.
    """
    params = params or JunctionParams()
    angle = junction_angles(network, params)
    start = network.starts()
    xy = network.points() - network.origin
    owner = np.repeat(np.arange(network.channel_count), np.diff(start))
    s = _arc(xy, start)
    length = s[start[1:] - 1]
    shaped = np.isfinite(angle)
    if not shaped.any():
        return network.to()
    reach = np.minimum(params.reach * network.channel_width, 0.5 * length)
    node, below = xy[start[1:] - 1], _directions_below(network, xy, start)
    # Where the shaped reach begins, and the direction there.
    # All channels laid end to end, so that one search serves them all.
    offset = np.concatenate([[0.0], np.cumsum(length + 1.0)[:-1]])
    begin = np.searchsorted(s + offset[owner], offset + length - reach)
    begin = np.clip(begin, start[:-1] + 1, start[1:] - 2)
    first, leaving = xy[begin], _unit(xy[begin + 1] - xy[begin - 1])
    span = length - s[begin]
    back = first - node
    side = np.sign(below[:, 0] * back[:, 1] - below[:, 1] * back[:, 0])
    turn = -side * np.where(shaped, angle, 0.0)
    cosine, sine = np.cos(turn), np.sin(turn)
    arriving = np.stack([cosine * below[:, 0] - sine * below[:, 1], sine * below[:, 0] + cosine * below[:, 1]], axis=1)
    inside = shaped[owner] & (np.arange(len(xy)) >= begin[owner])
    c = owner[inside]
    t = ((s[inside] - s[begin[c]]) / span[c])[:, None]
    size = np.hypot(*back[c].T)[:, None]
    u = 1.0 - t
    blend = t * t * (3.0 - 2.0 * t)
    cubic = first[c] + blend * (node[c] - first[c]) + size * t * u * (u * leaving[c] - t * arriving[c])
    moved = xy.copy()
    moved[inside] = cubic
    ends = start[1:] - 1
    moved[ends] = node
    result = network.to()
    result.point_z = None
    result.point_xy.assign(moved.astype(PRECISIONS[result.dtype][2]))
    return result


def _arc(xy: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Arc length of each point from its channel's head, (P,)."""
    step = np.concatenate([[0.0], np.hypot(*np.diff(xy, axis=0).T)])
    step[start[:-1]] = 0.0
    total = np.cumsum(step)
    arc: np.ndarray = total - np.repeat(total[start[:-1]], np.diff(start))
    return arc


def _directions_below(network: RiverNetwork, xy: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Direction of the channel below each channel's node, over its first points, (C, 2); 0 where there is none."""
    ahead = np.minimum(start[:-1] + 2, start[1:] - 1)
    own = _unit(xy[ahead] - xy[start[:-1]])
    by_node = np.zeros((network.node_count, 2))
    by_node[network.channel_from] = own
    directions: np.ndarray = by_node[network.channel_to]
    return directions


def _unit(vectors: np.ndarray) -> np.ndarray:
    size = np.hypot(*vectors.T)[:, None]
    unit: np.ndarray = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)
    return unit


class MoveJunctions(Phase):
    """Moves nodes with the river that goes on through them, and lets junctions wander downstream; tributaries follow.

    It works on ``state.point_moved``. Where junctions are held it moves through nodes alone.

    Attributes:
        downstream: (C,) int32, the channel that each flows into, -1 if none; ``tributaries``: how many flow into it.
        drift: (C,) speed of the junction at its head, m/yr; ``active``, ``shift``: scratch.
    """

    name = "junctions"

    def __init__(self, rate: Callable[[np.ndarray, Any], np.ndarray], *, follows: str, drifts: bool):
        """Say what moves nodes.

        Args:
            rate: (width, params) -> the rate k, m/yr, at a fraction of which junctions drift.
            follows: "stems", "through nodes" or "nothing": where rivers go on through nodes.
            drifts: Whether junctions drift.
        """
        self._rate, self._drifts = rate, drifts
        self.follows_stems, self.follows_through = follows == "stems", follows == "through nodes"
        self.moves_nodes = self.follows_stems or drifts
        self._capacity = 0

    def check_network(self, network: RiverNetwork) -> None:
        """Junctions that drift have one channel downstream of them."""
        if self._drifts:
            check_forest(network)

    def allocate(self, state: State) -> None:
        """Make the device arrays; where there are more points but no more channels, they stay."""
        count = state.channel_capacity
        if self._capacity == count:
            return
        self._capacity = count
        self.downstream, self.tributaries, self.active = state.zeros(count), state.zeros(count), state.zeros(count)
        self.drift, self.shift = state.zeros(count, state.scalar), state.zeros(count, state.vec2)

    def install(self, state: State) -> None:
        """Take what flows into what, and the speeds."""
        network, count = state.network, state.network.channel_count
        if state.stems is not None and state.stems.joined:
            self.moves_nodes = True
        leaving = np.full(network.node_count, -1)
        leaving[network.channel_from] = np.arange(count)
        downstream = np.where(network.channel_closed, -1, leaving[network.channel_to])
        # Beyond the channels nothing flows on.
        state.assign(self.downstream, np.concatenate([downstream, np.full(state.channel_capacity - count, -1)]))
        state.assign(self.tributaries, np.bincount(downstream[downstream >= 0], minlength=count))
        # Through nodes and locked points are no junctions.
        wanders = ~np.isin(network.channel_from, network.channel_to[network.channel_joint != JOINT_NONE])
        drift = state.params.junction_drift * self._rate(network.channel_width, state.params)
        state.assign(self.drift, np.where(wanders, drift, 0.0))

    def stages(self, state: State) -> list[Stage]:
        """Return the stage: heads of channels at junctions move, and the ends of their tributaries follow."""
        joined = state.stems is not None and state.stems.joined
        if not joined and not self._drifts:
            return []
        kernel, capacity, channels = kernels.build(state.scalar), state.channel_capacity, state.channels()
        junctions = kernel.Junctions()
        junctions.downstream, junctions.tributaries, junctions.drift = self.downstream, self.tributaries, self.drift

        def start(name: str, inputs: list[Any], outputs: list[Any]) -> None:
            launch(getattr(kernel, name), capacity, [channels, *inputs], outputs, state.device)

        def run(whole: Share) -> None:
            start("settle_heads", [state.network.point_xy, whole.work], [self.shift, state.point_moved])
            if self._drifts:
                clear(self.active)
                start("count_active", [junctions], [self.active])
                inputs = [junctions, state.params.time_step, state.substep, self.active]
                start("shift_heads", inputs, [self.shift, state.point_moved])
            start("follow_heads", [junctions, state.params.junction_reach, self.shift], [state.point_moved])

        return [Stage(self.name, run, shared=False)]

    def check(self, state: State) -> None:
        """Points are finite."""
        state.check_moved(self.name, anchored=False)
