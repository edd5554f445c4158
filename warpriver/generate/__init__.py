"""Lines and terrains from nothing."""

from warpriver.erosion.eroded import erosion_peak, erosion_plane
from warpriver.generate.lines import kinoshita, noisy_line, sine_generated, straight_line, valley_line
from warpriver.generate.terrains import (
    cone,
    fluvial_terrain,
    fractal_terrain,
    intermontane_basin,
    mountain_front,
    mountain_front_line,
    mountain_front_zones,
    read_sample_dem,
    tilted_plain,
)

__all__ = [
    "cone",
    "erosion_peak",
    "erosion_plane",
    "fluvial_terrain",
    "fractal_terrain",
    "intermontane_basin",
    "kinoshita",
    "mountain_front",
    "mountain_front_line",
    "mountain_front_zones",
    "noisy_line",
    "read_sample_dem",
    "sine_generated",
    "straight_line",
    "tilted_plain",
    "valley_line",
]
