"""History: the networks, events and times that a run records; kept in memory or streamed to a folder."""

from warpriver.history.changes import (
    AppliedEdit,
    ControlChange,
    ControlStroke,
    Ground,
    GroundChange,
    ParameterChange,
)
from warpriver.history.events import Avulsion, Collision, Crevasse, Cutoff, Event, EventLog, HeldLock, Split
from warpriver.history.history import History, StopReason, read_history
from warpriver.history.record import Record
from warpriver.history.schedule import Every

__all__ = [
    "AppliedEdit",
    "Avulsion",
    "Collision",
    "ControlChange",
    "ControlStroke",
    "Crevasse",
    "Cutoff",
    "Event",
    "EventLog",
    "Every",
    "Ground",
    "GroundChange",
    "HeldLock",
    "History",
    "ParameterChange",
    "Record",
    "Split",
    "StopReason",
    "read_history",
]

# A segment is written when it holds this much or when the last one is this old; until then the journal has its records.
SEGMENT_BYTES = 16 * 2**20
SEGMENT_SECONDS = 5.0
