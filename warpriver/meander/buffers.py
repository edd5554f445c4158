"""Device arrays that one step works in, by point and by channel, sized by capacity."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels.polyline import GOAL, POINTS, STATUS_SIZE, SUBSTEP_SIZE, Marks, Work
from warpriver.meander.scans import Scan
from warpriver.meander.stages import Share, Stage
from warpriver.network import PRECISIONS, RiverNetwork

__all__ = [
    "SUBSTEPS_IN_A_ROW",
    "StepBuffers",
    "StepChannels",
]

# Sub-steps that a GPU does in a row at most before the host looks at them; never more than went before without an event
# that is for the host. On the CPU looking costs nothing.
SUBSTEPS_IN_A_ROW = 16
# Consecutive points that a thread takes, on a GPU and on the CPU; 0: slabs of whole channels.
CUDA_CHUNK, CPU_CHUNK = 32, 0
# Points of a slab on the CPU at most (of more than one channel): what a phase leaves of so many points is still in the
# cache when the next one reads it.
SLAB_POINTS = 16_384
# Points of a chunk where a thread copies runs of points.
CPU_COPY_CHUNK = 4096


class Status:
    """How a row of sub-steps went, as one small block of integers: all that the host looks at after a row.

    On the CPU the host sees the device's array itself, without a call that costs. On a GPU the block travels by way of
    pinned memory, to the device before a row and back after it, and both copies can be recorded with the row.

    Attributes:
        array: The numbers of ``kernels/polyline.py``, then the number of each sub-step of the row in its step and how
            many there are in that step.
    """

    def __init__(self, device: Any):
        """Allocate on a device."""
        size = STATUS_SIZE + 2 * SUBSTEPS_IN_A_ROW
        self.array = wp.zeros(size, dtype=wp.int32, device=device)
        self._host = self.array if device.is_cpu else wp.zeros(size, dtype=wp.int32, device="cpu", pinned=True)
        self._view = self._host.numpy()

    def begin(self, steps: int) -> None:
        """Set nothing done, nothing wrong, and that many steps to do, on the side of the host."""
        points = self._view[POINTS]
        self._view[...] = 0
        self._view[GOAL], self._view[POINTS] = steps, points

    def send(self) -> None:
        """Copy the host's block to the device."""
        if self._host is not self.array:
            wp.copy(self.array, self._host)

    def fetch(self) -> None:
        """Copy the device's block to the host, who has to wait for it; see ``read``."""
        if self._host is not self.array:
            wp.copy(self._host, self.array)

    def stages(self, row: list[Stage]) -> list[Stage]:
        """Return a row of stages with both copies around them."""
        if self._host is self.array:
            return row
        return [
            Stage("row", lambda _: self.send(), shared=False),
            *row,
            Stage("row", lambda _: self.fetch(), shared=False),
        ]

    def read(self) -> np.ndarray:
        """Wait for the device and return the host's block."""
        if self._host is not self.array:
            wp.synchronize_device(self.array.device)
        return self._view


class StepBuffers:
    """Scratch of one step for a network of up to ``point_capacity`` points.

    Attributes:
        point_moved: (P,) vec2, points after the move and the cutoffs, m.
        section_moved: (P,) vec2, width and depth that go with ``point_moved``, or None where they are constant.
        point_smoothed: (P,) vec2, room for a smoothing pass, made by the first one.
        point_rate: (P,) migration rate, m/yr, positive to the right.
        point_arc: (P,) float64, arc length from the channel's head (with chunks: from the chunk's first point), m.
        point_next, bucket_head: linked lists of the points in each grid cell; 0 ends a list. ``bucket_row``: the same
            table by fours.
        point_neck: (P,) int32, the later point that a point's neck reaches, -1 if none.
        point_cut: (P,) int32, the point at which the loop that is cut off there ends, -1 for none, where a point has a
            neck; in the memory of ``point_next``.
        chunk_length, chunk_offset: int64, what each chunk adds to the arc length, and the running sum.
        chunk_mark, chunk_mark_sum: which chunks hold necks or ends of shortcuts, and the running sum.
        marks: The list of those chunks.
        share_cut, share_cut_sum: vec2i, cutoffs of this step that begin in each slab or chunk and their points.
        cut, cut_span: (K,) records of cutoffs; ``oxbow_xy``, ``oxbow_section``: their points, end to end.
        block_bucket: grid of the search for collisions, four integers a cell; ``point_next`` and ``point_neck`` serve
            it as the lists' links and the blocks' channels.
        status: How the sub-steps went.
        chunk: Points that a thread takes, 0 where it takes whole channels.
        share_count: Number of chunks, or of the slabs of whole channels.
    """

    def __init__(self, network: RiverNetwork, point_capacity: int, cut_capacity: int, oxbow_capacity: int):
        """Allocate for ``network``, with room for that many points, cutoffs a step and oxbow points a step."""
        scalar, vec2, _ = PRECISIONS[network.dtype]
        device = network.device
        self.chunk = CPU_CHUNK if device.is_cpu else CUDA_CHUNK
        self.point_capacity = point_capacity
        self.chunk_count = math.ceil(point_capacity / self.chunk) if self.chunk else 1
        self.share_count = self.chunk_count if self.chunk else math.ceil(point_capacity / SLAB_POINTS)

        def zeros(count: int, dtype: Any) -> wp.array:
            return wp.zeros(count, dtype=dtype, device=device)

        varies = network.point_section is not None
        self.point_moved = zeros(point_capacity, vec2)
        self.section_moved = zeros(point_capacity, vec2) if varies else None
        self.point_smoothed: wp.array | None = None
        self.point_rate = zeros(point_capacity, scalar)
        self.point_arc = zeros(point_capacity, wp.float64)
        self.point_next = zeros(point_capacity, wp.int32)
        self.point_cut = self.point_next
        # With chunks a bucket has two fields.
        self.bucket_head = zeros((8 if self.chunk else 4) * point_capacity, wp.int32)
        self.bucket_row: wp.array = wp.array(
            ptr=self.bucket_head.ptr, dtype=wp.vec4i, shape=point_capacity, device=device, copy=False
        )
        self.point_neck = zeros(point_capacity, wp.int32)
        self.chunk_length = zeros(self.chunk_count, wp.int64)
        self.chunk_offset = zeros(self.chunk_count, wp.int64)
        self.chunk_mark = zeros(self.chunk_count, wp.vec2i)
        self.chunk_mark_sum = zeros(self.chunk_count, wp.vec2i)
        self.marks = Marks()
        if self.chunk:
            self.marks.place, self.marks.chunk = (zeros(self.chunk_count + k, wp.int32) for k in (1, 0))
        self.share_cut = zeros(self.share_count, wp.vec2i)
        self.share_cut_sum = zeros(self.share_count, wp.vec2i)
        self.block_bucket = zeros(4 << max(6, (point_capacity - 1).bit_length() - 1), wp.int32)
        self.status = Status(device)

        def scan(kind: str, value: wp.array, out: wp.array) -> Scan:
            return Scan(kind, value, out, scalar, serial=not self.chunk)

        self.scan_lengths = scan("lengths", self.chunk_length, self.chunk_offset)
        self.scan_marks = scan("marks", self.chunk_mark, self.chunk_mark_sum)
        self.scan_cuts = scan("pairs", self.share_cut, self.share_cut_sum)
        self.allocate_cuts(network, cut_capacity, oxbow_capacity)

    def allocate_cuts(self, network: RiverNetwork, cuts: int, oxbow_points: int) -> None:
        """Make room for so many cutoffs and oxbow points in a row of sub-steps."""
        vec2, device = PRECISIONS[network.dtype][1], network.device
        self.cut_capacity, self.oxbow_capacity = cuts, oxbow_points
        self.cut = wp.zeros(cuts, dtype=wp.vec4i, device=device)
        self.cut_span = wp.zeros(cuts, dtype=wp.vec2i, device=device)
        self.oxbow_xy = wp.zeros(oxbow_points, dtype=vec2, device=device)
        varies = network.point_section is not None
        self.oxbow_section = wp.zeros(oxbow_points, dtype=vec2, device=device) if varies else None

    def begin_row(self, steps: int = 1) -> None:
        """Set ``status`` to nothing done, nothing wrong, and that many steps to do; 0: points are sampled anew."""
        self.status.begin(steps)
        self.status.send()

    def read_status(self) -> list[int]:
        """Return ``status`` as it is now on the device."""
        self.status.fetch()
        return self.status.read().tolist()

    @property
    def nbytes(self) -> int:
        """Device memory of all arrays in bytes."""
        return _nbytes(self)


class StepChannels:
    """What a step needs of each channel of a network, with room for ``capacity`` of them.

    Beyond the network's channels there are empty ones, without points, which always rest: so the arrays, and with them
    a recorded step, outlast edits of the network.

    Attributes:
        start: (C + 1,) offsets of the channels' points; the network's ``channel_start`` is a view of it.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        spacing: (C,) even spacing of the points, m.
        limit: (C,) vec3 of the two limits of a sub-step (see ``step_limits``), yr, and the least width, m.
        nodes: (C,) vec2i, labels of the nodes above and below; see ``gathered_nodes``.
        closed: (C,) int32, 1 for a ring; None where the network has none, as it never gets one then.
        area: (C,) int64, area of each ring in the step, see ``measure_rings``; None likewise.
        head: (C,) int32, where the route round each ring begins, see ``find_path``; None likewise.
        mobility: (C,) greatest factor by which the ground lets a point of the channel move, or None on a plain.
        below: (C,) int32, the channel that each flows into, -1 if none; ``tributaries``: how many flow into it.
        drift: (C,) speed of the junction above, m/yr; ``awake``, ``shift``: scratch of its drift.
        pace: (C,) greatest speed of a point in the time step so far, m/yr; ``pace_bits``: the same memory as integers,
            as ``mobility_bits`` is that of ``mobility``.
        parts: (C,) int32, equal parts in which a channel does a time step; 0 where it does not move.
        step: (C,) time step in this sub-step, yr; 0 where the channel rests.
        substep: three int32, sub-steps done, how many there are, 1 once that is settled; ``most``: one int32, how many
            the channels ask for.
        necks: (C,) int32, necks or shortcuts of each channel, where the work is dealt out in slabs.
        samples, start_next, spacing_next: points, offsets and spacing that resampling gives.
        share_contacts: places where channels touch, by slab or chunk; ``share_contacts_sum`` runs over them.
        slabs: Shares of the work that can be done one after the other or at once.
        whole: All the work as one share.
    """

    whole: Share
    slabs: list[Share]
    share_contacts: wp.array
    share_contacts_sum: wp.array
    scan_contacts: Scan
    scan_samples: Scan
    _slab_channel: wp.array

    def __init__(self, network: RiverNetwork, capacity: int, *, mobile: bool):
        """Allocate for ``network``; ``mobile``: with room for ``mobility``."""
        scalar, vec2, _ = PRECISIONS[network.dtype]

        def zeros(count: int, dtype: Any = wp.int32) -> wp.array:
            return wp.zeros(count, dtype=dtype, device=network.device)

        self.capacity = capacity
        self.start, self.start_next = zeros(capacity + 1), zeros(capacity + 1)
        self.form = zeros(capacity, wp.types.vector(4, scalar))
        self.spacing, self.spacing_next = zeros(capacity, scalar), zeros(capacity, scalar)
        self.limit = zeros(capacity, wp.types.vector(3, scalar))
        self.pace, self.step = zeros(capacity, scalar), zeros(capacity, scalar)
        self.pace_bits = _bits(self.pace)
        self.parts = zeros(capacity)
        self.below, self.tributaries, self.awake = zeros(capacity), zeros(capacity), zeros(capacity)
        self.drift, self.shift = zeros(capacity, scalar), zeros(capacity, vec2)
        self.mobility = zeros(capacity, scalar) if mobile else None
        self.mobility_bits = None if self.mobility is None else _bits(self.mobility)
        self.nodes = zeros(capacity, wp.vec2i)
        rings = bool(network.channel_closed.any())
        self.closed = zeros(capacity) if rings else None
        self.area = zeros(capacity, wp.int64) if rings else None
        self.head = zeros(capacity) if rings else None
        self.substep = zeros(SUBSTEP_SIZE)
        self.most = zeros(1)
        self.necks, self.samples = zeros(capacity), zeros(capacity)
        self.plan_anew()

    def fill(
        self,
        network: RiverNetwork,
        *,
        form: np.ndarray,
        spacing: np.ndarray,
        limit: np.ndarray,
        nodes: np.ndarray,
        drift: np.ndarray | None = None,
        pace: np.ndarray | None = None,
        parts: np.ndarray | None = None,
        mobility: np.ndarray | None = None,
    ) -> None:
        """Take the channels of ``network`` over; the arguments are host arrays of the attributes' shapes."""
        count = network.channel_count
        start = network.starts()
        self.start.assign(np.concatenate([start, np.full(self.capacity - count, start[-1], np.int32)]))
        network.channel_start = self.start[: count + 1]
        for array, values in (
            (self.form, form), (self.spacing, spacing), (self.limit, limit), (self.nodes, nodes), (self.pace, pace),
            (self.drift, drift), (self.parts, parts), (self.mobility, mobility),
            (self.closed, network.channel_closed.astype(np.int32)),
        ):  # fmt: skip
            if array is not None:
                _assign(array, np.zeros(0) if values is None else values)
        leaving = np.full(network.node_count, -1)
        leaving[network.channel_from] = np.arange(count)
        below = np.where(network.channel_closed, -1, leaving[network.channel_to])
        # Beyond the channels nothing flows on.
        _assign(self.below, np.concatenate([below, np.full(self.capacity - count, -1)]))
        _assign(self.tributaries, np.bincount(below[below >= 0], minlength=count))
        for stale in (self.step, self.necks, self.samples):
            stale.zero_()

    def plan_anew(self) -> None:
        """Let the next sub-step begin a step, and the step be planned."""
        self.substep.assign(np.array([0, 1, 0], np.int32))

    def set_step(self, values: np.ndarray) -> None:
        """Set ``step`` of the network's channels from a host array."""
        _assign(self.step, values)

    def set_pace(self, values: np.ndarray) -> None:
        """Set ``pace`` of the network's channels from a host array."""
        _assign(self.pace, values)

    def deal_out(self, network: RiverNetwork, buffers: StepBuffers, *, anew: bool) -> None:
        """Deal the work out: in slabs of whole channels on the CPU, in chunks of points on a GPU.

        Args:
            network: The network.
            buffers: Its ``share_count`` says how many shares there may be.
            anew: Make the shares; otherwise only what they hold changes.
        """
        by_slab = buffers.chunk == 0
        threads = buffers.share_count
        if anew:
            self._slab_channel = wp.zeros(threads + 1 if by_slab else 1, dtype=wp.int32, device=network.device)
            work = Work()
            work.status, work.slab_channel = buffers.status.array, self._slab_channel
            work.chunk, work.first = buffers.chunk, 0
            self.whole = Share(work, threads, threads if by_slab else self.capacity)
            self.slabs = [self.whole.slab(k) for k in range(threads)] if by_slab and threads > 1 else [self.whole]
            self.share_contacts = wp.zeros(threads, dtype=wp.int32, device=network.device)
            self.share_contacts_sum = wp.zeros(threads, dtype=wp.int32, device=network.device)
            scalar = PRECISIONS[network.dtype][0]
            self.scan_contacts = Scan("counts", self.share_contacts, self.share_contacts_sum, scalar, serial=by_slab)
            self.scan_samples = Scan("counts", self.samples, self.start_next[1:], scalar, serial=by_slab)
        if by_slab:
            # All slabs get a like number of points, so that threads that take as many slabs have as much to do.
            start = network.starts().astype(np.int64)
            first = np.unique(start[:-1] * threads // start[-1], return_index=True)[1]
            table = np.full(threads + 1, network.channel_count, np.int32)
            table[: len(first)] = first
            self._slab_channel.assign(table)

    @property
    def nbytes(self) -> int:
        """Device memory of all arrays in bytes."""
        return _nbytes(self)


def _assign(array: wp.array, values: np.ndarray) -> None:
    """Copy a host array to the beginning of a device array, and fill the rest with 0."""
    host = np.zeros(array.shape + values.shape[1:], values.dtype)
    host[: len(values)] = values
    array.assign(host)


def _bits(array: wp.array) -> wp.array:
    """The memory of real numbers from 0 on as integers, whose order is theirs."""
    kind = wp.int64 if array.dtype is wp.float64 else wp.int32
    return wp.array(ptr=array.ptr, dtype=kind, shape=array.shape, device=array.device, copy=False)


def _nbytes(owner: object) -> int:
    # Two that begin at the same place are one.
    arrays = {a.ptr: a for a in vars(owner).values() if isinstance(a, wp.array)}
    return sum(int(np.prod(a.shape)) * wp.types.type_size_in_bytes(a.dtype) for a in arrays.values())
