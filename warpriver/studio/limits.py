"""Limits of the processes that read files and make maps."""

from __future__ import annotations

__all__ = ["limit_memory"]


def limit_memory(most: int) -> None:
    """Let this process take no more memory than so many bytes, where the system can hold it to that."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    except (ImportError, ValueError, OSError):  # not on this system
        pass
