"""A river under an author's hand: a simulation, the edits done so far, and the way back before any of them."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.edits import Edit, PaintControl, Session, write_edits
from warpriver.errors import InputError
from warpriver.history import Avulsion, Collision, Crevasse, Cutoff, Event, HeldLock, History, Split
from warpriver.meander import Control, ControlField, SetControls
from warpriver.raster import Raster
from warpriver.simulation import Simulation
from warpriver.studio.journal import Entry, digest, session_of
from warpriver.terrain import Terrain
from warpriver.validate import finite, finite_numbers, positive, whole

__all__ = ["EVENTS_KEPT", "Author", "Checkpoint", "brushed"]

# A copy of the run is kept every so many steps; of these, when there are more, every other one is given up.
MARK_STEPS, MARKS = 50, 16
# Cells of the painted control field along the longer side of the map.
FIELD_CELLS = 512
# Events of channels that are kept at least, the latest ones, so that memory does not grow however long a run plays.
# What changes controls, constants or ground is kept always: a run is taken up with it.
EVENTS_KEPT = 3000
CHANNEL_EVENTS = (Cutoff, Collision, Avulsion, Crevasse, Split, HeldLock)
# Rows of two grounds that are compared at a time.
COMPARED_ROWS = 64


@dataclasses.dataclass
class _Mark:
    """The run after so many steps and edits.

    Attributes:
        step: Steps done.
        edits: Edits done.
        state: What the run pickles as. Its events and records are those of the run, which never change, and its ground
            is that of the mark before where it is the same.
        ground: The ground, or None.
        forgotten: Events that the run has forgotten, by kind.
    """

    step: int
    edits: int
    state: dict[str, Any]
    ground: Terrain | None
    forgotten: dict[str, int]

    def simulation(self) -> Simulation:
        """Return the run as it was, to be gone on with."""
        made = Simulation.__new__(Simulation)
        made.__setstate__(copy.deepcopy(self.state, _shared(self.state["history"])))
        return made


class Author:
    """A simulation with its edits, which can be taken back at any time.

    An edit that was done since the last step is taken back as it is. One that lies further back is left out: the run is
    taken up where it stood before, and does its steps again without it. So is one that is done again.

    Edits of one group, as the touches of a stroke, are undone and redone together.

    Attributes:
        simulation: The run as it is now; another object after an edit further back was undone or redone.
        entries: The edits, in order.
        forgotten: Numbers of events, by kind, that the run has had and that its history holds no longer.
        stepped: Called after steps, at least every 50, and after edits, also when these are done again.
        returned: Called before steps are done again, with the step before which the run stays as it was.
    """

    def __init__(self, simulation: Simulation):
        """Take a simulation at its beginning."""
        self.simulation = simulation
        self.entries: list[Entry] = []
        self.stepped: Callable[[], None] | None = None
        self.returned: Callable[[int], None] | None = None
        self.forgotten: dict[str, int] = {}
        self._undone: list[list[Entry]] = []
        self._marks: list[_Mark] = []
        self._marks.append(self._mark())

    # ---- time

    def step(self, count: int = 1) -> list[Event]:
        """Advance by so many steps, and return the events of these."""
        found: list[Event] = []
        left = whole(count, "count", 1)
        while left:
            part = min(left, MARK_STEPS - self.simulation.step_count % MARK_STEPS)
            before = len(self.simulation.history.events)
            self.simulation.step(part)
            found += self.simulation.history.events[before:]
            left -= part
            self._forget()
            self._tell_stepped()
            if self.simulation.step_count % MARK_STEPS == 0:
                self._marks.append(self._mark())
                if len(self._marks) > MARKS:
                    # The first one is the beginning, the last one is now.
                    del self._marks[1:-1:2]
        return found

    def count(self, kind: type[Event]) -> int:
        """Return how many events of a kind the run has had."""
        return len(self.simulation.history.events.of(kind)) + self.forgotten.get(kind.kind, 0)

    @property
    def events(self) -> int:
        """Number of all events that the run has had."""
        return len(self.simulation.history.events) + sum(self.forgotten.values())

    def events_after(self, count: int) -> list[Event]:
        """Return the events after the first ``count``, as far as they are remembered."""
        return list(self.simulation.history.events[max(0, count - sum(self.forgotten.values())) :])

    def _forget(self) -> None:
        """Let the oldest events go, if there are too many."""
        history = self.simulation.history
        if len(history.events) <= 2 * EVENTS_KEPT:
            return
        held = list(history.events)
        old = held[:-EVENTS_KEPT]
        kept = [event for event in old if not isinstance(event, CHANNEL_EVENTS)]
        for event in old:
            if isinstance(event, CHANNEL_EVENTS):
                self.forgotten[event.kind] = self.forgotten.get(event.kind, 0) + 1
        # What the run began with stays in its place: the first record refers to it.
        history.forget_events(0)
        history.events.extend(kept + held[-EVENTS_KEPT:])

    def _tell_stepped(self) -> None:
        if self.stepped is not None:
            self.stepped()

    def rewind(self, step: int) -> int:
        """Go back to the end of a step; edits after it are forgotten. Returns how many these are."""
        step = whole(step, "step")
        if step > self.simulation.step_count:
            raise InputError(f"step is {step}; the run has done {self.simulation.step_count}")
        kept = [each for each in self.entries if each.step <= step]
        lost = len(self.entries) - len(kept)
        self._again(kept, step, len(kept))
        self._undone.clear()
        return lost

    # ---- edits

    @property
    def edits(self) -> list[tuple[int, Edit]]:
        """(step, edit), in order."""
        return [(entry.step, entry.edit) for entry in self.entries]

    @property
    def undoable(self) -> int:
        """Edits that can be taken back."""
        return len(self.entries)

    @property
    def redoable(self) -> int:
        """Edits that can be done again."""
        return len(self._undone)

    def apply(self, edit: Edit, group: str | None = None) -> None:
        """Do an edit.

        Args:
            edit: The edit to apply.
            group: Name of the group to which it belongs.

        Raises:
            ValueError: It cannot be done, and nothing has changed.
        """
        self.simulation.apply(edit)
        self.entries.append(Entry(self.simulation.step_count, edit, group))
        self._undone.clear()

    def undo(self) -> list[Entry]:
        """Take the last edit back, with all of its group, and return them: the river is as if they had not been done.

        Raises:
            ValueError: There is none.
        """
        if not self.entries:
            raise InputError("there is no edit to undo")
        first = len(self.entries) - 1
        group = self.entries[first].group
        while first > 0 and group is not None and self.entries[first - 1].group == group:
            first -= 1
        taken = self.entries[first:]
        if taken[0].step == self.simulation.step_count and self._take_back(len(taken)):
            del self.entries[first:]
            self._tell_stepped()
        else:
            self._again(self.entries[:first], self.simulation.step_count, first)
        self._undone.append(taken)
        return taken

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

    def redo(self) -> list[Entry]:
        """Do again what was undone last, at its own time, and return it.

        Raises:
            ValueError: There is nothing, or it cannot be done any more.
        """
        if not self._undone:
            raise InputError("there is no edit to redo")
        taken = self._undone[-1]
        if taken[0].step == self.simulation.step_count:
            for entry in taken:
                self.simulation.apply(entry.edit)
                self.entries.append(entry)
            self._tell_stepped()
        else:
            self._again([*self.entries, *taken], self.simulation.step_count, len(self.entries))
        self._undone.pop()
        return taken

    def session(self) -> Session:
        """Return the edits as a session, which :meth:`warpriver.Simulation.replay` does again."""
        return session_of(self.entries, self.simulation.seed, self.simulation.step_count)

    def write_session(self, path: Path) -> None:
        """Write the edits to a file."""
        write_edits(path, self.session())

    def take_up(self, entries: list[Entry], seed: int | None, steps: int, checkpoint: Checkpoint | None = None) -> None:
        """Do a session from the beginning.

        Args:
            entries: Its edits.
            seed: Its seed, where it is known.
            steps: Its steps.
            checkpoint: The same session at an earlier time, from which less is to be done; one of another session is
                passed over.

        Raises:
            ValueError: It has another seed, or one of its edits cannot be done.
        """
        if seed is not None and seed != self.simulation.seed:
            raise InputError(f"the session has the seed {seed}, the run {self.simulation.seed}")
        same = 0
        if checkpoint is not None and checkpoint.fits(entries, steps):
            mark = self._marks[0]
            self.simulation = checkpoint.simulation(mark.simulation().terrain)
            same = checkpoint.edits
            self.entries, self.forgotten = list(entries[:same]), dict(checkpoint.forgotten)
            self._marks.append(self._mark())
        self._again(entries, steps, same)
        self._undone.clear()

    def save_checkpoint(self, folder: Path) -> dict[str, Any]:
        """Write the run as it is now to a new folder; returns what :class:`Checkpoint` needs beside it."""
        made = self._mark().simulation()
        made.run(steps=0)  # notes the state that the run stands at
        made.history.save(folder)
        told = {"edits": len(self.entries), "steps": made.step_count, "digest": digest(self.entries)}
        return told | {"forgotten": self.forgotten}

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
        terrain = self.simulation.terrain
        ground = self._marks[-1].ground if self._marks else None
        if terrain is not None and (ground is None or not _same_bits(ground, terrain)):
            ground = copy.deepcopy(terrain)
        state = self.simulation.__getstate__()
        shared = _shared(state["history"])
        if terrain is not None:
            shared[id(terrain)] = ground
        made = copy.deepcopy(state, shared)
        return _Mark(self.simulation.step_count, len(self.entries), made, ground, dict(self.forgotten))

    def _again(self, entries: list[Entry], steps: int, same: int) -> None:
        """Let the run have these edits and steps; the first ``same`` edits are those that it has."""
        first = entries[same].step if same < len(entries) else steps
        usable = [m for m in self._marks if m.step <= first and m.edits <= same]
        mark = usable[-1]
        before = (self.simulation, self.entries, self._marks, self.forgotten)
        self._marks = usable
        self.simulation, self.entries = mark.simulation(), list(entries[: mark.edits])
        self.forgotten = dict(mark.forgotten)
        had = before[1]
        differs = min(first, had[same].step if same < len(had) else before[0].step_count)
        if self.returned is not None:
            self.returned(differs)
        try:
            self._tell_stepped()
            for entry in entries[mark.edits :]:
                if entry.step > self.simulation.step_count:
                    self.step(entry.step - self.simulation.step_count)
                self.simulation.apply(entry.edit)
                self.entries.append(entry)
                self._tell_stepped()
            if steps > self.simulation.step_count:
                self.step(steps - self.simulation.step_count)
        except BaseException:
            self.simulation, self.entries, self._marks, self.forgotten = before
            if self.returned is not None:
                self.returned(differs)
            self._tell_stepped()
            raise


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """A session at one time, from which it is taken up sooner than from its beginning.

    Attributes:
        folder: The run, as :meth:`Author.save_checkpoint` wrote it.
        edits: Edits that it has.
        steps: Steps that it has done.
        digest: Sum of these edits.
        forgotten: Events that it has forgotten, by kind.
    """

    folder: Path
    edits: int
    steps: int
    digest: str
    forgotten: Mapping[str, int] = dataclasses.field(default_factory=dict)

    def fits(self, entries: list[Entry], steps: int) -> bool:
        """Tell whether a session goes on from here."""
        later = entries[self.edits].step if self.edits < len(entries) else steps
        return (
            self.edits <= len(entries)
            and self.steps <= min(later, steps)
            and digest(entries[: self.edits]) == self.digest
        )

    def simulation(self, terrain: Terrain | None) -> Simulation:
        """Return the run, over the ground that it began with."""
        history = History.load(self.folder)
        # No other file may be read in its place.
        if (history.ground is None) != (terrain is None):
            raise InputError("the checkpoint lies on another ground than the session; remove it")
        return Simulation.resume(history, terrain=terrain)


def _shared(history: History) -> dict[int, Any]:
    """Return what copies of a run share: its events and records, which never change."""
    held = [*history.events, *(history.record(k) for k in range(len(history)))]
    return {id(each): each for each in held}


def _same_bits(a: Terrain, b: Terrain) -> bool:
    # A few rows at a time: neither is copied as a whole, and the first difference ends it.
    one, other = (each.raster.values.numpy() for each in (a, b))
    return one.shape == other.shape and all(
        np.array_equal(one[k : k + COMPARED_ROWS].view(np.uint64), other[k : k + COMPARED_ROWS].view(np.uint64))
        for k in range(0, len(one), COMPARED_ROWS)
    )


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
