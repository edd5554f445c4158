"""Sections of unit area by Rosgen type, and the speed, width and depth that a discharge gives them.

A section has the area a = phi / u of its water [Peytavie2019]. The source leaves u open. Here it is that of uniform
flow: Manning's equation with Jarrett's roughness, in a section whose width is k mean depths, k by type.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from warpriver.arrays import FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.parameter import Params, parameter
from warpriver.public import public
from warpriver.riverscape.stations import TYPES
from warpriver.validate import floats

__all__ = [
    "BEND_TABLE",
    "FORMS",
    "FORM_TABLE",
    "LANES",
    "TEMPLATES",
    "FlowParams",
    "Template",
    "UniformFlow",
    "UnitSections",
    "bend_shape",
    "section_depth",
    "section_fill",
    "section_table",
    "spread_factor",
    "type_index",
    "uniform_flow",
    "unit_sections",
]


GRAVITY = 9.81
# Places across a section in the tables of its forms.
ACROSS = 65
# Lanes that the table of bends has: the deepest place as a part of the width from the left bank.
LANES = np.linspace(0.1, 0.9, 17)
# Rounds in which the area is found. The speed grows with its power 1/4 to 0.413; a step that is right for STRIDE leaves
# less than a tenth of the error.
ROUNDS, STRIDE = 16, 1.3

# Forms of straight sections: the depth over the greatest one at y = -1 (left bank) to 1. Trapezoids are named by the
# part of the width that is level.
FORMS = ("level_half", "polynomial", "parabola", "semicircle", "level_wide", "level_narrow", "plain")


def _form_table() -> FloatArray:
    y = np.linspace(-1.0, 1.0, ACROSS)
    trapezoids = {f: np.minimum(1.0, (1.0 - np.abs(y)) / (1.0 - f)) for f in (0.5, 0.6, 0.3, 0.9)}
    return np.stack(
        [
            trapezoids[0.5],
            1.0 - y**4,
            1.0 - y**2,
            np.sqrt(np.maximum(1.0 - y**2, 0.0)),
            trapezoids[0.6],
            trapezoids[0.3],
            trapezoids[0.9],
        ]
    )


def _bend_table() -> FloatArray:
    """Depth over the greatest one across a bend, by lane: 4 Y^k (1 - Y^k), a^k = 1/2 [Deutsch1996]."""
    share = np.linspace(0.0, 1.0, ACROSS)[None]
    lane = LANES[:, None]
    side = np.where(lane > 0.5, 1.0 - share, share)
    power = side ** (np.log(0.5) / np.log(np.minimum(lane, 1.0 - lane)))
    found: FloatArray = 4.0 * power * (1.0 - power)
    return found


FORM_TABLE, BEND_TABLE = _form_table(), _bend_table()
# Mean depths of these, as the tables are linear between their places.
FORM_FILL, BEND_FILL = ((t.sum(axis=1) - 0.5 * (t[:, 0] + t[:, -1])) / (ACROSS - 1) for t in (FORM_TABLE, BEND_TABLE))


class Template(NamedTuple):
    """Section of a type.

    Attributes:
        width_to_depth: Width over mean depth.
        form: Index into ``FORMS``.
        lanes: Lowest and highest lane in bends, parts of the width; None where bends do not tilt the section.
        sinuosity: Length of the course over that of the coarse one, where the terrain does not show bends.
    """

    width_to_depth: float
    form: int
    lanes: tuple[float, float] | None
    sinuosity: float


def _template(k: float, form: str, lanes: tuple[float, float] | None, sinuosity: float) -> Template:
    return Template(k, FORMS.index(form), lanes, sinuosity)


# By type, in the order of TYPES; D and DA are those of one thread. Width to depth and form are choices within the
# limits of [Rosgen1994], sinuosities those that are usual for a type, within the same limits.
TEMPLATES: tuple[Template, ...] = (
    _template(8.0, "level_half", None, 1.0),
    _template(10.0, "level_half", None, 1.0),
    _template(16.0, "polynomial", None, 1.05),
    _template(20.0, "parabola", (0.1, 0.9), 1.5),
    _template(20.0, "parabola", None, 1.1),
    _template(8.0, "parabola", None, 1.2),
    _template(8.0, "semicircle", (0.25, 0.75), 1.8),
    _template(25.0, "level_wide", (0.15, 0.85), 1.45),
    _template(9.0, "level_narrow", (0.15, 0.85), 1.25),
)


@dataclasses.dataclass(frozen=True)
class FlowParams(Params):
    """Constants of uniform flow in a section."""

    roughness_floor: float = parameter(
        0.03, "-", low=0.0, low_open=True, source="warpriver", doc="least Manning's n, of a smooth natural bed"
    )
    steepest: float = parameter(
        0.1,
        "m/m",
        low=0.0,
        low_open=True,
        source="warpriver",
        doc="slope at which roughness and speed are held on steeper ground: Jarrett measured up to 0.04",
    )
    gentlest: float = parameter(
        1e-4, "m/m", low=0.0, low_open=True, source="warpriver", doc="slope that level water is taken to have"
    )
    froude: float = parameter(1.0, "-", low=0.0, low_open=True, source="warpriver", doc="greatest Froude number")


class UniformFlow(NamedTuple):
    """Uniform flow in sections.

    Attributes:
        area: Area of the water, m2.
        speed: Mean speed, m/s.
        width: m.
        mean_depth: m.
        roughness: Manning's n.
        froude: Froude number.
    """

    area: FloatArray
    speed: FloatArray
    width: FloatArray
    mean_depth: FloatArray
    roughness: FloatArray
    froude: FloatArray


def type_index(name: str) -> int:
    """Return the index of a type, as "C", "C4" or "A+"; digits of the bed's material are left aside."""
    word = str(name).strip()
    bare = word.rstrip("123456") or word
    bare = "A+" if bare.lower() == "aa+" else bare
    if bare not in TYPES:
        raise InputError(f"type is {name!r}; use {', '.join(TYPES)}, with a digit of the bed's material or without")
    return TYPES.index(bare)


@public
def uniform_flow(
    flow: ArrayLike, slope: ArrayLike, width_to_depth: ArrayLike, params: FlowParams | None = None
) -> UniformFlow:
    """Find the area, speed and width of uniform flow with a discharge, on a slope, in a section of k = W / D.

        W = sqrt(a k),  R = sqrt(a) / (sqrt k + 2 / sqrt k),  n = max(0.03, 0.32 S^0.38 R^-0.16) [Jarrett1984],
        u = R^(2/3) S^(1/2) / n,  Froude <= 1,  a u = phi

    Args:
        flow: Discharge phi in m3/s.
        slope: S in m/m.
        width_to_depth: k, width over mean depth.
        params: Constants.

    Raises:
        ValueError: A discharge or a ratio that is not positive, or a slope that is not finite.
    """
    given = params or FlowParams()
    phi, s, k = np.broadcast_arrays(
        floats(flow, "flow"), floats(slope, "slope"), floats(width_to_depth, "width_to_depth")
    )
    for values, name, unit in ((phi, "flow", "m3/s"), (k, "width_to_depth", "")):
        wrong = ~((values > 0.0) & (values < 1e30))
        if wrong.any():
            raise InputError(f"{name} is {values[wrong].flat[0]:g}; give positive numbers{unit and f' of {unit}'}")
    if not np.isfinite(s).all():
        raise InputError("slope holds a value that is not finite; give m/m")
    s = np.clip(s, given.gentlest, given.steepest)
    root = np.sqrt(k) + 2.0 / np.sqrt(k)

    def at(area: FloatArray) -> tuple[FloatArray, FloatArray]:
        radius = np.sqrt(area) / root
        rough = np.maximum(given.roughness_floor, 0.32 * s**0.38 * radius**-0.16)
        limit = given.froude * np.sqrt(GRAVITY * np.sqrt(area / k))
        return np.minimum(radius ** (2.0 / 3.0) * np.sqrt(s) / rough, limit), rough

    area = np.array(phi, np.float64)
    for _ in range(ROUNDS):
        area = area * (phi / (area * at(area)[0])) ** (1.0 / STRIDE)
    speed, rough = at(area)
    # To the bit: area and speed belong together.
    area = phi / speed
    depth = np.sqrt(area / k)
    return UniformFlow(area, speed, np.sqrt(area * k), depth, rough, speed / np.sqrt(GRAVITY * depth))


def bend_shape(
    curvature: FloatArray, width: FloatArray, lanes: tuple[float, float] | None
) -> tuple[FloatArray, FloatArray]:
    """Return the lane and the weight of the bend's section by curvature: min(1, 2.5 |curvature| W).

    The deepest place moves to the outer bank as the weight grows: to the right where the course turns left.
    """
    if lanes is None:
        return np.full(len(curvature), 0.5), np.zeros(len(curvature))
    turn = np.clip(2.5 * curvature * width, -1.0, 1.0)
    lane = np.where(turn > 0.0, 0.5 + turn * (lanes[1] - 0.5), 0.5 + turn * (0.5 - lanes[0]))
    return lane, np.abs(turn)


def section_table(
    form: IndexArray, blend: FloatArray, lane: FloatArray, bend: FloatArray, forms: FloatArray = FORM_TABLE
) -> FloatArray:
    """Depth over its scale across sections, (n, ACROSS), from the left bank to the right one."""
    straight = (1.0 - blend)[:, None] * forms[form[:, 0]] + blend[:, None] * forms[form[:, 1]]
    place = (lane - LANES[0]) / (LANES[1] - LANES[0])
    k = np.clip(place.astype(np.int64), 0, len(LANES) - 2)
    part = (place - k)[:, None]
    tilted = (1.0 - part) * BEND_TABLE[k] + part * BEND_TABLE[k + 1]
    found: FloatArray = (1.0 - bend)[:, None] * straight + bend[:, None] * tilted
    return found


def section_depth(
    share: FloatArray,
    form: IndexArray,
    blend: FloatArray,
    lane: FloatArray,
    bend: FloatArray,
    forms: FloatArray = FORM_TABLE,
) -> FloatArray:
    """Depth over its scale at a part of the width from the left bank, one a section, (n,); 0 beyond the banks."""
    place = np.clip(share, 0.0, 1.0) * (ACROSS - 1)
    k = np.minimum(place.astype(np.int64), ACROSS - 2)
    shape, row, part = section_table(form, blend, lane, bend, forms), np.arange(len(share)), place - k
    inside = (share >= 0.0) & (share <= 1.0)
    return np.where(inside, (1.0 - part) * shape[row, k] + part * shape[row, k + 1], 0.0)


def section_fill(form: IndexArray, blend: FloatArray, lane: FloatArray, bend: FloatArray) -> FloatArray:
    """Mean depth over the depth's scale, (n,): what the scale of a section of unit area follows from."""
    straight = (1.0 - blend) * FORM_FILL[form[:, 0]] + blend * FORM_FILL[form[:, 1]]
    found: FloatArray = (1.0 - bend) * straight + bend * np.interp(lane, LANES, BEND_FILL)
    return found


def spread_factor(
    form: IndexArray, blend: FloatArray, lane: FloatArray, bend: FloatArray, forms: FloatArray = FORM_TABLE
) -> FloatArray:
    """Speed over mean speed where the depth is the scale of depth, (n,).

    Across a section u ~ d^(2/3); it is scaled so that the integral of u d is the discharge.
    """
    shape = section_table(form, blend, lane, bend, forms)
    # The integral of a linear depth to the power 5/3 over each step, by Simpson's rule.
    power = shape ** (5.0 / 3.0)
    middle = (0.5 * (shape[:, 1:] + shape[:, :-1])) ** (5.0 / 3.0)
    mean = (power[:, 1:] + power[:, :-1] + 4.0 * middle).mean(axis=1) / 6.0
    fill = (shape.sum(axis=1) - 0.5 * (shape[:, 0] + shape[:, -1])) / (shape.shape[1] - 1)
    found: FloatArray = fill / mean
    return found


class UnitSections(NamedTuple):
    """Sections whose water has an area of 1 m2, by type; one of area a is sqrt(a) times as wide and as deep.

    Attributes:
        width: (9,) width of the water in m, in the order of ``TYPES``.
        depth: (9, 65) depth in m at even places from the left bank to the right one, on straight reaches.
    """

    width: FloatArray
    depth: FloatArray


@public
def unit_sections() -> UnitSections:
    """Return the sections of all types; of types D and DA that of one thread.

    Its rows may be given wherever sections are taken as tables, as when rivers are carved into a landscape.
    """
    k = np.array([t.width_to_depth for t in TEMPLATES])
    form = np.array([t.form for t in TEMPLATES])
    width = np.sqrt(k)
    return UnitSections(width, FORM_TABLE[form] / (width * FORM_FILL[form])[:, None])
