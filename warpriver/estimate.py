"""What a run will take: points, time and disk space, estimated from a few steps of a copy before it begins."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from warpriver.history import Every
from warpriver.simulation import Simulation

__all__ = ["RunEstimate", "estimate_run"]

# Sinuosity of a channel whose bends are grown: cutoffs keep it about there.
GROWN_SINUOSITY = 3.0
# Bends are grown when points can have moved by so many widths.
GROWN_WIDTHS = 10.0
# Steps that are timed, after one that records the step.
TIMED_STEPS = 2


@dataclasses.dataclass(frozen=True)
class RunEstimate:
    """What a run will take: as the network is now, and as it will be when its bends are grown.

    Attributes:
        steps: Steps to do.
        records: Records that they leave.
        points: Points now, and when the bends are grown.
        seconds: Time in s for all steps, with so many points.
        bytes: Size of the records, with so many points.
    """

    steps: int
    records: int
    points: tuple[int, int]
    seconds: tuple[float, float]
    bytes: tuple[int, int]


def estimate_run(simulation: Simulation, steps: int, record_every: int | Every = 10) -> RunEstimate:
    """Estimate what so many steps will take; a few steps are done on a copy of the network.

    A channel whose bends have time to grow gets as many points as a sinuosity of 3 makes of it. Channels that join or
    leave the map are not foreseen.

    Args:
        simulation: The simulation, which is left as it is.
        steps: Steps to do.
        record_every: Steps between records, or a schedule.
    """
    years = steps * simulation.params.time_step
    schedule = record_every if isinstance(record_every, Every) else Every(steps=record_every)
    gap = schedule.steps or max(1.0, (schedule.years or years) / simulation.params.time_step)
    records = int(steps / gap) + 1
    now, grown = simulation.network.point_count, _grown_points(simulation, years)
    second, per_point = _seconds_of_a_step(simulation), simulation.history.record(-1).nbytes / now
    return RunEstimate(
        steps,
        records,
        (now, grown),
        (steps * second, steps * second * grown / now),
        (int(records * per_point * now), int(records * per_point * grown)),
    )


def _grown_points(simulation: Simulation, years: float) -> int:
    """Points of the network after so many years."""
    network, state = simulation.network, simulation.stepper.state
    count, lengths = network.channel_count, network.channel_lengths()
    ends = network.node_xy[network.channel_from], network.node_xy[network.channel_to]
    chord = np.where(network.channel_closed, lengths, np.hypot(*(ends[1] - ends[0]).T))
    sinuosity = lengths / np.maximum(chord, 1e-9 * lengths)
    moved = state.max_speed.numpy()[:count].astype(np.float64) * years / (GROWN_WIDTHS * network.channel_width)
    gain = np.maximum(GROWN_SINUOSITY / sinuosity, 1.0) - 1.0
    return int((np.diff(network.starts()) * (1.0 + gain * np.minimum(moved, 1.0))).sum())


def _seconds_of_a_step(simulation: Simulation) -> float:
    """Time of a step of a copy, s."""
    copy = Simulation(
        simulation.network,
        simulation.params,
        terrain=simulation.terrain,
        check=simulation.check,
        threads=simulation.threads,
        controls=simulation.controls,
    )
    copy.step()
    begin = time.perf_counter()
    copy.step(TIMED_STEPS)
    return (time.perf_counter() - begin) / TIMED_STEPS
