"""Errors: each derives from :class:`WarpriverError` and from a built-in one, so that ``except ValueError`` works."""

from __future__ import annotations

import inspect
import warnings
from pathlib import Path

__all__ = [
    "InputError",
    "InputTypeError",
    "InternalError",
    "MissingExtraError",
    "MissingFileError",
    "MissingRecordError",
    "NotFiniteError",
    "OutOfMemoryError",
    "OutputExistsError",
    "PathDeniedError",
    "PathError",
    "RunLockedError",
    "WarpriverError",
    "WrongPathError",
    "warn",
]

HOME = str(Path(__file__).parent)


class WarpriverError(Exception):
    """Base of every error that warpriver raises on purpose; its text says what is wrong, where, and what to do."""


class InputError(WarpriverError, ValueError):
    """A value that is not valid."""


class MissingRecordError(InputError, IndexError):
    """A record that a run does not have."""


class InputTypeError(InputError, TypeError):
    """A value of the wrong type."""


class MissingExtraError(WarpriverError, ImportError):
    """An optional dependency that is needed is not installed."""


class OutOfMemoryError(WarpriverError, MemoryError):
    """More memory is needed than is available; raised before anything is allocated."""


class NotFiniteError(WarpriverError, FloatingPointError):
    """A point of a simulation is no longer finite."""


class InternalError(WarpriverError, RuntimeError):
    """A fault of the program."""


class PathError(WarpriverError, OSError):
    """A file or folder that cannot be read or written."""

    @staticmethod
    def of(error: OSError, what: str) -> PathError:
        """Return an error of the system as one of ours, of the same built-in kind and with its ``errno``.

        Args:
            error: What the system or a library raised.
            what: What could not be done, as "cannot write rivers.csv"; the reason is added.
        """
        kinds = (MissingFileError, WrongPathError, OutputExistsError, PathDeniedError)
        kind = next((kind for kind in kinds if isinstance(error, kind.__bases__[1])), PathError)
        reason = error.strerror or " ".join(str(error).split()) or type(error).__name__
        told = kind(f"{what}: {reason}")
        told.errno = error.errno
        return told


class MissingFileError(PathError, FileNotFoundError):
    """A file or folder that is not there."""


class WrongPathError(PathError, IsADirectoryError):
    """A folder where a file is needed."""


class OutputExistsError(PathError, FileExistsError):
    """A file or folder that is there already."""


class PathDeniedError(PathError, PermissionError):
    """A file or folder that this user may not read or write."""


class RunLockedError(PathError, BlockingIOError):
    """The folder of a run that another process or simulation writes to."""


def warn(text: str) -> None:
    """Warn of what was not as expected but could be used, as of the line outside of warpriver that called it."""
    level, frame = 1, inspect.currentframe()
    while frame is not None and frame.f_code.co_filename.startswith(HOME):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, UserWarning, stacklevel=level)
