"""A step as a list of stages, and the launches that they are made of: done at once, or noted to be done later."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.device import load_kernel
from warpriver.errors import InternalError
from warpriver.kernels import replay as kernels
from warpriver.kernels.channels import Work
from warpriver.kernels.status import STATUS_SIZE

__all__ = ["CUDA_CHUNK", "Share", "Stage", "clear", "launch", "noted_launches", "put", "run_stages", "whole_share"]

# Threads of a block on a GPU. The kernels of a step need up to 150 registers a thread: in blocks of 64 more of them fit
# on a multiprocessor (65,536 registers) than in Warp's usual 256, and those that need few are not worse off.
BLOCK_DIM = 64
# Consecutive points that a thread takes on a GPU.
CUDA_CHUNK = 32


class _Notes(threading.local):
    """What a thread notes; each thread has its own, so that none sees what another is recording.

    Attributes:
        launches: Launches in order, or None while they are done at once.
        calls: Calls of :func:`launch` and :func:`clear`, also those that had nothing to do.
    """

    launches: list[Any] | None = None
    calls: int = 0


_notes = _Notes()


def launch(kernel: Any, dim: int, inputs: list[Any], outputs: list[Any], device: Any) -> None:
    """Launch a kernel of a step, unless it has no threads: on a GPU an empty launch surfaces as an error later on."""
    noted = _notes.launches
    _notes.calls += 1
    if dim > 0:
        block_dim = 1 if device.is_cpu else BLOCK_DIM
        record = noted is not None
        load_kernel(kernel, device, block_dim)
        command = wp.launch(
            kernel, dim, inputs, outputs, device=device, block_dim=block_dim, record_cmd=record, record_tape=False
        )
        if noted is not None:
            noted.append(command)


def clear(array: DeviceArray) -> None:
    """Set a device array of a step to zero; in a stage this takes the place of ``array.zero_()``."""
    noted = _notes.launches
    if noted is None:
        _notes.calls += 1
        array.zero_()
        return
    inputs = [wp.uint64(array.ptr or 0), wp.uint64(array.size * wp.types.type_size_in_bytes(array.dtype))]
    launch(kernels.build(wp.float64).zero_memory, 1, inputs, [], array.device)
    noted[-1].cleared = array  # lives as long as the launch, which knows but its address


def put(array: DeviceArray, values: np.ndarray) -> None:
    """Copy all values of an array from the host, outside of any stage; on the CPU without a call that costs."""
    device: Any = array.device
    if device.is_cpu:
        np.copyto(array.numpy(), values, casting="unsafe")
    else:
        array.assign(values)


@contextlib.contextmanager
def noted_launches() -> Iterator[list[Any]]:
    """Note the launches of this thread, on the CPU, in the list that is given, and do none of them."""
    _notes.launches = []
    try:
        yield _notes.launches
    finally:
        _notes.launches = None


@dataclasses.dataclass(frozen=True)
class Share:
    """A part of the work of a stage.

    Attributes:
        work: How a launch deals its part out.
        point_threads: Threads of a launch over points.
        channel_threads: Threads of a launch over channels.
    """

    work: Any
    point_threads: int
    channel_threads: int

    def of_channels(self, count: int) -> Share:
        """Return the same share for launches over so many channels."""
        return dataclasses.replace(self, channel_threads=count)

    def slab(self, k: int) -> Share:
        """Return the k-th slab alone."""
        work = Work()
        work.status, work.slab_channel = self.work.status, self.work.slab_channel
        work.chunk, work.first = self.work.chunk, k
        return Share(work, 1, 1)


def whole_share(points: int, device: Any) -> Share:
    """Return the share of a launch over so many points outside of any step: all of them, on the CPU by one thread."""
    work = Work()
    work.status = wp.zeros(STATUS_SIZE, dtype=wp.int32, device=device)
    work.chunk = points if device.is_cpu else CUDA_CHUNK
    return Share(work, math.ceil(points / work.chunk), 0)


@dataclasses.dataclass(frozen=True)
class Stage:
    """What is launched between two points where all the network has to wait for each other.

    Stages are recorded and replayed, so ``run`` does nothing but call :func:`launch` and :func:`clear`.

    Attributes:
        phase: Name of the verb of the step that it belongs to.
        run: Launches the kernels for a share of the work.
        shared: True where each share of the work can be done without the others; else ``run`` gets all of it.
    """

    phase: str
    run: Callable[[Share], None]
    shared: bool = True


def run_stages(stages: Iterable[Stage], whole: Share, slabs: list[Share]) -> None:
    """Run stages in order; stages in a row that can be shared are done slab by slab, while a slab is in the cache."""
    for shared, group in itertools.groupby(stages, lambda stage: stage.shared):
        together = list(group)
        for share in slabs if shared else [whole]:
            for stage in together:
                _run(stage, share)


def _run(stage: Stage, share: Share) -> None:
    calls = _notes.calls
    stage.run(share)
    if _notes.launches is not None and _notes.calls == calls:
        raise InternalError(
            f"a stage of {stage.phase!r} cannot be recorded: it calls neither launch nor clear of "
            "warpriver.engine.stages; use these in place of wp.launch and array.zero_"
        )
