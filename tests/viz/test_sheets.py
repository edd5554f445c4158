"""Tests of pictures on given axes, of pictures without a frame, of relief and of belts with few records."""

import types

import numpy as np
import pytest
from histories import History
from plain import plain_params

import warpriver as wr
from warpriver import hydrology
from warpriver.io.raster.placing import WORLD_FILES
from warpriver.viz import belt, relief

matplotlib = pytest.importorskip("matplotlib")
pytest.importorskip("PIL")

PLACE = (40.0, (500010.0, 4000050.0), "EPSG:32619")
SHAPE = (90, 130)


@pytest.fixture(scope="module")
def land():
    """Hills, the rivers on them, their flow, and a run of three records."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    noise = np.random.default_rng(1).normal(0.0, 1.0, SHAPE)
    terrain = wr.Terrain(400.0 + 30.0 * np.sin(0.07 * y) - 2.0 * x + noise, *PLACE)
    surface = hydrology.fill_depressions(terrain)
    network = wr.extract_network(terrain, min_drainage_area=5e5)
    sim = wr.Simulation(network, plain_params(spacing_in_widths=1.0))
    history = sim.run(steps=4, record_every=2)
    return types.SimpleNamespace(
        terrain=terrain,
        network=network,
        history=history,
        flow=hydrology.route(surface),
        valley=wr.synthetic_valley("S1"),
    )


def read(path):
    from PIL import Image

    return np.asarray(Image.open(path).convert("RGB")).astype(int)


DRAW = {
    "network": lambda d, **k: wr.viz.draw_network(d.network, terrain=d.terrain, **k),
    "belt": lambda d, **k: wr.viz.draw_belt(d.history, terrain=d.terrain, color="width", **k),
    "elevation": lambda d, **k: wr.viz.draw_elevation(d.terrain, **k),
    "drainage": lambda d, **k: wr.viz.draw_drainage(d.flow, **k),
    "ordered": lambda d, **k: wr.viz.draw_ordered_network(d.terrain, d.network, **k),
}


# ---- given axes


@pytest.mark.parametrize("name", DRAW)
def test_maps_on_given_axes(land, name):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), dpi=80)
    left, right = figure.subplots(1, 2)
    assert DRAW[name](land, ax=right, title="a map") is right
    assert figure.axes == [left, right], "no bars beside the axes that were given"
    assert left.get_xlim() == (0.0, 1.0) and not left.images
    west, south, east, north = land.terrain.bounds
    assert right.get_xlim()[0] <= west + 4000.0 and right.get_xlim()[1] >= east - 4000.0
    assert right.get_aspect() == 1.0 and right.get_title(loc="left") == "a map"
    figure.canvas.draw()
    if name in ("elevation", "drainage"):
        assert right.get_xlim() == (west, east) and right.get_ylim() == (south, north)


def test_what_needs_several_axes(land):
    from matplotlib.figure import Figure

    axes = Figure().subplots(1, 2)
    assert wr.viz.draw_before_after(land.history, ax=axes) is axes
    assert all(len(one.images) == 1 for one in axes)
    one = Figure().subplots()
    assert wr.viz.draw_valley(land.valley, ax=one) is one and one.images
    five = Figure().subplots(5, 1)
    assert wr.viz.draw_valley_sections(land.valley, ax=five, positions=(0.2, 0.4, 0.6, 0.8)) is five
    assert [bool(ax.lines) for ax in five] == [True] * 5
    with pytest.raises(ValueError, match=r"ax is an Axes; give a list or None"):
        wr.viz.draw_before_after(land.history, ax=one)
    with pytest.raises(ValueError, match=r"ax is str; give matplotlib axes"):
        wr.viz.draw_elevation(land.terrain, ax="here")
    for words in ({"size": (500, 400)}, {"frame": False}):
        with pytest.raises(ValueError, match=r"size= and frame= belong to a picture of its own"):
            wr.viz.draw_elevation(land.terrain, ax=one, **words)


# ---- without a frame


@pytest.mark.parametrize(("suffix", "name"), [(".jpg", "network"), *((".png", name) for name in DRAW)])
def test_a_map_without_a_frame_is_its_raster(land, tmp_path, name, suffix):
    """Large enough to look at, or of the size that was asked for."""
    rasterio = pytest.importorskip("rasterio")
    more = {} if name in ("elevation", "ordered") else {"size": (2 * SHAPE[1], 2 * SHAPE[0])}
    DRAW[name](land, path=tmp_path / f"a{suffix}", frame=False, **more)
    rows, columns = SHAPE
    picture = read(tmp_path / f"a{suffix}")
    fine = picture.shape[0] // rows
    assert picture.shape == (rows * fine, columns * fine, 3)
    assert fine == 2 if more else 1000 < columns * fine <= 3000
    with rasterio.open(tmp_path / f"a{suffix}") as file:
        np.testing.assert_allclose(file.bounds, land.terrain.bounds, atol=1e-6)
        assert file.crs.to_epsg() == 32619
    world = [float(line) for line in (tmp_path / f"a{WORLD_FILES[suffix]}").read_text().split()]
    np.testing.assert_allclose(world[:4], [40.0 / fine, 0.0, 0.0, -40.0 / fine])
    # Framed over it: nothing says any more where it lies.
    DRAW[name](land, path=tmp_path / f"a{suffix}")
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"a{suffix}"]


def test_every_cell_is_a_block_of_the_picture(tmp_path):
    height = np.add.outer(np.zeros(20), np.arange(30.0))
    height[7, 11] = 500.0
    wr.viz.draw_elevation(wr.Terrain(height, 10.0), tmp_path / "a.png", frame=False, size=(300, 200))
    blocks = read(tmp_path / "a.png").reshape(20, 10, 30, 10, 3)
    assert (np.ptp(blocks, axis=(1, 3)) == 0).all()
    peak = np.abs(blocks[:, 0, :, 0] - blocks[7, 0, 11, 0]).sum(axis=2)
    assert (peak == 0).sum() == 1, "the peak is at its cell, row 0 in the north"


def test_a_size_of_another_shape_is_refused(land, tmp_path):
    with pytest.raises(ValueError, match=r"without a frame both have one shape; give \(400, 277\), or leave size= out"):
        wr.viz.draw_network(land.network, tmp_path / "a.png", terrain=land.terrain, frame=False, size=(400, 300))
    window = (501000.0, 3997500.0, 502000.0, 3998000.0)
    wr.viz.draw_network(land.network, tmp_path / "a.png", frame=False, window=window, size=(400, 200))
    assert read(tmp_path / "a.png").shape == (200, 400, 3)


# ---- relief


def test_what_alternates_from_cell_to_cell_casts_no_shade():
    y, x = np.mgrid[:40, :50]
    plane = 200.0 - 0.4 * 30.0 * x - 0.3 * 30.0 * y
    window, shape = (300.0, 300.0, 1200.0, 900.0), (480, 720)
    smooth = relief.relief_picture(wr.Terrain(plane, 30.0), window, shape).shade
    for pattern in ((-1.0) ** (x + y), (-1.0) ** x, (-1.0) ** y):
        rough = relief.relief_picture(wr.Terrain(plane + 2.0 * pattern, 30.0), window, shape).shade
        np.testing.assert_allclose(rough, smooth, atol=2e-3)
    # A ridge is seen.
    ridge = relief.relief_picture(wr.Terrain(plane + 30.0 * (x == 20), 30.0), window, shape).shade
    assert np.ptp(ridge - smooth) > 0.2


# ---- belts with few records


def bend(amplitude):
    x = np.linspace(0.0, 4000.0, 161)
    return np.c_[x, amplitude * np.sin(np.pi * x / 4000.0) ** 2]


def run_of(*amplitudes):
    networks = [wr.RiverNetwork.from_polylines([bend(a)], 50.0) for a in amplitudes]
    return History(times=10.0 * np.arange(len(networks)), networks=networks, cutoffs=[])


@pytest.mark.parametrize("amplitudes", [(0.0, 60.0), (0.0, 280.0), (280.0, 0.0), (100.0, 250.0, 520.0)])
def test_the_ground_between_two_records_is_painted(amplitudes):
    painter = belt.BeltPainter(run_of(*amplitudes), (0.0, -50.0, 4000.0, 600.0), (130, 800))
    painter.advance(len(amplitudes) - 1)
    cover = painter.cover()
    low, high = min(amplitudes), max(amplitudes)
    bare = 0
    for column in range(100, 700, 20):
        x = (column + 0.5) * 5.0
        y = np.interp(x, *bend(1.0).T)
        rows = (600.0 - np.linspace(low * y, high * y, 200)) / 5.0
        bare += (cover.kind[rows.astype(int), column] == 0).sum()
    assert bare == 0
    # Ages run from one record to the next.
    if high - low > 200.0:
        middle = cover.left[int((600.0 - 0.5 * (low + high)) / 5.0), 400]
        assert 2.0 < middle < 10.0 * (len(amplitudes) - 1) - 2.0


def test_what_was_cut_off_is_not_swept():
    loop = np.concatenate([bend(0.0)[:70], [[1800.0, 900.0], [2000.0, 1400.0], [2200.0, 900.0]], bend(0.0)[90:]])
    networks = [wr.RiverNetwork.from_polylines([line], 50.0) for line in (loop, bend(0.0))]
    cut = History(times=np.array([0.0, 10.0]), networks=networks, cutoffs=[])
    painter = belt.BeltPainter(cut, (1400.0, -100.0, 2600.0, 1500.0), (160, 120))
    painter.advance(1)
    # Inside the loop.
    assert (painter.cover().kind[15:120, 50:70] == 0).mean() > 0.5


@pytest.mark.parametrize(("cell", "unit"), [(2.0, "m"), (40.0, "km")])
def test_maps_of_short_reaches_have_ticks_in_metres(cell, unit):
    terrain = wr.Terrain(np.linspace(0.0, 9.0, 1200).reshape(30, 40), cell)
    (axes, *_) = wr.viz.draw_elevation(terrain, size=(320, 400)).axes
    assert axes.get_xlabel() == f"easting, {unit}" and axes.get_ylabel() == f"northing, {unit}"
    axes.figure.canvas.draw()
    assert max(float(tick.get_text()) for tick in axes.get_xticklabels()) == pytest.approx(
        40 * cell / (1e3 if unit == "km" else 1), rel=0.3
    )
