"""Chute cutoffs: bends that floods cut across their bars, by chance."""

from __future__ import annotations

from typing import Any

import numpy as np

from warpriver.arrays import DeviceArray
from warpriver.engine.stages import Share, Stage, launch
from warpriver.engine.state import State
from warpriver.kernels import chutes as kernels

__all__ = ["Chutes"]


class Chutes:
    """The bends that are cut by chutes, beside the necks that a search has found.

    Attributes:
        identity: (C,) int32, identities of the channels.
    """

    identity: DeviceArray

    def allocate(self, state: State) -> None:
        """Make the device array."""
        self.identity = state.zeros(state.channel_capacity)
        self.install(state)

    def install(self, state: State) -> None:
        """Take the identities of the channels."""
        state.assign(self.identity, state.network.channel_id.astype(np.int32))

    def stage(self, name: str, state: State, cuts: Any, chunk_mark: DeviceArray) -> Stage:
        """Return the stage that adds chutes to the necks of a sub-step, before it is chosen among them."""
        kernel, params = kernels.build(state.scalar), state.params.chutes
        chutes = kernel.Chutes()
        chutes.rate, chutes.winding, chutes.longest = params.rate, params.winding, params.longest
        chutes.min_arc = state.params.cutoff_min_arc
        chutes.seed = state.kernel_seed
        channels, moved = state.channels(), state.moved()

        def find(share: Share) -> None:
            launch(
                kernel.find_chutes,
                dim=share.point_threads,
                inputs=[channels, moved, chutes, share.work, self.identity, state.substep],
                outputs=[cuts, chunk_mark],
                device=state.device,
            )

        return Stage(name, find)
