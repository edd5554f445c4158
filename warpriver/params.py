"""Constants of the processes: frozen dataclasses whose every field states its unit, range and source."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.parameter import Params, parameter, part

__all__ = [
    "DAYS_PER_YEAR",
    "SOLVER_PARAMS",
    "AvulsionParams",
    "ChuteParams",
    "FloodplainParams",
    "JunctionParams",
    "LehenyParams",
    "MeanderParams",
    "PathMeander",
    "WidthParams",
]

DAYS_PER_YEAR = 365.25
# Defaults of two constants of which either tells the memory of a river.
FRICTION, MEMORY_LENGTH = 0.011, 2.2


@dataclasses.dataclass(frozen=True)
class AvulsionParams(Params):
    """Constants of crevasses and avulsions [Paris2023], Sec. 5.2: ``MeanderParams(avulsions=AvulsionParams())``.

    At the apex of a bend whose curvature, by the mean over one width, is above a threshold, the bank may break: a
    crevasse. Some of them become avulsions: the channel leaves there along a new course, to a point of its own farther
    downstream. With the defaults that is one avulsion for 100 km of bends and 100 yr.

    By the paper every point of such a curvature breaks with a probability of 5 % a step, and 5 % of these are avulsions
    (``crevasse_rule="point"``). The number then depends on the spacing of the points and on the time step: a channel of
    300 widths gets tens of crevasses and about two avulsions at every step of 106 days.
    """

    crevasse_rule: str = parameter(
        "bend",
        "-",
        choices=("bend", "point"),
        source="warpriver",
        doc="where banks break: at the apexes of bends, by a hazard a year (bend), or at every point that is curved "
        "enough, with a probability a step, as in [Paris2023] (point)",
    )
    crevasse_curvature: float = parameter(
        0.1, "-", low=0.0, source="Paris2023", doc="t_c: width times curvature above which banks may break"
    )
    crevasse_rate: float = parameter(
        0.002,
        "1/(km yr)",
        low=0.0,
        source="warpriver",
        doc="hazard by the bend: a bend has that of its length, from inflection to inflection",
    )
    crevasse_probability: float = parameter(
        0.05, "-", low=0.0, high=1.0, source="Paris2023", doc="rho_c: probability by the point and the step"
    )
    avulsion_probability: float = parameter(
        0.05, "-", low=0.0, high=1.0, source="Paris2023", doc="rho_a: probability that a crevasse becomes an avulsion"
    )
    first_angle: float = parameter(
        45.0,
        "deg",
        low=0.0,
        high=90.0,
        source="Paris2023",
        doc="alpha_0: greatest angle between the channel and the first step of a new course",
    )
    jitter: float = parameter(
        5.0, "deg", low=0.0, high=45.0, source="Paris2023", doc="greatest turn by chance at each step of a new course"
    )
    steepest_rise: float = parameter(
        0.05,
        "m/m",
        low=0.0,
        source="Paris2023",
        doc="eps_a: rise of the ground along a new course that is still carved through; a steeper one prevents it",
    )
    fall: float = parameter(
        1e-4, "m/m", low=0.0, low_open=True, source="warpriver", doc="minimum slope of the bed that is carved"
    )
    deepest_cut: float = parameter(
        2.0, "depths", low=0.0, low_open=True, source="warpriver", doc="maximum cut of a new course into the ground"
    )
    nearest: float = parameter(
        10.0,
        "widths",
        low=1.0,
        source="warpriver",
        doc="minimum distance along the channel to where a new course ends",
    )
    farthest: float = parameter(
        100.0,
        "widths",
        low=1.0,
        source="warpriver",
        doc="maximum distance along the channel to where a new course ends",
    )

    meeting: str = parameter(
        "refuse",
        "-",
        choices=("refuse", "join"),
        source="warpriver",
        doc="where a new course meets another channel: it is refused, as in [Paris2023] (refuse), or ends there in a "
        "junction, and the rest of the old course falls dry (join)",
    )
    regional: float = parameter(
        0.0,
        "-",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="fraction of the avulsions that leave for another channel, or the edge of the ground, along the cheapest "
        "way over the ground, rather than for a point of their own channel",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.farthest < self.nearest:
            raise InputError(
                f"AvulsionParams.farthest is {self.farthest:g} widths, below nearest ({self.nearest:g} widths)"
            )


@dataclasses.dataclass(frozen=True)
class ChuteParams(Params):
    """Constants of chute cutoffs: ``MeanderParams(chutes=ChuteParams())``.

    A flood that flows across the bar of a bend may cut a chute there that becomes the channel [Grenfell2014]. A bend,
    from inflection to inflection, is cut by a hazard a year where it winds enough and its chord is short enough.
    """

    rate: float = parameter(
        0.002, "1/yr", low=0.0, source="warpriver", doc="hazard of a bend that may be cut; 0: none is"
    )
    winding: float = parameter(
        1.5, "-", low=1.0, source="Grenfell2014", doc="least length of the bend over its chord, from which on it may be"
    )
    longest: float = parameter(
        8.0,
        "widths",
        low=1.0,
        source="Grenfell2014",
        doc="longest chord of a bend that may be, the length of the chute",
    )


@dataclasses.dataclass(frozen=True)
class FloodplainParams(Params):
    """Constants of what a river leaves behind and meets again: ``MeanderParams(floodplain=FloodplainParams())``.

    Banks differ by what was laid down there [Bogoni2017]: oxbow lakes fill with clay, which resists, and young bars are
    eroded more easily until plants hold them. The rate of a point is multiplied by 1 + (factor - 1) e^(-age / time) of
    the bank half a width ahead. Around a fresh cutoff, where the river is steeper and adjusts, it is multiplied by
    1 + unrest e^(-age / time - distance / reach) as well [Schwenk2016].
    """

    plug_factor: float = parameter(
        0.3, "-", low=0.0, high=1.0, source="Bogoni2017", doc="factor of the rate in a fresh clay plug; 1: none"
    )
    plug_time: float = parameter(
        1000.0, "yr", low=0.0, low_open=True, source="warpriver", doc="time in which plugs become as other banks"
    )
    bar_factor: float = parameter(
        1.5, "-", low=1.0, high=10.0, source="Bogoni2017", doc="factor of the rate in a fresh bar; 1: none"
    )
    bar_time: float = parameter(
        20.0, "yr", low=0.0, low_open=True, source="warpriver", doc="time in which plants come to hold bars"
    )
    unrest: float = parameter(
        1.0,
        "-",
        low=0.0,
        high=10.0,
        source="Schwenk2016",
        doc="by how much the rate next to a fresh cutoff is greater, as a part of it; 0: by nothing",
    )
    unrest_time: float = parameter(
        5.0, "yr", low=0.0, low_open=True, source="Schwenk2016", doc="time in which that goes away"
    )
    unrest_reach: float = parameter(
        10.0, "widths", low=0.1, high=100.0, source="Schwenk2016", doc="distance over which it falls to 1/e"
    )


@dataclasses.dataclass(frozen=True)
class JunctionParams(Params):
    """Constants of the angles at which rivers meet, ``MeanderParams(junctions=JunctionParams())``.

    Rivers of like size meet at a narrow angle; a small one meets a large one nearly at a right angle [Hooshyar2017,
    Paris2023, Sec. 6.1]. The angle between a tributary and the channel below, or in a simulation the course of the
    river through the junction, is

        wide - (wide - narrow) r^e,

    r the lesser flow over the greater one; the greater one arrives at narrow r^(3 e), straight on unless both are
    alike.
    Surveyed tributaries of lowland rivers arrive at 92 to 100 degrees in the median, and none at less than 25.
    """

    narrow_angle: float = parameter(
        28.0,
        "deg",
        low=0.0,
        high=90.0,
        source="warpriver",
        doc="angle between a tributary and the channel below when both tributaries carry the same",
    )
    wide_angle: float = parameter(
        95.0,
        "deg",
        low=0.0,
        high=120.0,
        source="warpriver",
        doc="that angle for a tributary that carries next to nothing beside the other one",
    )
    exponent: float = parameter(
        1.5,
        "-",
        low=0.0,
        low_open=True,
        source="warpriver",
        doc="e: how fast the angle narrows as the flows become alike: ratio^exponent",
    )
    reach: float = parameter(
        6.0,
        "mean widths",
        low=1.0,
        source="warpriver",
        doc="length of the last reach that is shaped, in mean widths of the tributary and the channel below, at most "
        "half of the tributary",
    )
    ease: float = parameter(
        1.0,
        "-",
        low=0.0,
        source="warpriver",
        doc="how fast a mouth takes its angle in a simulation: in 1 / ease of the time in which the channel below "
        "migrates by its width, at the migration rate",
    )
    deferred: float = parameter(
        0.0,
        "-",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="a tributary with less than this part of the river's flow that touches the river runs along its belt from "
        "then on, down to a bend that reaches as far out, as the Yazoo does; 0: it flows in where it touches",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wide_angle < self.narrow_angle:
            raise InputError(
                f"JunctionParams.wide_angle ({self.wide_angle:g} deg) is below narrow_angle ({self.narrow_angle:g} deg)"
            )


@dataclasses.dataclass(frozen=True)
class WidthParams(Params):
    """Constants of widths that vary through bends: ``MeanderParams(widths=WidthParams())``.

    The banks move apart from each other [Parker2011]: the outer one is eroded by the rate E of the law, and the inner
    one follows with (1 - lag) E + (W - W0) / time, W0 the width of the channel. Bends that migrate steadily are wider
    by lag E time, and channels wider where banks are weak and next to fresh cutoffs.
    """

    lag: float = parameter(
        0.3,
        "-",
        low=0.0,
        high=1.0,
        source="Parker2011",
        doc="part of what the outer bank loses that the inner one does not gain at once; 0: widths stay",
    )
    time: float = parameter(
        10.0, "yr", low=0.0, low_open=True, source="warpriver", doc="time in which the inner bank makes up for it"
    )
    widest: float = parameter(
        2.0,
        "-",
        low=1.0,
        high=5.0,
        source="warpriver",
        doc="greatest width that a bend comes to, in those of its channel",
    )


# What else may be left out, of both solvers.
JUNCTIONS: dict[str, Any] = {
    "source": "warpriver",
    "doc": "angles that the last reaches of tributaries take, by how their flow compares with that of the river, and "
    "the bank to which they are led; by default there are",
}
AVULSIONS: dict[str, Any] = {
    "source": "Paris2023",
    "doc": "crevasses, where banks break, and avulsions, new courses of channels from there; by default there are none",
}


@dataclasses.dataclass(frozen=True)
class MeanderParams(Params):
    """Constants of meander migration and neck cutoffs [Paris2023], Table 1.

    Rate, friction, weights, spacing and time step are the paper's; memory, saturation, inlets, banks and cutoffs are
    chosen so that planforms have the statistics of measured rivers (docs/realism.md). ``MeanderParams.paper()`` gives
    Table 1 to the digit, without any of that.
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
        doc="maximum distance between the points of a channel",
    )
    spacing_in_widths: float = parameter(
        1.0,
        "widths",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="maximum distance between the points of a channel as well, in widths at its narrowest place, so that each "
        "channel of a network has its own; 0: no such limit, and a spacing wider than a channel is refused",
    )
    migration_rate: float = parameter(
        60.0,
        "m/yr",
        low=0.0,
        source="Sylvester2019",
        doc="k: lateral migration per unit of width times curvature",
    )
    reference_width: float | None = parameter(
        None,
        "m",
        low=0.0,
        source="Hickin1984",
        doc="migration_rate is that of channels of this width, and others migrate in proportion to their width, as "
        "surveyed rivers do; 0: the same rate for all [Paris2023]; by default the width of the widest channel of the "
        "network",
    )
    friction: float = parameter(
        None,
        "-",
        low=0.0,
        low_open=True,
        source="Sylvester2019",
        doc="f: friction factor, by default 0.011; if it is given, upstream curvature is felt over depth / (2 f) "
        "metres",
    )
    memory_length: float = parameter(
        None,
        "widths",
        low=0.0,
        source="warpriver",
        doc="L: upstream curvature is felt over so many widths, by default 2.2, unless friction is given; 0: by "
        "friction and depth [Paris2023]",
    )
    curvature_saturation: float = parameter(
        0.4,
        "-",
        low=0.0,
        source="Blanckaert2011",
        doc="c0: width times curvature at which the rate of bends saturates, as c0 tanh(w C / c0), since the flow no "
        "longer follows bends that are tighter; 0: never [Paris2023]",
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
    upstream_memory: str = parameter(
        "stem",
        "-",
        choices=("stem", "channel"),
        source="warpriver",
        doc="what a channel feels of the curvature upstream of its head: that of the larger tributary, with which it "
        "moves as one river through the junction (stem), or none, held at both ends as in [Paris2023] (channel)",
    )
    inlet: str = parameter(
        "edge",
        "-",
        choices=("edge", "all", "periodic", "none"),
        source="warpriver",
        doc="which heads feel bends beyond them, as those of rivers that enter the map do: heads at its edge, or all "
        "on a plain without a map (edge), also those of springs (all), or none, below which rivers straighten (none); "
        "periodic: heads as by edge feel the bends at the foot of their river, as if what leaves there came in again",
    )
    inlet_wavelength: float = parameter(
        15.0,
        "widths",
        low=1.0,
        source="warpriver",
        doc="mean wavelength of the bends beyond an inlet",
    )
    inlet_curvature: float = parameter(
        0.1,
        "-",
        low=0.0,
        source="Weiss2022",
        doc="width times curvature of the bends beyond an inlet, as its head feels it, root mean square",
    )
    sinuosity_scaling: str = parameter(
        "whole",
        "-",
        choices=("upstream", "whole", "none"),
        source="Paris2023",
        doc="what sinuosity^(-2/3) multiplies: the upstream term (as printed), the whole rate (as meanderpy does), "
        "or nothing",
    )
    cutoff_distance: float = parameter(
        2.0,
        "widths",
        low=0.0,
        source="warpriver",
        doc="two points of a channel closer than this join and cut the loop between them off: 1 where its banks meet "
        "[Howard1984], 2 where a neck as wide as the river is breached; 0: never",
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
    max_rings: int = parameter(
        1000,
        "-",
        low=1,
        high=1_000_000,
        source="warpriver",
        doc="number of rings up to which ring_policy both makes new ones; from there on it does as marked",
    )
    end_damping: float = parameter(
        5.0,
        "widths",
        low=0.0,
        source="Paris2023",
        doc="reach at both ends of a channel over which what it feels of the bends upstream fades to nothing, so that "
        "bends only straighten there; 0: only the end points are held",
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
    junction_drift: float = parameter(
        0.2,
        "-",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="fraction of the migration rate with which junctions wander along the river, to where the tributary lies "
        "on the outer bank and its last reach does not run along the river; 0: they stay, as in [Paris2023]",
    )

    bank_spread: float = parameter(
        0.7,
        "-",
        low=0.0,
        high=2.0,
        source="Guneralp2011",
        doc="standard deviation of the logarithm of a factor of the rate, a random field of mean 1: some banks are "
        "stronger than others; 0: all are alike",
    )
    bank_correlation: float = parameter(
        4.0,
        "widths",
        low=0.1,
        source="warpriver",
        doc="distance over which the strength of banks differs",
    )
    control_steering: str = parameter(
        "normal",
        "-",
        choices=("normal", "vector", "printed"),
        source="warpriver",
        doc="how the gradient of the control field c steers a channel of the rate mu and the normal n: by (|mu| + "
        "floor) (n . grad c) n (normal), by the whole vector (|mu| + floor) grad c (vector), or by mu grad c, whose "
        "sign turns with every bend, as in [Paris2023], Eq. 7 (printed)",
    )
    control_floor: float = parameter(
        0.02,
        "-",
        low=0.0,
        high=1.0,
        source="warpriver",
        doc="floor: fraction of the migration rate k with which controls steer reaches that do not bend",
    )
    junctions: JunctionParams | None = part(JunctionParams, JunctionParams(), **JUNCTIONS)
    avulsions: AvulsionParams | None = part(AvulsionParams, **AVULSIONS)
    floodplain: FloodplainParams | None = part(
        FloodplainParams,
        source="Bogoni2017",
        doc="clay plugs in oxbow lakes, young bars, and faster migration near fresh cutoffs; by default there are none",
    )
    chutes: ChuteParams | None = part(
        ChuteParams,
        source="Grenfell2014",
        doc="chute cutoffs, bends that floods cut across their bars; by default there are none",
    )
    widths: WidthParams | None = part(
        WidthParams,
        source="Parker2011",
        doc="banks that move apart from each other, so that widths vary through bends; by default they do not",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        friction, memory = self.friction, self.memory_length
        if memory is None:
            memory = MEMORY_LENGTH if friction is None else 0.0
        elif memory > 0.0 and friction not in (None, FRICTION):
            raise InputError(
                f"MeanderParams.friction is {friction:g} and memory_length {memory:g} widths, which are two ways to "
                "tell how far upstream bends are felt; leave one out, or set memory_length to 0"
            )
        object.__setattr__(self, "friction", FRICTION if friction is None else friction)
        object.__setattr__(self, "memory_length", memory)
        if 0.0 < self.cutoff_distance and self.cutoff_min_arc <= self.cutoff_distance:
            raise InputError(
                f"MeanderParams.cutoff_min_arc is {self.cutoff_min_arc:g} widths, not above cutoff_distance "
                f"({self.cutoff_distance:g} widths): a straight line would be cut"
            )

    @classmethod
    def paper(cls, *, events: bool = False) -> MeanderParams:
        """Return Table 1 of [Paris2023]: 106 days, 50 m, k = 0.164 m/day, f = 0.011, omega = -1, gamma = 2.5.

        As there, channels are held at their nodes, the spacing and the rate are the same for all of them, however wide
        they are, and controls steer by its Eq. 7 as printed: an attractor draws the bends to one side, drives off those
        to the other, and does nothing to a straight reach.

        Args:
            events: With crevasses and avulsions by the point and the step, as printed: t_c = 0.1, rho_c = rho_a = 0.05.
                Their number depends on spacing and time step, and is large; see :class:`AvulsionParams`.
        """
        return cls(
            migration_rate=0.164 * DAYS_PER_YEAR,
            spacing_in_widths=0.0,
            reference_width=0.0,
            upstream_memory="channel",
            memory_length=0.0,
            curvature_saturation=0.0,
            inlet="none",
            sinuosity_scaling="upstream",
            cutoff_distance=1.0,
            bank_spread=0.0,
            control_steering="printed",
            junction_drift=0.0,
            junctions=None,
            avulsions=AvulsionParams(crevasse_rule="point") if events else None,
        )

    def for_widths(self, channel_width: np.ndarray) -> MeanderParams:
        """Return the constants with the reference width of a network, where its channels differ in width."""
        if self.reference_width is not None or np.ptp(channel_width) == 0.0:
            return self
        return self.replace(reference_width=float(np.max(channel_width)))


@dataclasses.dataclass(frozen=True)
class LehenyParams(Params):
    """Constants of Leheny's erosion by rain [Leheny1995], in the values that are in use for it on unit cells.

    The model knows no metres: it has one unit of height, in which the constants are given, and cells. On a terrain the
    unit is a metre; :meth:`scaled` makes it another length.
    """

    flow_bias: float = parameter(
        0.05,
        "1/m",
        low=0.0,
        low_open=True,
        source="Leheny1995",
        doc="E: how much water prefers steep ways; a neighbour lower by another 1 / E is e times as likely",
    )
    depth: float = parameter(
        10.0,
        "m",
        low=0.0,
        low_open=True,
        source="Leheny1995",
        doc="D: what each visit of a unit of rain takes off a cell",
    )
    slide_threshold: float = parameter(
        2000.0,
        "m",
        low=0.0,
        low_open=True,
        source="Leheny1995",
        doc="M: neighbours that differ by more than this slide; the taller loses a quarter of the difference",
    )
    neighbors: int = parameter(
        8,
        "-",
        choices=(8, 4),
        source="warpriver",
        doc="neighbours of a cell, for water and for slides; with 4 nothing slides until ways are deep",
    )

    def scaled(self, unit: float) -> LehenyParams:
        """Return the constants for a model whose unit of height is ``unit`` m: E / unit, D unit, M unit."""
        if not (math.isfinite(unit) and unit > 0.0):
            raise InputError(f"unit is {unit}; give a positive length in m")
        return self.replace(
            flow_bias=self.flow_bias / unit, depth=self.depth * unit, slide_threshold=self.slide_threshold * unit
        )


def shared(name: str, *, default: Any = None, **told: str) -> Any:
    """Declare a constant that :class:`MeanderParams` has too: as it stands there, but for what is ``told``."""
    field = MeanderParams.__dataclass_fields__[name]
    default = field.default if default is None else default
    return dataclasses.field(default=default, metadata={**field.metadata, **told})


@dataclasses.dataclass(frozen=True)
class PathMeander(Params):
    """Constants of meandering by shortest paths [PathStudy2026]: give them to ``Simulation`` in place of migration.

    Each point is pushed by its signed curvature C, outward by k w C and downstream by a share of it; the push is
    blurred along the channel and the line smoothed. Where strands lie within the search radius and run along each
    other, or cross, they are joined by shortcuts; the shortest path from the head to the foot is the new channel, and
    what it bypasses stays behind as a closed loop. Small waves of wavenumber q grow at the rate

        k w q^2 (1 / (1 + (b w)^2 q^2) - S),

    k the displacement rate, b the blur length and S the smoothing: fastest at the wavelength
    2 pi b w / sqrt(1 / sqrt(S) - 1), and not at all below 2 pi b w / sqrt(1 / S - 1).

    Channels are held at their nodes, also where a river goes on through them: the course that is searched for is the
    shortest from the head of a channel to its foot, and the push comes from the bends at a point, not from those
    upstream. So there is no ``upstream_memory`` here, as :class:`MeanderParams` has one.

    On rings, what area the smoothing would take, 2 pi S k w a year whatever the form, is given back all along
    [Gage1986]: it keeps the area, and a ring of radius R obeys (R^2 - R0^2) / 2 + (b w)^2 ln(R / R0) = k w t.
    """

    time_step: float = shared("time_step")
    spacing: float = shared("spacing")
    spacing_in_widths: float = shared("spacing_in_widths")
    displacement_rate: float = parameter(
        60.0,
        "m/yr",
        low=0.0,
        source="warpriver",
        doc="k, strength of the displacement: lateral push per unit of width times curvature",
    )
    downstream_share: float = parameter(
        0.9,
        "-",
        low=0.0,
        high=2.0,
        source="PathStudy2026",
        doc="phi: fraction of the lateral push that is added along the channel, downstream; with little of it bends "
        "stand still, and ever longer loops carry the belt away",
    )
    blur_length: float = parameter(
        1.5,
        "widths",
        low=0.5,
        source="warpriver",
        doc="b: length along the channel over which the push is blurred; bends grow in proportion to it",
    )
    smoothing: float = parameter(
        0.35,
        "-",
        low=0.01,
        high=10.0,
        source="warpriver",
        doc="S, strength of the smoothing: diffusivity of the line over k w; from 1 on nothing meanders",
    )
    search_radius: float = parameter(
        1.5,
        "widths",
        low=0.0,
        low_open=True,
        source="PathStudy2026",
        doc="points of a channel closer than this may be joined by a shortcut",
    )
    cone_angle: float = parameter(
        45.0,
        "deg",
        low=0.0,
        high=90.0,
        low_open=True,
        source="PathStudy2026",
        doc="greatest angle between the lines of two strands that a shortcut joins; 90: any",
    )
    cutoff_min_arc: float = shared(
        "cutoff_min_arc", doc="points closer than this along the channel are neighbours, never joined"
    )
    ring_policy: str = shared("ring_policy")
    max_rings: int = shared("max_rings")
    end_damping: float = shared(
        "end_damping",
        source="PathStudy2026",
        doc="reach at both ends of a channel over which the push fades to nothing; 0: only the end points are held",
    )
    taubin_passes: int = shared("taubin_passes")
    slope_threshold: float = shared(
        "slope_threshold",
        doc="on a terrain, the push and the smoothing fade with the slope and stop where it is this steep",
    )
    collision_distance: float = shared("collision_distance")
    junction_reach: float = shared("junction_reach")
    junction_drift: float = shared(
        "junction_drift",
        default=0.0,
        doc="fraction of the displacement rate with which junctions wander along the river, to where the tributary "
        "lies on the outer bank; 0: they stay",
    )
    control_steering: str = shared("control_steering")
    control_floor: float = shared(
        "control_floor",
        doc="floor: fraction of the displacement rate k with which controls steer reaches that do not bend",
    )
    junctions: JunctionParams | None = part(JunctionParams, JunctionParams(), **JUNCTIONS)
    avulsions: AvulsionParams | None = part(AvulsionParams, **AVULSIONS)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cutoff_min_arc <= self.search_radius:
            raise InputError(
                f"PathMeander.cutoff_min_arc is {self.cutoff_min_arc:g} widths, not above search_radius "
                f"({self.search_radius:g} widths): a straight line would be cut"
            )


# The parameters of each solver that a simulation knows, by the name that files and the command line use.
SOLVER_PARAMS: dict[str, type[MeanderParams] | type[PathMeander]] = {"migration": MeanderParams, "path": PathMeander}
