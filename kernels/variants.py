"""How the kernels of a file are made: once, and several times from one source, for several types or layouts."""

import functools
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

# One lock for all files, as the ``build`` of one calls those of others.
_BUILDING = threading.RLock()


def once(build: Callable[[Any], SimpleNamespace]) -> Callable[[Any], SimpleNamespace]:
    """Cache what a ``build`` makes for each precision.

    Unlike with ``functools.cache`` two threads never make it at the same time: the second would register its kernels
    in the module of the first, which may be running.
    """
    made: dict[Any, SimpleNamespace] = {}

    @functools.wraps(build)
    def built(scalar: Any) -> SimpleNamespace:
        found = made.get(scalar)
        if found is None:
            with _BUILDING:
                found = made.get(scalar)
                if found is None:
                    found = made[scalar] = build(scalar)
        return found

    return built


def named(name: str) -> Callable[[Callable], Callable]:
    """Give a kernel a name of its own, below the decorator that makes it one.

    Warp tells the kernels of a module apart by their names alone where it records or compiles ahead of time (1.19).
    """

    def rename(function: Callable) -> Callable:
        function.__qualname__ = f"build.<locals>.{name}"
        return function

    return rename
