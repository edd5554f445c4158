"""Lines as columns of numbers: CSV and its kin, plain or with .gz."""

from __future__ import annotations

import contextlib
import csv
import gzip
import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.crs import crs_text
from warpriver.errors import InputError, warn
from warpriver.io.files import decoded, is_number
from warpriver.io.vector.attributes import GENERIC, LISTS, NO_VALUE, NO_WORD, is_no_value, read_names, write_columns
from warpriver.io.vector.breaks import breaks_by_blank, breaks_by_name, channel_columns, tell_jumps
from warpriver.io.vector.extras import EXTRA, extra_kinds, stated_extra, wanted_extra
from warpriver.io.vector.point_lists import filled_gaps
from warpriver.io.vector.source import Line, Source, checked_points
from warpriver.network import RiverNetwork

__all__ = ["TEXT", "read_text", "write_text"]

TEXT = (".csv", ".txt", ".dat", ".xy")

# Columns by what they hold, lower case; the first one that is there counts. Others: ``attributes.READ``, "any file".
NAMES = {
    "x": ("x", "x_m", "easting", "east", "x_coord", "point_x"),
    "y": ("y", "y_m", "northing", "north", "y_coord", "point_y"),
    "lon": ("lon", "longitude", "long", "lng"),
    "lat": ("lat", "latitude"),
    "z": ("z", "z_m", "elevation", "elevation_m", "point_z"),
}
# What is the same in all rows of a channel; left alone where it is no number, as elsewhere a column may be anything.
OPTIONAL = ("drainage_area", "slope", "from_node", "to_node", "z")
# What every row must have; the rest may be left open.
NEEDED = ("x", "y", "channel")
# The column in which a .csv says what no other holds, in the first row of each channel: a comment would hide the names
# of the columns from other programs.
FACTS = "warpriver"
# The attributes that have a column in what is written; width and depth are those of the point.
COLUMNS = ("discharge_m3s", "drainage_area_m2", "slope", "from_node", "to_node", "closed", "joint")

METRES = ("m", "metre", "metres", "meter", "meters")
DEGREES = ("degree", "degrees", "deg")


def read_text(path: Path, wanted: Sequence[str], asked: Iterable[str] | None) -> Source:
    """Read points from columns of numbers; ``wanted`` are the roles to look for, ``asked`` names of free columns."""
    wanted = [role for role in wanted if role not in ("channel_id", "next_down")]  # told by the column of channels
    text = decoded(path).replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n")
    rows = text.rstrip().split("\n")
    first, names, comments = _scan_head(path, rows)
    comments += _column_facts(names, rows[first])
    comments, stated = _split_comments(comments)
    extra = wanted_extra(path, stated, asked, names)
    separator = _separator(rows[first].partition("#")[0])
    if separator == ";":
        rows[first:] = [row.replace(",", ".") for row in rows[first:]]
    columns, lonlat = _columns(names, wanted)
    crs, upstream, degrees = _header_facts(path, comments)
    fields = _fields(rows[first])
    for role in OPTIONAL:
        if role in columns and (columns[role] >= len(fields) or not _may_be_number(fields[columns[role]])):
            del columns[role]
    table = dict(zip(columns, _load_columns(path, rows, first, separator, columns).T, strict=True))
    _tell_open(path, {role: table[role] for role in LISTS if role in table and role in wanted})
    words = {name: _load_words(path, rows[first:], separator, names.index(name.lower())) for name in extra}
    origin = _stated_origin(comments)
    source = Source(path, [], crs, lonlat or degrees, origin=origin, ours=origin is not None)
    source.extra = {name: kind or _kind_of(words[name]) for name, kind in extra.items()}
    factors = {role: _factor(names[columns[role]], role) for role in wanted if role in table}
    spans = _spans(source, table, rows, first, separator, names)
    for line, span in zip(source.lines, spans, strict=True):
        for role, factor in factors.items():
            _take_column(line, role, table[role][span], factor, upstream)
        for name, values in words.items():
            line.extra[name] = _one_word(values[span], name, line.where)
        if upstream:
            line.reverse()
    return source


def _spans(
    source: Source, table: dict[str, np.ndarray], rows: list[str], first: int, separator: str | None, names: list[str]
) -> list[slice]:
    """Give a source its lines, with their points, elevations and identities; return the rows of each."""
    path = source.path
    breaks, labels, named = _parted(path, rows, first, separator, names)

    def line_number(row: int) -> int:
        return next(itertools.islice(_data_rows(rows, first), row, None))[0]

    spans = [slice(begin, end) for begin, end in zip([0, *breaks], [*breaks, len(table["x"])], strict=True)]
    for span, label in zip(spans, labels, strict=True):
        where = f"{path}, channel {label}" if len(labels) > 1 else str(path)
        xy = checked_points(np.stack([table["x"][span], table["y"][span]], axis=1), where)
        line = Line(xy, where, feature=len(source.lines))
        if not source.ours and (not named or len(labels) == 1):
            tell_jumps(where, xy, span.start, line_number)
        if "z" in table:
            line.z = np.where(is_no_value(table["z"][span], "z"), np.nan, table["z"][span])
        if named and isinstance(label, int) and label not in NO_VALUE:
            line.channel_id = label
        source.lines.append(line)
    return spans


def _tell_open(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Warn of points without a width or depth, which are given that between the others."""
    for role, values in columns.items():
        count = int(is_no_value(values, role).sum())
        if 0 < count < len(values):
            warn(
                f"{path}: {count} of {len(values)} rows have no {role}; it is interpolated along each channel that "
                "has others"
            )


def _parted(
    path: Path, rows: list[str], first: int, separator: str | None, names: list[str]
) -> tuple[list[int], list[Any], bool]:
    """Return the rows at which channels begin, but for the first, their labels, and whether a column names them."""
    fields = _fields(rows[first])
    for name in channel_columns(names):
        column = names.index(name)
        if column < len(fields) and not is_number(fields[column]):
            ids = _load_words(path, rows[first:], separator, column)
        else:
            ids = _load_columns(path, rows, first, separator, {"channel": column})[:, 0]
        found = breaks_by_name(path, ids, name)
        if found is not None:
            return *found, True
    breaks = breaks_by_blank(rows[first:])
    return breaks, list(range(len(breaks) + 1)), False


def _factor(name: str, role: str) -> float:
    """Factor that brings a column into our unit."""
    return next(n.factor for n in read_names(GENERIC, role) if n.name == name)


def _take_column(line: Line, role: str, values: np.ndarray, factor: float, upstream: bool) -> None:
    """Give a channel what a column says of it; rows of no value are left to the others."""
    known = values[~is_no_value(values, role)]
    if not len(known):
        return
    constant = bool((known == known[0]).all())
    if role in ("from_node", "to_node"):
        if constant and float(known[0]).is_integer():
            setattr(line, role, int(known[0]))
    elif role == "drainage_area":  # that of the downstream end
        line.drainage_area = factor * float(known[0] if upstream else known[-1])
    elif constant:
        setattr(line, role, factor * known[0])
    elif role in ("discharge", "slope"):
        setattr(line, role, factor * known.mean())
    elif (filled := filled_gaps(values, role)) is not None:
        setattr(line, role, factor * filled)


def _kind_of(words: np.ndarray) -> str:
    """Return what all words of a column are."""
    known = [word for word in words.tolist() if word.strip()]
    for kind, parse in (("int", int), ("float", float)):
        with contextlib.suppress(ValueError):
            for word in known:
                parse(word)
            if known and (kind == "float" or len(known) == len(words)):
                return kind
    return "text"


def _one_word(words: np.ndarray, name: str, where: str) -> str | None:
    """Return the word that the rows of a channel hold in a free column, None for nothing."""
    if (words != words[0]).any():
        raise InputError(
            f"{where}: the extra column {name!r} holds {words[0]} and {words[words != words[0]][0]}; only one value a "
            "channel is kept"
        )
    return str(words[0]).strip() or None


def write_text(network: RiverNetwork, path: Path, suffix: str) -> None:
    """Write a row a point: in a .csv under the names of the columns, in other formats under comments as well."""
    separator = "," if suffix == ".csv" else " "
    told = write_columns(network)
    columns = {name: told[name] for name in COLUMNS if name in told}
    if not np.isfinite(network.channel_slope).any():
        del columns["slope"]
    if not network.channel_closed.any():
        del columns["closed"]
    columns |= network.channels.extra
    height = network.point_elevations(close=True)
    names = ["channel_id", "x", "y", *["z"] * (height is not None), "width_m", "depth_m", *columns]
    constant = list(zip(*(map(_word, column.tolist()) for column in columns.values()), strict=True))
    packed = path.suffix.lower() == ".gz"
    widths, depths = network.point_widths(close=True), network.point_depths(close=True)
    facts = _csv_facts(network) if suffix == ".csv" else ""
    with path.open("wb") as raw, contextlib.ExitStack() as stack:
        # No time in the gzip header: the same network gives the same bytes.
        out = stack.enter_context(gzip.GzipFile("", "wb", fileobj=raw, mtime=0)) if packed else raw
        out.writelines(f"# {comment}\n".encode() for comment in ([] if facts else _comment_facts(network)))
        out.write(f"{separator.join([*names, FACTS] if facts else names)}\n".encode())
        for c, xy in enumerate(network.polylines(close=True)):
            head = str(network.channel_id[c])
            tail = separator.join([*constant[c], ""] if facts else constant[c])
            table = np.column_stack([xy, *([] if height is None else [height[c]]), widths[c], depths[c]]).tolist()
            rows = [separator.join((head, *map(repr, row), tail)) for row in table]
            rows[0] += facts
            out.write(("\n".join(rows) + "\n").encode())


def _comment_facts(network: RiverNetwork) -> list[str]:
    """Return the comments that tell CRS, unit, order and origin, and the kinds of free columns."""
    facts = "units=m order=downstream"
    if network.crs is not None:
        crs = " ".join(str(network.crs).split())
        facts = f"{facts} crs_wkt={crs}" if " " in crs or "[" in crs else f"crs={crs} {facts}"
    facts += " origin_x={!r} origin_y={!r}".format(*network.origin.tolist())
    return [facts] + ([f"{EXTRA} {json.dumps(extra_kinds(network.channels))}"] if network.channels.extra else [])


def _csv_facts(network: RiverNetwork) -> str:
    """Return the same as a field of a .csv, of JSON text."""
    facts = {"crs": network.crs, "units": "m", "order": "downstream", "origin": network.origin.tolist()}
    if network.channels.extra:
        facts[EXTRA] = extra_kinds(network.channels)
    # What parts columns or begins a comment is written as a code.
    text = json.dumps(facts).replace("#", "\\u0023").replace(";", "\\u003b")
    return '"' + text.replace('"', '""') + '"'


def _column_facts(names: Sequence[str], row: str) -> list[str]:
    """Return what the column of :func:`_csv_facts` says as comments would; nothing where it is damaged."""
    fields = _fields(row)
    if FACTS not in names or len(fields) <= names.index(FACTS):
        return []
    try:
        facts = json.loads(fields[names.index(FACTS)])
        crs = [f"crs_wkt={facts['crs']}"] if facts["crs"] else []
        origin = "origin_x={!r} origin_y={!r}".format(*facts["origin"])
        free = [f"{EXTRA} {json.dumps(facts[EXTRA])}"] if EXTRA in facts else []
        return [f"units={facts['units']} order={facts['order']} {origin}", *crs, *free]
    except (IndexError, KeyError, TypeError, ValueError):
        return []


def _word(value: Any) -> str:
    return value if isinstance(value, str) else repr(value)


# ---- the head of a file


def _scan_head(path: Path, rows: list[str]) -> tuple[int, list[str], list[str]]:
    """Return the index of the first row of numbers, and the column names and comments before it."""
    names: list[str] = []
    words: list[str] = []
    comments: list[str] = []
    for k, row in enumerate(rows):
        if not row.strip():
            continue
        if row.lstrip().startswith("#"):
            comments.append(row.strip().lstrip("# "))
            continue
        fields = _fields(row)
        if names or is_number(fields[0]):
            first = k
            break
        words = _words(fields)
        names = words if _has_xy(words) else []
    else:
        raise InputError(f"{path}: no row of numbers in it; expected x and y in columns")
    if not names and comments:
        said = _words(_fields(comments[-1]))
        names = said if _has_xy(said) and len(said) == len(fields) else []
    if not names and len(words) == len(fields) > 1 and not any(map(is_number, words)):
        raise InputError(f"{path}: its columns are {', '.join(words)}; name two of them x and y (or lon and lat)")
    return first, names, comments


def _split_comments(comments: list[str]) -> tuple[list[str], dict[str, str]]:
    """Return the comments but the one that tells the free columns, and what that one says."""
    told = [comment for comment in comments if comment.startswith(f"{EXTRA} {{")]
    stated = stated_extra(told[0][len(EXTRA) :]) if told else {}
    return [comment for comment in comments if comment not in told], stated


def _header_facts(path: Path, comments: list[str]) -> tuple[str | None, bool, bool]:
    """Return from comments the CRS, whether lines run upstream, and whether units are degrees."""
    facts: dict[str, str] = {}
    for comment in comments:
        plain, _, wkt = comment.partition("crs_wkt=")
        if wkt:
            facts["crs"] = wkt
        for key, value in re.findall(r"(?:^|[\s,;])(crs|units|order)\s*=\s*([^\s,;]+)", plain, re.IGNORECASE):
            facts.setdefault(key.lower(), value)
    units = facts.get("units", "m").lower()
    if units not in METRES + DEGREES:
        raise InputError(f"{path}: its header says units={units}; only metres are read, so convert it first")
    order = facts.get("order", "downstream").lower()
    if order not in ("downstream", "upstream"):
        raise InputError(f"{path}: its header says order={order}; use downstream or upstream")
    return crs_text(facts.get("crs"), str(path)), order == "upstream", units in DEGREES


def _stated_origin(comments: list[str]) -> tuple[float, float] | None:
    """Return from comments the zero of the device coordinates, if they state one."""
    found = dict(re.findall(r"\b(origin_[xy])=([^\s,;]+)", " ".join(comments)))
    if len(found) < 2 or not all(map(is_number, found.values())):
        return None
    x, y = float(found["origin_x"]), float(found["origin_y"])
    return (x, y) if math.isfinite(x) and math.isfinite(y) else None


def _columns(names: list[str], wanted: Sequence[str]) -> tuple[dict[str, int], bool]:
    """Return the column of each role, and whether x and y are named longitude and latitude."""
    if not names:
        return {"x": 0, "y": 1}, False
    lonlat = any(_find(names, role) is None for role in "xy")
    found = {"x": _find(names, "lon" if lonlat else "x"), "y": _find(names, "lat" if lonlat else "y")}
    found |= {role: _find(names, role) for role in ("z", *wanted)}
    return {role: column for role, column in found.items() if column is not None}, lonlat


def _find(names: Sequence[str], role: str) -> int | None:
    """Return the index of the first name that plays a role."""
    known = NAMES.get(role) or tuple(name.name for name in read_names(GENERIC, role))
    return next((names.index(alias) for alias in known if alias in names), None)


def _has_xy(names: Sequence[str]) -> bool:
    return any(all(_find(names, role) is not None for role in pair) for pair in (("x", "y"), ("lon", "lat")))


# ---- rows


def _separator(row: str) -> str | None:
    """Return what separates the columns of a row; None for spaces."""
    return next((s for s in (";", ",", "\t") if s in row), None)


def _fields(row: str) -> list[str]:
    """Split a row into its columns; beside semicolons a comma is a decimal point."""
    row = row.partition("#")[0].strip()
    separator = _separator(row)
    if separator == ";":
        row = row.replace(",", ".")
    return row.split() if separator is None else next(csv.reader([row], delimiter=separator))


def _words(fields: list[str]) -> list[str]:
    return [field.strip(" \"'").lower() for field in fields]


def _data_rows(rows: list[str], first: int) -> Iterator[tuple[int, str]]:
    """Yield the rows that hold numbers with their line number in the file."""
    for k in range(first, len(rows)):
        if rows[k].partition("#")[0].strip():
            yield k + 1, rows[k]


def _may_be_number(word: str) -> bool:
    """Tell whether a field is a number or is left open."""
    return is_number(word) or word.strip(" \"'").lower() in NO_WORD


def _load_columns(
    path: Path, rows: list[str], first: int, separator: str | None, columns: dict[str, int]
) -> np.ndarray:
    """Return columns of numbers, (rows, columns) float64, NaN where a field is open.

    Raises:
        ValueError: A field that is no number, or an open one of a column that needs them; the line is named.
    """
    try:
        table = np.loadtxt(rows[first:], delimiter=separator, usecols=tuple(columns.values()), quotechar='"', ndmin=2)
    except ValueError:
        table = _load_open_columns(path, rows, first, columns)
    bad = ~np.isfinite(table)
    for k, role in enumerate(columns):
        if role not in NEEDED:
            bad[:, k] &= ~np.isnan(table[:, k])
    if bad.any():
        row, column = np.argwhere(bad)[0]
        number, _ = next(itertools.islice(_data_rows(rows, first), int(row), None))
        raise InputError(f"{path}, line {number}: {list(columns)[column]} is {table[row, column]}; remove or repair it")
    return table


def _load_open_columns(path: Path, rows: list[str], first: int, columns: dict[str, int]) -> np.ndarray:
    """Return columns of numbers of which some are left open, or raise ``ValueError`` with the line."""
    table = []
    for number, row in _data_rows(rows, first):
        fields, values = _fields(row), []
        for role, column in columns.items():
            if column >= len(fields):
                text = f"{len(fields)} columns; {role} should be in column {column + 1}"
                raise InputError(f"{path}, line {number}: {text}")
            field = fields[column].strip(" \"'")
            if not is_number(field) and (role in NEEDED or field.lower() not in NO_WORD):
                text = f"{fields[column]!r} is not a number (column {column + 1}, {role})"
                raise InputError(f"{path}, line {number}: {text}")
            values.append(float(field) if is_number(field) else np.nan)
        table.append(values)
    return np.array(table)


def _load_words(path: Path, rows: list[str], separator: str | None, column: int) -> np.ndarray:
    """Return a column of channel names, or raise ``ValueError``."""
    try:
        return np.loadtxt(rows, delimiter=separator, usecols=column, quotechar='"', dtype=str, ndmin=1)
    except ValueError as error:
        raise InputError(f"{path}: its channels cannot be read ({error})") from error
