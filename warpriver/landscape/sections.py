"""Cross sections of channels, as tables of unit width and depth: given forms, or any others."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from warpriver.arrays import CellArray, FloatArray
from warpriver.errors import InputError
from warpriver.public import public
from warpriver.validate import floats, shown, whole

__all__ = ["SectionTable", "parabola", "trapezoid"]

Form = Callable[[FloatArray], ArrayLike]

# Places across a form that is given as a function.
PLACES = 257


@dataclasses.dataclass(frozen=True, eq=False)
class SectionTable:
    """Forms of cross sections, and which of them the points of a network have.

    A form is a row of depths below the water's edge, at places spaced evenly from the left bank to the right one. Each
    is scaled to a maximum depth of 1: that of a channel is the depth of its point, its width that of its point. So
    forms of unit area are as good as those of unit depth; ``fraction`` says how much water they hold.

    Attributes:
        depth: (K, M) depths over the maximum of the form, read-only.
        row: (P,) row of each point of the network; between two points their forms are blended. None: the first one for
            all.
    """

    depth: FloatArray
    row: CellArray | None = None

    @public
    def __init__(self, depth: ArrayLike, row: ArrayLike | None = None):
        """Check and copy a table.

        Args:
            depth: (K, M) depths of K forms, 0 or more, or (M,) those of one.
            row: (P,) row of each point of the network.

        Raises:
            ValueError: Fewer than 3 places, a depth below 0 or none above, or a row that is not there.
        """
        table = np.atleast_2d(floats(depth, "depth", "(forms, places) depths from bank to bank")).copy()
        if table.ndim != 2 or table.shape[1] < 3 or not len(table):
            raise InputError(f"depth has shape {np.shape(depth)}; give (forms, places), three places or more")
        if not np.isfinite(table).all() or (table < 0.0).any() or not (table.max(axis=1) > 0.0).all():
            raise InputError("depth must be finite and 0 or more, and above 0 somewhere in each form")
        table /= table.max(axis=1)[:, None]
        table.flags.writeable = False
        object.__setattr__(self, "depth", table)
        rows = None
        if row is not None:
            given = floats(row, "row", "one whole number a point")
            if given.ndim != 1 or not np.array_equal(given, np.round(given)):
                raise InputError(f"row has shape {given.shape}; give one whole number a point")
            if len(given) and not (given.min() >= 0 and given.max() < len(table)):
                raise InputError(f"row names {given.min():g} to {given.max():g}; there are {len(table)} forms, from 0")
            rows = given.astype(np.int32)
            rows.flags.writeable = False
        object.__setattr__(self, "row", rows)

    @staticmethod
    @public
    def of(forms: Sequence[Form], row: ArrayLike | None = None, places: int = PLACES) -> SectionTable:
        """Return the table of functions.

        Args:
            forms: Functions of Y, (M,) from 0 at the left bank to 1 at the right one, that return (M,) depths.
            row: (P,) form of each point of the network.
            places: Number of places across.
        """
        y = np.linspace(0.0, 1.0, whole(places, "places", 3, maximum=10_000))
        wrong = next((form for form in forms if not callable(form)), None)
        if wrong is not None:
            raise InputError(f"forms holds {shown(wrong)}, which is no function; give functions of Y")
        tables = [np.broadcast_to(floats(form(y), "a form's depth"), y.shape) for form in forms]
        if not tables:
            raise InputError("forms is empty; give at least one function of Y")
        return SectionTable(np.array(tables), row)

    @property
    def fraction(self) -> FloatArray:
        """(K,) mean depth of each form over its maximum: the area of a section is this times width times depth."""
        mean: FloatArray = 0.5 * (self.depth[:, 1:] + self.depth[:, :-1]).mean(axis=1)
        return mean


def parabola(y: FloatArray) -> FloatArray:
    """Depth of a parabola, 4 Y (1 - Y)."""
    return 4.0 * y * (1.0 - y)


def trapezoid(y: FloatArray, side: float = 0.2) -> FloatArray:
    """Depth of a trapezoid whose sides take up that fraction of the width each."""
    return np.minimum(1.0, np.minimum(y, 1.0 - y) / side)
