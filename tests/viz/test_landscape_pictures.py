"""Pictures of landscapes: water where the channel is, sand on the inner side of bends, plants that grow over it."""

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver.landscape import GROUND, landscape_maps
from warpriver.viz.landscape import DEEP, LANDSCAPE_LAYERS, landscape_picture, layer_picture


@pytest.fixture(scope="module")
def history():
    line = wr.generate.noisy_line(length=5_000, spacing=50, amplitude=80, seed=1)
    return wr.Simulation(wr.RiverNetwork.from_polylines([line], width=90.0), plain_params(), threads=1).run(
        years=60, record_every=15
    )


@pytest.fixture(scope="module")
def maps(history):
    return landscape_maps(history, cell_size=15.0)


def brightness(pixels):
    return pixels.astype(float).mean(axis=-1)


def test_water_sand_and_woods_have_their_colours(maps):
    picture = landscape_picture(maps)
    assert picture.shape == (*maps.age.shape, 3) and picture.dtype == np.uint8
    deep = np.array([int(DEEP[k : k + 2], 16) for k in (1, 3, 5)])
    middle = np.abs(np.nan_to_num(maps.water.numpy(), nan=9.0)) < 0.1
    np.testing.assert_allclose(picture[middle].mean(axis=0), deep, atol=12)
    bar = maps.ground.numpy() == GROUND.index("point bar")
    fresh, old = (bar & (maps.age.numpy() < 3.0)), (bar & (maps.age.numpy() > 35.0))
    assert brightness(picture[fresh]).mean() > brightness(picture[old]).mean() + 40.0
    # Woods are green.
    assert (picture[old][:, 1].astype(int) > picture[old][:, 2]).mean() > 0.9


@pytest.mark.parametrize("layer", LANDSCAPE_LAYERS)
def test_each_map_is_drawn_on_its_ramp(maps, layer):
    picture, (low, high) = layer_picture(maps, layer)
    assert picture.shape == (*maps.age.shape, 3) and low < high
    assert np.nanmax(maps.rasters[layer].numpy()) >= high * 0.999 or layer in ("vegetation", "sand", "elevation_change")


def test_a_picture_is_its_window(history, tmp_path):
    wr.viz.draw_landscape(
        history, tmp_path / "a.png", frame=False, window=(0.0, -600.0, 2400.0, 600.0), size=(240, 120)
    )
    from PIL import Image

    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (240, 120)
    with pytest.raises(ValueError, match="layer is 'trees'"):
        wr.viz.draw_landscape(history, layer="trees")


def test_a_movie_and_a_look_of_landscapes(history, tmp_path):
    wr.viz.movie(history, tmp_path / "a.gif", look="landscape", every=6, size=(360, 240))
    from PIL import Image

    with Image.open(tmp_path / "a.gif") as image:
        assert image.size == (360, 240) and image.n_frames == len({*range(0, len(history) - 1, 6), len(history) - 1})
    with pytest.raises(ValueError, match="look"):
        wr.viz.movie(history, tmp_path / "a.gif", look="map")
