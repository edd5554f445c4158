"""Phase: one process of a step, with all that belongs to it."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from warpriver.engine.stages import Stage
from warpriver.engine.state import Member, State
from warpriver.history.events import Event
from warpriver.kernels.status import DONE, HALT, STATUS_SIZE, STEPS, TOUCH
from warpriver.network import RiverNetwork

__all__ = ["Batch", "Phase"]


class Batch:
    """What a batch of sub-steps came to, as the host sees it afterwards.

    Attributes:
        status: Numbers of ``kernels/polyline.py``.
        edited: Whether a phase before has edited the network on the host.
        steps_after: Steps done in all, those of the batch included.
    """

    __slots__ = ("_steps", "_time_step", "edited", "status", "steps_after")

    def __init__(self, status: list[int], steps: int, time_step: float):
        """Take the status, the steps done before the batch, and the time step in yr."""
        self.status, self.edited, self.steps_after = status, False, steps + status[STEPS]
        self._steps, self._time_step = steps, time_step

    @property
    def halted(self) -> bool:
        """Whether sub-steps were halted behind channels that touch."""
        return bool(self.status[HALT] == TOUCH)

    @property
    def times(self) -> list[float]:
        """Time after each of its sub-steps, yr."""
        steps, times = self._steps, []
        done = self.status[STATUS_SIZE : STATUS_SIZE + 2 * self.status[DONE]]
        for number, total in zip(done[::2], done[1::2], strict=True):
            times.append((steps + (number + 1) / total) * self._time_step)
            steps += number + 1 == total
        return times


class Phase(Member, Protocol):
    """One process of a step.

    It owns the stages that it adds to every sub-step, the device arrays that only it uses, what it does on the host
    after a batch of sub-steps, and its check. Derive from it and write what differs; only ``stages`` has to be written.

    Attributes:
        name: Name of the verb of the step, as in ``Stage.phase``.
        moves_nodes: Whether the ends of channels, and the nodes with them, may move.
        follows_stems: Whether channels that go on from each other at a junction move as one river; they then take the
            same sub-steps.
        follows_through: Whether they do at through nodes, at which nothing joins.
        varies_sections: Whether widths and depths come to vary along channels that had none of their own at each point.
        widening: Greatest factor by which it may widen a channel between edits.
        every_substep: Whether the next sub-step depends on what ``after`` does, so that none is begun before.
    """

    name: str
    moves_nodes: bool = False
    follows_stems: bool = False
    follows_through: bool = False
    varies_sections: bool = False
    widening: float = 1.0
    every_substep: bool = False

    def check_network(self, network: RiverNetwork) -> None:
        """Raise ``ValueError`` for a network that the process cannot deal with."""
        return None

    def allocate(self, state: State) -> None:
        """Make the device arrays for the capacities of the state; called again when these have grown."""

    def install(self, state: State) -> None:
        """Take the channels of the network; called at the start, and after every edit of the network."""
        return None

    def stages(self, state: State) -> list[Stage]:
        """Return what the process launches in a sub-step, in order. It allocates nothing."""
        ...

    def after(self, state: State, batch: Batch) -> list[Event]:
        """Do on the host what a batch calls for, and return its events; ``state.adopt`` may edit the network."""
        return []

    def grow(self, state: State, status: list[int]) -> bool:
        """Enlarge what a sub-step found too small, and tell whether the fault in its status was this phase's."""
        return False

    def check(self, state: State) -> None:
        """Raise :class:`PhaseError` where the stages of a sub-step broke their promise; slow, on the host."""
        return None

    def saved(self, state: State) -> dict[str, np.ndarray]:
        """Return what a record needs so that a run resumed from it goes on to the same bits, by names of its own."""
        return {}

    def restore(self, state: State, saved: dict[str, np.ndarray]) -> None:
        """Take up what ``saved`` returned; called before ``install``, at the start of a run that is resumed."""
        return None
