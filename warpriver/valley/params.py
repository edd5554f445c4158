"""What a synthetic valley is made from: reach averages, one control function for each element, a cross section."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.parameter import Params, parameter
from warpriver.validate import freeze_numbers, shown
from warpriver.valley.controls import Term
from warpriver.valley.profile import LongProfile
from warpriver.valley.stamps import MeshStamp, RoughnessPatch

__all__ = ["ELEMENTS", "SECTION_FORMS", "CovarianceTarget", "CrossSection", "ObjectField", "Thread", "ValleyParams"]

# Elements that take a control function: unit of its values, what they do, and the coordinate they are stationed by.
ELEMENTS: dict[str, tuple[str, str]] = {
    "centerline": ("m", "y of the channel's line over the valley axis x"),
    "width": ("-", "bankfull width = width (1 + f)"),
    "thalweg": ("-", "thalweg = depth (1 + f) above the sloping datum"),
    "curvature": ("-", "f is a line in radians of the reach, whose curvature shifts the thalweg sideways"),
    "bank": ("-", "top of bank raised by depth f"),
    "left_floor": ("m", "left edge of the valley floor, moved outward by f - min f; by x"),
    "right_floor": ("m", "right edge of the valley floor, moved outward by f - min f; by x"),
    "left_top": ("m", "width of the left valley side = top_width / 2 + f; by x"),
    "right_top": ("m", "width of the right valley side = top_width / 2 + f; by x"),
    "floor": ("m", "height of the floor's edge above top of bank = floor_height + f; by x"),
    "top": ("m", "height of the valley top above the floor's edge = top_height + f; by x"),
}

# Forms of cross sections; the number is the one that the kernels know.
SECTION_FORMS = {"asymmetric": 0, "trapezoid": 1, "rectangle": 1, "triangle": 1, "semicircle": 2, "polynomial": 3}
SECTION_FORMS["weibull"] = 4
MAX_THREADS = 8
LINEAR = LongProfile()


@dataclasses.dataclass(frozen=True)
class CrossSection(Params):
    """Form of the channel between its banks; Y runs from 0 at the left bank to 1 at the right, a is the deepest place.

    ============ ==================================================================================================
    form         depth below top of bank, in bankfull depths
    ============ ==================================================================================================
    asymmetric   4 Y^k (1 - Y^k) with a^k = 1/2: deepest at the outer bank of a bend [Deutsch1996]
    trapezoid    flat over the fraction ``flat`` of the width, straight to the banks; flat = 1 is a rectangle, flat = 0
                 a triangle; the bed leans towards a
    rectangle    trapezoid with flat = 1
    triangle     trapezoid with flat = 0
    semicircle   sqrt(1 - (2 Y - 1)^2), a semicircle where the depth is half the width
    polynomial   1 - |(Y - a) / side|^exponent, side the distance from a to the bank [James1996]
    weibull      the deepest of several Weibull curves: threads in one channel [Jacobson2006]
    ============ ==================================================================================================

    Attributes:
        form: Name of the form.
        flat: Fraction of the width over which a trapezoid is flat.
        exponent: Exponent of the polynomial; 2 is a parabola.
        threads: For "weibull": (location, scale, shape, depth) of each thread: its upper end, length and shape of the
            Weibull density in Y, and its maximum depth in bankfull depths, 0 to 1.
    """

    form: str = parameter(
        "asymmetric", "-", choices=tuple(SECTION_FORMS), source="Brown2014", doc="form of the section"
    )
    flat: float = parameter(0.5, "-", low=0.0, high=1.0, source="Brown2014", doc="flat fraction of a trapezoid's width")
    exponent: float = parameter(2.0, "-", low=1.0, high=100.0, source="James1996", doc="exponent of the polynomial")
    threads: tuple[tuple[float, float, float, float], ...] = ((0.0, 0.25, 2.0, 1.0), (0.5, 0.25, 2.0, 0.7))

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            table = np.array(self.threads, np.float64)
        except (TypeError, ValueError):
            table = np.empty(0)
        if table.ndim != 2 or table.shape[1] != 4 or not 1 <= len(table) <= MAX_THREADS:
            raise InputError(
                f"CrossSection.threads must hold 1 to {MAX_THREADS} rows of location, scale, shape and depth"
            )
        bad = (
            ~np.isfinite(table).all(1) | (table[:, 1] <= 0) | (table[:, 2] < 1) | (table[:, 3] <= 0) | (table[:, 3] > 1)
        )
        if bad.any():
            raise InputError(
                f"CrossSection.threads[{int(np.flatnonzero(bad)[0])}] needs a finite location, scale above 0, shape of "
                "1 or more, and a depth above 0, up to 1"
            )
        object.__setattr__(self, "threads", tuple(tuple(float(v) for v in row) for row in table))

    @property
    def flat_fraction(self) -> float:
        """Fraction of the width over which a trapezoid, rectangle or triangle is flat."""
        return {"rectangle": 1.0, "triangle": 0.0}.get(self.form, self.flat)


@dataclasses.dataclass(frozen=True)
class Thread(Params):
    """A further channel that leaves the main one and comes back: its middle runs ``offset`` m to the left of it.

    The offset grows from 0 at ``start`` to its full value halfway and falls to 0 at ``end``, as a sine squared. Where
    channels overlap the deeper one holds.
    """

    start: float = parameter(
        0.2, "reach", low=0.0, high=1.0, source="Brown2014", doc="where it leaves, a fraction of the reach"
    )
    end: float = parameter(0.8, "reach", low=0.0, high=1.0, source="Brown2014", doc="where it comes back")
    offset: float = parameter(50.0, "m", source="Brown2014", doc="maximum distance to the left of the main channel")
    width: float = parameter(
        0.6, "-", low=0.0, low_open=True, high=2.0, source="Brown2014", doc="width over that of the main channel"
    )
    depth: float = parameter(
        0.8, "-", low=0.0, low_open=True, high=2.0, source="Brown2014", doc="depth over that of the main channel"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.end - self.start < 0.02:
            raise InputError(
                f"Thread.end is {self.end:g} and start {self.start:g}; a thread is 0.02 of the reach or more"
            )


@dataclasses.dataclass(frozen=True)
class ObjectField(Params):
    """Boulders or logs, strewn at random by a seed: the ground is raised where one lies, the highest holds.

    A boulder is the upper half of an ellipsoid whose height is ``height`` radii; a log half a round bar of random
    direction, ``length`` m long and as thick as its diameter says. Sizes are even in their logarithm.
    """

    kind: str = parameter("boulder", "-", choices=("boulder", "log"), source="Brown2014", doc="what is strewn")
    where: str = parameter(
        "channel", "-", choices=("channel", "floor", "both"), source="Brown2014", doc="between banks, outside, or both"
    )
    density: float = parameter(0.01, "1/m2", low=0.0, low_open=True, source="Brown2014", doc="objects a square metre")
    smallest: float = parameter(0.3, "m", low=0.0, low_open=True, source="Brown2014", doc="minimum diameter")
    largest: float = parameter(1.5, "m", low=0.0, low_open=True, source="Brown2014", doc="maximum diameter")
    height: float = parameter(1.0, "radii", low=0.0, low_open=True, source="Brown2014", doc="height over radius")
    length: float = parameter(8.0, "m", low=0.0, low_open=True, source="Brown2014", doc="length of logs")
    seed: int = parameter(0, "-", low=0, high=2**31 - 1, source="warpriver", doc="seed of the field")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.largest < self.smallest:
            raise InputError(f"ObjectField.largest is {self.largest:g} m, below smallest, {self.smallest:g} m")


@dataclasses.dataclass(frozen=True)
class CovarianceTarget(Params):
    """Covariance that the thalweg shall have with another series; the thalweg's control function follows from it.

    Attributes:
        partner: "width" or "curvature" (its absolute value).
        mean: Target for the mean of the covariance structure, -1 to 1, or None where ``by_frequency`` alone counts.
        frequencies: Cycles over the reach that the thalweg is made of.
        by_frequency: Target for the correlation at each frequency, -1 to 1, or None for the mean at all of them.
        amplitude: Root mean square of the thalweg's variation, in bankfull depths, times sqrt 2.
    """

    partner: str = parameter("width", "-", choices=("width", "curvature"), source="Brown2014", doc="the other series")
    mean: float | None = None
    frequencies: tuple[float, ...] = (1.0,)
    by_frequency: tuple[float, ...] | None = None
    amplitude: float = parameter(
        0.25, "depths", low=0.0, low_open=True, source="Brown2014", doc="amplitude of the thalweg, sqrt 2 times its rms"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze_numbers(self, "frequencies")
        if self.by_frequency is not None:
            freeze_numbers(self, "by_frequency")
        if self.mean is not None and (isinstance(self.mean, bool) or not isinstance(self.mean, (int, float))):
            raise InputError(f"CovarianceTarget.mean is {shown(self.mean)}; give a number from -1 to 1, or None")


@dataclasses.dataclass(frozen=True)
class ValleyParams(Params):
    """A valley by its reach averages and control functions [Brown2014].

    Attributes:
        controls: For names of :data:`ELEMENTS`, a tuple of terms.
        section: Form of the cross section.
        line: Real centreline in place of the control of "centerline": (n, 2) points in m, downstream, or a RiverNetwork
            of one channel; ``length`` then counts no more.
        bank_window: Length of channel in m over which the highest riffle crest sets the top of bank; None for that of
            the whole reach (eq. 14).
        floor_window: Length of valley in m over which the outermost banks set the floor's edges; None for those of the
            whole reach (eqs 9 and 10).
        covariance: Target that sets the thalweg in place of its control function, or None; or two of them, one with
            the width and one with the curvature, that it meets at once.
        threads: Further channels.
        objects: Fields of boulders and logs.
        profile: Long profile, in place of an even slope.
        patches: Patches of rough ground.
        stamps: Meshes that are set into the ground or stand on it, such as levees and bridges.
    """

    name: str = "valley"
    length: float = parameter(
        420.0, "m", low=0.0, low_open=True, source="Brown2014", doc="length along the valley axis, L_x"
    )
    slope: float = parameter(0.002, "m/m", low=0.0, high=1.0, source="Brown2014", doc="reach slope S along the axis")
    valley_slope: float | None = None
    width: float = parameter(30.0, "m", low=0.0, low_open=True, source="Brown2014", doc="bankfull width W_BF")
    depth: float | None = None
    grain_size: float = parameter(
        0.064, "m", low=0.0, low_open=True, source="Brown2014", doc="median sediment size D50, for the depth by eq. 4"
    )
    shields: float = parameter(
        0.04, "-", low=0.0, low_open=True, source="Brown2014", doc="critical Shields stress, for the depth by eq. 4"
    )
    submerged_gravity: float = parameter(
        1.65, "-", low=0.0, low_open=True, source="Brown2014", doc="submerged specific gravity (g_s - g_w) / g_w"
    )
    floor_width: float = parameter(25.0, "m", low=0.0, source="Brown2014", doc="valley floor W_VB, both sides together")
    top_width: float = parameter(25.0, "m", low=0.0, source="Brown2014", doc="valley sides W_VT, both together")
    floor_height: float = parameter(0.0, "m", source="Brown2014", doc="floor's edge above top of bank, Z_VB")
    top_height: float = parameter(0.0, "m", source="Brown2014", doc="valley top above the floor's edge, Z_VT")
    terraces: int = parameter(
        0, "-", low=0, high=20, source="Brown2014", doc="treads of terraces between bank and floor's edge, 0 for none"
    )
    datum: float = parameter(1000.0, "m", source="Brown2014", doc="vertical datum Z_D, at the downstream end")
    increments: int = parameter(784, "-", low=8, high=2_000_000, source="Brown2014", doc="increments along the reach")
    bank_window: float | None = None
    floor_window: float | None = None
    stationing: str = parameter(
        "channel", "-", choices=("channel", "valley"), source="Brown2014", doc="elements follow s / L_s or x / L_x"
    )
    fall: str = parameter(
        "valley",
        "-",
        choices=("valley", "channel"),
        source="warpriver",
        doc="top of bank falls evenly along the valley axis or along the channel; where limbs of the channel are less "
        "than two widths apart, the latter leaves a step between them",
    )
    curvature_limit: float = parameter(
        1.2,
        "-",
        low=1.0,
        low_open=True,
        source="Brown2014",
        doc="C_max over the greatest curvature; at 1 banks overhang",
    )
    sharp_bends: str = parameter(
        "error",
        "-",
        choices=("error", "blend"),
        source="warpriver",
        doc="where the width exceeds twice the bend radius",
    )
    controls: Mapping[str, Sequence[Term]] = dataclasses.field(default_factory=dict)
    section: CrossSection = CrossSection()
    line: Any = None
    covariance: CovarianceTarget | tuple[CovarianceTarget, ...] | None = None
    profile: LongProfile = LINEAR
    threads: tuple[Thread, ...] = ()
    objects: tuple[ObjectField, ...] = ()
    patches: tuple[RoughnessPatch, ...] = ()
    stamps: tuple[MeshStamp, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for key in self.controls:
            if key not in ELEMENTS:
                raise InputError(f"ValleyParams.controls has {key!r}; the elements are {', '.join(ELEMENTS)}")
        terms = {key: (value,) if callable(value) else tuple(value) for key, value in self.controls.items()}
        for key, value in terms.items():
            if not all(callable(term) for term in value):
                raise InputError(f"ValleyParams.controls[{key!r}] must hold terms, functions of the position")
        object.__setattr__(self, "controls", terms)
        optional = {"depth": True, "valley_slope": False, "bank_window": True, "floor_window": True}
        for name, positive in optional.items():
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and (value > 0.0 if positive else value >= 0.0)):
                bound = "above 0" if positive else "0 or more"
                raise InputError(f"ValleyParams.{name} is {shown(value)}; give a finite number {bound}, or None")
        if self.depth is None and self.slope == 0.0:
            raise InputError(
                "ValleyParams.slope is 0, where the Shields depth of eq. 4 is infinite; give a slope, or a depth"
            )
        self._check_targets()
        if self.covariance is not None and self.controls.get("thalweg"):
            raise InputError("ValleyParams has a covariance target and a control of the thalweg; give one of them")
        if self.line is not None and self.controls.get("centerline"):
            raise InputError("ValleyParams has a line and a control of the centerline; give one of them")

    def _check_targets(self) -> None:
        """Refuse covariance targets that one thalweg cannot meet."""
        targets = self.targets
        if not all(isinstance(target, CovarianceTarget) for target in targets) or len(targets) > 2:
            raise InputError("ValleyParams.covariance must be a CovarianceTarget, two of them, or None")
        if len(targets) < 2:
            object.__setattr__(self, "covariance", targets[0] if targets else None)
            return
        object.__setattr__(self, "covariance", targets)
        first, second = targets
        if first.partner == second.partner:
            raise InputError(
                f'ValleyParams.covariance has two targets with "{first.partner}"; give one with "width" and one with '
                '"curvature"'
            )
        if first.amplitude != second.amplitude:
            raise InputError(
                f"ValleyParams.covariance has the amplitudes {first.amplitude:g} and {second.amplitude:g}; the thalweg "
                "has one, so give both targets the same"
            )
        for target in targets:
            if target.by_frequency is not None or target.mean is None:
                raise InputError(
                    "ValleyParams.covariance has two targets, of which each must be a mean; by_frequency can be given "
                    "for a single one"
                )

    @property
    def targets(self) -> tuple[CovarianceTarget, ...]:
        """The covariance targets: none, one or two."""
        if self.covariance is None:
            return ()
        return tuple(self.covariance) if isinstance(self.covariance, (tuple, list)) else (self.covariance,)

    @property
    def bankfull_depth(self) -> float:
        """Reach-average bankfull depth in m: the one given, or that of incipient motion [Brown2014], eq. 4."""
        if self.depth is not None:
            return float(self.depth)
        return self.submerged_gravity * self.grain_size * self.shields / self.slope

    @property
    def confinement(self) -> float:
        """Confinement ratio W_BF / (W_BF + W_VB + W_VT)."""
        return self.width / (self.width + self.floor_width + self.top_width)

    @property
    def width_to_depth(self) -> float:
        """Width to depth ratio W_BF / H_BF."""
        return self.width / self.bankfull_depth
