"""Names of files that GDAL writes: some of its Python packages take a name for an address, in an archive or on the web.

pyogrio splits names at "!" and looks for schemes as "zip:". A path is a path here, whatever stands in it; for files
that are read see :func:`warpriver.io.files.plain_path`.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from warpriver.io.files import NOT_PLAIN

__all__ = ["is_address", "name_to_write"]


def is_address(path: Path) -> bool:
    """Tell whether a path would be taken for an address even when it is absolute."""
    return NOT_PLAIN.search(str(path.absolute())) is not None


@contextlib.contextmanager
def name_to_write(path: Path) -> Iterator[Path]:
    """Give a name under which GDAL writes a file; at the end it, and what was written with it, is at ``path``."""
    if not is_address(path):
        yield path.absolute()
        return
    with tempfile.TemporaryDirectory(prefix="warpriver-") as folder:
        yield Path(folder) / f"file{path.suffix}"
        for part in sorted(Path(folder).iterdir()):
            shutil.move(part, path.parent / f"{path.stem}{part.name.removeprefix('file')}")
