"""Checks of what each phase of a step promises; slow, on the host, for ``Simulation(check=True)``."""

from __future__ import annotations

import numpy as np

from warpriver.kernels.polyline import FAULT, FAULT_NONE
from warpriver.meander.buffers import StepBuffers, StepChannels
from warpriver.network import RiverNetwork

__all__ = ["PhaseError", "check_phase"]

# Points are even by the chords of the old ones. Where a cutoff joined two points far apart, the cubic between them has
# the speed |3/2 c - (Tb + Tc)/4| in its middle, at most 3/2 + 5/6 with tangents of up to 5/3; the next step evens it.
LONGEST_CHORD = 2.34


class PhaseError(AssertionError):
    """A phase of a step broke its promise; the text says which, where and by how much."""


def check_phase(
    phase: str, network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, anchored: bool = True
) -> None:
    """Check the state after one phase.

    Args:
        phase: "migrate", "smooth", "cut off" or "resample".
        network: The network.
        channels: Its channels.
        buffers: The step's scratch.
        anchored: Whether the ends of channels stay; else they may have wandered once the points have migrated.

    Raises:
        PhaseError: A promise is broken.
    """
    if buffers.read_status()[FAULT] != FAULT_NONE:
        return  # the step will not be taken over
    if phase == "resample":
        if int(channels.start_next[-1:].numpy()[0]) <= buffers.point_capacity:
            _check_resampled(network, channels.spacing.numpy()[: network.channel_count].astype(np.float64))
    elif phase in ("migrate", "smooth", "cut off"):
        _check_moved(phase, network, channels, buffers, anchored or phase in ("migrate", "smooth"))


def _check_moved(
    phase: str, network: RiverNetwork, channels: StepChannels, buffers: StepBuffers, anchored: bool
) -> None:
    """The points are finite, the ends have not moved, and cutoffs are in order and lie within their channels."""
    start = network.starts()
    moved = buffers.point_moved.numpy()[: start[-1]]
    before = network.point_xy.numpy()[: start[-1]]
    _require(np.isfinite(moved).all(axis=1), phase, "is not finite", "point")
    for ends in (start[:-1], start[1:] - 1) if anchored else ():
        kept = (moved[ends] == before[ends]).all(axis=1) | network.channel_closed
        _require(kept, phase, "lost its anchored end", "channel")
    if phase == "cut off":
        count, total = buffers.share_cut_sum[-1:].numpy()[0].tolist()
        cut = buffers.cut[:count].numpy()
        _require(np.diff(cut[:, 0]) >= 0, phase, "is out of order", "cutoff")
        _require(cut[:, 2] >= 3, phase, "has no loop", "cutoff")
        following = np.concatenate([cut[1:, 1], [total]])[: len(cut)]
        _require(following == cut[:, 1] + cut[:, 2], phase, "has a gap", "cutoff")


def _check_resampled(network: RiverNetwork, spacing: np.ndarray) -> None:
    """Starts ascend, points are finite, and no two neighbours are farther apart than the spacing allows."""
    start = network.starts()
    _require(np.diff(start) >= 3, "resample", "has fewer than 3 points", "channel")
    xy = network.point_xy.numpy()[: start[-1]].astype(np.float64)
    _require(np.isfinite(xy).all(axis=1), "resample", "is not finite", "point")
    gap = np.hypot(*(xy[start[:-1]] - xy[start[1:] - 1]).T)
    _require(~network.channel_closed | (gap <= LONGEST_CHORD * spacing), "resample", "does not close", "ring")
    chord = np.hypot(*np.diff(xy, axis=0).T)
    owner = np.repeat(np.arange(len(spacing)), np.diff(start))[:-1]
    chord[start[1:-1] - 1] = 0.0
    _require(chord <= LONGEST_CHORD * spacing[owner], "resample", "is too far from the next", "point")


def _require(good: np.ndarray, phase: str, problem: str, kind: str) -> None:
    if not good.all():
        index = int(np.argmin(good))
        raise PhaseError(f"after {phase!r}: {kind} {index} {problem} ({int((~good).sum())} in all)")
