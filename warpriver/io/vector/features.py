"""Lines written as features: GeoJSON, GeoPackage, GeoParquet, shapefile, FlatGeobuf."""

from __future__ import annotations

import gzip
import json
import logging
import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.io.files import filtered_warnings
from warpriver.io.vector.attributes import (
    SHORT_NAMES,
    write_columns,
)
from warpriver.io.vector.extras import EXTRA, extra_kinds
from warpriver.network import RiverNetwork

__all__ = [
    "FRAME",
    "JSON",
    "NEEDS",
    "NODES",
    "OGR",
    "PARQUET",
    "SHAPEFILE_PARTS",
    "check_ogr",
    "reason",
    "refuse_others",
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

# How files of a format begin.
BEGINNINGS = {".gpkg": b"SQLite format 3\0", ".shp": (9994).to_bytes(4, "big"), ".fgb": b"fgb\x03"}

# The layer of nodes that belongs to a layer of channels in a GeoPackage; the key of what no attribute holds elsewhere.
NODES = "_nodes"
FRAME = "warpriver"


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
        raise InputError(f"{path}: GDAL cannot write it ({reason(error)})") from error


def check_ogr(network: RiverNetwork, path: Path, suffix: str, layer: str) -> None:
    """Raise ``ValueError`` unless a file holds that network: GDAL does not tell when its last bytes find no room."""
    _, shapely, raw = need(f"reading {suffix}", *NEEDS[suffix], "pyogrio.raw")
    if suffix == ".shp":
        refuse_others(path, suffix)
        _refuse_cut_table(path.with_suffix(".dbf"))
    meta, _, wkb, _ = raw.read(path, layer=layer if suffix == ".gpkg" else None)
    if (meta["crs"] is None) != (network.crs is None):
        raise InputError("it states no CRS")
    if not np.array_equal(shapely.from_wkb(wkb), _line_strings(shapely, network)):
        raise InputError("its lines differ")


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
        raise InputError(f"{path}: cannot be written as GeoParquet ({reason(error)})") from error


def refuse_others(path: Path, suffix: str) -> None:
    """Raise ``ValueError`` for what is no file of this format, or is shorter than its header says.

    GDAL would open by its content what has another format's name, and some of its formats read whatever other files or
    addresses they name; of a file that is cut short it may read a part without a word.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(100)
    if not head.startswith(BEGINNINGS[suffix]):
        raise InputError(f"{path}: cannot be read as {OGR[suffix]}, it does not begin like one; is its suffix right?")
    needed = 0
    if suffix == ".gpkg":
        page = int.from_bytes(head[16:18], "big")
        needed = max(100, (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big"))
    elif suffix == ".shp":
        needed = max(100, 2 * int.from_bytes(head[24:28], "big"))
    if size < needed:
        raise InputError(f"{path}: cut short, {size} of {needed} bytes are there; fetch it again")


def _refuse_cut_table(path: Path) -> None:
    """Raise ``ValueError`` for the table of a shapefile that is shorter than its header says."""
    head = path.read_bytes()[:12]
    needed = int.from_bytes(head[8:10], "little") + int.from_bytes(head[4:8], "little") * int.from_bytes(
        head[10:12], "little"
    )
    if len(head) < 12 or path.stat().st_size < needed:
        raise InputError(f"{path.name} has {path.stat().st_size} of {needed} bytes")


def reason(error: Exception) -> str:
    """Return what a library says of its failure, as a part of one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


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
