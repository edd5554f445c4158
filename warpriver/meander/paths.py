"""Meanders by shortest paths: the curvature pushes, near strands are joined, and the shortest route is the channel.

After the study *Meandering river: oxbows from shortest paths* [PathStudy2026].
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels import paths as kernels
from warpriver.meander.buffers import StepBuffers
from warpriver.meander.cutoffs import cut_loops, link_points
from warpriver.meander.resampling import measure
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import PathMeander
from warpriver.terrain import Terrain

__all__ = [
    "PathBuffers",
    "check_radius",
    "find_path",
    "find_shortcuts",
    "path_law",
    "push",
    "stable_push_dt",
    "take_shortcuts",
]

# Shortcuts that there is room for at first, a point: only where strands touch are there any.
SHORTCUTS_PER_POINT = 0.125


class PathBuffers(StepBuffers):
    """Scratch of one step by shortest paths.

    Attributes:
        point_push: (P,) vec4, push and smoothing of each point, half blurred, m.
        point_links: (P,) int32, shortcuts that begin at each point.
        point_from: (P,) int32, point + 1 where the best shortcut to a point begins, 0 where none is better than the
            channel itself.
        point_saving: (P,) float64, what the best route to a point over a shortcut saves against the channel, m.
        link_from, link_to: (E,) int32, the shortcuts, in ascending order.
        link_saving: (E,) float64, the arc that each bypasses less its own length, m.
        chunk_links, chunk_links_sum: shortcuts that begin in each chunk of points, and their running sum.
        chunk_ends: 1 where a shortcut ends in the chunk.
    """

    def __init__(self, network: RiverNetwork, point_capacity: int, cut_capacity: int, oxbow_capacity: int):
        """Allocate for ``network``, with room for that many points, cutoffs a step and oxbow points a step."""
        super().__init__(network, point_capacity, cut_capacity, oxbow_capacity)
        scalar, device = PRECISIONS[network.dtype][0], network.device
        self.point_push = wp.zeros(point_capacity, dtype=wp.types.vector(4, scalar), device=device)
        self.point_links = wp.zeros(point_capacity, dtype=wp.int32, device=device)
        self.point_from = wp.zeros(point_capacity, dtype=wp.int32, device=device)
        self.point_saving = wp.zeros(point_capacity, dtype=wp.float64, device=device)
        self.chunk_links = wp.zeros(self.chunk_count, dtype=wp.int32, device=device)
        self.chunk_links_sum = wp.zeros(self.chunk_count, dtype=wp.int32, device=device)
        self.chunk_ends = wp.zeros(self.chunk_count, dtype=wp.int32, device=device)
        self._allocate_links(64 + int(SHORTCUTS_PER_POINT * point_capacity))

    @property
    def link_capacity(self) -> int:
        """Shortcuts that there is room for."""
        return self.link_to.shape[0]

    def _allocate_links(self, count: int) -> None:
        device = self.point_links.device
        self.link_from = wp.zeros(count, dtype=wp.int32, device=device)
        self.link_to = wp.zeros(count, dtype=wp.int32, device=device)
        self.link_saving = wp.zeros(count, dtype=wp.float64, device=device)

    def make_room_for_shortcuts(self) -> None:
        """Allocate for twice the shortcuts that the last search found."""
        self._allocate_links(2 * int(self.chunk_links_sum.numpy()[-1]))


def stable_push_dt(width: Any, depth: Any, params: PathMeander) -> Any:
    """Longest time step in yr that follows a channel truly; longer ones are done in equal sub-steps.

    The smoothing is implicit and sets no limit. The push does not: the shortest waves grow by k / (b^2 w) a year (b the
    blur length in widths), at most by half in a step; and a bend as tight as its width moves by at most its width.

    Args:
        width: Channel width in m, a number or an array.
        depth: Not used; here so that both solvers are asked alike.
        params: Constants.

    Returns:
        Time step in yr, float64, of the shape of ``width``; infinite where nothing moves.
    """
    width = np.asarray(width, np.float64)
    with np.errstate(divide="ignore"):
        return width / np.float64(params.displacement_rate) * min(1.0, 0.5 * params.blur_length**2)


def path_law(params: PathMeander, time_step: float, dtype: str) -> Any:
    """Pack the scalars of one (sub-)step of ``time_step`` yr for the kernels of that precision."""
    law = kernels.build(PRECISIONS[dtype][0]).PathLaw()
    law.time_step = time_step
    law.displacement_rate = params.displacement_rate
    law.downstream_share = params.downstream_share
    law.blur_length = params.blur_length
    law.smoothing = params.smoothing
    law.end_damping = params.end_damping
    law.slope_threshold = params.slope_threshold
    return law


def check_radius(network: RiverNetwork, params: PathMeander) -> None:
    """Raise ``ValueError`` where the search radius exceeds a channel's length: all of it would be near itself."""
    radius, length = params.search_radius * network.channel_width, network.channel_lengths()
    if (radius > length).any():
        c = int((radius > length).argmax())
        raise ValueError(
            f"search_radius {params.search_radius:g} widths ({radius[c]:g} m) exceeds the length of channel {c} "
            f"({length[c]:g} m); use a smaller one"
        )


def push(
    network: RiverNetwork, form: wp.array, spacing: wp.array, terrain: Terrain | None, law: Any, buffers: PathBuffers
) -> None:
    """Push and smooth every point over one (sub-)step, from ``network.point_xy`` to ``buffers.point_moved``.

    Args:
        network: The network; its points are evenly spaced along each channel.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        spacing: (C,) even spacing of the points, m.
        terrain: Ground whose slope slows the push, on the network's device, or None.
        law: From :func:`path_law`.
        buffers: Where ``point_push`` and ``point_moved`` are written.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    channels = [network.point_xy, network.point_section, network.channel_start, form, spacing]
    wp.launch(
        kernel.compute_push,
        dim=buffers.chunk_count,
        inputs=[*channels, law, buffers.chunk],
        outputs=[buffers.point_push],
        device=device,
    )
    height, grid = None, kernel.RasterGrid()
    if terrain is not None:
        height, grid = terrain.height, terrain.grid(network.dtype, network.origin)
    wp.launch(
        kernel.shift_points,
        dim=buffers.chunk_count,
        inputs=[*channels, height, grid, law, buffers.chunk, buffers.point_push],
        outputs=[buffers.point_moved],
        device=device,
    )
    if network.point_section is not None and buffers.section_moved is not None:
        wp.copy(buffers.section_moved, network.point_section)


def find_shortcuts(
    network: RiverNetwork, form: wp.array, spacing: wp.array, params: PathMeander, buffers: PathBuffers
) -> None:
    """List all pairs of ``buffers.point_moved`` that a shortcut joins, and what each saves.

    All pairs within the radius, the cone and beyond the least arc are edges: counted, then listed. Their number has no
    bound a point, only the room for all of them, which the host enlarges on ``buffers.fault``.

    Args:
        network: The network whose points moved.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        spacing: (C,) even spacing of the points before the move, m.
        params: ``search_radius`` and ``cutoff_min_arc`` in widths, ``cone_angle`` in degrees.
        buffers: Gets the ``point_links`` and ``link_...`` arrays.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    start, chunk, chunks, b = network.channel_start, buffers.chunk, buffers.chunk_count, buffers
    law = kernel.ShortcutLaw()
    law.radius, law.min_arc = params.search_radius, params.cutoff_min_arc
    law.cone = math.cos(math.radians(params.cone_angle)) ** 2 if params.cone_angle < 90.0 else 0.0
    link_points(network, form, params.search_radius, buffers)
    near = [b.point_moved, b.section_moved, b.point_next, b.bucket_head]
    wp.launch(
        kernel.count_shortcuts,
        dim=chunks,
        inputs=[start, form, spacing, law, chunk, int(device.is_cpu), *near],
        outputs=[b.point_links, b.point_neck, b.point_from, b.chunk_links, b.chunk_ends, b.chunk_necks],
        device=device,
    )
    wp.utils.array_scan(b.chunk_links, b.chunk_links_sum, inclusive=True)
    wp.launch(
        kernel.list_shortcuts,
        dim=chunks,
        inputs=[start, form, spacing, law, chunk, *near, b.point_links, b.chunk_links_sum],
        outputs=[b.link_from, b.link_to, b.fault],
        device=device,
    )
    measure(network, buffers)
    wp.launch(
        kernel.weigh_shortcuts,
        dim=chunks,
        inputs=[chunk, b.point_moved, b.point_arc, b.chunk_offset, b.chunk_links_sum, b.link_from, b.link_to],
        outputs=[b.link_saving, b.chunk_ends],
        device=device,
    )


def find_path(network: RiverNetwork, buffers: PathBuffers) -> None:
    """Find the shortest path down each channel over the shortcuts of :func:`find_shortcuts`.

    Linear in points and edges. The sweep is serial down a channel, but passes over the chunks of points that hold no
    end of an edge; channels run in parallel.

    Args:
        network: The network whose points moved.
        buffers: Gets ``point_neck``, -1 but where a shortcut on the path begins, and the counts of cuts.
    """
    b = buffers
    wp.launch(
        kernels.build(PRECISIONS[network.dtype][0]).find_path,
        dim=network.channel_count,
        inputs=[
            network.channel_start, b.chunk, b.point_links, b.chunk_links, b.chunk_links_sum, b.chunk_ends, b.link_to,
            b.link_saving,
        ],
        outputs=[
            b.point_from, b.point_saving, b.point_neck, b.chunk_necks, b.channel_cuts, b.channel_cut_points,
        ],
        device=network.device,
    )  # fmt: skip


def take_shortcuts(
    network: RiverNetwork, form: wp.array, spacing: wp.array, params: PathMeander, buffers: PathBuffers
) -> None:
    """Join near strands of ``buffers.point_moved``, find each channel's shortest path, and cut off what it bypasses.

    Args:
        network: The network whose points moved.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        spacing: (C,) even spacing of the points before the move, m.
        params: As of :func:`find_shortcuts`.
        buffers: Scratch and results, as of :func:`warpriver.meander.cutoffs.cut_loops`.
    """
    find_shortcuts(network, form, spacing, params, buffers)
    find_path(network, buffers)
    cut_loops(network, buffers)
