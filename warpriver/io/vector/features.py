"""Lines as features: GeoJSON, GeoPackage, GeoParquet, shapefile, FlatGeobuf."""

from __future__ import annotations

import gzip
import json
import logging
import math
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.io.crs import crs_text, within_degrees
from warpriver.io.files import decoded, filtered_warnings
from warpriver.io.vector.attributes import (
    LISTS,
    SHORT_NAMES,
    Family,
    family_of,
    list_names,
    read_role,
    useful_names,
    write_columns,
)
from warpriver.io.vector.extras import EXTRA, extra_kinds, stated_extra, wanted_extra
from warpriver.io.vector.source import Line, Source
from warpriver.network import RiverNetwork

__all__ = [
    "JSON",
    "NEEDS",
    "OGR",
    "PARQUET",
    "SHAPEFILE_PARTS",
    "read_geojson",
    "read_ogr",
    "read_parquet",
    "write_geojson",
    "write_ogr",
    "write_parquet",
]

log = logging.getLogger("warpriver")

JSON = (".geojson", ".json")
OGR = {".gpkg": "GPKG", ".shp": "ESRI Shapefile", ".fgb": "FlatGeobuf"}
PARQUET = ".parquet"
# Modules beyond the core that a format needs; all of them come with the extra "gis".
NEEDS = {suffix: ("pyogrio", "shapely") for suffix in OGR} | {PARQUET: ("geopandas", "pyarrow", "shapely")}
# A .prj or an index that an older shapefile left behind would be taken for one of the new file.
SHAPEFILE_PARTS = (".shx", ".dbf", ".prj", ".cpg", ".qpj", ".qix", ".sbn", ".sbx", ".shp.xml")

# The layer of nodes that belongs to a layer of channels in a GeoPackage; the key of what no attribute holds elsewhere.
NODES = "_nodes"
FRAME = "warpriver"

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
        chosen = _line_layer(path, layer, pyogrio.list_layers(path))
        info = pyogrio.read_info(path, layer=chosen)
        frame = (info.get("layer_metadata") or {}).get(FRAME)
        extra = wanted_extra(path, _frame_extra(frame), asked, info["fields"])
        useful = useful_names(info["fields"], wanted, extra)
        names = [name for name in info["fields"] if name in useful]
        meta, _, wkb, data = raw.read(path, layer=chosen, columns=names, force_2d=not _has_z(info))
        beside = [name for name, _ in pyogrio.list_layers(path) if name == chosen + NODES]
        nodes = _read_nodes(shapely, raw, path, beside[0]) if beside else {}
    except (RuntimeError, IndexError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as {OGR[suffix]} ({_reason(error)}); is it cut short?") from error
    if wkb is None or len(wkb) < info["features"]:
        count = 0 if wkb is None else len(wkb)
        raise InputError(f"{path}: {count} of {info['features']} features can be read; is it cut short?")
    attributes = {name.lower(): column for name, column in zip(meta["fields"], data, strict=True)}
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
        frame = geopandas.read_parquet(path)
        geometries = frame.geometry.to_numpy()
        texts = [str(name) for name in frame.columns]
        extra = wanted_extra(path, _frame_extra(frame.attrs.get(FRAME)), asked, texts)
        useful = useful_names(texts, wanted, extra)
        attributes = {str(n).lower(): frame[n].to_numpy(dtype=object, na_value=None) for n in useful}
    except (RuntimeError, ValueError, LookupError, TypeError, OSError, pyarrow.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as GeoParquet ({_reason(error)}); is it cut short?") from error
    family = family_of(texts)
    lines = _lines_of(path, _shapely_features(shapely, geometries, attributes), wanted, family, extra)
    source = Source(path, lines, crs_text(frame.crs, str(path)), family=family, extra=extra)
    return _take_frame(source, frame.attrs.get(FRAME))


def write_geojson(network: RiverNetwork, path: Path, layer: str) -> None:
    """Write GeoJSON with a "crs" member."""
    crs = None
    if network.crs is not None:
        code = re.fullmatch(r"(\w+):(\w+)", network.crs)
        name = f"urn:ogc:def:crs:{code[1]}::{code[2]}" if code else network.crs
        crs = {"type": "name", "properties": {"name": name}}
    columns = {name: _plain(c) for name, c in write_columns(network).items()}
    features = [
        {
            "type": "Feature",
            "properties": {name: column[c] for name, column in columns.items()},
            "geometry": {"type": "LineString", "coordinates": points.tolist()},
        }
        for c, points in enumerate(_coordinates(network))
    ]
    head = {"type": "FeatureCollection", "name": layer, "crs": crs, FRAME: _frame_of(network)}
    # One feature a line, so that versions of a file can be compared.
    body = ",\n".join(json.dumps(feature, allow_nan=False) for feature in features)
    data = f'{json.dumps(head)[:-1]}, "features": [\n{body}\n]}}\n'.encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix.lower() == ".gz" else data)


def write_ogr(network: RiverNetwork, temporary: Path, path: Path, suffix: str, layer: str) -> None:
    """Write through GDAL; the layers of an existing GeoPackage at ``path`` are taken over."""
    _, shapely, raw = need(f"writing {suffix}", *NEEDS[suffix], "pyogrio.raw")
    columns = _text_columns(network)
    if suffix == ".shp":
        columns = {SHORT_NAMES.get(name, name): column for name, column in columns.items()}
    if suffix == ".gpkg" and path.exists():
        shutil.copyfile(path, temporary)
    # A FlatGeobuf with an index would have its channels in another order.
    options: dict[str, Any] = {"SPATIAL_INDEX": "NO"} if suffix == ".fgb" else {}
    if suffix != ".shp":
        frame = _frame_of(network)
        if suffix == ".gpkg":
            del frame["node_xy"]  # they are a layer of their own
        options["layer_metadata"] = {FRAME: json.dumps(frame)}
    try:
        with filtered_warnings("ignore", UserWarning, "'crs' was not provided"):
            raw.write(
                temporary,
                geometry=shapely.to_wkb(_line_strings(shapely, network)),
                field_data=list(columns.values()),
                fields=np.array(list(columns)),
                geometry_type="LineString" if network.point_z is None else "LineString Z",
                crs=network.crs,
                driver=OGR[suffix],
                layer=layer if suffix == ".gpkg" else None,
                **options,
            )
            if suffix == ".gpkg":
                _write_nodes(shapely, raw, network, temporary, layer)
    except RuntimeError as error:
        raise InputError(f"{path}: GDAL cannot write it ({_reason(error)})") from error


def write_parquet(network: RiverNetwork, temporary: Path, path: Path) -> None:
    """Write GeoParquet."""
    geopandas, _, shapely = need("writing .parquet", *NEEDS[PARQUET])
    try:
        frame = geopandas.GeoDataFrame(
            _text_columns(network), geometry=_line_strings(shapely, network), crs=network.crs
        )
        frame.attrs[FRAME] = _frame_of(network)
        frame.to_parquet(temporary, index=False)
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be written as GeoParquet ({_reason(error)})") from error


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


def _reason(error: Exception) -> str:
    """Return what a library says of its failure, as a part of one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


# ---- writing


def _text_columns(network: RiverNetwork) -> dict[str, np.ndarray]:
    """Return the attributes of the channels, lists as JSON text and words as objects."""
    columns = {}
    for name, column in write_columns(network).items():
        if isinstance(column, list):
            column = np.array([None if v is None else json.dumps(v) for v in column], object)
        columns[name] = column.astype(object) if column.dtype.kind == "U" else column
    return columns


def _plain(values: Any) -> list[Any]:
    """Return a column as JSON has it: null for what is not known."""
    plain = values if isinstance(values, list) else values.tolist()
    return [None if isinstance(v, float) and math.isnan(v) else v for v in plain]


def _frame_of(network: RiverNetwork) -> dict[str, Any]:
    """Return what no attribute holds: the zero of the device coordinates, the nodes by number, the free columns."""
    extra = {EXTRA: extra_kinds(network.channels)} if network.channels.extra else {}
    return {"origin": network.origin.tolist(), "node_xy": network.node_xy.tolist(), **extra}


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


def _write_nodes(shapely: Any, raw: Any, network: RiverNetwork, path: Path, layer: str) -> None:
    """Add the nodes as a layer of points beside that of the channels."""
    arriving = np.bincount(network.channel_to, minlength=network.node_count)
    leaving = np.bincount(network.channel_from, minlength=network.node_count)
    kind = np.where(arriving == 0, "source", np.where(leaving == 0, "outlet", "junction"))
    raw.write(
        path,
        geometry=shapely.to_wkb(shapely.points(network.node_xy)),
        field_data=[np.arange(network.node_count), kind.astype(object)],
        fields=np.array(["node_id", "kind"]),
        geometry_type="Point",
        crs=network.crs,
        driver="GPKG",
        layer=layer + NODES,
    )


def _read_nodes(shapely: Any, raw: Any, path: Path, layer: str) -> dict[int, tuple[float, float]]:
    """Return the positions of the nodes by their numbers."""
    meta, _, wkb, data = raw.read(path, layer=layer, columns=["node_id"], force_2d=True)
    if "node_id" not in meta["fields"]:
        return {}
    points = shapely.from_wkb(wkb, on_invalid="ignore")
    known = [p is not None and p.geom_type == "Point" and not p.is_empty for p in points]
    return {int(k): (p.x, p.y) for k, p, there in zip(data[0], points, known, strict=True) if there and k == k}


def _line_strings(shapely: Any, network: RiverNetwork) -> np.ndarray:
    """Return the channels as shapely LineStrings."""
    lines = _coordinates(network)
    owner = np.repeat(np.arange(network.channel_count), [len(points) for points in lines])
    return shapely.linestrings(np.concatenate(lines), indices=owner)


def _coordinates(network: RiverNetwork) -> list[np.ndarray]:
    """Return the points of the channels, (n, 2), or (n, 3) with elevations."""
    lines, elevations = network.polylines(close=True), network.point_elevations(close=True)
    if elevations is None:
        return lines
    return [np.column_stack([xy, z]) for xy, z in zip(lines, elevations, strict=True)]
