"""Leaves and foam that the water carries [Peytavie2019], Sec. 7."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpriver.arrays import DeviceArray, FlagArray, FloatArray, IndexArray
from warpriver.device import launch_kernel
from warpriver.errors import InputError
from warpriver.kernels import drift as kernels
from warpriver.riverscape.seeding import hashed
from warpriver.riverscape.water import Water, WaterGrid
from warpriver.validate import floats, shown

__all__ = ["Foam", "LeafFrame", "drift_leaves"]


# Of a leaf's step in time at most, s, and its way in that in primitives' radii; how often one is set anew at most.
LONGEST_STEP, FARTHEST = 0.25, 0.15
# A leaf that has not moved for so long is set anew, s.
PATIENCE = 4.0
# Water that carries a leaf is so deep, m.
AFLOAT = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class LeafFrame:
    """Leaves on the water at a time.

    Attributes:
        time: s.
        xy: (n, 2) m.
        elevation: (n,) of the water under them, m.
        heading: (n,) direction of their long side, rad; they turn with the water.
        generation: (n,) how often each has been set anew.
    """

    time: float
    xy: FloatArray
    elevation: FloatArray
    heading: FloatArray
    generation: IndexArray


def checked_times(times: ArrayLike) -> list[float]:
    """Return times in s, all of them finite."""
    moments = floats(times, "times", "a list of seconds")
    if moments.ndim != 1 or not np.isfinite(moments).all():
        raise InputError(f"times is {shown(times)}; give a list of finite seconds")
    return [float(t) for t in moments]


def drift_leaves(
    water: Water, bed: Callable[[ArrayLike], FloatArray], times: ArrayLike, count: int, seed: int
) -> Iterator[LeafFrame]:
    """Let leaves drift: the middle of each step tells its velocity (second order), and none goes on land.

    One that would run aground turns along the water's edge, or stays; one that leaves the water, or has not moved for a
    while, is set anew. Where depends on its number, how often that has been, and the seed.

    Args:
        water: Whose velocity carries them.
        bed: Height of the bed at places.
        times: s, not falling.
        count: Of leaves.
        seed: Of where they are set.
    """
    moments = checked_times(times)
    if not moments or any(np.diff(moments) < 0.0):
        raise InputError("times must be seconds that do not fall, one at least")
    number = np.arange(count, dtype=np.int64)
    generation = np.zeros(count, np.int64)
    xy = _set_anew(water, bed, number, generation, seed)
    heading = np.asarray(hashed(number, generation, seed + 1) * (2.0 * np.pi / 2.0**32), np.float64)
    stuck = np.zeros(count)
    now = moments[0]
    for moment in moments:
        while moment - now > 1e-9:
            speed = np.hypot(*water.at(xy, now).velocity.T).max(initial=1e-6)
            step = min(moment - now, LONGEST_STEP, FARTHEST * float(np.median(water.primitives.radius)) / speed)
            there, turned, aground = _moved(water, bed, xy, step, now)
            moved = np.hypot(*(there - xy).T)
            heading = heading + turned
            stuck = np.where(moved < 0.02 * step, stuck + step, 0.0)
            lost = aground | (stuck > PATIENCE)
            xy = there
            if lost.any():
                generation = generation + lost
                xy[lost] = _set_anew(water, bed, number[lost], generation[lost], seed)
                stuck[lost] = 0.0
            now += step
        yield LeafFrame(moment, xy.copy(), water.at(xy, moment).elevation, heading.copy(), generation.copy())


def _moved(
    water: Water, bed: Callable[[ArrayLike], FloatArray], xy: FloatArray, step: float, time: float
) -> tuple[FloatArray, FloatArray, FlagArray]:
    """Places after a step, angles turned, and which leaves have no water around them at all."""
    first = water.at(xy, time).velocity
    middle = water.at(xy + 0.5 * step * first, time)
    velocity = np.where(middle.weight[:, None] > 0.0, middle.velocity, first)
    there = xy + step * velocity
    dry = ~_afloat(water, bed, there, time)
    for angle in (0.5, -0.5, 1.0, -1.0):
        # Along the water's edge instead, to either side.
        k = np.flatnonzero(dry)
        if not len(k):
            break
        c, s = math.cos(angle), math.sin(angle)
        aside = velocity[k] @ np.array([[c, s], [-s, c]])
        other = xy[k] + step * aside * c
        free = _afloat(water, bed, other, time)
        there[k[free]] = other[free]
        dry[k[free]] = False
    there[dry] = xy[dry]
    aground = dry & ~_afloat(water, bed, xy, time)
    # Half the curl turns what floats.
    small = 0.05
    east, north = (water.at(there + off, time).velocity for off in ((small, 0.0), (0.0, small)))
    here = water.at(there, time).velocity
    curl = (east[:, 1] - here[:, 1] - north[:, 0] + here[:, 0]) / small
    return there, 0.5 * curl * step, aground


def _afloat(water: Water, bed: Callable[[ArrayLike], FloatArray], xy: FloatArray, time: float) -> FlagArray:
    """Whether the water is deep enough to carry a leaf."""
    found = water.at(xy, time)
    wet = found.weight > 0.0
    wet[wet] = found.still[wet] - bed(xy[wet]) > AFLOAT
    return wet


def _set_anew(
    water: Water, bed: Callable[[ArrayLike], FloatArray], number: IndexArray, generation: IndexArray, seed: int
) -> FloatArray:
    """Places in the water where leaves begin, each by its number and how often it has been set."""
    center, radius = water.primitives.center, water.primitives.radius
    xy = center[np.zeros(len(number), np.int64)].copy()
    missing = np.ones(len(number), bool)
    for attempt in range(64):
        k = np.flatnonzero(missing)
        if not len(k):
            return xy
        bits = [hashed(number[k], generation[k] * 64 + attempt, 3 * seed + salt) for salt in (11, 12, 13)]
        row = bits[0] % len(center)
        angle, size = 2.0 * np.pi * bits[1] / 2.0**32, np.sqrt(bits[2] / 2.0**32)
        place = center[row] + (0.7 * radius[row] * size)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        wet = _afloat(water, bed, place, 0.0)
        xy[k[wet]] = place[wet]
        missing[k[wet]] = False
    if missing.any():
        raise InputError("no water is deep enough to carry a leaf; give a wetter scene or no leaves")
    return xy


class Foam:
    """Foam on a grid: carried by the water, made where it is white, and fading.

    Args:
        grid: The water at a first time; its velocity carries the foam.
        lifetime: In which foam fades by 1/e, s.
        rate: Foam made in a second by water that is white all over.

    Attributes:
        cover: (rows, columns) 0 to 1, on the device.
    """

    def __init__(self, grid: WaterGrid, lifetime: float = 2.0, rate: float = 0.6) -> None:
        scalar = wp.float64 if grid.effervescence.dtype == wp.float64 else wp.float32
        self._scalar, self._kernels = scalar, kernels.build(scalar)
        self.lifetime, self.rate = lifetime, rate
        self.cell_size = grid.cell_size
        self.cover = wp.zeros(grid.shape, dtype=scalar, device=grid.elevation.device)
        self._other = wp.zeros_like(self.cover)

    def step(self, grid: WaterGrid, seconds: float) -> DeviceArray:
        """Carry the foam on, and return it.

        Args:
            grid: The water now, on the same cells.
            seconds: Time since the last step; it is divided so that foam comes two cells far at a time.
        """
        fastest = float(np.abs(grid.velocity.numpy()).max(initial=0.0))
        parts = max(1, math.ceil(seconds * fastest / (2.0 * self.cell_size)))
        s, device = self._scalar, self.cover.device
        source: DeviceArray = wp.array(self.rate * grid.effervescence.numpy(), dtype=s, device=device)
        step = seconds / parts
        for _ in range(parts):
            inputs = [
                s(1.0 / self.cell_size),
                s(step),
                s(math.exp(-step / self.lifetime)),
                grid.velocity,
                source,
                self.cover,
            ]
            launch_kernel(self._kernels.carry_foam, self.cover.shape, inputs, [self._other], device=device)
            self.cover, self._other = self._other, self.cover
        return self.cover
