"""Outlets of landlocked ground, by hand and against a search of the neighbours."""

import numpy as np
import pytest
import reference_hydrology as reference
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from padded_cells import Case

from warpriver.kernels import cells

NAN = np.nan


def drained(height, edges, nodata, dtype="float64", device="cpu"):
    """Outlets (rows, columns) and the count after ``drain_landlocked``."""
    case = Case(height, edges=edges, nodata=nodata, dtype=dtype, device=device)
    # The states as the library's call finds them, without outlets for landlocked ground.
    state = case.cells.state
    raster = reference.Raster(height, edges, nodata, landlocked=False)
    for row, column in raster.height:
        state[row + 1, column + 1] = cells.OUTLET if (row, column) in raster.outlets else cells.OPEN
    case.state = wp.array(state.ravel(), dtype=wp.uint8, device=device)
    count, reached = wp.zeros(1, dtype=int, device=device), wp.clone(case.state)
    kernel = cells.build(case.scalar)
    outputs = [count, case.state, reached, case.scratch(int)]
    case.launch(kernel.drain_landlocked, [case.rows, case.stride, case.height], outputs)
    return case.inside(case.state) == cells.OUTLET, int(count.numpy()[0])


def test_each_piece_of_closed_ground_drains_to_its_lowest_cell(device, dtype):
    height = np.array([[3.0, 2.0, NAN, 1.0], [4.0, 5.0, NAN, 1.0], [4.0, 2.0, NAN, 6.0]])
    outlet, count = drained(height, "closed", "wall", dtype, device)
    # Of the two equal ones in either piece the first.
    assert np.argwhere(outlet).tolist() == [[0, 1], [0, 3]]
    assert count == 2


def test_pieces_joined_across_a_periodic_side_are_one(device, dtype):
    height = np.array([[3.0, 2.0, NAN, 1.0], [4.0, 5.0, NAN, 2.0]])
    edges = {"north": "closed", "south": "closed", "east": "periodic", "west": "periodic"}
    outlet, count = drained(height, edges, "wall", dtype, device)
    assert np.argwhere(outlet).tolist() == [[0, 3]] and count == 1


@pytest.mark.parametrize("nodata", ["outlet", "wall"])
def test_ground_with_an_outlet_gets_no_other(device, dtype, nodata):
    height = np.array([[3.0, 2.0, 3.0], [4.0, 1.0, 4.0], [4.0, 2.0, 7.0]])
    outlet, count = drained(height, "open", nodata, dtype, device)
    assert count == 0 and not outlet[1, 1] and outlet.sum() == 8


@settings(max_examples=150, derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_outlets_are_those_of_the_reference(seed):
    rng = np.random.default_rng(seed)
    height, edges, nodata = reference.random_heights(rng), reference.random_rules(rng), rng.choice(["outlet", "wall"])
    outlet, _ = drained(height, edges, nodata)
    raster = reference.Raster(height, edges, nodata)
    assert {tuple(rc) for rc in np.argwhere(outlet)} == raster.outlets
    # The library's padding leads to the same ones.
    case = Case(height, edges=edges, nodata=nodata)
    assert {tuple(rc) for rc in np.argwhere(case.inside(case.state) == cells.OUTLET)} == raster.outlets
