"""Collisions: channels that come closer to each other than they are wide are joined where they touch."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels import collisions as kernels
from warpriver.meander.buffers import StepBuffers
from warpriver.meander.topology import EditedChannels, NetworkEdit, Rejoin
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import MeanderParams, PathMeander

__all__ = ["collision_law", "find_contacts", "gather_points", "gathered_nodes", "join_channels", "list_contacts"]

# Length of a block of points in the grid, in widths of the widest channel: long enough that few blocks are looked up,
# short enough that few blocks near each other do not touch.
BLOCK_WIDTHS = 2.0


def collision_law(network: RiverNetwork, params: MeanderParams | PathMeander, widest: float) -> Any:
    """Pack the scalars of the search for a network; ``None`` where there is nothing to search.

    Args:
        network: The network.
        params: ``collision_distance`` and ``junction_reach``.
        widest: Greatest width of all points, m.
    """
    if params.collision_distance == 0.0 or network.channel_count < 2:
        return None
    law = kernels.build(PRECISIONS[network.dtype][0]).CollisionLaw()
    law.distance = params.collision_distance
    law.node_reach = params.junction_reach
    law.block = BLOCK_WIDTHS * widest
    # Two cells side by side hold every block whose middle is near enough: distance, half a block each, a spacing each.
    law.cell = 2.0 * (params.collision_distance * widest + BLOCK_WIDTHS * widest + 2.5 * params.spacing)
    return law


def gathered_nodes(network: RiverNetwork, params: MeanderParams | PathMeander) -> np.ndarray:
    """Label the nodes for the search, (C, 2) int32 above and below each channel: near ones count as one.

    Channels that meet at neighbouring junctions lie as close there as those that share one. Nodes that a channel of
    less than half the junction reach joins have the same label.

    Args:
        network: The network.
        params: ``junction_reach``.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    short = network.channel_lengths() < 0.5 * params.junction_reach * network.channel_width
    ends = network.channel_from[short], network.channel_to[short]
    graph = coo_array((np.ones(int(short.sum())), ends), shape=(network.node_count, network.node_count))
    label = connected_components(graph, directed=False)[1]
    return np.stack([label[network.channel_from], label[network.channel_to]], axis=1).astype(np.int32)


def find_contacts(
    network: RiverNetwork, nodes: wp.array, form: wp.array, spacing: wp.array, law: Any, buffers: StepBuffers
) -> None:
    """Count the places where channels touch, in ``buffers.contact_count`` and by chunk.

    Args:
        network: The network, its points evenly spaced.
        nodes: (C,) vec2i, labels of :func:`gathered_nodes`.
        form: (C,) vec4 of mean width, mean depth, greatest width and spacing asked for, all in m.
        spacing: (C,) even spacing, m.
        law: From :func:`collision_law`.
        buffers: Scratch and results.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    buffers.block_head.zero_()
    buffers.block_high.zero_()
    buffers.contact_count.zero_()
    wp.launch(
        kernel.insert_blocks,
        dim=buffers.chunk_count,
        inputs=[network.point_xy, network.channel_start, spacing, law, buffers.chunk],
        outputs=[buffers.point_next, buffers.point_neck, buffers.block_head, buffers.block_high],
        device=device,
    )
    _launch_search(network, nodes, form, spacing, law, buffers, None)


def list_contacts(
    network: RiverNetwork, nodes: wp.array, form: wp.array, spacing: wp.array, law: Any, buffers: StepBuffers
) -> np.ndarray:
    """Return the contacts that :func:`find_contacts` counted, (K, 2) point indices, in the order of the points."""
    count = int(buffers.contact_count.numpy()[0])
    if count == 0:
        return np.zeros((0, 2), np.int32)
    wp.utils.array_scan(buffers.chunk_contacts, buffers.chunk_contacts_sum, inclusive=True)
    contact = wp.zeros(count, dtype=wp.vec2i, device=network.device)
    _launch_search(network, nodes, form, spacing, law, buffers, contact)
    return contact.numpy()


def _launch_search(
    network: RiverNetwork, nodes: wp.array, form: wp.array, spacing: wp.array, law: Any, buffers: StepBuffers, out: Any
) -> None:
    kernel = kernels.build(PRECISIONS[network.dtype][0])
    wp.launch(
        kernel.find_contacts,
        dim=buffers.chunk_count,
        inputs=[
            network.point_xy, network.point_section, network.channel_start, nodes, form, spacing, law, buffers.chunk,
            buffers.point_next, buffers.point_neck, buffers.block_head, buffers.block_high, buffers.chunk_contacts_sum,
        ],
        outputs=[out, buffers.chunk_contacts, buffers.contact_count],
        device=network.device,
    )  # fmt: skip


def join_channels(network: RiverNetwork, contacts: np.ndarray) -> tuple[EditedChannels, list[Rejoin]] | None:
    """Join the channels that touch, each pair at its uppermost contact on the channel that gives way.

    Args:
        network: The network.
        contacts: (K, 2) pairs of points of different channels.

    Returns:
        The channels afterwards and what was done; None when no contact could be acted on.
    """
    start = network.starts()
    owner = np.searchsorted(start, contacts, side="right") - 1
    edit = NetworkEdit(network)
    # The largest rivers first: what they take cannot be taken by a smaller one.
    flow = network.channel_flow()[owner]
    on_minor = np.where(flow[:, 1] < flow[:, 0], contacts[:, 1], contacts[:, 0])
    order = np.lexsort((contacts[:, 0], on_minor, -flow.min(axis=1), -flow.max(axis=1)))
    done = []
    for k in order:
        result = edit.rejoin(int(owner[k, 0]), int(contacts[k, 0]), int(owner[k, 1]), int(contacts[k, 1]))
        if result is not None:
            done.append(result)
    if not done:
        return None
    return edit.build(), done


def gather_points(network: RiverNetwork, edited: EditedChannels, buffers: StepBuffers) -> None:
    """Bring the points of a network into the order of its edited channels, in ``buffers.point_moved``."""
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    source: wp.array = wp.array(edited.point_source.astype(np.int32), dtype=wp.int32, device=device)
    scale: wp.array | None = None
    if edited.point_scale is not None:
        _, vec2, real = PRECISIONS[network.dtype]
        scale = wp.array(edited.point_scale.astype(real), dtype=vec2, device=device)
    wp.launch(
        kernel.gather_points,
        dim=len(edited.point_source),
        inputs=[network.point_xy, network.point_section, source, scale],
        outputs=[buffers.point_moved, buffers.section_moved],
        device=device,
    )
