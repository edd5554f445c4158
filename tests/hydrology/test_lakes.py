"""Rivers on flat ground, over lakes, to the sea, and at the edges of the map, where the answer is known."""

import math
import pickle

import numpy as np
import pytest
import reference_hydrology as reference
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates
from trees import assert_forest

from warpriver import Terrain
from warpriver.hydrology import Flow, drainage_area, extract_network, fill_depressions, route

CELL = 30.0


def land(height):
    """A terrain whose cell (row, column) has its centre at x = column, y = -row cells."""
    return Terrain(height, CELL, origin=(-0.5 * CELL, 0.5 * CELL))


def cells_of(xy):
    """Row and column of points, as fractions."""
    return np.asarray(xy)[..., ::-1] * [-1.0, 1.0] / CELL


def mouths(network):
    """Row and column of the lower ends from which water leaves."""
    last = ~np.isin(network.channel_to, network.channel_from)
    return cells_of(network.node_xy[network.channel_to[last]])


def sources(network):
    first = ~np.isin(network.channel_from, network.channel_to)
    return cells_of(network.node_xy[network.channel_from[first]])


def at(raster, cells):
    """Values of a raster in the cells of points."""
    row, column = np.round(cells).astype(int).T
    return raster[row.clip(0, raster.shape[0] - 1), column.clip(0, raster.shape[1] - 1)]


def longest_raster_run(line):
    """Length in cells of the longest stretch of a line along one of the eight directions of the raster."""
    step = np.diff(cells_of(line), axis=0)
    angle = np.degrees(np.arctan2(*step.T)) % 45.0
    length, longest = 0.0, 0.0
    for along, size in zip(np.minimum(angle, 45.0 - angle) < 0.1, np.hypot(*step.T), strict=True):
        length = length + size if along else 0.0
        longest = max(longest, length)
    return longest


def noise(shape, scale, size, seed):
    """Smooth noise within -size .. size."""
    values = gaussian_filter(np.random.default_rng(seed).standard_normal(shape), scale)
    return size * values / np.abs(values).max()


# ---- flats


@pytest.mark.parametrize("carve", [True, False])
def test_a_flat_between_hills_is_crossed_away_from_its_shores_in_a_smooth_line(carve):
    """A river comes to a bent flat of 24 cells' width; its middle line is known."""
    row, column = np.indices((200, 120)).astype(float)
    middle = 60.0 + 25.0 * np.sin(row / 24.0)
    away = np.abs(column - middle)
    height = np.where(away < 12.0, 50.0, 50.0 + 3.0 * (away - 11.0))
    # A valley leads to the flat, and from it to the edge.
    height[:60] = 80.0 - 0.5 * row[:60] + np.abs(column[:60] - middle[60, 0])
    height[190:] = 50.0 - 0.2 * (row[190:] - 189.0) + 2.0 * away[190:]
    height[:2] = 200.0
    network = extract_network(land(height), min_drainage_area=2500 * CELL**2, carve=carve)
    assert_forest(network)
    assert network.channel_count == 1, "what its shores bring makes no streams on a flat"
    (line,) = network.polylines()
    inside = cells_of(line)
    inside = inside[(inside[:, 0] > 75.0) & (inside[:, 0] < 180.0)]
    off = np.abs(inside[:, 1] - (60.0 + 25.0 * np.sin(inside[:, 0] / 24.0)))
    # Bends are cut a little: the half-width is 12.
    assert np.median(off) < 2.5 and off.max() < 6.0
    on_flat = (cells_of(line)[:, 0] > 75.0) & (cells_of(line)[:, 0] < 180.0)
    assert longest_raster_run(line[on_flat]) < 20.0


def test_a_filled_depression_is_crossed_along_its_bed():
    """A winding bed whose lower end is dammed: the lake over it reaches far beyond the bed; the river keeps to it."""
    row, column = np.indices((120, 100)).astype(float)
    bed = 50.0 + 14.0 * np.sin(row / 9.0)
    height = 20.0 - 0.1 * row + 0.3 * np.minimum(np.abs(column - bed), 6.0) + 0.0025 * (column - 50.0) ** 2
    height[:2] = 30.0
    height[95:105] = 16.3 + 0.0025 * (column[95:105] - 50.0) ** 2
    flow = route(land(height), depressions="fill")
    lake = flow.water.numpy() == 1
    assert lake[85].sum() > 50, "it is wide"
    network = extract_network(land(height), min_drainage_area=300 * CELL**2, flow=flow, smoothing=0)
    inside = np.concatenate([cells_of(line) for line in network.polylines()])
    # Where the lake begins and other streams come in it is not the bed's alone; below, it turns to the dam's low point.
    inside = inside[(inside[:, 0] > 64.0) & (inside[:, 0] < 84.0)]
    assert len(inside) > 20 and at(lake, inside).all()
    off = np.abs(inside[:, 1] - (50.0 + 14.0 * np.sin(inside[:, 0] / 9.0)))
    # Across the raster's rows, and the bed runs at up to 57 degrees to them.
    assert np.median(off) < 1.5 and off.max() < 4.0


@pytest.mark.parametrize(("thick", "cut"), [(3, True), (20, False)])
def test_banks_are_cut_through_and_hills_are_not(thick, cut):
    """A valley behind a bank of some cells; beside it is a lower pass."""
    row, column = np.indices((90, 80)).astype(float)
    height = 60.0 - 0.3 * row + 0.5 * np.abs(column - 40.0)
    height[:2] = 90.0
    height[50 : 50 + thick] = 66.0 + 0.2 * np.abs(column[50 : 50 + thick] - 40.0)
    height[50 : 50 + thick, 5] = 62.0
    terrain = land(height)
    surface = route(terrain, depressions="carve").terrain.to_numpy()
    assert (surface < height).any() == cut and (surface > height).any() != cut
    anyhow = route(terrain, depressions="carve", max_cut=math.inf).terrain.to_numpy()
    assert (anyhow < height).any()
    network = extract_network(terrain, min_drainage_area=1500 * CELL**2)
    crossing = np.concatenate([cells_of(line) for line in network.polylines()])
    crossing = crossing[np.abs(crossing[:, 0] - (50 + thick / 2)) < 1.0, 1]
    assert (np.abs(crossing - (40.0 if cut else 5.0)) < 2.0).all() and len(crossing)


# ---- lakes


def lake_with_two_inlets():
    """A round lake of 30 cells' radius at 10 m; valleys from the north-west and north-east, an outlet in the south."""
    row, column = np.indices((160, 140)).astype(float)
    far = np.hypot(row - 80.0, column - 70.0)
    lake = far < 30.0
    # North of the lake all drains to two valleys; south of it shores rise, but for the outlet's valley.
    north, east = 80.0 - row, np.abs(column - 70.0)
    height = 10.2 + 0.05 * (far - 30.0) + 0.5 * np.abs(east - 0.8 * north)
    south = np.minimum(10.2 + 0.3 * (far - 30.0), 10.0 - 0.05 * (row - 109.0) + 0.5 * east)
    height = np.where(north < 0.0, np.where(row < 109.0, 10.2 + 0.3 * (far - 30.0), south), height)
    height[lake] = 10.0
    return height, lake


@pytest.mark.parametrize("carve", [True, False])
def test_a_lake_with_two_inlets_has_one_outlet_that_carries_all(carve):
    height, lake = lake_with_two_inlets()
    terrain = land(height)
    network = extract_network(terrain, min_drainage_area=2000 * CELL**2, carve=carve)
    assert_forest(network)
    assert network.channel_count == 3 and len(mouths(network)) == 1
    assert not at(lake, sources(network)).any()
    flow = route(terrain, depressions="carve" if carve else "fill")
    assert (flow.water.numpy()[lake] == 1).all() or (flow.water.numpy()[lake] == 1).mean() > 0.99
    assert network.channel_drainage_area.max() == drainage_area(flow).numpy()[159, 70]
    # The inlets meet on the lake, and neither course runs along its shore.
    junction = cells_of(network.node_xy[np.intersect1d(network.channel_from, network.channel_to)])
    assert at(lake, junction).all()
    shore = distance_transform_edt(lake)
    for line in network.polylines():
        inside = cells_of(line)
        inside = inside[at(lake, inside)]
        # From the third cell on it is farther from the shore than two cells, up to the outlet.
        assert (at(shore, inside[(inside[:, 0] < 100.0)]) < 2.5).sum() <= 6
        assert longest_raster_run(line[at(lake, cells_of(line))]) < 25.0


@pytest.mark.parametrize("carve", [True, False])
def test_no_river_begins_on_a_lake_however_low_the_threshold(carve):
    height, lake = lake_with_two_inlets()
    for cells in (20, 60, 200, 600):
        network = extract_network(land(height), min_drainage_area=cells * CELL**2, carve=carve)
        assert_forest(network)
        # A source lies on the cell's centre.
        assert not at(lake, sources(network)).any()


@pytest.mark.parametrize("side", ["south", "east"])
def test_a_lake_at_the_edge_of_a_plane_is_no_comb_of_streams(side):
    """Rivers of a rough plane run into a lake that the edge cuts off, and out over the edge."""
    row, column = np.indices((120, 160)).astype(float)
    height = 10.0 + 0.3 * (120.0 - row) + noise(row.shape, 5.0, 6.0, 2)
    lake = (row > 85.0 + 6.0 * np.sin(column / 12.0)) & (column > 20.0) & (column < 140.0)
    height = np.where(lake, 10.0, np.maximum(height, 10.2 + 0.1 * distance_transform_edt(~lake)))
    if side == "east":
        height, lake = height.T.copy(), lake.T.copy()
    network = extract_network(land(height), min_drainage_area=250 * CELL**2)
    assert_forest(network)
    assert not at(lake, sources(network)).any()
    points = np.concatenate([cells_of(line) for line in network.polylines()])
    points = points[at(lake, points)]
    assert len(points) > 50, "they cross it"
    along = points[:, 0] if side == "south" else points[:, 1]
    depth = np.round(along).astype(int)
    abreast = [len(np.unique(np.round(points[depth == k] / 3.0), axis=0)) for k in range(95, 118)]
    inlets = 8
    assert max(abreast) <= inlets
    # None runs along the edge.
    assert (along > 117.5).mean() < 0.1


def test_rivers_end_at_the_shore_of_the_sea():
    """Level ground at 0 m at an open side: no river goes on over it; half a metre higher it is a lake, and they do."""
    row, _column = np.indices((120, 120)).astype(float)
    height = 0.4 * (80.0 - row) + noise(row.shape, 5.0, 6.0, 0)
    for level, ends in ((0.0, True), (0.5, False)):
        ground = np.maximum(height, 0.0) + level
        network = extract_network(land(ground), min_drainage_area=150 * CELL**2)
        assert_forest(network)
        sea = ground == level
        on_it = np.concatenate([at(sea, cells_of(line)) for line in network.polylines()])
        near_edge = (mouths(network) > 118.0).any(axis=1) | (mouths(network) < 1.0).any(axis=1)
        far_from_sea = at(distance_transform_edt(~sea), mouths(network)) > 1.5
        if ends:
            assert on_it.mean() < 0.02, "smoothing may cut a corner of the shore"
            assert (near_edge | ~far_from_sea).all() and (~near_edge).sum() >= 4
        else:
            assert on_it.mean() > 0.1 and near_edge.all()


def test_rivers_of_a_closed_basin_end_at_the_shore_of_its_lake_and_lose_no_water():
    row, column = np.indices((121, 121)).astype(float)
    far = np.hypot(row - 60.0, column - 60.0)
    height = np.maximum(0.5 * far + noise(row.shape, 5.0, 4.0, 1), 8.0) + 100.0
    lake = height == 108.0
    terrain = land(height)
    network = extract_network(terrain, min_drainage_area=200 * CELL**2, edges="closed")
    assert_forest(network)
    ends = mouths(network)
    off = at(distance_transform_edt(~lake), ends)
    assert len(ends) >= 6 and (off < 1.5).all() and not at(lake, sources(network)).any()
    last = ~np.isin(network.channel_to, network.channel_from)
    flow = route(terrain, depressions="carve", edges="closed")
    area = drainage_area(flow).numpy()
    # All water comes to the lake's cell that the basin drains to; what the rivers bring is a part of it.
    assert area.max() == pytest.approx(121**2 * CELL**2)
    assert (flow.water.numpy()[lake] == 2).mean() > 0.99
    assert 0.5 * 121**2 * CELL**2 < network.channel_drainage_area[last].sum() < area.max()


# ---- edges of the map


def test_a_dem_turned_inside_a_border_without_data_has_the_same_rivers():
    """The same ground on cells at 23 degrees, as a reprojected DEM has it: no streams along the border, no stubs."""
    size, angle = 160, np.radians(23.0)
    row, _column = np.indices((size, size)).astype(float)
    ground = 0.4 * (size - row) + noise((size, size), 6.0, 12.0, 3)
    upright = extract_network(land(ground), min_drainage_area=300 * CELL**2)
    turned_size = 220
    r, c = np.indices((turned_size, turned_size)).astype(float) - 0.5 * (turned_size - 1)
    back = np.array([np.cos(angle) * r - np.sin(angle) * c, np.sin(angle) * r + np.cos(angle) * c])
    back += 0.5 * (size - 1)
    inside = ((back >= 0.0) & (back <= size - 1)).all(axis=0)
    height = np.where(inside, map_coordinates(ground, back, order=1, mode="nearest"), np.nan)
    turned = extract_network(land(height), min_drainage_area=300 * CELL**2)
    assert_forest(turned)
    points = np.concatenate([cells_of(line) for line in turned.polylines()])
    border = distance_transform_edt(inside)
    assert (at(border, points) < 1.5).mean() < 0.03, "they leave over the border and do not follow it"
    assert turned.channel_lengths().min() > 3.0 * CELL * 0.9
    # Back on the upright cells.
    r, c = (points - 0.5 * (turned_size - 1)).T
    there = np.column_stack([np.cos(angle) * r - np.sin(angle) * c, np.sin(angle) * r + np.cos(angle) * c])
    there += 0.5 * (size - 1)
    from scipy.spatial import cKDTree

    known = np.concatenate([cells_of(line) for line in upright.polylines()])
    off = cKDTree(known).query(there)[0]
    print(f"turned to upright: median {np.median(off):.2f} cells, {(off < 3.0).mean():.0%} within 3")
    assert np.median(off) < 1.2 and (off < 3.0).mean() > 0.85
    back_off = cKDTree(there).query(known)[0]
    assert np.median(back_off) < 1.2 and (back_off < 3.0).mean() > 0.75


def test_flats_of_whole_metres_are_not_left_along_the_edge():
    """A plane in steps of a metre: its rivers run down the steps, not along the sides of the map."""
    row, _column = np.indices((150, 150)).astype(float)
    height = np.floor(20.0 + 0.06 * (150.0 - row) + noise(row.shape, 9.0, 1.5, 4))
    network = extract_network(land(height), min_drainage_area=400 * CELL**2)
    assert_forest(network)
    points = np.concatenate([cells_of(line) for line in network.polylines()])
    assert ((points[:, 1] < 1.5) | (points[:, 1] > 147.5)).mean() < 0.03
    assert len(points) > 200 and max(longest_raster_run(line) for line in network.polylines()) < 25.0


# ---- route


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("depressions", ["fill", "carve"])
def test_all_water_gets_out_under_any_rules(seed, depressions):
    """Of ground of few heights, full of flats: every course ends at an outlet, and never rises."""
    rng = np.random.default_rng(seed)
    height, edges = reference.random_heights(rng, 25), reference.random_rules(rng)
    nodata = "wall" if seed % 2 else "outlet"
    flow = route(Terrain(height, 5.0), depressions=depressions, edges=edges, nodata=nodata)
    surface, receiver = flow.terrain.to_numpy(), flow.receiver.numpy().ravel()
    known = np.flatnonzero(receiver >= 0)
    assert len(flow.order) == len(known), "no cycles"
    stays = known[receiver[known] == known]
    outlets = reference.Raster(height, edges, nodata).outlets
    assert {divmod(int(c), height.shape[1]) for c in stays} <= outlets
    level = surface.ravel()
    assert (level[receiver[known]] <= level[known]).all()
    filled = fill_depressions(Terrain(height, 5.0), epsilon=False, edges=edges, nodata=nodata).to_numpy()
    if depressions == "fill":
        assert np.array_equal(surface, filled, equal_nan=True)
    else:
        assert (surface[~np.isnan(filled)] <= filled[~np.isnan(filled)]).all()


def test_a_lake_is_five_cells_wide_or_wider():
    row, column = np.indices((40, 60)).astype(float)
    for width, kind in ((3, 0), (4, 0), (5, 1), (9, 1)):
        height = 50.0 - 0.5 * row + np.abs(column - 30.0)
        pond = (row > 8.0) & (row < 30.0) & (np.abs(column - 30.0) <= (width - 1) / 2)
        height[pond | ((row == 30.0) & (column == 30.0))] = 35.0
        water = route(land(height), depressions="fill").water.numpy()
        assert water[20, 30] == kind and water[2, 30] == 0


def test_flows_keep_their_lakes():
    height, _ = lake_with_two_inlets()
    flow = route(land(height), depressions="fill")
    again = pickle.loads(pickle.dumps(flow))
    made = Flow(flow.terrain, flow.receiver, water=flow.water)
    for other in (again, made):
        assert np.array_equal(other.water.numpy(), flow.water.numpy())
    assert route(land(height)).water is None
    with pytest.raises(ValueError, match="water must be 0 on land"):
        Flow(flow.terrain, flow.receiver, water=np.full(height.shape, 3))
    with pytest.raises(ValueError, match="water has shape"):
        Flow(flow.terrain, flow.receiver, water=np.zeros((2, 2)))


def test_bad_input_says_what_is_wrong():
    terrain = land(lake_with_two_inlets()[0])
    with pytest.raises(ValueError, match="depressions is 'breach'"):
        route(terrain, depressions="breach")
    with pytest.raises(ValueError, match="max_cut is for depressions"):
        route(terrain, depressions="fill", max_cut=10.0)
    with pytest.raises(ValueError, match="max_cut is -1"):
        route(terrain, depressions="carve", max_cut=-1.0)
    with pytest.raises(ValueError, match="drains among 8 neighbours"):
        route(terrain, depressions="carve", neighbors=4)
    with pytest.raises(ValueError, match="stays on level lakes"):
        drainage_area(route(terrain, depressions="fill"), method="mfd")
    with pytest.raises(ValueError, match="max_cut is for carve=True"):
        extract_network(terrain, min_drainage_area=1e6, carve=False, max_cut=10.0)
