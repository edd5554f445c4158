"""Loops that are cut off: saved as oxbow lakes, or rings that go on, and taken out of their channels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.engine.checks import require
from warpriver.engine.phase import Batch
from warpriver.engine.scans import Scan
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.errors import warn
from warpriver.graph.rings import split_rings
from warpriver.history.events import Cutoff, Event, Split
from warpriver.kernels import cutoffs as kernels
from warpriver.kernels.cuts import Cuts, Marks
from warpriver.kernels.status import CUT_POINTS, CUT_POINTS_NEEDED, CUTS, CUTS_NEEDED, FAULT, FAULT_OXBOWS_FULL

__all__ = ["ChunkMarks", "Loops", "PointTable"]


class PointTable:
    """The points of ``state.point_moved`` in a grid for each channel, to find what is near.

    Attributes:
        point_next, bucket_head: linked lists of the points in each grid cell; 0 ends a list. ``bucket_row``: the same
            table by fours.
    """

    bucket_head: DeviceArray
    bucket_row: DeviceArray

    def allocate(self, state: State) -> None:
        """Make the device arrays; the lists are in the state's spare array."""
        # With chunks a bucket has two fields.
        fields = 2 if state.chunk else 1
        self.point_next = state.spare[0]
        self.bucket_head = state.zeros(4 * fields * state.point_capacity)
        rows = fields * state.point_capacity
        self.bucket_row = wp.array(
            ptr=self.bucket_head.ptr, dtype=wp.vec4i, shape=rows, device=state.device, copy=False
        )

    def struct(self, state: State, distance: float, min_arc: float) -> Any:
        """Return the points as a search takes them.

        Args:
            state: Says which precision.
            distance: How far apart near points are at most, in greatest widths of the channel.
            min_arc: How far apart along the channel they are at least, in widths.
        """
        struct = kernels.build(state.scalar).PointTable()
        struct.distance, struct.min_arc = distance, min_arc
        struct.point_next, struct.bucket_head = self.point_next, self.bucket_head
        return struct

    def stages(self, state: State, distance: float) -> list[Stage]:
        """Return the stages that link the points.

        Args:
            state: Its points have moved.
            distance: How far apart near points are at most, in greatest widths of the channel; a cell is twice as wide.
        """
        kernel, channels = kernels.build(state.scalar), state.channels()

        def link(share: Share) -> None:
            launch(
                kernel.insert_points,
                dim=share.point_threads,
                inputs=[channels, distance, share.work, state.point_moved],
                outputs=[self.point_next, self.bucket_row, self.bucket_head],
                device=state.device,
            )

        # A slab empties what is its own.
        empty = Stage("cut off", lambda _: clear(self.bucket_head), shared=False)
        return [*([empty] if state.chunk else []), Stage("cut off", link)]


class ChunkMarks:
    """Which chunks hold necks, or ends of shortcuts; on the CPU, where there are no chunks, nothing.

    Attributes:
        chunk_mark, chunk_mark_sum: vec2i, 1 where a chunk is marked and a point that it reaches; the running sum and
            maximum.
        marks: The list of the marked chunks.
    """

    chunk_mark: DeviceArray
    chunk_mark_sum: DeviceArray
    scan: Scan

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        count = state.chunk_count
        self.chunk_mark, self.chunk_mark_sum = state.zeros(count, wp.vec2i), state.zeros(count, wp.vec2i)
        self.scan = Scan("marks", self.chunk_mark, self.chunk_mark_sum, state.scalar, serial=state.chunk == 0)
        self.marks = Marks()
        if state.chunk:
            self.marks.place, self.marks.chunk = state.zeros(count + 1), state.zeros(count)
            self.marks.sum = self.chunk_mark_sum

    def stages(self, state: State) -> list[Stage]:
        """Return the stages that list the marked chunks."""
        if state.chunk == 0:
            return []

        def run(_: Share) -> None:
            self.scan.run()
            outputs = [self.marks.place, self.marks.chunk]
            launch(
                kernels.build(state.scalar).list_marks, state.chunk_count, [self.chunk_mark_sum], outputs, state.device
            )

        return [Stage("cut off", run, shared=False)]


class Loops:
    """The loops that the sub-steps of a batch cut off.

    Attributes:
        share_cut, share_cut_sum: vec2i, cutoffs of a sub-step that begin in each slab or chunk and their points; the
            running sums.
        cut: (K,) ``Cut`` of ``kernels/cutoffs.py``; ``cut_span``: (K,) vec2i, first and last point of each loop.
        oxbow_xy, oxbow_section: Points of the loops, end to end, and their widths and depths where these vary.
        cut_capacity, oxbow_capacity: Capacity for cutoffs and their points.
    """

    cut: DeviceArray
    cut_span: DeviceArray
    oxbow_xy: DeviceArray
    oxbow_section: DeviceArray | None
    share_cut: DeviceArray
    share_cut_sum: DeviceArray
    scan: Scan

    def __init__(self, *, closed: bool):
        """Start without capacity; ``closed``: oxbow lakes are kept as closed lines, the first point repeated."""
        self.closed = closed
        self.cut_capacity = self.oxbow_capacity = 0
        self._told = False

    def allocate(self, state: State) -> None:
        """Make the device arrays, for a cutoff in 384 points and a sixth of them."""
        self.share_cut, self.share_cut_sum = (state.zeros(state.share_count, wp.vec2i) for _ in range(2))
        self.scan = Scan("pairs", self.share_cut, self.share_cut_sum, state.scalar, serial=state.chunk == 0)
        if self.cut_capacity == 0:
            self.reserve(state, 64 + state.point_capacity // 384, 1024 + state.point_capacity // 6)

    def reserve(self, state: State, cuts: int, points: int) -> None:
        """Allocate for so many cutoffs and points in a batch of sub-steps."""
        self.cut_capacity, self.oxbow_capacity = cuts, points
        self.cut, self.cut_span = state.zeros(cuts, kernels.Cut), state.zeros(cuts, wp.vec2i)
        self.oxbow_xy = state.zeros(points, state.vec2)
        self.oxbow_section = None if state.section_moved is None else state.zeros(points, state.vec2)
        state.changed()

    def cuts(self, point_neck: DeviceArray, point_cut: DeviceArray, channel_necks: DeviceArray) -> Any:
        """Return the cuts of a sub-step as kernels take them.

        Args:
            point_neck: (P,) int32, -1 where nothing is cut.
            point_cut: (P,) int32, the point at which the loop ends that begins at a point, where that has a neck; -1
                for none. It may be the same array.
            channel_necks: (C,) int32, 0 for channels without any, where the work is dealt out in slabs.
        """
        cuts = Cuts()
        cuts.point_neck, cuts.point_cut, cuts.channel_necks = point_neck, point_cut, channel_necks
        cuts.share_cut, cuts.share_cut_sum = self.share_cut, self.share_cut_sum
        return cuts

    def stages(self, state: State, cuts: Any) -> list[Stage]:
        """Return the stages that cut off the loops that were chosen; they must not overlap.

        The loops are saved in the order of the points; their inner points in ``state.point_moved`` become copies of
        the point before, which have no length.

        Args:
            state: Its points have moved.
            cuts: From ``cuts``.
        """
        kernel, channels, moved = kernels.build(state.scalar), state.channels(), state.moved()
        loops = kernel.Loops()
        loops.cut, loops.span, loops.xy = self.cut, self.cut_span, self.oxbow_xy
        if self.oxbow_section is not None:
            loops.section = self.oxbow_section

        def record(share: Share) -> None:
            launch(
                kernel.record_cuts,
                dim=share.point_threads,
                inputs=[channels, share.work, cuts],
                outputs=[loops, moved, state.status.array],
                device=state.device,
            )

        def save(share: Share) -> None:
            launch(
                kernel.save_loops,
                dim=share.point_threads,
                inputs=[channels, share.work, cuts],
                outputs=[loops, moved],
                device=state.device,
            )

        return [
            Stage("cut off", lambda _: self.scan.run(), shared=False),
            Stage("cut off", record),
            Stage("cut off", save),
        ]

    def after(self, state: State, batch: Batch) -> list[Event]:
        """Return the cutoffs and splits of a batch; where both parts of a ring go on, the network gets new channels."""
        count, points = batch.status[CUTS], batch.status[CUT_POINTS]
        if count == 0:
            return []
        network, events, times = state.network, list[Event](), batch.times
        cut = self.cut[:count].numpy()
        xy = self.oxbow_xy[:points].numpy().astype(np.float64) + network.origin
        section = None if self.oxbow_section is None else self.oxbow_section[:points].numpy()
        split = self._limited(state, network.channel_closed[cut["channel"]] & (state.params.ring_policy == "both"))
        columns = np.stack([cut[name][split] for name in ("channel", "begin", "count")], axis=1)
        edited = split_rings(network, columns, xy, state.next_identity) if split.any() else None
        chutes = getattr(state.params, "chutes", None) is not None
        added = iter([] if edited is None else edited.channels.id[network.channel_count :].tolist())
        for k, (channel, begin, length, substep) in enumerate(cut.tolist()):
            width, depth = network.channel_width[channel], network.channel_depth[channel]
            along = None if section is None else section[begin : begin + length].astype(np.float64)
            if along is not None:
                width, depth = along[0]
            identity, loop = int(network.channel_id[channel]), xy[begin : begin + length]
            if split[k]:
                events.append(Split(times[substep], identity, next(added), float(width), loop.copy()))
            else:
                line = np.concatenate([loop, loop[:1]]) if self.closed else loop.copy()
                if along is not None and self.closed:
                    along = np.concatenate([along, along[:1]])
                flow = float(network.channel_discharge[channel])
                chute = chutes and math.dist(loop[0], loop[-1]) > state.params.cutoff_distance * float(width)
                events.append(Cutoff(times[substep], identity, float(width), line, float(depth), flow, along, chute))
        if edited is not None:
            state.adopt(edited, self.oxbow_xy, self.oxbow_section)
        return events

    def _limited(self, state: State, split: np.ndarray) -> np.ndarray:
        """Return which loops become rings of their own, so many that there are ``max_rings`` at most."""
        rings, limit = int(state.network.channel_closed.sum()), state.params.max_rings
        within: np.ndarray = split & (np.cumsum(split) <= limit - rings)
        if (split & ~within).any() and not self._told:
            self._told = True
            warn(
                f"there are {rings + int(within.sum())} rings: no more are made (max_rings={limit:g}), and where a "
                "ring splits, the part without its first point becomes an oxbow lake"
            )
        return within

    def grow(self, state: State, status: list[int]) -> bool:
        """Enlarge for the loops of a sub-step; where those of a batch did not fit together, the next one has it all."""
        if status[FAULT] != FAULT_OXBOWS_FULL:
            return False
        cuts, points = status[CUTS_NEEDED], status[CUT_POINTS_NEEDED]
        if cuts > self.cut_capacity or points > self.oxbow_capacity:
            self.reserve(state, max(self.cut_capacity, 2 * cuts), max(self.oxbow_capacity, 2 * points))
        return True

    def check(self, state: State) -> None:
        """Cutoffs are in order and lie end to end."""
        count, total = self.share_cut_sum[-1:].numpy()[0].tolist()
        cut = self.cut[:count].numpy()
        require(np.diff(cut["channel"]) >= 0, "cut off", "is out of order", "cutoff")
        require(cut["count"] >= 3, "cut off", "has no loop", "cutoff")
        following = np.concatenate([cut["begin"][1:], [total]])[: len(cut)]
        require(following == cut["begin"] + cut["count"], "cut off", "has a gap", "cutoff")
