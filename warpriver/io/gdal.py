"""Names of files for GDAL: some of its Python packages take a name for an address, in an archive or on the web.

pyogrio splits names at "!" and looks for schemes as "zip:"; a path is a path here, whatever stands in it. An absolute
one has no scheme; what has a "!" or the like in it is handed over under another name.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

__all__ = ["is_address", "name_to_read", "name_to_write"]


# What ends the name of an archive, or begins that of one of GDAL's virtual file systems.
ADDRESS = re.compile(r"[!;?#\x00-\x1f]|^/vsi|\.zip", re.IGNORECASE)


def is_address(path: Path) -> bool:
    """Tell whether a path would be taken for an address even when it is absolute."""
    return ADDRESS.search(str(path.absolute())) is not None


@contextlib.contextmanager
def name_to_read(path: Path) -> Iterator[Path]:
    """Give a name under which GDAL finds a file, and the files of the same stem that belong to it."""
    if not is_address(path):
        yield path.absolute()
        return
    with tempfile.TemporaryDirectory() as folder:
        for part in path.parent.iterdir():
            if part.name.startswith(path.stem + ".") and part.is_file():
                _link(part, Path(folder) / f"file{part.name.removeprefix(path.stem)}")
        yield Path(folder) / f"file{path.suffix}"


@contextlib.contextmanager
def name_to_write(path: Path) -> Iterator[Path]:
    """Give a name under which GDAL writes a file; at the end it, and what was written with it, is at ``path``."""
    if not is_address(path):
        yield path.absolute()
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder) / f"file{path.suffix}"
        for part in sorted(Path(folder).iterdir()):
            shutil.move(part, path.parent / f"{path.stem}{part.name.removeprefix('file')}")


def _link(file: Path, name: Path) -> None:
    """Make a file known under another name."""
    try:
        name.symlink_to(file)
    except OSError:  # where a user may not make links
        shutil.copyfile(file, name)
