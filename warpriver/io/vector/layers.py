"""Layers: features of one kind with their attributes, written to GeoPackage, shapefile, FlatGeobuf or GeoParquet."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.files import beside
from warpriver.io.files import filtered_warnings, plain_path
from warpriver.io.gdal import name_to_write
from warpriver.io.vector.geopackage import add_styles, drop_layers, edited_geopackage, is_database

__all__ = [
    "GEOPACKAGE",
    "JSON",
    "NEEDS",
    "OGR",
    "PARQUET",
    "SHAPEFILE_PARTS",
    "Layer",
    "check_layer",
    "crs_member",
    "geojson_text",
    "plain_values",
    "reason",
    "refuse_others",
    "replaced_layer",
    "write_geopackage",
    "write_layer",
    "write_layer_geojson",
]

JSON = (".geojson", ".json")
GEOPACKAGE, PARQUET = ".gpkg", ".parquet"
OGR = {GEOPACKAGE: "GPKG", ".shp": "ESRI Shapefile", ".fgb": "FlatGeobuf"}
# Modules beyond the core that a format needs; all of them come with the extra "gis".
NEEDS = {suffix: ("pyogrio", "shapely") for suffix in OGR} | {PARQUET: ("geopandas", "pyarrow", "shapely")}
# A .prj or an index that an older shapefile left behind would be taken for one of the new file.
SHAPEFILE_PARTS = (".shx", ".dbf", ".prj", ".cpg", ".qpj", ".qix", ".sbn", ".sbx", ".shp.xml")
# How files of a format begin.
BEGINNINGS = {GEOPACKAGE: b"SQLite format 3\0", ".shp": (9994).to_bytes(4, "big"), ".fgb": b"fgb\x03"}
# The maximum of decimals of a number in a shapefile.
DECIMALS = 15


@dataclasses.dataclass(frozen=True)
class Layer:
    """Features of one kind, as they are written.

    Attributes:
        name: Name of the layer.
        kind: Kind of the geometries: "LineString", "LineString Z", "Point", "Polygon" ...
        geometry: (F,) shapely geometries.
        columns: The attributes by name, each (F,) numbers, words (object) or times, or a list of F lists of numbers.
        style: Name of its style in QGIS.
        frame: What is told of the layer as a whole, JSON text; "" for nothing.
    """

    name: str
    kind: str
    geometry: np.ndarray
    columns: Mapping[str, Any]
    style: str
    frame: str = ""


def write_geopackage(path: Path, layers: Sequence[Layer], crs: str | None, stale: Sequence[str] = ()) -> None:
    """Write layers to a GeoPackage, in place of those of the same names; it keeps its other layers.

    Args:
        path: The file, which need not exist.
        layers: What to write.
        crs: Their coordinate reference system.
        stale: Layers to remove, of those that there are.

    Raises:
        ImportError: pyogrio or shapely is missing.
        OSError: The file cannot be written, or another program is writing into it.
        ValueError: The CRS is unknown.
    """
    need("writing .gpkg", *NEEDS[GEOPACKAGE])
    made = {} if is_database(path) else {"dataset_options": {"VERSION": "1.3"}}
    with edited_geopackage(path) as temporary:
        if not made:
            drop_layers(temporary, {*stale, *(layer.name for layer in layers)})
        for layer in layers:
            _write_ogr(layer, temporary, path, crs, **made)
            made = {}
        for layer in layers:
            check_layer(layer, temporary, crs)
        add_styles(temporary, {layer.name: layer.style for layer in layers})


def replaced_layer(path: Path, layer: Layer, crs: str | None) -> contextlib.AbstractContextManager[Path]:
    """Give the path to write a file of one layer at, which takes the place of an old one once it was read back."""
    suffix = path.suffix.lower()
    check = (lambda written: check_layer(layer, written, crs)) if suffix in OGR else None
    return beside(path, SHAPEFILE_PARTS if suffix == ".shp" else (), check)


def write_layer(layer: Layer, temporary: Path, path: Path, crs: str | None) -> None:
    """Write one layer to the file of another format.

    Args:
        layer: What to write.
        temporary: The file to write to.
        path: What to call it in messages.
        crs: Coordinate reference system.
    """
    suffix = path.suffix.lower()
    if suffix == PARQUET:
        _write_parquet(layer, temporary, path, crs)
        return
    with name_to_write(temporary) as name:
        # A FlatGeobuf with an index would have its features in another order.
        _write_ogr(layer, name, path, crs, **({"SPATIAL_INDEX": "NO"} if suffix == ".fgb" else {}))
        if suffix == ".shp":
            fit_numbers(name.with_suffix(".dbf"), layer.columns)


def write_layer_geojson(layer: Layer, path: Path, crs: str | None) -> None:
    """Write a layer as GeoJSON with a "crs" member."""
    (shapely,) = need("writing .geojson", "shapely")
    columns = {name: plain_values(column) for name, column in layer.columns.items()}
    features = [
        json.dumps(
            {
                "type": "Feature",
                "properties": {name: column[k] for name, column in columns.items()},
                "geometry": json.loads(text),
            },
            allow_nan=False,
        )
        for k, text in enumerate(shapely.to_geojson(layer.geometry).tolist())
    ]
    path.write_bytes(geojson_text({"name": layer.name, "crs": crs_member(crs)}, features).encode())


def geojson_text(members: Mapping[str, Any], features: Sequence[str]) -> str:
    """Return a collection of features, one a line, so that versions of a file can be compared."""
    head = json.dumps({"type": "FeatureCollection", **members})[:-1]
    body = ",\n".join(features)
    return f'{head}, "features": [\n{body}\n]}}\n'


def crs_member(crs: str | None) -> dict[str, Any] | None:
    """Return a CRS as GDAL and QGIS find it in GeoJSON."""
    if crs is None:
        return None
    code = re.fullmatch(r"(\w+):(\w+)", crs)
    return {"type": "name", "properties": {"name": f"urn:ogc:def:crs:{code[1]}::{code[2]}" if code else crs}}


def plain_values(values: Any) -> list[Any]:
    """Return a column as JSON has it: null for what is not known, dates as text."""
    if not isinstance(values, list) and values.dtype.kind == "M":
        return [None if text == "NaT" else text for text in np.datetime_as_string(values, "s").tolist()]
    plain = values if isinstance(values, list) else values.tolist()
    return [None if isinstance(v, float) and math.isnan(v) else v for v in plain]


def _write_ogr(layer: Layer, temporary: Path, path: Path, crs: str | None, **options: Any) -> None:
    """Write a layer through GDAL."""
    suffix = path.suffix.lower()
    _, shapely, raw = need(f"writing {suffix}", *NEEDS[suffix], "pyogrio.raw")
    if layer.frame and suffix != ".shp":
        options["layer_metadata"] = {"warpriver": layer.frame}
    columns = {name: _as_field(column) for name, column in layer.columns.items()}
    try:
        with filtered_warnings("ignore", UserWarning, "'crs' was not provided"):
            raw.write(
                temporary,
                geometry=shapely.to_wkb(layer.geometry),
                field_data=list(columns.values()),
                fields=np.array(list(columns), object),
                geometry_type=layer.kind,
                crs=crs,
                driver=OGR[suffix],
                layer=layer.name if suffix == GEOPACKAGE else None,
                **options,
            )
    except RuntimeError as error:
        raise InputError(f"{path}: GDAL cannot write it ({reason(error)})") from error


def _write_parquet(layer: Layer, temporary: Path, path: Path, crs: str | None) -> None:
    """Write GeoParquet, in which lists are lists."""
    geopandas, *_ = need("writing .parquet", *NEEDS[PARQUET])
    columns = {name: _as_objects(column) for name, column in layer.columns.items()}
    try:
        frame = geopandas.GeoDataFrame(columns, geometry=layer.geometry, crs=crs)
        if layer.frame:
            frame.attrs["warpriver"] = json.loads(layer.frame)
        frame.to_parquet(temporary.absolute(), index=False)
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be written as GeoParquet ({reason(error)})") from error


def _as_field(column: Any) -> np.ndarray:
    """Return a column as GDAL takes it: lists as JSON text, words as objects."""
    if isinstance(column, list):
        return np.array([None if value is None else json.dumps(value) for value in column], object)
    field: np.ndarray = column.astype(object) if column.dtype.kind == "U" else column
    return field


def _as_objects(column: Any) -> np.ndarray:
    """Return a column as pandas takes it: lists and words as objects."""
    if not isinstance(column, list):
        whole: np.ndarray = column.astype(object) if column.dtype.kind == "U" else column
        return whole
    values = np.empty(len(column), object)
    values[:] = [None if value is None else np.array(value, np.float64) for value in column]
    return values


def fit_numbers(path: Path, columns: Mapping[str, Any]) -> None:
    """Give the numbers of a .dbf as many decimals as the field has room for beside their whole digits, up to 15.

    GDAL gives every field 15 of its 24 places: from 1e8 on a number fills more than its field, and programs that
    save the file again cut it or refuse it.

    Args:
        path: The .dbf, as GDAL wrote it.
        columns: The values of its columns, by name.
    """
    data = bytearray(path.read_bytes())
    count, head, size = (int.from_bytes(data[a:b], "little") for a, b in ((4, 8), (8, 10), (10, 12)))
    records = np.frombuffer(data, np.uint8, count * size, head).reshape(count, size)
    first = 1  # a record begins with the mark of a deleted one
    for place in range(32, head - 1, 32):
        name = bytes(data[place : place + 11]).split(b"\0")[0].decode()
        width, decimals = data[place + 16], data[place + 17]
        if decimals and name in columns:
            values = np.asarray(columns[name], np.float64)
            known = np.isfinite(values)
            largest = int(np.abs(values[known]).max(initial=0.0))
            fit = min(DECIMALS, width - 2 - len(str(largest)) - int((values[known] < 0.0).any()))
            text = np.char.mod(f"%{width}.{max(fit, 0)}f", values[known]).astype(f"S{width}")
            records[known, first : first + width] = text.view(np.uint8).reshape(-1, width)
            data[place + 17] = max(fit, 0)
        first += width
    path.write_bytes(data)


def check_layer(layer: Layer, path: Path, crs: str | None) -> None:
    """Raise ``ValueError`` unless a file holds a layer: GDAL does not tell when its last bytes find no room."""
    suffix = path.suffix.lower()
    _, shapely, raw = need(f"reading {suffix}", *NEEDS[suffix], "pyogrio.raw")
    if suffix == ".shp":
        refuse_others(path, suffix)
        _refuse_cut_table(path.with_suffix(".dbf"))
    with plain_path(path) as plain:
        meta, _, wkb, _ = raw.read(plain, layer=layer.name if suffix == GEOPACKAGE else None)
    if (meta["crs"] is None) != (crs is None):
        raise InputError("it states no CRS")
    # A shapefile has its polygons wound the other way.
    found, written = (shapely.normalize(g) for g in (shapely.from_wkb(wkb), layer.geometry))
    if not np.array_equal(found, written):
        raise InputError(f"the features of {layer.name} differ")


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
    if suffix == GEOPACKAGE:
        page = int.from_bytes(head[16:18], "big")
        needed = max(100, (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big"))
    elif suffix == ".shp":
        needed = max(100, 2 * int.from_bytes(head[24:28], "big"))
    if size < needed:
        raise InputError(f"{path}: cut short, {size} of {needed} bytes are there; fetch it again")


def _refuse_cut_table(path: Path) -> None:
    """Raise ``ValueError`` for the table of a shapefile that is shorter than its header says."""
    head = path.read_bytes()[:12]
    count, begin, size = (int.from_bytes(head[a:b], "little") for a, b in ((4, 8), (8, 10), (10, 12)))
    if len(head) < 12 or path.stat().st_size < begin + count * size:
        raise InputError(f"{path.name} has {path.stat().st_size} of {begin + count * size} bytes")


def reason(error: Exception) -> str:
    """Return what a library says of its failure, in one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__
