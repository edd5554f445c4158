"""warpriver: a GPU compute engine for rivers.

A network of channels is read or made, a simulation lets it migrate and cut off its bends, and a history keeps what
happened. Start at :class:`RiverNetwork`, :class:`Simulation` and :class:`History`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warpriver import generate, metrics, viz
    from warpriver.history import Cutoff, History, StopReason
    from warpriver.io.lines import read_network, write_network
    from warpriver.network import RiverNetwork
    from warpriver.params import MeanderParams
    from warpriver.simulation import Every, Simulation

__all__ = [
    "Cutoff",
    "Every",
    "History",
    "MeanderParams",
    "RiverNetwork",
    "Simulation",
    "StopReason",
    "generate",
    "metrics",
    "read_network",
    "viz",
    "write_network",
]

__version__ = "0.1.0"

# Each name is imported when it is first used, so that `warpriver --help` does not wait for Warp.
_HOMES = {
    "Cutoff": "warpriver.history",
    "Every": "warpriver.simulation",
    "History": "warpriver.history",
    "MeanderParams": "warpriver.params",
    "RiverNetwork": "warpriver.network",
    "Simulation": "warpriver.simulation",
    "StopReason": "warpriver.history",
    "read_network": "warpriver.io.lines",
    "write_network": "warpriver.io.lines",
}
_ROOMS = ("generate", "metrics", "viz")


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"warpriver.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'warpriver' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
