"""Which primitives the water of a river gets: the document's Table 1, cover, kinds, and what a seed decides."""

import numpy as np
import pytest

from warpriver.kernels import flow_tree
from warpriver.riverscape import Course, CourseMap, Merge, Primitives, Replace, Rock, SeedingParams, example, seed_water

# Primitives of the water in the document's Table 1, at one every 50 cm.
TABLE = {"A": 520, "C": 754, "D": 1270}


def rows_of(tree):
    """All primitives of a tree."""
    if isinstance(tree, Replace):
        return Primitives.concatenate([rows_of(tree.under), rows_of(tree.over)])
    if isinstance(tree, Merge):
        return Primitives.concatenate([rows_of(child) for child in tree.children])
    return tree


def body_of(tree):
    """The layer below all others."""
    while isinstance(tree, Replace):
        tree = tree.under
    return tree


@pytest.fixture(scope="module")
def scenes(device):
    made = {name: example(name) for name in TABLE}
    return {name: (s, CourseMap(s.courses, rocks=s.rocks, device=device)) for name, s in made.items()}


@pytest.mark.parametrize("name", TABLE)
def test_as_many_primitives_as_in_the_documents_table(name, scenes):
    scene, courses = scenes[name]
    assert len(rows_of(seed_water(courses, 0.5, 0))) == pytest.approx(TABLE[name], rel=0.3)
    assert scene.courses[0].length == pytest.approx({"A": 63.0, "C": 76.0, "D": 60.0}[name], rel=0.07)


@pytest.mark.parametrize("name", TABLE)
def test_all_water_is_covered_and_merged_weights_are_between_a_half_and_one(name, scenes):
    """At most four of a level reach a place; where levels meet there may be more."""
    _, courses = scenes[name]
    body = body_of(seed_water(courses, 0.5, 0))
    west, south, east, north = courses.bounds
    places = np.random.default_rng(0).uniform((west, south), (east, north), (20_000, 2))
    found = courses.survey(places)
    places = places[(found.point >= 0) & (found.depth > 0.01)][:1500]
    off = places[:, None, :] - body.center
    inside = 1.0 - (off**2).sum(axis=2) / body.radius**2
    weight = np.where(inside > 0.0, inside, 0.0) ** 3
    assert (weight.sum(axis=1) > 0.05).all()
    assert (weight.sum(axis=1) > 0.45).mean() > 0.9 and weight.sum(axis=1).max() < 2.0
    for radius in np.unique(body.radius):
        assert ((weight > 0.0) & (body.radius == radius)).sum(axis=1).max() <= 4


def straight(slope, speed, depth, kind="C", **rest):
    x = np.linspace(0.0, 60.0, 121)
    return Course(np.column_stack([x, 0.0 * x]), 3.0 - slope * x, 8.0, depth, speed, kind, **rest)


def test_spacing_follows_the_speed(device):
    """h = h0 sqrt(1 m/s / u), by powers of two, from h0/2 to 4 h0 and at most a quarter of the width."""
    for speed, spacing in ((0.05, 2.0), (0.25, 1.0), (1.0, 0.5), (5.0, 0.25)):
        body = body_of(seed_water(CourseMap([straight(0.01, speed, 0.5)], device=device), 0.5, 0))
        assert set(body.radius) == {spacing}


def test_kinds_follow_the_froude_number(device):
    """On a wide straight: below 0.2 calm, below 0.45 rippling, above turbulent; the middle is rougher than the rims."""
    kinds = {}
    for froude in (0.05, 0.25, 0.9):
        speed = froude * np.sqrt(9.81 * 0.5)
        body = body_of(seed_water(CourseMap([straight(0.01, speed, 0.5, "B")], device=device), 0.5, 0))
        middle = np.abs(body.center[:, 1]) < 2.0
        kinds[froude] = set(body.kind[middle])
    assert kinds[0.05] == {flow_tree.CALM} and kinds[0.9] == {flow_tree.TURBULENT}
    assert flow_tree.RIPPLE in kinds[0.25]


def test_bends_are_rough_where_deep_and_calm_where_shallow(scenes):
    _, courses = scenes["C"]
    body = body_of(seed_water(courses, 0.5, 0))
    found = courses.survey(body.center)
    bent = np.abs(courses.joined("curvature") * courses.joined("width"))[found.point] > 0.3
    share = found.depth / courses.joined("depth")[found.point]
    calm = np.isin(body.kind, (flow_tree.CALM, flow_tree.ECHO))
    assert calm[bent & (share < 0.3)].mean() > 0.9
    assert calm[bent & (share > 0.8)].mean() < 0.3


def test_behind_a_fall_waves_and_foam_fade(device):
    x = np.concatenate([np.arange(0.0, 20.0, 0.5), [19.95, 20.05], np.arange(20.5, 60.0, 0.5)])
    course = Course(np.column_stack([x, 0.0 * x]), np.where(x < 20.0, 5.0, 4.5), 4.0, 0.6, 0.4, "A", falls=[40])
    courses = CourseMap([course], device=device)
    body = body_of(seed_water(courses, 0.5, 0))
    middle = np.abs(body.center[:, 1]) < 0.6
    falls = body.kind == flow_tree.CASCADE
    assert falls.any() and (np.abs(body.center[falls, 0] - 20.0) <= body.radius[falls]).all()
    along, foam, height = body.center[:, 0], body.effervescence, body.amplitude
    near, mid, far = (middle & ~falls & (along > a) & (along < b) for a, b in ((21, 23), (25, 28), (45, 60)))
    above = middle & ~falls & (along < 19.0)
    assert foam[near].mean() > 1.5 * foam[mid].mean() > 3.0 * foam[far].mean()
    assert height[near].mean() > 1.5 * height[far].mean()
    assert foam[above].max() < 0.1
    # Levels agree on both sides of the lip.
    assert body.level[falls] == pytest.approx(4.75) and body.shape[falls, 0] == pytest.approx(0.5)


def test_behind_a_rock_a_pair_of_vortices_turns_against_each_other(device):
    courses = CourseMap([straight(0.01, 1.0, 0.5)], rocks=[Rock((30.0, 0.0), 0.8, 3.0)], device=device)
    rows = rows_of(seed_water(courses, 0.5, 0))
    pair = rows[rows.kind == flow_tree.VORTEX]
    assert len(pair) == 2 and (pair.center[:, 0] > 30.4).all()
    np.testing.assert_allclose(pair.radius, 1.2 * 0.8)
    speed = courses.survey([[30.0, 0.0]]).velocity[0, 0]
    left, right = np.argsort(-pair.center[:, 1])
    # Behind the rock the water turns back: to the right on its left side.
    np.testing.assert_allclose(pair.shape[[left, right], 1], [-speed / 0.96, speed / 0.96])


def test_a_seed_decides_and_places_far_from_a_change_keep_their_bits(device):
    before = seed_water(CourseMap([straight(0.01, 0.8, 0.5)], device=device), 0.5, 0)
    again = seed_water(CourseMap([straight(0.01, 0.8, 0.5)], device=device), 0.5, 0)
    other = seed_water(CourseMap([straight(0.01, 0.8, 0.5)], device=device), 0.5, 1)
    a, b, c = (body_of(tree) for tree in (before, again, other))
    np.testing.assert_array_equal(a.offset, b.offset)
    assert (a.offset != c.offset).mean() > 0.99
    # The same reach that ends 20 m earlier.
    x = np.linspace(0.0, 40.0, 81)
    short = Course(np.column_stack([x, 0.0 * x]), 3.0 - 0.01 * x, 8.0, 0.5, 0.8)
    d = body_of(seed_water(CourseMap([short], device=device), 0.5, 0))
    rows = [
        {(*p, o) for p, o in zip(each.center.tolist(), each.offset.tolist(), strict=True) if p[0] < 35.0}
        for each in (a, d)
    ]
    assert rows[0] == rows[1]


def test_livelier_water_has_higher_waves(device):
    courses = CourseMap([straight(0.01, 0.8, 0.5)], device=device)
    flat, high = (
        body_of(seed_water(courses, 0.5, 0, SeedingParams(liveliness=factor))).amplitude for factor in (0.0, 2.0)
    )
    assert flat.max() == 0.0 and high.min() > 0.0
