"""Runs in files for a GIS: the rivers as they are now, their earlier courses, oxbow lakes and abandoned courses."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from warpriver.errors import InputError
from warpriver.extras import need
from warpriver.history import History
from warpriver.history.tables import FEATURES, Features, features_of, geometry_of
from warpriver.io.vector.attributes import SHORT_NAMES
from warpriver.io.vector.layers import (
    GEOPACKAGE,
    JSON,
    NEEDS,
    SHAPEFILE_PARTS,
    Layer,
    replaced_layer,
    write_geopackage,
    write_layer,
    write_layer_geojson,
)
from warpriver.io.vector.network_layers import POINTS, network_layers
from warpriver.io.vector.networks import write_network
from warpriver.public import public
from warpriver.validate import one_of

__all__ = ["HISTORY_SUFFIXES", "history_layers", "records_between", "write_history"]

HISTORY_SUFFIXES = (*NEEDS, *JSON)
# Points of all courses beyond which not every record becomes one, unless it is said which are to.
MAX_POINTS = 2_000_000


@public
def write_history(
    history: History,
    path: str | os.PathLike[str],
    *,
    every: int | None = None,
    layers: Sequence[str] | None = None,
) -> list[Path]:
    """Write a run for a GIS: the last network, and what happened before it, with times.

    A GeoPackage has the layers "channels" (with nodes and points, as ``write_network`` writes them; ``read_network``
    reads it back), "courses" (the line of each channel at each record), "oxbows" (areas) and "abandoned" (courses that
    were given up where channels met), all with a style for QGIS. Of other formats each is a file of its own:
    NAME.geojson, NAME_courses.geojson, NAME_oxbows.geojson and NAME_abandoned.geojson. Layers of things that did not
    happen are empty in a GeoPackage, and no files elsewhere.

    Attributes are those of ``History.to_geopandas``: ``time_yr``, and the dates ``begin`` and ``end``, by which the
    temporal controller of QGIS shows a run (year 0 is 2000).

    Args:
        history: The run.
        path: File name; .gpkg, .shp, .fgb, .parquet, .geojson or .json.
        every: Take every so many records; by default all, or as many as make about two million points.
        layers: Which of "courses", "oxbows" and "abandoned" are written beside the rivers; by default all.

    Returns:
        The files that were written.

    Raises:
        ImportError: The format needs a module that is not installed.
        OSError: A file cannot be written.
        ValueError: Another suffix or layer, an interval below 1, or a history without a record.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in HISTORY_SUFFIXES:
        raise InputError(f"{path}: {suffix or 'no suffix'} cannot hold a run; write {', '.join(HISTORY_SUFFIXES)}")
    need(f"writing a run as {suffix}", *NEEDS.get(suffix, ("shapely",)))
    step = records_between(history) if every is None else every
    wanted = tuple(FEATURES) if layers is None else tuple(one_of(name, "layers", tuple(FEATURES)) for name in layers)
    made = {name: features_of(history, name, step) for name in FEATURES if name in wanted}
    network = history.networks[-1]
    if suffix == GEOPACKAGE:
        further = [_layer(name, features, suffix) for name, features in made.items()]
        write_geopackage(path, [*network_layers(network, "channels"), *further], history.crs, ["channels" + POINTS])
        return [path]
    files = {name: path.with_name(f"{path.stem}_{name}{path.suffix}") for name in made}
    write_network(network, path)
    for name, file in files.items():
        if not len(made[name].owner):
            _remove(file)
            continue
        layer = _layer(name, made[name], suffix)
        with replaced_layer(file, layer, history.crs) as temporary:
            if suffix in JSON:
                write_layer_geojson(layer, temporary, history.crs)
            else:
                write_layer(layer, temporary, file, history.crs)
    return [path, *(file for name, file in files.items() if len(made[name].owner))]


def history_layers(history: History) -> list[Layer]:
    """Return courses, oxbow lakes and abandoned courses of a run as the layers of a GeoPackage."""
    step = records_between(history)
    return [_layer(name, features_of(history, name, step), GEOPACKAGE) for name in FEATURES]


def records_between(history: History) -> int:
    """Return every how many records one becomes a course, so that all have about two million points at most."""
    if not len(history.times):
        return 1
    points = max(history.networks[k].point_count for k in (0, -1)) * len(history.times)
    return max(1, -(-points // MAX_POINTS))


def _layer(name: str, features: Features, suffix: str) -> Layer:
    """Return features as a layer, with the attributes as the format of a suffix has them."""
    columns = dict(features.columns)
    if suffix == ".shp":  # which has no times of day, and short names
        dates = {key: values for key, values in columns.items() if values.dtype.kind == "M"}
        columns |= {key: np.datetime_as_string(values, "D").astype(object) for key, values in dates.items()}
        columns = {SHORT_NAMES.get(key, key): values for key, values in columns.items()}
    return Layer(name, features.kind, geometry_of(features), columns, name)


def _remove(file: Path) -> None:
    """Remove what an earlier run left under a name."""
    for part in (file, *(file.with_suffix(p) for p in SHAPEFILE_PARTS if file.suffix.lower() == ".shp")):
        part.unlink(missing_ok=True)
