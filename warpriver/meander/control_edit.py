"""SetControls: a change of controls as an edit, to be taken back, done again and replayed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from warpriver.edits.values import Edit
from warpriver.errors import InputError
from warpriver.meander.control_record import control_of, described
from warpriver.meander.controls import Bounds, Control, checked_controls
from warpriver.validate import whole

__all__ = ["SetControls"]


@dataclasses.dataclass(frozen=True)
class _Kept(Control):
    """Stands for the control that had a place before."""

    place: int

    def bounds(self) -> Bounds:
        """Return none: it is another control that has them."""
        return (0.0, 0.0, 0.0, 0.0)

    def packed(self) -> tuple[dict[str, Any], np.ndarray]:
        """Return the place."""
        return {"kept": self.place}, np.empty(0)


@dataclasses.dataclass(frozen=True)
class SetControls(Edit):
    """Let other controls steer the channels from the next step on.

    Attributes:
        controls: All of them, one or several; none: ``()``. Those of rasters are kept in the history, and in files of
            sessions, with all their cells, unless they were among the controls before.
    """

    controls: tuple[Control, ...] = ()

    def check(self) -> dict[str, Any]:
        """Check the controls; those that were read from a file are made again."""
        given: Any = self.controls
        if isinstance(given, (list, tuple)):
            given = [_control_of(each) if isinstance(each, dict) else each for each in given]
        controls = checked_controls(given, None)
        for control in controls:
            if getattr(control, "raster", None) is None:
                described(control)
        return {"controls": controls}

    def as_json(self) -> dict[str, Any]:
        """Return the controls as words and numbers."""
        return {"edit": self.name, "controls": [described(control) for control in self.controls]}

    def told_after(self, before: Sequence[Control]) -> SetControls:
        """Return the same edit where these controls hold before: rasters among them that stay are told by their place.

        Args:
            before: Controls that the edit takes the place of.
        """
        places = {id(control): place for place, control in enumerate(before)}
        return SetControls(
            tuple(
                _Kept(places[id(c)]) if getattr(c, "raster", None) is not None and id(c) in places else c
                for c in self.controls
            )
        )

    def after(self, before: Sequence[Control]) -> tuple[Control, ...]:
        """Return the controls where those before are ``before``.

        Raises:
            ValueError: One is to stay that was not there.
        """
        for control in self.controls:
            if isinstance(control, _Kept) and control.place >= len(before):
                raise InputError(f"control {control.place} is to stay, and there are {len(before)}; give it in full")
        return tuple(before[c.place] if isinstance(c, _Kept) else c for c in self.controls)


def _control_of(values: dict[str, Any]) -> Control:
    return _Kept(whole(values["kept"], "kept")) if "kept" in values else control_of(values)
