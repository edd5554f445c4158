"""The six valleys S1 to S6 of Brown et al. (2014), Tables 3 and 4, with slopes and grain sizes before rounding.

Phases that the tables round to 3.14 and 1.57 are pi and pi / 2. S1 and S2 are straight, S3 and S4 meander, S5 and S6
are hybrids; S2 and S4 are mountain rivers.
"""

from __future__ import annotations

import math

from warpriver.valley.controls import cosine, sine
from warpriver.valley.params import ValleyParams

__all__ = ["EXAMPLES"]

HALF, QUARTER = math.pi, 0.5 * math.pi

_S1 = ValleyParams(
    name="S1",
    controls={"thalweg": (sine(0.25, 1),), "width": (sine(0.25, 1),)},
)
_S2 = ValleyParams(
    name="S2",
    length=140.0,
    slope=0.015,
    width=10.0,
    grain_size=0.256,
    floor_width=1.0,
    top_width=1.0,
    floor_height=5.0,
    top_height=5.0,
    controls={
        "thalweg": (sine(2.0, 2, HALF),),
        "width": (sine(0.25, 2),),
        "left_floor": (sine(2.0, 2),),
        "right_floor": (sine(2.0, 2),),
    },
)
_S3 = ValleyParams(
    name="S3",
    grain_size=0.032,
    floor_width=50.0,
    top_width=50.0,
    top_height=1.0,
    controls={
        "centerline": (sine(50.0, 1),),
        "curvature": (sine(0.1, 1),),
        "thalweg": (sine(1.0, 2, QUARTER),),
        "width": (sine(0.25, 2, QUARTER),),
        "left_floor": (sine(50.0, 1, HALF),),
        "right_floor": (sine(50.0, 1),),
    },
)
_S4 = ValleyParams(
    name="S4",
    length=140.0,
    slope=0.015,
    width=10.0,
    grain_size=0.256,
    floor_width=1.0,
    top_width=1.0,
    floor_height=5.0,
    top_height=5.0,
    controls={
        "centerline": (sine(5.0, 1),),
        "curvature": (sine(0.1, 2, HALF),),
        "thalweg": (sine(2.0, 2),),
        "width": (sine(0.25, 2, HALF),),
        "left_floor": (sine(5.0, 1, HALF),),
        "right_floor": (sine(5.0, 1, HALF),),
    },
)
_S5 = ValleyParams(
    name="S5",
    length=1000.0,
    slope=0.001,
    width=50.0,
    grain_size=0.032,
    floor_width=25.0,
    top_width=100.0,
    floor_height=4.0,
    top_height=10.0,
    controls={
        "centerline": (sine(100.0, 1), cosine(50.0, 2)),
        "curvature": (sine(0.25, 1, 1.0),),
        "thalweg": (sine(0.5, 1.25, HALF), cosine(2.0, 2, HALF)),
        "width": (sine(0.2, 2, QUARTER), cosine(0.3, 0.5)),
        "left_floor": (sine(75.0, 1.5), cosine(25.0, 4, HALF)),
        "right_floor": (sine(25.0, 4.5, HALF), cosine(55.0, 1.5, HALF)),
    },
)
_S6 = ValleyParams(
    name="S6",
    length=2000.0,
    slope=0.001,
    width=50.0,
    grain_size=0.032,
    floor_width=25.0,
    top_width=200.0,
    floor_height=2.0,
    top_height=5.0,
    controls={
        "centerline": (sine(175.0, 0.2), cosine(75.0, 2), sine(50.0, 1), cosine(10.0, 7)),
        "curvature": (sine(0.25, 2, HALF),),
        "thalweg": (sine(1.0, 4), cosine(0.5, 4), sine(0.25, 5), cosine(0.5, 2)),
        "width": (sine(0.3, 4), cosine(0.2, 4), sine(0.1, 2), cosine(0.1, 2)),
        "left_floor": (sine(100.0, 0.2), cosine(75.0, 2, HALF), sine(50.0, 1), cosine(10.0, 7)),
        "right_floor": (sine(100.0, 0.2, HALF), cosine(75.0, 2), sine(50.0, 1, HALF), cosine(10.0, 7, HALF)),
    },
)

EXAMPLES = {params.name: params for params in (_S1, _S2, _S3, _S4, _S5, _S6)}
