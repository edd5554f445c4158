"""Files as wholes: read and unpacked at once."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

from warpriver.errors import InputError, MissingFileError

__all__ = ["check_readable", "decoded", "is_number"]


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
