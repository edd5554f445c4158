"""``render_riverscape``: a block of a riverscape in the colours of its shading."""

import numpy as np
import pytest

import warpriver as wr


@pytest.fixture(scope="module")
def scene():
    made = wr.riverscape.example("C")
    return wr.Riverscape(made.terrain, made.courses, rocks=made.rocks)


def test_a_block_is_drawn_with_water_in_it(scene, tmp_path):
    pytest.importorskip("pyvista")
    answer = wr.viz.gl.probe()
    if not answer.ok:
        pytest.skip(answer.message)
    from PIL import Image

    wr.viz.render_riverscape(scene, tmp_path / "a.png", bounds=(8.0, 0.0, 20.0, 12.0), cell_size=0.2, size=(200, 140))
    pixels = np.asarray(Image.open(tmp_path / "a.png")).astype(float)
    assert pixels.shape == (140, 200, 3)
    # Grass is greener than blue, the water is grey, and the sky bluer.
    excess = pixels[..., 1] - pixels[..., 2]
    assert (excess > 25.0).mean() > 0.2
    assert ((np.abs(excess) < 12.0) & (pixels.mean(axis=2) < 190.0)).mean() > 0.02


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"size": (4, 4)}, "size is"),
        ({"exaggeration": -1.0}, "exaggeration is"),
        ({"camera": (0.0, 0.0)}, "camera: give position"),
        ({"bounds": (8.0, 0.0, 20.0, 12.0), "cell_size": 0.001}, "too many"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options, told, scene, tmp_path):
    with pytest.raises(ValueError, match=told):
        wr.viz.render_riverscape(scene, tmp_path / "a.png", **options)
