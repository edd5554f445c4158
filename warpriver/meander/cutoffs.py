"""Neck cutoffs: a channel that comes closer to itself than its width joins there and leaves the loop behind."""

from __future__ import annotations

from warpriver.arrays import DeviceArray
from warpriver.engine.phase import Batch, Phase
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.history.events import Event
from warpriver.kernels import cutoffs as kernels
from warpriver.meander.chutes import Chutes
from warpriver.meander.loops import ChunkMarks, Loops, PointTable

__all__ = ["CutOff"]


class CutOff(Phase):
    """Finds all necks among ``state.point_moved`` and cuts their loops off; not part of a step at a distance of 0.

    Attributes:
        point_neck: (P,) int32, the later point that a point's neck reaches, -1 if none; in the state's spare memory.
        necks: (C,) int32, necks of each channel, where the work is dealt out in slabs.
        table, marks, loops: What is near what, the chunks that hold necks, and what is cut off.
        chutes: Bends that are cut without a neck; None where none are.
    """

    name = "cut off"
    point_neck: DeviceArray
    necks: DeviceArray

    def __init__(self, *, chutes: bool = False) -> None:
        """Start without arrays; ``chutes``: bends are cut across their bars as well."""
        self.chutes = Chutes() if chutes else None
        self.table, self.marks, self.loops = PointTable(), ChunkMarks(), Loops(closed=False)

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        self.point_neck = state.spare[1]
        self.necks = state.zeros(state.channel_capacity)
        for part in (self.table, self.marks, self.loops):
            part.allocate(state)
        if self.chutes is not None:
            self.chutes.allocate(state)

    def install(self, state: State) -> None:
        """Forget the necks of channels that are no more."""
        clear(self.necks)
        if self.chutes is not None:
            self.chutes.install(state)

    def stages(self, state: State) -> list[Stage]:
        """Return the stages: the table, the search, the choice of cuts, the cut."""
        kernel, device, params = kernels.build(state.scalar), state.device, state.params
        marks, channels, moved = self.marks, state.channels(), state.moved()
        near = self.table.struct(state, params.cutoff_distance, params.cutoff_min_arc)
        # Where a loop ends is written once the lists of near points are no longer read.
        cuts = self.loops.cuts(self.point_neck, self.table.point_next, self.necks)
        keep_longer = int(params.ring_policy == "longer")

        def find(share: Share) -> None:
            launch(
                kernel.find_necks_in_chunks if state.chunk else kernel.find_necks,
                dim=share.point_threads,
                inputs=[channels, share.work, moved, near],
                outputs=[cuts, marks.chunk_mark],
                device=device,
            )

        def select(share: Share) -> None:
            launch(
                kernel.select_cuts,
                dim=share.point_threads,
                inputs=[channels, keep_longer, share.work, marks.marks],
                outputs=[cuts],
                device=device,
            )

        chutes = [] if self.chutes is None else [self.chutes.stage(self.name, state, cuts, marks.chunk_mark)]
        return [
            *self.table.stages(state, params.cutoff_distance),
            Stage(self.name, find),
            *chutes,
            *marks.stages(state),
            Stage(self.name, select),
            *self.loops.stages(state, cuts),
        ]

    def after(self, state: State, batch: Batch) -> list[Event]:
        """Return the cutoffs and splits of a batch."""
        return self.loops.after(state, batch)

    def grow(self, state: State, status: list[int]) -> bool:
        """Make room for more loops."""
        return self.loops.grow(state, status)

    def check(self, state: State) -> None:
        """Points are finite, ends are in place unless a phase moves them, and cutoffs are in order."""
        state.check_moved(self.name, anchored=not state.nodes_move)
        self.loops.check(state)
