"""Patches and stamped meshes against float64 twins."""

import math

import numpy as np
import pytest
import warp as wp
from kernel_arrays import REALS, SCALARS, to_device, vec2_of
from reference_terrain import gradient_noise

from warpriver.kernels import stamps

CORNERS = np.array([[0.0, 0.0], [40.0, 5.0], [30.0, 20.0], [45.0, 38.0], [5.0, 30.0], [12.0, 15.0]])
# Places of some 50 m, heights of some 3 m, noise whose slope is about 1; a mesh is float32 in both precisions.
HEIGHT = {"float64": 1e-9, "float32": 3e-5}


def inside_distance(xy):
    """Distance to the edge of the polygon from inside, by shapely; 0 outside."""
    shapely = pytest.importorskip("shapely")
    polygon, points = shapely.Polygon(CORNERS), shapely.points(xy)
    return np.where(shapely.contains(polygon, points), shapely.distance(polygon.exterior, points), 0.0)


def twin_patch(xy):
    inside = inside_distance(xy)
    weight = np.clip(inside / 3.0, 0.0, 1.0)
    total = sum(0.8 * 0.6**k * np.array([gradient_noise(9 + k, *(p / (7.0 / 2.0**k))) for p in xy]) for k in range(3))
    return np.where(inside > 0.0, weight**2 * (3.0 - 2.0 * weight) * total, 0.0), inside


def patch_of(kernel, dtype, device):
    patch = kernel.Patch()
    patch.corner = to_device(CORNERS.astype(REALS[dtype]), vec2_of(SCALARS[dtype]), device)
    patch.amplitude, patch.wavelength, patch.roughness, patch.blend = 0.8, 7.0, 0.6, 3.0
    patch.octaves, patch.seed = 3, 9
    return patch


def window_of(kernel, dtype, row=0, column=0):
    window = kernel.Window()
    window.corner = vec2_of(SCALARS[dtype])(-4.0, 41.0)
    window.cell_size, window.cosine, window.sine = 1.3, math.cos(0.2), math.sin(0.2)
    window.row, window.column = row, column
    return window


def cell_places(rows, columns):
    i, j = np.indices((rows, columns))
    x, y = 1.3 * j, -1.3 * i
    c, s = math.cos(0.2), math.sin(0.2)
    return np.stack([-4.0 + c * x - s * y, 41.0 + s * x + c * y], axis=-1).reshape(-1, 2)


def test_a_patch_is_that_of_the_twin(dtype, device):
    kernel = stamps.build(SCALARS[dtype])
    xy = np.random.default_rng(3).uniform(-3.0, 48.0, (400, 2)).astype(REALS[dtype])
    height = np.random.default_rng(4).normal(100.0, 1.0, 400)
    out = to_device(height.copy(), wp.float64, device)
    inputs = [patch_of(kernel, dtype, device), to_device(xy, vec2_of(SCALARS[dtype]), device)]
    wp.launch(kernel.roughen_points, dim=400, inputs=inputs, outputs=[out], device=device)
    added, inside = twin_patch(xy.astype(np.float64))
    assert 100 < (inside > 0).sum() < 300
    np.testing.assert_allclose(out.numpy() - height, added, atol=HEIGHT[dtype])
    np.testing.assert_array_equal(out.numpy()[inside == 0], height[inside == 0])


def test_cells_of_a_window_alone_are_changed(dtype, device):
    kernel = stamps.build(SCALARS[dtype])
    height = np.zeros((36, 40))
    out = to_device(height.copy(), wp.float64, device)
    inputs = [patch_of(kernel, dtype, device), window_of(kernel, dtype, 5, 8)]
    wp.launch(kernel.roughen_cells, dim=(20, 25), inputs=inputs, outputs=[out], device=device)
    added = twin_patch(cell_places(36, 40))[0].reshape(36, 40)
    within = np.zeros((36, 40), bool)
    within[5:25, 8:33] = True
    np.testing.assert_allclose(out.numpy(), np.where(within, added, 0.0), atol=HEIGHT[dtype])


@pytest.mark.parametrize("mode", [stamps.RAISE, stamps.LOWER, stamps.REPLACE])
def test_a_mesh_is_that_of_the_twin(dtype, device, mode):
    """A pyramid with a hole in its middle, over ground some of which is missing."""
    kernel = stamps.build(SCALARS[dtype])
    xyz = np.array(
        [[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0], [-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]], float
    )
    faces = [t for k in range(4) for t in ((k, (k + 1) % 4, k + 4), ((k + 1) % 4, (k + 1) % 4 + 4, k + 4))]
    mesh = wp.Mesh(
        to_device(xyz.astype(np.float32), wp.vec3, device),
        to_device(np.array(faces, np.int32).ravel(), wp.int32, device),
    )
    stamp = kernel.Stamp()
    stamp.mesh, stamp.mode, stamp.base, stamp.scale, stamp.top = mesh.id, mode, 7.0, 4.0, 2.0
    stamp.place = vec2_of(SCALARS[dtype])(20.0, 18.0)
    stamp.cosine, stamp.sine = math.cos(0.7), math.sin(0.7)
    places = cell_places(36, 40)
    off = (places - [20.0, 18.0]) / 4.0
    local = off @ np.array([[math.cos(0.7), -math.sin(0.7)], [math.sin(0.7), math.cos(0.7)]])
    out_of_middle = np.abs(local).max(axis=1)
    top = 7.0 + 4.0 * (3.0 - out_of_middle)
    hit = (out_of_middle > 1.0) & (out_of_middle < 3.0)
    ground = np.random.default_rng(1).normal(11.0, 3.0, len(places))
    ground[::17] = np.nan
    expected = ground.copy()
    meet = {stamps.RAISE: np.maximum, stamps.LOWER: np.minimum, stamps.REPLACE: lambda _, t: t}[mode]
    known = hit & np.isfinite(ground)
    expected[known] = meet(ground[known], top[known])
    clear = (np.abs(out_of_middle - 1.0) > 1e-3) & (np.abs(out_of_middle - 3.0) > 1e-3)
    assert known.sum() > 100
    out = to_device(ground.reshape(36, 40).copy(), wp.float64, device)
    inputs = [stamp, window_of(kernel, dtype)]
    wp.launch(kernel.stamp_cells, dim=(36, 40), inputs=inputs, outputs=[out], device=device)
    np.testing.assert_allclose(out.numpy().ravel()[clear], expected[clear], atol=3e-5)
    points = to_device(ground.copy(), wp.float64, device)
    inputs = [stamp, to_device(places.astype(REALS[dtype]), vec2_of(SCALARS[dtype]), device)]
    wp.launch(kernel.stamp_points, dim=len(places), inputs=inputs, outputs=[points], device=device)
    np.testing.assert_allclose(points.numpy()[clear], expected[clear], atol=3e-5)
