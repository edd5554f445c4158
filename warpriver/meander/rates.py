"""Migration rates of a network as it stands: what its points would do next, without a simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.device import PRECISIONS
from warpriver.engine.stages import launch, whole_share
from warpriver.engine.stems import StemArrays, find_map_edges
from warpriver.engine.stepper import check_ground
from warpriver.errors import InputTypeError
from warpriver.extras import IMPORTING
from warpriver.kernels import migration as kernels
from warpriver.meander.memory import StemMemory, migration_constants
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams
from warpriver.public import public
from warpriver.terrain import Terrain

with IMPORTING:
    from scipy.interpolate import CubicSpline

__all__ = ["migration_rate"]

# Segments that differ by more than this part count as uneven: the kernel takes all of a channel for equal.
EVENNESS = 0.01
# Places on each segment of an uneven line where the length of the cubic through it is measured.
PLACES = 8


@public
def migration_rate(network: RiverNetwork, params: MeanderParams, terrain: Terrain | None = None) -> list[np.ndarray]:
    """Return the migration rate of every point of a network as it stands, on the network's device.

    It is the rate of the first, infinitely short step of a simulation [Howard1984, Paris2023], by the same kernel:
    omega k w C, plus the weighted mean of k w C upstream, with the sinuosity of the whole channel. Nothing is smoothed.
    It is multiplied by what steers a step:

    - at both ends of a line what is felt of the bends upstream fades to 0 over ``params.end_damping`` widths, as
      3 t^2 - 2 t^3 of the distance to the end: there bends only straighten. With ``end_damping=0`` the rate is that of
      the law alone, also at the end points, which a simulation holds;
    - on a terrain of slope s it is multiplied by 1 - t^2 (3 - 2 t), t = s / ``params.slope_threshold``: 0 from the
      threshold on, off the map and where there is no data.

    The random strength of banks, controls, and what enters at inlets depend on a simulation and have no part in it.

    The kernel takes the points of a channel for evenly spaced, as those of a simulation are. A channel whose segments
    differ by more than 1 % is evaluated at as many even points on the cubic spline through its own, and the rates are
    brought back by arc length, with a cubic as well.

    Example::

        network = wr.RiverNetwork.from_polylines([xy], width=60.0)
        rate = wr.meander.migration_rate(network, wr.MeanderParams())[0]      # m/yr, > 0: to the right of the flow

    Args:
        network: The network; it is left as it is.
        params: Migration constants; those of time steps, cutoffs and collisions do not count.
        terrain: The ground, on any device, or None for a plain.

    Returns:
        One (n,) float64 array a channel, m/yr, positive to the right of the flow. A bend to the left, of positive
        curvature, has a local part to the right: it grows.

    Raises:
        TypeError: An argument is of another kind.
        ValueError: The terrain lies elsewhere or in another CRS.
    """
    for name, value, kind in (("network", network, RiverNetwork), ("params", params, MeanderParams)):
        if not isinstance(value, kind):
            raise InputTypeError(f"{name} is a {type(value).__name__}; give a {kind.__name__}")
    if terrain is not None and not isinstance(terrain, Terrain):
        raise InputTypeError(f"terrain is a {type(terrain).__name__}; give a Terrain, or None for a plain")
    check_ground(network, terrain)
    params = params.for_widths(network.channel_width)
    lines = [_Line(*each) for each in zip(network.polylines(), network.channel_closed.tolist(), strict=True)]
    rates = _compute_rates(network, lines, params, terrain)
    rates = [line.at_points(rate) for line, rate in zip(lines, rates, strict=True)]
    if terrain is not None:
        weight = _slope_weight(terrain, network.points(), params.slope_threshold)
        rates = [r * w for r, w in zip(rates, np.split(weight, network.starts()[1:-1]), strict=True)]
    return rates


class _Line:
    """A channel's line with the even points where its rates are evaluated: its own points, if they are even.

    Attributes:
        closed: Whether it is a ring.
        spacing: Even spacing, m.
        length: Length, m; of a ring all the way round.
        arc: (n,) arc length of the channel's points, m.
        even: (n,) arc length of the even points, m; None where those are the channel's own.
        xy: (n, 2) the even points, m.
    """

    def __init__(self, xy: np.ndarray, closed: bool):
        self.closed, self.xy = closed, xy
        self.even: np.ndarray | None = None
        around = np.concatenate([xy, xy[:1]]) if closed else xy
        chord = np.hypot(*np.diff(around, axis=0).T)
        arc = np.concatenate([[0.0], np.cumsum(chord)])
        if np.ptp(chord) > EVENNESS * chord.mean():
            arc, self.even, self.xy = self._sample_evenly(around, arc)
        self.length, self.arc = float(arc[-1]), arc[: len(xy)]
        self.spacing = self.length / len(chord)

    def _sample_evenly(self, around: np.ndarray, chord_arc: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return arc lengths of the points along the cubic through them, and of as many even points, and those."""
        kept = np.concatenate([[True], np.diff(chord_arc) > 0.0])  # points that stand twice count once
        bounds = "periodic" if self.closed else "natural"
        curve = CubicSpline(chord_arc[kept], around[kept], bc_type=bounds)
        within = np.linspace(chord_arc[:-1], chord_arc[1:], PLACES + 1)[1:]
        at = np.concatenate([chord_arc[:1], within.T.ravel()])
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve(at), axis=0).T))])
        even = np.linspace(0.0, arc[-1], len(around))[: len(around) - self.closed]
        return arc[::PLACES], even, curve(np.interp(even, arc, at))

    def at_even(self, values: np.ndarray) -> np.ndarray:
        """Return values of the channel's points, such as widths, at the even points, linear in between."""
        if self.even is None:
            return values
        even: np.ndarray = np.interp(self.even, self.arc, values, period=self.length if self.closed else None)
        return even

    def at_points(self, rate: np.ndarray) -> np.ndarray:
        """Return rates of the even points at the channel's points."""
        if self.even is None:
            return rate
        if self.closed:
            spline = CubicSpline(np.append(self.even, self.length), np.append(rate, rate[0]), bc_type="periodic")
        else:
            spline = CubicSpline(self.even, rate)
        along: np.ndarray = spline(self.arc)
        return along


def _compute_rates(
    network: RiverNetwork, lines: list[_Line], params: MeanderParams, terrain: Terrain | None
) -> list[np.ndarray]:
    """Return the rates at the even points of each line, (n,) float64, of a step too short for any smoothing."""
    scalar, device, start = PRECISIONS[network.dtype][0], network.device, network.starts()
    kernel, count = kernels.build(scalar), network.channel_count
    channels, points = _as_kernels_take_it(network, lines)
    constants, whole = migration_constants(params, network.dtype), whole_share(network.point_count, device)
    if network.channel_closed.any():
        launch(kernel.measure_rings, whole.point_threads, [channels, points.xy, whole.work], [channels.area], device)
    velocity = wp.zeros(network.point_count, dtype=kernel.vec2, device=device)
    rate = wp.zeros(network.point_count, dtype=scalar, device=device)
    stems = StemArrays(count, device, through_only=params.upstream_memory != "stem")
    # The stencil at a junction reaches two segments far into the next link.
    stems.take(network, find_map_edges(terrain), alone=np.diff(start) < 3)
    stems.give(channels)
    handed_on = kernel.Memory()
    if stems.joined:
        memory = StemMemory(count, scalar, device)
        handed_on = memory.struct()
        memory.measure(channels, stems.length)
    inputs = [channels, points, constants, whole.work]
    launch(kernel.compute_velocity, whole.point_threads, inputs, [velocity, handed_on], device)
    if stems.joined:
        memory.chain(channels, constants, whole.work)
        memory.add(channels, points, constants, whole.of_channels(count), velocity)
    launch(kernel.resolve_rate, whole.point_threads, [channels, points.xy, whole.work, velocity], [rate], device)
    return np.split(rate.numpy().astype(np.float64), start[1:-1])


def _as_kernels_take_it(network: RiverNetwork, lines: list[_Line]) -> tuple[Any, Any]:
    """Return channels and points with even points on each line; a channel of two points is straight, and inactive."""
    scalar, vec2, real = PRECISIONS[network.dtype]
    kernel, device, start = kernels.build(scalar), network.device, network.starts()

    def on_device(values: np.ndarray, kind: type, dtype: type = real) -> DeviceArray:
        return wp.array(values.astype(dtype), dtype=kind, device=device)

    points, widest = kernel.Points(), network.channel_width
    points.xy = on_device(np.concatenate([line.xy for line in lines]) - network.origin, vec2)
    if network.point_section is not None:
        of_points = [network.point_widths(), network.point_depths()]
        even = [np.concatenate([line.at_even(v) for line, v in zip(lines, part, strict=True)]) for part in of_points]
        widest = np.maximum.reduceat(even[0], start[:-1])
        points.section = on_device(np.column_stack(even), vec2)
    form = np.zeros(len(lines), kernel.Form.numpy_dtype())
    form["width"], form["depth"], form["widest"] = network.channel_width, network.channel_depth, widest
    channels = kernel.Channels()
    channels.start, channels.form = on_device(start, wp.int32, np.int32), wp.array(form, kernel.Form, device=device)
    channels.spacing = on_device(np.array([line.spacing for line in lines]), scalar)
    channels.step = on_device(np.where(np.diff(start) > 2, np.finfo(network.dtype).tiny, 0.0), scalar)
    if network.channel_closed.any():
        channels.closed = on_device(network.channel_closed, wp.int32, np.int32)
        channels.area = wp.zeros(len(lines), dtype=wp.int64, device=device)
    return channels, points


def _slope_weight(terrain: Terrain, xy: np.ndarray, threshold: float) -> np.ndarray:
    """Return the factor of points by the slope of the ground, (P,); see the kernels."""
    slope = np.hypot(*terrain.gradient(xy).T)
    t = np.where(slope < threshold, slope, threshold) / threshold
    return 1.0 - t * t * (3.0 - 2.0 * t)
