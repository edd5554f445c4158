"""Hydraulic geometry: width, depth and discharge of channels from each other and from their drainage area."""

from __future__ import annotations

from typing import Any

import numpy as np

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
# Q = 0.42 A^0.69 in m3/s and km2 [Peytavie2019].
DISCHARGE_AT_1_KM2, DISCHARGE_BY_AREA = 0.42, 0.69
# w ~ A^0.5 along a river [Paris2023], as w ~ Q^0.5.
WIDTH_BY_FLOW = 0.5
# Area in m2 at which width from area and width from discharge agree.
CALIBRATION_AREA = 100.0 * SQUARE_KILOMETER


def bankfull_depth(width: Any) -> Any:
    """Bankfull depth in m of a channel ``width`` m wide, from w = 18.8 d^1.41 [Konsoer2013]."""
    return (np.asarray(width, np.float64) / WIDTH_AT_1_M) ** DEPTH_BY_WIDTH


def bankfull_width(depth: Any) -> Any:
    """Bankfull width in m of a channel ``depth`` m deep, w = 18.8 d^1.41 [Konsoer2013]."""
    return WIDTH_AT_1_M * np.asarray(depth, np.float64) ** WIDTH_BY_DEPTH


def bankfull_discharge(width: Any) -> Any:
    """Bankfull discharge in m3/s of a channel ``width`` m wide, from w = 7.2 Q^0.5 [Andreadis2013]."""
    return (np.asarray(width, np.float64) / WIDTH_AT_1_M3_S) ** 2


def discharge(area: Any) -> np.ndarray:
    """Discharge in m3/s of a channel that drains an area in m2: 0.42 A^0.69 with A in km2 [Peytavie2019].

    The source prints A in m2, which would give 5,800 m3/s for a square kilometre; its figures need km2.
    """
    return DISCHARGE_AT_1_KM2 * (np.asarray(area, np.float64) / SQUARE_KILOMETER) ** DISCHARGE_BY_AREA


def width_of_discharge(flow: Any) -> np.ndarray:
    """Bankfull width in m of a channel with a discharge in m3/s, w = 7.2 Q^0.5 [Andreadis2013]."""
    return np.sqrt(np.asarray(flow, np.float64) / bankfull_discharge(1.0))


# 2.29e-3: a channel that drains 100 km2 is as wide as its discharge of 10.1 m3/s makes it, 22.9 m.
WIDTH_COEFFICIENT = float(width_of_discharge(discharge(CALIBRATION_AREA)) / np.sqrt(CALIBRATION_AREA))


def channel_width(area: Any, coefficient: float = WIDTH_COEFFICIENT) -> np.ndarray:
    """Bankfull width in m of a channel that drains an area in m2, w = c A^0.5 [Paris2023, Sec. 3.1].

    The source leaves c open. By default it makes the width agree with ``width_of_discharge(discharge(area))`` at
    100 km2; that law grows as A^0.345, so that this one is narrower in headwaters (1 km2: 2.3 m against 4.7 m) and
    wider in large basins (10,000 km2: 229 m against 112 m). Depth follows by :func:`bankfull_depth`.

    Args:
        area: m2.
        coefficient: c, in m per m.
    """
    return coefficient * np.sqrt(np.asarray(area, np.float64))
