"""Profiles: envelopes over trees, against a walk along every path; and the steps of steep rivers."""

import numpy as np
import pytest
from data_folder import data_folder
from river_scenes import junction, one_river

import warpriver as wr
from warpriver.riverscape import ProfileParams, Riverscape
from warpriver.riverscape.profiles import Graph, falling_profile, lay_steps, step_levels
from warpriver.riverscape.stations import TYPES

GENTLE, STEEP = np.full(99, 0.0), np.full(99, np.inf)


def tree(seed):
    """A random tree of channels with random heights."""
    random = np.random.default_rng(seed)
    count = 12
    below = np.array([random.integers(k) if k else 0 for k in range(count)])  # node k drains into node below[k]
    above, into = np.arange(1, count + 1), below
    counts = random.integers(3, 9, count)
    start = np.concatenate([[0], np.cumsum(counts)])
    graph = Graph(start, above, into, count + 1)
    along = np.arange(start[-1]) - np.repeat(start[:-1], counts)
    return graph, along * 10.0, random.normal(0.0, 5.0, start[-1])


def upstream(graph, c, k):
    """Indices of all places at or above place k of channel c; the head of what leaves a node lies at the node."""
    start = graph.start
    found = list(range(start[c], start[c] + k + 1))
    for other in np.flatnonzero(graph.below == graph.above[c]):
        found += upstream(graph, other, start[other + 1] - start[other] - 1)
    return found


@pytest.mark.parametrize("seed", range(5))
def test_the_lower_envelope_is_the_least_height_upstream(seed):
    graph, along, ground = tree(seed)
    count = len(graph.above)
    z = falling_profile(ground, along, graph, np.zeros(count), np.full(count, 1e4), 1.0)
    node = np.full(graph.nodes, np.inf)
    for c in range(count):
        here = ground[upstream(graph, c, graph.start[c + 1] - graph.start[c] - 1)].min()
        leaving = np.flatnonzero(graph.above == graph.below[c])
        here = min([here, *ground[graph.start[leaving]]])
        node[graph.below[c]] = min(node[graph.below[c]], here)
    for c in range(count):
        for k in range(graph.start[c + 1] - graph.start[c]):
            least = ground[upstream(graph, c, k)].min()
            if k == 0:
                least = min(node[graph.above[c]], np.inf) if np.isfinite(node[graph.above[c]]) else least
            if k == graph.start[c + 1] - graph.start[c] - 1:
                least = min(least, node[graph.below[c]])
            assert z[graph.start[c] + k] == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize("mix", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_every_mixture_falls_through_all_nodes(seed, mix):
    graph, along, ground = tree(seed)
    count = len(graph.above)
    z = falling_profile(ground, along, graph, np.full(count, 25.0), np.full(count, 2.0), mix)
    first, last = graph.start[:-1], graph.start[1:] - 1
    inside = np.ones(len(z) - 1, bool)
    inside[graph.start[1:-1] - 1] = False
    assert (np.diff(z)[inside] <= 1e-9).all()
    level = np.full(graph.nodes, np.nan)
    for c in range(count):
        for node, value in ((graph.above[c], z[first[c]]), (graph.below[c], z[last[c]])):
            assert np.isnan(level[node]) or level[node] == value
            level[node] = value
    if mix == 1.0:
        assert (z <= ground + 1e-9).all()
    # No reach is steeper than the limit.
    assert (-np.diff(z)[inside] <= 2.0 * 10.0 + 1e-9).all()


def test_steps_have_the_spacing_of_their_slope_and_keep_nodes():
    """A plane of 5 %: 8.25 x 5^-.98 = 1.70 widths apart, flat between, nowhere above the plane."""
    along = np.linspace(0.0, 600.0, 1201)
    z, graph = 50.0 - 0.05 * along, Graph(np.array([0, 1201]), np.array([0]), np.array([1]), 2)
    one = np.ones(1)
    steps = lay_steps(z, along, graph, np.array([TYPES.index("A")]), 0.05 * one, 4.0 * one, one, 1, ProfileParams())
    assert 600.0 / len(steps.channel) / 4.0 == pytest.approx(8.25 * 5.0**-0.98, rel=0.02)
    gaps = steps.end - steps.axis
    assert 0.1 < gaps.std() / gaps.mean() < 0.25  # jittered by 30 % evenly: .17
    out = step_levels(z, np.zeros(1201, int), along, steps)
    assert out[0] == z[0] and out[-1] == pytest.approx(z[-1]) and (out <= z + 1e-12).all()
    assert (np.diff(out) <= 1e-12).all()
    flat = np.isclose(np.diff(out), 0.0, atol=1e-9)
    assert 0.7 < flat.mean() < 0.95
    b = lay_steps(z, along, graph, np.array([TYPES.index("B")]), 0.05 * one, 4.0 * one, one, 1, ProfileParams())
    between = (b.lower - b.tail) / (b.end - b.axis)
    np.testing.assert_allclose(between, 0.4 * 0.05, rtol=1e-9)


def test_high_steps_are_waterfalls_of_thrown_water():
    along = np.linspace(0.0, 400.0, 4001)
    z, graph = 200.0 - 0.3 * along, Graph(np.array([0, 4001]), np.array([0]), np.array([1]), 2)
    one = np.ones(1)
    steps = lay_steps(
        z, along, graph, np.array([TYPES.index("A+")]), 0.3 * one, 9.0 * one, 2.0 * one, 1, ProfileParams()
    )
    assert steps.free.all() and (steps.upper - steps.lower > 1.5).all()
    k = len(steps.channel) // 2
    x = steps.axis[k] + np.linspace(0.0, 0.9 * steps.length[k], 20)
    level = step_levels(np.full(20, 1e9), np.zeros(20, int), x, steps)
    np.testing.assert_allclose(level, steps.upper[k] - 0.5 * 9.81 * ((x - steps.axis[k]) / 2.0) ** 2, atol=1e-9)


def rises(scene):
    """Uphill steps of the water, and the greatest difference between courses that meet at a node."""
    courses = scene.stations
    course = courses.station_course
    same = (course[1:] == course[:-1]) & courses.wet[course[1:]]
    up = int((np.diff(courses.water)[same] > 0.0).sum())
    first, last = courses.start[:-1], courses.start[1:] - 1
    node = np.concatenate([courses.from_node[courses.wet], courses.to_node[courses.wet]])
    level = np.concatenate([courses.water[first[courses.wet]], courses.water[last[courses.wet]]])
    low, high = np.full(node.max() + 1, np.inf), np.full(node.max() + 1, -np.inf)
    np.minimum.at(low, node, level)
    np.maximum.at(high, node, level)
    return up, float((high - low)[np.isfinite(low)].max())


@pytest.mark.parametrize("kinds", [("B", "B", "C"), ("A", "G", "D"), ("E", "C", "DA"), ("A+", "A+", "F")])
def test_water_never_rises_where_types_meet(kinds):
    assert rises(junction(kinds)) == (0, 0.0)


@pytest.mark.parametrize(
    ("name", "options", "threshold"),
    [
        ("vermont_90m_nocrs.tif", {"crs": "EPSG:32618"}, 4e6),
        ("gabilan_lidar1m.tif", {}, 1e4),
        ("minnesota_potholes_lidar1m.tif", {}, 4e3),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_water_never_rises_on_real_ground(name, options, threshold):
    pytest.importorskip("rasterio")
    ground = wr.read_terrain(data_folder("dem") / name, **options)
    network = wr.extract_network(ground, min_drainage_area=threshold)
    scene = Riverscape(ground, network, detail=2.0)
    assert rises(scene) == (0, 0.0)
    # The ground itself rises along 7 to 27 % of the steps.
    raw = scene.rivers.beds.heights(scene.stations.xy)[1]
    course = scene.stations.station_course
    assert (np.diff(raw)[course[1:] == course[:-1]] > 0.0).mean() > 0.04


def test_falls_are_where_the_water_is_steep():
    scene = one_river("A", 0.08, 1.5, 120.0)
    falls, courses = scene.stations.falls, scene.stations
    assert len(falls) > 10 and (falls.drop > 0.0).all() and (falls.drop / falls.length > 0.15).all()
    # Between them the water of type A is level: they make up all of the drop.
    assert falls.drop.sum() == pytest.approx(courses.water[0] - courses.water[-1], rel=0.02)
    assert not len(one_river("C", 0.008, 1.5, 120.0).stations.falls)
