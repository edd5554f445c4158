"""Flats against a march on Python's heap, equal to the bit, and against distances and lines in the plane."""

import numpy as np
import pytest
import reference_flats as reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import REALS, to_device
from padded_cells import Case
from reference_hydrology import Raster, fill, no_step, random_heights, random_rules

from warpriver.kernels import depressions, flats

SEEDS = st.integers(0, 2**32 - 1)
BEGIN = {reference.SHORES: flats.SHORES, reference.EXITS: flats.EXITS}


class Listed:
    """Flats of a case, as ``list_flats`` lists them, and marches over them."""

    def __init__(self, case):
        self.case, self.kernel = case, flats.build(case.scalar)
        pit = case.scratch(wp.uint8, 0)
        find_pits = depressions.build(case.scalar).find_pits
        case.launch(find_pits, [case.stride, case.height, case.state], [pit], dim=case.rows)
        count = wp.zeros(2, dtype=int, device=case.device)
        start, inner, cell = (case.scratch(int) for _ in range(3))
        self.member = case.scratch(int, -1)
        self.arrays = start, inner, cell
        case.launch(self.kernel.list_flats, [pit], [self.struct(flats.SHORES, 0.0), count])
        self.count, self.flat_count = (int(n) for n in count.numpy())
        self.start, self.inner = start.numpy()[: self.flat_count + 1], inner.numpy()[: self.flat_count]
        row, column = np.divmod(cell.numpy()[: self.count], case.stride)
        self.cell = list(zip((row - 1).tolist(), (column - 1).tolist(), strict=True))

    def struct(self, begin, toll):
        s, case = self.kernel.Flats(), self.case
        s.rows, s.stride, s.begin, s.toll = case.rows, case.stride, begin, toll
        s.height, s.state, s.cell_member = case.height, case.state, self.member
        s.start, s.inner, s.member_cell = self.arrays
        return s

    def of_members(self, kind):
        return wp.empty(self.count, dtype=kind, device=self.case.device)

    def march(self, begin, cost, toll=0.0):
        """Device arrays: length, side, crossing, order."""
        case = self.case
        length, crossing = self.of_members(case.scalar), self.of_members(case.scalar)
        side, (order, place, heap) = self.of_members(wp.uint8), (self.of_members(int) for _ in range(3))
        inputs = [self.struct(begin, toll), to_device(np.asarray(cost, REALS[self.dtype]), case.scalar, case.device)]
        outputs = [length, side, crossing, order, place, heap]
        case.launch(self.kernel.march_flats, inputs, outputs, dim=self.flat_count)
        return length, side, crossing, order

    @property
    def dtype(self):
        return "float64" if self.case.scalar is wp.float64 else "float32"

    def lead(self, side, crossing, order):
        """Receiver of each member, as (row, column)."""
        case = self.case
        receiver = wp.full(case.shape, -7, dtype=int, device=case.device)
        outputs = [self.of_members(int), self.of_members(int), self.of_members(case.scalar), receiver]
        inputs = [self.struct(flats.EXITS, 0.0), side, crossing, order]
        case.launch(self.kernel.lead_flats, inputs, outputs, dim=self.flat_count)
        to = receiver.numpy()
        inside = np.zeros(case.shape, bool)
        inside[tuple(np.array(self.cell, int).reshape(-1, 2).T)] = True
        assert (to[~inside] == -7).all(), "only members are written"
        columns = case.shape[1]
        return {cell: divmod(int(to[cell]), columns) for cell in self.cell}


def filled_case(seed, **options):
    """A random raster of a few heights, filled level, as a case and as the reference has it."""
    rng = np.random.default_rng(seed)
    edges, nodata = random_rules(rng), "outlet" if rng.random() < 0.5 else "wall"
    height = random_heights(rng, 12)
    if rng.random() < 0.5:
        height = np.floor(height / 3.0)
    level = fill(Raster(height, edges, nodata), no_step)
    return Case(level, edges=edges, nodata=nodata, **options), Raster(level, edges, nodata), rng


@settings(max_examples=150, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_flats_are_listed_and_led_as_by_the_reference_to_the_bit(seed):
    case, raster, rng = filled_case(seed)
    listed, expected = Listed(case), reference.flats(raster)
    assert listed.flat_count == len(expected)
    assert listed.cell == [cell for flat in expected for cell in flat.members]
    assert listed.inner.tolist() == [int(bool(flat.inner)) for flat in expected]
    if not expected:
        return
    cost = rng.choice([0.5, 1.0, 1.7, 40.0], listed.count)
    costs = dict(zip(listed.cell, cost.tolist(), strict=True))
    for begin, toll in ((reference.SHORES, 0.0), (reference.EXITS, 0.0), (reference.EXITS, 4.0)):
        length, side, crossing, order = listed.march(BEGIN[begin], cost, toll)
        ways = [reference.march(flat, begin, costs, toll) for flat in expected]
        found = dict(zip(listed.cell, length.numpy().tolist(), strict=True))
        reached = {cell: way[0] for some in ways for cell, way in some.items()}
        assert {cell: far for cell, far in found.items() if np.isfinite(far)} == reached
    assert len(reached) == listed.count, "every flat of a filled surface has an exit"
    arrival = [listed.cell[member] for member in order.numpy()]
    assert arrival == [cell for some in ways for cell in some]
    receiver = listed.lead(side, crossing, order)
    assert receiver == {k: v for flat, some in zip(expected, ways, strict=True) for k, v in
                        reference.lead(flat, some).items()}  # fmt: skip


def lake(size, center, exit_cell, dtype="float64", device="cpu"):
    """A round flat of height 1 in ground of height 2, with an exit at its rim."""
    row, column = np.indices((size, size))
    far = np.hypot(row - center[0], column - center[1])
    height = np.where(far < 0.45 * size, 1.0, 2.0)
    height[exit_cell] = 1.0
    # On to the edge.
    height[exit_cell[0] + 1 :, exit_cell[1]] = -np.arange(1.0, size - exit_cell[0])
    return Case(height, dtype=dtype, device=device)


def test_distances_to_the_shore_are_those_in_the_plane(device, dtype):
    """To the nearest higher cell; a fast march on cells is off by a few per cent, and by less the farther away."""
    from scipy.ndimage import distance_transform_edt

    size = 81
    listed = Listed(lake(size, (40, 40), (76, 40), dtype, device))
    length = listed.march(flats.SHORES, np.ones(listed.count))[0].numpy().astype(float)
    row, column = np.indices((size, size))
    exact = distance_transform_edt(np.hypot(row - 40, column - 40) < 0.45 * size)
    exact = np.array([exact[cell] for cell in listed.cell])
    # Near the exit, which is no shore, it is farther; around the lake the ground is level too.
    from_exit = np.array([np.hypot(cell[0] - 76, cell[1] - 40) for cell in listed.cell])
    off = (from_exit > exact + 1.0) & (exact > 0.0)
    error = (length[off] - exact[off]) / exact[off]
    assert off.sum() > 3000
    assert -0.02 < error.min() and error.max() < 0.09 and np.abs(error[exact[off] > 10.0]).max() < 0.04


@pytest.mark.parametrize("angle", np.radians([3.0, 11.0, 20.0, 22.5, 33.0, 40.0, 58.0, 80.0]))
def test_courses_over_even_ground_are_straight_in_any_direction(device, dtype, angle):
    """From the far side of a flat of even cost to the one exit: within two and a half cells of the straight line.

    Steepest descent among eight neighbours would run along two of their directions, off by up to a fifth of the way.
    """
    size = 161
    row, column = np.indices((size, size))
    height = np.where((row > 0) & (column > 0), 1.0, 2.0)
    height[[-1, 0], :], height[:, -1] = 2.0, 2.0
    height[0, 0], height[1, 1] = -1.0, 1.0
    height[0, 1] = height[1, 0] = 2.0
    case = Case(height, edges="closed", dtype=dtype, device=device)
    listed = Listed(case)
    _, side, crossing, order = listed.march(flats.EXITS, np.ones(listed.count))
    receiver = listed.lead(side, crossing, order)
    reach = 150
    cell = (1 + round(reach * np.sin(angle)), 1 + round(reach * np.cos(angle)))
    along = np.array(cell) - 1.0
    along /= np.hypot(*along)
    course = [cell]
    while course[-1] in receiver:
        course.append(receiver[course[-1]])
    offset = (np.array(course) - 1.0) @ np.array([along[1], -along[0]])
    assert course[-1] == (1, 1) and np.abs(offset).max() < 2.5
    assert len(course) < 1.1 * reach


def test_of_a_mouths_exits_the_middle_is_taken(device, dtype):
    """A strip of nine cells between walls that ends in nine exits: at a toll all leave by the middle one."""
    height = np.full((30, 11), 5.0)
    height[1:, 1:-1] = 1.0
    height[25:, 1:-1] -= np.arange(5.0)[:, None] * 0.1
    case = Case(height, dtype=dtype, device=device)
    listed = Listed(case)
    shore = listed.march(flats.SHORES, np.ones(listed.count))[0].numpy().astype(float)
    used = {}
    for toll in (0.0, 8.0):
        _, side, crossing, order = listed.march(flats.EXITS, 1.0 / shore, toll)
        receiver = listed.lead(side, crossing, order)
        used[toll] = {to for to in receiver.values() if to not in receiver}
    assert len(used[0.0]) > 3 and used[8.0] == {(25, 5)}
