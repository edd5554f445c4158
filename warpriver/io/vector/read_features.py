"""Lines read from features: GeoJSON, GeoPackage, GeoParquet, shapefile, FlatGeobuf."""

from __future__ import annotations

import json
import logging
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.io.crs import within_degrees
from warpriver.io.files import check_unpacked, decoded, plain_path
from warpriver.io.vector.attributes import (
    LISTS,
    family_of,
    is_no_value,
    is_ours,
    read_role,
    tell_lost_names,
    useful_names,
)
from warpriver.io.vector.extras import EXTRA, stated_extra, wanted_extra
from warpriver.io.vector.layers import NEEDS, OGR, PARQUET, reason, refuse_others
from warpriver.io.vector.network_layers import FRAME, NODES, POINTS, point_lists
from warpriver.io.vector.point_lists import PointLists
from warpriver.io.vector.source import Line, Source, checked_points

__all__ = ["read_geojson", "read_ogr", "read_parquet"]

log = logging.getLogger("warpriver")


# A feature is its kind of geometry, the (n, 2) or (n, 3) arrays of its parts, and its attributes by lower-case name.
_Feature = tuple[str, list[np.ndarray], dict[str, Any]]


def read_geojson(path: Path, wanted: Sequence[str], asked: Iterable[str] | None) -> Source:
    """Read lines from GeoJSON."""
    try:
        root = json.loads(decoded(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not whole JSON ({error}); is it cut short?") from error
    kind = root.get("type") if isinstance(root, dict) else None
    if kind == "FeatureCollection":
        features = root.get("features")
    elif kind == "Feature":
        features = [root]
    else:
        features = [{"geometry": root}] if kind is not None and "coordinates" in root else None
    if not isinstance(features, list) or not all(isinstance(f, dict) for f in features):
        raise InputError(f"{path}: not GeoJSON; expected a FeatureCollection, a Feature or a geometry")
    names = {n for f in features if isinstance(f.get("properties"), dict) for n in f["properties"]}
    extra = wanted_extra(path, _frame_extra(root.get(FRAME)), asked, names)
    source = Source(path, [], None, family=family_of(names), extra=extra, ours=is_ours(names))
    tell_lost_names(path, names, wanted)
    _read_lines(source, (_geojson_feature(path, k, f) for k, f in enumerate(features)), wanted)
    member = root.get("crs")
    named = member.get("properties") if isinstance(member, dict) else None
    name = (named.get("name") or named.get("code")) if isinstance(named, dict) else None
    source.crs = f"EPSG:{name}" if str(name).isdigit() else None if name is None else str(name)
    source.lonlat = "crs" not in root and within_degrees(source.lines)
    return _take_frame(source, root.get(FRAME))


def read_ogr(path: Path, suffix: str, layer: str | None, wanted: Sequence[str], asked: Iterable[str] | None) -> Source:
    """Read lines through GDAL."""
    need(f"reading {suffix}", *NEEDS[suffix])
    refuse_others(path, suffix)
    with plain_path(path) as plain:
        return _read_ogr(path, plain, suffix, layer, wanted, asked)


def _read_ogr(
    path: Path, plain: Path, suffix: str, layer: str | None, wanted: Sequence[str], asked: Iterable[str] | None
) -> Source:
    """Read the lines of a file that GDAL opens by the name ``plain``."""
    pyogrio, shapely, raw = need(f"reading {suffix}", *NEEDS[suffix], "pyogrio.raw")
    try:
        layers = pyogrio.list_layers(plain)
        chosen = _line_layer(path, layer, layers)
        info = pyogrio.read_info(plain, layer=chosen)
        frame = (info.get("layer_metadata") or {}).get(FRAME)
        extra = wanted_extra(path, _frame_extra(frame), asked, info["fields"])
        useful = useful_names(info["fields"], wanted, [*extra, "length_m"])
        names = [name for name in info["fields"] if name in useful]
        meta, _, wkb, data = raw.read(plain, layer=chosen, columns=names, force_2d=not _has_z(info))
        beside = {str(name) for name, _ in layers}
        nodes = _read_nodes(shapely, raw, plain, chosen + NODES) if chosen + NODES in beside else {}
        points = _read_points(raw, plain, chosen + POINTS) if chosen + POINTS in beside else {}
    except (RuntimeError, IndexError, UnicodeDecodeError) as error:
        why = reason(error).replace(str(plain), path.name)
        raise InputError(f"{path}: cannot be read as {OGR[suffix]} ({why}); is it cut short?") from error
    if wkb is None or len(wkb) < info["features"]:
        count = 0 if wkb is None else len(wkb)
        raise InputError(f"{path}: {count} of {info['features']} features can be read; is it cut short?")
    attributes = {name.lower(): column for name, column in zip(meta["fields"], data, strict=True)}
    if points and "channel_id" in attributes:
        attributes |= point_lists(points, np.asarray(attributes["channel_id"]))
    with np.errstate(invalid="ignore"):  # a NaN is told by _read_lines
        geometries = shapely.from_wkb(wkb, on_invalid="ignore")
    source = Source(path, [], meta["crs"], family=family_of(info["fields"]), extra=extra, ours=is_ours(info["fields"]))
    source.crs_beside = suffix == ".shp"
    tell_lost_names(path, info["fields"], wanted)
    _read_lines(source, _shapely_features(shapely, geometries, attributes), wanted)
    _take_frame(source, frame)
    source.node_xy.update(nodes)
    return source


def read_parquet(path: Path, wanted: Sequence[str], asked: Iterable[str] | None) -> Source:
    """Read lines from GeoParquet."""
    geopandas, pyarrow, shapely, parquet = need("reading .parquet", *NEEDS[PARQUET], "pyarrow.parquet")
    try:
        # From a file that is open: a path would be looked at for a protocol.
        with path.open("rb") as file:
            told = parquet.read_metadata(file)
            unpacked = sum(told.row_group(k).total_byte_size for k in range(told.num_row_groups))
            check_unpacked(path, path.stat().st_size, unpacked)
            frame = geopandas.read_parquet(file)
        geometries = frame.geometry.to_numpy()
        texts = [str(name) for name in frame.columns]
        extra = wanted_extra(path, _frame_extra(frame.attrs.get(FRAME)), asked, texts)
        useful = useful_names(texts, wanted, [*extra, "length_m"])
        attributes = {str(n).lower(): frame[n].to_numpy(dtype=object, na_value=None) for n in useful}
    except InputError:
        raise
    except (RuntimeError, ValueError, LookupError, TypeError, OSError, pyarrow.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as GeoParquet ({reason(error)}); is it cut short?") from error
    source = Source(
        path,
        [],
        None if frame.crs is None else frame.crs.to_wkt(),
        family=family_of(texts),
        extra=extra,
        ours=is_ours(texts),
    )
    tell_lost_names(path, texts, wanted)
    _read_lines(source, _shapely_features(shapely, geometries, attributes), wanted)
    return _take_frame(source, frame.attrs.get(FRAME))


def _read_lines(source: Source, features: Iterable[_Feature], wanted: Sequence[str]) -> None:
    """Turn features into the lines of a source, or raise ``ValueError`` if none is a line."""
    path, lists = source.path, PointLists(source.path)
    others: Counter[str] = Counter()
    for k, (kind, parts, attributes) in enumerate(features):
        if kind not in ("LineString", "MultiLineString") or not any(map(len, parts)):
            others[f"{'empty ' if 'LineString' in kind else ''}{kind}"] += 1
            continue
        where = f"{path}, feature {k}"
        for points in _chained([part for part in parts if len(part)]):
            line = Line(checked_points(points[:, :2].copy(), where), where, feature=k)
            if points.shape[1] > 2:
                line.z = np.where(is_no_value(points[:, 2], "z"), np.nan, points[:, 2])
            line.extra = {name: attributes.get(name.lower()) for name in source.extra}
            for role in wanted:
                value = lists.read(attributes, role, line.xy) if role in LISTS else None
                whole = read_role(attributes, source.family, role, where)
                setattr(line, role, whole if value is None else value)
                if value is not None:
                    setattr(line, f"mean_{role}", whole)
                    line.lists = (*line.lists, role)
            source.lines.append(line)
    lists.tell()
    found = ", ".join(f"{count} {kind}" for kind, count in others.items())
    if not source.lines:
        raise InputError(f"{path}: no lines in it; it holds {found or 'no features'}")
    if others:
        log.info("%s: passed over %s", path, found)


def _chained(parts: list[np.ndarray]) -> list[np.ndarray]:
    """Join parts that follow end to start; where more than two parts meet, none is joined."""
    parts = [part for part in parts if (part[1:, :2] != part[:1, :2]).any()] or parts[:1]
    heads = [(float(p[0, 0]), float(p[0, 1])) for p in parts]
    tails = [(float(p[-1, 0]), float(p[-1, 1])) for p in parts]
    starts, ends = Counter(heads), Counter(tails)
    joint = {point for point in starts if starts[point] == ends[point] == 1}
    follower = {head: k for k, head in enumerate(heads) if head in joint}
    chains, used = [], set()
    # Heads of chains first; what is left after them are rings, which start with their first part.
    for k in sorted(range(len(parts)), key=lambda k: heads[k] in joint):
        chain: list[np.ndarray] = []
        following: int | None = k
        while following is not None and following not in used:
            used.add(following)
            chain.append(parts[following] if not chain else parts[following][1:])
            following = follower.get(tails[following])
        if chain:
            chains.append((k, np.concatenate(chain)))
    return [xy for _, xy in sorted(chains, key=lambda item: item[0])]


def _geojson_feature(path: Path, k: int, feature: dict[str, Any]) -> _Feature:
    """Return one GeoJSON object as a feature."""
    geometry, properties = feature.get("geometry") or {}, feature.get("properties") or {}
    try:
        kind = str(geometry.get("type"))
        attributes = {str(name).lower(): value for name, value in properties.items()}
        if kind not in ("LineString", "MultiLineString"):
            return kind, [], attributes
        parts: list[Any] = geometry["coordinates"]
        parts = [parts] if kind == "LineString" else parts
        size = 3 if all(len(p) > 2 for part in parts for p in part) else 2
        arrays = [np.array([p[:size] for p in part], np.float64).reshape(-1, size) for part in parts]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}, feature {k}: its coordinates are not pairs of numbers ({error})") from error
    return kind, arrays, attributes


def _shapely_features(shapely: Any, geometries: np.ndarray, attributes: dict[str, Any]) -> Iterator[_Feature]:
    """Yield shapely geometries, with columns of attributes, as features."""
    pieces, owner = shapely.get_parts(geometries, return_index=True)
    counts = shapely.get_num_coordinates(pieces)
    points = shapely.get_coordinates(pieces, include_z=bool(shapely.has_z(pieces).any()))
    split = np.split(points, np.cumsum(counts)[:-1])
    parts: list[list[np.ndarray]] = [[] for _ in geometries]
    for k, xy in zip(owner, split, strict=False):
        parts[k].append(xy)
    for k, geometry in enumerate(geometries):
        kind = "unreadable geometry" if geometry is None else geometry.geom_type
        yield kind, parts[k], {name: column[k] for name, column in attributes.items()}


def _line_layer(path: Path, layer: str | None, layers: np.ndarray) -> str:
    """Return the layer to read: the named one, or the only one that holds lines."""
    listed = ", ".join(f"{name} ({kind})" for name, kind in layers)
    if layer is not None:
        if layer not in [name for name, _ in layers]:
            raise InputError(f"{path}: no layer {layer!r} in it; it has {listed}")
        return layer
    kinds = {name: str(kind) for name, kind in layers if kind is not None}
    lines = [name for name, kind in kinds.items() if "LineString" in kind]
    lines = lines or [name for name, kind in kinds.items() if "Unknown" in kind or "Collection" in kind]
    if not lines:
        raise InputError(f"{path}: no lines in it; it has {listed or 'no layers'}")
    # Of the layers of a run the one that is a network has nodes.
    lines = [name for name in lines if name + NODES in kinds] or lines
    if len(lines) > 1:
        raise InputError(f"{path}: several layers hold lines: {', '.join(lines)}; pass layer=")
    return str(lines[0])


def _has_z(info: dict[str, Any]) -> bool:
    """Tell whether a layer's points have a third coordinate."""
    kind = str(info["geometry_type"])
    return kind.endswith(" Z") or kind.startswith("2.5D")


def _frame_extra(frame: Any) -> dict[str, str]:
    """Return the free columns that :func:`_frame_of` told, with their kinds."""
    try:
        frame = json.loads(frame) if isinstance(frame, str) else frame
        return stated_extra(frame[EXTRA])
    except (KeyError, TypeError, ValueError):
        return {}


def _take_frame(source: Source, frame: Any) -> Source:
    """Give a source what :func:`_frame_of` wrote; what is damaged is left out, since the lines have it as well."""
    try:
        frame = json.loads(frame) if isinstance(frame, str) else frame
        x, y = map(float, frame["origin"])
        if math.isfinite(x) and math.isfinite(y):
            source.origin = (x, y)
        source.node_xy = {k: (float(x), float(y)) for k, (x, y) in enumerate(frame.get("node_xy", ()))}
    except (AttributeError, KeyError, TypeError, ValueError):
        return source
    return source


def _read_points(raw: Any, path: Path, layer: str) -> dict[str, np.ndarray]:
    """Return the columns of the points along the channels; nothing where one of them is missing."""
    names = ["channel_id", "point", *(f"{role}_m" for role in LISTS)]
    meta, _, _, data = raw.read(path, layer=layer, columns=names, read_geometry=False)
    columns = dict(zip(meta["fields"].tolist(), data, strict=True))
    return columns if set(columns) == set(names) else {}


def _read_nodes(shapely: Any, raw: Any, path: Path, layer: str) -> dict[int, tuple[float, float]]:
    """Return the positions of the nodes by their numbers."""
    meta, _, wkb, data = raw.read(path, layer=layer, columns=["node_id"], force_2d=True)
    if "node_id" not in meta["fields"]:
        return {}
    points = shapely.from_wkb(wkb, on_invalid="ignore")
    known = [p is not None and p.geom_type == "Point" and not p.is_empty for p in points]
    return {int(k): (p.x, p.y) for k, p, there in zip(data[0], points, known, strict=True) if there and k == k}
