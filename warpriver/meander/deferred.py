"""Deferred junctions: small tributaries that run along the belt of a river before they run into it, as the Yazoo does.

A river builds its banks higher than the plain beside it. A small tributary that comes to its belt then runs along it,
down to where a bend reaches as far out.
"""

from __future__ import annotations

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.engine.state import State
from warpriver.extras import IMPORTING
from warpriver.graph.authoring import smooth_line
from warpriver.graph.edits import JUNCTION_CLEARANCE
from warpriver.meander.courses import Course, Refusal, falling_bed
from warpriver.meander.diversions import Diversion
from warpriver.network import RiverNetwork
from warpriver.params import AvulsionParams

with IMPORTING:
    from scipy.ndimage import maximum_filter1d
    from scipy.spatial import cKDTree

__all__ = ["defer_junction"]

# Widths of the river: how far downstream the new mouth is sought along its axis, from and to; what the tributary keeps
# away from its bends; and how far along its axis a bend is seen.
NEAREST, FARTHEST = 10.0, 60.0
CLEAR, SEEN = 2.0, 4.0
# Places of the course for a width of the river; it is smooth in between.
PLACES = 1.0


def defer_junction(state: State, channel: int, params: AvulsionParams) -> Diversion | Refusal:
    """Find a course along the river for a tributary, from above its mouth to a bend farther downstream.

    The course keeps two widths of the river outside of its bends, and ends at the one that reaches farthest out on the
    side of the tributary, 10 to 60 widths downstream along the axis. It does not go past another tributary of that
    side, and the rules of new courses hold: no steeper rise and no deeper cut than they allow, and the bed falls.

    Args:
        state: The network and its ground.
        channel: Index of the tributary.
        params: How steeply the ground may rise, and how deep a cut may be.

    Returns:
        The diversion, or why there is none; nothing is changed.
    """
    network, start = state.network, state.network.starts()
    node = int(network.channel_to[channel])
    place = network.node_xy[node]
    told = float(place[0]), float(place[1])
    beside = np.flatnonzero((network.channel_to == node) & (np.arange(network.channel_count) != channel))
    leaving = np.flatnonzero(network.channel_from == node)
    if len(beside) != 1 or len(leaving) != 1:
        return Refusal("it does not flow into a river", told)
    width = float(network.channel_width[leaving[0]])
    points = _river_below(network, int(leaving[0]), 4.0 * FARTHEST * width)
    xy = network.points()
    river = xy[points] - place
    along = np.hypot(*river.T) <= FARTHEST * width
    river, points = river[along], points[along]
    if len(river) < 2 or np.hypot(*river[-1]) < NEAREST * width:
        return Refusal("the river is too short", told)
    axis = river[-1] / np.hypot(*river[-1])
    own = xy[int(start[channel]) : int(start[channel + 1])] - place
    upper = xy[int(start[beside[0]]) : int(start[beside[0] + 1])] - place
    left = np.array([-axis[1], axis[0]])
    # To the side of the river on which it lies farther upstream.
    away = int(min(len(own) - 1, np.ceil(SEEN * width / float(state.spacing.numpy()[channel]))))
    side = 1.0 if own[-1 - away] @ left >= 0.0 else -1.0
    out = side * left
    x, y = river @ axis, river @ out
    stop = _first_of_side(network, points, channel, out)
    mouths = np.flatnonzero((x >= NEAREST * width) & (np.arange(len(x)) < stop))
    if not len(mouths):
        return Refusal("another tributary, or the end of the river, is too near", told)
    mouth = int(mouths[y[mouths].argmax()])
    # How far out the bends reach, by the place along the axis.
    bends = np.concatenate([upper @ axis, x]), np.concatenate([upper @ out, y])
    step = width / PLACES
    count = max(2, int(np.ceil((x[mouth] + FARTHEST * width) / step)) + 1)
    cell = np.floor((bends[0] + FARTHEST * width) / step).astype(int)
    reach = np.full(count, -np.inf)
    inside = (cell >= 0) & (cell < count)
    np.maximum.at(reach, cell[inside], bends[1][inside])
    reach = maximum_filter1d(reach, 2 * int(SEEN * PLACES) + 1, mode="nearest") + CLEAR * width
    # It leaves at its last point outside of them.
    px, py = own @ axis, own @ out
    at = np.clip(np.floor((px + FARTHEST * width) / step).astype(int), 0, count - 1)
    free = np.flatnonzero((py >= reach[at]) & (px < x[mouth] - 2.0 * SEEN * width))
    free = free[(free >= JUNCTION_CLEARANCE) & (free < len(own) - JUNCTION_CLEARANCE)]
    if not len(free):
        return Refusal("it does not come from beside the river's belt", told)
    leaves = int(free[-1])
    places = np.arange(at[leaves] + 1, int((x[mouth] + FARTHEST * width) / step) - int(SEEN * PLACES))
    places = places[np.isfinite(reach[places])]
    line = np.stack([(places + 0.5) * step - FARTHEST * width, reach[places]], axis=1)
    corners = line[:, :1] * axis + line[:, 1:] * out
    end = int(points[mouth])
    corners = place + np.concatenate([own[leaves : leaves + 1], corners, river[mouth : mouth + 1]])
    course = smooth_line(corners, float(state.spacing.numpy()[channel]))
    met = _met(state, channel, leaves, end, course)
    if met is not None:
        return met
    return _on_ground(state, channel, int(start[channel]) + leaves, end, course, params)


def _river_below(network: RiverNetwork, channel: int, length: float) -> IndexArray:
    """Points of the river that goes on in a channel, from its head, over about a length in m."""
    start, lengths = network.starts(), network.channel_lengths()
    found: list[IndexArray] = []
    walked, seen = 0.0, set[int]()
    while channel not in seen and walked < length:
        seen.add(channel)
        found.append(np.arange(start[channel] + bool(found), start[channel + 1]))
        walked += float(lengths[channel])
        following = np.flatnonzero(network.channel_from == network.channel_to[channel])
        if len(following) != 1:
            break
        channel = int(following[0])
    return np.concatenate(found)


def _first_of_side(network: RiverNetwork, points: IndexArray, channel: int, out: FloatArray) -> int:
    """Number of points of a river above the first mouth of another tributary of a side."""
    start = network.starts()
    owner = np.searchsorted(start, points, side="right") - 1
    for c in dict.fromkeys(owner.tolist()):
        node = network.channel_to[c]
        for other in np.flatnonzero((network.channel_to == node) & ~np.isin(np.arange(network.channel_count), owner)):
            line = network.point_xy[int(start[other]) : int(start[other + 1])].numpy().astype(np.float64)
            away = line[max(len(line) // 2, 0)] - line[-1]
            if other != channel and away @ out > 0.0:
                return int(np.flatnonzero(owner == c)[-1])
    return len(points)


def _met(state: State, channel: int, leaves: int, end: int, course: FloatArray) -> Refusal | None:
    """Why a course cannot be, as it comes to its own channel, or to another one before its end; None where it can."""
    network, start = state.network, state.network.starts()
    xy, width = network.points(), network.channel_width
    owner = np.repeat(np.arange(network.channel_count), np.diff(start))
    river = int(owner[end])
    reach = float(width[channel] + width.max())
    near = (xy >= course.min(axis=0) - reach).all(axis=1) & (xy <= course.max(axis=0) + reach).all(axis=1)
    index = np.flatnonzero(near)
    # The rest of its own course falls dry; next to both ends it is near what it leaves and what it comes to.
    first = int(start[channel])
    index = index[(owner[index] != channel) | (index < first + leaves)]
    spacing = float(state.spacing.numpy()[channel])
    skip = max(2, int(np.ceil(2.0 * float(width[channel]) / spacing)))
    last = max(2, int(np.ceil(2.0 * float(width[river]) / spacing)))
    line = course[skip : len(course) - last]
    if not len(line) or not len(index):
        return None
    away, nearest = cKDTree(xy[index]).query(line)
    touch = 0.5 * (float(width[channel]) + width[owner[index[nearest]]])
    hit = np.flatnonzero(away < np.maximum(touch, spacing))
    if not len(hit):
        return None
    what = int(owner[index[nearest[hit[0]]]])
    x, y = line[hit[0]].tolist()
    return Refusal(f"it meets channel {int(network.channel_id[what])}", (x, y))


def _on_ground(
    state: State, channel: int, point: int, end: int, line: FloatArray, params: AvulsionParams
) -> Diversion | Refusal:
    """The diversion along a line, with its bed, where the ground allows it."""
    ground = np.zeros(len(line)) if state.terrain is None else state.terrain.sample(line)
    if not np.isfinite(ground).all():
        x, y = line[int(np.isnan(ground).argmax())].tolist()
        return Refusal("there is no ground", (x, y))
    bed = ground if state.terrain is None else falling_bed(line, ground, params.fall)
    course = Course(line, ground, bed)
    rise = np.diff(ground) / np.hypot(*np.diff(line, axis=0).T)
    if rise.max() > params.steepest_rise:
        x, y = line[int(rise.argmax())].tolist()
        return Refusal(f"the ground rises by more than {params.steepest_rise:g} m/m", (x, y))
    if course.deepest_cut > params.deepest_cut * float(state.network.channel_depth[channel]):
        x, y = line[int((ground - bed).argmax())].tolist()
        return Refusal(f"the cut would be deeper than {params.deepest_cut:g} depths", (x, y))
    return Diversion.along(state.network, channel, point, end, course)
