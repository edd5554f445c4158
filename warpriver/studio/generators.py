"""Terrains from nothing, with their rivers, as the page offers them: what each asks for, and how it is made."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from warpriver.erosion import erode
from warpriver.errors import InputError
from warpriver.generate import (
    cone,
    erosion_plane,
    fluvial_terrain,
    fractal_terrain,
    intermontane_basin,
    mountain_front,
    mountain_front_line,
    noisy_line,
    read_sample_dem,
    tilted_plain,
)
from warpriver.hydrology import extract_network
from warpriver.network import RiverNetwork
from warpriver.params import MeanderParams
from warpriver.simulation import Simulation
from warpriver.terrain import Terrain
from warpriver.validate import finite, whole
from warpriver.valley import synthetic_valley

__all__ = ["GENERATORS", "Generator", "described", "generated"]

# Cells of a terrain at most: 2048 x 2048.
MOST_CELLS = 2**22
EXAMPLES = ("S1", "S2", "S3", "S4", "S5", "S6")


@dataclasses.dataclass(frozen=True)
class Field:
    """A number, or a word, that a generator asks for.

    Attributes:
        label: Its name on the page.
        value: By default.
        low: Least value.
        high: Greatest value.
        unit: Of the number.
        doc: What it is.
        choices: The words there are; empty for a number.
    """

    label: str
    value: float | str
    low: float = 0.0
    high: float = 0.0
    unit: str = "-"
    doc: str = ""
    choices: tuple[str, ...] = ()

    @property
    def is_whole(self) -> bool:
        """Whether it is a whole number."""
        return isinstance(self.value, int)


@dataclasses.dataclass(frozen=True)
class Generator:
    """A kind of land.

    Attributes:
        title: Its name on the page.
        doc: What it is.
        fields: What it asks for.
        make: Makes a simulation of it.
        seconds: What that takes with the values by default, about.
        powers: By which power of each value it grows.
    """

    title: str
    doc: str
    fields: Mapping[str, Field]
    make: Callable[..., Simulation]
    seconds: float = 0.5
    powers: Mapping[str, float] = dataclasses.field(default_factory=dict)


def _seed(value: int = 1) -> Field:
    return Field("Seed", value, 0, 1_000_000, doc="Another seed, another land")


def _cell(value: float, low: float, high: float) -> Field:
    return Field("Cells", value, low, high, "m", "Side of a cell")


def _area(value: float, low: float = 0.1, high: float = 1000.0) -> Field:
    return Field("Rivers from", value, low, high, "km²", "Drainage area from which a stream is a river")


def _size(value: float, low: float, high: float) -> Field:
    return Field("Size", value, low, high, "km", "Side of the map")


def _relief(value: float, low: float = 10.0, high: float = 5000.0) -> Field:
    return Field("Relief", value, low, high, "m", "Highest less lowest ground")


def _shape(size: float, cell: float) -> tuple[int, int]:
    side = max(8, round(1e3 * size / cell))
    if side * side > MOST_CELLS:
        raise InputError(f"{side} x {side} cells; the studio takes 2048 x 2048: give larger cells or a smaller map")
    return side, side


def _with_rivers(terrain: Terrain, area: float) -> Simulation:
    return Simulation(extract_network(terrain, min_drainage_area=1e6 * area), terrain=terrain)


def _basin(cell: float, seed: int, relief: float, area: float) -> Simulation:
    return _with_rivers(intermontane_basin(cell, seed, relief=relief), area)


def _front(cell: float, seed: int, width: float) -> Simulation:
    line = mountain_front_line(0.5 * width, seed)
    return Simulation(RiverNetwork.from_polylines([line], width=width), terrain=mountain_front(cell, seed))


def _drained(size: float, cell: float, relief: float, concavity: float, seed: int, area: float) -> Simulation:
    return _with_rivers(fluvial_terrain(_shape(size, cell), cell, relief, seed, concavity), area)


def _fractal(size: float, cell: float, relief: float, roughness: float, seed: int, area: float) -> Simulation:
    return _with_rivers(fractal_terrain(_shape(size, cell), cell, relief, seed, roughness), area)


def _plain(length: float, cell: float, slope: float, width: float, wandering: float, seed: int) -> Simulation:
    columns, rows = round(1e3 * length / cell), round(500.0 * length / cell)
    if columns * rows > MOST_CELLS:
        raise InputError(f"{rows} x {columns} cells; give larger cells or a shorter plain")
    terrain = tilted_plain((max(8, rows), max(8, columns)), cell, slope)
    west, south, east, north = terrain.bounds
    line = noisy_line(0.96 * (east - west), 0.5 * width, wandering * width, seed)
    line = line + [west + 0.02 * (east - west), 0.5 * (south + north)]
    return Simulation(RiverNetwork.from_polylines([line], width=width), terrain=terrain)


def _fan(size: float, cell: float, slope: float, count: int, width: float, seed: int) -> Simulation:
    """Rivers that run down a cone to all sides."""
    terrain = cone(_shape(size, cell), cell, slope)
    west, south, east, north = terrain.bounds
    middle, reach = np.array([0.5 * (west + east), 0.5 * (south + north)]), 0.47 * (east - west)
    lines = []
    for k in range(count):
        line = noisy_line(0.9 * reach, 0.5 * width, width, seed + k) + [0.1 * reach, 0.0]
        turn = 2.0 * np.pi * k / count
        turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        lines.append(line @ turned + middle)
    return Simulation(RiverNetwork.from_polylines(lines, width=width), terrain=terrain)


def _eroded(cells: int, cell: float, slope: float, rain: float, seed: int, area: float) -> Simulation:
    start = erosion_plane((cells, cells), cell, slope=slope)
    terrain = erode(start, events=round(rain * cells * cells), seed=seed)
    network = extract_network(terrain, min_drainage_area=1e6 * area, edges=terrain.edges)
    return Simulation(network, terrain=Terrain(terrain.to_numpy(), cell, terrain.origin))


def _valley(example: str) -> Simulation:
    made = synthetic_valley(example)
    width = float(made.network.channel_width.min())
    params = MeanderParams(migration_rate=0.5 * width, spacing_in_widths=1.0)
    return Simulation(made.network, params, terrain=made.terrain)


def _sample(cell: float, area: float) -> Simulation:
    return _with_rivers(read_sample_dem(cell), area)


GENERATORS = {
    "basin": Generator(
        "Basin among mountains", "Mountains on three sides of a plain of 40 x 26 km, with the rivers that drain them.",
        {"cell": _cell(100.0, 25.0, 400.0), "relief": _relief(1200.0), "area": _area(30.0, 1.0), "seed": _seed()},
        _basin, 1.0, {"cell": -2},
    ),
    "front": Generator(
        "Mountain front", "A river that leaves a valley through a canyon for a plain, 35 x 20 km.",
        {"cell": _cell(50.0, 25.0, 250.0), "width": Field("Width", 60.0, 10.0, 300.0, "m", "Width of the river"),
         "seed": _seed(0)},
        _front, 2.0, {"cell": -2},
    ),
    "drained": Generator(
        "Mountains drained by rivers", "Uplift and erosion in balance: every cell drains to the edge.",
        {"size": _size(20.0, 2.0, 200.0), "cell": _cell(50.0, 10.0, 500.0), "relief": _relief(800.0),
         "concavity": Field("Concavity", 0.45, 0.3, 0.6, doc="Exponent of drainage area in the slope of rivers"),
         "area": _area(4.0), "seed": _seed()},
        _drained, 1.5, {"size": 2, "cell": -2},
    ),
    "fractal": Generator(
        "Fractal land", "Rough land that nothing has drained yet; its rivers cross lakes.",
        {"size": _size(20.0, 2.0, 200.0), "cell": _cell(50.0, 10.0, 500.0), "relief": _relief(200.0),
         "roughness": Field("Roughness", 0.4, 0.2, 0.8, doc="Height of an octave over that of the one before"),
         "area": _area(5.0), "seed": _seed()},
        _fractal, 0.5, {"size": 2, "cell": -2},
    ),
    "plain": Generator(
        "One river on a plain", "A tilted plain with a river that has yet to bend.",
        {"length": Field("Length", 20.0, 2.0, 200.0, "km", "Length of the plain"), "cell": _cell(50.0, 5.0, 500.0),
         "slope": Field("Slope", 0.0005, 0.0, 0.05, "m/m", "Fall of the plain, to the east"),
         "width": Field("Width", 60.0, 5.0, 500.0, "m", "Width of the river"),
         "wandering": Field("Wandering", 1.0, 0.1, 10.0, "widths", "How far the river leaves a straight line"),
         "seed": _seed()},
        _plain,
    ),
    "fan": Generator(
        "Cone", "Rivers that run down a cone to all sides.",
        {"size": _size(20.0, 2.0, 100.0), "cell": _cell(50.0, 10.0, 500.0),
         "slope": Field("Slope", 0.004, 0.0005, 0.1, "m/m", "Of the cone"),
         "count": Field("Rivers", 6, 1, 24, doc="How many"),
         "width": Field("Width", 40.0, 5.0, 200.0, "m", "Width of each river"), "seed": _seed()},
        _fan,
    ),
    "eroded": Generator(
        "Plane eroded by rain", "A plane that rain has cut valleys into, after Leheny and Nagel.",
        {"cells": Field("Cells a side", 120, 40, 300, doc="Rows and columns"), "cell": _cell(30.0, 5.0, 200.0),
         "slope": Field("Slope", 0.05, 0.005, 0.3, "m/m", "Of the plane, to the south"),
         "rain": Field("Rain", 3.0, 0.5, 20.0, "a cell", "Units of rain for each cell"),
         "area": _area(0.5, 0.01), "seed": _seed()},
        _eroded, 0.5, {"cells": 3, "rain": 1},
    ),
    "valley": Generator(
        "Synthetic valley", "A river valley of prescribed form, after Brown, Pasternack and Wallender.",
        {"example": Field("Example", "S3", doc="The six valleys of the paper", choices=EXAMPLES)}, _valley,
    ),
    "sample": Generator(
        "Mountains of Tennessee", "A real terrain, 30 x 32 km, from the SRTM.",
        {"cell": _cell(75.0, 50.0, 300.0), "area": _area(8.0)}, _sample, 0.5, {"cell": -2},
    ),
}  # fmt: skip


def described() -> list[dict[str, Any]]:
    """Return what a page needs to ask for each of them."""
    return [
        {
            "name": name, "title": each.title, "doc": each.doc, "seconds": each.seconds, "powers": dict(each.powers),
            "fields": [
                {
                    "name": key, "label": f.label, "unit": f.unit, "doc": f.doc, "value": f.value, "low": f.low,
                    "high": f.high, "whole": f.is_whole, "choices": list(f.choices) or None,
                }
                for key, f in each.fields.items()
            ],
        }
        for name, each in GENERATORS.items()
    ]  # fmt: skip


def generated(recipe: Any) -> Simulation:
    """Return the simulation of a recipe: the name of a generator, and what it asks for.

    Raises:
        ValueError: There is no such generator, or a value is missing or out of its range.
    """
    if not isinstance(recipe, dict) or recipe.get("generator") not in GENERATORS:
        raise InputError(f"a recipe needs the key 'generator': one of {', '.join(GENERATORS)}")
    chosen = GENERATORS[recipe["generator"]]
    if unknown := sorted(set(recipe) - {"generator"} - set(chosen.fields)):
        raise InputError(f"{chosen.title} asks for {', '.join(chosen.fields)}; it has no {str(unknown[0])[:40]!r}")
    values: dict[str, Any] = {}
    for name, field in chosen.fields.items():
        given = recipe.get(name, field.value)
        if field.choices:
            if given not in field.choices:
                raise InputError(f"{field.label} is {str(given)[:40]!r}; give one of {', '.join(field.choices)}")
            values[name] = given
            continue
        value = whole(given, field.label) if field.is_whole else finite(given, field.label, field.unit)
        if not field.low <= value <= field.high:
            raise InputError(f"{field.label} is {value:g}; give {field.low:g} to {field.high:g} {field.unit}")
        values[name] = value
    return chosen.make(**values)
