"""What the folder of a session holds, how it begins, and how the session is taken up from it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from warpriver.io import read_terrain, write_terrain
from warpriver.simulation import Simulation
from warpriver.studio.author import Author, Checkpoint
from warpriver.studio.figures import FIGURES
from warpriver.studio.journal import read_journal

__all__ = [
    "CHECKED",
    "CHECKPOINT",
    "EDITS",
    "KEPT",
    "RUN",
    "SAVED",
    "TERRAIN",
    "begin_folder",
    "copy_session",
    "read_checkpoint",
    "taken_up",
]

# What a session's folder holds: the run at its beginning, the ground that it began with, its edits, and the run at a
# later time, from which it is taken up sooner, with the sum of the edits up to there.
RUN, TERRAIN, EDITS, SAVED = "run", "terrain.npz", "edits.log", "saved"
CHECKPOINT, CHECKED = "checkpoint", "checkpoint.json"
KEPT = (RUN, TERRAIN, EDITS, CHECKPOINT, CHECKED, FIGURES)


def begin_folder(folder: Path, simulation: Simulation) -> None:
    """Write what a session begins with: a run of one record, and its ground."""
    folder.mkdir(parents=True, exist_ok=True)
    if simulation.terrain is not None:
        write_terrain(simulation.terrain, folder / TERRAIN)
    simulation.history.save(folder / RUN)


def copy_session(source: Path, target: Path) -> None:
    """Put a session from one folder into another, in place of what that held."""
    target.mkdir(parents=True, exist_ok=True)
    for name in KEPT:
        old, new = target / name, source / name
        if old.is_dir():
            shutil.rmtree(old)
        else:
            old.unlink(missing_ok=True)
        if new.is_dir():
            shutil.copytree(new, old)
        elif new.exists():
            shutil.copy2(new, old)


def taken_up(folder: Path, begun: Callable[[Author], None]) -> tuple[Author, str | None]:
    """Return the session of a folder, with the edits and steps that it has, and a word on what is missing of them.

    Args:
        folder: Folder of the session.
        begun: Called with the session as it stood at its beginning.
    """
    ground = folder / TERRAIN
    terrain = read_terrain(ground) if ground.exists() else None
    author = Author(Simulation.replay(folder / RUN, [], steps=0, terrain=terrain))
    begun(author)
    word = None
    if (folder / EDITS).exists():
        entries, seed, steps, word = read_journal(folder / EDITS)
        author.take_up(entries, seed, steps, read_checkpoint(folder))
    return author, word


def read_checkpoint(folder: Path) -> Checkpoint | None:
    """Return the checkpoint of a folder, None where there is none, or where it cannot be read."""
    try:
        told = json.loads((folder / CHECKED).read_text())
        forgotten = {str(kind): int(count) for kind, count in told.get("forgotten", {}).items()}
        return Checkpoint(folder / CHECKPOINT, int(told["edits"]), int(told["steps"]), str(told["digest"]), forgotten)
    except (OSError, LookupError, TypeError, ValueError, AttributeError):
        return None
