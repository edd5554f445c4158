"""The command ``landscape``: runs, lines on a terrain, and terrains; and what it refuses."""

import json

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver.cli import main

pytestmark = pytest.mark.usefixtures("coarse_pictures")


def run(capsys, *arguments):
    code = main([str(a) for a in arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("landscape")
    line = wr.generate.noisy_line(2500.0, 30.0, 30.0, 0) + [0.0, 600.0]
    network = wr.RiverNetwork.from_polylines([line], width=40.0, crs="EPSG:32619")
    wr.write_network(network, folder / "line.csv")
    hills = wr.generate.fluvial_terrain((80, 90), 30.0, 60.0, 1)
    ground = wr.Terrain(hills.to_numpy(), 30.0, (-100.0, 1800.0), "EPSG:32619")
    wr.write_terrain(ground, folder / "ground.npz")
    wr.Simulation(network, plain_params(), threads=1).run(steps=4, record_every=2, store=folder / "run")
    wr.Simulation(network, plain_params(), terrain=wr.read_terrain(folder / "ground.npz"), threads=1).run(
        steps=4, record_every=2, store=folder / "over" / "run"
    )
    return folder


def test_a_run_on_a_plain(files, tmp_path, capsys):
    pytest.importorskip("rasterio")
    pytest.importorskip("pyogrio")
    out = tmp_path / "land"
    code, said, err = run(
        capsys, "landscape", files / "run", "-o", out, "--export", "gis", "unreal", "--resolution", 12
    )
    assert code == 0, err
    assert "carved" in said and "m3 cut" in said and str(out / "unreal") in said
    assert (out / "landscape.png").stat().st_size > 0 and (out / "gis" / "events.csv").exists()
    ground = wr.read_terrain(out / "gis" / "terrain.tif")
    assert ground.cell_size == 12.0 and ground.crs == "EPSG:32619"
    told = json.loads((out / "unreal" / "landscape.json").read_text())
    assert told["columns"] == 505 and told["crs"] == "EPSG:32619"
    code, _, err = run(capsys, "landscape", files / "run", "-o", out, "--export", "gis")
    assert code == 2 and "holds an earlier gis" in err


def test_a_run_finds_its_ground_again(files, tmp_path, capsys):
    code, _, err = run(capsys, "landscape", files / "over", "-o", tmp_path / "a", "--export", "mesh")
    assert code == 0, err
    assert wr.landscape.ground_of_run(wr.read_history(files / "over" / "run")).cell_size == 30.0


def test_maps_of_a_run_are_layers_and_their_deposits_lie_on_the_ground(files, tmp_path, capsys):
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("rasterio")
    words = ["--maps", "--export", "gis", "blender", "--resolution", 15]
    code, _, err = run(capsys, "landscape", files / "run", "-o", tmp_path / "a", *words)
    assert code == 0, err
    gis = tmp_path / "a" / "gis"
    for name in ("moisture", "sediment", "vegetation", "age", "plants"):
        assert (gis / f"{name}.tif").exists(), name
    change, deposit = (wr.io.read_raster(gis / f"{n}.tif").numpy() for n in ("elevation_change", "material_deposit"))
    assert change.max() > 0.05 and (deposit[change > 0.05] > 0).mean() > 0.3 and (deposit[change <= 0.0] == 0).all()
    with image.open(tmp_path / "a" / "blender" / "map_plants.png") as picture:
        np.testing.assert_array_equal(np.array(picture), wr.io.read_raster(gis / "plants.tif").numpy())


def test_lines_on_a_terrain_and_rivers_of_a_terrain(files, tmp_path, capsys):
    pytest.importorskip("PIL")
    flags = ["--section", "trapezoid", "--max-cut", 80, "--keep-junctions", "--export", "blender"]
    code, _, err = run(
        capsys, "landscape", files / "line.csv", "--terrain", files / "ground.npz", "-o", tmp_path / "a", *flags
    )
    assert code == 0, err
    told = json.loads((tmp_path / "a" / "blender" / "landscape.json").read_text())
    assert (told["rows"], told["columns"]) == (80, 90) and told["metres_per_pixel"] == pytest.approx([30.0, 30.0])
    code, _, err = run(
        capsys, "landscape", files / "ground.npz", "--min-area", "100cells", "-o", tmp_path / "b", "--export", "mesh"
    )
    assert code == 0, err
    assert (tmp_path / "b" / "mesh" / "landscape.glb").exists()


@pytest.mark.parametrize(
    "arguments, words",
    [
        ("line.csv --min-area 2", "--min-area is for rivers that are found on a terrain"),
        ("ground.npz --terrain ground.npz", "--terrain goes with rivers"),
        ("ground.npz --width 30", "--width says how river lines are read"),
        ("line.csv --maps", "--maps are made from a run"),
        ("run --width 30", "--width says how river lines are read"),
        ("line.csv --size 1000 --export unreal", "size is 1000; Unreal Engine takes 505"),
        ("line.csv --repose-angle 0", "--repose-angle"),
        ("line.csv --max-cut -3", "--max-cut"),
        ("nothing.csv", "nothing.csv"),
    ],
)
def test_bad_input_is_one_line(files, tmp_path, capsys, arguments, words):
    named = [files / word if (files / word).exists() else word for word in arguments.split()]
    code, _, err = run(capsys, "landscape", *named, "-o", tmp_path / "out")
    assert code == 2 and err.count("\n") == 1 and words in err, err


def test_every_constant_is_a_flag(files, tmp_path, capsys):
    flags = (
        "--section trapezoid --side-fraction 0.3 --bank-reach 2 --repose-angle 20 --max-cut 70 --fill-fraction 0.5 "
        "--smoothing 3 --lake-time 20 --plug-length 1 --keep-junctions --export mesh"
    ).split()
    code, _, err = run(
        capsys, "landscape", files / "line.csv", "--terrain", files / "ground.npz", "-o", tmp_path / "a", *flags
    )
    assert code == 0, err
    params = wr.landscape.CarveParams("trapezoid", 0.3, 2.0, 20.0, 70.0, 0.5, 3.0, False, 20.0, 1.0)
    ground, network = wr.read_terrain(files / "ground.npz"), wr.read_network(files / "line.csv")
    wanted = wr.carve(ground, network, params)
    wr.landscape.write_surfaces(wr.landscape.landscape_surfaces(wanted), tmp_path / "b.glb")
    assert (tmp_path / "a" / "mesh" / "landscape.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    plain = wr.carve(ground, network)
    assert not np.array_equal(wanted.terrain.to_numpy(), plain.terrain.to_numpy(), equal_nan=True)
