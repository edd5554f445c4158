"""What a history holds as tables: courses, oxbow lakes and abandoned courses as features, events, and a summary."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.history.events import Avulsion, Collision, Cutoff, Event, event_class, event_fields
from warpriver.validate import shown, whole

if TYPE_CHECKING:
    from warpriver.history.history import History

__all__ = ["FEATURES", "Features", "event_columns", "features_of", "geometry_of", "summary_columns"]

FEATURES = ("courses", "oxbows", "abandoned")
# The date that stands for the beginning of a run, and the years that dates can be told for.
ZERO, DATED_YEARS = np.datetime64("2000-01-01T00:00:00.000"), 7999.0
DAY, DAYS_PER_YEAR = 86_400_000.0, 365.25
# Sides of a quarter of a circle at the ends of a lake.
QUARTER_SIDES = 4
# Fields of events under the names that tables and files have for them.
EVENT_NAMES = {"time": "time_yr", "channel": "channel_id", "other": "other_id", "width": "width_m"}


@dataclasses.dataclass(frozen=True)
class Features:
    """Lines with attributes, or areas along them.

    Attributes:
        kind: "LineString", "MultiLineString" or "Polygon", what the lines of a feature become.
        columns: Attributes by name, each (F,); of polygons width_m says how wide they are.
        xy: (P, 2) points of all lines, m.
        line_start: (L + 1,) offsets that cut the points into lines.
        owner: (L,) feature that each line belongs to, ascending.
    """

    kind: str
    columns: Mapping[str, np.ndarray]
    xy: np.ndarray
    line_start: np.ndarray
    owner: np.ndarray


def features_of(history: History, layer: str, every: int = 1) -> Features:
    """Return one layer of a history.

    Args:
        history: The history.
        layer: "courses": the lines of the channels at each record. "oxbows": the loops that were cut off. "abandoned":
            the courses that were given up where channels met, or where one left its own.
        every: Take every so many records; the last one always.

    Raises:
        ValueError: Another layer, an interval below 1, or a history without a record.
    """
    if layer not in FEATURES:
        raise InputError(f"layer is {shown(layer)}; use one of {', '.join(map(repr, FEATURES))}")
    every = whole(every, "every", 1, "records")
    if not len(history.times):
        raise InputError("the history holds no record; run the simulation first")
    if layer == "courses":
        return _courses(history, sorted({*range(0, len(history.times), every), len(history.times) - 1}))
    return _loops(history) if layer == "oxbows" else _abandoned(history)


def geometry_of(features: Features) -> np.ndarray:
    """Return the geometries as shapely has them, (F,) (``warpriver[gis]``)."""
    (shapely,) = need("geometries", "shapely")
    count = len(features.owner)
    if not count:
        return np.empty(0, object)
    owner = np.repeat(np.arange(count), np.diff(features.line_start))
    lines: np.ndarray = shapely.linestrings(features.xy, indices=owner)
    if features.kind == "Polygon":
        lines = shapely.buffer(lines, 0.5 * features.columns["width_m"], quad_segs=QUARTER_SIDES)
    elif features.kind != "LineString":
        lines = shapely.multilinestrings(lines, indices=features.owner)
    return lines


def event_columns(history: History) -> dict[str, np.ndarray]:
    """Return all events as columns: what each kind tells in numbers and words, with length and middle of its line."""
    events, count = history.events, len(history.events)
    columns: dict[str, np.ndarray] = {"time_yr": events.times, "kind": np.array(events.kinds, str)}
    for name in ("length_m", "x", "y"):
        columns[name] = np.full(count, np.nan)
    told = list(events.counts())
    for kind in told:
        cls = event_class(kind)
        assert cls is not None
        rows = np.flatnonzero(columns["kind"] == kind)
        # One after the other: their lines are not kept.
        for row, event in zip(rows.tolist(), events.of(cls), strict=True):
            _take_event(columns, event, row, count)
    return columns


def _take_event(columns: dict[str, np.ndarray], event: Event, row: int, count: int) -> None:
    """Add what an event tells to the columns of all."""
    for name, kind, _ in event_fields(type(event)):
        value = getattr(event, name)
        if kind is np.ndarray:
            if name == "xy" and value is not None and value.ndim == 2:
                columns["length_m"][row] = np.hypot(*np.diff(value, axis=0).T).sum()
                columns["x"][row], columns["y"][row] = value.mean(axis=0) if len(value) else (np.nan, np.nan)
            continue
        target = EVENT_NAMES.get(name, name)
        if target not in columns:
            columns[target] = np.full(count, "", object) if kind is str else np.full(count, np.nan)
        if value is not None:
            columns[target][row] = value


def summary_columns(history: History) -> dict[str, np.ndarray]:
    """Return a row a record: its time and step, size of the network, and how often things had happened until then."""
    rows = []
    for network in history.networks:
        length, (chord, rings) = network.channel_lengths(), _chords(network)
        open_length = length[~rings].sum()
        rows.append(
            (
                network.channel_count,
                network.point_count,
                length.sum(),
                open_length / chord[~rings].sum() if open_length > 0.0 else np.nan,
                (length * network.channel_width).sum() / length.sum(),
            )
        )
    names = ("channels", "points", "length_m", "sinuosity", "width_m")
    columns: dict[str, np.ndarray] = {
        "time_yr": history.times,
        "step": history.steps,
        **{name: np.array([row[k] for row in rows]) for k, name in enumerate(names)},
    }
    times, kinds = history.events.times, np.array(history.events.kinds, str)
    for kind in {Cutoff.kind: 0, Collision.kind: 0} | history.events.counts():
        columns[f"{kind}s"] = np.searchsorted(np.sort(times[kinds == kind]), history.times, "right")
    return columns


# ---- layers


def _courses(history: History, records: Sequence[int]) -> Features:
    """Return the lines of the channels at some records."""
    times = history.times
    columns: dict[str, list[np.ndarray]] = {}
    lines: list[np.ndarray] = []
    for place, record in enumerate(records):
        network = history.networks[record]
        count = network.channel_count
        length, (chord, rings) = network.channel_lengths(), _chords(network)
        following = times[records[place + 1]] if place + 1 < len(records) else times[record]
        told = {
            "record": np.full(count, record),
            "time_yr": np.full(count, times[record]),
            "begin": np.full(count, _date(times[record])),
            "end": np.full(count, _date(following)),
            "channel_id": network.channel_id,
            "width_m": network.channel_width,
            "depth_m": network.channel_depth,
            "discharge_m3s": network.channel_discharge,
            "length_m": length,
            "sinuosity": np.where(rings, np.nan, length / np.where(rings, 1.0, chord)),
        }
        for name, values in told.items():
            columns.setdefault(name, []).append(values)
        lines += network.polylines(close=True)
    packed = {name: np.concatenate(pieces) for name, pieces in columns.items()}
    return _packed("LineString", packed, lines, np.arange(len(lines)))


def _loops(history: History) -> Features:
    """Return the loops that were cut off, as wide as the channel was."""
    cutoffs = [cutoff for cutoff in history.cutoffs if len(cutoff.xy) > 1]
    columns = _told(history, cutoffs) | {
        "channel_id": np.array([cutoff.channel for cutoff in cutoffs], np.int64),
        "width_m": np.array([cutoff.width for cutoff in cutoffs], np.float64),
    }
    return _packed("Polygon", columns, [cutoff.xy for cutoff in cutoffs], np.arange(len(cutoffs)))


def _abandoned(history: History) -> Features:
    """Return the courses that channels gave up where they met others, or where they left them for new ones."""
    events: list[Any] = list(history.events.of(Collision, Avulsion))
    pieces = [
        [xy for xy in (event.pieces() if isinstance(event, Collision) else [event.xy]) if len(xy) > 1]
        for event in events
    ]
    kept = [(c, p) for c, p in zip(events, pieces, strict=True) if p]
    gone = [event for event, _ in kept]
    columns = _told(history, gone) | {
        "case": np.array([getattr(event, "case", Avulsion.kind) for event in gone], object),
        "channel_id": np.array([event.channel for event in gone], np.int64),
        "other_id": np.array([getattr(event, "other", event.channel) for event in gone], np.int64),
        "width_m": np.array([event.width for event in gone], np.float64),
    }
    owner = np.repeat(np.arange(len(kept)), [len(p) for _, p in kept]).astype(np.int64)
    return _packed("MultiLineString", columns, [xy for _, p in kept for xy in p], owner)


def _told(history: History, events: Sequence[Event]) -> dict[str, np.ndarray]:
    """Return when things happened; what they left is there until the end of the run."""
    end = _date(history.times[-1])
    return {
        "time_yr": np.array([event.time for event in events], np.float64),
        "begin": np.array([_date(event.time) for event in events], "datetime64[ms]"),
        "end": np.array([end] * len(events), "datetime64[ms]"),
    }


def _packed(kind: str, columns: dict[str, np.ndarray], lines: Sequence[np.ndarray], owner: np.ndarray) -> Features:
    """Return lines end to end, with the lengths of the features where they are not known yet."""
    start = np.concatenate([[0], np.cumsum([len(xy) for xy in lines])]).astype(np.int64)
    xy = np.concatenate(lines).astype(np.float64) if lines else np.empty((0, 2))
    if "length_m" not in columns:
        step = np.hypot(*np.diff(xy, axis=0).T) if len(xy) else np.empty(0)
        step[start[1:-1] - 1] = 0.0
        line = np.repeat(np.arange(len(lines)), np.diff(start))
        count = len(columns["time_yr"])
        columns["length_m"] = np.bincount(owner[line[1:]] if len(xy) else [], step, minlength=count)
    return Features(kind, columns, xy, start, owner)


def _chords(network: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance of the ends of each channel in m, and which are rings, (C,) each."""
    xy, start = network.points(), network.starts()
    chord = np.hypot(*(xy[start[1:] - 1] - xy[start[:-1]]).T)
    return chord, (chord == 0.0) | network.channel_closed


def _date(time: float) -> np.datetime64:
    """Return the date that stands for a time in yr, none where calendars end."""
    if not 0.0 <= time <= DATED_YEARS:
        return np.datetime64("NaT", "ms")
    date: np.datetime64 = ZERO + np.timedelta64(round(float(time) * DAYS_PER_YEAR * DAY), "ms")
    return date
