"""Rasters: where they lie, what is looked up in them, files and pickles that keep all of it, and bad input."""

import copy
import math
import pickle
import sys
import warnings

import numpy as np
import pytest
import reference_terrain as twin
import warp as wp

import warpriver as wr
import warpriver.device as device_module
from warpriver import Terrain, hydrology
from warpriver.io.raster.terrains import read_raster, write_raster
from warpriver.raster import Raster

UTM = "EPSG:32619"
ORIGIN, SIZE = (440_300.25, 5_100_200.5), 12.5
# Values of up to 1e3 over some ten operations in float64.
TOLERANCE = 1e-9
FILLINGS = ["holes", "full", "whole", "empty"]
INTEGERS = ["int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"]


def rough(rows=18, columns=25, gaps=0.2, seed=0):
    """Random values with holes."""
    values = np.random.default_rng(seed).uniform(-50.0, 900.0, (rows, columns))
    values[np.random.default_rng(seed + 1).random(values.shape) < gaps] = np.nan
    return values


def labels(kind="int32", rows=18, columns=25):
    """Whole numbers from -1 on, or from 0 where there is no -1."""
    low = 0 if kind.startswith("u") else -1
    return np.random.default_rng(3).integers(low, 100, (rows, columns)).astype(kind)


def area(values=None, **changes):
    """A raster with all that one can have."""
    told = {"crs": UTM, "unit": "m2", "name": "drainage_area"} | changes
    return Raster(rough() if values is None else values, SIZE, ORIGIN, **told)


def scattered(raster, count=500, beyond=30.0):
    west, south, east, north = raster.bounds
    rng = np.random.default_rng(4)
    return rng.uniform((west - beyond, south - beyond), (east + beyond, north + beyond), (count, 2))


def same(a, b):
    """Two rasters with the same values to the bit, in the same place, with unit and name."""
    assert a.dtype == b.dtype and a.matches(b), (a, b)
    np.testing.assert_array_equal(a.numpy(), b.numpy())
    assert (a.unit, a.name) == (b.unit, b.name)


# ---- what it is, and where it lies


def test_a_raster_knows_where_it_is_and_what_it_holds():
    raster = area()
    assert raster.shape == (18, 25) and raster.dtype == np.float64 and not raster.is_integer
    assert raster.bounds == (440_300.25, 5_100_200.5 - 225.0, 440_612.75, 5_100_200.5)
    assert raster.values.dtype == wp.float64 and raster.device.alias == "cpu"
    assert (raster.crs, raster.unit, raster.name) == (UTM, "m2", "drainage_area")
    text = repr(raster)
    assert text.startswith("Raster(drainage_area in m2, 18 x 25 cells of 12.5 m, 0.3125 x 0.225 km, values -4")
    assert "% no data" in text and f"crs={UTM}" in text and text.endswith("on cpu)")
    assert repr(Raster(labels(), 1.0)).startswith("Raster(unnamed, 18 x 25 int32 cells of 1 m")
    assert "values -1 to 99," in repr(Raster(labels(), 1.0)) and "no data" not in repr(Raster(labels(), 1.0))
    assert ", no data, crs=None" in repr(Raster(np.full((2, 3), np.nan), 1.0))


def test_values_are_copied_and_copies_are_apart():
    values = rough()
    raster = Raster(values, SIZE)
    other, moved = raster.copy(), raster.to("cpu")
    values[:] = 0.0
    raster.numpy()[:] = 0.0
    np.testing.assert_array_equal(raster.numpy(), rough())
    raster.values.fill_(1.0)
    for copied in (other, moved):
        np.testing.assert_array_equal(copied.numpy(), rough())


@pytest.mark.parametrize("kind", INTEGERS)
def test_whole_numbers_keep_their_type(kind):
    raster = Raster(labels(kind), SIZE)
    assert raster.is_integer and raster.dtype == np.dtype(kind) and raster.numpy().dtype == np.dtype(kind)
    np.testing.assert_array_equal(raster.numpy(), labels(kind))
    swapped = Raster(labels(kind).astype(np.dtype(kind).newbyteorder()), SIZE)
    assert swapped.dtype == np.dtype(kind)
    np.testing.assert_array_equal(swapped.numpy(), labels(kind))


def test_other_values_become_float64_or_bytes():
    masked = np.ma.MaskedArray(labels(), labels() < 0)
    assert np.array_equal(Raster(masked, 1.0), np.where(labels() < 0, np.nan, labels()), equal_nan=True)
    whole = Raster(np.ma.MaskedArray(labels(), False), 1.0)
    assert whole.dtype == np.int32
    flags = Raster(labels() > 50, 1.0)
    assert flags.dtype == np.uint8 and np.array_equal(flags, labels() > 50)
    for kind in (np.float16, np.float32):
        assert Raster(labels().astype(kind), 1.0).dtype == np.float64
    assert Raster([[1.0, 2.0], [3.0, 4.0]], 1.0).dtype == np.float64
    device_array = wp.array(rough(), dtype=wp.float64, device="cpu")
    assert Raster(device_array, 1.0).values.ptr != device_array.ptr


def test_numpy_takes_a_raster_for_its_values():
    raster = area()
    assert np.nanmax(raster) == np.nanmax(rough()) and np.asarray(raster, np.float32).dtype == np.float32
    np.testing.assert_array_equal(np.add(raster, 1.0), rough() + 1.0)
    made = np.asarray(raster)
    made[:] = 0.0
    np.testing.assert_array_equal(raster.numpy(), rough())
    with pytest.raises(ValueError, match="are copied"):
        raster.__array__(copy=False)


def test_like_keeps_the_place_and_nothing_else():
    raster = area()
    made = raster.like(labels(), unit="-", name="basin")
    assert made.matches(raster) and made.dtype == np.int32 and (made.unit, made.name) == ("-", "basin")
    plain = raster.like(raster.numpy() * 2.0)
    assert (plain.unit, plain.name) == ("", "")
    # Results of kernels are taken as they are.
    values = wp.zeros(raster.shape, dtype=wp.float64, device="cpu")
    assert raster.like(values, unit="m").values is values
    single = wp.zeros(raster.shape, dtype=wp.float32, device="cpu")
    assert raster.like(single).dtype == np.float64
    turned = wp.array(rough(25, 18), dtype=wp.float64, device="cpu").transpose()
    assert raster.like(turned).values.is_contiguous
    np.testing.assert_array_equal(raster.like(turned).numpy(), rough(25, 18).T)


@pytest.mark.parametrize(
    "other",
    [
        {"values": rough(17, 25)},
        {"cell_size": 12.0},
        {"origin": (440_300.25, 5_100_200.0)},
        {"crs": None},
        {"crs": "EPSG:32620"},
    ],
)
def test_rasters_on_other_cells_do_not_match(other):
    place = {"values": rough(), "cell_size": SIZE, "origin": ORIGIN, "crs": UTM}
    assert area().matches(Raster(**place)) and area().matches(Terrain(rough(), SIZE, ORIGIN, UTM))
    assert not area().matches(Raster(**(place | other)))


def test_a_crop_is_the_cells_with_centres_in_the_box():
    for values in (rough(), labels("uint8")):
        raster = area(values)
        west, south, east, north = raster.bounds
        part = raster.crop((west + 2 * SIZE, south + 3 * SIZE, east - 4 * SIZE, north - 5 * SIZE))
        np.testing.assert_array_equal(part.numpy(), values[5:-3, 2:-4])
        assert part.bounds == (west + 2 * SIZE, south + 3 * SIZE, east - 4 * SIZE, north - 5 * SIZE)
        assert (part.crs, part.unit, part.name, part.dtype) == (raster.crs, raster.unit, raster.name, raster.dtype)
        same(raster.crop(raster.bounds), raster)


def test_a_raster_lies_on_the_device_that_it_is_given(device):
    for values in (rough(), labels("int16")):
        raster = Raster(values, SIZE, ORIGIN, UTM, "m", "depth", device=device)
        assert raster.device.alias == device and raster.like(values).device == raster.device
        assert raster.like(Raster(values, SIZE).values).device == raster.device
        same(raster.to("cpu"), raster)
        xy = scattered(raster)
        # A GPU fuses multiplications and additions.
        np.testing.assert_allclose(raster.sample(xy), raster.to("cpu").sample(xy), rtol=1e-13)
        same(pickle.loads(pickle.dumps(raster)), raster)
        assert copy.deepcopy(raster).device == raster.device


# ---- sampling


@pytest.mark.parametrize("gaps", [0.0, 0.2, 0.6])
def test_samples_are_those_of_the_twin(gaps, device):
    values = rough(gaps=gaps)
    raster = Raster(values, SIZE, ORIGIN, device=device)
    xy = scattered(raster)
    expected = [twin.value_at(values, (*ORIGIN, SIZE), p) for p in xy]
    assert 0.1 < np.isnan(expected).mean() < 0.95
    np.testing.assert_allclose(raster.sample(xy), expected, atol=TOLERANCE, rtol=0.0)
    np.testing.assert_array_equal(raster.sample(xy), Terrain(values, SIZE, ORIGIN, device=device).sample(xy))


@pytest.mark.parametrize("kind", INTEGERS)
def test_whole_numbers_are_those_of_the_points_cell(kind, device):
    values = labels(kind)
    raster = Raster(values, SIZE, ORIGIN, device=device)
    xy = scattered(raster)
    row, column = (
        np.floor((ORIGIN[1] - xy[:, 1]) / SIZE).astype(int),
        np.floor((xy[:, 0] - ORIGIN[0]) / SIZE).astype(int),
    )
    on = (row >= 0) & (row < 18) & (column >= 0) & (column < 25)
    expected = np.where(on, values[np.clip(row, 0, 17), np.clip(column, 0, 24)].astype(np.float64), np.nan)
    assert 0.1 < on.mean() < 0.95
    np.testing.assert_array_equal(raster.sample(xy), expected)


def test_a_hole_takes_no_part_in_what_lies_beside_it():
    values = np.array([[1.0, 2.0], [np.nan, 4.0]])
    raster = Raster(values, 10.0, (0.0, 20.0))
    assert np.isnan(raster.sample([(5.0, 5.0), (-0.1, 15.0), (math.nan, 1.0)])).all()
    # A quarter of the way to the hole: the other three centres, with weights 9, 3 and 1 of 13.
    assert raster.sample([(7.5, 12.5)])[0] == pytest.approx((9.0 * 1.0 + 3.0 * 2.0 + 1.0 * 4.0) / 13.0)
    assert raster.sample([(0.0, 20.0)])[0] == 1.0, "through the outer half cell"


def test_no_points_are_no_trouble():
    for values in (rough(), labels()):
        assert Raster(values, 1.0).sample(np.empty((0, 2))).shape == (0,)


# ---- terrains hold one


def test_a_terrain_and_its_raster_are_the_same_memory():
    terrain = Terrain(rough(gaps=0.0), SIZE, ORIGIN, UTM)
    raster = terrain.raster
    assert (raster.unit, raster.name) == ("m", "height") and raster.values is terrain.height
    terrain.brush("raise", (440_400.0, 5_100_100.0), 50.0, 3.0)
    np.testing.assert_array_equal(raster.numpy(), terrain.to_numpy())
    terrain.crs = "EPSG:32620"
    assert raster.crs == "EPSG:32620"
    with pytest.raises(ValueError, match="longitude and latitude"):
        terrain.crs = "EPSG:4326"
    with pytest.raises(ValueError, match="longitude and latitude"):
        raster.crs = "EPSG:4326"
    assert terrain.crs == "EPSG:32620"


def test_a_raster_of_heights_becomes_a_terrain_without_a_copy():
    raster = area(unit="m", name="water_level")
    terrain = Terrain.from_raster(raster)
    assert terrain.height is raster.values and terrain.raster.matches(raster)
    assert terrain.raster.name == "height" and raster.name == "water_level"
    for wrong, text in (
        (area(), "raster 'drainage_area' is in 'm2'; a terrain needs float64 heights in m"),
        (area(labels(), unit="m"), "is int32; a terrain needs float64 heights"),
        (area(np.full((3, 3), np.nan), unit=""), "NaN in every cell"),
        (rough(), "raster is an ndarray; give a Raster"),
    ):
        with pytest.raises(ValueError, match=text):
            Terrain.from_raster(wrong)


# ---- hydrology returns them


@pytest.fixture(scope="module")
def flow():
    height = wr.generate.fractal_terrain((60, 70), 30.0, 200.0, 4).to_numpy()
    height[20:30, 40:50] = np.nan
    terrain = Terrain(height, 30.0, (500.0, 9000.0), UTM)
    return hydrology.route(hydrology.carve_depressions(terrain))


def test_results_of_hydrology_lie_where_the_terrain_does_and_tell_their_units(flow):
    drained = hydrology.drainage_area(flow)
    made = {
        ("m2", "drainage_area"): drained,
        ("m", "flow_length"): hydrology.flow_length(flow),
        ("m", "upstream_flow_length"): hydrology.flow_length(flow, downstream=False),
        ("m", "height_above_drainage"): hydrology.hand(flow, drained.numpy() > 1e5),
        ("m", "stream_power"): hydrology.stream_power(flow),
        ("m2", "stream_power"): hydrology.stream_power(flow, drained, m=1.0),
        ("m^0.9", "stream_power"): hydrology.stream_power(flow, m=0.45),
        ("", "stream_power"): hydrology.stream_power(flow, m=0.0),
        ("", "receiver"): flow.receiver,
    }
    for (unit, name), raster in made.items():
        assert isinstance(raster, Raster) and raster.matches(flow.terrain), name
        assert (raster.unit, raster.name) == (unit, name) and raster.is_integer == (name == "receiver")
    gap = np.isnan(flow.terrain.to_numpy())
    assert np.array_equal(np.isnan(drained), gap) and np.array_equal(flow.receiver.numpy() == -1, gap)
    same(hydrology.flow_directions(flow.terrain), flow.receiver)
    mfd = hydrology.drainage_area(flow.terrain, method="mfd")
    assert mfd.matches(drained) and (mfd.unit, mfd.name) == ("m2", "drainage_area")


def test_hydrology_takes_rasters_for_surfaces_areas_and_channels(flow):
    """The surface of the water, or a map of channels, gives what the terrain or the array gives."""
    terrain = Terrain(rough(40, 50, 0.05), 10.0, (100.0, 900.0), UTM)
    level = terrain.raster.like(terrain.to_numpy(), unit="m", name="water_level")
    for change in (hydrology.fill_depressions, hydrology.carve_depressions):
        made = change(level)
        assert isinstance(made, Raster) and made.matches(terrain) and (made.unit, made.name) == ("m", "water_level")
        np.testing.assert_array_equal(made.numpy(), change(terrain).to_numpy())
    filled = hydrology.fill_depressions(level)
    for method in ("d8", "mfd"):
        same(
            hydrology.drainage_area(filled, method=method),
            hydrology.drainage_area(hydrology.fill_depressions(terrain), method=method),
        )
    drained = hydrology.drainage_area(flow)
    same(hydrology.stream_power(flow, drained), hydrology.stream_power(flow))
    channels = drained.numpy() > 1e5
    same(hydrology.hand(flow, drained.like(channels)), hydrology.hand(flow, channels))
    networks = [
        wr.extract_network(surface, min_drainage_area=1e5, flow=flow, area=known)
        for surface, known in ((flow.terrain, None), (flow.terrain.raster, drained))
    ]
    np.testing.assert_array_equal(networks[0].points(), networks[1].points())
    elsewhere = Raster(drained.numpy(), 31.0, drained.origin, drained.crs)
    for call in (
        lambda: hydrology.stream_power(flow, elsewhere),
        lambda: wr.extract_network(flow.terrain, min_drainage_area=1e5, flow=flow, area=elsewhere),
    ):
        with pytest.raises(ValueError, match=r"area lies on other cells than the terrain: Raster\(.* beside Terrain\("):
            call()
    with pytest.raises(ValueError, match="channels lies on other cells"):
        hydrology.hand(flow, elsewhere)
    with pytest.raises(ValueError, match="receiver lies on other cells"):
        hydrology.Flow(flow.terrain, Raster(flow.receiver.numpy(), 31.0))
    with pytest.raises(ValueError, match="terrain is an ndarray; give a Terrain or a Raster"):
        hydrology.fill_depressions(rough())
    with pytest.raises(ValueError, match="is in 'm2'; a terrain needs"):
        hydrology.route(drained)


def test_a_receiver_from_elsewhere_is_copied_and_becomes_a_raster(flow):
    receiver = flow.receiver.numpy()
    for given in (receiver, receiver.astype(np.int64), flow.receiver):
        made = hydrology.Flow(flow.terrain, given)
        same(made.receiver, flow.receiver)
        same(hydrology.drainage_area(made), hydrology.drainage_area(flow))
    made = hydrology.Flow(flow.terrain, receiver)
    receiver[:] = 0
    same(made.receiver, flow.receiver)


def test_results_of_hydrology_lie_on_the_terrains_device(device, flow):
    there = flow.terrain.to(device)
    routed = hydrology.route(there)
    made = [routed.receiver, hydrology.drainage_area(routed), hydrology.flow_length(routed)]
    made += [hydrology.hand(routed, made[1].numpy() > 1e5), hydrology.stream_power(routed)]
    made += [hydrology.drainage_area(there, method="mfd"), hydrology.fill_depressions(there.raster)]
    assert all(raster.device == there.device for raster in made)
    same(made[1], hydrology.drainage_area(flow))


# ---- files


@pytest.mark.parametrize("suffix", [".tif", ".asc", ".npz"])
@pytest.mark.parametrize("told", [{}, {"crs": None, "unit": "", "name": ""}], ids=["all", "nothing"])
@pytest.mark.parametrize("values", [rough(), rough(gaps=0.0), labels(), np.full((3, 4), np.nan)], ids=FILLINGS)
def test_what_is_written_is_read_back_with_all_that_it_tells(tmp_path, suffix, told, values):
    for module in {".tif": ["rasterio"], ".asc": ["pyproj"]}.get(suffix, []):
        pytest.importorskip(module)
    raster = area(values, **told)
    write_raster(raster, tmp_path / f"a{suffix}")
    read = read_raster(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(read.origin, raster.origin, rtol=0.0, atol=1e-6)
    same(Raster(read.values, read.cell_size, raster.origin, read.crs, read.unit, read.name), raster)


@pytest.mark.parametrize("suffix", [".tif", ".npz", ".npy", ".asc"])
@pytest.mark.parametrize("kind", INTEGERS)
def test_whole_numbers_come_back_whole(tmp_path, suffix, kind):
    if suffix == ".tif":
        pytest.importorskip("rasterio")
    write_raster(Raster(labels(kind), SIZE), tmp_path / f"a{suffix}")
    read = read_raster(tmp_path / f"a{suffix}", **({"cell_size": SIZE} if suffix == ".npy" else {}))
    np.testing.assert_array_equal(read.numpy(), labels(kind))
    # A text tells no type.
    assert read.dtype == np.dtype("int32" if suffix == ".asc" else kind)


def test_an_ascii_grid_keeps_large_whole_numbers_or_refuses_them(tmp_path):
    large = np.array([[2**40, -3], [0, 2**53 - 1]])
    write_raster(Raster(large, 1.0), tmp_path / "a.asc")
    read = read_raster(tmp_path / "a.asc")
    assert read.dtype == np.int64 and np.array_equal(read, large)
    with pytest.raises(ValueError, match=r"2\^53 or more are not kept in an ASCII grid"):
        write_raster(Raster(large + 1, 1.0), tmp_path / "b.asc")
    assert not (tmp_path / "b.asc").exists()


def test_whole_numbers_of_which_some_are_no_data_are_read_as_float64(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    profile = {"driver": "GTiff", "count": 1, "height": 18, "width": 25, "dtype": "int32", "crs": UTM}
    transform = rasterio.Affine(SIZE, 0.0, ORIGIN[0], 0.0, -SIZE, ORIGIN[1])
    for nodata, dtype in ((-1, np.float64), (-77, np.int32)):
        with rasterio.open(tmp_path / "a.tif", "w", transform=transform, nodata=nodata, **profile) as dataset:
            dataset.write(labels(), 1)
        read = read_raster(tmp_path / "a.tif")
        assert read.dtype == dtype and np.isnan(read).sum() == (labels() == nodata).sum()
    assert np.isnan(read_raster(tmp_path / "a.tif", nodata=5)).sum() == (labels() == 5).sum() > 0
    np.save(tmp_path / "a.npy", labels())
    assert read_raster(tmp_path / "a.npy", cell_size=1.0).dtype == np.int32
    assert read_raster(tmp_path / "a.npy", cell_size=1.0, nodata=-1).dtype == np.float64


def test_other_programs_see_unit_name_and_type(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    write_raster(area(), tmp_path / "a.tif")
    write_raster(area(labels(), name="basin", unit=""), tmp_path / "b.tif")
    write_raster(area(), tmp_path / "c.asc")
    with rasterio.open(tmp_path / "a.tif") as a, rasterio.open(tmp_path / "b.tif") as b:
        assert a.units == ("m2",) and a.descriptions == ("drainage_area",) and math.isnan(a.nodata)
        assert b.dtypes == ("int32",) and b.nodata is None and b.descriptions == ("basin",) and b.units == (None,)
        assert b.crs.to_string() == UTM
    with rasterio.open(tmp_path / "c.asc") as c:
        assert c.units == ("m2",) and c.descriptions == ("drainage_area",)


def test_a_grid_leaves_no_others_labels_beside_it(tmp_path):
    pytest.importorskip("pyproj")
    write_raster(area(), tmp_path / "a.asc")
    assert (tmp_path / "a.asc.aux.xml").is_file() and (tmp_path / "a.prj").is_file()
    write_raster(area(crs=None, unit="", name=""), tmp_path / "a.asc")
    assert [p.name for p in tmp_path.iterdir()] == ["a.asc"]
    write_raster(area(), tmp_path / "a.asc")
    wr.io.write_terrain(Terrain(rough(), 1.0), tmp_path / "a.asc")
    assert [p.name for p in tmp_path.iterdir()] == ["a.asc"]
    (tmp_path / "a.asc.aux.xml").write_text("<PAMDataset>")
    with pytest.raises(ValueError, match=r"a\.asc\.aux\.xml: not XML .*; repair or remove it"):
        read_raster(tmp_path / "a.asc")
    (tmp_path / "a.asc.aux.xml").write_text("<PAMDataset><Metadata/></PAMDataset>")
    assert read_raster(tmp_path / "a.asc").unit == ""


@pytest.mark.parametrize("suffix", [".tif", ".asc", ".npz"])
def test_files_of_terrains_are_rasters_too(tmp_path, suffix):
    if suffix == ".tif":
        pytest.importorskip("rasterio")
    terrain = Terrain(rough(), SIZE, ORIGIN)
    wr.io.write_terrain(terrain, tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(read_raster(tmp_path / f"a{suffix}").numpy(), rough())
    write_raster(terrain.raster, tmp_path / f"b{suffix}")
    if suffix == ".npz":
        with pytest.raises(ValueError, match=r"holds values, .* but no array named height"):
            wr.read_terrain(tmp_path / "b.npz")
    else:
        np.testing.assert_array_equal(wr.read_terrain(tmp_path / f"b{suffix}").to_numpy(), rough())


def test_whole_numbers_are_turned_and_brought_into_another_crs_but_not_averaged(tmp_path):
    pytest.importorskip("pyproj")
    raster = area(labels("uint8"), name="kind", unit="")
    write_raster(raster, tmp_path / "a.npz")
    same(read_raster(tmp_path / "a.npz", to_crs=UTM), raster)
    moved = read_raster(tmp_path / "a.npz", to_crs="EPSG:32620")
    found = moved.numpy()[np.isfinite(moved.numpy())]
    assert moved.crs == "EPSG:32620" and moved.name == "kind" and moved.dtype == np.float64, "corners are empty"
    assert set(np.unique(found)) <= set(np.unique(labels("uint8"))) and len(found) > 400
    with pytest.raises(ValueError, match="whole numbers are not resampled; leave cell_size= out"):
        read_raster(tmp_path / "a.npz", cell_size=5.0)
    write_raster(area(), tmp_path / "b.npz")
    assert read_raster(tmp_path / "b.npz", cell_size=25.0).shape == (9, 13)


def test_xarray_out_and_in():
    pytest.importorskip("xarray")
    pytest.importorskip("pyproj")
    for raster in (area(), area(labels("int16"), name="basin", unit=""), area(crs=None, name="")):
        array = raster.to_xarray()
        assert array.dims == ("y", "x") and array.dtype == raster.dtype and array.name == (raster.name or None)
        assert array.attrs.get("units", "") == raster.unit
        assert float(array.x[0]) == ORIGIN[0] + 0.5 * SIZE and float(array.y[0]) == ORIGIN[1] - 0.5 * SIZE
        same(wr.io.raster_from_xarray(array), raster)
        same(wr.io.raster_from_xarray(array[::-1]), raster)
        same(wr.io.raster_from_xarray(wr.io.to_xarray(raster)), raster)
    filled = area(labels()).to_xarray().assign_attrs(_FillValue=-1)
    assert np.isnan(wr.io.raster_from_xarray(filled)).sum() == (labels() < 0).sum()
    with pytest.raises(ValueError, match=r"a raster needs \(y, x\)"):
        wr.io.raster_from_xarray(filled.rename(y="time"))


def test_a_missing_xarray_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r'to_xarray needs xarray: pip install "warpriver\[gis\]"'):
        area().to_xarray()


# ---- pickles


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy], ids=["pickle", "deepcopy"])
def test_what_holds_rasters_comes_back_to_the_bit_and_apart(again, flow):
    for raster in (area(), area(labels("uint16"))):
        other = again(raster)
        same(other, raster)
        other.values.fill_(3)
        assert not np.array_equal(other, raster, equal_nan=True)
    terrain = Terrain(rough(), SIZE, ORIGIN, UTM)
    other = again(terrain)
    same(other.raster, terrain.raster)
    np.testing.assert_array_equal(other.slope(), terrain.slope())
    routed = again(flow)
    same(routed.receiver, flow.receiver)
    same(routed.terrain.raster, flow.terrain.raster)
    same(hydrology.flow_length(routed), hydrology.flow_length(flow))
    assert (routed.edges, routed.nodata) == (flow.edges, flow.nodata) and np.array_equal(routed.order, flow.order)


def test_eroded_terrain_comes_back_with_its_account_and_snapshots():
    eroded = wr.erode(wr.generate.erosion_plane((20, 24), 10.0), events=300, seed=1, record_every=100)
    other = pickle.loads(pickle.dumps(eroded))
    same(other.raster, eroded.raster)
    assert isinstance(other, wr.erosion.ErodedTerrain) and repr(other) == repr(eroded) and other.params == eroded.params
    assert (other.edges, other.nodata, other.visits) == (eroded.edges, eroded.nodata, eroded.visits)
    assert [s.events for s in other.snapshots] == [s.events for s in eroded.snapshots]
    same(other.snapshots[1].raster, eroded.snapshots[1].raster)
    # It goes on as the one that stayed.
    further = [wr.erode(land, events=50, seed=2) for land in (eroded, other)]
    same(further[0].raster, further[1].raster)


@pytest.mark.parametrize("asked", [False, True], ids=["as made", "after use"])
def test_a_valley_comes_back_and_makes_the_same_ground(asked):
    valley = wr.synthetic_valley("S3", length=300.0, origin=(5000.0, 700.0), crs=UTM)
    if asked:
        assert valley.terrain and valley.network and valley.covariance
    for other in (pickle.loads(pickle.dumps(valley)), copy.deepcopy(valley)):
        same(other.terrain.raster, valley.terrain.raster)
        np.testing.assert_array_equal(other.network.points(), valley.network.points())
        assert repr(other) == repr(valley) and other.device == valley.device and other.crs == UTM
        assert other.covariance.mean_thalweg_width == valley.covariance.mean_thalweg_width
        xy = valley.network.points()[::7] + 1.0
        np.testing.assert_array_equal(other.height(xy), valley.height(xy))


def test_what_was_pickled_on_a_device_that_is_missing_comes_back_on_the_cpu_with_a_word():
    state = area().__getstate__() | {"on": "cuda:99"}
    raster = Raster.__new__(Raster)
    with pytest.warns(UserWarning, match="a raster was pickled on 'cuda:99', which this machine does not have"):
        raster.__setstate__(state)
    same(raster, area())
    valley = wr.synthetic_valley("S3", length=300.0)
    other = wr.valley.Valley.__new__(wr.valley.Valley)
    with pytest.warns(UserWarning, match="a valley was pickled on 'cuda:99'"):
        other.__setstate__(valley.__getstate__() | {"device": "cuda:99"})
    same(other.terrain.raster, valley.terrain.raster)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pickle.loads(pickle.dumps(area()))


# ---- bad input

BAD = [
    ({"values": np.zeros(5)}, r"values cannot be used \(its shape is \(5,\)\); give numbers .* at least 2 of each"),
    ({"values": np.zeros((1, 9))}, r"its shape is \(1, 9\)"),
    ({"values": np.zeros((2, 2, 2))}, "its shape is"),
    ({"values": [[1.0, 2.0], [3.0]]}, "values cannot be used"),
    ({"values": [["a", "b"], ["c", "d"]]}, "values cannot be used"),
    ({"values": np.zeros((2, 2), complex)}, "its numbers are complex"),
    ({"values": [[1.0, np.inf], [0.0, -np.inf]]}, "values: infinite in 2 cells, the first at row 0, column 1"),
    ({"cell_size": 0.0}, "cell_size is 0; give a positive number of m"),
    ({"cell_size": math.nan}, "cell_size is nan"),
    ({"cell_size": "wide"}, "cell_size is 'wide'"),
    ({"origin": (1.0, math.inf)}, r"origin is .*2 finite numbers"),
    ({"origin": 7.0}, r"origin is 7; give"),
    ({"crs": "EPSG:4326"}, r'longitude and latitude, not metres.*to_crs="utm"'),
    ({"unit": None}, "unit is None; give a text"),
    ({"name": 3}, "name is 3; give a text"),
    ({"device": "cuda:99"}, "'cuda:99' is not on this machine"),
]


@pytest.mark.parametrize(("change", "text"), BAD)
def test_bad_input_is_told_in_one_sentence(change, text):
    with pytest.raises(ValueError, match=text) as caught:
        Raster(**({"values": np.zeros((3, 3)), "cell_size": 1.0} | change))
    assert "\n" not in str(caught.value)


CALLS = [
    (("like", np.zeros((2, 3))), r"values have shape \(2, 3\); the raster has \(18, 25\)"),
    (("like", wp.zeros((2, 3), dtype=wp.float64, device="cpu")), r"values have shape \(2, 3\)"),
    (("like", np.full((18, 25), np.inf)), "values: infinite in 450 cells"),
    (("crop", (0.0, 0.0, 1.0)), "bounds is"),
    (("crop", (0.0, 0.0, 1.0, 1.0)), "fewer than 2 x 2 cells of the raster, which lies within"),
    (("sample", [1.0, 2.0]), r"xy has shape \(2,\)"),
    (("sample", [["a", "b"]]), "xy is .*; give .n, 2. x, y in metres"),
    (("to", "cuda:99"), "'cuda:99' is not on this machine"),
]


@pytest.mark.parametrize(("call", "text"), CALLS)
def test_bad_calls_are_told(call, text):
    with pytest.raises(ValueError, match=text):
        getattr(area(), call[0])(*call[1:])


def test_bad_files_are_told(tmp_path):
    for name, text in (("a.png", "holds heights of terrains alone"), ("a.txt", "names no format"), ("a", "no suffix")):
        for call in (lambda p: write_raster(area(), p), read_raster):
            with pytest.raises(ValueError, match=text):
                call(tmp_path / name)
    with pytest.raises(ValueError, match="raster is a Terrain; give a Raster"):
        write_raster(Terrain(rough(), 1.0), tmp_path / "a.npz")
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        read_raster(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", other=rough())
    with pytest.raises(ValueError, match="holds other, but no array named values"):
        read_raster(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", values=np.full((3, 3), np.inf), cell_size=1.0)
    with pytest.raises(ValueError, match=r"a\.npz: values: infinite in 9 cells"):
        read_raster(tmp_path / "a.npz")


def test_a_raster_that_cannot_fit_is_refused_before_anything_is_allocated(monkeypatch):
    giant = np.broadcast_to(np.int8(1), (400_000, 400_000))
    with pytest.raises(MemoryError, match=r"a raster of 400000 x 400000 cells needs 320 GB and .* are free on cpu"):
        Raster(giant, 1.0)
    monkeypatch.setattr(Raster, "shape", property(lambda self: (50_000, 50_000)))
    with pytest.raises(ValueError, match=r"50000 x 50000 cells; 2\^31 is the limit"):
        Raster(labels(), 1.0).sample([(0.5, -0.5)])
    monkeypatch.setattr(device_module, "available_memory", lambda device: 100)
    with pytest.raises(MemoryError, match="and 1e-07 GB are free"):
        Raster(rough(), 1.0)
