"""The states of a run, kept on disk: the timeline, maps and movies take them from there, so that memory stays bounded.

Each is the frame that pages are sent, in a file of its own named by its step. When there are too many, every other one
is removed, and from then on states are kept half as often.
"""

from __future__ import annotations

import shutil
from pathlib import Path

__all__ = ["REEL", "Reel", "state_file"]

# Its folder in that of a session.
REEL = "reel"
# States that are kept at most, and their bytes; states that the timeline shows.
STATES, BYTES, SHOWN = 4000, 2**30, 240


class Reel:
    """States of a run, by step.

    Attributes:
        folder: Where their files are.
        every: Steps from one to the next.
    """

    def __init__(self, folder: Path):
        """Begin an empty one; what the folder held is removed."""
        self.folder = folder
        self.every = 1
        self._held: list[tuple[int, float, int]] = []  # step, time, bytes
        self._bytes = 0
        self._shown: list[tuple[int, float]] | None = None
        self.clear()

    def __len__(self) -> int:
        return len(self._held)

    @property
    def steps(self) -> list[int]:
        """Steps of all states."""
        return [step for step, _, _ in self._held]

    @property
    def states(self) -> list[tuple[int, float]]:
        """Step and time of all states."""
        return [(step, time) for step, time, _ in self._held]

    @property
    def last(self) -> int:
        """Step of the last state, -1 before the first."""
        return self._held[-1][0] if self._held else -1

    def clear(self) -> None:
        """Remove all states."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        self._held.clear()
        self._bytes, self.every, self._shown = 0, 1, None

    def wants(self, step: int) -> bool:
        """Tell whether the state after so many steps is to be kept."""
        return step > self.last and step % self.every == 0

    def keep(self, step: int, time: float, frame: bytes) -> None:
        """Keep a state, in place of one of the same step."""
        self.rewind(step - 1)
        state_file(self.folder, step).write_bytes(frame)
        self._held.append((step, time, len(frame)))
        self._bytes += len(frame)
        self._shown = None
        while len(self._held) > STATES or self._bytes > BYTES:
            if len(self._held) < 3:
                break
            self.every *= 2
            self._leave([each for each in self._held if each[0] % self.every == 0])

    def rewind(self, step: int) -> None:
        """Forget what came after a step."""
        if self.last > step:
            self._leave([each for each in self._held if each[0] <= step])

    def shown(self) -> list[tuple[int, float]]:
        """Return step and time of the states of the timeline, evenly spread over all."""
        if self._shown is None:
            stride = -(-len(self._held) // SHOWN) if self._held else 1
            self._shown = [(step, time) for step, time, _ in self._held[::stride]]
        return self._shown

    def frame(self, step: int) -> bytes:
        """Return the state after so many steps."""
        return state_file(self.folder, step).read_bytes()

    def _leave(self, kept: list[tuple[int, float, int]]) -> None:
        for step in {each[0] for each in self._held} - {each[0] for each in kept}:
            state_file(self.folder, step).unlink(missing_ok=True)
        self._held, self._shown = kept, None
        self._bytes = sum(each[2] for each in kept)


def state_file(folder: Path, step: int) -> Path:
    """Return the file of the state after so many steps."""
    return folder / f"{step:010d}"
