"""History: the networks, events and times that a run records; kept in memory or streamed to a folder.

On disk a run is a folder of numbered NumPy archives ("segments") beside ``run.json``, or one such archive. A segment is
written under another name and then renamed, so that a run that is interrupted, killed, or out of disk space leaves
everything recorded before readable.
"""

from __future__ import annotations

import dataclasses
import enum
import itertools
import json
import os
import time
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.channel_table import COLUMNS, ChannelTable
from warpriver.network import RiverNetwork
from warpriver.params import SOLVER_PARAMS, MeanderParams, PathMeander

__all__ = ["Collision", "Cutoff", "History", "Record", "Split", "StopReason"]

FORMAT = "warpriver-run-1"
HEADER = "run.json"

# A segment is written when it holds this much or when the last one is this old: a killed run loses no more than that.
SEGMENT_BYTES = 16 * 2**20
SEGMENT_SECONDS = 5.0


class StopReason(enum.Enum):
    """Why a run ended; ``advice`` says what to do next."""

    COMPLETED = "completed"
    INTERRUPTED = "interrupted"
    CALLBACK = "stopped by a callback"
    NOT_FINITE = "a point is no longer finite"
    CHECK_FAILED = "a phase check failed"
    STORE_FAILED = "the run could not be written"

    @property
    def advice(self) -> str:
        """What to do about it, in one sentence."""
        return {
            StopReason.COMPLETED: "nothing to do; call run again to go on",
            StopReason.INTERRUPTED: "the run stands at a step boundary; call run again, or resume from what was stored",
            StopReason.CALLBACK: "call run again to go on",
            StopReason.NOT_FINITE: "the state before the failing step is kept; look for extreme widths or rates there, "
            "and report it if there are none",
            StopReason.CHECK_FAILED: "the state after the failing phase is kept; report it with the input",
            StopReason.STORE_FAILED: "make room or choose another folder, then save the history, which is still in "
            "memory, and run again",
        }[self]


@dataclasses.dataclass(frozen=True)
class Cutoff:
    """One neck cutoff: the loop that a channel left behind as an oxbow lake, or the part that a ring split off.

    Attributes:
        time: Time of the cutoff, yr.
        channel: Index of the channel.
        width: Bankfull width there, m.
        xy: (n, 2) float64 abandoned line in m, absolute, downstream order, both neck points included. Shortest paths
            leave closed loops: the first point is repeated at the end.
    """

    time: float
    channel: int
    width: float
    xy: np.ndarray


@dataclasses.dataclass(frozen=True)
class Collision:
    """Two channels that touched and were joined there [Paris2023, Sec. 6.2].

    Attributes:
        time: yr.
        kind: "upstream" (two tributaries meet above their junction), "downstream" (a tributary meets, below their
            junction, the channel that it flows into) or "disconnected".
        channel: Identity of the channel that gave way.
        other: Identity of the channel that kept its course.
        width: Bankfull width of the channel that gave way, m.
        xy: (n, 2) float64 course that was abandoned, m, absolute, downstream order; pieces of several channels lie one
            after the other, cut by ``start``.
        start: (k + 1,) int64 offsets of the pieces in ``xy``.
    """

    time: float
    kind: str
    channel: int
    other: int
    width: float
    xy: np.ndarray
    start: np.ndarray

    def pieces(self) -> list[np.ndarray]:
        """Return the abandoned pieces, each an (n, 2) line."""
        return np.split(self.xy, self.start[1:-1])


@dataclasses.dataclass(frozen=True)
class Split:
    """A ring that a neck divided in two rings which both go on, ``ring_policy="both"``.

    Attributes:
        time: yr.
        channel: Identity of the ring, which goes on with the part that holds its first point.
        other: Identity of the new ring, the other part.
        width: Bankfull width at the neck, m.
        xy: (n, 2) float64 line of the new ring as it came off, in m, absolute, downstream order, from the one bank of
            the neck to the other.
    """

    time: float
    channel: int
    other: int
    width: float
    xy: np.ndarray


@dataclasses.dataclass(frozen=True)
class Record:
    """The state of a network at one time, in the precision of the device, so that a run can go on from it.

    Attributes:
        step: Number of steps done.
        time: yr.
        cutoffs_before: Number of cutoffs up to this time.
        collisions_before: Number of collisions up to this time.
        splits_before: Number of splits of rings up to this time.
        point_xy: (P, 2) m, relative to ``origin``.
        point_section: (P, 2) width and depth in m, or None where they are constant along each channel.
        channel_start: (C + 1,) int32.
        channel_spacing: (C,) m.
        channels: The table of the channels.
        node_xy: (N, 2) m, absolute.
        channel_fixed: (C, 6) what the step holds fixed between edits of the graph: least width, least depth, greatest
            width and spacing asked for, in m, and the labels of the nodes above and below in the search for collisions.
        channel_pace: (C,) greatest speed of the channel's points in the step, m/yr.
    """

    step: int
    time: float
    cutoffs_before: int
    collisions_before: int
    point_xy: np.ndarray
    point_section: np.ndarray | None
    channel_start: np.ndarray
    channel_spacing: np.ndarray
    channels: ChannelTable
    node_xy: np.ndarray
    channel_fixed: np.ndarray
    channel_pace: np.ndarray
    splits_before: int = 0

    @property
    def nbytes(self) -> int:
        """Memory of the arrays in bytes."""
        return sum(a.nbytes for a in vars(self).values() if isinstance(a, (np.ndarray, ChannelTable)))


RECORD_ARRAYS = (
    "point_xy", "point_section", "channel_start", "channel_spacing", "node_xy", "channel_fixed", "channel_pace",
)  # fmt: skip


class _Networks(Sequence):
    """The recorded networks, each built when it is asked for."""

    def __init__(self, history: History):
        self._history = history

    def __len__(self) -> int:
        return len(self._history.times)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        return self._history.network(index)


class History:
    """What a run recorded, in order of time; read it while the run goes on or after reopening it.

    Attributes:
        params: The run's constants.
        time_step: yr.
        seed: Seed of the run.
        origin: (2,) absolute position of the recorded points' zero, m.
        crs: Coordinate reference system or None.
        dtype: Precision of the run.
        cutoffs: List of :class:`Cutoff`, in order of time.
        collisions: List of :class:`Collision`, in order of time.
        splits: List of :class:`Split`, in order of time.
        stop_reason: Why the last run ended, or None while it has not.
        path: Folder that the run is streamed to, or None.
    """

    def __init__(
        self,
        params: MeanderParams | PathMeander,
        *,
        seed: int = 0,
        origin: Sequence[float] | np.ndarray = (0.0, 0.0),
        crs: str | None = None,
        dtype: str = "float64",
    ):
        """Start an empty history."""
        self.params = params
        self.seed = seed
        self.origin = np.array(origin, np.float64)
        self.crs = crs
        self.dtype = dtype
        self.cutoffs: list[Cutoff] = []
        self.collisions: list[Collision] = []
        self.splits: list[Split] = []
        self.stop_reason: StopReason | None = None
        self.path: Path | None = None
        self._times: list[float] = []
        self._steps: list[int] = []
        # A record in memory, or where to find it: (segment file, index in it).
        self._records: list[Record | tuple[Path, int]] = []
        self._pending: list[int] = []
        self._cutoffs_stored = 0
        self._collisions_stored = 0
        self._splits_stored = 0
        self._segments = 0
        self._flushed = time.monotonic()
        self._cache: tuple[Path, list[Record]] | None = None

    # ---- reading

    @property
    def times(self) -> np.ndarray:
        """Times of the records in yr, (K,) float64."""
        return np.array(self._times)

    @property
    def steps(self) -> np.ndarray:
        """Steps done at the records, (K,) int64."""
        return np.array(self._steps, np.int64)

    @property
    def networks(self) -> Sequence[RiverNetwork]:
        """The recorded networks, a sequence of K; each is built when asked for."""
        return _Networks(self)

    def __len__(self) -> int:
        return len(self._records)

    def record(self, index: int) -> Record:
        """Return one record, from memory or from disk."""
        held = self._records[index]
        if isinstance(held, Record):
            return held
        path, row = held
        if self._cache is None or self._cache[0] != path:
            self._cache = (path, _read_segment(path)[0])
        return self._cache[1][row]

    def network(self, index: int) -> RiverNetwork:
        """Return the network of one record, on the CPU device."""
        record = self.record(index)
        return RiverNetwork(
            record.point_xy,
            record.channel_start,
            record.channels,
            node_xy=record.node_xy,
            point_section=record.point_section,
            origin=self.origin,
            crs=self.crs,
            dtype=self.dtype,
        )

    def __repr__(self) -> str:
        if not self._times:
            return "History(empty)"
        reason = self.stop_reason.value if self.stop_reason else "still running"
        where = f", stored in {self.path}" if self.path else ""
        splits = f"{len(self.splits)} splits, " if self.splits else ""
        return (
            f"History({len(self)} records, {self._times[0]:.4g} to {self._times[-1]:.4g} yr, "
            f"{len(self.cutoffs)} cutoffs, {len(self.collisions)} collisions, {splits}{reason}{where})"
        )

    # ---- writing

    def append(self, record: Record) -> None:
        """Add a record; it goes to disk with its segment when the history is stored."""
        self._records.append(record)
        self._times.append(record.time)
        self._steps.append(record.step)
        if self.path is None:
            return
        self._pending.append(len(self._records) - 1)
        size = sum(self.record(k).nbytes for k in self._pending)
        if size >= SEGMENT_BYTES or time.monotonic() - self._flushed >= SEGMENT_SECONDS:
            self.flush()

    def store_in(self, path: str | os.PathLike) -> None:
        """Stream what is and will be recorded into a folder.

        Args:
            path: A folder to make, or the one that this history was loaded from, which then grows.

        Raises:
            FileExistsError: The folder holds something else.
            OSError: It cannot be written.
        """
        folder = Path(path)
        if self.path is not None and folder.resolve() == self.path.resolve():
            return
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise FileExistsError(f"{folder} exists and is not empty; name another folder, or resume the run in it")
        folder.mkdir(parents=True, exist_ok=True)
        self._pending = list(range(len(self._records)))
        if self.path is not None:  # stored elsewhere so far: bring the records along
            self._records = [self.record(k) for k in range(len(self._records))]
        self._cutoffs_stored = self._collisions_stored = self._splits_stored = self._segments = 0
        self.path = folder
        self._write_header()
        self.flush()

    def flush(self) -> None:
        """Write the pending records and events as one segment; nothing to do for a history in memory."""
        if self.path is None:
            return
        self._flushed = time.monotonic()
        cutoffs = self.cutoffs[self._cutoffs_stored :]
        collisions = self.collisions[self._collisions_stored :]
        splits = self.splits[self._splits_stored :]
        if not (self._pending or cutoffs or collisions or splits):
            return
        target = self.path / f"segment_{self._segments:06d}.npz"
        _write_segment(target, [self.record(k) for k in self._pending], cutoffs, collisions, splits)
        for row, k in enumerate(self._pending):
            self._records[k] = (target, row)
        self._pending = []
        self._cutoffs_stored = len(self.cutoffs)
        self._collisions_stored = len(self.collisions)
        self._splits_stored = len(self.splits)
        self._segments += 1

    def close(self, reason: StopReason) -> None:
        """Note why the run ended and write what is pending."""
        self.stop_reason = reason
        self.flush()
        if self.path is not None:
            self._write_header()

    def save(self, path: str | os.PathLike) -> None:
        """Write everything to one ``.npz`` file, or to a new folder for any other name.

        Raises:
            FileExistsError: The folder holds something already (a file is replaced).
            OSError: It cannot be written; nothing half-written is left.
        """
        target = Path(path)
        if target.suffix == ".npz":
            records = [self.record(k) for k in range(len(self))]
            _write_segment(target, records, self.cutoffs, self.collisions, self.splits, header=self._header())
            return
        copy = History(self.params, seed=self.seed, origin=self.origin, crs=self.crs, dtype=self.dtype)
        copy.cutoffs = list(self.cutoffs)
        copy.collisions = list(self.collisions)
        copy.splits = list(self.splits)
        for k in range(len(self)):
            copy.append(self.record(k))
        copy.stop_reason = self.stop_reason
        copy.store_in(target)

    @classmethod
    def load(cls, path: str | os.PathLike) -> History:
        """Reopen a run that was saved or streamed; records of a folder are read when asked for.

        Raises:
            FileNotFoundError: Nothing is there.
            ValueError: It is not a run, or is damaged.
        """
        source = Path(path)
        if not source.exists():
            raise FileNotFoundError(f"no run at {source}")
        if source.is_file():
            records, cutoffs, collisions, splits, header = _read_segment(source)
            history = cls._from_header(header, source)
            history.cutoffs, history.collisions, history.splits = cutoffs, collisions, splits
            for record in records:
                history.append(record)
            return history
        header_file = source / HEADER
        if not header_file.is_file():
            raise ValueError(f"{source} is not a run: it has no {HEADER}")
        history = cls._from_header(header_file.read_text(), source)
        for segment in sorted(source.glob("segment_*.npz")):
            records, cutoffs, collisions, splits, _ = _read_segment(segment)
            history.cutoffs += cutoffs
            history.collisions += collisions
            history.splits += splits
            for row, record in enumerate(records):
                history.append(record)
                history._records[-1] = (segment, row)
        history.path = source
        history._segments = len(list(source.glob("segment_*.npz")))
        history._cutoffs_stored = len(history.cutoffs)
        history._collisions_stored = len(history.collisions)
        history._splits_stored = len(history.splits)
        return history

    def _header(self) -> str:
        values = {
            "format": FORMAT,
            "solver": next(name for name, kind in SOLVER_PARAMS.items() if isinstance(self.params, kind)),
            "params": dataclasses.asdict(self.params),
            "seed": self.seed,
            "origin": self.origin.tolist(),
            "crs": self.crs,
            "dtype": self.dtype,
            "stop_reason": self.stop_reason.name if self.stop_reason else None,
        }
        return json.dumps(values, indent=2)

    def _write_header(self) -> None:
        assert self.path is not None
        temporary = self.path / (HEADER + ".tmp")
        temporary.write_text(self._header())
        os.replace(temporary, self.path / HEADER)

    @classmethod
    def _from_header(cls, text: str | None, source: Path) -> History:
        try:
            values = json.loads(text or "")
            if values["format"] != FORMAT:
                raise ValueError(f"{source} has format {values['format']!r}; this version reads {FORMAT!r}")
            history = cls(
                SOLVER_PARAMS[values.get("solver", "migration")](**values["params"]),
                seed=values["seed"],
                origin=values["origin"],
                crs=values["crs"],
                dtype=values["dtype"],
            )
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(f"{source} is not a warpriver run or is damaged ({error})") from error
        if values["stop_reason"]:
            history.stop_reason = StopReason[values["stop_reason"]]
        return history


def _write_segment(
    target: Path,
    records: Sequence[Record],
    cutoffs: Sequence[Cutoff],
    collisions: Sequence[Collision],
    splits: Sequence[Split],
    header: str | None = None,
) -> None:
    """Write records and events as one archive, under another name first."""
    arrays: dict[str, Any] = {
        "record_step": np.array([r.step for r in records], np.int64),
        "record_time": np.array([r.time for r in records], np.float64),
        "record_cutoffs": np.array([r.cutoffs_before for r in records], np.int64),
        "record_collisions": np.array([r.collisions_before for r in records], np.int64),
        "cutoff_time": np.array([c.time for c in cutoffs], np.float64),
        "cutoff_channel": np.array([c.channel for c in cutoffs], np.int64),
        "cutoff_width": np.array([c.width for c in cutoffs], np.float64),
        "cutoff_start": np.cumsum([0] + [len(c.xy) for c in cutoffs]),
        "cutoff_xy": np.concatenate([c.xy for c in cutoffs]) if cutoffs else np.zeros((0, 2)),
        "collision_time": np.array([c.time for c in collisions], np.float64),
        "collision_kind": np.array([c.kind for c in collisions], "U16"),
        "collision_channel": np.array([c.channel for c in collisions], np.int64),
        "collision_other": np.array([c.other for c in collisions], np.int64),
        "collision_width": np.array([c.width for c in collisions], np.float64),
        "collision_start": np.cumsum([0] + [len(c.xy) for c in collisions]),
        "collision_xy": np.concatenate([c.xy for c in collisions]) if collisions else np.zeros((0, 2)),
        "collision_pieces_start": np.cumsum([0] + [len(c.start) for c in collisions]),
        "collision_pieces": np.concatenate([c.start for c in collisions]) if collisions else np.zeros(0, np.int64),
    }
    if splits:
        arrays |= {
            "split_time": np.array([s.time for s in splits], np.float64),
            "split_channel": np.array([s.channel for s in splits], np.int64),
            "split_other": np.array([s.other for s in splits], np.int64),
            "split_width": np.array([s.width for s in splits], np.float64),
            "split_start": np.cumsum([0] + [len(s.xy) for s in splits]),
            "split_xy": np.concatenate([s.xy for s in splits]),
        }
    if any(r.splits_before for r in records):
        arrays["record_splits"] = np.array([r.splits_before for r in records], np.int64)
    tables = [r.channels for r in records]
    columns = list(tables[0]) if tables else []
    arrays["columns"] = np.array(columns, str)
    arrays["columns_start"] = np.cumsum([0] + [len(table) for table in tables])
    arrays |= {f"column_{k}": np.concatenate([table[name] for table in tables]) for k, name in enumerate(columns)}
    for name in RECORD_ARRAYS:
        parts = [getattr(r, name) for r in records]
        if not parts or parts[0] is None:
            continue
        arrays[name] = np.concatenate(parts)
        arrays[f"{name}_start"] = np.cumsum([0] + [len(p) for p in parts])
    if header is not None:
        arrays["header"] = np.array(header)
    temporary = target.with_name(target.name + ".tmp")
    try:
        with open(temporary, "wb") as file:
            np.savez(file, **arrays)
        os.replace(temporary, target)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise OSError(error.errno, f"cannot write {target}: {error.strerror or error}") from error


# What one archive holds: records, cutoffs, collisions, splits, and the header where it is a whole run.
Segment = tuple[list[Record], list[Cutoff], list[Collision], list[Split], str | None]


def _read_segment(path: Path) -> Segment:
    """Read one archive back."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            data = {name: archive[name] for name in archive.files}
        return _decode_segment(data)
    except (zipfile.BadZipFile, KeyError, ValueError, EOFError) as error:
        raise ValueError(f"{path} is not a warpriver run or is damaged ({error})") from error


def _decode_tables(data: dict[str, np.ndarray]) -> list[ChannelTable]:
    start = data["columns_start"]
    values = {str(name): data[f"column_{k}"] for k, name in enumerate(data["columns"])}
    tables = []
    for a, b in itertools.pairwise(start.tolist()):
        columns = {name: array[a:b] for name, array in values.items()}
        tables.append(
            ChannelTable(
                **{name: array for name, array in columns.items() if name in COLUMNS},
                extra={name: array for name, array in columns.items() if name not in COLUMNS},
            )
        )
    return tables


def _decode_segment(data: dict[str, np.ndarray]) -> Segment:
    def split(name: str) -> Iterator[np.ndarray | None]:
        if name not in data:
            return iter([None] * len(data["record_step"]))
        return iter(np.split(data[name], data[f"{name}_start"][1:-1]))

    columns = [split(name) for name in RECORD_ARRAYS]
    records = [
        Record(
            int(step),
            float(at),
            int(cutoffs_before),
            int(collisions_before),
            splits_before=int(splits_before),
            channels=table,
            **dict(zip(RECORD_ARRAYS, arrays, strict=True)),
        )
        for step, at, cutoffs_before, collisions_before, splits_before, table, *arrays in zip(
            data["record_step"],
            data["record_time"],
            data["record_cutoffs"],
            data["record_collisions"],
            # Runs without splits of rings, and those stored before there were any, do not have it.
            data.get("record_splits", np.zeros(len(data["record_step"]), np.int64)),
            _decode_tables(data),
            *columns,
            strict=True,
        )
    ]
    loops = np.split(data["cutoff_xy"], data["cutoff_start"][1:-1]) if len(data["cutoff_time"]) else []
    cutoffs = [
        Cutoff(float(at), int(channel), float(width), xy)
        for at, channel, width, xy in zip(
            data["cutoff_time"], data["cutoff_channel"], data["cutoff_width"], loops, strict=True
        )
    ]
    names = ("time", "kind", "channel", "other", "width")
    collisions = (
        [
            Collision(float(at), str(kind), int(channel), int(other), float(width), xy, start)
            for at, kind, channel, other, width, xy, start in zip(
                *(data[f"collision_{name}"] for name in names),
                np.split(data["collision_xy"], data["collision_start"][1:-1]),
                np.split(data["collision_pieces"], data["collision_pieces_start"][1:-1]),
                strict=True,
            )
        ]
        if len(data["collision_time"])
        else []
    )
    splits = []
    if "split_time" in data:
        splits = [
            Split(float(at), int(channel), int(other), float(width), xy)
            for at, channel, other, width, xy in zip(
                *(data[f"split_{name}"] for name in ("time", "channel", "other", "width")),
                np.split(data["split_xy"], data["split_start"][1:-1]),
                strict=True,
            )
        ]
    header = str(data["header"]) if "header" in data else None
    return records, cutoffs, collisions, splits, header
