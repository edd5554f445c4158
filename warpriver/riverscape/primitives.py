"""What a water surface is made of: moving primitives, and how they are merged and replaced [Peytavie2019], Sec. 6."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpriver.arrays import FlagArray, FloatArray, IndexArray
from warpriver.errors import InputError
from warpriver.kernels import flow_tree as kernels
from warpriver.public import public
from warpriver.validate import seeded

__all__ = ["KINDS", "Merge", "Node", "Primitives", "Replace", "blend", "primitives"]


# The kinds of a primitive by name; the numbers from 7 on are those of a user's own leaves.
KINDS = {
    "calm": kernels.CALM,
    "ripple": kernels.RIPPLE,
    "turbulent": kernels.TURBULENT,
    "wave": kernels.WAVE,
    "cascade": kernels.CASCADE,
    "vortex": kernels.VORTEX,
    "echo": kernels.ECHO,
}
# What the three numbers of a primitive's shape are, by kind.
SHAPES: dict[int, tuple[str, ...]] = {
    kernels.WAVE: ("height", "blending", "length"),
    kernels.CASCADE: ("height", "blending", "lip"),
    kernels.VORTEX: ("shear", "spin", "depth"),
    kernels.ECHO: ("bank_angle", "bank_distance"),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Primitives:
    """Leaves of a blend-flow tree, one a row; as a node of the tree they are merged.

    :func:`primitives` makes them from names.

    Attributes:
        kind: (n,) numbers of :data:`KINDS`; from 7 on a user's own.
        center: (n, 2) m.
        radius: (n,) m: the weight is (1 - r^2)^3 within it, 0 beyond.
        level: (n,) level of the water at the centre, m.
        gradient: (n, 2) of the level, m/m.
        velocity: (n, 2) m/s.
        amplitude: (n,) of the waves, m.
        wavelength: (n,) of the first octave of the waves, m.
        effervescence: (n,) white water, 0 to 1.
        shape: (n, 3) by kind: wave (height m, blending m, length m), cascade (drop m, blending m, lip m), vortex (shear
            in rad from the centre to the rim, spin rad/s, depth m), echo (angle of the bank's normal rad, distance of
            the bank along it m, -).
        offset: (n,) whole numbers below 2^32: where in the noise each begins.
    """

    kind: IndexArray
    center: FloatArray
    radius: FloatArray
    level: FloatArray
    gradient: FloatArray
    velocity: FloatArray
    amplitude: FloatArray
    wavelength: FloatArray
    effervescence: FloatArray
    shape: FloatArray
    offset: IndexArray

    def __len__(self) -> int:
        return len(self.radius)

    def __getitem__(self, rows: slice | IndexArray | FlagArray) -> Primitives:
        return Primitives(*(getattr(self, f.name)[rows] for f in dataclasses.fields(self)))

    def replace(self, **changes: NDArray[Any]) -> Primitives:
        """Return a copy with some arrays changed."""
        return dataclasses.replace(self, **changes)

    @staticmethod
    def concatenate(parts: Sequence[Primitives]) -> Primitives:
        """Return the rows of several, one after the other."""
        names = [f.name for f in dataclasses.fields(Primitives)]
        return Primitives(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def __repr__(self) -> str:
        names = {number: name for name, number in KINDS.items()}
        kinds, counts = np.unique(self.kind, return_counts=True)
        told = ", ".join(f"{c} {names.get(int(k), f'kind {k}')}" for k, c in zip(kinds, counts, strict=True))
        return f"Primitives({told or 'none'})"


@dataclasses.dataclass(frozen=True, eq=False)
class Merge:
    """Nodes whose surfaces are mixed by their weights: f = sum(alpha f) / sum(alpha), alpha = sum(alpha)."""

    children: tuple[Node, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Replace:
    """A surface that another one replaces: f = (1 - m) f_A + m f_B, m = min(1, alpha_B), alpha = alpha_A."""

    under: Node
    over: Node


Node = Primitives | Merge | Replace


@public
def blend(under: Node, *over: Node) -> Node:
    """Return a tree in which each of some nodes replaces what lies under it.

    Args:
        under: What is replaced.
        over: What replaces it, in this order.

    Source:
        [Peytavie2019], Sec. 6.2.
    """
    node = under
    for each in over:
        node = Replace(node, each)
    return node


@public
def primitives(
    kind: str | int,
    center: ArrayLike,
    radius: ArrayLike,
    level: ArrayLike = 0.0,
    *,
    gradient: ArrayLike = (0.0, 0.0),
    velocity: ArrayLike = (0.0, 0.0),
    amplitude: ArrayLike = 0.0,
    wavelength: ArrayLike = 1.0,
    effervescence: ArrayLike = 0.0,
    height: ArrayLike = 0.0,
    blending: ArrayLike = 0.1,
    length: ArrayLike = 1.0,
    lip: ArrayLike = 0.0,
    shear: ArrayLike = 0.0,
    spin: ArrayLike = 0.0,
    depth: ArrayLike = 0.0,
    bank_angle: ArrayLike = 0.0,
    bank_distance: ArrayLike = 0.0,
    shape: ArrayLike | None = None,
    seed: int = 0,
) -> Primitives:
    """Return primitives of one kind; what is given once holds for all of them.

    Args:
        kind: A name of :data:`KINDS`, or the number of an own leaf, from 7 on.
        center: (2,) or (n, 2) m.
        radius: m, above 0.
        level: Level of the water at the centre, m.
        gradient: (2,) or (n, 2) of the level, m/m.
        velocity: (2,) or (n, 2) m/s; a wave and a cascade need one, whose direction they lie along.
        amplitude: Of the waves, m, 0 or more.
        wavelength: Of the first octave of the waves, m, above 0.
        effervescence: White water, 0 to 1.
        height: Of a wave from trough to crest, or of a cascade's drop, m.
        blending: Half the length over which a wave or a cascade passes from calm to turbulent, m, above 0.
        length: Of a standing wave, m, above 0.
        lip: How far down the stream from the centre a cascade's lip is, m.
        shear: Angle by which a vortex is twisted from its centre to its rim, rad.
        spin: Of a vortex, rad/s, above 0 to the left.
        depth: Of a vortex's dimple, m.
        bank_angle: Direction of the normal of an echo's bank, rad from east to north.
        bank_distance: Distance of that bank from the centre along its normal, m.
        shape: (3,) or (n, 3), of an own leaf: what it makes of them is its own.
        seed: Of the places in the noise where they begin.

    Raises:
        ValueError: An unknown kind, lengths that differ, or a value out of its range.

    Source:
        [Peytavie2019], Sec. 6.1.
    """
    number = _kind_number(kind)
    named = {
        "height": height,
        "blending": blending,
        "length": length,
        "lip": lip,
        "shear": shear,
        "spin": spin,
        "depth": depth,
        "bank_angle": bank_angle,
        "bank_distance": bank_distance,
    }
    columns = {
        "radius": radius,
        "level": level,
        "amplitude": amplitude,
        "wavelength": wavelength,
        "effervescence": effervescence,
        **named,
    }
    pairs = {"center": center, "gradient": gradient, "velocity": velocity}
    rows = {name: np.atleast_1d(_numbers(value, name)) for name, value in columns.items()}
    rows |= {name: np.atleast_2d(_numbers(value, name)) for name, value in pairs.items()}
    own = np.atleast_2d(_numbers((0.0, 0.0, 0.0) if shape is None else shape, "shape"))
    count = max(len(value) for value in [*rows.values(), own])
    for name, value in [*rows.items(), ("shape", own)]:
        wide = {"shape": (3,)}.get(name, (2,) if name in pairs else ())
        if value.shape[1:] != wide or len(value) not in (1, count):
            raise InputError(f"primitives: {name} has shape {value.shape}; give one, or one for each of {count}")
    rows = {name: np.broadcast_to(value, (count, *value.shape[1:])) for name, value in rows.items()}
    form = np.array(np.broadcast_to(own, (count, 3)))
    for column, name in enumerate(SHAPES.get(number, ())):
        form[:, column] = rows[name]
    for name in named:
        del rows[name]
    generator = seeded(seed)
    found = Primitives(
        kind=np.full(count, number, np.int64),
        shape=form,
        offset=generator.integers(0, 2**32, count, dtype=np.int64),
        **{name: np.array(value) for name, value in rows.items()},
    )
    check_primitives(found)
    return found


def check_primitives(rows: Primitives) -> None:
    """Raise ``ValueError`` that names the first row with a value that no primitive can have."""
    wave, cascade = rows.kind == kernels.WAVE, rows.kind == kernels.CASCADE
    still = ~rows.velocity.any(axis=1)
    wrong = {
        "radius must be above 0": ~(rows.radius > 0.0),
        "wavelength must be above 0": ~(rows.wavelength > 0.0),
        "amplitude must be 0 or more": ~(rows.amplitude >= 0.0),
        "effervescence must lie in [0, 1]": ~((rows.effervescence >= 0.0) & (rows.effervescence <= 1.0)),
        "a wave or a cascade needs a velocity, whose direction it lies along": (wave | cascade) & still,
        "blending must be above 0": (wave | cascade) & ~(rows.shape[:, 1] > 0.0),
        "length must be above 0": wave & ~(rows.shape[:, 2] > 0.0),
    }
    for text, where in wrong.items():
        if where.any():
            raise InputError(f"primitives: row {int(where.argmax())}: {text}")


def _kind_number(kind: str | int) -> int:
    if isinstance(kind, str) and kind in KINDS:
        return int(KINDS[kind])
    if isinstance(kind, int) and kernels.OWN <= kind < 2**15:
        return kind
    raise InputError(
        f"primitives: kind is {kind!r}; use one of {', '.join(KINDS)}, or {kernels.OWN} and more for your own"
    )


def _numbers(value: ArrayLike, name: str) -> FloatArray:
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"primitives: {name} cannot be used ({error}); give numbers") from error
    if not np.isfinite(found).all() or (found.size and np.abs(found).max() > 1e12):
        raise InputError(f"primitives: {name} has a value that is not finite, or above 1e12")
    return found
