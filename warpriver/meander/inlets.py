"""Inlets: rivers that enter the map bring bends with them, as a slow random curvature that their heads feel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import FlagArray
from warpriver.engine.stages import Share, Stage, launch
from warpriver.engine.state import State
from warpriver.engine.stems import MapEdges
from warpriver.kernels import inlets as kernels
from warpriver.meander.memory import migration_constants, rate_of
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams

__all__ = ["Inlets", "find_inlets", "inlet_periods"]


def find_inlets(network: RiverNetwork, edges: MapEdges | None, rule: str) -> FlagArray:
    """Return which channels begin at an inlet, (C,) bool.

    Args:
        network: The network.
        edges: Where the map ends, or None on a plain, on which all heads count as at its edge.
        rule: "edge" or "periodic": heads within a cell of the edge of the map, or a width, if that is more; "all": all
            heads, to which nothing flows; "none": none.
    """
    if rule == "none":
        return np.zeros(network.channel_count, bool)
    fed: FlagArray = np.isin(network.channel_from, network.channel_to, invert=True) & ~network.channel_closed
    if rule in ("edge", "periodic") and edges is not None:
        away = np.minimum(*edges.distance(network.node_xy[network.channel_from]))
        fed &= away < np.maximum(edges.cell_size, network.channel_width)
    return fed


def inlet_periods(width: np.ndarray, depth: np.ndarray, params: MeanderParams) -> np.ndarray:
    """Return the time in yr in which a wave of the inlet's wavelength passes a head, by the theory of small waves.

    A wave of wavenumber q is carried down with c = k w gamma alpha q^2 / (alpha^2 + q^2), alpha = 2 f / d or 1 / (L w).
    """
    length = params.inlet_wavelength * width
    q = 2.0 * math.pi / length
    alpha = 1.0 / (params.memory_length * width) if params.memory_length else 2.0 * params.friction / depth
    speed = rate_of(width, params) * width * params.upstream_weight * alpha * q**2 / (alpha**2 + q**2)
    with np.errstate(divide="ignore"):
        period: np.ndarray = np.where(speed > 0.0, length / speed, 0.0)
    return period


class Inlets:
    """The curvature that enters at each head, and the launch that brings it to the time of a sub-step.

    Attributes:
        fed: (C,) int32, 1 where a channel begins at an inlet.
        curvature: (C,) what its head feels, 1/m.
        any: Whether any channel has ever begun at one.
    """

    def __init__(self, state: State):
        """Allocate for the channels of a state."""
        count = state.channel_capacity
        self.fed, self._identity = state.zeros(count), state.zeros(count)
        self.curvature, self._period = state.zeros(count, state.scalar), state.zeros(count, wp.float64)
        self.any = False

    def install(self, state: State) -> None:
        """Take the channels of the network."""
        network, params = state.network, state.params
        fed = find_inlets(network, state.map_edges, params.inlet)
        period = np.where(fed, inlet_periods(network.channel_width, network.channel_depth, params), 0.0)
        state.assign(self.fed, fed.astype(np.int32))
        state.assign(self._period, period)
        state.assign(self._identity, network.channel_id.astype(np.int32))
        state.assign(self.curvature, np.zeros(0, self.curvature.numpy().dtype))
        if fed.any() and not self.any:
            self.any = True
            state.changed()

    def give(self, channels: Any) -> None:
        """Set the arrays in the channels as kernels take them; they stay missing where nothing enters."""
        if self.any:
            channels.fed, channels.inlet = self.fed, self.curvature

    def stages(self, state: State) -> list[Stage]:
        """Return the stage that brings the curvature to the time of a sub-step; none without inlets."""
        if not self.any:
            return []
        kernel, params = kernels.build(state.scalar), state.params
        inflow = kernel.Inflow()
        inflow.curvature, inflow.time_step = params.inlet_curvature, params.time_step
        inflow.seed = state.kernel_seed
        channels = state.channels()
        if params.inlet == "periodic":
            return [self._returning(state)]

        def feed(_: Share) -> None:
            launch(
                kernel.feed_inlets,
                dim=state.channel_capacity,
                inputs=[channels, inflow, self._identity, self._period, state.substep, state.status.array],
                outputs=[self.curvature],
                device=state.device,
            )

        return [Stage("migrate", feed, shared=False)]

    def _returning(self, state: State) -> Stage:
        """Return the stage that lets what leaves at the foot of a river come in at its head."""
        kernel, channels, points = kernels.build(state.scalar), state.channels(), state.points()
        channels.fed = self.fed
        constants = migration_constants(state.params, state.network.dtype)

        def turn(_: Share) -> None:
            inputs = [channels, points, constants, state.status.array]
            launch(kernel.return_outflow, state.channel_capacity, inputs, [self.curvature], state.device)

        return Stage("migrate", turn, shared=False)
