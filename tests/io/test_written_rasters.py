"""Tests of what other programs find in the raster files: place, unit, no data, overviews."""

import importlib.util
import json

import numpy as np
import pytest

from warpriver.io import read_terrain, to_xarray, write_raster, write_terrain
from warpriver.raster import Raster
from warpriver.terrain import Terrain

rasterio = pytest.importorskip("rasterio")
FOREIGN = [".sdat", ".bil", ".img"]
AFFINE = (30.0, 0.0, 376313.25, 0.0, -30.0, 3807917.5)
PLACE = (30.0, (376313.25, 3807917.5), "EPSG:32611")


def bumpy(shape=(60, 80), gap=False):
    """Heights whose bits do not fit into float32, with cells without data or none."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    height = 100.0 + 40.0 * np.sin(0.1 * x) * np.cos(0.13 * y) + 1e-9 * x
    if gap:
        height[10:20, 30:50] = np.nan
    return height


def opened(path):
    return rasterio.open(path)


# ---- GeoTIFF


@pytest.mark.parametrize("kind", ["float32", "float64", "int32", "uint8"])
def test_a_geotiff_is_cloud_optimized(tmp_path, kind):
    values = bumpy((1300, 1100), gap=kind[0] == "f").astype(kind)
    write_raster(Raster(values, *PLACE, "m", "height"), tmp_path / "a.tif")
    with opened(tmp_path / "a.tif") as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.block_shapes == [(512, 512)] and file.overviews(1) == [2, 4]
        assert file.dtypes == (kind,) and (file.units, file.descriptions) == (("m",), ("height",))
        assert (file.nodata is None) == (kind[0] != "f")
        np.testing.assert_array_equal(file.read(1), values)
    with rasterio.open(tmp_path / "a.tif", overview_level=0) as file:
        coarse = file.read(1)
    blocks = values.reshape(650, 2, 550, 2)
    if kind[0] == "f":  # means, of the cells that have data
        whole = np.isfinite(blocks).all(axis=(1, 3))
        np.testing.assert_allclose(coarse[whole], blocks.mean(axis=(1, 3))[whole], rtol=1e-6)
        assert np.isnan(coarse[8, 20])
    else:  # a cell of the four, no number between them
        assert (coarse[:, None, :, None] == blocks).any(axis=(1, 3)).all()


# ---- formats of other programs


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("suffix", FOREIGN)
def test_other_programs_formats(tmp_path, suffix, gap):
    height, path = bumpy(gap=gap), tmp_path / f"a{suffix}"
    if suffix == ".bil":
        with pytest.warns(UserWarning, match=r"a\.bil: \.bil holds numbers of 32 bits: they are rounded, by up to \d"):
            write_terrain(Terrain(height, *PLACE), path)
    else:
        write_terrain(Terrain(height, *PLACE), path)
    with opened(path) as file:
        assert file.crs.to_epsg() == 32611 and tuple(file.transform)[:6] == (
            30.0,
            0.0,
            376313.25,
            0.0,
            -30.0,
            3807917.5,
        )
        assert file.units == ("m",) and file.nodata == -9999.0
        read = file.read(1, masked=True).astype(np.float64).filled(np.nan)
    np.testing.assert_allclose(read, height, rtol=1e-7 if suffix == ".bil" else 0.0)
    again = read_terrain(path)
    np.testing.assert_array_equal(again.to_numpy(), read)
    assert (again.origin, again.crs) == PLACE[1:]
    # A later file without a CRS keeps none of the older one's.
    write_terrain(Terrain(np.round(height), 30.0), path)
    with opened(path) as file:
        assert file.crs is None


@pytest.mark.parametrize("suffix", FOREIGN)
@pytest.mark.parametrize("kind", ["uint8", "int8", "uint16", "int64"])
def test_whole_numbers_of_other_programs_formats(tmp_path, suffix, kind):
    values = np.arange(48, dtype=kind).reshape(6, 8)
    values[0, 0] = 255 if kind == "uint8" else 100
    write_raster(Raster(values, *PLACE), tmp_path / f"a{suffix}")
    with opened(tmp_path / f"a{suffix}") as file:
        assert np.dtype(file.dtypes[0]).kind in "iu"
        assert not np.ma.getmaskarray(file.read(1, masked=True)).any()  # 255 is a number here
        np.testing.assert_array_equal(file.read(1), values)


@pytest.mark.parametrize("suffix", FOREIGN)
def test_numbers_that_a_format_cannot_hold(tmp_path, suffix):
    with pytest.raises(ValueError, match=rf"a\{suffix}: whole numbers up to \d+ do not fit into 32 bits; write .tif"):
        write_raster(Raster(np.full((3, 3), 2**40), 1.0), tmp_path / f"a{suffix}")
    if suffix == ".bil":
        with pytest.raises(ValueError, match=r"numbers up to 1e\+300 do not fit into 32 bits"):
            write_terrain(Terrain(np.array([[1e300, 0.0], [0.0, 0.0]]), 1.0), tmp_path / "a.bil")
    assert not list(tmp_path.iterdir())


def test_no_data_is_a_value_that_no_cell_has(tmp_path):
    height = bumpy(gap=True)
    height[0, 0] = -9999.0
    write_raster(Raster(height, *PLACE), tmp_path / "a.sdat")
    with opened(tmp_path / "a.sdat") as file:
        assert file.nodata == -99999.0 and file.read(1)[0, 0] == -9999.0


# ---- height maps


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("suffix", [".png", ".r16", ".raw"])
def test_a_height_map_is_placed_and_in_metres(tmp_path, suffix, gap):
    height, path = bumpy(gap=gap), tmp_path / f"a.b{suffix}"
    write_terrain(Terrain(height, *PLACE), path)
    with opened(path) as file:
        assert file.crs.to_epsg() == 32611 and tuple(file.transform)[:6] == (
            30.0,
            0.0,
            376313.25,
            0.0,
            -30.0,
            3807917.5,
        )
        assert file.units == ("m",) and file.nodata == (0.0 if gap else None)
        steps = file.read(1, masked=True).astype(np.float64).filled(np.nan)
        metres = steps * file.scales[0] + file.offsets[0]
    half = 0.5 * file.scales[0] * (1.0 + 1e-9)
    np.testing.assert_allclose(metres, height, atol=half)
    np.testing.assert_allclose(read_terrain(path).to_numpy(), metres, atol=1e-9)
    side = json.loads((tmp_path / f"a.b{suffix}.json").read_text())
    assert side["unreal_scale_xy"] == 3000.0
    # 65,535 steps are 512 m at a scale of 100.
    assert side["unreal_scale_z"] / 100.0 * 512.0 / 65535.0 == pytest.approx(file.scales[0])
    # Nothing of it stays when it is replaced by one elsewhere.
    write_terrain(Terrain(height, 10.0), path)
    with opened(path) as file:
        assert file.crs is None and file.transform.a == 10.0


def test_a_png_has_a_world_file(tmp_path):
    write_terrain(Terrain(bumpy(), *PLACE), tmp_path / "a.png")
    numbers = [float(line) for line in (tmp_path / "a.pgw").read_text().split()]
    assert numbers == [30.0, 0.0, 0.0, -30.0, 376328.25, 3807902.5]  # the centre of the first pixel


# ---- NetCDF


def test_netcdf_is_a_plane_in_paraview(tmp_path):
    array = to_xarray(Terrain(bumpy(), *PLACE))
    assert not {"axis"} & set(array.x.attrs) | {"axis"} & set(array.y.attrs)
    assert [array[n].attrs["standard_name"] for n in "xy"] == [f"projection_{n}_coordinate" for n in "xy"]
    if importlib.util.find_spec("vtk") is None:
        pytest.skip("vtk is not installed (warpriver[viz])")
    import vtk

    array.to_netcdf(tmp_path / "a.nc", format="NETCDF3_64BIT", engine="scipy")
    reader = vtk.vtkNetCDFCFReader()
    reader.SetFileName(str(tmp_path / "a.nc"))
    reader.Update()
    west, east, south, north = reader.GetOutputDataObject(0).GetBounds()[:4]
    assert (west, east, south, north) == (376328.25, 378698.25, 3806132.5, 3807902.5)
