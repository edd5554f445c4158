"""Tests of units, longitudes and other people's conventions of rasters: scaled, turned, shifted, or told."""

import json
import math
import warnings

import numpy as np
import pytest
from test_sentinels import valley, write_tif

from warpriver import Terrain
from warpriver.io import from_xarray, read_network, read_raster, read_terrain, write_terrain
from warpriver.io.raster import reproject
from warpriver.io.units import is_degrees, metres_in, names_a_unit

US_FOOT = 1200.0 / 3937.0


@pytest.mark.parametrize(
    ("names", "factor"),
    [
        (("m", "Metre", "meters", "metre (EGM96)", "m above NAVD88", "Elevation [m]", "m a.s.l."), 1.0),
        (("US_survey_foot", "ftUS", "Foot_US", "us-ft", "US survey foot", "U.S. Survey Feet"), US_FOOT),
        (("ft", "foot", "Feet", "feet (NAVD88)", "International Foot"), 0.3048),
        (("cm", "centimetre", "Centimeters"), 0.01),
        (("dm",), 0.1),
        (("mm",), 0.001),
        (("km", "kilometres"), 1000.0),
        (("fathoms",), 1.8288),
        (("m/m", "m2", "m s-1", "metres per year", "K", "degrees", "furlong of beer", "m or ft"), None),
    ],
)
def test_units_as_files_spell_them(names, factor):
    for name in names:
        assert metres_in(name) == factor, name


def test_what_names_no_unit():
    assert not any(map(names_a_unit, (None, "", " ", "1", "unknown", "None", "n/a", "-")))
    assert names_a_unit("m") and names_a_unit("K")
    assert all(map(is_degrees, ("degrees_east", "degree", "deg"))) and not is_degrees("m")


@pytest.mark.parametrize("unit", ["US_survey_foot", "ftUS", "Foot_US", "centimetre", "cm", "dm", "mm", "km", "feet"])
def test_heights_of_other_units_are_scaled_and_told(tmp_path, unit):
    rasterio = pytest.importorskip("rasterio")
    path = write_tif(tmp_path / "a.tif", valley())
    with rasterio.open(path, "r+") as dataset:
        dataset.units = (unit,)
    with pytest.warns(UserWarning, match=rf"heights are in '{unit}'; they were multiplied by .* Pass z_factor="):
        height = read_terrain(path, nodata=math.nan).to_numpy()
    np.testing.assert_allclose(height, metres_in(unit) * valley(), rtol=1e-15)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_allclose(read_terrain(path, z_factor=2.0).to_numpy(), 2.0 * valley(), rtol=1e-15)


@pytest.mark.parametrize("crs", ["EPSG:26913+6360", "EPSG:26913+8228"])
def test_the_unit_of_a_vertical_crs_counts_wherever_it_is_stated(tmp_path, crs):
    pyproj = pytest.importorskip("pyproj")
    factor = pyproj.CRS(crs).axis_info[2].unit_conversion_factor
    write_tif(tmp_path / "a.tif", valley() / factor, crs=crs)
    grid = "ncols 40\nnrows 30\nxllcorner 0\nyllcorner 0\ncellsize 30\n" + "\n".join(
        " ".join(map(repr, row)) for row in (valley() / factor).tolist()
    )
    (tmp_path / "b.asc").write_text(grid)
    (tmp_path / "b.prj").write_text(pyproj.CRS(crs).to_wkt())
    (tmp_path / "c.asc").write_text(grid)
    for name, more in (("a.tif", {}), ("b.asc", {}), ("c.asc", {"crs": crs})):
        with pytest.warns(UserWarning, match=r"multiplied by 0\.3048"):
            np.testing.assert_allclose(read_terrain(tmp_path / name, **more).to_numpy(), valley(), rtol=1e-12)


def test_a_unit_that_is_not_known_is_never_metres(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = write_tif(tmp_path / "a.tif", valley())
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ("kelvin",)
    with pytest.raises(ValueError, match=r"its heights are in 'kelvin', which is not known.*pass z_factor="):
        read_terrain(path)
    np.testing.assert_array_equal(read_terrain(path, z_factor=1.0).to_numpy(), valley())
    assert read_raster(path).unit == "kelvin", "a raster may hold anything"


def test_heights_that_only_feet_can_be_are_told(tmp_path):
    path = write_tif(tmp_path / "a.tif", 40.0 * valley())
    with pytest.warns(UserWarning, match=r"heights are up to .* m; if they are in feet, pass z_factor=0\.3048"):
        read_terrain(path)


LOCAL = ['LOCAL_CS["site",UNIT["foot",0.3048]]', 'LOCAL_CS["site",UNIT["kilometre",1000]]']


@pytest.mark.parametrize(("crs", "factor"), zip(LOCAL, (0.3048, 1000.0), strict=True))
def test_local_systems_of_other_units(tmp_path, crs, factor):
    path = write_tif(tmp_path / "a.tif", valley(), crs=crs)
    with pytest.warns(UserWarning, match=r"coordinates are in '\w+' of a local system; they were multiplied by"):
        terrain = read_terrain(path)
    assert terrain.crs is None and terrain.cell_size == pytest.approx(30.0 * factor, rel=1e-12)
    np.testing.assert_allclose(terrain.origin, (5e5 * factor, 5e6 * factor), rtol=1e-12)
    geopandas = pytest.importorskip("geopandas")
    from shapely.geometry import LineString

    lines = geopandas.GeoDataFrame({"width": [9.0]}, geometry=[LineString([(0, 0), (500, 1), (1000, 0)])], crs=crs)
    lines.to_file(tmp_path / "a.gpkg")
    with pytest.warns(UserWarning, match="coordinates are in '"):
        network = read_network(tmp_path / "a.gpkg")
    assert network.crs is None
    np.testing.assert_allclose(network.polylines()[0], factor * np.array([(0, 0), (500, 1), (1000, 0)]), rtol=1e-12)


def array(unit_xy=None, unit=None, factor=1.0, crs=None):
    xarray = pytest.importorskip("xarray")
    y, x = (5e6 - 15.0 - 30.0 * np.arange(30)) * factor, (5e5 + 15.0 + 30.0 * np.arange(40)) * factor
    made = xarray.DataArray(valley(), dims=("y", "x"), coords={"y": y, "x": x}, attrs={"units": unit} if unit else {})
    for name in "xy" if unit_xy else "":
        made[name].attrs["units"] = unit_xy
    if crs:
        made.attrs["crs"] = crs
    return made


@pytest.mark.parametrize("crs", [None, "EPSG:32633"])
def test_coordinates_of_an_array_in_other_units(crs):
    for unit, factor in (("km", 1e-3), ("m", 1.0), ("ft", 1.0 / 0.3048), ("kilometers", 1e-3), (None, 1.0), ("1", 1.0)):
        terrain = from_xarray(array(unit, factor=factor, crs=crs))
        assert terrain.cell_size == pytest.approx(30.0, rel=1e-9)
        np.testing.assert_allclose(terrain.origin, (5e5, 5e6), rtol=1e-9)
    with pytest.raises(ValueError, match="the coordinates 'x' are in 'radian', which is not known as a unit of length"):
        from_xarray(array("radian", crs=crs))
    with pytest.warns(UserWarning, match="heights are in 'cm'"):
        np.testing.assert_allclose(from_xarray(array(unit="cm")).to_numpy(), 0.01 * valley(), rtol=1e-15)


def test_an_array_is_not_read_without_its_coordinates():
    """Rows of an array may run from the south: without its coordinates it would be mirrored."""
    with pytest.raises(ValueError, match=r"height is an xarray array.*wr\.from_xarray reads it as it lies"):
        Terrain(array(), 30.0)
    south_up = array()[::-1]
    np.testing.assert_array_equal(from_xarray(south_up).to_numpy(), valley())


# ---- landlab


def test_landlab_has_row_0_in_the_south(tmp_path):
    np.savez(tmp_path / "a.npz", topographic__elevation=valley()[::-1], cell_size=30.0)
    for read in (read_terrain, read_raster):
        with pytest.warns(UserWarning, match="taken as landlab has it, row 0 in the south, and turned"):
            np.testing.assert_array_equal(np.asarray(getattr(read(tmp_path / "a.npz"), "raster", None) or
                                                     read(tmp_path / "a.npz")), valley())  # fmt: skip
    np.savez(tmp_path / "b.npz", height=valley(), topographic__elevation=valley()[::-1], cell_size=30.0)
    np.testing.assert_array_equal(read_terrain(tmp_path / "b.npz").to_numpy(), valley())


# ---- a file beside


def test_crs_overrules_a_projection_beside_a_grid(tmp_path):
    pytest.importorskip("pyproj")
    write_terrain(Terrain(valley(), 30.0, (5e5, 5e6), "EPSG:32633"), tmp_path / "a.asc")
    assert read_terrain(tmp_path / "a.asc").crs == "EPSG:32633"
    assert read_terrain(tmp_path / "a.asc", crs="EPSG:32619").crs == "EPSG:32619"
    (tmp_path / "a.prj").write_text("nonsense")
    with pytest.raises(ValueError, match=r"a\.asc: pyproj does not know the CRS 'nonsense'"):
        read_terrain(tmp_path / "a.asc")
    assert read_terrain(tmp_path / "a.asc", crs="epsg:32619").crs == "EPSG:32619"


def test_crs_overrules_a_projection_beside_a_shapefile_or_height_map(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    from shapely.geometry import LineString

    lines = geopandas.GeoDataFrame({"width": [9.0]}, geometry=[LineString([(0, 0), (500, 1), (1000, 0)])])
    lines.set_crs("EPSG:32633").to_file(tmp_path / "a.shp")
    assert read_network(tmp_path / "a.shp", crs="EPSG:32619").crs == "EPSG:32619"
    lines.set_crs("EPSG:32633").to_file(tmp_path / "a.gpkg")
    with pytest.raises(ValueError, match="the file is in EPSG:32633 but crs= says EPSG:32619"):
        read_network(tmp_path / "a.gpkg", crs="EPSG:32619")
    terrain = Terrain(valley(), 30.0, (5e5, 5e6), "EPSG:32633")
    write_terrain(terrain, tmp_path / "a.r16")
    read = read_terrain(tmp_path / "a.r16", crs="EPSG:32619", origin=(7.0, 9.0))
    assert (read.crs, read.origin) == ("EPSG:32619", (7.0, 9.0))
    tif = write_tif(tmp_path / "a.tif", valley())
    with pytest.raises(ValueError, match="the file is in EPSG:32633 but crs= says EPSG:32619"):
        read_terrain(tif, crs="EPSG:32619")
    with pytest.raises(ValueError, match="the file tells its origin; leave origin= out"):
        read_terrain(tif, origin=(7.0, 9.0))


def test_crs_overrules_what_gdal_keeps_beside_a_geotiff(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = write_tif(tmp_path / "a.tif", valley(), crs=None)
    wkt = rasterio.crs.CRS.from_epsg(32633).to_wkt()
    (tmp_path / "a.tif.aux.xml").write_text(f"<PAMDataset>\n  <SRS>{wkt.replace('<', '&lt;')}</SRS>\n</PAMDataset>\n")
    assert read_terrain(path).crs == "EPSG:32633"
    assert read_terrain(path, crs="EPSG:32619").crs == "EPSG:32619"


# ---- longitudes


@pytest.mark.parametrize("west", [179.99, -180.01, 189.9, 359.99, -0.01])
def test_a_terrain_stays_whole_at_any_longitude(west):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("pyproj")
    cell, count = 1.0 / 3600.0, 80
    lon, lat = west + (np.arange(count) + 0.5) * cell, -16.5 - (np.arange(count) + 0.5) * cell
    height = 300.0 - np.arange(count)[:, None] + 3.0 * np.abs(np.arange(count) - 40)[None]
    made = xarray.DataArray(height, dims=("lat", "lon"), coords={"lat": lat, "lon": lon})
    terrain = from_xarray(made, to_crs="utm")
    assert np.isnan(terrain.to_numpy()).mean() < 0.05
    # The same ground a full turn away is the same terrain.
    turned = from_xarray(made.assign_coords(lon=lon - 360.0 if west > 0.0 else lon + 360.0), to_crs=terrain.crs)
    np.testing.assert_allclose(turned.to_numpy(), terrain.to_numpy(), atol=1e-4)
    assert turned.crs == terrain.crs


def test_grids_of_longitudes_to_360_are_known_as_such(tmp_path):
    rows = "\n".join(" ".join(["5"] * 4) for _ in range(4))
    text = f"ncols 4\nnrows 4\nxllcorner 291.5\nyllcorner -6.5\ncellsize 0.01\n{rows}\n"
    (tmp_path / "a.asc").write_text(text)
    with pytest.raises(ValueError, match="look like longitude and latitude and no CRS is stated"):
        read_terrain(tmp_path / "a.asc")
    pytest.importorskip("pyproj")
    assert read_terrain(tmp_path / "a.asc", crs="EPSG:4326", to_crs="utm").crs == "EPSG:32719"


def test_lines_of_longitudes_to_360(tmp_path):
    pytest.importorskip("pyproj")
    rows = "lon,lat,width\n{0},-6.5,50\n{1},-6.51,50\n{2},-6.5,50\n"
    (tmp_path / "a.csv").write_text(rows.format(293.0, 293.01, 293.03))
    (tmp_path / "b.csv").write_text(rows.format(-67.0, -66.99, -66.97))
    a, b = (read_network(tmp_path / f"{name}.csv", to_crs="utm") for name in "ab")
    assert a.crs == b.crs == "EPSG:32719"
    np.testing.assert_allclose(a.polylines()[0], b.polylines()[0], atol=1e-6)
    (tmp_path / "c.csv").write_text(rows.replace("lon,lat", "x,y").format(293.0, 293.01, 293.03))
    with pytest.raises(ValueError, match="look like longitude and latitude"):
        read_network(tmp_path / "c.csv")


def test_cells_that_come_out_empty_are_told(monkeypatch):
    """As they do where longitudes are not shifted towards the raster."""
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("pyproj")
    lon, lat = 179.99 + (np.arange(80) + 0.5) / 3600.0, -16.5 - (np.arange(80) + 0.5) / 3600.0
    made = xarray.DataArray(np.ones((80, 80)), dims=("lat", "lon"), coords={"lat": lat, "lon": lon})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        from_xarray(made, to_crs="utm")
    monkeypatch.setattr(reproject, "full_turn", lambda crs: None)
    with pytest.warns(UserWarning, match=r"array: [45]\d % of its cells with data come out empty in EPSG:32701"):
        from_xarray(made, to_crs="utm")


# ---- formats of others


@pytest.mark.parametrize(
    ("suffix", "driver"), [(".dem", "USGSDEM"), (".img", "HFA"), (".bil", "EHdr"), (".sdat", "SAGA")]
)
def test_rasters_of_other_programs(tmp_path, suffix, driver):
    pytest.importorskip("rasterio")
    import rasterio.shutil

    height = (800 + 2 * np.arange(30)[:, None] + 3 * np.arange(40)[None]).astype("int16")
    from rasterio.transform import Affine

    corner = Affine(30.0, 0.0, 557_955.0, 0.0, -30.0, 5_127_525.0)
    source = write_tif(tmp_path / "a.tif", height, crs="EPSG:26710", transform=corner, nodata=-32767)
    rasterio.shutil.copy(source, tmp_path / f"b{suffix}", driver=driver)
    terrain = read_terrain(tmp_path / f"b{suffix}")
    inner = terrain.to_numpy()[1:-1]
    at = [(558_000.0, 5_127_000.0), (559_000.0, 5_126_800.0)]
    np.testing.assert_allclose(terrain.sample(at), read_terrain(source).sample(at), atol=1e-9)
    assert (terrain.cell_size == 30.0 and "NAD27" in terrain.crs) or terrain.crs == "EPSG:26710"
    assert np.isfinite(inner).all() and inner.min() > 800.0


def test_a_height_map_side_file_of_nonsense_is_one_sentence(tmp_path):
    write_terrain(Terrain(valley(), 30.0), tmp_path / "a.r16")
    side = json.loads((tmp_path / "a.r16.json").read_text())
    for change in ({"rows": 1e400}, {"rows": "x"}, {"origin": 3}, {"height_low": None}, {"metres_per_pixel": []}):
        (tmp_path / "a.r16.json").write_text(json.dumps(side | change))
        with pytest.raises(ValueError, match=r"a\.r16\.json: not what write_terrain writes"):
            read_terrain(tmp_path / "a.r16")
    (tmp_path / "a.r16.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match=r"a\.r16\.json: not JSON"):
        read_terrain(tmp_path / "a.r16")


@pytest.mark.parametrize("header", ["ncols inf", "ncols 2.5", "ncols -3", "ncols 1e300", "ncols nan"])
def test_an_ascii_header_of_nonsense_is_one_sentence(tmp_path, header):
    (tmp_path / "a.asc").write_text(f"{header}\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 5\n1 2 3\n4 5 6\n")
    with pytest.raises((ValueError, MemoryError), match=r"a\.asc"):
        read_terrain(tmp_path / "a.asc")
