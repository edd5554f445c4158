"""What a file holds, told from its name and, where that leaves it open, from its content."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Literal

from warpriver.cli.shared import ending_of, stored_run
from warpriver.errors import InputError, MissingFileError

__all__ = ["Kind", "kind_of", "written_terrains"]

Kind = Literal["lines", "raster", "run", "scene", "terrain", "valley"]


def kind_of(path: Path) -> Kind:
    """Tell what a file or folder holds.

    Raises:
        ValueError: Its name is of no known format.
        FileNotFoundError: There is nothing.
    """
    from warpriver.io.raster.terrains import terrain_formats
    from warpriver.io.tables import holds_scene
    from warpriver.io.vector.networks import line_formats

    if not path.exists():
        raise MissingFileError(f"{path}: there is no such file or folder")
    if stored_run(path) is not None:
        return "run"
    if path.is_dir():
        raise InputError(f"{path} is a folder without a run; give a file, or the folder of a run")
    if path.suffix.lower() == ".toml":
        return "scene" if holds_scene(path) else "valley"
    lines, cells = line_formats(), terrain_formats()
    ending = ending_of(path, ())
    if ending in lines:
        return "lines"
    if ending not in cells:
        raise InputError(
            f"{path}: {ending or 'no ending'} names no format; known are {', '.join(lines)} (lines), "
            f"{', '.join(cells)} (terrains and rasters), .toml (scenes and valleys) and folders of runs"
        )
    return "raster" if ending == ".npz" and not _holds_heights(path) else "terrain"


def written_terrains() -> dict[str, bool]:
    """Return the endings of terrains that can be written, and whether what they need is installed."""
    from warpriver.io.raster.terrains import SUFFIXES, terrain_formats

    return {suffix: installed for suffix, installed in terrain_formats().items() if suffix in SUFFIXES}


def _holds_heights(path: Path) -> bool:
    """Tell a terrain in an .npz file from another raster, whose numbers are called values."""
    try:
        with zipfile.ZipFile(path) as archive:
            return "values.npy" not in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return True  # whoever reads it says what is wrong
