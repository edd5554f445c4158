"""The solvers of :class:`warpriver.Simulation`: what moves the points and cuts the loops, by the kind of parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from warpriver.meander.buffers import StepBuffers
from warpriver.meander.cutoffs import cut_off
from warpriver.meander.migration import migrate, migration_law, stable_dt
from warpriver.meander.paths import PathBuffers, check_radius, path_law, push, stable_push_dt, take_shortcuts
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams, PathMeander

__all__ = ["Solver", "solver_of"]


@dataclasses.dataclass(frozen=True)
class Solver:
    """What a step does with the channels between resampling and resampling.

    Attributes:
        stable_dt: (width, depth, params) -> longest (sub-)step, yr.
        law: (params, time_step, dtype) -> scalars of a (sub-)step for the kernels.
        buffers: (network, point_capacity, cut_capacity, oxbow_capacity) -> scratch.
        move: (network, form, spacing, terrain, law, buffers): moves the points.
        cut: (network, form, spacing, params, buffers): cuts loops off.
        check: (network, params): raises ``ValueError`` for what the solver cannot do.
        closes_loops: Oxbow lakes are kept as closed lines, the first point repeated.
    """

    stable_dt: Callable[[Any, Any, Any], Any]
    law: Callable[[Any, float, str], Any]
    buffers: Callable[[RiverNetwork, int, int, int], StepBuffers]
    move: Callable[..., None]
    cut: Callable[..., None]
    check: Callable[[RiverNetwork, Any], None]
    closes_loops: bool

    def oxbow(self, loop: np.ndarray) -> np.ndarray:
        """Return a bypassed arc (n, 2) as the solver keeps it."""
        return np.concatenate([loop, loop[:1]]) if self.closes_loops else loop.copy()


SOLVERS: dict[type, Solver] = {
    MeanderParams: Solver(stable_dt, migration_law, StepBuffers, migrate, cut_off, lambda network, params: None, False),
    PathMeander: Solver(stable_push_dt, path_law, PathBuffers, push, take_shortcuts, check_radius, True),
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
