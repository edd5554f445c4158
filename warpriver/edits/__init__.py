"""What an author does to a river between two steps, as values: each is recorded, undone, redone, saved and replayed.

``sim.apply(edit)`` does one of them, ``sim.undo()`` takes it back, ``sim.history.edits`` are all that were done.
:func:`write_edits` and :func:`read_edits` keep a session in a file: what a run began with, its seed and its edits make
the same run again, to the bit, by ``Simulation.replay``.

A channel is named by its identity (``network.channel_id``), a place on it by ``at``: the arc length from the head of
the channel in m, or a point (x, y), which stands for the nearest one of the channel. At a locked point the channels of
the network part, but a river is one all the same: it has one identity, that of its lowest part, and its arc length runs
on.
"""

from warpriver.edits.session import Session, read_edits, write_edits
from warpriver.edits.values import (
    AddChannel,
    AvulseChannel,
    CutLoop,
    DeferJunction,
    DivertChannel,
    Edit,
    EditTerrain,
    JoinChannels,
    LockPoint,
    MovePoint,
    PaintControl,
    RedrawSection,
    RemoveChannel,
    SetChannel,
    SplitChannel,
    UnlockPoint,
)

__all__ = [
    "AddChannel",
    "AvulseChannel",
    "CutLoop",
    "DeferJunction",
    "DivertChannel",
    "Edit",
    "EditTerrain",
    "JoinChannels",
    "LockPoint",
    "MovePoint",
    "PaintControl",
    "RedrawSection",
    "RemoveChannel",
    "Session",
    "SetChannel",
    "SplitChannel",
    "UnlockPoint",
    "read_edits",
    "write_edits",
]
