"""Depression kernels against a priority flood and a Dijkstra search on Python's heap, equal to the bit, and by hand."""

import math

import numpy as np
import pytest
import reference_hydrology as reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_arrays import REALS, struct_of, to_device
from padded_cells import Case

from warpriver.kernels import depressions

SEEDS = st.integers(0, 2**32 - 1)
# A bowl with a sill of 4 in the east and a hole in its middle.
BOWL = np.array(
    [
        [9.0, 9.0, 9.0, 9.0, 9.0],
        [9.0, 2.0, 2.0, 2.0, 9.0],
        [9.0, 2.0, 1.0, 2.0, 4.0],
        [9.0, 2.0, 2.0, 2.0, 9.0],
        [9.0, 9.0, 9.0, 9.0, 9.0],
    ]
)


def flooded(case, epsilon, buckets=7):
    """Heights after ``flood_cells``, and the number of raised cells."""
    kernel = depressions.build(case.scalar)
    lowest, highest = np.nanmin(case.cells.height), np.nanmax(case.cells.height)
    flood = kernel.Flood()
    flood.rows, flood.stride, flood.epsilon, flood.lowest = case.rows, case.stride, int(epsilon), lowest
    flood.buckets_per_meter = buckets / max(highest - lowest, 1e-30)
    raised, level, state = wp.zeros(1, dtype=int, device=case.device), wp.clone(case.height), wp.clone(case.state)
    bucket, count = (wp.zeros(n, dtype=int, device=case.device) for n in (buckets, 3))
    rims = struct_of(
        kernel.Rims, next=case.scratch(int), bucket=bucket, count=count,
        heap_key=case.scratch(case.scalar), heap_cell=case.scratch(int),
    )  # fmt: skip
    case.launch(kernel.flood_cells, [flood], [raised, level, state, case.scratch(int), rims])
    return case.inside(level), int(raised.numpy()[0])


def pits_of(case):
    """Flat indices of the pits in the padded array."""
    pit = case.scratch(wp.uint8, 0)
    kernel = depressions.build(case.scalar)
    case.launch(kernel.find_pits, [case.stride, case.height, case.state], [pit], dim=case.rows)
    return np.flatnonzero(pit.numpy()), pit


def carved(case, max_depth=math.inf, max_length=math.inf):
    """Heights after ``carve_pits``, not filled yet, and the number of courses."""
    kernel = depressions.build(case.scalar)
    cell, pit = pits_of(case)
    if not len(cell):
        return case.inside(case.height), 0
    cell = cell[np.argsort(case.height.numpy()[cell], kind="stable")]
    count, height = wp.zeros(1, dtype=int, device=case.device), wp.clone(case.height)
    carving = kernel.Carving()
    carving.rows, carving.stride, carving.max_depth, carving.max_length = case.rows, case.stride, max_depth, max_length
    for field in ("cell_from", "cell_mark", "heap_cell"):
        setattr(carving, field, case.scratch(int))
    for field in ("cell_length", "heap_key"):
        setattr(carving, field, case.scratch(case.scalar))
    case.launch(kernel.carve_pits, [to_device(cell, wp.int32, case.device), case.state], [count, height, pit, carving])
    return case.inside(height), int(count.numpy()[0])


def random_case(seed, largest=9, **options):
    """A random raster and rules, as a case and as the reference has it."""
    rng = np.random.default_rng(seed)
    height, edges, nodata = reference.random_heights(rng, largest), reference.random_rules(rng), "outlet"
    if rng.random() < 0.5:
        nodata = "wall"
    if options.get("dtype") == "float32":
        height = height.astype(np.float32).astype(np.float64)
    return Case(height, edges=edges, nodata=nodata, **options), reference.Raster(height, edges, nodata), rng


# ---- flood_cells


def test_a_bowl_is_filled_to_its_sill(device, dtype):
    level, raised = flooded(Case(BOWL, dtype=dtype, device=device), epsilon=False)
    expected = BOWL.copy()
    expected[1:4, 1:4] = 4.0
    assert np.array_equal(level, expected) and raised == 9


def test_a_bowl_is_filled_with_one_step_a_cell_from_the_sill(device, dtype):
    level, _ = flooded(Case(BOWL, dtype=dtype, device=device), epsilon=True)
    step = np.spacing(REALS[dtype](4.0))
    assert np.array_equal((level[1:4, 1:4].astype(np.float64) - 4.0) / step, [[3, 2, 1], [3, 2, 1], [3, 2, 1]])


@pytest.mark.parametrize(
    "height", [0.0, 1e-300, -1e-300, 0.5, 1.0, -1.0, -4.0, 2.0**10, 1.0 - 2.0**-53, -1000.1, 8848.0]
)
def test_the_step_is_the_next_number_and_no_less_than_near_one(device, dtype, height):
    """A flat of three cells beside an outlet; -1 and -4 are where the spacing of numbers changes."""
    real = REALS[dtype]
    height = float(real(height))
    wall = 1e4
    case = Case([[wall, wall, wall], [height, height, wall], [wall, wall, wall]], dtype=dtype, device=device)
    level, _ = flooded(case, epsilon=True)
    assert float(level[1, 1]) == reference.step_above(height, real) > height


@settings(max_examples=400, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_flood_equals_the_reference_to_the_bit(seed):
    case, raster, _ = random_case(seed)
    assert np.array_equal(flooded(case, True)[0], reference.fill(raster), equal_nan=True)
    assert np.array_equal(flooded(case, False)[0], reference.fill(raster, reference.no_step), equal_nan=True)


@pytest.mark.parametrize("buckets", [1, 2, 50, 5000])
def test_the_flood_does_not_depend_on_the_buckets(device, dtype, buckets):
    case, _, _ = random_case(5, 40, dtype=dtype, device=device)
    assert np.array_equal(flooded(case, True, buckets)[0], flooded(case, True)[0], equal_nan=True)


@pytest.mark.parametrize("seed", range(6))
def test_larger_floods_equal_the_reference_to_the_bit(device, dtype, seed):
    case, raster, _ = random_case(seed, 40, dtype=dtype, device=device)
    expected = reference.fill(raster, lambda height: reference.step_above(height, REALS[dtype]))
    assert np.array_equal(flooded(case, True)[0], expected, equal_nan=True)


# ---- find_pits


def test_pits_are_cells_without_a_lower_neighbour_and_no_outlets(device, dtype):
    height = BOWL.copy()
    height[1, 3] = 1.0
    case = Case(height, dtype=dtype, device=device)
    stride = case.stride
    assert pits_of(case)[0].tolist() == [2 * stride + 4, 3 * stride + 3]


@settings(max_examples=150, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_pits_are_those_of_the_reference(seed):
    case, raster, _ = random_case(seed)
    found = [(int(i) // case.stride - 1, int(i) % case.stride - 1) for i in pits_of(case)[0]]
    assert found == sorted(reference.find_pits(raster))


# ---- carve_pits


def test_a_bowl_is_opened_through_its_sill(device, dtype):
    height, count = carved(Case(BOWL, dtype=dtype, device=device))
    fall = 4.0 * float(np.finfo(REALS[dtype]).eps)
    expected = BOWL.copy()
    expected[2, 3], expected[2, 4] = 1.0 - fall, 1.0 - 2.0 * fall
    assert np.array_equal(height, expected) and count == 1


def test_the_course_takes_the_cheaper_of_two_ways(device, dtype):
    """Straight on through one wall of 9, cost 8, or around through 3 cells of 3, cost 6 and the ends."""
    wall = np.full((5, 7), 20.0)
    wall[2, 1], wall[2, 2:5], wall[1, 2:5] = 1.0, 12.0, 3.0
    wall[2, 5], wall[2, 6] = 0.5, 0.0
    height, _ = carved(Case(wall, dtype=dtype, device=device))
    assert (height[1, 2:5] < 1.0).all() and (height[2, 2:5] == 12.0).all()


@pytest.mark.parametrize(("limits", "open_"), [((3.0, 2.0), True), ((2.9, 9.0), False), ((3.0, 1.9), False)])
def test_nothing_is_cut_beyond_the_limits(device, dtype, limits, open_):
    """The bowl's sill stands 3 above its hole, two cells away."""
    height, count = carved(Case(BOWL, dtype=dtype, device=device), *limits)
    assert count == int(open_) and (height != BOWL).any() == open_


def test_a_flat_pit_is_opened_once(device, dtype):
    height = np.full((7, 9), 5.0)
    height[1:6, 1:8] = 1.0
    opened, count = carved(Case(height, dtype=dtype, device=device))
    assert count == 1 and (opened < height).sum() == 1


@settings(max_examples=400, derandomize=True, deadline=None)
@given(seed=SEEDS)
def test_carving_equals_the_reference_to_the_bit(seed):
    case, raster, rng = random_case(seed)
    limits = [(math.inf, math.inf), (1.0, math.inf), (math.inf, 3.0), (2.0, 2.0)][rng.integers(4)]
    assert np.array_equal(carved(case, *limits)[0], reference.carve_pits(raster, *limits)[0], equal_nan=True)


@pytest.mark.parametrize("seed", range(6))
def test_larger_carvings_equal_the_reference_to_the_bit(device, seed):
    case, raster, _ = random_case(seed, 40, device=device)
    assert np.array_equal(carved(case)[0], reference.carve_pits(raster)[0], equal_nan=True)
