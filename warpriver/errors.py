"""Errors: what is refused, each of a built-in kind as well, so that ``except ValueError`` goes on to work."""

from __future__ import annotations

__all__ = [
    "InputError",
    "InputTypeError",
    "InternalError",
    "MissingExtraError",
    "MissingFileError",
    "NotFiniteError",
    "OutOfMemoryError",
    "OutputExistsError",
    "PathError",
    "WarpriverError",
    "WrongPathError",
]


class WarpriverError(Exception):
    """Base of every error that warpriver raises on purpose; its text says what is wrong, where, and what to do."""


class InputError(WarpriverError, ValueError):
    """A value that cannot be honoured."""


class InputTypeError(WarpriverError, TypeError):
    """A value of a kind that is not understood."""


class MissingExtraError(WarpriverError, ImportError):
    """An optional part that is needed is not installed."""


class OutOfMemoryError(WarpriverError, MemoryError):
    """More memory is needed than there is; told before anything is allocated."""


class NotFiniteError(WarpriverError, FloatingPointError):
    """A point of a simulation is no longer finite."""


class InternalError(WarpriverError, RuntimeError):
    """Something that cannot be: a fault of the program."""


class PathError(WarpriverError, OSError):
    """A file or folder that cannot be read or written."""


class MissingFileError(PathError, FileNotFoundError):
    """A file or folder that is not there."""


class WrongPathError(PathError, IsADirectoryError):
    """A folder where a file is needed."""


class OutputExistsError(PathError, FileExistsError):
    """A file or folder that is there already."""
