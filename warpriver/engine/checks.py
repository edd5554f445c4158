"""What a phase of a step promises, checked on the host."""

from __future__ import annotations

import numpy as np

from warpriver.errors import WarpriverError

__all__ = ["PhaseError", "require"]


class PhaseError(WarpriverError, AssertionError):
    """A phase of a step broke its promise; the text says which, where and by how much."""


def require(good: np.ndarray, phase: str, problem: str, kind: str) -> None:
    """Raise :class:`PhaseError` unless all is good; it names the first of its kind that is not."""
    if not good.all():
        index = int(np.argmin(good))
        raise PhaseError(f"after {phase!r}: {kind} {index} {problem} ({int((~good).sum())} in all)")
