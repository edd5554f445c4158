"""Tests of the line files: every format there and back, writing that fails, arguments that do not fit."""

import csv
import json
import logging
import os
import subprocess
import sys

import numpy as np
import pytest
from river_files import (
    CORE,
    GIS,
    HAS_OGR,
    HAS_PARQUET,
    SHP,
    confluence,
    needs_ogr,
    needs_parquet,
    needs_pyproj,
    same_lines,
    sine,
    write,
)

from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge
from warpriver.io import line_formats, read_network, write_network
from warpriver.network import RiverNetwork


@pytest.mark.parametrize("crs", ["EPSG:32619", None])
@pytest.mark.parametrize("suffix", CORE + GIS + SHP)
def test_round_trip_keeps_every_bit_of_the_coordinates(tmp_path, suffix, crs):
    network = confluence(crs)
    path = tmp_path / f"rivers{suffix}"
    write_network(network, path)
    back = read_network(path)
    same_lines(back.polylines(), network.polylines())
    assert back.crs == crs
    np.testing.assert_array_equal(back.channel_width, network.channel_width)
    np.testing.assert_array_equal(back.channel_depth, network.channel_depth)
    np.testing.assert_array_equal(back.channel_discharge, network.channel_discharge)
    np.testing.assert_array_equal(back.channel_from, network.channel_from)
    np.testing.assert_array_equal(back.channel_to, network.channel_to)
    assert back.point_section is None
    assert not list(tmp_path.glob(".*"))  # nothing is left beside


@pytest.mark.parametrize("suffix", CORE + GIS)
def test_round_trip_keeps_a_section_that_varies(tmp_path, suffix):
    network = confluence(varying=True)
    path = tmp_path / f"rivers{suffix}"
    write_network(network, path)
    back = read_network(path)
    np.testing.assert_array_equal(back.point_section.numpy(), network.point_section.numpy())
    np.testing.assert_array_equal(back.channel_width, network.channel_width)
    np.testing.assert_array_equal(back.channel_depth, network.channel_depth)
    # An argument overrides what varies in the file.
    assert read_network(path, width=70.0, depth=2.0).point_section is None


def test_round_trip_in_single_precision(tmp_path):
    network = confluence().to(dtype="float32")
    write_network(network, tmp_path / "a.csv")
    same_lines(read_network(tmp_path / "a.csv", dtype="float32").polylines(), network.polylines())


@pytest.mark.parametrize(
    "suffix",
    [
        pytest.param(".csv", marks=needs_pyproj),
        pytest.param(".geojson", marks=needs_pyproj),
        pytest.param(".gpkg", marks=[needs_ogr, needs_pyproj]),
        pytest.param(".parquet", marks=[needs_parquet, needs_pyproj]),
        pytest.param(".fgb", marks=[needs_ogr, needs_pyproj]),
        pytest.param(".shp", marks=[needs_ogr, needs_pyproj]),
    ],
)
def test_round_trip_keeps_a_crs_without_code(tmp_path, suffix):
    import pyproj

    crs = pyproj.CRS("+proj=laea +lat_0=-6 +lon_0=-68 +datum=WGS84 +units=m")
    write_network(confluence(crs.to_wkt(), shift=(0.0, 0.0)), tmp_path / f"a{suffix}")
    back = read_network(tmp_path / f"a{suffix}")
    # Shapefiles know an older kind of WKT, which renames the datum: there the projection is compared.
    same = pyproj.CRS(back.crs)
    if suffix == ".shp":
        values = [[p.value for p in system.coordinate_operation.params] for system in (same, crs)]
        assert values[0] == values[1]
    else:
        assert same.equals(crs)


def test_csv_has_the_documented_head(tmp_path):
    write_network(confluence(), tmp_path / "a.csv")
    rows = list(csv.reader((tmp_path / "a.csv").open()))
    assert rows[0] == "channel_id x y width_m depth_m discharge_m3s from_node to_node warpriver".split()
    assert rows[1][1].startswith("58") and {len(row) for row in rows} == {9}
    facts = {"crs": "EPSG:32619", "units": "m", "order": "downstream", "origin": [583000.0, -717000.0]}
    assert [json.loads(row[-1]) for row in rows[1:] if row[-1]] == [facts] * 3  # once a channel
    assert np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1, usecols=range(8)).shape == (120, 8)


def test_other_text_has_its_facts_in_comments(tmp_path):
    write_network(confluence(), tmp_path / "a.txt")
    head = (tmp_path / "a.txt").read_text().splitlines()[:2]
    assert head[0] == "# crs=EPSG:32619 units=m order=downstream origin_x=583000.0 origin_y=-717000.0"
    assert head[1] == "channel_id x y width_m depth_m discharge_m3s from_node to_node"


def test_the_same_network_gives_the_same_bytes(tmp_path):
    for suffix in (".csv.gz", ".geojson.gz"):
        for name in ("a", "b"):
            write_network(confluence(), tmp_path / f"{name}{suffix}")
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_attributes_name_the_channel_downstream(tmp_path):
    trunk = sine(30)
    # The trunk splits into a small and a large arm; the large one is the heir though it comes later.
    arms = [trunk[-1] + sine(20, seed=k) - sine(20, seed=k)[0] for k in (1, 2)]
    arms[1][:, 1] *= -1.0
    arms[1] += trunk[-1] - arms[1][0]
    network = RiverNetwork.from_polylines([trunk, *arms], width=[50.0, 20.0, 40.0])
    write_network(network, tmp_path / "a.geojson")
    table = [f["properties"] for f in json.loads((tmp_path / "a.geojson").read_text())["features"]]
    assert [row["channel_id"] for row in table] == [0, 1, 2]
    assert [row["next_down"] for row in table] == [2, -1, -1]
    assert table[0]["to_node"] == table[1]["from_node"] == table[2]["from_node"]
    np.testing.assert_allclose([row["length_m"] for row in table], network.channel_lengths())
    # Water parts, so that there are no orders; the section is constant, so that there are no lists.
    assert not {"strahler", "point_width_m"} & set(table[0])


def test_a_ring_flows_into_no_channel(tmp_path):
    t = np.linspace(0.0, 2.0 * np.pi, 50)
    ring = 500.0 * np.stack([np.cos(t), np.sin(t)], axis=1)
    ring[-1] = ring[0]
    write_network(RiverNetwork.from_polylines([ring], width=10.0), tmp_path / "a.geojson")
    row = json.loads((tmp_path / "a.geojson").read_text())["features"][0]["properties"]
    assert row["next_down"] == -1 and row["sinuosity"] is None and row["from_node"] == row["to_node"]
    np.testing.assert_array_equal(read_network(tmp_path / "a.geojson").channel_to, [0])


@needs_ogr
def test_gdal_reads_our_geojson(tmp_path):
    import pyogrio

    write_network(confluence(varying=True), tmp_path / "a.geojson", layer="rivers")
    info = pyogrio.read_info(tmp_path / "a.geojson")
    assert (info["crs"], info["features"], info["layer_name"]) == ("EPSG:32619", 3, "rivers")
    assert {"channel_id", "next_down", "width_m", "point_width_m", "strahler"} <= set(info["fields"])


@needs_ogr
def test_a_geopackage_keeps_its_other_layers(tmp_path):
    import pyogrio

    path = tmp_path / "a.gpkg"
    write_network(confluence(), path, layer="before")
    write_network(confluence(varying=True), path, layer="after")
    write_network(confluence(varying=True), path, layer="after")
    layers = sorted(name for name, _ in pyogrio.list_layers(path))
    assert layers == ["after", "after_nodes", "after_points", "before", "before_nodes", "layer_styles"]
    with pytest.raises(ValueError, match=r"several layers hold lines: .*before.*layer="):
        read_network(path)
    with pytest.raises(ValueError, match=r"no layer 'none' .*before"):
        read_network(path, layer="none")
    assert read_network(path, layer="before").point_section is None
    assert read_network(path, layer="after").point_section is not None
    # What is no whole GeoPackage is replaced.
    for rest in (b"not a GeoPackage", path.read_bytes()[:9000]):
        (tmp_path / "b.gpkg").write_bytes(rest)
        write_network(confluence(), tmp_path / "b.gpkg")
        assert read_network(tmp_path / "b.gpkg").channel_count == 3


@needs_ogr
def test_a_shapefile_has_the_mean_section_and_no_stale_parts(tmp_path):
    network = confluence(varying=True)
    with pytest.warns(UserWarning, match=r"one width and one depth for each channel.*\.gpkg"):
        write_network(network, tmp_path / "a.shp")
    again = read_network(tmp_path / "a.shp")
    assert again.point_section is None
    np.testing.assert_allclose(again.channel_width, network.channel_width, rtol=1e-14)
    assert (tmp_path / "a.prj").exists()
    write_network(confluence(None), tmp_path / "a.shp")
    assert read_network(tmp_path / "a.shp").crs is None


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    write_network(confluence(), path)
    before = path.read_bytes()
    monkeypatch.setattr(RiverNetwork, "polylines", lambda self: [np.zeros((3, 2)), None, None])
    with pytest.raises((TypeError, ValueError)):
        write_network(confluence(), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


def test_writing_where_it_is_impossible(tmp_path, monkeypatch):
    network = confluence()
    with pytest.raises(OSError, match=r"cannot write .*nowhere.*a\.csv: No such file"):
        write_network(network, tmp_path / "nowhere" / "a.csv")
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"cannot write .*Not a directory"):
        write_network(network, tmp_path / "file" / "a.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(OSError, match=r"cannot write .*folder\.csv: it is a directory"):
        write_network(network, tmp_path / "folder.csv")
    with pytest.raises(ValueError, match=r"\.docx names no format; known are \.csv"):
        write_network(network, tmp_path / "a.docx")

    def denied(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", denied)
    with pytest.raises(PermissionError, match=r"cannot write .*a\.csv: Permission denied"):
        write_network(network, tmp_path / "a.csv")


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"a\.csv: there is no such file"):
        read_network(tmp_path / "a.csv")
    with pytest.raises(ValueError, match=r"\.docx names no format; known are \.csv, .*\.parquet"):
        read_network("a.docx")
    for name in ("a", "a.gz", "a.gpkg.gz"):
        with pytest.raises(ValueError, match="names no format"):
            read_network(name)
    (tmp_path / "b.csv").mkdir()
    with pytest.raises(ValueError, match="is a directory"):
        read_network(tmp_path / "b.csv")
    with pytest.raises(ValueError, match="list of paths is empty"):
        read_network([])


def test_arguments_that_do_not_fit(tmp_path):
    path = write(tmp_path / "a.csv", "0,0\n100,0\n200,0\n")
    for changes, message in (
        ({"repeated": "merge"}, "repeated is 'merge'; use one of 'drop', 'error'"),
        ({"short": "merge"}, "short is 'merge'"),
        ({"layer": "b"}, r"\.csv has no layers"),
        ({"width": [1.0, 2.0]}, "width: 2 values for 1 channels"),
        ({"width": "wide"}, "width is 'wide'; give a number"),
        ({"width": [[1.0, 2.0]]}, r"shape \(2,\) for 3 points"),
        ({"discharge": [[1.0, 2.0, 3.0]]}, "discharge of channel 0"),
        ({"dtype": "float16"}, "float16"),
        ({"device": "abacus"}, "abacus"),
    ):
        with pytest.raises(ValueError, match=message):
            read_network(path, **({"width": 5.0} | changes))


def test_repeated_points(tmp_path, caplog):
    path = write(tmp_path / "a.csv", "x,y,width\n0,0,5\n0,0,6\n100,0,7\n200,0,8\n200,0,9\n200,0,9\n")
    with caplog.at_level(logging.INFO, logger="warpriver"):
        network = read_network(path)
    np.testing.assert_array_equal(network.polylines()[0], [(0.0, 0.0), (100.0, 0.0), (200.0, 0.0)])
    np.testing.assert_array_equal(network.point_widths()[0], [5.0, 7.0, 8.0])
    assert "3 points that stood twice" in caplog.text
    with pytest.raises(ValueError, match=r"points 0 and 1 are both at \(0, 0\)"):
        read_network(path, repeated="error")


def test_two_points_get_a_third(tmp_path):
    network = read_network(write(tmp_path / "a.csv", "x,y,width\n0,0,5\n100,20,7\n"))
    np.testing.assert_array_equal(network.polylines()[0], [(0.0, 0.0), (50.0, 10.0), (100.0, 20.0)])
    np.testing.assert_array_equal(network.point_widths()[0], [5.0, 6.0, 7.0])


def test_channels_shorter_than_wide(tmp_path, caplog):
    text = "channel,x,y,width\n" + "".join(
        f"{c},{x},0,{w}\n"
        for c, a, b, w in ((0, 0, 500, 20), (1, 500, 510, 30), (2, 510, 900, 20))
        for x in (a, (a + b) / 2, b)
    )
    path = write(tmp_path / "a.csv", text)
    with pytest.raises(ValueError, match=r"channel 1: 10 m long but 30 m wide .1 of 3 .*short='narrow'"):
        read_network(path)
    with caplog.at_level(logging.INFO, logger="warpriver"):
        network = read_network(path, short="narrow")
    assert "1 of 3 lines are shorter" in caplog.text
    np.testing.assert_allclose(network.channel_width, [20.0, 10.0, 20.0], rtol=2e-6)
    np.testing.assert_allclose(network.channel_depth[1], bankfull_depth(30.0))
    np.testing.assert_allclose(network.channel_discharge[1], bankfull_discharge(30.0))
    assert network.node_count == 4
    assert read_network(path, short="drop").channel_count == 2
    with pytest.raises(ValueError, match="3 of 3"):
        read_network(path, width=1000.0, short="drop")


def test_several_files(tmp_path):
    head = "# crs=EPSG:{} units=m\n"
    rows = "0,{0}\n100,{0}\n200,{0}\n"
    a = write(tmp_path / "a.csv", head.format(32619) + rows.format(0))
    b = write(tmp_path / "b.csv", head.format(32619) + rows.format(500))
    c = write(tmp_path / "c.csv", head.format(32620) + rows.format(500))
    d = write(tmp_path / "d.csv", rows.format(500))
    network = read_network([a, str(b)], width=[5.0, 6.0])
    assert (network.channel_count, network.crs) == (2, "EPSG:32619")
    with pytest.raises(ValueError, match=r"a\.csv is in EPSG:32619 and .*c\.csv in EPSG:32620; pass to_crs="):
        read_network([a, c], width=5.0)
    with pytest.raises(ValueError, match=r"d\.csv in no CRS"):
        read_network([a, d], width=5.0)
    assert read_network([a, d], width=5.0, crs="EPSG:32619").channel_count == 2


@pytest.mark.parametrize(
    ("suffix", "module"),
    [(".gpkg", "pyogrio"), (".shp", "pyogrio"), (".fgb", "pyogrio"), (".parquet", "geopandas")],
)
def test_a_missing_extra_says_what_to_install(tmp_path, monkeypatch, suffix, module):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / f"a{suffix}").write_bytes(b"some bytes")
    text = rf'{suffix} needs {module}: pip install "warpriver\[gis\]"'
    with pytest.raises(ImportError, match=f"reading {text}"):
        read_network(tmp_path / f"a{suffix}", width=5.0)
    with pytest.raises(ImportError, match=f"writing {text}"):
        write_network(confluence(), tmp_path / f"b{suffix}")


def test_formats_and_lazy_imports(tmp_path):
    formats = line_formats()
    assert formats[".csv"] and formats[".geojson"]
    assert formats[".gpkg"] == HAS_OGR and formats[".parquet"] == HAS_PARQUET
    code = (
        "import sys, warpriver.io; "
        "assert not {'pyogrio', 'geopandas', 'shapely', 'pyproj', 'pyarrow', 'pandas'} & set(sys.modules)"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, cwd=tmp_path)
