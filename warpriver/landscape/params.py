"""Constants of the maps that are made from a history."""

from __future__ import annotations

import dataclasses

from warpriver.parameter import Params, parameter

__all__ = ["LandscapeParams"]


@dataclasses.dataclass(frozen=True)
class LandscapeParams(Params):
    """What moving channels leave behind, and how it ages; see :func:`warpriver.landscape_maps`."""

    moisture_rate: float = parameter(
        0.02,
        "1/yr",
        low=0.0,
        source="warpriver",
        doc="moisture that a year adds where the falloff is 1",
    )
    sediment_rate: float = parameter(
        0.05,
        "m/yr",
        low=0.0,
        source="warpriver",
        doc="deposits that a year adds where the falloff is 1, uncapped",
    )
    lake_time: float = parameter(
        50.0,
        "yr",
        low=0.0,
        low_open=True,
        source="warpriver",
        doc="time in which an oxbow lake fills, down to 1/e",
    )
    plug_length: float = parameter(
        2.0, "widths", low=0.0, source="warpriver", doc="reach at both ends of an oxbow lake that is plugged at once"
    )
    cover_time: float = parameter(
        20.0, "yr", low=0.0, low_open=True, source="warpriver", doc="time in which plants cover 1 - 1/e of new ground"
    )
    dry_cover: float = parameter(
        0.12,
        "-",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="density of vegetation where no river moistens the ground",
    )
    bar_time: float = parameter(
        15.0, "yr", low=0.0, low_open=True, source="warpriver", doc="time in which a point bar grows to the floodplain"
    )
    bar_depth: float = parameter(
        0.4, "depths", low=0.0, high=1.0, source="warpriver", doc="how far below the floodplain a bar emerges"
    )
    scroll_period: float = parameter(
        8.0, "yr", low=0.0, low_open=True, source="warpriver", doc="time from one scroll bar to the next"
    )
    scroll_height: float = parameter(
        0.12, "depths", low=0.0, high=1.0, source="warpriver", doc="height of scroll bars above the swales between them"
    )
    lobe_length: float = parameter(
        6.0, "widths", low=0.0, source="warpriver", doc="how far a crevasse lobe reaches from the channel; 0: none"
    )
    lobe_height: float = parameter(
        0.25, "depths", low=0.0, high=1.0, source="warpriver", doc="thickness of a crevasse lobe at the bank"
    )
