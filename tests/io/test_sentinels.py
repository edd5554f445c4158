"""Tests of numbers that stand for no data although nothing says so, in files of heights, in arrays and in text."""

import math
import warnings

import numpy as np
import pytest

from warpriver import RiverNetwork, Terrain
from warpriver.io import from_xarray, raster_from_xarray, read_network, read_raster, read_terrain
from warpriver.sentinels import equal_cells, find_sentinels

FLOAT_MIN = float(np.finfo(np.float32).min)


def valley(rows=30, columns=40):
    y, x = np.mgrid[0:rows, 0:columns]
    return 200.0 + 0.6 * (rows - y) + 1.5 * np.abs(x - columns // 2)


def holed(value, dtype="float32", cells=(slice(3), slice(None))):
    height = valley().astype(dtype)
    height[cells] = value
    return height


def write_tif(path, height, **more):
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import Affine

    profile = {"driver": "GTiff", "height": height.shape[0], "width": height.shape[1], "count": 1}
    place = {"transform": Affine(30.0, 0.0, 5e5, 0.0, -30.0, 5e6), "crs": "EPSG:32633"}
    with rasterio.open(path, "w", dtype=height.dtype.name, **profile, **(place | more)) as dataset:
        dataset.write(height, 1)
    return path


CASES = [
    (-9999.0, "float32"), (-9999, "int16"), (-32768, "int16"), (32767, "int16"), (-32767, "float32"),
    (-99999.0, "float32"), (-999.0, "float32"), (65535, "uint16"), (1.70141e38, "float32"), (3.4e38, "float32"),
    (FLOAT_MIN, "float32"), (-1.7976931348623157e308, "float64"), (1e20, "float32"), (9.969209968386869e36, "float32"),
]  # fmt: skip


@pytest.mark.parametrize(("value", "dtype"), CASES, ids=[f"{v:g}-{d}" for v, d in CASES])
@pytest.mark.parametrize("suffix", [".tif", ".npz", ".npy", ".asc"])
def test_gaps_that_nothing_declares_are_no_ground(tmp_path, value, dtype, suffix):
    height, path = holed(value, dtype), tmp_path / f"dem{suffix}"
    if suffix == ".tif":
        write_tif(path, height)
    elif suffix == ".asc":
        rows = "\n".join(" ".join(map(repr, row)) for row in height.astype(float).tolist())
        path.write_text(f"ncols 40\nnrows 30\nxllcorner 0\nyllcorner 0\ncellsize 30\nNODATA_value nan\n{rows}\n")
    elif suffix == ".npz":
        np.savez(path, height=height, cell_size=30.0)
    else:
        np.save(path, height)
    place = {"cell_size": 30.0} if suffix == ".npy" else {}
    if suffix == ".asc":  # the header names another value: they are kept, and told
        with pytest.warns(UserWarning, match=r"of its cells 120 are .*may stand for no data; if so, pass nodata="):
            read_terrain(path)
    else:
        with pytest.warns(UserWarning, match=r"of its cells 120 are .*which nothing in the file explains") as told:
            terrain = read_terrain(path, **place)
        assert len(told) == 1
        assert np.isnan(terrain.to_numpy()[:3]).all() and np.isfinite(terrain.to_numpy()[3:]).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert np.isnan(read_terrain(path, nodata=float(value), **place).to_numpy()[:3]).all()


def test_a_value_that_is_one_of_many_is_a_height(tmp_path):
    """The floor of the sea passes -9999 m, and a plane may pass any number."""
    for low, high in ((-10_500.0, -9_500.0), (-1_200.0, -800.0), (32_000.0, 33_000.0)):
        heights = np.linspace(low, high, 1001)[: 1000 // 25 * 25].reshape(-1, 25).round()
        assert not find_sentinels(heights)
    assert not find_sentinels(np.full((3, 3), -9999.0)), "a flat map of one height is one"
    assert find_sentinels(np.array([[-9999.0, 3.0], [4.0, 5.0]])) == [(-9999.0, 1)]
    both = np.array([[-9999.0, -32768.0, -32768.0], [4.0, 5.0, np.nan]])
    assert find_sentinels(both) == [(-32768.0, 2), (-9999.0, 1)]
    assert not find_sentinels(np.full((2, 2), np.nan)) and not find_sentinels(np.zeros((2, 2), bool))
    labels = np.array([[2_000_000_000, 7], [8, 9]], np.int64)
    assert not find_sentinels(labels), "whole numbers may be labels of any size"


def test_the_caller_has_the_last_word(tmp_path):
    path = write_tif(tmp_path / "a.tif", holed(-9999.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert read_terrain(path, nodata=math.nan).to_numpy().min() == -9999.0
    declared = write_tif(tmp_path / "b.tif", holed(-9999.0), nodata=-32768.0)
    with pytest.warns(UserWarning, match="may stand for no data; if so, pass nodata=-9999"):
        assert read_terrain(declared).to_numpy().min() == -9999.0
    assert np.isnan(read_terrain(declared, nodata=-9999).to_numpy()[:3]).all()


def test_values_of_other_rasters_are_told_and_kept(tmp_path):
    path = write_tif(tmp_path / "a.tif", holed(-9999, "int16"))
    with pytest.warns(UserWarning, match="may stand for no data"):
        raster = read_raster(path)
    assert raster.dtype == np.int16 and raster.numpy().min() == -9999


@pytest.mark.parametrize("typed", [-3.40282e38, -3.4e38, FLOAT_MIN])
def test_a_huge_value_is_matched_by_its_first_digits(tmp_path, typed):
    path = write_tif(tmp_path / "a.tif", holed(FLOAT_MIN))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        assert np.isnan(read_terrain(path, nodata=typed).to_numpy()[:3]).all()
    assert not equal_cells(np.array([-9999.5]), -9999.0).any(), "others are matched exactly"


def test_the_default_of_ascii_grids(tmp_path):
    text = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 5\n1 2 3\n-9999 5 6\n"
    (tmp_path / "a.asc").write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        height = read_terrain(tmp_path / "a.asc").to_numpy()
    assert np.isnan(height[1, 0]) and np.isfinite(height).sum() == 5
    np.testing.assert_array_equal(read_raster(tmp_path / "a.asc", nodata=math.nan).numpy()[1], [-9999, 5, 6])


def test_sentinels_are_found_before_scale_and_offset(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    raw = ((valley() - 100.0) * 10.0).round().astype("int16")
    raw[:3] = -9999
    path = write_tif(tmp_path / "a.tif", raw)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.1,), (100.0,)
    with pytest.warns(UserWarning, match="of its cells 120 are -9999"):
        height = read_terrain(path).to_numpy()
    assert np.isnan(height[:3]).all()
    np.testing.assert_allclose(height[3:], valley()[3:], atol=0.051)


def test_arrays_are_told():
    with pytest.warns(UserWarning, match="height: of its cells 120 are -9999; if that stands for no data, write NaN"):
        terrain = Terrain(holed(-9999.0), 30.0)
    assert terrain.to_numpy().min() == -9999.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(Terrain(np.ma.masked_equal(holed(-9999.0), -9999.0), 30.0).to_numpy()[:3]).all()


def test_xarray_that_was_not_decoded():
    xarray = pytest.importorskip("xarray")
    raw = ((valley() - 100.0) * 10.0).round().astype("int16")
    raw[:3] = -9999
    place = {"y": 5e6 - 15.0 - 30.0 * np.arange(30), "x": 5e5 + 15.0 + 30.0 * np.arange(40)}

    def array(values, **told):
        return xarray.DataArray(values, dims=("y", "x"), coords=place, name="dem", attrs=told)

    scaled = {"scale_factor": 0.1, "add_offset": 100.0}
    for gap in ({"_FillValue": -9999}, {"missing_value": -9999}, {"missing_value": [-9999, -1]}, {"valid_min": -500}):
        height = from_xarray(array(raw, **gap, **scaled)).to_numpy()
        assert np.isnan(height[:3]).all(), gap
        np.testing.assert_allclose(height[3:], valley()[3:], atol=0.051)
    height = from_xarray(array(raw, valid_range=[-500, 32000], scale_factor=0.1)).to_numpy()
    np.testing.assert_allclose(height[3:], valley()[3:] - 100.0, atol=0.051)
    with pytest.warns(UserWarning, match="array 'dem': of its cells 120 are -9999"):
        assert np.isnan(from_xarray(array(raw)).to_numpy()[:3]).all()
    assert raster_from_xarray(array(raw, missing_value=-9999)).numpy().dtype == np.float64
    # What was decoded says in its encoding how it was stored: its values are what they are.
    decoded = array(valley())
    decoded.encoding = {"_FillValue": 200.6, "scale_factor": 0.1}
    np.testing.assert_array_equal(from_xarray(decoded).to_numpy(), valley())


# ---- text and attributes of lines


def rows(name, values):
    return f"x,y,width,{name}\n" + "".join(f"{50 * k},{k % 2},30,{v}\n" for k, v in enumerate(values))


@pytest.mark.parametrize("none", ["-9999", "-9999.0", "-9998", "-999", "-99999", "nan", "", "NA", "1e38"])
def test_rows_of_no_value_are_left_to_the_others(tmp_path, none):
    path = tmp_path / "a.csv"
    path.write_text(rows("slope", ["0.001", none, "0.003", "0.002"]))
    np.testing.assert_allclose(read_network(path).channel_slope, [0.002])
    path.write_text(rows("discharge", [none, "80", "100", "90"]))
    np.testing.assert_allclose(read_network(path).channel_discharge, [90.0])
    path.write_text(rows("depth", ["2", none, "4", none]))
    with pytest.warns(UserWarning, match=r"a\.csv: 2 of 4 rows have no depth; it is interpolated along each channel"):
        np.testing.assert_allclose(read_network(path).point_depths()[0], [2.0, 3.0, 4.0, 4.0])
    path.write_text(rows("drainage_area_km2", ["1", "2", "3", none]))
    np.testing.assert_allclose(read_network(path).channel_drainage_area, [3e6])
    for name in ("slope", "discharge", "depth", "drainage_area_km2", "z"):
        path.write_text(rows(name, [none] * 4))
        network = read_network(path)
        assert network.channel_depth[0] > 0.0 and network.channel_discharge[0] > 0.0 and network.point_z is None
        assert np.isnan(network.channel_slope[0]) and network.channel_drainage_area is None


def test_a_point_of_no_value_is_no_place(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,width\n0,0,9\n50,0,9\n-9999,-9999,9\n100,0,9\n")
    with pytest.raises(ValueError, match=r"a\.csv: point 2 is at \(-9999, -9999\), which stands for no value; remove"):
        read_network(tmp_path / "a.csv")


def test_unknown_areas_stay_unknown():
    lines = [[(0.0, 500.0 * k), (300.0, 500.0 * k), (600.0, 500.0 * k)] for k in range(2)]
    network = RiverNetwork.from_polylines(lines, width=20.0, drainage_area=[math.nan, 4e6])
    np.testing.assert_array_equal(network.channel_drainage_area, [math.nan, 4e6])
    np.testing.assert_array_equal(network.channel_flow(), network.channel_discharge)
    with pytest.raises(ValueError, match=r"channel_drainage_area of channel 0 is -3; it must be positive, or NaN"):
        RiverNetwork.from_polylines(lines, width=20.0, drainage_area=[-3.0, 4e6])
