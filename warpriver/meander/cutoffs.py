"""Neck cutoffs: a channel that comes closer to itself than its width joins there and leaves the loop behind."""

from __future__ import annotations

import warp as wp

from warpriver.kernels import cutoffs as kernels
from warpriver.meander.buffers import StepBuffers
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import MeanderParams

__all__ = ["cut_loops", "cut_off", "link_points"]


def link_points(network: RiverNetwork, form: wp.array, distance: float, buffers: StepBuffers) -> None:
    """Link ``buffers.point_moved`` into a grid for each channel, in which points up to ``distance`` apart are found.

    Args:
        network: The network whose points moved.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        distance: In greatest widths of the channel; a cell is twice as wide.
        buffers: Gets ``point_next`` and ``bucket_head``.
    """
    kernel = kernels.build(PRECISIONS[network.dtype][0])
    buffers.bucket_head.zero_()
    wp.launch(
        kernel.insert_points,
        dim=buffers.chunk_count,
        inputs=[network.channel_start, form, distance, buffers.chunk, buffers.point_moved],
        outputs=[buffers.point_next, buffers.bucket_head],
        device=network.device,
    )


def cut_loops(network: RiverNetwork, buffers: StepBuffers) -> None:
    """Cut off the loops between each point and its ``point_neck``; they must not overlap.

    The loops go to ``buffers.cut`` and ``buffers.oxbow_xy`` in the order of the channels; their inner points in
    ``point_moved`` become copies of the point before, which have no length.

    Args:
        network: The network whose points moved.
        buffers: ``point_neck``, ``chunk_necks``, ``channel_cuts`` and ``channel_cut_points`` are read.
    """
    kernel = kernels.build(PRECISIONS[network.dtype][0])
    wp.utils.array_scan(buffers.channel_cuts, buffers.channel_cuts_sum, inclusive=True)
    wp.utils.array_scan(buffers.channel_cut_points, buffers.channel_cut_points_sum, inclusive=True)
    wp.launch(
        kernel.cut_necks,
        dim=network.channel_count,
        inputs=[
            network.channel_start, buffers.chunk, buffers.chunk_necks, buffers.channel_cuts_sum,
            buffers.channel_cut_points_sum, buffers.point_neck, buffers.section_moved,
        ],
        outputs=[buffers.cut, buffers.oxbow_xy, buffers.oxbow_section, buffers.point_moved, buffers.fault],
        device=network.device,
    )  # fmt: skip


def cut_off(
    network: RiverNetwork, form: wp.array, spacing: wp.array, params: MeanderParams, buffers: StepBuffers
) -> None:
    """Find all necks among ``buffers.point_moved`` and cut their loops off as :func:`cut_loops` does.

    Args:
        network: The network whose points moved.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        spacing: (C,) even spacing of the points before the move, m.
        params: ``cutoff_distance`` and ``cutoff_min_arc``, in widths.
        buffers: Scratch and results.
    """
    buffers.neck_count.zero_()
    buffers.channel_cuts_sum.zero_()
    buffers.channel_cut_points_sum.zero_()
    if params.cutoff_distance == 0.0:
        return
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    start, chunk, chunks = network.channel_start, buffers.chunk, buffers.chunk_count
    distance = params.cutoff_distance
    link_points(network, form, distance, buffers)
    wp.launch(
        kernel.find_necks,
        dim=chunks,
        inputs=[
            start, form, spacing, distance, params.cutoff_min_arc, chunk, int(device.is_cpu),
            buffers.point_moved, buffers.section_moved, buffers.point_next, buffers.bucket_head,
        ],
        outputs=[buffers.point_neck, buffers.chunk_necks, buffers.neck_count],
        device=device,
    )  # fmt: skip
    wp.launch(
        kernel.select_cuts,
        dim=network.channel_count,
        inputs=[start, chunk, buffers.chunk_necks, buffers.neck_count],
        outputs=[buffers.channel_cuts, buffers.channel_cut_points, buffers.point_neck],
        device=device,
    )
    cut_loops(network, buffers)
