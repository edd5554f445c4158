"""``shade_pixels``: where rays meet the ground, what still water mirrors and hides, and that the sky is above."""

import numpy as np
import pytest
import warp as wp
from kernel_arrays import REALS, SCALARS, to_device

from warpriver.kernels import shading


def shade(bed, water, view, dtype, device, white=0.0, size=0.1, rock=0.0):
    scalar, real = SCALARS[dtype], REALS[dtype]
    made = shading.build(scalar)
    scene = made.Scene()
    for name, values in (
        ("bed", bed),
        ("water", water),
        ("shore", water - bed),
        ("rock", 0.0 * bed + rock),
        ("white", 0.0 * bed + white),
    ):
        setattr(scene, name, to_device(values.astype(real), scalar, device))
    scene.cell_size, scene.white_scale, scene.top = size, 1.0, float(max(bed.max(), water.max())) + 0.01
    camera = made.View()
    eye, forward, right, up, parallel, shape = view
    camera.eye, camera.forward = made.vec3(*eye), made.vec3(*forward)
    camera.right, camera.up = made.vec3(*right), made.vec3(*up)
    camera.sun = made.vec3(0.48, 0.6, 0.64)
    camera.parallel, (camera.height, camera.width) = parallel, shape
    color = wp.empty(shape, dtype=made.vec3, device=device)
    far = wp.empty(shape, dtype=scalar, device=device)
    wp.launch(made.shade_pixels, shape, [scene, camera], [color, far], device=device)
    return color.numpy(), far.numpy()


def from_above(shape=(16, 16), height=10.0):
    """A map of the square from (0, -8) to (8, 0)."""
    return (4.0, -4.0, height), (0.0, 0.0, -1.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0), 1, shape


def test_rays_from_above_end_on_the_higher_of_bed_and_water(dtype, device):
    x = np.tile(0.1 * np.arange(81), (81, 1))
    bed, water = 0.2 * x, np.full_like(x, 0.8)
    _, far = shade(bed, water, from_above(), dtype, device)
    at = 4.0 + 3.0 * ((2.0 * (np.arange(16) + 0.5) / 16.0) - 1.0)
    expected = 10.0 - np.maximum(0.2 * at, 0.8)
    np.testing.assert_allclose(far, np.broadcast_to(expected, far.shape), atol=2e-3)


def test_a_slanting_ray_ends_where_it_meets_a_plane(dtype, device):
    flat = np.zeros((81, 81))
    down = np.array([0.6, 0.0, -0.8])
    view = ((1.0, -4.0, 4.0), down, (0.0, -0.001, 0.0), (0.0008, 0.0, 0.0006), 0, (3, 3))
    _, far = shade(flat, flat - 1.0, view, dtype, device)
    np.testing.assert_allclose(far, 5.0, atol=0.02)
    up = ((1.0, -4.0, 4.0), (0.0, 0.0, 1.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), 0, (2, 2))
    assert (shade(flat, flat - 1.0, up, dtype, device)[1] < 0.0).all()


def test_deep_water_hides_the_bed_and_foam_the_water(dtype, device):
    """The deeper, the darker and the less red; foam is nearly white."""
    flat = np.zeros((81, 81))
    colors = [shade(flat - d, flat, from_above(), dtype, device)[0].mean(axis=(0, 1)) for d in (0.05, 0.5, 3.0)]
    assert colors[0][0] > colors[1][0] > colors[2][0]
    assert colors[0][0] / colors[0][1] > colors[1][0] / colors[1][1]
    foam = shade(flat - 3.0, flat, from_above(), dtype, device, white=1.0)[0].mean(axis=(0, 1))
    assert foam.min() > 0.5 and foam.min() / foam.max() == pytest.approx(1.0, abs=0.15)


def test_water_mirrors_more_the_flatter_it_is_looked_at(dtype, device):
    """Schlick: 2 % straight down, nearly all at grazing; over a black depth that is the light of the sky."""
    flat = np.zeros((161, 161))
    means = []
    for down in (1.0, 0.3, 0.08):
        across = np.sqrt(1.0 - down * down)
        forward, eye = np.array([0.0, across, -down]), np.array([8.0, -8.0 - 3.0 * across, 3.0 * down])
        view = (eye, forward, (0.01, 0.0, 0.0), 0.01 * np.array([0.0, down, across]), 0, (4, 4))
        color, far = shade(flat - 30.0, flat, view, dtype, device)
        assert (far > 0.0).all()
        means.append(color.mean())
    assert means[0] < means[1]
    assert np.isfinite(means).all()


def test_logs_are_browner_and_darker_than_rocks(dtype, device):
    flat = np.zeros((81, 81))
    stone, wood = (
        shade(flat, flat - 1.0, from_above(), dtype, device, rock=r)[0].mean(axis=(0, 1)) for r in (1.0, -1.0)
    )
    assert wood[0] / wood[2] > 1.5 * stone[0] / stone[2] and wood.sum() < 0.7 * stone.sum()
