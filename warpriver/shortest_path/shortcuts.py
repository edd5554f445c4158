"""Shortcuts join the near strands of a channel; what the shortest route makes of them is in ``route``."""

from __future__ import annotations

import math
from typing import Any

import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.engine.scans import Scan
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.errors import InputError
from warpriver.kernels import shortcuts as kernels
from warpriver.kernels.links import Links
from warpriver.kernels.status import FAULT, FAULT_SHORTCUTS_FULL, LINKS_NEEDED
from warpriver.meander.loops import ChunkMarks, PointTable
from warpriver.meander.resampling import Arcs
from warpriver.network import RiverNetwork
from warpriver.params import PathMeander

__all__ = ["Shortcuts", "check_radius"]

# Capacity for shortcuts at first, a point and in all: only where strands touch are there any.
SHORTCUTS_PER_POINT, MINIMUM_SHORTCUTS = 0.125, 64


class Shortcuts:
    """All pairs of ``state.point_moved`` that a shortcut joins, and what each saves.

    All pairs within the radius, the cone and beyond the minimum arc are edges: counted, then listed. Their number has
    no bound a point, only a capacity for all of them, which the host enlarges on a fault.

    Attributes:
        table, marks: What is near what, and the chunks in which a shortcut begins or ends.
        arcs: Arc lengths of the points.
        necks: (C,) int32, shortcuts of each channel, where the work is dealt out in slabs.
        point_links: (P,) int32, shortcuts that begin at each point; ``point_link``: the first of them.
        link_from, link_to: (E,) int32, the shortcuts, in ascending order.
        link_saving: (E,) float64, the arc that each bypasses less its own length, m; -1 for one that is forbidden.
        share_links, share_links_sum: vec2i, shortcuts that begin in each slab or chunk and the last point that one of
            them reaches, and their running sum and maximum.
    """

    necks: DeviceArray
    link_from: DeviceArray
    link_to: DeviceArray
    link_saving: DeviceArray

    def __init__(self, arcs: Arcs):
        """Start without capacity; ``arcs`` are those of the phase that resamples."""
        self.arcs, self.table, self.marks = arcs, PointTable(), ChunkMarks()
        self._capacity = 0

    @property
    def capacity(self) -> int:
        """Capacity for shortcuts."""
        return self._capacity

    def count(self, state: State) -> int:
        """Shortcuts that the last search found, whether they fitted or not."""
        needed: int = state.read_status()[LINKS_NEEDED]
        return needed

    @property
    def links(self) -> Any:
        """The shortcuts as kernels take them."""
        links = Links()
        links.link_from, links.link_to, links.link_saving = self.link_from, self.link_to, self.link_saving
        links.point_links, links.point_link, links.channel_links = self.point_links, self.point_link, self.necks
        links.share_links, links.share_links_sum = self.share_links, self.share_links_sum
        return links

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        points = state.point_capacity
        self.necks = state.zeros(state.channel_capacity)
        self.point_links, self.point_link = (state.zeros(points) for _ in range(2))
        self.share_links, self.share_links_sum = (state.zeros(state.share_count, wp.vec2i) for _ in range(2))
        self.scan = Scan("marks", self.share_links, self.share_links_sum, state.scalar, serial=state.chunk == 0)
        self.table.allocate(state)
        self.marks.allocate(state)
        self.reserve(state, max(self._capacity, MINIMUM_SHORTCUTS + int(SHORTCUTS_PER_POINT * points)))

    def reserve(self, state: State, count: int) -> None:
        """Allocate for so many shortcuts."""
        self._capacity = count
        self.link_from, self.link_to = state.zeros(count), state.zeros(count)
        self.link_saving = state.zeros(count, wp.float64)
        state.changed()

    def grow(self, state: State, status: list[int]) -> bool:
        """Allocate for twice the shortcuts that the last search found, if they were too many."""
        if status[FAULT] != FAULT_SHORTCUTS_FULL:
            return False
        self.reserve(state, 2 * status[LINKS_NEEDED])
        return True

    def stages(self, state: State, route: Any, cuts: Any) -> list[Stage]:
        """Return the stages that list the shortcuts and weigh them.

        Args:
            state: Its points have moved; ``params`` has ``search_radius`` and ``cutoff_min_arc`` in widths, and
                ``cone_angle`` in degrees.
            route: What the best route to each point is noted in, as kernels take it; it is cleared.
            cuts: What is cut off, as kernels take it; it is cleared.
        """
        kernel, device, params = kernels.build(state.scalar), state.device, state.params
        channels, moved, links, arcs = state.channels(), state.moved(), self.links, self.arcs.struct
        near = self.table.struct(state, params.search_radius, params.cutoff_min_arc)
        cone = math.cos(math.radians(params.cone_angle)) ** 2 if params.cone_angle < 90.0 else 0.0

        def count(share: Share) -> None:
            launch(
                kernel.count_shortcuts_in_chunks if state.chunk else kernel.count_shortcuts,
                dim=share.point_threads,
                inputs=[channels, cone, share.work, moved, near],
                outputs=[links, route, cuts],
                device=device,
            )

        def number(_: Share) -> None:
            if state.chunk > 0:
                clear(self.marks.chunk_mark)
            self.scan.run()

        def list_and_weigh(share: Share) -> None:
            launch(
                kernel.list_shortcuts,
                dim=share.point_threads,
                inputs=[channels, cone, share.work, moved, near],
                outputs=[links, state.status.array],
                device=device,
            )
            launch(
                kernel.weigh_shortcuts,
                dim=share.point_threads,
                inputs=[share.work, state.point_moved, arcs],
                outputs=[links, self.marks.chunk_mark],
                device=device,
            )

        return [
            *self.table.stages(state, params.search_radius),
            Stage("cut off", count),
            *self.arcs.stages(state, "cut off"),
            Stage("cut off", number, shared=False),
            Stage("cut off", list_and_weigh),
            *self.marks.stages(state),
        ]


def check_radius(network: RiverNetwork, params: PathMeander) -> None:
    """Raise ``ValueError`` where the search radius exceeds a channel's length: all of it would be near itself."""
    radius, length = params.search_radius * network.channel_width, network.channel_lengths()
    if (radius > length).any():
        c = int((radius > length).argmax())
        raise InputError(
            f"search_radius {params.search_radius:g} widths ({radius[c]:g} m) exceeds the length of channel {c} "
            f"({length[c]:g} m); use a smaller one"
        )
