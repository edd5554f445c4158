"""Synthetic valleys: the figures of the paper, pools and riffles, the surface and what it may not do."""

import itertools
import math

import numpy as np
import pytest
from plain import plain_params
from reference_valley import section_depth
from scipy.integrate import trapezoid

import warpriver as wr
from warpriver import generate
from warpriver import valley as g

NAMES = ("S1", "S2", "S3", "S4", "S5", "S6")
# What the paper's Tables 3 and 4 must give, to the digits it has: sinuosity, depth, W/H, confinement, width and depth
# ranges, mean c(z_T, W) and c(z_T, |C|). Slopes and grain sizes are those before rounding.
EXPECTED = {
    "S1": (1.0000, 2.1120, 14.2045, 0.3750, 22.50, 37.50, 2.112, 3.168, 1.0000, None),
    "S2": (1.0000, 1.1264, 8.8778, 0.8333, 7.50, 12.50, 1.126, 5.632, -1.0000, None),
    "S3": (1.1278, 1.0560, 28.4091, 0.2308, 22.50, 37.50, 1.056, 3.168, 1.0000, -0.976),
    "S4": (1.0125, 1.1264, 8.8778, 0.8333, 7.50, 12.50, 1.126, 5.632, -1.0000, 0.000),
    "S5": (1.1672, 2.1120, 23.6742, 0.2857, 29.06, 75.00, 2.112, 12.062, -0.6015, -0.340),
    "S6": (1.0687, 2.1120, 23.6742, 0.1818, 29.61, 74.82, 2.112, 9.248, 0.9295, -0.398),
}


@pytest.fixture(scope="module")
def examples(device):
    return {name: wr.synthetic_valley(name, device=device) for name in NAMES}


def sampled(valley, name):
    """A series of the reach."""
    return getattr(valley.stations, name)[valley.stations.reach]


# ---- figures


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("stationing", ["channel", "valley"])
def test_figures_of_the_paper(name, stationing):
    valley = wr.synthetic_valley(name, stationing=stationing)
    sinuosity, depth, ratio, confinement, *ranges, width_mean, curvature_mean = EXPECTED[name]
    # Half a unit of the last digit, and a little for figures that lie on the half (12.0625, 9.2475).
    assert valley.sinuosity == pytest.approx(sinuosity, abs=0.5e-4)
    assert valley.bankfull_depth == pytest.approx(depth, abs=0.5e-4)
    assert valley.params.width_to_depth == pytest.approx(ratio, abs=0.5e-4)
    assert valley.params.confinement == pytest.approx(confinement, abs=0.5e-4)
    width, local = sampled(valley, "width"), sampled(valley, "depth")
    np.testing.assert_allclose([width.min(), width.max()], ranges[:2], atol=0.5e-2)
    # Stations are up to half an increment off the extremes of the functions: 3e-4 m.
    np.testing.assert_allclose([local.min(), local.max()], ranges[2:], atol=0.5e-3 + 3e-4)
    found = valley.covariance
    assert found.mean_thalweg_width == pytest.approx(width_mean, abs=0.5e-4)
    if curvature_mean is None:
        assert math.isnan(found.mean_thalweg_curvature)
    else:
        assert found.mean_thalweg_curvature == pytest.approx(curvature_mean, abs=0.5e-3)


def test_the_network_carries_width_and_depth(examples):
    for name, valley in examples.items():
        network = valley.network
        width, depth = network.point_widths()[0], network.point_depths()[0]
        np.testing.assert_allclose([width.min(), width.max()], EXPECTED[name][4:6], atol=0.5e-2)
        np.testing.assert_allclose([depth.min(), depth.max()], EXPECTED[name][6:8], atol=0.8e-3)
        assert network.point_count == 785
        assert wr.metrics.sinuosity(network.polylines()[0]) == pytest.approx(
            np.hypot(*np.diff(network.polylines()[0], axis=0).T).sum()
            / np.hypot(*(network.polylines()[0][-1] - network.polylines()[0][0]))
        )


def test_depth_by_the_shields_stress():
    params = wr.valley.ValleyParams(grain_size=0.05, slope=0.004, shields=0.045, submerged_gravity=1.6)
    assert params.bankfull_depth == pytest.approx(1.6 * 0.05 * 0.045 / 0.004, rel=1e-15)
    assert wr.valley.ValleyParams(depth=3.5).bankfull_depth == 3.5


def test_sinuosity_converges_to_the_integral(examples):
    x = np.linspace(0.0, 1.0, 400_001)
    slope = 50.0 / 420.0 * 2.0 * np.pi * np.cos(2.0 * np.pi * x)
    assert examples["S3"].sinuosity == pytest.approx(trapezoid(np.hypot(1.0, slope), x), rel=1e-7)


# ---- pools and riffles


@pytest.mark.parametrize(
    ("name", "riffles", "pools"),
    [
        # Thalweg 0.25 sin(2 pi u): 1/4 and 3/4; 2 sin(4 pi u + pi): 3/8, 7/8 and 1/8, 5/8; and so on.
        ("S1", [0.25], [0.75]),
        ("S2", [0.375, 0.875], [0.125, 0.625]),
        ("S3", [0.5], [0.25, 0.75]),
        ("S4", [0.125, 0.625], [0.375, 0.875]),
    ],
)
def test_riffles_and_pools_lie_where_the_formulas_put_them(examples, name, riffles, pools):
    valley = examples[name]
    residual = sampled(valley, "residual")
    u = np.linspace(0.0, 1.0, len(residual))
    inner = np.arange(1, len(u) - 1)
    highs = [u[i] for i in inner if residual[i] >= max(residual[i - 1], residual[i + 1])]
    lows = [u[i] for i in inner if residual[i] <= min(residual[i - 1], residual[i + 1])]
    np.testing.assert_allclose(highs, riffles, atol=1.0 / 784)
    np.testing.assert_allclose(lows, pools, atol=1.0 / 784)


@pytest.mark.parametrize("given", ["control", "planform"])
def test_pools_lie_at_the_outer_bank_of_both_turns(given, device):
    """S3 turns right about x = 105 m and left about 315 m; the deepest place is left there, and right here."""
    controls = dict(wr.synthetic_valley("S3").params.controls)
    if given == "planform":
        controls.pop("curvature")
    valley = wr.synthetic_valley("S3", controls=controls, device=device)
    line = valley.stations.line
    for x, turn in ((105.0, -1.0), (315.0, 1.0)):
        k = int(np.abs(line.xy[:, 0] - x).argmin())
        assert np.sign(line.curvature[k]) == turn
        n = np.linspace(-11.0, 11.0, 2001)
        normal = np.array([-line.tangent[k, 1], line.tangent[k, 0]])
        height = valley.height(line.xy[k] + n[:, None] * normal)
        deepest = n[height.argmin()]
        # Left is above 0: the outer bank of a right turn is the left one.
        assert np.sign(deepest) == -turn
        apex = 0.5 * (1.0 - turn / 1.2) if turn < 0 else 0.5 * (1.0 + 1.0 / 1.2)
        expected = 0.5 * valley.stations.width[k] * (1.0 - 2.0 * apex)
        assert abs(deepest) == pytest.approx(abs(expected), abs=0.15)
        assert (valley._plane(line.xy[k, 0]) - height).max() == pytest.approx(valley.stations.depth[k], abs=2e-3)


def test_stationing_by_the_channel_keeps_pools_at_bends():
    """By s / L_s the pools of S3 are at its apices; by 2 pi s / L_x they would be 13 % of the way off."""
    valley = wr.synthetic_valley("S3")
    line, reach = valley.stations.line, valley.stations.reach
    pool = np.flatnonzero(np.diff(np.sign(np.diff(sampled(valley, "residual")))) > 0) + 1
    apex = [np.abs(line.xy[reach, 0] - x).argmin() for x in (105.0, 315.0)]
    assert np.abs(pool - apex).max() <= 1


# ---- the section


@pytest.mark.parametrize("curvature", [-0.8, -0.3, 0.0, 0.5, 0.9])
def test_section_area_and_depth_by_the_closed_forms(curvature, device):
    """Deutsch and Wang: greatest depth exactly h at Y = a; area over width times depth is 4 k / ((k + 1) (2 k + 1))."""
    apex = 0.5 + 0.5 * curvature / 1.2
    side = min(apex, 1.0 - apex)
    k = -math.log(2.0) / math.log(side)
    valley = wr.synthetic_valley("S1", controls={}, device=device)
    valley.stations.apex[:] = apex
    n = np.linspace(-15.0 + 1e-9, 15.0 - 1e-9, 60_001)
    depth = valley._plane(210.0) - valley.height(np.column_stack([np.full_like(n, 210.0), n]))
    h = valley.bankfull_depth
    assert depth.max() == pytest.approx(h, rel=1e-6)
    assert n[depth.argmax()] == pytest.approx(15.0 * (1.0 - 2.0 * apex), abs=0.05)
    area = trapezoid(depth, n) / (30.0 * h)
    # 60,000 trapezoids; against the outer bank the section is as steep as Y^(k - 1), k = 0.3.
    assert area == pytest.approx(4.0 * k / ((k + 1.0) * (2.0 * k + 1.0)), rel=2e-3)


@pytest.mark.parametrize(
    ("section", "area"),
    [
        (g.CrossSection("rectangle"), 1.0),
        (g.CrossSection("triangle"), 0.5),
        (g.CrossSection("trapezoid", flat=0.4), 0.7),
        (g.CrossSection("semicircle"), math.pi / 4.0),
        (g.CrossSection("polynomial", exponent=2.0), 2.0 / 3.0),
        (g.CrossSection("polynomial", exponent=4.0), 4.0 / 5.0),
    ],
    ids=["rectangle", "triangle", "trapezoid", "semicircle", "parabola", "quartic"],
)
def test_areas_of_other_sections(section, area, device):
    valley = wr.synthetic_valley("S1", controls={}, section=section, device=device)
    n = np.linspace(-15.0 + 1e-9, 15.0 - 1e-9, 20_001)
    depth = valley._plane(210.0) - valley.height(np.column_stack([np.full_like(n, 210.0), n]))
    assert trapezoid(depth, n) / (30.0 * valley.bankfull_depth) == pytest.approx(area, rel=1e-4)
    assert depth.max() == pytest.approx(valley.bankfull_depth, rel=1e-6)


def test_weibull_section_has_its_threads(device):
    threads = ((0.02, 0.2, 2.5, 1.0), (0.55, 0.2, 2.5, 0.6))
    valley = wr.synthetic_valley("S1", controls={}, section=g.CrossSection("weibull", threads=threads), device=device)
    y = np.linspace(1e-6, 1.0 - 1e-6, 4001)
    place = np.column_stack([np.full_like(y, 210.0), 15.0 * (1.0 - 2.0 * y)])
    depth = (valley._plane(210.0) - valley.height(place)) / valley.bankfull_depth
    peaks = np.flatnonzero((depth[1:-1] > depth[:-2]) & (depth[1:-1] > depth[2:])) + 1
    mode = 0.2 * (1.5 / 2.5) ** (1.0 / 2.5)
    np.testing.assert_allclose(y[peaks], [0.02 + mode, 0.55 + mode], atol=1e-3)
    np.testing.assert_allclose(depth[peaks], [1.0, 0.6], atol=1e-3)
    np.testing.assert_allclose(depth, [section_depth(4, v, 0.5, threads=threads) for v in y], atol=1e-9)


# ---- the surface


@pytest.mark.parametrize("name", NAMES)
def test_raster_and_curvilinear_evaluation_agree(examples, name):
    """The same ground whether a section is laid out or a place finds its section: banks, where it is a matter of
    rounding on which side a place lies, are left out by 1e-6 of the width."""
    valley = examples[name]
    grid = valley.grid(valley.params.width / 60.0)
    banks = grid.xyz[:, grid.banks[0] + 1 : grid.banks[1]].reshape(-1, 3)
    inside = banks[(banks[:, 0] >= 0.0) & (banks[:, 0] <= valley.params.length)]
    np.testing.assert_allclose(valley.height(inside[:, :2]), inside[:, 2], atol=1e-8)
    # And the raster is the surface at its cells' centres.
    terrain = valley.terrain
    rows, columns = np.meshgrid(*(np.arange(n)[::7] for n in terrain.shape), indexing="ij")
    west, north = terrain.origin
    x, y = west + (columns + 0.5) * terrain.cell_size, north - (rows + 0.5) * terrain.cell_size
    height = valley.height(np.column_stack([x.ravel(), y.ravel()]))
    np.testing.assert_allclose(terrain.to_numpy()[rows, columns].ravel(), height, atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_the_surface_has_no_gap_and_lies_within_its_elements(examples, name):
    valley = examples[name]
    height = valley.terrain.to_numpy()
    assert np.isfinite(height).all()
    lines, params = valley.lines, valley.params
    top = valley._plane(0.0) + (lines.table[:, 4] + lines.table[:, 5]).max()
    lowest = (sampled(valley, "thalweg") + valley._plane(valley.stations.line.xy[valley.stations.reach, 0])).min()
    assert height.max() <= top + 1e-9
    # Sections level with the plane across, not along x: a place beside the thalweg is lower by slope times its offset.
    assert height.min() >= lowest - params.slope * 0.5 * sampled(valley, "width").max()


@pytest.mark.parametrize("name", NAMES)
def test_no_ground_outside_the_channel_is_below_top_of_bank(examples, name):
    valley = examples[name]
    rng = np.random.default_rng(5)
    west, south, east, north = valley.bounds
    places = np.column_stack([rng.uniform(west, east, 20_000), rng.uniform(south, north, 20_000)])
    rise = valley.height(places) - valley._plane(places[:, 0])
    stations = valley.stations
    line = stations.line.xy
    from scipy.spatial import cKDTree

    distance, near = cKDTree(line).query(places)
    outside = distance > 0.5 * stations.width[near] * 1.02 + 0.05
    assert outside.sum() > 1000
    assert rise[outside].min() >= -1e-9


@pytest.mark.parametrize("name", NAMES)
def test_the_surface_is_continuous_across_banks_floor_and_sides(examples, name):
    """On lines across the valley neighbours 1 to 4 mm apart differ by no more than the steepest ground allows.

    Outside the banks that is the steeper of the floor, at its narrowest, and the valley sides; in the channel the
    section itself, 4 h Y^k at the outer bank. A step where places change from one bend to the next would be told.
    """
    valley = examples[name]
    p = valley.params
    steepest = max(2.0 * p.floor_height / p.floor_width, 2.0 * p.top_height / p.top_width) + p.slope
    apex, depth, width = (sampled(valley, k) for k in ("apex", "depth", "width"))
    k = -math.log(2.0) / math.log(min(apex.min(), 1.0 - apex.max()))
    _, south, _, north = valley.bounds
    y = np.linspace(south, north, 320_001)
    step = y[1] - y[0]
    for part in (0.13, 0.25, 0.37, 0.5, 0.62, 0.75, 0.88):
        x = part * p.length
        rise = valley.height(np.column_stack([np.full_like(y, x), y])) - valley._plane(x)
        difference = np.abs(np.diff(rise))
        outside = (rise[1:] >= -1e-9) & (rise[:-1] >= -1e-9)
        # Floor edges run at an angle to y and the floor's rise bends: a fifth more.
        assert difference[outside].max() <= 1.2 * steepest * step + 1e-9
        assert difference[~outside].max() <= 4.0 * depth.max() * (step / width.min()) ** k


@pytest.mark.parametrize("name", ["S3", "S5"])
def test_the_surface_converges_with_the_increments(name, device):
    """Second order or better in the increment of the stations."""
    rng = np.random.default_rng(1)
    finest = wr.synthetic_valley(name, increments=12_544, device=device)
    west, _, east, _ = finest.bounds
    x = rng.uniform(west + 20.0, east - 20.0, 3000)
    middle = np.interp(x, finest.stations.line.xy[:, 0], finest.stations.line.xy[:, 1])
    places = np.column_stack([x, middle + rng.uniform(-8.0, 8.0, 3000)])
    errors = []
    for count in (98, 196, 392):
        height = wr.synthetic_valley(name, increments=count, device=device).height(places)
        errors.append(float(np.sqrt(np.mean((height - finest.height(places)) ** 2))))
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert errors[-1] < 1e-3
    assert min(orders) > 1.8


def test_sharp_bends_are_refused_by_station_or_blended(device):
    with pytest.raises(ValueError, match=r"S3: at station (118|355)\.\d m the width, 225 m, exceeds twice the radius"):
        wr.synthetic_valley("S3", width=300.0)
    controls = {"centerline": (g.sine(25.0, 4),)}
    with pytest.raises(ValueError, match="exceeds twice the radius of the bend"):
        wr.synthetic_valley("S3", width=60.0, controls=controls)
    valley = wr.synthetic_valley("S3", width=60.0, controls=controls, sharp_bends="blend", device=device)
    half, curvature = valley.stations.half, valley.stations.line.curvature
    inner = np.where(curvature > 0.0, half[:, 0], half[:, 1])
    assert (np.abs(curvature) * inner).max() < 0.9
    grid = valley.grid(2.0)
    xy = grid.xyz[:, grid.banks[0] : grid.banks[1] + 1, :2]
    along, across = np.diff(xy, axis=0)[:, :-1], np.diff(xy, axis=1)[:-1]
    # Columns run from left to right: a quad that is not folded has them clockwise from the flow.
    assert (along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]).max() < 0.0


@pytest.mark.parametrize("name", NAMES)
def test_no_section_of_the_examples_crosses_the_next(examples, name):
    xyz = examples[name].grid().xyz
    grid = examples[name].grid()
    xy = xyz[:, grid.banks[0] : grid.banks[1] + 1, :2]
    along, across = np.diff(xy, axis=0)[:, :-1], np.diff(xy, axis=1)[:-1]
    assert (along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]).max() < 0.0


def test_valley_edges_by_their_equations(examples):
    """Eqs 9 to 12 with left at +y, and heights 16 and 17 with the slope added once."""
    valley = examples["S5"]
    p, table = valley.params, valley.lines.table
    x = np.linspace(0.0, 1.0, len(table))
    f = 75.0 * np.sin(2 * np.pi * 1.5 * x) + 25.0 * np.cos(2 * np.pi * 4 * x + np.pi)
    dense = np.linspace(0.0, 1.0, 200_001)
    least = (75.0 * np.sin(2 * np.pi * 1.5 * dense) + 25.0 * np.cos(2 * np.pi * 4 * dense + np.pi)).min()
    bank = valley.breaklines()["left_bank"]
    highest = bank[(bank[:, 0] >= 0.0) & (bank[:, 0] <= 1000.0), 1].max()
    np.testing.assert_allclose(table[:, 0], f + 0.5 * p.floor_width + highest - least, atol=0.05)
    np.testing.assert_allclose(table[:, 1] - table[:, 0], 50.0)
    lines = valley.breaklines()
    np.testing.assert_allclose(lines["left_floor"][:, 2] - lines["left_floor"][-1, 2], 0.001 * (1000.0 - 1000.0 * x))
    np.testing.assert_allclose(lines["right_top"][:, 2] - lines["right_floor"][:, 2], 10.0)
    np.testing.assert_allclose(lines["right_floor"][:, 2] - valley._plane(1000.0 * x), 4.0)


def test_thalweg_and_bank_by_their_equations(examples):
    """Eqs 13 to 15: z_T = H f + H + S (L - x) + Z_D; top of bank is H above the highest thalweg over the same slope."""
    valley = examples["S1"]
    h = valley.bankfull_depth
    x = np.linspace(5.0, 415.0, 83)
    f = 0.25 * np.sin(2.0 * np.pi * x / 420.0)
    middle = valley.height(np.column_stack([x, np.zeros_like(x)]))
    np.testing.assert_allclose(middle, h * f + h + 0.002 * (420.0 - x) + 1000.0, atol=1e-4)
    floor = valley.height(np.column_stack([x, np.full_like(x, 24.0)]))
    np.testing.assert_allclose(floor, 0.25 * h + h + h + 0.002 * (420.0 - x) + 1000.0, atol=1e-9)


def test_a_steeper_valley_and_terraces(device):
    valley = wr.synthetic_valley(
        "S1", valley_slope=0.01, floor_height=1.0, terraces=4, floor_width=100.0, device=device
    )
    np.testing.assert_allclose(valley.lines.table[[0, -1], 4], [1.0 + 0.008 * 420.0, 1.0])
    y = np.linspace(20.0, 80.0, 4001)
    rise = valley.height(np.column_stack([np.full_like(y, 210.0), y])) - valley._plane(210.0)
    level = np.abs(np.diff(rise)) < 1e-9
    treads = np.unique(np.round(rise[1:][level], 6))
    floor = 1.0 + 0.008 * 210.0
    for part in (0.25, 0.5, 0.75):
        assert np.abs(treads - part * floor).min() < 1e-6


def test_stations_of_elements_in_metres_follow_their_controls():
    controls = {
        "bank": (g.sine(0.1, 1),),
        "floor": (g.cosine(0.5, 2),),
        "top": (g.cosine(1.0, 1),),
        "left_top": (g.sine(5.0, 1),),
    }
    valley = wr.synthetic_valley("S1", controls=controls, floor_height=2.0, top_height=4.0)
    u = np.linspace(0.0, 1.0, len(valley.lines.table))
    np.testing.assert_allclose(valley.lines.table[:, 4], 2.0 + 0.5 * np.cos(4 * np.pi * u))
    np.testing.assert_allclose(valley.lines.table[:, 5], 4.0 + np.cos(2 * np.pi * u))
    np.testing.assert_allclose(
        valley.lines.table[:, 1] - valley.lines.table[:, 0], 12.5 + 5.0 * np.sin(2 * np.pi * u), atol=1e-9
    )
    bank = valley.breaklines()["left_bank"]
    raised = bank[:, 2] - valley._plane(bank[:, 0])
    np.testing.assert_allclose(raised, 0.1 * 2.112 * np.sin(2 * np.pi * bank[:, 0] / 420.0), atol=1e-6)


# ---- given lines, threads, objects


def meandered(*, device):
    """A channel that has meandered, with cutoffs."""
    line = generate.noisy_line(6_000.0, 30.0, 60.0, seed=3)
    simulation = wr.Simulation(
        wr.RiverNetwork.from_polylines([line + [1e5, 2e6]], width=50.0), plain_params(), device=device
    )
    simulation.run(years=120)
    return simulation.network


def test_a_channel_that_meandered_takes_the_place_of_the_planform(device):
    network = meandered(device=device)
    given = network.polylines()[0]
    params = wr.valley.ValleyParams(
        line=network, width=50.0, depth=2.5, slope=5e-4, floor_height=2.0, top_height=15.0, increments=1200,
        controls={"thalweg": (g.sine(0.3, 25),), "width": (g.sine(0.1, 25),)},
    )  # fmt: skip
    valley = wr.synthetic_valley(params, cell_size=15.0, device=device)
    assert valley.sinuosity == pytest.approx(wr.metrics.sinuosity(given), rel=2e-3)
    from scipy.spatial import cKDTree

    assert cKDTree(given).query(valley.network.polylines()[0])[0].max() < 26.0, "points are 50 m apart"
    # The bed lies a depth below top of bank all along.
    line = valley.network.polylines()[0][20:-20]
    depth = valley._plane(valley.stations.frame.to_valley(line)[:, 0]) - valley.height(line)
    inside = valley.network.point_depths()[0][20:-20]
    assert (depth < inside + 1e-6).all() and (depth > 0.2 * inside).all()
    bend = valley.stations.line.curvature[valley.stations.reach]
    sharp = int(np.abs(bend).argmax())
    apex = valley.stations.apex[valley.stations.reach][sharp]
    assert np.sign(apex - 0.5) == np.sign(bend[sharp])
    with pytest.raises(ValueError, match="2 channels"):
        wr.synthetic_valley("S1", line=wr.RiverNetwork.from_polylines([given, given + 1e4], width=50.0), controls={})


def test_a_valley_turned_on_the_map_is_the_same_valley(device):
    x = np.linspace(0.0, 420.0, 4001)
    straight = np.column_stack([x, 50.0 * np.sin(2.0 * np.pi * x / 420.0)])
    controls = {k: v for k, v in wr.synthetic_valley("S3").params.controls.items() if k != "centerline"}
    angle = 0.8
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    one = wr.synthetic_valley("S3", line=straight, controls=controls, device=device)
    other = wr.synthetic_valley("S3", line=straight @ turn + [5e5, 4e6], controls=controls, device=device)
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(10.0, 410.0, 2000), rng.uniform(-180.0, 180.0, 2000)])
    # Absolute coordinates of 4e6 m have 1e-9 m; slopes are below 5 but at the outer bank.
    difference = np.abs(one.height(places) - other.height(places @ turn + [5e5, 4e6]))
    assert np.quantile(difference, 0.99) < 1e-6 and difference.max() < 1e-2
    terrain = other.raster(8.0)
    assert np.isnan(terrain.to_numpy()).any(), "outside the ends of the valley there is no ground"
    west, north = terrain.origin
    rows, columns = np.nonzero(np.isfinite(terrain.to_numpy()))
    x, y = west + (columns + 0.5) * 8.0, north - (rows + 0.5) * 8.0
    np.testing.assert_allclose(
        terrain.to_numpy()[rows, columns], other.height(np.column_stack([x, y])), atol=1e-2, rtol=0.0
    )


def test_the_bed_falls_along_the_channel_where_it_is_asked_to(device):
    network = meandered(device=device)
    fields = dict(line=network.polylines()[0], width=50.0, depth=2.5, slope=1e-3, increments=1500, controls={})
    falls = {}
    for fall in ("valley", "channel"):
        valley = wr.synthetic_valley("S1", fall=fall, **fields, device=device)
        falls[fall] = -np.diff(valley.breaklines()["thalweg"][:, 2])
    assert falls["valley"].min() < 0.0 < falls["channel"].min()
    assert falls["channel"].sum() == pytest.approx(falls["valley"].sum(), abs=0.1)


def test_threads_leave_and_come_back(device):
    threads = (g.Thread(0.2, 0.7, 60.0, 0.6, 0.9), g.Thread(0.35, 0.85, -50.0, 0.5, 0.8))
    valley = wr.synthetic_valley("S1", controls={}, threads=threads, floor_width=80.0, device=device)
    x = 0.45 * 420.0
    off = 60.0 * math.sin(math.pi * 0.5) ** 2
    h = valley.bankfull_depth
    depth = valley._plane(x) - valley.height([[x, 0.0], [x, off], [x, 30.0]])
    np.testing.assert_allclose(depth, [h, 0.9 * h, 0.0], atol=0.01)
    network = valley.network
    assert network.channel_count == 5 + 2
    assert network.node_count == 6, "threads meet the main channel at its nodes"
    np.testing.assert_allclose(network.channel_width[-2:], [18.0, 15.0])
    # Where channels overlap the deeper one holds.
    y = np.linspace(-15.0, 15.0, 301)
    alone = wr.synthetic_valley("S1", controls={}, floor_width=80.0, device=device)
    place = np.column_stack([np.full_like(y, 0.24 * 420.0), y])
    assert (valley.height(place) <= alone.height(place) + 1e-9).all()


def test_objects_are_as_many_as_asked_for_and_stay_in_their_field(device):
    field = g.ObjectField(density=0.02, smallest=0.8, largest=1.6, seed=11)
    plain, strewn = (
        wr.synthetic_valley("S1", controls={}, objects=o, section=g.CrossSection("rectangle"), device=device)
        for o in ((), (field,))
    )
    cell = 0.05
    bounds = (50.0, -20.0, 130.0, 20.0)
    height = strewn.raster(cell, bounds).to_numpy() - plain.raster(cell, bounds).to_numpy()
    from scipy.ndimage import label

    _, count = label(height > 0.0)
    # 80 m x 30 m x 0.02 = 48 boulders; a Poisson field would have a standard deviation of 7, and some touch.
    assert 30 <= count <= 60
    assert 0.5 < height.max() <= 0.8
    y = bounds[3] - cell * (np.arange(height.shape[0]) + 0.5)
    assert height[np.abs(y) > 15.0].max() == 0.0
    again = wr.synthetic_valley("S1", controls={}, objects=(field,), section=g.CrossSection("rectangle"), device=device)
    np.testing.assert_array_equal(again.raster(cell, bounds).to_numpy(), strewn.raster(cell, bounds).to_numpy())


def test_the_same_valley_to_the_bit(device):
    first, second = (wr.synthetic_valley("S4", device=device).terrain.to_numpy() for _ in range(2))
    np.testing.assert_array_equal(first, second)


# ---- the grid


def test_the_grid_is_structured_and_its_triangles_cover_it(examples):
    valley = examples["S3"]
    grid = valley.grid(1.0)
    rows, columns, _ = grid.xyz.shape
    assert rows == 785 and np.isfinite(grid.xyz).all()
    triangles = grid.triangles()
    assert len(triangles) == 2 * (rows - 1) * (columns - 1)
    a, b, c = (grid.points()[triangles[:, k], :2] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    inside = (triangles % columns >= grid.banks[0]).all(1) & (triangles % columns <= grid.banks[1]).all(1)
    assert (area[inside] > 0.0).all(), "seen from above they run counter-clockwise"
    width = sampled(valley, "width")
    assert area[inside].sum() == pytest.approx(
        trapezoid(width, valley.stations.line.s[valley.stations.reach]), rel=1e-3
    )
    spacing = np.hypot(*np.diff(grid.xyz[:, grid.banks[0] : grid.banks[1] + 1, :2], axis=1).reshape(-1, 2).T)
    assert spacing.max() <= 1.0 + 1e-9


def test_what_is_held_beside_the_heights_does_not_grow_with_the_raster(examples):
    """The lattice of nearest stations belongs to the valley: a raster of any size looks into the same one."""
    valley = examples["S6"]
    lattice = valley._lattice
    assert lattice.node_station.shape[0] == lattice.rows * lattice.columns < 20_000
    valley.raster(40.0), valley.raster(2.5)
    assert valley._lattice is lattice


# ---- bad input


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 0.0}, r"ValleyParams.width is 0 m; the range is \(0"),
        ({"width": -3.0}, "ValleyParams.width is -3 m"),
        ({"width": math.nan}, "ValleyParams.width is nan"),
        ({"grain_size": 0.0}, "ValleyParams.grain_size is 0 m"),
        ({"slope": 0.0}, "slope is 0, where the Shields depth of eq. 4 is infinite"),
        ({"slope": -0.1}, "ValleyParams.slope is -0.1"),
        ({"depth": 0.0}, "ValleyParams.depth is 0;"),
        ({"floor_width": -1.0}, "ValleyParams.floor_width is -1"),
        ({"increments": 100.5}, "increments is 100.5; give a whole number"),
        ({"stationing": "x"}, "stationing is 'x'; use one of 'channel', 'valley'"),
        ({"controls": {"witdh": ()}}, "controls has 'witdh'; the elements are"),
        ({"controls": {"width": (0.3,)}}, "controls\\['width'\\] must hold terms"),
        (
            {"controls": {"thalweg": ()}, "covariance": g.CovarianceTarget(mean=0.5, frequencies=(3.0,))},
            "does not vary",
        ),
        ({"controls": {"width": (g.sine(1.2, 1),)}}, r"S3: the width is -6 m at station 0\.75 of the reach"),
        ({"controls": {"left_top": (g.sine(60.0, 1),)}}, r"the valley side left_top is -35 m wide at x = 315 m"),
        ({"controls": {"bank": (g.sine(-3.0, 1),)}}, r"the depth is .* at station 0\.25 of the reach"),
        ({"colour": 1}, "'colour' is no field of ValleyParams"),
        ({"line": [[0, 0], [1, 1]], "controls": {}}, r"line: 2 point\(s\); give at least 3"),
        ({"line": [[0, 0], [1, 1], [1, 1], [3, 0]], "controls": {}}, "line: points 1 and 2 are both at"),
        ({"line": [[0, 0], [1, np.nan], [2, 1], [3, 0]], "controls": {}}, "point 1 is not finite"),
        ({"line": [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], "controls": {}}, "ends close to where it starts"),
    ],
)
def test_bad_valleys_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        wr.synthetic_valley("S3", **changes)


def test_other_bad_input():
    with pytest.raises(ValueError, match="valley is 'S7'; use one of S1, S2"):
        wr.synthetic_valley("S7")
    with pytest.raises(ValueError, match="a line and a control of the centerline"):
        wr.synthetic_valley("S3", line=np.zeros((4, 2)))
    with pytest.raises(ValueError, match="cell_size is -1"):
        wr.synthetic_valley("S3", cell_size=-1)
    with pytest.raises(ValueError, match="give a smaller one"):
        wr.synthetic_valley("S3").raster(400.0)
    with pytest.raises(ValueError, match="origin is"):
        wr.synthetic_valley("S3", origin=(0.0, math.inf))
    with pytest.raises(ValueError, match=r"CrossSection.threads\[1\] needs"):
        g.CrossSection("weibull", threads=((0.0, 0.2, 2.0, 1.0), (0.5, -0.2, 2.0, 1.0)))
    with pytest.raises(ValueError, match=r"Thread\.end is 0\.3 and start 0\.4"):
        g.Thread(0.4, 0.3)
    with pytest.raises(ValueError, match=r"largest is 0\.2 m, below smallest"):
        g.ObjectField(largest=0.2)
    with pytest.raises(ValueError, match="finite places"):
        wr.synthetic_valley("S3").height([[0.0, math.nan]])
    with pytest.raises(MemoryError, match="a valley of"):
        wr.synthetic_valley("S6").raster(1e-4)
