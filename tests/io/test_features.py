"""Tests of GeoJSON and of the formats of GIS."""

import json

import numpy as np
import pytest
from river_files import GIS, LINE, SHP, collection, confluence, feature, needs_ogr, needs_parquet, sine, write

from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge
from warpriver.io import read_network, write_network
from warpriver.network import RiverNetwork


def test_geojson_attributes(tmp_path):
    path = collection(
        tmp_path / "a.json",
        feature("LineString", LINE, WIDTH=12, depth_m=1.5, discharge=None),
        feature("LineString", [[0, 900], [100, 900], [200, 900]], width=None, width_m="13.5", discharge_m3s=4),
        feature("Point", [0, 0]),
        {"type": "Feature", "properties": None, "geometry": None},
        crs={"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32619"}},
    )
    network = read_network(path)
    assert network.crs == "EPSG:32619"
    np.testing.assert_array_equal(network.polylines()[0], np.array(LINE)[:, :2])  # z is dropped
    np.testing.assert_array_equal(network.channel_width, [12.0, 13.5])
    np.testing.assert_allclose(network.channel_depth, [1.5, bankfull_depth(13.5)])
    np.testing.assert_allclose(network.channel_discharge, [bankfull_discharge(12.0), 4.0])


def test_multilinestrings_are_chained(tmp_path):
    def read(*parts):
        path = collection(tmp_path / "a.json", feature("MultiLineString", parts, width=5.0), crs=None)
        return [xy[:, 0].tolist() for xy in read_network(path).polylines()]

    a, b, c = [[0, 0], [50, 9], [100, 0]], [[100, 0], [150, 9], [200, 0]], [[200, 0], [250, 9], [300, 0]]
    whole = [0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0]
    assert read(a, b, c) == [whole]
    assert read(c, a, b) == [whole]
    assert read(a, c) == [[0.0, 50.0, 100.0], [200.0, 250.0, 300.0]]
    # A fork is not joined: a into b and into d.
    d = [[100, 0], [150, -90], [200, -90]]
    assert read(a, b, d) == [[0.0, 50.0, 100.0], [100.0, 150.0, 200.0], [100.0, 150.0, 200.0]]
    # A ring of two parts starts with its first.
    ring = [[[0, 0], [50, 50], [100, 0]], [[100, 0], [50, -50], [0, 0]]]
    assert read(*ring) == [[0.0, 50.0, 100.0, 50.0, 0.0]]


def test_geojson_roots_and_crs_rules(tmp_path):
    path = tmp_path / "a.geojson"
    for root in (feature("LineString", LINE), {"type": "LineString", "coordinates": LINE}):
        path.write_text(json.dumps(root))
        # Without a crs member the numbers exceed 180: the CRS is unknown.
        assert read_network(path, width=5.0).crs is None
        assert read_network(path, width=5.0, crs="EPSG:32619").crs == "EPSG:32619"
    degrees = [[-67.0, -6.5], [-67.01, -6.51], [-67.03, -6.5]]
    collection(path, feature("LineString", degrees))
    with pytest.raises(ValueError, match=r"longitude and latitude, not metres"):
        read_network(path, width=5.0)
    collection(path, feature("LineString", LINE), crs={"type": "EPSG", "properties": {"code": 32619}})
    assert read_network(path, width=5.0).crs == "EPSG:32619"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"type": "FeatureCollection", "features": [', "not whole JSON"),
        ("river", "not whole JSON"),
        ("[1, 2]", "not GeoJSON"),
        ('{"name": "a package"}', "not GeoJSON"),
        ('{"type": "FeatureCollection", "features": 3}', "not GeoJSON"),
        ('{"type": "FeatureCollection", "features": []}', "no lines in it; it holds no features"),
        ('{"type": "Point", "coordinates": [1, 2]}', "no lines in it; it holds 1 Point"),
        ('{"type": "LineString", "coordinates": []}', "no lines in it; it holds 1 empty LineString"),
        ('{"type": "LineString", "coordinates": [[0, 0], [1]]}', "feature 0: its coordinates are not pairs"),
        ('{"type": "LineString", "coordinates": [0, 1]}', "feature 0: its coordinates are not pairs"),
        ('{"type": "LineString", "coordinates": [{"x": 0}]}', "feature 0: its coordinates are not pairs"),
        ('{"type": "LineString", "coordinates": [["a", "b"]]}', "feature 0: its coordinates are not pairs"),
        ('{"type": "LineString"}', "not GeoJSON"),
        (
            '{"type": "LineString", "coordinates": [[0, 0], [NaN, 1], [9, 9]]}',
            "feature 0: point 1 is not finite",
        ),
        (
            '{"type": "LineString", "coordinates": [[0, 0], [null, 1], [9, 9]]}',
            "feature 0: point 1 is not finite",
        ),
        ("", "the file is empty"),
    ],
)
def test_bad_geojson_is_told_in_one_line(tmp_path, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_network(write(tmp_path / "a.geojson", text), width=1.0)
    assert "a.geojson" in str(caught.value) and "\n" not in str(caught.value)


def test_bad_attributes(tmp_path):
    path = tmp_path / "a.geojson"
    for properties, message in (
        ({"width": "wide"}, "feature 0: width is 'wide', not a number"),
        ({"width": -5}, "gives no width"),
        ({"width": -9999}, "gives no width"),
        ({"breadth": 3}, "gives no width"),
    ):
        collection(path, feature("LineString", LINE, **properties), crs=None)
        with pytest.raises(ValueError, match=message):
            read_network(path)
        assert read_network(path, width=5.0).channel_count == 1
    for properties, fate in (
        ({"point_width": [1.0, 2.0]}, "belongs to a line of another length"),
        ({"point_width": "[1.0, 2.0"}, "cannot be read"),
        ({"point_width": ["a", "b", "c"]}, "cannot be read"),
    ):
        collection(path, feature("LineString", LINE, width=6, **properties), crs=None)
        with pytest.warns(UserWarning, match=f"the list point_width of 1 line {fate}"):
            assert read_network(path).channel_width.tolist() == [6.0]
    rest = [feature("LineString", np.add(LINE, [0.0, 500.0 * k, 0.0]).tolist()) for k in (1, 2)]
    collection(path, feature("LineString", LINE, width=5), *rest, crs=None)
    with pytest.raises(ValueError, match=r"feature 1: no width .2 of 3 lines have none.; pass missing_width="):
        read_network(path)
    assert read_network(path, missing_width=7).channel_width.tolist() == [5.0, 7.0, 7.0]


@pytest.mark.parametrize("suffix", GIS + SHP)
def test_cut_gis_files(tmp_path, suffix):
    lines = [sine(200, (0.0, 1000.0 * k)) for k in range(20)]
    write_network(RiverNetwork.from_polylines(lines, width=10.0), tmp_path / f"a{suffix}")
    whole = (tmp_path / f"a{suffix}").read_bytes()
    for part in (0.0, 0.001, 0.01, 0.1, 0.5, 0.9, 0.99):
        (tmp_path / f"a{suffix}").write_bytes(whole[: int(part * len(whole))])
        with pytest.raises(
            ValueError, match=rf"a\{suffix}: (cut short|cannot be read|the file is empty|\d+ of|no lines)"
        ):
            read_network(tmp_path / f"a{suffix}")


@needs_ogr
def test_layers_and_geometries(tmp_path):
    import pyogrio.raw
    import shapely

    def put(layer, *geometries, kind="Unknown", fields=None, crs="EPSG:32619"):
        fields = fields or {}
        pyogrio.raw.write(
            tmp_path / "a.gpkg",
            geometry=shapely.to_wkb(np.array(geometries, object)),
            layer=layer,
            crs=crs,
            geometry_type=kind,
            field_data=[np.array(v) for v in fields.values()],
            fields=np.array(list(fields)),
        )

    polygon = shapely.box(0, 0, 100, 100)
    put("lakes", polygon, kind="Polygon")
    with pytest.raises(ValueError, match=r"no lines in it; it has lakes \(Polygon\)"):
        read_network(tmp_path / "a.gpkg", width=5.0)
    with pytest.raises(ValueError, match="no lines in it; it holds 1 Polygon"):
        read_network(tmp_path / "a.gpkg", width=5.0, layer="lakes")
    high = shapely.LineString(LINE)
    put("anything", polygon, high, None, shapely.LineString(), fields={"Width_M": [1.0, 8.0, 9.0, 9.0]})
    network = read_network(tmp_path / "a.gpkg")
    np.testing.assert_array_equal(network.polylines()[0], np.array(LINE)[:, :2])
    np.testing.assert_array_equal(network.channel_width, [8.0])
    put(
        "rivers",
        shapely.MultiLineString([shapely.force_2d(high), [[200, 0], [300, 0]]]),
        kind="MultiLineString",
    )
    assert [len(xy) for xy in read_network(tmp_path / "a.gpkg", width=5.0).polylines()] == [4]
    with np.errstate(invalid="ignore"):
        put("rivers", shapely.LineString([[0, 0], [np.nan, 5], [9, 9]]), kind="LineString")
    with pytest.raises(ValueError, match="feature 0: point 1 is not finite"):
        read_network(tmp_path / "a.gpkg", width=5.0)
    put("rivers", shapely.LineString([[-67.0, -6.5], [-67.01, -6.5]]), kind="LineString", crs="EPSG:4326")
    with pytest.raises(ValueError, match="EPSG:4326 is longitude and latitude"):
        read_network(tmp_path / "a.gpkg", width=5.0)
    put(
        "rivers",
        shapely.LineString([[-67.0, -6.5], [-67.01, -6.5]]),
        kind="LineString",
        fields={"width": [np.nan]},
    )
    with pytest.raises(ValueError, match="gives no width"):
        read_network(tmp_path / "a.gpkg")


@needs_ogr
def test_other_files_under_a_gis_name(tmp_path):
    for suffix in (".gpkg", ".shp", ".fgb"):
        write(tmp_path / f"a{suffix}", "this is not it\n" * 20)
        with pytest.raises(ValueError, match=rf"a\{suffix}: cannot be read as"):
            read_network(tmp_path / f"a{suffix}", width=5.0)
    write_network(confluence(), tmp_path / "b.shp")
    (tmp_path / "b.shx").unlink()
    with pytest.raises(ValueError, match=r"b\.shp: cannot be read"):
        read_network(tmp_path / "b.shp", width=5.0)


@needs_parquet
def test_a_table_without_geometry_is_no_geoparquet(tmp_path):
    import pandas

    pandas.DataFrame({"a": [1, 2]}).to_parquet(tmp_path / "a.parquet")
    with pytest.raises(ValueError, match=r"a\.parquet: cannot be read as GeoParquet"):
        read_network(tmp_path / "a.parquet", width=5.0)
