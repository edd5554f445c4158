"""NumPy's files read within limits: shapes and types are looked at before anything is unpacked."""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from warpriver.device import require_memory
from warpriver.errors import InputError
from warpriver.io.files import check_unpacked

__all__ = ["load_cells"]

# What stands beside the cells is a word or a few numbers; text of a CRS is the longest.
LONGEST_FACT = 1 << 20  # bytes
# How an archive of arrays begins.
ZIP = b"PK"


def load_cells(path: Path, names: Sequence[str], facts: Sequence[str]) -> tuple[str, np.ndarray, dict[str, np.ndarray]]:
    """Return the cells of a .npy or .npz file, and what stands beside them.

    Args:
        path: The file.
        names: Names that the cells may have in an .npz; the first that is there counts.
        facts: Names of small arrays to read as well, where they are there.

    Returns:
        The name of the cells ("" in an .npy), the cells, and the facts by name.

    Raises:
        ValueError: Not such a file, cut short, without cells, or it unpacks to far more than such files do.
        MemoryError: There is no room for the cells.
    """
    try:
        with path.open("rb") as file:
            packed = file.read(2) == ZIP
        if not packed:
            cells = np.load(path, mmap_mode="r", allow_pickle=False)
            _check_cells(path, cells.shape, cells.dtype)
            return "", cells, {}
        with zipfile.ZipFile(path) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            held = [name for name in names if name in members]
            if not held:
                raise InputError(f"holds {', '.join(members) or 'nothing'}, but no array named {names[0]}")
            found = {name: _load_fact(archive, members[name]) for name in facts if name in members}
            return held[0], _load_member(path, archive, members[held[0]]), found
    except (OSError, ValueError, EOFError, RuntimeError, NotImplementedError, zlib.error, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read as NumPy's {path.suffix} ({error}); is the file whole?") from error


def _load_member(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    """Return the cells of an archive."""
    shape, dtype = _header(archive, info)
    _check_cells(path, shape, dtype)
    check_unpacked(path, info.compress_size, math.prod(shape) * dtype.itemsize)
    with archive.open(info) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _load_fact(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    """Return a small array of an archive."""
    shape, dtype = _header(archive, info)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize > LONGEST_FACT:
        raise InputError(f"its {info.filename} is {shape} of {dtype}, too much for a word or a few numbers")
    with archive.open(info) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> tuple[tuple[int, ...], np.dtype]:
    """Return the shape and the type of an array of an archive; its numbers are not unpacked."""
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
        if read is None:
            raise InputError(f"its {info.filename} is of version {version} of NumPy's format")
        shape, _, dtype = read(file)
    if math.prod(shape) * dtype.itemsize > info.file_size:
        raise InputError(f"its {info.filename} is cut short")
    return shape, dtype


def _check_cells(path: Path, shape: tuple[int, ...], dtype: np.dtype) -> None:
    """Raise unless an array can be the cells of a raster, and fits into memory."""
    if len(shape) != 2 or dtype.kind not in "iuf":
        raise InputError(f"an array of shape {shape} and type {dtype} where (rows, columns) numbers belong")
    require_memory(shape, 17 + dtype.itemsize, what=f"{path}: a raster")
