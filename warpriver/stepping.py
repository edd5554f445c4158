"""The list of verbs that is one step, and how steps are done: recorded and replayed, in rows, with room to grow."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from warpriver.crs import short_name
from warpriver.history import Collision, Cutoff, History, Record, Split
from warpriver.kernels.polyline import (
    CONTACTS,
    CUT_POINTS,
    CUT_POINTS_NEEDED,
    CUTS,
    CUTS_NEEDED,
    DONE,
    FAULT,
    FAULT_NONE,
    FAULT_NOT_FINITE,
    FAULT_OXBOWS_FULL,
    FAULT_SHORTCUTS_FULL,
    HALT,
    PARTS,
    POINTS,
    POINTS_NEEDED,
    STATUS_SIZE,
    STEPS,
    TOUCH,
)
from warpriver.meander import checks
from warpriver.meander.buffers import (
    SUBSTEPS_IN_A_ROW,
    StepBuffers,
    StepChannels,
)
from warpriver.meander.collisions import (
    COARSEST_SPACING,
    collision_law,
    find_contacts,
    gather_points,
    gathered_nodes,
    join_channels,
    list_contacts,
)
from warpriver.meander.junctions import drift_junctions
from warpriver.meander.resampling import resample
from warpriver.meander.rings import split_rings
from warpriver.meander.schedule import begin_substep, schedule_channels
from warpriver.meander.shortcuts import PathBuffers
from warpriver.meander.smoothing import smooth
from warpriver.meander.solvers import Solver
from warpriver.meander.stages import Replay, Stage, run_stages
from warpriver.meander.topology import EditedChannels, Rejoin, check_forest
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams, PathMeander
from warpriver.terrain import Terrain

__all__ = ["Stepper", "check_ground", "check_resume"]

# Columns of what holds for a channel between edits: least width, least depth, greatest width and spacing asked for, in
# m, and the labels of the nodes above and below in the search for collisions.
NARROWEST, SHALLOWEST, WIDEST, WANTED, NODES = 0, 1, 2, 3, slice(4, 6)
# Room for points beyond those at the start: channels lengthen as they meander, and growing costs one step done twice.
HEADROOM = 1.5
# Rounds of joining channels that touch in one (sub-)step; contacts left after them wait for the next one.
COLLISION_ROUNDS = 8
# A time step that needs more sub-steps than this is taken for a mistake in its unit.
MAX_SUBSTEPS = 10_000


class Stepper:
    """A network on its device, with all that a step needs; it does steps, and notes their events in a history.

    Attributes:
        network: The network as it is now.
        params: Constants; their kind says which solver moves the channels.
        history: Gets the events of each step.
        terrain: The ground, or None for a plain.
        buffers: Scratch by point.
        channels: What a step needs of each channel.
        step_count: Steps done.
        substeps: Equal parts in which the last step was done.
        stable_dt: Longest sub-step in yr that any bend of any channel may need on flat ground.
        threads: Greatest number of threads that a step is dealt out to.
        check: True: every phase of every step is checked.
    """

    network: RiverNetwork
    params: MeanderParams | PathMeander
    history: History
    terrain: Terrain | None
    buffers: StepBuffers
    channels: StepChannels
    _solver: Solver
    _law: Any
    _fixed: np.ndarray
    _replays: dict[int, Replay]
    _collisions: Any
    _keep_plan: bool

    @property
    def device(self) -> Any:
        """The Warp device of the run."""
        return self.network.device

    def _check_network(self, network: RiverNetwork) -> None:
        looped = (network.channel_from == network.channel_to) & ~network.channel_closed
        if looped.any():
            raise ValueError(
                f"channel {int(looped.argmax())}: its ends coincide; make it a ring, RiverNetwork.from_polylines(..., "
                "closed=True), or open it"
            )
        self._solver.check(network, self.params)
        if self.params.collision_distance > 0.0 or self.params.junction_drift > 0.0:
            check_forest(network)
        if self.params.spacing_in_widths > 0.0:
            return
        narrow = [float(w.min()) for w in network.point_widths()]
        c = int(np.argmin(narrow))
        if self.params.spacing > narrow[c]:
            kind = type(self.params).__name__
            raise ValueError(
                f"spacing {self.params.spacing:g} m is coarser than channel {c} is wide ({narrow[c]:g} m): bends would "
                f"be missed; set {kind}(spacing=...) to {narrow[c]:g} or less, or spacing_in_widths=1"
            )

    def _prepare(
        self,
        network: RiverNetwork,
        *,
        seed: int,
        check: bool,
        capture: bool,
        threads: int | None,
        record: Record | None = None,
    ) -> None:
        self.seed = seed
        self.check = check
        self.threads = _thread_count(threads) if network.device.is_cpu else 1
        self._pool = ThreadPoolExecutor(self.threads - 1, "warpriver") if self.threads > 1 else None
        self.step_count = 0
        self.substeps = 0
        self._replays = {}
        self._capture = capture and not check
        # Rings that split are for the host at once.
        splits = network.channel_closed.any() and self.params.ring_policy == "both"
        alone = network.device.is_cpu or not self._capture or bool(splits)
        self._in_a_row = 1 if alone else SUBSTEPS_IN_A_ROW
        self._calm = 0
        self._keep_plan = False
        if self.terrain is not None and self.terrain.device != network.device:
            self.terrain = self.terrain.to(network.device)
        self.network = network
        self._law = self._solver.law(self.params, network.dtype)
        length = network.channel_lengths()
        fixed = self._fix_channels(length) if record is None else record.resume["channel_fixed"]
        needed = max(network.point_count, int((length / fixed[:, WANTED]).sum()))
        self.channels = StepChannels(network, _channel_room(network), mobile=self.terrain is not None)
        self._collisions = None
        self._install(fixed[:, WANTED] if record is None else record.resume["channel_spacing"], fixed)
        self._allocate(int(HEADROOM * needed) + 64, 64 + needed // 256, 1024 + needed // 4)

    def _fix_channels(self, length: np.ndarray) -> np.ndarray:
        """Return what holds for the channels until the next edit, (C, 6): ``NARROWEST`` and so on.

        Args:
            length: (C,) length of the channels, m.
        """
        network = self.network
        narrow = widest = network.channel_width
        shallow = network.channel_depth
        if network.point_section is not None:
            section = network.point_section[: network.point_count].numpy().astype(np.float64)
            first = network.starts()[:-1]
            narrow, shallow = np.minimum.reduceat(section, first, axis=0).T
            widest = np.maximum.reduceat(section[:, 0], first)
        wanted = np.full(network.channel_count, self.params.spacing)
        if self.params.spacing_in_widths > 0.0:
            wanted = np.minimum(wanted, self.params.spacing_in_widths * narrow)
        nodes = gathered_nodes(network, length, self.params)
        return np.column_stack([narrow, shallow, widest, wanted, nodes])

    def _install(
        self,
        spacing: np.ndarray,
        fixed: np.ndarray,
        *,
        pace: np.ndarray | None = None,
        parts: np.ndarray | None = None,
        mobility: np.ndarray | None = None,
    ) -> None:
        """Prepare what the step needs of the network's channels.

        Args:
            spacing: (C,) even spacing of their points, m.
            fixed: (C, 6) from :meth:`_fix_channels`.
            pace: (C,) greatest speed of their points in the time step so far, m/yr.
            parts: (C,) parts in which they do the time step.
            mobility: (C,) how the ground lets them move.
        """
        network, self._fixed = self.network, fixed
        limits = self._solver.limits(fixed[:, NARROWEST], fixed[:, SHALLOWEST], self.params)
        limit = np.column_stack([*limits, fixed[:, NARROWEST]])
        self.stable_dt = float(np.min(limit[:, :2]))
        needed = self.params.time_step / self.stable_dt
        if needed > MAX_SUBSTEPS:
            raise ValueError(
                f"a time step of {self.params.time_step:g} yr is {math.ceil(needed)} times what these channels allow "
                f"({self.stable_dt:.3g} yr); is it in years, and are the widths in metres?"
            )
        if network.channel_count > self.channels.capacity:
            before = self.channels
            self.channels = StepChannels(network, _channel_room(network), mobile=self.terrain is not None)
            self.channels.substep = before.substep
            self.channels.deal_out(network, self.buffers, anew=True)
            self._replays = {}
        form = np.column_stack([network.channel_width, network.channel_depth, fixed[:, [WIDEST, WANTED]]])
        drift = self.params.junction_drift * self._solver.rate(network.channel_width, self.params)
        self.channels.fill(
            network, form=form, spacing=spacing, limit=limit, nodes=fixed[:, NODES], drift=drift, pace=pace,
            parts=parts, mobility=mobility,
        )  # fmt: skip
        law = collision_law(network, self.params, form, self._collisions)
        if law is not self._collisions:
            self._collisions, self._replays = law, {}
        # On a plain a step that is stable for any bend needs no plan but the first.
        keep_plan = self.terrain is None and self.params.time_step <= self.stable_dt
        if self._keep_plan:
            self.channels.plan_anew()
        if self._keep_plan != keep_plan:
            self._keep_plan, self._replays = keep_plan, {}

    def _allocate(self, points: int, cuts: int, oxbow_points: int) -> None:
        """Make room for so many points, cutoffs a step and oxbow points a step; the state is kept."""
        network = self.network
        self.buffers = self._solver.buffers(network, points, cuts, oxbow_points)
        self.channels.deal_out(network, self.buffers, anew=True)
        self._replays = {}
        if points == network.point_xy.shape[0]:
            return
        for name in ("point_xy", "point_section"):
            old = getattr(network, name)
            if old is not None:
                new = wp.zeros(points, dtype=old.dtype, device=network.device)
                wp.copy(new, old, count=network.point_count)
                setattr(network, name, new)

    def _resample_start(self) -> None:
        """Bring the lines as given to the even spacing."""
        self.channels.set_step(np.ones(self.network.channel_count))
        wp.copy(self.buffers.point_moved, self.network.point_xy)
        if self.buffers.section_moved is not None and self.network.point_section is not None:
            wp.copy(self.buffers.section_moved, self.network.point_section)
        self._resample_moved()

    def _measure_pace(self) -> None:
        """Find how fast the channels' points would move, which tells in how many parts the first step is done."""
        self.buffers.begin_row()
        self._run(self._move_stages())
        self.channels.plan_anew()

    def _resample_moved(self) -> None:
        """Sample the lines in ``buffers.point_moved`` evenly, with more room if they need it."""
        network = self.network
        while True:
            buffers = self.buffers
            buffers.begin_row(steps=0)
            self._run(resample(network, self.channels, buffers))
            needed = buffers.read_status()[POINTS_NEEDED]
            if needed <= buffers.point_capacity:
                network.point_count = needed
                return
            self._allocate(int(HEADROOM * needed), buffers.cut_capacity, buffers.oxbow_capacity)
            wp.copy(self.buffers.point_moved, buffers.point_moved, count=buffers.point_capacity)
            if buffers.section_moved is not None and self.buffers.section_moved is not None:
                wp.copy(self.buffers.section_moved, buffers.section_moved, count=buffers.point_capacity)

    def _move_stages(self) -> list[Stage]:
        """What moves the points in one (sub-)step."""
        network, channels = self.network, self.channels
        return [
            *begin_substep(network, channels, self.buffers, self.terrain, self.params),
            *self._solver.move(network, channels, self.buffers, self.terrain, self._law),
        ]

    def _stages(self) -> list[Stage]:
        """The verbs of one (sub-)step, in order."""
        network, channels, buffers = self.network, self.channels, self.buffers
        return [
            *self._move_stages(),
            *smooth(network, channels, buffers, self.params),
            *drift_junctions(network, channels, buffers, self.params),
            *self._solver.cut(network, channels, buffers, self.params),
            *resample(network, channels, buffers, self._keep_plan),
            *find_contacts(network, channels, buffers, self._collisions),
        ]

    def _run(self, stages: Iterable[Stage]) -> None:
        run_stages(stages, self.channels.whole, self.channels.slabs)

    def _do_steps(self, count: int) -> None:
        """Do so many steps; a sub-step that did not fit into the buffers changed nothing and is repeated."""
        goal = self.step_count + count
        while self.step_count < goal:
            steps = goal - self.step_count
            row = max(1, min(self._in_a_row, self._calm, steps * self.substeps))
            # Powers of two: a few recordings serve rows of any length.
            status = self._launch(1 << row.bit_length() - 1, steps)
            if status[DONE] > 0:
                self.network.point_count = status[POINTS]
                self.substeps = status[PARTS]
            times = self._times_after(status)
            edited = self._collect_cutoffs(status[CUTS], status[CUT_POINTS], times)
            self._calm += status[DONE]
            if status[FAULT] == FAULT_NONE and (status[CONTACTS] > 0 or edited):
                self._resolve_collisions(times[-1], status[HALT] == TOUCH)
            self.step_count += status[STEPS]
            if status[FAULT] != FAULT_NONE:
                self._make_room(status)

    def _times_after(self, status: list[int]) -> list[float]:
        """Time in yr after each of the sub-steps of a row."""
        steps, times = self.step_count, []
        done = status[STATUS_SIZE : STATUS_SIZE + 2 * status[DONE]]
        for number, total in zip(done[::2], done[1::2], strict=True):
            times.append((steps + (number + 1) / total) * self.params.time_step)
            steps += number + 1 == total
        return times

    def _launch(self, count: int, steps: int) -> list[int]:
        """Run sub-steps on the device, of so many steps at most: replayed, or phase by phase when checked.

        Returns:
            The status after them.
        """
        buffers, channels = self.buffers, self.channels
        if self._capture:
            if count not in self._replays:
                stages = buffers.status.stages(self._stages() * count)
                self._replays[count] = Replay(stages, channels.whole, channels.slabs, self.device, self._pool)
            buffers.status.begin(steps)
            self._replays[count].run()
            return buffers.status.read().tolist()
        buffers.begin_row(steps)
        if self.check:
            for phase, group in itertools.groupby(self._stages(), lambda stage: stage.phase):
                self._run(group)
                checks.check_phase(phase, self.network, channels, buffers, self.params.junction_drift == 0.0)
        else:
            self._run(self._stages() * count)
        return buffers.read_status()

    def _make_room(self, status: list[int]) -> None:
        """Enlarge what a sub-step found too small; where a row as a whole did, the next one has all the room.

        Raises:
            FloatingPointError: That was not what is wrong.
        """
        buffers, fault, self._calm = self.buffers, status[FAULT], 0
        if fault == FAULT_NOT_FINITE:
            raise FloatingPointError(
                f"step {self.step_count + 1}: a point is no longer finite; the state before it is kept"
            )
        if fault == FAULT_SHORTCUTS_FULL:
            assert isinstance(buffers, PathBuffers)
            buffers.make_room_for_shortcuts()
            self._replays = {}
        elif fault == FAULT_OXBOWS_FULL:
            cuts, points = status[CUTS_NEEDED], status[CUT_POINTS_NEEDED]
            if cuts > buffers.cut_capacity or points > buffers.oxbow_capacity:
                cuts, points = max(buffers.cut_capacity, 2 * cuts), max(buffers.oxbow_capacity, 2 * points)
                buffers.allocate_cuts(self.network, cuts, points)
                self._replays = {}
        else:
            needed = int(HEADROOM * status[POINTS_NEEDED])
            self._allocate(needed, buffers.cut_capacity, buffers.oxbow_capacity)

    def _collect_cutoffs(self, count: int, points: int, times: list[float]) -> bool:
        """Move the cutoffs and splits of the sub-steps just done into the history; of a ring, both parts may go on.

        Args:
            count: How many there are.
            points: How many points they have.
            times: Time after each of those sub-steps, yr.

        Returns:
            Whether channels were added.
        """
        if count == 0:
            return False
        buffers, network = self.buffers, self.network
        cut = buffers.cut[:count].numpy()
        xy = buffers.oxbow_xy[:points].numpy().astype(np.float64) + network.origin
        section = None if buffers.oxbow_section is None else buffers.oxbow_section[:points].numpy()
        both = self.params.ring_policy == "both"
        split = network.channel_closed[cut[:, 0]] & both
        edited = split_rings(network, cut[split, :3], xy) if split.any() else None
        added = iter([] if edited is None else edited.channels.id[network.channel_count :].tolist())
        for k, (channel, begin, length, substep) in enumerate(cut.tolist()):
            width = float(network.channel_width[channel] if section is None else section[begin, 0])
            identity, loop = int(network.channel_id[channel]), xy[begin : begin + length]
            if split[k]:
                self.history.events.append(Split(times[substep], identity, next(added), width, loop.copy()))
            else:
                self.history.events.append(Cutoff(times[substep], identity, width, self._solver.oxbow(loop)))
        if edited is not None:
            self._adopt(edited)
            self._run(find_contacts(network, self.channels, self.buffers, self._collisions))
        return edited is not None

    def _resolve_collisions(self, time: float, halted: bool) -> None:
        """Join the channels that touch after the (sub-)step just done, until none can be joined any more.

        Args:
            time: Time after that sub-step, yr.
            halted: Whether others were to follow: halted, they have emptied the table of the search.
        """
        if self._collisions is None:
            return
        if halted:
            self.buffers.begin_row()
            self._run(find_contacts(self.network, self.channels, self.buffers, self._collisions))
        for _ in range(COLLISION_ROUNDS):
            if self.buffers.read_status()[CONTACTS] == 0:
                return
            self._calm = 0
            contacts = list_contacts(self.network, self.channels, self.buffers, self._collisions)
            self._place_nodes()
            joined = join_channels(self.network, contacts)
            if joined is None:
                return
            edited, done = joined
            self._collect_collisions(time, done)
            self._adopt(edited)
            if self._collisions is None:
                return
            self._run(find_contacts(self.network, self.channels, self.buffers, self._collisions))

    def _collect_collisions(self, time: float, done: list[Rejoin]) -> None:
        """Note what was joined in the history, with the courses that were abandoned."""
        network = self.network
        order = np.argsort(network.channel_id)
        minor = order[np.searchsorted(network.channel_id[order], [edit.minor for edit in done])]
        for edit, width in zip(done, network.channel_width[minor].tolist(), strict=True):
            ranges = [(first, stop) for first, stop, _ in edit.abandoned]
            pieces = [network.point_xy[a:b].numpy().astype(np.float64) + network.origin for a, b in ranges]
            start = np.cumsum([0] + [len(p) for p in pieces])
            self.history.events.append(
                Collision(time, edit.kind, edit.minor, edit.main, width, np.concatenate(pieces), start)
            )

    def _adopt(self, edited: EditedChannels) -> None:
        """Go on with edited channels: their points are taken over and brought to the even spacing."""
        network, buffers = self.network, self.buffers
        needed = int(edited.channel_start[-1])
        if needed > buffers.point_capacity:
            self._allocate(int(HEADROOM * needed), buffers.cut_capacity, buffers.oxbow_capacity)
        gather_points(network, edited, self.buffers, buffers)
        network.replace_channels(edited.channel_start, edited.channels, edited.node_xy)
        if network.point_section is not None and self.buffers.section_moved is not None:
            wp.copy(network.point_section, self.buffers.section_moved, count=network.point_count)
        spacing = self.channels.spacing.numpy()[edited.channel_old].astype(np.float64)
        length = spacing * (np.diff(edited.channel_start) - ~network.channel_closed)
        carried = {
            name: array.numpy()[edited.channel_old]
            for name in ("pace", "parts", "mobility")
            if (array := getattr(self.channels, name)) is not None
        }
        fixed = self._fix_channels(length)
        self._install(spacing, fixed, **carried)
        self.channels.deal_out(network, self.buffers, anew=False)
        # A channel that has become narrower may have to be sampled more finely.
        self.channels.set_step(edited.channel_changed | (spacing > COARSEST_SPACING * fixed[:, WANTED]))
        self._resample_moved()
        # The (sub-)step goes on with the new channels: any that can move at all may have come to touch another.
        start: wp.array = wp.array([0, self.substeps, 1], dtype=wp.int32, device=self.device)
        self.buffers.begin_row()
        schedule_channels(network, self.channels, self.buffers, self.params.time_step, start)

    def _resume_part(self) -> dict[str, np.ndarray]:
        """Return what a record needs beside the network, so that the next step is the same to the bit."""
        count = self.network.channel_count
        return {
            "channel_spacing": self.channels.spacing.numpy()[:count].copy(),
            "channel_fixed": self._fixed,
            "channel_pace": self.channels.pace.numpy()[:count].copy(),
        }

    def _place_nodes(self) -> None:
        """Bring the nodes to where junctions have wandered."""
        if self.params.junction_drift > 0.0:
            network, start = self.network, self.network.starts()
            xy = network.point_xy[: network.point_count].numpy()
            for node, end in ((network.channel_from, start[:-1]), (network.channel_to, start[1:] - 1)):
                network.node_xy[node] = xy[end].astype(np.float64) + network.origin


def _channel_room(network: RiverNetwork) -> int:
    """Channels to make room for: a join or the split of a ring makes one more, a loss of a whole channel one less."""
    grows = network.channel_count > 1 or network.channel_closed.any()
    return network.channel_count + max(8, network.channel_count // 8) if grows else 1


def _thread_count(threads: int | None) -> int:
    """Return the number of threads asked for, or that of the cores that the process may use."""
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if threads != int(threads) or threads < 1:
        raise ValueError(f"threads is {threads!r}; give a whole number, 1 or more")
    return int(threads)


def check_resume(record: Record) -> None:
    """Raise ``ValueError`` unless a record has what :class:`Stepper` needs to go on from it."""
    count = len(record.channels)
    # Columns that are lengths; a pace may be 0, and the label of a node -1.
    for name, shape, lengths in (
        ("channel_spacing", (count,), 1), ("channel_fixed", (count, 6), NODES.start), ("channel_pace", (count,), 0),
    ):  # fmt: skip
        array = record.resume.get(name, np.empty(0))
        fits = array.shape == shape and bool(np.isfinite(array).all())
        if not fits or (array.reshape(count, -1)[:, :lengths] <= 0.0).any():
            raise ValueError(
                f"the run cannot go on from its record of step {record.step}: {name} is missing or damaged; resume "
                "from a copy of the run"
            )


def check_ground(network: RiverNetwork, terrain: Terrain | None) -> None:
    """Raise ``ValueError`` unless the terrain lies under the network."""
    if terrain is None:
        return
    if terrain.crs is not None and network.crs is not None and terrain.crs != network.crs:
        raise ValueError(
            f"the terrain is in {short_name(terrain.crs)}, the network in {short_name(network.crs)}; "
            "read one of them with to_crs="
        )
    west, south, east, north = terrain.bounds
    xy = network.points()
    inside = (xy[:, 0] >= west) & (xy[:, 0] <= east) & (xy[:, 1] >= south) & (xy[:, 1] <= north)
    if not inside.any():
        raise ValueError(
            f"the terrain (west {west:g}, south {south:g}, east {east:g}, north {north:g} m) does not lie under the "
            f"network (west, south, east, north {', '.join(f'{v:g}' for v in network.bounds())} m)"
        )
