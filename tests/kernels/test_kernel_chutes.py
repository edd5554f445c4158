"""``find_chutes`` against its twin, however the points are dealt out, and as often as its hazard says."""

import itertools

import numpy as np
import pytest
import reference_chutes as twin
import warp as wp
from kernel_arrays import (
    DEALS,
    SCALARS,
    channels_of,
    forms,
    points_of,
    share_count,
    share_of_points,
    share_out,
    starts_of,
    status_of,
    struct_of,
    to_device,
    vec2_of,
)

import warpriver as wr
from warpriver.kernels import chutes
from warpriver.kernels.cuts import Cuts
from warpriver.kernels.status import BEGUN, HALT, SUBSTEP_SIZE

SPACING, WIDTHS = 20.0, np.array([40.0, 30.0, 40.0])
BENDS = {"winding": 1.25, "longest": 8.0, "min_arc": 5.0}


def lines():
    made = [
        wr.generate.sine_generated(15.0 * 40.0, 1.1, 8, SPACING),
        wr.generate.sine_generated(500.0, 0.6, 5, SPACING),
    ]
    bumpy = made[0] + np.random.default_rng(3).normal(0.0, 1.0, made[0].shape)
    return [made[0], made[1], bumpy]


def found(deal, device, dtype="float64", *, rate=1e9, step=0.3, begun=0, halt=0, necks=()):
    """Necks after the search, the channels' counts and the chunks' marks."""
    scalar, each = SCALARS[dtype], lines()
    kernel, start = chutes.build(scalar), starts_of(each)
    xy, count = np.concatenate(each), len(each)
    form = forms(WIDTHS, np.ones(count), WIDTHS, np.ones(count), scalar, device)
    arrays = {"spacing": np.full(count, SPACING), "step": np.array([step, step, step])}
    arrays = {name: to_device(values, scalar, device) for name, values in arrays.items()}
    channels = channels_of(scalar, start=to_device(start, int, device), form=form, **arrays)
    moved = points_of(scalar, to_device(xy, vec2_of(scalar), device))
    struct = struct_of(kernel.Chutes, rate=rate, seed=5, **BENDS)
    neck = np.full(len(xy), -1, np.int32)
    for i, j in necks:
        neck[i] = j
    cuts = struct_of(
        Cuts, point_neck=to_device(neck, int, device), channel_necks=wp.zeros(count, dtype=int, device=device)
    )
    marks = wp.zeros(share_count(deal, count, len(xy)), dtype=wp.vec2i, device=device)
    status = status_of({BEGUN: begun, HALT: halt}, device)
    identity = to_device(np.array([3, 4, 9]), int, device)
    substep = wp.zeros(SUBSTEP_SIZE, dtype=int, device=device)
    for part in share_out(deal, count, len(xy), device, status=status):
        inputs = [channels, moved, struct, part.work, identity, substep, cuts]
        wp.launch(kernel.find_chutes, part.threads, inputs, [marks], device=device)
    return start, cuts.point_neck.numpy(), cuts.channel_necks.numpy(), marks.numpy()


def expected():
    each, neck = lines(), []
    for line, width, first in zip(each, WIDTHS, starts_of(each), strict=False):
        bends = twin.bends_to_cut(line, SPACING, width, BENDS["winding"], BENDS["longest"], BENDS["min_arc"])
        own = np.full(len(line), -1)
        for i, j in bends.items():
            own[i] = first + j
        neck.append(own)
    return np.concatenate(neck)


@pytest.mark.parametrize("deal", DEALS)
def test_bends_that_may_be_cut_are_those_of_the_twin(deal, device, dtype):
    start, neck, counts, marks = found(deal, device, dtype)
    twins = expected()
    np.testing.assert_array_equal(neck, twins)
    of_channel = [int((twins[a:b] >= 0).sum()) for a, b in itertools.pairwise(start)]
    assert of_channel[0] >= 5 and of_channel[1] == 0, "the second winds too little"
    if not isinstance(deal, int):
        np.testing.assert_array_equal(counts, of_channel)
        return
    shares = share_of_points(deal, start)
    farthest = np.zeros(len(marks), int)
    np.maximum.at(farthest, shares, np.maximum(twins, 0))
    np.testing.assert_array_equal(marks, np.stack([farthest > 0, farthest], axis=1))


def test_necks_are_kept_and_nothing_is_found_while_halted_or_by_no_hazard(device):
    twins = expected()
    first = int(np.flatnonzero(twins >= 0)[0])
    assert found(7, device, necks=[(first, first + 5)])[1][first] == first + 5
    for options in ({"halt": 1}, {"rate": 0.0}, {"step": 0.0}):
        assert (found(7, device, **options)[1] == -1).all()


def test_bends_are_cut_as_often_as_their_hazard_says():
    """100 steps of chance 0.26 each: the share is within four standard deviations of a binomial law."""
    may = (expected() >= 0).sum()
    cut = sum((found("one slab", "cpu", rate=1.0, begun=k)[1] >= 0).sum() for k in range(100))
    chance = 1.0 - np.exp(-0.3)
    assert cut / (100 * may) == pytest.approx(chance, abs=4.0 * np.sqrt(chance * (1.0 - chance) / (100 * may)))
