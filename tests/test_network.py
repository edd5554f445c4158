import copy
import pickle

import numpy as np
import pytest
from plain import plain_params

from warpriver import RiverNetwork, Simulation
from warpriver.hydraulic_geometry import bankfull_depth, bankfull_discharge, bankfull_width
from warpriver.meander import taubin_smooth

LINE = np.array([[0.0, 0.0], [400.0, 100.0], [900.0, 0.0], [1500.0, 300.0]])


def test_polylines_come_back_to_the_bit():
    other = LINE + [5e5, 4.6e6]
    network = RiverNetwork.from_polylines([other, other + [0.0, 5000.0]], width=50.0)
    back = network.polylines()
    np.testing.assert_array_equal(back[0], other)
    np.testing.assert_array_equal(back[1], other + [0.0, 5000.0])
    assert network.channel_count == 2 and network.point_count == 8 and network.node_count == 4


def test_float32_far_from_the_origin_loses_no_more_than_its_extent_asks():
    far = LINE + [500_000.0, 4_600_000.0]
    back = RiverNetwork.from_polylines([far], width=50.0, dtype="float32").polylines()[0]
    # Half the extent, 750 m, has a float32 step of 6e-5 m; at 4,600 km it would be 0.5 m.
    np.testing.assert_allclose(back, far, atol=6e-5, rtol=0)


def test_depth_and_discharge_follow_from_the_width():
    network = RiverNetwork.from_polylines([LINE], width=200.0)
    assert network.channel_depth[0] == pytest.approx((200.0 / 18.8) ** (1 / 1.41))
    assert bankfull_width(bankfull_depth(137.0)) == pytest.approx(137.0)
    assert network.channel_discharge[0] == pytest.approx(bankfull_discharge(200.0))
    given = RiverNetwork.from_polylines([LINE], width=200.0, depth=3.0, discharge=77.0)
    assert (given.channel_depth[0], given.channel_discharge[0]) == (3.0, 77.0)


def test_width_may_vary_along_a_channel():
    width = np.array([40.0, 50.0, 60.0, 70.0])
    network = RiverNetwork.from_polylines([LINE, LINE + [0, 9e3]], width=[width, 30.0])
    assert network.channel_width.tolist() == [55.0, 30.0]
    np.testing.assert_array_equal(network.point_widths()[0], width)
    np.testing.assert_array_equal(network.point_section.numpy()[:4, 1], bankfull_depth(width))
    constant = RiverNetwork.from_polylines([LINE], width=[np.full(4, 40.0)])
    assert constant.point_section is None


def test_ends_that_meet_are_one_node():
    left, right = LINE, np.array([[0.0, 900.0], [700.0, 700.0], [1500.0, 300.0]])
    below = np.array([[1500.0, 300.0], [2000.0, 200.0], [2500.0, 300.0]])
    network = RiverNetwork.from_polylines([left, right, below], width=20.0)
    assert network.node_count == 4
    assert network.channel_to[0] == network.channel_to[1] == network.channel_from[2]
    np.testing.assert_array_equal(network.node_xy[network.channel_to[0]], [1500.0, 300.0])


def test_lengths_and_bounds():
    network = RiverNetwork.from_polylines([LINE, LINE[::-1] + [0.0, 1e4]], width=20.0)
    length = np.hypot(*np.diff(LINE, axis=0).T).sum()
    np.testing.assert_allclose(network.channel_lengths(), [length, length], rtol=1e-14)
    assert network.bounds() == (0.0, 0.0, 1500.0, 10300.0)


def test_repr_says_what_there_is():
    text = repr(RiverNetwork.from_polylines([LINE], width=20.0, crs="EPSG:32619"))
    for word in ("1 channels", "4 points", "width 20 m", "EPSG:32619", "float64 on cpu"):
        assert word in text


def test_another_precision_is_a_copy():
    network = RiverNetwork.from_polylines([LINE], width=20.0)
    single = network.to(dtype="float32")
    assert single.dtype == "float32" and single.point_xy.dtype is not network.point_xy.dtype
    np.testing.assert_array_equal(single.polylines()[0], LINE)


NAN = LINE.copy()
NAN[2, 1] = np.nan
TWICE = np.concatenate([LINE[:2], LINE[1:]])


@pytest.mark.parametrize(
    ("lines", "arguments", "words"),
    [
        ([], {}, "at least one line"),
        ([np.zeros((0, 2))], {}, "channel 0: 0 point"),
        ([LINE, LINE[:1]], {}, "channel 1: 1 point"),
        ([LINE[:2]], {}, "at least 3"),
        ([NAN], {}, "channel 0: point 2 is not finite"),
        ([TWICE], {}, "points 1 and 2 are both at"),
        ([LINE[:, :1]], {}, r"shape \(4, 1\)"),
        ([[["a", "b"]] * 3], {}, "give .n, 2. x, y in metres"),
        ([LINE], {"width": 0.0}, "width of channel 0 is 0 m"),
        ([LINE], {"width": -3.0}, "positive"),
        ([LINE], {"width": np.nan}, "positive and finite"),
        ([LINE], {"width": [20.0, 30.0]}, "2 values for 1 channels"),
        ([LINE], {"width": [np.ones(3)]}, "for 4 points"),
        ([LINE], {"width": 5000.0}, "exceeds its length"),
        ([LINE], {"depth": 0.0}, "depth of channel 0"),
        ([LINE], {"discharge": -1.0}, "discharge of channel 0"),
        ([LINE], {"dtype": "float16"}, "use 'float64' or 'float32'"),
        ([LINE], {"crs": "EPSG:4326"}, "longitude and latitude"),
        ([LINE], {"crs": "nonsense"}, "crs: pyproj does not know the CRS 'nonsense'"),
        ([LINE], {"crs": "EPSG:2263"}, "crs: EPSG:2263 is in US survey foot, not metres"),
        ([LINE], {"device": "tpu:7"}, "not on this machine; it has: cpu"),
    ],
)
def test_bad_input_gets_one_clear_error(lines, arguments, words):
    with pytest.raises(ValueError, match=words) as caught:
        RiverNetwork.from_polylines(lines, **{"width": 20.0, **arguments})
    assert "\n" not in str(caught.value)


# ---- columns, elevations and copies


def test_columns_cannot_be_written_into():
    """A width set in place would move nothing: what a step needs of the channels was made of it before."""
    network = RiverNetwork.from_polylines([LINE, LINE + [0.0, 9e3]], width=20.0, drainage_area=1e6, slope=0.01)
    simulated = Simulation(network, plain_params(spacing=20.0)).network
    for net in (network, simulated, network.to(dtype="float32"), pickle.loads(pickle.dumps(network))):
        for name in ("width", "depth", "discharge", "drainage_area", "slope", "id", "from", "to", "closed"):
            column = getattr(net, f"channel_{name}")
            with pytest.raises(ValueError, match="read-only"):
                column[:] = column[0]
            with pytest.raises(AttributeError):
                setattr(net, f"channel_{name}", column)
        with pytest.raises(AttributeError):
            net.channels = network.channels


def test_a_copy_may_have_other_columns():
    network = RiverNetwork.from_polylines([LINE, LINE + [0.0, 9e3]], width=20.0, z=[np.arange(4.0), np.ones(4)])
    wide = network.with_channels(network.channels.replace(width=[30.0, 40.0], extra={"name": ["a", "b"]}))
    assert wide.channel_width.tolist() == [30.0, 40.0] and wide.channels["name"].tolist() == ["a", "b"]
    assert network.channel_width.tolist() == [20.0, 20.0] and "name" not in network.channels
    np.testing.assert_array_equal(wide.points(), network.points())
    np.testing.assert_array_equal(wide.point_z, network.point_z)


def test_a_table_or_keywords_make_the_same_network():
    network = RiverNetwork.from_polylines([LINE, LINE[::-1] + [0.0, 9e3]], width=[20.0, 30.0], slope=[0.1, np.nan])
    xy, start, table = network.points(), network.starts(), network.channels
    by_keyword = RiverNetwork(
        xy, start, channel_width=table.width, channel_depth=table.depth, channel_discharge=table.discharge,
        channel_slope=table.slope,
    )  # fmt: skip
    assert by_keyword.channels == RiverNetwork(xy, start, table, node_xy=network.node_xy).channels == table
    np.testing.assert_array_equal(by_keyword.node_xy, network.node_xy)
    with pytest.raises(TypeError, match="but not both"):
        RiverNetwork(xy, start, table, channel_width=table.width)
    with pytest.raises(TypeError, match="takes no channel_wdth; it takes channel_width, channel_depth"):
        RiverNetwork(xy, start, channel_wdth=table.width)
    with pytest.raises(TypeError, match="channel_depth is missing"):
        RiverNetwork(xy, start, channel_width=table.width)


def test_elevations_belong_to_the_line_as_given():
    z = [np.array([9.0, 7.5, 7.0, 1.0]), np.array([-1.0, -2.0, -3.0, -4.0])]
    network = RiverNetwork.from_polylines([LINE, LINE + [0.0, 9e3]], width=20.0, z=z)
    np.testing.assert_array_equal(network.point_z, np.concatenate(z))
    assert [line.shape for line in network.polylines()] == [(4, 2), (4, 2)]
    for one, two in zip(network.point_elevations(), z, strict=True):
        np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(network.to(dtype="float32").point_z, network.point_z)
    with pytest.raises(ValueError, match="read-only"):
        network.point_z[:] = 0.0
    assert Simulation(network, plain_params(spacing=20.0)).network.point_z is None
    assert taubin_smooth(network, 1).point_z is None and network.point_z is not None
    assert RiverNetwork.from_polylines([LINE], width=20.0).point_elevations() is None


def test_elevations_of_a_ring_turn_with_its_points():
    angle = 2.0 * np.pi * np.arange(21) / 20
    ring, z = 300.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), np.cos(angle)
    ring[-1], z[-1] = ring[0], z[0]
    network = RiverNetwork.from_polylines([ring], width=20.0, z=[z], closed=True, marks=5)
    np.testing.assert_array_equal(network.point_z, np.roll(z[:-1], -5))
    (closed,) = network.point_elevations(close=True)
    assert len(closed) == 21 and closed[0] == closed[-1]


@pytest.mark.parametrize("varying", [False, True])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_networks_are_pickled_and_copied_to_the_bit(dtype, varying):
    width = [np.array([40.0, 50.0, 60.0, 70.0]), 30.0] if varying else 30.0
    network = RiverNetwork.from_polylines(
        [LINE + [5e5, 4e6], LINE + [5e5, 4.009e6]], width=width, drainage_area=[1e6, 2e6], slope=[0.01, np.nan],
        z=[np.arange(4.0), np.ones(4)], channel_id=[7, 3], extra={"name": ["a", "b"]}, crs="EPSG:32619", dtype=dtype,
    )  # fmt: skip
    for other in (pickle.loads(pickle.dumps(network)), copy.deepcopy(network)):
        assert other is not network and (other.dtype, other.crs, other.device) == (dtype, network.crs, network.device)
        assert other.channels == network.channels
        for name in ("point_xy", "channel_start", "point_section"):
            one, two = getattr(other, name), getattr(network, name)
            assert (one is None and two is None) or one.numpy().tobytes() == two.numpy().tobytes()
        for name in ("origin", "node_xy", "point_z"):
            np.testing.assert_array_equal(getattr(other, name), getattr(network, name))
    copied = copy.deepcopy(network)
    copied.point_xy.zero_()
    assert network.points().any(), "the copy has points of its own"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"point_z": np.zeros(3)}, r"point_z has shape \(3,\); give \(4,\)"),
        ({"point_z": [0.0, 1.0, np.nan, 2.0]}, "point_z of point 2 is nan"),
        ({"point_section": np.ones(4)}, r"point_section has shape \(4,\); give \(4, 2\)"),
        ({"point_section": np.array([[1.0, 1.0]] * 3 + [[1.0, 0.0]])}, r"point_section of point 3 is \[1.0, 0.0\]"),
        ({"origin": (np.nan, 0.0)}, "origin is"),
        ({"crs": 5}, "crs is 5; give a text"),
        ({"channel_depth": [0.0]}, "channel_depth of channel 0 is 0"),
        ({"channel_closed": []}, r"channel_closed has shape \(0,\)"),
    ],
)
def test_the_constructor_takes_no_bad_values(arguments, words):
    columns = {"channel_width": [20.0], "channel_depth": [1.0], "channel_discharge": [5.0], **arguments}
    with pytest.raises(ValueError, match=words) as caught:
        RiverNetwork(LINE, [0, 4], **columns)
    assert "\n" not in str(caught.value)


def test_elevations_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"z of channel 0: shape \(3,\) for 4 points"):
        RiverNetwork.from_polylines([LINE], width=20.0, z=[np.zeros(3)])
    with pytest.raises(ValueError, match="z of channel 0 is nan m; it must be finite"):
        RiverNetwork.from_polylines([LINE], width=20.0, z=[[0.0, 1.0, np.nan, 2.0]])
