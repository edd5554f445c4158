"""The kernels of what a floodplain remembers against their twins, however the points are dealt out."""

import numpy as np
import pytest
import reference_floodplain as twin
import warp as wp
from kernel_arrays import (
    DEALS,
    SCALARS,
    bits_of,
    channels_of,
    forms,
    points_of,
    share_out,
    split,
    starts_of,
    status_of,
    struct_of,
    to_device,
    vec2_of,
)

from warpriver.kernels import floodplain
from warpriver.kernels.floodplain import NEVER, TICKS
from warpriver.kernels.status import BEGUN, HALT, NUMBER, STEPS, SUBSTEP_SIZE, TOTAL

ROWS, COLUMNS = 60, 90
GRID = (-100.0, 500.0, 12.0)
LAW = {"bar": (0.5, 20.0), "plug": (-0.7, 300.0), "unrest": (1.5, 5.0)}
NOW = 1000 * TICKS


class Case:
    """Lines over a map, on a device."""

    def __init__(self, dtype, device, *, kinds=("river", "plug", "unrest"), width=40.0):
        self.scalar, self.device = SCALARS[dtype], device
        self.kernel, self.vec2 = floodplain.build(self.scalar), vec2_of(self.scalar)
        rng = np.random.default_rng(4)
        self.cells = {}
        for kind in ("river", "plug", "unrest"):
            dates = NOW - rng.integers(0, 40 * TICKS, (ROWS, COLUMNS))
            dates[rng.random(dates.shape) < 0.4] = NEVER
            self.cells[kind] = dates if kind in kinds else np.full(dates.shape, NEVER)
        names = {"bar_change": LAW["bar"][0], "bar_time": LAW["bar"][1]}
        for kind in ("plug", "unrest"):
            names |= {f"{kind}_change": LAW[kind][0], f"{kind}_time": LAW[kind][1]}
        self.plain = struct_of(self.kernel.Floodplain, rows=ROWS, columns=COLUMNS, **names)
        for kind in kinds:
            setattr(self.plain, kind, to_device(self.cells[kind].ravel().astype(np.int32), int, device))
        self.plain.grid.west, self.plain.grid.north, self.plain.grid.cell_size = GRID
        self.plain.grid.cells_per_meter = 1.0 / GRID[2]
        x = np.linspace(-150.0, 1050.0, 49)
        self.lines = [np.stack([x, y0 + 60.0 * np.sin(x / k)], axis=1) for y0, k in ((300.0, 70.0), (40.0, 11.0))]
        self.start = starts_of(self.lines)
        self.width = np.array([width, 25.0])
        self.xy = np.concatenate(self.lines)
        # The second channel rests in one of the cases.
        self.step = np.array([0.3, 0.3])

    def channels(self):
        form = forms(self.width, np.ones(2), self.width, np.ones(2), self.scalar, self.device)
        arrays = {"spacing": to_device(np.array([25.0, 25.0]), self.scalar, self.device)}
        arrays |= {"step": to_device(self.step, self.scalar, self.device)}
        return channels_of(self.scalar, start=to_device(self.start, int, self.device), form=form, **arrays)

    def launch(self, name, deal, outputs, halt=0):
        points = points_of(self.scalar, to_device(self.xy, self.vec2, self.device))
        now = to_device(np.array([NOW]), int, self.device)
        for part in share_out(deal, 2, len(self.xy), self.device, halt=halt):
            inputs = [self.channels(), points, self.plain, part.work, now]
            wp.launch(getattr(self.kernel, name), part.threads, inputs, outputs, device=self.device)

    def twin_moves(self, way):
        cells = twin.cell_factors(self.cells["river"], self.cells["plug"], self.cells["unrest"], NOW, LAW)
        size = np.hypot(*way.T)
        width = np.repeat(self.width, np.diff(self.start))
        with np.errstate(invalid="ignore", divide="ignore"):
            ahead = self.xy + ((0.5 * width + 1.5 * GRID[2]) / size)[:, None] * way
        factor = np.where(size > 0.0, twin.factors_at(cells, GRID, np.nan_to_num(ahead)), 1.0)
        tight = np.concatenate([_tight(line, w) for line, w in zip(self.lines, self.width, strict=True)])
        factor = np.where((factor < 1.0) & ((tight * way).sum(axis=1) > 0.0), 1.0, factor)
        return self.xy + factor[:, None] * way, factor * size / 0.3


def _tight(line, width):
    """Second difference at points that are bent more tightly than the width, else 0, (n, 2)."""
    a, b = np.diff(line, axis=0)[:-1], np.diff(line, axis=0)[1:]
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    bend = 2.0 * cross / (np.hypot(*a.T) * np.hypot(*b.T) * np.hypot(*(a + b).T))
    found = np.zeros_like(line)
    found[1:-1] = np.where((np.abs(bend) * width > 1.0)[:, None], b - a, 0.0)
    return found


@pytest.mark.parametrize("deal", DEALS)
def test_ways_are_scaled_as_by_the_twin(deal, device, dtype):
    case = Case(dtype, device)
    way = np.random.default_rng(2).normal(0.0, 3.0, case.xy.shape)
    way[::7] = 0.0
    moved = to_device(case.xy + way, case.vec2, device)
    speed = wp.zeros(2, dtype=case.scalar, device=device)
    case.launch("scale_moves", deal, [moved, bits_of(speed)])
    expected, fastest = case.twin_moves(way)
    tolerance = 1e-9 if dtype == "float64" else 2e-3  # float32: a place rounds to the other side of a cell's centre
    np.testing.assert_allclose(moved.numpy(), expected, atol=tolerance)
    found = [part.max() for part in split(fastest, case.start)]
    np.testing.assert_allclose(speed.numpy(), found, rtol=1e-9 if dtype == "float64" else 1e-3)
    assert np.ptp(np.hypot(*(expected - case.xy)[way[:, 0] != 0.0].T) / np.hypot(*way[way[:, 0] != 0.0].T)) > 1.0


@pytest.mark.parametrize("kinds", [(), ("river",), ("plug",), ("unrest",), ("river", "plug")])
def test_what_is_not_remembered_has_no_effect(kinds, device):
    case = Case("float64", device, kinds=kinds)
    way = np.random.default_rng(2).normal(0.0, 3.0, case.xy.shape)
    moved = to_device(case.xy + way, case.vec2, device)
    speed = wp.zeros(2, dtype=case.scalar, device=device)
    case.launch("scale_moves", "one slab", [moved, bits_of(speed)])
    np.testing.assert_allclose(moved.numpy(), case.twin_moves(way)[0], atol=1e-9)
    if not kinds:
        np.testing.assert_array_equal(moved.numpy(), case.xy + way)


@pytest.mark.parametrize("deal", DEALS)
def test_the_river_dates_the_cells_that_it_covers_and_channels_that_rest_do_not(deal, device):
    case = Case("float64", device)
    case.step[1] = 0.0
    dates = to_device(np.full(ROWS * COLUMNS, NEVER), int, device)
    case.launch("mark_courses", deal, [dates], halt=1)
    assert (dates.numpy() == NEVER).all()
    case.launch("mark_courses", deal, [dates])
    line = case.lines[0]
    pieces = np.ceil(np.hypot(*np.diff(line, axis=0).T) / 20.0).astype(int)
    parts = [a + np.arange(n)[:, None] / n * (b - a) for a, b, n in zip(line[:-1], line[1:], pieces, strict=True)]
    expected = twin.discs((ROWS, COLUMNS), GRID, np.concatenate([*parts, line[-1:]]), 20.0)
    np.testing.assert_array_equal(dates.numpy().reshape(ROWS, COLUMNS), np.where(expected, NOW, NEVER))
    assert 100 < expected.sum() < 0.5 * expected.size


def test_plugs_and_unrest_raise_dates_alone(device, dtype):
    case = Case(dtype, device)
    before = case.cells["plug"].astype(np.int32)
    xy, radius = np.array([[100.0, 300.0], [130.0, 310.0], [-500.0, 0.0]]), np.array([20.0, 30.0, 20.0])
    places = [to_device(xy, case.vec2, device), to_device(radius, case.scalar, device)]
    cells, date = to_device(before.ravel(), int, device), NOW - 30 * TICKS
    wp.launch(case.kernel.lay_plugs, 3, [case.plain, *places, date], [cells], device=device)
    covered = twin.discs(before.shape, GRID, xy, radius)
    expected = np.where(covered, np.maximum(before, date), before)
    np.testing.assert_array_equal(cells.numpy().reshape(before.shape), expected)
    assert (expected != before).sum() > 5

    neck, reach, spread = np.array([[150.0, 250.0], [600.0, 200.0]]), np.array([60.0, 40.0]), 3.0
    places = [to_device(neck, case.vec2, device), to_device(reach, case.scalar, device)]
    cells = to_device(np.full(before.size, NEVER), int, device)
    inputs = [case.plain, case.scalar(spread), *places, NOW]
    wp.launch(case.kernel.spread_unrest, (2, 40), inputs, [cells], device=device)
    row, column = np.indices(before.shape)
    x, y = GRID[0] + (column + 0.5) * GRID[2], GRID[1] - (row + 0.5) * GRID[2]
    away = np.stack([np.hypot(x - a, y - b) / r for (a, b), r in zip(neck, reach, strict=True)])
    expected = NOW - away * LAW["unrest"][1] * TICKS
    found = cells.numpy().reshape(before.shape)
    near = np.where(away <= spread, expected, -np.inf).max(axis=0)
    sure = (np.abs(away - spread) > 1e-3).all(axis=0)
    np.testing.assert_array_equal(found[sure] == NEVER, ~np.isfinite(near[sure]))
    seen = sure & np.isfinite(near)
    np.testing.assert_allclose(found[seen], near[seen], atol=1.0)
    assert 200 < seen.sum() < 0.6 * seen.size


def test_the_date_is_that_of_the_sub_step(device):
    kernel = floodplain.build(wp.float64)
    now, substep = to_device(np.array([5]), int, device), np.zeros(SUBSTEP_SIZE, np.int32)
    substep[NUMBER], substep[TOTAL] = 1, 4
    for halt, expected in ((1, 5), (0, round(103.25 * 0.3 * TICKS))):
        status = status_of({BEGUN: 100, STEPS: 3, HALT: halt}, device)
        inputs = [wp.float64(0.3), to_device(substep, int, device), status]
        wp.launch(kernel.tell_date, 1, inputs, [now], device=device)
        assert now.numpy().tolist() == [expected]
