"""Tests of the line files: every format there and back, every refusal, and real rivers."""

import gzip
import importlib.util
import json
import logging
import os
import subprocess
import sys
import textwrap
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from data_folder import DEFAULT, data_folder

from warpriver.io import line_formats, read_network, write_network
from warpriver.network import RiverNetwork, bankfull_depth, bankfull_discharge

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


# ---- there and back ----


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
    head = (tmp_path / "a.csv").read_text().splitlines()[:3]
    assert head[0] == "# crs=EPSG:32619 units=m order=downstream"
    assert head[1] == "channel,x,y,width,depth,discharge"
    assert head[2].startswith("0,58")
    assert np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=2).shape == (120, 6)


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
    assert [row["seg_id"] for row in table] == [0, 1, 2]
    assert [row["down_id"] for row in table] == [2, -1, -1]
    assert table[0]["to_node"] == table[1]["from_node"] == table[2]["from_node"]
    np.testing.assert_allclose([row["length"] for row in table], network.channel_lengths())
    assert "point_width" not in table[0]


def test_a_ring_flows_into_no_channel(tmp_path):
    t = np.linspace(0.0, 2.0 * np.pi, 50)
    ring = 500.0 * np.stack([np.cos(t), np.sin(t)], axis=1)
    ring[-1] = ring[0]
    write_network(RiverNetwork.from_polylines([ring], width=10.0), tmp_path / "a.geojson")
    assert json.loads((tmp_path / "a.geojson").read_text())["features"][0]["properties"]["down_id"] == -1


@needs_ogr
def test_gdal_reads_our_geojson(tmp_path):
    import pyogrio

    write_network(confluence(varying=True), tmp_path / "a.geojson", layer="rivers")
    info = pyogrio.read_info(tmp_path / "a.geojson")
    assert (info["crs"], info["features"], info["layer_name"]) == ("EPSG:32619", 3, "rivers")
    assert {"seg_id", "down_id", "width", "point_width"} <= set(info["fields"])


@needs_ogr
def test_a_geopackage_keeps_its_other_layers(tmp_path):
    import pyogrio

    path = tmp_path / "a.gpkg"
    write_network(confluence(), path, layer="before")
    write_network(confluence(varying=True), path, layer="after")
    write_network(confluence(varying=True), path, layer="after")
    assert sorted(name for name, _ in pyogrio.list_layers(path)) == ["after", "before"]
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
def test_a_shapefile_takes_no_section_that_varies_and_no_stale_parts(tmp_path):
    with pytest.raises(ValueError, match=r"shapefile cannot hold.*\.gpkg"):
        write_network(confluence(varying=True), tmp_path / "a.shp")
    write_network(confluence(), tmp_path / "a.shp")
    assert (tmp_path / "a.prj").exists()
    write_network(confluence(None), tmp_path / "a.shp")
    assert read_network(tmp_path / "a.shp").crs is None


# ---- writing that fails ----


@pytest.mark.parametrize("suffix", GIS + SHP)
def test_a_crs_that_no_library_knows(tmp_path, suffix):
    with pytest.raises(ValueError, match=rf"a\{suffix}: .*nonsense"):
        write_network(confluence("nonsense"), tmp_path / f"a{suffix}")
    assert not list(tmp_path.iterdir())


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


# ---- text ----

POINTS = [(0.0, 0.0), (100.0, 10.0), (200.0, -10.0), (300.5, 0.25)]


@pytest.mark.parametrize(
    "text",
    [
        "0,0\n100,10\n200,-10\n300.5,0.25\n",
        "0 0\n100 10\n200 -10\n300.5 0.25",
        "0\t0\r\n100\t10\r\n200\t-10\r\n300.5\t0.25\r\n",
        "0;0\n100;10\n200;-10\n300,5;0,25\n",
        "0,0;0\n100,0;10\n200,0;-10\n300,5;0,25\n",
        "  0   0\n  100   10\n\n\n# the end\n",
        "\ufeffx,y\n0,0\n100,10\n200,-10\n300.5,0.25\n",
        "# a comment\n\nx y\n# another\n0 0 # here\n100 10\n200 -10\n300.5 0.25\n",
        "RMTEXT\t350\t2\n0 0\n100 10\n200 -10\n300.5 0.25\n",
        "Easting,Northing\n0,0\n100,10\n200,-10\n300.5,0.25\n",
        'name,Y,left_x,X\nA,0,1,0\n"B, b",10,1,100\nC,-10,1,200\nD,0.25,1,300.5\n',
        "# y,x\n0,0\n10,100\n-10,200\n0.25,300.5\n",
        "0 0 7\n100 10 7\n200 -10 nan\n300.5 0.25 7\n",
        "id,x,y\n1,0,0\n2,100,10\n3,200,-10\n4,300.5,0.25\n",
        "# order=upstream\n300.5 0.25\n200 -10\n100 10\n0 0\n",
        "0, 0\n1e2, 1.0E1\n200., -10.\n+300.5, .25\n",
    ],
)
def test_text_layouts(tmp_path, text):
    path = tmp_path / "a.txt"
    path.write_bytes(text.encode())
    network = read_network(path, width=20.0)
    assert network.channel_count == 1
    expected = POINTS if "300" in text else [(0.0, 0.0), (50.0, 5.0), (100.0, 10.0)]
    np.testing.assert_array_equal(network.polylines()[0], expected)
    assert network.crs is None


def test_width_and_depth_of_each_point(tmp_path):
    path = write(
        tmp_path / "a.csv",
        """\
        # river=Jurua date=1987 crs=EPSG:32619 units=m order=downstream source=somewhere (Apache-2.0)
        x,y,width_m,depth_m,discharge
        0,0,20,2,5
        100,10,21,2.5,6
        200,-10,22,3,7
        """,
    )
    network = read_network(path)
    assert network.crs == "EPSG:32619"
    np.testing.assert_array_equal(network.point_widths()[0], [20.0, 21.0, 22.0])
    np.testing.assert_array_equal(network.point_section.numpy()[:, 1], [2.0, 2.5, 3.0])
    assert network.channel_discharge[0] == 6.0
    network = read_network(path, width=30.0, discharge=9.0)
    np.testing.assert_array_equal(network.point_widths()[0], 30.0)
    assert network.channel_discharge[0] == 9.0
    np.testing.assert_array_equal(read_network(path, width=[[7.0, 8.0, 9.0]]).point_widths()[0], [7.0, 8.0, 9.0])


def test_laws_fill_what_is_missing(tmp_path):
    network = read_network(write(tmp_path / "a.csv", "x,y,width\n0,0,30\n900,0,30\n1800,9,30\n"))
    np.testing.assert_allclose(network.channel_depth, bankfull_depth(30.0))
    np.testing.assert_allclose(network.channel_discharge, bankfull_discharge(30.0))


@pytest.mark.parametrize(("one", "two"), [("1", "2"), ("north", "south"), ("2.5", "-1"), ('"a, b"', '"c"')])
@pytest.mark.parametrize("name", ["channel", "Channel_ID", "seg_id", "id"])
def test_channels_by_column(tmp_path, name, one, two):
    rows = f"{one},0,0\n{one},100,0\n{one},200,5\n{two},0,900\n{two},100,900\n{two},150,905\n{two},200,900\n"
    network = read_network(write(tmp_path / "a.csv", f"{name},x,y\n{rows}"), width=9.0)
    assert [len(xy) for xy in network.polylines()] == [3, 4]


def test_channels_by_blank_line(tmp_path):
    blocks = "# first\n0 0\n100 0\n200 5\n \n\n# second\n0 900\n100 900\n# not a new one\n150 905\n200 900\n\n"
    network = read_network(write(tmp_path / "b.xy", blocks), width=[9.0, 8.0])
    assert [len(xy) for xy in network.polylines()] == [3, 4]
    np.testing.assert_array_equal(network.channel_width, [9.0, 8.0])
    path = write(tmp_path / "c.csv", "channel,x,y\n1,0,0\n1,9,0\n1,20,0\n2,0,5\n2,9,5\n2,20,5\n1,40,0\n1,50,0\n")
    with pytest.raises(ValueError, match="rows of channel 1 do not stand together"):
        read_network(path, width=1.0)


def test_a_million_rows_take_seconds(tmp_path):
    xy = np.cumsum(np.random.default_rng(0).random((1_000_000, 2)) + 0.01, axis=0)
    rows = "\n".join(f"{x:.2f},{y:.2f}" for x, y in xy.tolist())
    (tmp_path / "a.csv").write_text(rows)
    begin = time.perf_counter()
    network = read_network(tmp_path / "a.csv", width=1.0)
    assert network.point_count == 1_000_000
    assert time.perf_counter() - begin < 10.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: the file is empty"),
        (" \n\n", "a.csv: the file is empty"),
        ("# only\n# comments\n", "no row of numbers"),
        ("once upon a time\nthere was a river\n", "no row of numbers"),
        ("x,y\n", "no row of numbers"),
        ("x,y\n0,0\n\n1,one\n", r"a\.csv, line 4: 'one' is not a number \(column 2, y\)"),
        ("0,0\n1\n", r"a\.csv, line 2: 1 columns; y should be in column 2"),
        ("7\n0 0\n1 1\n", r"a\.csv, line 1: 1 columns"),
        ("x,y,width\n0,0,1\n1,1,\n", r"line 3: '' is not a number \(column 3, width\)"),
        ("x,y,channel\n0,0\n1,1\n", r"a\.csv, line 2: 2 columns; channel should be in column 3"),
        ("x,y,channel\n0,0,north\n1,1\n", r"a\.csv: its channels cannot be read"),
        ("0,0\n# c\n1,nan\n2,2\n", r"a\.csv, line 3: y is nan"),
        ("0,0\n-inf,3\n2,2\n", r"a\.csv, line 2: x is -inf"),
        ("a,b\n0,0\n1,1\n2,2\n", "its columns are a, b; name two of them x and y"),
        ("# units=ft\n0,0\n1,1\n2,2\n", "units=ft; only metres"),
        ("# order=sideways\n0,0\n1,1\n2,2\n", "order=sideways"),
        ("x,y\n0,0\n100,0\n200,0\n", r"gives no width; pass width= \(bankfull width in m\)"),
        ("x,y,width\n5,5,1\n5,5,1\n", "only one distinct point"),
        ("x,y,width\n0,0,1\n50,5,-1\n99,9,1\n", r"a\.csv: width of channel 0 is -1 m; it must be positive"),
        ("\x89PNG\x00\x00", "zero bytes"),
    ],
)
def test_bad_text_is_told_in_one_line(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match=message) as caught:
        read_network(path)
    assert "a.csv" in str(caught.value) and "\n" not in str(caught.value)


def test_a_cut_gzip_is_told_at_every_length(tmp_path):
    write_network(confluence(), tmp_path / "a.csv.gz")
    whole = (tmp_path / "a.csv.gz").read_bytes()
    for length in (1, 2, 9, 10, 15, len(whole) // 2, len(whole) - 9, len(whole) - 1):
        (tmp_path / "b.csv.gz").write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"b\.csv\.gz: not a whole gzip file"):
            read_network(tmp_path / "b.csv.gz")
    (tmp_path / "b.csv.gz").write_bytes(whole[:50] + bytes(20) + whole[70:])
    with pytest.raises(ValueError, match="not a whole gzip file"):
        read_network(tmp_path / "b.csv.gz")
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(b""))
    with pytest.raises(ValueError, match="is empty"):
        read_network(tmp_path / "b.csv.gz")


# ---- arguments ----


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
        ({"short": "keep"}, "short is 'keep'"),
        ({"layer": "b"}, r"\.csv has no layers"),
        ({"width": [1.0, 2.0]}, "width: 2 values for 1 channels"),
        ({"width": "wide"}, "width of channel 0 is 'wide', not a number"),
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


# ---- coordinate reference systems ----

LONLAT = "{0},{1}\n-67.0,-6.5\n-67.01,-6.51\n-67.03,-6.51\n-67.05,-6.5\n"


def test_geographic_coordinates_are_refused(tmp_path):
    named = write(tmp_path / "a.csv", LONLAT.format("lon", "lat"))
    stated = write(tmp_path / "b.csv", "# crs=EPSG:4326\n" + LONLAT.format("x", "y"))
    degrees = write(tmp_path / "c.csv", "# units=degrees\n" + LONLAT.format("x", "y"))
    for path in (named, stated, degrees):
        with pytest.raises(ValueError, match=r"longitude and latitude, not metres; pass to_crs=\"utm\""):
            read_network(path, width=50.0)
    # Nothing is stated: a line in degrees is always shorter than it is wide, whatever `short` is.
    bare = write(tmp_path / "d.csv", LONLAT.format("x", "y"))
    for short in ("error", "narrow", "drop"):
        with pytest.raises(ValueError, match=r'look like longitude and latitude.*crs="EPSG:4326" and to_crs="utm"'):
            read_network(bare, width=50.0, short=short)
    with pytest.raises(ValueError, match=r"longitude and latitude by format or name.*EPSG:32619"):
        read_network(named, width=50.0, crs="EPSG:32619")
    with pytest.raises(ValueError, match="file is in EPSG:4326 but crs= says EPSG:32619"):
        read_network(stated, width=50.0, crs="EPSG:32619")


def test_small_local_metres_pass(tmp_path):
    # A laboratory flume fits into 180 by 90, and is longer than wide.
    path = write(tmp_path / "a.csv", "0,0\n1,0.2\n2,-0.2\n4,0\n")
    assert read_network(path, width=0.3).channel_count == 1
    write_network(read_network(path, width=0.3), tmp_path / "a.geojson")
    assert read_network(tmp_path / "a.geojson").crs is None


@needs_pyproj
def test_reprojection(tmp_path):
    import pyproj

    path = write(tmp_path / "a.csv", LONLAT.format("lon", "lat"))
    network = read_network(path, width=50.0, to_crs="utm")
    assert network.crs == "EPSG:32719"  # 67 W, southern hemisphere
    change = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32719", always_xy=True)
    expected = np.stack(change.transform([-67.0, -67.01, -67.03, -67.05], [-6.5, -6.51, -6.51, -6.5]), axis=1)
    np.testing.assert_allclose(network.polylines()[0], expected, rtol=1e-12)
    geod = pyproj.Geod(ellps="WGS84").line_length([-67.0, -67.01, -67.03, -67.05], [-6.5, -6.51, -6.51, -6.5])
    np.testing.assert_allclose(network.channel_lengths()[0], geod, rtol=1e-3)
    assert read_network(path, width=50.0, to_crs="EPSG:31979").crs == "EPSG:31979"
    swapped = write(tmp_path / "b.csv", "latitude;longitude\n-6,5;-67\n-6,51;-67,01\n-6,51;-67,03\n-6,5;-67,05\n")
    same_lines(read_network(swapped, width=50.0, to_crs="utm").polylines(), network.polylines())
    # NAD83 may be stated for columns named lon and lat.
    assert read_network(path, width=50.0, crs="EPSG:4269", to_crs="utm").crs == "EPSG:32719"
    plain = write(tmp_path / "c.csv", "0,0\n1000,0\n2000,0\n")
    with pytest.raises(ValueError, match="states no CRS to reproject from; pass it as crs="):
        read_network(plain, width=50.0, to_crs="utm")
    with pytest.raises(ValueError, match="pyproj does not know the CRS 'EPSG:1'"):
        read_network(plain, width=50.0, crs="EPSG:1")
    with pytest.raises(ValueError, match="to_crs=: pyproj does not know"):
        read_network(path, width=50.0, to_crs="mars")
    with pytest.raises(ValueError, match="to_crs"):
        read_network(path, width=50.0, to_crs="EPSG:4269")


@needs_pyproj
def test_utm_zone_at_the_date_line_and_the_pole(tmp_path):
    rows = "lon,lat\n179.9,-16.5\n-179.9,-16.51\n-179.8,-16.5\n"
    assert read_network(write(tmp_path / "a.csv", rows), width=9.0, to_crs="UTM").crs == "EPSG:32701"
    rows = "lon,lat\n10,86\n10.1,86\n10.2,86\n"
    with pytest.raises(ValueError, match="UTM has no zone at 86 degrees"):
        read_network(write(tmp_path / "b.csv", rows), width=9.0, to_crs="utm")
    rows = "lon,lat\n10,95\n10.1,95\n10.2,95\n"
    with pytest.raises(ValueError, match="3 points cannot be brought from"):
        read_network(write(tmp_path / "c.csv", rows), width=9.0, to_crs="EPSG:32632")


@needs_pyproj
def test_files_of_two_zones_meet_in_one(tmp_path):
    a = write(tmp_path / "a.csv", "# crs=EPSG:32619\n780000,0\n790000,0\n800000,0\n")
    b = write(tmp_path / "b.csv", "# crs=EPSG:32620\n180000,0\n190000,0\n200000,0\n")
    network = read_network([a, b], width=50.0, to_crs="EPSG:32619")
    assert network.crs == "EPSG:32619"
    np.testing.assert_array_equal(network.polylines()[0][0], [780000.0, 0.0])
    assert 8.4e5 < network.polylines()[1][0, 0] < 8.6e5
    assert read_network([a, b], width=50.0, to_crs="utm").crs in ("EPSG:32619", "EPSG:32620")


@needs_pyproj
def test_feet_are_refused_or_reprojected(tmp_path):
    path = write(tmp_path / "a.csv", "# crs=EPSG:2263\n980000,200000\n990000,200000\n1000000,201000\n")
    with pytest.raises(ValueError, match=r"EPSG:2263 is in US survey foot, not metres; pass to_crs="):
        read_network(path, width=50.0)
    network = read_network(path, width=50.0, to_crs="utm")
    assert network.crs == "EPSG:32618"
    np.testing.assert_allclose(network.channel_lengths()[0], 20050.0 * 1200.0 / 3937.0, rtol=1e-3)


def mercator_rows(latitude):
    y = 6378137.0 * np.arcsinh(np.tan(np.radians(latitude)))
    return "# crs=EPSG:3857\n" + "".join(f"{x},{y}\n" for x in (-8e6, -7.99e6, -7.98e6))


@pytest.mark.parametrize("bare", [False, True])
def test_web_mercator_depends_on_the_latitude(tmp_path, monkeypatch, bare):
    if bare:
        monkeypatch.setitem(sys.modules, "pyproj", None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_network(write(tmp_path / "a.csv", mercator_rows(3)), width=50.0).crs == "EPSG:3857"
    with pytest.warns(UserWarning, match=r"1\.0[34]\d* times those on the ground"):
        read_network(write(tmp_path / "a.csv", mercator_rows(15)), width=50.0)
    with pytest.raises(ValueError, match=r"EPSG:3857 are 2 times those on the ground there; pass to_crs="):
        read_network(write(tmp_path / "a.csv", mercator_rows(60)), width=50.0)


def test_without_pyproj(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyproj", None)
    path = write(tmp_path / "a.csv", "# crs=EPSG:32619\n0,0\n100,0\n200,0\n")
    assert read_network(path, width=5.0).crs == "EPSG:32619"
    assert read_network(path, width=5.0, crs="urn:ogc:def:crs:EPSG::32619").crs == "EPSG:32619"
    with pytest.raises(ImportError, match=r'to_crs needs pyproj: pip install "warpriver\[gis\]"'):
        read_network(path, width=5.0, to_crs="utm")
    with pytest.raises(ValueError, match="not metres"):
        read_network(write(tmp_path / "b.csv", LONLAT.format("lon", "lat")), width=5.0)


# ---- GeoJSON ----


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
        ({"point_width": [1.0, 2.0]}, r"point_width has 2 numbers for 3 points; remove it, or pass width="),
        ({"point_width": "[1.0, 2.0"}, "point_width is not a list of numbers"),
        ({"point_width": ["a", "b", "c"]}, "point_width is not a list of numbers"),
        ({"width": -9999}, "width of channel 0 is -9999 m"),
        ({"breadth": 3}, "gives no width"),
    ):
        collection(path, feature("LineString", LINE, **properties), crs=None)
        with pytest.raises(ValueError, match=message):
            read_network(path)
        assert read_network(path, width=5.0).channel_count == 1
    collection(path, feature("LineString", LINE, width=5), feature("LineString", LINE), crs=None)
    with pytest.raises(ValueError, match=r"feature 1: no width .1 of 2"):
        read_network(path)


# ---- GIS formats ----


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


# ---- real rivers ----


def data_files(pattern):
    root = Path(os.environ.get("WARPRIVER_DATA", DEFAULT))
    missing = pytest.mark.skip(reason=f"no {pattern} in {root}; set WARPRIVER_DATA")
    files = [pytest.param(f, id=f.name) for f in sorted(root.glob(pattern))]
    return files or [pytest.param(None, id=pattern, marks=missing)]


@pytest.mark.parametrize("path", data_files("centerlines/*.csv.gz"))
def test_amazon_centrelines(path):
    network = read_network(path)
    raw = np.loadtxt(path, delimiter=",", skiprows=2)
    np.testing.assert_allclose(network.polylines()[0], raw[:, :2], rtol=1e-15)
    np.testing.assert_array_equal(network.point_widths()[0], raw[:, -1])
    assert network.crs in ("EPSG:32619", "EPSG:32620")


@pytest.mark.parametrize("path", data_files("mamore_series/*.csv.gz"))
def test_mamore_series(path):
    network = read_network(path, width=250.0)
    assert (network.channel_count, network.crs) == (1, "EPSG:32620")
    assert 3.1e5 < network.channel_lengths()[0] < 4.1e5
    with pytest.raises(ValueError, match="gives no width"):
        read_network(path)


@pytest.mark.parametrize("path", data_files("centerlines_local/*.txt"))
def test_local_centrelines(path):
    network = read_network(path, width=40.0)
    raw = np.loadtxt(path, skiprows=1 if "mackinaw" in path.name else 0)
    assert network.point_count == len(raw)
    np.testing.assert_allclose(network.polylines()[0], raw, atol=1e-9)
    assert network.crs is None


@needs_pyproj
def test_jurua_in_web_mercator():
    path = data_folder("centerlines_local") / "jurua.txt"
    with pytest.warns(UserWarning, match=r"1\.02 times those on the ground"):
        local = read_network(path, width=200.0, crs="EPSG:3857")
    utm = read_network(path, width=200.0, crs="EPSG:3857", to_crs="utm")
    assert utm.crs == "EPSG:32718"
    np.testing.assert_allclose(local.channel_lengths() / utm.channel_lengths(), 1.012, atol=1e-3)


@needs_ogr
def test_amazon_geopackage():
    path = data_folder("centerlines") / "amazon_centerlines.gpkg"
    with pytest.raises(ValueError, match=r"several layers hold lines: centerlines_utm19n, centerlines_utm20n"):
        read_network(path)
    network = read_network(path, layer="centerlines_utm19n")
    assert (network.channel_count, network.crs) == (2, "EPSG:32619")
    np.testing.assert_allclose(network.channel_width, [273.194674, 245.021835])
    assert read_network(path, layer="centerlines_utm20n").crs == "EPSG:32620"
    text = read_network(data_folder("centerlines") / "purus_19870701.csv.gz")
    np.testing.assert_allclose(network.polylines()[0], text.polylines()[0], atol=1e-9)


@needs_ogr
def test_shellmound_flowlines(tmp_path):
    path = data_folder("networks") / "shellmound_nhdplus.gpkg"
    with pytest.raises(ValueError, match=r"32 of 432 lines are like that.*short='narrow'"):
        read_network(path)
    network = read_network(path, layer="flowlines", short="narrow")
    assert (network.channel_count, network.crs) == (432, "EPSG:5070")
    assert network.node_count < 500
    write_network(network, tmp_path / "a.csv")
    same_lines(read_network(tmp_path / "a.csv").polylines(), network.polylines())
