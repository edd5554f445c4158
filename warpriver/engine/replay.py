"""Stages recorded once and replayed with little overhead, by several threads where there are slabs for them.

A GPU records them as a CUDA graph. Warp's recordings on the CPU are one at a time in a process, and hold whatever any
of its threads launches meanwhile; so there the launches are noted by the thread that makes them, and replayed by a
kernel.
"""

from __future__ import annotations

import ctypes
import itertools
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from warpriver.device import load_kernel
from warpriver.engine.stages import Share, Stage, noted_launches, run_stages
from warpriver.kernels import replay as kernels

__all__ = ["GPU_LOCK", "NATIVE_VERSIONS", "LaunchList", "Replay"]

# A GPU's stream is shared by all threads, and while one records all that is launched on it is recorded. So steps on
# GPUs are taken in turn.
GPU_LOCK = threading.RLock()
# Versions of Warp whose compiled CPU kernels are called with the addresses of their bounds and of their arguments. With
# any other they are launched one by one, which takes longer (measured: 90 instead of 2 us for 35 small launches).
NATIVE_VERSIONS = ("1.19",)


class LaunchList:
    """Launches on the CPU, done in order by one call during which the interpreter serves other threads."""

    def __init__(self, launches: list[Any]):
        """Take launches that :func:`~warpriver.engine.stages.noted_launches` noted."""
        self._launches = launches
        self._call: Any = None
        if launches and wp.__version__.rpartition(".")[0] in NATIVE_VERSIONS:
            self._arguments = [_packed(command.params[1:]) for command in launches]
            addresses = [
                (
                    ctypes.cast(command.hooks.forward, ctypes.c_void_p).value,
                    ctypes.addressof(command.params[0]),
                    ctypes.addressof(arguments),
                )
                for command, arguments in zip(launches, self._arguments, strict=True)
            ]
            self._table = np.array(addresses, np.uint64)
            kernel, device = kernels.build(wp.float64).run_launches, wp.get_device("cpu")
            load_kernel(kernel, device, 1)
            self._call = wp.launch(
                kernel,
                1,
                [wp.uint64(self._table.ctypes.data), len(launches)],
                device=device,
                block_dim=1,
                record_cmd=True,
            )

    def run(self) -> None:
        """Do the launches."""
        if self._call is not None:
            self._call.launch()
            return
        for command in self._launches:
            command.launch()


def _packed(values: list[Any]) -> ctypes.Structure:
    """The arguments of a compiled kernel as it takes them: a C struct of a field for each."""
    fields = [(f"field_{k}", type(value)) for k, value in enumerate(values)]
    packed: ctypes.Structure = type("Arguments", (ctypes.Structure,), {"_fields_": fields})(*values)
    return packed


class _Graph:
    """Launches on a GPU, recorded as a CUDA graph."""

    def __init__(self, stages: list[Stage], whole: Share, slabs: list[Share], device: Any):
        with wp.ScopedCapture(device=device) as recording:
            run_stages(stages, whole, slabs)
        self._graph = recording.graph

    def run(self) -> None:
        wp.capture_launch(self._graph)


def _record(stages: list[Stage], whole: Share, slabs: list[Share], device: Any) -> LaunchList | _Graph:
    if device.is_cuda:
        return _Graph(stages, whole, slabs, device)
    with noted_launches() as launches:
        run_stages(stages, whole, slabs)
    return LaunchList(launches)


class Replay:
    """Stages recorded once, to be replayed."""

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
            slabs: The same in shares.
            device: Warp device.
            pool: Threads that help the calling one; replays release the interpreter, so that they run side by side.
            helpers: How many threads the pool has.
        """
        hands = [part.tolist() for part in np.array_split(np.arange(len(slabs)), min(1 + helpers, len(slabs)))]
        self._pool = pool if len(hands) > 1 else None
        if self._pool is None:
            self._records = [[_record(stages, whole, slabs, device)]]
            return
        self._records = []
        for shared, group in itertools.groupby(stages, lambda stage: stage.shared):
            together = list(group)
            parts = [[slabs[k] for k in hand] for hand in hands] if shared else [[whole]]
            self._records.append([_record(together, whole, part, device) for part in parts])

    def run(self) -> None:
        """Replay all stages."""
        for records in self._records:
            waiting = []
            if self._pool is not None:
                waiting = [self._pool.submit(record.run) for record in records[1:]]
            records[0].run()
            for future in waiting:
                future.result()
