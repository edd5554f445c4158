"""Packed device arrays for kernel tests: lines end to end, and outputs filled with what no kernel writes."""

import dataclasses
import inspect
import itertools
import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels import channels, polyline
from warpriver.kernels import ground as grounds
from warpriver.kernels.channels import Stems, Work
from warpriver.kernels.cuts import Marks
from warpriver.kernels.status import HALT, STATUS_SIZE

REALS = {"float64": np.float64, "float32": np.float32}
SCALARS = {"float64": wp.float64, "float32": wp.float32}
UNWRITTEN = -7


class Backwards(int):
    """Points of a chunk, where each chunk has a launch of its own, the last one first."""

    def __str__(self):
        return f"{int(self)} backwards"

    __repr__ = __str__


# Ways to deal points out to threads: chunks of so many points, or slabs of whole channels, see ``slab_bounds``; slabs
# that are "apart" have a launch each, the last one first.
CHUNKS = (1, 2, 7, 64, 4096, Backwards(7))
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
    if hasattr(kind, "numpy_dtype"):
        table = np.zeros(count, kind.numpy_dtype())
        for name in table.dtype.names:
            table[name] = UNWRITTEN
        return to_device(table, kind, device)
    integral = kind in (wp.int32, wp.int64, wp.vec4i, wp.vec2i)
    array = wp.empty(count, dtype=kind, device=device)
    array.fill_(UNWRITTEN if integral else math.nan)
    return array


def by_fours(array):
    """The same array of integers, as one of vectors of four."""
    return wp.array(ptr=array.ptr, dtype=wp.vec4i, shape=len(array) // 4, device=array.device, copy=False)


def bits_of(array):
    """The same array of real numbers from 0 on, as the integers that the kernels compare them as."""
    kind = wp.int64 if array.dtype is wp.float64 else wp.int32
    return wp.array(ptr=array.ptr, dtype=kind, shape=array.shape, device=array.device, copy=False)


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


def status_of(values, device, row=0):
    """Status on the device with those values by field, 0 elsewhere, and room for a batch of sub-steps."""
    status = np.zeros(STATUS_SIZE + 2 * row, np.int32)
    status[list(values)] = list(values.values())
    return to_device(status, wp.int32, device)


def going_on(device):
    """Status of a step of which nothing is done and nothing wrong."""
    return status_of({}, device)


def share_out(deal, channels, capacity, device, halt=0, status=None):
    """Launches that do the work of all channels, dealt out in one of the ways of ``DEALS``.

    Args:
        deal: Points of a chunk, or one of ``SLABS``.
        channels: Number of channels.
        capacity: Room for points, which the chunks cover.
        device: Warp device.
        halt: Not 0 where the status says halt.
        status: Status on the device, in place of one that tells nothing else.
    """
    status = status_of({HALT: halt}, device) if status is None else status
    if isinstance(deal, int):
        threads = chunk_count(capacity, deal)
        firsts = range(threads)[::-1] if isinstance(deal, Backwards) else [0]
        parts = []
        for first in firsts:
            work = Work()
            work.status, work.chunk, work.first = status, int(deal), first
            # Channels are numbered from the first thread on: all of them are of the launch that begins at 0.
            parts.append(Part(work, threads // len(firsts), channels if first == 0 else 0))
        return parts
    bounds = slab_bounds(deal, channels)
    slabs = to_device(np.array(bounds, np.int32), wp.int32, device)
    spans = [(0, len(bounds) - 1)]
    if deal.endswith("apart"):
        spans = [(k, k + 1) for k in range(len(bounds) - 1)][::-1]
    parts = []
    for first, stop in spans:
        work = Work()
        work.status, work.slab_channel, work.first = status, slabs, first
        parts.append(Part(work, stop - first, stop - first))
    return parts


def share_count(deal, channels, capacity):
    """Number of chunks or slabs in all."""
    return chunk_count(capacity, deal) if isinstance(deal, int) else len(slab_bounds(deal, channels)) - 1


def share_of_points(deal, start):
    """Chunk or slab that each point belongs to, (count,)."""
    if isinstance(deal, int):
        return np.arange(start[-1]) // deal
    owner = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return np.searchsorted(slab_bounds(deal, len(start) - 1)[1:], owner, side="right")


def list_of_marks(chunk_mark, device):
    """The marked chunks as the kernels read them, from (marked, last point reached) of each; for slabs, None, none."""
    marks = Marks()
    if chunk_mark is not None:
        marks.sum = running_marks(chunk_mark, device)
        flags = np.asarray(chunk_mark)[:, 0] > 0
        marks.place = to_device(np.concatenate([[0], np.cumsum(flags)]), wp.int32, device)
        # Beyond the list there is what an earlier step left.
        marks.chunk = to_device(np.append(np.flatnonzero(flags), np.full((~flags).sum(), UNWRITTEN)), wp.int32, device)
    return marks


def arcs_of(deal, point, chunk_offset):
    """Arc lengths as kernels take them, from arrays on the device; ``deal`` as in ``DEALS``."""
    chunk = int(deal) if isinstance(deal, int) else 0
    return struct_of(polyline.Arcs, point=point, chunk_offset=chunk_offset, chunk=chunk)


def running_marks(marks, device):
    """Running sum of the first and running maximum of the second numbers, (N, 2), on the device."""
    marks = np.asarray(marks)
    both = np.stack([np.cumsum(marks[:, 0]), np.maximum.accumulate(marks[:, 1])], axis=1)
    return to_device(both, wp.vec2i, device)


def vec2_of(scalar):
    """Warp's type of a 2-vector."""
    return wp.types.vector(2, scalar)


def structs(columns, kind, device):
    """Array of structs on the device from a column for each member."""
    columns = np.broadcast_arrays(*columns)
    table = np.zeros(len(columns[0]), kind.numpy_dtype())
    for name, column in zip(table.dtype.names, columns, strict=True):
        table[name] = column
    return to_device(table, kind, device)


def forms(width, depth, widest, spacing, scalar, device):
    """Form of each channel as the kernels read it: mean width, mean depth, greatest width, target spacing."""
    return structs((width, depth, widest, spacing), channels.build(scalar).Form, device)


def struct_of(kind, **members):
    """A struct of kernels with those members; those that are None are left out."""
    struct = kind()
    for name, value in members.items():
        if value is not None:
            setattr(struct, name, value)
    return struct


def channels_of(scalar, **members):
    """The channels of a launch; their members are arrays on a device."""
    return struct_of(channels.build(scalar).Channels, **members)


def stems_of(stems, channels, device):
    """The stems that the kernels read, from the links of each as a list of channels; None where there are none."""
    if not stems:
        return None
    upper, lower = np.full(channels, -1), np.full(channels, -1)
    top, bottom = np.arange(channels), np.arange(channels)
    for links in stems:
        upper[links[1:]], lower[links[:-1]] = links[:-1], links[1:]
        top[links], bottom[links] = links[0], links[-1]
    arrays = {"upper": upper, "lower": lower, "top": top, "bottom": bottom}
    arrays = {name: to_device(values.astype(np.int32), wp.int32, device) for name, values in arrays.items()}
    return struct_of(Stems, **arrays, length=wp.zeros(channels, dtype=wp.int64, device=device))


def points_of(scalar, xy, section=None):
    """The points of a launch, with widths and depths or without."""
    return struct_of(channels.build(scalar).Points, xy=xy, section=section)


def ground_of(scalar, height, grid, device):
    """The ground of a launch: heights, or None for a plain, and (west, north, cell size)."""
    kernel = grounds.build(scalar)
    west, north, cell_size = grid
    place = struct_of(kernel.RasterGrid, west=west, north=north, cell_size=cell_size, cells_per_meter=1.0 / cell_size)
    return struct_of(kernel.Ground, height=to_device(height, wp.float64, device), grid=place)


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
