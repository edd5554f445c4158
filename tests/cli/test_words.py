"""Tests of messages in the words of the command line, and of flags that say how files are read."""

import json
import math

import numpy as np
import pytest

from warpriver.cli import main
from warpriver.cli.words import flag_names, in_flags, naming
from warpriver.errors import InputError
from warpriver.io import read_network, write_network, write_terrain
from warpriver.meander import shape_junctions
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain

FLAGS = {name: f"--{name.replace('_', '-')}" for name in "crs to_crs cell_size range short nodata closed width".split()}


def run(capsys, *words):
    try:
        code = main([str(word) for word in words])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    return code, out, err


def valley(rows=60, columns=80):
    y, x = np.mgrid[0:rows, 0:columns]
    return 200.0 + 0.6 * (rows - y) + 1.5 * np.abs(x - columns // 2)


def tif(path, height, cell=(30.0, 30.0), crs="EPSG:32633", corner=(5e5, 5e6)):
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import Affine

    place = Affine(cell[0], 0.0, corner[0], 0.0, -cell[1], corner[1])
    size = {"height": height.shape[0], "width": height.shape[1], "count": 1}
    with rasterio.open(path, "w", driver="GTiff", dtype="float32", transform=place, crs=crs, **size) as dataset:
        dataset.write(height.astype("float32"), 1)
    return path


@pytest.mark.parametrize(
    ("said", "spoken"),
    [
        (
            'a.tif: in feet; pass to_crs="utm" or to_crs="EPSG:..."',
            "a.tif: in feet; pass --to-crs utm or --to-crs EPSG:...",
        ),
        ("pass cell_size= to have it resampled", "pass --cell-size to have it resampled"),
        ("pass cell_size=27.1, or another", "pass --cell-size 27.1, or another"),
        ("pass range=(low, high) in m", "pass --range LOW HIGH in m"),
        ("or pass short='narrow', 'drop'", "or pass --short narrow, 'drop'"),
        ("Pass width= if you know better", "Pass --width if you know better"),
        ("pass closed=True for it", "pass --closed for it"),
        ("pass nodata=-9999; or nodata=nan", "pass --nodata -9999; or --nodata nan"),
        ("set MeanderParams(width=0) to", "set --width 0 to"),
        ("MeanderParams.width is -5 m", "--width is -5 m"),
        ("pass depth= (there is no flag)", "pass depth= (there is no flag)"),
        ("w = 7.2 Q^0.5 and width is 3", "w = 7.2 Q^0.5 and width is 3"),
    ],
)
def test_arguments_become_flags(said, spoken):
    with naming(**FLAGS):
        assert in_flags(said) == spoken


def test_what_lies_under_rivers_has_flags_of_its_own():
    with naming(**FLAGS):
        with pytest.raises(InputError, match=r"pass --terrain-crs a and --to-crs b"), naming(crs="--terrain-crs"):
            raise InputError('pass crs="a" and to_crs="b"')
        with naming(crs="--terrain-crs"):
            assert in_flags("pass crs=") == "pass --terrain-crs"
        assert in_flags("pass crs=") == "pass --crs"


@pytest.mark.parametrize("command", ["network", "simulate", "landscape", "render", "info", "erode"])
def test_every_argument_of_a_reader_is_a_flag_of_the_commands_that_read(capsys, command):
    """A message may name any of them."""
    import argparse

    from warpriver.cli import _parser

    parsers = next(a for a in _parser()._actions if isinstance(a, argparse._SubParsersAction))
    flags = flag_names(parsers.choices[command])
    heights = {"cell_size", "origin", "crs", "to_crs", "range", "z_factor", "nodata", "shape", "band"}
    lines = {"width", "missing_width", "layer", "crs", "to_crs", "repeated", "short", "topology", "reverse", "closed"}
    if command != "info":
        assert heights <= set(flags)
    if command in ("simulate", "landscape", "render", "info"):
        assert lines <= set(flags)


@pytest.mark.parametrize(
    "value", ["-3.4e38", "-3.40282e+38", "-3.4028234663852886e+38", "-inf", "-1e4", "-9999.", "-9999"]
)
def test_negative_numbers_with_exponents_are_numbers(capsys, tmp_path, value):
    height = valley()
    height[:15] = max(float(value), float(np.finfo(np.float32).min)) if value != "-inf" else -math.inf
    path = tif(tmp_path / "dem.tif", height)
    code, out, err = run(capsys, "network", path, "--nodata", value, "--min-area", "0.1", "-o", tmp_path / "r.csv")
    assert code == 0 and "25 % no data" in out and "as low as" not in err


def test_advice_on_cells_can_be_followed(capsys, tmp_path):
    path = tif(tmp_path / "dem.tif", valley(), (27.1, 27.9))
    words = ("network", path, "--min-area", 0.1, "-o", tmp_path / "r.csv")
    code, _, err = run(capsys, *words)
    assert code == 2 and "pass --cell-size 27.1" in err and "cell_size=" not in err
    assert run(capsys, *words, "--cell-size", "27.5")[0] == 0


def test_advice_on_height_maps_can_be_followed(capsys, tmp_path):
    (65535 * (valley() - 200.0) / 100.0).clip(0, 65535).astype("<u2").tofile(tmp_path / "a.r16")
    words = ["network", tmp_path / "a.r16", "--min-area", 0.1, "-o", tmp_path / "r.csv"]
    for advice, flags in (
        ("pass --range LOW HIGH", ("--range", "-1e1", "90")),
        ("pass --shape ROWS COLUMNS", ("--shape", "60", "80")),
        ("pass --cell-size in m", ("--cell-size", "30")),
    ):
        code, _, err = run(capsys, *words)
        assert code == 2 and advice in err
        words += flags
    code, out, _ = run(capsys, *words, "--origin", "5e5", "-7e3")
    assert code == 0 and "heights -9." in out
    assert read_network(tmp_path / "r.csv").bounds()[3] < -7000.0


def test_junctions_are_shaped_on_the_way(capsys, tmp_path):
    up = np.linspace(1.0, 0.0, 60)[:, None]
    lines = [up * [-600.0, 800.0], up * [700.0, 700.0], (1.0 - up) * [0.0, -1000.0]]
    network = RiverNetwork.from_polylines(lines, width=[30.0, 8.0, 31.0], discharge=[20.0, 1.0, 21.0])
    write_network(network, tmp_path / "a.csv")
    code, _, err = run(capsys, "convert", tmp_path / "a.csv", "--shape-junctions", "-o", tmp_path / "b.csv")
    assert code == 0, err
    expected = shape_junctions(read_network(tmp_path / "a.csv"))
    np.testing.assert_array_equal(read_network(tmp_path / "b.csv").points(), expected.points())
    assert np.abs(expected.points() - network.points()).max() > 10.0
    path = tif(tmp_path / "dem.tif", valley())
    words = ("network", path, "--min-area", 0.1, "-o", tmp_path / "r.csv")
    assert run(capsys, *words)[0] == run(capsys, *words[:-1], tmp_path / "s.csv", "--shape-junctions")[0] == 0
    code, _, err = run(capsys, "convert", path, "--shape-junctions", "-o", tmp_path / "c.tif")
    assert code == 2 and "--shape-junctions means nothing to" in err


def test_advice_on_lines_can_be_followed(capsys, tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("channel,x,y\n" + "".join(f"{k},{60 * i},{900 * k}\n" for k in (0, 1) for i in range(30)))
    code, _, err = run(capsys, "convert", path, "-o", tmp_path / "out.csv")
    assert code == 2 and "pass --width (bankfull width in m)" in err
    assert run(capsys, "convert", path, "-o", tmp_path / "out.csv", "--missing-width", 20)[0] == 0
    assert run(capsys, "convert", path, "-o", tmp_path / "out.csv", "--width", 20)[0] == 0
    path.write_text("x,y,width\n" + "".join(f"{60 * i},0,30\n" for i in range(30)) + "9000,5,30\n9000,5,30\n")
    code, _, err = run(capsys, "convert", path, "-o", tmp_path / "out.csv", "--repeated", "error")
    assert code == 2 and "or pass --repeated drop" in err


def test_lines_that_run_upstream_can_be_turned(capsys, tmp_path):
    y = [[[500, 500], [200, 700], [0, 900]], [[500, 500], [800, 700], [1000, 900]], [[500, 0], [520, 250], [500, 500]]]
    features = [
        {"type": "Feature", "properties": {"width": 20}, "geometry": {"type": "LineString", "coordinates": xy}}
        for xy in y
    ]
    path = tmp_path / "r.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "crs": None, "features": features}))
    words = ("simulate", path, "--years", 1, "-o", tmp_path / "o", "--no-progress", "--spacing", 20)
    code, _, err = run(capsys, *words)
    assert (
        code == 2 and "pass --reverse" in err and "read them with --reverse" in err and "--collision-distance 0" in err
    )
    code, _, err = run(capsys, *words, "--reverse")
    assert code == 0 and "upstream" not in err


def test_rivers_and_terrain_get_one_zone(capsys, tmp_path):
    """The middle of the river lies in zone 32, that of the terrain in zone 33."""
    pytest.importorskip("pyproj")
    dem = tif(tmp_path / "dem.tif", 500.0 - 0.5 * np.mgrid[0:120, 0:400][0], (0.001, 0.001), "EPSG:4326", (11.9, 47.0))
    s = np.linspace(0.0, 0.06, 80)
    xy = np.stack([11.92 + s, 46.95 + 0.001 * np.sin(400.0 * s)], axis=1).tolist()
    feature = {"type": "Feature", "properties": {"width": 40}, "geometry": {"type": "LineString", "coordinates": xy}}
    (tmp_path / "r.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    words = ("--to-crs", "utm", "--terrain", dem, "--no-progress")
    code, _, err = run(capsys, "simulate", tmp_path / "r.geojson", "--years", 1, "-o", tmp_path / "o", *words)
    assert code == 0, err
    code, _, err = run(capsys, "simulate", tmp_path / "o" / "run", "--years", 1, *words)
    assert code == 0, err
    words = words[:-1]
    code, _, err = run(capsys, "render", tmp_path / "o" / "run", "-o", tmp_path / "a.png", *words)
    assert code == 0, err
    code, _, err = run(capsys, "render", tmp_path / "r.geojson", "-o", tmp_path / "b.png", *words)
    assert code == 0, err


def test_a_terrain_without_a_place_is_told_of_by_its_flag(capsys, tmp_path):
    line = "".join(f"{5e5 + 60 * i},{5e6 - 900},30\n" for i in range(30))
    (tmp_path / "r.csv").write_text("# crs=EPSG:32633\nx,y,width\n" + line)
    rows = "\n".join(" ".join(["5"] * 30) for _ in range(30))
    (tmp_path / "dem.asc").write_text(f"ncols 30\nnrows 30\nxllcorner 11\nyllcorner 46\ncellsize 0.01\n{rows}\n")
    words = ("simulate", tmp_path / "r.csv", "--terrain", tmp_path / "dem.asc", "-o", tmp_path / "o", "--no-progress")
    code, _, err = run(capsys, *words)
    assert code == 2 and "pass --terrain-crs EPSG:4326 and --to-crs utm" in err


def test_a_terrain_under_a_part_of_the_river_is_told(capsys, tmp_path):
    (tmp_path / "r.csv").write_text("x,y,width\n" + "".join(f"{60 * i},{150 * np.sin(i / 4)},60\n" for i in range(100)))
    write_terrain(Terrain(np.tile(100 - 0.05 * np.arange(60), (40, 1)), 50.0, (-1000, 1000)), tmp_path / "part.npz")
    words = ("simulate", tmp_path / "r.csv", "--terrain", tmp_path / "part.npz", "--years", 1, "-o", tmp_path / "o")
    code, _, err = run(capsys, *words, "--no-progress")
    assert code == 0 and "warning: 66 of 100 points lie off the terrain" in err
