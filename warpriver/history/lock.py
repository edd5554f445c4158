"""The lock on the folder of a run: one process writes to it at a time.

The lock is held by the system for the open file ``run.lock``, so that it ends with its process, however that ends. What
the file says is for people: who holds it.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from pathlib import Path
from typing import Any

from warpriver.errors import PathError, RunLockedError, warn

try:
    import fcntl
except ImportError:  # not on this system: then a file that is there is a lock
    fcntl = None  # type: ignore[assignment]

__all__ = ["LOCK", "FolderLock"]

LOCK = "run.lock"


class FolderLock:
    """The lock of one folder; a context that may be entered again while it is held."""

    def __init__(self, folder: Path):
        """Prepare the lock of a folder; nothing is locked yet."""
        self._folder = folder
        self._file: int | None = None
        self._depth = 0

    @property
    def held(self) -> bool:
        """Whether this object holds the lock."""
        return self._depth > 0

    def __enter__(self) -> FolderLock:
        if self._depth == 0:
            self._file = self._acquire()
        self._depth += 1
        return self

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth == 0 and self._file is not None:
            file, self._file = self._file, None
            # The folder may be gone.
            with contextlib.suppress(OSError):
                (self._folder / LOCK).unlink()
            os.close(file)

    def _acquire(self) -> int:
        """Return the open file that holds the lock.

        Raises:
            RunLockedError: Another process, or another simulation of this one, writes to the folder.
            OSError: The lock cannot be made.
        """
        path = self._folder / LOCK
        while True:
            try:
                file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            except OSError as error:
                raise PathError.of(error, f"cannot write to the run {self._folder}") from error
            try:
                holder = _holder(file)
                if not _locked(file, unknown=holder is not None):
                    raise RunLockedError(_refusal(self._folder, holder))
                # Whoever held it before may have removed the file in the meantime: then another one is there by now.
                if _is_at(file, path):
                    break
            except BaseException:
                os.close(file)
                raise
            os.close(file)
        if holder is not None:
            warn(
                f"{self._folder}: process {holder.get('process')} on {holder.get('host')} ended without closing the "
                "run, which is taken over from what it stored"
            )
        told = {"process": os.getpid(), "host": socket.gethostname(), "since": time.strftime("%Y-%m-%d %H:%M:%S")}
        # Without room for who holds it, it is held all the same.
        with contextlib.suppress(OSError):
            os.ftruncate(file, 0)
            os.lseek(file, 0, os.SEEK_SET)
            os.write(file, json.dumps(told).encode())
        return file


def _holder(file: int) -> dict[str, Any] | None:
    """Return what a lock file says of who holds it, or held it when they were killed; None for a new file."""
    text = os.read(file, 4096)
    if not text:
        return None
    try:
        values = json.loads(text)
    except ValueError:
        values = None
    return values if isinstance(values, dict) else {}


def _locked(file: int, *, unknown: bool) -> bool:
    """Lock an open file if nobody else has; ``unknown``: whether somebody is to be supposed to where locks are not."""
    if fcntl is None:
        return not unknown
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return not unknown
    return True


def _is_at(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False


def _refusal(folder: Path, holder: dict[str, Any] | None) -> str:
    who = "another process" if not holder else f"process {holder.get('process')} on {holder.get('host')}"
    since = f" since {holder['since']}" if holder and "since" in holder else ""
    return (
        f"{folder} is being written by {who}{since}; wait until it has ended, or store the run elsewhere. If no such "
        f"process is left, remove {folder / LOCK}"
    )
