"""Device arrays that one step works in, sized by capacity: allocated on the host, filled on the device."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.network import PRECISIONS, RiverNetwork

__all__ = [
    "FAULT_NONE",
    "FAULT_NOT_FINITE",
    "FAULT_OXBOWS_FULL",
    "FAULT_SHORTCUTS_FULL",
    "StepBuffers",
    "chunk_size",
]

# Values of ``fault``; the kernels write the same numbers.
FAULT_NONE, FAULT_NOT_FINITE, FAULT_OXBOWS_FULL, FAULT_SHORTCUTS_FULL = 0, 1, 2, 3

# Points a thread works on. On the CPU a launch is one serial loop, and a long chunk makes the walk back upstream that
# starts each chunk cheap; a GPU wants many threads.
CPU_CHUNK, CUDA_CHUNK = 4096, 32


def chunk_size(device: Any) -> int:
    """Points a thread works on, on that device."""
    return CPU_CHUNK if device.is_cpu else CUDA_CHUNK


class StepBuffers:
    """Scratch of one step for a network of up to ``point_capacity`` points.

    Attributes:
        point_moved: (P,) vec2, points after the move and the cutoffs, m.
        section_moved: (P,) vec2, width and depth that go with ``point_moved``, or None where they are constant.
        point_rate: (P,) migration rate, m/yr, positive to the right.
        point_arc: (P,) float64, arc length from the first point of the chunk, m.
        point_next, bucket_head: linked lists of the points in each grid cell; 0 ends a list.
        point_neck: (P,) int32, the later point that a point's neck reaches, -1 if none.
        channel_cuts, channel_cut_points: (C,) int32, cutoffs of this step and their points; ``..._sum`` run over them.
        cut: (K,) vec4i records; ``oxbow_xy``, ``oxbow_section``: their points, end to end.
        block_head, block_high: grid of the search for collisions: lists of blocks of points, and the cell's last
            channel + 1; ``point_next`` and ``point_neck`` serve it as the lists' links and the blocks' channels.
        contact_count: one int32, blocks that touch another channel.
        fault: one int32, 0 while all is well.
        neck_count: one int32, candidates found in this step.
    """

    def __init__(self, network: RiverNetwork, point_capacity: int, cut_capacity: int, oxbow_capacity: int):
        """Allocate for ``network``, with room for that many points, cutoffs a step and oxbow points a step."""
        scalar, vec2, _ = PRECISIONS[network.dtype]
        device = network.device
        self.chunk = chunk_size(device)
        self.point_capacity = point_capacity
        self.cut_capacity = cut_capacity
        self.oxbow_capacity = oxbow_capacity
        self.chunk_count = math.ceil(point_capacity / self.chunk)

        def zeros(count: int, dtype: Any) -> wp.array:
            return wp.zeros(count, dtype=dtype, device=device)

        varies = network.point_section is not None
        self.point_moved = zeros(point_capacity, vec2)
        self.section_moved = zeros(point_capacity, vec2) if varies else None
        self.point_rate = zeros(point_capacity, scalar)
        self.point_arc = zeros(point_capacity, wp.float64)
        self.chunk_length = zeros(self.chunk_count, wp.float64)
        self.chunk_offset = zeros(self.chunk_count, wp.float64)
        self.point_next = zeros(point_capacity, wp.int32)
        self.bucket_head = zeros(4 * point_capacity, wp.int32)
        self.point_neck = zeros(point_capacity, wp.int32)
        self.chunk_necks = zeros(self.chunk_count, wp.int32)
        blocks = 1 << max(6, (point_capacity - 1).bit_length())
        self.block_head = zeros(blocks, wp.int32)
        self.block_high = zeros(blocks, wp.int32)
        self.chunk_contacts = zeros(self.chunk_count, wp.int32)
        self.chunk_contacts_sum = zeros(self.chunk_count, wp.int32)
        self.contact_count = zeros(1, wp.int32)
        self.cut = zeros(cut_capacity, wp.vec4i)
        self.oxbow_xy = zeros(oxbow_capacity, vec2)
        self.oxbow_section = zeros(oxbow_capacity, vec2) if varies else None
        self.fault = zeros(1, wp.int32)
        self.neck_count = zeros(1, wp.int32)
        self.fit_channels(network)

    def fit_channels(self, network: RiverNetwork) -> None:
        """Allocate anew what goes by channel, for a network whose channels have changed."""
        scalar, channels = PRECISIONS[network.dtype][0], network.channel_count

        def zeros(count: int, dtype: Any) -> wp.array:
            return wp.zeros(count, dtype=dtype, device=network.device)

        self.channel_cuts = zeros(channels, wp.int32)
        self.channel_cuts_sum = zeros(channels, wp.int32)
        self.channel_cut_points = zeros(channels, wp.int32)
        self.channel_cut_points_sum = zeros(channels, wp.int32)
        self.channel_start_next = zeros(channels + 1, wp.int32)
        self.channel_samples = zeros(channels, wp.int32)
        self.channel_spacing_next = zeros(channels, scalar)

    @property
    def nbytes(self) -> int:
        """Device memory of all arrays in bytes."""
        arrays = [a for a in vars(self).values() if isinstance(a, wp.array)]
        return sum(int(np.prod(a.shape)) * wp.types.type_size_in_bytes(a.dtype) for a in arrays)
