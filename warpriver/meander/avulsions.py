"""Avulsions: banks that break at bends, and channels that leave there for new courses [Paris2023], Sec. 5.2."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.engine.phase import Batch, Phase
from warpriver.engine.stages import Share, Stage, launch
from warpriver.engine.state import State
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.graph.authoring import Reworking
from warpriver.graph.edits import JUNCTION_CLEARANCE
from warpriver.history.events import Avulsion, Crevasse, Event
from warpriver.kernels import avulsions as kernels
from warpriver.kernels.status import CREVASSES, FAULT, FAULT_NONE, STEPS
from warpriver.meander.courses import Course, Refusal, carve_course, falling_bed, walk_courses
from warpriver.meander.diversions import Diversion, divert, find_way, upstream_of
from warpriver.params import AvulsionParams
from warpriver.terrain import Terrain

with IMPORTING:
    from scipy.spatial import cKDTree

__all__ = ["Avulse", "NewCourse", "avulsion_of", "carve", "plan_avulsion", "plan_course", "rework_courses", "window_of"]


# Points that a new course keeps from both ends of its channel.
END_POINTS = 2
METERS_PER_KILOMETER = 1000.0


@dataclasses.dataclass(frozen=True)
class NewCourse:
    """A new course that a channel can take.

    Attributes:
        channel: Index of the channel.
        first: Point, of all, where it leaves.
        last: Point where it comes back.
        course: The course, both points included.
        width: Width of the channel where it leaves, m.
        old_xy: (n, 2) course that it leaves, both points included, m.
    """

    channel: int
    first: int
    last: int
    course: Course
    width: float
    old_xy: FloatArray


def window_of(terrain: Terrain, new: NewCourse | Diversion) -> tuple[int, int, int, int] | None:
    """Return first row and column, rows and columns of the cells that a new course may carve; None if none."""
    (west, south), (east, north) = new.course.xy.min(axis=0) - new.width, new.course.xy.max(axis=0) + new.width
    return terrain.raster.window(west, south, east, north)


class Avulse(Phase):
    """At the end of each step lets banks break by chance, and channels leave there, on the host.

    Attributes:
        point_bend: (P,) width times curvature; by the bend its mean over a width.
        point_bank: (P,) int32, what the bank does: HOLDS, BREAKS or LEAVES of ``kernels/avulsions.py``.
        identity: (C,) int32, identities of the channels.
    """

    name = "avulse"
    point_bend: DeviceArray
    point_bank: DeviceArray
    identity: DeviceArray

    def __init__(self) -> None:
        self._identity = np.zeros(0, np.int32)

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        self.point_bend = state.zeros(state.point_capacity, state.scalar)
        self.point_bank = state.zeros(state.point_capacity)
        self.identity = state.zeros(state.channel_capacity)
        if len(self._identity):
            state.assign(self.identity, self._identity)

    def install(self, state: State) -> None:
        """Take the identities of the channels."""
        self._identity = state.network.channel_id.astype(np.int32)
        state.assign(self.identity, self._identity)

    def stages(self, state: State) -> list[Stage]:
        """Return the stages: how much each point bends, and which banks break."""
        kernel, channels, points = kernels.build(state.scalar), state.channels(), state.points()
        breaking = _constants(state)

        def measure(share: Share) -> None:
            launch(
                kernel.measure_bends,
                dim=share.point_threads,
                inputs=[channels, points, breaking, share.work, state.substep],
                outputs=[self.point_bend],
                device=state.device,
            )

        def find(whole: Share) -> None:
            launch(
                kernel.break_banks,
                dim=whole.point_threads,
                inputs=[channels, breaking, whole.work, self.identity, self.point_bend, state.substep],
                outputs=[self.point_bank, state.status.array],
                device=state.device,
            )

        return [Stage(self.name, measure), Stage(self.name, find, shared=False)]

    def after(self, state: State, batch: Batch) -> list[Event]:
        """Note the banks that broke, and let channels leave."""
        if batch.status[FAULT] != FAULT_NONE or batch.status[STEPS] == 0:
            return []
        count = batch.status[CREVASSES]
        if batch.edited:
            # The points are others than those whose banks broke.
            state.begin_batch(begun=batch.steps_after)
            state.run(self.stages(state))
            count = state.read_status()[CREVASSES]
        return self._break(state, batch.times[-1], batch.steps_after) if count else []

    def _break(self, state: State, time: float, step: int) -> list[Event]:
        """Return the events of the banks that the device found to break, once the network has followed them."""
        state.place_nodes()
        network, params = state.network, state.params.avulsions
        bank = self.point_bank.numpy()[: network.point_count]
        where = np.flatnonzero(bank != kernels.HOLDS)
        bend = self.point_bend.numpy()[where]
        start = network.starts()
        owner = np.searchsorted(start, where, side="right") - 1
        events: list[Event] = []
        taken: list[NewCourse] = []
        left: tuple[Diversion, Reworking, FloatArray] | None = None
        for i, c, wc in zip(where.tolist(), owner.tolist(), bend.tolist(), strict=True):
            xy = network.point_xy[i : i + 1].numpy()[0].astype(np.float64) + network.origin
            identity, width, outcome = int(network.channel_id[c]), _width_at(state, c, i), ""
            if bank[i] == kernels.LEAVES:
                chance = np.random.default_rng([state.seed, step, identity, i - int(start[c])])
                found = plan_avulsion(state, c, i, params, chance, taken=taken)
                if left is not None or (taken and isinstance(found, Diversion)):
                    # What a diversion does to the graph is not known to others of the same step.
                    found = Refusal("another channel has left its course in this step", (float(xy[0]), float(xy[1])))
                if isinstance(found, Diversion):
                    try:
                        left = (found, *divert(state, found))
                    except InputError as error:
                        found = Refusal(str(error), (float(xy[0]), float(xy[1])))
                outcome = found.reason if isinstance(found, Refusal) else "avulsion"
                if isinstance(found, NewCourse):
                    taken.append(found)
            events.append(Crevasse(time, identity, width, float(wc), float(xy[0]), float(xy[1]), outcome))
        if taken:
            events += [avulsion_of(state, time, new) for new in taken]
            work = rework_courses(state, taken)
            for new in taken:
                carve(state, new)
            state.adopt(work.build())
            # New courses begin and end in corners, of whose speed nothing is known.
            state.hasten(np.isin(np.arange(state.network.channel_count), [new.channel for new in taken]))
        if left is not None:
            diversion, graph, line = left
            events.append(avulsion_of(state, time, diversion, line))
            carve(state, diversion)
            state.adopt(graph.build())
            state.hasten(np.ones(state.network.channel_count, bool))
        return events


def _constants(state: State) -> Any:
    """Pack the constants of breaking banks for the kernels."""
    params, breaking = state.params.avulsions, kernels.build(state.scalar).Breaking()
    breaking.curvature = params.crevasse_curvature
    breaking.rate = params.crevasse_rate / METERS_PER_KILOMETER
    breaking.chance, breaking.avulsion = params.crevasse_probability, params.avulsion_probability
    breaking.time_step, breaking.by_point = state.params.time_step, int(params.crevasse_rule == "point")
    breaking.seed = state.kernel_seed
    return breaking


# ---- a new course


def plan_avulsion(
    state: State,
    channel: int,
    point: int,
    params: AvulsionParams,
    chance: np.random.Generator,
    *,
    taken: Sequence[NewCourse] = (),
) -> NewCourse | Diversion | Refusal:
    """Find a new course for a channel: regional, by chance, or within the channel; or say why there is none.

    Args:
        state: The network and its ground.
        channel: Index of the channel, which is no ring.
        point: Point, of all, where it leaves.
        params: Constants.
        chance: What is left to chance.
        taken: New courses that were found before.
    """
    # Not drawn where there are none, so that runs without them are as they were.
    if params.regional > 0.0 and chance.uniform() < params.regional:
        first, last = (int(v) for v in state.network.starts()[channel : channel + 2])
        if not first + JUNCTION_CLEARANCE <= point < last - JUNCTION_CLEARANCE:
            x, y = (state.network.point_xy[point : point + 1].numpy()[0] + state.network.origin).tolist()
            return Refusal("it lies at an end of the channel", (x, y))
        return find_way(state, channel, point, params, goals="any")
    return plan_course(state, channel, point, params, chance, taken=taken)


def plan_course(
    state: State,
    channel: int,
    point: int,
    params: AvulsionParams,
    chance: np.random.Generator,
    *,
    target: int | None = None,
    angle: float | None = None,
    taken: Sequence[NewCourse] = (),
) -> NewCourse | Diversion | Refusal:
    """Find a new course for a channel, or say why there is none; nothing is changed.

    It ends where it meets the reach downstream of its target, which is kept. Where it meets the reach upstream there is
    no course; where it meets another channel there is none, or it ends there, by ``params.meeting``.

    Args:
        state: The network and its ground.
        channel: Index of the channel, which is no ring.
        point: Point, of all, where it leaves.
        params: Constants.
        chance: What is left to chance.
        target: Point where it shall come back; by chance between ``nearest`` and ``farthest``.
        angle: First angle to the channel in radians, to the left; by chance up to ``first_angle``.
        taken: New courses that were found before.
    """
    network, start = state.network, state.network.starts()
    first, last = int(start[channel]), int(start[channel + 1]) - 1
    spacing, width = float(state.spacing.numpy()[channel]), _width_at(state, channel, point)
    xy = network.point_xy[first : last + 1].numpy().astype(np.float64) + network.origin
    at = point - first
    here = float(xy[at, 0]), float(xy[at, 1])
    if any(new.channel == channel for new in taken):
        return Refusal("the channel has left its course already in this step", here)
    # All draws are made whatever comes of them, so that one does not depend on another.
    far, turn, seed = chance.uniform(), chance.uniform(-1.0, 1.0), int(chance.integers(2**32))
    if target is None:
        nearest, rest = params.nearest * width, (len(xy) - 1 - END_POINTS - at) * spacing
        if at < END_POINTS or rest < nearest:
            return Refusal("too little of the channel is left there", here)
        ahead = nearest + far * (min(params.farthest * width, rest) - nearest)
        target = point + round(ahead / spacing)
    way = xy[min(at + 1, len(xy) - 1)] - xy[max(at - 1, 0)]
    first_angle = math.radians(params.first_angle) * turn if angle is None else angle
    heading = math.atan2(way[1], way[0]) + first_angle
    direction = [[math.cos(heading), math.sin(heading)]]
    ends = xy[at], xy[target - first]
    (walked,) = walk_courses([ends[0]], [ends[1]], direction, [seed], spacing, params, state.terrain, state.device)
    if isinstance(walked, Refusal):
        return walked
    joins = params.meeting == "join"
    met = _meeting(state, channel, point, target, walked, width, taken, joins=joins)
    if isinstance(met, Refusal):
        return met
    course, end = met
    last_rise = course.ground[-1] - course.ground[-2]
    if last_rise > params.steepest_rise * float(np.hypot(*(course.xy[-1] - course.xy[-2]))):
        return Refusal(f"the ground rises by more than {params.steepest_rise:g} m/m", _place(course.xy[-1]))
    bed = course.bed if state.terrain is None else falling_bed(course.xy, course.ground, params.fall)
    course = dataclasses.replace(course, bed=bed)
    if course.deepest_cut > params.deepest_cut * _depth_at(state, channel, point):
        deepest = int((course.ground - course.bed).argmax())
        return Refusal(f"the cut would be deeper than {params.deepest_cut:g} depths", _place(course.xy[deepest]))
    if not first <= end <= last:
        return Diversion.along(network, channel, point, end, course)
    return NewCourse(channel, point, end, course, width, xy[at : end - first + 1])


def _meeting(
    state: State,
    channel: int,
    point: int,
    target: int,
    course: Course,
    width: float,
    taken: Sequence[NewCourse],
    *,
    joins: bool = False,
) -> tuple[Course, int] | Refusal:
    """A course up to where it meets the reach below its target, with the point there; or what it must not meet.

    Lines meet where their points come closer than the channels are wide in the mean, and than segments that cross. With
    ``joins`` other channels whose water does not come through this one may be met as well.
    """
    network, start = state.network, state.network.starts()
    spacing = state.spacing.numpy().astype(np.float64)
    last, step = int(start[channel + 1]) - 1, float(spacing[channel])
    beside = math.ceil(state.params.cutoff_min_arc * width / step)
    own = max(width, step)
    margin = max(own, 0.5 * (width + float(network.channel_width.max())), 0.5 * (step + float(spacing.max())))
    (west, south), (east, north) = course.xy.min(axis=0) - margin, course.xy.max(axis=0) + margin
    xy = network.points()
    near = (xy[:, 0] >= west) & (xy[:, 0] <= east) & (xy[:, 1] >= south) & (xy[:, 1] <= north)
    index = np.flatnonzero(near)
    owner = np.searchsorted(start, index, side="right") - 1
    # (what, points, how close): those that must not be met, and the reach below, which may.
    forbidden = [("its own course upstream", index[(owner == channel) & (index < point - beside)], own)]
    own_water = upstream_of(network, channel) | network.channel_closed if joins else np.ones(len(spacing), bool)
    open_to = []
    for other in np.unique(owner[owner != channel]).tolist():
        reach = max(0.5 * (width + float(network.channel_width[other])), 0.5 * (step + float(spacing[other])))
        if own_water[other]:
            forbidden.append((f"channel {int(network.channel_id[other])}", index[owner == other], reach))
        else:
            open_to.append((index[owner == other], reach))
    below = index[(owner == channel) & (index > target + beside) & (index <= last - END_POINTS)]
    line = course.xy[1:-1]
    stop, end = len(course.xy) - 1, target
    met, at = _first_contact(line, xy[below], own)
    if met >= 0:
        stop, end = met + 1, int(below[at])
    for points, reach in open_to:
        met, at = _first_contact(line[:stop], xy[points], reach)
        if met >= 0 and met + 1 < stop:
            stop, end = met + 1, int(points[at])
    lines = [(what, xy[points], reach) for what, points, reach in forbidden]
    lines += [
        (f"the new course of channel {int(network.channel_id[new.channel])}", new.course.xy, 0.5 * (width + new.width))
        for new in taken
    ]
    for what, points, reach in lines:
        met, _ = _first_contact(line[:stop], points, reach)
        if met >= 0:
            return Refusal(f"it meets {what}", _place(line[met]))
    if end == target:
        return course, end
    ground = course.ground[: stop + 1]
    foot = 0.0 if state.terrain is None else float(state.terrain.sample(xy[end : end + 1])[0])
    if not math.isfinite(foot):
        return Refusal("there is no ground", _place(xy[end]))
    heights = np.append(ground, foot)
    return Course(np.concatenate([course.xy[: stop + 1], xy[end : end + 1]]), heights, heights), end


def _first_contact(line: FloatArray, points: FloatArray, reach: float) -> tuple[int, int]:
    """First point of a line that comes within reach of others, and the nearest of those; -1, -1 if none does."""
    if not len(points) or not len(line):
        return -1, -1
    away, nearest = cKDTree(points).query(line, distance_upper_bound=reach)
    met = np.flatnonzero(np.isfinite(away))
    return (int(met[0]), int(nearest[met[0]])) if len(met) else (-1, -1)


def rework_courses(state: State, taken: Sequence[NewCourse]) -> Reworking:
    """Return the network's channels with new courses in place of old ones, to be built."""
    spacing = state.spacing.numpy()[: state.network.channel_count].astype(np.float64)
    work, start = Reworking(state.network, spacing, state.next_identity), state.network.starts()
    for new in taken:
        head = int(start[new.channel])
        work.redraw(new.channel, new.first + 1 - head, new.last - head, new.course.xy[1:-1])
    return work


def avulsion_of(state: State, time: float, new: NewCourse | Diversion, line: FloatArray | None = None) -> Avulsion:
    """Return the event of a channel that takes a new course; the network is still as it was.

    Args:
        state: The network and its ground.
        time: When, yr.
        new: The course.
        line: (n, 2) m, the course as it became where that ends in a junction.
    """
    network = state.network
    section = None
    if network.point_section is not None:
        old = network.point_section[new.first : new.first + len(new.old_xy)]
        section = np.asarray(old.numpy(), np.float64)
    return Avulsion(
        time,
        int(network.channel_id[new.channel]),
        new.width,
        new.old_xy,
        new.course.xy if line is None else line,
        _bed_of(state, new.course),
        _depth_at(state, new.channel, new.first),
        float(network.channel_discharge[new.channel]),
        section,
    )


def _bed_of(state: State, course: Course) -> FloatArray:
    return np.empty(0) if state.terrain is None else course.bed


def carve(state: State, new: NewCourse | Diversion) -> None:
    """Carve a new course into the ground, where there is any."""
    if state.terrain is not None:
        carve_course(state.terrain, new.course.xy, new.course.bed, new.width)


def _width_at(state: State, channel: int, point: int) -> float:
    """Width of a channel at a point, m."""
    return float(_section_at(state, channel, point)[0])


def _depth_at(state: State, channel: int, point: int) -> float:
    """Depth of a channel at a point, m."""
    return float(_section_at(state, channel, point)[1])


def _section_at(state: State, channel: int, point: int) -> Any:
    network = state.network
    if network.point_section is not None:
        return network.point_section[point : point + 1].numpy()[0]
    return network.channel_width[channel], network.channel_depth[channel]


def _place(xy: FloatArray) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])
