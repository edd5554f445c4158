"""Packed device arrays for kernel tests: lines end to end, and outputs filled with what no kernel writes."""

import inspect
import itertools
import math

import numpy as np
import warp as wp

REALS = {"float64": np.float64, "float32": np.float32}
SCALARS = {"float64": wp.float64, "float32": wp.float32}
UNWRITTEN = -7
CHUNKS = (1, 2, 7, 64, 4096)


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
    integral = kind is wp.int32 or kind is wp.vec4i
    array = wp.empty(count, dtype=kind, device=device)
    array.fill_(UNWRITTEN if integral else math.nan)
    return array


def chunk_count(capacity, chunk):
    """Threads that cover a capacity."""
    return math.ceil(capacity / chunk)


def vec2_of(scalar):
    """Warp's type of a 2-vector."""
    return wp.types.vector(2, scalar)


def forms(width, depth, widest, spacing, scalar, device):
    """The vec4 a channel that the kernels read: mean width, mean depth, greatest width, spacing asked for."""
    table = np.stack(np.broadcast_arrays(width, depth, widest, spacing), axis=1)
    return to_device(table, wp.types.vector(4, scalar), device)


def nested(function, *names):
    """Follow the names of device functions inward from a kernel: they live in the closures of ``build``."""
    for name in names:
        function = inspect.getclosurevars(function.func).nonlocals[name]
    return function
