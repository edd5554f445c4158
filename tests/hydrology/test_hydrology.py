"""Hydrology against closed forms, known statistics, its own promises on real ground, and bad input."""

import logging

import numpy as np
import pytest
import reference_hydrology as reference
from data_folder import data_folder

from warpriver import hydrology
from warpriver.hydraulic_geometry import bankfull_discharge
from warpriver.hydrology import cells as cells_module
from warpriver.terrain import Terrain

NAN = np.nan
# Multiple flow sums shares that are rounded: a few units in the last place of each of up to a million additions.
SUM_TOLERANCE = 1e-10
# Heights of real rasters, as they lie in the data folder; feet and degrees do no harm here.
RASTERS = [
    "bigtujunga_srtm30m.tif",
    "boulder_co_srtmgl3.asc",
    "gabilan_lidar1m.tif",
    "hugo_site_10m.asc",
    "mandakini_srtm90m.tif",
    "minnesota_potholes_lidar1m.tif",
    "shellmound_100m_feet.tif",
    "smith_rock_srtm90m.tif",
    "vermont_90m_nocrs.tif",
    "west_bijou_gully_3m.asc",
]


def fractal(size, seed=0, roughness=3.0, relief=200.0):
    """Heights with a power-law spectrum: pits of every size."""
    wave = np.hypot(np.fft.rfftfreq(size)[None], np.fft.fftfreq(size)[:, None])
    wave[0, 0] = 1.0
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal((size, size)))
    height = np.fft.irfft2(noise * wave ** (-roughness / 2.0), (size, size))
    return relief * (height - height.min()) / np.ptp(height)


def own(flow):
    """Cells whose water leaves or stays."""
    receiver = flow.receiver.numpy()
    return receiver == np.arange(receiver.size).reshape(receiver.shape)


def real_heights(name):
    """Heights and cell size of a raster in the data folder, or a skip."""
    path = data_folder("dem") / name
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(path) as raster:
        height = raster.read(1, masked=True).astype(np.float64).filled(np.nan)
        if name == "west_bijou_gully_3m.asc":
            height[height == 0.0] = np.nan
        return height, abs(raster.transform.a)


# ---- depressions


@pytest.mark.parametrize("edges", ["open", "closed", ("closed", "open", "periodic", "periodic")])
@pytest.mark.parametrize("change", [hydrology.fill_depressions, hydrology.carve_depressions])
def test_no_pit_is_left_and_doing_it_again_changes_nothing(change, edges, device):
    terrain = Terrain(fractal(96), 10.0, device=device)
    once = change(terrain, edges=edges)
    flow = hydrology.route(once, edges=edges)
    cells = cells_module.pad_terrain(once, edges, "outlet", 0)
    outlet = cells.interior(cells.state) == cells_module.kernels.OUTLET
    assert np.array_equal(own(flow), outlet)
    assert np.array_equal(change(once, edges=edges).to_numpy(), once.to_numpy())


def test_filling_never_lowers_and_carving_never_rises_above_it(device):
    terrain = Terrain(fractal(96, seed=1), 10.0, device=device)
    height, filled = terrain.to_numpy(), hydrology.fill_depressions(terrain).to_numpy()
    carved = hydrology.carve_depressions(terrain).to_numpy()
    assert (filled >= height).all() and (carved <= filled).all() and (carved < height).any()
    assert (carved - height).max() < 1e-9, "without limits all is cut, and flats alone rise by single steps"
    assert np.abs(carved - height).sum() < 0.25 * np.abs(filled - height).sum(), "carving moves less ground"
    assert np.array_equal(terrain.to_numpy(), height), "the terrain given is not changed"


def test_limits_leave_deep_pits_to_be_filled(device):
    terrain = Terrain(fractal(96, seed=2), 10.0, device=device)
    height, filled = terrain.to_numpy(), hydrology.fill_depressions(terrain).to_numpy()
    shallow = hydrology.carve_depressions(terrain, max_depth=0.5).to_numpy()
    short = hydrology.carve_depressions(terrain, max_length=25.0).to_numpy()
    # A cut goes down to a line that falls by 2^-50 of the height a cell.
    assert (height - shallow).max() <= 0.5 + 1e-9
    for some in (shallow, short):
        assert (some < height).any() and (some > height).any() and (some <= filled).all()
    assert np.array_equal(hydrology.carve_depressions(terrain, max_length=0.0).to_numpy(), filled)


def test_without_epsilon_depressions_become_flats(device):
    terrain = Terrain(fractal(64), 10.0, device=device)
    flat = hydrology.fill_depressions(terrain, epsilon=False).to_numpy()
    filled = hydrology.fill_depressions(terrain).to_numpy()
    assert (filled >= flat).all() and (filled - flat).max() < 1e-9
    assert np.array_equal(np.unique(flat), np.intersect1d(flat, terrain.to_numpy())), "only heights that were there"


@pytest.mark.parametrize("seed", range(4))
def test_public_functions_equal_the_reference(seed, device):
    rng = np.random.default_rng(seed)
    height, edges = reference.random_heights(rng, 30), reference.random_rules(rng)
    for nodata in ("outlet", "wall"):
        terrain, raster = Terrain(height, 5.0, device=device), reference.Raster(height, edges, nodata)
        rules = {"edges": edges, "nodata": nodata}
        filled = hydrology.fill_depressions(terrain, **rules).to_numpy()
        assert np.array_equal(filled, reference.fill(raster), equal_nan=True)
        carved = hydrology.carve_depressions(terrain, max_depth=3.0, max_length=20.0, **rules).to_numpy()
        assert np.array_equal(carved, reference.carve(raster, 3.0, 4.0), equal_nan=True)
        receiver = reference.receivers(raster)
        assert np.array_equal(hydrology.flow_directions(terrain, **rules).numpy(), receiver)
        area = hydrology.drainage_area(terrain, **rules).numpy()
        assert np.array_equal(area, 25.0 * reference.d8_cells(receiver), equal_nan=True)


# ---- drainage area


@pytest.mark.parametrize("method", ["d8", "mfd"])
def test_all_area_arrives_at_base_level(method, device):
    height = fractal(128)
    height[30:50, 40:60] = NAN
    terrain = hydrology.fill_depressions(Terrain(height, 30.0, device=device))
    area, base = hydrology.drainage_area(terrain, method=method).numpy(), own(hydrology.route(terrain))
    total = np.isfinite(height).sum() * 30.0**2
    if method == "d8":
        assert area[base].sum() == total
    assert abs(area[base].sum() / total - 1.0) < SUM_TOLERANCE
    assert np.array_equal(np.isnan(area), np.isnan(height)) and np.nanmin(area) == 900.0


def test_pits_keep_their_water_where_nothing_was_filled(device):
    terrain = Terrain(fractal(64), 2.0, device=device)
    flow = hydrology.route(terrain)
    assert hydrology.drainage_area(flow).numpy()[own(flow)].sum() == 64 * 64 * 4.0
    assert own(flow)[1:-1, 1:-1].any()


def test_tilted_periodic_plane_drains_row_by_row(device):
    """Each row has the water of all above it; a cell sends .42265 straight on and .28868 to either side."""
    height = np.repeat(np.arange(20.0, 0.0, -1.0)[:, None], 12, axis=1)
    edges = {"north": "closed", "south": "open", "east": "periodic", "west": "periodic"}
    rows = np.arange(1.0, 21.0)[:, None] * np.ones((1, 12))
    for method in ("d8", "mfd"):
        area = hydrology.drainage_area(Terrain(height, 10.0, device=device), method=method, edges=edges).numpy()
        assert np.allclose(area / 100.0, rows, rtol=1e-13)
    height[0] = 0.0
    height[0, 5] = 20.0  # one spring alone; the rest of its row is dammed off below
    height[0, :5] = height[0, 6:] = NAN
    terrain = Terrain(height, 1.0, device=device)
    area = hydrology.drainage_area(terrain, method="mfd", edges=edges, nodata="wall").numpy()
    assert np.allclose(area[1, 4:7] - 1.0, [0.28868, 0.42265, 0.28868], atol=5e-6)


def test_cone_has_the_least_scatter_at_exponent_1_1(device):
    """The specific area of a cone is r/2; over a ring of square cells the mean is off by their shape."""
    y, x = np.mgrid[-110:111, -110:111].astype(np.float64)
    r = np.hypot(x, y)
    ring = np.abs(r - 100.0) < 0.5
    scatter = {}
    for exponent in (1.0, 1.1, 1.2, 1.3, 1.5, 2.0):
        area = hydrology.drainage_area(Terrain(-r, 1.0, device=device), method="mfd", exponent=exponent).numpy()
        ratio = area[ring] / (0.5 * r[ring])
        scatter[exponent] = ratio.std() / ratio.mean()
        if exponent == 1.1:
            assert abs(ratio.mean() - 1.0) < 0.06
    assert min(scatter, key=scatter.get) == 1.1
    assert abs(scatter[1.1] - 0.008) < 0.001


def test_random_lattice_has_scheideggers_sources_and_hacks_exponent():
    """Every cell drains to one of the two below it at random: a quarter are sources, and lengths grow as A^(2/3)."""
    size, rng = 800, np.random.default_rng(3)
    row, column = np.indices((size, size))
    receiver = (row + 1) * size + (column + rng.integers(0, 2, (size, size))) % size
    receiver[-1] = np.arange(size * size)[-size:]
    flow = hydrology.Flow(Terrain(np.zeros((size, size)), 1.0), receiver)
    area, length = hydrology.drainage_area(flow).numpy(), hydrology.flow_length(flow, downstream=False).numpy()
    # Standard deviation of the fraction over 640,000 cells: below .0006.
    assert abs((area[1:] == 1.0).mean() - 0.25) < 0.002
    # Basins that reach the first row are cut short; small ones have not reached the asymptote.
    octave = np.where(length < row, np.floor(np.log2(area)), -1)
    means = [(np.log(area[octave == k].mean()), np.log(length[octave == k].mean())) for k in range(5, 11)]
    exponent = np.polyfit(*np.transpose(means), 1)[0]
    assert abs(exponent - 2.0 / 3.0) < 0.03


@pytest.mark.parametrize("method", ["d8", "mfd"])
def test_area_does_not_depend_on_how_the_raster_lies(method, device):
    """Turned and mirrored terrain: the same areas, except where D8 met a tie, of which real numbers have none."""
    height = fractal(48)
    filled = hydrology.fill_depressions(Terrain(height, 1.0, device=device))
    area = hydrology.drainage_area(filled, method=method).numpy()
    for turn in (np.rot90, np.flipud, np.transpose):
        turned = Terrain(np.ascontiguousarray(turn(height)), 1.0, device=device)
        other = hydrology.drainage_area(hydrology.fill_depressions(turned), method=method)
        same = np.isclose(other, turn(area), rtol=1e-9)
        # Filled ground is full of ties.
        assert same.all() if method == "mfd" else same.mean() > 0.9


# ---- what follows from it


def test_discharge_at_four_areas():
    flow = hydrology.discharge(np.array([1e6, 1e7, 1e8, 1e9]))
    assert np.allclose(flow, [0.42, 2.057, 10.08, 49.35], rtol=5e-4)


def test_width_is_calibrated_at_100_km2_and_grows_with_the_root_of_area():
    flow = hydrology.discharge(1e8)
    assert np.isclose(hydrology.channel_width(1e8), hydrology.width_of_discharge(flow))
    assert np.isclose(bankfull_discharge(hydrology.width_of_discharge(flow)), flow)
    assert np.isclose(hydrology.channel_width(4e8) / hydrology.channel_width(1e8), 2.0)
    assert np.isclose(hydrology.channel_width(1e8), 22.85, atol=0.01)
    assert np.isclose(hydrology.channel_width(1e8, coefficient=1e-3), 10.0)


def test_stream_power_is_root_of_area_times_slope(device):
    """On a plane that falls by 1 in 50 to the south, down columns of 10 m cells."""
    height = np.repeat(np.arange(8.0, 0.0, -1.0)[:, None], 5, axis=1) * 0.2
    edges = {"north": "closed", "south": "open", "east": "closed", "west": "closed"}
    power = hydrology.stream_power(Terrain(height, 10.0, device=device), edges=edges)
    expected = np.sqrt(100.0 * np.arange(1.0, 9.0)) * 0.02
    expected[-1] = 0.0  # an outlet has no slope
    assert np.allclose(power, expected[:, None], rtol=1e-12)
    flow = hydrology.route(Terrain(height, 10.0, device=device), edges=edges)
    area = np.full((8, 5), 4.0)
    assert np.allclose(hydrology.stream_power(flow, area, m=1.0, n=2.0).numpy()[:-1], 4.0 * 0.02**2, rtol=1e-12)


def test_flow_length_runs_both_ways(device):
    height = np.repeat(np.arange(6.0)[:, None], 4, axis=1) + np.zeros((1, 4))
    edges = {"north": "open", "south": "closed", "east": "closed", "west": "closed"}
    flow = hydrology.route(Terrain(height, 5.0, device=device), edges=edges)
    assert np.allclose(hydrology.flow_length(flow).numpy()[:, 1], 5.0 * np.arange(6.0))
    assert np.allclose(hydrology.flow_length(flow, downstream=False).numpy()[:, 1], 5.0 * np.arange(5.0, -1.0, -1.0))


def test_hand_is_the_height_above_the_channel_a_cell_drains_to(device):
    """A valley along a column; its west bank drains to it, its east bank over the map's edge."""
    height = np.array([[7.0, 4.0, 9.0, 8.0], [6.0, 3.0, 9.5, 8.0], [5.0, 2.0, 9.0, 8.0]])
    edges = {"north": "closed", "south": "open", "east": "open", "west": "closed"}
    channel = np.zeros((3, 4), bool)
    channel[:, 1] = True
    above = hydrology.hand(Terrain(height, 30.0, device=device), channel, edges=edges).numpy()
    assert np.array_equal(above[:2, :3], [[3.0, 0.0, 5.0], [3.0, 0.0, 6.5]])
    assert np.isnan(above[:, 3]).all()


def test_a_flow_is_asked_many_times_and_routed_once(monkeypatch, device):
    flow = hydrology.route(hydrology.fill_depressions(Terrain(fractal(32), 10.0, device=device)))
    area = hydrology.drainage_area(flow)
    monkeypatch.setattr(hydrology.routing, "route", None)
    assert flow.order is flow.order and len(flow.order) == 32 * 32
    assert np.array_equal(hydrology.drainage_area(flow), area)
    assert hydrology.hand(flow, area.numpy() > 4000.0).shape == (32, 32)
    assert "32 x 32" in repr(flow)


def test_results_lie_where_the_terrain_lies_and_routing_says_where_it_runs(device, caplog):
    cells_module._say_where.cache_clear()
    terrain = Terrain(fractal(24), 10.0, origin=(500.0, 900.0), crs="EPSG:32611", device=device)
    with caplog.at_level(logging.INFO, "warpriver"):
        filled, carved = hydrology.fill_depressions(terrain), hydrology.carve_depressions(terrain)
    for result in (filled, carved):
        assert result.device == terrain.device and result.cell_size == 10.0
        assert result.origin == terrain.origin and result.crs == terrain.crs
    host = Terrain(fractal(24), 10.0)
    assert np.array_equal(filled.to_numpy(), hydrology.fill_depressions(host).to_numpy())
    assert np.array_equal(hydrology.drainage_area(filled), hydrology.drainage_area(hydrology.fill_depressions(host)))
    assert caplog.text.count("runs on the CPU device") == int(terrain.device.is_cuda)


# ---- real ground


@pytest.mark.parametrize("name", RASTERS)
def test_real_terrain_is_drained_whole(name, device):
    height, cell_size = real_heights(name)
    for change in (hydrology.fill_depressions, hydrology.carve_depressions):
        terrain = change(Terrain(height, cell_size, device=device))
        flow = hydrology.route(terrain)
        d8, mfd = hydrology.drainage_area(flow).numpy(), hydrology.drainage_area(terrain, method="mfd").numpy()
        cells = np.isfinite(height).sum()
        base = own(flow)
        inside = base[1:-1, 1:-1] & ~_beside_gap(height)[1:-1, 1:-1]
        assert not inside.any(), "water leaves at the edge and beside no data only"
        assert np.isclose(d8[base].sum(), cells * cell_size**2, rtol=1e-12)
        assert np.isclose(mfd[base].sum(), cells * cell_size**2, rtol=SUM_TOLERANCE)
        assert (np.diff(terrain.to_numpy().ravel()[_course(flow, d8)]) < 0.0).all(), "the main stem falls all the way"


def _beside_gap(height):
    """Cells with a neighbour that has no data."""
    gap = np.pad(np.isnan(height), 1)
    rows = gap[:-2] | gap[1:-1] | gap[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


def _course(flow, area):
    """Flat indices from the farthest source down to the outlet of the largest basin."""
    length, receiver = hydrology.flow_length(flow).numpy(), flow.receiver.numpy()
    start = int(np.nanargmax(np.where(np.isnan(area), np.nan, length)))
    course = [start]
    while receiver.flat[course[-1]] != course[-1]:
        course.append(int(receiver.flat[course[-1]]))
    return course


# ---- bad input and edges of the domain


def test_level_ground_drains_after_filling(device):
    for value in (0.0, -7.25, 4000.0):
        terrain = hydrology.fill_depressions(Terrain(np.full((40, 30), value), 1.0, device=device))
        flow = hydrology.route(terrain)
        assert own(flow).sum() == 2 * 30 + 2 * 38
        assert hydrology.drainage_area(flow).numpy()[own(flow)].sum() == 1200.0
        assert np.array_equal(
            hydrology.carve_depressions(Terrain(np.full((40, 30), value), 1.0, device=device)).to_numpy(),
            terrain.to_numpy(),
        )


@pytest.mark.filterwarnings("error", "ignore:height. of its cells")
@pytest.mark.parametrize("change", [hydrology.fill_depressions, hydrology.carve_depressions])
@pytest.mark.parametrize("relief", [0.0, 5e-324, 1e-300, 1.0, 1e300])
def test_no_relief_is_too_small_or_too_large(change, relief, device):
    """Heights wait in buckets by their share of the relief, which may be nothing, or not even a normal number."""
    height = relief * np.random.default_rng(0).random((25, 30))
    height[12, 12] = 0.0
    result = change(Terrain(height, 10.0, device=device))
    flow = hydrology.route(result)
    assert hydrology.drainage_area(flow).numpy()[own(flow)].sum() == 25 * 30 * 100.0
    assert not own(flow)[1:-1, 1:-1].any()


def test_terrain_closed_all_around_drains_to_its_lowest_cell(caplog, device):
    height = fractal(24)
    height[11, 7] = height.min() - 1.0
    with caplog.at_level(logging.INFO, "warpriver"):
        filled = hydrology.fill_depressions(Terrain(height, 1.0, device=device), edges="closed")
    assert "no outlet" in caplog.text
    flow = hydrology.route(filled, edges="closed")
    assert np.argwhere(own(flow)).tolist() == [[11, 7]]
    assert hydrology.drainage_area(flow).numpy()[11, 7] == 24 * 24


def test_islands_behind_walls_drain_each_to_its_lowest_cell(device):
    height = np.full((5, 7), NAN)
    height[1, 1:3], height[3, 4:6] = [5.0, 4.0], [1.0, 2.0]
    flow = hydrology.route(Terrain(height, 1.0, device=device), nodata="wall")
    assert np.argwhere(own(flow)).tolist() == [[1, 2], [3, 4]]
    as_outlets = hydrology.route(Terrain(height, 1.0, device=device), nodata="outlet")
    assert own(as_outlets).sum() == 4 and (as_outlets.receiver.numpy() < 0).sum() == 31


def test_a_pit_at_the_edge_is_an_outlet_if_open_and_filled_if_closed(device):
    height = np.full((5, 5), 9.0)
    height[0, 2], height[4, 2] = 1.0, 5.0
    edges = {"north": "closed", "south": "open", "east": "closed", "west": "closed"}
    assert hydrology.fill_depressions(Terrain(height, 1.0, device=device)).to_numpy()[0, 2] == 1.0
    filled = hydrology.fill_depressions(Terrain(height, 1.0, device=device), edges=edges).to_numpy()
    assert 9.0 < filled[0, 2] < 9.001


def test_a_terrain_too_large_is_refused_before_anything_is_allocated(monkeypatch):
    terrain = Terrain(np.zeros((3, 3)), 1.0)
    monkeypatch.setattr("warpriver.device.available_memory", lambda device="cpu": 100)
    for call in (hydrology.fill_depressions, hydrology.carve_depressions, hydrology.route):
        with pytest.raises(MemoryError, match=r"routing a terrain of 5 x 5 cells needs .* GB are free"):
            call(terrain)


def test_a_terrain_beyond_int32_is_refused(monkeypatch):
    terrain = Terrain(np.zeros((3, 3)), 1.0)
    monkeypatch.setattr(Terrain, "shape", property(lambda self: (50_000, 50_000)))
    monkeypatch.setattr(cells_module, "require_memory", lambda *args: None)
    with pytest.raises(ValueError, match=r"50000 x 50000 cells; 2\^31 is the limit"):
        hydrology.route(terrain)


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ("shut", "edges is 'shut'; use 'open', 'closed', 'periodic'"),
        (3, "edges is 3"),
        (("open", "open"), "one for each of north, south, east, west"),
        ({"north": "open"}, "one for each of north, south, east, west"),
        (("periodic", "open", "open", "open"), "periodic sides come in pairs"),
        (("open", "open", "closed", "periodic"), "east is 'closed' and west is 'periodic'"),
    ],
)
def test_unknown_edges_are_refused(edges, message):
    with pytest.raises(ValueError, match=message):
        hydrology.fill_depressions(Terrain(np.zeros((3, 3)), 1.0), edges=edges)


def test_other_bad_input_is_refused():
    terrain = Terrain(np.zeros((3, 3)), 1.0)
    with pytest.raises(ValueError, match="nodata is 'sea'; use 'outlet' or 'wall'"):
        hydrology.route(terrain, nodata="sea")
    with pytest.raises(ValueError, match="method is 'dinf'"):
        hydrology.drainage_area(terrain, method="dinf")
    for exponent in (0.0, -1.0, NAN):
        with pytest.raises(ValueError, match="exponent is"):
            hydrology.drainage_area(terrain, method="mfd", exponent=exponent)
    with pytest.raises(ValueError, match="max_depth is -1"):
        hydrology.carve_depressions(terrain, max_depth=-1.0)
    with pytest.raises(ValueError, match="max_length is nan"):
        hydrology.carve_depressions(terrain, max_length=NAN)
    with pytest.raises(ValueError, match=r"channels has shape \(2, 2\); the terrain has \(3, 3\)"):
        hydrology.hand(terrain, np.ones((2, 2), bool))
    with pytest.raises(ValueError, match="a Flow has its edges and nodata already"):
        hydrology.drainage_area(hydrology.route(terrain), edges="closed")


def test_a_receiver_from_elsewhere_is_checked():
    terrain = Terrain(np.zeros((2, 2)), 1.0)
    with pytest.raises(ValueError, match=r"whole numbers of shape \(2, 2\)"):
        hydrology.Flow(terrain, np.zeros(4, int))
    with pytest.raises(ValueError, match=r"whole numbers of shape \(2, 2\)"):
        hydrology.Flow(terrain, np.full((2, 2), 0.5))
    for receiver in ([[0, 4], [0, 0]], [[0, -2], [0, 0]], [[-1, 0], [3, 3]]):
        with pytest.raises(ValueError, match="leads out of the raster or to a cell without data"):
            hydrology.Flow(terrain, np.array(receiver))
    with pytest.raises(ValueError, match="more donors than it has neighbours"):
        hydrology.Flow(Terrain(np.zeros((4, 4)), 1.0), np.zeros((4, 4), int))
    with pytest.raises(ValueError, match="cycle: 2 cells"):
        _ = hydrology.Flow(terrain, np.array([[1, 0], [2, 3]])).order
