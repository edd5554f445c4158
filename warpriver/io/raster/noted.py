"""Terrains that know the file that they were read from."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec

from warpriver.terrain import Terrain, TerrainFile

__all__ = ["noted_file"]

P = ParamSpec("P")


def noted_file(read: Callable[P, Terrain]) -> Callable[P, Terrain]:
    """Make a function that reads a terrain note the path, and the arguments that were given, in ``Terrain.file``."""
    signature = inspect.signature(read)

    @functools.wraps(read)
    def noting(*args: P.args, **kwargs: P.kwargs) -> Terrain:
        terrain = read(*args, **kwargs)
        given = dict(signature.bind(*args, **kwargs).arguments)
        path = Path(given.pop("path")).resolve()
        given.pop("device", None)  # a matter of the machine
        terrain.file = TerrainFile(str(path), {name: value for name, value in given.items() if value is not None})
        return terrain

    return noting
