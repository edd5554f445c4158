import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from histories import History

pytest.importorskip("matplotlib")

from scipy.spatial import cKDTree

from warpriver.history import Cutoff
from warpriver.kernels import covers
from warpriver.landscape.maps import Landscape
from warpriver.network import RiverNetwork
from warpriver.raster import Raster
from warpriver.viz import bands, belt, draw_belt, draw_network, gl, maps, movie, render_scene, scene, sheet

WIDTH = 80.0
needs_gl = pytest.mark.gl


def sine(amplitude, shift=0.0, length=4000.0, wavelength=1300.0, spacing=20.0):
    x = np.arange(0.0, length + spacing, spacing)
    fade = np.minimum(1.0, np.minimum(x, length - x) / 400.0).clip(0.0, 1.0)
    return np.stack([x, amplitude * fade * np.sin(2.0 * np.pi * (x - shift) / wavelength)], axis=1)


def loop(x, y, radius=250.0):
    angle = np.linspace(1.35 * np.pi, -0.35 * np.pi, 60)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)


def make_history(records=8, offset=(0.0, 0.0)):
    times = 10.0 * np.arange(records)
    networks = [RiverNetwork.from_polylines([sine(30.0 * k, 12.0 * k) + offset], WIDTH) for k in range(records)]
    # In the north-east, away from all courses.
    lake = Cutoff(35.0, 0, WIDTH, loop(3000.0, 700.0) + offset)
    return History(times=times, networks=networks, cutoffs=[lake], stop_reason=None)


@pytest.fixture(scope="module")
def history():
    return make_history()


@pytest.fixture
def opengl():
    answer = gl.probe()
    if not answer.ok:
        pytest.skip(answer.message)


def read(path):
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def color(text):
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)])


def near(pixels, text, tolerance=6):
    return (np.abs(pixels - color(text)) <= tolerance).all(axis=-1)


def figure_pixels(figure):
    """The map's own pixels, and its metres per pixel."""
    figure.canvas.draw()
    page = np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)
    axes = figure.axes[0]
    box = axes.get_window_extent()
    rows = slice(round(page.shape[0] - box.y1), round(page.shape[0] - box.y0))
    pixels = page[rows, round(box.x0) : round(box.x1)]
    return pixels, (axes.get_xlim()[1] - axes.get_xlim()[0]) / pixels.shape[1]


def pixel_at(figure, xy):
    pixels, size = figure_pixels(figure)
    axes = figure.axes[0]
    return pixels[int((axes.get_ylim()[1] - xy[1]) / size), int((xy[0] - axes.get_xlim()[0]) / size)]


# ---- geometry


def test_banks_of_a_straight_channel_lie_half_a_width_to_either_side():
    xy = np.stack([np.linspace(0.0, 900.0, 10), np.zeros(10)], axis=1)
    width = np.linspace(40.0, 60.0, 10)
    left, right, joint = bands.bank_lines([xy], [width])
    np.testing.assert_allclose(left[:, 1], 0.5 * width)
    np.testing.assert_allclose(right[:, 1], -0.5 * width)
    assert joint.tolist() == [True, *[False] * 8, True]


@pytest.mark.parametrize(
    "line",
    [
        sine(300.0),
        # Tighter than the half width, with a corner and a reversal.
        np.array([[0, 0], [500, 0], [540, 60], [500, 120], [0, 120], [0, 400], [300, 420], [40, 500]], float),
        loop(0.0, 0.0, radius=45.0),
    ],
    ids=["sine", "corners", "tight loop"],
)
def test_a_filled_band_is_the_buffer_of_its_line(line):
    width = 100.0
    low, high = line.min(axis=0) - 100.0, line.max(axis=0) + 100.0
    window = (low[0], low[1], high[0], high[1])
    cell = 4.0
    shape = (int((high[1] - low[1]) / cell), int((high[0] - low[0]) / cell))
    window = (low[0], low[1], low[0] + cell * shape[1], low[1] + cell * shape[0])
    network = RiverNetwork.from_polylines([line], width)
    one = History(times=np.zeros(1), networks=[network], cutoffs=[])
    painter = belt.BeltPainter(one, window, shape)
    painter.advance(0)
    covered = painter.cover().kind > 0
    dense = np.concatenate([a + (b - a) * np.linspace(0, 1, 40)[:, None] for a, b in pairwise(line)])
    x = window[0] + cell * (np.arange(shape[1]) + 0.5)
    y = window[3] - cell * (np.arange(shape[0]) + 0.5)
    distance = cKDTree(dense).query(np.stack(np.meshgrid(x, y), axis=-1))[0]
    # A cell of rasterisation and the discs' 24 sides; mitres of bends below 52 degrees may stand out.
    assert covered[distance < 0.5 * width - 1.5 * cell].all()
    assert not covered[distance > 0.5 * width / 0.9 + 1.5 * cell].any()


def test_channels_are_outlined_one_by_one():
    lines = [sine(100.0), sine(50.0)[:40] + 2000.0]
    widths = [np.full(len(xy), 60.0) for xy in lines]
    together = bands.band_outlines(lines, widths)
    assert together[2][-1] == len(together[0]) == len(together[1])
    for c in range(2):
        vertices, codes, _ = bands.band_outlines(lines[c : c + 1], widths[c : c + 1])
        part = slice(together[2][c], together[2][c + 1])
        np.testing.assert_array_equal(together[1][part], codes)
        drawn = codes != 79  # the place of a closing vertex has no meaning
        np.testing.assert_allclose(together[0][part][drawn], vertices[drawn])


def test_refined_lines_pass_through_their_points_and_follow_a_circle():
    angle = np.linspace(0.0, 1.5 * np.pi, 40)
    circle = 500.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    lines, widths = bands.refine_lines(
        [circle, sine(0.0) + 9000.0], [np.full(40, 30.0), np.full(len(sine(0.0)), 30.0)], step=10.0
    )
    parts = (len(lines[0]) - 1) // 39
    assert parts > 1 and len(lines[0]) == 39 * parts + 1 == len(widths[0])
    np.testing.assert_allclose(lines[0][::parts], circle, atol=1e-9)
    # The first and last segment have a straight neighbour that is made up.
    np.testing.assert_allclose(np.hypot(*lines[0][parts:-parts].T), 500.0, rtol=1e-4)
    np.testing.assert_allclose(lines[1][:, 1], 9000.0)
    assert bands.refine_lines([circle], [np.full(40, 30.0)], step=1000.0)[0][0] is circle


# ---- network map


def test_network_map_shows_true_width_and_equal_axes(tmp_path):
    line = np.stack([np.linspace(5e5, 5e5 + 4000.0, 81), np.full(81, 4.1e6)], axis=1)
    network = RiverNetwork.from_polylines([line], 200.0)
    figure = draw_network(network, tmp_path / "map.png", size=(800, 600), dpi=80, flow_arrow=False)
    assert read(tmp_path / "map.png").shape == (600, 800, 3)
    pixels, size = figure_pixels(figure)
    axes = figure.axes[0]
    assert (axes.get_ylim()[1] - axes.get_ylim()[0]) / pixels.shape[0] == pytest.approx(size)
    column = pixels[:, pixels.shape[1] // 2]
    assert (near(column, maps.WATER) | near(column, maps.BANK, 40)).sum() * size == pytest.approx(200.0, abs=2.5 * size)
    assert axes.xaxis.get_major_formatter()(501000.0, 0) == "501"


@pytest.mark.parametrize("by", ["discharge", "width"])
def test_network_map_is_shaded_by_value(by, tmp_path):
    small, large = sine(0.0) + np.array((0.0, 800.0)), sine(0.0)
    network = RiverNetwork.from_polylines([small, large], [40.0, 400.0])
    figure = draw_network(network, color=by, size=(900, 600), dpi=80, flow_arrow=False)
    assert pixel_at(figure, (2000.0, 0.0)).sum() < pixel_at(figure, (2000.0, 800.0)).sum() - 150
    assert any(by in axes.get_title(loc="right") for axes in figure.axes)


def test_background_lies_with_row_0_in_the_north(tmp_path):
    network = RiverNetwork.from_polylines([sine(0.0)], 50.0)
    image = np.zeros((20, 20, 3), np.uint8)
    image[:10, :, 0], image[10:, :, 2] = 255, 255
    figure = draw_network(network, background=image, extent=(0.0, -1000.0, 4000.0, 1000.0))
    assert pixel_at(figure, (300.0, 900.0)).tolist() == [255, 0, 0]
    assert pixel_at(figure, (300.0, -900.0)).tolist() == [0, 0, 255]
    with pytest.raises(ValueError, match="together"):
        draw_network(network, background=image)
    grey = Raster(image[..., 0], 200.0, (0.0, 2000.0))
    figure = draw_network(network, background=grey, window=(0.0, -1000.0, 4000.0, 1000.0))
    assert pixel_at(figure, (300.0, 900.0)).tolist() == [255, 255, 255]
    assert pixel_at(figure, (300.0, -900.0)).tolist() == [0, 0, 0]
    with pytest.raises(ValueError, match="its own extent"):
        draw_network(network, background=grey, extent=grey.bounds)
    with pytest.raises(ValueError, match=r"the raster, .* lies beside the channels"):
        draw_network(network, background=Raster(image[..., 0], 1.0, (1e6, 0.0)))
    with pytest.raises(ValueError, match="shape"):
        draw_network(network, background=image[0, 0], extent=(0, 0, 1, 1), window=(0, -100, 900, 100))


def test_flow_arrow_points_downstream():
    line = sine(100.0)
    for xy, sign in ((line, 1.0), (line[::-1], -1.0)):
        axes = draw_network(RiverNetwork.from_polylines([xy], 50.0)).axes[0]
        (arrow,) = [text for text in axes.texts if text.get_text() == ""]
        assert sign * (arrow.xy[0] - arrow.xyann[0]) > 0.0
        assert cKDTree(line).query([arrow.xy, arrow.xyann])[0].min() > 25.0


def test_thousands_of_channels_are_drawn():
    lines = [sine(100.0, spacing=50.0) + np.array((5000.0 * (k % 40), 700.0 * (k // 40))) for k in range(1500)]
    figure = draw_network(RiverNetwork.from_polylines(lines, 50.0), size=(900, 600), dpi=80)
    pixels, _ = figure_pixels(figure)
    assert len(figure.axes[0].collections) == 2
    assert (pixels[..., 2] > pixels[..., 0] + 20).mean() > 0.05


def test_map_refuses_what_it_cannot_draw(tmp_path):
    network = RiverNetwork.from_polylines([sine(100.0)], 50.0)
    with pytest.raises(ValueError, match="water, discharge, width"):
        draw_network(network, color="depth")
    with pytest.raises(ValueError, match="shows nothing"):
        draw_network(network, window=(1e6, 0.0, 2e6, 10.0))
    # Inside the bounding box of a corner's two arms there is nothing: the picture is empty, whatever the colours.
    arms = [sine(0.0), sine(0.0)[:, ::-1]]
    corner = RiverNetwork.from_polylines(arms, 50.0)
    for by in ("water", "width"):
        empty = draw_network(corner, color=by, window=(2000.0, 2000.0, 3000.0, 3000.0), size=(300, 300), dpi=50)
        assert not empty.axes[0].collections
    with pytest.raises(ValueError, match="west < east"):
        draw_network(network, window=(10.0, 0.0, 0.0, 10.0))
    with pytest.raises(ValueError, match="too small"):
        draw_network(network, size=(90, 90))
    with pytest.raises(ValueError, match=r"must end in \.png"):
        draw_network(network, tmp_path / "map.bmp")
    with pytest.raises(OSError, match="does not exist"):
        draw_network(network, tmp_path / "nowhere" / "map.png")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(OSError, match="is a folder"):
        draw_network(network, tmp_path / "folder.png")
    assert os.listdir(tmp_path) == ["folder.png"]


def test_a_failed_write_keeps_the_old_file(tmp_path):
    target = tmp_path / "old.png"
    target.write_bytes(b"old")
    with pytest.raises(RuntimeError), sheet.replacing(target, (".png",)) as temporary:
        with open(temporary, "wb") as file:
            file.write(b"half")
        raise RuntimeError
    assert target.read_bytes() == b"old" and os.listdir(tmp_path) == ["old.png"]


@pytest.mark.parametrize("suffix", ["svg", "pdf", "jpg"])
def test_other_formats(suffix, tmp_path, history):
    draw_belt(history, tmp_path / f"belt.{suffix}", size=(500, 300), dpi=60)
    assert (tmp_path / f"belt.{suffix}").stat().st_size > 1000


def test_missing_matplotlib_says_what_to_install(monkeypatch, history):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    for draw in (lambda: draw_belt(history), lambda: draw_network(history.networks[0])):
        with pytest.raises(ImportError, match=r'pip install "warpriver\[viz\]"'):
            draw()


def test_import_is_light_and_pyplot_stays_out():
    code = (
        "import sys, numpy as np, warpriver.viz as viz\n"
        "assert not {'matplotlib', 'pyvista', 'vtk', 'PIL'} & set(sys.modules)\n"
        "from warpriver.network import RiverNetwork\n"
        "x = np.linspace(0, 900, 40)\n"
        "viz.draw_network(RiverNetwork.from_polylines([np.stack([x, x], 1)], 9.0))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).resolve().parents[2])


# ---- channel belt


def test_belt_shows_channel_deposits_and_lake_in_their_colours(history):
    figure = draw_belt(history, size=(1000, 700), dpi=100)
    lake, crest = history.cutoffs[0].xy, history.networks[-1].polylines()[0]
    crest = crest[np.argmax(crest[:, 1])]
    assert near(pixel_at(figure, crest), maps.WATER)
    age = (70.0 - 35.0) / 70.0
    expected = 255.0 * maps.color_ramp(belt.OXBOW_RAMP, age)
    np.testing.assert_allclose(pixel_at(figure, lake[len(lake) // 2]), expected, atol=25)
    # Behind the bend the deposits grow older: darker, and greener than sand.
    old = pixel_at(figure, (crest[0], -20.0))
    fresh = pixel_at(figure, (crest[0], crest[1] - 1.1 * WIDTH))
    assert fresh.sum() > old.sum() + 40
    np.testing.assert_allclose(pixel_at(figure, (200.0, 700.0)), color(maps.GROUND), atol=30)
    assert "1 cutoff" in " ".join(text.get_text() for text in figure.texts)


def test_belt_at_an_earlier_record(history):
    lake = history.cutoffs[0].xy[30]
    before = draw_belt(history, until=3, size=(700, 500), dpi=80)
    after = draw_belt(history, until=4, size=(700, 500), dpi=80)
    np.testing.assert_allclose(pixel_at(before, lake), color(maps.GROUND), atol=30)
    np.testing.assert_allclose(pixel_at(after, lake), color("#5c98b8"), atol=40)
    # The window and the scale of age are those of the whole history.
    assert (
        before.axes[0].get_xlim()
        == after.axes[0].get_xlim()
        == draw_belt(history, until=-1, size=(700, 500), dpi=80).axes[0].get_xlim()
    )


def test_later_courses_erase_older_lakes():
    later = make_history()
    later.cutoffs = [Cutoff(35.0, 0, WIDTH, sine(120.0, 48.0)[60:140])]
    painter = belt.BeltPainter(later, (0.0, -500.0, 4000.0, 500.0), (250, 1000))
    painter.advance(4)
    first = (painter.cover().kind == covers.OXBOW).sum()
    assert [len(seen) for *_, seen in painter.lakes(4)] in ([], [80])
    painter.advance(7)
    assert (painter.cover().kind == covers.OXBOW).sum() <= first


def test_painting_step_by_step_gives_the_same_picture_at_the_cost_of_one(history, monkeypatch):
    window, shape = (0.0, -600.0, 4000.0, 1200.0), (180, 400)
    led = []
    lead_to = Landscape.lead_to
    monkeypatch.setattr(Landscape, "lead_to", lambda self, k: (led.append((self.record, k)), lead_to(self, k)))
    steps = belt.BeltPainter(history, window, shape)
    for k in range(8):
        steps.advance(k)
    assert led == [(k - 1, k) for k in range(8)]
    once = belt.BeltPainter(history, window, shape)
    once.advance(7)
    np.testing.assert_array_equal(steps.picture(7), once.picture(7))
    # The lake of year 35 lies on the ground of the courses before, and shows.
    cover = once.cover()
    assert (cover.left[cover.kind == covers.OXBOW] == 35.0).all() and (cover.kind == covers.OXBOW).sum() > 100


def test_pages_that_share_a_painter_show_what_they_show_alone(history):
    alone, shared = (
        [belt.BeltSheet(history, size=size, dpi=60.0) for size in ((700, 500), (420, 330))] for _ in range(2)
    )
    belt.share_painter(shared, history)
    for one, other in zip(alone, shared, strict=True):
        for page in (one, other):
            page.turn_to(7)
        assert shared[0].painter is other.painter
        # The mottling of the ground is another one.
        apart = one.pixels()[:330, :420].astype(float) - other.pixels()[:330, :420]
        blocks = apart.reshape(33, 10, 42, 10, 3).mean(axis=(1, 3))
        assert np.abs(blocks).mean() < 4.0 and np.abs(np.median(blocks)) < 0.5


def test_belt_fits_long_rivers_and_crops(history):
    line = sine(3000.0, length=500e3, wavelength=12e3, spacing=150.0)
    networks = [RiverNetwork.from_polylines([line + np.array((0.0, 50.0 * k))], 300.0) for k in range(3)]
    long = History(times=np.arange(3.0), networks=networks, cutoffs=[])
    figure = draw_belt(long, dpi=60)
    width, height = figure.get_size_inches()
    assert 10.0 < width < 18.0 and 2.0 < height < 6.0
    upright = [RiverNetwork.from_polylines([line[:, ::-1]], 300.0) for _ in range(3)]
    figure = draw_belt(History(times=np.arange(3.0), networks=upright, cutoffs=[]), dpi=60)
    width, height = figure.get_size_inches()
    assert 4.0 < width < height < 16.0
    view = draw_belt(history, window=(1000.0, -300.0, 1800.0, 300.0), size=(600, 500), dpi=60).axes[0]
    assert view.get_xlim()[0] <= 1000.0 and view.get_xlim()[1] >= 1800.0
    assert view.get_xlim()[1] - view.get_xlim()[0] < 1600.0


def test_a_single_record_and_absolute_coordinates(tmp_path):
    far = make_history(1, offset=(512345.0, 5234567.0))
    far.cutoffs = []
    figure = draw_belt(far, title="", legend=False, size=(600, 300), dpi=60)
    assert near(pixel_at(figure, (512345.0 + 2000.0, 5234567.0)), maps.WATER, 12)
    assert len(figure.axes) == 1 and not any(text.get_text() for text in figure.texts)


def test_belt_refuses_records_that_are_not_there(history):
    with pytest.raises(ValueError, match="records 0 to 7"):
        draw_belt(history, until=8)
    with pytest.raises(ValueError, match="must be positive"):
        draw_belt(history, age_span=0.0)
    with pytest.raises(ValueError, match="holds no record"):
        draw_belt(History(times=np.zeros(0), networks=[], cutoffs=[]))


# ---- movies


def test_gif_has_one_frame_a_record(history, tmp_path):
    from PIL import Image

    seen = []
    size = (480, 300)
    movie(history, tmp_path / "belt.gif", fps=10, size=size, dpi=50, every=3, progress=lambda *a: seen.append(a))
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]
    with Image.open(tmp_path / "belt.gif") as image:
        assert image.size == size and image.n_frames == 4
        assert image.info["duration"] == 100
        image.seek(3)
        assert image.info["duration"] == 2000
        last = np.asarray(image.convert("RGB")).astype(int)
    figure = draw_belt(history, size=size, dpi=50)
    figure.canvas.draw()
    still = np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)
    assert np.abs(last - still).mean() < 4.0, "the last frame is the map, in 256 colours"


def test_mp4(history, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    movie(history, tmp_path / "belt.mp4", fps=8, size=(480, 300), dpi=50, hold=0.5)
    frames, _ = ffmpeg.count_frames_and_secs(str(tmp_path / "belt.mp4"))
    assert frames == 8 + 4
    assert next(ffmpeg.read_frames(str(tmp_path / "belt.mp4")))["source_size"] == (480, 300)


def test_movie_says_what_is_wrong(history, tmp_path, monkeypatch):
    target = tmp_path / "belt.mp4"
    for options, words in (
        ({"fps": 0}, "fps"),
        ({"every": 0}, "every"),
        ({"size": (401, 300)}, "even"),
    ):
        with pytest.raises(ValueError, match=words):
            movie(history, target, **{"size": (480, 300), "dpi": 50, **options})
    with pytest.raises(ValueError, match="shows nothing"):
        movie(history, tmp_path / "belt.gif", size=(480, 300), dpi=50, window=(1e7, 0, 2e7, 9))
    with pytest.raises(ValueError, match=r"\.gif, \.mp4"):
        movie(history, tmp_path / "belt.avi")
    with pytest.raises(OSError, match="does not exist"):
        movie(history, tmp_path / "nowhere" / "belt.gif")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ImportError, match=r"warpriver\[movie\]"):
        movie(history, target, size=(480, 300), dpi=50)
    assert os.listdir(tmp_path) == []


# ---- 3-D


def test_probe_survives_what_would_kill_this_process():
    packages = "libegl1 libgl1-mesa-dri"
    crash = gl.probe([sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"])
    assert not crash.ok and "crashed" in crash.message and "SIG" not in crash.message and packages in crash.message
    error = gl.probe([sys.executable, "-c", "raise SystemExit('no display')"])
    assert not error.ok and "no display" in error.message and packages in error.message
    silent = gl.probe([sys.executable, "-c", "pass"])
    assert not silent.ok, "status 0 alone is not a picture"
    slow = gl.probe([sys.executable, "-c", "import time; time.sleep(9)"], timeout=0.2)
    assert not slow.ok and "0.2 s" in slow.message
    missing = gl.probe(["/nowhere/python"])
    assert not missing.ok and "could not be started" in missing.message
    no_vtk = gl.probe([sys.executable, "-c", "raise ModuleNotFoundError(\"No module named 'vtk'\")"])
    assert not no_vtk.ok and "warpriver[viz]" in no_vtk.message


def test_probe_asks_once(monkeypatch, tmp_path):
    note = tmp_path / "asked"
    code = f"open({str(note)!r}, 'a').write('x'); print('drawn')"
    for _ in range(3):
        assert gl.probe((sys.executable, "-c", code)) == gl.Probe(True, "off-screen OpenGL works")
    assert note.read_text() == "x"


def test_environment_for_drawing_without_a_screen(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    assert gl.window_environment({}) == {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}
    assert gl.window_environment({"DISPLAY": ":0"}) == {}
    assert gl.window_environment({"VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow"}) == {}
    monkeypatch.setattr(sys, "platform", "win32")
    assert gl.window_environment({}) == {}


def test_scene_without_opengl_is_an_error_not_a_crash(history, tmp_path, monkeypatch):
    pytest.importorskip("pyvista")
    monkeypatch.setattr(gl, "SCRIPT", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(RuntimeError, match="libegl1 libgl1-mesa-dri"):
        render_scene(history, tmp_path / "scene.png")
    assert os.listdir(tmp_path) == []


def test_scene_refuses_what_it_cannot_draw(history, tmp_path, monkeypatch):
    target = tmp_path / "scene.png"
    with pytest.raises(ValueError, match="size"):
        render_scene(history, target, size=(3, 3))
    with pytest.raises(ValueError, match="exaggeration"):
        render_scene(history, target, exaggeration=-1.0)
    with pytest.raises(ValueError, match="camera"):
        render_scene(history, target, camera=[(0, 0, 1)])
    with pytest.raises(ValueError, match=r"must end in \.png, \.jpg"):
        render_scene(history, tmp_path / "scene.tif")
    with pytest.raises(OSError, match="does not exist"):
        render_scene(history, tmp_path / "nowhere" / "scene.png")
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r'pip install "warpriver\[viz\]"'):
        render_scene(history, target)


def test_ribbons_have_the_area_of_their_channels_and_face_up():
    lines = [sine(200.0), sine(0.0)[:30] + 900.0]
    widths = [np.full(len(xy), 60.0) for xy in lines]
    points, faces, owner = scene.ribbon_surface(lines, widths)
    quads = faces.reshape(-1, 5)
    assert (quads[:, 0] == 4).all() and quads[:, 1:].max() < len(points)
    corner = points[quads[:, 1:]]
    x, y = corner[..., 0], corner[..., 1]
    area = 0.5 * np.sum(x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y, axis=1)
    assert (area > 0.0).all()
    for c, xy in enumerate(lines):
        length = np.hypot(*np.diff(xy, axis=0).T).sum()
        assert area[owner == c].sum() == pytest.approx(60.0 * length, rel=2e-3)


def test_block_sides_close_around_the_ground():
    x, y = np.meshgrid(np.arange(5.0), np.arange(4.0))
    points, faces = scene.block_sides(x, y, np.zeros_like(x), 2.0)
    assert len(points) == 2 * 14 and len(faces) == 5 * 14
    assert set(points[14:, 2]) == {-2.0}
    steps = np.diff(np.vstack([points[:14], points[:1]]), axis=0)
    np.testing.assert_allclose(np.hypot(steps[:, 0], steps[:, 1]), 1.0)


def test_view_fits_all_corners():
    corners = np.array([[x, y, 0.0] for x in (-9.0, 9.0) for y in (-2.0, 2.0)])
    corners += (100.0, 50.0, 0.0)
    direction = np.array([0.3, -0.7, 0.65])
    direction /= np.linalg.norm(direction)
    focus, distance = scene.fit_view(corners, direction, np.radians(25.0), 1.6)
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    depth = distance - (corners - focus) @ direction
    screen = np.stack([(corners - focus) @ right / 1.6, (corners - focus) @ up], axis=1)
    reach = np.abs(screen / depth[:, None]).max() / np.tan(np.radians(12.5))
    assert 0.85 < reach <= 1.0


def test_runs_of_true_values():
    mask = np.array([1, 1, 0, 1, 0, 0, 1, 1, 1], bool)
    assert scene.runs(mask) == [slice(0, 2), slice(6, 9)]


@needs_gl
def test_scene_of_a_network_has_north_up(opengl, tmp_path):
    # A channel in the north-east, seen from straight above.
    line = np.stack([np.linspace(2500.0, 3800.0, 60), np.full(60, 1500.0)], axis=1)
    line += (5e5, 4e6)
    network = RiverNetwork.from_polylines([line], 150.0)
    camera = ((5e5 + 2000.0, 4e6 + 1000.0, 9000.0), (5e5 + 2000.0, 4e6 + 1000.0, 0.0), (0.0, 1.0, 0.0))
    window = (5e5, 4e6, 5e5 + 4000.0, 4e6 + 2000.0)
    render_scene(network, tmp_path / "a.png", size=(320, 200), camera=camera, window=window)
    pixels = read(tmp_path / "a.png")
    assert pixels.shape == (200, 320, 3)
    row, column = np.nonzero(pixels[40:160, 60:260, 2] > pixels[40:160, 60:260, 0] + 40)
    assert len(row) > 100
    assert row.mean() + 40 < 90 and column.mean() + 60 > 190


@needs_gl
def test_scene_of_a_history_carries_belt_and_lakes(opengl, tmp_path):
    subject = make_history()
    camera = ((2000.0, 200.0, 12000.0), (2000.0, 200.0, 0.0), (0.0, 1.0, 0.0))
    render_scene(subject, tmp_path / "belt.png", size=(480, 300), camera=camera)
    pixels = read(tmp_path / "belt.png")
    # 12 km above, 30 degrees of view: metres per pixel.
    size = 2.0 * 12000.0 * np.tan(np.radians(15.0)) / 300.0

    def at(x, y):
        column, row = 240 + (x - 2000.0) / size, 150 - (y - 200.0) / size
        return pixels[int(row) - 1 : int(row) + 2, int(column) - 1 : int(column) + 2].mean(axis=(0, 1))

    ground, lake, channel = at(300.0, 800.0), at(3000.0, 950.0), at(*subject.networks[-1].polylines()[0][40])
    assert abs(ground[0] - ground[2]) < 45
    assert lake[1] - lake[0] > 10 and channel[2] - channel[0] > 40
    subject.networks = subject.networks[:1]
    subject.times, subject.cutoffs = subject.times[:1], []
    render_scene(subject, tmp_path / "belt.png", size=(320, 200), exaggeration=0.0)
    assert np.ptp(read(tmp_path / "belt.png"), axis=(0, 1)).min() > 60
