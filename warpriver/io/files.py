"""Files as wholes: read and unpacked within limits, and named so that GDAL opens them."""

from __future__ import annotations

import contextlib
import gzip
import os
import re
import tempfile
import threading
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from warpriver.device import available_memory
from warpriver.errors import InputError, MissingFileError, OutOfMemoryError

__all__ = ["check_readable", "check_unpacked", "decoded", "filtered_warnings", "is_number", "plain_path"]

# Python has one list of warning filters for all threads, so that those who change it take turns.
_FILTERS = threading.RLock()

# A packed file is unpacked to so many times its size, or to so many bytes, whichever is more. Numbers that were
# measured do not shrink further; what does is built to fill the memory.
MAX_UNPACKED, ALWAYS_UNPACKED = 100, 1 << 28
# Bytes that text takes while it is read, divided by those of the file.
TEXT_MEMORY = 6
# What libraries above GDAL take for parts of a URI or an archive, and GDAL for one of its virtual file systems.
NOT_PLAIN = re.compile(r"[!;?#\x00-\x1f]|^/vsi|\.zip", re.IGNORECASE)


def check_readable(path: Path) -> None:
    """Raise ``FileNotFoundError`` or ``ValueError`` unless there is a file that holds something."""
    if not path.exists():
        raise MissingFileError(f"{path}: there is no such file")
    if path.is_dir():
        raise InputError(f"{path}: is a directory; give a file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty")


def is_number(word: str) -> bool:
    """Tell whether a word of a text file is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def check_unpacked(path: Path, packed: int, unpacked: int) -> None:
    """Raise ``ValueError`` for a file that unpacks to far more than files of its kind do.

    Args:
        path: The file, for messages.
        packed: Its size in bytes.
        unpacked: What it unpacks to.
    """
    if unpacked > max(ALWAYS_UNPACKED, MAX_UNPACKED * packed):
        raise InputError(
            f"{path}: {packed} bytes unpack to {unpacked / 1e9:.3g} GB or more, which no file of measurements does; "
            "if you trust it, unpack it yourself and read that"
        )


def decoded(path: Path) -> str:
    """Return the text of a file, unpacked if its name ends in .gz.

    Raises:
        ValueError: It is empty, no text, cut short, or unpacks to far more than files of numbers do.
        MemoryError: There is no memory for it.
    """
    size, free = path.stat().st_size, available_memory()
    limit = size if free is None else free // TEXT_MEMORY
    if size > limit:
        raise _too_large(path, size, limit)
    data = _unpacked(path, size, free) if path.suffix.lower() == ".gz" else path.read_bytes()
    if b"\0" in data:
        raise InputError(f"{path}: holds zero bytes, so it is not UTF-8 text; is it binary, or UTF-16?")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if not text.strip():
        raise InputError(f"{path}: the file is empty")
    return text


def _unpacked(path: Path, size: int, free: int | None) -> bytes:
    """Return what a gzip file holds; no more than the limit is ever unpacked."""
    limit = max(ALWAYS_UNPACKED, MAX_UNPACKED * size)
    limit = limit if free is None else min(limit, free // TEXT_MEMORY)
    try:
        with gzip.open(path) as file:
            data = file.read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: not a whole gzip file ({error}); fetch it again") from error
    if len(data) > limit:
        check_unpacked(path, size, len(data))
        raise _too_large(path, len(data), limit)
    return data


def _too_large(path: Path, size: int, limit: int) -> OutOfMemoryError:
    return OutOfMemoryError(
        f"{path}: {size / 1e9:.3g} GB of text or more, and there is memory to read {limit / 1e9:.3g} GB; split it"
    )


@contextlib.contextmanager
def plain_path(path: Path) -> Iterator[Path]:
    """Give an absolute path that GDAL and the libraries above it take for this file and nothing else.

    They read "!" and ";" in a name as the end of an archive's, "zip:" at its start as a protocol. A file whose path
    holds such characters is given as a link of a plain name, in a folder of its own that lasts as long as the block,
    beside links to the files that belong to it.
    """
    absolute = Path("/" + os.path.abspath(path).lstrip("/")) if os.name == "posix" else Path(os.path.abspath(path))
    if not NOT_PLAIN.search(str(absolute)):
        yield absolute
        return
    with tempfile.TemporaryDirectory(prefix="warpriver-") as folder:
        for file in os.scandir(absolute.parent):
            if file.name.startswith(f"{absolute.stem}.") and file.is_file():
                os.symlink(file.path, Path(folder) / f"file{file.name.removeprefix(absolute.stem)}")
        yield Path(folder) / f"file{absolute.suffix}"


@contextlib.contextmanager
def filtered_warnings(action: Literal["error", "ignore"], category: type[Warning], message: str = "") -> Iterator[None]:
    """Ignore warnings of a kind within, or raise them.

    Args:
        action: What to do.
        category: The kind.
        message: How their text begins, as a regular expression.
    """
    with _FILTERS, warnings.catch_warnings():
        warnings.filterwarnings(action, message, category)
        yield
