import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from warpriver import LehenyParams, RiverNetwork, Terrain, bench, erode, extract_network, generate, read_terrain
from warpriver.cli import main
from warpriver.cli.info import describe_device, describe_gpus
from warpriver.edits import write_edits
from warpriver.history import History
from warpriver.io import read_network, write_network, write_terrain
from warpriver.params import ChuteParams, FloodplainParams, WidthParams
from warpriver.riverscape import AddRock, read_riverscape

pytestmark = pytest.mark.usefixtures("coarse_pictures")


@pytest.fixture
def river(tmp_path):
    """A small CSV river, 60 m wide."""
    line = generate.noisy_line(9_000.0, 30.0, 60.0, 4)
    write_network(RiverNetwork.from_polylines([line], width=60.0, crs="EPSG:32619"), tmp_path / "river.csv")
    return tmp_path / "river.csv"


def run(capsys, *arguments):
    code = main([str(a) for a in arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_simulate_writes_run_lines_and_map_and_continues(river, tmp_path, capsys):
    out = tmp_path / "out"
    code, said, err = run(capsys, "simulate", river, "--years", 40, "--record-every", 20, "-o", out, "--no-progress")
    assert code == 0, err
    assert "sinuosity" in said and "ms a step" in said and str(out) in said
    for name in ("run/run.json", "channels.csv", "belt.png"):
        assert (out / name).stat().st_size > 0, name
    first = History.load(out / "run")
    assert first.crs == "EPSG:32619" and first.steps[-1] == 138 and first.params.spacing == 50.0
    assert "EPSG:32619" in (out / "channels.csv").read_text().splitlines()[1]
    code, _, err = run(capsys, "simulate", out / "run", "--years", 10, "--no-progress")
    assert code == 0, err
    assert History.load(out / "run").steps[-1] == 138 + 35


def test_network_finds_rivers_that_simulate_takes_on(tmp_path, capsys):
    write_terrain(generate.fluvial_terrain((120, 120), 50.0, 300.0, seed=2), tmp_path / "dem.npz")
    code, said, err = run(capsys, "network", tmp_path / "dem.npz", "--min-area", 0.5, "-o", tmp_path / "rivers.csv")
    assert code == 0, err
    assert "channels" in said and "km2" in said
    arguments = ["simulate", tmp_path / "rivers.csv", "--terrain", tmp_path / "dem.npz", "--years", 5, "--no-progress"]
    code, _, err = run(capsys, *arguments, "-o", tmp_path / "out")
    assert code == 0, err
    assert History.load(tmp_path / "out" / "run").networks[-1].channel_count > 3
    code, _, err = run(capsys, "network", tmp_path / "dem.npz", "--min-area", 1e9, "-o", tmp_path / "none.csv")
    assert code == 2 and err.count("\n") == 1 and not (tmp_path / "none.csv").exists()


@pytest.mark.parametrize("start", ["plane", "peak", "file"])
def test_erode_writes_terrain_rivers_and_pictures(start, tmp_path, capsys):
    arguments = ["--size", "60x40"]
    if start == "file":
        write_terrain(generate.fractal_terrain((40, 60), 10.0, 80.0, 3), tmp_path / "dem.npz")
        arguments, start = (
            ["--fill", "--cut-depth", 0.5, "--slide-threshold", 40, "--flow-bias", 1],
            tmp_path / "dem.npz",
        )
    arguments += ["--start", start, "--events", 600, "--min-area", "20cells", "--no-progress", "-o", tmp_path / "out"]
    code, said, err = run(capsys, "erode", *arguments, "--movie", "growth.gif", "--frames", 4)
    assert code == 0, err
    for word in ("600 events", "slides", "m3 removed", "orders", "Hack"):
        assert word in said, word
    for name in ("terrain.npz", "rivers.csv", "elevation.png", "drainage.png", "network.png", "growth.gif"):
        assert (tmp_path / "out" / name).stat().st_size > 0, name
    assert read_terrain(tmp_path / "out" / "terrain.npz").shape == (40, 60)


def test_every_parameter_of_erode_is_a_flag(tmp_path, capsys):
    flags = "--size 30x40 --cell-size 5 --slope 0.2 --edges closed,open,closed,closed --events 300 --flow-bias 0.1 "
    flags += "--cut-depth 2 --slide-threshold 30 --neighbors 4 --seed 7 --batch 4 --dtype float32 --min-area 10cells"
    flags += " --base-level -20"
    code, said, err = run(capsys, "erode", *flags.split(), "-o", tmp_path, "--no-progress")
    assert code == 0 and "40 x 30 cells of 5 m" in said, err
    params = LehenyParams(flow_bias=0.1, depth=2.0, slide_threshold=30.0, neighbors=4)
    edges = ("closed", "open", "closed", "closed")
    plane = generate.erosion_plane((40, 30), 5.0, 0.2)
    expected = erode(plane, params, events=300, seed=7, edges=edges, batch=4, dtype="float32", base_level=-20.0)
    assert (read_terrain(tmp_path / "terrain.npz").to_numpy() == expected.to_numpy()).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--size", "300x1"], "at least 2 of each"),
        (["--size", "big"], "such as 300x200"),
        (["--events", "-1"], "--events: '-1' is not a whole number"),
        (["--cut-depth", "0"], "--cut-depth is 0"),
        (["--flow-bias", "nan"], "--flow-bias is nan"),
        (["--slide-threshold", "-5"], "--slide-threshold is -5"),
        (["--slope", "0"], "slope is 0"),
        (["--edges", "closed"], "water has nowhere to go"),
        (["--edges", "open,closed"], "edges is"),
        (["--batch", "0"], "--batch: '0'"),
        (["--start", "nowhere.tif"], "nowhere.tif"),
        (["--start", "nowhere.tif", "--size", "30x30"], "--size is for a plane or peak"),
        (["--start", "flat.npz"], "the ground is level"),
        (["--movie", "film.avi"], "use .gif, .mp4"),
        (["--min-area", "1e9"], "--min-area"),
        (["--z-factor", "2"], "--start plane is none; leave it out"),
        (["--base-level", "deep"], "--base-level: 'deep'"),
    ],
)
def test_bad_input_of_erode_is_one_line(tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    write_terrain(Terrain(np.full((20, 20), 5.0), 10.0), tmp_path / "flat.npz")
    small = [] if {"--size", "--start"} & set(arguments) else ["--size", "30x30"]
    code, _, err = run(capsys, "erode", *small, "--events", 50, *arguments, "--no-progress")
    assert code == 2 and err.count("\n") == 1 and words in err and "Traceback" not in err
    assert not (tmp_path / "out").exists(), "nothing is begun on bad input"


def test_a_seed_is_that_of_the_banks(river, tmp_path, capsys):
    ends = []
    for name, seed in (("a", []), ("b", ["--seed", "0"]), ("c", ["--seed", "7"])):
        assert run(capsys, "simulate", river, "--width", 60, "--years", 3, *seed, "-o", tmp_path / name)[0] == 0
        ends.append(read_network(tmp_path / name / "channels.csv").points())
    assert np.array_equal(ends[0], ends[1]) and not np.array_equal(ends[0], ends[2])
    code, _, said = run(capsys, "simulate", tmp_path / "c" / "run", "--years", 1, "--seed", 8)
    assert code == 2 and "--seed 8: the run has the seed 7, and goes on with it; leave it out" in said
    assert run(capsys, "simulate", tmp_path / "c" / "run", "--years", 1, "--seed", 7)[0] == 0


def test_simulate_on_a_terrain(river, tmp_path, capsys):
    steep = generate.tilted_plain((200, 400), 30.0, 0.5)
    write_terrain(Terrain(steep.to_numpy(), 30.0, origin=(-1000.0, 3000.0), crs="EPSG:32619"), tmp_path / "steep.npz")
    arguments = ["simulate", river, "--terrain", tmp_path / "steep.npz", "--years", 20, "--no-progress"]
    code, _, err = run(capsys, *arguments, "-o", tmp_path / "out")
    assert code == 0, err
    history = History.load(tmp_path / "out" / "run")
    first, last = history.networks[0].polylines()[0], history.networks[-1].polylines()[0]
    # Too steep to move; resampling slides points along the line until their chords are even.
    np.testing.assert_allclose(first, last, atol=0.5)


def test_every_parameter_is_a_flag(river, tmp_path, capsys):
    flags = "--step-days 50 --spacing 20 --migration-rate 30 --friction 0.02 --local-weight -0.9 --upstream-weight 2 "
    flags += "--sinuosity-scaling whole --cutoff-distance 1.5 --cutoff-min-arc 6 --end-damping 2 --dtype float32"
    code, _, err = run(capsys, "simulate", river, "--years", 2, *flags.split(), "-o", tmp_path / "o", "--no-progress")
    assert code == 0, err
    history = History.load(tmp_path / "o" / "run")
    p = history.params
    assert (p.spacing, p.migration_rate, p.friction, p.local_weight, p.upstream_weight) == (20, 30, 0.02, -0.9, 2)
    assert (p.sinuosity_scaling, p.cutoff_distance, p.cutoff_min_arc, p.end_damping) == ("whole", 1.5, 6, 2)
    assert p.time_step == pytest.approx(50 / 365.25) and history.dtype == "float32"


def test_parts_of_the_model_are_flags_and_their_constants_are_set(river, tmp_path, capsys):
    flags = "--floodplain --inlet periodic --set chutes.rate=0.001 --set widths.lag=0.2 --set widths.time=5"
    flags += " --set avulsions.nearest=200 --set avulsions.farthest=300"
    code, _, err = run(capsys, "simulate", river, "--years", 1, *flags.split(), "-o", tmp_path / "o", "--no-progress")
    assert code == 0, err
    p = History.load(tmp_path / "o" / "run").params
    assert (p.floodplain, p.chutes, p.inlet) == (FloodplainParams(), ChuteParams(rate=0.001), "periodic")
    assert p.widths == WidthParams(lag=0.2, time=5.0) and p.avulsions.farthest == 300.0
    again = ("simulate", tmp_path / "o" / "run", "--years", 1, "--set", "chutes.longest=5", "--no-progress")
    code, _, err = run(capsys, *again)
    assert code == 0, err
    assert History.load(tmp_path / "o" / "run").last_params.chutes == ChuteParams(rate=0.001, longest=5.0)


def test_render_and_info_of_a_run(river, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(capsys, "simulate", river, "--years", 20, "-o", out, "--no-progress")[0] == 0
    for name, extra in (("a.png", []), ("b.gif", ["--every", "3"]), ("c.png", ["--until", "10"])):
        code, said, err = run(capsys, "render", out, "-o", tmp_path / name, *extra)
        assert code == 0, err
        assert (tmp_path / name).stat().st_size > 0 and name in said
    code, said, _ = run(capsys, "info", out / "run")
    assert code == 0 and "records" in said and "channel 0" in said
    code, said, _ = run(capsys, "render", river, "-o", tmp_path / "d.png")
    assert code == 0 and (tmp_path / "d.png").stat().st_size > 0


def test_info_says_what_the_installation_can_do(capsys):
    code, said, _ = run(capsys, "info")
    assert code == 0 and "device cpu" in said and "extra gis" in said
    assert re.search(r"^CUDA: driver (none|\d+\.\d+), toolkit of Warp (none|\d+\.\d+)$", said, re.MULTILINE)
    assert sum(line.startswith("GPU: ") for line in said.splitlines()) == max(1, said.count("device cuda"))


def gpu(**changed):
    """A GPU as Warp tells of it."""
    known = {"alias": "cuda:0", "name": "NVIDIA H100", "is_cuda": True, "arch": 90, "is_mempool_supported": True}
    return SimpleNamespace(**known | {"total_memory": 80 * 2**30, "free_memory": 79 * 2**30} | changed)


CPU = SimpleNamespace(alias="cpu", name="Xeon", is_cuda=False, arch=0, is_mempool_supported=False)


@pytest.mark.parametrize(
    ("gpus", "driver", "toolkit", "words"),
    [
        ([], None, None, ["runs on the CPU", "Warp has no CUDA"]),
        ([], None, (13, 4), ["runs on the CPU", "no NVIDIA driver"]),
        (
            [],
            (12, 9),
            (13, 4),
            ["runs on the CPU", "CUDA 12.9", "with 13.4", "R580 or newer", "for CUDA 12 ("],
        ),
        ([], (11, 8), (12, 9), ["runs on the CPU", "R525 or newer", "Warp for CUDA 11"]),
        ([], (13, 0), (15, 1), ["needs a driver for CUDA 15.0 or newer"]),
        # A driver of the same major version serves, however old.
        ([], (13, 0), (13, 4), ["runs on the CPU", "CUDA_VISIBLE_DEVICES"]),
        ([gpu(arch=70)], (13, 0), (13, 4), ["too old (sm_70)", "(sm_75) and newer", "for CUDA 12 (", 'device="cpu"']),
        ([gpu(arch=70)], (12, 4), (12, 9), ["cuda:0 runs steps of rivers", "run on the CPU"]),
        ([gpu(arch=75)], (13, 0), (13, 4), ["cuda:0 runs steps of rivers", "run on the CPU"]),
        ([gpu(is_mempool_supported=False)], (13, 0), (13, 4), ["no memory pool", "capture=False", "nvidia_uvm"]),
    ],
)
def test_info_says_what_a_gpu_will_do_and_what_to_do_where_it_will_not(gpus, driver, toolkit, words):
    (line,) = describe_gpus([CPU, *gpus], driver, toolkit)
    assert all(word in line for word in words), line
    assert ("runs on the CPU" in line) == (not gpus)


def test_info_tells_of_each_gpu_alone():
    first, second = describe_gpus([CPU, gpu(), gpu(alias="cuda:1", arch=61)], (13, 0), (13, 4))
    assert first.startswith("cuda:0 runs") and second.startswith("cuda:1 is too old")
    assert describe_device(CPU) == "Xeon"
    assert describe_device(gpu()) == "NVIDIA H100, sm_90, 80 GiB, 79 free, memory pool"
    assert describe_device(gpu(is_mempool_supported=False)).endswith("no memory pool")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "nowhere.csv", "--width", "50"], "nowhere.csv"),
        (["simulate", "{river}", "--spacing", "80", "--spacing-in-widths", "0"], "coarser than channel 0"),
        (["simulate", "{river}", "--z-factor", "2"], "none is given; leave it out"),
        (["simulate", "{river}", "--change-terrain"], "for a run that goes on"),
        (["simulate", "{river}", "--width", "-5"], "--width: '-5' is not a number of m above 0"),
        (["simulate", "{river}", "--width", "99999"], "99999"),
        (["simulate", "{river}", "--friction", "0"], "friction"),
        (["simulate", "{river}", "--set", "spacing=30"], "spacing has a flag, --spacing"),
        (["simulate", "{river}", "--set", "chute.rate=1"], "no part chute; did you mean chutes?"),
        (["simulate", "{river}", "--set", "chutes.rat=1"], "chutes has no rat; did you mean rate?"),
        (["simulate", "{river}", "--set", "chutes.rate=a lot"], "chutes.rate is 'a lot'; give a finite number"),
        (["simulate", "{river}", "--set", "widths.lag=2"], "--set widths.lag is 2 -; the range is [0, 1]"),
        (["simulate", "{river}", "--set", "junctions.ease=2", "--no-junctions"], "give one of the two"),
        (["simulate", "{river}", "--device", "cuda:17"], "it has: cpu"),
        (["simulate", "{river}", "--step-days", "9158400"], "is it in years"),
        (["simulate", "{river}", "--years", "nan"], "--years: 'nan' is not a number of years, 0 or more"),
        (["simulate", "{river}", "--record-every", "0"], "such as 20 or 20steps, 10yr"),
        (["simulate", "{river}", "-o", "{river}/x"], "river.csv"),
        (["simulate", "{full}"], "holds an earlier run"),
        (["simulate", "{text}", "--width", "50"], "text.csv"),
        (["render", "{river}", "-o", "x.gif"], "not a run"),
        (["render", "{river}", "-o", "x.bmp"], ".svg, .gif, .mp4"),
        (["info", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_bad_input_is_one_clear_line_and_exit_code_2(river, tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out" / "full" / "run").mkdir(parents=True)
    (tmp_path / "full.csv").write_bytes(river.read_bytes())
    (tmp_path / "text.csv").write_text("once upon a time\nthere was a river\nand another\n")
    places = {"river": river, "full": tmp_path / "full.csv", "text": tmp_path / "text.csv"}
    code, _, err = run(capsys, *[a.format(**places) for a in arguments])
    assert code == 2
    assert err.count("\n") == 1 and words in err and "Traceback" not in err
    assert not (tmp_path / "out" / "river" / "run").exists(), "nothing is begun on bad input"


def test_a_wrong_flag_exits_with_2(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["simulate", "x.csv", "--no-such-flag"])
    assert caught.value.code == 2
    with pytest.raises(SystemExit) as caught:
        main(["simulate", "x.csv", "--sprout", "3"])
    assert caught.value.code == 2
    assert capsys.readouterr().err.count("\n") == 2, "a line each"


def test_help_does_not_wait_for_warp_and_explains_units_and_defaults():
    code = "import sys, warpriver.cli\ntry: warpriver.cli.main(['simulate', '--help'])\n"
    code += "finally: assert 'warp' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for word in ("m/yr", "default 60.0", "widths", "examples:", "--step-days", "106"):
        assert word in done.stdout


def records_in(folder):
    """How many records a run has that is still being written."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return len(History.load(folder))
        except (OSError, ValueError):
            return 0


def test_an_interrupted_command_leaves_a_readable_run(river, tmp_path):
    # Few records, since the map draws each of them.
    command = [sys.executable, "-m", "warpriver", "simulate", str(river), "--years", "1e6", "--record-every", "50"]
    process = subprocess.Popen(
        [*command, "-o", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    run_file = tmp_path / "out" / "run" / "run.json"
    deadline = time.monotonic() + 60.0
    while records_in(run_file.parent) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "interrupted" in err and "Traceback" not in err
    history = History.load(tmp_path / "out" / "run")
    assert len(history) > 1 and np.isfinite(history.networks[-1].points()).all()
    assert json.loads(run_file.read_text())["stop_reason"] == "INTERRUPTED"


def write_grid(path, height, cell_size=50.0):
    """An ESRI ASCII grid."""
    rows, columns = height.shape
    head = f"ncols {columns}\nnrows {rows}\nxllcorner 0\nyllcorner 0\ncellsize {cell_size}\nNODATA_value -9999\n"
    path.write_text(head + "\n".join(" ".join(f"{v:.3f}" for v in row) for row in np.nan_to_num(height, nan=-9999.0)))


BAD_GROUND = {
    "one value": (np.full((60, 60), 7.0), "the terrain is level, 7 m in every cell"),
    "all no data": (np.full((60, 60), np.nan), "height is NaN in every cell"),
    "one row": (np.arange(60.0)[None], "its shape is (1, 60)"),
    "one column": (np.arange(60.0)[:, None], "its shape is (60, 1)"),
    "small islands": (np.kron(np.eye(20), [[1.0, np.nan], [np.nan, np.nan]]) * 5.0 + 1.0, "no channel"),
    "nothing": (None, "the file is empty"),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", BAD_GROUND)
def test_bad_ground_is_one_clear_line_and_exit_code_2(name, tmp_path, capsys):
    height, words = BAD_GROUND[name]
    if height is None:
        (tmp_path / "dem.asc").write_text("")
    else:
        write_grid(tmp_path / "dem.asc", height)
    code, _, err = run(capsys, "network", tmp_path / "dem.asc", "--min-area", 0.03, "-o", tmp_path / "rivers.csv")
    assert code == 2 and err.count("\n") == 1 and words in err
    assert not (tmp_path / "rivers.csv").exists()


def test_a_grid_of_a_billion_cells_is_refused_before_it_is_read(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("warpriver.device.available_memory", lambda device="cpu": 4 * 10**9)
    write_grid(tmp_path / "dem.asc", np.zeros((2, 2)))
    text = (tmp_path / "dem.asc").read_text().replace("ncols 2\nnrows 2", "ncols 31623\nnrows 31623")
    (tmp_path / "dem.asc").write_text(text)
    code, _, err = run(capsys, "network", tmp_path / "dem.asc", "-o", tmp_path / "rivers.csv")
    assert code == 2 and err.count("\n") == 1 and "31623 x 31623 cells needs 17 GB and 4 GB are free" in err


@pytest.mark.filterwarnings("error")
def test_ground_elsewhere_or_in_another_system_is_refused(tmp_path, capsys):
    land = generate.fluvial_terrain((60, 60), 50.0, 300.0, 1).to_numpy()
    write_terrain(Terrain(land, 50.0, (0.0, 3000.0), crs="EPSG:32619"), tmp_path / "dem.npz")
    assert run(capsys, "network", tmp_path / "dem.npz", "--min-area", 0.1, "-o", tmp_path / "rivers.csv")[0] == 0
    write_terrain(Terrain(land, 50.0, (1e6, 1e6), crs="EPSG:32619"), tmp_path / "far.npz")
    write_terrain(Terrain(land, 50.0, (0.0, 3000.0), crs="EPSG:32620"), tmp_path / "zone.npz")
    for file, words in (("far.npz", "does not lie under the network"), ("zone.npz", "EPSG:32620")):
        arguments = ["simulate", tmp_path / "rivers.csv", "--terrain", tmp_path / file, "-o", tmp_path / "out"]
        code, _, err = run(capsys, *arguments, "--years", 1)
        assert code == 2 and err.count("\n") == 1 and words in err
        assert not (tmp_path / "out").exists()
        arguments = ["render", tmp_path / "rivers.csv", "--terrain", tmp_path / file, "-o", tmp_path / "map.png"]
        code, _, err = run(capsys, *arguments)
        assert code == 2 and err.count("\n") == 1 and not (tmp_path / "map.png").exists()


def test_heights_in_feet_without_a_system_and_with_a_value_for_no_data(tmp_path, capsys):
    pytest.importorskip("pyproj")
    land = generate.fluvial_terrain((60, 60), 50.0, 300.0, 1).to_numpy()
    land[20:30, 20:30] = np.nan
    write_grid(tmp_path / "feet.asc", np.nan_to_num(land / 0.3048, nan=-5.0))
    flags = ["--z-factor", 0.3048, "--nodata", -5]
    names = [tmp_path / "feet.asc", "--crs", "EPSG:32619", *flags, "--min-area", 0.1, "-o", tmp_path / "rivers.csv"]
    code, said, err = run(capsys, "network", *names)
    assert code == 0, err
    assert "heights 0 to 300 m, 2.78 % no data, crs=EPSG:32619" in said
    ground = ["--terrain", tmp_path / "feet.asc", "--terrain-crs", "EPSG:32619", *flags]
    out = ["-o", tmp_path / "out", "--no-progress"]
    code, _, err = run(capsys, "simulate", tmp_path / "rivers.csv", *ground, "--years", 2, *out)
    assert code == 0, err
    code, _, err = run(capsys, "render", tmp_path / "out", *ground, "-o", tmp_path / "map.png")
    assert code == 0 and (tmp_path / "map.png").stat().st_size > 0, err
    start = ["--start", tmp_path / "feet.asc", *flags, "--cut-depth", 0.5, "--slide-threshold", 40, "--fill"]
    code, _, err = run(capsys, "erode", *start, "--events", 20, "-o", tmp_path / "eroded", "--no-progress")
    assert code == 0, err
    eroded = read_terrain(tmp_path / "eroded" / "terrain.npz").to_numpy()
    assert np.isnan(eroded).sum() == 100 and 250.0 < np.nanmax(eroded) < 301.0


def test_widths_set_spacings_and_rates_by_flags(river, tmp_path, capsys):
    flags = ["--spacing-in-widths", 0.5, "--reference-width", 120]
    code, _, err = run(capsys, "simulate", river, "--years", 2, *flags, "-o", tmp_path / "o", "--no-progress")
    assert code == 0, err
    params = History.load(tmp_path / "o" / "run").params
    assert (params.spacing_in_widths, params.reference_width) == (0.5, 120.0)


def test_demo_goes_from_a_terrain_to_pictures(tmp_path, capsys):
    flags = ["--cell-size", 250, "--min-area", 40, "--relief", 600, "--years", 15, "--seed", 3]
    code, said, err = run(capsys, "demo", *flags, "-o", tmp_path / "demo", "--no-progress")
    assert code == 0, err
    names = "terrain.npz network.csv channels.csv run/run.json network.png rivers.png before_after.png"
    names += " landscape.png rivers.gif"
    for name in names.split():
        assert (tmp_path / "demo" / name).stat().st_size > 0, name
        assert name == "run/run.json" or name in said
    terrain = read_terrain(tmp_path / "demo" / "terrain.npz")
    expected = generate.intermontane_basin(250.0, 3, relief=600.0)
    assert terrain.shape == (104, 160) and (terrain.to_numpy() == expected.to_numpy()).all()
    history = History.load(tmp_path / "demo" / "run")
    widest = max(width.max() for width in history.networks[0].point_widths())
    # The network that was extracted; resampling may cut a little off the last point's interval.
    assert history.params.reference_width == pytest.approx(widest, rel=0.01)
    assert history.networks[0].channel_count > 5


def test_demo_refuses_bad_numbers_in_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for flags, words in (
        (["--cell-size", 5000], "--cell-size is 5000"),
        (["--relief", -1], "--relief: '-1'"),
        (["--min-area", 1e6], "--min-area"),
        (["--cell-size", 250, "--min-area", 40, "--reference-width", -5], "--reference-width is -5"),
    ):
        code, _, err = run(capsys, "demo", *flags)
        assert code == 2 and err.count("\n") == 1 and words in err
    assert not (tmp_path / "out").exists()


def test_bench_measures_prints_and_writes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bench, "RIVER_YEARS", 1.0)
    monkeypatch.setattr(bench, "COPY_BYTES", 2**20)
    arguments = ["bench", "--points", 600, "--channels", 2, "--threads", 1, "--no-cutoffs", "--on-slopes"]
    code, said, err = run(capsys, *arguments, "--json", tmp_path / "bench.json")
    assert code == 0, err
    for word in ("ms, ", "ns a point", "migrate", "resample", "GB/s", "1 thread,", "copies of its points"):
        assert word in said, word
    assert "cut off" not in said
    found = json.loads((tmp_path / "bench.json").read_text())
    assert found["benchmark"] == "bench" and found["channels"] == 2 and found["threads"] == 1
    assert (found["terrain"], found["cutoffs"], found["collisions"]) == (True, False, True)
    assert set(found["phases_ms"]) == {"migrate", "resample", "collide", *bench.HOST_PHASES}


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--points", 2], "--points: '2'"),
        (["--points", 5], "3 points for each"),
        (["--channels", 0], "--channels: '0'"),
        (["--points", 600, "--channels", 2, "--threads", 0], "--threads: '0'"),
        (["--device", "cuda:99"], "not on this machine"),
        (["--json", "nowhere/bench.json"], "no folder nowhere"),
    ],
)
def test_bench_refuses_bad_input(arguments, word, capsys, monkeypatch):
    monkeypatch.setattr(bench, "RIVER_YEARS", 1.0)
    code, _, err = run(capsys, "bench", *arguments)
    assert code == 2 and word in err and err.splitlines()[-1].startswith("warpriver bench: "), err


def test_riverscape_writes_types_and_a_bed(tmp_path, capsys):
    ground = generate.fluvial_terrain((60, 60), 30.0, 200.0, seed=2)
    write_terrain(ground, tmp_path / "dem.npz")
    arguments = ["riverscape", tmp_path / "dem.npz", "--min-area", 0.2]
    code, said, err = run(capsys, *arguments, "-o", tmp_path / "types")
    assert code == 0, err
    assert re.search(r"type \S+: [\d.]+ km", said)
    rows = (tmp_path / "types" / "types.csv").read_text().splitlines()
    assert rows[0].startswith("channel,type,entrenchment,") and len(rows) > 2 and "unresolved" in rows[1]
    assert (tmp_path / "types" / "types.png").stat().st_size > 0
    code, said, err = run(capsys, *arguments, "--window", "0,0,1", "-o", tmp_path / "no")
    assert code == 2 and "--window 0,0,1: give west,south,east,north" in err
    code, said, err = run(capsys, *arguments, "--window", "9000,9000,9100,9100", "-o", tmp_path / "no")
    assert code == 2 and "--window" in err and "no river" in err
    code, said, err = run(capsys, *arguments, "--type", "H", "-o", tmp_path / "no")
    assert code == 2 and "'H'" in err
    network = extract_network(ground, min_drainage_area=2e5)
    x, y = network.polylines()[0][5]
    window = f"{x - 50:.0f},{y - 50:.0f},{x + 50:.0f},{y + 50:.0f}"
    code, said, err = run(capsys, *arguments, "--window", window, "--detail", 2, "--bed", "-o", tmp_path / "bed")
    assert code == 0, err
    assert "Riverscape(" in said
    (carved,) = [p for p in (tmp_path / "bed").iterdir() if p.stem == "bed" and p.suffix in (".tif", ".npz")]
    assert read_terrain(carved).shape == (50, 50)
    assert (tmp_path / "bed" / "bed.png").stat().st_size > 0


def test_riverscape_writes_its_water_with_edits(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("warpriver.cli.riverscape.MOVIE_SIZE", (64, 36))
    ground = generate.fluvial_terrain((60, 60), 30.0, 200.0, seed=2)
    write_terrain(ground, tmp_path / "dem.npz")
    x, y = extract_network(ground, min_drainage_area=2e5).polylines()[0][5]
    write_edits(tmp_path / "edits.json", [(0, AddRock((float(x), float(y)), 4.0))])
    window = f"{x - 20:.0f},{y - 20:.0f},{x + 20:.0f},{y + 20:.0f}"
    arguments = ["riverscape", tmp_path / "dem.npz", "--min-area", 0.2, "--detail", 2, "--window", window]
    arguments += [
        "--flowmap",
        "unity",
        "--mesh",
        "--movie",
        "--frames",
        ".npz",
        "--scene",
        "--seconds",
        0.2,
        "--fps",
        10,
    ]
    code, said, err = run(capsys, *arguments, "--edits", tmp_path / "edits.json", "-o", tmp_path / "out")
    assert code == 0, err
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"flow.png", "flow.png.json", "riverscape.glb", "frames", "scene.json", "scene.npz"}
    assert any(name.startswith("movie.") for name in names) and "types.csv" not in names
    assert len(list((tmp_path / "out" / "frames").iterdir())) == 11 and "2 frames" in said
    assert read_riverscape(tmp_path / "out" / "scene.json").edits[0].diameter == 4.0
    code, _, err = run(capsys, "riverscape", tmp_path / "dem.npz", "--movie", "-o", tmp_path / "no")
    assert code == 2 and "--movie needs --window" in err
    code, _, err = run(capsys, *arguments, "--edits", tmp_path / "gone.json", "-o", tmp_path / "no")
    assert code != 0 and "gone.json" in err
