"""Beds of courses of one's own: their sections, several of them, rocks and logs."""

import numpy as np
import pytest

from warpriver.riverscape import Course, Log, Riverscape, Rock
from warpriver.riverscape.beds import Beds
from warpriver.riverscape.given import given_stations, mounds_of
from warpriver.terrain import Terrain


def straight(y=0.0, level=10.0, width=4.0, depth=0.5, **rest):
    x = np.linspace(0.0, 40.0, 21)
    return Course(np.column_stack([x, 0.0 * x + y]), level - 0.01 * x, width, depth, 0.8, **rest)


def level_ground(device, height=10.2):
    return Terrain(np.full((40, 60), height), 1.0, (-10.0, 20.0), device=device)


def test_sections_are_those_of_the_course(device):
    """A form of its own at each point, between which it goes over evenly."""
    x = np.linspace(0.0, 40.0, 21)
    y = np.linspace(1.0, -1.0, 33)
    form = np.stack([(1.0 - y**2) ** (1.0 + 0.1 * k) for k in range(21)])
    scene = Riverscape(level_ground(device), [straight(form=form)], device=device)
    across = np.linspace(-1.9, 1.9, 9)
    for k in (4, 7):
        for part in (0.0, 0.25):
            at = np.column_stack([np.full(9, x[k] + 2.0 * part), across])
            depth = 10.0 - 0.01 * at[:, 0] - scene.bed(at)
            mixed = (1.0 - part) * form[k] + part * form[k + 1]
            # The rim is rounded where what is cut is as small as its softness, 0.06 m.
            np.testing.assert_allclose(depth, 0.5 * np.interp(across / 2.0, -y, mixed), atol=1e-9)


def test_the_lowest_bed_of_several_courses_counts(device):
    """Where threads meet the bed is the lower one of both."""
    deep, shallow = straight(0.0, depth=0.6), straight(1.5, depth=0.2)
    places = np.column_stack([np.full(50, 20.0), np.linspace(-2.5, 4.0, 50)])
    both, *single = (Riverscape(level_ground(device), c).bed(places) for c in ([deep, shallow], [deep], [shallow]))
    np.testing.assert_allclose(both, np.minimum(*single), atol=1e-12)


def test_nothing_is_raised_and_far_away_nothing_changes(device):
    rng = np.random.default_rng(0)
    ground = Terrain(9.7 + 0.5 * rng.random((40, 60)), 1.0, (-10.0, 20.0), device=device)
    places = rng.uniform((-9.0, -19.0), (49.0, 19.0), (4000, 2))
    scene = Riverscape(ground, [straight()])
    bed, base = scene.rivers.beds.heights(places)
    assert (bed <= base).all()
    far = np.abs(places[:, 1]) > 2.0 + scene.stations.reach.max()
    assert far.any()
    np.testing.assert_array_equal(bed[far], base[far])


def test_a_rock_stands_as_high_as_it_is_said(device):
    scene = Riverscape(level_ground(device), [straight()], rocks=[Rock((20.0, 0.0), 0.8, 10.1)])
    bed = scene.bed([[20.0, 0.0], [20.2, 0.0], [21.0, 0.0]])
    # A mound (1 - r^4)^2 over the bed.
    floor = scene.bed([[20.0, 0.0], [20.2, 0.0], [21.0, 0.0]], rocks=False)
    assert bed[0] == pytest.approx(10.1, abs=1e-6)
    assert bed[1] == pytest.approx(floor[1] + (10.1 - floor[1]) * (1.0 - 0.5**4) ** 2, abs=1e-6)
    assert bed[2] == floor[2]


def test_a_log_is_level_along_its_upper_side(device):
    """Its mounds are half a radius apart: within 2 % of its height; beside it the bed is as before."""
    ground, course = level_ground(device, 11.0), straight()
    bare = given_stations(ground, [course])
    log = Log((15.0, -1.2), (16.5, 1.2), 0.4, 10.05)
    beds = Beds(ground, bare, obstacles=mounds_of([log]))
    part = np.linspace(0.02, 0.98, 60)[:, None]
    along = (1.0 - part) * np.array(log.start) + part * np.array(log.end)
    top, floor = beds.heights(along)[0], beds.heights(along, rocks=False)[0]
    # Half way between two centres a mound is 0.05 % lower than at them.
    np.testing.assert_allclose(top, 10.05, atol=0.0006 * np.max(10.05 - floor))
    assert (top > floor + 0.2).all()
    aside = along + (0.21, -0.21 * 1.5 / 2.4)
    np.testing.assert_allclose(beds.heights(aside)[0], beds.heights(aside, rocks=False)[0], atol=0.02)


def test_a_rock_on_the_bank_stands_on_the_ground(device):
    """Beside the river, and far away from it."""
    rocks = [Rock((20.0, 8.0), 1.0, 10.7), Rock((45.0, 15.0), 1.0, 10.5)]
    scene = Riverscape(level_ground(device), [straight()], rocks=rocks)
    at = [rock.center for rock in rocks]
    np.testing.assert_allclose(scene.bed(at), [10.7, 10.5], atol=1e-9)
    np.testing.assert_allclose(scene.bed(at, rocks=False), 10.2, atol=1e-9)
