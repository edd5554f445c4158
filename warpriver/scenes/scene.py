"""A scene as a value, which makes its simulation, runs it and writes what is to be written."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from warpriver.errors import InputError, OutputExistsError, WrongPathError
from warpriver.history import History, StopReason
from warpriver.io.raster.terrains import write_terrain
from warpriver.io.tables import raising
from warpriver.meander.control_edit import SetControls
from warpriver.meander.controls import Control
from warpriver.params import MeanderParams, PathMeander
from warpriver.scenes.outputs import write_outputs
from warpriver.scenes.parts import START, GroundSource, Outputs, RiverSource, RunPlan, TimedControl, TimedEdit
from warpriver.simulation import Simulation
from warpriver.terrain import TerrainFile

__all__ = ["Scene"]


@dataclasses.dataclass(frozen=True)
class Scene:
    """Terrain, rivers, constants, controls, edits and outputs of a run; :func:`read_scene` reads one from a file.

    The same scene gives the same bits, those of the same calls in Python.

    Attributes:
        name: Name of the scene.
        network: Where the rivers come from.
        params: Constants of the model.
        run_plan: How long, how often recorded, the seed.
        terrain: Where the ground comes from, or None for a plain.
        controls: Controls, and when they work.
        edits: Edits, and when they are done, in order.
        outputs: What is written.
        path: File that it was read from, or None.
        systems: Where lines of controls, edits and channels come from files, and the CRS of these.
    """

    name: str
    network: RiverSource
    params: MeanderParams | PathMeander
    run_plan: RunPlan
    terrain: GroundSource | None = None
    controls: tuple[TimedControl, ...] = ()
    edits: tuple[TimedEdit, ...] = ()
    outputs: Outputs = dataclasses.field(default_factory=Outputs)
    path: Path | None = None
    systems: tuple[tuple[str, str], ...] = ()

    @property
    def years(self) -> float:
        """Length of the run, yr."""
        return self.run_plan.steps * self.params.time_step

    def simulation(
        self, *, device: Any = "cpu", threads: int | None = None, folder: str | os.PathLike[str] | None = None
    ) -> Simulation:
        """Make the terrain and the network, and prepare the run, at its beginning.

        Args:
            device: Warp device.
            threads: Threads on the CPU, in place of those of the scene.
            folder: Folder of the results, where a stored run finds the ground that it began with; see
                :meth:`write_start`.

        Raises:
            ValueError: Terrain, network or controls cannot be made; where they stand in the scene is named.
            OSError: A file cannot be read.
        """
        terrain = None if self.terrain is None else self.terrain.make(device)
        start = None if folder is None else self.start(Path(folder))
        if terrain is not None and start is not None:
            terrain.file = TerrainFile(str(start.resolve()))
        network = self.network.make(terrain, self.run_plan.dtype, device)
        for where, crs in self.systems:
            if network.crs is not None and crs != network.crs:
                raise InputError(f"{where} has the CRS {crs}, the rivers {network.crs}; reproject it")
        make = functools.partial(
            Simulation,
            network,
            self.params,
            terrain=terrain,
            seed=self.run_plan.seed,
            check=self.run_plan.check,
            threads=threads or self.run_plan.threads,
            controls=self.controls_at(0),
        )
        simulation: Simulation = raising(self.label, make, {})
        return simulation

    def controls_at(self, step: int) -> tuple[Control, ...]:
        """Return the controls that work from a step on."""
        return tuple(
            each.control
            for each in self.controls
            if self.step_at(each.begin) <= step and (each.end is None or step < self.step_at(each.end))
        )

    def step_at(self, time: float) -> int:
        """Return the number of steps after which what is planned for a time happens: the first at or after it."""
        return first_step(time, self.params.time_step)

    def play(
        self,
        simulation: Simulation,
        *,
        store: str | os.PathLike[str] | None = None,
        callbacks: Sequence[Any] = (),
        progress: bool = False,
    ) -> History:
        """Run a simulation of this scene from where it is to the end, with controls and edits at their times.

        Controls that change between the same two steps as edits do so before them.

        Args:
            simulation: One that :meth:`simulation` made.
            store: Folder to stream the history into.
            callbacks: As those of :meth:`Simulation.run`.
            progress: Show a bar on standard error.

        Raises:
            ValueError: An edit cannot be done; what was run before it is kept.
        """
        history, plan = simulation.history, self.run_plan
        for step in sorted({plan.steps, *self._cues()}):
            if step < simulation.step_count:
                continue
            if step > simulation.step_count or step == plan.steps:
                history = simulation.run(
                    steps=step - simulation.step_count,
                    record_every=plan.record_every,
                    store=store,
                    callbacks=callbacks,
                    progress=progress,
                )
                if history.stop_reason is not StopReason.COMPLETED:
                    break
            self._act(simulation, step)
        return history

    def _cues(self) -> list[int]:
        """Steps after which something is done."""
        times = [time for each in self.controls for time in (each.begin, each.end) if time is not None]
        steps = [self.step_at(time) for time in times] + [each.step for each in self.edits]
        return [step for step in steps if step <= self.run_plan.steps]

    def _act(self, simulation: Simulation, step: int) -> None:
        wanted = self.controls_at(step)
        if step > 0 and [*map(id, wanted)] != [*map(id, self.controls_at(step - 1))]:
            simulation.apply(SetControls(wanted))
        for each in self.edits:
            if each.step == step:
                try:
                    simulation.apply(each.edit)
                except InputError as error:
                    raise type(error)(
                        f"{each.where} ({each.edit.name}), after {step} steps: {error}; what ran before it is kept"
                    ) from error

    def run(
        self,
        folder: str | os.PathLike[str] | None = None,
        *,
        device: Any = "cpu",
        threads: int | None = None,
        progress: bool = False,
    ) -> History:
        """Run the scene from its beginning to its end, and write its outputs.

        Args:
            folder: Folder of the results, which is made; without one nothing is written.
            device: Warp device.
            threads: Threads on the CPU, in place of those of the scene.
            progress: Show a bar on standard error.

        Raises:
            ValueError: Something of the scene cannot be made or done; where it stands is named.
            OSError: The folder holds results already, or cannot be written to.
        """
        place = None if folder is None else self.check_folder(folder)
        simulation = self.simulation(device=device, threads=threads, folder=place)
        if place is not None:
            place.mkdir(parents=True, exist_ok=True)
            self.write_start(simulation, place)
        history = self.play(simulation, store=self.store(place), progress=progress)
        if place is not None:
            self.write(simulation, place)
        return history

    def store(self, folder: Path | None) -> Path | None:
        """Return where the run is stored in a folder of results, None where it is not."""
        return folder / "run" if folder is not None and self.outputs.run else None

    def start(self, folder: Path) -> Path | None:
        """Return where the ground that the run begins with is kept; None where the run needs none, or has a file."""
        made = self.terrain is not None and (self.terrain.file is None or len(self.terrain.brushes) > 0)
        return folder / START if made and self.outputs.run else None

    def write_start(self, simulation: Simulation, folder: str | os.PathLike[str]) -> None:
        """Write the ground of a simulation before it is run, so that the stored run can go on over it."""
        start = self.start(Path(folder))
        if start is not None and simulation.terrain is not None:
            write_terrain(simulation.terrain, start)

    def write(self, simulation: Simulation, folder: str | os.PathLike[str]) -> list[Path]:
        """Write what is to be written of a simulation that was run, but for the run itself; return the files."""
        return write_outputs(self.outputs, simulation, self.controls, Path(folder), self.label)

    def check_folder(self, folder: str | os.PathLike[str]) -> Path:
        """Return a folder for the results as a path; one that holds some of them already is refused."""
        place = Path(folder)
        start = self.start(place)
        for name in (*self.outputs.names(), *([] if start is None else [start.name])):
            if (place / name).exists():
                raise OutputExistsError(f"{place} holds an earlier {name}; remove it, or choose another folder")
        if place.exists() and not place.is_dir():
            raise WrongPathError(f"{place} is a file; give the name of a folder")
        return place

    @property
    def label(self) -> str:
        """The scene in messages: its file, or its name."""
        return str(self.path or self.name)

    def __repr__(self) -> str:
        parts = [f"{self.run_plan.steps} steps, {self.years:.4g} yr"]
        parts += [_counted(self.controls, "control"), _counted(self.edits, "edit")]
        return f"Scene({self.name!r}: {', '.join(part for part in parts if part)})"


def first_step(time: float, time_step: float) -> int:
    """Return the number of steps at the end of which a time is reached."""
    # With the slack of Simulation.run(years=...), so that both count alike.
    return max(0, math.ceil(time / time_step * (1.0 - 1e-12)))


def _counted(things: Sequence[Any], name: str) -> str:
    return f"{len(things)} {name}{'s' if len(things) != 1 else ''}" if things else ""
