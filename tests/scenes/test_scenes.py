"""Scenes: read, refused, run to the bits of the same calls in Python, described, and run from the command line."""

import copy
import dataclasses
import json

import numpy as np
import pytest

import warpriver as wr
from warpriver import edits
from warpriver.cli import main
from warpriver.errors import WarpriverError
from warpriver.io.tables import read_toml
from warpriver.meander import Attractor, DampingRegion, Guide, Repeller, SetControls
from warpriver.scenes import describe_scene, read_scene, scene_schema
from warpriver.scenes.output_tables import OUTPUT, PICTURE
from warpriver.scenes.reading import CONTROLS, PLAN, edit_names

SCENE = """
name = "bend"

[terrain]
generate = "tilted_plain"
shape = [60, 100]
cell_size = 100.0
slope = 1e-3

[[terrain.brush]]
operation = "ridge"
line = [[0, 1000], [10000, 1200]]
height = 20
width = 1500

[[network.channel]]
generate = "noisy_line"
length = 8_000.0
spacing = 50.0
amplitude = 100.0
seed = 3
width = 60.0
offset = [1_000.0, 3_000.0]

[[network.channel]]
points = [[1_000.0, 5_500.0], [4_000.0, 5_000.0], [8_500.0, 5_200.0]]
width = 40.0
depth = 2.0

[params]
sinuosity_scaling = "whole"
migration_rate = 80.0

[params.avulsions]
crevasse_rate = 0.5
avulsion_probability = 0.5

[[control]]
kind = "Repeller"
center = [5_000.0, 3_400.0]
radius = 900.0
from = 5.0
until = 12.0

[[control]]
kind = "DampingRegion"
polygon = [[7_000.0, 1_000.0], [8_000.0, 1_000.0], [8_000.0, 4_500.0], [7_000.0, 4_500.0]]
factor = 0.3

[[control]]
kind = "Guide"
file = "guide.csv"
radius = 700.0
from = 5.0

[[edit]]
time = 8.0
kind = "EditTerrain"
operation = "raise"
center = [3_000.0, 3_600.0]
radius = 600.0
amount = 30.0

[[edit]]
time = 2.0
kind = "LockPoint"
channel = 0
at = 3_000.0

[run]
years = 20.0
record_every_years = 4.0
seed = 7

[output]
lines = "channels.csv"
session = "session.json"
terrain = "ground.npz"

[[output.picture]]
file = "belt.png"
controls = true
dpi = 40
"""
GUIDE = [(2000.0, 2600.0), (3000.0, 2500.0), (4000.0, 2700.0)]


@pytest.fixture
def folder(tmp_path):
    """A scene, and the line that it names."""
    (tmp_path / "bend.toml").write_text(SCENE)
    (tmp_path / "guide.csv").write_text("x,y\n" + "".join(f"{x},{y}\n" for x, y in GUIDE))
    return tmp_path


def typed():
    """What the scene says, in Python."""
    terrain = wr.generate.tilted_plain((60, 100), 100.0, 1e-3)
    terrain.add_ridge([(0.0, 1000.0), (10000.0, 1200.0)], 20.0, 1500.0)
    noisy = wr.generate.noisy_line(8000.0, 50.0, 100.0, 3) + [1000.0, 3000.0]
    points = [(1000.0, 5500.0), (4000.0, 5000.0), (8500.0, 5200.0)]
    depth = float((60.0 / 18.8) ** (1.0 / 1.41))
    network = wr.RiverNetwork.from_polylines([noisy, points], width=[60.0, 40.0], depth=[depth, 2.0])
    avulsions = wr.AvulsionParams(crevasse_rate=0.5, avulsion_probability=0.5)
    params = wr.MeanderParams(sinuosity_scaling="whole", migration_rate=80.0, avulsions=avulsions)
    corners = [(7000.0, 1000.0), (8000.0, 1000.0), (8000.0, 4500.0), (7000.0, 4500.0)]
    damping, repeller = DampingRegion(corners, 0.3), Repeller((5000.0, 3400.0), 900.0)
    guide = Guide(GUIDE, 700.0)
    sim = wr.Simulation(network, params, terrain=terrain, seed=7, controls=[damping])
    sim.run(years=2.0)
    sim.lock(0, 3000.0)
    # As far as the first step that ends at 5 yr or later; a run of its own may end a step later.
    for time, act in (
        (5.0, SetControls([repeller, damping, guide])),
        (8.0, edits.EditTerrain("raise", (3000.0, 3600.0), 600.0, 30.0)),
        (12.0, SetControls([damping, guide])),
    ):
        sim.step(int(np.ceil(time / params.time_step)) - sim.step_count)
        sim.apply(act)
    sim.step(int(np.ceil(20.0 / params.time_step)) - sim.step_count)
    return sim


def assert_same(a, b):
    np.testing.assert_array_equal(a.network.points(), b.network.points())
    np.testing.assert_array_equal(a.network.channel_width, b.network.channel_width)
    np.testing.assert_array_equal(a.network.channel_id, b.network.channel_id)
    if a.terrain is not None:
        np.testing.assert_array_equal(a.terrain.to_numpy(), b.terrain.to_numpy())


def test_a_scene_gives_the_bits_of_the_same_calls(folder):
    scene, by_hand = wr.read_scene(folder / "bend.toml"), typed()
    sim = scene.simulation(threads=1)
    history = scene.play(sim)
    assert_same(sim, by_hand)
    assert len(history.crevasses) == len(by_hand.history.crevasses) > 0
    assert [e.edit.name for e in history.edits] == ["LockPoint", "SetControls", "EditTerrain", "SetControls"]
    assert history.times[-1] == by_hand.time and scene.years == by_hand.time
    # Once more, from the same value: nothing of it was changed by the run.
    other = scene.simulation(threads=2)
    scene.play(other)
    assert_same(other, sim)


def test_a_run_writes_what_the_scene_names_and_nothing_else(folder):
    scene = wr.io.read_scene(folder / "bend.toml")
    history = scene.run(folder / "out")
    names = sorted(path.name for path in (folder / "out").iterdir())
    assert names == ["belt.png", "channels.csv", "ground.npz", "run", "session.json", "start.npz"]
    assert wr.read_history(folder / "out" / "run").times.tolist() == history.times.tolist()
    with pytest.raises(WarpriverError, match="holds an earlier run"):
        scene.run(folder / "out")
    # A session is played by a scene that has no edits of its own.
    text = SCENE.split("[[control]]")[0] + '[session]\nfile = "out/session.json"\n'
    damping = "[[control]]\n" + SCENE.split("[[control]]")[2]
    (folder / "again.toml").write_text(text + damping)
    again = wr.read_scene(folder / "again.toml")
    assert again.run_plan.seed == 7 and again.run_plan.steps == scene.run_plan.steps
    np.testing.assert_array_equal(again.run().networks[-1].points(), history.networks[-1].points())


def test_a_run_goes_on_from_its_folder(folder):
    scene = read_scene(folder / "bend.toml")
    scene.run(folder / "out")
    sim = wr.Simulation.resume(folder / "out" / "run")  # it finds the ground that it began with
    sim.step(5)
    straight = scene.simulation()
    scene.play(straight)
    straight.step(5)
    assert_same(sim, straight)


# ---- refusals


def refused(folder, text, match, **options):
    (folder / "wrong.toml").write_text(text)
    with pytest.raises(WarpriverError, match=match) as caught:
        read_scene(folder / "wrong.toml", **options)
    assert "wrong.toml" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("[run]", "[runs]", r"runs = .* is no key of a scene; did you mean run\?"),
        ("name = ", "nam = ", r"nam = 'bend' is no key of a scene; did you mean name\?"),
        ('"tilted_plain"', '"tilted_plan"', r"terrain.generate = 'tilted_plan'; did you mean tilted_plain\?"),
        ("slope = 1e-3", "slop = 1e-3", r"terrain.slop = 0.001 is no key there; did you mean slope\?"),
        ("slope = 1e-3", "", r"terrain.slope is missing; generate = 'tilted_plain' needs it"),
        ("slope = 1e-3", 'slope = "steep"', r"terrain.slope = 'steep'; give a number"),
        ("shape = [60, 100]", "shape = [60]", r"terrain.shape = \[60\]; give 2 numbers"),
        ('operation = "ridge"', 'operation = "rigde"', r"terrain.brush\[0\].operation is 'rigde'; use"),
        ("amplitude = 100.0", "amplitude = -1.0", r"network.channel\[0\]: amplitude is -1; give a positive number"),
        ("width = 60.0", "", r"network.channel\[0\].width is missing"),
        ("width = 60.0", "width = 0", r"network.channel\[0\].width is 0; give a positive number of m"),
        ("depth = 2.0", "dpeth = 2.0", r"network.channel\[1\].dpeth = 2.0 is no key there"),
        ("[4_000.0, 5_000.0],", "[4_000.0, nan],", r"network.channel\[1\]: point 1 is not finite"),
        ("migration_rate = 80.0", "migration_rate = -80.0", r"params.migration_rate is -80 m/yr; the range is"),
        ("migration_rate = 80.0", "migraton_rate = 1", r"params.migraton_rate = 1 is no key there; did you mean migr"),
        ('"whole"', '"hole"', r"params.sinuosity_scaling is 'hole'; use one of"),
        ("crevasse_rate = 0.5", "crevase_rate = 0.5", r"params.avulsions.crevase_rate = 0.5 is no key there"),
        ("crevasse_rate = 0.5", "crevasse_rate = -1", r"params.avulsions.crevasse_rate is -1"),
        ('kind = "Repeller"', 'kind = "Repellor"', r"control\[0\].kind = 'Repellor'; did you mean Repeller\?"),
        ("radius = 900.0", "radius = 0", r"control\[0\].radius is 0 m; the range is"),
        ("until = 12.0", "until = 5.0", r"control\[0\].until = 5.0; the control begins at 5 yr"),
        ("factor = 0.3", "factor = 1.3", r"control\[1\].factor is 1.3; the range is 0 to 1"),
        ("[8_000.0, 4_500.0], [7_000.0, 4_500.0]]", "]", r"control\[1\].polygon has 2 points; give 3 to 10000"),
        ('file = "guide.csv"', 'file = "guides.csv"', r"control\[2\].file = 'guides.csv': there is no such file"),
        (
            'file = "guide.csv"',
            'file = "../guide.csv"',
            r"control\[2\].file = '../guide.csv' lies outside of the folder",
        ),
        ('file = "guide.csv"', 'file = "/etc/passwd"', r"control\[2\].file = '/etc/passwd' lies outside of the folder"),
        ('kind = "LockPoint"', 'kind = "LockPonit"', r"edit\[1\].kind = 'LockPonit'; did you mean LockPoint\?"),
        ('kind = "LockPoint"', 'kind = "SetControls"', r"edit\[1\].kind = 'SetControls'; give each control in"),
        ("at = 3_000.0", "at = -3.0", r"edit\[1\].at is -3; give a finite number of m, 0 or more"),
        ("at = 3_000.0", "", r"edit\[1\].at is missing; LockPoint needs it"),
        ("time = 2.0", "time = -2.0", r"edit\[1\].time is -2; give a finite number of years, 0 or more"),
        ("time = 2.0", "time = 99.0", r"edit\[1\] is to be done after 342 steps, .* and the run ends after 69"),
        ("time = 2.0", "", r"edit\[1\].time is missing"),
        ("years = 20.0", "years = -20.0", r"run.years is -20; give a finite number of years"),
        ("years = 20.0", "", r"run has no years"),
        ("years = 20.0", "years = 20\nsteps = 3", r"run has years and steps; give one of them"),
        ("seed = 7", "seed = -7", r"run.seed is -7; give a whole number"),
        ("record_every_years = 4.0", "record_every = 0", r"run.record_every is 0; give a whole number of steps, 1"),
        ("[run]\n", "[run]\ndtype = 'float16'\n", r"run.dtype is 'float16'; use 'float64' or 'float32'"),
        ('"channels.csv"', '"../channels.csv"', r"output.lines = '../channels.csv'; give the plain name of a file"),
        ('"channels.csv"', '"channels.doc"', r"output.lines = 'channels.doc'; .doc is none of"),
        ('"belt.png"', '"channels.csv"', r"output.picture\[0\].file = 'channels.csv'; .csv is none of .png"),
        ("controls = true", 'color = "blue"', r"output.picture\[0\].color = 'blue'; use one of area, discharge"),
        ("controls = true", "fps = 3", r"output.picture\[0\].fps = 3 is no key there"),
        ("[output]\n", "[output]\nlayers = ['oxbows']\n", r"output.layers = \['oxbows'\] are those of gis"),
        ("[output]\n", "[output]\ngis = 'run'\n", r"output.gis = 'run'; no ending is none of"),
    ],
)
def test_each_wrong_key_and_value_is_refused_by_name(folder, old, new, match):
    assert old in SCENE
    refused(folder, SCENE.replace(old, new, 1), match)
    assert not (folder / "out").exists()


def places(value, above=()):
    """Where each value of nested tables and lists stands."""
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield (*above, key)
        yield from places(value[key], (*above, key))


# One more of each kind, with the keys that the scene above does not have.
MORE = {
    "edit": [
        {"kind": "MovePoint", "channel": 0, "at": 2000.0, "to": [3000.0, 3100.0], "radius": 500.0},
        {"kind": "SplitChannel", "channel": 0, "at": 2000.0, "width_above": 40.0},
        {"kind": "AddChannel", "xy": [[0, 0], [10, 10], [900, 900]], "width": 20.0, "max_rise": 3.0},
        {"kind": "SetChannel", "channel": 0, "reach": [100.0, 900.0], "width": 33.0},
        {"kind": "AvulseChannel", "channel": 0, "at": 4000.0, "angle": 20.0},
        {"kind": "RedrawSection", "channel": 0, "file": "guide.csv", "channel_of_file": 0},
    ],
    "control": [
        {"kind": "ControlField", "bounds": [0, 0, 900, 900], "cell_size": 50.0,
         "stroke": [{"center": [100, 100], "radius": 90, "amount": 4.0}]},
    ],
}  # fmt: skip
WRONG = (1e308, "x", [[1]])


def test_whatever_stands_in_a_place_is_read_or_refused_in_one_line(folder, monkeypatch):
    scene = read_toml(folder / "bend.toml", "a scene")
    scene["edit"] += [{"time": 1.0, **edit} for edit in MORE["edit"]]
    scene["control"] += MORE["control"]
    faults, refusals = [], 0
    for place in places(scene):
        for wrong in WRONG:
            table = given = copy.deepcopy(scene)
            for key in place[:-1]:
                table = table[key]
            table[place[-1]] = wrong
            for module in ("warpriver.scenes.reading", "warpriver.io.tables"):
                monkeypatch.setattr(f"{module}.read_toml", lambda path, what, given=given: given)
            try:
                read_scene(folder / "bend.toml")
            except WarpriverError as error:
                refusals += 1
                if "bend.toml" not in str(error) or "\n" in str(error):
                    faults.append((place, wrong, str(error)))
            except Exception as error:
                faults.append((place, wrong, repr(error)))
    assert faults == [] and refusals > 300


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[run]\nyears = 1\n", r"there is no \[network\]"),
        ("[network]\n[run]\nyears = 1\n", "network has none of file, extract and channel; give one of them"),
        ("network = 3\n[run]\nyears = 1\n", r"network = 3; give a table, \[network\]"),
        ("[network]\nextract = {min_drainage_area = 1e6}\n[run]\nyears = 1\n", r"there is none; give \[terrain\]"),
        ("[network]\nfile = 'rivers.gpkg'\n[run]\nyears = 1\n", "network.file = 'rivers.gpkg': there is no such file"),
        ("[network]\nfile = 3\n[run]\nyears = 1\n", "network.file = 3; give the name of a file of lines"),
        ("[network\n", "not TOML"),
        ("length = 3.0\nwidth = 3.0\nslope = 0.1\n", "is a valley file, no scene"),
        (
            "[[network.channel]]\npoints = [[0, 0], [900, 0]]\nwidth = 20\n[[edit]]\ntime = 0\nkind = 'EditTerrain'\n"
            "operation = 'raise'\ncenter = [0, 0]\nradius = 9\namount = 1\n[run]\nyears = 1\n",
            r"edit\[0\] is an edit of the ground, and there is none; give \[terrain\]",
        ),
    ],
)
def test_each_wrong_table_is_refused_by_name(folder, text, match):
    refused(folder, text, match)


def test_files_of_other_folders_are_read_where_the_user_names_these(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    (folder / "guide.csv").rename(other / "guide.csv")
    text = SCENE.replace('"guide.csv"', json.dumps(str(other / "guide.csv")))
    refused(folder, text, "or name its folder")
    (folder / "named.toml").write_text(text)
    scene = read_scene(folder / "named.toml", folders=[other])
    np.testing.assert_array_equal(scene.controls[2].control.xy, GUIDE)
    # A link out of the folder is no way round.
    (folder / "linked.csv").symlink_to(other / "guide.csv")
    refused(folder, SCENE.replace('"guide.csv"', '"linked.csv"'), "lies outside of the folder")


def test_what_comes_out_while_a_scene_is_made_or_played_names_its_place(folder):
    short = SCENE.replace("shape = [60, 100]", "shape = [1, 100]")
    (folder / "short.toml").write_text(short)
    with pytest.raises(WarpriverError, match=r"short.toml: terrain: shape is \(1, 100\)"):
        read_scene(folder / "short.toml").run(folder / "out")
    (folder / "strange.toml").write_text(SCENE.replace("channel = 0\nat", "channel = 5\nat"))
    with pytest.raises(WarpriverError, match=r"strange.toml: edit\[1\] \(LockPoint\), after 7 steps: .*channel"):
        read_scene(folder / "strange.toml").run(folder / "out")
    # What ran before it is there.
    assert wr.read_history(folder / "out" / "run").times[-1] > 2.0


def test_a_session_of_another_seed_is_refused(folder):
    edits.write_edits(folder / "s.json", [(3, edits.RemoveChannel(1))], seed=4, steps=5)
    text = '[[network.channel]]\npoints = [[0, 0], [900, 0]]\nwidth = 20\n[session]\nfile = "s.json"\n[run]\nseed = 3\n'
    refused(folder, text, "run.seed = 3; the session has the seed 4")
    (folder / "good.toml").write_text(text.replace("seed = 3", "dtype = 'float32'"))
    scene = read_scene(folder / "good.toml")
    assert (scene.run_plan.seed, scene.run_plan.steps, scene.edits[0].step) == (4, 5, 3)


# ---- sources


def test_networks_come_from_files_and_terrains_and_controls_from_rasters(folder):
    line = wr.generate.noisy_line(4000.0, 40.0, 60.0, 2) + [500.0, 2000.0]
    wr.write_network(wr.RiverNetwork.from_polylines([line], width=50.0), folder / "river.geojson")
    wr.write_terrain(wr.generate.fluvial_terrain((40, 50), 100.0, 300.0, 1), folder / "ground.npz")
    factors = wr.generate.cone((10, 12), 400.0, 1e-4).raster
    wr.io.write_raster(factors, folder / "factors.npz")
    (folder / "file.toml").write_text(
        '[terrain]\nfile = "ground.npz"\n[network]\nfile = "river.geojson"\nwidth = 30.0\n[run]\nsteps = 3\n'
        '[[control]]\nkind = "ErodibilityField"\nfile = "factors.npz"\n'
        '[[control]]\nkind = "ControlField"\nbounds = [500, 1500, 4500, 2500]\ncell_size = 50\n'
        "stroke = [{center = [2500, 2000], radius = 300, amount = 20}, "
        "{operation = 'erase', center = [600, 1600], radius = 90}]\n"
    )
    scene = read_scene(folder / "file.toml")
    sim = scene.simulation()
    assert sim.network.channel_width.tolist() == [30.0] and len(sim.controls) == 2
    assert sim.controls[1].raster.numpy().max() == pytest.approx(20.0, rel=0.05)
    before = sim.network.points()
    scene.play(sim)
    assert not np.array_equal(before, sim.network.points())
    (folder / "found.toml").write_text(
        '[terrain]\nfile = "ground.npz"\n[network.extract]\nmin_drainage_area = 1e6\n[run]\nsteps = 2\n'
    )
    found = read_scene(folder / "found.toml").simulation().network
    expected = wr.extract_network(wr.read_terrain(folder / "ground.npz"), min_drainage_area=1e6)
    assert found.channel_count == expected.channel_count


def test_a_channel_leaves_its_course_by_hand(folder):
    (folder / "hand.toml").write_text(
        '[[network.channel]]\ngenerate = "noisy_line"\nlength = 8000\nspacing = 40\namplitude = 80\nseed = 1\n'
        "width = 50\n"
        '[run]\nyears = 3\n[[edit]]\ntime = 2.0\nkind = "AvulseChannel"\nchannel = 0\nat = 3000.0\nangle = 15.0\n'
    )
    (avulsion,) = read_scene(folder / "hand.toml").run().avulsions
    assert avulsion.time == pytest.approx(2.03, abs=0.01) and len(avulsion.course) > 3


def test_lines_of_another_system_and_polygons_are_refused(folder):
    wr.write_network(wr.RiverNetwork.from_polylines([GUIDE], width=1.0, crs="EPSG:32619"), folder / "guide.geojson")
    text = SCENE.replace("guide.csv", "guide.geojson")
    (folder / "far.toml").write_text(
        text.replace("[[network.channel]]", '[network]\ncrs = "EPSG:32620"\n\n[[network.channel]]', 1)
    )
    with pytest.raises(WarpriverError, match=r"control\[2\].file = 'guide.geojson' has the CRS EPSG:32619, the rivers"):
        read_scene(folder / "far.toml").simulation()
    ring = {"type": "Polygon", "coordinates": [[[0, 0], [900, 0], [900, 900], [0, 0]]]}
    feature = {"type": "Feature", "properties": {}, "geometry": ring}
    (folder / "guide.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    refused(folder, SCENE.replace("guide.csv", "guide.geojson"), "it holds 1 Polygon; give the outlines of polygons as")


def test_lines_are_turned_moved_and_shaped(folder):
    (folder / "turned.toml").write_text(
        "[network]\nshape_junctions = true\n"
        '[[network.channel]]\ngenerate = "straight_line"\nlength = 1000\nspacing = 10\nwidth = 20\nturn = 90\n'
        "offset = [500, -1000]\n"
        "[[network.channel]]\npoints = [[-500, -300], [500, 0]]\nwidth = 20\n"
        "[[network.channel]]\npoints = [[500, 0], [500, 1000]]\nwidth = 28\n[run]\nsteps = 0\n"
    )
    scene = read_scene(folder / "turned.toml")
    lines = scene.network.make(None).polylines()
    np.testing.assert_allclose(lines[0][[0, -1]], [(500.0, -1000.0), (500.0, 0.0)], atol=1e-9)
    ends = [3.0 * xy[-1] - 4.0 * xy[-2] + xy[-3] for xy in lines[:2]]
    # Against the direction of the channel below, north. Rivers of like flow: 28 degrees; the first one arrives straight
    # from the south, and so from no side.
    assert np.degrees(np.arctan2(ends[1][0], ends[1][1])) == pytest.approx(28.0, abs=0.2)


def test_every_preset_and_solver_is_read(folder):
    line = "[[network.channel]]\npoints = [[0, 0], [900, 0]]\nwidth = 60\n[run]\nsteps = 2\n"
    for params, expected in (
        ('preset = "paper"', wr.MeanderParams.paper()),
        ('preset = "paper"\nspacing = 40.0', wr.MeanderParams.paper().replace(spacing=40.0)),
        ("junctions = false", wr.MeanderParams(junctions=None)),
        ("[params.junctions]\nreach = 8.0", wr.MeanderParams(junctions=wr.meander.JunctionParams(reach=8.0))),
        ('solver = "path"\nblur_length = 2.0', wr.PathMeander(blur_length=2.0)),
        ("", wr.MeanderParams()),
    ):
        (folder / "params.toml").write_text(f"[params]\n{params}\n{line}")
        assert read_scene(folder / "params.toml").params == expected


# ---- what is told


def test_the_schema_lists_every_key():
    lines = scene_schema().splitlines()
    keys = {line.split(" ", 1)[0] for line in lines}
    classes = [*edit_names().values(), wr.MeanderParams, wr.PathMeander, wr.AvulsionParams]
    classes += [wr.meander.JunctionParams, wr.FloodplainParams, wr.ChuteParams, wr.WidthParams, Attractor, Guide]
    tables = {"avulsions", "junctions", "floodplain", "chutes", "widths"}
    fields = {field.name for kind in classes for field in dataclasses.fields(kind)} - tables
    assert fields | set(OUTPUT) | set(PICTURE) | set(PLAN) | {"polygon", "stroke", "generate", "turn"} <= keys
    for name in (*CONTROLS, *edit_names(), "noisy_line", "fluvial_terrain", "mountain_front"):
        assert f'= "{name}":' in scene_schema()
    assert ":class:" not in scene_schema() and "``" not in scene_schema()


def test_a_scene_is_described_as_it_was_understood(folder):
    text = describe_scene(read_scene(folder / "bend.toml"))
    for told in (
        "tilted_plain, shape (60, 100)",
        "migration_rate 80",
        "5 yr to 12 yr: Repeller(center",
        "69 steps",
        "after 7 steps, 2.031 yr: LockPoint(channel 0",
        "seed 7",
        "Guide(xy 3 points",
        "belt.png",
    ):
        assert told in text, told


def said(capsys, *words):
    code = main([str(word) for word in words])
    out = capsys.readouterr()
    return code, out.out, out.err


def test_the_command_runs_a_scene(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    code, out, err = said(capsys, "simulate", "bend.toml", "--no-progress", "--threads", 1)
    assert code == 0 and "out/bend/run" in out and "out/bend/belt.png" in out, err
    assert said(capsys, "info", "bend.toml")[1].splitlines() == describe_scene(read_scene("bend.toml")).splitlines()
    assert said(capsys, "simulate", "--schema")[1].strip() == scene_schema()
    code, _, err = said(capsys, "simulate", "bend.toml", "--no-progress")
    assert code == 2 and "holds an earlier run" in err
    for words in (("--years", "3"), ("--width", "30"), ("--record-every", "2"), ("--migration-rate", "3")):
        code, _, err = said(capsys, "simulate", "bend.toml", *words)
        assert code == 2 and words[0] in err and "says that itself" in err
    code, _, err = said(capsys, "simulate", "guide.csv", "--width", "30", "--allow", "x")
    assert code == 2 and "--allow is for a scene" in err
    assert said(capsys, "simulate")[0] == 2


def test_the_command_names_folders(folder, capsys, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    (folder / "guide.csv").rename(other / "guide.csv")
    (folder / "bend.toml").write_text(SCENE.replace('"guide.csv"', json.dumps(str(other / "guide.csv"))))
    code, _, err = said(capsys, "info", folder / "bend.toml")
    assert code == 2 and "--allow" in err and err.count("\n") == 1
    assert said(capsys, "info", folder / "bend.toml", "--allow", other)[0] == 0


def test_scenes_and_valleys_are_told_apart(folder, capsys):
    wr.io.write_valley(wr.valley.ValleyParams(), folder / "valley.toml")
    code, _, err = said(capsys, "valley", folder / "bend.toml", "-o", folder / "v.tif")
    assert code == 2 and "is a scene, no valley" in err
    code, _, err = said(capsys, "simulate", folder / "valley.toml")
    assert code == 2 and "is a valley file, no scene" in err
    code, _, err = said(capsys, "convert", folder / "bend.toml", "-o", folder / "b.gpkg")
    assert code == 2 and "warpriver simulate" in err
    assert "Scene('bend'" in said(capsys, "info", folder / "bend.toml")[1]
    assert "Valley" in said(capsys, "info", folder / "valley.toml")[1]


@pytest.mark.usefixtures("coarse_pictures")
def test_every_kind_of_picture_is_drawn(folder):
    kinds = {
        "belt.png": 'of = "belt"\ncontrols = true\nuntil = 8.0\nlegend = false\nage_span = 9.0',
        "both.png": 'of = "before_after"\ncontrols = true\ntitle = "Before and after"',
        "map.png": 'of = "network"\ncontrols = true\ncolor = "width"\nwindow = [0, 1000, 9000, 6000]\nrelief = false',
        "film.gif": "fps = 4\nevery = 4\nsize = [300, 260]",
    }
    head = SCENE.split("[output]")[0]
    pictures = "".join(f'[[output.picture]]\nfile = "{name}"\ndpi = 24\n{text}\n' for name, text in kinds.items())
    field = '[[control]]\nkind = "ControlField"\nbounds = [2000, 2000, 4000, 4000]\ncell_size = 100\n'
    attractor = '[[control]]\nkind = "Attractor"\ncenter = [3000, 3000]\nradius = 500\n'
    (folder / "drawn.toml").write_text(f"{head}{field}{attractor}[output]\nrun = false\n{pictures}")
    read_scene(folder / "drawn.toml").run(folder / "drawn")
    assert sorted(path.name for path in (folder / "drawn").iterdir()) == sorted(kinds)
    assert all((folder / "drawn" / name).stat().st_size > 1000 for name in kinds)
    (folder / "small.toml").write_text(f'{head}[output]\n[[output.picture]]\nfile = "b.png"\nsize = [16, 16]\n')
    with pytest.raises(WarpriverError, match=r"small.toml: output.picture\[0\]: size is \(16, 16\) pixels, too small"):
        read_scene(folder / "small.toml").run(folder / "small")
    assert wr.read_history(folder / "small" / "run").times[-1] > 19.0


def test_without_outputs_what_lines_get_is_written(folder):
    (folder / "plain.toml").write_text(
        '[[network.channel]]\ngenerate = "straight_line"\nlength = 3000\nspacing = 20\nwidth = 30\n[run]\nsteps = 2\n'
    )
    outputs = read_scene(folder / "plain.toml").outputs
    assert outputs.run and outputs.names() == ["run", "channels.csv", "rivers.gpkg", "belt.png"]
