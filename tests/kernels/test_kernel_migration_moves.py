"""``move_points`` and ``measure_mobility``, on plain and on sloping ground, against the twins in reference.py."""

import numpy as np
import pytest
import reference
from kernel_arrays import DEALS, REALS, SLABS
from migration_case import (
    GRID,
    MOVE_TOLERANCE,
    SHORT_STEP,
    SLOPE_TOLERANCE,
    Case,
    hills,
    meander,
    stacked_lines,
    varying_sections,
)
from reference import Law

NO_DAMPING = Law(end_damping=0.0)


def random_velocities(lines, seed=0):
    """Any velocities of some metres a year, by channel."""
    rng = np.random.default_rng(seed)
    return [rng.normal(0.0, 10.0, xy.shape) for xy in lines]


# ---- the move


def test_moves_match_the_twin_however_they_are_dealt_out(device):
    lines = stacked_lines(seed=12)
    sections = varying_sections(lines)
    velocities = random_velocities(lines)
    case = Case(lines, sections=sections, device=device)
    for law in (Law(time_step=SHORT_STEP), Law(time_step=0.4), Law(time_step=0.4, scale_local=1), NO_DAMPING):
        twins = [
            reference.move_points(xy, velocity, 50.0, sections[c][:, 0], law)
            for c, (xy, velocity) in enumerate(zip(lines, velocities, strict=True))
        ]
        for deal in DEALS:
            for moved, twin in zip(case.moved(law, velocities, deal), twins, strict=True):
                assert np.abs(moved - twin).max() <= MOVE_TOLERANCE


def test_a_positive_rate_moves_to_the_right_of_the_flow():
    east = np.stack([50.0 * np.arange(9), np.zeros(9)], axis=1)
    law = Law(time_step=1e-3, end_damping=0.0)
    moved = Case([east]).moved(law, [reference.velocities(east, np.full(9, 2.0))])[0]
    assert moved[1:-1, 1] == pytest.approx(-0.002, rel=1e-12)
    assert (moved[:, 0] == east[:, 0]).all()


def test_ends_never_move(device, dtype):
    """To the bit, whatever the rate there, in channels of 3 points too."""
    lines = [np.asarray(xy, REALS[dtype]).astype(np.float64) for xy in stacked_lines(seed=13)]
    case = Case(lines, dtype=dtype, device=device)
    velocities = [np.full(xy.shape, 1e3) for xy in lines]
    for law in (Law(time_step=0.3), Law(time_step=0.3, end_damping=0.0), Law(time_step=SHORT_STEP)):
        for deal in (1, 7, 4096, *SLABS):
            for xy, moved in zip(lines, case.moved(law, velocities, deal), strict=True):
                assert (moved[[0, -1]] == xy[[0, -1]]).all()


def test_a_line_that_turns_back_on_itself_stays_finite():
    """Both neighbours of the middle point coincide: it has no normal, and does not move."""
    xy = np.array([[0.0, 0.0], [50.0, 0.0], [0.0, 0.0], [0.0, 50.0], [0.0, 100.0]])
    law = Law(time_step=1e-3, end_damping=0.0)
    case = Case([xy])
    moved = case.moved(law, case.velocities(law))[0]
    assert (moved[1] == xy[1]).all()


# ---- slabs, and inactive channels


def test_the_division_into_slabs_changes_no_bit(device, dtype):
    """Velocities and moves, smoothing and ground included."""
    lines = stacked_lines(seed=14)
    law, height = Law(time_step=0.6), hills()
    case = Case(lines, sections=varying_sections(lines), dtype=dtype, device=device)
    results = []
    for deal in SLABS:
        found = case.velocities(law, deal)
        results.append([np.concatenate(values) for values in (found, case.moved(law, found, deal, height))])
    assert np.abs(results[0][0]).max() > 1.0
    for velocities, points in results[1:]:
        np.testing.assert_array_equal(velocities, results[0][0])
        np.testing.assert_array_equal(points, results[0][1])


@pytest.mark.parametrize("deal", DEALS)
def test_channels_at_rest_are_passed_over(device, dtype, deal):
    """Their velocities are not written and their points copied; those that move do as they do among themselves."""
    lines = stacked_lines(seed=15)
    sections, law = varying_sections(lines), Law(time_step=0.6)
    awake = Case(lines, sections=sections, dtype=dtype, device=device)
    velocities = awake.velocities(law, deal)
    moved = awake.moved(law, velocities, deal)
    for resting in ((0, 3, 9), (1, 2, 4, 5), range(len(lines))):
        case = Case(lines, sections=sections, resting=tuple(resting), dtype=dtype, device=device)
        found = case.velocities(law, deal)
        # A velocity left over from another step must not count.
        points = case.moved(
            law, [np.full(xy.shape, 9.0) if c in resting else found[c] for c, xy in enumerate(lines)], deal
        )
        for c, xy in enumerate(lines):
            if c in resting:
                np.testing.assert_array_equal(points[c], xy.astype(REALS[dtype]))
            else:
                np.testing.assert_array_equal(found[c], velocities[c])
                np.testing.assert_array_equal(points[c], moved[c])


# ---- the ground


def test_moves_on_the_ground_match_the_twin(device):
    lines = stacked_lines(seed=16)
    velocities = random_velocities(lines)
    law, height = Law(time_step=0.4), hills()
    case = Case(lines, width=60.0, device=device)
    ground = [reference.slope_weights(xy, height, GRID, law) for xy in lines]
    everywhere = np.concatenate(ground)
    assert (everywhere == 0.0).any() and (everywhere > 0.9).any() and ((0.1 < everywhere) & (everywhere < 0.9)).any()
    for deal in DEALS:
        for c, moved in enumerate(case.moved(law, velocities, deal, height)):
            twin = reference.move_points(lines[c], velocities[c], 50.0, 60.0, law, ground[c])
            assert np.abs(moved - twin).max() <= MOVE_TOLERANCE + SLOPE_TOLERANCE["float64"]


def test_tight_bends_straighten_on_slopes_that_hold_all_else(device):
    """By a quarter of the way to the middle of their neighbours, or less in short steps; else nothing moves there."""
    rng = np.random.default_rng(2)
    lines = [xy + rng.normal(0.0, 12.0, xy.shape) for xy in stacked_lines(seed=18)]
    height = hills(0.0) + 0.3 * GRID[2] * np.arange(150)
    case = Case(lines, width=100.0, device=device)
    for law in (Law(time_step=0.02), Law(time_step=0.4)):
        for deal in (1, 32, "one slab", "uneven slabs"):
            for xy, moved in zip(lines, case.moved(law, random_velocities(lines), deal, height), strict=True):
                away = reference.straightening(xy, 50.0, np.full(len(xy), 100.0), law)
                assert np.abs(moved - xy - away).max() <= MOVE_TOLERANCE + SLOPE_TOLERANCE["float64"]
                assert len(xy) < 60 or ((away == 0.0).all(axis=1).sum() > 10 and (away != 0.0).any())


@pytest.mark.parametrize(
    "height",
    [hills(), hills(gaps=0.6), hills(0.0), hills(0.0) + 0.3 * GRID[2] * np.arange(150), np.full((150, 150), np.nan)],
    ids=["hills", "holes", "flat", "steep", "no ground"],
)
def test_mobility_is_that_of_the_freest_point(device, dtype, height):
    """In every way to deal the points out, to the bit; channels partly off the ground and short ones among them."""
    rng = np.random.default_rng(17)
    lines = []
    for n in (3, 3, 4, 3, 5, 90, 3, 200, 3, 3, 3, 4, 150, 3):
        x, y = rng.uniform(-9000.0, 9000.0, 2)
        lines.append(meander(n, turn=rng.uniform(0.0, 6.0)) + [x, y])
    lines.append(np.array([[9500.0, 0.0], [9550.0, 0.0], [9600.0, 0.0]]))
    law = Law(slope_threshold=0.25)
    case = Case(lines, dtype=dtype, device=device)
    twins = np.array([reference.mobility(xy, height, GRID, law) for xy in lines])
    found = case.mobility(law, height)
    np.testing.assert_allclose(found, twins, atol=SLOPE_TOLERANCE[dtype], rtol=0.0)
    np.testing.assert_array_equal(found == 0.0, twins == 0.0)
    np.testing.assert_array_equal(found == 1.0, twins == 1.0)
    assert found[-1] == 0.0, "off the ground"
    for deal in DEALS:
        np.testing.assert_array_equal(case.mobility(law, height, deal), found)
        assert not case.mobility(law, height, deal, planned=1).any()
        # Where one part is enough even on flat ground, how free a channel is does not matter.
        assert (case.mobility(law, height, deal, limit=1.01 * law.time_step) == (found > 0.0)).all()


def test_the_hills_hold_channels_of_all_kinds():
    """Else the test above would not see some."""
    law = Law(slope_threshold=0.25)
    places = np.random.default_rng(1).uniform(-9000.0, 9000.0, (300, 1, 2))
    found = np.array([reference.mobility(xy, hills(), GRID, law) for xy in places])
    assert all(((low < found) & (found < high)).any() for low, high in ((-1.0, 0.01), (0.1, 0.8), (0.99, 1.1)))
    assert not ((0.9 <= found) & (found < 1.0)).any()
