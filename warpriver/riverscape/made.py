"""What a riverscape is made of between two edits, and what each edit makes of it; nothing that was made is changed."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.edits.ground import edit_terrain, edited_box
from warpriver.edits.values import Edit, EditTerrain
from warpriver.errors import InputError
from warpriver.network import RiverNetwork
from warpriver.riverscape import edits
from warpriver.riverscape.beds import ground_of
from warpriver.riverscape.courses import TYPES, Course, CourseFrame, CourseMap, Log, Rock, courses_near, frame_of
from warpriver.riverscape.primitives import KINDS, Merge, Node, Primitives, Replace, check_primitives
from warpriver.riverscape.programs import TileFrame
from warpriver.riverscape.rivers import Rivers
from warpriver.riverscape.seeding import SeedingParams, Window, frame_of_water, margin_of, seed_layers
from warpriver.riverscape.templates import type_index
from warpriver.riverscape.water import Water
from warpriver.terrain import Terrain

__all__ = ["Layer", "Made", "leaves_of", "tree_of"]


# Beyond this part of the depth the ground may not lie below the water of a course that is laid anew.
HANGING = 1.0
# How far level ground beside a course decides on it, in widths.
ROOM_WIDTHS = 8.0


@dataclasses.dataclass(frozen=True, eq=False)
class Layer:
    """A part of the water that has a name.

    Attributes:
        name: Its name.
        node: Its primitives, merged and replaced.
        merged: Whether it is merged with what is below it, rather than put in its place.
    """

    name: str
    node: Node
    merged: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Made:
    """Ground, rivers and water, to be evaluated.

    Attributes:
        terrain: The ground.
        rivers: Courses and beds, with rocks and logs.
        detail, seed, params: Of the water's primitives.
        tree: The water as a tree of a user's own, or None.
        water_edits: Edits of the water, in order; they are done again where it is seeded anew.
        frames: What the bits of courses and water are relative to: those of what was made first.
        window: (west, south, east, north) in m that water is needed in; by default everywhere.
    """

    terrain: Terrain
    rivers: Rivers
    detail: float
    seed: int
    params: SeedingParams
    tree: Node | None = None
    water_edits: tuple[Edit, ...] = ()
    frames: tuple[CourseFrame, TileFrame] | None = None
    window: Window | None = None

    @functools.cached_property
    def courses(self) -> CourseMap:
        """The courses, to be asked at any place; with a window those that come near it."""
        courses, rocks, logs = self._all_courses, self.rivers.rocks(self._reached), self.rivers.logs()
        frame = None if self.frames is None else self.frames[0]
        if self._reached is not None:
            frame = frame_of(courses) if frame is None else frame
            courses = courses_near(courses, self._reached)
        return CourseMap(courses, rocks=rocks, logs=logs, frame=frame, device=self.terrain.device)

    @functools.cached_property
    def _all_courses(self) -> list[Course]:
        return self.rivers.courses()

    @functools.cached_property
    def _frame(self) -> TileFrame | None:
        """What the bits of the water are relative to; None for a tree of a user's."""
        if self.frames is not None:
            return self.frames[1]
        return frame_of_water(self._all_courses, self.detail) if self.tree is None else None

    @functools.cached_property
    def _reached(self) -> Window | None:
        """The window with what has to be made around it."""
        if self.window is None or self._frame is None:
            return None
        west, south, east, north = self.window
        wide = margin_of(self._frame, self.detail)
        return west - wide, south - wide, east + wide, north + wide

    @functools.cached_property
    def layers(self) -> tuple[Layer, ...]:
        """The water's layers from the bottom up, with all edits."""
        if self.tree is not None:
            found: tuple[Layer, ...] = (Layer("body", self.tree),)
        else:
            made = seed_layers(self.courses, self.detail, self.seed, self.params, self._reached)
            found = tuple(Layer(name, node) for name, node in made.items())
        for edit in self.water_edits:
            found = _edit_layers(edit, found, self, anew=True)
        return found

    @functools.cached_property
    def surface(self) -> Water:
        """The blend-flow tree of the water."""
        return Water(tree_of(self.layers), frame=self._frame, device=self.terrain.device)

    def with_edit(self, edit: Edit) -> Made:
        """Return what an edit makes of this.

        Raises:
            ValueError: It cannot be done.
        """
        if type(edit) not in DOERS:
            raise InputError(f"{edit.name} is no edit of a riverscape; use {', '.join(sorted(k.name for k in DOERS))}")
        known = self
        if self.frames is None:
            known = dataclasses.replace(self, frames=(self.courses.frame, self.surface.frame))
            known.__dict__.update(courses=self.courses, layers=self.layers)
        found = DOERS[type(edit)](edit, known)
        # What cannot be evaluated is told now, while nothing has changed.
        _ = found.surface
        return found


def tree_of(layers: Sequence[Layer]) -> Node:
    """Return the tree of layers, each upon what is below it."""
    node = layers[0].node
    for layer in layers[1:]:
        node = Merge((node, layer.node)) if layer.merged else Replace(node, layer.node)
    return node


def leaves_of(node: Node) -> Primitives:
    """Return all leaves of a tree, in its order."""
    if isinstance(node, Primitives):
        return node
    children = node.children if isinstance(node, Merge) else (node.under, node.over)
    return Primitives.concatenate([leaves_of(child) for child in children])


# ---- water


def _edit_layers(edit: Edit, layers: tuple[Layer, ...], made: Made, anew: bool) -> tuple[Layer, ...]:
    """Do an edit of the water; ``anew``: on water that may have changed since, where what is gone is left alone."""
    try:
        return _edited_layers(edit, layers, made)
    except InputError:
        if anew:
            return layers
        raise


def _edited_layers(edit: Any, layers: tuple[Layer, ...], made: Made) -> tuple[Layer, ...]:
    names = [layer.name for layer in layers]
    if isinstance(edit, edits.AddWater):
        if edit.layer in names:
            raise InputError(f"there is a layer {edit.layer!r} already; give the new one another name")
        return (*layers, Layer(edit.layer, _placed(edit, layers, made), edit.operator == "merge"))
    if edit.layer is not None and edit.layer not in names:
        raise InputError(f"there is no layer {edit.layer!r}; there are {', '.join(names)}")
    found: list[Layer] = []
    count = 0
    for below, layer in enumerate(layers):
        node: Node | None = layer.node
        if edit.layer in (None, layer.name):
            node, number = _map_leaves(layer.node, functools.partial(_edit_rows, edit))
            count += number
            if isinstance(edit, edits.ReplaceWater) and number:
                new = _placed(edit, layers[:below] or layers, made)
                node = new if node is None else Merge((node, new))
        if node is not None:
            found.append(dataclasses.replace(layer, node=node))
    if not count:
        raise InputError(f"{edit.name} finds no primitive that is meant; look at scene.layers")
    if not found or found[0].name != names[0]:
        raise InputError(f"nothing would be left of the water's lowest layer, {names[0]!r}; leave some of it")
    return tuple(found)


def _placed(edit: Any, layers: Sequence[Layer], made: Made) -> Node:
    """The tree of an edit, put on the water where it is relative to it."""
    tree = edits.node_of(edit.tree)
    if not edit.relative:
        return tree
    rows = leaves_of(tree)
    low, high = rows.center.min(axis=0), rows.center.max(axis=0)

    def near(rows: Primitives) -> tuple[Primitives, int]:
        reach = rows.radius[:, None]
        kept = ((rows.center + reach > low) & (rows.center - reach < high)).all(axis=1)
        return rows[kept], 0

    part = _map_leaves(tree_of(layers), near)[0]
    if part is None:
        raise _no_water(low)
    below = Water(part, frame=None if made.frames is None else made.frames[1], device=made.terrain.device)

    def put(rows: Primitives) -> tuple[Primitives, int]:
        here, course = below.at(rows.center, 0.0), made.courses.survey(rows.center)
        dry = ~(here.weight > 0.0)
        if dry.any():
            raise _no_water(rows.center[int(dry.argmax())])
        gradient = np.where((course.point >= 0)[:, None], course.gradient, 0.0)
        return rows.replace(
            level=rows.level + here.still, velocity=rows.velocity + here.velocity, gradient=rows.gradient + gradient
        ), len(rows)

    node, _ = _map_leaves(tree, put)
    assert node is not None
    return node


def _no_water(xy: FloatArray) -> InputError:
    return InputError(
        f"there is no water at ({xy[0]:g}, {xy[1]:g}), where a primitive is to lie; move it, or give relative=False"
    )


def _map_leaves(node: Node, change: Callable[[Primitives], tuple[Primitives, int]]) -> tuple[Node | None, int]:
    """Change the leaves of a tree; nodes of which nothing is left go. Returns the number that were meant as well."""
    if isinstance(node, Primitives):
        rows, count = change(node)
        return (rows if len(rows) else None), count
    if isinstance(node, Merge):
        parts = [_map_leaves(child, change) for child in node.children]
        kept = tuple(part for part, _ in parts if part is not None)
        return (Merge(kept) if kept else None), sum(count for _, count in parts)
    (under, below), (over, above) = (_map_leaves(child, change) for child in (node.under, node.over))
    if under is None:
        return None, below + above
    return (under if over is None else Replace(under, over)), below + above


def _edit_rows(edit: Any, rows: Primitives) -> tuple[Primitives, int]:
    meant = np.ones(len(rows), bool)
    if edit.center is not None:
        meant &= np.hypot(*(rows.center - edit.center).T) <= edit.radius
    if edit.kind is not None:
        meant &= rows.kind == KINDS[edit.kind]
    count = int(meant.sum())
    if isinstance(edit, (edits.RemoveWater, edits.ReplaceWater)):
        return rows[~meant], count
    if isinstance(edit, edits.MoveWater):
        return rows.replace(center=np.where(meant[:, None], rows.center + edit.by, rows.center)), count
    return _changed_rows(edit, rows, meant), count


def _changed_rows(edit: edits.ChangeWater, rows: Primitives, meant: FlagArray) -> Primitives:
    for name, value, factor in (*((*pair, False) for pair in edit.set), *((*pair, True) for pair in edit.times)):
        if name in edits.COLUMNS:
            old = getattr(rows, name)
            new = old * value if factor else np.broadcast_to(np.asarray(value, np.float64), old.shape)
            rows = rows.replace(**{name: np.where(meant[:, None] if old.ndim == 2 else meant, new, old)})
            continue
        shape = rows.shape.copy()
        for kind in np.unique(rows.kind[meant]).tolist():
            column = edits.shape_column(kind, name)
            if column is None:
                words = {number: word for word, number in KINDS.items()}
                raise InputError(f"a {words.get(kind, kind)} has no {name}; name a kind that has")
            own = meant & (rows.kind == kind)
            shape[own, column] = shape[own, column] * value if factor else value
        rows = rows.replace(shape=shape)
    check_primitives(rows)
    return rows


def _water(edit: Edit, made: Made) -> Made:
    layers = _edit_layers(edit, made.layers, made, anew=False)
    found = dataclasses.replace(made, water_edits=(*made.water_edits, edit))
    # What does not change need not be made again.
    found.__dict__.update(courses=made.courses, layers=layers)
    return found


# ---- rocks and logs


def _surface_at(made: Made, xy: tuple[float, float], label: str) -> float:
    """Level of the water at a place, or of the ground where there is none, m."""
    here = made.courses.survey([xy])
    if here.point[0] >= 0 and here.depth[0] > 0.0:
        return float(here.level[0])
    ground = float(made.rivers.beds.heights(np.array([xy]))[0][0])
    if not np.isfinite(ground):
        raise InputError(f"{label} ({xy[0]:g}, {xy[1]:g}) lies off the ground; give a place on it")
    return ground


def _add_rock(edit: edits.AddRock, made: Made) -> Made:
    top = _surface_at(made, edit.center, "center") + edit.height
    return _obstacles(made, (*made.rivers.obstacles, Rock(edit.center, edit.diameter, top)))


def _add_log(edit: edits.AddLog, made: Made) -> Made:
    middle = (0.5 * (edit.start[0] + edit.end[0]), 0.5 * (edit.start[1] + edit.end[1]))
    top = _surface_at(made, middle, "the middle of the log") + edit.height
    return _obstacles(made, (*made.rivers.obstacles, Log(edit.start, edit.end, edit.diameter, top)))


def _obstacles(made: Made, obstacles: Sequence[Rock | Log], kept: IndexArray | None = None) -> Made:
    return dataclasses.replace(made, rivers=made.rivers.with_obstacles(obstacles, kept))


def _middle(each: Rock | Log) -> FloatArray:
    return np.array(each.center if isinstance(each, Rock) else np.mean([each.start, each.end], axis=0), np.float64)


def _away(each: Rock | Log, at: tuple[float, float]) -> float:
    """Distance of a place from a rock or a log, m; below 0 on it."""
    a, b = (np.array(v, np.float64) for v in ((each.center,) * 2 if isinstance(each, Rock) else (each.start, each.end)))
    toward = b - a
    part = np.clip((np.array(at) - a) @ toward / max(float(toward @ toward), 1e-12), 0.0, 1.0)
    return float(np.hypot(*(np.array(at) - a - part * toward)) - 0.5 * each.diameter)


def _nearest(made: Made, at: tuple[float, float]) -> tuple[Rock | Log, Made]:
    """The rock or log at a place, and what is left without it."""
    own = made.rivers.stations.rocks
    user = made.rivers.obstacles
    far = np.concatenate([np.hypot(*(own.xy - at).T) - own.radius, [_away(each, at) for each in user]])
    if not len(far) or far.min() > 0.25:
        away = f"the nearest is {far.min():.3g} m away" if len(far) else "there is none at all"
        raise InputError(f"at ({at[0]:g}, {at[1]:g}) lies no rock and no log; {away}")
    k = int(far.argmin())
    if k >= len(own):
        rest = [each for number, each in enumerate(user) if number != k - len(own)]
        return user[k - len(own)], _obstacles(made, rest)
    rows = np.arange(len(own))
    center = (float(own.xy[k, 0]), float(own.xy[k, 1]))
    rock = Rock(center, float(2.0 * own.radius[k]), float(made.rivers.beds.heights(own.xy[k : k + 1])[0][0]))
    return rock, _obstacles(made, user, rows[rows != k])


def _remove_obstacle(edit: edits.RemoveObstacle, made: Made) -> Made:
    return _nearest(made, edit.at)[1]


def _move_obstacle(edit: edits.MoveObstacle, made: Made) -> Made:
    found, rest = _nearest(made, edit.at)
    middle = _middle(found)
    height = found.top - _surface_at(made, (float(middle[0]), float(middle[1])), "at")
    top = _surface_at(rest, edit.to, "to") + height
    by = np.array(edit.to) - middle

    def moved(place: tuple[float, float]) -> tuple[float, float]:
        return float(place[0] + by[0]), float(place[1] + by[1])

    new: Rock | Log
    if isinstance(found, Rock):
        new = Rock(moved(found.center), found.diameter, top)
    else:
        new = Log(moved(found.start), moved(found.end), found.diameter, top)
    return _obstacles(rest, (*rest.rivers.obstacles, new))


# ---- rivers


def _check_channel(channel: int, count: int) -> None:
    if channel >= count:
        raise InputError(f"channel is {channel}; there are {count}, from 0 to {count - 1}")


def _own_courses(made: Made, courses: list[Course], terrain: Terrain | None = None) -> Made:
    ground = made.terrain if terrain is None else terrain
    return dataclasses.replace(made, terrain=ground, rivers=Rivers.of_courses(ground, courses, made.rivers.obstacles))


def _retype(edit: edits.RetypeChannel, made: Made) -> Made:
    network = made.rivers.network
    if network is None:
        courses = made.rivers.courses()
        _check_channel(edit.channel, len(courses))
        name = TYPES[type_index(edit.type)]
        new = [dataclasses.replace(c, channel_type=name) if k == edit.channel else c for k, c in enumerate(courses)]
        return _own_courses(made, new)
    _check_channel(edit.channel, network.channel_count)
    types: Any = made.rivers.types
    if types is not None:
        types = types.retyped(edit.channel, edit.type)
    else:
        names = [TYPES[k] for k in made.rivers.kind]
        names[edit.channel] = edit.type
        types = names
    changed = np.zeros(network.channel_count, bool)
    changed[edit.channel] = True
    # The sections of what flows into it become its own before the node.
    leveled = changed.copy()
    changed |= network.channel_to == network.channel_from[edit.channel]
    return _anew(made, made.terrain, network, types, changed, leveled=leveled)


def _redraw(edit: edits.RedrawCourse, made: Made) -> Made:
    network, line = made.rivers.network, np.array(edit.xy)
    if network is None:
        courses = made.rivers.courses()
        _check_channel(edit.channel, len(courses))
        course = courses[edit.channel]
        i, j = _section(np.asarray(course.xy), line, edit.channel)
        new = [_redrawn(course, i, j, line) if k == edit.channel else c for k, c in enumerate(courses)]
        return _own_courses(made, new)
    _check_channel(edit.channel, network.channel_count)
    network = _redrawn_network(network, edit.channel, line)
    changed = np.arange(network.channel_count) == edit.channel
    found = _anew(made, made.terrain, network, _types(made), changed, redrawn=changed)
    _check_hanging(found, edit.channel)
    return found


def _types(made: Made) -> Any:
    return made.rivers.types if made.rivers.types is not None else [TYPES[k] for k in made.rivers.kind]


def _section(xy: FloatArray, line: FloatArray, channel: int) -> tuple[int, int]:
    """Points of a channel that are nearest to both ends of a line."""
    i, j = (int(np.hypot(*(xy - end).T).argmin()) for end in (line[0], line[-1]))
    if i >= j:
        raise InputError(f"xy runs upstream along channel {channel}, or nowhere; draw it downstream")
    return i, j


def _redrawn(course: Course, i: int, j: int, line: FloatArray) -> Course:
    """A course with another line between two of its points, along which its values go on evenly."""
    old = np.asarray(course.xy)
    step = float(np.median(np.hypot(*np.diff(old, axis=0).T)))
    drawn = _even(np.concatenate([old[i : i + 1], line[1:-1], old[j : j + 1]]), step)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(drawn, axis=0).T))])
    own = along / along[-1]
    before = course.along[i : j + 1] - course.along[i]
    part = before / before[-1]
    if ((np.asarray(course.falls) >= i) & (np.asarray(course.falls) < j)).any():
        raise InputError("the water falls between both ends of xy, and falls cannot be redrawn; draw up to them")

    def joined(values: Any) -> FloatArray:
        value = np.asarray(values)
        if value.ndim == 1:
            middle: FloatArray = np.interp(own, part, value[i : j + 1])
        else:
            middle = np.stack([np.interp(own, part, column) for column in value[i : j + 1].T], axis=1)
        return np.concatenate([value[:i], middle, value[j + 1 :]])

    falls = np.asarray(course.falls)
    falls = np.where(falls >= j, falls + len(drawn) - (j - i + 1), falls)
    return Course(
        np.concatenate([old[:i], drawn, old[j + 1 :]]),
        np.minimum.accumulate(joined(course.level)),
        joined(course.width),
        joined(course.depth),
        joined(course.speed),
        course.channel_type,
        joined(course.form),
        falls,
    )


def _even(line: FloatArray, step: float) -> FloatArray:
    """Points along a smooth line through some, about evenly."""
    from warpriver.graph.authoring import smooth_line

    repeated = np.concatenate([[True], (np.diff(line, axis=0) != 0.0).any(axis=1)])
    return smooth_line(line[repeated], step)


def _redrawn_network(network: RiverNetwork, channel: int, line: FloatArray) -> RiverNetwork:
    start, xy = network.starts().astype(np.int64), network.points()
    first, stop = int(start[channel]), int(start[channel + 1])
    own = xy[first:stop]
    i, j = _section(own, line, channel)
    step = float(np.median(np.hypot(*np.diff(own, axis=0).T)))
    drawn = _even(np.concatenate([own[i : i + 1], line[1:-1], own[j : j + 1]]), step)
    new = np.concatenate([own[:i], drawn, own[j + 1 :]])
    offsets = start.copy()
    offsets[channel + 1 :] += len(new) - len(own)
    section = None
    if network.point_section is not None:
        known = network.point_section.numpy()[: network.point_count]
        place = np.interp(
            np.arange(len(new)) / (len(new) - 1), np.arange(len(own)) / (len(own) - 1), np.arange(len(own))
        )
        middle = np.stack([np.interp(place, np.arange(len(own)), column) for column in known[first:stop].T], axis=1)
        section = np.concatenate([known[:first], middle, known[stop:]])
    slope = network.channel_slope.copy()
    longer = np.hypot(*np.diff(new, axis=0).T).sum() / np.hypot(*np.diff(own, axis=0).T).sum()
    slope[channel] /= longer
    return RiverNetwork(
        np.concatenate([xy[:first], new, xy[stop:]]) - network.origin,
        offsets,
        network.channels.replace(slope=slope),
        node_xy=network.node_xy,
        point_section=section,
        origin=network.origin,
        crs=network.crs,
        dtype=network.dtype,
        device=network.device,
    )


def _anew(
    made: Made,
    terrain: Terrain,
    network: RiverNetwork,
    types: Any,
    changed: FlagArray,
    *,
    free: FlagArray | None = None,
    redrawn: FlagArray | None = None,
    leveled: FlagArray | None = None,
) -> Made:
    """Lay some channels anew."""
    rivers = made.rivers.laid_anew(
        terrain,
        network,
        types,
        changed,
        np.zeros(network.node_count, bool) if free is None else free,
        redrawn=np.zeros(network.channel_count, bool) if redrawn is None else redrawn,
        leveled=changed if leveled is None else leveled,
    )
    return dataclasses.replace(made, terrain=terrain, rivers=rivers)


def _check_hanging(made: Made, channel: int) -> None:
    """Refuse a course whose water would stand on ground that lies below it."""
    stations = made.rivers.stations
    own = (stations.channel[stations.station_course] == channel) & stations.wet[stations.station_course]
    xy, depth = stations.xy[own], stations.depth[own]
    below = stations.water[own] - ground_of(made.terrain)(xy)
    hangs = below > HANGING * depth
    if hangs.any():
        k = int(np.where(hangs, below, -np.inf).argmax())
        raise InputError(
            f"the water would stand {below[k]:.3g} m above the ground at ({xy[k, 0]:.6g}, {xy[k, 1]:.6g}), since the "
            "channel ends higher than that; draw it elsewhere, or raise the ground first"
        )


def _ground(edit: EditTerrain, made: Made) -> Made:
    terrain = made.terrain.copy()
    edit_terrain(terrain, edit)
    network, stations = made.rivers.network, made.rivers.stations
    if network is None:
        return _own_courses(made, made.rivers.courses(), terrain)
    # What looks at the ground that was changed is laid anew; nodes on it may change their levels.
    low, high = edited_box(edit)
    low, high = low - 2.0 * terrain.cell_size, high + 2.0 * terrain.cell_size
    reach = np.maximum(0.5 * stations.width + stations.reach, ROOM_WIDTHS * stations.width)[:, None]
    near = ((stations.xy > low - reach) & (stations.xy < high + reach)).all(axis=1)
    changed = np.zeros(network.channel_count, bool)
    changed[stations.channel[stations.station_course[near]]] = True
    free = np.asarray(((network.node_xy > low) & (network.node_xy < high)).all(axis=1))
    changed |= free[network.channel_from] | free[network.channel_to]
    if not changed.any():
        rivers = made.rivers.on(terrain)
        return dataclasses.replace(made, terrain=terrain, rivers=rivers)
    return _anew(made, terrain, network, _types(made), changed, free=free)


DOERS: dict[type[Edit], Callable[[Any, Made], Made]] = {
    edits.AddWater: _water,
    edits.MoveWater: _water,
    edits.ChangeWater: _water,
    edits.RemoveWater: _water,
    edits.ReplaceWater: _water,
    edits.AddRock: _add_rock,
    edits.AddLog: _add_log,
    edits.MoveObstacle: _move_obstacle,
    edits.RemoveObstacle: _remove_obstacle,
    edits.RetypeChannel: _retype,
    edits.RedrawCourse: _redraw,
    EditTerrain: _ground,
}
