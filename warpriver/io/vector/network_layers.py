"""Networks as features: their lines, the nodes and, where sections vary, the points along the lines."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import warn
from warpriver.extras import need
from warpriver.io.vector.attributes import LISTS, SHORT_NAMES, list_names, write_columns
from warpriver.io.vector.extras import EXTRA, extra_kinds
from warpriver.io.vector.layers import (
    GEOPACKAGE,
    NEEDS,
    Layer,
    crs_member,
    geojson_text,
    plain_values,
    replaced_layer,
    write_geopackage,
    write_layer,
)
from warpriver.network import RiverNetwork

__all__ = ["FRAME", "NODES", "POINTS", "network_layers", "point_lists", "write_features", "write_geojson"]

# The layers of nodes and of points that belong to a layer of channels in a GeoPackage; the key of what no attribute
# holds elsewhere.
NODES, POINTS = "_nodes", "_points"
FRAME = "warpriver"


def write_geojson(network: RiverNetwork, path: Path, layer: str) -> None:
    """Write GeoJSON with a "crs" member."""
    columns = {name: plain_values(c) for name, c in write_columns(network).items()}
    features = [
        json.dumps(
            {
                "type": "Feature",
                "properties": {name: column[c] for name, column in columns.items()},
                "geometry": {"type": "LineString", "coordinates": points.tolist()},
            },
            allow_nan=False,
        )
        for c, points in enumerate(_coordinates(network))
    ]
    members = {"name": layer, "crs": crs_member(network.crs), FRAME: _frame_of(network)}
    data = geojson_text(members, features).encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix.lower() == ".gz" else data)


def write_features(network: RiverNetwork, path: Path, layer: str) -> None:
    """Write a network to a GeoPackage, shapefile, FlatGeobuf or GeoParquet; the suffix says to which."""
    suffix = path.suffix.lower()
    need(f"writing {suffix}", *NEEDS[suffix])
    if suffix == GEOPACKAGE:
        write_geopackage(path, network_layers(network, layer), network.crs, stale=[layer + POINTS])
        return
    if suffix == ".shp" and network.point_section is not None:
        warn(
            f"{path}: a shapefile holds one width and one depth for each channel: their means are written; those of "
            "the points are kept by .gpkg, .geojson, .parquet, .fgb and .csv"
        )
    channels = _channel_layer(network, layer, suffix)
    with replaced_layer(path, channels, network.crs) as temporary:
        write_layer(channels, temporary, path, network.crs)


def network_layers(network: RiverNetwork, name: str) -> list[Layer]:
    """Return the layers that a GeoPackage has of a network: channels, nodes and, where sections vary, points."""
    (shapely,) = need("writing .gpkg", "shapely")
    layers = [_channel_layer(network, name, GEOPACKAGE), _node_layer(shapely, network, name + NODES)]
    return layers + ([_point_layer(shapely, network, name + POINTS)] if network.point_section is not None else [])


def _channel_layer(network: RiverNetwork, name: str, suffix: str) -> Layer:
    """Return the channels as lines, with the attributes that the format of a suffix has a place for."""
    (shapely,) = need(f"writing {suffix}", "shapely")
    columns = write_columns(network)
    if suffix in (GEOPACKAGE, ".shp"):
        columns = {name: column for name, column in columns.items() if not isinstance(column, list)}
    if suffix == ".shp":
        columns = {SHORT_NAMES.get(name, name): column for name, column in columns.items()}
    frame = _frame_of(network)
    if suffix == GEOPACKAGE:
        del frame["node_xy"]  # they are a layer of their own
    lines = _coordinates(network)
    owner = np.repeat(np.arange(network.channel_count), [len(points) for points in lines])
    geometry = shapely.linestrings(np.concatenate(lines), indices=owner)
    kind = "LineString" if network.point_z is None else "LineString Z"
    return Layer(name, kind, geometry, columns, "channels", json.dumps(frame))


def _node_layer(shapely: Any, network: RiverNetwork, name: str) -> Layer:
    """Return the nodes as points."""
    arriving = np.bincount(network.channel_to, minlength=network.node_count)
    leaving = np.bincount(network.channel_from, minlength=network.node_count)
    kind = np.where(arriving == 0, "source", np.where(leaving == 0, "outlet", "junction"))
    columns = {"node_id": np.arange(network.node_count), "kind": kind}
    return Layer(name, "Point", shapely.points(network.node_xy), columns, "nodes")


def _point_layer(shapely: Any, network: RiverNetwork, name: str) -> Layer:
    """Return the points along the channels with the section at each."""
    lines = _coordinates(network)
    counts = [len(points) for points in lines]
    distance = [np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(p[:, :2], axis=0).T))]) for p in lines]
    columns = {
        "channel_id": np.repeat(network.channel_id, counts),
        "point": np.concatenate([np.arange(n) for n in counts]),
        "distance_m": np.concatenate(distance),
        "width_m": np.concatenate(network.point_widths(close=True)),
        "depth_m": np.concatenate(network.point_depths(close=True)),
    }
    kind = "Point" if network.point_z is None else "Point Z"
    return Layer(name, kind, shapely.points(np.concatenate(lines)), columns, "points")


def point_lists(columns: dict[str, np.ndarray], channel_id: np.ndarray) -> dict[str, np.ndarray]:
    """Return what a layer of points says as the lists that other formats have: a list for each channel, by attribute.

    Args:
        columns: Its attributes, of which channel_id, point, width_m and depth_m count.
        channel_id: Identities of the channels.
    """
    order = np.lexsort((columns["point"], columns["channel_id"]))
    owner = columns["channel_id"][order]
    first, last = np.searchsorted(owner, channel_id, "left"), np.searchsorted(owner, channel_id, "right")
    lists = {}
    for role in LISTS:
        values, made = columns[f"{role}_m"][order], np.empty(len(channel_id), object)
        made[:] = [values[a:b] if b > a else None for a, b in zip(first.tolist(), last.tolist(), strict=True)]
        lists[list_names(role)[0]] = made
    return lists


def _frame_of(network: RiverNetwork) -> dict[str, Any]:
    """Return what no attribute holds: the zero of the device coordinates, the nodes by number, the free columns."""
    extra = {EXTRA: extra_kinds(network.channels)} if network.channels.extra else {}
    return {"origin": network.origin.tolist(), "node_xy": network.node_xy.tolist(), **extra}


def _coordinates(network: RiverNetwork) -> list[np.ndarray]:
    """Return the points of the channels, (n, 2), or (n, 3) with elevations."""
    lines, elevations = network.polylines(close=True), network.point_elevations(close=True)
    if elevations is None:
        return lines
    return [np.column_stack([xy, z]) for xy, z in zip(lines, elevations, strict=True)]
