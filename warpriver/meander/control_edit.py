"""SetControls: a change of controls as an edit, to be taken back, done again and replayed."""

from __future__ import annotations

import dataclasses
from typing import Any

from warpriver.edits.values import Edit
from warpriver.errors import InputError
from warpriver.meander.control_record import control_of, described
from warpriver.meander.controls import Control, checked_controls

__all__ = ["SetControls"]


@dataclasses.dataclass(frozen=True)
class SetControls(Edit):
    """Let other controls steer the channels from the next step on.

    Attributes:
        controls: All of them, one or several; none: ``()``. Those of rasters are kept in the history, and in files of
            sessions, with all their cells.
    """

    controls: tuple[Control, ...] = ()

    def check(self) -> dict[str, Any]:
        """Check the controls; those that were read from a file are made again."""
        given: Any = self.controls
        if isinstance(given, (list, tuple)):
            given = [control_of(each) if isinstance(each, dict) else each for each in given]
        controls = checked_controls(given, None)
        for control in controls:
            described(control)
        return {"controls": controls}

    def as_json(self) -> dict[str, Any]:
        """Return the controls as words and numbers."""
        return {"edit": self.name, "controls": [described(control) for control in self.controls]}

    @property
    def has_rasters(self) -> bool:
        """Whether any of the controls is a raster."""
        return any(getattr(control, "raster", None) is not None for control in self.controls)


def refuse_untold(events: Any) -> None:
    """Raise ``ValueError`` for a run whose controls were changed by other means than edits."""
    told = list(events)
    for event, following in zip(told, [*told[1:], None], strict=True):
        if event.kind == "control_stroke" or (
            event.kind == "control_change" and getattr(following, "name", "") != SetControls.name
        ):
            raise InputError(
                f"the controls of the run were painted or set at {event.time:g} yr, which its edits do not tell; set "
                "fields by SetControls, and set them anew once they are painted"
            )
