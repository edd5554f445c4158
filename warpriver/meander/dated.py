"""The strength of banks, mapped from two dated surveys of a river: where it moved faster than the law has it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from warpriver.errors import InputError
from warpriver.extras import IMPORTING
from warpriver.meander.controls import ErodibilityField
from warpriver.meander.rates import migration_rate
from warpriver.metrics.changes import migration
from warpriver.metrics.lines import arc_length_of
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams
from warpriver.public import public
from warpriver.raster import Raster
from warpriver.validate import positive

with IMPORTING:
    from scipy.ndimage import gaussian_filter1d
    from scipy.spatial import cKDTree

__all__ = ["mapped_banks"]

FloatArray = NDArray[np.float64]

# Displacements of more widths than this between the surveys are cutoffs, or other bends.
FARTHEST = 1.0
# Part of an average stretch for which the mean of the whole river counts.
PRIOR = 0.1
# Range of the factors.
LEAST, MOST = 0.1, 5.0
# Widths beside the channel over which a factor fades to 1, and cells of the map to a width; most cells a side.
BESIDE, CELLS, MOST_CELLS = 6.0, 2.0, 4000


@public
def mapped_banks(
    before: RiverNetwork, after: RiverNetwork, params: MeanderParams | None = None, *, smoothing: float = 3.0
) -> ErodibilityField:
    """Map how easily banks are eroded from the same channels at two dates.

    At each point the factor is the ratio of observed and predicted migration by least squares over some widths along
    the channel, sum(m p) / sum(p^2), drawn to that of the whole river where hardly anything was predicted, and divided
    by it: the mean rate is left to ``params.migration_rate``. Where the channel was cut off nothing is known, and the
    factor is 1, as it is six widths away from the channel. On dated rivers such a map of one period predicts some of
    the next.

    Example::

        banks = wr.meander.mapped_banks(survey_1987, survey_2002)
        sim = wr.Simulation(survey_2002, controls=[banks])

    Args:
        before: The channels at the first date.
        after: The same channels at the second one, alike in number and order.
        params: Constants of the law; by default its defaults.
        smoothing: Standard deviation of the weights along the channel, in widths.

    Returns:
        A control for a simulation, of factors from 0.1 to 5.

    Raises:
        ValueError: The networks have different numbers of channels, or no point of one is found in the other.
    """
    if after.channel_count != before.channel_count:
        raise InputError(
            f"after has {after.channel_count} channels where before has {before.channel_count}; give the same channels "
            "at both dates"
        )
    scale = positive(smoothing, "smoothing")
    rates = migration_rate(before, (params or MeanderParams()).replace(end_damping=0.0))
    places, factors = [], []
    lines, widths = zip(before.polylines(), after.polylines(), strict=True), before.point_widths()
    for (old, new), rate, width in zip(lines, rates, widths, strict=True):
        w = float(np.median(width))
        found = _factors(old, new, rate, w, scale * w)
        if found is not None:
            places.append(old)
            factors.append(found)
    if not places:
        raise InputError("no point of the channels before was found after; are these the same channels, in one CRS?")
    middle = float(np.median(before.channel_width))
    return ErodibilityField(_as_map(np.concatenate(places), np.concatenate(factors), middle, before.crs))


def _factors(old: FloatArray, new: FloatArray, rate: FloatArray, width: float, scale: float) -> FloatArray | None:
    """Factor of each point of a channel, (n,); None where no point was found again, or nothing was predicted."""
    seen = migration(old, new, max_distance=FARTHEST * width)
    known = np.isfinite(seen)
    # Migration is measured to the left, and the rate of the law to the right.
    expected, observed = -np.where(known, rate, 0.0), np.where(known, seen, 0.0)
    squares = float((expected**2).sum())
    ratio = float((expected * observed).sum()) / squares if squares > 0.0 else 0.0
    if not ratio > 0.0:
        return None
    gap = float(arc_length_of(old)[-1]) / (len(old) - 1)

    def smoothed(values: FloatArray) -> FloatArray:
        found: FloatArray = gaussian_filter1d(values, scale / gap, mode="nearest")
        return found

    prior = squares / max(1, int(known.sum()))
    local = (smoothed(expected * observed) + PRIOR * prior * ratio) / (smoothed(expected**2) + PRIOR * prior)
    factor: FloatArray = np.clip(local / ratio, LEAST, MOST)
    return np.where(smoothed(known.astype(np.float64)) > 0.5, factor, 1.0)


def _as_map(xy: FloatArray, factor: FloatArray, width: float, crs: str | None) -> Raster:
    """Factors of points on cells: that of the nearest point, fading to 1 in its logarithm beside the channel."""
    reach = BESIDE * width
    (west, south), (east, north) = xy.min(axis=0) - reach, xy.max(axis=0) + reach
    cell = max(width / CELLS, max(east - west, north - south) / MOST_CELLS)
    rows, columns = int(np.ceil((north - south) / cell)), int(np.ceil((east - west) / cell))
    y = north - (np.arange(rows) + 0.5) * cell
    x = west + (np.arange(columns) + 0.5) * cell
    centers = np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1).reshape(-1, 2)
    away, nearest = cKDTree(xy).query(centers, distance_upper_bound=reach)
    near = np.isfinite(away)
    t = np.clip(1.0 - away[near] / reach, 0.0, 1.0)
    values = np.ones(len(centers))
    values[near] = factor[nearest[near]] ** (t * t * (3.0 - 2.0 * t))
    return Raster(values.reshape(rows, columns), cell, (float(west), float(north)), crs=crs, name="erodibility")
