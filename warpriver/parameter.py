"""How constants of processes are declared: a field states its unit, range and source, and values are checked."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, TypeVar

import numpy as np

from warpriver.errors import InputError
from warpriver.validate import real, shown

__all__ = ["Params", "describe", "parameter", "part"]

P = TypeVar("P", bound="Params")


def parameter(
    default: Any,
    unit: str,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    low_open: bool = False,
    choices: tuple[Any, ...] = (),
    source: str,
    doc: str,
) -> Any:
    """Declare one constant of a process: a dataclass field that knows its unit, range, source and meaning.

    Args:
        default: Value used when none is given; None where it follows from the network.
        unit: Unit at the API, for example ``"m/yr"``; ``"-"`` for a pure number.
        low: Least value allowed.
        high: Greatest value allowed.
        low_open: True when ``low`` itself is refused.
        choices: Allowed values, for a field that takes one of a few.
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


def part(kind: type[Params], default: Params | None = None, *, source: str, doc: str) -> Any:
    """Declare the constants of a process that may be left out: a field of that class, or None.

    Args:
        kind: Their class.
        default: Those used when none are given; None: without the process.
        source: As of ``parameter``.
        doc: One sentence for help texts.
    """
    metadata = {"unit": "-", "choices": (), "kind": kind, "source": source, "doc": doc}
    return dataclasses.field(default=default, metadata=metadata)


def describe(params: type) -> list[tuple[str, Any, str, str, str]]:
    """List a parameter class as rows (name, default, unit, source, meaning), for help texts and documents."""
    return [
        (f.name, f.default, f.metadata["unit"], f.metadata["source"], f.metadata["doc"])
        for f in dataclasses.fields(params)
    ]


@dataclasses.dataclass(frozen=True)
class Params:
    """What all constants of a process can do: they are checked when they are made, and changed in copies."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value, label = getattr(self, field.name), f"{type(self).__name__}.{field.name}"
            kind = field.metadata.get("kind")
            if kind is not None and (isinstance(value, dict) or value is False):
                # As files hold it; false leaves the process out.
                value = kind(**value) if isinstance(value, dict) else None
                object.__setattr__(self, field.name, value)
            if field.metadata:
                _check_constant(value, label, field)
            elif field.type in ("bool", bool) and not isinstance(value, bool):
                raise InputError(f"{label} is {shown(value)}; give true or false")

    def replace(self: P, **changes: Any) -> P:
        """Return a copy with some fields changed (and checked again)."""
        return dataclasses.replace(self, **changes)

    def for_widths(self: P, channel_width: np.ndarray) -> P:
        """Return the constants for a network: defaults that follow from the widths of its channels are filled in."""
        return self


def _check_constant(value: Any, label: str, field: dataclasses.Field[Any]) -> None:
    """Raise ``ValueError`` unless a value lies in the range that its field declares."""
    meta = field.metadata
    kind = meta.get("kind")
    if value is None and (field.default is None or kind is not None):
        return
    if kind is not None:
        if not isinstance(value, kind):
            raise InputError(f"{label} is {value!r}; give {kind.__name__}(...) or None")
        return
    if meta["choices"]:
        if not isinstance(value, (str, int)) or value not in meta["choices"]:
            words = ", ".join(repr(c) for c in meta["choices"])
            raise InputError(f"{label} is {shown(value)}; use one of {words}")
        return
    if math.isnan(real(value)):
        raise InputError(f"{label} is {shown(value)}; give a finite number of unit {meta['unit']}, from 1e-30 to 1e30")
    below = value <= meta["low"] if meta["low_open"] else value < meta["low"]
    if below or value > meta["high"]:
        left = "(" if meta["low_open"] else "["
        raise InputError(f"{label} is {value:g} {meta['unit']}; the range is {left}{meta['low']:g}, {meta['high']:g}]")
    if isinstance(field.default, int) and value != int(value):
        raise InputError(f"{label} is {value:g}; give a whole number")
