"""Shortcuts join the near strands of a channel; what the shortest route makes of them is in ``routes``."""

from __future__ import annotations

import math

import warp as wp

from warpriver.kernels import shortcuts as kernels
from warpriver.kernels.polyline import LINKS_NEEDED
from warpriver.meander.buffers import StepBuffers, StepChannels
from warpriver.meander.cutoffs import link_points, list_marks
from warpriver.meander.resampling import measure
from warpriver.meander.scans import Scan
from warpriver.meander.stages import Share, Stage
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import PathMeander

__all__ = ["PathBuffers", "check_radius", "find_shortcuts"]

# Shortcuts that there is room for at first, a point and in all: only where strands touch are there any.
SHORTCUTS_PER_POINT, LEAST_SHORTCUTS = 0.125, 64


class PathBuffers(StepBuffers):
    """Scratch of one step by shortest paths.

    Attributes:
        point_push: (P,) vec4, push and smoothing of each point, half blurred, m.
        point_links: (P,) int32, shortcuts that begin at each point.
        point_link: (P,) int32, the first of them.
        point_from: (P,) int32, point + 1 where the best shortcut to a point begins, 0 where none is better than the
            channel itself; -1 at the ends of a ring's shortcuts before its route is known.
        point_saving: (P,) float64, what the best route to a point over a shortcut saves against the channel, m.
        link_from, link_to: (E,) int32, the shortcuts, in ascending order.
        link_saving: (E,) float64, the arc that each bypasses less its own length, m; -1 for one that is forbidden.
        share_links, share_links_sum: vec2i, shortcuts that begin in each slab or chunk and the last point that one of
            them reaches, and their running sum and maximum. ``chunk_mark`` tells where one begins or ends.
    """

    def __init__(self, network: RiverNetwork, point_capacity: int, cut_capacity: int, oxbow_capacity: int):
        """Allocate for ``network``, with room for that many points, cutoffs a step and oxbow points a step."""
        super().__init__(network, point_capacity, cut_capacity, oxbow_capacity)
        scalar, device = PRECISIONS[network.dtype][0], network.device
        self.point_push = wp.zeros(point_capacity, dtype=wp.types.vector(4, scalar), device=device)
        self.point_links = wp.zeros(point_capacity, dtype=wp.int32, device=device)
        self.point_link = wp.zeros(point_capacity, dtype=wp.int32, device=device)
        self.point_from = wp.zeros(point_capacity, dtype=wp.int32, device=device)
        self.point_saving = wp.zeros(point_capacity, dtype=wp.float64, device=device)
        self.share_links = wp.zeros(self.share_count, dtype=wp.vec2i, device=device)
        self.share_links_sum = wp.zeros(self.share_count, dtype=wp.vec2i, device=device)
        self.scan_links = Scan("marks", self.share_links, self.share_links_sum, scalar, serial=self.chunk == 0)
        self._allocate_links(LEAST_SHORTCUTS + int(SHORTCUTS_PER_POINT * point_capacity))

    @property
    def link_count(self) -> int:
        """Shortcuts that the last search found, whether there was room for them or not."""
        return self.read_status()[LINKS_NEEDED]

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
        """Allocate for twice the shortcuts that the last search found; stages made before hold the old arrays."""
        self._allocate_links(2 * self.link_count)


def check_radius(network: RiverNetwork, params: PathMeander) -> None:
    """Raise ``ValueError`` where the search radius exceeds a channel's length: all of it would be near itself."""
    radius, length = params.search_radius * network.channel_width, network.channel_lengths()
    if (radius > length).any():
        c = int((radius > length).argmax())
        raise ValueError(
            f"search_radius {params.search_radius:g} widths ({radius[c]:g} m) exceeds the length of channel {c} "
            f"({length[c]:g} m); use a smaller one"
        )


def find_shortcuts(
    network: RiverNetwork, channels: StepChannels, buffers: PathBuffers, params: PathMeander
) -> list[Stage]:
    """Return the stages that list all pairs of ``buffers.point_moved`` that a shortcut joins, and what each saves.

    All pairs within the radius, the cone and beyond the least arc are edges: counted, then listed. Their number has no
    bound a point, only the room for all of them, which the host enlarges on a fault.

    Args:
        network: The network whose points moved.
        channels: Its channels, of spacing as before the move.
        buffers: Gets the ``point_links`` and ``link_...`` arrays.
        params: ``search_radius`` and ``cutoff_min_arc`` in widths, ``cone_angle`` in degrees.
    """
    kernel, device, b = kernels.build(PRECISIONS[network.dtype][0]), network.device, buffers
    law = kernel.ShortcutLaw()
    law.radius, law.min_arc = params.search_radius, params.cutoff_min_arc
    law.cone = math.cos(math.radians(params.cone_angle)) ** 2 if params.cone_angle < 90.0 else 0.0
    if channels.closed is not None:
        law.channel_closed = channels.closed
    shape = [channels.start, channels.form, channels.spacing]
    near = [b.point_moved, b.section_moved, b.point_next, b.bucket_head]

    def count(share: Share) -> None:
        wp.launch(
            kernel.count_shortcuts,
            dim=share.point_threads,
            inputs=[*shape, channels.step, law, share.work, *near],
            outputs=[b.point_links, b.point_neck, b.point_from, b.share_links, b.share_cut, channels.necks],
            device=device,
        )

    def number(_: Share) -> None:
        if b.chunk > 0:
            b.chunk_mark.zero_()
        b.scan_links.run()

    def list_and_weigh(share: Share) -> None:
        wp.launch(
            kernel.list_shortcuts,
            dim=share.point_threads,
            inputs=[*shape, law, share.work, *near, b.point_links, channels.necks, b.share_links_sum],
            outputs=[b.point_link, b.link_from, b.link_to, b.status.array],
            device=device,
        )
        wp.launch(
            kernel.weigh_shortcuts,
            dim=share.point_threads,
            inputs=[
                share.work, b.point_moved, b.point_arc, b.chunk_offset, b.share_links_sum, b.link_from, b.link_to,
            ],
            outputs=[b.link_saving, b.chunk_mark],
            device=device,
        )  # fmt: skip

    return [
        *link_points(network, channels, buffers, params.search_radius),
        Stage("cut off", count),
        *measure(network, channels, buffers, "cut off"),
        Stage("cut off", number, shared=False),
        Stage("cut off", list_and_weigh),
        *list_marks(network, buffers),
    ]
