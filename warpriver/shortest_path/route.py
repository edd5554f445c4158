"""The shortest route over the shortcuts of a channel is the new channel [PathStudy2026]."""

from __future__ import annotations

from typing import Any

import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.engine.phase import Batch, Phase
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.history.events import Event
from warpriver.kernels import routes as kernels
from warpriver.kernels.links import Route
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
        point_from: (P,) int32, point + 1 where the best shortcut to a point begins, 0 where none is better than the
            channel itself; -1 at the ends of a ring's shortcuts before its route is known.
        point_saving: (P,) float64, what the best route to a point over a shortcut saves against the channel, m.
        point_neck: (P,) int32, where the shortcut of the route ends that begins at a point, -1 if none does.
        head: (C,) int32, where the route round each ring begins, see ``open_rings``; None without rings.
    """

    name = "cut off"
    point_from: DeviceArray
    point_saving: DeviceArray
    point_neck: DeviceArray
    head: DeviceArray | None

    def __init__(self, params: PathMeander, arcs: Arcs):
        """Start without capacity; ``arcs`` are those of the phase that resamples."""
        self._params = params
        self.shortcuts, self.loops = Shortcuts(arcs), Loops(closed=True)

    def check_network(self, network: RiverNetwork) -> None:
        """Channels are longer than the search radius."""
        check_radius(network, self._params)

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        points = state.point_capacity
        self.point_from, self.point_saving = state.zeros(points), state.zeros(points, wp.float64)
        self.point_neck = state.spare[1]
        self.head = None if state.closed is None else state.zeros(state.channel_capacity)
        self.shortcuts.allocate(state)
        self.loops.allocate(state)

    def install(self, state: State) -> None:
        """Forget the shortcuts of channels that are no more."""
        clear(self.shortcuts.necks)

    @property
    def route(self) -> Any:
        """The best routes as kernels take them."""
        route = Route()
        route.point_from, route.point_saving = self.point_from, self.point_saving
        if self.head is not None:
            route.channel_head = self.head
        return route

    @property
    def cuts(self) -> Any:
        """What is cut off as kernels take it: every shortcut on the route is a neck that is cut."""
        return self.loops.cuts(self.point_neck, self.point_neck, self.shortcuts.necks)

    def stages(self, state: State) -> list[Stage]:
        """Return the stages: the shortcuts, the path, the cut."""
        cuts = self.cuts
        return [
            *self.shortcuts.stages(state, self.route, cuts),
            *self.path_stages(state),
            *self.loops.stages(state, cuts),
        ]

    def path_stages(self, state: State) -> list[Stage]:
        """Return the stages that find the shortest path down each channel over its shortcuts, ``point_neck``.

        On a ring a shortcut (i, j) may bypass either of two arcs, that from i to j and that from j round to i. Which
        one it is follows from the ring's head, a point that none passes over (see the kernel ``open_rings``): the route
        is the shortest of all closed ones that pass the head once, and the marked point where the arc that holds it
        goes on.

        Linear in points and edges. On the CPU the sweep is serial down a channel; channels without a shortcut are
        passed over. With chunks, clusters of shortcuts that reach over each other are swept in parallel, from one chunk
        that holds an end of one to the next; a ring is swept by one thread.
        """
        kernel, device, found = kernels.build(state.scalar), state.device, self.shortcuts
        channels, marks, links, arcs = state.channels(), found.marks.marks, found.links, found.arcs.struct
        route, cuts, longer = self.route, self.cuts, int(state.params.ring_policy == "longer")

        def open_rings(share: Share) -> None:
            launch(
                kernel.open_rings,
                dim=share.channel_threads,
                inputs=[channels, longer, share.work, state.point_moved, arcs, marks],
                outputs=[links, route],
                device=device,
            )

        def find(share: Share) -> None:
            launch(
                kernel.find_path,
                dim=share.point_threads,
                inputs=[channels, share.work, marks, links],
                outputs=[route, cuts],
                device=device,
            )

        opened = [] if state.closed is None else [Stage(self.name, open_rings)]
        return [*opened, Stage(self.name, find)]

    def after(self, state: State, batch: Batch) -> list[Event]:
        """Return the cutoffs and splits of a batch."""
        return self.loops.after(state, batch)

    def grow(self, state: State, status: list[int]) -> bool:
        """Make room for more shortcuts or loops."""
        return self.shortcuts.grow(state, status) or self.loops.grow(state, status)

    def check(self, state: State) -> None:
        """Points are finite, ends are in place unless a phase moves them, and cutoffs are in order."""
        state.check_moved(self.name, anchored=not state.nodes_move)
        self.loops.check(state)
