"""Tests of runs in tables and in files for a GIS."""

import importlib.util
import sqlite3

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver.cli import main
from warpriver.history import Collision, Cutoff
from warpriver.history.history import History
from warpriver.history.tables import event_columns, features_of, summary_columns
from warpriver.io.vector import histories
from warpriver.io.vector.histories import write_history

geopandas = pytest.importorskip("geopandas")
pyogrio = pytest.importorskip("pyogrio")
FILES = [".shp", ".fgb", ".geojson", ".parquet"]


@pytest.fixture(scope="module")
def history():
    """Three records of a river and a brook, with one cutoff and one collision put in by hand."""
    line = wr.generate.noisy_line(length=4000, spacing=50, amplitude=50, seed=0) + [500000.0, 4000000.0]
    brook = line[::2] + [0.0, 3000.0]
    network = wr.RiverNetwork.from_polylines([line, brook], width=[60.0, 30.0], crs="EPSG:32619")
    sim = wr.Simulation(network, plain_params(time_step=1.0, spacing=30.0))
    sim.run(years=10, record_every=5)
    made = sim.history
    assert len(made) == 3 and not len(made.events)
    loop = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 300.0], [0.0, 300.0]]) + line[0]
    made.events.append(Cutoff(4.0, 0, 20.0, loop))
    pieces = np.concatenate([loop, loop[::-1] + 1000.0])
    made.events.append(Collision(7.0, "upstream", 1, 0, 30.0, pieces, np.array([0, 4, 8])))
    return made


def test_courses_have_times(history):
    frame = history.to_geopandas()
    assert frame.crs.to_epsg() == 32619 and len(frame) == 6
    assert frame.time_yr.tolist() == [0.0, 0.0, 5.0, 5.0, 10.0, 10.0] and frame.channel_id.tolist() == [0, 1] * 3
    for row in frame.itertuples():
        network = history.networks[row.record]
        np.testing.assert_array_equal(np.array(row.geometry.coords), network.polylines()[row.channel_id])
        assert row.length_m == pytest.approx(row.geometry.length)
        assert row.sinuosity == pytest.approx(wr.metrics.sinuosity(network.polylines()[row.channel_id]))
    # Each is there until the next; the last ones to the end of the run. Year 0 is 2000.
    begin, end = frame.begin.to_numpy(), frame.end.to_numpy()
    np.testing.assert_array_equal(begin[2:], end[:-2])
    assert (begin[0] == np.datetime64("2000-01-01")) and (end[-2:] == begin[-2:]).all()
    assert ((begin[2] - begin[0]) / np.timedelta64(1, "D")) == 5 * 365.25
    assert history.to_geopandas(every=5).record.tolist() == [0, 0, 2, 2]


def test_oxbows_are_areas_and_abandoned_courses_lines(history):
    (lake,) = history.to_geopandas("oxbows").itertuples()
    assert (lake.time_yr, lake.channel_id, lake.width_m, lake.length_m) == (4.0, 0, 20.0, 500.0)
    # A band of 20 m along 500 m, with round ends; corners fill a little more outside than they lack inside.
    assert lake.geometry.is_valid and lake.geometry.area == pytest.approx(500.0 * 20.0 + np.pi * 100.0, rel=0.02)
    (course,) = history.to_geopandas("abandoned").itertuples()
    assert (course.case, course.channel_id, course.other_id, course.length_m) == ("upstream", 1, 0, 1000.0)
    assert course.geometry.geom_type == "MultiLineString" and len(course.geometry.geoms) == 2


def test_events_and_records_as_tables(history):
    table = history.event_table()
    assert table.kind.tolist() == ["cutoff", "collision"] and table.time_yr.tolist() == [4.0, 7.0]
    assert table.length_m[0] == 500.0 and np.isnan(table.other_id[0]) and table.case.tolist() == ["", "upstream"]
    assert table.x[0] == pytest.approx(history.networks[0].polylines()[0][0, 0] + 50.0)
    summary = history.summary()
    assert summary.cutoffs.tolist() == [0, 1, 1] and summary.collisions.tolist() == [0, 0, 1]
    assert summary.step.tolist() == [0, 5, 10] and summary.channels.tolist() == [2, 2, 2]
    for row, network in zip(summary.itertuples(), history.networks, strict=True):
        lengths = network.channel_lengths()
        chords = [np.hypot(*(xy[-1] - xy[0])) for xy in network.polylines()]
        assert row.length_m == pytest.approx(lengths.sum())
        assert row.sinuosity == pytest.approx(lengths.sum() / sum(chords))
        assert row.width_m == pytest.approx((lengths @ [60.0, 30.0]) / lengths.sum())


def test_tables_of_a_run_without_events(history):
    empty = History(plain_params())
    assert len(event_columns(empty)["kind"]) == 0 and len(summary_columns(empty)["time_yr"]) == 0
    with pytest.raises(ValueError, match=r"no record; run the simulation first"):
        empty.to_geopandas()
    with pytest.raises(ValueError, match=r"layer is 'lakes'; use one of 'courses', 'oxbows', 'abandoned'"):
        history.to_geopandas("lakes")
    with pytest.raises(ValueError, match=r"every is 0; give a whole number of records, 1 or more"):
        features_of(history, "courses", 0)


def test_a_geopackage_holds_the_run(history, tmp_path):
    path = tmp_path / "a.gpkg"
    assert write_history(history, path) == [path]
    layers = dict(map(tuple, pyogrio.list_layers(path)))
    assert layers == {
        "channels": "LineString",
        "channels_nodes": "Point",
        "courses": "LineString",
        "oxbows": "Polygon",
        "abandoned": "MultiLineString",
        "layer_styles": None,
    }
    assert [pyogrio.read_info(path, layer=n)["features"] for n in ("courses", "oxbows", "abandoned")] == [6, 1, 1]
    frame = pyogrio.read_dataframe(path, layer="courses")
    assert frame.begin.dtype.kind == "M" and frame.crs.to_epsg() == 32619
    # The network is what a run goes on from, without a word about which layer.
    again = wr.read_network(path)
    for a, b in zip(again.polylines(), history.networks[-1].polylines(), strict=True):
        np.testing.assert_array_equal(a, b)
    with sqlite3.connect(path) as database:
        styled = {name for (name,) in database.execute("SELECT f_table_name FROM layer_styles")}
    assert styled == set(layers) - {"layer_styles"}


@pytest.mark.parametrize("suffix", FILES)
def test_other_formats_hold_a_layer_a_file(history, tmp_path, suffix):
    names = [f"a{suffix}", f"a_courses{suffix}", f"a_oxbows{suffix}", f"a_abandoned{suffix}"]
    assert [p.name for p in write_history(history, tmp_path / f"a{suffix}")] == names
    read = geopandas.read_parquet if suffix == ".parquet" else pyogrio.read_dataframe
    for name, count in zip(names, (2, 6, 1, 1), strict=True):
        frame = read(tmp_path / name)
        assert len(frame) == count and frame.crs.to_epsg() == 32619
    courses = read(tmp_path / names[1])
    assert courses.time_yr.tolist() == [0.0, 0.0, 5.0, 5.0, 10.0, 10.0]
    assert str(courses.begin[0]).startswith("2000-01-01")
    # What a shorter run does not have does not stay of an older one.
    line = wr.generate.noisy_line(length=4000, spacing=50, amplitude=50, seed=0)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=60.0, crs="EPSG:32619"), plain_params())
    sim.run(steps=2, record_every=1)
    assert [p.name for p in write_history(sim.history, tmp_path / f"a{suffix}")] == names[:2]
    assert not [p for p in tmp_path.iterdir() if "oxbows" in p.name or "abandoned" in p.name]


def test_a_long_run_has_fewer_courses(history, tmp_path, monkeypatch):
    most = 2 * max(network.point_count for network in history.networks)
    monkeypatch.setattr(histories, "MAX_POINTS", most)
    assert histories.records_between(history) == 2
    write_history(history, tmp_path / "a.gpkg")
    assert pyogrio.read_dataframe(tmp_path / "a.gpkg", layer="courses").record.tolist() == [0, 0, 2, 2]
    write_history(history, tmp_path / "a.gpkg", every=1)
    assert pyogrio.read_info(tmp_path / "a.gpkg", layer="courses")["features"] == 6
    with pytest.raises(ValueError, match=r"a\.csv: \.csv cannot hold a run; write \.gpkg"):
        write_history(history, tmp_path / "a.csv")


# ---- the command line


@pytest.fixture
def no_pictures(monkeypatch):
    for name in ("runs", "erode"):
        monkeypatch.setattr(f"warpriver.cli.{name}.can_draw", lambda: False)


@pytest.mark.parametrize("suffix", [".gpkg", ".geojson", ".shp", ".csv"])
def test_results_come_in_the_format_of_the_input(history, tmp_path, suffix, capsys, no_pictures):
    source, out = tmp_path / f"a{suffix}", tmp_path / "out"
    wr.write_network(history.networks[0], source)
    assert main(["simulate", str(source), "--years", "3", "--no-progress", "-o", str(out)]) == 0
    wanted = out / f"rivers{'.gpkg' if suffix == '.csv' else suffix}"
    assert wanted.is_file() and f"GIS      {wanted}" in capsys.readouterr().out
    frame = pyogrio.read_dataframe(wanted, layer="channels" if wanted.suffix == ".gpkg" else None)
    assert frame.crs.to_epsg() == 32619 and frame.total_bounds[1] > 3.9e6
    # A run that goes on keeps the format.
    assert main(["simulate", str(out / "run"), "--years", "2", "--no-progress"]) == 0
    assert len({p.suffix for p in out.glob("rivers.*")} & {".gpkg", ".geojson", ".shp"}) == 1


def test_erosion_leaves_rasters_and_lines(tmp_path, no_pictures):
    rasterio = pytest.importorskip("rasterio")
    terrain = wr.Terrain(wr.generate.erosion_plane((40, 60)).to_numpy(), 30.0, (500000.0, 4e6), "EPSG:32619")
    wr.write_terrain(terrain, tmp_path / "dem.asc")
    for start, name in (("plane", "terrain.tif"), (str(tmp_path / "dem.asc"), "terrain.asc")):
        out = tmp_path / name
        words = ["--size", "60x40"] if start == "plane" else ["--edges", "open"]
        assert main(["erode", "--start", start, *words, "--events", "50", "--no-progress", "-o", str(out)]) == 0
        with rasterio.open(out / name) as file:
            heights = file.read(1)
        np.testing.assert_array_equal(heights, wr.read_terrain(out / "terrain.npz").to_numpy())
        assert pyogrio.read_info(out / "rivers.gpkg", layer="channels")["features"] > 0


def test_without_the_extra_the_lines_are_written(history, tmp_path, monkeypatch):
    from warpriver.cli import results

    found = importlib.util.find_spec
    monkeypatch.setattr(results.importlib.util, "find_spec", lambda n: None if n == "pyogrio" else found(n))
    said = results.write_run(history, tmp_path)
    assert wr.read_network(tmp_path / "rivers.geojson").channel_count == 2
    assert len(said) == 1 and 'pip install "warpriver[gis]"' in said[0]
