"""``survey_places`` against closed forms and a search in NumPy."""

import numpy as np
import pytest
import reference_riverscape as reference

from warpriver.riverscape.courses import Course, CourseMap


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


def test_a_fall_is_level_above_and_below(device):
    x = np.array([0.0, 5.0, 9.9, 10.1, 15.0, 20.0])
    course = Course(np.column_stack([x, 0.0 * x]), [5.0, 5.0, 5.0, 4.6, 4.6, 4.6], 2.0, 0.3, 0.5, "A", falls=[2])
    found = CourseMap([course], device=device).survey([[9.95, 0.0], [10.05, 0.0], [7.0, 0.5]])
    np.testing.assert_allclose(found.level, [5.0, 4.6, 5.0])
    np.testing.assert_allclose(found.gradient, 0.0, atol=1e-12)


def test_two_maps_of_one_frame_give_the_same_bits(device):
    """Whatever else there is in them."""
    one = CourseMap([straight()], device=device)
    places = np.random.default_rng(2).uniform((0.0, -3.0), (40.0, 3.0), (400, 2))
    other = straight(y=-70.0, width=20.0)
    two = CourseMap([straight(), other], frame=one.frame, device=device)
    for a, b in ((getattr(one.survey(places), n), getattr(two.survey(places), n)) for n in ("level", "depth", "along")):
        np.testing.assert_array_equal(a, b)
