"""Banks: the random strength of the ground that rivers cut into."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpriver.arrays import DeviceArray
from warpriver.device import PRECISIONS
from warpriver.kernels import banks as kernels
from warpriver.params import MeanderParams

__all__ = ["BankField", "bank_table", "highest_factor"]


@functools.lru_cache(maxsize=4)
def bank_table(seed: int) -> NDArray[np.float32]:
    """Return a normal random field of mean 0 and variance 1 on cells of a quarter of its correlation length.

    Its correlation is e^(-(r / L)^2) at a distance r, and its table comes again at all sides.

    Args:
        seed: Seed.

    Returns:
        (512, 512) float32.
    """
    size = kernels.SIZE
    white = np.fft.rfft2(np.random.default_rng([seed & 0xFFFFFFFFFFFFFFFF, 0xBA9C]).standard_normal((size, size)))
    # White noise averaged by a Gaussian of deviation L / 2 has that correlation.
    deviation = 0.5 * kernels.CELLS
    f, g = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None]
    field = np.fft.irfft2(white * np.exp(-2.0 * (math.pi * deviation) ** 2 * (f**2 + g**2)), s=(size, size))
    field = (field - field.mean()) / field.std()
    table: NDArray[np.float32] = field.astype(np.float32)
    return table


def highest_factor(params: Any) -> float:
    """Return the greatest factor by which banks, and what a floodplain remembers, may multiply a rate; 1 if none do."""
    spread, remembered = getattr(params, "bank_spread", 0.0), getattr(params, "floodplain", None)
    factor = max(1.0, math.exp(spread * (kernels.REACH - 0.5 * spread))) if spread else 1.0
    if remembered is None:
        return factor
    return factor * max(1.0, float(remembered.bar_factor)) * (1.0 + float(remembered.unrest))


class BankField:
    """The field of a simulation on its device."""

    def __init__(self, seed: int, device: Any):
        """Make the table of a seed."""
        self._table: DeviceArray = wp.array(bank_table(seed), dtype=wp.float32, device=device)

    def struct(self, params: MeanderParams, dtype: str, origin: np.ndarray) -> Any:
        """Return the field as kernels take it, for positions about an origin."""
        banks = kernels.build(PRECISIONS[dtype][0]).Banks()
        banks.cell_noise = self._table
        banks.origin = wp.vec2d(*(float(v) for v in origin))
        banks.correlation, banks.spread = params.bank_correlation, params.bank_spread
        return banks
