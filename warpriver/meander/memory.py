"""Memory of stems: the curvature that a channel feels of the links upstream, handed on from each to the next."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.device import PRECISIONS
from warpriver.engine.stages import Share, clear, launch
from warpriver.kernels import memory as kernels
from warpriver.meander.banks import highest_factor
from warpriver.params import MeanderParams

__all__ = ["StemMemory", "migration_constants", "rate_of"]


def rate_of(width: np.ndarray, params: MeanderParams) -> np.ndarray:
    """Return the rate k of channels of those widths in m, m/yr."""
    if params.reference_width:
        return params.migration_rate * width / params.reference_width
    return np.full(width.shape, params.migration_rate)


def migration_constants(params: MeanderParams, dtype: str) -> Any:
    """Pack the constants of migration for the kernels of that precision."""
    constants = kernels.build(PRECISIONS[dtype][0]).MigrationConstants()
    constants.migration_rate = params.migration_rate
    constants.reference_width = params.reference_width or 0.0
    constants.friction = params.friction
    constants.memory_length = params.memory_length
    constants.curvature_saturation = params.curvature_saturation
    constants.local_weight = params.local_weight
    constants.upstream_weight = params.upstream_weight
    constants.scale_local = int(params.sinuosity_scaling == "whole")
    constants.scale_upstream = int(params.sinuosity_scaling in ("whole", "upstream"))
    constants.end_damping = params.end_damping
    constants.slope_threshold = params.slope_threshold
    constants.freest = highest_factor(params)
    return constants


class StemMemory:
    """What the links of stems hand on in a sub-step, and the launches that hand it on.

    The velocities of a link are computed as if nothing came from upstream. They are linear in what enters it: a few
    numbers tell what a link makes of that, the links are chained without a walk over their points, and what enters each
    is added to its velocities afterwards.
    """

    def __init__(self, count: int, scalar: Any, device: Any):
        """Allocate for so many channels."""
        kernel = kernels.build(scalar)

        def zeros(kind: Any) -> DeviceArray:
            return wp.zeros(count, dtype=kind, device=device)

        self._kernel, self._device, self._count = kernel, device, count
        self.end, self.fade, self.start = zeros(kernel.vec3), zeros(kernel.vec4), zeros(kernel.vec3)
        self.back, self.tail = zeros(kernel.vec3), zeros(kernel.vec2)
        self.terms, self.ends = zeros(kernel.Terms), zeros(kernel.Ends)

    def struct(self) -> Any:
        """Return the arrays as kernels take them."""
        memory = self._kernel.Memory()
        memory.end, memory.fade, memory.start = self.end, self.fade, self.start
        memory.back, memory.tail, memory.terms, memory.ends = self.back, self.tail, self.terms, self.ends
        return memory

    def measure(self, channels: Any, length: DeviceArray) -> None:
        """Measure the stems, whose sinuosity the rates need."""
        clear(length)
        self._launch("measure_stems", self._count, [channels], [length])

    def chain(self, channels: Any, constants: Any, work: Any) -> None:
        """Find what enters each link, when the velocities of all are computed."""
        self._launch("chain_links", self._count, [channels, constants, work], [self.struct()])

    def add(self, channels: Any, points: Any, constants: Any, share: Share, velocity: DeviceArray) -> None:
        """Add to the velocities of a share of the channels what enters them."""
        inputs = [channels, points, constants, share.work]
        self._launch("add_upstream", share.channel_threads, inputs, [self.struct(), velocity])

    def find_tails(self, channels: Any, work: Any) -> None:
        """Find what comes from downstream of each link where velocities are smoothed, when they are complete."""
        self._launch("find_tails", self._count, [channels, work], [self.struct()])

    def _launch(self, name: str, threads: int, inputs: list[Any], outputs: list[Any]) -> None:
        launch(getattr(self._kernel, name), threads, inputs, outputs, self._device)
