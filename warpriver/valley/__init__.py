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
from warpriver.valley.covariance import Covariance, harmonics_for_covariance, harmonics_for_covariances
from warpriver.valley.params import CovarianceTarget, CrossSection, ObjectField, Thread, ValleyParams
from warpriver.valley.profile import LongProfile
from warpriver.valley.stamps import MeshStamp, RoughnessPatch, Structure
from warpriver.valley.structures import bridge, levee
from warpriver.valley.valley import Valley, ValleyGrid, synthetic_valley
from warpriver.valley.variogram import Variogram

__all__ = [
    "Autoregressive",
    "Cnoidal",
    "Covariance",
    "CovarianceTarget",
    "CrossSection",
    "GradientNoise",
    "Harmonic",
    "Kinoshita",
    "LongProfile",
    "MeshStamp",
    "ObjectField",
    "RoughnessPatch",
    "Series",
    "SineGenerated",
    "Spectral",
    "Spline",
    "Steps",
    "Structure",
    "Thread",
    "Valley",
    "ValleyGrid",
    "ValleyParams",
    "Variogram",
    "bridge",
    "cosine",
    "harmonics_for_covariance",
    "harmonics_for_covariances",
    "levee",
    "sine",
    "strongest_harmonics",
    "synthetic_valley",
]
