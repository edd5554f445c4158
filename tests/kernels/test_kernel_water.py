"""The kernels of the water surface, ``evaluate_water`` and ``set_phases``, against the tree by recursion in float64."""

import functools
import math

import numpy as np
import pytest
import reference_riverscape as reference
import warp as wp
from kernel_arrays import SCALARS

from warpriver.kernels import flow_tree
from warpriver.kernels import water as kernels
from warpriver.riverscape.primitives import Merge, Primitives, Replace, primitives
from warpriver.riverscape.water import Water

KINDS = ("calm", "ripple", "turbulent", "wave", "cascade", "vortex", "echo")
# Levels of some metres, places of up to 60 m, waves of some cm: rounding of each.
NEAR = {"float64": 1e-9, "float32": 2e-5}
YEAR = 365.25 * 86400.0


def one(kind, rng, center, radius=None):
    """A primitive of a kind with everything drawn."""
    return primitives(
        kind,
        center,
        rng.uniform(0.6, 2.0) if radius is None else radius,
        rng.uniform(1.0, 2.0),
        gradient=rng.uniform(-0.1, 0.1, 2),
        velocity=rng.uniform(-1.0, 1.0, 2),
        amplitude=rng.uniform(0.0, 0.05),
        wavelength=rng.uniform(0.3, 1.0),
        effervescence=rng.uniform(0.0, 1.0),
        height=rng.uniform(-0.3, 0.3),
        blending=rng.uniform(0.1, 0.5),
        length=rng.uniform(0.3, 1.0),
        lip=rng.uniform(-0.5, 0.5),
        shear=rng.uniform(-1.0, 1.0),
        spin=rng.uniform(-2.0, 2.0),
        depth=rng.uniform(0.0, 0.1),
        bank_angle=rng.uniform(0.0, 6.0),
        bank_distance=rng.uniform(-0.5, 0.5),
        seed=int(rng.integers(2**31)),
    )


@functools.cache
def leaves():
    """Twenty of each kind, about the origin: to draw them takes most of the time of a tree."""
    rng = np.random.default_rng(9)
    return [one(kind, rng, (0.0, 0.0)) for kind in KINDS for _ in range(20)]


def random_tree(rng, center, depth):
    """A tree about a centre: at each inner node a merge of two or three, or a replacement."""
    if depth == 0 or rng.random() < 0.15:
        leaf = leaves()[rng.integers(len(leaves()))]
        return leaf.replace(center=np.array([center + rng.uniform(-1.0, 1.0, 2)]), level=rng.uniform(1.0, 2.0, 1))
    children = [random_tree(rng, center, depth - 1) for _ in range(rng.integers(2, 4))]
    return Replace(*children[:2]) if rng.random() < 0.5 else Merge(tuple(children))


def assert_surface(found, expected, near):
    elevation, still, velocity, foam, weight = expected
    dry = weight == 0.0
    # A primitive ends where its weight is 1e-12.
    unsure = (weight > 0.0) & (weight < 1e-9)
    np.testing.assert_array_equal(np.isnan(found.elevation)[~unsure], dry[~unsure])
    wet = ~dry & ~unsure
    np.testing.assert_allclose(found.still[wet], still[wet], rtol=0.0, atol=near)
    np.testing.assert_allclose(found.elevation[wet], elevation[wet], rtol=0.0, atol=near)
    np.testing.assert_allclose(found.velocity[wet], velocity[wet], rtol=0.0, atol=10.0 * near)
    np.testing.assert_allclose(found.effervescence[wet], foam[wet], rtol=0.0, atol=10.0 * near)
    np.testing.assert_allclose(found.weight[wet], weight[wet], rtol=0.0, atol=10.0 * near)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("time", [0.0, 3.7, YEAR])
def test_each_kind_of_leaf_is_that_of_the_reference(kind, time, dtype, device):
    """After a year of clock time as exactly as at its beginning."""
    rng = np.random.default_rng(KINDS.index(kind))
    leaf = one(kind, rng, (31.0, -17.0), 1.5)
    # What rounds velocities and wavelengths to float32 would move the noise by metres in a year.
    names = ("velocity", "wavelength", "shape", "radius", "amplitude", "center", "level", "gradient", "effervescence")
    exact = {name: np.float32(getattr(leaf, name)).astype(float) for name in names}
    exact["wavelength"] = np.full(1, 0.5)
    leaf = leaf.replace(**exact)
    places = leaf.center + rng.uniform(-1.6, 1.6, (60, 2))
    found = Water(leaf, noise="exact", dtype=dtype, device=device).at(places, time)
    near = NEAR[dtype] if dtype == "float32" or time < YEAR else 1e-7
    assert_surface(found, reference.evaluate(leaf, places, time), near)


@pytest.mark.parametrize("contrast", [True, False])
def test_programs_of_cells_are_the_recursion_on_a_thousand_random_trees(contrast, device):
    """Side by side, 12 m apart, each asked at some places; the programs hold what reaches a cell and nothing else.

    500 with each way of merging.
    """
    rng = np.random.default_rng([7, contrast])
    trees, places, expected = [], [], []
    for k in range(500):
        center = np.array([12.0 * (k % 25), 12.0 * (k // 25)])
        tree = random_tree(rng, center, 3)
        at = center + rng.uniform(-1.6, 1.6, (2, 2))
        trees.append(tree)
        places.append(at)
        expected.append(reference.evaluate(tree, at, 1.3, contrast))
    water = Water(Merge(tuple(trees)), cell_size=0.7, contrast=contrast, noise="exact", dtype="float64", device=device)
    together = [np.concatenate(column) for column in zip(*expected, strict=True)]
    assert (together[4] > 0.0).mean() > 0.5
    assert_surface(water.at(np.concatenate(places), 1.3), together, 1e-9)


def test_a_grid_is_its_cells_centres(dtype, device):
    rng = np.random.default_rng(2)
    tree = random_tree(rng, np.array([5.0, 5.0]), 3)
    water = Water(tree, dtype=dtype, device=device)
    grid = water.on_grid((3.0, 8.0), 0.25, (20, 24), 2.0)
    x, y = 3.0 + 0.25 * (np.arange(24) + 0.5), 8.0 - 0.25 * (np.arange(20) + 0.5)
    found = water.at(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), 2.0)
    np.testing.assert_array_equal(grid.elevation.numpy().ravel(), found.elevation)
    np.testing.assert_array_equal(grid.velocity.numpy().reshape(-1, 2), found.velocity)


def test_baked_noise_is_the_exact_noise_within_a_few_percent(device):
    """Texels are a quarter of the shortest wavelength; the edges of ridges are rounded, waves are not."""
    for kind, near, worst in (("calm", 0.004, 0.02), ("ripple", 0.01, 0.05), ("turbulent", 0.03, 0.3)):
        leaf = primitives(kind, (0.0, 0.0), 4.0, velocity=(1.0, 0.2), amplitude=1.0, wavelength=1.0)
        places = np.random.default_rng(0).uniform(-2.0, 2.0, (4000, 2))
        baked, exact = (Water(leaf, noise=n, device=device).at(places, 5.0).elevation for n in ("baked", "exact"))
        assert np.sqrt(((baked - exact) ** 2).mean()) < near and np.abs(baked - exact).max() < worst


def test_baked_tables_have_no_mean_and_repeat_themselves(dtype, device):
    """``bake_noise``: what a table adds to the level of the water on average is nothing."""
    made = kernels.build(SCALARS[dtype])
    value = wp.zeros((flow_tree.TABLES, flow_tree.TEXELS, flow_tree.TEXELS), dtype=wp.float64, device=device)
    wp.launch(made.bake_noise, value.shape, [], [value], device=device)
    np.testing.assert_allclose(value.numpy().mean(axis=(1, 2)), 0.0, atol=2e-3)
    texel = flow_tree.PERIOD / flow_tree.TEXELS
    for table, i, j in ((0, 3, 250), (1, 77, 8), (2, 255, 128)):
        expected = reference.noise(table, texel * np.array([j, i]))
        assert value.numpy()[table, i, j] == pytest.approx(expected, abs=1e-9 if dtype == "float64" else 1e-5)


def test_a_users_own_leaf_is_called(device):
    @wp.func
    def bump(kind: int, off: wp.vec2f, weight: float, shape: wp.vec3f, phase: wp.vec4f) -> wp.vec4f:
        return wp.vec4f(shape[0] * weight, shape[1], 0.0, float(kind - 7) * 0.5)

    own = primitives(8, (0.0, 0.0), 1.0, 2.0, shape=(0.4, 0.25, 0.0))
    found = Water(own, leaf=bump, device=device).at([[0.0, 0.0], [0.5, 0.0]])
    np.testing.assert_allclose(found.elevation, 2.0 + 0.4 * np.array([1.0, 0.75**3]), atol=1e-6)
    np.testing.assert_allclose(found.velocity, [[0.25, 0.0]] * 2)
    np.testing.assert_allclose(found.effervescence, 0.5)
    with pytest.raises(ValueError, match="leaf="):
        Water(own, device=device)


def test_offsets_of_primitives_are_wrapped(dtype, device):
    """``set_phases``: whatever the time, a primitive lies within one period of the noise."""
    rows = Primitives.concatenate([one("calm", np.random.default_rng(k), (0.0, 0.0)) for k in range(50)])
    water = Water(rows, dtype=dtype, device=device)
    water.at([[0.0, 0.0]], 1e9)
    phase = water._rows.phase.numpy()
    assert (phase[:, :2] >= 0.0).all() and (phase[:, :2] <= flow_tree.PERIOD).all()
    np.testing.assert_allclose(np.hypot(*phase[:, 2:].T) * rows.wavelength, 1.0, rtol=1e-6)
    assert math.isfinite(phase.sum())


def test_a_loop_has_no_seam_and_does_not_pulse(device):
    """``fade_surfaces``: at its end it is as at its beginning, and its waves are as high all the time."""
    x, y = np.meshgrid(np.arange(24.0), np.arange(24.0))
    center = 0.5 * np.column_stack([x.ravel(), y.ravel()])
    for speed in (0.02, 0.6):
        rows = primitives("ripple", center, 0.5, velocity=(speed, 0.3 * speed), amplitude=0.05, wavelength=0.4)
        water = Water(rows, device=device)
        where = ((1.0, 10.0), 0.05, (180, 180))
        plain = water.on_grid(*where, 0.0).elevation.numpy()
        np.testing.assert_allclose(water.loop_grid(*where, 0.0, 4.0).elevation.numpy(), plain, atol=1e-6)
        np.testing.assert_allclose(water.loop_grid(*where, 3.9999, 4.0).elevation.numpy(), plain, atol=2e-4)
        height = [water.loop_grid(*where, t, 4.0).elevation.numpy().std() for t in np.linspace(0.0, 4.0, 9)]
        # 80 wavelengths of the first octave: the spread of their variance.
        assert max(height) / min(height) < 1.15
    with pytest.raises(ValueError, match="jelly"):
        water.loop_grid(*where, 0.0, 0.4)


def test_merged_waves_are_as_high_between_centres_as_at_them(device):
    """Plain merging halves their variance there, which shows as a quilt."""
    x, y = np.meshgrid(np.arange(80.0), np.arange(80.0))
    center = 0.5 * np.column_stack([x.ravel(), y.ravel()])
    rows = primitives("ripple", center, 0.5, velocity=(0.4, 0.1), amplitude=0.05, wavelength=0.4)
    at, between = center[1000:5000], center[1000:5000] + 0.25
    ratio = {}
    for contrast in (True, False):
        water = Water(rows, contrast=contrast, device=device)
        ratio[contrast] = water.at(between).elevation.std() / water.at(at).elevation.std()
    assert ratio[True] == pytest.approx(1.0, abs=0.05)
    assert ratio[False] == pytest.approx(0.5, abs=0.05)
