"""What a scene is made of, as values: where its ground and its rivers come from, what happens when, what is written."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from warpriver import generate
from warpriver.arrays import FloatArray
from warpriver.edits.ground import edit_terrain
from warpriver.edits.values import Edit, EditTerrain
from warpriver.errors import InputError
from warpriver.history import Every
from warpriver.hydrology.extraction import extract_network
from warpriver.io.raster.terrains import read_terrain
from warpriver.io.tables import raising
from warpriver.io.vector.networks import read_network
from warpriver.meander.controls import Control
from warpriver.meander.junctions import shape_junctions
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain

__all__ = [
    "START",
    "GroundSource",
    "Line",
    "Outputs",
    "Picture",
    "RiverSource",
    "RunPlan",
    "TimedControl",
    "TimedEdit",
    "line_generators",
    "terrain_generators",
]


# Where a stored run keeps the ground that it began with, if no other file holds that.
START = "start.npz"


def terrain_generators() -> dict[str, Callable[..., Terrain]]:
    """Return the functions of ``warpriver.generate`` that make a terrain, by name."""
    return _generators("Terrain")


def line_generators() -> dict[str, Callable[..., FloatArray]]:
    """Return the functions of ``warpriver.generate`` that make a line, by name."""
    return _generators("FloatArray")


def _generators(returned: str) -> dict[str, Callable[..., Any]]:
    functions = {name: getattr(generate, name) for name in generate.__all__}
    return {
        name: function
        for name, function in functions.items()
        if inspect.signature(function).return_annotation == returned
    }


@dataclasses.dataclass(frozen=True)
class GroundSource:
    """Where the ground of a scene comes from: a file or a generator, and what is done to it before the run.

    Attributes:
        where: File and key, for messages.
        file: The file, or None.
        generator: Name of a function of ``warpriver.generate``, or None.
        arguments: Arguments of ``read_terrain`` or of the generator.
        brushes: Edits of the ground, in order.
    """

    where: str
    file: Path | None = None
    generator: str | None = None
    arguments: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    brushes: tuple[EditTerrain, ...] = ()

    def make(self, device: Any = "cpu") -> Terrain:
        """Read or make the ground.

        Raises:
            ValueError: It cannot be made; where it stands in the scene is named.
        """
        if self.file is not None:
            terrain = raising(self.where, lambda: read_terrain(self.file, device=device, **self.arguments), {})  # type: ignore[arg-type]
        else:
            function = terrain_generators()[str(self.generator)]
            terrain = raising(self.where, lambda: function(**self.arguments, device=device), {})
        for number, brush in enumerate(self.brushes):
            raising(f"{self.where}.brush[{number}]", functools.partial(edit_terrain, terrain, brush), {})
        return terrain


@dataclasses.dataclass(frozen=True, eq=False)
class Line:
    """A channel that stands in a scene.

    Attributes:
        xy: (n, 2) points in m, downstream.
        width: Bankfull width, m.
        depth: Bankfull depth in m, None where it follows from the width.
        discharge: Bankfull discharge in m3/s, None where it follows from the width.
        closed: Whether it is a ring.
        about: How it was given, for people.
    """

    xy: FloatArray
    width: float
    depth: float | None = None
    discharge: float | None = None
    closed: bool = False
    about: str = ""


@dataclasses.dataclass(frozen=True)
class RiverSource:
    """Where the rivers of a scene come from: a file, the terrain, or lines.

    Attributes:
        where: File and key, for messages.
        file: The file, or None.
        extracted: Whether they are found on the terrain.
        arguments: Arguments of ``read_network`` or ``extract_network``.
        lines: Channels that stand in the scene.
        crs: Coordinate reference system of the lines.
        shaped: Whether tributaries get the angle that fits their flows, see ``shape_junctions``.
    """

    where: str
    file: Path | None = None
    extracted: bool = False
    arguments: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    lines: tuple[Line, ...] = ()
    crs: str | None = None
    shaped: bool = False

    def make(self, terrain: Terrain | None, dtype: Any = "float64", device: Any = "cpu") -> RiverNetwork:
        """Read, find or build the network.

        Raises:
            ValueError: It cannot be made; where it stands in the scene is named.
        """
        options = {"dtype": dtype, "device": device}
        network: RiverNetwork = raising(self.where, lambda: self._made(terrain, options), {})
        return shape_junctions(network) if self.shaped else network

    def _made(self, terrain: Terrain | None, options: Mapping[str, Any]) -> RiverNetwork:
        if self.file is not None:
            return read_network(self.file, **self.arguments, **options)
        if self.extracted:
            if terrain is None:
                raise InputError("the rivers are to be found on a terrain, and there is none; give [terrain]")
            return extract_network(terrain, **self.arguments, **options)
        lines = tuple(map(_densified, self.lines)) if self.shaped else self.lines
        return _network_of(lines, self.crs, options)


def _densified(line: Line) -> Line:
    """The line with a point every quarter of a width or closer, so that its last reach can be bent."""
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line.xy, axis=0).T))])
    parts = np.maximum(1, np.ceil(np.diff(arc) / (0.25 * line.width))).astype(int)
    # The points themselves stay.
    places = [arc[k] + (arc[k + 1] - arc[k]) * np.arange(count) / count for k, count in enumerate(parts)]
    at = np.concatenate([*places, arc[-1:]])
    return dataclasses.replace(line, xy=np.column_stack([np.interp(at, arc, line.xy[:, axis]) for axis in (0, 1)]))


def _network_of(lines: tuple[Line, ...], crs: str | None, options: Mapping[str, Any]) -> RiverNetwork:
    """A network of lines; depths and discharges follow from the widths of those that lack them."""
    from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge

    return RiverNetwork.from_polylines(
        [line.xy for line in lines],
        width=[line.width for line in lines],
        depth=[float(bankfull_depth(line.width)) if line.depth is None else line.depth for line in lines],
        discharge=[
            float(bankfull_discharge(line.width)) if line.discharge is None else line.discharge for line in lines
        ],
        closed=[line.closed for line in lines],
        crs=crs,
        **options,
    )


@dataclasses.dataclass(frozen=True)
class TimedControl:
    """A control, and when it works.

    Attributes:
        control: The control.
        begin: yr.
        end: yr, None for the end of the run.
    """

    control: Control
    begin: float = 0.0
    end: float | None = None


@dataclasses.dataclass(frozen=True)
class TimedEdit:
    """An edit, and the number of steps after which it is done.

    Attributes:
        step: Steps that are done before it.
        edit: The edit.
        where: File and key, for messages.
    """

    step: int
    edit: Edit
    where: str


@dataclasses.dataclass(frozen=True)
class RunPlan:
    """How a scene is run.

    Attributes:
        steps: Steps in all.
        record_every: When the state is recorded.
        seed: Seed of the random numbers.
        threads: Threads on the CPU; None for one a core.
        dtype: Precision, "float64" or "float32".
        check: Whether every phase of every step is checked.
    """

    steps: int
    record_every: Every = dataclasses.field(default_factory=lambda: Every(steps=10))
    seed: int = 0
    threads: int | None = None
    dtype: str = "float64"
    check: bool = False


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture or a movie of a run.

    Attributes:
        file: Its name.
        of: "belt", "before_after", "network", "movie" or "preview".
        relief: Whether the ground is drawn.
        controls: Whether the outlines of the controls are drawn that work at that time.
        until: Time that is shown, yr; None for the end.
        options: Arguments of the function of ``warpriver.viz`` that draws it.
    """

    file: str
    of: str = "belt"
    relief: bool = True
    controls: bool = False
    until: float | None = None
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Outputs:
    """What is written of a run, each into the folder of the results.

    Attributes:
        run: Whether the run itself is stored, in the folder "run".
        lines: File of the rivers at the end, or None.
        gis: File of rivers, courses, oxbow lakes and abandoned courses, or None.
        layers: Which of these, beside the rivers; None for all.
        terrain: File of the ground at the end, or None.
        session: File of the edits, or None.
        pictures: Pictures and movies.
    """

    run: bool = True
    lines: str | None = None
    gis: str | None = None
    layers: tuple[str, ...] | None = None
    terrain: str | None = None
    session: str | None = None
    pictures: tuple[Picture, ...] = ()

    def names(self) -> list[str]:
        """Return the names of all that is written."""
        files = [self.lines, self.gis, self.terrain, self.session, *(picture.file for picture in self.pictures)]
        return [*(["run"] if self.run else []), *(name for name in files if name is not None)]
