"""State: a network on its device in the middle of a step, and what all phases of the step share."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.device import PRECISIONS, available_memory
from warpriver.engine.batch_status import MAX_BATCH, Status
from warpriver.engine.checks import require
from warpriver.engine.replay import Replay
from warpriver.engine.snapshot import Snapshot
from warpriver.engine.stages import CUDA_CHUNK, Share, Stage, launch, put, run_stages
from warpriver.engine.stems import MapEdges, StemArrays, find_map_edges
from warpriver.errors import InputError, OutOfMemoryError
from warpriver.graph.edits import EditedChannels
from warpriver.kernels import channels, runs, schedule
from warpriver.kernels import ground as grounds
from warpriver.kernels.channels import COARSEST_SPACING, Work
from warpriver.kernels.status import POINTS_NEEDED, SUBSTEP_SIZE
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain

__all__ = ["CPU_COPY_CHUNK", "MAX_BATCH", "Controls", "Member", "State", "Status", "arrays_of"]

# Consecutive points that a thread takes on the CPU; 0: slabs of whole channels.
CPU_CHUNK = 0
# What a channel keeps through an edit of the network: how fast it moved, and the sub-steps planned by that.
CARRIED = ("max_speed", "channel_substeps", "mobility")
# Points of a slab on the CPU at most (of more than one channel): what a phase leaves of so many points is still in the
# cache when the next one reads it.
SLAB_POINTS = 16_384
# Points of a chunk where a thread copies runs of points.
CPU_COPY_CHUNK = 4096
# Room for points beyond those at the start: channels lengthen as they meander, and growing costs one step done twice.
HEADROOM = 1.5
# Points are numbered by 32 bits; and what each takes at least on the device, for a word before nothing fits.
MAX_POINTS, BYTES_PER_POINT = 2**31 - 1, 64
# A time step that needs more sub-steps than this is taken for a mistake in its unit.
MAX_SUBSTEPS = 10_000
# Columns of what holds for a channel between edits: minimum width, minimum depth, maximum width and target spacing, m.
NARROWEST, SHALLOWEST, WIDEST, WANTED = range(4)
# Limits of a sub-step by width, depth and constants, yr; see ``migration.step_limits``.
StepLimits = Callable[[Any, Any, Any], tuple[Any, Any]]


class Controls(Protocol):
    """What the state asks of the controls that steer points; see :class:`warpriver.meander.control_map.ControlMap`."""

    def steering(self, params: Any, dtype: str, origin: Sequence[float] | np.ndarray) -> Any:
        """Return the struct ``Steering`` of ``kernels/ground.py``."""
        ...


class Member(Protocol):
    """What the state asks of each phase that shares it; see :class:`warpriver.engine.phase.Phase`."""

    name: str
    moves_nodes: bool
    follows_stems: bool
    follows_through: bool
    widening: float

    def allocate(self, state: State) -> None:
        """Make the device arrays."""

    def install(self, state: State) -> None:
        """Take the channels of the network."""

    def stages(self, state: State) -> list[Stage]:
        """Return what is launched in a sub-step."""
        ...

    def saved(self, state: State) -> dict[str, np.ndarray]:
        """Return what a record needs."""
        ...

    def restore(self, state: State, saved: dict[str, np.ndarray]) -> None:
        """Take up what ``saved`` returned."""


class State:
    """A network on its device, with what all phases of a step share: the points on their way, channels, shares of work.

    Beyond the network's channels there are empty ones, without points, which always rest: so the arrays, and with them
    a recorded step, outlast edits of the network.

    Attributes:
        network: The network as it is now.
        params: Constants of the model.
        terrain: The ground on the network's device, or None for a plain.
        controls: What steers points beside the ground, or None; others are set by ``steer``.
        phases: All phases of a step, in order.
        seed: Seed of the random numbers of phases that draw any.
        edition: Grows whenever stages made before are out of date, because arrays or constants have changed.
        step_count: Whole steps done, up to the last batch.
        edits: Edits of the network so far.
        next_identity: Least identity that a new channel may get: none that a channel of the run ever had.
        channel_length: (C,) length of the channels at the last edit, m.
        stable_dt: Longest sub-step in yr that any bend of any channel may need on flat ground.
        substeps: Equal sub-steps in which the last step was done.
        status: How the sub-steps went.
        point_capacity, channel_capacity: Room for points and channels.
        chunk: Points that a thread takes, 0 where it takes whole channels.
        share_count: Number of chunks, or of the slabs of whole channels.
        slabs: Shares of the work that can be done one after the other or at once; ``whole``: all of it as one share.
        point_moved: (P,) vec2, points on their way through a sub-step, m.
        section_moved: (P,) vec2, width and depth that go with ``point_moved``, or None where they are constant.
        spare: Two (P,) int32 arrays that a phase may use from one of its stages to the next, and no longer.
        start: (C + 1,) offsets of the channels' points; the network's ``channel_start`` is a view of it.
        form: (C,) ``Form`` of ``kernels/channels.py``: mean width, mean depth, greatest width and target spacing, m.
        spacing: (C,) even spacing of the points, m.
        limits: (C,) ``Limits`` of ``kernels/schedule.py``: the two limits of a sub-step, yr, and the smallest width, m.
        closed: (C,) int32, 1 for a ring; None where the network has none, as it never gets one then.
        area: (C,) int64, what each ring encloses, see the kernel ``measure_rings``; None without rings.
        stems: Which channels go on from each other as one river; None where no phase follows stems.
        mobility: (C,) greatest factor by which ground and controls let a point of the channel move, or None on a plain
            without controls.
        max_speed: (C,) greatest speed of a point in the time step so far, m/yr; ``max_speed_bits``: the same memory as
            integers, as ``mobility_bits`` is that of ``mobility``.
        channel_substeps: (C,) int32, equal sub-steps in which a channel does a time step; 0 where it does not move.
        step: (C,) time step in this sub-step, yr; 0 where the channel is inactive.
        substep: three int32, sub-steps done, how many there are, 1 once that is settled; ``max_substeps``: one
            int32, the greatest number that a channel needs.
        nodes_placed: Whether the nodes are where the ends of channels are; see ``place_nodes``.
        keep_plan: Whether the sub-steps in which channels do a step hold for the next one, too.
    """

    status: Status
    whole: Share
    slabs: list[Share]
    start: DeviceArray
    _fixed: np.ndarray
    _slab_channel: DeviceArray

    def __init__(
        self,
        network: RiverNetwork,
        params: Any,
        terrain: Terrain | None,
        phases: Sequence[Member],
        limits: StepLimits,
        seed: int = 0,
        controls: Controls | None = None,
        *,
        capture: bool = True,
    ):
        """Allocate for a network, and take its channels.

        Args:
            network: The network; it is changed by the steps.
            params: Constants of the model.
            terrain: The ground on the network's device, or None.
            phases: All phases of a step, in order; one of them resamples, see ``resample``.
            limits: (width, depth, params) -> the two limits of a sub-step, yr.
            seed: Seed of random numbers.
            controls: What steers points beside the ground, or None.
            capture: Record what is done again and again, and replay it.
        """
        self.seed = seed
        self.network, self.params, self.terrain, self.phases = network, params, terrain, tuple(phases)
        self.controls = controls
        self.step_count = 0
        self._limits = limits
        self.edition = self.edits = self.substeps = self.point_capacity = self.channel_capacity = 0
        self.keep_plan, self.nodes_placed = False, True
        self.capture = capture
        # The edition in which lines were sampled anew last, and the record of that once it is made.
        self._resampling: tuple[int, Replay | None] | None = None
        self.status = Status(network.device)
        self.substep = wp.zeros(SUBSTEP_SIZE, dtype=wp.int32, device=network.device)
        self.max_substeps = wp.zeros(1, dtype=wp.int32, device=network.device)

    @property
    def device(self) -> Any:
        """The Warp device."""
        return self.network.device

    @property
    def scalar(self) -> Any:
        """Warp's type of a real number."""
        return PRECISIONS[self.network.dtype][0]

    @property
    def vec2(self) -> Any:
        """Warp's type of a point."""
        return PRECISIONS[self.network.dtype][1]

    def zeros(self, count: int, dtype: Any = wp.int32) -> DeviceArray:
        """Return an array of zeros on the device."""
        return wp.zeros(count, dtype=dtype, device=self.device)

    def changed(self) -> None:
        """Tell that stages made before are out of date."""
        self.edition += 1

    # ---- room

    def begin(self, saved: dict[str, np.ndarray] | None = None) -> bool:
        """Allocate and take the network's channels as they are.

        Args:
            saved: What ``saved`` returned at the end of a run that is resumed; else the spacing is the target.

        Returns:
            Whether the lines have yet to be brought to their target spacing.
        """
        network = self.network
        length = network.channel_lengths()
        if saved is None:
            fixed, respaced = self._fix_channels(), True
        else:
            fixed = saved["channel_fixed"].copy()
            # Not the target that was saved: the constants may have changed.
            fixed[:, WANTED] = self._target_spacing(fixed[:, NARROWEST])
            respaced = not np.array_equal(fixed, saved["channel_fixed"])
        needed = max(network.point_count, _checked_count(float((length / fixed[:, WANTED]).sum()), self.device))
        self.channel_length = length
        self.next_identity = int(network.channel_id.max()) + 1
        if saved is not None:
            self.next_identity = int(saved["next_identity"][0])
            for phase in self.phases:
                phase.restore(self, saved)
        self._allocate_channels()
        self.allocate_points(int(HEADROOM * needed) + 64)
        self._install(fixed[:, WANTED] if saved is None else saved["channel_spacing"], fixed)
        self.plan_anew()
        if saved is not None:
            self.assign(self.max_speed, saved["channel_max_speed"])
        return respaced

    def make_room(self, points: int) -> None:
        """Make room for so many points, and for those to come; the network and ``point_moved`` are kept."""
        moved, section = self.point_moved, self.section_moved
        self.allocate_points(int(HEADROOM * points))
        wp.copy(self.point_moved, moved, count=len(moved))
        if section is not None and self.section_moved is not None:
            wp.copy(self.section_moved, section, count=len(section))

    def allocate_points(self, points: int) -> None:
        """Make room for just so many points, at least those of the network; what was on its way is lost."""
        network = self.network
        self.point_capacity = points
        self.chunk = CPU_CHUNK if self.device.is_cpu else CUDA_CHUNK
        self.chunk_count = math.ceil(points / self.chunk) if self.chunk else 1
        self.share_count = self.chunk_count if self.chunk else math.ceil(points / SLAB_POINTS)
        self.point_moved = self.zeros(points, self.vec2)
        self.section_moved = None if network.point_section is None else self.zeros(points, self.vec2)
        self.spare = self.zeros(points), self.zeros(points)
        for name in ("point_xy", "point_section"):
            old = getattr(network, name)
            if old is not None and len(old) != points:
                new = self.zeros(points, old.dtype)
                wp.copy(new, old, count=network.point_count)
                setattr(network, name, new)
        self._make_shares()
        self._deal_out()
        for phase in self.phases:
            phase.allocate(self)
        self.changed()

    def _allocate_channels(self) -> None:
        network = self.network
        # A join or the split of a ring makes one more, a loss of a whole channel one less.
        grows = network.channel_count > 1 or network.channel_closed.any()
        count = network.channel_count + max(8, network.channel_count // 8) if grows else 1
        scalar, zeros = self.scalar, self.zeros
        self.channel_capacity = count
        self.start = zeros(count + 1)
        self.form = zeros(count, channels.build(scalar).Form)
        self.limits = zeros(count, schedule.build(scalar).Limits)
        self.spacing, self.max_speed, self.step = zeros(count, scalar), zeros(count, scalar), zeros(count, scalar)
        self.channel_substeps = zeros(count)
        self._allocate_mobility()
        ringed = network.channel_closed.any()
        follows = any(phase.follows_stems for phase in self.phases)
        through = any(phase.follows_through for phase in self.phases)
        self.stems = StemArrays(count, self.device, through_only=not follows) if follows or through else None
        self.closed, self.area = (zeros(count, kind) if ringed else None for kind in (wp.int32, wp.int64))
        self.max_speed_bits = _bits(self.max_speed)

    @property
    def kernel_seed(self) -> int:
        """The seed in the 31 bits that kernels take."""
        return (self.seed ^ (self.seed >> 31)) & 0x7FFFFFFF

    @functools.cached_property
    def map_edges(self) -> MapEdges | None:
        """Where the map ends; None on a plain. Edits of the ground leave cells without data as they are."""
        return find_map_edges(self.terrain)

    def _allocate_mobility(self) -> None:
        """Make room for the mobilities, where any point may be less or more free than others."""
        self.mobility = self.zeros(self.channel_capacity, self.scalar) if self.is_uneven else None
        self.mobility_bits = None if self.mobility is None else _bits(self.mobility)

    @property
    def is_uneven(self) -> bool:
        """Whether there is ground, or are controls, by which points differ in how they may move."""
        return self.terrain is not None or self.controls is not None

    def steer(self, controls: Controls | None) -> None:
        """Let other controls steer the points from the next step on; None: none do.

        Stages have to be made anew only for this: what is stamped into the arrays of the same controls is read as it
        is.
        """
        self.controls = controls
        self._allocate_mobility()
        self._keep_plan()
        self.plan_anew()
        self.changed()

    def hasten_by(self, factor: np.ndarray) -> None:
        """Plan the next step for points that move faster than in the last one, by a factor for each channel, (C,)."""
        if (factor != 1.0).any():
            max_speed = self.max_speed.numpy()
            max_speed[: len(factor)] *= factor
            self.max_speed.assign(max_speed)

    def _make_shares(self) -> None:
        """Divide the work in slabs of whole channels on the CPU, in chunks of points on a GPU."""
        by_slab, threads = self.chunk == 0, self.share_count
        self._slab_channel = self.zeros(threads + 1 if by_slab else 1)
        work = Work()
        work.status, work.slab_channel = self.status.array, self._slab_channel
        work.chunk, work.first = self.chunk, 0
        self.whole = Share(work, threads, threads if by_slab else self.channel_capacity)
        self.slabs = [self.whole.slab(k) for k in range(threads)] if by_slab and threads > 1 else [self.whole]

    def _deal_out(self) -> None:
        """Deal the network's channels out to the slabs."""
        if self.chunk == 0:
            # All slabs get a like number of points, so that threads that take as many slabs have as much to do.
            start, threads = self.network.starts().astype(np.int64), self.share_count
            first = np.unique(start[:-1] * threads // start[-1], return_index=True)[1]
            table = np.full(threads + 1, self.network.channel_count, np.int32)
            table[: len(first)] = first
            put(self._slab_channel, table)

    # ---- channels

    def _fix_channels(self) -> np.ndarray:
        """Return what holds for the channels until the next edit, (C, 4): ``NARROWEST`` and so on."""
        network = self.network
        narrow = widest = network.channel_width
        shallow = network.channel_depth
        if network.point_section is not None:
            section = network.point_section[: network.point_count].numpy().astype(np.float64)
            first = network.starts()[:-1]
            narrow, shallow = np.minimum.reduceat(section, first, axis=0).T
            widest = np.maximum.reduceat(section[:, 0], first)
        widening = max(phase.widening for phase in self.phases)
        if widening > 1.0:
            widest = np.maximum(widest, widening * network.channel_width)
        return np.column_stack([narrow, shallow, widest, self._target_spacing(narrow)])

    def _target_spacing(self, narrowest: np.ndarray) -> np.ndarray:
        """Return the target spacing in m of channels of these minimum widths."""
        target = np.full(len(narrowest), self.params.spacing)
        if self.params.spacing_in_widths > 0.0:
            target = np.minimum(target, self.params.spacing_in_widths * narrowest)
        return target

    def _install(self, spacing: np.ndarray, fixed: np.ndarray, carried: dict[str, np.ndarray] | None = None) -> None:
        """Take the network's channels.

        Args:
            spacing: (C,) even spacing of their points, m.
            fixed: (C, 4) from :meth:`_fix_channels`.
            carried: (C,) arrays of ``max_speed``, ``channel_substeps`` and ``mobility`` from before an edit; else they
                begin at 0.
        """
        network, self._fixed, carried = self.network, fixed, carried or {}
        travel, growth = self._limits(fixed[:, NARROWEST], fixed[:, SHALLOWEST], self.params)
        limits = _columns(travel=travel, growth=growth, width=fixed[:, NARROWEST])
        self.stable_dt = float(np.minimum(travel, growth).min())
        needed = self.params.time_step / self.stable_dt
        if needed > MAX_SUBSTEPS:
            raise InputError(
                f"a time step of {self.params.time_step:g} yr is {math.ceil(needed)} times what these channels allow "
                f"({self.stable_dt:.3g} yr); is it in years, and are the widths in metres?"
            )
        if network.channel_count > self.channel_capacity:
            self._allocate_channels()
            self._make_shares()
            for phase in self.phases:
                phase.allocate(self)
            self.changed()
        start = network.starts()
        put(self.start, np.concatenate([start, np.full(len(self.start) - len(start), start[-1], np.int32)]))
        network.channel_start = self.start[: network.channel_count + 1]
        if self.stems is not None:
            if self.stems.take(network, self.map_edges):
                self.changed()
            if "channel_substeps" in carried:
                carried["channel_substeps"] = self.stems.level(carried["channel_substeps"])
        for array, values in (
            (self.form, self.channel_form), (self.spacing, spacing), (self.limits, limits),
            (self.closed, network.channel_closed.astype(np.int32)), (self.step, np.zeros(0)),
            *((getattr(self, name), carried.get(name, np.zeros(0))) for name in CARRIED),
        ):  # fmt: skip
            if array is not None:
                self.assign(array, values)
        self._deal_out()
        for phase in self.phases:
            phase.install(self)
        if self.keep_plan:
            self.plan_anew()
        self._keep_plan()

    def _keep_plan(self) -> None:
        """Note whether a plan lasts: on a plain a step that is stable for any bend needs none but the first."""
        keep_plan = not self.is_uneven and self.params.time_step <= self.stable_dt
        if self.keep_plan != keep_plan:
            self.keep_plan = keep_plan
            self.changed()

    @property
    def channel_form(self) -> np.ndarray:
        """(C,) ``Form`` of the network's channels, in float64, with its members as named columns."""
        width, depth, fixed = self.network.channel_width, self.network.channel_depth, self._fixed
        return _columns(width=width, depth=depth, widest=fixed[:, WIDEST], target_spacing=fixed[:, WANTED])

    def plan_anew(self) -> None:
        """Let the next sub-step begin a step, and the step be planned."""
        put(self.substep, np.array([0, 1, 0], np.int32))

    def assign(self, array: DeviceArray, values: np.ndarray) -> None:
        """Copy a host array to the beginning of a device array, and fill the rest with 0."""
        kind: Any = array.dtype
        host = np.zeros(
            array.shape + values.shape[1:], kind.numpy_dtype() if hasattr(kind, "numpy_dtype") else values.dtype
        )
        host[: len(values)] = values
        put(array, host)

    # ---- as kernels take it, of the arrays as they are now: not to be kept beyond ``edition``

    def channels(self) -> Any:
        """Return the channels."""
        struct = channels.build(self.scalar).Channels()
        struct.start, struct.form, struct.spacing, struct.step = self.start, self.form, self.spacing, self.step
        if self.closed is not None:
            struct.closed, struct.area = self.closed, self.area
        if self.stems is not None:
            self.stems.give(struct)
        return struct

    def points(self) -> Any:
        """Return the points of the network."""
        return self._points(self.network.point_xy, self.network.point_section)

    def moved(self) -> Any:
        """Return the points on their way."""
        return self._points(self.point_moved, self.section_moved)

    def _points(self, xy: DeviceArray, section: DeviceArray | None) -> Any:
        struct = channels.build(self.scalar).Points()
        struct.xy = xy
        if section is not None:
            struct.section = section
        return struct

    def ground(self) -> Any:
        """Return the ground with what steers points on it; without heights where there is no terrain."""
        struct = grounds.build(self.scalar).Ground()
        if self.controls is not None:
            struct.steering = self.controls.steering(self.params, self.network.dtype, self.network.origin)
        if self.terrain is not None:
            struct.height = self.terrain.height
            struct.grid = self.terrain.grid(self.network.dtype, self.network.origin)
        return struct

    # ---- running

    def run(self, stages: Iterable[Stage]) -> None:
        """Run stages."""
        run_stages(stages, self.whole, self.slabs)

    def begin_batch(self, steps: int = 1, begun: int | None = None) -> None:
        """Set ``status`` to nothing done, nothing wrong, and that many steps to do; 0: points are sampled anew.

        Args:
            steps: Steps to do.
            begun: Steps done before, by default ``step_count``.
        """
        self.status.begin(steps, self.step_count if begun is None else begun)
        self.status.send()

    def read_status(self) -> list[int]:
        """Return ``status`` as it is now on the device."""
        self.status.fetch()
        status: list[int] = self.status.read().tolist()
        return status

    def schedule(
        self, substep: DeviceArray, max_substeps: DeviceArray | None = None, max_speed: DeviceArray | None = None
    ) -> None:
        """Set the time step of every channel in a sub-step, ``step``, 0 where it is inactive; not while halted.

        Args:
            substep: Three int32: the number of the sub-step, how many there are, 1 where that is settled.
            max_substeps: ``self.max_substeps``, how many the first sub-step of a step finds that there are; or None.
            max_speed: ``self.max_speed``, to be cleared in the first sub-step.
        """
        launch(
            schedule.build(self.scalar).schedule_channels,
            dim=self.channel_capacity,
            inputs=[self.channel_substeps, self.params.time_step, max_substeps],
            outputs=[self.step, max_speed, substep, self.status.array],
            device=self.device,
        )

    def resample(self) -> None:
        """Sample the lines in ``point_moved`` evenly, outside of any step, with more room if they need it."""
        while True:
            self.begin_batch(steps=0)
            self._run_resampling()
            needed = self.read_status()[POINTS_NEEDED]
            if needed <= self.point_capacity:
                self.network.point_count = needed
                return
            self.make_room(needed)

    def _run_resampling(self) -> None:
        """Run the stages that resample; those of many edits are recorded once, where the device allows."""
        if self._resampling is not None and self._resampling[0] == self.edition:
            replay = self._resampling[1]
            if replay is None:
                replay = Replay(self._resampling_stages(), self.whole, self.slabs, self.device)
                self._resampling = self.edition, replay
            replay.run()
            return
        self.run(self._resampling_stages())
        self._resampling = (self.edition, None) if self.capture else None

    def _resampling_stages(self) -> list[Stage]:
        return [stage for phase in self.phases if phase.name == "resample" for stage in phase.stages(self)]

    def resample_start(self) -> None:
        """Bring the network's lines as given to the even spacing."""
        self.assign(self.step, np.ones(self.network.channel_count))
        wp.copy(self.point_moved, self.network.point_xy)
        if self.section_moved is not None and self.network.point_section is not None:
            wp.copy(self.section_moved, self.network.point_section)
        self.resample()

    def adopt(
        self,
        edited: EditedChannels,
        loops: DeviceArray | None = None,
        loop_sections: DeviceArray | None = None,
        *,
        between: bool = False,
    ) -> None:
        """Go on with edited channels: their points are taken over and brought to the even spacing.

        Args:
            edited: The channels after an edit of the network.
            loops: Points that ``edited.loops`` are cut from, where it has any.
            loop_sections: Widths and depths that go with them, where they vary.
            between: Whether this is between two steps: the next one is planned anew.
        """
        network = self.network
        self.edits += 1
        drawn = 0 if edited.drawn_xy is None else len(edited.drawn_xy)
        needed = max(int(edited.channel_start[-1]), network.point_count + drawn)
        if needed > self.point_capacity:
            self.allocate_points(int(HEADROOM * needed))
        self._take_drawn(edited)
        self._gather(edited, loops, loop_sections)
        network.replace_channels(edited.channel_start, edited.channels, edited.node_xy)
        self.next_identity = max(self.next_identity, int(edited.channels.id.max()) + 1)
        if network.point_section is not None and self.section_moved is not None:
            wp.copy(network.point_section, self.section_moved, count=network.point_count)
        spacing = self.spacing.numpy()[edited.channel_old].astype(np.float64)
        self.channel_length = spacing * (np.diff(edited.channel_start) - ~network.channel_closed)
        carried = {
            name: array.numpy()[edited.channel_old] for name in CARRIED if (array := getattr(self, name)) is not None
        }
        fixed = self._fix_channels()
        self._install(spacing, fixed, carried)
        # A channel that has become narrower may have to be sampled more finely.
        self.assign(self.step, edited.channel_changed | (spacing > COARSEST_SPACING * fixed[:, WANTED]))
        self.resample()
        if between:
            self.plan_anew()
            return
        # The (sub-)step goes on with the new channels: any that can move at all may have come to touch another.
        self.begin_batch()
        go_on: DeviceArray = wp.array([0, self.substeps, 1], dtype=wp.int32, device=self.device)
        self.schedule(go_on)

    def _take_drawn(self, edited: EditedChannels) -> None:
        """Put points that were drawn behind those of the network, from where the runs take them."""
        network, real = self.network, PRECISIONS[self.network.dtype][2]
        relative = None if edited.drawn_xy is None else edited.drawn_xy - network.origin
        for array, values in ((network.point_xy, relative), (network.point_section, edited.drawn_section)):
            if array is not None and values is not None and len(values):
                new: DeviceArray = wp.array(values.astype(real), dtype=self.vec2, device=self.device)
                wp.copy(array, new, network.point_count, 0, len(values))

    def _gather(self, edited: EditedChannels, loops: DeviceArray | None, loop_sections: DeviceArray | None) -> None:
        """Bring the points of the network into the order of its edited channels, in ``point_moved``."""
        network, device = self.network, self.device
        real = PRECISIONS[network.dtype][2]
        begin: DeviceArray = wp.array(edited.run_begin.astype(np.int32), dtype=wp.int32, device=device)
        start: DeviceArray = wp.array(edited.run_start.astype(np.int32), dtype=wp.int32, device=device)
        scale: DeviceArray | None = None
        if edited.run_scale is not None:
            scale = wp.array(edited.run_scale.astype(real), dtype=self.vec2, device=device)
        chunk, filled = self.chunk or CPU_COPY_CHUNK, int(edited.run_start[-1])
        launch(
            runs.build(self.scalar).gather_runs,
            dim=math.ceil(filled / chunk),
            inputs=[self.points(), chunk, begin, start, scale],
            outputs=[self.moved()],
            device=device,
        )
        for first, count in edited.loops:
            assert loops is not None
            wp.copy(self.point_moved, loops, filled, first, count)
            if self.section_moved is not None and loop_sections is not None:
                wp.copy(self.section_moved, loop_sections, filled, first, count)
            filled += count

    @property
    def nodes_move(self) -> bool:
        """Whether any phase moves the ends of channels."""
        return any(phase.moves_nodes for phase in self.phases)

    def place_nodes(self) -> None:
        """Bring the nodes to where the ends of channels have moved, if any phase moves them and a sub-step was done."""
        if self.nodes_placed or not self.nodes_move:
            return
        network, start = self.network, self.network.starts()
        ends = np.concatenate([start[:-1], start[1:] - 1]).astype(np.int32)
        xy = network.point_xy[wp.array(ends, dtype=wp.int32, device=self.device)].numpy()
        nodes = np.concatenate([network.channel_from, network.channel_to])
        node_xy = network.node_xy.copy()
        node_xy[nodes] = xy.astype(np.float64) + network.origin
        network.place_nodes(node_xy)
        self.nodes_placed = True

    def snapshot(self) -> Snapshot:
        """Return the network as it is between two steps, to be put back by :meth:`put_back`."""
        self.place_nodes()
        network, count = self.network, self.network.point_count
        section = None if network.point_section is None else network.point_section[:count].numpy().copy()
        return Snapshot(
            point_xy=network.point_xy[:count].numpy().copy(),
            point_section=section,
            channel_start=network.starts(),
            channels=network.channels,
            node_xy=network.node_xy,
            channel_length=self.channel_length,
            saved=self.saved(),
        )

    def put_back(self, snapshot: Snapshot) -> None:
        """Go on from a network as it was between two steps, to the bit; there is room for it."""
        network, saved = self.network, snapshot.saved
        network.replace_channels(snapshot.channel_start, snapshot.channels, snapshot.node_xy)
        for array, values in (
            (network.point_xy, snapshot.point_xy),
            (network.point_section, snapshot.point_section),
        ):
            if array is not None and values is not None:
                old: DeviceArray = wp.array(values, dtype=self.vec2, device=self.device)
                wp.copy(array, old, 0, 0, len(values))
        self.next_identity, self.channel_length = int(saved["next_identity"][0]), snapshot.channel_length
        self.nodes_placed = True
        for phase in self.phases:
            phase.restore(self, saved)
        self._install(saved["channel_spacing"], saved["channel_fixed"])
        self.assign(self.max_speed, saved["channel_max_speed"])
        self.plan_anew()

    def hasten(self, channels: np.ndarray) -> None:
        """Let the next step of channels be done in as many sub-steps as their tightest bends may need.

        How fast they move was measured before they had the course that they have now.

        Args:
            channels: (C,) bool.
        """
        max_speed, fixed = self.max_speed.numpy().copy(), self._fixed[channels]
        travel, _ = self._limits(fixed[:, NARROWEST], fixed[:, SHALLOWEST], self.params)
        max_speed[: len(channels)][channels] = np.minimum(fixed[:, NARROWEST] / travel, np.finfo(max_speed.dtype).max)
        put(self.max_speed, max_speed)

    # ---- records and checks

    def saved(self) -> dict[str, np.ndarray]:
        """Return what a record needs beside the network, so that the next step is the same to the bit."""
        count = self.network.channel_count
        own = {
            "channel_spacing": self.spacing.numpy()[:count].copy(),
            "channel_fixed": self._fixed,
            "channel_max_speed": self.max_speed.numpy()[:count].copy(),
            "next_identity": np.array([self.next_identity]),
        }
        for phase in self.phases:
            own |= phase.saved(self)
        return own

    def check_moved(self, phase: str, anchored: bool | np.ndarray) -> None:
        """Raise ``PhaseError`` unless ``point_moved`` is finite and all ends that are anchored are in place.

        Args:
            phase: Name of the verb of the step.
            anchored: Whether all ends are, or (C,) bool: all heads, and these feet.
        """
        network, start = self.network, self.network.starts()
        moved, before = (a[: start[-1]].numpy() for a in (self.point_moved, network.point_xy))
        require(np.isfinite(moved).all(axis=1), phase, "is not finite", "point")
        if anchored is False:
            return
        for ends, held in ((start[:-1], True), (start[1:] - 1, anchored)):
            kept = (moved[ends] == before[ends]).all(axis=1) | network.channel_closed | ~np.asarray(held)
            require(kept, phase, "lost its anchored end", "channel")

    @property
    def nbytes(self) -> int:
        """Device memory of all arrays in bytes, those of the phases included."""
        # Two that begin at the same place are one.
        arrays = {a.ptr: a for a in arrays_of([vars(self), self.phases])}
        return sum(int(np.prod(a.shape)) * wp.types.type_size_in_bytes(a.dtype) for a in arrays.values())


def _checked_count(points: float, device: Any) -> int:
    """Return a number of points, or raise ``MemoryError`` if there is no room for them on a device."""
    free = available_memory(device)
    limit = MAX_POINTS if free is None else min(MAX_POINTS, free // BYTES_PER_POINT)
    if not HEADROOM * points + 64 <= limit:
        raise OutOfMemoryError(
            f"the spacing makes about {points:.3g} points, and there is room for {int(limit / HEADROOM):.3g} on "
            f"{device.alias}; check the units of the lines and of the spacing, or use a larger spacing"
        )
    return int(points)


def arrays_of(values: Iterable[Any]) -> Iterator[DeviceArray]:
    """Device arrays in values, in containers and in what belongs to the phases; those of the network are its own."""
    for value in values:
        if isinstance(value, wp.array):
            yield value
        elif isinstance(value, (list, tuple)):
            yield from arrays_of(value)
        elif isinstance(value, dict):
            yield from arrays_of(value.values())
        elif type(value).__module__.startswith("warpriver.") and not isinstance(value, (RiverNetwork, Terrain, State)):
            yield from arrays_of(getattr(value, "__dict__", {}).values())


def _columns(**columns: np.ndarray) -> np.ndarray:
    """Return columns of equal length as an array of structs."""
    table = np.zeros(len(next(iter(columns.values()))), [(name, np.float64) for name in columns])
    for name, column in columns.items():
        table[name] = column
    return table


def _bits(array: DeviceArray) -> DeviceArray:
    """The memory of real numbers from 0 on as integers, whose order is theirs."""
    kind = wp.int64 if array.dtype is wp.float64 else wp.int32
    return wp.array(ptr=array.ptr, dtype=kind, shape=array.shape, device=array.device, copy=False)
