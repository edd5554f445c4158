"""Constants of the processes: frozen dataclasses whose every field states its unit, range and source."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

__all__ = ["DAYS_PER_YEAR", "MeanderParams", "describe", "parameter"]

DAYS_PER_YEAR = 365.25


def parameter(
    default: Any,
    unit: str,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    low_open: bool = False,
    choices: tuple[str, ...] = (),
    source: str,
    doc: str,
) -> Any:
    """Declare one constant of a process: a dataclass field that knows its unit, range, source and meaning.

    Args:
        default: Value used when none is given.
        unit: Unit at the API, for example ``"m/yr"``; ``"-"`` for a pure number.
        low: Least value allowed.
        high: Greatest value allowed.
        low_open: True when ``low`` itself is refused.
        choices: Allowed words, for a field that holds text.
        source: Key in ``references.bib``, or ``"warpriver"`` for a choice of ours.
        doc: One sentence for help texts.
    """
    metadata = {
        "unit": unit,
        "low": low,
        "high": high,
        "low_open": low_open,
        "choices": choices,
        "source": source,
        "doc": doc,
    }
    return dataclasses.field(default=default, metadata=metadata)


def describe(params: type) -> list[tuple[str, Any, str, str, str]]:
    """List a parameter class as rows (name, default, unit, source, meaning), for help texts and documents."""
    return [
        (f.name, f.default, f.metadata["unit"], f.metadata["source"], f.metadata["doc"])
        for f in dataclasses.fields(params)
    ]


def check_ranges(params: Any) -> None:
    """Raise ``ValueError`` for the first field of ``params`` that lies outside its declared range."""
    kind = type(params).__name__
    for field in dataclasses.fields(params):
        value, meta = getattr(params, field.name), field.metadata
        if meta["choices"]:
            if value not in meta["choices"]:
                words = ", ".join(repr(c) for c in meta["choices"])
                raise ValueError(f"{kind}.{field.name} is {value!r}; use one of {words}")
            continue
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ValueError(f"{kind}.{field.name} is {value!r}; give a finite number of unit {meta['unit']}")
        below = value <= meta["low"] if meta["low_open"] else value < meta["low"]
        if below or value > meta["high"]:
            left = "(" if meta["low_open"] else "["
            raise ValueError(
                f"{kind}.{field.name} is {value:g} {meta['unit']}; "
                f"the range is {left}{meta['low']:g}, {meta['high']:g}]"
            )


@dataclasses.dataclass(frozen=True)
class MeanderParams:
    """Constants of meander migration and neck cutoffs [Paris2023], Table 1.

    The defaults are the paper's values in metres and years; ``MeanderParams.paper()`` gives its Table 1 to the digit.
    """

    time_step: float = parameter(
        106.0 / DAYS_PER_YEAR,
        "yr",
        low=0.0,
        low_open=True,
        source="Paris2023",
        doc="time between two recorded states; done in equal sub-steps where stability asks for it",
    )
    spacing: float = parameter(
        50.0,
        "m",
        low=0.0,
        low_open=True,
        source="Paris2023",
        doc="distance between the points of a channel; at most the channel width",
    )
    spacing_in_widths: float = parameter(
        0.0,
        "widths",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="above 0: each channel has its own spacing, so many of its narrowest width, where that is finer; a network "
        "of brooks and rivers then needs no more points than each asks for",
    )
    migration_rate: float = parameter(
        60.0,
        "m/yr",
        low=0.0,
        source="Sylvester2019",
        doc="k: lateral migration per unit of width times curvature",
    )
    reference_width: float = parameter(
        0.0,
        "m",
        low=0.0,
        source="Hickin1984",
        doc="above 0: migration_rate is that of channels so wide, and others migrate in proportion to their width, as "
        "surveyed rivers do; 0: the same rate for all [Paris2023]",
    )
    friction: float = parameter(
        0.011,
        "-",
        low=0.0,
        low_open=True,
        source="Sylvester2019",
        doc="f: friction factor; upstream curvature is felt over depth / (2 f) metres",
    )
    local_weight: float = parameter(
        -1.0,
        "-",
        high=0.0,
        source="Howard1984",
        doc="omega: weight of the local curvature; above 0 the model would be ill-posed",
    )
    upstream_weight: float = parameter(
        2.5,
        "-",
        low=0.0,
        source="Howard1984",
        doc="gamma: weight of the upstream curvature",
    )
    sinuosity_scaling: str = parameter(
        "upstream",
        "-",
        choices=("upstream", "whole", "none"),
        source="Paris2023",
        doc="what sinuosity^(-2/3) multiplies: the upstream term (as printed), the whole rate (as meanderpy does), "
        "or nothing",
    )
    cutoff_distance: float = parameter(
        1.0,
        "widths",
        low=0.0,
        source="Howard1984",
        doc="two points of a channel closer than this join and cut the loop between them off; 0: never",
    )
    cutoff_min_arc: float = parameter(
        5.0,
        "widths",
        low=1.0,
        source="warpriver",
        doc="points closer than this along the channel are neighbours, never a neck",
    )
    ring_policy: str = parameter(
        "longer",
        "-",
        choices=("longer", "marked", "both"),
        source="warpriver",
        doc="which part of a ring goes on where a neck splits it: the longer one, the one with the ring's first point, "
        "or both, the other as a new channel; what does not go on becomes an oxbow lake",
    )
    end_damping: float = parameter(
        5.0,
        "widths",
        low=0.0,
        source="Paris2023",
        doc="reach at both ends of a channel over which migration fades to nothing; 0: only the end points are held",
    )

    taubin_passes: int = parameter(
        0,
        "-",
        low=0,
        high=1000,
        source="Taubin1995",
        doc="passes a sub-step of a smoothing that takes out the shortest waves and shrinks nothing; 0: none",
    )
    slope_threshold: float = parameter(
        0.15,
        "m/m",
        low=0.0,
        low_open=True,
        source="Paris2023",
        doc="s0: on a terrain, migration fades with the slope and stops where it is this steep",
    )
    collision_distance: float = parameter(
        1.0,
        "mean widths",
        low=0.0,
        source="Paris2023",
        doc="two channels closer than this join where they touch; 0: never",
    )
    junction_reach: float = parameter(
        10.0,
        "widths",
        low=0.0,
        source="warpriver",
        doc="two points that lie together within this arc of a node that their channels share never collide",
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.taubin_passes != int(self.taubin_passes):
            raise ValueError(f"MeanderParams.taubin_passes is {self.taubin_passes:g}; give a whole number")
        if 0.0 < self.cutoff_distance and self.cutoff_min_arc <= self.cutoff_distance:
            raise ValueError(
                f"MeanderParams.cutoff_min_arc is {self.cutoff_min_arc:g} widths, not above cutoff_distance "
                f"({self.cutoff_distance:g} widths): a straight line would be cut"
            )

    @classmethod
    def paper(cls) -> MeanderParams:
        """Return Table 1 of [Paris2023]: 106 days, 50 m, k = 0.164 m/day, f = 0.011, omega = -1, gamma = 2.5."""
        return cls(migration_rate=0.164 * DAYS_PER_YEAR)

    def replace(self, **changes: Any) -> MeanderParams:
        """Return a copy with some fields changed (and checked again)."""
        return dataclasses.replace(self, **changes)
