import json
import math
import struct
import sys
import warnings

import numpy as np
import pytest
from data_folder import data_folder
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import warpriver.device as device_module
from warpriver.io.raster.terrains import read_terrain, terrain_formats, write_terrain
from warpriver.sentinels import find_sentinels
from warpriver.terrain import Terrain

EXACT = [".tif", ".asc", ".npz"]
STEPS = [".png", ".r16", ".raw"]
UTM = "EPSG:32619"


@pytest.fixture(autouse=True)
def no_surprising_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        yield


def needs(suffix):
    for module in {".tif": ["rasterio"], ".asc": ["pyproj"], ".png": ["PIL"]}.get(suffix, []):
        pytest.importorskip(module)


def rough(gaps=0.2, rows=20, columns=27, seed=0):
    height = np.random.default_rng(seed).uniform(-50.0, 900.0, (rows, columns))
    height[np.random.default_rng(seed + 1).random(height.shape) < gaps] = np.nan
    return height


def sample_terrain(gaps=0.2, crs=UTM):
    return Terrain(rough(gaps), 12.5, (440_300.25, 5_100_200.5), crs)


def same(a, b):
    """Two terrains with the same heights to the bit, in the same place."""
    np.testing.assert_array_equal(a.to_numpy(), b.to_numpy())
    assert (a.cell_size, a.crs) == (b.cell_size, b.crs)
    np.testing.assert_allclose(a.origin, b.origin, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("suffix", EXACT)
@pytest.mark.parametrize("gaps", [0.0, 0.2])
@pytest.mark.parametrize("crs", [UTM, None])
def test_what_is_written_is_read_back_to_the_bit(tmp_path, suffix, gaps, crs):
    needs(suffix)
    terrain = sample_terrain(gaps, crs)
    write_terrain(terrain, tmp_path / f"a{suffix}")
    same(read_terrain(tmp_path / f"a{suffix}"), terrain)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1e4, 9e3, width=64), min_size=6, max_size=6), st.sampled_from([".asc", ".npz"]))
def test_any_heights_come_back(tmp_path_factory, values, suffix):
    assume(not find_sentinels(np.array(values)))
    terrain = Terrain(np.reshape(values, (2, 3)), 0.1, (1.0 / 3.0, -7.1))
    path = tmp_path_factory.mktemp("any") / f"a{suffix}"
    write_terrain(terrain, path)
    read = read_terrain(path, crs=UTM) if suffix == ".asc" else read_terrain(path)
    np.testing.assert_array_equal(read.to_numpy(), terrain.to_numpy())


def test_heights_that_equal_the_usual_no_data_value_survive(tmp_path):
    height = rough()
    height[3, 3] = -9999.0
    with pytest.warns(UserWarning, match=r"height: of its cells 1 is -9999; if that stands for no data, write NaN"):
        terrain = Terrain(height, 5.0)
    write_terrain(terrain, tmp_path / "a.asc")
    with pytest.warns(UserWarning, match=r"of its cells 1 is -9999, which may stand for no data"):
        np.testing.assert_array_equal(read_terrain(tmp_path / "a.asc").to_numpy(), height)


@pytest.mark.parametrize("suffix", STEPS)
@pytest.mark.parametrize("gaps", [0.0, 0.2])
def test_height_maps_are_exact_to_half_a_step(tmp_path, suffix, gaps):
    needs(suffix)
    terrain = sample_terrain(gaps)
    path = tmp_path / f"a{suffix}"
    write_terrain(terrain, path)
    read = read_terrain(path)
    step = np.ptp(terrain.to_numpy()[np.isfinite(terrain.to_numpy())]) / (65535 - (gaps > 0.0))
    np.testing.assert_allclose(read.to_numpy(), terrain.to_numpy(), rtol=0.0, atol=0.5001 * step)
    assert (read.cell_size, read.origin, read.crs) == (terrain.cell_size, terrain.origin, terrain.crs)
    side = json.loads((tmp_path / f"a{suffix}.json").read_text())
    assert side["metres_per_pixel"] == 12.5 and side["height_low"] == np.nanmin(terrain.to_numpy())
    # Once more, and nothing moves: a step is a fixed point.
    write_terrain(read, path, range=(side["height_low"], side["height_high"]))
    np.testing.assert_allclose(read_terrain(path).to_numpy(), read.to_numpy(), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("suffix", STEPS)
def test_height_maps_of_other_programs_take_their_scale_from_the_caller(tmp_path, suffix):
    needs(suffix)
    path = tmp_path / f"a{suffix}"
    steps = np.arange(36, dtype=np.uint16).reshape(6, 6) * 1872
    steps[5, 5] = 65535
    if suffix == ".png":
        from PIL import Image

        Image.fromarray(steps).save(path)
    else:
        steps.astype("<u2").tofile(path)
    terrain = read_terrain(path, range=(-100.0, 500.0), cell_size=2.0, origin=(7.0, 9.0), crs=UTM)
    np.testing.assert_allclose(terrain.to_numpy(), -100.0 + 600.0 * (steps / 65535.0), rtol=1e-13)
    assert (terrain.cell_size, terrain.origin, terrain.crs) == (2.0, (7.0, 9.0), UTM)
    with pytest.raises(ValueError, match="does not tell its heights; pass range="):
        read_terrain(path, cell_size=2.0)
    with pytest.raises(ValueError, match="does not tell the size of its cells; pass cell_size="):
        read_terrain(path, range=(0.0, 1.0))
    for limits in ((1.0, 1.0), (2.0, 1.0), (0.0, math.inf), 5.0, (1.0,)):
        with pytest.raises(ValueError, match="range is"):
            read_terrain(path, range=limits, cell_size=2.0)


def test_a_raw_height_map_is_little_endian_and_square_unless_told(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(struct.pack("<6H", 0, 1, 2, 256, 257, 65535))
    read = read_terrain(path, range=(0.0, 65535.0), cell_size=1.0, shape=(2, 3))
    np.testing.assert_array_equal(read.to_numpy(), [[0, 1, 2], [256, 257, 65535]])
    with pytest.raises(ValueError, match=r"12 bytes are no square of 16-bit steps; pass shape=\(rows, columns\)"):
        read_terrain(path, range=(0.0, 1.0), cell_size=1.0)
    with pytest.raises(ValueError, match="12 bytes, but 3 x 3 steps of 16 bits are 18"):
        read_terrain(path, range=(0.0, 1.0), cell_size=1.0, shape=(3, 3))


def test_a_height_map_of_8_bits_is_read_and_told(tmp_path, caplog):
    Image = pytest.importorskip("PIL.Image")
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(tmp_path / "a.png")
    read = read_terrain(tmp_path / "a.png", range=(0.0, 255.0), cell_size=1.0)
    np.testing.assert_allclose(read.to_numpy().ravel(), np.arange(64), atol=1e-12)
    assert "256 steps of height are few" in caplog.text


def test_heights_outside_the_range_are_refused_not_clipped(tmp_path):
    with pytest.raises(ValueError, match=r"do not fit into range=\(0, 100\)"):
        write_terrain(sample_terrain(), tmp_path / "a.r16", range=(0.0, 100.0))
    assert not list(tmp_path.iterdir())


def test_a_level_terrain_goes_through_a_height_map(tmp_path):
    write_terrain(Terrain(np.full((3, 4), 8.5), 1.0), tmp_path / "a.r16")
    np.testing.assert_array_equal(read_terrain(tmp_path / "a.r16").to_numpy(), 8.5)


def test_numpy_files_of_others(tmp_path):
    np.save(tmp_path / "a.npy", rough().astype(np.float32))
    read = read_terrain(tmp_path / "a.npy", cell_size=3.0)
    np.testing.assert_array_equal(read.to_numpy(), rough().astype(np.float32))
    assert read.origin == (0.0, 0.0) and read.crs is None
    np.savez(tmp_path / "b.npz", elevation=rough(), something=np.arange(3))
    np.testing.assert_array_equal(read_terrain(tmp_path / "b.npz", cell_size=3.0).to_numpy(), rough())
    write_terrain(sample_terrain(), tmp_path / "c.npy")
    np.testing.assert_array_equal(read_terrain(tmp_path / "c.npy", cell_size=3.0).to_numpy(), rough())
    integers = np.array([[1, 2], [3, -32768]], np.int16)
    np.save(tmp_path / "d.npy", integers)
    read = read_terrain(tmp_path / "d.npy", cell_size=3.0, nodata=-32768)
    np.testing.assert_array_equal(read.to_numpy(), [[1.0, 2.0], [3.0, np.nan]])


ASC = """ncols 3
nrows 2
xllcorner 100.0
yllcorner 200.0
cellsize 10.0
nodata_value -1
1 2 3
4 -1 6
"""


@pytest.mark.parametrize(
    "text",
    [
        ASC,
        ASC.replace("\n", "\r\n"),
        ASC.replace("xllcorner 100.0", "XLLCENTER   105").replace("yllcorner 200.0", "YLLCENTER\t205"),
        ASC.replace("cellsize 10.0", "dx 10\ndy 10"),
        ASC.replace("1 2 3\n4 -1 6", "1 2\n3 4 -1\n\n6"),
        ASC.replace("4 -1 6", "4.0e0 -1.000 +6."),
        ASC.replace("-1 6", "nan 6").replace("nodata_value -1\n", ""),
        ASC.upper().replace("NODATA_VALUE", "NODATA_value"),
        "nrows 2\nncols 3\n" + ASC.split("\n", 2)[2],
    ],
)
def test_an_ascii_grid_in_its_forms(tmp_path, text):
    (tmp_path / "a.asc").write_bytes(text.encode())
    read = read_terrain(tmp_path / "a.asc")
    np.testing.assert_array_equal(read.to_numpy(), [[1, 2, 3], [4, np.nan, 6]])
    assert read.bounds == (100.0, 200.0, 130.0, 220.0)


def test_an_ascii_grid_finds_its_projection_beside_it(tmp_path):
    pyproj = pytest.importorskip("pyproj")
    (tmp_path / "a.asc").write_text(ASC)
    (tmp_path / "a.PRJ").write_text(pyproj.CRS(UTM).to_wkt("WKT1_ESRI"))
    assert read_terrain(tmp_path / "a.asc").crs == UTM
    # A terrain without a CRS, written there, leaves no other's beside it.
    write_terrain(Terrain(rough(), 5.0, crs=UTM), tmp_path / "b.asc")
    assert (tmp_path / "b.prj").is_file()
    write_terrain(Terrain(rough(), 5.0), tmp_path / "b.asc")
    assert not (tmp_path / "b.prj").exists() and read_terrain(tmp_path / "b.asc").crs is None


BROKEN = [
    ("a.asc", ASC[:-2], "5 heights where the header promises 6; is the file cut short"),
    ("a.asc", ASC + "7\n", "7 heights where the header promises 6; is the header right"),
    ("a.asc", ASC.replace("4 -1", "4,5 -1"), "'4,5' among the heights is no number"),
    ("a.asc", ASC.replace("cellsize 10.0\n", ""), "the header gives no cellsize"),
    ("a.asc", ASC.replace("xllcorner 100.0\n", ""), "neither xllcorner nor xllcenter"),
    ("a.asc", ASC.replace("cellsize 10.0", "cellsize wide"), "'cellsize wide' holds no number"),
    ("a.asc", ASC.replace("ncols 3\n", ""), "not an ESRI ASCII grid: its header has nrows"),
    ("a.asc", ASC.replace("cellsize 10.0", "cellsize -10"), "the header gives cells of -10 x -10"),
    ("a.asc", ASC.replace("cellsize 10.0", "cellsize 0"), "the header gives cells of 0 x 0"),
    ("a.asc", ASC.replace("4 -1 6", "-1 -1 -1").replace("1 2 3", "-1 -1 -1"), "NaN in every cell"),
    ("a.asc", "x,y,z\n1,2,3\n", "not an ESRI ASCII grid: its header has no line"),
    ("a.asc", "", "the file is empty"),
    ("a.asc", b"II*\0\0\0", "holds zero bytes"),
    ("a.npy", b"\x93NUMPY junk", "cannot be read as NumPy's .npy"),
    ("a.npz", b"PK\x03\x04 junk", "cannot be read as NumPy's .npz"),
    ("a.npz", b"no zip at all", "cannot be read as NumPy's .npz"),
    ("a.tif", b"II*\0 junk", "not a GeoTIFF that rasterio can open"),
    ("a.png", b"\x89PNG\r\n", "not a PNG file, or cut short"),
    ("a.png", b"GIF89a" + b" " * 40, "not a PNG file"),
    ("a.txt", "1 2 3", ".txt names no format of terrains; known are .tif"),
    ("a", "1 2 3", "no suffix names no format"),
]


@pytest.mark.parametrize(("name", "content", "text"), BROKEN)
def test_a_broken_file_is_told_in_one_sentence(tmp_path, name, content, text):
    needs("." + name.rpartition(".")[2])
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ValueError, match=text) as caught:
        read_terrain(path, **({"range": (0.0, 1.0), "cell_size": 1.0} if name == "a.png" else {}))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [*EXACT, ".npy", ".png"])
@pytest.mark.parametrize("part", [0.3, 0.9])
def test_a_file_cut_short_is_refused(tmp_path, suffix, part):
    needs(suffix)
    path = tmp_path / f"a{suffix}"
    write_terrain(Terrain(rough(0.0, 200, 300), 5.0, crs=UTM), path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(ValueError, match=r"whole|cut short|cannot be read|not a GeoTIFF"):
        read_terrain(path, cell_size=5.0)


def test_paths_that_are_no_files(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        read_terrain(tmp_path / "none.tif")
    (tmp_path / "folder.tif").mkdir()
    with pytest.raises(ValueError, match="is a directory"):
        read_terrain(tmp_path / "folder.tif")
    with pytest.raises(OSError, match="cannot write"):
        write_terrain(sample_terrain(), tmp_path / "nowhere" / "a.npz")
    with pytest.raises(ValueError, match="names no format"):
        write_terrain(sample_terrain(), tmp_path / "a.jpg")
    with pytest.raises(ValueError, match="holds heights themselves; leave range= out"):
        write_terrain(sample_terrain(), tmp_path / "a.npz", range=(0.0, 1.0))
    with pytest.raises(ValueError, match="names no format"):
        read_terrain(tmp_path)


@pytest.mark.parametrize("suffix", [".tif", ".png"])
def test_a_missing_extra_is_named(tmp_path, suffix, monkeypatch):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"something")
    for name in ("rasterio", "PIL.Image", "PIL"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match=r'pip install "warpriver\[gis\]"'):
        read_terrain(path, range=None if suffix == ".tif" else (0.0, 1.0), cell_size=1.0)
    with pytest.raises(ImportError, match=r'pip install "warpriver\[gis\]"'):
        write_terrain(sample_terrain(), path)
    assert path.read_bytes() == b"something", "the old file is gone"


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    write_terrain(sample_terrain(), path)
    before = path.read_bytes()

    def broken(*args, **kwargs):
        args[0].write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", broken)
    with pytest.raises(OSError, match=r"cannot write .*a\.npz: No space left"):
        write_terrain(sample_terrain(0.5), path)
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_formats_are_listed_with_what_is_installed():
    formats = terrain_formats()
    assert formats[".npz"] and formats[".asc"] and set(formats) >= {".tif", ".png", ".r16", ".npy"}


@pytest.mark.parametrize("suffix", [*EXACT, ".npy", ".png", ".r16"])
def test_no_room_is_told_before_anything_is_read(tmp_path, suffix, monkeypatch):
    needs(suffix)
    path = tmp_path / f"a{suffix}"
    write_terrain(Terrain(rough(0.0, 200, 300), 5.0), path)
    monkeypatch.setattr(device_module, "available_memory", lambda device: 500_000)
    with pytest.raises(MemoryError, match=r"a raster of 200 x 300 cells needs .* GB and 0.0005 GB are free"):
        read_terrain(path, **({"cell_size": 5.0} if suffix == ".npy" else {}))


# GeoTIFFs of all kinds


def write_tif(path, bands, transform, **profile):
    rasterio = pytest.importorskip("rasterio")
    bands = np.asarray(bands)[None] if np.ndim(bands) == 2 else np.asarray(bands)
    shape = {"count": bands.shape[0], "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", transform=transform, **shape, **profile) as dataset:
            dataset.write(bands)
    return path


def affine(*numbers):
    return pytest.importorskip("rasterio").Affine(*numbers)


HERE = (5.0, 0.0, 440_000.0, 0.0, -5.0, 5_100_000.0)


def test_a_geotiff_is_small_and_says_what_others_need(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    whole = Terrain(np.round(rough()), 12.5, (440_000.0, 5_100_000.0), UTM)
    write_terrain(whole, tmp_path / "a.tif")
    write_terrain(sample_terrain(), tmp_path / "b.tif")
    with rasterio.open(tmp_path / "a.tif") as a, rasterio.open(tmp_path / "b.tif") as b:
        assert a.dtypes == ("float32",) and b.dtypes == ("float64",)
        assert a.crs.to_string() == UTM and math.isnan(a.nodata) and a.units == ("m",)
        assert a.profile["compress"] == "deflate" and a.tags()["units"] == "m"
        assert a.tags(ns="IMAGE_STRUCTURE").get("PREDICTOR", "1") == "1"
        assert tuple(a.bounds) == whole.bounds
    same(read_terrain(tmp_path / "a.tif"), whole)


@pytest.mark.parametrize("kind", ["int16", "uint8", "float32", "float64", "uint32"])
def test_types_no_data_scale_and_bands(tmp_path, kind):
    band = np.arange(1, 13).reshape(3, 4).astype(kind)
    path = write_tif(tmp_path / "a.tif", np.stack([band, 2 * band]), affine(*HERE), nodata=5, crs=UTM)
    expected = np.where(band == 5, np.nan, band.astype(float))
    np.testing.assert_array_equal(read_terrain(path).to_numpy(), expected)
    second = 2.0 * np.where(np.isin(2 * band, (5, 8)), np.nan, band.astype(float))
    np.testing.assert_array_equal(read_terrain(path, band=2, nodata=8).to_numpy(), second)
    with pytest.raises(ValueError, match="no band 3; it has 1 to 2"):
        read_terrain(path, band=3)
    import rasterio

    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.25, 1.0), (-10.0, 0.0)
    np.testing.assert_array_equal(read_terrain(path).to_numpy(), 0.25 * expected - 10.0)


def test_a_mask_band_is_no_data(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = write_tif(tmp_path / "a.tif", rough(0.0).astype(np.float32), affine(*HERE), crs=UTM)
    mask = rough(0.3) > 0.0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as dataset:
        dataset.write_mask(mask)
    np.testing.assert_array_equal(np.isnan(read_terrain(path).to_numpy()), ~mask)


@pytest.mark.parametrize("flips", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_rasters_from_the_south_or_the_east_are_turned(tmp_path, flips):
    x_sign, y_sign = flips
    height = rough(0.1, 8, 11)
    numbers = (5.0 * x_sign, 0.0, 440_000.0 + (0.0 if x_sign > 0 else 55.0))
    numbers += (0.0, -5.0 * y_sign, 5_100_000.0 - (0.0 if y_sign > 0 else 40.0))
    path = write_tif(tmp_path / "a.tif", height[::y_sign, ::x_sign], affine(*numbers), crs=UTM, nodata=math.nan)
    same(read_terrain(path), Terrain(height, 5.0, (440_000.0, 5_100_000.0), UTM))


def test_a_rotated_raster_is_refused_or_turned(tmp_path):
    """A plane on cells turned by 30 degrees is the same plane after the warp."""
    turn = math.radians(30.0)
    a, d = 5.0 * math.cos(turn), 5.0 * math.sin(turn)
    numbers = (a, d, 440_000.0, d, -a, 5_100_000.0)
    row, column = np.indices((80, 100)) + 0.5
    x, y = a * column + d * row, d * column - a * row
    height = 100.0 + 0.2 * x - 0.1 * y
    path = write_tif(tmp_path / "a.tif", height, affine(*numbers), crs=UTM)
    with pytest.raises(ValueError, match="its rows do not run east; pass to_crs="):
        read_terrain(path)
    for to_crs in (UTM, "utm"):
        terrain = read_terrain(path, to_crs=to_crs)
        assert terrain.cell_size == pytest.approx(5.0) and terrain.crs == UTM
        gradient = terrain.gradient(
            np.stack([440_000.0 + x, 5_100_000.0 + y], axis=-1)[10:-10:7, 10:-10:7].reshape(-1, 2)
        )
        np.testing.assert_allclose(gradient, np.broadcast_to([0.2, -0.1], gradient.shape), atol=1e-6)
        at = terrain.sample([(440_000.0 + x[40, 50], 5_100_000.0 + y[40, 50])])
        assert at[0] == pytest.approx(height[40, 50], abs=1e-6)


def test_oblong_cells_need_a_size_and_nearly_square_ones_a_word(tmp_path):
    row, column = np.indices((40, 60)) + 0.5
    height = 2.0 * 10.0 * column - 3.0 * 15.0 * row
    path = write_tif(tmp_path / "a.tif", height, affine(10.0, 0.0, 440_000.0, 0.0, -15.0, 5_100_000.0), crs=UTM)
    with pytest.raises(ValueError, match="its cells are 10 x 15 m, not square; pass cell_size="):
        read_terrain(path)
    terrain = read_terrain(path, cell_size=5.0)
    assert terrain.shape == (120, 120) and terrain.origin == (440_000.0, 5_100_000.0)
    gradient = terrain.gradient(
        np.random.default_rng(0).uniform((440_020.0, 5_099_440.0), (440_580.0, 5_099_970.0), (99, 2))
    )
    np.testing.assert_allclose(gradient, np.broadcast_to([2.0, 3.0], gradient.shape), atol=1e-9)
    path = write_tif(tmp_path / "b.tif", height, affine(10.0, 0.0, 440_000.0, 0.0, -10.004, 5_100_000.0), crs=UTM)
    with pytest.warns(
        UserWarning, match=r"cells of 10 x 10.004 m are taken as 10.002 m square, off by 0.024 of a cell"
    ):
        assert read_terrain(path).cell_size == pytest.approx(10.002)
    path = write_tif(tmp_path / "c.tif", height, affine(10.0, 0.0, 440_000.0, 0.0, -10.000001, 5_100_000.0), crs=UTM)
    assert read_terrain(path).cell_size == pytest.approx(10.0)


def test_a_cell_size_resamples_a_raster_that_has_one(tmp_path):
    terrain = Terrain(rough(0.0, 20, 30), 10.0, (440_000.0, 5_100_000.0), UTM)
    write_terrain(terrain, tmp_path / "a.npz")
    for size in (20.0, 5.0):
        same(read_terrain(tmp_path / "a.npz", cell_size=size), terrain.resampled(size))
    same(read_terrain(tmp_path / "a.npz", cell_size=10.0), terrain)
    for wrong in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="cell_size is"):
            read_terrain(tmp_path / "a.npz", cell_size=wrong)
    with pytest.raises(ValueError, match="the file tells its origin; leave origin= out"):
        read_terrain(tmp_path / "a.npz", origin=(0.0, 0.0))


def test_a_geotiff_without_a_place_takes_it_from_the_caller(tmp_path):
    path = write_tif(tmp_path / "a.tif", rough(0.0), affine(1.0, 0.0, 0.0, 0.0, 1.0, 0.0))
    with pytest.raises(ValueError, match="does not tell the size of its cells"):
        read_terrain(path)
    terrain = read_terrain(path, cell_size=3.0, origin=(10.0, 20.0), crs=UTM)
    same(terrain, Terrain(rough(0.0), 3.0, (10.0, 20.0), UTM))


def lonlat_tif(path, crs="EPSG:4326"):
    """A cone of slope 0.1 around (-70, 46), on cells of 2 x 1.5 arc-seconds, with a corner of no data."""
    pyproj = pytest.importorskip("pyproj")
    row, column = np.indices((240, 260)) + 0.5
    lon, lat = -70.05 + column / 1800.0 * 0.7, 46.05 - row / 2400.0
    x, y = pyproj.Transformer.from_crs("EPSG:4326", UTM, always_xy=True).transform(lon, lat)
    x0, y0 = pyproj.Transformer.from_crs("EPSG:4326", UTM, always_xy=True).transform(-70.0, 46.0)
    height = 2000.0 - 0.1 * np.hypot(x - x0, y - y0)
    height[:40, :50] = -9999.0
    numbers = (0.7 / 1800.0, 0.0, -70.05, 0.0, -1.0 / 2400.0, 46.05)
    return write_tif(path, height.astype(np.float32), affine(*numbers), crs=crs, nodata=-9999.0), (x0, y0)


def test_a_geographic_raster_is_refused_or_reprojected(tmp_path):
    path, (x0, y0) = lonlat_tif(tmp_path / "a.tif")
    with pytest.raises(ValueError, match='EPSG:4326 is longitude and latitude, not metres; pass to_crs="utm"'):
        read_terrain(path)
    for to_crs, size in (("utm", None), (UTM, 60.0)):
        terrain = read_terrain(path, to_crs=to_crs, cell_size=size)
        assert terrain.crs == UTM and terrain.cell_size == (pytest.approx(37.4, abs=0.5) if size is None else size)
        angle = np.linspace(0.0, 6.28, 50)
        ring = np.array([x0, y0]) + 1500.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        np.testing.assert_allclose(terrain.sample(ring), 2000.0 - 150.0, atol=0.2)
        np.testing.assert_allclose(np.hypot(*terrain.gradient(ring).T), 0.1, atol=0.003)
        # No data stays so, and only the rim that the turned raster does not fill is added to it.
        gap = np.isnan(terrain.to_numpy()).mean()
        assert 40 * 50 / (240 * 260) < gap < 40 * 50 / (240 * 260) + 0.06
        assert np.nanmin(terrain.to_numpy()) > 0.0


def test_to_crs_of_the_same_system_changes_nothing(tmp_path):
    pytest.importorskip("pyproj")
    write_terrain(sample_terrain(), tmp_path / "a.npz")
    same(read_terrain(tmp_path / "a.npz", to_crs=UTM), sample_terrain())
    same(read_terrain(tmp_path / "a.npz", to_crs="utm"), sample_terrain())


def test_crs_that_is_missing_unknown_or_in_conflict(tmp_path):
    pytest.importorskip("pyproj")
    write_terrain(sample_terrain(crs=None), tmp_path / "a.npz")
    assert read_terrain(tmp_path / "a.npz", crs="epsg:32619").crs == UTM
    with pytest.raises(ValueError, match="states no CRS to reproject from; pass it as crs="):
        read_terrain(tmp_path / "a.npz", to_crs="utm")
    with pytest.raises(ValueError, match="pyproj does not know the CRS"):
        read_terrain(tmp_path / "a.npz", crs="EPSG:0")
    write_terrain(sample_terrain(), tmp_path / "b.npz")
    with pytest.raises(ValueError, match="the file is in EPSG:32619 but crs= says EPSG:32620"):
        read_terrain(tmp_path / "b.npz", crs="EPSG:32620")
    with pytest.raises(ValueError, match=r"in US survey foot, not metres|US survey foot"):
        read_terrain(tmp_path / "a.npz", crs="EPSG:2263")
    (tmp_path / "c.asc").write_text(ASC.replace("100.0", "-70.0").replace("200.0", "45.0").replace("10.0", "0.0008"))
    with pytest.raises(ValueError, match='look like longitude and latitude and no CRS is stated; pass crs="EPSG:4326"'):
        read_terrain(tmp_path / "c.asc")


def test_heights_in_feet_and_undeclared_no_data_are_told(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = write_tif(tmp_path / "a.tif", rough(0.0), affine(*HERE), crs=UTM)
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ("US survey foot",)
    with pytest.warns(UserWarning, match=r"heights are in 'US survey foot'; they were multiplied by 0\.3048006096 "):
        scaled = read_terrain(path)
    np.testing.assert_allclose(scaled.to_numpy(), 1200.0 / 3937.0 * rough(0.0), rtol=1e-15)
    np.testing.assert_allclose(read_terrain(path, z_factor=0.3048).to_numpy(), 0.3048 * rough(0.0), rtol=1e-15)
    for wrong in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="z_factor is"):
            read_terrain(path, z_factor=wrong)
    height = rough(0.0).astype(np.float32)
    height[2, 3] = -32768.0
    path = write_tif(tmp_path / "b.tif", height, affine(*HERE), crs=UTM)
    with pytest.warns(UserWarning, match="of its cells 1 is -32768, which nothing in the file explains"):
        assert np.isnan(read_terrain(path).to_numpy()[2, 3])
    assert np.isnan(read_terrain(path, nodata=-32768).to_numpy()[2, 3])
    with pytest.warns(UserWarning, match="1 heights are as low as -32768 m; if that stands for no data, pass nodata="):
        assert read_terrain(path, nodata=math.nan).to_numpy()[2, 3] == -32768.0


# xarray


def test_xarray_out_and_in(tmp_path):
    pytest.importorskip("xarray")
    from warpriver.io.raster.xarrays import from_xarray, to_xarray

    terrain = sample_terrain()
    array = to_xarray(terrain)
    assert array.dims == ("y", "x") and array.attrs["units"] == "m" and array.name == "height"
    assert float(array.y[0]) > float(array.y[-1])
    assert float(array.x[0]) == terrain.origin[0] + 0.5 * terrain.cell_size
    assert "32619" in array.spatial_ref.attrs["crs_wkt"]
    same(from_xarray(array), terrain)
    same(from_xarray(array[::-1]), terrain)
    same(from_xarray(array.T), terrain)
    same(from_xarray(array.expand_dims("band")), terrain)
    same(from_xarray(to_xarray(sample_terrain(crs=None))), sample_terrain(crs=None))
    same(
        from_xarray(array.isel(x=slice(3, 15), y=slice(2, 9))),
        terrain.crop((array.x[3] - 1, array.y[8] - 1, array.x[14] + 1, array.y[2] + 1)),
    )
    coarse = from_xarray(array, cell_size=25.0)
    np.testing.assert_array_equal(coarse.to_numpy(), terrain.resampled(25.0).to_numpy())


def test_xarray_of_others():
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("rasterio")
    from warpriver.io.raster.xarrays import from_xarray

    lat, lon = np.linspace(45.9, 46.1, 120), np.linspace(-70.1, -69.9, 100)
    height = 5000.0 * (lat[:, None] - 45.9) + 0.0 * lon
    array = xarray.DataArray(height, dims=("lat", "lon"), coords={"lat": lat, "lon": lon})
    with pytest.raises(ValueError, match="longitude and latitude, not metres"):
        from_xarray(array)
    terrain = from_xarray(array, to_crs="utm")
    assert terrain.crs == UTM
    middle = np.mean([terrain.bounds[:2], terrain.bounds[2:]], axis=0)
    # North of the grid is 0.7 degrees off at this place of the zone.
    east, north = terrain.gradient([middle])[0]
    assert north == pytest.approx(5000.0 / 111_150.0, rel=1e-3) and abs(east) < 6e-4
    filled = xarray.DataArray(
        np.array([[1, -999], [3, 4]], np.int16), dims=("y", "x"), coords={"y": [30.0, 20.0], "x": [0.0, 10.0]},
        attrs={"_FillValue": -999},
    )  # fmt: skip
    np.testing.assert_array_equal(from_xarray(filled).to_numpy(), [[1.0, np.nan], [3.0, 4.0]])
    uneven = filled.assign_coords(x=[0.0, 11.0]).reindex(x=[0.0, 11.0, 15.0])
    cases = [
        (np.zeros((3, 3)), "no xarray.DataArray"),
        (filled.to_dataset(name="a"), "no xarray.DataArray; pick one variable"),
        (filled.rename(y="time"), r"dimensions are \('time', 'x'\); a terrain needs \(y, x\)"),
        (filled.drop_vars("x"), "'x' needs coordinates"),
        (uneven, "'x' are unevenly spaced"),
        (filled.assign_coords(x=[0.0, np.nan]), "not finite numbers"),
        (filled.assign_coords(x=[0.0, 20.0]), "not square; pass cell_size="),
    ]
    for wrong, text in cases:
        with pytest.raises(ValueError, match=text):
            from_xarray(wrong)


# The DEMs of the data folder: shape, CRS, and lowest and highest height as their README has them.

DEMS = {
    "bigtujunga_srtm30m.tif": ({}, (643, 1197), "EPSG:32611", 315.0, 2295.0, 0.0),
    "boulder_co_srtmgl3.asc": ({"crs": "EPSG:4326", "to_crs": "utm"}, None, "EPSG:32613", 1943.0, 3286.0, 0.03),
    "gabilan_lidar1m.tif": ({}, (859, 921), "EPSG:32610", 187.9, 307.28, 0.0),
    "hugo_site_10m.asc": ({}, (55, 76), None, 1660.0, 1711.0, 0.485),
    "mandakini_srtm90m.tif": ({}, (648, 587), "EPSG:32644", 644.0, 6741.0, 0.452),
    "minnesota_potholes_lidar1m.tif": ({}, (400, 400), "EPSG:26915", 379.66, 410.76, 0.0),
    "shellmound_100m_feet.tif": ({"z_factor": 0.3048006}, (341, 391), "EPSG:5070", 30.445, 46.551, 0.008),
    "smith_rock_srtm90m.tif": ({"to_crs": "utm"}, None, "EPSG:32610", 788.0, 1267.0, 0.08),
    "vermont_90m_nocrs.tif": ({"crs": "EPSG:32618"}, (188, 237), "EPSG:32618", 212.23, 1233.1, 0.0),
    "west_bijou_gully_3m.asc": ({}, (89, 43), None, 1680.78, 1725.43, 0.716),
}


@pytest.mark.parametrize("name", DEMS)
def test_a_real_dem_is_read(name, tmp_path):
    path = data_folder("dem") / name
    arguments, shape, crs, low, high, gap = DEMS[name]
    if path.suffix == ".tif" or "to_crs" in arguments:
        pytest.importorskip("rasterio")
        pytest.importorskip("pyproj")
    with warnings.catch_warnings():
        if name.startswith("vermont"):
            warnings.simplefilter("ignore", UserWarning)
        terrain = read_terrain(path, **arguments)
    height = terrain.to_numpy()
    assert terrain.crs == crs and shape in (None, terrain.shape)
    warped = "to_crs" in arguments
    assert np.nanmin(height) == pytest.approx(low, abs=10.0 if warped else 0.01)
    assert np.nanmax(height) == pytest.approx(high, abs=10.0 if warped else 0.01)
    assert np.isnan(height).mean() == pytest.approx(gap, abs=0.02)
    slope = terrain.slope()
    assert 0.0 < np.nanmedian(slope) < 1.0
    write_terrain(terrain, tmp_path / "a.npz")
    same(read_terrain(tmp_path / "a.npz"), terrain)


def test_the_geographic_dems_are_refused_as_they_are():
    folder = data_folder("dem")
    with pytest.raises(ValueError, match="look like longitude and latitude"):
        read_terrain(folder / "boulder_co_srtmgl3.asc")
    pytest.importorskip("rasterio")
    with pytest.raises(ValueError, match="EPSG:4326 is longitude and latitude"):
        read_terrain(folder / "smith_rock_srtm90m.tif")
    with pytest.warns(UserWarning, match="'US feet'"):
        read_terrain(folder / "shellmound_100m_feet.tif")


def test_the_nhd_elevations_of_shellmound_are_those_of_the_dem_in_feet():
    """Flowlines of the reference network carry elevations in feet: the terrain in metres must be 0.3048 of them."""
    pytest.importorskip("rasterio")
    pyogrio = pytest.importorskip("pyogrio")
    pytest.importorskip("geopandas")
    folder = data_folder("dem")
    terrain = read_terrain(folder / "shellmound_100m_feet.tif", z_factor=0.3048006)
    lines = pyogrio.read_dataframe(folder.parent / "networks" / "shellmound_nhdplus.gpkg", layer="flowlines")
    heads = np.array(
        [np.asarray(g.geoms[0].coords if hasattr(g, "geoms") else g.coords)[0, :2] for g in lines.geometry]
    )
    ground = terrain.sample(heads) / 0.3048006
    known = np.isfinite(ground) & (lines["elevup"].to_numpy() > 0.0)
    ratio = ground[known] / lines["elevup"].to_numpy()[known]
    assert known.sum() > 150 and np.median(ratio) == pytest.approx(1.05, abs=0.03)
