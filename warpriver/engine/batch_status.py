"""Status: how a batch of sub-steps went, on the device and on the host."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpriver.engine.stages import Stage
from warpriver.kernels.status import BEGUN, GOAL, POINTS, STATUS_SIZE

__all__ = ["MAX_BATCH", "Status"]

# Sub-steps that a GPU does at once at most before the host looks at them; never more than went before without an event
# that is for the host. On the CPU looking costs nothing.
MAX_BATCH = 16


class Status:
    """How a batch of sub-steps went, as one small block of integers: all that the host looks at after a batch.

    On the CPU the host sees the device's array itself, without a call that costs. On a GPU the block travels by way of
    pinned memory, to the device before a batch and back after it, and both copies can be recorded with the batch.

    Attributes:
        array: The numbers of ``kernels/polyline.py``, then the number of each sub-step of the batch in its step and how
            many there are in that step.
    """

    def __init__(self, device: Any):
        """Allocate on a device."""
        size = STATUS_SIZE + 2 * MAX_BATCH
        self.array = wp.zeros(size, dtype=wp.int32, device=device)
        self._host = self.array if device.is_cpu else wp.zeros(size, dtype=wp.int32, device="cpu", pinned=True)
        self._view: np.ndarray = self._host.numpy()
        self._sent = False

    def begin(self, steps: int, begun: int = 0) -> None:
        """Set nothing done, nothing wrong, and that many steps to do, on the side of the host.

        Args:
            steps: Steps to do.
            begun: Steps done before.
        """
        if self._sent:
            # The copy to the device may still be on its way.
            wp.synchronize_device(self.array.device)
            self._sent = False
        points = self._view[POINTS]
        self._view.fill(0)
        self._view[GOAL], self._view[POINTS], self._view[BEGUN] = steps, points, begun

    def send(self) -> None:
        """Copy the host's block to the device."""
        if self._host is not self.array:
            wp.copy(self.array, self._host)
            self._sent = True

    def fetch(self) -> None:
        """Copy the device's block to the host, who has to wait for it; see ``read``."""
        if self._host is not self.array:
            wp.copy(self._host, self.array)

    def stages(self, batch: list[Stage]) -> list[Stage]:
        """Return a batch of stages with both copies around them."""
        if self._host is self.array:
            return batch
        send = Stage("batch", lambda _: self.send(), shared=False)
        return [send, *batch, Stage("batch", lambda _: self.fetch(), shared=False)]

    def read(self) -> np.ndarray:
        """Wait for the device and return the host's block."""
        if self._host is not self.array:
            wp.synchronize_device(self.array.device)
            self._sent = False
        return self._view
