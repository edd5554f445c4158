"""Beds, water, banks and lakes: closed forms on planes, and what must hold on any terrain."""

import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from data_folder import data_folder
from plain import plain_params
from test_real_terrains import TERRAINS, read

import warpriver as wr
from warpriver.history.events import Cutoff
from warpriver.landscape import CarveParams, SectionTable, carve, plain_under

CELL, WIDTH, DEPTH, SLOPE = 2.0, 60.0, 3.0, 1e-3
LEVEL = {"smoothing": 0.0, "junctions": False}


def plane(slope=SLOPE, shape=(150, 300), cell=CELL, tilt=0.0):
    """Ground that falls to the east, and towards the south by ``tilt``."""
    x, y = (np.arange(shape[1]) + 0.5) * cell, -(np.arange(shape[0]) + 0.5) * cell
    return wr.Terrain(100.0 - slope * x[None] + tilt * y[:, None], cell)


def straight(width=WIDTH, depth=DEPTH, y=-150.0, spacing=20.0):
    x = np.arange(40.0, 560.0, spacing)
    return wr.RiverNetwork.from_polylines([np.column_stack([x, np.full(len(x), y)])], width, depth)


def offsets(terrain, y=-150.0):
    """Distance of cells north of the line."""
    return -(np.arange(terrain.shape[0]) + 0.5) * terrain.cell_size - y


def cells_of(network, raster):
    """Row and column of the cell of each point, inside of the raster."""
    xy, (west, north), size = network.points(), raster.origin, raster.cell_size
    row = np.clip(((north - xy[:, 1]) // size).astype(int), 0, raster.shape[0] - 1)
    return row, np.clip(((xy[:, 0] - west) // size).astype(int), 0, raster.shape[1] - 1)


def uphill_steps(network, level):
    """Steps from point to point, and across nodes, at which a level rises."""
    start, step = network.starts(), np.diff(level)
    step[start[1:-1] - 1] = 0.0
    head = np.full(network.node_count, -np.inf)
    head[network.channel_from] = level[start[:-1]]
    across = head[network.channel_to] - level[start[1:] - 1]
    return int((step > 0.0).sum() + (across[~network.channel_closed] > 0.0).sum())


def assert_holds(carved, ground):
    """What must hold wherever rivers are carved: water falls, depths are those asked for, the rest is as it was."""
    network = carved.network
    cell = cells_of(network, carved.water)
    level, depth = carved.water.numpy()[cell], carved.depth.numpy()[cell]
    known = np.isfinite(ground.to_numpy()[cell])
    assert np.isfinite(level[known]).all(), "a channel is dry"
    assert uphill_steps(network, network.point_z) == 0
    assert uphill_steps(network, np.where(known, level, np.nan)) == 0
    # At least, as a cell may be that of a deeper channel as well.
    asked = np.concatenate(network.point_depths())
    assert (depth[known] >= 0.95 * asked[known]).all()
    outside = carved.support.numpy() == 0
    np.testing.assert_array_equal(carved.terrain.to_numpy()[outside], ground.to_numpy()[outside])
    total = sum(raster.numpy().astype(int) for raster in carved.materials.values())
    np.testing.assert_array_equal(total[np.isfinite(ground.to_numpy())], 255)
    wet = np.isfinite(carved.water.numpy())
    below = (carved.water.numpy() - carved.terrain.to_numpy())[wet]
    np.testing.assert_allclose(below, carved.depth.numpy()[wet], atol=1e-9)


# ---- closed forms


@pytest.mark.parametrize("section", ["parabola", "trapezoid"])
def test_a_straight_channel_has_its_section(section, device):
    ground = plane().to(device)
    carved = carve(ground, straight(), CarveParams(section=section, side_fraction=0.25, **LEVEL))
    n = offsets(ground)
    part = np.abs(n) / (0.5 * WIDTH)
    form = 1.0 - part**2 if section == "parabola" else np.minimum(1.0, 2.0 * (1.0 - part))
    form = np.where(part < 1.0, form, 0.0)
    # The mean of levels around a cell is its own, away from the ends.
    middle = slice(100, 200)
    level = ground.to_numpy()[:, middle]
    np.testing.assert_allclose(carved.terrain.to_numpy()[:, middle], level - DEPTH * form[:, None], atol=1e-4)
    wet = np.isfinite(carved.water.numpy()[:, middle])
    np.testing.assert_array_equal(wet, np.broadcast_to((part < 1.0)[:, None], wet.shape))


def test_forms_are_seen_from_the_left_bank_and_blended_along_the_line(device):
    ground, network = plane(0.0).to(device), straight()
    y = np.linspace(0.0, 1.0, 31)
    left, right = 6.75 * y * (1.0 - y) ** 2, 6.75 * y**2 * (1.0 - y)
    row = np.where(np.arange(network.point_count) < 13, 0, 1)
    carved = carve(ground, network, CarveParams(**LEVEL), sections=SectionTable([left, right], row))
    n = offsets(ground)
    place = np.clip(0.5 - n / WIDTH, 0.0, 1.0)  # the line runs east: its left bank is in the north
    depth = 100.0 - carved.terrain.to_numpy()
    # The twelfth segment, from x = 280 to 300 m, is between both.
    for column, weight in ((60, 0.0), (144, 9.0 / 20.0), (200, 1.0)):
        wanted = DEPTH * ((1.0 - weight) * np.interp(place, y, left) + weight * np.interp(place, y, right))
        np.testing.assert_allclose(depth[:, column], wanted, atol=0.02)
    np.testing.assert_allclose(SectionTable([left, right]).fraction, 6.75 / 12.0, atol=1e-3)


def test_walls_of_a_deep_cut_rise_at_the_angle_of_repose_at_most():
    # A sill 20 m high across the line, on level ground.
    ground = plane(0.0)
    height = ground.to_numpy()
    x = (np.arange(300) + 0.5) * CELL
    height += 20.0 * np.exp(-(((x - 300.0) / 60.0) ** 2))[None]
    ground = wr.Terrain(height, CELL)
    angle = 30.0
    carved = carve(ground, straight(width=16.0, depth=1.5), CarveParams(repose_angle=angle, **LEVEL))
    across = carved.terrain.to_numpy()[:, 150]
    n = offsets(ground)
    steepness = np.abs(np.diff(across)) / CELL
    outside = (np.abs(n[1:]) > 9.0) & (np.abs(n[:-1]) > 9.0)
    assert 0.9 * np.tan(np.radians(angle)) < steepness[outside].max() < 1.02 * np.tan(np.radians(angle))
    assert carved.materials["wall"].numpy()[:, 150].max() > 200
    assert carved.report.deepest_cut == pytest.approx(21.5, abs=0.2)


def test_the_limit_of_cuts_holds_for_banks_beside_a_cliff():
    """A cliff of 30 m along the left bank; then one in the bed, whose side is cut open all the same, and reported."""
    height = plane(0.0).to_numpy()
    network = straight(width=16.0, depth=1.5, spacing=5.0)
    y = float(network.points()[0, 1])
    north = plane(0.0).bounds[3] - (np.arange(height.shape[0]) + 0.5) * CELL
    for beside, beyond in ((16.0, False), (4.0, True)):
        ground = wr.Terrain(height + 30.0 * (north > y + beside)[:, None], CELL)
        told = pytest.warns(UserWarning, match="the sides of beds were cut by up to") if beyond else nullcontext()
        with told:
            carved = carve(ground, network, CarveParams(max_cut=5.0, **LEVEL))
        cut = ground.to_numpy() - carved.terrain.to_numpy()
        dry = np.isnan(carved.water.numpy())
        assert cut[dry].max() == pytest.approx(5.0, abs=1e-9)
        assert (carved.report.cells_beyond > 0) == beyond
        assert carved.report.cell_excess == pytest.approx(25.0 if beyond else 0.0, abs=0.1)


def test_the_limit_of_cuts_holds_and_is_reported():
    ground = plane(0.0)
    height = ground.to_numpy()
    x = (np.arange(300) + 0.5) * CELL
    height += 20.0 * np.exp(-(((x - 300.0) / 60.0) ** 2))[None]
    ground = wr.Terrain(height, CELL)
    network = straight(width=16.0, depth=1.5, spacing=5.0)
    with pytest.warns(UserWarning, match="max_cut=5 m held the water up at"):
        carved = carve(ground, network, CarveParams(max_cut=5.0, **LEVEL))
    assert carved.report.excess == pytest.approx(15.0, abs=0.02) and carved.report.held_points > 5
    cut = ground.to_numpy() - carved.terrain.to_numpy()
    # Levels are averaged around a place, over less than the width.
    assert cut.max() < 5.0 + 1.5 + 0.15
    assert uphill_steps(carved.network, carved.network.point_z) == 0
    # Upstream of the crest the water stands on what was filled.
    assert carved.report.highest_fill == pytest.approx(15.0, abs=0.1)


def test_filling_in_part_lies_between_cutting_and_filling():
    rng = np.random.default_rng(2)
    ground = wr.Terrain(plane().to_numpy() + rng.normal(0.0, 0.3, (150, 300)), CELL)
    levels = [
        carve(ground, straight(), CarveParams(fill_fraction=part, **LEVEL)).network.point_z for part in (0.0, 0.25, 1.0)
    ]
    np.testing.assert_allclose(levels[1], 0.75 * levels[0] + 0.25 * levels[2], atol=1e-12)
    assert (levels[2] >= levels[0]).all() and (levels[2] > levels[0]).any()


def test_smoothed_levels_fall_without_steps_and_keep_their_ends():
    rng = np.random.default_rng(2)
    ground = wr.Terrain(plane().to_numpy() + rng.normal(0.0, 0.05, (150, 300)), CELL)
    rough, smooth = (
        carve(ground, straight(width=10.0), CarveParams(smoothing=s, junctions=False)).network.point_z
        for s in (0.0, 20.0)
    )
    np.testing.assert_allclose(smooth[[0, -1]], rough[[0, -1]], atol=1e-9)
    assert np.diff(smooth).max() <= 0.0 and np.diff(smooth).min() > 0.5 * np.diff(rough).min()


# ---- what must hold anywhere


def tree(seed=0):
    rng = np.random.default_rng(seed)

    def line(a, b):
        t = np.linspace(0.0, 1.0, 40)[:, None]
        wave = np.sin(np.pi * t) * np.sin(9.0 * t + rng.uniform(0.0, 6.0))
        side = np.array([a[1] - b[1], b[0] - a[0]]) / np.hypot(*np.subtract(b, a))
        return np.array(a) * (1.0 - t) + np.array(b) * t + 60.0 * wave * side

    lines = [
        line((100.0, 1500.0), (900.0, 1000.0)),
        line((100.0, 500.0), (900.0, 1000.0)),
        line((900.0, 1000.0), (1500.0, 900.0)),
        line((1000.0, 200.0), (1500.0, 900.0)),
        line((1500.0, 900.0), (2300.0, 800.0)),
    ]
    return wr.RiverNetwork.from_polylines(lines, [20.0, 25.0, 40.0, 12.0, 60.0])


def hills(cell, seed=1):
    noise = wr.generate.fractal_terrain((int(2000 / cell), int(2400 / cell)), cell, 25.0, seed).to_numpy()
    x = (np.arange(noise.shape[1]) + 0.5) * cell
    return wr.Terrain(noise + 80.0 - 0.02 * x[None], cell, (0.0, 2000.0))


@pytest.mark.parametrize("cell", [4.0, 15.0, 60.0])
def test_rivers_over_hills(cell, device):
    ground = hills(cell).to(device)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # cuts through hills
        assert_holds(carve(ground, tree().to(device)), ground)


def test_there_are_no_seams_at_junctions_and_inside_of_bends():
    """No step between neighbours is above what the slopes of banks make, where limbs and channels overlap."""
    t = np.linspace(0.0, 1.0, 90)
    hairpin = np.column_stack([400.0 + 300.0 * np.sin(1.5 * np.pi * t) - 250 * t, 300.0 + 380.0 * np.cos(np.pi * t)])
    lines = [hairpin, *(line + [900.0, 0.0] for line in tree().polylines())]
    network = wr.RiverNetwork.from_polylines(lines, [60.0, 20.0, 25.0, 40.0, 12.0, 60.0], 2.0)
    ground = plain_under(network, 2.0, slope=2e-3, margin=200.0)
    carved = carve(ground, network)
    height = carved.terrain.to_numpy()
    # A parabola's side rises by 4 d / w, of 12 m: 2/3; two of them may meet in a ridge.
    steepest = max(np.abs(np.diff(height, axis=axis)).max() / 2.0 for axis in (0, 1))
    assert steepest < 4.0 * 2.0 / 12.0 + 0.05
    level = carved.water.numpy()
    step = np.concatenate([np.abs(np.diff(level, axis=axis)).ravel() for axis in (0, 1)])
    # The plain falls by 4 mm a cell; where two limbs lie side by side their levels differ by some cells.
    assert np.nanmax(step) < 0.03


def test_a_ring_is_level():
    a = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    ring = np.column_stack([300.0 + 100.0 * np.cos(a), -150.0 + 100.0 * np.sin(a)])
    network = wr.RiverNetwork.from_polylines([ring], 20.0, 2.0, closed=True)
    ground = plane(tilt=0.01)
    carved = carve(ground, network, CarveParams(**LEVEL))
    level = carved.water.numpy()
    assert np.ptp(level[np.isfinite(level)]) < 1e-9
    depth = carved.depth.numpy()
    row, column = cells_of(network, carved.depth)
    assert np.abs(depth[row, column] / 2.0 - 1.0).max() < 0.05


def test_deposits_are_added_and_beds_carved_through_them():
    ground = plane()
    thickness = np.zeros(ground.shape)
    thickness[20:130] = 0.4
    carved = carve(ground, straight(), CarveParams(**LEVEL), deposits=ground.raster.like(thickness, unit="m"))
    np.testing.assert_allclose((carved.terrain.to_numpy() - ground.to_numpy())[21, 150], 0.4, atol=1e-12)
    weight = carved.materials["deposit"].numpy()
    assert weight[21, 150] == round(255 * 0.8) and weight[75, 150] == 0 and weight[5, 150] == 0
    assert carved.depth.numpy()[75, 150] == pytest.approx(DEPTH, rel=0.02)


def test_order_and_direction_of_arrays_cannot_be_seen_by_the_device(device):
    ground, network = hills(8.0).to(device), tree().to(device)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        first, again = carve(ground, network), carve(ground, network)
    assert first.terrain.digest() == again.terrain.digest()
    np.testing.assert_array_equal(first.water.numpy(), again.water.numpy())


# ---- lakes


def run_with_loop(age, years_after=0.0):
    """A history of a straight river with one loop that was cut off so many years before its end."""
    network = straight()
    history = wr.Simulation(network, plain_params(), threads=1, device="cpu").run(steps=2, record_every=1)
    a = np.linspace(0.0, np.pi, 60)
    loop = np.column_stack([300.0 + 110.0 * np.cos(a[::-1]), -95.0 + 85.0 * np.sin(a)])
    end = float(history.times[-1])
    history.events.append(Cutoff(end - age, 0, 20.0, loop))
    return network, history, loop


def test_an_oxbow_lake_is_level_between_its_plugs_and_fills_with_age():
    ground = plane()
    depths = []
    # Negative ages are of loops that go on being cut off after the last record: none lies on them.
    for age in (0.0, 50.0):
        network, history, loop = run_with_loop(age)
        carved = carve(ground, network, CarveParams(**LEVEL), history=history)
        rows, columns = ((-loop[:, 1]) // CELL).astype(int), (loop[:, 0] // CELL).astype(int)
        level, depth = carved.water.numpy()[rows, columns], carved.depth.numpy()[rows, columns]
        away = np.abs(np.arange(60) - 29.5) < 15
        assert carved.report.lakes == 1
        assert np.ptp(level[away]) < 1e-9
        assert (level[away] <= ground.to_numpy()[rows, columns][away] + 1e-9).all()
        depths.append(np.median(depth[away]))
        # Plugs of two widths: 40 m of a loop 300 m long.
        assert np.isnan(level[:6]).all() and np.isnan(level[-6:]).all()
    assert depths[0] == pytest.approx(float(wr.hydraulic_geometry.bankfull_depth(20.0)), rel=0.05)
    assert depths[1] / depths[0] == pytest.approx(np.exp(-1.0), rel=0.05)


def test_old_lakes_are_gone():
    network, history, _ = run_with_loop(400.0)
    assert carve(plane(), network, CarveParams(**LEVEL), history=history).report.lakes == 0


# ---- what is refused


def test_tables_and_deposits_must_fit():
    ground, network = plane(), straight()
    with pytest.raises(ValueError, match=r"sections.row has 3 rows for 26 points"):
        carve(ground, network, sections=SectionTable([0.0, 1.0, 0.0], [0, 0, 0]))
    with pytest.raises(ValueError, match="row names 0 to 2; there are 1 forms"):
        SectionTable([0.0, 1.0, 0.0], [0, 2])
    with pytest.raises(ValueError, match="above 0 somewhere"):
        SectionTable([0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="deposits must be a Raster"):
        carve(ground, network, deposits=plane(cell=3.0).raster)
    with pytest.raises(ValueError, match="lie off the terrain"):
        carve(ground, straight(y=5000.0))
    elsewhere = wr.Terrain(ground.to_numpy(), CELL, crs="EPSG:32619")
    other = wr.RiverNetwork.from_polylines(network.polylines(), WIDTH, crs="EPSG:32620")
    with pytest.raises(ValueError, match="the terrain is in EPSG:32619, the channels in EPSG:32620"):
        carve(elsewhere, other)
    with pytest.raises(ValueError, match="max_cut"):
        CarveParams(max_cut=-1.0)


# ---- real terrains and scenes


@pytest.mark.parametrize("name", TERRAINS)
def test_real_terrains(name):
    data_folder("dem")
    ground, threshold = read(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        network = wr.extract_network(ground, min_drainage_area=threshold)
        assert_holds(carve(ground, network), ground)


SCENES = sorted((Path(__file__).resolve().parents[2] / "demos" / "scenes").glob("*.toml"))


@pytest.mark.parametrize("file", SCENES, ids=lambda file: file.stem)
def test_built_in_scenes(file):
    simulation = wr.scenes.read_scene(file).simulation(threads=1)
    history = simulation.run(steps=10, record_every=5)
    network = history.networks[-1]
    ground = simulation.terrain or plain_under(network, float(network.channel_width.max()) / 5.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        assert_holds(carve(ground, network, history=history), ground)
