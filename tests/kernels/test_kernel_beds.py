"""River beds in both precisions: evaluate_points, evaluate_cells, sample_ground, locate_points, list_cells."""

import numpy as np
import pytest
import reference_beds as twin
from river_scenes import junction, one_river

from warpriver.riverscape.beds import Beds
from warpriver.riverscape.templates import BEND_TABLE, FORM_TABLE, LANES

# Heights in m. Places are within 500 m of their zero, so that in float32 they are known to 3e-5 m, on steep beds.
TOLERANCE = {"float64": 2e-6, "float32": 1e-3}


@pytest.fixture(scope="module")
def scenes(device):
    return [one_river("A", 0.07, 1.5, 60.0, device=device), junction(device=device)]


def around(scene, count):
    random = np.random.default_rng(1)
    k = random.integers(0, len(scene.stations.along), count)
    return scene.stations.xy[k] + random.normal(0.0, 1.5, (count, 2)) * scene.stations.width[k][:, None]


def test_evaluate_points_and_sample_ground_are_those_of_the_twin(scenes, dtype):
    for scene in scenes:
        beds, xy = Beds(scene.terrain, scene.stations, dtype), around(scene, 60)
        found, base = beds.heights(xy)
        height, (west, north) = scene.terrain.to_numpy(), scene.terrain.origin
        ground = [twin.bicubic(height, scene.terrain.cell_size, west, north, p) for p in xy]
        np.testing.assert_allclose(base, ground, atol=TOLERANCE[dtype])
        tables = (FORM_TABLE, BEND_TABLE, LANES)
        expected = [twin.bed_height(scene.stations, beds.limits, p, b, tables) for p, b in zip(xy, ground, strict=True)]
        np.testing.assert_allclose(found, expected, atol=TOLERANCE[dtype])
        assert (found < base - 0.05).mean() > 0.2


def test_evaluate_cells_gives_what_evaluate_points_does(scenes, dtype):
    scene = scenes[1]
    beds = Beds(scene.terrain, scene.stations, dtype)
    cells = beds.raster(1.0, 200.0, 140.0, (40, 60)).numpy()
    xy = np.stack(np.meshgrid(200.5 + np.arange(60), 139.5 - np.arange(40)), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(cells.ravel(), beds.heights(xy)[0], atol=1e-12)


def test_locate_points_finds_stations_and_sides(scenes, dtype):
    scene = scenes[1]
    courses, beds = scene.stations, Beds(scene.terrain, scene.stations, dtype)
    k = np.arange(20, courses.start[1] - 20, 9)
    normal = np.column_stack([-courses.tangent[:, 1], courses.tangent[:, 0]])[k]
    for off in (-0.3, 0.0, 0.3):
        found = beds.locate(courses.xy[k] + off * courses.width[k][:, None] * normal)
        np.testing.assert_allclose(found.station + found.part, k, atol=1e-3)
        np.testing.assert_allclose(found.left, off * courses.width[k], atol=1e-3)
        np.testing.assert_allclose(found.edge, (abs(off) - 0.5) * courses.width[k], atol=2e-3)
    assert beds.locate(np.array([[20.0, 20.0]])).station.tolist() == [-1]


def test_list_cells_lists_every_cell_that_a_segment_reaches(scenes, dtype):
    """Whatever a segment cuts, the index knows it: places one by one against all segments at once."""
    scene = scenes[0]
    beds = Beds(scene.terrain, scene.stations, dtype)
    xy = around(scene, 3000)
    height, base = beds.heights(xy)
    tables = (FORM_TABLE, BEND_TABLE, LANES)
    uncut = np.flatnonzero(height == base)[:40]
    for p, b in zip(xy[uncut], base[uncut], strict=True):
        assert twin.bed_height(scene.stations, beds.limits, p, b, tables) == pytest.approx(b, abs=1e-5)
