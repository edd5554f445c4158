"""What a blend-flow tree promises whatever it is made of [Peytavie2019], Sec. 6."""

import itertools
import math

import numpy as np
import pytest
import reference_riverscape as reference

from warpriver.riverscape import KINDS, Merge, Replace, Water, blend, primitives
from warpriver.riverscape.drift import drift_leaves

PLANE, ROUNDED = np.array([0.06, -0.02]), 1e-6
PLACES = np.random.default_rng(0).uniform(-1.5, 1.5, (400, 2))


def plane(xy):
    return 3.0 + xy @ PLANE


def still(kind, seed):
    """Some primitives of a kind whose levels lie in one plane and that have no waves, drops or dimples."""
    rng = np.random.default_rng(seed)
    center = rng.uniform(-2.0, 2.0, (30, 2))
    radius = rng.uniform(0.4, 1.5, 30)
    velocity = rng.uniform(0.1, 1.0, (30, 2))
    return primitives(kind, center, radius, plane(center), gradient=PLANE, velocity=velocity, seed=seed)


@pytest.mark.parametrize("contrast", [True, False])
def test_planes_are_reproduced_by_all_kinds_and_both_operators(contrast, device):
    """With constant levels a slope of 6 % would become a staircase."""
    nodes = [still(kind, k) for k, kind in enumerate(KINDS)]
    tree = blend(Merge(tuple(nodes[:4])), Replace(nodes[4], nodes[5]), nodes[6])
    found = Water(tree, contrast=contrast, device=device).at(PLACES, 5.0)
    wet = found.weight > 0.0
    assert wet.mean() > 0.9
    np.testing.assert_allclose(found.elevation[wet], plane(PLACES[wet]), rtol=0.0, atol=ROUNDED)


def waving(seed, kind="ripple"):
    rng = np.random.default_rng(seed)
    center = rng.uniform(-1.5, 1.5, (12, 2))
    return primitives(
        kind, center, 1.2, rng.uniform(0.0, 0.2, 12), velocity=rng.uniform(-0.5, 0.5, (12, 2)),
        amplitude=0.05, wavelength=0.5, effervescence=0.4, seed=seed,
    )  # fmt: skip


def assert_alike(a, b, near=ROUNDED):
    for name in ("elevation", "still", "velocity", "effervescence", "weight"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0.0, atol=10.0 * near)


@pytest.mark.parametrize("contrast", [True, False])
def test_merging_is_associative_and_commutes(contrast, device):
    a, b, c = (waving(k) for k in range(3))
    trees = [
        Merge((Merge((a, b)), c)),
        Merge((a, Merge((b, c)))),
        Merge((c, b, a)),
    ]
    found = [Water(tree, contrast=contrast, dtype="float64", device=device).at(PLACES, 2.0) for tree in trees]
    for one, other in itertools.combinations(found, 2):
        assert_alike(one, other)


@pytest.mark.parametrize("contrast", [True, False])
def test_replacing_by_nothing_half_and_all(contrast, device):
    """m = min(1, alpha_B): at 0 what was there, at 1 and above only what replaces it; the weight is A's."""
    under = waving(1)
    far = primitives("calm", (90.0, 0.0), 1.0)
    # Where weights are 1e-5 velocities are as exact as those in float32.
    options = {"contrast": contrast, "dtype": "float64", "device": device}
    trees = (Merge((Replace(under, far), far)), under)
    assert_alike(*(Water(tree, **options).at(PLACES) for tree in trees))
    at = [[0.0, 0.0]]
    full = primitives("calm", (0.0, 0.0), 1.0, 7.0, velocity=(0.3, 0.0), effervescence=1.0)
    over = Merge((full, full, full))
    for node in (full, over):
        found = Water(Replace(under, node), contrast=contrast, device=device).at(at)
        np.testing.assert_allclose([found.elevation[0], *found.velocity[0]], [7.0, 0.3, 0.0], atol=ROUNDED)
        assert found.effervescence[0] == pytest.approx(Water(node, device=device).at(at).effervescence[0], abs=1e-4)
        assert found.weight[0] == pytest.approx(Water(under, device=device).at(at).weight[0], abs=1e-4)
    # Half way out r^2 = 1/2: alpha = 1/8.
    there = [[math.sqrt(0.5), 0.0]]
    options |= {"contrast": False}
    found, below = (Water(tree, **options).at(there) for tree in (Replace(under, full), under))
    assert found.elevation[0] == pytest.approx(0.875 * below.elevation[0] + 0.125 * 7.0, abs=ROUNDED)
    # Nothing is there to be replaced.
    assert Water(Merge((Replace(far, full), far)), device=device).at(at).weight[0] == 0.0


def test_a_cascade_is_above_half_way_and_below_at_its_lip(device):
    """Lambda is 1, 1/2, 0 at -eps, 0, eps along the direction of the flow, whatever its speed."""
    for speed in (0.2, 3.0):
        leaf = primitives("cascade", (0.0, 0.0), 1.0, 5.0, velocity=(0.0, speed), height=0.4, blending=0.2, lip=0.1)
        found = Water(leaf, device=device).at([[0.0, y] for y in (-0.5, -0.1, 0.1, 0.3, 0.6)])
        np.testing.assert_allclose(found.elevation, [5.2, 5.2, 5.0, 4.8, 4.8], atol=ROUNDED)
        assert [reference.upstream_share(x, 0.2) for x in (-0.2, 0.0, 0.2)] == [1.0, 0.5, 0.0]


def test_a_vortex_without_shear_and_spin_is_turbulent_water(device):
    shared = {"amplitude": 0.1, "wavelength": 0.5, "effervescence": 0.5, "seed": 3}
    turning, plain = (primitives(kind, (0.0, 0.0), 2.0, **shared) for kind in ("vortex", "turbulent"))
    assert_alike(*(Water(leaf, device=device).at(PLACES, 40.0) for leaf in (turning, plain)))


def test_a_leaf_in_a_vortex_goes_round_in_two_pi_over_beta(device):
    """And keeps its distance from the centre."""
    spin = 0.8
    water = Water(primitives("vortex", (3.0, 1.0), 2.0, 1.0, spin=spin), device=device)
    times = np.linspace(0.0, 2.0 * np.pi / spin, 161)
    shots = list(drift_leaves(water, lambda xy: np.zeros(len(np.asarray(xy))), times, 20, 4))
    off = np.array([shot.xy for shot in shots]) - (3.0, 1.0)
    radius = np.hypot(*off[0].T)
    np.testing.assert_allclose(off[-1], off[0], rtol=0.0, atol=2e-3 * radius.max())
    np.testing.assert_allclose(
        off[40], off[0] @ np.array([[0.0, 1.0], [-1.0, 0.0]]), rtol=0.0, atol=2e-3 * radius.max()
    )
    # What floats turns with it: half the curl is beta.
    turned = shots[-1].heading - shots[0].heading
    np.testing.assert_allclose(turned, 2.0 * np.pi, rtol=1e-3)


def test_no_slope_crosses_the_bank_of_an_echo(device):
    angle, distance = 0.7, 0.4
    leaf = primitives(
        "echo", (0.0, 0.0), 2.0, velocity=(0.3, 0.1), amplitude=0.1, wavelength=0.5, bank_angle=angle,
        bank_distance=distance,
    )  # fmt: skip
    water = Water(leaf, noise="exact", dtype="float64", device=device)
    normal, along = (np.array([math.cos(a), math.sin(a)]) for a in (angle, angle + 0.5 * math.pi))
    bank = distance * normal + np.linspace(-1.0, 1.0, 50)[:, None] * along
    step = 1e-4
    before, after = (water.at(bank + side * step * normal, 3.0).elevation for side in (-1.0, 1.0))
    np.testing.assert_allclose((after - before) / (2.0 * step), 0.0, atol=1e-9)
    slope = (water.at(bank + step * along, 3.0).elevation - water.at(bank, 3.0).elevation) / step
    assert np.abs(slope).max() > 0.05


def test_weights_end_smoothly(device):
    """g, g' and g'' are 0 at the rim: (1 - r^2)^3 = 8 (1 - r)^3 + ... there."""
    water = Water(primitives("calm", (0.0, 0.0), 1.0), dtype="float64", device=device)
    for gap in (0.1, 0.05, 0.02):
        weight = water.at([[1.0 - gap, 0.0]]).weight[0]
        assert weight == pytest.approx(8.0 * gap**3, rel=2.0 * gap)
    assert water.at([[1.0, 0.0], [1.0001, 0.0]]).weight.tolist() == [0.0, 0.0]


def test_far_from_the_origin_water_is_as_exact(device):
    """Places are held relative to tiles: 500 km away float32 alone would be off by 3 cm."""
    for shift in (np.zeros(2), np.array([512_000.0, 4_096_000.0])):
        center = np.array([[0.0, 0.0], [70.0, 3.0]]) + shift
        leaf = primitives("ripple", center, 1.5, 2000.25, velocity=(0.5, 0.2), amplitude=0.05, wavelength=0.5, seed=1)
        found = Water(leaf, cell_size=0.5, device=device).at(center + (0.3, 0.4), 10.0)
        if not shift.any():
            expected = found.elevation
    np.testing.assert_allclose(found.elevation, expected, rtol=0.0, atol=2e-6)


def test_memory_of_a_primitive(device):
    water = Water(waving(0), device=device)
    assert water.bytes_per_primitive <= 90
