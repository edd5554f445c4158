"""New courses of avulsions: how they walk, what refuses them, and the beds that they carve."""

import math

import numpy as np
import pytest

from warpriver import Terrain
from warpriver.meander.courses import Course, Refusal, carve_course, falling_bed, walk_courses
from warpriver.params import AvulsionParams

SPACING = 50.0


def trials(count, seed=0):
    """Starts, targets within 500 to 5,000 m and first directions within 45 degrees of the way, of many courses."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(0.0, 10_000.0, (count, 2))
    way = rng.uniform(-math.pi, math.pi, count)
    target = start + rng.uniform(500.0, 5000.0, count)[:, None] * np.column_stack([np.cos(way), np.sin(way)])
    first = way + rng.uniform(-2.2, 2.2, count)
    return start, target, np.column_stack([np.cos(first), np.sin(first)]), rng.integers(0, 2**32, count)


def twin(start, target, first, spacing, jitter_of):
    """The walk as the document has it, with t the distance walked over |a - b|, 1 at most."""
    line = [start]
    whole = np.hypot(*(target - start))
    while np.hypot(*(target - line[-1])) > spacing:
        off = target - line[-1]
        left = np.hypot(*off)
        t = min((len(line) - 1) * spacing / whole, 1.0)
        d = t * off / left + (1.0 - t) * first
        angle = math.atan2(d[1], d[0]) + jitter_of(len(line))
        line.append(line[-1] + spacing * np.array([math.cos(angle), math.sin(angle)]))
    return np.array([*line, target])


def test_ten_thousand_courses_all_end_within_their_steps(device):
    start, target, first, seeds = trials(10_000)
    courses = walk_courses(start, target, first, seeds, SPACING, device=device)
    refused = sum(isinstance(course, Refusal) for course in courses)
    assert refused == 0
    count = np.array([len(course.xy) for course in courses])
    xy = np.concatenate([course.xy for course in courses])
    head = np.cumsum(count) - count
    np.testing.assert_allclose(xy[head], start, atol=1e-9)
    np.testing.assert_allclose(xy[head + count - 1], target, atol=1e-9)
    assert (count - 1 <= 4.0 * np.hypot(*(target - start).T) / SPACING + 1.0).all()
    within = np.ones(len(xy) - 1, bool)
    within[head[1:] - 1] = False
    last = np.zeros(len(xy) - 1, bool)
    last[head + count - 2] = True
    length = np.hypot(*np.diff(xy, axis=0).T)
    np.testing.assert_allclose(length[within & ~last], SPACING, atol=1e-9)
    assert (length[last] <= SPACING + 1e-9).all()
    # The first step is turned by chance alone.
    step = xy[head + 1] - xy[head]
    turn = np.arctan2(first[:, 0] * step[:, 1] - first[:, 1] * step[:, 0], (first * step).sum(axis=1))
    assert np.abs(turn).max() <= math.radians(5.0) + 1e-9


def test_without_chance_the_walk_is_that_of_the_twin(device):
    start, target, first, seeds = trials(40, 3)
    courses = walk_courses(start, target, first, seeds, SPACING, AvulsionParams(jitter=0.0), device=device)
    for k, course in enumerate(courses):
        np.testing.assert_allclose(course.xy, twin(start[k], target[k], first[k], SPACING, lambda _: 0.0), atol=1e-7)


def test_turns_by_chance_are_uniform_and_belong_to_their_seeds(device):
    start, target, first, seeds = trials(300, 4)
    courses = walk_courses(start, target, first, seeds, SPACING, device=device)
    again = walk_courses(start[::-1], target[::-1], first[::-1], seeds[::-1], SPACING, device=device)[::-1]
    turns = []
    for k, course in enumerate(courses):
        np.testing.assert_allclose(course.xy, again[k].xy, atol=1e-8)
        step = np.diff(course.xy, axis=0)
        turns.append(math.atan2(first[k] @ [-step[0, 1], step[0, 0]], first[k] @ step[0]))
    # Uniform within 5 degrees: a deviation of 5 / sqrt 3, to 4 standard errors.
    assert np.std(turns) == pytest.approx(math.radians(5.0) / math.sqrt(3.0), rel=4.0 / math.sqrt(2.0 * 300))


def plane(slope, rows=80, columns=120, cell=50.0, step=0.0):
    """Ground that falls to the east, with a step up halfway; outside there is none."""
    x = (np.arange(columns) + 0.5) * cell
    height = 100.0 - slope * x + np.where(x > 0.5 * columns * cell, step, 0.0)
    return Terrain(np.broadcast_to(height, (rows, columns)), cell, (0.0, rows * cell))


def east(terrain, params=None, start=(500.0, 2000.0), target=(5000.0, 2000.0)):
    return walk_courses([start], [target], [(1.0, 0.0)], [7], SPACING, params, terrain)[0]


def test_falling_ground_needs_nothing_and_rises_are_carved_or_refused():
    fallen = east(plane(0.01))
    assert isinstance(fallen, Course) and fallen.deepest_cut == 0.0
    np.testing.assert_array_equal(fallen.bed, fallen.ground)
    # A step of 2 m between two cells is 0.04 m/m; of 8 m it is 0.08 at least where a step of the walk has half of it.
    carved = east(plane(0.001, step=2.0))
    assert isinstance(carved, Course) and 1.5 < carved.deepest_cut < 2.1
    assert (np.diff(carved.bed) < 0.0).all() and (carved.bed <= carved.ground).all()
    steep = east(plane(0.001, step=8.0))
    assert isinstance(steep, Refusal) and steep.reason == "the ground rises by more than 0.05 m/m"
    assert steep.xy[0] == pytest.approx(3000.0, abs=SPACING)
    assert isinstance(east(plane(0.001, step=8.0), AvulsionParams(steepest_rise=0.17)), Course)
    beyond = east(plane(0.001), target=(9000.0, 2000.0))
    assert isinstance(beyond, Refusal) and beyond.reason == "there is no ground"


def test_a_walk_that_begins_the_wrong_way_arrives():
    away = np.array([[-1.0, 1e-3]])
    found = walk_courses([(0.0, 0.0)], [(1000.0, 0.0)], away, [0], SPACING, AvulsionParams(jitter=0.0))[0]
    assert isinstance(found, Course) and len(found.xy) * SPACING < 4000.0


def test_the_bed_is_the_highest_that_falls():
    rng = np.random.default_rng(1)
    xy = np.cumsum(rng.uniform(10.0, 60.0, (60, 2)), axis=0)
    ground = 50.0 - np.arange(60) * 0.2 + rng.normal(0.0, 1.0, 60)
    bed = falling_bed(xy, ground, 1e-3)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    brute = np.array([min(ground[k] - 1e-3 * (s[i] - s[k]) for k in range(i + 1)) for i in range(60)])
    np.testing.assert_allclose(bed, brute, atol=1e-12)


def test_carving_lowers_the_width_and_blends_to_twice_it(device):
    terrain = plane(0.0).to(device)
    before = terrain.to_numpy()
    xy = np.array([[500.0, 2000.0], [3000.0, 2400.0], [5000.0, 1200.0]])
    carve_course(terrain, xy, np.array([99.0, 97.0, 96.0]), 300.0)
    after = terrain.to_numpy()
    rows, columns = np.indices(after.shape)
    place = np.stack([(columns + 0.5) * 50.0, 4000.0 - (rows + 0.5) * 50.0], axis=-1).reshape(-1, 2)
    shapely = pytest.importorskip("shapely")
    distance = shapely.distance(shapely.LineString(xy), shapely.points(place)).reshape(after.shape)
    np.testing.assert_array_equal(after[distance >= 300.0], before[distance >= 300.0])
    line = shapely.LineString(xy)
    inside = distance <= 150.0
    at = np.array([line.project(shapely.Point(p)) for p in place[inside.ravel()]])
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    np.testing.assert_allclose(after[inside], np.interp(at, s, [99.0, 97.0, 96.0]), atol=1e-9)
    assert (after <= before).all()
    higher = plane(0.0)
    carve_course(higher, xy, np.full(3, 101.0), 300.0)
    np.testing.assert_array_equal(higher.to_numpy(), before)
