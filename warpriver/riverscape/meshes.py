"""Meshes of a riverscape for 3-D programs: ground, water with the current in it, and sheets of falling water."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.files import beside
from warpriver.io.gltf import GltfMesh, point_normals, write_gltf
from warpriver.io.meshes import cell_triangles
from warpriver.riverscape.courses import CourseMap

if TYPE_CHECKING:
    from warpriver.riverscape.scene import Riverscape

__all__ = ["write_glb"]


GROUND, WATER, WHITE = (0.36, 0.32, 0.24, 1.0), (0.10, 0.24, 0.30, 0.8), (0.86, 0.91, 0.93, 0.85)
# Points across and along a sheet of falling water; how far it stands off the water of the step, m.
ACROSS, DOWN, OFF = 9, 9, 0.01
GRAVITY = 9.81


def write_glb(
    scene: Riverscape,
    path: str | os.PathLike[str],
    *,
    bounds: Sequence[float] | FloatArray | None,
    cell_size: float,
    time: float,
) -> None:
    """Write a scene as binary glTF; see :meth:`Riverscape.to_glb`."""
    target = pathlib.Path(path)
    if target.suffix.lower() != ".glb":
        raise InputError(f"{target} ends in {target.suffix or 'nothing'}; a mesh of a riverscape is a .glb")
    (frame,) = scene.frames(bounds, cell_size, [time])
    bed, size = frame.bed.numpy(), frame.water.cell_size
    west, north = frame.water.origin
    rows, columns = bed.shape
    zero = np.array([np.floor(west), np.floor(north - rows * size)])
    x, y = west + size * (np.arange(columns) + 0.5), north - size * (np.arange(rows) + 0.5)
    place = np.stack(np.meshgrid(x, y), axis=-1)

    known = np.isfinite(bed)
    triangles = cell_triangles(known)
    if not len(triangles):
        raise InputError("the ground has no three cells that meet within the bounds; give others")
    points = np.column_stack([place[known], bed[known]])
    share = np.column_stack([(points[:, 0] - west) / (columns * size), (north - points[:, 1]) / (rows * size)])
    meshes = [_mesh("terrain", points, triangles, share, zero, GROUND)]
    meshes += _water(scene, frame.water.elevation.numpy(), frame, place, zero)
    meshes += _falls(scene, (west, north - rows * size, west + columns * size, north), zero)
    told = {"origin": zero.tolist(), "crs": scene.terrain.crs, "unit": "m", "up": "y", "time": time}
    told["water"] = {
        "TEXCOORD_0": "distance along the course and to its left, m",
        "_FLOW": "velocity, m/s, in the axes of the mesh",
        "_FOAM": "white water, 0 to 1",
    }
    with beside(target) as temporary, temporary.open("wb") as file:
        write_gltf(meshes, file, told)


def _upright(vectors: FloatArray) -> FloatArray:
    """Vectors with y up; north is -z."""
    return np.column_stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]])


def _mesh(
    name: str,
    points: FloatArray,
    triangles: IndexArray,
    uv: FloatArray,
    zero: FloatArray,
    color: tuple[float, float, float, float],
    **more: FloatArray,
) -> GltfMesh:
    attributes = {
        "POSITION": _upright(points - [*zero, 0.0]),
        "NORMAL": _upright(point_normals(points, triangles)),
        "TEXCOORD_0": uv,
    } | more
    return GltfMesh(name, attributes, triangles, color)


def _water(
    scene: Riverscape, elevation: FloatArray, frame: object, place: FloatArray, zero: FloatArray
) -> list[GltfMesh]:
    """The water where it stands over the bed, and as far as the next cells beyond, where it goes into the bank."""
    bed, water = frame.bed.numpy(), frame.water  # type: ignore[attr-defined]
    wet = np.isfinite(elevation) & (elevation > bed)
    # One cell more all around, as low as the bed's own height at most, so that its edge is the bank's.
    grown = wet.copy()
    for axis in (0, 1):
        for step in (1, -1):
            moved = np.roll(wet, step, axis=axis)
            edge = [slice(None)] * 2
            edge[axis] = slice(0, 1) if step == 1 else slice(-1, None)
            moved[tuple(edge)] = False
            grown |= moved
    grown &= np.isfinite(elevation)
    triangles = cell_triangles(grown)
    if not len(triangles):
        return []
    xy, z = place[grown], elevation[grown]
    triangles, source, along, across = _with_courses(scene.courses, xy, triangles)
    velocity = water.velocity.numpy()[grown].astype(np.float64)
    flow = np.column_stack([velocity, np.zeros(len(velocity))])
    foam = water.effervescence.numpy()[grown].astype(np.float64)
    points = np.column_stack([xy, z])[source]
    uv = np.column_stack([along, across])
    return [_mesh("water", points, triangles, uv, zero, WATER, _FLOW=_upright(flow)[source], _FOAM=foam[source])]


def _with_courses(
    courses: CourseMap, xy: FloatArray, triangles: IndexArray
) -> tuple[IndexArray, IndexArray, FloatArray, FloatArray]:
    """Places along courses of the points of triangles: points that belong to triangles of several courses are doubled.

    Returns:
        Triangles of the new points, the old point of each of these, its distance along and to the left of its course.
    """
    found = courses.survey(xy)
    own = np.where(found.point >= 0, courses.course_of_point[np.maximum(found.point, 0)], -1)
    # A triangle is of the course of its middle corner by number, which is one of at least two of them where two agree.
    course = np.sort(own[triangles], axis=1)[:, 1]
    nearest = np.sort(own[triangles], axis=1)[:, 2]
    course = np.where(course < 0, np.maximum(nearest, 0), course)
    key = triangles * len(courses.courses) + course[:, None]
    pairs, number = np.unique(key, return_inverse=True)
    source, meant = pairs // len(courses.courses), pairs % len(courses.courses)
    half = 0.5 * courses.joined("width")[np.maximum(found.point[source], 0)]
    along, across = found.along[source], found.across[source] * half
    other = np.flatnonzero(own[source] != meant)
    for k in np.unique(meant[other]).tolist():
        rows = other[meant[other] == k]
        along[rows], across[rows] = _beside(courses.courses[k], xy[source[rows]])
    return number.reshape(triangles.shape), source, along, across


def _beside(course: object, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance along a course and to its left of places, m, by the nearest of its points."""
    with IMPORTING:
        from scipy.spatial import cKDTree
    line, direction = np.asarray(course.xy), course.direction  # type: ignore[attr-defined]
    k = cKDTree(line).query(xy)[1]
    off = xy - line[k]
    ahead = (off * direction[k]).sum(axis=1)
    left = direction[k, 0] * off[:, 1] - direction[k, 1] * off[:, 0]
    return course.along[k] + ahead, left  # type: ignore[attr-defined]


def _falls(scene: Riverscape, window: tuple[float, float, float, float], zero: FloatArray) -> list[GltfMesh]:
    """Sheets of falling water: thrown bodies x = u t, z = -g t^2 / 2 where it falls freely, else over the step."""
    stations, falls = scene.stations, scene.stations.falls
    west, south, east, north = window
    inside = (falls.xy > (west, south)).all(axis=1) & (falls.xy < (east, north)).all(axis=1) & (falls.drop > 0.0)
    rows = np.flatnonzero(inside)
    if not len(rows):
        return []
    width, drop, length = stations.width[falls.station[rows]], falls.drop[rows], falls.length[rows]
    down = np.linspace(0.0, 1.0, DOWN)
    quintic = down**3 * (down * (down * 6.0 - 15.0) + 10.0)
    fallen = np.where(falls.free[rows, None], down**2, quintic)
    ahead = falls.direction[rows]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    aside = np.linspace(0.5, -0.5, ACROSS)
    xy = (
        falls.xy[rows][:, None, None]
        + (length[:, None] * down)[:, :, None, None] * ahead[:, None, None]
        + (width[:, None] * aside)[:, None, :, None] * left[:, None, None]
    )
    z = np.broadcast_to((falls.level[rows, None] - drop[:, None] * fallen + OFF)[:, :, None], xy.shape[:-1])
    points = np.concatenate([xy, z[..., None]], axis=-1).reshape(-1, 3)
    station = np.broadcast_to(falls.along[rows, None, None] + (length[:, None] * down)[:, :, None], z.shape)
    uv = np.column_stack([station.ravel(), np.broadcast_to((width[:, None] * aside)[:, None], z.shape).ravel()])
    i, j = np.meshgrid(np.arange(DOWN - 1), np.arange(ACROSS - 1), indexing="ij")
    a = (i * ACROSS + j).ravel()
    quad = np.concatenate([np.stack([a, a + ACROSS + 1, a + ACROSS], 1), np.stack([a, a + 1, a + ACROSS + 1], 1)])
    triangles = (np.arange(len(rows))[:, None, None] * (DOWN * ACROSS) + quad).reshape(-1, 3)
    fall_speed = np.sqrt(2.0 * GRAVITY * np.maximum(falls.level[rows, None] - z[:, :, 0], 0.0))
    flow = np.empty((*z.shape, 3))
    flow[..., :2] = (falls.speed[rows, None] * ahead)[:, None, None]
    flow[..., 2] = -fall_speed[:, :, None]
    flow = flow.reshape(-1, 3)
    foam = np.broadcast_to(np.clip(4.0 * drop, 0.25, 1.0)[:, None, None] * down[:, None], z.shape).ravel()
    return [_mesh("falls", points, triangles, uv, zero, WHITE, _FLOW=_upright(flow), _FOAM=foam)]
