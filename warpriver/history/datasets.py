"""A history as a data set of arrays with names: xarray in memory, Zarr on disk; CF conventions, UGRID names.

Records have different numbers of points, and so all of them lie end to end, as contiguous ragged arrays (CF, section
9.3): ``record_nodes`` says how many nodes each record has. All courses of all times together are one 1-D mesh of UGRID,
whose nodes know their record.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpriver.crs import pyproj_or_none
from warpriver.errors import InputError, OutputExistsError, PathError
from warpriver.extras import need
from warpriver.history.events import EventLog, event_fields
from warpriver.validate import whole

if TYPE_CHECKING:
    import xarray

    from warpriver.history.history import History

__all__ = ["dataset_of", "write_zarr"]

# What belongs to the nodes: unit, meaning, standard name.
NODE_NAMES = {
    "node_x": ("m", "x of a point of a channel", "projection_x_coordinate"),
    "node_y": ("m", "y of a point of a channel", "projection_y_coordinate"),
    "node_width": ("m", "bankfull width", ""),
    "node_depth": ("m", "bankfull depth", ""),
}
CHANNEL_UNITS = {"width": "m", "depth": "m", "discharge": "m3 s-1", "drainage_area": "m2", "slope": "1"}


def dataset_of(history: History, every: int = 1) -> xarray.Dataset:
    """Return a history as ``xarray.Dataset``, see :meth:`History.to_xarray`."""
    (module,) = need("History.to_xarray", "xarray")
    every = whole(every, "every", 1, "records")
    if not len(history):
        raise InputError("the history holds no record; run the simulation first")
    records = sorted({*range(0, len(history), every), len(history) - 1})
    values = _records(history, records) | _events(history.events) | _mesh(history.crs)
    made: xarray.Dataset = module.Dataset(values, attrs=_about(history))
    return made


def write_zarr(history: History, path: str | os.PathLike[str], every: int = 1) -> None:
    """Write a history as a Zarr store, see :meth:`History.to_zarr`."""
    need("History.to_zarr", "xarray", "zarr")
    if os.path.exists(path) and (not os.path.isdir(path) or os.listdir(path)):
        raise OutputExistsError(f"{path} exists and is not empty; name another folder")
    data = dataset_of(history, every)
    try:
        # Without dates: times are years since the beginning of the run.
        data.to_zarr(os.fspath(path), mode="w-", consolidated=False)
    except OSError as error:
        raise PathError.of(error, f"cannot write {path}") from error


def _about(history: History) -> dict[str, Any]:
    from warpriver import __version__

    return {
        "Conventions": "CF-1.11 UGRID-1.0",
        "title": "River channels that migrate",
        "source": f"warpriver {__version__}",
        "seed": int(history.seed),
    }


def _named(dims: Any, values: Any, about: str, unit: str = "", **attributes: Any) -> tuple[Any, Any, dict[str, Any]]:
    told = {"long_name": about} | ({"units": unit} if unit else {}) | attributes
    return dims, values, told


def _records(history: History, records: Sequence[int]) -> dict[str, Any]:
    """Return the networks of records, end to end."""
    counts, channels, node_xy, section, edges, edge_record, owner = [], [], [], [], [], [], []
    tables: dict[str, list[np.ndarray]] = {}
    before = channels_before = 0
    for place, k in enumerate(records):
        network = history.networks[k]
        start = network.starts().astype(np.int64)
        head = np.delete(np.arange(start[-1]), start[1:] - 1)
        closed = np.flatnonzero(network.channel_closed)
        pairs = np.stack([head, head + 1], axis=1)
        pairs = np.concatenate([pairs, np.stack([start[closed + 1] - 1, start[closed]], axis=1)])
        counts.append(int(start[-1]))
        channels.append(network.channel_count)
        node_xy.append(network.points())
        section.append(
            np.stack([np.concatenate(network.point_widths()), np.concatenate(network.point_depths())], axis=1)
        )
        owner.append(channels_before + np.repeat(np.arange(network.channel_count), np.diff(start)))
        edges.append(before + pairs)
        edge_record.append(np.full(len(pairs), place, np.int32))
        for name in network.channels:
            tables.setdefault(name, []).append(np.asarray(network.channels[name]))
        before += int(start[-1])
        channels_before += network.channel_count
    xy, sections = np.concatenate(node_xy), np.concatenate(section)
    columns = {"node_x": xy[:, 0], "node_y": xy[:, 1], "node_width": sections[:, 0], "node_depth": sections[:, 1]}
    at = np.repeat(np.arange(len(records), dtype=np.int32), counts)
    values: dict[str, Any] = {
        "time": _named("record", history.times[records], "time since the beginning of the run", "year"),
        "step": _named("record", history.steps[records], "steps done", "1"),
        "record_nodes": _named("record", np.array(counts), "nodes of a record", sample_dimension="node"),
        "record_channels": _named("record", np.array(channels), "channels of a record", sample_dimension="channel"),
        "node_record": _named("node", at, "record of a node", "1"),
        "node_channel": _named("node", np.concatenate(owner), "channel of a node", "1"),
        "edge_nodes": _named(
            ("edge", "two"), np.concatenate(edges), "nodes of an edge", cf_role="edge_node_connectivity", start_index=0
        ),
        "edge_record": _named("edge", np.concatenate(edge_record), "record of an edge", "1"),
    }
    for name, (unit, about, standard) in NODE_NAMES.items():
        told = {"standard_name": standard} if standard else {"mesh": "network", "location": "node"}
        values[name] = _named("node", columns[name], about, unit, grid_mapping="crs", **told)
    for name, parts in tables.items():
        joined = np.concatenate(parts)
        joined = joined.astype(np.int8) if joined.dtype.kind == "b" else joined
        # Words have no form that all readers of Zarr know.
        if joined.dtype.kind in "iuf" and sum(map(len, parts)) == channels_before == sum(channels):
            values[f"channel_{name}"] = _named("channel", joined, name.replace("_", " "), CHANNEL_UNITS.get(name, "1"))
    return values


def _mesh(crs: str | None) -> dict[str, Any]:
    """Return the variable that describes the mesh, and the one of the CRS."""
    topology = {
        "cf_role": "mesh_topology",
        "long_name": "channels of all records",
        "topology_dimension": 1,
        "node_coordinates": "node_x node_y",
        "edge_node_connectivity": "edge_nodes",
        "node_dimension": "node",
        "edge_dimension": "edge",
    }
    reference: dict[str, Any] = {}
    if crs is not None:
        pyproj = pyproj_or_none()
        reference = dict(pyproj.CRS(crs).to_cf()) if pyproj else {}
        reference |= {"spatial_ref": reference.get("crs_wkt", crs)}
    return {"network": ((), np.int32(0), topology), "crs": ((), np.int32(0), reference)}


def _events(events: EventLog) -> dict[str, Any]:
    """Return when events happened and what they tell in numbers, and the lines that they left end to end."""
    kinds: dict[str, int] = {}
    number: list[int] = []
    numbers: dict[str, list[float]] = {name: [] for name in ("channel", "width", "depth", "discharge")}
    lines, sections = [], []
    for event in events:
        number.append(kinds.setdefault(event.kind, len(kinds)))
        for name, column in numbers.items():
            value = getattr(event, name, None)
            column.append(np.nan if value is None else float(value))
        names = [field.name for field in event_fields(type(event))]
        line = getattr(event, "xy", None) if "xy" in names else None
        known = line is not None and line.ndim == 2
        lines.append(np.asarray(line, np.float64) if known else np.empty((0, 2)))
        section = getattr(event, "section", None)
        if section is None:
            pair = [getattr(event, name, None) for name in ("width", "depth")]
            section = np.tile([np.nan if value is None else float(value) for value in pair], (len(lines[-1]), 1))
        sections.append(section[: len(lines[-1])])
    flags: dict[str, Any] = {"flag_values": np.arange(len(kinds), dtype=np.int8), "flag_meanings": " ".join(kinds)}
    values: dict[str, Any] = {
        "event_time": _named("event", events.times, "time of an event", "year"),
        "event_kind": _named("event", np.array(number, np.int8), "kind of an event", **flags),
    }
    units = {"width": "m", "depth": "m", "discharge": "m3 s-1"}
    for name, told in numbers.items():
        values[f"event_{name}"] = _named("event", np.array(told), f"{name} of an event", units.get(name, "1"))
    xy = np.concatenate(lines) if lines else np.empty((0, 2))
    section = np.concatenate(sections) if sections else np.empty((0, 2))
    count = np.array([len(line) for line in lines], np.int64)
    values["event_points"] = _named("event", count, "points of the course left", sample_dimension="event_point")
    for k, axis in enumerate("xy"):
        values[f"event_{axis}"] = _named("event_point", xy[:, k], f"{axis} of the course that an event left", "m")
    for k, name in enumerate(("width", "depth")):
        about = f"bankfull {name} along the course that an event left"
        values[f"event_point_{name}"] = _named("event_point", section[:, k], about, "m")
    return values
