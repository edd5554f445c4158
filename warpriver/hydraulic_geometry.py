"""Hydraulic geometry: bankfull width, depth and discharge of a channel from each other and from its drainage area.

A channel has one bankfull discharge, and it follows from its width wherever none is stated: Q = (w / 7.2)^2
[Andreadis2013]. Widths that a file lacks follow from the drainage area, w = c A^0.5 [Paris2023], so that the bankfull
discharge grows in proportion to the area and adds up at junctions.

The long-term mean discharge, which HydroRIVERS and NHDPlus state, is something else: a river carries its bankfull
discharge for a day or two a year.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from warpriver.public import public
from warpriver.validate import floats

__all__ = [
    "DEPTH_BY_WIDTH",
    "DISCHARGE_BY_AREA",
    "WIDTH_BY_FLOW",
    "WIDTH_COEFFICIENT",
    "bankfull_depth",
    "bankfull_discharge",
    "bankfull_width",
    "channel_width",
    "discharge",
    "width_of_discharge",
]

SQUARE_KILOMETER = 1e6
# w = 18.8 d^1.41 in m [Konsoer2013], and the exponent of d ~ w^0.709.
WIDTH_AT_1_M, WIDTH_BY_DEPTH = 18.8, 1.41
DEPTH_BY_WIDTH = 1.0 / WIDTH_BY_DEPTH
# w = 7.2 Q^0.5 in m and m3/s [Andreadis2013].
WIDTH_AT_1_M3_S = 7.2
# w ~ A^0.5 along a river [Paris2023], as w ~ Q^0.5; together they make Q ~ A.
WIDTH_BY_FLOW = 0.5
DISCHARGE_BY_AREA = 2.0 * WIDTH_BY_FLOW
# Q = 0.42 A^0.69 in m3/s and km2 [Peytavie2019].
DISCHARGE_AT_1_KM2, DISCHARGE_EXPONENT = 0.42, 0.69
# Area in m2 at which the width of a channel is that of the discharge by this relation.
CALIBRATION_AREA = 100.0 * SQUARE_KILOMETER


def bankfull_depth(width: npt.ArrayLike) -> Any:
    """Bankfull depth in m of a channel ``width`` m wide, from w = 18.8 d^1.41 [Konsoer2013]."""
    return (floats(width, "width") / WIDTH_AT_1_M) ** DEPTH_BY_WIDTH


def bankfull_width(depth: npt.ArrayLike) -> Any:
    """Bankfull width in m of a channel ``depth`` m deep, w = 18.8 d^1.41 [Konsoer2013]."""
    return WIDTH_AT_1_M * floats(depth, "depth") ** WIDTH_BY_DEPTH


@public
def bankfull_discharge(width: npt.ArrayLike) -> Any:
    """Bankfull discharge in m3/s of a channel ``width`` m wide, from w = 7.2 Q^0.5 [Andreadis2013].

    It is the discharge of all channels for which none is stated, those of extracted networks among them.
    """
    return (floats(width, "width") / WIDTH_AT_1_M3_S) ** 2


@public
def width_of_discharge(flow: npt.ArrayLike) -> np.ndarray:
    """Bankfull width in m of a channel with a bankfull discharge in m3/s, w = 7.2 Q^0.5 [Andreadis2013].

    Of a mean discharge it makes a width that is too small.
    """
    width: np.ndarray = np.sqrt(floats(flow, "flow") / bankfull_discharge(1.0))
    return width


@public
def discharge(area: npt.ArrayLike) -> np.ndarray:
    """Discharge in m3/s by drainage area in m2, 0.42 A^0.69 with A in km2 [Peytavie2019].

    The source prints A in m2, which would give 5,800 m3/s for a square kilometre; its figures need km2. This relation
    sets the coefficient of :func:`channel_width` at 100 km2. It is not the discharge of the channels of a network,
    which follows from their widths by :func:`bankfull_discharge`: it does not add up at junctions.
    """
    return DISCHARGE_AT_1_KM2 * (floats(area, "area") / SQUARE_KILOMETER) ** DISCHARGE_EXPONENT


# 2.29e-3: a channel that drains 100 km2 is as wide as a discharge of 10.1 m3/s makes it, 22.9 m.
WIDTH_COEFFICIENT = float(width_of_discharge(discharge(CALIBRATION_AREA)) / np.sqrt(CALIBRATION_AREA))


@public
def channel_width(area: npt.ArrayLike, coefficient: float = WIDTH_COEFFICIENT) -> np.ndarray:
    """Bankfull width in m of a channel that drains an area in m2, w = c A^0.5 [Paris2023, Sec. 3.1].

    The source leaves c open. By default the width is that of :func:`discharge` at 100 km2. Channels are then 2.3 m wide
    at 1 km2 and 229 m at 10,000 km2, whatever the climate.

    Args:
        area: m2.
        coefficient: c, in m per m.
    """
    width: np.ndarray = coefficient * np.sqrt(floats(area, "area"))
    return width
