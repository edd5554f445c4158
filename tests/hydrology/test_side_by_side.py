"""Streams that run side by side, and stubs, drawn by hand."""

import numpy as np
import pytest
from trees import assert_forest

from warpriver import Terrain
from warpriver.hydrology import extract_network
from warpriver.hydrology.channel_cells import ChannelCells
from warpriver.hydrology.side_by_side import join_side_by_side

# Narrow: about a hundredth of a cell for a thousand cells.
NARROW = 3e-4


def streams(*lines):
    """Channel cells of lines (row, column) from source to mouth, each ending on a cell of an earlier one, or free.

    Every cell brings 10 cells of ground, and lies 1 m lower than the one before; a tributary's last cell lies above
    the one that it flows to.
    """
    place, down, height = [], [], []
    for line in lines:
        *own, last = line
        joins = last in place
        first = len(place)
        own = own if joins else line
        place += own
        down += [*range(first + 1, len(place)), place.index(last) if joins else -1]
        fall = np.arange(len(own), 0, -1.0)
        height += list(fall + (height[place.index(last)] if joins else 0.0))
    n = len(place)
    supply = np.full(n, 10.0)
    to = np.array(down)
    area = supply.copy()
    for start in range(n):
        cell = to[start]
        while cell >= 0:
            area[cell] += 10.0
            cell = to[cell]
    return ChannelCells(np.array(place), np.array(height), area, supply, to)


def column(number, rows):
    return [(row, number) for row in rows]


def source_of(cells, place):
    return int(np.flatnonzero((cells.place == place).all(axis=1))[0])


def total(cells):
    """What leaves through all mouths."""
    return cells.area[cells.down < 0].sum()


@pytest.mark.parametrize("apart", [1, 2, 3, 4])
def test_a_tributary_alongside_joins_where_that_begins(apart):
    """A straight stream, and one that comes close at row 20, runs alongside to row 50 and flows in there."""
    far = [(10 + k, 10 + 20 - k) for k in range(20 - apart)]
    near = column(10 + apart, range(30 - apart, 50))
    last = [(50 + k, 10 + apart - 1 - k) for k in range(apart)]
    cells = streams(column(10, range(70)), [*far, *near, *last])
    joined = join_side_by_side(cells, NARROW)
    assert total(joined) == total(cells) == cells.supply.sum()
    if apart > 3:
        assert len(joined.down) == len(cells.down)
        return
    at = [tuple(p) for p in joined.place.tolist()]
    # On the diagonal it is close a little earlier. What is gone is the length alongside.
    assert all((row, 10 + apart) not in at for row in range(35, 50)) and (10, 30) in at
    cell = source_of(joined, (10, 30))
    while joined.place[cell, 1] != 10:
        before, cell = cell, joined.down[cell]
    row = joined.place[cell, 0]
    assert 25 <= row <= 38 and joined.place[before, 0] < row, "downstream, at a narrow angle"
    # The stream carries all from there on.
    assert joined.area[source_of(joined, (69, 10))] == total(joined)
    assert joined.area[cell] >= 10.0 * (row + 1) + 10.0 * len(far)


def test_a_short_way_alongside_is_a_junction():
    """A tributary that comes at 45 degrees is close for a few cells only, and stays as it is."""
    cells = streams(column(10, range(60)), [(10 + k, 40 - k) for k in range(31)])
    joined = join_side_by_side(cells, NARROW)
    assert np.array_equal(joined.place, cells.place) and np.array_equal(joined.down, cells.down)


def test_water_does_not_rise_to_join():
    """The stream alongside lies higher than the tributary all the way: behind a bank, as on a leveed plain."""
    cells = streams(column(10, range(60)), [(5, 30), *column(12, range(6, 50)), (50, 11), (51, 10)])
    lower = cells.height.copy()
    tributary = cells.place[:, 1] != 10
    # Just above the cell where it flows in.
    lower[tributary] = cells.height[source_of(cells, (51, 10))] + np.linspace(1.0, 0.1, tributary.sum())
    perched = ChannelCells(cells.place, lower, cells.area, cells.supply, cells.down)
    joined = join_side_by_side(perched, NARROW)
    # Its last cell may join one cell earlier at most.
    assert len(perched.down) - len(joined.down) <= 2


def test_two_tributaries_alongside_become_one():
    """Both flow into a third one at rows close to each other; the smaller joins the larger."""
    main = column(60, range(160))
    long = [(130, column_) for column_ in range(61)]
    short = [(128, column_) for column_ in range(20, 61)]
    cells = streams(main, long, short)
    joined = join_side_by_side(cells, NARROW)
    assert total(joined) == total(cells)
    assert (joined.place[:, 0] == 128).sum() < 5 and (joined.place[:, 0] == 130).sum() == 61
    assert joined.area[source_of(joined, (130, 59))] == pytest.approx(10.0 * 60 + 10.0 * 40)


def test_streams_that_leave_the_map_side_by_side_leave_as_one():
    cells = streams(column(10, range(80)), column(12, range(30, 80)), column(20, range(30, 80)))
    joined = join_side_by_side(cells, NARROW)
    assert total(joined) == total(cells) and (joined.down < 0).sum() == 2
    assert (joined.place[:, 1] == 20).sum() == 50 and (joined.place[:, 1] == 12).sum() < 5


def test_wide_rivers_are_close_from_farther_away():
    """Bank to bank: rivers of 8 to 16 cells' width, 8 cells apart, are one; narrow ones are not."""
    cells = streams(
        column(10, range(200)), [(5, 60), *column(18, range(6, 150)), *[(150 + k, 17 - k) for k in range(8)]]
    )
    assert len(join_side_by_side(cells, NARROW).down) == len(cells.down)
    wide = 16.0 / np.sqrt(cells.area.max())
    assert len(join_side_by_side(cells, wide).down) < len(cells.down) - 60


@pytest.mark.parametrize("seed", range(10))
def test_joining_ends_and_keeps_all_water(seed):
    """A random crowd of streams: a forest afterwards, the same water, and nothing left to join."""
    rng = np.random.default_rng(seed)
    size = 60
    place = np.column_stack(np.divmod(np.arange(size * size), size))
    row, col = place.T
    to = (row + 1) * size + np.clip(col + rng.integers(-1, 2, size * size), 0, size - 1)
    keep = rng.random(size * size) < 0.02
    for start in np.flatnonzero(keep):
        cell = start
        while row[cell] < size - 1 and not keep[to[cell]]:
            cell = to[cell]
            keep[cell] = True
    number = np.cumsum(keep) - 1
    down = np.where(row < size - 1, number[np.minimum(to, size * size - 1)], -1)[keep]
    supply = rng.integers(1, 20, keep.sum()).astype(float)
    area = supply.copy()
    for cell in np.argsort(row[keep], kind="stable"):
        if down[cell] >= 0:
            area[down[cell]] += area[cell]
    cells = ChannelCells(place[keep], -row[keep].astype(float), area, supply, down)
    joined = join_side_by_side(cells, NARROW)
    assert total(joined) == total(cells)
    inner = joined.down >= 0
    assert (joined.area[joined.down[inner]] > joined.area[inner]).all()
    assert (joined.height[joined.down[inner]] <= joined.height[inner]).all()
    assert len(join_side_by_side(joined, NARROW).down) == len(joined.down)


def test_stubs_are_left_out_and_their_water_stays():
    """A straight valley with short side valleys that drain just the threshold: a comb; a long one stays."""
    row, column_ = np.indices((200, 200)).astype(float)
    height = 60.0 - 0.1 * row + 0.4 * np.abs(column_ - 60.0)
    for k in range(10, 200, 20):
        ridge = 0.8 * np.abs((row - k + 10) % 20 - 10)
        height = np.where((column_ > 60) & (np.abs(row - k) <= 10), height + ridge, height)
    terrain = Terrain(height, 10.0)
    # The side valleys drain 20 x 139 cells: that threshold is reached near the stream, half of it far from it.
    few = extract_network(terrain, min_drainage_area=2600 * 100.0, smoothing=0)
    many = extract_network(terrain, min_drainage_area=1300 * 100.0, smoothing=0)
    for network in (few, many):
        assert_forest(network)
        first = ~np.isin(network.channel_from, network.channel_to)
        assert network.channel_lengths()[first].min() >= 0.3 * np.sqrt(1300 * 100.0) - 10.0
    assert few.channel_count < 4 and many.channel_count > 12
    assert few.channel_drainage_area.max() == many.channel_drainage_area.max()
