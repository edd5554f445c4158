"""Stations of a synthetic valley: its lines in plan and what every element is at each of them.

The valley's frame has x along the axis from the upstream end of the reach and y to the left. Flow is towards +x, and
what Brown et al. count from the downstream end falls along it. A lead-in of stations at both ends keeps the surface
whole where the channel meets the ends of the valley at an angle.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from warpriver.arrays import FloatArray
from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.network import RiverNetwork
from warpriver.validate import checked_line
from warpriver.valley.controls import Term, evaluate
from warpriver.valley.params import Thread, ValleyParams

__all__ = [
    "Frame",
    "Line",
    "Stations",
    "ValleyLines",
    "curvature_series",
    "lay_stations",
    "lay_threads",
    "valley_lines",
]


# Samples an increment of lines that lengths are measured on, and their minimum number over the reach.
FINE, MIN_FINE = 16, 8192
# Samples over the reach that the extremes of control functions are taken from: for each increment, and their minimum.
EXTREME, MIN_EXTREME = 8, 8192
# Step of differences of a control function by its phase, rad: rounding and truncation are both below 1e-9.
PHASE_STEP = 2e-3
# The half-width on the inside of a blended bend stays below this fraction of its radius; how sharply it is held there.
BLEND, BLEND_POWER = 0.9, 8.0
# A curvature below this fraction of 1 / length counts as 0.
STRAIGHT = 1e-9


@dataclasses.dataclass(frozen=True)
class Frame:
    """Where the valley lies: absolute place of its zero, m, and direction of its axis, rad."""

    x: float = 0.0
    y: float = 0.0
    angle: float = 0.0

    def to_map(self, xy: FloatArray) -> FloatArray:
        """Turn places of the valley's frame, (..., 2), into absolute ones."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        return np.stack([self.x + c * xy[..., 0] - s * xy[..., 1], self.y + s * xy[..., 0] + c * xy[..., 1]], axis=-1)

    def to_valley(self, xy: FloatArray) -> FloatArray:
        """Turn absolute places, (..., 2), into those of the valley's frame."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        x, y = xy[..., 0] - self.x, xy[..., 1] - self.y
        return np.stack([c * x + s * y, c * y - s * x], axis=-1)


@dataclasses.dataclass(frozen=True)
class Line:
    """A line of points at even distances along it, with its tangents and curvature; left turns are above 0."""

    s: FloatArray
    xy: FloatArray
    tangent: FloatArray
    curvature: FloatArray


@dataclasses.dataclass(frozen=True)
class Stations:
    """The main channel at its stations.

    Attributes:
        frame: Where the valley lies.
        length: L_s, length of the channel's line over the reach, m.
        axis_length: L_x, m.
        lead: Stations of the lead-in at each end.
        line: The channel's line, lead-in included; s is 0 at the upstream end of the reach.
        position: (n,) 0 to 1 over the reach, what elements are stationed by.
        width: (n,) bankfull width, m.
        depth: (n,) bankfull depth, m.
        thalweg: (n,) thalweg below the plane of top of bank, as a rise, m.
        lift: (n,) top of bank above its plane, m.
        apex: (n,) place of the maximum depth, 0 left bank to 1 right bank.
        half: (n, 2) half-widths to the left and right, m; they differ in blended bends.
        residual: (n,) control function of the thalweg.
        section_curvature: (n,) curvature that the section leans by: that of the control, else of the line, 1/m.
        bank_height: Top of bank at the downstream end, m.
    """

    frame: Frame
    length: float
    axis_length: float
    lead: int
    line: Line
    position: FloatArray
    width: FloatArray
    depth: FloatArray
    thalweg: FloatArray
    lift: FloatArray
    apex: FloatArray
    half: FloatArray
    residual: FloatArray
    section_curvature: FloatArray
    bank_height: float

    @property
    def reach(self) -> slice:
        """The stations of the reach, without the lead-in."""
        return slice(self.lead, len(self.position) - self.lead)


@dataclasses.dataclass(frozen=True)
class ValleyLines:
    """Edges of the valley by x, a row for each of them.

    The columns are left floor, left top, right floor, right top (y, m), floor and top rise, and how far the long
    profile lies above the plane of top of bank (m).
    """

    start: float
    step: float
    table: FloatArray


# ---- the channel


def lay_stations(params: ValleyParams, thalweg: Sequence[Term]) -> Stations:
    """Evaluate the channel's elements at its stations [Brown2014], eqs 5, 6, 13 to 15 and 19 to 21.

    With ``bank_window`` top of bank follows the highest riffle crest within the window, in place of that of the reach.

    Args:
        params: The valley.
        thalweg: Control function of the thalweg: the one given, or one that follows from a covariance target.

    Raises:
        ValueError: A width or depth is not positive, or the width exceeds twice a bend's radius; the station is named.
    """
    every = np.linspace(0.0, 1.0, max(EXTREME * params.increments, MIN_EXTREME) + 1)
    controls = params.controls
    spread = evaluate(controls.get("width", ()), every)
    _refuse(params, every, 1.0 + spread, "width", "the amplitude of its control function is too large")
    highest = float(evaluate(thalweg, every).max())

    # Sections at the ends of the reach are tilted: as far as their banks reach beyond it, and a half more.
    lead_length = 0.75 * params.width * float(1.0 + spread.max())
    frame, place, axis_length = _centerline(params, lead_length)
    line, length, lead = _even_line(place, axis_length, lead_length, params.increments)

    inside = np.clip(line.s / length, 0.0, 1.0)
    position = np.clip(line.xy[:, 0] / axis_length, 0.0, 1.0) if params.stationing == "valley" else inside
    width = params.width * (1.0 + evaluate(controls.get("width", ()), position))
    residual = evaluate(thalweg, position)
    raised = evaluate(controls.get("bank", ()), position)
    mean = params.bankfull_depth
    if params.bank_window is not None:
        raised = raised + _windowed_maximum(residual, params.bank_window * params.increments / length) - highest
    depth = mean * (1.0 + highest - residual + raised)
    _refuse(params, position, depth, "depth", "the control function of the bank lies below the thalweg")
    curvature = curvature_series(params, position, line.curvature)
    maximum = float(np.abs(curvature[lead : len(curvature) - lead]).max())
    apex = np.full(len(position), 0.5)
    if maximum > STRAIGHT / axis_length:
        apex += 0.5 * np.clip(curvature / maximum, -1.0, 1.0) / params.curvature_limit
    lift = mean * raised
    if params.fall == "channel":
        along = np.clip(line.xy[:, 0] / axis_length, 0.0, 1.0)
        bend = params.profile.bend(inside) - params.profile.bend(along)
        lift = lift + params.slope * (line.xy[:, 0] - axis_length * inside + axis_length * bend)
    return Stations(
        frame=frame,
        length=length,
        axis_length=axis_length,
        lead=lead,
        line=line,
        position=position,
        width=width,
        depth=depth,
        thalweg=lift - depth,
        lift=lift,
        apex=apex,
        half=_halves(params, line, width, slice(lead, len(position) - lead)),
        residual=residual,
        section_curvature=curvature,
        bank_height=params.datum + mean * (2.0 + highest),
    )


def curvature_series(params: ValleyParams, position: FloatArray, measured: FloatArray) -> FloatArray:
    """Curvature that sections lean by: of the control's line in radians of the reach, eq. 24, else of the channel.

    Args:
        params: The valley.
        position: (n,) stationing.
        measured: (n,) curvature of the channel's line.
    """
    terms = params.controls.get("curvature", ())
    if not terms:
        return measured
    step = PHASE_STEP / (2.0 * math.pi)
    f = [evaluate(terms, position + k * step) for k in (-2, -1, 0, 1, 2)]
    slope = (f[0] - 8.0 * f[1] + 8.0 * f[3] - f[4]) / (12.0 * PHASE_STEP)
    bend = (-f[0] + 16.0 * f[1] - 30.0 * f[2] + 16.0 * f[3] - f[4]) / (12.0 * PHASE_STEP**2)
    return bend / (1.0 + slope**2) ** 1.5


def _centerline(params: ValleyParams, lead_length: float) -> tuple[Frame, FloatArray, float]:
    """Frame, finely sampled line in it with straight or natural ends well beyond the reach, and length of the axis."""
    if params.line is None:
        length = params.length
        beyond = 1.5 * lead_length + 12.0 * length / params.increments
        count = max(FINE * params.increments, MIN_FINE)
        ends = math.ceil(beyond / length * count)
        x = length * np.arange(-ends, count + ends + 1) / count
        return Frame(), np.column_stack([x, evaluate(params.controls.get("centerline", ()), x / length)]), length
    with IMPORTING:
        from scipy.interpolate import CubicSpline

    given = _checked_line(params.line)
    axis = given[-1] - given[0]
    frame = Frame(float(given[0, 0]), float(given[0, 1]), math.atan2(axis[1], axis[0]))
    local = frame.to_valley(given)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(local, axis=0).T))])
    curve = CubicSpline(along, local, bc_type="natural")
    count = max(FINE * params.increments, MIN_FINE)
    middle = curve(np.linspace(0.0, along[-1], count + 1))
    reach = np.linspace(0.0, 1.5 * lead_length + 12.0 * along[-1] / params.increments, 65)[1:, None]
    head, tail = (curve(t, 1) / np.hypot(*curve(t, 1)) for t in (0.0, along[-1]))
    local = np.concatenate([middle[0] - reach[::-1] * head, middle, middle[-1] + reach * tail])
    return frame, local, float(np.hypot(*axis))


def _checked_line(line: object) -> FloatArray:
    """Points of a given centreline; raises ValueError."""
    if isinstance(line, RiverNetwork):
        if line.channel_count != 1:
            raise InputError(f"line is a network of {line.channel_count} channels; give one of its polylines()")
        line = line.polylines()[0]
    xy = checked_line(line, "line")
    if len(xy) < 4:
        raise InputError(f"line has {len(xy)} points; give 4 or more, downstream")
    if np.hypot(*(xy[-1] - xy[0])) < 0.05 * np.hypot(*np.diff(xy, axis=0).T).sum():
        raise InputError("line ends close to where it starts, so that it has no valley axis; give a shorter stretch")
    return xy


def _even_line(fine: FloatArray, axis_length: float, lead_length: float, increments: int) -> tuple[Line, float, int]:
    """Line of even stations, its length over the reach, and the number of stations in each lead-in.

    The reach is between the points of the fine line at x = 0 and at x = L_x that lie closest to its ends.
    """
    with IMPORTING:
        from scipy.interpolate import CubicSpline

    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    ends = [_crossing(fine, s, at, first) for at, first in ((0.0, True), (axis_length, False))]
    length = ends[1] - ends[0]
    spacing = length / increments
    beyond = min(ends[0], float(s[-1]) - ends[1])
    lead = min(math.ceil(lead_length / spacing), math.floor(beyond / spacing) - 3)
    at: FloatArray = ends[0] + spacing * np.arange(-lead - 2, increments + lead + 3, dtype=np.float64)
    xy = CubicSpline(s, fine)(at)
    tangent = (xy[:-4] - 8.0 * xy[1:-3] + 8.0 * xy[3:-1] - xy[4:]) / (12.0 * spacing)
    bend = (-xy[:-4] + 16.0 * xy[1:-3] - 30.0 * xy[2:-2] + 16.0 * xy[3:-1] - xy[4:]) / (12.0 * spacing**2)
    speed = np.hypot(*tangent.T)
    curvature = (tangent[:, 0] * bend[:, 1] - tangent[:, 1] * bend[:, 0]) / speed**3
    return Line(at[2:-2] - ends[0], xy[2:-2], tangent / speed[:, None], curvature), length, lead


def _crossing(fine: FloatArray, s: FloatArray, x: float, first: bool) -> float:
    """Length along the fine line at the point of the reach's end: on the axis for a given line, at x for a function."""
    distance = np.abs(fine[:, 0] - x)
    if fine[0, 0] < fine[1, 0] and (np.diff(fine[:, 0]) > 0.0).all():
        return float(np.interp(x, fine[:, 0], s))
    near = np.flatnonzero(np.hypot(distance, fine[:, 1]) <= np.hypot(distance, fine[:, 1]).min() + 1e-9)
    return float(s[near[0] if first else near[-1]])


def _halves(params: ValleyParams, line: Line, width: FloatArray, reach: slice) -> FloatArray:
    """Half-widths to the left and right, (n, 2); raises ValueError where sections of a bend would cross."""
    half = np.column_stack([0.5 * width, 0.5 * width])
    tight = np.abs(line.curvature) * half[:, 0]
    if params.sharp_bends == "error":
        over = np.flatnonzero(tight[reach] >= 1.0)
        if len(over):
            k = reach.start + over[np.argmax(tight[reach][over])]
            raise InputError(
                f"{params.name}: at station {line.s[k]:.4g} m the width, {width[k]:.4g} m, exceeds twice the radius of "
                f"the bend, {1.0 / abs(line.curvature[k]):.4g} m, so that sections cross; widen the bend, or set "
                'sharp_bends = "blend"'
            )
        return half
    inner = 0.5 * width * (1.0 + (tight / BLEND) ** BLEND_POWER) ** (-1.0 / BLEND_POWER)
    half[line.curvature > 0.0, 0] = inner[line.curvature > 0.0]
    half[line.curvature < 0.0, 1] = inner[line.curvature < 0.0]
    return half


def _refuse(params: ValleyParams, position: FloatArray, value: FloatArray, what: str, why: str) -> None:
    """Raise ValueError that names the station where a value is not positive."""
    if not (value > 0.0).all():
        k = int(np.argmin(value))
        unit = params.width if what == "width" else 1.0
        raise InputError(
            f"{params.name}: the {what} is {unit * value[k]:.4g} m at station {position[k]:.4g} of the reach; {why}"
        )


# ---- threads and the valley's edges


def lay_threads(params: ValleyParams, main: Stations) -> list[tuple[Line, FloatArray, FloatArray]]:
    """Further channels: line, half-widths (n, 2), and (depth, apex, lift), (n, 3), of each."""
    made = []
    at = main.line.s / main.length
    for thread in params.threads:
        made.append(_lay_thread(params, main, at, thread))
    return made


def _lay_thread(
    params: ValleyParams, main: Stations, at: FloatArray, thread: Thread
) -> tuple[Line, FloatArray, FloatArray]:
    count = max(16, round((thread.end - thread.start) * params.increments))
    u = np.linspace(thread.start, thread.end, FINE * count + 1)

    def column(values: FloatArray) -> FloatArray:
        return np.interp(u, at, values)

    normal = np.column_stack([-column(main.line.tangent[:, 1]), column(main.line.tangent[:, 0])])
    offset = thread.offset * np.sin(math.pi * (u - thread.start) / (thread.end - thread.start)) ** 2
    fine = np.column_stack([column(main.line.xy[:, 0]), column(main.line.xy[:, 1])]) + offset[:, None] * normal
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    even: FloatArray = np.linspace(0.0, float(s[-1]), count + 1, dtype=np.float64)
    xy = np.column_stack([np.interp(even, s, fine[:, 0]), np.interp(even, s, fine[:, 1])])
    tangent = np.gradient(xy, even, axis=0)
    bend = np.gradient(tangent, even, axis=0)
    speed = np.hypot(*tangent.T)
    curvature = (tangent[:, 0] * bend[:, 1] - tangent[:, 1] * bend[:, 0]) / speed**3
    line = Line(even, xy, tangent / speed[:, None], curvature)
    place = np.interp(even, s, u)
    width = thread.width * np.interp(place, at, main.width)
    form = np.column_stack(
        [
            thread.depth * np.interp(place, at, main.depth),
            np.interp(place, at, main.apex),
            np.interp(place, at, main.lift),
        ]
    )
    return line, _halves(params, line, width, slice(0, len(even))), form


def valley_lines(
    params: ValleyParams, main: Stations, threads: Sequence[tuple[Line, FloatArray, FloatArray]]
) -> ValleyLines:
    """Edges of the valley's floor and top by x [Brown2014], eqs 9 to 12, 16 and 17, with left at +y.

    Raises:
        ValueError: A valley side is narrower than 0; x is named.
    """
    reach = main.reach
    lines = [(main.line.xy, main.line.tangent, main.half)] + [(t[0].xy, t[0].tangent, t[1]) for t in threads]
    begin = min(0.0, float(main.line.xy[reach, 0].min()))
    end = max(main.axis_length, float(main.line.xy[reach, 0].max()))
    count = max(params.increments, 512)
    x: FloatArray = np.linspace(begin, end, count + 1, dtype=np.float64)
    left, right = _outermost_banks(lines, x, params.floor_window)
    u = (x - begin) / (end - begin)
    every = np.linspace(0.0, 1.0, max(EXTREME * params.increments, MIN_EXTREME) + 1)
    f = {k: evaluate(params.controls.get(k, ()), u) for k in ("left_top", "right_top", "floor", "top")}
    toe = {}
    for side in ("left_floor", "right_floor"):
        terms = params.controls.get(side, ())
        toe[side] = evaluate(terms, u) - float(evaluate(terms, every).min()) + 0.5 * params.floor_width
    table = np.empty((len(x), 7))
    table[:, 0], table[:, 2] = left + toe["left_floor"], right - toe["right_floor"]
    for side, edge, column, sign in (("left_top", 0, 1, 1.0), ("right_top", 2, 3, -1.0)):
        width = 0.5 * params.top_width + f[side]
        if (width < 0.0).any():
            k = int(np.argmin(width))
            raise InputError(
                f"{params.name}: the valley side {side} is {width[k]:.4g} m wide at x = {x[k]:.4g} m; "
                "the amplitude of its control function is too large"
            )
        table[:, column] = table[:, edge] + sign * width
    steeper = 0.0 if params.valley_slope is None else params.valley_slope - params.slope
    table[:, 4] = params.floor_height + f["floor"] + steeper * (end - x)
    table[:, 5] = params.top_height + f["top"]
    table[:, 6] = params.slope * main.axis_length * params.profile.bend(x / main.axis_length)
    return ValleyLines(begin, (end - begin) / count, table)


def _outermost_banks(
    lines: Sequence[tuple[FloatArray, FloatArray, FloatArray]], x: FloatArray, window: float | None
) -> tuple[FloatArray, FloatArray]:
    """Highest and lowest y of any bank, (n,) each, of the whole reach or within a window around each x.

    Args:
        lines: Places, tangents and half-widths of each channel.
        x: (n,) even places along the axis, m.
        window: Length of the window, m.
    """
    step = x[1] - x[0]
    left, right = np.full(len(x), -math.inf), np.full(len(x), math.inf)
    for xy, tangent, half in lines:
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
        # In a line that turns back the left bank may be the lower one.
        for bank in (xy + half[:, :1] * normal, xy - half[:, 1:] * normal):
            on = (bank[:, 0] >= x[0]) & (bank[:, 0] <= x[-1])
            # A bank counts at both places beside it, so that the edges between them lie outside as well.
            for side in (np.floor, np.ceil):
                at = np.clip(side((bank[on, 0] - x[0]) / step).astype(int), 0, len(x) - 1)
                np.maximum.at(left, at, bank[on, 1])
                np.minimum.at(right, at, bank[on, 1])
    if window is None:
        return np.full(len(x), left.max()), np.full(len(x), right.min())
    return _windowed_maximum(left, window / step), -_windowed_maximum(-right, window / step)


def _windowed_maximum(series: FloatArray, samples: float) -> FloatArray:
    """Smooth upper envelope of an even series, (n,): its maximum within a window, averaged over a window as long.

    No value lies below the series: each maximum that is averaged is of a window with that sample in it. Samples without
    a value are -inf.

    Args:
        series: (n,) values.
        samples: Length of the window in samples; at least one sample on either side is looked at.
    """
    with IMPORTING:
        from scipy.ndimage import maximum_filter1d, uniform_filter1d

    size = 2 * max(1, round(0.5 * samples)) + 1
    highest = maximum_filter1d(series, size, mode="nearest")
    known = np.flatnonzero(np.isfinite(highest))
    highest = np.interp(np.arange(len(series)), known, highest[known])
    return np.asarray(uniform_filter1d(highest, size, mode="nearest"))
