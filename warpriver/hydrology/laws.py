"""The laws of a river network in one call: what a terrain's flow obeys, cell by cell, without lines in between."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from warpriver.hydrology.orders import exceedance, hack_exponent, horton_ratios
from warpriver.hydrology.routing import Flow, drainage_area, flow_length

__all__ = ["NetworkLaws", "network_laws"]

# P(A > a) is fitted up to this part of the largest area: above, the map cuts basins off.
EXCEEDANCE_HIGH = 0.05
# Cells that drain less than this many have lengths of 0 or one step.
HACK_CELLS = 3


class NetworkLaws(NamedTuple):
    """Laws of the network of all cells that drain enough ground.

    Attributes:
        streams: (K,) number of streams of the Strahler orders 1 to K.
        bifurcation_ratio: Streams of an order over those of the next one, without the highest order.
        area_ratio: Mean area of streams over that of the order before, without the highest order.
        length_ratio: Mean length of streams over that of the order before, without the highest order.
        hack_exponent: h of L ~ A^h over all cells that drain three cells or more, with L the longest course to the
            cell. Small basins are many, and make it larger than it is in the limit.
        area_exponent: beta of P(A > a) ~ a^-beta over all cells, from the least area of the network to 5 % of the
            largest basin.
    """

    streams: NDArray[np.int64]
    bifurcation_ratio: float
    area_ratio: float
    length_ratio: float
    hack_exponent: float
    area_exponent: float


def network_laws(flow: Flow, min_drainage_area: float) -> NetworkLaws:
    """Measure Horton's and Hack's laws and the distribution of areas on a terrain's flow.

    Every cell of the network counts as a channel of one step. Ratios are those of the fitted lines, log N over order,
    through all orders but the highest one, whose few streams the map cuts off; NaN for less than three orders.

    Args:
        flow: From :func:`warpriver.hydrology.route`; periodic sides are joined.
        min_drainage_area: Least drainage area of a cell of the network, m2.

    Raises:
        ValueError: A threshold that is not positive, or that leaves less than two cells.
    """
    if not (math.isfinite(min_drainage_area) and min_drainage_area > 0.0):
        raise ValueError(f"min_drainage_area is {min_drainage_area}; give a positive number of m2")
    size = flow.terrain.cell_size
    area = drainage_area(flow).reshape(-1)
    receiver = flow.receiver.reshape(-1).astype(np.int64)
    cell = np.flatnonzero(area >= min_drainage_area * (1.0 - 1e-9))
    if len(cell) < 2:
        raise ValueError(
            f"{len(cell)} cells drain {min_drainage_area:g} m2 or more; the largest area is {np.nanmax(area):g}"
        )
    to = receiver[cell]
    leaves = to == cell
    # Below each mouth a node of its own.
    node = np.where(leaves, cell + area.size, to)
    ratios = horton_ratios(cell, node, size * _steps(cell, to, flow.receiver.shape), area[cell])
    inner = np.flatnonzero(area >= HACK_CELLS * size**2)
    hack = hack_exponent(flow_length(flow, downstream=False).reshape(-1)[inner], area[inner]).exponent
    low, high = float(min_drainage_area), EXCEEDANCE_HIGH * float(np.nanmax(area))
    beta = exceedance(area, low=low, high=high).exponent if high > low else math.nan
    fall, *growth = (_ratio(np.asarray(v, np.float64)) for v in (ratios.streams, ratios.area, ratios.length))
    return NetworkLaws(ratios.streams, 1.0 / fall, growth[0], growth[1], hack, beta)


def _ratio(values: NDArray[np.float64]) -> float:
    """Factor from order to order of a line fitted to the logarithms, without the highest order."""
    if len(values) < 3:
        return math.nan
    return math.exp(np.polyfit(np.arange(len(values) - 1), np.log(values[:-1]), 1)[0])


def _steps(cell: NDArray[np.int64], to: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Cells from each cell to the one that it drains to, also around a periodic side; 1 where water leaves."""
    rows, columns = shape
    down, across = np.abs(to // columns - cell // columns), np.abs(to % columns - cell % columns)
    step = np.hypot(np.minimum(down, rows - down), np.minimum(across, columns - across))
    return np.where(to == cell, 1.0, step)
