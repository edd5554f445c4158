"""Names for the types of arrays: on the host by what they hold, and on a device."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import warp as wp

__all__ = ["ByteArray", "CellArray", "ComplexArray", "DeviceArray", "FlagArray", "FloatArray", "IndexArray"]

FloatArray: TypeAlias = NDArray[np.float64]
ComplexArray: TypeAlias = NDArray[np.complex128]
IndexArray: TypeAlias = NDArray[np.int64]
FlagArray: TypeAlias = NDArray[np.bool_]
ByteArray: TypeAlias = NDArray[np.uint8]
# Cells of a grid are counted in 32 bits, as in the kernels.
CellArray: TypeAlias = NDArray[np.int32]
# What it holds and its dimensions are chosen at run time, from the precision of a run among other things.
DeviceArray: TypeAlias = "wp.array[Any, Any]"
