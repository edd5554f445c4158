"""The layout of a riverscape: courses with their profiles and sections, from a terrain, its rivers and their types."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from warpriver.arrays import FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.graph.forest import leaving_channels
from warpriver.network import RiverNetwork
from warpriver.parameter import Params, parameter
from warpriver.riverscape.beds import FADES, GENTLEST_BANK, STEEPEST_BANK
from warpriver.riverscape.before import Before, Profile
from warpriver.riverscape.labels import ChannelLabels
from warpriver.riverscape.profiles import Graph, ProfileParams, Steps, falling_profile, lay_steps, step_levels
from warpriver.riverscape.stations import TYPES, Basins, Falls, Rocks, Stations
from warpriver.riverscape.templates import (
    FORM_TABLE,
    FORMS,
    TEMPLATES,
    FlowParams,
    UniformFlow,
    bend_shape,
    section_fill,
    uniform_flow,
)
from warpriver.riverscape.trajectories import Axes, Lines, TrajectoryParams, lay_axes, lay_lines

__all__ = ["BANK_EASE", "BedParams", "Ground", "Layout", "bank_reach", "lay_courses", "no_falls"]


# Height of the ground that beds are cut into at (n, 2) places.
Ground = Callable[[FloatArray], FloatArray]

# Stations across a width of water; ground is looked at in so many places from bank to bank.
STATIONS_ACROSS, LOOKS = 5.0, 7
# Places at which banks are looked for, as parts of the farthest; and those at which level ground beside an axis is.
BANK_LOOKS, ROOM_LOOKS, ROOM_WIDTHS = 12, 12, 7.0
# Distance from the water over which banks become steep, in widths.
BANK_EASE = 0.3
# Least and greatest slope of river types that a user gives, in tolerances of the limit.
BRAIDED_LIMIT = 0.044
# A run of rocks: number per width of length, by type.
ROCKS = {"A+": 1.3, "A": 1.0, "B": 0.35}
RIM_ROCKS = 6
# Passes that smooth the curvature: of stations a fifth of a width apart, by a Gaussian of half a width.
SMOOTHED = 14


@dataclasses.dataclass(frozen=True)
class BedParams(Params):
    """Constants of beds."""

    farthest: float = parameter(
        4.0,
        "widths",
        low=0.5,
        source="warpriver",
        doc="greatest distance from the water at which banks reach the ground",
    )
    bars: float = parameter(
        0.5,
        "mean depths",
        low=0.0,
        source="warpriver",
        doc="height of the plain between braided threads over the water",
    )
    basin_depth: float = parameter(
        0.6, "mean depths", low=0.0, source="warpriver", doc="depth of the basins of steep rivers below their sections"
    )
    unevenness: float = parameter(
        0.1, "-", low=0.0, high=0.5, source="warpriver", doc="how far the width varies along a course, as a part"
    )
    pool_width: float = parameter(
        0.16, "-", low=0.0, high=0.4, source="warpriver", doc="how much wider pools are than their river, as a part"
    )
    change: float = parameter(
        3.0, "widths", low=0.1, source="warpriver", doc="length over which a section becomes that of the next channel"
    )


class Layout(NamedTuple):
    """What courses are laid with: the constants of all parts.

    Attributes:
        detail: Least distance between stations, m.
        seed: Seed.
        width: "type" or "network".
        planform: "type" or "given".
        flow, trajectory, profile, bed: Constants.
    """

    detail: float
    seed: int
    width: str
    planform: str
    flow: FlowParams
    trajectory: TrajectoryParams
    profile: ProfileParams
    bed: BedParams


def lay_courses(
    ground: Ground,
    cell_size: float,
    network: RiverNetwork,
    kind: IndexArray,
    labels: ChannelLabels,
    layout: Layout,
    before: Before | None = None,
) -> tuple[Stations, Profile]:
    """Lay the courses of all channels.

    Args:
        ground: Height of the ground.
        cell_size: That of the terrain, m.
        network: A forest.
        kind: (C,) types.
        labels: Flow and slope of its channels.
        layout: Constants.
        before: What was laid before, of the same channels between the same nodes: what does not change stays, to the
            bit.
    """
    slope = _checked_slopes(network, ground, kind, labels)
    k = np.array([TEMPLATES[t].width_to_depth for t in kind])
    mean = _sized(labels.flow, slope, k, network.channel_width, layout)
    spacing = np.maximum(layout.detail, mean.width / STATIONS_ACROSS)
    axes = lay_axes(network, spacing, None if before is None else before.directions(network))
    wave = layout.trajectory.wavelength * mean.width
    braided = np.isin(kind, [TYPES.index("D"), TYPES.index("DA")])
    swings = braided | ((wave < layout.trajectory.shown_cells * cell_size) & (layout.planform == "type"))
    room = _room(axes, ground, mean, swings)
    point_flow = _flow_along(network, axes, labels)
    lines = lay_lines(axes, kind, point_flow, mean.width, room, swings, layout.seed, layout.trajectory)
    graph = Graph(axes.start, network.channel_from, network.channel_to, network.node_count)
    rough = _stations(lines, spacing)
    sizes = _sizes(rough, axes, point_flow, slope, k, network, layout)
    z = _axis_profile(ground, rough, sizes, axes, graph, slope, mean, cell_size, layout)
    if before is not None:
        z = before.levels(z, graph)
    steps = lay_steps(z, axes.along, graph, kind, slope, mean.width, mean.speed, layout.seed, layout.profile)
    at = _stations(lines, spacing, steps)
    sizes = _sizes(at, axes, point_flow, slope, k, network, layout)
    channel = lines.channel[at.course]
    water = _on_axis(z, axes, channel, at.axis)
    water = step_levels(water, channel, at.axis, steps)
    # To the bit: all that meets at a node has one level.
    begins, ends = lines.ends(axes)
    water[at.start[:-1][begins]] = z[axes.start[lines.channel[begins]]]
    water[at.start[1:][ends] - 1] = z[axes.start[lines.channel[ends] + 1] - 1]
    water = _falling(water, at.start)
    made = _courses(ground, network, kind, axes, lines, at, sizes, water, steps, slope, layout)
    profile = Profile(axes.start, z)
    if before is None:
        return made, profile
    anew = before.changed & before.leveled
    stations = before.stations.with_channels_of(made, anew)
    for c in np.flatnonzero(before.changed & ~anew).tolist():
        stations = stations.with_tail_of(made, c, layout.bed.change)
    return stations, before.profile.with_channels_of(profile, anew)


def _checked_slopes(network: RiverNetwork, ground: Ground, kind: IndexArray, labels: ChannelLabels) -> FloatArray:
    slope = labels.slope
    unknown = ~np.isfinite(slope)
    if unknown.any():
        c = int(unknown.argmax())
        raise InputError(f"the slope of channel {c} is not known; give the network slopes or heights")
    start, xy = network.starts().astype(np.int64), network.points()
    # The slope of extracted channels is that of the surface water was routed on, which falls; others are only lines.
    drawn = ~np.isfinite(network.channel_slope)
    rise = ground(xy[start[1:] - 1]) - ground(xy[start[:-1]])
    uphill = drawn & (rise > 0.5)
    if uphill.any():
        c = int(uphill.argmax())
        raise InputError(
            f"channel {c} runs uphill: the ground at its end is {rise[c]:.3g} m above that at its head "
            f"({int(uphill.sum())} such channels in all); reverse its points, or draw it down the valley"
        )
    if not (slope > 0.0).any():
        raise InputError(
            "the ground is level: no channel falls, so that nothing says how fast they flow; give the network slopes, "
            "or ground that falls"
        )
    steep = (kind == TYPES.index("D")) & (slope > BRAIDED_LIMIT)
    steep |= (kind == TYPES.index("DA")) & (slope > BRAIDED_LIMIT)
    if steep.any():
        c = int(steep.argmax())
        raise InputError(
            f"channel {c} has type {TYPES[kind[c]]} and a slope of {slope[c]:.3g}; rivers braid below 0.04: give it "
            "type A or B, or let classify_rivers choose"
        )
    return slope


def _sized(flow: FloatArray, slope: FloatArray, k: FloatArray, width: FloatArray, layout: Layout) -> UniformFlow:
    """Uniform flow in sections of the types' form, or of the network's width with the same speed law."""
    found = uniform_flow(flow, slope, k, layout.flow)
    if layout.width == "network":
        for _ in range(40):
            found = uniform_flow(flow, slope, np.clip(width**2 / found.area, 2.0, 400.0), layout.flow)
    return found


def _room(axes: Axes, ground: Ground, mean: UniformFlow, swings: NDArray[np.bool_]) -> FloatArray:
    """Width of level ground to the left and right of the axes, (Q, 2) m; infinite where it does not end nearby."""
    channel = np.repeat(np.arange(len(axes.length)), np.diff(axes.start))
    room = np.full((len(channel), 2), np.inf)
    index = np.flatnonzero(swings[channel])
    if not len(index):
        return room
    own = channel[index]
    step = ROOM_WIDTHS * mean.width[own] / ROOM_LOOKS
    left = np.column_stack([-axes.tangent[index, 1], axes.tangent[index, 0]])
    offset = np.arange(-ROOM_LOOKS, ROOM_LOOKS + 1)
    place = axes.xy[index][:, None] + left[:, None] * (offset * step[:, None])[..., None]
    height = ground(place.reshape(-1, 2)).reshape(len(index), -1)
    near = np.abs(offset) <= 1
    base = np.nan_to_num(np.where(near, height, np.inf), nan=np.inf).min(axis=1)
    high = ~(height < (base + 0.5 + 3.0 * mean.mean_depth[own])[:, None])
    for side, sign in ((0, 1), (1, -1)):
        beyond = high[:, ROOM_LOOKS:] if sign > 0 else high[:, ROOM_LOOKS::-1]
        free = np.where(beyond.any(axis=1), beyond.argmax(axis=1) * step, np.inf)
        room[index, side] = free
    return room


def _flow_along(network: RiverNetwork, axes: Axes, labels: ChannelLabels) -> FloatArray:
    """Discharge along the axes, (Q,) m3/s."""
    start = network.starts().astype(np.int64)
    xy = network.points()
    step = np.append(np.hypot(*np.diff(xy, axis=0).T), 0.0)
    out = np.empty(len(axes.along))
    for c in range(len(start) - 1):
        s = np.concatenate([[0.0], np.cumsum(step[start[c] : start[c + 1] - 1])])
        part = slice(axes.start[c], axes.start[c + 1])
        flow = labels.point_flow[start[c] : start[c + 1]]
        out[part] = np.interp(axes.along[part] / axes.length[c], s / s[-1], flow)
    return out


class _At(NamedTuple):
    """Stations on lines: offsets by course, place, distance along the line and along the axis, share and belt."""

    start: IndexArray
    course: IndexArray
    xy: FloatArray
    along: FloatArray
    axis: FloatArray
    share: FloatArray
    belt: FloatArray
    channel: IndexArray


def _stations(lines: Lines, spacing: FloatArray, steps: Steps | None = None) -> _At:
    """Lay stations along the lines: evenly, and at the lips and feet of steps.

    Args:
        lines: The lines.
        spacing: (C,) distance between stations by channel, m.
        steps: The steps.
    """
    count = len(lines.channel)
    course = np.repeat(np.arange(count), np.diff(lines.start))
    move = np.concatenate([[0.0], np.hypot(*np.diff(lines.xy, axis=0).T)])
    move[lines.start[:-1]] = 0.0
    total = np.cumsum(move)
    arc = total - np.repeat(total[lines.start[:-1]], np.diff(lines.start))
    length = arc[lines.start[1:] - 1]
    gaps = np.maximum(2, np.ceil(length / spacing[lines.channel]).astype(np.int64))
    owner = np.repeat(np.arange(count), gaps + 1)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(gaps + 1) - gaps - 1, gaps + 1)
    target = rank * (length / gaps)[owner]
    keep = np.ones(len(target), bool)
    # One coordinate for all lines, in which they do not touch; what grows along a line is interpolated in it.
    base = np.concatenate([[0.0], np.cumsum(length + 1.0)])[:-1]
    place = base[course] + arc
    if steps is not None and len(steps.channel):
        owner, target, keep = _with_steps(lines, course, arc, steps, owner, target, (length / gaps)[owner])
    at = base[owner[keep]] + target[keep]
    order = np.argsort(at, kind="stable")
    at, owner = at[order], owner[keep][order]
    values = [
        np.interp(at, place, v) for v in (lines.xy[:, 0], lines.xy[:, 1], arc, lines.axis, lines.share, lines.belt)
    ]
    start = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=count))])
    return _At(
        start, owner, np.column_stack(values[:2]), values[2], values[3], values[4], values[5], lines.channel[owner]
    )


def _with_steps(
    lines: Lines,
    course: IndexArray,
    arc: FloatArray,
    steps: Steps,
    owner: IndexArray,
    target: FloatArray,
    gap: FloatArray,
) -> tuple[IndexArray, FloatArray, NDArray[np.bool_]]:
    """Add stations at the lips, middles and feet of steps, and take out even ones that are close to them."""
    first = {int(c): k for k, c in reversed(list(enumerate(lines.channel)))}
    step_course = np.array([first[int(c)] for c in steps.channel])
    span = float(max(lines.axis.max(), (steps.axis + steps.length).max())) + 1.0
    where = np.concatenate([steps.axis + part * steps.length for part in (0.0, 0.25, 0.5, 0.75, 1.0)])
    own = np.tile(step_course, 5)
    extra = np.interp(own * span + where, course * span + lines.axis, arc)
    inner = (where > 1e-6) & (extra < arc[lines.start[1:] - 1][own] - 1e-6)
    own, extra = own[inner], extra[inner]
    width = float(arc.max()) + 1.0
    known = np.sort(own * width + extra)
    at = owner * width + target
    k = np.searchsorted(known, at)
    away = np.minimum(np.abs(at - known[np.minimum(k, len(known) - 1)]), np.abs(at - known[np.maximum(k - 1, 0)]))
    ends = (target <= 0.0) | (target >= arc[lines.start[1:] - 1][owner] - 1e-9)
    keep = ends | (away > 0.25 * gap)
    return (
        np.concatenate([owner, own]),
        np.concatenate([target, extra]),
        np.concatenate([keep, np.ones(len(own), bool)]),
    )


class _Sizes(NamedTuple):
    """Sections at stations: flow, width, mean depth and the forms."""

    flow: FloatArray
    width: FloatArray
    mean_depth: FloatArray


def _sizes(
    at: _At, axes: Axes, point_flow: FloatArray, slope: FloatArray, k: FloatArray, network: RiverNetwork, layout: Layout
) -> _Sizes:
    flow = _on_axis(point_flow, axes, at.channel, at.axis) * at.share
    wide = network.channel_width[at.channel] * np.sqrt(at.share)
    found = _sized(flow, slope[at.channel], k[at.channel], wide, layout)
    return _Sizes(flow, found.width, found.mean_depth)


def _on_axis(values: FloatArray, axes: Axes, channel: IndexArray, axis: FloatArray) -> FloatArray:
    """Values along axes at places on them."""
    span = float(axes.length.max()) + 1.0
    own = np.repeat(np.arange(len(axes.length)), np.diff(axes.start))
    return np.interp(channel * span + axis, own * span + axes.along, values)


def _axis_profile(
    ground: Ground,
    at: _At,
    sizes: _Sizes,
    axes: Axes,
    graph: Graph,
    slope: FloatArray,
    mean: UniformFlow,
    cell_size: float,
    layout: Layout,
) -> FloatArray:
    """Water surface along the axes, from the lowest ground between the banks of all threads."""
    wet = np.isnan(at.belt)
    tangent = _tangents(at.xy, at.start)
    left = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    offset = np.linspace(-0.5, 0.5, LOOKS)
    place = at.xy[wet][:, None] + left[wet][:, None] * (sizes.width[wet][:, None] * offset)[..., None]
    height = ground(place.reshape(-1, 2)).reshape(-1, LOOKS)
    lowest = np.nan_to_num(height, nan=np.inf).min(axis=1) - layout.profile.freeboard * sizes.mean_depth[wet]
    out = np.full(len(axes.along), np.inf)
    span = float(axes.length.max()) + 1.0
    coordinate = graph.channel * span + axes.along
    k = np.searchsorted(coordinate, at.channel[wet] * span + at.axis[wet])
    for index in (k, k - 1):
        inside = np.clip(index, axes.start[at.channel[wet]], axes.start[at.channel[wet] + 1] - 1)
        np.minimum.at(out, inside, lowest)
    window = np.maximum(layout.profile.smoothing * mean.width, 2.0 * cell_size)
    steepest = layout.profile.grade * slope + layout.profile.steepening
    return falling_profile(out, axes.along, graph, window, steepest, layout.profile.mix)


def _falling(water: FloatArray, start: IndexArray) -> FloatArray:
    """Running minimum along each course, whose ends stay: what was rounded up or down is taken off again."""
    out = np.maximum(water, np.repeat(water[start[1:] - 1], np.diff(start)))
    for a, b in itertools.pairwise(start.tolist()):
        np.minimum.accumulate(out[a:b], out=out[a:b])
    return out


def _tangents(xy: FloatArray, start: IndexArray) -> FloatArray:
    """Unit vectors downstream at stations: of the circle through three of them, at ends of the segment."""
    step = np.diff(xy, axis=0)
    size = np.maximum(np.hypot(*step.T), 1e-12)[:, None]
    unit = step / size
    out = np.empty_like(xy)
    out[1:-1] = unit[:-1] * size[1:] + unit[1:] * size[:-1]
    out[start[:-1]] = unit[np.minimum(start[:-1], len(unit) - 1)]
    out[start[1:] - 1] = unit[start[1:] - 2]
    found: FloatArray = out / np.maximum(np.hypot(*out.T), 1e-12)[:, None]
    return found


def _curvatures(tangent: FloatArray, along: FloatArray, start: IndexArray) -> FloatArray:
    """Turn of the tangent over the distance, 1/m, left above 0; smoothed over half a width, as beds follow bends."""
    cross = tangent[:-1, 0] * tangent[1:, 1] - tangent[:-1, 1] * tangent[1:, 0]
    dot = (tangent[:-1] * tangent[1:]).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.arctan2(cross, dot) / np.diff(along)
    last = start[1:-1] - 1
    turn[last] = 0.0
    padded = np.concatenate([[0.0], turn, [0.0]])
    value = 0.5 * (padded[1:] + padded[:-1])
    ends = np.concatenate([start[:-1], start[1:] - 1])
    value[ends] = 0.0
    for _ in range(SMOOTHED):
        inner = 0.25 * value[:-2] + 0.5 * value[1:-1] + 0.25 * value[2:]
        value[1:-1] = inner
        value[ends] = 0.0
    found: FloatArray = value
    return found


def _courses(
    ground: Ground,
    network: RiverNetwork,
    kind: IndexArray,
    axes: Axes,
    lines: Lines,
    at: _At,
    sizes: _Sizes,
    water: FloatArray,
    steps: Steps,
    slope: FloatArray,
    layout: Layout,
) -> Stations:
    """Put sections on stations, and what lies in the courses."""
    tangent = _tangents(at.xy, at.start)
    # Lines leave and reach their nodes along the axis, on which one channel of a stem goes on as the next.
    begins, ends = lines.ends(axes)
    tangent[at.start[:-1][begins]] = axes.tangent[axes.start[lines.channel[begins]]]
    tangent[at.start[1:][ends] - 1] = axes.tangent[axes.start[lines.channel[ends] + 1] - 1]
    curvature = _curvatures(tangent, at.along, at.start)
    wet = np.isnan(at.belt)
    shape = _sections(network, kind, axes, lines, at, sizes, curvature, steps, layout)
    plain = layout.bed.bars * sizes.mean_depth
    ease = BANK_EASE * sizes.width
    level = np.where(wet, water, water + plain)
    width = np.where(wet, shape.width, np.nan_to_num(at.belt))
    reach = bank_reach(ground, at.xy, tangent, level, width, sizes.width, layout.bed)
    courses = Stations(
        start=at.start,
        channel=lines.channel,
        type=kind[lines.channel],
        thread=lines.thread,
        wet=lines.thread >= 0,
        group=axes.stem[lines.channel],
        from_node=network.channel_from[lines.channel].astype(np.int64),
        to_node=network.channel_to[lines.channel].astype(np.int64),
        xy=at.xy,
        tangent=tangent,
        along=at.along,
        water=level,
        slope=_slopes(level, at.along, at.start),
        width=width,
        depth=np.where(wet, shape.depth, 0.0),
        flow=np.where(wet, sizes.flow, 0.0),
        speed=np.where(wet, sizes.flow / (shape.width * shape.mean_depth), 0.0),
        curvature=curvature,
        lane=shape.lane,
        bend=shape.bend,
        form=shape.form,
        blend=shape.blend,
        reach=reach,
        ease=ease,
        rim=layout.profile.freeboard * sizes.mean_depth,
        form_table=FORM_TABLE,
        falls=no_falls(),
        basins=Basins(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.int64)),
        rocks=Rocks(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0, np.int64)),
    )
    falls = _falls(courses, layout.profile)
    basins, rocks = _marks(courses, at, lines, kind, steps, sizes, layout)
    return dataclasses.replace(courses, falls=falls, basins=basins, rocks=rocks)


class _Shape(NamedTuple):
    width: FloatArray
    mean_depth: FloatArray
    depth: FloatArray
    lane: FloatArray
    bend: FloatArray
    form: IndexArray
    blend: FloatArray


def _sections(
    network: RiverNetwork,
    kind: IndexArray,
    axes: Axes,
    lines: Lines,
    at: _At,
    sizes: _Sizes,
    curvature: FloatArray,
    steps: Steps,
    layout: Layout,
) -> _Shape:
    """Sections at stations; near its lower end each becomes the one with which its stem goes on."""
    own = np.array([TEMPLATES[t].form for t in kind])
    form = np.repeat(own[at.channel][:, None], 2, axis=1)
    lane, bend = np.full(len(at.along), 0.5), np.zeros(len(at.along))
    for t in np.unique(kind):
        here = (kind[at.channel] == t) & np.isnan(at.belt)
        lane[here], bend[here] = bend_shape(curvature[here], sizes.width[here], TEMPLATES[t].lanes)
    vary = _variation(lines, kind, at, sizes, steps, layout)
    width, depth, blend = sizes.width * vary, sizes.mean_depth / vary, np.zeros(len(at.along))
    following = _following(network, axes)
    head = {int(c): k for k, c in reversed(list(enumerate(lines.channel)))}
    next_course = np.array([head[int(following[c])] if following[c] >= 0 else -1 for c in lines.channel])
    goes_on = (next_course[at.course] >= 0) & np.isnan(at.belt)
    target = at.start[np.maximum(next_course, 0)][at.course]
    left = at.along[at.start[1:] - 1][at.course] - at.along
    span = np.minimum(layout.bed.change * sizes.width, 0.5 * at.along[at.start[1:] - 1][at.course])
    t = np.clip(1.0 - left / span, 0.0, 1.0)
    part = np.where(goes_on, t * t * (3.0 - 2.0 * t), 0.0)
    width += part * (sizes.width[target] - width)
    depth += part * (sizes.mean_depth[target] - depth)
    form[:, 1] = np.where(goes_on, form[target, 0], form[:, 0])
    blend = np.where(form[:, 0] == form[:, 1], 0.0, part)
    form[~np.isnan(at.belt)] = FORMS.index("plain")
    return _Shape(width, depth, depth / section_fill(form, blend, lane, bend), lane, bend, form, blend)


def _variation(lines: Lines, kind: IndexArray, at: _At, sizes: _Sizes, steps: Steps, layout: Layout) -> FloatArray:
    """Width over that of uniform flow, (P,): pools are wide and steps narrow, and no bank is even; 1 at nodes.

    The mean depth falls as the width grows, so that the area, and with it the speed, stay.
    """
    drawn = _drawn(lines.channel, layout.seed, 3, 6)
    phase, period = 2.0 * np.pi * drawn[:, :3], 0.7 + 0.7 * drawn[:, 3:]
    widths = at.along / np.maximum(sizes.width, 1e-9)
    vary = np.zeros(len(at.along))
    for k, (size, length) in enumerate(((0.5, 7.0), (0.3, 3.2), (0.2, 1.4))):
        vary += size * np.sin(2.0 * np.pi * widths / length * period[at.course, k] + phase[at.course, k])
    vary *= layout.bed.unevenness
    if len(steps.channel):
        span = float(max(at.axis.max(), steps.end.max())) + 1.0
        above = np.searchsorted(steps.channel * span + steps.axis, at.channel * span + at.axis, side="right") - 1
        above = np.maximum(above, 0)
        pool = np.clip((at.axis - steps.axis[above]) / (steps.end[above] - steps.axis[above]), 0.0, 1.0)
        stepped = np.isin(kind[at.channel], [TYPES.index(name) for name in ROCKS])
        # Each pool bulges by an amount of its own; the lips between them are alike.
        bulge = (
            0.5
            * (1.0 - np.cos(2.0 * np.pi * pool))
            * (0.3 + 1.4 * _drawn(steps.channel, layout.seed, 4, 1)[:, 0])[above]
        )
        vary += np.where(stepped, layout.bed.pool_width * (2.0 * bulge - 1.0), 0.0)
    ends = np.minimum(at.along, at.along[at.start[1:] - 1][at.course] - at.along)
    return 1.0 + vary * np.clip(ends / np.maximum(sizes.width, 1e-9), 0.0, 1.0)


def _drawn(channel: IndexArray, seed: int, salt: int, columns: int) -> FloatArray:
    """Numbers in [0, 1) for rows in the order of channels, (n, columns): each channel has random ones of its own."""
    names, count = np.unique(channel, return_counts=True)
    made = [np.empty((0, columns))]
    for c, n in zip(names.tolist(), count.tolist(), strict=True):
        made.append(np.random.default_rng([seed, c, salt]).uniform(size=(n, columns)))
    return np.concatenate(made)


def _following(network: RiverNetwork, axes: Axes) -> IndexArray:
    """Channel with which each channel's stem goes on; -1 at its end."""
    following = leaving_channels(network)[network.channel_to]
    return np.where((following >= 0) & (axes.stem[following] == axes.stem), following, -1)


def _slopes(water: FloatArray, along: FloatArray, start: IndexArray) -> FloatArray:
    """Slope of the water at stations: the mean of that of both sides."""
    with np.errstate(divide="ignore", invalid="ignore"):
        fall = -np.diff(water) / np.diff(along)
    fall[start[1:-1] - 1] = np.nan
    both = np.stack([np.concatenate([[np.nan], fall]), np.concatenate([fall, [np.nan]])])
    found: FloatArray = np.maximum(np.nanmean(both, axis=0), 0.0)
    return found


def _bank_rise(away: FloatArray, ease: FloatArray) -> FloatArray:
    """Rise of a bank over the water's edge, m, as the kernel has it."""
    t = np.minimum(away / ease, 1.0)
    eased = ease * t**4 * (t * (t - 3.0) + 2.5) + (away - t * ease)
    found: FloatArray = GENTLEST_BANK * away + (math.tan(math.radians(STEEPEST_BANK)) - GENTLEST_BANK) * eased
    return found


def bank_reach(
    ground: Ground,
    xy: FloatArray,
    tangent: FloatArray,
    water: FloatArray,
    width: FloatArray,
    thread: FloatArray,
    params: BedParams,
) -> FloatArray:
    """Distance from the water within which banks of 35 degrees come up to the ground, or the farthest there may be.

    Args:
        ground: Height of the ground.
        xy: (P, 2) stations.
        tangent: (P, 2).
        water: (P,) level, m.
        width: (P,) of the water, or of the plain between threads, m.
        thread: (P,) width of the water of a thread, m.
        params: Constants.
    """
    farthest = np.maximum(params.farthest * thread, 2.0)
    part = (np.arange(1, BANK_LOOKS + 1) / BANK_LOOKS) ** 1.5
    left = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    away = farthest[:, None] * part
    rise = _bank_rise(away, BANK_EASE * thread[:, None])
    found = np.zeros(len(water))
    for sign in (1.0, -1.0):
        offset = sign * (0.5 * width[:, None] + away)
        place = xy[:, None] + left[:, None] * offset[..., None]
        height = ground(place.reshape(-1, 2)).reshape(len(water), -1)
        above = np.nan_to_num(height, nan=-np.inf) > water[:, None] + rise
        # The first look from which on nothing is above the bank.
        outermost = BANK_LOOKS - 1 - above[:, ::-1].argmax(axis=1)
        need = np.where(above.any(axis=1), part[np.minimum(outermost + 1, BANK_LOOKS - 1)], part[0]) * farthest
        found = np.maximum(found, need)
    # Room for the rounded rim, and for the outermost part, in which what is left of the cut fades.
    reach = np.minimum(found + 0.5 * BANK_EASE * thread, farthest) / FADES
    wide = reach.copy()
    wide[1:] = np.maximum(wide[1:], reach[:-1])
    wide[:-1] = np.maximum(wide[:-1], reach[1:])
    out: FloatArray = wide
    return out


def no_falls() -> Falls:
    """Return steps of which there are none."""
    none = np.empty(0)
    whole = np.empty(0, np.int64)
    nowhere = np.empty((0, 2))
    return Falls(nowhere, nowhere, none, none, none, none, none.astype(bool), whole, none, whole, whole)


def _falls(courses: Stations, params: ProfileParams) -> Falls:
    """Runs of stations along which the water is steeper than a cascade's least slope."""
    course = courses.station_course
    with np.errstate(divide="ignore", invalid="ignore"):
        steep = -np.diff(courses.water) > params.cascade_slope * np.diff(courses.along)
    steep &= (course[1:] == course[:-1]) & courses.wet[course[1:]]
    if not steep.any():
        return no_falls()
    before, after = np.concatenate([[False], steep[:-1]]), np.concatenate([steep[1:], [False]])
    joins = np.concatenate([[False], course[1:-1] == course[:-2]]) if len(steep) > 1 else np.zeros(1, bool)
    begin = np.flatnonzero(steep & ~(before & joins))
    end = np.flatnonzero(steep & ~(after & np.append(joins[1:], False))) + 1
    drop = courses.water[begin] - courses.water[end]
    length = courses.along[end] - courses.along[begin]
    speed = courses.speed[begin]
    ahead = courses.xy[end] - courses.xy[begin]
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-12)[:, None]
    throw = speed * np.sqrt(2.0 * drop / 9.81)
    free = (drop > params.waterfall) & (length < 1.5 * throw)
    along = courses.along[begin]
    return Falls(
        courses.xy[begin], ahead, courses.water[begin], drop, length, speed, free, course[begin], along, begin, end
    )


def _marks(
    courses: Stations, at: _At, lines: Lines, kind: IndexArray, steps: Steps, sizes: _Sizes, layout: Layout
) -> tuple[Basins, Rocks]:
    """Basins in the pools between steps and below falls; rocks at their lips and in runs."""
    first = {int(c): k for k, c in reversed(list(enumerate(lines.channel)))}
    course = np.array([first[int(c)] for c in steps.channel], np.int64)
    drawn = _drawn(steps.channel, layout.seed, 2, 2)
    span = float(max(at.axis.max(), 1.0)) + 1.0
    coordinate = at.course * span + at.axis

    def station(own: IndexArray, axis: FloatArray) -> tuple[FloatArray, ...]:
        where = own * span + axis
        values = (
            at.xy[:, 0],
            at.xy[:, 1],
            courses.tangent[:, 0],
            courses.tangent[:, 1],
            courses.width,
            sizes.mean_depth,
        )
        return tuple(np.interp(where, coordinate, v) for v in values)

    foot = steps.axis + steps.length
    pool = steps.end - foot
    x, y, _, _, width, depth = station(course, foot + 0.5 * pool)
    radius = np.minimum(0.6 * pool, 0.6 * width) * (0.8 + 0.3 * drawn[:, 0])
    hollow = layout.bed.basin_depth * depth * (0.6 + 0.8 * drawn[:, 1])
    drop = np.maximum(steps.upper - steps.lower, 0.0)
    # Scour under falling water, 1.9 h^0.225 q^0.54 below its surface [Veronese1937].
    middle = (courses.start[:-1] + courses.start[1:]) // 2
    unit = courses.flow[middle[course]] / np.maximum(width, 1e-6)
    scour = np.minimum(1.9 * drop**0.225 * unit**0.54, 0.35 * width)
    hollow = np.where(steps.free, np.maximum(hollow, scour - depth), hollow)
    keep = (radius > 0.05 * width) & (pool > 0.15 * width)
    basins = Basins(np.column_stack([x, y])[keep], radius[keep], hollow[keep], course[keep])
    return basins, _rocks(courses, at, lines, kind, steps, course, station, layout.seed)


def _rocks(
    courses: Stations,
    at: _At,
    lines: Lines,
    kind: IndexArray,
    steps: Steps,
    course: IndexArray,
    station: Callable[[IndexArray, FloatArray], tuple[FloatArray, ...]],
    seed: int,
) -> Rocks:
    # Side by side along each lip, but for that at the head of a channel, which is no step of its own.
    inner = np.flatnonzero(steps.axis > 0.0)
    lips = np.repeat(inner, RIM_ROCKS)
    own, axis = [course[lips]], [steps.axis[lips]]
    lane = np.tile((np.arange(RIM_ROCKS) + 0.5) / RIM_ROCKS - 0.5, len(inner))
    drawn = _drawn(steps.channel[lips], seed, 5, 4)
    across = [lane + (drawn[:, 0] - 0.5) / RIM_ROCKS]
    shift, size, tall = [0.22 * drawn[:, 1] - 0.14], [0.07 + 0.12 * drawn[:, 2]], [drawn[:, 3]]
    for name, dense in ROCKS.items():
        for k in np.flatnonzero((kind[lines.channel] == TYPES.index(name)) & courses.wet).tolist():
            part = slice(courses.start[k], courses.start[k + 1])
            number = round(dense * courses.along[part][-1] / float(courses.width[part].mean()))
            random = np.random.default_rng([seed, int(lines.channel[k]), 6])
            own.append(np.full(number, k))
            axis.append(random.uniform(0.0, at.axis[part][-1], number))
            side = random.uniform(0.15, 0.5, number) * random.choice([-1.0, 1.0], number)
            across.append(side)
            shift.append(np.zeros(number))
            size.append(0.16 * random.uniform(0.3, 1.0, number) ** 1.5)
            tall.append(random.uniform(size=number))
    which, place = np.concatenate(own).astype(np.int64), np.concatenate(axis)
    x, y, tx, ty, width, depth = station(which, place)
    off, ahead = np.concatenate(across) * width, np.concatenate(shift) * width
    radius = np.concatenate(size) * width
    xy = np.column_stack([x + tx * ahead - ty * off, y + ty * ahead + tx * off])
    height = np.minimum(depth * (0.5 + 1.2 * np.concatenate(tall)), 0.9 * radius)
    keep = radius > 0.02
    return Rocks(xy[keep], radius[keep], height[keep], which[keep])
