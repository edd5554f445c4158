"""Synthetic river valleys: control functions, cross sections and their covariance [Brown2014]."""

from warpriver.valley.controls import (
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
from warpriver.valley.covariance import Covariance, harmonics_for_covariance
from warpriver.valley.params import CovarianceTarget, CrossSection, ObjectField, Thread, ValleyParams
from warpriver.valley.valley import Valley, ValleyGrid, synthetic_valley

__all__ = [
    "Autoregressive",
    "Cnoidal",
    "Covariance",
    "CovarianceTarget",
    "CrossSection",
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
    "cosine",
    "harmonics_for_covariance",
    "sine",
    "strongest_harmonics",
    "synthetic_valley",
]
