"""Edits of riverscapes: what they do, what they leave as it was, undo, sessions, files, and what is refused."""

import numpy as np
import pytest
from river_scenes import junction, one_river, valley_floor

import warpriver as wr
from warpriver import edits, riverscape
from warpriver.kernels import flow_tree
from warpriver.riverscape import Riverscape, example, primitives, read_riverscape

WINDOW, CELL = (40.0, 20.0, 460.0, 220.0), 4.0


def frame(scene):
    """Bed, elevation, velocity and foam on a grid at a time, cell by cell."""
    (made,) = scene.frames(WINDOW, CELL, [3.0])
    water = made.water
    fields = (made.bed, water.elevation, water.velocity, water.effervescence)
    return np.concatenate([f.numpy().reshape(made.bed.size, -1).astype(np.float64) for f in fields], axis=1)


def changed_cells(before, after):
    """Places (n, 2) of cells whose bits are others."""
    same = (before == after) | (np.isnan(before) & np.isnan(after))
    rows, columns = np.divmod(np.flatnonzero(~same.all(axis=1)), int((WINDOW[2] - WINDOW[0]) / CELL))
    return np.column_stack([WINDOW[0] + CELL * (columns + 0.5), WINDOW[3] - CELL * (rows + 0.5)])


def brook(device):
    made = example("C")
    return Riverscape(made.terrain, made.courses, rocks=made.rocks, device=device)


@pytest.fixture(scope="module")
def laid(device):
    return junction(("A", "C", "D"), detail=1.0, device=device)


@pytest.fixture
def rivers(laid):
    """The same scene for each test, without the edits of others."""
    return laid.replay([])


NODE = 240.0


@pytest.mark.parametrize(
    ("edit", "where"),
    [
        # The channel itself, and of what flows into it as much as goes over into its section: 3 widths.
        (riverscape.RetypeChannel(1, "B"), lambda x, y: (x < NODE + 2.0) & (y < 126.0)),
        (riverscape.RetypeChannel(2, "B"), lambda x, y: x > NODE - 15.0),
        (
            riverscape.RedrawCourse(0, [(100.0, 151.0), (140.0, 170.0), (170.0, 150.0), (200.0, 135.0)]),
            lambda x, y: (x < NODE + 2.0) & (y > 114.0),
        ),
        # The channel on it, and the ground.
        (edits.EditTerrain("lower", center=(340.0, 120.0), radius=40.0, amount=1.5), lambda x, y: x > NODE - 2.0),
        (riverscape.AddRock((150.0, 140.0), 3.0), lambda x, y: np.hypot(x - 150.0, y - 140.0) < 20.0),
    ],
)
def test_cells_elsewhere_keep_their_bits(edit, where, rivers):
    before, stations = frame(rivers), rivers.stations
    rivers.apply(edit)
    after = frame(rivers)
    x, y = changed_cells(before, after).T
    assert len(x) and where(x, y).all()
    # Water falls all along, and what meets at a node has one level, to the bit.
    now = rivers.stations
    inner = np.diff(now.station_course) == 0
    assert (np.diff(now.water)[inner] <= 0.0).all()
    for node in range(4):
        levels = np.concatenate(
            [now.water[now.start[:-1][now.from_node == node]], now.water[now.start[1:][now.to_node == node] - 1]]
        )
        plain = np.concatenate([now.wet[now.from_node == node], now.wet[now.to_node == node]])
        assert np.ptp(levels[plain]) == 0.0
    assert rivers.undo() == edit
    np.testing.assert_array_equal(frame(rivers), before)
    assert rivers.stations is stations
    rivers.redo()
    np.testing.assert_array_equal(frame(rivers), after)
    rivers.undo()


def test_a_channel_that_is_given_its_own_type_stays_as_it_is(rivers):
    before = frame(rivers)
    rivers.apply(riverscape.RetypeChannel(2, "D"))
    np.testing.assert_array_equal(frame(rivers), before)
    rivers.undo()


def test_ground_that_is_raised_at_a_node_lets_its_level_follow(device):
    scene = junction(detail=1.0, device=device)
    before = scene.stations.water.copy()
    scene.apply(edits.EditTerrain("lower", center=(NODE, 120.0), radius=60.0, amount=3.0))
    first, last = scene.stations.start[:-1], scene.stations.start[1:] - 1
    assert before[last[0]] - scene.stations.water[last[0]] > 1.0
    assert scene.stations.water[last[0]] == scene.stations.water[last[1]] == scene.stations.water[first[2]]
    # The sources lie too far away to change.
    assert scene.stations.water[first[0]] == before[first[0]]


def test_retyped_and_redrawn_channels_are_what_is_asked_for(device):
    scene = one_river("C", 0.012, 6.0, 300.0, detail=1.0, device=device)
    scene.apply(riverscape.RetypeChannel(0, "D"))
    assert len(np.unique(scene.stations.thread)) > 2
    line = np.array([(120.0, 120.0), (170.0, 150.0), (220.0, 150.0), (300.0, 120.0)])
    scene.apply(riverscape.RetypeChannel(0, "B"))
    scene.apply(riverscape.RedrawCourse(0, line))
    xy = scene.stations.xy
    assert np.hypot(*(xy - line[1]).T).min() < 1.0 and np.hypot(*(xy - line[2]).T).min() < 1.0
    np.testing.assert_allclose(xy[[0, -1]], [(60.0, 120.0), (360.0, 120.0)], atol=1e-9)


def test_courses_of_ones_own_are_redrawn_and_retyped(device):
    scene = brook(device)
    course = scene.courses.courses[0]
    xy = np.asarray(course.xy)
    before = scene.water(xy[:40], 1.0).elevation
    line = np.concatenate([xy[100:101], xy[110:111] + (0.0, 1.5), xy[120:121]])
    scene.apply(riverscape.RedrawCourse(0, line))
    new = scene.courses.courses[0]
    assert np.hypot(*(np.asarray(new.xy) - line[1]).T).min() < 0.3
    assert (np.diff(np.asarray(new.level)) <= 0.0).all()
    np.testing.assert_array_equal(scene.water(xy[:40], 1.0).elevation, before)
    scene.apply(riverscape.RetypeChannel(0, "B"))
    assert scene.courses.courses[0].channel_type == "B" and scene.stations.type[0] == 2


def test_a_rock_has_a_wake_and_a_pair_of_vortices_by_replacement(device):
    scene = brook(device)
    course = scene.courses.courses[0]
    rocks = np.array([rock.center for rock in scene.courses.rocks])
    away = np.hypot(*(np.asarray(course.xy)[:, None] - rocks).transpose(2, 0, 1)).min(axis=1)
    k = 20 + int(away[20:-20].argmax())
    center, toward = np.asarray(course.xy)[k], course.direction[k]
    scene.apply(riverscape.AddRock(tuple(center), 0.5, 0.08))
    rock = scene.courses.rocks[-1]
    level = scene.courses.survey([center]).level[0]
    assert rock.top == pytest.approx(level + 0.08)
    assert scene.bed([center])[0] == pytest.approx(rock.top, abs=1e-6)
    eddies = {layer.name: layer for layer in scene.layers}["eddies"]
    assert not eddies.merged
    near = np.hypot(*(eddies.node.center - center - 0.6 * toward).T) < 0.6
    spin = eddies.node.shape[near, 1]
    assert near.sum() == 2 and spin.sum() == pytest.approx(0.0, abs=0.3 * np.abs(spin).max()) and spin.min() < 0.0
    # Behind it the water is held back.
    behind = center + np.linspace(0.5, 0.9, 5)[:, None] * toward
    free = scene.courses.survey(behind).velocity @ toward
    assert (scene.water(behind).velocity @ toward < 0.75 * free).all()
    there = tuple(center + 4.0 * toward)
    scene.apply(riverscape.MoveObstacle(tuple(center), there))
    assert scene.courses.rocks[-1].center == pytest.approx(there)
    scene.apply(riverscape.RemoveObstacle(there))
    np.testing.assert_array_equal(scene.water(behind).velocity, brook(device).water(behind).velocity)


def test_rocks_that_follow_from_the_type_can_go_as_well(rivers):
    rock = rivers.courses.rocks[5]
    count = len(rivers.courses.rocks)
    rivers.apply(riverscape.RemoveObstacle(rock.center))
    assert len(rivers.courses.rocks) == count - 1 and rock not in rivers.courses.rocks
    rivers.undo()


def test_a_log_has_rough_water_in_its_lee_and_an_eddy_behind_either_end(device):
    scene = brook(device)
    course = scene.courses.courses[0]
    center, toward = np.asarray(course.xy)[60], course.direction[60]
    left = np.array([-toward[1], toward[0]])
    start, end = center - 0.6 * left, center + 0.6 * left
    count = {layer.name: len(layer.node) for layer in scene.layers}
    scene.apply(riverscape.AddLog(tuple(start), tuple(end), 0.2, 0.05))
    rows = {layer.name: layer.node for layer in scene.layers}
    assert len(rows["eddies"]) == count["eddies"] + 2 and len(rows["wakes"]) >= count["wakes"] + 4
    eddies = rows["eddies"][-2:]
    off = eddies.center - center
    # The one on the left turns right.
    assert ((off @ left > 0.0) == (eddies.shape[:, 1] < 0.0)).all() and (off @ toward > 0.0).all()
    assert scene.bed([center])[0] == pytest.approx(scene.courses.logs[0].top, abs=0.01)


def test_water_is_added_changed_moved_replaced_and_removed(device):
    scene = brook(device)
    place = np.asarray(scene.courses.courses[0].xy)[80]
    before = scene.water([place], 2.0)
    pool = primitives("vortex", tuple(place), 0.8, spin=2.0, shear=1.0, depth=0.05)
    scene.apply(riverscape.AddWater(pool, "whirl"))
    still, course = scene.water([place], 2.0).still[0], before.still[0]
    # Its dimple is as deep as it says, below the water that was there.
    assert still == pytest.approx(course - 0.05, abs=5e-3)
    scene.apply(riverscape.ChangeWater("whirl", set={"depth": 0.02}, times={"spin": 0.5}))
    assert scene.water([place], 2.0).still[0] == pytest.approx(course - 0.02, abs=5e-3)
    assert scene.layers[-1].node.shape[0, 1] == 1.0
    scene.apply(riverscape.MoveWater("whirl", by=(0.3, 0.0)))
    np.testing.assert_allclose(scene.layers[-1].node.center[0], place + (0.3, 0.0))
    scene.apply(riverscape.ReplaceWater("whirl", tree=primitives("calm", tuple(place), 0.8, 0.04)))
    assert scene.layers[-1].node.kind.tolist() == [flow_tree.CALM]
    assert scene.water([place], 2.0).elevation[0] == pytest.approx(course + 0.04, abs=5e-3)
    scene.apply(riverscape.RemoveWater("whirl"))
    assert scene.water([place], 2.0).elevation[0] == before.elevation[0]
    # Leaves of the body by place and kind.
    body = scene.layers[0].node
    near = np.hypot(*(body.center - place).T) <= 1.5
    scene.apply(riverscape.ChangeWater("body", tuple(place), 1.5, times={"amplitude": 0.0}))
    assert (scene.layers[0].node.amplitude[near] == 0.0).all() and near.any()
    np.testing.assert_array_equal(scene.layers[0].node.amplitude[~near], body.amplitude[~near])
    for _ in range(6):
        scene.undo()
    assert scene.water([place], 2.0).elevation[0] == before.elevation[0] and not scene.edits


def test_edits_of_water_come_again_on_water_that_is_seeded_anew(rivers):
    place = rivers.stations.xy[rivers.stations.start[2] + 30]
    rivers.apply(riverscape.AddWater(primitives("calm", tuple(place), 3.0, 0.1), "hump"))
    rivers.apply(riverscape.RetypeChannel(1, "B"))
    assert [layer.name for layer in rivers.layers][-1] == "hump"
    rivers.undo()
    rivers.undo()


def session(scene):
    course = scene.stations
    place = course.xy[course.start[0] + 40]
    scene.apply(riverscape.AddRock(tuple(place), 0.8))
    scene.apply(riverscape.AddLog((200.0, 130.0), (204.0, 134.0), 0.4))
    scene.apply(riverscape.AddWater(primitives("ripple", tuple(place), 2.0, amplitude=0.05), "gust", "merge"))
    scene.apply(edits.EditTerrain("lower", center=(340.0, 120.0), radius=40.0, amount=1.5))
    scene.apply(riverscape.RetypeChannel(1, "B"))
    scene.apply(riverscape.ChangeWater("gust", times={"amplitude": 2.0}))
    return scene


def test_a_session_is_replayed_from_json_to_the_bit(device, tmp_path):
    scene = session(junction(("A", "C", "D"), detail=1.0, device=device))
    edits.write_edits(tmp_path / "session.json", scene)
    again = junction(("A", "C", "D"), detail=1.0, device=device).replay(tmp_path / "session.json")
    assert again.edits == scene.edits and len(scene.edits) == 6
    np.testing.assert_array_equal(frame(again), frame(scene))


def test_an_edited_scene_comes_back_from_its_files_and_can_be_edited_further(device, tmp_path):
    scene = session(junction(("A", "C", "D"), detail=1.0, device=device))
    scene.save(tmp_path / "scene.json")
    back = read_riverscape(tmp_path / "scene.json", device=device)
    assert back.edits == scene.edits
    np.testing.assert_array_equal(frame(back), frame(scene))
    for each in (scene, back):
        each.apply(riverscape.RetypeChannel(2, "C"))
        each.apply(riverscape.RemoveWater("gust"))
    np.testing.assert_array_equal(frame(back), frame(scene))
    back.undo(), back.undo()
    with pytest.raises(ValueError, match="no edit was done"):
        back.undo()


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (lambda: riverscape.RetypeChannel(9, "C"), "channel is 9; there are 3"),
        (lambda: riverscape.RetypeChannel(0, "Z"), "type is 'Z'"),
        (lambda: riverscape.RetypeChannel(0, "C") and riverscape.RedrawCourse(0, [(0, 0), (1, 1)]), "at least 3"),
        (lambda: riverscape.RedrawCourse(0, [(200, 135), (140, 150), (100, 151)]), "runs upstream"),
        (lambda: riverscape.RemoveWater("foam"), "there is no layer 'foam'; there are body"),
        (lambda: riverscape.RemoveWater("body", (0.0, 0.0), 1.0), "finds no primitive"),
        (lambda: riverscape.RemoveWater("body"), "nothing would be left"),
        (lambda: riverscape.RemoveWater(), "nothing says which"),
        (lambda: riverscape.MoveWater("body", center=(0.0, 0.0)), "go together"),
        (lambda: riverscape.ChangeWater("body"), "nothing is to be changed"),
        (lambda: riverscape.ChangeWater("body", kind="calm", set={"spin": 1.0}), "a calm has no spin"),
        (lambda: riverscape.ChangeWater("body", set={"radius": -1.0}), "radius must be above 0"),
        (lambda: riverscape.AddWater(primitives("calm", (0.0, 0.0), 1.0), "pond"), "no water at"),
        (lambda: riverscape.AddWater(primitives("calm", (100.0, 151.0), 1.0), "body"), "already"),
        (lambda: riverscape.AddWater("lake", "pond"), "no tree of water"),
        (lambda: riverscape.AddRock((-500.0, 0.0), 1.0), "off the ground"),
        (lambda: riverscape.AddLog((0.0, 0.0), (0.1, 0.0), 1.0), "shorter than it is thick"),
        (lambda: riverscape.RemoveObstacle((450.0, 30.0)), "no rock and no log"),
        (lambda: edits.LockPoint(0, 10.0), "no edit of a riverscape"),
    ],
)
def test_what_cannot_be_done_is_refused_and_nothing_changes(edit, told, rivers):
    made = rivers.made
    with pytest.raises(ValueError, match=told) as error:
        rivers.apply(edit())
    assert rivers.made is made and not rivers.edits and "\n" not in str(error.value)


def test_a_course_through_a_hollow_is_refused(device):
    ground = valley_floor(0.02)
    height = ground.to_numpy()
    height[3:7, 15:25] -= 12.0
    line = np.column_stack([np.linspace(60.0, 400.0, 18), np.full(18, 120.0)])
    network = wr.RiverNetwork.from_polylines([line], width=4.0, slope=[0.02])
    scene = Riverscape(wr.Terrain(height, 10.0, ground.origin), network, "B", flow=1.0, detail=1.0, device=device)
    with pytest.raises(ValueError, match="above the ground at"):
        scene.apply(riverscape.RedrawCourse(0, [(120.0, 120.0), (160.0, 190.0), (220.0, 190.0), (260.0, 120.0)]))


def test_a_simulation_takes_no_edit_of_a_riverscape():
    line = wr.generate.noisy_line(length=3_000, spacing=50, amplitude=20, seed=0)
    run = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=60.0), device="cpu")
    with pytest.raises((ValueError, TypeError), match="RetypeChannel"):
        run.apply(riverscape.RetypeChannel(0, "C"))
