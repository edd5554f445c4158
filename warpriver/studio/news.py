"""What the process that makes maps has been told of the run."""

from __future__ import annotations

import dataclasses
import math
import struct
from typing import Any

__all__ = ["REQUEST", "News"]

# What stands before a request to that process: the number of the command that waits for it, -1 for none.
REQUEST = struct.Struct("<q")


@dataclasses.dataclass
class News:
    """What the process that makes maps has been told, and what it shall make.

    Attributes:
        epoch: Number of the run that it knows; another one after what it has was taken back.
        events: Events that the run had had when it was told of them.
        known: Those of them that maps take, which are told.
        ground: Where it finds the ground, None where that has changed since.
        map: Map that is shown.
        types: Whether types of channels are shown.
        busy: Maps that it is at.
        asked: When the last one was asked for.
        made: What the last one is of.
    """

    epoch: int = 0
    events: int = 0
    known: int = 0
    ground: dict[str, Any] | None = None
    map: str | None = None
    types: bool = False
    busy: int = 0
    asked: float = -math.inf
    made: tuple[object, ...] = ()

    def begin(self) -> None:
        """Let it begin its maps anew; it keeps the events that it has."""
        self.epoch += 1
        self.ground = None

    def forget(self) -> None:
        """Let it be told all events again: it is another process, or another run."""
        self.begin()
        self.events = self.known = 0

    def take_back(self, events: int, known: int) -> None:
        """Let it forget the events after so many."""
        self.events, self.known = min(self.events, events), min(self.known, known)
