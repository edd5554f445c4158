"""Schedules: when a run is recorded, or something is called."""

from __future__ import annotations

import dataclasses
import math

from warpriver.errors import InputError
from warpriver.validate import positive, whole

__all__ = ["Every"]


@dataclasses.dataclass(frozen=True)
class Every:
    """A schedule: every so many steps, or every so many years.

    Attributes:
        steps: Interval in steps, or None.
        years: Interval in years, or None.
    """

    steps: int | None = None
    years: float | None = None

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.years is None):
            raise InputError("give Every either steps or years, not both")
        if self.steps is not None:
            whole(self.steps, "steps of Every", 1)
        else:
            positive(self.years, "years of Every")

    def due(self, step: int, time_step: float) -> bool:
        """Tell whether the state after ``step`` steps of ``time_step`` yr is on the schedule."""
        if self.steps is not None:
            return step % self.steps == 0
        assert self.years is not None
        # A part in 1e9 of slack, so that 10 steps of 0.1 yr make a year.
        now = math.floor(step * time_step / self.years + 1e-9)
        return now > math.floor((step - 1) * time_step / self.years + 1e-9)
