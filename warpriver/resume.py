"""Runs that go on: what they need of before is found again, and what is to change is checked and told as an event."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from warpriver.engine.phase import Phase
from warpriver.errors import InputError, WarpriverError
from warpriver.history import Event, Ground, GroundChange, ParameterChange
from warpriver.io.raster.terrains import read_terrain
from warpriver.models import Model, model_of
from warpriver.params import MeanderParams, PathMeander
from warpriver.terrain import Terrain

__all__ = ["continued", "ground_again", "ground_changes", "parameter_changes"]


def ground_again(ground: Ground | None, terrain: Terrain | None, change: bool, device: Any = "cpu") -> Terrain | None:
    """Return the terrain that a run goes on over: the one it had, unless a change is wanted.

    Args:
        ground: The terrain that the run had, None for a plain.
        terrain: The one that is given; None: that of the run, read again from its file.
        change: Take what is given, also if it is not the terrain of the run.
        device: Where a terrain is read to.

    Raises:
        ValueError: The terrain of the run is not given and cannot be found, or another one is given.
    """
    if change:
        return terrain
    if ground is None:
        if terrain is not None:
            raise InputError(
                "the run has no terrain: it lies on a plain; leave terrain= out, or pass change_terrain=True to go on "
                "over this one"
            )
        return None
    if terrain is None:
        return _read_again(ground, device)
    if terrain.digest() != ground.digest:
        raise InputError(
            f"the terrain is not the one that the run has had ({ground.about}{_of_file(ground)}): size, place or "
            "heights differ; give that one, or pass change_terrain=True to go on over this one"
        )
    return terrain


def _read_again(ground: Ground, device: Any) -> Terrain:
    """Read the terrain of a run from the file that it came from."""
    told, advice = f"the run lies on a terrain ({ground.about})", "give the terrain, terrain="
    if ground.path is None:
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
    return terrain


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
