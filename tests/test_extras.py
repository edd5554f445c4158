"""Tests of free columns and elevations in files: out and in again, of other people's files, and what is refused."""

import json
import logging

import numpy as np
import pytest
from river_files import CORE, GIS, SHP, Y, collection, confluence, feature, foreign, sine, write

from warpriver import RiverNetwork, read_network
from warpriver.channel_table import ChannelTable
from warpriver.io import write_network

EXTRA = {
    "rock": np.array(["clay", "gravel", "Sandstein"]),
    "grain": np.array([1.0 / 3.0, np.nan, -0.5]),
    "rank": np.array([2**60 + 1, -3, 0]),
    "dam": np.array([True, False, True]),
    "code": np.array(["007", "12", "1e5"]),
}


def with_extra(**extra):
    network = confluence()
    return network.with_channels(network.channels.replace(extra=extra or EXTRA))


def assert_same_columns(found: ChannelTable, expected):
    assert sorted(found.extra) == sorted(expected)
    for name, values in expected.items():
        assert found[name].dtype.kind == values.dtype.kind, name
        np.testing.assert_array_equal(found[name], values, name)


@pytest.mark.parametrize("suffix", CORE + GIS)
def test_free_columns_come_back(tmp_path, suffix):
    network = with_extra()
    write_network(network, tmp_path / f"a{suffix}")
    back = read_network(tmp_path / f"a{suffix}")
    assert_same_columns(back.channels, EXTRA)
    assert read_network(tmp_path / f"a{suffix}", extra=()).channels.extra == {}
    some = read_network(tmp_path / f"a{suffix}", extra=["GRAIN", "code"]).channels
    assert list(some.extra) == ["GRAIN", "code"] and some["code"].tolist() == ["007", "12", "1e5"]
    np.testing.assert_array_equal(some["GRAIN"], EXTRA["grain"])


@pytest.mark.parametrize("suffix", [".csv", ".geojson", *GIS])
def test_words_of_other_scripts_and_none_come_back(tmp_path, suffix):
    extra = {"Größe": np.array(["", "Río Purús", "長江"]), "a b": np.array([0, 1, 2])}
    if suffix == ".csv":
        extra["a_b"] = extra.pop("a b")
    write_network(with_extra(**extra), tmp_path / f"a{suffix}")
    assert_same_columns(read_network(tmp_path / f"a{suffix}").channels, extra)


@pytest.mark.parametrize("suffix", SHP)
def test_a_shapefile_gives_back_the_columns_that_are_asked_for(tmp_path, suffix):
    write_network(with_extra(), tmp_path / f"a{suffix}")
    assert read_network(tmp_path / f"a{suffix}").channels.extra == {}
    back = read_network(tmp_path / f"a{suffix}", extra=["rock", "grain", "code"]).channels
    assert back["rock"].tolist() == EXTRA["rock"].tolist() and back["code"].tolist() == ["007", "12", "1e5"]
    np.testing.assert_allclose(back["grain"], EXTRA["grain"], rtol=1e-14)


@pytest.mark.parametrize("suffix", CORE + GIS + SHP)
def test_elevations_come_back(tmp_path, suffix):
    base = confluence()
    z = [100.0 + np.random.default_rng(k).random(len(xy)) for k, xy in enumerate(base.polylines())]
    network = RiverNetwork.from_polylines(base.polylines(), width=50.0, z=z, crs=base.crs)
    write_network(network, tmp_path / f"a{suffix}")
    back = read_network(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(back.point_z, network.point_z)
    assert [xy.shape[1] for xy in back.polylines()] == [2, 2, 2]
    write_network(base, tmp_path / f"a{suffix}")
    assert read_network(tmp_path / f"a{suffix}").point_z is None


@pytest.mark.parametrize("suffix", [".csv", ".geojson", *GIS, *SHP])
def test_elevations_of_rings_come_back(tmp_path, suffix):
    angle = 2.0 * np.pi * np.arange(30) / 30
    ring, z = 400.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), np.sin(angle)
    network = RiverNetwork.from_polylines([ring], width=20.0, z=[z], closed=True)
    write_network(network, tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(read_network(tmp_path / f"a{suffix}").point_z, z)


def test_elevations_turn_with_the_lines_and_go_where_some_lack_them(tmp_path, caplog):
    path = write(tmp_path / "a.csv", "# order=upstream\nx,y,z\n0,0,1\n500,0,2\n1000,9,3\n")
    network = read_network(path, width=20.0)
    np.testing.assert_array_equal(network.polylines()[0][0], [1000.0, 9.0])
    assert network.point_z.tolist() == [3.0, 2.0, 1.0]
    with caplog.at_level(logging.INFO, "warpriver"):
        lines = [[[*xy, 5.0] for xy in line] for line in Y]
        assert read_network(foreign(tmp_path / "a.geojson", {}, {}, {}, lines=lines), width=20.0).point_z[0] == 5.0
        del lines[1][1][2]
        with pytest.warns(UserWarning, match="2 of 3 channels have elevations at all points; none is kept"):
            network = read_network(foreign(tmp_path / "a.geojson", {}, {}, {}, lines=lines), width=20.0)
        assert network.point_z is None
        path = write(tmp_path / "b.csv", "x,y,z\n0,0,1\n500,0,nan\n1000,9,3\n")
        assert read_network(path, width=20.0).point_z is None
        words = write(tmp_path / "c.csv", "x,y,z\n0,0,low\n500,0,low\n1000,9,high\n")
        assert read_network(words, width=20.0).point_z is None


def test_a_line_of_two_points_and_repeated_points_keep_their_elevations(tmp_path):
    line = feature("LineString", [[0, 0, 4.0], [900, 0, 2.0]])
    bent = feature("LineString", [[0, 500, 4.0], [0, 500, 4.0], [400, 600, 3.0], [900, 500, 1.0]])
    network = read_network(collection(tmp_path / "a.geojson", line, bent, crs=None), width=20.0)
    assert network.point_z.tolist() == [4.0, 3.0, 2.0, 4.0, 3.0, 1.0]


def test_attributes_of_other_files_are_kept_when_asked_for(tmp_path):
    rows = [
        {"GNIS_Name": "Aare", "year": 1990, "visits": 1, "sure": True, "width": 20.0},
        {"GNIS_Name": None, "year": None, "visits": 2, "sure": False, "width": 20.0},
        {"GNIS_Name": "12", "year": 2001, "visits": 3, "sure": True, "width": 20.0},
    ]
    path = foreign(tmp_path / "a.geojson", *rows)
    assert read_network(path).channels.extra == {}
    found = read_network(path, extra=["gnis_name", "year", "visits", "sure"]).channels
    assert found["gnis_name"].tolist() == ["Aare", "", "12"] and found["sure"].tolist() == [True, False, True]
    np.testing.assert_array_equal(found["year"], [1990.0, np.nan, 2001.0])
    assert found["visits"].dtype == np.int64 and found["sure"].dtype == bool
    with pytest.raises(ValueError, match=r"no attribute 'speed' to read as an extra column; it has .*visits"):
        read_network(path, extra=["speed"])
    with pytest.raises(ValueError, match="'width', which every table has"):
        read_network(path, extra=["width"])


def test_columns_of_other_text_files_are_kept_when_asked_for(tmp_path):
    path = write(
        tmp_path / "a.csv",
        """\
        channel,x,y,soil,age,order,share
        1,0,0,clay,5,1,
        1,500,0,clay,5,2,
        1,1000,9,clay,5,3,
        2,0,5000,,7.5,4,0.5
        2,500,5000,,7.5,5,0.5
        2,1000,5009,,7.5,6,0.5
        """,
    )
    found = read_network(path, width=20.0, extra=["soil", "age", "share"]).channels
    assert found["soil"].tolist() == ["clay", ""] and found["age"].tolist() == [5.0, 7.5]
    np.testing.assert_array_equal(found["share"], [np.nan, 0.5])
    with pytest.raises(ValueError, match="channel 1: the extra column 'order' holds 1 and 2; only one value a channel"):
        read_network(path, width=20.0, extra=["order"])


def test_columns_of_several_files_stand_beside_each_other(tmp_path):
    one, two = with_extra(rock=np.array(["a", "b", "c"])), with_extra(rank=np.array([1, 2, 3]))
    write_network(one, tmp_path / "a.geojson")
    write_network(two, tmp_path / "b.csv")
    with pytest.raises(ValueError, match=r"a.geojson and 1 more: the extra column 'rank' is not all int"):
        read_network([tmp_path / "a.geojson", tmp_path / "b.csv"])
    write_network(one, tmp_path / "b.csv")
    both = read_network([tmp_path / "a.geojson", tmp_path / "b.csv"]).channels
    assert both["rock"].tolist() == ["a", "b", "c"] * 2


@pytest.mark.parametrize(
    ("suffix", "extra", "words"),
    [
        (".geojson", {"Width_M": [1, 2, 3]}, "'Width_M' has the name of an attribute"),
        (".geojson", {"COMID": [1, 2, 3]}, "'COMID' has the name of an attribute"),
        (".geojson", {"fid": [1, 2, 3]}, "'fid' has the name of an attribute"),
        (".geojson", {"rock": [1, 2, 3], "Rock": [1, 2, 3]}, "'Rock' differs from 'rock' in case only"),
        (".shp", {"a_long_name": [1, 2, 3]}, "name of more than 10 characters"),
        (".shp", {"rock": ["x" * 255, "", ""]}, "words of more than 254 bytes"),
        (".csv", {"rock": ["a", "b,c", "d"]}, "holds 'b,c', which a row of text cannot"),
        (".csv", {"rock": ["a", "b#c", "d"]}, "holds 'b#c', which a row of text cannot"),
        (".csv", {"ro;ck": [1, 2, 3]}, "holds 'ro;ck'"),
        (".txt", {"rock": ["a", "b c", "d"]}, "holds 'b c'"),
        (".txt", {"rock": ["a", "", "d"]}, "holds ''"),
    ],
)
def test_what_a_format_cannot_hold_is_refused(tmp_path, suffix, extra, words):
    if suffix == ".shp":
        pytest.importorskip("pyogrio")
    path = tmp_path / f"a{suffix}"
    with pytest.raises(ValueError, match=words) as caught:
        write_network(with_extra(**extra), path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value) and not path.exists()


def test_a_damaged_list_of_free_columns_is_none(tmp_path):
    path = tmp_path / "a.geojson"
    write_network(with_extra(), path)
    data = json.loads(path.read_text())
    for damaged in ("{", 5, {"rock": "stone"}, ["rock"]):
        data["warpriver"]["extra"] = damaged
        path.write_text(json.dumps(data))
        assert read_network(path).channels.extra == {}
    assert read_network(path, extra=["rock"]).channels["rock"].tolist() == EXTRA["rock"].tolist()


def test_rows_of_text_name_their_columns(tmp_path):
    line = sine(10)
    network = RiverNetwork.from_polylines([line], width=20.0, z=[np.arange(10.0)], extra={"rock": ["clay"], "n": [3]})
    write_network(network, tmp_path / "a.csv")
    rows = (tmp_path / "a.csv").read_text().splitlines()
    assert rows[0] == "channel_id,x,y,z,width_m,depth_m,discharge_m3s,from_node,to_node,rock,n,warpriver"
    assert '""extra"": {""rock"": ""text"", ""n"": ""int""}' in rows[1]
    assert rows[2].endswith(",clay,3,") and rows[1].split(",")[3] == "0.0"
