"""Collisions: channels that come closer to each other than they are wide are joined where they touch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.kernels import collisions as kernels
from warpriver.meander.buffers import CPU_COPY_CHUNK, StepBuffers, StepChannels
from warpriver.meander.stages import Share, Stage
from warpriver.meander.topology import EditedChannels, NetworkEdit, Rejoin
from warpriver.network import PRECISIONS, RiverNetwork
from warpriver.params import MeanderParams, PathMeander

__all__ = [
    "COARSEST_SPACING",
    "collision_law",
    "find_contacts",
    "gather_points",
    "gathered_nodes",
    "join_channels",
    "list_contacts",
]

# Length of a block of points in the grid, in widths of its channel: long enough that few blocks are looked up, short
# enough that few blocks near each other do not touch.
BLOCK_WIDTHS = 8.0
# A channel of few points may be sampled by so much more coarsely than asked for; beyond that the search may miss it.
COARSEST_SPACING = kernels.COARSEST_SPACING


def collision_law(
    network: RiverNetwork, params: MeanderParams | PathMeander, form: np.ndarray, before: Any = None
) -> Any:
    """Pack the scalars of the search for a network; ``None`` where there is nothing to search: rings never join.

    Args:
        network: The network.
        params: ``collision_distance`` and ``junction_reach``.
        form: (C, 4) as in :class:`~warpriver.meander.buffers.StepChannels`.
        before: What holds until now; it is returned where it serves these channels as well.
    """
    lines = ~network.channel_closed
    if params.collision_distance == 0.0 or np.count_nonzero(lines) < 2:
        return None
    form = form[lines]
    law = kernels.build(PRECISIONS[network.dtype][0]).CollisionLaw()
    law.distance = params.collision_distance
    law.node_reach = params.junction_reach
    law.block = BLOCK_WIDTHS
    width, spacing = form[:, 2], kernels.COARSEST_SPACING * form[:, 3]
    reach = 0.5 * (params.collision_distance * width + np.maximum(BLOCK_WIDTHS * width, spacing))
    reach += kernels.SLACK_SPACINGS * spacing
    # Powers of two, so that the levels of the channels do not depend on which others there are.
    base = math.floor(math.log2(reach.min()))
    if before is not None:
        base = min(base, round(math.log2(before.reach)))
    law.reach = 2.0**base
    # What lies on the edge of a level may come to lie in either, by the rounding on the device.
    octave = np.log2(reach) - base
    levels = np.unique(np.maximum(np.ceil(np.concatenate([octave - 1e-5, octave + 1e-5])), 0.0).astype(int))
    law.level_count = int(levels[-1]) + 1
    law.level_mask = sum(1 << level for level in levels.tolist())
    if before is not None and law.reach == before.reach and law.level_mask & ~before.level_mask == 0:
        return before
    return law


def gathered_nodes(network: RiverNetwork, length: np.ndarray, params: MeanderParams | PathMeander) -> np.ndarray:
    """Label the nodes for the search, (C, 2) int32 above and below each channel: near ones count as one.

    Channels that meet at neighbouring junctions lie as close there as those that share one. Nodes that a channel of
    less than half the junction reach joins have the same label.

    Args:
        network: The network.
        length: (C,) length of its channels, m.
        params: ``junction_reach``.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    short = length < 0.5 * params.junction_reach * network.channel_width
    ends = network.channel_from[short], network.channel_to[short]
    graph = coo_array((np.ones(int(short.sum())), ends), shape=(network.node_count, network.node_count))
    label = connected_components(graph, directed=False)[1]
    return np.stack([label[network.channel_from], label[network.channel_to]], axis=1).astype(np.int32)


def find_contacts(network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, law: Any) -> list[Stage]:
    """Return the stages that count the places where channels touch, into ``buffers.status``.

    Of two channels that touch at least one must not be at rest.

    Args:
        network: The network, its points evenly spaced.
        channels: Its channels.
        buffers: Scratch.
        law: From :func:`collision_law`; None: there is nothing to do.
    """
    if law is None:
        return []
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device

    def insert(whole: Share) -> None:
        # The channels share one table: on the CPU it is filled by one thread.
        buffers.block_bucket.zero_()
        wp.launch(
            kernel.insert_blocks,
            dim=whole.point_threads,
            inputs=[
                network.point_xy, channels.start, channels.form, channels.spacing, channels.step, channels.closed,
                law, whole.work,
            ],
            outputs=[buffers.point_next, buffers.point_neck, buffers.block_bucket, buffers.status.array],
            device=device,
        )  # fmt: skip

    def count(_: Share) -> None:
        wp.launch(
            kernel.count_contacts,
            dim=1,
            inputs=[channels.share_contacts],
            outputs=[buffers.status.array],
            device=device,
        )

    return [
        Stage("collide", insert, shared=False),
        Stage("collide", lambda share: _search(network, channels, buffers, law, share, None)),
        *([Stage("collide", count, shared=False)] if buffers.chunk == 0 else []),
    ]


def list_contacts(network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, law: Any) -> np.ndarray:
    """Return the contacts that :func:`find_contacts` counted, (K, 2) point indices, in the order of the points."""
    channels.scan_contacts.run()
    count = int(channels.share_contacts_sum[-1:].numpy()[0])
    if count == 0:
        return np.zeros((0, 2), np.int32)
    contact = wp.zeros(count, dtype=wp.vec2i, device=network.device)
    shares = channels.slabs
    if len(shares) > 1:  # few slabs hold contacts
        shares = [shares[k] for k in np.flatnonzero(channels.share_contacts.numpy())]
    for share in shares:
        _search(network, channels, buffers, law, share, contact)
    return contact.numpy()


def _search(
    network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, law: Any, share: Share, out: Any
) -> None:
    contacts = channels.share_contacts if out is None else channels.share_contacts_sum
    wp.launch(
        kernels.build(PRECISIONS[network.dtype][0]).find_contacts,
        dim=share.point_threads,
        inputs=[
            network.point_xy, network.point_section, channels.start, channels.nodes, channels.form,
            channels.spacing, channels.step, channels.closed, law, share.work, buffers.point_next,
            buffers.point_neck, buffers.block_bucket,
        ],
        outputs=[out, contacts, buffers.status.array],
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
    # The largest rivers first: what they take cannot be taken by a smaller one.
    flow = network.channel_flow()[owner]
    on_minor = np.where(flow[:, 1] < flow[:, 0], contacts[:, 1], contacts[:, 0])
    order = np.lexsort((contacts[:, 0], on_minor, -flow.min(axis=1), -flow.max(axis=1)))
    pair = owner[order].min(axis=1) * np.int64(network.channel_count) + owner[order].max(axis=1)
    first = order[np.sort(np.unique(pair, return_index=True)[1])]
    edit, done = NetworkEdit(network), []
    for (a, b), (point_a, point_b) in zip(owner[first].tolist(), contacts[first].tolist(), strict=True):
        result = edit.rejoin(a, point_a, b, point_b)
        if result is not None:
            done.append(result)
    if not done:
        return None
    return edit.build(), done


def gather_points(
    network: RiverNetwork, edited: EditedChannels, buffers: StepBuffers, source: StepBuffers | None = None
) -> None:
    """Bring the points of a network into the order of its edited channels, in ``buffers.point_moved``.

    Args:
        network: The network as it was.
        edited: Its channels after the edits.
        buffers: Where the points go.
        source: Buffers that hold the loops of the step, which ``edited`` may take over; by default the same.
    """
    kernel, device = kernels.build(PRECISIONS[network.dtype][0]), network.device
    _, vec2, real = PRECISIONS[network.dtype]
    begin: wp.array = wp.array(edited.run_begin.astype(np.int32), dtype=wp.int32, device=device)
    start: wp.array = wp.array(edited.run_start.astype(np.int32), dtype=wp.int32, device=device)
    scale: wp.array | None = None
    if edited.run_scale is not None:
        scale = wp.array(edited.run_scale.astype(real), dtype=vec2, device=device)
    chunk = buffers.chunk or CPU_COPY_CHUNK
    wp.launch(
        kernel.gather_runs,
        dim=math.ceil(int(edited.run_start[-1]) / chunk),
        inputs=[network.point_xy, network.point_section, chunk, begin, start, scale],
        outputs=[buffers.point_moved, buffers.section_moved],
        device=device,
    )
    filled, loops = int(edited.run_start[-1]), buffers if source is None else source
    for first, count in edited.loops:
        wp.copy(buffers.point_moved, loops.oxbow_xy, filled, first, count)
        if buffers.section_moved is not None and loops.oxbow_section is not None:
            wp.copy(buffers.section_moved, loops.oxbow_section, filled, first, count)
        filled += count
