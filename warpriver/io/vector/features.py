"""Lines as features: GeoJSON, GeoPackage, GeoParquet, shapefile, FlatGeobuf."""

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
from warpriver.io.crs import crs_text, within_degrees
from warpriver.io.files import decoded
from warpriver.io.gdal import name_to_read
from warpriver.io.vector.attributes import LISTS, Family, family_of, list_names, read_role, useful_names
from warpriver.io.vector.extras import EXTRA, stated_extra, wanted_extra
from warpriver.io.vector.layers import NEEDS, OGR, PARQUET, reason_of
from warpriver.io.vector.network_layers import FRAME, NODES, POINTS, point_lists
from warpriver.io.vector.source import Line, Source

__all__ = ["JSON", "read_geojson", "read_ogr", "read_parquet"]

log = logging.getLogger("warpriver")

JSON = (".geojson", ".json")

# A feature is its kind of geometry, the (n, 2) or (n, 3) arrays of its parts, and its attributes by lower-case name.
_Feature = tuple[str, list[np.ndarray], dict[str, Any]]


def read_geojson(path: Path, wanted: Sequence[str], asked: Iterable[str] | None) -> Source:
    """Read lines from GeoJSON."""
    try:
        root = json.loads(decoded(path))
    except json.JSONDecodeError as error:
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
    family, extra = family_of(names), wanted_extra(path, _frame_extra(root.get(FRAME)), asked, names)
    lines = _lines_of(path, (_geojson_feature(path, k, f) for k, f in enumerate(features)), wanted, family, extra)
    member = root.get("crs")
    named = member.get("properties") if isinstance(member, dict) else None
    name = (named.get("name") or named.get("code")) if isinstance(named, dict) else None
    crs = crs_text(f"EPSG:{name}" if str(name).isdigit() else name, str(path))
    source = Source(path, lines, crs, "crs" not in root and within_degrees(lines), family, extra=extra)
    return _take_frame(source, root.get(FRAME))


def read_ogr(path: Path, suffix: str, layer: str | None, wanted: Sequence[str], asked: Iterable[str] | None) -> Source:
    """Read lines through GDAL."""
    pyogrio, shapely, raw = need(f"reading {suffix}", *NEEDS[suffix], "pyogrio.raw")
    _refuse_cut(path, suffix)
    try:
        with name_to_read(path) as name:
            layers = pyogrio.list_layers(name)
            chosen = _line_layer(path, layer, layers)
            info = pyogrio.read_info(name, layer=chosen)
            frame = (info.get("layer_metadata") or {}).get(FRAME)
            extra = wanted_extra(path, _frame_extra(frame), asked, info["fields"])
            useful = useful_names(info["fields"], wanted, extra)
            names = [field for field in info["fields"] if field in useful]
            meta, _, wkb, data = raw.read(name, layer=chosen, columns=names, force_2d=not _has_z(info))
            beside = {str(there) for there, _ in layers}
            nodes = _read_nodes(shapely, raw, name, chosen + NODES) if chosen + NODES in beside else {}
            points = _read_points(raw, name, chosen + POINTS) if chosen + POINTS in beside else {}
    except (RuntimeError, IndexError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as {OGR[suffix]} ({reason_of(error)}); is it cut short?") from error
    if wkb is None or len(wkb) < info["features"]:
        count = 0 if wkb is None else len(wkb)
        raise InputError(f"{path}: {count} of {info['features']} features can be read; is it cut short?")
    attributes = {name.lower(): column for name, column in zip(meta["fields"], data, strict=True)}
    if points and "channel_id" in attributes:
        attributes |= point_lists(points, np.asarray(attributes["channel_id"]))
    with np.errstate(invalid="ignore"):  # a NaN is told by _lines_of
        geometries = shapely.from_wkb(wkb, on_invalid="ignore")
    family = family_of(info["fields"])
    lines = _lines_of(path, _shapely_features(shapely, geometries, attributes), wanted, family, extra)
    source = Source(path, lines, crs_text(meta["crs"], str(path)), family=family, extra=extra)
    _take_frame(source, frame)
    source.node_xy.update(nodes)
    return source


def read_parquet(path: Path, wanted: Sequence[str], asked: Iterable[str] | None) -> Source:
    """Read lines from GeoParquet."""
    geopandas, pyarrow, shapely = need("reading .parquet", *NEEDS[PARQUET])
    try:
        frame = geopandas.read_parquet(path.absolute())
        geometries = frame.geometry.to_numpy()
        texts = [str(name) for name in frame.columns]
        extra = wanted_extra(path, _frame_extra(frame.attrs.get(FRAME)), asked, texts)
        useful = useful_names(texts, wanted, extra)
        attributes = {str(n).lower(): frame[n].to_numpy(dtype=object, na_value=None) for n in useful}
    except (RuntimeError, ValueError, LookupError, TypeError, OSError, pyarrow.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as GeoParquet ({reason_of(error)}); is it cut short?") from error
    family = family_of(texts)
    lines = _lines_of(path, _shapely_features(shapely, geometries, attributes), wanted, family, extra)
    source = Source(path, lines, crs_text(frame.crs, str(path)), family=family, extra=extra)
    return _take_frame(source, frame.attrs.get(FRAME))


# ---- reading


def _lines_of(
    path: Path, features: Iterable[_Feature], wanted: Sequence[str], family: Family, extra: Iterable[str]
) -> list[Line]:
    """Turn features into channels, or raise ``ValueError`` if none is a line."""
    lines: list[Line] = []
    others: Counter[str] = Counter()
    for k, (kind, parts, attributes) in enumerate(features):
        if kind not in ("LineString", "MultiLineString") or not any(map(len, parts)):
            others[f"{'empty ' if 'LineString' in kind else ''}{kind}"] += 1
            continue
        where = f"{path}, feature {k}"
        for points in _chained([part for part in parts if len(part)]):
            xy = points[:, :2].copy()
            if not np.isfinite(xy).all():
                point = int((~np.isfinite(xy)).any(axis=1).argmax())
                raise InputError(f"{where}: point {point} is not finite; remove or repair it")
            line = Line(xy, where, feature=k, z=points[:, 2].copy() if points.shape[1] > 2 else None)
            line.extra = {name: attributes.get(name.lower()) for name in extra}
            for role in wanted:
                value = _point_list(attributes, role, len(xy), where) if role in LISTS else None
                whole = read_role(attributes, family, role, where)
                setattr(line, role, whole if value is None else value)
                if value is not None:
                    setattr(line, f"mean_{role}", whole)
            lines.append(line)
    found = ", ".join(f"{count} {kind}" for kind, count in others.items())
    if not lines:
        raise InputError(f"{path}: no lines in it; it holds {found or 'no features'}")
    if others:
        log.info("%s: passed over %s", path, found)
    return lines


def _chained(parts: list[np.ndarray]) -> list[np.ndarray]:
    """Join parts that follow end to start; where more than two parts meet, none is joined."""
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


def _point_list(attributes: dict[str, Any], role: str, count: int, where: str) -> np.ndarray | None:
    """Return a list of one number a point, None if there is none, or raise ``ValueError``."""
    for name in list_names(role):
        value = attributes.get(name)
        if value is None or isinstance(value, float):  # a NaN stands for none in some tables
            continue
        try:
            array = np.array(json.loads(value) if isinstance(value, str) else value, np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"{where}: {name} is not a list of numbers ({error})") from error
        if array.shape != (count,):
            raise InputError(f"{where}: {name} has {array.size} numbers for {count} points; remove it, or pass {role}=")
        return array
    return None


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


def _refuse_cut(path: Path, suffix: str) -> None:
    """Raise ``ValueError`` for a file shorter than its header says: GDAL may read a part without a word."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(100)
    needed = 0
    if suffix == ".gpkg" and head.startswith(b"SQLite format 3"):
        page = int.from_bytes(head[16:18], "big")
        needed = max(100, (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big"))
    elif suffix == ".shp" and head.startswith((9994).to_bytes(4, "big")):
        needed = max(100, 2 * int.from_bytes(head[24:28], "big"))
    if size < needed:
        raise InputError(f"{path}: cut short, {size} of {needed} bytes are there; fetch it again")


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
