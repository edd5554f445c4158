"""The laws of a river network in one call: what a terrain's flow obeys, cell by cell, without lines in between."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from warpriver.arrays import FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.hydrology.orders import exceedance, hack_exponent, strahler_order
from warpriver.hydrology.routing import Flow, host_areas, host_lengths
from warpriver.public import public
from warpriver.validate import positive

__all__ = ["NetworkLaws", "network_laws"]

# P(A > a) is fitted up to this fraction of the largest area: above, the map cuts basins off.
EXCEEDANCE_HIGH = 0.05
# Cells that drain less than this many have lengths of 0 or one step.
HACK_CELLS = 3


class NetworkLaws(NamedTuple):
    """Laws of the network of all cells that drain enough ground.

    Attributes:
        streams: (K,) number of streams of the Strahler orders 1 to K.
        bifurcation_ratio: Streams of an order over those of the next one, without the highest order.
        area_ratio: Mean area at the lower end of streams over that of the order before, without the highest order.
        length_ratio: Mean length of the longest course to the lower end of streams, from the divide on, over that of
            the order before, without the highest order. It is the L of Hack's law: log R_L / log R_A is an exponent
            like Hack's. What a stream gains in its own order alone is measured by :func:`horton_ratios`.
        hack_exponent: h of L ~ A^h over all cells that drain three cells or more, with L the longest course to the
            cell. Small basins are many, and make it larger than it is in the limit.
        area_exponent: beta of P(A > a) ~ a^-beta over all cells, from the minimum area of the network to 5 % of the
            largest basin.
    """

    streams: IndexArray
    bifurcation_ratio: float
    area_ratio: float
    length_ratio: float
    hack_exponent: float
    area_exponent: float


@public
def network_laws(flow: Flow, min_drainage_area: float) -> NetworkLaws:
    """Measure Horton's and Hack's laws and the distribution of areas on a terrain's flow.

    A stream is a run of cells of one Strahler order; all count, also those that leave through an edge. Its area and
    length are taken at its last cell, above the junction. Ratios are those of lines fitted by least squares to the
    logarithm over the order, through all orders but the highest one, whose few streams the map cuts off; NaN for fewer
    than three orders.

    Args:
        flow: From :func:`warpriver.hydrology.route`; periodic sides are joined.
        min_drainage_area: Minimum drainage area of a cell of the network, m2.

    Raises:
        ValueError: A threshold that is not positive, or that leaves fewer than two cells.
    """
    positive(min_drainage_area, "min_drainage_area", "m2")
    size = flow.terrain.cell_size
    area = host_areas(flow).reshape(-1)
    receiver = flow.host_receiver.reshape(-1).astype(np.int64)
    cell = np.flatnonzero(area >= min_drainage_area * (1.0 - 1e-9))
    if len(cell) < 2:
        raise InputError(
            f"{len(cell)} cells drain {min_drainage_area:g} m2 or more; the largest area is {np.nanmax(area):g}"
        )
    length = host_lengths(flow, downstream=False).reshape(-1)
    streams, mean_area, mean_length = _streams(cell, receiver[cell], area, length)
    inner = np.flatnonzero(area >= HACK_CELLS * size**2)
    hack = hack_exponent(length[inner], area[inner]).exponent
    low, high = float(min_drainage_area), EXCEEDANCE_HIGH * float(np.nanmax(area))
    beta = exceedance(area, low=low, high=high).exponent if high > low else math.nan
    fall, *growth = (_ratio(v) for v in (streams.astype(np.float64), mean_area, mean_length))
    return NetworkLaws(streams, 1.0 / fall, growth[0], growth[1], hack, beta)


def _streams(
    cell: IndexArray, to: IndexArray, area: FloatArray, length: FloatArray
) -> tuple[IndexArray, FloatArray, FloatArray]:
    """Number of streams of each order, their mean area, and the mean length to their lower ends."""
    leaves = to == cell
    # Downstream of each mouth a node of its own.
    order = strahler_order(cell, np.where(leaves, cell + area.size, to))
    cell_order = np.zeros(area.size, np.int64)
    cell_order[cell] = order
    lowest = leaves | (cell_order[to] != order)
    end, number = cell[lowest], order[lowest] - 1
    streams = np.bincount(number)
    means = [np.bincount(number, weights=values[end]) / streams for values in (area, length)]
    return streams, means[0], means[1]


def _ratio(values: FloatArray) -> float:
    """Factor from order to order of a line fitted to the logarithms, without the highest; NaN where there is none."""
    if len(values) < 3 or values[0] == 0.0:
        return math.nan
    return math.exp(np.polyfit(np.arange(len(values) - 1), np.log(values[:-1]), 1)[0])
