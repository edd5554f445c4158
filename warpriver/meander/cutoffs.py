"""Neck cutoffs: a channel that comes closer to itself than its width joins there and leaves the loop behind."""

from __future__ import annotations

import warp as wp

from warpriver.kernels import cutoffs as kernels
from warpriver.meander.buffers import StepBuffers, StepChannels
from warpriver.meander.stages import Share, Stage, launch
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import MeanderParams

__all__ = ["cut_loops", "cut_off", "link_points", "list_marks"]


def cut_off(network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, params: MeanderParams) -> list[Stage]:
    """Return the stages that find all necks among ``buffers.point_moved`` and cut their loops off.

    Args:
        network: The network whose points moved.
        channels: Its channels, of spacing as before the move.
        buffers: Scratch and results, as of :func:`cut_loops`.
        params: ``cutoff_distance`` and ``cutoff_min_arc``, in widths, and ``ring_policy``.
    """
    if params.cutoff_distance == 0.0:
        return []
    kernel, device, b = kernels.build(PRECISIONS[network.dtype][0]), network.device, buffers
    start, distance = channels.start, params.cutoff_distance
    keep_longer = int(params.ring_policy == "longer")

    def find(share: Share) -> None:
        launch(
            kernel.find_necks_in_chunks if b.chunk else kernel.find_necks,
            share.point_threads,
            [
                start, channels.form, channels.spacing, channels.step, channels.closed, distance,
                params.cutoff_min_arc, share.work, b.point_moved, b.section_moved, b.point_next, b.bucket_head,
            ],
            [b.point_neck, b.chunk_mark, b.share_cut, channels.necks],
            device,
        )  # fmt: skip

    def select(share: Share) -> None:
        launch(
            kernel.select_cuts,
            share.point_threads,
            [start, channels.closed, keep_longer, share.work, channels.necks, b.chunk_mark_sum, b.marks, b.point_neck],
            [b.point_cut, b.share_cut],
            device,
        )

    return [
        *link_points(network, channels, buffers, distance),
        Stage("cut off", find),
        *list_marks(network, buffers),
        Stage("cut off", select),
        *cut_loops(network, channels, buffers, b.point_cut),
    ]


def list_marks(network: RiverNetwork, buffers: StepBuffers) -> list[Stage]:
    """Return the stages that list the chunks marked in ``buffers.chunk_mark``, in ``marks``; none without chunks."""
    if buffers.chunk == 0:
        return []
    kernel, b = kernels.build(PRECISIONS[network.dtype][0]), buffers

    def run(_: Share) -> None:
        b.scan_marks.run()
        launch(kernel.list_marks, b.chunk_count, [b.chunk_mark_sum], [b.marks.place, b.marks.chunk], network.device)

    return [Stage("cut off", run, shared=False)]


def link_points(network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, distance: float) -> list[Stage]:
    """Return the stages that link ``buffers.point_moved`` into a grid for each channel, to find what is near.

    Args:
        network: The network whose points moved.
        channels: Its channels.
        buffers: Gets ``point_next`` and ``bucket_head``.
        distance: How far apart near points are at most, in greatest widths of the channel; a cell is twice as wide.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device

    def clear(_: Share) -> None:
        buffers.bucket_head.zero_()

    def link(share: Share) -> None:
        launch(
            kernel.insert_points,
            dim=share.point_threads,
            inputs=[channels.start, channels.form, channels.step, distance, share.work, buffers.point_moved],
            outputs=[buffers.point_next, buffers.bucket_row, buffers.bucket_head],
            device=device,
        )

    # A slab empties what is its own.
    cleared = [] if buffers.chunk == 0 else [Stage("cut off", clear, shared=False)]
    return [*cleared, Stage("cut off", link)]


def cut_loops(network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, point_cut: wp.array) -> list[Stage]:
    """Return the stages that cut off the loops between each point and its ``point_cut``; they must not overlap.

    The loops go to ``buffers.cut`` and ``buffers.oxbow_xy`` in the order of the points; their inner points in
    ``point_moved`` become copies of the point before, which have no length.

    Args:
        network: The network whose points moved.
        channels: Its channels.
        buffers: ``share_cut`` tells how much there is to cut, ``point_neck`` is -1 where nothing is.
        point_cut: (P,) int32, see ``buffers``.
    """
    kernel, device, b = kernels.build(PRECISIONS[network.dtype][0]), network.device, buffers

    def record(share: Share) -> None:
        launch(
            kernel.record_cuts,
            share.point_threads,
            [
                channels.start, share.work, channels.necks, b.share_cut, b.share_cut_sum, b.point_neck, point_cut,
                b.section_moved,
            ],
            [b.cut, b.cut_span, b.oxbow_xy, b.oxbow_section, b.point_moved, b.status.array],
            device,
        )  # fmt: skip

    def save(share: Share) -> None:
        launch(
            kernel.save_loops,
            share.point_threads,
            [
                channels.start, share.work, b.share_cut, b.share_cut_sum, b.cut, b.cut_span, b.section_moved,
                b.status.array,
            ],
            [b.oxbow_xy, b.oxbow_section, b.point_moved],
            device,
        )  # fmt: skip

    return [
        Stage("cut off", lambda _: b.scan_cuts.run(), shared=False),
        Stage("cut off", record),
        Stage("cut off", save),
    ]
