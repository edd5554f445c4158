"""Kernels that are made several times from one source, for several types or layouts."""

from collections.abc import Callable


def named(name: str) -> Callable[[Callable], Callable]:
    """Give a kernel a name of its own, below the decorator that makes it one.

    Recordings on the CPU tell the kernels of a module apart by their names alone (Warp 1.19).
    """

    def rename(function: Callable) -> Callable:
        function.__qualname__ = f"build.<locals>.{name}"
        return function

    return rename
