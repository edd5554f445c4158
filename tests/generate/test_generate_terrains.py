import math

import numpy as np
import pytest
import reference_terrain as twin
from scipy.ndimage import minimum_filter

from warpriver import hydrology, metrics
from warpriver.generate.terrains import (
    cone,
    fluvial_terrain,
    fractal_terrain,
    intermontane_basin,
    mountain_front,
    mountain_front_line,
    mountain_front_zones,
    read_sample_dem,
    tilted_plain,
)
from warpriver.terrain import Terrain


def pits(terrain):
    """Inner cells none of whose neighbours is lower."""
    height = terrain.to_numpy()
    footprint = np.ones((3, 3), bool)
    footprint[1, 1] = False
    return (height <= minimum_filter(height, footprint=footprint))[1:-1, 1:-1]


@pytest.mark.parametrize("direction", [0.0, 0.3, math.pi / 2, math.pi, 4.0])
def test_a_plain_falls_as_asked(direction, device):
    t = tilted_plain((30, 40), 25.0, 0.02, direction, device=device)
    assert t.shape == (30, 40) and t.bounds == (0.0, 0.0, 1000.0, 750.0)
    gradient = t.gradient([(0.0, 0.0), (500.0, 333.0), (1000.0, 750.0)])
    expected = [-0.02 * math.cos(direction), -0.02 * math.sin(direction)]
    np.testing.assert_allclose(gradient, np.broadcast_to(expected, (3, 2)), atol=1e-12)
    assert t.to_numpy().min() == 0.0


def test_a_cone_has_its_slope_and_its_symmetry(device):
    t = cone((61, 81), 10.0, 0.25, device=device)
    height = t.to_numpy()
    np.testing.assert_allclose(height, height[::-1], rtol=1e-13)
    np.testing.assert_allclose(height, height[:, ::-1], rtol=1e-13)
    assert np.unravel_index(height.argmax(), height.shape) == (30, 40)
    radius = np.hypot(
        *(np.stack(twin.centers(height.shape, (0.0, 610.0, 10.0))) - np.array([405.0, 305.0])[:, None, None])
    )
    far = radius > 100.0
    far[[0, -1]] = far[:, [0, -1]] = False
    # Central differences over two cells of a cone: off by (dx / r)^2 / 12 or so.
    np.testing.assert_allclose(t.slope()[far], 0.25, rtol=0.01)
    assert height[0, 0] == pytest.approx(0.25 * 10.0 / math.sqrt(2.0), rel=1e-2)


def test_noise_has_the_relief_asked_for_and_depends_on_the_seed_alone():
    one, two = (fractal_terrain((80, 120), 30.0, 700.0, seed=5).to_numpy() for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert one.min() == 0.0 and one.max() == pytest.approx(700.0)
    other = fractal_terrain((80, 120), 30.0, 700.0, seed=6).to_numpy()
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.5
    assert fractal_terrain((20, 20), 1.0, 0.0, seed=0).to_numpy().max() == 0.0


def test_finer_cells_show_the_same_land():
    """Up to the octaves that only the finer cells can hold, and a factor, since the relief is that of the cells."""
    coarse = fractal_terrain((60, 80), 40.0, 500.0, seed=2, octaves=4).to_numpy()
    fine = fractal_terrain((180, 240), 40.0 / 3.0, 500.0, seed=2, octaves=4).to_numpy()[1::3, 1::3]
    assert np.corrcoef(coarse.ravel(), fine.ravel())[0, 1] > 0.9999999


@pytest.mark.parametrize("roughness", [0.35, 0.45, 0.55])
def test_roughness_is_the_fall_of_the_spectrum(roughness):
    """Octaves of half the wavelength and r times the height: squared steps grow as distance^(2 H), where 2^-H = r."""
    heights = [fractal_terrain((256, 256), 1.0, 1.0, seed, roughness=roughness).to_numpy() for seed in range(6)]
    lags = np.array([8, 16])
    square = [np.mean([((h[:, lag:] - h[:, :-lag]) ** 2).mean() for h in heights]) for lag in lags]
    slope = 0.5 * math.log2(square[1] / square[0])
    # Noise of one octave is as steep as its band is wide, so that H shows within some hundredths to a tenth only.
    assert slope == pytest.approx(min(-math.log2(roughness), 1.0), abs=0.2)


def test_noise_is_alike_in_all_directions():
    east = north = 0.0
    for seed in range(8):
        height = fractal_terrain((128, 128), 1.0, 1.0, seed).to_numpy()
        east += np.mean(np.diff(height, axis=1) ** 2)
        north += np.mean(np.diff(height, axis=0) ** 2)
    assert 0.85 < east / north < 1.18


@pytest.mark.parametrize("seed", [0, 1])
def test_fluvial_land_drains_and_follows_the_stream_power_law(seed):
    t = fluvial_terrain((90, 110), 50.0, 800.0, seed)
    height = t.to_numpy()
    assert height.max() == pytest.approx(800.0) and height.min() == 0.0
    assert not pits(t).any()
    edge = np.ones(height.shape, bool)
    edge[1:-1, 1:-1] = False
    assert (height[edge] == 0.0).all() and (height[~edge] > 0.0).all()
    receiver = twin.receivers(height, edge)
    area, _ = twin.drained(height, receiver, np.ones(height.size), np.zeros(height.size), 50.0, 1.0, 0.45, 3e4)
    assert area[edge.ravel()].sum() == pytest.approx(height.size * 2500.0)
    cell = np.flatnonzero((receiver != np.arange(height.size)) & (area >= 3e5))
    step = np.hypot(cell // 110 - receiver[cell] // 110, cell % 110 - receiver[cell] % 110) * 50.0
    slope = (height.ravel()[cell] - height.ravel()[receiver[cell]]) / step
    concavity = -np.polyfit(np.log(area[cell]), np.log(slope), 1)[0]
    assert concavity == pytest.approx(0.45, abs=0.05)


def test_divides_of_fluvial_land_are_no_cliffs(device):
    """Slopes on both sides of a divide become alike as it moves, so that no cell is much steeper than hillslopes."""
    slope = fluvial_terrain((120, 120), 50.0, 1000.0, seed=3, device=device).slope()
    assert np.percentile(slope, 99.9) < 2.0 * np.percentile(slope, 90)


def test_the_mountain_front_has_its_three_zones(device):
    t, line, zones = mountain_front(seed=0, device=device), mountain_front_line(seed=0), mountain_front_zones()
    assert t.bounds == (0.0, 0.0, 35_000.0, 20_000.0) and t.cell_size == 50.0
    assert line[0, 0] > line[-1, 0], "the river does not run west"
    slope = np.hypot(*t.gradient(line).T)
    at = {name: slope[(line[:, 0] >= west) & (line[:, 0] <= east)] for name, (west, east) in zones.items()}
    assert at["front"].min() > 0.15 and len(at["front"]) > 20
    assert at["plain"].max() < 0.003 and np.median(at["plain"]) == pytest.approx(1e-3, rel=0.1)
    assert at["valley"].max() < 0.006
    # The river only ever falls, but for the unevenness of the plain.
    fall = -np.diff(t.sample(line))
    assert fall.min() > -0.1 and (fall[line[1:, 0] > zones["plain"][1]] > 0.0).all()
    # Straight enough to start from, on the plain and on the front.
    plain = line[line[:, 0] < zones["plain"][1]]
    assert metrics.sinuosity(plain) < 1.05
    spacing = np.hypot(*np.diff(line, axis=0).T)
    assert spacing.min() > 49.0 and spacing.max() < 51.0


@pytest.mark.parametrize("seed", [1, 2])
def test_the_valley_is_held_by_mountains_and_the_plain_is_open(seed):
    t, line = mountain_front(cell_size=100.0, seed=seed), mountain_front_line(seed=seed)
    height = t.to_numpy()
    x, y = twin.centers(height.shape, (0.0, 20_000.0, 100.0))
    river = np.interp(x, line[::-1, 0], line[::-1, 1])
    level = np.interp(x, line[::-1, 0], t.sample(line)[::-1])
    west, east = mountain_front_zones()["valley"]
    beside = (x > west + 500.0) & (x < east - 500.0) & (np.abs(y - river) > 2000.0) & (np.abs(y - river) < 4000.0)
    assert np.median((height - level)[beside]) > 150.0
    assert (height - level)[beside].min() > 0.0, "the river runs above the land beside it"
    foot = mountain_front_zones()["plain"][1]
    assert t.slope()[x < foot - 2500.0].max() < 0.01
    inner = (x > foot + 3000.0)[1:-1, 1:-1] & (np.abs(y - river) > 2500.0)[1:-1, 1:-1]
    assert not pits(t)[inner].any()


def test_the_mountain_front_depends_on_seed_and_cells_as_said():
    one, two = mountain_front(200.0, seed=4), mountain_front(200.0, seed=4)
    np.testing.assert_array_equal(one.to_numpy(), two.to_numpy())
    assert not np.array_equal(one.to_numpy(), mountain_front(200.0, seed=5).to_numpy())
    assert one.shape == (100, 175)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_basin_gathers_its_water_and_sends_it_west(seed):
    t = intermontane_basin(200.0, seed)
    assert t.shape == (130, 200) and t.bounds == (0.0, 0.0, 40_000.0, 26_000.0)
    flow = hydrology.route(hydrology.carve_depressions(t))
    area = hydrology.drainage_area(flow).numpy()
    row, column = np.unravel_index(np.nanargmax(area), area.shape)
    assert column == 0 and 30 < row < 100, "the largest river leaves in the west, on the plain"
    assert area[row, column] > 0.6 * 40e3 * 26e3
    # Steep mountains, and a plain on which bends migrate at nearly their full rate.
    slope = t.slope()
    x, _ = twin.centers(t.shape, (0.0, 26_000.0, 200.0))
    assert np.median(slope[x > 34_000.0]) > 0.15
    network = hydrology.extract_network(t, min_drainage_area=2e7)
    west = network.points()[network.points()[:, 0] < 10_000.0]
    inner = west[np.abs(west[:, 1] - 13_000.0) < 4000.0]
    assert np.median(np.hypot(*t.gradient(inner).T)) < 0.01


def test_the_basin_depends_on_seed_and_relief_as_said():
    one = intermontane_basin(400.0, 4).to_numpy()
    np.testing.assert_array_equal(one, intermontane_basin(400.0, 4).to_numpy())
    assert not np.array_equal(one, intermontane_basin(400.0, 5).to_numpy())
    # All else stays: the plain, and the mountains' shape.
    low, high = (intermontane_basin(400.0, 4, relief=r).to_numpy() for r in (0.0, 2400.0))
    np.testing.assert_allclose(high - low, 2.0 * (one - low), atol=1e-9)
    assert np.ptp(low) < 80.0 and (high - low).max() == pytest.approx(2400.0)


def test_the_sample_dem_is_real_and_lies_the_right_way():
    pytest.importorskip("matplotlib")
    t = read_sample_dem()
    assert t.shape == (424, 401) and t.cell_size == 75.0 and t.crs is None
    west, south, east, north = t.bounds
    assert (
        (west, south) == (0.0, 0.0)
        and north == pytest.approx(31_850.0, abs=50.0)
        and east == pytest.approx(30_070.0, abs=50.0)
    )
    height = t.to_numpy()
    assert not np.isnan(height).any() and 236.0 <= height.min() < 245.0 and 1060.0 < height.max() <= 1076.0
    # Cross Mountain, 1076 m, at 36.213 N lies outside; what is inside: the Powell valley, low, in the east.
    assert height[:, -100:].mean() < height[:, :100].mean()
    assert 0.15 < np.median(t.slope()) < 0.3
    x, y = twin.centers((100, 100), (5_000.0, 25_000.0, 200.0))
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    assert np.corrcoef(read_sample_dem(150.0).sample(xy), t.sample(xy))[0, 1] > 0.99


BAD = [
    (lambda: tilted_plain((1, 5), 1.0, 0.1), "at least 2 of each"),
    (lambda: tilted_plain((5, 5), 0.0, 0.1), "cell_size is 0; give a positive number"),
    (lambda: tilted_plain((5, 5), 1.0, -0.1), "slope is -0.1"),
    (lambda: cone((5, 5), 1.0, math.nan), "slope is nan"),
    (lambda: fractal_terrain((5, 5), 1.0, -1.0, 0), "relief is -1"),
    (lambda: fractal_terrain((5, 5), 1.0, 1.0, 0, roughness=0.0), "roughness is 0.0"),
    (lambda: fractal_terrain((5, 5), 1.0, 1.0, 0, octaves=0), "octaves 0"),
    (lambda: fractal_terrain((5, 5), 1.0, 1.0, -3), "seed is -3"),
    (lambda: fluvial_terrain((5, 5), 1.0, 1.0, 0, concavity=0.0), "concavity is 0"),
    (lambda: fluvial_terrain((2, 2), 1.0, 1.0, 0), "at least 3 of each"),
    (lambda: intermontane_basin(0.0), "cell_size is 0"),
    (lambda: intermontane_basin(500.0), "give 400 m or less"),
    (lambda: intermontane_basin(relief=-1.0), "relief is -1"),
    (lambda: intermontane_basin(400.0, seed=-2), "seed is -2"),
    (lambda: mountain_front(-1.0), "cell_size is -1"),
    (lambda: mountain_front(5000.0), "cell_size is 5000.0"),
    (lambda: mountain_front_line(0.0), "spacing is 0"),
    (lambda: read_sample_dem(0.0), "cell_size is 0"),
]


@pytest.mark.parametrize(("call", "text"), BAD)
def test_bad_numbers_are_told(call, text):
    with pytest.raises(ValueError, match=text):
        call()


def test_land_that_cannot_fit_is_refused_before_it_is_made():
    for make in (tilted_plain, cone):
        with pytest.raises(MemoryError, match="GB are free"):
            make((10**6, 10**6), 1.0, 0.1)
    for make in (fractal_terrain, fluvial_terrain):
        with pytest.raises(MemoryError, match="GB are free"):
            make((10**6, 10**6), 1.0, 100.0, 0)


def test_terrains_go_to_the_device_asked_for(device):
    made = [
        tilted_plain((5, 5), 1.0, 0.1, device=device),
        cone((5, 5), 1.0, 0.1, device=device),
        fractal_terrain((5, 5), 1.0, 1.0, 0, device=device),
        fluvial_terrain((5, 5), 1.0, 1.0, 0, device=device),
        intermontane_basin(400.0, device=device),
        mountain_front(250.0, device=device),
    ]
    for terrain in made:
        assert isinstance(terrain, Terrain) and terrain.height.device.alias == device
    with pytest.raises(ValueError, match="is not on this machine"):
        cone((5, 5), 1.0, 0.1, device="cuda:77")
