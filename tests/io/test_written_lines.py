"""Tests of what other programs find in the line files: names, databases that are open, styles, numbers that fit."""

import contextlib
import csv
import json
import os
import sqlite3
import struct
import subprocess
import sys

import numpy as np
import pytest
from plain import plain_params
from river_files import GIS, HAS_OGR, SHP, confluence, needs_ogr, needs_pyproj, same_lines

from warpriver import Simulation
from warpriver.channel_table import JOINT_LOCK, JOINT_NONE, JOINT_THROUGH
from warpriver.errors import PathError
from warpriver.io import read_network, write_network
from warpriver.network import RiverNetwork

NAMES = [
    "a!b",
    "!GIS/rivers",
    " blank",
    "zip:rivers",
    "http:/host/rivers",
    "zip!/a.zip!rivers",
    "x.zip/rivers",
    "a b#c",
]


@pytest.mark.parametrize("suffix", [".csv", ".geojson", *GIS, *SHP])
@pytest.mark.parametrize("name", NAMES)
def test_a_path_is_a_path_whatever_stands_in_it(tmp_path, monkeypatch, suffix, name):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / f"{name}{suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    for other in ("b", "rivers", "a"):  # what a name would mean as an address
        (tmp_path / f"{other}{suffix}").write_bytes(b"of somebody else")
    write_network(confluence(), f"{name}{suffix}")
    assert path.is_file()
    again = read_network(f"{name}{suffix}", short="keep")
    same_lines(again.polylines(), confluence().polylines())
    assert again.crs == ("EPSG:32619" if suffix != ".shp" or HAS_OGR else None)
    for other in ("b", "rivers", "a"):
        assert (tmp_path / f"{other}{suffix}").read_bytes() == b"of somebody else"
    assert not list(tmp_path.rglob(".writing-*"))


def test_a_writer_that_wrote_nothing_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("warpriver.io.vector.networks.write_text", lambda *args: None)
    with pytest.raises(OSError, match=r"cannot write .*a\.csv: nothing was written"):
        write_network(confluence(), tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


# ---- GeoPackages that other programs have open

HOLDER = """
import os, sqlite3, sys
base = sqlite3.connect("a.gpkg", isolation_level=None)
base.execute("PRAGMA journal_mode=WAL").fetchone()
base.execute("PRAGMA wal_autocheckpoint=0")
base.execute("CREATE TABLE notes (text)")
base.execute("INSERT INTO notes VALUES ('kept')")
print("ready", flush=True)
if sys.stdin.readline().strip() == "crash":
    os._exit(0)
print(base.execute("SELECT count(*) FROM channels").fetchone()[0], flush=True)
base.close()
"""


@needs_ogr
@pytest.mark.parametrize("how", ["open", "crash"])
def test_a_geopackage_in_another_program_keeps_what_that_wrote(tmp_path, how):
    path = tmp_path / "a.gpkg"
    write_network(confluence(), path, layer="older")
    command = [sys.executable, "-c", HOLDER]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert holder.stdout.readline() == "ready\n"
    if how == "crash":
        holder.communicate("crash\n")
    write_network(confluence(), path)
    if how == "open":
        # The other program sees the new layer in the database that it has open.
        assert holder.communicate("look\n")[0] == "3\n"
    with contextlib.closing(sqlite3.connect(path)) as database:
        assert database.execute("SELECT text FROM notes").fetchall() == [("kept",)]
    assert read_network(path, layer="older").channel_count == read_network(path, layer="channels").channel_count == 3


@needs_ogr
def test_a_geopackage_that_is_being_written_to_is_left(tmp_path, monkeypatch):
    monkeypatch.setattr("warpriver.io.vector.geopackage.PATIENCE", 0.2)
    path = tmp_path / "a.gpkg"
    write_network(confluence(), path)
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        other.execute("CREATE TABLE notes (text)")
        with pytest.raises(PathError, match=r"cannot write .*a\.gpkg: another program is using it; close it"):
            write_network(confluence(), path, layer="more")
        other.execute("COMMIT")
    there = {name for (name,) in tables(path, "SELECT name FROM sqlite_master")}
    assert "notes" in there and "more" not in there


@needs_ogr
def test_a_geopackage_that_changed_meanwhile_is_left(tmp_path, monkeypatch):
    from warpriver.io.vector import layers

    path = tmp_path / "a.gpkg"
    write_network(confluence(), path)

    def meddle(*args, kept=layers.add_styles):
        kept(*args)
        with contextlib.closing(sqlite3.connect(path)) as other:
            other.execute("CREATE TABLE notes (text)")
            other.commit()

    monkeypatch.setattr(layers, "add_styles", meddle)
    with pytest.raises(PathError, match=r"another program changed it meanwhile; nothing was written"):
        write_network(confluence(), path, layer="more")
    assert [p.name for p in tmp_path.iterdir()] == ["a.gpkg"]


# ---- what a GeoPackage holds for a GIS


def tables(path, query, *values):
    with contextlib.closing(sqlite3.connect(path)) as database:
        return database.execute(query, values).fetchall()


@needs_ogr
def test_layers_have_a_style_and_a_users_own_stays(tmp_path):
    path = tmp_path / "a.gpkg"
    write_network(confluence(varying=True), path)
    rows = tables(path, "SELECT f_table_name, f_geometry_column, styleQML, useAsDefault FROM layer_styles")
    assert [(name, column, default) for name, column, _, default in rows] == [
        (name, "geom", 1) for name in ("channels", "channels_nodes", "channels_points")
    ]
    assert all(qml.startswith("<!DOCTYPE qgis") and "renderer-v2" in qml for _, _, qml, _ in rows)
    assert tables(path, "SELECT data_type FROM gpkg_contents WHERE table_name = 'layer_styles'") == [("attributes",)]
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE layer_styles SET styleQML = 'mine' WHERE f_table_name = 'channels'")
        database.commit()
    write_network(confluence(varying=True), path)
    assert tables(path, "SELECT styleQML FROM layer_styles WHERE f_table_name = 'channels'") == [("mine",)]


@needs_ogr
def test_widths_of_points_are_a_layer_of_points(tmp_path):
    import pyogrio

    network, path = confluence(varying=True), tmp_path / "a.gpkg"
    write_network(network, path)
    frame = pyogrio.read_dataframe(path, layer="channels_points")
    assert list(frame.columns) == ["channel_id", "point", "distance_m", "width_m", "depth_m", "geometry"]
    first = frame[frame.channel_id == 0]
    same_lines([np.c_[first.geometry.x, first.geometry.y]], network.polylines()[:1])
    np.testing.assert_array_equal(first.width_m, network.point_widths()[0])
    steps = np.hypot(*np.diff(network.polylines()[0], axis=0).T)
    np.testing.assert_allclose(np.diff(first.distance_m), steps, rtol=1e-12)
    assert not [name for name in pyogrio.read_info(path, layer="channels")["fields"] if name.startswith("point")]
    again = read_network(path)
    same_lines(again.point_widths(), network.point_widths())
    same_lines(again.point_depths(), network.point_depths())
    # A network without such widths leaves none of an older one there, in no table that names tables.
    write_network(confluence(), path)
    assert read_network(path).point_section is None
    named = tables(path, "SELECT name FROM sqlite_master WHERE name LIKE '%channels_points%'")
    named += tables(path, "SELECT table_name FROM gpkg_contents WHERE table_name = 'channels_points'")
    named += tables(path, "SELECT table_name FROM gpkg_geometry_columns WHERE table_name = 'channels_points'")
    assert named == [] and tables(path, "PRAGMA integrity_check") == [("ok",)]


# ---- numbers and words


@needs_ogr
@pytest.mark.parametrize("area", [1.5, 123456789.123, 7.05e12])
def test_numbers_of_a_shapefile_fit_their_fields(tmp_path, area):
    line = np.c_[np.linspace(0.0, 900.0, 10), np.zeros(10)]
    network = RiverNetwork.from_polylines(
        [line, line + 5000.0], width=10.0, drainage_area=[area, 0.1], slope=[-1e-3, np.nan], crs="EPSG:32619"
    )
    write_network(network, tmp_path / "a.shp")
    data = (tmp_path / "a.dbf").read_bytes()
    count, head, size = struct.unpack("<IHH", data[4:12])
    first = 1
    for place in range(32, head - 1, 32):
        width, decimals = data[place + 16 : place + 18]
        for row in range(count):
            text = data[head + row * size + first : head + row * size + first + width].decode().strip(" *\0")
            if decimals and text:
                whole, _, part = text.partition(".")
                # A number that fills its field as the field is declared can be written there again.
                assert len(part) == decimals and len(whole) <= width - decimals - 1
        first += width
    again = read_network(tmp_path / "a.shp")
    np.testing.assert_allclose(again.channel_drainage_area, [area, 0.1], rtol=1e-14)
    np.testing.assert_allclose(again.channel_slope, [-1e-3, np.nan], rtol=1e-11)


@needs_pyproj
def test_a_csv_shows_its_columns_and_keeps_its_facts(tmp_path):
    import pyproj

    odd = pyproj.CRS.from_proj4("+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9999 +x_0=500000 +ellps=GRS80 +units=m").to_wkt()
    line = np.c_[np.linspace(0.1, 900.0, 10), np.full(10, 1.0 / 3.0)]
    network = RiverNetwork.from_polylines(
        [line, line + 2000.0], width=10.0, crs=odd, origin=(-7.25, 12.5), extra={"name": ["Elbe", "x"], "n": [1, 2]}
    )
    for name in ("a.csv", "a.csv.gz"):
        write_network(network, tmp_path / name)
        again = read_network(tmp_path / name)
        same_lines(again.polylines(), network.polylines())
        assert again.crs == odd and again.origin.tolist() == [-7.25, 12.5]
        assert again.channels == network.channels
    rows = list(csv.DictReader((tmp_path / "a.csv").open()))
    assert [float(row["x"]) for row in rows[:10]] == network.polylines()[0][:, 0].tolist() and rows[0]["name"] == "Elbe"
    assert json.loads(rows[10]["warpriver"])["crs"] == odd and rows[11]["warpriver"] == ""
    # A damaged or emptied column costs its facts, not the lines.
    text = (tmp_path / "a.csv").read_text().replace('"{""crs', '"""crs')
    (tmp_path / "b.csv").write_text(text)
    assert read_network(tmp_path / "b.csv").channel_count == 2 and read_network(tmp_path / "b.csv").crs is None


@needs_ogr
def test_gdal_and_pandas_find_the_columns_of_a_csv(tmp_path):
    import pandas
    import pyogrio

    write_network(confluence(varying=True), tmp_path / "a.csv")
    names = "channel_id x y width_m depth_m discharge_m3s from_node to_node warpriver".split()
    assert pyogrio.read_info(tmp_path / "a.csv")["fields"].tolist() == names
    frame = pandas.read_csv(tmp_path / "a.csv")
    assert frame.columns.tolist() == names and frame.width_m.dtype == np.float64
    assert os.stat(tmp_path / "a.csv").st_size < 130 * len(frame)


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".geojson", *GIS, *SHP])
def test_locked_points_and_through_nodes_come_back(tmp_path, suffix):
    """And a simulation of what was read holds the lock."""
    line = np.stack([np.linspace(0.0, 6000.0, 121), 40.0 * np.sin(np.linspace(0.0, 30.0, 121))], axis=1)
    lines = [line[:41], line[40:81], line[80:], line[80] + np.linspace([-500.0, 900.0], [0.0, 0.0], 30)]
    network = RiverNetwork.from_polylines(lines[:3], width=40.0)
    network = network.with_channels(network.channels.replace(joint=np.array([JOINT_LOCK, JOINT_THROUGH, JOINT_NONE])))
    write_network(network, tmp_path / f"a{suffix}")
    again = read_network(tmp_path / f"a{suffix}", short="keep")
    assert again.channel_joint.tolist() == [JOINT_LOCK, JOINT_THROUGH, JOINT_NONE]
    sim = Simulation(again, plain_params(spacing=40.0))
    place = sim.network.polylines()[0][-1]
    sim.run(steps=10)
    np.testing.assert_array_equal(sim.network.polylines()[0][-1], place)
    # A node at which something joins is none of them, and names of others mean nothing.
    joined = RiverNetwork.from_polylines([lines[0], np.concatenate([lines[1], lines[2][1:]])], width=40.0)
    write_network(joined, tmp_path / f"b{suffix}")
    assert not read_network(tmp_path / f"b{suffix}", short="keep").channel_joint.any()
