"""Kernels of synthetic valleys against their twins, which look at every station from every place."""

import math

import numpy as np
import pytest
import reference_valley as twin
import warp as wp
from kernel_arrays import REALS, SCALARS, to_device, unwritten, vec2_of

from warpriver.kernels import valley

# Heights are a few metres at places up to 200 m from the zero. Float64: the root of a section is found to 1e-9 of an
# increment; the twin's circles are 1/200 of an increment apart, and touch with second order. Float32: 200 m has 1e-5 m.
HEIGHT = {"float64": 2e-4, "float32": 2e-3}
THREADS = [(0.0, 0.3, 2.0, 1.0), (0.45, 0.2, 3.0, 0.6), (0.7, 0.15, 1.0, 0.4)]


def bent_channel(count=90, amplitude=14.0, wave=90.0, offset=0.0, scale=1.0, seed=0):
    """A sinuous line with a width, depth and lean that vary: (xy, tangent, half, form)."""
    fine = np.linspace(-20.0, 140.0, 6001)
    curve = offset + amplitude * np.sin(2.0 * math.pi * fine / wave + 0.3 * seed)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(fine), np.diff(curve)))])
    x = np.interp(np.linspace(0.0, s[-1], count), s, fine)
    xy = np.column_stack([x, offset + amplitude * np.sin(2.0 * math.pi * x / wave + 0.3 * seed)])
    slope = amplitude * 2.0 * math.pi / wave * np.cos(2.0 * math.pi * x / wave + 0.3 * seed)
    tangent = np.column_stack([np.ones(count), slope]) / np.hypot(1.0, slope)[:, None]
    width = scale * (8.0 + 2.0 * np.sin(0.11 * x))
    half = np.column_stack([0.5 * width, 0.45 * width])
    form = np.column_stack([2.0 + 0.4 * np.cos(0.1 * x), 0.5 + 0.4 * np.sin(0.07 * x), 0.2 * np.sin(0.05 * x)])
    return xy, tangent, half, form


def made_valley(dtype, device, channels, section=None, terraces=0, objects=()):
    """The twin and the kernels' struct of one valley."""
    scalar, real = SCALARS[dtype], REALS[dtype]
    kernel = valley.build(scalar)
    x = np.linspace(0.0, 120.0, 41)
    table = np.column_stack(
        [
            45 + 3 * np.sin(0.1 * x),
            60 + 0 * x,
            -45 + 2 * np.cos(0.1 * x),
            -55 + 0 * x,
            1.5 + 0.01 * x,
            3.0 + 0 * x,
            -0.2 * np.sin(0.026 * x),
        ]
    )
    surface = kernel.Surface()
    counts = [len(c[0]) for c in channels]
    surface.channel_start = to_device(np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), wp.int32, device)
    kinds = [vec2_of(scalar), vec2_of(scalar), vec2_of(scalar), wp.types.vector(3, scalar)]
    for k, name in enumerate(("station_xy", "station_tangent", "station_half", "station_form")):
        packed = np.concatenate([c[k] for c in channels])
        packed = packed.astype(real)
        setattr(surface, name, to_device(packed, kinds[k], device))
    surface.valley_line = to_device(table.astype(real), wp.types.vector(7, scalar), device)
    section = {"form": 0, **(section or {})}
    threads = np.array(section.get("threads", THREADS), real)
    surface.section_thread = to_device(threads, wp.types.vector(4, scalar), device)
    surface.section_form, surface.terraces = section["form"], terraces
    surface.flat, surface.exponent = section.get("flat", 0.5), section.get("exponent", 2.0)
    rows = np.reshape([row for row, _ in objects], (len(objects), 10)).astype(real)
    surface.object_table = to_device(rows, scalar, device)
    surface.object_seed = to_device(np.array([seed for _, seed in objects], np.int32), wp.int32, device)
    surface.line_start, surface.lines_per_meter = 0.0, 1.0 / 3.0
    surface.bank_height, surface.slope, surface.lift_reach = 1000.0, 0.003, 6.0
    surface.begin, surface.end = -1e-3, 120.001
    plain = twin.Twin(channels, table, 0.0, 3.0, bank_height=1000.0, slope=0.003, reach=6.0, terraces=terraces)
    plain.section = section
    return kernel, surface, plain


def lattice_of(kernel, dtype):
    """A lattice of 5 m over the whole valley."""
    lattice = kernel.Lattice()
    lattice.rows, lattice.columns, lattice.step = 28, 30, 5.0
    lattice.corner = vec2_of(SCALARS[dtype])(-10.0, 66.0)
    return lattice


def known_stations(kernel, surface, lattice, device, channels=1):
    known = wp.full(channels * lattice.rows * lattice.columns, valley.NOWHERE, dtype=wp.int32, device=device)
    count = surface.station_xy.shape[0]
    wp.launch(kernel.mark_stations, dim=count, inputs=[surface, lattice], outputs=[known], device=device)
    for stride in (16, 8, 4, 2, 1, 2, 1):
        other = unwritten(known.shape[0], wp.int32, device)
        dim = (channels, lattice.rows, lattice.columns)
        inputs = [surface, lattice, known, stride]
        wp.launch(kernel.spread_stations, dim=dim, inputs=inputs, outputs=[other], device=device)
        known = other
    cells = unwritten(known.shape[0], wp.int32, device)
    wp.launch(kernel.settle_cells, dim=dim, inputs=[surface, lattice, known], outputs=[cells], device=device)
    lattice.node_station, lattice.cell_station = known, cells
    return known


def heights(kernel, surface, lattice, places, dtype, device):
    out = unwritten(len(places), wp.float64, device)
    inputs = [surface, lattice, to_device(places.astype(REALS[dtype]), vec2_of(SCALARS[dtype]), device)]
    wp.launch(kernel.evaluate_points, dim=len(places), inputs=inputs, outputs=[out], device=device)
    return out.numpy()


def scattered(count, seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(1.0, 119.0, count), rng.uniform(-62.0, 62.0, count)])


def near_bank(plain, places, within=2e-3):
    """Places so close to a bank that rounding decides on which side they lie: there twins may part."""
    return np.array([any(abs(plain.gap(c, xy)[0]) < within for c in plain.channels) for xy in places])


@pytest.mark.parametrize(
    "section",
    [
        {"form": 0},
        {"form": 1, "flat": 0.4},
        {"form": 1, "flat": 0.0},
        {"form": 2},
        {"form": 3, "exponent": 2.7},
        {"form": 4, "threads": THREADS},
    ],
    ids=["asymmetric", "trapezoid", "triangle", "semicircle", "polynomial", "weibull"],
)
def test_heights_are_those_of_the_twin(dtype, device, section):
    kernel, surface, plain = made_valley(dtype, device, [bent_channel()], section)
    lattice = lattice_of(kernel, dtype)
    known_stations(kernel, surface, lattice, device)
    channel = plain.channels[0]
    rng = np.random.default_rng(3)
    k = rng.integers(14, 72, 60)
    n = rng.uniform(-0.98, 0.98, 60) * channel[2][k, 1]
    normal = np.column_stack([-channel[1][:, 1], channel[1][:, 0]])
    places = np.concatenate([scattered(60, 1), channel[0][k] + n[:, None] * normal[k]]).astype(REALS[dtype])
    places = places[~near_bank(plain, places)].astype(np.float64)
    found = heights(kernel, surface, lattice, places, dtype, device)
    expected = np.array([plain.height(xy) for xy in places])
    np.testing.assert_allclose(found, expected, atol=HEIGHT[dtype], rtol=0.0)
    assert (expected < 999.0).sum() > 20 and (expected > 1002.0).sum() > 5, "the case leaves a part out"


def test_several_channels_and_terraces_are_those_of_the_twin(dtype, device):
    channels = [bent_channel(), bent_channel(50, 8.0, 120.0, offset=-16.0, scale=0.6, seed=4)]
    kernel, surface, plain = made_valley(dtype, device, channels, terraces=3)
    lattice = lattice_of(kernel, dtype)
    known_stations(kernel, surface, lattice, device, channels=2)
    places = scattered(140, 2)
    places = places[~near_bank(plain, places)]
    found = heights(kernel, surface, lattice, places, dtype, device)
    expected = np.array([plain.height(xy) for xy in places])
    # A riser is as steep as 1.5 * 4 * 3 terraces of its floor's height over the distance: errors of place grow so much.
    np.testing.assert_allclose(found, expected, atol=4.0 * HEIGHT[dtype], rtol=0.0)


def test_ground_ends_with_the_reach(device):
    kernel, surface, _ = made_valley("float64", device, [bent_channel()])
    lattice = lattice_of(kernel, "float64")
    known_stations(kernel, surface, lattice, device)
    found = heights(
        kernel,
        surface,
        lattice,
        np.array([[-0.1, 0.0], [0.0, 0.0], [120.0, 50.0], [120.1, 50.0]]),
        "float64",
        device,
    )
    np.testing.assert_array_equal(np.isnan(found), [True, False, False, True])


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_cells_have_the_heights_of_their_centres(dtype, device, angle):
    kernel, surface, _ = made_valley(dtype, device, [bent_channel()])
    lattice = lattice_of(kernel, dtype)
    known_stations(kernel, surface, lattice, device)
    grid = kernel.Grid()
    grid.corner, grid.cell_size = vec2_of(SCALARS[dtype])(30.0, 20.0), 2.5
    grid.cosine, grid.sine = math.cos(angle), math.sin(angle)
    out = unwritten((14, 17), wp.float64, device)
    wp.launch(kernel.evaluate_cells, dim=out.shape, inputs=[surface, lattice, grid], outputs=[out], device=device)
    rows, columns = np.meshgrid(np.arange(14), np.arange(17), indexing="ij")
    x, y = 2.5 * columns, -2.5 * rows
    places = np.stack(
        [30.0 + math.cos(angle) * x - math.sin(angle) * y, 20.0 + math.sin(angle) * x + math.cos(angle) * y], axis=-1
    )
    found = heights(kernel, surface, lattice, places.reshape(-1, 2), dtype, device)
    # The places are rounded once more on their way: in float32 by 1e-5 m, on ground as steep as 5 beside a bank.
    np.testing.assert_allclose(out.numpy().ravel(), found, atol={"float64": 1e-9, "float32": 1e-3}[dtype], rtol=0.0)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_lattice_spreads_stations_as_the_twin_and_close_to_the_nearest(device, seed):
    channel = bent_channel(seed=seed, amplitude=30.0)
    kernel, surface, _ = made_valley("float64", device, [channel])
    lattice = lattice_of(kernel, "float64")
    found = known_stations(kernel, surface, lattice, device).numpy().reshape(28, 30)
    rows, columns = np.meshgrid(np.arange(28), np.arange(30), indexing="ij")
    places = np.stack([-10.0 + 5.0 * columns, 66.0 - 5.0 * rows], axis=-1)[..., None, :]
    gap = np.hypot(*np.moveaxis(places - channel[0], -1, 0)) - channel[2].max(axis=1)
    np.testing.assert_array_equal(found, twin.jump_flood(gap, marked(channel), (16, 8, 4, 2, 1, 2, 1)))
    # A node keeps one of the two stations within it, and stations off the lattice are told to its rim: what a node
    # knows is nearest to within the lattice's step, 5 m, and each cell goes on from there.
    inside = np.s_[:, 2:-2]
    own = np.take_along_axis(gap, found[..., None], axis=-1)[..., 0]
    assert (own - gap.min(axis=-1))[inside].max() < 5.0


def marked(channel):
    """First station of each node of the lattice, (28, 30)."""
    made = np.full((28, 30), valley.NOWHERE)
    for i in reversed(range(len(channel[0]))):
        column = min(max(round((channel[0][i, 0] + 10.0) / 5.0), 0), 29)
        row = min(max(round((66.0 - channel[0][i, 1]) / 5.0), 0), 27)
        made[row, column] = i
    return made


def test_a_node_keeps_the_first_of_its_stations(device):
    channel = bent_channel(count=400)
    kernel, surface, _ = made_valley("float64", device, [channel])
    lattice = lattice_of(kernel, "float64")
    known = wp.full(28 * 30, valley.NOWHERE, dtype=wp.int32, device=device)
    wp.launch(kernel.mark_stations, dim=400, inputs=[surface, lattice], outputs=[known], device=device)
    np.testing.assert_array_equal(known.numpy().reshape(28, 30), marked(channel))


@pytest.mark.parametrize("amplitude", [14.0, 30.0])
def test_cells_are_settled_where_places_have_one_nearest_station(device, amplitude):
    """As by the twin; and from wherever in such a cell, the distance has one minimum among the stations around it."""
    channel = bent_channel(amplitude=amplitude, count=300)
    kernel, surface, _ = made_valley("float64", device, [channel])
    lattice = lattice_of(kernel, "float64")
    known = known_stations(kernel, surface, lattice, device).numpy().reshape(28, 30)
    settled = lattice.cell_station.numpy().reshape(28, 30)
    assert 100 < (settled >= 0).sum() < 27 * 29
    rng = np.random.default_rng(0)
    place, tangent = channel[:2]
    for row in range(1, 26):
        for column in range(1, 28):
            around = known[row - 1 : row + 3, column - 1 : column + 3]
            low, high = max(around.min() - 2, 0), min(around.max() + 2, 299)
            spacing = np.hypot(*np.diff(place[low : high + 1], axis=0).T)
            corners = [[-10 + 5 * (column + a), 66 - 5 * (row + b)] for a in (0, 1) for b in (0, 1)]
            ahead = [((c - place[low : high + 1]) * tangent[low : high + 1]).sum(1) for c in np.array(corners, float)]
            plain = around.max() - around.min() <= 256 and all((-np.diff(a) >= 0.1 * spacing).all() for a in ahead)
            assert settled[row, column] == ((around.min() + around.max()) // 2 if plain else -1)
            if plain:
                inside = np.array(corners[0]) + 5.0 * rng.uniform(0.0, 1.0, 2) * [1.0, -1.0]
                distance = np.hypot(*(inside - place[low : high + 1]).T)
                assert (np.diff(np.sign(np.diff(distance))) > 0).sum() <= 1


def test_sections_lie_where_the_equations_put_them(dtype, device):
    """x' = x - n dy/ds, y' = y + n dx/ds, and the depth of the section; the banks are at top of bank; on the map."""
    channel = bent_channel()
    kernel, surface, _ = made_valley(dtype, device, [channel])
    out = unwritten((20, 12), wp.vec3d, device)
    frame = kernel.Frame()
    frame.x, frame.y, frame.cosine, frame.sine = 5e5, 4e6, math.cos(0.4), math.sin(0.4)
    wp.launch(kernel.lay_sections, dim=(20, 9), inputs=[surface, frame, 30, 2, 9], outputs=[out], device=device)
    found = out.numpy()
    assert np.isnan(found[:, [0, 1, 11]]).all(), "columns of others are left alone"
    table = np.linspace(0.0, 120.0, 41)
    turn = np.array([[math.cos(0.4), math.sin(0.4)], [-math.sin(0.4), math.cos(0.4)]])
    xy, tangent, half, form = (part[30:50] for part in channel)
    for column in range(9):
        y = column / 8.0
        n = half[:, 0] - y * half.sum(axis=1)
        expected = xy + n[:, None] * np.column_stack([-tangent[:, 1], tangent[:, 0]])
        place = expected @ turn + [5e5, 4e6]
        # Places are laid out in the valley, 140 m long, in the precision, and put on the map in float64.
        np.testing.assert_allclose(found[:, 2 + column, :2], place, atol=3e-5 if dtype == "float32" else 1e-8, rtol=0.0)
        depth = [0.0 if column in (0, 8) else d * twin.section_depth(0, y, a) for d, a, _ in form]
        z = (
            1000.0
            - 0.003 * expected[:, 0]
            - 0.2 * np.interp(expected[:, 0], table, np.sin(0.026 * table))
            + form[:, 2]
            - depth
        )
        np.testing.assert_allclose(found[:, 2 + column, 2], z, atol={"float64": 1e-10, "float32": 2e-5}[dtype])


def test_sides_run_from_the_banks_to_the_edges(dtype, device):
    """Even steps to the floor's edge abreast of the station, then to the top; heights are those of the places."""
    channel = bent_channel()
    kernel, surface, plain = made_valley(dtype, device, [channel])
    lattice = lattice_of(kernel, dtype)
    known_stations(kernel, surface, lattice, device)
    frame = kernel.Frame()
    frame.x, frame.y, frame.cosine, frame.sine = 0.0, 0.0, 1.0, 0.0
    out = unwritten((20, 5 + 10), wp.vec3d, device)
    wp.launch(kernel.lay_sides, dim=(20, 10), inputs=[surface, lattice, frame, 30, 3, 2], outputs=[out], device=device)
    found = out.numpy()
    assert np.isnan(found[:, 5:10]).all()
    xy, tangent, half, _ = (part[30:50] for part in channel)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    for side, columns, edges in ((0, [4, 3, 2, 1, 0], (0, 1)), (1, [10, 11, 12, 13, 14], (2, 3))):
        sign = 1.0 if side == 0 else -1.0
        bank = xy + sign * half[:, side : side + 1] * normal
        edge, top = (np.column_stack([xy[:, 0], [plain.line(x, e) for x in xy[:, 0]]]) for e in edges)
        for k, column in enumerate(columns):
            expected = bank + (k + 1) / 3.0 * (edge - bank) if k < 3 else edge + (k - 2) / 2.0 * (top - edge)
            np.testing.assert_allclose(found[:, column, :2], expected, atol=2e-4 if dtype == "float32" else 1e-9)
    places = found[:, [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]].reshape(-1, 3)
    height = heights(kernel, surface, lattice, places[:, :2], dtype, device)
    np.testing.assert_allclose(places[:, 2], height, atol=1e-3 if dtype == "float32" else 1e-9)


@pytest.mark.parametrize("is_log", [0.0, 1.0])
def test_objects_are_those_of_the_twin(device, is_log):
    row = [is_log, 2.0, 5.0, 3.0, 0.7, 0.4, 1.2, 0.8, 3.0, 0.6]
    kernel, surface, plain = made_valley("float64", device, [bent_channel()], objects=[(row, 12345)])
    _, bare, _ = made_valley("float64", device, [bent_channel()])
    lattice = lattice_of(kernel, "float64")
    known_stations(kernel, surface, lattice, device)
    places = scattered(250, 7)
    found = heights(kernel, surface, lattice, places, "float64", device)
    found -= heights(kernel, bare, lattice, places, "float64", device)
    expected = [twin.objects_height(row, 12345, xy, plain.gap(plain.channels[0], xy)[0]) for xy in places]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert 20 < np.count_nonzero(expected) < 240
