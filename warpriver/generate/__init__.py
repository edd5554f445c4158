"""Lines, terrains and river valleys from nothing."""

from warpriver.generate.curves import kinoshita, noisy_line, sine_generated, straight_line, valley_line
from warpriver.generate.eroded import ErodedTerrain, erosion_peak, erosion_plane
from warpriver.generate.leheny import erode, erode_ensemble
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
from warpriver.generate.valley import Valley, ValleyGrid, synthetic_valley
from warpriver.generate.valley_controls import (
    Autoregressive,
    Cnoidal,
    GradientNoise,
    Harmonic,
    Kinoshita,
    Series,
    SineGenerated,
    Spectral,
    Spline,
    Steps,
    cosine,
    sine,
    strongest_harmonics,
)
from warpriver.generate.valley_covariance import Covariance, harmonics_for_covariance
from warpriver.generate.valley_params import CovarianceTarget, CrossSection, ObjectField, Thread, ValleyParams

__all__ = [
    "Autoregressive",
    "Cnoidal",
    "Covariance",
    "CovarianceTarget",
    "CrossSection",
    "ErodedTerrain",
    "GradientNoise",
    "Harmonic",
    "Kinoshita",
    "ObjectField",
    "Series",
    "SineGenerated",
    "Spectral",
    "Spline",
    "Steps",
    "Thread",
    "Valley",
    "ValleyGrid",
    "ValleyParams",
    "cone",
    "cosine",
    "erode",
    "erode_ensemble",
    "erosion_peak",
    "erosion_plane",
    "fluvial_terrain",
    "fractal_terrain",
    "harmonics_for_covariance",
    "intermontane_basin",
    "kinoshita",
    "mountain_front",
    "mountain_front_line",
    "mountain_front_zones",
    "noisy_line",
    "read_sample_dem",
    "sine",
    "sine_generated",
    "straight_line",
    "strongest_harmonics",
    "synthetic_valley",
    "tilted_plain",
    "valley_line",
]
