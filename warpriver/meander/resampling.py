"""Resampling: points at an even spacing again, on the cubic through the moved ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.engine.checks import require
from warpriver.engine.phase import Phase
from warpriver.engine.scans import Scan
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.kernels import polyline
from warpriver.kernels import resampling as kernels

__all__ = ["Arcs", "Resample"]

# Points are even by the chords of the old ones. Where a cutoff joined two points far apart, the cubic between them has
# the speed |3/2 c - (Tb + Tc)/4| in its middle, at most 3/2 + 5/6 with tangents of up to 5/3; the next step evens it.
LONGEST_CHORD = 2.34


class Arcs:
    """Arc lengths of ``state.point_moved``.

    Attributes:
        point_arc: (P,) float64, arc length from the channel's head (with chunks: from the chunk's first point), m.
        chunk_length, chunk_offset: int64, quanta that each chunk adds to the arc length, and the running sum.
    """

    point_arc: DeviceArray
    chunk_length: DeviceArray
    chunk_offset: DeviceArray
    scan: Scan
    _chunk: int

    @property
    def struct(self) -> Any:
        """The arc lengths as kernels take them."""
        struct = polyline.Arcs()
        struct.point, struct.chunk_offset, struct.chunk = self.point_arc, self.chunk_offset, self._chunk
        return struct

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        self._chunk = state.chunk
        self.point_arc = state.zeros(state.point_capacity, wp.float64)
        self.chunk_length, self.chunk_offset = (state.zeros(state.chunk_count, wp.int64) for _ in range(2))
        self.scan = Scan("lengths", self.chunk_length, self.chunk_offset, state.scalar, serial=state.chunk == 0)

    def stages(self, state: State, phase: str) -> list[Stage]:
        """Return the stages that measure them; ``phase``: name of the verb of the step that they belong to."""
        kernel, channels = kernels.build(state.scalar), state.channels()

        def measure(share: Share) -> None:
            launch(
                kernel.measure_arcs,
                dim=share.point_threads,
                inputs=[channels, share.work, state.point_moved],
                outputs=[self.point_arc, self.chunk_length, state.status.array],
                device=state.device,
            )

        summed = [Stage(phase, lambda _: self.scan.run(), shared=False)] if state.chunk > 0 else []
        return [Stage(phase, measure), *summed]


class Resample(Phase):
    """Samples the moved channels evenly and makes that the network's new state.

    A channel of length L gets n = round(L / target spacing) segments, at least 2, of L / n each; its ends stay. A ring
    gets n points for its n segments, at least 8. An inactive channel keeps its points. Nothing is committed when the
    status tells of a fault. It does when the points do not fit into the capacity, and tells which one the step needs.

    Attributes:
        arcs: Arc lengths before it.
        samples, start_next, spacing_next: (C,) points, (C + 1,) offsets and (C,) spacing that it gives.
    """

    name = "resample"
    samples: DeviceArray
    start_next: DeviceArray
    spacing_next: DeviceArray
    scan: Scan

    def __init__(self) -> None:
        self.arcs = Arcs()

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        self.arcs.allocate(state)
        count = state.channel_capacity
        self.samples, self.start_next = state.zeros(count), state.zeros(count + 1)
        self.spacing_next = state.zeros(count, state.scalar)
        self.scan = Scan("counts", self.samples, self.start_next[1:], state.scalar, serial=state.chunk == 0)

    def install(self, state: State) -> None:
        """Forget the samples of channels that are no more."""
        clear(self.samples)

    def stages(self, state: State) -> list[Stage]:
        """Return the stages: arc lengths, counts, samples, and the commit of all or nothing."""
        kernel, device, arcs = kernels.build(state.scalar), state.device, self.arcs.struct
        channels, points, moved, status = state.channels(), state.points(), state.moved(), state.status.array
        samples = state.channels()
        samples.start, samples.spacing = self.start_next, self.spacing_next

        def count(share: Share) -> None:
            launch(
                kernel.count_samples,
                dim=share.channel_threads,
                inputs=[channels, share.work, state.point_moved, arcs],
                outputs=[self.samples, self.spacing_next, status],
                device=device,
            )

        def sample(share: Share) -> None:
            launch(
                kernel.resample_points,
                dim=share.point_threads,
                inputs=[channels, share.work, samples, moved, arcs],
                outputs=[points],
                device=device,
            )

        def commit(_: Share) -> None:
            launch(
                kernel.commit_step,
                dim=state.channel_capacity + 1,
                inputs=[state.point_capacity, int(state.keep_plan), self.start_next, self.spacing_next],
                outputs=[state.start, state.spacing, state.substep, status],
                device=device,
            )

        return [
            *self.arcs.stages(state, self.name),
            Stage(self.name, count),
            Stage(self.name, lambda _: self.scan.run(), shared=False),
            Stage(self.name, sample),
            Stage(self.name, commit, shared=False),
        ]

    def check(self, state: State) -> None:
        """Starts ascend, points are finite, and no two neighbours are farther apart than the spacing allows."""
        if int(self.start_next[-1:].numpy()[0]) > state.point_capacity:
            return
        network, name = state.network, self.name
        spacing = state.spacing.numpy()[: network.channel_count].astype(np.float64)
        start = network.starts()
        require(np.diff(start) >= 3, name, "has fewer than 3 points", "channel")
        xy = network.point_xy[: start[-1]].numpy().astype(np.float64)
        require(np.isfinite(xy).all(axis=1), name, "is not finite", "point")
        gap = np.hypot(*(xy[start[:-1]] - xy[start[1:] - 1]).T)
        require(~network.channel_closed | (gap <= LONGEST_CHORD * spacing), name, "does not close", "ring")
        chord = np.hypot(*np.diff(xy, axis=0).T)
        owner = np.repeat(np.arange(len(spacing)), np.diff(start))[:-1]
        chord[start[1:-1] - 1] = 0.0
        require(chord <= LONGEST_CHORD * spacing[owner], name, "is too far from the next", "point")
