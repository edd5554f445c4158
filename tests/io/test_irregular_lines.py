"""Tests of files in which one line among many is irregular: that line is numbered, joined, dropped or told."""

import math
import warnings

import numpy as np
import pytest
from river_files import LINE, Y, collection, feature, foreign, needs_ogr

from warpriver.io import read_network
from warpriver.io.vector.networks import read_network as read

GAP = [[[0, 900], [200, 700], [496, 500]], [[1000, 900], [800, 700], [504, 500]], [[500, 500], [520, 250], [500, 0]]]


def links(ids, down, **more):
    return [{"HYRIV_ID": a, "NEXT_DOWN": b, "width_m": 20.0, **more} for a, b in zip(ids, down, strict=True)]


def one_basin(network):
    return int((~np.isin(network.channel_to, network.channel_from)).sum()) == 1


# ---- identities


@pytest.mark.parametrize("damaged", [12.998, None, "R12", math.nan, -9999, 1e400, [1.5]])
@pytest.mark.parametrize("which", [0, 2])
def test_one_damaged_identity_takes_nothing_from_the_others(tmp_path, damaged, which):
    """Ends lie 4 m apart: where lines meet they are three basins, by what the file says one."""
    ids = [11, 12, 13]
    ids[which] = damaged
    path = foreign(tmp_path / "a.geojson", *links(ids, (13, 13, 0)), lines=GAP)
    with pytest.warns(
        UserWarning, match=f"1 of 3 lines have no whole number as its identity: the first is feature {which}"
    ):
        network = read_network(path)
    found = network.channel_id.tolist()
    assert [n for k, n in enumerate(found) if k != which] == [n for k, n in enumerate((11, 12, 13)) if k != which]
    assert found[which] not in (11, 12, 13) or found[which] == 14 - (which == 2)
    assert one_basin(network), "those that name the damaged one join it where it begins"


def test_identities_with_decimals_of_zero_are_whole(tmp_path):
    path = foreign(tmp_path / "a.geojson", *links(["11.0", 12.0, "13"], ("13.0", 13.0, "0")), lines=GAP)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        network = read_network(path)
    assert network.channel_id.tolist() == [11, 12, 13] and one_basin(network)


def test_a_feature_of_two_parts_is_two_lines_of_the_same_river(tmp_path):
    parts = [[[500, 500], [510, 400], [500, 300]], [[500, 300], [490, 100], [500, 0]]]
    for gap in (0.0, 8.0):
        second = [[x, y - gap] for x, y in parts[1]]
        path = collection(
            tmp_path / "a.geojson",
            *(feature("LineString", xy, **row) for xy, row in zip(GAP[:2], links((11, 12), (13, 13)), strict=True)),
            feature("MultiLineString", [parts[0], second], **links((13,), (14,))[0]),
            feature("LineString", [[500, -gap], [500, -300], [520, -600]], **links((14,), (0,))[0]),
            crs=None,
        )
        if not gap:  # parts that follow end to start are one channel
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                assert read_network(path).channel_id.tolist() == [11, 12, 13, 14]
            continue
        with pytest.warns(UserWarning, match="1 of 5 lines have the identity of another: the first is feature 2"):
            network = read_network(path)
        assert network.channel_id.tolist() == [11, 12, 13, 15, 14] and one_basin(network)
        assert network.channel_to[2] == network.channel_from[3] and network.channel_to[3] == network.channel_from[4]


def test_a_part_of_no_length_does_not_part_the_others(tmp_path):
    parts = [LINE[:2], [LINE[1], LINE[1]], LINE[1:]]
    path = collection(tmp_path / "a.geojson", feature("MultiLineString", parts, width=9.0), crs=None)
    network = read_network(path)
    assert network.channel_count == 1 and network.channel_lengths()[0] == 200.0


def test_identities_that_tell_nothing_apart_are_not_taken_for_them(tmp_path):
    table = [{"seg_id": 1 + k // 2, "width": 20.0} for k in range(4)]
    lines = [(np.array(Y[2]) + [3000.0 * k, 0.0]).tolist() for k in range(4)]
    with pytest.warns(UserWarning, match="2 of 4 lines have the identity of another"):
        read_network(foreign(tmp_path / "a.geojson", *table, lines=lines))
    table = [{"seg_id": k // 3, "width": 20.0} for k in range(4)]
    table[3]["seg_id"] = 5
    with pytest.warns(UserWarning, match="2 of 4 lines have the identity of another"):
        read_network(foreign(tmp_path / "a.geojson", *table, lines=lines))
    table = [{"seg_id": 7 * (k == 0), "width": 20.0} for k in range(5)]
    lines.append((np.array(Y[2]) + [12000.0, 0.0]).tolist())
    with pytest.warns(UserWarning, match="its identities tell no channels apart, as 3 of 5 lines have that of another"):
        assert read_network(foreign(tmp_path / "a.geojson", *table, lines=lines)).channel_id.tolist() == list(range(5))
    table = [{"seg_id": 7, "width": 20.0} for _ in range(5)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_network(foreign(tmp_path / "a.geojson", *table, lines=lines)).channel_id.tolist() == list(range(5))


def test_one_line_without_nodes_joins_where_it_meets(tmp_path):
    table = [
        {"COMID": k, "FromNode": a, "ToNode": b, "TotDASqKM": 9.0} for k, a, b in ((1, 1, 3), (2, 2, 3), (3, 3, 4))
    ]
    table[1]["ToNode"] = None
    with pytest.warns(UserWarning) as told:
        network = read_network(foreign(tmp_path / "a.geojson", *table))
    assert any("1 of 3 lines have no nodes (the first: feature 1)" in str(w.message) for w in told)
    assert network.channel_to[0] == network.channel_to[1] == network.channel_from[2]
    assert network.channel_id.tolist() == [1, 2, 3]


def test_a_channel_that_names_itself_is_an_outlet(tmp_path):
    network = read_network(foreign(tmp_path / "a.geojson", *links((11, 12, 13), (13, 13, 13)), lines=GAP))
    assert one_basin(network)


# ---- widths and areas


def nhd(*areas):
    return [
        {"COMID": 11 + k, "FromNode": a, "ToNode": b, "TotDASqKM": area}
        for k, ((a, b), area) in enumerate(zip(((1, 3), (2, 3), (3, 4)), areas, strict=True))
    ]


@pytest.mark.parametrize("none", [0.0, None, -9999.0, "NA"])
def test_one_line_that_drains_nothing_does_not_refuse_the_file(tmp_path, none):
    path = foreign(tmp_path / "a.geojson", *nhd(40.0, none, 41.0))
    with pytest.warns(UserWarning) as told:
        network = read_network(path)
    text = " | ".join(str(w.message) for w in told)
    assert "2 of 3 channels have no width; inferred 2 from the drainage area" in text
    assert "1 of 3 channels have no width, discharge or drainage area (the first: feature 1)" in text
    w = network.channel_width
    assert w[0] < w[2] and w[1] == w[0]
    np.testing.assert_array_equal(network.channel_drainage_area, [40e6, math.nan, 41e6])


def test_a_width_may_be_given_to_those_without_one(tmp_path):
    path = foreign(tmp_path / "a.geojson", *nhd(40.0, 0.0, 41.0))
    with pytest.warns(UserWarning, match="inferred 2 from the drainage area") as told:
        base = read_network(path, missing_width=5.0)
    assert len(told) == 1
    np.testing.assert_allclose(base.channel_width[1], 5.0)
    for width in (np.array([np.nan, 5.0, np.nan]), [None, 5.0, None], [None, np.full(3, 5.0), math.nan]):
        with pytest.warns(UserWarning, match="2 of 3 channels have no width; inferred"):
            network = read_network(path, width=width)
        np.testing.assert_array_equal(network.channel_width, base.channel_width)
    assert read_network(path, width=9.0).channel_width.tolist() == [9.0] * 3
    table = [{"width": w, "depth": 2.0, "discharge": 70.0} for w in (30.0, None, 50.0)]
    path = foreign(tmp_path / "b.geojson", *table)
    network = read_network(path, width=[None, 40.0, None], depth=[None, None, 3.0], discharge=[math.nan, 80.0, None])
    assert network.channel_width.tolist() == [30.0, 40.0, 50.0]
    assert network.channel_depth.tolist() == [2.0, 2.0, 3.0]
    assert network.channel_discharge.tolist() == [70.0, 80.0, 70.0]
    for wrong in (0.0, -3.0, math.nan):
        with pytest.raises(ValueError, match="missing_width is"):
            read_network(path, missing_width=wrong)


def test_a_file_without_widths_is_still_refused(tmp_path):
    path = foreign(tmp_path / "a.geojson", *[{}] * 3)
    with pytest.raises(ValueError, match=r"the file gives no width; pass width= \(bankfull width in m\)"):
        read_network(path)
    assert read_network(path, missing_width=4.0).channel_width.tolist() == [4.0] * 3


@pytest.mark.parametrize("none", [0, -1, -9999, "n/a", "NULL", "", " - ", None, math.nan, 1e30])
def test_what_is_no_width_is_unknown(tmp_path, none):
    table = [{"width": none, "discharge": 100.0}, {"width": 40.0}, {"width": 50.0}]
    with pytest.warns(UserWarning, match="1 of 3 channels have no width; inferred 1 from the bankfull discharge"):
        network = read_network(foreign(tmp_path / "a.geojson", *table))
    np.testing.assert_allclose(network.channel_width, [72.0, 40.0, 50.0])


# ---- no length


@needs_ogr
@pytest.mark.parametrize("suffix", [".geojson", ".gpkg"])
def test_features_of_no_length(tmp_path, suffix):
    point = [[7.0, 7.0], [7.0, 7.0], [7.0, 7.0]]
    table = [{"width": 20.0}, {"width": 20.0}, {}]
    path = tmp_path / f"a{suffix}"
    if suffix == ".geojson":
        foreign(path, *table, lines=[Y[0], Y[2], point])
    else:
        geopandas = pytest.importorskip("geopandas")
        from shapely.geometry import LineString

        shapes = [LineString(xy) for xy in (Y[0], Y[2], point)]
        geopandas.GeoDataFrame({"width": [20.0, 20.0, None]}, geometry=shapes).to_file(path)
    with pytest.raises(ValueError, match=r"feature 2: no length.*1 of 3 lines are like that.*pass short='drop'"):
        read_network(path)
    # It needs no width to be left out.
    assert read_network(path, short="drop").channel_count == 2
    for short in ("keep", "narrow"):
        with pytest.warns(UserWarning, match="feature 2: no length.*they are left out"):
            assert read_network(path, short=short).channel_count == 2
    assert read_network(path, short="drop", width=[20.0, 30.0, 40.0]).channel_width.tolist() == [20.0, 30.0]


def test_a_file_of_points_is_refused_whatever_is_said(tmp_path):
    path = foreign(tmp_path / "a.geojson", {"width": 20.0}, lines=[[[1, 1], [1, 1]]])
    for short in ("error", "drop", "keep", "narrow"):
        with pytest.raises(ValueError, match="no length, only one distinct point"):
            read(path, short=short)


def test_elevations_of_some_lines_are_told(tmp_path):
    path = collection(
        tmp_path / "a.geojson",
        feature("LineString", LINE, width=9.0),
        feature("LineString", [[0.0, 900.0, -9999.0], [100.0, 900.0, 4.0], [200.0, 900.0, 3.0]], width=9.0),
        crs=None,
    )
    with pytest.warns(UserWarning, match="1 of 2 channels have elevations at all points; none is kept"):
        assert read_network(path).point_z is None
