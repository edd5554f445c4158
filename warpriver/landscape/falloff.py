"""Falloffs: how much of a channel's moisture and of its deposits there is at a distance from its centreline."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from warpriver.errors import InputError
from warpriver.kernels.covers import BANK, FELT, SEDIMENT_REACH
from warpriver.public import public
from warpriver.validate import floats

__all__ = ["Falloff", "falloff_table", "levee_falloff", "moisture_falloff", "sediment_falloff", "smoothstep"]

Falloff = Callable[[np.ndarray], np.ndarray]

# Distance over which levees fall by a factor e, widths.
LEVEE_WIDTHS = 1.0
# Pieces that a falloff is tabulated in, of which 1/2 and 4 widths are ends; Gauss points in each.
PIECES, GAUSS = 3072, 5


def smoothstep(x: npt.ArrayLike) -> np.ndarray:
    """Return 3 x^2 - 2 x^3, 0 below 0 and 1 above 1."""
    t = np.clip(np.asarray(x, np.float64), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@public
def moisture_falloff(widths: npt.ArrayLike) -> np.ndarray:
    """Moisture at a distance from the centreline: (1 - (d / 6 w)^2)^3, 0 beyond 6 widths.

    The paper shows the curve in a figure without numbers [Paris2023, Fig. 26]; this one is ours.

    Args:
        widths: Distances in widths of the channel.
    """
    ratio = np.minimum(np.abs(floats(widths, "widths")) / FELT, 1.0)
    return np.asarray((1.0 - ratio**2) ** 3)


@public
def sediment_falloff(widths: npt.ArrayLike) -> np.ndarray:
    """Deposits at a distance from the centreline: 0 there, 1 at the banks, 0 from 4 widths on, smooth in between.

    The paper shows the curve in a figure without numbers [Paris2023, Fig. 26]; this one is ours.

    Args:
        widths: Distances in widths of the channel.
    """
    away = np.abs(floats(widths, "widths"))
    return np.where(away < BANK, smoothstep(away / BANK), smoothstep((SEDIMENT_REACH - away) / (SEDIMENT_REACH - BANK)))


@public
def levee_falloff(widths: npt.ArrayLike) -> np.ndarray:
    """Deposits of natural levees at a distance from the centreline: 1 at the banks, falling away from them.

    What floods lay down beside a channel falls with distance exponentially [Pizzuto1987], here by a factor e in each
    width; from 4 widths on it fades, to 0 at 6. In the channel it is that of :func:`sediment_falloff`, which it can
    take the place of.

    Args:
        widths: Distances in widths of the channel.
    """
    away = np.abs(floats(widths, "widths"))
    beside = np.exp(-(away - BANK) / LEVEE_WIDTHS) * smoothstep((FELT - away) / (FELT - SEDIMENT_REACH))
    return np.where(away < BANK, smoothstep(away / BANK), beside)


def falloff_table(falloff: Falloff, name: str) -> np.ndarray:
    """Return a falloff's integral from 0 on and its values, at even nodes from 0 to 6 widths, (n, 2).

    Raises:
        ValueError: It gives something else than finite numbers from 0 on, or has not faded at 6 widths.
    """
    node = np.linspace(0.0, FELT, PIECES + 1)
    at, weight = np.polynomial.legendre.leggauss(GAUSS)
    inner = node[:-1, None] + 0.5 * np.diff(node)[:, None] * (1.0 + at)
    try:
        values = np.asarray(falloff(node), np.float64)
        within = np.asarray(falloff(inner.ravel()), np.float64).reshape(inner.shape)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} takes no array of distances in widths: {error}") from error
    if values.shape != node.shape or not (
        np.isfinite(values).all() and np.isfinite(within).all() and (values >= 0).all()
    ):
        raise InputError(f"{name} must give a finite number from 0 on for each distance in widths")
    if values[-1] > 1e-9:
        raise InputError(f"{name} is {values[-1]:g} at {FELT:g} widths; it must fade to 0 by there")
    pieces = 0.5 * np.diff(node) * (within * weight).sum(axis=1)
    return np.stack([np.concatenate([[0.0], np.cumsum(pieces)]), values], axis=1)
