"""How the processes of a session are started: forked from one that has imported what they need, and begin at once."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import threading
from collections.abc import Callable
from multiprocessing.context import BaseContext
from typing import Any

__all__ = ["context", "name_process", "run_apart", "warm_up"]

# Modules that the processes need.
NEEDED = ["warpriver.studio.worker", "warpriver.studio.mapping", "warpriver.studio.opening"]
# Seconds between two looks at a process.
LOOK = 0.05


def context() -> BaseContext:
    """Return the way in which processes are started here: forked from one without threads, or begun anew."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    made = multiprocessing.get_context("forkserver")
    made.set_forkserver_preload(NEEDED)
    return made


def warm_up() -> None:
    """Let the process from which others are forked begin; it imports while the page is loaded."""
    if context().get_start_method() == "forkserver":
        from multiprocessing import forkserver

        threading.Thread(target=forkserver.ensure_running, daemon=True).start()


def name_process(name: str) -> None:
    """Give this process a name that tools of the system show, of 15 letters at most, where that can be."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).prctl(15, name.encode()[:15], 0, 0, 0)


def run_apart(
    what: Callable[..., None], arguments: tuple[Any, ...], seconds: float, given_up: threading.Event
) -> str | None:
    """Call a function in a process of its own, and return what went wrong, None for nothing.

    Args:
        what: The function. After its arguments it gets a connection, to which it sends what went wrong, or "".
        arguments: Arguments of the function.
        seconds: Time after which the process is killed.
        given_up: Event that kills the process when it is set.
    """
    ours, theirs = context().Pipe()
    process = context().Process(target=what, args=(*arguments, theirs), daemon=True)  # type: ignore[attr-defined]
    process.start()
    theirs.close()
    with contextlib.closing(ours):
        waited = 0.0
        try:
            while not ours.poll(LOOK):
                waited += LOOK
                if given_up.is_set():
                    return "it was given up"
                if waited > seconds:
                    return f"it took longer than {seconds:g} s"
            return str(ours.recv_bytes().decode()) or None
        except (EOFError, OSError):
            process.join(2.0)
            return f"its process ended ({process.exitcode})"
        finally:
            if process.is_alive():
                process.join(0.2)
                process.kill()
            process.join()
