"""Limits of the processes that read files and make maps."""

from __future__ import annotations

import contextlib
import ctypes

__all__ = ["limit_memory", "release_memory"]


def limit_memory(most: int) -> None:
    """Let this process take no more memory than so many bytes, where the system can hold it to that."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    except (ImportError, ValueError, OSError):  # not on this system
        pass


def release_memory() -> None:
    """Give freed memory back to the system, where the C library keeps it otherwise: arrays of many sizes leave gaps."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
