"""What files in TOML share: reading them, making values of their tables, and messages that name file, key and value."""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from warpriver.errors import InputError, PathError, WarpriverError

__all__ = [
    "as_toml",
    "check_keys",
    "describe_fields",
    "holds_scene",
    "list_of_tables",
    "made",
    "nearest",
    "neighbour",
    "raising",
    "read_toml",
    "shown",
]

# Characters of a value in a message, and columns of the descriptions of keys.
LONGEST = 60

T = TypeVar("T")


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Args:
        path: The file.
        what: What it should hold, as "a valley".

    Raises:
        ValueError: It is no TOML.
        OSError: It cannot be read.
    """
    try:
        tables: dict[str, Any] = _toml().loads(path.read_text(encoding="utf-8"))
        return tables
    except OSError as error:
        raise PathError.of(error, f"cannot read {path}") from error
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text, so no TOML") from None
    except RecursionError:
        raise InputError(f"{path}: not TOML of {what}: it is nested too deeply") from None
    except ValueError as error:
        raise InputError(f"{path}: not TOML: {error}") from None


def holds_scene(path: Path) -> bool:
    """Tell a scene from a valley file: it has a network, or how long it runs; whoever reads it says what is wrong."""
    try:
        return bool({"network", "run", "edit", "session"} & set(read_toml(path, "a scene")))
    except (InputError, PathError):
        return False


def _toml() -> Any:
    """The TOML reader of the standard library, or the package that it came from."""
    if sys.version_info >= (3, 11):
        import tomllib

        return tomllib
    import tomli

    return tomli


def neighbour(
    path: Path,
    name: Any,
    where: str,
    what: str,
    kind: str,
    also: Sequence[Path] = (),
    remedy: str = "put it beside that",
) -> Path:
    """Return a file that a TOML file names: one in its own folder or below, or in a folder that its user named.

    Who wrote the file need not be allowed to read what its user can: so it reaches no other folders.

    Args:
        path: The TOML file.
        name: What it says.
        where: The key.
        what: What the file should be, as "a CSV".
        kind: What the TOML file is, as "valley file".
        also: Further folders whose files may be named.
        remedy: What to do about a file that lies elsewhere.

    Raises:
        ValueError: It is no name, it lies outside, or there is no such file.
    """
    if not isinstance(name, str):
        raise InputError(f"{path}: {where} = {shown(name)}; give the name of {what}")
    folder = path.parent.resolve()
    source = (folder / name).resolve()
    if not any(source.is_relative_to(each) for each in (folder, *(each.resolve() for each in also))):
        raise InputError(f"{path}: {where} = {shown(name)} lies outside of the folder of the {kind}; {remedy}")
    if not source.is_file():
        raise InputError(f"{path}: {where} = {shown(name)}: there is no such file beside it")
    return source


def list_of_tables(path: Path, key: str, rows: Any) -> list[Mapping[str, Any]]:
    """Return a list of tables, or say that it is none."""
    if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
        raise InputError(f"{path}: {key} = {shown(rows)}; give a list of tables")
    return rows


def made(kind: type, row: Any, where: str) -> Any:
    """Return a dataclass from a table; raises ``ValueError`` with file, key and value."""
    if not isinstance(row, Mapping):
        raise InputError(f"{where} = {shown(row)}; give a table")
    check_keys(row, [f.name for f in dataclasses.fields(kind)], where)
    values = {key: tuple(map(_frozen, v)) if isinstance(v, list) else v for key, v in row.items()}
    return raising(where, lambda: kind(**values), {f"{kind.__name__}.": ".", f"{kind.__name__} ": " "})


def check_keys(row: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    """Refuse a key of a table that is none there."""
    names = set(known)
    for key in row:
        if key not in names:
            raise InputError(f"{where}.{key} = {shown(row[key])} is no key there; {nearest(key, names)}")


def raising(where: Any, make: Callable[[], T], names: Mapping[str, str]) -> T:
    """Make something; its ``ValueError`` names the key as the file has it.

    Args:
        where: File and key.
        make: What makes it.
        names: How messages begin, and what stands for that in the file.
    """
    try:
        return make()
    except (ValueError, TypeError, WarpriverError) as error:
        text = str(error)
        if not isinstance(error, (ValueError, TypeError)):  # no memory, no file, no module
            raise type(error)(f"{where}: {text}") from error
        for name, instead in names.items():
            if text.startswith(name):
                joint = ": " if not instead else ""
                raise InputError(f"{where}{joint}{instead}{text.removeprefix(name)}") from None
        raise InputError(f"{where}: {text}") from None


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def shown(value: Any) -> str:
    """Return a value for a message, cut short."""
    text = " ".join(repr(value).split())
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def nearest(word: str, known: Iterable[str]) -> str:
    """Say what a wrong word may have meant."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, 1)
    return f"did you mean {close[0]}?" if close else f"use one of {', '.join(names)}"


def describe_fields(kind: type, *, bare: bool = True) -> list[str]:
    """Return a line a field of a dataclass: name, default, unit and meaning; ``bare``: also of those without them."""
    rows = []
    for f in dataclasses.fields(kind):
        if "kind" in f.metadata:  # a table of its own
            continue
        if f.metadata:
            doc = f.metadata["doc"]
            if f.metadata["choices"]:
                doc += ": " + ", ".join(map(str, f.metadata["choices"]))
            default = "(none)" if f.default is None else as_toml(f.default)
            rows.append(f"{f.name:<20} {default:<14} {f.metadata['unit']:<16} {doc}")
        elif bare:
            rows.append(f"{f.name:<20} {shown(f.default):<14}")
    return rows


def as_toml(number: Any, what: str = "a TOML file") -> str:
    """Return a value as TOML.

    Args:
        number: A number, text, flag, or a list of them.
        what: What cannot hold it, for the message.

    Raises:
        ValueError: An infinite number, or none.
    """
    if isinstance(number, bool):
        return "true" if number else "false"
    if isinstance(number, str):
        return json.dumps(number)
    if isinstance(number, np.ndarray):
        number = number.tolist()
    if isinstance(number, (tuple, list)):
        return "[" + ", ".join(as_toml(v, what) for v in number) + "]"
    if isinstance(number, (int, np.integer)):
        return str(int(number))
    if not math.isfinite(number):
        raise InputError(f"{what} cannot hold {number}")
    return repr(float(number))
