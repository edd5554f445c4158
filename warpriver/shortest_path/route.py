"""The shortest route over the shortcuts of a channel is the new channel [PathStudy2026]."""

from __future__ import annotations

import warp as wp

from warpriver.engine.phase import Phase, Row
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.history.events import Event
from warpriver.kernels import routes as kernels
from warpriver.meander.loops import Loops
from warpriver.meander.resampling import Arcs
from warpriver.network import RiverNetwork
from warpriver.params import PathMeander
from warpriver.shortest_path.shortcuts import Shortcuts, check_radius

__all__ = ["TakeShortcuts"]


class TakeShortcuts(Phase):
    """Joins near strands of ``state.point_moved`` and cuts off what the shortest path bypasses.

    Attributes:
        shortcuts, loops: The edges of the path, and what it cuts off.
        head: (C,) int32, where the route round each ring begins, see ``find_path``; None without rings.
    """

    name = "cut off"
    head: wp.array | None

    def __init__(self, params: PathMeander, arcs: Arcs):
        """Start without room; ``arcs`` are those of the phase that resamples."""
        self._params = params
        self.shortcuts, self.loops = Shortcuts(arcs), Loops(closed=True)

    def check_network(self, network: RiverNetwork) -> None:
        """Channels are longer than the search radius."""
        check_radius(network, self._params)

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        self.head = None if state.closed is None else state.zeros(state.channel_capacity)
        self.shortcuts.allocate(state)
        self.loops.allocate(state)

    def install(self, state: State) -> None:
        """Forget the shortcuts of channels that are no more."""
        clear(self.shortcuts.necks)

    def stages(self, state: State) -> list[Stage]:
        """Return the stages: the shortcuts, the path, the cut."""
        found, loops = self.shortcuts, self.loops
        return [
            *found.stages(state, loops.share_cut),
            *self.path_stages(state),
            *loops.stages(state, found.point_neck, found.point_neck, found.necks),
        ]

    def path_stages(self, state: State) -> list[Stage]:
        """Return the stages that find the shortest path down each channel over its shortcuts, ``point_neck``.

        On a ring a shortcut (i, j) may bypass either of two arcs, that from i to j and that from j round to i. Which
        one it is follows from the ring's head, a point that none passes over (see the kernel ``open_rings``): the route
        is the shortest of all closed ones that pass the head once, and the marked point where the part that holds it
        goes on.

        Linear in points and edges. On the CPU the sweep is serial down a channel; channels without a shortcut are
        passed over. With chunks, clusters of shortcuts that reach over each other are swept in parallel, from one chunk
        that holds an end of one to the next; a ring is swept by one thread.
        """
        kernel, device, found, marks = kernels.build(state.scalar), state.device, self.shortcuts, self.shortcuts.marks
        arcs, longer = found.arcs, int(state.params.ring_policy == "longer")

        def open_rings(share: Share) -> None:
            launch(
                kernel.open_rings,
                dim=share.channel_threads,
                inputs=[
                    state.start, state.closed, longer, share.work, state.point_moved, arcs.point_arc,
                    arcs.chunk_offset, found.point_links, found.point_link, found.share_links_sum, found.necks,
                    marks.marks, found.link_to,
                ],
                outputs=[found.link_saving, found.point_from, self.head],
                device=device,
            )  # fmt: skip

        def find(share: Share) -> None:
            launch(
                kernel.find_path,
                dim=share.point_threads,
                inputs=[
                    state.start, share.work, state.closed, self.head, found.necks, found.share_links_sum, marks.marks,
                    found.links,
                ],
                outputs=[found.point_from, found.point_saving, found.point_neck, self.loops.share_cut],
                device=device,
            )  # fmt: skip

        opened = [] if state.closed is None else [Stage(self.name, open_rings)]
        return [*opened, Stage(self.name, find)]

    def after(self, state: State, row: Row) -> list[Event]:
        """Return the cutoffs and splits of a row."""
        return self.loops.after(state, row)

    def grow(self, state: State, status: list[int]) -> bool:
        """Make room for more shortcuts or loops."""
        return self.shortcuts.grow(state, status) or self.loops.grow(state, status)

    def check(self, state: State) -> None:
        """Points are finite, ends are in place unless a phase moves them, and cutoffs are in order."""
        state.check_moved(self.name, anchored=not state.nodes_move)
        self.loops.check(state)
