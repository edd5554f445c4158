"""Runs that go on: what they need of before is found again, and what is to change is checked and told as an event."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable
from typing import Any

from warpriver.edits.ground import edit_terrain
from warpriver.edits.values import Edit, EditTerrain
from warpriver.engine.phase import Phase
from warpriver.errors import InputError, WarpriverError
from warpriver.history import (
    AppliedEdit,
    Avulsion,
    ControlStroke,
    Event,
    Ground,
    GroundChange,
    History,
    ParameterChange,
    Record,
)
from warpriver.history.events import events_of
from warpriver.io.raster.terrains import read_terrain
from warpriver.meander.courses import carve_course
from warpriver.models import Model, model_of
from warpriver.params import MeanderParams, PathMeander
from warpriver.terrain import Terrain

__all__ = ["continued", "edits_after", "ground_again", "ground_changes", "parameter_changes"]

# A ground, and what was done on it.
Stage = tuple[Ground | None, list[EditTerrain | Avulsion]]


def ground_again(
    start: Ground | None, events: Iterable[Event], terrain: Terrain | None, change: bool, device: Any = "cpu"
) -> Terrain | None:
    """Return the terrain that a run goes on over: the one it had, unless a change is wanted.

    Args:
        start: The terrain that the run began on, None for a plain.
        events: What happened up to where it goes on; edits of the ground among them, and what avulsions carved, are
            done again where the terrain is one that it had before them.
        terrain: The one that is given, which stays as it is where edits are done again; None: that of the run, read
            again from its file.
        change: Take what is given, also if it is not the terrain of the run.
        device: Where a terrain is read to, and edits of it are done again.

    Raises:
        ValueError: The terrain of the run is not given and cannot be found, or another one is given.
    """
    if change:
        return terrain
    stages = _stages(start, events)
    ground = stages[-1][0]
    if ground is None:
        if terrain is not None:
            raise InputError(
                "the run has no terrain: it lies on a plain; leave terrain= out, or pass change_terrain=True to go on "
                "over this one"
            )
        return None
    if terrain is None:
        return _read_again(stages, device)
    again = _edited_again(stages, terrain, device)
    if again is None:
        raise InputError(
            f"the terrain is not the one that the run has had ({ground.about}{_of_file(ground)}): size, place or "
            "heights differ; give that one, or pass change_terrain=True to go on over this one"
        )
    return again


def _stages(start: Ground | None, events: Iterable[Event]) -> list[Stage]:
    """The grounds of a run in order, each with what was done on it until the next one was noted."""
    stages: list[Stage] = [(start, [])]
    for event in events_of(events, GroundChange, AppliedEdit, Avulsion):
        if isinstance(event, GroundChange):
            stages.append((event.ground, []))
        elif isinstance(event, AppliedEdit) and isinstance(edit := event.edit, EditTerrain):
            stages[-1][1].append(edit)
        elif isinstance(event, Avulsion) and len(event.bed):
            stages[-1][1].append(event)
    return stages


def _edited_again(stages: list[Stage], terrain: Terrain, device: Any) -> Terrain | None:
    """A terrain as it was at the end, from what it was at any stage; None where it cannot be made of this one."""
    digest, end = terrain.digest(), stages[-1][0]
    assert end is not None
    for k in reversed(range(len(stages))):
        ground = stages[k][0]
        if ground is None or ground.digest != digest:
            continue
        edits = [edit for _, each in stages[k:] for edit in each]
        if not edits:
            return terrain if ground.digest == end.digest else None
        # On the device of the run: another one rounds otherwise.
        again = terrain.copy().to(device)
        for edit in edits:
            if isinstance(edit, Avulsion):
                carve_course(again, edit.course, edit.bed, edit.width)
            else:
                edit_terrain(again, edit)
        again.file = None
        # After the last change that was noted there is none to compare with.
        return again if stages[-1][1] or again.digest() == end.digest else None
    return None


def _read_again(stages: list[Stage], device: Any) -> Terrain:
    """Read the terrain of a run from the file that it came from, and do the edits of it again."""
    end = stages[-1][0]
    assert end is not None
    told, advice = f"the run lies on a terrain ({end.about})", "give the terrain, terrain="
    ground = next((ground for ground, _ in reversed(stages) if ground is not None and ground.path is not None), None)
    unedited = ground is not None and ground.path == end.path
    if ground is None or ground.path is None or not (unedited or any(edits for _, edits in stages)):
        raise InputError(
            f"{told} that comes from no file, or was edited during the run; {advice}, or pass change_terrain=True to "
            "go on over a plain"
        )
    try:
        terrain = read_terrain(ground.path, **ground.options, device=device)
    except (WarpriverError, TypeError) as error:
        raise InputError(f"{told} from {ground.path}, which cannot be read ({error}); {advice}") from error
    if terrain.digest() != ground.digest:
        raise InputError(f"{told} from {ground.path}, which has changed since; {advice} as it was then")
    again = _edited_again(stages, terrain, device)
    if again is None:
        raise InputError(
            f"{told} that was edited by other means than edits of the run, so that {ground.path} is not it any more; "
            f"{advice}, or pass change_terrain=True to go on over a plain"
        )
    return again


def edits_after(history: History, record: Record) -> list[Edit]:
    """Return the edits that were done after a record, before the next step."""
    return [
        event.edit
        for event in history.events[record.events_before :].of(AppliedEdit, ControlStroke)
        if isinstance(event, (AppliedEdit, ControlStroke)) and event.step == record.step
    ]


def _of_file(ground: Ground) -> str:
    return f", {ground.path}" if ground.path else ""


def ground_changes(time: float, before: Ground | None, now: Ground | None) -> list[Event]:
    """Return the event of a change of the ground, if there was one."""
    same = (before and before.digest) == (now and now.digest)
    return [] if same else [GroundChange.to(time, now)]


def continued(
    before: MeanderParams | PathMeander, given: MeanderParams | PathMeander | None
) -> MeanderParams | PathMeander:
    """Return the constants to go on with: those given, whose defaults that follow from the network are the run's."""
    if given is None:
        return before
    if isinstance(given, MeanderParams) and isinstance(before, MeanderParams) and given.reference_width is None:
        return given.replace(reference_width=before.reference_width)
    return given


def parameter_changes(
    time: float, before: MeanderParams | PathMeander, now: MeanderParams | PathMeander
) -> list[Event]:
    """Return an event for each constant that is to change.

    Args:
        time: When, yr.
        before: Constants until then.
        now: Constants from then on.

    Raises:
        ValueError: A change that a run cannot make.
    """
    if type(before) is not type(now):
        raise InputError(
            f"the run goes by {type(before).__name__} and cannot go on by {type(now).__name__}; start a new one from "
            "its last network"
        )
    if before.time_step != now.time_step:
        raise InputError(
            f"time_step is {now.time_step:g} yr, that of the run {before.time_step:g} yr: its times are whole steps; "
            "leave it as it is, or start a new run from its last network"
        )
    lost = _kept_by(model_of(before)) ^ _kept_by(model_of(now))
    if lost:
        raise InputError(
            f"these constants add or remove {', '.join(sorted(lost))}, of which the records of the run hold more than "
            "the network; start a new run from its last network"
        )
    old, new = dataclasses.asdict(before), dataclasses.asdict(now)
    return [
        ParameterChange(time, name, json.dumps(old[name]), json.dumps(new[name]))
        for name in old
        if old[name] != new[name]
    ]


def _kept_by(model: Model) -> set[str]:
    """Names of the phases that keep arrays of their own in records."""
    return {phase.name for phase in model.phases if type(phase).saved is not Phase.saved}
