"""Collisions: channels that come closer to each other than they are wide are joined where they touch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.channel_table import JOINT_NONE
from warpriver.device import PRECISIONS
from warpriver.engine.phase import Batch, Phase
from warpriver.engine.saved import SavedError
from warpriver.engine.scans import Scan
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.graph.edits import EditedChannels, NetworkEdit, Refusal, Rejoin
from warpriver.graph.forest import check_forest
from warpriver.graph.stems import find_stems
from warpriver.history.events import Collision, Cutoff, Event, HeldLock
from warpriver.kernels import collisions as kernels
from warpriver.kernels.channels import COARSEST_SPACING
from warpriver.kernels.status import CONTACTS, FAULT, FAULT_NONE
from warpriver.meander.avulsions import avulsion_of, carve
from warpriver.meander.deferred import defer_junction
from warpriver.meander.diversions import Diversion, divert
from warpriver.network import RiverNetwork
from warpriver.params import AvulsionParams, MeanderParams, PathMeander

__all__ = ["Collide", "collision_constants", "gathered_nodes", "join_channels"]

# Length of a block of points in the grid, in widths of its channel: long enough that few blocks are looked up, short
# enough that few blocks near each other do not touch.
BLOCK_WIDTHS = 8.0
# Rounds of joining channels that touch in one (sub-)step; contacts left after them wait for the next one.
ROUNDS = 8


def collision_constants(
    network: RiverNetwork, params: MeanderParams | PathMeander, form: np.ndarray, before: Any = None, necks: float = 0.0
) -> Any:
    """Pack the constants of the search for a network; ``None`` where there is nothing to search: rings never join.

    Args:
        network: The network.
        params: ``collision_distance``, ``junction_reach`` and ``cutoff_min_arc``.
        form: (C,) structs, as ``State.channel_form``.
        before: What holds until now; it is returned where it serves these channels as well.
        necks: Distance that counts as a touch where channels do not join, and only necks across through nodes are
            sought, in widths; 0: none are.
    """
    lines, distance = ~network.channel_closed, params.collision_distance
    if distance == 0.0 and (network.channel_joint != JOINT_NONE).any():
        distance = necks
    if distance == 0.0 or np.count_nonzero(lines) < 2:
        return None
    form = form[lines]
    constants = kernels.build(PRECISIONS[network.dtype][0]).CollisionConstants()
    constants.distance = distance
    constants.node_reach = params.junction_reach
    constants.neck_arc = params.cutoff_min_arc
    constants.block = BLOCK_WIDTHS
    width, spacing = form["widest"], COARSEST_SPACING * form["target_spacing"]
    reach = 0.5 * (distance * width + np.maximum(BLOCK_WIDTHS * width, spacing))
    reach += kernels.SLACK_SPACINGS * spacing
    # Powers of two, so that the levels of the channels do not depend on which others there are.
    base = math.floor(math.log2(reach.min()))
    if before is not None:
        base = min(base, round(math.log2(before.reach)))
    constants.reach = 2.0**base
    # What lies on the edge of a level may come to lie in either, by the rounding on the device.
    octave = np.log2(reach) - base
    levels = np.unique(np.maximum(np.ceil(np.concatenate([octave - 1e-5, octave + 1e-5])), 0.0).astype(int))
    constants.level_count = int(levels[-1]) + 1
    constants.level_mask = sum(1 << level for level in levels.tolist())
    alike = before is not None and (constants.reach, distance) == (before.reach, before.distance)
    if alike and constants.level_mask & ~before.level_mask == 0:
        return before
    return constants


def gathered_nodes(network: RiverNetwork, length: np.ndarray, params: MeanderParams | PathMeander) -> np.ndarray:
    """Label the nodes for the search, (C, 2) int32 above and below each channel: near ones count as one.

    Channels that meet at neighbouring junctions lie as close there as those that share one. Nodes that a channel of
    less than half the junction reach joins have the same label.

    Args:
        network: The network.
        length: (C,) length of its channels, m.
        params: ``junction_reach``.
    """
    with IMPORTING:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

    short = length < 0.5 * params.junction_reach * network.channel_width
    if not short.any():
        return np.stack([network.channel_from, network.channel_to], axis=1)
    ends = network.channel_from[short], network.channel_to[short]
    graph = coo_array((np.ones(int(short.sum())), ends), shape=(network.node_count, network.node_count))
    label = connected_components(graph, directed=False)[1]
    return np.stack([label[network.channel_from], label[network.channel_to]], axis=1).astype(np.int32)


class Collide(Phase):
    """Finds where channels of the network touch after a sub-step, and joins them there on the host.

    Of two channels that touch at least one must not be at rest.

    Attributes:
        nodes: (C,) vec2i, labels of the nodes above and below; see :func:`gathered_nodes`.
        rivers: (C,) int32, labels of the rivers that channels are parts of, where only those touch.
        block_bucket: Grid of the search, four integers a cell; the links of its lists and the blocks' channels are in
            the state's spare memory.
        share_contacts, share_contacts_sum: Places where channels touch, by slab or chunk; the running sum.
    """

    name = "collide"
    nodes: DeviceArray
    rivers: DeviceArray
    block_bucket: DeviceArray
    share_contacts: DeviceArray
    share_contacts_sum: DeviceArray
    scan: Scan

    def __init__(self, *, joins: bool = True, necks: float = 0.0) -> None:
        """Say what is sought.

        Args:
            joins: Whether channels join where they touch; else only the parts of one river do, across through nodes.
            necks: Then, how close they come, in widths.
        """
        self._constants: Any = None
        self._joins, self._necks = joins, necks
        self._rivers = np.zeros(0, np.int32)
        self._saved: np.ndarray | None = None
        self._nodes = np.zeros((0, 2), np.int32)

    def check_network(self, network: RiverNetwork) -> None:
        """Channels that join have one channel below them."""
        if self._joins:
            check_forest(network)

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        self.nodes = state.zeros(state.channel_capacity, wp.vec2i)
        self.block_bucket = state.zeros(4 << max(6, (state.point_capacity - 1).bit_length() - 1))
        self.share_contacts, self.share_contacts_sum = state.zeros(state.share_count), state.zeros(state.share_count)
        serial = state.chunk == 0
        self.scan = Scan("counts", self.share_contacts, self.share_contacts_sum, state.scalar, serial=serial)
        self.rivers = state.zeros(state.channel_capacity)
        if len(self._nodes):
            state.assign(self.nodes, self._nodes)
            state.assign(self.rivers, self._rivers)

    def install(self, state: State) -> None:
        """Label the nodes, and choose the cells of the search."""
        labels, self._saved = self._saved, None
        if labels is None:
            labels = gathered_nodes(state.network, state.channel_length, state.params)
        self._nodes = labels
        state.assign(self.nodes, labels)
        if not self._joins:
            self._rivers = find_stems(state.network, through_only=True).top
            state.assign(self.rivers, self._rivers)
        network, form = state.network, state.channel_form
        constants = collision_constants(network, state.params, form, self._constants, self._necks)
        if constants is not self._constants:
            self._constants = constants
            state.changed()

    def saved(self, state: State) -> dict[str, np.ndarray]:
        """The labels of nodes hold from one edit of the network to the next."""
        return {"channel_nodes": self._nodes}

    def restore(self, state: State, saved: dict[str, np.ndarray]) -> None:
        """Take up the labels of nodes."""
        if "channel_nodes" not in saved:
            raise SavedError("channel_nodes")
        self._saved = saved["channel_nodes"]

    def stages(self, state: State) -> list[Stage]:
        """Return the stages that count the places where channels touch; none where there is nothing to search."""
        constants = self._constants
        if constants is None:
            return []
        kernel, device, status = kernels.build(state.scalar), state.device, state.status.array
        channels = state.channels()

        def insert(whole: Share) -> None:
            # The channels share one table: on the CPU it is filled by one thread.
            clear(self.block_bucket)
            launch(
                kernel.insert_blocks,
                dim=whole.point_threads,
                inputs=[channels, state.network.point_xy, constants, whole.work],
                outputs=[*state.spare, self.block_bucket, status],
                device=device,
            )

        def count(_: Share) -> None:
            launch(kernel.count_contacts, dim=1, inputs=[self.share_contacts], outputs=[status], device=device)

        return [
            Stage(self.name, insert, shared=False),
            Stage(self.name, lambda share: self._search(state, share, None)),
            *([Stage(self.name, count, shared=False)] if state.chunk == 0 else []),
        ]

    def _search(self, state: State, share: Share, out: DeviceArray | None) -> None:
        index, contacts = kernels.BlockIndex(), kernels.Contacts()
        (index.point_next, index.point_owner), index.bucket = state.spare, self.block_bucket
        if not self._joins:
            index.channel_river = self.rivers
        contacts.share_count, contacts.share_sum = self.share_contacts, self.share_contacts_sum
        if out is not None:
            contacts.pair = out
        launch(
            kernels.build(state.scalar).find_contacts,
            dim=share.point_threads,
            inputs=[state.channels(), state.points(), self.nodes, self._constants, share.work, index],
            outputs=[contacts, state.status.array],
            device=state.device,
        )

    def contacts(self, state: State) -> np.ndarray:
        """Return the contacts that the stages counted, (K, 2) point indices, in the order of the points."""
        self.scan.run()
        count = int(self.share_contacts_sum[-1:].numpy()[0])
        contact = state.zeros(count, wp.vec2i)
        shares = state.slabs
        if len(shares) > 1:  # few slabs hold contacts
            shares = [shares[k] for k in np.flatnonzero(self.share_contacts.numpy())]
        for share in shares if count else []:
            self._search(state, share, contact)
        found: np.ndarray = contact.numpy()
        return found

    def after(self, state: State, batch: Batch) -> list[Event]:
        """Join the channels that touch after the (sub-)step just done, until none can be joined any more."""
        if (
            self._constants is None
            or batch.status[FAULT] != FAULT_NONE
            or not (batch.status[CONTACTS] > 0 or batch.edited)
        ):
            return []
        if batch.halted:
            # The sub-steps that were halted have emptied the table of the search.
            state.begin_batch()
        if batch.halted or batch.edited:
            state.run(self.stages(state))
        events: list[Event] = []
        for _ in range(ROUNDS):
            if state.read_status()[CONTACTS] == 0:
                break
            contacts = self.contacts(state)
            state.place_nodes()
            refused: list[Refusal] = []
            joined = join_channels(state.network, contacts, state.next_identity, refused)
            events += _held(state.network, batch.times[-1], refused)
            if joined is None:
                break
            edited, done = joined
            events += _collisions(state.network, batch.times[-1], done)
            state.adopt(edited)
            events += _deferred(state, batch.times[-1], done)
            if self._constants is None:
                break
            state.run(self.stages(state))
        return events


def _deferred(state: State, time: float, done: list[Rejoin]) -> list[Event]:
    """Lead small tributaries that have just come to a river along its belt, where that is asked for and possible."""
    shape = state.params.junctions
    if shape is None or shape.deferred == 0.0:
        return []
    events: list[Event] = []
    for edit in done:
        network = state.network
        found, mains = (np.flatnonzero(network.channel_id == name) for name in (edit.minor, edit.main))
        flow = network.channel_flow()
        river = edit.kind not in ("neck", "cutoff") and len(found) == len(mains) == 1
        if not river or flow[found[0]] >= shape.deferred * flow[mains[0]]:
            continue
        state.place_nodes()
        new = defer_junction(state, int(found[0]), state.params.avulsions or AvulsionParams())
        if isinstance(new, Diversion):
            try:
                work, line = divert(state, new)
            except InputError:  # a locked point is in the way
                continue
            events.append(avulsion_of(state, time, new, line))
            carve(state, new)
            state.adopt(work.build())
            state.hasten(np.ones(state.network.channel_count, bool))
    return events


def _held(network: RiverNetwork, time: float, refused: list[Refusal]) -> list[Event]:
    """Return what was not done because a locked point would have gone with it."""
    places = [network.node_xy[edit.node].tolist() for edit in refused]
    return [
        HeldLock(time, "cutoff" if edit.kind == "neck" else edit.kind, edit.minor, edit.main, x, y)
        for edit, (x, y) in zip(refused, places, strict=True)
    ]


def _collisions(network: RiverNetwork, time: float, done: list[Rejoin]) -> list[Event]:
    """Return what was joined, with the courses that were abandoned; necks across through nodes are cutoffs."""
    order = np.argsort(network.channel_id)
    minor = order[np.searchsorted(network.channel_id[order], [edit.minor for edit in done])]
    events: list[Event] = []
    for edit, channel in zip(done, minor.tolist(), strict=True):
        ranges = [(first, stop) for first, stop, _ in edit.abandoned]
        pieces = [network.point_xy[a:b].numpy().astype(np.float64) + network.origin for a, b in ranges]
        width, depth, flow = (
            float(values[channel])
            for values in (network.channel_width, network.channel_depth, network.channel_discharge)
        )
        sections = None
        if network.point_section is not None:
            sections = [network.point_section[a:b].numpy().astype(np.float64) for a, b in ranges]
        if edit.kind == "cutoff":
            # A piece begins where the one before it ends.
            loop, along = (None if part is None else _one_line(part) for part in (pieces, sections))
            events.append(Cutoff(time, edit.minor, width, loop, depth, flow, along))  # type: ignore[arg-type]
            continue
        start = np.cumsum([0] + [len(p) for p in pieces])
        along = None if sections is None else np.concatenate(sections)
        line = np.concatenate(pieces)
        events.append(Collision(time, edit.kind, edit.minor, edit.main, width, line, start, depth, flow, along))
    return events


def _one_line(pieces: list[np.ndarray]) -> np.ndarray:
    """Join pieces each of which begins where the one before it ends."""
    return np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])


def join_channels(
    network: RiverNetwork, contacts: np.ndarray, next_identity: int = 0, refused: list[Refusal] | None = None
) -> tuple[EditedChannels, list[Rejoin]] | None:
    """Join the channels that touch, each pair at its uppermost contact on the channel that gives way.

    Args:
        network: The network.
        contacts: (K, 2) pairs of points of different channels.
        next_identity: Least identity that a new channel may get.
        refused: Where what would have dropped a locked point is added.

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
    edit, done = NetworkEdit(network, next_identity), []
    for (a, b), (point_a, point_b) in zip(owner[first].tolist(), contacts[first].tolist(), strict=True):
        result = edit.rejoin(a, point_a, b, point_b)
        if result is not None:
            done.append(result)
    if refused is not None:
        refused += edit.refused
    if not done:
        return None
    return edit.build(), done
