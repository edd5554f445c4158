"""Tests of the elevations of channel lines."""

import numpy as np
import pytest

import warpriver as wr
from warpriver.hydrology import drape
from warpriver.terrain import Terrain


def rough(gaps=False):
    """Ground that falls east with noise that makes courses rise."""
    x = np.arange(200) * 10.0
    height = 500.0 - 0.01 * x + np.random.default_rng(0).normal(0.0, 2.0, (100, 200))
    if gaps:
        height[:, 50:60] = height[40:60, :3] = np.nan
    return Terrain(height, 10.0, (0.0, 1000.0))


def fork():
    """Two channels that meet in a third."""
    s = np.linspace(0.0, 1.0, 60)
    a = np.c_[5.0 + 900.0 * s, 800.0 - 300.0 * s]
    b = np.c_[5.0 + 900.0 * s, 200.0 + 300.0 * s]
    c = np.c_[905.0 + 1000.0 * s, 500.0 + 40.0 * np.sin(6.0 * s)]
    return wr.RiverNetwork.from_polylines([a, b, c], width=5.0)


def by_hand(network, terrain):
    """The least height of the ground upstream, point by point."""
    lines = [terrain.sample(xy) for xy in network.polylines()]
    a, b = (np.minimum.accumulate(z) for z in lines[:2])
    a[-1] = b[-1] = min(a[-1], b[-1])
    c = np.minimum.accumulate(np.concatenate([[a[-1]], lines[2][1:]]))
    return np.concatenate([a, b, c])


def test_elevations_are_the_lowest_upstream():
    network, terrain = fork(), rough()
    raw = terrain.sample(network.points())
    assert (np.diff(raw) > 0.0).sum() > 60  # what they would be without
    draped = drape(network, terrain)
    np.testing.assert_array_equal(draped.point_z, by_hand(network, terrain))
    assert network.point_z is None and draped.channels == network.channels
    a, b, c = draped.point_elevations()
    assert a[-1] == b[-1] == c[0] and all((np.diff(z) <= 0.0).all() for z in (a, b, c))
    assert (draped.point_z <= raw).all()


def test_gaps_are_crossed_and_rings_are_level():
    draped = drape(fork(), rough(gaps=True))
    assert np.isfinite(draped.point_z).all()
    assert all((np.diff(z) <= 0.0).all() for z in draped.point_elevations())
    angle = np.linspace(0.0, 2.0 * np.pi, 50, endpoint=False)
    ring = np.c_[1000.0 + 300.0 * np.cos(angle), 500.0 + 300.0 * np.sin(angle)]
    level = drape(wr.RiverNetwork.from_polylines([ring], width=5.0, closed=True), rough())
    np.testing.assert_array_equal(level.point_z, rough().sample(ring).min())


def test_what_has_no_ground_is_refused():
    far = wr.RiverNetwork.from_polylines([fork().polylines()[0], fork().polylines()[0] + 5000.0], width=5.0)
    with pytest.raises(ValueError, match=r"1 channels \(the first: 1\) lie off the terrain"):
        drape(far, rough())
    p, q = np.array([300.0, 500.0]), np.array([900.0, 500.0])
    bow = np.c_[np.linspace(0, 1, 20), np.sin(np.linspace(0, np.pi, 20))]
    there = p + bow * [600.0, 100.0]
    back = q - bow * [600.0, 100.0]
    there[-1], back[-1] = q, p
    circle = wr.RiverNetwork.from_polylines([there, back], width=5.0)
    with pytest.raises(ValueError, match=r"2 channels flow in a circle"):
        drape(circle, rough())


@pytest.mark.parametrize("carve", [True, False])
def test_an_extracted_network_never_rises_in_files(tmp_path, carve):
    basin = wr.generate.intermontane_basin(cell_size=400.0, seed=1)
    network = drape(wr.extract_network(basin, min_drainage_area=8e6, carve=carve), basin)
    wr.write_network(network, tmp_path / "a.csv")
    again = wr.read_network(tmp_path / "a.csv", short="keep")
    np.testing.assert_array_equal(again.point_z, network.point_z)
    end = np.array([z[-1] for z in again.point_elevations()])
    begin = np.array([z[0] for z in again.point_elevations()])
    assert all((np.diff(z) <= 0.0).all() for z in again.point_elevations())
    joined = np.flatnonzero(np.isin(again.channel_to, again.channel_from))
    for c in joined:
        assert end[c] >= begin[again.channel_from == again.channel_to[c]].max()
