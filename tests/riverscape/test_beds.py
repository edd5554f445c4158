"""Beds: their twin in NumPy, the ground around them, water in its banks, discharge, and what is refused."""

import dataclasses

import numpy as np
import pytest
import reference_beds as twin
from data_folder import data_folder
from river_scenes import junction, one_river, valley_floor

import warpriver as wr
from warpriver.errors import InputError, OutOfMemoryError
from warpriver.riverscape import BedParams, ProfileParams, Riverscape
from warpriver.riverscape.beds import MATERIALS
from warpriver.riverscape.templates import BEND_TABLE, FORM_TABLE, LANES, section_depth

TABLES = (FORM_TABLE, BEND_TABLE, LANES)
SCENES = {
    "A": lambda device: one_river("A", 0.07, 1.5, 60.0, device=device),
    "C": lambda device: one_river("C", 0.008, 0.3, 150.0, device=device),
    "D": lambda device: one_river("D", 0.012, 6.0, 120.0, device=device),
    "junction": lambda device: junction(device=device),
}
# Tangent of 35 degrees; sections and rocks are steeper: the banks alone are held against it.
BANK = np.tan(np.radians(35.0))


@pytest.fixture(scope="module")
def scenes(device):
    return {name: make(device) for name, make in SCENES.items()}


def places(scene, count, seed=0, spread=2.0):
    """Places on and beside the courses, up to some widths away."""
    random = np.random.default_rng(seed)
    courses = scene.stations
    k = random.integers(0, len(courses.along), count)
    return courses.xy[k] + random.normal(0.0, spread, (count, 2)) * courses.width[k][:, None]


@pytest.mark.parametrize("name", SCENES)
def test_beds_are_those_of_the_twin(scenes, name):
    scene = scenes[name]
    xy = places(scene, 150)
    found, base = scene.rivers.beds.heights(xy)
    limits = scene.rivers.beds.limits
    expected = [twin.bed_height(scene.stations, limits, p, b, TABLES) for p, b in zip(xy, base, strict=True)]
    assert 0.2 < (found < base - 1e-6).mean() < 0.95
    # The twin integrates the slope of banks numerically.
    np.testing.assert_allclose(found, expected, atol=2e-6, rtol=0.0)


def test_the_base_is_bicubic(scenes):
    scene = scenes["C"]
    ground = scene.terrain
    xy = np.random.default_rng(1).uniform([15.0, 15.0], [485.0, 225.0], (60, 2))
    height, (west, north) = ground.to_numpy(), ground.origin
    expected = [twin.bicubic(height, ground.cell_size, west, north, p) for p in xy]
    np.testing.assert_allclose(scene.rivers.beds.heights(xy)[1], expected, atol=1e-9)


@pytest.mark.parametrize("name", SCENES)
def test_nothing_is_raised_and_ground_away_from_rivers_stays(scenes, name):
    scene = scenes[name]
    xy = np.random.default_rng(2).uniform([20.0, 20.0], [480.0, 220.0], (20000, 2))
    bed, base = scene.rivers.beds.heights(xy)
    assert (bed <= base).all()
    courses = scene.stations
    far = 0.5 * courses.width + courses.reach
    away = np.min(np.hypot(*(xy[:, None] - courses.xy[None, ::4]).transpose(2, 0, 1)) - far[::4], axis=1) > 2.0
    assert away.mean() > 0.2 and np.array_equal(bed[away], base[away])
    assert (bed[~away] < base[~away]).any()


@pytest.mark.parametrize("name", ["C", "D", "junction"])
def test_banks_are_no_steeper_than_35_degrees(scenes, name):
    """By steps of 2 cm; beside steps of the water banks have faces as well, at a few places in a thousand."""
    scene = scenes[name]
    xy, step = places(scene, 30000, 3), 0.02
    located = scene.rivers.beds.locate(xy)
    height = scene.rivers.beds.heights(xy)[0]
    slope = np.hypot(*[(scene.rivers.beds.heights(xy + step * e)[0] - height) / step for e in np.eye(2)])
    slope = np.nan_to_num(slope)  # beyond the terrain
    bank = located.edge > 0.05
    assert bank.mean() > 0.3 and np.percentile(slope[bank], 99.5) < BANK + 0.05
    # Sections: half a bed's depth over a tenth of its width, about vertical for a semicircle alone.
    assert slope.max() < 6.0


@pytest.mark.parametrize("name", SCENES)
def test_water_lies_above_the_bed_and_below_its_banks(scenes, name):
    scene = scenes[name]
    courses = scene.stations
    wet = courses.wet[courses.station_course]
    bed = scene.bed_at(courses.xy[wet])
    # Rocks stand out of the water here and there.
    assert (bed.depth > 0.0).mean() > {"A": 0.93, "junction": 0.98}.get(name, 0.999)
    normal = np.column_stack([-courses.tangent[:, 1], courses.tangent[:, 0]])[wet]
    for sign in (-1.0, 1.0):
        edge = courses.xy[wet] + sign * (0.5 * courses.width[wet] + 0.02)[:, None] * normal
        bank = scene.rivers.beds.heights(edge)[0] - courses.water[wet]
        # Where courses lie side by side the bank of one is in the water of the other.
        inside = scene.rivers.beds.locate(edge).edge < 0.0
        steps = name == "A"  # at the lip of a step its section cuts into the pool's bank
        assert (bank[~inside] > -0.01).mean() > (0.75 if steps else 0.97)


@pytest.mark.parametrize("name", SCENES)
def test_the_water_below_the_lowest_ground_between_the_banks(scenes, name):
    """It cannot hang on a side slope: from bank to bank nothing of the ground is below it."""
    courses = scenes[name].stations
    normal = np.column_stack([-courses.tangent[:, 1], courses.tangent[:, 0]])
    for part in (-0.45, -0.2, 0.0, 0.2, 0.45):
        base = scenes[name].rivers.beds.heights(courses.xy + part * courses.width[:, None] * normal)[1]
        wet = courses.wet[courses.station_course]
        assert (base[wet] > courses.water[wet]).all()


@pytest.mark.parametrize("name", ["A", "C"])
def test_the_water_carries_its_discharge(scenes, name):
    """The integral of u d across sections, by places 1/200 of the width apart, away from what lies on the bed."""
    scene = scenes[name]
    courses = scene.stations
    k = np.arange(len(courses.along) // 4, 3 * len(courses.along) // 4, 7)
    normal = np.column_stack([-courses.tangent[:, 1], courses.tangent[:, 0]])[k]
    offset = (np.arange(200) + 0.5) / 200 - 0.5
    for i, n in zip(k, normal, strict=True):
        xy = courses.xy[i] + offset[:, None] * courses.width[i] * n
        speed = np.hypot(*scene.rivers.beds.velocity(xy).T)
        share = 0.5 - offset
        one = [np.repeat(v[i : i + 1], 200, axis=0) for v in (courses.form, courses.blend, courses.lane, courses.bend)]
        depth = courses.depth[i] * section_depth(share, *one)
        total = (speed * depth).sum() * courses.width[i] / 200
        assert total == pytest.approx(courses.flow[i], rel=0.005)


def test_threads_carry_all_of_the_water_together(scenes):
    courses = scenes["D"].stations
    middle = [
        np.interp(0.5 * courses.along[b - 1], courses.along[a:b], courses.flow[a:b])
        for a, b, wet in zip(courses.start[:-1], courses.start[1:], courses.wet, strict=True)
        if wet
    ]
    assert len(middle) == 3 and sum(middle) == pytest.approx(6.0, rel=0.005)


def test_the_bed_is_the_lowest_of_its_threads(scenes):
    """Each course alone cuts no more than all together, and the deepest of them as much."""
    scene = scenes["D"]
    xy = places(scene, 400, 5, 0.6)
    xy = xy[np.abs(xy[:, 0] - 120.0) < 59.0]  # off the nodes, where all of them begin and end
    together = scene.rivers.beds.heights(xy)[0]
    alone = []
    for k in range(scene.stations.count):
        group = np.where(np.arange(scene.stations.count) == k, 0, 1)
        keep = dataclasses.replace(
            scene.stations,
            group=group,
            reach=np.where(scene.stations.station_course == k, scene.stations.reach, 1e-9),
            width=np.where(scene.stations.station_course == k, scene.stations.width, 1e-9),
        )
        alone.append(type(scene.rivers.beds)(scene.terrain, keep).heights(xy)[0])
    np.testing.assert_allclose(together, np.min(alone, axis=0), atol=1e-9)


@pytest.mark.parametrize("name", SCENES)
def test_windows_side_by_side_fit_together(scenes, name):
    scene = scenes[name]
    whole = scene.carved(0.5, (80.0, 90.0, 140.0, 150.0)).to_numpy()
    left = scene.carved(0.5, (80.0, 90.0, 110.0, 150.0)).to_numpy()
    right = scene.carved(0.5, (110.0, 90.0, 140.0, 150.0)).to_numpy()
    assert np.array_equal(whole, np.concatenate([left, right], axis=1))
    # The same places one by one.
    x, y = 80.25 + 0.5 * np.arange(120), 149.75 - 0.5 * np.arange(120)
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(whole.ravel(), scene.rivers.beds.heights(xy)[0], atol=1e-12)


@pytest.mark.parametrize("name", SCENES)
def test_there_is_no_step_across_cells_of_the_index_or_at_nodes(scenes, name):
    """Along lines with places 1 mm apart, no two heights differ by more than the steepest slope makes of it."""
    scene = scenes[name]
    xy = places(scene, 40, 7, 0.5)
    angle = np.random.default_rng(8).uniform(0.0, 2.0 * np.pi, 40)
    way = np.arange(4000) * 1e-3
    line = xy[:, None] + way[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None]
    height = scene.rivers.beds.heights(line.reshape(-1, 2))[0].reshape(40, -1)
    assert np.abs(np.diff(height, axis=1)).max() < 1e-3 * 12.0


@pytest.mark.parametrize("kinds", [("B", "A", "C"), ("A+", "G", "D"), ("E", "F", "DA")])
def test_there_is_no_seam_where_one_type_goes_over_into_the_next(kinds):
    """Lines along the main stem through its node, at some places across: heights 5 mm apart, no step in them."""
    scene = junction(kinds)
    stations = scene.stations
    node = np.array([240.0, 120.0])
    k = int(np.flatnonzero((stations.channel == 2) & (stations.thread == 0))[0])
    ahead = stations.tangent[stations.start[k]]
    left = np.array([-ahead[1], ahead[0]])
    way = np.arange(-400, 400) * 5e-3
    for off in (-0.4, -0.2, 0.0, 0.2, 0.4):
        line = node + off * stations.width[stations.start[k]] * left + way[:, None] * ahead
        height = scene.bed(line, rocks=False)
        # Steps of the water apart, whose faces are steep, nothing is steeper than a section at its banks.
        assert np.abs(np.diff(height)).max() < 5e-3 * 4.0


def test_basins_lie_in_pools_and_rocks_in_the_water(scenes):
    courses = scenes["A"].stations
    assert len(courses.basins) > 5 and len(courses.rocks) > 20
    for marks in (courses.basins, courses.rocks):
        located = scenes["A"].rivers.beds.locate(marks.xy)
        assert (located.edge < 0.0).mean() > 0.9
    flat = one_river("A", 0.07, 1.5, 60.0, bed_params=BedParams(basin_depth=0.0))
    middle = courses.basins.xy
    deeper = flat.rivers.beds.heights(middle)[0] - scenes["A"].rivers.beds.heights(middle)[0]
    assert np.median(deeper) > 0.05


def test_materials_belong_to_types_and_depths(scenes):
    rocky, winding = (scenes[n].bed_at(scenes[n].stations.xy).material for n in ("A", "C"))
    np.testing.assert_allclose(winding.sum(axis=1), 1.0)
    assert rocky[:, MATERIALS.index("rock")].mean() > 0.5 > winding[:, MATERIALS.index("rock")].max()
    away = scenes["C"].bed_at([(60.0, 30.0), (400.0, 30.0)])
    assert (away.material == 0.0).all() and (away.depth == 0.0).all() and np.isnan(away.water).all()


def test_sections_go_over_into_each_other_at_nodes(scenes):
    """At the node where two channels become one, width and depth of the main stem are one."""
    courses = scenes["junction"].stations
    group = courses.group
    main = np.flatnonzero(group == group[2])
    up, down = (int(main[main != 2][0]), 2)
    a, b = courses.start[up + 1] - 1, courses.start[down]
    np.testing.assert_allclose(courses.xy[a], courses.xy[b], atol=1e-9)
    np.testing.assert_allclose(courses.tangent[a], courses.tangent[b], atol=1e-6)
    assert courses.width[a] == pytest.approx(courses.width[b], rel=1e-6)
    assert courses.water[a] == courses.water[b]
    # The area changes on the way, and the speed with it; the discharge does not.
    assert courses.depth[a] == pytest.approx(courses.depth[b], rel=1e-6)


def test_a_finer_detail_changes_the_bed_little():
    coarse, fine = (one_river("C", 0.008, 0.3, 150.0, detail=d) for d in (0.5, 0.25))
    xy = places(fine, 500, 4, 0.5)
    assert np.percentile(np.abs(coarse.rivers.beds.heights(xy)[0] - fine.rivers.beds.heights(xy)[0]), 95) < 0.08


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_real_rivers_have_water_in_their_beds():
    pytest.importorskip("rasterio")
    ground = wr.read_terrain(data_folder("dem") / "gabilan_lidar1m.tif")
    network = wr.extract_network(ground, min_drainage_area=2e4)
    scene = Riverscape(ground, network)
    courses = scene.stations
    bed = scene.bed_at(courses.xy[courses.wet[courses.station_course]])
    assert (bed.depth > 0.0).mean() > 0.97
    window = scene.carved(
        0.5, (ground.bounds[0] + 200, ground.bounds[1] + 200, ground.bounds[0] + 300, ground.bounds[1] + 300)
    )
    assert window.shape == (200, 200)


def lines(*ends, **more):
    xy = [np.linspace(a, b, 12) for a, b in ends]
    return wr.RiverNetwork.from_polylines(xy, width=4.0, **more)


DOWN, UP = ((60.0, 120.0), (300.0, 120.0)), ((300.0, 120.0), (60.0, 120.0))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: Riverscape(valley_floor(0.02), lines(UP), "C"), "channel 0 runs uphill"),
        (lambda: Riverscape(valley_floor(0.0), lines(DOWN), "C", flow=1.0), "the ground is level"),
        (lambda: Riverscape(valley_floor(0.02, 3, 4, 150.0), lines(DOWN), "C"), "cells are 150 m wide and the longest"),
        (lambda: wr.classify_rivers(lines(DOWN), valley_floor(0.02, 3, 4, 150.0)), "use a finer terrain"),
        (lambda: Riverscape(valley_floor(0.02), lines(DOWN), "H"), "type is 'H'"),
        (lambda: Riverscape(valley_floor(0.02), lines(DOWN), ["C", "C"]), "types are 2 for 1 channels"),
        (lambda: Riverscape(valley_floor(0.06), lines(DOWN), "D"), "type D and a slope of 0.06"),
        (lambda: Riverscape(valley_floor(0.02), lines(((900.0, 0.0), (990.0, 0.0))), "C"), "no data"),
        (lambda: Riverscape(valley_floor(0.02), lines(DOWN), "C", detail=0.0), "detail is 0"),
        (lambda: one_river("C", 0.01, 1.0).carved(0.5, (0.0, 0.0, 0.4, 0.4)), "hold fewer than 2 x 2 cells"),
        (lambda: one_river("C", 0.01, 1.0).carved(0.0), "cell_size is 0"),
        (lambda: one_river("C", 0.01, 1.0).carved(1.0, (0.0, 0.0, 40.0, 40.0)), "holds no river"),
    ],
)
def test_bad_input_gets_one_clear_error(call, said):
    with pytest.raises(InputError, match=said) as error:
        call()
    assert "\n" not in str(error.value) and len(str(error.value)) < 250


def test_holes_in_the_ground_are_filled_from_upstream_and_told_where_all_is_lost():
    ground = valley_floor(0.02)
    height = ground.to_numpy()
    height[8:16, 14:17] = np.nan
    holed = wr.Terrain(height, ground.cell_size, ground.origin)
    scene = Riverscape(holed, lines(DOWN), "C")
    assert np.isfinite(scene.stations.water).all() and (np.diff(scene.stations.water) <= 0.0).all()
    bed = scene.bed_at([(155.0, 120.0), (100.0, 120.0)])
    assert np.isnan(bed.elevation[0]) and bed.depth[0] == 0.0 and bed.depth[1] > 0.0
    height[:] = np.where(np.arange(50) < 40, np.nan, height)
    with pytest.raises(InputError, match="no data"):
        Riverscape(wr.Terrain(height, ground.cell_size, ground.origin), lines(DOWN), "C")


def test_a_level_channel_among_others_is_a_slow_one():
    network = lines(DOWN, ((60.0, 60.0), (300.0, 60.0)), slope=[0.0, 0.01])
    scene = Riverscape(valley_floor(0.0), network, "C", flow=1.0)
    assert (scene.stations.speed > 0.0).all() and np.ptp(scene.stations.water) < 2.0
    level = scene.stations.channel[scene.stations.station_course] == 0
    assert scene.stations.speed[level].max() < scene.stations.speed[~level].min()


def test_detail_beyond_memory_is_refused_before_it_is_tried(monkeypatch):
    monkeypatch.setattr("warpriver.device.available_memory", lambda device: 10**6)
    with pytest.raises(OutOfMemoryError, match="detail"):
        Riverscape(valley_floor(0.02), lines(DOWN), "C", detail=1e-3)


def test_hollows_are_filled_where_less_is_cut():
    """With mix 0 the water is the greatest ground downstream."""
    ground = valley_floor(0.01)
    height = ground.to_numpy()
    height[:, 20:24] += 2.0  # a bar across the valley
    barred = wr.Terrain(height, ground.cell_size, ground.origin)
    cut, filled = (Riverscape(barred, lines(DOWN), "C", profile_params=ProfileParams(mix=m)) for m in (1.0, 0.0))
    assert (
        filled.stations.water[0] > cut.stations.water[0] and (filled.stations.water >= cut.stations.water - 1e-9).all()
    )
