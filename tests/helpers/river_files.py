"""River networks for tests of files, and which formats this installation has."""

import importlib.util
import json
import textwrap

import numpy as np
import pytest

from warpriver.network import RiverNetwork

HAS_OGR = all(importlib.util.find_spec(m) for m in ("pyogrio", "shapely"))
HAS_PARQUET = HAS_OGR and all(importlib.util.find_spec(m) for m in ("geopandas", "pyarrow"))
HAS_PYPROJ = importlib.util.find_spec("pyproj") is not None

needs_ogr = pytest.mark.skipif(not HAS_OGR, reason="pyogrio and shapely are not installed (warpriver[gis])")
needs_parquet = pytest.mark.skipif(not HAS_PARQUET, reason="geopandas and pyarrow are not installed (warpriver[gis])")
needs_pyproj = pytest.mark.skipif(not HAS_PYPROJ, reason="pyproj is not installed (warpriver[gis])")

CORE = [".csv", ".csv.gz", ".txt", ".dat", ".xy.gz", ".geojson", ".json", ".geojson.gz"]
GIS = [
    pytest.param(".gpkg", marks=needs_ogr),
    pytest.param(".fgb", marks=needs_ogr),
    pytest.param(".parquet", marks=needs_parquet),
]
SHP = [pytest.param(".shp", marks=needs_ogr)]


def sine(count=40, shift=(0.0, 0.0), seed=0):
    """Return a wavy line whose coordinates use all their bits."""
    t = np.linspace(0.0, 20.0, count)
    jitter = np.random.default_rng(seed).normal(0.0, 0.1, (count, 2))
    return np.stack([300.0 * t, 400.0 * np.sin(t)], axis=1) + jitter + shift


def confluence(crs="EPSG:32619", shift=(580000.0, -717000.0), varying=False):
    """Return two tributaries and a trunk."""
    a, b, trunk = sine(40, shift, 1), sine(30, shift, 2), sine(50, shift, 3)
    a[-1] = b[-1] = trunk[0]
    width = [51.7, 1.0 / 3.0 + 60.0, 88.1]
    depth, flow = [2.1, 2.3, 3.3], [70.0 + 1.0 / 7.0, 90.0, 170.0]
    if varying:
        width[0] = 50.0 + np.random.default_rng(4).random(40)
        depth[0] = 2.0 + np.random.default_rng(5).random(40)
    return RiverNetwork.from_polylines([a, b, trunk], width=width, depth=depth, discharge=flow, crs=crs)


def same_lines(a, b):
    assert len(a) == len(b)
    for p, q in zip(a, b, strict=True):
        np.testing.assert_array_equal(p, q)


def write(path, text):
    path.write_text(textwrap.dedent(text))
    return path


def feature(kind, coordinates, **properties):
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": kind, "coordinates": coordinates},
    }


def collection(path, *features, **members):
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features), **members}))
    return path


LINE = [[0.0, 0.0, 7.0], [100.0, 0.0, 7.0], [200.0, 0.0, 6.0]]

# Two lines that meet, and one that goes on from there.
Y = [
    [[0, 900], [200, 700], [500, 500]],
    [[1000, 900], [800, 700], [500, 500]],
    [[500, 500], [520, 250], [500, 0]],
]


def foreign(path, *rows, lines=Y, **members):
    """A file of three lines that meet, with other people's attributes."""
    return collection(
        path, *(feature("LineString", xy, **row) for xy, row in zip(lines, rows, strict=True)), crs=None, **members
    )
