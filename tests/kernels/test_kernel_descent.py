"""Descent in any direction against a twin on plain Python structures, and on planes, whose direction is known."""

import math

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from padded_cells import Case
from reference_hydrology import Raster, random_heights, random_rules

from warpriver.kernels import descent

SEEDS = st.integers(0, 2**32 - 1)


def led(case):
    """Receivers by ``measure_descents`` and ``lead_downhill``, (rows, columns)."""
    kernel, side, crossing = descent.build(case.scalar), case.scratch(wp.uint8, 255), case.scratch(case.scalar)
    inputs = [case.stride, case.height, case.state]
    case.launch(kernel.measure_descents, inputs, [side, crossing], dim=case.rows)
    own = np.arange(case.rows * case.shape[1], dtype=np.int32).reshape(case.shape)
    own[np.isnan(case.cells.height[1:-1, 1:-1])] = -1
    receiver = wp.array(own, dtype=int, device=case.device)
    scratch = [case.scratch(int), case.scratch(int, 1), case.scratch(int, 0), case.scratch(case.scalar, 0.0)]
    inputs = [case.rows, case.stride, case.state, side, crossing]
    case.launch(kernel.lead_downhill, inputs, [case.scratch(wp.uint8, 0), *scratch, receiver])
    return receiver.numpy()


def reference_receivers(raster):
    """The same from its definition: cells from high to low, deviations along the largest donor."""
    height = raster.height
    receiver, gathered = {}, dict.fromkeys(height, 1)
    largest, drift = dict.fromkeys(height, 0), dict.fromkeys(height, 0.0)
    for cell in sorted(height, key=lambda c: -height[c]):
        receiver[cell] = cell
        near = dict(raster.neighbors(cell))
        best = (0.0, 0.0, None, 1)
        for k in (0, 2, 4, 6):
            for turn in (-1, 1):
                straight, diagonal = near.get(k), near.get((k + turn) % 8)
                a = height[cell] - height[straight] if straight else None
                b = height[straight] - height[diagonal] if straight and diagonal else None
                if diagonal and (straight is None or b >= a):
                    slope, crossing = (height[cell] - height[diagonal]) * math.sqrt(0.5), 1.0
                elif straight:
                    aslant = b is not None and b > 0.0
                    slope, crossing = (math.sqrt(a * a + b * b), b / a) if aslant else (a, 0.0)
                else:
                    continue
                if slope > best[0]:
                    best = (slope, crossing, k, turn)
        if best[2] is None or cell in raster.outlets:
            continue
        _, crossing, k, turn = best
        rise = turn / math.sqrt(1.0 + crossing * crossing)
        ends = [(k, drift[cell] - rise * crossing)]
        if crossing > 0.0:
            ends.append(((k + turn) % 8, drift[cell] + rise * (1.0 - crossing)))
        to, moved = ends[-1] if crossing == 1.0 else min(ends, key=lambda end: abs(end[1]))
        to = receiver[cell] = near[to]
        gathered[to] += gathered[cell]
        if gathered[cell] > largest[to]:
            largest[to], drift[to] = gathered[cell], moved
    columns = raster.shape[1]
    return raster.table({cell: to[0] * columns + to[1] for cell, to in receiver.items()}, np.int32, -1)


@settings(max_examples=300, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_receivers_equal_the_reference(seed):
    """On heights that all differ, so that the order of equal donors does not matter."""
    rng = np.random.default_rng(seed)
    height = random_heights(rng, 9)
    height += rng.uniform(0.0, 0.3, height.shape)
    edges, nodata = random_rules(rng), "outlet" if rng.random() < 0.5 else "wall"
    case, raster = Case(height, edges=edges, nodata=nodata), Raster(height, edges, nodata)
    found, expected = led(case), reference_receivers(raster)
    same = found == expected
    # Two donors may have gathered the same: then the course below one of them has another deviation.
    assert same.mean() > 0.9 and np.array_equal(found < 0, expected < 0)
    level = case.cells.height[1:-1, 1:-1].ravel()
    inner = np.flatnonzero(found.ravel() >= 0)
    moves = inner[found.ravel()[inner] != inner]
    assert (level[found.ravel()[moves]] < level[moves]).all(), "always downhill"
    stays = {divmod(int(c), height.shape[1]) for c in np.setdiff1d(inner, moves)}
    assert stays == {c for c in raster.height if c in raster.outlets or not any(
        raster.height[n] < raster.height[c] for _, n in raster.neighbors(c))}  # fmt: skip


@pytest.mark.parametrize("degrees", [0.0, 7.0, 14.0, 22.5, 30.0, 45.0, 52.0, 71.0, 90.0])
def test_on_a_plane_courses_run_straight_down_whatever_its_direction(device, dtype, degrees):
    """Within a cell of the line of descent over 100 cells, where the eight directions would be off by up to 38."""
    angle = np.radians(degrees)
    row, column = np.indices((120, 120)).astype(float)
    case = Case(1000.0 - (np.sin(angle) * row + np.cos(angle) * column), dtype=dtype, device=device)
    receiver = led(case).ravel()
    cell, course = 1 * 120 + 1, []
    while receiver[cell] != cell:
        course.append(divmod(cell, 120))
        cell = receiver[cell]
    offset = (np.array(course) - 1.0) @ np.array([np.cos(angle), -np.sin(angle)])
    assert len(course) > 80 and np.abs(offset).max() < 1.0


def test_on_a_cone_courses_run_from_the_middle_out(device, dtype):
    """From points around the top to the rim: the direction changes by less than a cell over 60."""
    row, column = np.indices((151, 151)).astype(float) - 75.0
    case = Case(1000.0 - np.hypot(row, column), dtype=dtype, device=device)
    receiver = led(case).ravel()
    for degrees in range(0, 360, 17):
        along = np.array([np.sin(np.radians(degrees)), np.cos(np.radians(degrees))])
        start = np.round(10.0 * along).astype(int)
        cell = (start[0] + 75) * 151 + start[1] + 75
        while receiver[cell] != cell and np.hypot(*(np.array(divmod(int(cell), 151)) - 75.0)) < 70.0:
            cell = receiver[cell]
        end = np.array(divmod(int(cell), 151)) - 75.0
        off = abs(end @ np.array([start[1], -start[0]])) / np.hypot(*start)
        # The same in proportion to the distance from the top.
        assert off < 6.0, degrees
