"""Files that appear whole or not at all: written beside their place, brought to the disk, checked, then moved.

Everything that warpriver writes goes through :func:`beside`. Libraries that write for it may lose an error: some close
a file without looking whether its last bytes found room. So a file counts as written only once it is on the disk and,
for such libraries, once ``check`` has read it back.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from warpriver.errors import PathError, WrongPathError

__all__ = ["STAGING", "beside", "in_memory", "sync", "sync_folder"]

# Folders of files that are being written begin with this; one that is there long after was left by a killed process.
STAGING = ".writing-"


@contextlib.contextmanager
def beside(path: Path, parts: Sequence[str] = (), check: Callable[[Path], None] | None = None) -> Iterator[Path]:
    """Give a path of that name in a new folder beside it; at the end what is in there moves to its place.

    Args:
        path: File to write.
        parts: Suffixes of further files that belong to it; those that are not written anew are removed.
        check: Called with the path in the new folder once all is on the disk; raises if what it reads there is not
            what was to be written. For writers that may lose an error.

    Yields:
        The path to write to.

    Raises:
        OSError: The file cannot be written; what was there before is untouched.
    """
    folder = None
    try:
        if path.is_dir():
            raise WrongPathError("it is a directory; give a file name")
        folder = Path(tempfile.mkdtemp(prefix=STAGING, dir=path.parent))
        yield folder / path.name
        made = {file.name for file in folder.iterdir()}
        if path.name not in made or (folder / path.name).stat().st_size == 0:
            raise PathError("nothing was written")
        for name in made:
            sync(folder / name)
        if check is not None:
            _check(folder / path.name, check)
        for stale in (path.with_suffix(part) for part in parts):
            if stale.name not in made:
                stale.unlink(missing_ok=True)
        # The file itself last: once it is in place, its parts are there as well.
        for name in sorted(made, key=lambda name: name == path.name):
            os.replace(folder / name, path.parent / name)
        sync_folder(path.parent)
    except OSError as error:
        raise PathError.of(error, f"cannot write {path}") from error
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def in_memory(path: str | Path) -> Iterator[io.BytesIO]:
    """Give a buffer, and write it to a file: for encoders that do not look whether what they write finds room."""
    buffer = io.BytesIO()
    yield buffer
    with open(path, "wb") as file:
        file.write(buffer.getbuffer())


def _check(path: Path, check: Callable[[Path], None]) -> None:
    """Call a check; whatever it raises means that the file is not whole."""
    try:
        check(path)
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PathError(f"what was written is not whole when read back ({reason}); is the disk full?") from error


def sync(path: Path) -> None:
    """Bring the content of a file to the disk; an error of a write that was delayed is raised here."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the system can do that."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        # Some network file systems refuse to; they do it by themselves.
        with contextlib.suppress(OSError):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)
