"""Resampling: points at an even spacing again, on the cubic through the moved ones."""

from __future__ import annotations

import warp as wp

from warpriver.kernels import resampling as kernels
from warpriver.meander.buffers import StepBuffers
from warpriver.network import PRECISIONS, RiverNetwork

__all__ = ["measure", "resample"]


def measure(network: RiverNetwork, buffers: StepBuffers) -> None:
    """Measure the arc length of ``buffers.point_moved``, into ``point_arc`` and ``chunk_offset``.

    Args:
        network: The network whose points moved.
        buffers: Scratch and results.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    wp.launch(
        kernel.measure_chunks,
        dim=buffers.chunk_count,
        inputs=[network.channel_start, network.channel_count, buffers.chunk, buffers.point_moved],
        outputs=[buffers.point_arc, buffers.chunk_length],
        device=device,
    )
    wp.utils.array_scan(buffers.chunk_length, buffers.chunk_offset, inclusive=True)


def resample(network: RiverNetwork, form: wp.array, spacing: wp.array, buffers: StepBuffers) -> None:
    """Sample the moved channels evenly and make that the network's new state.

    A channel of length L gets n = round(L / spacing asked for) segments, at least 2, of L / n each; its ends stay.
    Nothing is taken over when ``buffers.fault`` is set, or when the points do not fit into the capacity: then the
    last entry of ``buffers.channel_start_next`` tells how much room the step needs.

    Args:
        network: Gets the new points, and ``channel_start``.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        spacing: (C,) even spacing in m; gets the new one.
        buffers: ``point_moved`` (and ``section_moved``) is read.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    start, chunk, chunks = network.channel_start, buffers.chunk, buffers.chunk_count
    channels = network.channel_count
    measure(network, buffers)
    wp.launch(
        kernel.count_samples,
        dim=channels,
        inputs=[start, form, chunk, buffers.point_arc, buffers.chunk_offset],
        outputs=[buffers.channel_samples, buffers.channel_spacing_next, buffers.fault],
        device=device,
    )
    wp.utils.array_scan(buffers.channel_samples, buffers.channel_start_next[1:], inclusive=True)
    wp.launch(
        kernel.resample_points,
        dim=chunks,
        inputs=[
            start, buffers.channel_spacing_next, chunk, buffers.channel_start_next,
            buffers.point_moved, buffers.section_moved, buffers.point_arc, buffers.chunk_offset, buffers.fault,
        ],
        outputs=[network.point_xy, network.point_section],
        device=device,
    )  # fmt: skip
    wp.launch(
        kernel.commit_step,
        dim=channels + 1,
        inputs=[buffers.point_capacity, buffers.channel_start_next, buffers.channel_spacing_next, buffers.fault],
        outputs=[start, spacing],
        device=device,
    )
