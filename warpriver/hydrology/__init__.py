"""Hydrology on a terrain: depressions filled or carved, flow directions, drainage area and what follows from it.

It says where water goes on a surface, a terrain or a raster of heights: in rasters on the surface's device, or in a
network. It is not for water depth and velocity, ground water, or rain that varies.
"""

from warpriver.hydraulic_geometry import bankfull_discharge, channel_width, discharge, width_of_discharge
from warpriver.hydrology.depressions import carve_depressions, fill_depressions
from warpriver.hydrology.drape import drape
from warpriver.hydrology.extraction import extract_network
from warpriver.hydrology.laws import NetworkLaws, network_laws
from warpriver.hydrology.orders import (
    exceedance,
    hack_exponent,
    horton_order,
    horton_ratios,
    main_stem,
    main_stem_length,
    shreve_magnitude,
    strahler_order,
    tokunaga,
)
from warpriver.hydrology.routing import Flow, drainage_area, flow_directions, flow_length, hand, route, stream_power

__all__ = [
    "Flow",
    "NetworkLaws",
    "bankfull_discharge",
    "carve_depressions",
    "channel_width",
    "discharge",
    "drainage_area",
    "drape",
    "exceedance",
    "extract_network",
    "fill_depressions",
    "flow_directions",
    "flow_length",
    "hack_exponent",
    "hand",
    "horton_order",
    "horton_ratios",
    "main_stem",
    "main_stem_length",
    "network_laws",
    "route",
    "shreve_magnitude",
    "strahler_order",
    "stream_power",
    "tokunaga",
    "width_of_discharge",
]
