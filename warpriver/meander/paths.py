"""Meanders by shortest paths, the move: the curvature pushes, and the line is smoothed.

After the study *Meandering river: oxbows from shortest paths* [PathStudy2026]; what follows is in
:mod:`warpriver.meander.shortcuts` and ``routes``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from warpriver.kernels import paths as kernels
from warpriver.meander.buffers import StepChannels
from warpriver.meander.migration import measure_rings
from warpriver.meander.shortcuts import PathBuffers
from warpriver.meander.stages import Share, Stage, launch
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import PathMeander
from warpriver.terrain import Terrain

__all__ = ["path_law", "push", "push_limits", "push_rate"]


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


def path_law(params: PathMeander, dtype: str) -> Any:
    """Pack the scalars of the push for the kernels of that precision."""
    law = kernels.build(PRECISIONS[dtype][0]).PathLaw()
    law.displacement_rate = params.displacement_rate
    law.downstream_share = params.downstream_share
    law.blur_length = params.blur_length
    law.smoothing = params.smoothing
    law.end_damping = params.end_damping
    law.slope_threshold = params.slope_threshold
    return law


def push(
    network: RiverNetwork, channels: StepChannels, buffers: PathBuffers, terrain: Terrain | None, law: Any
) -> list[Stage]:
    """Return the stages that push and smooth every point over ``channels.step``, into ``buffers.point_moved``.

    Args:
        network: The network; its points are evenly spaced along each channel.
        channels: Its channels.
        buffers: Where ``point_push`` and ``point_moved`` are written.
        terrain: Ground whose slope slows the push, on the network's device, or None.
        law: From :func:`path_law`.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    height, grid = None, kernel.RasterGrid()
    if terrain is not None:
        height, grid = terrain.height, terrain.grid(network.dtype, network.origin)
    shape = [network.point_xy, network.point_section, channels.start, channels.form, channels.spacing, channels.step]
    shape += [channels.closed]

    def move(share: Share) -> None:
        launch(
            kernel.compute_push,
            dim=share.point_threads,
            inputs=[*shape, law, share.work],
            outputs=[buffers.point_push],
            device=device,
        )
        launch(
            kernel.shift_points,
            dim=share.point_threads,
            inputs=[*shape, channels.area, height, grid, law, share.work, buffers.point_push],
            outputs=[buffers.point_moved, buffers.section_moved, channels.pace_bits],
            device=device,
        )

    return [*measure_rings(network, channels), Stage("migrate", move)]
