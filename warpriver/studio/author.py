"""A river under an author's hand: a simulation, the edits done so far, and the way back before any of them."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from warpriver.edits import Edit, PaintControl, Session, write_edits
from warpriver.errors import InputError
from warpriver.history import Event
from warpriver.meander import Control, ControlField, SetControls
from warpriver.raster import Raster
from warpriver.simulation import Simulation
from warpriver.validate import finite, finite_numbers, positive, whole

__all__ = ["Author", "brushed"]

# A copy of the run is kept every so many steps; of these, when there are more, every other one is given up.
MARK_STEPS, MARKS = 50, 16
# Cells of the painted control field along the longer side of the map.
FIELD_CELLS = 512


@dataclasses.dataclass
class _Mark:
    """The run after so many steps and edits."""

    step: int
    edits: int
    simulation: Simulation


class Author:
    """A simulation with its edits, which can be taken back at any time.

    An edit that was done since the last step is taken back as it is. One that lies further back is left out: the run is
    taken up where it stood before, and does its steps again without it. So is one that is done again.

    Edits of one group, as the touches of a stroke, are undone and redone together.

    Attributes:
        simulation: The run as it is now; another object after an edit further back was undone or redone.
        edits: (step, edit), in order.
    """

    def __init__(self, simulation: Simulation):
        """Take a simulation at its beginning."""
        self.simulation = simulation
        self.edits: list[tuple[int, Edit]] = []
        self._groups: list[str | None] = []
        self._undone: list[list[tuple[int, Edit]]] = []
        self._marks = [self._mark()]

    # ---- time

    def step(self, count: int = 1) -> list[Event]:
        """Advance by so many steps, and return the events of these."""
        before = len(self.simulation.history.events)
        left = whole(count, "count", 1)
        while left:
            part = min(left, MARK_STEPS - self.simulation.step_count % MARK_STEPS)
            self.simulation.step(part)
            left -= part
            if self.simulation.step_count % MARK_STEPS == 0:
                self._marks.append(self._mark())
                if len(self._marks) > MARKS:
                    # The first one is the beginning, the last one is now.
                    del self._marks[1:-1:2]
        return list(self.simulation.history.events[before:])

    def rewind(self, step: int) -> int:
        """Go back to the end of a step; edits after it are forgotten. Returns how many these are."""
        step = whole(step, "step")
        if step > self.simulation.step_count:
            raise InputError(f"step is {step}; the run has done {self.simulation.step_count}")
        kept = [each for each in self.edits if each[0] <= step]
        lost = len(self.edits) - len(kept)
        self._again(kept, step, len(kept))
        del self._groups[len(kept) :]
        self._undone.clear()
        return lost

    # ---- edits

    @property
    def undoable(self) -> int:
        """Edits that can be taken back."""
        return len(self.edits)

    @property
    def redoable(self) -> int:
        """Edits that can be done again."""
        return len(self._undone)

    def apply(self, edit: Edit, group: str | None = None) -> None:
        """Do an edit.

        Args:
            edit: It.
            group: Name of the group to which it belongs.

        Raises:
            ValueError: It cannot be done, and nothing has changed.
        """
        self.simulation.apply(edit)
        self.edits.append((self.simulation.step_count, edit))
        self._groups.append(group)
        self._undone.clear()

    def undo(self) -> list[Edit]:
        """Take the last edit back, with all of its group, and return them: the river is as if they had not been done.

        Raises:
            ValueError: There is none.
        """
        if not self.edits:
            raise InputError("there is no edit to undo")
        first = len(self.edits) - 1
        while first > 0 and self._groups[-1] is not None and self._groups[first - 1] == self._groups[-1]:
            first -= 1
        taken = self.edits[first:]
        if taken[0][0] == self.simulation.step_count and self._take_back(len(taken)):
            del self.edits[first:]
        else:
            self._again(self.edits[:first], self.simulation.step_count, first)
        del self._groups[first:]
        self._undone.append(taken)
        return [edit for _, edit in taken]

    def _take_back(self, count: int) -> bool:
        """Take the last edits back as they are; tell whether nothing has happened since, so that this can be."""
        for done in range(count):
            try:
                self.simulation.undo()
            except InputError:
                if done:
                    raise
                return False
        return True

    def redo(self) -> list[Edit]:
        """Do again what was undone last, at its own time, and return it.

        Raises:
            ValueError: There is nothing, or it cannot be done any more.
        """
        if not self._undone:
            raise InputError("there is no edit to redo")
        taken = self._undone[-1]
        same = len(self.edits)
        if taken[0][0] == self.simulation.step_count:
            for step, edit in taken:
                self.simulation.apply(edit)
                self.edits.append((step, edit))
        else:
            self._again([*self.edits, *taken], self.simulation.step_count, same)
        self._groups += [None if len(taken) == 1 else f"redone {same}"] * len(taken)
        self._undone.pop()
        return [edit for _, edit in taken]

    def session(self) -> Session:
        """Return the edits as a session, which :meth:`warpriver.Simulation.replay` does again."""
        return Session(tuple(self.edits), self.simulation.seed, self.simulation.step_count)

    def write_session(self, path: Path) -> None:
        """Write the edits to a file."""
        write_edits(path, self.session())

    def take_up(self, session: Session) -> None:
        """Do a session from the beginning.

        Raises:
            ValueError: It has another seed, or one of its edits cannot be done.
        """
        if session.seed != self.simulation.seed:
            raise InputError(f"the session has the seed {session.seed}, the run {self.simulation.seed}")
        self._again(list(session.edits), session.steps, 0)
        self._groups = [None] * len(self.edits)
        self._undone.clear()

    # ---- what needs more than one edit, or the state of the run

    def paint(self, center: Sequence[float], radius: float, amount: float, group: str | None = None) -> list[Edit]:
        """Paint a round stroke on the control field and return the edits that this took.

        Args:
            center: (x, y), m.
            radius: m.
            amount: What is added to c at the centre, m: above 0 it draws channels there, below 0 it drives them away.
            group: Name of the group to which the stroke belongs.

        Raises:
            ValueError: The stroke misses the map, or an argument is none.
        """
        x, y = finite_numbers(center, 2, "center")
        radius, amount = positive(radius, "radius", "m"), finite(amount, "amount", "m")
        done: list[Edit] = []
        place = next((k for k, each in enumerate(self.simulation.controls) if isinstance(each, ControlField)), None)
        field = self._blank() if place is None else self.simulation.controls[place]
        assert isinstance(field, ControlField)
        window = field.raster.window(x - radius, y - radius, x + radius, y + radius)
        if window is None:
            raise InputError(f"the stroke at ({x:g}, {y:g}) misses the field; paint on the map, with a larger radius")
        if place is None:
            place = len(self.simulation.controls)
            done.append(SetControls((*self.simulation.controls, field)))
            self.apply(done[0], group)
        values = brushed(field.raster, window, (x, y), radius, amount)
        done.append(PaintControl(place, window, tuple(values.ravel().tolist())))
        self.apply(done[-1], group)
        return done

    def set_controls(self, controls: Sequence[Control]) -> Edit:
        """Let other controls steer the channels; the painted field stays as it is."""
        fields = [each for each in self.simulation.controls if isinstance(each, ControlField)]
        edit = SetControls((*fields, *controls))
        self.apply(edit)
        return edit

    def _blank(self) -> ControlField:
        """Return a field on which nothing is painted, over the terrain, or over the rivers and a tenth around them."""
        network, terrain = self.simulation.network, self.simulation.terrain
        west, south, east, north = network.bounds() if terrain is None else terrain.bounds
        margin = 0.1 * max(east - west, north - south) if terrain is None else 0.0
        bounds = (west - margin, south - margin, east + margin, north + margin)
        cell = max(bounds[2] - bounds[0], bounds[3] - bounds[1]) / FIELD_CELLS
        return ControlField.blank(bounds, cell, crs=network.crs)

    # ---- inside

    def _mark(self) -> _Mark:
        return _Mark(self.simulation.step_count, len(self.edits), copy.deepcopy(self.simulation))

    def _again(self, edits: list[tuple[int, Edit]], steps: int, same: int) -> None:
        """Let the run have these edits and steps; the first ``same`` edits are those that it has."""
        first = edits[same][0] if same < len(edits) else steps
        usable = [m for m in self._marks if m.step <= first and m.edits <= same]
        mark = usable[-1]
        before = (self.simulation, self.edits, self._marks)
        self._marks = usable
        self.simulation, self.edits = copy.deepcopy(mark.simulation), list(edits[: mark.edits])
        try:
            for step, edit in edits[mark.edits :]:
                if step > self.simulation.step_count:
                    self.step(step - self.simulation.step_count)
                self.simulation.apply(edit)
                self.edits.append((step, edit))
            if steps > self.simulation.step_count:
                self.step(steps - self.simulation.step_count)
        except BaseException:
            self.simulation, self.edits, self._marks = before
            raise


def brushed(
    raster: Raster, window: Sequence[int], center: tuple[float, float], radius: float, amount: float
) -> np.ndarray:
    """Values of a window of a raster after a round stroke: ``amount`` (1 - (r / radius)^2)^3 is added.

    Args:
        raster: The raster.
        window: First row, first column, rows, columns.
        center: (x, y) of the stroke, m.
        radius: m.
        amount: What is added at the centre.
    """
    row, column, rows, columns = (int(v) for v in window)
    x = raster.origin[0] + (column + 0.5 + np.arange(columns)) * raster.cell_size
    y = raster.origin[1] - (row + 0.5 + np.arange(rows)) * raster.cell_size
    away = ((x[None, :] - center[0]) ** 2 + (y[:, None] - center[1]) ** 2) / (radius * radius)
    return raster.cells((row, column, rows, columns)) + amount * np.clip(1.0 - away, 0.0, None) ** 3
