"""Tests of networks of ours that were edited or saved anew in a GIS, and of lines that run upstream."""

import json
import logging
import warnings

import numpy as np
import pytest
from plain import plain_params
from river_files import Y, collection, feature, foreign, needs_ogr, sine

from warpriver import RiverNetwork, Simulation, Terrain
from warpriver.io import read_network, write_network

WIDTHS = 40.0 + 10.0 * np.linspace(0.0, 1.0, 41)


def tree(z=False):
    """Two tributaries and a trunk, with widths that grow along them."""
    t = np.linspace(0.0, 1.0, 41)
    wave = 60.0 * np.sin(6.0 * np.pi * t)
    a = np.stack([5e5 + 2000.0 * t, 4e6 + 1000.0 * (1.0 - t) + wave], axis=1)
    b = np.stack([5e5 + 2000.0 * t, 4e6 - 1000.0 * (1.0 - t) + wave], axis=1)
    trunk = np.stack([5e5 + 2000.0 + 3000.0 * t, 4e6 + wave], axis=1)
    a[-1] = b[-1] = trunk[0]
    return RiverNetwork.from_polylines(
        [a, b, trunk],
        width=[WIDTHS, WIDTHS + 5.0, WIDTHS + 20.0],
        discharge=[300.0, 310.0, 620.0],
        drainage_area=[3e8, 3.1e8, 6.2e8],
        z=[100.0 - 10.0 * t, 100.0 - 10.0 * t, 90.0 - 10.0 * t] if z else None,
        channel_id=[11, 12, 13],
        crs="EPSG:32614",
    )


def joined(network):
    """Whether the three are the tree that they were."""
    a, b, trunk = (np.flatnonzero(network.channel_id == k)[0] for k in (11, 12, 13))
    return bool(network.channel_to[a] == network.channel_to[b] == network.channel_from[trunk])


def edited(tmp_path, change, **more):
    """The tree after an edit of the features of its file."""
    write_network(tree(**more), tmp_path / "a.geojson")
    document = json.loads((tmp_path / "a.geojson").read_text())
    change(document["features"])
    document.pop("warpriver")  # as any GIS does
    (tmp_path / "b.geojson").write_text(json.dumps(document))
    return tmp_path / "b.geojson"


def course(feature):
    return feature["geometry"]["coordinates"]


# ---- vertices


@pytest.mark.parametrize("what", ["added", "deleted", "simplified", "densified"])
def test_a_list_is_interpolated_along_a_line_of_other_points(tmp_path, what):
    def change(features):
        points = course(features[0])
        middles = (0.5 * (np.array(points)[1:] + np.array(points)[:-1])).tolist()
        if what == "added":
            points.insert(5, middles[4])
        elif what == "deleted":
            del points[7]
        elif what == "simplified":
            del points[1:-1:2]
        else:
            points[:] = [p for pair in zip(points, [*middles, None], strict=True) for p in pair if p is not None]

    path = edited(tmp_path, change)
    with pytest.warns(UserWarning, match="point_width_m of 1 line .* is interpolated along the line"):
        network = read_network(path)
    old, new = tree(), network.point_widths()[0]
    assert joined(network) and len(new) == len(network.polylines()[0])
    # The width at each point is that of the old line at the same place.
    gap = np.hypot(*(network.polylines()[0][:, None] - old.polylines()[0]).transpose(2, 0, 1))
    np.testing.assert_allclose(new, old.point_widths()[0][gap.argmin(axis=1)], atol=0.6)
    np.testing.assert_array_equal(network.point_widths()[1], old.point_widths()[1])
    np.testing.assert_array_equal(network.channel_width, old.channel_width)


def test_a_line_that_was_cut_is_two_that_follow_one_another(tmp_path):
    """Both halves have the attributes of the whole, its identity, its nodes and its list."""

    def change(features):
        half = json.loads(json.dumps(features[2]))
        course(half)[:] = course(half)[20:]
        course(features[2])[:] = course(features[2])[:21]
        features.append(half)

    path = edited(tmp_path, change)
    with pytest.warns(UserWarning) as told:
        network = read_network(path)
    text = " | ".join(str(w.message) for w in told)
    assert "1 of 4 lines have the identity of another" in text and "belongs to a line of another length" in text
    assert "left free" not in text
    assert joined(network) and network.channel_id.tolist() == [11, 12, 13, 14]
    assert network.channel_to[2] == network.channel_from[3]
    np.testing.assert_allclose(network.channel_width[2:], tree().channel_width[2], rtol=1e-12)
    Simulation(network, plain_params(spacing=30.0)).step()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("kind", ["nodes", "next_down"])
def test_halves_may_stand_in_any_order(tmp_path, kind, order):
    halves = [Y[2][:2], Y[2][1:]]
    lines = [Y[0], Y[1], *(halves[k] for k in order)]
    table = [{"channel_id": k, "width_m": 20.0} for k in (5, 6, 7, 7)]
    for row, nodes, down in zip(table, ((0, 2), (1, 2), (2, 3), (2, 3)), (7, 7, 0, 0), strict=True):
        row.update({"from_node": nodes[0], "to_node": nodes[1]} if kind == "nodes" else {"next_down": down})
    with pytest.warns(UserWarning, match="1 of 4 lines have the identity of another"):
        network = read_network(foreign(tmp_path / "a.geojson", *table, lines=lines))
    upper, lower = (2, 3) if order == (0, 1) else (3, 2)
    assert network.channel_to[0] == network.channel_to[1] == network.channel_from[upper]
    assert network.channel_to[upper] == network.channel_from[lower] and network.node_count == 5


def test_a_junction_that_was_moved_with_its_lines_stays_one(tmp_path):
    def change(features):
        for k, end in ((0, -1), (1, -1), (2, 0)):
            course(features[k])[end] = [502100.0, 4000150.0]

    write_network(tree(), tmp_path / "a.geojson")
    document = json.loads((tmp_path / "a.geojson").read_text())
    change(document["features"])  # the file still says where the nodes were
    (tmp_path / "b.geojson").write_text(json.dumps(document))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        network = read_network(tmp_path / "b.geojson")
    assert joined(network)
    np.testing.assert_array_equal(network.node_xy[network.channel_to[0]], [502100.0, 4000150.0])


def test_a_line_that_was_drawn_has_no_attributes(tmp_path):
    drawn = [[5e5 + 3000.0, 4e6 + 2000.0], [5e5 + 2500.0, 4e6 + 1000.0], [5e5 + 2000.0, 4e6]]

    def change(features):
        drawn[-1] = course(features[2])[0]
        none = dict.fromkeys(features[0]["properties"])
        features.append(feature("LineString", drawn, **none))

    with pytest.warns(UserWarning) as told:
        network = read_network(edited(tmp_path, change))
    text = " | ".join(str(w.message) for w in told)
    assert "1 of 4 channels have no width, discharge or drainage area (the first: feature 3)" in text
    assert joined(network) and network.channel_to[3] == network.channel_from[2]
    assert network.channel_width[3] == 40.0, "as the narrowest of the others"
    assert np.isnan(network.channel_drainage_area[3]) and network.channel_drainage_area[2] == 6.2e8
    assert read_network(tmp_path / "b.geojson", missing_width=7.0).channel_width[3] == 7.0


def test_a_line_that_was_deleted_leaves_the_others(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        network = read_network(edited(tmp_path, lambda features: features.pop(0)))
    assert network.channel_id.tolist() == [12, 13] and network.channel_to[0] == network.channel_from[1]


# ---- reversed


@pytest.mark.parametrize("turned", [(0,), (2,), (0, 1, 2), (1, 2)])
@pytest.mark.parametrize("keep", ["nodes", "next_down"])
def test_lines_that_a_gis_reversed_are_turned_back(tmp_path, turned, keep, caplog):
    def change(features):
        for k in turned:
            course(features[k]).reverse()
        for row in features if keep == "next_down" else ():
            del row["properties"]["from_node"], row["properties"]["to_node"]

    with caplog.at_level(logging.INFO, logger="warpriver"), warnings.catch_warnings():
        warnings.simplefilter("error")
        network = read_network(edited(tmp_path, change, z=True))
    assert joined(network) and f"{len(turned)} lines that ran upstream were turned" in caplog.text
    for c, old in enumerate(tree().polylines()):
        np.testing.assert_array_equal(network.polylines()[c], old)
        # A reversal leaves the list as it was, along the line as it flows; heights belong to the points.
        np.testing.assert_array_equal(network.point_widths()[c], tree().point_widths()[c])
        np.testing.assert_array_equal(network.point_elevations()[c], tree(z=True).point_elevations()[c])


def test_a_single_line_that_was_reversed_is_turned_by_its_nodes(tmp_path):
    river = RiverNetwork.from_polylines([tree().polylines()[0]], width=30.0)
    write_network(river, tmp_path / "a.geojson")
    document = json.loads((tmp_path / "a.geojson").read_text())
    course(document["features"][0]).reverse()
    (tmp_path / "b.geojson").write_text(json.dumps(document))
    np.testing.assert_array_equal(read_network(tmp_path / "b.geojson").points(), river.points())


def up(*lines):
    return [xy[::-1] for xy in lines]


def test_a_tree_drawn_from_the_mouth_is_told_and_reversed(tmp_path):
    path = foreign(tmp_path / "a.geojson", *[{"width": 20.0}] * 3, lines=up(*Y))
    with pytest.warns(UserWarning, match=r"a\.geojson: lines part at 1 node and meet at 0.*pass reverse=True"):
        network = read_network(path)
    with pytest.raises(ValueError, match=r"where water would part.*read them with reverse=True"):
        Simulation(network, plain_params(spacing=20.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        right = read_network(path, reverse=True)
    assert right.channel_to[0] == right.channel_to[1] == right.channel_from[2]
    Simulation(right, plain_params(spacing=20.0)).step()


def test_one_line_of_three_that_runs_upstream_is_told(tmp_path):
    with pytest.warns(UserWarning, match=r"3 lines end at \(500, 500\) and none begins there; if one of them runs up"):
        read_network(foreign(tmp_path / "a.geojson", *[{"width": 20.0}] * 3, lines=[Y[0], Y[1], Y[2][::-1]]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_network(foreign(tmp_path / "a.geojson", *[{"width": 20.0}] * 3))


def test_elevations_that_rise_are_told(tmp_path):
    line = [[0.0, 0.0, 5.0], [300.0, 0.0, 7.0], [600.0, 9.0, 8.0]]
    with pytest.warns(UserWarning, match=r"elevations of 100 % of the length rise.*pass reverse=True"):
        read_network(collection(tmp_path / "a.geojson", feature("LineString", line, width=9.0), crs=None))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_network(tmp_path / "a.geojson", reverse=True).point_z.tolist() == [8.0, 7.0, 5.0]


def test_reversing_text_turns_what_goes_with_the_points(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,width,depth\n0,0,30,3\n100,0,20,2\n200,5,10,1\n")
    network = read_network(tmp_path / "a.csv", reverse=True)
    np.testing.assert_array_equal(network.point_widths()[0], [10.0, 20.0, 30.0])
    np.testing.assert_array_equal(network.polylines()[0][0], [200.0, 5.0])


def test_widths_that_are_given_for_the_points_of_the_file_are_turned_with_them(tmp_path):
    path = foreign(tmp_path / "a.geojson", {"width": 9.0, "point_width_m": [1.0, 2.0, 3.0]}, lines=[Y[2][::-1]])
    network = read_network(path, width=[np.array([30.0, 20.0, 10.0])], reverse=True)
    np.testing.assert_array_equal(network.point_widths()[0], [10.0, 20.0, 30.0])
    np.testing.assert_array_equal(network.polylines()[0], Y[2])


@pytest.mark.parametrize("family", ["TauDEM", "MERIT-Basins"])
def test_links_of_other_programs_turn_the_lines(tmp_path, family):
    if family == "TauDEM":
        names, ids, down = ("LINKNO", "DSLINKNO", "DSContArea"), (1, 2, 0), (0, 0, -1)
        area = (1e7, 2e7, 3e7)
    else:
        names, ids, down = ("COMID", "NextDownID", "uparea"), (71, 72, 73), (73, 73, 0)
        area = (10.0, 20.0, 30.0)
    table = [dict(zip(names, row, strict=True)) | {"width_m": 20.0} for row in zip(ids, down, area, strict=True)]
    network = read_network(foreign(tmp_path / "a.geojson", *table, lines=up(*Y)))
    assert network.channel_to[0] == network.channel_to[1] == network.channel_from[2]
    assert network.channel_id.tolist() == list(ids)
    np.testing.assert_allclose(network.channel_drainage_area, [1e7, 2e7, 3e7])


# ---- saved anew


@needs_ogr
def test_names_that_a_shapefile_cuts_are_known(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    write_network(tree(), tmp_path / "a.fgb")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        geopandas.read_file(tmp_path / "a.fgb").to_file(tmp_path / "b.shp")
    with pytest.warns(UserWarning) as told:
        network = read_network(tmp_path / "b.shp")
    # The lists are longer than a text of a shapefile: that is told, and the mean width counts.
    assert {str(w.message).split("the list ")[1][:10] for w in told} == {"point_widt", "point_dept"}
    assert all("cannot be read" in str(w.message) for w in told)
    np.testing.assert_allclose(network.channel_discharge, tree().channel_discharge, rtol=1e-12)
    np.testing.assert_allclose(network.channel_drainage_area, tree().channel_drainage_area, rtol=1e-12)
    np.testing.assert_allclose(network.channel_width, tree().channel_width, rtol=1e-12)
    assert joined(network)


def test_attributes_that_are_lost_are_told(tmp_path):
    """As by programs that shorten names their own way."""

    def change(features):
        for row in features:
            row["properties"]["dschr_3"] = row["properties"].pop("discharge_m3s")

    with pytest.warns(UserWarning, match="comes from write_network, but has lost its discharge"):
        read_network(edited(tmp_path, change))

    def keep_one(features):
        for row in features:
            row["properties"]["drainage_a"] = row["properties"].pop("drainage_area_km2")
            del row["properties"]["drainage_area_m2"]

    with pytest.warns(UserWarning, match="drainage_a is taken as drainage_area_km2"):
        network = read_network(edited(tmp_path, keep_one))
    np.testing.assert_allclose(network.channel_drainage_area, tree().channel_drainage_area)


@pytest.mark.parametrize(
    "text", ["(3:40,45,50)", "40,45,50", "{40,45,50}", "[40, 45, 50]", "[40, null, 50]", "40 45 50"]
)
def test_lists_as_gdal_writes_them_in_text(tmp_path, text):
    path = foreign(tmp_path / "a.geojson", *[{"width_m": 45.0, "point_width_m": text}], lines=Y[:1])
    np.testing.assert_array_equal(read_network(path).point_widths()[0], [40.0, 45.0, 50.0])
    cut = text[:-1] if text[-1] in "])}" else text + ",5" * 130
    path = foreign(tmp_path / "b.geojson", *[{"width_m": 45.0, "point_width_m": cut}], lines=Y[:1])
    if text[-1] != "}":
        with pytest.warns(UserWarning, match="point_width_m of 1 line cannot be read"):
            assert (read_network(path).point_widths()[0] == 45.0).all()


def test_short_channels_of_ours_stay_after_a_detour(tmp_path):
    """Collisions leave channels shorter than wide, and a GIS drops what says that the file is ours."""
    far = [xy + [0.0, 9e4] for xy in tree().polylines()[:1]]
    short = RiverNetwork.from_polylines([sine(5) / 50.0, *far], width=90.0, allow_short=True)
    write_network(short, tmp_path / "a.geojson")
    document = json.loads((tmp_path / "a.geojson").read_text())
    document.pop("warpriver")
    (tmp_path / "b.geojson").write_text(json.dumps(document))
    assert read_network(tmp_path / "b.geojson").channel_count == 2


def test_an_origin_that_the_lines_have_left_does_not_count(tmp_path):
    write_network(tree(), tmp_path / "a.geojson")
    document = json.loads((tmp_path / "a.geojson").read_text())
    for row in document["features"]:
        course(row)[:] = (np.array(course(row)) + [4e5, -2e6]).tolist()
    (tmp_path / "b.geojson").write_text(json.dumps(document))
    network = read_network(tmp_path / "b.geojson", topology="ends")
    assert np.abs(network.point_xy.numpy()).max() < 1e4


# ---- terrain under lines


def test_a_terrain_under_a_part_of_the_lines_is_told():
    line = np.stack([np.arange(0.0, 6000.0, 60.0), 150.0 * np.sin(np.arange(100) / 4.0)], axis=1)
    network = RiverNetwork.from_polylines([line], width=50.0)
    ground = np.tile(100.0 - 0.05 * np.arange(60), (40, 1))
    with pytest.warns(UserWarning, match=r"66 of 100 points lie off the terrain or where it has no data, and will not"):
        Simulation(network, plain_params(), terrain=Terrain(ground, 50.0, (-1000.0, 1000.0)))
    holed = np.tile(100.0 - 0.02 * np.arange(160), (40, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Simulation(network, plain_params(), terrain=Terrain(holed, 50.0, (-1000.0, 1000.0)))
    holed[:, :60] = np.nan
    with pytest.warns(UserWarning, match=r"3[34] of 100 points lie off the terrain"):
        Simulation(network, plain_params(), terrain=Terrain(holed, 50.0, (-1000.0, 1000.0)))
    holed[:, :150] = np.nan
    with pytest.raises(ValueError, match=r"does not lie under the network .*or has no data there"):
        Simulation(network, plain_params(), terrain=Terrain(holed, 50.0, (-1000.0, 1000.0)))


def test_rivers_that_climb_are_told():
    line = np.stack([np.arange(0.0, 6000.0, 60.0), 150.0 * np.sin(np.arange(100) / 4.0)], axis=1)
    ground = Terrain(np.tile(100.0 + 0.1 * np.arange(160), (40, 1)), 50.0, (-1000.0, 1000.0))
    with pytest.warns(UserWarning, match=r"100 % of the channels' length climbs on the terrain.*reverse=True"):
        Simulation(RiverNetwork.from_polylines([line], width=50.0), plain_params(), terrain=ground)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Simulation(RiverNetwork.from_polylines([line[::-1]], width=50.0), plain_params(), terrain=ground)


def test_lines_and_terrain_of_two_zones_are_told_what_to_read_them_with():
    pytest.importorskip("pyproj")
    line = np.stack([np.arange(0.0, 6000.0, 60.0), np.zeros(100)], axis=1)
    network = RiverNetwork.from_polylines([line], width=50.0, crs="EPSG:32632")
    ground = Terrain(np.ones((40, 160)), 50.0, (-1000.0, 1000.0), "EPSG:32633")
    with pytest.raises(
        ValueError, match=r'terrain is in EPSG:32633, the network in EPSG:32632; read both with to_crs="EP'
    ):
        Simulation(network, plain_params(), terrain=ground)
