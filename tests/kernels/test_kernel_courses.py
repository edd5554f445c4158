"""``survey_places`` and ``carve_places`` against closed forms and a search in NumPy."""

import numpy as np
import pytest
import reference_riverscape as reference

from warpriver.riverscape.courses import Course, CourseMap, Rock
from warpriver.terrain import Terrain


def straight(y=0.0, level=10.0, width=4.0, depth=0.5):
    x = np.linspace(0.0, 40.0, 21)
    return Course(np.column_stack([x, 0.0 * x + y]), level - 0.01 * x, width, depth, 0.8)


def test_a_straight_course_is_known_in_closed_form(device):
    courses = CourseMap([straight()], device=device)
    y = np.array([0.0, 1.0, -1.0, 1.9, 2.5])
    found = courses.survey(np.column_stack([np.full(5, 13.3), y]))
    np.testing.assert_allclose(found.level, 10.0 - 0.133, rtol=1e-12)
    np.testing.assert_allclose(found.gradient, [[-0.01, 0.0]] * 5, atol=1e-12)
    np.testing.assert_allclose(found.across, y / 2.0, atol=1e-12)
    np.testing.assert_allclose(found.along, 13.3, rtol=1e-12)
    # A parabola, of which the table holds 33 places: a chord lies (1/32)^2 of the depth below it at most.
    np.testing.assert_allclose(found.depth[:4], 0.5 * (1.0 - (y[:4] / 2.0) ** 2), atol=0.5 / 32.0**2)
    assert found.depth[4] < 0.0
    # u ~ d^(2/3), so that the integral of u d is speed times area: of a parabola 0.8 * (2/3) / mean of (1-x^2)^(5/3).
    x = np.linspace(-1.0, 1.0, 200_001)
    peak = 0.8 * (2.0 / 3.0) / ((1.0 - x**2) ** (5.0 / 3.0)).mean()
    np.testing.assert_allclose(found.velocity[0], [peak, 0.0], rtol=2e-3, atol=1e-12)
    np.testing.assert_allclose(found.velocity[1, 0], peak * 0.75 ** (2.0 / 3.0), rtol=2e-3)


def test_the_discharge_is_that_of_the_velocities(device):
    """The integral of u d across is phi within 0.5 %."""
    course = straight()
    courses = CourseMap([course], device=device)
    y = np.linspace(-2.0, 2.0, 4001)
    found = courses.survey(np.column_stack([np.full(len(y), 20.0), y]))
    discharge = np.trapezoid(found.velocity[:, 0] * found.depth, y)
    assert discharge == pytest.approx(course.discharge[10], rel=0.005)


def test_the_nearest_place_is_that_of_a_search_over_all_segments(device):
    rng = np.random.default_rng(4)
    s = np.linspace(0.0, 60.0, 151)
    bend = np.column_stack([s, 6.0 * np.sin(s / 7.0)])
    courses = CourseMap([Course(bend, 5.0 - 0.01 * s, 3.0, 0.3, 0.5)], device=device)
    places = bend[rng.integers(0, 151, 300)] + rng.normal(0.0, 1.2, (300, 2))
    found = courses.survey(places)
    near = found.point >= 0
    assert near.mean() > 0.9
    for place, across, along in zip(places[near], found.across[near], found.along[near], strict=True):
        distance, arc = reference.nearest_on_line(bend, place)
        assert abs(across) * 1.5 == pytest.approx(distance, abs=1e-9)
        assert along == pytest.approx(arc, abs=1e-6)


def test_the_lowest_bed_of_several_courses_counts(device):
    """Where threads meet the bed is the lower one of both."""
    deep, shallow = straight(0.0, depth=0.6), straight(1.5, depth=0.2)
    places = np.column_stack([np.full(50, 20.0), np.linspace(-2.5, 4.0, 50)])
    ground = Terrain(np.full((20, 60), 30.0), 1.0, (-10.0, 10.0), device=device)
    both, *single = (CourseMap(c, device=device).bed(places, ground) for c in ([deep, shallow], [deep], [shallow]))
    np.testing.assert_allclose(both, np.minimum(*single), atol=1e-12)


def test_nothing_is_raised_and_far_away_nothing_changes(device):
    rng = np.random.default_rng(0)
    ground = Terrain(9.7 + 0.5 * rng.random((40, 60)), 1.0, (-10.0, 20.0), device=device)
    courses = CourseMap([straight()], device=device)
    places = rng.uniform((-9.0, -19.0), (49.0, 19.0), (4000, 2))
    bed = courses.bed(places, ground)
    plain = CourseMap([straight(y=500.0)], device=device).bed(places, ground)
    # The two maps have origins of their own: rounding.
    assert (bed <= plain + 1e-9).all()
    far = np.abs(places[:, 1]) > 2.0 * 1.5 + 6.0 * 0.5 + 1.0
    np.testing.assert_allclose(bed[far], plain[far], rtol=0.0, atol=1e-9)


def test_the_ground_between_cells_is_cubic(device):
    """Catmull-Rom cubics reproduce a quadratic surface."""
    x, y = np.meshgrid(np.arange(30) + 0.5, 20.0 - np.arange(20) - 0.5)
    height = 100.0 + 0.02 * x**2 - 0.03 * x * y + 0.01 * y**2
    ground = Terrain(height, 1.0, (0.0, 20.0), device=device)
    courses = CourseMap([straight(y=500.0)], device=device)
    places = np.random.default_rng(1).uniform((3.0, 3.0), (27.0, 17.0), (200, 2))
    p, q = places.T
    np.testing.assert_allclose(courses.bed(places, ground), 100.0 + 0.02 * p**2 - 0.03 * p * q + 0.01 * q**2, atol=1e-9)


def test_a_rock_stands_on_the_bed(device):
    ground = Terrain(np.full((20, 60), 30.0), 1.0, (-10.0, 10.0), device=device)
    courses = CourseMap([straight()], rocks=[Rock((20.0, 0.0), 0.8, 10.1)], device=device)
    bed = courses.bed([[20.0, 0.0], [20.2, 0.0], [21.0, 0.0]], ground)
    assert bed[0] == pytest.approx(10.1)
    assert bed[1] == pytest.approx(10.1 - 0.28 * (1.0 - np.sqrt(1.0 - 0.25)))
    assert bed[2] == courses.bed([[21.0, 0.0]], ground, rocks=False)[0]


def test_a_fall_is_level_above_and_below(device):
    x = np.array([0.0, 5.0, 9.9, 10.1, 15.0, 20.0])
    course = Course(np.column_stack([x, 0.0 * x]), [5.0, 5.0, 5.0, 4.6, 4.6, 4.6], 2.0, 0.3, 0.5, "A", falls=[2])
    found = CourseMap([course], device=device).survey([[9.95, 0.0], [10.05, 0.0], [7.0, 0.5]])
    np.testing.assert_allclose(found.level, [5.0, 4.6, 5.0])
    np.testing.assert_allclose(found.gradient, 0.0, atol=1e-12)
