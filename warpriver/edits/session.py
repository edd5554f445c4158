"""Sessions: the edits of a run in a file, with its seed, to be replayed."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from warpriver.edits.values import Edit, edit_of
from warpriver.errors import InputError, MissingFileError, PathError
from warpriver.files import beside
from warpriver.public import public
from warpriver.validate import shown, whole

__all__ = ["Session", "read_edits", "write_edits"]

FORMAT = "warpriver-edits-1"


@dataclasses.dataclass(frozen=True)
class Session:
    """The edits of a run, each with the number of steps that were done before it.

    Attributes:
        edits: (step, edit), in order.
        seed: Seed of the run.
        steps: Steps that it did in all.
    """

    edits: tuple[tuple[int, Edit], ...]
    seed: int = 0
    steps: int = 0

    def __post_init__(self) -> None:
        edits = _pairs(self.edits)
        steps = [step for step, _ in edits]
        if steps != sorted(steps):
            raise InputError(
                f"the steps of the edits are {shown(steps)}; give the edits in the order in which they are done"
            )
        object.__setattr__(self, "edits", edits)
        object.__setattr__(self, "seed", whole(self.seed, "seed"))
        object.__setattr__(self, "steps", max([whole(self.steps, "steps"), *steps]))


@public
def write_edits(path: str | os.PathLike[str], edits: object, *, seed: int = 0, steps: int = 0) -> None:
    """Write a session to a JSON file.

    Args:
        path: The file, which is replaced.
        edits: A :class:`Session`, a history, a simulation, a riverscape, or (step, edit) pairs.
        seed: Seed of the run, where pairs are given.
        steps: Steps that it did, where pairs are given.

    Raises:
        OSError: The file cannot be written.
        ValueError: What is given holds no edits.
    """
    session = session_of(edits, seed, steps)
    listed = [{"step": step} | edit.as_json() for step, edit in session.edits]
    values = {"format": FORMAT, "seed": session.seed, "steps": session.steps}
    head = json.dumps(values)[:-1]
    lines = ",\n  ".join(json.dumps(each) for each in listed)
    text = f'{head}, "edits": [\n  {lines}\n]}}\n' if listed else f'{head}, "edits": []}}\n'
    with beside(Path(path)) as temporary:
        temporary.write_text(text, encoding="utf-8")


@public
def read_edits(path: str | os.PathLike[str]) -> Session:
    """Read a session from a JSON file.

    Raises:
        FileNotFoundError: Nothing is there.
        ValueError: It is no session, or one of its edits is none.
    """
    source = Path(path)
    if not source.exists():
        raise MissingFileError(f"no session at {source}")
    try:
        text = source.read_text(encoding="utf-8")
    except OSError as error:
        raise PathError.of(error, f"cannot read {source}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{source} is no session: {error}") from error
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source} is no session: it is no JSON ({error})") from error
    if not isinstance(values, dict) or values.get("format") != FORMAT or not isinstance(values.get("edits"), list):
        raise InputError(f"{source} is no session: it needs the format {FORMAT!r} and a list of edits")
    edits = []
    for number, told in enumerate(values["edits"]):
        try:
            fields = dict(told)
            step = whole(fields.pop("step", None), "step")
            edits.append((step, edit_of(fields)))
        except (InputError, TypeError, ValueError) as error:
            raise InputError(f"{source}, edit {number}: {error}") from error
    try:
        return Session(tuple(edits), values.get("seed", 0), values.get("steps", 0))
    except InputError as error:
        raise InputError(f"{source}: {error}") from error


def session_of(edits: object, seed: int = 0, steps: int = 0) -> Session:
    """Return the session of a run: of itself, of a history or a simulation, of (step, edit) pairs, or of a file."""
    if isinstance(edits, Session):
        return edits
    if isinstance(edits, (str, os.PathLike)):
        return read_edits(edits)
    history: Any = getattr(edits, "history", edits)
    applied = getattr(history, "edits", None)
    if isinstance(applied, tuple) and all(isinstance(each, Edit) for each in applied):
        # Of a scene, which has no steps.
        return Session(_pairs(applied), getattr(history, "seed", seed))
    if applied is not None:
        done = getattr(edits, "step_count", int(history.steps[-1]) if len(history) else 0)
        return Session(_pairs(applied), history.seed, done)
    return Session(_pairs(edits), seed, steps)


def _pairs(edits: object) -> tuple[tuple[int, Edit], ...]:
    """(step, edit) of pairs, or of events of a history."""
    pairs: list[tuple[int, Edit]] = []
    listed: Iterable[Any] = edits if isinstance(edits, Iterable) else [edits]
    for each in listed:
        pair = (each.step, each.edit) if isinstance(getattr(each, "edit", None), Edit) else each
        pair = (0, pair) if isinstance(pair, Edit) else pair
        if not isinstance(pair, Sequence) or isinstance(pair, (str, bytes)) or len(pair) != 2:
            raise InputError(f"{shown(each)} is no (step, edit) pair; give a list of them, a history or a Session")
        if not isinstance(pair[1], Edit):
            raise InputError(f"{shown(pair[1])} is no edit; make one of warpriver.edits")
        pairs.append((whole(pair[0], "step of an edit"), pair[1]))
    return tuple(pairs)
