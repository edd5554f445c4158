"""Routing kernels against courses followed cell by cell, and by hand."""

import itertools

import numpy as np
import pytest
import reference_hydrology as reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import REALS, SCALARS, to_device
from padded_cells import Case

from warpriver.kernels import routing

SEEDS = st.integers(0, 2**32 - 1)
# Sums of a few hundred steps of 1 and sqrt(2), and of shares; the order of additions differs from the reference.
TOLERANCE = {"float64": 1e-12, "float32": 1e-4}


def random_case(seed, largest=9, **options):
    """A random raster and rules, as a case and as the reference has it."""
    rng = np.random.default_rng(seed)
    height, edges, nodata = reference.random_heights(rng, largest), reference.random_rules(rng), "outlet"
    if rng.random() < 0.5:
        nodata = "wall"
    return Case(height, edges=edges, nodata=nodata, **options), reference.Raster(height, edges, nodata), rng


def random_receiver(seed, largest=9):
    """Receivers of a random raster, (rows, columns)."""
    return reference.receivers(random_case(seed, largest)[1])


def received(case, four=0, ties=0, seed=0):
    """Receivers of a case by the kernel."""
    out = wp.zeros(case.shape, dtype=int, device=case.device)
    inputs = [case.rows, case.stride, four, ties, seed, case.height, case.state]
    case.launch(routing.build(case.scalar).find_receivers, inputs, [out], dim=case.rows)
    return out.numpy()


class Courses:
    """Receivers on a device with their order; each kernel along them has its method."""

    def __init__(self, receiver, dtype="float64", device="cpu"):
        self.kernel, self.scalar, self.device = routing.build(SCALARS[dtype]), SCALARS[dtype], device
        self.shape, self.columns = receiver.shape, receiver.shape[1]
        self.receiver = to_device(receiver.ravel(), wp.int32, device)
        count, order = wp.zeros(1, dtype=int, device=device), wp.zeros(receiver.size, dtype=int, device=device)
        donors = wp.zeros(receiver.size, dtype=wp.uint8, device=device)
        wp.launch(self.kernel.order_cells, 1, [self.receiver], [count, order, donors], device=device)
        self.order = order[: int(count.numpy()[0])] if count.numpy()[0] else wp.empty(0, dtype=int, device=device)

    def run(self, name, start, *inputs):
        """Launch a kernel that changes one array."""
        value = to_device(np.ravel(start), self.scalar, self.device)
        head = [self.columns] if name.startswith("measure") else []
        inputs = [*head, self.receiver, self.order, *inputs]
        wp.launch(getattr(self.kernel, name), 1, inputs, [value], device=self.device)
        return value.numpy().reshape(self.shape)

    def sum_upstream(self, start):
        return self.run("sum_upstream", start)

    def measure_downstream(self, start):
        return self.run("measure_downstream", start)

    def measure_upstream(self, start):
        return self.run("measure_upstream", start)

    def carry_upstream(self, start, fixed):
        return self.run("carry_upstream", start, to_device(fixed.ravel().astype(np.uint8), wp.uint8, self.device))


# ---- find_receivers


def test_water_takes_the_steepest_of_eight_ways(device, dtype):
    """Diagonals are sqrt(2) longer: a drop of 1.4 there is less steep than 1.0 straight on, 1.5 is steeper."""
    for k, (row, column) in enumerate(reference.STEPS):
        height = np.full((3, 3), 9.0)
        height[1, 1] = 5.0
        for other, (r, c) in enumerate(reference.STEPS):
            height[1 + r, 1 + c] = 5.0 - (1.0 if other % 2 == 0 else 1.4)
        height[1 + row, 1 + column] = 5.0 - (1.01 if k % 2 == 0 else 1.5)
        out = received(Case(height, dtype=dtype, device=device))
        assert out[1, 1] == (1 + row) * 3 + 1 + column
        out[1, 1] = 4
        assert np.array_equal(out.ravel(), np.arange(9)), "outlets keep their water"


def test_equal_slopes_go_clockwise_from_the_north(device, dtype):
    height = np.full((3, 3), 5.0)
    height[1, 1] = 6.0
    for row, column in ((0, 1), (1, 2), (2, 1), (1, 0)):  # north, east, south, west; diagonals are less steep
        assert received(Case(height, dtype=dtype, device=device))[1, 1] == row * 3 + column
        height[row, column] = 7.0


@settings(max_examples=300, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_receivers_equal_the_reference(seed):
    case, raster, _ = random_case(seed)
    assert np.array_equal(received(case), reference.receivers(raster))


@settings(max_examples=100, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_receivers_by_hash_and_among_four_equal_the_reference(seed):
    """Heights are whole numbers, so that many slopes are equal."""
    rng = np.random.default_rng(seed)
    height, edges = np.rint(reference.random_heights(rng, 9) / 4.0), reference.random_rules(rng)
    case, raster = Case(height, edges=edges), reference.Raster(height, edges)
    lot = int(rng.integers(2**31))
    for four in (False, True):
        assert np.array_equal(received(case, int(four), 1, lot), reference.receivers(raster, four, lot))
        assert np.array_equal(received(case, int(four)), reference.receivers(raster, four))


def test_ties_are_broken_evenly(device):
    """On a ridge that falls to both sides, by steps of one column: half of the cells drain west, each by itself."""
    height = np.repeat(-np.abs(np.arange(3) - 1.0)[None, :], 4001, axis=0)
    case = Case(height, edges={"north": "closed", "south": "closed", "east": "open", "west": "open"}, device=device)
    west = received(case, 0, 1, 5)[:, 1] == 3 * np.arange(4001)
    # Four standard deviations; runs would be longer or shorter if neighbours were not independent.
    assert abs(west.sum() - 2000.5) < 4.0 * np.sqrt(4001) / 2.0
    assert abs((west[1:] == west[:-1]).sum() - 2000) < 4.0 * np.sqrt(4000) / 2.0
    assert (received(case, 0, 1, 6)[:, 1] != received(case, 0, 1, 5)[:, 1]).mean() > 0.4


# ---- order_cells, sum_upstream, measure_downstream, measure_upstream, carry_upstream


@settings(max_examples=150, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_order_cells_puts_each_before_its_receiver(seed):
    receiver = random_receiver(seed)
    order = Courses(receiver).order.numpy()
    assert np.array_equal(np.sort(order), np.flatnonzero(receiver.ravel() >= 0))
    place = np.empty(receiver.size, int)
    place[order] = np.arange(len(order))
    to = receiver.ravel()[order]
    assert ((place[to] > place[order]) | (to == order)).all()


def test_order_cells_leaves_out_a_cycle_and_what_flows_into_one_stays(device):
    receiver = np.array([[1, 2, 1, 2], [5, 5, 5, 7]], np.int32)
    # 1 and 2 lead to each other; 0 and 3 flow in.
    assert sorted(Courses(receiver, device=device).order.numpy().tolist()) == [0, 3, 4, 5, 6, 7]


@settings(max_examples=150, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_sums_and_lengths_equal_the_reference(seed):
    receiver = random_receiver(seed)
    courses = Courses(receiver)
    one, zero = np.where(receiver < 0, np.nan, 1.0), np.where(receiver < 0, np.nan, 0.0)
    down, up = reference.lengths(receiver)
    tolerance = {"rtol": TOLERANCE["float64"], "equal_nan": True}
    assert np.array_equal(courses.sum_upstream(one), reference.d8_cells(receiver), equal_nan=True)
    assert np.allclose(courses.measure_downstream(zero), down, **tolerance)
    assert np.allclose(courses.measure_upstream(zero), up, **tolerance)


@settings(max_examples=150, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_values_carried_upstream_are_those_of_the_first_fixed_cell(seed):
    receiver, rng = random_receiver(seed), np.random.default_rng(seed)
    fixed = (rng.random(receiver.shape) < 0.3) & (receiver >= 0)
    value = rng.normal(size=receiver.shape)
    found = Courses(receiver).carry_upstream(np.where(fixed, value, np.nan), fixed)
    assert np.array_equal(found, reference.first_value(receiver, fixed, value), equal_nan=True)


def test_a_short_course_by_hand(device, dtype):
    """Cells 0 -> 4 -> 5 with a fork at 1 -> 5, in two rows of three; 3 has no data."""
    receiver = np.array([[4, 5, 2], [-1, 5, 5]], np.int32)
    courses = Courses(receiver, dtype, device)
    start = np.array([[1.0, 1.0, 1.0], [np.nan, 1.0, 1.0]])
    diagonal = REALS[dtype](np.sqrt(2.0))
    assert np.array_equal(courses.sum_upstream(start), [[1, 1, 1], [np.nan, 2, 4]], equal_nan=True)
    expected = np.array([[1.0 + diagonal, diagonal, 0.0], [np.nan, 1.0, 0.0]])
    assert np.allclose(courses.measure_downstream(0.0 * start), expected, rtol=1e-6, equal_nan=True)
    expected = np.array([[0.0, 0.0, 0.0], [np.nan, diagonal, 1.0 + diagonal]])
    assert np.allclose(courses.measure_upstream(0.0 * start), expected, rtol=1e-6, equal_nan=True)
    fixed = np.array([[False, False, False], [False, True, False]])
    carried = courses.carry_upstream(np.where(fixed, 8.0, np.nan), fixed)
    assert np.array_equal(carried, [[8.0, np.nan, np.nan], [np.nan, 8.0, np.nan]], equal_nan=True)


# ---- measure_slopes


def test_slopes_are_falls_over_distances(device, dtype):
    scalar = SCALARS[dtype]
    height = np.array([[9.0, 7.0, 4.0], [np.nan, 5.0, 1.0]])
    receiver = np.array([[4, 5, 2], [-1, 5, 5]], np.int32)
    out = wp.zeros((2, 3), dtype=scalar, device=device)
    inputs = [to_device(height, scalar, device), to_device(receiver, wp.int32, device)]
    wp.launch(routing.build(scalar).measure_slopes, dim=2, inputs=inputs, outputs=[out], device=device)
    expected = [[4.0 / np.sqrt(2.0), 6.0 / np.sqrt(2.0), 0.0], [np.nan, 4.0, 0.0]]
    assert np.allclose(out.numpy(), expected, rtol=1e-6, equal_nan=True)


# ---- count_contributors, share_downhill


def shared(case, exponent):
    """Cells that drain through each by multiple flow, and the counts of contributors."""
    kernel = routing.build(case.scalar)
    donors, gathered = case.scratch(wp.uint8, 255), case.scratch(case.scalar, 1.0)
    case.launch(kernel.count_contributors, [case.stride, case.height, case.state], [donors], dim=case.rows)
    counted = case.inside(donors).copy()
    inputs = [case.rows, case.stride, exponent, case.height, case.state]
    case.launch(kernel.share_downhill, inputs, [gathered, donors, case.scratch(int)])
    gap = np.isnan(case.inside(case.height))
    assert (case.inside(donors)[~gap] == 255).all(), "every cell has had its turn"
    return np.where(gap, np.nan, case.inside(gathered)), counted


def test_shares_follow_the_slopes_to_the_power(device, dtype):
    """Falls of 2 to the east, 1 to the south and sqrt(8) to the south-east, whose slope is 2, too."""
    height = np.array([[9.0, 9.0, 9.0], [9.0, 5.0, 3.0], [9.0, 4.0, 5.0 - np.sqrt(8.0)]])
    for exponent in (0.5, 1.0, 1.1, 4.0):
        cells, counted = shared(Case(height, dtype=dtype, device=device), exponent)
        part = np.array([1.0, 0.5**exponent, 1.0]) / (2.0 + 0.5**exponent)
        got = np.array([cells[1, 2], cells[2, 1], cells[2, 2]]) - 1.0
        assert np.allclose(got, part, rtol=TOLERANCE[dtype])
        assert counted[1, 1] == 5 and cells[1, 1] == 1.0, "outlets pass nothing on"


@settings(max_examples=200, derandomize=True, deadline=None)
@given(seed=SEEDS, exponent=st.sampled_from([0.7, 1.0, 1.1, 3.0]))
def test_multiple_flow_equals_the_reference(seed, exponent):
    case, raster, _ = random_case(seed)
    expected = reference.multiple_flow(raster, exponent)
    assert np.allclose(shared(case, exponent)[0], expected, rtol=TOLERANCE["float64"], equal_nan=True)


@pytest.mark.parametrize(("seed", "exponent"), [*itertools.product(range(3), (1.0, 1.1))])
def test_larger_rasters_on_every_device(device, dtype, seed, exponent):
    case, raster, _ = random_case(seed, 40, dtype=dtype, device=device)
    if dtype == "float64":
        assert np.array_equal(received(case), reference.receivers(raster))
    cells = shared(case, exponent)[0]
    assert np.allclose(cells, reference.multiple_flow(raster, exponent), rtol=TOLERANCE[dtype], equal_nan=True)


def test_tiny_slopes_still_carry_water(device, dtype):
    """A filled flat falls by single steps between numbers; in the power alone they would vanish."""
    tiny = float(np.finfo(REALS[dtype]).eps)
    height = np.arange(6)[None, :] * tiny + np.zeros((3, 1))
    edges = {"north": "periodic", "south": "periodic", "east": "closed", "west": "open"}
    cells, _ = shared(Case(height, edges=edges, dtype=dtype, device=device), 30.0)
    assert np.allclose(cells, np.arange(6, 0, -1)[None, :], rtol=1e-5)
