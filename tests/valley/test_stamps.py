"""Patches of rough ground and meshes that are set into a valley."""

import math
import pickle

import numpy as np
import pytest

import warpriver as wr
from warpriver import valley as g

SQUARE = ((60.0, -20.0), (100.0, -20.0), (100.0, 20.0), (60.0, 20.0))
# A roof 6 m long and 4 m wide, its ridge along x and 3 m high.
ROOF = np.array([[-3, -2, 0], [3, -2, 0], [3, 0, 3], [-3, 0, 3], [3, 2, 0], [-3, 2, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4], [3, 4, 5]])


def made(device="cpu", **changes):
    return wr.synthetic_valley("S1", controls={}, device=device, **changes)


def roof_height(x, y):
    return np.where((abs(x) <= 3.0) & (abs(y) <= 2.0), 3.0 - 1.5 * abs(y), -math.inf)


def test_a_patch_is_rough_inside_and_nothing_outside(device):
    """Standard deviation over some 60 waves of the first octave: within 12 %."""
    patch = g.RoughnessPatch(SQUARE, deviation=0.2, wavelength=5.0, octaves=3, blend=2.0, seed=4)
    plain, rough = made(device), made(device, patches=(patch,))
    x, y = np.meshgrid(np.arange(50.0, 110.0, 0.37), np.arange(-25.0, 25.0, 0.37))
    places = np.column_stack([x.ravel(), y.ravel()])
    added = rough.height(places) - plain.height(places)
    inside = (np.abs(places[:, 0] - 80.0) < 18.0) & (np.abs(places[:, 1]) < 18.0)
    outside = (np.abs(places[:, 0] - 80.0) > 20.0) | (np.abs(places[:, 1]) > 20.0)
    assert not added[outside].any()
    assert added[inside].std() == pytest.approx(0.2, rel=0.12) and abs(added[inside].mean()) < 0.05
    # Nothing jumps at the edge: within 0.37 m of it, the weight of the blend is below 0.1.
    rim = ~outside & ((np.abs(places[:, 0] - 80.0) > 19.63) | (np.abs(places[:, 1]) > 19.63))
    assert rim.any() and np.abs(added[rim]).max() < 0.1
    again = made(device, patches=(patch,))
    np.testing.assert_array_equal(again.height(places), rough.height(places))
    assert not np.array_equal(made(device, patches=(patch.replace(seed=5),)).height(places), rough.height(places))


def test_deviations_are_those_asked_for_over_many_seeds():
    deviation = []
    places = np.random.default_rng(1).uniform((62.0, -18.0), (98.0, 18.0), (3000, 2))
    plain = made().height(places)
    for seed in range(0, 60, 6):
        patch = g.RoughnessPatch(SQUARE, deviation=1.0, wavelength=2.0, octaves=4, roughness=0.7, blend=0.0, seed=seed)
        deviation.append(np.mean((made(patches=(patch,)).height(places) - plain) ** 2))
    assert math.sqrt(np.mean(deviation)) == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize("mode", ["raise", "lower", "replace"])
@pytest.mark.parametrize("angle", [0.0, 30.0])
def test_a_mesh_meets_the_ground_as_its_mode_says(mode, angle, device):
    """Against the roof's own equation; float32 within the mesh: 1e-5 m."""
    stamp = g.MeshStamp(ROOF, FACES, (200.0, 3.0), angle=angle, scale=2.0, mode=mode)
    plain, stamped = made(device), made(device, stamps=(stamp,))
    x, y = np.meshgrid(np.arange(185.0, 215.0, 0.31), np.arange(-8.0, 14.0, 0.31))
    places = np.column_stack([x.ravel(), y.ravel()])
    ground = plain.height(places)
    base = plain.height(np.array([[200.0, 3.0]]))[0]
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    off = (places - [200.0, 3.0]) / 2.0
    local = np.column_stack([c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0]])
    top = base + 2.0 * roof_height(local[:, 0], local[:, 1])
    expected = {"raise": np.maximum(ground, top), "lower": np.where(np.isfinite(top), np.minimum(ground, top), ground),
                "replace": np.where(np.isfinite(top), top, ground)}[mode]  # fmt: skip
    edge = (np.abs(np.abs(local[:, 0]) - 3.0) < 1e-3) | (np.abs(np.abs(local[:, 1]) - 2.0) < 1e-3)
    np.testing.assert_allclose(stamped.height(places)[~edge], expected[~edge], atol=1e-5)


def test_raster_places_and_grid_agree(device):
    patch = g.RoughnessPatch(SQUARE, seed=2)
    stamps = (g.MeshStamp(ROOF, FACES, (150.0, 0.0), scale=3.0), g.MeshStamp(ROOF, FACES, (70.0, 5.0), base="datum"))
    valley = made(device, patches=(patch,), stamps=stamps, cell_size=1.0, origin=(500.0, 900.0))
    terrain = valley.terrain
    values = terrain.to_numpy()
    rows, columns = np.indices(values.shape)
    x, y = terrain.origin[0] + (columns + 0.5) * 1.0, terrain.origin[1] - (rows + 0.5) * 1.0
    np.testing.assert_allclose(values.ravel(), valley.height(np.column_stack([x.ravel(), y.ravel()])), atol=1e-9)
    assert values.max() > made(device, cell_size=1.0).terrain.to_numpy().max() + 5.0
    xyz = valley.grid(2.0).xyz
    inner = xyz[5:-5]
    np.testing.assert_allclose(inner[..., 2].ravel(), valley.height(inner[..., :2].reshape(-1, 2)), atol=1e-3)


def test_cells_beyond_a_stamp_keep_their_bits(device):
    stamp = g.MeshStamp(ROOF, FACES, (200.0, 3.0), scale=2.0)
    plain, stamped = (made(device, stamps=s, cell_size=1.0).terrain.to_numpy() for s in ((), (stamp,)))
    changed = np.argwhere(plain != stamped)
    assert len(changed) and np.ptp(changed, axis=0).max() <= 12


def test_a_mesh_of_its_own_stands_on_the_map():
    stamp = g.MeshStamp(ROOF, FACES, (200.0, 3.0), name="shed", mode="keep")
    valley = made(stamps=(stamp,), origin=(1000.0, 2000.0))
    places = np.array([[1200.0, 2003.0], [1201.0, 2002.0]])
    np.testing.assert_array_equal(valley.height(places), made(origin=(1000.0, 2000.0)).height(places))
    (shed,) = valley.structures()
    np.testing.assert_allclose(shed.points()[:, :2], ROOF[:, :2] + [1200.0, 2003.0])
    np.testing.assert_allclose(shed.points()[:, 2], ROOF[:, 2] + valley.height(places[:1])[0])
    np.testing.assert_array_equal(shed.triangles(), FACES)


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_a_structure_is_written_as_a_mesh(suffix, tmp_path):
    """And comes back where it stood: text has a tenth of a millimetre, and the reader single precision."""
    pytest.importorskip("pyvista")
    valley = made(stamps=(g.MeshStamp(ROOF, FACES, (200.0, 3.0), mode="keep"),), crs="EPSG:32619")
    (shed,) = valley.structures()
    assert shed.crs == "EPSG:32619"
    wr.write_mesh(shed, tmp_path / f"shed{suffix}")
    vertices, triangles = wr.io.read_mesh(tmp_path / f"shed{suffix}")
    np.testing.assert_allclose(vertices, shed.points(), atol=2e-4)
    np.testing.assert_array_equal(triangles, shed.triangles())


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_levee_keeps_its_height_along_a_bend(side, device):
    valley = wr.synthetic_valley("S3", device=device)
    levee = g.levee(valley, side, start=0.2, end=0.7, offset=6.0, height=1.5, crest=3.0)
    with_levee = wr.synthetic_valley("S3", stamps=(levee,), device=device)
    reach, bank = valley.stations.reach, 0 if side == "left" else 1
    s, line = valley.stations.line.s[reach] / valley.stations.length, valley.stations.line
    on = (s > 0.22) & (s < 0.68)
    sign = 1.0 if side == "left" else -1.0
    normal = sign * np.column_stack([-line.tangent[reach][:, 1], line.tangent[reach][:, 0]])
    middle = line.xy[reach] + (valley.stations.half[reach][:, bank] + 6.0)[:, None] * normal
    crest = valley.bank_height_at(line.xy[reach][:, 0]) + valley.stations.lift[reach] + 1.5
    # Its sections lie a quarter of a width apart: between them the crest is straight.
    np.testing.assert_allclose(with_levee.height(middle)[on], crest[on], atol=0.02)
    assert (with_levee.height(middle)[on] > valley.height(middle)[on] + 1.0).all()
    bed = line.xy[reach]
    np.testing.assert_array_equal(with_levee.height(bed), valley.height(bed))
    (face,) = np.unique(np.sign(np.cross(*_edges(levee))[:, 2]))
    assert face == 1.0, "every triangle is seen from above"


def _edges(stamp):
    a, b, c = (np.asarray(stamp.vertices)[np.asarray(stamp.triangles)[:, k]] for k in range(3))
    return b - a, c - a


def test_a_bridge_spans_the_channel_and_its_piers_stand_in_it(device):
    valley = wr.synthetic_valley("S3", device=device)
    stamps = g.bridge(valley, 0.375, piers=2, clearance=1.0)
    assert [stamp.mode for stamp in stamps] == ["keep", "raise", "raise"]
    bridged = wr.synthetic_valley("S3", stamps=stamps, device=device)
    (deck,) = bridged.structures()
    at = round(0.375 * 784) + valley.stations.lead
    line, half = valley.stations.line, valley.stations.half[at]
    normal = np.array([-line.tangent[at, 1], line.tangent[at, 0]])
    across = (deck.points()[:, :2] - line.xy[at]) @ normal
    assert across.max() == pytest.approx(half[0] + 4.0) and across.min() == pytest.approx(-half[1] - 4.0)
    top = valley.bank_height_at(line.xy[at : at + 1, 0])[0] + valley.stations.lift[at]
    assert deck.points()[:, 2].min() == pytest.approx(top + 1.0)
    n = -half[1] + half.sum() * np.array([1.0, 2.0]) / 3.0
    piers = line.xy[at] + n[:, None] * normal
    np.testing.assert_allclose(bridged.height(piers), top + 1.0, atol=1e-4)
    middle = line.xy[at : at + 1]
    np.testing.assert_array_equal(bridged.height(middle), valley.height(middle))
    # A closed surface, seen from outside: its volume by Gauss' theorem is that of the box.
    a, b, c = (deck.points()[deck.triangles()[:, k]] - deck.points().mean(axis=0) for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    assert volume == pytest.approx(8.0 * 1.0 * (half.sum() + 8.0))


def test_stamped_valleys_pickle_with_equal_heights():
    valley = made(patches=(g.RoughnessPatch(SQUARE),), stamps=(g.MeshStamp(ROOF, FACES, (80.0, 0.0)),))
    places = np.random.default_rng(0).uniform((62.0, -18.0), (98.0, 18.0), (200, 2))
    again = pickle.loads(pickle.dumps(valley))
    np.testing.assert_array_equal(again.height(places), valley.height(places))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: g.RoughnessPatch(((0, 0), (1, 1))), "RoughnessPatch.polygon has 2 corners"),
        (lambda: g.RoughnessPatch("abc"), r"RoughnessPatch.polygon must be \(n, 2\) finite numbers"),
        (lambda: g.MeshStamp(ROOF, [[0, 1, 6]]), "whole numbers from 0 to 5"),
        (lambda: g.MeshStamp(ROOF, [[0, 1, 1.5]]), "whole numbers from 0 to 5"),
        (lambda: g.MeshStamp(ROOF[:, :2], FACES), r"MeshStamp.vertices must be \(n, 3\) finite numbers"),
        (lambda: g.MeshStamp(ROOF, FACES, (math.nan, 0.0)), "MeshStamp.place"),
        (lambda: g.MeshStamp(ROOF, FACES, mode="burn"), "MeshStamp.mode is 'burn'"),
        (lambda: made(stamps=(g.MeshStamp(ROOF, FACES, (-900.0, 0.0)),)).terrain, "where the valley has no ground"),
        (lambda: g.levee(made(), "up"), 'side is \'up\'; give "left" or "right"'),
        (lambda: g.levee(made(), offset=1.0, crest=3.0), "reaches over the bank"),
        (lambda: g.levee(made(), start=0.8, end=0.2), "0 <= start < end <= 1"),
        (lambda: g.bridge(made(), 1.5), "station is 1.5"),
        (lambda: g.bridge(made(), piers=-1), "piers is -1"),
    ],
)
def test_bad_patches_and_meshes_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
