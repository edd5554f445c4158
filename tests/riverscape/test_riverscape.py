"""Riverscapes as users have them: water, bed, frames, drift, files, flow maps, and what is refused."""

import json

import numpy as np
import pytest

import warpriver as wr
from warpriver.riverscape import Course, FlowMap, example, primitives, read_flow_map, read_riverscape, write_frames


@pytest.fixture(scope="module")
def scenes(device):
    made = {name: example(name) for name in "ACD"}
    return {
        name: wr.Riverscape(each.terrain, each.courses, rocks=each.rocks, device=device) for name, each in made.items()
    }


@pytest.mark.parametrize("name", ["A", "C", "D"])
def test_water_lies_in_its_bed_and_below_its_banks(name, scenes):
    """On the centre line above the bed by the depth of the section; beyond the banks nowhere above the ground."""
    scene = scenes[name]
    for course in scene.courses.courses:
        inside = slice(4, -4)
        xy, level = np.asarray(course.xy)[inside], np.asarray(course.level)[inside]
        found = scene.water(xy, 3.0)
        # Where the water falls, a lip lies a little below the step of the bed.
        drop = np.abs(np.diff(np.asarray(course.level)))
        steep = np.concatenate([drop, [0.0]]) + np.concatenate([[0.0], drop]) > 0.05
        near = 0.05 * np.asarray(course.depth).max()
        np.testing.assert_allclose(found.still[~steep[inside]], level[~steep[inside]], atol=near)
        bed = scene.bed(xy, rocks=False)
        assert (found.elevation > bed).mean() > 0.97
    west, south, east, north = scene.courses.bounds
    at = np.random.default_rng(0).uniform((west - 3, south - 3), (east + 3, north + 3), (6000, 2))
    where = scene.courses.survey(at)
    beyond = (where.point < 0) | (np.abs(where.across) > 1.6)
    found = scene.water(at[beyond], 3.0)
    hanging = found.elevation > scene.bed(at[beyond])
    assert hanging.mean() < 0.002


def test_steps_of_the_water_go_down(scenes):
    """Along the course the still water never rises by more than rounding."""
    scene = scenes["A"]
    course = scene.courses.courses[0]
    along = np.arange(1.0, course.length - 1.0, 0.05)
    xy = np.column_stack([np.interp(along, course.along, np.asarray(course.xy)[:, k]) for k in (0, 1)])
    level = np.interp(along, course.along, course.level)
    still = scene.water(xy, 0.0).still
    wake = np.abs(still - level) > 0.5 * np.abs(np.diff(course.level)).max()
    rise = np.diff(still)
    assert (rise > 2e-3).mean() < 0.02 and not wake.mean() > 0.05


def test_frames_are_the_scene_on_a_grid(scenes):
    scene = scenes["C"]
    bounds = (10.0, 4.0, 16.0, 16.0)
    first, second = scene.frames(bounds, 0.1, [0.0, 1.5])
    assert first.water.shape == (120, 60) and first.bed is second.bed
    x, y = 10.0 + 0.1 * (np.arange(60) + 0.5), 16.0 - 0.1 * (np.arange(120) + 0.5)
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    np.testing.assert_array_equal(second.water.elevation.numpy().ravel(), scene.water(at, 1.5).elevation)
    np.testing.assert_allclose(first.bed.numpy().ravel(), scene.bed(at), atol=1e-12)
    assert first.depth.min() == 0.0 and first.depth.max() > 0.1
    assert not np.array_equal(first.depth, second.depth)


def test_a_carved_terrain_is_the_bed(scenes):
    scene = scenes["D"]
    carved = scene.carved(0.5, (5.0, -6.0, 20.0, 6.0))
    assert carved.shape == (24, 30)
    at = [[5.25, 5.75], [12.75, 0.25]]
    np.testing.assert_allclose(carved.raster.values.numpy()[[0, 11], [0, 15]], scene.bed(at), atol=1e-12)


def test_leaves_drift_downstream_and_stay_on_the_water(scenes):
    scene = scenes["C"]
    shots = list(scene.drift(np.arange(0.0, 10.0, 0.5), leaves=60))
    for shot in shots:
        found = scene.water(shot.xy, shot.time)
        assert (found.still - scene.bed(shot.xy) > 0.0).all()
    kept = shots[0].generation == shots[-1].generation
    first, last = (scene.courses.survey(shot.xy[kept]).along for shot in (shots[0], shots[-1]))
    assert kept.mean() > 0.7 and np.median(last - first) > 0.5
    again = list(scene.drift(np.arange(0.0, 10.0, 0.5), leaves=60))
    np.testing.assert_array_equal(shots[-1].xy, again[-1].xy)


def test_a_scene_comes_back_from_its_files(scenes, tmp_path, device):
    scene = scenes["A"]
    scene.save(tmp_path / "a.json")
    back = read_riverscape(tmp_path / "a.json", device=device)
    at = np.random.default_rng(1).uniform((0.0, -2.0), (60.0, 2.0), (500, 2))
    np.testing.assert_array_equal(back.water(at, 2.0).elevation, scene.water(at, 2.0).elevation)
    np.testing.assert_array_equal(back.bed(at), scene.bed(at))
    assert repr(back) == repr(scene)
    (tmp_path / "b.json").write_text("{}")
    with pytest.raises(ValueError, match=r"no scene|npz"):
        (tmp_path / "b.npz").write_bytes((tmp_path / "a.npz").read_bytes())
        read_riverscape(tmp_path / "b.json")
    with pytest.raises(OSError, match="npz"):
        read_riverscape(tmp_path / "c.json")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("preset", ["unreal", "unity"])
def test_a_flow_map_keeps_speed_and_still_water(preset, bits, scenes, tmp_path):
    scene = scenes["C"]
    bounds = (10.0, 4.0, 16.0, 16.0)
    made = FlowMap.of(scene, bounds, 0.1, preset=preset, bits=bits)
    made.save(tmp_path / "flow.png")
    back = read_flow_map(tmp_path / "flow.png")
    np.testing.assert_array_equal(back.pixel, made.pixel)
    (frame,) = scene.frames(bounds, 0.1, [0.0])
    wet = frame.depth > 0.0
    velocity = frame.water.velocity.numpy()
    step = np.abs(velocity[wet]).max() / (2 ** (bits - 1) - 1)
    np.testing.assert_allclose(back.velocity[wet], velocity[wet], rtol=0.0, atol=0.501 * step)
    assert (back.velocity[~wet] == 0.0).all() and (~wet).any()
    np.testing.assert_allclose(back.depth, frame.depth, rtol=0.0, atol=0.51 * frame.depth.max() / (2**bits - 1))
    # Downstream is the same in both; the green channel runs the other way.
    told = json.loads((tmp_path / "flow.png.json").read_text())
    zero, north = told["green"]["zero"], velocity[..., 1]
    strong = wet & (np.abs(north) > 0.5 * np.abs(north[wet]).max())
    sign = np.sign(made.pixel[..., 1].astype(int) - zero)[strong] * np.sign(north)[strong]
    assert (sign == (-1 if preset == "unreal" else 1)).all()
    assert told["meters_per_pixel"] == 0.1 and told["west"] == 10.0


def test_the_png_of_a_flow_map_is_one_for_others(scenes, tmp_path):
    image = pytest.importorskip("PIL.Image")
    made = FlowMap.of(scenes["C"], (10.0, 4.0, 16.0, 16.0), 0.2)
    made.save(tmp_path / "flow.png")
    np.testing.assert_array_equal(np.asarray(image.open(tmp_path / "flow.png")), made.pixel)


def test_frames_as_rasters(scenes, tmp_path):
    files = write_frames(
        scenes["C"], tmp_path / "out", times=[0.0, 0.5], cell_size=0.25, bounds=(10.0, 4.0, 16.0, 16.0), loop=2.0,
        suffix=".npz",
    )  # fmt: skip
    assert [f.name for f in files][:3] == ["bed.npz", "0000_elevation.npz", "0000_depth.npz"] and len(files) == 11
    depth = wr.io.read_raster(tmp_path / "out" / "0001_depth.npz")
    assert depth.unit == "m" and depth.values.numpy().max() > 0.1


def test_a_tree_of_ones_own_takes_the_place_of_the_rivers(device):
    made = example("C")
    lake = primitives("calm", (20.0, 8.0), 30.0, 50.0)
    scene = wr.Riverscape(made.terrain, made.courses, tree=lake, device=device)
    assert scene.water([[20.0, 8.0]]).elevation[0] == 50.0


LINE = np.column_stack([np.linspace(0.0, 10.0, 6), np.zeros(6)])


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"level": [1.0, 1.0, 1.1, 1.0, 1.0, 1.0]}, "rises after point 1"),
        ({"width": 0.0}, "width of point 0"),
        ({"speed": np.nan}, "speed of point 0"),
        ({"channel_type": "Z"}, "A\\+, A, B"),
        ({"xy": LINE[:2]}, "at least 3"),
        ({"form": [0.0, 2.0, 0.0]}, "in \\[0, 1\\]"),
        ({"falls": [5]}, "falls"),
    ],
)
def test_courses_that_cannot_be_are_refused(wrong, told):
    good = {"xy": LINE, "level": 1.0, "width": 2.0, "depth": 0.3, "speed": 0.5}
    Course(**good)
    with pytest.raises(ValueError, match=told):
        Course(**{**good, **wrong})


def test_what_a_riverscape_cannot_do_is_refused(scenes):
    scene = scenes["C"]
    with pytest.raises(ValueError, match="too many"):
        scene.frames((0.0, 0.0, 50.0, 20.0), 1e-4, [0.0])
    with pytest.raises(ValueError, match="fewer than 2 x 2"):
        scene.frames((0.0, 0.0, 0.0, 20.0), 0.1, [0.0])
    with pytest.raises(ValueError, match="do not fall"):
        next(scene.drift([1.0, 0.0]))
    with pytest.raises(ValueError, match="detail"):
        wr.Riverscape(scene.terrain, scene.courses.courses, detail=0.0)
    with pytest.raises(ValueError, match="no water"):
        made = example("C")
        dry = wr.Riverscape(made.terrain, made.courses, tree=primitives("calm", (0.0, 0.0), 1.0, -50.0))
        next(dry.drift([0.0]))


def test_the_water_of_a_window_is_that_of_the_whole(device):
    """To the bit, also at its edge, though other courses and all water far from it are left out."""
    terrain = wr.generate.fluvial_terrain((60, 60), cell_size=30.0, relief=200.0, seed=2, device=device)
    network = wr.extract_network(terrain, min_drainage_area=2e5)
    whole = wr.Riverscape(terrain, network, detail=2.0)
    x, y = network.polylines()[0][5]
    window = (x - 40.0, y - 40.0, x + 40.0, y + 40.0)
    part = whole.within(window)
    assert len(part.courses.courses) < len(whole.courses.courses)
    assert len(part.water_surface.primitives) < 0.5 * len(whole.water_surface.primitives)
    (expected,), (found,) = (scene.frames(window, 0.5, [3.3]) for scene in (whole, part))
    assert (found.water.weight.numpy() > 0.0).sum() > 500
    for name in ("elevation", "velocity", "effervescence"):
        np.testing.assert_array_equal(getattr(found.water, name).numpy(), getattr(expected.water, name).numpy())
    np.testing.assert_array_equal(found.bed.numpy(), expected.bed.numpy())
    with pytest.raises(ValueError, match="holds no river"):
        whole.within((9000.0, 9000.0, 9100.0, 9100.0))
