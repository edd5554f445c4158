"""Edits done: each value of :mod:`warpriver.edits` becomes one of the graph, or of the ground, between two steps."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np

from warpriver import edits
from warpriver.channel_table import JOINT_LOCK, JOINT_THROUGH
from warpriver.edits.ground import edit_terrain, terrain_window
from warpriver.edits.values import Place
from warpriver.engine.stepper import Stepper
from warpriver.errors import InputError
from warpriver.graph.authoring import Reworking, nearest_point, river_of, smooth_line
from warpriver.graph.edits import JUNCTION_CLEARANCE
from warpriver.history import AppliedEdit, Avulsion, ControlStroke, Cutoff, Event, EventLog, HeldLock, History
from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge
from warpriver.meander.avulsions import NewCourse, avulsion_of, carve, plan_course, rework_courses, window_of
from warpriver.meander.courses import Refusal, carve_course
from warpriver.meander.deferred import defer_junction
from warpriver.meander.diversions import Diversion, divert, find_way, upstream_of
from warpriver.network import RiverNetwork
from warpriver.params import AvulsionParams, PathMeander
from warpriver.terrain import Terrain

__all__ = ["LOCK_SPACINGS", "EditStack", "untold"]

# Spacings that locked points keep from each other and from the ends of their channel: the samples between them are
# even, so that a short part would be sampled by up to half a spacing in so many otherwise than the target.
LOCK_SPACINGS = 10
# A place that is given as (x, y) may be so many widths from its channel, the end of an added one from what it joins.
PLACE_WIDTHS, JOIN_WIDTHS = 2.0, 0.5
# Spacings over which a point that moves takes its channel along at least.
MOVE_SPACINGS = 2.0
# A loop that is cut off by hand: its least length in widths, how far around a place it may reach, how long the way
# across is at most beside it where both ends are chosen, and among how many points on each side.
LEAST_LOOP, LOOP_REACH, LOOP_RATIO, LOOP_SAMPLES = 5.0, 30.0, 0.8, 256


C = TypeVar("C", bound="NewCourse | Diversion")
# Takes an edit back that was done.
Back = Callable[[], None]


class EditStack:
    """The edits that were done between the same two steps, to be taken back and done again."""

    def __init__(
        self,
        check: Callable[[RiverNetwork], None],
        doers: Mapping[type[edits.Edit], Callable[[Any], tuple[Back, edits.Edit]]] | None = None,
    ):
        """Start without any.

        Args:
            check: Raises ``ValueError`` for a network that the run cannot go on with.
            doers: What does edits of further kinds: it does one, or raises and changes nothing, and returns what takes
                it back, and the edit as the history shall tell it.
        """
        self._check, self._doers = check, doers or {}
        # Each with the number of events before it, and what takes it back.
        self._done: list[tuple[edits.Edit, int, Back]] = []
        self._undone: list[edits.Edit] = []

    def apply(self, stepper: Stepper, history: History, edit: edits.Edit) -> None:
        """Do an edit and note it in the history.

        Raises:
            ValueError: It cannot be done, and nothing has changed.
        """
        self._do(stepper, history, edit)
        self._undone.clear()

    def undo(self, stepper: Stepper, history: History) -> edits.Edit:
        """Take the last edit back and return it.

        Raises:
            ValueError: None was done.
        """
        if not self._done:
            raise InputError(
                "no edit was done since the last step, and none before it can be taken back; replay the session "
                "without it: Simulation.replay(start, edits)"
            )
        edit, events, back = self._done.pop()
        back()
        # What was painted on a field since stays.
        own = isinstance(edit, edits.PaintControl)
        painted = list(history.events[events + own :].of(ControlStroke))
        history.forget_events(events)
        history.events.extend(painted)
        self._undone.append(edit)
        return edit

    def redo(self, stepper: Stepper, history: History) -> edits.Edit:
        """Do the edit again that was taken back last, and return it.

        Raises:
            ValueError: None was taken back.
        """
        if not self._undone:
            raise InputError("no edit was taken back since the last edit or step; there is nothing to do again")
        edit = self._undone.pop()
        self._do(stepper, history, edit)
        return edit

    def _do(self, stepper: Stepper, history: History, edit: edits.Edit) -> None:
        events, steps, told = len(history.events), stepper.step_count, edit
        if type(edit) in self._doers:
            back, told = self._doers[type(edit)](edit)
        elif isinstance(edit, edits.EditTerrain):
            back = _edit_ground(stepper, edit)
        elif isinstance(edit, (edits.AvulseChannel, edits.DeferJunction)):
            back = _avulse(stepper, history, edit)
        elif isinstance(edit, edits.DivertChannel):
            back = self._divert(stepper, history, edit)
        elif isinstance(edit, edits.CutLoop):
            back = self._cut(stepper, history, edit)
        else:
            back = self._edit_network(stepper, edit)
        if not isinstance(edit, edits.PaintControl):  # told as a stroke
            history.events.append(AppliedEdit.of(steps * stepper.state.params.time_step, steps, told))
        self._done.append((edit, events, back))

    def _divert(self, stepper: Stepper, history: History, edit: edits.DivertChannel) -> Back:
        state, before = stepper.state, stepper.snapshot()
        try:
            event = _divert(edit, stepper)
            self._check(state.network)
        except BaseException:
            stepper.put_back(before)
            raise
        assert state.terrain is not None
        raster = state.terrain.raster
        low, high = event.course.min(axis=0) - event.width, event.course.max(axis=0) + event.width
        window = raster.window(*low.tolist(), *high.tolist())
        cells = None if window is None else raster.cells(window)
        carve_course(state.terrain, event.course, event.bed, event.width)
        history.events.append(event)

        def back() -> None:
            stepper.put_back(before)
            if window is not None and cells is not None:
                raster.put_cells(window, cells)

        return back

    def _cut(self, stepper: Stepper, history: History, edit: edits.CutLoop) -> Back:
        cutoff, straight = _cutoff_of(stepper, edit)
        back = self._edit_network(stepper, straight)
        history.events.append(cutoff)
        return back

    def _edit_network(self, stepper: Stepper, edit: edits.Edit) -> Back:
        before = stepper.snapshot()
        try:
            _do(edit, stepper)
            self._check(stepper.state.network)
        except BaseException:
            stepper.put_back(before)
            raise
        return lambda: stepper.put_back(before)


def _edit_ground(stepper: Stepper, edit: edits.EditTerrain) -> Back:
    terrain = stepper.state.terrain
    if terrain is None:
        raise InputError("the run lies on a plain, which cannot be edited; give it a terrain, terrain=")
    raster, window = terrain.raster, terrain_window(terrain, edit)
    cells = None if window is None else raster.cells(window)
    edit_terrain(terrain, edit)
    if window is None or cells is None:
        return lambda: None
    return lambda: raster.put_cells(window, cells)


def _avulse(stepper: Stepper, history: History, edit: edits.AvulseChannel | edits.DeferJunction) -> Back:
    new = _new_course(edit, stepper) if isinstance(edit, edits.AvulseChannel) else _deferred(edit, stepper)
    state, before = stepper.state, stepper.snapshot()
    work, line = divert(state, new) if isinstance(new, Diversion) else (rework_courses(state, [new]), None)
    raster = None if state.terrain is None else state.terrain.raster
    window = None if state.terrain is None else window_of(state.terrain, new)
    cells = None if raster is None or window is None else raster.cells(window)

    def back() -> None:
        stepper.put_back(before)
        if raster is not None and window is not None and cells is not None:
            raster.put_cells(window, cells)

    time = stepper.step_count * state.params.time_step
    history.events.append(avulsion_of(state, time, new, line))
    carve(state, new)
    _adopt(stepper, work)
    return back


def _divert(edit: edits.DivertChannel, stepper: Stepper) -> Avulsion:
    """Lead a channel to another one, and return the event of that; the ground is not carved yet."""
    state, network = stepper.state, stepper.state.network
    state.place_nodes()
    river = _River(network, edit.channel)
    channel, point = river.inner(edit.at, JUNCTION_CLEARANCE, "be diverted")
    target = None
    if isinstance(edit.to, int):
        target = _River(network, edit.to).parts[-1]
        if upstream_of(network, channel)[target]:
            raise InputError(f"the water of channel {edit.to} comes through channel {edit.channel}; choose another one")
    params, goals = state.params.avulsions or AvulsionParams(), "outlet" if edit.to == "outlet" else "channels"
    found = _course_of(river, find_way(state, channel, point, params, target, goals=goals))
    work, line = divert(state, found)
    event = avulsion_of(state, stepper.step_count * state.params.time_step, found, line)
    _adopt(stepper, work)
    return event


def _course_of(river: _River, found: C | Refusal) -> C:
    """Return a course that was found for a river, or raise ``ValueError`` that says why there is none."""
    if isinstance(found, Refusal):
        x, y = found.xy
        raise InputError(f"channel {river.identity} finds no course: {found.reason}, at ({x:g}, {y:g})")
    return found


def _deferred(edit: edits.DeferJunction, stepper: Stepper) -> Diversion:
    """Find the course along the river of a tributary, or raise ``ValueError`` that says why there is none."""
    state = stepper.state
    state.place_nodes()
    river = _River(state.network, edit.channel)
    return _course_of(river, defer_junction(state, river.parts[-1], state.params.avulsions or AvulsionParams()))


def _new_course(edit: edits.AvulseChannel, stepper: Stepper) -> NewCourse | Diversion:
    """Find the course that a channel is to take, or raise ``ValueError`` that says why there is none."""
    state = stepper.state
    state.place_nodes()
    river = _River(state.network, edit.channel)
    channel, point = river.inner(edit.at, JUNCTION_CLEARANCE, "leave its course")
    head = int(state.network.starts()[channel])
    target = None
    if edit.to is not None:
        k, i = river.locate(edit.to, "to")
        target = river.first[k] + i
        if river.parts[k] != channel or target < point + JUNCTION_CLEARANCE:
            raise InputError(
                f"to does not lie downstream of at on channel {river.identity}, or a locked point lies between them; "
                "choose another place"
            )
    params = state.params.avulsions or AvulsionParams()
    identity = int(state.network.channel_id[channel])
    chance = np.random.default_rng([state.seed, stepper.step_count, identity, point - head])
    angle = None if edit.angle is None else math.radians(edit.angle)
    return _course_of(river, plan_course(state, channel, point, params, chance, target=target, angle=angle))


def untold(log: EventLog, events: Iterable[Event]) -> Iterator[Event]:
    """Yield events without those that tell once more that a lock keeps two channels apart."""
    told: set[tuple[int, int]] | None = None
    for event in events:
        if isinstance(event, HeldLock):
            if told is None:
                told = {(held.channel, held.other) for held in log.of(HeldLock)}
            if (event.channel, event.other) in told:
                continue
            told.add((event.channel, event.other))
        yield event


@functools.singledispatch
def _do(edit: Any, stepper: Stepper) -> None:
    raise InputError(f"{edit.name} is no edit that can be done; make one of warpriver.edits")


# ---- where


class _River:
    """A channel that an edit names, with all its parts between locked points.

    Attributes:
        parts: Their indices, downstream; the last one has the identity of all.
        xy: Points of each part, m, absolute.
    """

    def __init__(self, network: RiverNetwork, identity: int):
        self.network = network
        found = np.flatnonzero(network.channel_id == identity)
        if not len(found):
            ids = network.channel_id
            listed = ", ".join(map(str, np.sort(ids)[:20].tolist())) + (" ..." if len(ids) > 20 else "")
            raise InputError(f"there is no channel {identity}; the network has {listed}")
        self.parts = river_of(network, int(found[0]))
        self.identity = int(network.channel_id[self.parts[-1]])
        self.closed = bool(network.channel_closed[self.parts[0]])
        start = network.starts()
        self.first = [int(start[c]) for c in self.parts]
        self.last = [int(start[c + 1]) - 1 for c in self.parts]
        self.xy = [
            network.point_xy[a : b + 1].numpy().astype(np.float64) + network.origin
            for a, b in zip(self.first, self.last, strict=True)
        ]
        arcs = [np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))]) for xy in self.xy]
        before = np.concatenate([[0.0], np.cumsum([arc[-1] for arc in arcs])])
        self.arc = [arc + offset for arc, offset in zip(arcs, before, strict=False)]
        self.length = float(before[-1])

    def locate(self, at: Place, name: str = "at") -> tuple[int, int]:
        """Return the part (its place in ``parts``) and the index among its points of the nearest point to a place.

        Raises:
            ValueError: The place is not on the channel.
        """
        if isinstance(at, tuple):
            found = [nearest_point(xy, at) for xy in self.xy]
            k = int(np.argmin([away for _, away in found]))
            i, away = found[k]
            width = float(self.network.channel_width[self.parts[k]])
            if away > PLACE_WIDTHS * width:
                raise InputError(
                    f"{name} ({at[0]:g}, {at[1]:g}) lies {away:.4g} m outside of channel {self.identity}, which is "
                    f"{width:.4g} m wide; give a point within {PLACE_WIDTHS:g} widths of it, or an arc length"
                )
            return k, i
        if at > self.length:
            raise InputError(
                f"{name} is {at:g} m, beyond the end of channel {self.identity}, which is {self.length:.6g} m long"
            )
        k = int(np.searchsorted([arc[-1] for arc in self.arc[:-1]], at))
        arc = self.arc[k]
        i = int(np.searchsorted(arc, at))
        if i > 0 and (i == len(arc) or at - arc[i - 1] <= arc[i] - at):
            i -= 1
        return k, i

    def inner(self, at: Place, clearance: int, what: str) -> tuple[int, int]:
        """Return the part and the point of a place where the channel can be divided.

        Raises:
            ValueError: It is a ring, or the place is less than so many spacings from an end or a locked point.
        """
        if self.closed:
            raise InputError(f"channel {self.identity} is a ring, which cannot {what}; open it, or use a control")
        k, i = self.locate(at)
        away = min(i, len(self.xy[k]) - 1 - i)
        if away < clearance:
            upper = i <= len(self.xy[k]) - 1 - i
            locked = (upper and k > 0) or (not upper and k < len(self.parts) - 1)
            end = "a locked point" if locked else f"its {'head' if upper else 'end'}"
            raise InputError(
                f"at is {away} spacings from {end} of channel {self.identity}; to {what} keep {clearance} spacings away"
            )
        return self.parts[k], self.first[k] + i


def _rework(stepper: Stepper) -> Reworking:
    state = stepper.state
    spacing = state.spacing.numpy()[: state.network.channel_count].astype(np.float64)
    return Reworking(state.network, spacing, state.next_identity)


def _adopt(stepper: Stepper, work: Reworking, anew: bool = True) -> None:
    """Go on with what an edit made; ``anew``: what was drawn or resized may move faster than before."""
    edited = work.build()
    before = stepper.state.network.channels
    hastened = edited.channel_changed | (edited.channels.width != before.width[edited.channel_old])
    stepper.adopt(edited, hastened if anew else None)


# ---- points


@_do.register
def _(edit: edits.LockPoint, stepper: Stepper) -> None:
    river = _River(stepper.state.network, edit.channel)
    _refuse_twice(river, edit.at)
    c, point = river.inner(edit.at, LOCK_SPACINGS, "be locked")
    work = _rework(stepper)
    work.split(c, point, JOINT_LOCK)
    _adopt(stepper, work, anew=False)


def _refuse_twice(river: _River, at: Place) -> None:
    """Raise ``ValueError`` where a place is a locked point already."""
    if river.closed or len(river.parts) == 1:
        return
    k, i = river.locate(at)
    if (i == 0 and k > 0) or (i == len(river.xy[k]) - 1 and k < len(river.parts) - 1):
        raise InputError(f"channel {river.identity} is locked there already; leave it out")


@_do.register
def _(edit: edits.UnlockPoint, stepper: Stepper) -> None:
    network = stepper.state.network
    river = _River(network, edit.channel)
    if len(river.parts) == 1:
        raise InputError(f"channel {river.identity} has no locked point; there is nothing to unlock")
    k, i = river.locate(edit.at)
    ends = np.array([xy[-1] for xy in river.xy[:-1]])
    nearest = nearest_point(ends, river.xy[k][i])[0]
    work = _rework(stepper)
    work.join(river.parts[nearest], river.parts[nearest + 1])
    _adopt(stepper, work, anew=False)


@_do.register
def _(edit: edits.MovePoint, stepper: Stepper) -> None:
    network = stepper.state.network
    river = _River(network, edit.channel)
    k, i = river.locate(edit.at)
    c = river.parts[k]
    spacing = float(stepper.state.spacing.numpy()[c])
    if edit.radius < MOVE_SPACINGS * spacing:
        raise InputError(
            f"radius is {edit.radius:g} m; the points are {spacing:.4g} m apart, give {MOVE_SPACINGS:g} times that or "
            "more"
        )
    shift = np.asarray(edit.to) - river.xy[k][i]
    work = _rework(stepper)
    last = len(river.xy[k]) - 1
    if river.closed:
        _move_ring(work, c, river.xy[k], i, edit, shift)
    elif 0 < i < last:
        arc = river.arc[k]
        reach = np.where(arc < arc[i], min(edit.radius, arc[i] - arc[0]), min(edit.radius, arc[-1] - arc[i]))
        _shift(work, c, river.xy[k], np.abs(arc - arc[i]) / reach, shift)
    else:
        node = int(network.channel_from[c] if i == 0 else network.channel_to[c])
        _move_node(work, node, edit.radius, shift)
    _adopt(stepper, work)


def _shift(work: Reworking, c: int, xy: np.ndarray, t: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Move the points of a channel by (1 - t^2)^3 of a way, 0 from t = 1 on, and return where they are then."""
    part = np.maximum(1.0 - t * t, 0.0) ** 3
    inside = np.flatnonzero(part > 0.0)
    begin, stop = int(inside[0]), int(inside[-1]) + 1
    moved: np.ndarray = xy + part[:, None] * shift
    work.redraw(c, begin, stop, moved[begin:stop])
    return moved


def _move_ring(work: Reworking, c: int, xy: np.ndarray, i: int, edit: edits.MovePoint, shift: np.ndarray) -> None:
    step = np.hypot(*(np.roll(xy, -1, axis=0) - xy).T)
    arc, length = np.concatenate([[0.0], np.cumsum(step[:-1])]), float(step.sum())
    away = np.abs(arc - arc[i])
    away = np.minimum(away, length - away)
    moved = _shift(work, c, xy, away / min(edit.radius, 0.5 * length), shift)
    work.place_node(int(work.network.channel_to[c]), moved[0])


def _move_node(work: Reworking, node: int, radius: float, shift: np.ndarray) -> None:
    """Move a node with all channels that meet there, each over the radius, or all its length."""
    network = work.network
    for c in np.flatnonzero((network.channel_from == node) | (network.channel_to == node)).tolist():
        xy = work.line(c)
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
        away = arc if network.channel_from[c] == node else arc[-1] - arc
        _shift(work, c, xy, away / min(radius, float(arc[-1])), shift)
    work.place_node(node, network.node_xy[node] + shift)


# ---- channels


@_do.register
def _(edit: edits.SplitChannel, stepper: Stepper) -> None:
    river = _River(stepper.state.network, edit.channel)
    c, point = river.inner(edit.at, JUNCTION_CLEARANCE, "be split")
    work = _rework(stepper)
    upper = work.split(c, point, JOINT_THROUGH)
    work.resize(upper, edit.width_above, edit.depth_above)
    work.resize(c, edit.width_below, edit.depth_below)
    # The parts of the river above, between its locked points, are as wide as the part next to the node.
    for part in river.parts[: river.parts.index(c)]:
        work.resize(part, edit.width_above, edit.depth_above)
    for part in river.parts[river.parts.index(c) + 1 :]:
        work.resize(part, edit.width_below, edit.depth_below)
    _adopt(stepper, work)


@_do.register
def _(edit: edits.JoinChannels, stepper: Stepper) -> None:
    network = stepper.state.network
    above, below = _River(network, edit.upper), _River(network, edit.lower)
    upper, lower = above.parts[-1], below.parts[0]
    node = int(network.channel_to[upper])
    told = f"channels {above.identity} and {below.identity}"
    if above.identity == below.identity:
        raise InputError(f"{told} are one; name two that follow each other")
    if above.closed or below.closed or network.channel_from[lower] != node:
        raise InputError(f"{told} do not follow each other: the first does not end where the second begins")
    arriving, leaving = (int((ends == node).sum()) for ends in (network.channel_to, network.channel_from))
    if arriving != 1 or leaving != 1:
        raise InputError(f"{told} meet at a junction of {arriving + leaving} channels; remove the others first")
    work = _rework(stepper)
    work.join(upper, lower)
    # All parts of the river have the section that the joined one has.
    table = network.channels
    for part in above.parts[:-1] if network.point_section is None else []:
        work.resize(part, float(table.width[lower]), float(table.depth[lower]))
    _adopt(stepper, work)


@_do.register
def _(edit: edits.AddChannel, stepper: Stepper) -> None:
    state = stepper.state
    network, params = state.network, state.params
    xy = np.asarray(edit.xy, np.float64)
    target = _target(network, xy[-1])
    if edit.ends == "channel" and target is None:
        raise InputError(
            f"the line ends at ({xy[-1, 0]:g}, {xy[-1, 1]:g}), on no channel; end it on one, or give ends='outlet'"
        )
    if edit.ends == "outlet" and target is not None:
        raise InputError(
            f"the line ends at ({xy[-1, 0]:g}, {xy[-1, 1]:g}), on channel {int(network.channel_id[target[0]])}; end it "
            "elsewhere, or give ends='channel'"
        )
    spacing = params.spacing
    if params.spacing_in_widths > 0.0:
        spacing = min(spacing, params.spacing_in_widths * edit.width)
    work = _rework(stepper)
    node = None if target is None else work.junction_at(*target)
    if node is not None and any(work.joint(c) == JOINT_LOCK for c in work.arriving(node)):
        raise InputError("the line ends at a locked point; unlock it first, or end the line farther away")
    end = xy[-1] if node is None else work.node_place(node)
    xy = np.concatenate([xy[:-1], end[None]])
    if len(xy) < 2 or (xy[-1] == xy[-2]).all():
        raise InputError("the line has no length up to where it joins; draw a longer one")
    length = float(np.hypot(*np.diff(xy, axis=0).T).sum())
    if length < max(edit.width, 2.0 * spacing):
        raise InputError(
            f"the line is {length:.4g} m long, for a width of {edit.width:g} m and a spacing of {spacing:g} m; draw a "
            "longer one"
        )
    line = smooth_line(xy, spacing)
    if edit.max_rise is not None:
        _check_rise(line, state.terrain, edit.max_rise)
    depth = float(bankfull_depth(edit.width)) if edit.depth is None else edit.depth
    flow = float(bankfull_discharge(edit.width)) if edit.discharge is None else edit.discharge
    work.add(line, node, {"width": edit.width, "depth": depth, "discharge": flow}, 0 if target is None else target[0])
    _adopt(stepper, work)


def _target(network: RiverNetwork, end: np.ndarray) -> tuple[int, int] | None:
    """Channel, and point of it in all, that lies within half its width of the end of a line; None if none does."""
    away = np.hypot(*(network.points() - end).T)
    start = network.starts()
    owner = np.repeat(np.arange(network.channel_count), np.diff(start))
    away = np.where(network.channel_closed[owner], np.inf, away)
    # Between two points the channel is no farther than the nearer one less what the chord may hide.
    point = int(away.argmin())
    c = int(owner[point])
    near = _distance_to(network, point, end)
    return (c, point) if near <= JOIN_WIDTHS * network.channel_width[c] else None


def _distance_to(network: RiverNetwork, point: int, place: np.ndarray) -> float:
    """Distance in m of a place from the segments at a point."""
    start = network.starts()
    c = int(np.searchsorted(start, point, side="right")) - 1
    first, last = max(point - 1, int(start[c])), min(point + 1, int(start[c + 1]) - 1)
    xy = network.point_xy[first : last + 1].numpy().astype(np.float64) + network.origin
    nearest = np.inf
    for a, b in itertools.pairwise(xy):
        along = b - a
        size = float(along @ along)
        t = min(max(float((place - a) @ along) / size, 0.0), 1.0) if size > 0.0 else 0.0
        nearest = min(nearest, float(np.hypot(*(a + t * along - place))))
    return nearest


def _check_rise(line: np.ndarray, terrain: Terrain | None, limit: float) -> None:
    """Raise ``ValueError`` where the ground under a line rises by more than ``limit`` m over a point upstream."""
    if terrain is None:
        raise InputError("max_rise is given, but the run lies on a plain; leave it out, or run it over a terrain")
    height = terrain.sample(line)
    if np.isnan(height).any():
        x, y = line[int(np.isnan(height).argmax())]
        raise InputError(f"the line runs over ({x:.6g}, {y:.6g}), where the terrain has no data; draw it elsewhere")
    rise = height - np.minimum.accumulate(height)
    if rise.max() > limit:
        x, y = line[int(rise.argmax())]
        raise InputError(
            f"the ground rises by {rise.max():.4g} m along the line, up to ({x:.6g}, {y:.6g}), more than max_rise "
            f"{limit:g} m; draw it round the ridge, or lower the ground first"
        )


@_do.register
def _(edit: edits.RemoveChannel, stepper: Stepper) -> None:
    river = _River(stepper.state.network, edit.channel)
    work = _rework(stepper)
    work.remove(river.parts)
    _adopt(stepper, work, anew=False)


@_do.register
def _(edit: edits.RedrawSection, stepper: Stepper) -> None:
    network = stepper.state.network
    river = _River(network, edit.channel)
    (k, i), (other, j) = river.locate(edit.xy[0], "xy[0]"), river.locate(edit.xy[-1], "xy[-1]")
    if k != other:
        raise InputError(
            f"a locked point of channel {river.identity} lies between both ends of the line; unlock it first, or "
            "redraw up to it"
        )
    if i >= j:
        raise InputError(
            f"the line runs upstream along channel {river.identity}, or nowhere; draw it downstream"
            + (", without passing the first point of the ring" if river.closed else "")
        )
    c, xy = river.parts[k], river.xy[k]
    spacing = float(stepper.state.spacing.numpy()[c])
    drawn = np.concatenate([xy[i : i + 1], np.asarray(edit.xy[1:-1], np.float64).reshape(-1, 2), xy[j : j + 1]])
    drawn = drawn[np.concatenate([[True], (np.diff(drawn, axis=0) != 0.0).any(axis=1)])]
    if len(drawn) < 2:
        raise InputError("the line has no length; draw a longer one")
    line = smooth_line(drawn, spacing)
    work = _rework(stepper)
    work.redraw(c, i + 1, j, line[1:-1])
    _adopt(stepper, work)


def _cutoff_of(stepper: Stepper, edit: edits.CutLoop) -> tuple[Cutoff, edits.RedrawSection]:
    """Return the event of a bend that is cut off, and the straight way across it, as an edit."""
    state, network = stepper.state, stepper.state.network
    state.place_nodes()
    river = _River(network, edit.channel)
    (k, i), (other, j) = river.locate(edit.at), river.locate(edit.at if edit.to is None else edit.to, "to")
    if k != other:
        raise InputError(f"a locked point of channel {river.identity} lies on the loop; unlock it first")
    c, xy, arc = river.parts[k], river.xy[k], river.arc[k]
    width = float(network.channel_width[c])
    if edit.to is None:
        i, j = _neck_around(xy, arc, i, width)
        if i == j:
            raise InputError(
                f"channel {river.identity} hardly bends at ({xy[i, 0]:g}, {xy[i, 1]:g}): no way across is shorter than "
                f"{LOOP_RATIO:g} times the loop; give `to`, or a place on a bend"
            )
    elif i >= j:
        raise InputError(
            f"to lies upstream of at on channel {river.identity}, or at the same point; give both downstream"
        )
    if arc[j] - arc[i] <= LEAST_LOOP * width:
        raise InputError(
            f"the loop of channel {river.identity} is {arc[j] - arc[i]:.4g} m long; a cutoff takes more than "
            f"{LEAST_LOOP:g} widths ({LEAST_LOOP * width:.4g} m)"
        )
    loop, section = xy[i : j + 1].copy(), None
    if isinstance(state.params, PathMeander):  # whose loops are closed
        loop = np.concatenate([loop, loop[:1]])
    depth = float(network.channel_depth[c])
    if network.point_section is not None:
        along = network.point_section[river.first[k] + i : river.first[k] + j + 1].numpy().astype(np.float64)
        section = np.concatenate([along, along[: len(loop) - len(along)]])
        width, depth = (float(v) for v in section[0])
    time, flow = stepper.step_count * state.params.time_step, float(network.channel_discharge[c])
    cutoff = Cutoff(time, int(network.channel_id[c]), width, loop, depth, flow, section)
    return cutoff, edits.RedrawSection(edit.channel, (tuple(xy[i].tolist()), tuple(xy[j].tolist())))


def _neck_around(xy: np.ndarray, arc: np.ndarray, at: int, width: float) -> tuple[int, int]:
    """Return the points between which a bend is cut off: the shortest way across beside the loop; twice ``at`` if none.

    Args:
        xy: (n, 2) points of the channel, m.
        arc: (n,) arc lengths, m.
        at: Index of a point on the bend.
        width: m.
    """
    reach = LOOP_REACH * width
    above = np.arange(np.searchsorted(arc, arc[at] - reach), at + 1)
    below = np.arange(at, np.searchsorted(arc, arc[at] + reach, side="right"))
    # As many on each side as tell loops apart, however finely the line is sampled.
    above, below = above[:: -(-len(above) // LOOP_SAMPLES)], below[:: -(-len(below) // LOOP_SAMPLES)]
    across = np.hypot(*(xy[above][:, None] - xy[below][None, :]).transpose(2, 0, 1))
    along = arc[below][None, :] - arc[above][:, None]
    ratio = np.where(along > LEAST_LOOP * width, across / np.maximum(along, 1e-300), np.inf)
    best = np.unravel_index(int(np.argmin(ratio)), ratio.shape)
    return (int(above[best[0]]), int(below[best[1]])) if ratio[best] <= LOOP_RATIO else (at, at)


@_do.register
def _(edit: edits.SetChannel, stepper: Stepper) -> None:
    river = _River(stepper.state.network, edit.channel)
    if edit.reach is not None:
        _set_reach(edit, river, stepper)
        return
    work = _rework(stepper)
    if edit.discharge is not None:
        for part in river.parts[:-1]:
            work.set_discharge(part, edit.discharge, alone=True)
        work.set_discharge(river.parts[-1], edit.discharge)
    for part in river.parts:
        work.resize(part, edit.width, edit.depth)
    _adopt(stepper, work)


def _set_reach(edit: edits.SetChannel, river: _River, stepper: Stepper) -> None:
    """Make a channel of a reach, where it does not end at the channel's own ends, and set that."""
    assert edit.reach is not None
    (k, i), (other, j) = river.locate(edit.reach[0], "reach[0]"), river.locate(edit.reach[1], "reach[1]")
    if (k, i) >= (other, j):
        raise InputError("reach runs upstream, or nowhere; give (from, to), downstream")
    if k != other:
        raise InputError(
            f"a locked point of channel {river.identity} lies in the reach; unlock it first, or set the reaches on "
            "both sides of it"
        )
    if river.closed:
        raise InputError(f"channel {river.identity} is a ring, which has no reaches; set all of it")
    c, first, last = river.parts[k], river.first[k], river.last[k]
    work = _rework(stepper)
    reach = c
    if j < last - first:
        if last - first - j < JUNCTION_CLEARANCE or j - i < 2 * JUNCTION_CLEARANCE:
            raise InputError(f"reach is {j - i} spacings long, or ends next to the channel's end; choose another")
        reach = work.split(c, first + j, JOINT_THROUGH)
    if i > 0:
        if i < JUNCTION_CLEARANCE or j - i < 2 * JUNCTION_CLEARANCE:
            raise InputError(f"reach is {j - i} spacings long, or begins next to the channel's head; choose another")
        work.split(reach, first + i, JOINT_THROUGH)
    work.resize(reach, edit.width, edit.depth)
    _adopt(stepper, work)
