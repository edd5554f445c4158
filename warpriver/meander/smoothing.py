"""Smoothing of channels by pairs of passes that shrink and swell: short waves go, length and area stay [Taubin1995]."""

from __future__ import annotations

from typing import Any, overload

import numpy as np
import numpy.typing as npt
import warp as wp

from warpriver.arrays import DeviceArray
from warpriver.device import PRECISIONS
from warpriver.engine.phase import Phase
from warpriver.engine.stages import Share, Stage, launch, whole_share
from warpriver.engine.state import State
from warpriver.errors import InputError
from warpriver.kernels import junctions
from warpriver.kernels import smoothing as kernels
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.validate import floats, whole

__all__ = ["Smooth", "taubin_smooth"]

# lambda of [Taubin1995]: with it the shortest wave of the points goes in one pair of passes.
STRENGTH = 0.5
# Stands for the longest wave of each channel, see the kernel.
LONGEST_WAVE = -1.0


class Smooth(Phase):
    """Smooths ``state.point_moved`` by ``params.taubin_passes`` pairs of passes; inactive channels stay as they are.

    The links of a stem are smoothed as one line. What else ends at their nodes follows in the phase of the junctions.

    Attributes:
        point_smoothed: (P,) vec2, what a pass gives; None without passes. ``shift``: (C,) vec2, scratch.
    """

    name = "smooth"
    point_smoothed: DeviceArray | None
    shift: DeviceArray

    def allocate(self, state: State) -> None:
        """Make the device array."""
        passes = int(state.params.taubin_passes)
        self.point_smoothed = state.zeros(state.point_capacity, state.vec2) if passes > 0 else None
        self.shift = state.zeros(state.channel_capacity, state.vec2)

    def stages(self, state: State) -> list[Stage]:
        """Return the stage of all passes; none without passes."""
        if self.point_smoothed is None:
            return []
        there, back, passes = state.point_moved, self.point_smoothed, int(state.params.taubin_passes)
        kernel, channels = kernels.build(state.scalar), state.channels()

        def settle(whole: Share) -> None:
            settle_heads, inputs = junctions.build(state.scalar).settle_heads, [state.network.point_xy, whole.work]
            launch(settle_heads, state.channel_capacity, [channels, *inputs], [self.shift, there], state.device)

        def run(share: Share) -> None:
            for _ in range(passes):
                for swell, before, after in ((0, there, back), (1, back, there)):
                    inputs = [channels, STRENGTH, LONGEST_WAVE, swell, share.work, before]
                    launch(kernel.smooth_points, share.point_threads, inputs, [after], state.device)

        if state.stems is None or not state.stems.joined:
            return [Stage("smooth", run)]
        # Links read of each other, in every pass.
        return [Stage("smooth", settle, shared=False), Stage("smooth", run, shared=False)]

    def check(self, state: State) -> None:
        """Points are finite, and the ends of channels have not moved."""
        state.check_moved(self.name, anchored=not state.nodes_move)


@overload
def taubin_smooth(
    channels: RiverNetwork,
    passes: int = 10,
    *,
    strength: float = STRENGTH,
    pass_band: float | None = None,
    closed: bool = False,
) -> RiverNetwork: ...


@overload
def taubin_smooth(
    channels: npt.ArrayLike,
    passes: int = 10,
    *,
    strength: float = STRENGTH,
    pass_band: float | None = None,
    closed: bool = False,
) -> np.ndarray: ...


@public
def taubin_smooth(
    channels: RiverNetwork | npt.ArrayLike,
    passes: int = 10,
    *,
    strength: float = STRENGTH,
    pass_band: float | None = None,
    closed: bool = False,
) -> RiverNetwork | np.ndarray:
    """Smooth channels without shrinking them; ends of lines are held, rings keep their area [Taubin1995].

    A pair of passes multiplies a wave of the line by 1 - strength |w| K (K - pass_band), K = 1 - cos a, a the angle of
    the wave from point to point, 1/w = pass_band - 1/strength: waves longer than the pass band stay or grow slightly,
    shorter ones fade. By default the band ends at the longest wave of each channel, once round a ring or twice a line's
    length, so that none grows and a circle of even points stays as it is.

    Args:
        channels: A network, or one line as an (n, 2) array in m; evenly spaced points are assumed.
        passes: Pairs of passes.
        strength: lambda, 0 < strength <= 1.
        pass_band: K at which the band ends, 0 to 1; 0.1 ends it at waves of 14 points.
        closed: Whether the line given as an array is a ring, its first point not repeated.

    Returns:
        A new network, without elevations of its points, or an (n, 2) float64 array.

    Raises:
        ValueError: A number is out of its range, or the line is none.
    """
    passes = whole(passes, "passes")
    if not 0.0 < strength <= 1.0:
        raise InputError(f"strength is {strength:g}; give a number above 0 and up to 1")
    if pass_band is not None and not 0.0 <= pass_band < 1.0:
        raise InputError(f"pass_band is {pass_band:g}; give a number from 0 to below 1")
    given = isinstance(channels, RiverNetwork)
    if isinstance(channels, RiverNetwork):
        network = channels.to()
        network.point_z = None
    else:
        line = floats(channels, "channels", "a network, or (n, 2) points")
        length = float(np.hypot(*np.diff(line, axis=0).T).sum()) if line.ndim == 2 and line.shape[1:] == (2,) else 1.0
        width = length / max(line.size, 1) if length > 0.0 else 1.0
        network = RiverNetwork.from_polylines([line], width=width, closed=closed)
    band = LONGEST_WAVE if pass_band is None else pass_band
    kernel, active = kernels.build(PRECISIONS[network.dtype][0]), _all_active(network)
    share = whole_share(network.point_count, network.device)
    there, back = network.point_xy, wp.empty_like(network.point_xy)
    for _ in range(passes):
        for swell, before, after in ((0, there, back), (1, back, there)):
            inputs = [active, strength, band, swell, share.work, before]
            launch(kernel.smooth_points, share.point_threads, inputs, [after], network.device)
    return network if given else network.polylines()[0]


def _all_active(network: RiverNetwork) -> Any:
    """Return the channels of a network as the kernel takes them, all of them active, without form and spacing."""
    scalar, device, count = PRECISIONS[network.dtype][0], network.device, network.channel_count
    kernel = kernels.build(scalar)
    channels = kernel.Channels()
    channels.start = network.channel_start
    channels.form = wp.zeros(count, dtype=kernel.Form, device=device)
    channels.spacing = wp.zeros(count, dtype=scalar, device=device)
    channels.step = wp.full(count, 1.0, dtype=scalar, device=device)
    if network.channel_closed.any():
        channels.closed = wp.array(network.channel_closed.astype(np.int32), dtype=wp.int32, device=device)
    return channels
