"""The shortest route over the shortcuts of a channel is the new channel [PathStudy2026]."""

from __future__ import annotations

import warp as wp

from warpriver.kernels import routes as kernels
from warpriver.meander.buffers import StepChannels
from warpriver.meander.cutoffs import cut_loops
from warpriver.meander.shortcuts import PathBuffers, find_shortcuts
from warpriver.meander.stages import Share, Stage, launch
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import PathMeander

__all__ = ["find_path", "take_shortcuts"]


def find_path(network: RiverNetwork, channels: StepChannels, buffers: PathBuffers, params: PathMeander) -> list[Stage]:
    """Return the stages that find the shortest path down each channel over the shortcuts of ``find_shortcuts``.

    On a ring a shortcut (i, j) may bypass either of two arcs, that from i to j and that from j round to i. Which one it
    is follows from the ring's head, a point that none passes over (see the kernel ``open_rings``): the route is the
    shortest of all closed ones that pass the head once, and the marked point where the part that holds it goes on.

    Linear in points and edges. On the CPU the sweep is serial down a channel, and channels without a shortcut are
    passed over. With chunks, clusters of shortcuts that reach over each other are swept in parallel, from one chunk that
    holds an end of one to the next; a ring is swept by one thread.

    Args:
        network: The network whose points moved.
        channels: Its channels.
        buffers: Gets ``point_neck``, -1 but where a shortcut on the path begins, and ``share_cut``.
        params: ``ring_policy``.
    """
    kernel, b, links = kernels.build(PRECISIONS[network.dtype][0]), buffers, kernels.Links()
    links.point_links, links.point_link = b.point_links, b.point_link
    links.link_from, links.link_to, links.link_saving = b.link_from, b.link_to, b.link_saving
    longer = int(params.ring_policy == "longer")

    def open_rings(share: Share) -> None:
        wp.launch(
            kernel.open_rings,
            dim=share.channel_threads,
            inputs=[
                channels.start, channels.closed, longer, share.work, b.point_moved, b.point_arc, b.chunk_offset,
                b.point_links, b.point_link, b.share_links_sum, channels.necks, b.marks, b.link_to,
            ],
            outputs=[b.link_saving, b.point_from, channels.head],
            device=network.device,
        )  # fmt: skip

    def find(share: Share) -> None:
        launch(
            kernel.find_path,
            share.point_threads,
            [
                channels.start, share.work, channels.closed, channels.head, channels.necks, b.share_links_sum, b.marks,
                links,
            ],
            [b.point_from, b.point_saving, b.point_neck, b.share_cut],
            network.device,
        )  # fmt: skip

    opened = [] if channels.closed is None else [Stage("cut off", open_rings)]
    return [*opened, Stage("cut off", find)]


def take_shortcuts(
    network: RiverNetwork, channels: StepChannels, buffers: PathBuffers, params: PathMeander
) -> list[Stage]:
    """Return the stages that join near strands of ``buffers.point_moved`` and cut off what the shortest path bypasses.

    Args:
        network: The network whose points moved.
        channels: Its channels, of spacing as before the move.
        buffers: Scratch and results, as of :func:`warpriver.meander.cutoffs.cut_loops`.
        params: As of ``find_shortcuts`` and :func:`find_path`.
    """
    return [
        *find_shortcuts(network, channels, buffers, params),
        *find_path(network, channels, buffers, params),
        *cut_loops(network, channels, buffers, buffers.point_neck),
    ]
