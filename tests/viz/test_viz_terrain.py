import numpy as np
import pytest
from histories import History

pytest.importorskip("matplotlib")

from warpriver.history import Collision
from warpriver.kernels import covers
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain
from warpriver.viz import (
    belt,
    draw_before_after,
    draw_belt,
    draw_network,
    gl,
    hillshade,
    maps,
    movie,
    relief,
    render_scene,
    scene,
    sheet,
    surface,
)

SIZE = {"size": (520, 400), "dpi": 60}


def plane(east=0.0, north=0.0, shape=(40, 60), cell=50.0, origin=(0.0, 2000.0), **more):
    """Heights that rise by these slopes."""
    x = np.arange(shape[1]) * cell
    y = -np.arange(shape[0])[:, None] * cell
    return Terrain(100.0 + east * x + north * y, cell, origin, **more)


def hills(shape=(60, 90), cell=50.0, origin=(0.0, 3000.0), height=120.0):
    row, column = np.mgrid[: shape[0], : shape[1]]
    return Terrain(height * (np.sin(0.35 * row) + np.cos(0.27 * column)), cell, origin)


def line(x, y, count=60):
    return np.stack([np.linspace(*x, count), np.linspace(*y, count)], axis=1)


def tree(width=(60.0, 40.0, 90.0)):
    lines = [line((500, 2000), (2500, 1500)), line((500, 2000), (500, 1500)), line((2000, 4000), (1500, 1500))]
    return RiverNetwork.from_polylines(lines, width, drainage_area=[2e6, 1e6, 4e6])


def make_history(collide=True):
    networks = [tree(), tree()]
    course = line((2500, 3500), (2600, 2200))
    event = Collision(5.0, "downstream", 1, 2, 120.0, course, np.array([0, 30, 60]))
    return History(
        times=np.array([0.0, 10.0]), networks=networks, cutoffs=[], collisions=[event] if collide else [], crs=None
    )


def pixels_of(figure, panel=0):
    figure.canvas.draw()
    page = np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)
    box = figure.axes[panel].get_window_extent()
    rows = slice(round(page.shape[0] - box.y1), round(page.shape[0] - box.y0))
    return page[rows, round(box.x0) : round(box.x1)]


def pixel_at(figure, xy, panel=0):
    pixels, axes = pixels_of(figure, panel), figure.axes[panel]
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    row = int((north - xy[1]) / (north - south) * pixels.shape[0])
    return pixels[row, int((xy[0] - west) / (east - west) * pixels.shape[1])]


def rgb(text):
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)])


@pytest.fixture
def opengl():
    answer = gl.probe()
    if not answer.ok:
        pytest.skip(answer.message)


# ---- hillshade


@pytest.mark.parametrize("azimuth", [0.0, 90.0, 200.0, 315.0])
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.4, 0.0), (-0.2, 0.3)])
def test_hillshade_of_a_plane_is_the_cosine_to_the_light(azimuth, slope):
    shade = hillshade(plane(*slope), azimuth, 40.0, exaggeration=2.0)
    normal = np.array([-2.0 * slope[0], -2.0 * slope[1], 1.0])
    turn, rise = np.radians(azimuth), np.radians(40.0)
    light = np.array([np.sin(turn) * np.cos(rise), np.cos(turn) * np.cos(rise), np.sin(rise)])
    np.testing.assert_allclose(shade, max(0.0, normal @ light / np.linalg.norm(normal)), atol=1e-12)


def test_ground_that_faces_the_north_west_is_bright():
    west, east = hillshade(plane(east=0.3)), hillshade(plane(east=-0.3))
    assert west.mean() > np.sin(np.radians(45.0)) > east.mean()
    cells = hills().to_numpy()
    shade = hillshade(hills(), exaggeration=1.0)
    assert shade.shape == cells.shape and 0.0 <= shade.min() < shade.max() <= 1.0


def test_hillshade_leaves_gaps_and_their_neighbours_sound():
    height = plane(0.2, 0.1).to_numpy()
    height[10:20, 10:30] = np.nan
    height[15, 20] = 7.0  # an island of one cell, which has no slope
    ground = Terrain(height, 50.0, (0.0, 2000.0))
    shade, whole = hillshade(ground, exaggeration=1.0), hillshade(plane(0.2, 0.1), exaggeration=1.0)
    np.testing.assert_array_equal(np.isnan(shade), np.isnan(height))
    known = ~np.isnan(height)
    known[15, 20] = False
    np.testing.assert_allclose(shade[known], whole[known])
    assert shade[15, 20] == pytest.approx(np.sin(np.radians(45.0)))


def test_flat_land_is_exaggerated_and_mountains_are_not():
    faint = hillshade(hills(height=2.0))
    assert np.ptp(faint) > 4.0 * np.ptp(hillshade(hills(height=2.0), exaggeration=1.0))
    np.testing.assert_allclose(hillshade(hills(height=900.0)), hillshade(hills(height=900.0), exaggeration=1.0))
    assert np.ptp(hillshade(plane())) == 0.0
    for options in ({"altitude": 0.0}, {"altitude": 91.0}, {"azimuth": np.nan}, {"exaggeration": 0.0}):
        with pytest.raises(ValueError, match="give"):
            hillshade(plane(), **options)


# ---- relief


@pytest.mark.parametrize("shape", [(17, 23), (40, 60), (230, 310)], ids=["coarser", "same", "finer"])
def test_heights_of_a_window_are_those_of_the_plane(shape):
    ground = plane(0.1, -0.2)
    window = (310.0, 270.0, 2540.0, 1710.0)
    height, known = relief.height_grid(ground, window, shape)
    x = window[0] + (window[2] - window[0]) * (np.arange(shape[1]) + 0.5) / shape[1]
    y = window[3] - (window[3] - window[1]) * (np.arange(shape[0]) + 0.5) / shape[0]
    expected = ground.sample(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(shape)
    assert known.all()
    np.testing.assert_allclose(height, expected, atol=5e-3)


def test_means_of_a_coarse_window_keep_the_plane_and_gaps():
    height = plane(0.1, 0.0, shape=(200, 300)).to_numpy()
    height[:, :100] = np.nan
    ground = Terrain(height, 50.0, (0.0, 10_000.0))
    coarse, known = relief.height_grid(ground, (0.0, 0.0, 15_000.0, 10_000.0), (20, 30))
    assert not known[:, :9].any() and known[:, 11:].all()
    x = 500.0 * (np.arange(30) + 0.5)
    np.testing.assert_allclose(
        coarse[:, 12:-1], np.broadcast_to(100.0 + 0.1 * (x - 25.0), (20, 30))[:, 12:-1], atol=1.0
    )
    off, known = relief.height_grid(ground, (-9e5, -9e5, -8e5, -8e5), (8, 8))
    assert not known.any() and np.isfinite(off).all()


def test_relief_is_darker_in_the_shade_and_paler_on_high_ground():
    ground = hills()
    picture = relief.relief_picture(ground, ground.bounds, (120, 180))
    assert picture.color.shape == (120, 180, 3) and picture.known.all()
    light = picture.color.mean(axis=2)
    assert light[picture.shade < 0.7].mean() < light[picture.shade > 1.0].mean() - 40.0
    level = relief.relief_picture(plane(), plane().bounds, (20, 30))
    np.testing.assert_allclose(level.shade, 1.0, atol=1e-6)
    assert np.ptp(level.color, axis=(0, 1)).max() == 0.0


# ---- network on a terrain


def test_network_lies_on_its_relief(tmp_path):
    height = hills().to_numpy()
    height[:20, 60:] = np.nan
    ground = Terrain(height, 50.0, (0.0, 3000.0))
    figure = draw_network(tree(), tmp_path / "map.png", terrain=ground, flow_arrow=False, **SIZE)
    assert (tmp_path / "map.png").stat().st_size > 5000
    np.testing.assert_allclose(pixel_at(figure, (3000.0, 1500.0)), rgb(maps.RELIEF_RAMP[1][1]), atol=12)
    np.testing.assert_allclose(pixel_at(figure, (3800.0, 2450.0)), rgb(sheet.GROUND), atol=3)
    inner = pixels_of(figure)[40:-40, 40:200]
    assert inner.mean(axis=2).std() > 10.0
    west, south, east, north = ground.bounds
    x, y = figure.axes[0].get_xlim(), figure.axes[0].get_ylim()
    assert x[1] - x[0] <= 1.3 * (east - west) and y[1] - y[0] <= 1.3 * (north - south)


@pytest.mark.parametrize("by", ["discharge", "width", "area", "order"])
def test_each_value_has_its_colours_and_bar(by):
    figure = draw_network(tree(), terrain=hills(), color=by, order=[1, 1, 2], flow_arrow=False, **SIZE)
    main, side = pixel_at(figure, (3000.0, 1500.0)), pixel_at(figure, (800.0, 700.0))
    assert main.sum() < side.sum() - 60
    words = " ".join(axes.get_title(loc="right") for axes in figure.axes)
    assert by in words
    if by == "order":
        (bar,) = [axes for axes in figure.axes if by in axes.get_title(loc="right")]
        assert [label.get_text() for label in bar.get_xticklabels() if label.get_text()] == ["1", "2"]


def test_orders_of_one_number_and_many_are_drawn():
    for order in ([3, 3, 3], [1, 7, 30]):
        figure = draw_network(tree(), color="order", order=order, **SIZE)
        assert figure.axes[0].collections


def test_a_brook_on_a_wide_map_is_seen():
    brook = RiverNetwork.from_polylines([line((2000, 28_000), (15_000, 15_000), 400)], 5.0)
    figure = draw_network(brook, window=(0.0, 0.0, 30_000.0, 30_000.0), flow_arrow=False, size=(900, 900), dpi=100)
    column = pixels_of(figure)[:, 400]
    ground = rgb(sheet.GROUND)
    assert np.abs(column - ground).sum(axis=1).max() > 90
    # Far wider than 5 m, but still a thin line.
    assert 1 <= (np.abs(column - ground).sum(axis=1) > 40).sum() <= 3


def test_least_lines_grow_with_width():
    least = maps._least_lines(np.array([2.0, 6.0, 50.0]))
    assert least[0] == maps.MIN_LINE and (np.diff(least) > 0.0).all()
    assert (maps._least_lines(np.full(3, 8.0)) == maps.MIN_LINE).all()


def test_lines_are_thinned_but_keep_their_ends():
    xy = line((0, 1000), (0, 0), 1001)
    thin = maps._thin_out(xy, 10.0)
    assert 95 < len(thin) < 110
    np.testing.assert_array_equal(thin[[0, -1]], xy[[0, -1]])
    assert maps._thin_out(xy, 0.5) is xy


def test_what_cannot_be_drawn_on_a_terrain_is_named():
    network = tree()
    with pytest.raises(ValueError, match="order= is missing"):
        draw_network(network, color="order")
    with pytest.raises(ValueError, match="each of the 3 channels"):
        draw_network(network, color="order", order=[1, 2])
    bare = RiverNetwork.from_polylines([line((0, 900), (0, 0))], 20.0)
    with pytest.raises(ValueError, match="drainage area is not known"):
        draw_network(bare, color="area")
    with pytest.raises(ValueError, match="not both"):
        draw_network(network, terrain=hills(), background=np.zeros((4, 4)), extent=(0, 0, 4000, 3000))
    far = hills(origin=(9e5, 9e5))
    for draw in (draw_network, draw_belt, draw_before_after):
        with pytest.raises(ValueError, match="lies beside the channels"):
            draw(network if draw is draw_network else make_history(), terrain=far)
    away = plane(crs="EPSG:32611")
    other = RiverNetwork.from_polylines([line((0, 900), (500, 500))], 20.0, crs="EPSG:32612")
    with pytest.raises(ValueError, match="to_crs"):
        draw_network(other, terrain=away)


# ---- belt on a terrain


def test_belt_lies_on_the_relief_and_dry_courses_are_brown():
    subject = make_history()
    figure = draw_belt(subject, terrain=hills(), age_span=10.0, **SIZE)
    dry = 255.0 * sheet.color_ramp(belt.DRY_RAMP, 0.5)
    figure_plain = draw_belt(subject, age_span=10.0, **SIZE)
    spot = subject.collisions[0].xy[15]
    np.testing.assert_allclose(pixel_at(figure_plain, spot), dry, atol=20)
    red, green, blue = pixel_at(figure, spot)
    assert red > green + 8 > blue + 20
    before = draw_belt(subject, until=0, **SIZE)
    np.testing.assert_allclose(pixel_at(before, spot), rgb(sheet.GROUND), atol=20)
    assert pixels_of(figure)[10:60].mean(axis=2).std() > 1.5 * pixels_of(figure_plain)[10:60].mean(axis=2).std()
    labels = [label.get_text() for axes in figure.axes for label in axes.get_yticklabels()]
    assert "dry courses" in labels
    assert "1 collision" in " ".join(text.get_text() for text in figure.texts)
    without = draw_belt(make_history(collide=False), **SIZE)
    assert "dry courses" not in [label.get_text() for axes in without.axes for label in axes.get_yticklabels()]


@pytest.mark.parametrize("color", ["discharge", "width", "area", "order"])
def test_channels_of_a_belt_are_coloured_by_value(color):
    """Those with most water are darkest, whatever stands for it, and a bar says what it is where there is room."""
    figure = draw_belt(make_history(collide=False), color=color, size=(840, 540), dpi=60)
    small, trunk = pixel_at(figure, (1250.0, 1000.0)), pixel_at(figure, (3000.0, 1500.0))
    np.testing.assert_allclose(trunk, rgb(maps.FLOW_RAMP[-1][1]), atol=12)
    np.testing.assert_allclose(small, rgb(maps.FLOW_RAMP[0][1]), atol=12)
    assert maps.VALUE_LABELS[color] in [axes.get_title(loc="right") for axes in figure.axes]
    narrow = draw_belt(make_history(collide=False), color=color, size=(240, 240), dpi=60)
    assert maps.VALUE_LABELS[color] not in [axes.get_title(loc="right") for axes in narrow.axes]


def test_before_and_after_may_be_coloured_and_unknown_values_are_refused():
    figure = draw_before_after(make_history(), color="order", terrain=hills(), size=(1600, 700), dpi=100)
    assert "stream order" in [axes.get_title(loc="right") for axes in figure.axes]
    with pytest.raises(ValueError, match="color is 'depth'; use one of water"):
        draw_belt(make_history(), color="depth", **SIZE)


def test_the_gap_between_pieces_of_a_dry_course_stays_bare():
    subject = make_history()
    course = subject.collisions[0].xy.copy()
    course[30:] += (0.0, -900.0)
    subject.collisions = [Collision(5.0, "upstream", 0, 1, 60.0, course, np.array([0, 30, 60]))]
    painter = belt.BeltPainter(subject, (0.0, 0.0, 4500.0, 3000.0), (300, 450))
    painter.advance(1)
    row, column = ((3000.0 - course[:, 1]) / 10.0).astype(int), (course[:, 0] / 10.0).astype(int)
    cover = painter.cover().kind
    hit = cover[row, column] == covers.ABANDONED
    assert hit[1:29].all() and hit[40:59].any()
    middle = 0.5 * (course[29] + course[30])
    assert cover[int((3000.0 - middle[1]) / 10.0), int(middle[0] / 10.0)] != covers.ABANDONED


def test_movie_frames_carry_the_relief(tmp_path):
    from PIL import Image

    movie(make_history(), tmp_path / "belt.gif", terrain=hills(), **SIZE)
    with Image.open(tmp_path / "belt.gif") as image:
        assert image.n_frames == 2
        frame = np.asarray(image.convert("L")).astype(float)
    assert frame[40:90, 60:400].std() > 8.0


@pytest.mark.parametrize("wide", [True, False])
def test_before_and_after_share_one_extent(tmp_path, wide):
    subject = make_history()
    if not wide:
        subject.networks = [RiverNetwork.from_polylines([xy[:, ::-1] for xy in tree().polylines()], 60.0)] * 2
    figure = draw_before_after(
        subject, tmp_path / "two.png", terrain=hills((100, 100), origin=(-200.0, 4800.0)), dpi=60
    )
    first, second = figure.axes[:2]
    assert first.get_xlim() == second.get_xlim() and first.get_ylim() == second.get_ylim()
    a, b = first.get_window_extent(), second.get_window_extent()
    assert (a.width, a.height) == pytest.approx((b.width, b.height))
    assert a.y0 > b.y1 if wide and a.width > 1.6 * a.height else a.x1 < b.x0
    assert first.texts[0].get_text() == "year 0.0" and "1 collision" in second.texts[0].get_text()
    if wide:
        spot = subject.collisions[0].xy[15]
        assert np.abs(pixel_at(figure, spot, 0) - pixel_at(figure, spot, 1)).sum() > 30


def test_before_and_after_fill_the_size_asked_for(tmp_path):
    from PIL import Image

    draw_before_after(make_history(), tmp_path / "two.png", size=(801, 507), dpi=50)
    with Image.open(tmp_path / "two.png") as image:
        assert image.size == (801, 507)
    with pytest.raises(ValueError, match="too small"):
        draw_before_after(make_history(), size=(120, 90), dpi=50)


# ---- 3-D


def test_surface_holds_heights_and_is_level_across_channels():
    ground = plane(0.0, 0.3, shape=(60, 90), origin=(0.0, 3000.0))
    network = RiverNetwork.from_polylines([line((200, 4200), (1500, 1500), 100)], 400.0)
    surfaced = surface.TerrainGround((0.0, 0.0, 4500.0, 3000.0), network, ground, 2.0)
    x, y, z = surfaced.grid()
    assert z.shape == (len(y), len(x)) and z.size <= 1.05 * surface.MAX_CELLS
    assert z.min() == 0.0 and z[-1].mean() > z[0].mean()
    # Two metres of drawing for one of height: 0.3 * 2 * 1000 m apart.
    ends = surfaced.height(np.array([[3000.0, 600.0], [3000.0, 2600.0]]))
    assert np.diff(ends)[0] == pytest.approx(2.0 * 0.3 * 2000.0, rel=0.01)
    across = surfaced.height(np.column_stack([np.full(9, 2000.0), np.linspace(1320.0, 1680.0, 9)]))
    assert np.ptp(across) < 1.0


def test_huge_terrain_is_drawn_with_a_million_cells_and_gaps_are_filled():
    height = np.add.outer(np.arange(1500.0), np.arange(1600.0))
    height[:, :300] = np.nan
    ground = Terrain(height, 10.0, (0.0, 15_000.0))
    network = RiverNetwork.from_polylines([line((5000, 12_000), (7000, 7000))], 20.0)
    surfaced = surface.TerrainGround(ground.bounds, network, ground, None)
    _, _, z = surfaced.grid()
    assert z.size <= surface.MAX_CELLS and np.isfinite(z).all()
    assert 1.0 <= surfaced.exaggeration <= 8.0


def test_windows_are_clipped_to_the_terrain():
    assert surface.clip_window((0.0, 0.0, 9.0, 9.0), (1.0, -5.0, 7.0, 5.0)) == (1.0, 0.0, 7.0, 5.0)
    with pytest.raises(ValueError, match="only touch"):
        surface.clip_window((0.0, 0.0, 9.0, 9.0), (9.0, 0.0, 12.0, 9.0))


@pytest.mark.gl
def test_scene_on_a_terrain_shows_the_channel_where_it_is(opengl, tmp_path, monkeypatch):
    from PIL import Image

    monkeypatch.setattr(scene, "TEXTURE_PIXELS", 512)
    monkeypatch.setattr(surface, "REFINED_CELLS", 20_000)

    ground = hills()
    network = RiverNetwork.from_polylines([line((2500, 4200), (2200, 2200))], 150.0)
    camera = ((2250.0, 1500.0, 9000.0), (2250.0, 1500.0, 0.0), (0.0, 1.0, 0.0))
    render_scene(network, tmp_path / "a.png", terrain=ground, size=(320, 200), camera=camera, window=ground.bounds)
    with Image.open(tmp_path / "a.png") as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    row, column = np.nonzero(pixels[50:150, 90:230, 2] > pixels[50:150, 90:230, 0] + 50)
    assert len(row) > 60
    assert row.mean() + 50 < 95 and column.mean() + 90 > 165
    render_scene(make_history(), tmp_path / "b.png", terrain=ground, size=(200, 120))
    with Image.open(tmp_path / "b.png") as image:
        assert np.ptp(np.asarray(image.convert("L"))) > 100
