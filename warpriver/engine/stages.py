"""A step as a list of stages: run as they stand, recorded and replayed, or dealt out to threads."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels.channels import Work
from warpriver.kernels.status import STATUS_SIZE

__all__ = ["CUDA_CHUNK", "Replay", "Share", "Stage", "launch", "run_stages", "whole_share"]

# Threads of a block on a GPU. The kernels of a step need up to 150 registers a thread: in blocks of 64 more of them fit
# on a multiprocessor (65,536 registers) than in Warp's usual 256, and those that need few are not worse off.
BLOCK_DIM = 64
# Consecutive points that a thread takes on a GPU.
CUDA_CHUNK = 32


def launch(kernel: Any, dim: int, inputs: list[Any], outputs: list[Any], device: Any) -> None:
    """Launch a kernel of a step, unless it has no threads: on a GPU an empty launch surfaces as an error later on."""
    if dim > 0:
        wp.launch(kernel, dim, inputs, outputs, device=device, block_dim=BLOCK_DIM)


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
                stage.run(share)


class Replay:
    """Stages recorded once, to be replayed with little overhead, by several threads where there are slabs for them."""

    def __init__(
        self,
        stages: list[Stage],
        whole: Share,
        slabs: list[Share],
        device: Any,
        pool: ThreadPoolExecutor | None = None,
        helpers: int = 0,
    ):
        """Record the stages, which also compiles their kernels.

        Args:
            stages: Stages in order.
            whole: All the work.
            slabs: The same in parts.
            device: Warp device.
            pool: Threads that help the calling one; replays release the interpreter, so that they run side by side.
            helpers: How many threads the pool has.
        """
        hands = [part.tolist() for part in np.array_split(np.arange(len(slabs)), min(1 + helpers, len(slabs)))]
        self._pool = pool if len(hands) > 1 else None
        if self._pool is None:
            self._graphs = [[_record(stages, whole, slabs, device)]]
            return
        self._graphs = []
        for shared, group in itertools.groupby(stages, lambda stage: stage.shared):
            together = list(group)
            parts = [[slabs[k] for k in hand] for hand in hands] if shared else [[whole]]
            self._graphs.append([_record(together, whole, part, device) for part in parts])

    def run(self) -> None:
        """Replay all stages."""
        for graphs in self._graphs:
            waiting = []
            if self._pool is not None:
                waiting = [self._pool.submit(wp.capture_launch, graph) for graph in graphs[1:]]
            wp.capture_launch(graphs[0])
            for future in waiting:
                future.result()


def _record(stages: list[Stage], whole: Share, slabs: list[Share], device: Any) -> Any:
    with wp.ScopedCapture(device=device) as recording:
        run_stages(stages, whole, slabs)
    return recording.graph
