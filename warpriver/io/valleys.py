"""Valley files: parameters as TOML; points and breaklines of a valley's surface.

A TOML valley file holds the fields of :class:`~warpriver.valley.params.ValleyParams` under their names, and

    [control]                      # for each element a list of terms, which are summed
    thalweg = [{kind = "harmonic", amplitude = 0.25, frequency = 1}]
    width = [{kind = "series", file = "widths.csv", column = "width", relative = true, harmonics = 5}]

    [section]                      # CrossSection
    [covariance]                   # CovarianceTarget, in place of control.thalweg; [[covariance]] for two of them
    [profile]                      # LongProfile, in place of an even slope
    [[thread]]                     # Thread, one table each
    [[objects]]                    # ObjectField, one table each
    [[patch]]                      # RoughnessPatch, one table each
    [[stamp]]                      # MeshStamp, one table each; file = "weir.obj" in place of vertices and triangles
    [line]                         # a given centreline: file = "river.csv", channel = 0; or points = [[x, y], ...]

Files are sought beside the valley file, in its folder or below; others are refused. ``warpriver valley --schema`` lists
every key with unit and default.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpriver.errors import InputError, PathError
from warpriver.files import beside
from warpriver.io.files import is_number
from warpriver.io.meshes import read_mesh
from warpriver.io.tables import (
    as_toml,
    describe_fields,
    holds_scene,
    list_of_tables,
    made,
    nearest,
    neighbour,
    raising,
    read_toml,
    shown,
)
from warpriver.public import public
from warpriver.valley.params import (
    ELEMENTS,
    CovarianceTarget,
    CrossSection,
    ObjectField,
    Thread,
    ValleyParams,
)
from warpriver.valley.profile import LongProfile
from warpriver.valley.stamps import MeshStamp, RoughnessPatch
from warpriver.valley.terms import TERMS
from warpriver.valley.valley import ValleyGrid

__all__ = ["read_valley", "valley_schema", "write_breaklines", "write_points", "write_valley"]

# Keys of the file, other than single constants, and what they hold.
TABLES = {"section": CrossSection, "covariance": CovarianceTarget, "profile": LongProfile}
LISTS = {
    "thread": ("threads", Thread),
    "objects": ("objects", ObjectField),
    "patch": ("patches", RoughnessPatch),
    "stamp": ("stamps", MeshStamp),
}
KINDS = {kind: name for name, kind in TERMS.items()}
# Constants that may be left out altogether.
OPTIONAL = {
    "valley_slope": ("m/m", "slope of the valley floor; the reach slope where it is left out"),
    "depth": ("m", "bankfull depth; by eq. 4 from grain size and Shields stress where it is left out"),
    "bank_window": ("m", "length of channel whose highest riffle crest sets top of bank; the reach where left out"),
    "floor_window": ("m", "length of valley whose outermost banks set the floor's edges; the reach where left out"),
}
POINTS = (".xyz", ".csv", ".npz")


# ---- parameters


@public
def read_valley(path: str | os.PathLike[str]) -> ValleyParams:
    """Read the parameters of a synthetic valley from a TOML file.

    Args:
        path: File; its keys are listed by :func:`valley_schema`.

    Returns:
        ValleyParams, for ``warpriver.synthetic_valley``.

    Raises:
        ValueError: The file is no TOML, or a key is unknown or its value wrong; file, key and value are named.
        OSError: The file cannot be read.
    """
    path = Path(path)
    data = read_toml(path, "a valley")
    constants = {f.name for f in dataclasses.fields(ValleyParams) if f.metadata} | set(OPTIONAL) | {"name"}
    known = {*constants, "control", "line", *TABLES, *LISTS}
    if holds_scene(path):
        raise InputError(f"{path} is a scene, no valley; wr.read_scene reads it, and warpriver simulate runs it")
    for key in data:
        if key not in known:
            raise InputError(f"{path}: {key} = {shown(data[key])} is no key of a valley; {nearest(key, known)}")
    fields: dict[str, Any] = {key: data[key] for key in constants & set(data)}
    if not isinstance(fields.setdefault("name", path.stem), str):
        raise InputError(f"{path}: name = {shown(fields['name'])}; give text")
    for key, value in fields.items():
        if key in OPTIONAL and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise InputError(f"{path}: {key} = {shown(value)}; give a number of unit {OPTIONAL[key][0]}")
    fields["controls"] = _controls(path, data.get("control", {}))
    for key, kind in TABLES.items():
        if key == "covariance" and isinstance(data.get(key), list):
            rows = list_of_tables(path, key, data[key])
            fields[key] = tuple(made(kind, row, f"{path}: {key}[{k}]") for k, row in enumerate(rows))
        elif key in data:
            fields[key] = made(kind, data[key], f"{path}: {key}")
    for key, (name, kind) in LISTS.items():
        fields[name] = tuple(
            made(kind, _with_mesh(path, row, f"{key}[{k}]") if key == "stamp" else row, f"{path}: {key}[{k}]")
            for k, row in enumerate(list_of_tables(path, key, data.get(key, [])))
        )
    if "line" in data:
        fields["line"] = _line(path, data["line"])
    return raising(path, lambda: ValleyParams(**fields), {"ValleyParams.": ""})


@public
def write_valley(params: ValleyParams, path: str | os.PathLike[str]) -> None:
    """Write the parameters of a valley as TOML, so that :func:`read_valley` gives the same back.

    Args:
        params: The valley; its control functions may hold the terms of warpriver only.
        path: File to write.

    Raises:
        ValueError: A term that a file cannot hold.
        OSError: The file cannot be written.
    """
    rows = [f"name = {json.dumps(params.name)}"]
    rows += [f"{f.name} = {as_toml(getattr(params, f.name))}" for f in dataclasses.fields(params) if f.metadata]
    rows += [f"{key} = {as_toml(getattr(params, key))}" for key in OPTIONAL if getattr(params, key) is not None]
    if params.controls:
        rows += ["", "[control]"]
    for name, terms in params.controls.items():
        rows += [f"{name} = ["] + [f"  {_inline(term)}," for term in terms] + ["]"]
    for key in TABLES:
        value = getattr(params, key)
        if isinstance(value, tuple):
            rows += [line for entry in value for line in ("", f"[[{key}]]", *_table(entry))]
        elif value is not None:
            rows += ["", f"[{key}]", *_table(value)]
    for key, (name, _) in LISTS.items():
        for entry in getattr(params, name):
            rows += ["", f"[[{key}]]", *_table(entry)]
    if params.line is not None:
        line = params.line.polylines()[0] if hasattr(params.line, "polylines") else params.line
        rows += ["", "[line]", "points = [", *(f"  [{x!r}, {y!r}]," for x, y in np.asarray(line).tolist()), "]"]
    with beside(Path(path)) as temporary:
        temporary.write_text("\n".join(rows) + "\n", encoding="utf-8")


def valley_schema() -> str:
    """Return the keys of a valley file as text: name, default, unit and meaning, a line each."""
    rows = ["# constants", *describe_fields(ValleyParams, bare=False)]
    rows += [f"{key:<20} {'(none)':<14} {unit:<16} {doc}" for key, (unit, doc) in OPTIONAL.items()]
    rows += ["", "# [control]: elements; each holds a list of terms, {kind = ..., ...}, which are summed"]
    rows += [f"{name:<20} {'[]':<14} {unit:<16} {doc}" for name, (unit, doc) in ELEMENTS.items()]
    for name, kind in TERMS.items():
        rows += ["", f'# term of kind "{name}": {_summary(kind)}', *describe_fields(kind)]
    for key, kind in TABLES.items():
        rows += ["", f"# [{key}]: {_summary(kind)}", *describe_fields(kind)]
    for key, (_, kind) in LISTS.items():
        rows += ["", f"# [[{key}]]: {_summary(kind)}", *describe_fields(kind)]
    rows += ["", '# [line]: a given centreline, file = "river.csv" and channel = 0, or points = [[x, y], ...]']
    return "\n".join(rows)


def _controls(path: Path, data: Any) -> dict[str, tuple[Any, ...]]:
    """Control functions of a file."""
    if not isinstance(data, Mapping):
        raise InputError(f"{path}: control = {shown(data)}; give a table of elements")
    made = {}
    for name, rows in data.items():
        if name not in ELEMENTS:
            raise InputError(f"{path}: control.{name} is no element; {nearest(name, ELEMENTS)}")
        made[name] = tuple(
            _term(path, dict(row), f"control.{name}[{k}]")
            for k, row in enumerate(list_of_tables(path, f"control.{name}", rows))
        )
    return made


def _term(path: Path, row: dict[str, Any], where: str) -> Any:
    """One term of a control function; a series may lie in a file of its own."""
    kind = row.pop("kind", None)
    if kind not in TERMS:
        raise InputError(f"{path}: {where}.kind = {shown(kind)} is no function; {nearest(str(kind), TERMS)}")
    if kind == "series" and "file" in row:
        row["values"] = _column(path, row.pop("file"), row.pop("column", None), where)
    return made(TERMS[kind], row, f"{path}: {where}")


def _neighbour(path: Path, name: Any, where: str, what: str) -> Path:
    """Return a file that a valley file names: one in its own folder or below, and nowhere else."""
    return neighbour(path, name, f"{where}.file", what, "valley file")


def _column(path: Path, name: Any, column: Any, where: str) -> np.ndarray:
    """A column of numbers of a CSV beside the valley file: by its name, or the last one.

    Messages tell nothing of what else stands in the file: who wrote the valley file need not be allowed to read it.
    """
    source = _neighbour(path, name, where, "a CSV")
    try:
        rows = source.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise PathError.of(error, f"cannot read {source}") from error
    except UnicodeDecodeError:
        raise InputError(f"{path}: {where}.file = {shown(name)}: not UTF-8 text, so no CSV") from None
    names = [word.strip() for word in rows[0].split(",")] if rows else []
    heads = not all(is_number(word) for word in names)
    if column is not None and (not heads or column not in names):
        raise InputError(
            f"{path}: {where}.column = {shown(column)}: {name} has no column of that name in its first line"
        )
    at = names.index(column) if column is not None else len(names) - 1
    values = []
    for number, row in enumerate(rows[heads:], 1 + heads):
        fields = row.split(",")
        if row.strip() and not (len(fields) > at and is_number(fields[at])):
            raise InputError(f"{path}: {where}.file = {shown(name)}: line {number} has no number in column {at + 1}")
        values += [float(fields[at])] if row.strip() else []
    return np.array(values)


def _with_mesh(path: Path, row: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """A table whose mesh, where it lies in a file, stands in it."""
    if "file" not in row:
        return row
    if {"vertices", "triangles"} & set(row):
        raise InputError(f"{path}: {where} has file and vertices or triangles; give one of them")
    source = _neighbour(path, row["file"], where, "a mesh")
    vertices, triangles = read_mesh(source)
    rest = {key: value for key, value in row.items() if key != "file"}
    return rest | {"vertices": vertices, "triangles": triangles}


def _line(path: Path, data: Any) -> np.ndarray:
    """Centreline of a file."""
    keys = set(data) if isinstance(data, Mapping) else {"?"}
    if not keys <= {"file", "channel", "points"} or ("file" in keys) == ("points" in keys):
        raise InputError(f"{path}: line = {shown(data)}; give file, and channel, or points")
    if "points" in data:
        try:
            return np.array(data["points"], np.float64)
        except (TypeError, ValueError):
            raise InputError(f"{path}: line.points is no list of [x, y]") from None
    from warpriver.io.vector.networks import read_network

    source = _neighbour(path, data["file"], "line", "a file of lines")
    try:
        lines = read_network(source, width=1.0).polylines()
    except ValueError:
        raise InputError(
            f"{path}: line.file = {shown(data['file'])} cannot be read as lines; read_network tells why"
        ) from None
    channel = data.get("channel", 0)
    if not isinstance(channel, int) or not 0 <= channel < len(lines):
        raise InputError(f"{path}: line.channel = {shown(channel)}; {data['file']} has channels 0 to {len(lines) - 1}")
    return lines[channel]


def _summary(kind: type) -> str:
    return (kind.__doc__ or "").strip().splitlines()[0]


def _table(entry: Any) -> list[str]:
    """Lines of a table."""
    pairs = [(f.name, getattr(entry, f.name)) for f in dataclasses.fields(entry)]
    return [f"{name} = {as_toml(number, 'a valley file')}" for name, number in pairs if number is not None]


def _inline(term: Any) -> str:
    """A term as an inline table."""
    if type(term) not in KINDS:
        raise InputError(f"a valley file cannot hold {term!r}; it knows {', '.join(TERMS)}")
    return "{" + ", ".join([f'kind = "{KINDS[type(term)]}"', *_table(term)]) + "}"


# ---- surfaces


@public
def write_points(grid: ValleyGrid, path: str | os.PathLike[str]) -> None:
    """Write the points of a curvilinear grid: x, y and z in m, a section after the other, from left to right.

    Args:
        grid: As ``Valley.grid()`` gives it.
        path: .xyz (blanks between), .csv (a head line and commas) or .npz (array ``xyz``, (sections, points, 3)).

    Raises:
        ValueError: Another suffix.
        OSError: The file cannot be written.
    """
    target = _checked_suffix(path, POINTS)
    with beside(target) as temporary:
        if target.suffix.lower() == ".npz":
            np.savez_compressed(temporary, xyz=grid.xyz)
        elif target.suffix.lower() == ".csv":
            np.savetxt(temporary, grid.points(), fmt="%.4f", delimiter=",", header="x,y,z", comments="")
        else:
            np.savetxt(temporary, grid.points(), fmt="%.4f")


@public
def write_breaklines(lines: Mapping[str, ArrayLike], path: str | os.PathLike[str], *, crs: str | None = None) -> None:
    """Write breaklines with their heights.

    Args:
        lines: (n, 3) points in m by name, as ``Valley.breaklines()`` gives them.
        path: .geojson (a LineString with z each) or .csv (name, x, y, z).
        crs: Coordinate reference system, as "EPSG:32619".

    Raises:
        ValueError: Another suffix.
        OSError: The file cannot be written.
    """
    target = _checked_suffix(path, (".geojson", ".json", ".csv"))
    with beside(target) as temporary:
        if target.suffix.lower() == ".csv":
            rows = [f"{name},{x:.4f},{y:.4f},{z:.4f}" for name, xyz in lines.items() for x, y, z in np.asarray(xyz)]
            temporary.write_text("\n".join(["name,x,y,z", *rows]) + "\n", encoding="utf-8")
            return
        head: dict[str, Any] = {"type": "FeatureCollection", "name": "breaklines"}
        if crs is not None:
            authority, _, code = crs.partition(":")
            name = f"urn:ogc:def:crs:{authority}::{code}" if code.isdigit() else crs
            head["crs"] = {"type": "name", "properties": {"name": name}}
        head["features"] = [
            {
                "type": "Feature",
                "properties": {"name": name},
                "geometry": {"type": "LineString", "coordinates": np.round(np.asarray(xyz, np.float64), 4).tolist()},
            }
            for name, xyz in lines.items()
        ]
        temporary.write_text(json.dumps(head, allow_nan=False) + "\n", encoding="utf-8")


def _checked_suffix(path: str | os.PathLike[str], known: tuple[str, ...]) -> Path:
    target = Path(path)
    if target.suffix.lower() not in known:
        raise InputError(f"cannot write {target}: the name must end in {', '.join(known)}")
    return target
