"""Running sums on the device, as launches that allocate nothing and whose bits depend on no order."""

from __future__ import annotations

import math
from typing import Any

import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.engine.stages import launch
from warpriver.kernels import scans as kernels

__all__ = ["Scan"]

# Values that one thread adds up by itself.
SERIAL = 64


class Scan:
    """The inclusive running sum of an array of whole numbers, in one to three launches.

    Attributes:
        value: (N,) what is added up: int32 ("counts"), int64 ("lengths") or vec2i; of vec2i both components are sums
            ("pairs"), or the second is a running maximum of numbers from 0 on ("marks").
        sum: (N,) the running sums.
    """

    def __init__(self, kind: str, value: DeviceArray, out: DeviceArray, scalar: Any, *, serial: bool):
        """Allocate what the launches need.

        Args:
            kind: "counts", "lengths", "pairs" or "marks".
            value: What is added up.
            out: Where the running sums go.
            scalar: Precision of the modules of kernels that are loaded anyway.
            serial: One thread does all, as suits a CPU.
        """
        self.value, self.sum = value, out
        kernel, count, device = kernels.build(scalar), len(value), value.device
        self._sum_groups, self._scan_groups = getattr(kernel, f"sum_{kind}"), getattr(kernel, f"scan_{kind}")

        def totals(length: int) -> DeviceArray:
            return wp.zeros(length, dtype=value.dtype, device=device)

        # One level, or two or three whose groups are of like size.
        levels = 1 if serial or count <= SERIAL else 2 if count <= SERIAL**2 else 3
        self._group = max(1, count) if levels == 1 else math.ceil(count ** (1.0 / levels))
        groups = math.ceil(count / self._group)
        self._threads = [groups, math.ceil(groups / self._group)]
        self._totals = [totals(length) if levels > k + 1 else None for k, length in enumerate(self._threads)]

    def run(self) -> None:
        """Launch."""
        group, (totals, uppers), device = self._group, self._totals, self.value.device
        if totals is not None:
            launch(self._sum_groups, self._threads[0], [group, self.value], [totals], device)
        if uppers is not None:
            launch(self._sum_groups, self._threads[1], [group, totals], [uppers], device)
        inputs = [group, group, self.value, totals, uppers]
        launch(self._scan_groups, self._threads[0], inputs, [self.sum], device)
