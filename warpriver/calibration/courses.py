"""Lines that migrate by the rate law, and how each point would move with other constants: both in the same steps."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver.arrays import FloatArray
from warpriver.device import resolve_device
from warpriver.engine.scans import Scan
from warpriver.engine.stages import CUDA_CHUNK, launch
from warpriver.errors import InputError
from warpriver.kernels import sensitivities as kernels
from warpriver.params import MeanderParams

__all__ = ["Lines", "Traced", "strength_over_rate", "trace"]

# An explicit step keeps D dt / h^2 at this, where 1/2 is the limit; D = k w |omega|, which saturation only lessens.
DIFFUSION_NUMBER = 0.4
# Steps of one simulation at most: bends have long come and gone by then.
MOST_STEPS = 200_000
# Points move by so many widths at most before they are spread evenly again.
DRIFT = 0.1
# Width times curvature that few bends exceed: what the drift is estimated with where nothing saturates.
TIGHT = 0.5
# Real numbers of the kernels: derivatives are wanted to more digits than positions in float32 have.
SCALAR, VEC2, VEC3 = wp.float64, wp.vec2d, wp.vec3d


@dataclasses.dataclass(frozen=True)
class Lines:
    """Lines whose points lie end to end, evenly spaced along each.

    Attributes:
        start: (L + 1,) offsets of the lines.
        xy: (N, 2) points, m.
        width: (N,) width, m.
        depth: (N,) depth, m.
    """

    start: NDArray[np.int32]
    xy: FloatArray
    width: FloatArray
    depth: FloatArray

    @property
    def count(self) -> int:
        """Number of lines."""
        return len(self.start) - 1

    def spacing(self) -> FloatArray:
        """Return the even spacing of each line, (L,), m."""
        step = np.hypot(*np.diff(self.xy, axis=0).T)
        step = np.append(step, 0.0)
        step[self.start[1:] - 1] = 0.0
        return np.asarray(np.add.reduceat(step, self.start[:-1]) / (np.diff(self.start) - 1))

    def owner(self) -> NDArray[np.intp]:
        """Return the line of each point, (N,)."""
        return np.repeat(np.arange(self.count), np.diff(self.start))

    def mean_width(self) -> FloatArray:
        """Return the mean width of each line, (L,), m."""
        return np.asarray(np.add.reduceat(self.width, self.start[:-1]) / np.diff(self.start))

    def tiled(self, copies: int) -> Lines:
        """Return so many copies of the lines, one after the other."""
        size = self.start[-1]
        start = np.concatenate([self.start[:-1] + k * size for k in range(copies)] + [[copies * size]])
        return Lines(
            start.astype(np.int32),
            np.tile(self.xy, (copies, 1)),
            np.tile(self.width, copies),
            np.tile(self.depth, copies),
        )


@dataclasses.dataclass(frozen=True)
class Traced:
    """Where lines have gone, and how far their points move for a change of the constants.

    Attributes:
        xy: (N, 2) points, as many on each line as before and as evenly spaced, m.
        change: (A, N, 2) derivative of the points in each direction, m.
        steps: How many steps it took.
    """

    xy: FloatArray
    change: FloatArray
    steps: int


def strength_over_rate(width: FloatArray, params: MeanderParams) -> FloatArray:
    """Return the strength of bends over the rate: w, or w^2 / W where the rate is that of a reference width W, m."""
    return width * width / params.reference_width if params.reference_width else width


def trace(
    lines: Lines,
    law: FloatArray,
    seeds: FloatArray,
    params: MeanderParams,
    years: float,
    *,
    steps: int | None = None,
    even: bool = True,
    device: wp.DeviceLike = "cpu",
) -> Traced:
    """Let lines migrate, without cutoffs, and carry the derivatives of their points along in the same steps.

    Between explicit steps the points are spread evenly from time to time, as many as there are. The derivatives are
    those of the steps themselves, exact but for how the even places move along the line, which changes no shape.

    Args:
        lines: The lines, four points or more each.
        law: (N, 3) rate in m/yr, memory and saturation at each point. The memory is in widths, or in depths, 1 / (2 f),
            where ``params.memory_length`` is 0.
        seeds: (A, N, 3) how the logarithms of these change in each direction.
        params: Constants that are the same everywhere; rate, memory and saturation are those of ``law``.
        years: Time, yr.
        steps: Number of steps; by default as many as are stable.
        even: Spread the points evenly at the end as well.
        device: Where to compute.
    """
    on = resolve_device(device)
    steps = steps or _stable_steps(lines, law, params, years)
    run = _Run(lines, law, seeds, params, on)
    stride = max(1, steps // _spreads(lines, law, params, years))
    for k in range(steps):
        run.step(years / steps)
        if (k + 1) % stride == 0 and k + 1 < steps:
            run.spread()
    if even:
        run.spread()
    return Traced(
        run.courses.xy.numpy() + run.origin, run.directions.xy.numpy().reshape(len(seeds), len(lines.xy), 2), steps
    )


def _stable_steps(lines: Lines, law: FloatArray, params: MeanderParams, years: float) -> int:
    diffusivity = law[:, 0] * strength_over_rate(lines.width, params) * max(-params.local_weight, 0.1)
    most = np.maximum.reduceat(diffusivity, lines.start[:-1]) / lines.spacing() ** 2
    steps = years * float(most.max()) / DIFFUSION_NUMBER
    if not steps <= MOST_STEPS:
        raise InputError(
            f"{years:g} yr at {law[:, 0].max():g} m/yr need {steps:.1e} steps; check the years, the width and the "
            "migration rate"
        )
    return max(1, math.ceil(steps))


def _spreads(lines: Lines, law: FloatArray, params: MeanderParams, years: float) -> int:
    """How often the points are spread evenly."""
    tight = np.where(law[:, 2] > 0.0, np.minimum(law[:, 2], TIGHT), TIGHT)
    weight = params.upstream_weight - params.local_weight
    speed = law[:, 0] * strength_over_rate(lines.width, params) / lines.width * tight * weight
    return max(1, math.ceil(years * float((speed / lines.width).max()) / DRIFT))


class _Run:
    """Device arrays of lines on their way, and the launches of a step."""

    def __init__(self, lines: Lines, law: FloatArray, seeds: FloatArray, params: MeanderParams, device: Any):
        kernel, size = kernels.build(SCALAR), len(lines.xy)

        def give(values: Any, kind: Any) -> Any:
            return wp.array(np.ascontiguousarray(values), dtype=kind, device=device)

        self._kernel, self._device, self._size, self._count = kernel, device, size, len(seeds)
        self.origin = np.round(lines.xy.mean(axis=0))
        unit = lines.width if params.memory_length > 0.0 else lines.depth
        section = np.column_stack([lines.width, strength_over_rate(lines.width, params), unit])
        self._start, self._width = give(lines.start, wp.int32), give(lines.mean_width(), SCALAR)
        self.courses, self._spare_courses = kernel.Courses(), kernel.Courses()
        self.directions, self._spare_directions = kernel.Directions(), kernel.Directions()
        for courses in (self.courses, self._spare_courses):
            courses.start, courses.width = self._start, self._width
        self._take(self.courses, give(lines.xy - self.origin, VEC2), give(section, VEC3), give(law, VEC3))
        self._take(self._spare_courses, *(wp.empty(size, dtype=kind, device=device) for kind in (VEC2, VEC3, VEC3)))
        self.directions.xy = wp.zeros(self._count * size, dtype=VEC2, device=device)
        self.directions.seed = give(seeds.reshape(-1, 3), VEC3)
        self._spare_directions.xy = wp.empty(self._count * size, dtype=VEC2, device=device)
        self._spare_directions.seed = wp.empty(self._count * size, dtype=VEC3, device=device)
        self._velocity = wp.empty(size, dtype=VEC2, device=device)
        self._change = wp.empty(self._count * size, dtype=VEC2, device=device)
        self._place = wp.empty(size, dtype=wp.int32, device=device)
        self._weight = wp.empty(size, dtype=kernel.vec4, device=device)
        quanta, arc = (wp.zeros(size, dtype=wp.int64, device=device) for _ in range(2))
        self.courses.arc = self._spare_courses.arc = arc
        self._arcs, self._quanta = Scan("lengths", quanta, arc, SCALAR, serial=device.is_cpu), quanta
        first, owner = _pieces(lines, size if device.is_cpu else CUDA_CHUNK)
        self._pieces, self._piece_count = kernel.Pieces(), len(owner)
        self._pieces.first, self._pieces.line = give(first, wp.int32), give(owner, wp.int32)
        constants = self._constants = kernel.RateLaw()
        constants.local_weight, constants.upstream_weight = params.local_weight, params.upstream_weight
        constants.scale_local = int(params.sinuosity_scaling == "whole")
        constants.scale_upstream = int(params.sinuosity_scaling in ("whole", "upstream"))
        constants.end_damping = params.end_damping
        self._measure()

    @staticmethod
    def _take(courses: Any, xy: Any, section: Any, law: Any) -> None:
        courses.xy, courses.section, courses.law = xy, section, law

    def _launch(self, name: str, threads: int, inputs: list[Any], outputs: list[Any]) -> None:
        launch(getattr(self._kernel, name), threads, inputs, outputs, self._device)

    def _measure(self) -> None:
        self._launch("measure_segments", self._size, [self.courses], [self._quanta])
        self._arcs.run()

    def step(self, years: float) -> None:
        """Move the points, and how far they have moved in each direction, by one step."""
        inputs = [self.courses, self._constants, self._pieces]
        self._launch("trace_velocity", self._piece_count, inputs, [self._velocity])
        if self._count:
            threads = self._count * self._piece_count
            self._launch("trace_tangents", threads, [*inputs, self.directions], [self._change])
            moved = self.directions.xy
            self._launch("advance_points", len(moved), [SCALAR(years), self._change], [moved])
        self._launch("advance_points", self._size, [SCALAR(years), self._velocity], [self.courses.xy])

    def spread(self) -> None:
        """Spread the points of each line evenly."""
        self._measure()
        self._launch("place_points", self._size, [self.courses], [self._place, self._weight])
        courses, places = self._spare_courses, [self._place, self._weight]
        self._launch("sample_courses", self._size, [self.courses, *places], [courses.xy, courses.section, courses.law])
        self.courses, self._spare_courses = courses, self.courses
        if self._count:
            directions = self._spare_directions
            threads, outputs = self._count * self._size, [directions.xy, directions.seed]
            self._launch("sample_directions", threads, [self.directions, *places], outputs)
            self.directions, self._spare_directions = directions, self.directions
        self._measure()


def _pieces(lines: Lines, size: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Offsets of pieces of so many points at most, none across two lines, and the line of each."""
    counts = np.diff(lines.start)
    pieces = -(-counts // size)
    owner = np.repeat(np.arange(lines.count), pieces)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    first = lines.start[owner] + nth * size
    return np.append(first, lines.start[-1]).astype(np.int32), owner.astype(np.int32)
