"""Tests of what notebooks show."""

import base64
import io
import re
import subprocess
import sys

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver.thumbnail import GROUND, WATER, lines_picture, png_of, raster_picture


def image_of(data):
    return np.asarray(pytest.importorskip("PIL.Image").open(io.BytesIO(data)))


def test_png_holds_the_colours():
    pixels = np.random.default_rng(0).integers(0, 256, (13, 17, 3)).astype(np.uint8)
    np.testing.assert_array_equal(image_of(png_of(pixels)), pixels)


def test_lines_lie_where_they_belong():
    line = np.array([[1000.0, 2000.0], [3000.0, 2000.0], [3000.0, 3000.0]])
    picture = lines_picture([([line], [1.0], WATER)])
    rows, columns = picture.shape[:2]
    assert columns == 420 and 200 <= rows <= 230
    wet = (np.abs(picture.astype(int) - GROUND).sum(axis=2) > 60).nonzero()
    assert wet[0].max() - wet[0].min() == pytest.approx((columns - 12) / 2, abs=4)  # 1 km high, 2 km wide
    assert wet[1].max() - wet[1].min() == pytest.approx(columns - 12, abs=4)
    # North is up: along the lower edge the line is long, along the upper one there is its end.
    assert (wet[0] > rows - 10).sum() > 10 * (wet[0] < 10).sum() > 0
    # A later layer lies on top, and wide lines are wide.
    both = lines_picture([([line], [1.0], WATER), ([line], [300.0], (200, 0, 0))])
    assert (np.abs(both.astype(int) - (200, 0, 0)).sum(axis=2) < 10).sum() > 3 * len(wet[0])
    assert not (np.abs(both.astype(int) - WATER).sum(axis=2) < 10).any()


def test_ground_is_lit_from_the_north_west():
    y, x = np.mgrid[:80, :80]
    cone = 400.0 - np.hypot(x - 40.0, y - 40.0)
    tone = raster_picture(cone, 1.0, heights=True).sum(axis=2)
    assert tone[25, 25] > tone[40, 20] > tone[55, 55] and tone[25, 25] > tone[55, 25] > tone[55, 55]
    flat = raster_picture(np.full((5, 5), 3.0), 1.0, heights=True)
    assert np.ptp(flat, axis=(0, 1)).max() == 0
    gap = np.full((6, 6), np.nan)
    assert (raster_picture(gap, 1.0, heights=True) == 255).all()
    gap[2:, :] = 1.0
    picture = raster_picture(gap, 1.0, heights=False)
    assert (picture[:2] == 255).all() and (picture[2:] != 255).any()
    assert max(raster_picture(np.zeros((3000, 10)), 1.0, heights=True).shape) <= 420


def subjects():
    line = wr.generate.noisy_line(length=4000, spacing=50, amplitude=50, seed=0)
    network = wr.RiverNetwork.from_polylines([line], width=60.0, crs="EPSG:32619")
    terrain = wr.Terrain(np.add.outer(np.arange(30.0), np.arange(40.0)), 30.0)
    sim = wr.Simulation(network, plain_params())
    history = sim.run(steps=4, record_every=2)
    raster = terrain.raster.like(np.arange(1200).reshape(30, 40), name="<cells>")
    return {"RiverNetwork": network, "Terrain": terrain, "Raster": raster, "History": history}


def test_every_noun_shows_itself():
    for kind, subject in subjects().items():
        picture = image_of(subject._repr_png_())
        assert picture.ndim == 3 and picture.shape[2] == 3 and np.ptp(picture) > 50
        page = subject._repr_html_()
        inside = re.search(r'src="data:image/png;base64,([^"]+)"', page)[1]
        assert base64.b64decode(inside) == subject._repr_png_()
        assert f"<b>{kind}</b>" in page and "CRS" in page
    assert "&lt;cells&gt;" in subjects()["Raster"]._repr_html_()
    empty = wr.History(plain_params())
    assert empty._repr_png_() is None and "empty" in empty._repr_html_()


def test_no_library_of_pictures_is_needed():
    code = (
        "import sys; sys.modules['matplotlib'] = sys.modules['PIL'] = None\n"
        "import numpy as np, warpriver as wr\n"
        "assert wr.Terrain(np.eye(9), 1.0)._repr_html_()"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, timeout=120)
