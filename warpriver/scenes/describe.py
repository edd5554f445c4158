"""Scenes and their keys as text."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from warpriver.hydrology.extraction import extract_network
from warpriver.io.raster.terrains import read_terrain
from warpriver.io.tables import describe_fields, shown
from warpriver.io.vector.networks import read_network
from warpriver.meander.controls import Control, ControlField, RateControl
from warpriver.params import SOLVER_PARAMS, MeanderParams
from warpriver.public import public
from warpriver.scenes.output_tables import OUTPUT, PICTURE
from warpriver.scenes.outputs import PICTURES, picture_options
from warpriver.scenes.parts import Line, line_generators, terrain_generators
from warpriver.scenes.reading import CONTROLS, PLAN, TABLES, edit_names, file_arguments
from warpriver.scenes.scene import Scene

__all__ = ["describe_scene", "scene_schema"]

# Constants of processes that may be left out, a table each.
PARTS = {f.name: f.metadata["kind"] for f in dataclasses.fields(MeanderParams) if "kind" in f.metadata}
# Tables of which there may be several.
LISTED = ("control", "edit")
CHANNEL = {
    "points": ("(none)", "m", "[[x, y], ...], downstream; or give file or generate"),
    "file": ("(none)", "", "file of lines beside the scene, and channel, the number of one of them (0)"),
    "generate": ("(none)", "", "name of a function that makes a line, whose arguments stand beside it; see below"),
    "width": ("(needed)", "m", "bankfull width"),
    "depth": ("(from width)", "m", "bankfull depth"),
    "discharge": ("(from width)", "m3/s", "bankfull discharge"),
    "closed": ("false", "-", "a ring, in which the water goes round"),
    "turn": ("0", "deg", "turn the line about its zero, to the left"),
    "offset": ("[0, 0]", "m", "move the line"),
}


def scene_schema() -> str:
    """Return the keys of a scene as text: name, default, unit and meaning, a line each."""
    return "\n".join(row.rstrip() for part in _parts() for row in part)


def _parts() -> Iterator[list[str]]:
    """The parts of the schema, each a head and its keys."""
    beside = _row("file", "(none)", "", "file beside the scene")
    yield ["# A scene is a TOML file. Files that it names lie in its folder or below."]
    yield [_row("name", "(the file's)", "", "name of the scene")]
    yield [_row(f"[[{key}]]" if key in LISTED else f"[{key}]", "", "", doc) for key, doc in TABLES.items()]
    yield _headed("[terrain]: file, or generate, the name of a function of warpriver.generate", beside)
    yield _arguments(read_terrain)
    for name, function in terrain_generators().items():
        yield _headed(f'generate = "{name}": {_summary(function)}', *_arguments(function))
    yield _headed("[[terrain.brush]]: what is done to the ground before the run, by the keys of the edit EditTerrain")
    yield _headed("[network]: file, or extract, or channel")
    yield [_row("shape_junctions", "false", "", "give tributaries the angle that fits their flows, before the run")]
    yield _headed("[network] with file: lines beside the scene", beside, *_arguments(read_network))
    yield _headed("[network.extract]: rivers of the terrain", *_arguments(extract_network))
    yield _headed("[[network.channel]]: a channel each; ends that meet are joined; crs of [network] is theirs")
    yield [_row(key, *texts) for key, texts in CHANNEL.items()]
    for name, line in line_generators().items():
        yield _headed(f'generate = "{name}": {_summary(line)}', *_arguments(line))
    yield from _parts_of_params()
    yield from _parts_of_changes()
    yield _headed("[run]", *(_row(key, *texts) for key, texts in PLAN.items()))
    yield _headed("[output]: names of files in the folder of the results")
    yield [_row(key, default, "", doc) for key, (default, doc) in OUTPUT.items()]
    yield _headed("[[output.picture]]", *(_row(key, "", "", doc) for key, doc in PICTURE.items()))
    yield [_row(f"of = {of}", "", "", f"further keys: {', '.join(picture_options(of))}") for of in PICTURES]


def _parts_of_params() -> Iterator[list[str]]:
    solvers = _row("solver", "migration", "", f"what moves the channels: {', '.join(SOLVER_PARAMS)}")
    preset = "default, or paper: Table 1 of the paper; further keys change single constants"
    yield _headed("[params]", solvers, _row("preset", "default", "", preset))
    for name, kind in SOLVER_PARAMS.items():
        yield _headed(f'[params] with solver = "{name}"', *describe_fields(kind))
    for name, part in PARTS.items():
        yield _headed(f"[params.{name}], or {name} = false: {_summary(part)}", *describe_fields(part))


def _parts_of_changes() -> Iterator[list[str]]:
    yield _headed("[[control]]", _row("kind", "(needed)", "", f"one of {', '.join(CONTROLS)}"))
    yield [_row("from", "0", "yr", "when it begins to work"), _row("until", "(the end)", "yr", "when it ceases to")]
    for name, control in CONTROLS.items():
        yield _headed(f'kind = "{name}": {_summary(control)}', *_control_keys(control))
    yield _headed("[[edit]]", _row("kind", "(needed)", "", f"one of {', '.join(edit_names())}"))
    yield [_row("time", "(needed)", "yr", "done between two steps, at the end of the first that reaches this time")]
    for name, edit in edit_names().items():
        rows = _documented(edit)
        if {"xy", "line"} & {field.name for field in dataclasses.fields(edit)}:
            rows.append(_row("file", "(none)", "", "file of lines in place of the points; channel_of_file: which one"))
        yield _headed(f'kind = "{name}": {_summary(edit)}', *rows)
    yield _headed("[session]", _row("file", "(needed)", "", "JSON of warpriver.edits.write_edits"))


def _headed(head: str, *rows: str) -> list[str]:
    return ["", f"# {head}", *rows]


@public
def describe_scene(scene: Scene) -> str:
    """Return a scene as it was understood: sources, constants that are not the default, what happens when."""
    plan, rows = scene.run_plan, [repr(scene)]
    if scene.path is not None:
        rows.append(_part("file", str(scene.path)))
    ground = scene.terrain
    if ground is None:
        rows.append(_part("terrain", "none: the rivers run on a plain"))
    else:
        rows.append(_part("terrain", _call(ground.generator or ground.file, ground.arguments)))
        rows += [_part("brush", _fields(brush)) for brush in ground.brushes]
    rivers = scene.network
    if rivers.lines:
        rows += [_part("channel", _channel(line)) for line in rivers.lines]
    else:
        source = "found on the terrain" if rivers.extracted else rivers.file
        rows.append(_part("network", _call(source, rivers.arguments)))
    if rivers.shaped:
        rows.append(_part("junctions", "tributaries get the angle that fits their flows"))
    rows.append(_part("params", _changed(scene.params)))
    for each in scene.controls:
        end = "the end" if each.end is None else f"{each.end:g} yr"
        rows.append(_part("control", f"{each.begin:g} yr to {end}: {_control(each.control)}"))
    for planned in scene.edits:
        at = f"after {planned.step} steps, {planned.step * scene.params.time_step:.4g} yr"
        rows.append(_part("edit", f"{at}: {planned.edit.name}({_fields(planned.edit)})"))
    every = plan.record_every
    between = f"{every.steps} steps" if every.steps is not None else f"{every.years:g} yr"
    told = f"{plan.steps} steps of {scene.params.time_step:.4g} yr, recorded every {between}, seed {plan.seed}"
    told += f", {plan.dtype}"
    rows.append(_part("run", told + (f", {plan.threads} threads" if plan.threads else "")))
    rows.append(_part("output", ", ".join(scene.outputs.names()) or "nothing"))
    return "\n".join(rows)


def _part(name: str, text: str) -> str:
    return f"  {name:<9} {text}"


def _row(name: str, default: str, unit: str, doc: str) -> str:
    return f"{name:<20} {default:<14} {unit:<16} {_plain(doc)}"


def _plain(doc: str) -> str:
    """A sentence of a docstring without its markup."""
    return re.sub(r":\w+:`~?([^`]*)`", r"\1", doc).replace("``", "")


def _call(name: Any, arguments: Mapping[str, Any]) -> str:
    return ", ".join([str(name), *(f"{key} {_brief(value)}" for key, value in arguments.items())])


def _fields(value: Any) -> str:
    pairs = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    return ", ".join(f"{name} {_brief(each)}" for name, each in pairs if each is not None)


def _brief(value: Any) -> str:
    """A value for people: long lines by the number of their points."""
    if isinstance(value, (tuple, list, np.ndarray)) and len(value) > 2 and np.ndim(value) == 2:
        return f"{len(value)} points"
    return f"{value:g}" if isinstance(value, float) else shown(value)


def _channel(line: Line) -> str:
    length = float(np.hypot(*np.diff(line.xy, axis=0).T).sum())
    (x0, y0), (x1, y1) = line.xy[0], line.xy[-1]
    ring = ", a ring" if line.closed else ""
    ends = f"from ({x0:.6g}, {y0:.6g}) to ({x1:.6g}, {y1:.6g})"
    return f"{len(line.xy)} points of {line.about}, {length:.4g} m {ends}, width {line.width:g} m{ring}"


def _control(control: Control) -> str:
    name = type(control).__name__
    if isinstance(control, ControlField):
        return f"{name} of {control.raster!r}"
    return repr(control) if isinstance(control, RateControl) else f"{name}({_fields(control)})"


def _changed(params: Any) -> str:
    """Constants that are not the default."""
    solver = next(name for name, kind in SOLVER_PARAMS.items() if kind is type(params))
    rows = [
        f"{field.name} {_fields(value) if dataclasses.is_dataclass(value) else _brief(value)}"
        for field in dataclasses.fields(params)
        if (value := getattr(params, field.name)) != field.default
    ]
    return f"solver {solver}" + (f": {', '.join(rows)}" if rows else ", all by default")


def _control_keys(kind: type[Control]) -> list[str]:
    if kind is ControlField:
        return [
            _row("file", "(none)", "", "raster of c in m, above 0 where channels are drawn to; or a gray image"),
            _row("bounds", "(none)", "m", "[west, south, east, north]: of an image, or of a field to paint on"),
            _row("height", "(none)", "m", "of an image: c where it is white; black is the opposite"),
            _row("cell_size", "(none)", "m", "of a field to paint on"),
            _row("stroke", "[]", "", "tables {operation, center, radius, amount}: paint; erase and smooth have share"),
        ]
    if issubclass(kind, RateControl):
        factor = "0" if kind.highest == 1.0 else "(needed)"
        return [
            _row("polygon", "(none)", "m", "[[x, y], ...]; or give file"),
            _row("file", "(none)", "", "file of lines, and channel, the number of one (0); or a raster of factors"),
            _row("factor", factor, "-", "factor of the rate in the polygon; a raster has its own"),
            _row("blend", "0", "m", "distance inside the edge over which the factor fades from 1"),
        ]
    rows = describe_fields(kind, bare=False)
    places = {field.name for field in dataclasses.fields(kind)} & {"center", "xy"}  # type: ignore[arg-type]
    rows[:0] = [
        _row(name, "(needed)", "m", "(x, y)" if name == "center" else "[[x, y], ...]") for name in sorted(places)
    ]
    if "xy" in places:
        rows.append(_row("file", "(none)", "", "file of lines in place of xy, and channel, the number of one (0)"))
    return rows


def _arguments(function: Callable[..., Any]) -> list[str]:
    """A line an argument that a scene can give."""
    docs = _docs(function, "Args:")
    return [
        _row(name, "(needed)" if p.default is p.empty else _default(p.default), "", docs.get(name, ""))
        for name, p in file_arguments(function).items()
    ]


def _documented(kind: type) -> list[str]:
    """A line a field of a class whose docstring tells them."""
    docs = _docs(kind, "Attributes:")
    return [
        _row(f.name, "(needed)" if f.default is dataclasses.MISSING else _default(f.default), "", docs.get(f.name, ""))
        for f in dataclasses.fields(kind)
    ]


def _default(value: Any) -> str:
    return "(none)" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _docs(thing: Any, section: str) -> dict[str, str]:
    """What a docstring says of each argument or attribute."""
    text = inspect.getdoc(thing) or ""
    if section not in text:
        return {}
    found: dict[str, str] = {}
    names: list[str] = []
    for line in text.split(section, 1)[1].splitlines()[1:]:
        if line and not line.startswith(" "):
            break
        begun = re.match(r"    ([\w, ]+): (.*)", line)
        if begun:
            names = [name.strip() for name in begun[1].split(",")]
            found |= dict.fromkeys(names, begun[2])
        else:
            found |= {name: f"{found[name]} {line.strip()}" for name in names if line.strip()}
    return found


def _summary(thing: Any) -> str:
    return _plain((inspect.getdoc(thing) or "").splitlines()[0])
