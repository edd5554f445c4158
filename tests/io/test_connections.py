"""Tests of how channels in files are joined, and of graphs that are none: by file and by the constructor."""

import logging
import warnings

import numpy as np
import pytest
from plain import plain_params
from river_files import Y, collection, feature, foreign, needs_ogr, sine

from warpriver import RiverNetwork, Simulation
from warpriver.hydrology import strahler_order
from warpriver.io import read_network, write_network

TRIANGLE = [[[0, 0], [400, 0], [900, 0]], [[900, 0], [700, 400], [500, 800]], [[500, 800], [250, 400], [0, 0]]]


def rows(*links, **more):
    return [{"channel_id": n, "next_down": d, "width_m": 20.0, **more} for n, d in links]


def noded(*links):
    return [{"channel_id": k, "from_node": a, "to_node": b, "width_m": 20.0} for k, (a, b) in enumerate(links)]


# ---- joined as the file says


def test_nodes_rule_over_the_channels_downstream_and_over_the_ends(tmp_path):
    # By its ends the trunk is fed by two; by its nodes by the second alone.
    table = noded((4, 9), (5, 7), (7, 8))
    for row in table:
        row["next_down"] = 2
    network = read_network(foreign(tmp_path / "a.geojson", *table))
    assert network.channel_from.tolist() == [0, 1, 2] and network.channel_to.tolist() == [4, 2, 3]
    np.testing.assert_array_equal(network.node_xy[[4, 2]], [[500, 500], [500, 500]])
    by_ends = read_network(tmp_path / "a.geojson", topology="ends")
    assert by_ends.channel_to[0] == by_ends.channel_to[1] == by_ends.channel_from[2]
    assert by_ends.channel_id.tolist() == [0, 1, 2]


def test_channels_downstream_rule_over_the_ends(tmp_path):
    network = read_network(foreign(tmp_path / "a.geojson", *rows((5, -1), (6, 7), (7, -1))))
    assert network.channel_id.tolist() == [5, 6, 7]
    assert network.channel_to[1] == network.channel_from[2] != network.channel_to[0]
    assert strahler_order(network.channel_from, network.channel_to).tolist() == [1, 1, 1]


def test_a_clipped_basin_ends_in_outlets(tmp_path):
    """A channel downstream that the file does not hold makes an outlet."""
    network = read_network(foreign(tmp_path / "a.geojson", *rows((5, 7), (6, 99), (7, 1000))))
    outlets = ~np.isin(network.channel_to, network.channel_from)
    assert outlets.tolist() == [False, True, True]
    Simulation(network, plain_params(spacing=20.0))


def test_an_orphan_channel_is_a_basin_of_its_own(tmp_path):
    lines = [*Y, (np.array(Y[2]) + [5000, 0]).tolist()]
    for table in (rows((5, 7), (6, 7), (7, 0), (8, 0)), noded((0, 2), (1, 2), (2, 3), (4, 5)), [{"width": 20.0}] * 4):
        network = read_network(foreign(tmp_path / "a.geojson", *table, lines=lines))
        assert network.node_count == 6 and network.channel_count == 4
        assert (~np.isin(network.channel_to, network.channel_from)).sum() == 2
        Simulation(network, plain_params(spacing=20.0)).step()
    network = RiverNetwork.from_polylines(lines, width=20.0)
    assert strahler_order(network.channel_from, network.channel_to).tolist() == [1, 1, 2, 1]


@pytest.mark.parametrize("kind", ["next_down", "nodes"])
def test_ends_near_their_node_are_brought_there(tmp_path, caplog, kind):
    table = rows((0, 2), (1, 2), (2, -1)) if kind == "next_down" else noded((0, 2), (1, 2), (2, 3))
    lines = [Y[0], [*Y[1][:-1], [508.0, 505.0]], [[500.0, 490.0], *Y[2][1:]]]
    with caplog.at_level(logging.INFO, logger="warpriver"):
        network = read_network(foreign(tmp_path / "a.geojson", *table, lines=lines))
    assert "2 ends were brought to their nodes" in caplog.text
    for c in (0, 1):
        np.testing.assert_array_equal(network.polylines()[c][-1], [500.0, 490.0])
    np.testing.assert_array_equal(network.polylines()[2][0], network.node_xy[network.channel_from[2]])
    assert read_network(tmp_path / "a.geojson", topology="ends").node_count == 6


@pytest.mark.parametrize("kind", ["next_down", "nodes"])
def test_an_end_far_from_its_node_is_left_free(tmp_path, kind):
    """A dangling end: what the attributes join lies further apart than the channel is wide."""
    table = rows((0, 2), (1, 2), (2, -1)) if kind == "next_down" else noded((0, 2), (1, 2), (2, 3))
    lines = [Y[0], [*Y[1][:-1], [600.0, 600.0]], Y[2]]
    path = foreign(tmp_path / "a.geojson", *table, lines=lines)
    with pytest.warns(UserWarning, match=r"a\.geojson: 1 ends lie more than a width .*left free .*141\.4 m: feature 1"):
        network = read_network(path)
    assert network.channel_to[0] == network.channel_from[2] != network.channel_to[1]
    np.testing.assert_array_equal(network.node_xy[network.channel_to[1]], [600.0, 600.0])
    np.testing.assert_array_equal(network.polylines()[1], lines[1])


def test_some_without_a_node_or_identity_are_joined_where_they_meet(tmp_path):
    for name in ("from_node", "channel_id"):
        table = noded((0, 9), (1, 9), (2, 3)) if name == "from_node" else rows((0, -1), (1, -1), (2, -1))
        table[1][name] = None
        with pytest.warns(UserWarning, match="1 of 3 lines have no (nodes|whole number as its identity)"):
            network = read_network(foreign(tmp_path / "a.geojson", *table))
        assert network.channel_to[0] == network.channel_to[1] == network.channel_from[2]
    assert network.channel_id.tolist() == [0, 3, 2]


def test_several_files_are_numbered_anew_and_of_a_feature_its_further_lines(tmp_path):
    for name in "ab":
        foreign(tmp_path / f"{name}.geojson", *rows((5, -1), (6, -1), (7, -1)))
    far = collection(
        tmp_path / "c.geojson",
        feature("MultiLineString", [Y[0], Y[1]], width=9.0, channel_id=3, next_down=4),
        feature("LineString", Y[2], width=9.0, channel_id=4, next_down=-1),
        crs=None,
    )
    both = read_network([tmp_path / "a.geojson", tmp_path / "b.geojson"])
    assert both.channel_id.tolist() == [0, 1, 2, 3, 4, 5]
    with pytest.warns(UserWarning, match="1 of 3 lines have the identity of another: the first is feature 0"):
        parts = read_network(far)
    assert parts.channel_id.tolist() == [3, 5, 4]
    for network in (both, parts):
        assert network.channel_to[0] == network.channel_to[1] == network.channel_from[2]


def test_dropped_channels_leave_the_rest_joined(tmp_path):
    table = rows((0, 2), (1, 2), (2, -1))
    table[1]["width_m"] = 5000.0
    path = foreign(tmp_path / "a.geojson", *table)
    network = read_network(path, short="drop")
    assert network.channel_id.tolist() == [0, 2] and network.channel_to[0] == network.channel_from[1]
    assert read_network(path, short="keep").channel_width[1] == 5000.0


@needs_ogr
def test_nodes_of_a_geopackage_that_no_channel_uses_are_passed_over(tmp_path):
    import pyogrio.raw
    import shapely

    path = tmp_path / "a.gpkg"
    network = RiverNetwork.from_polylines(Y, width=20.0, crs="EPSG:32619")
    write_network(network, path)
    _, _, wkb, data = pyogrio.raw.read(path, layer="channels_nodes")
    assert data[0].tolist() == [0, 1, 2, 3] and data[1].tolist() == ["source", "source", "junction", "outlet"]
    np.testing.assert_array_equal(shapely.get_coordinates(shapely.from_wkb(wkb)), network.node_xy)
    dangling = shapely.to_wkb(shapely.points([*network.node_xy.tolist(), [9e3, 9e3]]))
    pyogrio.raw.write(
        path,
        geometry=dangling,
        field_data=[np.arange(5)],
        fields=np.array(["node_id"]),
        geometry_type="Point",
        crs="EPSG:32619",
        layer="channels_nodes",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = read_network(path)
    np.testing.assert_array_equal(back.node_xy, network.node_xy)


def test_a_damaged_frame_is_passed_over(tmp_path):
    for frame in (None, 3, {}, {"origin": [1]}, {"origin": ["a", "b"]}, {"origin": [0, 0], "node_xy": [[1]]}, "{"):
        network = read_network(foreign(tmp_path / "a.geojson", *noded((0, 2), (1, 2), (2, 3)), warpriver=frame))
        assert network.node_count == 4
        np.testing.assert_array_equal(network.polylines()[0], Y[0])


# ---- graphs that are none


@pytest.mark.parametrize(
    ("table", "lines", "words"),
    [
        (rows((5, 6), (6, 7), (7, 5)), TRIANGLE, r"a\.geojson, feature \d: channels flow in a circle, \d -> \d -> \d"),
        (rows((5, 6), (6, 5), (7, -1)), Y, r"feature \d: channels flow in a circle, \d -> \d -> \d; correct what"),
        (rows((5, 7), (6, 7), (7, -1)), [*Y[:2], [[5, 5], [5, 5], [5, 5]]], r"feature 2: no length, only one distinct"),
    ],
)
def test_bad_graphs_in_files_are_told_in_one_line(tmp_path, table, lines, words):
    path = foreign(tmp_path / "a.geojson", *table, lines=lines)
    with pytest.raises(ValueError, match=words) as caught:
        read_network(path)
    assert "a.geojson" in str(caught.value) and "\n" not in str(caught.value)


def test_bad_numbers_do_not_stand_in_the_way_of_ends(tmp_path):
    path = foreign(tmp_path / "a.geojson", *rows((5, 7), (5, 7), (7, 5)))
    with pytest.warns(UserWarning, match="1 of 3 lines have the identity of another: the first is feature 1"):
        network = read_network(path, topology="ends")
    assert network.channel_id.tolist() == [5, 8, 7] and network.node_count == 4
    with pytest.raises(ValueError, match="topology is 'nodes'; use one of 'file', 'ends'"):
        read_network(path, topology="nodes")


def test_identities_of_text_stand_once(tmp_path):
    text = "channel,x,y,width\n1,0,0,9\n1,90,0,9\n2,0,50,9\n2,90,50,9\n1,0,99,9\n1,90,99,9\n"
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match="rows of channel 1 do not stand together"):
        read_network(tmp_path / "a.csv")


def test_a_circle_of_ends_or_nodes_is_read_and_refused_by_what_needs_a_forest(tmp_path):
    for table in ([{"width": 20.0}] * 3, noded((0, 1), (1, 2), (2, 0))):
        network = read_network(foreign(tmp_path / "a.geojson", *table, lines=TRIANGLE))
        write_network(network, tmp_path / "b.geojson")  # without orders
        back = read_network(tmp_path / "b.geojson")
        np.testing.assert_array_equal(back.channel_to, network.channel_to)
        for circle in (network, RiverNetwork.from_polylines(TRIANGLE, width=20.0)):
            with pytest.raises(ValueError, match="channel 0 belongs to a circle or flows into one"):
                Simulation(circle, plain_params(spacing=20.0))
            with pytest.raises(ValueError, match="belongs to a circle"):
                strahler_order(circle.channel_from, circle.channel_to)


def packed(**changes):
    """A network of two channels of three points by its constructor, with some arguments changed."""
    arguments = {
        "point_xy": np.array([[0.0, 0.0], [50.0, 0.0], [90.0, 9.0], [90.0, 9.0], [200.0, 0.0], [300.0, 0.0]]),
        "channel_start": np.array([0, 3, 6]),
        "channel_width": np.array([9.0, 9.0]),
        "channel_depth": np.array([1.0, 1.0]),
        "channel_discharge": np.array([5.0, 5.0]),
        "channel_nodes": (np.array([0, 1]), np.array([1, 2]), np.array([[0.0, 0.0], [90.0, 9.0], [300.0, 0.0]])),
    }
    arguments |= changes
    return RiverNetwork(arguments.pop("point_xy"), arguments.pop("channel_start"), **arguments)


def nodes(above, below, count=3):
    return np.array(above), np.array(below), np.arange(2.0 * count).reshape(count, 2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"channel_id": [4, 4]}, "channel_id 4 stands twice, at channels 0 and 1"),
        ({"channel_id": [4]}, r"channel_id has shape \(1,\) for 2 channels"),
        ({"channel_id": [0.5, 1.0]}, "one whole number a channel"),
        ({"channel_nodes": nodes([0, 1], [1, 2], 4)}, "node 3 belongs to no channel"),
        ({"channel_nodes": nodes([0, 1], [1, 3])}, "channel 1 runs from node 1 to 3, but there are 3 nodes"),
        ({"channel_nodes": nodes([0, -1], [1, 2])}, "channel 1 runs from node -1 to 2"),
        ({"channel_nodes": (np.array([0, 1]), np.array([1, 2]), np.zeros(3))}, r"node_xy has shape \(3,\)"),
        ({"channel_start": [0, 3, 4]}, r"channel 1 has 1 point\(s\)"),
        ({"channel_start": [0, 3]}, "2 offsets, from 0 to 3, for 2 channels and 6 points"),
        ({"channel_start": [0, 3, 9]}, "from 0 to 9, for 2 channels and 6 points"),
        (
            {"point_xy": np.array([[0.0, 0.0], [9.0, 0.0], [90.0, 9.0], [5.0, 5.0], [5.0, 5.0], [5.0, 5.0]])},
            "no length",
        ),
    ],
)
def test_the_constructor_takes_no_bad_graph(changes, words):
    assert packed().node_count == 3
    with pytest.raises(ValueError, match=words) as caught:
        packed(**changes)
    assert "\n" not in str(caught.value)


def test_the_constructor_from_lines_takes_no_bad_graph():
    lines = [sine(20), sine(20, shift=(0.0, 5e3))]
    ends = np.array([lines[0][0], lines[1][0], lines[0][-1], lines[1][-1]])
    fine = RiverNetwork.from_polylines(lines, width=9.0, nodes=([0, 1], [2, 3], ends), channel_id=[5, 3])
    assert fine.channel_id.tolist() == [5, 3] and np.isnan(fine.channel_slope).all()
    for changes, words in (
        ({"channel_id": [5, 5]}, "channel_id 5 stands twice"),
        ({"nodes": ([0, 1], [2, 9], ends)}, "but there are 4 nodes"),
        ({"nodes": ([0, 1], [2, 2], ends)}, "node 3 belongs to no channel"),
        ({"slope": [0.1, np.inf]}, "slope of channel 1 is infinite"),
        ({"slope": [0.1, 0.2, 0.3]}, r"slope: shape \(3,\) for 2 channels"),
    ):
        with pytest.raises(ValueError, match=words):
            RiverNetwork.from_polylines(lines, width=9.0, **changes)
