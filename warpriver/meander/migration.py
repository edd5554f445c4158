"""Migration: how fast each point of a channel moves sideways, and the move itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels import migration as kernels
from warpriver.meander.buffers import StepBuffers
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import MeanderParams
from warpriver.terrain import Terrain

__all__ = ["explicit_dt", "migrate", "migration_law", "stable_dt"]


def stable_dt(width: Any, depth: Any, params: MeanderParams) -> Any:
    """Longest time step in yr that follows a channel truly; longer ones are done in equal sub-steps.

    Two limits, each measured in the tests against what a step really does:

    - the upstream term is explicit: a wave that it carries downstream must not outgrow the local term's diffusion,
      dt <= 1 / (D gamma^2 alpha^2), half the bound of an explicit step (D = k w |omega|, alpha = 2 f / d);
    - a bend as tight as its width must move by less than its width: dt <= w / (k max(|omega|, gamma - |omega|)).

    The diffusion of the local term sets no limit: what of it would be unstable is treated implicitly. Small waves stay
    true up to 12 times this step and more; tight bends begin to cross themselves at twice it.

    Args:
        width: Channel width in m, a number or an array.
        depth: Channel depth in m, alike.
        params: Migration constants.

    Returns:
        Time step in yr, float64, of the arguments' shape; infinite where nothing moves.
    """
    width, depth = np.asarray(width, np.float64), np.asarray(depth, np.float64)
    weights = max(-params.local_weight, params.local_weight + params.upstream_weight)
    with np.errstate(divide="ignore"):
        travel = width / (params.migration_rate * weights) if params.migration_rate * weights > 0 else np.inf
        memory = 2.0 * params.friction / depth
        # Without a local term nothing damps the waves; its own weight of 1 then stands in as the scale.
        diffusivity = params.migration_rate * width * max(-params.local_weight, 1.0)
        carried = 1.0 / (diffusivity * (params.upstream_weight * memory) ** 2)
    return np.minimum(travel, carried)


def explicit_dt(width: Any, params: MeanderParams) -> Any:
    """Time step in yr up to which the local term is treated wholly explicitly: D dt / h^2 <= 9/32.

    Args:
        width: Channel width in m.
        params: Migration constants; ``spacing`` is h.
    """
    diffusivity = params.migration_rate * np.asarray(width, np.float64) * -params.local_weight
    with np.errstate(divide="ignore"):
        return np.where(diffusivity > 0, 9.0 / 32.0 * params.spacing**2 / diffusivity, np.inf)


def migration_law(params: MeanderParams, time_step: float, dtype: str) -> Any:
    """Pack the scalars of one (sub-)step of ``time_step`` yr for the kernels of that precision."""
    law = kernels.build(PRECISIONS[dtype][0]).MigrationLaw()
    law.time_step = time_step
    law.migration_rate = params.migration_rate
    law.friction = params.friction
    law.local_weight = params.local_weight
    law.upstream_weight = params.upstream_weight
    law.scale_local = int(params.sinuosity_scaling == "whole")
    law.scale_upstream = int(params.sinuosity_scaling in ("whole", "upstream"))
    law.end_damping = params.end_damping
    law.slope_threshold = params.slope_threshold
    return law


def migrate(
    network: RiverNetwork, form: wp.array, spacing: wp.array, terrain: Terrain | None, law: Any, buffers: StepBuffers
) -> None:
    """Move every point by its rate over one (sub-)step, from ``network.point_xy`` to ``buffers.point_moved``.

    Args:
        network: The network; its points are evenly spaced along each channel.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        spacing: (C,) even spacing of the points, m.
        terrain: Ground whose slope slows migration, on the network's device, or None.
        law: From :func:`migration_law`.
        buffers: Where ``point_rate`` and ``point_moved`` are written.
    """
    kernel = kernels.build(PRECISIONS[network.dtype][0])
    wp.launch(
        kernel.compute_rate,
        dim=buffers.chunk_count,
        inputs=[
            network.point_xy, network.point_section, network.channel_start, form, spacing, law, buffers.chunk,
        ],
        outputs=[buffers.point_rate],
        device=network.device,
    )  # fmt: skip
    height, grid = None, kernel.RasterGrid()
    if terrain is not None:
        height, grid = terrain.height, terrain.grid(network.dtype, network.origin)
    wp.launch(
        kernel.move_points,
        dim=buffers.chunk_count,
        inputs=[
            network.point_xy, network.point_section, network.channel_start, form, spacing, height, grid, law,
            buffers.chunk, buffers.point_rate,
        ],
        outputs=[buffers.point_moved],
        device=network.device,
    )  # fmt: skip
    if network.point_section is not None and buffers.section_moved is not None:
        wp.copy(buffers.section_moved, network.point_section)
