"""Coupling both ways: rivers make the ground on which plants grow, and plants hold the banks that rivers erode."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.history import Every, History, StopReason
from warpriver.landscape.maps import Landscape, LandscapeMaps
from warpriver.landscape.params import LandscapeParams
from warpriver.meander.controls import ErodibilityField
from warpriver.public import public
from warpriver.simulation import Simulation
from warpriver.validate import not_negative, positive

__all__ = ["erodibility", "simulate_with_plants"]


@public
def erodibility(maps: LandscapeMaps, strength: float = 0.5, reach: float = 60.0) -> ErodibilityField:
    """Return how easily banks are eroded where plants hold them: 1 - strength times their density.

    A channel erodes the banks beside it: the density is the mean of the land around a place, without the water.

    Args:
        maps: The maps.
        strength: How much slower a bank under closed vegetation is eroded, 0 to 1.
        reach: How far around a place the land counts, m, about the width of the channel.

    Raises:
        ValueError: ``strength`` is not between 0 and 1, ``reach`` not positive.
    """
    with IMPORTING:
        from scipy.ndimage import gaussian_filter

    strength = not_negative(strength, "strength")
    if strength > 1.0:
        raise InputError(f"strength is {strength:g}; give a number from 0 to 1")
    sigma = positive(reach, "reach", unit="m") / maps.vegetation.cell_size
    density, land = maps.vegetation.numpy(), (maps.plants.numpy() != 0).astype(np.float64)
    above, below = (gaussian_filter(values, sigma, mode="nearest") for values in (density * land, land))
    mean = np.where(below > 1e-6, above / np.maximum(below, 1e-6), 0.0)
    factor = np.clip(1.0 - strength * mean, 0.0, 1.0)
    return ErodibilityField(maps.vegetation.like(factor, name="erodibility"))


@public
def simulate_with_plants(
    simulation: Simulation,
    years: float,
    *,
    bounds: Sequence[float] | np.ndarray,
    every: float = 20.0,
    strength: float = 0.5,
    cell_size: float = 40.0,
    params: LandscapeParams | None = None,
    record_every: int | Every = 10,
) -> History:
    """Run a simulation in which plants grow on the ground that the river makes, and slow down its erosion.

    Every so many years the vegetation is mapped anew and its :func:`erodibility` becomes a control of the simulation,
    beside those that it has, as an edit that is recorded and replayed as any.

    Args:
        simulation: The simulation, which goes on.
        years: How long, yr.
        bounds: (west, south, east, north) of the land whose plants count, in m; elsewhere banks are bare.
        every: Time from one map of the vegetation to the next, yr.
        strength: How much slower a bank under closed vegetation is eroded, 0 to 1.
        cell_size: Side of the cells of the maps, m.
        params: Constants of the maps.
        record_every: As in :meth:`Simulation.run`.

    Returns:
        The history; it ends early where the run does.
    """
    years, every = not_negative(years, "years"), positive(every, "every", unit="yr")
    landscape = Landscape(simulation.history, None, cell_size, bounds=bounds, params=params)
    others, begin = simulation.controls, simulation.time
    reach = float(np.max(simulation.network.channel_width))
    while begin + years - simulation.time > 1e-9:
        landscape.lead_to(len(simulation.history) - 1)
        simulation.controls = (*others, erodibility(landscape.maps(), strength, reach))
        before = simulation.step_count
        simulation.run(years=min(every, begin + years - simulation.time), record_every=record_every)
        if simulation.step_count == before or simulation.history.stop_reason is not StopReason.COMPLETED:
            break
    return simulation.history
