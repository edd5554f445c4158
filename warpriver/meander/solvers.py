"""The solvers of :class:`warpriver.Simulation`: what moves the points and cuts the loops, by the kind of parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from warpriver.meander.buffers import StepBuffers
from warpriver.meander.cutoffs import cut_off
from warpriver.meander.migration import migrate, migration_law, rate_of, step_limits
from warpriver.meander.paths import path_law, push, push_limits, push_rate
from warpriver.meander.routes import take_shortcuts
from warpriver.meander.shortcuts import PathBuffers, check_radius
from warpriver.meander.stages import Stage
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams, PathMeander

__all__ = ["Solver", "solver_of"]


@dataclasses.dataclass(frozen=True)
class Solver:
    """What a step does with the channels between resampling and resampling.

    Attributes:
        limits: (width, depth, params) -> the two limits of a sub-step, yr; see ``StepChannels.limit``.
        rate: (width, params) -> the rate k of channels, m/yr.
        law: (params, dtype) -> scalars for the kernels that move the points.
        buffers: (network, point_capacity, cut_capacity, oxbow_capacity) -> scratch.
        move: (network, channels, buffers, terrain, law) -> stages that move the points over ``channels.step``.
        cut: (network, channels, buffers, params) -> stages that cut loops off.
        check: (network, params): raises ``ValueError`` for what the solver cannot do.
        closes_loops: Oxbow lakes are kept as closed lines, the first point repeated.
    """

    limits: Callable[[Any, Any, Any], tuple[Any, Any]]
    rate: Callable[[np.ndarray, Any], np.ndarray]
    law: Callable[[Any, str], Any]
    buffers: Callable[[RiverNetwork, int, int, int], StepBuffers]
    move: Callable[..., list[Stage]]
    cut: Callable[..., list[Stage]]
    check: Callable[[RiverNetwork, Any], None] = lambda network, params: None
    closes_loops: bool = False

    def oxbow(self, loop: np.ndarray) -> np.ndarray:
        """Return a bypassed arc (n, 2) as the solver keeps it."""
        return np.concatenate([loop, loop[:1]]) if self.closes_loops else loop.copy()


SOLVERS: dict[type, Solver] = {
    MeanderParams: Solver(step_limits, rate_of, migration_law, StepBuffers, migrate, cut_off),
    PathMeander: Solver(
        push_limits, push_rate, path_law, PathBuffers, push, take_shortcuts, check_radius, closes_loops=True
    ),
}


def solver_of(params: Any) -> Solver:
    """Return the solver that parameters of this kind ask for.

    Raises:
        ValueError: They are of no kind that a simulation knows.
    """
    try:
        return SOLVERS[type(params)]
    except KeyError:
        kinds = " or ".join(kind.__name__ for kind in SOLVERS)
        raise ValueError(f"params is a {type(params).__name__}; give {kinds}") from None
