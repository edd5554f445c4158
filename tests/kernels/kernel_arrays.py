"""Packed device arrays for kernel tests: lines end to end, and outputs filled with what no kernel writes."""

import dataclasses
import inspect
import itertools
import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels.polyline import STATUS_SIZE, Work

REALS = {"float64": np.float64, "float32": np.float32}
SCALARS = {"float64": wp.float64, "float32": wp.float32}
UNWRITTEN = -7
# Ways to deal points out to threads: chunks of so many points, or slabs of whole channels, see ``slab_bounds``; slabs
# that are "apart" have a launch each, the last one first.
CHUNKS = (1, 2, 7, 64, 4096)
SLABS = ("one slab", "a slab each", "uneven slabs", "a slab each, apart", "uneven slabs, apart")
DEALS = (*CHUNKS, *SLABS)


def starts_of(lines):
    """Offsets of the lines in the packed array, (C + 1,) int32."""
    return np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int32)


def split(packed, start):
    """Cut a packed host array into channels."""
    return [packed[a:b] for a, b in itertools.pairwise(start)]


def to_device(values, kind, device):
    """Copy a host array to the device; None stays None."""
    return None if values is None else wp.array(np.ascontiguousarray(values), dtype=kind, device=device)


def unwritten(count, kind, device):
    """Device array that holds NaN, or -7 where it holds integers."""
    integral = kind is wp.int32 or kind is wp.vec4i or kind is wp.vec2i
    array = wp.empty(count, dtype=kind, device=device)
    array.fill_(UNWRITTEN if integral else math.nan)
    return array


def by_fours(array):
    """The same array of integers, as one of vectors of four."""
    return wp.array(ptr=array.ptr, dtype=wp.vec4i, shape=len(array) // 4, device=array.device, copy=False)


def chunk_count(capacity, chunk):
    """Threads that cover a capacity."""
    return math.ceil(capacity / chunk)


@dataclasses.dataclass(frozen=True)
class Part:
    """One launch of several that share the work: its threads, for kernels over points and over channels."""

    work: Any
    threads: int
    channel_threads: int


def slab_bounds(deal, channels):
    """First channel of each slab, and the channel count at the end."""
    if deal.startswith("a slab each"):
        return list(range(channels + 1))
    if deal.startswith("uneven slabs"):
        # Slabs without channels lie behind the others.
        return [*sorted({0, 1, channels // 3, channels - 1} if channels > 1 else {0}), channels, channels, channels]
    return [0, channels]


def going_on(device):
    """Status of a step of which nothing is done and nothing wrong."""
    return wp.zeros(STATUS_SIZE, dtype=wp.int32, device=device)


def share_out(deal, channels, capacity, device):
    """Launches that do the work of all channels, dealt out in one of the ways of ``DEALS``.

    Args:
        deal: Points of a chunk, or one of ``SLABS``.
        channels: Number of channels.
        capacity: Room for points, which the chunks cover.
        device: Warp device.
    """
    if isinstance(deal, int):
        work = Work()
        work.status, work.chunk = going_on(device), deal
        return [Part(work, chunk_count(capacity, deal), channels)]
    bounds = slab_bounds(deal, channels)
    slabs = to_device(np.array(bounds, np.int32), wp.int32, device)
    spans = [(0, len(bounds) - 1)]
    if deal.endswith("apart"):
        spans = [(k, k + 1) for k in range(len(bounds) - 1)][::-1]
    parts = []
    for first, stop in spans:
        work = Work()
        work.status, work.slab_channel, work.first = going_on(device), slabs, first
        parts.append(Part(work, stop - first, stop - first))
    return parts


def share_count(deal, channels, capacity):
    """Number of chunks or slabs in all."""
    return chunk_count(capacity, deal) if isinstance(deal, int) else len(slab_bounds(deal, channels)) - 1


def vec2_of(scalar):
    """Warp's type of a 2-vector."""
    return wp.types.vector(2, scalar)


def forms(width, depth, widest, spacing, scalar, device):
    """The vec4 a channel that the kernels read: mean width, mean depth, greatest width, spacing asked for."""
    table = np.stack(np.broadcast_arrays(width, depth, widest, spacing), axis=1)
    return to_device(table, wp.types.vector(4, scalar), device)


def ring_flags(rings, channels, device):
    """Array of 1 for rings and 0 for lines on the device; None where there are no rings, as in a simulation."""
    flags = np.zeros(channels, np.int32)
    flags[list(rings)] = 1
    return to_device(flags, wp.int32, device) if len(rings) else None


def nested(function, *names):
    """Follow the names of device functions inward from a kernel: they live in the closures of ``build``."""
    for name in names:
        function = inspect.getclosurevars(function.func).nonlocals[name]
    return function
