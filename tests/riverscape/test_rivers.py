"""Rivers of a network with their water: what the beds hand on to it, scenes in files, and whole DEMs."""

import numpy as np
import pytest
from river_scenes import junction, one_river

import warpriver as wr
from warpriver.errors import InputError
from warpriver.landscape import SectionTable
from warpriver.riverscape import TYPES, Course, Riverscape, read_riverscape, unit_sections


@pytest.fixture(scope="module")
def scene():
    return junction(("A", "C", "C"))


def test_courses_carry_what_stations_do(scene):
    stations = scene.stations
    courses = scene.rivers.courses()
    assert len(courses) == stations.wet.sum()
    for k, course in zip(np.flatnonzero(stations.wet), courses, strict=True):
        part = slice(stations.start[k], stations.start[k + 1])
        assert course.channel_type == TYPES[stations.type[k]]
        # The area of a section by its table of places, and with it the discharge, are those of the template.
        np.testing.assert_allclose(course.discharge[[0, -1]], stations.flow[part][[0, -1]], rtol=2e-3)
        level = np.asarray(course.level)
        falls = np.asarray(course.falls)
        drop = level[falls] - level[falls + 1]
        own = stations.falls.course == k
        np.testing.assert_allclose(drop, stations.falls.drop[own], atol=1e-12)
    assert any(len(np.asarray(c.falls)) for c in courses)


def test_water_lies_in_the_bed(scene):
    stations = scene.stations
    wet = stations.wet[stations.station_course]
    # Off the falls, over which waves reach.
    calm = stations.slope[wet] < 0.02
    xy = stations.xy[wet][calm]
    water = scene.water(xy, 1.5)
    assert (water.elevation > scene.bed(xy, rocks=False)).mean() > 0.99
    off = np.abs(water.elevation - stations.water[wet][calm])
    assert np.median(off) < 0.02 and np.percentile(off, 95) < 0.2
    middle = water.velocity @ np.ones(2)
    assert np.isfinite(middle).all() and (np.hypot(*water.velocity.T) > 0.05).mean() > 0.95


def test_scenes_come_back_from_files_to_the_bit(scene, tmp_path):
    scene.save(tmp_path / "a.json")
    again = read_riverscape(tmp_path / "a.json")
    xy = scene.stations.xy[::5] + 0.3
    assert np.array_equal(again.bed(xy), scene.bed(xy))
    assert np.array_equal(again.water(xy, 2.0).elevation, scene.water(xy, 2.0).elevation)
    assert again.bed_at(xy).material.shape == (len(xy), 4)


def test_rocks_of_the_bed_are_those_of_the_water():
    scene = one_river("A", 0.06, 1.0, 60.0)
    rocks = scene.courses.rocks
    assert len(rocks) == len(scene.stations.rocks.xy)
    centers = np.array([rock.center for rock in rocks])
    np.testing.assert_allclose([rock.top for rock in rocks], scene.bed(centers), atol=1e-12)
    assert (scene.bed(centers) >= scene.bed(centers, rocks=False)).all()


def test_courses_of_ones_own_have_no_types():
    ground = wr.generate.tilted_plain((20, 30), 5.0, 0.01)
    x = np.linspace(20.0, 120.0, 30)
    course = Course(np.column_stack([x, 50.0 + 0.0 * x]), 1.0 - 0.005 * x, 4.0, 0.5, 1.0)
    own = Riverscape(ground, [course])
    assert own.types is None and own.network is None
    bed = own.bed_at([(50.0, 50.0), (50.0, 20.0)])
    assert bed.depth[0] == pytest.approx(0.5) and bed.depth[1] == 0.0 and bed.material[0].sum() == pytest.approx(1.0)
    with pytest.raises(InputError, match="types and flow are those of a network"):
        Riverscape(ground, [course], "C")


def test_templates_serve_rivers_that_are_carved_into_a_landscape():
    """The same section of unit area in ``wr.carve``: what is cut across a straight river has the area of its water."""
    ground = wr.generate.tilted_plain((60, 120), 1.0, 0.004)
    x = np.linspace(5.0, 115.0, 60)
    kind, width = TYPES.index("E"), 8.0
    unit = unit_sections()
    scale = width / unit.width[kind]
    depth = scale * unit.depth[kind].max()
    network = wr.RiverNetwork.from_polylines([np.column_stack([x, 30.0 + 0.0 * x])], width=width, depth=depth)
    row = np.full(network.point_count, kind)
    carved = wr.carve(ground, network, sections=SectionTable(unit.depth, row))
    cut = (ground.to_numpy() - carved.terrain.to_numpy())[:, 60]
    # In cells of an eighth of the width; banks and the depth of the water below the ground add to it.
    assert scale**2 * 0.95 < cut.sum() < scale**2 * 2.0
