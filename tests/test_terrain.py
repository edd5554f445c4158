import math

import numpy as np
import pytest
import reference_terrain as twin
import warp as wp
from devices import assert_bits
from hypothesis import given, settings
from hypothesis import strategies as st

import warpriver.device as device_module
from warpriver.device import available_memory, require_memory
from warpriver.network import RiverNetwork
from warpriver.terrain import Terrain, square_cells

# Heights of up to 1e3 m over some ten operations in float64.
TOLERANCE = 1e-9
ORIGIN, SIZE = (1200.0, 5300.0), 20.0


def rough(rows=18, columns=25, gaps=0.0, seed=0):
    height = np.random.default_rng(seed).uniform(0.0, 1000.0, (rows, columns))
    height[np.random.default_rng(seed + 1).random(height.shape) < gaps] = np.nan
    return height


def plane(rows=18, columns=25, east=0.3, north=-0.1, *, device):
    x, y = twin.centers((rows, columns), (*ORIGIN, SIZE))
    return Terrain(50.0 + east * (x - ORIGIN[0]) + north * (y - ORIGIN[1]), SIZE, ORIGIN, device=device)


def inside(terrain, count=500, margin=0.0, seed=2):
    """Points in a terrain's bounds, off the edge by a margin in m."""
    west, south, east, north = terrain.bounds
    rng = np.random.default_rng(seed)
    return rng.uniform((west + margin, south + margin), (east - margin, north - margin), (count, 2))


def test_a_terrain_knows_where_it_is(device):
    t = Terrain(rough(), SIZE, ORIGIN, "EPSG:32619", device=device)
    assert t.shape == (18, 25)
    assert t.bounds == (1200.0, 5300.0 - 360.0, 1700.0, 5300.0)
    assert t.height.dtype == wp.float64 and t.device.alias == device
    np.testing.assert_array_equal(t.to_numpy(), rough())
    assert repr(t).startswith("Terrain(18 x 25 cells of 20 m, 0.5 x 0.36 km, heights ")
    assert "crs=EPSG:32619" in repr(t) and "no data" not in repr(t)
    assert "% no data" in repr(Terrain(rough(gaps=0.3), SIZE, device=device))


def test_heights_are_copied_and_copies_are_apart(device):
    height = rough()
    t = Terrain(height, SIZE, device=device)
    other, moved = t.copy(), t.to("cpu")
    height[0, 0] = t.to_numpy()[0, 0] + 1.0
    t.brush("raise", (100.0, -100.0), 60.0, 5.0)
    np.testing.assert_array_equal(other.to_numpy(), rough())
    np.testing.assert_array_equal(moved.to_numpy(), rough())
    assert not np.array_equal(t.to_numpy(), rough())
    t.to_numpy()[:] = 0.0
    assert t.to_numpy().max() > 0.0


@pytest.mark.parametrize("kind", ["list", "float32", "int16", "masked", "fortran", "warp"])
def test_heights_come_in_any_form(kind, device):
    height = np.arange(12.0).reshape(3, 4)
    forms = {
        "list": height.tolist(),
        "float32": height.astype(np.float32),
        "int16": height.astype(np.int16),
        "masked": np.ma.masked_equal(height.astype(np.int32), 5),
        "fortran": np.asfortranarray(height),
        "warp": wp.array(height, dtype=wp.float32, device=device),
    }
    t = Terrain(forms[kind], 1.0, device=device)
    if kind == "masked":
        height[1, 1] = np.nan
    np.testing.assert_array_equal(t.to_numpy(), height)


def test_a_plane_is_sampled_to_rounding(device):
    t = plane(device=device)
    xy = inside(t, margin=0.5 * SIZE)
    expected = 50.0 + 0.3 * (xy[:, 0] - ORIGIN[0]) - 0.1 * (xy[:, 1] - ORIGIN[1])
    np.testing.assert_allclose(t.sample(xy), expected, atol=TOLERANCE, rtol=0.0)
    # In the outer half cell the height of the nearest point between the centres goes on.
    edge = inside(t)
    pulled = np.clip(edge, np.add(t.bounds[:2], 0.5 * SIZE), np.subtract(t.bounds[2:], 0.5 * SIZE))
    np.testing.assert_allclose(t.sample(edge), t.sample(pulled), atol=TOLERANCE, rtol=0.0)


def test_the_gradient_of_a_plane_is_exact_out_to_the_edge(device):
    t = plane(device=device)
    gradient = t.gradient(np.concatenate([inside(t), corners(t)]))
    np.testing.assert_allclose(gradient, np.broadcast_to([0.3, -0.1], gradient.shape), atol=1e-12)
    np.testing.assert_allclose(t.slope(), math.hypot(0.3, 0.1), atol=1e-12)


def corners(t):
    west, south, east, north = t.bounds
    return [(west, south), (west, north), (east, south), (east, north), (0.5 * (west + east), north)]


def test_the_edge_belongs_to_the_terrain_and_nothing_beyond_does(device):
    t = Terrain(rough(), SIZE, ORIGIN, device=device)
    (west, south, east, north), height = t.bounds, rough()
    assert_bits(t.sample(corners(t))[:4], height[[-1, 0, -1, 0], [0, 0, -1, -1]], device, TOLERANCE)
    beyond = [
        (west - 0.1, north - 9.0),
        (east + 0.1, north - 9.0),
        (west + 9.0, south - 0.1),
        (west + 9.0, north + 0.1),
    ]
    assert np.isnan(t.sample(beyond)).all() and np.isnan(t.gradient(beyond)).all()
    # A rounding error of coordinates like those of UTM is not beyond.
    assert np.isfinite(t.sample([(np.nextafter(east, np.inf), np.nextafter(south, -np.inf))])).all()


def test_bilinear_heights_are_those_of_scipy_inside(device):
    from scipy.ndimage import map_coordinates

    t = Terrain(rough(), SIZE, ORIGIN, device=device)
    xy = inside(t)
    row, column = (ORIGIN[1] - xy[:, 1]) / SIZE - 0.5, (xy[:, 0] - ORIGIN[0]) / SIZE - 0.5
    expected = map_coordinates(rough(), [row, column], order=1, mode="nearest")
    np.testing.assert_allclose(t.sample(xy), expected, atol=1e-8, rtol=0.0)


def test_a_value_at_a_centre_is_that_of_the_cell(device):
    height = rough(gaps=0.3)
    t = Terrain(height, SIZE, (0.0, 0.0), device=device)
    x, y = twin.centers(height.shape, (0.0, 0.0, SIZE))
    assert_bits(t.sample(np.stack([x.ravel(), y.ravel()], axis=1)), height.ravel(), device, TOLERANCE)


def test_gaps_do_not_spread(device):
    """A point has a height if its own cell has one; a constant with gaps is that constant everywhere it is known."""
    height = np.where(rough(gaps=0.4) >= 0.0, 7.25, np.nan)
    t = Terrain(height, SIZE, ORIGIN, device=device)
    xy = inside(t, 2000)
    row, column = ((ORIGIN[1] - xy[:, 1]) // SIZE).astype(int), ((xy[:, 0] - ORIGIN[0]) // SIZE).astype(int)
    known = np.isfinite(height[row, column])
    found = t.sample(xy)
    np.testing.assert_array_equal(np.isfinite(found), known)
    np.testing.assert_allclose(found[known], 7.25, rtol=1e-15)
    np.testing.assert_array_equal(t.gradient(xy)[known], 0.0)
    np.testing.assert_array_equal(np.isfinite(t.slope()), np.isfinite(height))


def test_a_plane_with_gaps_keeps_its_gradient_wherever_a_cell_has_neighbours(device):
    height = plane(device="cpu").to_numpy()
    height[4:7, 4:9] = np.nan
    height[0, 0] = height[17, 3] = np.nan
    slope = Terrain(height, SIZE, ORIGIN, device=device).slope()
    np.testing.assert_allclose(slope[np.isfinite(height)], math.hypot(0.3, 0.1), atol=1e-12)


def test_the_gradient_is_continuous(device):
    """Steps of a thousandth of a cell, across cells and next to edges, change it by no more than curvature allows."""
    t = Terrain(rough(), SIZE, ORIGIN, device=device)
    path = np.linspace((ORIGIN[0] + 1.0, ORIGIN[1] - 3.0), (ORIGIN[0] + 499.0, ORIGIN[1] - 357.0), 40_000)
    largest = np.abs(np.diff(t.gradient(path), axis=0)).max()
    # Neighbouring gradients differ by at most 1000 m / cell; a step is under 1/1000 cell.
    assert largest < 3.0 * 1000.0 / SIZE / 1000.0


def test_the_gradient_converges_on_a_smooth_surface(device):
    errors = []
    for size in (40.0, 20.0, 10.0):
        count = round(2000.0 / size)
        x, y = twin.centers((count, count), (0.0, 2000.0, size))
        t = Terrain(100.0 * np.sin(x / 300.0) * np.cos(y / 250.0), size, (0.0, 2000.0), device=device)
        xy = inside(t, margin=100.0)
        exact = np.stack(
            [
                100.0 / 300.0 * np.cos(xy[:, 0] / 300.0) * np.cos(xy[:, 1] / 250.0),
                -100.0 / 250.0 * np.sin(xy[:, 0] / 300.0) * np.sin(xy[:, 1] / 250.0),
            ],
            axis=1,
        )
        errors.append(np.abs(t.gradient(xy) - exact).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 1.8).all(), orders


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.integers(2, 9), st.integers(2, 9), st.floats(0.0, 0.7))
def test_flips_and_turns_of_a_terrain_turn_what_is_sampled(device, seed, rows, columns, gaps):
    height = rough(rows, columns, gaps, seed)
    if np.isnan(height).all():
        return
    xy = np.random.default_rng(seed).uniform((-1.0, -1.0), (columns + 1.0, rows + 1.0), (50, 2))
    t = Terrain(height, 1.0, (0.0, rows), device=device)
    value, gradient = t.sample(xy), t.gradient(xy)
    cases = [
        (height[:, ::-1], xy * (-1, 1) + (columns, 0), gradient * (-1, 1), rows),
        (height[::-1], xy * (1, -1) + (0, rows), gradient * (1, -1), rows),
        # The transpose about the main diagonal of the array: x becomes rows - y, and y becomes columns - x.
        (height.T, np.stack([rows - xy[:, 1], columns - xy[:, 0]], axis=1), -gradient[:, ::-1], columns),
    ]
    for turned, at, expected, north in cases:
        other = Terrain(turned, 1.0, (0.0, north), device=device)
        np.testing.assert_allclose(other.sample(at), value, atol=TOLERANCE, rtol=0.0)
        np.testing.assert_allclose(other.gradient(at), expected, atol=TOLERANCE, rtol=0.0)
        assert np.nanmax(np.abs(np.sort(other.slope(), axis=None) - np.sort(t.slope(), axis=None))) < TOLERANCE


def test_no_points_are_no_trouble(device):
    t = plane(device=device)
    assert t.sample(np.empty((0, 2))).shape == (0,) and t.gradient(np.empty((0, 2))).shape == (0, 2)


def test_raising_adds_the_volume_of_the_brush(device):
    """The integral of 1 - 3 p^2 + 2 p^3 over the disk is 3/10 of it."""
    t = Terrain(np.zeros((200, 200)), 1.0, (0.0, 200.0), device=device)
    t.brush("raise", (97.3, 104.8), 80.0, 25.0)
    raised = t.to_numpy()
    assert raised.sum() == pytest.approx(0.3 * math.pi * 80.0**2 * 25.0, rel=1e-4)
    assert raised.max() == pytest.approx(25.0, rel=1e-3)
    x, y = twin.centers((200, 200), (0.0, 200.0, 1.0))
    assert (raised[np.hypot(x - 97.3, y - 104.8) >= 80.0] == 0.0).all()
    t.brush("lower", (97.3, 104.8), 80.0, 25.0)
    np.testing.assert_allclose(t.to_numpy(), 0.0, atol=1e-14)


def test_smoothing_leaves_planes_and_flattens_bumps(device):
    t = plane(device=device)
    t.brush("smooth", (1250.0, 5290.0), 150.0, 1.0)
    np.testing.assert_allclose(t.to_numpy(), plane(device="cpu").to_numpy(), atol=TOLERANCE, rtol=0.0)
    bumpy = Terrain(rough(60, 60), SIZE, ORIGIN, device=device)
    bumpy.brush("smooth", (1800.0, 4700.0), 500.0, 1.0)
    near = (slice(25, 35), slice(25, 35))
    assert bumpy.to_numpy()[near].std() < 0.3 * rough(60, 60)[near].std()
    assert bumpy.to_numpy()[near].mean() == pytest.approx(rough(60, 60)[15:45, 15:45].mean(), rel=0.15)
    assert rough(60, 60).min() <= bumpy.to_numpy().min() and bumpy.to_numpy().max() <= rough(60, 60).max()
    np.testing.assert_array_equal(bumpy.to_numpy()[:, 56:], rough(60, 60)[:, 56:])


def test_smoothing_near_gaps_stays_within_the_heights_and_keeps_the_gaps(device):
    height = rough(40, 40, gaps=0.3)
    t = Terrain(height, 1.0, device=device)
    for _ in range(5):
        t.brush("smooth", (20.0, -20.0), 30.0, 1.0)
    np.testing.assert_array_equal(np.isnan(t.to_numpy()), np.isnan(height))
    assert np.nanmin(height) <= np.nanmin(t.to_numpy()) <= np.nanmax(t.to_numpy()) <= np.nanmax(height)


def test_flattening_goes_to_the_level_or_to_the_height_at_the_centre(device):
    t = Terrain(rough(50, 50), 10.0, (0.0, 500.0), device=device)
    t.brush("flatten", (255.0, 245.0), 200.0, 1.0, level=123.0)
    assert t.to_numpy()[25, 25] == pytest.approx(123.0)
    t = Terrain(rough(50, 50), 10.0, (0.0, 500.0), device=device)
    t.brush("flatten", (255.0, 245.0), 200.0, 1.0)
    assert t.to_numpy()[25, 25] == pytest.approx(rough(50, 50)[25, 25])
    assert t.to_numpy()[23:28, 23:28].std() < 0.2 * rough(50, 50)[23:28, 23:28].std()
    for _ in range(60):
        t.brush("flatten", (255.0, 245.0), 200.0, 1.0, level=50.0)
    near = t.to_numpy()[23:28, 23:28]
    np.testing.assert_allclose(near, 50.0, atol=1e-3)


def test_brushes_off_the_terrain_and_between_the_centres_do_nothing(device):
    t = Terrain(rough(), SIZE, ORIGIN, device=device)
    for kind in ("raise", "lower", "smooth", "flatten"):
        t.brush(kind, (-1e6, 0.0), 100.0, 0.5, level=0.0)
        t.brush(kind, (1200.0, 5300.0), 1.0, 0.5, level=0.0)
    t.add_ridge([(0.0, 0.0), (100.0, 0.0)], 100.0, 50.0)
    np.testing.assert_array_equal(t.to_numpy(), rough())


def test_edits_of_parts_that_leave_the_terrain_are_cut_at_its_edge(device):
    whole = Terrain(np.zeros((60, 60)), 1.0, (0.0, 60.0), device=device)
    part = whole.crop((20.0, 20.0, 60.0, 60.0))
    for t in (whole, part):
        t.brush("raise", (22.0, 38.0), 15.0, 4.0)
        t.add_ridge([(10.0, 30.0), (50.0, 70.0)], [5.0, 10.0], 12.0)
        t.brush("flatten", (21.0, 50.0), 9.0, 0.5, level=3.0)
    np.testing.assert_array_equal(part.to_numpy(), whole.to_numpy()[:40, 20:])


def test_a_ridge_has_its_volume_and_crest(device):
    """Along a straight line of length L: half of width times height times L, and the brush's volume at its two ends."""
    t = Terrain(np.zeros((100, 300)), 1.0, (0.0, 100.0), device=device)
    t.add_ridge([(60.0, 50.0), (240.0, 50.0)], 30.0, 60.0)
    ends = 0.3 * math.pi * 30.0**2 * 30.0
    assert t.to_numpy().sum() == pytest.approx(180.0 * 0.5 * 60.0 * 30.0 + ends, rel=1e-3)
    assert t.sample([(150.0, 50.0)])[0] == pytest.approx(30.0, rel=1e-2)
    t.add_ridge([(60.0, 50.0), (240.0, 50.0)], [-30.0, -30.0], 60.0)
    np.testing.assert_allclose(t.to_numpy(), 0.0, atol=1e-12)


def test_coarser_cells_keep_the_volume_and_finer_ones_the_heights(device):
    height = rough(24, 36)
    t = Terrain(height, 10.0, (500.0, 900.0), "EPSG:32619", device=device)
    coarse = t.resampled(40.0)
    assert coarse.shape == (6, 9) and coarse.bounds == t.bounds and coarse.crs == t.crs and coarse.cell_size == 40.0
    assert coarse.to_numpy().sum() * 1600.0 == pytest.approx(height.sum() * 100.0, rel=1e-13)
    fine = t.resampled(10.0 / 3.0)
    assert fine.shape == (72, 108)
    np.testing.assert_allclose(fine.to_numpy()[1::3, 1::3], height, atol=TOLERANCE, rtol=0.0)
    np.testing.assert_array_equal(t.resampled(10.0).to_numpy(), height)
    odd = t.resampled(27.0)
    assert odd.shape == (9, 13) and odd.origin == t.origin


def test_a_plane_stays_a_plane_on_other_cells(device):
    t = plane(40, 50, device=device)
    for size in (7.0, 50.0):
        other = t.resampled(size)
        inner = other.to_numpy()[4:-4, 4:-4]
        x, y = twin.centers(other.shape, (*ORIGIN, size))
        expected = 50.0 + 0.3 * (x - ORIGIN[0]) - 0.1 * (y - ORIGIN[1])
        np.testing.assert_allclose(inner, expected[4:-4, 4:-4], atol=TOLERANCE, rtol=0.0)


def test_resampling_keeps_gaps_where_they_are(device):
    height = rough(20, 20)
    height[:10, :10] = np.nan
    for size, gap in ((5.0, slice(0, 40)), (40.0, slice(0, 5))):
        other = Terrain(height, 20.0, device=device).resampled(size).to_numpy()
        expected = np.zeros(other.shape, bool)
        expected[gap, gap] = True
        np.testing.assert_array_equal(np.isnan(other), expected)


def test_a_crop_is_the_cells_with_centres_in_the_box(device):
    t = Terrain(rough(), SIZE, ORIGIN, "EPSG:32619", device=device)
    part = t.crop((1245.0, 5005.0, 1395.0, 5255.0))
    np.testing.assert_array_equal(part.to_numpy(), rough()[2:15, 2:10])
    assert part.bounds == (1240.0, 5000.0, 1400.0, 5260.0) and part.crs == t.crs
    np.testing.assert_array_equal(t.crop(t.bounds).to_numpy(), rough())
    np.testing.assert_array_equal(t.crop((-1e9, -1e9, 1e9, 1e9)).to_numpy(), rough())
    xy = inside(part, margin=0.5 * SIZE)
    np.testing.assert_allclose(part.sample(xy), t.sample(xy), atol=TOLERANCE, rtol=0.0)
    part.brush("raise", (1300.0, 5100.0), 100.0, 5.0)
    np.testing.assert_array_equal(t.to_numpy(), rough())


def test_square_cells_from_oblong_ones(device):
    """A plane on cells of 75 x 92 m is the same plane on square ones."""
    row, column = np.indices((60, 70))
    height = 3.0 * (column + 0.5) * 75.0 - 2.0 * (row + 0.5) * 92.0
    square = square_cells(height, 75.0, 92.0, 80.0, device=device)
    assert square.shape == (69, 66)
    row, column = np.indices(square.shape)
    exact = 3.0 * (column + 0.5) * 80.0 - 2.0 * (row + 0.5) * 80.0
    # Along the columns, 75 -> 80 m, the area mean applies: exact on a plane away from the edge all the same.
    np.testing.assert_allclose(square[2:-2, 2:-2], exact[2:-2, 2:-2], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_kernels_can_look_up_points_that_are_relative_to_a_network(dtype, device):
    """``grid`` places a terrain in a network's own coordinates, which keeps float32 exact far from zero."""
    from warpriver.device import PRECISIONS
    from warpriver.kernels import terrain as kernels

    x, y = twin.centers((50, 50), (4.5e5, 5.1e6, 30.0))
    t = Terrain(0.25 * (x - 4.5e5) - 0.125 * (y - 5.1e6), 30.0, (4.5e5, 5.1e6), device=device)
    line = np.column_stack([np.linspace(4.502e5, 4.512e5, 30), np.full(30, 5.0994e6)])
    network = RiverNetwork.from_polylines([line], width=50.0, dtype=dtype, device=device)
    scalar, vec2, _ = PRECISIONS[dtype]
    out = wp.empty(30, dtype=vec2, device=device)
    inputs = [t.height, t.grid(dtype, network.origin), network.point_xy]
    wp.launch(kernels.build(scalar).sample_gradients, dim=30, inputs=inputs, outputs=[out], device=device)
    np.testing.assert_allclose(out.numpy(), np.broadcast_to([0.25, -0.125], (30, 2)), atol=1e-6)


BAD = [
    ({"height": np.zeros(5)}, r"its shape is \(5,\).*at least 2 of each"),
    ({"height": np.zeros((1, 9))}, r"its shape is \(1, 9\)"),
    ({"height": np.zeros((9, 1))}, r"its shape is \(9, 1\)"),
    ({"height": np.zeros((2, 2, 2))}, "its shape is"),
    ({"height": 3.0}, "its shape is"),
    ({"height": [[1.0, 2.0], [3.0]]}, "height cannot be used"),
    ({"height": [["a", "b"], ["c", "d"]]}, "height cannot be used"),
    ({"height": np.full((3, 3), np.nan)}, "NaN in every cell"),
    ({"height": np.ma.masked_all((3, 3))}, "NaN in every cell"),
    ({"height": [[1.0, np.inf], [0.0, -np.inf]]}, "infinite in 2 cells, the first at row 0, column 1"),
    ({"cell_size": 0.0}, "cell_size is 0; give a positive number of m"),
    ({"cell_size": -3.0}, "cell_size is -3"),
    ({"cell_size": math.nan}, "cell_size is nan"),
    ({"cell_size": "wide"}, "cell_size is 'wide'"),
    ({"origin": (1.0, math.inf)}, "origin is .*2 finite numbers"),
    ({"origin": 7.0}, "origin is 7; give"),
    ({"origin": (1.0, 2.0, 3.0)}, "origin is"),
    ({"crs": "EPSG:4326"}, 'longitude and latitude, not metres.*to_crs="utm"'),
    ({"crs": 'GEOGCS["WGS 84",DATUM["WGS_1984"]]'}, "longitude and latitude"),
    ({"crs": "mars"}, "crs: pyproj does not know the CRS 'mars'"),
    ({"crs": 32619}, "crs is 32619; give a text"),
    ({"crs": "EPSG:2263"}, "crs: EPSG:2263 is in US survey foot, not metres"),
    ({"device": "cuda:99"}, "'cuda:99' is not on this machine"),
]


@pytest.mark.parametrize(("change", "text"), BAD)
def test_bad_input_is_told_in_one_sentence(change, text):
    with pytest.raises(ValueError, match=text) as caught:
        Terrain(**({"height": np.zeros((3, 3)), "cell_size": 1.0} | change))
    assert "\n" not in str(caught.value)


EDITS = [
    (("brush", "erase", (0.0, 0.0), 1.0, 1.0), "brush kind is 'erase'; use one of raise, lower, smooth, flatten"),
    (("brush", "raise", (0.0,), 1.0, 1.0), "center is"),
    (("brush", "raise", (0.0, math.nan), 1.0, 1.0), "center is"),
    (("brush", "raise", (0.0, 0.0), 0.0, 1.0), "radius is 0"),
    (("brush", "raise", (0.0, 0.0), 1.0, -1.0), "amount is -1.0; to raise give m, 0 or more"),
    (("brush", "smooth", (0.0, 0.0), 1.0, 1.5), "amount is 1.5; to smooth give a fraction, 0 to 1"),
    (("brush", "raise", (0.0, 0.0), 1.0, math.nan), "amount is nan"),
    (("brush", "flatten", (9e9, 0.0), 1.0, 1.0), "no height at the centre"),
    (("add_ridge", [(0.0, 0.0)], 1.0, 1.0), "line has 1 points"),
    (("add_ridge", [(0.0, 0.0), (0.0, 0.0)], 1.0, 1.0), "none of them twice in a row"),
    (("add_ridge", [(0.0, 0.0), (1.0, 0.0)], [1.0, 2.0, 3.0], 1.0), "height is .*give 2 finite numbers"),
    (("add_ridge", [(0.0, 0.0), (1.0, 0.0)], 1.0, -1.0), "width is -1"),
    (("add_ridge", [(0.0, math.nan), (1.0, 0.0)], 1.0, 1.0), "line holds a point that is not finite"),
    (("resampled", 0.0), "cell_size is 0"),
    (("resampled", 400.0), "leaves 1 x 1 cells"),
    (("crop", (0.0, 0.0, 1.0)), "bounds is"),
    (("crop", (0.0, 0.0, 1.0, 1.0)), "fewer than 2 x 2 cells of the terrain, which lies within"),
    (("crop", (1700.0, 4940.0, 1200.0, 5300.0)), "fewer than 2 x 2"),
    (("sample", [1.0, 2.0]), r"xy has shape \(2,\)"),
    (("sample", [["a", "b"]]), "xy is .*; give .n, 2. x, y in metres"),
]


@pytest.mark.parametrize(("call", "text"), EDITS)
def test_bad_calls_are_told_and_change_nothing(call, text, device):
    t = Terrain(rough(), SIZE, ORIGIN, device=device)
    with pytest.raises(ValueError, match=text):
        getattr(t, call[0])(*call[1:])
    np.testing.assert_array_equal(t.to_numpy(), rough())


def test_a_terrain_that_cannot_fit_is_refused_before_anything_is_allocated():
    # A billion and more cells that take no memory themselves: every stride is 0.
    giant = np.broadcast_to(np.float32(1.0), (400_000, 400_000))
    with pytest.raises(MemoryError, match=r"a terrain of 400000 x 400000 cells needs .* GB and .* are free on cpu"):
        Terrain(giant, 1.0)
    with pytest.raises(MemoryError, match="GB are free"):
        plane(device="cpu").resampled(1e-4)


def test_a_billion_cells_are_refused_where_there_is_no_memory(monkeypatch):
    monkeypatch.setattr(device_module, "available_memory", lambda device: 4_000_000_000)
    with pytest.raises(MemoryError, match="31623 x 31623 cells needs 17 GB and 4 GB are free"):
        Terrain(np.broadcast_to(np.float32(1.0), (31_623, 31_623)), 1.0)
    require_memory((10, 10), 8)
    monkeypatch.setattr(device_module, "available_memory", lambda device: None)
    require_memory((10**6, 10**6), 8)


def test_the_system_tells_its_memory_or_nothing():
    free = available_memory("cpu")
    assert free is None or 1e6 < free < 1e14


def test_a_terrain_of_one_value_is_level(device):
    t = Terrain(np.full((5, 6), 3.0), 10.0, device=device)
    assert (t.slope() == 0.0).all()
    assert_bits(t.sample([(12.3, -17.1)]), 3.0, device, TOLERANCE)
    assert "heights 3 to 3 m" in repr(t)
