"""Valley files, surfaces on disk, the command, and the pictures."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest

import warpriver as wr
from warpriver import generate
from warpriver import valley as g
from warpriver.cli import main
from warpriver.io.valleys import valley_schema
from warpriver.valley.examples import EXAMPLES
from warpriver.valley.terms import TERMS

FILE = """
name = "brook"
length = 200
slope = 0.004
width = 8.0
depth = 0.7
floor_width = 30.0
top_width = 20.0
top_height = 3.0

[control]
centerline = [{kind = "harmonic", amplitude = 12, frequency = 2}]
width = [{kind = "series", file = "widths.csv", column = "width", relative = true, harmonics = 4}]
left_floor = [{kind = "perlin", amplitude = 4.0, frequency = 6, seed = 3}]

[covariance]
partner = "width"
mean = -0.5
frequencies = [FREQUENCIES]

[section]
form = "trapezoid"
flat = 0.3

[[thread]]
start = 0.3
end = 0.8
offset = 25.0

[[objects]]
kind = "boulder"
density = 0.05
"""


def run(capsys, *arguments):
    code = main([str(a) for a in arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.fixture
def brook(tmp_path):
    """A valley file with a survey beside it."""
    u = np.linspace(0.0, 1.0, 120)
    width = 8.0 + 1.5 * np.sin(2 * np.pi * 3 * u) + 0.8 * np.cos(2 * np.pi * 7 * u)
    np.savetxt(tmp_path / "widths.csv", np.column_stack([200 * u, width]), delimiter=",", header="s,width", comments="")
    kept = g.strongest_harmonics(width / width.mean() - 1.0, 4)
    (tmp_path / "brook.toml").write_text(FILE.replace("FREQUENCIES", ", ".join(repr(h.frequency) for h in kept[:2])))
    return tmp_path / "brook.toml"


def test_a_file_becomes_a_valley(brook, device):
    params = wr.io.read_valley(brook)
    assert params.name == "brook" and params.length == 200 and params.bankfull_depth == 0.7
    valley = wr.synthetic_valley(params, device=device)
    assert valley.covariance.mean_thalweg_width == pytest.approx(-0.5, abs=0.02)
    assert len(valley.threads) == 1 and np.isfinite(valley.terrain.to_numpy()).all()
    width = valley.stations.width[valley.stations.reach]
    survey = np.loadtxt(brook.parent / "widths.csv", delimiter=",", skiprows=1)[:, 1]
    np.testing.assert_allclose([width.min(), width.max()], [survey.min(), survey.max()], rtol=0.05)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_survive_a_file(name, tmp_path):
    wr.io.write_valley(EXAMPLES[name], tmp_path / "v.toml")
    assert wr.io.read_valley(tmp_path / "v.toml") == EXAMPLES[name]


def test_every_term_and_table_survives_a_file(tmp_path):
    params = wr.valley.ValleyParams(
        controls={
            "width": (g.Series((1.0, 2.0, 1.5), relative=True, amplitude=0.1),),
            "bank": tuple(kind() for kind in TERMS.values()),
        },
        section=g.CrossSection("weibull", threads=((0.0, 0.3, 2.0, 1.0),)),
        covariance=g.CovarianceTarget("width", None, (1.0, 2.0), (0.5, -0.5)),
        profile=g.LongProfile("power", 20.0, 0.7), bank_window=30.0, floor_window=50.0,
        patches=(g.RoughnessPatch(((0.0, 0.0), (10.0, 0.0), (5.0, 4.5))),),
        stamps=(g.MeshStamp(((0.0, 0.0, 0.0), (1.0, 0.0, 0.5), (0.0, 1.0, 1.0)), ((0, 1, 2),), mode="keep"),),
        threads=(g.Thread(),), objects=(g.ObjectField(), g.ObjectField(kind="log")), depth=1.0, valley_slope=0.01,
    )  # fmt: skip
    wr.io.write_valley(params, tmp_path / "v.toml")
    assert wr.io.read_valley(tmp_path / "v.toml") == params
    line = np.array([[0.0, 0.0], [100.0, 10.0], [200.0, -5.0], [300.0, 0.1]])
    wr.io.write_valley(dataclasses.replace(params, line=line), tmp_path / "v.toml")
    np.testing.assert_array_equal(wr.io.read_valley(tmp_path / "v.toml").line, line)
    with pytest.raises(ValueError, match="cannot hold <function"):
        wr.io.write_valley(wr.valley.ValleyParams(controls={"width": (lambda u: u,)}), tmp_path / "v.toml")


def test_two_targets_and_a_mesh_of_a_file_survive(tmp_path):
    targets = (g.CovarianceTarget("width", 0.5, (1.0, 2.0)), g.CovarianceTarget("curvature", -0.2, (2.0, 3.0)))
    params = wr.valley.ValleyParams(covariance=targets)
    wr.io.write_valley(params, tmp_path / "v.toml")
    assert wr.io.read_valley(tmp_path / "v.toml").covariance == targets
    (tmp_path / "weir.obj").write_text("v 0 0 0\nv 4 0 0\nv 4 3 1\nv 0 3 1\nf 1 2 3 4\n")
    text = (tmp_path / "v.toml").read_text()
    pytest.importorskip("pyvista")
    (tmp_path / "v.toml").write_text(text + '[[stamp]]\nfile = "weir.obj"\nplace = [20, 1]\nscale = 2\n')
    (stamp,) = wr.io.read_valley(tmp_path / "v.toml").stamps
    assert len(stamp.triangles) == 2 and stamp.place == (20.0, 1.0)
    np.testing.assert_array_equal(stamp.bounds, [[20.0, 1.0], [28.0, 7.0]])
    (tmp_path / "v.toml").write_text(text + '[[stamp]]\nfile = "none.obj"\n')
    with pytest.raises(ValueError, match=r"stamp\[0\].file = 'none.obj': there is no such file beside it"):
        wr.io.read_valley(tmp_path / "v.toml")


def test_a_line_may_lie_in_a_file_beside_it(tmp_path, device):
    line = generate.valley_line(900.0, 10.0, 40.0, 300.0, seed=1)
    wr.io.write_network(wr.RiverNetwork.from_polylines([line], width=20.0), tmp_path / "river.csv")
    (tmp_path / "v.toml").write_text('slope = 0.001\ndepth = 1.0\nwidth = 20.0\n[line]\nfile = "river.csv"\n')
    valley = wr.synthetic_valley(wr.io.read_valley(tmp_path / "v.toml"), device=device)
    assert valley.sinuosity == pytest.approx(wr.metrics.sinuosity(line), rel=1e-3)
    (tmp_path / "v.toml").write_text('[line]\nfile = "river.csv"\nchannel = 3\n')
    with pytest.raises(ValueError, match=r"v\.toml: line\.channel = 3; river\.csv has channels 0 to 0"):
        wr.io.read_valley(tmp_path / "v.toml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("width = ", "bad.toml: not TOML"),
        ("widht = 3", r"bad.toml: widht = 3 is no key of a valley; did you mean width\?"),
        ("width = -3", r"bad.toml: width is -3 m; the range is \(0"),
        ('width = "wide"', "bad.toml: width is 'wide'; give a finite number"),
        ("width = nan", "bad.toml: width is nan"),
        ("increments = 10.5", "bad.toml: increments is 10.5; give a whole number"),
        ("slope = 0", "bad.toml: slope is 0, where the Shields depth"),
        ('depth = "deep"', "bad.toml: depth = 'deep'; give a number of unit m"),
        ("depth = -1", "bad.toml: depth is -1; give a finite number above 0"),
        ("name = 3", "bad.toml: name = 3; give text"),
        ("control = 3", "bad.toml: control = 3; give a table of elements"),
        ("control.with = []", r"bad.toml: control.with is no element; did you mean width\?"),
        ("control.width = 3", "bad.toml: control.width = 3; give a list of tables"),
        ("control.width = [{}]", r"bad.toml: control.width\[0\].kind = None is no function; use one of"),
        (
            'control.width = [{kind = "harmonc"}]',
            r"bad.toml: control.width\[0\].kind = 'harmonc' is no function; did you mean harmonic\?",
        ),
        (
            'control.width = [{kind = "harmonic"}, {kind = "harmonic", amplitud = 3}]',
            r"bad.toml: control.width\[1\].amplitud = 3 is no key there; did you mean amplitude\?",
        ),
        (
            'control.width = [{kind = "harmonic", amplitude = "big"}]',
            r"bad.toml: control.width\[0\].amplitude is 'big'; give a finite number",
        ),
        (
            'control.width = [{kind = "series", values = [1.0, nan]}]',
            r"bad.toml: control.width\[0\].values\[1\] is nan; give finite numbers",
        ),
        (
            'control.width = [{kind = "spline", positions = [0.0, 1.0], values = [1.0, 2.0, 3.0]}]',
            r"bad.toml: control.width\[0\] has 2 positions and 3 values",
        ),
        (
            'control.width = [{kind = "series", file = "none.csv"}]',
            r"bad.toml: control.width\[0\].file = 'none.csv': there is no such file",
        ),
        ('section.form = "round"', "bad.toml: section.form is 'round'; use one of"),
        ("section.threads = [[1, 2]]", "bad.toml: section.threads must hold 1 to 8 rows"),
        ("section = 3", "bad.toml: section = 3; give a table"),
        ("thread = [{start = 0.5, end = 0.4}]", r"bad.toml: thread\[0\].end is 0.4 and start 0.5"),
        ("thread = {start = 0.5}", "bad.toml: thread = .* give a list of tables"),
        ("objects = [{density = 0.0}]", r"bad.toml: objects\[0\].density is 0"),
        ("covariance = {means = 3}", r"bad.toml: covariance.means = 3 is no key there; did you mean mean\?"),
        ("line = 3", "bad.toml: line = 3; give file, and channel, or points"),
        ('line.points = [[0, "a"]]', r"bad.toml: line.points is no list"),
    ],
)
def test_schema_errors_name_file_key_and_value(text, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text(text + "\n")
    with pytest.raises(ValueError, match=message):
        wr.io.read_valley("bad.toml")


def test_a_series_of_a_file_is_checked(tmp_path):
    (tmp_path / "widths.csv").write_text("s,width\n0,3\n1,x\n")
    (tmp_path / "v.toml").write_text('control.width = [{kind = "series", file = "widths.csv", column = "depth"}]')
    with pytest.raises(ValueError, match=r"control\.width\[0\]\.column = 'depth': widths\.csv has no column of that"):
        wr.io.read_valley(tmp_path / "v.toml")
    (tmp_path / "v.toml").write_text('control.width = [{kind = "series", file = "widths.csv"}]')
    with pytest.raises(ValueError, match=r"control\.width\[0\]\.file = 'widths\.csv': line 3 has no number in col"):
        wr.io.read_valley(tmp_path / "v.toml")


@pytest.mark.parametrize(
    "text",
    [
        'control.width = [{{kind = "series", file = "{name}"}}]',
        'control.width = [{{kind = "series", file = "{name}", column = "x"}}]',
        '[line]\nfile = "{name}"\n',
        '[[stamp]]\nfile = "{name}"\nplace = [20, 1]\n',
    ],
    ids=["column", "named column", "line", "stamp"],
)
def test_files_outside_of_the_folder_are_refused_and_those_in_it_not_shown(tmp_path, text):
    (tmp_path / "in").mkdir()
    for folder in (tmp_path, tmp_path / "in"):
        for name in ("secret.csv", "secret.obj"):
            (folder / name).write_text("root:x:0:0:password\nroot:x:0\n")
    (tmp_path / "in" / "link.csv").symlink_to(tmp_path / "secret.csv")
    path = tmp_path / "in" / "v.toml"
    suffix = ".obj" if "stamp" in text else ".csv"
    for name in (f"../secret{suffix}", f"{tmp_path}/secret{suffix}", "link.csv", f"x/../../secret{suffix}"):
        path.write_text(text.format(name=name))
        with pytest.raises(ValueError, match="lies outside of the folder of the valley file"):
            wr.io.read_valley(path)
    path.write_text(text.format(name=f"secret{suffix}"))
    with pytest.raises(ValueError, match=r"v\.toml: |secret\.obj: holds no") as caught:
        wr.io.read_valley(path)
    assert "alice" not in str(caught.value) and "password" not in str(caught.value)


def test_a_file_that_is_nested_too_deeply_is_no_traceback(tmp_path):
    (tmp_path / "v.toml").write_text("slope = " + "[" * 100_000 + "]" * 100_000)
    with pytest.raises(ValueError, match=r"v\.toml: not TOML"):
        wr.io.read_valley(tmp_path / "v.toml")


def test_the_schema_lists_every_key(capsys):
    text = valley_schema()
    assert run(capsys, "valley", "--schema")[:2] == (0, text + "\n")
    for kind in (wr.valley.ValleyParams, g.CrossSection, g.CovarianceTarget, g.Thread, g.ObjectField, *TERMS.values()):
        for f in dataclasses.fields(kind):
            if f.metadata:
                assert f.name in text and f.metadata["doc"] in text
    assert all(name in text for name in TERMS)


# ---- surfaces


@pytest.fixture(scope="module")
def small(device):
    return wr.synthetic_valley("S3", increments=60, device=device)


def test_points_are_written(small, tmp_path):
    grid = small.grid(3.0)
    for name, options in (("p.xyz", {}), ("p.csv", {"delimiter": ",", "skiprows": 1})):
        wr.io.write_points(grid, tmp_path / name)
        np.testing.assert_allclose(np.loadtxt(tmp_path / name, **options), grid.points(), atol=1e-4)
    wr.io.write_points(grid, tmp_path / "p.npz")
    np.testing.assert_array_equal(np.load(tmp_path / "p.npz")["xyz"], grid.xyz)
    with pytest.raises(ValueError, match=r"p\.dat: the name must end in \.xyz"):
        wr.io.write_points(grid, tmp_path / "p.dat")


def test_meshes_are_written(small, tmp_path):
    grid = small.grid(3.0)
    wr.io.write_mesh(grid, tmp_path / "m.obj")
    rows = (tmp_path / "m.obj").read_text().splitlines()
    assert sum(row.startswith("v ") for row in rows) == len(grid.points())
    faces = np.array([row.split()[1:] for row in rows if row.startswith("f ")], int)
    np.testing.assert_array_equal(faces - 1, grid.triangles())
    pyvista = pytest.importorskip("pyvista")
    for suffix in ("ply", "stl", "vtp"):
        wr.io.write_mesh(grid, tmp_path / f"m.{suffix}")
        mesh = pyvista.read(tmp_path / f"m.{suffix}")
        assert mesh.n_cells == len(grid.triangles())
        # STL holds float32: heights of 1,000 m to 1e-4 m.
        np.testing.assert_allclose(
            np.array(mesh.bounds).reshape(3, 2).T, [grid.points().min(0), grid.points().max(0)], atol=1e-3
        )


def test_breaklines_are_written(small, tmp_path):
    lines = small.breaklines()
    wr.io.write_breaklines(lines, tmp_path / "b.geojson", crs="EPSG:32619")
    data = json.loads((tmp_path / "b.geojson").read_text())
    assert "EPSG::32619" in data["crs"]["properties"]["name"]
    found = {f["properties"]["name"]: np.array(f["geometry"]["coordinates"]) for f in data["features"]}
    assert set(found) == {"thalweg", "left_bank", "right_bank", "left_floor", "right_floor", "left_top", "right_top"}
    for name, xyz in lines.items():
        np.testing.assert_allclose(found[name], xyz, atol=1e-4)
    wr.io.write_breaklines(lines, tmp_path / "b.csv")
    assert len((tmp_path / "b.csv").read_text().splitlines()) == 1 + sum(len(xyz) for xyz in lines.values())


def test_breaklines_lie_on_the_surface(small):
    for name, xyz in small.breaklines().items():
        inside = (xyz[:, 0] > 1.0) & (xyz[:, 0] < 419.0)
        height = small.height(xyz[inside, :2])
        # A bank is as steep as a wall on one side: there the surface is that on either side.
        off = np.abs(height - xyz[inside, 2])
        assert np.median(off) < 1e-6, name
        if "bank" not in name:
            assert off.max() < 1e-6, name


# ---- command and pictures


def test_the_command_writes_a_folder(brook, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    code, said, err = run(capsys, "valley", brook, "-o", tmp_path / "out", "--mesh-spacing", 1)
    assert code == 0, err
    assert "sinuosity" in said and "mean c(z_T, W) -0.5" in said
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"channel.csv", "points.csv", "mesh.obj", "breaklines.geojson", "valley.toml", "valley.png"} <= names
    assert {"terrain.tif", "terrain.npz"} & names
    network = wr.read_network(tmp_path / "out" / "channel.csv")
    assert network.channel_count == 4
    terrain = wr.read_terrain(next((tmp_path / "out").glob("terrain.*")))
    np.testing.assert_allclose(
        terrain.to_numpy(), wr.synthetic_valley(wr.io.read_valley(brook)).terrain.to_numpy(), atol=1e-3
    )
    again = wr.io.read_valley(tmp_path / "out" / "valley.toml")
    assert again.length == 200.0


@pytest.mark.parametrize("name", ["t.asc", "t.npz", "p.xyz", "m.obj", "b.geojson", "v.toml"])
def test_the_command_writes_what_the_ending_says(name, tmp_path, capsys):
    code, said, err = run(
        capsys, "valley", "S1", "-o", tmp_path / name, "--cell-size", 4, "--mesh-spacing", 3, "--set", "increments=50"
    )
    assert code == 0, err
    assert (tmp_path / name).stat().st_size > 0 and str(tmp_path / name) in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["S7"], "valley is 'S7'; use one of S1"),
        ([], "name an example, S1 to S6, or a TOML file"),
        (["none.toml"], "No such file"),
        (["S1", "--set", "width"], "--set width: give KEY=VALUE"),
        (["S1", "--set", "wdth=3"], "'wdth' is no field of ValleyParams"),
        (["S1", "--set", "width=-3"], "width is -3 m"),
        (["S1", "--set", "grain_size=0"], "grain_size is 0 m"),
        (["S1", "--set", "slope=0"], "Shields depth of eq. 4 is infinite"),
        (["S3", "--set", "width=300"], "exceeds twice the radius of the bend"),
        (["S1", "--device", "cuda:9"], "device 'cuda:9' is not on this machine"),
        (["S1", "-o", "x.docx"], "names no format of what is to be written"),
    ],
)
def test_bad_commands_end_with_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, "valley", *arguments)
    assert code == 2
    assert message in err and len(err.strip().splitlines()) == 1


def test_the_command_runs_on_its_own(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "warpriver", "valley", "S2", "-o", str(tmp_path / "s2.npz")],
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert wr.read_terrain(tmp_path / "s2.npz").shape == wr.synthetic_valley("S2").terrain.shape


@pytest.mark.parametrize("name", ["S2", "S5"])
def test_pictures_show_the_surface_and_the_covariance(name, tmp_path):
    pytest.importorskip("matplotlib")
    valley = wr.synthetic_valley(name, increments=200)
    figure = wr.viz.draw_valley(valley, tmp_path / "valley.png", interval=2.0, dpi=60)
    surface, _, covariance = figure.axes
    (contours,) = [c for c in surface.collections if hasattr(c, "levels")]
    np.testing.assert_allclose(np.diff(contours.levels), 2.0)
    curve = [line for line in covariance.get_lines() if str(line.get_label()).startswith("c(z")]
    assert len(curve) == (1 if name == "S2" else 2)
    np.testing.assert_allclose(curve[0].get_ydata(), valley.covariance.thalweg_width)
    figure = wr.viz.draw_valley_sections(valley, tmp_path / "sections.png", dpi=60)
    assert len(figure.axes) == (3 if name == "S2" else 5)
    assert all((tmp_path / f"{k}.png").stat().st_size > 5000 for k in ("valley", "sections"))
    with pytest.raises(ValueError, match="positions are"):
        wr.viz.draw_valley_sections(valley, positions=[1.5])
    with pytest.raises(ValueError, match="interval is 0"):
        wr.viz.draw_valley(valley, interval=0.0)
