"""Neck cutoffs: a channel that comes closer to itself than its width joins there and leaves the loop behind."""

from __future__ import annotations

import warp as wp

from warpriver.kernels import cutoffs as kernels
from warpriver.meander.buffers import StepBuffers, StepChannels
from warpriver.meander.stages import Share, Stage
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import MeanderParams

__all__ = ["cut_loops", "cut_off", "link_points"]


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
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    # A slab links its points in order.
    start, distance, ordered = channels.start, params.cutoff_distance, int(buffers.chunk == 0)
    keep_longer = int(params.ring_policy == "longer")

    def find(share: Share) -> None:
        wp.launch(
            kernel.find_necks,
            dim=share.point_threads,
            inputs=[
                start, channels.form, channels.spacing, channels.step, channels.closed, distance,
                params.cutoff_min_arc, share.work, ordered, buffers.point_moved, buffers.section_moved,
                buffers.point_next, buffers.bucket_head,
            ],
            outputs=[buffers.point_neck, buffers.chunk_necks, channels.necks],
            device=device,
        )  # fmt: skip
        wp.launch(
            kernel.select_cuts,
            dim=share.channel_threads,
            inputs=[start, channels.closed, keep_longer, share.work, buffers.chunk_necks, channels.necks],
            outputs=[channels.cuts, channels.cut_points, buffers.point_neck],
            device=device,
        )

    return [
        *link_points(network, channels, buffers, distance),
        Stage("cut off", find),
        *cut_loops(network, channels, buffers),
    ]


def link_points(network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, distance: float) -> list[Stage]:
    """Return the stages that link ``buffers.point_moved`` into a grid for each channel, to find what is near.

    Args:
        network: The network whose points moved.
        channels: Its channels; ``necks`` is made ready to be counted up.
        buffers: Gets ``point_next`` and ``bucket_head``; ``chunk_necks`` is made ready to be counted up.
        distance: How far apart near points are at most, in greatest widths of the channel; a cell is twice as wide.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device

    def clear(_: Share) -> None:
        buffers.bucket_head.zero_()
        buffers.chunk_necks.zero_()
        channels.necks.zero_()

    def link(share: Share) -> None:
        wp.launch(
            kernel.insert_points,
            dim=share.point_threads,
            inputs=[channels.start, channels.form, channels.step, distance, share.work, buffers.point_moved],
            outputs=[buffers.point_next, buffers.bucket_row, buffers.bucket_head],
            device=device,
        )

    # A slab empties what is its own.
    cleared = [] if buffers.chunk == 0 else [Stage("cut off", clear, shared=False)]
    return [*cleared, Stage("cut off", link)]


def cut_loops(network: RiverNetwork, channels: StepChannels, buffers: StepBuffers) -> list[Stage]:
    """Return the stages that cut off the loops between each point and its ``point_neck``; they must not overlap.

    The loops go to ``buffers.cut`` and ``buffers.oxbow_xy`` in the order of the channels; their inner points in
    ``point_moved`` become copies of the point before, which have no length.

    Args:
        network: The network whose points moved.
        channels: Its channels; ``cuts`` and ``cut_points`` tell how much there is to cut.
        buffers: ``point_neck`` and, with chunks, ``chunk_necks`` are read.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device

    def number(_: Share) -> None:
        wp.utils.array_scan(channels.cuts, channels.cuts_sum, inclusive=True)
        wp.utils.array_scan(channels.cut_points, channels.cut_points_sum, inclusive=True)

    def cut(share: Share) -> None:
        wp.launch(
            kernel.cut_necks,
            dim=share.channel_threads,
            inputs=[
                channels.start, share.work, buffers.chunk_necks, channels.cuts_sum,
                channels.cut_points_sum, buffers.point_neck, buffers.section_moved,
            ],
            outputs=[buffers.cut, buffers.oxbow_xy, buffers.oxbow_section, buffers.point_moved, buffers.status],
            device=device,
        )  # fmt: skip

    return [Stage("cut off", number, shared=False), Stage("cut off", cut)]
