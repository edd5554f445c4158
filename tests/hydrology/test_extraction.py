"""Networks extracted from terrains: forests that follow the ground and lose no water."""

import numpy as np
import pytest
from trees import assert_forest

from warpriver import RiverNetwork, Terrain, generate
from warpriver.hydraulic_geometry import bankfull_depth
from warpriver.hydrology import carve_depressions, drainage_area, route
from warpriver.hydrology.extraction import extract_network
from warpriver.hydrology.orders import shreve_magnitude, strahler_order


def valley(rows=60, columns=41, cell_size=10.0):
    """Two valleys that meet in the middle of row 30 and run south as one."""
    row, column = np.mgrid[:rows, :columns].astype(float)
    middle = columns // 2
    away = np.abs(column - middle)
    arm = np.clip(30 - row, 0, None) * 0.5
    return Terrain(1.0 * np.abs(away - arm) + 0.5 * (rows - row), cell_size, origin=(500.0, 900.0))


def outlets(network):
    """Channels from which water leaves."""
    return ~np.isin(network.channel_to, network.channel_from)


def river_cells(terrain, threshold):
    """Centres of the cells above the threshold, m; their drainage area at outlets, m2."""
    flow = route(terrain, depressions="carve")
    area = drainage_area(flow).numpy()
    row, column = np.nonzero(area >= threshold)
    west, north = terrain.origin
    centers = np.column_stack([west + (column + 0.5) * terrain.cell_size, north - (row + 0.5) * terrain.cell_size])
    index = np.ravel_multi_index((row, column), area.shape)
    out = flow.receiver.numpy()[row, column] == index
    return centers, area[row, column][out], centers[out]


def test_two_valleys_meet_where_they_do():
    terrain = valley()
    network = extract_network(terrain, min_drainage_area=150 * 100.0)
    assert_forest(network)
    assert network.channel_count == 3 and network.node_count == 4
    assert strahler_order(network.channel_from, network.channel_to).max() == 2
    junction = network.node_xy[np.intersect1d(network.channel_to, network.channel_from)[0]]
    expected = np.array([500.0 + 20.5 * 10.0, 900.0 - 30.5 * 10.0])
    assert np.hypot(*(junction - expected)) < 25.0
    outlet = network.node_xy[network.channel_to[outlets(network)][0]]
    np.testing.assert_allclose(outlet, [500.0 + 20.5 * 10.0, 900.0 - 59.5 * 10.0])


def test_slopes_are_drops_over_lengths():
    """The trunk falls 0.5 m a row of 10 m; the arms as much a row, along a course that runs 1 to 2 across the rows."""
    network = extract_network(valley(), min_drainage_area=1.5e4, smoothing=0)
    trunk = int(outlets(network).argmax())
    # Heads and junctions may lie a cell aside of the valley floor: 1 m of some 150.
    assert network.channel_slope[trunk] == pytest.approx(0.05, rel=0.02)
    # In steps from cell to cell, one across and one diagonal: 2 rows in 10 (1 + sqrt(2)) m.
    arms = np.delete(network.channel_slope, trunk)
    np.testing.assert_allclose(arms, 1.0 / (10.0 * (1.0 + np.sqrt(2.0))), rtol=0.1)


@pytest.mark.parametrize("carve", [True, False])
def test_slopes_are_those_of_the_surface_that_water_was_routed_on(carve):
    """Noise of the raw heights makes channels rise; the opened ones fall, and add up to the drop of the stem."""
    rng = np.random.default_rng(1)
    smooth = generate.tilted_plain((120, 100), 10.0, 0.01).to_numpy()
    terrain = Terrain(smooth + rng.uniform(0.0, 1.0, smooth.shape), 10.0)
    network = extract_network(terrain, min_drainage_area=2e4, carve=carve, smoothing=0)
    assert network.channel_count > 10
    slope, length = network.channel_slope, network.channel_lengths()
    assert np.isfinite(slope).all() and (slope >= 0.0).all()
    surface = route(terrain, depressions="carve" if carve else "fill").terrain.to_numpy()

    def height(node):
        x, y = network.node_xy[node].T
        return surface[((terrain.origin[1] - y) // 10.0).astype(int), ((x - terrain.origin[0]) // 10.0).astype(int)]

    drop = height(network.channel_from) - height(network.channel_to)
    np.testing.assert_allclose(slope * length, np.maximum(drop, 0.0), atol=1e-12)
    # Where no junction was moved upstream the drops are those of the nodes.
    assert (drop >= 0.0).mean() > 0.9


def test_attributes_follow_their_laws():
    network = extract_network(valley(), min_drainage_area=1.5e4)
    area = network.channel_drainage_area
    assert (area % 100.0 == 0.0).all()
    # One relation of width and bankfull discharge, of channels that are found and of those that are given.
    wide = 7.2 * np.sqrt(0.42 * 100**0.69) / 1e4 * np.sqrt(area)
    np.testing.assert_allclose(network.channel_discharge, (wide / 7.2) ** 2)
    lines = [xy[:3] for xy in network.polylines()]
    given = RiverNetwork.from_polylines(lines, width=wide, allow_short=True)
    np.testing.assert_allclose(given.channel_discharge, network.channel_discharge)
    # It is in proportion to the area, so that what flows into a junction flows out of it.
    np.testing.assert_allclose(network.channel_discharge / area, 0.42 * 100**0.69 / 1e8)
    for width, depth, a, mean in zip(
        network.point_widths(), network.point_depths(), area, network.channel_width, strict=True
    ):
        np.testing.assert_allclose(width[-1], 7.2 * np.sqrt(0.42 * 100**0.69) / 1e4 * np.sqrt(a))
        np.testing.assert_allclose(depth, bankfull_depth(width))
        assert (np.diff(width) >= 0.0).all() and width[0] < mean < width[-1]
    constant = extract_network(valley(), min_drainage_area=1.5e4, varying=False, width_coefficient=0.01)
    assert constant.point_section is None
    assert (constant.channel_width > network.channel_width).all()


@pytest.mark.parametrize("smoothing", [0, 4, 12])
def test_points_are_even_and_near_the_cells(smoothing):
    terrain = generate.fluvial_terrain((120, 160), 50.0, 800.0, 3)
    network = extract_network(terrain, min_drainage_area=2e5, spacing=20.0, smoothing=smoothing)
    assert_forest(network)
    for line in network.polylines():
        step = np.hypot(*np.diff(line, axis=0).T)
        assert step.max() < 1.25 * step.mean() and abs(step.mean() - 20.0) < 6.0
    from scipy.spatial import cKDTree

    centers, _, _ = river_cells(terrain, 2e5)
    off = cKDTree(centers).query(network.points())[0] / 50.0
    assert off.mean() < 0.6 and off.max() < 2.0


@pytest.mark.parametrize("passes", [0, 1, 2, 4])
@pytest.mark.parametrize(("period", "factor"), [(2, 0.0), (4, 0.5)])
def test_a_pass_of_smoothing_damps_waves_by_their_length(period, factor, passes):
    """The filter 1/4, 1/2, 1/4 multiplies a wave of p points by cos(pi / p)^2; sources and outlets stay."""
    rows, cell_size = 81, 10.0
    row, column = np.mgrid[:rows, :41].astype(float)
    swing = np.array({2: [0, 1], 4: [0, 1, 2, 1]}[period])
    course = 20 + swing[np.arange(rows) % period]
    height = rows - row + 5.0 * np.abs(column - course[:, None])
    terrain = Terrain(height, cell_size, origin=(0.0, cell_size * rows))
    # Twenty points a cell: the crests of the cubic are among them.
    network = extract_network(terrain, min_drainage_area=200 * cell_size**2, smoothing=passes, spacing=0.5)
    (line,) = network.polylines()
    source = (cell_size * (rows - 0.5) - line[0, 1]) / cell_size
    assert line[0, 0] == (course[round(source)] + 0.5) * cell_size
    assert line[-1].tolist() == [(course[-1] + 0.5) * cell_size, 0.5 * cell_size]
    # The middle half: as many cells away from the ends as no pass carries anything.
    x = line[len(line) // 4 : -len(line) // 4, 0] / cell_size
    crest = 0.5 * swing.max() * factor**passes
    assert [x.min(), x.max()] == pytest.approx([20.5 + 0.5 * swing.max() + k * crest for k in (-1, 1)], abs=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_no_water_is_lost(seed):
    rng = np.random.default_rng(seed)
    if seed % 2:
        terrain = generate.fractal_terrain((90, 110), 30.0, 300.0, seed)
    else:
        terrain = generate.fluvial_terrain((90, 110), 30.0, 300.0, seed)
    height = terrain.to_numpy()
    height[40:50, 30 : 30 + seed * 4] = np.nan
    terrain = Terrain(height, 30.0)
    for threshold in (900.0 * rng.integers(5, 30), 900.0 * 100):
        network = extract_network(terrain, min_drainage_area=threshold, carve=True)
        assert_forest(network)
        _, area, xy = river_cells(terrain, threshold)
        last = outlets(network)
        # Every outlet has the area of its cell, or more, where another stream ran alongside: added up by place.
        at = np.round(network.node_xy[network.channel_to[last]], 3)
        found = dict(zip(map(tuple, at), network.channel_drainage_area[last], strict=True))
        wanted = dict(zip(map(tuple, np.round(xy, 3)), area, strict=True))
        assert len(found) == last.sum() and set(found) <= set(wanted)
        assert all(found[place] >= wanted[place] for place in found)
        assert np.mean([found[place] == wanted[place] for place in found]) > 0.8
        missing = sum(wanted.values()) - sum(found.values())
        assert 0.0 <= missing < 0.15 * sum(wanted.values()), "only the shortest courses are left out"


def test_every_threshold_gives_a_forest():
    terrain = generate.fluvial_terrain((60, 80), 50.0, 500.0, 1)
    sources = []
    for threshold in (2500.0, 1e4, 5e4, 2e5, 1e6):
        network = extract_network(terrain, min_drainage_area=threshold)
        assert_forest(network)
        width = [w.max() for w in network.point_widths()]
        assert (network.channel_lengths() > width).all()
        sources.append(shreve_magnitude(network.channel_from, network.channel_to)[outlets(network)].sum())
    assert sources == sorted(sources, reverse=True)


@pytest.mark.parametrize("seed", range(12))
def test_any_threshold_width_and_spacing_gives_a_forest(seed):
    rng = np.random.default_rng(seed)
    shape = int(rng.integers(3, 60)), int(rng.integers(3, 60))
    terrain = generate.fluvial_terrain(shape, float(rng.uniform(1.0, 90.0)), 300.0, seed)
    flow = route(terrain)
    for threshold in np.percentile(drainage_area(flow), [0, 50, 90, 98]):
        try:
            network = extract_network(
                terrain,
                min_drainage_area=float(threshold),
                width_coefficient=float(10.0 ** rng.uniform(-4.0, 0.0)),
                smoothing=int(rng.integers(0, 20)),
                spacing=terrain.cell_size * float(rng.uniform(0.1, 5.0)),
                flow=flow,
            )
        except ValueError as error:
            assert "no channel" in str(error)
            continue
        assert_forest(network)
        assert (network.channel_lengths() > [w.max() for w in network.point_widths()]).all()


def test_wide_rivers_on_fine_cells():
    terrain = generate.fluvial_terrain((100, 100), 10.0, 200.0, 2)
    network = extract_network(terrain, min_drainage_area=1e4, width_coefficient=0.2)
    assert_forest(network)
    width = np.array([w.max() for w in network.point_widths()])
    assert width.max() > 30.0 and (network.channel_lengths() > width).all()


def test_more_than_two_streams_in_one_cell():
    """Eight valleys run into a hole: seven junctions, one channel each."""
    y, x = np.mgrid[-30:31, -30:31].astype(float)
    spokes = np.min([np.abs(x), np.abs(y), np.abs(x - y), np.abs(x + y)], axis=0)
    height = 0.5 * np.hypot(x, y) + spokes
    height[30:, 30] = -0.01 * np.arange(31)
    network = extract_network(Terrain(height, 10.0), min_drainage_area=5e3)
    assert_forest(network)
    assert shreve_magnitude(network.channel_from, network.channel_to)[outlets(network)].max() >= 5


def test_cone_has_many_basins():
    network = extract_network(generate.cone((120, 120), 10.0, 0.1), min_drainage_area=1500.0)
    assert_forest(network)
    assert outlets(network).sum() >= 8


def test_periodic_sides_end_channels():
    """A valley that runs over the west side and on from the east side is two channels."""
    row, column = np.mgrid[:60, :41]
    terrain = Terrain(1.0 * np.abs((column + row) % 41 - 20) + 2.0 * (60 - row), 10.0)
    edges = {"north": "open", "south": "open", "east": "periodic", "west": "periodic"}
    network = extract_network(terrain, min_drainage_area=8e3, edges=edges)
    assert_forest(network)
    x = [(line[0, 0], line[-1, 0]) for line in network.polylines()]
    assert any(end == 5.0 for _, end in x) and any(start == 405.0 for start, _ in x)
    assert max(np.hypot(*np.diff(line, axis=0).T).max() for line in network.polylines()) < 30.0


@pytest.mark.parametrize("turn", [0, 13, 30])
def test_unrolled_rivers_do_not_feel_where_a_periodic_map_is_cut(turn):
    """Rivers of land that is joined east to west, in one piece each: the same wherever it is cut."""
    row, column = np.mgrid[:60, :41]
    height = 1.0 * np.abs((column + row) % 41 - 20) + 2.0 * (60 - row)
    edges = {"north": "closed", "south": "open", "east": "periodic", "west": "periodic"}
    height += 0.3 * np.random.default_rng(1).random(height.shape)

    def extract(land):
        flow = route(carve_depressions(Terrain(land, 10.0), edges=edges), edges=edges)
        return extract_network(flow.terrain, min_drainage_area=8e3, flow=flow, unroll=True)

    whole, turned = extract(height), extract(np.roll(height, turn, 1))
    assert_forest(whole)
    mouth = whole.node_xy[whole.channel_to[outlets(whole)]]
    assert (mouth[:, 1] == -595.0).all() and ((0.0 < mouth[:, 0]) & (mouth[:, 0] < 410.0)).all()
    assert whole.channel_count == turned.channel_count
    lengths = [np.sort(n.channel_lengths()) for n in (whole, turned)]
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=1e-9)
    assert max(np.hypot(*np.diff(line, axis=0).T).max() for line in whole.polylines()) < 30.0
    assert whole.points()[:, 0].max() - whole.points()[:, 0].min() > 410.0


def lake_valley(kind):
    """A V-shaped valley that falls south by 1 in 60, with an oval lake of 8 x 6 cells' radius; and where that lies.

    Kinds of lake: "flat" is at the level of its outlet, "bowl" a depression, "gap" has no data.
    """
    row, column = np.mgrid[:80, :61].astype(float)
    height = 100.0 - 0.5 * row + np.abs(column - 30.0)
    far = np.hypot((row - 60.0) / 8.0, (column - 30.0) / 6.0)
    lake = far < 1.0
    height[lake] = {"flat": 66.0, "bowl": (height - 20.0 * (1.0 - far**2))[lake], "gap": np.nan}[kind]
    return Terrain(height, 30.0, origin=(0.0, 2400.0)), lake


@pytest.mark.parametrize(("kind", "carve"), [("flat", True), ("flat", False), ("bowl", True), ("bowl", False)])
def test_a_river_crosses_a_lake_as_one_smooth_line(kind, carve):
    terrain, _ = lake_valley(kind)
    # More than either shore brings.
    network = extract_network(terrain, min_drainage_area=600 * 900.0, carve=carve)
    assert_forest(network)
    assert outlets(network).sum() == 1
    assert network.channel_drainage_area.max() == pytest.approx(drains(terrain, carve))
    # From the source furthest north down to the outlet.
    c = int(np.argmax(network.node_xy[network.channel_from, 1]))
    stem, areas = [network.polylines()[c]], [network.channel_drainage_area[c]]
    while network.channel_to[c] in network.channel_from:
        c = int(np.flatnonzero(network.channel_from == network.channel_to[c])[0])
        stem.append(network.polylines()[c][1:])
        areas.append(network.channel_drainage_area[c])
    line = np.concatenate(stem)
    assert line[0, 1] > 30.0 * 40 and line[-1, 1] == 15.0, "it begins above the lake and reaches the map's edge"
    assert (np.diff(areas) > 0.0).all() and areas[-1] == network.channel_drainage_area.max()
    step = np.diff(line, axis=0)
    turn = np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
    assert np.abs(turn).max() < 0.5 and np.hypot(*step.T).sum() < 1.05 * np.hypot(*(line[-1] - line[0]))
    on_lake = (line[:, 1] < 30.0 * 27) & (line[:, 1] > 30.0 * 12)
    assert on_lake.sum() > 10 and (np.abs(line[on_lake, 0] - 30.5 * 30.0) < 6 * 30.0).all()


def drains(terrain, carve):
    """Largest drainage area on a terrain."""
    return np.nanmax(drainage_area(route(terrain, depressions="carve" if carve else "fill")))


def test_rivers_end_at_a_lake_without_data_or_run_round_it():
    terrain, lake = lake_valley("gap")
    x, y = (np.argwhere(lake)[:, ::-1] + 0.5).T * 30.0
    lake_xy = np.column_stack([x, 80 * 30.0 - y])
    into = extract_network(terrain, min_drainage_area=100 * 900.0)
    assert_forest(into)
    ends = into.node_xy[into.channel_to[outlets(into)]]
    off = np.array([np.hypot(*(lake_xy - end).T).min() for end in ends]) / 30.0
    assert (off < 1.5).sum() >= 1, "one ends on the shore"
    assert (ends[:, 1] == 15.0).sum() == 1, "below the lake one begins anew"
    below = into.channel_drainage_area[outlets(into)][ends[:, 1] == 15.0][0]
    around = extract_network(terrain, min_drainage_area=100 * 900.0, nodata="wall")
    assert_forest(around)
    last = outlets(around)
    assert last.sum() == 1 and around.node_xy[around.channel_to[last]][0, 1] == 15.0
    assert around.channel_drainage_area[last][0] > 1.5 * below, "it brings the water from above the lake"
    # Smoothing may cut corners of the shore by a fraction of a cell.
    gone = np.isnan(terrain.sample(around.points()))
    assert gone.mean() < 0.1


def test_a_river_along_the_edge_leaves_there_unless_the_side_is_closed():
    row, column = np.mgrid[:60, :30].astype(float)
    terrain = Terrain(60.0 - row + 2.0 * column, 10.0, origin=(0.0, 600.0))
    with pytest.raises(ValueError, match="min_drainage_area"):
        extract_network(terrain, min_drainage_area=100 * 100.0)
    sides = {"north": "open", "south": "open", "east": "open", "west": "closed"}
    network = extract_network(terrain, min_drainage_area=100 * 100.0, edges=sides)
    assert network.channel_count == 1
    line = network.polylines()[0]
    assert (line[:, 0] == 5.0).all() and line[-1, 1] == 5.0


def test_flow_and_area_are_used_again():
    terrain = generate.fractal_terrain((80, 80), 30.0, 300.0, 5)
    whole = extract_network(terrain, min_drainage_area=1e5)
    flow = route(terrain, depressions="carve")
    again = extract_network(terrain, min_drainage_area=1e5, flow=flow, area=drainage_area(flow))
    assert (whole.points() == again.points()).all() and (whole.channel_to == again.channel_to).all()
    filled = extract_network(terrain, min_drainage_area=1e5, carve=False)
    assert_forest(filled)
    single = extract_network(terrain, min_drainage_area=1e5, dtype="float32")
    assert single.dtype == "float32"
    np.testing.assert_allclose(single.points(), whole.points(), atol=1e-3)


def test_bad_input_says_what_is_wrong():
    terrain = generate.fluvial_terrain((40, 40), 50.0, 500.0, 1)
    with pytest.raises(ValueError, match="largest drainage area on this terrain is"):
        extract_network(terrain, min_drainage_area=1e9)
    with pytest.raises(ValueError, match="longer than three cells"):
        extract_network(Terrain(np.arange(4.0).reshape(2, 2), 10.0), min_drainage_area=1.0)
    for name, value in (("min_drainage_area", 0.0), ("spacing", -1.0), ("smoothing", 1.5), ("width_coefficient", 0.0)):
        arguments = {"min_drainage_area": 1e5, name: value}
        with pytest.raises(ValueError, match=name):
            extract_network(terrain, **arguments)
    with pytest.raises(ValueError, match="shape"):
        extract_network(terrain, min_drainage_area=1e5, area=np.ones((3, 3)))
    with pytest.raises(ValueError, match="downstream"):
        extract_network(terrain, min_drainage_area=1e5, area=np.random.default_rng(0).uniform(1, 2, (40, 40)))
    other = route(generate.cone((20, 20), 10.0, 0.1))
    with pytest.raises(ValueError, match="another terrain"):
        extract_network(terrain, min_drainage_area=1e5, flow=other)


@pytest.mark.filterwarnings("error", "ignore:height. of its cells")
@pytest.mark.parametrize("value", [0.0, 7.0, -3.5, 1e300])
def test_level_ground_has_no_rivers(value):
    height = np.full((30, 40), value)
    for gap in (False, True):
        height[10:15, 10:15] = np.nan if gap else value
        with pytest.raises(ValueError, match=f"the terrain is level, {value:g} m".replace("+", r"\+")):
            extract_network(Terrain(height, 10.0), min_drainage_area=1e3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("carve", [True, False])
def test_islands_and_pits_at_the_edge(carve):
    """Islands of some and of single cells each drain for themselves; a pit at an open edge is an outlet like others."""
    land = generate.fluvial_terrain((60, 60), 50.0, 300.0, 1).to_numpy()
    islands = np.full((60, 60), np.nan)
    islands[5:30, 5:30] = land[5:30, 5:30]
    islands[40:43, 40:43], islands[50, 50] = 5.0, 3.0
    network = extract_network(Terrain(islands, 50.0, origin=(0.0, 3000.0)), min_drainage_area=3e4, carve=carve)
    assert_forest(network)
    x, y = network.points().T
    assert ((x > 250.0) & (x < 1500.0) & (y > 1500.0) & (y < 2750.0)).all(), "all on the large one"
    pits = land.copy()
    pits[0, 30], pits[30, 0] = -50.0, -80.0
    network = extract_network(Terrain(pits, 50.0, origin=(0.0, 3000.0)), min_drainage_area=3e4, carve=carve)
    assert_forest(network)
    ends = network.node_xy[network.channel_to[outlets(network)]]
    at_edge = (np.abs(ends - 1500.0) == 1475.0).any(axis=1)
    assert at_edge.all()
