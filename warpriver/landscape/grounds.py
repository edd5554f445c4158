"""The ground of a landscape: that of a run, or a plain under rivers that have none."""

from __future__ import annotations

import math

import numpy as np

from warpriver.errors import InputError
from warpriver.history.history import History
from warpriver.network import RiverNetwork
from warpriver.public import public
from warpriver.resume import ground_again
from warpriver.terrain import Terrain
from warpriver.validate import not_negative, positive

__all__ = ["ground_of_run", "plain_under"]

# Cells across the narrowest channel, and cells at most, of a plain for which no cell size is given.
CELLS_ACROSS, MAX_CELLS = 6.0, 4_000_000


@public
def plain_under(
    network: RiverNetwork,
    cell_size: float | None = None,
    *,
    slope: float = 3e-4,
    margin: float | None = None,
    history: History | None = None,
) -> Terrain:
    """Return a plain under rivers that falls from the middle of their sources towards the middle of their outlets.

    Args:
        network: The rivers.
        cell_size: m; by default a sixth of the narrowest channel's width, or as much as makes four million cells.
        slope: Its fall, m/m.
        margin: Distance from the rivers to its edges, m; by default eight widths of the widest channel.
        history: Their run, whose oxbow lakes are to lie on the plain as well.
    """
    slope = not_negative(slope, "slope", "m/m")
    widths = network.channel_width
    rim = 8.0 * float(widths.max()) if margin is None else not_negative(margin, "margin", "m")
    west, south, east, north = network.bounds()
    for cutoff in () if history is None else history.cutoffs:
        (left, low), (right, high) = cutoff.xy.min(axis=0), cutoff.xy.max(axis=0)
        west, south, east, north = min(west, left), min(south, low), max(east, right), max(north, high)
    west, south, east, north = west - rim, south - rim, east + rim, north + rim
    size = max(float(widths.min()) / CELLS_ACROSS, math.sqrt((east - west) * (north - south) / MAX_CELLS))
    if cell_size is not None:
        size = positive(cell_size, "cell_size", "m")
    shape = max(2, math.ceil((north - south) / size)), max(2, math.ceil((east - west) / size))
    lines = ~network.channel_closed
    above, below = network.channel_from[lines], network.channel_to[lines]
    sources, outlets = np.setdiff1d(above, below), np.setdiff1d(below, above)
    fall = np.array([1.0, 0.0])
    if len(sources) and len(outlets):
        along = network.node_xy[outlets].mean(axis=0) - network.node_xy[sources].mean(axis=0)
        fall = along / np.hypot(*along) if np.hypot(*along) > 0.0 else fall
    x = (np.arange(shape[1]) + 0.5) * size
    y = -(np.arange(shape[0]) + 0.5) * size
    height = -slope * (fall[0] * x[None, :] + fall[1] * y[:, None])
    return Terrain(height - height.min(), size, (west, north), network.crs, device=network.device)


@public
def ground_of_run(history: History, terrain: Terrain | None = None) -> Terrain | None:
    """Return the ground that a run ended on: read again from its file, with the edits of the run; None for a plain.

    Args:
        history: The run.
        terrain: The terrain that the run began or ended on, where its file is not to be found; on a plain any.

    Raises:
        ValueError: The terrain cannot be found, or the one given is another one.
    """
    if history.ground is None and history.last_ground is None:
        return terrain
    try:
        return ground_again(history.ground, history.events, terrain, False)
    except InputError as error:
        # That it may go on over another one is no advice here.
        raise InputError(str(error).split(", or pass change_terrain=")[0]) from None
