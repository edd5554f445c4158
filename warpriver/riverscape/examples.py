"""Three reaches of 60 to 76 m as in the document's Table 1: a step-pool brook, a meandering one, a braided one."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.extras import IMPORTING
from warpriver.public import public
from warpriver.riverscape.courses import Course, Rock
from warpriver.terrain import Terrain
from warpriver.validate import one_of, seeded

__all__ = ["Example", "example"]


GRAVITY = 9.81
# Length, slope, discharge (m, m/m, m3/s): of the document the length; the others such that water is as wide as its
# number of primitives says, at one every 50 cm.
SCENES = {"A": (63.0, 0.045, 0.055), "C": (76.0, 0.017, 0.042), "D": (60.0, 0.018, 0.072)}
# Width over greatest depth, and the form of the section, by type.
SECTIONS = {"A": (10.0, "trapezoid"), "C": (20.0, "parabola"), "D": (20.0, "parabola")}
# Of the ground's raster, m; how far it goes beyond the water; how high banks are.
CELL, MARGIN, BANK = 0.5, 10.0, 0.3


@dataclasses.dataclass(frozen=True, eq=False)
class Example:
    """A reach: what :class:`warpriver.riverscape.Riverscape` takes.

    Attributes:
        terrain: The ground before it is carved.
        courses: Its channels.
        rocks: Boulders.
    """

    terrain: Terrain
    courses: list[Course]
    rocks: list[Rock]


@public
def example(name: str, seed: int = 0) -> Example:
    """Return one of three reaches of the document's Table 1.

    Args:
        name: "A": 63 m of steps and pools at 7 %; "C": 76 m of a meandering brook; "D": 60 m of three threads.
        seed: Of what is drawn: places of steps and rocks, courses, and the ground.

    Raises:
        ValueError: Another name.

    Source:
        [Peytavie2019], Table 1; roughness and speed [Jarrett1984]; steps and bends as in the code.
    """
    one_of(name, "name", tuple(SCENES))
    random = seeded(seed)
    length, slope, flow = SCENES[name]
    made = {"A": _steps, "C": _meander, "D": _braid}[name]
    courses = made(length, slope, flow, random)
    rocks = _rocks(name, courses, random)
    return Example(_ground(name, courses, random), courses, rocks)


def hydraulics(kind: str, flow: float, slope: float) -> tuple[float, float, float]:
    """Width, greatest depth and mean speed of a section that carries a discharge.

    u = R^(2/3) S^(1/2) / n, n = max(0.03, 0.32 S^0.38 R^-0.16), S held at 0.1 in n [Jarrett1984]; a Froude number of 1
    at most.
    """
    ratio, form = SECTIONS[kind]
    share = 0.75 if form == "trapezoid" else 2.0 / 3.0
    low, high = 1e-6, 1e6
    for _ in range(80):
        area = math.sqrt(low * high)
        width = math.sqrt(area * ratio / share)
        depth = width / ratio
        radius = area / (width + 2.0 * depth)
        rough = max(0.03, 0.32 * min(slope, 0.1) ** 0.38 * radius**-0.16)
        speed = min(radius ** (2.0 / 3.0) * math.sqrt(slope) / rough, math.sqrt(GRAVITY * area / width))
        low, high = (area, high) if area * speed < flow else (low, area)
    return width, depth, speed


def _steps(length: float, slope: float, flow: float, random: np.random.Generator) -> list[Course]:
    """Type A: steps 8.25 (100 S)^-0.98 widths apart, flat pools between them, wider than the steps."""
    width, depth, speed = hydraulics("A", flow, slope)
    apart = 8.25 * (100.0 * slope) ** -0.98 * width
    count = round(length / apart)
    step = (np.arange(count) + 0.5 + random.uniform(-0.25, 0.25, count)) * length / count
    blending = 0.06
    between = np.linspace(0.0, length, round(length / 0.25) + 1)
    between = between[np.abs(between[:, None] - step).min(axis=1) > 2.5 * blending]
    along = np.sort(np.concatenate([between, step - blending, step + blending]))
    falls = np.searchsorted(along, step - blending)
    # The water falls by the slope times the distance to the steps around, and lies flat between.
    edges = np.concatenate([[0.0], 0.5 * (step[1:] + step[:-1]), [length]])
    drop = slope * np.diff(edges)
    level = slope * length - np.concatenate([[0.0], np.cumsum(drop)])[np.searchsorted(step, along)]
    x, y = along, 0.8 * np.sin(2.0 * np.pi * along / 21.0 + 1.0) + 0.35 * np.sin(2.0 * np.pi * along / 8.3)
    near = np.abs(along[:, None] - step).min(axis=1) / apart
    wide = 0.93 + 0.17 * np.clip(near / 0.3, 0.0, 1.0) ** 2
    # A pool is deepest below its step.
    behind = along - step[np.maximum(np.searchsorted(step, along) - 1, 0)]
    deep = 0.75 + 1.0 * np.exp(-(((behind - 0.3 * apart) / (0.25 * apart)) ** 2)) * (behind > 0.0)
    place = np.linspace(1.0, -1.0, 33)
    form = np.clip((1.0 - np.abs(place)) / 0.5, 0.0, 1.0)
    here = speed / (wide * deep)
    return [Course(np.column_stack([x, y]), level + 2.0, width * wide, depth * deep, here, "A", form, falls)]


def _meander(length: float, slope: float, flow: float, random: np.random.Generator) -> list[Course]:
    """Type C: a sine-generated curve of sinuosity 1.45, wavelength 11 widths; deep at the outer banks."""
    width, depth, speed = hydraulics("C", flow, slope)
    omega, period = 1.15, 11.0 * width * 1.45
    along = np.linspace(0.0, length, round(length / 0.4) + 1)
    angle = omega * np.sin(2.0 * np.pi * along / period + 0.6)
    step = np.diff(along)
    middle = 0.5 * (angle[1:] + angle[:-1])
    xy = np.concatenate([[[0.0, 0.0]], np.cumsum(np.column_stack([np.cos(middle), np.sin(middle)]) * step[:, None], 0)])
    curvature = np.gradient(angle, along)
    form = bend_form(curvature * width, 0.1)
    # Pools in bends, riffles on the straights between.
    bend = np.clip(np.abs(curvature) * width / 0.45, 0.0, 1.0)
    deep = 0.8 + 0.7 * bend
    wide = 1.08 - 0.12 * bend
    fall = slope * (1.5 - 0.8 * bend)
    level = -np.concatenate([[0.0], np.cumsum(0.5 * (fall[1:] + fall[:-1]) * step)])
    area = wide * deep * form.mean(axis=1) / form.mean(axis=1).mean()
    return [Course(xy, level - level[-1] + 1.0, width * wide, depth * deep, speed / area, "C", form)]


def bend_form(curvature_width: FloatArray, nearest: float) -> FloatArray:
    """Sections from a parabola on straights to 4 x^b (1 - x^b) in bends [Deutsch1996], by min(1, 2.5 |curvature| W).

    Args:
        curvature_width: (n,) curvature times width, above 0 to the left.
        nearest: How near the deepest place comes to a bank, of the width.
    """
    weight = np.minimum(1.0, 2.5 * np.abs(curvature_width))[:, None]
    x = np.linspace(0.0, 1.0, 33)
    # The deepest place from the left bank: on the right in a bend to the left.
    deepest = np.clip(0.5 + np.sign(curvature_width)[:, None] * 0.4 * weight, nearest, 1.0 - nearest)
    right = deepest >= 0.5
    across = np.where(right, x, 1.0 - x)
    b = -math.log(2.0) / np.log(np.where(right, deepest, 1.0 - deepest))
    return (1.0 - weight) * 4.0 * x * (1.0 - x) + weight * 4.0 * across**b * (1.0 - across**b)


def _braid(length: float, slope: float, flow: float, random: np.random.Generator) -> list[Course]:
    """Type D: three threads from one node to another, each with its share of the water and a course of its own."""
    shares = np.array([0.4, 0.26, 0.34])
    along = np.linspace(0.0, length, round(length / 0.4) + 1)
    courses = []
    for k, share in enumerate(shares):
        width, depth, speed = hydraulics("D", flow * share, slope)
        apart = np.sin(np.pi * along / length) ** 0.7
        phase = random.uniform(0.0, 2.0 * np.pi)
        sway = 0.9 * np.sin(2.0 * np.pi * along / 19.0 + phase) + 0.4 * np.sin(2.0 * np.pi * along / 8.0 + 2.0 * phase)
        y = apart * (3.4 * (1.0 - k) + sway)
        xy = np.column_stack([along, y])
        level = slope * (length - along) + 1.0
        courses.append(Course(xy, level, width, depth, speed, "D"))
    return courses


def _rocks(name: str, courses: list[Course], random: np.random.Generator) -> list[Rock]:
    """Boulders: at the rims of falls and in pools (A), on straights and bars (C, D)."""
    rocks = []
    for course in courses:
        xy, level, half = np.asarray(course.xy), np.asarray(course.level), 0.5 * np.asarray(course.width)
        left = np.column_stack([-course.direction[:, 1], course.direction[:, 0]])
        points = np.asarray(course.falls)
        for k in points:
            for side in (-1.0, 1.0):
                size = random.uniform(0.3, 0.6)
                place = xy[k] + left[k] * side * half[k] * random.uniform(0.75, 1.15)
                rocks.append(Rock(tuple(place), size, level[k] + random.uniform(0.02, 0.12)))
        spare = {"A": 8, "C": 7, "D": 3}[name]
        for k in random.integers(4, len(xy) - 4, spare):
            size = random.uniform(0.25, 0.45)
            place = xy[k] + left[k] * half[k] * random.uniform(-0.5, 0.5)
            rocks.append(Rock(tuple(place), size, level[k] + random.uniform(0.03, 0.1)))
    return rocks


def _ground(name: str, courses: list[Course], random: np.random.Generator) -> Terrain:
    """Ground above the water: a plain, or the sides of a steep valley, with bumps of a few metres' length."""
    with IMPORTING:
        from scipy.ndimage import gaussian_filter
        from scipy.spatial import cKDTree

    xy = np.concatenate([np.asarray(c.xy) for c in courses])
    level = np.concatenate([np.asarray(c.level) for c in courses])
    half = np.concatenate([0.5 * np.asarray(c.width) for c in courses])
    low, high = xy.min(axis=0) - MARGIN, xy.max(axis=0) + MARGIN
    columns, rows = (math.ceil(v / CELL) for v in high - low)
    x, y = low[0] + CELL * (np.arange(columns) + 0.5), high[1] - CELL * (np.arange(rows) + 0.5)
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    far, near = cKDTree(xy).query(at)
    beyond = np.maximum(far - half[near], 0.0).reshape(rows, columns)
    sides, bank, bumps = {"A": (0.35, 0.3, 0.25), "C": (0.02, 0.3, 0.1), "D": (0.01, 0.06, 0.06)}[name]
    # All three run east: the valley falls as the water does, less its steps.
    order = np.argsort(xy[:, 0])
    trend = np.polynomial.Polynomial.fit(xy[order, 0], level[order], 3)
    base = np.maximum(trend(np.clip(x, xy[:, 0].min(), xy[:, 0].max())), level.min())[None, :]
    rough = sum(
        size * field / field.std()
        for size, field in (
            (1.0, gaussian_filter(random.normal(size=(rows, columns)), 6.0)),
            (0.35, gaussian_filter(random.normal(size=(rows, columns)), 1.5)),
        )
    )
    edge = 1.0 - np.exp(-beyond / 2.0)
    height = base + bank * (0.5 + 0.5 * edge) + sides * beyond * edge + bumps * rough * (0.25 + 0.75 * edge)
    # Water stays between its banks.
    banks = np.concatenate([c.bank_level for c in courses])[near].reshape(rows, columns)
    height = np.maximum(height, banks + 0.12 + 0.04 * rough)
    return Terrain(height, CELL, (float(low[0]), float(low[1]) + rows * CELL))
