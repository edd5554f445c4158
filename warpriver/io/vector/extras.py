"""Free columns of the channels in files: which a file holds, under which names, and as what they come back."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from warpriver.channel_table import ChannelTable
from warpriver.errors import InputError
from warpriver.io.vector.attributes import FAMILIES, LISTS, READ, WRITTEN, list_names
from warpriver.io.vector.source import Source

__all__ = ["EXTRA", "KINDS", "check_extra", "extra_columns", "extra_kinds", "stated_extra", "wanted_extra"]

# The member in which our own files say which attributes are free columns, and of which kind.
EXTRA = "extra"
KINDS = {"b": "bool", "i": "int", "f": "float", "U": "text"}

# Names that mean something else in a file: ours, those that are read, and those that formats and text columns use.
_PLACES = (
    "x y z lon lat long lng longitude latitude easting northing east north id channel geometry geom shape fid ogc_fid"
)
_TAKEN = {
    *_PLACES.split(),
    *(name.lower() for attribute in WRITTEN for name in (attribute.name, attribute.short)),
    *(name.name.lower() for names in READ.values() for name in names),
    *(name for role in LISTS for name in list_names(role)),
    *(name for family in FAMILIES for marks in family.marks for name in marks),
}
# A shapefile holds so many characters of a name and bytes of a word.
SHAPEFILE_NAME, SHAPEFILE_TEXT = 10, 254


def check_extra(channels: ChannelTable, path: Any, suffix: str, *, text: bool) -> None:
    """Raise ``ValueError`` where a format cannot hold the free columns of a table.

    Args:
        channels: The table.
        path: The file, for messages.
        suffix: Its suffix.
        text: Whether it holds rows of plain text, whose fields are parted by commas or spaces.
    """
    seen: dict[str, str] = {}
    for name, column in channels.extra.items():
        what = f"{path}: the extra column {name!r}"
        other = seen.setdefault(name.lower(), name)
        if name.lower() in _TAKEN:
            raise InputError(f"{what} has the name of an attribute that files have for something else; rename it")
        if other != name:
            raise InputError(f"{what} differs from {other!r} in case only, which files do not tell apart; rename it")
        if suffix == ".shp" and len(name.encode()) > SHAPEFILE_NAME:
            raise InputError(f"{what} has a name of more than {SHAPEFILE_NAME} characters; rename it or write .gpkg")
        if column.dtype.kind == "U":
            _check_words(what, name, column.tolist(), suffix, text)
        elif text:
            _check_words(what, name, [], suffix, text)


def _check_words(what: str, name: str, words: Sequence[str], suffix: str, text: bool) -> None:
    """Raise ``ValueError`` for words that would not come back."""
    if suffix == ".shp" and any(len(word.encode()) > SHAPEFILE_TEXT for word in words):
        raise InputError(f"{what} has words of more than {SHAPEFILE_TEXT} bytes; write .gpkg or .geojson")
    if not text:
        return
    parting = set(',;\t"#') if suffix == ".csv" else set(',;\t"# ')
    for word in (name, *words):
        if parting & set(word) or not word.isprintable() or (suffix != ".csv" and not word) or word != word.strip():
            raise InputError(f"{what} holds {word!r}, which a row of text cannot; write .geojson or .gpkg")


def extra_kinds(channels: ChannelTable) -> dict[str, str]:
    """Return the kinds of the free columns by name, as our files state them."""
    return {name: KINDS[column.dtype.kind] for name, column in channels.extra.items()}


def stated_extra(member: Any) -> dict[str, str]:
    """Return what :func:`extra_kinds` gave, from what a file holds; nothing where it is damaged."""
    try:
        stated = json.loads(member) if isinstance(member, str) else member
        return {str(name): kind for name, kind in stated.items() if kind in KINDS.values()}
    except (AttributeError, ValueError):
        return {}


def wanted_extra(
    path: Any, stated: Mapping[str, str], asked: Iterable[str] | None, names: Iterable[str]
) -> dict[str, str | None]:
    """Return the free columns to read from a file, each with its kind where the file states it.

    Args:
        path: The file, for messages.
        stated: What the file states.
        asked: Names that the caller asks for; None: those that the file states.
        names: All attributes of the file.

    Raises:
        ValueError: The file has no attribute of a name that is asked for.
    """
    there = {name.lower(): name for name in names}
    if asked is None:
        return {name: kind for name, kind in stated.items() if name.lower() in there}
    for name in asked:
        if name.lower() not in there:
            listed = ", ".join(there.values()) or "none"
            raise InputError(f"{path}: no attribute {name!r} to read as an extra column; it has {listed}")
    return {name: stated.get(name) for name in asked}


def extra_columns(sources: Sequence[Source], values: Sequence[Mapping[str, Any]], label: str) -> dict[str, Any]:
    """Return the free columns of the channels.

    Args:
        sources: The files they come from; ``extra`` tells names and kinds.
        values: What each channel has of them, None or nothing where it has none.
        label: What to call the files in messages.
    """
    kinds: dict[str, set[str | None]] = {}
    for source in sources:
        for name, kind in source.extra.items():
            kinds.setdefault(name, set()).add(kind)
    columns = {}
    for name, found in kinds.items():
        kind = found.pop() if len(found) == 1 else None
        try:
            columns[name] = _as_kind([_plain(v.get(name)) for v in values], kind)
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{label}: the extra column {name!r} is not all {kind} ({error})") from error
    return columns


def _plain(value: Any) -> Any:
    """Return a value of a file as Python has it, None for nothing."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        return value
    return None if value is None or value != value else value


def _as_kind(values: list[Any], kind: str | None) -> np.ndarray:
    """Return values as a column of a kind, or of the narrowest that holds them all."""
    known = [value for value in values if value is not None]
    whole = len(known) == len(values)
    if kind is None:
        if any(isinstance(value, str) for value in known) or not known:
            kind = "text"
        elif whole and all(isinstance(value, bool) for value in known):
            kind = "bool"
        elif whole and all(isinstance(value, int) for value in known):
            kind = "int"
        else:
            kind = "float"
    if kind == "text":
        return np.array(["" if value is None else str(value) for value in values], str)
    if kind == "float":
        return np.array([np.nan if value is None else float(value) for value in values], np.float64)
    if not whole:
        raise InputError("some channels have none")
    if kind == "int":
        return np.array([int(value) for value in values], np.int64)
    return np.array([_truth(value) for value in values], bool)


def _truth(value: Any) -> bool:
    if isinstance(value, str):
        return {"true": True, "false": False, "1": True, "0": False}[value.lower()]
    return bool(value)
