"""Trajectories: sinuosity 1 / J0, wavelengths, threads and their shares, and where nothing is added."""

import numpy as np
import pytest
from river_scenes import one_river
from scipy.special import j0

import warpriver as wr
from warpriver.metrics import wavelength
from warpriver.riverscape import TrajectoryParams
from warpriver.riverscape.stations import TYPES
from warpriver.riverscape.templates import TEMPLATES
from warpriver.riverscape.trajectories import _Axis, _braid, _meander, meander_angle, thread_count


def straight(length, room=np.inf):
    x = np.linspace(0.0, length, 2001)
    zero, one = np.zeros_like(x), np.ones_like(x)
    return _Axis(x, np.column_stack([x, zero]), np.column_stack([one, zero]), np.full((len(x), 2), room))


@pytest.mark.parametrize("sinuosity", [1.1, 1.5, 1.8, 2.0])
def test_meanders_have_the_sinuosity_of_their_angle(sinuosity):
    angle = meander_angle(sinuosity)
    assert 1.0 / j0(angle) == pytest.approx(sinuosity, rel=1e-4)
    # Without variation, and away from the ends, which nodes hold: whole waves.
    line = _meander(straight(4400.0), 0, 10.0, sinuosity, np.random.default_rng(1), TrajectoryParams(variation=0.0))
    x = line.axis
    inside = (x >= 440.0) & (x <= 3960.0)
    arc = np.hypot(*np.diff(line.xy[inside], axis=0).T).sum()
    assert arc / 3520.0 == pytest.approx(1.0 / j0(angle), rel=5e-3)


def test_varied_meanders_stay_about_their_axis_and_wavelength():
    line = _meander(straight(4400.0), 0, 10.0, 1.6, np.random.default_rng(2), TrajectoryParams())
    assert abs(line.xy[:, 1].mean()) < 3.0 and line.xy[0, 1] == line.xy[-1, 1] == 0.0
    assert wavelength(line.xy, 10.0) == pytest.approx(110.0, rel=0.25)
    inside = (line.axis > 110.0) & (line.axis < 4290.0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(*np.diff(line.xy[inside], axis=0).T[::-1]))))
    # No corner where bends of different angles meet: points are 1.5 m apart, and no bend is tighter than its width.
    assert turn.max() < 0.15


def test_meanders_keep_within_level_ground():
    line = _meander(straight(2200.0, room=12.0), 0, 10.0, 1.6, np.random.default_rng(2), TrajectoryParams())
    # Half a width of water beside the line.
    assert 4.0 < np.abs(line.xy[:, 1]).max() <= 7.5


def test_the_number_of_threads_follows_the_flow():
    d, da = TYPES.index("D"), TYPES.index("DA")
    flow = np.array([1.0, 8.0, 27.0, 125.0, 1000.0])
    assert thread_count(d, flow, TrajectoryParams()).tolist() == [3, 3, 4, 6, 7]
    assert thread_count(da, flow, TrajectoryParams()).tolist() == [4, 4, 5, 7, 8]
    assert thread_count(TYPES.index("C"), flow, TrajectoryParams()).tolist() == [1] * 5


def test_threads_share_the_water_and_meet_at_the_nodes():
    axis = straight(900.0)
    lines = _braid(axis, 0, np.full(2, 5), 20.0, "D", np.random.default_rng(4), TrajectoryParams())
    threads, plain = lines[:-1], lines[-1]
    middle = len(threads[0].axis) // 2
    assert sum(t.share[middle] for t in threads) == pytest.approx(1.0)
    assert min(t.share[middle] for t in threads) > 0.35 / 5 / 2
    for t in threads:
        np.testing.assert_allclose(t.xy[[0, -1]], [[0.0, 0.0], [900.0, 0.0]], atol=1e-9)
        assert t.share[0] == t.share[-1] == 1.0  # one section there
    y = np.stack([t.xy[:, 1] for t in threads])
    crossings = (np.diff(np.sign(y[:, None] - y[None]), axis=2) != 0).sum() / 2
    assert crossings > 20  # they part and meet
    half = np.nanmax(plain.belt) / 2
    assert np.abs(y).max() < half and np.nanmin(plain.belt) >= 0.0
    wide = _braid(axis, 0, np.full(2, 5), 20.0, "DA", np.random.default_rng(4), TrajectoryParams())
    assert np.nanmax(wide[-1].belt) > 1.5 * np.nanmax(plain.belt)


@pytest.mark.parametrize(
    ("kind", "least", "most"), [("A", 1.0, 1.001), ("B", 1.001, 1.1), ("C", 1.3, 1.55), ("E", 1.4, 1.9)]
)
def test_types_wind_as_they_do(kind, least, most):
    scene = one_river(kind, 0.008, 0.3, 360.0, curve=0.0)
    assert least <= scene.stations.length()[0] / 360.0 <= most
    assert TEMPLATES[scene.rivers.kind[0]].sinuosity >= 1.0


def test_terrain_that_shows_bends_gets_no_more_of_them():
    """Cells of 10 m show a wavelength of 80 m or more; and lines that are given stay as they are."""
    wide = one_river("C", 0.008, 6.0, 360.0, curve=0.0)
    assert 11.0 * wide.stations.width.mean() > 80.0 and wide.stations.length()[0] == pytest.approx(360.0, rel=1e-6)
    given = one_river("C", 0.008, 0.3, 360.0, curve=0.0, planform="given")
    assert given.stations.length()[0] == pytest.approx(360.0, rel=1e-6)


def test_the_same_seed_gives_the_same_courses():
    a, b, other = (one_river("C", 0.008, 0.3, 300.0, seed=s).stations for s in (5, 5, 6))
    assert np.array_equal(a.xy, b.xy) and np.array_equal(a.water, b.water)
    assert len(a.xy) != len(other.xy) or not np.array_equal(a.xy, other.xy)


def test_threads_leave_and_join_the_nearest_where_their_number_changes():
    """Where they part both lie on one line with the water of both; beyond that all water is shared out."""
    along = np.linspace(0.0, 4000.0, 401)
    axis = _Axis(along, np.column_stack([along, 0.0 * along]), np.tile([1.0, 0.0], (401, 1)), np.full((401, 2), np.inf))
    number = np.where(along < 1500.0, 3, np.where(along < 2600.0, 5, 4))
    lines = _braid(axis, 0, number, 20.0, "D", np.random.default_rng(4), TrajectoryParams())
    threads = [line for line in lines if line.thread >= 0]
    assert len(threads) == 5 and len({line.thread for line in threads}) == 5
    ends = [(line.axis[0], line.axis[-1]) for line in threads]
    assert [e for e in ends if e == (0.0, 4000.0)] == [(0.0, 4000.0)] * 3
    (fourth,) = [e for e in ends if e[0] > 0.0 and e[1] == 4000.0]
    (fifth,) = [e for e in ends if e[0] > 0.0 and e[1] < 4000.0]
    assert fourth[0] == pytest.approx(1500.0, abs=15.0) and fifth == pytest.approx((1500.0, 2600.0), abs=15.0)
    for k, line in enumerate(threads):
        for end, place in ((0, line.axis[0]), (-1, line.axis[-1])):
            if 0.0 < place < 4000.0:
                others = [o for j, o in enumerate(threads) if j != k and o.axis[0] <= place <= o.axis[-1]]
                off = [np.hypot(*(o.xy[np.abs(o.axis - place).argmin()] - line.xy[end])) for o in others]
                near = others[int(np.argmin(off))]
                assert min(off) < 1e-9
                assert near.share[np.abs(near.axis - place).argmin()] == pytest.approx(line.share[end])
    # Away from where they part and meet the water is that of the river.
    belt = np.nanmax(lines[-1].belt)
    for x in np.arange(2.0 * belt, 4000.0 - 2.0 * belt, 10.0):
        if min(abs(x - 1500.0), abs(x - 2600.0)) > 1.3 * belt:
            shares = [np.interp(x, o.axis, o.share) for o in threads if o.axis[0] <= x <= o.axis[-1]]
            assert sum(shares) == pytest.approx(1.0, abs=1e-9)
            assert len(shares) == (3 if x < 1500.0 else 5 if x < 2600.0 else 4)


def test_a_braided_river_whose_flow_grows_gets_more_threads_on_the_way(device):
    """From 13 to 20 m3/s: round(1 + phi^(1/3)) is 3 at the head and 4 at the end; the water falls on all threads."""
    x = np.linspace(0.0, 1900.0, 60)
    line = np.column_stack([x + 40.0, 200.0 + 0.0 * x])
    network = wr.RiverNetwork.from_polylines([line], width=20.0, slope=[0.012], drainage_area=[2.8e8])
    rows = (40.0 - np.arange(40) - 0.5) * 10.0
    east = (np.arange(200) + 0.5) * 10.0
    height = 100.0 - 0.012 * east + 1e-5 * (rows[:, None] - 200.0) ** 2
    scene = wr.Riverscape(wr.Terrain(height, 10.0, (0.0, 400.0)), network, "D", detail=1.0, device=device)
    stations = scene.stations
    wet = np.flatnonzero(stations.wet)
    begins = stations.along[stations.start[wet]], stations.xy[stations.start[wet], 0]
    late = wet[begins[1] > 100.0]
    assert len(late) >= 1 and len(wet) > 3
    for k in wet:
        part = slice(stations.start[k], stations.start[k + 1])
        assert (np.diff(stations.water[part]) <= 0.0).all()
    for k in late:
        # It begins on another thread, at that one's level: no fall where they part.
        first = stations.start[k]
        others = [m for m in wet if m != k]
        index = np.concatenate([np.arange(stations.start[m], stations.start[m + 1]) for m in others])
        near = index[np.hypot(*(stations.xy[index] - stations.xy[first]).T).argmin()]
        assert np.hypot(*(stations.xy[near] - stations.xy[first])) < 4.0
        assert stations.water[near] == pytest.approx(stations.water[first], abs=0.05)
