"""Scenes read from TOML files: everything that can be told without computing anything is checked here."""

from __future__ import annotations

import dataclasses
import inspect
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.edits.session import read_edits
from warpriver.edits.values import Edit, EditTerrain, edit_kinds, edit_of
from warpriver.errors import InputError, InputTypeError
from warpriver.history import Every
from warpriver.hydrology.extraction import extract_network
from warpriver.io.raster.terrains import read_raster, read_terrain, terrain_formats
from warpriver.io.tables import (
    check_keys,
    holds_scene,
    list_of_tables,
    made,
    nearest,
    neighbour,
    raising,
    read_toml,
    shown,
)
from warpriver.io.vector.networks import line_formats, read_network
from warpriver.meander.controls import (
    Attractor,
    Control,
    ControlField,
    DampingRegion,
    ErodibilityField,
    Guide,
    Repeller,
)
from warpriver.params import SOLVER_PARAMS, MeanderParams, PathMeander
from warpriver.public import public
from warpriver.scenes.output_tables import read_outputs
from warpriver.scenes.parts import (
    GroundSource,
    Line,
    RiverSource,
    RunPlan,
    TimedControl,
    TimedEdit,
    line_generators,
    terrain_generators,
)
from warpriver.scenes.scene import Scene, first_step
from warpriver.validate import MAX_SEED, checked_line, finite, finite_numbers, not_negative, one_of, positive, whole

__all__ = ["CONTROLS", "PLAN", "TABLES", "edit_names", "file_arguments", "read_scene"]

# Tables of the file, and what each holds.
TABLES = {
    "terrain": "the ground: a file or a generator, and brushes; without it the rivers run on a plain",
    "network": "the rivers: a file, found on the terrain, or channels",
    "params": "constants of the model",
    "control": "a list of controls, each with its kind",
    "edit": "a list of edits, each with its kind and its time",
    "session": "edits of a JSON file, each after its number of steps",
    "run": "how long, how often recorded, the seed",
    "output": "what is written",
}
CONTROLS: dict[str, type[Control]] = {
    kind.__name__: kind for kind in (Attractor, Repeller, Guide, ControlField, DampingRegion, ErodibilityField)
}
# Fields of edits and controls that are lines, which may lie in a file.
LINES = ("xy", "line")
# Edits of controls, which have tables of their own.
OF_CONTROLS = ("SetControls", "PaintControl")
STROKES = ("paint", "erase", "smooth")
# Keys of [run], and what they mean.
PLAN = {
    "years": ("(none)", "yr", "length of the run; or give steps"),
    "steps": ("(none)", "steps", "length of the run; by default that of the session, if there is one"),
    "record_every": ("10", "steps", "steps from record to record"),
    "record_every_years": ("(none)", "yr", "years from record to record, in place of steps"),
    "seed": ("0", "-", "seed of the random numbers"),
    "threads": ("(all cores)", "-", "threads on the CPU; results do not depend on it"),
    "dtype": ("float64", "-", "precision: float64, float32"),
    "check": ("false", "-", "check every phase of every step, slowly"),
}
# Arguments of readers and generators that a scene does not give: they follow from elsewhere, or are no text.
OTHERS = {"terrain", "flow", "area", "device", "dtype", "path", "extra"}


def file_arguments(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the arguments of a reader or a generator that a scene can give."""
    return {name: p for name, p in inspect.signature(function).parameters.items() if name not in OTHERS}


def edit_names() -> dict[str, type[Edit]]:
    """Return the classes of edits that stand in a scene, by name; controls have their times in it instead."""
    return {name: kind for name, kind in edit_kinds().items() if name not in OF_CONTROLS}


@dataclasses.dataclass(frozen=True)
class _File:
    """The file that is read, further folders in which what it names may lie, and the CRS of the lines of these."""

    path: Path
    folders: tuple[Path, ...]
    systems: list[tuple[str, str]] = dataclasses.field(default_factory=list)

    def find(self, name: Any, where: str, what: str) -> Path:
        remedy = "put it beside that, or name its folder (folders=, or --allow on the command line)"
        return neighbour(self.path, name, where, what, "scene", self.folders, remedy)

    def refusal(self, where: str, value: Any, remedy: str) -> InputError:
        return InputError(f"{self.path}: {where} = {shown(value)}; {remedy}")

    def at(self, where: str) -> str:
        return f"{self.path}: {where}"

    def word(self, where: str, value: Any, known: Iterable[str]) -> str:
        """Return a word that is one of a few, or refuse it with the nearest of them."""
        if not isinstance(value, str) or value not in known:
            raise self.refusal(where, value, nearest(str(value), known))
        return value


@public
def read_scene(path: str | os.PathLike[str], *, folders: Sequence[str | os.PathLike[str]] = ()) -> Scene:
    """Read a scene from a TOML file, and check all of it that can be told without computing anything.

    Args:
        path: File; its keys are listed by :func:`warpriver.scenes.scene_schema`.
        folders: Folders whose files the scene may name, beside those of its own folder and below.

    Raises:
        ValueError: The file is no TOML, or a key is unknown or its value wrong; file, key and value are named.
        OSError: A file cannot be read.
    """
    for folder in folders:
        if not isinstance(folder, (str, os.PathLike)):
            raise InputTypeError(f"read_scene: folders holds {shown(folder)}; give paths of folders")
    file = _File(Path(path), tuple(Path(folder) for folder in folders))
    data = read_toml(file.path, "a scene")
    if not holds_scene(file.path) and {"width", "slope", "length"} <= set(data):
        raise InputError(f"{path} is a valley file, no scene; wr.io.read_valley and warpriver valley read it")
    for key in data:
        if key not in {*TABLES, "name"}:
            known = {*TABLES, "name"}
            raise InputError(f"{path}: {key} = {shown(data[key])} is no key of a scene; {nearest(key, known)}")
    name = data.get("name", file.path.stem)
    if not isinstance(name, str):
        raise file.refusal("name", name, "give text")
    tables = {key: _table(file, key, data.get(key, {})) for key in TABLES if key not in ("control", "edit")}
    params = _params(file, tables["params"])
    terrain = _ground(file, tables["terrain"]) if "terrain" in data else None
    if "network" not in data:
        raise InputError(f"{path}: there is no [network]; give a file, extract or channels")
    network = _rivers(file, tables["network"], terrain)
    session = _session(file, tables["session"]) if "session" in data else None
    plan = _plan(file, tables["run"], params.time_step, session)
    return Scene(
        name=name,
        network=network,
        params=params,
        run_plan=plan,
        terrain=terrain,
        controls=_controls(file, data.get("control", []), plan.steps * params.time_step),
        edits=_edits(file, data.get("edit", []), params.time_step, plan, session, terrain is not None),
        outputs=read_outputs(file.path, tables["output"], data.get("output"), terrain is not None),
        path=file.path,
        systems=tuple(file.systems),
    )


def _table(file: _File, key: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise file.refusal(key, value, f"give a table, [{key}]")
    return value


# ---- ground


def _ground(file: _File, table: Mapping[str, Any]) -> GroundSource:
    """Where the ground comes from."""
    given = {"file", "generate"} & set(table)
    if len(given) != 1:
        raise InputError(f"{file.path}: terrain has {' and '.join(sorted(given)) or 'neither'}; give file or generate")
    where, rest = file.at("terrain"), {key: value for key, value in table.items() if key not in (*given, "brush")}
    brushes = tuple(
        _edit(file, {"kind": "EditTerrain", **row}, f"terrain.brush[{k}]")
        for k, row in enumerate(list_of_tables(file.path, "terrain.brush", table.get("brush", [])))
    )
    ground = [brush for brush in brushes if isinstance(brush, EditTerrain)]
    if "file" in table:
        source = file.find(table["file"], "terrain.file", "a terrain")
        _check_format(file, "terrain.file", source, terrain_formats())
        arguments = _arguments(rest, read_terrain, where, "terrain")
        return GroundSource(where, file=source, arguments=arguments, brushes=tuple(ground))
    generators = terrain_generators()
    name = file.word("terrain.generate", table["generate"], generators)
    arguments = _arguments(rest, generators[name], where, f"generate = {name!r}")
    return GroundSource(where, generator=name, arguments=arguments, brushes=tuple(ground))


def _arguments(table: Mapping[str, Any], function: Callable[..., Any], where: str, what: str) -> dict[str, Any]:
    """Return what a table says as arguments of a function: those that it knows, and all that it needs."""
    known = file_arguments(function)
    check_keys(table, known, where)
    for name, parameter in known.items():
        if parameter.default is parameter.empty and name not in table:
            raise InputError(f"{where}.{name} is missing; {what} needs it")
    for name, value in table.items():
        _check_type(value, str(known[name].annotation), f"{where}.{name}")
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}


def _check_type(value: Any, annotation: str, where: str) -> None:
    """Refuse a text where a number is needed, and the like; ranges are checked by what takes the value."""
    parts = {part.split("[", 1)[0].strip() for part in annotation.split("|")}
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if number and not math.isfinite(value) and "nodata" not in where and "max_cut" not in where:
        raise InputError(f"{where} = {value}; give a finite number")
    if parts <= {"int", "float", "None"} and not (number and (isinstance(value, int) or "float" in parts)):
        raise InputError(f"{where} = {shown(value)}; give {'a number' if 'float' in parts else 'a whole number'}")
    if parts == {"bool"} and not isinstance(value, bool):
        raise InputError(f"{where} = {shown(value)}; give true or false")
    if parts <= {"Sequence", "tuple", "None"}:
        count = 2
        numbers = isinstance(value, list) and all(isinstance(v, (int, float)) and v is not True for v in value)
        if not numbers or len(value) != count:
            raise InputError(f"{where} = {shown(value)}; give {count} numbers, [a, b]")
    if parts <= {"str", "Literal", "None"} and not isinstance(value, str):
        raise InputError(f"{where} = {shown(value)}; give text")


def _check_format(file: _File, where: str, source: Path, formats: Mapping[str, bool]) -> None:
    """Refuse a file that no reader reads, or whose reader is not installed."""
    suffixes = [suffix.lower() for suffix in source.suffixes]
    if suffixes[-1:] == [".gz"] and ".gz" not in formats:
        suffixes.pop()
    ending = suffixes[-1] if suffixes else ""
    if ending not in formats:
        raise file.refusal(where, source.name, f"{ending or 'no ending'} is none of {', '.join(formats)}")
    if not formats[ending]:
        raise file.refusal(where, source.name, f'{ending} needs the extra "gis": pip install "warpriver[gis]"')


# ---- rivers


def _rivers(file: _File, table: Mapping[str, Any], terrain: GroundSource | None) -> RiverSource:
    """Where the rivers come from."""
    given = [key for key in ("file", "extract", "channel") if key in table]
    if len(given) != 1:
        raise InputError(
            f"{file.path}: network has {' and '.join(given) or 'none of file, extract and channel'}; give one of them"
        )
    shaped = table.get("shape_junctions", False)
    if not isinstance(shaped, bool):
        raise file.refusal("network.shape_junctions", shaped, "give true or false")
    where, rest = file.at("network"), {k: v for k, v in table.items() if k not in (given[0], "shape_junctions")}
    if given == ["file"]:
        source = file.find(table["file"], "network.file", "a file of lines")
        _check_format(file, "network.file", source, line_formats())
        arguments = _arguments(rest, read_network, where, "network")
        return RiverSource(where, file=source, arguments=arguments, shaped=shaped)
    check_keys(rest, ["crs"] if given == ["channel"] else [], where)
    if given == ["extract"]:
        if terrain is None:
            raise InputError(f"{where}.extract finds rivers on a terrain, and there is none; give [terrain]")
        wanted = _table(file, "network.extract", table["extract"])
        arguments = _arguments(wanted, extract_network, f"{where}.extract", "extract")
        positive(arguments["min_drainage_area"], f"{where}.extract.min_drainage_area", "m2")
        return RiverSource(where, extracted=True, arguments=arguments, shaped=shaped)
    rows = list_of_tables(file.path, "network.channel", table["channel"])
    if not rows:
        raise InputError(f"{where}.channel is empty; give a channel or more, [[network.channel]]")
    lines = tuple(_channel(file, row, f"network.channel[{k}]") for k, row in enumerate(rows))
    return RiverSource(where, lines=lines, crs=rest.get("crs"), shaped=shaped)


def _channel(file: _File, row: Mapping[str, Any], key: str) -> Line:
    """A channel of a scene: inline points, a line of a file, or one from nothing."""
    where = file.at(key)
    given = [name for name in ("points", "file", "generate") if name in row]
    if len(given) != 1:
        raise InputError(f"{where} has {' and '.join(given) or 'no line'}; give points, file or generate")
    own = {"width", "depth", "discharge", "closed", "offset", "turn"}
    sizes: dict[str, float | None] = {"width": None, "depth": None, "discharge": None}
    for name, unit in (("width", "m"), ("depth", "m"), ("discharge", "m3/s")):
        if name in row:
            sizes[name] = positive(row[name], f"{where}.{name}", unit)
    if sizes["width"] is None:
        raise InputError(f"{where}.width is missing; give the bankfull width in m")
    closed = row.get("closed", False)
    if not isinstance(closed, bool):
        raise file.refusal(f"{key}.closed", closed, "give true or false")
    rest = {name: value for name, value in row.items() if name not in {*own, given[0]}}
    if given == ["generate"]:
        generators = line_generators()
        name = file.word(f"{key}.generate", row["generate"], generators)
        arguments = _arguments(rest, generators[name], where, f"generate = {name!r}")
        xy = raising(where, lambda: generators[name](**arguments), {})
        about = f"{name}({', '.join(f'{k}={v!r}' for k, v in arguments.items())})"
    elif given == ["points"]:
        check_keys(rest, [], where)
        xy, about = row["points"], "points"
    else:
        check_keys(rest, ["channel"], where)
        xy, about = _line_of_file(file, row["file"], row.get("channel", 0), key), f"{row['file']}"
    # A line of two points is straight between them.
    xy = raising(where, lambda: checked_line(_with_middle(xy), "points"), {"points: ": ": ", "points": ": points"})
    xy = _placed(xy, row, where)
    assert sizes["width"] is not None
    return Line(xy, sizes["width"], sizes["depth"], sizes["discharge"], closed, about)


def _with_middle(xy: Any) -> Any:
    if isinstance(xy, list) and len(xy) == 2 and all(isinstance(p, list) and len(p) == 2 for p in xy):
        return [xy[0], [0.5 * (a + b) for a, b in zip(*xy, strict=True)], xy[1]]
    return xy


def _placed(xy: np.ndarray, row: Mapping[str, Any], where: str) -> np.ndarray:
    """Turn a line about its zero, in degrees to the left, and move it."""
    turn = math.radians(finite(row.get("turn", 0.0), f"{where}.turn", "degrees"))
    if turn:
        c, s = math.cos(turn), math.sin(turn)
        xy = xy @ np.array([[c, s], [-s, c]])
    offset = finite_numbers(row.get("offset", (0.0, 0.0)), 2, f"{where}.offset")
    return xy + offset if any(offset) else xy


def _line_of_file(file: _File, name: Any, channel: Any, key: str) -> np.ndarray:
    """A line of a file beside the scene."""
    source = file.find(name, f"{key}.file", "a file of lines")
    _check_format(file, f"{key}.file", source, line_formats())
    where = file.at(f"{key}.file = {shown(name)}")
    try:
        network = read_network(source, width=1.0, short="keep")
    except InputError as error:
        hint = "; give the outlines of polygons as closed lines" if "Polygon" in str(error) else ""
        raise InputError(f"{where}: {error}{hint}") from error
    if network.crs is not None:
        file.systems.append((where, network.crs))
    lines = network.polylines()
    number = whole(channel, file.at(f"{key}.channel"))
    if number >= len(lines):
        raise file.refusal(f"{key}.channel", channel, f"{name} has channels 0 to {len(lines) - 1}")
    return lines[number]


# ---- constants


def _params(file: _File, table: Mapping[str, Any]) -> MeanderParams | PathMeander:
    """Constants of the solver that a table names."""
    solver = file.word("params.solver", table.get("solver", "migration"), SOLVER_PARAMS)
    preset = file.word("params.preset", table.get("preset", "default"), ("default", "paper"))
    if preset == "paper" and solver != "migration":
        raise file.refusal("params.preset", preset, "only the solver migration has it; leave one of them out")
    kind = SOLVER_PARAMS[solver]
    fields = {key: value for key, value in table.items() if key not in ("solver", "preset")}
    check_keys(fields, [f.name for f in dataclasses.fields(kind)], file.at("params"))
    for field in dataclasses.fields(kind):
        part, given = field.metadata.get("kind"), fields.get(field.name)
        if part is not None and field.name in fields and given is not False:
            fields[field.name] = made(part, given, file.at(f"params.{field.name}"))
    begin: MeanderParams | PathMeander = MeanderParams.paper() if preset == "paper" else kind()
    return raising(file.at("params"), lambda: begin.replace(**fields), {f"{kind.__name__}.": "."})


# ---- controls


def _controls(file: _File, rows: Any, years: float) -> tuple[TimedControl, ...]:
    """Controls and when they work."""
    return tuple(
        _control(file, row, f"control[{k}]", years) for k, row in enumerate(list_of_tables(file.path, "control", rows))
    )


def _control(file: _File, row: Mapping[str, Any], key: str, years: float) -> TimedControl:
    where, kind = file.at(key), file.word(f"{key}.kind", row.get("kind"), CONTROLS)
    begin = not_negative(row.get("from", 0.0), f"{where}.from", "years")
    end = None if "until" not in row else not_negative(row["until"], f"{where}.until", "years")
    if end is not None and end <= begin:
        raise file.refusal(f"{key}.until", row["until"], f"the control begins at {begin:g} yr; give a later time")
    if begin > years:
        raise file.refusal(f"{key}.from", row["from"], f"the run ends at {years:g} yr")
    fields = {name: value for name, value in row.items() if name not in ("kind", "from", "until")}
    return TimedControl(_made_control(file, kind, fields, key), begin, end)


def _made_control(file: _File, kind: str, fields: dict[str, Any], key: str) -> Control:
    where = file.at(key)
    if kind == "ControlField":
        return _field(file, fields, key)
    if kind in ("DampingRegion", "ErodibilityField"):
        check_keys(fields, ["polygon", "file", "channel", "factor", "blend"], where)
        if ("polygon" in fields) == ("file" in fields):
            raise InputError(f"{where} needs polygon or file; give one of them")
        area: Any = fields.get("polygon")
        if "file" in fields:
            source = file.find(fields["file"], f"{key}.file", "a file of lines or a raster")
            if source.suffix.lower() in line_formats():
                area = _line_of_file(file, fields["file"], fields.get("channel", 0), key)
            else:
                _check_format(file, f"{key}.file", source, {**line_formats(), **terrain_formats()})
                area = raising(f"{where}.file", lambda: read_raster(source), {})
        cls: Callable[..., Control] = CONTROLS[kind]
        options = {name: fields[name] for name in ("factor", "blend") if name in fields}
        return raising(
            where, lambda: cls(area, **options), {f"{kind}.area": ".polygon", f"{kind}.": ".", f"{kind} ": " "}
        )
    if kind == "Guide":
        fields = _with_line(file, fields, "xy", key)
    known = [f.name for f in dataclasses.fields(CONTROLS[kind])]  # type: ignore[arg-type]
    check_keys(fields, known, where)
    for name in ("center", "xy"):
        if name in known and name not in fields:
            raise InputError(
                f"{where}.{name} is missing; give {'(x, y)' if name == 'center' else 'points [x, y]'} in m"
            )
    return raising(where, lambda: CONTROLS[kind](**fields), {f"{kind}.": "."})


def _field(file: _File, fields: Mapping[str, Any], key: str) -> ControlField:
    """A painted field: a raster in m, a gray image, or zeros, and strokes on it."""
    where = file.at(key)
    check_keys(fields, ["file", "bounds", "height", "cell_size", "stroke"], where)
    if "file" in fields:
        if "cell_size" in fields:
            raise file.refusal(f"{key}.cell_size", fields["cell_size"], "the file has its own; leave it out")
        if ("bounds" in fields) != ("height" in fields):
            raise InputError(f"{where} has bounds or height alone; an image needs both, a raster in m neither")
        source = file.find(fields["file"], f"{key}.file", "a raster or an image")
        if "bounds" in fields:
            height = positive(fields["height"], f"{where}.height", "m")
            field = raising(where, lambda: ControlField.from_image(source, fields["bounds"], height), {})
        else:
            _check_format(file, f"{key}.file", source, terrain_formats())
            field = raising(f"{where}.file", lambda: ControlField(read_raster(source)), {})
    else:
        for name in ("bounds", "cell_size"):
            if name not in fields:
                raise InputError(
                    f"{where}.{name} is missing; give file, or bounds and cell_size of a field to paint on"
                )
        if "height" in fields:
            raise file.refusal(f"{key}.height", fields["height"], "it is that of an image; leave it out")
        size = positive(fields["cell_size"], f"{where}.cell_size", "m")
        field = raising(where, lambda: ControlField.blank(fields["bounds"], size), {"bounds": ".bounds"})
    for k, row in enumerate(list_of_tables(file.path, f"{key}.stroke", fields.get("stroke", []))):
        _stroke(file, field, row, f"{key}.stroke[{k}]")
    field.strokes.clear()
    return field


def _stroke(file: _File, field: ControlField, row: Mapping[str, Any], key: str) -> None:
    where, operation = file.at(key), file.word(f"{key}.operation", row.get("operation", "paint"), STROKES)
    last = "amount" if operation == "paint" else "share"
    check_keys(row, ["operation", "center", "radius", last], where)
    center = finite_numbers(row.get("center"), 2, f"{where}.center")
    radius = positive(row.get("radius"), f"{where}.radius", "m")
    amount = finite(row.get(last, None if operation == "paint" else 1.0), f"{where}.{last}")
    raising(where, lambda: getattr(field, operation)(center, radius, amount), {})


def _with_line(file: _File, fields: Mapping[str, Any], name: str, key: str, channel: str = "channel") -> dict[str, Any]:
    """Fields whose line, where it lies in a file, stands among them; ``channel`` is the key of its number there."""
    if "file" not in fields:
        return dict(fields)
    if name in fields:
        raise InputError(f"{file.at(key)} has file and {name}; give one of them")
    line = _line_of_file(file, fields["file"], fields.get(channel, 0), key)
    rest = {key: value for key, value in fields.items() if key not in ("file", channel)}
    return rest | {name: line.tolist()}


# ---- edits


def _session(file: _File, table: Mapping[str, Any]) -> Any:
    check_keys(table, ["file"], file.at("session"))
    source = file.find(table.get("file"), "session.file", "a session in JSON")
    return raising(file.at("session.file"), lambda: read_edits(source), {})


def _edits(
    file: _File, rows: Any, time_step: float, plan: RunPlan, session: Any, has_terrain: bool
) -> tuple[TimedEdit, ...]:
    """Edits in the order in which they are done; those of a session before others of the same step."""
    found: list[TimedEdit] = []
    if session is not None:
        if session.seed != plan.seed:
            raise file.refusal("run.seed", plan.seed, f"the session has the seed {session.seed}; give that")
        found += [
            TimedEdit(step, edit, file.at(f"session, edit {number}"))
            for number, (step, edit) in enumerate(session.edits)
        ]
    for k, row in enumerate(list_of_tables(file.path, "edit", rows)):
        key = f"edit[{k}]"
        if "time" not in row:
            raise InputError(f"{file.at(key)}.time is missing; give the time of the edit in years")
        time = not_negative(row["time"], f"{file.at(key)}.time", "years")
        edit = _edit(file, {name: value for name, value in row.items() if name != "time"}, key)
        found.append(TimedEdit(first_step(time, time_step), edit, file.at(key)))
    for each in found:
        if each.step > plan.steps:
            raise InputError(
                f"{each.where} is to be done after {each.step} steps, {each.step * time_step:g} yr, and the run ends "
                f"after {plan.steps}, {plan.steps * time_step:g} yr; give an earlier time, or a longer run"
            )
        if isinstance(each.edit, EditTerrain) and not has_terrain:
            raise InputError(f"{each.where} is an edit of the ground, and there is none; give [terrain]")
    return tuple(sorted(found, key=lambda each: each.step))


def _edit(file: _File, row: Mapping[str, Any], key: str) -> Edit:
    where, kinds = file.at(key), edit_names()
    if row.get("kind") in OF_CONTROLS:
        raise file.refusal(f"{key}.kind", row["kind"], "give each control in [[control]], with from and until")
    kind = file.word(f"{key}.kind", row.get("kind"), kinds)
    fields = {name: value for name, value in row.items() if name != "kind"}
    known = [f.name for f in dataclasses.fields(kinds[kind])]
    line = next((name for name in LINES if name in known), None)
    if line is not None:
        fields = _with_line(file, fields, line, key, "channel_of_file")
    check_keys(fields, known, where)
    for field in dataclasses.fields(kinds[kind]):
        if field.default is dataclasses.MISSING and field.name not in fields:
            raise InputError(f"{where}.{field.name} is missing; {kind} needs it")
    return raising(where, lambda: edit_of({"edit": kind, **fields}), {name: f".{name}" for name in known})


# ---- the run


def _plan(file: _File, table: Mapping[str, Any], time_step: float, session: Any) -> RunPlan:
    """How the scene is run."""
    where = file.at("run")
    check_keys(table, PLAN, where)
    if "years" in table and "steps" in table:
        raise InputError(f"{where} has years and steps; give one of them")
    if "years" in table:
        steps = first_step(not_negative(table["years"], f"{where}.years", "years"), time_step)
    elif "steps" in table:
        steps = whole(table["steps"], f"{where}.steps")
    elif session is not None:
        steps = session.steps
    else:
        raise InputError(f"{where} has no years; say how long the run is")
    steps = whole(steps, f"{where}: the number of steps")
    if "record_every" in table and "record_every_years" in table:
        raise InputError(f"{where} has record_every and record_every_years; give one of them")
    if "record_every_years" in table:
        every = Every(years=positive(table["record_every_years"], f"{where}.record_every_years", "years"))
    else:
        every = Every(steps=whole(table.get("record_every", 10), f"{where}.record_every", 1, "steps"))
    check = table.get("check", False)
    if not isinstance(check, bool):
        raise file.refusal("run.check", check, "give true or false")
    seed = whole(table.get("seed", session.seed if session is not None else 0), f"{where}.seed", maximum=MAX_SEED)
    threads = whole(table["threads"], f"{where}.threads", 1) if "threads" in table else None
    dtype = one_of(table.get("dtype", "float64"), f"{where}.dtype", ("float64", "float32"))
    return RunPlan(steps, every, seed, threads, dtype, check)
