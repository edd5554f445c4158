import numpy as np
import pytest

from warpriver import RiverNetwork
from warpriver.network import bankfull_depth, bankfull_discharge, bankfull_width

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
        ([[["a", "b"]] * 3], {}, "not an array of numbers"),
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
        ([LINE], {"device": "tpu:7"}, "not on this machine; it has: cpu"),
    ],
)
def test_bad_input_gets_one_clear_error(lines, arguments, words):
    with pytest.raises(ValueError, match=words) as caught:
        RiverNetwork.from_polylines(lines, **{"width": 20.0, **arguments})
    assert "\n" not in str(caught.value)
