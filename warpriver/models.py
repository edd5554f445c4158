"""Models: the phases of a step, by the kind of parameters that a simulation is given."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from warpriver.engine.phase import Phase
from warpriver.engine.state import StepLimits
from warpriver.errors import InputError
from warpriver.meander.avulsions import Avulse
from warpriver.meander.collisions import Collide
from warpriver.meander.cutoffs import CutOff
from warpriver.meander.floodplain import Floodplain
from warpriver.meander.junctions import MoveJunctions
from warpriver.meander.migration import Migrate, rate_of, step_limits
from warpriver.meander.resampling import Resample
from warpriver.meander.smoothing import Smooth
from warpriver.meander.widths import Widen
from warpriver.params import MeanderParams, PathMeander
from warpriver.shortest_path.push import Push, push_limits, push_rate
from warpriver.shortest_path.route import TakeShortcuts

__all__ = ["Model", "model_of"]


@dataclasses.dataclass(frozen=True)
class Model:
    """What a step does, in order.

    Attributes:
        phases: Phases in order. The first moves the points; those up to the one that resamples work on the points on
            their way, and those after it on the network.
        limits: (width, depth, params) -> the two limits of a sub-step, yr; see ``migration.step_limits``.
    """

    phases: tuple[Phase, ...]
    limits: StepLimits

    def with_phases(self, added: tuple[Phase, ...]) -> Model:
        """Return the model with further phases, which work on the points right after they have moved."""
        return dataclasses.replace(self, phases=(self.phases[0], *added, *self.phases[1:]))


def _migration(params: MeanderParams) -> Model:
    follows = "stems" if params.upstream_memory == "stem" else "through nodes"
    cut_off = CutOff(chutes=params.chutes is not None)
    remembering: list[Phase] = [Floodplain(cut_off.loops)] if params.floodplain is not None else []
    widening: list[Phase] = [Widen(params.widths)] if params.widths is not None and params.widths.lag > 0.0 else []
    phases: list[Phase] = [Migrate(), *remembering, *widening, *_shaping(params, rate_of, follows)]
    if params.cutoff_distance > 0.0:
        phases.append(cut_off)
    return Model((*phases, Resample(), *_joining(params)), step_limits)


def _shortest_paths(params: PathMeander) -> Model:
    resample = Resample()
    phases = [Push(), *_shaping(params, push_rate, "nothing"), TakeShortcuts(params, resample.arcs)]
    return Model((*phases, resample, *_joining(params)), push_limits)


def _shaping(params: Any, rate: Callable[..., Any], follows: str) -> list[Phase]:
    drifts = params.junction_drift > 0.0
    junctions: list[Phase] = []
    if follows != "nothing" or drifts or params.junctions is not None:
        junctions.append(MoveJunctions(rate, follows=follows, drifts=drifts, shape=params.junctions))
    return [*([Smooth()] if params.taubin_passes > 0 else []), *junctions]


def _joining(params: Any) -> list[Phase]:
    leaving: list[Phase] = [Avulse()] if params.avulsions is not None else []
    # Through nodes are none to the river, whose necks across them are found even where channels do not join.
    joins, necks = params.collision_distance > 0.0, getattr(params, "cutoff_distance", 1.0)
    return [*leaving, *([Collide(joins=joins, necks=necks)] if joins or necks > 0.0 else [])]


# A new kind of parameters is a new model here, and nowhere else.
MODELS: dict[type, Callable[[Any], Model]] = {MeanderParams: _migration, PathMeander: _shortest_paths}


def model_of(params: Any) -> Model:
    """Return the model that parameters of this kind ask for.

    Raises:
        ValueError: They are of no kind that a simulation knows.
    """
    try:
        make = MODELS[type(params)]
    except KeyError:
        kinds = " or ".join(kind.__name__ for kind in MODELS)
        raise InputError(f"params is a {type(params).__name__}; give {kinds}") from None
    return make(params)
