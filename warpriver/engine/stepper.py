"""Stepper: does steps, phase by phase, in batches of sub-steps that are recorded and replayed, with room to grow."""

from __future__ import annotations

import contextlib
import itertools
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.crs import same_crs, short_name
from warpriver.device import PRECISIONS
from warpriver.engine.phase import Batch, Phase
from warpriver.engine.replay import GPU_LOCK, Replay
from warpriver.engine.snapshot import Snapshot
from warpriver.engine.stages import Stage
from warpriver.engine.state import MAX_BATCH, Controls, State, StepLimits
from warpriver.engine.substeps import begin_substep
from warpriver.errors import InputError, NotFiniteError, warn
from warpriver.graph.edits import EditedChannels
from warpriver.history.events import Event
from warpriver.kernels.status import (
    CONTACTS,
    DONE,
    FAULT,
    FAULT_NONE,
    FAULT_NOT_FINITE,
    POINTS,
    POINTS_NEEDED,
    STEPS,
    SUBSTEPS,
)
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain
from warpriver.validate import whole

__all__ = ["Stepper", "check_ground"]

# More points than this fraction off the terrain are told.
OFF_GROUND = 0.01
# A channel climbs if it ends so much higher than it begins, m, which is more than the noise of elevations; that is told
# if it holds for this fraction of the length.
CLIMB, CLIMBING = 5.0, 0.8


class Stepper:
    """Does the steps of a model, and keeps their events until they are taken.

    Attributes:
        state: The network on its device, with what all phases share.
        phases: The phases of a step, in order.
        batch_limit: Sub-steps at most before the host looks at them.
        threads: Greatest number of threads that a step is dealt out to.
        check: True: every phase of every step is checked.
        capture: True: steps are recorded once and replayed.
        seconds: Where the time of each phase is added up, by its name; None: a step is replayed in one piece, and not
            timed. What a phase does on the host after a batch counts as NAME + " on host".
    """

    def __init__(
        self,
        network: RiverNetwork,
        params: Any,
        terrain: Terrain | None,
        phases: Sequence[Phase],
        limits: StepLimits,
        *,
        check: bool = False,
        capture: bool = True,
        threads: int | None = None,
        seed: int = 0,
        saved: dict[str, np.ndarray] | None = None,
        controls: Controls | None = None,
    ):
        """Take a network, which the steps change.

        Args:
            network: The network, on its device.
            params: Constants of the model.
            terrain: The ground, or None.
            phases: The phases of a step, in order; the first moves the points, one of the others resamples.
            limits: (width, depth, params) -> the two limits of a sub-step, yr.
            check: Check every phase of every step, slowly.
            capture: Record steps and replay them.
            threads: Greatest number of threads on the CPU, by default one for each core that the process may use.
            seed: Seed of random numbers.
            saved: What ``State.saved`` returned at the end of a run that is resumed.
            controls: What steers points beside the ground, or None.

        Raises:
            ValueError: The network is none that the phases can deal with, or the time step is out of proportion.
        """
        self.check, self.capture = check, capture and not check
        self.threads = _thread_count(threads) if network.device.is_cpu else 1
        self._pool = ThreadPoolExecutor(self.threads - 1, "warpriver") if self.threads > 1 else None
        self.seconds: dict[str, float] | None = None
        if terrain is not None and terrain.device != network.device:
            terrain = terrain.to(network.device)
        # Steps on GPUs are taken in turn by the threads of a process.
        self._turn: Any = GPU_LOCK if network.device.is_cuda else contextlib.nullcontext()
        self.phases = tuple(phases)
        self._settling = [phase for phase in self.phases if type(phase).after is not Phase.after]
        if network.point_section is None and any(phase.varies_sections for phase in self.phases):
            network.point_section = constant_sections(network)
        self.state = State(network, params, terrain, self.phases, limits, seed, controls, capture=self.capture)
        # Rings that split are for the host at once.
        splits = network.channel_closed.any() and params.ring_policy == "both"
        alone = network.device.is_cpu or not self.capture or bool(splits)
        alone = alone or any(phase.every_substep for phase in self.phases)
        self.batch_limit = 1 if alone else MAX_BATCH
        self._calm = 0
        self._events: list[Event] = []
        self._replays: dict[int, Any] = {}
        self._edition = -1
        with self._turn:
            self._begin(saved)

    def _begin(self, saved: dict[str, np.ndarray] | None) -> None:
        """Bring the network to the even spacing, or go on from what was saved."""
        if self.state.begin(saved):
            self.state.resample_start()
        if saved is None:
            self._measure_pace()

    def _measure_pace(self) -> None:
        """Find how fast the channels' points would move, which tells in how many parts the first step is done."""
        state = self.state
        state.begin_batch()
        state.run([*begin_substep(state), *self.phases[0].stages(state)])
        state.plan_anew()

    @property
    def step_count(self) -> int:
        """Steps done."""
        return self.state.step_count

    @step_count.setter
    def step_count(self, count: int) -> None:
        self.state.step_count = count

    def stages(self) -> list[Stage]:
        """Return the stages of one sub-step, in order."""
        state = self.state
        return [*begin_substep(state), *(stage for phase in self.phases for stage in phase.stages(state))]

    def take_events(self) -> list[Event]:
        """Return what happened since the last call, in the order of time."""
        events, self._events = self._events, []
        return events

    def adopt(self, edited: EditedChannels, hastened: np.ndarray | None = None) -> None:
        """Go on with edited channels from the next step on.

        Args:
            edited: The channels after an edit of the network between two steps.
            hastened: (C,) bool, channels of which it is not known how fast they will move; none by default.
        """
        with self._turn:
            self.state.place_nodes()
            self.state.adopt(edited, between=True)
            if hastened is not None and hastened.any():
                self.state.hasten(hastened)
            self._calm = 0

    def snapshot(self) -> Snapshot:
        """Return the network as it is between two steps."""
        with self._turn:
            return self.state.snapshot()

    def put_back(self, snapshot: Snapshot) -> None:
        """Go on from the network as it was, between the same two steps."""
        with self._turn:
            self.state.put_back(snapshot)
            self._calm = 0

    def step(self, count: int = 1) -> None:
        """Do so many steps; a sub-step that did not fit into its room changed nothing and is repeated.

        Raises:
            FloatingPointError: A point is no longer finite; the state before that sub-step is kept.
        """
        with self._turn:
            self._step(self.step_count + count)

    def _step(self, goal: int) -> None:
        state = self.state
        while self.step_count < goal:
            steps = goal - self.step_count
            length = 1
            if self.batch_limit > 1:
                # Powers of two: a few recordings serve batches of any length.
                longest = max(1, min(self.batch_limit, MAX_BATCH, self._calm, steps * state.substeps))
                length = 1 << longest.bit_length() - 1
            status = self._launch(length, steps)
            if status[DONE] > 0:
                state.nodes_placed = False
                state.network.point_count = status[POINTS]
                state.substeps = status[SUBSTEPS]
            self._calm += status[DONE]
            self._settle(status)
            self.step_count += status[STEPS]
            if status[FAULT] != FAULT_NONE:
                self._make_room(status)

    def _settle(self, status: list[int]) -> None:
        """Let the phases do on the host what a batch calls for."""
        state, edits = self.state, self.state.edits
        batch = Batch(status, self.step_count, state.params.time_step)
        for phase in self._settling:
            begin = 0.0 if self.seconds is None else time.perf_counter()
            events = phase.after(state, batch)
            if events:
                self._events += events
            batch.edited = state.edits > edits
            if self.seconds is not None:
                wp.synchronize_device(state.device)
                self._add_seconds(f"{phase.name} on host", begin)
        if batch.edited or status[CONTACTS] > 0:
            self._calm = 0

    def _launch(self, count: int, steps: int) -> list[int]:
        """Run sub-steps on the device, of so many steps at most: replayed, or phase by phase when checked.

        Returns:
            The status after them.
        """
        state = self.state
        if self.capture:
            if state.edition != self._edition:
                self._replays, self._edition = {}, state.edition
            if count not in self._replays:
                stages = state.status.stages(self.stages() * count)
                self._replays[count] = self._record(stages)
            state.status.begin(steps, state.step_count)
            for name, replay in self._replays[count]:
                begin = 0.0 if self.seconds is None else time.perf_counter()
                replay.run()
                if self.seconds is not None:
                    wp.synchronize_device(state.device)
                    self._add_seconds(name, begin)
            status: list[int] = state.status.read().tolist()
            return status
        state.begin_batch(steps)
        if self.check:
            state.run(begin_substep(state))
            for phase in self.phases:
                state.run(phase.stages(state))
                if state.read_status()[FAULT] == FAULT_NONE:
                    phase.check(state)
        else:
            state.run(self.stages() * count)
        return state.read_status()

    def _record(self, stages: list[Stage]) -> list[tuple[str, Replay]]:
        """Record stages: in one piece, or phase by phase where each is timed."""
        state, groups = self.state, [("step", stages)]
        if self.seconds is not None:
            groups = [(name, list(group)) for name, group in itertools.groupby(stages, lambda stage: stage.phase)]
        work = state.whole, state.slabs, state.device
        return [(name, Replay(group, *work, self._pool, self.threads - 1)) for name, group in groups]

    def time_phases(self, seconds: dict[str, float] | None) -> None:
        """Add the time of each phase up in ``seconds`` from now on; None: no longer.

        The phases are then replayed one by one, so that one no longer finds in the cache what the one before left
        there: their sum is somewhat more than a step costs in one piece.
        """
        self.seconds = seconds
        self.state.changed()

    def _add_seconds(self, name: str, begin: float) -> None:
        assert self.seconds is not None
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin

    def _make_room(self, status: list[int]) -> None:
        """Enlarge what a sub-step found too small.

        Raises:
            FloatingPointError: That was not what is wrong.
        """
        self._calm = 0
        if status[FAULT] == FAULT_NOT_FINITE:
            raise NotFiniteError(
                f"step {self.step_count + 1}: a point is no longer finite; the state before it is kept"
            )
        if not any([phase.grow(self.state, status) for phase in self.phases]):
            self.state.make_room(status[POINTS_NEEDED])


def constant_sections(network: RiverNetwork) -> DeviceArray:
    """Return width and depth at each point of a network whose channels have the same all along, (P,) vec2."""
    section = np.repeat(np.column_stack([network.channel_width, network.channel_depth]), np.diff(network.starts()), 0)
    _, vec2, real = PRECISIONS[network.dtype]
    values: DeviceArray = wp.array(section.astype(real), dtype=vec2, device=network.device)
    return values


def _thread_count(threads: int | None) -> int:
    """Return the number of threads asked for, or that of the cores that the process may use."""
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return whole(threads, "threads", 1)


def check_ground(network: RiverNetwork, terrain: Terrain | None) -> None:
    """Raise ``ValueError`` unless the terrain lies under the network; warn of gaps, and where it rises downstream.

    Points off the terrain, or where it has no data, do not move.
    """
    if terrain is None:
        return
    if terrain.crs is not None and network.crs is not None and not same_crs(terrain.crs, network.crs):
        common = f'"{network.crs}"' if len(network.crs) < 40 else ""
        raise InputError(
            f"the terrain is in {short_name(terrain.crs)}, the network in {short_name(network.crs)}; "
            f"read both with to_crs={common}"
        )
    west, south, east, north = terrain.bounds
    xy = network.points()
    off = np.isnan(terrain.sample(xy))
    if off.all():
        raise InputError(
            f"the terrain (west {west:g}, south {south:g}, east {east:g}, north {north:g} m) does not lie under the "
            f"network (west, south, east, north {', '.join(f'{v:g}' for v in network.bounds())} m), or has no data "
            "there"
        )
    if off.sum() > OFF_GROUND * len(off):
        warn(
            f"{int(off.sum())} of {len(off)} points lie off the terrain or where it has no data, and will not move; "
            "give a terrain that covers the network, or crop the lines"
        )
    _tell_climb(network, terrain)


def _tell_climb(network: RiverNetwork, terrain: Terrain) -> None:
    """Warn of channels most of which climb on the terrain from their first to their last point."""
    xy, starts, length = network.points(), network.starts(), network.channel_lengths()
    rise = terrain.sample(xy[starts[1:] - 1]) - terrain.sample(xy[starts[:-1]])
    known = np.isfinite(rise) & ~network.channel_closed
    climbing, total = length[known & (rise > CLIMB)].sum(), length[known].sum()
    if climbing > CLIMBING * total:
        warn(
            f"{100.0 * climbing / total:.0f} % of the channels' length climbs on the terrain from the first to the "
            "last point; lines run downstream here: read them with reverse=True if they are drawn upstream"
        )
