"""Neck cutoffs: a channel that comes closer to itself than its width joins there and leaves the loop behind."""

from __future__ import annotations

import warp as wp

from warpriver.kernels import cutoffs as kernels
from warpriver.meander.buffers import StepBuffers
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import MeanderParams

__all__ = ["cut_off"]


def cut_off(
    network: RiverNetwork, form: wp.array, spacing: wp.array, params: MeanderParams, buffers: StepBuffers
) -> None:
    """Find all necks among ``buffers.point_moved`` and cut their loops off, all on the device.

    The loops go to ``buffers.cut`` and ``buffers.oxbow_xy`` in the order of the channels; their inner points in
    ``point_moved`` become copies of the point before, which have no length.

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
    buffers.bucket_head.zero_()
    wp.launch(
        kernel.insert_points,
        dim=chunks,
        inputs=[start, form, distance, chunk, buffers.point_moved],
        outputs=[buffers.point_next, buffers.bucket_head],
        device=device,
    )
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
    wp.utils.array_scan(buffers.channel_cuts, buffers.channel_cuts_sum, inclusive=True)
    wp.utils.array_scan(buffers.channel_cut_points, buffers.channel_cut_points_sum, inclusive=True)
    wp.launch(
        kernel.cut_necks,
        dim=network.channel_count,
        inputs=[
            start, chunk, buffers.chunk_necks, buffers.channel_cuts_sum, buffers.channel_cut_points_sum,
            buffers.point_neck, buffers.section_moved,
        ],
        outputs=[buffers.cut, buffers.oxbow_xy, buffers.oxbow_section, buffers.point_moved, buffers.fault],
        device=device,
    )  # fmt: skip
