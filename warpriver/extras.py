"""Optional parts: the modules of an extra, imported where they are used."""

from __future__ import annotations

import importlib
from typing import Any

from warpriver.errors import MissingExtraError

__all__ = ["need"]


def need(purpose: str, *names: str) -> list[Any]:
    """Import modules of the extra "gis", or raise ``ImportError`` that says how to get them."""
    modules = []
    for name in names:
        try:
            modules.append(importlib.import_module(name))
        except ImportError as error:
            raise MissingExtraError(f'{purpose} needs {name.split(".")[0]}: pip install "warpriver[gis]"') from error
    return modules
