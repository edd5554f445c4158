"""Pictures of eroded terrain: every cell in its place and colour, and a movie whose frames follow the snapshots."""

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import warpriver as wr
from warpriver.generate import erosion_plane
from warpriver.hydrology import drainage_area
from warpriver.viz import draw_drainage, draw_elevation, draw_ordered_network, erosion_movie

SIZE = {"size": (640, 520), "dpi": 60}


@pytest.fixture(scope="module")
def eroded():
    return wr.erode(erosion_plane((60, 80), 10.0), events=1500, seed=1, record_every=500)


def laid(figure):
    """The picture of cells on a map."""
    (image,) = figure.axes[0].get_images()
    return np.asarray(image.get_array()), image.get_extent()


def test_elevation_has_a_colour_for_every_cell_and_low_ground_is_dark(eroded, tmp_path):
    picture, extent = laid(draw_elevation(eroded, tmp_path / "a.png", title="rain", **SIZE))
    assert (tmp_path / "a.png").stat().st_size > 0
    assert picture.shape == (60, 80, 3) and extent == [0.0, 800.0, 0.0, 600.0]
    height, bright = eroded.to_numpy(), picture.mean(axis=2)
    assert bright[height < np.percentile(height, 5)].mean() < bright[height > np.percentile(height, 60)].mean() - 0.2


def test_cells_without_data_are_white():
    height = erosion_plane((30, 40)).to_numpy()
    height[5:9, 7:12] = np.nan
    picture, _ = laid(draw_elevation(wr.Terrain(height, 1.0), **SIZE))
    assert (picture[5:9, 7:12] == 1.0).all() and (picture[15] < 1.0).any()


def test_drainage_colours_the_cells_that_drain_enough_and_no_other(eroded, tmp_path):
    flow = eroded.flow()
    area = drainage_area(flow).numpy()
    picture, _ = laid(draw_drainage(flow, tmp_path / "d.png", min_drainage_area=3000.0, **SIZE))
    ground = (picture == picture[area < 3000.0][0]).all(axis=2)
    assert np.array_equal(~ground, area >= 3000.0) and (tmp_path / "d.png").stat().st_size > 0
    river = area >= 3000.0
    order = np.argsort(area[river])
    bright = picture[river].mean(axis=1)[order]
    assert (np.diff(bright) <= 1e-12).all(), "more water is darker"


def test_rivers_are_seen_where_cells_are_smaller_than_pixels():
    """One line of cells that drain all, on 900 cells across 300 pixels: no part of it is lost."""
    height = np.add.outer(np.arange(901.0)[::-1], 10.0 * np.abs(np.arange(901.0) - 450.0))
    flow = wr.hydrology.route(wr.Terrain(height, 1.0))
    picture, extent = laid(draw_drainage(flow, min_drainage_area=2000.0, size=(400, 400), dpi=60))
    assert picture.shape[0] < 460 and extent[2] <= -901.0 and extent[3] == 0.0
    river = (picture != picture[-1, 0]).any(axis=2)
    rows = np.flatnonzero(river.any(axis=1))
    assert len(rows) == rows[-1] - rows[0] + 1 > 0.9 * len(picture)


def test_channels_are_drawn_by_order(eroded, tmp_path):
    network = wr.extract_network(eroded, flow=eroded.flow(), min_drainage_area=3000.0, unroll=True)
    figure = draw_ordered_network(eroded, network, tmp_path / "n.png", title="orders", dpi=60)
    assert (tmp_path / "n.png").stat().st_size > 0
    west, east = figure.axes[0].get_xlim()
    assert west >= -5.0 and east <= 805.0, "the map ends where the terrain does"


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_movie_has_a_frame_for_each_snapshot(eroded, tmp_path, suffix):
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg")
    told = []
    path = tmp_path / f"m{suffix}"
    erosion_movie(
        eroded, path, size=(480, 400), dpi=60, hold=0.2, progress=lambda done, total: told.append((done, total))
    )
    assert path.stat().st_size > 0 and told == [(k, 4) for k in range(1, 5)]
    if suffix == ".gif":
        from PIL import Image

        with Image.open(path) as movie:
            assert movie.n_frames == 4
            frames = []
            for k in range(4):
                movie.seek(k)
                frames.append(np.asarray(movie.convert("RGB"), np.float64))
        # The network grows: each frame has more dark cells than the first.
        assert all(np.abs(frame - frames[0]).mean() > 0.5 for frame in frames[1:])


def test_bad_input(eroded, tmp_path):
    with pytest.raises(ValueError, match="no snapshots"):
        erosion_movie(wr.erode(erosion_plane((20, 20)), events=5), tmp_path / "m.gif")
    for options, words in (({"fps": 0.0}, "fps is 0"), ({"size": (481, 400)}, "even numbers")):
        with pytest.raises(ValueError, match=words):
            erosion_movie(eroded, tmp_path / "m.mp4", **options)
    with pytest.raises(ValueError, match="must end in"):
        erosion_movie(eroded, tmp_path / "m.avi")
    for area, words in ((-1.0, "min_drainage_area is -1"), (float("nan"), "is nan"), (1e9, "no cell drains")):
        with pytest.raises(ValueError, match=words):
            draw_drainage(eroded.flow(), min_drainage_area=area)
    assert not list(tmp_path.iterdir()), "nothing is left behind"
