"""Meanders by shortest paths, the move: the curvature pushes, and the line is smoothed.

After the study *Meandering river: oxbows from shortest paths* [PathStudy2026]; what follows is in
:mod:`warpriver.shortest_path.shortcuts` and ``route``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from warpriver.arrays import DeviceArray
from warpriver.device import PRECISIONS
from warpriver.engine.phase import Phase
from warpriver.engine.stages import Share, Stage, launch
from warpriver.engine.state import State
from warpriver.kernels import paths as kernels
from warpriver.meander.migration import measure_rings
from warpriver.params import PathMeander

__all__ = ["Push", "path_constants", "push_limits", "push_rate"]


def push_limits(width: Any, depth: Any, params: PathMeander) -> tuple[Any, Any]:
    """Longest time steps in yr that follow a channel truly, (travel, growth); longer ones are done in equal parts.

    - a bend as tight as its width moves by at most its width, dt <= w / k; where no bend is as tight, it is enough that
      the fastest point moves by less than half a width;
    - the shortest waves grow by k / (b^2 w) a year (b the blur length in widths), at most by half in a step.

    The smoothing is implicit and sets no limit.

    Args:
        width: Channel width in m, a number or an array.
        depth: Not used; here so that both solvers are asked alike.
        params: Constants.

    Returns:
        Two time steps in yr, float64, of the shape of ``width``; infinite where nothing moves.
    """
    width = np.asarray(width, np.float64)
    with np.errstate(divide="ignore"):
        travel = width / np.float64(params.displacement_rate)
    return travel, 0.5 * params.blur_length**2 * travel


def push_rate(width: np.ndarray, params: PathMeander) -> np.ndarray:
    """Return the rate k of channels of those widths in m, m/yr."""
    return np.full(width.shape, params.displacement_rate)


def path_constants(params: PathMeander, dtype: str) -> Any:
    """Pack the constants of the push for the kernels of that precision."""
    constants = kernels.build(PRECISIONS[dtype][0]).PathConstants()
    constants.displacement_rate = params.displacement_rate
    constants.downstream_share = params.downstream_share
    constants.blur_length = params.blur_length
    constants.smoothing = params.smoothing
    constants.end_damping = params.end_damping
    constants.slope_threshold = params.slope_threshold
    return constants


class Push(Phase):
    """Pushes and smooths every point over ``state.step``, into ``state.point_moved``.

    Attributes:
        point_push: (P,) vec4, push and smoothing of each point, half blurred, m.
    """

    name = "migrate"
    point_push: DeviceArray

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        self.point_push = state.zeros(state.point_capacity, kernels.build(state.scalar).vec4)

    def stages(self, state: State) -> list[Stage]:
        """Return the stages: areas of rings, the push, the move."""
        kernel, constants = kernels.build(state.scalar), path_constants(state.params, state.network.dtype)
        channels, points, ground, moved = state.channels(), state.points(), state.ground(), state.moved()

        def move(share: Share) -> None:
            launch(
                kernel.compute_push,
                dim=share.point_threads,
                inputs=[channels, points, constants, share.work],
                outputs=[self.point_push],
                device=state.device,
            )
            launch(
                kernel.shift_points,
                dim=share.point_threads,
                inputs=[channels, points, ground, constants, share.work, self.point_push],
                outputs=[moved, state.max_speed_bits],
                device=state.device,
            )

        return [*measure_rings(state), Stage("migrate", move)]

    def check(self, state: State) -> None:
        """Points are finite, and the ends of channels have not moved."""
        state.check_moved(self.name, anchored=True)
