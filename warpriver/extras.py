"""Modules that are imported where they are used: those of SciPy, and those of an extra."""

from __future__ import annotations

import importlib
import threading
from typing import Any

from warpriver.errors import MissingExtraError

__all__ = ["IMPORTING", "need"]

# Held while a part of SciPy is imported. Its parts import each other: where two threads import two of them for the
# first time, either may find the other half done.
IMPORTING = threading.RLock()


def need(purpose: str, *names: str) -> list[Any]:
    """Import modules of the extra "gis", or raise ``ImportError`` that says how to get them."""
    modules = []
    for name in names:
        try:
            modules.append(importlib.import_module(name))
        except ImportError as error:
            raise MissingExtraError(f'{purpose} needs {name.split(".")[0]}: pip install "warpriver[gis]"') from error
    return modules
