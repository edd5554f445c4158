import numpy as np
import pytest
import warp as wp
from kernel_arrays import REALS, SCALARS, channels_of, forms, share_out, starts_of, struct_of, to_device, unwritten

from warpriver.kernels import junctions
from warpriver.kernels.channels import Stems

SPACING, WIDTH, STEP, REACH = 20.0, 8.0, 0.4, 12.0
# Sums of coordinates of some hundred metres.
TOLERANCE = {"float64": 1e-12, "float32": 4e-4}


def random_forest(rng, count):
    """Lines that flow into each other: lines, the channel below each, and what it starts with, all by hand."""
    below = np.full(count, -1)
    arrivals = np.zeros(count, int)
    for c in range(1, count):
        d = int(rng.integers(0, c))
        if arrivals[d] < 2 and rng.random() < 0.9:
            below[c] = d
            arrivals[d] += 1
    lines = [None] * count
    for c in range(count):
        line = rng.uniform(-300.0, 300.0, 2) + np.cumsum(rng.normal(0.0, SPACING, (int(rng.integers(3, 30)), 2)), 0)
        if below[c] >= 0:
            line[-1] = lines[below[c]][0]
        lines[c] = line
    return lines, below, arrivals


def follow(line, shift, mouth):
    """A tributary whose mouth went by ``shift``: its last reach is taken along, and drawn towards its chord."""
    count = min(int(REACH * WIDTH / SPACING), (len(line) - 1) // 2)
    t = np.clip(1.0 - np.arange(len(line))[::-1] / max(count, 1), 0.0, 1.0)
    weight = (t * t * (3.0 - 2.0 * t))[:, None]
    moved = line + shift * weight
    base = line[-1 - count]
    moved += weight * min(np.hypot(*shift) / WIDTH, 1.0) * (base + t[:, None] * (mouth - base) - moved)
    moved[-1] = mouth
    return moved


def twin(lines, below, arrivals, drift, step, number):
    """The same lines after the drift."""
    moved = [line.copy() for line in lines]
    for c, line in enumerate(lines):
        upper = np.flatnonzero(below == c)
        long = (len(line) - 1) * SPACING > 10.0 * WIDTH
        if number != 0 or not len(upper) or not long or step[c] == 0.0 or not (step[upper] > 0.0).all():
            continue
        along = line[1] - line[0]
        size = np.hypot(*along)
        moved[c][0] = line[0] + along / size * min(drift[c] * STEP, 0.5 * size)
        shift = moved[c][0] - line[0]
        for u in upper:
            moved[u] = follow(moved[u], shift, moved[c][0])
    return moved


@pytest.mark.parametrize("number", [0, 1])
def test_drift_matches_the_twin(device, dtype, number):
    rng, scalar = np.random.default_rng(5), SCALARS[dtype]
    kernel, shifted = junctions.build(scalar), 0
    for _ in range(20):
        lines, below, arrivals = random_forest(rng, int(rng.integers(2, 25)))
        count = len(lines)
        drift, step = rng.uniform(0.0, 40.0, count), rng.choice([0.0, STEP, STEP, STEP, STEP], count)
        points = to_device(np.concatenate(lines).astype(REALS[dtype]), kernel.vec2, device)
        start = to_device(starts_of(lines), wp.int32, device)
        downstream, tributaries = (to_device(v.astype(np.int32), wp.int32, device) for v in (below, arrivals))
        meet = struct_of(
            kernel.Junctions, downstream=downstream, tributaries=tributaries, drift=to_device(drift, scalar, device)
        )
        form, spacing = forms(WIDTH, 1.0, np.full(count, WIDTH), SPACING, scalar, device), np.full(count, SPACING)
        spacing, steps = (to_device(v, scalar, device) for v in (spacing, step))
        channels = channels_of(scalar, start=start, form=form, spacing=spacing, step=steps)
        active, substep = wp.zeros(count, dtype=int, device=device), to_device([number, 3], wp.int32, device)
        wp.launch(kernel.count_active, count, [channels, meet], [active], device=device)
        shift = unwritten(count, kernel.vec2, device)
        inputs = [channels, points, share_out(1, count, 1, device)[0].work]
        wp.launch(kernel.settle_heads, count, inputs, [shift, points], device=device)
        assert not shift.numpy().any(), "no channel goes on in another one"
        inputs = [channels, meet, scalar(STEP), substep, active]
        wp.launch(kernel.shift_heads, count, inputs, [shift, points], device=device)
        wp.launch(kernel.follow_heads, count, [channels, meet, scalar(REACH), shift], [points], device=device)
        moves = np.hypot(*shift.numpy().T) > 0.0
        expected = np.concatenate(twin(lines, below, arrivals, drift, step, number))
        np.testing.assert_allclose(points.numpy(), expected, atol=TOLERANCE[dtype], rtol=0.0)
        shifted += int(moves.sum())
        heads = starts_of(lines)
        for c in np.flatnonzero(below >= 0):
            if moves[below[c]]:
                np.testing.assert_array_equal(points.numpy()[heads[c + 1] - 1], points.numpy()[heads[below[c]]])
    assert shifted > 10 or number > 0


def test_heads_of_links_settle_where_the_link_upstream_ends(device, dtype):
    """And tributaries follow, as if it had drifted there; of the link upstream only the last point does."""
    rng, scalar = np.random.default_rng(7), SCALARS[dtype]
    kernel = junctions.build(scalar)
    node = np.array([100.0, 50.0])
    stem = node + np.arange(-20, 1)[:, None] * [SPACING, 3.0]
    lower = node + np.arange(21)[:, None] * [SPACING, -2.0]
    brook = node + np.arange(-20, 1)[:, None] * [3.0, SPACING]
    lines = [lower, stem, brook]
    start = to_device(starts_of(lines), wp.int32, device)
    before = to_device(np.concatenate(lines).astype(REALS[dtype]), kernel.vec2, device)
    moved = [line + rng.normal(0.0, 1.0, line.shape) for line in lines]
    moved[0][0], moved[2][-1] = lower[0], brook[-1]
    after = to_device(np.concatenate(moved).astype(REALS[dtype]), kernel.vec2, device)
    upper, down = (to_device(np.array(v, np.int32), wp.int32, device) for v in ([1, -1, -1], [-1, 0, -1]))
    channels = channels_of(
        scalar, start=start, form=forms(WIDTH, 1.0, np.full(3, WIDTH), SPACING, scalar, device),
        spacing=to_device(np.full(3, SPACING), scalar, device), stems=struct_of(Stems, upper=upper, lower=down),
    )  # fmt: skip
    meet = struct_of(kernel.Junctions, downstream=to_device(np.array([-1, 0, 0], np.int32), wp.int32, device))
    shift = unwritten(3, kernel.vec2, device)
    work = share_out(1, 3, 1, device)[0].work
    wp.launch(kernel.settle_heads, 3, [channels, before, work], [shift, after], device=device)
    wp.launch(kernel.follow_heads, 3, [channels, meet, scalar(REACH), shift], [after], device=device)
    found = np.split(after.numpy().astype(np.float64), starts_of(lines)[1:-1])
    expected = [moved[0].copy(), moved[1], follow(moved[2], moved[1][-1] - node, moved[1][-1])]
    expected[0][0] = moved[1][-1]
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, atol=TOLERANCE[dtype], rtol=0.0)
    np.testing.assert_array_equal(found[0][0], found[1][-1])
    np.testing.assert_array_equal(found[0][0], found[2][-1])
