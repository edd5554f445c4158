"""Files as wholes: read and unpacked at once, replaced in one move."""

from __future__ import annotations

import contextlib
import gzip
import os
import shutil
import tempfile
import threading
import warnings
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from warpriver.errors import InputError, MissingFileError, WrongPathError

__all__ = ["beside", "check_readable", "decoded", "filtered_warnings", "is_number"]

# Python has one list of warning filters for all threads, so that those who change it take turns.
_FILTERS = threading.RLock()


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


def decoded(path: Path) -> str:
    """Return the text of a file, unpacked if its name ends in .gz, or raise ``ValueError``."""
    data = path.read_bytes()
    if path.suffix.lower() == ".gz":
        try:
            data = gzip.decompress(data)
        except (OSError, EOFError, zlib.error) as error:
            raise InputError(f"{path}: not a whole gzip file ({error}); fetch it again") from error
    if b"\0" in data:
        raise InputError(f"{path}: holds zero bytes, so it is not UTF-8 text; is it binary, or UTF-16?")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if not text.strip():
        raise InputError(f"{path}: the file is empty")
    return text


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


@contextlib.contextmanager
def beside(path: Path, parts: Sequence[str] = ()) -> Iterator[Path]:
    """Give a path of that name in a new folder beside it; at the end what is in there moves to its place.

    Args:
        path: File to write.
        parts: Suffixes of further files that belong to it; those that are not written anew are removed.

    Raises:
        OSError: The file cannot be written; what was there before is untouched.
    """
    folder = None
    try:
        if path.is_dir():
            raise WrongPathError("it is a directory; give a file name")
        folder = Path(tempfile.mkdtemp(prefix=".writing-", dir=path.parent))
        yield folder / path.name
        made = {file.name for file in folder.iterdir()}
        for stale in (path.with_suffix(part) for part in parts):
            if stale.name not in made:
                stale.unlink(missing_ok=True)
        # The file itself last: once it is in place, its parts are there as well.
        for name in sorted(made, key=lambda name: name == path.name):
            os.replace(folder / name, path.parent / name)
    except OSError as error:
        raise type(error)(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
