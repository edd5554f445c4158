"""New courses of avulsions: walked over the terrain, and carved into it [Paris2023], section 5.2."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpriver.arrays import DeviceArray, FloatArray
from warpriver.device import launch_kernel
from warpriver.errors import InputError
from warpriver.kernels import avulsions as kernels
from warpriver.params import AvulsionParams
from warpriver.terrain import Terrain

__all__ = ["Course", "Refusal", "carve_course", "falling_bed", "walk_courses"]


# Steps of a walk at most, in straight steps from its start to its target.
MAX_STEPS = 4.0
# Courses that are walked in one launch.
BATCH = 4096


@dataclasses.dataclass(frozen=True)
class Refusal:
    """Why a course was refused.

    Attributes:
        reason: What is in the way, in words.
        xy: Where, (x, y) in m.
    """

    reason: str
    xy: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Course:
    """A new course, from its start on the channel to its end.

    Attributes:
        xy: (n, 2) points in m, a step apart; the last step may be shorter.
        ground: (n,) height of the ground at the points, m; 0 without a terrain.
        bed: (n,) height that the ground is carved to, m, falling all along; the ground itself where that falls.
    """

    xy: FloatArray
    ground: FloatArray
    bed: FloatArray

    @property
    def deepest_cut(self) -> float:
        """Maximum depth of the cut into the ground, m."""
        return float((self.ground - self.bed).max())


def walk_courses(
    start: ArrayLike,
    target: ArrayLike,
    direction: ArrayLike,
    seeds: Sequence[int] | NDArray[np.uint32],
    spacing: float,
    params: AvulsionParams | None = None,
    terrain: Terrain | None = None,
    device: wp.DeviceLike = "cpu",
) -> list[Course | Refusal]:
    """Walk new courses from points of channels to others, each by its own random numbers.

    d = t u + (1 - t) d0 with u the direction to the target b, d0 the first direction, and t = min(walked / |a - b|, 1),
    turned by chance at each step. As printed, with t = |p - b| / |a - b|, the walk does not end at b; with
    1 - |p - b| / |a - b| it misses b where d0 leads past it. On a straight way that is the same as ours.

    Args:
        start: (n, 2) where courses leave, m.
        target: (n, 2) where they end, m.
        direction: (n, 2) first directions, unit vectors.
        seeds: (n,) seeds, of 32 bits.
        spacing: Length of a step, m.
        params: Constants of the walk.
        terrain: Ground that may rise by ``steepest_rise`` at most; None for a plain.
        device: Warp device; that of the terrain where there is one.

    Returns:
        For each a Course, or a Refusal that says why there is none.
    """
    params = AvulsionParams() if params is None else params
    ends = np.stack([np.asarray(start, np.float64), np.asarray(target, np.float64)], axis=1)
    first, seed = np.asarray(direction, np.float64), np.asarray(seeds, np.uint32)
    found: list[Course | Refusal] = []
    for k in range(0, len(ends), BATCH):
        batch = slice(k, k + BATCH)
        found += _walk_batch(ends[batch], first[batch], seed[batch], spacing, params, terrain, device)
    return found


def _walk_batch(
    ends: FloatArray,
    direction: FloatArray,
    seeds: NDArray[np.uint32],
    spacing: float,
    params: AvulsionParams,
    terrain: Terrain | None,
    device: wp.DeviceLike,
) -> list[Course | Refusal]:
    """Walk courses in one launch."""
    kernel = kernels.build(wp.float64)
    place = terrain.device if terrain is not None else wp.get_device(device)
    # Relative to the first start, so that float64 keeps its digits far from the zero.
    zero = ends[0, 0]
    walk = kernel.Walk()
    walk.spacing, walk.jitter, walk.steepest = spacing, math.radians(params.jitter), params.steepest_rise
    longest = float(np.hypot(*(ends[:, 1] - ends[:, 0]).T).max())
    shape = len(ends), math.ceil(MAX_STEPS * longest / spacing) + 2
    xy = wp.empty(shape, dtype=wp.vec2d, device=place)
    height = wp.empty(shape, dtype=wp.float64, device=place)
    state = wp.empty((len(ends), 2), dtype=wp.int32, device=place)
    courses = kernel.Courses()
    courses.ends = wp.array(ends - zero, dtype=wp.vec2d, device=place)
    courses.direction = wp.array(direction, dtype=wp.vec2d, device=place)
    courses.seed = wp.array(seeds, dtype=wp.uint32, device=place)
    ground: list[Any] = (
        [None, kernel.RasterGrid()] if terrain is None else [terrain.height, terrain.grid("float64", zero)]
    )
    launch_kernel(kernel.walk_courses, len(ends), [*ground, walk, courses], [xy, height, state], device=place)
    points, heights, ended = xy.numpy(), height.numpy(), state.numpy()
    found: list[Course | Refusal] = []
    for k, (how, count) in enumerate(ended.tolist()):
        line, below = points[k, :count] + zero, heights[k, :count].copy()
        last = float(line[-1, 0]), float(line[-1, 1])
        if how == kernels.ARRIVED:
            found.append(Course(line, below, falling_bed(line, below, params.fall) if terrain is not None else below))
        elif how == kernels.TOO_STEEP:
            found.append(Refusal(f"the ground rises by more than {params.steepest_rise:g} m/m", last))
        elif how == kernels.NO_GROUND:
            found.append(Refusal("there is no ground", last))
        else:
            found.append(Refusal(f"the way does not end within {count - 1} steps", last))
    return found


def falling_bed(xy: FloatArray, ground: FloatArray, fall: float) -> FloatArray:
    """Return the highest bed that nowhere lies above the ground and falls by at least ``fall``, (n,) in m."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    return np.asarray(np.minimum.accumulate(ground + fall * s) - fall * s)


def carve_course(terrain: Terrain, xy: FloatArray, bed: FloatArray, width: float) -> None:
    """Carve a bed into a terrain: over the width wholly, blended to twice that; nothing is raised.

    Args:
        terrain: Changed in place.
        xy: (n, 2) points of the course, m.
        bed: (n,) height of its bed there, m.
        width: Width of the channel, m.
    """
    if not (math.isfinite(width) and width > 0.0):
        raise InputError(f"width is {width!r}; give a positive length in m")
    (west, south), (east, north) = xy.min(axis=0) - width, xy.max(axis=0) + width
    window = terrain.raster.window(west, south, east, north)
    if window is None:
        return
    kernel = kernels.build(wp.float64)
    line: DeviceArray = wp.array(xy, dtype=wp.vec2d, device=terrain.device)
    heights: DeviceArray = wp.array(bed, dtype=wp.float64, device=terrain.device)
    inputs = [terrain.grid(), wp.float64(width), wp.vec4i(*window), line, heights]
    launch_kernel(kernel.carve_line, window[2:], inputs, [terrain.height], device=terrain.device)
