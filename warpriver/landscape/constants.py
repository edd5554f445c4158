"""Constants of carving."""

from __future__ import annotations

import dataclasses

from warpriver.parameter import Params, parameter

__all__ = ["CarveParams"]


@dataclasses.dataclass(frozen=True)
class CarveParams(Params):
    """Constants of carving."""

    section: str = parameter(
        "parabola", "-", choices=("parabola", "trapezoid"), source="warpriver", doc="form of the cross sections"
    )
    side_fraction: float = parameter(
        0.2,
        "-",
        low=0.01,
        high=0.5,
        source="warpriver",
        doc="fraction of the width that each side of a trapezoid takes up",
    )
    bank_reach: float = parameter(
        1.0,
        "widths",
        low=0.0,
        source="warpriver",
        doc="distance from the water's edge at which banks have come up to the ground, at least a cell and a half",
    )
    repose_angle: float = parameter(
        35.0,
        "deg",
        low=1.0,
        high=85.0,
        source="warpriver",
        doc="maximum slope of the walls of deep cuts, over that of the ground before",
    )
    max_cut: float = parameter(
        60.0,
        "m",
        low=0.0,
        source="warpriver",
        doc="limit of how far water is led below the ground; beyond it hollows upstream are filled instead",
    )
    fill_fraction: float = parameter(
        0.0,
        "-",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="where ground rises along a river: 0 cuts through it, 1 fills the hollow above it, between is in between",
    )
    smoothing: float = parameter(
        6.0, "widths", low=0.0, source="warpriver", doc="length along a river over which the water's level is averaged"
    )
    junctions: bool = True
    lake_time: float = parameter(
        50.0, "yr", low=0.0, low_open=True, source="warpriver", doc="time in which an oxbow lake fills up by a factor e"
    )
    plug_length: float = parameter(
        2.0, "widths", low=0.0, source="warpriver", doc="length of the plug at each end of an oxbow lake"
    )
