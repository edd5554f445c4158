"""Kernels of Leheny's erosion against the twin, event by event and group by group, on small rasters of every kind."""

import numpy as np
import pytest
import warp as wp
from kernel_arrays import REALS, SCALARS, struct_of, to_device
from reference_leheny import Ground

from warpriver.erosion.leheny import marks_beside
from warpriver.kernels import cells, leheny

# Wraps (north-south, east-west), four neighbours, shape: all kinds of edges, odd and even rings.
CASES = [
    ((False, False), False, (7, 9)),
    ((False, True), False, (9, 7)),
    ((False, True), True, (8, 8)),
    ((True, False), False, (7, 6)),
    ((True, True), False, (5, 7)),
    ((True, True), True, (6, 5)),
    ((False, False), True, (3, 12)),
]


class Case:
    """The same ground for the twin and for the kernels: heights in quanta, without pits, some without data."""

    def __init__(
        self, wraps, four, shape, seed=0, dtype="float64", device="cpu", threshold=40.0, gaps=True, base=-np.inf
    ):
        rng = np.random.default_rng(seed)
        rows, columns = shape
        outlet = np.zeros(shape, bool)
        outlet[-1, rng.integers(columns)] = outlet[rows // 2, 0] = True
        flat = np.zeros(shape)
        if gaps and min(shape) > 5:
            flat[1, 2] = np.nan
        ground = Ground(flat, outlet, wraps, four, threshold=threshold, quantum=0.125)
        # Height grows with the steps from an outlet, so that there is no pit; the noise is in whole quanta.
        height, front, level = np.full(shape, np.nan), [tuple(c) for c in np.argwhere(outlet)], 0.0
        for cell in front:
            height[cell] = 0.0
        while front:
            level += 4.0
            front = sorted({n for c in front for n in ground.neighbors(c) if np.isnan(height[n])})
            for cell in front:
                height[cell] = level + rng.integers(24) / 8.0
        self.twin = Ground(height, outlet, wraps, four, threshold=threshold, quantum=0.125, base=base)
        self.scalar, self.real, self.device, self.shape = SCALARS[dtype], REALS[dtype], device, shape
        self.kernel = leheny.build(self.scalar)
        constants = self.kernel.Constants()
        constants.rows, constants.columns = shape
        constants.wraps_rows, constants.wraps_columns, constants.four = int(wraps[0]), int(wraps[1]), int(four)
        constants.bias, constants.depth, constants.threshold, constants.quantum = 0.05, 10.0, threshold, 0.125
        constants.base = base
        self.constants = constants
        self.height = to_device(height.ravel(), self.scalar, device)
        state = np.where(np.isnan(height), cells.DONE, np.where(outlet, cells.OUTLET, cells.OPEN)).astype(np.uint8)
        self.state = to_device(state.ravel(), wp.uint8, device)
        self.ground = to_device(np.flatnonzero(~np.isnan(height)).astype(np.int32), wp.int32, device)
        self.tally = wp.zeros(3, dtype=wp.int64, device=device)

    def full(self, kind, value=0):
        return wp.full(self.height.size, value, dtype=kind, device=self.device)

    def launch(self, name, dim, inputs, outputs):
        wp.launch(getattr(self.kernel, name), dim, inputs, outputs, device=self.device)

    def heights(self):
        return self.height.numpy().astype(np.float64).reshape(self.shape)


@pytest.mark.parametrize("base", [-np.inf, -15.0, 2.0], ids=["no base", "base", "base above outlets"])
@pytest.mark.parametrize(("wraps", "four", "shape"), CASES)
def test_events_one_after_another_are_those_of_the_twin(wraps, four, shape, base, dtype, device):
    """Heights are equal to the bit after every event, in both precisions; visits and slides are counted."""
    case = Case(wraps, four, shape, dtype=dtype, device=device, base=base)
    twin, visits = case.twin, 0
    seed = to_device(np.array([12345], np.int32), wp.int32, device)
    stack, waiting = case.full(int), case.full(wp.uint8)
    for event in range(60):
        visits += len(twin.event(12345, event))
        inputs = [case.constants, struct_of(leheny.Events, first=event, count=1, seed=seed), case.ground, case.state]
        case.launch("erode_serially", 1, inputs, [case.height, stack, waiting, case.tally])
        np.testing.assert_array_equal(case.heights(), twin.height, err_msg=f"event {event}")
        assert not twin.pits() and twin.largest_difference() <= twin.threshold
    assert case.tally.numpy().tolist() == [visits, twin.slides, 0] and (twin.slides > 0 or base > -1e9)
    assert not waiting.numpy().any()
    lowest = np.nanmin(case.heights())
    assert lowest == {-np.inf: lowest, -15.0: -15.0, 2.0: 0.0}[base], "outlets below the base stay where they are"
    assert base > -1e9 or lowest < -100.0


def test_grids_side_by_side_know_nothing_of_each_other(device):
    cases = [Case((False, True), False, (9, 7), device=device) for _ in range(3)]
    seeds = np.array([7, 8, 7], np.int32)
    for case, seed in zip(cases, seeds, strict=True):
        for event in range(5, 25):
            case.twin.event(int(seed), event)
    one, cells_of_all = cases[0], 3 * cases[0].height.size
    height = to_device(np.tile(one.height.numpy(), 3), wp.float64, device)
    outputs = [
        height, wp.zeros(cells_of_all, dtype=int, device=device), wp.zeros(cells_of_all, dtype=wp.uint8, device=device),
        wp.zeros(9, dtype=wp.int64, device=device),
    ]  # fmt: skip
    events = struct_of(leheny.Events, first=5, count=20, seed=to_device(seeds, wp.int32, device))
    one.launch("erode_serially", 3, [one.constants, events, one.ground, one.state], outputs)
    for found, case in zip(height.numpy().reshape(3, *one.shape), cases, strict=True):
        np.testing.assert_array_equal(found, case.twin.height)


def marked(case, marks):
    """Cells that have a mark, by the definition of the words."""
    words = marks.reshape(case.shape[0], -1)
    rows, columns = case.shape
    return {(r, c) for r in range(rows) for c in range(columns) if int(words[r, c // 64]) >> c % 64 & 1}


def swept(case, marks, chunk):
    """One sweep by the kernels, beside what has been lowered; returns the marks of what is lowered now."""
    words = marks.size
    beside = marks_beside(
        marks.numpy(), case.shape, tuple(bool(v) for v in (case.constants.wraps_rows, case.constants.wraps_columns))
    )
    listed = to_device(np.flatnonzero(beside).astype(np.int32), wp.int32, case.device)
    beside = to_device(beside, wp.uint64, case.device)
    steep = wp.zeros((4, words), dtype=wp.uint64, device=case.device)
    moved = wp.zeros(words, dtype=wp.uint64, device=case.device)
    dim = listed.size, 64 // chunk
    before = case.heights()
    case.launch("mark_steep", dim, [case.constants, chunk, listed, beside, case.height], [steep])
    for line, k in enumerate((2, 3, 4, 5)):
        pairs = [pair for color in range(3) for pair in case.twin.pairs(k, color)]
        assert marked(case, steep.numpy()[line]) == {a for a, b in pairs if case.twin.steep(a, b)}
    for k in (2, 4) if case.constants.four else (2, 3, 4, 5):
        for color in range(3):
            pairs = struct_of(leheny.Pairs, k=k, color=color, chunk=chunk)
            inputs, outputs = [case.constants, pairs, listed, steep], [case.height, moved, case.tally]
            case.launch("slide_pairs", dim, inputs, outputs)
    lowered = {tuple(int(v) for v in rc) for rc in np.argwhere(case.heights() < before)}
    assert marked(case, moved.numpy()) == lowered
    return moved


def graded(case, visits, below):
    """Heights after a batch, graded to the base by the kernels."""
    one, two = ([case.full(case.scalar), case.full(int)] for _ in range(2))
    case.launch("begin_grading", case.height.size, [case.constants, case.state, case.height, visits, below], one)
    for k in range(case.height.size.bit_length()):
        case.launch("double_grading", case.height.size, [case.scalar(0.125 * 2**k), *one], two)
        one, two = two, one
    return one[0]


@pytest.mark.parametrize("base", [-np.inf, -15.0], ids=["no base", "base"])
@pytest.mark.parametrize("chunk", [1, 64])
@pytest.mark.parametrize(("wraps", "four", "shape"), CASES)
def test_batches_are_those_of_the_twin(wraps, four, shape, chunk, base, dtype, device):
    """Walks over heights that stay, what they take, and each sweep of slides; however rows are cut into fractions."""
    case = Case(wraps, four, shape, dtype=dtype, device=device, base=base)
    twin, rows, columns = case.twin, *shape
    below, visits = case.full(int, -1), case.full(int)
    tables = [a.reshape(shape) for a in (case.height, visits, below)]
    for number in range(12):
        events = range(8 * number, 8 * number + 8)
        walks = struct_of(leheny.Walks, first=events[0], seed=99, turn_seed=1000 + number)
        inputs = [case.constants, walks, case.ground, case.state, case.height]
        case.launch("walk_together", len(events), inputs, [below, visits, case.tally])
        found = visits.numpy().reshape(shape).copy()
        ways = twin.walk_together(99, 1000 + number, events)
        np.testing.assert_array_equal(
            found, [[sum((r, c) in w for w in ways) for c in range(columns)] for r in range(rows)]
        )
        marks = wp.zeros(rows * -(-columns // 64), dtype=wp.uint64, device=device)
        heights = graded(case, visits, below)
        case.launch("lower_visited", (rows, -(-columns // chunk)), [case.constants, chunk], [*tables, marks])
        assert not visits.numpy().any() and (below.numpy() == -1).all()
        assert marked(case, marks.numpy()) == {cell for way in ways for cell in way}
        case.launch("raise_graded", case.height.size, [heights], [case.height])
        while marks.numpy().any():
            marks = swept(case, marks, chunk)
            twin.sweep()
            np.testing.assert_array_equal(case.heights(), twin.height, err_msg=f"batch {number}")
        assert not twin.pits() and twin.largest_difference() <= twin.threshold
    np.testing.assert_array_equal(case.heights(), twin.height)
    assert case.tally.numpy()[1] == twin.slides and case.tally.numpy()[2] == 0
    assert twin.slides > 0 or base > -1e9
    assert np.nanmin(case.heights()) == base or not base > -1e9


@pytest.mark.parametrize("columns", [2, 63, 64, 65, 128, 150])
@pytest.mark.parametrize("wraps", [(False, False), (True, False), (False, True), (True, True)])
def test_marks_beside_are_cells_with_a_marked_neighbor(columns, wraps):
    """East, south-east, south and south-west, also across the ends of words and around; nothing beyond the columns."""
    rows = 5
    rng = np.random.default_rng(columns)
    here = rng.random((rows, columns)) < 0.03
    here[2, [0, -1]] = here[0, columns // 2] = True
    padded = np.zeros((rows, -(-columns // 64) * 64), bool)
    padded[:, :columns] = here
    # Marks beyond the last column mean nothing.
    padded[:, columns:] = rng.random(padded[:, columns:].shape) < 0.5
    words = np.packbits(padded, axis=1, bitorder="little").view(np.uint64).reshape(-1)
    found = np.unpackbits(marks_beside(words, (rows, columns), wraps).view(np.uint8), bitorder="little")
    expected = np.zeros(padded.shape, bool)
    for r in range(rows):
        for c in range(columns):
            for row, column in ((r, c), (r, c + 1), (r + 1, c + 1), (r + 1, c), (r + 1, c - 1)):
                if (row < rows or wraps[0]) and (0 <= column < columns or wraps[1]):
                    expected[r, c] |= here[row % rows, column % columns]
    np.testing.assert_array_equal(found.reshape(padded.shape), expected)


def test_the_order_in_which_rain_walks_cannot_be_seen(device):
    """Forty units of rain in one launch, and one by one in a shuffled order: the same visits and ways."""
    found = []
    for order in (None, np.random.default_rng(5).permutation(40)):
        case = Case((False, True), False, (9, 7), device=device)
        below, visits = case.full(int, -1), case.full(int)
        for first, count in [(0, 40)] if order is None else [(int(event), 1) for event in order]:
            walks = struct_of(leheny.Walks, first=first, seed=3, turn_seed=4)
            inputs = [case.constants, walks, case.ground, case.state, case.height]
            case.launch("walk_together", count, inputs, [below, visits, case.tally])
        found.append((visits.numpy().copy(), below.numpy().copy(), case.tally.numpy().copy()))
    for a, b in zip(*found, strict=True):
        assert np.array_equal(a, b)
    assert found[0][0].max() > 5


@pytest.mark.parametrize(("wraps", "four", "shape"), CASES)
def test_no_cell_is_in_two_pairs_of_a_group_and_every_pair_in_one(wraps, four, shape):
    """So that the pairs of a group may slide in any order: done in many shuffled ones, the result is the same."""
    twin = Case(wraps, four, shape).twin
    seen = []
    for k in (2, 3, 4, 5):
        for color in range(3):
            pairs = twin.pairs(k, color)
            cells_of = [c for pair in pairs for c in pair]
            assert len(cells_of) == len(set(cells_of))
            seen += [frozenset(pair) for pair in pairs]
    assert set(seen) == {frozenset((c, n)) for c in twin.cells for n in twin.neighbors(c)}
    start = twin.height * 9.0
    results = []
    for seed in range(4):
        twin.height = start.copy()
        twin.sweep(np.random.default_rng(seed))
        results.append(twin.height.copy())
    assert all(np.array_equal(r, results[0], equal_nan=True) for r in results)
    assert not np.array_equal(results[0], start, equal_nan=True)


def test_probabilities_are_those_of_the_model(device, dtype):
    """Drawn 4,000 times on one cell: each lower neighbour has its part, which add up to 1; no other is chosen."""
    height = np.array([[30.0, 22.0, 31.0], [24.0, 25.0, 5.0], [9.0, -5.0, 25.0]])
    outlet = np.ones((3, 3), bool)
    outlet[1, 1] = False
    case = Case((False, False), False, (3, 3), dtype=dtype, device=device)
    case.twin = Ground(height, outlet)
    lower, p = case.twin.probabilities((1, 1))
    assert abs(p.sum() - 1.0) < 1e-15 and len(lower) == 5
    assert p[lower.index((2, 1))] / p[lower.index((0, 1))] == pytest.approx(np.exp(0.05 * 27.0))
    counts = np.zeros(9)
    case.ground = to_device(np.array([4], np.int32), wp.int32, device)
    case.state = to_device(np.where(outlet, cells.OUTLET, cells.OPEN).ravel().astype(np.uint8), wp.uint8, device)
    start = to_device(height.ravel(), case.scalar, device)
    visits = case.full(int)
    for turn in range(4000):
        walks = struct_of(leheny.Walks, first=0, seed=1, turn_seed=turn)
        inputs = [case.constants, walks, case.ground, case.state, start]
        case.launch("walk_together", 1, inputs, [case.full(int, -1), visits, case.tally])
    counts = visits.numpy().astype(np.float64)
    counts[4] = 0
    found = counts / counts.sum()
    for index in range(9):
        expected = p[lower.index((index // 3, index % 3))] if (index // 3, index % 3) in lower else 0.0
        # Four standard deviations of a count.
        assert abs(found[index] - expected) <= 4.0 * np.sqrt(expected * (1 - expected) / counts.sum())


def test_nothing_overflows_in_float32(device):
    """A neighbour 1e6 m lower beside one of 1 m: exp(50,000) is no number, but the walk goes down."""
    case = Case((False, False), False, (3, 3), dtype="float32", device=device)
    height = np.array([[2e6, 2e6, 2e6], [2e6, 1e6, 1e6 - 1.0], [2e6, 0.0, 2e6]])
    case.height = to_device(height.ravel(), wp.float32, device)
    case.ground = to_device(np.array([4], np.int32), wp.int32, device)
    state = np.full(9, cells.OUTLET, np.uint8)
    state[4] = cells.OPEN
    visits = case.full(int)
    walks = struct_of(leheny.Walks, first=0, seed=1, turn_seed=2)
    inputs = [case.constants, walks, case.ground, to_device(state, wp.uint8, device), case.height]
    case.launch("walk_together", 100, inputs, [case.full(int, -1), visits, case.tally])
    assert visits.numpy().tolist() == [0, 0, 0, 0, 100, 0, 0, 100, 0]


def test_a_pit_is_counted_and_not_left(device):
    """What the public functions refuse: the kernels end the walk and say so."""
    case = Case((False, False), False, (7, 9), device=device, gaps=False)
    height = case.height.numpy()
    height[3 * 9 + 4] = -50.0
    case.height = to_device(height, wp.float64, device)
    case.ground = to_device(np.array([3 * 9 + 4], np.int32), wp.int32, device)
    walks = struct_of(leheny.Walks, first=0, seed=1, turn_seed=2)
    inputs = [case.constants, walks, case.ground, case.state, case.height]
    case.launch("walk_together", 3, inputs, [case.full(int, -1), case.full(int), case.tally])
    seed = to_device(np.array([1], np.int32), wp.int32, device)
    inputs = [case.constants, struct_of(leheny.Events, first=0, count=2, seed=seed), case.ground, case.state]
    case.launch("erode_serially", 1, inputs, [case.height, case.full(int), case.full(wp.uint8), case.tally])
    assert case.tally.numpy()[2] == 5


def test_courses_are_raised_to_the_least_slope(device, dtype):
    """Cells 3 -> 2 -> 1 -> 0, and 4 -> 1; those that are high enough stay."""
    case = Case((False, False), False, (3, 3), dtype=dtype, device=device)
    height = to_device(np.array([1.0, 0.0, 5.0, 2.0, 1.5]), case.scalar, device)
    below, order = (to_device(np.array(a, np.int32), wp.int32, device) for a in ([-1, 0, 1, 2, 1], [0, 1, 4, 2, 3]))
    case.launch("raise_courses", 1, [case.constants, 0.25, below, order], [height])
    assert height.numpy().tolist() == [1.0, 1.25, 5.0, 5.25, 1.5]
